//! Long work: one piece at a time, with its progress, and an end that can be asked for.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Work that runs.
pub struct Job {
    /// What it is, in words.
    pub what: String,
    /// Set to end it.
    pub stop: Arc<AtomicBool>,
    done: AtomicUsize,
    of: AtomicUsize,
}

impl Job {
    /// Work that has just begun.
    pub fn new(what: impl Into<String>) -> Arc<Self> {
        Arc::new(Self { what: what.into(), stop: Arc::default(), done: 0.into(), of: 0.into() })
    }

    /// Pieces done, of so many.
    pub fn step(&self, done: usize, of: usize) {
        self.done.store(done, Ordering::Relaxed);
        self.of.store(of, Ordering::Relaxed);
    }

    /// Pieces done and of how many; 0 where that is not known.
    pub fn progress(&self) -> (usize, usize) {
        (self.done.load(Ordering::Relaxed), self.of.load(Ordering::Relaxed))
    }

    /// Whether its end was asked for.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}
