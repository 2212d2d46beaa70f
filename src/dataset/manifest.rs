//! `dataset.toml`: what camera and bench said of themselves.

use crate::camera::features::{LeftOn, is_setting, left_on, same_value};
use crate::camera::{Identity, Settings};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name and major version of the format.
pub const FORMAT: &str = "radcam-dataset/1";

/// `dataset.toml`. Keys that this version does not know are kept out of the way, not refused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// The camera and its settings.
    pub camera: CameraInfo,
    /// The light, where known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench: Option<BenchInfo>,
}

/// The `[camera]` table.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Maker.
    #[serde(default)]
    pub vendor: String,
    /// Model name.
    #[serde(default)]
    pub model: String,
    /// Serial number.
    #[serde(default)]
    pub serial: String,
    /// Columns, pixels.
    pub width: usize,
    /// Rows, pixels.
    pub height: usize,
    /// Bits of a code, 1 to 16.
    pub bit_depth: u8,
    /// PFNC name.
    #[serde(default)]
    pub pixel_format: String,
    /// Gain, dB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain_db: Option<f64>,
    /// Black level, DN.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub black_level_dn: Option<f64>,
    /// Sensor temperature at the start, degrees Celsius.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Firmware version.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub firmware: Option<String>,
    /// Automatic functions that could not be switched off, by their GenICam names.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub still_automatic: Vec<String>,
    /// Features of which radcam knows nothing and whose names speak of radiometry; their values stand in `features`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unlisted_features: Vec<String>,
    /// Other settings by their GenICam names, as read back.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub features: BTreeMap<String, toml::Value>,
}

/// The `[bench]` table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BenchInfo {
    /// `relative` or `photons/px/s`.
    pub illumination_unit: String,
    /// How well each level is known, relative; absent: not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub illumination_rel_std: Option<f64>,
}

impl CameraInfo {
    /// What a camera says of itself and how it is set; nothing of its automatic functions and further features.
    pub fn of(identity: &Identity, settings: &Settings) -> Self {
        Self {
            vendor: identity.vendor.clone(),
            model: identity.model.clone(),
            serial: identity.serial.clone(),
            width: settings.region.width as usize,
            height: settings.region.height as usize,
            bit_depth: settings.pixel_format.bits(),
            pixel_format: settings.pixel_format.name().into(),
            gain_db: settings.gain_db,
            black_level_dn: settings.black_level_dn,
            temperature_c: settings.temperature_c,
            firmware: identity.firmware.clone(),
            ..Self::default()
        }
    }

    /// Features that changed pixel values while the frames were taken, as far as is known.
    pub fn left_on(&self) -> Vec<LeftOn> {
        let text = |v: &toml::Value| v.as_str().map_or_else(|| v.to_string(), Into::into);
        let values = self.features.iter().map(|(name, value)| (name.clone(), text(value))).collect();
        left_on(&values, &self.still_automatic)
    }

    /// Largest code, DN.
    pub fn full_scale_dn(&self) -> u16 {
        ((1u32 << self.bit_depth.min(16)) - 1) as u16
    }
}

impl Manifest {
    /// A manifest without a bench.
    pub fn new(camera: CameraInfo) -> Self {
        Self { format: FORMAT.into(), camera, bench: None }
    }

    /// The first setting of the camera that another manifest has otherwise, in words: what one dataset, or a calibration, holds for.
    pub fn differs_from(&self, other: &Self) -> Option<String> {
        let (a, b) = (&self.camera, &other.camera);
        let shown = |v: Option<f64>| v.map_or("none".into(), |v| v.to_string());
        let fields = [
            ("vendor", a.vendor.clone(), b.vendor.clone()),
            ("model", a.model.clone(), b.model.clone()),
            ("serial", a.serial.clone(), b.serial.clone()),
            ("size", format!("{} x {} px", a.width, a.height), format!("{} x {} px", b.width, b.height)),
            ("bit_depth", a.bit_depth.to_string(), b.bit_depth.to_string()),
            ("gain_db", shown(a.gain_db), shown(b.gain_db)),
            ("black_level_dn", shown(a.black_level_dn), shown(b.black_level_dn)),
        ];
        let unit = |m: &Self| m.bench.as_ref().map(|b| b.illumination_unit.clone()).unwrap_or_default();
        let light = ("illumination_unit", unit(self), unit(other));
        let features = a.features.iter().filter(|(name, _)| is_setting(name)).filter_map(|(name, value)| {
            let other = b.features.get(name)?;
            Some((name.as_str(), value.to_string(), other.to_string()))
        });
        let mut all = fields.into_iter().chain([light]).chain(features);
        all.find(|(_, a, b)| !same_value(a, b))
            .map(|(name, a, b)| format!("has another {name} ({b}, not {a})"))
    }

    /// Reads and checks; the error is for a person.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        let table: toml::Table = toml::from_str(text).map_err(|e| e.to_string().trim_end().to_string())?;
        match table.get("format").and_then(|f| f.as_str()) {
            Some(FORMAT) => {}
            Some(other) => {
                return Err(format!("format is \"{other}\", and this program reads \"{FORMAT}\""));
            }
            None => return Err(format!("has no line format = \"{FORMAT}\"")),
        }
        let manifest: Self = toml::from_str(text).map_err(|e| e.to_string().trim_end().to_string())?;
        let camera = &manifest.camera;
        if !(1..=16).contains(&camera.bit_depth) {
            return Err(format!("camera.bit_depth is {}, and must lie within 1 to 16", camera.bit_depth));
        }
        if camera.width == 0 || camera.height == 0 || camera.width.max(camera.height) > 1 << 16 {
            return Err(format!("camera size {} x {} px makes no image", camera.width, camera.height));
        }
        if let Some(std) = manifest.bench.as_ref().and_then(|b| b.illumination_rel_std)
            && !(std.is_finite() && std >= 0.0)
        {
            return Err(format!("bench.illumination_rel_std is {std}, and must not be below 0"));
        }
        Ok(manifest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_named() {
        let good = "format = \"radcam-dataset/1\"\n[camera]\nwidth = 4\nheight = 3\nbit_depth = 12\n";
        assert_eq!(Manifest::from_toml(good).unwrap().camera.full_scale_dn(), 4095);
        for (from, to, part) in [
            ("dataset/1", "dataset/2", "radcam-dataset/2"),
            ("format", "fromat", "no line format"),
            ("= 12", "= 17", "bit_depth is 17"),
            ("width = 4", "width = 0", "0 x 3 px"),
            ("height", "hight", "height"),
            ("[camera]", "[camera", "camera"),
        ] {
            let message = Manifest::from_toml(&good.replace(from, to)).expect_err(to);
            assert!(message.contains(part), "{message}");
        }
    }
}
