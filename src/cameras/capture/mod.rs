//! Runs a plan on a camera and a bench, and keeps what comes.

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

/// Why a capture stopped. What was written before stays whole.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// The camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The bench.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// The disk.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The plan.
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
        /// What was wrong with the last one.
        last: String,
        /// What to do.
        advice: &'static str,
    },
    /// The dataset to be continued is not of this camera or this plan.
    #[error("cannot continue {path}: {message}")]
    Resume {
        /// The folder.
        path: String,
        /// What differs.
        message: String,
    },
    /// The user asked for the end.
    #[error("interrupted; {frames} frames are kept, continue with --resume")]
    Interrupted {
        /// Frames on disk.
        frames: u64,
    },
}

/// How far a capture is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Frames on disk.
    pub frames: u64,
    /// Frames of the plan.
    pub of: u64,
    /// Bytes of a frame in memory.
    pub frame_bytes: u64,
    /// Set at work.
    pub set: usize,
    /// Sets of the plan.
    pub sets: usize,
}

/// What a capture did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Summary {
    /// Frames written now.
    pub frames: u64,
    /// Sums over the streams.
    pub counts: StreamCounts,
    /// Automatic functions and what became of them.
    pub automatics: Vec<Automatic>,
    /// Exposure that counts as 1, s.
    pub full_exposure_s: Option<f64>,
    /// Device time at the start of the campaign, ns, where it is known.
    pub zero_ns: Option<i64>,
}

/// Everything that is done around the frames.
pub struct Capture<'a> {
    /// The camera.
    pub camera: &'a mut dyn Camera,
    /// The bench.
    pub bench: &'a mut dyn Illuminator,
    /// Stream options.
    pub options: StreamOptions,
    /// Set from outside to stop after the frame in flight.
    pub stop: &'a AtomicBool,
    /// Told after each frame.
    pub progress: Option<&'a mut dyn FnMut(Progress)>,
    /// Shown each frame that is kept.
    pub shown: Option<&'a mut dyn FnMut(&Frame)>,
}

/// Name of the log inside a dataset: one line a run, with the buffer statistics.
pub const LOG_FILE: &str = "capture.log";

/// Name of the plan inside a dataset, exposures in seconds, by which it is continued.
pub const PLAN_FILE: &str = "plan.toml";

/// The state of one run.
struct Run {
    writer: Writer,
    clock: DeviceClock,
    counts: StreamCounts,
    /// Sets that were begun again, once for each time.
    begun_again: Vec<usize>,
    /// Frames that are on disk are exposed again and discarded: the camera draws the same ones.
    again: bool,
}

impl Run {
    /// Frames of a set that are on disk.
    fn have(&self, number: usize) -> u32 {
        self.writer.written().iter().filter(|r| r.set as usize == number).count() as u32
    }

    /// Number of the first frame of a set within the campaign, and its time, s: after the exposure of the
    /// frame before.
    fn start_of(&self, number: usize, plan: &Plan) -> (u64, f64) {
        let settle = u64::from(plan.camera.settle_frames);
        let first = plan.sets[..number].iter().map(|set| u64::from(set.frames) + settle).sum();
        let before = self.writer.written().iter().rev().find(|r| (r.set as usize) < number);
        (first, before.and_then(|r| Some(r.timestamp_s? + r.exposure_s)).unwrap_or(0.0))
    }

    /// Time since the campaign's start by the computer's clock: the last frame was written right after its
    /// exposure. `None` where there is none.
    fn since_the_start(&self, root: &Path) -> Option<f64> {
        let last = self.writer.written().last()?;
        let file = last.file.split('#').next()?;
        let written = std::fs::metadata(root.join(file)).and_then(|m| m.modified()).ok()?;
        // A clock that was set back meanwhile: the pause counts as none.
        let pause = written.elapsed().unwrap_or_default();
        Some(last.timestamp_s? + last.exposure_s + pause.as_secs_f64())
    }

    /// What is kept of it beside the frames. `searched`: the full exposure that was searched for, s.
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

/// Of a capture that nobody stops.
static NEVER: AtomicBool = AtomicBool::new(false);

impl<'a> Capture<'a> {
    /// With the usual stream options, uninterrupted and without a word.
    pub fn new(camera: &'a mut dyn Camera, bench: &'a mut dyn Illuminator) -> Self {
        Self { camera, bench, options: StreamOptions::default(), stop: &NEVER, progress: None, shown: None }
    }

    /// Captures a plan into a new folder.
    ///
    /// # Errors
    ///
    /// What camera, bench, disk or plan refuse, a set with too many damaged frames, or that it was stopped.
    /// What was written before stays whole, and [`resume`](Self::resume) goes on with it.
    pub fn run(&mut self, plan: &Plan, root: &Path) -> Result<Summary, CaptureError> {
        self.start(Some(plan), root)
    }

    /// Goes on with a capture where it stopped, by its own plan.
    ///
    /// # Errors
    ///
    /// As [`run`](Self::run), and where camera or settings are not those of the capture.
    pub fn resume(&mut self, root: &Path) -> Result<Summary, CaptureError> {
        self.start(None, root)
    }

    /// Captures a plan into a new folder, or goes on there where none is given.
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
                // Before the camera moves: another capture may have begun here.
                let held = Folder::hold(root)?;
                held.must_be_free(root, &[PLAN_FILE])?;
                let automatics = self.set_up(plan)?;
                let plan = self.absolute(plan, &mut counts)?;
                self.begin(held, root, plan, automatics)?
            }
        };
        // The device may have been switched off since, and how long the pause was is not known.
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

    /// Finds the full exposure of a plan that needs it, with everything as a capture has it, and gives every
    /// exposure in seconds: what a campaign will take can then be said before it starts.
    ///
    /// # Errors
    ///
    /// What the camera, the bench or the plan refuse.
    pub fn ready(&mut self, plan: &Plan) -> Result<Plan, CaptureError> {
        self.set_up(plan)?;
        self.absolute(plan, &mut StreamCounts::default())
    }

    /// Adds the sets of another plan to a campaign that is complete, under its settings and with its full
    /// exposure: one campaign in the order of time. `zero_ns` is what its summary said, where this is the
    /// same run of the camera.
    ///
    /// # Errors
    ///
    /// As [`run`](Self::run), and where the folder is no campaign of this camera.
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
        // A campaign whose exposures were given in seconds has none that counts as 1: the search finds it.
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

    /// Takes what is not there yet, and keeps the log. `searched`: the full exposure that was searched for, s.
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
            // A thousand frames more than were kept: the pilot and damaged frames were drawn too.
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
        // A campaign of pairs is one of EMVA 1288: the reference tool reads it too.
        if let Some(path) = crate::dataset::write_descriptor(&Dataset::open(root)?)? {
            tracing::info!(file = %path.display(), "EMVA 1288 descriptor");
        }
        let zero_ns = if let DeviceClock::Zero(zero) = run.clock { Some(zero) } else { None };
        let full_exposure_s = plan.full_exposure_s;
        Ok(Summary { frames, counts: run.counts, automatics, full_exposure_s, zero_ns })
    }

    /// Switches off what distorts radiometry, brings the camera to the plan's settings, and switches off what
    /// these have made available; last come the features that the plan names, whatever they do.
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
            // The deepest, and of equal ones the one whose bytes need no unpacking.
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
        // Set last, and read back then.
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

    /// Begins a dataset with a plan whose exposures are in seconds.
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
        // Killed after the plan and before the manifest, which comes last.
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
        // After a power cycle a camera may have come back with other settings than a plan names.
        let now = self.manifest(&plan, &automatics)?;
        let differs = manifest.differences(&now);
        if !differs.is_empty() {
            return Err(fault(format!("{}; set it back, or begin a new campaign", differs.join("; "))));
        }
        Ok((automatics, writer, plan))
    }
}
