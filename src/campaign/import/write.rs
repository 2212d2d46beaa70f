//! Writer of a new dataset: frames, rows and manifest.

use super::{ImportError, Map, pixel_format, pixels};
use crate::dataset::{
    BenchInfo, CameraInfo, Dataset, Folder, FrameRow, ImportInfo, Kind, Manifest, write_whole,
};
use std::path::Path;

/// Refuses a folder that is not empty.
///
/// # Errors
///
/// The folder is not empty.
pub fn must_be_free(root: &Path) -> Result<(), ImportError> {
    if let Ok(found) = std::fs::symlink_metadata(root)
        && !found.is_dir()
    {
        let kind = crate::input::name_of(found.file_type());
        return Err(ImportError::Files(format!("{} is {kind}; choose a new folder", root.display())));
    }
    if root.exists() && root.read_dir().map_or(true, |mut inside| inside.next().is_some()) {
        return Err(ImportError::Files(format!("{} is there already; choose a new folder", root.display())));
    }
    Ok(())
}

/// Copies the frames of a map into a new dataset folder, or hard-links them if `link`, and opens it. On
/// failure the copied files are removed.
///
/// # Errors
///
/// A file that cannot be read or written, a gap in the map, or a stop by the user.
pub fn write(
    map: &Map,
    root: &Path,
    link: bool,
    step: impl FnMut(usize, usize) -> bool,
) -> Result<Dataset, ImportError> {
    let new = !root.exists();
    let _held = Folder::hold(root)?;
    must_be_free(root)?;
    let outcome = fill(map, root, link, step).and_then(|()| Ok(Dataset::open(root)?));
    if outcome.is_err() {
        for file in ["dataset.toml", "frames.csv"] {
            std::fs::remove_file(root.join(file)).ok();
        }
        std::fs::remove_dir_all(root.join("frames")).ok();
        if new {
            std::fs::remove_dir(root).ok();
        }
    }
    outcome
}

/// Writes frames, rows, and the manifest last: an interrupted import is not a dataset.
fn fill(
    map: &Map,
    root: &Path,
    link: bool,
    mut step: impl FnMut(usize, usize) -> bool,
) -> Result<(), ImportError> {
    let missing = map.missing();
    if !missing.is_empty() {
        return Err(ImportError::Map(format!("missing: {}", missing.join("; "))));
    }
    let frames = root.join("frames");
    crate::output::folder(&frames)
        .map_err(|e| ImportError::File { path: frames.clone(), message: e.to_string() })?;
    let all: usize = map.sets.iter().map(|s| s.files.len()).sum();
    let mut rows = csv::Writer::from_writer(Vec::new());
    let mut taken = pixels::Taken::new(map, root, link);
    let start = map.sets.iter().filter_map(|s| s.times_s.as_ref()?.first().copied());
    let start = start.fold(f64::INFINITY, f64::min);
    let mut done = 0;
    for (number, set) in map.sets.iter().enumerate() {
        for (index, file) in set.files.iter().enumerate() {
            if !step(done, all) {
                return Err(ImportError::Interrupted);
            }
            done += 1;
            let row = FrameRow {
                file: taken.frame(file, set.turned)?,
                kind: set.kind,
                set: number as u32,
                index: index as u32,
                exposure_s: set.exposure_s.unwrap_or(1.0),
                illumination: set.illumination.unwrap_or(f64::from(u8::from(set.kind != Kind::Dark))),
                configuration: set.configuration,
                temperature_c: set.temperature_c,
                // Seconds since 1970 have a resolution of a quarter of a microsecond.
                timestamp_s: set.times_s.as_ref().map(|t| (1e6 * (t[index] - start)).round() / 1e6),
            };
            rows.serialize(&row).map_err(|e| ImportError::Map(e.to_string()))?;
        }
    }
    let shape = taken.shape();
    let mono = || format!("Mono{}", map.bit_depth);
    let pattern = map.pattern.as_ref().filter(|_| map.plane.is_none());
    let mut camera = CameraInfo {
        vendor: map.vendor.clone().unwrap_or_default(),
        model: map.model.clone().unwrap_or_default(),
        width: shape.1,
        height: shape.0,
        bit_depth: map.bit_depth,
        pixel_format: pattern.map_or_else(mono, |p| pixel_format(p, map.bit_depth)),
        gain_db: map.gain_db,
        ..map.camera.clone().unwrap_or_default()
    };
    if let Some(serial) = &map.serial {
        camera.serial.clone_from(serial);
    }
    camera.features.extend(map.features.clone());
    let guessed = map.guessed();
    let import = (!guessed.is_empty() || !map.notes.is_empty())
        .then(|| ImportInfo { guessed, notes: map.notes.clone() });
    let bench = BenchInfo { illumination_unit: "relative".into(), ..Default::default() };
    let manifest = Manifest { bench: Some(bench), import, ..Manifest::new(camera) };
    let text = toml::to_string(&manifest).map_err(|e| ImportError::Map(e.to_string()))?;
    let rows = rows.into_inner().map_err(|e| ImportError::Map(e.to_string()))?;
    write_whole(&root.join("frames.csv"), &rows)?;
    write_whole(&root.join("dataset.toml"), text.as_bytes())?;
    Ok(())
}
