//! Expected statistics of a whole campaign: what every model must say before it is compared with measurements.

use crate::clipping::Clipped;
use crate::normal::upper;
use crate::quantize::{NODES, reaches_zero, rounded, rounded_from_zero, rounded_unlike};

pub use crate::normal::{NORMAL, PLACES};
pub use crate::spectrum::{Filter, GRID, HALF, LAGS, LineNoise, Ripple, Spectrum, angle, cosine_power};

/// A frame of a campaign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameInfo {
    /// Place of its set in [`Campaign::sets`].
    pub set: usize,
    /// Start of its exposure, s from the start of the campaign.
    pub time_s: f64,
    /// It follows frames of its own level that are not here: the first of a campaign that was joined to another.
    pub settled: bool,
}

/// A set of frames: darks or flats of one exposure and light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SetInfo {
    /// Exposure, s.
    pub exposure_s: f64,
    /// Electrons per pixel and second from the light, by which lamp level; `None`: dark.
    pub light: Option<usize>,
    /// Light relative to the campaign's unit.
    pub illumination: f64,
    /// Light of this set over that of its lamp level: 1 where every level has a light of its own.
    pub light_ratio: f64,
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
    /// Whether levels count from code 0; of tables the level without light was taken off.
    pub from_code_0: bool,
    /// Usual time from the end of a frame to the end of the next, s.
    pub frame_s: f64,
    /// The strongest line that the noise's spectrum has in read-out order, cycles per pixel.
    pub line_cycles_per_px: Option<f64>,
    /// Noise of the ordinary pixels in darks, where darks show it.
    pub ordinary: Option<Ordinary>,
}

/// Dark noise of the pixels without the few that are far noisier than the others, before rounding.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ordinary {
    /// Mean of their variances, DN^2.
    pub variance_dn2: f64,
    /// Variance of their variances over the square of their mean.
    pub spread: f64,
}

impl Ordinary {
    /// Ordinary pixels of darks, from the median of the pixels' variances (DN^2), the standard deviation of the
    /// logarithm of their noise, and the mean level and spread of the darks (DN).
    ///
    /// Rounding adds 1/12 where the noise is a code or more; below that it follows the place between two codes
    /// (Widrow and Kollar 2008, ch. 4), and is taken off as it is at the level of these darks. Variances are
    /// log-normal (Johnson, Kotz and Balakrishnan 1994, ch. 14).
    pub fn of_darks(median_dn2: f64, log_spread: f64, level_dn: f64, spread_dn: f64) -> Self {
        let shown = |variance: f64| {
            // The level is measured once it is rounded.
            let mut level = level_dn;
            for _ in 0..LEVEL_ROUNDS {
                level = level_dn - rounded(level, spread_dn, variance).mean;
            }
            let r = rounded(level, spread_dn, variance);
            (variance + r.variance, r.unequal)
        };
        let (mut low, mut high) = (LEAST_VARIANCE, median_dn2.max(LEAST_VARIANCE));
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if shown(middle).0 < median_dn2 { low = middle } else { high = middle }
        }
        let (median, (at, unequal)) = (high, shown(high));
        let slope = ((shown(1.05 * median).0 - at) / (0.05 * median)).max(0.1);
        let square = (4.0 * log_spread * log_spread - unequal / (at * at).max(f64::MIN_POSITIVE)).max(0.0)
            * (at / (slope * median)).powi(2);
        let square = square.min(LARGEST_SPREAD);
        Self { variance_dn2: median * libm::exp(0.5 * square), spread: libm::expm1(square) }
    }

    /// Variance of their noise and its spread over the pixels, where all pixels have this variance and this part
    /// of it is read noise, in squares of the code's step.
    fn of(self, variance: f64, read: f64, step: f64) -> (f64, f64) {
        let dark = (self.variance_dn2 / (step * step)).clamp(0.1 * read, read);
        let own = variance - read + dark;
        (own, self.spread * (dark / own.max(1e-12)).powi(2))
    }
}

/// Rounds after which a level before rounding is known to a hundredth of a code.
const LEVEL_ROUNDS: usize = 5;
/// Minimum variance that is told from none, DN^2 (a named choice: a tenth of a code).
const LEAST_VARIANCE: f64 = 0.01;
/// Maximum variance of the logarithm of the pixels' variances (a named choice: a factor of two in noise either
/// way).
const LARGEST_SPREAD: f64 = 2.0;

/// Maximum noise variance, codes squared, at which the spread of levels is corrected for rounding. The slope of
/// a rounded level differs from 1 by at most 2 exp(-2 pi^2 variance) (Widrow and Kollar 2008, ch. 4).
const LEAVES_SPREAD: f64 = 0.2;

/// Spread of the pixels' levels before rounding, from the spread of their measured means, in steps. Close to
/// the edge between two codes little noise makes small differences large.
fn before_rounding(level: f64, measured: f64, variance: f64) -> f64 {
    if variance > LEAVES_SPREAD {
        return measured;
    }
    (0..SPREAD_ROUNDS).fold(measured, |spread, _| measured / rounded(level, spread, variance).slope.max(1.0))
}

/// Rounds after which the spread is known to some per cent.
const SPREAD_ROUNDS: usize = 6;

/// The paper's parameters as a campaign sees them.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseParameters {
    /// A, DN/e.
    pub gain_dn_per_e: f64,
    /// Read noise, root mean square over the pixels, e.
    pub read_noise_e: f64,
    /// Spread of the read noise over the pixels: variance of the pixels' read-noise variances over the square of
    /// their mean; 0 for pixels that are alike.
    pub read_noise_spread: f64,
    /// Black level at zero exposure, DN.
    pub offset_dn: f64,
    /// Dark current, e/s.
    pub dark_e_per_s: f64,
    /// Light of each lamp level, e/s.
    pub flux_e_per_s: Vec<f64>,
    /// Signal of the frames before the first, e, for effects with memory; `None`: nothing was exposed.
    pub past_e: Option<f64>,
    /// Relative scatter of the light from setting to setting that is expected of it; `None`: every setting is
    /// what is stated.
    pub setting_rel: Option<f64>,
    /// The light monitor, where there is one.
    pub monitor: Option<Monitor>,
    /// Cut of noise below code 0, as a converter makes it. False where a diagnosis asks for a black level that is
    /// too low: only black-clipping brings the cut then.
    pub cut_at_0: bool,
}

/// A light monitor beside the camera.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Monitor {
    /// Logarithm of its reading for one electron of light.
    pub ln_per_e: f64,
    /// Relative scatter of its readings.
    pub rel: f64,
}

impl BaseParameters {
    /// Electrons per pixel and second that light brings to a set.
    pub fn rate_e_per_s(&self, set: &SetInfo) -> f64 {
        set.light.and_then(|l| self.flux_e_per_s.get(l)).copied().unwrap_or(0.0) * set.light_ratio
    }
}

/// Pixels that jump between two levels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TwoLevels {
    /// Their share.
    pub share: f64,
    /// Variance of the jumps, the mean over these pixels, e^2, then DN^2.
    pub variance: f64,
    /// Variance, over all pixels, of the variance of the jumps, e^4, then DN^4.
    pub spread: f64,
    /// Correlation of a pixel's level with that of the next frame.
    pub stays: f64,
    /// The amplitudes have an exponential distribution over these pixels; else they are all the same.
    pub differ: bool,
}

/// Expected statistics of one set.
///
/// What acts on the whole image acts through one operation on all parts of it: [`gain`](Self::gain), [`filter`](Self::filter),
/// [`mix_in_time`](Self::mix_in_time).
#[derive(Debug, Clone, PartialEq)]
pub struct SetPrediction {
    /// Mean signal of the settled frames, e before the amplifier, DN above zero after it.
    pub signal: f64,
    /// Power of the shot noise, e^2, then DN^2.
    pub shot: Spectrum,
    /// Power of the noise added at read-out, e^2, then DN^2.
    pub read: Spectrum,
    /// Noise common to the pixels of a row, from row to row.
    pub row: LineNoise,
    /// Noise common to the pixels of a column, from column to column.
    pub column: LineNoise,
    /// What changes slowly from row to row within a frame: variance and how.
    pub ripples: Vec<(f64, Ripple)>,
    /// Variance common to the pixels of a frame.
    pub common: f64,
    /// The part of it that follows the light of each pixel: where the field is dark it is less.
    pub with_light: f64,
    /// Variance common to all frames of the set, against other sets.
    pub setting: f64,
    /// Correlation of the noise with that of the frame 1, 2, ... later: of shot noise, of read noise.
    pub shot_memory: Vec<f64>,
    /// See `shot_memory`.
    pub read_memory: Vec<f64>,
    /// Variance, from pixel to pixel, of their noise's variance, e^4, then DN^4 (0 for pixels that are alike).
    pub unequal: f64,
    /// Fourth cumulant of the pixels' noise, the mean over all of them, e^4, then DN^4 (0 for normal noise).
    pub fourth: f64,
    /// Fourth cumulants of a pixel's noise in two successive frames, DN^4: three of the later and one of the earlier, two of each, one and
    /// three; the mean over all pixels.
    pub fourth_next: [f64; 3],
    /// Pixels that jump between two levels.
    pub two_levels: TwoLevels,
    /// Model uncertainty of `unequal`, e^4, then DN^4.
    pub unsure: f64,
    /// Model uncertainty of variance and covariances, e^2, then DN^2.
    pub unsure_var: f64,
    /// Model uncertainty of the variance alone, beside that: what single pixels have of their own, e^2, then DN^2.
    pub unsure_own: f64,
    /// Model uncertainty of the variance while the level still moves, e^2, then DN^2.
    pub unsure_moving: f64,
    /// What the mean of the pixels' fourth cumulants may be off by, DN^4.
    pub unsure_fourth: f64,
    /// Model uncertainty of the mean of the first frame of a set, DN.
    pub unsure_first: f64,
    /// Share of the samples that are moved by whole codes after conversion.
    pub moved: f64,
    /// Model uncertainty of the mean, e, then DN.
    pub unsure_mean: f64,
    /// What a pixel's mean may deviate by from an offset and a gain of its own, one standard deviation, e, then DN.
    pub uneven: f64,
    /// Lines in the spectrum: (variance, phase from column to column, phase from row to row), radians.
    pub lines: Vec<(f64, f64, f64)>,
    /// Change of the neighbour covariances per unit of distance from the output, as a share of the shot variance: along rows,
    /// along columns, over the whole sensor.
    pub growth: (f64, f64),
    /// Covariance with the next column from odd columns less that from even ones; with the next row alike.
    pub parity: (f64, f64),
    /// Share of the codes around the level that occur.
    pub codes_used: f64,
    /// Step of the codes around the level, DN: of a table whose steps grow.
    pub step_dn: f64,
}

/// Everything that is expected.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Mean of every frame: e before the amplifier, DN (with the offset) at the end.
    pub frame_signal: Vec<f64>,
    /// Statistics of every set.
    pub sets: Vec<SetPrediction>,
    /// Light of every set's settled frames as a monitor beside the camera sees it, e.
    pub light_e: Vec<f64>,
    /// Base parameters in force.
    pub base: BaseParameters,
    /// What the weight of each bit is too large by, DN.
    pub bit_errors_dn: [f64; BITS],
    /// Distance of successive codes, DN.
    pub code_step_dn: f64,
    /// A code from which all others are whole numbers of steps away, DN.
    pub code_zero_dn: f64,
    /// Whether firmware has handed on whole codes already.
    pub whole: bool,
    /// Nothing lies below this level, DN above the black level.
    pub floor_dn: f64,
    /// Cut of noise below code 0.
    pub cut_at_0: bool,
    /// Gain of the right half over the left, minus 1, and its offset, DN; of the lower half over the upper; of odd columns over even
    /// ones; of odd rows.
    pub taps: [(f64, f64); 4],
    /// Light collected while charge is moved through the image, s of exposure.
    pub smear_s: f64,
    /// From this charge on a pixel spills into its column, e.
    pub bloom_e: f64,
    /// No pixel holds more than this charge, e.
    pub well_e: f64,
}

/// Bits of a code at most.
pub const BITS: usize = 16;

impl SetPrediction {
    fn new(signal: f64) -> Self {
        Self {
            signal,
            shot: Spectrum::white(0.0),
            read: Spectrum::white(0.0),
            row: LineNoise::default(),
            column: LineNoise::default(),
            ripples: Vec::new(),
            common: 0.0,
            with_light: 0.0,
            setting: 0.0,
            shot_memory: Vec::new(),
            read_memory: Vec::new(),
            unequal: 0.0,
            fourth: 0.0,
            fourth_next: [0.0; 3],
            two_levels: TwoLevels::default(),
            unsure: 0.0,
            unsure_var: 0.0,
            unsure_own: 0.0,
            unsure_moving: 0.0,
            unsure_fourth: 0.0,
            unsure_first: 0.0,
            moved: 0.0,
            unsure_mean: 0.0,
            uneven: 0.0,
            lines: Vec::new(),
            growth: (0.0, 0.0),
            parity: (0.0, 0.0),
            codes_used: 1.0,
            step_dn: 1.0,
        }
    }

    /// Multiplies the image about its mean: all noise by the square.
    pub fn gain(&mut self, by: f64) {
        self.scale(by * by);
    }

    /// Multiplies every variance.
    pub(crate) fn scale(&mut self, square: f64) {
        self.shot.scale(square);
        self.read.scale(square);
        self.shared(square);
        self.setting *= square;
        self.unsure_mean *= square.abs().sqrt();
        self.uneven *= square.abs().sqrt();
        self.pixels_follow(square);
    }

    /// Multiplies the variance of what pixels, rows, columns and frames share from frame to frame.
    fn shared(&mut self, square: f64) {
        self.row.scale(square);
        self.column.scale(square);
        self.common *= square;
        self.with_light *= square;
        self.lines.iter_mut().for_each(|l| l.0 *= square);
        self.ripples.iter_mut().for_each(|r| r.0 *= square);
        self.parity = (self.parity.0 * square, self.parity.1 * square);
    }

    /// Filters the image.
    pub fn filter(&mut self, filter: &Filter<'_>) {
        let before = self.pixels();
        filter.apply(&mut self.shot);
        filter.apply(&mut self.read);
        filter.apply_to_rows(&mut self.row);
        filter.apply_to_columns(&mut self.column);
        self.common *= filter.of_mean();
        self.with_light *= filter.of_mean();
        self.setting *= filter.of_mean();
        self.lines.iter_mut().for_each(|(v, px, py)| *v *= filter.at(*py, *px));
        for (v, ripple) in &mut self.ripples {
            *v *= match ripple {
                Ripple::Sine(cycles) => filter.at(std::f64::consts::TAU * *cycles, 0.0),
                Ripple::Wander(_) => filter.of_mean(),
            };
        }
        self.follow(before);
        // Each new pixel is a weighted sum of several, which are more alike and closer to normal than single
        // ones.
        self.unequal *= filter.of_single();
        self.fourth *= filter.of_single();
    }

    /// Mixes each frame with those before it: all noise is multiplied by `less` and correlated in time by `memory`.
    pub fn mix_in_time(&mut self, less: f64, memory: &[f64]) {
        let setting = self.setting;
        self.scale(less);
        // What all frames of a set share stays.
        self.setting = setting;
        (self.shot_memory, self.read_memory) = (memory.to_vec(), memory.to_vec());
    }

    /// Variance of what single pixels have of their own.
    pub(crate) fn pixels(&self) -> f64 {
        self.shot.lag(0, 0) + self.read.lag(0, 0)
    }

    /// After noise was filtered, from the variance before: what is known of single pixels follows their variance.
    pub(crate) fn follow(&mut self, before: f64) {
        let by = if before > 0.0 { self.pixels() / before } else { 1.0 };
        self.pixels_follow(by);
    }

    /// What is known of single pixels, where their variance is multiplied by `by`.
    fn pixels_follow(&mut self, by: f64) {
        self.unsure_var *= by;
        self.unsure_own *= by;
        self.unsure_moving *= by;
        self.two_levels.variance *= by;
        self.two_levels.spread *= by * by;
        let powers = [&mut self.unequal, &mut self.fourth, &mut self.unsure, &mut self.unsure_fourth];
        powers.into_iter().chain(&mut self.fourth_next).for_each(|power| *power *= by * by);
    }

    /// Clipping leaves the share `less` of the variance.
    pub(crate) fn cut(&mut self, less: f64, left: &Clipped) {
        self.pixels_follow(less);
        self.unequal += left.unequal;
        self.fourth += left.fourth;
        // The pixels' places are known as a few shares; where nearly all are clipped, next to nothing of the few that are not.
        self.unsure = libm::hypot(self.unsure, (0.3 + 0.7 * left.above * left.above) * left.unequal);
        self.unsure_mean = libm::hypot(self.unsure_mean, 0.1 * left.lost * (1.0 - left.above));
        // Pixels on both sides of the limit: no more than what is cut off.
        self.uneven = libm::hypot(self.uneven, left.lost * (1.0 - left.above));
    }

    /// Variance of shot noise over the signal: 1 until neighbours share charge.
    pub(crate) fn shot_over_signal(&self) -> f64 {
        if self.signal > 0.0 { self.shot.lag(0, 0) / self.signal } else { 1.0 }
    }

    /// Shot noise, of whose variance clipping leaves the share `less`, with a share `above` of the pixels at the limit: what two pixels share
    /// is left where neither is, to first order in their correlation.
    pub(crate) fn cut_shot(&mut self, less: f64, above: f64) {
        let both = (1.0 - above) * (1.0 - above);
        let own = (less - both) * self.shot.lag(0, 0);
        self.shot.scale(both);
        self.shot.add_white(own);
    }

    /// A curve that charge follows, before read noise: of the variance of shot noise it leaves the share `less`.
    /// `at`: what becomes of the mean level; `bent`: of the levels at the pixels' places.
    pub(crate) fn bend_shot(
        &mut self,
        less: f64,
        left: &Clipped,
        at: f64,
        places: &[f64; PLACES.len()],
        bent: &[f64; PLACES.len()],
    ) {
        self.cut_shot(less, left.above);
        self.cut_light(left.above);
        self.pixels_follow(less);
        self.unequal += left.unequal;
        self.fourth += left.fourth;
        // The field's part in a bend is known from a few places only.
        self.unsure_mean = libm::hypot(self.unsure_mean, OF_PLACES * (left.mean - at).abs());
        self.uneven = libm::hypot(self.uneven, off_a_line(places, bent));
        self.signal = left.mean;
    }

    /// What light shares from pixel to pixel, where the share `above` of the pixels no longer follows it: the mean of what is clipped has that
    /// slope less than 1.
    pub(crate) fn cut_light(&mut self, above: f64) {
        let square = (1.0 - above) * (1.0 - above);
        self.common *= square;
        self.with_light *= square;
        self.setting *= square;
        self.ripples.iter_mut().for_each(|r| r.0 *= square);
    }

    /// All noise of a clipped image: shared noise is lost where pixels are clipped.
    pub(crate) fn cut_all(&mut self, less: f64, left: &Clipped) {
        self.cut(less, left);
        self.shot.scale(less);
        self.read.scale(less);
        self.shared(less);
        self.setting *= less;
    }

    /// Covariance at a lag of noise within a frame, DN^2: the frame's own mean is not taken off.
    pub fn covariance(&self, dy: i32, dx: i32) -> f64 {
        let line = |&(v, px, py): &(f64, f64, f64)| v * libm::cos(px * f64::from(dx) + py * f64::from(dy));
        let lines: f64 = self.lines.iter().map(line).sum();
        self.shot.lag(dy, dx)
            + self.read.lag(dy, dx)
            + self.row.lag(dy)
            + self.column.lag(dx)
            + self.ripple(f64::from(dy))
            + lines
    }

    /// Covariance of rows this far apart that light has which changes from row to row.
    pub fn ripple(&self, rows: f64) -> f64 {
        self.ripples.iter().map(|(v, ripple)| v * ripple.correlation(rows)).sum()
    }

    /// The same over that of a row with itself; 0 where there is none.
    pub fn ripple_correlation(&self, rows: f64) -> f64 {
        let all = self.ripple(0.0);
        if all > 0.0 { self.ripple(rows) / all } else { 0.0 }
    }

    /// Covariance of what changes slowly down the rows, in the first `to` of so many rows, with its mean over all of them.
    pub fn ripple_with_mean(&self, to: usize, rows: usize) -> f64 {
        self.ripples.iter().map(|(v, r)| v * r.with_mean(to as f64, rows as f64)).sum()
    }

    /// Mean over pairs of pixels of the square of the covariance that normal noise of lines and bands gives
    /// them, DN^4.
    pub fn shared_squares(&self, rows: usize, columns: usize) -> f64 {
        let height = rows as f64;
        let wander = |(v, ripple): &(f64, Ripple)| match *ripple {
            Ripple::Sine(_) => 0.0,
            Ripple::Wander(next) => v * v * Ripple::Wander(next * next).with_mean(height, height),
        };
        self.ripples.iter().map(wander).sum::<f64>()
            + self.row.lag(0).powi(2) / height
            + self.column.lag(0).powi(2) / columns as f64
    }

    /// Sines of one random phase a frame: the variance of each, DN^2, and the mean over pairs of pixels of
    /// the cosine of twice the phase between them.
    pub fn sines(&self, rows: usize) -> impl Iterator<Item = (f64, f64)> {
        let height = rows as f64;
        let down = self.ripples.iter().filter_map(move |(v, ripple)| match *ripple {
            Ripple::Sine(cycles) => Some((*v, Ripple::Sine(2.0 * cycles).with_mean(height, height))),
            Ripple::Wander(_) => None,
        });
        down.chain(self.lines.iter().map(|l| (l.0, 0.0)))
    }

    /// Variance of a frame's mean over rows x columns pixels by what pixels and lines have of their own.
    pub fn of_frame_mean(&self, (rows, columns): (usize, usize), pixels: f64) -> f64 {
        (self.shot.of_mean() + self.read.of_mean()) / pixels
            + self.row.of_mean() / rows as f64
            + self.column.of_mean() / columns as f64
    }
}

/// Relative error of a curve averaged over a few places of the field (a named choice: the field of shading is
/// not normal).
const OF_PLACES: f64 = 0.1;

/// Deviation of a rounded mean from the level, in steps, for noise of this variance in squares of the step: the first term of the
/// characteristic function, as a root mean square over all levels (Widrow and Kollar 2008, ch. 4).
pub(crate) fn quantised_mean(variance: f64) -> f64 {
    let square = std::f64::consts::PI * std::f64::consts::PI;
    libm::exp(-2.0 * square * variance.max(0.0)) / (std::f64::consts::PI * std::f64::consts::SQRT_2)
}

/// Root mean square of what is left of values at [`PLACES`] beside a straight line.
fn off_a_line(places: &[f64; PLACES.len()], values: &[f64]) -> f64 {
    let all = || places.iter().zip(PLACES).zip(values);
    let mean = |of: &dyn Fn(f64, f64) -> f64| all().map(|((x, share), v)| share * of(*x, *v)).sum::<f64>();
    let (mx, mv) = (mean(&|x, _| x), mean(&|_, v| v));
    let xx = mean(&|x, _| (x - mx) * (x - mx));
    let slope = if xx > 0.0 { mean(&|x, v| (x - mx) * (v - mv)) / xx } else { 0.0 };
    libm::sqrt(mean(&|x, v| (v - mv - slope * (x - mx)).powi(2)))
}

impl Prediction {
    /// Whether the camera is expected to do the same to every set, whatever light each has.
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

    /// Whether a set has the same light and the same statistics, its frames' means aside.
    pub fn has_set_of(&self, other: &Self, set: usize) -> bool {
        self.light_e.get(set) == other.light_e.get(set) && self.sets.get(set) == other.sets.get(set)
    }

    /// Light and dark charge of every frame and set, no noise yet.
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
        // Of steps between several kinds of parts the largest.
        let apart = |signal: f64| {
            let steps = taps.map(|(gain, offset)| gain * signal + offset);
            steps.into_iter().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a })
        };
        let may_be_clipped = c.from_code_0 && self.cut_at_0 && self.base.offset_dn + self.floor_dn < 0.0;
        for (i, s) in self.sets.iter_mut().enumerate() {
            let variance = s.covariance(0, 0) / square;
            let unlike = s.unequal.max(0.0) / (square * variance * square * variance).max(f64::MIN_POSITIVE);
            // A few noisy pixels make the spread large, and leave the rounding of the others as it is.
            let (own, unlike) = match c.ordinary {
                Some(ordinary) => {
                    ordinary.of(variance, (s.read.lag(0, 0) / square).min(variance).max(0.0), step)
                }
                None => (variance, unlike),
            };
            let (spread, places) = c.sets.get(i).map_or((0.0, &NORMAL), |s| (s.spread_dn / step, &s.places));
            let level = (s.signal + self.base.offset_dn - self.code_zero_dn) / step;
            let rounded = if may_be_clipped && reaches_zero(level, spread, places, variance) {
                // Levels are measured once they are clipped: before, they lie further apart, by the share of the pixels that is not clipped.
                let slope = upper(-level / libm::sqrt(variance + spread * spread).max(0.02));
                let found = rounded_from_zero(level, spread / slope.clamp(0.3, 1.0), places, variance);
                // The pixels' places are known as a few shares.
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
            // What pixels or frames share comes through with the slope; what each has of its own, with the whole of its variance.
            let through = rounded.slope * rounded.slope;
            let mut kept = 0.0;
            if through != 1.0 {
                for power in [&mut s.shot, &mut s.read] {
                    let own = power.lag(0, 0);
                    power.scale(through);
                    power.add_white((1.0 - through) * own);
                }
                let lines: f64 = s.lines.iter().map(|l| l.0).sum();
                kept = (1.0 - through) * (s.row.lag(0) + s.column.lag(0) + s.ripple(0.0) + lines);
                s.shared(through);
            }
            s.read.add_white(kept + square * rounded.variance);
            s.unequal += square * square * rounded.unequal;
            s.fourth += square * square * rounded.fourth;
            s.signal += shifts[i];
        }
        for (m, frame) in self.frame_signal.iter_mut().zip(&c.frames) {
            *m += shifts.get(frame.set).copied().unwrap_or(0.0);
        }
    }

    /// Multiplies the image by a number: the amplifier.
    pub(crate) fn amplify(&mut self, gain: f64) {
        self.frame_signal.iter_mut().for_each(|s| *s *= gain);
        for s in &mut self.sets {
            s.signal *= gain;
            s.gain(gain);
        }
    }

    /// Applies a curve to every pixel: to the noise of each with the slope that the noise itself sees, and over the pixels' places.
    pub fn bend(&mut self, c: &Campaign, curve: impl Fn(f64) -> f64) {
        let before: Vec<f64> = self.sets.iter().map(|s| s.signal).collect();
        let noise: Vec<f64> = self.sets.iter().map(|s| libm::sqrt(s.covariance(0, 0).max(1e-6))).collect();
        // Mean, and variance over that before, of a pixel at a level.
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
            // The field's part in a bend is known from a few places only.
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

    /// Pixels of 0.02 codes of spread and 0.06 codes of noise, next to the edge between two codes and far from it. Their
    /// rounded means are known from the error function; the spread is found to a tenth where rounding enlarges it, and
    /// is at most as measured elsewhere.
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
