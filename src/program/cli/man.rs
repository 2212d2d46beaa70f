//! `radcam man`

use super::Outcome;
use crate::dataset::write_whole;
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
    crate::output::folder(folder).with_context(|| folder.display().to_string())?;
    // The generator follows links, so it writes to a temporary folder.
    let made = tempfile::tempdir()?;
    clap_mangen::generate_to(super::command(), made.path())?;
    for page in made.path().read_dir()? {
        let page = page?;
        write_whole(&folder.join(page.file_name()), &crate::input::bytes(&page.path())?)?;
    }
    println!("{}: the manual pages; man {}/radcam.1", folder.display(), folder.display());
    Ok(Outcome::Agreement)
}
