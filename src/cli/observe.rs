//! Reading what the verbs compare with a model.

use super::common::STOP;
use super::progress::Show;
use crate::dataset::table::Table;
use crate::dataset::{Dataset, Set};
use crate::observables::{Observations, of_dataset, of_table};
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};

/// Observables of whatever the path is.
pub fn observe(path: &Path) -> Result<Observations> {
    observe_all(&[path.into()])
}

/// Observables of a table, or of datasets of one camera under one set of settings, taken together.
pub fn observe_all(paths: &[PathBuf]) -> Result<Observations> {
    let tables: Vec<_> = paths.iter().filter(|p| p.is_file() && Table::is_table(p)).collect();
    match (tables.as_slice(), paths) {
        ([], _) => {}
        ([table], [_]) => return Ok(of_table(&Table::open(table)?)?),
        ([table, ..], _) => bail!("{} is a table: only datasets with frames go together", table.display()),
    }
    let dataset = Dataset::join(paths.iter().map(|p| Dataset::open(p)).collect::<Result<_, _>>()?)?;
    let mut show = Show::new("reading");
    let mut all = of_dataset(&dataset, &STOP, &mut |done, of| show.step(done, of))?;
    if paths.len() > 1 {
        let of = |k: usize| {
            let of_part = |s: &&Set| dataset.part_of(s.rows[0]).0 == k;
            let numbers: Vec<u32> = dataset.sets().iter().filter(of_part).map(|s| s.number).collect();
            let (first, last) = (numbers.first().unwrap_or(&0), numbers.last().unwrap_or(&0));
            format!("{} has sets {first} to {last}", paths[k].display())
        };
        let parts: Vec<String> = (0..paths.len()).map(of).collect();
        all.missing.push(format!(
            "taken together: {}; the pause between them is not known, and no light is taken for that of another",
            parts.join(", ")
        ));
    }
    Ok(all)
}

/// Their names as a title.
pub fn names(paths: &[PathBuf]) -> String {
    paths.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(", ")
}
