//! Frames stored in two formats: `img_1.tif` beside `img_1.png`.

use super::{Found, ImportError, few};
use crate::dataset::image::Values;
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};

/// Returns a file's name without its extension.
pub fn name(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase()
}

fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// Finds names shared by files of several formats.
pub fn names(paths: &[PathBuf]) -> BTreeSet<String> {
    let mut formats: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for path in paths {
        formats.entry(name(path)).or_default().insert(extension(path));
    }
    formats.into_iter().filter(|(_, of)| of.len() > 1).map(|(name, _)| name).collect()
}

/// Computes a digest of a frame's values.
pub fn digest(values: &Values) -> u64 {
    let mut hasher = DefaultHasher::new();
    match values {
        Values::Codes(codes) => {
            codes.dim().hash(&mut hasher);
            codes.iter().for_each(|v| hasher.write_u16(*v));
        }
        Values::Numbers(numbers) => {
            numbers.dim().hash(&mut hasher);
            numbers.iter().for_each(|v| hasher.write_u64(v.to_bits()));
        }
    }
    hasher.finish()
}

/// Ranks a file by the amount of its metadata, then by format.
fn rank(frame: &Found) -> (usize, usize) {
    let format = ["fits", "fit", "fts", "tif", "tiff", "png", "bmp", "npy"];
    let place = format.iter().position(|f| *f == extension(&frame.path)).unwrap_or(format.len());
    (usize::MAX - frame.facts.from.len() - usize::from(frame.facts.time_s.is_some()), place)
}

/// Keeps one of several files with the same frames; returns descriptions of the dropped ones.
///
/// # Errors
///
/// Files of one folder and one name with different pixels: the right one is unknown.
pub fn count_once(frames: &mut Vec<Found>) -> Result<Vec<String>, ImportError> {
    let mut of_file: BTreeMap<PathBuf, Vec<usize>> = BTreeMap::new();
    for (k, frame) in frames.iter().enumerate().filter(|(_, f)| f.digest != 0) {
        of_file.entry(frame.path.clone()).or_default().push(k);
    }
    let mut groups: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for path in of_file.keys() {
        groups.entry(name(path)).or_default().push(path.clone());
    }
    let digests = |path: &PathBuf| -> Vec<u64> { of_file[path].iter().map(|k| frames[*k].digest).collect() };
    let mut dropped: BTreeSet<PathBuf> = BTreeSet::new();
    for mut paths in groups.into_values() {
        paths.sort_by_cached_key(|p| (rank(&frames[of_file[p][0]]), p.clone()));
        let pairs = paths.iter().enumerate().flat_map(|(k, a)| paths[k + 1..].iter().map(move |b| (a, b)));
        for (a, b) in pairs.filter(|(a, b)| extension(a) != extension(b)) {
            if digests(a) == digests(b) {
                dropped.insert(b.clone());
            } else if a.parent() == b.parent() {
                return Err(ImportError::Files(format!(
                    "{} and {} have one name and other pixels: they may be one frame, written in two ways; \
                     import one format only",
                    a.display(),
                    b.display()
                )));
            }
        }
    }
    if dropped.is_empty() {
        return Ok(Vec::new());
    }
    frames.retain(|f| !dropped.contains(&f.path));
    let names: Vec<String> = dropped.iter().map(|p| p.display().to_string()).collect();
    Ok(vec![format!(
        "{} files have the frames of files of the same name in another format, and count once: {} left out",
        names.len(),
        few(&names)
    )])
}
