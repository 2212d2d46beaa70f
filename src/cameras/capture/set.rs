//! Capture of the frames of one set.

use super::{Capture, CaptureError, Progress, Run};
use crate::camera::{CameraError, FrameStream, Settings};
use crate::dataset::FrameRow;
use crate::frame::{Frame, Status};
use crate::plan::{Plan, SetPlan};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Maximum number of restarts of a set whose first frame was lost. The previous set's light and exposure are
/// repeated first: the lost frame carried the memory of them.
const AGAIN: usize = 3;

/// Campaign start on a camera clock that radcam sets, s. Not 0, because a device time of 0 means no time.
const ZERO_S: f64 = 1.0;

impl Capture<'_> {
    /// Captures the missing frames of a set. If the first one is lost, the previous set is exposed once more
    /// and the set restarts.
    pub(super) fn capture_set(
        &mut self,
        number: usize,
        plan: &Plan,
        run: &mut Run,
    ) -> Result<(), CaptureError> {
        let set = &plan.sets[number];
        if run.have(number) >= set.frames && !run.again {
            return Ok(());
        }
        // An operator is not asked to move the light for a restart. With settling frames, which are
        // discarded, a set does not begin at a transition.
        let before = number.checked_sub(1).map(|k| &plan.sets[k]);
        let before = before.filter(|b| self.bench.moves_itself() || b.bench() == set.bench());
        let before = before.filter(|_| plan.camera.settle_frames == 0);
        for _ in 0..AGAIN {
            let Some(before) = before else { break };
            if self.attempt(number, plan, run, true)? {
                return Ok(());
            }
            run.begun_again.push(number);
            self.expose(before, before.exposure_s.unwrap_or(1.0), &mut run.counts)?;
        }
        self.attempt(number, plan, run, false).map(drop)
    }

    /// Attempts a set once. Returns `false`, with no frame, if the first was lost and `whole` is set.
    fn attempt(
        &mut self,
        number: usize,
        plan: &Plan,
        run: &mut Run,
        whole: bool,
    ) -> Result<bool, CaptureError> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(CaptureError::Interrupted { frames: run.writer.written().len() as u64 });
        }
        let set = &plan.sets[number];
        let reached = self.bench.apply(&set.bench(), self.camera)?;
        let exposure_s = self.camera.set_exposure_s(set.exposure_s.unwrap_or(1.0))?;
        let settings = self.camera.settings()?;
        // A camera that accepts the frame number draws the frames on disk again, and they are discarded. Each
        // frame and its time are then the same, whatever was interrupted.
        let (first, time_s) = run.start_of(number, plan);
        let told = self.camera.draw_from(first, ZERO_S + time_s);
        if told {
            run.clock = DeviceClock::Zero((ZERO_S * 1e9) as i64);
        }
        let mut stream = self.camera.stream(&self.options)?;
        let job = TakeSet {
            number,
            set,
            plan,
            exposure_s,
            illumination: reached.illumination,
            settings: &settings,
            stop: self.stop,
            whole,
            again: run.again || told,
        };
        let mut tell = |p| self.progress.iter_mut().for_each(|progress| progress(p));
        let mut show = |f: &Frame| self.shown.iter_mut().for_each(|shown| shown(f));
        let outcome = take(&mut *stream, &job, run, Tell { progress: &mut tell, shown: &mut show });
        let counted = stream.counts();
        tracing::debug!(set = number, ?counted, "set done");
        run.counts.add(counted);
        outcome
    }
}

/// Parameters of the set being captured.
struct TakeSet<'a> {
    number: usize,
    set: &'a SetPlan,
    plan: &'a Plan,
    exposure_s: f64,
    /// Illumination that the bench reports.
    illumination: f64,
    settings: &'a Settings,
    stop: &'a AtomicBool,
    /// True if the first frame must be the first that was exposed.
    whole: bool,
    /// True if frames that are on disk come again.
    again: bool,
}

/// Callbacks for progress and for captured frames.
struct Tell<'a> {
    progress: &'a mut dyn FnMut(Progress),
    shown: &'a mut dyn FnMut(&Frame),
}

/// Captures the frames of a set. Returns `false`, with nothing written, if `whole` is set and the first frame
/// is damaged.
fn take(
    stream: &mut dyn FrameStream,
    job: &TakeSet<'_>,
    run: &mut Run,
    tell: Tell<'_>,
) -> Result<bool, CaptureError> {
    let TakeSet { number, set, plan, exposure_s, illumination, settings, stop, whole, again } = *job;
    let have = run.have(number);
    let mut index = if again { 0 } else { have };
    let Run { writer, clock, .. } = run;
    let mut frame = Frame::new(settings.region.width as usize, settings.region.height as usize);
    let mut damaged = 0;
    let mut settling = plan.camera.settle_frames;
    while index < set.frames {
        if stop.load(Ordering::Relaxed) {
            return Err(CaptureError::Interrupted { frames: writer.written().len() as u64 });
        }
        stream.next(&mut frame, crate::camera::patience(exposure_s))?;
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
            tracing::warn!(set = number, frame = frame.id, why, "damaged frame discarded");
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
        if index == 0 {
            tracing::debug!(set = number, frame = frame.id, "first frame");
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
        let timestamp_s = clock.seconds(frame.timestamp_ns);
        if index < have {
            index += 1;
            continue;
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
            timestamp_s,
        };
        writer.append(row, &frame.pixels)?;
        (tell.shown)(&frame);
        index += 1;
        (tell.progress)(Progress {
            frames: writer.written().len() as u64,
            of: plan.frames(),
            frame_bytes: 2 * frame.pixels.len() as u64,
            set: number,
            sets: plan.sets.len(),
        });
    }
    Ok(true)
}

/// Converter from device time to seconds since the start of the campaign.
pub(super) enum DeviceClock {
    FromFirstFrame,
    /// Seconds since the start at an instant of the computer's clock.
    At(f64, Instant),
    /// Device time at the start of the campaign, ns; negative if the camera was switched on since.
    Zero(i64),
    Unknown,
}

impl DeviceClock {
    /// Returns the seconds since the start; `None` if unknown.
    pub(super) fn seconds(&mut self, timestamp_ns: Option<u64>) -> Option<f64> {
        let now = timestamp_ns?;
        let zero = match *self {
            DeviceClock::Unknown => return None,
            DeviceClock::Zero(zero) => zero,
            DeviceClock::FromFirstFrame => {
                *self = DeviceClock::Zero(now as i64);
                now as i64
            }
            DeviceClock::At(seconds, then) => {
                let since = seconds + then.elapsed().as_secs_f64();
                let zero = (now as i64).saturating_sub((since * 1e9).round() as i64);
                *self = DeviceClock::Zero(zero);
                zero
            }
        };
        // Whole nanoseconds leave no rounding digits in the file.
        Some((now as i64).saturating_sub(zero) as f64 * 1e-9)
    }
}
