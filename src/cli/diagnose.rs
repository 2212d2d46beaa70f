//! `radcam diagnose`

use super::Outcome;
use super::common::can_be_written;
use super::model::{fitted_model, read_effects};
use super::observe::{names, observe};
use crate::dataset::write_whole;
use crate::diagnosis::{Diagnosis, diagnose, searched};
use crate::number::chance;
use crate::report;
use anyhow::Result;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A dataset folder, an EMVA 1288 descriptor, or a table (CSV with mean_dn and var_dn2); several datasets of one camera under one set
    /// of settings are taken together
    #[arg(required = true, value_name = "DATASET")]
    datasets: Vec<PathBuf>,
    /// Effects that are known already; the paper's model alone where not given
    #[arg(long, value_name = "M.toml|SENSOR")]
    model: Option<PathBuf>,
    /// Also write a page with the ladder and the residuals before and after
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Also write the model with what was found, fitted
    #[arg(short, long, value_name = "M.toml")]
    output: Option<PathBuf>,
    /// Also write the measurement that would tell the closest candidates apart as a plan that `capture` runs
    #[arg(long, value_name = "PLAN.toml")]
    next: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    can_be_written([&arguments.report, &arguments.output, &arguments.next].into_iter().flatten())?;
    let effects = read_effects(arguments.model.as_deref())?;
    let all = observe(&arguments.datasets)?;
    let diagnosis = diagnose(&all, None, searched(&all, &effects), &mut |text| tracing::info!("{text}"));
    if let Some(path) = &arguments.report {
        super::report::of_diagnosis(path, &arguments.datasets, &all, &diagnosis)?;
    }
    if let (Some(path), Some(fitted)) = (&arguments.output, &diagnosis.fitted) {
        let model = fitted_model(&all, fitted, arguments.model.as_deref(), &arguments.datasets)?;
        write_whole(path, model.to_toml()?.as_bytes())?;
    }
    match (&arguments.next, &diagnosis.next_plan) {
        (Some(path), Some(plan)) => write_whole(path, plan.to_toml()?.as_bytes())?,
        (Some(path), None) => {
            tracing::warn!("{} is not written: nothing is left to be told apart", path.display());
        }
        (None, _) => {}
    }
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&diagnosis)?);
    } else {
        print(&names(&arguments.datasets), &diagnosis);
    }
    Ok(if diagnosis.consistent { Outcome::Agreement } else { Outcome::Disagreement })
}

pub fn print(title: &str, d: &Diagnosis) {
    println!("{title}\n");
    println!("{}\n", super::common::wrapped(d.verdict.sentence(), 2));
    for m in &d.missing {
        println!("  {} ({})", m.effect, report::heading(m));
        for (name, q) in m.parameters.iter().filter(|(_, q)| q.unit != "choice") {
            println!("      {name} = {}", q);
        }
        for text in &m.evidence {
            println!("    - {}", super::common::wrapped(text, 6).trim_start());
        }
    }
    println!("\n  {:<34} {:>8}  {:>9}", "model", "error", "p");
    for r in &d.ladder {
        let bar = "#".repeat((r.error.ln().max(0.0) * 6.0).round().min(40.0) as usize);
        println!(
            "  {:<34} {:>8.3}  {:>9}  {bar}",
            r.added.as_ref().map_or("starting model".into(), |added| format!("+ {added}")),
            r.error,
            chance(r.p_value)
        );
    }
    println!(
        "  error: RMS of (measured - predicted) / standard error over all statistics (means, variances, covariances, ...),"
    );
    println!("         each on frames that were held out of the fit; 1 is agreement");
    println!(
        "  starting model: the linear sensor of Healey and Kondepudy 1994, and the effects of --model if given, fitted"
    );
    println!(
        "  p: probability of deviations at least as large if the model is right; below 0.001 the model is rejected"
    );
    if let Some(next) = &d.next_measurement {
        println!("\n  next measurement: {next}\n    (as a plan for `radcam capture`: --next PLAN.toml)");
    }
    for note in &d.notes {
        println!("  note: {}", super::common::wrapped(note, 4).trim_start());
    }
}
