//! Observables of a whole campaign: code occupancy, and the spectrum of the noise in read-out order.

use crate::statistics::code_step::{Occurring, Stretch};
use crate::statistics::jackknife::Value;
use crate::statistics::layout::Layout;
use crate::statistics::median::median;
use crate::statistics::pass::Summary;
use crate::statistics::spectrum::Power;
use ndarray::Array2;

/// Returns the mean of the valid pixels, DN.
pub fn mean_of(image: &Array2<f32>, layout: &Layout) -> f64 {
    image.iter().zip(&layout.mask).map(|(v, m)| f64::from(v * m)).sum::<f64>() / layout.pixels
}

/// Number of low bits, whose codes are evaluated all together. For higher bits each transition is evaluated
/// by itself.
pub const LOW_BITS: usize = 6;
/// Maximum number of transitions of high bits that are evaluated.
const TRANSITIONS: usize = 64;

/// Bands of codes in which missing single codes are counted: a table leaves out more of the bright codes, a
/// multiplication as many everywhere.
const BANDS: usize = 4;
/// Parts of the codes for which the number of evaluated codes is stored.
const PARTS: usize = 16 * BANDS;

/// Counts around one transition, summed over all levels.
#[derive(Debug, Clone, Copy, Default)]
struct Transition {
    bend: f64,
    level: f64,
    var: f64,
}

/// Counts of every code, and the bit statistics of each level.
pub struct Codes {
    counts: Vec<u64>,
    /// For each level and bit: mean excess of one kind of codes over the other, and its variance.
    levels: Vec<[(f64, f64); LOW_BITS]>,
    /// Codes of these levels.
    bit_codes: std::ops::Range<u32>,
    /// Number of codes from one transition to the next.
    grain: usize,
    transitions: Vec<Transition>,
}

/// Minimum noise variance of a level whose histogram is smooth over a few codes, DN^2.
const WIDE_DN2: f64 = 36.0;

/// Variance of rounding, DN^2 (Widrow and Kollar 2008, eq. 4.15: a twelfth of a squared step).
const ROUNDING_DN2: f64 = 1.0 / 12.0;
/// Minimum variance of the noise of a level that tells bits, DN^2. With less, even and odd codes differ in a
/// histogram of equal codes: by 1e-4 at most here, see [`Comb`].
const EVEN_DN2: f64 = 2.25;

/// Minimum deviation of all samples of a level, relative to the period of a bit: with less, most
/// samples may lie in one kind of codes (a named choice).
const MIN_SPREAD: f64 = 0.25;

/// A weight of codes that repeats every `period` codes: a code of one kind less the mean of its neighbours,
/// and the same half a period later with the opposite sign. Over normal noise of deviation s its harmonic k
/// shrinks to exp(-2 pi^2 k^2 s^2 / period^2) (characteristic function of the normal law; Widrow and Kollar
/// 2008, ch. 4).
struct Comb {
    period: usize,
}

impl Comb {
    /// Weights of one period, each kind of codes over its own sum.
    fn weights(&self, above: f64, below: f64) -> Vec<f64> {
        let m = self.period;
        let mut out = vec![0.0; m];
        for (r, by) in [(m / 2 - 1, 1.0 / above), (m - 1, -1.0 / below)] {
            out[r] += by;
            out[(r + m - 1) % m] -= 0.5 * by;
            out[(r + 1) % m] -= 0.5 * by;
        }
        out
    }

    /// Amplitudes of the odd harmonics with what is left of them; even ones cancel.
    fn harmonics(&self, noise_dn2: f64) -> impl Iterator<Item = f64> + '_ {
        let m = self.period as f64;
        (1..=self.period / 2).step_by(2).map(move |k| {
            let turn = std::f64::consts::TAU * k as f64 / m;
            // The last harmonic, half the period, has no sine beside its cosine.
            let both = if 2 * k == self.period { 1.0 } else { 2.0 };
            2.0 * both / m * (1.0 - turn.cos()) * (-0.5 * turn * turn * noise_dn2).exp()
        })
    }

    /// Variance that single pixels add to the counts, over that of independent samples. Each stays at its
    /// place between two codes in all frames.
    fn of_places(&self, noise_dn2: f64, frames: f64) -> f64 {
        let squares: f64 = self.harmonics(noise_dn2).map(|a| 0.5 * a * a).sum();
        let own: f64 = self.weights(1.0, 1.0).iter().map(|w| w * w).sum::<f64>() / self.period as f64;
        (frames - 1.0).max(0.0) * squares / own
    }

    /// Maximum occupancy of equal codes, if all samples have a normal law of this variance.
    fn of_slope(&self, all_dn2: f64) -> f64 {
        self.period as f64 * self.harmonics(all_dn2).sum::<f64>()
    }
}

/// Returns the code below which this share of the samples lies.
fn quantile(n: &[u64], share: f64) -> usize {
    let needed = share * n.iter().sum::<u64>() as f64;
    let mut sum = 0.0;
    let reached = n.iter().position(|k| {
        sum += *k as f64;
        sum >= needed
    });
    reached.unwrap_or(n.len() - 1)
}

/// Returns a robust variance of all samples of a level, DN^2: from their quartiles (1.349 deviations apart if
/// normal), which are known to a code. Shading and unequal pixels are part of it.
fn spread_dn2(n: &[u64]) -> f64 {
    let apart = (quantile(n, 0.75) - quantile(n, 0.25)) as f64;
    ((apart - 1.0).max(0.0) / 1.349).powi(2)
}

/// Returns the occupancy of each low bit in the counts of one level, and its variance.
fn bits_of(n: &[u64], noise_dn2: f64, frames: f64) -> [(f64, f64); LOW_BITS] {
    let all_dn2 = spread_dn2(n).max(noise_dn2);
    std::array::from_fn(|b| {
        let comb = Comb { period: 1 << (b + 1) };
        let m = comb.period;
        if all_dn2 < (MIN_SPREAD * m as f64).powi(2) {
            return (0.0, f64::INFINITY);
        }
        let mut of_kind = vec![0.0; m];
        // Clipped samples pile up in the codes at both ends.
        let inside = || n.iter().enumerate().skip(1).take(n.len().saturating_sub(2));
        inside().for_each(|(c, n)| of_kind[c % m] += *n as f64);
        let level = |r: usize| 0.25 * (of_kind[(r + m - 1) % m] + 2.0 * of_kind[r] + of_kind[(r + 1) % m]);
        let [above, below] = [m / 2 - 1, m - 1].map(level);
        if above <= 0.0 || below <= 0.0 {
            return (0.0, f64::INFINITY);
        }
        let weights = comb.weights(above, below);
        let sum = |of: fn(f64) -> f64| weights.iter().zip(&of_kind).map(|(w, n)| of(*w) * n).sum::<f64>();
        let places = 1.0 + comb.of_places(noise_dn2, frames);
        (sum(|w| w), sum(|w| w * w) * places + comb.of_slope(all_dn2).powi(2))
    })
}

/// Returns the occupancy of bit `b` expected of a converter with these widths, as [`Codes::finish`] measures
/// it.
pub fn occupancy_of(widths: &dyn Fn(u32) -> f64, codes: &std::ops::Range<u32>, b: usize) -> f64 {
    let (first, second) = ((1u32 << b) - 1, (1u32 << (b + 1)) - 1);
    let relative = |residue: u32| {
        let (mut bend, mut level) = (0.0, 0.0);
        // First code of this kind that has one below it.
        let first = codes.start.max(1);
        let from = first + (residue.wrapping_sub(first) & second);
        for c in (from..codes.end).step_by(second as usize + 1).take(256) {
            let (own, beside) = (widths(c), 0.5 * (widths(c - 1) + widths(c + 1)));
            (bend, level) = (bend + own - beside, level + 0.5 * (own + beside));
        }
        bend / f64::max(level, 1e-9)
    };
    relative(first) - relative(second)
}

/// Finds the line of steps, not necessarily whole, on which the codes of all wide levels lie. The clipped
/// codes at both ends are left out.
pub fn stretch(halves: &[Codes; 2]) -> Option<Stretch> {
    let sum = |(a, b): (&u64, &u64)| a + b;
    let mut counts: Vec<u64> = halves[0].counts.iter().zip(&halves[1].counts).map(sum).collect();
    for end in [0, counts.len().saturating_sub(1)] {
        counts.get_mut(end).into_iter().for_each(|n| *n = 0);
    }
    let occurring = Occurring::of_counts(&counts);
    occurring.stretch().or_else(|| occurring.multiplied())
}

impl Codes {
    /// Creates counters for codes up to a full scale.
    pub fn new(full: u16) -> Self {
        let codes = usize::from(full) + 1;
        let grain = (codes / TRANSITIONS).max(1 << (LOW_BITS - 1));
        let transitions = vec![Transition::default(); codes.div_ceil(grain)];
        Self { counts: vec![0; codes], levels: Vec::new(), bit_codes: 0..0, grain, transitions }
    }

    /// Adds the codes of one level. The histogram of a narrow level is all slope: it tells low bits at most.
    pub fn add(&mut self, summary: &Summary) {
        let n = &summary.occupancy.0;
        let noise_dn2 = summary.var.value - ROUNDING_DN2;
        if noise_dn2 >= EVEN_DN2 {
            self.levels.push(bits_of(n, noise_dn2, summary.frames as f64));
            let [first, last] = [0.01, 0.99].map(|share| quantile(n, share) as u32);
            let before = &self.bit_codes;
            self.bit_codes =
                if before.is_empty() { first..last } else { before.start.min(first)..before.end.max(last) };
        }
        if summary.var.value < WIDE_DN2 {
            return;
        }
        self.counts.iter_mut().zip(n).for_each(|(a, b)| *a += b);
        for (k, t) in self.transitions.iter_mut().enumerate().skip(1) {
            let c = k * self.grain;
            let [a, b, d] = [n[c - 2], n[c - 1], n[c]].map(|n| n as f64);
            t.bend += b - 0.5 * (a + d);
            t.level += 0.25 * (a + 2.0 * b + d);
            t.var += b + 0.25 * (a + d);
        }
    }

    /// Returns the range of filled codes and the code statistics.
    pub fn finish(self) -> CodeStatistics {
        let n = &self.counts;
        let mut out = CodeStatistics::default();
        // A window of 16 codes holds the same number of multiples of 2, 4, 8 or 16 at every place. A window
        // of 17 would select the filled codes.
        let wide = |c: usize| n[c.saturating_sub(8)..(c + 8).min(n.len())].iter().sum::<u64>();
        let filled: Vec<usize> = (1..n.len().saturating_sub(1)).filter(|c| wide(*c) > 1000).collect();
        if filled.len() >= 32 {
            let used = filled.iter().filter(|c| n[**c] > 0).count() as f64;
            out.used = Some(share_of(used, filled.len() as f64));
            out.gaps = gaps(n);
            out.gaps_of_bands = std::array::from_fn(|band| gaps(&n[part(band, BANDS, n.len())]));
            out.filled.between =
                (0..PARTS).map(|k| between(&n[part(k, PARTS, n.len())]).count() as f64).collect();
            out.filled.range = filled[0] as u32..filled[filled.len() - 1] as u32;
        }
        out.filled.bits = self.bit_codes.clone();
        for b in 0..LOW_BITS {
            let sound: Vec<(f64, f64)> =
                self.levels.iter().map(|l| l[b]).filter(|(_, var)| var.is_finite() && *var > 0.0).collect();
            let weight: f64 = sound.iter().map(|(_, var)| 1.0 / var).sum();
            if sound.len() < 2 {
                continue;
            }
            let value = sound.iter().map(|(v, var)| v / var).sum::<f64>() / weight;
            // Levels may scatter more than their counts.
            let chi2 = sound.iter().map(|(v, var)| (v - value).powi(2) / var).sum::<f64>()
                / (sound.len() - 1) as f64;
            out.bits[b] = Some(Value { value, std_err: (chi2.max(1.0) / weight).sqrt().hypot(2e-4) });
        }
        for (k, t) in self.transitions.iter().enumerate().filter(|(_, t)| t.level > 400.0) {
            let value = Value { value: t.bend / t.level, std_err: (t.var.sqrt() / t.level).hypot(1e-3) };
            out.transitions.push((k * self.grain, value));
        }
        out
    }
}

/// Codes filled by samples.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Filled {
    /// Lowest to highest filled code.
    pub range: std::ops::Range<u32>,
    /// Lowest to highest code of the levels that tell low bits.
    pub bits: std::ops::Range<u32>,
    /// Number of codes whose neighbours hold many samples, for each of [`PARTS`] equal parts of all codes.
    pub between: Vec<f64>,
}

impl Filled {
    /// Returns the parts that belong to an index of [`super::gaps`] (0: all of them, others: a band). Each
    /// has its middle, as a share of all codes, and its number of codes.
    pub fn parts(&self, index: usize) -> impl Iterator<Item = (f64, f64)> + '_ {
        let range = index.checked_sub(1).map_or(0..PARTS, |band| part(band, BANDS, PARTS));
        range.filter_map(|k| Some(((k as f64 + 0.5) / PARTS as f64, *self.between.get(k)?)))
    }

    /// Returns the codes of the range that belong to an index, for this total number of codes.
    pub fn range_of(&self, index: usize, codes: usize) -> std::ops::Range<u32> {
        let band = index.checked_sub(1).map_or(0..codes, |band| part(band, BANDS, codes));
        self.range.start.max(band.start as u32)..self.range.end.min(band.end as u32)
    }
}

/// Code statistics of one half of a campaign.
#[derive(Debug, Clone, Default)]
pub struct CodeStatistics {
    /// Filled codes.
    pub filled: Filled,
    used: Option<Value>,
    gaps: Option<Value>,
    gaps_of_bands: [Option<Value>; BANDS],
    bits: [Option<Value>; LOW_BITS],
    transitions: Vec<(usize, Value)>,
}

impl CodeStatistics {
    /// Returns the share of occurring codes in the range.
    pub fn used(&self) -> Option<Value> {
        self.used
    }

    /// Returns the share of empty codes among those whose neighbours are both filled.
    pub fn gaps(&self) -> Option<Value> {
        self.gaps
    }

    /// Returns that share in each band of codes.
    pub fn gaps_of_bands(&self) -> impl Iterator<Item = (usize, Value)> + '_ {
        self.gaps_of_bands.iter().enumerate().filter_map(|(band, v)| Some((band, (*v)?)))
    }

    /// Returns the relative excess of the codes just before the bit is set over those just before it is
    /// cleared.
    pub fn bit(&self, b: usize) -> Option<Value> {
        self.bits.get(b).copied().flatten()
    }

    /// Returns the code above each transition of the high bits, with the relative excess of the code below it
    /// over its neighbours.
    pub fn transitions(&self) -> impl Iterator<Item = (usize, Value)> + '_ {
        self.transitions.iter().copied()
    }
}

/// Returns the share of occurring codes among those with many samples on both sides, and its error; `None` if
/// there are few.
pub fn share_used(summary: &Summary) -> Option<(f64, f64)> {
    let n = &summary.occupancy.0;
    const REACH: usize = 16;
    // Codes of ordinary width would hold a dozen samples there: none of them is missed by chance.
    let enough = 12 * REACH as u64;
    let mut sums = vec![0u64; n.len() + 1];
    n.iter().enumerate().for_each(|(c, n)| sums[c + 1] = sums[c] + n);
    let many = |c: &usize| sums[*c] - sums[c - REACH] > enough && sums[c + 1 + REACH] - sums[c + 1] > enough;
    let inside = REACH..n.len().saturating_sub(REACH + 1);
    let (all, used) = inside
        .filter(many)
        .fold((0.0, 0.0), |(all, used), c| (all + 1.0, used + f64::from(u8::from(n[c] > 0))));
    let share = share_of(used, all);
    (all >= 24.0).then_some((share.value, share.std_err))
}

/// Returns one of some equal parts of this many codes.
fn part(k: usize, of: usize, codes: usize) -> std::ops::Range<usize> {
    k * codes / of..(k + 1) * codes / of
}

/// Returns the codes between two that hold many samples: so many that a code of at least half their width is
/// empty once in 1e21 times.
fn between(n: &[u64]) -> impl Iterator<Item = &[u64]> {
    const MANY: u64 = 100;
    n.windows(3).filter(|w| w[0] >= MANY && w[2] >= MANY)
}

/// Returns the share of empty codes among those whose neighbours both hold many samples, with the error of
/// half a code.
pub(super) fn gaps(n: &[u64]) -> Option<Value> {
    let (all, empty) =
        between(n).fold((0.0, 0.0), |(all, e), w| (all + 1.0, e + f64::from(u8::from(w[1] == 0))));
    (all >= 64.0).then(|| Value { value: empty / all, std_err: 0.5 / all })
}

/// Returns a share of codes. For equal steps it is known to a code at each end; steps of a table or of
/// unequal bits are predicted to 2 %.
fn share_of(used: f64, all: f64) -> Value {
    Value { value: used / all, std_err: 0.02 * used / all + 1.0 / all }
}

/// Power spectrum of the noise in read-out order over many levels. The quiet levels have the largest weight:
/// they show a line best.
pub struct LineSearch {
    length: usize,
    power: Vec<f64>,
    weight: f64,
    frames: f64,
    /// Sum over the levels of the squared scatter of a line's power in few frames.
    walk: f64,
}

/// Lowest frequency of a line, in steps of the spectrum: slow changes are no line.
const SLOW: usize = 64;
/// Steps of the spectrum on either side of a line over which the window spreads it (Hann: two, and one for a
/// place between two).
const BESIDE: usize = 3;

impl LineSearch {
    /// Creates a search for frames of this shape.
    pub fn new(shape: (usize, usize)) -> Self {
        let length = Power::length(shape);
        Self { length, power: vec![0.0; length / 2 + 1], weight: 0.0, frames: 0.0, walk: 0.0 }
    }

    /// Adds the spectrum of one level.
    pub fn add(&mut self, summary: &Summary) {
        if self.length < 1024 || summary.var.value <= 0.0 {
            return;
        }
        let n = summary.frames as f64;
        let w = 1.0 / summary.var.value;
        // Subtracting the pixel means removed this share of the power.
        let up = w * n / (n - 1.0);
        self.power.iter_mut().zip(&summary.power).for_each(|(a, b)| *a += up * b);
        self.weight += w * n;
        // A line has one phase per frame, about the pixel means: its power in n frames has the relative error
        // 1 / sqrt(n (n - 1)).
        self.walk += w * w * n / (n - 1.0);
        self.frames += n;
    }

    /// Combines both halves.
    pub fn with(&self, other: &Self) -> Self {
        Self {
            length: self.length,
            power: self.power.iter().zip(&other.power).map(|(a, b)| a + b).collect(),
            weight: self.weight + other.weight,
            frames: self.frames + other.frames,
            walk: self.walk + other.walk,
        }
    }

    /// Returns the median power around a frequency, without the line.
    fn floor(&self, at: usize) -> f64 {
        let near = at.saturating_sub(60)..(at + 61).min(self.power.len());
        median(near.filter(|j| j.abs_diff(at) > 4).map(|j| self.power[j]))
    }

    /// Returns the strongest line that is no accident: its bin, and its frequency in cycles per pixel.
    pub fn strongest(&self) -> Option<(usize, f64)> {
        if self.frames < 2.0 {
            return None;
        }
        let n = self.power.len();
        let from = SLOW.min(n / 8);
        // Power is compared with its surroundings: filtered noise has no line.
        let top = (from..n - 2).max_by(|&a, &b| self.power[a].total_cmp(&self.power[b]))?;
        // A sum of exponentials has the relative deviation 1 / root of the frames. An excess of ten
        // deviations, and of at least 30 %, is no accident among 10^5 frequencies.
        let deviation = 1.0 / self.frames.sqrt();
        if self.power[top] / self.floor(top) - 1.0 < (10.0 * deviation).max(0.3) {
            return None;
        }
        // The power of a line between two bins is shared: a parabola through the logarithms finds its place.
        let log = |i: usize| self.power[i].max(f64::MIN_POSITIVE).ln();
        let (a, b, c) = (log(top - 1), log(top), log(top + 1));
        let shift = (0.5 * (a - c) / (a - 2.0 * b + c)).clamp(-0.5, 0.5);
        let frequency = (top as f64 + if shift.is_finite() { shift } else { 0.0 }) / self.length as f64;
        Some((top, frequency))
    }

    /// Returns the variance in the line at a bin, and one cycle per row of this many columns on either side
    /// of it, DN^2; `None` beyond the ends of the spectrum.
    pub fn teeth(&self, top: usize, columns: usize) -> [Option<Value>; 3] {
        let row = self.length as f64 / columns as f64;
        super::line::TEETH.map(|away| {
            let place = (top as f64 + away * row).round();
            (away == 0.0 || place > SLOW as f64 && place + BESIDE as f64 + 1.0 < self.power.len() as f64)
                .then(|| self.at(place as usize))
        })
    }

    /// Returns the variance in the line at a bin, DN^2.
    pub fn at(&self, top: usize) -> Value {
        let floor = self.floor(top);
        let last = self.power.len() - 1;
        let excess: f64 =
            (top.saturating_sub(BESIDE)..=top + BESIDE).map(|i| self.power[i.min(last)] - floor).sum();
        // Power at one frequency of a sine of variance v is v N / 2 (the other half lies at minus it).
        let unit = 2.0 / (self.weight * self.length as f64);
        let variance = excess.max(0.0) * unit;
        let error = floor * ((2 * BESIDE + 1) as f64).sqrt() / self.frames.sqrt() * unit;
        // Sampling error of the line in few frames, and the power of a line between two bins outside the
        // summed bins.
        let walk = self.walk.sqrt() / self.weight;
        Value { value: variance, std_err: error.hypot(variance * walk.hypot(0.02)) }
    }
}

#[cfg(test)]
mod tests {
    use super::{LOW_BITS, bits_of, gaps, occupancy_of};
    use radcam_sim::rng::{PixelRng, Stream};

    /// Counts of pixels in some frames: each keeps its place, under normal noise. `width`: of codes that end
    /// in a set bit, more than of the others.
    fn counts(seed: u64, noise_dn: f64, places_dn: f64, width: f64) -> Vec<u64> {
        let mut n = vec![0u64; 1024];
        for pixel in 0..4000u32 {
            let mut random = PixelRng::new(seed, Stream::Effect, 0, pixel, 0);
            let place = 500.0 + places_dn * random.normal();
            for _ in 0..8 {
                let level = place + noise_dn * random.normal();
                let pair = 2.0 * (0.5 * level).floor();
                let code = pair + f64::from(u8::from(level - pair >= 1.0 - 0.5 * width));
                n[code as usize] += 1;
            }
        }
        n
    }

    /// Equal codes have no occupancy, within errors of the right size for the lowest bit, also where pixels
    /// with little noise keep their places and where all have one level. Unequal ones have what is expected.
    #[test]
    fn occupancy_and_its_error_hold_for_little_noise() {
        const SEEDS: u64 = 60;
        for (noise_dn, places_dn) in [(1.5, 0.0), (1.5, 5.0), (2.5, 5.0), (6.0, 3.0), (6.0, 20.0)] {
            let mut squares = [0.0; LOW_BITS];
            for seed in 0..SEEDS {
                let found = bits_of(&counts(seed, noise_dn, places_dn, 0.0), noise_dn * noise_dn, 8.0);
                for (sum, (value, var)) in squares.iter_mut().zip(found) {
                    *sum += value * value / var / SEEDS as f64;
                }
            }
            // The mean of 60 squares of unit scatter has the deviation 0.18: four of them. Errors of high
            // bits contain the slope of a narrow histogram as its largest value.
            let most = 1.0 + 4.0 * (2.0 / SEEDS as f64).sqrt();
            assert!(squares.iter().all(|s| *s < most), "{noise_dn}, {places_dn}: {squares:.2?}");
            assert!(squares[0] > 0.27, "{noise_dn}, {places_dn}: {squares:.2?}");
        }
        for seed in 0..8 {
            let width = 0.15;
            let (value, var) = bits_of(&counts(seed, 2.0, 5.0, width), 4.0, 8.0)[0];
            let widths = |code: u32| if code % 2 == 1 { 1.0 + 0.5 * width } else { 1.0 - 0.5 * width };
            let expected = occupancy_of(&widths, &(480..520), 0);
            assert!((value - expected).abs() < 4.0 * var.sqrt(), "{value} +- {}, not {expected}", var.sqrt());
            assert!(value.abs() > 4.0 * var.sqrt(), "{value} +- {}", var.sqrt());
        }
    }

    /// Codes times 1.01, rounded down, leave out one code in 101. Unchanged codes and multiples of four leave
    /// out no single one.
    #[test]
    fn multiplied_codes_leave_single_ones_out() {
        let mut counts = vec![0u64; 1200];
        (0..1000).for_each(|c| counts[(1.01 * f64::from(c)).floor() as usize] += 500);
        let found = gaps(&counts).unwrap();
        assert!((found.value - 1.0 / 101.0).abs() < 2.0 * found.std_err, "{found:?}");
        assert_eq!(gaps(&[500; 1000]).unwrap().value, 0.0);
        let coarse: Vec<u64> = (0..1000).map(|c| if c % 4 == 0 { 500 } else { 0 }).collect();
        assert!(gaps(&coarse).is_none());
    }
}
