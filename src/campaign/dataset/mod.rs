//! Campaign on disk: a folder with `dataset.toml`, `frames.csv` and the frames.
//!
//! [`Dataset::open`] also reads the descriptor file of an EMVA 1288 test. A table of statistics without
//! frames is [`table::Table`].

mod electron_multiplication;
mod emva;
mod examination;
mod fault;
mod frames;
pub mod image;
mod kept;
mod manifest;
mod parts;
mod reduced;
mod rows;
mod shared_noise;
pub mod table;
pub mod tag;
mod write;

pub(crate) use electron_multiplication::ElectronMultiplication;
pub use emva::{DESCRIPTOR, write_descriptor};
use examination::UNEXAMINED;
pub(crate) use examination::{Examination, PassedOver, StruckSamples};
pub use fault::{DataFault, FaultKind};
pub use frames::Region;
pub use manifest::{BenchInfo, CameraInfo, FORMAT, ImportInfo, Manifest};
use reduced::ANY_HEAD;
pub(crate) use reduced::{HEAD, is_statistics};
pub use reduced::{Key, Reduced};
#[cfg(feature = "cli")]
pub(crate) use rows::MAX_EXPOSURE_S;
pub(crate) use rows::{Lines, csv_words};
pub(crate) use shared_noise::{Between, SharedNoise};
pub(crate) use table::delimiter;
pub(crate) use write::{Aside, synchronise};
pub use write::{Folder, Writer, write_whole};

use crate::input::{self, echo};
use rows::{check_row, parse_rows, plain_name, same_settings, split_page};
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, HashSet};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// Header of `frames.csv`.
pub const COLUMNS: [&str; 9] = [
    "file",
    "kind",
    "set",
    "index",
    "exposure_s",
    "illumination",
    "configuration",
    "temperature_c",
    "timestamp_s",
];

/// Minimum ratio of the darks' exposure to the longest flat exposure at which their dark charge is
/// irrelevant to the flats (a named choice).
pub(crate) const LONG_DARKS: f64 = 2.0;

/// Kind of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// No light.
    Dark,
    /// Uniform card.
    Flat,
    /// Any other still scene.
    Scene,
    /// Scene-variation surface.
    Target,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Kind::Dark => "dark",
            Kind::Flat => "flat",
            Kind::Scene => "scene",
            Kind::Target => "target",
        })
    }
}

/// One row of `frames.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRow {
    /// Path inside the folder; `name.tiff#3` is page 3, counted from 0.
    pub file: String,
    /// Kind of the frame.
    pub kind: Kind,
    /// Number of the set. Frames of one set share every setting and follow one another in time.
    pub set: u32,
    /// Index within the set, from 0.
    pub index: u32,
    /// Commanded exposure, s.
    pub exposure_s: f64,
    /// Light relative to the campaign's unit; 0 for darks.
    pub illumination: f64,
    /// Position of card and light (Section V of the paper).
    pub configuration: u32,
    /// Sensor temperature, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Start of the exposure, s since the start of the campaign.
    pub timestamp_s: Option<f64>,
}

/// Errors of a dataset, with their place.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// Error of the file system.
    #[error("{path}: {source}")]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// `dataset.toml` or the descriptor cannot be parsed.
    #[error("{path}: {message}")]
    Manifest {
        /// The file.
        path: PathBuf,
        /// Description of the fault.
        message: String,
    },
    /// Invalid row.
    #[error("{path}, line {line}: {message}")]
    Row {
        /// `frames.csv`, the descriptor or the table.
        path: PathBuf,
        /// Line of that file, from 1.
        line: u64,
        /// Description of the fault.
        message: String,
    },
    /// Invalid frame.
    #[error("frame {} (set {set}, index {index}): {message}", echo(.file))]
    Frame {
        /// Path as in `frames.csv`.
        file: String,
        /// Number of the set.
        set: u32,
        /// Index in the set.
        index: u32,
        /// Description of the fault.
        message: String,
    },
}

impl DatasetError {
    pub(crate) fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, source }
    }
}

/// Frames with the same settings, in time order.
#[derive(Debug, Clone)]
pub struct Set {
    /// Number of the set in `frames.csv`.
    pub number: u32,
    /// Indices of the frames in [`Dataset::rows`].
    pub rows: Vec<usize>,
}

/// Campaign: manifest and rows; frames are read on demand.
#[derive(Debug, Clone)]
pub struct Dataset {
    root: PathBuf,
    manifest: Manifest,
    rows: Vec<FrameRow>,
    sets: Vec<Set>,
    /// Folder and first row of each joined dataset; empty if none were joined.
    parts: Vec<(PathBuf, usize)>,
    /// Folders that rows with absolute paths may point into.
    folders: Vec<PathBuf>,
    /// Statistics that replace reading frames.
    reduced: Option<Arc<Reduced>>,
    /// Faults found by the examination; `None` before it.
    faults: Option<Arc<[DataFault]>>,
    /// Cache of opened stacks.
    opened: Arc<image::Opened>,
    /// Row of every file and page read so far, after resolving links.
    rows_of_files: Arc<Mutex<HashMap<(PathBuf, usize), String>>>,
    /// Cache of frames read by [`frame`](Self::frame).
    kept: Arc<kept::Kept>,
    /// Findings of the examination other than faults.
    examination: Examination,
    /// Sets excluded by the examination that were still exposed.
    passed_over: Option<Arc<(Dataset, Vec<PassedOver>)>>,
    /// Region of the frames that is retained; `None`: whole frames.
    cut: Option<frames::Cut>,
}

impl Dataset {
    /// Opens a dataset folder or an EMVA 1288 descriptor file, and checks every row.
    ///
    /// ```no_run
    /// let dataset = radcam::dataset::Dataset::open("campaign".as_ref())?;
    /// for set in dataset.sets() {
    ///     let frames = dataset.read_set(set)?; // (rows, columns) in DN
    ///     println!("set {}: {} frames", set.number, frames.len());
    /// }
    /// # Ok::<(), radcam::dataset::DatasetError>(())
    /// ```
    ///
    /// # Errors
    ///
    /// The folder, the descriptor or a row cannot be understood: file, line and fault.
    pub fn open(path: &Path) -> Result<Self, DatasetError> {
        if path.is_file() {
            if is_statistics(path) {
                let message = "is a file of statistics, without frames";
                return Err(DatasetError::Manifest { path: path.into(), message: message.into() });
            }
            return emva::open(path);
        }
        let manifest_path = path.join("dataset.toml");
        if !path.exists() {
            let message = "there is no such file or folder".into();
            return Err(DatasetError::Manifest { path: path.into(), message });
        }
        if !path.is_dir() {
            input::open(path).map_err(DatasetError::io(path))?;
        }
        if !manifest_path.exists() {
            let message = no_manifest(path);
            return Err(DatasetError::Manifest { path: path.into(), message });
        }
        let text = input::settings(&manifest_path).map_err(DatasetError::io(&manifest_path))?;
        let manifest = Manifest::from_toml(&text)
            .map_err(|message| DatasetError::Manifest { path: manifest_path, message })?;
        let csv_path = path.join("frames.csv");
        let text = input::table(&csv_path).map_err(DatasetError::io(&csv_path))?;
        Self::new(path.into(), manifest, parse_rows(&csv_path, &text)?, &csv_path)
    }

    /// Groups rows into sets and checks them.
    fn new(
        root: PathBuf,
        manifest: Manifest,
        rows: Vec<(u64, FrameRow)>,
        rows_path: &Path,
    ) -> Result<Self, DatasetError> {
        Self::within(Vec::new(), root, manifest, rows, rows_path)
    }

    /// As `new`, for files with absolute paths in given folders.
    fn within(
        folders: Vec<PathBuf>,
        root: PathBuf,
        manifest: Manifest,
        rows: Vec<(u64, FrameRow)>,
        rows_path: &Path,
    ) -> Result<Self, DatasetError> {
        let fault = |line, message| DatasetError::Row { path: rows_path.into(), line, message };
        let mut files = HashSet::new();
        let mut places = HashSet::new();
        let mut set_places: HashMap<u32, usize> = HashMap::new();
        let mut sets: Vec<Set> = Vec::new();
        for (i, (line, row)) in rows.iter().enumerate() {
            check_row(row, &folders).map_err(|message| fault(*line, message))?;
            // `./a` equals `a`: names are compared in normalised form.
            if !files.insert(plain_name(&row.file)) {
                return Err(fault(*line, format!("file {} stands in an earlier row too", echo(&row.file))));
            }
            if !places.insert((row.set, row.index)) {
                let message = format!("set {} index {} stands in an earlier row too", row.set, row.index);
                return Err(fault(*line, message));
            }
            let place = *set_places.entry(row.set).or_insert_with(|| {
                sets.push(Set { number: row.set, rows: Vec::new() });
                sets.len() - 1
            });
            if let Some(&first) = sets[place].rows.first() {
                same_settings(&rows[first].1, row).map_err(|message| fault(*line, message))?;
            }
            sets[place].rows.push(i);
        }
        let rows: Vec<FrameRow> = rows.into_iter().map(|(_, row)| row).collect();
        for set in &mut sets {
            set.rows.sort_by_key(|&i| rows[i].index);
        }
        Ok(Self {
            root,
            manifest,
            rows,
            sets,
            parts: Vec::new(),
            folders,
            reduced: None,
            faults: None,
            opened: Arc::default(),
            rows_of_files: Arc::default(),
            kept: Arc::default(),
            examination: UNEXAMINED,
            passed_over: None,
            cut: None,
        })
    }

    /// Attaches statistics of the frames.
    pub(crate) fn with_reduced(mut self, reduced: Reduced) -> Self {
        self.reduced = Some(Arc::new(reduced));
        self
    }

    /// Returns the frame statistics of a statistics file, which replace reading frames.
    pub fn reduced(&self) -> Option<&Reduced> {
        self.reduced.as_deref()
    }

    /// Returns metadata of camera and bench; for joined datasets those of the first.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Returns every row in file order, which is time order.
    pub fn rows(&self) -> &[FrameRow] {
        &self.rows
    }

    /// Returns the sets in time order.
    pub fn sets(&self) -> &[Set] {
        &self.sets
    }

    /// Returns true if the light is stated in photons without an uncertainty: nominal, as in an EMVA
    /// 1288 descriptor.
    pub fn light_is_nominal(&self) -> bool {
        let bench = self.manifest.bench.as_ref();
        bench.is_some_and(|b| b.illumination_unit == "photons/px/s" && b.illumination_rel_std.is_none())
    }

    /// Returns the first row of a set, which gives its settings.
    pub fn settings(&self, set: &Set) -> &FrameRow {
        &self.rows[set.rows[0]]
    }

    /// Returns the folder of the dataset.
    pub fn root(&self) -> &Path {
        &self.root
    }
}

/// Lists the planes of a mosaic as accepted by `--plane`, with their colours, for a PFNC pixel format or
/// a pattern such as RGGB.
pub(crate) fn planes_in_words(mosaic: &str) -> String {
    let pattern = mosaic.to_uppercase();
    let start = pattern.strip_prefix("BAYER").unwrap_or(&pattern).get(..2);
    let colours = match start {
        Some("RG") => [" (R)", " (G)", " (G)", " (B)"],
        Some("BG") => [" (B)", " (G)", " (G)", " (R)"],
        Some("GR") => [" (G)", " (R)", " (B)", " (G)"],
        Some("GB") => [" (G)", " (B)", " (R)", " (G)"],
        _ => [""; 4],
    };
    let [a, b, c, d] = colours;
    format!("--plane 0,0{a}, 0,1{b}, 1,0{c} or 1,1{d}")
}

/// Gives advice on a folder without `dataset.toml`, based on its contents.
fn no_manifest(folder: &Path) -> String {
    let mut inside: Vec<PathBuf> =
        std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    inside.sort();
    let is = |path: &PathBuf, kinds: &[&str]| {
        let kind = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        kinds.contains(&&*kind)
    };
    let name = folder.display();
    if inside.iter().any(|p| p.join("dataset.toml").exists()) {
        let dataset = inside.iter().find(|p| p.join("dataset.toml").exists());
        return format!("has no dataset.toml; {} is a dataset", dataset.unwrap_or(&folder.into()).display());
    }
    if let Some(text) = inside.iter().find(|p| is(p, &["txt"]) && emva::open(p).is_ok()) {
        return format!("has no dataset.toml; {} is an EMVA 1288 descriptor: give that file", text.display());
    }
    if inside.iter().any(|p| {
        p.is_dir() || is(p, &["tif", "tiff", "png", "bmp", "fits", "fit", "npy", "h5", "hdf5", "nxs"])
    }) {
        return format!("has no dataset.toml; for loose images: radcam import {name} -o DATASET");
    }
    "has no dataset.toml: no dataset".into()
}

/// Reads the text of a descriptor or table; an image is reported as such.
fn text(path: &Path) -> Result<String, DatasetError> {
    let start = input::start(path, 1024).map_err(DatasetError::io(path))?;
    let refused = |message: &str| DatasetError::Manifest { path: path.into(), message: message.into() };
    if start.is_empty() {
        return Err(refused("is empty: a copy that was cut off?"));
    }
    if start.starts_with(b"\xff\xfe") || start.starts_with(b"\xfe\xff") {
        return Err(refused("a text in UTF-16; save it as UTF-8"));
    }
    if start.starts_with(ANY_HEAD) {
        return Err(refused("statistics of another version of radcam: reduce the frames anew with this one"));
    }
    let text = match (start.contains(&0), input::table(path)) {
        (false, Ok(text)) => Some(text),
        (false, Err(e)) if e.kind() != std::io::ErrorKind::InvalidData => {
            return Err(DatasetError::io(path)(e));
        }
        _ => None,
    };
    text.ok_or_else(|| {
        refused(
            "no text but an image or another binary file; a dataset is a folder with dataset.toml, an EMVA 1288 descriptor, \
             or a table (CSV with mean_dn and var_dn2)",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn rows(text: &str) -> Result<Dataset, DatasetError> {
        let path = Path::new("frames.csv");
        let header = COLUMNS.join(",");
        let rows = parse_rows(path, &format!("{header}\n{text}"))?;
        Dataset::new("/nowhere".into(), Manifest::new(CameraInfo::default()), rows, path)
    }

    #[test]
    fn damaged_rows_are_named() {
        let good = "a.tiff,flat,3,0,0.01,1,0,,0.5\n";
        for (text, part) in [
            ("../a.tiff,flat,0,0,0.01,1,0,,\n", "inside the dataset folder"),
            ("/a.tiff,flat,0,0,0.01,1,0,,\n", "inside the dataset folder"),
            ("a.tiff#x,flat,0,0,0.01,1,0,,\n", "page"),
            ("a.tiff,flot,0,0,0.01,1,0,,\n", "flot"),
            ("a.tiff,flat,0,0,fast,1,0,,\n", "exposure_s"),
            ("a.tiff,flat,0,0,-1,1,0,,\n", "above 0 s"),
            ("a.tiff,dark,0,0,1,1,0,,\n", "illumination 0"),
            ("a.tiff,flat,0,0,1,nan,0,,\n", "illumination"),
            ("a.tiff,flat,0\n", "has 3 fields"),
            ("a.tiff,flat,0,0,1,1,0,,\r\nb.tiff,flat,0,x,1,1,0,,\r\n", "line 3: index"),
            (&format!("{good}{good}"), "line 3: file a.tiff stands in an earlier row"),
            (&format!("{good}b.tiff,flat,3,0,0.01,1,0,,\n"), "set 3 index 0"),
            (&format!("{good}b.tiff,flat,3,1,0.02,1,0,,\n"), "exposure_s differs"),
        ] {
            let message = rows(text).expect_err(text).to_string();
            assert!(message.contains(part) && message.contains("frames.csv, line"), "{message}");
        }
        assert!(parse_rows(Path::new("f"), "file,kind\n").unwrap_err().to_string().contains("exactly"));
    }

    #[test]
    fn joined_datasets_follow_one_another() {
        let dir = tempfile::tempdir().unwrap();
        let part = |name: &str, gain_db: f64| {
            let camera = CameraInfo {
                width: 2,
                height: 1,
                bit_depth: 12,
                gain_db: Some(gain_db),
                ..Default::default()
            };
            let mut writer = Writer::create(&dir.path().join(name), &Manifest::new(camera), &[]).unwrap();
            for index in 0..2 {
                let row = FrameRow {
                    file: String::new(),
                    kind: Kind::Flat,
                    set: 3,
                    index,
                    exposure_s: 0.5,
                    illumination: 1.0,
                    configuration: 0,
                    temperature_c: None,
                    timestamp_s: Some(f64::from(index)),
                };
                writer.append(row, &ndarray::array![[index as u16, 9]]).unwrap();
            }
            Dataset::open(&dir.path().join(name)).unwrap()
        };
        let (a, b) = (part("a", 0.0), part("b", 0.0));
        let all = Dataset::join(vec![a.clone(), b]).unwrap();
        let sets: Vec<_> = all.sets().iter().map(|s| (s.number, s.rows.clone())).collect();
        assert_eq!(sets, [(3, vec![0, 1]), (4, vec![2, 3])]);
        assert_eq!(
            all.rows().iter().map(|r| r.timestamp_s.unwrap()).collect::<Vec<_>>(),
            [0.0, 1.0, 1.5, 2.5]
        );
        assert_eq!(
            (0..4).map(|r| all.part_of(r)).collect::<Vec<_>>(),
            [(0, true), (0, false), (1, true), (1, false)]
        );
        assert_eq!(all.read_set(&all.sets()[1]).unwrap()[1], ndarray::array![[1, 9]]);
        let fault = |other: Dataset| Dataset::join(vec![a.clone(), other]).unwrap_err().to_string();
        assert!(fault(part("c", 6.0)).contains("gain is"));
        assert!(fault(a.clone()).contains("twice"));
    }

    #[test]
    fn sets_come_in_the_order_of_time() {
        let text = "b.tiff,flat,7,1,1,1,0,,\na.tiff,flat,7,0,1,1,0,20.5,\nc.tiff,dark,2,0,1,0,0,,\n";
        let dataset = rows(text).unwrap();
        let sets: Vec<_> = dataset.sets().iter().map(|s| (s.number, s.rows.clone())).collect();
        assert_eq!(sets, [(7, vec![1, 0]), (2, vec![2])]);
        assert_eq!(dataset.rows()[1].temperature_c, Some(20.5));
    }

    proptest! {
        #[test]
        fn no_text_makes_the_reader_panic(text in "(\\PC|\n|,){0,200}") {
            let _ = rows(&text);
        }

        #[test]
        fn rows_survive_a_round_trip(
            set in 0u32..99, index in 0u32..99, exposure_s in 1e-6f64..1e3, light in 0.0f64..2.0,
            temperature_c in prop::option::of(-50.0f64..80.0), timestamp_s in prop::option::of(0.0f64..1e6),
        ) {
            let row = FrameRow {
                file: "frames/a b,c.tiff#2".into(), kind: Kind::Flat, set, index, exposure_s,
                illumination: light, configuration: 1, temperature_c, timestamp_s,
            };
            let mut out = csv::Writer::from_writer(Vec::new());
            out.serialize(&row).unwrap();
            let text = String::from_utf8(out.into_inner().unwrap()).unwrap();
            let back = parse_rows(Path::new("f"), &text).unwrap();
            prop_assert_eq!(&back[0].1, &row);
        }
    }
}
