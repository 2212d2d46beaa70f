//! Residuals of the same frames whose errors have a part in common, made independent.
//!
//! Under a light that ripples a few frames show too much or too little of the ripple, and twenty statistics of these frames show the same.
//! With b_i the share of the error of number i that is common, the correlation matrix is D + b b', D = diag(1 - b_i^2). With a = D^(-1/2) b
//! the matrix (I - k a a') D^(-1/2), k = (1 - (1 + |a|^2)^(-1/2)) / |a|^2, makes such numbers independent with variance 1 (by the square root
//! of I + a a', whose eigenvectors are a and all that is orthogonal to it).

use super::layout::Layout;
use crate::observables::Expected;

/// Of each error at least this share of its square is its own: how exactly statistics move together is predicted to some per cent.
const OWN: f64 = 0.05;

/// The transformation at one place of a fit.
pub struct White(Vec<Group>);

/// Numbers of the same frames.
struct Group {
    rows: Vec<usize>,
    /// a of each.
    loads: Vec<f64>,
    /// One over the root of D of each.
    own: Vec<f64>,
    k: f64,
    log_det: f64,
}

impl White {
    /// For expectations; `wider`: by how much errors are wider than these.
    pub fn new(layout: &Layout<'_>, expected: &[Expected], wider: impl Fn(usize) -> f64) -> Self {
        let group = |chunk: &Vec<usize>| {
            let rows: Vec<usize> = chunk.iter().copied().filter(|r| expected[*r].common != 0.0).collect();
            let share = |r: &usize| expected[*r].common / expected[*r].std_err / wider(*r);
            let kept: Vec<f64> = rows.iter().map(|r| (1.0 - share(r).powi(2)).max(OWN)).collect();
            let loads: Vec<f64> = rows
                .iter()
                .zip(&kept)
                .map(|(r, d)| share(r).clamp(-1.0, 1.0) * ((1.0 - OWN) / d).sqrt())
                .collect();
            let square: f64 = loads.iter().map(|a| a * a).sum();
            let k = (1.0 - 1.0 / (1.0 + square).sqrt()) / square.max(f64::MIN_POSITIVE);
            let log_det = kept.iter().map(|d| d.ln()).sum::<f64>() + square.ln_1p();
            let own = kept.iter().map(|d| 1.0 / d.sqrt()).collect();
            (rows.len() > 1).then_some(Group { rows, loads, own, k, log_det })
        };
        Self(layout.chunks.iter().filter_map(group).collect())
    }

    /// Transforms numbers in rows of n.
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

    /// Logarithm of the determinant of the correlations.
    pub fn log_det(&self) -> f64 {
        self.0.iter().map(|g| g.log_det).sum()
    }
}
