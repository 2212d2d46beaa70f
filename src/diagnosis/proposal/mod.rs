//! A law for what has no name: formulas that describe it, found by the evidence that they bring, judged on frames
//! that no fit saw.
//!
//! Structure is chosen by evidence with the price of every parameter and of the number of laws that were tried
//! (Kass and Raftery 1995, J. Am. Stat. Assoc. 90, 773), one law after the other, as long as the campaign does
//! not agree.

mod causes;
mod laws;

use super::search::{NEEDED, score};
use super::starts::{Starts, finished};
use super::{Cost, HELPS, Memo, TIE, cost};
use crate::agreement::{DOUBT, P_LIMIT};
use crate::inference::{Comparison, Fitted, Screen, compare, seen};
use crate::number::{Quantity, percent};
use crate::observables::Observations;
use laws::{Growth, Kind, Law};
use radcam_sim::EffectValues;
use radcam_sim::predict::{Prediction, SetPrediction};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Laws in a proposal.
const MOST: usize = 3;
/// Laws that are fitted for a few rounds, of those that promise most, and of these to the end.
const FITTED: [usize; 2] = [8, 3];
/// Evidence by which a law of another shape may fall short of the best and still be the simpler one: none are
/// preferred beyond chance (Kass and Raftery 1995, section 3.2: not worth more than a bare mention).
const ALIKE: f64 = 2.0;

/// Share of the misfit that a law may leave and still be said where it is rejected (a named choice).
const MOST_LEFT: f64 = 0.5;

/// Name of the effect that a proposal makes.
pub const LAW: &str = "law";

/// A law for what the named effects, or the model as given, leave.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Proposal {
    /// Formula of each statistic that it changes, as a custom effect of a model file has them.
    pub formulas: BTreeMap<String, String>,
    /// Parameters of the formulas.
    pub parameters: BTreeMap<String, Quantity>,
    /// Named effects beside it; none where it stands in their place.
    pub beside: Vec<String>,
    /// Error without it, on frames that no fit saw.
    pub error_before: f64,
    /// Error with it.
    pub error_after: f64,
    /// Chance of what is left with it.
    pub p_value: f64,
    /// Law in words.
    pub text: String,
    /// Likely causes.
    pub causes: Vec<String>,
    /// Measurement that separates the causes.
    pub next_measurement: Option<String>,
    /// Errors of an EMVA 1288 evaluation that leaves it out of account.
    pub cost: Cost,
    /// Share of the gain by which it may be off where noise that pixels share comes from a filter that mixes
    /// them, and not from noise that is added.
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
}

impl Proposal {
    /// It as an effect of a model file; `taken`: names that other effects of the file have.
    pub fn effect(&self, taken: &[&str]) -> EffectValues {
        let numbered = (2..).map(|number| format!("{LAW}-{number}"));
        let name = std::iter::once(LAW.to_string()).chain(numbered).find(|n| !taken.contains(&n.as_str()));
        let of = |value: fn(&Quantity) -> f64| -> BTreeMap<String, f64> {
            self.parameters.iter().map(|(name, q)| (name.clone(), value(q))).collect()
        };
        EffectValues {
            id: "custom".into(),
            name,
            parameters: of(|q| q.value),
            formulas: self.formulas.clone(),
            bounds: BTreeMap::new(),
            units: self.parameters.iter().map(|(name, q)| (name.clone(), q.unit.to_string())).collect(),
            std_err: of(|q| if q.std_err.is_finite() { q.std_err } else { 0.0 }),
        }
    }

    /// True where the campaign agrees with it.
    pub fn holds(&self) -> bool {
        self.p_value >= DOUBT
    }

    /// Base and effects beside it, as fitted with it.
    pub fn beside_it(&self) -> Option<Fitted> {
        let mut fitted = self.fitted.clone()?;
        fitted.effects.truncate(self.effects);
        fitted.std_err.truncate(self.effects);
        Some(fitted)
    }

    /// It with what it does to the error.
    pub fn sentence(&self) -> String {
        let of_it = if self.p_value < P_LIMIT { ", which is a part of it" } else { "" };
        let (before, after) = (self.error_before, self.error_after);
        format!("{}{of_it}; with this law the error falls from {before:.3} to {after:.3}", self.text)
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
    /// Sentence on laws that explain a campaign better than its names, where they do: by more evidence than a tie
    /// has, and without being rejected where the names are not. `given`: the model without either.
    pub fn better(&self, all: &Observations, given: &Fitted, whole: &Fitted) -> Option<String> {
        let names = whole.effects.len() - given.effects.len();
        let of_names = score(all, given) - score(all, whole) - NEEDED * names as f64;
        let of_laws = score(all, given) - self.score;
        tracing::debug!("laws: evidence {of_laws:.1}, names {of_names:.1}");
        let chance = |model: &Fitted| compare(all, model).p_value;
        let holds = chance(&self.fitted) >= chance(whole).min(DOUBT);
        (of_laws - of_names > TIE && holds).then(|| {
            let laws: Vec<String> = self.laws.iter().map(Law::in_short).collect();
            format!("{} explains it better: evidence {of_laws:.0} and {of_names:.0}", laws.join(", with "))
        })
    }
}

/// Laws beside the model as given, in place of all names.
pub(super) fn in_place_of_names(all: &Observations, given: &Fitted) -> Option<Found> {
    found(all, given, &laws::all())
}

/// Looks for a law. `given`: the model as given; `whole`: with the named effects; `in_place`: laws beside the
/// model as given, where names are in doubt, so that a law may stand in their place.
pub(super) fn propose(
    all: &Observations,
    given: &Fitted,
    whole: &Fitted,
    in_place: Option<Found>,
) -> Option<Proposal> {
    let is_named = whole.effects.len() > given.effects.len();
    let beside = is_named.then(|| found(all, whole, &laws::all())).flatten();
    let holds = |f: &Found| compare(all, &f.fitted).p_value >= DOUBT;
    let from_given = match (&beside, &in_place) {
        (Some(b), Some(p)) if holds(b) != holds(p) => holds(p),
        (Some(b), Some(p)) => p.score <= b.score,
        (b, _) => b.is_none(),
    };
    let (best, start) = if from_given { (in_place?, given) } else { (beside?, whole) };
    let (first, before, after) = (compare(all, given), compare(all, start), compare(all, &best.fitted));
    let misfit = |c: &Comparison| (c.error * c.error - 1.0).max(0.0);
    // A law is worth nothing that is rejected and leaves most of the misfit.
    let explains_most = misfit(&after) < MOST_LEFT * misfit(&before);
    if after.p_value < P_LIMIT && !explains_most {
        return None;
    }
    if after.error > before.error - HELPS && after.p_value <= before.p_value {
        return None;
    }
    Some(described(all, best, start.effects.len() - given.effects.len(), [&first, &after]))
}

/// Adds laws to a model one by one, as long as the evidence pays for them and the campaign does not agree.
fn found(all: &Observations, model: &Fitted, laws: &[Law]) -> Option<Found> {
    let price = 2.0 * (laws.len() as f64).ln();
    let (mut now, mut chosen): (Fitted, Vec<Law>) = (model.clone(), Vec::new());
    while chosen.len() < MOST {
        let Some((law, fitted)) = next(all, &now, laws, &chosen) else { break };
        let evidence = score(all, &now) - score(all, &fitted) - price;
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
    let score = score(all, &now) + (price + NEEDED) * chosen.len() as f64;
    (!chosen.is_empty()).then_some(Found { laws: chosen, fitted: now, score })
}

/// The best law beside those that a model has.
fn next(all: &Observations, now: &Fitted, laws: &[Law], chosen: &[Law]) -> Option<(Law, Fitted)> {
    let seen = seen(all, &now.base);
    let screen = Screen::new(all, now, NEEDED);
    let is_chosen = |law: &&Law| chosen.iter().any(|c| c.effect.id() == law.effect.id());
    let free: Vec<&Law> = laws.iter().filter(|law| !is_chosen(law)).collect();
    let mut promising: Vec<(f64, &Law, Starts)> = free
        .into_par_iter()
        .filter_map(|law| {
            let starts = Starts::of(&screen, law.effect, &[], &law.starts(&seen));
            let gain = starts.gain()?;
            (gain > NEEDED).then_some((gain, law, starts))
        })
        .collect();
    promising.sort_by(|a, b| b.0.total_cmp(&a.0));
    promising.truncate(FITTED[0]);
    for (gain, law, _) in &promising {
        tracing::debug!("  screen {}: {gain:.1}", law.effect.id());
    }
    let mut brief: Vec<(&Law, Vec<Fitted>)> = promising
        .into_par_iter()
        .map(|(_, law, starts)| (law, starts.fit_briefly(all, now, None, 1, Some(&screen))))
        .collect();
    let first = |tries: &[Fitted]| tries.first().map_or(f64::INFINITY, |t| score(all, t));
    brief.sort_by(|a, b| first(&a.1).total_cmp(&first(&b.1)));
    brief.truncate(FITTED[1]);
    let memo = Memo::default();
    let mut done: Vec<(f64, Law, Fitted)> = brief
        .into_par_iter()
        .filter_map(|(law, tries)| {
            let fitted = finished(all, tries, &memo).into_iter().next()?;
            Some((score(all, &fitted), *law, fitted))
        })
        .collect();
    done.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best = done.first()?.0;
    // Of laws that explain it as well the first of the grammar: simple shapes stand first.
    let place = |law: &Law| laws.iter().position(|l| l.effect.id() == law.effect.id());
    done.into_iter()
        .filter(|(score, ..)| score - best < ALIKE)
        .min_by_key(|(_, law, _)| place(law))
        .map(|(_, law, fitted)| (law, fitted))
}

/// A found law in formulas and words. `named`: named effects beside it.
fn described(all: &Observations, found: Found, named: usize, [before, after]: [&Comparison; 2]) -> Proposal {
    let fitted = &found.fitted;
    let first = fitted.effects.len() - found.laws.len();
    let (mut formulas, mut parameters) = (BTreeMap::<String, String>::new(), BTreeMap::new());
    let mut words = Vec::new();
    for (number, law) in found.laws.iter().enumerate() {
        let (effect, values) = &fitted.effects[first + number];
        let mut formula = law.shape.formula.to_string();
        for (p, (value, error)) in
            effect.parameters().iter().zip(values.iter().zip(&fitted.std_err[first + number]))
        {
            let name =
                if found.laws.len() == 1 { p.name.into() } else { format!("{}{}", p.name, number + 1) };
            formula = renamed(&formula, p.name, &name);
            parameters.insert(name, Quantity { value: *value, std_err: *error, unit: p.unit.into() });
        }
        for (target, part) in law.target.parts {
            let formula = laws::part_of(*part, &formula);
            formulas
                .entry((*target).into())
                .and_modify(|f| *f = format!("{f} + {formula}"))
                .or_insert(formula);
        }
        words.push(in_words(all, fitted, first + number, law));
    }
    let causes: Vec<_> = found.laws.iter().flat_map(|l| causes::of(l.target.name, l.shape.growth)).collect();
    let beside = fitted.effects[first - named..first].iter().map(|(e, _)| e.id().to_string()).collect();
    let mut said: Vec<String> = causes.iter().map(|c| c.mechanism.to_string()).collect();
    said.dedup();
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
        gain_open_rel: mixed(all, fitted, &found.laws),
        effects: first,
        comparison: Some(after.clone()),
        fitted: Some(found.fitted),
    }
}

/// A formula with one of its parameters under another name.
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

/// A law as a sentence of physics, with its size at the brightest level, or in darks where it is largest there.
fn in_words(all: &Observations, fitted: &Fitted, at: usize, law: &Law) -> String {
    let with = fitted.predict(all);
    let mut rest = fitted.clone();
    rest.effects.remove(at);
    let without = rest.predict(all);
    let value = fitted.effects[at].1
        [fitted.effects[at].0.parameters().iter().position(|p| p.name == "k").unwrap_or(0)];
    let sign = if value < 0.0 { "less" } else { "more" };
    let of = |set: usize| size(law.target.kind, law.target, [&with, &without], set);
    let sets = (0..with.sets.len()).map(|set| (set, of(set)));
    let largest = sets.max_by(|a, b| a.1.of_all.total_cmp(&b.1.of_all));
    let size = largest.map_or(String::new(), |(set, size)| {
        let level = (without.sets[set].signal).round() + 0.0;
        match law.target.kind {
            Kind::Level => format!("{:+.3} DN at {level:.0} DN, {} of it", size.dn, percent(size.of_all)),
            Kind::Lines => format!("{:.3} DN at {level:.0} DN", size.dn),
            _ => format!("{} of the noise variance at {level:.0} DN", percent(size.of_all)),
        }
    });
    let words = match law.target.kind {
        Kind::Level => format!("the {} is {}", law.target.words, law.shape.words),
        _ => format!("{sign} {}, {}", law.target.words, law.shape.words),
    };
    if size.is_empty() { words } else { format!("{words} ({size})") }
}

/// Sum of the covariances of all other pixels over the variance of one, at the brightest level, of laws that grow
/// with signal or noise. A filter that keeps the mean leaves so much less of the variance (Moore, Ninkov and
/// Forrest 2006, Opt. Eng. 45, 076402); noise that is added leaves it.
fn mixed(all: &Observations, fitted: &Fitted, laws: &[Law]) -> f64 {
    let grows = |law: &&Law| {
        let shared = law.target.kind == Kind::Shared;
        shared && !matches!(law.shape.growth, Growth::Constant | Growth::Exposure)
    };
    if !laws.iter().any(|law| grows(&law)) {
        return 0.0;
    }
    let prediction = fitted.predict(all);
    let lit = prediction.sets.iter().zip(&all.campaign.sets).filter(|(_, info)| info.light.is_some());
    let brightest = lit.map(|(s, _)| s).max_by(|a, b| a.signal.total_cmp(&b.signal));
    let Some(s) = brightest else { return 0.0 };
    let power = s.shot.of_mean() + s.read.of_mean() + 2.0 * s.uphill;
    let variance = s.shot.lag(0, 0) + s.read.lag(0, 0);
    (power / variance - 1.0).abs()
}

/// Size of a law in one set.
struct InSet {
    dn: f64,
    of_all: f64,
}

fn size(kind: Kind, target: &laws::Target, [with, without]: [&Prediction; 2], set: usize) -> InSet {
    let (a, b): (&SetPrediction, &SetPrediction) = (&with.sets[set], &without.sets[set]);
    let variance = b.covariance(0, 0).max(1e-12);
    let target = target.parts.first().map_or("", |part| part.0);
    let of = |s: &SetPrediction| match target {
        "variance" => s.covariance(0, 0),
        "row" => s.row.lag(0),
        "column" => s.column.lag(0),
        "common" => s.common,
        "cov_1-1" => s.uphill,
        "parity_01" => s.parity.0,
        "parity_10" => s.parity.1,
        "mean" => s.signal,
        _ => {
            let digit = |at: usize| target.as_bytes().get(at).map_or(0, |c| i32::from(c - b'0'));
            s.read.lag(digit(4), digit(5))
        }
    };
    let off = of(a) - of(b);
    match kind {
        Kind::Level => InSet { dn: off, of_all: off.abs() / b.signal.abs().max(1.0) },
        Kind::Lines => InSet { dn: off.abs().sqrt(), of_all: off.abs() / variance },
        Kind::Pixels | Kind::Shared => InSet { dn: off.abs().sqrt(), of_all: off.abs() / variance },
    }
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
