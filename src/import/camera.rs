//! The camera that headers tell of, and colour patterns of mosaics that are kept whole.

use super::Facts;
use super::facts::feature_value;
use crate::dataset::CameraInfo;
use std::collections::BTreeMap;

/// Colour patterns of two by two pixels, row by row.
pub const PATTERNS: [&str; 4] = ["RGGB", "BGGR", "GRBG", "GBRG"];

/// PFNC name of a mosaic.
pub fn pixel_format(pattern: &str, bit_depth: u8) -> String {
    format!("Bayer{}{bit_depth}", pattern.get(..2).unwrap_or_default())
}

impl Facts {
    /// The camera as names and headers state it; what they do not state is empty or absent.
    pub fn camera_info(&self) -> CameraInfo {
        let text = |t: &Option<String>| t.clone().unwrap_or_default();
        let mut features: BTreeMap<String, toml::Value> =
            self.differs.iter().map(|(name, value)| (name.clone(), feature_value(value))).collect();
        if let Some(up) = self.bottom_up {
            features.insert("ROWORDER".into(), if up { "BOTTOM-UP" } else { "TOP-DOWN" }.into());
        }
        self.camera.clone().unwrap_or_else(|| CameraInfo {
            vendor: text(&self.vendor),
            model: text(&self.model),
            serial: text(&self.serial),
            gain_db: self.gain_db,
            temperature_c: self.temperature_c,
            features,
            ..CameraInfo::default()
        })
    }
}
