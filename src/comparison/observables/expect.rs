//! Expected values of observables under a prediction, in the space in which their noise is normal.

use super::line_peak::Axis;
use super::{Observable, Observations};
use crate::statistics::correlated_frames::CorrelatedFrames;
use crate::statistics::steady::PixelNoise;
use radcam_sim::predict::{LAGS, Prediction, Ripple, SetPrediction, TwoLevels};
use std::cell::OnceCell;

/// Expected value of an observable, with its errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Predicted value in the observable's own unit.
    pub value: f64,
    /// Standard error in the observable's own unit.
    pub std_err: f64,
    /// Part of the error common to all observables of the same frames, signed.
    pub common: f64,
    /// Measured value, predicted value and standard error in the space in which the noise is normal.
    pub normal: (f64, f64, f64),
    /// True if a few pixels dominate the value, so that its errors have heavy tails.
    pub heavy: bool,
}

/// Degrees of freedom of the Student's t for the errors of values dominated by a few pixels (Lange, Little
/// and Taylor 1989, J. Am. Stat. Assoc. 84, 881): five standard errors are as frequent as for the square of a
/// chi-square of few degrees.
pub const HEAVY_DOF: f64 = 4.0;

/// Converts a residual with heavy tails to the normal residual of equal cost: the logarithm of Student's t
/// without its constant.
pub fn lightened(z: f64) -> f64 {
    (HEAVY_DOF * (z * z / HEAVY_DOF).ln_1p()).sqrt().copysign(z)
}

impl Expected {
    /// Returns the expectation of an observable with normal noise.
    pub fn plain(o: &Observable, value: f64, std_err: f64) -> Self {
        Self {
            value,
            std_err,
            common: 0.0,
            normal: (o.measured.value, value, std_err.max(1e-12)),
            heavy: false,
        }
    }

    /// Sets the part of the error that is common to the observables of these frames.
    pub fn with_common(self, common: f64) -> Self {
        Self { common, ..self }
    }

    /// Marks heavy tails if `of_few`, the error due to a few pixels, makes up more than 30 % of the error
    /// variance.
    pub fn with_tails(self, of_few: f64) -> Self {
        Self { heavy: of_few * of_few > 0.3 * self.std_err * self.std_err, ..self }
    }

    /// Returns the expectation of a variance from few samples: its cube root is normal (Wilson and Hilferty
    /// 1931).
    pub fn of_few(o: &Observable, value: f64, dof: f64) -> Self {
        let value = value.max(1e-12);
        let c = 2.0 / (9.0 * dof);
        let root = value.cbrt();
        Self {
            value,
            std_err: value * (2.0 / dof).sqrt(),
            common: 0.0,
            normal: (o.measured.value.max(0.0).cbrt(), (1.0 - c) * root, c.sqrt() * root),
            heavy: false,
        }
    }

    /// Adds a model error of the value; the relative error of a cube root is a third of it.
    pub fn unsure(self, by: f64) -> Self {
        let (measured, root, error) = self.normal;
        let more = by / (3.0 * self.value.cbrt().powi(2));
        let std_err = in_quadrature(&[self.std_err, by]);
        Self { std_err, normal: (measured, root, in_quadrature(&[error, more])), ..self }
    }

    /// Returns the standardised residual.
    pub fn z(&self) -> f64 {
        (self.normal.0 - self.normal.1) / self.normal.2
    }
}

/// Returns the root of the sum of squared errors: simpler and faster than a chain of [`f64::hypot`], which
/// guards against overflow.
#[inline]
pub fn in_quadrature(errors: &[f64]) -> f64 {
    errors.iter().map(|e| e * e).sum::<f64>().sqrt()
}

/// Returns the fraction of the variance of temporally correlated noise that is left after subtracting the
/// mean over `n` frames.
fn left(memory: &[f64], n: f64) -> f64 {
    let lost: f64 = memory.iter().enumerate().map(|(k, r)| (n - (k + 1) as f64).max(0.0) * r).sum();
    1.0 - 2.0 * lost / (n * (n - 1.0))
}

/// Stripes in the means of rows or columns due to a line of the spectrum, DN^2.
#[derive(Debug, Clone, Copy, Default)]
pub struct Stripes {
    /// Covariance of means at a lag.
    pub covariance: f64,
    /// Variance of a mean.
    pub variance: f64,
    /// Standard error of the variance, due to few phases and to products with noise.
    pub std_err: f64,
    /// Part of the error common to all lags, signed.
    pub common: f64,
}

/// Returns the share of a line's variance that is left in means over n pixels with a phase step (squared
/// Dirichlet kernel).
pub(super) fn line_mean(phase: f64, n: f64) -> f64 {
    let half = (0.5 * phase).sin();
    if half.abs() < 1e-9 { 1.0 } else { ((0.5 * phase * n).sin() / (n * half)).powi(2) }
}

/// Returns the error of the predicted mean and variance of noise quantised in steps of q, DN and DN^2, for
/// noise and levels that together are narrower than about half a step. It is half of the first terms of the
/// characteristic function (Widrow and Kollar 2008, ch. 4 and app. B).
fn quantised(variance: f64, spread: f64, q: f64) -> (f64, f64) {
    let noise = (variance - q * q / 12.0).max(1e-3 * q * q);
    let fades = |square: f64| (-2.0 * std::f64::consts::PI.powi(2) * square / (q * q)).exp();
    // Levels of shading have edges: the characteristic function of uniform levels falls as one over their
    // width (root 12 deviations). The effect represented by a few places is known to half.
    let width = std::f64::consts::PI * 12f64.sqrt() * spread / q;
    let shading = if width > 1.0 { 0.5 / width } else { 0.0 };
    let ripple = fades(noise) * (0.5 * fades(spread * spread)).max(shading);
    (q / std::f64::consts::PI * ripple, (q * q / std::f64::consts::PI.powi(2) + 4.0 * noise) * ripple)
}

/// Returns the possible effect of rounding on mean and variance beyond the prediction, DN and DN^2.
fn rough(prediction: &Prediction, s: &SetPrediction, noise: f64, spread: f64) -> (f64, f64) {
    let (mean, variance) = quantised(noise, spread, prediction.code_step_dn.max(s.step_dn));
    if prediction.bit_errors_dn[..6].iter().all(|e| *e == 0.0) {
        return (mean, variance);
    }
    // If the noise covers few codes, it contains their widths. This is no equation but a bound on the part
    // that is not predicted; it vanishes if the noise covers many codes.
    let widths = 0.5 * prediction.bit_errors_dn[..6].iter().map(|e| e * e).sum::<f64>();
    (mean, variance.hypot(widths * (-0.02 * noise).exp()))
}

/// Returns the sampling error, over n frames, of a light that changes down the rows, DN^2. `within`: share of
/// its variance that does not change whole frames.
fn ripple_error(s: &SetPrediction, within: f64, rows: f64, n: f64) -> f64 {
    let dof = (n - 1.0).max(1.0);
    let of = |&(v, ripple): &(f64, Ripple)| {
        let v = v * within;
        match ripple {
            // Like a line it has one phase per frame.
            Ripple::Sine(cycles) => {
                let part = 1.0 / (std::f64::consts::TAU * cycles * rows).max(1.0);
                v * (1.0 / (n * (n - 1.0)).max(1.0) + 2.0 * part * part / dof).sqrt()
            }
            // The square of an autoregression decorrelates twice as fast as the autoregression.
            Ripple::Wander(next) => {
                let parts = (rows * (1.0 - next * next) / (1.0 + next * next)).max(1.0);
                v * (2.0 / (dof * parts)).sqrt()
            }
        }
    };
    match s.ripples.as_slice() {
        [] => 0.0,
        [one] => of(one),
        all => all.iter().map(of).fold(0.0, f64::hypot),
    }
}

/// Covariances of the noise of a set, DN^2, by row and column lag; several statistics of several chunks use
/// each.
#[derive(Debug, Clone, Copy, Default)]
struct Lags {
    shot: [[f64; LAGS]; LAGS],
    read: [[f64; LAGS]; LAGS],
    row: [f64; LAGS],
    column: [f64; LAGS],
    ripple: [f64; LAGS],
    /// Column lags from -3 on.
    lines: [[f64; 2 * LAGS - 1]; LAGS],
    /// Covariances of the field's shapes, by row lag and by column lag.
    fields: [[f64; LAGS]; 2],
    /// Covariances of row means times the pixels of a row: shot noise, then read noise.
    of_rows: [[f64; LAGS]; 2],
}

impl Lags {
    fn of(s: &SetPrediction, (rows, columns): (usize, usize)) -> Self {
        let mut lines = [[0.0; 2 * LAGS - 1]; LAGS];
        for &(v, px, py) in &s.lines {
            for (dy, row) in lines.iter_mut().enumerate() {
                for (i, at) in row.iter_mut().enumerate() {
                    *at += v * (px * (i as f64 - (LAGS - 1) as f64) + py * dy as f64).cos();
                }
            }
        }
        Self {
            shot: s.shot.lags(),
            read: s.read.lags(),
            row: std::array::from_fn(|d| s.row.lag(d as i32)),
            column: std::array::from_fn(|d| s.column.lag(d as i32)),
            ripple: std::array::from_fn(|d| s.ripple(d as f64)),
            lines,
            fields: [
                std::array::from_fn(|d| s.fields.rows_apart(d, rows)),
                std::array::from_fn(|d| s.fields.columns_apart(d, columns)),
            ],
            of_rows: [&s.shot, &s.read].map(|noise| std::array::from_fn(|d| noise.along_lag(d))),
        }
    }

    /// Multiplies the shot noise by this factor.
    fn scale_shot(&mut self, by: f64) {
        self.shot.iter_mut().flatten().for_each(|v| *v *= by);
        self.of_rows[0].iter_mut().for_each(|v| *v *= by);
    }

    /// Returns the covariance of lines of the spectrum; it is equal at the opposite lag.
    fn lines(&self, dy: i32, dx: i32) -> f64 {
        let along = if dy < 0 { -dx } else { dx };
        self.lines[near(dy)][(along + LAGS as i32 - 1).clamp(0, 2 * LAGS as i32 - 2) as usize]
    }

    /// Returns the covariance of the field's shapes.
    fn fields(&self, dy: i32, dx: i32) -> f64 {
        self.fields[0][near(dy)] + self.fields[1][near(dx)]
    }

    /// Returns the variance of a pixel.
    fn variance(&self) -> f64 {
        let lines = self.row[0] + self.column[0] + self.ripple[0] + self.lines(0, 0);
        self.shot[0][0] + self.read[0][0] + lines + self.fields(0, 0)
    }
}

/// Returns the larger of two errors, signed: of the errors common to statistics of the same frames one is
/// kept.
pub(super) fn larger(a: f64, b: f64) -> f64 {
    if b.abs() > a.abs() { b } else { a }
}

/// Returns the index of a lag in a table of lags.
fn near(lag: i32) -> usize {
    (lag.unsigned_abs() as usize).min(LAGS - 1)
}

/// Relative error of the effect of the field (a named choice: rows and columns determine its smooth part).
pub(super) const FIELD: f64 = 0.05;

/// Prediction for the observables of one chunk of frames.
#[derive(Debug)]
pub struct View<'a> {
    /// The full prediction.
    pub prediction: &'a Prediction,
    /// All observations.
    pub all: &'a Observations,
    /// Index of the set; `None` for the whole campaign.
    pub at: Option<usize>,
    /// Expected means of the frames, DN.
    pub frames: &'a [f64],
    /// Number of these frames, at least 1.
    pub n: f64,
    /// Number of these frames minus 1, at least 1.
    pub dof: f64,
    /// Mean of the expected frame means, DN.
    pub mean: f64,
    /// Variance of the expected frame means, DN^2: the level moves.
    pub moved: f64,
    /// Variance due to a level that moves within a chunk, DN^2: shading and fixed pattern move with it, pixel
    /// by pixel. The part that neighbours share is unknown.
    pub moving: f64,
    /// Part of the noise of pixels and lines that subtracting the frame mean removes, DN^2.
    pub of_mean: f64,
    /// Variance of the mean over all rows of slow changes down the rows, DN^2.
    pub ripple_of_mean: f64,
    /// Variance of a pixel, DN^2.
    pub noise: f64,
    /// Fractions of shot noise and of read noise that are left after subtracting the mean over the frames.
    pub left: (f64, f64),
    /// Possible effect of rounding on mean and variance beyond the prediction, DN and DN^2.
    pub rough: (f64, f64),
    /// Rounding error of covariances of line means, times the pixels of a line, DN^2. Different lines share
    /// no pixel: only their variances have the error common to all chunks of a level.
    pub rough_lags: f64,
    /// Sampling error of a light that changes down the rows, DN^2.
    pub ripple_error: f64,
    /// Variance that these frames share in proportion to the light of each pixel, DN^2, as shown by their
    /// means.
    pub with_light: f64,
    lags: Lags,
    whole: Whole,
    /// Spread of the pixels' noise and its shape, computed on first use.
    pixel_noise: OnceCell<(f64, PixelNoise)>,
}

/// Light of a set under a flickering lamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Light {
    /// Light shown by the frames of the set.
    Own,
    /// Light of the model.
    Nominal,
}

/// Properties of a whole prediction, used by many observables.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Whole {
    light: Light,
    all_codes: bool,
    even_codes: bool,
    moves_samples: bool,
}

impl Whole {
    fn of(p: &Prediction, light: Light) -> Self {
        Self {
            light,
            all_codes: p.sets.iter().all(|s| s.codes_used > 0.999) && p.code_step_dn.fract() == 0.0,
            even_codes: p.code_step_dn <= 1.0 && p.bit_errors_dn.iter().all(|e| *e == 0.0),
            moves_samples: p.sets.iter().any(|s| s.moved != 0.0),
        }
    }
}

impl<'a> View<'a> {
    /// Returns the expected power at the peak of a spectrum of line means.
    pub fn peak(&self, axis: Axis, o: &Observable) -> Expected {
        match &self.all.peaks[axis as usize] {
            Some(peak) => peak.expect(o, self),
            None => Expected::plain(o, 0.0, o.measured.std_err),
        }
    }

    /// Creates the view for the frames of an observable.
    fn new(
        o: &Observable,
        prediction: &'a Prediction,
        all: &'a Observations,
        lags: Lags,
        whole: Whole,
    ) -> Self {
        let set = o.set.and_then(|i| prediction.sets.get(i));
        let frames = prediction.frame_signal.get(o.frames.0..o.frames.1).unwrap_or(&[]);
        let n = frames.len().max(1) as f64;
        let dof = (n - 1.0).max(1.0);
        let mean = frames.iter().sum::<f64>() / n;
        let moved = frames.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / dof;
        let shape = all.campaign.shape;
        let at_scene = o.set.is_some_and(|s| all.after_scene[s]);
        let moving = if at_scene { 1.0 } else { all.largest_spread.powi(2) } * moved;
        let mut view = Self {
            prediction,
            all,
            at: o.set,
            frames,
            n,
            dof,
            mean,
            moved,
            moving,
            of_mean: 0.0,
            ripple_of_mean: 0.0,
            noise: 0.0,
            left: (1.0, 1.0),
            rough: (0.0, 0.0),
            rough_lags: 0.0,
            ripple_error: 0.0,
            with_light: 0.0,
            lags,
            whole,
            pixel_noise: OnceCell::new(),
        };
        let Some(s) = set else { return view };
        view.ripple_of_mean = s.ripple_with_mean(shape.0, shape.0);
        view.of_mean = s.of_frame_mean(shape, o.pixels) + view.ripple_of_mean;
        view.noise = lags.variance();
        if n > 1.5 {
            view.left = (left(&s.shot_memory, n), left(&s.read_memory, n));
        }
        let spread = o.set.and_then(|i| all.campaign.sets.get(i)).map_or(0.0, |s| s.spread_dn);
        view.rough = rough(prediction, s, view.noise, spread);
        view.rough_lags = view.rough.1;
        // Rounding errors are equal in all chunks of a level and do not average out.
        let alike = o.set.and_then(|i| all.alike.get(i)).map_or(1.0, |n| n.sqrt());
        view.rough = (alike * view.rough.0, alike * view.rough.1);
        // The part removed with the frame mean does not scatter.
        let within = 1.0 - view.ripple_of_mean / s.ripple(0.0).max(f64::MIN_POSITIVE);
        view.ripple_error = ripple_error(s, within, shape.0 as f64, n);
        // The scatter shown by the frames is used instead of the expected one: it is one number for all
        // statistics of these frames.
        if s.with_light > 0.0 {
            let (mean_dn, var_dn2) = o.frame_means;
            let shown = (var_dn2 - view.of_mean - moved).max(0.0);
            let share = (s.with_light / s.common.max(f64::MIN_POSITIVE)).min(1.0);
            view.with_light = shown * share;
            // Their light is also the one shown: under a flickering lamp the shot noise of few frames follows
            // their own mean, as far as the lamp moves it.
            let signal_dn = mean - prediction.base.offset_dn;
            if whole.light == Light::Own && var_dn2 > 0.0 && signal_dn > 0.0 {
                let by_light = s.with_light / (s.common + view.of_mean).max(f64::MIN_POSITIVE);
                view.lags.scale_shot((1.0 + by_light * (mean_dn - mean) / signal_dn).max(0.0));
            }
        }
        view
    }

    /// Returns the prediction of the set.
    pub fn set(&self) -> Option<&'a SetPrediction> {
        self.at.and_then(|i| self.prediction.sets.get(i))
    }

    /// Returns the covariance at a lag of at most 3 rows and columns as measured, about the mean of each
    /// pixel and of each frame, DN^2.
    pub fn lag(&self, dy: i32, dx: i32) -> f64 {
        if self.set().is_none() {
            return 0.0;
        }
        let (of, y, x) = (&self.lags, near(dy), near(dx));
        self.left.0 * of.shot[y][x]
            + self.left.1 * of.read[y][x]
            + of.row[y]
            + of.column[x]
            + of.ripple[y]
            + of.lines(dy, dx)
            + of.fields(dy, dx)
            + self.with_light * if (dy, dx) == (0, 0) { self.all.field.pixels } else { self.all.field.smooth }
            + self.set().filter(|_| (dy, dx) == (1, -1)).map_or(0.0, |s| s.uphill)
            - self.of_mean
    }

    /// Returns the model error of the variance while the level moves, DN^2; 0 if the level moves by less than
    /// a sixteenth of a code.
    pub fn unsure_moving(&self) -> f64 {
        self.set().filter(|_| self.moved > 0.004).map_or(0.0, |s| s.unsure_moving)
    }

    /// Returns the error of a mean product of noise shared by whole lines, DN^2. Lines are few: a mean
    /// product of n normal pairs has the error s^2 / root n (twice that square for a product with itself).
    pub fn shared(&self, dy: i32, dx: i32) -> f64 {
        if self.set().is_none() {
            return 0.0;
        }
        let of = |own: f64, count: usize, same: bool| {
            own * ((1.0 + f64::from(u8::from(same))) / count as f64 / self.dof).sqrt()
        };
        let shape = self.all.campaign.shape;
        let (rows, columns) =
            (of(self.lags.row[0], shape.0, dy == 0), of(self.lags.column[0], shape.1, dx == 0));
        in_quadrature(&[rows, columns, self.ripple_error, self.field_error(self.lags.fields(dy, dx))])
    }

    /// Returns the sampling error of the variance of shapes drawn anew in each frame: that of the square of
    /// one number per frame.
    pub fn field_error(&self, variance: f64) -> f64 {
        variance * (2.0 / self.dof).sqrt()
    }

    /// Returns the variance of the pixel variances over the square of their mean, and the raw second, third
    /// and fourth moments of the variances over their mean.
    pub fn unequal(&self) -> (f64, [f64; 3]) {
        let (spread, shape) = self.pixel_noise();
        (*spread, shape.moments(*spread))
    }

    /// Returns the variance of the pixel variances over the square of their mean.
    pub fn unequal_spread(&self) -> f64 {
        self.pixel_noise().0
    }

    fn pixel_noise(&self) -> &(f64, PixelNoise) {
        self.pixel_noise.get_or_init(|| self.find_pixel_noise())
    }

    fn find_pixel_noise(&self) -> (f64, PixelNoise) {
        let square = (self.noise * self.noise).max(f64::MIN_POSITIVE);
        let predicted = self.set().map_or(0.0, |s| s.unequal.max(0.0) / square);
        // Errors do not follow the fit if darks show the spread: a small fitted value would seem certain, and
        // a large one uncertain.
        let Some(shown) = self.all.pixel_noise else { return (predicted, PixelNoise::usual(predicted)) };
        let base = &self.prediction.base;
        let read = (base.gain_dn_per_e * base.read_noise_e).powi(2);
        let jumps = self.set().map_or(TwoLevels::default(), |s| s.two_levels);
        let of_darks = base.read_noise_spread * read * read + jumps.spread;
        let rest = (predicted - of_darks / square).max(0.0);
        let dark = read + jumps.share * jumps.variance;
        (rest + shown.spread.max(0.0) * dark * dark / square, shown)
    }

    /// Returns the largest variance of a pixel over the mean of all: one pixel may dominate a mean of fourth
    /// powers.
    pub fn noisiest(&self) -> f64 {
        let (spread, shape) = self.pixel_noise();
        shape.largest(*spread)
    }

    /// Returns the factor by which products of neighbours scatter more if some pixels have most of the noise
    /// and neighbours are alike, as beside the edge of a clipped region: the root of the mean square of the
    /// pixel variances over the square of their mean.
    pub fn unlike(&self) -> f64 {
        let square = self.noise * self.noise;
        self.set().map_or(1.0, |s| (1.0 + s.unequal.max(0.0) / square.max(f64::MIN_POSITIVE)).sqrt())
    }

    /// Returns the error at a lag common to all statistics of the same frames, signed: the frames show too
    /// much or too little of a ripple or a line. Of several such errors the largest is returned.
    pub fn common(&self, dy: i32, dx: i32) -> f64 {
        let of = &self.lags.ripple;
        let ripple = if of[0] > 0.0 { self.ripple_error * of[near(dy)] / of[0] } else { 0.0 };
        let field = self.field_error(self.lags.fields(dy, dx));
        larger(larger(ripple, self.lines(dy, dx)), field)
    }

    /// Returns the sampling error of lines of the spectrum, DN^2, with the sign of their covariance. A line
    /// has one phase per frame (random walk of n phases).
    pub fn lines(&self, dy: i32, dx: i32) -> f64 {
        if self.set().is_some() { self.walk() * self.lags.lines(dy, dx) } else { 0.0 }
    }

    /// Returns the variances of a pixel's shot noise and read noise, DN^2.
    pub fn pixels(&self) -> (f64, f64) {
        (self.lags.shot[0][0], self.lags.read[0][0])
    }

    /// Returns the covariances of the means of rows this far apart (at most 3), times the pixels of a row,
    /// DN^2: shot noise and read noise.
    pub fn of_rows(&self, apart: usize) -> (f64, f64) {
        let [shot, read] = self.lags.of_rows;
        (shot[apart.min(LAGS - 1)], read[apart.min(LAGS - 1)])
    }

    /// Returns the error of the mean product of two frames of noise common to all pixels, over its variance.
    pub fn walk(&self) -> f64 {
        1.0 / (self.n * (self.n - 1.0)).max(1.0).sqrt()
    }

    /// Returns the sampling error of the variance of a sine in the means of `lines` lines, DN^2. It has two
    /// parts: the phases (random walk), and products with the noise of a line's mean, whose power at one
    /// frequency equals that at every other (Priestley 1981, Spectral Analysis and Time Series, section 6.2:
    /// twice the product of both powers, over the frames).
    pub fn of_stripes(&self, stripes: f64, noise: f64, lines: usize) -> f64 {
        let with_noise = 4.0 * stripes.max(0.0) * noise.max(0.0) / (self.dof * lines as f64);
        in_quadrature(&[self.walk() * stripes, with_noise.sqrt()])
    }

    /// Returns the stripes in the means of rows or columns `lag` apart. `noise`: variance of a mean without
    /// stripes, DN^2.
    pub fn stripes(&self, rows: bool, lag: usize, noise: f64) -> Stripes {
        let Some(s) = self.set() else { return Stripes::default() };
        let shape = self.all.campaign.shape;
        let of_line = |&(v, px, py): &(f64, f64, f64)| {
            let (along, width, across) = if rows { (px, shape.1, py) } else { (py, shape.0, px) };
            let of_means = v * line_mean(along, width as f64);
            (of_means * (across * lag as f64).cos(), of_means)
        };
        let (covariance, variance) =
            s.lines.iter().map(of_line).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        let std_err = self.of_stripes(variance, noise, if rows { shape.0 } else { shape.1 });
        let sign = if variance > 0.0 { covariance / variance } else { 0.0 };
        Stripes { covariance, variance, std_err, common: std_err * sign }
    }

    /// Returns the variance of the means of rows or columns as measured.
    pub fn line_variance(&self, o: &Observable, rows: bool) -> Expected {
        let Some(s) = self.set() else { return Expected::plain(o, 0.0, 1.0) };
        let shape = self.all.campaign.shape;
        let (axis, count) = if rows { (1, self.all.lines.0) } else { (0, self.all.lines.1) };
        // Valid pixels of a line that has any.
        let width = o.pixels / count.max(1) as f64;
        let own = if rows { self.lags.row[0] + self.lags.ripple[0] } else { self.lags.column[0] };
        let shapes = if rows { s.fields.of_rows() } else { s.fields.of_columns() };
        let of_lines = self.stripes(rows, 0, 0.0).variance;
        let (shot, read) = if rows { self.of_rows(0) } else { (s.shot.along(axis), s.read.along(axis)) };
        let pixels = (shot * self.left.0 + read * self.left.1) / width;
        // Each line contains the mean of the noise across the lines, which the frame mean removes.
        let across = if rows {
            s.column.of_mean() / shape.1 as f64
        } else {
            s.row.of_mean() / shape.0 as f64 + self.ripple_of_mean
        };
        let field = self.with_light * if rows { self.all.field.rows } else { self.all.field.columns };
        let value = pixels + own + across + of_lines + shapes - self.of_mean + 0.3 * self.moving + field;
        let dof = self.dof * (count as f64 - 1.0);
        let ripple = if rows { self.ripple_error } else { 0.0 }.hypot(self.field_error(shapes));
        // Lines of unequal pixels scatter unequally.
        let unequal = 1.0 + self.unequal_spread() / width;
        let own = (value - shapes).abs().max(1e-9) * (2.0 * unequal / dof).sqrt();
        let single = in_quadrature(&[self.rough.1, s.unsure_var, s.unsure_own]) / width;
        Expected::plain(
            o,
            value,
            in_quadrature(&[own, self.walk() * of_lines, 0.3 * self.moving, single, ripple, FIELD * field]),
        )
        .with_common(ripple.max(self.of_stripes(of_lines, value - of_lines - shapes, count)))
    }

    /// Returns the share of noise with these correlations that is left after subtracting the mean over the
    /// frames.
    pub fn left_of(&self, memory: &[f64]) -> f64 {
        if self.n > 1.5 { left(memory, self.n) } else { 1.0 }
    }

    /// Returns the mean product of successive residuals over the variance, for noise with these correlations.
    pub fn product(&self, memory: &[f64]) -> f64 {
        let rho = |apart: usize| memory.get(apart - 1).copied().unwrap_or(0.0);
        CorrelatedFrames::new(self.frames.len(), rho).product()
    }

    /// Returns the variance of the mean of these frames, times their number, over their variance about the
    /// mean; 1 for independent frames.
    pub fn noise_of_mean(&self) -> f64 {
        let Some(s) = self.set() else { return 1.0 };
        let (shot, read) = self.pixels();
        let jumps = s.two_levels;
        let jumping = jumps.share * jumps.variance;
        let stays = |k: usize| jumps.stays.powi(k as i32);
        let of = |memory: &[f64], apart: usize| memory.get(apart - 1).copied().unwrap_or(0.0);
        let frames = |rho: &dyn Fn(usize) -> f64| CorrelatedFrames::new(self.frames.len(), rho);
        let all = [
            (shot, frames(&|k| of(&s.shot_memory, k))),
            ((read - jumping).max(0.0), frames(&|k| of(&s.read_memory, k))),
            (jumping, frames(&stays)),
        ];
        let n = self.frames.len() as f64;
        let between: f64 = all.iter().map(|(v, f)| v * n * f.of_mean()).sum();
        let within: f64 = all.iter().map(|(v, f)| v * f.left()).sum();
        between / within.max(1e-9)
    }

    /// Returns the correlations of the pixels' noise in these frames; `None` for independent frames.
    fn correlated(&self) -> Option<CorrelatedFrames> {
        let s = self.set().filter(|s| !s.shot_memory.is_empty() || !s.read_memory.is_empty())?;
        let (shot, read) = self.pixels();
        let of = |memory: &[f64], apart: usize| memory.get(apart - 1).copied().unwrap_or(0.0);
        let rho =
            |k: usize| (shot * of(&s.shot_memory, k) + read * of(&s.read_memory, k)) / self.noise.max(1e-9);
        Some(CorrelatedFrames::new(self.frames.len(), rho))
    }

    /// Returns the relative variance of a pixel's sample variance beyond that of independent frames.
    pub fn spread_in_time(&self) -> f64 {
        self.correlated().map_or(0.0, |frames| frames.spread())
    }

    /// Returns the error of a mean square of this number of pixels beyond that of independent frames, DN^2.
    /// For a mean product of neighbours this is an upper bound.
    pub fn alike_in_time(&self, pixels: f64) -> f64 {
        self.noise * (self.spread_in_time().max(0.0) / pixels).sqrt()
    }

    /// Returns the relative spread of the variances of the deviations from the mean of earlier frames; 0 for
    /// independent frames.
    pub fn unlike_in_time(&self) -> f64 {
        self.correlated().map_or(0.0, |frames| frames.unlike())
    }

    /// Returns the width of a code under the predicted converter.
    pub fn width(&self, code: u32) -> f64 {
        let p = self.prediction;
        if p.code_step_dn > 1.0 {
            let from = (f64::from(code) - p.code_zero_dn).rem_euclid(p.code_step_dn);
            return if from < 0.5 || from >= p.code_step_dn - 0.5 { p.code_step_dn } else { 0.0 };
        }
        // The next code has the lowest unset bit, and none below it.
        let bit = code.trailing_ones() as usize;
        let lost: f64 = p.bit_errors_dn[..bit.min(p.bit_errors_dn.len())].iter().sum();
        (1.0 + p.bit_errors_dn.get(bit).copied().unwrap_or(0.0) - lost).max(0.0)
    }

    /// Returns true if all codes occur at all predicted levels.
    pub fn all_codes(&self) -> bool {
        self.whole.all_codes
    }

    /// Returns true if the predicted converter has equal widths of one step.
    pub fn even_codes(&self) -> bool {
        self.whole.even_codes
    }

    /// Returns true if firmware moves samples by whole codes at any level.
    pub fn moves_samples(&self) -> bool {
        self.whole.moves_samples
    }
}

/// Set and frames of an observable.
type Place = (Option<usize>, (usize, usize));

/// Returns the expectations of the observables selected by `wanted`, in their order.
pub fn expectations(
    all: &Observations,
    prediction: &Prediction,
    wanted: impl Fn(&Observable) -> bool,
) -> Vec<Expected> {
    expectations_beside(all, prediction, wanted, None)
}

/// Returns the expectations of all observables under the light of the model, ignoring the light that frames
/// show under a flickering lamp.
pub fn nominal_expectations(all: &Observations, prediction: &Prediction) -> Vec<Expected> {
    expectations_under(Light::Nominal, all, prediction, |_| true, None)
}

/// Returns expectations as [`expectations`] does, and reuses those of frames that a known prediction
/// describes alike.
pub fn expectations_beside(
    all: &Observations,
    prediction: &Prediction,
    wanted: impl Fn(&Observable) -> bool,
    known: Option<(&Prediction, &[Expected])>,
) -> Vec<Expected> {
    expectations_under(Light::Own, all, prediction, wanted, known)
}

fn expectations_under(
    light: Light,
    all: &Observations,
    prediction: &Prediction,
    wanted: impl Fn(&Observable) -> bool,
    known: Option<(&Prediction, &[Expected])>,
) -> Vec<Expected> {
    let mut out = Vec::with_capacity(all.list.len());
    let whole = Whole::of(prediction, light);
    let known = known.filter(|(p, _)| Whole::of(p, light) == whole && p.has_camera_of(prediction));
    let same_set: Vec<bool> = match known {
        Some((p, _)) => (0..prediction.sets.len()).map(|s| p.has_set_of(prediction, s)).collect(),
        None => Vec::new(),
    };
    let mut same: Option<(Place, bool)> = None;
    let (mut last, mut lags): (Option<(Place, View<'_>)>, _) = (None, (None, Lags::default()));
    for o in all.list.iter().filter(|o| wanted(o)) {
        let key = (o.set, o.frames);
        if let (Some((p, expected)), Some(set)) = (known, o.set) {
            if same.is_none_or(|(k, _)| k != key) {
                let frames = o.frames.0..o.frames.1;
                let are_same = p.frame_signal.get(frames.clone()) == prediction.frame_signal.get(frames);
                same = Some((key, are_same && same_set.get(set) == Some(&true)));
            }
            if let (Some((_, true)), Some(e)) = (same, expected.get(out.len())) {
                out.push(*e);
                continue;
            }
        }
        if last.as_ref().is_none_or(|(k, _)| *k != key) {
            if let Some(s) = o.set.filter(|s| lags.0 != Some(*s)).and_then(|s| prediction.sets.get(s)) {
                lags = (o.set, Lags::of(s, all.campaign.shape));
            }
            last = Some((key, View::new(o, prediction, all, lags.1, whole)));
        }
        if let Some((_, view)) = &last {
            out.push(o.statistic.expect(o, view));
        }
    }
    out
}
