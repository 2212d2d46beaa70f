//! Cost of an unmodelled effect: errors of the gain, the dark noise and the linearity that EMVA 1288 finds in
//! the same frames.
//!
//! The expected means and variances of all sets are put through the estimates of `radcam emva` (EMVA 1288
//! release 4.0 Linear), once with the effect and once without: a line of the variance over the signal up to
//! 70 % of saturation (eq. 50), the noise of the darks over its slope (eq. 24), and the mean deviation of the
//! signal from a line over the light (eq. 59 to 63).

use crate::dataset::Kind;
use crate::emva::lines::{FIT_RANGE, LINEAR_RANGE, MIN_RANGE};
use crate::inference::{Effects, Fitted};
use crate::number::finite;
use crate::observables::{Observations, mean, nominal_expectations, variance};
use crate::statistics::quantisation::QUANTISATION_DN2;
use radcam_sim::effects::{self, Effect};
use serde::{Deserialize, Serialize};

use super::sensor::NOT_DETERMINED;

/// Relative errors of three results if an effect is ignored; 0 if this campaign does not tell.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Cost {
    /// Error of the system gain K.
    #[serde(with = "finite")]
    pub gain_rel: f64,
    /// Error of the dark noise, e.
    #[serde(with = "finite")]
    pub read_noise_rel: f64,
    /// Linearity error LE beyond that without the effect.
    #[serde(with = "finite")]
    pub linearity_rel: f64,
}

impl Cost {
    /// Returns the largest of the three.
    pub fn largest(&self) -> f64 {
        let of = |rel: f64| if rel.is_finite() { rel.abs() } else { 0.0 };
        of(self.gain_rel).max(of(self.read_noise_rel)).max(of(self.linearity_rel))
    }
}

/// Estimates that ignore effects, from means and variances.
#[derive(Debug, Clone, Copy)]
struct Plain {
    gain_dn_per_e: f64,
    dark_noise_e: f64,
    linearity: f64,
}

/// Fits the weighted line y = a + b x; returns (a, b).
fn line(points: impl Iterator<Item = (f64, f64, f64)> + Clone) -> Option<(f64, f64)> {
    let sum = |of: &dyn Fn(f64, f64) -> f64| points.clone().map(|(x, y, w)| w * of(x, y)).sum::<f64>();
    let (n, sx, sy) = (sum(&|_, _| 1.0), sum(&|x, _| x), sum(&|_, y| y));
    let (xx, xy) = (sum(&|x, _| x * x), sum(&|x, y| x * y));
    let determinant = n * xx - sx * sx;
    (determinant > 1e-12 * n * xx)
        .then(|| ((xx * sy - sx * xy) / determinant, (n * xy - sx * sy) / determinant))
}

impl Plain {
    /// Computes the estimates from a value for every observable.
    fn of(all: &Observations, values: impl Fn(usize) -> f64) -> Option<Self> {
        let sets = all.campaign.sets.len();
        let (mut means, mut variances) = (vec![(0.0, 0.0); sets], vec![(0.0, 0.0); sets]);
        for (i, o) in all.list.iter().enumerate() {
            let into = match () {
                () if o.is(&mean::Mean) => &mut means,
                () if o.is(&variance::Variance) => &mut variances,
                () => continue,
            };
            if let Some(set) = o.set {
                into[set] = (into[set].0 + values(i), into[set].1 + 1.0);
            }
        }
        let of = |(sum, n): (f64, f64)| sum / n;
        let level = |set: usize| of(means[set]);
        let darks: Vec<usize> =
            (0..sets).filter(|s| all.kinds[*s] == Kind::Dark && means[*s].1 > 0.0).collect();
        let exposure = |set: usize| all.campaign.sets[set].exposure_s;
        // Mean or variance of the darks at an exposure: a line, or a constant. Rounding may hide the
        // variance.
        let of_darks = |darks: &[usize], of_set: &dyn Fn(usize) -> f64| {
            let alone = darks.iter().map(|s| of_set(*s)).sum::<f64>() / darks.len().max(1) as f64;
            line(darks.iter().map(|&s| (exposure(s), of_set(s), 1.0))).unwrap_or((alone, 0.0))
        };
        let variance = |set: usize| of(variances[set]);
        let noisy: Vec<usize> = darks.iter().copied().filter(|s| variances[*s].1 > 0.0).collect();
        let (dark, dark_var) = match all.is_table {
            true => ((0.0, 0.0), (0.0, 0.0)),
            false => (of_darks(&darks, &level), of_darks(&noisy, &variance)),
        };
        let at = |line: (f64, f64), set: usize| line.0 + line.1 * exposure(set);
        let signal = |set: usize| level(set) - at(dark, set);
        let (flats, clipped): (Vec<usize>, Vec<usize>) = (0..sets)
            .filter(|s| all.kinds[*s] == Kind::Flat)
            .partition(|s| variances[*s].1 > 0.0 && variance(*s) > 0.0);
        // Saturation: full scale where a level is clipped, else the brightest level.
        let brightest = flats.iter().map(|s| signal(*s)).fold(0.0, f64::max);
        let saturation = if clipped.is_empty() { brightest } else { all.campaign.full_scale_dn - dark.0 };
        let noise = |top: f64| {
            let points = flats
                .iter()
                .filter(|s| signal(**s) <= top * saturation)
                .map(|&s| (signal(s), variance(s) - at(dark_var, s), 1.0));
            let (low, high) = points
                .clone()
                .fold((f64::INFINITY, 0.0f64), |(low, high), (x, ..)| (low.min(x), high.max(x)));
            if high >= MIN_RANGE * low {
                return line(points);
            }
            // One level: the slope from the darks to it, as with two flats and two darks (eq. 50 at one
            // point).
            let (xy, xx) = points.fold((0.0, 0.0), |(xy, xx), (x, y, _)| (xy + x * y, xx + x * x));
            (xx > 0.0 && !noisy.is_empty()).then(|| (0.0, xy / xx))
        };
        let (constant, gain_dn_per_e) =
            noise(FIT_RANGE).filter(|(_, gain)| *gain > 0.0).or_else(|| noise(f64::INFINITY))?;
        let shortest = noisy.iter().copied().min_by(|a, b| exposure(*a).total_cmp(&exposure(*b)));
        let dark_noise_dn2 = shortest.map_or(constant, variance);
        let quantisation_dn2 = QUANTISATION_DN2 * all.code_step_dn().powi(2);
        let dark_noise_e = (dark_noise_dn2 - quantisation_dn2).max(0.0).sqrt() / gain_dn_per_e;
        let (low, high) = (LINEAR_RANGE.0 * saturation, LINEAR_RANGE.1 * saturation);
        let lit: Vec<(f64, f64)> = flats
            .iter()
            .map(|&s| (all.campaign.sets[s].illumination * exposure(s), signal(s)))
            .filter(|(_, signal)| (low..=high).contains(signal))
            .collect();
        let of_light = if lit.len() < 3 || all.means_given {
            None
        } else {
            line(lit.iter().map(|&(x, y)| (x, y, 1.0 / (y * y))))
        };
        let linearity = of_light.map_or(0.0, |(a, b)| {
            lit.iter().map(|(x, y)| (y / (a + b * x) - 1.0).abs()).sum::<f64>() / lit.len() as f64
        });
        Some(Self { gain_dn_per_e, dark_noise_e, linearity })
    }

    /// Computes the estimates from a model with these effects.
    fn of_model(all: &Observations, fitted: &Fitted, effects: &Effects) -> Option<Self> {
        let list: Vec<(&dyn Effect, &[f64])> =
            effects.iter().map(|(e, p)| (*e as &dyn Effect, p.as_slice())).collect();
        let prediction = effects::predict(&all.campaign, &fitted.base, &list);
        let expected = nominal_expectations(all, &prediction);
        Self::of(all, |i| expected[i].value)
    }

    /// Returns the errors of this estimate relative to the right one.
    fn against(&self, right: &Self) -> Cost {
        let rel = |a: f64, b: f64| if b > 0.0 && a.is_finite() { a / b - 1.0 } else { 0.0 };
        Cost {
            gain_rel: rel(self.gain_dn_per_e, right.gain_dn_per_e),
            read_noise_rel: rel(self.dark_noise_e, right.dark_noise_e),
            linearity_rel: (self.linearity - right.linearity).max(0.0),
        }
    }
}

/// Computes the cost of ignoring an effect of a model.
pub(super) fn of_effect(all: &Observations, whole: &Fitted, id: &str) -> Cost {
    without(all, whole, whole.effects.iter().filter(|(e, _)| e.id() != id).cloned().collect())
}

/// Computes the cost of ignoring the last effects of a model; the first `kept` stay.
pub(super) fn of_last(all: &Observations, whole: &Fitted, kept: usize) -> Cost {
    without(all, whole, whole.effects.iter().take(kept).cloned().collect())
}

/// Computes the cost of ignoring all effects of a model but `rest`.
fn without(all: &Observations, whole: &Fitted, rest: Effects) -> Cost {
    let both = Plain::of_model(all, whole, &whole.effects).zip(Plain::of_model(all, whole, &rest));
    let cost = both.map_or_else(Cost::default, |(with, without)| with.against(&without));
    // A relative error is meaningless if the noise of single pixels is next to none.
    let known = whole.base_std_err[1] < NOT_DETERMINED * whole.base.read_noise_e;
    Cost { read_noise_rel: if known { cost.read_noise_rel } else { 0.0 }, ..cost }
}

/// Computes the cost of the remainder: measured means and variances against those that the model expects.
pub(super) fn of_remainder(all: &Observations, whole: &Fitted) -> Cost {
    let both =
        Plain::of(all, |i| all.list[i].measured.value).zip(Plain::of_model(all, whole, &whole.effects));
    both.map_or_else(Cost::default, |(measured, expected)| measured.against(&expected))
}
