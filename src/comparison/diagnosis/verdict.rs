//! Verdict of a diagnosis: one type that all commands, the demo and the reports print.

use super::sensor::tells_gain;
use super::{Cost, Missing, Proposal, Remainder};
use crate::agreement::Agreement;
use crate::features::LeftOn;
use crate::inference::{Comparison, Fitted};
use crate::number::{Quantity, percent, with_unit};
use radcam_sim::effects::{Parameter, find};
use serde::{Deserialize, Serialize};

/// The verdict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
#[non_exhaustive]
pub enum Verdict {
    /// The given model describes the campaign.
    Describes {
        /// Agreement grade.
        agreement: Agreement,
        /// Verdict in plain words.
        sentence: String,
    },
    /// Effects are missing; with them the residuals come down to the noise.
    Named {
        /// Strongest effect.
        effect: String,
        /// Effects that this campaign cannot tell from it.
        or: Vec<String>,
        /// Verdict in plain words.
        sentence: String,
        /// First sentence of the verdict.
        #[serde(default)]
        brief: String,
    },
    /// Something is missing that has no name in the catalogue.
    Unknown {
        /// Nearest names.
        nearest: Vec<String>,
        /// Verdict in plain words.
        sentence: String,
    },
}

impl Verdict {
    /// Returns the verdict in plain words.
    pub fn sentence(&self) -> &str {
        match self {
            Self::Describes { sentence, .. }
            | Self::Named { sentence, .. }
            | Self::Unknown { sentence, .. } => sentence,
        }
    }

    /// Returns the first sentence: effect, size, cost and remedy.
    pub fn brief(&self) -> &str {
        match self {
            Self::Named { brief, .. } if !brief.is_empty() => brief,
            _ => self.sentence(),
        }
    }

    /// Builds the verdict on the effects found. `whole`: the model with all of them. `left_on`: camera
    /// settings that changed its pixels.
    pub(super) fn of(
        missing: &[Missing],
        remainder: Option<&Remainder>,
        first: &Comparison,
        whole: &Fitted,
        left_on: &[LeftOn],
        proposal: Option<&Proposal>,
    ) -> Self {
        let mut verdict = Self::of_campaign(missing, remainder, first, whole, proposal);
        if !left_on.is_empty() {
            let names: Vec<String> = left_on.iter().map(ToString::to_string).collect();
            let on = format!("The camera's own {} was on while these frames were taken", names.join(", "));
            let suspected =
                |text: &str| format!("{on}: the first suspect. Switch it off and capture again. {text}");
            match &mut verdict {
                Self::Describes { sentence, .. } => *sentence += &format!(" {on}; it does not show."),
                Self::Named { sentence, brief, .. } => {
                    (*sentence, *brief) = (suspected(sentence), suspected(brief));
                }
                Self::Unknown { sentence, .. } => *sentence = suspected(sentence),
            }
        }
        verdict
    }

    fn of_campaign(
        missing: &[Missing],
        remainder: Option<&Remainder>,
        first: &Comparison,
        whole: &Fitted,
        proposal: Option<&Proposal>,
    ) -> Self {
        let Some(top) = missing.first() else {
            let (agreement, wider) = (first.agreement, first.error.max(1.0));
            let sentence = match agreement {
                Agreement::Fails => {
                    "Deviations are larger than chance allows, but too small to be named.".into()
                }
                _ if !tells_gain(whole) => format!(
                    "The darks agree with the model to within the noise of this campaign. The gain is not determined without flats; {}.",
                    told(
                        "read noise",
                        whole.base.gain_dn_per_e * whole.base.read_noise_e,
                        wider * whole.base.gain_dn_per_e * whole.base_std_err[1],
                        "DN"
                    )
                ),
                _ => format!(
                    "The camera {} {}, {}.",
                    agrees(first),
                    told("Gain", whole.base.gain_dn_per_e, wider * whole.base_std_err[0], "DN/e"),
                    told("read noise", whole.base.read_noise_e, wider * whole.base_std_err[1], "e")
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
            let cost = match cost(&top.cost, whole) {
                Some(cost) => format!(" An EMVA 1288 evaluation finds {cost}."),
                None if proposal.is_some_and(Proposal::holds) => {
                    " It costs an EMVA 1288 evaluation nothing beyond its errors.".into()
                }
                None => " What it does to system gain, read noise and linearity is not known.".into(),
            };
            let sentence = match proposal {
                Some(law) if law.holds() => {
                    let near = if law.beside.is_empty() { format!(" {near}") } else { String::new() };
                    format!(
                        "The camera shows something that is not in the catalogue: {}.{near}{cost}",
                        law.sentence()
                    )
                }
                Some(law) => format!(
                    "The camera shows something that is not in the catalogue. {near}{most}{cost} A law comes near: {}.",
                    law.sentence()
                ),
                None => {
                    format!("The camera shows something that is not in the catalogue. {near}{most}{cost}")
                }
            };
            return Self::Unknown { nearest: top.nearest.clone(), sentence };
        }
        let or: Vec<String> = missing
            .iter()
            .skip(1)
            .take_while(|m| m.tied_with.as_deref() == Some(&top.effect))
            .map(|m| m.effect.clone())
            .collect();
        let (brief, rest) = sentences(top, &or, missing, remainder, whole);
        Self::Named { effect: top.effect.clone(), or, sentence: format!("{brief} {rest}"), brief }
    }
}

/// States how the camera agrees with the model; in doubt, also the statistic that deviates most.
fn agrees(first: &Comparison) -> String {
    if first.agreement != Agreement::Doubtful {
        return "agrees with the model to within the noise of this campaign.".into();
    }
    let largest = first.largest.as_deref().unwrap_or("all statistics together");
    format!(
        "may agree with the model: deviations as large come by chance less than once in twenty campaigns, the largest in {largest}; more \
         frames tell."
    )
}

/// Formats a value with its error, or states that it is not determined to within half of itself.
fn told(name: &str, value: f64, std_err: f64, unit: &'static str) -> String {
    if std_err.is_finite() && std_err < 0.5 * value.abs() {
        return format!("{name} {}", with_unit(value, std_err, unit));
    }
    format!("{name} not determined by this campaign")
}

/// Writes the verdict on named effects. The first sentence has the effect, its size, its cost and the remedy;
/// the others have further effects, origins and further remedies.
fn sentences(
    top: &Missing,
    or: &[String],
    missing: &[Missing],
    remainder: Option<&Remainder>,
    whole: &Fitted,
) -> (String, String) {
    let page = find(&top.effect).map(|e| e.page());
    let what = page.map_or_else(|| format!("It has {}.", top.effect), |p| p.what.to_string());
    let subject = if find(&top.effect).is_some_and(|e| e.is_of_the_lamp()) { "light" } else { "camera" };
    let (shows, close) =
        if top.partial { ("behaves mostly like", ", and is not quite that") } else { ("shows", "") };
    let costs = cost(&top.cost, whole).map_or_else(
        || "it does not bias system gain, read noise or linearity".to_string(),
        |cost| format!("{}an EMVA 1288 evaluation finds {cost}", top.at_worst()),
    );
    let (first, more) = page.map_or(("", None), |p| match p.remedy.split_once("; ") {
        Some((first, more)) => (first, Some(more)),
        None => (p.remedy, None),
    });
    let remedy = match (first, or) {
        _ if top.by_the_darks_alone => {
            "; take darks and flats at the same settings, and a flat below that level".into()
        }
        ("", _) => String::new(),
        (first, []) => format!("; remedy: {first}"),
        (_, _) => "; measure which it is before you correct anything".into(),
    };
    let partial = if top.partial {
        let rest = remainder.and_then(|r| r.largest.first());
        let rest = rest.map_or(String::new(), |text| format!("; most of the rest is in {text}"));
        format!(" It explains {} of the misfit{rest}.", percent(top.share))
    } else {
        String::new()
    };
    let by_darks = if top.by_the_darks_alone {
        ", or its darks have another black level or gain than the flats (no flat lies below that level, and this campaign cannot tell which)"
    } else {
        ""
    };
    let tie = if or.is_empty() {
        String::new()
    } else {
        format!(" or {} (this campaign cannot tell which)", or.join(" or "))
    };
    let mut others: Vec<&Missing> =
        missing.iter().skip(1).filter(|m| m.tied_with.is_none() && m.effect != "unknown").collect();
    // Higher cost first; without cost, larger share first.
    let worth = |m: &Missing| Some(m.cost.largest()).filter(|cost| *cost >= WEAK).unwrap_or(0.0);
    others.sort_by(|a, b| worth(b).total_cmp(&worth(a)));
    let (told, weak): (Vec<&Missing>, Vec<&Missing>) =
        others.into_iter().partition(|m| m.share >= WEAK || m.costs(whole).is_some_and(|_| worth(m) > 0.0));
    let told: Vec<String> = told
        .iter()
        .map(|m| {
            let share = (m.share >= WEAK).then(|| format!("{} of the misfit", percent(m.share)));
            let costs = m.costs(whole).filter(|_| worth(m) > 0.0);
            let beside: Vec<String> = share.into_iter().chain(costs).collect();
            format!("{}{} ({})", m.effect, of_size(m), beside.join("; "))
        })
        .collect();
    let weak: Vec<&str> = weak.iter().map(|m| m.effect.as_str()).collect();
    let also = if told.is_empty() { String::new() } else { format!(" It also shows {}.", told.join(", ")) };
    let weak =
        if weak.is_empty() { String::new() } else { format!(" Less than 1 % each: {}.", weak.join(", ")) };
    let more = more.map_or(String::new(), |more| format!(" Further remedies: {more}."));
    let meaning = meaning(top).map_or(String::new(), |text| format!(" ({text})"));
    let size = of_size(top);
    let head =
        format!("The {subject} {shows} {}{size}{meaning}{tie}{by_darks}{close}: {costs}{remedy}", top.effect);
    let rest = format!("{partial}{also}{weak} {what}{more}");
    (format!("{}.", head.trim_end_matches('.')), rest.trim_start().into())
}

/// Returns the parameter that measures an effect's strength: the best known of those that may be 0, else the
/// first other one.
fn main_size(m: &Missing) -> Option<(&'static Parameter, &Quantity)> {
    let effect = find(&m.effect)?;
    let sizes = effect.parameters().iter().filter_map(|p| Some((p, m.parameters.get(p.name)?)));
    let known = |q: &Quantity| if q.std_err > 0.0 { (q.value / q.std_err).abs() } else { 0.0 };
    let (sizes, others): (Vec<_>, Vec<_>) =
        sizes.filter(|(p, _)| !p.is_choice()).partition(|(p, _)| p.is_size());
    sizes.into_iter().max_by(|a, b| known(a.1).total_cmp(&known(b.1))).or_else(|| others.into_iter().next())
}

/// Returns the strength of an effect, to follow its name.
fn of_size(m: &Missing) -> String {
    m.size().map_or(String::new(), |size| match size {
        Size::Open => " of a size that this campaign does not determine".into(),
        Size::Known(size) => format!(" of {size}"),
    })
}

/// Strength of an effect.
pub enum Size {
    /// Size in words, with its error; sizes without a unit in per cent.
    Known(String),
    /// Size that is not known to half of itself.
    Open,
}

impl Missing {
    /// Returns the strength by the main parameter; `None` without one.
    pub(crate) fn size(&self) -> Option<Size> {
        let (p, q) = main_size(self)?;
        Some(if q.std_err >= 0.5 * q.value.abs() {
            Size::Open
        } else if p.unit == "1" && p.is_size() {
            Size::Known(with_unit(100.0 * q.value, 100.0 * q.std_err, "%"))
        } else {
            Size::Known(q.to_string())
        })
    }

    /// Returns the errors of an EMVA 1288 evaluation that ignores the effect, in few words; `None` if they
    /// are negligible.
    pub(crate) fn costs(&self, whole: &Fitted) -> Option<String> {
        let parts = said(&self.cost, whole, |what, rel, decimals| {
            let ratio = (1.0 + rel).max(1e-9);
            if (0.5..2.0).contains(&ratio) {
                format!("{what} {:+.decimals$} %", 100.0 * rel)
            } else {
                format!("{what} {}", wrong_by(ratio, decimals))
            }
        });
        (!parts.is_empty()).then(|| format!("{}{}", self.at_worst(), parts.join(", ")))
    }

    /// Returns the words before the cost if it is that of the costlier of two forms.
    fn at_worst(&self) -> &'static str {
        if self.or_form.is_some() || self.by_the_darks_alone { "at worst " } else { "" }
    }
}

/// Returns the meaning of an effect's size and form.
fn meaning(m: &Missing) -> Option<String> {
    let size = main_size(m).map(|(p, _)| p.plain_meaning().to_string());
    let form = m.form.clone().map(|form| match &m.or_form {
        Some(other) => format!("\"{form}\" or \"{other}\", which this campaign does not tell apart"),
        None => form,
    });
    let parts: Vec<String> = size.into_iter().chain(form).filter(|part| !part.is_empty()).collect();
    (!parts.is_empty()).then(|| parts.join("; "))
}

/// Minimum share of the misfit, or minimum cost, for an effect to be listed with them.
pub(crate) const WEAK: f64 = 0.01;
/// Minimum cost that is reported: no one measures a gain to a thousandth (EMVA 1288 asks for no more than a
/// per cent).
const SAID: f64 = 1e-3;

/// Returns the parts of a cost that are not negligible, each formatted by `word`. Gain and read noise are
/// named only if the cost exceeds their errors.
fn said(cost: &Cost, whole: &Fitted, word: impl Fn(&str, f64, usize) -> String) -> Vec<String> {
    let (base, errors) = (&whole.base, &whole.base_std_err);
    let rel =
        |k: usize, value: f64| if value > 0.0 && errors[k].is_finite() { errors[k] / value } else { 0.0 };
    [
        ("K", cost.gain_rel, rel(0, base.gain_dn_per_e), 2),
        ("dark noise", cost.read_noise_rel, rel(1, base.read_noise_e), 1),
        ("LE", cost.linearity_rel, 0.0, 1),
    ]
    .into_iter()
    .filter(|(_, rel, std_err, _)| rel.is_finite() && rel.abs() > SAID.max(*std_err))
    .map(|(what, rel, _, decimals)| word(what, rel, decimals))
    .collect()
}

/// Returns the cost in words; `None` if it is negligible.
fn cost(cost: &Cost, whole: &Fitted) -> Option<String> {
    let parts = said(cost, whole, |what, rel, decimals| match what {
        "LE" => format!("the linearity error LE larger by {}", percent(rel)),
        "K" => format!("the system gain K {}", wrong_by((1.0 + rel).max(1e-9), decimals)),
        _ => format!("the dark noise (e) {}", wrong_by((1.0 + rel).max(1e-9), decimals)),
    });
    let (last, first) = parts.split_last()?;
    Some(if first.is_empty() { last.clone() } else { format!("{} and {last}", first.join(", ")) })
}

/// Formats a ratio: per cent below a factor of 2, beyond it a factor.
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

/// Capitalises the first letter of a text.
pub(crate) fn capital(id: &str) -> String {
    let mut letters = id.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().collect::<String>() + letters.as_str())
}

#[cfg(test)]
mod tests {
    use super::{agrees, wrong_by};
    use crate::agreement::Agreement;
    use crate::inference::Comparison;

    /// Agreement in doubt says which statistic deviates most; agreement does not.
    #[test]
    fn doubt_names_what_deviates() {
        let of = |agreement| Comparison {
            error: 1.0,
            p_value: 0.01,
            consistent: true,
            agreement,
            largest: Some("bend of the noise".into()),
            residuals: Vec::new(),
            data_faults: Vec::new(),
            not_looked_at: Vec::new(),
        };
        assert!(agrees(&of(Agreement::Doubtful)).contains("the largest in bend of the noise"));
        assert!(!agrees(&of(Agreement::Holds)).contains("bend"));
    }

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
