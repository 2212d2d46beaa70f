//! `radcam cameras`

use super::Outcome;
use super::common::may_be_written;
use crate::dataset::write_whole;
use anyhow::Result;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Write a report for remote support: description, feature values, registers, lost packets, what a
    /// capture would switch off
    #[arg(long, value_name = "ID", requires = "output")]
    report: Option<String>,
    /// The report, a JSON file
    #[arg(short, long, value_name = "FILE.json", requires = "report")]
    output: Option<PathBuf>,
    /// Write over a report that is there
    #[arg(long, requires = "report")]
    overwrite: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    if let (Some(id), Some(path)) = (&arguments.report, &arguments.output) {
        may_be_written(path, arguments.overwrite)?;
        if id.split_once(':').is_some_and(|(backend, _)| {
            backend != "aravis" && crate::camera::BACKENDS.iter().any(|b| b.name == backend)
        }) {
            anyhow::bail!("{id}: a report is of a camera on the network or on USB, aravis:ID");
        }
        let report = report_of(id.strip_prefix("aravis:").unwrap_or(id))?;
        write_whole(path, serde_json::to_string_pretty(&report)?.as_bytes())?;
        let (features, stream) = (&report["features"], &report["stream"]);
        let count = |part: &str| {
            let says = |f: &&serde_json::Value| f["radcam"].as_str().is_some_and(|r| r.starts_with(part));
            features.as_array().map_or(0, |all| all.iter().filter(says).count())
        };
        if arguments.json {
            println!("{}", serde_json::json!({ "report": path, "stream": stream }));
            return Ok(Outcome::Agreement);
        }
        println!("{}: {} features", path.display(), features.as_array().map_or(0, Vec::len));
        println!(
            "  a capture would set {}, record {}; {} of {} frames came whole, {} damaged, {} missing",
            count("a capture sets"),
            count("recorded"),
            stream["complete"],
            stream["asked"],
            stream["damaged"],
            stream["missing"]
        );
        return Ok(Outcome::Agreement);
    }
    #[cfg(not(feature = "aravis"))]
    tracing::warn!("{}", crate::camera::NO_ARAVIS);
    let rows = crate::camera::list();
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&rows)?);
        return Ok(Outcome::Agreement);
    }
    println!("{:<28} {:<12} {:<16} {:<12} over", "camera", "vendor", "model", "serial");
    for r in rows {
        println!("{:<28} {:<12} {:<16} {:<12} {}", r.camera, r.vendor, r.model, r.serial, r.protocol);
    }
    Ok(Outcome::Agreement)
}

#[cfg(feature = "aravis")]
fn report_of(id: &str) -> Result<serde_json::Value> {
    Ok(crate::camera::aravis::AravisCamera::open(id)?.report())
}

#[cfg(not(feature = "aravis"))]
fn report_of(_: &str) -> Result<serde_json::Value> {
    anyhow::bail!("{}", crate::camera::NO_ARAVIS)
}
