//! Holds a model against a campaign: fitted on one half of the frames, judged on the other.
//!
//! Halves take turns from set to set: the first frames after a change of level belong now to the one, now to the other. Whole
//! frames go to one half, so that noise that runs from frame to frame within a chunk stays on one side.

use super::fit::{Fitted, fit_half, halves};
use super::layout::Layout;
use super::slopes::Slopes;
use super::system::System;
use super::white::White;
use crate::agreement::{Agreement, P_LIMIT};
use crate::observables::{Half, Observable, Observations, Statistic, mean, settling};
use crate::statistics::{step, succession};
use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};
use statrs::function::erf::erfc_inv;
use std::collections::BTreeMap;

/// One residual on frames that the fit did not see.
#[derive(Debug, Clone, Serialize)]
pub struct Residual {
    /// Which statistic.
    pub observable: String,
    /// Number of the set; null for the whole campaign.
    pub set: Option<u32>,
    /// What was measured, DN or DN^2.
    pub measured: f64,
    /// What the model expects.
    pub predicted: f64,
    /// Standard error of the difference.
    pub std_err: f64,
    /// Their difference over its standard error.
    pub z: f64,
    /// The same once what the statistics of the same frames have in common is taken for one number.
    #[serde(skip)]
    pub independent_z: f64,
    /// Mean of the set above the level of zero charge, DN.
    #[serde(skip)]
    pub level_dn: f64,
    /// The statistic itself, and which of its several.
    #[serde(skip)]
    pub statistic: (&'static dyn Statistic, usize),
}

impl Residual {
    /// Whether it is set by what came before, and not by its level.
    pub fn is_of_first_frames(&self) -> bool {
        self.statistic.0.id() == settling::This.id()
    }

    /// What a deviation means, in words.
    pub fn meaning(&self) -> &'static str {
        self.statistic.0.meaning(self.statistic.1)
    }
}

/// A comparison.
#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    /// Root mean square of the standardised residuals; 1 is agreement.
    pub error: f64,
    /// Chance of residuals as large as these, under many comparisons.
    pub p_value: f64,
    /// Whether the model describes the campaign.
    pub consistent: bool,
    /// The same, with doubt.
    pub agreement: Agreement,
    /// Every residual.
    pub residuals: Vec<Residual>,
    /// What could not be looked at.
    pub not_looked_at: Vec<String>,
}

/// Fits a model on each half of the frames and judges it on the other.
pub fn compare(all: &Observations, model: &Fitted) -> Comparison {
    let of = |half| fit_half(all, half, model);
    let (first, second) = rayon::join(|| of(Half::First), || of(Half::Second));
    let mut residuals = Vec::new();
    for (fitted, half) in [(&first, Half::First), (&second, Half::Second)] {
        residuals.extend(judged(all, fitted, half));
    }
    let n = residuals.len() as f64;
    let error = (residuals.iter().map(|r| r.z * r.z).sum::<f64>() / n.max(1.0)).sqrt();
    let orders = setting_orders(all, model);
    // Of so few numbers the smallest chance times theirs and that of all others.
    let by_order = orders.iter().map(|r| two_sided(r.z)).fold(1.0, f64::min) * (orders.len() + 1) as f64;
    let p_value = p_value(&residuals).min(by_order);
    residuals.extend(orders);
    Comparison {
        error,
        p_value,
        consistent: p_value >= P_LIMIT,
        agreement: Agreement::of(p_value),
        residuals,
        not_looked_at: all.missing.clone(),
    }
}

/// Sets from which on the order of their settings tells something.
const FEWEST_SETTINGS: usize = 8;

/// Whether the settings of sets scatter one by one, as they are said to: whether those of the same light differ as others do, the correlation
/// of successive ones, and the largest step between two runs of them, in the order of time and in that of the signal. A lamp that jumps, a
/// response that bends or has a step is no scatter.
fn setting_orders(all: &Observations, model: &Fitted) -> Vec<Residual> {
    let layout = Layout::new(all, &halves(None));
    let state = layout.at(&model.free, &model.point);
    let mut scores = System::new(&layout, &model.free, &model.point, &state, &model.slopes).setting_scores();
    // The only set at a light tells nothing: its light is what it shows.
    scores.retain(|s| s.1.abs() > 1e-6);
    if scores.len() < FEWEST_SETTINGS {
        return Vec::new();
    }
    let levels = levels(all, model.base.offset_dn);
    let told = |observable: String, measured: f64, predicted: f64, std_err: f64, z: f64| Residual {
        observable,
        set: None,
        measured,
        predicted,
        std_err,
        z,
        independent_z: z,
        level_dn: 0.0,
        statistic: (&mean::This, 0),
    };
    // As many standard deviations as have this chance.
    let as_z = |p_value: f64| std::f64::consts::SQRT_2 * erfc_inv(p_value.clamp(1e-300, 1.0));
    let mut out = Vec::new();
    if let Some((mean_square, dof)) = repeats(all, &scores) {
        // They may be too alike; chi-squared has the deviation sqrt(2 / dof).
        let alike = ChiSquared::new(dof).map_or(1.0, |c| (2.0 * c.cdf(dof * mean_square)).min(1.0));
        let name = "light settings that come back".to_string();
        out.push(told(name, mean_square, 1.0, (2.0 / dof).sqrt(), -as_z(alike)));
    }
    for by_signal in [false, true] {
        let name = if by_signal { "the signal" } else { "time" };
        scores.sort_by(|a, b| if by_signal { levels[a.0].total_cmp(&levels[b.0]) } else { a.0.cmp(&b.0) });
        let (square, product) = succession::sums(scores.iter().map(|s| s.1));
        let (predicted, std_err) = succession::of_independent(scores.len() as f64);
        let measured = product / square.max(1e-300);
        let of_light = |what: &str| format!("{what} of light settings, in the order of {name}");
        out.push(told(
            of_light("succession"),
            measured,
            predicted,
            std_err,
            (measured - predicted) / std_err,
        ));
        let values: Vec<f64> = scores.iter().map(|s| s.1).collect();
        if let Some(step) = step::largest(&values) {
            let (z, size) = (as_z(step.p_value), step.difference);
            out.push(told(of_light("step"), size, 0.0, size.abs() / z.max(1e-9), z.copysign(size)));
        }
    }
    out
}

/// Mean square, over that of all, of the deviations of settings from the mean of those with the same light and exposure, and its degrees of
/// freedom: a lamp that is set again does not come back to the same error, and a response that bends does.
fn repeats(all: &Observations, scores: &[(usize, f64)]) -> Option<(f64, f64)> {
    let key = |set: usize| (all.campaign.sets[set].light, all.campaign.sets[set].exposure_s.to_bits());
    let mut groups: BTreeMap<_, Vec<f64>> = BTreeMap::new();
    for (i, (set, score)) in scores.iter().enumerate() {
        // Sets in a row of the same light are one setting.
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

/// Mean of every set above a zero, DN.
fn levels(all: &Observations, zero_dn: f64) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); all.campaign.sets.len()];
    for o in all.of(&mean::This) {
        if let Some(s) = o.set {
            sums[s] = (sums[s].0 + o.measured.value, sums[s].1 + 1.0);
        }
    }
    sums.iter().map(|(sum, n)| if *n > 0.0 { sum / n - zero_dn } else { 0.0 }).collect()
}

/// The residuals of the other half under a fit to this one; the error of the fit is in theirs.
fn judged(all: &Observations, fitted: &Fitted, half: Half) -> Vec<Residual> {
    let own = Layout::new(all, &halves(Some(half)));
    let settings = {
        let state = own.at(&fitted.free, &fitted.point);
        let slopes = Slopes::beside(Some(&fitted.slopes), &own, &fitted.free, &fitted.point, &state);
        System::new(&own, &fitted.free, &fitted.point, &state, &slopes).settings()
    };
    let layout = Layout::new(all, &[half.other()]);
    let state = layout.at(&fitted.free, &fitted.point);
    let seen = lights_seen(all, half);
    let is_seen = |o: &Observable| {
        let light = o.set.and_then(|s| all.campaign.sets[s].light);
        light.is_none_or(|l| seen[l])
    };
    let levels = levels(all, fitted.base.offset_dn);
    // How errors of what was fitted show in frames that the fit did not see: slopes that only served the fit would not do.
    let slopes = Slopes::new(&layout, &fitted.free, &fitted.point, &state).over_errors(&state);
    let n = fitted.free.common.len();
    let prediction = fitted.predict(all);
    let all_light = fitted.free.place(super::free::Common::Light).unwrap_or(0);
    // Square of what the light of a set moves its mean by, DN^2: the unit of its setting.
    let mut units = vec![0.0; all.campaign.sets.len()];
    for (r, (o, e)) in layout.rows.iter().zip(&state.expected).enumerate() {
        if let Some(set) = o.set.filter(|_| o.is(&mean::This)) {
            units[set] = (slopes[r * n + all_light] * e.normal.2).powi(2);
        }
    }
    let mut out = Vec::new();
    let mut places = Vec::new();
    let mut wider_by = vec![1.0; layout.rows.len()];
    for (r, (o, e)) in layout.rows.iter().zip(&state.expected).enumerate() {
        // Light levels that only one half has cannot be judged on the other.
        if o.statistic.sees_light() && !is_seen(o) {
            continue;
        }
        let row = &slopes[r * n..][..n];
        let level = o.set.and_then(|s| all.campaign.sets[s].light);
        let factor = level.and_then(|l| fitted.free.light_of_level.get(l).copied().flatten());
        let light = row[all_light];
        let mut variance = 1.0 + fitted.covariance.of(row, factor.map(|k| (k, light))).max(0.0);
        let mut z = e.z();
        if o.statistic.sees_light()
            && let Some(set) = o.set
        {
            // A setting is told by the frames of the set that the fit saw, and else it is as nominal.
            let told = settings.iter().find(|s| s.0 == set);
            let scatter = prediction.sets[set].setting / units[set].max(1e-30);
            let (shift, left) = told.map_or((0.0, scatter), |s| (s.1, s.2));
            if prediction.sets[set].setting > 0.0 {
                z -= light * shift;
                variance += light * light * left;
            }
        }
        let wider = variance.sqrt();
        z /= wider;
        if z.is_finite() {
            out.push(residual(all, o, e.value, e.std_err * wider, z, &levels));
            places.push(r);
            wider_by[r] = wider;
        }
    }
    let mut z = vec![0.0; layout.rows.len()];
    places.iter().zip(&out).for_each(|(r, residual)| z[*r] = residual.z);
    White::new(&layout, &state.expected, |r| wider_by[r]).apply(&mut z, 1);
    places.iter().zip(&mut out).for_each(|(r, residual)| residual.independent_z = z[*r]);
    out
}

fn residual(
    all: &Observations,
    o: &Observable,
    predicted: f64,
    std_err: f64,
    z: f64,
    levels: &[f64],
) -> Residual {
    Residual {
        observable: o.name(),
        set: o.set.map(|s| all.set_numbers[s]),
        measured: o.measured.value,
        predicted,
        std_err,
        z,
        independent_z: z,
        level_dn: o.set.map_or(0.0, |s| levels[s]),
        statistic: (o.statistic, o.index),
    }
}

/// The residuals of everything under a fit to everything.
pub(crate) fn residuals_of(all: &Observations, fitted: &Fitted) -> Vec<Residual> {
    let layout = Layout::new(all, &halves(None));
    let state = layout.at(&fitted.free, &fitted.point);
    let slopes = Slopes::beside(Some(&fitted.slopes), &layout, &fitted.free, &fitted.point, &state);
    let system = System::new(&layout, &fitted.free, &fitted.point, &state, &slopes);
    let levels = levels(all, fitted.base.offset_dn);
    let rows = layout.rows.iter().zip(&state.expected).zip(&system.z);
    rows.filter(|(_, z)| z.is_finite())
        .map(|((o, e), z)| residual(all, o, e.value, e.std_err, *z, &levels))
        .collect()
}

/// Whether each light level has a mean in a half.
fn lights_seen(all: &Observations, half: Half) -> Vec<bool> {
    let levels = all.campaign.sets.iter().filter_map(|s| s.light).max().map_or(0, |l| l + 1);
    let mut seen = vec![false; levels];
    for o in all.of(&mean::This).filter(|o| o.half == half || o.half == Half::Both) {
        if let Some(l) = o.set.and_then(|s| all.campaign.sets[s].light) {
            seen[l] = true;
        }
    }
    seen
}

/// What the residuals of one statistic say together.
#[derive(Debug, Clone)]
pub struct OfStatistic {
    /// Name of the statistic.
    pub name: String,
    /// Chance of a sum of squares, or of a sum, as large as theirs.
    pub chance: f64,
    /// By how much the larger of the sum of squares and the square of the sum over n passes what chance expects.
    pub excess: f64,
}

/// By so much a statistic's standardised residuals may pass what chance gives, since errors are predicted to some per cent and parameters
/// were fitted: the sum of their squares by a quarter, their mean by a fifth of its deviation.
const SLACK_OF_SQUARES: f64 = 1.25;
/// See [`SLACK_OF_SQUARES`].
const SLACK_OF_MEAN: f64 = 1.2;

/// The residuals by statistic.
pub fn by_statistic(residuals: &[Residual]) -> Vec<OfStatistic> {
    let mut of: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    residuals.iter().for_each(|r| of.entry(r.observable.as_str()).or_default().push(r.independent_z));
    let together = |(name, z): (&str, Vec<f64>)| {
        let n = z.len() as f64;
        let squares: f64 = z.iter().map(|z| z * z).sum();
        let sum: f64 = z.iter().sum();
        let chi2 = ChiSquared::new(n).map_or(1.0, |c| c.sf(squares / SLACK_OF_SQUARES));
        // What strays a little to one side in every set.
        let aside = two_sided(sum / n.sqrt() / SLACK_OF_MEAN);
        OfStatistic {
            name: name.to_string(),
            chance: (2.0 * chi2.min(aside)).min(1.0),
            excess: (squares - n).max(sum * sum / n - 1.0).max(0.0),
        }
    };
    of.into_iter().map(together).collect()
}

/// Chance that a normal number lies at least so far off.
fn two_sided(z: f64) -> f64 {
    statrs::function::erf::erfc(z.abs() / std::f64::consts::SQRT_2)
}

/// Chance of residuals as large as these: of their sum of squares, of the largest one, and of those of any one statistic, the smallest of
/// them times their number.
fn p_value(residuals: &[Residual]) -> f64 {
    let n = residuals.len() as f64;
    if n < 1.0 {
        return f64::NAN;
    }
    // Errors are known to some per cent and parameters are fitted: the squares scatter a little more than a chi-square.
    let squares: f64 = residuals.iter().map(|r| r.independent_z * r.independent_z).sum();
    let z = (squares - n * 1.05) / (2.0 * n * 1.3).sqrt();
    let whole = 0.5 * statrs::function::erf::erfc(z / std::f64::consts::SQRT_2);
    let largest = residuals.iter().map(|r| r.independent_z.abs()).fold(0.0, f64::max);
    let single = (n * two_sided(largest / 1.1)).min(1.0);
    let groups = by_statistic(residuals);
    let group = groups.iter().map(|g| g.chance).fold(1.0, f64::min) * groups.len() as f64;
    (3.0 * whole.min(single).min(group)).min(1.0)
}
