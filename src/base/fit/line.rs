//! Weighted straight line: appendix of the paper (eq. 59 to 67; the scan lacks part of it).

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Fitted line y = slope x + intercept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Slope, A of eq. (41).
    pub slope: f64,
    /// Intercept, sigma_C^2 of eq. (41).
    pub intercept: f64,
    /// Variance of the slope, S / D.
    pub var_slope: f64,
    /// Variance of the intercept, S_xx / D.
    pub var_intercept: f64,
    /// Covariance of slope and intercept, -S_x / D.
    pub covariance: f64,
    /// Weighted sum of squared residuals.
    pub chi2: f64,
    /// Degrees of freedom: number of points minus two.
    pub dof: usize,
}

impl Line {
    /// Returns the value of the line at x.
    pub fn at(&self, x: f64) -> f64 {
        self.slope * x + self.intercept
    }
}

/// Fits y = slope x + intercept to points (x, y, variance of y). `None` unless there are two different x with
/// positive, finite variances.
pub fn fit(points: impl Iterator<Item = (f64, f64, f64)> + Clone) -> Option<Line> {
    let sound = points.filter(|(x, y, v)| x.is_finite() && y.is_finite() && v.is_finite() && *v > 0.0);
    let (mut s, mut sx, mut sy, mut n) = (0.0, 0.0, 0.0, 0);
    for (x, y, variance) in sound.clone() {
        let w = 1.0 / variance;
        s += w;
        sx += w * x;
        sy += w * y;
        n += 1;
    }
    if n < 2 {
        return None;
    }
    // About the weighted mean of x the normal equations decouple, and rounding stays small.
    let (mx, my) = (sx / s, sy / s);
    let (mut txx, mut txy) = (0.0, 0.0);
    for (x, y, variance) in sound.clone() {
        let w = 1.0 / variance;
        txx += w * (x - mx).powi(2);
        txy += w * (x - mx) * (y - my);
    }
    if txx <= f64::EPSILON * s * mx * mx {
        return None;
    }
    let slope = txy / txx;
    let intercept = my - slope * mx;
    let chi2 = sound.map(|(x, y, v)| (y - slope * x - intercept).powi(2) / v).sum();
    Some(Line {
        slope,
        intercept,
        var_slope: 1.0 / txx,
        var_intercept: 1.0 / s + mx * mx / txx,
        covariance: -mx / txx,
        chi2,
        dof: n - 2,
    })
}

/// Returns Q(chi2 | dof), eq. (67): the probability that chance alone gives a larger chi-square. NaN for no
/// degrees of freedom.
///
/// ```
/// // Section VII.A of the paper.
/// assert!((radcam::fit::line::goodness(4.3496, 4.0) - 0.3607).abs() < 1e-4);
/// ```
pub fn goodness(chi2: f64, dof: f64) -> f64 {
    ChiSquared::new(dof).map_or(f64::NAN, |d| d.sf(chi2.max(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference: numpy.polyfit(x, y, 1, w=1/s, cov="unscaled").
    #[test]
    fn agrees_with_numpy() {
        let x = [10.0, 40.0, 90.0, 150.0, 230.0];
        let y = [1.2, 1.21, 1.45, 1.62, 1.9];
        let s = [0.01, 0.012, 0.013, 0.02, 0.018];
        let line = fit((0..5).map(|i| (x[i], y[i], s[i] * s[i]))).unwrap();
        for (got, numpy) in [
            (line.slope, 0.0032696686783002965),
            (line.intercept, 1.137977748987291),
            (line.var_slope, 7.161851803494072e-09),
            (line.var_intercept, 7.038026755932592e-05),
            (line.covariance, -5.022956049721413e-07),
        ] {
            assert!((got / numpy - 1.0).abs() < 1e-9, "{got} {numpy}");
        }
        assert_eq!(line.dof, 3);
    }

    #[test]
    fn what_cannot_be_fitted_is_not() {
        assert_eq!(fit([(1.0, 2.0, 1.0)].into_iter()), None);
        assert_eq!(fit([(1.0, 2.0, 1.0), (1.0, 3.0, 1.0)].into_iter()), None);
        assert_eq!(fit([(1.0, 2.0, 0.0), (2.0, 3.0, f64::NAN)].into_iter()), None);
    }
}
