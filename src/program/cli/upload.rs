//! `radcam upload`

use super::Outcome;
use super::common::{STOP, above_0};
use crate::calibrate::file::Calibration;
use crate::upload::{Map, Options, upload};
use anyhow::Result;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The calibration file
    #[arg(value_name = "CAL.tiff")]
    cal: PathBuf,
    /// aravis:ID; `radcam cameras` lists them
    #[arg(long, value_name = "ID")]
    camera: String,
    /// Exposure for which the offsets are to hold, s [default: the one at which the camera stands]
    #[arg(long, value_parser = above_0)]
    exposure_s: Option<f64>,
    /// Keep tables that a camera would lose when it is switched off
    #[arg(long)]
    save: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let calibration = Calibration::read(&arguments.cal)?;
    let mut camera = crate::camera::open(&arguments.camera)?;
    let terminal = std::io::stderr().is_terminal();
    let mut shown = 0;
    let mut go_on = |share: f64| {
        let percent = (100.0 * share) as u32;
        if terminal && percent != shown {
            shown = percent;
            eprint!("\r\x1b[Kwriting and reading back: {percent} %");
        }
        !STOP.load(Ordering::Relaxed)
    };
    let options = Options { exposure_s: arguments.exposure_s, save: arguments.save };
    let done = upload(&mut *camera, &calibration, options, &mut go_on);
    if terminal {
        eprint!("\r\x1b[K");
    }
    let done = done?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&done)?);
        return Ok(Outcome::Agreement);
    }
    println!(
        "{}: corrects its frames itself from now on, at {} s; {} DN is 0 DN above the dark reference",
        camera.identity(),
        crate::number::six_digits(done.exposure_s),
        done.black_dn
    );
    let title = |map: Map| match map {
        Map::FlatField => "flat field",
        Map::Defects => "defects",
    };
    for written in &done.written {
        println!(
            "  {:<11} {}: {} entries, read back the same",
            title(written.map),
            written.memory,
            written.entries
        );
        println!("  {:<11} {}", "", written.switched_on.join(", "));
        for remark in &written.remarks {
            println!("  {:<11} {remark}", "");
        }
    }
    for map in &done.without {
        println!("  {:<11} the camera has no memory for it that radcam can write", title(*map));
    }
    println!(
        "`radcam capture` and `radcam stream` switch this off again, since they measure and correct raw frames."
    );
    Ok(Outcome::Agreement)
}
