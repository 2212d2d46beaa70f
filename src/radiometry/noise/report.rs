//! Noise report, in the names of the JSON.

use super::levels::NO_ZERO;
use crate::agreement::Agreement;
use crate::data_faults::DataFault;
use crate::dataset::Kind;
use crate::number::{Quantity, finite};
use serde::{Deserialize, Serialize};

/// Estimation method of A and sigma_C^2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Method {
    /// As in the paper.
    Paper,
    /// Weights from the fitted line.
    Reweighted,
    /// Chi-square likelihood.
    Likelihood,
    /// Slope at zero signal of a polynomial, for levels that do not lie on a line.
    Curve,
    /// One lit level, and bounds of the constant noise.
    #[serde(rename = "one-level")]
    OneLevel,
}

impl Method {
    /// Name in the JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Reweighted => "reweighted",
            Self::Likelihood => "likelihood",
            Self::Curve => "curve",
            Self::OneLevel => "one-level",
        }
    }
}

/// Estimates of A and sigma_C^2 by one method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Method of the estimate.
    pub method: Method,
    /// A, DN per electron.
    pub gain_dn_per_e: Quantity,
    /// sigma_C^2, DN^2.
    pub constant_noise_var_dn2: Quantity,
    /// Covariance of A and sigma_C^2.
    #[serde(with = "finite")]
    pub covariance: f64,
    /// Chi-square (deviance for the likelihood).
    #[serde(with = "finite")]
    pub chi2: f64,
    /// Degrees of freedom of chi-square.
    pub dof: usize,
    /// Probability of a larger chi-square.
    #[serde(with = "finite")]
    pub q: f64,
}

impl Estimate {
    /// Adds correlated errors of A and sigma_C^2.
    pub(super) fn widen(&mut self, gain: f64, constant: f64) {
        self.gain_dn_per_e.std_err = self.gain_dn_per_e.std_err.hypot(gain);
        self.constant_noise_var_dn2.std_err = self.constant_noise_var_dn2.std_err.hypot(constant);
        self.covariance += gain * constant;
    }

    /// Clears the errors, for data that hold no measure of their own noise.
    pub(super) fn forget_errors(&mut self) {
        self.gain_dn_per_e.std_err = f64::NAN;
        self.constant_noise_var_dn2.std_err = f64::NAN;
        (self.covariance, self.chi2, self.q) = (f64::NAN, f64::NAN, f64::NAN);
    }
}

/// Level of the report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LevelReport {
    /// Number of the set.
    pub set: u32,
    /// Dark or flat.
    pub kind: Kind,
    /// Mean above the black level, DN.
    pub mean_dn: f64,
    /// Temporal variance, DN^2; NaN if the level has none.
    #[serde(with = "finite")]
    pub var_dn2: f64,
    /// Standard error of the variance at the fitted line, DN^2.
    #[serde(with = "finite")]
    pub var_std_err_dn2: f64,
    /// Distance from the line over its standard error.
    #[serde(with = "finite")]
    pub z: f64,
    /// True if the level was used in the fit.
    pub used: bool,
    /// Reason for exclusion.
    pub excluded_because: Option<String>,
}

impl LevelReport {
    /// Returns true for a flat below the darks.
    pub(super) fn is_below_the_darks(&self) -> bool {
        !self.used && super::levels::is_darker(self.kind, self.mean_dn, self.var_dn2)
    }
}

/// Minimum number of standard errors below zero at which a negative variance is significant.
const BEYOND_CHANCE: f64 = 5.0;

/// Result of a noise evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct NoiseReport {
    /// A by the reweighted estimator, or by the curve if there is one; for a single lit level, by the bounds
    /// of the constant noise.
    pub gain_dn_per_e: Quantity,
    /// sigma_C^2 by the same estimator.
    pub constant_noise_var_dn2: Quantity,
    /// Read noise without quantisation, electrons: sqrt(sigma_C^2 - q^2/12) / A (eq. 27).
    pub read_noise_e: Quantity,
    /// Black level at zero exposure.
    pub offset_dn: Quantity,
    /// Source of the zero.
    pub offset_source: String,
    /// Chi-square of the reweighted fit.
    #[serde(with = "finite")]
    pub chi2: f64,
    /// Degrees of freedom of chi-square.
    pub dof: usize,
    /// Probability of a larger chi-square.
    #[serde(with = "finite")]
    pub q: f64,
    /// All estimators that the data allow.
    pub estimators: Vec<Estimate>,
    /// All levels.
    pub levels: Vec<LevelReport>,
    /// Covariances of neighbouring pixels or successive frames over the variance: the relative amount by
    /// which the gain is too low (below 0: too high, after sharpening). `None` if pixels and frames are
    /// independent.
    #[serde(default)]
    pub shared_noise_rel: Option<Quantity>,
    /// Faults of the data.
    #[serde(default)]
    pub data_faults: Vec<DataFault>,
    /// Notes for the reader.
    pub notes: Vec<String>,
}

/// Maximum share of the noise that pixels or frames have in common for the gain to be a result (a named
/// choice: most sensors have some crosstalk).
const MAX_SHARED: f64 = 0.05;

impl NoiseReport {
    /// Agreement of the levels with a line of nonnegative constant noise. Without degrees of freedom it
    /// holds.
    pub fn agreement(&self) -> Agreement {
        if self.constant_noise_is_negative() { Agreement::Fails } else { self.line() }
    }

    /// Agreement of the levels with a line of any intercept.
    pub fn line(&self) -> Agreement {
        Agreement::of(if self.q.is_nan() { 1.0 } else { self.q })
    }

    /// Returns true if the constant noise is negative beyond chance.
    pub(super) fn constant_noise_is_negative(&self) -> bool {
        let constant = &self.constant_noise_var_dn2;
        self.offset_source != NO_ZERO && constant.value < -BEYOND_CHANCE * constant.std_err
    }

    /// Returns true if nothing clearly contradicts the line, pixels and frames are independent, flats are
    /// brighter than darks, and frames are no averages of several.
    pub fn consistent(&self) -> bool {
        self.agreement() != Agreement::Fails
            && self.shared_noise_rel.as_ref().is_none_or(|shared| shared.value.abs() < MAX_SHARED)
            && self.gain_dn_per_e.value > 0.0
            && !self.levels.iter().any(LevelReport::is_below_the_darks)
            && !self.data_faults.iter().any(DataFault::is_of_means)
    }
}
