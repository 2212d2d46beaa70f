//! Cameras with electron multiplication before readout: the multiplication is random and adds noise to
//! the photon noise.

use super::CameraInfo;
use crate::number::{six_digits, with_unit};

/// Names of features that state the multiplication gain, in FITS headers, file names and GenICam
/// cameras.
const NAMES: [&str; 2] = ["EMGAIN", "EMGain"];
/// Number of stages of a multiplication register (Robbins and Hadwen 2003, IEEE Trans. Electron Devices
/// 50, 1227; commercial cameras have 500 to 600).
const STAGES: f64 = 536.0;

/// Gain of an electron multiplication.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ElectronMultiplication {
    gain: f64,
}

impl ElectronMultiplication {
    /// Reads the multiplication gain stated by the camera's features; `None` without one, or with a
    /// conventional amplifier.
    pub fn of(camera: &CameraInfo) -> Option<Self> {
        let text = |name: &str| {
            let value = camera.features.get(name)?;
            Some(value.as_str().map_or_else(|| value.to_string(), Into::into))
        };
        let gain: f64 = NAMES.iter().find_map(|name| text(name)?.trim().parse().ok())?;
        let other = text("OUTPTAMP").is_some_and(|amplifier| amplifier.to_lowercase().starts_with("conv"));
        (gain > 1.0 && gain.is_finite() && !other).then_some(Self { gain })
    }

    /// Returns the excess noise factor F^2: variance of the light signal over that of photons (same
    /// source, eq. 11).
    pub fn excess(self) -> f64 {
        2.0 * (self.gain - 1.0) * self.gain.powf(-(STAGES + 1.0) / STAGES) + self.gain.recip()
    }

    /// Describes the error of gains and read noises.
    pub fn in_words(self) -> String {
        let times = six_digits((100.0 * self.excess()).round() / 100.0);
        format!(
            "the camera multiplies electrons before it reads them (EM gain {}): the variance of light is {times} times that of photons (Robbins \
             and Hadwen 2003), the system gain {times} times lower than what variance and mean say, and read noise in electrons {times} times \
             higher",
            six_digits(self.gain),
        )
    }

    /// Describes that error, with the system gain computed from the photon-transfer gain and its
    /// standard error, DN/e.
    pub fn with_gain(self, gain: f64, std_err: f64) -> String {
        let excess = self.excess();
        let own = with_unit(gain / excess, std_err / excess, "DN/e");
        format!("{}: the system gain is {own}", self.in_words())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(features: &[(&str, toml::Value)]) -> CameraInfo {
        let features = features.iter().map(|(name, value)| (name.to_string(), value.clone())).collect();
        CameraInfo { features, ..CameraInfo::default() }
    }

    /// F^2 is 2 at high gain and 1 at gain one (Robbins and Hadwen 2003, fig. 2).
    #[test]
    fn excess_noise_goes_from_one_to_two() {
        let excess = |gain: f64| ElectronMultiplication { gain }.excess();
        assert!(
            (excess(1.0) - 1.0).abs() < 1e-12 && (excess(300.0) - 1.98).abs() < 0.02,
            "{}",
            excess(300.0)
        );
        let words = ElectronMultiplication { gain: 300.0 }.with_gain(25.64, 0.03);
        assert!(words.contains("system gain is 12.9"), "{words}");
    }

    #[test]
    fn a_conventional_amplifier_multiplies_nothing() {
        let gain = ("EMGAIN", toml::Value::from(200));
        assert!(ElectronMultiplication::of(&camera(std::slice::from_ref(&gain))).is_some());
        assert!(ElectronMultiplication::of(&camera(&[gain, ("OUTPTAMP", "Conventional".into())])).is_none());
        assert!(ElectronMultiplication::of(&camera(&[("EMGain", 1.into())])).is_none());
    }
}
