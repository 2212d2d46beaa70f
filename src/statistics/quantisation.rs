//! Quantisation noise, in squared steps.

/// Variance of quantisation (EMVA 1288 release 4, section 2.4; q^2 / 12, eq. 27 of Healey and Kondepudy).
pub(crate) const QUANTISATION_DN2: f64 = 1.0 / 12.0;
/// Temporal variance of darks below which quantisation hides the noise (EMVA 1288 release 4, appendix C.4).
pub(crate) const SMALLEST_DARK_DN2: f64 = 0.24;
/// Temporal variance below which rounding hides the noise, DN^2 (a named choice): 0.27 DN of normal noise
/// about the middle of a code reaches it.
pub(crate) const QUIET_DN2: f64 = 0.06;

/// Returns the error of a temporal variance by rounding, DN^2, root mean square over the levels, for a
/// measured variance: the first term of the characteristic function, (4 v + 1 / pi^2) exp(-2 pi^2 v) for
/// noise of variance v (Widrow and Kollar 2008, ch. 4).
pub(crate) fn error_of_variance_dn2(measured_dn2: f64) -> f64 {
    let (noise, square) = ((measured_dn2 - QUANTISATION_DN2).max(0.0), std::f64::consts::PI.powi(2));
    (4.0 * noise + 1.0 / square) * (-2.0 * square * noise).exp() / std::f64::consts::SQRT_2
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Variance of rounded normal noise from the shares of the codes, over a hundred levels between two
    /// codes.
    #[test]
    fn the_error_is_that_of_rounded_noise() {
        use statrs::distribution::{ContinuousCDF, Normal};
        for noise in [0.05f64, 0.1, 0.15, 0.25] {
            let normal = Normal::new(0.0, noise.sqrt()).expect("a standard deviation above 0");
            let variance = |level: f64| {
                let codes = (-6..=7).map(|c| {
                    let c = f64::from(c);
                    (c, normal.cdf(c + 0.5 - level) - normal.cdf(c - 0.5 - level))
                });
                let (mean, square) =
                    codes.fold((0.0, 0.0), |(m, s), (c, share)| (m + share * c, s + share * c * c));
                square - mean * mean
            };
            let errors = (0..100).map(|k| variance(f64::from(k) / 100.0) - noise - QUANTISATION_DN2);
            let rms = (errors.map(|e| e * e).sum::<f64>() / 100.0).sqrt();
            let said = error_of_variance_dn2(noise + QUANTISATION_DN2);
            assert!((rms / said - 1.0).abs() < 0.25, "{noise}: {rms} and {said}");
        }
    }
}
