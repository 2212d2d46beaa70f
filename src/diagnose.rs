//! Which physical effect is missing: every candidate is fitted, the one whose evidence pays for its parameters is added, and
//! the campaign is looked at again, until the model is consistent or nothing helps.

use crate::compare::{
    Comparison, Fitted, Observations, Statistic, compare, fit, fit_with, signatures, start,
};
use crate::noise::Quantity;
use crate::plan::Plan;
use crate::report::chance;
use radcam_sim::effects::{self, Effect, Needs, takes};
use radcam_sim::predict::BaseParameters;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;

/// Effects added at most.
const MOST: usize = 4;
/// Evidence (twice the logarithm of a Bayes factor, by BIC) that an addition needs: with some 25 candidates tried, chance
/// reaches this less than once in a hundred campaigns.
const NEEDED: f64 = 9.0;
/// Candidates within this evidence of the best cannot be told apart.
const TIE: f64 = 6.0;

/// Error from which on a fit says little of the parameters.
const FAR: f64 = 3.0;
/// Share of the excess of the squared error that may be left where the names that were found are right.
const UNEXPLAINED: f64 = 0.05;

/// Share of the excess of the squared error that an addition takes at least, where the error is large.
const LEAST: f64 = 0.03;

/// What an error has beyond that of a model which holds.
fn excess(error: f64) -> f64 {
    (error * error - 1.0).max(0.0)
}

/// What is missing.
#[derive(Debug, Clone, Serialize)]
pub struct Missing {
    /// Identifier; `unknown` where none of the effects explains it.
    pub effect: String,
    /// Share of the evidence among all candidates.
    pub confidence: f64,
    /// How far the error fell by adding it.
    pub error_drop: f64,
    /// Its parameters.
    pub parameters: BTreeMap<String, Quantity>,
    /// Why.
    pub evidence: Vec<String>,
}

/// A rung.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rung {
    /// What was added; null for the model as given.
    pub added: Option<String>,
    /// Error on frames that the fit did not see.
    pub error: f64,
    /// Chance of such residuals.
    pub p_value: f64,
}

/// The whole answer.
#[derive(Debug, Clone, Serialize)]
pub struct Diagnosis {
    /// Whether the model as given describes the campaign.
    pub consistent: bool,
    /// Its error.
    pub error_before: f64,
    /// Error with all that was added.
    pub error_after: f64,
    /// What is missing, strongest first.
    pub missing: Vec<Missing>,
    /// The ladder.
    pub ladder: Vec<Rung>,
    /// The one measurement that would tell the closest candidates apart.
    pub next_measurement: Option<String>,
    /// That measurement as a plan.
    #[serde(skip)]
    pub next_plan: Option<Plan>,
    /// What could not be looked at, and what is left over.
    pub notes: Vec<String>,
    /// The last model.
    #[serde(skip)]
    pub fitted: Option<Fitted>,
    /// Comparisons of the first and the last model.
    #[serde(skip)]
    pub comparisons: Vec<Comparison>,
}

/// A candidate after its fit.
struct Candidate {
    fitted: Fitted,
    effect: &'static dyn Effect,
    evidence: f64,
}

/// Looks for what a model lacks. `base` and `effects` are the model as given; without a base the campaign's own is taken.
pub fn diagnose(
    all: &Observations,
    base: Option<BaseParameters>,
    effects: Vec<(&'static dyn Effect, Vec<f64>)>,
    progress: &mut dyn FnMut(&str),
) -> Diagnosis {
    let base = base.unwrap_or_else(|| start(all));
    let has = |kind: Statistic| all.all.iter().any(|o| o.kind == kind);
    let there = match (has(Statistic::FrameMeanVariance), has(Statistic::Covariance(0, 1))) {
        (true, _) => Needs::Frames,
        (_, true) => Needs::Covariances,
        _ => Needs::Variances,
    };
    let n = all.all.len() as f64;
    let mut now = fit(all, None, &base, &effects);
    let first = compare(all, &now.base, &now.effects);
    let mut ladder = vec![Rung { added: None, error: first.error, p_value: first.p_value }];
    let mut missing = Vec::new();
    let (mut next_measurement, mut sets) = (None, takes::PAIRS);
    let mut last = first.clone();
    for _ in 0..MOST {
        progress(&format!("error {:.2}; trying every effect", last.error));
        let ids: Vec<&str> = now.effects.iter().map(|(e, _)| e.id()).collect();
        let mut candidates: Vec<Candidate> = effects::all()
            .into_par_iter()
            .filter(|e| !ids.contains(&e.id()) && e.needs() <= there)
            .filter_map(|effect| {
                let fitted = fit_with(effect, &[], all, &now, last.error > FAR)?;
                let parameters = effect.parameters().iter().filter(|p| !p.is_choice()).count() as f64;
                let evidence = now.objective - fitted.objective - parameters * n.ln();
                Some(Candidate { fitted, effect, evidence })
            })
            .collect();
        candidates.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        for c in candidates.iter().take(6) {
            let at = c.fitted.effects.len() - 1;
            let (values, errors) = (&c.fitted.effects[at].1, &c.fitted.std_err[at]);
            tracing::debug!("{}: evidence {:.1}, {values:?} +- {errors:?}", c.effect.id(), c.evidence);
        }
        // A parameter that is nothing within its error explains nothing.
        candidates.retain(|c| {
            if c.evidence > 100.0 {
                return true;
            }
            let at = c.fitted.effects.len() - 1;
            let (values, errors) = (&c.fitted.effects[at].1, &c.fitted.std_err[at]);
            let free = || {
                let all = c.effect.parameters().iter().zip(values.iter().zip(errors));
                all.filter(|(p, _)| !p.is_choice()).map(|(p, (v, e))| (p.min.max(0.0).min(p.max), *v, *e))
            };
            // Two that only their product tells are each unknown, and together something.
            let product = free().count() > 1 && free().all(|(_, v, e)| e > 3.0 * v.abs());
            product || free().any(|(zero, v, e)| (v - zero).abs() > 2.5 * e)
        });
        let Some(best) = candidates.first().filter(|c| c.evidence > NEEDED) else { break };
        let after = compare(all, &best.fitted.base, &best.fitted.effects);
        tracing::debug!("with {}: error {:.4}, was {:.4}", best.effect.id(), after.error, last.error);
        // What does not help on frames that the fit did not see is no effect; nor is what takes next to nothing of a large error.
        let next_to_nothing = last.error > 1.2 && excess(after.error) > (1.0 - LEAST) * excess(last.error);
        if after.error > last.error - 1e-3 || next_to_nothing {
            break;
        }
        let weight = |c: &Candidate| (0.5 * (c.evidence - best.evidence)).max(-300.0).exp();
        let sum: f64 = candidates.iter().map(weight).sum::<f64>() + (-0.5 * best.evidence).max(-300.0).exp();
        let why = reasons(&last, &after, best.effect);
        let close: Vec<&Candidate> =
            candidates.iter().skip(1).take_while(|c| best.evidence - c.evidence < TIE).collect();
        let mut entry = describe(best, weight(best) / sum, last.error - after.error);
        entry.evidence = why;
        if let Some(other) = close.first() {
            entry.evidence.push(format!("a tie: {} explains it as well", other.effect.id()));
            sets = best.effect.page().sets;
            next_measurement = Some(format!(
                "{} or {}: {}",
                best.effect.id(),
                other.effect.id(),
                best.effect.page().measure
            ));
        } else if let Some(other) = candidates.get(1).filter(|c| c.evidence > NEEDED) {
            entry.evidence.push(format!(
                "next best: {}, its evidence {:.0} below",
                other.effect.id(),
                best.evidence - other.evidence
            ));
        }
        missing.push(entry);
        for other in close {
            let mut entry = describe(other, weight(other) / sum, last.error - after.error);
            entry
                .evidence
                .push(format!("a tie with {}: this campaign cannot tell them apart", best.effect.id()));
            missing.push(entry);
        }
        ladder.push(Rung {
            added: Some(best.effect.id().to_string()),
            error: after.error,
            p_value: after.p_value,
        });
        now = best.fitted.clone();
        last = after;
    }
    let mut notes = all.missing.clone();
    if last.p_value < crate::compare::P_LIMIT {
        let left = signatures(&last.residuals);
        let evidence: Vec<String> = left.iter().take(5).map(|s| s.text.clone()).collect();
        let weak = evidence.is_empty() || last.error < 1.15;
        if weak {
            notes.push(format!("what is left is small: error {:.3}, p {}", last.error, chance(last.p_value)));
        }
        // What was added explains little of the whole: it is near the truth at best, and the truth has no name here.
        let share = excess(last.error) / excess(first.error).max(1e-9);
        let nameless = last.error > 1.2 && share > UNEXPLAINED;
        if !weak || missing.is_empty() {
            let mut unknown = Missing {
                effect: "unknown".into(),
                confidence: 1.0,
                error_drop: 0.0,
                parameters: BTreeMap::new(),
                evidence,
            };
            if nameless {
                unknown.evidence =
                    signatures(&first.residuals).iter().take(6).map(|s| s.text.clone()).collect();
                for m in &mut missing {
                    m.evidence
                        .push("explains a part only: its shape is near, its name need not be right".into());
                }
                missing.insert(0, unknown);
            } else {
                missing.push(unknown);
            }
            if next_measurement.is_none() {
                next_measurement = Some(
                    "the statistic that strays most, at more levels and frames; a custom formula in the model file can describe it"
                        .into(),
                );
            }
        }
    }
    if all.means_given && !missing.is_empty() {
        next_measurement = Some(
            "flats with their neighbour covariances (brighter-fatter) and an exposure sweep at fixed light (nonlinearity)".into(),
        );
    }
    if all.means_given {
        sets = takes::SWEEP;
    }
    let next_plan = next_measurement.as_ref().map(|about| Plan::of_takes(about, sets));
    let added: Vec<Missing> = missing;
    Diagnosis {
        consistent: added.is_empty(),
        error_before: first.error,
        error_after: last.error,
        missing: added,
        ladder,
        next_measurement,
        next_plan,
        notes,
        fitted: Some(now),
        comparisons: vec![first, last],
    }
}

fn describe(c: &Candidate, confidence: f64, error_drop: f64) -> Missing {
    let at = c.fitted.effects.len() - 1;
    let values = c.fitted.effects[at].1.iter().zip(&c.fitted.std_err[at]);
    let parameters = c
        .effect
        .parameters()
        .iter()
        .zip(values)
        .map(|(p, (&value, &std_err))| (p.name.to_string(), Quantity { value, std_err, unit: p.unit }))
        .collect();
    Missing { effect: c.effect.id().into(), confidence, error_drop, parameters, evidence: Vec::new() }
}

/// The statistics that the addition mended, worst first, and what the effect does.
fn reasons(before: &Comparison, after: &Comparison, effect: &dyn Effect) -> Vec<String> {
    let strayed = signatures(&before.residuals);
    let left = signatures(&after.residuals);
    let name = |text: &str| text.split(':').next().unwrap_or_default().to_string();
    let mut out: Vec<String> = strayed
        .iter()
        .filter(|s| left.iter().all(|l| name(&l.text) != name(&s.text) || l.excess < 0.5 * s.excess))
        .take(4)
        .map(|s| s.text.clone())
        .collect();
    out.push(format!("{}: {}", effect.id(), effect.page().signature));
    out
}
