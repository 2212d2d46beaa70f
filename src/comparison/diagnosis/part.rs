//! Parts of the fitted model: each effect with its own evidence, and the alternatives that explain it as
//! well.

use super::search::{Candidate, NEEDED, score, without};
use super::share::MATTERS;
use super::{HOLDS, TIE, unknown};
use crate::agreement::DOUBT;
use crate::dataset::Kind;
use crate::inference::{Comparison, Fitted, Residual, compare, fit, fit_near, residuals_of};
use crate::number::six_digits;
use crate::observables::Observations;
use radcam_sim::effects::Effect;
use rayon::prelude::*;

/// Discount on the evidence of the nameless model: a free curve follows the last per cent of any
/// statistic better than physics does.
const NAMELESS_DISCOUNT: f64 = MATTERS;
/// Maximum mean squared residual of a fit with which a campaign may agree: its chance for twenty residuals is
/// one in a thousand.
pub(super) const MAX_MEAN_SQUARE: f64 = 2.3;
/// Minimum evidence of an effect beside others with which the campaign agrees, if the error on held-out
/// frames does not fall with it (a named choice: five standard errors).
const BESIDE: f64 = 25.0;
/// Evidence that is not worth more than a bare mention (Kass and Raftery 1995, section 3.2).
pub(super) const BARE_MENTION: f64 = 2.0;

/// Effect of the fitted model with its own evidence.
pub(super) struct Part {
    /// Effect.
    pub effect: &'static dyn Effect,
    /// Evidence lost without the effect.
    pub evidence: f64,
    /// Mean squared residual of the whole model, at least 1: evidence counts less by this factor (McCullagh
    /// and Nelder 1989, 4.5).
    pub dispersion: f64,
    /// Alternatives in place of the effect, most evidence first.
    pub others: Vec<Candidate>,
    /// Evidence of the nameless model in place of the effect.
    pub nameless: f64,
    /// Model without the effect.
    pub rest: Fitted,
    /// Residuals of the model without the effect.
    pub without: Vec<Residual>,
    /// True for a drift in a campaign in which one light has two sets of flats and every other has one: a
    /// lamp that returns to another light explains that too.
    pub hangs_on_one_return: bool,
}

impl Part {
    /// Returns the alternatives that explain as much as the effect.
    pub fn tied(&self) -> Vec<&Candidate> {
        let same = |c: &&Candidate| self.evidence - c.evidence < TIE * self.dispersion;
        let returns =
            |c: &&Candidate| self.hangs_on_one_return && c.effect.sets_each() && c.evidence > NEEDED;
        self.others.iter().filter(|c| same(c) || returns(c)).collect()
    }

    /// Returns the share of one explanation of a part in the evidence of all: the effect, the alternatives,
    /// nothing at all, and the nameless model.
    pub fn confidence(&self, evidence: f64) -> f64 {
        let all = self.others.iter().map(|c| c.evidence).chain([self.evidence, 0.0, self.nameless]);
        let sum: f64 = all.map(|e| (0.5 * (e - evidence)).clamp(-300.0, 300.0).exp()).sum();
        1.0 / sum
    }

    /// Returns a sentence on the nameless model if it explains the part better than the effect does.
    pub fn better(&self) -> Option<String> {
        (self.nameless > self.evidence + BARE_MENTION).then(|| {
            format!(
                "a smooth function of the level that has no name explains it better than {} does: evidence {:.0} and {:.0}",
                self.effect.id(),
                self.nameless,
                self.evidence
            )
        })
    }
}

/// Returns the parts of a fitted model: every effect that was added to the given model.
pub(super) fn left_out(all: &Observations, model: &Fitted, whole: &Fitted) -> Vec<Part> {
    let given = model.effects.len();
    let part = |i: usize| {
        let rest = if whole.effects.len() == given + 1 {
            model.clone()
        } else {
            // Refitted from the end of the whole and from the start: a shallow minimum of the rest is no
            // evidence.
            let near = without(all, whole, i);
            let afresh = fit_near(all, model, &near.effects);
            if afresh.objective < near.objective { afresh } else { near }
        };
        let effect = whole.effects[i].0;
        let evidence = score(all, &rest) - score(all, whole);
        let without = residuals_of(all, &rest);
        // Darks alone have no levels for a function to follow.
        let lit = all.kinds.iter().any(|kind| *kind != Kind::Dark);
        let of_levels = if lit { unknown::evidence(&without, all.list.len() as f64) } else { 0.0 };
        let nameless = (1.0 - NAMELESS_DISCOUNT) * of_levels;
        let dispersion = whole.mean_square.max(1.0);
        let hangs_on_one_return = effect.is_drift_of_level() && all.repeated_lights() == 1;
        Part {
            effect,
            evidence,
            dispersion,
            others: Vec::new(),
            nameless,
            rest,
            without,
            hangs_on_one_return,
        }
    };
    (given..whole.effects.len()).into_par_iter().map(part).collect()
}

/// Returns the model without an effect that does not belong there, if there is one. Such an effect does not
/// pay beside the others, or the campaign contradicts it and agrees with the rest (settings that are in
/// order, say).
pub(super) fn without_one<'p>(
    all: &Observations,
    parts: &'p [Part],
    last: &Comparison,
) -> Option<&'p Fitted> {
    let weakest = parts.iter().min_by(|a, b| a.evidence.total_cmp(&b.evidence));
    if let Some(idle) = weakest.filter(|p| p.evidence < NEEDED) {
        return Some(&idle.rest);
    }
    if parts.len() < 2 {
        return None;
    }
    let is_idle = |p: &&Part| {
        let rest = compare(all, &p.rest);
        rest.p_value >= DOUBT && rest.error <= last.error
    };
    if let Some(idle) = weakest.filter(|p| p.evidence < BESIDE).filter(is_idle) {
        return Some(&idle.rest);
    }
    if last.p_value >= HOLDS {
        return None;
    }
    let near = parts.iter().filter(|p| p.rest.mean_square < MAX_MEAN_SQUARE);
    near.map(|p| &p.rest).find(|rest| compare(all, rest).p_value >= HOLDS)
}

/// Equally good model with another form of one of its effects.
pub(super) struct OtherForm {
    /// Place of the effect in the model.
    pub at: usize,
    /// Fit of the model.
    pub fitted: Fitted,
}

impl OtherForm {
    /// Returns the identifier of the effect.
    pub fn id(&self) -> &'static str {
        self.fitted.effects[self.at].0.id()
    }

    /// Returns the form in words.
    pub fn name(&self) -> &'static str {
        let (effect, values) = &self.fitted.effects[self.at];
        effect.form(values).unwrap_or("another form")
    }

    /// Returns a sentence on the tie.
    pub fn words(&self) -> String {
        let form = self.name();
        let gain = six_digits(self.fitted.base.gain_dn_per_e);
        format!("a tie: \"{form}\" explains it as well, with a gain of {gain} DN/e")
    }
}

/// Fits the other forms of the effects found that give the same means at another gain, and returns those
/// that the campaign does not tell from the fitted one.
pub(super) fn other_forms(all: &Observations, parts: &[Part], whole: &Fitted) -> Vec<OtherForm> {
    let is_found = |id: &str| parts.iter().any(|p| p.effect.id() == id);
    let found = whole.effects.iter().enumerate().filter(|(_, (e, _))| is_found(e.id()));
    let forms: Vec<(usize, Vec<f64>)> =
        found.flat_map(|(at, (e, p))| e.forms_with_same_means(p).into_iter().map(move |p| (at, p))).collect();
    let max_score = score(all, whole) + TIE * whole.mean_square.max(1.0);
    let fitted = forms.into_par_iter().map(|(at, values)| {
        let mut effects = whole.effects.clone();
        effects[at].1 = values;
        OtherForm { at, fitted: fit(all, &whole.base, &effects) }
    });
    fitted.filter(|form| score(all, &form.fitted) < max_score).collect()
}

/// Returns the models that explain the campaign as well as the whole: with alternatives, and with other
/// forms.
pub(super) fn equally_good<'p>(parts: &'p [Part], forms: &'p [OtherForm], whole: &Fitted) -> Vec<&'p Fitted> {
    let has = |id: &str| whole.effects.iter().any(|(e, _)| e.id() == id);
    let tied = parts.iter().flat_map(Part::tied).filter(|c| !has(c.effect.id())).map(|c| &c.fitted);
    tied.chain(forms.iter().map(|f| &f.fitted)).collect()
}
