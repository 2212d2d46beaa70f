//! Running acquisition.

use super::{arv, Arrived, CameraError, FrameCounter, FrameStream, Settings, StreamCounts, Trigger};
use crate::frame::{Frame, Region, Status};
use arv::Received;
use std::time::{Duration, Instant};

pub(super) struct AravisStream<'a> {
    pub(super) stream: arv::Stream<'a>,
    pub(super) id: String,
    pub(super) settings: Settings,
    pub(super) trigger: Trigger,
    pub(super) gigevision: bool,
    pub(super) counter: FrameCounter,
    pub(super) counts: StreamCounts,
}

impl AravisStream<'_> {
    /// Waits for the next frame and passes it to `take`, or the reason why it is damaged.
    fn show(
        &mut self,
        timeout: Duration,
        take: &mut dyn FnMut(Result<Arrived<'_>, &str>) -> bool,
    ) -> Result<(), CameraError> {
        let Self { stream, settings, counter, counts, gigevision, .. } = self;
        let begun = Instant::now();
        let got = stream.next(timeout, |received| {
            let repeated = counts.repeated;
            let shown = match arrived(received, settings, *gigevision, counter, counts) {
                Ok(frame) => take(Ok(frame)),
                Err(why) => {
                    take(Err(&why));
                    false
                }
            };
            if shown {
                counts.completed += 1;
            } else if counts.repeated == repeated {
                counts.failures += 1;
            }
        });
        match got {
            Ok(Some(())) => Ok(()),
            Ok(None) => {
                let c = self.counts();
                Err(CameraError::Timeout {
                    camera: self.id.clone(),
                    seconds: begun.elapsed().as_secs_f64(),
                    counts: format!(
                        "completed {}, failures {}, underruns {}; check the trigger, the packet size against \
                         the network's MTU, and the firewall",
                        c.completed, c.failures, c.underruns
                    ),
                })
            }
            Err(e) => Err(CameraError::Lost { camera: self.id.clone(), message: e.message }),
        }
    }
}

impl FrameStream for AravisStream<'_> {
    fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<(), CameraError> {
        let temperature_c = self.settings.temperature_c;
        self.show(timeout, &mut |arrived| {
            let unpacked = arrived.map_err(String::from).and_then(|a| {
                let dn = frame.pixels_mut(a.size.0, a.size.1);
                a.format.unpack(a.bytes, dn).map_err(|e| e.to_string())?;
                (frame.id, frame.timestamp_ns, frame.temperature_c) = (a.id, a.timestamp_ns, temperature_c);
                Ok(())
            });
            let whole = unpacked.is_ok();
            frame.status = unpacked.map_or_else(Status::Damaged, |()| Status::Complete);
            whole
        })
    }

    fn next_arrived(
        &mut self,
        _memory: &mut Frame,
        timeout: Duration,
        take: &mut dyn FnMut(Result<Arrived<'_>, &str>),
    ) -> Result<(), CameraError> {
        self.show(timeout, &mut |arrived| {
            take(arrived);
            true
        })
    }

    fn trigger(&mut self) -> Result<(), CameraError> {
        if self.trigger != Trigger::Software {
            let feature = "TriggerSoftware in free run".into();
            return Err(CameraError::NotAvailable { camera: self.id.clone(), feature });
        }
        self.stream.trigger().map_err(|e| CameraError::Backend {
            camera: self.id.clone(),
            feature: e.what,
            message: e.message,
        })
    }

    fn counts(&self) -> StreamCounts {
        let aravis = self.stream.counts();
        let dropped = aravis.dropped;
        let failures = self.counts.failures + aravis.dropped_damaged;
        // Every lost frame leaves a gap in the frame numbers, whatever the cause. Aravis counts an underrun
        // for each packet that finds no buffer.
        let left = self.counts.missing.saturating_sub(failures + dropped);
        let underruns = aravis.underruns.min(left);
        StreamCounts { underruns, dropped, failures, missing: left - underruns, ..self.counts }
    }
}

/// Returns a frame that is complete and as commanded, or a description of the fault.
fn arrived<'a>(
    received: Received<'a>,
    settings: &Settings,
    gigevision: bool,
    counter: &mut FrameCounter,
    counts: &mut StreamCounts,
) -> Result<Arrived<'a>, String> {
    let (bytes, code, region, frame_id, timestamp_ns, age) = match received {
        Received::Complete { bytes, format, region, frame_id, timestamp_ns, age } => {
            (bytes, format, region, frame_id, timestamp_ns, age)
        }
        Received::Damaged(why) => return Err(why),
    };
    let (wanted, format) = (settings.region, settings.pixel_format);
    let [x, y, w, h] = region.map(|v| v.max(0) as u32);
    if (Region { x, y, width: w, height: h }) != wanted || code != format.code() {
        return Err(format!("{w} x {h} px at {x}, {y} in format {code:#010x}, not what was commanded"));
    }
    let size = (w as usize, h as usize);
    // Counted before the length check: a frame that cannot be unpacked was sent all the same.
    let Some((id, missing)) = counter.take(frame_id, gigevision) else {
        counts.repeated += 1;
        return Err(format!("a frame of number {frame_id} has come before"));
    };
    counts.missing += missing;
    if bytes.len() != format.payload(size.0 * size.1) {
        let expected = format.payload(size.0 * size.1);
        return Err(format!("{} bytes, and {w} x {h} px of {format} are {expected}", bytes.len()));
    }
    let timestamp_ns = (timestamp_ns != 0).then_some(timestamp_ns);
    Ok(Arrived { bytes, format, size, id, timestamp_ns, age })
}
