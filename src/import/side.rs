//! Settings that a program writes into a text file beside its frames: `Capture.CameraSettings.txt` of SharpCap, the
//! log of FireCapture, `frame_01.json` of a script.

use super::Facts;
use super::words::of_description;
use std::path::Path;

/// Bytes of a file of settings, at most: a longer one is something else.
const MAX_BYTES: u64 = 64 * 1024;
/// Ends of its name.
const ENDS: [&str; 3] = [".CameraSettings.txt", ".txt", ".json"];
/// Files that tell of all frames in their folder.
const OF_THE_FOLDER: [&str; 7] = [
    "CameraSettings.txt",
    "settings.txt",
    "settings.json",
    "metadata.txt",
    "metadata.json",
    "acquisition.txt",
    "acquisition.json",
];
/// Starts of a frame's name that are tried, at most.
const MAX_STARTS: usize = 16;

/// Facts of the file of settings that belongs to a frame: of its own name, of the start of it, of all frames in its
/// folder, or of the name of the folder and beside it. The nearest counts. No folder is listed, so that the time
/// is the same for each of many frames.
pub fn facts(image: &Path) -> Facts {
    let folder = image.parent().unwrap_or(Path::new(""));
    let name_of = |name: Option<&std::ffi::OsStr>| name.unwrap_or_default().to_string_lossy().into_owned();
    let stem = name_of(image.file_stem());
    let cuts = stem.char_indices().rev().filter(|(at, c)| *at > 0 && !c.is_alphanumeric()).map(|(at, _)| at);
    let starts = [stem.len()].into_iter().chain(cuts).take(MAX_STARTS);
    let own = starts.flat_map(|at| ENDS.map(|end| folder.join(format!("{}{end}", &stem[..at]))));
    let whole = OF_THE_FOLDER.map(|name| folder.join(name));
    let beside = folder.parent().filter(|_| folder.file_name().is_some()).map(|above| {
        let name = name_of(folder.file_name());
        ENDS.map(|end| above.join(format!("{name}{end}")))
    });
    let found = own.chain(whole).chain(beside.into_iter().flatten()).find(|path| path.is_file());
    found.map(|path| read(&path)).unwrap_or_default()
}

/// What the file says; nothing of one that is too long or no text.
fn read(path: &Path) -> Facts {
    if path.metadata().map_or(true, |m| m.len() > MAX_BYTES) {
        return Facts::default();
    }
    let Ok(text) = crate::input::settings(path) else { return Facts::default() };
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
