//! Import map: assigns files to sets; the user confirms, completes or writes it.

use super::{ImportError, ReadOptions, Scale, camera, plausible};
use crate::dataset::{CameraInfo, Kind};
use crate::input::echo;
use crate::number::ranges;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name of the map format.
pub const MAP_FORMAT: &str = "radcam-import/1";

/// Assignment of files to sets: the user confirms it, and may write it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Map {
    /// [`MAP_FORMAT`].
    pub format: String,
    /// Bit depth, 1 to 16.
    pub bit_depth: u8,
    /// Bits by which the codes in the files are shifted left; import shifts them back.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub shift: u8,
    /// File value per code: for converters with stretched codes, or for floating-point values.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub step: f64,
    /// File value of code 0.
    #[serde(default, skip_serializing_if = "is_nothing")]
    pub zero: f64,
    /// Axis of NumPy arrays and HDF5 datasets that counts the frames; absent: the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames_axis: Option<u8>,
    /// Dataset of frames in HDF5 files; absent: the only candidate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hdf5_dataset: Option<String>,
    /// Row and column, 0 or 1, of the pixel kept of every 2 x 2 cell, for raw Bayer frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plane: Option<[u8; 2]>,
    /// Colour pattern of raw Bayer frames that are kept whole, such as RGGB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pattern: Option<String>,
    /// Region of the frames that is kept, `[column, row, width, height]` counted from 0; the rest is
    /// overscan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<[usize; 4]>,
    /// Gain of all frames, dB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain_db: Option<f64>,
    /// Manufacturer of the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vendor: Option<String>,
    /// Model of the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Serial number of the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Findings in the files worth knowing, as sentences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Settings of all frames by GenICam or FITS name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub features: BTreeMap<String, toml::Value>,
    /// Camera and settings as stated in frames written by radcam.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<CameraInfo>,
    /// Sets in time order.
    #[serde(rename = "set")]
    pub sets: Vec<MapSet>,
}

/// Frames with the same settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapSet {
    /// Kind: dark, flat, scene or target.
    pub kind: Kind,
    /// Exposure, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_s: Option<f64>,
    /// Relative light; 0 for darks, and 1 if nothing is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub illumination: Option<f64>,
    /// Position of card and light.
    #[serde(default)]
    pub configuration: u32,
    /// Sensor temperature, degrees Celsius.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Mean over the frames, DN: distinguishes flats of one exposure whose light is not stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_dn: Option<f64>,
    /// True if only the mean determines the kind, dark or flat.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub kind_by_mean: bool,
    /// True if rows run from bottom to top in the files: they are flipped.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub turned: bool,
    /// Ambiguous values, `key: why`. A set with a doubt is not imported: correct the value and remove
    /// the line.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub doubts: Vec<String>,
    /// Guessed values, `key: how`; the dataset states them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub guessed: Vec<String>,
    /// Source of each value, `key: source`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub from: Vec<String>,
    /// Files in time order; `name.tiff#3` is page 3, counted from 0.
    pub files: Vec<String>,
    /// Capture times, s since an arbitrary common epoch; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub times_s: Option<Vec<f64>>,
}

fn is_zero(n: &u8) -> bool {
    *n == 0
}

fn one() -> f64 {
    1.0
}

fn is_one(x: &f64) -> bool {
    *x == 1.0
}

fn is_nothing(x: &f64) -> bool {
    *x == 0.0
}

impl Map {
    /// Reads and checks a map.
    ///
    /// # Errors
    ///
    /// The text is not a map: line, key and fault.
    pub fn from_toml(text: &str) -> Result<Self, ImportError> {
        let map: Self =
            toml::from_str(text).map_err(|e| ImportError::Map(crate::input::echo_lines(&e.to_string())))?;
        if map.format != MAP_FORMAT {
            return Err(ImportError::Map(format!(
                "format is \"{}\", and this program reads \"{MAP_FORMAT}\"",
                echo(&map.format)
            )));
        }
        if !(map.step.is_finite() && map.step > 0.0 && map.zero.is_finite()) {
            let message = format!("step is {} and zero {}; a step is above 0", map.step, map.zero);
            return Err(ImportError::Map(message));
        }
        if map.plane.is_some_and(|p| p.iter().any(|k| *k > 1)) {
            return Err(ImportError::Map("plane is a row and a column of a 2 x 2 cell, each 0 or 1".into()));
        }
        if let Some(pattern) = map.pattern.as_ref().filter(|p| !camera::PATTERNS.contains(&p.as_str())) {
            let known = camera::PATTERNS.join(", ");
            return Err(ImportError::Map(format!(
                "pattern is {}, and must be one of {known}",
                echo(pattern)
            )));
        }
        let mut named: BTreeMap<&str, usize> = BTreeMap::new();
        for (k, set) in map.sets.iter().enumerate() {
            let fault = |message: String| Err(ImportError::Map(format!("set {k}: {message}")));
            if let Some(exposure_s) = set.exposure_s.filter(|e| !(e.is_finite() && *e > 0.0)) {
                return fault(format!("exposure_s is {exposure_s}, and must be above 0 s"));
            }
            if let Some(light) = set.illumination.filter(|l| !(l.is_finite() && *l >= 0.0)) {
                return fault(format!("illumination is {light}, and must not be below 0"));
            }
            if set.kind == Kind::Dark && set.illumination.is_some_and(|l| l != 0.0) {
                return fault("a dark has illumination 0".into());
            }
            for file in &set.files {
                if let Some(other) = named.insert(file, k) {
                    return fault(format!("{} stands in set {other} too", echo(file)));
                }
            }
            if let Some(times) = set.times_s.as_ref().filter(|t| t.len() != set.files.len()) {
                let message = format!("set {k} has {} files and {} times", set.files.len(), times.len());
                return Err(ImportError::Map(message));
            }
        }
        if let Some(info) = &map.camera {
            info.check().map_err(ImportError::Map)?;
        }
        let own = CameraInfo { gain_db: map.gain_db, ..CameraInfo::default() };
        own.check().map_err(ImportError::Map)?;
        for (k, set) in map.sets.iter().enumerate() {
            let own = CameraInfo { temperature_c: set.temperature_c, ..CameraInfo::default() };
            own.check().map_err(|message| ImportError::Map(format!("set {k}: {message}")))?;
            if set.times_s.iter().flatten().any(|t| !t.is_finite()) {
                return Err(ImportError::Map(format!("set {k}: times_s holds a value that is no number")));
            }
        }
        if !(1..=16).contains(&map.bit_depth) || map.shift > 15 {
            return Err(ImportError::Map(format!(
                "bit_depth is {}, and must lie within 1 to 16",
                map.bit_depth
            )));
        }
        Ok(map)
    }

    /// Returns the options for reading the files.
    pub fn read_options(&self) -> ReadOptions {
        ReadOptions {
            frames_axis: self.frames_axis.map(usize::from),
            hdf5_dataset: self.hdf5_dataset.clone(),
        }
    }

    /// Returns the scale of the codes in the files. A `shift` of older maps is a step of as many bits.
    pub fn scale(&self) -> Scale {
        match self.shift {
            0 => Scale { step: self.step, zero: self.zero },
            shift => Scale { step: f64::from(1u32 << shift.min(15)), zero: 0.0 },
        }
    }

    /// Describes values to be filled in before the dataset can be written; empty if complete.
    pub fn missing(&self) -> Vec<String> {
        let lowest = self.sets.iter().filter_map(|s| s.mean_dn).fold(f64::INFINITY, f64::min);
        // Flats without a stated light had the same light if their signals are alike.
        let unlike = |a: &MapSet, b: &MapSet| {
            let stated = a.illumination.is_some() || b.illumination.is_some() || a.kind != b.kind;
            let signal = |s: &MapSet| s.mean_dn.map_or(0.0, |m| m - lowest);
            !stated
                && a.exposure_s == b.exposure_s
                && (signal(a) - signal(b)).abs() > SAME_LIGHT * signal(a).max(signal(b))
        };
        let without = |(k, s): (usize, &MapSet)| {
            let first = s.files.first().map_or("no files", String::as_str);
            let other = self.sets.iter().position(|b| s.kind == Kind::Flat && unlike(s, b));
            let of_set = format!("set {k} ({}, {first})", s.kind);
            // A filled-in exposure settles doubts about it.
            let open = |doubt: &&String| s.exposure_s.is_none() || !doubt.starts_with("exposure_s:");
            if let Some(doubt) = s.doubts.iter().find(open) {
                let (key, why) = doubt.split_once(':').unwrap_or((doubt, ""));
                let settle = if key == "exposure_s" { "" } else { " (settle it and remove the line doubts)" };
                return Some(format!("{key} of {of_set}:{why}{settle}"));
            }
            match (s.exposure_s, other) {
                (None, _) => Some(format!("exposure_s of {of_set}")),
                (Some(_), Some(b)) => Some(format!(
                    "illumination of {of_set}, which has the exposure of set {b} and another mean"
                )),
                _ => None,
            }
        };
        let mut out: Vec<String> = self.sets.iter().enumerate().filter_map(without).collect();
        // Filled-in exposures are checked against the levels too.
        let lit =
            self.sets.iter().enumerate().filter(|(_, s)| s.kind == Kind::Flat && s.illumination.is_none());
        let flats = lit.filter_map(|(k, s)| Some((k, s.exposure_s?, s.mean_dn?))).collect();
        if let Some((k, text)) = plausible::falling_levels(flats, lowest).filter(|_| out.is_empty()) {
            let (key, why) = text.split_once(':').unwrap_or(("exposure", &text));
            out.push(format!("{key} of set {k} ({}):{why}", self.sets[k].kind));
        }
        out
    }
}

/// Maximum relative difference between signals of one exposure under the same light: undisturbed lamps
/// are stable to some per cent.
pub(super) const SAME_LIGHT: f64 = 0.1;

impl Map {
    /// Describes the guesses, each with its sets.
    pub fn guessed(&self) -> Vec<String> {
        let mut of: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        for (k, set) in self.sets.iter().enumerate() {
            if set.kind_by_mean {
                let text = "kind: by the mean, names and headers do not say it";
                of.entry(text.into()).or_default().push(k);
            }
            for text in &set.guessed {
                of.entry(text.clone()).or_default().push(k);
            }
        }
        let sentence = |(text, sets): (String, Vec<usize>)| {
            let (key, how) = text.split_once(": ").unwrap_or((&text, ""));
            let word = if sets.len() == 1 { "set" } else { "sets" };
            format!("{key} of {word} {}: {how}", ranges(&sets))
        };
        of.into_iter().map(sentence).collect()
    }
}
