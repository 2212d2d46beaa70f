//! Settings that a program writes into a text file beside its frames: `Capture.CameraSettings.txt` of SharpCap, the
//! log of FireCapture, `frame_01.json` of a script.

use super::Facts;
use super::words::of_description;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Bytes of a file of settings, at most: a longer one is something else.
const MAX_BYTES: u64 = 64 * 1024;
/// Names of files that tell of all frames in their folder.
const OF_THE_FOLDER: [&str; 5] = ["", "camerasettings", "settings", "metadata", "acquisition"];

/// Files of settings, folder by folder as they are asked for.
#[derive(Debug, Default)]
pub struct Side(BTreeMap<PathBuf, Vec<(String, PathBuf)>>);

impl Side {
    /// Facts of the file of settings that belongs to a frame: of its own name, of the start of it, of all
    /// frames in its folder, or of the name of the folder and beside it. The nearest counts.
    pub fn facts(&mut self, image: &Path) -> Facts {
        let folder = image.parent().unwrap_or(Path::new(""));
        let stem = lower(image.file_stem());
        let own = self.nearest(folder, &stem);
        let above = || folder.parent().zip(folder.file_name());
        let found =
            own.or_else(|| above().and_then(|(parent, name)| self.exactly(parent, &lower(Some(name)))));
        found.map(|path| read(&path)).unwrap_or_default()
    }

    fn in_folder(&mut self, folder: &Path) -> &[(String, PathBuf)] {
        self.0.entry(folder.into()).or_insert_with(|| {
            let here = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
            let entries = std::fs::read_dir(here).into_iter().flatten().flatten();
            let mut found: Vec<(String, PathBuf)> =
                entries.filter_map(|e| Some((base(&e.path())?, e.path()))).collect();
            found.sort();
            found
        })
    }

    /// The file with the longest name that the frame's begins with, else one of the whole folder.
    fn nearest(&mut self, folder: &Path, stem: &str) -> Option<PathBuf> {
        let all = self.in_folder(folder);
        let begins = |base: &str| {
            let rest = stem.strip_prefix(base);
            !base.is_empty() && rest.is_some_and(|r| !r.starts_with(char::is_alphanumeric))
        };
        let own = all.iter().filter(|(base, _)| begins(base)).max_by_key(|(base, _)| base.len());
        let whole = || all.iter().find(|(base, _)| OF_THE_FOLDER.contains(&base.as_str()));
        own.or_else(whole).map(|(_, path)| path.clone())
    }

    fn exactly(&mut self, folder: &Path, name: &str) -> Option<PathBuf> {
        self.in_folder(folder).iter().find(|(base, _)| base == name).map(|(_, path)| path.clone())
    }
}

fn lower(name: Option<&std::ffi::OsStr>) -> String {
    name.unwrap_or_default().to_string_lossy().to_lowercase()
}

/// Name that a file of settings shares with its frames; `None` of other files.
fn base(path: &Path) -> Option<String> {
    let name = lower(path.file_name());
    let stem = name.strip_suffix(".txt").or_else(|| name.strip_suffix(".json"))?;
    Some(stem.strip_suffix(".camerasettings").unwrap_or(stem).to_string())
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
