//! User-writable memory of a served camera: a file of flat-field coefficients, and a list of defects.

use super::gige::Registers;
use super::register;
use crate::flat_field::{DefectList, FlatField};
use crate::frame::Region;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Entries of `FileSelector`.
pub(super) const NAMES: [(&str, u32); 1] = [("UserFlatField", 0)];
/// Entries of `FileOperationSelector`.
pub(super) const OPERATIONS: [(&str, u32); 5] =
    [("Open", 0), ("Close", 1), ("Read", 2), ("Write", 3), ("Delete", 4)];
/// Entries of `FileOpenMode`.
pub(super) const MODES: [(&str, u32); 2] = [("Read", 0), ("Write", 1)];
/// Entries of `FileOperationStatus`.
pub(super) const STATUSES: [(&str, u32); 2] = [("Success", 0), ("Failure", 1)];
/// Size of `FileAccessBuffer`, bytes.
pub(super) const BUFFER: u32 = 0x4000;
/// Capacity of the defect list.
pub(super) const DEFECTS: u32 = 256;

/// Polling interval of the command register while a file is open, and while none is.
const LOOK: [Duration; 2] = [Duration::from_micros(50), Duration::from_millis(2)];

/// File used by the painter, and the number of its writes.
#[derive(Debug, Clone, Default)]
pub(super) struct Files(Arc<Mutex<(u64, Option<Arc<FlatField>>)>>);

impl Files {
    fn lock(&self) -> MutexGuard<'_, (u64, Option<Arc<FlatField>>)> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Corrections used by the painter.
#[derive(Debug, Clone, Default)]
pub(super) struct Memory {
    version: u64,
    pub flat_field: Option<Arc<FlatField>>,
    pub defects: Option<Arc<DefectList>>,
}

impl PartialEq for Memory {
    fn eq(&self, other: &Self) -> bool {
        let list = |m: &Self| m.defects.as_ref().map(Arc::as_ptr);
        self.version == other.version && list(self) == list(other)
    }
}

impl Memory {
    /// Takes over new files and lists. Runs on the server's thread.
    pub fn refresh(&mut self, files: &Files, registers: &Registers, sensor: Region) {
        let written = files.lock();
        if written.0 != self.version {
            (self.version, self.flat_field) = (written.0, written.1.clone());
        }
        drop(written);
        match registers.u32(register::DEFECT_APPLY) {
            0 => self.defects = None,
            1 => {
                let count = registers.u32(register::DEFECT_COUNT).min(DEFECTS);
                let places = (0..count).map(|i| {
                    let at = register::DEFECT_LIST + 8 * i;
                    (registers.u32(at), registers.u32(at + 4))
                });
                let size = (sensor.width as usize, sensor.height as usize);
                self.defects = Some(Arc::new(DefectList::new(size, &places.collect::<Vec<_>>(), 1)));
                registers.set_u32(register::DEFECT_APPLY, 2);
            }
            _ => {}
        }
    }
}

/// Executes `FileOperationExecute` until dropped.
pub(super) struct Keeper {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Keeper {
    /// Starts the thread. `size`: columns and rows of the sensor as in the description.
    pub fn start(memory: Registers, files: Files, size: (u32, u32)) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&stop);
        let work = move || {
            let mut open = Open { memory, files, size, file: None, kept: Vec::new() };
            while !told.load(Ordering::Relaxed) {
                if open.memory.u32(register::FILE_EXECUTE) != 0 {
                    open.execute();
                }
                std::thread::sleep(LOOK[usize::from(open.file.is_none())]);
            }
        };
        Self { stop, thread: Some(std::thread::spawn(work)) }
    }
}

impl Drop for Keeper {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Open file.
enum Access {
    Read,
    Write(Vec<u8>),
}

struct Open {
    memory: Registers,
    files: Files,
    size: (u32, u32),
    file: Option<Access>,
    /// Contents of the file when last closed.
    kept: Vec<u8>,
}

impl Open {
    fn execute(&mut self) {
        let done = self.operation();
        let r = &self.memory;
        r.set_u32(register::FILE_STATUS, u32::from(done.is_none()));
        r.set_u32(register::FILE_RESULT, done.unwrap_or(0));
        r.set_u32(register::FILE_SIZE, self.kept.len() as u32);
        // Written last: the client polls this register.
        r.set_u32(register::FILE_EXECUTE, 0);
    }

    /// Returns the number of bytes read or written; `None` on failure.
    fn operation(&mut self) -> Option<u32> {
        let r = &self.memory;
        let offset = r.u32(register::FILE_OFFSET) as usize;
        let length = r.u32(register::FILE_LENGTH).min(BUFFER) as usize;
        let operation = OPERATIONS.iter().find(|o| o.1 == r.u32(register::FILE_OPERATION))?.0;
        match (operation, &mut self.file) {
            ("Open", None) => {
                let write = r.u32(register::FILE_OPEN_MODE) == 1;
                self.file = Some(if write { Access::Write(Vec::new()) } else { Access::Read });
                Some(0)
            }
            ("Close", Some(_)) => match self.file.take() {
                Some(Access::Write(bytes)) => self.keep(bytes),
                _ => Some(0),
            },
            ("Delete", None) => {
                self.kept.clear();
                let mut written = self.files.lock();
                *written = (written.0 + 1, None);
                Some(0)
            }
            ("Read", Some(Access::Read)) => {
                let rest = self.kept.get(offset..)?;
                let part = &rest[..length.min(rest.len())];
                r.write(register::FILE_BUFFER, part);
                Some(part.len() as u32)
            }
            ("Write", Some(Access::Write(bytes))) => {
                // Maximum file size: header and 4 bytes per pixel.
                let most = 1024 + 4 * self.size.0 as usize * self.size.1 as usize;
                if offset > bytes.len() || offset + length > most {
                    return None;
                }
                let mut part = vec![0; length];
                r.read(register::FILE_BUFFER, &mut part);
                bytes.truncate(offset);
                bytes.extend(part);
                Some(length as u32)
            }
            _ => None,
        }
    }

    /// Keeps the file if its coefficients match the size of this sensor.
    fn keep(&mut self, bytes: Vec<u8>) -> Option<u32> {
        match FlatField::from_bytes(&bytes) {
            Ok(flat) if flat.size() == self.size => {
                let mut written = self.files.lock();
                *written = (written.0 + 1, Some(Arc::new(flat)));
                drop(written);
                self.kept = bytes;
                Some(0)
            }
            Ok(flat) => {
                tracing::warn!(size = ?flat.size(), sensor = ?self.size, "a file of flat-field coefficients of another size is refused");
                None
            }
            Err(e) => {
                tracing::warn!(error = %e, "a file of flat-field coefficients is refused");
                None
            }
        }
    }
}
