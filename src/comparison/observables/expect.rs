//! What a prediction says of observables, in the space in which their noise is normal.

use super::line_peak::Axis;
use super::{Observable, Observations};
use crate::statistics::correlated_frames::CorrelatedFrames;
use crate::statistics::steady::PixelNoise;
use radcam_sim::predict::{LAGS, Prediction, Ripple, SetPrediction, TwoLevels};
use std::cell::OnceCell;

/// An expectation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Predicted value in the observable's own unit.
    pub value: f64,
    /// Standard error in the observable's own unit.
    pub std_err: f64,
    /// The part of the error that all observables of the same frames have in common, with its sign.
    pub common: f64,
    /// Measured, predicted and deviation in the space in which the noise is normal.
    pub normal: (f64, f64, f64),
    /// A few pixels decide its value, so that its errors have heavy tails.
    pub heavy: bool,
}

/// Degrees of freedom of Student's t that stands for the errors of values that a few pixels decide (Lange, Little
/// and Taylor 1989, J. Am. Stat. Assoc. 84, 881): of a chi-square of few degrees, squared, five standard errors
/// come as often as they do there.
pub const HEAVY_DOF: f64 = 4.0;

/// A residual with heavy tails as a normal one that costs the same: by the logarithm of Student's t without its
/// constant.
pub fn lightened(z: f64) -> f64 {
    (HEAVY_DOF * (z * z / HEAVY_DOF).ln_1p()).sqrt().copysign(z)
}

impl Expected {
    /// Of an observable whose noise is normal.
    pub fn plain(o: &Observable, value: f64, std_err: f64) -> Self {
        Self {
            value,
            std_err,
            common: 0.0,
            normal: (o.measured.value, value, std_err.max(1e-12)),
            heavy: false,
        }
    }

    /// The same, where a part of the error is common to the observables of these frames.
    pub fn with_common(self, common: f64) -> Self {
        Self { common, ..self }
    }

    /// The same, where this part of the error comes of a few pixels.
    pub fn with_tails(self, of_few: f64) -> Self {
        Self { heavy: of_few * of_few > 0.3 * self.std_err * self.std_err, ..self }
    }

    /// Of a variance from few samples: its cube root is normal (Wilson and Hilferty 1931).
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

    /// The same where the value may be off by that much more: of a cube root by a third of that share.
    pub fn unsure(self, by: f64) -> Self {
        let (measured, root, error) = self.normal;
        let more = by / (3.0 * self.value.cbrt().powi(2));
        let std_err = in_quadrature(&[self.std_err, by]);
        Self { std_err, normal: (measured, root, in_quadrature(&[error, more])), ..self }
    }

    /// Standardised residual.
    pub fn z(&self) -> f64 {
        (self.normal.0 - self.normal.1) / self.normal.2
    }
}

/// Root of the sum of the squares of errors: plainer and faster than a chain of [`f64::hypot`], which guards against overflow.
#[inline]
pub fn in_quadrature(errors: &[f64]) -> f64 {
    errors.iter().map(|e| e * e).sum::<f64>().sqrt()
}

/// What taking off the mean over `n` frames leaves of the variance of temporally correlated noise.
fn left(memory: &[f64], n: f64) -> f64 {
    let lost: f64 = memory.iter().enumerate().map(|(k, r)| (n - (k + 1) as f64).max(0.0) * r).sum();
    1.0 - 2.0 * lost / (n * (n - 1.0))
}

/// Stripes that a line of the spectrum makes in the means of rows or columns, DN^2.
#[derive(Debug, Clone, Copy, Default)]
pub struct Stripes {
    /// Covariance of means at a lag.
    pub covariance: f64,
    /// Variance of a mean.
    pub variance: f64,
    /// Standard error of the variance: few phases, and products with noise.
    pub std_err: f64,
    /// Part of the error that all lags share, with its sign.
    pub common: f64,
}

/// Share of a line's variance that is left in means over n pixels with a phase step (squared Dirichlet
/// kernel).
pub(super) fn line_mean(phase: f64, n: f64) -> f64 {
    let half = (0.5 * phase).sin();
    if half.abs() < 1e-9 { 1.0 } else { ((0.5 * phase * n).sin() / (n * half)).powi(2) }
}

/// Error of the predicted mean and variance of noise quantised in steps of q, DN and DN^2, where noise and
/// levels together are narrower than about half a step. Half of the first terms of the characteristic function
/// (Widrow and Kollar 2008, ch. 4 and app. B).
fn quantised(variance: f64, spread: f64, q: f64) -> (f64, f64) {
    let noise = (variance - q * q / 12.0).max(1e-3 * q * q);
    let fades = |square: f64| (-2.0 * std::f64::consts::PI.powi(2) * square / (q * q)).exp();
    // Levels of shading end at edges: the characteristic function of even ones falls as one over their width
    // (root 12 deviations). What a few places stand for is known to half.
    let width = std::f64::consts::PI * 12f64.sqrt() * spread / q;
    let shading = if width > 1.0 { 0.5 / width } else { 0.0 };
    let ripple = fades(noise) * (0.5 * fades(spread * spread)).max(shading);
    (q / std::f64::consts::PI * ripple, (q * q / std::f64::consts::PI.powi(2) + 4.0 * noise) * ripple)
}

/// What rounding may do to mean and variance beyond what is predicted, DN and DN^2.
fn rough(prediction: &Prediction, s: &SetPrediction, noise: f64, spread: f64) -> (f64, f64) {
    let (mean, variance) = quantised(noise, spread, prediction.code_step_dn.max(s.step_dn));
    if prediction.bit_errors_dn[..6].iter().all(|e| *e == 0.0) {
        return (mean, variance);
    }
    // Where the noise covers few codes their widths are in it: not an equation but a bound on what is not predicted, gone where the noise
    // covers many.
    let widths = 0.5 * prediction.bit_errors_dn[..6].iter().map(|e| e * e).sum::<f64>();
    (mean, variance.hypot(widths * (-0.02 * noise).exp()))
}

/// How little n frames show of a light that changes down the rows, DN^2. `within`: the share of it that does not change whole frames.
fn ripple_error(s: &SetPrediction, within: f64, rows: f64, n: f64) -> f64 {
    let dof = (n - 1.0).max(1.0);
    let of = |&(v, ripple): &(f64, Ripple)| {
        let v = v * within;
        match ripple {
            // Like a line it has one phase a frame.
            Ripple::Sine(cycles) => {
                let part = 1.0 / (std::f64::consts::TAU * cycles * rows).max(1.0);
                v * (1.0 / (n * (n - 1.0)).max(1.0) + 2.0 * part * part / dof).sqrt()
            }
            // Squares of an autoregression forget twice as fast as it does itself.
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

/// Covariances of the noise of a set, DN^2, by rows and columns apart; several statistics of several chunks ask for each.
#[derive(Debug, Clone, Copy, Default)]
struct Lags {
    shot: [[f64; LAGS]; LAGS],
    read: [[f64; LAGS]; LAGS],
    row: [f64; LAGS],
    column: [f64; LAGS],
    ripple: [f64; LAGS],
    /// Columns from -3 on.
    lines: [[f64; 2 * LAGS - 1]; LAGS],
    /// Covariances of the field's shapes, by rows and by columns apart.
    fields: [[f64; LAGS]; 2],
    /// Of the means of rows, times the pixels of one: of shot noise and of read noise.
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

    /// Multiplies the shot noise by this.
    fn scale_shot(&mut self, by: f64) {
        self.shot.iter_mut().flatten().for_each(|v| *v *= by);
        self.of_rows[0].iter_mut().for_each(|v| *v *= by);
    }

    /// Of what lies in lines of the spectrum: the same at the opposite lag.
    fn lines(&self, dy: i32, dx: i32) -> f64 {
        let along = if dy < 0 { -dx } else { dx };
        self.lines[near(dy)][(along + LAGS as i32 - 1).clamp(0, 2 * LAGS as i32 - 2) as usize]
    }

    /// Covariance of the field's shapes.
    fn fields(&self, dy: i32, dx: i32) -> f64 {
        self.fields[0][near(dy)] + self.fields[1][near(dx)]
    }

    /// A pixel with itself.
    fn variance(&self) -> f64 {
        let lines = self.row[0] + self.column[0] + self.ripple[0] + self.lines(0, 0);
        self.shot[0][0] + self.read[0][0] + lines + self.fields(0, 0)
    }
}

/// The larger of two errors, with its sign: of those that statistics of the same frames share one is kept.
pub(super) fn larger(a: f64, b: f64) -> f64 {
    if b.abs() > a.abs() { b } else { a }
}

/// Place of a lag in a table of them.
fn near(lag: i32) -> usize {
    (lag.unsigned_abs() as usize).min(LAGS - 1)
}

/// The field is known to so much of what it does (a named choice: its smooth part is told by rows and columns).
pub(super) const FIELD: f64 = 0.05;

/// A prediction as the observables of one chunk of frames see it.
#[derive(Debug)]
pub struct View<'a> {
    /// Everything that is expected.
    pub prediction: &'a Prediction,
    /// Everything that was observed.
    pub all: &'a Observations,
    /// Place of the set; `None` for the whole campaign.
    pub at: Option<usize>,
    /// Expected means of the frames, DN.
    pub frames: &'a [f64],
    /// Number of these pixels.
    pub n: f64,
    /// That less one, and one at least.
    pub dof: f64,
    /// Their mean, DN.
    pub mean: f64,
    /// Their expected variance, DN^2: the level moves.
    pub moved: f64,
    /// While the level moves within a chunk, shading and fixed pattern move with it, pixel by pixel: how much of that neighbours share is
    /// not known, DN^2.
    pub moving: f64,
    /// The part of the noise of pixels and lines that a frame's mean takes with it, DN^2.
    pub of_mean: f64,
    /// Variance, DN^2, of the mean over all rows of what changes slowly down them.
    pub ripple_of_mean: f64,
    /// Covariance of a pixel with itself, DN^2.
    pub noise: f64,
    /// What taking off the mean over the frames leaves of shot noise and of read noise.
    pub left: (f64, f64),
    /// What rounding may do to mean and variance beyond what is predicted, DN and DN^2.
    pub rough: (f64, f64),
    /// Error by rounding of covariances of the means of lines, times the pixels of a line, DN^2. Lines apart
    /// share no pixel: the error that all chunks of a level have in common is in their variances alone.
    pub rough_lags: f64,
    /// How little few frames show of a light that changes down the rows, DN^2.
    pub ripple_error: f64,
    /// Variance that these frames share in proportion to the light of each pixel, DN^2: as much as their means
    /// show.
    pub with_light: f64,
    lags: Lags,
    whole: Whole,
    /// Spread of the pixels' noise and its shape, once a statistic has asked.
    pixel_noise: OnceCell<(f64, PixelNoise)>,
}

/// Light of a set under a lamp that flickers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Light {
    /// Light that its frames show.
    Own,
    /// Light of the model.
    Nominal,
}

/// Facts of a whole prediction: many observables ask for each.
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
    /// Expected power at the peak of a spectrum of line means.
    pub fn peak(&self, axis: Axis, o: &Observable) -> Expected {
        match &self.all.peaks[axis as usize] {
            Some(peak) => peak.expect(o, self),
            None => Expected::plain(o, 0.0, o.measured.std_err),
        }
    }

    /// For the frames of an observable.
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
        // Rounding errors are the same in all chunks of a level, and do not average out.
        let alike = o.set.and_then(|i| all.alike.get(i)).map_or(1.0, |n| n.sqrt());
        view.rough = (alike * view.rough.0, alike * view.rough.1);
        // What the frame's mean takes with it does not scatter.
        let within = 1.0 - view.ripple_of_mean / s.ripple(0.0).max(f64::MIN_POSITIVE);
        view.ripple_error = ripple_error(s, within, shape.0 as f64, n);
        // Not what is expected of the frames' scatter but what they show: it is one number for all statistics of
        // these frames.
        if s.with_light > 0.0 {
            let (mean_dn, var_dn2) = o.frame_means;
            let shown = (var_dn2 - view.of_mean - moved).max(0.0);
            let share = (s.with_light / s.common.max(f64::MIN_POSITIVE)).min(1.0);
            view.with_light = shown * share;
            // So is their light: the shot noise of few frames under a lamp that flickers is that of their own
            // mean, as far as the lamp moves it.
            let signal_dn = mean - prediction.base.offset_dn;
            if whole.light == Light::Own && var_dn2 > 0.0 && signal_dn > 0.0 {
                let by_light = s.with_light / (s.common + view.of_mean).max(f64::MIN_POSITIVE);
                view.lags.scale_shot((1.0 + by_light * (mean_dn - mean) / signal_dn).max(0.0));
            }
        }
        view
    }

    /// The set's prediction.
    pub fn set(&self) -> Option<&'a SetPrediction> {
        self.at.and_then(|i| self.prediction.sets.get(i))
    }

    /// Covariance at a lag of at most 3 rows and columns, as it is measured: about each pixel's and each frame's mean, DN^2.
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

    /// Model uncertainty of the variance while the level still moves, DN^2; below a sixteenth of a code it no longer does.
    pub fn unsure_moving(&self) -> f64 {
        self.set().filter(|_| self.moved > 0.004).map_or(0.0, |s| s.unsure_moving)
    }

    /// Error of a mean product of noise that whole lines share, DN^2: there are few of them, and a mean product of n normal pairs has the
    /// error s^2 / root n (twice that square for a product with itself).
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

    /// Error that few frames leave of the variance of shapes that they take anew: its scatter is that of the
    /// square of one number a frame.
    pub fn field_error(&self, variance: f64) -> f64 {
        variance * (2.0 / self.dof).sqrt()
    }

    /// Variance of the pixels' variances over the square of their mean, and raw second, third and fourth moment
    /// of the variances over their mean.
    pub fn unequal(&self) -> (f64, [f64; 3]) {
        let (spread, shape) = self.pixel_noise();
        (*spread, shape.moments(*spread))
    }

    /// Variance of the pixels' variances over the square of their mean.
    pub fn unequal_spread(&self) -> f64 {
        self.pixel_noise().0
    }

    fn pixel_noise(&self) -> &(f64, PixelNoise) {
        self.pixel_noise.get_or_init(|| self.find_pixel_noise())
    }

    fn find_pixel_noise(&self) -> (f64, PixelNoise) {
        let square = (self.noise * self.noise).max(f64::MIN_POSITIVE);
        let predicted = self.set().map_or(0.0, |s| s.unequal.max(0.0) / square);
        // Errors do not follow the fit where darks show the spread: what a fit makes small would seem known, and
        // what it makes large unknown.
        let Some(shown) = self.all.pixel_noise else { return (predicted, PixelNoise::usual(predicted)) };
        let base = &self.prediction.base;
        let read = (base.gain_dn_per_e * base.read_noise_e).powi(2);
        let jumps = self.set().map_or(TwoLevels::default(), |s| s.two_levels);
        let of_darks = base.read_noise_spread * read * read + jumps.spread;
        let rest = (predicted - of_darks / square).max(0.0);
        let dark = read + jumps.share * jumps.variance;
        (rest + shown.spread.max(0.0) * dark * dark / square, shown)
    }

    /// Largest variance of a pixel over the mean of all: one pixel may decide a mean of fourth powers.
    pub fn noisiest(&self) -> f64 {
        let (spread, shape) = self.pixel_noise();
        shape.largest(*spread)
    }

    /// By how much products of neighbours scatter more where some pixels have most of the noise and neighbours are alike, as beside the edge
    /// of what is clipped: the root of the mean square of the pixels' variances over the square of their mean.
    pub fn unlike(&self) -> f64 {
        let square = self.noise * self.noise;
        self.set().map_or(1.0, |s| (1.0 + s.unequal.max(0.0) / square.max(f64::MIN_POSITIVE)).sqrt())
    }

    /// The error at a lag that all statistics of the same frames have in common: these show too much or too little of a ripple or a line.
    /// With its sign; where there are several, the largest.
    pub fn common(&self, dy: i32, dx: i32) -> f64 {
        let of = &self.lags.ripple;
        let ripple = if of[0] > 0.0 { self.ripple_error * of[near(dy)] / of[0] } else { 0.0 };
        let field = self.field_error(self.lags.fields(dy, dx));
        larger(larger(ripple, self.lines(dy, dx)), field)
    }

    /// A line has one phase a frame: what few frames show of it scatters (random walk of n phases), DN^2; with the sign of its covariance.
    pub fn lines(&self, dy: i32, dx: i32) -> f64 {
        if self.set().is_some() { self.walk() * self.lags.lines(dy, dx) } else { 0.0 }
    }

    /// Variance of a pixel's shot noise and of its read noise, DN^2.
    pub fn pixels(&self) -> (f64, f64) {
        (self.lags.shot[0][0], self.lags.read[0][0])
    }

    /// Covariance of the means of rows this far apart, at most 3, times the pixels of one, DN^2: by shot noise and by read noise.
    pub fn of_rows(&self, apart: usize) -> (f64, f64) {
        let [shot, read] = self.lags.of_rows;
        (shot[apart.min(LAGS - 1)], read[apart.min(LAGS - 1)])
    }

    /// Error of the mean product of two frames of noise that all share, over its variance.
    pub fn walk(&self) -> f64 {
        1.0 / (self.n * (self.n - 1.0)).max(1.0).sqrt()
    }

    /// Error that few frames leave of the variance of a sine of so many lines beside noise of a line's mean,
    /// DN^2: their phases (random walk), and its products with the noise, whose power at one frequency is
    /// that of every other (Priestley 1981, Spectral Analysis and Time Series, section 6.2: twice the product
    /// of both powers, over the frames).
    pub fn of_stripes(&self, stripes: f64, noise: f64, lines: usize) -> f64 {
        let with_noise = 4.0 * stripes.max(0.0) * noise.max(0.0) / (self.dof * lines as f64);
        in_quadrature(&[self.walk() * stripes, with_noise.sqrt()])
    }

    /// Stripes in the means of rows, or of columns, `lag` apart; `noise`: variance of a mean without them,
    /// DN^2.
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

    /// Variance of the means of rows or of columns, as it is measured.
    pub fn line_variance(&self, o: &Observable, rows: bool) -> Expected {
        let Some(s) = self.set() else { return Expected::plain(o, 0.0, 1.0) };
        let shape = self.all.campaign.shape;
        let (axis, count) = if rows { (1, self.all.lines.0) } else { (0, self.all.lines.1) };
        // Pixels that count of a line that has some.
        let width = o.pixels / count.max(1) as f64;
        let own = if rows { self.lags.row[0] + self.lags.ripple[0] } else { self.lags.column[0] };
        let shapes = if rows { s.fields.of_rows() } else { s.fields.of_columns() };
        let of_lines = self.stripes(rows, 0, 0.0).variance;
        let (shot, read) = if rows { self.of_rows(0) } else { (s.shot.along(axis), s.read.along(axis)) };
        let pixels = (shot * self.left.0 + read * self.left.1) / width;
        // Of noise across the lines each holds the mean, which the frame's mean takes with it.
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

    /// Share of noise with these correlations that is left once the mean over the frames is taken off.
    pub fn left_of(&self, memory: &[f64]) -> f64 {
        if self.n > 1.5 { left(memory, self.n) } else { 1.0 }
    }

    /// Mean product of successive residuals over the variance, for noise with these correlations.
    pub fn product(&self, memory: &[f64]) -> f64 {
        let rho = |apart: usize| memory.get(apart - 1).copied().unwrap_or(0.0);
        CorrelatedFrames::new(self.frames.len(), rho).product()
    }

    /// Correlations of the pixels' noise in these frames; `None` for independent frames.
    fn correlated(&self) -> Option<CorrelatedFrames> {
        let s = self.set().filter(|s| !s.shot_memory.is_empty() || !s.read_memory.is_empty())?;
        let (shot, read) = self.pixels();
        let of = |memory: &[f64], apart: usize| memory.get(apart - 1).copied().unwrap_or(0.0);
        let rho =
            |k: usize| (shot * of(&s.shot_memory, k) + read * of(&s.read_memory, k)) / self.noise.max(1e-9);
        Some(CorrelatedFrames::new(self.frames.len(), rho))
    }

    /// Relative variance of the sample variance of a pixel beyond that of independent frames.
    pub fn spread_in_time(&self) -> f64 {
        self.correlated().map_or(0.0, |frames| frames.spread())
    }

    /// Error of a mean square of so many pixels beyond that of independent frames, DN^2; of a mean product of
    /// neighbours it is at most that.
    pub fn alike_in_time(&self, pixels: f64) -> f64 {
        self.noise * (self.spread_in_time().max(0.0) / pixels).sqrt()
    }

    /// Relative spread of the variances of the deviations from the mean of earlier frames; 0 for independent
    /// frames.
    pub fn unlike_in_time(&self) -> f64 {
        self.correlated().map_or(0.0, |frames| frames.unlike())
    }

    /// Width of a code under the converter that is predicted.
    pub fn width(&self, code: u32) -> f64 {
        let p = self.prediction;
        if p.code_step_dn > 1.0 {
            let from = (f64::from(code) - p.code_zero_dn).rem_euclid(p.code_step_dn);
            return if from < 0.5 || from >= p.code_step_dn - 0.5 { p.code_step_dn } else { 0.0 };
        }
        // The next code has the lowest bit that is not set, and none below it.
        let bit = code.trailing_ones() as usize;
        let lost: f64 = p.bit_errors_dn[..bit.min(p.bit_errors_dn.len())].iter().sum();
        (1.0 + p.bit_errors_dn.get(bit).copied().unwrap_or(0.0) - lost).max(0.0)
    }

    /// Whether all codes occur at all levels that are predicted.
    pub fn all_codes(&self) -> bool {
        self.whole.all_codes
    }

    /// Whether the converter that is predicted has equal widths of one step.
    pub fn even_codes(&self) -> bool {
        self.whole.even_codes
    }

    /// True where firmware moves samples by whole codes at any level.
    pub fn moves_samples(&self) -> bool {
        self.whole.moves_samples
    }
}

/// Set and frames of an observable.
type Place = (Option<usize>, (usize, usize));

/// Expectations of the observables that `wanted` takes, in their order.
pub fn expectations(
    all: &Observations,
    prediction: &Prediction,
    wanted: impl Fn(&Observable) -> bool,
) -> Vec<Expected> {
    expectations_beside(all, prediction, wanted, None)
}

/// Expectations of all observables under the light of the model, whatever frames show of a lamp that flickers.
pub fn nominal_expectations(all: &Observations, prediction: &Prediction) -> Vec<Expected> {
    expectations_under(Light::Nominal, all, prediction, |_| true, None)
}

/// Expectations as [`expectations`] gives them; those of frames that a known prediction describes alike are reused.
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
