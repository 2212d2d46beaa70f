//! Text burnt into frames by a camera or program: a time stamp, a counter. Its glyphs jump between black
//! and white from frame to frame, in darks too, close together in few rows. These rows are excluded from
//! all frames.

use super::SetFacts;
use crate::dataset::{DataFault, Dataset, FaultKind, Kind, Region};
use std::collections::{HashMap, HashSet};
use std::ops::Range;

/// Minimum jump of a sample between successive frames, relative to full scale: in flats, and in darks, which
/// have less noise and no flicker (named choices).
const JUMP: f64 = 0.2;
const JUMP_OF_DARKS: f64 = 0.03;
/// Maximum fraction of the pixels covered by text; jumps elsewhere are light.
const MAX_SHARE: f64 = 0.05;
/// Minimum number of sets in which a glyph pixel jumps: cosmic rays hit a pixel once.
const MIN_SETS: usize = 2;
/// Distance in each direction within which other pixels of the glyph lie, and minimum number of these:
/// blinking pixels are isolated.
const REACH: usize = 3;
const MIN_BESIDE: usize = 3;
/// Minimum number of such pixels: half of a digit of 5 x 7.
const MIN_PIXELS: usize = 16;
/// Maximum height of the text relative to the frame, its minimum height and width, pixels, and the fraction
/// of its rectangle that jumps: defective rows are thin, and clusters of defective pixels have no gaps.
const MAX_HEIGHT: f64 = 0.25;
const MIN_SIZE: (usize, usize) = (5, 8);
const DENSITY: std::ops::RangeInclusive<f64> = 0.1..=0.95;
/// Rows beside the text that its edges may reach.
const MARGIN: usize = 2;

/// Returns pixels that jump between two frames of a kind; empty if there are more than text has.
pub(super) fn jumping(before: &[u16], after: &[u16], full: u16, kind: Kind) -> Vec<u32> {
    let share = if kind == Kind::Dark { JUMP_OF_DARKS } else { JUMP };
    let least = (share * f64::from(full)) as u16;
    few(before.iter().zip(after).map(|(a, b)| a.abs_diff(*b) > least))
}

/// Returns pixels of a dark that are as bright as text; empty if there are more than text has.
pub(super) fn bright(dark: &[u16], full: u16) -> Vec<u32> {
    let least = (JUMP * f64::from(full)) as u16;
    few(dark.iter().map(|dn| *dn > least))
}

/// Returns the places of true values; none if there are more than text has.
fn few(values: impl ExactSizeIterator<Item = bool>) -> Vec<u32> {
    let most = (MAX_SHARE * values.len() as f64) as usize;
    let found: Vec<u32> =
        values.enumerate().filter(|(_, is)| *is).take(most + 1).map(|(place, _)| place as u32).collect();
    if found.len() > most { Vec::new() } else { found }
}

/// Returns the dataset without the rows of text, and the fault; `None` without text, and for statistics
/// whose frames are not read again.
pub(super) fn without_text(dataset: &Dataset, facts: &[SetFacts]) -> Option<(Dataset, DataFault)> {
    if dataset.reduced().is_some() {
        return None;
    }
    let text = rows_with_text(dataset, facts)?;
    let (height, width) = (dataset.manifest().camera.height, dataset.manifest().camera.width);
    let (above, below) = (text.start.saturating_sub(MARGIN), (text.end + MARGIN).min(height));
    let rows = if above >= height - below { 0..above } else { below..height };
    let part = dataset.cut_to(Region { rows: rows.clone(), columns: 0..width })?;
    let said = format!(
        "all sets: rows {} to {} change from frame to frame as text does, such as a time stamp: rows {} to {} are used. Switch the overlay off",
        text.start,
        text.end - 1,
        rows.start,
        rows.end - 1
    );
    let sets = dataset.sets().iter().map(|s| s.number).collect();
    Some((
        part,
        DataFault { kind: FaultKind::OtherSettings, sets, frames: Vec::new(), text: said, left_out: false },
    ))
}

/// Returns the rows that hold text. It jumps within sets, or from one dark set to the next.
pub(crate) fn rows_with_text(dataset: &Dataset, facts: &[SetFacts]) -> Option<Range<usize>> {
    let camera = &dataset.manifest().camera;
    let is_dark = |set: &usize| dataset.settings(&dataset.sets()[*set]).kind == Kind::Dark;
    let darks: Vec<usize> = (0..facts.len()).filter(is_dark).collect();
    let between = |pair: &[usize]| -> Vec<u32> {
        let [a, b]: [HashSet<u32>; 2] = [0, 1].map(|k| facts[pair[k]].bright.iter().copied().collect());
        a.symmetric_difference(&b).copied().collect()
    };
    let mut jumping: Vec<Vec<u32>> = darks.windows(2).map(between).collect();
    if jumping.iter().all(Vec::is_empty) && darks.iter().all(|d| facts[*d].jumping.is_empty()) {
        return None;
    }
    jumping.extend(facts.iter().map(|f| f.jumping.clone()));
    rows_of_text(&jumping, (camera.height, camera.width))
}

/// Returns the rows of text from the pixels that jump in each set; frames of (rows, columns).
fn rows_of_text(jumping: &[Vec<u32>], (height, width): (usize, usize)) -> Option<Range<usize>> {
    let mut sets: HashMap<u32, usize> = HashMap::new();
    jumping.iter().flatten().for_each(|pixel| *sets.entry(*pixel).or_default() += 1);
    let often: Vec<(usize, usize)> = sets
        .into_iter()
        .filter(|(_, n)| *n >= MIN_SETS)
        .map(|(p, _)| (p as usize / width, p as usize % width))
        .collect();
    let occupied: HashSet<(usize, usize)> = often.iter().copied().collect();
    let beside = |&(y, x): &(usize, usize)| {
        let near = |at: usize| at.saturating_sub(REACH)..=at + REACH;
        near(y).flat_map(|v| near(x).map(move |u| (v, u))).filter(|at| occupied.contains(at)).count()
            > MIN_BESIDE
    };
    let glyphs: Vec<(usize, usize)> = often.into_iter().filter(beside).collect();
    let range = |of: fn(&(usize, usize)) -> usize| {
        let places = || glyphs.iter().map(of);
        places().min().zip(places().max())
    };
    let ((top, bottom), (left, right)) = (range(|p| p.0)?, range(|p| p.1)?);
    let (rows, columns) = (bottom - top + 1, right - left + 1);
    let is_text = glyphs.len() >= MIN_PIXELS
        && rows >= MIN_SIZE.0
        && columns >= MIN_SIZE.1
        && rows as f64 <= MAX_HEIGHT * height as f64
        && DENSITY.contains(&(glyphs.len() as f64 / (rows * columns) as f64));
    is_text.then_some(top..bottom + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two digits that jump in two sets are text; the same in one set, a cluster without gaps, a row, and
    /// isolated pixels are not.
    #[test]
    fn text_is_told_from_pixels_that_blink() {
        let block = |columns: std::ops::Range<u32>| -> Vec<u32> {
            (4..11).flat_map(|y| columns.clone().map(move |x| y * 100 + x)).collect()
        };
        let glyphs = [block(20..25), block(26..31)].concat();
        let blinking: Vec<u32> = (0..60).map(|k| (k * 37 % 80) * 100 + k * 53 % 100).collect();
        let row: Vec<u32> = (0..100).map(|x| 40 * 100 + x).collect();
        let of = |sets: [&[u32]; 2]| rows_of_text(&sets.map(<[u32]>::to_vec), (80, 100));
        let both = [glyphs.clone(), blinking.clone()].concat();
        assert_eq!(of([&glyphs, &both]), Some(4..11));
        let solid = block(20..28);
        for none in [[&glyphs, &blinking], [&blinking, &blinking], [&solid, &solid], [&row, &row]] {
            assert_eq!(of(none.map(Vec::as_slice)), None);
        }
    }

    #[test]
    fn light_that_jumps_everywhere_is_no_text() {
        let (dark, lit) = (vec![10u16; 1000], vec![900u16; 1000]);
        assert!(jumping(&dark, &lit, 1023, Kind::Flat).is_empty() && bright(&lit, 1023).is_empty());
        let mut some = dark.clone();
        some[5] = 60;
        assert_eq!(jumping(&dark, &some, 1023, Kind::Dark), [5]);
        assert!(jumping(&dark, &some, 1023, Kind::Flat).is_empty() && bright(&some, 1023).is_empty());
    }
}
