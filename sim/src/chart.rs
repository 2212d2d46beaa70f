//! The squares of a chart.

use crate::surface::Texture;
use serde::{Deserialize, Serialize};

/// A square of the chart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Square {
    /// Name.
    pub name: String,
    /// Mean reflectance R relative to the card, one number, or one for each band.
    pub reflectance: Vec<f64>,
    /// Variation of the paint.
    #[serde(default)]
    pub texture: Texture,
}

/// Returns the six squares of a bench whose file names none: greys of a chart whose variation is unrelated to
/// their brightness.
pub(crate) fn default_chart() -> Vec<Square> {
    let square = |(name, reflectance, grain): (&str, f64, f64)| Square {
        name: name.into(),
        reflectance: vec![reflectance],
        texture: Texture { grain, grain_length_px: 0.7, ..Default::default() },
    };
    [
        ("white", 1.0, 0.006),
        ("neutral-8", 0.82, 0.036),
        ("neutral-6.5", 0.6, 0.012),
        ("neutral-5", 0.66, 0.048),
        ("neutral-3.5", 0.5, 0.024),
        ("black", 0.55, 0.06),
    ]
    .map(square)
    .into()
}
