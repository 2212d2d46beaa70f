//! Light on a pixel, in photons, from a photodiode before the camera.

use serde::{Deserialize, Serialize};

/// Planck's constant, J s, and the speed of light, m/s: exact in the SI since 2019.
const PLANCK_J_S: f64 = 6.626_070_15e-34;
const LIGHT_M_PER_S: f64 = 299_792_458.0;

/// Light at illumination 1, in `[bench.light]` of `dataset.toml` and `[light]` of a plan: the photon flux, or
/// the irradiance with wavelength and pixel area.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Light {
    /// Photons per pixel per second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub photon_flux_per_s: Option<f64>,
    /// Irradiance of the sensor, W/m^2 (1 uW/cm^2 is 0.01 W/m^2).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub irradiance_w_per_m2: Option<f64>,
    /// Centroid wavelength of the light, nm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wavelength_nm: Option<f64>,
    /// Area of a pixel, um^2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixel_area_um2: Option<f64>,
    /// Relative standard error of the irradiance as a whole: the photodiode's calibration. It is common to
    /// all levels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub irradiance_rel_std: Option<f64>,
}

impl Light {
    /// Returns the photons per pixel per second at illumination 1: the stated flux, or E A lambda / (h c)
    /// (EMVA 1288, release 4.0 Linear, eq. 3). None if neither is known.
    ///
    /// ```
    /// let light = radcam::light::Light {
    ///     irradiance_w_per_m2: Some(0.01), wavelength_nm: Some(530.0), pixel_area_um2: Some(11.9025), ..Default::default()
    /// };
    /// // The standard's handy form: 50.34 A lambda t E with um^2, um, ms and uW/cm^2.
    /// let handy_per_ms = 50.34 * 11.9025 * 0.530;
    /// assert!((light.photons_per_px_s().unwrap() / (handy_per_ms * 1000.0) - 1.0).abs() < 1e-4);
    /// ```
    pub fn photons_per_px_s(&self) -> Option<f64> {
        self.photon_flux_per_s.or_else(|| {
            let watt = self.irradiance_w_per_m2? * self.pixel_area_um2? * 1e-12;
            Some(watt * self.wavelength_nm? * 1e-9 / (PLANCK_J_S * LIGHT_M_PER_S))
        })
    }

    /// Checks that every stated number is above 0, and the relative error within 0 to 1.
    ///
    /// # Errors
    ///
    /// The first key that fails, with its value.
    pub fn check(&self) -> Result<(), String> {
        let all = [
            ("photon_flux_per_s", self.photon_flux_per_s, "photons per pixel per second"),
            ("irradiance_w_per_m2", self.irradiance_w_per_m2, "W/m^2"),
            ("wavelength_nm", self.wavelength_nm, "nm"),
            ("pixel_area_um2", self.pixel_area_um2, "um^2"),
        ];
        for (name, value, unit) in all {
            if let Some(x) = value.filter(|x| !(x.is_finite() && *x > 0.0)) {
                return Err(format!("{name} is {x} {unit}, and must be above 0"));
            }
        }
        match self.irradiance_rel_std {
            Some(s) if !(s.is_finite() && (0.0..1.0).contains(&s)) => {
                Err(format!("irradiance_rel_std is {s}, and must lie within 0 to 1"))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photons_need_all_three_or_the_flux() {
        let mut light =
            Light { irradiance_w_per_m2: Some(0.01), wavelength_nm: Some(530.0), ..Default::default() };
        assert_eq!(light.photons_per_px_s(), None);
        light.photon_flux_per_s = Some(7e5);
        assert_eq!(light.photons_per_px_s(), Some(7e5));
        assert!(light.check().is_ok());
        light.wavelength_nm = Some(-1.0);
        assert!(light.check().unwrap_err().contains("wavelength_nm is -1 nm"));
        light = Light { irradiance_rel_std: Some(3.0), ..Default::default() };
        assert!(light.check().unwrap_err().contains("irradiance_rel_std is 3"));
    }
}
