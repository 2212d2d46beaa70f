//! Files in a camera, accessed by the features of SFNC 2.7, chapter File Access Control.

use radcam_aravis::{Camera, Error};
use std::time::{Duration, Instant};

/// Timeout of one operation: cameras write their flash memory.
const PATIENCE: Duration = Duration::from_secs(30);
/// Polling interval while an operation runs.
const LOOK: Duration = Duration::from_micros(100);

fn fault(feature: &str, message: impl ToString) -> Error {
    Error { what: feature.into(), message: message.to_string() }
}

/// Returns the entries of `FileSelector`, or none if file access is incomplete.
pub fn names(camera: &Camera) -> Vec<String> {
    let complete = ["FileOperationSelector", "FileOpenMode", "FileAccessOffset", "FileAccessLength"];
    if !complete.iter().all(|f| camera.has(f)) || camera.register("FileAccessBuffer").is_err() {
        return Vec::new();
    }
    camera.entries("FileSelector").unwrap_or_default()
}

/// File that is open in the camera; closed on drop.
struct File<'a> {
    camera: &'a Camera,
    name: &'a str,
    /// Address and size, bytes, of the buffer.
    buffer: (u64, usize),
    open: bool,
}

impl<'a> File<'a> {
    fn open(camera: &'a Camera, name: &'a str, mode: &str) -> Result<Self, Error> {
        camera.set_string("FileSelector", name)?;
        camera.set_string("FileOpenMode", mode)?;
        let (address, length) = camera.register("FileAccessBuffer")?;
        let buffer = (address, usize::try_from(length).map_err(|e| fault("FileAccessBuffer", e))?);
        if buffer.1 == 0 {
            return Err(fault("FileAccessBuffer", "its length is 0"));
        }
        let mut file = Self { camera, name, buffer, open: false };
        file.select("Open")?;
        file.execute()?;
        file.open = true;
        Ok(file)
    }

    fn select(&self, operation: &str) -> Result<(), Error> {
        self.camera.set_string("FileOperationSelector", operation)
    }

    /// Executes the selected operation and returns the number of bytes processed.
    fn execute(&self) -> Result<usize, Error> {
        let command = "FileOperationExecute";
        self.camera.execute(command)?;
        let begun = Instant::now();
        while !self.camera.is_done(command) {
            if begun.elapsed() > PATIENCE {
                return Err(fault(command, format!("{} was not done after {PATIENCE:?}", self.name)));
            }
            std::thread::sleep(LOOK);
        }
        let status = self.camera.string("FileOperationStatus")?;
        if status != "Success" {
            let operation = self.camera.string("FileOperationSelector").unwrap_or_default();
            return Err(fault("FileOperationStatus", format!("{operation} of {} ended with {status}", self.name)));
        }
        let done = self.camera.integer("FileOperationResult").unwrap_or(0);
        Ok(usize::try_from(done).unwrap_or(0))
    }

    /// Selects the next part of the file, by offset and length in bytes.
    fn part(&self, at: usize, bytes: usize) -> Result<(), Error> {
        self.camera.set_integer("FileAccessOffset", i64::try_from(at).map_err(|e| fault("FileAccessOffset", e))?)?;
        self.camera.set_integer("FileAccessLength", i64::try_from(bytes).map_err(|e| fault("FileAccessLength", e))?)
    }

    fn close(mut self) -> Result<(), Error> {
        self.open = false;
        self.select("Close")?;
        self.execute().map(drop)
    }
}

impl Drop for File<'_> {
    fn drop(&mut self) {
        // A file left open would keep cameras from starting an acquisition.
        if self.open && let Err(e) = self.select("Close").and_then(|()| self.execute()) {
            tracing::warn!(file = self.name, error = %e, "could not be closed");
        }
    }
}

/// Transfer unit, bytes: GVCP and USB3 Vision transfer whole words.
const WORD: usize = 4;

pub fn write(camera: &Camera, name: &str, bytes: &[u8], go_on: &mut dyn FnMut(usize) -> bool) -> Result<(), Error> {
    let file = File::open(camera, name, "Write")?;
    file.select("Write")?;
    let (mut at, mut words) = (0, Vec::new());
    while at < bytes.len() {
        if !go_on(at) {
            return Err(fault(name, "interrupted"));
        }
        let part = &bytes[at..bytes.len().min(at + file.buffer.1)];
        words.clear();
        words.extend(part);
        words.resize(part.len().next_multiple_of(WORD).min(file.buffer.1), 0);
        camera.set_memory(file.buffer.0, &words)?;
        file.part(at, part.len())?;
        let done = file.execute()?;
        if done == 0 || done > part.len() {
            return Err(fault("FileOperationResult", format!("{done} of {} bytes written at {at} of {name}", part.len())));
        }
        at += done;
    }
    go_on(at);
    file.close()
}

pub fn read(
    camera: &Camera,
    name: &str,
    most: usize,
    go_on: &mut dyn FnMut(usize) -> bool,
) -> Result<Vec<u8>, Error> {
    let file = File::open(camera, name, "Read")?;
    file.select("Read")?;
    let mut out = Vec::new();
    while out.len() < most {
        if !go_on(out.len()) {
            return Err(fault(name, "interrupted"));
        }
        let wanted = file.buffer.1.min(most - out.len());
        file.part(out.len(), wanted)?;
        let done = file.execute()?.min(wanted);
        if done == 0 {
            break;
        }
        let words = u32::try_from(done.next_multiple_of(WORD).min(file.buffer.1)).map_err(|e| fault(name, e))?;
        out.extend(&camera.memory(file.buffer.0, words)?[..done]);
    }
    file.close()?;
    Ok(out)
}
