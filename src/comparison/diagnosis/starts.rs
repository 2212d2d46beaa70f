//! Fits of a model with one more effect, from several starts.

use super::memo::Memo;
use super::search::{choices, score, used};
use crate::inference::{Effects, Fitted, Scored, Screen, as_given, fit_briefly};
use crate::observables::Observations;
use radcam_sim::effects::{self, Effect};
use radcam_sim::predict::BaseParameters;
use rayon::prelude::*;

/// Maximum number of starts of one effect, beyond one of each form, that are fitted for a few rounds.
const MAX_MORE: usize = 3;
/// Maximum number of fits of one effect to convergence.
const MAX_FINISHED: usize = 4;
/// Maximum difference of two scores, over the mean squared residual, of fits at the same point (a named
/// choice).
const SAME_SCORE: f64 = 0.01;
/// Maximum ratio of two sizes whose fits end at one point (a named choice: a fit passes over as much in one
/// step).
const NEAR_SIZE: f64 = 1.05;
/// Minimum share of the read noise's variance that a start leaves to the read noise (a named choice).
const MIN_READ_SHARE: f64 = 0.1;

/// Starts of one effect.
pub struct Starts {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Starts with their sizes scaled by score tests, the most promising first.
    scored: Vec<Scored>,
    /// Unscaled starts, for an effect that the fitted read noise absorbs.
    unscaled: Vec<Vec<f64>>,
}

impl Starts {
    /// Builds starts from these hints, scaled by score tests; `given`: known values.
    pub fn of(
        screen: &Screen<'_>,
        effect: &'static dyn Effect,
        given: &[Option<f64>],
        hinted: &[Vec<f64>],
    ) -> Self {
        let unscaled = if effect.read_noise_absorbs_it() {
            hinted.iter().map(|values| as_given(values, given)).collect()
        } else {
            Vec::new()
        };
        Self { effect, scored: screen.starts(effect, given, hinted), unscaled }
    }

    /// Drops the starts that `keep` refuses.
    pub fn retain(&mut self, keep: impl Fn(&[f64]) -> bool) {
        self.scored.retain(|start| keep(&start.values));
        self.unscaled.retain(|values| keep(values));
    }

    /// Returns the gain that the best start promises; `None` if no start moves an observable.
    pub fn gain(&self) -> Option<f64> {
        self.scored.first().map(|start| start.gain)
    }

    /// Returns the values of all starts, the most promising first.
    pub fn values(&self) -> impl Iterator<Item = &Vec<f64>> {
        self.scored.iter().map(|start| &start.values).chain(&self.unscaled)
    }

    /// Fits the model with the effect for a few rounds; returns the fits, the best first. It starts from the
    /// best start of each of so many forms, then from others.
    pub fn fit_briefly(
        &self,
        all: &Observations,
        now: &Fitted,
        guess: Option<&Fitted>,
        forms: usize,
        screen: Option<&Screen<'_>>,
    ) -> Vec<Fitted> {
        let effect = self.effect;
        let mut picked: Vec<&Vec<f64>> = Vec::new();
        for values in self.values() {
            if !picked.iter().any(|p| choices(effect, p) == choices(effect, values)) {
                picked.push(values);
            }
        }
        picked.truncate(forms);
        let scored = self.scored.iter().map(|start| &start.values).filter(|values| !picked.contains(values));
        // The promise of a start says little if the effect has no size: all are tried.
        let has_size = effect.parameters().iter().any(effects::Parameter::is_size);
        let most = if has_size { MAX_MORE } else { self.scored.len() };
        let more: Vec<&Vec<f64>> = scored.take((most + 1).saturating_sub(picked.len()).max(1)).collect();
        // The form with the fewest parameters is always tried: where many frequencies promise as much, none
        // of them may be needed.
        let of_the_forms =
            |values: &&Vec<f64>| picked.iter().any(|p| choices(effect, p) == choices(effect, values));
        let simplest = self.values().filter(of_the_forms).min_by_key(|values| used(effect, values));
        for values in more.into_iter().chain(simplest).chain(&self.unscaled) {
            if !picked.iter().any(|p| is_near(effect, p, values)) {
                picked.push(values);
            }
        }
        let bases: Vec<&Fitted> = std::iter::once(now).chain(guess).collect();
        let tries: Vec<(&Fitted, &Vec<f64>)> =
            bases.into_iter().flat_map(|b| picked.iter().map(move |values| (b, *values))).collect();
        let brief = tries.into_par_iter().map(|(from, values)| {
            let mut effects: Effects = from.effects.clone();
            effects.push((effect, values.clone()));
            if effect.read_noise_absorbs_it() {
                return fit_briefly(all, &without_added_noise(all, &from.base, &effects), &effects, None);
            }
            // Slopes at the current fit do not hold at a fresh guess.
            let known = screen.filter(|_| std::ptr::eq(from, now)).map(Screen::slopes);
            fit_briefly(all, &from.base, &effects, known)
        });
        sorted(all, brief.collect())
    }
}

/// Reduces the read noise, and its spread over the pixels, by what the last of some effects adds to both in
/// darks.
fn without_added_noise(all: &Observations, base: &BaseParameters, effects: &Effects) -> BaseParameters {
    let dark = all.campaign.sets.iter().position(|s| s.light.is_none()).unwrap_or(0);
    let of = |effects: &[(&'static dyn Effect, Vec<f64>)]| {
        let list: Vec<(&dyn Effect, &[f64])> = effects.iter().map(|(e, p)| (*e, p.as_slice())).collect();
        let out = effects::predict(&all.campaign, base, &list);
        out.sets.get(dark).map_or((0.0, 0.0), |s| (s.covariance(0, 0), s.unequal))
    };
    let (with, without) = (of(effects), of(&effects[..effects.len() - 1]));
    let square = base.gain_dn_per_e.powi(2);
    let read = base.read_noise_e.powi(2);
    let left = (read - (with.0 - without.0) / square).max(MIN_READ_SHARE * read);
    let spread = base.read_noise_spread * read * read - (with.1 - without.1) / (square * square);
    let least = base.read_noise_spread.min(0.1);
    BaseParameters {
        read_noise_e: left.sqrt(),
        read_noise_spread: (spread / (left * left)).clamp(least, base.read_noise_spread),
        ..base.clone()
    }
}

/// Returns true for two starts of an effect that differ only in their sizes, and by little.
fn is_near(effect: &dyn Effect, one: &[f64], other: &[f64]) -> bool {
    effect
        .parameters()
        .iter()
        .zip(one.iter().zip(other))
        .all(|(p, (a, b))| a == b || p.is_size() && a * b > 0.0 && (a / b).max(b / a) < NEAR_SIZE)
}

/// Sorts models by their score, the best first.
pub fn sorted(all: &Observations, mut models: Vec<Fitted>) -> Vec<Fitted> {
    models.sort_by(|a, b| score(all, a).total_cmp(&score(all, b)));
    models
}

/// Fits the best of some models to convergence; returns the best first.
pub fn finished(all: &Observations, mut models: Vec<Fitted>, memo: &Memo) -> Vec<Fitted> {
    models.dedup_by(|a, b| is_same_place(all, a, b));
    let all_of = models.into_par_iter().take(MAX_FINISHED).map(|m| memo.near(all, &m, &m.effects));
    sorted(all, all_of.collect())
}

/// Returns true for two fits of the same effects at the same point.
fn is_same_place(all: &Observations, one: &Fitted, other: &Fitted) -> bool {
    (score(all, one) - score(all, other)).abs() < SAME_SCORE * one.mean_square.max(1.0)
        && one.effects.iter().zip(&other.effects).all(|((e, a), (_, b))| e.form(a) == e.form(b))
}
