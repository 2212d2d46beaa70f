//! Exposures before the sets of a campaign that are not in the files, by what first frames carry of them.

use super::{Observable, Statistic, frame_scatter, mean, settling, successive, variance};
use crate::dataset::{FrameRow, Kind};
use crate::statistics::median::median;
use radcam_sim::predict::{Before, SetInfo};

/// Standard errors from which on frames carry something, relative difference up to which two shares of it are
/// one, ratio of squares from which on one explanation is far better than another, and fewest first frames that
/// tell (named choices).
const CARRIES: f64 = 5.0;
const MAX_REL: f64 = 0.3;
const FAR_BETTER: f64 = 0.25;
const MIN_FIRSTS: usize = 4;

/// Part of a small correlation of successive frames that n frames show about their mean, with their variance over
/// n added (its bias to first order: Marriott and Pope 1954, Biometrika 41, 390).
fn kept_by_few(n: f64) -> f64 {
    1.0 - 2.0 / n - 4.0 / (n * n) + 2.0 / (n * (n - 1.0))
}

/// First frame of a set.
struct First {
    /// Its mean less that of those after it, DN.
    step_dn: f64,
    /// Variance of it, DN^2.
    var_dn2: f64,
    /// Levels of its set and of the one before, DN.
    level_dn: f64,
    before_dn: f64,
}

/// Exposures before the sets, by their first frames. Where successive frames carry something from one to the
/// next and first frames nothing from the set before, they follow frames of their own level that are not in
/// the dataset. Where these lack a share of their own level, and the noise does not contradict it, they
/// follow darkness.
pub(super) fn of(list: &[Observable], sets: &[SetInfo], settings: &[FrameRow], zero_dn: f64) -> Before {
    let mut levels: Vec<Option<f64>> = vec![None; sets.len()];
    let set_of = |o: &Observable, statistic: &dyn Statistic| o.is(statistic).then_some(()).and(o.set);
    for o in list {
        if let Some(set) = set_of(o, &mean::Mean) {
            levels[set] = Some(o.measured.value);
        }
    }
    // Covariance over variance, weighed by its error.
    let mut within = (0.0, 0.0);
    for (i, o) in list.iter().enumerate() {
        let Some(set) = set_of(o, &successive::Successive).filter(|s| settings[*s].kind == Kind::Flat) else {
            continue;
        };
        let same = |v: &&Observable| v.is(&variance::Variance) && v.set == Some(set) && v.frames == o.frames;
        let near = list[..i].iter().rev().take(60).find(same);
        let Some(var) = near.map(|v| v.measured.value).filter(|v| *v > 0.0) else { continue };
        let var = var * kept_by_few((o.frames.1 - o.frames.0) as f64);
        let weight = (var / o.measured.std_err.max(1e-12)).powi(2);
        within = (within.0 + weight * o.measured.value / var, within.1 + weight);
    }
    let (share, error) = (within.0 / within.1, within.1.sqrt().recip());
    let first = |o: &Observable| {
        let set = set_of(o, &settling::Settling).filter(|s| *s > 0 && o.index == 0)?;
        let scatter = list.iter().filter(|v| v.is(&frame_scatter::FrameScatter) && v.set == Some(set));
        Some(First {
            step_dn: o.measured.value,
            var_dn2: median(scatter.map(|v| v.measured.value)).max(1e-6),
            level_dn: levels[set]?,
            before_dn: levels[set - 1]?,
        })
    };
    let firsts: Vec<First> = list.iter().filter_map(first).collect();
    let sum = |of: &dyn Fn(&First) -> f64| firsts.iter().map(|f| of(f) / f.var_dn2).sum::<f64>();
    // Share of a change of level that first frames carry, its error, and the squares that it leaves.
    let carried = |change: &dyn Fn(&First) -> f64| {
        let squares = sum(&|f| change(f).powi(2));
        let own = sum(&|f| change(f) * f.step_dn) / squares;
        (own, squares.sqrt().recip(), sum(&|f| (f.step_dn - own * change(f)).powi(2)))
    };
    let (of_set, uncertain, rest) = carried(&|f| f.before_dn - f.level_dn);
    let (of_dark, uncertain_dark, rest_dark) = carried(&|f| zero_dn - f.level_dn);
    let lacks_light = firsts.len() >= MIN_FIRSTS && of_dark > CARRIES * uncertain_dark;
    let is_lag = within.1 == 0.0 || (share - of_dark).abs() < (3.0 * error).max(MAX_REL * of_dark);
    if share > CARRIES * error && of_set.abs().max(uncertain) < MAX_REL * share {
        Before::Level
    } else if lacks_light && is_lag && rest_dark < FAR_BETTER * rest {
        Before::Dark
    } else {
        Before::Frame
    }
}

/// Note for the reader; `None` where each set follows the one before it.
pub(super) fn note(before: Before) -> Option<&'static str> {
    match before {
        Before::Frame => None,
        Before::Level => Some(
            "successive frames of a set are correlated, and first frames carry nothing of the set before: frames were exposed between the sets \
             that are not in the dataset",
        ),
        Before::Dark => Some(
            "first frames lack the same share of their own level in all sets: taken as what darkness before each set leaves (darks that are not \
             in the dataset, or a pause)",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Covariance of successive numbers of which each hands on 5 % to the next, over 400 000 runs of a few:
    /// within five standard errors.
    #[test]
    fn few_frames_keep_a_part_of_their_correlation() {
        const RUNS: u32 = 400_000;
        let covariance = 0.05 * 0.95;
        for n in [3usize, 5, 8] {
            let product = |run: u32| {
                let mut random = PixelRng::new(77, Stream::Effect, n as u64, run, 0);
                let mut last = random.normal();
                let mut next = || {
                    let now = random.normal();
                    let out = 0.95 * now + 0.05 * last;
                    last = now;
                    out
                };
                let frames: Vec<f64> = (0..n).map(|_| next()).collect();
                let mean = frames.iter().sum::<f64>() / n as f64;
                let square = frames.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1) as f64;
                let successive = frames.windows(2).map(|w| (w[0] - mean) * (w[1] - mean)).sum::<f64>();
                successive / (n - 1) as f64 + square / n as f64
            };
            let (mut sum, mut squares) = (0.0, 0.0);
            for value in (0..RUNS).map(product) {
                (sum, squares) = (sum + value, squares + value * value);
            }
            let mean = sum / f64::from(RUNS);
            let error = (squares / f64::from(RUNS)).sqrt() / f64::from(RUNS).sqrt();
            let expected = covariance * kept_by_few(n as f64);
            assert!((mean - expected).abs() < 5.0 * error, "{n}: {mean} +- {error} for {expected}");
        }
    }
}
