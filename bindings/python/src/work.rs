//! Long work: without the GIL, interruptible by Ctrl-C, with progress.

use pyo3::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Polling interval for Ctrl-C, short enough to feel immediate.
const LOOK: Duration = Duration::from_millis(50);
/// Time for stopped work to end (a frame being read). Computation that does not check the flag is left
/// running.
const PATIENCE: Duration = Duration::from_secs(2);

/// Stop flag and progress channel for the work.
#[derive(Clone)]
pub struct Watch {
    /// Set by Ctrl-C.
    pub stop: Arc<AtomicBool>,
    tell: Sender<(usize, usize)>,
}

impl Watch {
    /// Reports progress: `done` of `of` pieces.
    pub fn step(&self, done: usize, of: usize) {
        let _ = self.tell.send((done, of));
    }
}

/// Process that owns the worker threads; 0 before there are any.
static PROCESS: AtomicU32 = AtomicU32::new(0);

/// Rejects work after a fork: the new process has no threads, and waiting for them would never end.
pub fn own_threads() -> PyResult<()> {
    let now = std::process::id();
    match PROCESS.compare_exchange(0, now, Ordering::Relaxed, Ordering::Relaxed) {
        Err(of) if of != now => Err(crate::errors::RadcamError::new_err(
            "this process was forked from one that used radcam, whose threads it does not have: start it with \
             multiprocessing.get_context(\"spawn\")",
        )),
        _ => Ok(()),
    }
}

/// Runs work on a separate thread and waits for it. `progress` is called with (done, of).
pub fn run<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Watch) -> PyResult<T> + Send + 'static,
) -> PyResult<T> {
    own_threads()?;
    crate::logs::begin();
    let (tell, told) = channel();
    let told = Mutex::new(told);
    let watch = Watch { stop: Arc::new(AtomicBool::new(false)), tell };
    let stop = Arc::clone(&watch.stop);
    let thread = std::thread::spawn(move || work(&watch));
    let ended = |patience: Duration| {
        let from = std::time::Instant::now();
        while !thread.is_finished() && from.elapsed() < patience {
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    let mut raised = None;
    loop {
        match py.detach(|| told.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(LOOK)) {
            Ok((done, of)) => {
                if let Some(progress) = progress
                    && let Err(e) = progress.call1((done, of))
                {
                    raised = Some(e);
                }
            }
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {}
        }
        if let Err(e) = py.check_signals() {
            raised = Some(e);
        }
        if raised.is_some() {
            stop.store(true, Ordering::SeqCst);
            py.detach(|| ended(PATIENCE));
            break;
        }
    }
    if let Some(e) = raised {
        return Err(e);
    }
    match py.detach(|| thread.join()) {
        Ok(done) => {
            crate::effect::raised()?;
            done
        }
        Err(_) => Err(crate::errors::RadcamError::new_err(
            "a fault of radcam: its message is on standard error; please report it",
        )),
    }
}
