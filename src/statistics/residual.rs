//! Temporal noise of a few successive frames: its variance, its covariances in space and time, and what rows, columns and
//! whole frames share.
//!
//! Pixel means and frame means are taken off (the two-way layout), so that shading, fixed pattern and the lamp do not enter.
//! Errors come from a jackknife over blocks of the sensor.

use ndarray::Array2;
use rayon::prelude::*;

/// Lags of the covariances: rows down, columns right, both diagonal signs.
pub const LAGS: [(i32, i32); 10] =
    [(0, 1), (0, 2), (0, 3), (1, 0), (2, 0), (3, 0), (1, 1), (1, -1), (2, 1), (1, 2)];

/// Blocks along each side for the jackknife.
const BLOCKS: usize = 8;

/// A value with its standard error.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Value {
    /// The value.
    pub value: f64,
    /// Its standard error.
    pub std_err: f64,
}

/// What some successive frames of one set say.
#[derive(Debug, Clone, PartialEq)]
pub struct Residual {
    /// Frames.
    pub frames: usize,
    /// Pixels used.
    pub pixels: f64,
    /// Mean of every frame, DN.
    pub frame_means_dn: Vec<f64>,
    /// Temporal variance, DN^2.
    pub var: Value,
    /// Covariance at each of [`LAGS`], DN^2.
    pub cov: Vec<Value>,
    /// Mean product of a pixel's residuals in successive frames, DN^2: -var/F + ... for independent frames.
    pub successive: Value,
    /// Variance of row means, of column means, DN^2.
    pub row_var_dn2: f64,
    /// See `row_var_dn2`.
    pub column_var_dn2: f64,
    /// Excess of the spread of the pixels' variances over what the frames allow.
    pub unequal: Value,
    /// Covariance with the next column in the right half less that in the left half; with the next row, bottom less top.
    pub growth: [Value; 2],
    /// Mean of every pixel over the frames, DN.
    pub mean_dn: Array2<f32>,
}

/// Sums by block, and the ratio of their totals with its jackknife error.
struct Blocks(Vec<(f64, f64)>);

impl Blocks {
    fn new() -> Self {
        Self(vec![(0.0, 0.0); BLOCKS * BLOCKS])
    }

    fn value(&self) -> Value {
        let (sum, n) = self.0.iter().fold((0.0, 0.0), |(s, n), (bs, bn)| (s + bs, n + bn));
        let used: Vec<_> = self.0.iter().filter(|(_, bn)| *bn > 0.0 && *bn < n).collect();
        let g = used.len() as f64;
        let left: Vec<f64> = used.iter().map(|(bs, bn)| (sum - bs) / (n - bn)).collect();
        let mean = left.iter().sum::<f64>() / g;
        let var = (g - 1.0) / g * left.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        Value { value: sum / n, std_err: var.sqrt() }
    }
}

/// Statistics of successive frames (row by row, DN). `used` marks the pixels that count; `gain` is the growth of a pixel's
/// variance with its signal, DN, so that brighter pixels are not taken for unequal ones, and `zero` the pixels' level without
/// light, where it is known: an offset has no noise. `None` with fewer than two frames.
pub fn residual(
    frames: &[Array2<u16>],
    used: &Array2<bool>,
    gain: f64,
    zero: Option<&Array2<f32>>,
) -> Option<Residual> {
    let n = frames.len();
    if n < 2 {
        return None;
    }
    let (rows, columns) = used.dim();
    let pixels = used.iter().filter(|u| **u).count() as f64;
    let mut mean = Array2::<f32>::zeros((rows, columns));
    for frame in frames {
        mean.zip_mut_with(frame, |m, &d| *m += f32::from(d));
    }
    mean.mapv_inplace(|m| m / n as f32);
    let over = |image: &dyn Fn((usize, usize)) -> f64| {
        used.indexed_iter().filter(|(_, u)| **u).map(|(at, _)| image(at)).sum::<f64>() / pixels
    };
    let frame_means_dn: Vec<f64> = frames.iter().map(|f| over(&|at| f64::from(f[at]))).collect();
    let grand = frame_means_dn.iter().sum::<f64>() / n as f64;
    let residuals: Vec<Array2<f32>> = frames
        .par_iter()
        .zip(&frame_means_dn)
        .map(|(frame, frame_mean)| {
            let common = (frame_mean - grand) as f32;
            ndarray::Zip::from(frame)
                .and(&mean)
                .and(used)
                .map_collect(|&d, &m, &u| if u { f32::from(d) - m - common } else { 0.0 })
        })
        .collect();
    let up = n as f64 / (n as f64 - 1.0);
    let block = |y: usize, x: usize| (y * BLOCKS / rows) * BLOCKS + x * BLOCKS / columns;

    // Products at one lag, by block; `part` may leave places out.
    let product = |a: &Array2<f32>, b: &Array2<f32>, (dy, dx): (i32, i32), out: &mut Blocks| {
        let (dy, shift) = (dy as usize, dx as i64);
        for y in 0..rows - dy.min(rows) {
            let (ra, rb) = (a.row(y), b.row(y + dy));
            let (ra, rb) = (ra.as_slice().unwrap_or(&[]), rb.as_slice().unwrap_or(&[]));
            let of_row = (y * BLOCKS / rows) * BLOCKS;
            for bx in 0..BLOCKS {
                // Columns of this block whose partner is inside.
                let from = (bx * columns).div_ceil(BLOCKS) as i64;
                let to = ((bx + 1) * columns).div_ceil(BLOCKS) as i64;
                let (from, to) = (from.max(-shift), to.min(columns as i64 - shift));
                if from < to {
                    let pa = &ra[from as usize..to as usize];
                    let pb = &rb[(from + shift) as usize..(to + shift) as usize];
                    let sum: f32 = pa.iter().zip(pb).map(|(p, q)| p * q).sum();
                    out.0[of_row + bx].0 += f64::from(sum);
                }
            }
        }
    };
    // Pairs of used pixels at a lag, by block: the same for every frame.
    let counts = |(dy, dx): (i32, i32)| {
        let mut out = Blocks::new();
        for ((y, x), _) in used.indexed_iter().filter(|(_, u)| **u) {
            let (b, a) = (y as i64 + i64::from(dy), x as i64 + i64::from(dx));
            let inside = b < rows as i64 && (0..columns as i64).contains(&a);
            if inside && used[(b as usize, a as usize)] {
                out.0[block(y, x)].1 += 1.0;
            }
        }
        out
    };
    let lagged: Vec<Blocks> = std::iter::once((0, 0))
        .chain(LAGS)
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|lag| {
            let mut sums = counts(lag);
            residuals.iter().for_each(|r| product(r, r, lag, &mut sums));
            sums.0.iter_mut().for_each(|(s, _)| *s *= up / n as f64);
            sums
        })
        .collect();
    let mut successive = counts((0, 0));
    for pair in residuals.windows(2) {
        product(&pair[0], &pair[1], (0, 0), &mut successive);
    }
    successive.0.iter_mut().for_each(|(s, _)| *s /= n as f64 - 1.0);

    let halves = |sums: &Blocks, far: &dyn Fn(usize) -> bool| {
        let part = |wanted: bool| {
            Blocks(sums.0.iter().enumerate().filter(|(i, _)| far(*i) == wanted).map(|(_, b)| *b).collect())
                .value()
        };
        let (far, near) = (part(true), part(false));
        Value { value: far.value - near.value, std_err: far.std_err.hypot(near.std_err) }
    };
    let var = lagged[0].value();
    let growth = [
        halves(&lagged[1], &|i| i % BLOCKS >= BLOCKS / 2),
        halves(&lagged[4], &|i| i / BLOCKS >= BLOCKS / 2),
    ];

    let lines = |axis: usize| {
        let mut sum = 0.0;
        let mut count: f64 = 0.0;
        for r in &residuals {
            for (line, marks) in r.lanes(ndarray::Axis(axis)).into_iter().zip(used.lanes(ndarray::Axis(axis)))
            {
                let width = marks.iter().filter(|u| **u).count() as f64;
                if width > 0.0 {
                    let mean = line.iter().map(|v| f64::from(*v)).sum::<f64>() / width;
                    sum += mean * mean;
                    count += 1.0;
                }
            }
        }
        up * sum / count.max(1.0)
    };

    // Each pixel's variance over what its mean lets expect.
    let dof = n as f64 - 1.0;
    let signal = |at: (usize, usize)| f64::from(mean[at] - zero.map_or(0.0, |z| z[at]));
    let lit = over(&signal);
    let noise = var.value.max(0.0).sqrt();
    let mut spread = Blocks::new();
    let mut level = Blocks::new();
    for ((y, x), _) in used.indexed_iter().filter(|(_, u)| **u) {
        let s2: f64 = residuals.iter().map(|r| f64::from(r[(y, x)]).powi(2)).sum::<f64>() / dof;
        // In the dark what differs is mostly noise and offset: only what stands out is signal.
        let more = signal((y, x)) - lit;
        let more = if lit > 10.0 * noise || more > 5.0 * noise { gain * more } else { 0.0 };
        let expected = (var.value + more).max(0.1 * var.value);
        let ratio = s2 / expected;
        let b = block(y, x);
        spread.0[b].0 += ratio * ratio;
        spread.0[b].1 += 1.0;
        level.0[b].0 += ratio;
        level.0[b].1 += 1.0;
    }
    let middle = level.value().value;
    let square = spread.value();
    let allowed = 1.0 + 2.0 / dof;
    let unequal = Value {
        value: square.value / (middle * middle) / allowed - 1.0,
        std_err: square.std_err / (middle * middle) / allowed,
    };
    Some(Residual {
        frames: n,
        pixels,
        frame_means_dn,
        var,
        cov: lagged[1..].iter().map(Blocks::value).collect(),
        successive: successive.value(),
        row_var_dn2: lines(1),
        column_var_dn2: lines(0),
        unequal,
        growth,
        mean_dn: mean,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    fn frames(n: u64, noise: impl Fn(u64, usize, usize) -> f64) -> Vec<Array2<u16>> {
        (0..n)
            .map(|f| {
                Array2::from_shape_fn((64, 96), |(y, x)| {
                    (1000.0 + y as f64 + 2.0 * x as f64 + noise(f, y, x)).round() as u16
                })
            })
            .collect()
    }

    fn normal(f: u64, i: usize) -> f64 {
        PixelRng::new(3, Stream::Frame, f, i as u32, 0).normal()
    }

    /// White noise of 100 DN^2 under shading: every statistic is found, and the stated errors are true over 60 runs.
    #[test]
    fn errors_cover_the_truth() {
        let used = Array2::from_elem((64, 96), true);
        let (mut z2, mut count) = (0.0, 0.0);
        for run in 0..60u64 {
            let images = frames(4, |f, y, x| 10.0 * normal(100 * run + f, y * 96 + x));
            let r = residual(&images, &used, 0.0, None).unwrap();
            let truth = 100.0 + 1.0 / 12.0;
            let mut add = |v: Value, t: f64| {
                z2 += ((v.value - t) / v.std_err).powi(2);
                count += 1.0;
            };
            add(r.var, truth);
            r.cov.iter().for_each(|c| add(*c, 0.0));
            add(r.successive, -truth / 4.0);
            add(r.growth[0], 0.0);
            add(r.unequal, 0.0);
            assert!((r.row_var_dn2 * 96.0 / truth - 1.0).abs() < 5.0 * (2.0f64 / 192.0).sqrt());
        }
        // 840 squares of unit mean; their number gives 0.05, the errors' own scatter (64 blocks) as much again.
        assert!((z2 / count - 1.0f64).abs() < 0.25, "{}", z2 / count);
    }

    #[test]
    fn shared_noise_is_seen_where_it_is() {
        let used = Array2::from_elem((64, 96), true);
        let images = frames(6, |f, y, x| 5.0 * normal(f, y * 96 + x) + 3.0 * normal(500 + f, y));
        let r = residual(&images, &used, 0.0, None).unwrap();
        assert!((r.row_var_dn2 - 9.0).abs() < 9.0 * 5.0 * (2.0f64 / 320.0).sqrt());
        assert!(r.column_var_dn2 < 2.0 && r.cov[0].value > 7.0 && r.cov[3].value.abs() < 2.5);
        assert!(residual(&images[..1], &used, 0.0, None).is_none());
    }
}
