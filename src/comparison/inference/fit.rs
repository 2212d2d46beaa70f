//! Fits a model's free parameters to observables: generalised least squares with errors that the model itself
//! predicts.
//!
//! Errors are held within a round (quasi-likelihood: McCullagh and Nelder 1989, ch. 9), so that no parameter
//! gains by widening the error of something else. The scatter of frames tells flicker; the scatter of sets
//! tells that of a lamp's settings.

use super::free::{Common, Free, Point};
use super::iteration::{Effort, FAR_SQUARE, Iteration};
use super::judge::Comparison;
use super::layout::Layout;
use super::model::Effects;
use super::normal::Covariance;
use super::slopes::Slopes;
use crate::observables::{Expected, Half, Observations, codes_used, covariance, lightened, mean};
use radcam_sim::effects::{self, Effect, Seen, Together};
use radcam_sim::predict::{BaseParameters, Prediction};
use std::collections::BTreeSet;
use std::sync::{Arc, OnceLock};

/// A model with values: the paper's parameters and effects.
#[derive(Clone)]
pub struct Fitted {
    /// Paper's parameters.
    pub base: BaseParameters,
    /// Effects with their parameters.
    pub effects: Effects,
    /// Minus twice the logarithm of the likelihood.
    pub objective: f64,
    /// Mean square of the standardised residuals of what was fitted.
    pub mean_square: f64,
    /// Standard errors of the effects' parameters.
    pub std_err: Vec<Vec<f64>>,
    /// Standard errors of A, read noise, offset, dark current, and of the spread of the read noise.
    pub base_std_err: [f64; 5],
    /// Free values, their fitted point, and its covariance.
    pub(super) free: Free,
    pub(super) point: Point,
    pub(super) covariance: Covariance,
    /// Slopes at that point or near it.
    pub(super) slopes: Arc<Slopes>,
    /// Comparison with the first observations, and the identity of those.
    pub(super) compared: Arc<OnceLock<(u64, Comparison)>>,
}

impl std::fmt::Debug for Fitted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let effects: Vec<_> = self.effects.iter().map(|(e, p)| (e.id(), p)).collect();
        write!(f, "{:?} {effects:?} objective {}", self.base, self.objective)
    }
}

impl Fitted {
    /// Counts the light levels that only the means determine.
    pub(crate) fn open_lights(&self) -> usize {
        self.free.lights.iter().filter(|light| light.known.is_none()).count()
    }

    /// Predicts all sets.
    pub fn predict(&self, all: &Observations) -> Prediction {
        let list: Vec<(&dyn Effect, &[f64])> = self.effects.iter().map(|(e, p)| (*e, p.as_slice())).collect();
        effects::predict(&all.campaign, &self.base, &list)
    }

    /// Returns the same effects with another guess of the paper's parameters. Free values and errors stay
    /// those of the fit and say nothing of the guess.
    pub fn with_base(&self, base: BaseParameters) -> Self {
        Self { base, compared: Arc::default(), ..self.clone() }
    }

    /// Returns the approximate memory use, bytes.
    pub(crate) fn bytes(&self) -> usize {
        self.slopes.bytes()
    }

    /// Returns the covariance of two parameters of an effect, in their own units.
    pub fn covariance_of(&self, effect: usize, a: usize, b: usize) -> f64 {
        let place = |k: usize| self.free.place(Common::Of(effect, k));
        let (Some(i), Some(j)) = (place(a), place(b)) else { return f64::NAN };
        let n = self.free.common.len();
        self.covariance.common[i * n + j] * self.free.scale[i] * self.free.scale[j]
    }

    /// Returns the standard error of a combination of an effect's parameters.
    pub fn std_err_of(&self, effect: usize, of: &Together) -> f64 {
        let places: Vec<usize> = (0..of.slopes.len()).filter(|k| of.slopes[*k] != 0.0).collect();
        let covariance = |a: usize, b: usize| of.slopes[a] * of.slopes[b] * self.covariance_of(effect, a, b);
        let all = places.iter().flat_map(|a| places.iter().map(|b| covariance(*a, *b)));
        all.sum::<f64>().max(0.0).sqrt()
    }

    /// Counts the fitted parameters of the effects: all but choices and those that the choices do not use.
    pub fn parameters(&self) -> usize {
        let of = |(c, fixed): (&Common, &bool)| matches!(c, Common::Of(..)) && !fixed;
        self.free.common.iter().zip(&self.free.fixed).filter(|p| of(*p)).count()
    }
}

/// Fits the paper's parameters and those of some effects, from a start.
pub fn fit(all: &Observations, base: &BaseParameters, effects: &Effects) -> Fitted {
    fit_for(Effort::Full, all, None, &[], base, effects, None)
}

/// Fits beside another fit, whose slopes serve at first. A model that is far off is fitted only as exactly as
/// a comparison with others needs.
pub(crate) fn fit_near(all: &Observations, near: &Fitted, effects: &Effects) -> Fitted {
    fit_for(Effort::Rival, all, None, &[], &near.base, effects, Some(&near.slopes))
}

/// Maximum ratio of the error of an effect's parameter in a half to that in the whole campaign, for the half
/// to tell it (a named choice: two equal halves have 1.4). Where every level has one set in each half and a
/// light of its own, say, only the two together tell a drift, and its error would move all means of a half
/// alike.
const MOST_ERROR_OF_HALF: f64 = 4.0;

/// Refits on the observables of one half and those of both halves, starting from the joint fit. Few rounds
/// suffice for a model that is far off: the halves tell how far. Parameters of effects that a half does not
/// tell keep their values.
pub(super) fn fit_half(all: &Observations, half: Half, whole: &Fitted) -> Fitted {
    let effort = if whole.mean_square > FAR_SQUARE { Effort::Short } else { Effort::Full };
    let fit = |held: &[Common]| {
        fit_for(effort, all, Some(half), held, &whole.base, &whole.effects, Some(&whole.slopes))
    };
    let first = fit(&[]);
    let is_untold = |effect: usize, k: usize| {
        let (own, of_whole) = (first.std_err[effect][k], whole.std_err[effect][k]);
        of_whole > 0.0 && own > MOST_ERROR_OF_HALF * of_whole
    };
    let parameters = first.std_err.iter().enumerate().flat_map(|(i, e)| (0..e.len()).map(move |k| (i, k)));
    let untold: Vec<Common> =
        parameters.filter(|(i, k)| is_untold(*i, *k)).map(|(i, k)| Common::Of(i, k)).collect();
    if untold.is_empty() { first } else { fit(&untold) }
}

/// Fits for a few rounds, enough to find the best of several starts.
pub(crate) fn fit_briefly(
    all: &Observations,
    base: &BaseParameters,
    effects: &Effects,
    known: Option<&Slopes>,
) -> Fitted {
    fit_for(Effort::Look, all, None, &[], base, effects, known)
}

/// Returns the halves that a fit uses.
pub(super) fn halves(half: Option<Half>) -> Vec<Half> {
    match half {
        Some(half) => vec![half, Half::Both],
        None => vec![Half::First, Half::Second, Half::Both],
    }
}

fn fit_for(
    effort: Effort,
    all: &Observations,
    half: Option<Half>,
    held: &[Common],
    base: &BaseParameters,
    effects: &Effects,
    known: Option<&Slopes>,
) -> Fitted {
    let layout = Layout::new(all, &halves(half), effects.iter().map(|(e, _)| e));
    let (mut free, start) = Free::new(all, base, effects);
    let start = if base.past_e.is_none() { from_past(&layout, &free, start) } else { start };
    // A value that a half does not tell stays that of the whole campaign.
    if let Some(dark) = free.place(Common::Dark).filter(|_| !all.tells_dark_current(half)) {
        free.fixed[dark] = true;
    }
    let places: Vec<usize> = held.iter().filter_map(|what| free.place(*what)).collect();
    places.into_iter().for_each(|place| free.fixed[place] = true);
    if half.is_some_and(|h| repeated_settings(&layout, &free, h) < LEAST_REPEATED) {
        let of_effects = effects.iter().enumerate().filter(|(_, (e, _))| e.sets_each());
        let scatters = of_effects.map(|(i, _)| Common::Of(i, 0)).chain([Common::SettingRel]);
        let places: Vec<usize> = scatters.filter_map(|s| free.place(s)).collect();
        places.into_iter().for_each(|place| free.fixed[place] = true);
    }
    let begins = |h| all.of(&mean::Mean).any(|o| o.half == h && o.frames.0 == 0);
    if let Some(past) = free.place(Common::Past).filter(|_| half.is_some_and(|h| !begins(h))) {
        free.fixed[past] = true;
    }
    let mut iteration = Iteration::new(&layout, &free, start, known);
    iteration.run(effort, known);
    let Iteration { point, now, slopes, system, .. } = iteration;
    let objective = system.likelihood(&now, &point.lights);
    let mean_square = system.z.iter().map(|z| z * z).sum::<f64>() / layout.rows.len() as f64;
    let mut normal = system.normal();
    (0..free.common.len()).for_each(|i| normal.add_weight(i, free.own_weight(i, &point)));
    for (first, along) in free.redundant(&point) {
        let along: Vec<f64> = along.iter().zip(&free.scale[first..]).map(|(v, scale)| v * scale).collect();
        normal.constrain_to_zero(first, &along);
    }
    let covariance = normal.covariance();
    let errors = Errors { free: &free, covariance: &covariance };
    let (base, effects) = free.unpack(&point);
    let of_effect = |i: usize, p: &Vec<f64>| (0..p.len()).map(|k| errors.of(Common::Of(i, k))).collect();
    let std_err = effects.iter().enumerate().map(|(i, (_, p))| of_effect(i, p)).collect();
    let base_std_err = errors.of_base(&base);
    let slopes = Arc::new(slopes);
    Fitted {
        base,
        effects,
        objective,
        mean_square,
        std_err,
        base_std_err,
        free,
        point,
        covariance,
        slopes,
        compared: Arc::default(),
    }
}

/// Charges before the first frame from which a fit may start, relative to that of the brightest flat (a named
/// choice).
const PAST: [f64; 4] = [0.0, 0.1, 0.3, 1.0];

/// Returns the start with the charge before the first frame that fits best. A camera that keeps whole codes
/// shows nothing of a small charge, and the slope at no charge leads nowhere.
fn from_past(layout: &Layout<'_>, free: &Free, start: Point) -> Point {
    let Some(place) = free.place(Common::Past) else { return start };
    let at = |part: &f64| {
        let mut point = start.clone();
        point.x[place] = *part;
        free.clamp(&mut point);
        let square = |e: &Expected| lightened(e.z()).powi(2);
        let misfit: f64 = layout.at(free, &point).expected.iter().map(square).sum();
        (misfit, point)
    };
    PAST.iter().map(at).min_by(|a, b| a.0.total_cmp(&b.0)).map_or(start.clone(), |best| best.1)
}

/// Minimum number of settings in a half, beyond the open light levels, to tell their scatter (a named
/// choice).
const LEAST_REPEATED: usize = 3;

/// Counts the settings in a half beyond the open light levels; these tell the scatter of settings.
fn repeated_settings(layout: &Layout<'_>, free: &Free, half: Half) -> usize {
    let sets = &layout.all.campaign.sets;
    let means = layout.rows.iter().filter(|o| o.is(&mean::Mean) && o.half == half);
    let lit: Vec<(usize, usize)> = means.filter_map(|o| Some((o.set?, sets[o.set?].light?))).collect();
    let settings: BTreeSet<usize> = lit.iter().map(|(set, _)| layout.setting_of(*set)).collect();
    let levels: BTreeSet<usize> = lit.iter().map(|(_, level)| *level).collect();
    let is_known = |level: &&usize| {
        let place = free.light_of_level.get(**level).copied().flatten();
        place.is_some_and(|k| free.lights[k].known.is_some())
    };
    settings.len() - levels.len().min(settings.len()) + levels.iter().filter(is_known).count()
}

/// Standard errors of the free values, in their own units.
struct Errors<'a> {
    free: &'a Free,
    covariance: &'a Covariance,
}

impl Errors<'_> {
    /// Returns the covariance of two common values over their scales.
    fn covariance(&self, i: usize, j: usize) -> f64 {
        self.covariance.common[i * self.free.common.len() + j]
    }

    /// Returns the standard error of a common value; 0 if it is not free.
    fn of(&self, what: Common) -> f64 {
        let place = self.free.place(what).filter(|i| !self.free.fixed[*i]);
        place.map_or(0.0, |i| self.covariance(i, i).max(0.0).sqrt() * self.free.scale[i])
    }

    /// Returns the standard error of a charge in e. The fit holds charges in DN; in e they have the gain's
    /// error too.
    fn in_e(&self, what: Common, value_e: f64) -> f64 {
        let (Some(gain), Some(i)) = (self.free.place(Common::Gain), self.free.place(what)) else {
            return 0.0;
        };
        let (with, own) = (self.covariance(i, gain) * self.free.scale[i], self.of(what));
        (own * own - 2.0 * value_e * with + (value_e * self.of(Common::Gain)).powi(2)).max(0.0).sqrt()
    }

    /// Returns the standard errors of A, read noise, offset, dark current and the spread of the read noise.
    fn of_base(&self, base: &BaseParameters) -> [f64; 5] {
        let no_dark = self.free.place(Common::Dark).is_some_and(|i| self.free.fixed[i]);
        [
            self.of(Common::Gain) * base.gain_dn_per_e,
            self.in_e(Common::Read, base.read_noise_e),
            self.of(Common::Offset),
            if no_dark { 0.0 } else { self.in_e(Common::Dark, base.dark_e_per_s) },
            self.of(Common::ReadSpread),
        ]
    }
}

/// Counts the measured levels of light times exposure.
fn lit_levels(all: &Observations) -> usize {
    let lit = all.campaign.sets.iter().filter(|s| s.light.is_some() && s.exposure_s > 0.0);
    let mut levels: Vec<f64> = lit.map(|s| s.illumination * s.exposure_s).collect();
    levels.sort_by(f64::total_cmp);
    // Equal to within rounding of the stated values.
    levels.dedup_by(|a, b| (*a - *b).abs() < 1e-6 * b.abs());
    levels.len()
}

/// Summarises the campaign before any fit.
pub fn seen(all: &Observations, base: &BaseParameters) -> Seen {
    let means = all.of(&mean::Mean).map(|o| o.measured.value);
    let share = all.of(&codes_used::CodesUsed).map(|o| o.measured.value).reduce(f64::max);
    let peak_dn = means.fold(0.0, f64::max) - base.offset_dn;
    let frames = &all.campaign.frames;
    let lit = all.campaign.sets.iter().filter(|s| s.light.is_some());
    let duration_s = frames.last().map_or(0.0, |l| l.time_s - frames[0].time_s);
    let flat_sets = all.kinds.iter().filter(|kind| **kind == crate::dataset::Kind::Flat).count();
    Seen {
        peak_e: peak_dn / base.gain_dn_per_e,
        peak_dn,
        highest_dn: all.codes.iter().map(|c| f64::from(c.range.end)).fold(0.0, f64::max) - base.offset_dn,
        full_scale_dn: all.campaign.full_scale_dn,
        duration_s,
        frame_s: all.campaign.frame_s,
        lit_s: lit
            .fold((f64::INFINITY, 0.0), |(a, b), s| (f64::min(a, s.exposure_s), f64::max(b, s.exposure_s))),
        rows: all.campaign.shape.0 as f64,
        columns: all.campaign.shape.1 as f64,
        means: !all.means_given && lit_levels(all) >= Seen::MIN_CURVE_LEVELS,
        lit_levels: if all.means_given { flat_sets } else { lit_levels(all) },
        flat_sets,
        neighbours: all.has(&covariance::Covariance),
        dark_noise_dn: base.read_noise_e * base.gain_dn_per_e,
        dark_e_per_s: if all.tells_dark_current(None) { base.dark_e_per_s } else { 0.0 },
        successive: all.successive,
        line_cycles_per_px: all.campaign.line_cycles_per_px,
        column_cycles: all.column_cycles.first().copied(),
        row_cycles: std::array::from_fn(|k| all.row_cycles.get(k).copied()),
        ripple_hz: std::array::from_fn(|k| all.ripples.likely_hz.get(k).copied()),
        ripples: all.ripples.fitting,
        flicker_hz: std::array::from_fn(|k| all.flickers.likely_hz.get(k).copied()),
        flickers: all.flickers.fitting,
        exposure_steps: super::exposure_steps::likely(all, base),
        steady_dn4: all.steady_dn4.map(|v| (v.value, v.std_err)),
        darkest_dn: all.darkest_dn.map(|code| code - base.offset_dn),
        darkest_code: all.darkest_dn,
        together_dn4: all.together_dn4.and_then(|of| {
            let of = of.map(|v| (v.value, v.std_err)).into_iter().filter(|v| v.1 > 0.0);
            of.max_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)))
        }),
        code_step_dn: share.filter(|s| *s > 0.0).map(f64::recip),
        stretch_dn: all.code_step_dn(),
        stretch_zero_dn: all.stretch.map_or(0.0, |line| line.zero),
    }
}
