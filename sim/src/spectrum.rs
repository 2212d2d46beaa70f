//! Noise as a power spectrum over the sensor, so that charge sharing and filters are multiplications
//! (Wiener-Khinchin). The inverse transform gives the covariances at small lags. Noise of whole lines, and
//! light that ripples from row to row, have forms of their own.

use std::sync::OnceLock;

/// Side of the grid of spatial frequencies.
pub const GRID: usize = 16;

/// Number of frequencies from 0 to half a cycle per pixel along one axis. Negative frequencies mirror them,
/// since every spectrum here is even along each axis.
pub const HALF: usize = GRID / 2 + 1;

/// Number of lags with a known covariance, from 0.
pub const LAGS: usize = 4;

/// Power of the noise at HALF x HALF spatial frequencies, e^2 or DN^2 for each pixel. Noise without
/// correlation, the only noise of most models, is one number.
#[derive(Debug, Clone)]
pub struct Spectrum {
    /// White power, the same at every frequency.
    white: f64,
    /// Power beyond the white one, row-major: vertical, horizontal.
    shaped: Option<Box<Powers>>,
}

/// One number for each frequency.
type Powers = [f64; HALF * HALF];

impl PartialEq for Spectrum {
    fn eq(&self, other: &Self) -> bool {
        (0..HALF * HALF).all(|i| self.at(i) == other.at(i))
    }
}

/// Returns the angle of frequency number i, radians per pixel.
pub fn angle(i: usize) -> f64 {
    std::f64::consts::TAU * i as f64 / GRID as f64
}

/// Returns the share of frequency number i among all of one axis.
fn share(i: usize) -> f64 {
    (if i == 0 || i == HALF - 1 { 1.0 } else { 2.0 }) / GRID as f64
}

impl Spectrum {
    /// Creates noise without correlation.
    pub fn white(variance: f64) -> Self {
        Self { white: variance, shaped: None }
    }

    /// Returns the power at frequency number i, row-major.
    fn at(&self, i: usize) -> f64 {
        self.white + self.shaped.as_ref().map_or(0.0, |of| of[i])
    }

    /// Returns all powers, to be changed one by one.
    fn powers(&mut self) -> &mut Powers {
        let white = std::mem::take(&mut self.white);
        let shaped = self.shaped.get_or_insert_with(|| Box::new([0.0; HALF * HALF]));
        shaped.iter_mut().for_each(|p| *p += white);
        shaped
    }

    /// Multiplies the power at each frequency (vertical, horizontal angle).
    pub fn shape(&mut self, gain: impl Fn(f64, f64) -> f64) {
        for (i, p) in self.powers().iter_mut().enumerate() {
            *p *= gain(angle(i / HALF), angle(i % HALF));
        }
    }

    /// Multiplies the power at each frequency, row-major.
    pub(crate) fn shape_by(&mut self, gains: impl Iterator<Item = f64>) {
        self.powers().iter_mut().zip(gains).for_each(|(p, gain)| *p *= gain);
    }

    /// Multiplies all power.
    pub fn scale(&mut self, by: f64) {
        self.white *= by;
        self.shaped.iter_mut().flat_map(|of| of.iter_mut()).for_each(|p| *p *= by);
    }

    /// Adds noise without correlation.
    pub fn add_white(&mut self, variance: f64) {
        self.white += variance;
    }

    /// Adds noise of this power at each frequency (vertical, horizontal angle).
    pub(crate) fn add(&mut self, power: impl Fn(f64, f64) -> f64) {
        for (i, p) in self.powers().iter_mut().enumerate() {
            *p += power(angle(i / HALF), angle(i % HALF));
        }
    }

    /// Adds noise whose power depends on the horizontal frequency only.
    pub fn add_along_rows(&mut self, power: &[f64; HALF]) {
        for row in self.powers().as_chunks_mut::<HALF>().0 {
            row.iter_mut().zip(power).for_each(|(p, more)| *p += more);
        }
    }

    /// Returns the variance of a pixel.
    pub fn variance(&self) -> f64 {
        let Some(shaped) = &self.shaped else { return self.white };
        // All frequencies of an axis but the first and the last count twice: for themselves and for the
        // negative ones.
        let twice = |of: [f64; HALF]| 2.0 * of.iter().sum::<f64>() - of[0] - of[HALF - 1];
        let (mut lanes, rows) = ([0.0; HALF], shaped.as_chunks::<HALF>().0);
        for (i, row) in rows.iter().enumerate() {
            let weight = if i == 0 || i == HALF - 1 { 1.0 } else { 2.0 };
            lanes.iter_mut().zip(row).for_each(|(sum, p)| *sum += weight * p);
        }
        self.white + twice(lanes) / (GRID * GRID) as f64
    }

    /// Returns the covariance at a lag: rows down, columns to the right; at most 3 of each.
    pub fn lag(&self, dy: i32, dx: i32) -> f64 {
        if (dy, dx) == (0, 0) {
            return self.variance();
        }
        let Some(shaped) = &self.shaped else { return 0.0 };
        let lag = |d: i32| (d.unsigned_abs() as usize).min(LAGS - 1);
        let table = &cosines()[lag(dy) * LAGS + lag(dx)];
        // Independent partial sums: a fit calls this some million times.
        let mut lanes = [0.0; HALF];
        for (powers, cosines) in shaped.as_chunks::<HALF>().0.iter().zip(table.as_chunks::<HALF>().0) {
            for i in 0..HALF {
                lanes[i] += powers[i] * cosines[i];
            }
        }
        lanes.iter().sum()
    }

    /// Returns the covariance at every lag of up to 3 rows and columns.
    pub fn lags(&self) -> [[f64; LAGS]; LAGS] {
        let mut out = [[0.0; LAGS]; LAGS];
        if let Some(shaped) = &self.shaped {
            let cosines = along_one_axis();
            for (powers, down) in shaped.as_chunks::<HALF>().0.iter().zip(cosines) {
                let mut along = [0.0; LAGS];
                for (p, c) in powers.iter().zip(cosines) {
                    (0..LAGS).for_each(|dx| along[dx] += p * c[dx]);
                }
                for dy in 0..LAGS {
                    (0..LAGS).for_each(|dx| out[dy][dx] += along[dx] * down[dy]);
                }
            }
        }
        out[0][0] += self.white;
        out
    }

    /// Returns the power of the mean over all pixels, times their number.
    pub fn of_mean(&self) -> f64 {
        self.at(0)
    }

    /// Returns the power of the means of rows (axis 1) or of columns (axis 0), times the pixels of one: the
    /// part without variation along them.
    pub fn along(&self, axis: usize) -> f64 {
        if axis == 1 { self.along_lag(0) } else { self.across_lag(0) }
    }

    /// Returns the covariance of the means of rows this far apart, at most 3, times the pixels of one.
    pub fn along_lag(&self, rows: usize) -> f64 {
        self.means_at(rows, HALF)
    }

    /// Returns the covariance of the means of columns this far apart, at most 3, times the pixels of one.
    pub fn across_lag(&self, columns: usize) -> f64 {
        self.means_at(columns, 1)
    }

    /// Returns the covariance of the means of lines this far apart, times the pixels of one. `step` is the
    /// distance from one frequency across the lines to the next.
    fn means_at(&self, lines: usize, step: usize) -> f64 {
        let white = if lines == 0 { self.white } else { 0.0 };
        let Some(shaped) = &self.shaped else { return white };
        let all = shaped.iter().step_by(step).zip(along_one_axis());
        white + all.map(|(p, cosines)| p * cosines[lines.min(LAGS - 1)]).sum::<f64>()
    }
}

/// Returns the cosine of each frequency of one axis at each lag, times the frequency's share.
fn along_one_axis() -> &'static [[f64; LAGS]; HALF] {
    static TABLE: OnceLock<[[f64; LAGS]; HALF]> = OnceLock::new();
    TABLE.get_or_init(|| {
        std::array::from_fn(|i| std::array::from_fn(|d| share(i) * libm::cos(angle(i) * d as f64)))
    })
}

/// Returns the products of these cosines for both axes, frequency by frequency, for every lag of both.
fn cosines() -> &'static [Vec<f64>] {
    static TABLE: OnceLock<Vec<Vec<f64>>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let one = along_one_axis();
        let at =
            |dy: usize, dx: usize| (0..HALF * HALF).map(|i| one[i / HALF][dy] * one[i % HALF][dx]).collect();
        (0..LAGS).flat_map(|dy| (0..LAGS).map(move |dx| at(dy, dx))).collect()
    })
}

/// Noise shared by the pixels of a line: its power from line to line at HALF frequencies, e^2, then DN^2.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LineNoise([f64; HALF]);

impl LineNoise {
    /// Adds noise that is independent from line to line.
    pub fn add(&mut self, variance: f64) {
        self.0.iter_mut().for_each(|p| *p += variance);
    }

    /// Returns the covariance of lines this far apart, at most 3.
    pub fn lag(&self, d: i32) -> f64 {
        if self.0.iter().all(|p| *p == self.0[0]) {
            return if d == 0 { self.0[0] } else { 0.0 };
        }
        let lag = (d.unsigned_abs() as usize).min(LAGS - 1);
        self.0.iter().zip(along_one_axis()).map(|(p, cosines)| p * cosines[lag]).sum()
    }

    /// Returns the power of the mean over all lines, times their number.
    pub fn of_mean(&self) -> f64 {
        self.0[0]
    }

    /// Multiplies all power.
    pub fn scale(&mut self, by: f64) {
        self.0.iter_mut().for_each(|p| *p *= by);
    }
}

/// Linear filter of the image: its factor on the power at every frequency.
pub struct Filter<'a> {
    power: &'a dyn Fn(f64, f64) -> f64,
    table: Vec<f64>,
    of_single: f64,
}

impl<'a> Filter<'a> {
    /// Creates a filter from the square of its gain at a vertical and a horizontal angle, radians per pixel;
    /// even in both.
    pub fn new(power: &'a dyn Fn(f64, f64) -> f64) -> Self {
        let table = (0..HALF * HALF).map(|i| power(angle(i / HALF), angle(i % HALF))).collect();
        Self { power, table, of_single: 1.0 }
    }

    /// Sets the cumulants of a sum of pixels with these weights. Sums of independent pixels of unequal noise
    /// are more alike, by sum w^4 / (sum w^2)^2.
    pub fn of_weights(self, weights: impl Iterator<Item = f64>) -> Self {
        let (second, fourth) = weights.fold((0.0, 0.0), |(a, b), w| (a + w * w, b + w * w * w * w));
        Self { of_single: if second > 0.0 { fourth / (second * second) } else { 1.0 }, ..self }
    }

    /// Returns the factor on the spread of the pixels' variances and on fourth cumulants, beyond that of the
    /// variance.
    pub fn of_single(&self) -> f64 {
        self.of_single
    }

    /// Filters one kind of noise.
    pub fn apply(&self, noise: &mut Spectrum) {
        noise.shape_by(self.table.iter().copied());
    }

    /// Filters noise that the pixels of a row share.
    pub fn apply_to_rows(&self, noise: &mut LineNoise) {
        noise.0.iter_mut().enumerate().for_each(|(i, p)| *p *= self.table[i * HALF]);
    }

    /// Filters noise that the pixels of a column share.
    pub fn apply_to_columns(&self, noise: &mut LineNoise) {
        noise.0.iter_mut().zip(&self.table).for_each(|(p, h)| *p *= h);
    }

    /// Returns the factor on the power of noise that all pixels share.
    pub fn of_mean(&self) -> f64 {
        self.table[0]
    }

    /// Returns the factor on the power at a vertical and a horizontal angle, radians per pixel.
    pub fn at(&self, vertical: f64, horizontal: f64) -> f64 {
        (self.power)(vertical, horizontal)
    }
}

/// Change of a rippling light from row to row under a rolling shutter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ripple {
    /// Sine of this number of cycles per row, with a new phase in every frame.
    Sine(f64),
    /// Slow wander: correlation from one row to the next.
    Wander(f64),
}

impl Ripple {
    /// Returns the correlation of rows this far apart.
    pub fn correlation(&self, rows: f64) -> f64 {
        if rows == 0.0 {
            return 1.0;
        }
        match *self {
            Self::Sine(cycles) => libm::cos(std::f64::consts::TAU * cycles * rows),
            Self::Wander(next) => power(next, rows.abs()),
        }
    }

    /// Returns the mean correlation of the rows from the first to `to` with all `rows` rows: sums of cosines
    /// and of geometric series.
    pub fn with_mean(&self, to: f64, rows: f64) -> f64 {
        match *self {
            Self::Sine(cycles) => {
                let half = std::f64::consts::PI * cycles;
                let one = libm::sin(half);
                if one.abs() < 1e-9 {
                    return 1.0;
                }
                // Mean of row y with all rows: (sin((2y + 1) half) + sin((2 (rows - y) - 1) half)) / (2 rows
                // sin half).
                let square = |n: f64| libm::sin(n * half).powi(2);
                (square(to) + square(rows) - square(rows - to)) / (2.0 * rows * to * one * one)
            }
            Self::Wander(next) => {
                // Mean of row y with all rows: (1 + next - next^(y + 1) - next^(rows - y)) / (rows (1 -
                // next)).
                let next = next.clamp(1e-12, 1.0 - 1e-9);
                let less = 1.0 - next;
                let ends = next * (1.0 - power(next, to)) * (1.0 + power(next, rows - to)) / less / to;
                (1.0 + next - ends) / less / rows
            }
        }
    }
    /// Returns the variance of the mean product with a cosine of `halves` half turns over all rows (mean
    /// square 1), relative to the variance of a row. The cosines are those of the discrete cosine transform
    /// (Ahmed, Natarajan and Rao 1974, IEEE Trans. Comput. C-23, 90).
    ///
    /// Products of cosines d rows apart sum to (rows - d) cos(d a) - sin(d a) / sin a, a = pi halves / rows.
    pub fn with_cosine(&self, halves: u32, rows: f64) -> f64 {
        let a = std::f64::consts::PI * f64::from(halves) / rows;
        match *self {
            Self::Sine(cycles) => {
                let turn = std::f64::consts::TAU * cycles;
                cosine_power(halves, rows, turn)
            }
            Self::Wander(next) => {
                // Sums of z^d and of (rows - d) z^d with z = next e^(i a), as (real, imaginary).
                let next = next.clamp(1e-12, 1.0 - 1e-9);
                let z = (next * libm::cos(a), next * libm::sin(a));
                let end = power(next, rows);
                let end = (end * libm::cos(a * rows), end * libm::sin(a * rows));
                let less = (1.0 - z.0, -z.1);
                // The sum of z^d from 1 to rows - 1, and rows - z (1 - z^rows) / (1 - z), over 1 - z, less
                // rows.
                let series = over(times(z, (1.0 - end.0, -end.1)), less);
                let sines = over((z.0 - end.0, z.1 - end.1), less).1;
                let cosines = over((rows - series.0, -series.1), less).0 - rows;
                (rows + 2.0 * (cosines - sines / libm::sin(a))) / (rows * rows)
            }
        }
    }
}

/// Returns the relative power of a random-phase sine (`turn` rad per line) in DCT component `halves`: mean
/// square of their product over all lines, with a component of mean square 1.
pub fn cosine_power(halves: u32, lines: f64, turn: f64) -> f64 {
    let a = std::f64::consts::PI * f64::from(halves) / lines;
    // Sum of e^(i t y) over all lines, with the phase at the middle removed (Dirichlet's kernel).
    let sum = |t: f64| {
        let half = libm::sin(0.5 * t);
        if half.abs() < 1e-9 { lines } else { libm::sin(0.5 * lines * t) / half }
    };
    let sign = if halves.is_multiple_of(2) { 1.0 } else { -1.0 };
    0.5 * ((sum(turn + a) + sign * sum(turn - a)) / lines).powi(2)
}

fn times(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0)
}

fn over(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    let square = b.0 * b.0 + b.1 * b.1;
    ((a.0 * b.0 + a.1 * b.1) / square, (a.1 * b.0 - a.0 * b.1) / square)
}

/// Returns a number of at least 0 to the power of a whole number of rows, by squaring: a fit calls it some
/// million times.
fn power(of: f64, rows: f64) -> f64 {
    let (mut out, mut square, mut left) = (1.0, of, rows as u64);
    while left > 0 {
        if left & 1 == 1 {
            out *= square;
        }
        square *= square;
        left >>= 1;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_are_those_of_libm() {
        for of in [0.0, 1e-12, 0.3, 0.97, 1.0 - 1e-9, 1.0] {
            for rows in [0u32, 1, 2, 3, 64, 479, 65_535] {
                let (found, exact) = (power(of, f64::from(rows)), libm::pow(of, f64::from(rows)));
                assert!((found - exact).abs() <= 1e-10 * exact, "{of}^{rows}: {found}, not {exact}");
            }
        }
    }

    /// Products with cosines, compared with sums over all pairs of rows.
    #[test]
    fn products_with_cosines_are_those_of_the_sums() {
        for rows in [16u32, 97] {
            for halves in [1u32, 2] {
                let at = |y: u32| {
                    let turn = std::f64::consts::PI * f64::from(halves) / f64::from(rows);
                    std::f64::consts::SQRT_2 * (turn * (f64::from(y) + 0.5)).cos()
                };
                for ripple in
                    [0.013, 0.2].map(Ripple::Sine).into_iter().chain([0.3, 0.999].map(Ripple::Wander))
                {
                    let of = |y: u32, z: u32| at(y) * at(z) * ripple.correlation(f64::from(y.abs_diff(z)));
                    let all = (0..rows).flat_map(|y| (0..rows).map(move |z| (y, z)));
                    let exact = all.map(|(y, z)| of(y, z)).sum::<f64>() / f64::from(rows * rows);
                    let found = ripple.with_cosine(halves, f64::from(rows));
                    assert!((found - exact).abs() < 1e-9, "{ripple:?} {halves} {rows}: {found}, not {exact}");
                }
            }
        }
    }

    /// The variance equals the covariance at lag 0, and the shared part of lines that of their means, for an
    /// arbitrary spectrum (even along each axis).
    #[test]
    fn sums_over_frequencies_agree() {
        let mut noise = Spectrum::white(1.0);
        noise.shape_by((0..HALF * HALF).map(|i| 1.0 + ((7 * i) % 13) as f64));
        noise.add_white(0.5);
        assert!((noise.variance() - noise.lags()[0][0]).abs() < 1e-12);
        assert!((noise.along_lag(0) - noise.along(1)).abs() < 1e-12);
        let white = Spectrum::white(3.5);
        assert_eq!((white.variance(), white.along_lag(0), white.along_lag(2)), (3.5, 3.5, 0.0));
    }
}
