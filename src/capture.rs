//! Runs a plan on a camera and a bench, and keeps what comes.

use crate::bench::{BenchError, Illuminator};
use crate::camera::{Automatic, Camera, CameraError, Settings, StreamCounts, StreamOptions, Value};
use crate::dataset::{CameraInfo, DatasetError, FrameRow, Kind, Manifest, Writer};
use crate::frame::{Frame, Status};
use crate::pixel_format::PixelFormat;
use crate::plan::{FULL_EXPOSURE_LEVEL, Plan, PlanError, SetPlan};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Why a capture stopped. What was written before stays whole.
#[derive(Debug, thiserror::Error)]
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
        /// Frames thrown away.
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
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Frames written now.
    pub frames: u64,
    /// Sums over the streams.
    pub counts: StreamCounts,
    /// Automatic functions and what became of them.
    pub automatics: Vec<Automatic>,
    /// Exposure that counts as 1, s.
    pub full_exposure_s: Option<f64>,
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
    pub progress: &'a mut dyn FnMut(Progress),
}

/// Frames that are thrown away between the search for the exposure and the first frame of the plan: a filter that keeps a third of the last
/// frame has forgotten it to one part in 10^7.
const SETTLING: usize = 16;

/// A set whose first frame was lost is begun again so often: another set's light and exposure first, since the frame that was lost took with
/// it what that carries over.
const AGAIN: usize = 3;

/// Name of the log inside a dataset: one line a run, with the buffer statistics.
pub const LOG_FILE: &str = "capture.log";

/// Name of the plan inside a dataset, exposures in seconds, by which it is continued.
pub const PLAN_FILE: &str = "plan.toml";

impl Capture<'_> {
    /// Captures a plan into a new folder, or continues it there.
    pub fn run(&mut self, plan: &Plan, root: &Path, resume: bool) -> Result<Summary, CaptureError> {
        let automatics = self.camera.disable_automatics()?;
        for a in &automatics {
            if a.off {
                tracing::info!(
                    feature = a.feature,
                    before = a.before,
                    now = a.now,
                    "automatic function is off"
                );
            } else {
                tracing::warn!(
                    feature = a.feature,
                    now = a.now,
                    "automatic function could not be switched off"
                );
            }
        }
        let mut counts = StreamCounts::default();
        let searched = !resume && plan.full_exposure_s.is_none() && plan.needs_full_exposure();
        let (mut writer, plan) = if resume {
            self.resume(root)?
        } else {
            self.set_up(plan)?;
            let plan = self.absolute(plan, &mut counts)?;
            let manifest = self.manifest(&automatics)?;
            let writer = Writer::create(root, &manifest, &[(PLAN_FILE, &plan.to_toml()?)])?;
            (writer, plan)
        };
        let before = writer.written().len() as u64;
        let start = writer.written().last().and_then(|r| r.timestamp_s).unwrap_or(0.0);
        // A thousand frames more than were kept: the pilot and damaged frames were drawn too.
        let mut clock = match resume {
            false => DeviceClock::FromFirstFrame,
            true if self.camera.continue_after(before + 1000, start + 1.0) => DeviceClock::Zero(0),
            // How long the pause was is not known.
            true => DeviceClock::Unknown,
        };
        let outcome: Result<(), CaptureError> = plan.sets.iter().enumerate().try_for_each(|(number, set)| {
            let have = writer.written().iter().filter(|r| r.set as usize == number).count() as u32;
            if have >= set.frames {
                return Ok(());
            }
            let mut again = AGAIN;
            while !self.capture_set(number, set, &plan, &mut writer, &mut clock, &mut counts, again > 0)? {
                again -= 1;
                self.go_back(&plan.sets[number - 1], &mut counts)?;
            }
            Ok(())
        });
        let before_plan = if searched {
            format!(
                "before the first frame: a search for the full exposure up to {} s, then {SETTLING} frames under the first set's light\n",
                plan.full_exposure_s.unwrap_or(0.0)
            )
        } else {
            String::new()
        };
        let line = format!(
            "{before_plan}completed {} failures {} underruns {} missing {} written {} outcome {}\n",
            counts.completed,
            counts.failures,
            counts.underruns,
            counts.missing,
            writer.written().len() as u64 - before,
            outcome.as_ref().map_or_else(|e| e.to_string(), |()| "done".into()),
        );
        tracing::info!(counts = line.trim_end(), "buffer statistics");
        let log = std::fs::OpenOptions::new().create(true).append(true).open(root.join(LOG_FILE));
        if let Err(e) = log.and_then(|mut log| std::io::Write::write_all(&mut log, line.as_bytes())) {
            tracing::warn!(error = %e, "the buffer statistics could not be kept");
        }
        outcome?;
        let frames = writer.written().len() as u64 - before;
        Ok(Summary { frames, counts, automatics, full_exposure_s: plan.full_exposure_s })
    }

    /// Brings the camera to the plan's settings.
    fn set_up(&mut self, plan: &Plan) -> Result<(), CaptureError> {
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
        for (name, value) in &wanted.features {
            let value = match value {
                toml::Value::Boolean(v) => Value::Bool(*v),
                toml::Value::Integer(v) => Value::Int(*v),
                toml::Value::Float(v) => Value::Float(*v),
                other => Value::Text(other.as_str().map_or_else(|| other.to_string(), Into::into)),
            };
            camera.set_feature(name, &value)?;
        }
        Ok(())
    }

    fn read_back(&self, feature: &str, asked: String, got: String) -> CameraError {
        let camera = self.camera.identity().id.clone();
        CameraError::ReadBack { camera, feature: feature.into(), asked, got }
    }

    /// Gives every exposure in seconds; measures the full exposure where the plan needs it.
    fn absolute(&mut self, plan: &Plan, counts: &mut StreamCounts) -> Result<Plan, CaptureError> {
        let full = match plan.full_exposure_s {
            Some(full) => full,
            None if plan.needs_full_exposure() => {
                let full = self.find_full_exposure(plan, counts)?;
                self.settle(plan, full, counts)?;
                full
            }
            None => 1.0,
        };
        let bounds = self.camera.capabilities().exposure_s;
        if let Some(bounds) = bounds {
            for exposure_s in plan.sets.iter().filter_map(|s| s.exposure_s) {
                let id = &self.camera.identity().id;
                crate::camera::check_bounds(id, "ExposureTime", Some(bounds), exposure_s, "s")?;
            }
        }
        let absolute = plan.absolute(full, |e| bounds.map_or(e, |b| b.nearest(e)));
        for (wanted, set) in plan.sets.iter().zip(&absolute.sets) {
            let wanted = wanted.exposure_s.unwrap_or(wanted.exposure.unwrap_or(1.0) * full);
            let got = set.exposure_s.unwrap_or(wanted);
            if (got / wanted - 1.0).abs() > 0.05 {
                tracing::warn!(
                    wanted_s = wanted,
                    taken_s = got,
                    "the camera cannot expose so; nearest taken"
                );
            }
        }
        Ok(absolute)
    }

    /// The exposure that brings the card at illumination 1 to [`FULL_EXPOSURE_LEVEL`] of full scale.
    fn find_full_exposure(&mut self, plan: &Plan, counts: &mut StreamCounts) -> Result<f64, CaptureError> {
        let reference = plan.sets.iter().filter(|s| s.kind == Kind::Flat);
        let light = reference.map(|s| s.illumination).fold(0.0, f64::max);
        let light = if light > 0.0 { light } else { 1.0 };
        let state = SetPlan {
            kind: Kind::Flat,
            frames: 2,
            exposure_s: None,
            exposure: None,
            illumination: light,
            configuration: 0,
        };
        self.bench.apply(&state.bench(), self.camera)?;
        let Some(bounds) = self.camera.capabilities().exposure_s else {
            return Err(self.camera.not_available("ExposureTime").into());
        };
        let settings = self.camera.settings()?;
        let full_scale = f64::from(settings.pixel_format.full_scale_dn());
        let target = FULL_EXPOSURE_LEVEL * full_scale;
        // The level of no light, by the shortest exposure.
        let black = self.pilot(bounds.min, counts)?.0;
        let mut exposure = settings.exposure_s.clamp(bounds.min, bounds.max);
        let mut fastest = 0.0;
        for _ in 0..12 {
            let (mean, clipped) = self.pilot(exposure, counts)?;
            let rate = (mean - black) / exposure;
            if clipped <= 0.01 && mean < target && rate < 0.85 * fastest {
                tracing::warn!(
                    mean_dn = mean,
                    full_scale_dn = full_scale,
                    "the signal stops below full scale: the well is full; exposures end there"
                );
                // How fast the well fills shows at a third of that.
                let third = bounds.nearest(0.3 * (mean - black) / fastest);
                let (level, _) = self.pilot(third, counts)?;
                let fastest = f64::max(fastest, (level - black) / third);
                return Ok(bounds.nearest(1.05 * (mean - black) / fastest));
            }
            // Of levels that stand out from black: below them offsets and zero make the rate.
            if mean - black > 0.02 * full_scale && clipped <= 0.01 {
                fastest = f64::max(fastest, rate);
            }
            tracing::debug!(exposure_s = exposure, mean_dn = mean, clipped, "looking for the full exposure");
            let next = if clipped > 0.01 {
                exposure / 4.0
            } else {
                // Never more than 8 times at once: near black the estimate is coarse.
                exposure * ((target - black) / (mean - black).max(1e-3 * full_scale)).clamp(0.1, 8.0)
            };
            let next = bounds.nearest(next);
            if (next / exposure - 1.0).abs() < 0.01 {
                return Ok(next);
            }
            exposure = next;
        }
        tracing::warn!(
            exposure_s = exposure,
            "the light does not reach the wanted level; taking this exposure"
        );
        Ok(exposure)
    }

    /// Lets what the search has exposed fade, under the light of the first set: lag and filters carry it into the first frames else.
    fn settle(&mut self, plan: &Plan, full_s: f64, counts: &mut StreamCounts) -> Result<(), CaptureError> {
        let Some(first) = plan.sets.first() else { return Ok(()) };
        self.bench.apply(&first.bench(), self.camera)?;
        for _ in 0..SETTLING / 2 {
            self.pilot(full_s, counts)?;
        }
        tracing::info!(exposure_s = full_s, "frames without a place in the plan let the search fade");
        Ok(())
    }

    /// Mean and share of clipped pixels of a frame at an exposure; the first frame is let pass.
    fn pilot(&mut self, exposure_s: f64, counts: &mut StreamCounts) -> Result<(f64, f64), CaptureError> {
        self.camera.set_exposure_s(exposure_s)?;
        let full_scale = self.camera.settings()?.pixel_format.full_scale_dn();
        let timeout = timeout(exposure_s);
        let mut stream = self.camera.stream(&self.options)?;
        let mut frame = Frame::new(0, 0);
        let mut good = 0;
        for _ in 0..8 {
            stream.next(&mut frame, timeout)?;
            good += u32::from(frame.status == Status::Complete);
            if good == 2 {
                break;
            }
        }
        counts.add(stream.counts());
        let n = frame.pixels.len().max(1) as f64;
        let sum: u64 = frame.pixels.iter().map(|&d| u64::from(d)).sum();
        let clipped = frame.pixels.iter().filter(|&&d| d >= full_scale).count();
        Ok((sum as f64 / n, clipped as f64 / n))
    }

    fn manifest(&mut self, automatics: &[Automatic]) -> Result<Manifest, CaptureError> {
        let settings = self.camera.settings()?;
        let mut features: BTreeMap<String, Value> = self.camera.features();
        for a in automatics {
            features.insert(a.feature.clone(), Value::Text(a.now.clone()));
        }
        let identity = self.camera.identity();
        let mut manifest = Manifest::new(CameraInfo {
            still_automatic: automatics.iter().filter(|a| !a.off).map(|a| a.feature.clone()).collect(),
            features: features
                .into_iter()
                .map(|(name, value)| {
                    let value = match value {
                        Value::Bool(v) => v.into(),
                        Value::Int(v) => v.into(),
                        Value::Float(v) => v.into(),
                        Value::Text(v) => v.into(),
                    };
                    (name, value)
                })
                .collect(),
            ..CameraInfo::of(identity, &settings)
        });
        manifest.bench = self.bench.info();
        Ok(manifest)
    }

    /// Opens a dataset to be continued and brings the camera to its settings.
    fn resume(&mut self, root: &Path) -> Result<(Writer, Plan), CaptureError> {
        let fault = |message: String| CaptureError::Resume { path: root.display().to_string(), message };
        let plan_path = root.join(PLAN_FILE);
        let text = std::fs::read_to_string(&plan_path)
            .map_err(|e| fault(format!("{}: {e}", plan_path.display())))?;
        let mut plan = Plan::from_toml(&text)?;
        let (writer, manifest) = Writer::resume(root)?;
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
        self.set_up(&plan)?;
        let region = self.camera.settings()?.region;
        if (region.width as usize, region.height as usize) != (was.width, was.height) {
            return Err(fault(format!(
                "its frames are {} x {} px, and the camera gives {} x {} px",
                was.width, was.height, region.width, region.height
            )));
        }
        Ok((writer, plan))
    }

    /// Exposes what stood before a set once more, without keeping it.
    fn go_back(&mut self, before: &SetPlan, counts: &mut StreamCounts) -> Result<(), CaptureError> {
        self.bench.apply(&before.bench(), self.camera)?;
        for _ in 0..SETTLING / 2 {
            self.pilot(before.exposure_s.unwrap_or(1.0), counts)?;
        }
        Ok(())
    }

    /// Takes the frames of a set that are not there yet; `false`, and none of them, where the first was lost and `whole` sets are asked for.
    #[expect(clippy::too_many_arguments, reason = "the state of one run")]
    fn capture_set(
        &mut self,
        number: usize,
        set: &SetPlan,
        plan: &Plan,
        writer: &mut Writer,
        clock: &mut DeviceClock,
        counts: &mut StreamCounts,
        whole: bool,
    ) -> Result<bool, CaptureError> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(CaptureError::Interrupted { frames: writer.written().len() as u64 });
        }
        let exposure_s = set.exposure_s.unwrap_or(1.0);
        // A person is not asked to move the light for it.
        let same_bench = || number > 0 && plan.sets[number - 1].bench() == set.bench();
        let can_go_back = self.bench.moves_itself() || same_bench();
        let reached = self.bench.apply(&set.bench(), self.camera)?;
        let exposure_s = self.camera.set_exposure_s(exposure_s)?;
        let settings = self.camera.settings()?;
        let mut stream = self.camera.stream(&self.options)?;
        let outcome = take(
            &mut *stream,
            &TakeSet {
                number,
                set,
                plan,
                exposure_s,
                illumination: reached.illumination,
                settings: &settings,
                stop: self.stop,
                whole: whole && number > 0 && plan.camera.settle_frames == 0 && can_go_back,
            },
            writer,
            clock,
            self.progress,
        );
        let counted = stream.counts();
        tracing::debug!(set = number, ?counted, "set done");
        counts.add(counted);
        outcome
    }
}

/// What is known of the set being taken.
struct TakeSet<'a> {
    number: usize,
    set: &'a SetPlan,
    plan: &'a Plan,
    exposure_s: f64,
    /// As the bench says it stands.
    illumination: f64,
    settings: &'a Settings,
    stop: &'a AtomicBool,
    /// Whether the first frame must be the first that was exposed.
    whole: bool,
}

/// `false`, and nothing written, where that is asked for and cannot be had.
fn take(
    stream: &mut dyn crate::camera::FrameStream,
    job: &TakeSet<'_>,
    writer: &mut Writer,
    clock: &mut DeviceClock,
    progress: &mut dyn FnMut(Progress),
) -> Result<bool, CaptureError> {
    let TakeSet { number, set, plan, exposure_s, illumination, settings, stop, whole } = *job;
    let mut index = writer.written().iter().filter(|r| r.set as usize == number).count() as u32;
    let mut frame = Frame::new(settings.region.width as usize, settings.region.height as usize);
    let mut damaged = 0;
    let mut settling = plan.camera.settle_frames;
    while index < set.frames {
        if stop.load(Ordering::Relaxed) {
            return Err(CaptureError::Interrupted { frames: writer.written().len() as u64 });
        }
        stream.next(&mut frame, timeout(exposure_s))?;
        if let Status::Damaged(why) = &frame.status {
            damaged += 1;
            if whole && index == 0 {
                tracing::warn!(
                    set = number,
                    why,
                    "the first frame of the set is damaged: the set before is exposed once more"
                );
                return Ok(false);
            }
            tracing::warn!(set = number, frame = frame.id, why, "damaged frame thrown away");
            if damaged > 20 + 4 * u64::from(set.frames) {
                return Err(CaptureError::Damaged {
                    set: number,
                    damaged,
                    wanted: set.frames,
                    last: why.clone(),
                    advice: "check cable and switch, lower the frame rate or the packet size, \
                             raise net.core.rmem_max",
                });
            }
            continue;
        }
        if settling > 0 {
            settling -= 1;
            continue;
        }
        if !frame.fits(settings.pixel_format) {
            let largest = frame.pixels.iter().max().copied().unwrap_or(0);
            return Err(CameraError::Backend {
                camera: "frame".into(),
                feature: settings.pixel_format.name().into(),
                message: format!("holds {largest} DN, more than {} bits", settings.pixel_format.bits()),
            }
            .into());
        }
        let row = FrameRow {
            file: String::new(),
            kind: set.kind,
            set: number as u32,
            index,
            exposure_s,
            illumination,
            configuration: set.configuration,
            temperature_c: frame.temperature_c.or(settings.temperature_c),
            timestamp_s: clock.seconds(frame.timestamp_ns),
        };
        writer.append(row, &frame.pixels)?;
        index += 1;
        progress(Progress {
            frames: writer.written().len() as u64,
            of: plan.frames(),
            frame_bytes: 2 * frame.pixels.len() as u64,
            set: number,
            sets: plan.sets.len(),
        });
    }
    Ok(true)
}

/// How long to wait for a frame: the exposure, and time for the camera to answer.
fn timeout(exposure_s: f64) -> Duration {
    Duration::from_secs_f64((2.0 * exposure_s + 5.0).min(86_400.0))
}

/// Turns device time into seconds from the start of the campaign.
enum DeviceClock {
    FromFirstFrame,
    /// Device time at the start of the campaign, ns.
    Zero(u64),
    Unknown,
}

impl DeviceClock {
    /// `None` where it is not known.
    fn seconds(&mut self, timestamp_ns: Option<u64>) -> Option<f64> {
        let now = timestamp_ns?;
        let zero = match *self {
            DeviceClock::Unknown => return None,
            DeviceClock::Zero(zero) => zero,
            DeviceClock::FromFirstFrame => {
                *self = DeviceClock::Zero(now);
                now
            }
        };
        // Nanoseconds, and no rubbish behind them in the file.
        Some((now as f64 - zero as f64).round() * 1e-9)
    }
}
