//! Excess spread of the pixels' variances, relative: whether some pixels are noisier than the rest.

use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature};
use radcam_sim::predict::LineNoise;

/// The spread.
#[derive(Debug)]
pub struct Unequal;

impl Statistic for Unequal {
    fn id(&self) -> &'static str {
        "spread of pixel variances"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "a few pixels noisier than the rest"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        let r = chunk.summary();
        put.put(0, r.unequal.value, chunk.inflation.unequal * (8.0 / r.pixels).sqrt());
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 0.0, 1.0) };
        // The variance of a sample variance has the fourth cumulant over the frames in it (Cramer 1946, 27.4). Of two successive frames, of
        // which there are n - 1 pairs, it has theirs by the products of the weights 1 / n of a square and -1 / n (n - 1) of a product.
        let n = view.n;
        let [three, two, one] = s.fourth_next;
        let pairs =
            (n - 1.0) * (2.0 / (n * n) + 4.0 / (n * (n - 1.0)).powi(2)) * two - 4.0 / (n * n) * (three + one);
        let fourth = s.fourth / n + if n > 1.5 { pairs } else { 0.0 };
        let allowed = 1.0 + 2.0 / view.dof;
        let variance = view.noise.max(1e-9);
        let rest = view.rough.1.hypot(view.moving) / variance;
        let square = variance * variance;
        // Shot noise of unequal dark charge: only pixels that stand out are known to have more of it.
        let dark = view.at.map_or(0.0, |set| view.all.dark_spread_dn2[set]);
        let charge = dark * view.prediction.base.gain_dn_per_e.powi(2);
        // Pixels whose noise is alike have sample variances that are alike: of the scatter 2 s^4 / dof the mean over pairs of pixels of
        // (covariance / s^2)^2 is missing.
        let (rows, columns) = view.all.campaign.shape;
        let alike = s.shared_squares(rows, columns) / square * 2.0 / view.dof / allowed;
        // Where lines share noise, the sample variances scatter from line to line, and there are few lines. Of n independent sample variances of
        // d degrees of freedom, with a = 2 / d, the spread over (1 + a) has the variance 2 a^2 / (n (1 + a)), by first order in
        // x^2 - a - 2 a x for v = 1 + x and the moments of chi-square: E x^2 = a, E x^3 = 2 a^2, E x^4 = 3 a^2 + 6 a^3. What lines have in common
        // enters by the square of their share of the variance.
        let a = 2.0 / view.dof;
        let of_lines = |noise: &LineNoise, lines: usize| {
            let (own, of_mean) = (noise.lag(0), noise.of_mean());
            // Lines that are alike count as fewer.
            let independent = lines as f64 * if of_mean > own { own / of_mean } else { 1.0 };
            (own / variance).powi(2) * a * (2.0 / (independent.max(1.0) * (1.0 + a))).sqrt()
        };
        Expected::plain(
            o,
            (s.unequal + fourth / allowed) / square - alike,
            in_quadrature(&[
                o.measured.std_err,
                (s.unsure + charge) / square,
                s.unsure_fourth / (view.n * allowed) / square,
                0.002,
                rest,
                of_lines(&s.row, rows),
                of_lines(&s.column, columns),
                // How much alike depends on phases, of which there is one a frame.
                0.3 * alike,
            ]),
        )
    }
}
