//! Estimators with covariance.

pub mod line;
