//! Sets whose frames were averaged before saving among sets of single frames, too many for strays from
//! one photon-transfer curve: all sets lie on two curves, and one is the n-th part of the other.
//!
//! The mean of n frames has 1/n of their variance, plus rounding, at the same level (Healey and Kondepudy
//! 1994, eqs. 35 and 43). Another gain would change the level too, and a full well reduces the noise of the
//! brightest sets only.

use super::campaign::Zero;
use super::law::{Law, Point};
use super::transfer::{MAX_BEND, MODEL_ERROR, above, factors, pixel_error};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use crate::statistics::median::median;
use crate::statistics::quantisation::QUANTISATION_DN2;

/// Minimum number of sets, of sets of single frames, and of averaged ones: fewer are strays from one curve.
const MIN_SETS: (usize, usize, usize) = (6, 4, 2);
/// Minimum number of lit sets of single frames.
const MIN_LIT: usize = 3;
/// Maximum number of averaged frames.
const MAX_FRAMES: u32 = 32;
/// Maximum deviation of a set from its curve, standard deviations.
const MAX_OFF_SIGMAS: f64 = 5.0;
/// Minimum deviation of a set from the only curve, standard deviations.
const MIN_OFF_SIGMAS: f64 = 8.0;
/// Maximum relative deviation from straight lines in the search for the sets of each curve.
const MAX_OFF_LINE: f64 = 0.2;
/// Error of a variance that rounding determines, DN^2.
const ROUNDING_DN2: f64 = 0.03;
/// Maximum number of sets for the search over all pairs, whose time grows with the third power: others
/// are drawn evenly.
const MAX_SETS_OF_LINES: usize = 40;
/// Maximum relative difference of the responses, level over light, of the two curves: another gain
/// changes it by the square root of the variance's ratio.
const SAME_RESPONSE: f64 = 0.1;

/// Check for averages among the sets.
pub struct AveragesAmongSets;

/// One set on the curves.
#[derive(Debug, Clone, Copy)]
struct Measured {
    /// Level above the darks, DN.
    above_dn: f64,
    /// Temporal variance without that of rounding, DN^2, and its standard error.
    var_dn2: f64,
    std_dn2: f64,
}

impl Measured {
    /// Returns the deviation from a variance, relative to it and in standard deviations.
    fn off(&self, expected_dn2: f64) -> (f64, f64) {
        let off_dn2 = self.var_dn2 - expected_dn2;
        (off_dn2 / expected_dn2, off_dn2 / self.std_dn2.hypot(MODEL_ERROR * expected_dn2))
    }
}

/// Number of frames averaged in each set of the second curve, and flags of these sets.
type Parted = (u32, Vec<bool>);

/// Fits a curve to sets; `frames`: number of frames averaged in each.
fn curve(sets: &[Measured], frames: &[f64]) -> Option<Vec<f64>> {
    let most = sets.iter().map(|s| s.above_dn).fold(1.0, f64::max);
    let factors = |s: &Measured| factors(s.above_dn / most);
    let scaled: Vec<f64> = sets.iter().zip(frames).map(|(s, n)| s.var_dn2 * n).collect();
    let largest = scaled.iter().copied().fold(0.0, f64::max);
    let mut expected: Vec<f64> = scaled.iter().map(|v| v.max(1e-3 * largest)).collect();
    for _ in 0..5 {
        let points: Vec<Point> = (0..sets.len())
            .map(|i| Point {
                factors: factors(&sets[i]).iter().map(|f| f / expected[i]).collect(),
                value: scaled[i] / expected[i],
                std: (sets[i].std_dn2 * frames[i] / expected[i]).hypot(MODEL_ERROR),
            })
            .collect();
        let law = Law::fit(&points, &[1e6, 1e6, MAX_BEND * largest], 0)?;
        expected = sets.iter().map(|s| law.at(&factors(s))).collect();
        if expected.iter().any(|e| *e <= 0.0) {
            return None;
        }
    }
    Some(expected)
}

/// Returns the largest deviation of the sets from their curves, standard deviations; `None` without a curve.
fn largest_off(sets: &[Measured], frames: &[f64]) -> Option<f64> {
    let expected = curve(sets, frames)?;
    let off = sets.iter().zip(expected.iter().zip(frames)).map(|(s, (e, n))| s.off(e / n).1.abs());
    Some(off.fold(0.0, f64::max))
}

/// Finds the two curves: the number of averaged frames and the averaged sets; `None` if one curve
/// describes all, or two do not.
fn parted(sets: &[Measured]) -> Option<Parted> {
    // A single curve may leave no noise at some level.
    let is_one = |off: f64| off < MIN_OFF_SIGMAS;
    if sets.len() < MIN_SETS.0 || largest_off(sets, &vec![1.0; sets.len()]).is_some_and(is_one) {
        return None;
    }
    let step = sets.len().div_ceil(MAX_SETS_OF_LINES);
    let some: Vec<&Measured> = sets.iter().step_by(step).collect();
    let mut best: Option<(Parted, f64)> = None;
    for (i, a) in some.iter().enumerate() {
        for b in &some[i + 1..] {
            let slope = (b.var_dn2 - a.var_dn2) / (b.above_dn - a.above_dn);
            let at_zero = a.var_dn2 - slope * a.above_dn;
            if !(slope.is_finite() && slope > 0.0 && at_zero > -ROUNDING_DN2) {
                continue;
            }
            for frames in 2..=MAX_FRAMES {
                let n = f64::from(frames);
                let own = sets.iter().map(|s| {
                    let expected = (at_zero + slope * s.above_dn).max(ROUNDING_DN2);
                    let small = |e: f64| ROUNDING_DN2 / e;
                    let (single, mean) = (s.off(expected).0.abs(), s.off(expected / n).0.abs());
                    let is_mean = mean < single;
                    let (off, limit) =
                        if is_mean { (mean, small(expected / n)) } else { (single, small(expected)) };
                    (is_mean, off.min(2.0 * MAX_OFF_LINE), off < MAX_OFF_LINE + limit)
                });
                let own: Vec<(bool, f64, bool)> = own.collect();
                let means: Vec<bool> = own.iter().map(|o| o.0).collect();
                let off: f64 = own.iter().map(|o| o.1).sum();
                let explains = own.iter().all(|o| o.2);
                if explains && best.as_ref().is_none_or(|b| off < b.1) {
                    best = Some(((frames, means), off));
                }
            }
        }
    }
    let (frames, means) = best?.0;
    let averaged = means.iter().filter(|m| **m).count();
    if averaged < MIN_SETS.2 || sets.len() - averaged < MIN_SETS.1 {
        return None;
    }
    let numbers: Vec<f64> = means.iter().map(|m| if *m { f64::from(frames) } else { 1.0 }).collect();
    (largest_off(sets, &numbers)? < MAX_OFF_SIGMAS).then_some((frames, means))
}

impl Check for AveragesAmongSets {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_of_one_part()) else { return Vec::new() };
        let places = campaign.places(|s| {
            (s.kind == Kind::Dark || s.is_lit())
                && !s.clipped
                && !s.is_cut_off()
                && s.is_of_one_level(&zero)
                && s.variance_dn2().is_some()
        });
        let sets: Vec<Measured> = places.iter().filter_map(|&i| measured(campaign, &zero, i)).collect();
        tracing::debug!("levels and variances: {sets:.3?}");
        let Some((frames, means)) = parted(&sets) else { return Vec::new() };
        tracing::debug!("means of {frames} frames: {means:?}");
        let lit = |mean: bool| {
            let of_curve = |(i, m): &(&usize, &bool)| **m == mean && campaign.sets[**i].is_lit();
            places.iter().zip(&means).filter(of_curve).map(|(i, _)| *i).collect::<Vec<usize>>()
        };
        let (single, averaged) = (lit(false), lit(true));
        let level = |i: &usize| campaign.sets[*i].level_dn();
        let brightest = single.iter().map(level).fold(0.0, f64::max);
        let dimmest = averaged.iter().map(level).fold(f64::INFINITY, f64::min);
        // A full well takes noise from the brightest sets, and averages of darks alone have a check of
        // their own.
        let is_beside = brightest > dimmest;
        let response = |sets: &[usize]| {
            median(sets.iter().map(|&i| above(campaign, &zero, i) / campaign.sets[i].light()))
        };
        let is_of_one_gain = (response(&averaged) / response(&single) - 1.0).abs() < SAME_RESPONSE;
        if single.len() < MIN_LIT || !is_beside || !is_of_one_gain {
            return Vec::new();
        }
        let rounded: Vec<usize> = places.iter().zip(&means).filter(|(_, m)| **m).map(|(i, _)| *i).collect();
        let first = averaged[0];
        let text = format!(
            "{}: frames were averaged or filtered over time before they were saved, about {frames} each: set {} has a variance of {} DN² at {} DN, {frames} times less than the other sets leave for that level; take single frames",
            campaign.named(&rounded),
            campaign.sets[first].number,
            six_digits((1000.0 * campaign.sets[first].variance_dn2().map_or(0.0, |v| v.0)).round() / 1000.0),
            six_digits((10.0 * campaign.sets[first].level_dn()).round() / 10.0),
        );
        vec![campaign.fault_of_sets(FaultKind::DependentFrames, &rounded, text, true)]
    }
}

/// Returns level and variance of a set without that of rounding; `None` if it has no variance.
fn measured(campaign: &Campaign<'_>, zero: &Zero, set: usize) -> Option<Measured> {
    let (var_dn2, pairs) = campaign.sets[set].variance_dn2()?;
    let rounding_dn2 = QUANTISATION_DN2 * campaign.code_step_dn.powi(2);
    let std_dn2 =
        (var_dn2 * pixel_error(campaign, set, pairs)).hypot(ROUNDING_DN2 * rounding_dn2 / QUANTISATION_DN2);
    Some(Measured { above_dn: above(campaign, zero, set), var_dn2: var_dn2 - rounding_dn2, std_dn2 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Draws a campaign of sets with a bend of the curve; `frames`: averaged in each set.
    fn sets(seed: u32, frames: &[u32]) -> Vec<Measured> {
        let of = |(i, n): (usize, &u32)| {
            let above_dn = if i < 3 { 0.0 } else { 20.0 * 1.6f64.powi(i as i32 - 3) };
            let var_dn2 = (4.0 + 0.5 * above_dn * (1.0 - 5e-5 * above_dn)) / f64::from(*n);
            let z = PixelRng::new(11, Stream::Frame, i as u64, seed, 0).normal();
            Measured { above_dn, var_dn2: var_dn2 * (1.0 + 0.015 * z), std_dn2: 0.015 * var_dn2 }
        };
        frames.iter().enumerate().map(of).collect()
    }

    /// In 1000 campaigns of 11 sets two to five flats are averages, all but the brightest: 49 in 50 are
    /// parted so, with the number of frames to 7 %; no other sets are taken for averages, nor any where there
    /// are none.
    #[test]
    fn averages_are_parted() {
        let (mut right, mut all) = (0, 0);
        for seed in 0..1000u32 {
            let drawn = |what: u64, most: u64| {
                (PixelRng::new(12, Stream::Frame, what, seed, 0).uniform() * most as f64) as u64
            };
            let n = [2, 3, 4, 8, 16][drawn(0, 5) as usize];
            let mut frames = [1; 11];
            (0..3 + drawn(1, 3)).for_each(|k| frames[3 + drawn(2 + k, 7) as usize] = n);
            let means: Vec<bool> = frames.iter().map(|f| *f > 1).collect();
            if means.iter().filter(|m| **m).count() >= MIN_SETS.2 {
                all += 1;
                if let Some((number, found)) = parted(&sets(seed, &frames)) {
                    assert_eq!(found, means, "seed {seed}: {frames:?}");
                    right += usize::from(f64::from(number.abs_diff(n)) <= 0.07 * f64::from(n));
                }
            }
            assert_eq!(parted(&sets(seed, &[1; 11])), None, "seed {seed}");
        }
        assert!(50 * right >= 49 * all, "{right} of {all}");
    }
}
