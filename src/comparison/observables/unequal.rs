//! Excess spread of the pixel variances, relative: a few pixels are noisier than the rest.

use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature};
use crate::statistics::pass::Summary;
use radcam_sim::predict::LineNoise;

/// Spread of the pixel variances.
#[derive(Debug)]
pub struct Unequal;

/// Returns the standard error for independent, equal normal pixels: `scatter` without a spread.
pub fn theory(r: &Summary) -> f64 {
    (scatter(r.frames as f64 - 1.0, [1.0; 3]) / r.pixels).sqrt()
}

/// Returns the variance, times the pixels, of the spread mean(v^2) / mean(v)^2 / (1 + a) of sample variances
/// v = V (1 + x) with d degrees of freedom, a = 2 / d. The variances V of the pixels have mean 1 and these
/// raw moments (second, third, fourth).
///
/// To first order the spread deviates by the mean of V^2 (2 x + x^2 - a) - 2 c V x, c = (1 + a) E V^2, over
/// 1 + a. The moments of chi-square are E x^2 = a, E x^3 = 2 a^2, E x^4 = 3 a^2 + 6 a^3. For equal pixels the
/// result is 2 a^2 / (1 + a).
fn scatter(dof: f64, [two, three, four]: [f64; 3]) -> f64 {
    let a = 2.0 / dof.max(1.0);
    let c = (1.0 + a) * two;
    let of_square = four - 2.0 * c * three + c * c * two;
    let all = 4.0 * a * of_square + four * (2.0 * a * a + 6.0 * a.powi(3)) + 8.0 * a * a * (four - c * three);
    all.max(0.0) / ((1.0 + a) * (1.0 + a))
}

impl Statistic for Unequal {
    fn id(&self) -> &'static str {
        "spread of pixel variances"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "a few pixels noisier than the rest"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        let r = chunk.summary();
        put.put(0, r.unequal.value, chunk.inflation.unequal * theory(r));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 0.0, 1.0) };
        // The variance of a sample variance contains the fourth cumulant over the frames (Cramer 1946, 27.4).
        // The n - 1 pairs of successive frames add their cumulants by the products of the weights 1 / n of a
        // square and -1 / n (n - 1) of a product.
        let n = view.n;
        let [three, two, one] = s.fourth_next;
        let pairs =
            (n - 1.0) * (2.0 / (n * n) + 4.0 / (n * (n - 1.0)).powi(2)) * two - 4.0 / (n * n) * (three + one);
        let fourth = s.fourth / n + if n > 1.5 { pairs } else { 0.0 };
        let allowed = 1.0 + 2.0 / view.dof;
        let variance = view.noise.max(1e-9);
        let rest = view.rough.1.hypot(view.moving) / variance;
        let square = variance * variance;
        // Shot noise of unequal dark charge: only pixels that stand out are compared with the noise that
        // their charge lets expect.
        let dark = view.at.map_or(0.0, |set| view.all.dark_spread_dn2[set]);
        let charge = 0.5 * dark * view.prediction.base.gain_dn_per_e.powi(2);
        let scatter_of_unlike =
            (scatter(view.dof, view.unequal().1) - scatter(view.dof, [1.0; 3])).max(0.0) / o.pixels;
        // Pixels with common noise have similar sample variances: the scatter 2 s^4 / dof lacks the mean over
        // pairs of pixels of (covariance / s^2)^2.
        let (rows, columns) = view.all.campaign.shape;
        let alike = s.shared_squares(rows, columns) / square * 2.0 / view.dof / allowed;
        let of_lines = |noise: &LineNoise, lines: usize| {
            let (own, of_mean) = (noise.lag(0), noise.of_mean());
            // Lines with common noise count as fewer.
            let independent = lines as f64 * if of_mean > own { own / of_mean } else { 1.0 };
            scatter_of_lines(own / variance, view.dof, independent.max(1.0))
        };
        let (of_sines, sines_scatter) = s
            .sines(rows)
            .map(|(v, one)| of_sine(v / variance, view.n, one))
            .fold((0.0, 0.0f64), |(value, error), (v, e)| (value + v, error.hypot(e)));
        let in_time = view.spread_in_time() / allowed;
        let few = in_quadrature(&[scatter_of_unlike.sqrt(), tail(view.noisiest(), view.dof, o.pixels)]);
        Expected::plain(
            o,
            (s.unequal + charge + fourth / allowed) / square - alike + of_sines + in_time,
            in_quadrature(&[
                o.measured.std_err,
                few,
                (s.unsure + charge) / square,
                s.unsure_fourth / (view.n * allowed) / square,
                0.002,
                rest,
                of_lines(&s.row, rows),
                of_lines(&s.column, columns),
                sines_scatter,
                s.fields.squares() / square * of_field(view.dof),
                // A wander has few bands.
                0.3 * alike,
                // Rounding changes the correlation of frames, which is not predicted.
                0.1 * in_time,
            ]),
        )
        .with_tails(few)
    }
}

/// Returns the contribution to the spread, and its scatter, of a sine with one random phase per frame that
/// has the part `share` of the pixels' variance, over n frames. `one`: mean over pairs of pixels of the
/// cosine of twice the phase between them; 1 if all have the same phase, 0 for many cycles.
///
/// Let m_k be the mean of exp(i k phase) over the frames. The sample variance of the sine at phase t,
/// relative to its variance, is n / (n - 1) (1 - |m_1|^2 - Re (m_2 - m_1^2) exp(2 i t)). Over the pixels it
/// scatters by h (1 - one), as an exponential variable does: E |m_2 - m_1^2|^2 = (n^2 - 1) / n^3 for
/// independent uniform phases gives h = (n + 1) / 2 n (n - 1). Let r be the mean sample variance of the sine,
/// N that of normal noise, and a = 2 / (n - 1). The spread beside that of normal pixels is (h (1 - one) - a)
/// r^2 / (1 + a) (N + r)^2, and r scatters by 1 / n (n - 1).
fn of_sine(share: f64, n: f64, one: f64) -> (f64, f64) {
    let share = share.clamp(0.0, 1.0);
    let a = 2.0 / (n - 1.0).max(1.0);
    let pairs = (n * (n - 1.0)).max(1.0);
    let over_pixels = 0.5 * (n + 1.0) / pairs;
    let of_walk = 2.0 * a * (1.0 - share) / pairs.sqrt();
    let part = share * share / (1.0 + a);
    (part * (over_pixels * (1.0 - one).clamp(0.0, 1.0) - a), part * over_pixels.hypot(of_walk))
}

/// Chi-square of one degree of freedom passes [`RARE`] with a chance of one in a hundred thousand: some
/// pixels in some sets of a thousand campaigns.
const RARE: f64 = 19.5;

/// Returns the error of the mean square of sample variances due to the noisiest pixel: its contribution at a
/// chance of 1e-5, scaled to one standard error, because means over few noisy pixels are not normal.
/// `largest`: variance of that pixel over the mean.
fn tail(largest: f64, dof: f64, pixels: f64) -> f64 {
    if largest <= 1.5 {
        return 0.0;
    }
    // Quantile at that chance of chi-square over its degrees of freedom (Wilson and Hilferty 1931).
    let a = 2.0 / (9.0 * dof.max(1.0));
    let quantile = (1.0 - a + RARE.sqrt() * a.sqrt()).powi(3);
    (largest * quantile).powi(2) / pixels / RARE.sqrt()
}

/// Returns the standard error of the spread if lines share the part `share` of the pixels' variance: the
/// sample variances scatter from line to line, and lines are few.
///
/// Take n independent sample variances v = 1 + x of d degrees of freedom, and a = 2 / d. To first order the
/// spread mean(v^2) / mean(v)^2 / (1 + a) - 1 is the mean of (x^2 - a - 2 a x) / (1 + a). By the moments of
/// chi-square, E x^2 = a, E x^3 = 2 a^2, E x^4 = 3 a^2 + 6 a^3, its variance is 2 a^2 / (n (1 + a)). The
/// common noise of lines enters by the square of its share.
fn scatter_of_lines(share: f64, dof: f64, lines: f64) -> f64 {
    let a = 2.0 / dof;
    share * share * a * (2.0 / (lines * (1.0 + a))).sqrt()
}

/// Returns the scatter of the spread of pixel variances due to a shape drawn anew in n independent frames,
/// over the square of its share of the noise. It is the scatter of 1/2 A2^2, with A2 the mean square of n
/// normal numbers (moments of chi-squared: n (n + 2) (n + 4) (n + 6) less n^2 (n + 2)^2, over n^4).
fn of_field(n: f64) -> f64 {
    0.5 * (8.0 * (n + 2.0) * (n + 3.0) / n.powi(3)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::{layout::Layout, pass::collect};
    use ndarray::Array2;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Sines of 100, 70 and 40 % of the variance, of many cycles and of less than one, over four to sixteen
    /// frames. To first order in 1 / n the mean of 4000 sets is as stated, within 0.3 of the scatter. The
    /// scatter agrees to a tenth above and a third below.
    #[test]
    fn a_sine_of_few_phases_spreads_as_stated() {
        const PHASES: usize = 32;
        for (n, share, cycles) in [(4, 1.0, 1.0), (4, 0.7, 1.0), (8, 0.7, 1.0), (16, 0.4, 1.0), (8, 1.0, 0.3)]
        {
            let a = 2.0 / (n as f64 - 1.0);
            let at = |y: usize| std::f64::consts::TAU * cycles * y as f64 / PHASES as f64;
            let spread = |run: u64| {
                let mut random = PixelRng::new(31, Stream::Frame, run, n as u32, 0);
                let phases: Vec<f64> = (0..n).map(|_| std::f64::consts::TAU * random.uniform()).collect();
                // Sample variance at each place, over the variance of the sine.
                let own: Vec<f64> = (0..PHASES)
                    .map(|y| {
                        let values: Vec<f64> = phases.iter().map(|p| (at(y) + p).sin()).collect();
                        let mean = values.iter().sum::<f64>() / n as f64;
                        2.0 * values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n as f64 - 1.0)
                    })
                    .collect();
                let mean = own.iter().sum::<f64>() / PHASES as f64;
                let square = own.iter().map(|v| v * v).sum::<f64>() / PHASES as f64;
                let noise = (1.0 - share) / share;
                (square - (1.0 + a) * mean * mean) / ((1.0 + a) * (noise + mean).powi(2))
            };
            let values: Vec<f64> = (0..4000).map(spread).collect();
            let mean = values.iter().sum::<f64>() / 4000.0;
            let scatter = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 4000.0).sqrt();
            let pairs = (0..PHASES).flat_map(|i| (0..PHASES).map(move |j| (i, j)));
            let one =
                pairs.map(|(i, j)| (2.0 * (at(i) - at(j))).cos()).sum::<f64>() / (PHASES * PHASES) as f64;
            let (value, error) = of_sine(share, n as f64, one);
            let case = format!("{n} frames, {share} of the variance, {cycles} cycles");
            assert!(
                (mean - value).abs() < 0.3 * scatter,
                "{case}: {mean}, stated {value}, scatter {scatter}"
            );
            assert!((0.9..1.5).contains(&(error / scatter)), "{case}: {scatter}, stated {error}");
        }
    }

    /// Row noise of 99 and of 80 % of the variance, 300 sets of seven frames each. The spread scatters as
    /// stated, within four standard errors of its standard deviation, whose relative variance is
    /// (kurtosis - 1) / 4 n.
    #[test]
    fn lines_that_share_noise_are_few() {
        const SHAPE: (usize, usize) = (64, 96);
        let layout = Layout::new(&Array2::from_elem(SHAPE, true), 4095);
        for (row_dn, pixel_dn) in [(10.0, 1.0), (8.0, 4.0)] {
            let values: Vec<f64> = (0..300u64)
                .map(|run| {
                    let normal = |f: u64, i: usize| {
                        PixelRng::new(29, Stream::Frame, 8 * run + f, i as u32, 0).normal()
                    };
                    let frame = |f: u64| -> Vec<u16> {
                        let value =
                            |i: usize| row_dn * normal(f, 10_000 + i / SHAPE.1) + pixel_dn * normal(f, i);
                        (0..SHAPE.0 * SHAPE.1).map(|i| (1000.0 + value(i)).round() as u16).collect()
                    };
                    let frames: Vec<Vec<u16>> = (0..7).map(frame).collect();
                    let frames: Vec<&[u16]> = frames.iter().map(Vec::as_slice).collect();
                    collect(&layout, &frames).unwrap().unwrap().unequal.value
                })
                .collect();
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let moment = |k: i32| values.iter().map(|v| (v - mean).powi(k)).sum::<f64>() / n;
            let relative = ((moment(4) / moment(2).powi(2) - 1.0) / (4.0 * n)).sqrt();
            let share = row_dn * row_dn / (row_dn * row_dn + pixel_dn * pixel_dn);
            let stated = scatter_of_lines(share, 6.0, SHAPE.0 as f64);
            let ratio = moment(2).sqrt() / stated;
            assert!((ratio - 1.0).abs() < 4.0 * relative, "{share}: {ratio} within {relative}");
        }
    }
}
