//! Peak of a photon-transfer curve, and stray levels that could be mistaken for it.

use super::median::median;

/// Minimum level, as a share of the largest mean: below it variance over mean contains read noise.
const DIM: f64 = 0.05;
/// Minimum ratio of a stray's variance over mean to the median of five levels around it: noise near full well
/// falls, and does not rise by half from one level to the next.
const STRAY: f64 = 1.5;
/// Levels on each side that enter the median, besides the level itself.
const AROUND: usize = 2;

/// Onset of full well, as a share of the peak's level.
const TURNING: f64 = 0.97;
/// Maximum ratio of another level to the peak's at which the difference may be scatter.
const BEYOND: f64 = 1.02;

/// Returns the level at which full well begins and the level of the variance peak, from rows of (mean above
/// black, variance); `None` if the variance grows to the last level. Strays must be removed first.
///
/// ```
/// use radcam::statistics::peak::turn_off;
/// let mut levels: Vec<(f64, f64)> = (1..20).map(|i| (1000.0 * f64::from(i), 500.0 * f64::from(i))).collect();
/// assert_eq!(turn_off(&levels), None);
/// levels[18].1 = 100.0;
/// assert_eq!(turn_off(&levels), Some((17_460.0, 18_000.0)));
/// ```
pub fn turn_off(levels: &[(f64, f64)]) -> Option<(f64, f64)> {
    let peak = levels.iter().max_by(|a, b| a.1.total_cmp(&b.1))?.0;
    let top = levels.iter().map(|l| l.0).fold(0.0, f64::max);
    (top > BEYOND * peak).then_some((TURNING * peak, peak))
}

/// Returns the indices of levels, given as (mean above black, variance), whose variance lies far above that
/// of the levels around and could be mistaken for the peak. Empty for fewer than five levels.
///
/// ```
/// use radcam::statistics::peak::strays;
/// let mut levels: Vec<(f64, f64)> = (1..20).map(|i| (1000.0 * f64::from(i), 500.0 * f64::from(i))).collect();
/// assert!(strays(&levels).is_empty());
/// levels[15].1 = 400_000.0;
/// assert_eq!(strays(&levels), [15]);
/// let read_noise: Vec<(f64, f64)> = (1..20).map(|i| (10.0 * f64::from(i), 1.12 + 0.03 * f64::from(i))).collect();
/// assert!(strays(&read_noise).is_empty());
/// ```
pub fn strays(levels: &[(f64, f64)]) -> Vec<usize> {
    if levels.len() < 2 * AROUND + 1 {
        return Vec::new();
    }
    let top = levels.iter().map(|l| l.0).fold(0.0, f64::max);
    let mut order: Vec<usize> = (0..levels.len()).filter(|&i| levels[i].0 > DIM * top).collect();
    order.sort_by(|&a, &b| levels[a].0.total_cmp(&levels[b].0));
    let var = |k: usize| levels[order[k]].1;
    let ratio = |k: usize| var(k) / levels[order[k]].0;
    // Between levels, variance over mean is constant in shot noise; the variance is constant in read noise.
    let is_stray = |k: &usize| {
        let from = k.saturating_sub(AROUND).min(order.len().saturating_sub(2 * AROUND + 1));
        let around = || from..(from + 2 * AROUND + 1).min(order.len());
        let far = |value: f64, usual: f64| value > STRAY * usual;
        around().len() > 2 * AROUND
            && far(ratio(*k), median(around().map(ratio)))
            && far(var(*k), median(around().map(var)))
    };
    (0..order.len()).filter(is_stray).map(|k| order[k]).collect()
}
