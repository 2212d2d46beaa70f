//! `radcam serve`

use super::Outcome;
use anyhow::Result;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A sensor (xc77, cmos12, ccd16, imx250...; `radcam cameras` lists them) or a model file
    sensor: String,
    /// IPv4 address of the network interface to answer on
    #[arg(long, default_value = "127.0.0.1")]
    interface: std::net::Ipv4Addr,
    /// Serial number of the camera
    #[arg(long, default_value = "SIM1")]
    serial: String,
    /// Another specimen of the same camera: seed of its maps and its noise
    #[arg(long)]
    seed: Option<u64>,
    /// Names of exposure, gain and black level: those of SFNC 2, or what older cameras have
    #[cfg(feature = "aravis")]
    #[arg(long, value_enum, default_value = "current")]
    feature_names: crate::serve::Names,
    /// A feature that is stuck at a value, such as Gamma=0.6 (Gamma, LUTEnable, SharpeningEnable,
    /// DefectCorrectStaticEnable, FlatFieldCorrectionMode, TestPattern, BinningHorizontal, BinningVertical);
    /// may be given several times
    #[arg(long, value_name = "NAME=VALUE")]
    stuck: Vec<String>,
    /// Share of its packets that the camera loses, 0 to 1
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    lose_packets: f64,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// End when standard input does
    #[arg(long, hide = true)]
    while_stdin: bool,
}

/// Parses a number from 0 to 1.
fn share(text: &str) -> Result<f64, String> {
    let share = text.parse().ok().filter(|s| (0.0..=1.0).contains(s));
    share.ok_or_else(|| "write a number from 0 to 1".into())
}

#[cfg(feature = "aravis")]
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    use super::common::{STOP, heard, load_model};
    use std::io::{Read, Write};
    use std::sync::atomic::Ordering;

    let sensor = radcam_sim::Sensor::new(load_model(&arguments.sensor, arguments.seed)?)?;
    let stuck = arguments.stuck.iter().map(|text| {
        let pair = text.split_once('=').map(|(name, value)| (name.trim().into(), value.trim().into()));
        pair.ok_or_else(|| anyhow::anyhow!("--stuck {text}: write NAME=VALUE, such as Gamma=0.6"))
    });
    let options =
        crate::serve::Options { names: arguments.feature_names, stuck: stuck.collect::<Result<_>>()? };
    let served = crate::serve::serve(sensor.into(), arguments.interface.into(), &arguments.serial, &options)?;
    served.set_lost_packets(arguments.lose_packets.clamp(0.0, 1.0));
    let (sensor, interface, serial) = (&arguments.sensor, arguments.interface, &arguments.serial);
    if arguments.json {
        let answer = serde_json::json!({
            "sensor": sensor, "serial": serial, "interface": interface, "camera": format!("aravis:{interface}"),
        });
        println!("{answer}");
    } else {
        println!("serving {sensor} as {serial} over GigE Vision on {interface}; Ctrl-C ends");
    }
    std::io::stdout().flush()?;
    if arguments.while_stdin {
        std::thread::spawn(|| {
            let _ = std::io::stdin().read_to_end(&mut Vec::new());
            STOP.store(true, Ordering::SeqCst);
        });
    }
    while !STOP.load(Ordering::SeqCst) {
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    heard();
    if served.refused() > 0 {
        tracing::warn!(
            requests = served.refused(),
            "control requests were malformed or not allowed, and were refused"
        );
    }
    Ok(Outcome::Agreement)
}

#[cfg(not(feature = "aravis"))]
pub fn run(_arguments: &Arguments) -> Result<Outcome> {
    anyhow::bail!("serve: {}", crate::camera::NO_ARAVIS)
}
