//! Light in the darks: dim flats labelled as darks, or a leaking cap. The darks then contain the
//! PRNU, in proportion to their light.
//!
//! The response of each pixel is its slope over the levels of the flats (Healey and Kondepudy 1994, eq.
//! 22); the regression of a dark's pattern on it is the light, DN. If the black level has the same
//! pattern, as with column gains, it is not light: the darks would have to be brighter than they are.

use super::campaign::Zero;
use super::patterns::{Line, Noise, Sums, WithError, by_blocks, combined, pattern_of, share};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::with_error;
use crate::statistics::quantisation::SMALLEST_DARK_DN2;

/// Minimum significance of the light, standard deviations, and minimum light that is reported, DN.
const MIN_LIGHT: (f64, f64) = (8.0, 3.0);
/// Maximum relative difference between the light in a dark and its level above black, for all of
/// the level to be light (exposure sweeps).
const SAME: f64 = 0.25;
/// Minimum level of such a dark, relative to the flats' range; also the minimum light in the
/// brightest dark if fewer than half of the darks are lit.
const LARGE: f64 = 0.01;
/// Minimum fraction of the flats' light that is reported, and minimum significance, standard deviations.
const MIN_LEAK: (f64, f64) = (0.003, 6.0);
/// Minimum significance of a smaller leak, standard deviations.
const MIN_EVEN_LEAK: f64 = 4.0;
/// Range of a smaller leak's light, relative to the growth of the darks with exposure.
const PART_OF_GROWTH: std::ops::Range<f64> = 0.5..1.5;
/// Maximum spread of the dark current over the pixels for a smaller leak, relative to that growth.
/// Dark current usually varies more. If it does not, it follows the pixel gains and looks like
/// light (named choices).
const MAX_EVEN_SPREAD: f64 = 0.06;
/// Maximum excess of the light of a leak over the growth of the darks, standard deviations.
const POSSIBLE_SIGMAS: f64 = 2.0;
/// Maximum difference between the first and last frame of a dark, relative to the light: carry-over
/// decays.
const MAX_FADING: f64 = 0.3;
/// Minimum difference of first and last frame of a fading dark, DN.
const FADES_DN: f64 = 0.5;
/// Maximum ratio of the light in a dark to the dark's level above black.
const MAX_OF_LEVEL: f64 = 1.3;
/// Maximum ratio of a dark's level to the dimmest flat's. A brighter dark is reported only if all
/// of its level is light; else it may be exchanged with a flat.
const AS_DIM: f64 = 1.05;
/// Minimum ratio of the brightest to the dimmest flat's level, above the darkest dark.
const MIN_RANGE: f64 = 1.5;
/// Maximum relative deviation of the light from proportionality to exposure, for a leaking cap.
const GROWS: f64 = 0.3;
/// Check for light in darks.
pub struct LightInDarks;

/// Light found in a dark.
struct Lit {
    set: usize,
    light_dn: WithError,
    /// True if the light is certain.
    sure: bool,
}

impl Check for LightInDarks {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let darks = campaign.places(|s| s.kind == Kind::Dark && s.has_pattern());
        let flats = campaign.flats_by_field().into_values().max_by_key(Vec::len).unwrap_or_default();
        let alike = campaign.is_of_one_part() && campaign.are_of_one_size(darks.iter().chain(&flats));
        let Some(zero) = campaign.zero().filter(|_| alike && flats.len() > 1) else { return Vec::new() };
        let Some(all) = lights(campaign, &darks, &flats, &zero) else { return Vec::new() };
        let lit: Vec<&Lit> = all.iter().filter(|l| l.sure).collect();
        let brightest = lit.iter().max_by(|a, b| a.light_dn.0.total_cmp(&b.light_dn.0));
        let range = flats.iter().map(|&i| campaign.sets[i].level_dn()).fold(0.0, f64::max) - zero.dn;
        let Some(most) = brightest.filter(|l| 2 * lit.len() >= darks.len() || l.light_dn.0 > LARGE * range)
        else {
            return leak(campaign, &darks, &flats);
        };
        // A leak grows with exposure in all darks and vanishes at zero exposure.
        let exposure_s = |i: usize| campaign.sets[i].exposure_s;
        let per_s = most.light_dn.0 / exposure_s(most.set);
        let several = darks.iter().any(|&i| exposure_s(i) < 0.7 * exposure_s(most.set));
        let grows = |l: &Lit| {
            let expected = per_s * exposure_s(l.set);
            (l.light_dn.0 - expected).abs() < GROWS * expected + 3.0 * l.light_dn.1
        };
        let leaks = several && all.len() == darks.len() && all.iter().all(grows);
        let sets: Vec<usize> = lit.iter().map(|l| l.set).collect();
        let text = format!(
            "{}: stated dark, and the response of the pixels to light is in them, as of {} DN of light in set {}: {}",
            campaign.named(&sets),
            with_error(most.light_dn.0, most.light_dn.1),
            campaign.sets[most.set].number,
            if leaks {
                "a cap that leaks; what grows with their exposure is light and no dark current"
            } else {
                "a cap that leaks, or dim flats"
            }
        );
        vec![campaign.fault_of_sets(FaultKind::KindLabel, &sets, text, !leaks)]
    }
}

/// Returns the light of every dark from the flats' response; `None` if the flats do not determine it.
fn lights(campaign: &Campaign<'_>, darks: &[usize], flats: &[usize], zero: &Zero) -> Option<Vec<Lit>> {
    let columns = campaign.sets[flats[0]].facts.middle_columns;
    let x: Vec<f64> = flats.iter().map(|&i| campaign.sets[i].level_dn()).collect();
    let dimmest = x.iter().copied().fold(f64::INFINITY, f64::min);
    let brightest = x.iter().copied().fold(0.0, f64::max);
    let lowest = darks.iter().map(|&i| campaign.sets[i].level_dn()).fold(dimmest, f64::min);
    let (response, noise_dn2) = combined(campaign, flats, &Line::of(campaign, flats, &x)?.slope);
    if brightest - lowest < MIN_RANGE * (dimmest - lowest) {
        return None;
    }
    let noise = Noise::of_flats(noise_dn2);
    let black_dn = campaign.black_of(flats).unwrap_or(zero.dn).min(zero.dn);
    let exposure_s = |i: usize| campaign.sets[i].exposure_s;
    let longest_s = flats.iter().map(|&i| exposure_s(i)).fold(0.0, f64::max);
    let at_one_exposure = flats.iter().all(|&i| (exposure_s(i) / exposure_s(flats[0]) - 1.0).abs() < 1e-6);
    let light = |&i: &usize| {
        let set = &campaign.sets[i];
        let (light_dn, std) = share(&pattern_of(set), &response, noise, columns)?;
        let above_dn = set.level_dn() - black_dn;
        tracing::debug!(
            "set {}: {light_dn:.3} +- {std:.3} DN of light in a dark of {above_dn:.3} DN",
            set.number
        );
        let means = set.means_dn();
        let fading = means.first().zip(means.last()).map_or(0.0, |(a, b)| (a - b).abs());
        // Slopes over longer exposures include the dark-current pattern, which a dark contains with just
        // the amount of its level only by coincidence.
        let is_its_level = || {
            (light_dn / above_dn - 1.0).abs() < SAME
                && above_dn > LARGE * (brightest - black_dn)
                && set.exposure_s <= 1.05 * longest_s
        };
        let sure = light_dn > MIN_LIGHT.1.max(MIN_LIGHT.0 * std)
            && (at_one_exposure || is_its_level())
            && fading < MAX_FADING * light_dn
            && light_dn < MAX_OF_LEVEL * above_dn
            && (set.level_dn() < AS_DIM * dimmest || is_its_level());
        Some(Lit { set: i, light_dn: (light_dn, std), sure })
    };
    Some(darks.iter().filter_map(light).collect())
}

/// Finds light that leaks in during dark exposures: their pattern grows with exposure like the response.
/// Darks that fade from frame to frame have carry-over from the flats before them.
fn leak(campaign: &mut Campaign<'_>, darks: &[usize], flats: &[usize]) -> Vec<DataFault> {
    let scatter_dn = campaign.dark_scatter_dn();
    let fades = |i: usize| {
        let means = campaign.sets[i].means_dn();
        means.first().zip(means.last()).is_some_and(|(a, b)| a - b > FADES_DN.max(MIN_LEAK.1 * scatter_dn))
    };
    let darks = &darks.iter().copied().filter(|&i| !fades(i)).collect::<Vec<_>>()[..];
    let line = |sets: &[usize]| {
        let x: Vec<f64> = sets.iter().map(|&i| campaign.sets[i].exposure_s).collect();
        Line::of(campaign, sets, &x)
    };
    // The noise of the darks is measured, including noisy pixels.
    let measured = |sets: &[usize], weights: &[f64]| {
        let own = |(&i, w): (&usize, &f64)| w * w * campaign.sets[i].facts.middle_noise_dn2;
        sets.iter().zip(weights).map(own).sum::<f64>()
    };
    let level = |sets: &[usize], weights: &[f64]| {
        sets.iter().zip(weights).map(|(&i, w)| w * campaign.sets[i].level_dn()).sum::<f64>()
    };
    let first = &campaign.sets[flats[0]];
    let (light, columns) = (first.illumination, first.facts.middle_columns);
    let lit: Vec<usize> = flats.iter().copied().filter(|&i| campaign.sets[i].illumination == light).collect();
    let Some((of_darks, of_flats)) = line(darks).zip(line(&lit)) else { return Vec::new() };
    let (pattern, stated) = combined(campaign, darks, &of_darks.slope);
    let noise = match measured(darks, &of_darks.slope) {
        by_turns if by_turns > 0.0 => Noise::by_turns(by_turns, pattern.len()),
        _ => Noise::of_darks(stated),
    };
    let flat = combined(campaign, &lit, &of_flats.slope);
    let Some((part, std, spread)) = leaked(&pattern, noise, &flat, columns) else { return Vec::new() };
    let (growth, of_light) = (level(darks, &of_darks.slope), level(&lit, &of_flats.slope));
    tracing::debug!(
        "darks have {part:.5} +- {std:.5} of the flats' light, {of_light:.0} DN/s, and grow by {growth:.1} DN/s +- {spread:.1}"
    );
    // Rounding of a quiet dark depends on the fraction of a code, which differs from pixel to pixel.
    let least_dn2 = SMALLEST_DARK_DN2 * campaign.code_step_dn.powi(2);
    let are_quiet = darks.iter().any(|&i| campaign.sets[i].variance_dn2().is_some_and(|v| v.0 < least_dn2));
    let is_growth = !are_quiet
        && PART_OF_GROWTH.contains(&(part * of_light / growth))
        && spread < MAX_EVEN_SPREAD * growth;
    let is_sure = part > MIN_LEAK.0 && part > MIN_LEAK.1 * std || is_growth && part > MIN_EVEN_LEAK * std;
    // More light than the darks grow by is impossible: other flats have other gains, or darks have other
    // exposures.
    let is_possible = part < 1.0 && (part - POSSIBLE_SIGMAS * std) * of_light < growth;
    if !is_sure || !is_possible {
        return Vec::new();
    }
    let text = format!(
        "{}: light leaks into the darks, {} % of that of the flats: their pattern grows with the exposure as the pixels respond to light, \
         and their dark current is too high by that light",
        campaign.named(darks),
        with_error(100.0 * part, 100.0 * std),
    );
    vec![campaign.fault_of_sets(FaultKind::KindLabel, darks, text, false)]
}

/// Returns the fraction of the flats' light in the darks with its error, from the growth of both
/// patterns with exposure, each with its noise; and the spread of the dark current over the pixels.
///
/// The flats grow by R + P, response and dark current (eq. 22), and the darks by e R + P. R and P are
/// uncorrelated, so with the mean products A = (e R + P)(R + P), B = (e R + P)^2 and C = (R + P)^2 the
/// fraction of the light is e = (A - B) / (C - A), and P^2 = (B C - A^2) / (B + C - 2 A).
fn leaked(dark: &[f64], noise: Noise, flat: &(Vec<f64>, f64), columns: usize) -> Option<(f64, f64, f64)> {
    let without_noise = |[a, b, c, n]: Sums| (a, b - n * noise.dn2, c - n * flat.1);
    let of = |sums: &Sums| {
        let (a, b, c) = without_noise(*sums);
        (c - a > 0.3 * c).then(|| (a - b) / (c - a))
    };
    let ((part, std), sums) = by_blocks(dark, &flat.0, columns, of)?;
    let (a, b, c) = without_noise(sums);
    let n = sums[3];
    let spread = ((b * c - a * a) / (b + c - 2.0 * a) / n).max(0.0).sqrt();
    Some((part, std.hypot(noise.rel * n * noise.dn2 / (c - a)), spread))
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// In 300 sensors whose response spreads ten times as much as their dark current, with leaks of 0, 1
    /// and 5 % of the light: the mean agrees within four errors, and the scatter equals the stated error
    /// to a fifth.
    #[test]
    fn the_error_of_a_leak_is_its_scatter() {
        for truth in [0.0, 0.01, 0.05] {
            let z: Vec<f64> = (0..300u32)
                .map(|seed| {
                    let drawn = |what: u64, std: f64, i: u32| {
                        std * PixelRng::new(23, Stream::Frame, what, seed, i).normal()
                    };
                    let growth = |light: f64, what: u64| -> Vec<f64> {
                        let of = |i| light * drawn(0, 10.0, i) + drawn(1, 1.0, i) + drawn(what, 0.5, i);
                        (0..64 * 64).map(of).collect()
                    };
                    let (dark, flat) = ((growth(truth, 2), 0.25), (growth(1.0, 3), 0.25));
                    let of = |sums: &Sums| {
                        let [a, b, c, n] = *sums;
                        Some((a - (b - n * dark.1)) / (c - n * flat.1 - a))
                    };
                    // The noise is known exactly here.
                    let (_, std) = by_blocks(&dark.0, &flat.0, 64, of).unwrap().0;
                    let (part, stated, spread) = leaked(&dark.0, Noise::of_darks(dark.1), &flat, 64).unwrap();
                    assert!(stated >= std && (spread - 1.0).abs() < 0.1, "{spread}");
                    (part - truth) / std
                })
                .collect();
            let n = z.len() as f64;
            let mean = z.iter().sum::<f64>() / n;
            let std = (z.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
            assert!(mean.abs() < 4.0 * std / n.sqrt() && (std - 1.0).abs() < 0.2, "{truth}: {mean} {std}");
        }
    }
}
