//! Long-exposure noise reduction: above some exposure the camera captures a dark after each frame and
//! subtracts it. Such frames have the noise of two darks, but no dark charge and none of its fixed
//! pattern.

use super::patterns::{Noise, noise_of_mean, pattern_of, share};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;

/// Variance ratio of a difference of two darks to one, and maximum relative deviation from it (a named
/// choice).
const OF_TWO: f64 = 2.0;
const MAX_DEVIATION: f64 = 0.2;
/// Maximum fraction of the shorter darks' pattern, including two standard errors, in a longer dark that
/// has lost it (a named choice).
const MAX_SHARE: f64 = 0.6;
/// Minimum number of flats that stay.
const MIN_FLATS: usize = 3;

/// Check for subtracted darks.
pub struct SubtractedDarks;

impl Check for SubtractedDarks {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let mut darks = campaign.places(|s| s.kind == Kind::Dark && s.has_pattern() && !s.is_cut_off());
        if !campaign.is_of_one_part() || !campaign.are_of_one_size(darks.iter()) {
            return Vec::new();
        }
        let exposure = |i: usize| campaign.sets[i].exposure_s;
        darks.sort_by(|a, b| exposure(*a).total_cmp(&exposure(*b)));
        let parts = (1..darks.len()).map(|k| darks.split_at(k));
        let mut parts =
            parts.filter(|(shorter, longer)| exposure(shorter[shorter.len() - 1]) < exposure(longer[0]));
        let found = parts.find_map(|(shorter, longer)| {
            let ratios: Option<Vec<f64>> = longer.iter().map(|i| of_two(campaign, shorter, *i)).collect();
            ratios.map(|ratios| (longer, ratios[0]))
        });
        let Some((longer, ratio)) = found else { return Vec::new() };
        let from_s = exposure(longer[0]);
        let flats = campaign.places(|s| s.is_lit() && s.exposure_s < from_s);
        if flats.len() < MIN_FLATS {
            return Vec::new();
        }
        let sets = campaign.places(|s| s.exposure_s >= from_s && (s.kind == Kind::Dark || s.is_lit()));
        let text = format!(
            "{}: from {} s on the camera takes a dark frame off each frame (noise reduction of long exposures): the dark of set {} has {} times \
             the variance of shorter ones, no more level and none of their fixed pattern",
            campaign.named(&sets),
            six_digits(from_s),
            campaign.sets[longer[0]].number,
            six_digits((100.0 * ratio).round() / 100.0)
        );
        vec![campaign.fault_of_sets(FaultKind::OtherSettings, &sets, text, true)]
    }
}

/// Returns the ratio of the variance of a dark to that of one frame at its exposure, predicted by the
/// shorter darks; `None` unless it is the difference of two frames.
fn of_two(campaign: &Campaign<'_>, shorter: &[usize], longer: usize) -> Option<f64> {
    let set = |i: usize| &campaign.sets[i];
    let own_dn2 = set(longer).variance_dn2()?.0;
    let variances: Vec<(f64, f64)> = shorter
        .iter()
        .map(|i| set(*i).variance_dn2().map(|v| (set(*i).exposure_s, v.0)))
        .collect::<Option<_>>()?;
    let last = variances[variances.len() - 1];
    let first = variances[0];
    // The noise of the charge grows with exposure.
    let growth = if last.0 > first.0 { ((last.1 - first.1) / (last.0 - first.0)).max(0.0) } else { 0.0 };
    let ratio = own_dn2 / (last.1 + growth * (set(longer).exposure_s - last.0));
    let nearest = *shorter.last()?;
    let is_no_higher = set(longer).level_dn() < set(nearest).level_dn() + campaign.dark_scatter_dn();
    if !is_no_higher || (ratio / OF_TWO - 1.0).abs() > MAX_DEVIATION {
        return None;
    }
    let columns = set(nearest).facts.middle_columns;
    let noise = Noise::of_darks(noise_of_mean(set(nearest)));
    let (part, std) = share(&pattern_of(set(longer)), &pattern_of(set(nearest)), noise, columns)?;
    (part.abs() + 2.0 * std < MAX_SHARE).then_some(ratio)
}
