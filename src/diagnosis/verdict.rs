//! What a diagnosis comes to: one type that every verb, the demo and the reports print.

use super::Missing;
use crate::agreement::Agreement;
use crate::features::LeftOn;
use crate::inference::{Comparison, Fitted};
use crate::number::with_unit;
use radcam_sim::effects::find;
use serde::{Deserialize, Serialize};

/// The verdict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
#[non_exhaustive]
pub enum Verdict {
    /// The model that was given describes the campaign.
    Describes {
        /// How well.
        agreement: Agreement,
        /// In plain words.
        sentence: String,
    },
    /// Effects are missing, and with them the campaign comes down to the noise.
    Named {
        /// The strongest.
        effect: String,
        /// What this campaign cannot tell from it.
        or: Vec<String>,
        /// In plain words.
        sentence: String,
    },
    /// Something is missing that has no name here.
    Unknown {
        /// The names that come nearest.
        nearest: Vec<String>,
        /// In plain words.
        sentence: String,
    },
}

impl Verdict {
    /// In plain words.
    pub fn sentence(&self) -> &str {
        match self {
            Self::Describes { sentence, .. }
            | Self::Named { sentence, .. }
            | Self::Unknown { sentence, .. } => sentence,
        }
    }

    /// Of what was found. `given`, `whole`: the model as given and with all that was found, fitted. `left_on`: what the camera did to its
    /// pixels by its own settings.
    pub(super) fn of(
        missing: &[Missing],
        first: &Comparison,
        given: &Fitted,
        whole: &Fitted,
        left_on: &[LeftOn],
    ) -> Self {
        let mut verdict = Self::of_campaign(missing, first, given, whole);
        if !left_on.is_empty() {
            let names: Vec<String> = left_on.iter().map(ToString::to_string).collect();
            let on = format!("The camera's own {} was on while these frames were taken", names.join(", "));
            match &mut verdict {
                Self::Describes { sentence, .. } => *sentence += &format!(" {on}; it does not show."),
                Self::Named { sentence, .. } | Self::Unknown { sentence, .. } => {
                    *sentence =
                        format!("{on}: the first suspect. Switch it off and capture again. {sentence}");
                }
            }
        }
        verdict
    }

    fn of_campaign(missing: &[Missing], first: &Comparison, given: &Fitted, whole: &Fitted) -> Self {
        let Some(top) = missing.first() else {
            let agreement = first.agreement;
            let sentence = match agreement {
                Agreement::Fails => {
                    "Deviations are larger than chance allows, but too small to be named.".into()
                }
                _ => format!(
                    "{} {}, {}.",
                    "The camera agrees with the model to within the noise of this campaign.",
                    told("Gain", given.base.gain_dn_per_e, given.base_std_err[0], "DN/e"),
                    told("read noise", given.base.read_noise_e, given.base_std_err[1], "e")
                ),
            };
            return Self::Describes { agreement, sentence };
        };
        if top.effect == "unknown" {
            let near = match top.nearest.as_slice() {
                [] => "No effect of the catalogue is similar.".into(),
                [name] => format!("{} comes nearest, but does not explain it.", capital(name)),
                names => format!("The nearest are {}, but none of them explains it.", names.join(", ")),
            };
            let most = match (&top.doubt, top.evidence.first()) {
                (Some(doubt), _) => format!(" {}.", capital(doubt)),
                (None, Some(most)) => format!(" What deviates most: {most}."),
                (None, None) => String::new(),
            };
            let sentence = format!(
                "The camera shows an effect that is not in the catalogue. {near}{most} Do not rely on system gain, linearity and read noise of \
                 this campaign until it is known."
            );
            return Self::Unknown { nearest: top.nearest.clone(), sentence };
        }
        let or: Vec<String> = missing
            .iter()
            .skip(1)
            .take_while(|m| m.tied_with.as_deref() == Some(&top.effect))
            .map(|m| m.effect.clone())
            .collect();
        let sentence = sentence(top, &or, missing, &cost(given, whole));
        Self::Named { effect: top.effect.clone(), or, sentence }
    }
}

/// A value with its error; of one that is not known to half of itself, that.
fn told(name: &str, value: f64, std_err: f64, unit: &'static str) -> String {
    if std_err.is_finite() && std_err < 0.5 * value.abs() {
        return format!("{name} {}", with_unit(value, std_err, unit));
    }
    format!("{name} not determined by this campaign")
}

/// What the camera does, how much, what it costs and what to do.
fn sentence(top: &Missing, or: &[String], missing: &[Missing], cost: &str) -> String {
    let page = find(&top.effect).map(|e| e.page());
    let what = page.map_or_else(|| format!("It has {}.", top.effect), |p| p.what.to_string());
    let sizes: Vec<String> = top
        .parameters
        .iter()
        .filter(|(_, q)| q.unit != "choice")
        .map(|(name, q)| format!("{name} = {q}"))
        .collect();
    let form = top.form.as_ref().map_or(String::new(), |f| format!("; {f}"));
    let tie = if or.is_empty() {
        String::new()
    } else {
        format!(" This campaign cannot distinguish it from {}.", or.join(" or "))
    };
    let also: Vec<&str> = missing
        .iter()
        .skip(1)
        .filter(|m| m.tied_with.is_none() && !m.partial && m.effect != "unknown")
        .map(|m| m.effect.as_str())
        .collect();
    let also = if also.is_empty() { String::new() } else { format!(" It also shows {}.", also.join(", ")) };
    let remedy = page.map_or(String::new(), |p| format!(" Remedy: {}.", p.remedy));
    format!("The camera shows {} ({}{form}). {what}{tie}{also}{cost}{remedy}", top.effect, sizes.join(", "))
}

/// What a measurement that ignores it is wrong by.
fn cost(given: &Fitted, whole: &Fitted) -> String {
    let of = |what: &str, given: f64, whole: f64, std_err: f64, decimals: usize| {
        let whole = whole.max(1e-9);
        (((given - whole) / std_err).abs() > 3.0)
            .then(|| format!("{what} {}", wrong_by(given.max(1e-9) / whole, decimals)))
    };
    let (g, w, errors) = (&given.base, &whole.base, &whole.base_std_err);
    let parts: Vec<String> = [
        of("a system gain (DN/e)", g.gain_dn_per_e, w.gain_dn_per_e, errors[0], 2),
        of("a read noise (e)", g.read_noise_e, w.read_noise_e, errors[1], 1),
    ]
    .into_iter()
    .flatten()
    .collect();
    if parts.is_empty() {
        " It does not bias system gain or read noise.".into()
    } else {
        format!(
            " If it is left out of the model, the fit to all statistics of these frames gives {}.",
            parts.join(" and ")
        )
    }
}

/// A ratio in words: per cent as long as they say something, then a factor.
fn wrong_by(ratio: f64, decimals: usize) -> String {
    let high = if ratio > 1.0 { "high" } else { "low" };
    let factor = ratio.max(1.0 / ratio);
    if factor < 2.0 {
        format!("{:.decimals$} % too {high}", 100.0 * (ratio - 1.0).abs())
    } else if factor < 100.0 {
        format!("too {high} by a factor of {factor:.1}")
    } else {
        format!("too {high} by a factor of more than 100")
    }
}

fn capital(id: &str) -> String {
    let mut letters = id.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().collect::<String>() + letters.as_str())
}

#[cfg(test)]
mod tests {
    use super::wrong_by;

    #[test]
    fn ratios_are_said_in_words() {
        for (ratio, text) in [
            (1.0123, "1.23 % too high"),
            (0.9, "10.00 % too low"),
            (0.25, "too low by a factor of 4.0"),
            (5e5, "too high by a factor of more than 100"),
            (0.0, "too low by a factor of more than 100"),
        ] {
            assert_eq!(wrong_by(ratio, 2), text);
        }
    }
}
