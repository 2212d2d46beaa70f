//! Tables beside the frames that list their settings: `exposures.csv`, the log of a script.

use super::Facts;
use super::words::{self, Said, Writer};
use crate::dataset::delimiter;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

/// Largest table, bytes: some 40 000 rows.
const MAX_BYTES: u64 = 4 * 1024 * 1024;
/// Largest number of tables of a folder that are read, in the order of their names.
const MAX_TABLES: usize = 20;
/// Extensions of tables.
const EXTENSIONS: [&str; 2] = ["csv", "tsv"];
/// Columns that name the frame, its set or its folder, the best first; else the first column does.
const NAMES: [&str; 18] = [
    "file",
    "filename",
    "filepath",
    "path",
    "image",
    "imagename",
    "img",
    "frame",
    "name",
    "folder",
    "prefix",
    "set",
    "series",
    "datei",
    "dateiname",
    "bild",
    "fichier",
    "archivo",
];

/// Tables by the folder in which they lie.
pub struct FrameTables(BTreeMap<PathBuf, Vec<FrameTable>>);

/// Rows of a table by the name that each begins with.
struct FrameTable {
    name: String,
    rows: HashMap<String, Vec<Said>>,
}

impl FrameTables {
    /// Reads the tables in the folders of the images and in the folders above these.
    pub fn beside(images: &[PathBuf]) -> Self {
        let own: BTreeSet<&Path> = images.iter().filter_map(|p| p.parent()).collect();
        let above = own.iter().filter_map(|folder| folder.parent());
        let folders: BTreeSet<&Path> = own.iter().copied().chain(above).collect();
        let found = folders.into_iter().map(|folder| (folder.to_path_buf(), tables_in(folder)));
        Self(found.filter(|(_, tables)| !tables.is_empty()).collect())
    }

    /// Facts of the row that names an image, its name up to a sign, or its folder; none where no table does.
    pub fn facts(&self, image: &Path) -> Facts {
        let folder = image.parent().unwrap_or(Path::new(""));
        let text = |name: Option<&std::ffi::OsStr>| name.unwrap_or_default().to_string_lossy().into_owned();
        let (name, stem) = (text(image.file_name()), text(image.file_stem()));
        let prefixes = super::sidecar::prefixes(&stem).map(str::to_string);
        let keys: Vec<String> =
            [name].into_iter().chain(prefixes).chain([text(folder.file_name())]).collect();
        let tables = [Some(folder), folder.parent()].into_iter().flatten();
        let tables = tables.filter_map(|folder| self.0.get(folder)).flatten();
        let row =
            |t: &FrameTable| Some((t.name.clone(), keys.iter().find_map(|key| t.rows.get(key))?.clone()));
        let Some((table, said)) = tables.into_iter().find_map(row) else { return Facts::default() };
        let mut facts = words::facts(said, Writer::Lines);
        facts.from.values_mut().for_each(|from| *from = format!("{table}: {from}"));
        facts
    }
}

/// Tables of a folder in the order of their names.
fn tables_in(folder: &Path) -> Vec<FrameTable> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let entries = std::fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok).map(|e| e.path());
    let is_table = |path: &PathBuf| {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        EXTENSIONS.contains(&&*extension)
            && path.metadata().is_ok_and(|m| m.is_file() && m.len() <= MAX_BYTES)
    };
    let mut paths: Vec<PathBuf> = entries.filter(is_table).collect();
    paths.sort();
    paths.truncate(MAX_TABLES);
    paths.iter().filter_map(|path| table(path)).collect()
}

/// Reads a table with a header; `None` of a file that is none.
fn table(path: &Path) -> Option<FrameTable> {
    let rows = rows_of(&crate::input::settings(path).ok()?)?;
    Some(FrameTable { name: path.file_name()?.to_string_lossy().into_owned(), rows })
}

/// Parses rows by the name that each begins with. Rows of one name that differ are asked later, as headers are.
fn rows_of(text: &str) -> Option<HashMap<String, Vec<Said>>> {
    let text = text.trim_start_matches('\u{feff}');
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .flexible(true)
        .delimiter(delimiter(text.lines().find(|l| !l.starts_with('#')).unwrap_or_default()))
        .from_reader(text.as_bytes());
    let header = reader.headers().ok()?.clone();
    let plain: Vec<String> = header.iter().map(words::plain).collect();
    let key = NAMES.iter().find_map(|name| plain.iter().position(|p| p == name)).unwrap_or(0);
    let mut rows: HashMap<String, Vec<Said>> = HashMap::new();
    for record in reader.records().filter_map(Result::ok) {
        let Some(name) = record.get(key).and_then(|cell| cell.rsplit(['/', '\\']).next()) else { continue };
        let said = header.iter().zip(record.iter()).enumerate().filter(|(k, _)| *k != key);
        rows.entry(name.into()).or_default().extend(said.map(|(_, (column, cell))| Said::new(column, cell)));
    }
    Some(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_text_makes_it_panic(text in "\\PC{0,20}([,;\t\n\"#]\\PC{0,10}){0,12}") {
            let _ = rows_of(&text);
        }

        #[test]
        fn rows_are_read_in_any_order(order in Just(vec![1, 2, 3, 4]).prop_shuffle()) {
            let lines: Vec<String> = order.iter().map(|k| format!("img_{k}.tif;{k},5")).collect();
            let rows = rows_of(&format!("file;exposure_ms\n{}", lines.join("\n"))).unwrap();
            for k in 1..=4 {
                prop_assert_eq!(&rows[&format!("img_{k}.tif")], &[Said::new("exposure_ms", &format!("{k},5"))]);
            }
        }
    }
}
