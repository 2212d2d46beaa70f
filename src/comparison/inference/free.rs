//! Free values of a fit: one list of common values over their scales, and the light factors.

use super::model::Effects;
use super::start::{MOST_SPREAD, has_flats, of_darks, reference_level, zero_bounds};
use crate::dataset::Kind;
use crate::observables::{Half, Observations, Setting, mean, unequal};
use radcam_sim::effects::{Effect, Parameter};
use radcam_sim::predict::BaseParameters;

/// Minimum relative error of a lamp's light.
const LIGHT_FLOOR: f64 = 5e-5;

/// Maximum error of a positive parameter, in multiples of its value. A value with an error of two and a half
/// times itself counts for nothing, and the error of a value known to a fifth of itself changes by less than
/// 1/200.
const FACTOR: f64 = 2.0;

/// Minimum read noise, DN (a named choice: negligible beside the 0.29 DN of rounding). A variance does not
/// change with its root at 0, and a fit that came there would never leave.
const LEAST_READ_DN: f64 = 0.01;

/// A value that is common to all sets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Common {
    /// Logarithm of A over its start. Light, dark current and read noise are held in DN, so that only
    /// variances change.
    Gain,
    /// Read noise, e.
    Read,
    /// Spread of the pixels' read-noise variances, relative.
    ReadSpread,
    /// Relative scatter of the light's setting, within its stated limit.
    SettingRel,
    /// Black level at zero exposure, DN.
    Offset,
    /// Dark current, e/s.
    Dark,
    /// Logarithm of all light.
    Light,
    /// Signal of the frames before the first, e.
    Past,
    /// Logarithm of the monitor's reading for one electron.
    MonitorPer,
    /// Relative scatter of the monitor.
    MonitorRel,
    /// A parameter of an effect: index of the effect, index of the parameter.
    Of(usize, usize),
}

/// Identity of a common value, whatever the model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Key {
    /// A value of the paper, or of the campaign.
    Base(Common),
    /// A parameter of an effect with these choices.
    Of(&'static str, usize, Vec<u64>),
}

/// A light level with a factor of its own.
#[derive(Debug, Clone, Copy)]
pub struct Light {
    /// The level.
    pub level: usize,
    /// Relative error of its nominal light, if known.
    pub known: Option<f64>,
}

/// Free values of a model.
#[derive(Clone)]
pub struct Free {
    /// Effects.
    pub effects: Vec<&'static dyn Effect>,
    /// Common values, in the order of [`Point::x`].
    pub common: Vec<Common>,
    /// Scale of each.
    pub scale: Vec<f64>,
    /// True for values that are held in the fit.
    pub fixed: Vec<bool>,
    /// Minimum and maximum of each, over its scale.
    pub bounds: Vec<(f64, f64)>,
    /// Light levels with a factor of their own.
    pub lights: Vec<Light>,
    /// Index of the factor of every level.
    pub light_of_level: Vec<Option<usize>>,
    template: BaseParameters,
    values: Vec<Vec<f64>>,
    full_scale_dn: f64,
}

/// A point in the space of the free values.
#[derive(Debug, Clone)]
pub struct Point {
    /// Common values over their scales.
    pub x: Vec<f64>,
    /// Logarithms of the light factors.
    pub lights: Vec<f64>,
}

impl Point {
    /// Returns the step from another point to this one.
    pub fn from(&self, other: &Self) -> Self {
        let between = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect();
        Self { x: between(&self.x, &other.x), lights: between(&self.lights, &other.lights) }
    }
}

/// A common value before it is divided by its scale.
struct Entry {
    what: Common,
    value: f64,
    /// Scale; 0: the size of the value itself.
    scale: f64,
    fixed: bool,
    bounds: (f64, f64),
}

const ANY: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);

/// Start of the scatter of settings in a fit, as a part of its maximum (a named choice).
pub(super) const FIRST_SETTING: f64 = 0.01;

/// Lists the paper's parameters, the charge before the first frame, and the light monitor. `in_effect`: the
/// scatter of settings belongs to an effect.
fn of_base(all: &Observations, base: &BaseParameters, in_effect: bool) -> Vec<Entry> {
    let entry = |what, value, scale, fixed, bounds| Entry { what, value, scale, fixed, bounds };
    // The level without light is already subtracted in a table.
    let table = all.is_table;
    let no_gain = !has_flats(all) && of_darks(all, base.offset_dn).is_none();
    // The level of darks at two exposures may fall for other reasons, which is reported. With a single dark
    // only the flats tell the charge, which is no reason for one below 0.
    let dark = if all.darks_tell_dark_current() { ANY } else { (0.0, f64::INFINITY) };
    let mut list = vec![
        entry(Common::Gain, 0.0, 1.0, no_gain, (-14.0, 14.0)),
        entry(
            Common::Read,
            base.read_noise_e,
            0.0,
            false,
            (LEAST_READ_DN / base.gain_dn_per_e, f64::INFINITY),
        ),
        entry(
            Common::ReadSpread,
            base.read_noise_spread,
            base.read_noise_spread.max(0.05),
            !all.has(&unequal::Unequal),
            (0.0, MOST_SPREAD),
        ),
        entry(Common::Offset, base.offset_dn, 0.0, table, if table { ANY } else { zero_bounds(all) }),
        entry(Common::Dark, base.dark_e_per_s, 0.0, table || !all.tells_dark_current(None), dark),
        entry(Common::Light, 0.0, 1.0, false, ANY),
    ];
    if let Some(rel) = base.setting_rel {
        // An effect for the scatter of settings replaces a scatter that is not stated.
        let (fixed, rel, most) = match all.setting {
            Some(Setting::Below(most)) if in_effect => (true, 0.0, most),
            Some(Setting::Below(most)) => (false, rel.max(FIRST_SETTING * most), most),
            _ => (true, rel, rel),
        };
        list.push(entry(Common::SettingRel, rel, most, fixed, (0.0, most)));
    }
    if let Some(past) = base.past_e {
        let brightest = base.flux_e_per_s.iter().copied().fold(0.0, f64::max);
        let longest = all.campaign.sets.iter().filter(|s| s.light.is_some()).map(|s| s.exposure_s);
        let peak = (brightest * longest.fold(0.0, f64::max)).max(1.0);
        list.push(entry(Common::Past, past, peak, false, (0.0, 20.0 * peak)));
    }
    if let Some(m) = base.monitor {
        list.push(entry(Common::MonitorPer, m.ln_per_e, 1.0, false, ANY));
        list.push(entry(Common::MonitorRel, m.rel, m.rel, false, (1e-7, 1.0)));
    }
    list
}

/// Lists the parameters of an effect, which has this place among all.
fn of_effect(place: usize, effect: &dyn Effect, values: &[f64]) -> Vec<Entry> {
    let entry = |(k, (p, v)): (usize, (&Parameter, &f64))| {
        let start = p.starts.iter().copied().find(|s| *s != 0.0).unwrap_or(v.abs().max(1e-3));
        let bounds = match (effect.keeps_sign() && p.is_size(), *v < 0.0) {
            (false, _) => (p.min, p.max),
            (true, true) => (p.min, p.max.min(0.0)),
            (true, false) => (p.min.max(0.0), p.max),
        };
        Entry {
            what: Common::Of(place, k),
            value: *v,
            scale: v.abs().max(start.abs()),
            fixed: p.is_choice() || effect.is_whole(k) || !effect.uses(values, k),
            bounds,
        }
    };
    effect.parameters().iter().zip(values).enumerate().map(entry).collect()
}

/// Lists the light levels that have a mean, except the reference level.
fn lights_of(all: &Observations, levels: usize, reference: usize) -> Vec<Light> {
    let mut used = vec![false; levels];
    let with_mean = all.of(&mean::Mean).filter_map(|o| all.campaign.sets[o.set?].light);
    with_mean.for_each(|l| used[l] = true);
    // The level of a set that is clipped says nothing of its light, whatever is stated of it.
    let mut measured = vec![false; levels];
    let unclipped = all.of(&mean::Mean).filter(|o| o.half != Half::Both || all.means_given);
    unclipped.filter_map(|o| all.campaign.sets[o.set?].light).for_each(|l| measured[l] = true);
    let light = |level: usize| {
        let mut sets = all.campaign.sets.iter().zip(&all.kinds);
        let flat = sets.any(|(s, kind)| s.light == Some(level) && *kind == Kind::Flat);
        let known = all.light_rel_std.filter(|_| flat && measured[level]);
        Light { level, known: known.map(|r| r.max(LIGHT_FLOOR) * std::f64::consts::SQRT_2) }
    };
    (0..levels).filter(|l| used[*l] && *l != reference).map(light).collect()
}

/// Returns the log light factors. A level with known nominal light moves to it, and its factor is relative to
/// it; any other factor is relative to the level itself.
fn factors_of(all: &Observations, lights: &[Light], reference: usize, flux_e_per_s: &mut [f64]) -> Vec<f64> {
    let nominal = |level: usize| {
        all.campaign.sets.iter().find(|s| s.light == Some(level)).map_or(1.0, |s| s.illumination)
    };
    let unit = flux_e_per_s.get(reference).copied().unwrap_or(1.0) / nominal(reference);
    let factor = |light: &Light| {
        if light.known.is_none() {
            return 0.0;
        }
        let expected = unit * nominal(light.level);
        let ratio = flux_e_per_s[light.level] / expected;
        flux_e_per_s[light.level] = expected;
        if ratio > 0.0 { ratio.ln() } else { 0.0 }
    };
    lights.iter().map(factor).collect()
}

impl Free {
    /// Returns the free values of a model, and its point.
    pub fn new(all: &Observations, base: &BaseParameters, effects: &Effects) -> (Self, Point) {
        let has_memory = effects.iter().any(|(e, _)| e.has_memory()) && !all.is_table;
        let mut template = base.clone();
        template.past_e = has_memory.then(|| base.past_e.unwrap_or(0.0));
        let in_effect = effects.iter().any(|(e, _)| e.sets_each());
        let mut entries = of_base(all, &template, in_effect);
        for (place, (effect, values)) in effects.iter().enumerate() {
            entries.extend(of_effect(place, *effect, values));
        }
        for e in entries.iter_mut().filter(|e| e.scale <= 0.0) {
            e.scale = e.value.abs().max(1e-3);
        }
        let reference = reference_level(all);
        let levels = template.flux_e_per_s.len();
        let lights = lights_of(all, levels, reference);
        let factors = factors_of(all, &lights, reference, &mut template.flux_e_per_s);
        let mut light_of_level = vec![None; levels];
        lights.iter().enumerate().for_each(|(k, l)| light_of_level[l.level] = Some(k));
        let point = Point { x: entries.iter().map(|e| e.value / e.scale).collect(), lights: factors };
        let free = Self {
            effects: effects.iter().map(|(e, _)| *e).collect(),
            common: entries.iter().map(|e| e.what).collect(),
            scale: entries.iter().map(|e| e.scale).collect(),
            fixed: entries.iter().map(|e| e.fixed).collect(),
            bounds: entries.iter().map(|e| (e.bounds.0 / e.scale, e.bounds.1 / e.scale)).collect(),
            lights,
            light_of_level,
            template,
            values: effects.iter().map(|(_, v)| v.clone()).collect(),
            full_scale_dn: all.campaign.full_scale_dn,
        };
        (free, point)
    }

    /// Returns the model at a point.
    pub fn unpack(&self, at: &Point) -> (BaseParameters, Effects) {
        let mut base = self.template.clone();
        let mut values = self.values.clone();
        let mut in_e = 1.0;
        for ((what, x), scale) in self.common.iter().zip(&at.x).zip(&self.scale) {
            let v = x * scale;
            match *what {
                Common::Gain => {
                    base.gain_dn_per_e *= v.exp();
                    in_e = (-v).exp();
                }
                Common::Read => base.read_noise_e = v,
                Common::ReadSpread => base.read_noise_spread = v,
                Common::SettingRel => base.setting_rel = Some(v),
                Common::Offset => base.offset_dn = v,
                Common::Dark => base.dark_e_per_s = v,
                Common::Light => base.flux_e_per_s.iter_mut().for_each(|f| *f *= v.exp()),
                Common::Past => base.past_e = Some(v),
                Common::MonitorPer => {
                    if let Some(m) = &mut base.monitor {
                        m.ln_per_e = v;
                    }
                }
                Common::MonitorRel => {
                    if let Some(m) = &mut base.monitor {
                        m.rel = v;
                    }
                }
                Common::Of(i, k) => values[i][k] = v,
            }
        }
        base.read_noise_e *= in_e;
        base.dark_e_per_s *= in_e;
        base.flux_e_per_s.iter_mut().for_each(|f| *f *= in_e);
        for (light, factor) in self.lights.iter().zip(&at.lights) {
            base.flux_e_per_s[light.level] *= factor.exp();
        }
        (base, self.effects.iter().copied().zip(values).collect())
    }

    /// Returns the redundant directions of the effects: index of the effect's first parameter, and the
    /// direction in the parameters' units.
    pub fn redundant(&self, at: &Point) -> Vec<(usize, Vec<f64>)> {
        let of = |(place, effect): (usize, &&'static dyn Effect)| {
            let first = self.place(Common::Of(place, 0))?;
            let these = first..first + effect.parameters().len();
            let values: Vec<f64> = these.map(|i| at.x[i] * self.scale[i]).collect();
            Some((first, effect.redundant(&values, self.full_scale_dn)?))
        };
        self.effects.iter().enumerate().filter_map(of).collect()
    }

    /// Keeps every value within its bounds, and orthogonal to redundant directions.
    pub fn clamp(&self, at: &mut Point) {
        for (first, along) in self.redundant(at) {
            let values = along.iter().enumerate().map(|(k, v)| v * at.x[first + k] * self.scale[first + k]);
            let part = values.sum::<f64>() / along.iter().map(|v| v * v).sum::<f64>();
            for (k, v) in along.iter().enumerate() {
                at.x[first + k] -= part * v / self.scale[first + k];
            }
        }
        for (x, (min, max)) in at.x.iter_mut().zip(&self.bounds) {
            *x = x.clamp(*min, *max);
        }
        at.lights.iter_mut().for_each(|l| *l = l.clamp(-30.0, 30.0));
    }

    /// Returns the factor on the scatter of all settings from one point to another; `None` if anything else
    /// differs.
    pub fn scales_settings(&self, from: &Point, to: &Point) -> Option<f64> {
        let is_scatter = |what: Common| match what {
            Common::SettingRel => true,
            Common::Of(effect, _) => self.effects[effect].sets_each(),
            _ => false,
        };
        let all = || self.common.iter().zip(from.x.iter().zip(&to.x));
        let factor =
            all().find(|(what, (was, _))| is_scatter(**what) && **was > 0.0).map(|(_, (a, b))| b / a)?;
        let agrees = |(what, (a, b)): (&Common, (&f64, &f64))| {
            if is_scatter(*what) { (b - factor * a).abs() <= 1e-12 * b.abs() } else { a == b }
        };
        (all().all(agrees) && from.lights == to.lights).then_some(factor)
    }

    /// Returns the identity of a value.
    pub fn key(&self, i: usize) -> Key {
        let Common::Of(effect, parameter) = self.common[i] else { return Key::Base(self.common[i]) };
        let (e, values) = (self.effects[effect], &self.values[effect]);
        let choices = e.parameters().iter().zip(values).filter(|(p, _)| p.is_choice());
        Key::Of(e.id(), parameter, choices.map(|(_, v)| v.to_bits()).collect())
    }

    /// Returns the prior weight of a common value: an effect's parameter that cannot be below 0 is known to
    /// [`FACTOR`] times itself. Slopes at one point say nothing of values further off, and without the prior,
    /// factors whose product alone is determined would seem unbounded.
    pub fn own_weight(&self, i: usize, point: &Point) -> f64 {
        let Common::Of(effect, k) = self.common[i] else { return 0.0 };
        let p = self.effects[effect].parameters()[k];
        if p.min >= 0.0 && point.x[i] > 0.0 { (FACTOR * point.x[i]).powi(-2) } else { 0.0 }
    }

    /// Returns the index of a common value.
    pub fn place(&self, what: Common) -> Option<usize> {
        self.common.iter().position(|c| *c == what)
    }
}
