//! A law as a user's own effect, which joins the catalogue.

use super::Proposal;
use crate::number::six_digits;
use radcam_sim::effects::{OwnEffect, OwnPage, UNBOUNDED};

/// Rounds a value to six digits, which its error does not reach.
fn rounded(value: f64) -> f64 {
    six_digits(value).parse().unwrap_or(value)
}

impl Proposal {
    /// Returns the law as an effect of this name. `campaign`: name of the datasets that show it.
    pub fn own_effect(&self, name: &str, campaign: &str) -> OwnEffect {
        let mut own = OwnEffect { name: name.into(), formulas: self.formulas.clone(), ..Default::default() };
        for (number, law) in self.laws.iter().enumerate() {
            let named =
                |p: &str| if self.has_several() { format!("{p}{}", number + 1) } else { p.to_string() };
            own.parameters.extend(law.parameters.iter().map(|(p, v)| (named(p), rounded(*v))));
            let bounded = law.bounds.iter().filter(|(_, b)| **b != [-UNBOUNDED, UNBOUNDED]);
            own.bounds.extend(bounded.map(|(p, b)| (named(p), *b)));
            own.units.extend(law.units.iter().map(|(p, u)| (named(p), u.clone())));
        }
        let upper = |text: &str| {
            let mut letters = text.chars();
            letters.next().map_or(String::new(), |c| c.to_uppercase().chain(letters).collect())
        };
        own.page = OwnPage {
            what: match self.causes.as_slice() {
                [] => "Its cause is not known.".into(),
                causes => format!("{}.", upper(&causes.join(", or "))),
            },
            signature: self.text.clone(),
            measure: self.next_measurement.clone().unwrap_or_default(),
            source: format!("law found by radcam {} in {campaign}", env!("CARGO_PKG_VERSION")),
            ..Default::default()
        };
        own
    }
}
