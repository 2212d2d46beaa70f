//! Illuminated region of the frames, if other parts get no light: optically black and overscan columns
//! and rows, or the area outside the image circle of a lens. Statistics of whole rows and columns need
//! lines of equal pixels.

use crate::data_faults::ExamineError;
use crate::dataset::{Dataset, Kind, Region, Set};
use crate::statistics::lit::Lit;
use ndarray::Array2;
use std::collections::BTreeMap;

/// Maximum signal of an unlit pixel, relative to the light level (a named choice: lenses leave more in
/// the corners of the area that they are designed for).
const MIN_LIGHT: f32 = 0.3;
/// Minimum light level at which the noise of single pixels is far below a third of it, DN (a named
/// choice).
const MIN_LEVEL_DN: f32 = 64.0;
/// Number of pixels sampled to detect dark ones.
const SAMPLE: usize = 40_000;
/// Maximum fraction of a flat's samples at full scale at which it shows the light.
const MAX_FULL: f64 = 0.01;
/// Minimum fraction of the lit pixels inside the rectangle: the square in a circle has 2/pi = 0.64 of it
/// (a named choice).
const MIN_KEPT: f64 = 0.6;
/// Minimum fraction of unlit pixels that are excluded by region: single ones are defect pixels.
const MIN_BLIND: f64 = 0.005;
/// Minimum side of an examined region, pixels.
const MIN_SIDE: usize = 16;
/// Number of frames of a set that are averaged.
const FRAMES: usize = 2;

/// Returns the dataset cut to the illuminated region, and a description; `None` if all pixels get light,
/// if the data do not suffice, and for statistics whose frames are not read again.
///
/// # Errors
///
/// A frame cannot be read.
pub(crate) fn lit_part(dataset: &Dataset) -> Result<Option<(Dataset, String)>, ExamineError> {
    if dataset.reduced().is_some() {
        return Ok(None);
    }
    let full = dataset.manifest().camera.full_scale_dn();
    let of_kind = |kind: Kind| dataset.sets().iter().filter(move |s| dataset.settings(s).kind == kind);
    let light = |set: &Set| dataset.settings(set).exposure_s * dataset.settings(set).illumination;
    let mean = |set: &Set| -> Result<Array2<f32>, ExamineError> {
        let rows = &set.rows[..set.rows.len().min(FRAMES)];
        let mut sum = Array2::zeros((0, 0));
        for row in rows {
            let frame = dataset.frame(&dataset.rows()[*row])?.mapv(f32::from);
            if sum.is_empty() { sum = frame } else { sum += &frame }
        }
        Ok(sum / rows.len().max(1) as f32)
    };
    let is_full = |image: &Array2<f32>| {
        let count = image.iter().filter(|v| **v >= f32::from(full)).count();
        count as f64 > MAX_FULL * image.len() as f64
    };
    let mut flats: Vec<&Set> = of_kind(Kind::Flat).collect();
    flats.sort_by(|a, b| light(b).total_cmp(&light(a)));
    // Each position of card and light has its own field: a pixel lit in any of them is lit.
    let mut all: BTreeMap<u32, Option<Lit>> = BTreeMap::new();
    for set in flats {
        let settings = dataset.settings(set);
        if all.contains_key(&settings.configuration) {
            continue;
        }
        let flat = mean(set)?;
        if is_full(&flat) {
            continue;
        }
        let apart = |dark: &Set| (dataset.settings(dark).exposure_s / settings.exposure_s).ln().abs();
        let Some(dark) = of_kind(Kind::Dark).min_by(|a, b| apart(a).total_cmp(&apart(b))) else {
            return Ok(None);
        };
        let dark = mean(dark)?;
        let signal = flat - &dark;
        let closer_look = !is_full(&dark) && has_dark_part(&signal);
        all.insert(settings.configuration, closer_look.then(|| Lit::above(&[signal], MIN_LIGHT)));
    }
    // A field that lights the whole sensor leaves no pixel dark.
    let Some(found) = all.into_values().collect::<Option<Vec<Lit>>>().and_then(in_all) else {
        return Ok(None);
    };
    let (blind, of) = (found.blind_pixels(), found.blind.len());
    if (blind as f64) < MIN_BLIND * of as f64 || found.level_dn < MIN_LEVEL_DN {
        return Ok(None);
    }
    let region = match found.frame() {
        Some([rows, columns]) => Region { rows, columns },
        None => {
            let region = largest_without(&found.blind);
            if (region.pixels() as f64) < MIN_KEPT * found.lit_pixels() as f64 {
                return Ok(None);
            }
            region
        }
    };
    if region.rows.len().min(region.columns.len()) < MIN_SIDE {
        return Ok(None);
    }
    let words = format!(
        "less than {:.0} % of the light reaches {blind} of {of} pixels (optically black, overscan, outside of the image circle): rows {} to {} and \
         columns {} to {} are looked at",
        100.0 * MIN_LIGHT,
        region.rows.start,
        region.rows.end.saturating_sub(1),
        region.columns.start,
        region.columns.end.saturating_sub(1)
    );
    Ok(dataset.cut_to(region).map(|part| (part, words)))
}

/// Combines fields: pixels dark in every field, and pixels lit in at least one.
fn in_all(fields: Vec<Lit>) -> Option<Lit> {
    fields.into_iter().reduce(|mut all, own| {
        all.blind.zip_mut_with(&own.blind, |blind, own| *blind &= own);
        all.lit.zip_mut_with(&own.lit, |lit, own| *lit |= own);
        all.level_dn = all.level_dn.min(own.level_dn);
        all
    })
}

/// Returns true if a sample of the pixels contains enough dark ones for a full examination.
fn has_dark_part(signal: &Array2<f32>) -> bool {
    let mut sample: Vec<f32> = signal.iter().copied().step_by((signal.len() / SAMPLE).max(1)).collect();
    if sample.is_empty() {
        return false;
    }
    let bright = 9 * sample.len() / 10;
    let level = *sample.select_nth_unstable_by(bright, f32::total_cmp).1;
    let dark = sample.iter().filter(|v| **v < MIN_LIGHT * level).count();
    dark as f64 > MIN_BLIND * sample.len() as f64
}

/// Finds the largest rectangle without blind pixels: for every row the widest under the column heights
/// so far.
fn largest_without(blind: &Array2<bool>) -> Region {
    let (rows, columns) = blind.dim();
    let mut best = Region { rows: 0..0, columns: 0..0 };
    // Number of consecutive rows without a blind pixel up to this one, per column.
    let mut heights = vec![0usize; columns];
    for y in 0..rows {
        for (x, height) in heights.iter_mut().enumerate() {
            *height = if blind[(y, x)] { 0 } else { *height + 1 };
        }
        // First columns and heights of the open rectangles, in increasing height.
        let mut open: Vec<(usize, usize)> = Vec::new();
        for x in 0..=columns {
            let height = heights.get(x).copied().unwrap_or(0);
            let mut from = x;
            while let Some(&(first, own)) = open.last().filter(|(_, own)| *own > height) {
                if own * (x - first) > best.pixels() {
                    best = Region { rows: y + 1 - own..y + 1, columns: first..x };
                }
                from = first;
                open.pop();
            }
            open.push((from, height));
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_rectangle_lies_in_the_circle() {
        let off = |y: usize, x: usize| (y as f64 - 49.5).hypot(x as f64 - 59.5);
        let circle = Array2::from_shape_fn((100, 120), |(y, x)| off(y, x) > 45.0);
        let found = largest_without(&circle);
        // The square in a circle has area 2 r^2; rows and columns are integers.
        let square = 2.0 * 45.0f64.powi(2);
        assert!((found.pixels() as f64 / square - 1.0).abs() < 0.03, "{found:?}");
        let inside = circle.slice(ndarray::s![found.rows, found.columns]);
        assert!(inside.iter().all(|blind| !blind));
        let border = Array2::from_shape_fn((40, 50), |(y, x)| y < 3 || x >= 46);
        assert_eq!(largest_without(&border), Region { rows: 3..40, columns: 0..46 });
    }
}
