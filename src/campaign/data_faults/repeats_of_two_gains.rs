//! Another gain at one position of card and light: its flats repeat the settings of others, with the
//! noise of another gain.
//!
//! The noise variance of a flat scales with the square of a gain on the codes, in any light (Healey and
//! Kondepudy 1994, eq. 35: sigma_N^2 = A^2 (I + E_DC) + sigma_C^2), and its level with the gain, plus
//! the same factor on the black level if the codes include it. Under other light the noise is that of
//! its level.

use super::transfer::{above, variance_error};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::with_error;
use crate::statistics::median::median;
use std::collections::BTreeMap;

/// Minimum change of the gain that is reported (a named choice).
const MIN_GAIN_RATIO: f64 = 1.08;
/// Maximum difference between level and noise, relative to the change (a named choice).
const MAX_DIFFERENCE: f64 = 0.15;
/// Minimum change of the variance's logarithm, standard errors.
const MIN_SIGMAS: f64 = 8.0;
/// Minimum significance that the noise is not that of other light, standard errors.
const MIN_SIGMAS_OFF_LIGHT: f64 = 5.0;
/// Minimum number of other positions that repeat a setting: of two alone it is unknown which one
/// differs.
const MIN_OTHERS: usize = 2;

/// Check for repeats of two gains.
pub struct RepeatsOfTwoGains;

impl Check for RepeatsOfTwoGains {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_of_one_part()) else { return Vec::new() };
        let darks = campaign.places(|s| s.kind == Kind::Dark && !s.clipped);
        let dark_dn2 = median(darks.iter().filter_map(|&i| campaign.sets[i].variance_dn2().map(|v| v.0)));
        let flats = campaign.places(|s| s.is_lit() && !s.clipped && !s.is_cut_off());
        let mut of_setting: BTreeMap<(u64, u64), Vec<usize>> = BTreeMap::new();
        for i in flats {
            let s = &campaign.sets[i];
            of_setting.entry((s.exposure_s.to_bits(), s.illumination.to_bits())).or_default().push(i);
        }
        // Gain changes by position of card and light; `None` for a flat without one.
        let mut gains: BTreeMap<u32, Vec<Option<(f64, f64)>>> = BTreeMap::new();
        for repeats in of_setting.into_values() {
            for &i in &repeats {
                let own = campaign.sets[i].configuration;
                let others: Vec<usize> =
                    repeats.iter().copied().filter(|d| campaign.sets[*d].configuration != own).collect();
                if others.len() < MIN_OTHERS {
                    continue;
                }
                let Some((own_dn2, pairs)) = campaign.sets[i].variance_dn2() else { continue };
                let noises: Vec<f64> =
                    others.iter().filter_map(|d| campaign.sets[*d].variance_dn2().map(|v| v.0)).collect();
                let most = noises.iter().fold(0.0, |a: f64, b| a.max(*b));
                let least = noises.iter().fold(f64::INFINITY, |a, b| a.min(*b));
                let others_dn2 = median(noises.into_iter());
                let is_one_gain = most < MIN_GAIN_RATIO.powi(2) * least;
                let level_dn = median(others.iter().map(|d| above(campaign, &zero, *d)));
                let ratio_of_levels = above(campaign, &zero, i) / level_dn;
                // Level, with the black level in the codes scaled by the same factor.
                let with_black = (above(campaign, &zero, i) + zero.dn) / (level_dn + zero.dn);
                let change = 0.5 * (own_dn2 / others_dn2).ln();
                let std = 0.5 * 2f64.sqrt() * variance_error(campaign, i, pairs);
                // The shot noise of other light is proportional to the level.
                let of_light = dark_dn2 + (others_dn2 - dark_dn2).max(0.0) * ratio_of_levels.max(0.0);
                let off_light = 0.5 * (own_dn2 / of_light).ln();
                let is_so = |ratio: f64| (ratio.ln() - change).abs() < MAX_DIFFERENCE * change.abs();
                let is_gain = is_one_gain
                    && change.abs() > MIN_GAIN_RATIO.ln().max(MIN_SIGMAS * std)
                    && off_light.abs() > MIN_SIGMAS_OFF_LIGHT * std
                    && (is_so(ratio_of_levels) || is_so(with_black));
                gains.entry(own).or_default().push(is_gain.then_some((change, std)));
            }
        }
        let mut out = Vec::new();
        for (configuration, said) in gains {
            let Some(all) = said.into_iter().collect::<Option<Vec<_>>>() else { continue };
            let sets = campaign.places(|s| s.is_lit() && s.configuration == configuration);
            let ratio = median(all.iter().map(|c| c.0)).exp();
            let std = ratio * all.iter().map(|c| c.1).fold(f64::INFINITY, f64::min);
            let text = format!(
                "{}: another gain than the flats of the same settings in the other configurations, {} times theirs: level and noise both say so",
                campaign.named(&sets),
                with_error(ratio, std)
            );
            out.push(campaign.fault_of_sets(FaultKind::OtherSettings, &sets, text, true));
        }
        out
    }
}
