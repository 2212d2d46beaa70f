//! Parts of a model that was found: each effect with what it alone explains, and what explains it as well.

use super::search::{Candidate, NEEDED, score, without};
use super::{AGREES, BARELY, HOLDS, NEARLY_ALL, TIE, unknown};
use crate::dataset::Kind;
use crate::inference::{Comparison, Fitted, Residual, compare, fit, residuals_of};
use crate::observables::Observations;
use radcam_sim::effects::Effect;
use rayon::prelude::*;

/// An effect that was found, with what it alone explains.
pub(super) struct Part {
    /// Its effect.
    pub effect: &'static dyn Effect,
    /// Evidence that is lost without it.
    pub evidence: f64,
    /// Mean square of what the whole model leaves, 1 at least: where it leaves much, evidence counts as much
    /// less (McCullagh and Nelder 1989, 4.5).
    pub dispersion: f64,
    /// Others that would explain it, most evidence first.
    pub others: Vec<Candidate>,
    /// The evidence that something without a name would have in its place.
    pub nameless: f64,
    /// The rest of the model without it.
    pub rest: Fitted,
    /// What deviates then.
    pub without: Vec<Residual>,
    /// True for a drift in a campaign in which one light has two sets of flats and every other has one: a lamp
    /// that comes back to another light explains that too.
    pub hangs_on_one_return: bool,
}

impl Part {
    /// Candidates that explain as much as the part that was chosen.
    pub fn tied(&self) -> Vec<&Candidate> {
        let same = |c: &&Candidate| self.evidence - c.evidence < TIE * self.dispersion;
        let returns =
            |c: &&Candidate| self.hangs_on_one_return && c.effect.sets_each() && c.evidence > NEEDED;
        self.others.iter().filter(|c| same(c) || returns(c)).collect()
    }

    /// Share of the evidence that one explanation of a part has among all: others, nothing at all, and something
    /// without a name.
    pub fn confidence(&self, evidence: f64) -> f64 {
        let all = self.others.iter().map(|c| c.evidence).chain([self.evidence, 0.0, self.nameless]);
        let sum: f64 = all.map(|e| (0.5 * (e - evidence)).clamp(-300.0, 300.0).exp()).sum();
        1.0 / sum
    }

    /// What explains a part better than its name does, where something without a name does.
    pub fn better(&self) -> Option<String> {
        (self.nameless > self.evidence + BARELY).then(|| {
            format!(
                "a smooth function of the level that has no name explains it better than {} does: evidence {:.0} and {:.0}",
                self.effect.id(),
                self.nameless,
                self.evidence
            )
        })
    }
}

/// Every effect that was added to a model, with what is lost without it.
pub(super) fn left_out(all: &Observations, model: &Fitted, whole: &Fitted) -> Vec<Part> {
    let given = model.effects.len();
    let part = |i: usize| {
        let rest = if whole.effects.len() == given + 1 { model.clone() } else { without(all, whole, i) };
        let effect = whole.effects[i].0;
        let evidence = score(all, &rest) - score(all, whole);
        let without = residuals_of(all, &rest);
        // Darks alone have no levels that a function of them could follow.
        let lit = all.kinds.iter().any(|kind| *kind != Kind::Dark);
        let of_levels = if lit { unknown::evidence(&without, all.list.len() as f64) } else { 0.0 };
        let nameless = (1.0 - NEARLY_ALL) * of_levels;
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

/// The model without an effect that does not belong there, where there is one: it does not pay in the
/// presence of the others, or the campaign contradicts it where it agrees with the rest (settings that are in
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
    if parts.len() < 2 || last.p_value >= HOLDS {
        return None;
    }
    let near = parts.iter().filter(|p| p.rest.mean_square < AGREES);
    near.map(|p| &p.rest).find(|rest| compare(all, rest).p_value >= HOLDS)
}

/// A model with another form of one of its effects that explains the campaign as well.
pub(super) struct OtherForm {
    /// Place of the effect in the model.
    pub at: usize,
    /// The model.
    pub fitted: Fitted,
}

impl OtherForm {
    /// The tie in words.
    pub fn words(&self) -> String {
        let (effect, values) = &self.fitted.effects[self.at];
        let form = effect.form(values).unwrap_or("another form");
        format!(
            "a tie: \"{form}\" explains it as well, with a gain of {:.4} DN/e",
            self.fitted.base.gain_dn_per_e
        )
    }
}

/// Other forms of the parts by which the means are the same and the noise means another gain, where the campaign
/// does not tell them apart.
pub(super) fn other_forms(all: &Observations, parts: &[Part], whole: &Fitted) -> Vec<OtherForm> {
    let (best, reach) = (score(all, whole), TIE * whole.mean_square.max(1.0));
    let of_parts = whole.effects.iter().enumerate();
    let of_parts = of_parts.filter(|(_, (e, _))| parts.iter().any(|p| p.effect.id() == e.id()));
    let tries: Vec<(usize, Vec<f64>)> = of_parts
        .flat_map(|(at, (e, values))| e.same_means(values).into_iter().map(move |v| (at, v)))
        .collect();
    let tries = tries.into_par_iter().map(|(at, values)| {
        let mut effects = whole.effects.clone();
        effects[at].1 = values;
        OtherForm { at, fitted: fit(all, &whole.base, &effects) }
    });
    let worse = |f: &OtherForm| score(all, &f.fitted) - best;
    let tries: Vec<OtherForm> = tries.collect();
    tries.iter().for_each(|f| tracing::debug!("{}: worse by {:.1}", f.words(), worse(f)));
    tries.into_iter().filter(|f| worse(f) < reach).collect()
}

/// Models that explain the campaign as well as the whole does.
pub(super) fn as_good<'p>(parts: &'p [Part], forms: &'p [OtherForm], whole: &Fitted) -> Vec<&'p Fitted> {
    let has = |id: &str| whole.effects.iter().any(|(e, _)| e.id() == id);
    let tied = parts.iter().flat_map(Part::tied).filter(|c| !has(c.effect.id())).map(|c| &c.fitted);
    tied.chain(forms.iter().map(|f| &f.fitted)).collect()
}
