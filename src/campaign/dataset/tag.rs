//! What a frame says of itself: settings and camera, as JSON in the ImageDescription of its file.

use super::{CameraInfo, Dataset, FrameRow, Kind};
use serde::{Deserialize, Serialize};
use std::io::BufReader;
use std::path::Path;
use tiff::tags::Tag;

/// Name and major version of the format.
pub const FORMAT: &str = "radcam-frame/1";

/// Name and major version of the description of corrected frames.
pub const CORRECTED: &str = "radcam-corrected/1";

/// Returns true for a frame that radcam has corrected already, by its ImageDescription.
pub fn is_corrected(path: &Path) -> bool {
    let format = description(path).and_then(|text| {
        let value: serde_json::Value = serde_json::from_str(text.trim_end_matches('\0')).ok()?;
        Some(value.get("format")?.as_str()? == CORRECTED)
    });
    format.unwrap_or(false)
}

/// ImageDescription of a TIFF.
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
    /// What it shows.
    pub kind: Kind,
    /// Number of its set.
    pub set: u32,
    /// Place within the set.
    pub index: u32,
    /// Commanded exposure, s.
    pub exposure_s: f64,
    /// Relative to the campaign's unit; 0 for darks.
    pub illumination: f64,
    /// Position of card and light.
    #[serde(default)]
    pub configuration: u32,
    /// Start of the exposure, s from the start of the campaign.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timestamp_s: Option<f64>,
    /// The camera and its settings; its temperature is that of this frame.
    pub camera: CameraInfo,
}

impl FrameTag {
    /// Of a row of a dataset.
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

    /// True of numbers that can be.
    fn is_sound(&self) -> bool {
        let exposure = self.exposure_s.is_finite() && self.exposure_s > 0.0;
        let light = self.illumination.is_finite() && self.illumination >= 0.0;
        exposure && light && self.timestamp_s.is_none_or(f64::is_finite) && self.camera.check().is_ok()
    }

    /// Of an ImageDescription; `None` where it says something else.
    pub fn from_text(text: &str) -> Option<Self> {
        let tag: Self = serde_json::from_str(text.trim_end_matches('\0')).ok()?;
        (tag.format == FORMAT && tag.is_sound()).then_some(tag)
    }

    /// Of a file: what it says of itself, or what the dataset says in whose folder it lies. `None` where neither does.
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
