//! Symmetric equations by Cholesky's factorisation (Golub and Van Loan 2013, section 4.2), as implemented in
//! nalgebra.

use nalgebra::{Cholesky, DMatrix, DVectorViewMut, Dyn};

/// Factor of a symmetric matrix.
#[derive(Debug, Clone)]
pub struct Factor(Cholesky<f64, Dyn>);

/// Minimum pivot, relative to the diagonal element: a smaller one is due to rounding alone (2^-53 times the
/// order of the subtracted terms).
const ROUNDING: f64 = 1e-14;

impl Factor {
    /// Factorises a matrix, n x n, row by row, of which the lower triangle is read. `None` if an unknown
    /// depends on those before it, or an entry is NaN.
    pub fn of(a: &[f64], n: usize) -> Option<Self> {
        let factor = Cholesky::new(DMatrix::from_row_slice(n, n, a))?;
        let pivots = factor.l_dirty().diagonal();
        let sound = |(i, pivot): (usize, &f64)| pivot.is_finite() && pivot * pivot > ROUNDING * a[i * n + i];
        pivots.iter().enumerate().all(sound).then_some(Self(factor))
    }

    /// Solves for a right-hand side, in place.
    pub fn solve(&self, b: &mut [f64]) {
        let n = b.len();
        self.0.solve_mut(&mut DVectorViewMut::from_slice(b, n));
    }

    /// Returns the logarithm of the determinant.
    pub fn ln_determinant(&self) -> f64 {
        self.0.ln_determinant()
    }

    /// Returns the inverse, row by row.
    pub fn inverse(&self) -> Vec<f64> {
        self.0.inverse().as_slice().to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solutions_solve_and_what_depends_is_refused() {
        let m = [4.0, 2.0, 0.6, 2.0, 5.0, 1.0, 0.6, 1.0, 3.0];
        let truth = [1.0, -2.0, 0.5];
        let mut b: Vec<f64> = (0..3).map(|i| (0..3).map(|j| m[i * 3 + j] * truth[j]).sum()).collect();
        let factor = Factor::of(&m, 3).unwrap();
        factor.solve(&mut b);
        assert!(b.iter().zip(truth).all(|(b, t)| (b - t).abs() < 1e-12), "{b:?}");
        // 4 * (5 * 3 - 1) - 2 * (2 * 3 - 0.6) + 0.6 * (2 - 3)
        assert!((factor.ln_determinant() - 44.6f64.ln()).abs() < 1e-12);
        let inverse = factor.inverse();
        let product: f64 = (0..3).map(|k| m[3 + k] * inverse[k * 3 + 1]).sum();
        assert!((product - 1.0).abs() < 1e-12);
        assert!(Factor::of(&[1.0, 1.0, 1.0, 1.0], 2).is_none());
        assert!(Factor::of(&[1.0, 0.5, 0.5, 0.25 + 1e-16], 2).is_none());
        assert!(Factor::of(&[f64::NAN], 1).is_none());
    }
}
