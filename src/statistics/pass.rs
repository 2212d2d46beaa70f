//! Computes all noise statistics of a set in one pass, in memory independent of the number of frames.
//!
//! Each frame's mean and each pixel's running mean (Welford 1962) are subtracted. The residuals, times the
//! root of (n - 1) / n, are independent deviations whose products sum to those about the final means. Merging
//! two halves adds the product of the difference of their means (Chan, Golub and LeVeque 1979), which every
//! statistic takes as one more frame. So shading, fixed pattern and the lamp do not enter, and any split of
//! the frames gives the same result to rounding.

use super::covariance::{Covariance, Covariances};
use super::frame_means::FrameMeans;
use super::jackknife::Value;
use super::layout::Layout;
use super::lines::Lines;
use super::moments::SizeMismatch;
use super::occupancy::Occupancy;
use super::powers::Powers;
use super::quadratic::Quadratic;
use super::spectrum::Power;
use super::successive::Successive;
use super::variance::Variance;
use radcam_sim::predict::PLACES;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Additional statistic: a sum of products of deviations, computed from whole images.
pub trait Extra: Sync + std::fmt::Debug {
    /// Number of sums.
    fn size(&self, layout: &Layout) -> usize;
    /// Adds an image of deviations (rows * columns) whose row means and column means are complete.
    fn add(&self, image: &[f32], lines: &Lines, layout: &Layout, sums: &mut [f64]);
}

/// Accumulator of the frames of a set.
#[derive(Debug)]
pub struct Pass<'a> {
    layout: &'a Layout,
    frame_means: FrameMeans,
    /// Mean of every pixel after subtraction of each frame's mean, DN.
    mean: Vec<f32>,
    /// Scaled deviations of the current frame.
    now: Vec<f32>,
    sums: Sums,
    successive: Successive,
    /// Codes of the pixels in use.
    occupancy: Occupancy,
    /// Places of the masked pixels.
    masked: Vec<usize>,
    /// Third and fourth powers of every pixel's deviations, if requested.
    powers: Option<Powers>,
}

/// All sums of products of deviations.
#[derive(Debug)]
struct Sums {
    variance: Variance,
    covariance: Covariance,
    lines: Lines,
    power: Power,
    extra: Vec<(&'static dyn Extra, Vec<f64>)>,
}

impl Quadratic for Covariance {
    #[inline(always)]
    fn row(&mut self, y: usize, image: &[f32], _: &Layout) {
        self.add_row(y, image);
    }

    fn end(&mut self, _: &[f32], _: &Layout) {
        self.end_image();
    }

    fn absorb(&mut self, other: &Self) {
        self.add_sums(other);
    }
}

impl Quadratic for Sums {
    #[inline(always)]
    fn row(&mut self, y: usize, image: &[f32], layout: &Layout) {
        self.variance.row(y, image, layout);
        self.covariance.row(y, image, layout);
        self.lines.row(y, image, layout);
    }

    fn end(&mut self, image: &[f32], layout: &Layout) {
        self.covariance.end(image, layout);
        self.lines.end(image, layout);
        self.power.add(image, &self.lines, layout);
        self.extra.iter_mut().for_each(|(e, sums)| e.add(image, &self.lines, layout, sums));
    }

    fn absorb(&mut self, other: &Self) {
        self.variance.absorb(&other.variance);
        self.covariance.absorb(&other.covariance);
        self.lines.absorb(&other.lines);
        self.power.absorb(&other.power);
        for ((_, sums), (_, more)) in self.extra.iter_mut().zip(&other.extra) {
            sums.iter_mut().zip(more).for_each(|(a, b)| *a += b);
        }
    }
}

/// Statistics of the frames of a set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Number of frames.
    pub frames: usize,
    /// Number of pixels in use.
    pub pixels: f64,
    /// Means of whole frames.
    pub frame_means: FrameMeans,
    /// Temporal variance, DN^2.
    pub var: Value,
    /// Covariances within a frame.
    pub covariances: Covariances,
    /// Covariance of a pixel's noise in successive frames, DN^2: 0 for independent frames.
    pub successive: Value,
    /// Variance of row means, of column means, DN^2.
    pub line_var_dn2: [f64; 2],
    /// Excess of the spread of the pixels' variances over sampling scatter.
    pub unequal: Value,
    /// Counts of codes.
    pub occupancy: Occupancy,
    /// Power at each frequency in read-out order, summed over the frames, DN^2.
    pub power: Vec<f64>,
    /// Mean of each column, DN.
    pub columns_dn: Vec<f64>,
    /// Mean of each row, DN.
    pub rows_dn: Vec<f64>,
    /// Spatial variance of the pixels' means, DN^2.
    pub spatial_var_dn2: f64,
    /// Sums of the requested additional statistics, in their order, over the degrees of freedom.
    pub extra: Vec<Vec<f64>>,
    /// Mean positions of the pixels' means, sorted and grouped into the shares [`PLACES`], in standard
    /// deviations from their mean; residual noise of the means is included.
    pub places: [f64; PLACES.len()],
}

/// Rows of one frame: unit of vectorised work.
struct Rows<'a, 'b> {
    pass: &'a mut Pass<'b>,
    frame: &'a [u16],
    frame_mean: f32,
}

impl pulp::NullaryFnOnce for Rows<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Pass { layout, frame_means, mean, now, sums, successive, .. } = self.pass;
        let n = frame_means.frames() as f32 + 1.0;
        let (share, root) = (1.0 / n, ((n - 1.0) / n).sqrt());
        let columns = layout.columns();
        let mut row = vec![0f32; columns];
        for (y, codes) in self.frame.chunks_exact(columns).enumerate() {
            let at = y * columns;
            let places =
                mean[at..][..columns].iter_mut().zip(&mut now[at..][..columns]).zip(&layout.mask[at..]);
            for (((mean, now), used), (&code, row)) in places.zip(codes.iter().zip(&mut row)) {
                let value = (f32::from(code) - self.frame_mean) * used;
                let off = value - *mean;
                *row = value;
                *now = off * root;
                *mean += off * share;
            }
            successive.row(at, &row, n == 1.0);
            if n > 1.0 {
                sums.row(y, now, layout);
            }
        }
    }
}

impl<'a> Pass<'a> {
    /// Creates an empty pass.
    pub fn new(layout: &'a Layout) -> Self {
        Self::with(layout, &[])
    }

    /// Creates an empty pass with additional statistics.
    pub fn with(layout: &'a Layout, extra: &[&'static dyn Extra]) -> Self {
        let pixels = layout.mask.len();
        Self {
            layout,
            frame_means: FrameMeans::default(),
            mean: vec![0.0; pixels],
            now: vec![0.0; pixels],
            sums: Sums {
                variance: Variance::new(pixels),
                covariance: Covariance::new(layout.shape),
                lines: Lines::new(layout.shape),
                power: Power::new(layout.shape),
                extra: extra.iter().map(|e| (*e, vec![0.0; e.size(layout)])).collect(),
            },
            successive: Successive::new(pixels),
            occupancy: Occupancy::new(layout.full_scale_dn),
            masked: layout.mask.iter().enumerate().filter(|(_, m)| **m == 0.0).map(|(i, _)| i).collect(),
            powers: None,
        }
    }

    /// Turns the sums of third and fourth powers of single pixels on or off for the following frames.
    pub fn of_single_pixels(&mut self, wanted: bool) {
        self.powers = wanted.then(|| Powers::new(self.mean.len()));
    }

    /// Adds the next frame: (rows * columns) codes in DN, row by row.
    ///
    /// # Errors
    ///
    /// If a frame differs in size from the layout.
    pub fn add(&mut self, frame: &[u16]) -> Result<(), SizeMismatch> {
        let expected = self.mean.len();
        if frame.len() != expected {
            return Err(SizeMismatch { expected, found: frame.len() });
        }
        let arch = pulp::Arch::new();
        let total = arch.dispatch(Total { frame, mask: &self.layout.mask });
        let frame_mean = total / self.layout.pixels;
        self.occupancy.add(frame);
        self.masked.iter().for_each(|i| self.occupancy.take_off(frame[*i]));
        arch.dispatch(Rows { frame, frame_mean: frame_mean as f32, pass: self });
        if self.frame_means.frames() > 0 {
            self.sums.end(&self.now, self.layout);
            if let Some(powers) = &mut self.powers {
                powers.add(self.frame_means.frames(), &self.now, self.sums.variance.squares());
            }
        }
        // Uses the mean as it was subtracted, so that the two add up.
        self.frame_means.add(frame_mean);
        Ok(())
    }

    /// Sums of powers of every pixel's deviations, and its mean less that of the frames, DN; `None` if not
    /// requested.
    pub fn single_pixels(&self) -> Option<(Powers, Vec<f32>)> {
        Some((self.powers.clone()?, self.mean.clone()))
    }

    /// Merges the frames that follow, accumulated elsewhere under the same layout.
    pub fn merge(&mut self, later: &Self) {
        if later.frame_means.frames() == 0 {
            return;
        }
        if self.frame_means.frames() == 0 {
            self.mean.copy_from_slice(&later.mean);
            self.powers.clone_from(&later.powers);
            self.successive = later.successive.clone();
        } else {
            let (a, b) = (self.frame_means.frames() as f32, later.frame_means.frames() as f32);
            let (share, root) = (b / (a + b), (a * b / (a + b)).sqrt());
            if let (Some(own), Some(more)) = (&mut self.powers, &later.powers) {
                let squares = [&self.sums, &later.sums].map(|s| s.variance.squares());
                let off = later.mean.iter().zip(&self.mean).map(|(l, m)| l - m);
                own.merge(more, squares, [a, b], off);
            }
            for ((m, l), now) in self.mean.iter_mut().zip(&later.mean).zip(&mut self.now) {
                let off = l - *m;
                *now = off * root;
                *m += off * share;
            }
            for y in 0..self.layout.shape.0 {
                self.sums.row(y, &self.now, self.layout);
            }
            self.sums.end(&self.now, self.layout);
            self.successive.merge(&later.successive);
        }
        self.sums.absorb(&later.sums);
        self.occupancy.merge(&later.occupancy);
        self.frame_means.merge(&later.frame_means);
    }

    /// Share of samples at full scale, of pixels in use.
    pub fn clipped(&self) -> f64 {
        self.occupancy.clipped()
    }

    /// Mean of all frames, DN.
    pub fn mean_dn(&self) -> f64 {
        self.frame_means.mean_dn()
    }

    /// Temporal variance of every pixel, DN^2: 0 for masked pixels, and for a single frame.
    pub fn variances_dn2(&self) -> Vec<f32> {
        let dof = (self.frame_means.frames() as f32 - 1.0).max(1.0);
        self.sums.variance.squares().iter().map(|s| s / dof).collect()
    }

    /// Discards all frames but keeps the memory for the next set.
    pub fn clear(&mut self) {
        self.frame_means.clear();
        self.mean.fill(0.0);
        self.sums.variance.clear();
        self.sums.covariance.clear();
        self.sums.lines = Lines::new(self.layout.shape);
        self.sums.power.clear();
        if let Some(powers) = &mut self.powers {
            powers.thirds.fill(0.0);
            powers.fourths.fill(0.0);
        }
        self.sums.extra.iter_mut().for_each(|(_, sums)| sums.fill(0.0));
        self.successive.clear();
        self.occupancy.0.fill(0);
    }

    /// Computes the mean of each group of sorted pixels, the lowest first, in standard deviations. A
    /// histogram is accurate enough and avoids sorting.
    fn places(&self, deviation: f64) -> [f64; PLACES.len()] {
        const BINS: usize = 512;
        let mut counts = [0u64; BINS];
        let scale = (BINS as f64 / 12.0 / deviation.max(f64::MIN_POSITIVE)) as f32;
        for (m, _) in self.mean.iter().zip(&self.layout.mask).filter(|(_, used)| **used > 0.0) {
            let bin = (m * scale + 0.5 * BINS as f32).clamp(0.0, (BINS - 1) as f32);
            counts[bin as usize] += 1;
        }
        let all = counts.iter().sum::<u64>().max(1) as f64;
        let mut out = [0.0; PLACES.len()];
        let (mut part, mut left) = (0, PLACES[0]);
        for (bin, n) in counts.iter().enumerate() {
            let place = (bin as f64 + 0.5 - 0.5 * BINS as f64) * 12.0 / BINS as f64;
            let mut share = *n as f64 / all;
            while share > 0.0 {
                let taken = if part + 1 < PLACES.len() { share.min(left) } else { share };
                out[part] += taken * place / PLACES[part];
                (share, left) = (share - taken, left - taken);
                if left <= 0.0 && part + 1 < PLACES.len() {
                    part += 1;
                    left = PLACES[part];
                }
            }
        }
        // The spread within a group is lost: 2 % of the standard deviation.
        let square: f64 = out.iter().zip(PLACES).map(|(x, share)| share * x * x).sum();
        out.map(|x| x / square.sqrt().max(0.5))
    }

    /// Returns the statistics; `None` for fewer than two frames.
    pub fn finish(&mut self) -> Option<Summary> {
        let frames = self.frame_means.frames() as usize;
        if frames < 2 {
            return None;
        }
        let (layout, dof) = (self.layout, frames as f64 - 1.0);
        let power = self.sums.power.finish();
        let variance = &self.sums.variance;
        let level = self.frame_means.mean_dn();
        let between = self.mean.iter().map(|m| f64::from(*m).powi(2)).sum::<f64>() / layout.pixels;
        let var = variance.finish(layout, dof);
        let places = self.places(between.sqrt());
        let (mut columns_dn, mut rows_dn) = (vec![0.0; layout.columns()], Vec::new());
        for row in self.mean.chunks_exact(layout.columns()) {
            columns_dn.iter_mut().zip(row).for_each(|(c, m)| *c += f64::from(*m));
            rows_dn.push(row.iter().map(|m| f64::from(*m)).sum::<f64>());
        }
        let means = |sums: &mut [f64], pixels: &[f32]| {
            sums.iter_mut().zip(pixels).for_each(|(sum, n)| *sum = level + *sum / f64::from(n.max(1.0)));
        };
        means(&mut columns_dn, &layout.column_pixels);
        means(&mut rows_dn, &layout.row_pixels);
        Some(Summary {
            frames,
            pixels: layout.pixels,
            var,
            covariances: self.sums.covariance.finish(&layout.pairs, dof),
            successive: self.successive.finish(layout, dof, variance.squares(), &self.mean),
            line_var_dn2: self.sums.lines.finish(layout, dof),
            unequal: variance.tails(layout, dof, |i| level + f64::from(self.mean[i])),
            power,
            occupancy: self.occupancy.clone(),
            frame_means: self.frame_means.clone(),
            columns_dn,
            rows_dn,
            places,
            extra: self.sums.extra.iter().map(|(_, sums)| sums.iter().map(|s| s / dof).collect()).collect(),
            // Means over few frames contain temporal noise.
            spatial_var_dn2: (between - var.value / frames as f64).max(0.0),
        })
    }
}

/// Sum of the codes of the pixels in use.
struct Total<'a> {
    frame: &'a [u16],
    mask: &'a [f32],
}

impl pulp::NullaryFnOnce for Total<'_> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        let mut total = 0.0;
        for (codes, mask) in self.frame.chunks(4096).zip(self.mask.chunks(4096)) {
            let mut lanes = [0f32; 32];
            for (codes, mask) in codes.chunks(32).zip(mask.chunks(32)) {
                for ((l, &d), m) in lanes.iter_mut().zip(codes).zip(mask) {
                    *l += f32::from(d) * m;
                }
            }
            total += lanes.iter().map(|l| f64::from(*l)).sum::<f64>();
        }
        total
    }
}

/// Computes all statistics of frames in memory, on all cores.
///
/// ```
/// use radcam::statistics::{layout::Layout, pass::collect};
/// let layout = Layout::new(&ndarray::Array2::from_elem((2, 2), true), 4095);
/// let summary = collect(&layout, &[&[10, 12, 9, 9], &[12, 10, 9, 9]])?.expect("two frames say something");
/// assert!((summary.var.value - 1.0).abs() < 1e-6); // two of four pixels have the variance 2
/// # Ok::<(), radcam::statistics::moments::SizeMismatch>(())
/// ```
///
/// # Errors
///
/// If a frame differs in size from the layout.
pub fn collect(layout: &Layout, frames: &[&[u16]]) -> Result<Option<Summary>, SizeMismatch> {
    collect_with(layout, frames, &mut Vec::new())
}

/// Runs [`collect`] with reused memory: one pass per core, created if missing. All passes must have this
/// layout.
///
/// # Errors
///
/// If a frame differs in size from the layout.
pub fn collect_with<'a>(
    layout: &'a Layout,
    frames: &[&[u16]],
    passes: &mut Vec<Pass<'a>>,
) -> Result<Option<Summary>, SizeMismatch> {
    let parts = rayon::current_num_threads().min(frames.len() / 2).max(1);
    passes.iter_mut().for_each(Pass::clear);
    passes.resize_with(parts, || Pass::new(layout));
    let size = frames.len().div_ceil(parts).max(1);
    passes
        .par_iter_mut()
        .zip(frames.par_chunks(size))
        .try_for_each(|(pass, part)| part.iter().try_for_each(|f| pass.add(f)))?;
    let Some((first, rest)) = passes.split_first_mut() else { return Ok(None) };
    rest.iter().for_each(|later| first.merge(later));
    Ok(first.finish())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::covariance::LAGS;
    use ndarray::Array2;
    use radcam_sim::rng::{PixelRng, Stream};

    const SHAPE: (usize, usize) = (64, 96);

    fn frames(n: u64, noise: impl Fn(u64, usize, usize) -> f64) -> Vec<Vec<u16>> {
        let at = |i: usize| (i / SHAPE.1, i % SHAPE.1);
        let value = |f, (y, x)| (1000.0 + y as f64 + 2.0 * x as f64 + noise(f, y, x)).round() as u16;
        (0..n).map(|f| (0..SHAPE.0 * SHAPE.1).map(|i| value(f, at(i))).collect()).collect()
    }

    fn normal(f: u64, i: usize) -> f64 {
        PixelRng::new(3, Stream::Frame, f, i as u32, 0).normal()
    }

    fn refs(frames: &[Vec<u16>]) -> Vec<&[u16]> {
        frames.iter().map(Vec::as_slice).collect()
    }

    fn all() -> Layout {
        Layout::new(&Array2::from_elem(SHAPE, true), 4095)
    }

    /// Sums of fourth powers about the mean agree with their definition, in one pass and merged from two,
    /// within the precision of 32-bit sums.
    #[test]
    fn fourth_powers_are_about_the_mean() {
        let layout = all();
        let images = frames(9, |f, y, x| 10.0 * normal(f, y * 96 + x));
        let pass = |of: &[Vec<u16>]| {
            let mut pass = Pass::new(&layout);
            pass.of_single_pixels(true);
            of.iter().for_each(|f| pass.add(f).unwrap());
            pass
        };
        let whole = pass(&images);
        let mut merged = pass(&images[..4]);
        merged.merge(&pass(&images[4..]));
        let offs: Vec<f64> =
            images.iter().map(|f| f.iter().map(|v| f64::from(*v)).sum::<f64>() / f.len() as f64).collect();
        for i in (0..whole.mean.len()).step_by(37) {
            let own: Vec<f64> = images.iter().zip(&offs).map(|(f, off)| f64::from(f[i]) - off).collect();
            let mean = own.iter().sum::<f64>() / own.len() as f64;
            let known: f64 = own.iter().map(|v| (v - mean).powi(4)).sum();
            for found in [&whole, &merged].map(|p| f64::from(p.single_pixels().unwrap().0.fourths[i])) {
                assert!((found / known - 1.0).abs() < 1e-3, "{found}, not {known}");
            }
        }
    }

    /// White noise of 100 DN^2 under shading: every statistic is recovered, and the stated errors hold over
    /// 1000 runs.
    #[test]
    fn errors_cover_the_truth() {
        let layout = all();
        let mut squares = std::collections::BTreeMap::<String, Vec<f64>>::new();
        for run in 0..1000u64 {
            let images = frames(4, |f, y, x| 10.0 * normal(100 * run + f, y * 96 + x));
            let summary = collect(&layout, &refs(&images)).unwrap().unwrap();
            let truth = 100.0 + 1.0 / 12.0;
            let mut add = |name: &str, v: Value, t: f64| {
                squares.entry(name.into()).or_default().push(((v.value - t) / v.std_err).powi(2));
            };
            add("variance", summary.var, truth);
            summary.covariances.at.iter().for_each(|c| add("covariance", *c, 0.0));
            add("successive", summary.successive, 0.0);
            summary.covariances.growth.iter().for_each(|g| add("growth", *g, 0.0));
            summary.covariances.parity.iter().for_each(|p| add("parity", *p, 0.0));
            add("unequal", summary.unequal, 0.0);
            for (v, width) in summary.line_var_dn2.into_iter().zip([96.0, 64.0]) {
                let lines = SHAPE.0 as f64 * SHAPE.1 as f64 / width;
                let std_err = truth / width * (2.0f64 / (3.0 * lines)).sqrt();
                add("lines", Value { value: v, std_err }, truth / width * (1.0 - 1.0 / lines));
            }
        }
        for (name, z2) in squares {
            let n = z2.len() as f64;
            let mean = z2.iter().sum::<f64>() / n;
            // The square of Student's t with about 60 degrees of freedom has mean 1.03 and variance 2.2;
            // tolerance four standard errors. Values of one run share their pixels.
            let runs = n.min(2000.0);
            assert!((mean - 1.03).abs() < 4.0 * (2.2 / runs).sqrt(), "{name}: {mean} of {n}");
        }
    }

    /// Merged parts, with masked pixels, agree with a single pass and with the definition.
    #[test]
    fn any_split_says_the_same() {
        let used = Array2::from_shape_fn(SHAPE, |(y, x)| (y * 7 + x * 3) % 11 != 0 && y != 20);
        let layout = Layout::new(&used, 4095);
        let images = frames(11, |f, y, x| 6.0 * normal(f, y * 96 + x) + 2.0 * normal(900 + f, y) + f as f64);
        let whole = {
            let mut pass = Pass::new(&layout);
            // Reuses memory.
            images[3..6].iter().for_each(|f| pass.add(f).unwrap());
            pass.clear();
            images.iter().for_each(|f| pass.add(f).unwrap());
            pass.finish().unwrap()
        };
        for splits in [vec![1], vec![4], vec![2, 3, 9], vec![0, 10]] {
            let mut sum = Pass::new(&layout);
            let mut from = 0;
            for to in splits.into_iter().chain([11]) {
                let mut part = Pass::new(&layout);
                images[from..to].iter().for_each(|f| part.add(f).unwrap());
                sum.merge(&part);
                from = to;
            }
            let summary = sum.finish().unwrap();
            let close = |a: f64, b: f64, unit: f64| assert!((a - b).abs() < 2e-5 * unit, "{a} {b}");
            let var = whole.var.value;
            close(summary.var.value, var, var);
            close(summary.successive.value, whole.successive.value, var);
            close(summary.unequal.value, whole.unequal.value, 1.0);
            close(summary.spatial_var_dn2, whole.spatial_var_dn2, whole.spatial_var_dn2);
            close(summary.frame_means.variance_dn2(), whole.frame_means.variance_dn2(), var);
            close(summary.frame_means.first_step_dn(), whole.frame_means.first_step_dn(), var);
            for k in 0..LAGS.len() {
                close(summary.covariances.at[k].value, whole.covariances.at[k].value, var);
            }
            for k in 0..2 {
                close(summary.line_var_dn2[k], whole.line_var_dn2[k], var);
                close(summary.covariances.growth[k].value, whole.covariances.growth[k].value, var);
                close(summary.covariances.parity[k].value, whole.covariances.parity[k].value, var);
            }
            let total: f64 = whole.power.iter().sum();
            close(summary.power.iter().sum(), total, total);
            assert_eq!(summary.occupancy, whole.occupancy);
        }
        // By definition: residuals of the two-way layout.
        let n = images.len() as f64;
        let marks: Vec<usize> = used.iter().enumerate().filter(|(_, u)| **u).map(|(i, _)| i).collect();
        let frame = |f: &[u16]| marks.iter().map(|&i| f64::from(f[i])).sum::<f64>() / marks.len() as f64;
        let frame_means: Vec<f64> = images.iter().map(|f| frame(f)).collect();
        let grand = frame_means.iter().sum::<f64>() / n;
        let r = |f: usize, i: usize| {
            let mean = images.iter().map(|g| f64::from(g[i])).sum::<f64>() / n;
            f64::from(images[f][i]) - mean - frame_means[f] + grand
        };
        let mut products = [(0.0, 0.0); 3];
        for &i in &marks {
            let partner = i + 96 - 1;
            let pair = i % 96 > 0 && partner < SHAPE.0 * SHAPE.1 && used.as_slice().unwrap()[partner];
            products[1].1 += f64::from(u8::from(pair)) * (n - 1.0);
            (products[0].1, products[2].1) = (products[0].1 + n - 1.0, products[2].1 + n - 1.0);
            for f in 0..images.len() {
                products[0].0 += r(f, i) * r(f, i);
                products[1].0 += if pair { r(f, i) * r(f, partner) } else { 0.0 };
                products[2].0 += r(f, i) * r(f, i) / n + if f > 0 { r(f, i) * r(f - 1, i) } else { 0.0 };
            }
        }
        let diagonal = LAGS.iter().position(|l| *l == (1, -1)).unwrap();
        let summary = [whole.var, whole.covariances.at[diagonal], whole.successive];
        for (summary, (sum, count)) in summary.iter().zip(products) {
            assert!(
                (summary.value - sum / count).abs() < 2e-5 * whole.var.value,
                "{summary:?} {}",
                sum / count
            );
        }
    }

    #[test]
    fn shared_noise_is_seen_where_it_is() {
        let layout = all();
        let images = frames(6, |f, y, x| 5.0 * normal(f, y * 96 + x) + 3.0 * normal(500 + f, y));
        let summary = collect(&layout, &refs(&images)).unwrap().unwrap();
        assert!((summary.line_var_dn2[0] - 9.0).abs() < 9.0 * 5.0 * (2.0f64 / 320.0).sqrt());
        assert!(summary.line_var_dn2[1] < 2.0);
        assert!(summary.covariances.at[0].value > 7.0 && summary.covariances.at[3].value.abs() < 2.5);
        assert!(collect(&layout, &refs(&images[..1])).unwrap().is_none());
        assert!(collect(&layout, &[&[0; 7], &[0; 7]]).is_err());
    }

    /// A sine of variance 8 in read-out order stands out at its frequency, with its power.
    #[test]
    fn a_line_has_its_power() {
        let layout = all();
        let images = frames(8, |f, y, x| {
            let phase = 3.0 * normal(700 + f, 1);
            4.0 * normal(f, y * 96 + x)
                + 4.0 * (std::f64::consts::TAU * 0.1234 * (y * 96 + x) as f64 + phase).sin()
        });
        let summary = collect(&layout, &refs(&images)).unwrap().unwrap();
        let n = SHAPE.0 * SHAPE.1;
        let top = (1..n / 2).max_by(|&a, &b| summary.power[a].total_cmp(&summary.power[b])).unwrap();
        assert_eq!(top, (0.1234 * n as f64).round() as usize);
        let around: f64 = summary.power[top - 3..=top + 3].iter().sum();
        // Seven degrees of freedom, of which one sine per frame; the floor is 7 x 16 x 7.
        let variance = (around - 784.0) / 7.0 * 2.0 / n as f64;
        assert!((variance - 8.0).abs() < 0.15 * 8.0, "{variance}");
    }
    /// Places of normal pixels agree with the table, for any noise.
    #[test]
    fn levels_lie_where_they_are() {
        const RUNS: u64 = 40;
        let layout = all();
        let mut found = [[0.0; RUNS as usize]; PLACES.len()];
        for run in 0..RUNS {
            let image = |f: u64| -> Vec<u16> {
                let value = |i| 1500.0 + 40.0 * normal(1000 + run, i) + 10.0 * normal(2000 + 4 * run + f, i);
                (0..SHAPE.0 * SHAPE.1).map(|i| value(i).round() as u16).collect()
            };
            let summary = collect(&layout, &refs(&[image(0), image(1)])).unwrap().unwrap();
            found.iter_mut().zip(summary.places).for_each(|(all, place)| all[run as usize] = place);
        }
        for (all, normal) in found.iter().zip(radcam_sim::predict::NORMAL) {
            let mean = all.iter().sum::<f64>() / RUNS as f64;
            let variance = all.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / (RUNS - 1) as f64;
            // Five standard errors, and a tenth of a bin of the histogram.
            let allowed = 5.0 * (variance / RUNS as f64).sqrt() + 0.0024;
            assert!((mean - normal).abs() < allowed, "{mean}, not {normal} within {allowed}");
        }
    }
}
