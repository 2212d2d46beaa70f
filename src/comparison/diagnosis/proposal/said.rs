//! Changes that a law makes to a diagnosis: model, ladder, shares and costs.

use super::{LAW, Proposal};
use crate::diagnosis::{Diagnosis, Missing, Rung};
use crate::inference::{Comparison, Fitted};

impl Diagnosis {
    /// Returns the model that describes the campaign, with its comparison; with the law if it holds.
    pub fn described(&self) -> (Option<&Fitted>, Option<&Comparison>) {
        match self.proposal.as_ref().filter(|law| law.holds()) {
            Some(law) => (law.fitted.as_ref(), law.comparison.as_ref()),
            None => (self.fitted.as_ref(), self.comparisons.last()),
        }
    }

    /// Returns the ladder to that model.
    pub fn ladder_with_law(&self) -> Vec<Rung> {
        let mut ladder = self.ladder.clone();
        if let Some(law) = self.proposal.as_ref().filter(|law| law.holds()) {
            if law.beside.is_empty() {
                ladder.truncate(1);
            }
            ladder.push(Rung { added: Some(LAW.into()), error: law.error_after, p_value: law.p_value });
        }
        ladder
    }
}

impl Proposal {
    /// Gives `unknown`, if it stands first, the cost of a law that holds, and the whole misfit if the law
    /// replaces all names.
    pub(in crate::comparison::diagnosis) fn say_in(&self, missing: &mut [Missing]) {
        let Some((unknown, names)) = missing.split_first_mut().filter(|(m, _)| m.effect == "unknown") else {
            return;
        };
        unknown.cost = self.cost;
        if self.beside.is_empty() {
            unknown.share = 1.0;
            names.iter_mut().for_each(|m| m.share = 0.0);
        }
    }
}
