//! The three estimators of the line.

use super::{Estimate, Method, Point, Zero};
use crate::dataset::Kind;
use crate::fit::line::{Line, fit, goodness};
use crate::number::Quantity;

/// Computes the variance of a level's variance at the fitted line.
///
/// For independent pixels with variances sigma_p^2 and fourth cumulants k_p, the residual mean square over n
/// frames and M pixels has variance 2 mean(sigma_p^4) / ((n - 1) (M - 1)) + mean(k_p) / (n M) (Kendall and
/// Stuart, vol. 1, chapter 12, for one pixel). Over a field whose means have the variance V, mean(sigma_p^4)
/// = sigma^4 + A^2 V. A Poisson number of mean lambda has the fourth cumulant lambda, so the charge gives A^4
/// lambda = A^3 mu; quantisation gives -q^4 / 120.
pub(super) fn variance_of_variance(p: &Point, gain: f64, constant: f64) -> f64 {
    let mean = p.mean_dn.max(0.0);
    let sigma2 = (gain * mean + constant).max(1e-12);
    let fourth = gain.powi(3) * mean - 1.0 / 120.0;
    let spread = sigma2 * sigma2 + gain * gain * p.spatial_var_dn2 + p.noise_spread_dn4;
    let variance = 2.0 * spread / ((p.frames - 1.0) * (p.pixels - 1.0)) + fourth / (p.frames * p.pixels);
    variance.max(spread / ((p.frames - 1.0) * (p.pixels - 1.0))) + p.var_unsure_dn2.powi(2)
}

/// Computes the variance of a level's distance from the line, s^2 - A mean.
///
/// Mean and variance come from the same frames. For Poisson charge their covariance is k3 / (n M) with k3 =
/// A^2 mu, so that k4 - 2 A k3 + A^2 sigma^2 reduces to A^2 sigma_C^2 - q^4 / 120.
pub(super) fn residual_variance(p: &Point, gain: f64, constant: f64) -> f64 {
    residual_variance_at(p, gain, constant, (gain * p.mean_dn.max(0.0) + constant).max(1e-12))
}

/// As `residual_variance`, for a level whose variance is `sigma2`, DN^2.
pub(super) fn residual_variance_at(p: &Point, gain: f64, constant: f64, sigma2: f64) -> f64 {
    let spread = sigma2 * sigma2 + gain * gain * p.spatial_var_dn2 + p.noise_spread_dn4;
    let normal = 2.0 * spread / ((p.frames - 1.0) * (p.pixels - 1.0));
    let rest = (gain * gain * constant.max(0.0) - 1.0 / 120.0) / (p.frames * p.pixels);
    (normal + rest).max(0.5 * normal) + p.var_unsure_dn2.powi(2) + (gain * p.mean_unsure_dn).powi(2)
}

/// Fits eq. (42) with the weights of eq. (40).
pub(super) fn paper(points: &[Point]) -> Option<Line> {
    let used = points.iter().filter(|p| p.excluded.is_none() && p.kind == Kind::Flat);
    let pairs: Vec<_> = used
        .flat_map(|p| p.pairs.iter().map(|&(mean, var)| (mean, var, 2.0 * var * var / (p.pixels - 1.0))))
        .collect();
    fit(pairs.into_iter())
}

pub(super) fn reweighted(points: &[Point]) -> Option<Line> {
    let used: Vec<_> = points.iter().filter(|p| p.excluded.is_none()).collect();
    let normal = |p: &Point| 2.0 * p.var_dn2 * p.var_dn2 / ((p.frames - 1.0) * (p.pixels - 1.0));
    let mut line = fit(used.iter().map(|p| (p.mean_dn, p.var_dn2, normal(p))))?;
    for _ in 0..50 {
        let next = fit(used
            .iter()
            .map(|p| (p.mean_dn, p.var_dn2, residual_variance(p, line.slope, line.intercept))))?;
        let step = ((next.slope - line.slope) / next.slope).abs()
            + (next.intercept - line.intercept).abs() / next.var_intercept.sqrt();
        line = next;
        if step < 1e-10 {
            break;
        }
    }
    Some(line)
}

/// Maximises the chi-square likelihood by Newton's method, beginning at `start`, with the levels' effective
/// degrees of freedom 2 sigma^4 / var(s^2) there.
pub(super) fn likelihood(points: &[Point], start: &Line) -> Option<Line> {
    let used: Vec<(f64, f64, f64)> = points
        .iter()
        .filter(|p| p.excluded.is_none())
        .map(|p| {
            let dof = 2.0 * start.at(p.mean_dn).powi(2) / residual_variance(p, start.slope, start.intercept);
            (p.mean_dn, p.var_dn2, dof)
        })
        .collect();
    let (mut a, mut c) = (start.slope, start.intercept);
    let mut curvature = (0.0, 0.0, 0.0);
    for _ in 0..50 {
        let (mut ga, mut gc) = (0.0, 0.0);
        curvature = (0.0, 0.0, 0.0);
        for &(x, s2, dof) in &used {
            let m = a * x + c;
            if m <= 0.0 {
                return None;
            }
            let g = 0.5 * dof * (s2 - m) / (m * m);
            let h = 0.5 * dof * (2.0 * s2 - m) / (m * m * m);
            ga += g * x;
            gc += g;
            curvature.0 += h * x * x;
            curvature.1 += h * x;
            curvature.2 += h;
        }
        let (haa, hac, hcc) = curvature;
        let det = haa * hcc - hac * hac;
        if det <= 0.0 {
            return None;
        }
        let (da, dc) = ((hcc * ga - hac * gc) / det, (haa * gc - hac * ga) / det);
        a += da;
        c += dc;
        if (da / a).abs() < 1e-13 && dc.abs() < 1e-13 * (c.abs() + 1e-12) {
            break;
        }
    }
    let (haa, hac, hcc) = curvature;
    let det = haa * hcc - hac * hac;
    let deviance = used
        .iter()
        .map(|&(x, s2, dof)| {
            let ratio = s2 / (a * x + c);
            dof * (ratio - 1.0 - ratio.ln())
        })
        .sum();
    Some(Line {
        slope: a,
        intercept: c,
        var_slope: hcc / det,
        var_intercept: haa / det,
        covariance: -hac / det,
        chi2: deviance,
        dof: used.len() - 2,
    })
}

pub(super) fn estimate_of(method: Method, line: &Line, zero: &Zero) -> Estimate {
    // An error of the zero moves all means together, and so the intercept by A times the error.
    let shift = if zero.std_err_dn.is_finite() { line.slope * zero.std_err_dn } else { 0.0 };
    let quantity = |value, variance: f64, unit| Quantity::new(value, variance.sqrt(), unit);
    Estimate {
        method,
        gain_dn_per_e: quantity(line.slope, line.var_slope, "DN/e"),
        constant_noise_var_dn2: quantity(line.intercept, line.var_intercept + shift * shift, "DN^2"),
        covariance: line.covariance,
        chi2: line.chi2,
        dof: line.dof,
        q: goodness(line.chi2, line.dof as f64),
    }
}
