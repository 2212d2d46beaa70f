//! The peak of a photon-transfer curve, and single levels that would be taken for it.

use super::median::median;

/// Levels below this share of the largest mean have read noise in their variance over the mean.
const DIM: f64 = 0.05;
/// A level is a stray where its variance over the mean is this multiple of the median of five around it: noise of
/// a turning well falls, and does not rise by half from one level to the next.
const STRAY: f64 = 1.5;
/// Levels around, itself included, whose median is taken.
const AROUND: usize = 2;

/// Share of the peak's level from which on the well turns.
const TURNING: f64 = 0.97;
/// Level over the peak's up to which another level may be its scatter.
const BEYOND: f64 = 1.02;

/// Level from which on rows of (mean above black, variance) are full well, and that of the variance's peak;
/// `None` where the variance grows to the last. Strays must have been taken out.
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

/// Places of levels, given as (mean above black, variance), whose variance lies far above that of the levels
/// around: one of them would be taken for the peak. Nothing for fewer than five.
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
    // Variance over mean stays from level to level in the shot noise; the variance stays in the read noise.
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
