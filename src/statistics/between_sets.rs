//! Noise of the mean frames of sets from set to set: what the frames of a set share cancels within the set,
//! and not between sets.

use super::jackknife::Value;

/// Mean frame of a set.
pub(crate) struct MeanFrame<'a> {
    /// Mean over the frames, DN.
    pub mean_dn: &'a [f32],
    /// Exposure of a dark or level of a flat, which the fixed pattern follows.
    pub at: f64,
    /// Number of frames.
    pub frames: usize,
    /// Temporal variance of a frame from the differences of the set's frames, DN^2.
    pub var_dn2: f64,
}

/// Relative error of the ratio by charge, offsets, light and patterns that move from set to set (a named
/// choice).
pub(crate) const MOVES: f64 = 0.02;
/// Number of blocks of the jackknife: the error is known to a sixth of itself.
const BLOCKS: usize = 20;
/// Maximum sum of the squared weights of the other sets (a named choice: beyond, the pattern is
/// extrapolated).
const MAX_SQUARES: f64 = 4.0;

/// Returns the weights that leave nothing of a polynomial through all sets but the one at `middle`
/// (Lagrange's formula): 1 for that set. Sets at one place count alike. `None` if they do not determine it.
fn weights(at: &[f64], middle: usize) -> Option<Vec<f64>> {
    let others = |i: usize| (0..at.len()).filter(move |k| *k != middle && *k != i);
    let is_one_place = at.iter().all(|x| *x == at[0]);
    let of = |i: usize| match i {
        _ if i == middle => 1.0,
        _ if is_one_place => -((at.len() - 1) as f64).recip(),
        _ => -others(i).map(|k| (at[middle] - at[k]) / (at[i] - at[k])).product::<f64>(),
    };
    let all: Vec<f64> = (0..at.len()).map(of).collect();
    let squares = all.iter().map(|w| w * w).sum::<f64>() - 1.0;
    (squares < MAX_SQUARES).then_some(all)
}

/// Returns the variance of the mean of the second set about a polynomial through the others, over what the
/// noise within the sets makes of it, with its jackknife error over blocks of pixels. The fixed pattern and
/// the dark charge cancel: three darks by a line in the exposure (Healey and Kondepudy 1994, eq. 6), four
/// flats by a parabola in the level. Independent frames give 1. `mask`: above 0 for pixels that are used.
/// `None` if the sets do not determine the polynomial, or without noise.
pub(crate) fn noise_over_that_within(sets: &[&MeanFrame<'_>], mask: &[f32]) -> Option<Value> {
    let at: Vec<f64> = sets.iter().map(|s| s.at).collect();
    let weights = weights(&at, 1)?;
    let expected: f64 = sets.iter().zip(&weights).map(|(s, w)| w * w * s.var_dn2 / s.frames as f64).sum();
    let length = mask.len().div_ceil(BLOCKS).max(1);
    // Per block: pixels, sum, and sum of squares of the residuals.
    let sums: Vec<[f64; 3]> = (0..mask.len())
        .step_by(length)
        .map(|from| {
            let mut out = [0.0; 3];
            for i in (from..(from + length).min(mask.len())).filter(|i| mask[*i] > 0.0) {
                let residual: f64 = sets.iter().zip(&weights).map(|(s, w)| w * f64::from(s.mean_dn[i])).sum();
                out[0] += 1.0;
                out[1] += residual;
                out[2] += residual * residual;
            }
            out
        })
        .collect();
    let of = |skipped: usize| {
        let kept = sums.iter().enumerate().filter(|(k, _)| *k != skipped).map(|(_, s)| s);
        let [n, sum, square] = kept.fold([0.0; 3], |a, s| [a[0] + s[0], a[1] + s[1], a[2] + s[2]]);
        (square - sum * sum / n) / ((n - 1.0) * expected)
    };
    let value = of(sums.len());
    let blocks = sums.len() as f64;
    let without: Vec<f64> = (0..sums.len()).map(of).collect();
    let mean = without.iter().sum::<f64>() / blocks;
    let square: f64 = without.iter().map(|v| (v - mean).powi(2)).sum();
    let std_err = (square * (blocks - 1.0) / blocks).sqrt();
    (expected > 0.0 && value.is_finite() && std_err.is_finite()).then_some(Value { value, std_err })
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Darks of two frames with a fixed pattern and a charge of its own in each pixel: independent frames
    /// give 1, and frames with half of the one before in them give 3; both within four standard errors, which
    /// are right to a fifth over 60 draws.
    #[test]
    fn what_pairs_share_is_seen_from_set_to_set() {
        const SHAPE: (usize, usize) = (60, 80);
        let pixels = SHAPE.0 * SHAPE.1;
        let mask = vec![1.0; pixels];
        for (share, expected) in [(0.0f64, 1.0), (0.5, 3.0)] {
            let mut all = Vec::new();
            for seed in 0..60u64 {
                let normal =
                    |frame: u64, i: usize| PixelRng::new(seed, Stream::Frame, frame, i as u32, 0).normal();
                let dark = |set: u64, exposure_s: f64| -> Vec<f32> {
                    let pixel = |i: usize| {
                        let fixed = 3.0 * normal(1000, i) + 5.0 * exposure_s * (1.0 + normal(1001, i));
                        let first = normal(2 * set, i);
                        let second = share * first + (1.0 - share * share).sqrt() * normal(2 * set + 1, i);
                        (fixed + 0.5 * (first + second)) as f32
                    };
                    (0..pixels).map(pixel).collect()
                };
                let exposures = [0.1, 0.25, 1.0];
                let means: Vec<Vec<f32>> =
                    exposures.iter().enumerate().map(|(k, e)| dark(k as u64, *e)).collect();
                let set = |k: usize| MeanFrame {
                    mean_dn: &means[k],
                    at: exposures[k],
                    frames: 2,
                    var_dn2: 1.0 - share,
                };
                let (a, b, c) = (set(0), set(1), set(2));
                all.push(noise_over_that_within(&[&a, &b, &c], &mask).unwrap());
                assert!(noise_over_that_within(&[&a, &c, &b], &mask).is_none());
            }
            let z = |v: &Value| (v.value - expected) / v.std_err;
            assert!(all.iter().all(|v| z(v).abs() < 4.5), "{share}");
            let rms = (all.iter().map(|v| z(v).powi(2)).sum::<f64>() / all.len() as f64).sqrt();
            assert!((rms - 1.0).abs() < 0.25, "{share}: {rms}");
        }
    }
}
