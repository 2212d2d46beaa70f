//! `radcam demo`

use super::capture::capture;
use super::common::load_model;
use super::{Outcome, noise};
use crate::camera::StreamOptions;
use crate::dataset::write_whole;
use crate::diagnosis::diagnose;
use crate::number::with_unit;
use crate::plan::Plan;
use crate::report::noise::{Truth, html, sigmas};
use anyhow::{Context, Result, bail};
use radcam_sim::effects::{EFFECTS, Effect, example};
use radcam_sim::{EffectValues, Model};
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A sensor (xc77, cmos12, ccd16) or a model file
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
}

/// Largest side of the region that the demo captures: a campaign of some 40 MB.
const REGION: (u32, u32) = (320, 256);

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let mut model = load_model(&arguments.sensor, arguments.seed)?;
    let seed = arguments.seed.unwrap_or(model.base.seed);
    let hidden = hide(&arguments.hide, &mut model, seed)?;
    let (width, height) = (model.camera.width.min(REGION.0), model.camera.height.min(REGION.1));
    if hidden.is_some() {
        // The whole sensor is drawn for an effect that reaches across it: a small one is enough.
        (model.camera.width, model.camera.height) = (width, height);
    }
    let mut plan = Plan::standard();
    plan.camera.region =
        Some([(model.camera.width - width) / 8 * 4, (model.camera.height - height) / 8 * 4, width, height]);
    let dataset = arguments.output.join("dataset");
    clear(&arguments.output, &dataset)?;
    let file = arguments.output.join("camera.toml");
    write_whole(&file, model.to_toml()?.as_bytes())?;
    let how = take(arguments, &file, &plan, &dataset)?;
    let camera = format!("{} {}", model.camera.vendor, model.camera.model);
    println!("\n{camera}, {width} x {height} px, {how}");
    match hidden {
        None => the_papers(arguments, &model, &camera, &how, &dataset),
        Some((effect, values)) => the_story(arguments, effect, &values, &camera, &how, &dataset),
    }
}

/// An effect with its values.
type Hidden = (&'static dyn Effect, Vec<f64>);

/// Hides an effect in a model, at a strength that is plain to see.
fn hide(what: &str, model: &mut Model, seed: u64) -> Result<Option<Hidden>> {
    let known = || EFFECTS.iter().filter(|e| example(e.id(), model).is_some());
    let effect = match what {
        "none" => return Ok(None),
        // The same seed hides the same effect: a multiplicative hash of it (Knuth 1998, 6.4) picks.
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

/// Found wanting, named, added, and the error falls.
fn the_story(
    arguments: &Arguments,
    effect: &'static dyn Effect,
    hidden: &[f64],
    camera: &str,
    how: &str,
    dataset: &Path,
) -> Result<Outcome> {
    println!("Something is hidden in this camera. Is the paper's model enough?\n");
    let all = super::observe::observe(dataset)?;
    let d = diagnose(&all, None, Vec::new(), &mut |text| tracing::info!("{text}"));
    super::diagnose::print(dataset, &d);
    let path = arguments.output.join("report.html");
    let page = crate::report::compare::diagnosis("What the model lacks", &format!("{camera}, {how}"), &d);
    write_whole(&path, page.as_bytes())?;
    println!("\n  report:   {}\n  dataset:  {}", path.display(), dataset.display());
    println!("  next:     radcam effects {}", effect.id());
    let first = d.missing.first();
    let place = d.missing.iter().position(|m| m.effect == effect.id());
    // The first name, or what this campaign cannot tell from it.
    let tied = place
        .is_some_and(|p| p == 0 || d.missing[p].tied_with.as_deref() == first.map(|m| m.effect.as_str()));
    let found = tied && d.missing.first().is_none_or(|m| m.effect != "unknown");
    println!("\n  {:<28} {:<16} {:<28} difference", "hidden", "value", "found");
    for (k, p) in
        effect.parameters().iter().enumerate().filter(|(k, p)| effect.uses(hidden, *k) && !p.is_choice())
    {
        let quantity = place.and_then(|i| d.missing[i].parameters.get(p.name));
        let found = quantity.map_or("-".into(), |q| with_unit(q.value, q.std_err, q.unit));
        let z = quantity.map(|q| (q.value - hidden[k]) / q.std_err).filter(|z| z.is_finite());
        let z = z.map_or(String::new(), |z| format!("{z:+.1} σ"));
        let name = format!("{} {}", effect.id(), p.name);
        println!("  {name:<28} {:<16} {found:<28} {z}", format!("{:.4e}", hidden[k]));
    }
    let id = effect.id();
    println!(
        "\nHidden was {id}. {}",
        match (found, place) {
            (true, Some(0)) => "It was named first, and the error fell to the noise.".to_string(),
            (true, _) =>
                format!("It is tied with {}: this campaign cannot tell them apart.", d.missing[0].effect),
            (false, Some(_)) => format!("It was found, but {} stands before it.", d.missing[0].effect),
            (false, None) if d.consistent =>
                "It is too weak for this campaign: the paper's model holds.".into(),
            (false, None) => format!("IT WAS NOT FOUND; {} stands first.", d.missing[0].effect),
        }
    );
    Ok(if found { Outcome::Agreement } else { Outcome::Disagreement })
}

/// Gain and noise against the truth, for a camera that is what the paper says.
fn the_papers(
    arguments: &Arguments,
    model: &Model,
    camera: &str,
    how: &str,
    dataset: &Path,
) -> Result<Outcome> {
    let truth = Truth {
        gain_dn_per_e: model.base.gain_dn_per_e,
        constant_noise_var_dn2: model.constant_noise_var_dn2(0.0),
        read_noise_e: model.base.read_noise_e,
    };
    let report = noise::estimate(dataset)?;
    println!("\n  {:<16} {:<28} {:<12} difference", "", "measured", "truth");
    let mut worst = 0.0_f64;
    for (name, measured, truth) in truth.rows(&report) {
        let z = sigmas(measured, truth);
        worst = worst.max(z.abs());
        let value = with_unit(measured.value, measured.std_err, measured.unit);
        println!("  {name:<16} {value:<28} {truth:<12.5} {z:+.1} σ");
    }
    println!("\n  χ² = {:.1} for {} degrees of freedom, Q = {:.3}", report.chi2, report.dof, report.q);
    let path = arguments.output.join("report.html");
    let subtitle = format!("{camera}, {how}");
    write_whole(&path, html("Gain and constant noise", &subtitle, &report, Some(&truth)).as_bytes())?;
    let dataset = dataset.display();
    println!("\n  report:   {}\n  dataset:  {dataset}\n  next:     radcam noise {dataset}", path.display());
    let agrees = worst <= 3.0 && report.consistent();
    println!(
        "\n{}",
        if agrees { "The measurement agrees with the truth." } else { "THE MEASUREMENT DISAGREES." }
    );
    Ok(if agrees { Outcome::Agreement } else { Outcome::Disagreement })
}

/// Makes room for the demo, and touches nothing that is not a demo's.
fn clear(output: &Path, dataset: &Path) -> Result<()> {
    if dataset.exists() {
        if !dataset.join("frames.csv").exists() {
            bail!("{} is not a dataset of an earlier demo; choose another folder with -o", dataset.display());
        }
        std::fs::remove_dir_all(dataset).with_context(|| dataset.display().to_string())?;
    }
    std::fs::create_dir_all(output).with_context(|| output.display().to_string())
}

/// Captures through libaravis from a camera that another process serves.
#[cfg(feature = "aravis")]
fn take(arguments: &Arguments, sensor: &Path, plan: &Plan, dataset: &Path) -> Result<String> {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};

    let interface = arguments.interface.to_string();
    let mut serve = Command::new(std::env::current_exe()?);
    let sensor = sensor.display().to_string();
    serve.args(["serve", &sensor, "--interface", &interface, "--serial", "DEMO", "--while-stdin"]);
    // Its end of standard input closes with this process, however that ends.
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
        capture(&mut *camera, &mut *bench, StreamOptions::default(), plan, dataset, false)
    })();
    drop(child.stdin.take());
    child.wait()?;
    let summary = outcome?;
    let c = summary.counts;
    Ok(format!("{} frames over GigE Vision on {interface}, {} damaged", summary.frames, c.failures))
}

/// Captures from the simulator in this process.
#[cfg(not(feature = "aravis"))]
fn take(arguments: &Arguments, sensor: &Path, plan: &Plan, dataset: &Path) -> Result<String> {
    eprintln!("{}; the demo uses the simulator in this process instead", super::common::NO_ARAVIS);
    let (mut camera, mut bench) = super::common::simulated(&sensor.display().to_string(), arguments.seed)?;
    let summary = capture(&mut camera, &mut bench, StreamOptions::default(), plan, dataset, false)?;
    Ok(format!("{} frames simulated in this process", summary.frames))
}
