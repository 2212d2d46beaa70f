//! Cubic B-splines through measured curves: release 4.0 General, section 6.6.

use crate::fit::cholesky::Factor;

/// Regression with cubic B-splines between 0 and a largest abscissa.
#[derive(Debug, Clone)]
pub(super) struct Spline {
    step: f64,
    coefficients: Vec<f64>,
}

/// Evaluates the cubic B-spline (eq. 45) and its derivative (eq. 49).
fn basis(x: f64) -> (f64, f64) {
    let a = x.abs();
    if a < 1.0 {
        (2.0 / 3.0 - a * a + 0.5 * a * a * a, -2.0 * x * (1.0 - 0.75 * a))
    } else if a <= 2.0 {
        ((2.0 - a).powi(3) / 6.0, -0.5 * x.signum() * (2.0 - a).powi(2))
    } else {
        (0.0, 0.0)
    }
}

impl Spline {
    /// Fits by least squares without weights (eq. 47), in `intervals` intervals from 0 to `end`. `None` for
    /// too few points.
    pub fn fit(points: &[(f64, f64)], end: f64, intervals: usize) -> Option<Self> {
        let n = intervals + 3;
        let step = end / intervals as f64;
        let (mut matrix, mut right) = (vec![0.0; n * n], vec![0.0; n]);
        for &(x, y) in points {
            let row: Vec<f64> = (0..n).map(|p| basis(x / step - (p as f64 - 1.0)).0).collect();
            for i in 0..n {
                right[i] += row[i] * y;
                for j in 0..n {
                    matrix[i * n + j] += row[i] * row[j];
                }
            }
        }
        Factor::of(&matrix, n)?.solve(&mut right);
        right.iter().all(|c| c.is_finite()).then_some(Self { step, coefficients: right })
    }

    /// Returns the curve and its slope.
    pub fn at(&self, x: f64) -> (f64, f64) {
        let terms = self.coefficients.iter().enumerate().map(|(p, c)| {
            let (value, slope) = basis(x / self.step - (p as f64 - 1.0));
            (c * value, c * slope / self.step)
        });
        terms.fold((0.0, 0.0), |sum, term| (sum.0 + term.0, sum.1 + term.1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_met_with_its_slope() {
        let f = |x: f64| 1.0 + 2.0 * x - 0.3 * x * x + 0.02 * x * x * x;
        let slope = |x: f64| 2.0 - 0.6 * x + 0.06 * x * x;
        let points: Vec<(f64, f64)> = (0..40).map(|i| f64::from(i) * 0.25).map(|x| (x, f(x))).collect();
        let spline = Spline::fit(&points, 9.75, 6).unwrap();
        for x in [0.0, 0.1, 3.3, 7.0, 9.75] {
            let (y, s) = spline.at(x);
            assert!((y - f(x)).abs() < 1e-8 && (s - slope(x)).abs() < 1e-7, "{x}: {y} {s}");
        }
        assert!(Spline::fit(&points[..5], 9.75, 6).is_none());
    }
}
