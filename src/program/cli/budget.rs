//! `radcam budget`

use super::Outcome;
use super::common::can_be_written;
use super::region::RegionArguments;
use crate::budget::{NAMES, Parts};
use crate::dataset::write_whole;
use crate::report;
use crate::scene_variation::{CameraNoise, part};
use anyhow::Result;
use ndarray::ArrayView2;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    region: RegionArguments,
    /// Also write a page with the plot
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Returns mean and variance of a part of a map.
fn moments(view: ArrayView2<'_, f32>) -> (f64, f64) {
    let n = view.len() as f64;
    let mean = view.iter().map(|&v| f64::from(v)).sum::<f64>() / n;
    (mean, view.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / (n - 1.0))
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    can_be_written(&arguments.report)?;
    let seen = arguments.region.read()?;
    let v = seen.variation()?;
    let noise = CameraNoise::of(&seen.calibration)?;
    let (dark, dark_var) = moments(part(&seen.dark_dn, seen.roi)?);
    let (_, k_var) = moments(part(&seen.calibration.k, seen.roi)?);
    let k_error = part(&seen.calibration.k_std_err, seen.roi)?;
    let k_error = k_error.iter().map(|&e| f64::from(e).powi(2)).sum::<f64>() / k_error.len() as f64;
    let dark_error = seen.calibration.description.dark_std_err_dn.unwrap_or(0.0);
    let parts = Parts {
        scene_variation: v.scene_variation.value.max(0.0),
        dark_spatial_var_dn2: (dark_var - dark_error * dark_error).max(0.0),
        k_var: (k_var - k_error).max(0.0),
        gain_dn_per_e: noise.gain_dn_per_e,
        constant_noise_var_dn2: noise.constant_noise_var_dn2,
        dark_dn: dark - noise.offset_dn,
    };
    let full = f64::from(seen.calibration.description.camera.full_scale_dn());
    let levels = parts.levels((full - dark).max(v.mean_dn), 48);
    if let Some(path) = &arguments.report {
        let subtitle = arguments.region.images[0].display().to_string();
        write_whole(path, report::budget::html(&subtitle, &v, &levels).as_bytes())?;
    }
    if arguments.json {
        let here = parts.at(v.mean_dn);
        let json = serde_json::json!({
            "parts": parts, "variation": v, "here": here, "levels": levels, "shares": NAMES,
        });
        println!("{}", serde_json::to_string_pretty(&json)?);
        return Ok(Outcome::Agreement);
    }
    print!("{:>10} {:>12}", "mean (DN)", "total (DN^2)");
    NAMES.iter().for_each(|name| print!(" {name:>14}"));
    println!();
    let here = parts.at(v.mean_dn);
    let table = levels.iter().skip(3).step_by(4).map(|l| (l, "")).chain([(&here, "  <- this image")]);
    for (level, mark) in table {
        print!("{:>10.1} {:>12.3}", level.mean_dn, level.total_dn2);
        level.shares().iter().for_each(|share| print!(" {:>12.1} %", 100.0 * share));
        println!("{mark}");
    }
    Ok(Outcome::Agreement)
}
