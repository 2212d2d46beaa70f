//! Tables beside the frames with their settings: `exposures.csv`, the log of a script, `notes.txt`.

use super::words::{self, Said, Writer};
use super::{Facts, lists};
use crate::dataset::delimiter;
use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

/// Maximum size of a table, bytes: some 40 000 rows.
const MAX_BYTES: u64 = 4 * 1024 * 1024;
/// Maximum number of tables read per folder, sorted by name, plain texts last.
const MAX_TABLES: usize = 20;
/// Extensions of tables.
const EXTENSIONS: [&str; 3] = ["csv", "tsv", "txt"];
/// Columns that name the frame, its set or its folder, the best first; otherwise the first column.
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

/// Columns that name the first and the last frame of a row.
const FIRST: [&str; 7] = ["first", "firstfile", "from", "start", "von", "erste", "erstes"];
const LAST: [&str; 7] = ["last", "lastfile", "to", "end", "bis", "letzte", "letztes"];
/// Maximum number of frames that the rows of a table name by first and last.
const MAX_FRAMES: usize = 100_000;

/// Tables by folder.
pub struct FrameTables(BTreeMap<PathBuf, Vec<FrameTable>>);

/// Rows by their leading name: cells under column names, or lines of plain text.
enum Rows {
    Cells(HashMap<String, Vec<Said>>),
    Lines(HashMap<String, String>),
}

impl Rows {
    fn facts(&self, name: &str) -> Option<Facts> {
        match self {
            Self::Cells(rows) => rows.get(name).map(|said| words::facts(said.clone(), Writer::Lines)),
            Self::Lines(rows) => rows.get(name).map(|said| lists::facts(said)),
        }
    }

    /// Returns the alphabetically first name.
    fn example(&self) -> Option<&String> {
        match self {
            Self::Cells(rows) => rows.keys().min(),
            Self::Lines(rows) => rows.keys().min(),
        }
    }
}

/// Table or list beside the frames.
struct FrameTable {
    path: PathBuf,
    rows: Rows,
    /// True after a row has named a frame.
    is_used: Cell<bool>,
}

impl FrameTables {
    /// Reads the tables in the folders of the images and in their parent folders.
    pub fn beside(images: &[PathBuf]) -> Self {
        let own: BTreeSet<&Path> = images.iter().filter_map(|p| p.parent()).collect();
        let above = own.iter().filter_map(|folder| folder.parent());
        let folders: BTreeSet<&Path> = own.iter().copied().chain(above).collect();
        let found = folders.into_iter().map(|folder| (folder.to_path_buf(), tables_in(folder)));
        Self(found.filter(|(_, tables)| !tables.is_empty()).collect())
    }

    /// Returns the facts of the table row that names an image, a prefix of its name up to a separator,
    /// or its folder; empty if there is none.
    pub fn facts(&self, image: &Path) -> Facts {
        self.facts_of(image, |rows| matches!(rows, Rows::Cells(_)))
    }

    /// Returns the facts of the plain-text line that names an image in the same way. They rank below
    /// names: any prose may begin with a folder's name.
    pub fn listed(&self, image: &Path) -> Facts {
        self.facts_of(image, |rows| matches!(rows, Rows::Lines(_)))
    }

    fn facts_of(&self, image: &Path, is_asked: impl Fn(&Rows) -> bool) -> Facts {
        let folder = image.parent().unwrap_or(Path::new(""));
        let text = |name: Option<&std::ffi::OsStr>| name.unwrap_or_default().to_string_lossy().into_owned();
        let (name, stem) = (text(image.file_name()), text(image.file_stem()));
        let prefixes = super::sidecar::prefixes(&stem).map(str::to_string);
        let keys: Vec<String> =
            [name].into_iter().chain(prefixes).chain([text(folder.file_name())]).collect();
        let tables = [Some(folder), folder.parent()].into_iter().flatten();
        let tables = tables.filter_map(|folder| self.0.get(folder)).flatten().filter(|t| is_asked(&t.rows));
        for table in tables {
            if let Some(mut facts) = keys.iter().find_map(|key| table.rows.facts(key)) {
                table.is_used.set(true);
                let name = text(table.path.file_name());
                facts.from.values_mut().for_each(|from| *from = format!("{name}: {from}"));
                return facts;
            }
        }
        Facts::default()
    }

    /// Lists tables in which no row named a frame.
    pub fn unused(&self) -> Vec<String> {
        let unused = self.0.values().flatten().filter(|t| !t.is_used.get());
        let words = |t: &FrameTable| {
            let such = t.rows.example().map_or(String::new(), |name| format!(" (it has \"{name}\")"));
            format!(
                "{}: no row names a frame or a folder{such}; a table whose first row names its columns (file,exposure_ms,kind) is read",
                t.path.display()
            )
        };
        unused.map(words).collect()
    }
}

/// Reads the tables of a folder, sorted by name.
fn tables_in(folder: &Path) -> Vec<FrameTable> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let entries = std::fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok).map(|e| e.path());
    let is_table = |path: &PathBuf| {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        EXTENSIONS.contains(&&*extension)
            && path.metadata().is_ok_and(|m| m.is_file() && m.len() <= MAX_BYTES)
    };
    let mut paths: Vec<PathBuf> = entries.filter(is_table).collect();
    // Plain texts come last: a camera program may write one per frame.
    paths.sort_by_cached_key(|path| (is_text(path), path.clone()));
    paths.truncate(MAX_TABLES);
    paths.iter().filter_map(|path| table(path)).collect()
}

/// Returns true for plain text, which need not be a table.
fn is_text(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("txt"))
}

/// Reads a table with a header, or a plain-text list; `None` for any other file.
fn table(path: &Path) -> Option<FrameTable> {
    let text = crate::input::plain_text(path).ok()?;
    let rows = match is_text(path) && !names_frames(&text) {
        true => Rows::Lines(lists::rows_of(&text)?),
        false => Rows::Cells(rows_of(&text)?),
    };
    Some(FrameTable { path: path.to_path_buf(), rows, is_used: Cell::new(false) })
}

/// Returns true if the first line has several columns, one of which names frames or folders.
fn names_frames(text: &str) -> bool {
    let first = text.trim_start_matches('\u{feff}').lines().find(|l| !l.starts_with('#')).unwrap_or_default();
    let columns: Vec<String> =
        first.split(char::from(delimiter(first))).map(|c| words::plain(c.trim_matches('"'))).collect();
    columns.len() > 1 && columns.iter().any(|c| NAMES.contains(&&**c) || FIRST.contains(&&**c))
}

/// Parses rows by their leading name. Rows of one name with different values are questioned later, as
/// for headers.
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
    let column = |names: &[&str]| names.iter().find_map(|name| plain.iter().position(|p| p == name));
    let named = column(&NAMES);
    let range = column(&FIRST).zip(column(&LAST)).filter(|_| named.is_none());
    let key = named.or(range.map(|r| r.0)).unwrap_or(0);
    let mut rows: HashMap<String, Vec<Said>> = HashMap::new();
    for record in reader.records().filter_map(Result::ok) {
        let cell = |k: usize| record.get(k).and_then(|cell| cell.rsplit(['/', '\\']).next());
        let Some(name) = cell(key) else { continue };
        let is_name = |k: usize| k == key || range.is_some_and(|r| k == r.0 || k == r.1);
        let said = header.iter().zip(record.iter()).enumerate().filter(|(k, _)| !is_name(*k));
        let said: Vec<Said> = said.map(|(_, (column, cell))| Said::new(column, cell)).collect();
        let left = MAX_FRAMES.saturating_sub(rows.len());
        let all =
            range.and_then(|r| between(cell(r.0)?, cell(r.1)?, left)).unwrap_or_else(|| vec![name.into()]);
        for name in all {
            rows.entry(name).or_default().extend(said.iter().cloned());
        }
    }
    Some(rows)
}

/// Lists the names from the first to the last, which differ in their trailing number: `img_0001`,
/// `img_0004`; `None` beyond the maximum.
fn between(first: &str, last: &str, most: usize) -> Option<Vec<String>> {
    let parts = |name: &str| {
        let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem).to_string();
        let digits = stem.len() - stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
        let number: u64 = stem[stem.len() - digits..].parse().ok()?;
        Some((stem[..stem.len() - digits].to_string(), number, digits))
    };
    let ((prefix, from, digits), (other, to, _)) = parts(first).zip(parts(last))?;
    let few = prefix == other && from <= to && to - from < most as u64;
    few.then(|| (from..=to).map(|n| format!("{prefix}{n:0digits$}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn rows_of_several_frames_name_each() {
        let rows = rows_of("first,last,exposure_ms\nimg_0009.tif,img_0011.tif,5\na,b,7\n").unwrap();
        for name in ["img_0009", "img_0010", "img_0011"] {
            assert_eq!(rows[name], [Said::new("exposure_ms", "5")]);
        }
        assert_eq!((rows.len(), &rows["a"][0]), (4, &Said::new("exposure_ms", "7")));
        for (first, last) in [("img_5", "img_4"), ("a1", "b2"), ("a1", "a99999")] {
            assert_eq!(between(first, last, 1000), None, "{first} {last}");
        }
        // Start and end times of a named frame are not frame names.
        assert_eq!(rows_of("file,start,end\nx.tif,1.5,9\n").unwrap().len(), 1);
    }

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
