//! Expected statistics of a whole campaign: what every model must say before it is held against measurements.
//!
//! Noise is carried as a power spectrum over the sensor, so that charge sharing and filters are multiplications
//! (Wiener-Khinchin); covariances at small lags come back by the inverse transform.

use crate::effects::Clipped;
use crate::quantize::rounded;

/// Side of the grid of spatial frequencies.
pub const GRID: usize = 16;

/// Power of the noise at GRID x GRID spatial frequencies (row-major: vertical, horizontal), e^2 or DN^2 for each pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum(pub Vec<f64>);

/// The angle of frequency number i, radians per pixel.
pub fn angle(i: usize) -> f64 {
    std::f64::consts::TAU * i as f64 / GRID as f64
}

impl Spectrum {
    /// Noise without correlation.
    pub fn white(variance: f64) -> Self {
        Self(vec![variance; GRID * GRID])
    }

    /// Multiplies the power at each frequency (vertical, horizontal angle).
    pub fn shape(&mut self, gain: impl Fn(f64, f64) -> f64) {
        for (i, p) in self.0.iter_mut().enumerate() {
            *p *= gain(angle(i / GRID), angle(i % GRID));
        }
    }

    /// Multiplies all power.
    pub fn scale(&mut self, by: f64) {
        self.0.iter_mut().for_each(|p| *p *= by);
    }

    /// Covariance at a lag: rows down, columns to the right; at most 3 of each.
    pub fn lag(&self, dy: i32, dx: i32) -> f64 {
        if let Some(variance) = self.of_white() {
            return if (dy, dx) == (0, 0) { variance } else { 0.0 };
        }
        let table = &cosines()[((dy.clamp(-3, 3) + 3) * 7 + dx.clamp(-3, 3) + 3) as usize];
        // Sums that do not wait for each other: a fit asks for this some million times.
        let mut lanes = [0.0; 8];
        for (powers, cosines) in self.0.as_chunks::<8>().0.iter().zip(table.as_chunks::<8>().0) {
            for i in 0..8 {
                lanes[i] += powers[i] * cosines[i];
            }
        }
        lanes.iter().sum::<f64>() / self.0.len() as f64
    }

    /// The variance, where noise is without correlation.
    fn of_white(&self) -> Option<f64> {
        let first = self.0[0];
        self.0.as_chunks::<8>().0.iter().all(|powers| powers.iter().all(|p| *p == first)).then_some(first)
    }

    /// Power of the mean over all pixels, times their number.
    pub fn of_mean(&self) -> f64 {
        self.0[0]
    }
}

/// The cosine of each frequency at each lag from -3 to 3 in both directions.
fn cosines() -> &'static [Vec<f64>] {
    use std::sync::OnceLock;
    static TABLE: OnceLock<Vec<Vec<f64>>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let at = |dy: i32, dx: i32| {
            (0..GRID * GRID)
                .map(|i| libm::cos(angle(i / GRID) * f64::from(dy) + angle(i % GRID) * f64::from(dx)))
                .collect()
        };
        (-3..=3).flat_map(|dy| (-3..=3).map(move |dx| at(dy, dx))).collect()
    })
}

/// A frame of a campaign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameInfo {
    /// Place of its set in [`Campaign::sets`].
    pub set: usize,
    /// Start of its exposure, s from the start of the campaign.
    pub time_s: f64,
}

/// Shares of the pixels, from the lowest to the highest, whose levels [`SetInfo::places`] gives: few where the tails are.
pub const PLACES: [f64; 9] = [0.01, 0.04, 0.1, 0.2, 0.3, 0.2, 0.1, 0.04, 0.01];

/// [`SetInfo::places`] of normal levels.
pub const NORMAL: [f64; PLACES.len()] =
    [-2.718_725, -1.950_477, -1.326_337, -0.699_978, 0.0, 0.699_978, 1.326_337, 1.950_477, 2.718_725];

/// A set of frames: darks or flats of one exposure and light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SetInfo {
    /// Exposure, s.
    pub exposure_s: f64,
    /// Electrons per pixel and second from the light, by which lamp level; `None`: dark.
    pub light: Option<usize>,
    /// Light relative to the campaign's unit.
    pub illumination: f64,
    /// Spatial deviation of the signal over its mean.
    pub spread: f64,
    /// Spatial deviation of the level, fixed pattern of the offset included, DN.
    pub spread_dn: f64,
    /// Where the pixels' levels lie, in these deviations from the mean; their shares are [`PLACES`].
    pub places: [f64; PLACES.len()],
}

/// What was measured, as far as a prediction needs it.
#[derive(Debug, Clone, PartialEq)]
pub struct Campaign {
    /// Frames in the order of time, those that are not looked at (scenes) included.
    pub frames: Vec<FrameInfo>,
    /// Sets.
    pub sets: Vec<SetInfo>,
    /// Rows and columns.
    pub shape: (usize, usize),
    /// Largest code, DN.
    pub full_scale_dn: f64,
    /// The strongest line that the noise's spectrum has in read-out order, cycles per pixel.
    pub line_cycles_per_px: Option<f64>,
}

/// The paper's parameters as a campaign sees them.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseParameters {
    /// A, DN/e.
    pub gain_dn_per_e: f64,
    /// Read noise, e.
    pub read_noise_e: f64,
    /// Level of zero charge, DN.
    pub offset_dn: f64,
    /// Dark current, e/s.
    pub dark_e_per_s: f64,
    /// Light of each lamp level, e/s.
    pub flux_e_per_s: Vec<f64>,
}

/// Expected statistics of one set.
#[derive(Debug, Clone, PartialEq)]
pub struct SetPrediction {
    /// Mean signal of the settled frames, e before the amplifier, DN above zero after it.
    pub signal: f64,
    /// Power of the shot noise, e^2, then DN^2.
    pub shot: Spectrum,
    /// Power of the noise added at read-out, e^2, then DN^2.
    pub read: Spectrum,
    /// Variance common to the pixels of a row, of a column, of a frame.
    pub row: f64,
    /// See `row`.
    pub column: f64,
    /// See `row`.
    pub common: f64,
    /// Correlation of the noise with that of the frame 1, 2, ... later: of shot noise, of read noise.
    pub shot_memory: Vec<f64>,
    /// See `shot_memory`.
    pub read_memory: Vec<f64>,
    /// Variance, from pixel to pixel, of their noise's variance, e^4, then DN^4 (0 for pixels that are alike).
    pub unequal: f64,
    /// Fourth cumulant of the pixels' noise, the mean over all of them, e^4, then DN^4 (0 for normal noise).
    pub fourth: f64,
    /// By so much `unequal` is not known, e^4, then DN^4.
    pub unsure: f64,
    /// By so much variance and covariances are not known, e^2, then DN^2.
    pub unsure_var: f64,
    /// By so much the mean is not known, e, then DN.
    pub unsure_mean: f64,
    /// Lines in the spectrum: (variance, phase from column to column, phase from row to row), radians.
    pub lines: Vec<(f64, f64, f64)>,
    /// Change of the neighbour covariances per unit of distance from the output, as a share of the shot variance: along rows,
    /// along columns, over the whole sensor.
    pub growth: (f64, f64),
    /// Covariance with the next column from odd columns less that from even ones; with the next row alike.
    pub parity: (f64, f64),
}

/// Everything that is expected.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Mean of every frame: e before the amplifier, DN (with the offset) at the end.
    pub frame_signal: Vec<f64>,
    /// Statistics of every set.
    pub sets: Vec<SetPrediction>,
    /// Base parameters in force.
    pub base: BaseParameters,
    /// What the weight of each bit is too large by, DN.
    pub bit_errors_dn: [f64; BITS],
    /// Every code is a multiple of this, DN.
    pub code_step_dn: f64,
    /// Gain of the right half over the left, minus 1, and its offset, DN; of the lower half over the upper; of odd columns over even
    /// ones; of odd rows.
    pub taps: [(f64, f64); 4],
    /// Light collected while charge is moved through the image, s of exposure.
    pub smear_s: f64,
    /// From this charge on a pixel spills into its column, e.
    pub bloom_e: f64,
}

/// Bits of a code whose weights are looked at.
pub const BITS: usize = 6;

impl SetPrediction {
    /// After noise was filtered, from the variance before: what pixels have of their own follows their variance.
    pub(crate) fn follow(&mut self, before: f64) {
        let by = if before > 0.0 { self.covariance(0, 0) / before } else { 1.0 };
        self.pixels_follow(by);
    }

    /// What is known of single pixels, where their variance is multiplied by `by`.
    fn pixels_follow(&mut self, by: f64) {
        self.unsure_var *= by;
        for fourth_power in [&mut self.unequal, &mut self.fourth, &mut self.unsure] {
            *fourth_power *= by * by;
        }
    }

    /// Clipping leaves the share `less` of the variance.
    pub(crate) fn cut(&mut self, less: f64, left: &Clipped) {
        self.pixels_follow(less);
        self.unequal += left.unequal;
        self.fourth += left.fourth;
        // The pixels' places are known as a few shares.
        self.unsure = libm::hypot(self.unsure, 0.3 * left.unequal);
        self.unsure_mean = libm::hypot(self.unsure_mean, 0.1 * left.lost * (1.0 - left.above));
    }

    /// Covariance at a lag of noise within a frame, DN^2: the frame's own mean is not taken off.
    pub fn covariance(&self, dy: i32, dx: i32) -> f64 {
        let row = if dy == 0 { self.row } else { 0.0 };
        let column = if dx == 0 { self.column } else { 0.0 };
        let line = |&(v, px, py): &(f64, f64, f64)| v * libm::cos(px * f64::from(dx) + py * f64::from(dy));
        let lines: f64 = self.lines.iter().map(line).sum();
        self.shot.lag(dy, dx) + self.read.lag(dy, dx) + row + column + lines
    }

    /// Variance of a frame's mean over rows x columns pixels, the common part included.
    pub fn frame_mean_var(&self, (rows, columns): (usize, usize)) -> f64 {
        let pixels = (rows * columns) as f64;
        (self.shot.of_mean() + self.read.of_mean()) / pixels
            + self.row / rows as f64
            + self.column / columns as f64
            + self.common
    }
}

impl Prediction {
    /// Light and dark charge of every frame and set, no noise yet.
    pub(crate) fn begin(c: &Campaign, base: &BaseParameters) -> Self {
        let signal = |s: &SetInfo| {
            let light = s.light.map_or(0.0, |l| base.flux_e_per_s.get(l).copied().unwrap_or(0.0));
            (light + base.dark_e_per_s) * s.exposure_s
        };
        let of_sets: Vec<f64> = c.sets.iter().map(signal).collect();
        let set = |&signal: &f64| SetPrediction {
            signal,
            shot: Spectrum::white(0.0),
            read: Spectrum::white(0.0),
            row: 0.0,
            column: 0.0,
            common: 0.0,
            shot_memory: Vec::new(),
            read_memory: Vec::new(),
            unequal: 0.0,
            fourth: 0.0,
            unsure: 0.0,
            unsure_var: 0.0,
            unsure_mean: 0.0,
            lines: Vec::new(),
            growth: (0.0, 0.0),
            parity: (0.0, 0.0),
        };
        Self {
            frame_signal: c.frames.iter().map(|f| of_sets.get(f.set).copied().unwrap_or(0.0)).collect(),
            sets: of_sets.iter().map(set).collect(),
            base: base.clone(),
            bit_errors_dn: [0.0; BITS],
            code_step_dn: 1.0,
            taps: [(0.0, 0.0); 4],
            smear_s: 0.0,
            bloom_e: f64::INFINITY,
        }
    }

    /// Rounds to whole steps.
    pub(crate) fn quantize(&mut self, c: &Campaign) {
        let step = self.code_step_dn;
        let square = step * step;
        let mut shifts = vec![0.0; self.sets.len()];
        for (i, s) in self.sets.iter_mut().enumerate() {
            let variance = s.covariance(0, 0) / square;
            let spread = c.sets.get(i).map_or(0.0, |s| s.spread_dn) / step;
            let level = (s.signal + self.base.offset_dn) / step;
            let rounded = rounded(level, spread, variance);
            shifts[i] = step * rounded.mean;
            // What pixels or frames share comes through with the slope; what each has of its own, with the whole of its variance.
            let through = rounded.slope * rounded.slope;
            for power in [&mut s.shot, &mut s.read] {
                let own = power.lag(0, 0);
                power.0.iter_mut().for_each(|p| *p = own + through * (*p - own));
            }
            let mut kept = 0.0;
            for shared in [&mut s.row, &mut s.column].into_iter().chain(s.lines.iter_mut().map(|l| &mut l.0))
            {
                kept += *shared * (1.0 - through);
                *shared *= through;
            }
            s.common *= through;
            s.read.0.iter_mut().for_each(|p| *p += kept + square * rounded.variance);
            s.unequal += square * square * rounded.unequal;
            s.fourth += square * square * rounded.fourth;
        }
        for (m, frame) in self.frame_signal.iter_mut().zip(&c.frames) {
            *m += shifts.get(frame.set).copied().unwrap_or(0.0);
        }
    }

    /// Applies a curve to the mean of every frame and set, with the square of its slope to all noise.
    pub fn bend(&mut self, curve: impl Fn(f64) -> f64) {
        self.frame_signal.iter_mut().for_each(|s| *s = curve(*s));
        for s in &mut self.sets {
            let step = 1e-4 * s.signal.abs().max(1e-3);
            let slope = (curve(s.signal + step) - curve(s.signal - step)) / (2.0 * step);
            let square = slope * slope;
            s.signal = curve(s.signal);
            s.unsure_mean *= slope.abs();
            s.shot.scale(square);
            s.read.scale(square);
            s.row *= square;
            s.column *= square;
            s.common *= square;
            s.pixels_follow(square);
        }
    }
}
