//! `dataset.toml`: metadata of camera and bench.

use crate::features::{LeftOn, is_setting, left_on, same_value};
use crate::input::{echo, echo_lines};
use crate::light::Light;
use crate::pixel_format::PixelFormat;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name and major version of the file format.
pub const FORMAT: &str = "radcam-dataset/1";

/// Contents of `dataset.toml`. Unknown keys are ignored, not refused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// Camera and settings.
    pub camera: CameraInfo,
    /// Light, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench: Option<BenchInfo>,
    /// Row and column, 0 or 1, of the pixel of every 2 x 2 cell of the files that belongs to a frame:
    /// one colour of a mosaic. Size and pixel format of `camera` are then those of the plane.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plane: Option<[u8; 2]>,
    /// Guesses and notes of `import`, for files with incomplete metadata.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub import: Option<ImportInfo>,
}

/// The `[import]` table.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ImportInfo {
    /// Values that names and headers do not state or contradict, with their sets, as sentences.
    #[serde(default)]
    pub guessed: Vec<String>,
    /// Other findings in the files worth knowing, as sentences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// The `[camera]` table.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Manufacturer.
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
    /// Bit depth, 1 to 16.
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
    /// Automatic functions that could not be disabled, by GenICam name.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub still_automatic: Vec<String>,
    /// Features unknown to radcam whose names suggest an effect on radiometry; their values are in
    /// `features`.
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
    /// Relative standard uncertainty of each level; absent: unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub illumination_rel_std: Option<f64>,
    /// Light at illumination 1 in photons, measured with a photodiode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<Light>,
}

impl CameraInfo {
    /// Returns features known to have changed pixel values during capture.
    pub fn left_on(&self) -> Vec<LeftOn> {
        let text = |v: &toml::Value| v.as_str().map_or_else(|| v.to_string(), Into::into);
        let values = self.features.iter().map(|(name, value)| (name.clone(), text(value))).collect();
        left_on(&values, &self.still_automatic)
    }

    /// Describes the differences of another camera from this one: a calibration or dataset does not hold
    /// for them. Only properties known on both sides are compared.
    ///
    /// ```
    /// use radcam::dataset::CameraInfo;
    /// let of = |gain_db| CameraInfo { gain_db, ..Default::default() };
    /// assert_eq!(of(Some(0.0)).differences(&of(Some(6.0))), ["gain is 6 dB, and was 0 dB"]);
    /// assert!(of(Some(0.0)).differences(&of(None)).is_empty());
    /// ```
    pub fn differences(&self, now: &Self) -> Vec<String> {
        let pairs = self.properties().into_iter().zip(now.properties());
        let own = pairs.filter_map(|((name, was), (_, is))| difference(name, was, is));
        let settings = self.features.iter().filter(|(name, _)| is_setting(name));
        let settings = settings.filter_map(|(name, was)| {
            difference(&in_words(name), was.to_string(), now.features.get(name)?.to_string())
        });
        own.chain(settings).collect()
    }

    /// Lists properties that these frames do not state but this side knows, with its value: they cannot
    /// be compared. Only features that image files can state are included: gain, offset and binning.
    ///
    /// ```
    /// use radcam::dataset::CameraInfo;
    /// let of = |gain_db| CameraInfo { gain_db, ..Default::default() };
    /// assert_eq!(of(Some(6.0)).unstated(&of(None)), ["gain (6 dB)"]);
    /// assert!(of(None).unstated(&of(None)).is_empty());
    /// ```
    pub fn unstated(&self, now: &Self) -> Vec<String> {
        let absent = |name: &str, was: String, is: String| {
            (!was.is_empty() && is.is_empty()).then(|| format!("{name} ({})", was.trim_matches('"')))
        };
        let pairs = self.properties().into_iter().zip(now.properties());
        let own = pairs.filter_map(|((name, was), (_, is))| match name {
            // These are read from the pixels if the file does not state them.
            "size" | "bit depth" => None,
            "pixel format" if !self.is_mosaic() => None,
            _ => absent(name, was, is),
        });
        let features = IN_FILES.iter().filter_map(|name| {
            let is = now.features.get(*name).map(ToString::to_string).unwrap_or_default();
            absent(&in_words(name), self.features.get(*name)?.to_string(), is)
        });
        own.chain(features).collect()
    }

    /// Returns name and value, as text, of the compared properties; empty if unknown.
    fn properties(&self) -> [(&'static str, String); 8] {
        let number = |x: Option<f64>, unit: &str| x.map_or(String::new(), |x| format!("{x} {unit}"));
        let size = if self.width * self.height == 0 {
            String::new()
        } else {
            format!("{} x {} px", self.width, self.height)
        };
        // Packing changes the bytes of a frame, not its codes.
        let codes = match PixelFormat::from_name(&self.pixel_format) {
            Ok(f) if f.name().starts_with("Mono") => format!("Mono of {} bits", f.bits()),
            _ => self.pixel_format.clone(),
        };
        [
            ("vendor", self.vendor.clone()),
            ("model", self.model.clone()),
            ("serial", self.serial.clone()),
            ("size", size),
            ("bit depth", if self.bit_depth == 0 { String::new() } else { self.bit_depth.to_string() }),
            ("pixel format", codes),
            ("gain", number(self.gain_db, "dB")),
            ("black level", number(self.black_level_dn, "DN")),
        ]
    }

    /// Returns true for a colour mosaic of 2 x 2 pixels. Formats that radcam cannot unpack count too:
    /// files hold mosaics of 14 bits.
    pub fn is_mosaic(&self) -> bool {
        self.pixel_format.get(..5).is_some_and(|start| start.eq_ignore_ascii_case("Bayer"))
    }

    /// Refuses impossible numbers.
    ///
    /// # Errors
    ///
    /// Key and value of the impossible number.
    pub fn check(&self) -> Result<(), String> {
        /// Maximum gain, dB: 200 dB is 10^10, which no amplifier has.
        const MAX_GAIN_DB: f64 = 200.0;
        let bounds = [
            ("gain_db", self.gain_db, (-MAX_GAIN_DB, MAX_GAIN_DB), "dB"),
            ("black_level_dn", self.black_level_dn, (-65_535.0, 65_535.0), "DN"),
        ];
        for (name, value, (min, max), unit) in bounds {
            if let Some(value) = value.filter(|v| !(min..=max).contains(v)) {
                return Err(format!(
                    "camera.{name} is {value} {unit}, and must lie within {min} to {max} {unit}"
                ));
            }
        }
        Self::check_temperature(self.temperature_c).map_err(|message| format!("camera.{message}"))
    }

    /// Refuses a temperature below absolute zero or above the melting point of silicon.
    pub(crate) fn check_temperature(temperature_c: Option<f64>) -> Result<(), String> {
        match temperature_c {
            Some(c) if !(-273.15..=1414.0).contains(&c) => {
                Err(format!("temperature_c is {c} °C, and must lie within -273.15 to 1414 °C"))
            }
            _ => Ok(()),
        }
    }

    /// Returns the maximum code, DN.
    pub fn full_scale_dn(&self) -> u16 {
        ((1u32 << self.bit_depth.min(16)) - 1) as u16
    }
}

/// Features stated in headers of image files: gain and offset in camera units, and binning.
const IN_FILES: [&str; 4] = ["GainRaw", "BlackLevelRaw", "BinningHorizontal", "BinningVertical"];

/// Returns the name of a feature as users of image files know it.
fn in_words(feature: &str) -> String {
    match feature {
        "GainRaw" => "gain setting (GainRaw)".into(),
        "BlackLevelRaw" => "offset setting (BlackLevelRaw)".into(),
        other => other.into(),
    }
}

fn difference(name: &str, was: String, is: String) -> Option<String> {
    let differs = !was.is_empty() && !is.is_empty() && !same_value(&was, &is);
    differs.then(|| format!("{name} is {}, and was {}", echo(&is), echo(&was)))
}

impl Manifest {
    /// Creates a manifest without a bench.
    pub fn new(camera: CameraInfo) -> Self {
        Self { format: FORMAT.into(), camera, bench: None, plane: None, import: None }
    }

    /// Returns the guesses and findings of `import` as notes of a result.
    pub fn import_notes(&self) -> Vec<String> {
        let Some(import) = &self.import else { return Vec::new() };
        // The first of many guesses of one kind represents all.
        let key = |text: &str| text.split_once(" of ").map_or(text, |(key, _)| key).to_string();
        let mut kinds: Vec<(String, &String, usize)> = Vec::new();
        for text in &import.guessed {
            match kinds.iter_mut().find(|(own, ..)| *own == key(text)) {
                Some((.., more)) => *more += 1,
                None => kinds.push((key(text), text, 0)),
            }
        }
        let guessed = kinds.into_iter().map(|(_, text, more)| match more {
            0 => format!("guessed by import: {text}"),
            _ => {
                format!("guessed by import: {text}; {more} more of this kind in dataset.toml under [import]")
            }
        });
        guessed.chain(import.notes.iter().map(|text| format!("found by import: {text}"))).collect()
    }

    /// Describes the differences of another campaign in camera, settings and light; none if both can be
    /// combined.
    pub fn differences(&self, now: &Self) -> Vec<String> {
        let mut found = self.camera.differences(&now.camera);
        let unit = |m: &Self| m.bench.as_ref().map(|b| b.illumination_unit.clone()).unwrap_or_default();
        found.extend(difference("illumination_unit", unit(self), unit(now)));
        let plane = |m: &Self| m.plane.map_or("of all pixels".into(), |[y, x]| format!("{y},{x}"));
        found.extend(difference("plane", plane(self), plane(now)));
        found
    }

    /// Reads and checks a manifest; the error is a sentence.
    ///
    /// # Errors
    ///
    /// Description of the fault.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        let table: toml::Table = toml::from_str(text).map_err(|e| echo_lines(&e.to_string()))?;
        match table.get("format").and_then(|f| f.as_str()) {
            Some(FORMAT) => {}
            Some(other) => {
                return Err(format!("format is \"{}\", and this program reads \"{FORMAT}\"", echo(other)));
            }
            None => return Err(format!("has no line format = \"{FORMAT}\"")),
        }
        let manifest: Self = toml::from_str(text).map_err(|e| echo_lines(&e.to_string()))?;
        let camera = &manifest.camera;
        if !(1..=16).contains(&camera.bit_depth) {
            return Err(format!("camera.bit_depth is {}, and must lie within 1 to 16", camera.bit_depth));
        }
        if let Ok(format) = PixelFormat::from_name(&camera.pixel_format)
            && format.bits() < camera.bit_depth
        {
            return Err(format!(
                "camera.pixel_format is {format}, of {} bits, and camera.bit_depth is {}: codes of one depth",
                format.bits(),
                camera.bit_depth
            ));
        }
        if camera.width == 0 || camera.height == 0 || camera.width.max(camera.height) > 1 << 16 {
            return Err(format!("camera size {} x {} px makes no image", camera.width, camera.height));
        }
        camera.check()?;
        if let Some(plane) = manifest.plane.filter(|p| p.iter().any(|k| *k > 1)) {
            let message =
                format!("plane is {plane:?}, and is a row and a column of a 2 x 2 cell, each 0 or 1");
            return Err(message);
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
            ("= 12", "= 12\npixel_format = \"Mono8\"", "Mono8, of 8 bits, and camera.bit_depth is 12"),
            ("[camera]", "plane = [0, 2]\n[camera]", "plane is [0, 2]"),
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
        // A property unknown on one side is not a difference.
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
