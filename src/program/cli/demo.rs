//! `radcam demo`

use super::capture::capture;
use super::common::load_model;
use super::findings::{Place, print};
use super::observe::{Datasets, observe};
use super::{Outcome, investigate, noise};
use crate::bench::Illuminator;
use crate::camera::{Camera, StreamOptions};
use crate::dataset::write_whole;
use crate::plan::Plan;
use crate::report::noise::{Truth, html, sigmas};
use anyhow::{Context, Result, bail};
use radcam_sim::effects::{EFFECTS, Effect, example};
use radcam_sim::{EffectValues, Model};
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A sensor (xc77, cmos12, ccd16, imx250...; `radcam cameras` lists them) or a model file
    #[arg(long, default_value = "cmos12")]
    sensor: String,
    /// Another specimen of the same camera: seed of its maps and its noise
    #[arg(long)]
    seed: Option<u64>,
    /// Folder for the dataset and the report; an earlier demo there is replaced
    #[arg(short, long, default_value = "radcam-demo")]
    output: PathBuf,
    /// The effect hidden in the camera: an identifier, `random`, or `none` for the paper's camera
    #[arg(long, default_value = "random")]
    hide: String,
    /// IPv4 address of the interface the camera is served on
    #[arg(long, default_value = "127.0.0.1")]
    interface: std::net::Ipv4Addr,
    /// Print JSON: what was hidden and what was found
    #[arg(long)]
    json: bool,
}

/// Maximum size of the region that the demo captures: a campaign of about 40 MB.
const REGION: (u32, u32) = (320, 256);

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let mut model = load_model(&arguments.sensor, arguments.seed)?;
    let seed = arguments.seed.unwrap_or(model.base.seed);
    let hidden = hide(&arguments.hide, &mut model, seed)?;
    let (width, height) = (model.camera.width.min(REGION.0), model.camera.height.min(REGION.1));
    if hidden.is_some() {
        // The whole sensor is simulated for an effect that extends across it; a small sensor suffices.
        (model.camera.width, model.camera.height) = (width, height);
    }
    let mut plan = Plan::standard();
    plan.camera.region =
        Some([(model.camera.width - width) / 8 * 4, (model.camera.height - height) / 8 * 4, width, height]);
    let dataset = arguments.output.join("dataset");
    clear(&arguments.output, &dataset)?;
    let file = arguments.output.join("camera.toml");
    write_whole(&file, model.to_toml()?.as_bytes())?;
    let camera = format!("{} {}, {width} x {height} px", model.camera.vendor, model.camera.model);
    let outcome = match hidden {
        None => the_papers(arguments, &model, &camera, &file, &plan, &dataset),
        Some((effect, values)) => the_story(arguments, effect, &values, &camera, &file, &plan),
    };
    if outcome.is_err() {
        // The camera file contains the answer.
        std::fs::remove_file(&file).ok();
        std::fs::remove_dir(&arguments.output).ok();
    }
    outcome
}

/// Hidden effect with its values.
type Hidden = (&'static dyn Effect, Vec<f64>);

/// Hides an effect in a model, at a clearly visible strength.
fn hide(what: &str, model: &mut Model, seed: u64) -> Result<Option<Hidden>> {
    let known = || EFFECTS.iter().filter(|e| example(e.id(), model).is_some());
    let effect = match what {
        "none" => return Ok(None),
        // The seed selects the effect, by a multiplicative hash (Knuth 1998, 6.4).
        "random" => {
            known().nth((seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 33) as usize % known().count().max(1))
        }
        id => known().find(|e| e.id() == id),
    };
    let Some(effect) = effect else {
        let names: Vec<_> = known().map(|e| e.id()).collect();
        bail!("\"{what}\" cannot be hidden; write random, none or one of {}", names.join(", "));
    };
    let values = example(effect.id(), model).unwrap_or_default();
    let parameters = effect.parameters().iter().zip(&values).map(|(p, v)| (p.name.to_string(), *v)).collect();
    model.effects = vec![EffectValues { id: effect.id().into(), parameters, ..Default::default() }];
    Ok(Some((*effect, values)))
}

/// Runs the demo of a hidden effect: the model fails, the effect is named and added, the error falls.
fn the_story(
    arguments: &Arguments,
    effect: &'static dyn Effect,
    hidden: &[f64],
    camera: &str,
    file: &Path,
    plan: &Plan,
) -> Result<Outcome> {
    eprintln!("{camera}: something is hidden in it. Is the paper's model enough?");
    let options = StreamOptions::default();
    let found = with_camera(arguments, file, plan, |camera, bench| {
        investigate::carry_out(camera, bench, options, plan, &arguments.output, &[])
    })?;
    let (d, dataset) = (found.diagnosis, arguments.output.join("dataset"));
    let title = format!("{camera}{}", over(arguments));
    if !arguments.json {
        println!();
        let place = Place { title: &title, datasets: &Datasets::of(&dataset).to_string(), explain: false };
        print(&place, &d);
    }
    let path = arguments.output.join("report.html");
    let datasets = Datasets::of(&dataset);
    let all = observe(&datasets)?;
    super::report::of_diagnosis(&path, &datasets, &all, &d)?;
    let first = d.missing.first();
    let place = d.missing.iter().position(|m| m.effect == effect.id());
    // The first candidate, or one that this campaign cannot separate from it.
    let tied = place
        .is_some_and(|p| p == 0 || d.missing[p].tied_with.as_deref() == first.map(|m| m.effect.as_str()));
    let found = tied && d.missing.first().is_none_or(|m| m.effect != "unknown");
    let outcome = if found { Outcome::Agreement } else { Outcome::Disagreement };
    if arguments.json {
        let answer = serde_json::json!({
            "hidden": effect.id(), "values": hidden, "found": found, "diagnosis": d, "report": path, "dataset": dataset,
        });
        println!("{}", serde_json::to_string_pretty(&answer)?);
        return Ok(outcome);
    }
    println!("\n  report:   {}\n  dataset:  {}", path.display(), dataset.display());
    println!("  next:     radcam effects {}", effect.id());
    println!("\n  {:<28} {:<16} {:<28} deviation", "simulated", "true value", "estimate");
    for (k, p) in
        effect.parameters().iter().enumerate().filter(|(k, p)| effect.uses(hidden, *k) && !p.is_choice())
    {
        let quantity = place.and_then(|i| d.missing[i].parameters.get(p.name));
        let found = quantity.map_or("-".into(), |q| q.to_string());
        let z = quantity.map(|q| (q.value - hidden[k]) / q.std_err).filter(|z| z.is_finite());
        let z = z.map_or(String::new(), |z| format!("{z:+.1} σ"));
        let name = format!("{} {}", effect.id(), p.name);
        println!("  {name:<28} {:<16} {found:<28} {z}", format!("{:.4e}", hidden[k]));
    }
    let id = effect.id();
    println!(
        "\nThe simulated effect was {id}. {}",
        match (found, place) {
            (true, Some(0)) => format!(
                "It was named first, and the error fell from {:.2} to {:.2} (1: noise alone).",
                d.error_before, d.error_after
            ),
            (true, _) =>
                format!("It is tied with {}: this campaign cannot tell them apart.", d.missing[0].effect),
            (false, Some(_)) => format!("It was found, but {} stands before it.", d.missing[0].effect),
            (false, None) if d.consistent =>
                "It is too weak for this campaign: the paper's model agrees with it.".into(),
            (false, None) => format!("IT WAS NOT FOUND; {} stands first.", d.missing[0].effect),
        }
    );
    Ok(outcome)
}

/// Compares gain and noise with the truth, for a camera that follows the paper's model.
fn the_papers(
    arguments: &Arguments,
    model: &Model,
    camera: &str,
    file: &Path,
    plan: &Plan,
    dataset: &Path,
) -> Result<Outcome> {
    let options = StreamOptions::default();
    with_camera(arguments, file, plan, |camera, bench| {
        capture(camera, bench, options, plan, dataset, false)
    })?;
    let title = format!("{camera}{}", over(arguments));
    let truth = Truth {
        gain_dn_per_e: model.base.gain_dn_per_e,
        constant_noise_var_dn2: model.constant_noise_var_dn2(0.0),
        read_noise_e: model.base.read_noise_e,
    };
    let report = noise::estimate(&Datasets::of(dataset))?;
    if arguments.json {
        println!(
            "{}",
            serde_json::to_string_pretty(&serde_json::json!({ "hidden": null, "noise": report }))?
        );
        let worst = truth.rows(&report).into_iter().map(|(_, measured, truth)| sigmas(measured, truth).abs());
        let agrees = worst.fold(0.0, f64::max) <= 3.0 && report.consistent();
        return Ok(if agrees { Outcome::Agreement } else { Outcome::Disagreement });
    }
    println!("\n{title}\n\n  {:<16} {:<28} {:<12} difference", "", "measured", "truth");
    let mut worst = 0.0_f64;
    for (name, measured, truth) in truth.rows(&report) {
        let z = sigmas(measured, truth);
        worst = worst.max(z.abs());
        let value = measured.to_string();
        println!("  {name:<16} {value:<28} {truth:<12.5} {z:+.1} σ");
    }
    println!("\n  χ² = {:.1} for {} degrees of freedom, Q = {:.3}", report.chi2, report.dof, report.q);
    let path = arguments.output.join("report.html");
    write_whole(&path, html("Gain and constant noise", &title, &report, Some(&truth)).as_bytes())?;
    let dataset = dataset.display();
    println!("\n  report:   {}\n  dataset:  {dataset}\n  next:     radcam noise {dataset}", path.display());
    let agrees = worst <= 3.0 && report.consistent();
    println!(
        "\n{}",
        if agrees { "The measurement agrees with the truth." } else { "THE MEASUREMENT DISAGREES." }
    );
    Ok(if agrees { Outcome::Agreement } else { Outcome::Disagreement })
}

/// Prepares the output folder: removes the dataset of an earlier demo, and no other files.
fn clear(output: &Path, dataset: &Path) -> Result<()> {
    if dataset.exists() {
        if !dataset.join("frames.csv").exists() {
            bail!("{} is not a dataset of an earlier demo; choose another folder with -o", dataset.display());
        }
        std::fs::remove_dir_all(dataset).with_context(|| dataset.display().to_string())?;
    }
    crate::output::folder(output).with_context(|| output.display().to_string())
}

/// Describes the transport of the frames.
fn over(arguments: &Arguments) -> String {
    match cfg!(feature = "aravis") {
        true => format!(", over GigE Vision on {}", arguments.interface),
        false => ", simulated in this process".into(),
    }
}

/// Runs `act` with a camera that another process serves, through libaravis.
#[cfg(feature = "aravis")]
fn with_camera<T>(
    arguments: &Arguments,
    sensor: &Path,
    plan: &Plan,
    act: impl FnOnce(&mut dyn Camera, &mut dyn Illuminator) -> Result<T>,
) -> Result<T> {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};

    let interface = arguments.interface.to_string();
    let mut serve = Command::new(std::env::current_exe()?);
    let sensor = sensor.display().to_string();
    serve.args(["serve", &sensor, "--interface", &interface, "--serial", "DEMO", "--while-stdin"]);
    // The child's standard input closes when this process ends, for whatever reason.
    let mut child =
        serve.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().context("cannot start the camera")?;
    let mut said = String::new();
    if let Some(out) = child.stdout.take() {
        BufReader::new(out).read_line(&mut said)?;
    }
    if !said.starts_with("serving") {
        child.wait()?;
        bail!("the camera could not be served on {interface} (its own words stand above)");
    }
    eprintln!("{}", said.trim_end().trim_end_matches("; Ctrl-C ends"));
    let outcome = (|| {
        let (mut camera, mut bench) = super::common::open_camera(&format!("aravis:{interface}"), plan)?;
        act(&mut *camera, &mut *bench)
    })();
    drop(child.stdin.take());
    child.wait()?;
    outcome
}

/// Runs `act` with the simulator in this process.
#[cfg(not(feature = "aravis"))]
fn with_camera<T>(
    arguments: &Arguments,
    sensor: &Path,
    plan: &Plan,
    act: impl FnOnce(&mut dyn Camera, &mut dyn Illuminator) -> Result<T>,
) -> Result<T> {
    eprintln!("{}; the demo uses the simulator in this process instead", crate::camera::NO_ARAVIS);
    let mut camera = crate::camera::sim::SimCamera::open(&sensor.display().to_string(), arguments.seed)?;
    let mut bench = crate::bench::of(&mut camera, plan);
    act(&mut camera, &mut *bench)
}
