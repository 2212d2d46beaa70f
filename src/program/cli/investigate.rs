//! `radcam investigate`

use super::Outcome;
use super::capture::StreamArguments;
use super::common::{STOP, duration, load_plan, open_camera};
use super::findings::{Place, print};
use super::model::{fitted_model, read_effects};
use super::progress::Show;
use crate::bench::Illuminator;
use crate::camera::{Camera, StreamOptions};
use crate::capture::{Capture, CaptureError, Progress};
use crate::dataset::write_whole;
use crate::inference::Given;
use crate::investigate::{Event, Found, InvestigateError, STATE_FILE, investigate};
use crate::plan::Plan;
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[arg(long, help = crate::camera::names())]
    camera: String,
    /// Folder for the dataset, the report and the model; an investigation that was interrupted there goes on
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Frames of every set of the first measurement; else those of the plan
    #[arg(long, value_parser = clap::value_parser!(u32).range(2..))]
    frames: Option<u32>,
    /// The first measurement: standard (the default), quick, emva1288, or a plan file
    #[arg(long)]
    plan: Option<String>,
    /// Effects that are known already
    #[arg(long, value_name = "M.toml|SENSOR")]
    model: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    stream: StreamArguments,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let root = &arguments.output;
    let begun = root.join("dataset").exists() || root.join(STATE_FILE).exists();
    if root.exists() && !begun && root.read_dir()?.next().is_some() {
        bail!("{} is no investigation and not empty; choose a new folder", root.display());
    }
    if root.join("dataset").join("dataset.toml").exists()
        && (arguments.frames.is_some() || arguments.plan.is_some())
    {
        tracing::warn!("{} goes on with the plan it was begun with", root.display());
    }
    let known = read_effects(arguments.model.as_deref())?;
    let mut plan = load_plan(arguments.plan.as_deref(), false, root)?;
    if let Some(frames) = arguments.frames {
        plan.sets.iter_mut().for_each(|s| s.frames = frames);
    }
    let (mut camera, mut bench) = open_camera(&arguments.camera, &plan)?;
    let options = arguments.stream.options();
    let found = carry_out(&mut *camera, &mut *bench, options, &plan, root, &known)?;
    let dataset = root.join("dataset");
    let (report_path, model_path) = (root.join("report.html"), root.join("model.toml"));
    let d = &found.diagnosis;
    let datasets = super::observe::Datasets::of(&dataset);
    let all = super::observe::observe(&datasets)?;
    super::report::of_diagnosis(&report_path, &datasets, &all, d)?;
    if let Some(fitted) = &d.fitted {
        let model = fitted_model(&all, fitted, arguments.model.as_deref(), &datasets)?;
        write_whole(&model_path, model.to_toml()?.as_bytes())?;
    }
    if arguments.json {
        let json = serde_json::json!({
            "diagnosis": d, "measurements": found.measurements, "undecided": found.undecided,
        });
        println!("{}", serde_json::to_string_pretty(&json)?);
    } else {
        println!();
        let title = dataset.display().to_string();
        print(&Place { title: &title, datasets: &datasets.to_string(), explain: false }, d);
        if let Some(undecided) = &found.undecided {
            println!("\n{}", super::common::wrapped(&format!("This bench cannot decide it. {undecided}"), 2));
        }
        println!("\n  dataset:  {}", dataset.display());
        println!("  report:   {}\n  model:    {}", report_path.display(), model_path.display());
    }
    Ok(if d.consistent { Outcome::Agreement } else { Outcome::Disagreement })
}

/// Runs an investigation; reports progress and current work on standard error.
pub fn carry_out(
    camera: &mut dyn Camera,
    bench: &mut dyn Illuminator,
    options: StreamOptions,
    plan: &Plan,
    root: &Path,
    known: &[Given],
) -> Result<Found> {
    let by_hand = !bench.moves_itself();
    let mut show = Show::new("capture");
    let mut progress = |p: Progress| show.frames(p);
    let mut capture =
        Capture { camera, bench, options, stop: &STOP, progress: Some(&mut progress), shown: None };
    let mut tell = |event: Event<'_>| match event {
        Event::Begins { about, frames, sets, seconds, full_exposure_s } => {
            let full = full_exposure_s.map_or(String::new(), |s| format!(", full exposure {s:.6} s"));
            let hand = if by_hand { ", and the time to move the light" } else { "" };
            let what = about.split_once(": ").map_or(about, |(_, what)| what);
            eprintln!("{what}: {frames} frames in {sets} sets, about {}{hand}{full}", duration(seconds));
        }
        Event::Judged(d) => {
            if let Some(next) = &d.next_measurement {
                let names: Vec<&str> = d.missing.iter().take(3).map(|m| m.effect.as_str()).collect();
                eprintln!("so far: {}; next, {next}", names.join(", "));
            }
        }
    };
    investigate(&mut capture, plan, root, known, &mut tell).map_err(|e| match e {
        InvestigateError::Capture(CaptureError::Interrupted { frames }) => {
            anyhow::anyhow!(
                "interrupted; {frames} frames are kept, and the same command goes on where it was"
            )
        }
        e => e.into(),
    })
}
