//! Corrected frames as files.

use super::{Corrected, Ring, Sink, SinkCounts, StreamError};
use crate::dataset::{image, write_whole};
use ndarray::ArrayView2;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use tiff::encoder::colortype::Gray16;

/// Columns of `frames.csv` beside corrected frames.
const COLUMNS: &str = "file,id,timestamp_s,mean_dn,saturated_pixels";

/// A folder of corrected frames: `frames/00000001.tiff` and so on, a row for each in `frames.csv` once it is on the disk whole.
///
/// It writes on a thread of its own. A slow disk holds nothing up: the oldest frame that waits is dropped, and counted.
#[derive(Debug)]
pub struct Files {
    ring: Arc<Ring<Arc<Corrected>>>,
    written: Arc<AtomicU64>,
    fault: Arc<Mutex<Option<StreamError>>>,
    thread: Option<JoinHandle<()>>,
}

struct Job {
    root: PathBuf,
    rows: File,
    description: String,
}

impl Job {
    fn write(&mut self, number: u64, frame: &Corrected) -> Result<(), StreamError> {
        let name = format!("frames/{number:08}.tiff");
        let path = self.root.join(&name);
        let fault =
            |e: &dyn std::fmt::Display| StreamError::Files { path: path.clone(), message: e.to_string() };
        let (width, height) = frame.size;
        let pixels = ArrayView2::from_shape((height, width), &frame.pixels).map_err(|e| fault(&e))?;
        let bytes =
            image::described_bytes::<Gray16>(&pixels.to_owned(), &self.description).map_err(|e| fault(&e))?;
        write_whole(&path, &bytes).map_err(|e| StreamError::Dataset(Box::new(e)))?;
        let time = frame.timestamp_ns.map(|t| format!("{:.9}", t as f64 * 1e-9)).unwrap_or_default();
        let seen = frame.seen;
        writeln!(self.rows, "{name},{},{time},{:.4},{}", frame.id, seen.mean_dn(), seen.saturated)
            .map_err(|e| fault(&e))
    }
}

impl Files {
    /// A new folder, or an empty one.
    ///
    /// # Errors
    ///
    /// Where the folder holds something or cannot be written.
    pub fn create(root: &Path, description: &str, waiting: usize) -> Result<Self, StreamError> {
        let fault = |message: String| StreamError::Files { path: root.into(), message };
        let io = |e: std::io::Error| fault(e.to_string());
        if fs::read_dir(root).is_ok_and(|mut entries| entries.next().is_some()) {
            return Err(fault("is not empty; choose a new folder".into()));
        }
        fs::create_dir_all(root.join("frames")).map_err(io)?;
        let mut rows = File::create_new(root.join("frames.csv")).map_err(io)?;
        writeln!(rows, "{COLUMNS}").map_err(io)?;
        let mut job = Job { root: root.into(), rows, description: description.into() };
        let ring = Arc::new(Ring::<Arc<Corrected>>::new(waiting));
        let (written, failed) = (Arc::new(AtomicU64::new(0)), Arc::new(Mutex::new(None)));
        let (inbox, count, slot) = (Arc::clone(&ring), Arc::clone(&written), Arc::clone(&failed));
        let thread = std::thread::spawn(move || {
            while !inbox.is_finished() {
                let Some(frame) = inbox.pop(Duration::from_secs(1)) else { continue };
                if let Err(e) = job.write(count.load(Ordering::Relaxed) + 1, &frame) {
                    *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(e);
                    break;
                }
                count.fetch_add(1, Ordering::Relaxed);
            }
        });
        Ok(Self { ring, written, fault: failed, thread: Some(thread) })
    }

    fn check(&self) -> Result<(), StreamError> {
        self.fault.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(Ok(()), Err)
    }
}

impl Sink for Files {
    fn name(&self) -> &'static str {
        "written"
    }

    fn take(&mut self, frame: &Arc<Corrected>) -> Result<(), StreamError> {
        self.check()?;
        self.ring.push(Arc::clone(frame));
        Ok(())
    }

    fn counts(&self) -> SinkCounts {
        SinkCounts { taken: self.written.load(Ordering::Relaxed), dropped: self.ring.dropped() }
    }

    fn finish(&mut self) -> Result<(), StreamError> {
        self.ring.close();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        self.check()
    }
}

impl Drop for Files {
    fn drop(&mut self) {
        if let Err(e) = self.finish() {
            tracing::error!(error = %e, "corrected frames");
        }
    }
}
