//! Reading what the verbs compare with a model.

use super::common::STOP;
use super::progress::Show;
use crate::dataset::Dataset;
use crate::dataset::table::Table;
use crate::observables::{Observations, of_dataset, of_table};
use anyhow::Result;
use std::path::Path;

/// Observables of whatever the path is.
pub fn observe(path: &Path) -> Result<Observations> {
    if path.is_file() && Table::is_table(path) {
        return Ok(of_table(&Table::open(path)?)?);
    }
    let dataset = Dataset::open(path)?;
    let mut show = Show::new("reading");
    Ok(of_dataset(&dataset, &STOP, &mut |done, of| show.step(done, of))?)
}
