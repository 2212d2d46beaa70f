//! `radcam surface`

use super::Outcome;
use super::region::RegionArguments;
use crate::number::with_error;
use crate::surfaces::{Library, NONE_BELOW};
use anyhow::{Result, bail};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Add a region's scene variation to a library under a name
    Learn {
        /// The library, a TOML file; made where it is not there
        library: PathBuf,
        /// Name of the surface
        #[arg(long)]
        name: String,
        #[command(flatten)]
        region: RegionArguments,
        /// Print the library as JSON
        #[arg(long)]
        json: bool,
    },
    /// Name the surface of a region; exit code 1 where it is none of the library's
    Identify {
        /// The library
        library: PathBuf,
        #[command(flatten)]
        region: RegionArguments,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    match &arguments.action {
        Action::Learn { library: path, name, region, json } => {
            let mut library = if path.exists() { Library::read(path)? } else { Library::default() };
            let regions = region.read()?;
            let seen = regions.variation()?.scene_variation;
            let roi = regions.roi;
            let id = format!("{:016x} {},{},{},{}", regions.digest, roi.x, roi.y, roi.width, roi.height);
            library.learn(name, &seen, &id).map_err(|e| anyhow::anyhow!("{}: {e}", path.display()))?;
            library.write(path)?;
            if *json {
                println!("{}", serde_json::to_string_pretty(&library)?);
                return Ok(Outcome::Agreement);
            }
            println!("{}: {name}, V_s {}", path.display(), with_error(seen.value, seen.std_err));
            Ok(Outcome::Agreement)
        }
        Action::Identify { library: path, region, json } => {
            let library = Library::read(path)?;
            if library.surfaces.is_empty() {
                bail!("{}: holds no surfaces; `radcam surface learn` adds them", path.display());
            }
            let seen = region.read()?.variation()?.scene_variation;
            let answer = library.identify(&seen);
            if *json {
                println!("{}", serde_json::to_string_pretty(&answer)?);
            } else {
                println!("{}", answer.surface.as_deref().unwrap_or("none of these"));
                println!("  V_s {}", with_error(seen.value, seen.std_err));
                for c in &answer.candidates {
                    println!(
                        "  {:<20} {:>6.2} %  {:+.1} standard errors away, log-likelihood {:.1}",
                        c.name,
                        100.0 * c.probability,
                        c.z,
                        c.log_likelihood
                    );
                }
                if answer.surface.is_none() {
                    println!("  the nearest would lie that far away with a chance below {NONE_BELOW}");
                }
            }
            Ok(if answer.surface.is_some() { Outcome::Agreement } else { Outcome::Disagreement })
        }
    }
}
