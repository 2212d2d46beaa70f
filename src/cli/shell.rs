//! `radcam completions` and `radcam man`: for packagers, and for those who type.

use super::Outcome;
use anyhow::{Context, Result};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Completions {
    /// The shell
    shell: clap_complete::Shell,
}

#[derive(Debug, clap::Args)]
pub struct Man {
    /// Folder for the pages; made where it is not there
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
}

pub fn completions(arguments: &Completions) -> Result<Outcome> {
    clap_complete::generate(arguments.shell, &mut super::command(), "radcam", &mut std::io::stdout());
    Ok(Outcome::Agreement)
}

pub fn man(arguments: &Man) -> Result<Outcome> {
    let folder = &arguments.output;
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    clap_mangen::generate_to(super::command(), folder).with_context(|| folder.display().to_string())?;
    println!("{}: the manual pages; man {}/radcam.1", folder.display(), folder.display());
    Ok(Outcome::Agreement)
}
