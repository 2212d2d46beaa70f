//! Sink that writes corrected frames as files.

use super::{Corrected, Ring, Sink, SinkCounts, StreamError};
use crate::dataset::{Aside, DatasetError, Folder, image, synchronise};
use ndarray::ArrayView2;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use tiff::encoder::colortype::Gray16;

/// Columns of `frames.csv`, the table of corrected frames.
const COLUMNS: &str = "file,id,timestamp_s,mean_dn,saturated_pixels";

/// Folder of corrected frames: `frames/00000001.tiff` and so on, with a row for each in `frames.csv` once it
/// is completely on disk.
///
/// A separate thread writes. A slow disk blocks nothing: the oldest waiting frame is dropped and counted.
/// Frames that arrived while the disk was busy are written together, up to eight, which is faster than one by
/// one.
#[derive(Debug)]
pub struct Files {
    ring: Arc<Ring<Arc<Corrected>>>,
    written: Arc<AtomicU64>,
    fault: Arc<Mutex<Option<StreamError>>>,
    thread: Option<JoinHandle<()>>,
}

/// Maximum number of frames written together. A group leaves the queue before it is written; the queue must
/// hold the frames that arrive meanwhile.
const GROUP: usize = 8;

struct Job {
    root: PathBuf,
    rows: File,
    description: String,
    /// Frames written in earlier groups.
    written: u64,
    /// Folder lock that keeps other writers out.
    _held: Folder,
}

impl Job {
    /// Writes a frame to a temporary file, and returns its future row.
    fn aside(&self, number: u64, frame: &Corrected) -> Result<(Aside, String), StreamError> {
        let name = format!("frames/{number:08}.tiff");
        let path = self.root.join(&name);
        let fault =
            |e: &dyn std::fmt::Display| StreamError::Files { path: path.clone(), message: e.to_string() };
        let (width, height) = frame.size;
        let pixels = ArrayView2::from_shape((height, width), &frame.pixels).map_err(|e| fault(&e))?;
        let bytes = image::described_bytes::<Gray16>(pixels, &self.description).map_err(|e| fault(&e))?;
        let aside = Aside::write(&path, &bytes).map_err(disk)?;
        let time = frame.timestamp_ns.map(|t| format!("{:.9}", t as f64 * 1e-9)).unwrap_or_default();
        let seen = frame.seen;
        Ok((aside, format!("{name},{},{time},{:.4},{}\n", frame.id, seen.mean_dn(), seen.saturated)))
    }

    /// Writes frames to disk, then their rows. If one fails, frames completed before it stay, with their
    /// rows.
    fn write(&mut self, frames: &[Arc<Corrected>]) -> Result<(), StreamError> {
        let (mut outcome, mut aside) = (Ok(()), Vec::new());
        for (number, frame) in (self.written + 1..).zip(frames) {
            match self.aside(number, frame) {
                Ok(made) => aside.push(made),
                Err(e) => {
                    outcome = Err(e);
                    break;
                }
            }
        }
        let (mut rows, mut placed) = (String::new(), 0);
        for (file, row) in aside {
            if let Err(e) = file.put_in_place() {
                outcome = Err(disk(e));
                break;
            }
            rows += &row;
            placed += 1;
        }
        synchronise(&self.root.join("frames")).map_err(disk)?;
        self.rows
            .write_all(rows.as_bytes())
            .map_err(|e| disk(DatasetError::io(&self.root.join("frames.csv"))(e)))?;
        self.written += placed;
        outcome
    }
}

fn disk(e: DatasetError) -> StreamError {
    StreamError::Dataset(Box::new(e))
}

impl Files {
    /// Creates a new folder, or uses an empty one.
    ///
    /// # Errors
    ///
    /// The folder is not empty or cannot be written.
    pub fn create(root: &Path, description: &str, waiting: usize) -> Result<Self, StreamError> {
        let fault = |message: String| StreamError::Files { path: root.into(), message };
        let io = |e: std::io::Error| fault(e.to_string());
        let held = Folder::hold(root).map_err(disk)?;
        if fs::read_dir(root).is_ok_and(|mut entries| entries.next().is_some()) {
            return Err(fault("is not empty; choose a new folder".into()));
        }
        crate::output::folder(&root.join("frames")).map_err(io)?;
        let mut rows = File::create_new(root.join("frames.csv")).map_err(io)?;
        writeln!(rows, "{COLUMNS}").map_err(io)?;
        let mut job =
            Job { root: root.into(), rows, description: description.into(), written: 0, _held: held };
        let ring = Arc::new(Ring::<Arc<Corrected>>::new(waiting));
        let (written, failed) = (Arc::new(AtomicU64::new(0)), Arc::new(Mutex::new(None)));
        let (inbox, count, slot) = (Arc::clone(&ring), Arc::clone(&written), Arc::clone(&failed));
        let thread = std::thread::spawn(move || {
            let mut group = Vec::with_capacity(GROUP);
            while !inbox.is_finished() {
                let Some(frame) = inbox.pop(Duration::from_secs(1)) else { continue };
                group.push(frame);
                group.extend(std::iter::from_fn(|| inbox.pop(Duration::ZERO)).take(GROUP - 1));
                let outcome = job.write(&group);
                group.clear();
                count.store(job.written, Ordering::Relaxed);
                if let Err(e) = outcome {
                    *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(e);
                    break;
                }
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

#[cfg(test)]
mod tests {
    use super::Files;

    /// A second stream into a folder is refused while the first writes, and afterwards.
    #[test]
    fn a_folder_has_one_writer() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("frames of a line");
        let first = Files::create(&root, "", 4).unwrap();
        let said = |outcome: Result<Files, _>| {
            outcome.err().map(|e: super::StreamError| e.to_string()).unwrap_or_default()
        };
        assert!(said(Files::create(&root, "", 4)).contains("another program"));
        drop(first);
        assert!(said(Files::create(&root, "", 4)).contains("not empty"));
    }
}
