//! Light that rises or falls steadily while a set of flats is taken.

use crate::fit::line::fit;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Minimum drift of the light within a set, relative, to be reported, and minimum share of the scatter of the
/// frames that it explains.
const DRIFT: (f64, f64) = (0.005, 0.7);
/// Maximum chance that flicker alone makes such a line (a named choice: none of a thousand sets is reported
/// by chance).
const MAX_CHANCE: f64 = 1e-5;
/// Minimum number of frames.
const MIN_FRAMES: usize = 8;

/// Returns a note if the light rises or falls steadily while a set is taken.
pub(super) fn in_words(means_dn: &[f64], zero_dn: f64) -> Option<String> {
    let n = means_dn.len() as f64;
    let mean_dn = means_dn.iter().sum::<f64>() / n;
    let line = fit(means_dn.iter().enumerate().map(|(k, mean)| (k as f64, *mean, 1.0)))?;
    let all = line.slope * (n - 1.0) / (mean_dn - zero_dn);
    let share = 1.0 - line.chi2 / means_dn.iter().map(|mean| (mean - mean_dn).powi(2)).sum::<f64>();
    let is_steady = all.abs() > DRIFT.0 && share > DRIFT.1;
    if means_dn.len() < MIN_FRAMES || !is_steady {
        return None;
    }
    // A slope over its error by the frames' own scatter is Student's t with n - 2 degrees of freedom.
    let t = line.slope.abs() / (line.var_slope * line.chi2 / (n - 2.0)).sqrt().max(f64::MIN_POSITIVE);
    let chance = StudentsT::new(0.0, 1.0, n - 2.0).ok().map_or(1.0, |law| 2.0 * law.sf(t));
    (chance < MAX_CHANCE).then(|| {
        format!(
            "the light {} by {} from its first frame to its last, and that is {} of the scatter of its frames: a lamp that warms up or drifts, and no \
             flicker",
            if all > 0.0 { "rises" } else { "falls" },
            crate::number::percent(all.abs()),
            crate::number::percent(share)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::in_words;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Independent frames are called a drift in none of 20,000 sets of 8 to 40 frames (0.2 by chance).
    #[test]
    fn flicker_is_no_drift() {
        for seed in 0..20_000u32 {
            let drawn = |k: u32| 1064.0 + 20.0 * PixelRng::new(6, Stream::Effect, 2, seed, k).normal();
            let means: Vec<f64> = (0..8 + seed % 33).map(drawn).collect();
            assert_eq!(in_words(&means, 64.0), None, "{seed}");
        }
    }

    #[test]
    fn a_drift_is_told_from_flicker() {
        let of = |off: &dyn Fn(usize) -> f64| (0..20).map(|k| 1064.0 + 1000.0 * off(k)).collect::<Vec<f64>>();
        let rises = in_words(&of(&|k| 0.001 * k as f64), 64.0).unwrap();
        assert!(rises.contains("rises by 2 %"), "{rises}");
        assert!(in_words(&of(&|k| -0.001 * k as f64), 64.0).unwrap().contains("falls"));
        assert_eq!(in_words(&of(&|k| 0.01 * (k % 2) as f64), 64.0), None);
        assert_eq!(in_words(&of(&|k| 0.0001 * k as f64), 64.0), None);
        assert_eq!(in_words(&[1000.0, 1010.0, 1020.0], 64.0), None);
    }
}
