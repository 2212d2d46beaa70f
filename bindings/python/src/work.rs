//! Long work: without the interpreter's lock, ended by Ctrl-C, with progress.

use pyo3::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Time between two looks at Ctrl-C: a reaction that is felt to be at once.
const LOOK: Duration = Duration::from_millis(50);
/// What work that was told to stop has to end in: a frame being read. Computation that does not look is left to itself.
const PATIENCE: Duration = Duration::from_secs(2);

/// What work is given to look at and to tell.
#[derive(Clone)]
pub struct Watch {
    /// Set by Ctrl-C.
    pub stop: Arc<AtomicBool>,
    tell: Sender<(usize, usize)>,
}

impl Watch {
    /// Pieces done, of so many.
    pub fn step(&self, done: usize, of: usize) {
        let _ = self.tell.send((done, of));
    }
}

/// The process whose threads work here; 0 where there are none yet.
static PROCESS: AtomicU32 = AtomicU32::new(0);

/// Refuses work after a fork: threads do not come with the new process, and what waits for them waits for ever.
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

/// Does work on a thread of its own and waits for it. `progress` is called with (done, of).
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
