//! First look at a campaign: at most eight frames of each set determine the usable pixels, the dark
//! level, and the usual scatter of frames.

pub mod filled;
mod lit_part;

use crate::data_faults::ExamineError;
use crate::dataset::{Dataset, Key, Kind, Reduced};
use crate::statistics::layout::Layout;
use crate::statistics::median::median;
use crate::statistics::outliers;
use ndarray::Array2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

pub(crate) use lit_part::lit_part;

/// Number of frames per set that the first look reads.
pub(crate) const FIRST: usize = 8;

/// Distance to full scale, in standard deviations of a pixel's noise, at which the pixel is clipped.
const REACH: f64 = 3.0;

/// Minimum noise of jumping pixels, relative to other pixels (a named choice).
const JUMPS: f64 = 8.0;
/// Maximum offset of their mean, relative to their noise (a named choice: a jump in 9 of 10 frames lies
/// 3 off).
const OFF: f64 = 3.0;
/// Minimum number of frames of a dark set that determines the noise of a pixel.
const JUMPING_FRAMES: usize = 4;
/// Maximum signal of blind pixels, relative to the others: covered columns, dead pixels, area outside
/// the image circle (a named choice).
const BLIND: f64 = 0.1;
/// Minimum median of flats that reveal blind pixels, relative to full scale.
const TELLS_BLIND: f64 = 0.1;

/// Minimum deviation of a dim defect pixel from its neighbours, relative to their level: ten times a
/// usual PRNU (a named choice).
const MIN_DIM_REL: f64 = 0.2;
/// Minimum deviation in standard errors of its mean.
const MIN_DIM_SIGMAS: f64 = 6.0;

/// Numbers of frames of sets whose means are compared from set to set: the frames of longer ones are compared
/// with each other.
const FEW: std::ops::RangeInclusive<usize> = 2..=3;
/// Number of pixels of which the mean is kept: enough to know a noise to half a per cent.
const MIDDLE_PIXELS: usize = 1 << 15;

/// Returns the range of the pixels in the middle rows of a frame of (rows, columns).
pub(crate) fn middle((rows, columns): (usize, usize)) -> std::ops::Range<usize> {
    let number = MIDDLE_PIXELS.div_ceil(columns.max(1)).min(rows);
    let first = (rows - number) / 2;
    first * columns..(first + number) * columns
}

/// Findings from the first frames of a set.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Look {
    /// Pixels at full scale, or so close that their noise reaches it.
    clipped: Vec<usize>,
    /// True if these are 2 % of the pixels or more: the set is clipped.
    #[serde(default)]
    pub(crate) saturated: bool,
    /// Jumping pixels of a dark set: noise far above that of others, and a mean no further off than that
    /// noise.
    #[serde(default)]
    jumping: Vec<usize>,
    /// Mean of a dark set, DN.
    dark: Option<Array2<f32>>,
    /// Mean of the pixels in the [`middle`] of a set of few frames, DN.
    #[serde(default)]
    middle: Option<Vec<f32>>,
    /// Mean and temporal variance of the first two frames.
    pair: Option<(f64, f64)>,
    /// Pixels of a flat set far below the median, with their means, DN.
    #[serde(default)]
    low: Vec<(usize, f32)>,
    /// Dim defect pixels of a flat set.
    #[serde(default)]
    dim: Vec<usize>,
    /// Median of a flat set's pixels, DN.
    #[serde(default)]
    level_dn: Option<f32>,
    /// Pixels that appear to be interpolated from their neighbours, if that was examined.
    #[serde(default)]
    filled: Option<Vec<usize>>,
    /// 0.5 % quantile of the samples of the first frame of a dark set, as a code.
    #[serde(default)]
    darkest: Option<u16>,
    /// Distances of the frames from each other, and true for a dark set.
    pub(crate) apart: Option<(bool, outliers::Apart)>,
}

impl Look {
    /// Returns the temporal variance of the first two frames, DN^2.
    pub(crate) fn var_dn2(&self) -> Option<f64> {
        self.pair.map(|pair| pair.1)
    }

    /// Returns the mean of the pixels in the [`middle`] of a set of few frames, DN.
    pub(crate) fn middle_mean(&self) -> Option<&[f32]> {
        self.middle.as_deref()
    }

    /// Returns true if it is consistent with frames of (rows, columns).
    pub fn fits(&self, shape: (usize, usize)) -> bool {
        let low = self.low.iter().map(|(i, _)| i);
        let pixels = self.clipped.iter().chain(&self.jumping).chain(self.filled.iter().flatten());
        let pixels = pixels.chain(low).chain(&self.dim);
        pixels.copied().all(|i| i < shape.0 * shape.1)
            && self.middle.as_ref().is_none_or(|m| m.len() == middle(shape).len())
            && self.dark.as_ref().is_none_or(|d| d.dim() == shape)
    }
}

fn look(dataset: &Dataset, set: usize, full: u16) -> Result<Look, ExamineError> {
    let set = &dataset.sets()[set];
    if let Some(known) = dataset.reduced().and_then(|r| r.get::<Look>(&Key::first(dataset, set, FIRST))) {
        return Ok(known.clone());
    }
    let kind = dataset.settings(set).kind;
    let mut out = Look::default();
    if !matches!(kind, Kind::Dark | Kind::Flat) {
        return Ok(out);
    }
    let mut sum = Array2::<f32>::zeros((0, 0));
    let mut block: Vec<Arc<Array2<u16>>> = Vec::new();
    let rows = &set.rows[..set.rows.len().min(FIRST)];
    for &r in rows {
        let frame = dataset.frame(&dataset.rows()[r])?;
        if sum.dim() != frame.dim() {
            sum = Array2::zeros(frame.dim());
        }
        sum.zip_mut_with(&*frame, |m, &d| *m += f32::from(d));
        block.push(frame);
    }
    let (block, _) = outliers::without_struck(&block);
    let full = block.first().and_then(|frame| top_code(frame, full)).unwrap_or(full);
    if let [a, b, ..] = block.as_slice() {
        out.pair = Some(pair(a, b, full));
    }
    // Pixels whose noise reaches full scale are excluded by their mean. Selection by a high sample would
    // favour pixels of low noise; the mean of normal noise is independent of its variance.
    let reach = match (out.pair, block.as_slice()) {
        // Rows lost in one frame are not pixel noise.
        (Some((_, var)), [a, b, ..]) => REACH * var.max(0.0).min(TAILS * usual_var(a, b)).sqrt(),
        _ => 0.0,
    };
    let near = (f64::from(full) - if reach.is_finite() { reach } else { 0.0 }).max(0.5 * f64::from(full));
    let near = (near * block.len() as f64) as f32;
    let over: Vec<bool> = sum.iter().map(|s| *s >= near && !block.is_empty()).collect();
    let number = over.iter().filter(|o| **o).count();
    out.saturated = is_saturated(number, sum.len());
    if number as f64 <= MAX_LISTED * sum.len() as f64 {
        out.clipped = over.iter().enumerate().filter(|(_, o)| **o).map(|(i, _)| i).collect();
    }
    out.darkest = block.first().filter(|f| kind == Kind::Dark && !f.is_empty()).map(|frame| {
        let mut codes: Vec<u16> = frame.iter().copied().collect();
        let place = codes.len() / 200;
        *codes.select_nth_unstable(place).1
    });
    let bright = out.pair.is_some_and(|(mean, var)| {
        var >= filled::LEAST_VAR_DN2 && mean >= filled::LEAST_LEVEL * f64::from(full)
    });
    if kind == Kind::Flat && bright && block.len() >= filled::SETS.1 {
        out.filled = Some(filled::candidates(&block));
    }
    if kind == Kind::Flat && !out.saturated {
        let frames = block.len().max(1) as f32;
        let level = median(sum.iter().map(|s| f64::from(s / frames))) as f32;
        if f64::from(level) > TELLS_BLIND * f64::from(full) {
            let low = sum.iter().map(|s| s / frames).enumerate().filter(|(_, mean)| *mean < 0.5 * level);
            out.low = low.collect();
            let noise_dn = out.pair.map_or(0.0, |(_, var)| (var.max(0.0) / f64::from(frames)).sqrt());
            out.dim = dim(&(&sum / frames), (MIN_DIM_SIGMAS * noise_dn) as f32);
            out.level_dn = Some(level);
        }
    }
    out.apart = Some((kind == Kind::Dark, outliers::apart(&block)));
    if rows.len() == set.rows.len() && block.len() == rows.len() && FEW.contains(&rows.len()) {
        let all = sum.as_slice().and_then(|s| s.get(middle(sum.dim())));
        out.middle = all.map(|s| s.iter().map(|v| v / rows.len() as f32).collect());
    }
    out.dark = (kind == Kind::Dark).then(|| sum / rows.len().max(1) as f32);
    if let (Some(dark), Some((_, var))) = (&out.dark, out.pair) {
        out.jumping = jumping(dark, &block, var);
    }
    Ok(out)
}

/// Maximum fraction of pixels at full scale that are listed (a named choice): beyond, a set gives no
/// information on single pixels, and a list takes memory.
const MAX_LISTED: f64 = 0.05;

/// Returns true if the number of pixels at full scale makes the set saturated.
fn is_saturated(clipped: usize, pixels: usize) -> bool {
    clipped * 50 >= pixels.max(1)
}

/// Treats pixels that are at full scale in the darks too, such as stuck columns, as defects: they do not
/// make a set saturated. Saturated sets then list none.
fn without_stuck(looks: &mut [Look], pixels: usize) {
    let measured = || looks.iter().filter(|l| l.apart.is_some());
    // A dark without a pixel list gives no information on single pixels.
    let is_dark = |l: &&Look| l.dark.is_some() && !(l.saturated && l.clipped.is_empty());
    let mut darks = measured().filter(is_dark);
    let mut stuck = darks.next().map(|l| l.clipped.clone()).unwrap_or_default();
    for dark in darks {
        stuck.retain(|pixel| dark.clipped.binary_search(pixel).is_ok());
    }
    for look in looks.iter_mut().filter(|l| l.saturated && !l.clipped.is_empty()) {
        look.saturated = is_saturated(look.clipped.len().saturating_sub(stuck.len()), pixels);
        if look.saturated {
            look.clipped = Vec::new();
        }
    }
}

/// Maximum distance of the converter's top code from full scale, relative to full scale: code steps, a
/// subtracted black level, and digital gain leave the last codes unused (a named choice).
const TOP: f64 = 1.0 / 64.0;
/// Minimum fraction of the pixels that pile up at the top code.
const PILE: f64 = 1e-3;
/// Minimum ratio of the pixels at the top code to those at the next one below: noise of any kind falls
/// off there.
const ABOVE_NEXT: usize = 5;

/// Finds the code, a little below full scale, at which a frame piles up.
fn top_code(frame: &Array2<u16>, full: u16) -> Option<u16> {
    let top = *frame.iter().max()?;
    if top >= full || f64::from(top) < f64::from(full) * (1.0 - TOP) {
        return None;
    }
    let at = |code: u16| frame.iter().filter(|other| **other == code).count();
    let (at_top, next) = (at(top), frame.iter().copied().filter(|code| *code < top).max());
    let at_next = next.map_or(0, at);
    (at_top as f64 >= PILE * frame.len() as f64 && at_top >= ABOVE_NEXT * at_next.max(1)).then_some(top)
}

/// Averages darks of few frames, in order of their levels, until each mean has as many frames as the first
/// look reads of long sets. Noisy pixels of pairs would lie as far off as hot ones in some set. `None` if the
/// sets have more frames, or are too few for two means.
fn of_few_frames(darks: &[&Look], level: impl Fn(&Array2<f32>) -> f64) -> Option<Vec<Array2<f32>>> {
    let frames = |l: &Look| l.apart.as_ref().map_or(0, |(_, apart)| apart.mean_dn.len());
    let most = darks.iter().map(|l| frames(l)).max()?;
    let together = FIRST.div_ceil(most.max(1));
    if most >= JUMPING_FRAMES || darks.len() < 2 * together {
        return None;
    }
    let mut means: Vec<&Array2<f32>> = darks.iter().filter_map(|l| l.dark.as_ref()).collect();
    means.sort_by(|a, b| level(a).total_cmp(&level(b)));
    // The last mean takes the sets that are left over.
    let groups = means.len() / together;
    let of_group = |k: usize| {
        let end = if k + 1 == groups { means.len() } else { (k + 1) * together };
        let own = &means[k * together..end];
        let mut sum = own[0].clone();
        own[1..].iter().for_each(|d| sum += *d);
        sum / own.len() as f32
    };
    Some((0..groups).map(of_group).collect())
}

/// Minimum number of dark sets that determine the noise of a pixel.
const SETS_OF_NOISE: usize = 4;
/// Offset of a mean, in its own standard errors, that the largest of a few means does not reach by chance (2
/// in 10,000 for three of them).
const BY_NOISE: f64 = 4.0;

/// Noise of single pixels from set to set: noisy pixels are no hot ones, and belong to the read noise.
struct OwnNoise<'a> {
    /// Means of the darks in order of their levels.
    means: Vec<&'a [f32]>,
    /// Number of sets in each of the compared means.
    together: f64,
    /// Usual standard error of the mean of a set, DN.
    usual_dn: f64,
}

impl<'a> OwnNoise<'a> {
    /// `compared`: number of means among which the highest was sought. `None` for too few sets.
    fn of(darks: &[&'a Look], compared: usize, level: impl Fn(&Array2<f32>) -> f64) -> Option<Self> {
        let mut own: Vec<&Array2<f32>> = darks.iter().filter_map(|l| l.dark.as_ref()).collect();
        own.sort_by(|a, b| level(a).total_cmp(&level(b)));
        let frames = |l: &&Look| l.apart.as_ref().map_or(1, |(_, apart)| apart.mean_dn.len()).max(1) as f64;
        let squares = darks.iter().filter_map(|l| Some(l.var_dn2()?.max(1.0 / 12.0) / frames(l)));
        let usual_dn = median(squares).sqrt();
        let means: Vec<&[f32]> = own.iter().filter_map(|d| d.as_slice()).collect();
        let together = means.len() as f64 / compared.max(1) as f64;
        (means.len() >= SETS_OF_NOISE && usual_dn > 0.0).then_some(Self { means, together, usual_dn })
    }

    /// Returns true if the noise of a pixel reaches an offset of its mean, and is not that of a pixel that
    /// jumps. The median of the steps from set to set leaves out those of the dark charge, which is largest
    /// in the last few sets.
    fn reaches(&self, pixel: usize, off_dn: f64) -> bool {
        let steps = self.means.windows(2).map(|pair| f64::from(pair[1][pixel] - pair[0][pixel]).abs());
        let noise_dn = median(steps) / (0.6745 * std::f64::consts::SQRT_2);
        noise_dn < JUMPS * self.usual_dn && off_dn < BY_NOISE * noise_dn / self.together.sqrt()
    }
}

/// Finds pixels that jump between levels. Their means are offset like those of hot pixels: a jump A in a
/// fraction p of the frames moves the mean by p A and has noise sqrt(p (1 - p)) A. The shot noise of a
/// hot pixel is far below its offset.
fn jumping(dark: &Array2<f32>, block: &[Arc<Array2<u16>>], usual_dn2: f64) -> Vec<usize> {
    if block.len() < JUMPING_FRAMES {
        return Vec::new();
    }
    let mut squares = vec![0.0f32; dark.len()];
    for frame in block {
        for ((s, &d), &mean) in squares.iter_mut().zip(&**frame).zip(dark) {
            *s += (f32::from(d) - mean).powi(2);
        }
    }
    let middle = median(dark.iter().map(|&d| f64::from(d)));
    let (dof, least) = ((block.len() - 1) as f64, JUMPS * JUMPS * usual_dn2.max(1.0 / 12.0));
    let jumps = |(mean, square): (&f32, &f32)| {
        let variance = f64::from(*square) / dof;
        variance > least && (f64::from(*mean) - middle).powi(2) < OFF * OFF * variance
    };
    let found = dark.iter().zip(&squares).enumerate().filter(|(_, p)| jumps(*p));
    found.map(|(i, _)| i).collect()
}

/// Maximum ratio of the variance of two frames to that of most of their pixels that may be noise (a
/// named choice).
const TAILS: f64 = 4.0;
/// Number of pixels that determines the usual noise to 1 % (a named choice).
const USUAL_PIXELS: usize = 20_000;

/// Returns the temporal variance of most pixels of two frames, DN^2: from the median of the absolute
/// deviations, which for normal noise is 0.6745 standard deviations; at least that of rounding.
fn usual_var(a: &Array2<u16>, b: &Array2<u16>) -> f64 {
    let step = (a.len() / USUAL_PIXELS).max(1);
    let apart = || a.iter().zip(b).step_by(step).map(|(a, b)| f64::from(*a) - f64::from(*b));
    let middle = median(apart());
    let deviation = median(apart().map(|d| (d - middle).abs())) / 0.6745;
    (0.5 * deviation * deviation).max(1.0)
}

/// Returns mean and temporal variance of the pixels of two frames that are clipped in neither.
fn pair(a: &Array2<u16>, b: &Array2<u16>, full: u16) -> (f64, f64) {
    let (mut n, mut sum, mut apart, mut square) = (0.0, 0.0, 0.0, 0.0);
    for (&a, &b) in a.iter().zip(b).filter(|(a, b)| **a < full && **b < full) {
        let (a, b) = (f64::from(a), f64::from(b));
        (n, sum, apart, square) = (n + 1.0, sum + a + b, apart + a - b, square + (a - b) * (a - b));
    }
    (0.5 * sum / n, 0.5 * (square / n - (apart / n) * (apart / n)))
}

/// Estimates the growth of variance with the mean between the dimmest and the brightest pair, DN:
/// accurate enough for pixel weights.
fn rough_gain(pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    let points: Vec<_> = pairs.filter(|p| p.0.is_finite() && p.1.is_finite()).collect();
    let low = points.iter().min_by(|a, b| a.0.total_cmp(&b.0));
    let high = points.iter().max_by(|a, b| a.0.total_cmp(&b.0));
    match (low, high) {
        (Some(low), Some(high)) if high.0 > low.0 + 1.0 => ((high.1 - low.1) / (high.0 - low.0)).max(0.0),
        _ => 0.0,
    }
}

/// Finds pixels without light and dim defect pixels in the brightest set of flats.
fn blind(looks: &[Look], zero_dn: f64) -> Vec<usize> {
    let brightest =
        looks.iter().filter_map(|l| Some((f64::from(l.level_dn?), l))).max_by(|a, b| a.0.total_cmp(&b.0));
    let Some((level_dn, look)) = brightest else { return Vec::new() };
    let is_blind = |mean: f32| f64::from(mean) - zero_dn < BLIND * (level_dn - zero_dn);
    look.low
        .iter()
        .filter(|(_, mean)| is_blind(*mean))
        .map(|(i, _)| *i)
        .chain(look.dim.iter().copied())
        .collect()
}

/// Finds dim defect pixels and columns: lower than the median of their neighbours by [`MIN_DIM_REL`] and
/// `min_dn`.
fn dim(mean: &Array2<f32>, min_dn: f32) -> Vec<usize> {
    let (rows, columns) = mean.dim();
    let is_below = |own: f32, around: f32| around - own > min_dn.max(MIN_DIM_REL as f32 * around);
    let mut found = Vec::new();
    for (y, row) in mean.outer_iter().enumerate() {
        for (x, &own) in row.iter().enumerate() {
            // Comparison with the two row neighbours excludes most pixels cheaply.
            let beside = if x > 0 { row[x - 1] } else { *row.get(1).unwrap_or(&own) };
            let other = if x + 1 < columns { row[x + 1] } else { beside };
            if !is_below(own, beside.max(other)) {
                continue;
            }
            let around = |n: usize, end: usize| n.saturating_sub(1)..(n + 2).min(end);
            let near = around(y, rows).flat_map(|yy| around(x, columns).map(move |xx| (yy, xx)));
            let others = near.filter(|at| *at != (y, x)).map(|at| f64::from(mean[at]));
            if is_below(own, median(others) as f32) {
                found.push(y * columns + x);
            }
        }
    }
    found
}

/// Determines the usable pixels, the zero level, and the growth of variance with the signal.
fn layout(shape: (usize, usize), full: u16, looks: &[Look]) -> (Layout, f64, usize) {
    let mut used = Array2::from_elem(shape, true);
    let filled: Vec<&[usize]> =
        looks.iter().filter_map(|l| l.filled.as_deref()).take(filled::SETS.0).collect();
    let filled = filled::of_sets(&filled, used.len());
    if let Some(used) = used.as_slice_mut() {
        looks.iter().flat_map(|l| &l.clipped).for_each(|&i| used[i] = false);
    }
    // In a dark at full scale most pixels have one code, and the sound ones deviate from it.
    let is_told = |l: &&Look| !l.saturated || looks.iter().all(|l| l.saturated || l.dark.is_none());
    let level = |d: &Array2<f32>| f64::from(d.mean().unwrap_or(0.0));
    let own: Vec<&Look> = looks.iter().filter(is_told).filter(|l| l.dark.is_some()).collect();
    let means = of_few_frames(&own, level);
    let darks: Vec<&Array2<f32>> = match &means {
        Some(means) => means.iter().collect(),
        None => own.iter().filter_map(|l| l.dark.as_ref()).collect(),
    };
    let shortest = darks.iter().min_by(|a, b| level(a).total_cmp(&level(b)));
    let mut highest = shortest.map(|d| (*d).clone());
    if let Some(highest) = &mut highest {
        darks.iter().for_each(|d| highest.zip_mut_with(d, |a, b| *a = a.max(*b)));
        let middle = median(highest.iter().map(|&d| f64::from(d)));
        let spread = (median(highest.iter().map(|&d| (f64::from(d) - middle).abs())) / 0.6745).max(0.5);
        let clipped = used.clone();
        let noise = OwnNoise::of(&own, darks.len(), level);
        if let (Some(used), Some(highest)) = (used.as_slice_mut(), highest.as_slice()) {
            for (i, (used, d)) in used.iter_mut().zip(highest).enumerate() {
                let off_dn = (f64::from(*d) - middle).abs();
                *used &= off_dn < 8.0 * spread || noise.as_ref().is_some_and(|n| n.reaches(i, off_dn));
            }
        }
        if let (Some(used), Some(clipped)) = (used.as_slice_mut(), clipped.as_slice()) {
            looks.iter().flat_map(|l| &l.jumping).for_each(|&i| used[i] = clipped[i]);
        }
    }
    if let Some(used) = used.as_slice_mut() {
        blind(looks, shortest.map_or(0.0, |d| level(d))).into_iter().for_each(|i| used[i] = false);
    }
    // If most pixels were excluded, the criterion failed, not the pixels.
    if used.iter().filter(|u| **u).count() * 2 < used.len() {
        used.fill(true);
    }
    if let Some(used) = used.as_slice_mut() {
        filled.iter().for_each(|&i| used[i] = false);
    }
    let mut layout = Layout::new(&used, full);
    layout.zero = shortest.map(|d| d.iter().copied().collect());
    layout.gain = rough_gain(looks.iter().filter_map(|l| l.pair));
    (layout, shortest.map_or(0.0, |d| level(d)), filled.len())
}

/// Takes a first look at every set: levels, and frames as memory allows.
fn first_look(
    dataset: &Dataset,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize),
) -> Result<Vec<Look>, ExamineError> {
    let full = dataset.manifest().camera.full_scale_dn();
    let sets: Vec<usize> = (0..dataset.sets().len()).collect();
    let mut looks = Vec::with_capacity(sets.len());
    for group in sets.chunks(8) {
        if stop.load(Ordering::Relaxed) {
            return Err(ExamineError::Interrupted);
        }
        let of_set = |&set: &usize| look(dataset, set, full);
        looks.extend(group.par_iter().map(of_set).collect::<Result<Vec<_>, _>>()?);
        progress(looks.len());
    }
    let camera = &dataset.manifest().camera;
    without_stuck(&mut looks, camera.height * camera.width);
    Ok(looks)
}

/// Maximum temporal variance of a dark relative to the quietest: for charge shot noise small beside the
/// read noise, and for use if frames are few; then the number of frames, beyond one per set, needed for
/// single pixels (named choices).
const LITTLE_CHARGE: [f64; 2] = [1.3, 3.0];
const FRAMES_OF_PIXELS: usize = 6;

/// Returns the maximum variance of darks that determine the read noise of single pixels, DN^2.
fn quiet_dark_dn2(dataset: &Dataset, looks: &[Look]) -> f64 {
    let dark = |(set, look): (&crate::dataset::Set, &Look)| {
        let var_dn2 = look.var_dn2().filter(|_| look.dark.is_some() && !look.saturated)?;
        Some((var_dn2, set.rows.len().saturating_sub(1)))
    };
    let mut darks: Vec<(f64, usize)> =
        dataset.sets().iter().zip(looks).filter_map(dark).filter(|d| d.0.is_finite()).collect();
    darks.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some(quietest) = darks.first() else { return f64::INFINITY };
    let mut frames = 0;
    let enough = darks.iter().find(|(_, more)| {
        frames += more;
        frames >= FRAMES_OF_PIXELS
    });
    let [little, most] = LITTLE_CHARGE.map(|ratio| ratio * quietest.0);
    enough.map_or(most, |e| e.0.clamp(little, most))
}

/// Results of the first look at a campaign, with which every piece is read.
pub(crate) struct Seen {
    pub(crate) layout: Layout,
    pub(crate) zero_dn: f64,
    pub(crate) usual: outliers::Usual,
    /// Longest exposure of flats, s.
    pub(crate) longest_lit_s: f64,
    /// Maximum temporal variance of the first frames of darks that determine the read noise of single
    /// pixels, DN^2.
    pub(crate) quiet_dark_dn2: f64,
    pub(crate) looks: Vec<Look>,
    /// Number of pixels interpolated by the camera from their neighbours.
    pub(crate) filled: usize,
    /// 0.5 % quantile of the dark samples, as a code.
    pub(crate) darkest_dn: Option<f64>,
}

impl Seen {
    pub(crate) fn new(
        dataset: &Dataset,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(usize),
    ) -> Result<Self, ExamineError> {
        let camera = &dataset.manifest().camera;
        let (full, shape) = (camera.full_scale_dn(), (camera.height, camera.width));
        // Memory is bounded by actual data: a frame must confirm the size claimed by a header.
        // Statistics were checked when opened.
        if let Some(row) = dataset.rows().first().filter(|_| dataset.reduced().is_none()) {
            dataset.read(row)?;
        }
        let looks = first_look(dataset, stop, progress)?;
        let (layout, zero_dn, filled) = layout(shape, full, &looks);
        let aparts: Vec<_> = looks.iter().filter_map(|l| l.apart.clone()).collect();
        let darkest_dn = looks.iter().filter_map(|l| l.darkest).min().map(f64::from);
        let lit = dataset.rows().iter().filter(|r| r.kind == Kind::Flat && r.illumination > 0.0);
        let longest_lit_s = lit.map(|r| r.exposure_s).fold(0.0, f64::max);
        Ok(Self {
            usual: outliers::Usual::of(&aparts, zero_dn),
            layout,
            zero_dn,
            longest_lit_s,
            quiet_dark_dn2: quiet_dark_dn2(dataset, &looks),
            looks,
            filled,
            darkest_dn,
        })
    }

    /// Returns a digest of everything that the statistics of a piece depend on beside its frames and
    /// their settings; `names` are those of the statistics.
    pub(crate) fn digest<'n>(&self, names: impl Iterator<Item = &'n str>) -> String {
        let mut all = Sha256::new();
        all.update(env!("CARGO_PKG_VERSION"));
        names.for_each(|name| all.update(name));
        let layout = &self.layout;
        [layout.shape.0, layout.shape.1].iter().for_each(|n| all.update((*n as u64).to_le_bytes()));
        layout.mask.iter().for_each(|m| all.update([u8::from(*m > 0.0)]));
        layout.zero.iter().flatten().for_each(|z| all.update(z.to_le_bytes()));
        let numbers = [layout.gain, self.zero_dn, self.longest_lit_s, self.quiet_dark_dn2];
        numbers.iter().for_each(|n| all.update(n.to_le_bytes()));
        self.usual.numbers().iter().for_each(|n| all.update(n.to_le_bytes()));
        all.finalize().iter().map(|b| format!("{b:02x}")).collect()
    }
}

/// Takes the first look at every set and records it.
pub fn record_looks(dataset: &Dataset, stop: &AtomicBool) -> Result<Reduced, ExamineError> {
    let mut out = Reduced::default();
    for (set, look) in dataset.sets().iter().zip(first_look(dataset, stop, &mut |_| {})?) {
        out.add(Key::first(dataset, set, FIRST), look);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::{Look, OwnNoise, dim, top_code};
    use ndarray::Array2;
    use radcam_sim::rng::{PixelRng, Stream};

    /// In 20 darks of one frame each, nine of ten pixels of up to five times the usual noise stay. Hot
    /// pixels, also those that only long exposures show, and pixels of sixteen times the noise do not.
    #[test]
    fn noisy_pixels_are_no_hot_ones() {
        let shape = (40, 50);
        let kind = |i: usize| i % 4;
        let dark = |set: u32| {
            Array2::from_shape_fn(shape, |(r, c)| {
                let i = r * shape.1 + c;
                let z = PixelRng::new(396, Stream::Frame, u64::from(set), i as u32, 0).normal();
                let charge = 2f64.powi(set as i32 / 2 - 9);
                let (sd, off) = [(1.0, 0.0), (5.0, 0.0), (1.0, 400.0 * charge), (16.0, 0.0)][kind(i)];
                (20.0 + sd * z + off) as f32
            })
        };
        let look = |set: u32| Look { dark: Some(dark(set)), pair: Some((20.0, 1.0)), ..Look::default() };
        let looks: Vec<Look> = (0..20).map(look).collect();
        let all: Vec<&Look> = looks.iter().collect();
        let level = |d: &Array2<f32>| f64::from(d.mean().unwrap());
        let noise = OwnNoise::of(&all, all.len(), level).unwrap();
        let mut kept = [0; 4];
        for i in 0..shape.0 * shape.1 {
            let own = looks.iter().map(|l| f64::from(l.dark.as_ref().unwrap().as_slice().unwrap()[i]) - 20.0);
            let off_dn = own.map(f64::abs).fold(0.0, f64::max);
            kept[kind(i)] += usize::from(noise.reaches(i, off_dn));
        }
        // 500 of each kind.
        assert!(kept[0] > 450 && kept[1] > 450 && kept[2] == 0 && kept[3] < 50, "{kept:?}");
        assert!(OwnNoise::of(&all[..3], 3, level).is_none());
    }

    /// Two dim pixels, one of them in a corner, and a dead column are found in a shaded field; dust of 5
    /// x 5 pixels is not.
    #[test]
    fn single_pixels_are_dim() {
        let mut mean = Array2::from_shape_fn((30, 40), |(r, c)| 1000.0 - 10.0 * r as f32 - 5.0 * c as f32);
        for (r, c) in (14..19).flat_map(|r| (20..25).map(move |c| (r, c))) {
            mean[(r, c)] *= 1.0 - 0.15 * (5.0 - (r as f32 - 16.0).abs() - (c as f32 - 22.0).abs()) / 5.0;
        }
        mean[(0, 0)] *= 0.7;
        mean[(9, 10)] *= 0.3;
        assert_eq!(dim(&mean, 10.0), [0, 9 * 40 + 10]);
        assert_eq!(dim(&mean, 400.0), [9 * 40 + 10]);
        mean.column_mut(30).fill(100.0);
        assert!((0..30).all(|r| dim(&mean, 400.0).contains(&(r * 40 + 30))));
    }

    /// Pile-up at code 1022 of 1023 is found; noise that ends there, and a full well far below, are not.
    #[test]
    fn codes_pile_up_at_the_top() {
        let frame = |code: &dyn Fn(usize) -> u16| Array2::from_shape_fn((40, 50), |(r, c)| code(50 * r + c));
        assert_eq!(
            top_code(&frame(&|i| if i.is_multiple_of(10) { 1022 } else { 900 + 2 * (i % 50) as u16 }), 1023),
            Some(1022)
        );
        assert_eq!(top_code(&frame(&|i| 1022 - (i % 60) as u16), 1023), None);
        assert_eq!(top_code(&frame(&|i| if i.is_multiple_of(10) { 900 } else { 600 }), 1023), None);
        assert_eq!(top_code(&frame(&|_| 1022), 1023), Some(1022));
        assert_eq!(top_code(&frame(&|_| 1023), 1023), None);
    }
}
