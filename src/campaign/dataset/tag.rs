//! Metadata of a frame: settings and camera, as JSON in the ImageDescription of its file.

use super::{CameraInfo, Dataset, FrameRow, Kind};
use serde::{Deserialize, Serialize};
use std::io::BufReader;
use std::path::Path;
use tiff::tags::Tag;

/// Name and major version of the metadata format.
pub const FORMAT: &str = "radcam-frame/1";

/// Name and major version of the description of corrected frames.
pub const CORRECTED: &str = "radcam-corrected/1";

/// Returns true if the ImageDescription marks a frame as already corrected by radcam.
pub fn is_corrected(path: &Path) -> bool {
    let format = description(path).and_then(|text| {
        let value: serde_json::Value = serde_json::from_str(text.trim_end_matches('\0')).ok()?;
        Some(value.get("format")?.as_str()? == CORRECTED)
    });
    format.unwrap_or(false)
}

/// Reads the ImageDescription of a TIFF.
fn description(path: &Path) -> Option<String> {
    let file = crate::input::open(path).ok()?;
    let mut decoder = tiff::decoder::Decoder::new(BufReader::new(file)).ok()?;
    decoder.get_tag_ascii_string(Tag::ImageDescription).ok()
}

/// Settings and camera of a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameTag {
    /// [`FORMAT`].
    pub format: String,
    /// Kind of the frame.
    pub kind: Kind,
    /// Number of the set.
    pub set: u32,
    /// Index within the set.
    pub index: u32,
    /// Commanded exposure, s.
    pub exposure_s: f64,
    /// Light relative to the campaign's unit; 0 for darks.
    pub illumination: f64,
    /// Position of card and light.
    #[serde(default)]
    pub configuration: u32,
    /// Start of the exposure, s since the start of the campaign.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timestamp_s: Option<f64>,
    /// Camera and settings; the temperature is that of this frame.
    pub camera: CameraInfo,
}

impl FrameTag {
    /// Builds the metadata from a row of a dataset.
    pub fn of(row: &FrameRow, camera: &CameraInfo) -> Self {
        Self {
            format: FORMAT.into(),
            kind: row.kind,
            set: row.set,
            index: row.index,
            exposure_s: row.exposure_s,
            illumination: row.illumination,
            configuration: row.configuration,
            timestamp_s: row.timestamp_s,
            camera: CameraInfo {
                temperature_c: row.temperature_c.or(camera.temperature_c),
                ..camera.clone()
            },
        }
    }

    /// Returns true if all numbers are possible.
    fn is_sound(&self) -> bool {
        let exposure = self.exposure_s.is_finite() && self.exposure_s > 0.0;
        let light = self.illumination.is_finite() && self.illumination >= 0.0;
        exposure && light && self.timestamp_s.is_none_or(f64::is_finite) && self.camera.check().is_ok()
    }

    /// Parses an ImageDescription; `None` if it holds anything else.
    pub fn from_text(text: &str) -> Option<Self> {
        let tag: Self = serde_json::from_str(text.trim_end_matches('\0')).ok()?;
        (tag.format == FORMAT && tag.is_sound()).then_some(tag)
    }

    /// Reads the metadata of a file: its own, or those of the dataset in whose folder it is. `None`
    /// without either.
    pub fn read(path: &Path) -> Option<Self> {
        if let Some(tag) = description(path).and_then(|text| Self::from_text(&text)) {
            return Some(tag);
        }
        let whole = path.canonicalize().ok()?;
        let root = whole.ancestors().skip(1).take(3).find(|folder| folder.join("dataset.toml").is_file())?;
        let dataset = Dataset::open(root).ok()?;
        let row = dataset.rows().iter().find(|row| root.join(&row.file) == whole)?;
        Some(Self::of(row, &dataset.manifest().camera))
    }
}
