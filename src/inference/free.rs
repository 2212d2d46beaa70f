//! What is free in a fit, as one list of values over their scales, and the light factors beside it.

use super::model::Effects;
use super::start::reference_level;
use crate::dataset::Kind;
use crate::observables::{Observations, mean};
use radcam_sim::effects::Effect;
use radcam_sim::predict::BaseParameters;

/// No lamp is known better than this, relative.
const LIGHT_FLOOR: f64 = 5e-5;

/// Errors of positive parameters beyond so many times themselves are cut: from two and a half times itself on a value is nothing at all, and
/// one that is known to a fifth of itself has its error changed by less than a two-hundredth.
const FACTOR: f64 = 2.0;

/// A value that is common to all sets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Common {
    /// Logarithm of A over its start, what light, dark current and read noise are in DN held: all but variances stay where they are.
    Gain,
    /// Read noise, e.
    Read,
    /// Level of zero charge, DN.
    Offset,
    /// Dark current, e/s.
    Dark,
    /// Logarithm of all light.
    Light,
    /// Signal of the frames before the first, e.
    Past,
    /// The monitor's reading for one electron, logarithm.
    MonitorPer,
    /// Relative scatter of the monitor.
    MonitorRel,
    /// A parameter of an effect: which effect, which parameter.
    Of(usize, usize),
}

/// What a common value is, whatever the model that it stands in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Key {
    /// One of the paper's, or of the campaign.
    Base(Common),
    /// A parameter of an effect with these choices.
    Of(&'static str, usize, Vec<u64>),
}

/// A light level with a factor of its own.
#[derive(Debug, Clone, Copy)]
pub struct Light {
    /// The level.
    pub level: usize,
    /// Relative error of its nominal light, where that is known.
    pub known: Option<f64>,
}

/// Everything that is free.
#[derive(Clone)]
pub struct Free {
    /// Effects.
    pub effects: Vec<&'static dyn Effect>,
    /// Common values, in the order of [`Point::x`].
    pub common: Vec<Common>,
    /// The scale of each.
    pub scale: Vec<f64>,
    /// What the campaign says nothing of.
    pub fixed: Vec<bool>,
    /// Smallest and largest value of each, over its scale.
    pub bounds: Vec<(f64, f64)>,
    /// Light levels with a factor of their own.
    pub lights: Vec<Light>,
    /// For every level the place of its factor.
    pub light_of_level: Vec<Option<usize>>,
    template: BaseParameters,
    values: Vec<Vec<f64>>,
}

/// A place in the space of what is free.
#[derive(Debug, Clone)]
pub struct Point {
    /// Common values over their scales.
    pub x: Vec<f64>,
    /// Logarithms of the light factors.
    pub lights: Vec<f64>,
}

impl Point {
    /// The way from another place to this one.
    pub fn from(&self, other: &Self) -> Self {
        let between = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect();
        Self { x: between(&self.x, &other.x), lights: between(&self.lights, &other.lights) }
    }
}

impl Free {
    /// For a model, and the place where it stands.
    pub fn new(all: &Observations, base: &BaseParameters, effects: &Effects) -> (Self, Point) {
        let remembers = effects.iter().any(|(e, _)| e.remembers()) && !all.is_table;
        let mut template = base.clone();
        template.past_e = remembers.then(|| base.past_e.unwrap_or(0.0));
        let positive = (0.0, f64::INFINITY);
        let any = (f64::NEG_INFINITY, f64::INFINITY);
        let brightest = template.flux_e_per_s.iter().copied().fold(0.0, f64::max);
        let longest = all.campaign.sets.iter().filter(|s| s.light.is_some()).map(|s| s.exposure_s);
        let peak = (brightest * longest.fold(0.0, f64::max)).max(1.0);
        // Of a table the level without light was taken off.
        let table = all.is_table;
        let mut list = vec![
            (Common::Gain, 0.0, 1.0, false, (-14.0, 14.0)),
            (Common::Read, base.read_noise_e, 0.0, false, positive),
            (Common::Offset, base.offset_dn, 0.0, table, any),
            (Common::Dark, base.dark_e_per_s, 0.0, table, any),
            (Common::Light, 0.0, 1.0, false, any),
        ];
        if let Some(past) = template.past_e {
            list.push((Common::Past, past, peak, false, (0.0, 20.0 * peak)));
        }
        if let Some(m) = template.monitor {
            list.push((Common::MonitorPer, m.ln_per_e, 1.0, false, any));
            list.push((Common::MonitorRel, m.rel, m.rel, false, (1e-7, 1.0)));
        }
        for (i, (e, values)) in effects.iter().enumerate() {
            for (k, (p, v)) in e.parameters().iter().zip(values).enumerate() {
                let start = p.starts.iter().copied().find(|s| *s != 0.0).unwrap_or(v.abs().max(1e-3));
                let scale = v.abs().max(start.abs());
                let (mut min, mut max) = (p.min, p.max);
                if e.keeps_sign() && p.is_size() {
                    if *v < 0.0 { max = max.min(0.0) } else { min = min.max(0.0) }
                }
                let fixed = p.is_choice() || e.is_whole(k) || !e.uses(values, k);
                list.push((Common::Of(i, k), *v, scale, fixed, (min, max)));
            }
        }
        let (mut common, mut scale, mut fixed, mut bounds, mut x) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (what, value, size, still, (min, max)) in list {
            let size = if size > 0.0 { size } else { value.abs().max(1e-3) };
            common.push(what);
            scale.push(size);
            fixed.push(still);
            bounds.push((min / size, max / size));
            x.push(value / size);
        }
        let levels = template.flux_e_per_s.len();
        let mut used = vec![false; levels];
        let with_mean = all.of(&mean::This).filter_map(|o| all.campaign.sets[o.set?].light);
        with_mean.for_each(|l| used[l] = true);
        let reference = reference_level(all);
        let mut light_of_level = vec![None; levels];
        let mut lights = Vec::new();
        for level in (0..levels).filter(|l| used[*l] && *l != reference) {
            light_of_level[level] = Some(lights.len());
            let flat = all
                .campaign
                .sets
                .iter()
                .zip(&all.kinds)
                .any(|(s, kind)| s.light == Some(level) && *kind == Kind::Flat);
            let known = all.light_rel_std.filter(|_| flat);
            lights.push(Light { level, known: known.map(|r| r.max(LIGHT_FLOOR) * std::f64::consts::SQRT_2) });
        }
        // A factor counts from the nominal light where that is known, else from where the level stands.
        let nominal = |level: usize| {
            all.campaign.sets.iter().find(|s| s.light == Some(level)).map_or(1.0, |s| s.illumination)
        };
        let unit = template.flux_e_per_s.get(reference).copied().unwrap_or(1.0) / nominal(reference);
        let mut factors = vec![0.0; lights.len()];
        for (light, factor) in lights.iter().zip(&mut factors) {
            if light.known.is_some() {
                let expected = unit * nominal(light.level);
                let ratio = template.flux_e_per_s[light.level] / expected;
                *factor = if ratio > 0.0 { ratio.ln() } else { 0.0 };
                template.flux_e_per_s[light.level] = expected;
            }
        }
        let values = effects.iter().map(|(_, v)| v.clone()).collect();
        let effects = effects.iter().map(|(e, _)| *e).collect();
        let free = Self { effects, common, scale, fixed, bounds, lights, light_of_level, template, values };
        (free, Point { x, lights: factors })
    }

    /// The model at a place.
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

    /// Keeps every value within its bounds.
    pub fn clamp(&self, at: &mut Point) {
        for (x, (min, max)) in at.x.iter_mut().zip(&self.bounds) {
            *x = x.clamp(*min, *max);
        }
        at.lights.iter_mut().for_each(|l| *l = l.clamp(-30.0, 30.0));
    }

    /// What a value is.
    pub fn key(&self, i: usize) -> Key {
        let Common::Of(effect, parameter) = self.common[i] else { return Key::Base(self.common[i]) };
        let (e, values) = (self.effects[effect], &self.values[effect]);
        let choices = e.parameters().iter().zip(values).filter(|(p, _)| p.is_choice());
        Key::Of(e.id(), parameter, choices.map(|(_, v)| v.to_bits()).collect())
    }

    /// Weight of what is known of a common value by its size alone: an effect's parameter that cannot be below 0 is known to [`FACTOR`]
    /// times itself. Slopes at one place say nothing of what lies further off, and factors of which the campaign tells the product only
    /// would else seem to allow anything.
    pub fn own_weight(&self, i: usize, point: &Point) -> f64 {
        let Common::Of(effect, k) = self.common[i] else { return 0.0 };
        let p = self.effects[effect].parameters()[k];
        if p.min >= 0.0 && point.x[i] > 0.0 { (FACTOR * point.x[i]).powi(-2) } else { 0.0 }
    }

    /// Place of a common value.
    pub fn place(&self, what: Common) -> Option<usize> {
        self.common.iter().position(|c| *c == what)
    }
}
