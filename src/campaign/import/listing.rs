//! Image files in the named folders, and notes on skipped files.

use super::{ImportError, few, names};
use crate::dataset::Dataset;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Extensions of image files searched for in folders.
const EXTENSIONS: [&str; 14] =
    ["tif", "tiff", "dng", "png", "bmp", "fits", "fit", "fts", "npy", "h5", "hdf5", "hdf", "nxs", "nx5"];
/// Additional extensions of a compressed FITS, after its own.
pub(super) const PACKED: [&str; 2] = ["gz", "fz"];

/// Returns true for the name of an image file.
fn is_image(path: &Path) -> bool {
    let of = |p: &Path| p.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let extension = of(path);
    if PACKED.contains(&&*extension) {
        let inner = path.file_stem().map(|stem| of(Path::new(stem))).unwrap_or_default();
        return matches!(inner.as_str(), "fits" | "fit" | "fts");
    }
    EXTENSIONS.contains(&&*extension)
}

/// Files and folders written by operating systems, file servers and viewers.
const SYSTEM: [&str; 11] = [
    "thumbs",
    "thumbnails",
    "previews",
    "thumbs.db",
    "ehthumbs.db",
    "desktop.ini",
    "__macosx",
    "@eadir",
    "$recycle.bin",
    "system volume information",
    "lost+found",
];

/// Extensions of files that may hold settings of frames.
const SETTINGS: [&str; 4] = ["csv", "json", "tsv", "txt"];

/// Maximum number of text files checked for an EMVA 1288 descriptor.
const MAX_TEXTS: usize = 20;

/// Image files and notes on skipped files.
#[derive(Debug, Default)]
pub struct Listing {
    /// Image files sorted by name, without duplicates.
    pub files: Vec<PathBuf>,
    /// Notes on skipped files.
    pub notes: Vec<String>,
}

/// Returns true for a hidden file or folder, or one of the operating system: `._a.tif` and `Thumbs.db`.
fn is_system(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    name.starts_with('.') || SYSTEM.contains(&&*name)
}

/// Lists the named image files and those in named folders; the result does not depend on the order of
/// the names.
///
/// # Errors
///
/// A file or folder that cannot be read.
pub fn list(named: &[PathBuf]) -> Result<Listing, ImportError> {
    let mut files = Vec::new();
    let mut system = Vec::new();
    // First camera raw file found.
    let mut raw: Option<PathBuf> = None;
    let mut others: BTreeMap<String, usize> = BTreeMap::new();
    let mut texts: Vec<PathBuf> = Vec::new();
    let mut folders: Vec<PathBuf> = Vec::new();
    let fault = |path: &Path| {
        let path = path.to_path_buf();
        move |e: std::io::Error| ImportError::File { path, message: e.to_string() }
    };
    for path in named {
        if path.metadata().map_err(fault(path))?.is_dir() {
            folders.push(path.clone());
        } else if is_system(path) {
            system.push(path.clone());
        } else {
            files.push(path.clone());
        }
    }
    let mut seen = BTreeSet::new();
    while let Some(folder) = folders.pop() {
        // Links may form a loop.
        if !seen.insert(folder.canonicalize().map_err(fault(&folder))?) {
            continue;
        }
        for entry in std::fs::read_dir(&folder).map_err(fault(&folder))? {
            let path = entry.map_err(fault(&folder))?.path();
            let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
            if is_system(&path) {
                system.push(path);
            } else if path.is_dir() {
                folders.push(path);
            } else if is_image(&path) {
                files.push(path);
            } else {
                if extension == "txt" && texts.len() < MAX_TEXTS {
                    texts.push(path.clone());
                }
                if crate::dataset::image::is_camera_raw(&path) {
                    raw = raw.filter(|r: &PathBuf| *r < path).or(Some(path));
                }
                *others.entry(extension).or_default() += 1;
            }
        }
    }
    sort(&mut files);
    sort(&mut system);
    let mut notes = Vec::new();
    if let Some(raw) = raw {
        let message = crate::dataset::image::CAMERA_RAW;
        notes.push(format!("passed over: {} is {message}", raw.display()));
    }
    if !system.is_empty() {
        let names: Vec<String> = system.iter().map(|p| p.display().to_string()).collect();
        notes.push(format!("passed over, files of the operating system or hidden: {}", few(&names)));
    }
    sort(&mut texts);
    if let Some(descriptor) = texts.iter().find(|path| Dataset::open(path).is_ok()) {
        notes.push(format!(
            "{0} is a descriptor of EMVA 1288, which tells all of its frames: give it to noise, emva or diagnose as it is (radcam noise {0})",
            descriptor.display()
        ));
    }
    let count = |(e, n): (&String, &usize)| match e.as_str() {
        "" => format!("{n} without extension"),
        e => format!("{n} .{e}"),
    };
    let (settings, others): (BTreeMap<_, _>, BTreeMap<_, _>) =
        others.into_iter().partition(|(e, _)| SETTINGS.contains(&e.as_str()));
    if !settings.is_empty() {
        let words: Vec<String> = settings.iter().map(count).collect();
        notes.push(format!("looked at for settings of the frames: {}", words.join(", ")));
    }
    if !others.is_empty() {
        let words: Vec<String> = others.iter().map(count).collect();
        notes.push(format!("passed over, no images that radcam reads: {}", words.join(", ")));
    }
    // A file reached under two names counts once.
    let mut once = BTreeSet::new();
    let before = files.len();
    files.retain(|path| path.canonicalize().map_or(true, |whole| once.insert(whole)));
    if files.len() < before {
        notes.push(format!("{} files were named twice, and count once", before - files.len()));
    }
    Ok(Listing { files, notes })
}

fn sort(paths: &mut [PathBuf]) {
    paths.sort_by_cached_key(|p| (names::natural(&p.to_string_lossy()), p.clone()));
}
