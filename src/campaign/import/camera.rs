//! Camera stated in headers, and colour patterns of mosaics that are kept whole.

use super::Facts;
use super::facts::feature_value;
use crate::dataset::CameraInfo;
use std::collections::BTreeMap;

/// Colour patterns of 2 x 2 pixels, row by row.
pub const PATTERNS: [&str; 4] = ["RGGB", "BGGR", "GRBG", "GBRG"];

/// Returns the PFNC name of a mosaic.
pub fn pixel_format(pattern: &str, bit_depth: u8) -> String {
    format!("Bayer{}{bit_depth}", pattern.get(..2).unwrap_or_default())
}

/// Feature that states the row order of a frame.
pub const ROW_ORDER: &str = "ROWORDER";
/// Value of `ROW_ORDER` for rows from bottom to top.
pub const BOTTOM_UP: &str = "BOTTOM-UP";
/// Value of `ROW_ORDER` for rows from top to bottom.
pub const TOP_DOWN: &str = "TOP-DOWN";

impl Facts {
    /// Returns the order of the rows, if it is stated.
    pub fn row_order(&self) -> Option<&'static str> {
        self.bottom_up.map(|up| if up { BOTTOM_UP } else { TOP_DOWN })
    }

    /// Returns the camera as stated by names and headers; unstated properties are empty or absent.
    pub fn camera_info(&self) -> CameraInfo {
        let text = |t: &Option<String>| t.clone().unwrap_or_default();
        let mut features: BTreeMap<String, toml::Value> =
            self.differs.iter().map(|(name, value)| (name.clone(), feature_value(value))).collect();
        if let Some(order) = self.row_order() {
            features.insert(ROW_ORDER.into(), order.into());
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
