//! Expected statistics of a whole campaign: a model's predictions, to be compared with measurements.

mod campaign;
mod fields;
mod set;

use crate::normal::upper;
use crate::quantize::{NODES, reaches_zero, rounded_from_zero, rounded_unlike};
use campaign::{Noisy, before_rounding};

pub use crate::normal::{NORMAL, PLACES};
pub use crate::spectrum::{Filter, GRID, HALF, LAGS, LineNoise, Ripple, Spectrum, angle, cosine_power};
pub use campaign::{Before, Campaign, FrameInfo, Ordinary, SetInfo};
pub use fields::{Fields, SHAPES, cosine};
pub use set::{SetPrediction, TwoLevels};

/// Parameters of the paper's model, for a campaign.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseParameters {
    /// A, DN/e.
    pub gain_dn_per_e: f64,
    /// Read noise, root mean square over the pixels, e.
    pub read_noise_e: f64,
    /// Spread of the read noise over the pixels: variance of the pixels' read-noise variances over the square
    /// of their mean; 0 for pixels that are alike.
    pub read_noise_spread: f64,
    /// Black level at zero exposure, DN.
    pub offset_dn: f64,
    /// Dark current, e/s.
    pub dark_e_per_s: f64,
    /// Light of each lamp level, e/s.
    pub flux_e_per_s: Vec<f64>,
    /// Signal of the frames before the first, e, for effects with memory; `None`: nothing was exposed.
    pub past_e: Option<f64>,
    /// Expected relative scatter of the light from setting to setting; `None`: every setting is as stated.
    pub setting_rel: Option<f64>,
    /// Light monitor, if there is one.
    pub monitor: Option<Monitor>,
    /// True if noise is cut below code 0, as by a converter. False if a diagnosis looks for a black level
    /// that is too low: only black-clipping cuts then.
    pub cut_at_0: bool,
}

/// A light monitor beside the camera.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Monitor {
    /// Logarithm of the reading for one electron of light.
    pub ln_per_e: f64,
    /// Relative scatter of the readings.
    pub rel: f64,
}

impl BaseParameters {
    /// Returns the light of a set, electrons per pixel and second.
    pub fn rate_e_per_s(&self, set: &SetInfo) -> f64 {
        set.light.and_then(|l| self.flux_e_per_s.get(l)).copied().unwrap_or(0.0) * set.light_ratio
    }
}

/// Expected statistics of a campaign.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Mean of every frame: e before the amplifier, DN (with the offset) at the end.
    pub frame_signal: Vec<f64>,
    /// Statistics of every set.
    pub sets: Vec<SetPrediction>,
    /// Light of every set's settled frames for a monitor beside the camera, e.
    pub light_e: Vec<f64>,
    /// Base parameters in force.
    pub base: BaseParameters,
    /// Errors of the weights of the bits, DN.
    pub bit_errors_dn: [f64; BITS],
    /// Distance of successive codes, DN.
    pub code_step_dn: f64,
    /// Code from which all others are whole numbers of steps away, DN.
    pub code_zero_dn: f64,
    /// True if firmware has rounded to whole codes already.
    pub whole: bool,
    /// Standard error of the variance of the darkest sets that all of them share, beyond those of the sets,
    /// DN^2 before any table.
    pub unsure_dark_dn2: f64,
    /// Lowest possible level, DN above the black level.
    pub floor_dn: f64,
    /// True if noise is cut below code 0.
    pub cut_at_0: bool,
    /// Gain ratio less 1, and offset in DN, of one part against the other: right half against left, lower
    /// against upper, odd columns against even, odd rows against even.
    pub taps: [(f64, f64); 4],
    /// Light collected while charge is moved through the image, s of exposure.
    pub smear_s: f64,
    /// Charge above which a pixel spills into its column, e.
    pub bloom_e: f64,
    /// Maximum charge of a pixel, e.
    pub well_e: f64,
}

/// Maximum number of bits of a code.
pub const BITS: usize = 16;

/// Relative error of a curve averaged over a few levels of the field (a named choice: the field of shading is
/// not normal).
const OF_PLACES: f64 = 0.1;

/// Returns the deviation of a rounded mean from the level, in steps, for noise of this variance in squares of
/// the step: the first term of the characteristic function, as a root mean square over all levels (Widrow and
/// Kollar 2008, ch. 4).
pub(crate) fn quantised_mean(variance: f64) -> f64 {
    let square = std::f64::consts::PI * std::f64::consts::PI;
    libm::exp(-2.0 * square * variance.max(0.0)) / (std::f64::consts::PI * std::f64::consts::SQRT_2)
}

/// Returns the root mean square of the residuals of values at [`PLACES`] about a straight line.
fn off_a_line(places: &[f64; PLACES.len()], values: &[f64]) -> f64 {
    let all = || places.iter().zip(PLACES).zip(values);
    let mean = |of: &dyn Fn(f64, f64) -> f64| all().map(|((x, share), v)| share * of(*x, *v)).sum::<f64>();
    let (mx, mv) = (mean(&|x, _| x), mean(&|_, v| v));
    let xx = mean(&|x, _| (x - mx) * (x - mx));
    let slope = if xx > 0.0 { mean(&|x, v| (x - mx) * (v - mv)) / xx } else { 0.0 };
    libm::sqrt(mean(&|x, v| (v - mv - slope * (x - mx)).powi(2)))
}

impl Prediction {
    /// Returns true if two predictions have the same camera; the light of the sets may differ.
    pub fn has_camera_of(&self, other: &Self) -> bool {
        let dark = |base: &BaseParameters| BaseParameters {
            flux_e_per_s: Vec::new(),
            past_e: None,
            setting_rel: None,
            ..base.clone()
        };
        let limits = |p: &Self| (p.code_step_dn, p.code_zero_dn, p.floor_dn, p.smear_s, p.bloom_e, p.well_e);
        (self.bit_errors_dn, self.taps, limits(self)) == (other.bit_errors_dn, other.taps, limits(other))
            && (self.whole, self.cut_at_0) == (other.whole, other.cut_at_0)
            && dark(&self.base) == dark(&other.base)
    }

    /// Returns true if a set has the same light and the same statistics in both; means of frames may differ.
    pub fn has_set_of(&self, other: &Self, set: usize) -> bool {
        self.light_e.get(set) == other.light_e.get(set) && self.sets.get(set) == other.sets.get(set)
    }

    /// Starts with the light and dark charge of every frame and set, without noise.
    pub(crate) fn begin(c: &Campaign, base: &BaseParameters) -> Self {
        let light = |s: &SetInfo| base.rate_e_per_s(s) * s.exposure_s;
        let light_e: Vec<f64> = c.sets.iter().map(light).collect();
        let of_sets: Vec<f64> =
            c.sets.iter().zip(&light_e).map(|(s, light)| light + base.dark_e_per_s * s.exposure_s).collect();
        let rel = base.setting_rel.unwrap_or(0.0);
        let set = |(&signal, light): (&f64, &f64)| SetPrediction {
            setting: (rel * light).powi(2),
            ..SetPrediction::new(signal)
        };
        Self {
            frame_signal: c.frames.iter().map(|f| of_sets.get(f.set).copied().unwrap_or(0.0)).collect(),
            sets: of_sets.iter().zip(&light_e).map(set).collect(),
            light_e,
            base: base.clone(),
            bit_errors_dn: [0.0; BITS],
            code_step_dn: 1.0,
            code_zero_dn: 0.0,
            whole: false,
            unsure_dark_dn2: 0.0,
            floor_dn: f64::NEG_INFINITY,
            cut_at_0: base.cut_at_0,
            taps: [(0.0, 0.0); 4],
            smear_s: 0.0,
            bloom_e: f64::INFINITY,
            well_e: f64::INFINITY,
        }
    }

    /// Rounds to whole steps.
    pub(crate) fn quantize(&mut self, c: &Campaign, step: f64) {
        if std::mem::take(&mut self.whole) {
            return;
        }
        let square = step * step;
        let mut shifts = vec![0.0; self.sets.len()];
        let taps = self.taps;
        // With several tap patterns, the largest level difference is used.
        let apart = |signal: f64| {
            let steps = taps.map(|(gain, offset)| gain * signal + offset);
            steps.into_iter().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a })
        };
        let may_be_clipped = c.from_code_0 && self.cut_at_0 && self.base.offset_dn + self.floor_dn < 0.0;
        for (i, s) in self.sets.iter_mut().enumerate() {
            let variance = s.covariance(0, 0) / square;
            let unlike_all = s.unequal.max(0.0) / (square * square);
            let unlike = unlike_all / (variance * variance).max(f64::MIN_POSITIVE);
            // A few noisy pixels make the spread large, but do not change the rounding of the others.
            let (own, unlike) = match c.ordinary {
                Some(ordinary) => {
                    ordinary.of(variance, (s.read.lag(0, 0) / square).min(variance).max(0.0), step)
                }
                None => (variance, unlike),
            };
            let (spread, places) = c.sets.get(i).map_or((0.0, &NORMAL), |s| (s.spread_dn / step, &s.places));
            let level = (s.signal + self.base.offset_dn - self.code_zero_dn) / step;
            let noisy =
                c.ordinary.and_then(|_| Noisy::beside(own, variance, unlike_all - unlike * own * own));
            let loudest = noisy.map_or(variance, |n| n.variance);
            let rounded = if may_be_clipped && reaches_zero(level, spread, places, loudest) {
                // Levels are measured after clipping. Before it their spread is larger, by the inverse share
                // of the pixels that are not clipped.
                let slope = upper(-level / libm::sqrt(variance + spread * spread).max(0.02));
                let spread = spread / slope.clamp(0.3, 1.0);
                let found = match noisy {
                    Some(n) => n.mixed(own, |variance| rounded_from_zero(level, spread, places, variance)),
                    None => rounded_from_zero(level, spread, places, variance),
                };
                // The distribution of the pixels' levels is represented by nine groups only.
                s.unsure = libm::hypot(s.unsure, 0.3 * square * square * found.unequal);
                s.unsure_mean = libm::hypot(s.unsure_mean, 0.02 * step * found.mean.abs());
                found
            } else {
                rounded_unlike(
                    level,
                    before_rounding(level, spread, own),
                    apart(s.signal) / step,
                    own,
                    unlike,
                )
            };
            shifts[i] = step * rounded.mean;
            s.uneven = libm::hypot(s.uneven, step * quantised_mean(variance));
            // Noise that pixels or frames share is multiplied by the slope; the own noise of each keeps its
            // whole variance.
            let through = rounded.slope * rounded.slope;
            let mut kept = 0.0;
            if through != 1.0 {
                for power in [&mut s.shot, &mut s.read] {
                    let own = power.lag(0, 0);
                    power.scale(through);
                    power.add_white((1.0 - through) * own);
                }
                let lines: f64 = s.lines.iter().map(|l| l.0).sum::<f64>() + s.fields.variance();
                kept = (1.0 - through) * (s.row.lag(0) + s.column.lag(0) + s.ripple(0.0) + lines);
                s.shared(through);
            }
            s.add_rounding(kept + square * rounded.variance);
            s.unequal += square * square * rounded.unequal;
            s.fourth += square * square * rounded.fourth;
            s.signal += shifts[i];
        }
        for (m, frame) in self.frame_signal.iter_mut().zip(&c.frames) {
            *m += shifts.get(frame.set).copied().unwrap_or(0.0);
        }
    }

    /// Multiplies the image by a number, the gain of the amplifier.
    pub(crate) fn amplify(&mut self, gain: f64) {
        self.frame_signal.iter_mut().for_each(|s| *s *= gain);
        for s in &mut self.sets {
            s.signal *= gain;
            s.gain(gain);
        }
    }

    /// Applies a curve to every pixel. The noise of each pixel is multiplied by the slope averaged over the
    /// noise; the level is averaged over the nine level groups.
    pub fn bend(&mut self, c: &Campaign, curve: impl Fn(f64) -> f64) {
        let before: Vec<f64> = self.sets.iter().map(|s| s.signal).collect();
        let noise: Vec<f64> = self.sets.iter().map(|s| libm::sqrt(s.covariance(0, 0).max(1e-6))).collect();
        // Mean of a pixel at a level, and its variance over that before.
        let pixel = |level: f64, sd: f64| {
            let all = NODES.map(|(x, share)| (curve(level + sd * x), share));
            let mean: f64 = all.iter().map(|(v, share)| share * v).sum();
            let variance: f64 = all.iter().map(|(v, share)| share * (v - mean) * (v - mean)).sum();
            (mean, variance / (sd * sd))
        };
        let places = |set: usize| c.sets[set].places.iter().zip(PLACES);
        for (set, s) in self.sets.iter_mut().enumerate() {
            let spread = c.sets[set].spread * s.signal;
            let all: Vec<(f64, f64, f64)> = places(set)
                .map(|(x, share)| {
                    let (mean, square) = pixel(s.signal + spread * x, noise[set]);
                    (share, mean, square)
                })
                .collect();
            let square: f64 = all.iter().map(|(share, _, square)| share * square).sum();
            let apart: f64 = all.iter().map(|(share, _, q)| share * (q - square) * (q - square)).sum();
            let own = s.pixels();
            let level = s.signal;
            s.signal = all.iter().map(|(share, mean, _)| share * mean).sum();
            // The curve's effect on shading is evaluated at nine levels only.
            s.unsure_mean =
                libm::hypot(s.unsure_mean, OF_PLACES * (s.signal - pixel(level, noise[set]).0).abs());
            let bent: Vec<f64> = all.iter().map(|(_, mean, _)| mean - s.signal).collect();
            s.uneven = libm::hypot(s.uneven, off_a_line(&c.sets[set].places, &bent));
            s.scale(square);
            s.unequal += apart * own * own;
        }
        for (m, frame) in self.frame_signal.iter_mut().zip(&c.frames) {
            let (Some(before), set) = (before.get(frame.set), frame.set) else { continue };
            *m = if *m == *before {
                self.sets[set].signal
            } else {
                let spread = c.sets[set].spread * *m;
                places(set).map(|(x, share)| share * pixel(*m + spread * x, noise[set]).0).sum()
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantize::rounded;
    use crate::rng::{PixelRng, Stream};

    /// 20 000 pixels of log-normal noise, 8 of 1000 ten times noisier. The mean of their rounded levels is
    /// known from the series of Widrow and Kollar 2008, ch. 4; a log-normal with the spread of all pixels is
    /// off by more than a tenth of it.
    #[test]
    fn a_few_noisy_pixels_leave_the_rounding_of_the_others() {
        let (median, log_spread) = (0.37f64, 0.2f64);
        let mut rng = PixelRng::new(3, Stream::Effect, 0, 0, 0);
        let mut sd = || {
            let noisier = if rng.uniform() < 0.008 { 10.0 } else { 1.0 };
            noisier * median * (log_spread * rng.normal()).exp()
        };
        let all: Vec<f64> = (0..20_000).map(|_| sd()).collect();
        let mean = |of: &dyn Fn(f64) -> f64| all.iter().map(|s| of(*s)).sum::<f64>() / all.len() as f64;
        let variance = mean(&|s| s * s);
        let spread = mean(&|s| (s * s - variance).powi(2)) / (variance * variance);
        // Median and spread of the darks' measured variances, which include the rounding at their level.
        let dark_dn = 7.4;
        let shown = |s: f64| s * s + rounded(dark_dn, 0.0, s * s).variance;
        let measured_dn = dark_dn + rounded(dark_dn, 0.0, median * median).mean;
        let width = 0.5 * (shown(median * log_spread.exp()) / shown(median * (-log_spread).exp())).ln();
        let ordinary = Ordinary::of_darks(shown(median), 0.5 * width, measured_dn, 0.0);
        let (own, unlike) = ordinary.of(variance, variance, 1.0);
        for level in [10.2, 10.3, 10.7, 10.8] {
            let term = |k: i32, s: f64| {
                let (k, pi) = (f64::from(k), std::f64::consts::PI);
                (pi * k).cos() / (pi * k) * (2.0 * pi * k * level).sin() * (-2.0 * (pi * k * s).powi(2)).exp()
            };
            let known = mean(&|s| (1..6).map(|k| term(k, s)).sum());
            let found = rounded_unlike(level, 0.0, 0.0, own, unlike).mean;
            assert!((found - known).abs() < 0.1 * known.abs(), "{level}: {found}, not {known}");
            let by_spread = rounded_unlike(level, 0.0, 0.0, variance, spread).mean;
            assert!((by_spread - known).abs() > 0.1 * known.abs(), "{level}: {by_spread}, {known}");
        }
    }

    /// Pixels of 0.02 codes of spread and 0.06 codes of noise, next to the edge between two codes and far
    /// from it. Their rounded means are known from the error function; the spread is found to a tenth where
    /// rounding enlarges it, and is at most as measured elsewhere.
    #[test]
    fn spread_before_rounding_is_found_from_rounded_means() {
        let (spread, noise) = (0.02f64, 0.06f64);
        let mut rng = PixelRng::new(4, Stream::Effect, 0, 0, 0);
        for (level, enlarged) in [(10.5, true), (10.47, true), (10.44, true), (10.0, false)] {
            let mean = |at: f64| {
                let edge = |k: f64| 0.5 * libm::erfc((k + 0.5 - at) / (noise * std::f64::consts::SQRT_2));
                (0..30).map(|k| edge(f64::from(k))).sum::<f64>()
            };
            let means: Vec<f64> = (0..20_000).map(|_| mean(level + spread * rng.normal())).collect();
            let middle = means.iter().sum::<f64>() / means.len() as f64;
            let square = means.iter().map(|m| (m - middle).powi(2)).sum::<f64>() / means.len() as f64;
            let found = before_rounding(level, square.sqrt(), noise * noise);
            let right = if enlarged { (found / spread - 1.0).abs() < 0.1 } else { found <= square.sqrt() };
            assert!(right, "{level}: {found}, measured {}", square.sqrt());
        }
    }
}
