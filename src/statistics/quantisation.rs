//! Quantisation noise, in squared steps.

/// Variance of quantisation (EMVA 1288 release 4, section 2.4; q^2 / 12, eq. 27 of Healey and Kondepudy).
pub(crate) const QUANTISATION_DN2: f64 = 1.0 / 12.0;
/// Temporal variance of darks below which quantisation hides the noise (EMVA 1288 release 4, appendix C.4).
pub(crate) const SMALLEST_DARK_DN2: f64 = 0.24;
/// Temporal variance below which rounding hides the noise, DN^2 (a named choice): 0.27 DN of normal noise
/// about the middle of a code reaches it.
pub(crate) const QUIET_DN2: f64 = 0.06;
