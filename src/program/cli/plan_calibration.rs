//! `radcam plan-calibration`

use super::Outcome;
use super::common::{STOP, above_0, duration, may_be_written, open_camera, say_faults};
use super::observe::Colour;
use super::progress::Show;
use crate::calibrate::plan::{campaign, needs, needs_smooth, pilot};
use crate::capture::Capture;
use crate::data_faults::examined;
use crate::dataset::write_whole;
use crate::noise;
use anyhow::{Context, Result, bail};
use indicatif::HumanBytes;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A pilot already captured: darks, flats at several levels, three configurations or more (one for
    /// smooth)
    #[arg(required_unless_present = "camera")]
    pilot: Option<PathBuf>,
    #[command(flatten)]
    colour: Colour,
    /// Capture the pilot now with this camera (aravis:ID or sim:SENSOR)
    #[arg(long, conflicts_with = "pilot", requires = "pilot_folder")]
    camera: Option<String>,
    /// Where the pilot goes
    #[arg(long, value_name = "FOLDER")]
    pilot_folder: Option<PathBuf>,
    /// The plan that `capture` runs
    #[arg(short, long, value_name = "PLAN.toml")]
    output: PathBuf,
    /// Standard error of K wanted, relative, such as 0.001; where not given, K keeps as many bits as the
    /// converter has, as in the paper, which takes very many frames of a camera of 12 bits
    #[arg(long, value_name = "ERROR", value_parser = above_0)]
    k_error: Option<f64>,
    /// Estimator of `calibrate`: joint or paper, which need several configurations, or smooth, for which one
    /// is enough
    #[arg(long, default_value = "joint", value_parser = ["joint", "paper", "smooth"])]
    estimator: String,
    /// Write over a plan that is there
    #[arg(long)]
    overwrite: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Number of frames above which a smaller campaign is offered: ten minutes at 30 frames per second.
const MANY: u64 = 18_000;

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    may_be_written(&arguments.output, arguments.overwrite)?;
    let folder = match (&arguments.camera, &arguments.pilot_folder, &arguments.pilot) {
        (Some(name), Some(folder), _) => {
            let plan = pilot();
            let (mut camera, mut bench) = open_camera(name, &plan)?;
            let mut show = Show::new("pilot");
            let mut progress = |p| show.frames(p);
            let mut capture = Capture::new(&mut *camera, &mut *bench);
            capture.stop = &STOP;
            capture.progress = Some(&mut progress);
            capture.run(&plan, folder).context("pilot")?;
            folder
        }
        (_, _, Some(pilot)) => pilot,
        _ => bail!("give a pilot dataset, or --camera with --pilot-folder"),
    };
    let dataset = arguments.colour.open(folder)?;
    dataset.must_be_monochrome()?;
    let dataset = examined(&dataset, &STOP)?;
    let noise = noise::of_dataset(&dataset, &STOP, &mut |_, _| {})?;
    let smooth = arguments.estimator == "smooth";
    let needs = (if smooth { needs_smooth } else { needs })(&dataset, &noise, arguments.k_error)?;
    let plan = campaign(&dataset, &needs);
    write_whole(&arguments.output, plan.to_toml()?.as_bytes())?;
    if arguments.json {
        let mut said = serde_json::to_value(&needs)?;
        said["data_faults"] = serde_json::to_value(dataset.data_faults())?;
        println!("{}", serde_json::to_string_pretty(&said)?);
        return Ok(Outcome::Agreement);
    }
    let full = f64::from((1u32 << needs.bit_depth) - 1);
    println!("{}: {}", arguments.output.display(), plan.about);
    say_faults(dataset.data_faults());
    let frames = plan.frames();
    let camera = &dataset.manifest().camera;
    let bytes = frames * (camera.width * camera.height * camera.bit_depth.div_ceil(8) as usize) as u64;
    println!(
        "  {frames} frames in {} sets, {}, {} of exposure",
        plan.sets.len(),
        HumanBytes(bytes),
        duration(plan.seconds(None))
    );
    if smooth {
        println!(
            "  n2 = {:<6} frames of one configuration: K then has {:.2e} of noise a pixel, and contains the card and the\n{:11}lamp's \
             fine structure: radcam calibrate --estimator smooth",
            needs.n2, needs.slope_sd, ""
        );
        println!("  s  = {:<6} darks at each exposure", needs.s);
        return Ok(Outcome::Agreement);
    }
    if let Some(error) = needs.k_std_err {
        println!(
            "  n1 = {:<6} configurations of {} frames each, for K to {} a pixel: slopes scatter by {:.5}",
            needs.n1, needs.n2, error, needs.slope_sd
        );
        println!("  s  = {:<6} darks at each exposure", needs.s);
        return Ok(Outcome::Agreement);
    }
    println!(
        "  n1 = {:<6} configurations: slopes scatter by {:.5}, and at worst {:.0} % of them are kept,\n\
         {:11}so that K's error leaves {} bits whole: 10 * 2^{} * (1.5 * {:.5})^2 / {:.2}",
        needs.n1,
        needs.slope_sd,
        100.0 * needs.worst_kept,
        "",
        needs.bit_depth,
        2 * needs.bit_depth,
        needs.slope_sd,
        needs.worst_kept
    );
    println!(
        "  n2 = {:<6} frames each: {:.3} DN^2 of noise at {full} DN come down to q^2/9",
        needs.n2, needs.full_scale_var_dn2
    );
    println!(
        "  s  = {:<6} darks at each exposure: {:.3} DN^2 come down to q^2/9",
        needs.s, needs.dark_var_dn2
    );
    if frames > MANY {
        println!(
            "  note: that many frames keep K to {:.1e}, one part in 10 * 2^{} of the variance. --k-error 0.001 asks for an error that you choose;\n        \
             `calibrate` states the error of K whatever their number",
            (10.0 * 2f64.powi(2 * i32::from(needs.bit_depth))).sqrt().recip(),
            2 * needs.bit_depth
        );
    }
    Ok(Outcome::Agreement)
}
