//! Unequal light on two frames of a set, or on sets of equal settings.

use super::{Campaign, Check, DataFault, FaultKind, setting_label};
use crate::number::percent;
use crate::statistics::median::median;

/// Minimum deviation of unequal light, relative to the usual scatter.
const MIN_SIGMAS: f64 = 8.0;
/// Minimum difference in light relative to the signal: undisturbed lamps stay within it (a named
/// choice).
const MIN_RELATIVE_DIFFERENCE: f64 = 0.005;
/// Minimum deviation of each of several pairs that differ alike, in standard deviations (a named choice, as
/// the next four: by chance at most three of 20000 campaigns of 18 pairs under a lamp of normal flicker meet
/// them all).
const MIN_SIGMAS_OF_EACH: f64 = 4.0;
/// Minimum number of such pairs.
const MIN_PAIRS_ALIKE: usize = 3;
/// Minimum ratio of their deviations to the largest of the other pairs.
const MIN_RATIO_TO_OTHERS: f64 = 1.5;
/// Maximum deviation of each from their mean, in standard deviations.
const MAX_SIGMAS_FROM_MEAN: f64 = 2.0;
/// Maximum mean of the other pairs, in its standard deviations.
const MAX_SIGMAS_OF_OTHERS: f64 = 4.0;
/// Maximum fraction of the sets with unequal pairs that are isolated faults: more are a property of the
/// lamp.
const MAX_SHARE_OF_PAIRS: f64 = 0.5;

/// Check for unequal light.
pub struct UnequalLight;

impl Check for UnequalLight {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero() else { return Vec::new() };
        let mut found: Vec<(Vec<usize>, String, bool)> = Vec::new();
        let pairs = campaign.places(|s| s.is_lit() && !s.clipped && s.frames() == 2);
        let signal = |i: usize| campaign.sets[i].level_dn() - zero.at(campaign.sets[i].exposure_s);
        let scatter = campaign.scatter(&zero);
        let share = campaign.carried(&scatter).unwrap_or(0.0);
        let apart = |i: usize| {
            let means = campaign.sets[i].means_dn();
            let before = i.checked_sub(1).map(|b| &campaign.sets[b]).filter(|b| b.frames() > 0);
            let carried = before.map_or(0.0, |b| share * (b.last_dn() - means[1]));
            let plain = means[1] - means[0];
            // The level before the first set is unknown, and the remainder is known to a fifth.
            if before.is_none() && share.abs() > 3e-4 || (plain + carried).abs() < 0.2 * carried.abs() {
                return 0.0;
            }
            let less = plain + carried;
            if less.abs() < plain.abs() { less } else { plain }
        };
        let sigma = |i: usize| 2f64.sqrt() * scatter.of_frame_dn(&campaign.sets[i]);
        let is_large = |i: usize| apart(i).abs() > MIN_RELATIVE_DIFFERENCE * signal(i);
        let far = |i: usize| is_large(i) && apart(i).abs() > MIN_SIGMAS * sigma(i);
        let mut unequal: Vec<usize> = pairs.iter().copied().filter(|&i| far(i)).collect();
        if unequal.is_empty() {
            let lit: Vec<usize> = pairs.iter().copied().filter(|&i| signal(i) > 0.0).collect();
            unequal = find_equally_apart(&lit, |i| apart(i) / signal(i), |i| sigma(i) / signal(i));
        }
        if !unequal.is_empty()
            && unequal.len() as f64 <= (MAX_SHARE_OF_PAIRS * pairs.len() as f64).max(1.0)
            && pairs.len() > 2
        {
            let most = unequal.iter().map(|&i| (apart(i) / signal(i)).abs()).fold(0.0, f64::max);
            let text = format!(
                "{}: the two frames differ by {}{} in light",
                campaign.named(&unequal),
                if unequal.len() > 1 { "up to " } else { "" },
                percent(most)
            );
            found.push((unequal, text, true));
        }
        // Equal settings. With a law of the levels the stray one among them is identified.
        let lit = campaign.places(|s| s.is_lit() && !s.clipped).len();
        let repeats = if lit < setting_label::MIN_FLATS { campaign.repeats() } else { Vec::new() };
        let spread = |sets: &Vec<usize>| {
            let levels: Vec<f64> = sets.iter().map(|&i| signal(i)).collect();
            let middle = median(levels.iter().copied());
            let most = levels.iter().fold(f64::NEG_INFINITY, |a, b| a.max(*b));
            let least = levels.iter().fold(f64::INFINITY, |a, b| a.min(*b));
            (most - least) / middle
        };
        for sets in &repeats {
            let own = spread(sets);
            let noise = sets
                .iter()
                .map(|&i| {
                    scatter.of_frame_dn(&campaign.sets[i])
                        / (campaign.sets[i].frames() as f64).sqrt()
                        / signal(i)
                })
                .fold(0.0, f64::max);
            if signal(sets[0]) > 20.0 && own > (MIN_SIGMAS * noise).max(MIN_RELATIVE_DIFFERENCE) {
                let text = format!(
                    "{}: stated exposure and light are the same, and the light differs by {}",
                    campaign.named(sets),
                    percent(own)
                );
                found.push((sets.clone(), text, false));
            }
        }
        let fault = |(sets, text, left_out): (Vec<usize>, String, bool)| {
            campaign.fault_of_sets(FaultKind::UnequalLight, &sets, text, left_out)
        };
        found.into_iter().map(fault).collect()
    }
}

/// Finds pairs whose light differs by the same fraction in the same direction, each too little to be
/// reported alone. `apart`: relative difference of a pair; `sigma`: its standard deviation up to a
/// factor determined by the other pairs.
fn find_equally_apart(
    pairs: &[usize],
    apart: impl Fn(usize) -> f64,
    sigma: impl Fn(usize) -> f64,
) -> Vec<usize> {
    let z = |i: usize| apart(i) / sigma(i);
    let of_sign = |sign: f64| {
        let mut order: Vec<usize> = pairs.to_vec();
        order.sort_by(|a, b| (sign * z(*b)).total_cmp(&(sign * z(*a))));
        let most = (MAX_SHARE_OF_PAIRS * order.len() as f64) as usize;
        (MIN_PAIRS_ALIKE..=most).rev().find_map(|k| {
            let (found, rest) = order.split_at(k);
            let scale = (rest.iter().map(|&i| z(i).powi(2)).sum::<f64>() / rest.len() as f64).sqrt();
            let largest_of_rest = rest.iter().map(|&i| z(i).abs()).fold(0.0, f64::max);
            let least = (MIN_SIGMAS_OF_EACH * scale).max(MIN_RATIO_TO_OTHERS * largest_of_rest);
            let weight = |i: usize| (scale * sigma(i)).powi(-2);
            let weigh = |sets: &[usize]| {
                let all: f64 = sets.iter().map(|&i| weight(i)).sum();
                (sets.iter().map(|&i| weight(i) * apart(i)).sum::<f64>() / all, all.sqrt().recip())
            };
            let ((mean, std), (mean_of_rest, std_of_rest)) = (weigh(found), weigh(rest));
            let is_alike = |i: &usize| (apart(*i) - mean).abs() < MAX_SIGMAS_FROM_MEAN * scale * sigma(*i);
            let are_apart = found.iter().all(|&i| sign * z(i) > least) && found.iter().all(is_alike);
            let is_large = mean.abs() > MIN_RELATIVE_DIFFERENCE.max(MIN_SIGMAS * std);
            // A warming lamp, and lag, continue in the other pairs.
            let goes_on = mean_of_rest.abs() > MAX_SIGMAS_OF_OTHERS * std_of_rest;
            (are_apart && is_large && !goes_on).then(|| found.to_vec())
        })
    };
    let mut found = of_sign(1.0).or_else(|| of_sign(-1.0)).unwrap_or_default();
    found.sort_unstable();
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// False alarms in 2000 campaigns of 18 pairs under 0.2 % flicker: two at most, and one in 100 if
    /// single frames are far off. Four pairs that lack seven standard deviations are found in four of
    /// five.
    #[test]
    fn pairs_that_differ_alike_are_found() {
        let of = |seed: u64, kind: u64, off: f64| {
            let draw = |i: usize| {
                let mut rng = PixelRng::new(seed, Stream::Effect, kind, i as u32, 0);
                let own = match kind {
                    0 => rng.normal(),
                    // Ripple at a random phase per frame, and a lamp with occasional large deviations.
                    1 => (std::f64::consts::TAU * rng.uniform()).sin() * 2f64.sqrt(),
                    _ => rng.normal() * if rng.uniform() < 0.1 { 5.0 } else { 1.0 },
                };
                0.002 * (own - if (4..8).contains(&i) { off } else { 0.0 })
            };
            let apart: Vec<f64> = (0..18).map(draw).collect();
            find_equally_apart(&(0..18).collect::<Vec<_>>(), |i| apart[i], |_| 0.002)
        };
        for (kind, most) in [(0, 2), (1, 0), (2, 20)] {
            let accused = (0..2000).filter(|s| !of(*s, kind, 0.0).is_empty()).count();
            assert!(accused <= most, "{kind}: {accused}");
        }
        let found: Vec<_> = (0..500).map(|s| of(s, 0, 7.0)).filter(|f| !f.is_empty()).collect();
        let right = found.iter().filter(|f| **f == [4, 5, 6, 7]).count();
        assert!(right > 400 && found.len() - right < 15, "{right} of {}", found.len());
    }

    /// Lamp that warms up by 5 % over 8 of 100 frames and flickers by 0.1 %: the first pairs differ more
    /// than all others, but are not a fault.
    #[test]
    fn a_lamp_that_warms_up_is_no_slip() {
        let of = |seed: u64| {
            let light = |frame: usize| {
                let mut rng = PixelRng::new(seed, Stream::Effect, 9, frame as u32, 0);
                1.0 - 0.05 * (-(frame as f64) / 8.0).exp() + 0.001 * rng.normal()
            };
            let apart: Vec<f64> = (0..50).map(|i| light(2 * i + 1) - light(2 * i)).collect();
            find_equally_apart(&(0..50).collect::<Vec<_>>(), |i| apart[i], |_| 0.0014)
        };
        let accused = (0..200).filter(|s| !of(*s).is_empty()).count();
        assert!(accused <= 2, "{accused}");
    }
}
