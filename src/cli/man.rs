//! `radcam man`

use super::Outcome;
use anyhow::{Context, Result};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Folder for the pages; made where it is not there
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let folder = &arguments.output;
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    clap_mangen::generate_to(super::command(), folder).with_context(|| folder.display().to_string())?;
    println!("{}: the manual pages; man {}/radcam.1", folder.display(), folder.display());
    Ok(Outcome::Agreement)
}
