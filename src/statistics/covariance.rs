//! Covariances of pixel noise at small lags within a frame, their growth across the sensor, and their
//! dependence on the parity of rows and columns.

use super::jackknife::{BLOCKS, Blocks, Value};
use serde::{Deserialize, Serialize};

/// Lags: rows down, columns right, both diagonal signs.
pub const LAGS: [(i32, i32); 10] =
    [(0, 1), (0, 2), (0, 3), (1, 0), (2, 0), (3, 0), (1, 1), (1, -1), (2, 1), (1, 2)];
/// Places in [`LAGS`] of the next column and of the next row.
const NEXT: [usize; 2] = [0, 3];

/// Bands of rows: blocks, with even and odd rows separate.
const BANDS: usize = 2 * BLOCKS;
/// Rows summed in 32 bits before a flush, a sixteenth of them in each band.
const ROWS: usize = 4096;

/// Products of deviations, summed over bands of rows and kept by column.
#[derive(Debug, Clone)]
pub struct Covariance {
    shape: (usize, usize),
    /// Sums by lag, band, column.
    sums: Vec<f64>,
    now: Vec<f32>,
    rows: usize,
}

/// Covariances with their standard errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Covariances {
    /// Covariance at each of [`LAGS`], DN^2.
    pub at: Vec<Value>,
    /// Growth: covariance with the next column, right half minus left; with the next row, lower half minus
    /// upper, DN^2.
    pub growth: [Value; 2],
    /// Covariance with the next column, odd columns minus even ones; with the next row likewise, DN^2.
    pub parity: [Value; 2],
}

impl Covariance {
    /// Creates an accumulator for frames of (rows, columns).
    pub fn new(shape: (usize, usize)) -> Self {
        let n = LAGS.len() * BANDS * shape.1;
        Self { shape, sums: vec![0.0; n], now: vec![0.0; n], rows: 0 }
    }

    /// Discards all frames.
    pub fn clear(&mut self) {
        self.sums.fill(0.0);
        self.now.fill(0.0);
        self.rows = 0;
    }

    fn flush(&mut self) {
        self.sums.iter_mut().zip(&mut self.now).for_each(|(s, n)| *s += f64::from(std::mem::take(n)));
        self.rows = 0;
    }

    /// Computes the covariances over the pairs of pixels counted in `pairs`, divided by `dof`.
    pub fn finish(&self, pairs: &Self, dof: f64) -> Covariances {
        let columns = self.shape.1;
        // By lag: all pairs, or those of odd rows or columns only.
        let gather = |lag: usize, take: &dyn Fn(usize, usize) -> bool| {
            let mut out = Blocks::default();
            for band in 0..BANDS {
                for x in (0..columns).filter(|x| take(band % 2, *x)) {
                    let i = (lag * BANDS + band) * columns + x;
                    let sum = self.sums[i] + f64::from(self.now[i]);
                    let count = pairs.sums[i] + f64::from(pairs.now[i]);
                    out.add((band / 2, Blocks::of(x, columns)), sum / dof, count);
                }
            }
            out
        };
        let parity = |lag: usize, odd: &dyn Fn(usize, usize) -> bool| {
            let (a, b) = (gather(lag, odd).value(), gather(lag, &|band, x| !odd(band, x)).value());
            Value { value: a.value - b.value, std_err: a.std_err.hypot(b.std_err) }
        };
        let at: Vec<Blocks> = (0..LAGS.len()).map(|lag| gather(lag, &|_, _| true)).collect();
        Covariances {
            growth: [
                at[NEXT[0]].difference(|(_, right)| right >= BLOCKS / 2),
                at[NEXT[1]].difference(|(down, _)| down >= BLOCKS / 2),
            ],
            parity: [parity(NEXT[0], &|_, x| x % 2 == 1), parity(NEXT[1], &|band, _| band == 1)],
            at: at.iter().map(Blocks::value).collect(),
        }
    }
}

impl Covariance {
    /// Adds row `y` of an image; rows up to `y` must be filled.
    #[inline(always)]
    pub fn add_row(&mut self, y: usize, image: &[f32]) {
        let (rows, columns) = self.shape;
        for (lag, (dy, dx)) in LAGS.into_iter().enumerate() {
            let (dy, shift) = (dy as usize, dx.unsigned_abs() as usize);
            if y < dy || shift >= columns {
                continue;
            }
            let upper = &image[(y - dy) * columns..][..columns];
            let lower = &image[y * columns..][..columns];
            // The band combines the row parity of the upper pixel with the block of the lower one.
            let band = 2 * Blocks::of(y, rows) + (y - dy) % 2;
            let out = &mut self.now[(lag * BANDS + band) * columns..][..columns];
            let n = columns - shift;
            let (out, a, b) = if dx >= 0 {
                (&mut out[..n], &upper[..n], &lower[shift..])
            } else {
                (&mut out[shift..], &upper[shift..], &lower[..n])
            };
            for ((o, &p), &q) in out.iter_mut().zip(a).zip(b) {
                *o += p * q;
            }
        }
        self.rows += 1;
    }

    /// Completes the image.
    pub fn end_image(&mut self) {
        if self.rows >= ROWS {
            self.flush();
        }
    }

    /// Merges the sums of another.
    pub fn add_sums(&mut self, other: &Self) {
        let from = other.sums.iter().zip(&other.now);
        self.sums.iter_mut().zip(from).for_each(|(s, (o, n))| *s += o + f64::from(*n));
    }
}
