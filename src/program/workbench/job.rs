//! Jobs: one at a time, with progress and cancellation.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Running job.
pub struct Job {
    /// Description for the page.
    pub what: String,
    /// Set to cancel the job.
    pub stop: Arc<AtomicBool>,
    done: AtomicUsize,
    of: AtomicUsize,
}

impl Job {
    /// Creates a job without progress.
    pub fn new(what: impl Into<String>) -> Arc<Self> {
        Arc::new(Self { what: what.into(), stop: Arc::default(), done: 0.into(), of: 0.into() })
    }

    /// Sets the progress: pieces done, and their total.
    pub fn step(&self, done: usize, of: usize) {
        self.done.store(done, Ordering::Relaxed);
        self.of.store(of, Ordering::Relaxed);
    }

    /// Returns the pieces done and their total; the total is 0 if unknown.
    pub fn progress(&self) -> (usize, usize) {
        (self.done.load(Ordering::Relaxed), self.of.load(Ordering::Relaxed))
    }

    /// Returns true if cancellation was requested.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}
