//! From lamp to charge: spectra, filters and the point spread of the lens (eq. 15 to 19 of the paper).

use crate::surface::gaussian;
use serde::{Deserialize, Serialize};

/// The lens.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Optics {
    /// Standard deviation of the point spread p, a Gaussian, pixels.
    pub psf_sigma_px: f64,
    /// Optical density of a neutral filter: the light falls by 10 to this power.
    pub nd_density: f64,
}

/// Wavelength band. Without bands the camera is monochrome: every spectrum is flat.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Band {
    /// Middle of the band, nm.
    pub wavelength_nm: f64,
    /// L: photons of the lamp in this band, any unit; only shares of the flux count.
    pub lamp: f64,
    /// t: transmission of lens and filters.
    pub transmission: f64,
    /// q: electrons per photon.
    pub quantum_efficiency: f64,
    /// R of the card.
    pub reflectance: f64,
    /// Point spread in this band, pixels; default: that of the lens.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psf_sigma_px: Option<f64>,
}

/// Contribution of one band: electrons per photon of the flux, and its point spread on the fine grid.
pub(crate) struct Share {
    /// L t q over the sum of L.
    pub electrons: f64,
    /// R of the card.
    pub card: f64,
    /// Index of the band in a surface's list of reflectances.
    pub band: usize,
    /// Point spread.
    pub kernel: Vec<f64>,
}

/// Converts the bands to shares of the flux; one flat band if there are none.
pub(crate) fn shares(optics: &Optics, bands: &[Band], quantum_efficiency: f64, fine: f64) -> Vec<Share> {
    let filter = libm::pow(10.0, -optics.nd_density);
    if bands.is_empty() {
        let kernel = gaussian(optics.psf_sigma_px * fine);
        return vec![Share { electrons: quantum_efficiency * filter, card: 1.0, band: 0, kernel }];
    }
    let lamp: f64 = bands.iter().map(|b| b.lamp).sum();
    let share = |(band, b): (usize, &Band)| Share {
        electrons: if lamp > 0.0 { b.lamp / lamp } else { 0.0 }
            * b.transmission
            * b.quantum_efficiency
            * filter,
        card: b.reflectance,
        band,
        kernel: gaussian(b.psf_sigma_px.unwrap_or(optics.psf_sigma_px) * fine),
    };
    bands.iter().enumerate().map(share).collect()
}
