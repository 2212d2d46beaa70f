//! Dark with another black level or gain than the other darks.
//!
//! Dark charge raises level and noise: the excess of the variance over that of the quietest dark,
//! divided by the gain of the flats, equals the excess of the level over the black level (the charge is
//! Poisson: Healey and Kondepudy 1994, eq. 6). A black-level clamp removes part or all of that, equally
//! in all darks.

use super::law::{Law, Point};
use super::set_view::SetView;
use super::transfer::Transfer;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use crate::statistics::median::median;

/// Usual scatter of a dark set's level, DN.
const SET_SCATTER_DN: f64 = 0.1;
/// Minimum deviation that is reported, DN.
const MIN_SHIFT_DN: f64 = 1.0;
/// Maximum deviation, relative to the dark charge, that another temperature explains.
const MAX_SHARE_OF_CHARGE: f64 = 0.05;
/// Standard deviation of the prior on the growth of the level with the charge: hot pixels and a clamp
/// affect it.
const CHARGE_PRIOR: f64 = 0.5;
/// Minimum variance that shows dark charge, DN^2 (a named choice: rounding alone adds 0.083).
const MIN_VARIANCE_DN2: f64 = 0.15;
/// Minimum number of darks among which one can stand out.
const MIN_DARKS: usize = 3;
/// Maximum ratio of the noise standard deviations at equal gain.
const MAX_NOISE_RATIO: f64 = 1.1;

/// Check for darks of other settings.
pub struct DarkSettings;

impl Check for DarkSettings {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero() else { return Vec::new() };
        // Darks clipped at code 0, or with noise dominated by rounding, are not used.
        let told = |s: &SetView| s.variance_dn2().is_some_and(|v| v.0 > MIN_VARIANCE_DN2 && !s.is_cut_off());
        let usable = |s: &SetView| !s.clipped && s.is_of_one_level(&zero) && told(s);
        let darks = campaign.places(|s| s.kind == Kind::Dark && usable(s));
        let gain = Transfer::of(campaign, &zero, &darks).map(|t| t.slope()).filter(|g| *g > 0.0);
        let Some(gain) = gain.filter(|_| darks.len() >= MIN_DARKS) else { return Vec::new() };
        let var = |i: usize| campaign.sets[i].variance_dn2().unwrap_or_default();
        let quietest = darks.iter().map(|&i| var(i).0).fold(f64::INFINITY, f64::min);
        let charge: Vec<f64> = darks.iter().map(|&i| (var(i).0 - quietest) / gain).collect();
        let frame = campaign.dark_scatter_dn();
        let point = |(&i, &charge): (&usize, &f64)| {
            let set = &campaign.sets[i];
            let (var, pairs) = var(i);
            let of_charge = var / gain * (3.0 / (set.facts.pixels * pairs)).sqrt();
            let std = SET_SCATTER_DN.hypot(frame / (set.frames() as f64).sqrt()).hypot(of_charge);
            Point { factors: vec![1.0, charge], value: set.level_dn() - charge, std }
        };
        let points: Vec<Point> = darks.iter().zip(&charge).map(point).collect();
        let few = (darks.len() / 4).clamp(1, 3).min(darks.len() - 2);
        let Some(law) = Law::fit(&points, &[1e5, CHARGE_PRIOR], few) else { return Vec::new() };
        let mut found = Vec::new();
        for &k in &law.out {
            let (i, off) = (darks[k], points[k].value - law.at(&points[k].factors));
            // A single dark with more charge than all others is the only evidence of the effect of
            // charge on its level.
            let alone = charge.iter().filter(|c| **c >= 0.5 * charge[k]).count() == 1;
            if off.abs() < MIN_SHIFT_DN.max(MAX_SHARE_OF_CHARGE * charge[k])
                || alone && off.abs() < 1.5 * charge[k]
            {
                continue;
            }
            let std = |d: usize| points[darks.iter().position(|o| *o == d).unwrap_or(k)].std;
            if !campaign.is_off_the_darks(i, |d| campaign.sets[d].level_dn(), std) {
                continue;
            }
            let alike = |d: &usize| {
                let ratio = campaign.sets[*d].exposure_s / campaign.sets[i].exposure_s;
                (0.5..2.0).contains(&ratio)
            };
            // Charge and its noise grow with the exposure.
            let sound = || (0..darks.len()).filter(|d| !law.out.contains(d)).map(|d| darks[d]);
            let least = sound().map(|d| var(d).0).fold(f64::INFINITY, f64::min);
            let of_charge =
                |d: usize| (var(d).0 - least) * campaign.sets[i].exposure_s / campaign.sets[d].exposure_s;
            let usual = least + median(sound().filter(alike).map(of_charge));
            let ratio = (var(i).0 / usual).sqrt();
            let of_gain = ratio.is_finite() && !(MAX_NOISE_RATIO.recip()..MAX_NOISE_RATIO).contains(&ratio);
            let what = if of_gain {
                format!("another gain, {} times that of the other darks by its noise: its", six_digits(ratio))
            } else {
                "another black level: its".into()
            };
            let text = format!(
                "set {} ({}): {what} level is {} DN {} that of the other darks",
                campaign.sets[i].number,
                campaign.file(i, 0),
                six_digits(off.abs()),
                if off < 0.0 { "below" } else { "above" }
            );
            found.push((i, text));
        }
        found
            .into_iter()
            .map(|(i, text)| campaign.fault_of_sets(FaultKind::OtherSettings, &[i], text, true))
            .collect()
    }
}
