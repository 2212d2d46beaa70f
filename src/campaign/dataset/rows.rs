//! Rows of `frames.csv`: reader and checks.

use super::{COLUMNS, CameraInfo, DatasetError, FrameRow, Kind};
use crate::input::{echo, echo_message};
use std::path::{Component, Path, PathBuf};

/// Normalises a file name: removes `.` and double separators.
pub(super) fn plain_name(file: &str) -> std::borrow::Cow<'_, str> {
    if file.contains("./") || file.contains("//") || file.contains("/.") {
        let parts = file.split('/').filter(|part| !matches!(*part, "" | "."));
        let root = if file.starts_with('/') { "/" } else { "" };
        return (root.to_string() + &parts.collect::<Vec<_>>().join("/")).into();
    }
    file.into()
}

/// Splits `name.tiff#3` into name and page.
pub(super) fn split_page(file: &str) -> Result<(&str, usize), String> {
    match file.rsplit_once('#').filter(|(_, page)| !page.contains(['/', '\\'])) {
        Some((name, page)) => {
            let page =
                page.parse().map_err(|_| format!("\"#{}\" is not the number of a page", echo(page)))?;
            Ok((name, page))
        }
        None => Ok((file, 0)),
    }
}

/// Line numbers of the records of a CSV text, counted incrementally. The reader's own count omits lines
/// between records.
pub(crate) struct Lines<'a> {
    bytes: &'a [u8],
    at: usize,
    line: u64,
}

impl<'a> Lines<'a> {
    pub(crate) fn of(text: &'a str) -> Self {
        Self { bytes: text.as_bytes(), at: 0, line: 1 }
    }

    /// Returns the line, from 1, at which the record at this position begins.
    pub(crate) fn line_at(&mut self, position: Option<&csv::Position>) -> u64 {
        let Some(position) = position else { return 0 };
        let mut at = (position.byte() as usize).clamp(self.at, self.bytes.len());
        while self.bytes.get(at).is_some_and(|b| matches!(b, b'\r' | b'\n')) {
            at += 1;
        }
        self.line += self.bytes[self.at..at].iter().filter(|b| **b == b'\n').count() as u64;
        self.at = at;
        self.line
    }
}

/// Returns the message of a CSV reader without its position, as the line is stated before it.
pub(crate) fn csv_words(error: &csv::Error, header: &csv::StringRecord) -> String {
    match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("has {len} fields, and the header {expected_len}")
        }
        csv::ErrorKind::Deserialize { err, .. } => {
            let column = err.field().and_then(|i| header.get(i as usize)).unwrap_or("row");
            format!("{}: {}", echo(column), echo_message(&err.kind().to_string()))
        }
        _ => echo_message(&error.to_string()),
    }
}

pub(super) fn parse_rows(path: &Path, text: &str) -> Result<Vec<(u64, FrameRow)>, DatasetError> {
    let fault = |line, message| DatasetError::Row { path: path.into(), line, message };
    let mut reader = csv::ReaderBuilder::new().has_headers(true).from_reader(text.as_bytes());
    let header = reader.headers().map_err(|e| fault(1, e.to_string()))?.clone();
    if header.iter().ne(COLUMNS) {
        return Err(fault(1, format!("the header must be exactly {}", COLUMNS.join(","))));
    }
    let mut rows = Vec::new();
    let mut lines = Lines::of(text);
    for record in reader.records() {
        let record = record.map_err(|e| fault(lines.line_at(e.position()), csv_words(&e, &header)))?;
        let line = lines.line_at(record.position());
        let row = record.deserialize(Some(&header)).map_err(|e| fault(line, csv_words(&e, &header)))?;
        rows.push((line, row));
    }
    Ok(rows)
}

/// Maximum exposure, s: eleven days, as in a plan.
pub(crate) const MAX_EXPOSURE_S: f64 = 1e6;
/// Maximum illumination: more photons per pixel per second than the sun's surface emits.
const MAX_ILLUMINATION: f64 = 1e30;
/// Maximum duration of a campaign, s: times since any epoch fit.
const MAX_TIME_S: f64 = 1e12;

/// Checks a single row; `folders`: folders that absolute paths may point into, if any.
pub(super) fn check_row(row: &FrameRow, folders: &[PathBuf]) -> Result<(), String> {
    let (name, _) = split_page(&row.file)?;
    let path = Path::new(name);
    let plain = |c| matches!(c, Component::Normal(_) | Component::CurDir);
    let inside =
        folders.iter().find_map(|f| path.strip_prefix(f).ok()).or(folders.is_empty().then_some(path));
    if name.is_empty() || !inside.is_some_and(|p| p.components().all(plain)) {
        return Err(format!("file {} must be a path inside the dataset folder", echo(&row.file)));
    }
    if row.exposure_s.is_nan() || row.exposure_s <= 0.0 {
        return Err(format!("exposure_s is {}, and must be above 0 s", row.exposure_s));
    }
    if row.exposure_s > MAX_EXPOSURE_S {
        return Err(format!("exposure_s is {}, and must be at most {MAX_EXPOSURE_S} s", row.exposure_s));
    }
    if !(0.0..=MAX_ILLUMINATION).contains(&row.illumination) {
        return Err(format!(
            "illumination is {}, and must not be below 0 or above {MAX_ILLUMINATION:e}",
            row.illumination
        ));
    }
    if row.kind == Kind::Dark && row.illumination != 0.0 {
        return Err(format!("a dark frame has illumination 0, and this one {}", row.illumination));
    }
    let (name, value) = ("timestamp_s", row.timestamp_s);
    if let Some(value) = value.filter(|t| !(-MAX_TIME_S..=MAX_TIME_S).contains(t)) {
        return Err(format!("{name} is {value}, and must be a number of seconds up to {MAX_TIME_S:e}"));
    }
    CameraInfo::check_temperature(row.temperature_c)
}

/// Checks that frames of one set share every setting.
pub(super) fn same_settings(first: &FrameRow, row: &FrameRow) -> Result<(), String> {
    let differs = [
        ("kind", first.kind != row.kind),
        ("exposure_s", first.exposure_s != row.exposure_s),
        ("illumination", first.illumination != row.illumination),
        ("configuration", first.configuration != row.configuration),
    ];
    match differs.iter().find(|(_, differs)| *differs) {
        Some((name, _)) => Err(format!("{name} differs from the first frame of set {}", row.set)),
        None => Ok(()),
    }
}
