//! Darks of one setting and one fixed pattern of which some have far less noise: these were averaged.
//! Averaging preserves the pattern, which another gain would scale.

use super::dependent_frames::MIN_PATTERN_CORRELATION;
use super::orientation::{correlation, pattern};
use super::transfer::{MIN_VARIANCE_DN2, variance_error};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;

/// Maximum ratio of the variances of an averaged dark: two frames make it a half, and rounding adds a
/// twelfth of a squared code to both.
const MAX_VARIANCE_RATIO: f64 = 0.6;
/// Minimum significance of a ratio below 1, standard errors.
const MIN_SIGMAS: f64 = 10.0;
/// Maximum ratio of the pattern amplitudes of darks of one gain (a named choice).
const MAX_PATTERN_RATIO: f64 = 1.25;

/// Check for averaged darks among equal ones.
pub struct EqualDarks;

impl Check for EqualDarks {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let darks = campaign.places(|s| s.kind == Kind::Dark && !s.clipped && !s.is_cut_off());
        let exposure_s = |i: usize| campaign.sets[i].exposure_s;
        // Each with a noisier dark of the same setting and pattern.
        let mut averaged: Vec<(usize, usize)> = Vec::new();
        for &i in &darks {
            let equals = || darks.iter().copied().filter(|&d| exposure_s(d) == exposure_s(i));
            let noisier: Vec<usize> = equals().filter(|&d| is_quieter(campaign, i, d)).collect();
            // A single noisy dark among many does not make the others suspect.
            if 2 * noisier.len() >= equals().count() {
                let same = noisier.into_iter().find(|&d| are_of_one_gain(campaign, i, d));
                averaged.extend(same.map(|d| (i, d)));
            }
        }
        let Some(&(first, usual)) = averaged.first() else { return Vec::new() };
        // Noise does not fall with exposure: a longer dark with less noise was averaged too.
        let is_longer = |i: &usize| {
            let is_known = averaged.iter().any(|(own, other)| own == i || other == i);
            let is_beyond = |d: usize| exposure_s(*i) > exposure_s(d) && is_quieter(campaign, *i, d);
            !is_known && averaged.iter().any(|(_, other)| is_beyond(*other))
        };
        let longer = darks.iter().copied().filter(is_longer);
        let mut sets: Vec<usize> = averaged.iter().map(|a| a.0).chain(longer).collect();
        sets.sort_unstable();
        let variance = |i: usize| campaign.sets[i].variance_dn2().map_or(f64::NAN, |v| v.0);
        let text = format!(
            "{}: frames were averaged before they were saved: variance of set {} is {} of that of set {}, a dark of the same setting and pattern",
            campaign.named(&sets),
            campaign.sets[first].number,
            six_digits((variance(first) / variance(usual) * 1000.0).round() / 1000.0),
            campaign.sets[usual].number
        );
        vec![campaign.fault_of_sets(FaultKind::DependentFrames, &sets, text, true)]
    }
}

/// Returns true if a dark has far less noise than another whose noise is not dominated by rounding.
fn is_quieter(campaign: &Campaign<'_>, own: usize, other: usize) -> bool {
    let of = |i: usize| {
        campaign.sets[i].variance_dn2().map(|(var, pairs)| (var, variance_error(campaign, i, pairs)))
    };
    of(own).zip(of(other)).is_some_and(|((own, own_std), (other, other_std))| {
        own > 0.0
            && own < MAX_VARIANCE_RATIO * other
            && other > MIN_VARIANCE_DN2
            && (other / own).ln() > MIN_SIGMAS * own_std.hypot(other_std)
    })
}

/// Returns true if the fixed patterns of two darks have one amplitude: regression of one on the other,
/// corrected for the noise of the other (attenuation by errors in variables: Fuller 1987, section 1.1).
fn are_of_one_gain(campaign: &Campaign<'_>, own: usize, other: usize) -> bool {
    let of = |i: usize| pattern(&campaign.sets[i].facts.middle_dn, campaign.sets[i].facts.middle_columns);
    let (a, b) = (of(own), of(other));
    let Some((var, _)) = campaign.sets[other].variance_dn2() else { return false };
    let noise = var / campaign.sets[other].frames() as f64;
    let square = b.iter().map(|v| v * v).sum::<f64>() - noise * b.len() as f64;
    let product: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
    let ratio = product / square;
    correlation(&a, &b) > MIN_PATTERN_CORRELATION && ratio.max(ratio.recip()) < MAX_PATTERN_RATIO
}
