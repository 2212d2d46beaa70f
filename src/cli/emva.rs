//! `radcam emva`

use super::Outcome;
use super::common::STOP;
use super::progress::Show;
use crate::dataset::Dataset;
use crate::emva::{evaluate, of_dataset};
use anyhow::Result;
use std::path::PathBuf;
use std::sync::Mutex;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A dataset folder or the descriptor of an EMVA 1288 test: a pair of flats and a pair of darks at each exposure, and a stack of each
    dataset: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let dataset = Dataset::open(&arguments.dataset)?;
    let show = Mutex::new(Show::new("reading"));
    let progress = |done, of| {
        if let Ok(mut show) = show.lock() {
            show.step(done, of);
        }
    };
    let points = of_dataset(&dataset, &STOP, &progress)?;
    drop(show);
    let evaluation = evaluate(&points)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&evaluation)?);
        return Ok(Outcome::Agreement);
    }
    println!("{}: EMVA 1288, linear model\n", arguments.dataset.display());
    for (name, quantity) in &evaluation.quantities {
        let value = quantity.as_ref().map_or("undefined".into(), ToString::to_string);
        println!("  {name:<24} {value}");
    }
    for note in &evaluation.notes {
        println!("\n  note: {}", super::common::wrapped(note, 8).trim_start());
    }
    Ok(Outcome::Agreement)
}
