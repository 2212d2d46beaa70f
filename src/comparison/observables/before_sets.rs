//! Exposures before the sets of a campaign that are not in the files, from the carry-over in first frames.

use super::{Observable, Statistic, frame_scatter, from_set_to_set, mean, settling, successive, variance};
use crate::dataset::{FrameRow, Kind};
use crate::statistics::correlated_frames::CorrelatedFrames;
use crate::statistics::median::median;
use radcam_sim::predict::{Before, SetInfo};
use std::collections::BTreeMap;

/// Thresholds (named choices): significance of a carry-over in standard errors, relative difference up to
/// which two shares of it are equal, ratio of squares below which one explanation is far better than another,
/// and minimum number of first frames.
const CARRIES: f64 = 5.0;
const MAX_REL: f64 = 0.3;
const FAR_BETTER: f64 = 0.25;
const MIN_FIRSTS: usize = 4;
/// Maximum number of frames that people discard at each setting before they save any (a named choice).
const MOST_DISCARDED: u8 = 3;
/// Maximum share by which discarded frames are counted: a mean of the last two frames shows a half, and
/// forgets.
const MAX_SHARE: f64 = 0.45;

/// Returns the part of a small correlation of successive frames that n frames show about their mean, with
/// their variance over n added (its bias to first order: Marriott and Pope 1954, Biometrika 41, 390).
fn kept_by_few(n: f64) -> f64 {
    1.0 - 2.0 / n - 4.0 / (n * n) + 2.0 / (n * (n - 1.0))
}

/// Returns the covariance of successive frames over their variance, both about the mean of n frames, if each
/// frame has this share of the one before, which in turn has a share of its own (an autoregression of the
/// first order: Box and Jenkins 1976, 3.2.3).
fn shown_of(share: f64, n: usize) -> f64 {
    let frames = CorrelatedFrames::new(n, |apart| share.powi(apart as i32));
    frames.product() / frames.left() + 1.0 / n as f64
}

/// Returns the share that shows this value; a small one by its slope at 0.
fn share_of(shown: f64, n: usize) -> f64 {
    let (mut low, mut high) = (0.0, 0.99);
    if n < 3 || shown <= 0.0 {
        return shown / kept_by_few(n as f64);
    }
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if shown_of(middle, n) < shown { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// First frame of a set.
struct First {
    /// Mean of the frame minus that of those after it, DN.
    step_dn: f64,
    /// Variance of that mean, DN^2.
    var_dn2: f64,
    /// Levels of the set and of the one before, DN.
    level_dn: f64,
    before_dn: f64,
}

/// Finds the exposures before the sets from their first frames, and the correlation of successive frames if
/// it is significant. If successive frames carry something and first frames carry nothing of the set before,
/// the first frames follow frames of their own level that are not in the dataset. If first frames lack a
/// share of their own level, and the noise does not contradict it, they follow darkness. If they carry a
/// power of the share of successive frames, a few frames of their own level were discarded.
pub(super) fn of(
    list: &[Observable],
    sets: &[SetInfo],
    settings: &[FrameRow],
    zero_dn: f64,
) -> (Before, Option<f64>) {
    let mut levels: Vec<Option<f64>> = vec![None; sets.len()];
    let set_of = |o: &Observable, statistic: &dyn Statistic| o.is(statistic).then_some(()).and(o.set);
    for o in list {
        if let Some(set) = set_of(o, &mean::Mean) {
            levels[set] = Some(o.measured.value);
        }
    }
    // Covariance over variance, weighted by its error, for each number of frames.
    let mut within: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
    for (i, o) in list.iter().enumerate() {
        let Some(set) = set_of(o, &successive::Successive).filter(|s| settings[*s].kind == Kind::Flat) else {
            continue;
        };
        let same = |v: &&Observable| v.is(&variance::Variance) && v.set == Some(set) && v.frames == o.frames;
        let near = list[..i].iter().rev().take(60).find(same);
        let Some(var) = near.map(|v| v.measured.value).filter(|v| *v > 0.0) else { continue };
        let weight = (var / o.measured.std_err.max(1e-12)).powi(2);
        let sums = within.entry(o.frames.1 - o.frames.0).or_default();
        *sums = (sums.0 + weight * o.measured.value / var, sums.1 + weight);
    }
    let (mut sum, mut weights) = (0.0, 0.0);
    for (n, (product, weight)) in within {
        let weight_of_share = weight * kept_by_few(n as f64).powi(2);
        (sum, weights) = (sum + weight_of_share * share_of(product / weight, n), weights + weight_of_share);
    }
    let in_pairs = if weights == 0.0 { of_pairs(list) } else { None };
    let (share, error) = in_pairs.unwrap_or((sum / weights, weights.sqrt().recip()));
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
    // Share of a change of level carried by first frames, its error, and the sum of squares left by it.
    let carried = |change: &dyn Fn(&First) -> f64| {
        let squares = sum(&|f| change(f).powi(2));
        let own = sum(&|f| change(f) * f.step_dn) / squares;
        (own, squares.sqrt().recip(), sum(&|f| (f.step_dn - own * change(f)).powi(2)))
    };
    let (of_set, uncertain, rest) = carried(&|f| f.before_dn - f.level_dn);
    let (of_dark, uncertain_dark, rest_dark) = carried(&|f| zero_dn - f.level_dn);
    let lacks_light = firsts.len() >= MIN_FIRSTS && of_dark > CARRIES * uncertain_dark;
    let is_lag = weights == 0.0 || (share - of_dark).abs() < (3.0 * error).max(MAX_REL * of_dark);
    tracing::debug!(
        "successive frames share {share:.5} +- {error:.5}, first frames have {of_set:.6} +- {uncertain:.6} of the set before and {of_dark:.6} +- {uncertain_dark:.6} of darkness"
    );
    // Each frame of its own level multiplies the carry-over by the share: what is left gives the number of
    // frames.
    let discarded = || {
        let off = |n: u8| (of_set.ln() - f64::from(n + 1) * share.ln()).abs();
        let sure = |n: u8| MAX_REL.max(3.0 * f64::from(n + 1) * error / share);
        (0..=MOST_DISCARDED).find(|n| off(*n) < sure(*n)).filter(|n| *n > 0).map(Before::Discarded)
    };
    let before = if in_pairs.is_some() {
        let is_settled = share > CARRIES * error
            && step_in_pairs(list, &levels).is_some_and(|step| step < MAX_REL * share * (1.0 - share));
        if is_settled { Before::Level } else { Before::Frame }
    } else if let Some(found) = (share > CARRIES * error && share < MAX_SHARE && of_set > CARRIES * uncertain)
        .then(discarded)
        .flatten()
    {
        found
    } else if share > CARRIES * error && of_set.abs().max(uncertain) < MAX_REL * share {
        Before::Level
    } else if lacks_light && is_lag && rest_dark < FAR_BETTER * rest {
        Before::Dark
    } else {
        Before::Frame
    };
    (before, Some(share).filter(|s| *s > CARRIES * error))
}

/// Returns the correlation of the two frames of pairs, with its error, from the noise of the means of darks:
/// means of two frames with correlation r have (1 + r) / (1 - r) times the noise that their difference makes
/// of it. `None` if no darks tell it.
fn of_pairs(list: &[Observable]) -> Option<(f64, f64)> {
    let ratios = list.iter().filter(|o| o.is(&from_set_to_set::FromSetToSet));
    let ratios = ratios.filter(|o| o.frames.1 - o.frames.0 == 2 && o.measured.std_err > 0.0);
    let (sum, weights) = ratios.fold((0.0, 0.0), |(sum, weights), o| {
        let weight = o.measured.std_err.powi(-2);
        (sum + weight * o.measured.value, weights + weight)
    });
    let ratio = (weights > 0.0).then(|| sum / weights)?;
    Some(((ratio - 1.0) / (ratio + 1.0), 2.0 / (ratio + 1.0).powi(2) / weights.sqrt()))
}

/// Returns the usual difference of the two frames of pairs, relative to the change of level before them.
fn step_in_pairs(list: &[Observable], levels: &[Option<f64>]) -> Option<f64> {
    let mut steps = Vec::new();
    for o in list.iter().filter(|o| o.is(&mean::Mean) && o.frames.1 - o.frames.0 == 2) {
        let before = o.set.and_then(|s| s.checked_sub(1)).and_then(|s| levels[s]);
        let Some(change) = before.map(|before| (before - o.measured.value).abs()) else { continue };
        steps.push(((2.0 * o.frame_means.1.max(0.0)).sqrt(), change));
    }
    let most = steps.iter().map(|s| s.1).fold(0.0, f64::max);
    steps.retain(|s| s.1 > MAX_REL * most);
    (most > 0.0).then(|| median(steps.iter().map(|s| s.0 / s.1)))
}

/// Returns a note for the reader; `None` if each set follows the one before it.
pub(super) fn note(before: Before) -> Option<String> {
    let note = match before {
        Before::Frame => return None,
        Before::Discarded(n) => {
            return Some(format!(
                "first frames carry of the set before what {n} {} of their own level leave{}: taken as exposed between the sets and not saved",
                if n == 1 { "frame" } else { "frames" },
                if n == 1 { "s" } else { "" },
            ));
        }
        Before::Level => {
            "successive frames of a set are correlated, and first frames carry nothing of the set before: frames were exposed between the sets \
             that are not in the dataset"
        }
        Before::Dark => {
            "first frames lack the same share of their own level in all sets: taken as what darkness before each set leaves (darks that are not \
             in the dataset, or a pause)"
        }
    };
    Some(note.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// The exact form has the slope of the first-order one, and its inverse gives the share back.
    #[test]
    fn few_frames_show_a_share_as_stated() {
        for n in [3usize, 4, 6, 8, 16] {
            let slope = shown_of(1e-4, n) / 1e-4;
            assert!((slope - kept_by_few(n as f64)).abs() < 2e-3, "{n}: {slope}");
            for share in [0.02, 0.1, 0.3, 0.6, 0.9] {
                let back = share_of(shown_of(share, n), n);
                assert!((back - share).abs() < 1e-6, "{n}: {back} for {share}");
            }
        }
    }

    /// Covariance of successive numbers, each of which carries over 5 % to the next, for 400 000 short runs;
    /// tolerance five standard errors.
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
