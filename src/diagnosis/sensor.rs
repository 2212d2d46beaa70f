//! The linear sensor with all effects in the model.

use crate::inference::Fitted;
use crate::number::Quantity;
use crate::observables::Observations;
use serde::{Deserialize, Serialize};

/// The linear sensor with all effects in the model; null where the campaign does not determine a value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct SensorValues {
    /// System gain (EMVA 1288: K), DN/e.
    pub gain_dn_per_e: Option<Quantity>,
    /// Read noise, root mean square over the pixels, e.
    pub read_noise_e: Option<Quantity>,
    /// Read noise in DN, only where the gain is not determined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_dn: Option<Quantity>,
    /// Median of the pixels' read noise, e, where single pixels are told apart.
    pub read_noise_median_e: Option<f64>,
    /// Standard deviation of the logarithm of the ordinary pixels' read noise.
    pub read_noise_log_spread: Option<f64>,
    /// Share of pixels noisier than that.
    pub noisy_pixel_share: Option<f64>,
    /// Dark current, e/s.
    pub dark_current_e_per_s: Option<Quantity>,
}

/// Error of a value, relative, from which on the campaign does not determine it.
const NOT_DETERMINED: f64 = 0.3;

/// True if the gain was fitted. Darks alone tell it only by the shot noise of their dark charge.
pub(super) fn tells_gain(fitted: &Fitted) -> bool {
    fitted.base_std_err[0] > 0.0
}

/// Values of the linear sensor; where a model does not describe the campaign their errors grow with the misfit.
pub(super) fn sensor(all: &Observations, whole: &Fitted, error: f64) -> SensorValues {
    let (base, errors) = (&whole.base, &whole.base_std_err);
    let of = |value: f64, std_err: f64, unit: &'static str| {
        let std_err = std_err * error.max(1.0);
        (std_err.is_finite() && std_err < NOT_DETERMINED * value.abs())
            .then(|| Quantity::new(value, std_err, unit))
    };
    let pixels = all.pixel_noise.filter(|p| p.log_spread.is_finite());
    if !tells_gain(whole) {
        let gain = base.gain_dn_per_e;
        return SensorValues {
            gain_dn_per_e: None,
            read_noise_e: None,
            read_noise_dn: of(gain * base.read_noise_e, gain * errors[1], "DN"),
            read_noise_median_e: None,
            read_noise_log_spread: pixels.map(|p| p.log_spread),
            noisy_pixel_share: pixels.map(|p| p.noisy),
            dark_current_e_per_s: None,
        };
    }
    let read_noise_e = of(base.read_noise_e, errors[1], "e");
    SensorValues {
        read_noise_dn: None,
        gain_dn_per_e: of(base.gain_dn_per_e, errors[0], "DN/e"),
        read_noise_median_e: pixels.filter(|_| read_noise_e.is_some()).map(|p| p.median * base.read_noise_e),
        read_noise_log_spread: pixels.map(|p| p.log_spread),
        noisy_pixel_share: pixels.map(|p| p.noisy),
        read_noise_e,
        dark_current_e_per_s: of(base.dark_e_per_s, errors[3], "e/s"),
    }
}
