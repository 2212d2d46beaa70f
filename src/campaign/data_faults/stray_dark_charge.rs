//! Darks with more charge than the line of the other darks predicts: light leaked in, the sensor was
//! warmer, or the exposure was longer than stated.
//!
//! Charge raises the level by A E and the variance by A^2 E (Healey and Kondepudy 1994, eq. 35), unlike
//! a moved black level or another gain (`dark_settings`).

use super::campaign::median_line;
use super::law::{Law, Point};
use super::set_view::SetView;
use super::transfer::Transfer;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::with_error;

/// Minimum number of other darks, each with its own exposure (a named choice): a warming sensor bends
/// the line of all.
const MIN_OTHERS: usize = 3;
/// Minimum deviation relative to the largest of the others, minimum deviation in DN, and relative to the
/// growth of the others if the longest exposure is the stray (named choices).
const MIN_OVER_OTHERS: f64 = 20.0;
const MIN_DN: f64 = 1.0;
const MIN_OVER_GROWTH: f64 = 2.0;
/// Maximum number of strays, and with several of them their maximum exposure relative to the longest of
/// the others (named choices): dark charge may grow more than proportionally.
const MOST_STRAYS: usize = 2;
const MAX_REACH: f64 = 3.0;
/// Usual scatter of a dark set's level, DN.
const SET_SCATTER_DN: f64 = 0.1;
/// Minimum and maximum ratio of the noise to that of the charge (a named choice).
const AS_CHARGE: std::ops::Range<f64> = 0.6..1.6;

/// Check for stray dark charge.
pub struct StrayDarkCharge;

impl Check for StrayDarkCharge {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_of_one_part()) else { return Vec::new() };
        let told = |s: &SetView| s.variance_dn2().is_some() && !s.is_cut_off() && !s.clipped;
        let mut darks = campaign.places(|s| s.kind == Kind::Dark && told(s) && s.is_of_one_level(&zero));
        darks.sort_by(|a, b| campaign.sets[*a].exposure_s.total_cmp(&campaign.sets[*b].exposure_s));
        let exposure_s = |i: usize| campaign.sets[i].exposure_s;
        let are_single = darks.windows(2).all(|w| exposure_s(w[1]) > 1.05 * exposure_s(w[0]));
        if darks.len() <= MIN_OTHERS || !are_single {
            return Vec::new();
        }
        let Some(gain) = Transfer::of(campaign, &zero, &darks).map(|t| t.slope()).filter(|g| *g > 0.0) else {
            return Vec::new();
        };
        let var_dn2 = |i: usize| campaign.sets[i].variance_dn2().map_or(f64::NAN, |v| v.0);
        let scatter_dn = SET_SCATTER_DN.max(campaign.dark_scatter_dn());
        let longest_s = darks.last().map_or(0.0, |&d| exposure_s(d));
        let point = |&d: &usize| {
            let frames = campaign.sets[d].frames() as f64;
            let std = SET_SCATTER_DN.hypot(campaign.dark_scatter_dn() / frames.sqrt());
            Point { factors: vec![1.0, exposure_s(d) / longest_s], value: campaign.sets[d].level_dn(), std }
        };
        let points: Vec<Point> = darks.iter().map(point).collect();
        // Two halves do not show which one is right.
        let most = (darks.len() - MIN_OTHERS).min((darks.len() - 1) / 2).min(MOST_STRAYS);
        let Some(law) = Law::fit(&points, &[1e5, 1e5], most) else { return Vec::new() };
        let off = |k: &usize| points[*k].value - law.at(&points[*k].factors);
        let (strays, others): (Vec<usize>, Vec<usize>) = (0..darks.len()).partition(|k| law.out.contains(k));
        let scatter_of_others = others.iter().map(|k| off(k).abs()).fold(scatter_dn, f64::max);
        let level = |k: usize| points[k].value;
        // The longest exposure is extrapolated: dark current may grow more than proportionally.
        let growth_dn = others.last().map_or(0.0, |&k| level(k) - level(others[0])).abs();
        // With several strays, the three others may lie on a line by chance.
        let is_extrapolated = strays.contains(&(darks.len() - 1)) || strays.len() > 1;
        let of_growth = if is_extrapolated { MIN_OVER_GROWTH * growth_dn } else { 0.0 };
        let reach_s = MAX_REACH * others.last().map_or(0.0, |&k| exposure_s(darks[k]));
        let noise: Vec<(f64, f64)> =
            others.iter().map(|&k| (exposure_s(darks[k]), var_dn2(darks[k]))).collect();
        let Some((dn2, dn2_per_s)) = median_line(&noise) else { return Vec::new() };
        let least_dn = (MIN_OVER_OTHERS * scatter_of_others).max(MIN_DN).max(of_growth);
        let is_charged = |k: &usize| {
            let more_dn2 = var_dn2(darks[*k]) - dn2 - dn2_per_s * exposure_s(darks[*k]);
            // Lag of a preceding flat is not a fault.
            let follows_light = darks[*k] > 0 && campaign.sets[darks[*k] - 1].is_lit();
            let is_near = strays.len() == 1 || exposure_s(darks[*k]) <= reach_s;
            is_near
                && off(k) > least_dn
                && AS_CHARGE.contains(&(more_dn2 / (gain * off(k))))
                && !follows_light
        };
        if strays.is_empty() || !strays.iter().all(is_charged) {
            return Vec::new();
        }
        let sets: Vec<usize> = strays.iter().map(|k| darks[*k]).collect();
        let by_dn: Vec<String> = strays.iter().map(|k| with_error(off(k), law.std(&points[*k]))).collect();
        let name = match sets[..] {
            [one] => format!("set {} ({})", campaign.sets[one].number, campaign.file(one, 0)),
            _ => campaign.named(&sets),
        };
        let [level, noise, on, was] = match sets.len() {
            1 => ["its level is", "its noise is", "it", "it was"],
            _ => ["their levels are", "their noise is", "them", "they were"],
        };
        let text = format!(
            "{name}: {level} {} DN above the line of the other darks, and {noise} that of so much charge: light fell on {on}, the sensor was \
             warmer, or {was} exposed longer than stated",
            by_dn.join(" and ")
        );
        vec![campaign.fault_of_sets(FaultKind::OtherSettings, &sets, text, true)]
    }
}
