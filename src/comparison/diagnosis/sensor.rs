//! The linear sensor with all effects in the model.

use crate::dataset::Kind;
use crate::inference::Fitted;
use crate::number::{Quantity, six_digits};
use crate::observables::{Observations, expectations, variance};
use radcam_sim::effects::{self, Effect};
use radcam_sim::predict::{BaseParameters, Prediction};
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
    /// Temporal noise of the shortest darks, without quantisation and shot noise of the charge, over that
    /// read noise, by the model with its effects; null where the two agree within a hundredth. EMVA 1288
    /// counts the noise that pixels share, and the read noise above does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dark_noise_over_read_noise: Option<f64>,
    /// Median of the pixels' read noise, e, where single pixels are told apart.
    pub read_noise_median_e: Option<f64>,
    /// Standard deviation of the logarithm of the ordinary pixels' read noise.
    pub read_noise_log_spread: Option<f64>,
    /// Share of pixels noisier than that.
    pub noisy_pixel_share: Option<f64>,
    /// Dark current, e/s.
    pub dark_current_e_per_s: Option<Quantity>,
}

impl SensorValues {
    /// Widens the error of the gain by a share of it, and with it the errors of values in electrons.
    pub(super) fn with_open_gain(mut self, rel: f64) -> Self {
        let all = [&mut self.gain_dn_per_e, &mut self.read_noise_e, &mut self.dark_current_e_per_s];
        for q in all.into_iter().flatten() {
            q.std_err = q.std_err.hypot(rel * q.value);
        }
        self
    }
}

/// Minimum relative error of a value that the campaign does not determine.
pub(super) const NOT_DETERMINED: f64 = 0.3;

/// Returns true if the gain was fitted. Darks alone tell it only by the shot noise of their dark charge.
pub(super) fn tells_gain(fitted: &Fitted) -> bool {
    fitted.base_std_err[0] > 0.0
}

/// Returns the values of the linear sensor. If the model does not describe the campaign, their errors grow
/// with the misfit and cover the values of the equally good models `alternatives`.
pub(super) fn sensor(
    all: &Observations,
    whole: &Fitted,
    alternatives: &[&Fitted],
    error: f64,
) -> SensorValues {
    let (base, errors) = (&whole.base, &whole.base_std_err);
    let apart = |of: fn(&BaseParameters) -> f64| -> f64 {
        alternatives.iter().map(|other| (of(&other.base) - of(base)).abs()).fold(0.0, f64::max)
    };
    let of = |value: f64, std_err: f64, apart: f64, unit: &'static str| {
        let std_err = (std_err * error.max(1.0)).hypot(apart);
        (std_err.is_finite() && std_err < NOT_DETERMINED * value.abs())
            .then(|| Quantity::new(value, std_err, unit))
    };
    let mut dark_noise_over_read_noise = dark_noise(all, whole).filter(|ratio| (ratio - 1.0).abs() > SAID);
    let pixels = all.pixel_noise.filter(|p| p.log_spread.is_finite());
    if !tells_gain(whole) {
        let gain = base.gain_dn_per_e;
        return SensorValues {
            gain_dn_per_e: None,
            read_noise_e: None,
            read_noise_dn: of(
                gain * base.read_noise_e,
                gain * errors[1],
                apart(|b| b.gain_dn_per_e * b.read_noise_e),
                "DN",
            ),
            dark_noise_over_read_noise,
            read_noise_median_e: None,
            read_noise_log_spread: pixels.map(|p| p.log_spread),
            noisy_pixel_share: pixels.map(|p| p.noisy),
            dark_current_e_per_s: None,
        };
    }
    // The darks' variance is twice the read noise times its error.
    let shared = prediction(all, whole).unsure_dark_dn2
        / (2.0 * base.gain_dn_per_e.powi(2) * base.read_noise_e).max(f64::MIN_POSITIVE);
    let read_noise_std = errors[1].hypot(shared);
    let (mut rms_e, mut read_noise_e) =
        (base.read_noise_e, of(base.read_noise_e, read_noise_std, apart(|b| b.read_noise_e), "e"));
    // Noise that neighbours share almost entirely leaves next to none to single pixels: all of it is the read
    // noise.
    if read_noise_e.is_none()
        && let (Some(ratio), Some(shared_rel)) = (dark_noise_over_read_noise, shared_rel(whole))
    {
        let total_e = ratio * base.read_noise_e;
        rms_e = total_e;
        read_noise_e = of(total_e, total_e * shared_rel.hypot(errors[0] / base.gain_dn_per_e), 0.0, "e");
        dark_noise_over_read_noise = None;
    }
    SensorValues {
        read_noise_dn: None,
        dark_noise_over_read_noise,
        gain_dn_per_e: of(base.gain_dn_per_e, errors[0], apart(|b| b.gain_dn_per_e), "DN/e"),
        read_noise_median_e: pixels.filter(|_| read_noise_e.is_some()).map(|p| p.median * rms_e),
        read_noise_log_spread: pixels.map(|p| p.log_spread),
        noisy_pixel_share: pixels.map(|p| p.noisy),
        read_noise_e,
        dark_current_e_per_s: of(base.dark_e_per_s, errors[3], apart(|b| b.dark_e_per_s), "e/s")
            .filter(|_| !all.light_leaks_into_darks()),
    }
}

/// Returns a sentence on the gains of equally good models, if they differ by more than the fit's own error.
pub(super) fn range_of_gains(whole: &Fitted, alternatives: &[&Fitted], noise_tells: bool) -> Option<String> {
    let gains = || alternatives.iter().chain([&whole]).map(|model| model.base.gain_dn_per_e);
    let (least, most) = (gains().fold(f64::INFINITY, f64::min), gains().fold(0.0, f64::max));
    (tells_gain(whole) && most - least > whole.base_std_err[0]).then(|| {
        let more = if noise_tells { "; more frames in each set tell them apart by their noise" } else { "" };
        format!(
            "models that this campaign does not tell apart have system gains of {} to {} DN/e⁻, which the error of the gain covers{more}",
            six_digits(least),
            six_digits(most)
        )
    })
}

/// Returns the relative error of the noise that neighbours of a row share, if the model has it.
fn shared_rel(whole: &Fitted) -> Option<f64> {
    let place = whole.effects.iter().position(|(e, _)| e.id() == "read-noise-correlation")?;
    let (values, errors) = (&whole.effects[place].1, &whole.std_err[place]);
    Some(errors.get(1)? / values.get(1)?)
}

/// Returns what the model with its effects predicts.
fn prediction(all: &Observations, whole: &Fitted) -> Prediction {
    let list: Vec<(&dyn Effect, &[f64])> =
        whole.effects.iter().map(|(e, p)| (*e as &dyn Effect, p.as_slice())).collect();
    effects::predict(&all.campaign, &whole.base, &list)
}

/// Minimum relative difference from the read noise for the noise of darks to be reported.
const SAID: f64 = 0.01;

/// Computes the read noise of the shortest darks with all effects over that of single pixels. Charge and
/// quantisation are the same in both and are subtracted (Healey and Kondepudy 1994, eq. 35: variances add).
fn dark_noise(all: &Observations, whole: &Fitted) -> Option<f64> {
    let exposure = |set: usize| all.campaign.sets[set].exposure_s;
    let darks = || (0..all.kinds.len()).filter(|set| all.kinds[*set] == Kind::Dark);
    let shortest = darks().min_by(|a, b| exposure(*a).total_cmp(&exposure(*b)))?;
    let of = |effects: &[(&dyn Effect, &[f64])]| {
        let prediction = effects::predict(&all.campaign, &whole.base, effects);
        let expected = expectations(all, &prediction, |_| true);
        let own: Vec<f64> = all
            .list
            .iter()
            .zip(&expected)
            .filter(|(o, _)| o.is(&variance::Variance) && o.set == Some(shortest))
            .map(|(_, e)| e.value)
            .collect();
        (!own.is_empty()).then(|| own.iter().sum::<f64>() / own.len() as f64)
    };
    let list: Vec<(&dyn Effect, &[f64])> =
        whole.effects.iter().map(|(e, p)| (*e as &dyn Effect, p.as_slice())).collect();
    let (with, without) = (of(&list)?, of(&[])?);
    let read_dn2 = (whole.base.gain_dn_per_e * whole.base.read_noise_e).powi(2);
    let total = with - (without - read_dn2);
    (read_dn2 > 0.0 && total > 0.0).then(|| (total / read_dn2).sqrt())
}

/// Explains a negative dark current in words; `None` if it is not negative.
pub(super) fn below_zero(sensor: &SensorValues) -> Option<String> {
    let dark = sensor.dark_current_e_per_s.as_ref().filter(|d| d.value < -BELOW * d.std_err)?;
    Some(format!(
        "the dark current is {dark}, and there is none below zero: the darks of long exposures have less than those of short ones. Their \
         exposures may be exchanged, the black level may have fallen meanwhile, or the camera's clamp takes off more than it should"
    ))
}

/// Number of standard errors below zero that are no chance.
const BELOW: f64 = 5.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dark_current_below_zero_is_said() {
        let of = |value: f64| {
            let dark = Quantity::new(value, 2.0, "e/s");
            below_zero(&SensorValues {
                gain_dn_per_e: None,
                read_noise_e: None,
                read_noise_dn: None,
                dark_noise_over_read_noise: None,
                read_noise_median_e: None,
                read_noise_log_spread: None,
                noisy_pixel_share: None,
                dark_current_e_per_s: Some(dark),
            })
        };
        assert!(of(-64.0).is_some_and(|text| text.contains("-64.0 ± 2.0 e⁻/s")));
        assert!(of(-8.0).is_none() && of(64.0).is_none());
    }
}
