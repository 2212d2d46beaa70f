//! `radcam merge`

use super::{Outcome, reduce};
use crate::reduction::{self, Options};
use anyhow::Result;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Statistics of parts of one campaign, of `radcam reduce`; where their frames lie is known, and those
    /// that were reduced without the look of the whole campaign are read again
    #[arg(required = true, value_name = "STATS")]
    parts: Vec<PathBuf>,
    /// The statistics of all, a new file
    #[arg(short, long, value_name = "STATS")]
    output: PathBuf,
    /// Merge the looks of `radcam reduce --look`, for `radcam reduce --plan`
    #[arg(long)]
    look: bool,
    /// Write over a file that is there
    #[arg(long)]
    overwrite: bool,
}

pub fn run(a: &Arguments) -> Result<Outcome> {
    let parts = a.parts.iter().map(|p| reduction::open(p)).collect::<Result<_, _>>()?;
    reduce::write(parts, &a.output, a.overwrite, Options { plan: None, look_only: a.look })
}
