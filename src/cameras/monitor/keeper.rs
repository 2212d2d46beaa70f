//! Background writer of the history: a locked or unreachable database neither blocks the monitor nor costs a
//! check.

use super::store::{Store, StoreError};
use super::{Alarm, Check};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Maximum number of queued checks (a week at one per minute). When full, the oldest is dropped.
const MAX_WAITING: usize = 10_000;
/// Retry interval.
const AGAIN: Duration = Duration::from_millis(250);

#[derive(Debug, Default)]
struct Inside {
    waiting: VecDeque<(Check, Vec<Alarm>)>,
    /// Last database error, if nothing was written since.
    refused: Option<String>,
    lost: u64,
    ends: bool,
}

#[derive(Debug, Default)]
struct Shared {
    inside: Mutex<Inside>,
    changed: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Inside> {
        // No code under this lock panics halfway, so a poisoned lock is still consistent.
        self.inside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until `over` is true or the time is up.
    fn wait(&self, time: Duration, over: impl Fn(&Inside) -> bool) -> MutexGuard<'_, Inside> {
        let waited = self.changed.wait_timeout_while(self.lock(), time, |inside| !over(inside));
        waited.unwrap_or_else(PoisonError::into_inner).0
    }
}

/// Writes the checks of a camera on its own thread, in the order in which they were taken.
#[derive(Debug)]
pub struct Keeper(Arc<Shared>);

impl Keeper {
    /// Starts the writer thread for a store.
    pub fn start(mut store: Store, camera: &str, calibration: &str) -> Self {
        let shared = Arc::new(Shared::default());
        let (told, camera, calibration) = (Arc::clone(&shared), camera.to_string(), calibration.to_string());
        std::thread::spawn(move || {
            loop {
                let inside = told.wait(AGAIN, |i| !i.waiting.is_empty() || i.ends);
                let Some((check, alarms)) = inside.waiting.front().cloned() else {
                    if inside.ends {
                        return;
                    }
                    continue;
                };
                drop(inside);
                // Called without the lock: an unreachable database answers late.
                let kept =
                    store.follow().and_then(|()| store.keep_again(&camera, &calibration, &check, &alarms));
                told.written(&check, kept);
            }
        });
        Self(shared)
    }

    /// Queues a check and its alarms for writing.
    pub fn keep(&self, check: Check, alarms: Vec<Alarm>) {
        let mut inside = self.0.lock();
        if inside.waiting.len() >= MAX_WAITING {
            inside.waiting.pop_front();
            inside.lost += 1;
            if inside.lost.is_power_of_two() {
                tracing::error!(
                    lost = inside.lost,
                    "checks lost: the history could not be written for too long"
                );
            }
        }
        inside.waiting.push_back((check, alarms));
        drop(inside);
        self.0.changed.notify_all();
    }

    /// Returns the number of queued checks.
    pub fn waiting(&self) -> usize {
        self.0.lock().waiting.len()
    }

    /// Waits until all checks are written, at most for `patience`.
    ///
    /// # Errors
    ///
    /// The number of checks not written, and the reason.
    pub fn finish(self, patience: Duration) -> Result<(), String> {
        self.0.lock().ends = true;
        self.0.changed.notify_all();
        let inside = self.0.wait(patience, |inside| inside.waiting.is_empty());
        let missing = inside.waiting.len() as u64 + inside.lost;
        if missing == 0 {
            return Ok(());
        }
        let why = inside.refused.as_deref().unwrap_or("the time was too short");
        Err(format!("{missing} checks are not in the history: {why}"))
    }
}

impl Shared {
    /// Records the outcome for the oldest queued check.
    fn written(&self, check: &Check, outcome: Result<(), StoreError>) {
        let mut inside = self.lock();
        match outcome {
            Ok(()) => {
                // The check may have been dropped from a full queue.
                if inside.waiting.front().is_some_and(|(front, _)| front == check) {
                    inside.waiting.pop_front();
                }
                if inside.refused.is_some() && inside.waiting.is_empty() {
                    inside.refused = None;
                    tracing::warn!("the history is written again; no check is waiting");
                }
            }
            Err(e) => {
                if inside.refused.replace(e.to_string()).is_none() {
                    tracing::warn!(error = %e, "the history cannot be written; checks wait in memory");
                }
                drop(inside);
                std::thread::sleep(AGAIN);
                return;
            }
        }
        drop(inside);
        self.changed.notify_all();
    }
}
