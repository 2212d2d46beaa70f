//! `radcam calibrate`

use super::Outcome;
use super::common::{STOP, above_0, after_faults, may_be_written, say_faults};
use crate::calibrate::defects::{BLIND, DEAD, Defect, HOT, UNSTABLE};
use crate::calibrate::file::Calibration;
use crate::calibrate::pattern::{Options, Start};
use crate::calibrate::{Calibrated, Estimator, of_dataset};
use crate::data_faults::examined;
use crate::noise;
use crate::number::six_digits;
use crate::reduction;
use anyhow::{Result, bail};
use ndarray::Array2;
use std::path::PathBuf;

/// Maximum number of defects listed on the terminal.
const LISTED: usize = 10;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A dataset folder or an EMVA 1288 descriptor, with darks and with flats of three configurations or more
    dataset: PathBuf,
    /// The calibration file
    #[arg(short, long, value_name = "CAL.tiff")]
    output: PathBuf,
    /// joint: each light a smooth surface; paper: each light the mean over a window; smooth: one
    /// configuration is enough, and K then contains the card and the lamp's fine structure
    #[arg(long, default_value = "joint", value_parser = ["joint", "paper", "smooth"])]
    estimator: String,
    /// Flat-field correction: (I - D) / (F - D) times its mean. Lens shading, lamp and card are taken off
    /// with the fixed pattern; flats of one position are enough
    #[arg(long, conflicts_with = "estimator")]
    flat_field: bool,
    /// paper: side of the window, pixels, an odd number [default: 9]
    #[arg(long, value_parser = window)]
    window: Option<usize>,
    /// paper: keep slopes within p pooled deviations [default: 1.5]
    #[arg(long, value_parser = above_0)]
    p: Option<f64>,
    /// paper: begin at the mean over the configurations, as printed, instead of the median
    #[arg(long)]
    start_at_mean: bool,
    /// Write over a calibration that is there
    #[arg(long)]
    overwrite: bool,
    /// Print JSON: what the file says of itself
    #[arg(long)]
    json: bool,
}

/// Counts the defects by kind; a pixel may have several.
fn counts(defects: &[Defect]) -> [(&'static str, usize); 4] {
    [(HOT, "hot"), (DEAD, "dead"), (UNSTABLE, "unstable"), (BLIND, "blind")]
        .map(|(flag, name)| (name, defects.iter().filter(|d| d.flags & flag != 0).count()))
}

/// Returns mean and standard deviation over the pixels without a defect.
fn of_sound(calibration: &Calibration, values: &Array2<f32>) -> (f64, f64) {
    let sound = || values.iter().zip(&calibration.defects).filter(|(_, flags)| **flags == 0);
    let n = sound().count().max(1) as f64;
    let mean = sound().map(|(v, _)| f64::from(*v)).sum::<f64>() / n;
    let square: f64 = sound().map(|(v, _)| (f64::from(*v) - mean).powi(2)).sum();
    (mean, (square / n).sqrt())
}

/// Lists the columns and rows that are blind as a whole.
fn places(calibration: &Calibration) -> String {
    let blind = calibration.defects.mapv(|flags| flags & BLIND != 0);
    let lines = |axis: usize, name: &str| {
        let whole: Vec<usize> = blind
            .axis_iter(ndarray::Axis(axis))
            .enumerate()
            .filter(|(_, line)| line.iter().all(|b| *b))
            .map(|(i, _)| i)
            .collect();
        let runs = whole.chunk_by(|a, b| b - a == 1).map(|run| match run {
            [one] => one.to_string(),
            [first, .., last] => format!("{first} to {last}"),
            [] => String::new(),
        });
        let runs: Vec<String> = runs.collect();
        (!runs.is_empty()).then(|| format!("{name} {}", runs.join(", ")))
    };
    let named: Vec<String> = [lines(1, "columns"), lines(0, "rows")].into_iter().flatten().collect();
    let n = blind.iter().filter(|b| **b).count();
    if named.is_empty() { format!("{n} pixels") } else { format!("{n} pixels ({})", named.join("; ")) }
}

/// Parses the side of a window: odd, so that the window has a centre pixel.
fn window(text: &str) -> Result<usize, String> {
    match text.parse::<usize>() {
        Ok(side) if side >= 3 && side % 2 == 1 => Ok(side),
        _ => Err("write an odd number of pixels, 3 or more".into()),
    }
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    may_be_written(&arguments.output, arguments.overwrite)?;
    let of_paper = arguments.window.is_some() || arguments.p.is_some() || arguments.start_at_mean;
    if of_paper && arguments.estimator != "paper" {
        let other = if arguments.flat_field { "--flat-field" } else { &arguments.estimator };
        bail!("--window, --p and --start-at-mean belong to --estimator paper, and it is {other}");
    }
    let start = if arguments.start_at_mean { Start::Mean } else { Start::Median };
    let estimator = match &*arguments.estimator {
        _ if arguments.flat_field => Estimator::FlatField,
        "paper" => Estimator::Paper(Options {
            window: arguments.window.unwrap_or(9),
            p: arguments.p.unwrap_or(1.5),
            start,
        }),
        "smooth" => Estimator::Smooth,
        _ => Estimator::Joint,
    };
    let dataset = examined(&reduction::open(&arguments.dataset)?, &STOP)?;
    let camera = &dataset.manifest().camera;
    if let Some(side) = arguments.window.filter(|side| *side > camera.width.min(camera.height)) {
        bail!("--window {side}: frames have {} x {} px", camera.width, camera.height);
    }
    // A calibration campaign may have only one level; the noise is then unknown.
    let noise = noise::of_dataset(&dataset, &STOP, &mut |_, _| {}).ok();
    let provenance = format!("radcam {} from {}", env!("CARGO_PKG_VERSION"), arguments.dataset.display());
    let Calibrated { calibration, mut defects, data_faults, levels, left_out, has_card } =
        after_faults(of_dataset(&dataset, estimator, noise.as_ref(), &provenance), dataset.data_faults())?;
    calibration.write(&arguments.output)?;
    let d = &calibration.description;
    if arguments.json {
        let mut said = serde_json::to_value(d)?;
        said["data_faults"] = serde_json::to_value(&data_faults)?;
        said["left_out"] = serde_json::to_value(&left_out)?;
        said["has_card"] = has_card.into();
        said["defect_counts"] = counts(&defects)
            .into_iter()
            .map(|(name, n)| (name.to_string(), serde_json::Value::from(n)))
            .collect();
        println!("{}", serde_json::to_string_pretty(&said)?);
        return Ok(Outcome::Agreement);
    }
    say_faults(&data_faults);
    println!("{}: {} x {} px, {}", arguments.output.display(), d.camera.width, d.camera.height, d.estimator);
    let exposures = if levels > 1 { format!(" at {levels} levels") } else { String::new() };
    println!(
        "  K                {} configuration{} of {} frames{exposures}, standard deviation {:.5}",
        d.n1,
        if d.n1 == 1 { "" } else { "s" },
        d.n2,
        of_sound(&calibration, &calibration.k).1
    );
    let error = calibration.k_std_err.mean().unwrap_or(f32::NAN);
    println!("  error of K       {error:.5} a pixel");
    let (mean, sd) = of_sound(&calibration, &calibration.dark.level_dn);
    println!(
        "  dark reference   {mean:.3} DN, standard deviation {sd:.3} DN, at {} s",
        six_digits(d.dark_exposure_s)
    );
    let kinds: Vec<String> =
        counts(&defects).into_iter().filter(|(_, n)| *n > 0).map(|(name, n)| format!("{n} {name}")).collect();
    let kinds = if kinds.is_empty() { String::new() } else { format!(": {}", kinds.join(", ")) };
    println!("  defects          {} of {} pixels{kinds}", defects.len(), calibration.k.len());
    // Blind pixels are contiguous: their rows and columns say more than a list.
    let blind = defects.iter().any(|d| d.flags & BLIND != 0);
    defects.retain(|d| d.flags & BLIND == 0);
    for d in defects.iter().take(LISTED) {
        println!("    x {:>5}  y {:>5}  {}", d.x, d.y, d.reason());
    }
    if defects.len() > LISTED {
        println!("    ... and {} more; page \"defects\" of the file has all", defects.len() - LISTED);
    }
    if blind {
        println!(
            "  note: no light reaches {}: outside the image circle of the lens, optically black, or overscan. K = 1 there",
            places(&calibration)
        );
    }
    for left_out in &left_out {
        println!("  note: not used: {left_out}");
    }
    if estimator == Estimator::FlatField {
        println!(
            "  note: corrected frames are even where the flats are: the light of the flats, lens shading and card included, is in K"
        );
    } else if estimator == Estimator::Smooth {
        println!("  note: nothing was moved: K contains the card, and of the lamp what is not smooth");
    } else if has_card {
        println!(
            "  note: the configurations differ by no more than the noise of their frames: card and lamp are even, or were not moved, and \
             then K contains the card, and of the lamp what is not smooth; its error does not hold for that"
        );
    }
    if calibration.dark.current_dn_per_s.is_none() {
        println!(
            "  note: darks of one exposure: the dark reference holds at {} s only",
            six_digits(d.dark_exposure_s)
        );
    }
    Ok(Outcome::Agreement)
}
