//! Fits a model's free parameters to observables: generalised least squares with errors that the model itself predicts.
//!
//! Within a round the errors are held (quasi-likelihood: McCullagh and Nelder 1989, ch. 9), so that no parameter gains by widening the
//! error of something else: flicker is told by the scatter of frames, and the scatter of a lamp's settings by that of sets.

use super::free::{Common, Free, Point};
use super::layout::{Layout, State};
use super::normal::Covariance;
use super::slopes::Slopes;
use super::system::System;
use crate::observables::{Half, Observations, codes_used, mean};
use radcam_sim::effects::{self, Effect, Seen, Together};
use radcam_sim::predict::{BaseParameters, Prediction};
use std::sync::Arc;

/// Rounds of Levenberg and Marquardt at most.
const ROUNDS: usize = 40;
/// Rounds after which the better of two starts shows.
const FIRST_ROUNDS: usize = 5;
/// A round that gains less of the objective has arrived, where residuals are of the size of their errors; where they are larger, by their mean
/// square less.
const ARRIVED: f64 = 1e-3;
/// A step that gains less than this share of what it promised was promised too much.
const HOLDS: f64 = 0.8;
/// Slopes are taken again after more than so many such steps, one after the other.
const MENDED: usize = 2;
/// A mean square of residuals from which on a model is far off.
const FAR_SQUARE: f64 = 4.0;
/// Slopes serve in so many rounds at most, on average.
const SERVED: usize = 3;

/// Effects with the values of their parameters.
pub type Effects = Vec<(&'static dyn Effect, Vec<f64>)>;

/// An effect with what is given of its parameters, in their order.
pub type Given = (&'static dyn Effect, Vec<Option<f64>>);

/// A model with values: the paper's parameters and effects.
#[derive(Clone)]
pub struct Fitted {
    /// The paper's.
    pub base: BaseParameters,
    /// Effects with their parameters.
    pub effects: Effects,
    /// Minus twice the logarithm of the likelihood.
    pub objective: f64,
    /// Mean square of the standardised residuals of what was fitted.
    pub mean_square: f64,
    /// Standard errors of the effects' parameters.
    pub std_err: Vec<Vec<f64>>,
    /// Standard errors of A, read noise, offset, dark current.
    pub base_std_err: [f64; 4],
    /// What was free, where it came to lie, and its covariance.
    pub(super) free: Free,
    pub(super) point: Point,
    pub(super) covariance: Covariance,
    /// Slopes there or near.
    pub(super) slopes: Arc<Slopes>,
}

impl std::fmt::Debug for Fitted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let effects: Vec<_> = self.effects.iter().map(|(e, p)| (e.id(), p)).collect();
        write!(f, "{:?} {effects:?} objective {}", self.base, self.objective)
    }
}

impl Fitted {
    /// The prediction for all sets.
    pub fn predict(&self, all: &Observations) -> Prediction {
        let list: Vec<(&dyn Effect, &[f64])> = self.effects.iter().map(|(e, p)| (*e, p.as_slice())).collect();
        effects::predict(&all.campaign, &self.base, &list)
    }

    /// The same effects beside another guess of the paper's parameters.
    pub fn with_base(&self, base: BaseParameters) -> Self {
        Self { base, ..self.clone() }
    }

    /// Covariance of two parameters of an effect, in their own units.
    pub fn covariance_of(&self, effect: usize, a: usize, b: usize) -> f64 {
        let place = |k: usize| self.free.place(Common::Of(effect, k));
        let (Some(i), Some(j)) = (place(a), place(b)) else { return f64::NAN };
        let n = self.free.common.len();
        self.covariance.common[i * n + j] * self.free.scale[i] * self.free.scale[j]
    }

    /// Standard error of a combination of an effect's parameters.
    pub fn std_err_of(&self, effect: usize, of: &Together) -> f64 {
        let places: Vec<usize> = (0..of.slopes.len()).filter(|k| of.slopes[*k] != 0.0).collect();
        let covariance = |a: usize, b: usize| of.slopes[a] * of.slopes[b] * self.covariance_of(effect, a, b);
        let all = places.iter().flat_map(|a| places.iter().map(|b| covariance(*a, *b)));
        all.sum::<f64>().max(0.0).sqrt()
    }

    /// Parameters of the effects that were fitted: all but choices and those that the choices do not use.
    pub fn parameters(&self) -> usize {
        let of = |(c, fixed): (&Common, &bool)| matches!(c, Common::Of(..)) && !fixed;
        self.free.common.iter().zip(&self.free.fixed).filter(|p| of(*p)).count()
    }
}

/// Values with those that are given.
pub fn as_given(values: &[f64], given: &[Option<f64>]) -> Vec<f64> {
    values.iter().enumerate().map(|(i, v)| given.get(i).copied().flatten().unwrap_or(*v)).collect()
}

/// Fits the paper's parameters and those of some effects, from a start.
pub fn fit(all: &Observations, base: &BaseParameters, effects: &Effects) -> Fitted {
    fit_for(ROUNDS, all, None, base, effects, None)
}

/// The same beside another fit whose slopes serve at first.
pub(crate) fn fit_near(all: &Observations, near: &Fitted, effects: &Effects) -> Fitted {
    fit_for(ROUNDS, all, None, &near.base, effects, Some(&near.slopes))
}

/// A fit again, on the observables of one half and those of both. Where it is far off few rounds will do: the halves tell how far.
pub(super) fn fit_half(all: &Observations, half: Half, whole: &Fitted) -> Fitted {
    let rounds = if whole.mean_square > FAR_SQUARE { FIRST_ROUNDS } else { ROUNDS };
    fit_for(rounds, all, Some(half), &whole.base, &whole.effects, Some(&whole.slopes))
}

/// The same for a few rounds: enough to see which of several starts is the best.
pub(crate) fn fit_briefly(
    all: &Observations,
    base: &BaseParameters,
    effects: &Effects,
    known: Option<&Slopes>,
) -> Fitted {
    fit_for(FIRST_ROUNDS, all, None, base, effects, known)
}

/// Halves that a fit uses.
pub(super) fn halves(half: Option<Half>) -> Vec<Half> {
    match half {
        Some(half) => vec![half, Half::Both],
        None => vec![Half::First, Half::Second, Half::Both],
    }
}

fn fit_for(
    rounds: usize,
    all: &Observations,
    half: Option<Half>,
    base: &BaseParameters,
    effects: &Effects,
    known: Option<&Slopes>,
) -> Fitted {
    let layout = Layout::new(all, &halves(half));
    let (free, mut point) = Free::new(all, base, effects);
    free.clamp(&mut point);
    let mut now = layout.at(&free, &point);
    let mut damping = 1e-3;
    let mut slopes = Slopes::beside(known, &layout, &free, &point, &now);
    let mut fresh = known.is_none();
    let mut system = System::new(&layout, &free, &point, &now, &slopes);
    let (mut taken, mut missed) = (0, 0);
    for _ in 0..SERVED * rounds {
        let normal = system.normal();
        let before = system.objective(&now, &now, &point.lights);
        let mut found: Option<(Point, State, f64)> = None;
        let mut promised = f64::INFINITY;
        for _ in 0..if fresh { 10 } else { 2 } {
            let Some((step, lights)) = normal.step(damping) else {
                damping *= 10.0;
                continue;
            };
            let mut trial = point.clone();
            trial.x.iter_mut().zip(&step).for_each(|(x, s)| *x += s);
            trial.lights.iter_mut().zip(&lights).for_each(|(x, s)| *x += s);
            free.clamp(&mut trial);
            let there = layout.at(&free, &trial);
            let value = system.objective(&now, &there, &trial.lights);
            if value < before {
                damping = (damping * 0.2).max(1e-7);
                promised = system.promised(&trial.from(&point).x, &lights);
                found = Some((trial, there, before - value));
                break;
            }
            damping *= 6.0;
        }
        let mut gained = 0.0;
        let mut hold = false;
        if let Some((trial, there, by)) = found {
            // Slopes serve for as long as steps bring what they promise; once they do not, what the step did mends them.
            hold = by >= HOLDS * promised;
            missed = if hold { 0 } else { missed + 1 };
            system.follow(&mut slopes, &free, &trial.from(&point), &now, &there, &normal);
            (point, now, gained) = (trial, there, by);
        }
        system = System::new(&layout, &free, &point, &now, &slopes);
        let factors = system.scatter_factors();
        let settled = factors.iter().all(|(_, f)| (f - 1.0).abs() < 1e-3);
        if !settled {
            factors.iter().for_each(|(i, f)| point.x[*i] *= f);
            free.clamp(&mut point);
            now = layout.at(&free, &point);
        }
        let mean_square = (before / layout.rows.len() as f64).max(1.0);
        let arrived = settled && gained < ARRIVED * mean_square;
        if arrived && (fresh || known.is_some() && hold && gained < ARRIVED) {
            break;
        }
        fresh = arrived || missed > MENDED;
        if fresh {
            taken += 1;
            if taken == rounds {
                break;
            }
            missed = 0;
            // A first look takes again only what it adds.
            let keeps = known.filter(|_| rounds == FIRST_ROUNDS);
            slopes = Slopes::beside(keeps, &layout, &free, &point, &now);
        }
        if fresh || !settled {
            system = System::new(&layout, &free, &point, &now, &slopes);
        }
    }
    if !fresh && known.is_none() && rounds > FIRST_ROUNDS {
        slopes = Slopes::new(&layout, &free, &point, &now);
        system = System::new(&layout, &free, &point, &now, &slopes);
    }
    let objective = system.likelihood(&now, &point.lights);
    let mean_square = system.z.iter().map(|z| z * z).sum::<f64>() / layout.rows.len() as f64;
    let mut normal = system.normal();
    (0..free.common.len()).for_each(|i| normal.add_weight(i, free.own_weight(i, &point)));
    let covariance = normal.covariance();
    let n = free.common.len();
    let error = |i: usize| {
        if free.fixed[i] { 0.0 } else { covariance.common[i * n + i].max(0.0).sqrt() * free.scale[i] }
    };
    let of = |what: Common| free.place(what).map_or(0.0, error);
    let std_err = effects
        .iter()
        .enumerate()
        .map(|(i, (_, p))| (0..p.len()).map(|k| of(Common::Of(i, k))).collect())
        .collect();
    let (base, effects) = free.unpack(&point);
    // What is fitted beside the gain is charge in DN; in e it has the gain's error too.
    let in_e = |what: Common, value: f64| {
        let (Some(g), Some(i)) = (free.place(Common::Gain), free.place(what)) else { return 0.0 };
        let (with, scale) = (covariance.common[i * n + g] * free.scale[i], of(what));
        (scale * scale - 2.0 * value * with + (value * of(Common::Gain)).powi(2)).max(0.0).sqrt()
    };
    let base_std_err = [
        of(Common::Gain) * base.gain_dn_per_e,
        in_e(Common::Read, base.read_noise_e),
        of(Common::Offset),
        if free.place(Common::Dark).is_some_and(|i| free.fixed[i]) {
            0.0
        } else {
            in_e(Common::Dark, base.dark_e_per_s)
        },
    ];
    let slopes = Arc::new(slopes);
    Fitted { base, effects, objective, mean_square, std_err, base_std_err, free, point, covariance, slopes }
}

/// What the campaign shows before any fit.
pub fn seen(all: &Observations, base: &BaseParameters) -> Seen {
    let means = all.of(&mean::This).map(|o| o.measured.value);
    let share = all.of(&codes_used::This).map(|o| o.measured.value).reduce(f64::max);
    let peak_dn = means.fold(0.0, f64::max) - base.offset_dn;
    let frames = &all.campaign.frames;
    let duration_s = frames.last().map_or(0.0, |l| l.time_s - frames[0].time_s);
    Seen {
        peak_e: peak_dn / base.gain_dn_per_e,
        peak_dn,
        full_scale_dn: all.campaign.full_scale_dn,
        duration_s,
        frame_s: all.campaign.frame_s,
        rows: all.campaign.shape.0 as f64,
        means: !all.means_given,
        dark_noise_dn: base.read_noise_e * base.gain_dn_per_e,
        line_cycles_per_px: all.campaign.line_cycles_per_px,
        code_step_dn: share.filter(|s| *s > 0.0).map(f64::recip),
    }
}
