//! `dataset.toml`: what camera and bench said of themselves.

use crate::features::{LeftOn, is_setting, left_on, same_value};
use crate::light::Light;
use crate::pixel_format::PixelFormat;
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
    /// What `import` made of files that did not say everything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub import: Option<ImportInfo>,
}

/// The `[import]` table.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ImportInfo {
    /// Values that names and headers do not state or contradict, with their sets, in sentences.
    #[serde(default)]
    pub guessed: Vec<String>,
    /// What else was found in the files and should be known, in sentences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
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
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct BenchInfo {
    /// `relative` or `photons/px/s`.
    pub illumination_unit: String,
    /// How well each level is known, relative; absent: not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub illumination_rel_std: Option<f64>,
    /// The light at illumination 1 in photons, where a photodiode told it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<Light>,
}

impl CameraInfo {
    /// Features that changed pixel values while the frames were taken, as far as is known.
    pub fn left_on(&self) -> Vec<LeftOn> {
        let text = |v: &toml::Value| v.as_str().map_or_else(|| v.to_string(), Into::into);
        let values = self.features.iter().map(|(name, value)| (name.clone(), text(value))).collect();
        left_on(&values, &self.still_automatic)
    }

    /// What a camera has now and had otherwise here, in words: what a calibration or a dataset does not hold for.
    /// Compared are those properties that both sides know.
    ///
    /// ```
    /// use radcam::dataset::CameraInfo;
    /// let of = |gain_db| CameraInfo { gain_db, ..Default::default() };
    /// assert_eq!(of(Some(0.0)).differences(&of(Some(6.0))), ["gain is 6 dB, and was 0 dB"]);
    /// assert!(of(Some(0.0)).differences(&of(None)).is_empty());
    /// ```
    pub fn differences(&self, now: &Self) -> Vec<String> {
        let number = |x: Option<f64>, unit: &str| x.map_or(String::new(), |x| format!("{x} {unit}"));
        let size = |c: &Self| {
            if c.width * c.height == 0 { String::new() } else { format!("{} x {} px", c.width, c.height) }
        };
        let bits = |c: &Self| if c.bit_depth == 0 { String::new() } else { c.bit_depth.to_string() };
        // Packing changes the bytes of a frame, and not its codes.
        let codes = |c: &Self| match PixelFormat::from_name(&c.pixel_format) {
            Ok(f) if f.name().starts_with("Mono") => format!("Mono of {} bits", f.bits()),
            _ => c.pixel_format.clone(),
        };
        let own = [
            ("vendor", self.vendor.clone(), now.vendor.clone()),
            ("model", self.model.clone(), now.model.clone()),
            ("serial", self.serial.clone(), now.serial.clone()),
            ("size", size(self), size(now)),
            ("bit depth", bits(self), bits(now)),
            ("pixel format", codes(self), codes(now)),
            ("gain", number(self.gain_db, "dB"), number(now.gain_db, "dB")),
            ("black level", number(self.black_level_dn, "DN"), number(now.black_level_dn, "DN")),
        ];
        let settings = self.features.iter().filter(|(name, _)| is_setting(name));
        let settings = settings
            .filter_map(|(name, was)| difference(name, was.to_string(), now.features.get(name)?.to_string()));
        own.into_iter().filter_map(|(name, was, is)| difference(name, was, is)).chain(settings).collect()
    }

    /// Largest code, DN.
    pub fn full_scale_dn(&self) -> u16 {
        ((1u32 << self.bit_depth.min(16)) - 1) as u16
    }
}

fn difference(name: &str, was: String, is: String) -> Option<String> {
    let differs = !was.is_empty() && !is.is_empty() && !same_value(&was, &is);
    differs.then(|| format!("{name} is {is}, and was {was}"))
}

impl Manifest {
    /// A manifest without a bench.
    pub fn new(camera: CameraInfo) -> Self {
        Self { format: FORMAT.into(), camera, bench: None, import: None }
    }

    /// What `import` guessed and found, as notes of a result.
    pub fn import_notes(&self) -> Vec<String> {
        let Some(import) = &self.import else { return Vec::new() };
        let guessed = import.guessed.iter().map(|text| format!("guessed by import: {text}"));
        guessed.chain(import.notes.iter().map(|text| format!("found by import: {text}"))).collect()
    }

    /// What camera, settings and light of another campaign have otherwise, in words: none where the two can be taken together.
    pub fn differences(&self, now: &Self) -> Vec<String> {
        let mut found = self.camera.differences(&now.camera);
        let unit = |m: &Self| m.bench.as_ref().map(|b| b.illumination_unit.clone()).unwrap_or_default();
        found.extend(difference("illumination_unit", unit(self), unit(now)));
        found
    }

    /// Reads and checks; the error is a sentence.
    ///
    /// # Errors
    ///
    /// What is wrong with it, in words.
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
        if let Some(light) = manifest.bench.as_ref().and_then(|b| b.light) {
            light.check().map_err(|message| format!("bench.light.{message}"))?;
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

    fn camera(info: (usize, usize)) -> CameraInfo {
        CameraInfo { width: info.1, height: info.0, bit_depth: 12, ..Default::default() }
    }

    #[test]
    fn a_calibration_holds_for_its_own_geometry_and_depth() {
        let with = |binning: i64, bit_depth: u8| CameraInfo {
            bit_depth,
            features: [("BinningHorizontal".to_string(), binning.into()), ("Gamma".into(), "1".into())]
                .into(),
            ..Default::default()
        };
        assert!(with(1, 12).differences(&with(1, 12)).is_empty());
        assert_eq!(with(1, 12).differences(&with(2, 12)), ["BinningHorizontal is 2, and was 1"]);
        assert_eq!(with(1, 8).differences(&with(1, 16)), ["bit depth is 16, and was 8"]);
        // What one side does not know is no difference.
        assert!(with(1, 12).differences(&CameraInfo::default()).is_empty());
    }

    #[test]
    fn another_camera_is_told_by_what_differs() {
        let a = CameraInfo { serial: "1".into(), gain_db: Some(0.0), ..camera((3, 4)) };
        let b = CameraInfo {
            serial: "2".into(),
            gain_db: Some(6.0),
            black_level_dn: Some(1.0),
            ..camera((3, 5))
        };
        assert_eq!(a.differences(&a), Vec::<String>::new());
        let said = a.differences(&b).join("; ");
        assert_eq!(
            said,
            "serial is 2, and was 1; size is 5 x 3 px, and was 4 x 3 px; gain is 6 dB, and was 0 dB"
        );
    }
}
