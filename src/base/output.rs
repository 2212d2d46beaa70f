//! Output files: regular files and new names only, in folders that are no links.
//!
//! A file is written beside its place and renamed. The rename would replace a device or a FIFO by a file, and
//! a link in a dataset from elsewhere could lead anywhere. Both are refused by name.

use crate::input::name_of;
use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Result};
use std::path::{Path, PathBuf};

/// Refuses an existing path that is not a regular file.
///
/// # Errors
///
/// The path is a link, device, FIFO, socket or folder, or cannot be examined.
pub fn must_be_file_or_new(path: &Path) -> Result<()> {
    match std::fs::symlink_metadata(path) {
        Ok(found) if found.is_file() => Ok(()),
        Ok(found) => Err(refusal(name_of(found.file_type()), "an output is a regular file or a new name")),
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(()),
        Err(e) => Err(e),
    }
}

/// Creates a folder and its parents if they are missing; refuses a link in its place.
///
/// # Errors
///
/// The path is a link or a file, or the folder cannot be created.
pub fn folder(path: &Path) -> Result<()> {
    must_be_folder_or_new(path)?;
    std::fs::create_dir_all(path)?;
    must_be_folder_or_new(path)
}

/// Creates the folders of a relative path below a root; refuses links among them and `..`.
///
/// # Errors
///
/// As [`folder`], with the path that failed.
#[cfg(feature = "cli")]
pub fn folders_below(root: &Path, relative: &Path) -> std::result::Result<(), (PathBuf, Error)> {
    use std::path::Component;
    let mut at = root.to_path_buf();
    folder(&at).map_err(|e| (at.clone(), e))?;
    for part in relative.components() {
        match part {
            Component::CurDir => continue,
            Component::Normal(name) => at.push(name),
            _ => return Err((root.join(relative), refusal("no path below its folder", "name one"))),
        }
        folder(&at).map_err(|e| (at.clone(), e))?;
    }
    Ok(())
}

/// Opens a regular file to append to it; creates a missing one if `create` is true.
///
/// # Errors
///
/// As [`must_be_file_or_new`], and if the file cannot be opened.
pub fn append(path: &Path, create: bool) -> Result<File> {
    must_be_file_or_new(path)?;
    let mut options = OpenOptions::new();
    options.append(true).create(create);
    // The path may have changed since the check.
    #[cfg(unix)]
    {
        use rustix::fs::OFlags;
        let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
        std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, flags.bits().cast_signed());
    }
    options.open(path)
}

/// Syncs the names in a folder to the disk.
///
/// # Errors
///
/// An error of the file system.
pub fn synchronise(folder: &Path) -> Result<()> {
    File::open(folder)?.sync_all()
}

/// Returns the folder of a file.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn must_be_folder_or_new(path: &Path) -> Result<()> {
    match std::fs::symlink_metadata(path) {
        Ok(found) if found.is_dir() => Ok(()),
        // `folder/` and `.` follow links by the rules of the system: the user named the target.
        Ok(found) => {
            Err(refusal(name_of(found.file_type()), "a folder is needed, and links are not followed"))
        }
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(()),
        Err(e) => Err(e),
    }
}

fn refusal(kind: &str, needed: &str) -> Error {
    Error::new(ErrorKind::InvalidInput, format!("is {kind}; {needed}"))
}

/// Folder locked for one writer, from its creation until drop.
///
/// The lock is on the folder itself, because a file in it can be renamed away. A folder created for it that
/// stayed empty is removed.
#[derive(Debug)]
pub struct Held {
    path: PathBuf,
    made: bool,
    /// Handle of the folder; none on systems that cannot lock folders, on which only `frames.csv` is locked.
    _handle: Option<File>,
}

/// Reasons for not locking a folder.
#[derive(Debug)]
pub enum HoldError {
    /// Another program holds it.
    Busy,
    /// An error of the file system.
    Io(Error),
}

impl Held {
    /// Creates the folder if it is missing, and locks it.
    ///
    /// # Errors
    ///
    /// Another program holds the folder, the path is a link, or it cannot be created.
    pub fn take(path: &Path) -> std::result::Result<Self, HoldError> {
        // A folder that its last holder removes while it is opened here is created again.
        for _ in 0..100 {
            let made = !path.exists();
            folder(path).map_err(HoldError::Io)?;
            let Some(handle) = open_folder(path) else {
                return Ok(Self { path: path.into(), made, _handle: None });
            };
            match handle.try_lock() {
                Ok(()) if is_at(&handle, path) => {
                    return Ok(Self { path: path.into(), made, _handle: Some(handle) });
                }
                Ok(()) => {}
                Err(std::fs::TryLockError::WouldBlock) => return Err(HoldError::Busy),
                Err(std::fs::TryLockError::Error(_)) => {
                    return Ok(Self { path: path.into(), made, _handle: None });
                }
            }
        }
        Err(HoldError::Busy)
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        if self.made {
            // Succeeds for an empty folder only.
            std::fs::remove_dir(&self.path).ok();
        }
    }
}

#[cfg(unix)]
fn open_folder(path: &Path) -> Option<File> {
    use rustix::fs::OFlags;
    let flags = (OFlags::NOFOLLOW | OFlags::DIRECTORY).bits().cast_signed();
    let mut options = OpenOptions::new();
    std::os::unix::fs::OpenOptionsExt::custom_flags(options.read(true), flags);
    options.open(path).ok()
}

#[cfg(not(unix))]
fn open_folder(_: &Path) -> Option<File> {
    None
}

/// Returns true if the open folder is the one that has this name now.
#[cfg(unix)]
fn is_at(handle: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let of = |m: std::fs::Metadata| (m.dev(), m.ino());
    match (handle.metadata(), std::fs::symlink_metadata(path)) {
        (Ok(a), Ok(b)) => of(a) == of(b),
        _ => false,
    }
}

#[cfg(not(unix))]
fn is_at(_: &File, _: &Path) -> bool {
    true
}
