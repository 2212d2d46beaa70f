//! Rows that jump from frame to frame, in darks too: text burnt in by a camera or program (a time stamp),
//! embedded data, defective rows and clusters of pixels. These rows are excluded from all frames.

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
/// Maximum height of the part relative to the frame, and minimum fraction of its rectangle that jumps.
const MAX_HEIGHT: f64 = 0.25;
const MIN_DENSITY: f64 = 0.1;
/// Minimum height and width of text, pixels, and maximum fraction of its rectangle that jumps: embedded data
/// and defective rows are thin, and clusters of defective pixels have no gaps.
const MIN_SIZE_OF_TEXT: (usize, usize) = (5, 8);
const MAX_DENSITY_OF_TEXT: f64 = 0.95;
/// Rows beside the text that its edges may reach.
const MARGIN: usize = 2;

/// Returns pixels that jump between two frames of a kind; empty if they are too many.
pub(super) fn jumping(before: &[u16], after: &[u16], full: u16, kind: Kind) -> Vec<u32> {
    let share = if kind == Kind::Dark { JUMP_OF_DARKS } else { JUMP };
    let least = (share * f64::from(full)) as u16;
    few(before.iter().zip(after).map(|(a, b)| a.abs_diff(*b) > least))
}

/// Returns pixels of a dark that are as bright as text; empty if they are too many.
pub(super) fn bright(dark: &[u16], full: u16) -> Vec<u32> {
    let least = (JUMP * f64::from(full)) as u16;
    few(dark.iter().map(|dn| *dn > least))
}

/// Returns the places of true values; none if they are too many.
fn few(values: impl ExactSizeIterator<Item = bool>) -> Vec<u32> {
    let most = (MAX_SHARE * values.len() as f64) as usize;
    let found: Vec<u32> =
        values.enumerate().filter(|(_, is)| *is).take(most + 1).map(|(place, _)| place as u32).collect();
    if found.len() > most { Vec::new() } else { found }
}

/// Returns the dataset without the rows that jump, the fault, and true if they hold text; `None` without such
/// rows, and for statistics whose frames are not read again.
pub(super) fn without_part_that_jumps(
    dataset: &Dataset,
    facts: &[SetFacts],
) -> Option<(Dataset, DataFault, bool)> {
    if dataset.reduced().is_some() {
        return None;
    }
    let jumping = part_that_jumps(dataset, facts)?;
    let (height, width) = (dataset.manifest().camera.height, dataset.manifest().camera.width);
    let (above, below) = (jumping.rows.start.saturating_sub(MARGIN), (jumping.rows.end + MARGIN).min(height));
    let rows = if above >= height - below { 0..above } else { below..height };
    let text = format!("all sets: {}; rows {} to {} are used", jumping.in_words(), rows.start, rows.end - 1);
    let part = dataset.cut_to(Region { rows, columns: 0..width })?;
    let sets = dataset.sets().iter().map(|s| s.number).collect();
    let kind = FaultKind::OtherSettings;
    Some((part, DataFault { kind, sets, frames: Vec::new(), text, left_out: false }, jumping.is_text))
}

/// Part of the frames that jumps from frame to frame.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct PartThatJumps {
    rows: Range<usize>,
    /// True if its shape is that of text.
    is_text: bool,
}

impl PartThatJumps {
    /// Returns the rows and the cause.
    pub fn in_words(&self) -> String {
        let rows = match self.rows.len() {
            1 => format!("row {} jumps", self.rows.start),
            _ => format!("rows {} to {} jump", self.rows.start, self.rows.end - 1),
        };
        let cause = if self.is_text {
            "as text does, such as a time stamp (switch the overlay off)"
        } else {
            "(embedded data, or defective pixels)"
        };
        format!("{rows} from frame to frame {cause}")
    }
}

/// Returns the rows that jump, within sets or from one dark set to the next.
pub(crate) fn part_that_jumps(dataset: &Dataset, facts: &[SetFacts]) -> Option<PartThatJumps> {
    let camera = &dataset.manifest().camera;
    let is_dark = |set: &usize| dataset.settings(&dataset.sets()[*set]).kind == Kind::Dark;
    let darks: Vec<usize> = (0..facts.len()).filter(is_dark).collect();
    let between = |pair: &[usize]| -> Vec<u32> {
        let [a, b]: [HashSet<u32>; 2] = [0, 1].map(|k| facts[pair[k]].bright.iter().copied().collect());
        a.symmetric_difference(&b).copied().collect()
    };
    // Rays of one frame do not stay for a set: one change from set to set tells as much as jumps in two.
    let mut jumping: Vec<Vec<u32>> = darks.windows(2).map(between).collect();
    jumping.extend_from_within(..);
    if jumping.iter().all(Vec::is_empty) && darks.iter().all(|d| facts[*d].jumping.is_empty()) {
        return None;
    }
    jumping.extend(facts.iter().map(|f| f.jumping.clone()));
    part_of(&jumping, (camera.height, camera.width))
}

/// Returns the part from the pixels that jump in each set; frames of (rows, columns).
fn part_of(jumping: &[Vec<u32>], (height, width): (usize, usize)) -> Option<PartThatJumps> {
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
    let density = glyphs.len() as f64 / (rows * columns) as f64;
    let is_part =
        glyphs.len() >= MIN_PIXELS && rows as f64 <= MAX_HEIGHT * height as f64 && density >= MIN_DENSITY;
    let is_text =
        rows >= MIN_SIZE_OF_TEXT.0 && columns >= MIN_SIZE_OF_TEXT.1 && density <= MAX_DENSITY_OF_TEXT;
    is_part.then_some(PartThatJumps { rows: top..bottom + 1, is_text })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two digits that jump in two sets are text; a cluster without gaps and a row are not. The digits in one
    /// set, and isolated pixels, are no part of the frame.
    #[test]
    fn text_is_told_from_pixels_that_blink() {
        let block = |columns: std::ops::Range<u32>| -> Vec<u32> {
            (4..11).flat_map(|y| columns.clone().map(move |x| y * 100 + x)).collect()
        };
        let glyphs = [block(20..25), block(26..31)].concat();
        let blinking: Vec<u32> = (0..60).map(|k| (k * 37 % 80) * 100 + k * 53 % 100).collect();
        let row: Vec<u32> = (0..100).map(|x| 40 * 100 + x).collect();
        let of = |sets: [&[u32]; 2]| part_of(&sets.map(<[u32]>::to_vec), (80, 100));
        let both = [glyphs.clone(), blinking.clone()].concat();
        assert_eq!(of([&glyphs, &both]), Some(PartThatJumps { rows: 4..11, is_text: true }));
        assert_eq!(of([&glyphs, &blinking]), None);
        assert_eq!(of([&blinking, &blinking]), None);
        let solid = block(20..28);
        assert_eq!(of([&solid, &solid]), Some(PartThatJumps { rows: 4..11, is_text: false }));
        assert_eq!(of([&row, &row]), Some(PartThatJumps { rows: 40..41, is_text: false }));
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
