//! Code step of a converter whose codes were stretched, estimated from the codes that occur.
//!
//! Programs and cameras store 8 to 14 bits in 16: times 16 or 257, with the bits repeated, or scaled by
//! 65535/4095 and rounded. All of these are floor(step k + offset) of integer k: a digital straight line. A
//! line is accepted if every code lies on it and the match is unlikely by chance.

use statrs::function::factorial::ln_binomial;

/// Counts of each 16-bit value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Occurring(Vec<u64>);

impl Default for Occurring {
    fn default() -> Self {
        Self(vec![0; 1 << 16])
    }
}

/// Maximum share of samples off the line: pixels that a camera interpolates from their neighbours after its
/// codes were stretched (a named choice; a thousandth of the pixels moves no statistic).
const MAX_STRAY: f64 = 1e-3;

impl Occurring {
    /// Adds codes.
    pub fn add(&mut self, codes: &[u16]) {
        for code in codes {
            self.0[usize::from(*code)] += 1;
        }
    }

    /// Merges the counts of another.
    pub fn merge(&mut self, other: &Self) {
        self.0.iter_mut().zip(&other.0).for_each(|(a, b)| *a += b);
    }

    /// Creates counts from a list indexed by code; codes beyond 16 bits are ignored.
    pub fn of_counts(counts: &[u64]) -> Self {
        let mut out = Self::default();
        out.0.iter_mut().zip(counts).for_each(|(sum, n)| *sum = *n);
        out
    }

    /// Codes that occur, in ascending order.
    pub fn codes(&self) -> Vec<f64> {
        self.more_often_than(0)
    }

    fn more_often_than(&self, limit: u64) -> Vec<f64> {
        self.0.iter().enumerate().filter(|(_, n)| **n > limit).map(|(code, _)| code as f64).collect()
    }

    /// Returns step and offset of stretched codes; `None` if neighbouring codes occur or there are too few
    /// codes.
    pub fn stretch(&self) -> Option<Stretch> {
        let codes = self.codes();
        // Clipped values at the ends of the range are not codes of the converter. An integer step is tried
        // first: with one code off, a nearly integer step fits too.
        let n = codes.len();
        let parts = [(0, n), (0, n.saturating_sub(1)), (1, n)];
        let cut = |(from, to): (usize, usize)| codes.get(from..to.max(from)).unwrap_or(&[]);
        let least = if self.has_a_run() { MIN_EVIDENCE_OF_A_RUN } else { MIN_EVIDENCE };
        let whole = parts.iter().find_map(|part| of_multiples(cut(*part), least));
        if let Some(found) = whole.or_else(|| parts.iter().find_map(|part| of_whole_codes(cut(*part)))) {
            return Some(found);
        }
        let mut counts: Vec<u64> = self.0.iter().copied().filter(|n| *n > 0).collect();
        counts.sort_unstable();
        let most = MAX_STRAY * counts.iter().sum::<u64>() as f64;
        let mut rare = 0;
        let limit = counts.iter().take_while(|n| {
            rare += **n;
            rare as f64 <= most
        });
        of_whole_codes(&self.more_often_than(limit.last().copied()?))
    }

    /// Returns step and offset of codes that were multiplied by a number between 1 and 2 after conversion, as
    /// by a digital gain; otherwise `None`. Such codes are a balanced word: steps of one and of two,
    /// distributed as evenly as possible (Lothaire 2002, Algebraic Combinatorics on Words, section 2.1.2).
    pub fn multiplied(&self) -> Option<Stretch> {
        let runs = self.runs();
        let width = |step: f64| runs.iter().map(|run| band_of(run, step).1).fold(0.0, f64::max);
        // The maximum of convex functions is convex.
        let step = least_of(width, 1.0, 2.0);
        let chance: f64 = runs.iter().map(|run| evidence_of_balance(run)).sum();
        let found = width(step) < WHOLE && chance > MIN_EVIDENCE && MULTIPLIED.contains(&step);
        let longest = runs.iter().max_by_key(|run| run.len()).filter(|_| found)?;
        let zero = band_of(longest, step).0;
        Some(Stretch { step, zero: zero - step * (zero / step).round() })
    }

    /// Returns the runs of codes in which at most every second code is missing, and none by chance.
    fn runs(&self) -> Vec<Vec<f64>> {
        /// Minimum samples of both neighbours for an empty code to be significant.
        const MIN_SAMPLES: u64 = 100;
        /// Maximum ratio to the rarer neighbour at which a code counts as missing: interpolated pixels add
        /// samples.
        const LEFT_OUT: f64 = 0.02;
        let (mut runs, mut run) = (Vec::new(), Vec::new());
        for (code, n) in self.0.windows(3).enumerate().map(|(i, n)| ((i + 1) as f64, n)) {
            let left_out = n[0].min(n[2]) >= MIN_SAMPLES && (n[1] as f64) < LEFT_OUT * n[0].min(n[2]) as f64;
            if n[1] >= MIN_SAMPLES {
                run.push(code);
            } else if !left_out && !run.is_empty() {
                runs.push(std::mem::take(&mut run));
            }
        }
        runs.push(run);
        runs.retain(|run| run.len() > 2);
        runs
    }

    /// Returns true if noise covers four successive codes at the smallest distance that occurs, with none
    /// between.
    fn has_a_run(&self) -> bool {
        /// Minimum samples of a code for an empty neighbour to be significant.
        const MIN_SAMPLES: u64 = 30;
        let codes = self.codes();
        let often = self.more_often_than(MIN_SAMPLES - 1);
        let smallest = codes.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
        often.windows(4).any(|w| w.windows(2).all(|pair| pair[1] - pair[0] == smallest))
    }

    /// Returns true if neighbouring codes occur: the codes count in steps of 1.
    pub fn has_neighbours(&self) -> bool {
        self.0.windows(2).any(|pair| pair[0] > 0 && pair[1] > 0)
    }
}

/// Line of stretched codes: code k has the value `zero` + `step` k, to within half a rounding.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stretch {
    /// Distance between successive codes.
    pub step: f64,
    /// Value of code 0: between minus half a step and half a step.
    pub zero: f64,
}

impl Stretch {
    /// Returns the code of a value. Values off the line of stretched codes belong to the code below: they
    /// were clipped at full scale.
    pub fn code(&self, value: f64) -> f64 {
        if self.step < 2.0 {
            return ((value - self.zero) / self.step).round();
        }
        // Rounding shifts a value by at most half a step of the file.
        ((value - self.zero + 0.75) / self.step).floor()
    }
}

/// Range of steps of multiplied codes: nearer to 1 or 2 too few codes differ from those of whole steps (a
/// named choice).
const MULTIPLIED: std::ops::Range<f64> = 1.01..1.99;

/// Returns the centre, at place 0, and the width of the band of successive values about lines of this step.
fn band_of(values: &[f64], step: f64) -> (f64, f64) {
    let off = values.iter().enumerate().map(|(k, v)| v - step * k as f64);
    let (low, high) = off.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    (0.5 * (low + high), high - low)
}

/// Returns the minimiser of a convex function between two places, by ternary search.
fn least_of(of: impl Fn(f64) -> f64, mut a: f64, mut b: f64) -> f64 {
    for _ in 0..60 {
        let (left, right) = (a + (b - a) / 3.0, b - (b - a) / 3.0);
        if of(left) <= of(right) { b = right } else { a = left }
    }
    0.5 * (a + b)
}

/// Computes the logarithm of the number of orders of these steps of one and two, over the number of balanced
/// orders. Of n steps there are fewer than n^3 balanced orders for all numbers of twos, and n^2 for one
/// number.
fn evidence_of_balance(values: &[f64]) -> f64 {
    let steps = values.len() - 1;
    let twos = values.windows(2).filter(|w| w[1] - w[0] > 1.5).count();
    (ln_binomial(steps as u64, twos as u64) - 2.0 * (steps as f64).ln()).max(0.0)
}

/// Minimum evidence for a line, as minus the logarithm of its chance probability: exp(-14), one in a million.
const MIN_EVIDENCE: f64 = 14.0;

/// Maximum width of the band of rounded codes about their line: less than 1 for any kind of rounding. For
/// steps m / (2^15 - 1) the width is 1 - 3e-5; at 1 every second number lies on a line of step 2.
const WHOLE: f64 = 1.0 - 1e-5;

/// Minimum evidence for a line if four successive codes occur often: codes of a converter have neighbours
/// there (a named choice; two more codes at a step of 4).
const MIN_EVIDENCE_OF_A_RUN: f64 = 4.0;

/// Finds the step as the greatest common divisor of the distances of sorted integers.
fn of_multiples(values: &[f64], min_evidence: f64) -> Option<Stretch> {
    let first = *values.first()? as i64;
    let divisor = values.iter().fold(0, |mut a: i64, v| {
        let mut b = *v as i64 - first;
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a
    });
    let step = divisor as f64;
    let evidence = step.max(1.0).ln() * (values.len() - 1) as f64;
    let zero = first as f64 - step * (first as f64 / step.max(1.0)).round();
    (divisor >= 2 && evidence > min_evidence).then_some(Stretch { step, zero })
}

/// Finds the step of sorted integers that occur.
pub fn of_whole_codes(values: &[f64]) -> Option<Stretch> {
    of_multiples(values, MIN_EVIDENCE).or_else(|| of_sorted(values, WHOLE, 2.0))
}

/// Finds the step of sorted floating-point values that occur: exact except for their last bits.
pub fn of_numbers(values: &[f64]) -> Option<Stretch> {
    let largest = values.iter().fold(0.0f64, |a, v| a.max(v.abs()));
    // Four units in the last place of single precision.
    let window = 4.0 * largest * f64::from(f32::EPSILON);
    of_sorted(values, window.max(f64::MIN_POSITIVE), 4.0 * window)
}

/// Finds the step of sorted values that lie within `window` of a line; `None` if two are closer than `least`.
fn of_sorted(values: &[f64], window: f64, least: f64) -> Option<Stretch> {
    let gaps: Vec<f64> = values.windows(2).map(|w| w[1] - w[0]).collect();
    let smallest = gaps.iter().copied().fold(f64::INFINITY, f64::min);
    if gaps.is_empty() || smallest < least || !smallest.is_finite() {
        return None;
    }
    // The longest run of single steps gives the step well enough to count the steps of larger gaps.
    let single = |gap: &f64| *gap < smallest + 1.01 * window;
    let (mut run, mut longest, mut from) = (0, 0, 0);
    for (i, gap) in gaps.iter().enumerate() {
        run = if single(gap) { run + 1 } else { 0 };
        if run > longest {
            (longest, from) = (run, i + 1 - run);
        }
    }
    let step = (values[from + longest] - values[from]) / longest as f64;
    let fits = |places: Vec<f64>, step: f64| {
        let (step, zero, width) = narrowest(values, &places, step)?;
        // Share of the values between two steps that a line allows.
        let allowed = (window / step).min(1.0);
        let evidence = -allowed.ln() * (values.len() - 1) as f64;
        (width <= window && step >= least && evidence > MIN_EVIDENCE)
            .then(|| Stretch { step, zero: zero - step * (zero / step).round() })
    };
    // A run of n steps gives the step to about 2 / n, which is too coarse to count the steps of a large gap.
    // Stretch factors that programs use are tried first.
    let near = |q: &f64| window == WHOLE && (q - step).abs() <= 2.0 / longest as f64 + 1e-9;
    let known = usual_steps().into_iter().filter(near);
    let on_grid = |q: f64| values.iter().map(|v| ((v - values[from]) / q).round()).collect();
    known
        .filter_map(|q| fits(on_grid(q), q))
        .next()
        .or_else(|| fits(outwards(values, &gaps, from, longest), step))
}

/// Lists the usual steps of programs that stretch shorter codes: scaled to full scale or bits repeated.
fn usual_steps() -> Vec<f64> {
    let scaled = (1..16).flat_map(|bits| {
        let codes = f64::from(1u32 << bits);
        [65_535.0 / (codes - 1.0), 65_536.0 / codes * (1.0 + 1.0 / codes), 255.0 / (codes - 1.0)]
    });
    scaled.collect()
}

/// Counts the steps outwards from a run of single steps, by the line through the points counted before.
fn outwards(values: &[f64], gaps: &[f64], from: usize, longest: usize) -> Vec<f64> {
    let mut line = Line::new(values[from]);
    let mut places = vec![0.0; values.len()];
    let mut step = (values[from + longest] - values[from]) / longest as f64;
    for k in 0..=longest {
        places[from + k] = k as f64;
        line.add(k as f64, values[from + k]);
    }
    let (mut low, mut high) = (from, from + longest);
    while low > 0 || high + 1 < values.len() {
        // The nearer side first.
        let down = low > 0 && (high + 1 == values.len() || gaps[low - 1] <= gaps[high]);
        let (at, beside) = if down { (low - 1, low) } else { (high + 1, high) };
        step = line.slope().unwrap_or(step);
        places[at] = places[beside] + ((values[at] - values[beside]) / step).round();
        line.add(places[at], values[at]);
        if down {
            low = at;
        } else {
            high = at;
        }
    }
    places
}

/// Sums for a straight-line fit, relative to its first point.
struct Line {
    from: f64,
    n: f64,
    sums: [f64; 4],
}

impl Line {
    fn new(from: f64) -> Self {
        Self { from, n: 0.0, sums: [0.0; 4] }
    }

    fn add(&mut self, place: f64, value: f64) {
        let v = value - self.from;
        self.n += 1.0;
        let [x, y, xx, xy] = &mut self.sums;
        (*x, *y, *xx, *xy) = (*x + place, *y + v, *xx + place * place, *xy + place * v);
    }

    fn slope(&self) -> Option<f64> {
        let [x, y, xx, xy] = self.sums;
        let below = self.n * xx - x * x;
        (below > 0.0).then(|| (self.n * xy - x * y) / below)
    }
}

/// Returns the slope near `step` with the narrowest band, the centre of the band at place 0, and its width.
///
/// The width is a convex function of the slope, so ternary search finds its minimum.
fn narrowest(values: &[f64], places: &[f64], step: f64) -> Option<(f64, f64, f64)> {
    let span = places.last()? - places.first()?;
    let band = |step: f64| {
        let off = values.iter().zip(places).map(|(v, k)| v - step * k);
        off.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
    };
    let width = |step: f64| {
        let (a, b) = band(step);
        b - a
    };
    // A least-squares slope is off by less than the band width over the span of the places.
    let reach = 2.0 * width(step) / span.max(1.0);
    let step = least_of(width, step - reach, step + reach);
    let (low, high) = band(step);
    Some((step, 0.5 * (low + high), high - low))
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    fn of(codes: impl Iterator<Item = u16>) -> Option<Stretch> {
        let mut occurring = Occurring::default();
        occurring.add(&codes.collect::<Vec<_>>());
        occurring.stretch()
    }

    /// Returns converter codes as they occur in darks and four flats.
    fn converter(bits: u32) -> Vec<u32> {
        let full = (1u32 << bits) - 1;
        let around =
            |level: u32, width: u32| (level.saturating_sub(width)..=(level + width).min(full)).collect();
        let groups: [Vec<u32>; 5] = [
            around(full / 40, 2),
            around(full / 8, full / 60),
            around(full / 4, full / 50),
            around(full / 2, full / 40),
            around(9 * full / 10, full / 40),
        ];
        groups.concat()
    }

    type Scale = fn(u32) -> u32;

    /// Every kind of stretching is found with its step, and every code is recovered.
    #[test]
    fn stretched_codes_come_back() {
        let ways: [(&str, u32, f64, Scale); 11] = [
            ("x16", 12, 16.0, |v| v * 16),
            ("x4", 14, 4.0, |v| v * 4),
            ("x257", 8, 257.0, |v| v * 257),
            ("x100", 9, 100.0, |v| v * 100),
            ("repeated, 10 bits", 10, 64.0625, |v| v << 6 | v >> 4),
            ("repeated, 12 bits", 12, 16.0039, |v| v << 4 | v >> 8),
            ("65535/4095, rounded", 12, 65_535.0 / 4095.0, |v| {
                (f64::from(v) * 65_535.0 / 4095.0).round() as u32
            }),
            ("65535/1023, cut off", 10, 65_535.0 / 1023.0, |v| v * 65_535 / 1023),
            ("65535/16383, rounded", 14, 65_535.0 / 16_383.0, |v| {
                (f64::from(v) * 65_535.0 / 16_383.0).round() as u32
            }),
            ("x16 and 15 in the low bits", 12, 16.0, |v| v * 16 + 15),
            ("gain of 2.3", 12, 2.3, |v| (f64::from(v) * 2.3 + 40.0).round() as u32),
        ];
        for (name, bits, step, scale) in ways {
            let codes = converter(bits);
            let found = of(codes.iter().map(|v| scale(*v) as u16)).unwrap_or_else(|| panic!("{name}"));
            assert!((found.step / step - 1.0).abs() < 1e-3, "{name}: {found:?}");
            let off = found.code(scale(codes[0]).into()) - f64::from(codes[0]);
            for v in &codes {
                assert_eq!(found.code(f64::from(scale(*v))) - f64::from(*v), off, "{name}: {v} {found:?}");
            }
        }
    }

    /// Unstretched codes of a converter, and few codes of any kind, give no step.
    #[test]
    fn other_codes_are_left_alone() {
        assert_eq!(of(converter(12).into_iter().map(|v| v as u16)), None);
        assert_eq!(of([0, 100, 200, 300].into_iter().map(|v| v * 3 + 1).chain([5, 6])), None);
        assert_eq!(of([0u16, 16, 32].into_iter()), None);
        assert_eq!(of([7u16].into_iter()), None);
        assert_eq!(of(std::iter::empty()), None);
        for seed in 0..200 {
            // Sparse codes anywhere.
            let code = |i: u32| PixelRng::new(seed, Stream::Effect, 0, i, 0).uniform() * 65_535.0;
            let found = of((0..40).map(|i| code(i) as u16));
            assert_eq!(found, None, "{seed}");
        }
        // More codes off the line than the maximum share of strays.
        let off = [1003, 1005, 2011, 3003, 5001];
        assert_eq!(of(converter(12).into_iter().map(|v| 16 * v as u16).chain(off)), None);
    }

    /// Returns the counts of a campaign in which each of these codes occurs often.
    fn often(codes: impl Iterator<Item = f64>) -> Occurring {
        let mut counts = vec![0u64; 1 << 16];
        codes.for_each(|code| counts[code as usize] += 400);
        Occurring::of_counts(&counts)
    }

    /// Codes times a number between 1 and 2, rounded or truncated, are found with this factor in sweeps with
    /// gaps between their levels. Codes as they are, square-root tables and converters with missing codes are
    /// not.
    #[test]
    fn multiplied_codes_are_told_from_tables() {
        for k in 0..300u32 {
            let random = |n: u64| PixelRng::new(5, Stream::Effect, n, k, 0).uniform();
            let (step, zero) = (1.02 + 0.96 * random(0), 200.0 * random(1));
            let codes = converter(12).into_iter().filter(|c| *c > 4).map(f64::from);
            let scaled =
                |c: f64| if k % 2 == 0 { (step * c + zero).floor() } else { (step * c + zero).round() };
            let found = often(codes.map(scaled)).multiplied().unwrap_or_else(|| panic!("{step}"));
            assert!((found.step / step - 1.0).abs() < 0.003, "{step}: {found:?}");
        }
        assert_eq!(often(converter(12).into_iter().map(f64::from)).multiplied(), None);
        for sent in [3000.0, 4000.0, 6000.0] {
            let table = |c: u32| (f64::from(c) / sent).powi(2) * 4095.0;
            let expanded = (300..sent as u32).map(|c| table(c).round());
            assert_eq!(often(expanded).multiplied(), None, "{sent}");
        }
        // Every eighth code is missing, and others by chance.
        let some = (300..3000u32).filter(|c| c % 8 != 7 && c.wrapping_mul(2_654_435_761) >> 29 != 0);
        assert_eq!(often(some.map(f64::from)).multiplied(), None);
    }

    /// Quiet darks alone determine the step too.
    #[test]
    fn few_codes_that_occur_often_are_enough() {
        let counts = [(96u16, 40usize), (100, 900), (104, 1200), (108, 700), (112, 31)];
        let codes = counts.into_iter().flat_map(|(code, n)| std::iter::repeat_n(code, n));
        assert_eq!(of(codes), Some(Stretch { step: 4.0, zero: 0.0 }));
        let apart = [(10u16, 900usize), (50, 900), (130, 900), (170, 900)];
        assert_eq!(of(apart.into_iter().flat_map(|(code, n)| std::iter::repeat_n(code, n))), None);
    }

    /// Values clipped at an end of the range, and a few interpolated pixels, do not hide a step.
    #[test]
    fn strays_hide_no_step() {
        let stretched: Vec<u16> = converter(12).into_iter().map(|v| 16 * v as u16).collect();
        let found = Some(Stretch { step: 16.0, zero: 0.0 });
        assert_eq!(of(stretched.iter().copied().chain([65_535])), found);
        let mut occurring = Occurring::default();
        (0..100).for_each(|_| occurring.add(&stretched));
        occurring.add(&[1003, 4013, 20_001]);
        assert_eq!(occurring.stretch(), found);
    }

    #[test]
    fn steps_of_floating_point_numbers_are_found() {
        for (step, zero) in [(0.25, 0.0), (1.0 / 3.0, -20.5), (1.0 / 4095.0, 0.0), (1.0, -100.0), (16.0, 0.0)]
        {
            let values: Vec<f64> =
                converter(12).into_iter().map(|v| f64::from((f64::from(v) * step + zero) as f32)).collect();
            let found = of_numbers(&values).unwrap_or_else(|| panic!("{step}"));
            assert!((found.step / step - 1.0).abs() < 1e-5, "{step}: {found:?}");
        }
        let noise = |i: u32| 100.0 + PixelRng::new(3, Stream::Effect, 0, i, 0).normal();
        let mut values: Vec<f64> = (0..5000).map(|i| f64::from(noise(i) as f32)).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        assert_eq!(of_numbers(&values), None);
    }
}
