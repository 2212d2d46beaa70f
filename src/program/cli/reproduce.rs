//! `radcam reproduce`

use super::common::{STOP, can_be_written};
use super::{Outcome, progress::Show};
use crate::dataset::write_whole;
use crate::number::with_error;
use crate::report;
use crate::reproduce;
use anyhow::Result;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Simulated cameras, each with its own noise, pattern and card; at least 2
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u64).range(2..=100_000))]
    seeds: u64,
    /// The page with the four figures
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    can_be_written(&arguments.report)?;
    let mut show = Show::new("reproduce");
    let r = reproduce::run(arguments.seeds, &STOP, &mut |done, of| show.step(done, of))?;
    drop(show);
    if let Some(path) = &arguments.report {
        write_whole(path, report::reproduce::html(&r).as_bytes())?;
    }
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&r)?);
    } else {
        println!("Healey and Kondepudy 1994, Section VII, on {} simulated XC-77 cameras\n", r.seeds);
        println!("  {:<64} {:>9}  {:<24}", "quantity", "paper", "ours, and one experiment's error");
        for row in &r.rows {
            let paper = if row.paper.is_finite() { row.paper.to_string() } else { String::new() };
            let verdict = match row.agrees {
                Some(true) => "agrees",
                Some(false) => "DIFFERS",
                None => "not confirmable",
            };
            let quantity = row.quantity.split(": chi-square").next().unwrap_or_default();
            println!("  {quantity:<64} {paper:>9}  {:<24} {verdict}", with_error(row.ours, row.std_err));
            if let Some(note) = &row.note {
                println!("      {note}");
            }
        }
    }
    let agree = r.rows.iter().all(|row| row.agrees != Some(false));
    Ok(if agree { Outcome::Agreement } else { Outcome::Disagreement })
}
