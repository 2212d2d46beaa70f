//! Table of statistics instead of frames: many laboratories keep nothing else.

use super::{DatasetError, Lines, csv_words};
use crate::input::{self, echo};
use serde::Deserialize;
use std::path::Path;

/// Row of the table: one light level, black level subtracted.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Level {
    /// Mean above the black level, DN.
    pub mean_dn: f64,
    /// Temporal variance, DN^2.
    pub var_dn2: f64,
    /// Exposure, s.
    #[serde(default)]
    pub exposure_s: Option<f64>,
    /// Illumination.
    #[serde(default)]
    pub illumination: Option<f64>,
    /// Number of the light source, whose strength is unknown but constant.
    #[serde(default)]
    pub lamp: Option<u32>,
    /// Reading of a light monitor, in its own unit.
    #[serde(default)]
    pub monitor: Option<f64>,
    /// Number of pixels behind the variance.
    #[serde(default)]
    pub pixels: Option<f64>,
    /// Covariance with the next pixel of the same row, DN^2.
    #[serde(default)]
    pub cov_01: Option<f64>,
    /// Covariance with the same column of the next row, DN^2.
    #[serde(default)]
    pub cov_10: Option<f64>,
    /// Covariance with the diagonal neighbour, DN^2.
    #[serde(default)]
    pub cov_11: Option<f64>,
}

/// Table of statistics.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Rows in file order.
    pub levels: Vec<Level>,
}

impl Table {
    /// Returns true if the first line that is not a comment looks like the header of a table.
    pub fn is_table(path: &Path) -> bool {
        let named = |h: &str| {
            let columns = h.split([',', ';', '\t']).map(|c| c.trim().trim_matches('"'));
            columns.into_iter().any(|c| c == "mean_dn" || c == "var_dn2")
        };
        let is_text = input::start(path, 1024).is_ok_and(|start| !start.contains(&0));
        is_text && input::table(path).is_ok_and(|text| header(&text).is_some_and(named))
    }

    /// Reads a table. Lines that begin with `#` are comments; unknown columns are ignored.
    ///
    /// # Errors
    ///
    /// The file cannot be read, or a line is not a row: its number and fault.
    pub fn open(path: &Path) -> Result<Self, DatasetError> {
        let text = super::text(path)?;
        Self::parse(&text).map_err(|(line, message)| DatasetError::Row { path: path.into(), line, message })
    }

    /// Finds duplicate rows, as (row, first equal row) from 0: two real measurements differ.
    pub fn copies(&self) -> Vec<(usize, usize)> {
        let mut seen = std::collections::HashMap::new();
        let key = |l: &Level| {
            [Some(l.mean_dn), Some(l.var_dn2), l.exposure_s, l.illumination].map(|v| v.map(f64::to_bits))
        };
        let rows = self.levels.iter().enumerate();
        rows.filter_map(|(i, l)| match *seen.entry((key(l), l.lamp)).or_insert(i) {
            first if first == i => None,
            first => Some((i, first)),
        })
        .collect()
    }

    fn parse(text: &str) -> Result<Self, (u64, String)> {
        let text = text.strip_prefix(BOM).unwrap_or(text);
        let delimiter = delimiter(header(text).unwrap_or_default());
        let mut reader = csv::ReaderBuilder::new()
            .comment(Some(b'#'))
            .trim(csv::Trim::All)
            .delimiter(delimiter)
            .from_reader(text.as_bytes());
        let header = reader.headers().map_err(|e| (1, e.to_string()))?.clone();
        for needed in ["mean_dn", "var_dn2"] {
            if !header.iter().any(|name| name == needed) {
                return Err((1, format!("the header has no column {needed}")));
            }
        }
        let mut levels = Vec::new();
        let mut records = Vec::new();
        let mut lines = Lines::of(text);
        for record in reader.records() {
            let record = record.map_err(|e| (lines.line_at(e.position()), csv_words(&e, &header)))?;
            records.push((lines.line_at(record.position()), record));
        }
        for (line, record) in with_points(records, &header, delimiter)? {
            let level: Level =
                record.deserialize(Some(&header)).map_err(|e| (line, csv_words(&e, &header)))?;
            if !(level.mean_dn.is_finite() && level.var_dn2.is_finite() && level.var_dn2 >= 0.0) {
                let message = format!(
                    "mean_dn {} and var_dn2 {} must be finite, the variance not below 0",
                    level.mean_dn, level.var_dn2
                );
                return Err((line, message));
            }
            if level.pixels.is_some_and(|p| !(p.is_finite() && p >= 2.0)) {
                return Err((line, "pixels must be 2 or more".into()));
            }
            check_level(&level).map_err(|message| (line, message))?;
            levels.push(level);
        }
        if levels.is_empty() {
            return Err((1, "the table has no rows".into()));
        }
        Ok(Self { levels })
    }
}

/// Refuses impossible optional values.
fn check_level(level: &Level) -> Result<(), String> {
    if let Some(e) = level.exposure_s.filter(|e| !(e.is_finite() && *e > 0.0)) {
        return Err(format!("exposure_s is {e}, and must be above 0 s"));
    }
    if let Some(i) = level.illumination.filter(|i| !(i.is_finite() && *i >= 0.0)) {
        return Err(format!("illumination is {i}, and must not be below 0"));
    }
    for (name, value) in [
        ("monitor", level.monitor),
        ("cov_01", level.cov_01),
        ("cov_10", level.cov_10),
        ("cov_11", level.cov_11),
    ] {
        if value.is_some_and(|v| !v.is_finite()) {
            return Err(format!("{name} is not a finite number"));
        }
    }
    Ok(())
}

/// Byte order mark that spreadsheets write before UTF-8.
const BOM: char = '\u{feff}';

/// Returns the first line that is not a comment.
fn header(text: &str) -> Option<&str> {
    let text = text.strip_prefix(BOM).unwrap_or(text);
    text.lines().find(|l| !l.starts_with('#') && !l.trim().is_empty())
}

/// Returns the column separator: spreadsheets write semicolons if the comma is the decimal sign.
pub(crate) fn delimiter(header: &str) -> u8 {
    let count = |c: char| header.matches(c).count();
    match (count(';'), count('\t'), count(',')) {
        (0, 0, _) => b',',
        (n, tabs, _) if n >= tabs => b';',
        _ => b'\t',
    }
}

/// Converts records to decimal points. A comma is the decimal sign if columns are separated otherwise or
/// quoted; if every number with a comma could also have thousands groups, the meaning is ambiguous.
fn with_points(
    records: Vec<(u64, csv::StringRecord)>,
    header: &csv::StringRecord,
    delimiter: u8,
) -> Result<Vec<(u64, csv::StringRecord)>, (u64, String)> {
    const NUMBERS: [&str; 10] = [
        "mean_dn",
        "var_dn2",
        "exposure_s",
        "illumination",
        "lamp",
        "monitor",
        "pixels",
        "cov_01",
        "cov_10",
        "cov_11",
    ];
    let is_number = |k: usize| header.get(k).is_some_and(|name| NUMBERS.contains(&name));
    let thousands = |field: &str| {
        let (whole, rest) = field.split_once(',').unwrap_or((field, ""));
        let whole = whole.trim_start_matches('-');
        (1..=3).contains(&whole.len()) && whole != "0" && rest.len() == 3
    };
    let mut first = None;
    let mut sure = delimiter != b',';
    for (line, record) in &records {
        for (_, field) in record.iter().enumerate().filter(|(k, f)| is_number(*k) && f.contains(',')) {
            if field.contains('.') || field.matches(',').count() > 1 {
                let message = format!(
                    "{} has points and commas: write numbers without groups of thousands",
                    echo(field)
                );
                return Err((*line, message));
            }
            sure |= !thousands(field);
            first = first.or(Some((*line, field.to_string())));
        }
    }
    let Some((line, field)) = first else { return Ok(records) };
    if !sure {
        let message =
            format!("{}: is the comma the decimal sign or a group of thousands? Write a point", echo(&field));
        return Err((line, message));
    }
    let plain = |record: csv::StringRecord| -> csv::StringRecord {
        let of = |(k, f): (usize, &str)| if is_number(k) { f.replace(',', ".") } else { f.to_string() };
        record.iter().enumerate().map(of).collect()
    };
    Ok(records.into_iter().map(|(line, record)| (line, plain(record))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn optional_columns_may_be_absent_or_empty() {
        let table =
            Table::parse("# a\nmean_dn,var_dn2,pixels,lamp,about\n10,5,,,x\n20,9,1000,2,y\n").unwrap();
        assert_eq!(table.levels[0].pixels, None);
        assert_eq!((table.levels[1].pixels, table.levels[1].lamp), (Some(1000.0), Some(2)));
        for text in [
            "\u{feff}mean_dn;var_dn2;exposure_s\r\n100,5;54,3;0,001\r\n1,234;104,3;0,002\r\n",
            "mean_dn\tvar_dn2\texposure_s\n100.5\t54.3\t0.001\n1.234\t104.3\t0.002\n",
            "mean_dn,var_dn2,exposure_s\n\"100,5\",\"54,3\",\"0,001\"\n\"1,234\",\"104,3\",\"0,002\"\n",
        ] {
            let levels = Table::parse(text).unwrap().levels;
            assert_eq!((levels[0].mean_dn, levels[0].exposure_s), (100.5, Some(0.001)), "{text}");
            assert_eq!((levels[1].mean_dn, levels[1].var_dn2), (1.234, 104.3), "{text}");
        }
        for (text, line, part) in [
            ("mean_dn,var_dn2\n\"1,234\",\"2,345\"\n", 2, "group of thousands"),
            ("mean_dn;var_dn2\n1.234,5;2\n", 2, "points and commas"),
            ("mean_dn,pixels\n1,2\n", 1, "var_dn2"),
            ("mean_dn,var_dn2\n1,x\n", 2, "invalid float"),
            ("# a\r\nmean_dn,var_dn2\r\n1,2\r\n3,x\r\n", 4, "var_dn2: invalid float"),
            ("mean_dn,var_dn2\n1,2\n3\n", 3, "1 fields"),
            ("mean_dn,var_dn2\n1,-2\n", 2, "not below 0"),
            ("mean_dn,var_dn2\n", 1, "no rows"),
        ] {
            let (found, message) = Table::parse(text).unwrap_err();
            assert!(found == line && message.contains(part), "{found}: {message}");
        }
    }
}
