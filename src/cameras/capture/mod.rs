//! Runs a plan on a camera and a bench, and stores the frames.

mod exposure;
mod set;

use crate::bench::{BenchError, Illuminator};
use crate::camera::{Automatic, Camera, CameraError, StreamCounts, StreamOptions, Value};
use crate::dataset::{CameraInfo, Dataset, DatasetError, Folder, Manifest, Writer};
use crate::frame::Frame;
use crate::light::Light;
use crate::pixel_format::PixelFormat;
use crate::plan::{Plan, PlanError};
use exposure::SETTLING;
use serde::{Deserialize, Serialize};
use set::DeviceClock;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Reason why a capture stopped. Data written before stays intact.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// Camera error.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// Bench error.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// Dataset or disk error.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Plan error.
    #[error("plan: {0}")]
    Plan(#[from] PlanError),
    /// Too many damaged frames in one set.
    #[error("set {set}: {damaged} damaged frames for {wanted} wanted ({last}); {advice}")]
    Damaged {
        /// Number of the set.
        set: usize,
        /// Frames discarded.
        damaged: u64,
        /// Frames the plan asks for.
        wanted: u32,
        /// Fault of the last one.
        last: String,
        /// Advice.
        advice: &'static str,
    },
    /// The dataset to be continued belongs to another camera or another plan.
    #[error("cannot continue {path}: {message}")]
    Resume {
        /// Folder.
        path: String,
        /// Differences, or the fault.
        message: String,
    },
    /// The user stopped the capture.
    #[error("interrupted; {frames} frames are kept, continue with --resume")]
    Interrupted {
        /// Frames on disk.
        frames: u64,
    },
}

/// Progress of a capture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Frames on disk.
    pub frames: u64,
    /// Frames of the plan.
    pub of: u64,
    /// Bytes of a frame in memory.
    pub frame_bytes: u64,
    /// Number of the current set.
    pub set: usize,
    /// Sets of the plan.
    pub sets: usize,
}

/// Result of a capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Summary {
    /// Frames written by this run.
    pub frames: u64,
    /// Counts summed over the streams.
    pub counts: StreamCounts,
    /// Automatic functions and their final state.
    pub automatics: Vec<Automatic>,
    /// Exposure that counts as 1, s.
    pub full_exposure_s: Option<f64>,
    /// Device time at the start of the campaign, ns, if known.
    pub zero_ns: Option<i64>,
}

/// Capture of a plan: camera, bench, options and callbacks.
pub struct Capture<'a> {
    /// The camera.
    pub camera: &'a mut dyn Camera,
    /// The bench.
    pub bench: &'a mut dyn Illuminator,
    /// Stream options.
    pub options: StreamOptions,
    /// Flag set from outside to stop after the frame in flight.
    pub stop: &'a AtomicBool,
    /// Callback after each frame.
    pub progress: Option<&'a mut dyn FnMut(Progress)>,
    /// Callback with each frame that is kept.
    pub shown: Option<&'a mut dyn FnMut(&Frame)>,
}

/// Name of the log inside a dataset: one line per run, with the buffer statistics.
pub const LOG_FILE: &str = "capture.log";

/// Name of the plan inside a dataset, with exposures in seconds; a campaign is continued from it.
pub const PLAN_FILE: &str = "plan.toml";

/// State of one run.
struct Run {
    writer: Writer,
    clock: DeviceClock,
    counts: StreamCounts,
    /// Sets that were restarted, one entry per restart.
    begun_again: Vec<usize>,
    /// True if frames on disk are exposed again and discarded, because the camera draws the same ones.
    again: bool,
}

impl Run {
    /// Returns the number of frames of a set on disk.
    fn have(&self, number: usize) -> u32 {
        self.writer.written().iter().filter(|r| r.set as usize == number).count() as u32
    }

    /// Returns the number of a set's first frame within the campaign, and its time, s: the end of the
    /// previous frame's exposure.
    fn start_of(&self, number: usize, plan: &Plan) -> (u64, f64) {
        let settle = u64::from(plan.camera.settle_frames);
        let first = plan.sets[..number].iter().map(|set| u64::from(set.frames) + settle).sum();
        let before = self.writer.written().iter().rev().find(|r| (r.set as usize) < number);
        (first, before.and_then(|r| Some(r.timestamp_s? + r.exposure_s)).unwrap_or(0.0))
    }

    /// Returns the time since the start of the campaign, s, by the computer's clock: the last frame was
    /// written right after its exposure. `None` if there is no such frame or time.
    fn since_the_start(&self, root: &Path) -> Option<f64> {
        let last = self.writer.written().last()?;
        let file = last.file.split('#').next()?;
        let written = std::fs::metadata(root.join(file)).and_then(|m| m.modified()).ok()?;
        // If the clock was set back meanwhile, the pause counts as zero.
        let pause = written.elapsed().unwrap_or_default();
        Some(last.timestamp_s? + last.exposure_s + pause.as_secs_f64())
    }

    /// Returns the log entry of the run. `searched`: full exposure found by the search, s.
    fn log(&self, searched: Option<f64>, frames: u64, outcome: &Result<(), CaptureError>) -> String {
        let mut out = String::new();
        if let Some(full_s) = searched {
            out += &format!(
                "before the first frame: a search for the full exposure up to {full_s} s, then {SETTLING} frames under the first set's light\n"
            );
        }
        for set in &self.begun_again {
            out += &format!(
                "set {set} begun again, its first frame damaged: {SETTLING} frames under the light of the set before\n"
            );
        }
        let StreamCounts { completed, failures, underruns, missing, .. } = self.counts;
        let outcome = outcome.as_ref().map_or_else(ToString::to_string, |()| "done".into());
        out + &format!(
            "completed {completed} failures {failures} underruns {underruns} missing {missing} written {frames} outcome {outcome}\n"
        )
    }
}

/// Stop flag of a capture that nobody stops.
static NEVER: AtomicBool = AtomicBool::new(false);

impl<'a> Capture<'a> {
    /// Creates a capture with the default stream options, without stop flag and callbacks.
    pub fn new(camera: &'a mut dyn Camera, bench: &'a mut dyn Illuminator) -> Self {
        Self { camera, bench, options: StreamOptions::default(), stop: &NEVER, progress: None, shown: None }
    }

    /// Captures a plan into a new folder.
    ///
    /// # Errors
    ///
    /// An error of camera, bench, disk or plan, a set with too many damaged frames, or a stop by the user.
    /// Data written before stays intact, and [`resume`](Self::resume) continues it.
    pub fn run(&mut self, plan: &Plan, root: &Path) -> Result<Summary, CaptureError> {
        self.start(Some(plan), root)
    }

    /// Continues a capture where it stopped, by its own plan.
    ///
    /// # Errors
    ///
    /// As [`run`](Self::run), and if camera or settings are not those of the capture.
    pub fn resume(&mut self, root: &Path) -> Result<Summary, CaptureError> {
        self.start(None, root)
    }

    /// Captures a plan into a new folder, or continues there if none is given.
    fn start(&mut self, plan: Option<&Plan>, root: &Path) -> Result<Summary, CaptureError> {
        let unlisted = self.camera.unlisted_features();
        if !unlisted.is_empty() {
            tracing::warn!(
                features = unlisted.join(", "),
                "radcam does not know what these features do to pixel values; they stay as they are and are recorded"
            );
        }
        let mut counts = StreamCounts::default();
        let resume = plan.is_none();
        let searched = plan.is_some_and(|p| p.full_exposure_s.is_none() && p.needs_full_exposure());
        let (automatics, writer, plan) = match plan {
            None => self.reopen(Folder::existing(root)?, root)?,
            Some(plan) => {
                // Checked before camera and bench are touched: another capture may have begun here.
                let held = Folder::hold(root)?;
                held.must_be_free(root, &[PLAN_FILE])?;
                let automatics = self.set_up(plan)?;
                let plan = self.absolute(plan, &mut counts)?;
                self.begin(held, root, plan, automatics)?
            }
        };
        // The device may have been switched off since, and the length of the pause is unknown.
        let began = !resume || writer.written().is_empty();
        let clock = if began { DeviceClock::FromFirstFrame } else { DeviceClock::Unknown };
        let again = resume && self.camera.draws_again();
        if again && plan.searched {
            self.search(&plan, &mut counts)?;
        }
        let clock = if again { DeviceClock::FromFirstFrame } else { clock };
        let run = Run { writer, clock, counts, begun_again: Vec::new(), again };
        let searched = searched.then(|| plan.full_exposure_s.unwrap_or(0.0));
        self.carry_out(run, &plan, root, automatics, searched)
    }

    /// Sets everything up as for a capture, finds the full exposure of a plan that needs it, and converts
    /// every exposure to seconds. The frames of a campaign can then be announced before it starts.
    ///
    /// # Errors
    ///
    /// An error of the camera, the bench or the plan.
    pub fn ready(&mut self, plan: &Plan) -> Result<Plan, CaptureError> {
        self.set_up(plan)?;
        self.absolute(plan, &mut StreamCounts::default())
    }

    /// Adds the sets of another plan to a complete campaign, under its settings and with its full exposure:
    /// one campaign in order of time. `zero_ns` is the value of its summary, if the camera has run since
    /// without a restart.
    ///
    /// # Errors
    ///
    /// As [`run`](Self::run), and if the folder is not a campaign of this camera.
    pub fn extend(
        &mut self,
        more: &Plan,
        root: &Path,
        zero_ns: Option<i64>,
    ) -> Result<Summary, CaptureError> {
        let path = root.join(PLAN_FILE);
        let fault = |message: String| CaptureError::Resume { path: path.display().to_string(), message };
        let held = Folder::existing(root)?;
        let text = crate::input::settings(&path).map_err(|e| fault(e.to_string()))?;
        let mut plan = Plan::from_toml(&text)?;
        // A campaign with all exposures in seconds has no full exposure: the search finds it.
        let mut counts = StreamCounts::default();
        let more =
            self.absolute(&Plan { full_exposure_s: plan.full_exposure_s, ..more.clone() }, &mut counts)?;
        plan.full_exposure_s = more.full_exposure_s;
        plan.sets.extend(more.sets);
        crate::dataset::write_whole(&path, plan.to_toml()?.as_bytes())?;
        let (automatics, writer, plan) = self.reopen(held, root)?;
        let clock = zero_ns.map_or(DeviceClock::Unknown, DeviceClock::Zero);
        let run = Run { writer, clock, counts, begun_again: Vec::new(), again: false };
        self.carry_out(run, &plan, root, automatics, None)
    }

    /// Captures the missing frames, and writes the log. `searched`: full exposure found by the search, s.
    fn carry_out(
        &mut self,
        mut run: Run,
        plan: &Plan,
        root: &Path,
        automatics: Vec<Automatic>,
        searched: Option<f64>,
    ) -> Result<Summary, CaptureError> {
        let before = run.writer.written().len() as u64;
        if matches!(run.clock, DeviceClock::Unknown) {
            let start = run.writer.written().last().and_then(|r| r.timestamp_s).unwrap_or(0.0);
            // 1000 more than the frames kept: the pilot and damaged frames were drawn too.
            if self.camera.continue_after(before + 1000, start + 1.0) {
                run.clock = DeviceClock::Zero(0);
            } else if let Some(seconds) = run.since_the_start(root) {
                run.clock = DeviceClock::At(seconds, Instant::now());
            }
        }
        let outcome = (0..plan.sets.len()).try_for_each(|number| self.capture_set(number, plan, &mut run));
        let frames = run.writer.written().len() as u64 - before;
        let line = run.log(searched, frames, &outcome);
        tracing::info!(counts = line.trim_end(), "buffer statistics");
        let log = crate::output::append(&root.join(LOG_FILE), true);
        if let Err(e) = log.and_then(|mut log| std::io::Write::write_all(&mut log, line.as_bytes())) {
            tracing::warn!(error = %e, "the buffer statistics could not be kept");
        }
        outcome?;
        // A campaign of pairs is one of EMVA 1288: its descriptor lets the reference tool read it.
        if let Some(path) = crate::dataset::write_descriptor(&Dataset::open(root)?)? {
            tracing::info!(file = %path.display(), "EMVA 1288 descriptor");
        }
        let zero_ns = if let DeviceClock::Zero(zero) = run.clock { Some(zero) } else { None };
        let full_exposure_s = plan.full_exposure_s;
        Ok(Summary { frames, counts: run.counts, automatics, full_exposure_s, zero_ns })
    }

    /// Switches off features that distort radiometry, applies the plan's settings, and switches off features
    /// that these made available. Features named in the plan are set last, whatever they do.
    fn set_up(&mut self, plan: &Plan) -> Result<Vec<Automatic>, CaptureError> {
        let first = self.camera.disable_automatics()?;
        self.settings_of(plan)?;
        let mut automatics = self.camera.disable_automatics()?;
        for a in &mut automatics {
            if let Some(was) = first.iter().find(|f| f.feature == a.feature) {
                a.before.clone_from(&was.before);
            }
        }
        for a in &automatics {
            let (feature, before, now) = (&*a.feature, &*a.before, &*a.now);
            if a.off {
                tracing::info!(feature, before, now, "automatic function is off");
            } else {
                tracing::warn!(feature, now, "automatic function could not be switched off");
            }
        }
        for (name, value) in &plan.camera.features {
            let value = match value {
                toml::Value::Boolean(v) => Value::Bool(*v),
                toml::Value::Integer(v) => Value::Int(*v),
                toml::Value::Float(v) => Value::Float(*v),
                other => Value::Text(other.as_str().map_or_else(|| other.to_string(), Into::into)),
            };
            self.camera.set_feature(name, &value)?;
        }
        Ok(automatics)
    }

    fn settings_of(&mut self, plan: &Plan) -> Result<(), CaptureError> {
        let camera = &mut *self.camera;
        let wanted = &plan.camera;
        let deepest = camera.capabilities().pixel_formats.iter().copied().max_by_key(|f| {
            // The deepest format; of equal ones the one whose bytes need no unpacking.
            (f.bits(), f.bits_per_pixel())
        });
        if let Some(format) = wanted.pixel_format.or(deepest) {
            camera.set_pixel_format(format)?;
        }
        if let Some(region) = wanted.region() {
            let got = camera.set_region(region)?;
            if got != region {
                return Err(self.read_back("region", format!("{region:?}"), format!("{got:?}")).into());
            }
        }
        if let Some(gain) = wanted.gain_db {
            let got = camera.set_gain_db(gain)?;
            if (got - gain).abs() > 0.05 {
                return Err(self.read_back("Gain", format!("{gain} dB"), format!("{got} dB")).into());
            }
        }
        if let Some(level) = wanted.black_level_dn {
            let got = camera.set_black_level_dn(level)?;
            if (got - level).abs() > 0.5 {
                return Err(self.read_back("BlackLevel", format!("{level} DN"), format!("{got} DN")).into());
            }
        }
        if let Some(rate) = wanted.frame_rate_hz {
            camera.set_frame_rate_hz(rate)?;
        }
        Ok(())
    }

    fn read_back(&self, feature: &str, asked: String, got: String) -> CameraError {
        let camera = self.camera.identity().id.clone();
        CameraError::ReadBack { camera, feature: feature.into(), asked, got }
    }

    fn manifest(&mut self, plan: &Plan, automatics: &[Automatic]) -> Result<Manifest, CaptureError> {
        let settings = self.camera.settings()?;
        let mut features: BTreeMap<String, Value> = self.camera.features();
        for a in automatics {
            features.insert(a.feature.clone(), Value::Text(a.now.clone()));
        }
        // Features of the plan were set last, and read back then.
        for (name, value) in &plan.camera.features {
            features.insert(
                name.clone(),
                Value::Text(value.as_str().map_or_else(|| value.to_string(), Into::into)),
            );
        }
        let unlisted_features = self.camera.unlisted_features();
        let identity = self.camera.identity();
        let mut manifest = Manifest::new(CameraInfo {
            unlisted_features,
            still_automatic: automatics.iter().filter(|a| !a.off).map(|a| a.feature.clone()).collect(),
            features: features.into_iter().map(|(name, value)| (name, value.into())).collect(),
            ..settings.info(identity)
        });
        manifest.bench = self.bench.info();
        let flux = self.camera.photon_flux_per_s();
        let own = flux.map(|flux| Light { photon_flux_per_s: Some(flux), ..Default::default() });
        if let Some(bench) = &mut manifest.bench {
            bench.light = plan.light.or(own);
        }
        Ok(manifest)
    }

    /// Starts a dataset for a plan whose exposures are in seconds.
    fn begin(
        &mut self,
        held: Folder,
        root: &Path,
        plan: Plan,
        automatics: Vec<Automatic>,
    ) -> Result<(Vec<Automatic>, Writer, Plan), CaptureError> {
        let manifest = self.manifest(&plan, &automatics)?;
        let writer = Writer::create_in(held, root, &manifest, &[(PLAN_FILE, &plan.to_toml()?)])?;
        Ok((automatics, writer, plan))
    }

    /// Opens a dataset to be continued and brings the camera to its settings.
    fn reopen(&mut self, held: Folder, root: &Path) -> Result<(Vec<Automatic>, Writer, Plan), CaptureError> {
        let fault = |message: String| CaptureError::Resume { path: root.display().to_string(), message };
        let plan_path = root.join(PLAN_FILE);
        let text =
            crate::input::settings(&plan_path).map_err(|e| fault(format!("{}: {e}", plan_path.display())))?;
        let mut plan = Plan::from_toml(&text)?;
        // Interrupted after the plan and before the manifest, which is written last.
        if !root.join("dataset.toml").exists() {
            let automatics = self.set_up(&plan)?;
            return self.begin(held, root, plan, automatics);
        }
        let (writer, manifest) = Writer::resume_in(held, root)?;
        let was = &manifest.camera;
        let identity = self.camera.identity();
        for (name, now, was) in [
            ("vendor", &identity.vendor, &was.vendor),
            ("model", &identity.model, &was.model),
            ("serial", &identity.serial, &was.serial),
        ] {
            if now != was {
                return Err(fault(format!(
                    "it was taken with {name} \"{was}\", and this camera has \"{now}\""
                )));
            }
        }
        plan.camera.pixel_format = PixelFormat::from_name(&was.pixel_format).ok();
        plan.camera.gain_db = plan.camera.gain_db.or(was.gain_db);
        plan.camera.black_level_dn = plan.camera.black_level_dn.or(was.black_level_dn);
        let automatics = self.set_up(&plan)?;
        let region = self.camera.settings()?.region;
        if (region.width as usize, region.height as usize) != (was.width, was.height) {
            return Err(fault(format!(
                "its frames are {} x {} px, and the camera gives {} x {} px",
                was.width, was.height, region.width, region.height
            )));
        }
        // After a power cycle, settings that the plan does not name may have changed.
        let now = self.manifest(&plan, &automatics)?;
        let differs = manifest.differences(&now);
        if !differs.is_empty() {
            return Err(fault(format!("{}; set it back, or begin a new campaign", differs.join("; "))));
        }
        Ok((automatics, writer, plan))
    }
}
