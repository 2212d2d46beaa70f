//! A campaign on disk: a folder with `dataset.toml`, `frames.csv` and the frames.
//!
//! [`Dataset::open`] also reads the descriptor file of an EMVA 1288 test. A table of statistics, which has no
//! frames, is [`table::Table`].

mod emva;
mod fault;
pub mod image;
mod kept;
mod manifest;
mod rows;
pub mod table;
pub mod tag;
mod write;

pub use emva::{DESCRIPTOR, write_descriptor};
pub use fault::{DataFault, FaultKind};
pub use manifest::{BenchInfo, CameraInfo, FORMAT, ImportInfo, Manifest};
pub(crate) use rows::{Lines, MAX_EXPOSURE_S, csv_words};
pub(crate) use write::{Aside, synchronise};
pub use write::{Folder, Writer, write_whole};

use crate::data_faults::SharedNoise;
use crate::input::{self, echo};
use crate::reduction::{self, Reduced};
use crate::statistics::outliers;
use ndarray::Array2;
use rows::{check_row, parse_rows, plain_name, same_settings, split_page};
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, HashSet};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

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

/// Ratio of the darks' exposure to the longest one of the flats from which on their dark charge is no matter of the
/// flats (a named choice).
pub(crate) const LONG_DARKS: f64 = 2.0;

/// What a frame shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// No light.
    Dark,
    /// A uniform card.
    Flat,
    /// Anything else of one still scene.
    Scene,
    /// A scene-variation surface.
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
    /// What the frame shows.
    pub kind: Kind,
    /// Frames of one set share every setting and follow one another in time.
    pub set: u32,
    /// Place within the set, from 0.
    pub index: u32,
    /// Commanded exposure, s.
    pub exposure_s: f64,
    /// Relative to the campaign's unit; 0 for darks.
    pub illumination: f64,
    /// Position of card and light (Section V of the paper).
    pub configuration: u32,
    /// Sensor temperature, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Start of the exposure, s from the start of the campaign.
    pub timestamp_s: Option<f64>,
}

/// What is wrong with a dataset, and where.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// The file system refused.
    #[error("{path}: {source}")]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
    /// `dataset.toml` or the descriptor cannot be understood.
    #[error("{path}: {message}")]
    Manifest {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// A row is wrong.
    #[error("{path}, line {line}: {message}")]
    Row {
        /// `frames.csv`, the descriptor or the table.
        path: PathBuf,
        /// Line of that file, from 1.
        line: u64,
        /// What is wrong.
        message: String,
    },
    /// A frame is wrong.
    #[error("frame {} (set {set}, index {index}): {message}", echo(.file))]
    Frame {
        /// Path as `frames.csv` has it.
        file: String,
        /// Its set.
        set: u32,
        /// Its place in the set.
        index: u32,
        /// What is wrong.
        message: String,
    },
}

impl DatasetError {
    pub(crate) fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, source }
    }
}

/// Frames that share every setting, in the order of time.
#[derive(Debug, Clone)]
pub struct Set {
    /// Number of the set in `frames.csv`.
    pub number: u32,
    /// Places of its frames in [`Dataset::rows`].
    pub rows: Vec<usize>,
}

/// A campaign: its manifest and its rows; frames are read when asked for.
#[derive(Debug, Clone)]
pub struct Dataset {
    root: PathBuf,
    manifest: Manifest,
    rows: Vec<FrameRow>,
    sets: Vec<Set>,
    /// Of several that were joined: their folders, and the first row of each. Empty otherwise.
    parts: Vec<(PathBuf, usize)>,
    /// Folders in which rows with absolute paths may lie.
    folders: Vec<PathBuf>,
    /// What is known of frames without reading them.
    reduced: Option<Arc<Reduced>>,
    /// Faults found by the examination; `None` before it.
    faults: Option<Arc<[DataFault]>>,
    /// Stacks that were opened.
    opened: Arc<image::Opened>,
    /// Row of every file and page that was read, after links.
    rows_of_files: Arc<Mutex<HashMap<(PathBuf, usize), String>>>,
    /// Frames that [`frame`](Self::frame) has read.
    kept: Arc<kept::Kept>,
    /// Findings of the examination beside them.
    examination: Examination,
    /// Sets that the examination left out, and that were exposed nonetheless.
    passed_over: Option<Arc<(Dataset, Vec<PassedOver>)>>,
}

/// Set that is left out, and was exposed nonetheless: what follows it may carry its charge.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PassedOver {
    /// Number of the set.
    pub set: u32,
    /// Mean of its last frame, DN.
    pub last_dn: f64,
    /// True if its charge is that of stated exposure and light, and its level is not, as under another gain.
    pub as_stated: bool,
}

/// Findings of the examination beside the faults.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Examination {
    /// Step of the converter as the codes show it, DN; 1 before.
    pub code_step_dn: f64,
    /// Single samples that stand far off.
    pub struck: StruckSamples,
    /// Share of a change of level that first frames carry from the set before; 0 where none is seen.
    pub carried_share: f64,
    /// Noise that neighbours or successive frames share.
    pub shared_noise: Option<SharedNoise>,
    /// True if the flats are dark-subtracted: the black level of the manifest is not theirs.
    pub flats_are_dark_subtracted: bool,
}

/// Values before the examination.
const UNEXAMINED: Examination = Examination {
    code_step_dn: 1.0,
    struck: StruckSamples { number: 0, are_rays: true },
    carried_share: 0.0,
    shared_noise: None,
    flats_are_dark_subtracted: false,
};

/// Single samples that stand far off the same pixel in other frames.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StruckSamples {
    /// Their number; 0 before the examination.
    pub number: u64,
    /// False where they lie in the same pixels again and again, and belong to the sensor.
    pub are_rays: bool,
}

impl Dataset {
    /// Opens a dataset folder or an EMVA 1288 descriptor file, and checks every row of it.
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
    /// Where the folder, the descriptor or a row cannot be understood: file, line and what is wrong.
    pub fn open(path: &Path) -> Result<Self, DatasetError> {
        if path.is_file() {
            if reduction::is_statistics(path) {
                return reduction::open(path);
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

    /// Groups rows into sets, and checks them.
    fn new(
        root: PathBuf,
        manifest: Manifest,
        rows: Vec<(u64, FrameRow)>,
        rows_path: &Path,
    ) -> Result<Self, DatasetError> {
        Self::within(Vec::new(), root, manifest, rows, rows_path)
    }

    /// The same where files have absolute paths in some folders.
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
            // `./a` is `a`: names are compared without what does not change them.
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
        })
    }

    /// Several datasets of one camera under one set of settings as one: sets and times of each follow those
    /// of the one before.
    ///
    /// Their light levels are told apart, for nobody knows that two campaigns had the same light. The pause
    /// between them is not known.
    ///
    /// # Errors
    ///
    /// Where they differ in camera, settings or unit of light, or one is given twice.
    pub fn join(datasets: Vec<Self>) -> Result<Self, DatasetError> {
        let mut datasets = datasets.into_iter();
        let Some(mut all) = datasets.next() else {
            return Err(DatasetError::Manifest { path: "datasets".into(), message: "none is given".into() });
        };
        let Some(second) = datasets.next() else { return Ok(all) };
        all.parts.push((all.root.clone(), 0));
        all.rows_of_files = Arc::default();
        all.rows.iter_mut().for_each(|r| r.file = all.root.join(&r.file).to_string_lossy().into_owned());
        for next in std::iter::once(second).chain(datasets) {
            let files: HashSet<PathBuf> = all
                .rows
                .iter()
                .take(1)
                .chain(all.parts.iter().skip(1).map(|(_, at)| &all.rows[*at]))
                .filter_map(|r| Path::new(split_page(&r.file).ok()?.0).canonicalize().ok())
                .collect();
            let first_file = next
                .rows
                .first()
                .and_then(|r| next.root.join(split_page(&r.file).ok()?.0).canonicalize().ok());
            if first_file.is_some_and(|file| files.contains(&file)) {
                return Err(DatasetError::Manifest { path: next.root, message: "is given twice".into() });
            }
            let differs = all.manifest.differences(&next.manifest);
            if !differs.is_empty() {
                return Err(DatasetError::Manifest {
                    path: next.root,
                    message: format!(
                        "{} in {}: only datasets of one camera under one set of settings go together",
                        differs.join("; "),
                        all.root.display()
                    ),
                });
            }
            let first = all.rows.len();
            let number = all.sets.iter().map(|s| s.number.saturating_add(1)).max().unwrap_or(0);
            let least = next.sets.iter().map(|s| s.number).min().unwrap_or(0);
            let ends = all.rows.iter().filter_map(|r| Some(r.timestamp_s? + r.exposure_s));
            let end_s = ends.fold(0.0, f64::max);
            let renumbered = |k: u32| number.saturating_add(k - least);
            all.rows.extend(next.rows.into_iter().map(|r| FrameRow {
                file: next.root.join(&r.file).to_string_lossy().into_owned(),
                set: renumbered(r.set),
                timestamp_s: r.timestamp_s.map(|t| t + end_s),
                ..r
            }));
            all.sets.extend(next.sets.into_iter().map(|s| Set {
                number: renumbered(s.number),
                rows: s.rows.into_iter().map(|i| first + i).collect(),
            }));
            all.folders.extend(next.folders);
            all.parts.push((next.root, first));
        }
        Ok(all)
    }

    /// Rows of one campaign whose files have absolute paths in some folders.
    pub(crate) fn of_parts(
        root: &Path,
        manifest: Manifest,
        rows: Vec<FrameRow>,
        folders: Vec<PathBuf>,
    ) -> Result<Self, DatasetError> {
        let rows = rows.into_iter().enumerate().map(|(i, row)| (i as u64 + 1, row)).collect();
        Self::within(folders, root.into(), manifest, rows, root)
    }

    /// The same with absolute paths, so that its rows can go together with others.
    pub(crate) fn absolute(mut self) -> Result<Self, DatasetError> {
        if self.folders.is_empty() {
            let root = self.root.canonicalize().map_err(DatasetError::io(&self.root))?;
            for row in &mut self.rows {
                let file = root.join(&row.file);
                let Some(file) = file.to_str() else {
                    let message = format!("{} is not UTF-8: rename it", file.display());
                    return Err(DatasetError::Manifest { path: root, message });
                };
                row.file = file.into();
            }
            self.folders.push(root);
            self.rows_of_files = Arc::default();
        }
        Ok(self)
    }

    /// With what is known of its frames.
    pub(crate) fn with_reduced(mut self, reduced: Reduced) -> Self {
        self.reduced = Some(Arc::new(reduced));
        self
    }

    /// What is known of frames without reading them, of a file of statistics.
    pub fn reduced(&self) -> Option<&Reduced> {
        self.reduced.as_deref()
    }

    /// Faults that [`examined`](crate::data_faults::examined) found; empty before it ran.
    pub fn data_faults(&self) -> &[DataFault] {
        self.faults.as_deref().unwrap_or_default()
    }

    /// Distance of the codes of the converter, DN, as [`examined`](crate::data_faults::examined) found it from
    /// the codes that occur: 16 of 12 bits in the upper bits of 16; 1 before it ran, and of codes that are the
    /// converter's.
    pub fn code_step_dn(&self) -> f64 {
        self.examination.code_step_dn
    }

    /// Number of single samples that stand far off the same pixel in other frames (cosmic rays, bit errors); 0
    /// before [`examined`](crate::data_faults::examined) ran.
    pub fn struck(&self) -> u64 {
        self.examination.struck.number
    }

    /// Share of a change of level that first frames carry from the set before, by image lag or a filter over
    /// time, as [`examined`](crate::data_faults::examined) found it; 0 before it ran, and where none is seen.
    pub fn carried_share(&self) -> f64 {
        self.examination.carried_share
    }

    /// Black level of the manifest, DN; `None` for dark-subtracted flats.
    pub fn black_level_dn(&self) -> Option<f64> {
        self.manifest().camera.black_level_dn.filter(|_| !self.examination.flats_are_dark_subtracted)
    }

    /// Noise that neighbours or successive frames share in all flats.
    pub(crate) fn shared_noise(&self) -> Option<SharedNoise> {
        self.examination.shared_noise
    }

    /// False where the samples that stand far off lie in the same pixels again and again: noisy pixels.
    pub(crate) fn struck_are_rays(&self) -> bool {
        self.examination.struck.are_rays
    }

    /// Frames without single samples that stand far off the same pixel in the others, where these are rays,
    /// and how many they are.
    pub(crate) fn without_struck(&self, block: Vec<Arc<Array2<u16>>>) -> (Vec<Arc<Array2<u16>>>, usize) {
        if !self.examination.struck.are_rays {
            return (block, 0);
        }
        let (block, pixels) = outliers::without_struck(&block);
        (block, pixels.len())
    }

    /// Variance of quantisation, DN^2: q^2 / 12 (eq. 27 of Healey and Kondepudy).
    pub fn quantisation_dn2(&self) -> f64 {
        self.examination.code_step_dn.powi(2) / 12.0
    }

    /// Returns true after [`examined`](crate::data_faults::examined).
    pub fn is_examined(&self) -> bool {
        self.faults.is_some()
    }

    /// Removes rows because of these faults. Some of the sets were exposed nonetheless.
    pub(crate) fn without(
        &self,
        out: &[bool],
        passed_over: Vec<PassedOver>,
        faults: Vec<DataFault>,
        examination: Examination,
    ) -> Self {
        let mut kept = self.only(|row| !out[row]);
        (kept.faults, kept.examination) = (Some(faults.into()), examination);
        if !passed_over.is_empty() {
            let is_passed_over = |set: &&Set| passed_over.iter().any(|p| p.set == set.number);
            let rows: HashSet<usize> =
                self.sets.iter().filter(is_passed_over).flat_map(|s| s.rows.iter().copied()).collect();
            let mut all = self.only(|row| !out[row] || rows.contains(&row));
            (all.faults, all.examination) = (kept.faults.clone(), examination);
            kept.passed_over = Some(Arc::new((all, passed_over)));
        }
        kept
    }

    /// The campaign with the sets that were left out and exposed nonetheless, and these.
    pub(crate) fn timeline(&self) -> (Self, Vec<PassedOver>) {
        match &self.passed_over {
            Some(all) => (**all).clone(),
            None => (self.clone(), Vec::new()),
        }
    }

    /// Dataset of some of its rows.
    fn only(&self, keeps: impl Fn(usize) -> bool) -> Self {
        let out: Vec<bool> = (0..self.rows.len()).map(|row| !keeps(row)).collect();
        let mut place = Vec::with_capacity(out.len());
        let mut kept = 0;
        for out in &out {
            place.push(kept);
            kept += usize::from(!out);
        }
        let of_set = |set: &Set| {
            let rows: Vec<usize> = set.rows.iter().filter(|r| !out[**r]).map(|r| place[*r]).collect();
            (!rows.is_empty()).then_some(Set { number: set.number, rows })
        };
        let rows = self.rows.iter().zip(&out).filter(|(_, out)| !**out).map(|(r, _)| r.clone()).collect();
        let parts =
            self.parts.iter().map(|(root, first)| (root.clone(), place.get(*first).copied().unwrap_or(kept)));
        Self {
            rows,
            sets: self.sets.iter().filter_map(of_set).collect(),
            parts: parts.collect(),
            ..self.clone()
        }
    }

    /// Folders in which rows with absolute paths may lie: none of a dataset folder.
    pub fn folders(&self) -> &[PathBuf] {
        &self.folders
    }

    /// Of joined datasets: which one a row is of, and whether it is the first of it.
    pub fn part_of(&self, row: usize) -> (usize, bool) {
        let part = self.parts.iter().rposition(|(_, first)| *first <= row).unwrap_or(0);
        (part, self.parts.get(part).is_some_and(|(_, first)| *first == row))
    }

    /// The folders of the datasets that were joined; of one that was not, none.
    pub fn parts(&self) -> Vec<&Path> {
        self.parts.iter().map(|(root, _)| root.as_path()).collect()
    }

    /// What camera and bench said of themselves; of joined datasets those of the first.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// One colour of a mosaic, as a campaign of half the size: the pixel at this row and column, 0 or 1, of every
    /// 2 x 2 cell.
    ///
    /// # Errors
    ///
    /// Where it is one plane already, or statistics whose frames are not read again.
    pub fn plane(mut self, plane: [u8; 2]) -> Result<Self, DatasetError> {
        let fault =
            |message: &str| DatasetError::Manifest { path: self.root.clone(), message: message.into() };
        if self.manifest.plane.is_some() {
            return Err(fault("is one plane of a mosaic already; leave --plane out"));
        }
        if self.reduced.is_some() {
            return Err(fault("holds statistics of all pixels; take the plane where the frames are reduced"));
        }
        let camera = &mut self.manifest.camera;
        let half = |pixels: usize, from: u8| pixels.saturating_sub(from.into()).div_ceil(2);
        (camera.height, camera.width) = (half(camera.height, plane[0]), half(camera.width, plane[1]));
        camera.pixel_format = format!("Mono{}", camera.bit_depth);
        self.manifest.plane = Some(plane);
        self.kept = Arc::default();
        Ok(self)
    }

    /// Refuses a colour mosaic, for statistics that hold for pixels of one kind: its planes differ in light and,
    /// with a white balance, in gain.
    ///
    /// # Errors
    ///
    /// Where the frames are a mosaic, with its format and what to do.
    pub fn must_be_monochrome(&self) -> Result<(), DatasetError> {
        let camera = &self.manifest.camera;
        if !camera.is_mosaic() {
            return Ok(());
        }
        let message = format!(
            "pixel_format is {}: a colour mosaic, whose planes differ in light and gain; measure each colour by itself with {}",
            echo(&camera.pixel_format),
            planes_in_words(&camera.pixel_format)
        );
        Err(DatasetError::Manifest { path: self.root.clone(), message })
    }

    /// Every row, in the order of the file, which is the order of time.
    pub fn rows(&self) -> &[FrameRow] {
        &self.rows
    }

    /// Sets in the order of time.
    pub fn sets(&self) -> &[Set] {
        &self.sets
    }

    /// Whether the light is stated in photons, without an error of its own: nominal, as an EMVA 1288
    /// descriptor has it.
    pub fn light_is_nominal(&self) -> bool {
        let bench = self.manifest.bench.as_ref();
        bench.is_some_and(|b| b.illumination_unit == "photons/px/s" && b.illumination_rel_std.is_none())
    }

    /// The first row of a set: its settings.
    pub fn settings(&self, set: &Set) -> &FrameRow {
        &self.rows[set.rows[0]]
    }

    /// Where the dataset lies.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Reads one frame, (rows, columns) in DN, and checks its size and range by the manifest.
    ///
    /// # Errors
    ///
    /// Which frame cannot be read, or has another size or larger codes than the manifest says.
    pub fn read(&self, row: &FrameRow) -> Result<Array2<u16>, DatasetError> {
        if let Some(known) = self.kept.get(&row.file) {
            return Ok(Arc::unwrap_or_clone(known));
        }
        let mut buffer = image::Buffer::default();
        self.read_into(row, &mut buffer)?;
        Ok(buffer.into_array())
    }

    /// The same, kept in memory for the next time as long as there is room: several passes decode a frame once.
    pub(crate) fn frame(&self, row: &FrameRow) -> Result<Arc<Array2<u16>>, DatasetError> {
        if let Some(known) = self.kept.get(&row.file) {
            return Ok(known);
        }
        let frame = Arc::new(self.read(row)?);
        self.kept.put(&row.file, &frame);
        Ok(frame)
    }

    /// Gives the memory of [`frame`](Self::frame) back.
    pub(crate) fn forget_frames(&self) {
        self.kept.clear();
    }

    /// The same as [`read`](Self::read) into memory that is there: many frames one after the other cost less so.
    ///
    /// # Errors
    ///
    /// As [`read`](Self::read).
    pub fn read_into(&self, row: &FrameRow, buffer: &mut image::Buffer) -> Result<(), DatasetError> {
        let fault = |message: String| DatasetError::Frame {
            file: row.file.clone(),
            set: row.set,
            index: row.index,
            message,
        };
        let (name, page) = split_page(&row.file).map_err(fault)?;
        let mut root = &self.root;
        let roots = || self.parts.iter().map(|(root, _)| root).chain(&self.folders);
        if let Some(of_part) = roots().find(|root| Path::new(name).starts_with(root)) {
            root = of_part;
        }
        // Joining a path with one that begins as it does would double it.
        let path = if roots().next().is_none() { root.join(name) } else { name.into() };
        // A link inside the folder may point out of it.
        let whole = match (path.canonicalize(), root.canonicalize()) {
            (Ok(path), Ok(root)) if path.starts_with(&root) => path,
            (Ok(_), Ok(_)) => return Err(fault("the path leaves the dataset folder".into())),
            (Err(e), _) | (_, Err(e)) => {
                return Err(fault(format!("{}: {e}", echo(&path.display().to_string()))));
            }
        };
        self.must_be_one_row(row, (whole, page)).map_err(fault)?;
        let read = if row.file.len() == name.len() {
            image::read_into(&path, None, buffer)
        } else {
            self.opened.stack(&path).and_then(|images| images.read_into(page, buffer))
        };
        read.map_err(|e| match e {
            image::ImageError::Stack(_) => fault(format!("{e}; a row names its page as {name}#0")),
            e => fault(e.to_string()),
        })?;
        let camera = &self.manifest.camera;
        if let Some(plane) = self.manifest.plane {
            buffer.keep_plane(plane);
        }
        if buffer.shape() != (camera.height, camera.width) {
            let (h, w) = buffer.shape();
            let of = self.manifest.plane.map_or(String::new(), |[y, x]| format!("has a plane {y},{x} that "));
            return Err(fault(format!(
                "{of}is {w} x {h} px, and dataset.toml says {} x {} px",
                camera.width, camera.height
            )));
        }
        let full_scale = camera.full_scale_dn();
        if buffer.dn().iter().fold(0, |a, &b| a | b) > full_scale {
            let largest = buffer.dn().iter().max().copied().unwrap_or(0);
            return Err(fault(format!(
                "holds {largest} DN, and bit_depth = {} in dataset.toml allows at most {full_scale} DN",
                camera.bit_depth
            )));
        }
        Ok(())
    }

    /// Refuses a file that another row names too, by a link or a loop of links.
    fn must_be_one_row(&self, row: &FrameRow, file: (PathBuf, usize)) -> Result<(), String> {
        let mut known = self.rows_of_files.lock().unwrap_or_else(PoisonError::into_inner);
        let first = known.entry(file).or_insert_with(|| row.file.clone());
        if *first == row.file {
            return Ok(());
        }
        Err(format!("is the file of row {} too, by a link: a frame is named twice", echo(first)))
    }

    /// Reads the frames of a set in the order of time.
    ///
    /// # Errors
    ///
    /// Which frame cannot be read, or has another size or larger codes than the manifest says.
    pub fn read_set(&self, set: &Set) -> Result<Vec<Array2<u16>>, DatasetError> {
        set.rows.iter().map(|&i| self.read(&self.rows[i])).collect()
    }
}

/// The planes of a mosaic as `--plane` takes them, with their colours; of a PFNC pixel format or a pattern such
/// as RGGB.
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

/// What to do with a folder that has no `dataset.toml`: what lies in it says what it is.
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
    if inside
        .iter()
        .any(|p| p.is_dir() || is(p, &["tif", "tiff", "png", "fits", "fit", "npy", "h5", "hdf5", "nxs"]))
    {
        return format!("has no dataset.toml; for loose images: radcam import {name} -o DATASET");
    }
    "has no dataset.toml: no dataset".into()
}

/// The text of a descriptor or a table; of an image that it is one.
fn text(path: &Path) -> Result<String, DatasetError> {
    let start = input::start(path, 1024).map_err(DatasetError::io(path))?;
    if start.starts_with(b"\xff\xfe") || start.starts_with(b"\xfe\xff") {
        let message = "a text in UTF-16; save it as UTF-8".into();
        return Err(DatasetError::Manifest { path: path.into(), message });
    }
    let text = match (start.contains(&0), input::table(path)) {
        (false, Ok(text)) => Some(text),
        (false, Err(e)) if e.kind() != std::io::ErrorKind::InvalidData => {
            return Err(DatasetError::io(path)(e));
        }
        _ => None,
    };
    text.ok_or_else(|| DatasetError::Manifest {
        path: path.into(),
        message: "no text but an image or another binary file; a dataset is a folder with dataset.toml, an EMVA 1288 descriptor, \
                  or a table (CSV with mean_dn and var_dn2)"
            .into(),
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
