//! `radcam diagnose`

use super::Outcome;
use super::common::{can_be_written, say_faults};
use super::model::{fitted_model, read_effects};
use super::observe::{Datasets, observe};
use crate::agreement::P_LIMIT;
use crate::dataset::write_whole;
use crate::diagnosis::{Diagnosis, diagnose, searched};
use crate::number::{Quantity, chance, percent, six_digits};
use crate::report;
use anyhow::Result;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    datasets: Datasets,
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
        print(&arguments.datasets.names(), &diagnosis);
    }
    Ok(if diagnosis.consistent { Outcome::Agreement } else { Outcome::Disagreement })
}

/// Gain, read noise and dark current with the effects in the model.
fn sensor(d: &Diagnosis) {
    let said = |q: &Option<Quantity>| {
        q.as_ref().map_or("not determined by this campaign".into(), ToString::to_string)
    };
    let with = if d.missing.is_empty() { "" } else { " with these effects in the model" };
    let biased = match d.missing.first() {
        Some(first) if first.effect == "unknown" => " (what has no name may bias it by more than the errors)",
        _ => "",
    };
    println!("\n  the linear sensor{with}, fitted to all statistics{biased}:");
    println!("      system gain   {}", said(&d.sensor.gain_dn_per_e));
    let pixels = match (d.sensor.read_noise_median_e, d.sensor.noisy_pixel_share) {
        (Some(median), Some(noisy)) => {
            format!(
                " (RMS over the pixels; median {}, {} noisy pixels)",
                six_digits(round_to(median, 4)),
                percent(noisy)
            )
        }
        _ => String::new(),
    };
    let read_noise =
        if d.sensor.read_noise_dn.is_some() { &d.sensor.read_noise_dn } else { &d.sensor.read_noise_e };
    println!("      read noise    {}{pixels}", said(read_noise));
    println!("      dark current  {}", said(&d.sensor.dark_current_e_per_s));
    if let Some(r) = &d.remainder {
        println!(
            "  what is left: {} of the misfit, error {:.3}, p {}",
            percent(r.share),
            r.error,
            chance(r.p_value)
        );
        for text in r.largest.iter().take(3) {
            println!("    - {}", super::common::wrapped(text, 6).trim_start());
        }
    }
}

/// Rounds to so many significant digits.
fn round_to(value: f64, digits: i32) -> f64 {
    if value == 0.0 {
        return 0.0;
    }
    let unit = 10f64.powi(value.abs().log10().floor() as i32 + 1 - digits);
    (value / unit).round() * unit
}

pub fn print(title: &str, d: &Diagnosis) {
    println!("{title}\n");
    say_faults(&d.data_faults);
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
    sensor(d);
    println!("\n  {:<34} {:>8}  {:>9}", "model", "error", "p");
    for r in &d.ladder {
        let bar = "#".repeat((r.error.ln().max(0.0) * 6.0).round().min(40.0) as usize);
        println!(
            "  {:<34} {:>8.3}  {:>9}  {:<8}  {bar}",
            r.added.as_ref().map_or("starting model".into(), |added| format!("+ {added}")),
            r.error,
            chance(r.p_value),
            if r.p_value < P_LIMIT { "rejected" } else { "" }
        );
    }
    println!(
        "  error: RMS of (measured - predicted) / standard error on frames that the fit did not see; about 1 is agreement"
    );
    println!("  p: chance of deviations as large if the model is right; below 0.001 it is rejected");
    println!(
        "  starting model: the linear sensor of Healey and Kondepudy 1994, with the effects of --model;"
    );
    println!("  misfit: its deviations above the noise");
    if let Some(next) = &d.next_measurement {
        println!("\n  next measurement: {next}\n    (as a plan for `radcam capture`: --next PLAN.toml)");
    }
    for note in &d.notes {
        println!("  note: {}", super::common::wrapped(note, 4).trim_start());
    }
}
