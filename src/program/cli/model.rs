//! `radcam model`

use super::Outcome;
use super::common::{load_model, no_effect};
use super::observe::{Colour, Datasets, observe};
use crate::dataset::write_whole;
use crate::diagnosis::{Proposal, diagnose, searched};
use crate::inference::{Fitted, Given, compare, fit, start};
use crate::number::{chance, six_digits, with_unit};
use crate::observables::Observations;
use anyhow::{Context, Result, bail};
use radcam_sim::effects;
use radcam_sim::{EffectValues, Model};
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Print the model as JSON
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Make a model file from a sensor of the catalogue
    New {
        /// The model file
        model: PathBuf,
        /// The sensor it begins with
        #[arg(long, default_value = "cmos12")]
        sensor: String,
    },
    /// Show a model's effects with their values
    Show {
        /// The model file
        model: PathBuf,
    },
    /// Add an effect, with values where given; a fit finds the others. Or the law that describes what has no
    /// name
    Add {
        /// The model file
        model: PathBuf,
        /// Identifier, as `radcam effects` lists them
        #[arg(required_unless_present = "proposal", conflicts_with = "proposal")]
        effect: Option<String>,
        /// Values, such as rel=0.01
        #[arg(value_parser = value)]
        values: Vec<(String, f64)>,
        /// Diagnose these datasets of one camera, and add the law that is proposed, fitted, with the effects
        /// named beside it
        #[arg(long, value_name = "DATASET", num_args = 1..)]
        proposal: Vec<PathBuf>,
        #[command(flatten)]
        colour: Colour,
    },
    /// Remove an effect
    Remove {
        /// The model file
        model: PathBuf,
        /// Identifier
        effect: String,
    },
    /// Fit the model's free values to a campaign, and write them with their errors
    Fit {
        /// The model file
        model: PathBuf,
        #[command(flatten)]
        datasets: Datasets,
    },
}

/// Parses `name=value`.
fn value(text: &str) -> Result<(String, f64), String> {
    let (name, value) = text.split_once('=').ok_or("write name=value")?;
    let value = value.parse().map_err(|_| format!("\"{value}\" is not a number"))?;
    Ok((name.into(), value))
}

fn read(path: &Path) -> Result<Model> {
    let text = crate::input::settings(path).with_context(|| path.display().to_string())?;
    Model::from_toml(&text).with_context(|| path.display().to_string())
}

fn write(path: &Path, model: &Model) -> Result<()> {
    model.check().with_context(|| path.display().to_string())?;
    Ok(write_whole(path, model.to_toml()?.as_bytes())?)
}

/// Reads the effects of a model file, with their values.
pub fn read_effects(path: Option<&Path>) -> Result<Vec<Given>> {
    let Some(path) = path else { return Ok(Vec::new()) };
    // A sensor name stands for its model, as elsewhere.
    let model = load_model(&path.to_string_lossy(), None)?;
    Ok(crate::model::given(&model.effects)?)
}

/// Creates a model file with fitted values, based on the given file, or else with the campaign's size.
pub fn fitted_model(
    all: &Observations,
    fitted: &Fitted,
    given: Option<&Path>,
    datasets: &Datasets,
) -> Result<Model> {
    let mut model = match given {
        Some(path) => load_model(&path.to_string_lossy(), None)?,
        None => load_model("cmos12", None)?,
    };
    let dataset = datasets.paths.first().and_then(|path| datasets.colour.open(path).ok());
    let camera = dataset.as_ref().map(|d| &d.manifest().camera);
    if let (None, Some(camera)) = (given, camera) {
        (model.camera.vendor, model.camera.model) = (camera.vendor.clone(), camera.model.clone());
    }
    model.about = format!("Fitted to {}", datasets.names());
    Ok(crate::model::with_fit(model, all, fitted, camera))
}

/// Creates a model file with the law that a diagnosis of a dataset proposes, and the effects beside it.
fn with_proposal(path: &Path, datasets: &Datasets) -> Result<(Model, Proposal)> {
    let known = crate::model::given(&read(path)?.effects)?;
    let all = observe(datasets)?;
    let diagnosis = diagnose(&all, None, searched(&all, &known), &mut |text| tracing::info!("{text}"));
    let Some(law) = diagnosis.proposal else {
        bail!("no law is proposed for {}: {}", datasets.names(), diagnosis.verdict.sentence());
    };
    Ok((model_with_law(&all, &law, Some(path), datasets)?, law))
}

/// Creates a model file with a law and the effects beside it.
pub fn model_with_law(
    all: &Observations,
    law: &Proposal,
    given: Option<&Path>,
    datasets: &Datasets,
) -> Result<Model> {
    let fitted = law.beside_it().context("a law without its fit")?;
    let mut model = fitted_model(all, &fitted, given, datasets)?;
    let names: Vec<String> = model.effects.iter().filter_map(|e| e.name.clone()).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    model.effects.extend(law.laws(&names));
    Ok(model)
}

/// Joins names; "none" for an empty list.
fn listed(names: &[&str]) -> String {
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

fn show(path: &Path, model: &Model, json: bool) -> Result<()> {
    if json {
        println!("{}", serde_json::to_string_pretty(model)?);
        return Ok(());
    }
    let b = &model.base;
    println!("{}: {}", path.display(), model.about);
    println!("  A                {} DN/e", six_digits(b.gain_dn_per_e));
    println!("  read noise       {} e", six_digits(b.read_noise_e));
    println!("  black level      {} DN", six_digits(b.black_level_dn));
    println!("  dark current     {} e/s", six_digits(b.dark_current_e_per_s));
    println!("  sigma_K          {}", six_digits(b.sigma_k));
    if model.effects.is_empty() {
        println!("  no effects: the paper's model");
    }
    for e in &model.effects {
        println!("  {}", e.called());
        e.formulas.iter().for_each(|(what, formula)| println!("    {what:<24} + {formula}"));
        let of_effect = effects::find(&e.id).map_or(&[][..], |e| e.parameters());
        for (name, value) in &e.parameters {
            let of_known = of_effect.iter().find(|p| p.name == name).map(|p| p.unit);
            let unit = e.units.get(name).map(String::as_str).or(of_known).unwrap_or("");
            let error = e.std_err.get(name).copied().unwrap_or(f64::NAN);
            println!("    {name:<24} {}", with_unit(*value, error, unit));
        }
        for p in of_effect.iter().filter(|p| !e.parameters.contains_key(p.name)) {
            println!("    {:<24} not given: `radcam model fit` finds it in a dataset", p.name);
        }
    }
    Ok(())
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    match &arguments.action {
        Action::New { model: path, sensor } => {
            if path.exists() {
                bail!("{} is there already; remove it or choose another name", path.display());
            }
            let model = load_model(sensor, None)?;
            write(path, &model)?;
            show(path, &model, arguments.json)?;
        }
        Action::Show { model: path } => show(path, &read(path)?, arguments.json)?,
        Action::Add { model: path, proposal, colour, .. } if !proposal.is_empty() => {
            let datasets = Datasets { paths: proposal.clone(), colour: colour.clone() };
            let (model, law) = with_proposal(path, &datasets)?;
            write(path, &model)?;
            show(path, &model, arguments.json)?;
            if !arguments.json {
                println!("{}, p {}", law.sentence(), chance(law.p_value));
            }
        }
        Action::Add { model: path, effect, values, .. } => {
            let mut model = read(path)?;
            let effect = effect.as_deref().unwrap_or_default();
            if effects::find(effect).is_none() {
                bail!("{}", no_effect(effect, effects::all().iter().map(|e| e.id())));
            }
            let mut entry = EffectValues::new(effect);
            if model.effects.iter().any(|e| e.is_same(&entry)) {
                bail!("{} has {effect} already", path.display());
            }
            // Missing values are fitted.
            entry.parameters.extend(values.iter().cloned());
            model.effects.push(entry);
            write(path, &model)?;
            show(path, &model, arguments.json)?;
        }
        Action::Remove { model: path, effect } => {
            let mut model = read(path)?;
            if !model.remove(effect) {
                let names: Vec<&str> = model.effects.iter().map(EffectValues::called).collect();
                bail!("{} has no effect \"{effect}\": it has {}", path.display(), listed(&names));
            }
            write(path, &model)?;
            show(path, &model, arguments.json)?;
        }
        Action::Fit { model: path, datasets } => {
            let list = crate::model::to_be_fitted(&read(path)?)?;
            let all = observe(datasets)?;
            let fitted = fit(&all, &start(&all), &searched(&all, &list));
            let model = fitted_model(&all, &fitted, Some(path), datasets)?;
            write(path, &model)?;
            show(path, &model, arguments.json)?;
            if arguments.json {
                return Ok(Outcome::Agreement);
            }
            let c = compare(&all, &fitted);
            println!("fitted to {}: {}", datasets.names(), c.agreement.words());
            let (b, e) = (&fitted.base, &fitted.base_std_err);
            println!("  A                {}", with_unit(b.gain_dn_per_e, e[0], "DN/e"));
            println!("  read noise       {}", with_unit(b.read_noise_e, e[1], "e"));
            println!("  zero level       {}", with_unit(b.offset_dn, e[2], "DN"));
            println!("  dark current     {}", with_unit(b.dark_e_per_s, e[3], "e/s"));
            println!(
                "  error            {:.3} on frames that the fit did not see (1: agreement to within noise)",
                c.error
            );
            println!("  p-value          {} over {} residuals", chance(c.p_value), c.residuals.len());
        }
    }
    Ok(Outcome::Agreement)
}
