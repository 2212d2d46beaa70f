//! `radcam scene`

use super::Outcome;
use super::common::can_be_written;
use super::region::RegionArguments;
use crate::dataset::{image, write_whole};
use crate::number::with_error;
use crate::scene_variation::map;
use anyhow::{Result, bail};
use std::path::PathBuf;
use tiff::encoder::colortype::Gray32Float;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    region: RegionArguments,
    /// Also write a map of V_s over windows of this side, px
    #[arg(long, value_name = "PX", requires = "map_output")]
    map: Option<usize>,
    /// The map: a 32-bit float TIFF, one pixel for each window, NaN where there is no light
    #[arg(long, value_name = "MAP.tiff", requires = "map")]
    map_output: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    can_be_written(&arguments.map_output)?;
    let seen = arguments.region.read()?;
    let v = seen.variation()?;
    let (rows, columns) = seen.corrected.dim();
    if let Some(side) = arguments.map.filter(|side| *side > rows.min(columns) || *side < 10) {
        bail!(
            "--map {side}: windows have 10 px a side or more, and fit into the image of {columns} x {rows} px"
        );
    }
    if let (Some(side), Some(path)) = (arguments.map, &arguments.map_output) {
        let (value, _) = map(&seen.corrected, seen.frames, &seen.dark_dn, &seen.calibration, side)?;
        let description = format!("scene variation V_s over windows of {side} x {side} px");
        write_whole(path, &image::described_bytes::<Gray32Float>(value.view(), &description)?)?;
    }
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&v)?);
        return Ok(Outcome::Agreement);
    }
    let q = v.scene_variation;
    println!("scene variation V_s  {}", with_error(q.value, q.std_err));
    println!("  mean               {:.3} DN above the dark reference", v.mean_dn);
    println!("  spatial variance   {:.4} DN^2 over {} pixels", v.spatial_var_dn2, v.pixels);
    println!(
        "  of it camera noise {:.4} DN^2 ({} frame{})",
        v.noise_var_dn2,
        v.frames,
        if v.frames == 1 { "" } else { "s" }
    );
    if q.value < 2.0 * q.std_err {
        println!("  note: no variation of the surface is seen above the camera's noise");
    }
    Ok(Outcome::Agreement)
}
