//! A camera's frames, corrected as they come, for as long as the line runs.
//!
//! The bytes that the camera sends are unpacked, corrected and looked at in one pass where they lie. What is
//! not fast enough never makes the camera wait: of frames that wait the oldest is dropped, and counted. A
//! camera that is lost is looked for until it is back.

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

/// Time between two attempts to find a lost camera.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// How a stream is corrected.
#[derive(Debug, Clone)]
pub struct Options {
    /// What the codes mean; `None`: as the camera has them, one code for a DN, with the mean of the dark
    /// reference as the black level, and none above its full scale.
    pub codes: Option<Codes>,
    /// Replace flagged pixels.
    pub replace_defects: bool,
    /// Go on although frames are darker than the dark reference.
    pub force: bool,
    /// Exposure, s; `None`: the one at which the camera stands.
    pub exposure_s: Option<f64>,
    /// The stream of the camera. Frames that wait are bounded.
    pub stream: StreamOptions,
    /// End after so many corrected frames.
    pub frames: Option<u64>,
    /// End after this time.
    pub duration: Option<Duration>,
    /// How long a lost camera is looked for before it is given up.
    pub patience: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            codes: None,
            replace_defects: false,
            force: false,
            exposure_s: None,
            // Frames that wait for lost packets hold their buffers: 100 ms at 160 frames a second.
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

/// A corrected frame.
#[derive(Debug, Clone)]
pub struct Corrected {
    /// Codes, row by row.
    pub pixels: Vec<u16>,
    /// Columns and rows.
    pub size: (usize, usize),
    /// Number by the camera's count, as [`Frame::id`]; of a camera that was lost and begins at 1 again, from
    /// the last number on.
    pub id: u64,
    /// Device clock, ns, where the camera tells.
    pub timestamp_ns: Option<u64>,
    /// What was seen of the raw frame.
    pub seen: Seen,
}

/// Where corrected frames go.
pub trait Sink {
    /// What [`Summary::sinks`] calls it.
    fn name(&self) -> &'static str;

    /// Takes a frame, without making the stream wait.
    ///
    /// # Errors
    ///
    /// What makes going on useless: a full disk.
    fn take(&mut self, frame: &Arc<Corrected>) -> Result<(), StreamError>;

    /// What became of the frames.
    fn counts(&self) -> SinkCounts;

    /// Waits until all that was taken is done with.
    ///
    /// # Errors
    ///
    /// As [`take`](Self::take).
    fn finish(&mut self) -> Result<(), StreamError> {
        Ok(())
    }
}

/// Frames of a sink.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct SinkCounts {
    /// Done with.
    pub taken: u64,
    /// Dropped, because the sink was slower than the camera.
    pub dropped: u64,
}

/// Time from a frame's first packet to its corrected pixels, ms.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Latency {
    /// Half of the frames were faster.
    pub median_ms: f64,
    /// 99 of 100 frames were faster.
    pub p99_ms: f64,
    /// The slowest.
    pub worst_ms: f64,
}

/// What a stream did.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Summary {
    /// Which camera.
    pub camera: String,
    /// What came.
    pub received: StreamCounts,
    /// Frames corrected.
    pub corrected: u64,
    /// How often the camera was lost and found again, or its stream begun anew.
    pub reconnections: u64,
    /// Time without the camera, s. What it sent then is not known.
    pub away_s: f64,
    /// Time of the whole run, s.
    pub seconds: f64,
    /// Frames corrected per second.
    pub frames_per_s: f64,
    /// Raw pixels corrected, bytes per second in 16-bit codes.
    pub bytes_per_s: f64,
    /// `None` where the backend does not tell when a frame came.
    pub latency: Option<Latency>,
    /// Mean of the last raw frame, DN.
    pub mean_dn: f64,
    /// What became of the corrected frames, by sink.
    pub sinks: BTreeMap<String, SinkCounts>,
}

impl Summary {
    /// Whether every frame that the camera sent came through to every sink.
    pub fn is_whole(&self) -> bool {
        self.received.lost() == 0 && self.reconnections == 0 && self.sinks.values().all(|s| s.dropped == 0)
    }
}

/// Why a stream ended before it should.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StreamError {
    /// The camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The calibration.
    #[error("camera {camera}: {source}")]
    Correct {
        /// Which camera.
        camera: String,
        /// What does not fit.
        source: CorrectError,
    },
    /// Corrected frames cannot be written.
    #[error("{}: {message}", path.display())]
    Files {
        /// Which file.
        path: PathBuf,
        /// Why.
        message: String,
    },
    /// Corrected frames cannot be written.
    #[error(transparent)]
    Dataset(#[from] Box<DatasetError>),
}

/// Brings a camera to what a calibration holds for: switches off what distorts, sets format, region, gain and
/// black level, and the exposure where one is given.
///
/// # Errors
///
/// What the camera refuses, and what still differs.
pub fn prepare(
    camera: &mut dyn Camera,
    calibration: &Calibration,
    exposure_s: Option<f64>,
) -> Result<Settings, StreamError> {
    let known = &calibration.description.camera;
    // Who it is, before any setting is touched.
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

/// Memory for corrected frames, used again once every sink has let go.
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

/// What is counted while it runs.
struct Tally {
    summary: Summary,
    /// Nanoseconds, to three digits.
    latency: Histogram<u64>,
    begun: Instant,
    /// The last whole frame.
    last: Instant,
    /// Of streams that have ended.
    before: StreamCounts,
    pace: Pace,
    numbers: Numbers,
}

/// Frame numbers that go on where a camera that was found again begins at 1: no frame of a run has the number
/// of another.
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

/// Frames a camera took while nobody received, by its clock: it goes on while the numbers begin anew.
#[derive(Debug, Default)]
struct Pace {
    /// Number and time of the last frame, ns.
    last: Option<(u64, u64)>,
    period_ns: f64,
    /// Frames in a row that kept the period.
    steady: u32,
    /// Frames known to be lost since the last.
    known: u64,
}

/// Frames in a row that make a period, and the part by which they may differ.
const STEADY_FRAMES: u32 = 8;
const STEADY_PART: f64 = 0.01;

impl Pace {
    /// Takes a frame; `begun`: the first of an acquisition. The frames that were missed before it, where the
    /// camera keeps a period and its clock has gone on.
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

/// Whether it is done: stopped, or as many frames or as long as asked for.
fn done(options: &Options, tally: &Tally, stop: &AtomicBool) -> bool {
    stop.load(Ordering::Relaxed)
        || options.frames.is_some_and(|n| tally.summary.corrected >= n)
        || options.duration.is_some_and(|d| tally.begun.elapsed() >= d)
}

/// Corrects a camera's frames until it is told to stop. `open` opens the camera, and again where it was lost;
/// `tell` hears how it stands once a second, before the camera is stopped, and at the end.
///
/// # Errors
///
/// Where the camera is not there at the start or stays away, where the calibration does not hold for it, and
/// what a sink says.
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
    // After a power cycle the camera comes back with another exposure: it is set again.
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
            // A recording ends; one that never began is an error.
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

/// What codes mean, and the largest of them.
pub fn meaning(calibration: &Calibration, corrector: &Corrector, options: &Options) -> (Codes, u16) {
    match options.codes {
        Some(codes) => (codes, u16::MAX),
        None => {
            let offset = corrector.dark_dn().round();
            (Codes { scale: 1.0, offset }, calibration.description.camera.full_scale_dn())
        }
    }
}

/// Looks for a camera that was lost. `None`: told to stop.
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
            // A camera that came back with settings that cannot be set back is not the one that was calibrated.
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

/// What does not change while it runs.
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
    /// One acquisition, until it is done or fails.
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
            // Short waits: Ctrl-C and the end of a duration do not wait for a camera that is silent.
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
                // It grows with what is put in.
                let _ = tally.latency.record(u64::try_from(age.as_nanos()).unwrap_or(u64::MAX));
            }
            tally.summary.mean_dn = frame.seen.mean_dn();
            // At the first frame a wrong calibration is told; later a line goes on.
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
        // Before the camera is stopped, which takes its time.
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
        // 30 periods later its numbers begin anew: 29 frames were missed, 2 of which are known already.
        pace.known = 2;
        assert_eq!(pace.take(1, Some(1190 + 300), true), 27);
        assert_eq!(pace.take(2, Some(1500), false), 0);
        // A clock that began anew, one that tells nothing, and a camera without a period say nothing.
        assert_eq!(pace.take(1, Some(5), true), 0);
        assert_eq!((pace.take(2, None, false), pace.take(3, Some(900), true)), (0, 0));
        let mut odd = Pace::default();
        for (n, t) in [3, 4, 9, 11, 20, 33, 34, 50, 61, 70].into_iter().enumerate() {
            odd.take(n as u64, Some(t), n == 0);
        }
        assert_eq!(odd.take(1, Some(900), true), 0);
    }
}
