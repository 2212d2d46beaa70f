//! First frames that follow the level of the set before: what looks like scatter from frame to frame is memory.

use crate::observables::Observations;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Share of the squares of the first frames' deviations from which on they follow the level before (a named
/// choice: a lamp that starts dim explains half of them where levels come in any order).
const FOLLOWS: f64 = 0.8;
/// Chance of that share under independent deviations, below which they are none (a named choice: the same share
/// of few steps says little).
const BY_CHANCE: f64 = 1.0 / 300.0;

/// Step of the level from the set before, and how far the first frame of the set lies on that side of the others,
/// DN.
type Step = (f64, f64);

/// Returns true if most of the scatter of frames within their sets is what first frames have of the level before.
pub fn is_memory(all: &Observations) -> bool {
    let mut order: Vec<usize> = Vec::new();
    for frame in &all.campaign.frames {
        if order.last() != Some(&frame.set) {
            order.push(frame.set);
        }
    }
    let means = |set: usize| all.frame_means_dn.get(set).map_or(&[][..], Vec::as_slice);
    let steps = order.windows(2).filter_map(|pair| {
        let before = means(pair[0]).last()?;
        let (first, others) = means(pair[1]).split_first().filter(|(_, others)| !others.is_empty())?;
        let level = others.iter().sum::<f64>() / others.len() as f64;
        Some((before - level, first - level))
    });
    follow(&steps.collect::<Vec<Step>>())
}

/// Returns true if the deviations go with the steps: by their share, and by Student's t of a line through the
/// origin, with as many steps as count like the largest (Kish 1965, Survey Sampling, 8.2).
fn follow(steps: &[Step]) -> bool {
    let sum = |of: fn(&Step) -> f64| steps.iter().map(of).sum::<f64>();
    let (xx, xy, yy) = (sum(|s| s.0 * s.0), sum(|s| s.0 * s.1), sum(|s| s.1 * s.1));
    let share = xy * xy / (xx * yy);
    let dof = xx * xx / sum(|s| s.0.powi(4)) - 1.0;
    let Ok(students) = StudentsT::new(0.0, 1.0, dof) else { return false };
    let t = (dof * share / (1.0 - share).max(1e-12)).sqrt();
    tracing::debug!("first frames follow the level before: share {share:.3}, t {t:.1} of {dof:.1} degrees");
    xy > 0.0 && share >= FOLLOWS && students.sf(t) < BY_CHANCE
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Of 3000 campaigns of 6 and of 13 levels in any order at most 1 % are taken for memory where the light
    /// flickers by a part of itself, 3 % where a lamp starts dim beside it; of those with lag of twenty times the
    /// flicker more than half are.
    #[test]
    fn lag_is_told_from_flicker() {
        let taken = |levels: usize, campaigns: u32, lag: f64, flicker: f64, dim: f64| {
            let of = |campaign: u32| {
                let mut random = PixelRng::new(7, Stream::Effect, 0, campaign, levels as u32);
                let levels: Vec<f64> = (0..levels).map(|_| 4000.0 * random.uniform()).collect();
                let step = |pair: &[f64]| {
                    let x = pair[0] - pair[1];
                    (x, lag * x + pair[1] * (flicker * random.normal() - dim))
                };
                follow(&levels.windows(2).map(step).collect::<Vec<_>>())
            };
            (0..campaigns).filter(|c| of(*c)).count()
        };
        for levels in [6, 13] {
            let (flicker, dim) = (taken(levels, 3000, 0.0, 0.01, 0.0), taken(levels, 3000, 0.0, 0.001, 0.01));
            assert!(flicker <= 30 && dim <= 90, "{levels} levels: {flicker} {dim}");
            let lag = taken(levels, 300, 0.02, 0.001, 0.0);
            assert!(lag >= 150, "{levels} levels: {lag}");
        }
    }
}
