//! `radcam monitor`

use super::Outcome;
use super::common::{STOP, above_0, heard, load_plan, seconds};
use crate::bench;
use crate::calibrate::file::Calibration;
use crate::camera::{self, Camera, CameraError, StreamOptions};
use crate::capture::Capture;
use crate::monitor::keeper::Keeper;
use crate::monitor::metrics::{Metrics, serve};
use crate::monitor::store::Store;
use crate::monitor::{Alarm, Check, Limits, Monitor, Plan, TakeError, take};
use crate::number::six_digits;
use crate::source::Source;
use crate::stream::prepare;
use anyhow::{Context, Result, bail};
use sha2::{Digest, Sha256};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// aravis:ID or sim:SENSOR; `radcam cameras` lists them
    #[arg(long, value_name = "ID")]
    camera: String,
    /// The calibration file
    #[arg(long, value_name = "CAL.tiff")]
    cal: PathBuf,
    /// History: a SQLite file, or postgres://USER@HOST/DATABASE with the password in PGPASSWORD or ~/.pgpass;
    /// @FILE or env:NAME hold the whole address; nothing is kept where not given
    #[arg(long, value_name = "URL")]
    store: Option<String>,
    /// A plan whose [bench] names the features that move the light
    #[arg(long, value_name = "PLAN.toml")]
    plan: Option<String>,
    /// Seconds from the start of one check to that of the next
    #[arg(long, value_parser = seconds, default_value = "60")]
    every: Duration,
    /// End after so many checks
    #[arg(long)]
    checks: Option<u64>,
    /// Frames of each kind in a check: short darks, long darks, reference flat
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u64).range(2..=10_000))]
    frames: u64,
    /// Exposure of the reference flat, s [default: that of the calibration's dark reference]
    #[arg(long, value_parser = above_0)]
    exposure_s: Option<f64>,
    /// Light of the reference flat
    #[arg(long, value_parser = above_0, default_value = "1")]
    illumination: f64,
    /// Change of the gain that matters, relative
    #[arg(long, value_parser = above_0, default_value = "0.01")]
    gain_limit: f64,
    /// Change of the black level that matters, DN
    #[arg(long, value_parser = above_0, default_value = "0.5")]
    black_limit_dn: f64,
    /// Change of the light that matters, relative
    #[arg(long, value_parser = above_0, default_value = "0.02")]
    light_limit: f64,
    /// After an alarm capture the standard plan into a folder of its own in here, and name what the model
    /// lacks
    #[arg(long, value_name = "DIR")]
    diagnose: Option<PathBuf>,
    /// The model that the camera had; otherwise the linear sensor
    #[arg(long, value_name = "M.toml", requires = "diagnose")]
    model: Option<PathBuf>,
    /// Answer Prometheus at this address, such as 127.0.0.1:9464, path /metrics
    #[arg(long, value_name = "ADDRESS")]
    metrics: Option<SocketAddr>,
    /// Print a JSON object for each check
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let bytes = crate::input::bytes(&arguments.cal).with_context(|| arguments.cal.display().to_string())?;
    let calibration = Calibration::read(&arguments.cal)?;
    // Checks are compared only under the same calibration, exposure and light.
    let mut digest = Sha256::new_with_prefix(&bytes);
    digest.update(format!("{:?} {}", arguments.exposure_s, arguments.illumination));
    let hash: String = digest.finalize().iter().take(8).map(|b| format!("{b:02x}")).collect();
    let limits = Limits {
        gain: arguments.gain_limit,
        black_level_dn: arguments.black_limit_dn,
        signal: arguments.light_limit,
        ..Limits::default()
    };
    let serial = &calibration.description.camera.serial;
    let name = if serial.is_empty() { arguments.camera.clone() } else { serial.clone() };
    let address = arguments.store.as_deref().map(super::secret::database).transpose()?;
    let (mut monitor, keeper) = history(address.as_deref(), &name, &hash, limits)?;
    let metrics = Arc::new(Metrics::default());
    if let Some(address) = arguments.metrics {
        let bound = serve(address, Arc::clone(&metrics)).with_context(|| format!("--metrics {address}"))?;
        if !arguments.json {
            println!("metrics at http://{bound}/metrics");
        }
    }
    let (mut taken, mut alarms) = (0u64, 0);
    let plan = load_plan(Some(arguments.plan.as_deref().unwrap_or("standard")), false, Path::new("."))?;
    let mut job = Job { arguments, calibration: &calibration, camera: None, plan, told: false };
    if !arguments.json {
        let known = monitor.history().len();
        println!(
            "{name}: a check every {} s, {known} in the history; Ctrl-C ends",
            six_digits(arguments.every.as_secs_f64())
        );
    }
    while !STOP.load(Ordering::Relaxed) && arguments.checks.is_none_or(|n| taken < n) {
        let begun = Instant::now();
        let check = match job.take() {
            Ok(check) => check,
            // A camera that is absent now may return by the next check.
            Err(TakeError::Stopped) => break,
            Err(
                e @ (TakeError::Damaged { .. }
                | TakeError::Camera(
                    CameraError::Lost { .. } | CameraError::Timeout { .. } | CameraError::Absent { .. },
                )),
            ) if taken > 0 => {
                tracing::warn!(error = %e, "no check");
                job.camera = None;
                wait(begun, arguments.every);
                continue;
            }
            Err(e) => return Err(e.into()),
        };
        taken += 1;
        // Differences at the first check are not drift: the camera already differs from its calibration.
        let differs = if taken == 1 { check.against(&calibration, &limits) } else { Vec::new() };
        alarms += differs.len();
        let found = monitor.add(check.clone());
        alarms += found.len();
        metrics.take(&name, &check, &found);
        let verdict = match &arguments.diagnose {
            Some(root) if !found.is_empty() => Some(job.diagnose(root, check.time_s)),
            _ => None,
        };
        let told = tell(arguments.json, &name, &check, (&found, &differs), verdict.as_deref(), &monitor);
        // Report first: an unreachable database must not cost an alarm.
        if let Some(keeper) = &keeper {
            keeper.keep(check, found);
        }
        told?;
        if arguments.checks.is_none_or(|n| taken < n) {
            wait(begun, arguments.every);
        }
    }
    if let Some(keeper) = keeper {
        if STOP.load(Ordering::Relaxed) {
            heard();
        }
        let patience = if STOP.load(Ordering::Relaxed) { AT_A_STOP } else { AT_THE_END };
        keeper.finish(patience).map_err(anyhow::Error::msg)?;
    }
    Ok(if alarms == 0 { Outcome::Agreement } else { Outcome::Disagreement })
}

/// Time limits for an unreachable database: at the start, at the end, and if the program must stop at once.
const AT_THE_START: Duration = Duration::from_secs(60);
const AT_THE_END: Duration = Duration::from_secs(90);
const AT_A_STOP: Duration = Duration::from_millis(700);

/// Restores the monitor after the last stored check, and starts the keeper of the next ones.
fn history(url: Option<&str>, name: &str, hash: &str, limits: Limits) -> Result<(Monitor, Option<Keeper>)> {
    let Some(url) = url else { return Ok((Monitor::new(limits), None)) };
    let begun = Instant::now();
    let mut said = false;
    loop {
        let opened = Store::open(url).and_then(|store| Ok((store.monitor(name, hash, limits)?, store)));
        match opened {
            Ok((monitor, store)) => return Ok((monitor, Some(Keeper::start(store, name, hash)))),
            Err(e) if e.is_passing() && begun.elapsed() < AT_THE_START && !STOP.load(Ordering::Relaxed) => {
                if !std::mem::replace(&mut said, true) {
                    tracing::warn!(error = %e, "waiting for the history");
                }
                wait(Instant::now(), Duration::from_secs(1));
            }
            Err(e) => return Err(e.into()),
        }
    }
}

fn wait(begun: Instant, every: Duration) {
    while begun.elapsed() < every && !STOP.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(20).min(every));
    }
}

struct Job<'a> {
    arguments: &'a Arguments,
    calibration: &'a Calibration,
    camera: Option<Box<dyn Camera>>,
    /// Plan whose bench controls the light.
    plan: crate::plan::Plan,
    /// Set once the settings that the calibration does not state were reported.
    told: bool,
}

impl Job<'_> {
    fn take(&mut self) -> Result<Check, TakeError> {
        let a = self.arguments;
        if self.camera.is_none() {
            let mut camera = camera::open(&a.camera)?;
            prepare(&mut *camera, self.calibration, None)?;
            if !std::mem::replace(&mut self.told, true) {
                let now = camera::info(&mut *camera)?;
                for text in super::correct::unknown(&self.calibration.description.camera, &now) {
                    tracing::warn!("{}: {text}", a.camera);
                }
            }
            self.camera = Some(camera);
        }
        let Some(camera) = &mut self.camera else { unreachable!("it was opened above") };
        let mut bench = bench::of(&mut **camera, &self.plan);
        if !bench.moves_itself() {
            let message = "a check needs a light that can be switched by a feature of the camera: name it under [bench] in a plan, \
                           and give that with --plan";
            return Err(bench::BenchError::Operator(message.into()).into());
        }
        let exposure_s = a.exposure_s;
        let plan = Plan { exposure_s, frames: a.frames, illumination: a.illumination, ..Plan::default() };
        take(&mut **camera, &mut *bench, self.calibration, &plan, &StreamOptions::default(), &STOP)
    }

    /// Captures a campaign and returns its verdict, or the reason of a failure.
    fn diagnose(&mut self, root: &Path, time_s: f64) -> String {
        let root = root.join(format!("{time_s:.3}"));
        let mut work = || -> Result<String> {
            let known = super::model::read_effects(self.arguments.model.as_deref())?;
            let Some(camera) = &mut self.camera else { return Ok(String::new()) };
            let mut bench = bench::of(&mut **camera, &self.plan);
            let plan = crate::plan::Plan { bench: self.plan.bench.clone(), ..crate::plan::Plan::standard() };
            Capture { stop: &STOP, ..Capture::new(&mut **camera, &mut *bench) }.run(&plan, &root)?;
            let found = Source::open(&root)?.diagnose(&known)?;
            Ok(found.verdict.sentence().to_string())
        };
        let said = work().unwrap_or_else(|e| format!("no diagnosis: {e:#}"));
        format!("{} ({})", said, root.display())
    }
}

fn tell(
    json: bool,
    name: &str,
    check: &Check,
    (alarms, differs): (&[Alarm], &[String]),
    verdict: Option<&str>,
    monitor: &Monitor,
) -> Result<()> {
    if json {
        let learning = monitor.learning();
        let needed = monitor.checks_needed();
        let answer = serde_json::json!({
            "camera": name, "check": check, "alarms": alarms, "verdict": verdict, "learning": learning,
            "checks_needed": needed, "against_calibration": differs,
        });
        println!("{answer}");
        return Ok(());
    }
    for text in differs {
        println!(
            "NOT AS CALIBRATED {name}: {text}: another camera, other settings, or a calibration that holds no more"
        );
    }
    for alarm in alarms {
        println!("ALARM {name}: {}", alarm.sentence);
    }
    if let Some(verdict) = verdict {
        println!("{}", super::common::wrapped(verdict, 2));
    }
    if alarms.is_empty() {
        let learning = monitor.learning().len();
        let state =
            if learning > 0 { format!("learning {learning} of its usual values") } else { "as usual".into() };
        println!("{} check {}: {state}", crate::monitor::clock(check.time_s), monitor.history().len());
    }
    if monitor.history().len() == 1 && check.readings.is_empty() {
        bail!("the check read nothing: no light, and no dark");
    }
    Ok(())
}
