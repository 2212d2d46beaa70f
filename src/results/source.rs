//! Sources of measurements: datasets, EMVA 1288 descriptors, tables.

use crate::data_faults::{DataFault, ExamineError, examined};
use crate::dataset::table::Table;
use crate::dataset::{Dataset, DatasetError, Set};
use crate::diagnosis::{Diagnosis, diagnose, searched};
use crate::inference::Given;
use crate::noise::{self, NoiseError, NoiseReport};
use crate::observables::{self, Observations, ObserveError};
use crate::reduction;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Frames, or statistics of frames.
///
/// ```
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("ptc.csv");
/// # std::fs::write(&path, "mean_dn,var_dn2\n100,41\n200,81\n400,161\n800,321\n")?;
/// let source = radcam::source::Source::open(&path)?; // a dataset folder, an EMVA 1288 descriptor or a table
/// let report = source.noise()?;
/// assert!((report.gain_dn_per_e.value - 0.4).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub enum Source {
    /// Frames: a dataset folder or the files that an EMVA 1288 descriptor names.
    Frames(Box<Dataset>),
    /// Means and variances.
    Table(Table),
}

impl Source {
    /// Opens a dataset folder, the descriptor of an EMVA 1288 test, or a table (CSV with `mean_dn` and
    /// `var_dn2`).
    ///
    /// # Errors
    ///
    /// The path does not exist or cannot be read; the message gives file and line.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, DatasetError> {
        let path = path.as_ref();
        if path.is_file() && Table::is_table(path) {
            return Ok(Self::Table(Table::open(path)?));
        }
        Ok(Self::Frames(Box::new(reduction::open(path)?)))
    }

    /// Opens several datasets of one camera and one set of settings as one ([`Dataset::join`]). A table must
    /// be alone.
    ///
    /// # Errors
    ///
    /// As [`open`](Self::open); also if two datasets differ in camera or settings, or one is a table.
    pub fn open_all(paths: &[PathBuf]) -> Result<Self, DatasetError> {
        if let [path] = paths {
            return Self::open(path);
        }
        if let Some(table) = paths.iter().find(|p| p.is_file() && Table::is_table(p)) {
            let message = "is a table: only datasets with frames go together".into();
            return Err(DatasetError::Manifest { path: table.clone(), message });
        }
        let all = paths.iter().map(|p| reduction::open(p)).collect::<Result<_, _>>()?;
        Ok(Self::Frames(Box::new(Dataset::join(all)?)))
    }

    /// Selects one colour of a mosaic ([`Dataset::plane`]).
    ///
    /// # Errors
    ///
    /// The source is a single plane already, or consists of statistics whose frames are not read again.
    pub fn plane(self, plane: [u8; 2]) -> Result<Self, DatasetError> {
        match self {
            Self::Frames(dataset) => Ok(Self::Frames(Box::new(dataset.plane(plane)?))),
            Self::Table(_) => {
                let message = "a table of statistics has no planes; leave it out".into();
                Err(DatasetError::Manifest { path: "--plane".into(), message })
            }
        }
    }

    /// Removes faulty sets and frames ([`examined`]). `stop` cancels. Tables are returned unchanged.
    ///
    /// # Errors
    ///
    /// The source is a colour mosaic, a frame cannot be read, or the call was stopped.
    pub fn examined(self, stop: &AtomicBool) -> Result<Self, ExamineError> {
        Ok(match self {
            Self::Frames(dataset) => {
                dataset.must_be_monochrome()?;
                Self::Frames(Box::new(examined(&dataset, stop)?))
            }
            table => table,
        })
    }

    /// Returns the data faults; empty before [`Source::examined`].
    pub fn data_faults(&self) -> &[DataFault] {
        match self {
            Self::Frames(dataset) => dataset.data_faults(),
            Self::Table(_) => &[],
        }
    }

    /// Estimates gain and constant noise (Section IV of the paper).
    ///
    /// # Errors
    ///
    /// The data are too few for a line, or a frame cannot be read.
    pub fn noise(&self) -> Result<NoiseReport, NoiseError> {
        self.noise_with(&AtomicBool::new(false), &mut |_, _| {})
    }

    /// Like [`noise`](Self::noise), with cancellation by `stop`; `progress` receives (sets done, sets).
    ///
    /// # Errors
    ///
    /// As [`noise`](Self::noise); also if the call was stopped.
    pub fn noise_with(
        &self,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<NoiseReport, NoiseError> {
        match self {
            Self::Frames(dataset) => {
                let mut report = noise::of_dataset(dataset, stop, progress)?;
                report.notes.extend(dataset.manifest().import_notes());
                Ok(report)
            }
            Self::Table(table) => noise::of_table(table),
        }
    }

    /// Computes all observables that a model is compared with.
    ///
    /// # Errors
    ///
    /// There is nothing to compare, or a frame cannot be read.
    pub fn observations(&self) -> Result<Observations, ObserveError> {
        self.observations_with(&AtomicBool::new(false), &mut |_, _| {})
    }

    /// Like [`observations`](Self::observations), with cancellation by `stop`; `progress` receives (pieces
    /// done, pieces).
    ///
    /// # Errors
    ///
    /// As [`observations`](Self::observations); also if the call was stopped.
    pub fn observations_with(
        &self,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Observations, ObserveError> {
        let dataset = match self {
            Self::Frames(dataset) => dataset,
            Self::Table(table) => return observables::of_table(table),
        };
        let mut all = observables::of_dataset(dataset, stop, progress)?;
        all.missing.extend(dataset.manifest().import_notes());
        let parts = dataset.parts();
        if parts.len() > 1 {
            let of = |(k, path): (usize, &Path)| {
                let of_part = |s: &&Set| dataset.part_of(s.rows[0]).0 == k;
                let numbers: Vec<u32> = dataset.sets().iter().filter(of_part).map(|s| s.number).collect();
                let (first, last) = (numbers.first().unwrap_or(&0), numbers.last().unwrap_or(&0));
                format!("{} has sets {first} to {last}", path.display())
            };
            let parts: Vec<String> = parts.into_iter().enumerate().map(of).collect();
            all.missing.push(format!(
                "taken together: {}; the pause between them is not known, and each has light levels of its own",
                parts.join(", ")
            ));
        }
        Ok(all)
    }

    /// Searches for effects missing from the paper's model plus the effects `known`. A known effect has given
    /// values, or is fitted if it has none.
    ///
    /// # Errors
    ///
    /// As [`observations`](Self::observations).
    pub fn diagnose(&self, known: &[Given]) -> Result<Diagnosis, ObserveError> {
        let all = self.observations()?;
        Ok(diagnose(&all, None, searched(&all, known), &mut |_| {}))
    }
}
