//! Test of memory: first frames that follow the level of the set before look like scatter from frame to
//! frame.

use crate::observables::Observations;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Minimum share of the squared deviations of the first frames that follows the level before (a named
/// choice).
const FOLLOWS: f64 = 0.8;
/// Maximum chance of that share under independent deviations (a named choice: the same share of few steps
/// says little).
const BY_CHANCE: f64 = 1.0 / 300.0;
/// Minimum part of the squared steps that does not follow the level, and minimum root mean square of the
/// steps over the largest level (named choices).
const LEAST_OF_STEPS: f64 = 0.05;
const LEAST_STEP: f64 = 0.05;

/// First frame of a set.
struct First {
    /// Step of the level from the set before, DN.
    step_dn: f64,
    /// Level of the set's other frames, DN.
    level_dn: f64,
    /// Height of the first frame above that, DN.
    off_dn: f64,
}

/// Returns true if first frames that follow the level before explain most of the scatter of frames within
/// their sets.
pub fn is_memory(all: &Observations) -> bool {
    let mut is_known = vec![false; all.frame_means_dn.len()];
    let mut order: Vec<usize> = Vec::new();
    for frame in &all.campaign.frames {
        if is_known.get(frame.set).is_some_and(|known| !known) {
            is_known[frame.set] = true;
            order.push(frame.set);
        }
    }
    let means = |set: usize| all.frame_means_dn.get(set).map_or(&[][..], Vec::as_slice);
    let firsts = order.windows(2).filter_map(|pair| {
        let before = means(pair[0]).last()?;
        let (first, others) = means(pair[1]).split_first().filter(|(_, others)| !others.is_empty())?;
        let level_dn = others.iter().sum::<f64>() / others.len() as f64;
        Some(First { step_dn: before - level_dn, level_dn, off_dn: first - level_dn })
    });
    follow(&firsts.collect::<Vec<First>>())
}

/// Returns the residuals of a straight line over other numbers.
fn beside(values: &[f64], over: &[f64]) -> Vec<f64> {
    let n = values.len().max(1) as f64;
    let mean = |of: &[f64]| of.iter().sum::<f64>() / n;
    let (of_values, of_over) = (mean(values), mean(over));
    let square: f64 = over.iter().map(|o| (o - of_over).powi(2)).sum();
    let product: f64 = over.iter().zip(values).map(|(o, v)| (o - of_over) * (v - of_values)).sum();
    let slope = if square > 0.0 { product / square } else { 0.0 };
    values.iter().zip(over).map(|(v, o)| v - of_values - slope * (o - of_over)).collect()
}

/// Returns true if the deviations follow the steps beside a line over the level, which a lamp that starts dim
/// makes. Criteria: their share, and Student's t with the effective number of steps (Kish 1965, Survey
/// Sampling, 8.2). In a sweep with equal steps they are the same and tell nothing.
fn follow(firsts: &[First]) -> bool {
    let of = |value: fn(&First) -> f64| firsts.iter().map(value).collect::<Vec<f64>>();
    let levels = of(|f| f.level_dn);
    let (x, y) = (beside(&of(|f| f.step_dn), &levels), beside(&of(|f| f.off_dn), &levels));
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let (xx, xy, yy) = (dot(&x, &x), dot(&x, &y), dot(&y, &y));
    let steps: f64 = firsts.iter().map(|f| f.step_dn * f.step_dn).sum();
    let most = levels.iter().map(|level| level.abs()).fold(0.0, f64::max);
    if xx <= LEAST_OF_STEPS * steps || steps <= (LEAST_STEP * most).powi(2) * firsts.len() as f64 {
        return false;
    }
    let share = xy * xy / (xx * yy);
    let dof = xx * xx / x.iter().map(|x| x.powi(4)).sum::<f64>() - 3.0;
    let Ok(students) = StudentsT::new(0.0, 1.0, dof) else { return false };
    let t = (dof * share / (1.0 - share).max(1e-12)).sqrt();
    tracing::debug!("first frames follow the level before: share {share:.3}, t {t:.1} of {dof:.1} degrees");
    xy > 0.0 && share >= FOLLOWS && students.sf(t) < BY_CHANCE
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// At most 1 % of 3000 campaigns with flicker, a lamp that starts dim, or a drift are taken for memory: 8
    /// and 13 levels in any order, ascending, and at one level. Lag of twenty times the flicker is found in
    /// at least half of 300 campaigns of 13 levels in any order.
    #[test]
    fn lag_is_told_from_flicker() {
        let taken = |n: usize, order: usize, campaigns: u32, [lag, flicker, dim]: [f64; 3]| {
            let of = |campaign: u32| {
                let mut random = PixelRng::new(7, Stream::Effect, 0, campaign, n as u32);
                let mut levels: Vec<f64> = (0..n).map(|_| 4000.0 * random.uniform()).collect();
                match order {
                    0 => {}
                    1 => levels = (1..=n).map(|k| 4000.0 * k as f64 / n as f64).collect(),
                    2 => levels = (1..=n).map(|k| 4000.0 * 0.7f64.powi((n - k) as i32)).collect(),
                    _ => levels = (0..n).map(|k| 2000.0 - k as f64 + 0.6 * random.normal()).collect(),
                }
                let first = |pair: &[f64]| {
                    let step_dn = pair[0] - pair[1];
                    let off_dn = lag * step_dn + pair[1] * (flicker * random.normal() - dim);
                    First { step_dn, level_dn: pair[1], off_dn }
                };
                follow(&levels.windows(2).map(first).collect::<Vec<_>>())
            };
            (0..campaigns).filter(|c| of(*c)).count()
        };
        for (n, order) in [8, 13].into_iter().flat_map(|n| (0..4).map(move |order| (n, order))) {
            let (flicker, dim) =
                (taken(n, order, 3000, [0.0, 0.01, 0.0]), taken(n, order, 3000, [0.0, 0.001, 0.01]));
            assert!(flicker <= 30 && dim <= 30, "{n} levels, order {order}: {flicker} {dim}");
        }
        let lag = taken(13, 0, 300, [0.02, 0.001, 0.0]);
        assert!(lag >= 150, "{lag}");
    }
}
