//! Expected moments of one set, and their change by effects and rounding.

use super::{Fields, Filter, LineNoise, OF_PLACES, PLACES, Ripple, Spectrum, off_a_line};
use crate::clipping::Clipped;

/// Pixels that jump between two levels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TwoLevels {
    /// Share of these pixels.
    pub share: f64,
    /// Variance of the jumps, the mean over these pixels, e^2, then DN^2.
    pub variance: f64,
    /// Variance, over all pixels, of the variance of the jumps, e^4, then DN^4.
    pub spread: f64,
    /// Correlation of a pixel's level with that of the next frame.
    pub stays: f64,
    /// True if the amplitudes have an exponential distribution over these pixels; else they are all the same.
    pub differ: bool,
}

/// Expected statistics of one set.
///
/// Operations on the whole image act on all its parts: [`gain`](Self::gain), [`filter`](Self::filter),
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
    /// Slow changes from row to row within a frame: variance and spectrum.
    pub ripples: Vec<(f64, Ripple)>,
    /// Field shapes that are drawn anew for every frame.
    pub fields: Fields,
    /// Variance common to the pixels of a frame.
    pub common: f64,
    /// Part of `common` that follows the light of each pixel: less where the field is dark.
    pub with_light: f64,
    /// Variance common to all frames of the set, relative to other sets.
    pub setting: f64,
    /// Correlation of the shot noise with that of the frame 1, 2, ... later.
    pub shot_memory: Vec<f64>,
    /// Correlation of the read noise with that of the frame 1, 2, ... later.
    pub read_memory: Vec<f64>,
    /// Pixel-to-pixel variance of the noise variance, e^4, then DN^4 (0 for pixels that are alike).
    pub unequal: f64,
    /// Mean over the pixels of the fourth cumulant of their noise, e^4, then DN^4 (0 for normal noise).
    pub fourth: f64,
    /// Mean over the pixels of the fourth cumulants of their noise in two successive frames, DN^4: three of
    /// the later and one of the earlier, two of each, one and three.
    pub fourth_next: [f64; 3],
    /// Pixels that jump between two levels.
    pub two_levels: TwoLevels,
    /// Model uncertainty of `unequal`, e^4, then DN^4.
    pub unsure: f64,
    /// Model uncertainty of variance and covariances, e^2, then DN^2.
    pub unsure_var: f64,
    /// Model uncertainty of the variance alone, beside `unsure_var`: of the pixels' own noise, e^2, then
    /// DN^2.
    pub unsure_own: f64,
    /// Model uncertainty of the variance while the level still changes, e^2, then DN^2.
    pub unsure_moving: f64,
    /// Standard error of the mean of the pixels' fourth cumulants, DN^4.
    pub unsure_fourth: f64,
    /// Model uncertainty of the mean of the first frame of a set, DN.
    pub unsure_first: f64,
    /// Share of the samples that are changed by whole codes after conversion.
    pub moved: f64,
    /// Model uncertainty of the mean, e, then DN.
    pub unsure_mean: f64,
    /// RMS residual of a pixel's mean from its own straight line (offset and gain), e, then DN.
    pub uneven: f64,
    /// Lines in the spectrum: (variance, phase from column to column, phase from row to row), radians.
    pub lines: Vec<(f64, f64, f64)>,
    /// Change of the neighbour covariances per unit of distance from the output, as a share of the shot
    /// variance: along rows, along columns, over the whole sensor.
    pub growth: (f64, f64),
    /// Covariance with the next column starting at odd columns minus that at even ones; the same for rows.
    pub parity: (f64, f64),
    /// Covariance along the diagonal up to the right minus that along the other.
    pub uphill: f64,
    /// Share of the codes around the level that occur.
    pub codes_used: f64,
    /// Step of the codes around the level, DN, for a table whose steps grow.
    pub step_dn: f64,
}

impl SetPrediction {
    pub(super) fn new(signal: f64) -> Self {
        Self {
            signal,
            shot: Spectrum::white(0.0),
            read: Spectrum::white(0.0),
            row: LineNoise::default(),
            column: LineNoise::default(),
            ripples: Vec::new(),
            fields: Fields::default(),
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
            uphill: 0.0,
            codes_used: 1.0,
            step_dn: 1.0,
        }
    }

    /// Multiplies the image about its mean by a gain: all variances by its square.
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

    /// Multiplies the variance of noise that pixels, rows, columns and frames share and that changes from
    /// frame to frame.
    pub(super) fn shared(&mut self, square: f64) {
        self.row.scale(square);
        self.column.scale(square);
        self.fields.scale(square);
        self.common *= square;
        self.with_light *= square;
        self.lines.iter_mut().for_each(|l| l.0 *= square);
        self.ripples.iter_mut().for_each(|r| r.0 *= square);
        self.parity = (self.parity.0 * square, self.parity.1 * square);
        self.uphill *= square;
    }

    /// Filters the image.
    pub fn filter(&mut self, filter: &Filter<'_>) {
        let before = self.pixels();
        filter.apply(&mut self.shot);
        filter.apply(&mut self.read);
        filter.apply_to_rows(&mut self.row);
        filter.apply_to_columns(&mut self.column);
        self.fields.scale(filter.of_mean());
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
        // Each new pixel is a weighted sum of several pixels. Such sums are more alike and closer to normal
        // than single pixels.
        self.unequal *= filter.of_single();
        self.fourth *= filter.of_single();
    }

    /// Mixes each frame with those before it: all noise is multiplied by `less` and correlated in time by
    /// `memory`.
    pub fn mix_in_time(&mut self, less: f64, memory: &[f64]) {
        let setting = self.setting;
        self.scale(less);
        // Noise that all frames of a set share stays.
        self.setting = setting;
        (self.shot_memory, self.read_memory) = (memory.to_vec(), memory.to_vec());
    }

    /// Adds noise of rounding, which is white and differs from frame to frame: the read noise then has less
    /// in common with that of other frames.
    pub(crate) fn add_rounding(&mut self, variance: f64) {
        let before = self.read.lag(0, 0);
        self.read.add_white(variance);
        let share = before / self.read.lag(0, 0).max(f64::MIN_POSITIVE);
        self.read_memory.iter_mut().for_each(|r| *r *= share.clamp(0.0, 1.0));
    }

    /// Returns the variance of the pixels' own noise.
    pub(crate) fn pixels(&self) -> f64 {
        self.shot.lag(0, 0) + self.read.lag(0, 0)
    }

    /// Scales the statistics of single pixels by the change of their variance through a filter; `before` is
    /// the variance before it.
    pub(crate) fn follow(&mut self, before: f64) {
        let by = if before > 0.0 { self.pixels() / before } else { 1.0 };
        self.pixels_follow(by);
    }

    /// Scales the statistics of single pixels if their variance is multiplied by `by`.
    pub(super) fn pixels_follow(&mut self, by: f64) {
        self.unsure_var *= by;
        self.unsure_own *= by;
        self.unsure_moving *= by;
        self.two_levels.variance *= by;
        self.two_levels.spread *= by * by;
        let powers = [&mut self.unequal, &mut self.fourth, &mut self.unsure, &mut self.unsure_fourth];
        powers.into_iter().chain(&mut self.fourth_next).for_each(|power| *power *= by * by);
    }

    /// Applies clipping that leaves the share `less` of the variance.
    pub(crate) fn cut(&mut self, less: f64, left: &Clipped) {
        self.pixels_follow(less);
        self.unequal += left.unequal;
        self.fourth += left.fourth;
        // The pixels' levels are represented by nine groups. If nearly all pixels are clipped, the few others
        // are almost undetermined.
        self.unsure = libm::hypot(self.unsure, (0.3 + 0.7 * left.above * left.above) * left.unequal);
        self.unsure_mean = libm::hypot(self.unsure_mean, 0.1 * left.lost * (1.0 - left.above));
        // Pixels lie on both sides of the limit; their residual is at most the excess that is clipped.
        self.uneven = libm::hypot(self.uneven, left.lost * (1.0 - left.above));
    }

    /// Returns the variance of shot noise over the signal: 1 until neighbours share charge.
    pub(crate) fn shot_over_signal(&self) -> f64 {
        if self.signal > 0.0 { self.shot.lag(0, 0) / self.signal } else { 1.0 }
    }

    /// Clips shot noise. `less`: remaining share of its variance; `above`: share of the pixels at the limit.
    /// Noise shared by two pixels survives only if neither is clipped (to first order in their correlation).
    pub(crate) fn cut_shot(&mut self, less: f64, above: f64) {
        let both = (1.0 - above) * (1.0 - above);
        let own = (less - both) * self.shot.lag(0, 0);
        self.shot.scale(both);
        self.shot.add_white(own);
    }

    /// Applies a curve to charge, before read noise. `less`: remaining share of the shot-noise variance;
    /// `at`: mean level after the curve; `bent`: levels of the pixel groups after it.
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
        // The curve's effect on shading is evaluated at nine levels only.
        self.unsure_mean = libm::hypot(self.unsure_mean, OF_PLACES * (left.mean - at).abs());
        self.uneven = libm::hypot(self.uneven, off_a_line(places, bent));
        self.signal = left.mean;
    }

    /// Reduces the noise of light that pixels share if the share `above` of the pixels no longer follows the
    /// light: the mean of clipped pixels has a slope that is less than 1 by that share.
    pub(crate) fn cut_light(&mut self, above: f64) {
        let square = (1.0 - above) * (1.0 - above);
        self.fields.scale(square);
        self.common *= square;
        self.with_light *= square;
        self.setting *= square;
        self.ripples.iter_mut().for_each(|r| r.0 *= square);
    }

    /// Clips all noise of an image: shared noise is lost where pixels are clipped.
    pub(crate) fn cut_all(&mut self, less: f64, left: &Clipped) {
        self.cut(less, left);
        self.shot.scale(less);
        self.read.scale(less);
        self.shared(less);
        self.setting *= less;
    }

    /// Returns the covariance at a lag of noise within a frame, DN^2, without subtraction of the frame's own
    /// mean.
    pub fn covariance(&self, dy: i32, dx: i32) -> f64 {
        let line = |&(v, px, py): &(f64, f64, f64)| v * libm::cos(px * f64::from(dx) + py * f64::from(dy));
        let lines: f64 = self.lines.iter().map(line).sum();
        self.shot.lag(dy, dx)
            + self.read.lag(dy, dx)
            + self.row.lag(dy)
            + self.column.lag(dx)
            + self.ripple(f64::from(dy))
            + self.fields.variance()
            + lines
    }

    /// Returns the covariance of rows this far apart by slow changes from row to row.
    pub fn ripple(&self, rows: f64) -> f64 {
        self.ripples.iter().map(|(v, ripple)| v * ripple.correlation(rows)).sum()
    }

    /// Returns that covariance over that of a row with itself; 0 without ripples.
    pub fn ripple_correlation(&self, rows: f64) -> f64 {
        let all = self.ripple(0.0);
        if all > 0.0 { self.ripple(rows) / all } else { 0.0 }
    }

    /// Returns the covariance of the ripples in the first `to` of `rows` rows with their mean over all rows.
    pub fn ripple_with_mean(&self, to: usize, rows: usize) -> f64 {
        self.ripples.iter().map(|(v, r)| v * r.with_mean(to as f64, rows as f64)).sum()
    }

    /// Returns the mean over pairs of pixels of the square of their covariance by normal noise of lines,
    /// bands and fields, DN^4.
    pub fn shared_squares(&self, rows: usize, columns: usize) -> f64 {
        let height = rows as f64;
        let wander = |(v, ripple): &(f64, Ripple)| match *ripple {
            Ripple::Sine(_) => 0.0,
            Ripple::Wander(next) => v * v * Ripple::Wander(next * next).with_mean(height, height),
        };
        self.ripples.iter().map(wander).sum::<f64>()
            + self.fields.squares()
            + self.row.lag(0).powi(2) / height
            + self.column.lag(0).powi(2) / columns as f64
    }

    /// Returns the sines of one random phase per frame: the variance of each, DN^2, and the mean over pairs
    /// of pixels of the cosine of twice the phase between them.
    pub fn sines(&self, rows: usize) -> impl Iterator<Item = (f64, f64)> {
        let height = rows as f64;
        let down = self.ripples.iter().filter_map(move |(v, ripple)| match *ripple {
            Ripple::Sine(cycles) => Some((*v, Ripple::Sine(2.0 * cycles).with_mean(height, height))),
            Ripple::Wander(_) => None,
        });
        down.chain(self.lines.iter().map(|l| (l.0, 0.0)))
    }

    /// Returns the variance of a frame's mean over rows x columns pixels by the own noise of pixels and
    /// lines.
    pub fn of_frame_mean(&self, (rows, columns): (usize, usize), pixels: f64) -> f64 {
        (self.shot.of_mean() + self.read.of_mean()) / pixels
            + self.row.of_mean() / rows as f64
            + self.column.of_mean() / columns as f64
    }
}
