//! Flats whose fixed pattern differs from the other flats: turned, shifted by a row, filtered, or from
//! another camera. A calibration from both makes frames worse.

use super::patterns::{Noise, moved_by, noise_of_mean, pattern_of, share};
use super::{Campaign, Check, DataFault, FaultKind};

/// Minimum fraction of the brightest flat's pattern in a flat with the same pattern, and standard
/// deviations to that.
const MIN_SHARE: f64 = 0.6;
const MIN_SIGMAS: f64 = 8.0;
/// Maximum standard error of a usable flat.
const MAX_STD_ERR: f64 = 0.1;
/// Maximum distance from the fractions that another black level causes, standard deviations, and minimum
/// error of a fraction (named choices).
const MIN_SIGMAS_OF_ZERO: f64 = 4.0;
const MIN_STD_ERR: f64 = 0.02;
/// Minimum number of flats of one position of card and light among which one can differ.
const MIN_FLATS: usize = 4;

/// Check for another pattern.
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

/// Returns flats with another pattern than most, and a description.
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
    let (mut same, mut other, mut parts) = (Vec::new(), Vec::new(), Vec::new());
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
        parts.push((level(i), part, std));
        if part > MIN_SHARE {
            same.push(i);
        } else if 1.0 - part > MIN_SIGMAS * std {
            other.push(i);
        }
    }
    if other.is_empty() || is_of_another_zero(&parts, level(reference)) {
        return None;
    }
    let first = pattern(other[other.len() / 2]);
    let how = moved_by(&first, &of_reference, noise, columns, MIN_SIGMAS);
    // Full wells change the pattern of the brightest; dimmer flats with their own pattern are from
    // another camera, and so are the bright ones that share it.
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

/// Returns true if a black level other than that of the darks explains the fractions: the pattern in a
/// flat then decreases towards dim ones with the fraction of light in the level. Entries are (level in
/// DN, fraction of the reference pattern, standard error).
fn is_of_another_zero(parts: &[(f64, f64, f64)], reference_dn: f64) -> bool {
    let expected = |level_dn: f64, zero_dn: f64| (1.0 - zero_dn / level_dn) / (1.0 - zero_dn / reference_dn);
    // The dimmest flat determines the black level.
    let Some(&(level_dn, part, _)) = parts.iter().min_by(|a, b| a.0.total_cmp(&b.0)) else { return false };
    let zero_dn = (1.0 - part) / (1.0 / level_dn - part / reference_dn);
    let others = || parts.iter().filter(|p| p.0 > level_dn && p.0 < reference_dn);
    let told = others().any(|p| (1.0 - expected(p.0, zero_dn)).abs() > MIN_SIGMAS_OF_ZERO * p.2);
    told && others().all(|p| (p.1 - expected(p.0, zero_dn)).abs() < MIN_SIGMAS_OF_ZERO * p.2.max(MIN_STD_ERR))
}

#[cfg(test)]
mod tests {
    use super::is_of_another_zero;

    /// Black level 180 DN higher in the flats; and two filtered dim flats.
    #[test]
    fn another_zero_is_no_other_pattern() {
        let levels = [240.0, 290.0, 380.0, 600.0, 840.0, 1800.0];
        let of_zero = |dn: f64| (dn, (1.0 - 180.0 / dn) / (1.0 - 180.0 / 1800.0), 0.02);
        assert!(is_of_another_zero(&levels.map(of_zero), 1800.0));
        let filtered = |dn: f64| (dn, if dn < 300.0 { 0.4 } else { 1.0 }, 0.02);
        assert!(!is_of_another_zero(&levels.map(filtered), 1800.0));
        assert!(!is_of_another_zero(&levels.map(|dn| (dn, 1.0, 0.02)), 1800.0));
    }
}
