//! Text burnt into frames by a camera or program: a time stamp, a counter. Its glyphs jump between black
//! and white from frame to frame, in darks too, close together in few rows. These rows are excluded from
//! all frames.

use super::SetFacts;
use crate::dataset::{DataFault, Dataset, FaultKind, Kind, Region};
use std::collections::HashMap;

/// Minimum jump of a sample between successive frames, relative to full scale (a named choice: pixel
/// noise and lamp flicker are far below).
const JUMP: f64 = 0.2;
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
/// Maximum height of the text relative to the frame, and minimum fraction of its rectangle that jumps.
const MAX_HEIGHT: f64 = 0.25;
const MIN_DENSITY: f64 = 0.1;
/// Rows beside the text that its edges may reach.
const MARGIN: usize = 2;

/// Returns pixels that jump between two frames; empty if there are more than text has.
pub(super) fn jumping(before: &[u16], after: &[u16], full: u16) -> Vec<u32> {
    let least = (JUMP * f64::from(full)) as u16;
    let jumps = |(_, (a, b)): &(usize, (&u16, &u16))| a.abs_diff(**b) > least;
    let most = (MAX_SHARE * before.len() as f64) as usize;
    let found: Vec<u32> =
        before.iter().zip(after).enumerate().filter(jumps).take(most + 1).map(|p| p.0 as u32).collect();
    if found.len() > most { Vec::new() } else { found }
}

/// Returns the dataset without the rows of text, and the fault; `None` without text, and for statistics
/// whose frames are not read again.
pub(super) fn without_text(dataset: &Dataset, facts: &[SetFacts]) -> Option<(Dataset, DataFault)> {
    let camera = &dataset.manifest().camera;
    let shape = (camera.height, camera.width);
    let is_dark = |set: usize| dataset.settings(&dataset.sets()[set]).kind == Kind::Dark;
    if dataset.reduced().is_some() || !(0..facts.len()).any(|s| is_dark(s) && !facts[s].jumping.is_empty()) {
        return None;
    }
    let [first, last] = rows_of_text(facts.iter().map(|f| f.jumping.as_slice()), shape)?;
    let (above, below) = (first.saturating_sub(MARGIN), (last + 1 + MARGIN).min(shape.0));
    let rows = if above >= shape.0 - below { 0..above } else { below..shape.0 };
    let part = dataset.cut_to(Region { rows: rows.clone(), columns: 0..shape.1 })?;
    let text = format!(
        "all sets: rows {first} to {last} hold text that changes from frame to frame, such as a time stamp: rows {} to {} are used. Switch the \
         overlay off",
        rows.start,
        rows.end - 1
    );
    let sets = dataset.sets().iter().map(|s| s.number).collect();
    Some((
        part,
        DataFault { kind: FaultKind::OtherSettings, sets, frames: Vec::new(), text, left_out: false },
    ))
}

/// Returns the first and last row of text from the pixels that jump in each set; frames of (rows,
/// columns).
fn rows_of_text<'f>(
    jumping: impl Iterator<Item = &'f [u32]>,
    (height, width): (usize, usize),
) -> Option<[usize; 2]> {
    let mut sets: HashMap<u32, usize> = HashMap::new();
    jumping.flatten().for_each(|pixel| *sets.entry(*pixel).or_default() += 1);
    let often: Vec<(usize, usize)> = sets
        .into_iter()
        .filter(|(_, n)| *n >= MIN_SETS)
        .map(|(p, _)| (p as usize / width, p as usize % width))
        .collect();
    let occupied: std::collections::HashSet<(usize, usize)> = often.iter().copied().collect();
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
        && rows as f64 <= MAX_HEIGHT * height as f64
        && glyphs.len() as f64 >= MIN_DENSITY * (rows * columns) as f64;
    is_text.then_some([top, bottom])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A block of pixels that jump in two sets is text; the same block in one set, and isolated pixels,
    /// are not.
    #[test]
    fn text_is_told_from_pixels_that_blink() {
        let glyph: Vec<u32> = (4..11).flat_map(|y| (20..25).map(move |x| y * 100 + x)).collect();
        let blinking: Vec<u32> = (0..60).map(|k| (k * 37 % 80) * 100 + k * 53 % 100).collect();
        let of = |sets: &[&[u32]]| rows_of_text(sets.iter().copied(), (80, 100));
        let both: Vec<u32> = glyph.iter().chain(&blinking).copied().collect();
        assert_eq!(of(&[&glyph, &both]), Some([4, 10]));
        assert_eq!(of(&[&glyph, &blinking]), None);
        assert_eq!(of(&[&blinking, &blinking]), None);
    }

    #[test]
    fn light_that_jumps_everywhere_is_no_text() {
        let (dark, bright) = (vec![10u16; 1000], vec![900u16; 1000]);
        assert!(jumping(&dark, &bright, 1023).is_empty());
        let mut some = dark.clone();
        some[5] = 900;
        assert_eq!(jumping(&dark, &some, 1023), [5]);
    }
}
