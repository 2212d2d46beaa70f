//! Cache of decoded frames: the examination, the first look and the pass over all frames read the same
//! files.

use ndarray::Array2;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Maximum size of the cache, bytes: decoding compressed frames takes longer than examining them. A
/// named choice: a tenth of the memory of a small machine.
const MAX_BYTES: usize = 256 << 20;

/// Cached frames by file and page.
#[derive(Debug, Default)]
pub(super) struct Kept(Mutex<Frames>);

#[derive(Debug, Default)]
struct Frames {
    by_file: HashMap<String, Arc<Array2<u16>>>,
    bytes: usize,
}

impl Kept {
    fn lock(&self) -> std::sync::MutexGuard<'_, Frames> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn get(&self, file: &str) -> Option<Arc<Array2<u16>>> {
        self.lock().by_file.get(file).cloned()
    }

    /// Caches a frame if there is room.
    pub(super) fn put(&self, file: &str, frame: &Arc<Array2<u16>>) {
        let (mut frames, bytes) = (self.lock(), size_of::<u16>() * frame.len());
        if frames.bytes + bytes <= MAX_BYTES && !frames.by_file.contains_key(file) {
            frames.bytes += bytes;
            frames.by_file.insert(file.into(), frame.clone());
        }
    }

    pub(super) fn clear(&self) {
        *self.lock() = Frames::default();
    }
}
