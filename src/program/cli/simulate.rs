//! `radcam simulate`

use super::Outcome;
use super::capture::{capture, region, tell};
use super::common::load_plan;
use crate::bench;
use crate::camera::StreamOptions;
use crate::camera::sim::SimCamera;
use anyhow::Result;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A sensor (xc77, cmos12, ccd16, imx250...; `radcam cameras` lists them) or a model file
    sensor: String,
    /// quick, standard (the default), emva1288, or a plan file; a resumed run has its own, and may name it
    /// again
    #[arg(long)]
    plan: Option<String>,
    /// Folder of the new dataset
    #[arg(short, long)]
    output: PathBuf,
    /// Continue where an interrupted run stopped
    #[arg(long)]
    resume: bool,
    /// Another specimen of the same camera: seed of its maps and its noise
    #[arg(long)]
    seed: Option<u64>,
    /// First column, first row, width, height of the region, pixels
    #[arg(long, value_name = "X,Y,W,H", value_parser = region, conflicts_with = "resume")]
    region: Option<[u32; 4]>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let mut plan = load_plan(arguments.plan.as_deref(), arguments.resume, &arguments.output)?;
    plan.camera.region = arguments.region.or(plan.camera.region);
    let mut camera = SimCamera::open(&arguments.sensor, arguments.seed)?;
    let mut bench = bench::of(&mut camera, &plan);
    let options = StreamOptions::default();
    let summary = capture(&mut camera, &mut *bench, options, &plan, &arguments.output, arguments.resume)?;
    tell(&summary, &arguments.output, arguments.json)?;
    Ok(Outcome::Agreement)
}
