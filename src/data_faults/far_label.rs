//! A flat whose level is that of another order of exposure or light: `30us` for 30 ms. So far from the others a
//! label bends any law that is fitted to them.

use super::transfer::{Transfer, above};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::number::six_digits;
use crate::statistics::median::median;

/// Least factor between the stated light and that of the level (a named choice).
const MIN_FACTOR: f64 = 3.0;
/// Largest factor by which the other flats are off the proportion to their light, an offset or a bend (a named
/// choice).
const MAX_FACTOR_OF_OTHERS: f64 = 1.3;
/// Least number of the others.
const MIN_OTHERS: usize = 3;
/// Largest share of the flats that have such labels.
const MAX_SHARE: f64 = 0.25;
/// Least signal of a flat, DN and over the brightest: dimmer ones are off by what is wrong with the zero.
const MIN_SIGNAL_DN: f64 = 20.0;
const MIN_REL_SIGNAL: f64 = 0.02;

/// Largest logarithm of the variance over that of the level, at which the noise is that of the level.
const MAX_NOISE_OFFSET: f64 = 0.4;

/// The check.
pub struct FarLabel;

impl Check for FarLabel {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_one_bench()) else { return Vec::new() };
        let lit = campaign.places(|s| s.is_lit() && !s.clipped);
        let signal = |i: usize| above(campaign, &zero, i);
        let brightest = lit.iter().map(|&i| signal(i)).fold(0.0, f64::max);
        let least = MIN_SIGNAL_DN.max(MIN_REL_SIGNAL * brightest);
        let lit: Vec<usize> = lit.into_iter().filter(|&i| signal(i) > least).collect();
        let light = |i: usize| campaign.sets[i].exposure_s * campaign.sets[i].illumination;
        let ratio = |i: usize| signal(i) / light(i);
        let usual = median(lit.iter().map(|&i| ratio(i)));
        let factor = |i: usize| ratio(i) / usual;
        let is_off = |i: usize, most: f64| factor(i).max(factor(i).recip()) > most;
        let (far, others): (Vec<usize>, Vec<usize>) = lit.iter().partition(|&&i| is_off(i, MIN_FACTOR));
        let are_few = far.len() as f64 <= MAX_SHARE * lit.len() as f64;
        if !are_few || others.len() < MIN_OTHERS || others.iter().any(|&i| is_off(i, MAX_FACTOR_OF_OTHERS)) {
            return Vec::new();
        }
        let exposures_vary =
            others.iter().any(|&i| campaign.sets[i].exposure_s != campaign.sets[others[0]].exposure_s);
        // Another gain makes the noise grow with the level.
        let transfer = Transfer::of(campaign, &zero, &far);
        let is_noise_of_level = |i: &usize| {
            let off = transfer.as_ref().and_then(|t| t.off(campaign, *i, signal(*i)));
            off.is_none_or(|(off, _)| off.abs() < MAX_NOISE_OFFSET)
        };
        let found: Vec<(usize, String)> = far
            .into_iter()
            .filter(is_noise_of_level)
            .map(|i| {
                let set = &campaign.sets[i];
                let (what, stated, unit) = if campaign.light_is_in_photons() {
                    ("stated", light(i), " photons")
                } else if exposures_vary {
                    ("stated exposure", set.exposure_s, " s")
                } else {
                    ("stated light", set.illumination, "")
                };
                let text = format!(
                    "set {} ({}): {what} {}{unit}, its level belongs to {}{unit}",
                    set.number,
                    campaign.file(i, 0),
                    six_digits(stated),
                    six_digits(stated * factor(i))
                );
                (i, text)
            })
            .collect();
        found
            .into_iter()
            .map(|(i, text)| campaign.fault_of_sets(FaultKind::SettingLabel, &[i], text, true))
            .collect()
    }
}
