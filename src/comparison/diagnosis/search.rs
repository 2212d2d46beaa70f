//! Search over sets of effects: several lines are followed, and effects that others replace are dropped
//! again.

use super::memo::{Memo, key, of_effects};
use super::memory::is_memory;
use super::part::{BARE_MENTION, MAX_MEAN_SQUARE};
use super::starts::{Starts, finished, sorted};
use super::{HOLDS, TIE};
use crate::dataset::Kind;
use crate::inference::{
    Effects, Fitted, Given, Residual, Screen, as_given, compare, fit, fit_near, has_flats, residuals_of,
    seen, start,
};

use crate::observables::profile::LineProfile;
use crate::observables::{Observations, Statistic, covariance, frame_scatter, mean, settling, succession};
use radcam_sim::effects::{self, Effect, Needs, Seen};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Maximum number of effects added.
const MOST: usize = 8;
/// Minimum evidence of an addition (twice the logarithm of a Bayes factor, by BIC): with some 30 candidates
/// tried, chance reaches this less than once in a hundred campaigns.
pub const NEEDED: f64 = 9.0;
/// Maximum number of candidates that are fitted, the most promising first.
const FITTED: usize = 11;
/// Maximum number of rivals that are fitted for an effect of a model.
const RIVALS: usize = 4;
/// Minimum promised gain of a rival that is fitted, as a share of the evidence of the effect in the model. A
/// named choice: on the 182 cameras of docs/CONFUSION.md as many are right, unknown and wrong as without it.
const NO_RIVAL: f64 = 0.03;
/// Maximum number of forms of an effect that are fitted: of a candidate, and of the most promising one.
const FORMS: [usize; 2] = [3, 11];
/// Minimum size that is something, in standard errors: 0 is rejected at 1 in 80.
const KNOWN: f64 = 2.5;
/// Minimum size, in standard errors, of the scatter of settings or of frames, of which there may be two.
const KNOWN_SCATTER: f64 = 1.2;
/// Minimum evidence of a candidate after a few rounds, as a share of the best, for a fit to convergence.
const BEHIND: f64 = 0.3;
/// Minimum gain of a candidate beside another one, as a share of its evidence, if it explains something else.
const SOMETHING_ELSE: f64 = 0.5;
/// Minimum ratio of a squared size over its squared error to its price for an effect that is not left out for
/// a try (a named choice).
const SURELY: f64 = 4.0;
/// Maximum number of lines followed at once.
const LINES: usize = 3;
/// Minimum evidence, as a share of the best, of a candidate that is followed beside a scatter that explains
/// most.
const MOST_OF: f64 = 0.5;
/// Maximum shortfall of a second line's evidence behind the best line's.
const NEAR: f64 = 40.0;

/// Minimum ratio of errors for a statistic to be excused and not explained (a named choice).
const WIDER: f64 = 1.5;

/// Minimum share of the best candidate's evidence for another that explains the same (a named choice).
const NEARLY: f64 = 0.9;
/// Minimum evidence of an effect far beyond doubt: the errors of its prediction then matter more than its
/// size (a named choice).
const MANY: f64 = 1e3;

/// A candidate after its fit.
#[derive(Clone)]
pub struct Candidate {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// The model with it.
    pub fitted: Fitted,
    /// Evidence against the model without it.
    pub evidence: f64,
    /// Model with a simpler form of the effect that explains nearly as much, where neither describes the
    /// campaign: a flexible form takes over a part of what a second effect does.
    simpler: Option<Box<Fitted>>,
}

/// Returns the kind of statistics that the campaign has.
fn there(all: &Observations) -> Needs {
    match (all.has(&frame_scatter::FrameScatter), all.has(&covariance::Covariance)) {
        (true, _) => Needs::Frames,
        (_, true) => Needs::Covariances,
        _ => Needs::Variances,
    }
}

/// Computes the price of a model: its parameters by BIC, and twice the logarithm of the number of forms of
/// each effect and of its rarity. The prior is spread evenly over the forms of a name (Kass and Raftery 1995,
/// J. Am. Stat. Assoc. 90, 773).
fn price(all: &Observations, fitted: &Fitted) -> f64 {
    let forms: f64 = fitted.effects.iter().map(|(e, _)| 2.0 * (forms(*e) as f64).ln() + e.rarer()).sum();
    fitted.parameters() as f64 * (all.list.len() as f64).ln() + forms
}

/// Counts the combinations of the choices of an effect.
fn forms(effect: &dyn Effect) -> usize {
    let choices = effect.parameters().iter().filter(|p| p.is_choice());
    choices.map(|p| p.starts.len().max(1)).product()
}

/// Computes minus twice the logarithm of a model's evidence.
pub fn score(all: &Observations, fitted: &Fitted) -> f64 {
    fitted.objective + price(all, fitted)
}

/// Finds effects that could replace one with this evidence in a model, fitted beside the rest; most evidence
/// first.
pub fn rivals(all: &Observations, rest: &Fitted, of: &dyn Effect, evidence: f64) -> Vec<Candidate> {
    let memo = &Memo::default();
    Look { all, now: rest, guess: None, most: RIVALS, not: &[(of.id(), None)], against: evidence, memo }
        .candidates()
}

/// Fits every effect that a model lacks beside those that it has; most evidence first. `fresh`: also from a
/// first guess of the paper's parameters, since a fit that is far off may have distorted sound values. `not`:
/// excluded effects.
fn candidates(all: &Observations, now: &Fitted, fresh: bool, not: &[Banned], memo: &Memo) -> Vec<Candidate> {
    let guess = fresh.then(|| now.with_base(start(all)));
    Look { all, now, guess, most: FITTED, not, against: 0.0, memo }.candidates()
}

/// Excluded effect: in one of its forms, by the bits of its choices, or in all of them.
type Banned = (&'static str, Option<Vec<u64>>);

/// Returns the bits of an effect's choices.
pub fn choices(effect: &dyn Effect, values: &[f64]) -> Vec<u64> {
    let of = effect.parameters().iter().zip(values).filter(|(p, _)| p.is_choice());
    of.map(|(_, v)| v.to_bits()).collect()
}

/// Counts the parameters that an effect uses at these values.
pub fn used(effect: &dyn Effect, values: &[f64]) -> usize {
    (0..values.len()).filter(|k| effect.uses(values, *k)).count()
}

/// Search for additions to a model.
struct Look<'a> {
    all: &'a Observations,
    now: &'a Fitted,
    /// Same effects beside a first guess of the paper's parameters.
    guess: Option<Fitted>,
    /// Maximum number of effects that are fitted, the most promising first.
    most: usize,
    /// Excluded effects.
    not: &'a [Banned],
    /// Evidence of the effect to be replaced; 0 without one.
    against: f64,
    memo: &'a Memo,
}

/// An effect with its starts, and the promised gain of the best of them.
struct Promising {
    gain: f64,
    starts: Starts,
}

impl Look<'_> {
    fn candidates(&self) -> Vec<Candidate> {
        let screen = Screen::new(self.all, self.now, NO_RIVAL * self.against);
        let chosen = self.chosen(self.screened(&screen));
        let best = chosen.iter().map(|p| p.gain).filter(|g| g.is_finite()).fold(0.0, f64::max);
        let brief: Vec<(&'static dyn Effect, Vec<Fitted>)> = chosen
            .into_par_iter()
            .map(|p| {
                let effect = p.starts.effect;
                let forms = FORMS[usize::from(p.gain >= best)];
                let guess = self.guess.as_ref();
                let mut key = key(self.now);
                key.extend([forms as u64, u64::from(guess.is_some())]);
                key.extend(of_effects(&p.starts.values().map(|v| (effect, v.clone())).collect()));
                let fits = || p.starts.fit_briefly(self.all, self.now, guess, forms, Some(&screen));
                (effect, self.memo.fits(key, fits))
            })
            .collect();
        // A few rounds tell which candidates are far behind; the others are fitted to convergence.
        let first = |tries: &[Fitted]| Some(self.evidence(tries.first()?));
        brief.iter().for_each(|(effect, tries)| self.trace("a few rounds", *effect, tries));
        let ahead = brief.iter().filter_map(|(_, tries)| first(tries)).fold(self.against, f64::max);
        let mut found: Vec<Candidate> = brief
            .into_par_iter()
            .filter_map(|(effect, mut tries)| {
                let is_near = |t: &Fitted| self.evidence(t) > BEHIND * ahead;
                if is_near(tries.first()?) {
                    tries.retain(is_near);
                    tries = finished(self.all, tries, self.memo);
                }
                self.standing(effect, tries)
            })
            .collect();
        found.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        for c in found.iter().take(6) {
            let at = c.fitted.effects.len() - 1;
            let (values, errors) = (&c.fitted.effects[at].1, &c.fitted.std_err[at]);
            tracing::debug!("{}: evidence {:.1}, {values:?} +- {errors:?}", c.effect.id(), c.evidence);
        }
        found
    }

    /// Returns the effects that the model lacks and this campaign could show, the most promising first.
    fn screened(&self, screen: &Screen<'_>) -> Vec<Promising> {
        let mut ids: Vec<&str> = self.now.effects.iter().map(|(e, _)| e.id()).collect();
        ids.extend(self.not.iter().filter(|(_, form)| form.is_none()).map(|(id, _)| *id));
        let is_banned = |effect: &'static dyn Effect, values: &[f64]| {
            self.not.iter().any(|(id, form)| {
                *id == effect.id() && form.as_ref().is_some_and(|form| *form == choices(effect, values))
            })
        };
        let there = there(self.all);
        let first_seen = self.guess.as_ref().map(|g| seen(self.all, &g.base));
        let seen = seen(self.all, &self.now.base);
        let promising = |effect: &&'static dyn Effect| {
            let mut hinted = effect.starts(&seen);
            if let Some(first) = &first_seen {
                let fresh: Vec<Vec<f64>> =
                    effect.starts(first).into_iter().filter(|s| !hinted.contains(s)).collect();
                hinted.extend(fresh);
            }
            let mut starts = Starts::of(screen, *effect, &[], &hinted);
            starts.retain(|values| !is_banned(*effect, values));
            Some(Promising { gain: starts.gain()?, starts })
        };
        let lit = has_flats(self.all);
        let tells = |e: &&&'static dyn Effect| {
            e.needs() <= there
                && !(self.all.means_given && e.needs() == Needs::Means)
                && (lit || e.shows_in_darks())
        };
        let list: Vec<&'static dyn Effect> =
            effects::considered().iter().filter(|e| !ids.contains(&e.id())).filter(tells).copied().collect();
        let mut found: Vec<Promising> = list.par_iter().filter_map(promising).collect();
        found.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        for p in found.iter().take(FITTED + 3) {
            let first = p.starts.values().next();
            tracing::debug!("  screen {}: {:.1} at {first:?}", p.starts.effect.id(), p.gain);
        }
        found
    }

    /// Selects the effects to fit. A score test of expectations does not see effects that move only errors:
    /// these are always fitted.
    fn chosen(&self, promising: Vec<Promising>) -> Vec<Promising> {
        let needed = NEEDED.max(NO_RIVAL * self.against);
        let (always, rest): (Vec<_>, Vec<_>) = promising.into_iter().partition(|p| p.gain.is_infinite());
        always.into_iter().chain(rest.into_iter().filter(|p| p.gain > needed).take(self.most)).collect()
    }

    /// Returns the best form of an effect among those whose values are known.
    fn standing(&self, effect: &'static dyn Effect, tries: Vec<Fitted>) -> Option<Candidate> {
        let seen = seen(self.all, &self.now.base);
        let stands = |c: &Candidate| {
            let told = || is_told(self.all, self.now, &c.fitted, c.effect, &seen);
            (stands(c, &seen) || told()) && is_shown(self.all, c) && !self.only_excuses(c)
        };
        self.trace("to the end", effect, &tries);
        let tries = tries.into_iter().map(|fitted| Candidate {
            effect,
            evidence: self.evidence(&fitted),
            fitted,
            simpler: None,
        });
        let standing: Vec<Candidate> = tries.filter(stands).collect();
        // Forms that explain it equally well are tied: the first of the effect's list is taken.
        let best = standing.first()?.evidence;
        let form = |c: &&Candidate| c.fitted.effects.last().map(|(e, values)| choices(*e, values));
        let number = |c: &Candidate| c.fitted.effects.last().map_or(0, |(e, values)| used(*e, values));
        let chosen = standing.iter().filter(|c| best - c.evidence < BARE_MENTION).min_by_key(form)?;
        let nearly = standing.iter().filter(|c| c.evidence > NEARLY * best && number(c) < number(chosen));
        let simplest =
            nearly.filter(|_| chosen.fitted.mean_square > MAX_MEAN_SQUARE).min_by_key(|c| number(c));
        let simpler = simplest.map(|c| Box::new(c.fitted.clone()));
        Some(Candidate { simpler, ..chosen.clone() })
    }

    /// Logs fits of an effect with their evidence.
    fn trace(&self, stage: &str, effect: &'static dyn Effect, tries: &[Fitted]) {
        for t in tries {
            let last = t.effects.last().map(|(_, values)| values).zip(t.std_err.last());
            tracing::trace!("  {stage} of {}: {:.1} at {last:?}", effect.id(), self.evidence(t));
        }
    }

    fn evidence(&self, fitted: &Fitted) -> f64 {
        score(self.all, self.now) - score(self.all, fitted)
    }

    /// Returns true for a candidate that only widens errors, which fits anything. No effect predicts profiles
    /// of lines: a gain there comes from their errors. A bend of the response moves means and unequal codes
    /// move shares of codes: a gain by residuals that are as large as before and count less comes from the
    /// rounding of a table, or from tails of the noise. Scatter rightly widens errors.
    fn only_excuses(&self, c: &Candidate) -> bool {
        let (now, with) = (residuals_of(self.all, self.now), residuals_of(self.all, &c.fitted));
        let differ = |(a, b): (&Residual, &Residual)| a.set != b.set || a.statistic != b.statistic;
        if now.len() != with.len() || now.iter().zip(&with).any(differ) {
            return false;
        }
        let profiles = LineProfile.id();
        let all = !c.effect.adds_scatter();
        let pairs = now.iter().zip(&with).filter(|(_, b)| all || b.statistic == profiles);
        let gained = pairs.filter(|(a, b)| b.std_err > WIDER * a.std_err).map(|(a, b)| {
            let ratio = b.std_err / a.std_err;
            let as_before = if b.statistic == profiles { a.z } else { b.z * ratio };
            as_before.powi(2) - b.z.powi(2) - 2.0 * ratio.ln()
        });
        let gained: f64 = gained.sum();
        if gained > 0.0 && c.evidence - gained < NEEDED {
            tracing::debug!("{} only widens errors: {:.1} of {gained:.1}", c.effect.id(), c.evidence);
            return true;
        }
        false
    }
}

/// Returns true if a candidate is something by itself: see [`is_something`].
fn stands(c: &Candidate, seen: &Seen) -> bool {
    is_something(&c.fitted, c.fitted.effects.len() - 1, seen)
}

/// Minimum mean residual of the statistic that is an effect's own scatter, in standard errors; below it the
/// scatter is not there.
const NOT_THERE: f64 = -1.5;

/// Maximum likeness of successive frames, in standard errors over all sets, for scatter that is independent
/// from frame to frame.
const IN_TURN: f64 = 6.0;

/// Returns true if the scatter that an effect brings is measured, or no statistic shows it.
fn is_shown(all: &Observations, c: &Candidate) -> bool {
    let Some(statistic) = c.effect.shown_by() else { return true };
    let residuals = residuals_of(all, &c.fitted);
    let of = |name: &str| -> (f64, f64) {
        residuals.iter().filter(|r| r.statistic == name).fold((0.0, 0.0), |(sum, n), r| (sum + r.z, n + 1.0))
    };
    let (sum, n) = of(statistic);
    let (in_turn, frames) = of(succession::Succession.id());
    (n == 0.0 || sum / n > NOT_THERE) && (frames == 0.0 || in_turn.abs() / frames.sqrt() < IN_TURN)
}

/// Returns true if an effect explains something: not if its sizes are zero within their errors, nor if one is
/// at the end of its range, nor if it has become another effect.
pub fn is_something(fitted: &Fitted, at: usize, seen: &Seen) -> bool {
    let ((effect, values), errors) = (&fitted.effects[at], &fitted.std_err[at]);
    if at_an_end(*effect, values) || effect.is_another(values, seen) {
        return false;
    }
    // A scatter with m degrees of freedom is known to 1 / root 2 m of itself: two settings or frames tell it
    // to 0.7.
    let known = if effect.sets_each() || effect.shown_by().is_some() { KNOWN_SCATTER } else { KNOWN };
    let is_known = |value: f64, error: f64| value.abs() > known * error;
    // Two sizes that only their combination tells are each unknown.
    if effect.in_frames(values, seen).iter().any(|t| is_known(t.value, fitted.std_err_of(at, t))) {
        return true;
    }
    let sizes: Vec<usize> = sizes(*effect, values).collect();
    // A size that a fit has driven to rounding is nothing, whatever its error.
    let is_there = |k: usize| values[k].abs() > NOTHING * effect.parameters()[k].max.abs();
    sizes.is_empty() || sizes.iter().any(|&k| is_there(k) && is_known(values[k], errors[k]))
}

/// Tests an effect by the drop in chi-square of its own statistics, for effects of which only a combination
/// of parameters is known. Errors are those of the fit without the effect: enlarging them gains nothing.
pub fn is_told(
    all: &Observations,
    without: &Fitted,
    with: &Fitted,
    effect: &'static dyn Effect,
    seen: &Seen,
) -> bool {
    let values = with.effects.iter().find(|(e, _)| e.id() == effect.id()).map(|(_, values)| values);
    let own = effect.told_by();
    let is_none =
        |v: &Vec<f64>| effect.together(v).is_none() || at_an_end(effect, v) || effect.is_another(v, seen);
    if own.is_empty() || values.is_none_or(is_none) {
        return false;
    }
    let of = |model: &Fitted| -> Vec<Residual> {
        let mut list = residuals_of(all, model);
        list.retain(|r| own.contains(&&*r.statistic));
        list
    };
    let (before, after) = (of(without), of(with));
    let explained = before.iter().zip(&after).map(|(b, a)| {
        let z = |r: &Residual| (r.measured - r.predicted) / b.std_err;
        z(b).powi(2) - z(a).powi(2)
    });
    before.len() == after.len() && explained.sum::<f64>() > NEEDED + (all.list.len() as f64).ln()
}

/// Returns true if an effect is surely there: Wald test of its only size, or of its combined parameters,
/// against the evidence that a name needs beside a model that holds. Few frames tell a scatter to no better
/// than a third however large it is; its test is the deviance of its own statistic. Evidence alone does not
/// suffice: it also rises when errors become smaller.
pub fn surely_there(
    all: &Observations,
    without: &Fitted,
    fitted: &Fitted,
    effect: &'static dyn Effect,
) -> bool {
    let Some(at) = fitted.effects.iter().position(|(e, _)| e.id() == effect.id()) else { return false };
    let ((_, values), errors) = (&fitted.effects[at], &fitted.std_err[at]);
    let needed = NEEDED + (all.list.len() as f64).ln();
    let far = |value: f64, error: f64| value * value >= needed * error * error;
    if effect.shown_by().is_some_and(|statistic| deviance_drop(all, without, fitted, statistic) >= needed) {
        return true;
    }
    let shown = effect.in_frames(values, &seen(all, &fitted.base));
    if !shown.is_empty() {
        return shown.iter().any(|t| far(t.value, fitted.std_err_of(at, t)));
    }
    let sizes: Vec<usize> = sizes(effect, values).collect();
    sizes.len() != 1 || far(values[sizes[0]], errors[sizes[0]])
}

/// Computes the drop in the deviance of a variance: with d degrees of freedom, d (r - 1 - ln r) for a ratio r
/// of measured to predicted (gamma errors; McCullagh and Nelder 1989, section 8.3.2).
fn deviance_drop(all: &Observations, without: &Fitted, with: &Fitted, statistic: &str) -> f64 {
    let deviance = |model: &Fitted| -> f64 {
        let own = residuals_of(all, model).into_iter().filter(|r| r.statistic == statistic);
        own.map(|r| {
            let ratio = (r.measured / r.predicted).max(f64::MIN_POSITIVE);
            2.0 * (r.predicted / r.std_err).powi(2) * (ratio - 1.0 - ratio.ln())
        })
        .sum()
    };
    deviance(without) - deviance(with)
}

/// Returns the indexes of the sizes that an effect uses at these values.
fn sizes<'e>(effect: &'e dyn Effect, values: &'e [f64]) -> impl Iterator<Item = usize> + 'e {
    let is_size = |k: &usize| effect.parameters()[*k].is_size();
    (0..values.len()).filter(|k| effect.uses(values, *k)).filter(is_size)
}

/// Part of the range below which a size is rounding.
const NOTHING: f64 = 1e-15;

/// Returns true if a size is at an end of its range that is not zero.
fn at_an_end(effect: &dyn Effect, values: &[f64]) -> bool {
    sizes(effect, values).any(|k| {
        let (p, v) = (effect.parameters()[k], values[k]);
        let near = |end: f64| (v - end).abs() <= 1e-6 * end.abs();
        near(p.max) || p.min < 0.0 && near(p.min)
    })
}

/// A set of effects, fitted.
#[derive(Clone)]
struct Line {
    fitted: Fitted,
    score: f64,
}

/// Result of a search.
pub struct Found {
    /// Model with all effects found.
    pub fitted: Fitted,
    /// Candidates for the first addition.
    pub first: Vec<Candidate>,
    /// Model of more evidence that was given up because the campaign does not agree with it.
    pub given_up: Option<Fitted>,
}

/// Mean squared residual beyond which a fit may have ended early.
const FAR_SQUARE: f64 = 4.0;

/// Maximum number of searches, each without the forms of effects that had become nothing, before the last
/// one.
const AGAIN: usize = 3;

/// Returns true for an effect of memory whose drop in chi-square comes from the frame means of one set of
/// flats. A lamp that starts dim makes a first frame dark too; charge that is carried over also correlates
/// the noise of frames or shows in other sets.
fn is_of_one_set(all: &Observations, with: &Fitted, at: usize) -> bool {
    let (effect, _) = &with.effects[at];
    if !effect.has_memory() {
        return false;
    }
    let rest = without(all, with, at);
    let (before, after) = (residuals_of(all, &rest), residuals_of(all, with));
    if before.len() != after.len() {
        return false;
    }
    let of_frames: [&dyn Statistic; 4] =
        [&mean::Mean, &settling::Settling, &frame_scatter::FrameScatter, &succession::Succession];
    let of_frames = of_frames.map(|s| s.id());
    let sets = all.kinds.iter().zip(&all.set_numbers);
    let lit: BTreeSet<u32> = sets.filter(|(kind, _)| **kind == Kind::Flat).map(|(_, set)| *set).collect();
    let (mut elsewhere, mut by_set) = (0.0, BTreeMap::<u32, f64>::new());
    for (b, a) in before.iter().zip(&after) {
        let explained = b.z.powi(2) - a.z.powi(2);
        match b.set.filter(|set| lit.contains(set) && of_frames.contains(&b.statistic.as_ref())) {
            Some(set) => *by_set.entry(set).or_default() += explained,
            None => elsewhere += explained,
        }
    }
    let most = by_set.values().copied().fold(0.0, f64::max);
    elsewhere + by_set.values().sum::<f64>() - most < NEEDED
}

/// Adds effects to a model as long as the evidence pays for them. `far`: the model is so far off that its own
/// values may be distorted.
pub fn search(all: &Observations, model: &Fitted, far: bool, progress: &mut dyn FnMut(&str)) -> Found {
    let mut not: Vec<Banned> = Vec::new();
    let memo = Memo::default();
    for _ in 0..AGAIN {
        let found = search_without(all, model, far, &not, &memo, progress);
        let seen = seen(all, &found.fitted.base);
        let added = model.effects.len()..found.fitted.effects.len();
        // An effect fitted beside others may end at values at which it is another one, at an end of its
        // range, or at a size that is nothing within its errors.
        let told = |i: usize, effect: &'static dyn Effect| {
            !effect.told_by().is_empty()
                && is_told(all, &without(all, &found.fitted, i), &found.fitted, effect, &seen)
        };
        let nothing = |i: &usize| {
            let (effect, values) = &found.fitted.effects[*i];
            effect.is_another(values, &seen)
                || at_an_end(*effect, values)
                || !is_something(&found.fitted, *i, &seen) && !told(*i, *effect)
        };
        let before = not.len();
        if added.clone().any(|i| is_of_one_set(all, &found.fitted, i)) {
            not.extend(effects::all().into_iter().filter(|e| e.has_memory()).map(|e| (e.id(), None)));
        }
        let effects_added = || found.fitted.effects[added.clone()].iter();
        if effects_added().any(|(e, _)| e.shown_by().is_some())
            && !found.fitted.effects.iter().any(|(e, _)| e.has_memory())
            && is_memory(all)
        {
            let scatters = effects::all().into_iter().filter(|e| e.shown_by().is_some());
            not.extend(scatters.map(|e| (e.id(), None)));
        }
        // Another form of the same effect may be something.
        let banned = |i: usize| {
            let (effect, values) = &found.fitted.effects[i];
            (effect.id(), Some(choices(*effect, values)))
        };
        not.extend(added.filter(nothing).map(banned));
        if not.len() == before {
            return or_one_that_holds(all, found);
        }
    }
    or_one_that_holds(all, search_without(all, model, far, &not, &memo, progress))
}

/// Replaces what was found by a single effect with which the campaign agrees, if it does not agree with what
/// was found. Evidence also grows as errors become narrower, and a model whose narrow errors are wrong is no
/// better for it.
fn or_one_that_holds(all: &Observations, mut found: Found) -> Found {
    let best = found.first.first().map_or(0.0, |c| c.evidence);
    let reach = if best < MANY { TIE } else { (1.0 - NEARLY) * best };
    let near: Vec<&Candidate> = found.first.iter().filter(|c| best - c.evidence < reach).collect();
    if near.len() < 2 || compare(all, &found.fitted).p_value >= HOLDS {
        return found;
    }
    if let Some(one) = near.into_iter().find(|c| compare(all, &c.fitted).p_value >= HOLDS) {
        tracing::debug!("{} alone agrees, what was found does not", one.effect.id());
        let one = one.fitted.clone();
        found.given_up = Some(std::mem::replace(&mut found.fitted, one));
    }
    found
}

fn search_without(
    all: &Observations,
    model: &Fitted,
    far: bool,
    not: &[Banned],
    memo: &Memo,
    progress: &mut dyn FnMut(&str),
) -> Found {
    let given = model.effects.len();
    let mut lines = vec![Line { score: score(all, model), fitted: model.clone() }];
    let (mut first, mut done, mut looked_at) = (Vec::new(), Vec::new(), Vec::new());
    for depth in 0..MOST {
        let mut next: Vec<Line> = Vec::new();
        for line in &lines {
            let names: Vec<&str> = line.fitted.effects.iter().map(|(e, _)| e.id()).collect();
            if looked_at.contains(&forms_of(&line.fitted)) {
                done.push(line.clone());
                continue;
            }
            if names.len() >= given + MOST {
                done.push(line.clone());
                continue;
            }
            looked_at.push(forms_of(&line.fitted));
            progress(&format!("with {names:?}: trying every effect"));
            let found = candidates(all, &line.fitted, far && depth == 0, not, memo);
            let mut longer = longer(all, &found, given, memo);
            if longer.is_empty() {
                longer = instead(all, &found, line, given, memo);
                done.push(line.clone());
            }
            next.extend(longer);
            if depth == 0 {
                first = found;
            }
        }
        next.sort_by(|a, b| a.score.total_cmp(&b.score));
        next.dedup_by(|a, b| forms_of(&a.fitted) == forms_of(&b.fitted));
        for line in &next {
            tracing::debug!("line {:.1}: {:?}", line.score, forms_of(&line.fitted));
        }
        next.truncate(LINES);
        if next.is_empty() {
            break;
        }
        lines = next;
        if depth + 1 == MOST {
            done.extend(lines.iter().cloned());
        }
    }
    // One more effect must bring as much between lines as within one: two effects are no better than one that
    // explains the same.
    let priced = |l: &Line| l.score + NEEDED * l.fitted.effects.len() as f64;
    let best = done.into_iter().min_by(|a, b| priced(a).total_cmp(&priced(b)));
    // A model that came a long way may have been led astray: it is also fitted from a first guess of the
    // paper's parameters.
    let best = best.map(|l| {
        let from = |base| fit(all, base, &l.fitted.effects);
        let guess = start(all);
        if !far {
            return from(&l.fitted.base);
        }
        let (here, fresh) = rayon::join(|| from(&l.fitted.base), || from(&guess));
        if score(all, &fresh) < score(all, &here) { fresh } else { here }
    });
    let fitted = best.map(|found| with_best_forms(all, found, given, not, memo));
    Found { fitted: fitted.unwrap_or_else(|| model.clone()), first, given_up: None }
}

/// Gives an effect of the model another form if that explains more, or a simpler one that explains as much.
/// An effect that was found beside a stand-in for a part of it, which is gone again, has the form that was
/// left to it.
fn with_best_forms(
    all: &Observations,
    mut model: Fitted,
    given: usize,
    not: &[Banned],
    memo: &Memo,
) -> Fitted {
    if model.effects.len() < given + 2 {
        return model;
    }
    for at in given..model.effects.len() {
        let effect = model.effects[at].0;
        if forms(effect) < 2 {
            continue;
        }
        let rest = without(all, &model, at);
        let others = effects::all().into_iter().filter(|e| e.id() != effect.id()).map(|e| (e.id(), None));
        let not: Vec<Banned> = others.chain(not.iter().cloned()).collect();
        let against = score(all, &rest) - score(all, &model);
        let look = Look { all, now: &rest, guess: None, most: 1, not: &not, against, memo };
        let Some(other) = look.candidates().into_iter().next() else { continue };
        // A simpler form need not pay for itself.
        let now = used(effect, &model.effects[at].1);
        let is_simpler = other.fitted.effects.last().is_some_and(|(e, values)| used(*e, values) < now);
        if other.evidence > against + if is_simpler { 0.0 } else { NEEDED } {
            tracing::debug!(
                "{} in another form: evidence {:.1}, was {against:.1}",
                effect.id(),
                other.evidence
            );
            let mut effects = other.fitted.effects;
            // The new form was added last; it takes the place of the form before.
            effects[at..].rotate_right(1);
            let again = fit(all, &other.fitted.base, &effects);
            if score(all, &again) < score(all, &model) {
                model = again;
            }
        }
    }
    model
}

/// Returns a line with the best of these candidates, and one with the second if that is near; each with the
/// candidates that explain something else.
fn longer(all: &Observations, found: &[Candidate], given: usize, memo: &Memo) -> Vec<Line> {
    let good: Vec<&Candidate> = found.iter().filter(|c| c.evidence > NEEDED).collect();
    let best = good.first().map_or(0.0, |c| c.evidence);
    let mut near: Vec<&Candidate> =
        good.iter().take(2).filter(|c| c.evidence > best - NEAR).copied().collect();
    // A fitted scatter excuses any deviation of what scatters: a candidate that moves means is followed
    // beside it.
    let scatters = |c: &Candidate| c.effect.shown_by().is_some() || c.effect.sets_each();
    if near.iter().all(|c| scatters(c)) {
        near.extend(good.iter().find(|c| !scatters(c) && c.evidence > MOST_OF * best));
    }
    let line = |c: &&Candidate| {
        let fitted = without_idle(all, with_others(all, c, &good, given, memo), given, memo);
        // Fits of models that were far off end early: lines are compared after convergence.
        let fitted =
            if fitted.mean_square > FAR_SQUARE { fit(all, &fitted.base, &fitted.effects) } else { fitted };
        Line { score: score(all, &fitted), fitted }
    };
    let simple = |c: &Candidate| {
        let fitted = c.simpler.as_deref()?.clone();
        let against = c.evidence + score(all, &c.fitted);
        Some(Candidate { evidence: against - score(all, &fitted), fitted, simpler: None, ..c.clone() })
    };
    let simpler: Vec<Candidate> = near.iter().filter_map(|c| simple(c)).collect();
    near.extend(&simpler);
    near.iter().map(line).collect()
}

/// Returns lines in which a candidate that does not pay beside the others replaces some of them.
fn instead(all: &Observations, found: &[Candidate], line: &Line, given: usize, memo: &Memo) -> Vec<Line> {
    let some = found.iter().filter(|c| c.evidence > -NEAR).take(2);
    let lines = some.map(|c| {
        let fitted = without_idle(all, c.fitted.clone(), given, memo);
        Line { score: score(all, &fitted), fitted }
    });
    lines.filter(|l| l.fitted.effects.len() <= line.fitted.effects.len() && l.score < line.score).collect()
}

/// Returns the effects of a model, each with the bits of its choices.
fn forms_of(fitted: &Fitted) -> Vec<(&'static str, Vec<u64>)> {
    let mut forms: Vec<_> = fitted.effects.iter().map(|(e, values)| (e.id(), choices(*e, values))).collect();
    forms.sort_unstable();
    forms
}

/// Adds the candidates that explain something else to a candidate's model: each gains beside it most of what
/// it gained alone.
fn with_others(
    all: &Observations,
    chosen: &Candidate,
    good: &[&Candidate],
    given: usize,
    memo: &Memo,
) -> Fitted {
    let mut model = chosen.fitted.clone();
    for other in good.iter().filter(|c| c.effect.id() != chosen.effect.id()) {
        let Some(own) = other.fitted.effects.last().filter(|_| model.effects.len() < given + MOST) else {
            continue;
        };
        let mut effects = model.effects.clone();
        effects.push(own.clone());
        let both = memo.near(all, &model, &effects);
        let gain = score(all, &model) - score(all, &both);
        if gain > SOMETHING_ELSE * other.evidence && gain > NEEDED {
            model = both;
        }
    }
    model
}

/// Refits a model without one of its effects.
pub fn without(all: &Observations, model: &Fitted, which: usize) -> Fitted {
    fit_near(all, model, &effects_without(model, which))
}

fn effects_without(model: &Fitted, which: usize) -> Effects {
    let mut effects = model.effects.clone();
    effects.remove(which);
    effects
}

/// Returns true if an effect of a model pays for itself beyond doubt: by its squared size over its squared
/// error (Wald's test), which a fit without it would give to within a small factor.
fn surely_pays(all: &Observations, model: &Fitted, which: usize) -> bool {
    let (effect, values) = &model.effects[which];
    let parameters = effect.parameters();
    let price = NEEDED + parameters.len() as f64 * (all.list.len() as f64).ln();
    let square = |k: usize| (values[k] / model.std_err[which][k]).powi(2);
    sizes(*effect, values).any(|k| square(k) > SURELY * price && square(k).is_finite())
}

/// Drops effects whose evidence no longer pays for them.
fn without_idle(all: &Observations, mut model: Fitted, given: usize, memo: &Memo) -> Fitted {
    while model.effects.len() > given + 1 {
        let doubtful =
            (given..model.effects.len() - 1).into_par_iter().filter(|i| !surely_pays(all, &model, *i));
        let tries: Vec<Fitted> =
            doubtful.map(|i| memo.near(all, &model, &effects_without(&model, i))).collect();
        let best = tries.into_iter().min_by(|a, b| score(all, a).total_cmp(&score(all, b)));
        match best {
            Some(less) if score(all, &less) - score(all, &model) < NEEDED => model = less,
            _ => break,
        }
    }
    model
}

/// Finds values of effects' parameters that are not given, by adding one effect after the other to the known
/// ones. An effect that moves nothing measured stays at its first start.
pub fn searched(all: &Observations, given: &[Given]) -> Effects {
    let known = |(e, values): &Given| Some((*e, values.iter().copied().collect::<Option<Vec<f64>>>()?));
    if given.iter().all(|g| known(g).is_some()) {
        return given.iter().filter_map(known).collect();
    }
    let certain: Effects = given.iter().filter_map(known).collect();
    let mut now = fit(all, &start(all), &certain);
    for unknown in given.iter().filter(|g| known(g).is_none()) {
        now = with_one(all, now, unknown);
    }
    let place = |e: &&'static dyn Effect| given.iter().position(|g| g.0.id() == e.id());
    now.effects.sort_by_key(|(e, _)| place(e));
    now.effects
}

/// Adds one effect to a model, and searches for the values of its parameters that are not given.
fn with_one(all: &Observations, now: Fitted, (effect, given): &Given) -> Fitted {
    let guess = now.with_base(start(all));
    let mut hinted = effect.starts(&seen(all, &guess.base));
    hinted.extend(effect.starts(&seen(all, &now.base)));
    // Also from the first guess: a fit that lacks the effect may lie far off.
    let brief = [&guess, &now].map(|from| {
        let starts = Starts::of(&Screen::new(all, from, 0.0), *effect, given, &hinted);
        starts.fit_briefly(all, &now, Some(&guess), FORMS[1], None)
    });
    finished(all, sorted(all, brief.concat()), &Memo::default()).into_iter().next().unwrap_or_else(|| {
        let first = hinted.into_iter().next();
        let first = first.unwrap_or_else(|| effect.parameters().iter().map(|p| p.min.max(0.0)).collect());
        let mut still = now;
        still.effects.push((*effect, as_given(&first, given)));
        still
    })
}
