//! Whitening of residuals of the same frames whose errors have a part in common.
//!
//! Under a light that ripples, a few frames show too much or too little of the ripple, and twenty statistics
//! of these frames show it together. A line, which has one phase a frame, does the same.
//!
//! Let b_i be the share of the error of residual i that is common. The correlation matrix is D + b b', D =
//! diag(1 - b_i^2). With a = D^(-1/2) b, the matrix (I - k a a') D^(-1/2), k = (1 - (1 + |a|^2)^(-1/2)) /
//! |a|^2, makes the residuals independent with variance 1 (by the square root of I + a a', whose eigenvectors
//! are a and all vectors orthogonal to it).

use super::layout::Layout;
use crate::observables::Expected;

/// Minimum share of each squared error that is its own: common errors are predicted only to some per cent.
const OWN: f64 = 0.05;

/// Whitening transformation at one point of a fit.
pub struct White(Vec<Group>);

/// Residuals of the same frames.
struct Group {
    rows: Vec<usize>,
    /// Value of a for each residual.
    loads: Vec<f64>,
    /// One over the root of D for each residual.
    own: Vec<f64>,
    k: f64,
    log_det: f64,
}

impl Group {
    /// Builds a group from the share of each error that is common.
    fn new(rows: Vec<usize>, shares: &[f64]) -> Self {
        let kept: Vec<f64> = shares.iter().map(|b| 1.0 - b * b).collect();
        let loads: Vec<f64> = shares.iter().zip(&kept).map(|(b, d)| b / d.sqrt()).collect();
        let square: f64 = loads.iter().map(|a| a * a).sum();
        let k = (1.0 - 1.0 / (1.0 + square).sqrt()) / square.max(f64::MIN_POSITIVE);
        let log_det = kept.iter().map(|d| d.ln()).sum::<f64>() + square.ln_1p();
        let own = kept.iter().map(|d| 1.0 / d.sqrt()).collect();
        Self { rows, loads, own, k, log_det }
    }
}

impl White {
    /// Builds the transformation for expectations; `wider`: ratio of each error to that of its expectation.
    pub fn new(layout: &Layout<'_>, expected: &[Expected], wider: impl Fn(usize) -> f64) -> Self {
        if expected.iter().all(|e| e.common == 0.0) {
            return Self(Vec::new());
        }
        let group = |chunk: &Vec<usize>| {
            let rows: Vec<usize> = chunk.iter().copied().filter(|r| expected[*r].common != 0.0).collect();
            let most = (1.0 - OWN).sqrt();
            let share =
                |r: &usize| (expected[*r].common / expected[*r].std_err / wider(*r)).clamp(-most, most);
            let shares: Vec<f64> = rows.iter().map(share).collect();
            (rows.len() > 1).then(|| Group::new(rows, &shares))
        };
        Self(layout.chunks.iter().filter_map(group).collect())
    }

    /// Whitens values in rows of n.
    pub fn apply(&self, values: &mut [f64], n: usize) {
        let mut common = vec![0.0; n];
        for g in &self.0 {
            common.fill(0.0);
            for ((r, a), own) in g.rows.iter().zip(&g.loads).zip(&g.own) {
                for (v, sum) in values[r * n..][..n].iter_mut().zip(&mut common) {
                    *v *= own;
                    *sum += a * *v;
                }
            }
            for (r, a) in g.rows.iter().zip(&g.loads) {
                let row = values[r * n..][..n].iter_mut();
                row.zip(&common).for_each(|(v, sum)| *v -= g.k * a * sum);
            }
        }
    }

    /// Returns the log determinant of the correlation matrix.
    pub fn log_det(&self) -> f64 {
        self.0.iter().map(|g| g.log_det).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    fn group(shares: &[f64]) -> White {
        White(vec![Group::new((0..shares.len()).collect(), shares)])
    }

    /// Residuals with a common part of both signs: after whitening, their covariances are those of
    /// independent numbers within five standard errors.
    #[test]
    fn common_errors_are_taken_apart() {
        let shares = [0.9, -0.7, 0.3, 0.0, 0.97];
        let (white, draws, n) = (group(&shares), 40_000u32, shares.len());
        let mut products = vec![0.0; n * n];
        for draw in 0..draws {
            let mut rng = PixelRng::new(5, Stream::Effect, 0, draw, 0);
            let common = rng.normal();
            let mut values: Vec<f64> =
                shares.iter().map(|b| b * common + (1.0 - b * b).sqrt() * rng.normal()).collect();
            white.apply(&mut values, 1);
            (0..n * n).for_each(|k| products[k] += values[k / n] * values[k % n] / f64::from(draws));
        }
        for (k, product) in products.iter().enumerate() {
            let (value, variance) = if k / n == k % n { (1.0, 2.0) } else { (0.0, 1.0) };
            let error = (variance / f64::from(draws)).sqrt();
            assert!((product - value).abs() < 5.0 * error, "{k}: {product}");
        }
    }

    /// The determinant for two numbers is 1 minus their squared correlation.
    #[test]
    fn the_determinant_is_that_of_the_correlations() {
        let (a, b) = (0.8, -0.6);
        assert!((group(&[a, b]).log_det() - (1.0 - (a * b * a * b)).ln()).abs() < 1e-12);
    }
}
