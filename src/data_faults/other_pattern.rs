//! Flats whose fixed pattern is not that of the other flats: turned, shifted by a row, filtered, or of
//! another camera. A calibration made of both makes frames worse.

use super::patterns::{Noise, moved_by, noise_of_mean, pattern_of, share};
use super::{Campaign, Check, DataFault, FaultKind};

/// Share of the pattern of the brightest flat from which on a flat has it, and standard deviations to that.
const MIN_SHARE: f64 = 0.6;
const MIN_SIGMAS: f64 = 8.0;
/// Standard error from which on a flat does not tell.
const MAX_STD_ERR: f64 = 0.1;
/// Flats of one position of card and light below which none is another.
const MIN_FLATS: usize = 4;

/// The check.
pub struct OtherPattern;

impl Check for OtherPattern {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_of_one_part()) else { return Vec::new() };
        let mut out = Vec::new();
        for mut flats in campaign.flats_by_field().into_values() {
            flats.retain(|&i| !campaign.is_rounded(&campaign.sets[i]));
            if flats.len() < MIN_FLATS {
                continue;
            }
            if let Some((sets, how)) = odd_ones(campaign, &flats, zero.dn) {
                let text = format!("{}: {how}", campaign.named(&sets));
                out.push(campaign.fault_of_sets(FaultKind::OtherSettings, &sets, text, true));
            }
        }
        out
    }
}

/// Flats with another pattern than most, and what it is.
fn odd_ones(campaign: &Campaign<'_>, flats: &[usize], zero_dn: f64) -> Option<(Vec<usize>, String)> {
    if !campaign.are_of_one_size(flats.iter()) {
        return None;
    }
    let columns = campaign.sets[flats[0]].facts.middle_columns;
    let level = |i: usize| campaign.sets[i].level_dn() - zero_dn;
    // Patterns relative to the level are those of the response.
    let pattern = |i: usize| -> Vec<f64> {
        pattern_of(&campaign.sets[i]).into_iter().map(|v| v / level(i).max(1.0)).collect()
    };
    let reference = *flats.iter().max_by(|a, b| level(**a).total_cmp(&level(**b)))?;
    let of_reference = pattern(reference);
    let noise = Noise::of_flats(noise_of_mean(&campaign.sets[reference]) / level(reference).powi(2).max(1.0));
    let (mut same, mut other) = (Vec::new(), Vec::new());
    for &i in flats {
        let own = pattern(i);
        let Some((part, std)) = share(&own, &of_reference, noise, columns).filter(|s| s.1 < MAX_STD_ERR)
        else {
            continue;
        };
        tracing::debug!(
            "set {}: {part:.3} +- {std:.3} of the pattern of set {}",
            campaign.sets[i].number,
            campaign.sets[reference].number
        );
        if part > MIN_SHARE {
            same.push(i);
        } else if 1.0 - part > MIN_SIGMAS * std {
            other.push(i);
        }
    }
    if other.is_empty() {
        return None;
    }
    let first = pattern(other[other.len() / 2]);
    let how = moved_by(&first, &of_reference, noise, columns, MIN_SIGMAS);
    // Full wells end the pattern of the brightest, whatever else is there; dimmer flats of a pattern of their own
    // are of another camera, and the bright ones that share it.
    let (dim, bright): (Vec<usize>, Vec<usize>) =
        other.iter().copied().partition(|o| level(*o) < 0.9 * level(reference));
    let shares_it = |o: &usize| {
        let noise = Noise::of_flats(noise_of_mean(&campaign.sets[*o]) / level(*o).powi(2).max(1.0));
        dim.iter().all(|d| share(&pattern(*d), &pattern(*o), noise, columns).is_some_and(|s| s.0 > MIN_SHARE))
    };
    let below =
        same.iter().any(|s| dim.iter().any(|o| level(*o) < level(*s))) && bright.iter().all(shares_it);
    let (odd, text) = match how {
        Some(how) => (
            if other.len() > same.len() { same } else { other },
            format!("{how} against the other flats by the fixed pattern"),
        ),
        None if below && same.len() > 1 && other.len() <= same.len() => (
            other,
            "the fixed pattern of these flats is not that of the others: filtered or binned in the camera, or of another camera"
                .into(),
        ),
        None => return None,
    };
    Some((odd, text))
}
