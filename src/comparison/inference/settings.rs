//! Tests of independent scatter of the settings of sets. A lamp that jumps, or a response that bends or has a
//! step, is no scatter.

use super::fit::{Fitted, halves};
use super::layout::Layout;
use super::system::System;
use crate::observables::Observations;
use crate::statistics::{step, succession};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use statrs::function::erf::erfc_inv;
use std::collections::BTreeMap;

/// Minimum number of sets for the order of their settings to tell anything.
const FEWEST: usize = 8;

/// Names of tests that tell a lamp's setting from something else.
pub const THAT_COME_BACK: &str = "light settings that come back";
/// See [`THAT_COME_BACK`].
pub const AT_LONG_EXPOSURES: &str = "light settings at long exposures";

/// Names of tests that tell a lamp's setting from a response with a step or a bend.
pub const STEP_IN_SIGNAL: &str = "step of light settings, in the order of the signal";
/// See [`STEP_IN_SIGNAL`].
pub const ALIKE_IN_SIGNAL: &str = "succession of light settings, in the order of the signal";

/// Returns the deviation that a test of this name finds, in words.
pub fn words(name: &str) -> Option<&'static str> {
    match name {
        THAT_COME_BACK => {
            Some("sets of the same light and exposure agree, and errors of a lamp are drawn anew each time")
        }
        AT_LONG_EXPOSURES => Some(
            "sets scatter less at long exposures, and errors of a lamp are as large at long exposures as at short ones",
        ),
        STEP_IN_SIGNAL => Some(
            "up to one level all sets are off to one side, and beyond it to the other, as a response with a step puts them; errors of a lamp \
             come in any order",
        ),
        ALIKE_IN_SIGNAL => Some(
            "sets next to each other in the signal are off alike, as a response with a bend or a step puts them; errors of a lamp come in any \
             order",
        ),
        _ => None,
    }
}

/// Result of a test of the settings.
pub(super) struct Test {
    pub name: String,
    pub measured: f64,
    pub predicted: f64,
    pub std_err: f64,
    pub z: f64,
}

/// Set, and the standardised deviation of its setting.
type Score = (usize, f64);

/// Tests whether settings of the same light differ as others do, whether those at long exposures scatter
/// alike, the correlation of successive ones, and the largest step between two runs of them, in the order of
/// time and of the signal. `levels`: mean of every set, DN.
pub(super) fn tests(all: &Observations, model: &Fitted, levels: &[f64]) -> Vec<Test> {
    let layout = Layout::new(all, &halves(None), model.free.effects.iter());
    let state = layout.at(&model.free, &model.point);
    let mut scores = System::new(&layout, &model.free, &model.point, &state, &model.slopes).setting_scores();
    if scores.len() < FEWEST {
        return Vec::new();
    }
    let mut out: Vec<Test> = coming_back(all, &scores).into_iter().collect();
    out.extend(at_long_exposures(all, &scores));
    scores.sort_by_key(|s| s.0);
    out.extend(in_order(&scores, "time"));
    scores.sort_by(|a, b| levels[a.0].total_cmp(&levels[b.0]));
    out.extend(in_order(&scores, "the signal"));
    out
}

/// Converts a two-sided chance to normal standard deviations.
pub(super) fn as_z(p_value: f64) -> f64 {
    std::f64::consts::SQRT_2 * erfc_inv(p_value.clamp(1e-300, 1.0))
}

/// Tests whether settings of the same light are too alike.
fn coming_back(all: &Observations, scores: &[Score]) -> Option<Test> {
    let (mean_square, dof) = repeats(all, scores)?;
    let alike = ChiSquared::new(dof).map_or(1.0, |c| (2.0 * c.cdf(dof * mean_square)).min(1.0));
    Some(Test {
        name: THAT_COME_BACK.into(),
        measured: mean_square,
        predicted: 1.0,
        // Standard error of chi-squared over its degrees of freedom.
        std_err: (2.0 / dof).sqrt(),
        z: -as_z(alike),
    })
}

/// Minimum ratio of the long exposures to the short ones, for the test at long exposures (a named choice).
const LONGER: f64 = 4.0;

/// Tests whether settings at long exposures scatter too little (lower tail of chi-square). A lamp is off by a
/// part of its light at any exposure; an exposure is off by a time, which matters less the longer it is.
fn at_long_exposures(all: &Observations, scores: &[Score]) -> Option<Test> {
    let of = |score: &Score| (all.campaign.sets[score.0].exposure_s, score.1);
    let (measured, dof, z) = scatter_of_long(scores.iter().map(of).collect())?;
    let std_err = (2.0 / dof).sqrt();
    Some(Test { name: AT_LONG_EXPOSURES.into(), measured, predicted: 1.0, std_err, z })
}

/// Computes the mean square of the deviations in the longer half of the exposures over that of all, its
/// degrees of freedom and z. Input: (exposure in s, deviation).
fn scatter_of_long(mut sorted: Vec<(f64, f64)>) -> Option<(f64, f64, f64)> {
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (short, long) = sorted.split_at(sorted.len() / 2);
    let middle = |of: &[(f64, f64)]| of.get(of.len() / 2).map(|s| s.0);
    if middle(long)? < LONGER * middle(short)? {
        return None;
    }
    let square = |of: &[(f64, f64)]| of.iter().map(|s| s.1 * s.1).sum::<f64>() / of.len() as f64;
    let (measured, dof) = (square(long) / square(&sorted).max(1e-300), long.len() as f64);
    let alike = ChiSquared::new(dof).map_or(1.0, |c| (2.0 * c.cdf(dof * measured)).min(1.0));
    Some((measured, dof, -as_z(alike)))
}

/// Tests the correlation of successive settings, and the largest step between two runs of them.
fn in_order(scores: &[Score], order: &str) -> Vec<Test> {
    let values: Vec<f64> = scores.iter().map(|s| s.1).collect();
    let name = |what: &str| format!("{what} of light settings, in the order of {order}");
    let (square, product) = succession::sums(values.iter().copied());
    let (predicted, std_err) = succession::of_independent(values.len() as f64);
    let measured = product / square.max(1e-300);
    let z = (measured - predicted) / std_err;
    let mut out = vec![Test { name: name("succession"), measured, predicted, std_err, z }];
    if let Some(step) = step::largest(&values) {
        let (z, size) = (as_z(step.p_value), step.difference);
        let std_err = size.abs() / z.max(1e-9);
        out.push(Test { name: name("step"), measured: size, predicted: 0.0, std_err, z: z.copysign(size) });
    }
    out
}

/// Computes the mean square of the deviations of settings from the mean of those with the same light and
/// exposure, over that of all, and its degrees of freedom. A lamp that is set again does not return to the
/// same error; a response that bends does.
fn repeats(all: &Observations, scores: &[Score]) -> Option<(f64, f64)> {
    let key = |set: usize| (all.campaign.sets[set].light, all.campaign.sets[set].exposure_s.to_bits());
    let mut groups: BTreeMap<_, Vec<f64>> = BTreeMap::new();
    for (i, (set, score)) in scores.iter().enumerate() {
        // Successive sets of the same light are one setting.
        if i == 0 || key(scores[i - 1].0) != key(*set) {
            groups.entry(key(*set)).or_default().push(*score);
        }
    }
    let (mut square, mut dof) = (0.0, 0.0);
    for group in groups.values() {
        let mean = group.iter().sum::<f64>() / group.len() as f64;
        square += group.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        dof += group.len() as f64 - 1.0;
    }
    let whole = scores.iter().map(|s| s.1 * s.1).sum::<f64>() / scores.len() as f64;
    (dof >= 1.0 && whole > 0.0).then(|| (square / dof / whole, dof))
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Effects ask for the tests of the order by these names.
    #[test]
    fn tests_of_the_order_have_their_names() {
        let scores: Vec<Score> = (0..8).map(|k| (k, (k as f64).sin())).collect();
        let names: Vec<String> = in_order(&scores, "the signal").into_iter().map(|t| t.name).collect();
        assert_eq!(names, [ALIKE_IN_SIGNAL, STEP_IN_SIGNAL]);
    }

    /// At most one of 1000 lamps whose 16 settings scatter alike at all exposures is rejected at 3.3 standard
    /// errors (p 1e-3); nearly all of 100 exposures that are off by a time of their own are.
    #[test]
    fn settings_scatter_alike_at_all_exposures() {
        let of = |seed: u64, deviation: &dyn Fn(f64) -> f64| {
            let mut random = PixelRng::new(seed, Stream::Effect, 0, 0, 0);
            let exposure_s = |k: i32| 1e-3 * 1.6f64.powi(k);
            let pairs =
                (0..16).map(|k| (exposure_s(k), random.normal() * deviation(exposure_s(k)))).collect();
            scatter_of_long(pairs).unwrap().2
        };
        let rejected =
            |n: u64, deviation: &dyn Fn(f64) -> f64| (0..n).filter(|s| of(*s, deviation) < -3.3).count();
        assert!(rejected(1000, &|_| 1.0) <= 1);
        let found = rejected(100, &|exposure_s| 1e-3 / exposure_s);
        assert!(found >= 90, "{found}");
    }
}
