//! Variance budget of a region (Fig. 4 of the paper): sources of the total variance, against intensity.

use serde::{Deserialize, Serialize};

/// Components of the variance of a raw region.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Parts {
    /// V_s of the surface.
    pub scene_variation: f64,
    /// Spatial variance of the dark reference, DN^2.
    pub dark_spatial_var_dn2: f64,
    /// sigma_K^2.
    pub k_var: f64,
    /// A, DN per electron.
    pub gain_dn_per_e: f64,
    /// sigma_C^2, DN^2.
    pub constant_noise_var_dn2: f64,
    /// Mean dark charge, DN.
    pub dark_dn: f64,
}

/// Variance budget at one intensity, DN^2.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Level {
    /// Mean above the dark reference, DN.
    pub mean_dn: f64,
    /// V_s mu^2.
    pub scene_dn2: f64,
    /// Spatial variance of the dark reference.
    pub dark_spatial_dn2: f64,
    /// sigma_K^2 mu^2.
    pub k_dn2: f64,
    /// sigma_C^2.
    pub constant_dn2: f64,
    /// A (mu + dark).
    pub shot_dn2: f64,
    /// Sum of the parts.
    pub total_dn2: f64,
}

/// Names of the parts, in the order of [`Level::shares`].
pub const NAMES: [&str; 5] = ["scene", "shot", "K", "constant noise", "dark, spatial"];

impl Level {
    /// Parts over the total, in the order of [`NAMES`].
    pub fn shares(&self) -> [f64; 5] {
        [self.scene_dn2, self.shot_dn2, self.k_dn2, self.constant_dn2, self.dark_spatial_dn2]
            .map(|part| part / self.total_dn2)
    }
}

impl Parts {
    /// Computes the budget at a mean above the dark reference, DN. Scene, dark current and K are independent
    /// of the temporal noise and of one another, so that variances add up (Section VII.C of the paper).
    ///
    /// ```
    /// use radcam::budget::Parts;
    /// let parts = Parts {
    ///     scene_variation: 1e-3, dark_spatial_var_dn2: 0.3, k_var: 1e-5,
    ///     gain_dn_per_e: 0.0034, constant_noise_var_dn2: 1.1, dark_dn: 10.7,
    /// };
    /// assert!(parts.at(5.0).shares()[3] > 0.7); // the constant noise leads in dim light
    /// assert!(parts.at(200.0).shares()[0] > 0.9); // and the scene in bright light
    /// ```
    pub fn at(&self, mean_dn: f64) -> Level {
        let square = mean_dn * mean_dn;
        let (scene_dn2, k_dn2) = (self.scene_variation.max(0.0) * square, self.k_var * square);
        let shot_dn2 = self.gain_dn_per_e * (mean_dn + self.dark_dn).max(0.0);
        let (dark_spatial_dn2, constant_dn2) = (self.dark_spatial_var_dn2, self.constant_noise_var_dn2);
        let total_dn2 = scene_dn2 + k_dn2 + shot_dn2 + dark_spatial_dn2 + constant_dn2;
        Level { mean_dn, scene_dn2, dark_spatial_dn2, k_dn2, constant_dn2, shot_dn2, total_dn2 }
    }

    /// Computes the budget at `n` even steps up to `top_dn`.
    pub fn levels(&self, top_dn: f64, n: usize) -> Vec<Level> {
        (1..=n).map(|i| self.at(top_dn * i as f64 / n as f64)).collect()
    }
}
