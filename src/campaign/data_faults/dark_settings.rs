//! Dark with another black level or gain than the other darks.
//!
//! Dark charge raises level and noise: the excess of the variance over that of the quietest dark,
//! divided by the gain of the flats, equals the excess of the level over the black level (the charge is
//! Poisson: Healey and Kondepudy 1994, eq. 6). A black-level clamp removes part or all of that, equally
//! in all darks.

use super::campaign::Zero;
use super::law::{Law, Point};
use super::set_view::SetView;
use super::transfer::Transfer;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use crate::statistics::median::median;
use crate::statistics::quantisation::error_of_variance_dn2;

/// Usual scatter of a dark set's level, DN.
const SET_SCATTER_DN: f64 = 0.1;
/// Minimum deviation that is reported, DN.
const MIN_SHIFT_DN: f64 = 1.0;
/// Maximum deviation, relative to the dark charge, that another temperature explains.
const MAX_SHARE_OF_CHARGE: f64 = 0.05;
/// Standard deviations of the priors: level, DN, and its growth with the charge, which hot pixels and a clamp
/// affect.
const PRIORS: [f64; 2] = [1e5, 0.5];
/// Minimum deviation of the only dark that is off, standard deviations, and maximum scatter of the other
/// darks and the flats, relative to their errors (named choices).
const MIN_SIGMAS_OF_ONE: f64 = 8.0;
const MAX_SCATTER_OF_OTHERS: f64 = 2.0;
/// Minimum variance that shows dark charge, DN^2 (a named choice: rounding alone adds 0.083).
const MIN_VARIANCE_DN2: f64 = 0.15;
/// Minimum number of darks among which one can stand out, and beside flats that tell.
const MIN_DARKS: (usize, usize) = (3, 2);
/// Maximum ratio of the noise standard deviations at equal gain.
const MAX_NOISE_RATIO: f64 = 1.1;

/// Usual relative scatter of the light of a set, and maximum relative bend of the response at the brightest
/// flat (named choices).
const LAMP_SCATTER: f64 = 0.002;
const MAX_BEND: f64 = 0.1;
/// Minimum number of flats that have a level without light, and maximum error of that, DN.
const MIN_FLATS: usize = 5;
const MAX_ERROR_OF_FLATS_DN: f64 = 1.0;
/// Range of the exposures of a dark with the charge of a flat, relative to it.
const SAME_CHARGE: std::ops::Range<f64> = 0.5..2.0;

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
        let Some(gain) = gain.filter(|_| darks.len() >= MIN_DARKS.1) else { return Vec::new() };
        let var = |i: usize| campaign.sets[i].variance_dn2().unwrap_or_default();
        let quietest = darks.iter().map(|&i| var(i).0).fold(f64::INFINITY, f64::min);
        let charge: Vec<f64> = darks.iter().map(|&i| (var(i).0 - quietest) / gain).collect();
        let frame = campaign.dark_scatter_dn();
        let point = |(&i, &charge): (&usize, &f64)| {
            let set = &campaign.sets[i];
            let (var, pairs) = var(i);
            let of_rounding = error_of_variance_dn2(var).hypot(error_of_variance_dn2(quietest)) / gain;
            let of_charge = (var / gain * (3.0 / (set.facts.pixels * pairs)).sqrt()).hypot(of_rounding);
            let std = SET_SCATTER_DN.hypot(frame / (set.frames() as f64).sqrt()).hypot(of_charge);
            Point { factors: vec![1.0, charge], value: set.level_dn() - charge, std }
        };
        let mut points: Vec<Point> = darks.iter().zip(&charge).map(point).collect();
        // Among a few darks the flats tell which of them is off.
        let of_flats = level_of_flats(campaign, &zero, &darks, &charge);
        let flats_tell = of_flats.is_some();
        points.extend(of_flats);
        if points.len() < MIN_DARKS.0 {
            return Vec::new();
        }
        let few = (darks.len() / 4).clamp(1, 3).min(darks.len() - 2);
        let Some(mut law) = Law::fit(&points, &PRIORS, few) else { return Vec::new() };
        if law.out.is_empty() && flats_tell {
            law = one_off(&points, darks.len()).unwrap_or(law);
        }
        let mut found = Vec::new();
        for &k in law.out.iter().filter(|k| **k < darks.len()) {
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

/// Finds the only dark that is off the others and the flats, which agree: too few points give a scatter of
/// their own. The law is fitted without it.
fn one_off(points: &[Point], darks: usize) -> Option<Law> {
    let without = |k: usize| {
        let others: Vec<Point> = (0..points.len()).filter(|i| *i != k).map(|i| points[i].clone()).collect();
        let law = Law::fit(&others, &PRIORS, 0)?;
        let off = (points[k].value - law.at(&points[k].factors)).abs() / law.std(&points[k]);
        let is_off = law.scale() < MAX_SCATTER_OF_OTHERS && off > MIN_SIGMAS_OF_ONE;
        is_off.then(|| law.with_out(vec![k]))
    };
    let mut found = (0..darks).filter_map(without);
    found.next().filter(|_| found.next().is_none())
}

/// Returns the level that the flats have without light as one more dark, from a line with a bend over the
/// light (linear model of EMVA 1288, and the bend that its linearity error allows); `None` if they do not
/// determine it.
/// `charge`: of each dark, DN.
fn level_of_flats(campaign: &Campaign<'_>, zero: &Zero, darks: &[usize], charge: &[f64]) -> Option<Point> {
    let flats = campaign.places(|s| s.is_lit() && !s.clipped && s.is_of_one_level(zero));
    let exposure_s = |i: &usize| campaign.sets[*i].exposure_s;
    let shortest_s = flats.iter().map(exposure_s).fold(f64::INFINITY, f64::min);
    let longest_s = flats.iter().map(exposure_s).fold(0.0, f64::max);
    let most = flats.iter().map(|&i| campaign.sets[i].light()).fold(0.0, f64::max);
    let lamps =
        flats.iter().map(|&i| campaign.sets[i].configuration).collect::<std::collections::BTreeSet<_>>();
    if flats.len() < MIN_FLATS || lamps.len() > 1 || !campaign.is_of_one_part() {
        return None;
    }
    // The charge of one exposure is in all flats; that of an exposure sweep vanishes with the light.
    let own_charge = if longest_s < SAME_CHARGE.end * shortest_s {
        let has_it = |(i, _): &(&usize, &f64)| SAME_CHARGE.contains(&(exposure_s(i) / longest_s));
        let all: Vec<f64> = darks.iter().zip(charge).filter(has_it).map(|(_, c)| *c).collect();
        (!all.is_empty()).then(|| median(all.into_iter()))?
    } else {
        0.0
    };
    let range_dn = flats.iter().map(|&i| campaign.sets[i].level_dn()).fold(0.0, f64::max) - zero.dn;
    let scatter = campaign.scatter(zero);
    let factors = |light: f64| [1.0, light / most, (light / most).powi(2)];
    let point = |&i: &usize| {
        let set = &campaign.sets[i];
        let of_lamp = LAMP_SCATTER * (set.level_dn() - zero.dn).abs();
        let of_frames = scatter.of_frame_dn(set) / (set.frames() as f64).sqrt();
        let std = of_lamp.hypot(of_frames).hypot(SET_SCATTER_DN);
        Point { factors: factors(set.light()).to_vec(), value: set.level_dn(), std }
    };
    let points: Vec<Point> = flats.iter().map(point).collect();
    let law = Law::fit(&points, &[1e5, 1e6, MAX_BEND * range_dn.max(1.0)], flats.len() / 5)?;
    let dark = Point { factors: factors(0.0).to_vec(), value: 0.0, std: 0.0 };
    let (level_dn, error_dn) = (law.at(&dark.factors), law.std(&dark));
    tracing::debug!("the flats have {level_dn:.3} +- {error_dn:.3} DN without light");
    let value = level_dn - own_charge;
    (error_dn < MAX_ERROR_OF_FLATS_DN).then(|| Point {
        factors: vec![1.0, own_charge],
        value,
        std: error_dn.hypot(SET_SCATTER_DN),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// One of three darks is 3 DN off, and the flats, known to 0.3 DN, agree with the others: it is found in
    /// all of 300 campaigns, and none in 2000 without.
    #[test]
    fn the_flats_tell_the_dark_that_is_off() {
        let points = |seed: u32, off_dn: f64| -> Vec<Point> {
            let of = |(k, std): (usize, f64)| {
                let z = PixelRng::new(17, Stream::Frame, k as u64, seed, 0).normal();
                let off = if k == seed as usize % 3 { off_dn } else { 0.0 };
                Point {
                    factors: vec![1.0, 0.1 * k as f64],
                    value: 60.0 + 0.1 * k as f64 + std * z + off,
                    std,
                }
            };
            [0.1, 0.1, 0.1, 0.3].into_iter().enumerate().map(of).collect()
        };
        let found = |seed: u32, off_dn: f64| one_off(&points(seed, off_dn), 3).map(|law| law.out);
        for seed in 0..300 {
            assert_eq!(found(seed, 3.0), Some(vec![seed as usize % 3]), "seed {seed}");
        }
        assert_eq!((0..2000).filter(|s| found(*s, 0.0).is_some()).count(), 0);
    }
}
