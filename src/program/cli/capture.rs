//! `radcam capture`

use super::common::{STOP, above_0, load_plan, open_camera};
use super::{Outcome, progress::Show};
use crate::bench::Illuminator;
use crate::camera::{Camera, StreamOptions};
use crate::capture::{Capture, Progress, Summary};
use crate::plan::Plan;
use anyhow::Result;
use std::path::{Path, PathBuf};
use std::time::Duration;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[arg(long, help = crate::camera::names())]
    camera: String,
    /// quick, standard (the default), emva1288, or a plan file; a resumed capture has its own, and may name
    /// it again
    #[arg(long)]
    plan: Option<String>,
    /// Folder of the new dataset
    #[arg(short, long)]
    output: PathBuf,
    /// Continue a capture that was interrupted
    #[arg(long)]
    resume: bool,
    /// Exposure that brings the card at illumination 1 close to full scale, s; measured where not given
    #[arg(long, conflicts_with = "resume", value_parser = above_0)]
    full_exposure_s: Option<f64>,
    /// First column, first row, width, height of the region, pixels; else the plan's, or what the camera has
    #[arg(long, value_name = "X,Y,W,H", value_parser = region, conflicts_with = "resume")]
    region: Option<[u32; 4]>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    stream: StreamArguments,
}

/// Parses `x,y,w,h`.
pub fn region(text: &str) -> Result<[u32; 4], String> {
    let numbers: Vec<u32> = text
        .split(',')
        .map(|n| n.trim().parse().map_err(|_| format!("\"{n}\" is not a whole number")))
        .collect::<Result<_, String>>()?;
    numbers.try_into().map_err(|_| "write x,y,width,height".into())
}

/// GigE Vision options.
#[derive(Debug, Default, clap::Args)]
pub struct StreamArguments {
    /// Bytes of a GigE Vision packet; negotiated where not given
    #[arg(long)]
    packet_size: Option<u32>,
    /// Do not ask for lost packets again
    #[arg(long)]
    no_resend: bool,
    /// Milliseconds until a packet counts as lost
    #[arg(long)]
    packet_timeout_ms: Option<u64>,
    /// Milliseconds until an unfinished frame is given up
    #[arg(long)]
    frame_retention_ms: Option<u64>,
    /// Nothing: the packet socket is never used
    #[arg(long, hide = true)]
    no_packet_socket: bool,
    /// Frames held ready for the camera to fill
    #[arg(long)]
    buffers: Option<usize>,
}

impl StreamArguments {
    pub fn options(&self) -> StreamOptions {
        let default = StreamOptions::default();
        let ms = |given: Option<u64>, or| given.map_or(or, Duration::from_millis);
        StreamOptions {
            buffers: self.buffers.unwrap_or(default.buffers),
            packet_size: self.packet_size,
            packet_resend: !self.no_resend,
            packet_timeout: ms(self.packet_timeout_ms, default.packet_timeout),
            frame_retention: ms(self.frame_retention_ms, default.frame_retention),
            ..default
        }
    }
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let mut plan = load_plan(arguments.plan.as_deref(), arguments.resume, &arguments.output)?;
    if arguments.full_exposure_s.is_some() {
        plan.full_exposure_s = arguments.full_exposure_s;
    }
    plan.camera.region = arguments.region.or(plan.camera.region);
    let (mut camera, mut bench) = open_camera(&arguments.camera, &plan)?;
    let options = arguments.stream.options();
    let summary = capture(&mut *camera, &mut *bench, options, &plan, &arguments.output, arguments.resume)?;
    tell(&summary, &arguments.output, arguments.json)?;
    Ok(Outcome::Agreement)
}

/// Captures a plan; reports progress on standard error.
pub fn capture(
    camera: &mut dyn Camera,
    bench: &mut dyn Illuminator,
    options: StreamOptions,
    plan: &Plan,
    root: &Path,
    resume: bool,
) -> Result<Summary> {
    let mut show = Show::new("capture");
    let mut progress = |p: Progress| show.frames(p);
    let mut capture =
        Capture { camera, bench, options, stop: &STOP, progress: Some(&mut progress), shown: None };
    Ok(if resume { capture.resume(root)? } else { capture.run(plan, root)? })
}

/// Prints the result of a capture.
pub fn tell(summary: &Summary, root: &Path, json: bool) -> Result<()> {
    if json {
        let c = summary.counts;
        let left_on: Vec<_> = summary.automatics.iter().filter(|a| !a.off).collect();
        let left_on: Vec<_> =
            left_on.iter().map(|a| serde_json::json!({ "feature": a.feature, "value": a.now })).collect();
        let answer = serde_json::json!({
            "dataset": root,
            "frames": summary.frames,
            "received": c.completed,
            "damaged": c.failures,
            "underruns": c.underruns,
            "missing": c.missing,
            "full_exposure_s": summary.full_exposure_s,
            "left_on": left_on,
        });
        println!("{}", serde_json::to_string_pretty(&answer)?);
        return Ok(());
    }
    println!("{}: {} frames written", root.display(), summary.frames);
    let c = summary.counts;
    let passed = c.completed.saturating_sub(summary.frames);
    let passed = match passed {
        0 => String::new(),
        n => format!(" ({} kept; {n} exposed for the search or to settle, or drawn again)", summary.frames),
    };
    println!(
        "  frames received {}{passed}, damaged and discarded {}, without a free buffer {}, never arrived {}",
        c.completed, c.failures, c.underruns, c.missing
    );
    let still_on: Vec<_> =
        summary.automatics.iter().filter(|a| !a.off).map(|a| format!("{} = {}", a.feature, a.now)).collect();
    if !still_on.is_empty() {
        println!(
            "  could not be switched off: {}; `diagnose` will name it as the first suspect",
            still_on.join(", ")
        );
    }
    Ok(())
}
