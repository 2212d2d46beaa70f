//! `radcam cameras`

use super::Outcome;
use anyhow::Result;
use radcam_sim::{Model, sensors};
use serde::Serialize;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Row {
    camera: String,
    vendor: String,
    model: String,
    serial: String,
    protocol: String,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let mut rows = real();
    for (name, text) in sensors::ALL {
        let model = Model::from_toml(text)?;
        rows.push(Row {
            camera: format!("sim:{name}"),
            vendor: model.camera.vendor,
            model: model.camera.model,
            serial: format!("SIM{}", model.base.seed),
            protocol: "simulated".into(),
        });
    }
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
fn real() -> Vec<Row> {
    crate::camera::aravis::list()
        .into_iter()
        .map(|d| Row {
            camera: format!("aravis:{}", if d.protocol.starts_with("GigE") { d.address } else { d.id }),
            vendor: d.vendor,
            model: d.model,
            serial: d.serial,
            protocol: d.protocol,
        })
        .collect()
}

#[cfg(not(feature = "aravis"))]
fn real() -> Vec<Row> {
    tracing::warn!("{}", super::common::NO_ARAVIS);
    Vec::new()
}
