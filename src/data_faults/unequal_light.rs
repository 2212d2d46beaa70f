//! Two frames of a set, or sets of equal settings, under unequal light.

use super::{Campaign, Check, DataFault, FaultKind, setting_label};
use crate::number::percent;
use crate::statistics::median::median;

/// Deviations over their usual scatter from which on light is unequal.
const MIN_SIGMAS: f64 = 8.0;
/// Least difference in light, over the signal: lamps that are left alone stay within it (a named choice).
const MIN_RELATIVE_DIFFERENCE: f64 = 0.005;
/// The same for each of several pairs that differ alike; chance brings one of 16000 that far.
const MIN_SIGMAS_OF_EACH: f64 = 4.0;
/// Standard deviations within which such pairs differ alike.
const ALIKE_SIGMAS: f64 = 3.0;
/// Share of the sets up to which unequal pairs are slips: more are what the lamp does.
const MAX_SHARE_OF_PAIRS: f64 = 0.5;

/// The check.
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
            // Nobody knows what came before the first set, and the rest is known to a fifth.
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
            unequal = equally_apart(&pairs, |i| apart(i) / signal(i), |i| sigma(i) / signal(i));
            unequal.retain(|&i| is_large(i));
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
        // Equal settings. With a law of the levels the stray one among them is told.
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

/// Pairs that differ by the same share in the same direction, where a single one is too little to be said.
fn equally_apart(pairs: &[usize], apart: impl Fn(usize) -> f64, sigma: impl Fn(usize) -> f64) -> Vec<usize> {
    let is_apart = |i: &usize| apart(*i).abs() > MIN_SIGMAS_OF_EACH * sigma(*i);
    let found: Vec<usize> = pairs.iter().copied().filter(is_apart).collect();
    let weight = |i: usize| sigma(i).powi(-2);
    let all: f64 = found.iter().map(|&i| weight(i)).sum();
    let mean = found.iter().map(|&i| weight(i) * apart(i)).sum::<f64>() / all;
    let are_alike = found.iter().all(|&i| (apart(i) - mean).abs() < ALIKE_SIGMAS * sigma(i));
    let is_said = found.len() > 1 && are_alike && mean.abs() > MIN_SIGMAS / all.sqrt();
    if is_said { found } else { Vec::new() }
}
