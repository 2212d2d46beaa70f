//! Continuous correction of a camera's frames, for as long as the line runs.
//!
//! The received bytes are unpacked, corrected and inspected in one pass, without a copy. A slow consumer
//! never blocks the camera: the oldest waiting frame is dropped and counted. A lost camera is searched for
//! until it is back.

mod files;
mod ring;

pub use files::Files;
pub use ring::Ring;

use crate::calibrate::file::Calibration;
use crate::camera::{self, Camera, CameraError, Identity, Settings, StreamCounts, StreamOptions};
use crate::correct::{Codes, CorrectError, Corrector, Seen};
use crate::dataset::{CameraInfo, DatasetError};
use crate::frame::{Frame, Region};
use crate::pixel_format::PixelFormat;
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Interval between two attempts to find a lost camera.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Options of a corrected stream.
#[derive(Debug, Clone)]
pub struct Options {
    /// Meaning of the codes. `None`: the camera's codes, that is 1 code per DN, the mean of the dark
    /// reference as the black level, clipped at the camera's full scale.
    pub codes: Option<Codes>,
    /// True if flagged pixels are replaced.
    pub replace_defects: bool,
    /// True to continue although frames are darker than the dark reference.
    pub force: bool,
    /// Exposure, s; `None`: the current exposure of the camera.
    pub exposure_s: Option<f64>,
    /// Stream options of the camera. The number of waiting frames is bounded.
    pub stream: StreamOptions,
    /// Number of corrected frames after which the stream ends.
    pub frames: Option<u64>,
    /// Time after which the stream ends.
    pub duration: Option<Duration>,
    /// Maximum time for which a lost camera is searched.
    pub patience: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            codes: None,
            replace_defects: false,
            force: false,
            exposure_s: None,
            // Frames that wait for lost packets occupy buffers: 100 ms at 160 frames per second.
            stream: StreamOptions {
                buffers: 24,
                waiting: Some(8),
                frame_retention: Duration::from_millis(100),
                ..StreamOptions::default()
            },
            frames: None,
            duration: None,
            patience: Duration::MAX,
        }
    }
}

/// Corrected frame.
#[derive(Debug, Clone)]
pub struct Corrected {
    /// Codes, row by row.
    pub pixels: Vec<u16>,
    /// Columns and rows.
    pub size: (usize, usize),
    /// Frame number of the camera, as [`Frame::id`]. If a lost camera restarts at 1, the numbers continue
    /// from the last one.
    pub id: u64,
    /// Device clock, ns, if the camera reports it.
    pub timestamp_ns: Option<u64>,
    /// Statistics of the raw frame.
    pub seen: Seen,
}

/// Destination of corrected frames.
pub trait Sink {
    /// Returns the name of the sink in [`Summary::sinks`].
    fn name(&self) -> &'static str;

    /// Takes a frame without blocking the stream.
    ///
    /// # Errors
    ///
    /// An error that makes continuing useless, such as a full disk.
    fn take(&mut self, frame: &Arc<Corrected>) -> Result<(), StreamError>;

    /// Returns the counts of frames.
    fn counts(&self) -> SinkCounts;

    /// Waits until all frames taken are processed.
    ///
    /// # Errors
    ///
    /// As [`take`](Self::take).
    fn finish(&mut self) -> Result<(), StreamError> {
        Ok(())
    }
}

/// Frame counts of a sink.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct SinkCounts {
    /// Frames processed.
    pub taken: u64,
    /// Frames dropped because the sink was slower than the camera.
    pub dropped: u64,
}

/// Latency from a frame's first packet to its corrected pixels, ms.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Latency {
    /// Median.
    pub median_ms: f64,
    /// 99th percentile.
    pub p99_ms: f64,
    /// Maximum.
    pub worst_ms: f64,
}

/// Summary of a stream.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Summary {
    /// Camera id.
    pub camera: String,
    /// Counts of received frames.
    pub received: StreamCounts,
    /// Frames corrected.
    pub corrected: u64,
    /// Number of times that the camera was lost and found again, or its stream restarted.
    pub reconnections: u64,
    /// Time without the camera, s. Frames sent meanwhile were not received.
    pub away_s: f64,
    /// Time of the whole run, s.
    pub seconds: f64,
    /// Frames corrected per second.
    pub frames_per_s: f64,
    /// Corrected raw pixels, bytes per second in 16-bit codes.
    pub bytes_per_s: f64,
    /// Latency; `None` if the backend does not report when a frame came.
    pub latency: Option<Latency>,
    /// Mean of the last raw frame, DN.
    pub mean_dn: f64,
    /// Counts of the corrected frames, by sink.
    pub sinks: BTreeMap<String, SinkCounts>,
}

impl Summary {
    /// Returns true if every frame that the camera sent reached every sink.
    pub fn is_whole(&self) -> bool {
        self.received.lost() == 0 && self.reconnections == 0 && self.sinks.values().all(|s| s.dropped == 0)
    }
}

/// Reason why a stream ended early.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StreamError {
    /// Camera error.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// Calibration error.
    #[error("camera {camera}: {source}")]
    Correct {
        /// Camera id.
        camera: String,
        /// Mismatch.
        source: CorrectError,
    },
    /// Corrected frames cannot be written.
    #[error("{}: {message}", path.display())]
    Files {
        /// File.
        path: PathBuf,
        /// Cause.
        message: String,
    },
    /// Corrected frames cannot be written.
    #[error(transparent)]
    Dataset(#[from] Box<DatasetError>),
}

/// Brings a camera into the state for which a calibration holds: switches off distorting features, sets
/// format, region, gain and black level, and the exposure if given.
///
/// # Errors
///
/// A setting that the camera refuses, or the differences that remain.
pub fn prepare(
    camera: &mut dyn Camera,
    calibration: &Calibration,
    exposure_s: Option<f64>,
) -> Result<Settings, StreamError> {
    let known = &calibration.description.camera;
    // The identity is checked before any setting is touched.
    let Identity { vendor, model, serial, .. } = camera.identity().clone();
    let found = known.differences(&CameraInfo { vendor, model, serial, ..CameraInfo::default() });
    if !found.is_empty() {
        let source = CorrectError::Settings(found.join("; "));
        return Err(StreamError::Correct { camera: camera.identity().id.clone(), source });
    }
    for automatic in camera.disable_automatics()? {
        if !automatic.off {
            tracing::warn!(feature = automatic.feature, now = automatic.now, "could not be switched off");
        }
    }
    let now = camera.settings()?;
    if let Ok(format) = PixelFormat::from_name(&known.pixel_format)
        && format.unpacked() != now.pixel_format.unpacked()
    {
        camera.set_pixel_format(format)?;
    }
    let offset = |name: &str| known.features.get(name).and_then(toml::Value::as_integer);
    let (x, y) = (offset("OffsetX"), offset("OffsetY"));
    let place = |v: Option<i64>, now: u32| v.and_then(|v| u32::try_from(v).ok()).unwrap_or(now);
    let region = Region {
        x: place(x, now.region.x),
        y: place(y, now.region.y),
        width: known.width as u32,
        height: known.height as u32,
    };
    if region != now.region {
        camera.set_region(region)?;
    }
    if let Some(gain) = known.gain_db.filter(|g| now.gain_db.is_some_and(|n| (n - g).abs() > 1e-9)) {
        camera.set_gain_db(gain)?;
    }
    let black = known.black_level_dn;
    if let Some(level) = black.filter(|b| now.black_level_dn.is_some_and(|n| (n - b).abs() > 1e-9)) {
        camera.set_black_level_dn(level)?;
    }
    if let Some(exposure_s) = exposure_s {
        camera.set_exposure_s(exposure_s)?;
    }
    let settings = camera.settings()?;
    let found = known.differences(&camera::info(camera)?);
    if found.is_empty() {
        return Ok(settings);
    }
    let source = CorrectError::Settings(found.join("; "));
    Err(StreamError::Correct { camera: camera.identity().id.clone(), source })
}

/// Pool of recycled buffers for corrected frames, reused once every sink has released them.
#[derive(Default)]
struct Pool(Vec<Arc<Corrected>>);

impl Pool {
    fn free(&mut self, size: (usize, usize)) -> Arc<Corrected> {
        let free = self.0.iter().position(|f| Arc::strong_count(f) == 1 && f.size == size);
        free.map_or_else(
            || {
                let pixels = vec![0; size.0 * size.1];
                Arc::new(Corrected { pixels, size, id: 0, timestamp_ns: None, seen: Seen::default() })
            },
            |at| self.0.swap_remove(at),
        )
    }

    fn keep(&mut self, frame: Arc<Corrected>) {
        self.0.push(frame);
    }
}

/// Counts of a running stream.
struct Tally {
    summary: Summary,
    /// Latency, ns, to three digits.
    latency: Histogram<u64>,
    begun: Instant,
    /// Arrival of the last complete frame.
    last: Instant,
    /// Counts of streams that have ended.
    before: StreamCounts,
    pace: Pace,
    numbers: Numbers,
}

/// Frame numbering that continues if a camera that was found again restarts at 1: numbers are unique within a
/// run.
#[derive(Debug, Default)]
struct Numbers {
    last: u64,
    base: u64,
    begun: bool,
}

impl Numbers {
    fn of(&mut self, id: u64) -> u64 {
        if std::mem::take(&mut self.begun) {
            self.base = if id > self.last { 0 } else { self.last };
        }
        self.last = self.last.max(self.base + id);
        self.base + id
    }
}

/// Estimate of frames taken while nobody received, from the camera's clock, which goes on while the numbers
/// restart.
#[derive(Debug, Default)]
struct Pace {
    /// Number and time of the last frame, ns.
    last: Option<(u64, u64)>,
    period_ns: f64,
    /// Consecutive frames that kept the period.
    steady: u32,
    /// Frames known to be lost since the last one.
    known: u64,
}

/// Consecutive frames that establish a period, and the relative tolerance (`STEADY_PART`).
const STEADY_FRAMES: u32 = 8;
const STEADY_PART: f64 = 0.01;

impl Pace {
    /// Registers a frame; `begun`: the first of an acquisition. Returns the number of frames missed before
    /// it, if the camera keeps a period and its clock has gone on.
    fn take(&mut self, id: u64, timestamp_ns: Option<u64>, begun: bool) -> u64 {
        let known = std::mem::take(&mut self.known);
        let (last, now) = (self.last.take(), timestamp_ns.filter(|t| *t > 0));
        let Some(now) = now else { return 0 };
        self.last = Some((id, now));
        let Some((last_id, last_ns)) = last.filter(|(_, t)| now > *t) else { return 0 };
        let between_ns = (now - last_ns) as f64;
        if begun {
            let steady = self.steady >= STEADY_FRAMES && self.period_ns > 0.0;
            let frames = if steady { (between_ns / self.period_ns).round() - 1.0 } else { 0.0 };
            return (frames.max(0.0) as u64).saturating_sub(known);
        }
        let period_ns = between_ns / id.saturating_sub(last_id).max(1) as f64;
        let kept = (period_ns / self.period_ns - 1.0).abs() < STEADY_PART;
        self.steady = if kept { self.steady + 1 } else { 0 };
        self.period_ns = period_ns;
        0
    }
}

impl Tally {
    fn new(camera: &str) -> Self {
        let latency = Histogram::new(3).unwrap_or_else(|_| unreachable!("three digits are allowed"));
        let summary = Summary { camera: camera.into(), ..Summary::default() };
        let now = Instant::now();
        Self {
            summary,
            latency,
            begun: now,
            last: now,
            before: StreamCounts::default(),
            pace: Pace::default(),
            numbers: Numbers::default(),
        }
    }

    fn refresh(&mut self, now: StreamCounts, pixels: usize, sinks: &[Box<dyn Sink + '_>]) {
        let s = &mut self.summary;
        s.received = self.before;
        s.received.add(now);
        s.seconds = self.begun.elapsed().as_secs_f64();
        s.frames_per_s = s.corrected as f64 / s.seconds.max(1e-9);
        s.bytes_per_s = s.frames_per_s * 2.0 * pixels as f64;
        let ms = |ns: u64| ns as f64 * 1e-6;
        s.latency = (!self.latency.is_empty()).then(|| Latency {
            median_ms: ms(self.latency.value_at_quantile(0.5)),
            p99_ms: ms(self.latency.value_at_quantile(0.99)),
            worst_ms: ms(self.latency.max()),
        });
        s.sinks = sinks.iter().map(|s| (s.name().into(), s.counts())).collect();
    }
}

/// Returns true if the stream was stopped, or the requested number of frames or time is reached.
fn done(options: &Options, tally: &Tally, stop: &AtomicBool) -> bool {
    stop.load(Ordering::Relaxed)
        || options.frames.is_some_and(|n| tally.summary.corrected >= n)
        || options.duration.is_some_and(|d| tally.begun.elapsed() >= d)
}

/// Corrects a camera's frames until stopped. `open` opens the camera, also after a loss. `tell` receives the
/// summary once a second, before the camera is stopped, and at the end.
///
/// # Errors
///
/// The camera is absent at the start or stays away, the calibration does not hold for it, or a sink reports
/// an error.
pub fn run(
    open: &mut dyn FnMut() -> Result<Box<dyn Camera>, CameraError>,
    calibration: &Calibration,
    options: &Options,
    sinks: &mut [Box<dyn Sink + '_>],
    tell: &mut dyn FnMut(&Summary),
    stop: &AtomicBool,
) -> Result<Summary, StreamError> {
    let mut camera = open()?;
    let identity = camera.identity().clone();
    // After a power cycle the camera may have another exposure, so it is set again.
    let exposure_s = prepare(&mut *camera, calibration, options.exposure_s)?.exposure_s;
    let mut reopen = || -> Result<Box<dyn Camera>, StreamError> {
        let mut camera = open()?;
        prepare(&mut *camera, calibration, Some(exposure_s))?;
        Ok(camera)
    };
    let mut tally = Tally::new(&identity.id);
    let corrector = Corrector::new(calibration, exposure_s)
        .map_err(|source| StreamError::Correct { camera: identity.id.clone(), source })?;
    let corrector =
        if options.replace_defects { corrector.replacing_defects(calibration) } else { corrector };
    let (codes, limit) = meaning(calibration, &corrector, options);
    let job = Job { corrector, calibration, codes, limit, exposure_s, options, stop };
    loop {
        let ended = job.stream(&mut *camera, &mut tally, sinks, tell);
        match ended {
            Ok(()) => break,
            // The end of a recording is no error, except before the first frame.
            Err(StreamError::Camera(CameraError::Ended { message, .. })) if tally.summary.corrected > 0 => {
                tracing::info!(message, "the recording has ended");
                break;
            }
            Err(StreamError::Camera(e @ (CameraError::Lost { .. } | CameraError::Timeout { .. }))) => {
                tracing::warn!(error = %e, "the stream is begun anew");
                drop(camera);
                match find(&mut reopen, options, stop, &e)? {
                    Some(found) if found.identity().serial == identity.serial => camera = found,
                    Some(other) => {
                        let message = format!("another camera answers there: {}", other.identity());
                        return Err(CameraError::Absent { camera: identity.id, message }.into());
                    }
                    None => break,
                }
                tally.summary.reconnections += 1;
                tally.summary.away_s += tally.last.elapsed().as_secs_f64();
            }
            Err(e) => return Err(e),
        }
    }
    for sink in sinks.iter_mut() {
        sink.finish()?;
    }
    tally.refresh(StreamCounts::default(), calibration.k.len(), sinks);
    tell(&tally.summary);
    Ok(tally.summary)
}

/// Returns the meaning of the codes, and the largest code.
pub fn meaning(calibration: &Calibration, corrector: &Corrector, options: &Options) -> (Codes, u16) {
    match options.codes {
        Some(codes) => (codes, u16::MAX),
        None => {
            let offset = corrector.dark_dn().round();
            (Codes { scale: 1.0, offset }, calibration.description.camera.full_scale_dn())
        }
    }
}

/// Searches for a lost camera. `None`: stopped.
fn find(
    reopen: &mut dyn FnMut() -> Result<Box<dyn Camera>, StreamError>,
    options: &Options,
    stop: &AtomicBool,
    lost: &CameraError,
) -> Result<Option<Box<dyn Camera>>, StreamError> {
    let begun = Instant::now();
    loop {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        match reopen() {
            Ok(camera) => {
                tracing::warn!(away_s = begun.elapsed().as_secs_f64(), "the camera is back");
                return Ok(Some(camera));
            }
            // A camera whose settings cannot be restored is not the one that was calibrated.
            Err(e @ StreamError::Correct { .. }) => return Err(e),
            Err(e) if begun.elapsed() >= options.patience => {
                tracing::warn!(error = %e, "given up");
                let CameraError::Lost { camera, message } = lost else { return Err(e) };
                let message = format!("{message}; it did not come back: {e}");
                return Err(CameraError::Lost { camera: camera.clone(), message }.into());
            }
            Err(e) => tracing::debug!(error = %e, "not back yet"),
        }
        let again = Instant::now() + LOOK_EVERY;
        while Instant::now() < again && !stop.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// Constants of a run.
struct Job<'a> {
    corrector: Corrector,
    calibration: &'a Calibration,
    codes: Codes,
    limit: u16,
    exposure_s: f64,
    options: &'a Options,
    stop: &'a AtomicBool,
}

impl Job<'_> {
    /// Runs one acquisition, until it is done or fails.
    fn stream(
        &self,
        camera: &mut dyn Camera,
        tally: &mut Tally,
        sinks: &mut [Box<dyn Sink + '_>],
        tell: &mut dyn FnMut(&Summary),
    ) -> Result<(), StreamError> {
        let mut stream = camera.stream(&self.options.stream)?;
        let (mut pool, mut memory) = (Pool::default(), Frame::new(0, 0));
        let mut told = Instant::now();
        let timeout = camera::patience(self.exposure_s);
        tally.last = Instant::now();
        let pixels = self.corrector.shape().0 * self.corrector.shape().1;
        let (mut begun, mut lost) = (true, 0);
        tally.numbers.begun = true;
        let outcome = loop {
            if done(self.options, tally, self.stop) {
                break Ok(());
            }
            if told.elapsed() >= Duration::from_secs(1) {
                told = Instant::now();
                tally.refresh(stream.counts(), pixels, sinks);
                tell(&tally.summary);
            }
            let mut taken = None;
            let numbers = &mut tally.numbers;
            // Short timeout: Ctrl-C and the end of a duration do not wait for a silent camera.
            let wait = Duration::from_millis(200);
            let got = stream.next_arrived(&mut memory, wait, &mut |arrived| match arrived {
                Ok(a) => {
                    let handed = Instant::now();
                    let mut frame = pool.free(a.size);
                    let Some(into) = Arc::get_mut(&mut frame) else { return };
                    let (codes, limit) = (self.codes, self.limit);
                    let seen =
                        self.corrector.arrived_to_u16(a.format, a.bytes, codes, limit, &mut into.pixels);
                    (into.id, into.timestamp_ns) = (numbers.of(a.id), a.timestamp_ns);
                    into.seen = seen.clone().unwrap_or_default();
                    taken = Some(seen.map(|_| (frame, a.age.map(|age| age + handed.elapsed()))));
                }
                Err(why) => tracing::info!(why, "damaged frame discarded"),
            });
            match got {
                Ok(()) | Err(CameraError::Timeout { .. })
                    if taken.is_none() && tally.last.elapsed() < timeout =>
                {
                    continue;
                }
                Ok(()) if taken.is_none() => {
                    let counts = format!(
                        "{} damaged; check the packet size against the network's MTU, cable and switch",
                        stream.counts().failures
                    );
                    let (camera, seconds) =
                        (tally.summary.camera.clone(), tally.last.elapsed().as_secs_f64());
                    break Err(CameraError::Timeout { camera, seconds, counts }.into());
                }
                Ok(()) => tally.last = Instant::now(),
                Err(e) => break Err(e.into()),
            }
            let Some(corrected) = taken else { continue };
            let (frame, age) = match corrected {
                Ok(frame) => frame,
                Err(source) => {
                    break Err(StreamError::Correct { camera: tally.summary.camera.clone(), source });
                }
            };
            if let Some(age) = age {
                // The histogram grows with its values.
                let _ = tally.latency.record(u64::try_from(age.as_nanos()).unwrap_or(u64::MAX));
            }
            tally.summary.mean_dn = frame.seen.mean_dn();
            // A wrong calibration is reported at the first frame only; later the line continues.
            if tally.summary.corrected == 0
                && !self.options.force
                && let Err(source) =
                    self.corrector.is_lit(self.calibration, self.exposure_s, tally.summary.mean_dn)
            {
                break Err(StreamError::Correct { camera: tally.summary.camera.clone(), source });
            }
            tally.summary.corrected += 1;
            tally.before.missing += tally.pace.take(frame.id, frame.timestamp_ns, std::mem::take(&mut begun));
            lost = stream.counts().lost();
            let taken = sinks.iter_mut().try_for_each(|sink| sink.take(&frame));
            pool.keep(frame);
            if let Err(e) = taken {
                break Err(e);
            }
        };
        // Reported before the camera is stopped, which takes time.
        tally.refresh(stream.counts(), pixels, sinks);
        tell(&tally.summary);
        let counts = stream.counts();
        tally.pace.known = counts.lost().saturating_sub(lost);
        tally.before.add(counts);
        outcome
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_frames_of_a_run_have_one_number() {
        let mut numbers = Numbers { begun: true, ..Numbers::default() };
        assert_eq!([5, 6, 9, 8].map(|id| numbers.of(id)), [5, 6, 9, 8]);
        numbers.begun = true;
        assert_eq!([1, 2].map(|id| numbers.of(id)), [10, 11]);
        numbers.begun = true;
        assert_eq!([12, 13].map(|id| numbers.of(id)), [12, 13]);
    }

    #[test]
    fn frames_of_an_interval_without_the_camera_are_counted() {
        let mut pace = Pace::default();
        for n in 0..20 {
            assert_eq!(pace.take(1 + n, Some(1000 + 10 * n), n == 0), 0);
        }
        // 30 periods later the numbers restart: 29 frames were missed, 2 of which are known already.
        pace.known = 2;
        assert_eq!(pace.take(1, Some(1190 + 300), true), 27);
        assert_eq!(pace.take(2, Some(1500), false), 0);
        // No estimate from a clock that restarted, a missing time, or a camera without a period.
        assert_eq!(pace.take(1, Some(5), true), 0);
        assert_eq!((pace.take(2, None, false), pace.take(3, Some(900), true)), (0, 0));
        let mut odd = Pace::default();
        for (n, t) in [3, 4, 9, 11, 20, 33, 34, 50, 61, 70].into_iter().enumerate() {
            odd.take(n as u64, Some(t), n == 0);
        }
        assert_eq!(odd.take(1, Some(900), true), 0);
    }
}
