//! Readings of one check, from some darks and some frames of a reference flat.

use crate::calibrate::file::Calibration;
use crate::monitor::Limits;
use crate::number::{six_digits, with_error};
use crate::statistics::moments::{Moments, SizeMismatch};
use ndarray::{Array2, s};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Threshold of hot pixels: standard deviations above the dark reference.
const HOT_SIGMA: f64 = 6.0;
/// Threshold of dead pixels: factor between the corrected value and the mean, either way
/// ([`crate::calibrate::defects`]).
const DEAD: f64 = 0.5;
/// Minimum signal of the reference flat as a divisor, in standard errors.
const FAINT: f64 = 10.0;
/// Smallest reported difference of the gain from the calibration, relative: lag and filters of a camera bias
/// the two estimates differently.
const MIN_GAIN_LIMIT: f64 = 0.05;
/// Margin beyond a limit, in standard errors, for a difference from the calibration.
const SIGMAS: f64 = 5.0;
/// Maximum length of a pixel list: more pixels mean another fault of the camera.
const LISTED: usize = 1000;

/// Quantity followed by the checks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Followed {
    /// Mean of short darks without their dark current, DN.
    BlackLevel,
    /// Mean growth of darks with the exposure, DN/s.
    DarkCurrent,
    /// Overall system gain from temporal variances, DN/e.
    Gain,
    /// Mean of the reference flat above the dark level, DN.
    Signal,
    /// Temporal variance of darks, DN^2.
    DarkNoise,
    /// Variance between neighbours left after correction with K, relative to the signal.
    Pattern,
    /// Variance of the frame means of the flat, relative to the signal.
    Flicker,
    /// Frames lost in transfer.
    LostFrames,
}

impl Followed {
    /// Returns the name with its unit, for an axis.
    pub fn title(self) -> &'static str {
        match self {
            Self::BlackLevel => "Black level (DN)",
            Self::DarkCurrent => "Dark current (DN/s)",
            Self::Gain => "System gain (DN/e⁻)",
            Self::Signal => "Reference flat (DN)",
            Self::DarkNoise => "Dark noise, temporal variance (DN²)",
            Self::Pattern => "Pattern left by K, variance (relative)",
            Self::Flicker => "Flicker, variance of frame means (relative)",
            Self::LostFrames => "Lost frames",
        }
    }
}

/// A reading and its standard error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Value.
    pub value: f64,
    /// Standard error.
    pub std_err: f64,
}

/// Results of a check.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Check {
    /// Time of the check, seconds since 1970.
    pub time_s: f64,
    /// Exposure of flats and short darks, s.
    pub exposure_s: f64,
    /// Sensor temperature, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Frames of the flat; the flicker has one degree of freedom less.
    pub flats: u64,
    /// Frames received.
    pub frames: u64,
    /// Readings.
    pub readings: BTreeMap<Followed, Reading>,
    /// Pixels (column, row) that became hot after the calibration.
    pub hot: Vec<(u32, u32)>,
    /// Pixels (column, row) that became dead after the calibration.
    pub dead: Vec<(u32, u32)>,
}

impl Check {
    /// Compares black level and gain with the calibration; returns the differences as sentences. The monitor
    /// follows changes from check to check, so it misses a difference that exists since the first check.
    pub fn against(&self, calibration: &Calibration, limits: &Limits) -> Vec<String> {
        let d = &calibration.description;
        let mut said = Vec::new();
        let mut hold = |what, name: &str, unit: &str, known: Option<f64>, limit: f64| {
            let (Some(reading), Some(known)) = (self.readings.get(&what), known) else { return };
            if (reading.value - known).abs() > limit + SIGMAS * reading.std_err {
                let (now, was) = (with_error(reading.value, reading.std_err), six_digits(known));
                said.push(format!("{name} is {now} {unit}, and {was} {unit} in the calibration"));
            }
        };
        hold(Followed::BlackLevel, "the black level", "DN", d.offset_dn, limits.black_level_dn);
        let gain = d.gain_dn_per_e;
        let limit = limits.gain.max(MIN_GAIN_LIMIT);
        hold(Followed::Gain, "the gain", "DN/e", gain, limit * gain.unwrap_or(0.0).abs());
        said
    }
}

/// Statistics of the frames of one kind.
#[derive(Debug, Clone)]
pub struct Stack {
    moments: Moments,
    means_dn: Vec<f64>,
}

impl Stack {
    /// Creates a stack for frames of (rows, columns) with codes of `bit_depth` bits.
    pub fn new(shape: (usize, usize), bit_depth: u8) -> Self {
        Self { moments: Moments::new(shape, bit_depth), means_dn: Vec::new() }
    }

    /// Adds a frame, row by row, DN.
    ///
    /// # Errors
    ///
    /// The frame has another size.
    pub fn add(&mut self, dn: &[u16]) -> Result<(), SizeMismatch> {
        self.moments.add(&[dn])?;
        let sum: u64 = dn.iter().map(|&d| u64::from(d)).sum();
        self.means_dn.push(sum as f64 / dn.len().max(1) as f64);
        Ok(())
    }

    /// Returns the number of frames.
    pub fn frames(&self) -> u64 {
        self.moments.frames()
    }

    fn mean_dn(&self) -> f64 {
        self.means_dn.iter().sum::<f64>() / self.means_dn.len().max(1) as f64
    }

    /// Returns the variance of the frame means, DN^2.
    fn scatter_dn2(&self) -> f64 {
        let (mean, n) = (self.mean_dn(), self.means_dn.len() as f64);
        self.means_dn.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0)
    }

    /// Returns the mean temporal variance of a pixel, DN^2, without the noise common to a frame. Its squared
    /// standard error is 2 v^2 / dof for normal noise, with dof = n (F - 1).
    fn noise_dn2(&self) -> Reading {
        let pixels = self.moments.sums().len() as f64;
        let variance = self.moments.variance_dn2().mean().unwrap_or(f64::NAN);
        // The variance of frame means contains v / n of the pixel noise.
        let value = (variance - self.scatter_dn2()) / (1.0 - 1.0 / pixels);
        let dof = pixels * (self.frames() as f64 - 1.0).max(1.0);
        Reading { value, std_err: value * (2.0 / dof).sqrt() }
    }
}

/// The frames of a check.
#[derive(Debug, Clone)]
pub struct Taken {
    /// Seconds since 1970.
    pub time_s: f64,
    /// Exposure of flats and short darks, s.
    pub exposure_s: f64,
    /// Exposure of long darks, s.
    pub long_s: f64,
    /// Degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Darks at the exposure of the flats.
    pub short: Stack,
    /// Darks at the long exposure.
    pub long: Stack,
    /// The reference flat.
    pub flat: Stack,
    /// Frames lost during the check.
    pub lost: u64,
}

impl Taken {
    /// Evaluates the frames against the calibration.
    pub fn check(&self, calibration: &Calibration) -> Check {
        let pixels = self.short.moments.sums().len() as f64;
        let (short, long, flat) = (&self.short, &self.long, &self.flat);
        let (dark_noise, flat_noise) = (short.noise_dn2(), flat.noise_dn2());
        let frames = |s: &Stack| s.frames().max(1) as f64;
        // Squared error of a mean: pixel noise or noise common to a frame, the larger one.
        let error2 = |s: &Stack, noise: f64| (noise / pixels).max(s.scatter_dn2()) / frames(s);
        let (short_error2, long_error2) =
            (error2(short, dark_noise.value), error2(long, long.noise_dn2().value));
        let reach_s = self.long_s - self.exposure_s;
        let current = if reach_s > 0.0 { (long.mean_dn() - short.mean_dn()) / reach_s } else { 0.0 };
        let current_error2 = (short_error2 + long_error2) / (reach_s * reach_s);
        let signal = flat.mean_dn() - short.mean_dn();
        let signal_error2 = flat_noise.value / pixels / frames(flat) + short_error2;
        let flicker = (flat.scatter_dn2() - flat_noise.value / pixels).max(0.0);
        let gain = (flat_noise.value - dark_noise.value) / signal;
        let gain_error = flat_noise.std_err.hypot(dark_noise.std_err) / signal;
        let mut readings = BTreeMap::new();
        let mut put = |what, value: f64, std_err: f64| {
            if value.is_finite() && std_err.is_finite() {
                readings.insert(what, Reading { value, std_err });
            }
        };
        if reach_s > 0.0 {
            // Black level = short - (long - short) e / reach: the error of short has the weight 1 + e /
            // reach.
            let share = self.exposure_s / reach_s;
            let black_error2 = (1.0 + share).powi(2) * short_error2 + share * share * long_error2;
            put(Followed::BlackLevel, short.mean_dn() - current * self.exposure_s, black_error2.sqrt());
            put(Followed::DarkCurrent, current, current_error2.sqrt());
        } else {
            put(Followed::BlackLevel, short.mean_dn(), short_error2.sqrt());
        }
        let signal_error = (signal_error2 + flicker / frames(flat)).sqrt();
        let lit = signal > FAINT * signal_error && flat.frames() > 1;
        put(Followed::Signal, signal, signal_error);
        if lit {
            put(Followed::Gain, gain, gain_error);
            put(Followed::Flicker, flat.scatter_dn2() / (signal * signal), 0.0);
            let (value, std_err) = self.pattern(calibration, signal, flat_noise.value);
            put(Followed::Pattern, value, std_err);
        }
        put(Followed::DarkNoise, dark_noise.value, dark_noise.std_err);
        let came = short.frames() + long.frames() + flat.frames();
        put(Followed::LostFrames, self.lost as f64, 0.0);
        Check {
            time_s: self.time_s,
            exposure_s: self.exposure_s,
            temperature_c: self.temperature_c,
            flats: flat.frames(),
            frames: came,
            readings,
            hot: self.hot(calibration, if lit { gain } else { 0.0 }),
            dead: if lit { self.dead(calibration) } else { Vec::new() },
        }
    }

    /// Returns the corrected flat over its mean; in a colour mosaic, each plane over its own mean.
    fn corrected(&self, calibration: &Calibration) -> Array2<f64> {
        let dark = self.short.moments.mean_dn();
        let mut out = self.flat.moments.mean_dn() - dark;
        ndarray::Zip::from(&mut out).and(&calibration.k).for_each(|o, &k| *o /= f64::from(k));
        let period = calibration.period();
        for (y, x) in (0..period).flat_map(|y| (0..period).map(move |x| (y, x))) {
            let mut plane = out.slice_mut(s![y..;period, x..;period]);
            let flags = calibration.defects.slice(s![y..;period, x..;period]);
            // Flagged pixels, such as those without light, do not enter the mean.
            let sound = plane.iter().zip(&flags).filter(|(_, flags)| **flags == 0);
            let (n, sum) = sound.fold((0.0, 0.0), |(n, sum), (v, _)| (n + 1.0, sum + v));
            plane /= if n > 0.0 { sum / n } else { 1.0 };
        }
        out
    }

    /// Returns the variance between neighbours in the corrected flat beyond the frame noise, relative: half
    /// the mean square of differences along the rows, within a colour. Neighbours receive equal light. The
    /// constant part, including errors of K, is in the baseline as well.
    fn pattern(&self, calibration: &Calibration, signal: f64, noise_dn2: f64) -> (f64, f64) {
        let image = self.corrected(calibration);
        let period = calibration.period();
        let (mut sum, mut squares, mut n) = (0.0, 0.0, 0.0);
        for (row, flags) in image.rows().into_iter().zip(calibration.defects.rows()) {
            // Pairs do not overlap.
            for x in (period..row.len()).filter(|x| x / period % 2 == 1) {
                if flags[x] == 0 && flags[x - period] == 0 {
                    let half = 0.5 * (row[x] - row[x - period]).powi(2);
                    sum += half;
                    squares += half * half;
                    n += 1.0;
                }
            }
        }
        let mean: f64 = sum / f64::max(n, 1.0);
        let error = ((squares / f64::max(n, 1.0) - mean * mean) / f64::max(n, 1.0)).sqrt();
        let frames = self.flat.frames() as f64;
        let dark = self.short.noise_dn2().value / self.short.frames().max(1) as f64;
        (mean - (noise_dn2 / frames + dark) / (signal * signal), error)
    }

    fn hot(&self, calibration: &Calibration, gain: f64) -> Vec<(u32, u32)> {
        let Ok(reference) = calibration.dark.at(self.long_s) else { return Vec::new() };
        let mean = self.long.moments.mean_dn();
        let shift = self.long.mean_dn() - f64::from(reference.mean().unwrap_or(0.0));
        let usual = f64::from(reference.mean().unwrap_or(0.0));
        let noise = self.long.noise_dn2().value;
        let error = calibration.dark.std_err_at(self.long_s);
        let limit2 = |r: f64| {
            // Dark charge has shot noise of its own.
            (noise + gain.max(0.0) * (r - usual).max(0.0)) / self.long.frames().max(1) as f64 + error * error
        };
        let hot = mean.indexed_iter().filter(|((y, x), m)| {
            let r = f64::from(reference[(*y, *x)]);
            calibration.defects[(*y, *x)] == 0 && **m - r - shift > HOT_SIGMA * limit2(r).sqrt()
        });
        hot.map(|((y, x), _)| (x as u32, y as u32)).take(LISTED).collect()
    }

    fn dead(&self, calibration: &Calibration) -> Vec<(u32, u32)> {
        let image = self.corrected(calibration);
        let dead = image
            .indexed_iter()
            .filter(|((y, x), v)| calibration.defects[(*y, *x)] == 0 && !(DEAD..=1.0 / DEAD).contains(*v));
        dead.map(|((y, x), _)| (x as u32, y as u32)).take(LISTED).collect()
    }
}
