//! Kurtosis of the noise: a test of normality of the pixel deviations.

use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature};
use crate::statistics::layout::Layout;
use crate::statistics::lines::Lines;

/// Square of a normal number that is exceeded once in a hundred thousand draws.
const RARE: f64 = 19.5;

/// Fourth power of the deviations over the square of their variance, over all pixels and frames; 3 for normal
/// noise.
#[derive(Debug)]
pub struct Kurtosis;

impl Statistic for Kurtosis {
    fn id(&self) -> &'static str {
        "kurtosis of the noise"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "above 0: rare large deviations; below 0: two levels or clipped"
    }

    fn sums(&self, _: &Layout) -> usize {
        1
    }

    fn add(&self, image: &[f32], _: &Lines, layout: &Layout, sums: &mut [f64]) {
        // Eight partial sums per row are precise enough in 32 bits.
        let row = |row: &[f32]| {
            let (eights, rest) = row.as_chunks::<8>();
            let mut sums = [0f32; 8];
            for eight in eights {
                for (sum, v) in sums.iter_mut().zip(eight) {
                    let square = v * v;
                    *sum += square * square;
                }
            }
            f64::from(sums.iter().sum::<f32>()) + rest.iter().map(|v| f64::from(*v).powi(4)).sum::<f64>()
        };
        sums[0] += image.chunks(layout.columns().max(1)).map(row).sum::<f64>();
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        let r = chunk.summary();
        let square = r.var.value.powi(2);
        if let (Some(fourth), true) = (chunk.sums().first(), square > 0.0) {
            put.put(0, fourth / r.pixels / square, 0.0);
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 3.0, 1.0) };
        let variance = view.noise.max(1e-9);
        let square = variance * variance;
        // The deviation of frame k from the mean of those before it, scaled to the variance of a frame, has
        // the fourth cumulant of a frame times ((k - 1) / k)^2 (1 + 1 / (k - 1)^3).
        let of_frame = |k: f64| ((k - 1.0) / k).powi(2) * (1.0 + (k - 1.0).powi(-3));
        let kept = (2..=view.frames.len().max(2)).map(|k| of_frame(k as f64)).sum::<f64>() / view.dof;
        // In that deviation frame k has the weight w, w^2 = (k - 1) / k, and each frame before it -w / (k -
        // 1). The cumulants of two successive frames enter by the pair that ends with k, and by the k - 2
        // pairs before it.
        let [three, two, one] = s.fourth_next;
        let of_pairs = |k: f64| {
            let earlier = -1.0 / (k - 1.0);
            let last = 6.0 * earlier * earlier * two + 4.0 * earlier * three + 4.0 * earlier.powi(3) * one;
            let before = (k - 2.0) * earlier.powi(4) * (6.0 * two + 4.0 * (three + one));
            ((k - 1.0) / k).powi(2) * (last + before)
        };
        let pairs = (2..=view.frames.len().max(2)).map(|k| of_pairs(k as f64)).sum::<f64>() / view.dof;
        // All cumulants of a Poisson number equal its mean; a mean of several is nearer to a normal one.
        let (shot, _) = view.pixels();
        let poisson = shot * view.prediction.base.gain_dn_per_e.powi(2);
        // Pixels with more light have more shot noise, and some pixels have more dark current.
        let set = view.at.map(|i| &view.all.campaign.sets[i]);
        let uneven = set.map_or(0.0, |info| (shot * info.spread).powi(2));
        let dark =
            view.at.map_or(0.0, |i| view.all.dark_spread_dn2[i]) * view.prediction.base.gain_dn_per_e.powi(2);
        // The fourth cumulant of a sine of random phase is -3/2 of the square of its variance.
        let sine = s.ripples.iter().map(|r| r.0 * r.0).sum::<f64>();
        let own = 3.0 * (s.unequal + uneven + 0.5 * dark) + kept * (s.fourth + poisson) + pairs;
        // The mean of n fourth powers of normal numbers, over the square of their variance, has the variance
        // 24 sum(rho^4) / n: its scatter is that of the fourth Hermite polynomial, whose covariance is 24
        // rho^4 (Mehler 1866; Cramer 1946, 27.4, for independent numbers).
        let rho = |c: f64| (c / variance).powi(4);
        // The covariance at a lag equals that at the opposite lag.
        let below = (1..=2).flat_map(|y| (-2..=2).map(move |x| (y, x)));
        let half: f64 = [(0, 1), (0, 2)].into_iter().chain(below).map(|(y, x)| rho(view.lag(y, x))).sum();
        let neighbours = rho(view.lag(0, 0)) + 2.0 * half;
        let (rows, columns) = view.all.campaign.shape;
        let lines = rho(s.row.lag(0) + s.ripple(0.0)) * columns as f64 + rho(s.column.lag(0)) * rows as f64;
        let waves = s.lines.iter().map(|l| rho(l.0)).sum::<f64>() * o.pixels;
        let (fewer, of_fields) = of_field(view.dof);
        let share = s.fields.squares() / square;
        let later: f64 = s.shot_memory.iter().chain(&s.read_memory).map(|r| 2.0 * r.powi(4)).sum();
        let alike = (neighbours + lines + waves) * (1.0 + later);
        let dof = o.pixels * view.dof;
        // For pixels whose variances V have mean 1, the fourth power minus 6 E V^2 of the square scatters by
        // 96 E V^4 + 72 (E V^2)^3 - 144 E V^2 E V^3: 24 if they are equal (moments of normal numbers: 105 -
        // 9, 2 and 15 - 3).
        let [two, three, four] = view.unequal().1;
        // A single sample of the noisiest pixel, at a chance of one in a hundred thousand, must lie within as
        // many standard errors.
        let noisiest = view.noisiest();
        let single = if noisiest > 1.5 { (noisiest * RARE).powi(2) / dof / RARE.sqrt() } else { 0.0 };
        let unlike = (96.0 * four + 72.0 * two.powi(3) - 144.0 * two * three - 24.0).max(0.0);
        let in_time = 3.0 * view.unlike_in_time();
        let rest = 6.0 * (view.rough.1.hypot(view.moving) / variance);
        Expected::plain(
            o,
            3.0 * dof / (dof + 2.0) + own / square + in_time + share * fewer,
            in_quadrature(&[
                ((24.0 * alike.max(1.0) + unlike) / dof).sqrt(),
                single,
                3.0 * (s.unsure + 0.5 * dark + 0.3 * uneven + 0.01 * s.unequal.abs()) / square,
                (s.unsure_fourth + 0.3 * poisson + 0.3 * s.fourth.abs() + 1.5 * sine) / square,
                0.01,
                0.1 * in_time,
                rest,
                share * of_fields,
            ]),
        )
        .with_tails(single.hypot((unlike / dof).sqrt()))
    }
}

/// Returns the change of the excess kurtosis due to a shape drawn anew in every frame, for n independent
/// frames instead of many, and its scatter, over the square of its share of the noise. With A2 and A4 the
/// mean square and fourth power of n normal numbers, and 1/2 the variance of the square of a cosine, the
/// excess is 3/2 A4 - 3 A2^2. Its mean is 3/2 - 6 / n, and its variance is 72 / n for many frames (moments of
/// normal numbers: 1, 3, 15, 105), three times that for one.
fn of_field(n: f64) -> (f64, f64) {
    (-6.0 / n, (72.0 * (1.0 + 2.0 / n) / n).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Mean of the excess over 20 000 draws of few normal numbers, within five standard errors. The scatter
    /// does not exceed the stated one by more than a tenth, and at few frames is at least two fifths of it.
    #[test]
    fn few_frames_show_a_field_as_they_come() {
        for n in [1u32, 3, 7, 15] {
            let excess = |draw: u32| {
                let mut rng = PixelRng::new(5, Stream::Effect, u64::from(n), draw, 0);
                let squares: Vec<f64> = (0..n).map(|_| rng.normal().powi(2)).collect();
                let mean =
                    |of: &dyn Fn(f64) -> f64| squares.iter().map(|s| of(*s)).sum::<f64>() / f64::from(n);
                1.5 * mean(&|s| s * s) - 3.0 * mean(&|s| s).powi(2)
            };
            let all: Vec<f64> = (0..20_000).map(excess).collect();
            let mean = all.iter().sum::<f64>() / all.len() as f64;
            let sd = (all.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / all.len() as f64).sqrt();
            let (less, said) = of_field(f64::from(n));
            assert!((mean - 1.5 - less).abs() < 5.0 * sd / (all.len() as f64).sqrt(), "{n}: {mean}");
            // The fourth power of one number has heavy tails: its scatter is known to a tenth.
            assert!((0.4..1.1).contains(&(sd / said)), "{n}: {sd}, said {said}");
        }
    }

    /// Kurtosis of 400 lists of four frames of normal numbers, as deviations from the mean of those before.
    /// Its mean and variance agree with 3 n / (n + 2) and 24 / n within five standard errors, n the degrees
    /// of freedom of all pixels.
    #[test]
    fn of_normal_noise_it_scatters_as_it_says() {
        let (side, frames, lists) = (24usize, 4u32, 400u32);
        let layout = Layout::new(&Array2::from_elem((side, side), true), 4095);
        let of = |list: u32| {
            let (mut fourth, mut square) = ([0.0], 0.0);
            let mut rng = PixelRng::new(3, Stream::Effect, 0, list, 0);
            let mut sum = vec![0.0; side * side];
            for k in 0..frames {
                let frame: Vec<f64> = sum.iter().map(|_| rng.normal()).collect();
                if k > 0 {
                    let scale = f64::from(k) / f64::from(k + 1);
                    let of = |(v, s): (&f64, &f64)| ((v - s / f64::from(k)) * scale.sqrt()) as f32;
                    let image: Vec<f32> = frame.iter().zip(&sum).map(of).collect();
                    square += image.iter().map(|v| f64::from(v * v)).sum::<f64>();
                    Kurtosis.add(&image, &Lines::new(layout.shape), &layout, &mut fourth);
                }
                sum.iter_mut().zip(&frame).for_each(|(s, v)| *s += v);
            }
            let n = (side * side) as f64 * f64::from(frames - 1);
            (fourth[0] / n / (square / n).powi(2), n)
        };
        let all: Vec<(f64, f64)> = (0..lists).map(of).collect();
        let (n, count) = (all[0].1, f64::from(lists));
        let z: Vec<f64> = all.iter().map(|k| (k.0 - 3.0 * n / (n + 2.0)) / (24.0 / n).sqrt()).collect();
        let mean = z.iter().sum::<f64>() / count;
        let variance = z.iter().map(|z| z * z).sum::<f64>() / count;
        assert!(mean.abs() < 5.0 / count.sqrt(), "{mean}");
        assert!((variance - 1.0).abs() < 5.0 * (2.0 / count).sqrt(), "{variance}");
    }
}
