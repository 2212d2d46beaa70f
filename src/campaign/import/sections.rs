//! Overscan stated in FITS headers: TRIMSEC, DATASEC and BIASSEC, in IRAF notation.

use super::Facts;
use crate::dataset::Region;
use ndarray::{ArrayBase, ArrayView2, Data, Ix2, s};
use std::ops::Range;

impl Region {
    /// Returns the region of a frame.
    pub fn of<'a, T, S: Data<Elem = T>>(&self, frame: &'a ArrayBase<S, Ix2>) -> ArrayView2<'a, T> {
        frame.slice(s![self.rows.clone(), self.columns.clone()])
    }

    /// Returns `[column, row, width, height]`, counted from 0.
    pub fn to_numbers(&self) -> [usize; 4] {
        [self.columns.start, self.rows.start, self.columns.len(), self.rows.len()]
    }

    /// Creates a region from `[column, row, width, height]`; `None` if it does not fit a frame of this
    /// shape.
    pub fn from_numbers([x, y, width, height]: [usize; 4], shape: (usize, usize)) -> Option<Self> {
        let (right, bottom) = (x.checked_add(width)?, y.checked_add(height)?);
        let inside = width > 0 && height > 0 && right <= shape.1 && bottom <= shape.0;
        inside.then_some(Self { rows: y..bottom, columns: x..right })
    }

    /// Describes the overscan removed from a frame of this shape, counted from 1 as in FITS.
    pub fn cut_off(&self, shape: (usize, usize)) -> String {
        let side = |name: &str, kept: &Range<usize>, n: usize| {
            let run = |from: usize, to: usize| match to.saturating_sub(from) {
                0 => None,
                1 => Some(format!("{}", to)),
                _ => Some(format!("{} to {to}", from + 1)),
            };
            let runs: Vec<String> = [run(0, kept.start), run(kept.end, n)].into_iter().flatten().collect();
            (!runs.is_empty()).then(|| format!("{name} {} of {n}", runs.join(" and ")))
        };
        let sides = [side("columns", &self.columns, shape.1), side("rows", &self.rows, shape.0)];
        sides.into_iter().flatten().collect::<Vec<_>>().join(", ")
    }
}

/// Parses a section `[x1:x2,y1:y2]`, counted from 1, both ends included; `*` is a whole axis, and an
/// axis may run backwards.
fn section(text: &str, shape: (usize, usize)) -> Option<Region> {
    let inside = text.trim().strip_prefix('[')?.strip_suffix(']')?;
    let (x, y) = inside.split_once(',')?;
    let axis = |text: &str, n: usize| -> Option<Range<usize>> {
        // A step follows a second colon.
        let mut parts = text.trim().split(':');
        let first = parts.next()?.trim();
        if first == "*" {
            return Some(0..n);
        }
        let a: usize = first.parse().ok()?;
        let b: usize = parts.next().map_or(Some(a), |b| b.trim().parse().ok())?;
        let (low, high) = (a.min(b), a.max(b));
        (low >= 1).then(|| low - 1..high)
    };
    Some(Region { columns: axis(x, shape.1)?, rows: axis(y, shape.0)? })
}

/// Removes a strip of overscan along one edge of the frame.
fn without(strip: &Region, (rows, columns): (usize, usize)) -> Option<Region> {
    let (whole_rows, whole_columns) = (0..rows, 0..columns);
    let rest = |strip: &Range<usize>, n: usize| match (strip.start, strip.end) {
        (0, end) if end < n => Some(end..n),
        (start, end) if start > 0 && end == n => Some(0..start),
        _ => None,
    };
    // The strip runs along the edge on its shorter side: rows of overscan may lack the corner.
    let share = |part: &Range<usize>, n: usize| part.len() as f64 / n.max(1) as f64;
    if share(&strip.columns, columns) < share(&strip.rows, rows) {
        Some(Region { columns: rest(&strip.columns, columns)?, rows: whole_rows })
    } else {
        Some(Region { rows: rest(&strip.rows, rows)?, columns: whole_columns })
    }
}

/// Returns the illuminated region stated in the header; `None` if it is the whole frame or not stated.
///
/// # Errors
///
/// A section that cannot be parsed, or extends beyond the frame.
pub fn region_of(facts: &Facts, shape: (usize, usize)) -> Result<Option<Region>, String> {
    let fault = |key: &str, text: &str| {
        format!(
            "{key} is {text}, which is no part of a frame of {} x {} px (columns, rows); correct the header, or remove the \
             card to keep the frame whole",
            shape.1, shape.0
        )
    };
    // Sections of some headers count unbinned pixels.
    let bin = |name: &str| {
        facts.feature(name).and_then(|v| v.parse::<usize>().ok()).filter(|b| *b > 0).unwrap_or(1)
    };
    let (across, down) = (bin("BinningHorizontal"), bin("BinningVertical"));
    let inside = |r: &Region| r.rows.end <= shape.0 && r.columns.end <= shape.1;
    let read = |key: &str, text: &str| {
        let binned = |r: Region| {
            let axis = |a: &Range<usize>, by: usize| a.start.div_ceil(by)..a.end / by;
            Region { rows: axis(&r.rows, down), columns: axis(&r.columns, across) }
        };
        let found = section(text, shape).map(|r| if inside(&r) { r } else { binned(r) }).filter(inside);
        found.filter(|r| !r.rows.is_empty() && !r.columns.is_empty()).ok_or_else(|| fault(key, text))
    };
    let region = match (&facts.trim_section, &facts.bias_section) {
        (Some((key, text)), _) => Some(read(key, text)?),
        (None, Some(text)) => {
            let strip = read("BIASSEC", text)?;
            Some(without(&strip, shape).ok_or_else(|| fault("BIASSEC", text))?)
        }
        (None, None) => None,
    };
    Ok(region.filter(|r| r.rows != (0..shape.0) || r.columns != (0..shape.1)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of(trim: &str, bias: &str) -> Result<Option<[usize; 4]>, String> {
        let text = |t: &str| Some(t.to_string()).filter(|t| !t.is_empty());
        let facts = Facts {
            trim_section: text(trim).map(|t| ("TRIMSEC".into(), t)),
            bias_section: text(bias),
            ..Facts::default()
        };
        Ok(region_of(&facts, (40, 60))?.map(|r| r.to_numbers()))
    }

    #[test]
    fn sections_before_binning_are_read() {
        let mut facts =
            Facts { trim_section: Some(("TRIMSEC".into(), "[1:120,5:80]".into())), ..Facts::default() };
        assert!(region_of(&facts, (40, 60)).is_err());
        facts.set_feature("BinningHorizontal", "2", "CCDSUM");
        facts.set_feature("BinningVertical", "2", "CCDSUM");
        assert_eq!(region_of(&facts, (40, 60)).unwrap().unwrap().to_numbers(), [0, 2, 60, 38]);
    }

    #[test]
    fn sections_are_read_as_iraf_writes_them() {
        assert_eq!(of("[5:56,1:40]", "[57:60,1:40]"), Ok(Some([4, 0, 52, 40])));
        assert_eq!(of("[56:5,40:3]", ""), Ok(Some([4, 2, 52, 38])));
        assert_eq!(of("[*,1:39]", ""), Ok(Some([0, 0, 60, 39])));
        assert_eq!(of("[1:60,1:40]", "[57:60,1:40]"), Ok(None));
        assert_eq!(of("", ""), Ok(None));
        // Only the overscan is stated.
        assert_eq!(of("", "[53:60,1:40]"), Ok(Some([0, 0, 52, 40])));
        assert_eq!(of("", "[1:8,1:40]"), Ok(Some([8, 0, 52, 40])));
        assert_eq!(of("", "[1:52,37:40]"), Ok(Some([0, 0, 60, 36])));
        for (trim, bias) in [("[1:70,1:40]", ""), ("[0:60,1:40]", ""), ("1:60", ""), ("", "[20:30,1:40]")] {
            assert!(of(trim, bias).unwrap_err().contains("60 x 40 px"), "{trim} {bias}");
        }
        let region = Region { rows: 0..39, columns: 4..56 };
        assert_eq!(region.cut_off((40, 60)), "columns 1 to 4 and 57 to 60 of 60, rows 40 of 40");
        assert_eq!(Region::from_numbers([4, 0, 52, 39], (40, 60)), Some(region));
        assert_eq!(Region::from_numbers([4, 0, 57, 39], (40, 60)), None);
    }

    proptest! {
        #[test]
        fn no_section_makes_it_panic(text in "\\[?[0-9:*,]{0,24}\\]?", bias in any::<bool>()) {
            if let Ok(Some([x, y, w, h])) = if bias { of("", &text) } else { of(&text, "") } {
                prop_assert!(w > 0 && h > 0 && x + w <= 60 && y + h <= 40);
            }
        }
    }
}
