//! Fixed patterns of sets against each other: weighted images, and how much of one pattern is in another.

use super::Campaign;
use super::campaign::SetView;
use crate::statistics::median::{MAD_OF_NORMAL, median};

/// Deviations of a pixel from which on it is hot, or dust.
const MAX_DEVIATIONS: f64 = 5.0;
/// Noise of a pattern that is taken off, as a variance, DN^2, and its relative error.
#[derive(Debug, Clone, Copy)]
pub struct Noise {
    dn2: f64,
    rel: f64,
}

impl Noise {
    /// Of darks: hot and noisy pixels, which are left out, are in the mean (the error is a named choice).
    pub fn of_darks(dn2: f64) -> Self {
        Self { dn2, rel: 0.3 }
    }

    /// Of flats, whose shot noise is that of all pixels (the error is a named choice).
    pub fn of_flats(dn2: f64) -> Self {
        Self { dn2, rel: 0.05 }
    }
}

/// Blocks left out in turn for the error.
const BLOCKS: usize = 16;
/// Shifts of the frame that are tried, pixels.
const MAX_SHIFT: isize = 2;

/// Weights of images whose sum is the value at x = 0 of the line through them.
pub fn intercept(x: &[f64], weight: &[f64]) -> Option<Vec<f64>> {
    let sum = |f: &dyn Fn(usize) -> f64| (0..x.len()).map(f).sum::<f64>();
    let (s, sx) = (sum(&|i| weight[i]), sum(&|i| weight[i] * x[i]));
    let sxx = sum(&|i| weight[i] * x[i] * x[i]);
    let determinant = s * sxx - sx * sx;
    (determinant > 1e-9 * s * sxx)
        .then(|| (0..x.len()).map(|i| weight[i] * (sxx - sx * x[i]) / determinant).collect())
}

/// Weights of images whose sum is the slope of the line through them.
pub fn slope(x: &[f64], weight: &[f64]) -> Option<Vec<f64>> {
    let sum = |f: &dyn Fn(usize) -> f64| (0..x.len()).map(f).sum::<f64>();
    let (s, sx) = (sum(&|i| weight[i]), sum(&|i| weight[i] * x[i]));
    let sxx = sum(&|i| weight[i] * x[i] * x[i]);
    let determinant = s * sxx - sx * sx;
    (determinant > 1e-9 * s * sxx)
        .then(|| (0..x.len()).map(|i| weight[i] * (s * x[i] - sx) / determinant).collect())
}

/// Images with weights, added.
pub fn combined(campaign: &Campaign<'_>, sets: &[usize], weights: &[f64]) -> Vec<f64> {
    let pixels = campaign.sets[sets[0]].facts.middle_dn.len();
    let mut out = vec![0.0; pixels];
    for (&i, weight) in sets.iter().zip(weights) {
        let image = campaign.sets[i].facts.middle_dn.iter();
        out.iter_mut().zip(image).for_each(|(sum, v)| *sum += weight * f64::from(*v));
    }
    out
}

/// Variance of the mean of a set's frames, DN^2.
pub fn noise_of_mean(set: &SetView) -> f64 {
    set.variance_dn2().map_or(0.0, |v| v.0) / set.frames().max(1) as f64
}

/// Sums over blocks of pixels, without hot pixels and dust: a b, a^2, b^2, and the pixels.
pub fn products(a: &[f64], b: &[f64], columns: usize) -> [[f64; 4]; BLOCKS] {
    let usual = |image: &[f64]| median(image.iter().map(|v| v.abs())) / MAD_OF_NORMAL;
    let most = [a, b].map(|image| MAX_DEVIATIONS * usual(image));
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

/// Regression of one pattern on another whose noise is known, with the error of leaving out blocks of pixels in
/// turn.
pub fn share(offsets: &[f64], pattern: &[f64], noise: Noise, columns: usize) -> Option<(f64, f64)> {
    let sums = products(offsets, pattern, columns);
    // Relative error of what is left of the pattern without its noise.
    let to_noise = |left: f64| {
        let n: f64 = sums.iter().map(|s| s[3]).sum();
        noise.rel * n * noise.dn2 / left
    };
    let of = |without: Option<usize>| {
        let kept = || sums.iter().enumerate().filter(|(k, _)| Some(*k) != without).map(|(_, s)| s);
        let sum = |j: usize| kept().map(|s| s[j]).sum::<f64>();
        let left = sum(2) - sum(3) * noise.dn2;
        (left > 0.0).then(|| (sum(0) / left, left))
    };
    let (all, left) = of(None)?;
    let parts: Vec<f64> = (0..BLOCKS).map(|k| of(Some(k)).map(|p| p.0)).collect::<Option<_>>()?;
    let mean = parts.iter().sum::<f64>() / BLOCKS as f64;
    let squares: f64 = parts.iter().map(|v| (v - mean).powi(2)).sum();
    let std = (squares * (BLOCKS - 1) as f64 / BLOCKS as f64).sqrt();
    Some((all, std.hypot(all * to_noise(left))))
}

/// Shifts of a few pixels.
pub fn shifts() -> impl Iterator<Item = (isize, isize)> {
    (-MAX_SHIFT..=MAX_SHIFT)
        .flat_map(|down| (-MAX_SHIFT..=MAX_SHIFT).map(move |right| (down, right)))
        .filter(|shift| *shift != (0, 0))
}

/// An image moved; its edges come in again at the other side.
pub fn moved(image: &[f64], columns: usize, down: isize, right: isize) -> Vec<f64> {
    let rows = (image.len() / columns) as isize;
    let from = |i: usize| {
        let (y, x) = ((i / columns) as isize, (i % columns) as isize);
        ((y + down).rem_euclid(rows) * columns as isize + (x + right).rem_euclid(columns as isize)) as usize
    };
    (0..image.len()).map(|i| image[from(i)]).collect()
}
