//! Darks with exchanged exposures: the shorter ones have the level and the hot pixels of the longer
//! ones.
//!
//! A black-level clamp or a drift may lower the level of long darks; the dark charge of single pixels,
//! and its noise, grow with the exposure regardless of the level.

use super::campaign::median_line;
use super::patterns::{noise_of_mean, pattern_of};
use super::set_view::SetView;
use super::transfer::{MODEL_ERROR, Transfer};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use std::ops::RangeInclusive;

/// Minimum ratio of the exposures.
const MIN_RATIO: f64 = 1.5;
/// Minimum fall of the level, in scatters of the darks' means and in DN; the second is smaller if the
/// hot pixels fall too (named choices).
const FALL: (f64, f64) = (10.0, 1.0);
const FALL_OF_HOT_DN: f64 = 0.1;
/// Maximum ratio of the spread of the longest dark to that of the shortest, for a large and for a small
/// fall of the level; the fall of the spread is then at least this many standard errors.
const MAX_SPREAD_SHARE: f64 = 0.7;
const MAX_HOT_SHARE: f64 = 0.3;
const MIN_SPREAD_SIGMAS: f64 = 10.0;

/// Minimum ratio of levels at which one dark may be a scaled copy of the other (two lost bits make 4),
/// and maximum deviation of the noise from that ratio.
const SCALED: (f64, f64) = (3.0, 1.5);

/// Maximum ratio between the fall of the variance and that of the noise of a charge, and minimum fall in
/// its errors (named choices).
const AS_CHARGE: (f64, f64) = (1.5, 5.0);

/// Numbers of darks among which one pair is searched for, pair by pair, and maximum deviation from a
/// line after the exchange, relative to that before (named choices).
const DARKS_OF_A_PAIR: RangeInclusive<usize> = 4..=32;
const MAX_SCATTER_EXCHANGED: f64 = 0.3;

/// Check for exchanged labels of darks.
pub struct DarkLabels;

/// Returns true if the noise of dark b is lower than that of dark a by the noise of the charge between
/// their levels: system gain times the level difference (Healey and Kondepudy 1994, eq. 35).
fn falls_as_charge(campaign: &Campaign<'_>, a: usize, b: usize) -> bool {
    let variance = |i: usize| Some(campaign.sets[i].variance_dn2()?.0);
    let transfer = || Transfer::of(campaign, &campaign.zero()?, &[]);
    let (Some(of_a), Some(of_b), Some(transfer)) = (variance(a), variance(b), transfer()) else {
        return false;
    };
    let charge = transfer.slope() * (campaign.sets[a].level_dn() - campaign.sets[b].level_dn());
    let fall = of_a - of_b;
    fall > AS_CHARGE.1 * MODEL_ERROR * of_a.hypot(of_b)
        && fall < AS_CHARGE.0 * charge
        && charge < AS_CHARGE.0 * fall
}

/// Returns the spread over the pixels that is not noise, DN^2, hot pixels included.
fn spread_dn2(set: &SetView) -> f64 {
    let pattern = pattern_of(set);
    pattern.iter().map(|v| v * v).sum::<f64>() / pattern.len().max(1) as f64 - noise_of_mean(set)
}

/// Returns true if dark b lacks the hot pixels of dark a: most of the spread of a is missing, by more
/// than noise explains.
fn falls_with_hot_pixels(a: &SetView, b: &SetView) -> bool {
    let pixels = a.facts.middle_dn.len().max(1) as f64;
    let noise = noise_of_mean(a).hypot(noise_of_mean(b)) * (2.0 / pixels).sqrt();
    let (of_a, of_b) = (spread_dn2(a), spread_dn2(b));
    of_b < MAX_HOT_SHARE * of_a && of_a - of_b > MIN_SPREAD_SIGMAS * noise
}

/// Returns true if black level and noise of dark b are those of dark a divided by one number, or b has
/// no noise at all: codes that lost their last bits, or an image that is not from the sensor.
fn is_scaled(a: &SetView, b: &SetView) -> bool {
    let deviation = |set: &SetView| set.variance_dn2().map_or(0.0, |v| v.0.sqrt());
    let (level, noise) = (a.level_dn() / b.level_dn(), deviation(a) / deviation(b));
    level > SCALED.0 && (noise / level > SCALED.1.recip() || !noise.is_finite())
}

/// Finds darks that are scaled copies of the others, if the flats extrapolate to the level of the latter
/// at zero exposure.
fn scaled(campaign: &mut Campaign<'_>, darks: &[usize]) -> Option<DataFault> {
    let black_dn = campaign.black_of_flats()?;
    let off = |i: usize| (campaign.sets[i].level_dn() / black_dn).ln().abs();
    let right = darks.iter().copied().min_by(|a, b| off(*a).total_cmp(&off(*b)))?;
    let small = |i: &&usize| is_scaled(&campaign.sets[right], &campaign.sets[**i]);
    let wrong: Vec<usize> = darks.iter().filter(small).copied().collect();
    if off(right) > SCALED.1.ln() || wrong.is_empty() {
        return None;
    }
    let ratio = campaign.sets[right].level_dn() / campaign.sets[wrong[0]].level_dn();
    let text = format!(
        "{}: level and noise are those of the other darks divided by {}: codes that lost their last bits",
        campaign.named(&wrong),
        six_digits((10.0 * ratio).round() / 10.0)
    );
    Some(campaign.fault_of_sets(FaultKind::OtherSettings, &wrong, text, true))
}

/// Finds a pair of darks with exchanged exposures: by their hot pixels, and because the level of all
/// grows with exposure after the exchange but not as stated.
fn one_pair(campaign: &mut Campaign<'_>, darks: &[usize]) -> Option<DataFault> {
    let stated: Vec<(f64, f64)> =
        darks.iter().map(|&i| (campaign.sets[i].exposure_s, campaign.sets[i].level_dn())).collect();
    let least_dn = FALL_OF_HOT_DN.max(FALL.0 * campaign.dark_scatter_dn());
    let (as_stated_dn, _) = furthest_off(&stated)?;
    if !DARKS_OF_A_PAIR.contains(&darks.len()) || as_stated_dn <= least_dn {
        return None;
    }
    let is_told = |(a, b): &(usize, usize)| {
        let (short, long) = (&campaign.sets[darks[*a]], &campaign.sets[darks[*b]]);
        long.exposure_s >= MIN_RATIO * short.exposure_s && falls_with_hot_pixels(short, long)
    };
    let exchange = |(a, b): (usize, usize)| {
        let mut right = stated.clone();
        (right[a].0, right[b].0) = (stated[b].0, stated[a].0);
        let (off_dn, dn_per_s) = furthest_off(&right)?;
        (dn_per_s > 0.0).then_some((off_dn, (darks[a], darks[b])))
    };
    let pairs = (0..darks.len()).flat_map(|b| (0..b).map(move |a| (a, b))).filter(is_told);
    let (off_dn, pair) = pairs.filter_map(exchange).min_by(|a, b| a.0.total_cmp(&b.0))?;
    (off_dn < MAX_SCATTER_EXCHANGED * as_stated_dn)
        .then(|| exchanged(campaign, &[pair.0.min(pair.1), pair.0.max(pair.1)], pair))
}

/// Returns the largest deviation of levels from the line over exposure, DN, and its slope, DN/s.
fn furthest_off(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let (dn, dn_per_s) = median_line(points)?;
    let off = points.iter().map(|(exposure_s, level_dn)| (level_dn - dn - dn_per_s * exposure_s).abs());
    Some((off.fold(0.0, f64::max), dn_per_s))
}

/// Creates the fault of darks with exchanged exposures; `example`: one stated short and one stated long.
fn exchanged(campaign: &mut Campaign<'_>, sets: &[usize], example: (usize, usize)) -> DataFault {
    let stated = |i: usize| {
        let set = &campaign.sets[i];
        (six_digits(set.exposure_s), six_digits(set.level_dn()))
    };
    let ((short_s, short_dn), (long_s, long_dn)) = (stated(example.0), stated(example.1));
    let text = format!(
        "{}: the exposures of these darks are exchanged: those of {short_s} s have {short_dn} DN and the noise and hot pixels of more charge than those of {long_s} s with {long_dn} DN",
        campaign.named(sets)
    );
    campaign.fault_of_sets(FaultKind::SettingLabel, sets, text, true)
}

impl Check for DarkLabels {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let mut darks = campaign.places(|s| s.kind == Kind::Dark && s.has_pattern());
        if let Some(fault) = scaled(campaign, &darks) {
            return vec![fault];
        }
        let exposure_s = |i: usize| campaign.sets[i].exposure_s;
        let level = |i: usize| campaign.sets[i].level_dn();
        darks.sort_by(|a, b| exposure_s(*a).total_cmp(&exposure_s(*b)));
        let [shortest, .., longest] = *darks.as_slice() else { return Vec::new() };
        let hot = falls_with_hot_pixels(&campaign.sets[shortest], &campaign.sets[longest]);
        let least = if hot { FALL_OF_HOT_DN } else { FALL.1 }.max(FALL.0 * campaign.dark_scatter_dn());
        let falls = level(longest) < level(shortest) - least;
        let spreads = || (spread_dn2(&campaign.sets[shortest]), spread_dn2(&campaign.sets[longest]));
        if exposure_s(longest) < MIN_RATIO * exposure_s(shortest)
            || !falls
            || is_scaled(&campaign.sets[shortest], &campaign.sets[longest])
            || (spreads().1 > MAX_SPREAD_SHARE * spreads().0 && !falls_as_charge(campaign, shortest, longest))
        {
            return one_pair(campaign, &darks).into_iter().collect();
        }
        // With correct labels the order by level equals that by exposure.
        let mut by_level = darks.clone();
        by_level.sort_by(|a, b| level(*a).total_cmp(&level(*b)));
        let mut wrong: Vec<usize> = darks
            .iter()
            .zip(&by_level)
            .filter(|(a, b)| (level(**a) - level(**b)).abs() > least && exposure_s(**a) != exposure_s(**b))
            .map(|(a, _)| *a)
            .collect();
        if wrong.is_empty() {
            return Vec::new();
        }
        wrong.sort_unstable();
        vec![exchanged(campaign, &wrong, (shortest, longest))]
    }
}
