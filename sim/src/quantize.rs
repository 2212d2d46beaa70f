//! Effect of rounding to whole steps on noise that covers about a step or less.

use crate::clipping::cut;
use crate::normal::PLACES as SHARES;
use crate::normal::{tail, upper};
use std::sync::OnceLock;

/// Statistics of rounded noise over many pixels, in steps.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rounded {
    /// Mean after rounding less the mean before.
    pub mean: f64,
    /// Change of the mean with the level: the factor on noise that pixels share.
    pub slope: f64,
    /// Mean of the pixels' variances less that before rounding: 1/12 for wide noise.
    pub variance: f64,
    /// Variance of the pixels' variances.
    pub unequal: f64,
    /// Mean of the pixels' fourth cumulants.
    pub fourth: f64,
}

/// Noise deviation, in steps, from which rounding adds 1/12 at every level: the error is exp(-2 pi^2 0.7^2) =
/// 6e-5.
const WIDE: f64 = 0.7;
/// Deviation of the pixels' levels, in steps, from which they are uniform between two codes.
const EVEN: f64 = 0.6;
/// Number of deviations, and of level positions between two codes, in the table.
const DEVIATIONS: usize = 70;
const PLACES: usize = 64;

/// Mean error, slope of the mean, variance and fourth cumulant of a pixel.
type Pixel = [f64; 4];

/// Computes the statistics for a level (0 is a code) and a deviation by sums over the codes.
fn exact(level: f64, sd: f64) -> Pixel {
    let below = |edge: f64| 0.5 * libm::erfc(-edge / (sd.max(1e-9) * std::f64::consts::SQRT_2));
    let codes = (-6..=6).map(|c| {
        let c = f64::from(c);
        (c, below(c + 0.5 - level) - below(c - 0.5 - level))
    });
    let codes: Vec<(f64, f64)> = codes.collect();
    let moment = |about: f64, k: i32| codes.iter().map(|(c, p)| p * (c - about).powi(k)).sum::<f64>();
    let mean = moment(0.0, 1);
    let (second, fourth) = (moment(mean, 2), moment(mean, 4));
    // Samples that pass an edge move by one code: the slope is the sum of the densities at the edges.
    let sd = sd.max(0.02);
    let density = |edge: f64| libm::exp(-0.5 * (edge / sd).powi(2)) / (sd * std::f64::consts::TAU.sqrt());
    let slope: f64 = (-6..6).map(|c| density(f64::from(c) + 0.5 - level)).sum();
    [mean - level, slope, second, fourth - 3.0 * second * second]
}

fn table() -> &'static [Pixel] {
    static TABLE: OnceLock<Vec<Pixel>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let row = |i: usize| {
            let sd = WIDE * i as f64 / DEVIATIONS as f64;
            (0..=PLACES).map(move |k| exact(k as f64 / PLACES as f64 - 0.5, sd))
        };
        (0..=DEVIATIONS).flat_map(row).collect()
    })
}

/// Returns points of a standard normal number up to three deviations, with the density at each.
fn levels() -> &'static [(f64, f64)] {
    const HALF: i32 = 24;
    static TABLE: OnceLock<Vec<(f64, f64)>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let at = |i: i32| 3.0 * f64::from(i) / f64::from(HALF);
        (-HALF..=HALF).map(|i| (at(i), tail(at(i)).0)).collect()
    })
}

/// Computes the statistics of rounded normal noise of this variance, in pixels whose levels have this mean
/// and deviation; all in steps, 0 is a code.
pub fn rounded(level: f64, spread: f64, variance: f64) -> Rounded {
    let place = variance.max(0.0).sqrt() / WIDE * DEVIATIONS as f64;
    if !place.is_finite() || place >= DEVIATIONS as f64 {
        return Rounded { slope: 1.0, variance: 1.0 / 12.0, fourth: -1.0 / 120.0, ..Default::default() };
    }
    let (row, down) = (place as usize * (PLACES + 1), place.fract());
    let table = table();
    let (above, below) = (&table[row..][..=PLACES], &table[row + PLACES + 1..][..=PLACES]);
    // Rounds up by a cast: processors without a vector instruction for it would call a function.
    let up = |x: f64| {
        let whole = x as i64 as f64;
        if x > whole { whole + 1.0 } else { whole }
    };
    let pixel = |level: f64| -> Pixel {
        let x = (level - up(level - 0.5) + 0.5).clamp(0.0, 1.0) * PLACES as f64;
        let k = (x as usize).min(PLACES - 1);
        let right = x - k as f64;
        let (a, b, c, d) = (above[k], above[k + 1], below[k], below[k + 1]);
        let between = |i: usize| {
            let (upper, lower) = (a[i] + right * (b[i] - a[i]), c[i] + right * (d[i] - c[i]));
            upper + down * (lower - upper)
        };
        [0, 1, 2, 3].map(between)
    };
    // Levels of the pixels: normal, up to three deviations.
    let spread = spread.min(EVEN);
    let mut sums = [0.0; 6];
    for &(t, w) in levels() {
        let [mean, slope, var, fourth] = pixel(level + spread * t);
        for (sum, v) in sums.iter_mut().zip([1.0, mean, slope, var, var * var, fourth]) {
            *sum += w * v;
        }
    }
    let [n, mean, slope, var, square, fourth] = sums;
    let var = var / n;
    Rounded {
        mean: mean / n,
        slope: slope / n,
        variance: var - variance.max(0.0),
        unequal: (square / n - var * var).max(0.0),
        fourth: fourth / n,
    }
}

/// Computes the statistics if half of the pixels lie `apart` steps above the others; `spread` is the
/// deviation of all of them.
pub fn rounded_apart(level: f64, spread: f64, apart: f64, variance: f64) -> Rounded {
    if apart.abs() < NEXT_TO_NONE {
        return rounded(level, spread, variance);
    }
    let own = (spread * spread - 0.25 * apart * apart).max(0.0).sqrt();
    let [a, b] = [-0.5, 0.5].map(|part| rounded(level + part * apart, own, variance));
    let half = |of: fn(&Rounded) -> f64| 0.5 * (of(&a) + of(&b));
    Rounded {
        mean: half(|r| r.mean),
        slope: half(|r| r.slope),
        variance: half(|r| r.variance),
        unequal: half(|r| r.unequal) + 0.25 * (a.variance - b.variance).powi(2),
        fourth: half(|r| r.fourth),
    }
}

/// Points and weights at which log-normal variances of the pixels are evaluated; points in standard
/// deviations of the logarithm (Gauss and Hermite's rule of three points; Abramowitz and Stegun 1972, table
/// 25.10).
const LOGNORMAL: [(f64, f64); 3] =
    [(-1.732_050_807_568_877_2, 1.0 / 6.0), (0.0, 2.0 / 3.0), (1.732_050_807_568_877_2, 1.0 / 6.0)];

/// Computes the statistics of rounded noise of pixels whose variances are log-normal about their mean.
/// `unlike` is the variance of the variances over the square of their mean.
pub fn rounded_unlike(level: f64, spread: f64, apart: f64, variance: f64, unlike: f64) -> Rounded {
    if unlike <= 0.0 || variance > WIDE * WIDE {
        return rounded_apart(level, spread, apart, variance);
    }
    let square = libm::log1p(unlike.min(10.0));
    let width = libm::sqrt(square);
    let all = LOGNORMAL.map(|(x, share)| {
        let own = variance * libm::exp(width * x - 0.5 * square);
        (share, rounded_apart(level, spread, apart, own))
    });
    let mean = |of: fn(&Rounded) -> f64| all.iter().map(|(share, r)| share * of(r)).sum::<f64>();
    let added = mean(|r| r.variance);
    Rounded {
        mean: mean(|r| r.mean),
        slope: mean(|r| r.slope),
        variance: added,
        unequal: mean(|r| r.unequal),
        fourth: mean(|r| r.fourth),
    }
}

/// Step between parts, in codes, below which it is ignored: it changes levels by less than a thousandth of a
/// code squared.
const NEXT_TO_NONE: f64 = 0.03;

/// Noise deviation, in steps, from which clipping at code 0 is treated as that of a continuous level: many
/// codes occur.
const MANY: f64 = 8.0;
/// Height above code 0, in noise deviations, from which levels are not clipped.
const CLEAR: f64 = 6.5;

/// Returns true if normal noise of this variance about these levels reaches code 0.
pub fn reaches_zero(level: f64, spread: f64, places: &[f64], variance: f64) -> bool {
    let lowest = places.iter().copied().fold(0.0, f64::min);
    level + spread * lowest < CLEAR * variance.max(0.0).sqrt() + 0.5
}

/// Noise deviation, in steps, from which rounding adds 1/12 to within exp(-2 pi^2) = 3e-9: precise enough for
/// the moments of the few codes that remain as a difference.
const SMOOTH: f64 = 1.0;
/// Depth below the first edge, in noise deviations, from which levels show code 0 alone: the rest is 6e-16.
const ALL_BELOW: f64 = 8.0;

/// Computes mean, slope of the mean, variance and fourth cumulant of max(code, 0) for a rounded level with
/// normal noise, by sums over the codes.
fn from_zero(level: f64, sd: f64) -> Pixel {
    if sd >= SMOOTH {
        return from_zero_of_wide(level, sd);
    }
    let sd = sd.max(0.02);
    let first = (level - 6.0 * sd).floor().max(0.0);
    let codes = ((level + 6.0 * sd).ceil() - first).max(0.0) as usize;
    let (mut passed, mut slope) = (0.0, 0.0);
    // Range: six deviations, each of less than a step, to both sides.
    let mut shares = [0.0; 16];
    for (k, share) in shares.iter_mut().enumerate().take(codes + 1) {
        let (density, below) = tail((level - first - k as f64 - 0.5) / sd);
        let here = if k == codes { 1.0 } else { below };
        *share = here - passed;
        passed = here;
        slope += density / sd;
    }
    let moment = |about: f64, power: i32| {
        shares.iter().enumerate().map(|(k, p)| p * (first + k as f64 - about).powi(power)).sum::<f64>()
    };
    let mean = moment(0.0, 1);
    let (second, fourth) = (moment(mean, 2), moment(mean, 4));
    [mean, slope, second, fourth - 3.0 * second * second]
}

/// Computes them where rounding adds 1/12 and nothing else: raw moments of all codes less those of the codes
/// below 0, which become 0.
fn from_zero_of_wide(level: f64, sd: f64) -> Pixel {
    // So far below 0 that every pixel shows code 0: the sum below would pass through each code down to the
    // level.
    if level + ALL_BELOW * sd < 0.5 {
        return [0.0; 4];
    }
    let variance = sd * sd + 1.0 / 12.0;
    let square = level * level;
    let fourth = square * square + 6.0 * square * variance + 3.0 * variance * variance - 1.0 / 120.0;
    let mut raw = [level, square + variance, level * (square + 3.0 * variance), fourth];
    let mut slope = 1.0;
    let below = |edge: f64| tail((level - edge) / sd);
    let (mut edge, (mut density, mut passed)) = (-0.5, below(-0.5));
    while passed > 1e-12 {
        let (next, lower) = below(edge - 1.0);
        let (code, share) = (edge - 0.5, passed - lower);
        let mut power = share;
        for moment in &mut raw {
            power *= code;
            *moment -= power;
        }
        slope -= density / sd;
        (edge, density, passed) = (edge - 1.0, next, lower);
    }
    let [mean, second, third, fourth] = raw;
    let square = mean * mean;
    let variance = second - square;
    let fourth = fourth - 4.0 * mean * third + 6.0 * square * second - 3.0 * square * square;
    // Slope of the mean: the densities at the edges above 0; those at all edges sum to 1.
    [mean, slope, variance, fourth - 3.0 * variance * variance]
}

/// Computes the statistics of rounded normal noise of this variance in pixels at these places; codes below 0
/// become 0; all in steps.
pub fn rounded_from_zero(level: f64, spread: f64, places: &[f64; SHARES.len()], variance: f64) -> Rounded {
    let variance = variance.max(0.0);
    let sd = variance.sqrt();
    let pixel = |level: f64| {
        if sd < MANY {
            return from_zero(level, sd);
        }
        // Mirrored: `cut` cuts off values above the limit.
        let left = cut(-level, variance, 0.0);
        let kept = 1.0 - left.above;
        [-left.mean, kept, left.variance + kept / 12.0, left.fourth]
    };
    let all = places.map(|x| pixel(level + spread * x));
    let average = |i: usize| all.iter().zip(SHARES).map(|(p, share)| share * p[i]).sum::<f64>();
    let second = average(2);
    let apart = |p: &Pixel| (p[2] - second) * (p[2] - second);
    Rounded {
        mean: average(0) - level,
        slope: average(1),
        variance: second - variance,
        unequal: all.iter().zip(SHARES).map(|(p, share)| share * apart(p)).sum(),
        fourth: average(3),
    }
}

/// Correction floor(a u + 1/2) of whole numbers u with normal noise, which firmware adds to a code.
#[derive(Debug, Clone, Copy)]
pub struct Correction {
    slope: f64,
    sd: f64,
    pattern: f64,
}

/// Maximum number of steps of a correction that are summed; with more, rounding does not matter.
const STEPS: usize = 64;

/// Gauss and Hermite's five points of a normal number, in deviations, and their weights (Abramowitz and
/// Stegun 1964, 25.10).
pub const NODES: [(f64, f64); 5] = [
    (0.0, 8.0 / 15.0),
    (1.355_626_179_974_266, 0.222_075_922_005_613),
    (-1.355_626_179_974_266, 0.222_075_922_005_613),
    (2.856_970_013_872_806, 0.011_257_411_327_721),
    (-2.856_970_013_872_806, 0.011_257_411_327_721),
];

impl Correction {
    /// Creates a correction of this slope for noise of this deviation; `pattern` is the deviation of the
    /// means of u from pixel to pixel.
    pub fn new(slope: f64, sd: f64, pattern: f64) -> Self {
        Self { slope: slope.abs(), sd: sd.max(1e-3), pattern }
    }

    /// Returns the u from which the correction is k. Whole numbers u reach it up to half a step before or
    /// after. This matters if the noise passes few thresholds; if it passes many, they lie anywhere between
    /// whole numbers. Only so much of the first Fourier term of this sawtooth is used that thresholds still
    /// fall as the slope grows: a fit then converges.
    fn threshold(&self, k: usize) -> f64 {
        let at = (k as f64 - 0.5) / self.slope;
        at + 0.45 * self.narrow() / std::f64::consts::PI * libm::sin(std::f64::consts::TAU * at)
    }

    /// Returns 1 if the noise passes hardly any threshold, 0 if it passes many.
    pub fn narrow(&self) -> f64 {
        (2.0 - 5.0 * self.slope * self.sd.hypot(self.pattern)).clamp(0.0, 1.0)
    }

    /// Returns the number of steps that matter; `None`: the slope is 0, or so many that rounding adds 1/12
    /// and nothing else.
    fn steps(&self) -> Option<usize> {
        let steps = self.slope * 6.0 * self.sd.hypot(self.pattern) + 2.0;
        (self.slope > 0.0 && steps < STEPS as f64).then_some(steps as usize)
    }

    /// Returns the slope of the correction on the noise, and the variance of the remainder: the regression of
    /// the rounded number on u, E[u r] / var u, and the rest of its variance in time (Bussgang 1952: for
    /// normal noise both follow from the thresholds).
    pub fn linear(&self) -> (f64, f64) {
        let Some(all) = self.of_pixels() else {
            return if self.slope == 0.0 { (0.0, 0.0) } else { (self.slope, 1.0 / 12.0) };
        };
        let (slope, variance) =
            all.iter().fold((0.0, 0.0), |(a, b), (share, s, v)| (a + share * s, b + share * v));
        (slope, (variance - slope * slope * self.sd * self.sd).max(0.0))
    }

    /// Returns the pixel-to-pixel variance of what the correction adds to the pixels' variances: its own
    /// variance, and `with` times its slope, since it follows the noise.
    pub fn unequal(&self, with: f64) -> f64 {
        let all = self.of_pixels().unwrap_or_default();
        let mean: f64 = all.iter().map(|(share, s, v)| share * (v + with * s)).sum();
        all.iter().map(|(share, s, v)| share * (v + with * s - mean) * (v + with * s - mean)).sum()
    }

    /// Returns share, slope and variance of the pixels at each node of the pattern; `None` if rounding does
    /// not matter.
    fn of_pixels(&self) -> Option<Vec<(f64, f64, f64)>> {
        let steps = self.steps()?;
        let thresholds: Vec<f64> = (1..=steps).map(|k| self.threshold(k)).collect();
        let nodes = if self.pattern > 0.0 { &NODES[..] } else { &[(0.0, 1.0)] };
        let of = |(x, share): &(f64, f64)| {
            let u = self.pattern * x;
            let (mut with, mut mean, mut square) = (0.0, 0.0, 0.0);
            for (k, t) in thresholds.iter().enumerate() {
                let (above, below) = ((t - u) / self.sd, (t + u) / self.sd);
                let ((at_above, above), (at_below, below)) = (tail(above), tail(below));
                with += at_above + at_below;
                mean += above - below;
                square += (2 * k + 1) as f64 * (above + below);
            }
            (*share, with / self.sd, square - mean * mean)
        };
        Some(nodes.iter().map(of).collect())
    }

    /// Returns the variance of u.
    pub fn variance(&self) -> f64 {
        self.sd * self.sd
    }

    /// Returns the share of the numbers that the correction changes.
    pub fn moves(&self) -> f64 {
        if self.slope > 0.0 { (2.0 * upper(self.threshold(1) / self.sd)).min(1.0) } else { 0.0 }
    }

    /// Returns the fourth cumulants of x + floor(a u + 1/2), where u = y - x, x and y are normal and
    /// independent, and x has the share var x / var u: four of it, three of it and one y, two of each, one
    /// and three. Given u, the rest of x is normal and shared with y. Only g = floor(a u + 1/2) - share u and
    /// w = (1 - share) u count. Between two thresholds g is linear: truncated moments of a normal number
    /// (Johnson, Kotz and Balakrishnan 1994, 13.10.1).
    pub fn fourth(&self, share: f64) -> [f64; 4] {
        let Some(steps) = self.steps() else { return [0.0; 4] };
        // No noise passes a threshold: only the rounding of the sums is left.
        if self.threshold(1) > 6.0 * self.sd {
            return [0.0; 4];
        }
        let (by, with) = (share * self.sd, (1.0 - share) * self.sd);
        // Moments E g^i w^j.
        let mut of = [[0.0; 5]; 5];
        let mut from = place(0.0);
        for k in 0..=steps {
            let to = place(if k < steps { self.threshold(k + 1) / self.sd } else { f64::INFINITY });
            // The other side of 0 is alike. g = k - by v for v deviations: the binomial theorem gives its
            // powers.
            let m = between(from, to);
            for (i, j) in [(2, 0), (1, 1), (4, 0), (3, 1), (2, 2), (1, 3)] {
                let choose = [
                    [1.0, 1.0, 0.0, 0.0, 0.0],
                    [1.0, 2.0, 1.0, 0.0, 0.0],
                    [1.0, 3.0, 3.0, 1.0, 0.0],
                    [1.0, 4.0, 6.0, 4.0, 1.0],
                ];
                let power =
                    |r: usize| choose[i - 1][r] * (k as f64).powi((i - r) as i32) * (-by).powi(r as i32);
                let sum: f64 = (0..=i).map(|r| power(r) * m[r + j]).sum();
                of[i][j] += 2.0 * with.powi(j as i32) * sum;
            }
            from = to;
        }
        let (gg, gw, ww) = (of[2][0], of[1][1], with * with);
        [
            of[4][0] - 3.0 * gg * gg,
            of[3][1] - 3.0 * gg * gw,
            of[2][2] - gg * ww - 2.0 * gw * gw,
            of[1][3] - 3.0 * ww * gw,
        ]
    }

    /// Returns the mean of the correction if u has this mean.
    pub fn mean(&self, u: f64) -> f64 {
        if self.slope == 0.0 || u.abs() * self.slope > 0.5 * STEPS as f64 || self.steps().is_none() {
            return self.slope * u;
        }
        let steps = (self.slope * (u.abs() + 6.0 * self.sd) + 2.0) as usize;
        let of = |k: usize| {
            let t = self.threshold(k);
            upper((t - u) / self.sd) - upper((t + u) / self.sd)
        };
        (1..=steps).map(of).sum()
    }
}

/// Point of a standard normal number: the point, the density there and the upper tail probability.
type Place = (f64, f64, f64);

fn place(x: f64) -> Place {
    let density =
        if x.is_finite() { libm::exp(-0.5 * x * x) / libm::sqrt(std::f64::consts::TAU) } else { 0.0 };
    // Cumulants are differences of these: the table's error of 1e-11 would swamp small ones.
    (x, density, 0.5 * libm::erfc(x * std::f64::consts::FRAC_1_SQRT_2))
}

/// Returns the partial moments 0 to 4 of a standard normal number between two points.
fn between(from: Place, to: Place) -> [f64; 5] {
    // x^n times the density, which is 0 far out.
    let at = |(x, density, _): Place, n: i32| if density > 0.0 { x.powi(n) * density } else { 0.0 };
    let mut m = [from.2 - to.2, at(from, 0) - at(to, 0), 0.0, 0.0, 0.0];
    for n in 2..5 {
        m[n] = (n - 1) as f64 * m[n - 2] + at(from, n as i32 - 1) - at(to, n as i32 - 1);
    }
    m
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared with sums over a grid by numpy 2.2: x - floor(a x + 1/2) of normal x.
    #[test]
    fn the_fourth_cumulant_is_that_of_a_grid() {
        for (slope, wide, variance, excess) in [
            (0.06, 0.15, 0.9977, -0.0410),
            (0.06, 0.25, 0.9508, -0.2759),
            (0.2, 0.3, 0.7772, -0.7034),
            (0.2, 0.5, 0.6578, -0.1253),
        ] {
            let sd: f64 = wide / slope;
            // A grid has no whole numbers u: its thresholds are not moved.
            let all = Correction { slope, sd, pattern: 0.0 };
            let got = all.fourth(1.0)[0] / (variance * sd * sd).powi(2);
            assert!((got - excess).abs() < 0.02, "{slope} {wide}: {got}, not {excess}");
        }
    }

    /// Successive frames of a filter of whole codes, compared with draws by numpy 2.2 (two million pixels of
    /// a level of 182 +- 5.5 DN, twelve frames before): alpha, noise, then the cumulants over the square of
    /// the variance. The drawn cumulants have errors of some 0.003.
    #[test]
    fn successive_frames_share_what_was_drawn() {
        for (alpha, noise, drawn) in [
            (0.03, 5.0, [-0.0546, 0.0438, -0.0275, 0.0133]),
            (0.03, 7.0, [-0.0611, 0.0506, -0.0316, 0.0155]),
            (0.06, 3.0, [-0.1171, 0.0929, -0.0651, 0.0293]),
            (0.06, 5.0, [-0.0493, 0.0415, -0.0275, 0.0134]),
        ] {
            let x: f64 = noise * noise + 1.0 / 12.0;
            let mut before = x;
            let with = |before: f64| Correction::new(alpha, (x + before).sqrt(), 0.0);
            for _ in 0..8 {
                let (slope, own) = with(before).linear();
                before = x * (1.0 - slope) / (1.0 + slope) + own / (1.0 - slope * slope);
            }
            let got = with(before).fourth(x / (x + before)).map(|c| c / (before * before));
            for (got, drawn) in got.iter().zip(drawn) {
                assert!((got - drawn).abs() < 0.012, "{alpha} {noise}: {got}, drawn {drawn}");
            }
        }
    }

    /// Compared with 10^6 draws each; tolerance five standard errors.
    #[test]
    fn codes_below_zero_come_out_as_zero() {
        use crate::rng::{PixelRng, Stream};
        for (level, sd) in [(0.0, 1.06), (0.7, 0.4), (-1.0, 2.0), (5.0, 12.0), (3.0, 0.5)] {
            let n = 1_000_000;
            let draw = |i: u32| {
                let v: f64 = level + sd * PixelRng::new(7, Stream::Effect, 0, i, 0).normal();
                v.round().max(0.0)
            };
            let all: Vec<f64> = (0..n).map(draw).collect();
            let mean = all.iter().sum::<f64>() / f64::from(n);
            let moment = |k: i32| all.iter().map(|v| (v - mean).powi(k)).sum::<f64>() / f64::from(n);
            let (second, fourth) = (moment(2), moment(4));
            let found = rounded_from_zero(level, 0.0, &[0.0; SHARES.len()], sd * sd);
            let error = (second / f64::from(n)).sqrt();
            assert!((found.mean + level - mean).abs() < 5.0 * error, "{level} {sd}: {found:?}, mean {mean}");
            let error = ((fourth - second * second) / f64::from(n)).sqrt();
            let got = found.variance + sd * sd;
            assert!((got - second).abs() < 5.0 * error, "{level} {sd}: {got}, drawn {second}");
            let got = found.fourth + 3.0 * got * got;
            let error = (moment(8) / f64::from(n)).sqrt();
            assert!((got - fourth).abs() < 5.0 * error, "{level} {sd}: {got}, drawn {fourth}");
        }
    }

    /// Half of the pixels lie a part of a code higher. Compared with 64 drawn frames; tolerance five standard
    /// errors.
    #[test]
    fn two_halves_are_rounded_each_where_it_lies() {
        use crate::rng::{PixelRng, Stream};
        let (level, own, apart, sd): (f64, f64, f64, f64) = (17.1, 0.15, 0.7, 0.25);
        let (pixels, frames) = (4000u32, 64u32);
        let mut variances = Vec::new();
        let mut sum = 0.0;
        for i in 0..pixels {
            let half = if i % 2 == 0 { -0.5 } else { 0.5 };
            let here = level + half * apart + own * PixelRng::new(5, Stream::Effect, 0, i, 1).normal();
            let mut random = PixelRng::new(5, Stream::Effect, 0, i, 0);
            let codes: Vec<f64> = (0..frames).map(|_| (here + sd * random.normal()).round()).collect();
            let mean = codes.iter().sum::<f64>() / f64::from(frames);
            let squares = codes.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
            variances.push(squares / f64::from(frames - 1));
            sum += mean;
        }
        let n = f64::from(pixels);
        let found = rounded_apart(level, own.hypot(0.5 * apart), apart, sd * sd);
        let variance = variances.iter().sum::<f64>() / n;
        let scatter = variances.iter().map(|v| (v - variance).powi(2)).sum::<f64>() / n;
        // Error of the mean: from the pixels' levels, and from their noise.
        let error = ((own * own + variance / f64::from(frames)) / n).sqrt();
        assert!((found.mean + level - sum / n).abs() < 5.0 * error, "{found:?} {}", sum / n);
        let error = (scatter / n).sqrt();
        assert!((found.variance + sd * sd - variance).abs() < 5.0 * error, "{found:?} {variance}");
        assert_eq!(rounded_apart(17.1, 0.3, 0.01, 0.04), rounded(17.1, 0.3, 0.04));
    }

    /// Both sums agree at the switch from one to the other, and a level far below 0 takes no time.
    #[test]
    fn wide_noise_below_zero_is_summed_alike() {
        for level in [-1e9, -7.0, -5.2, -3.0, -0.4, 0.0, 1.7, 30.0] {
            let narrow = from_zero(level, SMOOTH - 1e-9);
            let wide = from_zero_of_wide(level, SMOOTH);
            for (a, b) in narrow.iter().zip(wide) {
                // The fourth moment about 0 is some 1e6 at a level of 30.
                assert!((a - b).abs() < 1e-5, "{level}: {narrow:?} {wide:?}");
            }
        }
        assert_eq!(from_zero_of_wide(-1e300, 5.0), [0.0; 4]);
    }

    /// Levels spread over several codes: the mean variance is too small by the sum over k of exp(-(2 pi k
    /// sd)^2) / (2 pi^2 k^2) (Widrow and Kollar 2008, ch. 4).
    #[test]
    fn narrow_noise_loses_what_the_series_says() {
        for sd in [0.05f64, 0.12, 0.2, 0.31, 0.5, 0.9] {
            let term = |k: f64| {
                let turns = std::f64::consts::TAU * k * sd;
                (-turns * turns).exp() / (2.0 * (std::f64::consts::PI * k).powi(2))
            };
            let lost: f64 = (1..400).map(|k| term(f64::from(k))).sum();
            let found = rounded(17.3, 1.3, sd * sd);
            // Tolerance: linear interpolation in the table, and levels cut off at three deviations.
            assert!((found.variance - (1.0 / 12.0 - lost)).abs() < 1e-3, "{sd}: {found:?} {lost}");
            assert!(found.mean.abs() < 1e-3 && (found.slope - 1.0).abs() < 0.02, "{sd}: {found:?}");
        }
    }

    /// All pixels at one level: on a code and between two.
    #[test]
    fn a_level_on_a_code_and_between_two() {
        let on = rounded(5.0, 0.0, 0.04);
        assert!(on.mean.abs() < 1e-12 && on.variance < 0.0 && on.unequal < 1e-12, "{on:?}");
        let between = rounded(5.5, 0.0, 0.04);
        assert!((between.variance + 0.04 - 0.25).abs() < 0.02, "{between:?}");
        let wide = exact(0.3, 0.8);
        assert!((wide[2] - 0.64 - 1.0 / 12.0).abs() < 1e-4 && wide[0].abs() < 1e-4, "{wide:?}");
    }
}
