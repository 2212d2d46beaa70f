//! `radcam compare`

use super::Outcome;
use super::common::can_be_written;
use super::model::read_effects;
use super::observe::{Datasets, observe};
use crate::diagnosis::{searched, signatures};
use crate::inference::{compare, fit, start};
use crate::number::chance;
use anyhow::Result;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    datasets: Datasets,
    /// The model; the paper's alone where not given
    #[arg(long, value_name = "M.toml|SENSOR")]
    model: Option<PathBuf>,
    /// Also write a page: observables down, levels across, colour by the residual
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    can_be_written(&arguments.report)?;
    let effects = read_effects(arguments.model.as_deref())?;
    let all = observe(&arguments.datasets)?;
    let fitted = fit(&all, &start(&all), &searched(&all, &effects));
    let c = compare(&all, &fitted);
    if let Some(path) = &arguments.report {
        super::report::of_comparison(path, &arguments.datasets, &all, (&c, &fitted))?;
    }
    let outcome = if c.consistent { Outcome::Agreement } else { Outcome::Disagreement };
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&c)?);
        return Ok(outcome);
    }
    println!("{}: {}", arguments.datasets.names(), c.agreement.words());
    super::common::say_faults(&c.data_faults);
    println!(
        "  error    {:.3}, the RMS of the residuals in sigma on frames that the fit did not use (1 is agreement)",
        c.error
    );
    println!("  p-value  {} over {} residuals", chance(c.p_value), c.residuals.len());
    println!(
        "  fitted   gain, read noise, black level, dark current and light; effects keep the values that the model gives"
    );
    let deviations = signatures(&c.residuals);
    for s in deviations.iter().take(6) {
        println!("  - {}", s.text);
    }
    if deviations.is_empty() && !c.consistent {
        let mut worst: Vec<_> = c.residuals.iter().collect();
        worst.sort_by(|a, b| b.z.abs().total_cmp(&a.z.abs()));
        for r in worst.iter().take(3) {
            let set = r.set.map_or(String::new(), |s| format!(" of set {s}"));
            println!(
                "  - {}{set}: {:.4} for {:.4} +- {:.4}, {:+.1} sigma",
                r.observable, r.measured, r.predicted, r.std_err, r.z
            );
        }
    }
    for note in &c.not_looked_at {
        println!("{}", super::common::item("  note: ", note, 4));
    }
    Ok(outcome)
}
