//! Estimators with covariance.

pub mod cholesky;
pub mod line;
