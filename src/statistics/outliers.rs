//! Outlier frames and samples: a flash, someone in the light, a cosmic ray. They are excluded and reported,
//! and influence no result.

use super::median::{MAD_OF_NORMAL, median};
use ndarray::Array2;
use serde::{Deserialize, Serialize};
use std::borrow::Borrow;
use std::ops::Range;
use std::sync::Arc;

/// Cells along each side of a frame.
const CELLS: usize = 6;
/// Minimum deviation of an outlier frame's mean, over the usual deviation of frame means; half of it for
/// cells. Never reached by chance. Camera effects do not reach it either: they shift many frames, which
/// raises the usual deviation itself.
const FAR: f64 = 12.0;
/// Minimum deviation of a struck sample (cosmic ray, bit error) from the pixel's other frames, in standard
/// deviations of the noise; one in 10^15 by chance.
const STRUCK: f32 = 8.0;
/// Minimum excess of a struck sample's neighbour over its other frames, in standard deviations of the noise:
/// the charge of a ray spreads.
const BESIDE: f32 = 4.0;
/// Minimum deviation of a struck sample, over the noise of the same pixel in the other frames. Five frames
/// determine this noise to a third.
const OF_OWN: f32 = 4.0;
/// Share of the pixels at the largest code above which the noise is estimated from the largest ranges (a
/// named choice): samples at full scale show no noise.
const MANY_AT_TOP: f64 = 0.2;
/// Correction factor of these ranges for clipping (a named choice): a pixel at full scale loses half of its
/// noise on average.
const CUT_RANGES: f32 = 2.0;
/// 95 % quantile of the range of two to eight normal numbers, in standard deviations (Harter 1960).
const FAR_RANGE: [f32; 7] = [2.77, 3.31, 3.63, 3.86, 4.03, 4.17, 4.29];
/// Maximum number of frames compared with each other.
pub const BLOCK: usize = 8;
/// Minimum number of frames for a comparison.
pub const FEWEST: usize = 3;

/// Returns true if a frame's deviation may be decaying carry-over: the frame before deviates by at least half
/// as much.
pub fn dies_away(before_dn: f64, own_dn: f64) -> bool {
    2.0 * before_dn.abs() >= own_dn.abs()
}

/// Computes the mean of a frame as for [`Apart::mean_dn`], DN.
pub fn mean_dn(frame: &Array2<u16>) -> f64 {
    mean_of(&cell_means(frame))
}

fn mean_of(cells: &[f64]) -> f64 {
    cells.iter().sum::<f64>() / cells.len().max(1) as f64
}

/// Deviations of the frames of a block from the block's medians.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Apart {
    /// Deviation of each frame's mean from the median of the block, DN.
    pub mean_dn: Vec<f64>,
    /// Largest deviation of a cell in each frame, DN: cell mean minus frame mean, against its median over the
    /// block.
    pub cell_dn: Vec<f64>,
    /// Median of the frames' means, DN.
    pub level_dn: f64,
}

impl Apart {
    /// Robust standard deviation of the frame means within the block, DN; NaN for an empty block.
    pub fn usual_mean_dn(&self) -> f64 {
        median(self.mean_dn.iter().map(|m| m.abs())) / MAD_OF_NORMAL
    }

    /// Median deviation of the cells within the block, DN; NaN for an empty block.
    fn usual_cell_dn(&self) -> f64 {
        median(self.cell_dn.iter().copied())
    }
}

/// Compares the frames of a block; empty for fewer than three frames.
pub fn apart<F: Borrow<Array2<u16>>>(block: &[F]) -> Apart {
    let Some(first) = block.first().map(F::borrow).filter(|_| block.len() >= FEWEST) else {
        return Apart::default();
    };
    let (rows, columns) = first.dim();
    let cells: Vec<Vec<f64>> = block.iter().map(|f| cell_means(f.borrow())).collect();
    apart_of(&cells, rows >= 2 * CELLS && columns >= 2 * CELLS)
}

/// Compares frames by their [`cell_means`]; `large`: true if the cells have several pixels.
pub fn apart_of(cells: &[Vec<f64>], large: bool) -> Apart {
    if cells.len() < FEWEST {
        return Apart::default();
    }
    let means: Vec<f64> = cells.iter().map(|c| mean_of(c)).collect();
    let level_dn = median(means.iter().copied());
    if !large {
        return Apart {
            mean_dn: means.iter().map(|m| m - level_dn).collect(),
            cell_dn: Vec::new(),
            level_dn,
        };
    }
    let usual: Vec<f64> =
        (0..cells[0].len()).map(|k| median(cells.iter().zip(&means).map(|(c, m)| c[k] - m))).collect();
    let cell =
        |(c, m): (&Vec<f64>, &f64)| c.iter().zip(&usual).map(|(v, u)| (v - m - u).abs()).fold(0.0, f64::max);
    Apart {
        mean_dn: means.iter().map(|m| m - level_dn).collect(),
        cell_dn: cells.iter().zip(&means).map(cell).collect(),
        level_dn,
    }
}

/// Computes the means of the cells of a frame, DN.
pub fn cell_means(frame: &Array2<u16>) -> Vec<f64> {
    let (rows, columns) = frame.dim();
    let mut sums = vec![0u64; CELLS * CELLS];
    let (height, width) = (rows.div_ceil(CELLS).max(1), columns.div_ceil(CELLS).max(1));
    for (y, row) in frame.outer_iter().enumerate() {
        let at = y / height * CELLS;
        let row = row.as_slice().unwrap_or(&[]);
        for (part, sum) in row.chunks(width).zip(&mut sums[at..at + CELLS]) {
            *sum += part.iter().map(|v| u64::from(*v)).sum::<u64>();
        }
    }
    let side = |k: usize, size: usize, n: usize| (n.min((k + 1) * size) - n.min(k * size)) as f64;
    let of = |(k, sum): (usize, &u64)| {
        let pixels = side(k / CELLS, height, rows) * side(k % CELLS, width, columns);
        (pixels > 0.0).then(|| *sum as f64 / pixels)
    };
    let all: Vec<f64> = sums.iter().enumerate().filter_map(of).collect();
    all
}

/// Computes half the variance of the difference of two frames in each cell of [`cell_means`], DN^2, with the
/// means of the cell's rows and columns subtracted.
pub fn cell_variances(a: &Array2<u16>, b: &Array2<u16>) -> Vec<f64> {
    let (rows, columns) = a.dim();
    let (height, width) = (rows.div_ceil(CELLS).max(1), columns.div_ceil(CELLS).max(1));
    let starts = |n: usize, size: usize| (0..n).step_by(size).map(move |from| from..(from + size).min(n));
    let cells = starts(rows, height).flat_map(|ys| starts(columns, width).map(move |xs| (ys.clone(), xs)));
    let variance = |(ys, xs): (Range<usize>, Range<usize>)| {
        let mut of_columns = vec![0i64; xs.len()];
        let (mut sum, mut square, mut of_rows) = (0i64, 0i64, 0.0);
        for y in ys.clone() {
            let mut row = 0i64;
            for (x, column) in xs.clone().zip(&mut of_columns) {
                let d = i64::from(a[(y, x)]) - i64::from(b[(y, x)]);
                row += d;
                *column += d;
                square += d * d;
            }
            sum += row;
            of_rows += (row as f64).powi(2);
        }
        let (rows, columns) = (ys.len() as f64, xs.len() as f64);
        let of_columns: f64 = of_columns.iter().map(|c| (*c as f64).powi(2)).sum();
        let shared = of_rows / columns + of_columns / rows - (sum as f64).powi(2) / (rows * columns);
        0.5 * (square as f64 - shared) / ((rows - 1.0) * (columns - 1.0))
    };
    cells.filter(|(ys, xs)| ys.len() > 1 && xs.len() > 1).map(variance).collect()
}

/// Usual scatter of the frames of a campaign.
#[derive(Debug, Clone, Copy)]
pub struct Usual {
    /// Relative scatter of the means of flats.
    flat_rel: f64,
    /// Scatter of the means of darks, DN.
    dark_dn: f64,
    /// Deviation of cells: in flats, over the root of the level; in darks, DN.
    flat_cell: f64,
    dark_cell_dn: f64,
}

impl Usual {
    /// Estimates the scatter from blocks of frames, each with a flag for darks; `zero_dn`: level of the
    /// darks.
    pub fn of(blocks: &[(bool, Apart)], zero_dn: f64) -> Self {
        let over = |dark: bool, of: &dyn Fn(&Apart, f64) -> Vec<f64>| {
            let all = blocks.iter().filter(|b| b.0 == dark).flat_map(|b| {
                let above = (b.1.level_dn - zero_dn).max(1.0);
                of(&b.1, above)
            });
            let middle = median(all);
            if middle.is_finite() { middle } else { f64::INFINITY }
        };
        // The first two frames of a set may contain memory of earlier frames.
        let means = |a: &Apart| a.mean_dn.iter().skip(2).map(|m| m.abs()).collect::<Vec<_>>();
        let cells = |a: &Apart| a.cell_dn.iter().skip(2).copied().collect::<Vec<_>>();
        let scaled = |all: Vec<f64>, by: f64| all.into_iter().map(|v| v / by).collect::<Vec<_>>();
        Self {
            flat_rel: over(false, &|a, above| scaled(means(a), above)) / MAD_OF_NORMAL,
            dark_dn: over(true, &|a, _| means(a)) / MAD_OF_NORMAL,
            flat_cell: over(false, &|a, above| scaled(cells(a), above.sqrt())),
            dark_cell_dn: over(true, &|a, _| cells(a)),
        }
    }

    /// All values, for comparison with another instance.
    pub fn numbers(&self) -> [f64; 4] {
        [self.flat_rel, self.dark_dn, self.flat_cell, self.dark_cell_dn]
    }

    /// Computes the minimum deviation of a cell for a frame to be an outlier of its set, DN; `above`: level
    /// of the frame above the darks, DN.
    pub fn far_cell_dn(&self, of_set: &Apart, dark: bool, above: f64) -> f64 {
        let of_dark = if self.dark_cell_dn.is_finite() { self.dark_cell_dn } else { 0.0 };
        let cell = if dark { self.dark_cell_dn } else { (self.flat_cell * above.sqrt()).hypot(of_dark) };
        0.5 * FAR * cell.max(of_set.usual_cell_dn()).max(0.05)
    }

    /// Returns the places of outlier frames in a block; `of_set`: frames of its set; `start`: place of the
    /// first frame of the block in the set.
    pub fn outliers(&self, a: &Apart, of_set: &Apart, dark: bool, start: usize, zero_dn: f64) -> Vec<usize> {
        let above = (a.level_dn - zero_dn).max(1.0);
        let (mean, cell) = if dark {
            (self.dark_dn, self.dark_cell_dn)
        } else {
            // Dim flats have the scatter of darks as well.
            let dark = |v: f64| if v.is_finite() { v } else { 0.0 };
            (
                (self.flat_rel * above).hypot(dark(self.dark_dn)),
                (self.flat_cell * above.sqrt()).hypot(dark(self.dark_cell_dn)),
            )
        };
        // Scatter common to all frames of this set (light bands, flicker) is not a flash. Other exposures may
        // average it out.
        let mean = mean.max(a.usual_mean_dn()).max(of_set.usual_mean_dn());
        let cell = cell.max(a.usual_cell_dn()).max(of_set.usual_cell_dn());
        // Rounding to whole codes alone moves a mean by a few hundredths.
        let (mean, cell) = (mean.max(0.02), cell.max(0.05));
        let far = |i: &usize| {
            let by_cell = a.cell_dn.get(*i).is_some_and(|c| *c > 0.5 * FAR * cell);
            a.mean_dn[*i].abs() > FAR * mean || by_cell
        };
        // The first frame of a set may contain memory of earlier frames.
        (0..a.mean_dn.len()).skip(usize::from(start == 0)).filter(far).collect()
    }
}

/// Sample that deviates far from the same pixel in the other frames of a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Struck {
    /// Place of its frame in the block.
    pub frame: usize,
    /// Place of its pixel.
    pub pixel: usize,
    /// Usual code of the pixel.
    pub usual_dn: u16,
    /// True for the centre; false for a neighbour that has part of the charge.
    pub centre: bool,
}

/// Finds samples far above or below the same pixel in the block's other frames: cosmic rays, and bit errors
/// of a link. Of two frames the one that also differs from its neighbours is chosen.
pub fn struck<F: Borrow<Array2<u16>>>(block: &[F]) -> Vec<Struck> {
    let n = block.len();
    let frames: Vec<&[u16]> = block.iter().filter_map(|f| f.borrow().as_slice()).collect();
    let Some(pixels) = frames.first().map(|f| f.len()).filter(|p| n >= 2 && frames.len() == n && *p > 0)
    else {
        return Vec::new();
    };
    let columns = block[0].borrow().ncols();
    let (mut least, mut most, mut sum) = (vec![u16::MAX; pixels], vec![0u16; pixels], vec![0u32; pixels]);
    for frame in &frames {
        for (((l, m), s), v) in least.iter_mut().zip(&mut most).zip(&mut sum).zip(*frame) {
            *l = (*l).min(*v);
            *m = (*m).max(*v);
            *s += u32::from(*v);
        }
    }
    let others = |i: usize, extreme: u16| (sum[i] - u32::from(extreme)) as f32 / (n - 1) as f32;
    // The largest of n normal numbers lies about 1.3 to 1.5 deviations above the mean of the others, for n =
    // 3 to 8; the median over the pixels hardly scatters. For n = 2 it lies 0.95 above the other.
    let sample = || (0..pixels).step_by((pixels / 4096).max(1));
    let usual = median(sample().map(|i| f64::from(f32::from(most[i]) - others(i, most[i])))) as f32;
    let level = median(sample().map(|i| f64::from(others(i, most[i])))) as f32;
    let usual = usual / if n < 3 { 0.95 } else { 1.4 };
    // Samples at the largest code, usually full scale, show no noise; pixels that reach it show only part of
    // their noise.
    let top = most.iter().copied().max().unwrap_or(0);
    let at_top = sample().filter(|i| most[*i] == top).count() as f64;
    let usual = if at_top > MANY_AT_TOP * sample().count() as f64 {
        let mut ranges: Vec<u16> = sample().map(|i| most[i] - least[i]).filter(|range| *range > 0).collect();
        ranges.sort_unstable();
        let far = ranges.get(19 * ranges.len() / 20).map_or(0.0, |range| f32::from(*range));
        usual.max(CUT_RANGES * far / FAR_RANGE[n.clamp(2, 8) - 2])
    } else {
        usual
    };
    // Frames of narrow noise on coarse codes differ by whole steps, three frames by several.
    let ranges = (0..pixels).map(|i| most[i] - least[i]);
    let step_dn = f32::from(ranges.filter(|range| *range > 0).min().unwrap_or(1));
    let floor = step_dn * if n < 4 { 2.0 } else { 0.5 };
    let noise = usual.max(floor);
    // Hot pixels have more shot noise: the square root of their charge, which lies below their level in DN.
    let limit = |level_dn: f32| {
        let more = (level_dn - level).max(0.0);
        noise * (1.0 + more / (noise * noise)).sqrt()
    };
    let far = |i: usize| {
        // The range bounds the deviation of either extreme from the mean of the others.
        if f32::from(most[i] - least[i]) <= STRUCK * noise {
            return false;
        }
        let (above, below) = (others(i, most[i]), others(i, least[i]));
        f32::from(most[i]) - above > STRUCK * limit(above)
            || below - f32::from(least[i]) > STRUCK * limit(below)
    };
    let mut out: Vec<Struck> = Vec::new();
    for i in (0..pixels).filter(|&i| far(i)) {
        let usual_dn = usual_of(&frames, i, columns);
        let off = |f: usize| (f32::from(frames[f][i]) - f32::from(usual_dn)).abs();
        let of_frames = (0..n).filter(|&f| off(f) > STRUCK * limit(f32::from(usual_dn)));
        // Deviations in half of the frames are not random hits.
        let hit: Vec<usize> = of_frames.collect();
        if 2 * hit.len() >= n && n > 2 {
            continue;
        }
        // A noisy pixel has similar deviations in its other frames.
        let own = own_noise((0..n).filter(|f| !hit.contains(f)).map(|f| f32::from(frames[f][i])));
        for frame in hit.into_iter().filter(|&f| off(f) > OF_OWN * own) {
            out.push(Struck { frame, pixel: i, usual_dn, centre: true });
            beside(&frames, frame, i, columns, &limit, &mut out);
        }
    }
    out
}

/// Estimates the standard deviation of some values by their range (Tippett 1925); 0 for fewer than five,
/// which hardly determine it.
fn own_noise(values: impl Iterator<Item = f32>) -> f32 {
    /// Mean range of 5 to 8 normal numbers, in standard deviations.
    const RANGE: [f32; 4] = [2.326, 2.534, 2.704, 2.847];
    const FEWEST: usize = 5;
    let (mut n, mut least, mut most) = (0usize, f32::INFINITY, 0f32);
    for v in values {
        (n, least, most) = (n + 1, least.min(v), most.max(v));
    }
    if n < FEWEST { 0.0 } else { (most - least) / RANGE[(n - FEWEST).min(RANGE.len() - 1)] }
}

/// Finds neighbours that collected part of a ray's charge.
fn beside(
    frames: &[&[u16]],
    frame: usize,
    pixel: usize,
    columns: usize,
    limit: &dyn Fn(f32) -> f32,
    out: &mut Vec<Struck>,
) {
    let (n, rows) = (frames.len(), frames[frame].len() / columns);
    let (y, x) = (pixel / columns, pixel % columns);
    for yy in y.saturating_sub(1)..=(y + 1).min(rows - 1) {
        for xx in x.saturating_sub(1)..=(x + 1).min(columns - 1) {
            let at = yy * columns + xx;
            // The median, not the mean: another frame may be struck there too.
            let mut rest: Vec<u16> = (0..n).filter(|g| *g != frame).map(|g| frames[g][at]).collect();
            rest.sort_unstable();
            let usual_dn = rest[(rest.len() - 1) / 2];
            let usual = f32::from(usual_dn);
            if at != pixel && f32::from(frames[frame][at]) - usual > BESIDE * limit(usual) {
                out.push(Struck { frame, pixel: at, usual_dn, centre: false });
            }
        }
    }
}

/// Returns the usual code of a pixel: the median over the frames; for two frames, the code nearer to the
/// median of the neighbours.
fn usual_of(frames: &[&[u16]], pixel: usize, columns: usize) -> u16 {
    let mut own: Vec<u16> = frames.iter().map(|f| f[pixel]).collect();
    own.sort_unstable();
    if let [a, b] = own[..] {
        let (rows, y, x) = (frames[0].len() / columns, pixel / columns, pixel % columns);
        let mut near: Vec<u16> = Vec::new();
        for yy in y.saturating_sub(1)..=(y + 1).min(rows - 1) {
            for xx in x.saturating_sub(1)..=(x + 1).min(columns - 1) {
                if (yy, xx) != (y, x) {
                    near.extend(frames.iter().map(|f| f[yy * columns + xx]));
                }
            }
        }
        near.sort_unstable();
        let middle = near.get(near.len() / 2).copied().unwrap_or(a);
        return if a.abs_diff(middle) <= b.abs_diff(middle) { a } else { b };
    }
    own[(own.len() - 1) / 2]
}

/// Replaces the samples of [`struck`] by the usual code of their pixels; returns (frame, pixel) of the
/// centres.
pub fn take_struck(block: &mut [Array2<u16>]) -> Vec<(usize, usize)> {
    let found = struck(block);
    for s in &found {
        if let Some(v) = block[s.frame].as_slice_mut().and_then(|b| b.get_mut(s.pixel)) {
            *v = s.usual_dn;
        }
    }
    found.iter().filter(|s| s.centre).map(|s| (s.frame, s.pixel)).collect()
}

/// Computes the block size that divides `frames` into blocks of nearly equal size: a last block of one frame
/// would have no frames for comparison.
pub fn block_size(frames: usize) -> usize {
    frames.div_ceil(frames.div_ceil(BLOCK).max(1)).max(1)
}

/// Divides the rows of a set into blocks of [`block_size`].
pub fn blocks<T>(rows: &[T]) -> impl Iterator<Item = &[T]> {
    rows.chunks(block_size(rows.len()))
}

/// Formats the message about `n` struck samples, shared by all commands.
pub fn in_words(n: u64) -> String {
    let (samples, stand) = if n == 1 { ("sample", "stands") } else { ("samples", "stand") };
    format!("{n} single {samples} {stand} far off the same pixel in other frames (cosmic rays, bit errors)")
}

/// Returns a block with its struck samples replaced, if these are few enough to be random, and their pixels.
pub fn without_struck(block: &[Arc<Array2<u16>>]) -> (Vec<Arc<Array2<u16>>>, Vec<usize>) {
    let found = struck(block);
    let pixels: Vec<usize> = found.iter().filter(|s| s.centre).map(|s| s.pixel).collect();
    let mut out = block.to_vec();
    if found.is_empty() {
        return (out, Vec::new());
    }
    let samples = block.iter().map(|f| f.len()).sum::<usize>() as f64;
    if !are_rays(&pixels, samples, block[0].len() as f64) {
        return (out, Vec::new());
    }
    for s in found {
        if let Some(v) = Arc::make_mut(&mut out[s.frame]).as_slice_mut() {
            v[s.pixel] = s.usual_dn;
        }
    }
    (out, pixels)
}

/// Returns true if struck samples are at random pixels, like cosmic rays, and do not recur in the same
/// pixels, like blinking pixels. Of `n` samples in `pixels` pixels some hit a pixel again by chance.
pub fn are_rays(hit: &[usize], samples: f64, pixels: f64) -> bool {
    let mut sorted = hit.to_vec();
    sorted.sort_unstable();
    let again = sorted.windows(2).filter(|w| w[0] == w[1]).count() as f64;
    let n = hit.len() as f64;
    let by_chance = n - pixels * (1.0 - (-n / pixels.max(1.0)).exp());
    again <= 0.1 * n + by_chance + 3.0 * by_chance.sqrt() && n < 2e-3 * samples
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    fn block(seed: u64) -> Vec<Array2<u16>> {
        let at = |f: u64, i: usize| PixelRng::new(seed, Stream::Frame, f, i as u32, 0).normal();
        let frame = |f: u64| {
            Array2::from_shape_fn((64, 64), |(y, x)| {
                (1000.0 + x as f64 + 9.0 * at(f, y * 64 + x)).round() as u16
            })
        };
        (0..8).map(frame).collect()
    }

    /// With more than half of the samples at full scale, the noise of the others is not taken for rays.
    #[test]
    fn noise_beside_full_scale_is_no_ray() {
        for full in [1000.0, 1020.0, 1030.0, 1045.0, 1065.0] {
            for seed in 0..10 {
                let mut cut = block(seed);
                cut.iter_mut().for_each(|frame| frame.mapv_inplace(|v| v.min(full as u16)));
                assert!(take_struck(&mut cut).is_empty(), "seed {seed}, full scale {full}");
            }
        }
    }

    #[test]
    fn a_ray_is_taken_and_noise_is_not() {
        for seed in 0..20 {
            assert!(take_struck(&mut block(seed)).is_empty(), "seed {seed}");
        }
        let mut hit = block(1);
        hit[3][(10, 20)] += 400;
        hit[3][(10, 21)] += 60;
        // A bit error of a link, and two in one pixel.
        (hit[5][(30, 30)], hit[1][(40, 7)], hit[6][(40, 7)]) = (0, 65535, 65535);
        let before = block(1);
        let found = take_struck(&mut hit);
        assert_eq!(found, [(3, 10 * 64 + 20), (5, 30 * 64 + 30), (1, 40 * 64 + 7), (6, 40 * 64 + 7)]);
        assert!(hit[5][(30, 30)].abs_diff(1030) < 40 && hit[1][(40, 7)].abs_diff(1007) < 40);
        // In a pair, the frame that differs from its neighbours.
        for seed in 0..20 {
            assert!(take_struck(&mut block(seed)[..2]).is_empty(), "seed {seed}");
        }
        let mut pair = block(2);
        pair[1][(12, 12)] = 0;
        assert_eq!(take_struck(&mut pair[..2]), [(1, 12 * 64 + 12)]);
        assert!(hit[3][(10, 20)].abs_diff(1020) < 30 && hit[3][(10, 21)] < before[3][(10, 21)] + 30);
    }

    #[test]
    fn a_flash_and_a_shadow_are_outliers() {
        let blocks: Vec<(bool, Apart)> = (0..8).map(|s| (false, apart(&block(s)))).collect();
        let usual = Usual::of(&blocks, 100.0);
        assert!(blocks.iter().all(|(_, a)| usual.outliers(a, &Apart::default(), false, 8, 100.0).is_empty()));
        let mut flash = block(30);
        flash[5].mapv_inplace(|v| v + 12);
        assert_eq!(usual.outliers(&apart(&flash), &Apart::default(), false, 8, 100.0), [5]);
        let mut shadow = block(31);
        shadow[6].slice_mut(ndarray::s![..12, 40..]).mapv_inplace(|v| v - 20);
        assert_eq!(usual.outliers(&apart(&shadow), &Apart::default(), false, 8, 100.0), [6]);
        // Also in the second frame of a set, and never in the first.
        let mut second = block(32);
        second[1].mapv_inplace(|v| v + 12);
        assert_eq!(usual.outliers(&apart(&second), &Apart::default(), false, 0, 100.0), [1]);
        let mut first = block(33);
        first[0].mapv_inplace(|v| v + 12);
        assert!(usual.outliers(&apart(&first), &Apart::default(), false, 0, 100.0).is_empty());
    }

    /// Light bands of one set among sets without: three of its frames happen to be alike, and the fourth is
    /// no flash.
    #[test]
    fn bands_of_one_exposure_are_no_outliers() {
        let blocks: Vec<(bool, Apart)> = (0..8).map(|s| (false, apart(&block(s)))).collect();
        let usual = Usual::of(&blocks, 100.0);
        let mut banded = block(40);
        for (frame, phase) in banded.iter_mut().zip([1.0, 1.2, 0.9, 4.0, 2.6, 5.5, 3.3, 0.2]) {
            for (y, mut row) in frame.outer_iter_mut().enumerate() {
                let band = 60.0 * (0.07 * y as f64 + phase).sin();
                row.mapv_inplace(|v| (f64::from(v) + band).round() as u16);
            }
        }
        let (of_set, of_half) = (apart(&banded), apart(&banded[..4]));
        assert!(usual.outliers(&of_half, &of_set, false, 8, 100.0).is_empty());
        assert!(usual.outliers(&of_set, &of_set, false, 8, 100.0).is_empty());
    }
}
