//! Photon-transfer curve for levels that are not on a line: its slope at zero signal is A.
//!
//! Its curvature comes from a higher power of the signal: charge that repels charge (Astier et al. 2019, eq.
//! 20, to second order in the signal), a nonlinear response, flicker in a shaded field, gains that differ
//! from frame to frame. None of these changes the slope at the dark end.

use super::estimators::residual_variance_at;
use super::{Estimate, Method, Point, Zero};
use crate::dataset::Kind;
use crate::fit::cholesky::Factor;
use crate::fit::line::goodness;
use crate::number::Quantity;

/// Polynomial of the level, fitted to the variance.
#[derive(Debug, Clone)]
pub(super) struct Curve {
    /// Slope at zero signal, DN/e, with its variance.
    pub gain: (f64, f64),
    /// Variance at zero signal, DN^2, with its variance.
    pub constant: (f64, f64),
    /// Covariance of slope and constant.
    pub covariance: f64,
    /// Sum of squared residuals over their variances.
    pub chi2: f64,
    /// Degrees of freedom.
    pub dof: usize,
    /// Variance at the highest level over that of the straight line with this slope, less 1.
    pub bend: f64,
}

impl Curve {
    /// Returns the values at zero signal as an estimate of A and sigma_C^2.
    pub(super) fn estimate(&self, zero: &Zero) -> Estimate {
        let shift = if zero.std_err_dn.is_finite() { self.gain.0 * zero.std_err_dn } else { 0.0 };
        Estimate {
            method: Method::Curve,
            gain_dn_per_e: Quantity::new(self.gain.0, self.gain.1.sqrt(), "DN/e"),
            constant_noise_var_dn2: Quantity::new(
                self.constant.0,
                self.constant.1.sqrt().hypot(shift),
                "DN^2",
            ),
            covariance: self.covariance,
            chi2: self.chi2,
            dof: self.dof,
            q: goodness(self.chi2, self.dof as f64),
        }
    }
}

/// Minimum number of lit levels for a curve.
const MIN_LIT: usize = 6;
/// Polynomial orders that are tried.
const ORDERS: [usize; 2] = [2, 3];
/// Maximum mean squared residual of the curve over that of the line, for the curve to explain the levels.
const MAX_RATIO: f64 = 0.25;

/// Fits the curve of the lower order that the levels support (Schwarz 1978); `None` if no curve is far better
/// than the line, given by its sum of squared residuals and degrees of freedom.
pub(super) fn fit(points: &[Point], gain: f64, constant: f64, of_line: (f64, usize)) -> Option<Curve> {
    let used: Vec<&Point> = points.iter().filter(|p| p.excluded.is_none()).collect();
    if used.iter().filter(|p| p.kind == Kind::Flat).count() < MIN_LIT {
        return None;
    }
    let n = used.len() as f64;
    let line = of_line.0 / of_line.1.max(1) as f64;
    let usual = |c: &Curve| (c.chi2 / c.dof.max(1) as f64).max(1.0);
    let mut best: Option<Curve> = None;
    for &order in &ORDERS {
        let Some(curve) = of_order(&used, order, gain, constant) else { continue };
        // One more term must reduce chi-square by more than chance, in units of the remaining residuals.
        if best.as_ref().is_none_or(|b| (b.chi2 - curve.chi2) / usual(&curve) > n.ln()) {
            best = Some(curve);
        }
    }
    let mut curve = best?;
    let own = curve.chi2 / curve.dof.max(1) as f64;
    if curve.dof == 0 || own > MAX_RATIO * line || curve.gain.0.is_nan() || curve.gain.0 <= 0.0 {
        return None;
    }
    // Multiplies the variances by chi-square per degree of freedom, if above 1.
    let inflation = own.max(1.0);
    for variance in [&mut curve.gain.1, &mut curve.constant.1, &mut curve.covariance] {
        *variance *= inflation;
    }
    Some(curve)
}

/// Slope and variance at zero signal of a parabola less those of the line, where the levels bend.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bend {
    /// Difference of A, DN/e.
    pub gain: f64,
    /// Difference of the variance at zero signal, DN^2.
    pub constant: f64,
    /// Variance at the highest level over that of the straight line from the dark end, less 1.
    pub at_top: f64,
    /// Size of the bend, in its standard errors.
    pub sigmas: f64,
}

/// Minimum bend that counts, in its standard errors (a named choice: 1 of 370 lines has it by chance).
const SHOWS: f64 = 3.0;

/// Returns the bend of levels that may lie on a line as a whole, since chi-square of many levels hardly sees
/// one term; `None` if a line is as good (likelihood ratio; Bevington and Robinson 2003, section 11.4).
pub(super) fn bend(points: &[Point], gain: f64, constant: f64, chi2_of_line: f64) -> Option<Bend> {
    let used: Vec<&Point> = points.iter().filter(|p| p.excluded.is_none()).collect();
    if used.iter().filter(|p| p.kind == Kind::Flat).count() < MIN_LIT {
        return None;
    }
    let curve = of_order(&used, 2, gain, constant)?;
    let usual = (curve.chi2 / curve.dof.max(1) as f64).max(1.0);
    let sigmas = ((chi2_of_line - curve.chi2) / usual).max(0.0).sqrt();
    (sigmas > SHOWS).then_some(Bend {
        gain: curve.gain.0 - gain,
        constant: curve.constant.0 - constant,
        at_top: curve.bend,
        sigmas,
    })
}

fn of_order(used: &[&Point], order: usize, gain: f64, constant: f64) -> Option<Curve> {
    let n = order + 1;
    let top = used.iter().map(|p| p.mean_dn).fold(0.0, f64::max);
    if used.len() <= n || top <= 0.0 {
        return None;
    }
    let mut values: Vec<f64> = used.iter().map(|p| p.var_dn2.max(1e-12)).collect();
    let (mut c, mut inverse, mut variances) = (vec![0.0; n], Vec::new(), Vec::new());
    // The weights come from the curve, not from the noisy variances.
    for _ in 0..8 {
        let of = |(p, v): (&&Point, &f64)| residual_variance_at(p, gain, constant, *v);
        variances = used.iter().zip(&values).map(of).collect::<Vec<f64>>();
        let (mut a, mut b) = (vec![0.0; n * n], vec![0.0; n]);
        for (p, variance) in used.iter().zip(&variances) {
            let x = p.mean_dn / top;
            for i in 0..n {
                b[i] += x.powi(i as i32) * p.var_dn2 / variance;
                for j in 0..n {
                    a[i * n + j] += x.powi((i + j) as i32) / variance;
                }
            }
        }
        let factor = Factor::of(&a, n)?;
        factor.solve(&mut b);
        inverse = factor.inverse();
        c = b;
        let at = |x: f64| c.iter().rev().fold(0.0, |sum, c| sum * x + c);
        values = used.iter().map(|p| at(p.mean_dn / top).max(1e-3 * p.var_dn2.max(1e-9))).collect();
    }
    let chi2 = used.iter().zip(&values).zip(&variances).map(|((p, v), s)| (p.var_dn2 - v).powi(2) / s).sum();
    Some(Curve {
        gain: (c[1] / top, inverse[n + 1] / (top * top)),
        constant: (c[0], inverse[0]),
        covariance: inverse[1] / top,
        chi2,
        dof: used.len() - n,
        bend: c[2..].iter().sum::<f64>() / (c[0] + c[1]),
    })
}
