//! `radcam report`

use super::Outcome;
use super::common::{STOP, can_be_written};
use super::model::read_effects;
use super::observe::Datasets;
use super::progress::Show;
use crate::calibrate::file::Calibration;
use crate::dataset::write_whole;
use crate::diagnosis::{Diagnosis, Verdict, diagnose, searched};
use crate::inference::{Comparison, Fitted};
use crate::observables::Observations;
use crate::report;
use crate::source::Source;
use crate::study::{Judgement, Provenance, Study};
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    datasets: Datasets,
    /// Effects that are known already; the paper's model alone where not given
    #[arg(long, value_name = "M.toml|SENSOR")]
    model: Option<PathBuf>,
    /// Calibration of the camera: its dark reference, K and defects are shown in place of the campaign's own
    /// images
    #[arg(long, value_name = "CAL.tiff")]
    cal: Option<PathBuf>,
    /// The page
    #[arg(short, long, value_name = "FILE.html", required_unless_present = "json")]
    output: Option<PathBuf>,
    /// Print the numbers of the page as JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    can_be_written(&arguments.output)?;
    let effects = read_effects(arguments.model.as_deref())?;
    let cal = arguments.cal.as_deref().map(Calibration::read).transpose()?;
    let source = arguments.datasets.open()?;
    if let (Some(path), Some(cal), Source::Frames(dataset)) = (&arguments.cal, &cal, &source) {
        let differs = cal.description.camera.differences(&dataset.manifest().camera);
        if !differs.is_empty() {
            bail!(
                "--cal {}: is not of the camera and settings of {}: {}",
                path.display(),
                arguments.datasets.names(),
                differs.join("; ")
            );
        }
    }
    let mut show = Show::new("reading");
    let all = source.observations_with(&STOP, &mut |done, of| show.step(done, of))?;
    drop(show);
    let d = diagnose(&all, None, searched(&all, &effects), &mut |text| tracing::info!("{text}"));
    let judged = (&Judgement::of_diagnosis(&d), Some(&d.verdict));
    let study = study(&arguments.datasets, &source, &all, judged, cal.as_ref())?;
    if let Some(path) = &arguments.output {
        write(path, &study, &all)?;
    }
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&study.numbers())?);
    } else if let Some(path) = &arguments.output {
        println!("{}\n{} written", super::common::wrapped(d.verdict.sentence(), 0), path.display());
    }
    Ok(if d.consistent { Outcome::Agreement } else { Outcome::Disagreement })
}

fn study(
    datasets: &Datasets,
    source: &Source,
    all: &Observations,
    judged: (&Judgement, Option<&Verdict>),
    cal: Option<&Calibration>,
) -> Result<Study> {
    let command: Vec<String> = std::env::args().collect();
    let mut show = Show::new("images");
    let provenance = Provenance::of(&datasets.paths, source, &command.join(" "))?;
    Ok(Study::of(source, all, judged, cal, provenance, &STOP, &mut |done, of| show.step(done, of))?)
}

fn write(path: &Path, study: &Study, all: &Observations) -> Result<()> {
    let page = report::study::html(study, &report::study::kinds(all));
    Ok(write_whole(path, page.as_bytes())?)
}

/// Writes the page of a diagnosis, for the commands that make one.
pub fn of_diagnosis(path: &Path, datasets: &Datasets, all: &Observations, d: &Diagnosis) -> Result<()> {
    let judged = (&Judgement::of_diagnosis(d), Some(&d.verdict));
    write(path, &study(datasets, &datasets.open()?, all, judged, None)?, all)
}

/// Writes the page of a comparison.
pub fn of_comparison(
    path: &Path,
    datasets: &Datasets,
    all: &Observations,
    (c, fitted): (&Comparison, &Fitted),
) -> Result<()> {
    let judged = (&Judgement::of_comparison(c, fitted), None);
    write(path, &study(datasets, &datasets.open()?, all, judged, None)?, all)
}
