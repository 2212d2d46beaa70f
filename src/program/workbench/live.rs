//! Camera thread of the workbench. It owns the camera, shows the live picture while a client watches, changes
//! settings, and captures.

use super::job::Job;
use crate::bench::{self, Illuminator, ManualBench};
use crate::camera::{Camera, Capabilities, Settings, StreamOptions};
use crate::capture::{Capture, CaptureError, PLAN_FILE};
use crate::frame::{Frame, Region, Status};
use crate::plan::{BenchState, Plan};
use std::io::{BufRead, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Locks a mutex and ignores poisoning: no holder leaves the data inconsistent.
pub fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Order to the camera thread.
pub enum Order {
    /// Sets the exposure, s.
    Exposure(f64),
    /// Sets the gain, dB.
    Gain(f64),
    /// Sets the region of interest.
    Region(Region),
    /// Sets the relative light of the bench.
    Light(f64),
    /// Ends the thread: the camera is stopped and released.
    End,
    /// Captures a plan into a folder, or extends the campaign in it.
    Capture {
        /// Plan to capture.
        plan: Box<Plan>,
        /// Output folder.
        folder: PathBuf,
        /// True to extend the existing campaign.
        extend: bool,
        /// Progress and cancellation.
        job: Arc<Job>,
    },
}

/// Live picture with its predecessor.
#[derive(Clone)]
pub struct Picture {
    /// Sequence number of the picture.
    pub number: u64,
    /// Current frame.
    pub frame: Arc<Frame>,
    /// Preceding frame.
    before: Option<Arc<Frame>>,
    /// Largest code, DN.
    pub full_dn: u16,
}

impl Picture {
    /// Returns the mean, DN.
    pub fn mean_dn(&self) -> f64 {
        self.frame.pixels.iter().map(|v| f64::from(*v)).sum::<f64>() / self.frame.pixels.len() as f64
    }

    /// Counts the pixels at the largest code.
    pub fn saturated(&self) -> usize {
        self.frame.pixels.iter().filter(|v| **v >= self.full_dn).count()
    }

    /// Returns the temporal variance of a pixel from this frame and the preceding one, DN^2; NaN without a
    /// preceding frame of the same size.
    pub fn var_dn2(&self) -> f64 {
        self.before.as_ref().map_or(f64::NAN, |before| difference_variance(before, &self.frame))
    }
}

/// Question to the bench operator, with its answer.
#[derive(Default)]
pub struct Operator {
    state: Mutex<Asked>,
    changed: Condvar,
}

#[derive(Default)]
struct Asked {
    /// Number of the question; an answer refers to one question.
    number: u64,
    question: Option<String>,
    answer: Option<bool>,
}

impl Operator {
    /// Returns the open question with its number.
    pub fn question(&self) -> Option<(u64, String)> {
        let state = lock(&self.state);
        state.question.clone().filter(|_| state.answer.is_none()).map(|q| (state.number, q))
    }

    /// Answers the question with this number: done, or given up. Other numbers are ignored.
    pub fn answer(&self, number: u64, done: bool) {
        let mut state = lock(&self.state);
        if state.question.is_some() && state.number == number && state.answer.is_none() {
            state.answer = Some(done);
            self.changed.notify_all();
        }
    }

    /// Gives up the open question, if any.
    pub fn give_up(&self) {
        if let Some((number, _)) = self.question() {
            self.answer(number, false);
        }
    }
}

/// Adapter that lets a manual bench ask its questions and read its answers through the page.
struct Page(Arc<Operator>, Arc<dyn Fn() + Send + Sync>);

impl Write for Page {
    fn write(&mut self, text: &[u8]) -> std::io::Result<usize> {
        let said = String::from_utf8_lossy(text);
        let said = said.split(", then press Enter").next().unwrap_or_default();
        if !said.trim().is_empty() {
            let mut state = lock(&self.0.state);
            if state.question.is_none() {
                state.number += 1;
            }
            let before = state.question.take().unwrap_or_default();
            state.question = Some(before + said);
        }
        (self.1)();
        Ok(text.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Read for Page {
    fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
        Ok(0)
    }
}

impl BufRead for Page {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        let mut state = lock(&self.0.state);
        while state.answer.is_none() {
            state = self.0.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        Ok(if state.answer == Some(true) { b"\n" } else { b"q\n" })
    }

    fn consume(&mut self, _: usize) {
        let mut state = lock(&self.0.state);
        (state.question, state.answer) = (None, None);
        drop(state);
        (self.1)();
    }
}

/// State shared by the camera thread and the pages.
pub struct Live {
    /// Identity of the camera.
    pub identity: String,
    /// Camera ID, for opening it again.
    pub id: String,
    /// Capabilities of the camera.
    pub capabilities: Capabilities,
    orders: Mutex<Sender<Ordered>>,
    state: Mutex<State>,
    shown: tokio::sync::watch::Sender<u64>,
    /// Number of requests that wait for a picture.
    waiting: AtomicUsize,
    thread: Mutex<Option<std::thread::JoinHandle<()>>>,
    /// Question to the bench operator.
    pub operator: Arc<Operator>,
}

struct State {
    picture: Option<Picture>,
    settings: Option<Settings>,
    light: f64,
    /// Time of the last request for a picture.
    looked: Option<Instant>,
    error: Option<String>,
}

/// Time after the last request at which a client counts as gone.
const LOOKS: Duration = Duration::from_secs(2);
/// Minimum interval between pictures; more than 40 per second are not visible.
const BETWEEN: Duration = Duration::from_millis(25);

impl Live {
    /// Opens the camera and starts its thread. Calls `changed` when the pages should update.
    pub fn start(
        mut camera: Box<dyn Camera>,
        options: StreamOptions,
        changed: Arc<dyn Fn() + Send + Sync>,
    ) -> Arc<Self> {
        let (orders, todo) = channel();
        let (shown, _) = tokio::sync::watch::channel(0);
        let settings = camera.settings().ok();
        let live = Arc::new(Self {
            identity: camera.identity().to_string(),
            id: camera.identity().id.clone(),
            capabilities: camera.capabilities().clone(),
            orders: Mutex::new(orders),
            state: Mutex::new(State { picture: None, settings, light: 1.0, looked: None, error: None }),
            shown,
            waiting: AtomicUsize::new(0),
            thread: Mutex::new(None),
            operator: Arc::default(),
        });
        let shared = live.clone();
        let thread = std::thread::spawn(move || {
            Thread { camera, options, live: shared, changed, last: None }.run(&todo)
        });
        *lock(&live.thread) = Some(thread);
        live
    }

    /// Stops and releases the camera after the work in flight.
    pub fn end(&self) {
        self.operator.give_up();
        let _ = self.order(Order::End);
        if let Some(thread) = lock(&self.thread).take() {
            let _ = thread.join();
        }
    }

    /// Sends an order and waits for the answer.
    ///
    /// # Errors
    ///
    /// The camera or the bench refused the order.
    pub fn order(&self, order: Order) -> Result<String, String> {
        let (answer, got) = channel();
        let gone = || "the camera's thread has ended".to_string();
        lock(&self.orders).send((order, answer)).map_err(|_| gone())?;
        got.recv().map_err(|_| gone())?
    }

    /// Waits for a picture newer than `number` and returns the newest one; none after a timeout.
    pub async fn picture(&self, number: u64) -> Option<Picture> {
        let exposure_s = lock(&self.state).settings.as_ref().map_or(0.0, |s| s.exposure_s);
        let patience = crate::camera::patience(exposure_s);
        let mut shown = self.shown.subscribe();
        let waits = Waits::new(&self.waiting);
        let newer = tokio::time::timeout(patience, shown.wait_for(|n| *n > number)).await;
        lock(&self.state).looked = Some(Instant::now());
        drop(waits);
        newer.ok()?.ok()?;
        lock(&self.state).picture.clone()
    }

    /// Returns the settings last reported by the camera, the light, and the last error.
    pub fn state(&self) -> (Option<Settings>, f64, Option<String>) {
        let state = lock(&self.state);
        (state.settings.clone(), state.light, state.error.clone())
    }

    fn is_looked_at(&self) -> bool {
        self.waiting.load(Ordering::Relaxed) > 0
            || lock(&self.state).looked.is_some_and(|t| t.elapsed() < LOOKS)
    }

    /// Shows a frame, unless the last picture is too recent.
    fn show(&self, frame: &Frame, full_dn: u16, last: &mut Option<Instant>) {
        if !self.is_looked_at() || last.is_some_and(|t| t.elapsed() < BETWEEN) {
            return;
        }
        *last = Some(Instant::now());
        // Clients compute the statistics of the picture: this thread may be capturing.
        let frame = Arc::new(frame.clone());
        let mut state = lock(&self.state);
        let before = state.picture.take();
        let number = before.as_ref().map_or(0, |p| p.number) + 1;
        state.picture = Some(Picture { number, frame, before: before.map(|p| p.frame), full_dn });
        drop(state);
        self.shown.send_replace(number);
    }
}

/// Guard that counts a waiting request until it ends.
struct Waits<'a>(&'a AtomicUsize);

impl<'a> Waits<'a> {
    fn new(count: &'a AtomicUsize) -> Self {
        count.fetch_add(1, Ordering::Relaxed);
        Self(count)
    }
}

impl Drop for Waits<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Returns half the variance of the difference of two frames, DN^2: the temporal variance of a pixel (EMVA
/// 1288 release 4.0 Linear, eq. 19).
fn difference_variance(a: &Frame, b: &Frame) -> f64 {
    if a.pixels.dim() != b.pixels.dim() || a.pixels.is_empty() {
        return f64::NAN;
    }
    let (mut sum, mut squares) = (0i64, 0i64);
    for (a, b) in a.pixels.iter().zip(&b.pixels) {
        let d = i64::from(*a) - i64::from(*b);
        (sum, squares) = (sum + d, squares + d * d);
    }
    let n = a.pixels.len() as f64;
    0.5 * (squares as f64 / n - (sum as f64 / n).powi(2))
}

/// Returns true if a folder holds an incomplete capture: fewer frames than in its plan.
pub fn is_incomplete(folder: &Path) -> bool {
    let Ok(text) = crate::input::settings(&folder.join(PLAN_FILE)) else { return false };
    let Ok(plan) = Plan::from_toml(&text) else { return false };
    let rows =
        crate::input::table(&folder.join("frames.csv")).map_or(0, |t| t.lines().count().saturating_sub(1));
    (rows as u64) < plan.frames()
}

struct Thread {
    camera: Box<dyn Camera>,
    options: StreamOptions,
    live: Arc<Live>,
    changed: Arc<dyn Fn() + Send + Sync>,
    last: Option<Instant>,
}

/// Order with the channel for its answer.
type Ordered = (Order, Sender<Result<String, String>>);
type Orders = Receiver<Ordered>;

impl Thread {
    fn run(mut self, orders: &Orders) {
        loop {
            match orders.recv_timeout(Duration::from_millis(50)) {
                Ok((order, answer)) => {
                    if self.carry_out(order, &answer) {
                        return;
                    }
                }
                Err(RecvTimeoutError::Disconnected) => return,
                Err(RecvTimeoutError::Timeout) => {}
            }
            while self.live.is_looked_at() {
                match self.look(orders) {
                    Ok(Some((order, answer))) => {
                        if self.carry_out(order, &answer) {
                            return;
                        }
                    }
                    Ok(None) => break,
                    Err(e) => {
                        lock(&self.live.state).error = Some(e);
                        (self.changed)();
                        std::thread::sleep(Duration::from_secs(1));
                        break;
                    }
                }
            }
        }
    }

    /// Streams frames until an order arrives or no client watches.
    fn look(&mut self, orders: &Orders) -> Result<Option<Ordered>, String> {
        let settings = self.camera.settings().map_err(|e| e.to_string())?;
        let full = settings.pixel_format.full_scale_dn();
        let wait = crate::camera::patience(settings.exposure_s);
        let mut frame = Frame::new(settings.region.width as usize, settings.region.height as usize);
        lock(&self.live.state).settings = Some(settings);
        let mut stream = self.camera.stream(&self.options).map_err(|e| e.to_string())?;
        loop {
            if let Ok(order) = orders.try_recv() {
                return Ok(Some(order));
            }
            if !self.live.is_looked_at() {
                return Ok(None);
            }
            stream.next(&mut frame, wait).map_err(|e| e.to_string())?;
            if frame.status == Status::Complete {
                self.live.show(&frame, full, &mut self.last);
                lock(&self.live.state).error = None;
            }
            // A simulated camera runs as fast as the machine allows; leave time for the pages.
            if let Some(rest) = self.last.and_then(|t| BETWEEN.checked_sub(t.elapsed())) {
                std::thread::sleep(rest.min(Duration::from_millis(5)));
            }
        }
    }

    /// Executes an order and sends the answer. Returns true after the last order.
    fn carry_out(&mut self, order: Order, answer: &Sender<Result<String, String>>) -> bool {
        let last = matches!(order, Order::End);
        let said = match order {
            Order::End => Ok("ended".into()),
            Order::Exposure(s) => {
                self.camera.set_exposure_s(s).map(|s| format!("exposure {s} s")).map_err(|e| e.to_string())
            }
            Order::Gain(db) => {
                self.camera.set_gain_db(db).map(|db| format!("gain {db} dB")).map_err(|e| e.to_string())
            }
            Order::Region(region) => self
                .camera
                .set_region(region)
                .map(|r| format!("region {} × {} at {}, {}", r.width, r.height, r.x, r.y))
                .map_err(|e| e.to_string()),
            Order::Light(light) => self.light(light),
            Order::Capture { plan, folder, extend, job } => {
                self.capture(&plan, &folder, extend, &job).map(|()| "captured".into())
            }
        };
        let _ = answer.send(said);
        if !last {
            self.refresh();
        }
        last
    }

    fn refresh(&mut self) {
        if let Ok(settings) = self.camera.settings() {
            lock(&self.live.state).settings = Some(settings);
        }
        (self.changed)();
    }

    fn bench(&mut self, plan: &Plan) -> Box<dyn Illuminator> {
        let (operator, changed) = (self.live.operator.clone(), self.changed.clone());
        let page = move || -> Box<dyn Illuminator> {
            Box::new(ManualBench::new(Page(operator.clone(), changed.clone()), Page(operator, changed)))
        };
        bench::of_or(&mut *self.camera, plan, page)
    }

    fn light(&mut self, illumination: f64) -> Result<String, String> {
        let mut bench = self.bench(&Plan::quick());
        if !bench.moves_itself() {
            return Err("this bench is moved by hand: set the light there".into());
        }
        let state = bench.apply(&BenchState { illumination, ..Default::default() }, &mut *self.camera);
        let reached = state.map_err(|e| e.to_string())?.illumination;
        lock(&self.live.state).light = reached;
        Ok(format!("light {reached}"))
    }

    fn capture(
        &mut self,
        plan: &Plan,
        folder: &std::path::Path,
        extend: bool,
        job: &Job,
    ) -> Result<(), String> {
        let mut bench = self.bench(plan);
        let full = self.camera.settings().map_err(|e| e.to_string())?.pixel_format.full_scale_dn();
        let (live, last) = (self.live.clone(), &mut self.last);
        let mut progress = |p: crate::capture::Progress| job.step(p.frames as usize, p.of as usize);
        let mut shown = |frame: &Frame| live.show(frame, full, last);
        let mut capture = Capture {
            camera: &mut *self.camera,
            bench: &mut *bench,
            options: self.options.clone(),
            stop: &job.stop,
            progress: Some(&mut progress),
            shown: Some(&mut shown),
        };
        let done = if is_incomplete(folder) {
            // Complete an interrupted capture first, by its own plan; this also applies to an extension.
            capture.resume(folder)
        } else if extend {
            capture.extend(plan, folder, None)
        } else {
            capture.run(plan, folder)
        };
        match done {
            Ok(_) => Ok(()),
            Err(CaptureError::Interrupted { frames }) => {
                Err(format!("the capture was ended; {frames} frames are kept, capture again to go on"))
            }
            Err(e) => Err(e.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::sim::{SharedBench, SimCamera};

    /// The page prompts the operator and the bench waits for the answer. Unsolicited answers are ignored.
    #[test]
    fn the_page_asks_for_what_has_to_be_moved() {
        let operator = Arc::new(Operator::default());
        operator.answer(1, true);
        let page = || Page(operator.clone(), Arc::new(|| {}));
        let mut bench = ManualBench::new(page(), page());
        let moved = std::thread::spawn(move || {
            let sensor = radcam_sim::Sensor::new(radcam_sim::sensors::load("cmos12").unwrap()).unwrap();
            let mut camera = SimCamera::new("cmos12", sensor.into(), SharedBench::default());
            let flat = BenchState { illumination: 1.0, configuration: 1, ..BenchState::default() };
            (bench.apply(&flat, &mut camera).is_ok(), bench.apply(&BenchState::default(), &mut camera))
        });
        let mut asked = Vec::new();
        while !moved.is_finished() {
            if let Some((number, question)) = operator.question() {
                // An answer to another question is ignored; the last question is given up.
                operator.answer(number + 1, false);
                operator.answer(number, !question.contains("Cover"));
                asked.push(question);
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        let (lit, dark) = moved.join().unwrap();
        assert!(lit && dark.unwrap_err().to_string().contains("given up"));
        assert!(asked.iter().any(|q| q.contains("Move both card and light")), "{asked:?}");
        assert!(operator.question().is_none());
    }
}
