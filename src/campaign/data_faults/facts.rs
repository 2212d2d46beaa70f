//! Frame statistics for the checks: levels, noise of successive frames, digests, fixed pattern.

use super::ExamineError;
use super::hot_charge::{HotCharge, HotPixels};
use super::lost_parts::Zeros;
use super::old_data::{OldData, Search};
use super::{overlay, patterns};
use crate::dataset::{Dataset, Kind, Set};
use crate::statistics::code_step::Occurring;
use crate::statistics::median::median;
use crate::statistics::outliers;
use ndarray::{Array2, ArrayView2, s};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Side of the central region whose pattern identifies matching frames, pixels: 16384 pixels reveal a
/// pattern of a twentieth of the noise (a named choice).
pub const MIDDLE: usize = 128;

/// Statistics of the frames of a set.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SetFacts {
    /// Number of pixels per frame.
    pub pixels: f64,
    /// Mean of each frame, DN.
    pub means_dn: Vec<f64>,
    /// Means of the cells of each frame, DN.
    pub cells_dn: Vec<Vec<f64>>,
    /// Digest of the codes: equal frames have equal digests.
    pub digests: Vec<u64>,
    /// Number of pixels that differ from the previous frame; 0 for the first.
    pub changed: Vec<u64>,
    /// Half the variance over the pixels of the difference to the previous frame, DN^2, with row and
    /// column means removed; 0 for the first.
    pub successive_dn2: Vec<f64>,
    /// Half that variance for the difference to the frame before the previous one, DN^2; 0 for the first
    /// two.
    pub second_dn2: Vec<f64>,
    /// Half that variance for the difference of the last frame to the third, DN^2; the first two may
    /// contain carry-over. 0 for fewer than six frames, and in files of earlier versions.
    #[serde(default)]
    pub ends_dn2: f64,
    /// Sum of the noise covariances of a pixel with its neighbours, relative to its variance.
    #[serde(default)]
    pub neighbours: Neighbours,
    /// Fraction of the samples at full scale.
    pub clipped: f64,
    /// Temporal variance in the cells of [`cells_dn`](Self::cells_dn), DN^2; empty for a single frame,
    /// and in files of earlier versions.
    #[serde(default)]
    pub cells_dn2: Vec<f64>,
    /// Fraction of even samples; 0 in files of earlier versions.
    #[serde(default)]
    pub even_share: f64,
    /// Variance over the pixels of the first frame, DN^2.
    pub spread_dn2: f64,
    /// Code step of the first frame, DN: 1 unless the camera counts in coarser steps.
    pub step_dn: f64,
    /// Step of the converter, DN, from all codes of the set: 1 if neighbouring codes occur, 0 if too few
    /// codes do.
    #[serde(default)]
    pub code_step_dn: f64,
    /// Step of the converter, DN, from the first frame alone; 0 in files of earlier versions.
    #[serde(default)]
    pub frame_step_dn: f64,
    /// Pixels of outlier samples, far from the same pixel in other frames. They are excluded from all
    /// these statistics but the digests, the changed pixels, and the fraction at full scale.
    #[serde(default)]
    pub struck_pixels: Vec<u32>,
    /// Pixels that jump from one frame to the next, as in a time stamp; empty in files of earlier
    /// versions.
    #[serde(default)]
    pub jumping: Vec<u32>,
    /// Pixels of the first frame of a dark that are as bright as text; none in files of earlier versions.
    #[serde(default)]
    pub bright: Vec<u32>,
    /// Parts of frames with data of an earlier frame.
    #[serde(default)]
    pub old_data: Vec<OldData>,
    /// Samples of each frame that are exactly 0; empty in files of earlier versions.
    #[serde(default)]
    pub zeros: Vec<Zeros>,
    /// Mean over the frames of the central region, DN, row by row: at most [`MIDDLE`] x [`MIDDLE`]
    /// pixels.
    pub middle_dn: Vec<f32>,
    /// Number of columns of the central region.
    pub middle_columns: usize,
    /// Noise variance of that mean, DN^2, without hot pixels, from frames added with alternating sign; 0
    /// for a single frame, and in files of earlier versions.
    #[serde(default)]
    pub middle_noise_dn2: f64,
    /// Gain from the hot pixels of a dark; `None` for flats, without usable hot pixels, and in files of
    /// earlier versions.
    #[serde(default)]
    pub hot_charge: Option<HotCharge>,
}

/// Covariances of neighbours relative to the variance, averaged over pairs of frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Neighbours {
    /// Sum over all neighbours.
    pub share: f64,
    /// Sum over the four nearest neighbours; 0 in files of earlier versions.
    #[serde(default)]
    pub of_next: f64,
    /// Number of pixels of all pairs; 0 for a single or small frame, and in files of earlier versions.
    pub pixels: f64,
}

impl Neighbours {
    /// Adds the next pair, until the pixels suffice.
    fn add(&mut self, a: &Array2<u16>, b: &Array2<u16>) {
        let own = a.len().min(ENOUGH) as f64;
        if self.pixels + 0.5 * own > ENOUGH as f64 {
            return;
        }
        if let Some((share, of_next)) = shared_by_neighbours(a, b) {
            self.pixels += own;
            self.share += own / self.pixels * (share - self.share);
            self.of_next += own / self.pixels * (of_next - self.of_next);
        }
    }
}

impl SetFacts {
    /// Returns true if the statistics are consistent with this number of frames of (rows, columns).
    pub fn fits(&self, frames: usize, shape: (usize, usize)) -> bool {
        let n = self.means_dn.len();
        let counts =
            [self.digests.len(), self.changed.len(), self.successive_dn2.len(), self.second_dn2.len()];
        let cells = self.cells_dn.first().map_or(0, Vec::len);
        let (rows, columns) = (middle_side(shape.0).1, middle_side(shape.1).1);
        // Files of earlier versions have a smaller central region.
        let middle = self.middle_columns <= columns
            && self.middle_dn.len() <= rows * columns
            && self.middle_dn.len().is_multiple_of(self.middle_columns.max(1));
        (n == 0 || n == frames && middle)
            && counts.iter().all(|c| *c == n)
            && self.cells_dn.len() == n
            && (self.zeros.is_empty() || self.zeros.len() == n)
            && self.cells_dn.iter().all(|c| c.len() == cells)
            && self.jumping.iter().chain(&self.bright).all(|pixel| (*pixel as usize) < shape.0 * shape.1)
    }
}

/// Accumulated central regions.
#[derive(Default)]
struct Middle {
    frames: usize,
    sum: Array2<f32>,
    /// Sum with alternating sign.
    in_turns: Array2<f32>,
}

impl Middle {
    fn add(&mut self, part: &Array2<f32>) {
        if self.sum.dim() != part.dim() {
            (self.sum, self.in_turns) = (Array2::zeros(part.dim()), Array2::zeros(part.dim()));
        }
        self.frames += 1;
        self.sum += part;
        match self.frames % 2 {
            1 => self.in_turns += part,
            _ => self.in_turns -= part,
        }
    }
}

/// Returns first pixel and size of the central region for a side of n pixels; symmetrical about the
/// centre.
fn middle_side(n: usize) -> (usize, usize) {
    let size = n.min(MIDDLE) - (n.min(MIDDLE) + n) % 2;
    ((n - size) / 2, size)
}

/// Computes the statistics of a set, reading its frames in sequence.
pub(super) fn of_set(dataset: &Dataset, set: &Set, stop: &AtomicBool) -> Result<SetFacts, ExamineError> {
    let full = dataset.manifest().camera.full_scale_dn();
    let mut out = SetFacts::default();
    let mut old_data = Search::default();
    let mut before: Option<Arc<Array2<u16>>> = None;
    let mut sent_before: Option<Arc<Array2<u16>>> = None;
    let mut second: Option<Arc<Array2<u16>>> = None;
    let mut third: Option<Arc<Array2<u16>>> = None;
    // Sums over all frames, and over frames without lost parts.
    let (mut middle_of_all, mut middle_of_whole) = (Middle::default(), Middle::default());
    let (mut clipped, mut odd) = (0usize, 0u64);
    let mut occurring = Occurring::default();
    let mut cells = CellVariances::default();
    let kind = dataset.settings(set).kind;
    let mut hot = (kind == Kind::Dark).then(HotPixels::default);
    for frames in in_blocks(dataset, set, stop) {
        let (frames, struck) = frames?;
        out.struck_pixels.extend(struck.into_iter().map(|pixel| pixel as u32));
        for [sent, frame] in frames {
            out.pixels = frame.len() as f64;
            occurring.add(sent.as_slice().unwrap_or(&[]));
            if out.means_dn.is_empty() {
                out.frame_step_dn = step_of(&occurring);
            }
            let codes = frame.as_slice().unwrap_or(&[]);
            if out.means_dn.is_empty() {
                out.spread_dn2 = spread(codes);
                out.step_dn = step(codes, full);
            }
            if let Some(hot) = &mut hot {
                hot.add(codes, full);
            }
            out.means_dn.push(codes.iter().map(|v| u64::from(*v)).sum::<u64>() as f64 / out.pixels.max(1.0));
            out.cells_dn.push(outliers::cell_means(&frame));
            let shared = Arc::clone(&sent);
            let sent = sent.as_slice().unwrap_or(&[]);
            out.digests.push(digest(sent));
            out.zeros.push(Zeros::of(sent));
            odd += sent.iter().map(|v| u64::from(v & 1)).sum::<u64>();
            clipped += sent.iter().filter(|v| **v >= full).count();
            if let Some(before) = sent_before.as_ref().and_then(|b| b.as_slice()) {
                out.jumping.extend(overlay::jumping(before, sent, full, kind));
            }
            if out.digests.len() == 1 && kind == Kind::Dark {
                out.bright = overlay::bright(sent, full);
            }
            old_data.add(sent, sent_before.as_ref().and_then(|b| b.as_slice()), full);
            sent_before = Some(shared);
            // The first frame may contain carry-over from the previous set.
            let pairs = out.digests.len() % 2 == 0 && (out.digests.len() > 2 || set.rows.len() < 4);
            if let Some(before) = before.as_ref().filter(|_| pairs) {
                out.neighbours.add(before, &frame);
                cells.add(before, &frame);
            }
            let to = |other: &Option<Arc<Array2<u16>>>| {
                other
                    .as_ref()
                    .map_or((0, 0.0), |o| difference(codes, o.as_slice().unwrap_or(&[]), frame.ncols()))
            };
            let (changed, successive) = to(&before);
            out.changed.push(changed);
            out.successive_dn2.push(successive);
            out.second_dn2.push(to(&second).1);
            middle_of_all.add(&middle_of(&frame));
            if out.zeros.last().is_some_and(|zeros| zeros.are_single()) {
                middle_of_whole.add(&middle_of(&frame));
            }
            if out.means_dn.len() == 3 {
                third = Some(Arc::clone(&frame));
            }
            second = before.replace(frame);
        }
    }
    if let (Some(third), Some(last), 6..) = (&third, &before, out.means_dn.len()) {
        let codes = [third, last].map(|f| f.as_slice().unwrap_or(&[]));
        out.ends_dn2 = difference(codes[0], codes[1], last.ncols()).1;
    }
    let successive = out.successive_dn2.iter().skip(1);
    out.hot_charge = hot.and_then(|hot| hot.finish(median(successive.copied())));
    out.cells_dn2 = cells.finish();
    out.jumping.sort_unstable();
    out.jumping.dedup();
    out.old_data = old_data.finish();
    out.code_step_dn = step_of(&occurring);
    let samples = (out.pixels * set.rows.len() as f64).max(1.0);
    out.even_share = 1.0 - odd as f64 / samples;
    out.clipped = clipped as f64 / samples;
    let middle = if middle_of_whole.frames > 0 { middle_of_whole } else { middle_of_all };
    out.middle_columns = middle.sum.ncols();
    out.middle_dn = middle.sum.iter().map(|v| v / middle.frames.max(1) as f32).collect();
    let in_turns: Vec<f32> = middle.in_turns.into_iter().collect();
    out.middle_noise_dn2 = patterns::noise_of(&out.middle_dn, &in_turns, middle.frames, out.middle_columns);
    Ok(out)
}

/// Variances in the cells of frames, from pairs of frames.
#[derive(Default)]
struct CellVariances {
    pairs: usize,
    sums_dn2: Vec<f64>,
}

impl CellVariances {
    /// Adds the next pair, until the pixels suffice.
    fn add(&mut self, a: &Array2<u16>, b: &Array2<u16>) {
        if self.pairs * a.len() >= ENOUGH {
            return;
        }
        let own = outliers::cell_variances(a, b);
        self.pairs += 1;
        self.sums_dn2.resize(own.len(), 0.0);
        self.sums_dn2.iter_mut().zip(own).for_each(|(sum, v)| *sum += v);
    }

    fn finish(self) -> Vec<f64> {
        self.sums_dn2.into_iter().map(|sum| sum / self.pairs.max(1) as f64).collect()
    }
}

/// Returns the code step: 1 if neighbouring codes occur, 0 if too few codes do.
fn step_of(occurring: &Occurring) -> f64 {
    let stretch = occurring.stretch().map(|s| s.step);
    stretch.unwrap_or(if occurring.has_neighbours() { 1.0 } else { 0.0 })
}

/// Shared frame.
type Shared = Arc<Array2<u16>>;

/// Reads the frames of a set in blocks: each frame as recorded and without outlier samples, and the
/// number of these.
fn in_blocks<'d>(
    dataset: &'d Dataset,
    set: &'d Set,
    stop: &'d AtomicBool,
) -> impl Iterator<Item = Result<(Vec<[Shared; 2]>, Vec<usize>), ExamineError>> + 'd {
    outliers::blocks(&set.rows).map(move |rows| {
        let read = |row: &usize| {
            if stop.load(Ordering::Relaxed) {
                return Err(ExamineError::Interrupted);
            }
            Ok(dataset.frame(&dataset.rows()[*row])?)
        };
        let sent = rows.iter().map(read).collect::<Result<Vec<_>, _>>()?;
        let (whole, struck) = outliers::without_struck(&sent);
        Ok((sent.into_iter().zip(whole).map(<[_; 2]>::from).collect(), struck))
    })
}

/// Returns the converter step on which the sets agree, DN; 1 if a set counts in steps of 1 or none
/// determines it.
pub(super) fn code_step(facts: &[SetFacts]) -> f64 {
    /// Maximum relative difference of the step between sets, which cover different ranges.
    const SAME_STEP: f64 = 0.02;
    let told = facts.iter().map(|f| f.code_step_dn).filter(|step| *step > 0.0);
    let (least, most) = told.fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
    if most > 0.0 && most - least <= SAME_STEP * least { most } else { 1.0 }
}

/// Returns the central region of a frame; that of a mirrored frame is mirrored.
fn middle_of(frame: &Array2<u16>) -> Array2<f32> {
    let (rows, columns) = frame.dim();
    let ((top, height), (left, width)) = (middle_side(rows), middle_side(columns));
    frame.slice(s![top..top + height, left..left + width]).mapv(f32::from)
}

/// Returns the variance over the pixels.
fn spread(codes: &[u16]) -> f64 {
    let (mut sum, mut square) = (0u64, 0u64);
    for &code in codes {
        sum += u64::from(code);
        square += u64::from(code) * u64::from(code);
    }
    let n = (codes.len() as f64).max(1.0);
    (square as f64 / n - (sum as f64 / n).powi(2)).max(0.0)
}

/// Returns the range of the middle 80 % of the samples divided by the number of codes that occur in it.
fn step(codes: &[u16], full: u16) -> f64 {
    let mut counts = vec![0usize; usize::from(full) + 1];
    codes.iter().for_each(|c| counts[usize::from(*c).min(usize::from(full))] += 1);
    let tenth = codes.len() / 10;
    let mut below = 0;
    let inside: Vec<usize> = counts
        .iter()
        .enumerate()
        .filter(|(_, n)| {
            below += **n;
            **n > 0 && below > tenth && below <= codes.len() - tenth
        })
        .map(|(code, _)| code)
        .collect();
    match inside.as_slice() {
        [first, .., last] => (last - first) as f64 / (inside.len() - 1) as f64,
        _ => 1.0,
    }
}

/// Minimum number of rows, and of columns, whose means are removed from a difference (a named choice).
const FEW: f64 = 8.0;

/// Returns the number of differing pixels, and half the variance of the difference, DN^2, with row and
/// column means removed: light bands and line noise affect those.
fn difference(a: &[u16], b: &[u16], columns: usize) -> (u64, f64) {
    let columns = columns.max(1);
    let (mut changed, mut total, mut square, mut of_rows) = (0u64, 0i64, 0u64, 0.0);
    let mut of_columns = vec![0i64; columns];
    for (a, b) in a.chunks_exact(columns).zip(b.chunks_exact(columns)) {
        let mut sum = 0i64;
        for ((&a, &b), column) in a.iter().zip(b).zip(&mut of_columns) {
            let d = i64::from(a) - i64::from(b);
            changed += u64::from(d != 0);
            sum += d;
            *column += d;
            square += (d * d) as u64;
        }
        total += sum;
        of_rows += (sum as f64).powi(2);
    }
    let (n, rows) = ((a.len() as f64).max(1.0), a.len() as f64 / columns as f64);
    let of_columns = of_columns.iter().map(|v| (*v as f64).powi(2)).sum::<f64>();
    let of_frame = (total as f64).powi(2) / n;
    // In a few lines of few pixels little remains besides the means.
    let (shared, dof) = if rows >= FEW && columns as f64 >= FEW {
        (of_rows / columns as f64 + of_columns / rows - of_frame, (rows - 1.0) * (columns as f64 - 1.0))
    } else {
        (of_frame, n)
    };
    (changed, 0.5 * (square as f64 - shared).max(0.0) / dof)
}

/// Maximum distance of neighbours, along both axes, pixels: a kernel of five by five.
const NEAR: isize = 2;
/// Distances beyond filters and crosstalk; the remaining covariance is that of row and column noise, and
/// of fields that move as a whole (a named choice).
const FAR: std::ops::RangeInclusive<isize> = 6..=13;
/// Side of the central region used for neighbours, and number of pixels that suffices: 2 % of the
/// variance in a set.
const SIDE: usize = 512;
pub(super) const ENOUGH: usize = SIDE * SIDE;
/// Variance of that sum for white noise, times the number of pixels: a correlation has 1 / n (Box and
/// Jenkins 1976, 2.1.6), and counted twice are two along each axis, less twice the mean of eight, and
/// eight others, less eight times the mean of 16.
pub(super) const NEIGHBOURS_VAR: f64 = 4.0 * (2.0 * (2.0 + 4.0 / 8.0) + 8.0 + 64.0 / 16.0);

/// Variance of the sum over the nearest neighbours, times the number of pixels: counted twice is one
/// along each axis, less the mean of eight.
pub(super) const NEXT_VAR: f64 = 4.0 * 2.0 * (1.0 + 1.0 / 8.0);

/// Returns the sum of the covariances of a frame difference with itself up to [`NEAR`] pixels away,
/// relative to its variance, and that of one pixel along a row or a column. For each direction the
/// covariance [`FAR`] away is subtracted.
fn shared_by_neighbours(a: &Array2<u16>, b: &Array2<u16>) -> Option<(f64, f64)> {
    let (rows, columns) = a.dim();
    let (height, width) = (rows.min(SIDE), columns.min(SIDE));
    if height.min(width) < 2 * FAR.end().unsigned_abs() || a.dim() != b.dim() {
        return None;
    }
    let (top, left) = ((rows - height) / 2, (columns - width) / 2);
    let part = s![top..top + height, left..left + width];
    let mut off: Array2<f32> = Array2::zeros((height, width));
    ndarray::Zip::from(&mut off)
        .and(a.slice(part))
        .and(b.slice(part))
        .for_each(|d, &a, &b| *d = f32::from(a) - f32::from(b));
    off -= off.mean()?;
    without_field(&mut off, a.slice(part), b.slice(part));
    let rows_of: Vec<&[f32]> = off.as_slice()?.chunks_exact(width).collect();
    // Mean product of pixels at this displacement.
    let product = |down: isize, across: isize| {
        let (down, far) = (down.unsigned_abs(), across.unsigned_abs());
        let right = |row: &[f32]| -> std::ops::Range<usize> { far..row.len() };
        let sum = rows_of.iter().zip(&rows_of[down..]).map(|(one, other)| {
            if across < 0 { dot(&one[right(one)], other) } else { dot(one, &other[right(other)]) }
        });
        sum.sum::<f64>() / ((height - down) * (width - far)) as f64
    };
    let mean = |of: &dyn Fn(isize) -> f64| FAR.map(of).sum::<f64>() / FAR.count() as f64;
    let (in_row, in_column) = (mean(&|k| product(0, k)), mean(&|k| product(k, 0)));
    let aslant = mean(&|k| 0.5 * (product(k, k) + product(k, -k)));
    // Half of the neighbours: the opposite half is equal.
    let half = (0..=NEAR).flat_map(|down| (-NEAR..=NEAR).map(move |across| (down, across)));
    let half = half.filter(|(down, across)| *down > 0 || *across > 0);
    let near = half.map(|(down, across)| {
        let far = match (down, across) {
            (0, _) => in_row,
            (_, 0) => in_column,
            _ => aslant,
        };
        product(down, across) - far
    });
    let near: f64 = near.sum();
    let own = product(0, 0) - in_row - in_column + aslant;
    let next = product(0, 1) - in_row + product(1, 0) - in_column;
    (own > 0.0).then(|| (2.0 * near / own, 2.0 * next / own))
}

/// Removes the light field from the difference of two frames by regression on their sum: a flickering
/// lamp leaves the shape of its field in the difference.
fn without_field(off: &mut Array2<f32>, a: ArrayView2<'_, u16>, b: ArrayView2<'_, u16>) {
    let sum = ndarray::Zip::from(a).and(b).map_collect(|&a, &b| f32::from(a) + f32::from(b));
    let Some(mean) = sum.mean() else { return };
    let (mut product, mut square) = (0.0f64, 0.0f64);
    ndarray::Zip::from(&*off).and(&sum).for_each(|d, s| {
        product += f64::from(d * (s - mean));
        square += f64::from(s - mean).powi(2);
    });
    if square > 0.0 {
        let share = (product / square) as f32;
        ndarray::Zip::from(off).and(&sum).for_each(|d, s| *d -= share * (s - mean));
    }
}

/// Returns the sum of products of two rows, the longer one truncated. Separate lanes allow
/// vectorisation.
fn dot(one: &[f32], other: &[f32]) -> f64 {
    const LANES: usize = 16;
    let n = one.len().min(other.len());
    let ((one, rest), (other, other_rest)) = (one[..n].as_chunks::<LANES>(), other[..n].as_chunks::<LANES>());
    let rest: f32 = rest.iter().zip(other_rest).map(|(a, b)| a * b).sum();
    let mut lanes = [0.0f32; LANES];
    for k in 0..one.len() {
        for i in 0..LANES {
            lanes[i] += one[k][i] * other[k][i];
        }
    }
    f64::from(rest) + lanes.iter().copied().map(f64::from).sum::<f64>()
}

/// Computes FNV-1a over the codes (Fowler, Noll and Vo), in four lanes: different frames have equal
/// digests with a probability of 2^-64.
pub(super) fn digest(codes: &[u16]) -> u64 {
    const PRIME: u64 = 0x0000_0100_0000_01b3;
    let mut lanes = [0xcbf2_9ce4_8422_2325u64, 1, 2, 3];
    let whole = codes.chunks_exact(4);
    let rest = whole.remainder();
    for four in whole {
        for (lane, code) in lanes.iter_mut().zip(four) {
            *lane = (*lane ^ u64::from(*code)).wrapping_mul(PRIME);
        }
    }
    let all = rest.iter().map(|c| u64::from(*c)).chain(lanes[1..].to_vec());
    all.fold(lanes[0], |h, x| (h.rotate_left(29) ^ x).wrapping_mul(PRIME))
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// White noise has no neighbour covariance within four errors over 300 pairs, and the mean square
    /// agrees with the stated one within four errors, also for the nearest neighbours alone. Kernels
    /// with a sum of 1 reduce the variance to the sum of their squares, and share the rest: the mean of
    /// two by two 3, that of three by three 8, a sharpening by 0.2 of four neighbours -0.706, all within
    /// four errors of their pairs.
    #[test]
    fn neighbours_share_what_a_kernel_makes() {
        let (rows, columns) = (60, 80);
        let mut random = PixelRng::new(17, Stream::Effect, 0, 0, 0);
        let mut shared = |kernel: &[(usize, usize, f64)]| {
            let mut frame = || {
                let noise = Array2::from_shape_fn((rows + 2, columns + 2), |_| random.normal());
                let of = |(y, x): (usize, usize)| {
                    kernel.iter().map(|(i, j, k)| k * noise[[y + i, x + j]]).sum::<f64>()
                };
                Array2::from_shape_fn((rows, columns), |at| (1000.0 + 60.0 * of(at)).round() as u16)
            };
            shared_by_neighbours(&frame(), &frame()).unwrap()
        };
        let (white, of_next): (Vec<f64>, Vec<f64>) = (0..300).map(|_| shared(&[(1, 1, 1.0)])).unzip();
        for (white, variance) in [(white, NEIGHBOURS_VAR), (of_next, NEXT_VAR)] {
            let expected = variance / (rows * columns) as f64;
            let n = white.len() as f64;
            let mean = white.iter().sum::<f64>() / n;
            let square = white.iter().map(|s| s * s).sum::<f64>() / n;
            assert!(mean.abs() < 4.0 * (expected / n).sqrt(), "{mean}");
            assert!((square / expected - 1.0).abs() < 4.0 * (2.0 / n).sqrt(), "{square} for {expected}");
        }
        let box_of = |side: usize| -> Vec<(usize, usize, f64)> {
            let each = 1.0 / (side * side) as f64;
            (0..side).flat_map(|i| (0..side).map(move |j| (i, j, each))).collect()
        };
        let sharp = [(1, 1, 1.8), (0, 1, -0.2), (1, 0, -0.2), (1, 2, -0.2), (2, 1, -0.2)];
        for kernel in [box_of(2), box_of(3), sharp.to_vec()] {
            let truth = 1.0 / kernel.iter().map(|k| k.2 * k.2).sum::<f64>() - 1.0;
            let all: Vec<f64> = (0..40).map(|_| shared(&kernel).0).collect();
            let mean = all.iter().sum::<f64>() / 40.0;
            let std = (all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 39.0 / 40.0).sqrt();
            assert!((mean - truth).abs() < 4.0 * std + 0.01 * truth.abs(), "{mean} +- {std} for {truth}");
        }
    }

    /// A lamp that flickers by 3 %, in a field that falls to a half in the corners, leaves nothing: the
    /// mean of 300 pairs is 0 and the mean square agrees with the stated one, both within four errors.
    #[test]
    fn flicker_in_a_shaded_field_is_not_shared() {
        let (rows, columns) = (60, 80);
        let mut random = PixelRng::new(18, Stream::Effect, 0, 0, 0);
        let mut frame = || {
            let light = 3000.0 * (1.0 + 0.03 * random.normal());
            Array2::from_shape_fn((rows, columns), |(y, x)| {
                let (y, x) = (y as f64 / 30.0 - 1.0, x as f64 / 40.0 - 1.0);
                let signal = light * (1.0 + 0.21 * (y * y + x * x)).powi(-2);
                (100.0 + signal + 0.4 * signal.sqrt() * random.normal()).round() as u16
            })
        };
        let shares: Vec<f64> =
            (0..300).map(|_| shared_by_neighbours(&frame(), &frame()).unwrap().0).collect();
        let n = shares.len() as f64;
        let mean = shares.iter().sum::<f64>() / n;
        let square = shares.iter().map(|s| s * s).sum::<f64>() / n;
        let expected = NEIGHBOURS_VAR / (rows * columns) as f64;
        println!("mean {mean:.4}, square {square:.3e} for {expected:.3e}");
        assert!(mean.abs() < 4.0 * (expected / n).sqrt(), "{mean}");
        assert!((square / expected - 1.0).abs() < 4.0 * (2.0 / n).sqrt(), "{square} for {expected}");
    }

    #[test]
    fn one_code_changes_the_digest() {
        let frame: Vec<u16> = (0..1003).map(|i| (i * 7 % 4096) as u16).collect();
        for at in 0..frame.len() {
            let mut other = frame.clone();
            other[at] ^= 1;
            assert_ne!(digest(&frame), digest(&other));
        }
        let mut exchanged = frame.clone();
        exchanged.swap(4, 8);
        assert_ne!(digest(&frame), digest(&exchanged));
    }

    /// Light bands and column noise do not change the measured pixel variance, 4 DN squared and
    /// rounding, within five standard errors.
    #[test]
    fn what_lines_share_is_no_difference() {
        use radcam_sim::rng::{PixelRng, Stream};
        let (rows, columns) = (64usize, 96usize);
        let frame = |f: u64| -> Vec<u16> {
            let normal = |at: usize| PixelRng::new(8, Stream::Frame, f, at as u32, 0).normal();
            let value = |i: usize| {
                let (y, x) = (i / columns, i % columns);
                1000.0
                    + 200.0 * (0.02 * y as f64 + 2.0 * f as f64).sin()
                    + 50.0 * normal(10_000 + x)
                    + 4.0 * normal(i)
            };
            (0..rows * columns).map(|i| value(i).round() as u16).collect()
        };
        let (changed, variance) = difference(&frame(0), &frame(1), columns);
        let truth = 4.0f64.powi(2) + 1.0 / 12.0;
        let error = truth * (2.0 / (rows * columns) as f64).sqrt();
        assert!(changed > 5000 && (variance - truth).abs() < 5.0 * error, "{variance}");
    }

    #[test]
    fn the_middle_of_a_mirrored_frame_is_mirrored() {
        for (rows, columns) in [(70, 101), (64, 64), (9, 200), (1, 1)] {
            let frame = Array2::from_shape_fn((rows, columns), |(y, x)| (y * 300 + x) as u16);
            let mirrored = frame.slice(s![.., ..;-1]).to_owned();
            let (a, b) = (middle_of(&frame), middle_of(&mirrored));
            assert_eq!(a.slice(s![.., ..;-1]), b);
        }
    }
}
