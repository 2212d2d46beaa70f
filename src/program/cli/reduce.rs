//! `radcam reduce`

use super::Outcome;
use super::common::{STOP, may_be_written};
use super::observe::Colour;
use super::progress::Show;
use crate::dataset::Dataset;
use crate::reduction::{self, Options};
use anyhow::Result;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Parts of one campaign: dataset folders or EMVA 1288 descriptors whose frames have the set and index of
    /// the campaign, or statistics
    #[arg(required = true, value_name = "PART")]
    parts: Vec<PathBuf>,
    #[command(flatten)]
    colour: Colour,
    /// The statistics, a new file
    #[arg(short, long, value_name = "STATS")]
    output: PathBuf,
    /// A first look only, at most eight frames of each set: what --plan takes, once all parts are merged
    #[arg(long)]
    look: bool,
    /// The merged looks of all parts: what is reduced under them need not be read again when it is merged
    #[arg(long, value_name = "STATS", conflicts_with = "look")]
    plan: Option<PathBuf>,
    /// Write over a file that is there
    #[arg(long)]
    overwrite: bool,
}

pub fn run(a: &Arguments) -> Result<Outcome> {
    let plan = a.plan.as_deref().map(reduction::open).transpose()?;
    let parts = a.parts.iter().map(|p| a.colour.open(p)).collect::<Result<_>>()?;
    write(parts, &a.output, a.overwrite, Options { plan, look_only: a.look })
}

/// Reduces parts and writes the file.
pub fn write(parts: Vec<Dataset>, output: &Path, overwrite: bool, options: Options) -> Result<Outcome> {
    may_be_written(&output.to_path_buf(), overwrite)?;
    let mut show = Show::new("reducing");
    let reduced = reduction::reduce(parts, &options, &STOP, &mut |done, of| show.step(done, of))?;
    reduction::write(&reduced, output)?;
    let (sets, frames) = (reduced.sets().len(), reduced.rows().len());
    println!("{}: {frames} frames in {sets} sets", output.display());
    Ok(Outcome::Agreement)
}
