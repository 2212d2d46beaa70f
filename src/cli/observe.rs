//! Reading what the verbs compare with a model.

use super::common::{STOP, after_faults};
use super::progress::Show;
use crate::observables::Observations;
use crate::source::Source;
use anyhow::Result;
use std::path::PathBuf;

/// Observables of a table, or of datasets of one camera under one set of settings, taken together.
pub fn observe(paths: &[PathBuf]) -> Result<Observations> {
    let mut show = Show::new("reading");
    let source = Source::open_all(paths)?.examined(&STOP)?;
    after_faults(source.observations_with(&STOP, &mut |done, of| show.step(done, of)), source.data_faults())
}

/// Their names as a title.
pub fn names(paths: &[PathBuf]) -> String {
    paths.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(", ")
}
