//! Law for a nameless effect: formulas chosen by the evidence that they bring to all frames, and judged like
//! any model, on held-out frames.
//!
//! Evidence selects the structure, with the price of every parameter and of the number of laws that were
//! tried (Kass and Raftery 1995, J. Am. Stat. Assoc. 90, 773). Laws are added one by one, as long as the
//! campaign does not agree.

mod causes;
mod laws;
mod own;
mod said;

use super::search::{NEEDED, score};
use super::share::MATTERS;
use super::starts::{Starts, finished};
use super::{Cost, HELPS, Memo, TIE, cost};
use crate::agreement::{DOUBT, P_LIMIT};
use crate::inference::{Comparison, Fitted, Screen, compare};
use crate::number::{Quantity, finite, percent};
use crate::observables::Observations;
use laws::{Growth, Kind, Law};
use radcam_sim::EffectValues;
use radcam_sim::predict::{Prediction, SetPrediction};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Maximum number of laws in a proposal; laws do not compete with more names than that.
pub(super) const MAX_LAWS: usize = 3;
/// Maximum number of the most promising laws that are fitted for a few rounds, and of these to convergence.
const MAX_FITTED: [usize; 2] = [8, 3];
/// Maximum error of a model beside which a law is searched for (a named choice: where nothing comes near,
/// fits end far from where they began).
const MAX_ERROR: f64 = 30.0;
/// Minimum size of a law, standard errors (a named choice).
const MIN_SIZE_SIGMAS: f64 = 2.0;
/// Maximum share of their noise that two pixels have in common by a law (a named choice).
const MAX_SHARED: f64 = 0.5;
/// Maximum evidence by which a simpler law of another shape may fall short of the best: neither is preferred
/// beyond chance (Kass and Raftery 1995, section 3.2: not worth more than a bare mention).
const ALIKE: f64 = 2.0;
/// Maximum share of the misfit that a rejected law may leave and still be reported (a named choice).
const MAX_LEFT: f64 = 0.5;

/// Name of the effect that a proposal makes.
pub const LAW: &str = "law";

/// Law for the misfit that the named effects, or the model as given, leave.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Proposal {
    /// Formula of each statistic that it changes, as a custom effect of a model file has them.
    pub formulas: BTreeMap<String, String>,
    /// Parameters of the formulas.
    pub parameters: BTreeMap<String, Quantity>,
    /// Named effects beside it; none if it replaces them.
    pub beside: Vec<String>,
    /// Error on held-out frames of the model with only the effects beside it.
    #[serde(with = "finite")]
    pub error_before: f64,
    /// Error with the law.
    #[serde(with = "finite")]
    pub error_after: f64,
    /// Chance of the remaining residuals.
    #[serde(with = "finite")]
    pub p_value: f64,
    /// Law in words.
    pub text: String,
    /// Likely causes.
    pub causes: Vec<String>,
    /// Measurement that separates the causes.
    pub next_measurement: Option<String>,
    /// Errors of an EMVA 1288 evaluation that ignores it.
    pub cost: Cost,
    /// Relative error of the gain if the noise that pixels share comes from a filter that mixes them, and not
    /// from noise that is added.
    #[serde(with = "finite")]
    pub gain_open_rel: f64,
    /// The model with it: named effects first, then its laws.
    #[serde(skip)]
    pub(super) fitted: Option<Fitted>,
    /// Comparison of that model.
    #[serde(skip)]
    pub(super) comparison: Option<Comparison>,
    /// Effects of that model before its laws.
    #[serde(skip)]
    effects: usize,
    /// Each law as an effect of a model file.
    #[serde(skip)]
    laws: Vec<EffectValues>,
}

impl Proposal {
    /// Returns the laws as effects of a model file; `taken`: names of other effects in the file.
    pub fn laws(&self, taken: &[&str]) -> Vec<EffectValues> {
        let numbered = (2..).map(|number| format!("{LAW}-{number}"));
        let names = std::iter::once(LAW.to_string()).chain(numbered).filter(|n| !taken.contains(&n.as_str()));
        self.laws
            .iter()
            .zip(names)
            .map(|(law, name)| EffectValues { name: Some(name), ..law.clone() })
            .collect()
    }

    /// Returns true if the campaign agrees with it.
    pub fn holds(&self) -> bool {
        self.p_value >= DOUBT
    }

    /// Returns true if it has more than one formula.
    pub fn has_several(&self) -> bool {
        self.laws.len() > 1
    }

    /// Returns the base and the effects beside it, as fitted with it.
    pub fn beside_it(&self) -> Option<Fitted> {
        let mut fitted = self.fitted.clone()?;
        fitted.effects.truncate(self.effects);
        fitted.std_err.truncate(self.effects);
        Some(fitted)
    }

    /// Returns a sentence with the law and its effect on the error.
    pub fn sentence(&self) -> String {
        let of_it = if self.p_value < P_LIMIT { ", which is not all of it" } else { "" };
        let (before, after) = (self.error_before, self.error_after);
        let beside = if self.beside.is_empty() {
            String::new()
        } else {
            format!(", beside {}", self.beside.join(", "))
        };
        format!("{}{beside}{of_it}; with this law the error falls from {before:.3} to {after:.3}", self.text)
    }
}

/// A model with laws added.
pub(super) struct Found {
    laws: Vec<Law>,
    fitted: Fitted,
    /// Minus twice the logarithm of its evidence, with the price of the laws that were tried and of each
    /// addition.
    score: f64,
}

impl Found {
    /// Returns a sentence on laws that explain a campaign better than its names, if they do. They need more
    /// evidence than a tie, and more than a hundredth of that of the names, whose shapes are known no better,
    /// unless the names are rejected and the laws hold. They must not be rejected where the names are not,
    /// nor have a larger error on held-out frames. `given`: the model without either.
    pub fn better(&self, all: &Observations, given: &Fitted, whole: &Fitted) -> Option<String> {
        // A bend of the response and a law of the level are the same in two shapes.
        let bends = whole.effects.iter().skip(given.effects.len()).any(|(e, _)| e.bends_means());
        if bends && self.laws.iter().all(|law| law.target.kind == Kind::Level) {
            return None;
        }
        let of_names = score(all, given) - of_names(all, given, whole);
        let of_laws = score(all, given) - self.score;
        tracing::debug!("laws: evidence {of_laws:.1}, names {of_names:.1}");
        let (laws, names) = (compare(all, &self.fitted), compare(all, whole));
        let holds = laws.p_value >= names.p_value.min(DOUBT) && laws.error < names.error + HELPS;
        let alone_holds = laws.p_value >= DOUBT && names.p_value < P_LIMIT;
        tracing::debug!("laws: p {:.1e}, names p {:.1e}", laws.p_value, names.p_value);
        let needed = if alone_holds { TIE } else { TIE.max(MATTERS * of_names) };
        (of_laws - of_names > needed && holds).then(|| {
            let laws: Vec<String> = self.laws.iter().map(Law::in_short).collect();
            format!("{} explains it better: evidence {of_laws:.0} and {of_names:.0}", laws.join(" with "))
        })
    }

    /// Returns true if no pair of pixels shares more than half of its noise: fits go astray where little is
    /// measured.
    fn is_possible(&self, all: &Observations) -> bool {
        let first = self.fitted.effects.len() - self.laws.len();
        self.laws.iter().enumerate().filter(|(_, law)| law.target.kind == Kind::Shared).all(|(k, law)| {
            let mut rest = self.fitted.clone();
            rest.effects.remove(first + k);
            let (with, without) = (self.fitted.predict(all), rest.predict(all));
            let share = |set: usize| part_of_variance(law, [&with, &without], set).abs();
            (0..with.sets.len()).all(|set| share(set) <= MAX_SHARED)
        })
    }
}

/// Computes minus twice the logarithm of the evidence of named effects, with the price of each addition.
fn of_names(all: &Observations, given: &Fitted, whole: &Fitted) -> f64 {
    score(all, whole) + NEEDED * (whole.effects.len() - given.effects.len()) as f64
}

/// Finds laws beside the model as given, in place of all names.
pub(super) fn in_place_of_names(all: &Observations, given: &Fitted) -> Option<Found> {
    found(all, given, laws::all())
}

/// Searches for a law. `given`: the model as given; `whole`: with the named effects; `in_place`: laws beside
/// the model as given that may replace doubtful names.
pub(super) fn propose(
    all: &Observations,
    given: &Fitted,
    whole: &Fitted,
    in_place: Option<Found>,
) -> Option<Proposal> {
    let is_named = whole.effects.len() > given.effects.len();
    let beside = is_named.then(|| found(all, whole, laws::all())).flatten();
    let names = of_names(all, given, whole) - score(all, whole);
    let chance = |f: &Found| compare(all, &f.fitted).p_value;
    let from_given = match (&beside, &in_place) {
        // Evidence decides, unless the better of the two is rejected and the other is not.
        (Some(b), Some(p)) if chance(b) < P_LIMIT && chance(p) >= DOUBT => true,
        (Some(b), Some(p)) if chance(p) < P_LIMIT && chance(b) >= DOUBT => false,
        (Some(b), Some(p)) => p.score <= b.score + names,
        (b, _) => b.is_none(),
    };
    let (best, start) = if from_given { (in_place?, given) } else { (beside?, whole) };
    let (before, after) = (compare(all, start), compare(all, &best.fitted));
    let misfit = |c: &Comparison| (c.error * c.error - 1.0).max(0.0);
    // A law that is rejected must explain most of the misfit.
    let explains_most = misfit(&after) < MAX_LEFT * misfit(&before);
    if after.p_value < P_LIMIT && !explains_most {
        return None;
    }
    if after.error > before.error - HELPS && after.p_value <= before.p_value {
        return None;
    }
    Some(described(all, best, start.effects.len() - given.effects.len(), [&before, &after]))
}

/// Adds laws to a model one by one, as long as the evidence pays for them and the campaign does not agree.
fn found(all: &Observations, model: &Fitted, laws: &[Law]) -> Option<Found> {
    // A table has a few numbers for each level, and any of many laws fits them.
    if all.is_table || compare(all, model).error > MAX_ERROR {
        return None;
    }
    let levels_dn = levels(all, model);
    let number = |law: &Law| if law.shape.growth == Growth::Step { law.starts(&levels_dn).len() } else { 1 };
    let price = |law: &Law| 2.0 * ((laws.len() * number(law).max(1)) as f64).ln();
    let (mut now, mut chosen): (Fitted, Vec<Law>) = (model.clone(), Vec::new());
    while chosen.len() < MAX_LAWS {
        let Some((law, fitted)) = next(all, &now, laws, &chosen, &levels_dn) else { break };
        let evidence = score(all, &now) - score(all, &fitted) - price(&law);
        tracing::debug!("{}: evidence {evidence:.1}", law.effect.id());
        if evidence < NEEDED {
            break;
        }
        now = fitted;
        chosen.push(law);
        if compare(all, &now).p_value >= DOUBT {
            break;
        }
    }
    let score = score(all, &now) + chosen.iter().map(|law| price(law) + NEEDED).sum::<f64>();
    (!chosen.is_empty())
        .then_some(Found { laws: chosen, fitted: now, score })
        .filter(|found| found.is_possible(all))
}

/// Returns the signals of the flats in ascending order, DN.
fn levels(all: &Observations, model: &Fitted) -> Vec<f64> {
    let prediction = model.predict(all);
    let sets = prediction.sets.iter().zip(&all.campaign.sets);
    let mut levels: Vec<f64> = sets.filter(|(_, info)| info.light.is_some()).map(|(s, _)| s.signal).collect();
    levels.sort_by(f64::total_cmp);
    levels
}

/// Returns the size of a law: the parameter k of an effect of a model.
fn size_of(fitted: &Fitted, at: usize) -> f64 {
    let (effect, values) = &fitted.effects[at];
    effect.parameters().iter().position(|p| p.name == "k").map_or(0.0, |k| values[k])
}

/// Returns true if the size of the last law is determined: evidence for one that is not comes from base
/// values that it frees, like an offset of flats alone.
fn is_determined(fitted: &Fitted) -> bool {
    let last = fitted.effects.len() - 1;
    let place = fitted.effects[last].0.parameters().iter().position(|p| p.name == "k");
    place.is_none_or(|k| {
        let std_err = fitted.std_err[last][k];
        !std_err.is_finite() || size_of(fitted, last).abs() > MIN_SIZE_SIGMAS * std_err
    })
}

/// Finds the best law beside those of a model. Its size must not cancel that of another law of the same
/// target.
fn next(
    all: &Observations,
    now: &Fitted,
    laws: &[Law],
    chosen: &[Law],
    levels_dn: &[f64],
) -> Option<(Law, Fitted)> {
    let screen = Screen::new(all, now, NEEDED);
    let is_chosen = |law: &&Law| chosen.iter().any(|c| c.effect.id() == law.effect.id());
    let free: Vec<&Law> = laws.iter().filter(|law| !is_chosen(law)).collect();
    let mut promising: Vec<(f64, &Law, Starts)> = free
        .into_par_iter()
        .filter_map(|law| {
            let starts = Starts::of(&screen, law.effect, &[], &law.starts(levels_dn));
            let gain = starts.gain()?;
            (gain > NEEDED).then_some((gain, law, starts))
        })
        .collect();
    promising.sort_by(|a, b| b.0.total_cmp(&a.0));
    promising.truncate(MAX_FITTED[0]);
    for (gain, law, _) in &promising {
        tracing::debug!("  screen {}: {gain:.1}", law.effect.id());
    }
    let mut brief: Vec<(&Law, Vec<Fitted>)> = promising
        .into_par_iter()
        .map(|(_, law, starts)| (law, starts.fit_briefly(all, now, None, 1, Some(&screen))))
        .collect();
    let first = |tries: &[Fitted]| tries.first().map_or(f64::INFINITY, |t| score(all, t));
    brief.sort_by(|a, b| first(&a.1).total_cmp(&first(&b.1)));
    brief.truncate(MAX_FITTED[1]);
    let memo = Memo::default();
    let mut done: Vec<(f64, Law, Fitted)> = brief
        .into_par_iter()
        .filter_map(|(law, tries)| {
            let fitted = finished(all, tries, &memo).into_iter().next()?;
            let cancels = chosen.iter().enumerate().any(|(k, other)| {
                let place = now.effects.len() - chosen.len() + k;
                other.target == law.target
                    && size_of(&fitted, place) * size_of(&fitted, now.effects.len()) < 0.0
            });
            (!cancels && is_determined(&fitted)).then(|| (score(all, &fitted), *law, fitted))
        })
        .collect();
    done.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best = done.first()?.0;
    // First of the grammar among equally good laws: simple shapes stand first.
    let place = |law: &Law| laws.iter().position(|l| l.effect.id() == law.effect.id());
    done.into_iter()
        .filter(|(score, ..)| score - best < ALIKE)
        .min_by_key(|(_, law, _)| place(law))
        .map(|(_, law, fitted)| (law, fitted))
}

/// Describes a found law in formulas and words. `named`: number of named effects beside it.
fn described(all: &Observations, found: Found, named: usize, [before, after]: [&Comparison; 2]) -> Proposal {
    let fitted = &found.fitted;
    let first = fitted.effects.len() - found.laws.len();
    let (mut formulas, mut parameters) = (BTreeMap::<String, String>::new(), BTreeMap::new());
    let (mut words, mut singles) = (Vec::new(), Vec::new());
    for (number, law) in found.laws.iter().enumerate() {
        let (effect, values) = &fitted.effects[first + number];
        let mut formula = law.shape.formula.to_string();
        for (p, (value, error)) in
            effect.parameters().iter().zip(values.iter().zip(&fitted.std_err[first + number]))
        {
            let name =
                if found.laws.len() == 1 { p.name.into() } else { format!("{}{}", p.name, number + 1) };
            formula = renamed(&formula, p.name, &name);
            // A step may lie anywhere between two levels.
            let is_open = law.shape.growth == Growth::Step && p.name == "m";
            let std_err = if is_open { f64::NAN } else { *error };
            parameters.insert(name, Quantity { value: *value, std_err, unit: p.unit.into() });
        }
        for (target, part) in law.target.parts {
            let formula = laws::part_of(*part, &formula);
            formulas
                .entry((*target).into())
                .and_modify(|f| *f = format!("{f} + {formula}"))
                .or_insert(formula);
        }
        words.push(in_words(all, fitted, first + number, law));
        singles.push(as_effect(fitted, first + number, law));
    }
    let causes: Vec<_> = found.laws.iter().flat_map(|l| causes::of(l.target.name, l.shape.growth)).collect();
    let beside = fitted.effects[first - named..first].iter().map(|(e, _)| e.id().to_string()).collect();
    let mut said: Vec<String> = Vec::new();
    for cause in &causes {
        let text = format!("{} [{}]", cause.mechanism, cause.source);
        if !said.contains(&text) {
            said.push(text);
        }
    }
    Proposal {
        formulas,
        parameters,
        beside,
        error_before: before.error,
        error_after: after.error,
        p_value: after.p_value,
        text: words.join("; and "),
        causes: said,
        next_measurement: causes.first().map(|c| c.measure.to_string()),
        cost: cost::of_last(all, fitted, first),
        gain_open_rel: mixed(all, fitted, first, &found.laws),
        laws: singles,
        effects: first,
        comparison: Some(after.clone()),
        fitted: Some(found.fitted),
    }
}

/// Renames one of the parameters of a formula.
fn renamed(formula: &str, from: &str, to: &str) -> String {
    let is_of_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let (mut out, mut word) = (String::new(), String::new());
    for c in formula.chars().chain([' ']) {
        if is_of_name(c) {
            word.push(c);
            continue;
        }
        out += if word == from { to } else { &word };
        word.clear();
        out.push(c);
    }
    out.trim_end().into()
}

/// Returns a law of a fit as an effect of a model file.
fn as_effect(fitted: &Fitted, at: usize, law: &Law) -> EffectValues {
    let (effect, values) = &fitted.effects[at];
    let names = || effect.parameters().iter().map(|p| p.name.to_string());
    let errors = names().zip(fitted.std_err[at].iter().copied());
    let is_known = |(name, error): &(String, f64)| {
        error.is_finite() && !(law.shape.growth == Growth::Step && name == "m")
    };
    let of_target =
        |(target, part): &(&str, f64)| ((*target).to_string(), laws::part_of(*part, law.shape.formula));
    EffectValues {
        id: "custom".into(),
        parameters: names().zip(values.iter().copied()).collect(),
        formulas: law.target.parts.iter().map(of_target).collect(),
        bounds: effect.parameters().iter().map(|p| (p.name.to_string(), [p.min, p.max])).collect(),
        units: effect.parameters().iter().map(|p| (p.name.to_string(), p.unit.to_string())).collect(),
        std_err: errors.filter(is_known).collect(),
        ..Default::default()
    }
}

/// Describes a law as a sentence of physics, with its size where it is largest.
fn in_words(all: &Observations, fitted: &Fitted, at: usize, law: &Law) -> String {
    let (effect, values) = &fitted.effects[at];
    let parameter = |name: &str| {
        let k = effect.parameters().iter().position(|p| p.name == name)?;
        Some(Quantity {
            value: values[k],
            std_err: fitted.std_err[at][k],
            unit: effect.parameters()[k].unit.into(),
        })
    };
    let (Some(size), words) = (parameter("k"), law.shape.words) else { return law.in_short() };
    let place = match (law.shape.growth, parameter("m")) {
        (Growth::Step, Some(m)) => format!(", at about {:.0} DN", m.value),
        (Growth::Wave, Some(m)) => format!(", with a period of {:.0} DN", m.value),
        _ => String::new(),
    };
    let place = parameter("p").map_or(place, |p| format!(", p = {p}"));
    if law.target.kind == Kind::Level {
        let at_level = if law.shape.formula.contains("1000") { " at 1000 DN" } else { "" };
        return format!("the level is {words} ({size}{at_level}{place})");
    }
    let mut rest = fitted.clone();
    rest.effects.remove(at);
    let (with, without) = (fitted.predict(all), rest.predict(all));
    let of = |set: usize| part_of_variance(law, [&with, &without], set);
    let largest = (0..with.sets.len()).max_by(|a, b| of(*a).abs().total_cmp(&of(*b).abs())).unwrap_or(0);
    let (level, share) = (without.sets[largest].signal.round() + 0.0, of(largest));
    let is_less = size.value < 0.0;
    match law.target.kind {
        Kind::Lines => {
            let sd = (share.abs() * without.sets[largest].covariance(0, 0)).sqrt();
            format!(
                "noise {}, its variance {words} (standard deviation {sd:.3} DN at {level:.0} DN{place})",
                law.target.words
            )
        }
        Kind::Shared if is_less => format!(
            "noise of opposite sign {}, {words} ({} of the noise variance at {level:.0} DN{place})",
            law.target.words,
            percent(share.abs())
        ),
        _ => format!(
            "{} noise {}, {words} ({} of the noise variance at {level:.0} DN{place})",
            if is_less { "less" } else { "more" },
            law.target.words,
            percent(share.abs())
        ),
    }
}

/// Computes the sum of the covariances that laws give a pixel with all others, over its variance, at the
/// brightest level below saturation, for laws that grow with signal or noise. A filter that keeps the mean
/// lowers the variance by as much (Moore, Ninkov and Forrest 2006, Opt. Eng. 45, 076402); added noise does
/// not. `kept`: number of effects of the model before its laws.
fn mixed(all: &Observations, fitted: &Fitted, kept: usize, laws: &[Law]) -> f64 {
    let grows = |law: &Law| {
        let shared = law.target.kind == Kind::Shared;
        shared && !matches!(law.shape.growth, Growth::Constant | Growth::Exposure)
    };
    if !laws.iter().any(grows) {
        return 0.0;
    }
    let mut rest = fitted.clone();
    rest.effects.truncate(kept);
    let (with, without) = (fitted.predict(all), rest.predict(all));
    let variance = |s: &SetPrediction| s.shot.lag(0, 0) + s.read.lag(0, 0);
    let others = |s: &SetPrediction| s.shot.of_mean() + s.read.of_mean() + 2.0 * s.uphill - variance(s);
    let sets = with.sets.iter().zip(&without.sets).zip(&all.campaign.sets);
    let lit = sets.filter(|((s, _), info)| info.light.is_some() && variance(s) > 0.0);
    let brightest = lit.map(|(pair, _)| pair).max_by(|a, b| variance(a.0).total_cmp(&variance(b.0)));
    let open = brightest.map_or(0.0, |(a, b)| ((others(a) - others(b)) / variance(a)).abs());
    if open.is_finite() { open } else { 0.0 }
}

/// Computes the share of a pixel's noise variance that a law of noise changes or shares in a set, with its
/// sign.
fn part_of_variance(law: &Law, [with, without]: [&Prediction; 2], set: usize) -> f64 {
    let (a, b): (&SetPrediction, &SetPrediction) = (&with.sets[set], &without.sets[set]);
    let target = law.target.parts.first().map_or("", |part| part.0);
    let of = |s: &SetPrediction| match target {
        "variance" => s.covariance(0, 0),
        "row" => s.row.lag(0),
        "column" => s.column.lag(0),
        "common" => s.common,
        "gradient_y" => s.fields.down[0],
        "gradient_x" => s.fields.across[0],
        "curvature_y" => s.fields.down[1],
        "curvature_x" => s.fields.across[1],
        "cov_1-1" => s.uphill,
        "parity_01" => s.parity.0,
        "parity_10" => s.parity.1,
        _ => {
            let digit = |at: usize| target.as_bytes().get(at).map_or(0, |c| i32::from(*c) - i32::from(b'0'));
            s.read.lag(digit(4), digit(5))
        }
    };
    let part = law.target.parts.first().map_or(1.0, |part| part.1.abs());
    (of(a) - of(b)) / part / b.covariance(0, 0).max(1e-12)
}

#[cfg(test)]
mod tests {
    use super::renamed;

    /// A name that is part of another word stays.
    #[test]
    fn parameters_are_renamed_as_words() {
        assert_eq!(renamed("k * (mu / 1000)^2", "k", "k1"), "k1 * (mu / 1000)^2");
        assert_eq!(renamed("k * sin(6.28 * mu / m + f)", "m", "m2"), "k * sin(6.28 * mu / m2 + f)");
    }
}
