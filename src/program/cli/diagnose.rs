//! `radcam diagnose`

use super::Outcome;
use super::common::{can_be_written, no_effect};
use super::findings::{Place, print};
use super::model::{fitted_model, model_with_law, read_effects};
use super::observe::{Datasets, observe};
use crate::dataset::write_whole;
use crate::diagnosis::{diagnose, searched};
use anyhow::{Result, bail};
use radcam_sim::effects;
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
    /// Also print all parameters, the statistics that show each effect, and where it comes from
    #[arg(long)]
    explain: bool,
    /// Effect that is not considered, because it is excluded by other means; may be given several times
    #[arg(long, value_name = "EFFECT")]
    without: Vec<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    can_be_written([&arguments.report, &arguments.output, &arguments.next].into_iter().flatten())?;
    for id in &arguments.without {
        if effects::find(id).is_none() {
            bail!("{}", no_effect(id, effects::all().iter().map(|e| e.id())));
        }
        effects::leave_out(id);
    }
    let effects = read_effects(arguments.model.as_deref())?;
    let all = observe(&arguments.datasets)?;
    let diagnosis = diagnose(&all, None, searched(&all, &effects), &mut |text| tracing::info!("{text}"));
    if let Some(path) = &arguments.report {
        super::report::of_diagnosis(path, &arguments.datasets, &all, &diagnosis)?;
    }
    if let (Some(path), Some(fitted)) = (&arguments.output, &diagnosis.fitted) {
        let given = arguments.model.as_deref();
        let model = match diagnosis.proposal.as_ref().filter(|law| law.holds()) {
            Some(law) => model_with_law(&all, law, given, &arguments.datasets)?,
            None => fitted_model(&all, fitted, given, &arguments.datasets)?,
        };
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
        let place = Place {
            title: &arguments.datasets.names(),
            datasets: &arguments.datasets.to_string(),
            explain: arguments.explain,
        };
        print(&place, &diagnosis);
    }
    Ok(if diagnosis.consistent { Outcome::Agreement } else { Outcome::Disagreement })
}
