//! How files become sets: the map that the user confirms, completes or writes.

use super::{ImportError, ReadOptions, Scale, camera, plausible};
use crate::dataset::{CameraInfo, Kind};
use crate::input::echo;
use crate::number::ranges;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name of the map's format.
pub const MAP_FORMAT: &str = "radcam-import/1";

/// How files become sets: what the user confirms, and may write.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Map {
    /// [`MAP_FORMAT`].
    pub format: String,
    /// Bits of a code, 1 to 16.
    pub bit_depth: u8,
    /// Bits by which the codes of the files were shifted up: they are shifted down again.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub shift: u8,
    /// Values of the files that make one code: those of converters whose codes were stretched, or
    /// floating-point ones.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub step: f64,
    /// Value of code 0 in the files.
    #[serde(default, skip_serializing_if = "is_nothing")]
    pub zero: f64,
    /// Axis of NumPy arrays and HDF5 datasets that counts the frames; absent: the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames_axis: Option<u8>,
    /// Dataset of frames in HDF5 files; absent: the only one that can be.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hdf5_dataset: Option<String>,
    /// Row and column, 0 or 1, of the one pixel of every 2 x 2 cell that is kept, of raw Bayer frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plane: Option<[u8; 2]>,
    /// Colour pattern of raw Bayer frames that are kept whole, such as RGGB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pattern: Option<String>,
    /// Part of the frames that is kept, `[column, row, width, height]` counted from 0: what is cut off is
    /// overscan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<[usize; 4]>,
    /// Gain of all frames, dB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain_db: Option<f64>,
    /// Maker of the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vendor: Option<String>,
    /// Its model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Serial number of the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// What was found in the files and should be known, in words.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Settings of all frames by their GenICam names, or those of FITS.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub features: BTreeMap<String, toml::Value>,
    /// What frames that radcam wrote say of their camera and its settings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<CameraInfo>,
    /// Sets in the order of time.
    #[serde(rename = "set")]
    pub sets: Vec<MapSet>,
}

/// Frames that share every setting.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapSet {
    /// What they show: dark, flat, scene or target.
    pub kind: Kind,
    /// Exposure, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_s: Option<f64>,
    /// Light, relative; 0 for darks, and 1 where nothing is said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub illumination: Option<f64>,
    /// Position of card and light.
    #[serde(default)]
    pub configuration: u32,
    /// Sensor temperature, degrees Celsius.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Mean over the frames, DN: tells flats of one exposure apart whose light nobody states.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_dn: Option<f64>,
    /// Whether the mean alone says that it is a dark or a flat.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub kind_by_mean: bool,
    /// Rows run from the bottom to the top in the files: they are turned.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub turned: bool,
    /// Values with more than one reading, `key: why`. A set with a doubt is not imported: correct the value
    /// and remove the line.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub doubts: Vec<String>,
    /// What was guessed, `key: how`; the dataset says so.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub guessed: Vec<String>,
    /// Where each value comes from, `key: source`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub from: Vec<String>,
    /// Files in the order of time; `name.tiff#3` is page 3, counted from 0.
    pub files: Vec<String>,
    /// When each was taken, s from any moment that is the same for all; absent where it is not known.
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
    /// Reads and checks.
    ///
    /// # Errors
    ///
    /// Where the text is no map: line, key and what is wrong.
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

    /// Choices under which the files are read.
    pub fn read_options(&self) -> ReadOptions {
        ReadOptions {
            frames_axis: self.frames_axis.map(usize::from),
            hdf5_dataset: self.hdf5_dataset.clone(),
        }
    }

    /// What one code is in the files. A `shift` of older maps is a step of as many bits.
    pub fn scale(&self) -> Scale {
        match self.shift {
            0 => Scale { step: self.step, zero: self.zero },
            shift => Scale { step: f64::from(1u32 << shift.min(15)), zero: 0.0 },
        }
    }

    /// What is to be filled in before it can be written, in words; empty where nothing is.
    pub fn missing(&self) -> Vec<String> {
        let lowest = self.sets.iter().filter_map(|s| s.mean_dn).fold(f64::INFINITY, f64::min);
        // Flats that say nothing of their light had the same where they are alike.
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
            // An exposure that is filled in settles what was doubtful of it.
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
        // Levels contradict exposures that were filled in, too.
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

/// Flats of one exposure whose signals differ by more had different light: lamps that are left alone stay
/// within some per cent.
pub(super) const SAME_LIGHT: f64 = 0.1;

impl Map {
    /// What was guessed, in sentences: each with the sets.
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
