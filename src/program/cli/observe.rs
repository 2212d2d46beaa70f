//! Reads the observables that the commands compare with a model.

use super::common::{STOP, after_faults, plane, quoted};
use super::progress::Show;
use crate::dataset::Dataset;
use crate::observables::Observations;
use crate::reduction;
use crate::source::Source;
use anyhow::Result;
use std::path::{Path, PathBuf};

#[derive(Debug, Clone, Default, clap::Args)]
pub struct Colour {
    /// Of a colour mosaic: row and column, 0 or 1, of the one pixel of every 2 x 2 cell that is measured; 0,0
    /// is R of RGGB
    #[arg(long, value_name = "ROW,COLUMN", value_parser = plane)]
    pub plane: Option<[u8; 2]>,
}

impl Colour {
    /// Opens a dataset, or the requested plane of it.
    pub fn open(&self, path: &Path) -> Result<Dataset> {
        let dataset = reduction::open(path)?;
        Ok(self.plane.map_or(Ok(dataset.clone()), |plane| dataset.plane(plane))?)
    }
}

#[derive(Debug, Clone, clap::Args)]
pub struct Datasets {
    /// A dataset folder, an EMVA 1288 descriptor, or a table (CSV with mean_dn and var_dn2); several datasets
    /// of one camera under one set of settings are taken together
    #[arg(required = true, value_name = "DATASET")]
    pub paths: Vec<PathBuf>,
    #[command(flatten)]
    pub colour: Colour,
}

impl Datasets {
    /// Selects one dataset with all its pixels.
    pub fn of(path: &Path) -> Self {
        Self { paths: vec![path.into()], colour: Colour::default() }
    }

    pub fn open(&self) -> Result<Source> {
        let source = Source::open_all(&self.paths)?;
        Ok(self.colour.plane.map_or(Ok(source.clone()), |plane| source.plane(plane))?)
    }

    /// Joins the names to a title.
    pub fn names(&self) -> String {
        let names = self.paths.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(", ");
        self.colour.plane.map_or(names.clone(), |[y, x]| format!("{names}, plane {y},{x}"))
    }
}

impl std::fmt::Display for Datasets {
    /// Formats the arguments as on a command line.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let paths = self.paths.iter().map(|p| quoted(&p.display().to_string()));
        let plane = self.colour.plane.map(|[y, x]| format!("--plane {y},{x}"));
        f.write_str(&paths.chain(plane).collect::<Vec<_>>().join(" "))
    }
}

/// Computes the observables of a table, or of datasets of one camera and one set of settings, combined.
pub fn observe(datasets: &Datasets) -> Result<Observations> {
    let mut show = Show::new("reading");
    let source = datasets.open()?.examined(&STOP)?;
    after_faults(source.observations_with(&STOP, &mut |done, of| show.step(done, of)), source.data_faults())
}
