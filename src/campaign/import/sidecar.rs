//! Sidecar files: settings that a program writes into a text file beside its frames
//! (`Capture.CameraSettings.txt` of SharpCap, the log of FireCapture, `frame_01.json` of a script).

use super::Facts;
use super::words::of_description;
use std::path::Path;

/// Maximum size of a sidecar file, bytes.
const MAX_BYTES: u64 = 64 * 1024;
/// Suffixes of a sidecar file.
const SUFFIXES: [&str; 3] = [".CameraSettings.txt", ".txt", ".json"];
/// Names of sidecar files that apply to a whole folder.
const FOLDER_FILES: [&str; 7] = [
    "CameraSettings.txt",
    "settings.txt",
    "settings.json",
    "metadata.txt",
    "metadata.json",
    "acquisition.txt",
    "acquisition.json",
];
/// Maximum number of prefixes of a frame's name that are tried.
const MAX_PREFIXES: usize = 16;

/// Reads the facts of a frame's sidecar file. The file has the frame's name or a prefix of it, applies
/// to the whole folder, or is beside the folder under the folder's name; the first existing one is read.
/// No folder is listed, so the time per frame does not grow with their number.
pub fn facts(image: &Path) -> Facts {
    let folder = image.parent().unwrap_or(Path::new(""));
    let name_of = |name: Option<&std::ffi::OsStr>| name.unwrap_or_default().to_string_lossy().into_owned();
    let stem = name_of(image.file_stem());
    let of_frame =
        prefixes(&stem).flat_map(|prefix| SUFFIXES.map(|suffix| folder.join(format!("{prefix}{suffix}"))));
    let of_folder = FOLDER_FILES.map(|name| folder.join(name));
    let beside_folder = folder.parent().filter(|_| folder.file_name().is_some()).map(|above| {
        let name = name_of(folder.file_name());
        SUFFIXES.map(|suffix| above.join(format!("{name}{suffix}")))
    });
    let mut all = of_frame.chain(of_folder).chain(beside_folder.into_iter().flatten());
    all.find(|path| path.is_file()).map(|path| read(&path)).unwrap_or_default()
}

/// Returns a name and its prefixes up to a separator, the longest first.
pub(super) fn prefixes(stem: &str) -> impl Iterator<Item = &str> {
    let cuts = stem.char_indices().rev().filter(|(at, c)| *at > 0 && !c.is_alphanumeric()).map(|(at, _)| at);
    [stem.len()].into_iter().chain(cuts).take(MAX_PREFIXES).map(|at| &stem[..at])
}

/// Reads the facts of a sidecar file; none if it is too large.
fn read(path: &Path) -> Facts {
    if path.metadata().map_or(true, |m| m.len() > MAX_BYTES) {
        return Facts::default();
    }
    let Ok(text) = crate::input::plain_text(path) else { return Facts::default() };
    let mut facts = of_description(text.trim_start_matches('\u{feff}'));
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    facts.from.values_mut().for_each(|from| *from = format!("{name}: {from}"));
    // SharpCap names the camera in the first line, in brackets.
    let first = text.lines().next().unwrap_or_default().trim();
    if facts.model.is_none()
        && let Some(model) = first.strip_prefix('[').and_then(|l| l.strip_suffix(']'))
    {
        facts.model = Some(model.into());
    }
    facts
}
