//! Bounded queue that drops (and counts) the oldest entry when full; writers never block.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// State of the queue.
#[derive(Debug)]
struct Inside<T> {
    waiting: VecDeque<T>,
    dropped: u64,
    closed: bool,
}

/// Bounded queue between two threads.
#[derive(Debug)]
pub struct Ring<T> {
    inside: Mutex<Inside<T>>,
    filled: Condvar,
    capacity: usize,
}

impl<T> Ring<T> {
    /// Creates a queue of at most `capacity` entries, at least one.
    pub fn new(capacity: usize) -> Self {
        let waiting = VecDeque::with_capacity(capacity.max(1));
        let inside = Mutex::new(Inside { waiting, dropped: 0, closed: false });
        Self { inside, filled: Condvar::new(), capacity: capacity.max(1) }
    }

    fn lock(&self) -> MutexGuard<'_, Inside<T>> {
        // No code that holds this lock panics half way.
        self.inside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Appends an entry; drops the oldest if the queue is full.
    pub fn push(&self, entry: T) {
        let mut inside = self.lock();
        if inside.waiting.len() >= self.capacity {
            inside.waiting.pop_front();
            inside.dropped += 1;
        }
        inside.waiting.push_back(entry);
        drop(inside);
        self.filled.notify_one();
    }

    /// Waits for the oldest entry; `None` on a timeout, or if the queue is closed and empty.
    pub fn pop(&self, timeout: Duration) -> Option<T> {
        let inside = self.lock();
        let (mut inside, _) = self
            .filled
            .wait_timeout_while(inside, timeout, |i| i.waiting.is_empty() && !i.closed)
            .unwrap_or_else(PoisonError::into_inner);
        inside.waiting.pop_front()
    }

    /// Closes the queue: nobody waits for entries any more.
    pub fn close(&self) {
        self.lock().closed = true;
        self.filled.notify_all();
    }

    /// Returns true if the queue is closed and empty.
    pub fn is_finished(&self) -> bool {
        let inside = self.lock();
        inside.closed && inside.waiting.is_empty()
    }

    /// Returns the number of dropped entries.
    pub fn dropped(&self) -> u64 {
        self.lock().dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[test]
    fn the_oldest_goes_and_is_counted() {
        let ring = Ring::new(3);
        (0..10).for_each(|n| ring.push(n));
        let now = Duration::ZERO;
        assert_eq!(
            (ring.pop(now), ring.pop(now), ring.pop(now), ring.pop(now)),
            (Some(7), Some(8), Some(9), None)
        );
        assert_eq!(ring.dropped(), 7);
    }

    /// The reader is slower than the writer: entries read ascend, and with the dropped ones they are all
    /// entries written.
    #[test]
    fn every_entry_is_read_or_counted() {
        let ring = Arc::new(Ring::new(4));
        let writer = Arc::clone(&ring);
        let thread = std::thread::spawn(move || {
            for n in 0..20_000u64 {
                writer.push(n);
                if n % 64 == 0 {
                    std::thread::yield_now();
                }
            }
            writer.close();
        });
        let mut read: Vec<u64> = Vec::new();
        while !ring.is_finished() {
            read.extend(ring.pop(Duration::from_secs(10)));
        }
        thread.join().unwrap();
        assert!(read.windows(2).all(|w| w[0] < w[1]));
        assert_eq!(read.len() as u64 + ring.dropped(), 20_000);
        assert_eq!(read.last(), Some(&19_999));
    }
}
