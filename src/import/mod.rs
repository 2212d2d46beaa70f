//! Loose image files into a dataset folder.
//!
//! [`survey`] looks at the files, [`propose`] sorts them into sets as a [`Map`], the user confirms or completes it, and [`write()`] copies the
//! frames. What cannot be known is not guessed: [`Map::missing`] says what is to be filled in.

mod headers;
pub mod names;
mod pixels;

use crate::dataset::{
    BenchInfo, CameraInfo, Dataset, DatasetError, FORMAT, FrameRow, Kind, Manifest, image, write_whole,
};
use ndarray::{ArrayView2, Axis, s};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Why files cannot be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// A file cannot be read or is no frame.
    #[error("{path}: {message}")]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what to do.
        message: String,
    },
    /// The files do not make one dataset.
    #[error("{0}")]
    Files(String),
    /// The map cannot be understood, or something is missing in it.
    #[error("{0}")]
    Map(String),
    /// The dataset cannot be written.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Stopped by its user.
    #[error("interrupted; nothing was imported")]
    Interrupted,
}

/// What names and headers say of a frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Facts {
    /// What it shows.
    pub kind: Option<Kind>,
    /// Exposure, s.
    pub exposure_s: Option<f64>,
    /// Light, relative.
    pub illumination: Option<f64>,
    /// Gain, dB.
    pub gain_db: Option<f64>,
    /// Sensor temperature, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Maker.
    pub vendor: Option<String>,
    /// Model.
    pub model: Option<String>,
    /// When it was taken, s from any moment that is the same for all.
    pub time_s: Option<f64>,
    /// Number of its set, where it says so.
    pub set: Option<u32>,
    /// Further settings by their names, which all frames of a dataset share.
    pub differs: Vec<(String, String)>,
    /// The camera with its settings, where it says all of it.
    pub camera: Option<CameraInfo>,
}

impl Facts {
    /// These, and where they say nothing the others.
    fn or(self, other: Self) -> Self {
        Self {
            kind: self.kind.or(other.kind),
            exposure_s: self.exposure_s.or(other.exposure_s),
            illumination: self.illumination.or(other.illumination),
            gain_db: self.gain_db.or(other.gain_db),
            temperature_c: self.temperature_c.or(other.temperature_c),
            vendor: self.vendor.or(other.vendor),
            model: self.model.or(other.model),
            time_s: self.time_s.or(other.time_s),
            set: self.set.or(other.set),
            differs: [self.differs, other.differs].concat(),
            camera: self.camera.or(other.camera),
        }
    }
}

/// A frame that was found: a file, or a page of one.
#[derive(Debug, Clone)]
pub struct Found {
    /// The file.
    pub path: PathBuf,
    /// Its page, where it has several.
    pub page: Option<usize>,
    /// What is known of it.
    pub facts: Facts,
    /// Rows and columns.
    pub shape: (usize, usize),
    /// Mean, DN.
    pub mean_dn: f64,
    /// Every bit that any pixel has.
    pub bits: u16,
    /// Means of the four places of a 2 x 2 cell, DN: (0, 0), (0, 1), (1, 0), (1, 1) as (row, column).
    pub cells_dn: [f64; 4],
}

/// Extensions of files that are looked at in folders.
const EXTENSIONS: [&str; 7] = ["tif", "tiff", "png", "fits", "fit", "fts", "npy"];

/// The image files that are named, and those in folders that are.
///
/// # Errors
///
/// Which file or folder cannot be read.
pub fn files(named: &[PathBuf]) -> Result<Vec<PathBuf>, ImportError> {
    let mut out = Vec::new();
    for path in named {
        let fault = |e: std::io::Error| ImportError::File { path: path.clone(), message: e.to_string() };
        if !path.metadata().map_err(fault)?.is_dir() {
            out.push(path.clone());
            continue;
        }
        let mut inside = Vec::new();
        for entry in std::fs::read_dir(path).map_err(fault)? {
            inside.push(entry.map_err(fault)?.path());
        }
        let image = |p: &PathBuf| {
            let extension = p.extension().and_then(|e| e.to_str()).unwrap_or_default().to_lowercase();
            p.is_dir() || EXTENSIONS.contains(&extension.as_str())
        };
        inside.retain(image);
        inside.sort_by_key(|p| names::natural(&p.to_string_lossy()));
        out.extend(files(&inside)?);
    }
    Ok(out)
}

/// Reads every file and page.
///
/// # Errors
///
/// Which file cannot be read, or that it was stopped.
pub fn survey(
    paths: &[PathBuf],
    mut step: impl FnMut(usize, usize) -> bool,
) -> Result<Vec<Found>, ImportError> {
    let mut out: Vec<Found> = Vec::new();
    for (at, path) in paths.iter().enumerate() {
        let fault = |message: String| ImportError::File { path: path.clone(), message };
        let (header, pages) = headers::facts(path).map_err(fault)?;
        let text = |p: Option<&std::ffi::OsStr>| p.unwrap_or_default().to_string_lossy().into_owned();
        let named = names::facts(&text(path.parent().and_then(Path::file_name)), &text(path.file_name()));
        // An array of numpy is read once, not once a page.
        let array = pixels::npy(path).map_err(fault)?;
        let pages = array.as_ref().map_or(pages, |a| a.len_of(Axis(0)));
        for page in 0..pages {
            if !step(at, paths.len()) {
                return Err(ImportError::Interrupted);
            }
            let pixels = match &array {
                Some(array) => array.index_axis(Axis(0), page).to_owned(),
                None => image::read(path, page).map_err(|e| fault(e.to_string()))?,
            };
            let shape = pixels.dim();
            if let Some(first) = out.first().filter(|f| f.shape != shape) {
                return Err(fault(format!(
                    "is {} x {} px, and {} is {} x {} px; a dataset has frames of one size",
                    shape.1,
                    shape.0,
                    first.path.display(),
                    first.shape.1,
                    first.shape.0
                )));
            }
            let mean = |pixels: ArrayView2<'_, u16>| {
                pixels.iter().map(|v| f64::from(*v)).sum::<f64>() / pixels.len().max(1) as f64
            };
            let cell = |y: usize, x: usize| mean(pixels.slice(s![y.., x..]).slice(s![..;2, ..;2]));
            let whole = shape.0 >= 2 && shape.1 >= 2;
            // The one time of a stack is that of its first page.
            let mut facts = header.clone().or(named.clone());
            facts.time_s = facts.time_s.filter(|_| pages == 1);
            out.push(Found {
                path: path.clone(),
                page: (pages > 1).then_some(page),
                facts,
                shape,
                mean_dn: mean(pixels.view()),
                bits: pixels.iter().fold(0, |a, b| a | b),
                cells_dn: if whole { [cell(0, 0), cell(0, 1), cell(1, 0), cell(1, 1)] } else { [0.0; 4] },
            });
        }
    }
    // The order of time is what matters; where it is not known for all, that of the names.
    if out.iter().all(|f| f.facts.time_s.is_some()) {
        out.sort_by(|a, b| a.facts.time_s.unwrap_or(0.0).total_cmp(&b.facts.time_s.unwrap_or(0.0)));
    }
    Ok(out)
}

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
    /// Row and column, 0 or 1, of the one pixel of every 2 x 2 cell that is kept, of raw Bayer frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plane: Option<[u8; 2]>,
    /// Gain of all frames, dB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain_db: Option<f64>,
    /// Maker of the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vendor: Option<String>,
    /// Its model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
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
    /// Files in the order of time; `name.tiff#3` is page 3, counted from 0.
    pub files: Vec<String>,
    /// When each was taken, s from any moment that is the same for all; absent where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub times_s: Option<Vec<f64>>,
}

fn is_zero(n: &u8) -> bool {
    *n == 0
}

impl Map {
    /// Reads and checks.
    ///
    /// # Errors
    ///
    /// Where the text is no map: line, key and what is wrong.
    pub fn from_toml(text: &str) -> Result<Self, ImportError> {
        let map: Self =
            toml::from_str(text).map_err(|e| ImportError::Map(e.to_string().trim_end().to_string()))?;
        if map.format != MAP_FORMAT {
            return Err(ImportError::Map(format!(
                "format is \"{}\", and this program reads \"{MAP_FORMAT}\"",
                map.format
            )));
        }
        if map.plane.is_some_and(|p| p.iter().any(|k| *k > 1)) {
            return Err(ImportError::Map("plane is a row and a column of a 2 x 2 cell, each 0 or 1".into()));
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
                    return fault(format!("{file} stands in set {other} too"));
                }
            }
            if let Some(times) = set.times_s.as_ref().filter(|t| t.len() != set.files.len()) {
                let message = format!("set {k} has {} files and {} times", set.files.len(), times.len());
                return Err(ImportError::Map(message));
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
            match (s.exposure_s, other) {
                (None, _) => Some(format!("exposure_s of set {k} ({}, {first})", s.kind)),
                (Some(_), Some(b)) => Some(format!(
                    "illumination of set {k} ({}, {first}), which has the exposure of set {b} and another mean",
                    s.kind
                )),
                _ => None,
            }
        };
        self.sets.iter().enumerate().filter_map(without).collect()
    }
}

/// Flats of one exposure whose signals differ by more had different light: lamps that are left alone stay within some per cent.
const SAME_LIGHT: f64 = 0.1;

/// A flat lies so much of the full scale above the darkest set at least, where nothing but the mean tells: above what dark current and offsets
/// of usual darks bring.
const LIT: f64 = 0.02;

/// Sorts frames into sets: by what names and headers say, else by folder and name, darks from flats by their means.
///
/// # Errors
///
/// Where the files are not of one camera and one size, or there is none.
pub fn propose(found: &[Found], bit_depth: Option<u8>) -> Result<Map, ImportError> {
    let bits = found.iter().fold(0, |a, f| a | f.bits);
    // Multiples of one number in 16 bits: cameras send 12 bits so.
    let shift = if bits > 255 && bits.trailing_zeros() >= 2 { bits.trailing_zeros() as u8 } else { 0 };
    let bits = bits >> shift;
    let bit_depth = bit_depth.unwrap_or_else(|| depth_of(bits));
    if bits > 0 && bit_depth < 16 && u32::from(bits) >> bit_depth != 0 {
        return Err(ImportError::Files(format!(
            "codes reach above {} DN, the largest of {bit_depth} bits",
            (1u32 << bit_depth) - 1
        )));
    }
    let mut gains: Vec<f64> = found.iter().filter_map(|f| f.facts.gain_db).collect();
    gains.dedup();
    if let Some(other) = gains.iter().find(|g| **g != gains[0]) {
        return Err(ImportError::Files(format!(
            "frames at {} dB and at {other} dB; a dataset has one gain, so import each by itself",
            gains[0]
        )));
    }
    one_camera(found)?;
    let lowest = found.iter().map(|f| f.mean_dn).fold(f64::INFINITY, f64::min);
    let lit = lowest + LIT * f64::from(((1u32 << bit_depth) - 1) << shift);
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    let mut sets: Vec<(MapSet, f64)> = Vec::new();
    for frame in found {
        let facts = &frame.facts;
        let (kind, by_mean) = match facts.kind {
            Some(kind) => (kind, false),
            None => (if frame.mean_dn > lit { Kind::Flat } else { Kind::Dark }, true),
        };
        let name = frame.path.file_name().unwrap_or_default().to_string_lossy();
        // Pages of a stack are one set.
        let stem = if frame.page.is_some() { name.into_owned() } else { names::stem(&name) };
        let folder = frame.path.parent().unwrap_or(Path::new("")).display();
        let key = match facts.set {
            // What says its set needs no guess.
            Some(set) => format!("{folder} set {set}"),
            None => format!("{folder}/{stem} {kind} {:?} {:?}", facts.exposure_s, facts.illumination),
        };
        let place = *places.entry(key).or_insert_with(|| {
            let set = MapSet {
                kind,
                // A bias frame has no exposure: as good as none is a nanosecond.
                exposure_s: facts.exposure_s.map(|s| s.max(1e-9)),
                illumination: if kind == Kind::Dark { Some(0.0) } else { facts.illumination },
                configuration: 0,
                temperature_c: facts.temperature_c,
                mean_dn: None,
                kind_by_mean: by_mean,
                files: Vec::new(),
                times_s: facts.time_s.map(|_| Vec::new()),
            };
            sets.push((set, 0.0));
            sets.len() - 1
        });
        let (set, sum) = &mut sets[place];
        let page = frame.page.map(|p| format!("#{p}")).unwrap_or_default();
        set.files.push(format!("{}{page}", frame.path.display()));
        match (&mut set.times_s, facts.time_s) {
            (Some(times), Some(time)) => times.push(time),
            _ => set.times_s = None,
        }
        *sum += frame.mean_dn;
    }
    let of = |(mut set, sum): (MapSet, f64)| {
        let unshifted = sum / set.files.len() as f64 / f64::from(1u32 << shift);
        set.mean_dn = Some((10.0 * unshifted).round() / 10.0);
        set
    };
    let camera = found.iter().find_map(|f| f.facts.camera.clone());
    let bit_depth = camera.as_ref().map_or(bit_depth, |c| c.bit_depth.max(depth_of(bits).min(bit_depth)));
    let first = |of: fn(&Facts) -> &Option<String>| found.iter().find_map(|f| of(&f.facts).clone());
    Ok(Map {
        format: MAP_FORMAT.into(),
        bit_depth,
        shift,
        plane: None,
        gain_db: gains.first().copied(),
        vendor: first(|f| &f.vendor),
        model: first(|f| &f.model),
        camera,
        sets: sets.into_iter().map(of).collect(),
    })
}

/// Refuses frames whose headers speak of two cameras or settings.
fn one_camera(found: &[Found]) -> Result<(), ImportError> {
    let of = |f: &Found| {
        let text = |name: &str, v: &Option<String>| v.clone().map(|v| (name.to_string(), v));
        let mut all: Vec<(String, String)> =
            text("vendor", &f.facts.vendor).into_iter().chain(text("model", &f.facts.model)).collect();
        all.extend(f.facts.differs.iter().cloned());
        all
    };
    let mut said: BTreeMap<String, (String, PathBuf)> = BTreeMap::new();
    for frame in found {
        for (name, value) in of(frame) {
            let (first, path) =
                said.entry(name.clone()).or_insert_with(|| (value.clone(), frame.path.clone()));
            if *first != value {
                return Err(ImportError::Files(format!(
                    "{} has {name} {value}, and {} has {first}; a dataset is of one camera under one set of settings, so import each by itself",
                    frame.path.display(),
                    path.display()
                )));
            }
        }
    }
    Ok(())
}

/// By how much the four places of a 2 x 2 cell differ in the brightest frame, over its signal: raw Bayer frames do by tens of per cent.
pub fn mosaic(found: &[Found]) -> f64 {
    let lowest = found.iter().map(|f| f.mean_dn).fold(f64::INFINITY, f64::min);
    let brightest = found.iter().max_by(|a, b| a.mean_dn.total_cmp(&b.mean_dn));
    // Of darks alone nothing can be said.
    let Some(brightest) = brightest.filter(|f| f.mean_dn - lowest > LIT * f64::from(f.bits)) else {
        return 0.0;
    };
    let (low, high) = brightest
        .cells_dn
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
    (high - low) / (brightest.mean_dn - lowest).max(1.0)
}

/// Cells that differ by more are those of a colour filter: of monochrome sensors they agree to a few per mille.
pub const MOSAIC: f64 = 0.1;

/// The usual depth that holds these codes.
fn depth_of(bits: u16) -> u8 {
    let needed = (u16::BITS - bits.leading_zeros()) as u8;
    [8, 10, 12, 14, 16].into_iter().find(|d| *d >= needed).unwrap_or(16)
}

/// Refuses a folder that has something in it.
///
/// # Errors
///
/// Where the folder holds something.
pub fn must_be_free(root: &Path) -> Result<(), ImportError> {
    if root.exists() && root.read_dir().map_or(true, |mut inside| inside.next().is_some()) {
        return Err(ImportError::Files(format!("{} is there already; choose a new folder", root.display())));
    }
    Ok(())
}

/// Copies the frames of a map into a new dataset folder, or makes hard links where `link` says so, and opens it. Where that fails what was
/// copied is removed again.
///
/// # Errors
///
/// Which file cannot be read or written, what the map leaves open, or that it was stopped.
pub fn write(
    map: &Map,
    root: &Path,
    link: bool,
    step: impl FnMut(usize, usize) -> bool,
) -> Result<Dataset, ImportError> {
    must_be_free(root)?;
    let new = !root.exists();
    let outcome = fill(map, root, link, step).and_then(|()| Ok(Dataset::open(root)?));
    if outcome.is_err() {
        for file in ["dataset.toml", "frames.csv"] {
            std::fs::remove_file(root.join(file)).ok();
        }
        std::fs::remove_dir_all(root.join("frames")).ok();
        if new {
            std::fs::remove_dir(root).ok();
        }
    }
    outcome
}

/// Frames, rows, and last the manifest: what was broken off is no dataset.
fn fill(
    map: &Map,
    root: &Path,
    link: bool,
    mut step: impl FnMut(usize, usize) -> bool,
) -> Result<(), ImportError> {
    let missing = map.missing();
    if !missing.is_empty() {
        return Err(ImportError::Map(format!("missing: {}", missing.join("; "))));
    }
    let frames = root.join("frames");
    std::fs::create_dir_all(&frames)
        .map_err(|e| ImportError::File { path: frames.clone(), message: e.to_string() })?;
    let all: usize = map.sets.iter().map(|s| s.files.len()).sum();
    let mut rows = csv::Writer::from_writer(Vec::new());
    let mut taken = pixels::Taken::new(map, root, link);
    let start = map.sets.iter().filter_map(|s| s.times_s.as_ref()?.first().copied());
    let start = start.fold(f64::INFINITY, f64::min);
    let mut done = 0;
    for (number, set) in map.sets.iter().enumerate() {
        for (index, file) in set.files.iter().enumerate() {
            if !step(done, all) {
                return Err(ImportError::Interrupted);
            }
            done += 1;
            let row = FrameRow {
                file: taken.frame(file)?,
                kind: set.kind,
                set: number as u32,
                index: index as u32,
                exposure_s: set.exposure_s.unwrap_or(1.0),
                illumination: set.illumination.unwrap_or(f64::from(u8::from(set.kind != Kind::Dark))),
                configuration: set.configuration,
                temperature_c: set.temperature_c,
                timestamp_s: set.times_s.as_ref().map(|t| t[index] - start),
            };
            rows.serialize(&row).map_err(|e| ImportError::Map(e.to_string()))?;
        }
    }
    let shape = taken.shape();
    let camera = CameraInfo {
        vendor: map.vendor.clone().unwrap_or_default(),
        model: map.model.clone().unwrap_or_default(),
        width: shape.1,
        height: shape.0,
        bit_depth: map.bit_depth,
        pixel_format: format!("Mono{}", map.bit_depth),
        gain_db: map.gain_db,
        ..map.camera.clone().unwrap_or_default()
    };
    let bench = BenchInfo { illumination_unit: "relative".into(), ..Default::default() };
    let manifest = Manifest { format: FORMAT.into(), camera, bench: Some(bench) };
    let text = toml::to_string(&manifest).map_err(|e| ImportError::Map(e.to_string()))?;
    let rows = rows.into_inner().map_err(|e| ImportError::Map(e.to_string()))?;
    write_whole(&root.join("frames.csv"), &rows)?;
    write_whole(&root.join("dataset.toml"), text.as_bytes())?;
    Ok(())
}
