//! An entry of the answer: an effect with its values and the statistics that show it.

use super::sensor::tells_gain;
use super::{Cost, Missing, Signature, signatures};
use crate::inference::{Fitted, Residual};
use crate::number::Quantity;
use radcam_sim::effects::{Effect, Parameter, Seen};
use std::collections::BTreeMap;

/// Describes an effect of a model with its values.
pub(super) fn describe(
    fitted: &Fitted,
    effect: &'static dyn Effect,
    confidence: f64,
    seen: &Seen,
) -> Missing {
    let at = fitted.effects.iter().position(|(e, _)| e.id() == effect.id()).unwrap_or(0);
    Missing {
        effect: effect.id().into(),
        confidence,
        share: 0.0,
        cost: Cost::default(),
        error_drop: 0.0,
        parameters: parameters(fitted, at, seen),
        form: effect.form(&fitted.effects[at].1).map(Into::into),
        or_form: None,
        partial: false,
        nearest: Vec::new(),
        tied_with: None,
        evidence: Vec::new(),
        doubt: None,
        by_the_darks_alone: false,
    }
}

/// Returns the parameters of an effect of a model. Parameters that only a combination tells are replaced by
/// that combination.
fn parameters(fitted: &Fitted, at: usize, seen: &Seen) -> BTreeMap<String, Quantity> {
    let ((effect, values), errors) = (&fitted.effects[at], &fitted.std_err[at]);
    let used = effect.parameters().iter().enumerate().filter(|(k, _)| effect.uses(values, *k));
    let own = |(k, p): (usize, &Parameter)| {
        // An undetermined value has the standard deviation of a uniform distribution over its range.
        let (std_err, most) =
            (errors[k].hypot(effect.resolution(k, values, seen)), (p.max - p.min) / 12f64.sqrt());
        let std_err = if std_err > most { most } else { std_err };
        let (by, unit) = in_dn(fitted, p.unit);
        (p.name.to_string(), Quantity::new(by * values[k], by * std_err, unit))
    };
    let mut out: BTreeMap<String, Quantity> = used.map(own).collect();
    let Some(t) = effect.together(values) else { return out };
    // Neighbour covariances tell the parts of a combination apart. Without them the unknown split moves it,
    // by the brightest signal.
    let split = (!seen.neighbours).then_some(seen.peak_e);
    let std_err = fitted.std_err_of(at, &t).hypot(t.unsure_per_e * split.unwrap_or(0.0));
    let of: Vec<usize> = (0..values.len()).filter(|k| t.slopes[*k] != 0.0).collect();
    // Each alone is known ten times worse, relative to its size, than all of them together.
    let alone = of.iter().map(|&k| errors[k] / values[k].abs().max(1e-300)).fold(f64::INFINITY, f64::min);
    if split.is_some() || std_err / t.value.abs().max(1e-300) < 0.1 * alone {
        of.iter().for_each(|k| {
            out.remove(effect.parameters()[*k].name);
        });
        let (by, unit) = in_dn(fitted, t.unit);
        out.insert(t.name.into(), Quantity::new(by * t.value, by * std_err, unit));
    }
    out
}

/// Returns the factor and the unit in which a value is reported: electrons are codes if nothing tells the
/// gain.
fn in_dn(fitted: &Fitted, unit: &'static str) -> (f64, &'static str) {
    match unit {
        "e" if !tells_gain(fitted) => (fitted.base.gain_dn_per_e, "DN"),
        "e/s" if !tells_gain(fitted) => (fitted.base.gain_dn_per_e, "DN/s"),
        unit => (1.0, unit),
    }
}

/// Returns the statistics that deviate without an effect and are mended with it, worst first, and the
/// signature of the effect.
pub(super) fn reasons(without: &[Residual], with: &[Residual], effect: &dyn Effect) -> Vec<String> {
    let deviations = signatures(without);
    let left = signatures(with);
    let mended = |s: &&Signature| left.iter().all(|l| l.name != s.name || l.excess < 0.5 * s.excess);
    let mut out: Vec<String> =
        deviations.iter().filter(mended).take(4).map(|s| format!("without it: {}", s.text)).collect();
    out.push(format!("{}: {}", effect.id(), effect.page().signature));
    out
}
