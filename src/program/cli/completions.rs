//! `radcam completions`

use super::Outcome;
use anyhow::Result;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The shell
    shell: clap_complete::Shell,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    clap_complete::generate(arguments.shell, &mut super::command(), "radcam", &mut std::io::stdout());
    Ok(Outcome::Agreement)
}
