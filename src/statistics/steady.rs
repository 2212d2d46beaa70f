//! Persistence of pixel noise: covariance of the pixels' variances in different runs of frames.
//!
//! A pixel that jumps between two levels does so in every run. A rare large deviation hits another pixel each
//! time. Jumping pixels lie at random places; noisy pixels side by side, or in every second line, are parts
//! of the sensor.

use super::jackknife::{Blocks, Value};
use super::layout::Layout;
use super::powers::Powers;
use radcam_sim::rng::{PixelRng, Stream};
use std::collections::BTreeMap;

/// Deviations of the pixels' variances from their mean, summed over runs of frames.
#[derive(Debug, Clone)]
pub struct Steady {
    /// Sums over the first, third, ... run, and over the others.
    sums: [Vec<f32>; 2],
    squares: Vec<f32>,
    runs: usize,
    /// Degrees of freedom of all runs, and the sum of the runs' means, DN^2.
    dof: f64,
    mean_dn2: f64,
    /// Sums of squares and of fourth powers of every pixel's deviations in both halves, and their degrees of
    /// freedom.
    halves: [Half; 2],
}

/// Frames of one half.
#[derive(Debug, Clone, Default)]
struct Half {
    /// Sums over the groups of every pixel's squares about its group mean, and of [`above_bound`].
    squares: Vec<f64>,
    above_bound: Vec<f64>,
    dof: f64,
    /// Number of frames of each group in the sums.
    runs: Vec<u64>,
    /// Groups that later runs of the same exposure may join.
    open: Vec<Group>,
    /// Lowest mean of a run, DN.
    level_dn: f64,
    /// Mean variance of the pixels in the first group, DN^2.
    first_dn2: Option<f64>,
}

/// Runs of frames of one exposure, about their common mean: a pixel that stays on one level for a run jumps
/// from run to run.
#[derive(Debug, Clone)]
pub struct Group {
    /// Exposure, s.
    pub exposure_s: f64,
    /// Number of frames.
    pub frames: u64,
    /// Mean of the frames, DN.
    pub level_dn: f64,
    /// Mean of every pixel minus the mean of the frames, DN.
    pub mean_dn: Vec<f32>,
    /// Sums of squares, DN^2.
    pub squares: Vec<f32>,
    /// Sums of higher powers.
    pub powers: Powers,
}

impl Group {
    fn merge(&mut self, later: &Self) {
        let [a, b] = [self.frames as f32, later.frames as f32];
        let off = || later.mean_dn.iter().zip(&self.mean_dn).map(|(l, m)| l - m);
        self.powers.merge(&later.powers, [&self.squares, &later.squares], [a, b], off());
        for ((s, more), (m, l)) in
            self.squares.iter_mut().zip(&later.squares).zip(self.mean_dn.iter_mut().zip(&later.mean_dn))
        {
            let off = l - *m;
            *s += more + off * off * a * b / (a + b);
            *m += off * b / (a + b);
        }
        self.frames += later.frames;
    }
}

/// Maximum pixels of all open groups together (a named choice: 16 MB for each kind of sum).
const OPEN_PIXELS: usize = 1 << 22;
/// Maximum number of open groups (a named choice: exposures at which darks are repeated).
const OPEN: usize = 8;

impl Half {
    /// Adds a run.
    fn add(&mut self, run: Group) {
        let first = self.runs.is_empty() && self.open.is_empty();
        self.level_dn = if first { run.level_dn } else { run.level_dn.min(self.level_dn) };
        let pixels = run.squares.len().max(1);
        if let Some(group) = self.open.iter_mut().find(|g| g.exposure_s == run.exposure_s) {
            group.merge(&run);
        } else if self.open.len() < (OPEN_PIXELS / pixels).min(OPEN) {
            self.open.push(run);
        } else {
            self.close(&run);
        }
    }

    /// Adds a group to the sums, in units of the noise of the first: shot noise of dark charge grows with the
    /// exposure. Two frames tell nothing of the kurtosis.
    fn close(&mut self, group: &Group) {
        if group.frames < 3 {
            return;
        }
        let mean: f64 = group.squares.iter().map(|s| f64::from(*s)).sum();
        let variance_dn2 = mean / (group.frames as f64 - 1.0) / group.squares.len().max(1) as f64;
        let first_dn2 = *self.first_dn2.get_or_insert(variance_dn2);
        let scale = if variance_dn2 > 0.0 { first_dn2 / variance_dn2 } else { 1.0 };
        self.runs.push(group.frames);
        self.dof += group.frames as f64 - 1.0;
        self.squares.resize(group.squares.len(), 0.0);
        self.above_bound.resize(group.squares.len(), 0.0);
        let powers = group.powers.thirds.iter().zip(&group.powers.fourths);
        let sums = self.squares.iter_mut().zip(&mut self.above_bound);
        for ((square_sum, above_sum), (square, (third, fourth))) in sums.zip(group.squares.iter().zip(powers))
        {
            let powers = [*square, *third, *fourth].map(f64::from);
            *square_sum += scale * powers[0];
            *above_sum += scale * scale * above_bound(powers, group.frames as f64);
        }
    }

    fn close_all(&mut self) {
        std::mem::take(&mut self.open).iter().for_each(|g| self.close(g));
    }
}

/// Computes the kurtosis above Pearson's bound, times S^2 / n: Q - T^2 / S - S^2 / n of the sums of squares
/// S, third powers T and fourth powers Q of n deviations from their mean.
///
/// The bound, kurtosis >= skewness^2 + 1, is reached by two-valued numbers of any proportion (Pearson 1916,
/// Phil. Trans. A 216, 429).
fn above_bound([square, third, fourth]: [f64; 3], n: f64) -> f64 {
    if square > 0.0 { (fourth - third * third / square - square * square / n).max(0.0) } else { 0.0 }
}

/// Mean of [`above_bound`] for normal noise of variance 1: E Q = 3 (n - 1)^2 / n, E S^2 = n^2 - 1, and a mean
/// squared skewness of 6 (n - 2) / (n + 1) (n + 3) (Fisher 1930), independent of S (Basu 1955).
fn mean_of_normal(n: f64) -> f64 {
    let square = (n * n - 1.0) / n;
    let skewness = 6.0 * (n - 2.0).max(0.0) / ((n + 1.0) * (n + 3.0));
    (3.0 * (n - 1.0).powi(2) / n - (skewness + 1.0) * square).max(0.0)
}

/// Mean square of [`above_bound`] over S^2 for normal noise, by Monte Carlo.
fn mean_square_of_normal(frames: u64) -> f64 {
    let draws = (DRAWN_NUMBERS / frames.max(1)).clamp(MIN_DRAWS, DRAWN_NUMBERS);
    let mut rng = PixelRng::new(0, Stream::Effect, frames, 0, 0);
    let mut values = vec![0.0; frames as usize];
    let mut sum = 0.0;
    for _ in 0..draws {
        values.fill_with(|| rng.normal());
        let mean = values.iter().sum::<f64>() / frames as f64;
        let powers = [2, 3, 4].map(|k| values.iter().map(|v| (v - mean).powi(k)).sum::<f64>());
        sum += (above_bound(powers, frames as f64) / powers[0].powi(2)).powi(2);
    }
    sum / draws as f64
}

/// Random normal numbers per Monte Carlo mean, and minimum draws (named choices: errors of a few per cent).
const DRAWN_NUMBERS: u64 = 40_000;
const MIN_DRAWS: u64 = 400;

impl Half {
    /// Kurtosis of a pixel above Pearson's bound, relative to that of normal noise, minus 1: 0 for normal
    /// noise of any size, -1 for two levels without other noise. `None` if all runs are shorter than three
    /// frames.
    ///
    /// The ratio to S^2 is independent of S (Basu 1955), so pixels may be selected by S. With d degrees of
    /// freedom E S^2 = d (d + 2).
    fn levels(&self) -> Option<impl Fn(usize) -> f64> {
        let normal: f64 = self.runs.iter().map(|n| mean_of_normal(*n as f64)).sum();
        let scale = self.dof * (self.dof + 2.0) / normal;
        let of = move |i: usize| scale * self.above_bound[i] / (self.squares[i] * self.squares[i]) - 1.0;
        (normal > 0.0).then_some(of)
    }

    /// Variance of [`Self::levels`] for normal noise, with E S^4 = (n - 1) (n + 1) (n + 3) (n + 5) and
    /// independent runs.
    fn variance(&self) -> f64 {
        let d = self.dof;
        let mut known: BTreeMap<u64, f64> = BTreeMap::new();
        let mut of_square = |frames: u64| {
            let n = frames as f64;
            let one = *known.entry(frames).or_insert_with(|| mean_square_of_normal(frames));
            one * (n - 1.0) * (n + 1.0) * (n + 3.0) * (n + 5.0) - mean_of_normal(n).powi(2)
        };
        let normal: f64 = self.runs.iter().map(|n| mean_of_normal(*n as f64)).sum();
        let square = normal * normal + self.runs.iter().map(|n| of_square(*n)).sum::<f64>();
        let ratio = square / (d * (d + 2.0) * (d + 4.0) * (d + 6.0)) * (d * (d + 2.0) / normal).powi(2);
        (ratio - 1.0).max(0.0)
    }
}

/// Kurtosis of a group of pixels above Pearson's bound.
#[derive(Debug, Clone, Copy)]
pub struct Levels {
    /// Relative to that of normal noise, minus 1; mean over the pixels.
    pub excess: Value,
    /// Number of pixels.
    pub pixels: f64,
}

/// Shares of the pixels, the noisiest first, that are examined besides those that stand out.
const NOISIEST: [f64; 2] = [0.01, 0.05];
/// Minimum pixels and degrees of freedom of this statistic.
const PIXELS: f64 = 4.0;
const DOF: f64 = 3.0;
/// Minimum variance of a pixel that covers more than two codes, DN^2: 1/12 and 0.56 DN of noise, which
/// rounding changes by 2 exp(-2 pi^2 0.32) = 0.004 (Widrow and Kollar 2008, ch. 4).
pub const LEAST_DN2: f64 = 0.4;
/// Standard deviations of a pixel's noise within which code 0 clips it.
pub const REACH: f64 = 3.0;
/// Minimum distance of pixels that stand out, in standard deviations of the ordinary pixels' log variances.
const STANDS_OUT: f64 = 3.5;

/// Distribution of the noise variances of single pixels, as estimated from many frames of the same kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelNoise {
    /// Variance of the pixels' variances, over the square of their mean.
    pub spread: f64,
    /// Third and fourth central moment, over the spread to the power 3/2 and 2.
    pub skewness: f64,
    /// See `skewness`.
    pub kurtosis: f64,
    /// Largest variance of a pixel over the mean of all.
    pub largest: f64,
    /// Median of the pixels' standard deviations over their root mean square.
    pub median: f64,
    /// Mean of the pixels' variances, DN^2; NaN if not estimated from frames.
    pub mean_dn2: f64,
    /// Standard deviation of the ordinary pixels' log standard deviations; NaN if there are too few frames.
    pub log_spread: f64,
    /// Share of the pixels that are noisier than the spread of the ordinary ones explains; NaN as
    /// `log_spread`.
    pub noisy: f64,
}

impl PixelNoise {
    /// Creates lognormal variances with this relative variance (Johnson, Kotz and Balakrishnan 1994, ch. 14).
    pub fn lognormal(spread: f64) -> Self {
        let w = 1.0 + spread.max(1e-9);
        Self {
            spread,
            skewness: (w + 2.0) * (w - 1.0).sqrt(),
            kurtosis: w.powi(4) + 2.0 * w.powi(3) + 3.0 * w * w - 3.0,
            // The farthest of about ten thousand pixels lies four standard deviations off.
            largest: (4.0 * w.ln().sqrt()).exp(),
            median: w.powf(-0.25),
            mean_dn2: f64::NAN,
            log_spread: 0.5 * w.ln().sqrt(),
            noisy: 0.0,
        }
    }

    /// Returns the default distribution for a sensor whose darks do not determine it: lognormal, or one pixel
    /// in three hundred with most of the spread, whichever has heavier tails.
    pub fn usual(spread: f64) -> Self {
        let of = Self::lognormal(spread);
        let noisy: f64 = 300.0;
        let largest = of.largest.max(4.0 * (noisy * spread.max(0.0)).sqrt());
        Self { skewness: of.skewness.max(noisy.sqrt()), kurtosis: of.kurtosis.max(noisy), largest, ..of }
    }

    /// Largest variance of a pixel over the mean, at relative variance `spread` and with the same shape.
    pub fn largest(&self, spread: f64) -> f64 {
        1.0 + (self.largest - 1.0).max(0.0) * (spread.max(0.0) / self.spread.max(1e-6)).sqrt().min(1.0)
    }

    /// Raw second, third and fourth moment of variances of mean 1 and relative variance `spread`, with the
    /// same shape.
    pub fn moments(&self, spread: f64) -> [f64; 3] {
        let root = spread.max(0.0).sqrt();
        let (two, three, four) =
            (spread.max(0.0), self.skewness * root.powi(3), self.kurtosis.max(1.0) * root.powi(4));
        [1.0 + two, 1.0 + 3.0 * two + three, 1.0 + 6.0 * two + 4.0 * three + four]
    }
}

/// Estimates the variance of the noisiest of n pixels over the mean, from its sample variance v (relative to
/// the mean) with 2 / a degrees of freedom. Few frames make the largest of many seem larger, by two and a
/// half deviations of chi-square. A pixel far beyond the expected maximum of n equal pixels is as noisy as it
/// looks, less that (Wilson and Hilferty 1931).
fn of_largest(v: f64, a: f64, n: f64) -> f64 {
    let quantile = |z: f64| (1.0 - a / 9.0 + z * (a / 9.0).sqrt()).powi(3);
    // Value that one of n normal numbers exceeds (Cramer 1946, 28.6, to first order).
    let most = (2.0 * n.max(2.0).ln()).sqrt();
    (v / quantile(2.5)).max(v - quantile(most))
}

/// Upper quartile of a standard normal number.
const QUARTILE: f64 = 0.674_489_750_196_081_7;
/// Minimum distance of a noisy pixel, in standard deviations of the ordinary pixels' log variances: one in a
/// million by chance.
const NOISY: f64 = 4.8;
/// Minimum degrees of freedom to tell single pixels apart, and to estimate moments.
const TOLD: f64 = 6.0;
const FEWEST: f64 = 2.0;

impl Steady {
    /// Creates an accumulator for frames of this number of pixels.
    pub fn new(pixels: usize) -> Self {
        Self {
            sums: [vec![0.0; pixels], vec![0.0; pixels]],
            squares: vec![0.0; pixels],
            runs: 0,
            dof: 0.0,
            mean_dn2: 0.0,
            halves: Default::default(),
        }
    }

    /// Adds a run of `frames` frames: the variance of every pixel (0 if masked) and their mean, DN^2.
    pub fn add(&mut self, var_dn2: &[f32], mean_dn2: f64, frames: usize) {
        self.dof += frames as f64 - 1.0;
        self.mean_dn2 += mean_dn2;
        let sum = &mut self.sums[self.runs % 2];
        for ((sum, square), v) in sum.iter_mut().zip(&mut self.squares).zip(var_dn2) {
            let off = v - mean_dn2 as f32;
            *sum += off;
            *square += off * off;
        }
        self.runs += 1;
    }

    /// Adds a run of frames of one half for [`Self::levels`].
    pub fn add_run(&mut self, half: usize, run: Group) {
        self.halves[half].add(run);
    }

    /// Kurtosis above Pearson's bound of the pixels that stand out, the noisiest hundredth and the noisiest
    /// twentieth, for each half; `None` for too few pixels. Pixels whose noise reaches code 0 or covers only
    /// two codes are excluded, since clipping and rounding change it.
    pub fn levels(&mut self, layout: &Layout) -> [[Option<Levels>; 3]; 2] {
        self.halves.iter_mut().for_each(Half::close_all);
        [0, 1].map(|half| self.levels_of(layout, half))
    }

    fn levels_of(&self, layout: &Layout, half: usize) -> [Option<Levels>; 3] {
        let own = &self.halves[half];
        if own.dof < DOF || own.squares.is_empty() {
            return [None; 3];
        }
        let Some(off) = own.levels() else { return [None; 3] };
        let total = |i: usize| self.halves.iter().filter_map(|h| h.squares.get(i)).sum::<f64>();
        let mut all: Vec<(f64, usize)> =
            (0..layout.mask.len()).filter(|i| layout.mask[*i] > 0.0).map(|i| (total(i), i)).collect();
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        let quantile =
            |share: f64| all[((share * all.len() as f64) as usize).min(all.len() - 1)].0.max(1e-12);
        let width = 0.5 * (quantile(0.25) / quantile(0.75)).ln() / QUARTILE;
        let limit = quantile(0.5) * (STANDS_OUT * width).exp();
        let stand_out = all.iter().take_while(|v| v.0 > limit).count();
        let [few, more] = NOISIEST.map(|share| (share * all.len() as f64) as usize);
        let variance = own.variance();
        let of = |count: usize| {
            let [least, largest] = [LEAST_DN2, (own.level_dn / REACH).powi(2)].map(|v| own.dof * v);
            let whole_noise = |i: &usize| own.squares[*i] > least && own.squares[*i] < largest;
            let chosen = all[..count].iter().map(|v| v.1).filter(whole_noise);
            let one = |(n, sum), i: usize| (n + 1.0, sum + off(i));
            let (pixels, sum) = chosen.fold((0.0, 0.0), one);
            Levels { excess: Value { value: sum / pixels, std_err: (variance / pixels).sqrt() }, pixels }
        };
        [stand_out, few, more].map(|count| Some(of(count)).filter(|l| l.pixels >= PIXELS))
    }

    /// Estimates the distribution of the single pixels' variances, corrected for the scatter of few frames;
    /// `None` for too few degrees of freedom.
    ///
    /// A sample variance of normal noise with d degrees of freedom has the raw moments s^2k prod(1 + 2 j /
    /// d), j < k (chi-square). Its logarithm has the variance trigamma(d / 2) (Bartlett and Kendall 1946),
    /// which is about 2 / (d - 1).
    pub fn distribution(&self, layout: &Layout) -> Option<PixelNoise> {
        if self.dof < FEWEST {
            return None;
        }
        let usual = self.mean_dn2 / self.runs as f64;
        let of = |i: usize| usual + f64::from(self.sums[0][i] + self.sums[1][i]) / self.runs as f64;
        let mut all: Vec<f64> =
            (0..layout.mask.len()).filter(|i| layout.mask[*i] > 0.0).map(|i| of(i).max(0.0)).collect();
        let n = all.len() as f64;
        let mean = all.iter().sum::<f64>() / n;
        if mean <= 0.0 || n < 64.0 {
            return None;
        }
        all.iter_mut().for_each(|v| *v /= mean);
        let a = 2.0 / self.dof;
        let raw = |k: i32| all.iter().map(|v| v.powi(k)).sum::<f64>() / n;
        let two = raw(2) / (1.0 + a);
        let three = raw(3) / ((1.0 + a) * (1.0 + 2.0 * a));
        let four = raw(4) / ((1.0 + a) * (1.0 + 2.0 * a) * (1.0 + 3.0 * a));
        let spread = two - 1.0;
        all.sort_by(f64::total_cmp);
        let quantile = |share: f64| all[((share * n) as usize).min(all.len() - 1)].max(1e-6);
        // Median of chi-square over its degrees of freedom (Wilson and Hilferty 1931).
        let median_of_few = (1.0 - a / 9.0).powi(3);
        let width = 0.5 * (quantile(0.75) / quantile(0.25)).ln() / QUARTILE;
        let by_chance = 2.0 / (self.dof - 1.0).max(1.0);
        let log_variance = (width * width - by_chance).max(0.0);
        let limit = quantile(0.5) * (NOISY * width).exp();
        let noisy = all.iter().filter(|v| **v > limit).count() as f64 / n;
        let told = spread > 3.0 * (2.0 * a * a / (1.0 + a) / n).sqrt();
        let moments = |of: f64, power: f64| if told { of / spread.powf(power) } else { f64::NAN };
        let (third, fourth) = (three - 3.0 * two + 2.0, four - 4.0 * three + 6.0 * two - 3.0);
        let usual = PixelNoise::usual(spread.max(0.0));
        let (skewness, kurtosis) = (moments(third, 1.5), moments(fourth, 2.0));
        Some(PixelNoise {
            spread,
            skewness: if skewness.is_finite() { skewness.max(0.0) } else { usual.skewness },
            kurtosis: if kurtosis.is_finite() { kurtosis.max(1.0) } else { usual.kurtosis },
            largest: all.last().map_or(1.0, |v| of_largest(*v, a, n)).max(1.0),
            median: (quantile(0.5) / median_of_few).sqrt(),
            mean_dn2: mean,
            log_spread: if self.dof < TOLD { f64::NAN } else { 0.5 * log_variance.sqrt() },
            noisy: if self.dof < TOLD { f64::NAN } else { noisy },
        })
    }

    /// Covariance of the pixels' variances in two runs, DN^4, as the mean over all pairs of runs and all
    /// pixels; `None` for fewer than two runs. For equal pixels it is 0 within its error.
    pub fn covariance(&self, layout: &Layout) -> Option<Value> {
        let runs = self.runs as f64;
        let mut blocks = Blocks::default();
        // The sum over all pairs is the square of the sum minus the sum of the squares.
        let pairs = |i: usize| {
            let sum = f64::from(self.sums[0][i]) + f64::from(self.sums[1][i]);
            let square = f64::from(self.squares[i]);
            f64::from(layout.mask[i]) * (sum * sum - square) / (runs * (runs - 1.0))
        };
        layout.runs(|run, count, block| blocks.add(block, run.map(pairs).sum(), count));
        (self.runs > 1).then(|| blocks.value())
    }

    /// Covariance of a pixel's variance in one run with that of the pixel two columns on, and two rows on, in
    /// another run, DN^4; `None` for fewer than two runs. A distance of two also shows patterns of every
    /// second line. For noisy pixels at random places it is 0 within its error.
    pub fn of_neighbours(&self, layout: &Layout) -> Option<[Value; 2]> {
        if self.runs < 2 {
            return None;
        }
        let columns = layout.columns();
        let pairs = (self.runs.div_ceil(2) * (self.runs / 2)) as f64;
        let [a, b] = &self.sums;
        let of = |apart: usize, last_column: usize| {
            let mut blocks = Blocks::default();
            layout.runs(|run, _, block| {
                let (mut sum, mut count) = (0.0, 0.0);
                for i in run.filter(|i| i % columns < last_column && i + apart < layout.mask.len()) {
                    let j = i + apart;
                    let both = f64::from(layout.mask[i] * layout.mask[j]);
                    let products = f64::from(a[i]) * f64::from(b[j]) + f64::from(a[j]) * f64::from(b[i]);
                    sum += both * 0.5 * products / pairs;
                    count += both;
                }
                if count > 0.0 {
                    blocks.add(block, sum, count);
                }
            });
            blocks.value()
        };
        Some([of(2, columns.saturating_sub(2)), of(2 * columns, columns)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    /// 200 campaigns of four runs. Noisy pixels at random places give 0 within five standard errors of the
    /// mean, and the stated errors cover the scatter. Every second column, and the right half, are detected.
    #[test]
    fn parts_of_the_sensor_are_no_single_pixels() {
        let (side, campaigns) = (32usize, 200u32);
        let layout = Layout::new(&Array2::from_elem((side, side), true), 4095);
        let of = |noisy: fn(usize, usize) -> bool, campaign: u32| {
            let mut steady = Steady::new(side * side);
            let mut rng = PixelRng::new(19, Stream::Effect, 0, campaign, 0);
            for _ in 0..4 {
                let var = |i: usize| {
                    let chi2: f64 = (0..4).map(|_| rng.normal().powi(2)).sum();
                    (chi2 / 4.0 * if noisy(i / 32, i % 32) { 2.0 } else { 1.0 }) as f32
                };
                let var: Vec<f32> = (0..side * side).map(var).collect();
                let mean = var.iter().map(|v| f64::from(*v)).sum::<f64>() / var.len() as f64;
                steady.add(&var, mean, 5);
            }
            steady.of_neighbours(&layout).unwrap()
        };
        type Noisy = fn(usize, usize) -> bool;
        let anywhere: Noisy =
            |y, x| PixelRng::new(4, Stream::Effect, 1, (32 * y + x) as u32, 0).uniform() < 0.25;
        let cases: [(Noisy, [f64; 2]); 3] = [
            (anywhere, [0.0, 0.0]),
            (|_, x| x % 2 == 1, [0.25, 0.25]),
            // Pairs of columns across the middle are unequal: 2 of 30.
            (|_, x| x >= 16, [0.25 * (1.0 - 2.0 * 2.0 / 30.0), 0.25]),
        ];
        for (noisy, expected) in cases {
            let all: Vec<[Value; 2]> = (0..campaigns).map(|c| of(noisy, c)).collect();
            for (k, expected) in expected.into_iter().enumerate() {
                let n = f64::from(campaigns);
                let mean = all.iter().map(|v| v[k].value).sum::<f64>() / n;
                let scatter =
                    (all.iter().map(|v| (v[k].value - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
                let by_chance = 0.02 * f64::from(u8::from(expected == 0.0));
                assert!(
                    (mean - expected).abs() < 5.0 * scatter / n.sqrt() + by_chance,
                    "{k}: {mean}, not {expected}"
                );
                let stated = (all.iter().map(|v| v[k].std_err.powi(2)).sum::<f64>() / n).sqrt();
                assert!(stated > 0.75 * scatter, "{k}: {stated}, scatter {scatter}");
            }
        }
    }

    /// Builds a run of frames as a pass sums it up.
    fn run(exposure_s: f64, frames: usize, mut pixel: impl FnMut(usize) -> Vec<f64>, pixels: usize) -> Group {
        let mut out = Group {
            exposure_s,
            frames: frames as u64,
            level_dn: 100.0,
            mean_dn: Vec::new(),
            squares: Vec::new(),
            powers: Powers::default(),
        };
        for i in 0..pixels {
            let all = pixel(i);
            let mean = all.iter().sum::<f64>() / frames as f64;
            let power = |k| all.iter().map(|x| (x - mean).powi(k)).sum::<f64>() as f32;
            out.mean_dn.push(mean as f32);
            out.squares.push(power(2));
            out.powers.thirds.push(power(3));
            out.powers.fourths.push(power(4));
        }
        out
    }

    /// Noise of the pixels that stand out.
    #[derive(Clone, Copy, PartialEq)]
    enum Noise {
        Normal,
        /// Two levels, with jumps in any frame.
        Jumps,
        /// A level that persists for a run.
        Stays,
    }

    /// 200 campaigns of two halves of two runs, of one exposure and of two. Noisy pixels with normal noise
    /// have an excess of 0 within the stated errors. Jumping pixels have nearly -1, in runs of three frames
    /// and in long ones, and over many runs also if a level persists for a run.
    #[test]
    fn noisy_pixels_and_two_levels_are_told_apart() {
        let (side, campaigns) = (32usize, 200u32);
        let layout = Layout::new(&Array2::from_elem((side, side), true), 4095);
        let of = |noise: Noise, frames: usize, runs: usize, apart: bool, campaign: u32| {
            let mut steady = Steady::new(side * side);
            let mut rng = PixelRng::new(23, Stream::Effect, 0, campaign, 0);
            for k in 0..2 * runs {
                let one = |i: usize| -> Vec<f64> {
                    let mut sign = || if rng.uniform() < 0.5 { 1.0 } else { -1.0 };
                    let stays = sign();
                    let signs: Vec<f64> = (0..frames).map(|_| sign()).collect();
                    let at = |sign: f64, normal: f64| match (i.is_multiple_of(41), noise) {
                        (true, Noise::Jumps) => 8.0 * sign + normal,
                        (true, Noise::Stays) => 8.0 * stays + normal,
                        (true, Noise::Normal) => 8.0 * normal,
                        _ => normal,
                    };
                    signs.into_iter().map(|s| at(s, rng.normal())).collect()
                };
                let exposure_s = if apart { (k / 2) as f64 } else { 0.0 };
                steady.add_run(k % 2, run(exposure_s, frames, one, side * side));
            }
            steady.levels(&layout)[0][0].unwrap().excess
        };
        let of_all = |noise, frames, runs, apart| {
            let all: Vec<Value> = (0..campaigns).map(|c| of(noise, frames, runs, apart, c)).collect();
            let n = f64::from(campaigns);
            let mean = all.iter().map(|v| v.value).sum::<f64>() / n;
            let scatter = (all.iter().map(|v| (v.value - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
            let stated = (all.iter().map(|v| v.std_err.powi(2)).sum::<f64>() / n).sqrt();
            (mean, scatter, stated, n.sqrt())
        };
        for (frames, apart) in [(3, true), (4, true), (8, true), (4, false)] {
            let (mean, scatter, stated, root) = of_all(Noise::Normal, frames, 2, apart);
            assert!(mean.abs() < 5.0 * scatter / root, "{frames}: {mean}");
            assert!((stated / scatter - 1.0).abs() < 0.25, "{frames}: {stated}, scatter {scatter}");
        }
        // Jumps have 64 of a variance of 65, and 0.97 is the square of this ratio. A quarter of the runs of
        // three frames has no jump, and an eighth of those of four.
        for (frames, apart, least) in
            [(3, true, 0.84), (4, true, 0.9), (8, true, 0.94), (16, true, 0.94), (4, false, 0.9)]
        {
            let (mean, scatter, _, root) = of_all(Noise::Jumps, frames, 2, apart);
            let error = 5.0 * scatter / root;
            assert!(mean - error < -least && mean + error > -1.0, "{frames}: {mean} {scatter}");
        }
        // Over eight runs one in a hundred pixels always stays on one level and counts as normal noise.
        let (mean, scatter, _, root) = of_all(Noise::Stays, 2, 8, false);
        assert!(mean + 5.0 * scatter / root < -0.9, "{mean} {scatter}");
    }

    /// 200 campaigns of two runs whose noise differs three times in variance, the louder in three frames in
    /// one half and in five in the other, as after a left-out first frame: normal noise has an excess of 0
    /// in both.
    #[test]
    fn noise_that_grows_from_run_to_run_is_not_levels() {
        let (side, campaigns) = (32usize, 200u32);
        let layout = Layout::new(&Array2::from_elem((side, side), true), 4095);
        let mut all = [Vec::new(), Vec::new()];
        for campaign in 0..campaigns {
            let mut steady = Steady::new(side * side);
            let mut rng = PixelRng::new(29, Stream::Effect, 0, campaign, 0);
            for (k, (frames, noise)) in
                [(5, 1.0), (3, 1.0), (3, 3f64.sqrt()), (5, 3f64.sqrt())].iter().enumerate()
            {
                let mut one = |i: usize| -> Vec<f64> {
                    let own = if i.is_multiple_of(41) { 4.0 } else { 1.0 };
                    (0..*frames).map(|_| own * noise * rng.normal()).collect()
                };
                steady.add_run(k % 2, run(*noise, *frames, &mut one, side * side));
            }
            let of = steady.levels(&layout);
            all.iter_mut().zip(of).for_each(|(all, of)| all.push(of[2].unwrap().excess.value));
        }
        for all in all {
            let n = f64::from(campaigns);
            let mean = all.iter().sum::<f64>() / n;
            let scatter = (all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
            assert!(mean.abs() < 5.0 * scatter / n.sqrt(), "{mean} +- {scatter} / root {n}");
        }
    }

    /// 300 campaigns of three runs. Equal pixels give 0 within the stated error; a tenth of the pixels with
    /// twice the variance gives 0.1 * 0.9 within five standard errors of the mean.
    #[test]
    fn only_what_stays_with_its_pixels_counts() {
        let (side, campaigns) = (32usize, 300u32);
        let layout = Layout::new(&Array2::from_elem((side, side), true), 4095);
        let of = |more: f64, campaign: u32| {
            let mut steady = Steady::new(side * side);
            let mut rng = PixelRng::new(9, Stream::Effect, 0, campaign, 0);
            for _ in 0..3 {
                // Variance of five numbers: chi-squared of four degrees of freedom over four.
                let var = |i: usize| {
                    let chi2: f64 = (0..4).map(|_| rng.normal().powi(2)).sum();
                    (chi2 / 4.0 * if i.is_multiple_of(10) { 1.0 + more } else { 1.0 }) as f32
                };
                let var: Vec<f32> = (0..side * side).map(var).collect();
                let mean = var.iter().map(|v| f64::from(*v)).sum::<f64>() / var.len() as f64;
                steady.add(&var, mean, 5);
            }
            steady.covariance(&layout).unwrap()
        };
        for (more, expected) in [(0.0, 0.0), (1.0, 0.09)] {
            let all: Vec<Value> = (0..campaigns).map(|c| of(more, c)).collect();
            let n = f64::from(campaigns);
            let mean = all.iter().map(|v| v.value).sum::<f64>() / n;
            let scatter = (all.iter().map(|v| (v.value - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
            assert!((mean - expected).abs() < 5.0 * scatter / n.sqrt(), "{mean}, not {expected}");
            // Each jackknife error is known to a few per cent, and their mean to better than a tenth.
            let stated = (all.iter().map(|v| v.std_err * v.std_err).sum::<f64>() / n).sqrt();
            assert!((stated / scatter - 1.0).abs() < 0.25, "{stated}, scatter {scatter}");
        }
    }
}
