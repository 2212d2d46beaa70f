//! `radcam stream`

use super::Outcome;
use super::common::{STOP, above_0, codes, heard, seconds};
use crate::calibrate::file::Calibration;
use crate::camera;
use crate::correct::{Codes, Corrector};
use crate::stream::{Files, Options, Sink, Summary, meaning, prepare, run as correct};
use anyhow::Result;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Length of the disk queue, corrected frames.
const WAITING: usize = 16;
/// Interval between plain lines of progress.
const LINE_EVERY: Duration = Duration::from_secs(10);

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// aravis:ID, sim:SENSOR or replay:DATASET; `radcam cameras` lists them
    #[arg(long, value_name = "ID")]
    camera: String,
    /// The calibration file
    #[arg(long, value_name = "CAL.tiff")]
    cal: PathBuf,
    /// Write corrected frames into this new folder
    #[arg(long, value_name = "DIR")]
    to: Option<PathBuf>,
    /// Offer corrected frames as a GigE Vision camera of this serial number
    #[arg(long, value_name = "SERIAL")]
    serve_as: Option<String>,
    /// IPv4 address of the network interface to offer them on
    #[arg(long, default_value = "127.0.0.1", requires = "serve_as")]
    interface: std::net::Ipv4Addr,
    /// 16-bit codes, SCALE times DN plus OFFSET; otherwise codes are the camera's own: one for a DN, its
    /// black level, none above its full scale
    #[arg(long, value_name = "SCALE,OFFSET", value_parser = codes)]
    codes: Option<Codes>,
    /// Replace hot, dead and unstable pixels of the calibration by the mean of the nearest sound ones
    #[arg(long)]
    replace_defects: bool,
    /// Go on although frames are darker than the dark reference, which no light makes
    #[arg(long)]
    force: bool,
    /// Exposure, s [default: the one at which the camera stands]
    #[arg(long, value_parser = above_0)]
    exposure_s: Option<f64>,
    /// Packet size, bytes [default: the largest that passes]
    #[arg(long, value_name = "BYTES")]
    packet_size: Option<u32>,
    /// Nothing: packets of the packet socket cannot be checked before Aravis sees them
    #[arg(long, hide = true)]
    packet_socket: bool,
    /// End after so many frames
    #[arg(long)]
    frames: Option<u64>,
    /// End after so many seconds
    #[arg(long, value_parser = seconds)]
    seconds: Option<Duration>,
    /// Give a lost camera up after so many seconds [default: never]
    #[arg(long, value_parser = seconds, value_name = "SECONDS")]
    patience: Option<Duration>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let calibration = Calibration::read(&arguments.cal)?;
    let mut options = Options {
        codes: arguments.codes,
        replace_defects: arguments.replace_defects,
        force: arguments.force,
        exposure_s: arguments.exposure_s,
        frames: arguments.frames,
        duration: arguments.seconds,
        patience: arguments.patience.unwrap_or(Duration::MAX),
        ..Options::default()
    };
    options.stream.packet_size = arguments.packet_size;
    if arguments.packet_socket {
        tracing::warn!("--packet-socket: the ordinary socket is used, before which packets can be checked");
    }
    // Read identity and exposure before frames are offered to clients.
    let (identity, settings) = {
        let mut camera = camera::open(&arguments.camera)?;
        let settings = prepare(&mut *camera, &calibration, arguments.exposure_s)?;
        for text in super::correct::unknown(&calibration.description.camera, &camera::info(&mut *camera)?) {
            tracing::warn!("{}: {text}", arguments.camera);
        }
        (camera.identity().clone(), settings)
    };
    let corrector = Corrector::new(&calibration, settings.exposure_s)?;
    let (codes, _) = meaning(&calibration, &corrector, &options);
    let mut sinks: Vec<Box<dyn Sink>> = Vec::new();
    if let Some(root) = &arguments.to {
        let description = super::correct::description(&arguments.cal, Some(codes), &corrector);
        sinks.push(Box::new(Files::create(root, &description, WAITING)?));
    }
    if let Some(serial) = &arguments.serve_as {
        sinks.push(relay(arguments, serial, &identity, &settings)?);
    }
    if !arguments.json {
        let where_to = match (&arguments.to, &arguments.serve_as) {
            (None, None) => ", measured only: --to writes them, --serve-as offers them".to_string(),
            (to, serial) => {
                let to = to.as_ref().map(|d| format!(", written to {}", d.display())).unwrap_or_default();
                let by = |s: &String| format!(", offered as {s} on {}", arguments.interface);
                to + &serial.as_ref().map(by).unwrap_or_default()
            }
        };
        println!(
            "{identity}: frames of {} s corrected, {}; {} code(s) per DN, {} at 0 DN{where_to}; Ctrl-C ends",
            crate::number::six_digits(settings.exposure_s),
            calibration.description.correction(),
            codes.scale,
            codes.offset
        );
    }
    let mut show = Show { last: Instant::now(), terminal: std::io::stderr().is_terminal() };
    let mut open = || camera::open(&arguments.camera);
    let mut tell = |summary: &Summary| {
        if STOP.load(Ordering::Relaxed) {
            heard();
        }
        show.tell(summary);
    };
    let summary = correct(&mut open, &calibration, &options, &mut sinks, &mut tell, &STOP)?;
    show.end();
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&summary)?);
    } else {
        print(&summary);
    }
    Ok(if summary.is_whole() { Outcome::Agreement } else { Outcome::Disagreement })
}

#[cfg(feature = "aravis")]
fn relay(
    arguments: &Arguments,
    serial: &str,
    identity: &camera::Identity,
    settings: &camera::Settings,
) -> Result<Box<dyn Sink>> {
    use crate::pixel_format::PixelFormat;
    let format = settings.pixel_format;
    let mosaic = format.name().get(..7).filter(|_| format.is_mosaic());
    let format = match (arguments.codes, mosaic) {
        (None, _) => format.unpacked(),
        (Some(_), Some(mosaic)) => PixelFormat::from_name(&format!("{mosaic}16"))?,
        (Some(_), None) => PixelFormat::MONO16,
    };
    let interface = arguments.interface.into();
    Ok(Box::new(crate::serve::relay::Relay::start(interface, serial, identity, settings, format)?))
}

#[cfg(not(feature = "aravis"))]
fn relay(_: &Arguments, _: &str, _: &camera::Identity, _: &camera::Settings) -> Result<Box<dyn Sink>> {
    anyhow::bail!("--serve-as: {}", camera::NO_ARAVIS)
}

/// Formats the state of the stream in one line.
fn line(s: &Summary) -> String {
    let latency = s.latency.map(|l| format!(", latency {:.1} ms", l.median_ms)).unwrap_or_default();
    let lost = s.received.lost() + s.sinks.values().map(|s| s.dropped).sum::<u64>();
    format!(
        "{} frames, {:.1} a second, {:.0} MB/s{latency}, {lost} lost, mean {:.1} DN",
        s.corrected,
        s.frames_per_s,
        s.bytes_per_s * 1e-6,
        s.mean_dn
    )
}

/// Progress display on standard error.
struct Show {
    last: Instant,
    terminal: bool,
}

impl Show {
    fn tell(&mut self, s: &Summary) {
        if self.terminal {
            eprint!("\r\x1b[K{}", line(s));
        } else if self.last.elapsed() >= LINE_EVERY {
            self.last = Instant::now();
            eprintln!("stream: {}", line(s));
        }
    }

    fn end(&self) {
        if self.terminal {
            eprint!("\r\x1b[K");
        }
    }
}

fn print(s: &Summary) {
    println!("{}", line(s));
    let r = s.received;
    println!(
        "  received     {} whole, {} damaged, {} dropped, {} without a buffer, {} missing",
        r.completed, r.failures, r.dropped, r.underruns, r.missing
    );
    if s.reconnections > 0 {
        println!(
            "  camera       lost and found again {} times, {:.1} s without it",
            s.reconnections, s.away_s
        );
    }
    if let Some(l) = s.latency {
        println!(
            "  latency      median {:.2} ms, 99 % below {:.2} ms, worst {:.2} ms, from the first packet to the corrected frame",
            l.median_ms, l.p99_ms, l.worst_ms
        );
    }
    for (name, sink) in &s.sinks {
        println!("  {name:<12} {} frames, {} dropped", sink.taken, sink.dropped);
    }
}
