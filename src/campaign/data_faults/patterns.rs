//! Comparison of fixed patterns of sets: weighted images, and the fraction of one pattern in another.

use super::Campaign;
use super::orientation::{TURNS, flattened};
use super::set_view::SetView;
use crate::statistics::median::{MAD_OF_NORMAL, median};

/// Minimum number of pixels of a usable pattern (a named choice: a correlation of 0.03 is chance there).
pub const MIN_PIXELS: usize = 1024;
/// Minimum deviation of a hot or dusty pixel.
const MAX_DEVIATIONS: f64 = 5.0;
/// Number of jackknife blocks: four by four.
const BLOCKS: usize = 16;
/// Maximum shift of the frame that is tried, pixels.
const MAX_SHIFT: isize = 2;
/// Range of the fraction of a pattern that is present as a whole.
const WHOLE: std::ops::Range<f64> = 0.7..1.4;

/// Value and standard error.
pub type WithError = (f64, f64);

/// Noise of a pattern as a variance, DN^2, with its relative error.
#[derive(Debug, Clone, Copy)]
pub struct Noise {
    pub dn2: f64,
    pub rel: f64,
}

impl Noise {
    /// Returns the noise of darks: hot and noisy pixels, which are excluded, contribute to its mean (the
    /// error is a named choice).
    pub fn of_darks(dn2: f64) -> Self {
        Self { dn2, rel: 0.3 }
    }

    /// Returns the noise of this number of pixels from frames with alternating sign: three times the
    /// error of normal noise, because of noisy pixels (a named choice).
    pub fn by_turns(dn2: f64, pixels: usize) -> Self {
        Self { dn2, rel: 3.0 * (2.0 / pixels.max(1) as f64).sqrt() }
    }

    /// Returns the noise of flats: shot noise is equal for all pixels (the error is a named choice).
    pub fn of_flats(dn2: f64) -> Self {
        Self { dn2, rel: 0.05 }
    }
}

/// Weights of images for a straight line through each pixel.
pub struct Line {
    /// Weights for the value at x = 0.
    pub at_zero: Vec<f64>,
    /// Weights for the slope.
    pub slope: Vec<f64>,
}

impl Line {
    /// Fits the line through images at x, weighted by their noise; `None` if all have the same x.
    pub fn of(campaign: &Campaign<'_>, sets: &[usize], x: &[f64]) -> Option<Self> {
        let weight: Vec<f64> =
            sets.iter().map(|&i| 1.0 / noise_of_mean(&campaign.sets[i]).max(1e-6)).collect();
        let sum = |f: &dyn Fn(usize) -> f64| (0..x.len()).map(|i| weight[i] * f(i)).sum::<f64>();
        let (s, sx, sxx) = (sum(&|_| 1.0), sum(&|i| x[i]), sum(&|i| x[i] * x[i]));
        let determinant = s * sxx - sx * sx;
        let over = |f: &dyn Fn(usize) -> f64| (0..x.len()).map(|i| weight[i] * f(i) / determinant).collect();
        (determinant > 1e-9 * s * sxx)
            .then(|| Self { at_zero: over(&|i| sxx - sx * x[i]), slope: over(&|i| s * x[i] - sx) })
    }
}

/// Returns the pattern of a weighted sum of images, and its noise, DN^2.
pub fn combined(campaign: &Campaign<'_>, sets: &[usize], weights: &[f64]) -> (Vec<f64>, f64) {
    let first = &campaign.sets[sets[0]].facts;
    let mut out = vec![0.0; first.middle_dn.len()];
    let mut noise_dn2 = 0.0;
    for (&i, weight) in sets.iter().zip(weights) {
        let set = &campaign.sets[i];
        out.iter_mut().zip(&set.facts.middle_dn).for_each(|(sum, v)| *sum += weight * f64::from(*v));
        noise_dn2 += weight * weight * noise_of_mean(set);
    }
    (flattened(&out, first.middle_columns), noise_dn2)
}

/// Returns the pattern of one set, DN.
pub fn pattern_of(set: &SetView) -> Vec<f64> {
    let image: Vec<f64> = set.facts.middle_dn.iter().map(|v| f64::from(*v)).collect();
    flattened(&image, set.facts.middle_columns)
}

/// Returns the variance of the mean of a set's frames, DN^2 (Healey and Kondepudy 1994, eq. 43:
/// sigma_N^2 / s).
pub fn noise_of_mean(set: &SetView) -> f64 {
    set.mean_noise_factor * set.variance_dn2().map_or(0.0, |v| v.0) / set.frames().max(1) as f64
}

/// Returns the noise variance of the mean of a set's frames, DN^2, without hot pixels; 0 for a single
/// frame. `in_turns`: sum of the frames with alternating sign.
pub fn noise_of(mean: &[f32], in_turns: &[f32], frames: usize, columns: usize) -> f64 {
    let n = frames as f64;
    let (plus, minus) = (frames.div_ceil(2) as f64, (frames / 2) as f64);
    if frames < 2 {
        return 0.0;
    }
    // Means of both halves, and their difference with the noise of the overall mean.
    let difference = |(m, t): (&f32, &f32)| {
        let (sum, t) = (n * f64::from(*m), f64::from(*t));
        (0.5 * (sum + t) / plus - 0.5 * (sum - t) / minus) * (plus * minus).sqrt() / n
    };
    let noise = flattened(&mean.iter().zip(in_turns).map(difference).collect::<Vec<_>>(), columns);
    let image = flattened(&mean.iter().map(|v| f64::from(*v)).collect::<Vec<_>>(), columns);
    let most = MAX_DEVIATIONS * median(image.iter().map(|v| v.abs())) / MAD_OF_NORMAL;
    let (sum, count) = (image.iter().zip(&noise).filter(|(v, _)| v.abs() < most))
        .fold((0.0, 0.0), |(sum, count), (_, d)| (sum + d * d, count + 1.0));
    sum / f64::max(count, 1.0)
}

/// Sums over the pixels of a block: a b, a^2, b^2, and their number.
pub type Sums = [f64; 4];

/// Returns the sums of all blocks, without hot pixels and dust.
fn sums_of(a: &[f64], b: &[f64], columns: usize) -> [Sums; BLOCKS] {
    let most = [a, b].map(|image| MAX_DEVIATIONS * median(image.iter().map(|v| v.abs())) / MAD_OF_NORMAL);
    let rows = a.len() / columns;
    let mut sums = [[0.0; 4]; BLOCKS];
    for i in (0..a.len()).filter(|&i| a[i].abs() < most[0] && b[i].abs() < most[1]) {
        let (y, x) = (i / columns, i % columns);
        let block = (4 * y / rows.max(1)) * 4 + 4 * x / columns;
        let own = &mut sums[block.min(BLOCKS - 1)];
        for (sum, v) in own.iter_mut().zip([a[i] * b[i], a[i] * a[i], b[i] * b[i], 1.0]) {
            *sum += v;
        }
    }
    sums
}

/// Computes a statistic from the sums over all pixels of two images, with the jackknife standard error
/// from leaving out one block of pixels at a time (Efron and Tibshirani 1993, eq. 11.5); also returns
/// the sums.
pub fn by_blocks(
    a: &[f64],
    b: &[f64],
    columns: usize,
    of: impl Fn(&Sums) -> Option<f64>,
) -> Option<(WithError, Sums)> {
    let blocks = sums_of(a, b, columns);
    let without = |out: Option<usize>| {
        let mut sums = [0.0; 4];
        for (_, own) in blocks.iter().enumerate().filter(|(k, _)| Some(*k) != out) {
            sums.iter_mut().zip(own).for_each(|(sum, v)| *sum += v);
        }
        sums
    };
    let all = without(None);
    let value = of(&all)?;
    let parts: Vec<f64> = (0..BLOCKS).map(|k| of(&without(Some(k)))).collect::<Option<_>>()?;
    let n = BLOCKS as f64;
    let mean = parts.iter().sum::<f64>() / n;
    let squares: f64 = parts.iter().map(|v| (v - mean).powi(2)).sum();
    Some(((value, (squares * (n - 1.0) / n).sqrt()), all))
}

/// Regresses an image on a pattern with known noise (Fuller 1987, eq. 1.2.3), with standard error: 1 if
/// the image contains the whole pattern.
pub fn share(image: &[f64], pattern: &[f64], noise: Noise, columns: usize) -> Option<WithError> {
    let left = |sums: &Sums| sums[2] - sums[3] * noise.dn2;
    let of = |sums: &Sums| (left(sums) > 0.0).then(|| sums[0] / left(sums));
    let ((value, std), all) = by_blocks(image, pattern, columns, of)?;
    Some((value, std.hypot(value * noise.rel * all[3] * noise.dn2 / left(&all))))
}

/// Describes the turn or small shift of an image that makes the pattern match; `None` without one.
pub fn moved_by(
    image: &[f64],
    pattern: &[f64],
    noise: Noise,
    columns: usize,
    min_sigmas: f64,
) -> Option<String> {
    let fits = |image: &[f64]| {
        share(image, pattern, noise, columns)
            .is_some_and(|(part, std)| part > min_sigmas * std && WHOLE.contains(&part))
    };
    if let Some((name, _)) = TURNS.iter().find(|(_, turn)| fits(&turn(image, columns))) {
        return Some((*name).into());
    }
    let side = -MAX_SHIFT..=MAX_SHIFT;
    let shifts = side.clone().flat_map(|down| side.clone().map(move |right| (down, right)));
    let found =
        shifts.filter(|s| *s != (0, 0)).find(|(down, right)| fits(&moved(image, columns, *down, *right)));
    found.map(|(down, right)| format!("{} rows and {} columns off", down.abs(), right.abs()))
}

/// Returns a shifted image, with wrapped edges.
fn moved(image: &[f64], columns: usize, down: isize, right: isize) -> Vec<f64> {
    let rows = (image.len() / columns) as isize;
    let from = |i: usize| {
        let (y, x) = ((i / columns) as isize, (i % columns) as isize);
        ((y + down).rem_euclid(rows) * columns as isize + (x + right).rem_euclid(columns as isize)) as usize
    };
    (0..image.len()).map(|i| image[from(i)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    const COLUMNS: usize = 64;

    /// Returns normal random numbers of a standard deviation, one for each pixel.
    fn drawn(seed: u32, what: u32, std: f64) -> Vec<f64> {
        let z = |i: u32| PixelRng::new(17, Stream::Frame, u64::from(what), seed, i).normal();
        (0..(COLUMNS * COLUMNS) as u32).map(|i| std * z(i)).collect()
    }

    fn sum(a: &[f64], b: &[f64]) -> Vec<f64> {
        a.iter().zip(b).map(|(a, b)| a + b).collect()
    }

    /// In 300 sensors a pattern of 1 DN under noise of 1 DN is regressed on one under noise of 0.7 DN:
    /// the mean is within four of its errors of the truth, the scatter equals the stated error to a
    /// fifth (five sigma of the scatter's own); with noise alone, and with twice the pattern.
    #[test]
    fn the_error_of_a_share_is_its_scatter() {
        for truth in [0.0, 1.0, 2.0] {
            let z: Vec<f64> = (0..300)
                .map(|seed| {
                    let pattern = drawn(seed, 0, 1.0);
                    let strong: Vec<f64> = pattern.iter().map(|v| truth * v).collect();
                    let (image, seen) =
                        (sum(&strong, &drawn(seed, 1, 1.0)), sum(&pattern, &drawn(seed, 2, 0.7)));
                    // The noise is known exactly here.
                    let noise = Noise { dn2: 0.49, rel: 0.0 };
                    let (value, std) = share(&image, &seen, noise, COLUMNS).unwrap();
                    (value - truth) / std
                })
                .collect();
            let n = z.len() as f64;
            let mean = z.iter().sum::<f64>() / n;
            let std = (z.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
            assert!(mean.abs() < 4.0 * std / n.sqrt() && (std - 1.0).abs() < 0.2, "{truth}: {mean} {std}");
        }
    }

    /// A shifted or turned pattern is found, an absent one is not.
    #[test]
    fn a_moved_pattern_is_found() {
        let pattern = drawn(1, 0, 1.0);
        let noise = Noise::of_flats(0.0);
        let found = |image: &[f64]| moved_by(image, &pattern, noise, COLUMNS, 8.0);
        assert_eq!(found(&moved(&pattern, COLUMNS, -1, 2)).unwrap(), "1 rows and 2 columns off");
        let turned: Vec<f64> = pattern.iter().rev().copied().collect();
        assert_eq!(found(&turned).unwrap(), "turned by 180 degrees");
        assert_eq!(found(&drawn(2, 0, 1.0)), None);
    }
}
