//! Light in the darks: dim flats that are called darks, a cap that leaks. What differs from pixel to pixel in the
//! response is then in the darks too, in proportion to their light.
//!
//! The response of each pixel is its slope over the levels of the flats (Healey and Kondepudy 1994, eq. 8); the
//! regression of a dark's pattern on it is the light, DN. A response pattern that a black level has as well, as
//! where columns have gains of their own, is no light: the darks would be brighter than they are.

use super::campaign::SetView;
use super::orientation::flattened;
use super::patterns::{Noise, combined, noise_of_mean, products, share, slope};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::with_error;
use std::collections::BTreeMap;

/// Standard deviations of the light, and least light that is said, DN.
const MIN_LIGHT: (f64, f64) = (8.0, 3.0);
/// Deviation of the light from the level of a dark, relative, and share of the flats' range, from which on it is light
/// in sweeps of the exposure too.
const SAME: f64 = 0.25;
const LARGE: f64 = 0.01;
/// Least share of the flats' light that is said, and standard deviations.
const MIN_LEAK: (f64, f64) = (0.003, 6.0);
/// Share of the light by which the frames of a dark differ at most: what came before fades from frame to frame.
const MAX_FADING: f64 = 0.3;
/// Ratio of the light to what the level of a dark has above the black level, at most.
const MAX_OF_LEVEL: f64 = 1.3;
/// Ratio of a dark's level to the dimmest flat up to which the flat is not what it was exchanged for.
const AS_DIM: f64 = 1.05;
/// Least ratio of the levels of the flats.
const MIN_RANGE: f64 = 1.5;
/// Pixels below which no pattern tells.
const MIN_PIXELS: usize = 1024;

/// The check.
pub struct LightInDarks;

impl Check for LightInDarks {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let usable = |s: &SetView| !s.clipped && s.variance_dn2().is_some() && s.facts.middle_columns > 0;
        let darks = campaign.places(|s| s.kind == Kind::Dark && usable(s));
        let mut of_fields: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for i in campaign.places(|s| s.is_lit() && usable(s)) {
            of_fields.entry(campaign.sets[i].configuration).or_default().push(i);
        }
        let flats = of_fields.into_values().max_by_key(Vec::len).unwrap_or_default();
        let level = |i: usize| campaign.sets[i].level_dn();
        let (Some(zero), true) = (campaign.zero(), campaign.is_of_one_part() && flats.len() > 1) else {
            return Vec::new();
        };
        let pixels = campaign.sets[flats[0]].facts.middle_dn.len();
        let columns = campaign.sets[flats[0]].facts.middle_columns;
        let alike = |i: &usize| campaign.sets[*i].facts.middle_dn.len() == pixels;
        let dimmest = flats.iter().map(|&i| level(i)).fold(f64::INFINITY, f64::min);
        let brightest = flats.iter().map(|&i| level(i)).fold(0.0, f64::max);
        let lowest = darks.iter().map(|&i| level(i)).fold(dimmest, f64::min);
        if pixels < MIN_PIXELS
            || brightest - lowest < MIN_RANGE * (dimmest - lowest)
            || !darks.iter().chain(&flats).all(alike)
        {
            return Vec::new();
        }
        let x: Vec<f64> = flats.iter().map(|&i| level(i)).collect();
        let weight: Vec<f64> =
            flats.iter().map(|&i| 1.0 / noise_of_mean(&campaign.sets[i]).max(1e-6)).collect();
        let Some(weights) = slope(&x, &weight) else { return Vec::new() };
        let response = flattened(&combined(campaign, &flats, &weights), columns);
        let noise: f64 =
            flats.iter().zip(&weights).map(|(&i, w)| w * w * noise_of_mean(&campaign.sets[i])).sum();
        let noise = Noise::of_flats(noise);
        let black_dn = black_of(campaign, &flats, &zero).min(zero.dn);
        let at_one_exposure = {
            let t = |i: usize| campaign.sets[i].exposure_s;
            flats.iter().all(|&i| (t(i) / t(flats[0]) - 1.0).abs() < 1e-6)
        };
        let longest_s = 1.05 * flats.iter().map(|&i| campaign.sets[i].exposure_s).fold(0.0, f64::max);
        let range = brightest - black_dn;
        let large = |l: &(usize, f64, f64)| l.1 > LARGE * range;
        let light = |&i: &usize| {
            let set = &campaign.sets[i];
            let own = flattened(&image_of(set), columns);
            let (light_dn, std) = share(&own, &response, noise, columns)?;
            let above_dn = level(i) - black_dn;
            tracing::debug!(
                "set {}: {light_dn:.3} +- {std:.3} DN of light in a dark of {above_dn:.3} DN",
                set.number
            );
            let means = set.means_dn();
            let fading = means.first().zip(means.last()).map_or(0.0, |(a, b)| (a - b).abs());
            // Slopes over levels of longer exposures have the pattern of the dark current too, of which no more than by
            // accident as much is in a dark as its level makes light.
            let is_its_level = || {
                (light_dn / above_dn - 1.0).abs() < SAME
                    && above_dn > LARGE * range
                    && set.exposure_s <= longest_s
            };
            let is_light = light_dn > MIN_LIGHT.1.max(MIN_LIGHT.0 * std)
                && (at_one_exposure || is_its_level())
                && fading < MAX_FADING * light_dn
                && light_dn < MAX_OF_LEVEL * above_dn
                && level(i) < AS_DIM * dimmest;
            Some((i, light_dn, std, is_light))
        };
        let all: Vec<(usize, f64, f64, bool)> = darks.iter().filter_map(light).collect();
        let lit: Vec<(usize, f64, f64)> = all.iter().filter(|l| l.3).map(|l| (l.0, l.1, l.2)).collect();
        let Some(most) = lit
            .iter()
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .filter(|l| 2 * lit.len() >= darks.len() || large(l))
        else {
            return leak(campaign, &darks, &flats, columns);
        };
        // What grows with the exposure in all darks leaks in; at zero exposure they are dark.
        let per_s = most.1 / campaign.sets[most.0].exposure_s;
        let exposure_s = |i: usize| campaign.sets[i].exposure_s;
        let several = darks.iter().any(|&i| exposure_s(i) < 0.7 * exposure_s(most.0));
        let grows = |l: &(usize, f64, f64, bool)| {
            (l.1 - per_s * exposure_s(l.0)).abs() < 0.3 * per_s * exposure_s(l.0) + 3.0 * l.2
        };
        let leaks = several && all.len() == darks.len() && all.iter().all(grows);
        let sets: Vec<usize> = lit.iter().map(|l| l.0).collect();
        let text = format!(
            "{}: stated dark, and the response of the pixels to light is in them, as of {} DN of light in set {}: {}",
            campaign.named(&sets),
            with_error(most.1, most.2),
            campaign.sets[most.0].number,
            if leaks {
                "a cap that leaks; what grows with their exposure is light and no dark current"
            } else {
                "a cap that leaks, or dim flats"
            }
        );
        vec![campaign.fault_of_sets(FaultKind::KindLabel, &sets, text, !leaks)]
    }
}

fn image_of(set: &SetView) -> Vec<f64> {
    set.facts.middle_dn.iter().map(|v| f64::from(*v)).collect()
}

/// Light that leaks in while darks are exposed: the growth of their pattern with the exposure has the pattern of the
/// response. Let the flats' growth be R + P (response and dark current) and that of the darks e R + P; with the
/// variances A = (e R + P)(R + P), B = (e R + P)^2 and C = (R + P)^2 the share of the light is e = (A - B) / (C - A).
fn leak(campaign: &mut Campaign<'_>, darks: &[usize], flats: &[usize], columns: usize) -> Vec<DataFault> {
    let of = |sets: &[usize]| {
        let x: Vec<f64> = sets.iter().map(|&i| campaign.sets[i].exposure_s).collect();
        let noise: Vec<f64> = sets.iter().map(|&i| noise_of_mean(&campaign.sets[i]).max(1e-6)).collect();
        let weights = slope(&x, &noise.iter().map(|n| 1.0 / n).collect::<Vec<_>>())?;
        let left: f64 = noise.iter().zip(&weights).map(|(n, w)| w * w * n).sum();
        Some((flattened(&combined(campaign, sets, &weights), columns), left))
    };
    let light = campaign.sets[flats[0]].illumination;
    let lit: Vec<usize> = flats.iter().copied().filter(|&i| campaign.sets[i].illumination == light).collect();
    let (Some((dark, dark_noise)), Some((flat, flat_noise))) = (of(darks), of(&lit)) else {
        return Vec::new();
    };
    let Some((part, std)) = leaked(&dark, dark_noise, &flat, flat_noise, columns) else { return Vec::new() };
    tracing::debug!("darks have {part:.5} +- {std:.5} of the flats' light");
    if part < MIN_LEAK.0 || part < MIN_LEAK.1 * std || part > 1.0 {
        return Vec::new();
    }
    let text = format!(
        "{}: light leaks into the darks: what grows in them with the exposure has {} of the flats' response pattern; their dark current is \
         that of light",
        campaign.named(darks),
        format_args!("{} %", with_error(100.0 * part, 100.0 * std)),
    );
    vec![campaign.fault_of_sets(FaultKind::KindLabel, darks, text, false)]
}

/// The share of the light, and the error of leaving out blocks of pixels in turn.
fn leaked(
    dark: &[f64],
    dark_noise: f64,
    flat: &[f64],
    flat_noise: f64,
    columns: usize,
) -> Option<(f64, f64)> {
    let sums = products(dark, flat, columns);
    let of = |without: Option<usize>| {
        let sum = |j: usize| {
            sums.iter().enumerate().filter(|(k, _)| Some(*k) != without).map(|(_, s)| s[j]).sum::<f64>()
        };
        let n = sum(3);
        let (a, b, c) = (sum(0), sum(1) - n * dark_noise, sum(2) - n * flat_noise);
        (c - a > 0.3 * c && b > 0.0).then(|| (a - b) / (c - a))
    };
    let all = of(None)?;
    let parts: Vec<f64> = (0..sums.len()).map(|k| of(Some(k))).collect::<Option<_>>()?;
    let n = parts.len() as f64;
    let mean = parts.iter().sum::<f64>() / n;
    let squares: f64 = parts.iter().map(|v| (v - mean).powi(2)).sum();
    // Hot and noisy pixels are in the mean of the noise.
    let pixels: f64 = sums.iter().map(|s| s[3]).sum();
    let of_noise = 0.3 * pixels * dark_noise / sums.iter().map(|s| s[2] - s[0]).sum::<f64>();
    Some((all, (squares * (n - 1.0) / n).sqrt().hypot(of_noise)))
}

/// Level at which the flats would have no light, DN, by a line through the dimmest and the brightest.
fn black_of(campaign: &Campaign<'_>, flats: &[usize], zero: &super::campaign::Zero) -> f64 {
    let light = |i: usize| campaign.sets[i].exposure_s * campaign.sets[i].illumination;
    let by_light = |a: &&usize, b: &&usize| light(**a).total_cmp(&light(**b));
    let (Some(&a), Some(&b)) = (flats.iter().min_by(by_light), flats.iter().max_by(by_light)) else {
        return zero.dn;
    };
    let level = |i: usize| campaign.sets[i].level_dn();
    if light(b) > light(a) {
        level(a) - light(a) * (level(b) - level(a)) / (light(b) - light(a))
    } else {
        zero.dn
    }
}
