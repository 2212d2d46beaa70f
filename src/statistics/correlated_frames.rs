//! Sample variance of a pixel over a few frames whose noise is correlated in time.
//!
//! With R the correlation matrix of n frames, A = C R C is that of their deviations from the mean (C = 1 -
//! 1/n). All sums take time linear in n, since R depends only on the distance of two frames.

/// Correlations of a pixel's noise in n successive frames.
pub struct CorrelatedFrames {
    /// Correlation by distance, from 0 to n - 1.
    rho: Vec<f64>,
    /// Mean of each row of R.
    rows: Vec<f64>,
    /// Mean of R.
    whole: f64,
}

impl CorrelatedFrames {
    /// Computes the correlations of n frames (at least two) from `rho`, called with distances 1 to n - 1.
    pub fn new(n: usize, rho: impl Fn(usize) -> f64) -> Self {
        let n = n.max(2);
        let rho: Vec<f64> = std::iter::once(1.0).chain((1..n).map(rho)).collect();
        let mut sums = vec![0.0; n];
        (1..n).for_each(|k| sums[k] = sums[k - 1] + rho[k]);
        let rows: Vec<f64> = (0..n).map(|i| (1.0 + sums[i] + sums[n - 1 - i]) / n as f64).collect();
        let whole = rows.iter().sum::<f64>() / n as f64;
        Self { rho, rows, whole }
    }

    fn n(&self) -> f64 {
        self.rho.len() as f64
    }

    /// Expected sample variance over the variance: tr A / (n - 1).
    pub fn left(&self) -> f64 {
        self.n() * (1.0 - self.whole) / (self.n() - 1.0)
    }

    /// Variance of the mean of the frames over the variance.
    pub fn of_mean(&self) -> f64 {
        self.whole
    }

    /// Mean product of successive residuals over the variance.
    pub fn product(&self) -> f64 {
        let each = self.rows.windows(2).map(|r| self.rho[1] - r[0] - r[1] + self.whole);
        each.sum::<f64>() / (self.n() - 1.0)
    }

    /// Relative variance of the sample variance beyond that of independent frames, 2 / (n - 1): 2 tr A^2 /
    /// (tr A)^2 (quadratic form of normal numbers: Mathai and Provost 1992, section 3.2b).
    pub fn spread(&self) -> f64 {
        let n = self.n();
        let square = |r: &f64| r * r;
        let of_frames: f64 =
            self.rho.iter().enumerate().skip(1).map(|(k, r)| 2.0 * (n - k as f64) * square(r)).sum();
        let of_rows: f64 = self.rows.iter().map(square).sum();
        let squares = n + of_frames - 2.0 * n * of_rows + (n * self.whole).powi(2);
        let trace = n * (1.0 - self.whole);
        2.0 * squares / (trace * trace).max(1e-12) - 2.0 / (n - 1.0)
    }

    /// Squared coefficient of variation of the variances of each frame's deviation from the mean of the
    /// frames before it, scaled to one frame; 0 for independent frames.
    pub fn unlike(&self) -> f64 {
        // Sums of the correlations of a frame with the earlier frames, and among the earlier frames.
        let (mut to, mut among) = (0.0, 1.0);
        let of_frame = |(k, r): (usize, &f64)| {
            let before = k as f64;
            to += r;
            let own = before / (before + 1.0) * (1.0 - 2.0 * to / before + among / (before * before));
            among += 1.0 + 2.0 * to;
            own
        };
        let all: Vec<f64> = self.rho.iter().enumerate().skip(1).map(of_frame).collect();
        let mean = |power: i32| all.iter().map(|v| v.powi(power)).sum::<f64>() / all.len() as f64;
        mean(2) / mean(1).powi(2).max(1e-12) - 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// 40 000 draws each of a running average of weight 0.4 and of a mean of the last two frames. Mean and
    /// relative variance of the sample variance, and mean product of successive residuals, agree within five
    /// standard errors, estimated from ten parts of the draws.
    #[test]
    fn sample_variances_scatter_as_stated() {
        const PARTS: usize = 10;
        const DRAWS: usize = 4000;
        for n in [3usize, 4, 8] {
            for weights in [vec![1.0, 0.4, 0.16, 0.064, 0.0256, 0.01024, 0.004096], vec![1.0, 1.0]] {
                let lag = |k: usize| -> f64 {
                    weights.iter().zip(weights.iter().skip(k)).map(|(a, b)| a * b).sum()
                };
                let frames = CorrelatedFrames::new(n, |k| lag(k) / lag(0));
                let draw = |run: usize| {
                    let mut random =
                        PixelRng::new(41, Stream::Effect, n as u64, run as u32, weights.len() as u32);
                    let white: Vec<f64> = (0..n + weights.len()).map(|_| random.normal()).collect();
                    let values: Vec<f64> = (0..n)
                        .map(|i| {
                            weights.iter().zip(&white[i..]).map(|(w, x)| w * x).sum::<f64>() / lag(0).sqrt()
                        })
                        .collect();
                    let mean = values.iter().sum::<f64>() / n as f64;
                    let residuals: Vec<f64> = values.iter().map(|v| v - mean).collect();
                    let square = residuals.iter().map(|r| r * r).sum::<f64>() / (n - 1) as f64;
                    let product = residuals.windows(2).map(|r| r[0] * r[1]).sum::<f64>() / (n - 1) as f64;
                    (square, product)
                };
                let of_part = |part: usize| {
                    let all: Vec<(f64, f64)> = (0..DRAWS).map(|k| draw(part * DRAWS + k)).collect();
                    let mean =
                        |of: &dyn Fn(&(f64, f64)) -> f64| all.iter().map(of).sum::<f64>() / DRAWS as f64;
                    let (square, product) = (mean(&|v| v.0), mean(&|v| v.1));
                    [square, product, mean(&|v| v.0 * v.0) / (square * square) - 1.0]
                };
                let parts: Vec<[f64; 3]> = (0..PARTS).map(of_part).collect();
                let stated = [frames.left(), frames.product(), 2.0 / (n - 1) as f64 + frames.spread()];
                for (k, stated) in stated.into_iter().enumerate() {
                    let mean = parts.iter().map(|p| p[k]).sum::<f64>() / PARTS as f64;
                    let var = parts.iter().map(|p| (p[k] - mean).powi(2)).sum::<f64>() / (PARTS - 1) as f64;
                    let error = (var / PARTS as f64).sqrt();
                    assert!(
                        (mean - stated).abs() < 5.0 * error,
                        "{n} frames, {k}: {mean} +- {error}, not {stated}"
                    );
                }
            }
        }
    }

    /// Deviations from the mean of the earlier frames agree with explicit weights; independent frames give 0.
    #[test]
    fn deviations_from_earlier_frames_have_unlike_variances() {
        let rho = |k: usize| 0.6f64.powi(k as i32);
        let of_frame = |k: usize| {
            let weight = |i: usize| if i == k { 1.0 } else { -1.0 / k as f64 };
            let pairs = (0..=k).flat_map(|i| (0..=k).map(move |j| (i, j)));
            let sum: f64 = pairs.map(|(i, j)| weight(i) * weight(j) * rho(i.abs_diff(j))).sum();
            sum * k as f64 / (k + 1) as f64
        };
        let all: Vec<f64> = (1..6).map(of_frame).collect();
        let mean = all.iter().sum::<f64>() / 5.0;
        let stated = all.iter().map(|v| v * v).sum::<f64>() / 5.0 / (mean * mean) - 1.0;
        let found = CorrelatedFrames::new(6, rho).unlike();
        assert!((found - stated).abs() < 1e-12 && stated > 0.01, "{found}, not {stated}");
        assert!(CorrelatedFrames::new(6, |_| 0.0).unlike().abs() < 1e-12);
        assert!(CorrelatedFrames::new(6, |_| 0.0).spread().abs() < 1e-12);
    }
}
