//! Holds a model against a campaign: fitted on one half of the frames, judged on the other.

mod expect;
mod fit;
mod global;
mod observe;
mod read;
mod scene;
mod table;
mod words;

pub use expect::Expected;
pub use fit::{Effects, Fitted, Given, fit, fit_with, searched, start};
pub use observe::{Observable, Observations, ObserveError, Statistic, of_dataset, of_table};
pub use scene::{Direction, ScenePair};
pub use words::{Signature, signatures};

use radcam_sim::effects::Effect;
use serde::Serialize;

/// Below this chance a model does not describe the campaign.
pub const P_LIMIT: f64 = 1e-3;

/// One residual on frames that the fit did not see.
#[derive(Debug, Clone, PartialEq, Serialize)]
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
    /// Mean of the set above the level of zero charge, DN.
    #[serde(skip)]
    pub level_dn: f64,
    /// The statistic itself.
    #[serde(skip)]
    pub statistic: Option<Statistic>,
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
    /// Every residual.
    pub residuals: Vec<Residual>,
    /// What could not be looked at.
    pub not_looked_at: Vec<String>,
}

/// Fits a model on each half of the frames and judges it on the other.
///
/// Halves take turns from set to set: the first frames after a change of level belong now to the one, now to the other. Whole
/// frames go to one half, so that noise that runs from frame to frame within a chunk stays on one side.
pub fn compare(
    all: &Observations,
    base: &radcam_sim::predict::BaseParameters,
    effects: &[(&'static dyn Effect, Vec<f64>)],
) -> Comparison {
    let mut residuals = Vec::new();
    let (mut sum, mut count) = (0.0, 0.0);
    let (first, second) =
        rayon::join(|| fit(all, Some(0), base, effects), || fit(all, Some(1), base, effects));
    for (fitted, other) in [(&first, 1u8), (&second, 0u8)] {
        for (o, e) in fitted.judged(all, other) {
            // Light levels that only one half has cannot be judged on the other.
            if o.kind == Statistic::Mean && !level_seen(all, o, 1 - other) {
                continue;
            }
            let z = e.z();
            if !z.is_finite() {
                continue;
            }
            sum += z * z;
            count += 1.0;
            let level_dn =
                o.set.map_or(0.0, |s| measured_mean(all, s).unwrap_or(0.0) - fitted.base.offset_dn);
            residuals.push(Residual {
                observable: o.kind.name(),
                set: o.set.map(|s| all.set_numbers[s]),
                measured: o.measured.value,
                predicted: e.value,
                std_err: e.std_err,
                z,
                level_dn,
                statistic: Some(o.kind),
            });
        }
    }
    let error = (sum / f64::max(count, 1.0)).sqrt();
    let p_value = p_value(&residuals);
    Comparison {
        error,
        p_value,
        consistent: p_value >= P_LIMIT,
        residuals,
        not_looked_at: all.missing.clone(),
    }
}

/// Whether a light level has a mean in a half.
fn level_seen(all: &Observations, o: &Observable, half: u8) -> bool {
    let light = |o: &Observable| o.set.and_then(|s| all.campaign.sets[s].light);
    match light(o) {
        None => true,
        Some(l) => all.all.iter().any(|p| p.kind == Statistic::Mean && p.half == half && light(p) == Some(l)),
    }
}

/// Mean of a set over its chunks, DN.
fn measured_mean(all: &Observations, set: usize) -> Option<f64> {
    let means = all.all.iter().filter(|o| o.kind == Statistic::Mean && o.set == Some(set));
    let (sum, n) = means.fold((0.0, 0.0), |(s, n), o| (s + o.measured.value, n + 1.0));
    (n > 0.0).then(|| sum / n)
}

/// Chance of residuals as large as these: of their sum of squares, of the largest one, and of the largest sum of squares of
/// any one statistic, the smallest of them times their number.
fn p_value(residuals: &[Residual]) -> f64 {
    let tail = |squares: f64, n: f64, slack: f64| {
        // Errors are known to some per cent and parameters are fitted: the squares scatter a little more than a chi-square.
        let z = (squares - n * (1.0 + slack)) / (2.0 * n * 1.3).sqrt();
        0.5 * statrs::function::erf::erfc(z / std::f64::consts::SQRT_2)
    };
    let n = residuals.len() as f64;
    if n < 1.0 {
        return f64::NAN;
    }
    let whole = tail(residuals.iter().map(|r| r.z * r.z).sum(), n, 0.05);
    let largest = residuals.iter().map(|r| r.z.abs()).fold(0.0, f64::max);
    let single = (n * statrs::function::erf::erfc(largest / 1.1 / std::f64::consts::SQRT_2)).min(1.0);
    let mut names: Vec<&str> = residuals.iter().map(|r| r.observable.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    let group = names
        .iter()
        .map(|name| {
            let of: Vec<f64> =
                residuals.iter().filter(|r| r.observable == *name).map(|r| r.z * r.z).collect();
            let n = of.len() as f64;
            // Few of a kind: the chi-square itself.
            let squares: f64 = of.iter().sum();
            let chi2 = statrs::distribution::ChiSquared::new(n)
                .map_or(1.0, |c| statrs::distribution::ContinuousCDF::sf(&c, squares / 1.25));
            chi2.min(1.0)
        })
        .fold(1.0, f64::min)
        * names.len() as f64;
    (3.0 * whole.min(single).min(group)).min(1.0)
}
