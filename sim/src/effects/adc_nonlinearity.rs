//! ADC nonlinearity: bits of the converter have wrong weights, so that codes have unequal widths.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Stage, takes};
use crate::normal::{AROUND, tail};
use crate::predict::{BITS, NORMAL, PLACES};

/// Weight errors of the six lowest bits, of the six highest, or of both.
pub struct AdcNonlinearity;

/// Number of bits at each end with a weight error of their own.
const EACH: usize = 6;

/// Builds the parameter of one bit. `max`: nearly half of the weight of a low bit, and nearly one code for
/// the lowest (named choices: larger errors would make the codes nonmonotonic).
const fn bit(name: &'static str, meaning: &'static str, max: f64) -> Parameter {
    Parameter { name, meaning, unit: "DN", min: -max, max, starts: &[0.05] }
}

const fn weight(bit: usize) -> f64 {
    (1u32 << bit) as f64
}

/// Returns the gain error of these bit errors: their component proportional to the weights (least squares).
fn gain_of(errors: &[f64]) -> f64 {
    let sum = |of: &dyn Fn(usize) -> f64| (0..errors.len()).map(of).sum::<f64>();
    sum(&|b| weight(b) * errors[b]) / sum(&|b| weight(b) * weight(b)).max(1.0)
}

/// Returns the errors of all bits of a converter of `bits` bits.
fn errors(p: &[f64], bits: usize) -> [f64; BITS] {
    let mut out = [0.0; BITS];
    let part = p[0].round() as i32;
    for k in 0..EACH.min(bits) {
        if part != 1 {
            out[k] += p[1 + k];
        }
        if part != 0 {
            out[bits - 1 - k] += p[1 + EACH + k];
        }
    }
    if part != 0 {
        // Nonlinearity is relative to the straight line, so the gain error is removed.
        let gain = gain_of(&out[..bits]);
        (0..bits).for_each(|b| out[b] -= gain * weight(b));
    }
    out
}

/// Excess of the voltage of a code, as steps at the codes where bits of wrong weight change.
struct Steps {
    /// Number of bits.
    bits: usize,
    /// Lowest bit whose error is not 0: a step stands at each multiple of its weight.
    lowest: usize,
    errors: [f64; BITS],
    /// Step where this bit is set and all below it are cleared, DN.
    height: [f64; BITS],
}

impl Steps {
    /// Builds the steps of the bits whose error is not 0.
    fn new(errors: [f64; BITS], bits: usize) -> Self {
        let lowest = errors[..bits].iter().position(|e| *e != 0.0).unwrap_or(bits);
        let mut height = errors;
        for b in lowest + 1..bits {
            height[b] = errors[b] - errors[lowest..b].iter().sum::<f64>();
        }
        Self { bits, lowest, errors, height }
    }

    /// Returns the excess between the step of this number and the next.
    fn sum(&self, number: usize) -> f64 {
        (self.lowest..self.bits)
            .filter(|b| number >> (b - self.lowest) & 1 == 1)
            .map(|b| self.errors[b])
            .sum()
    }

    /// Returns the mean over normal noise about a level, DN, and its slope with the level.
    fn over(&self, level: f64, sd: f64) -> (f64, f64) {
        let (apart, last) = (1usize << self.lowest, (1usize << (self.bits - self.lowest)) - 1);
        // A code begins half a step below its value. Steps beyond four deviations are passed or not reached.
        let edge = |number: usize| (number * apart) as f64 - 0.5;
        let place = |at: f64| (((at + 0.5) / apart as f64).max(0.0) as usize).min(last);
        let (from, to) = (place(level - 4.0 * sd), place(level + 4.0 * sd));
        let (mut mean, mut slope) = (self.sum(from), 0.0);
        for number in from + 1..=to {
            let height = self.height[self.lowest + number.trailing_zeros() as usize];
            let (density, passed) = tail((edge(number) - level) / sd);
            mean += height * passed;
            slope += height * density;
        }
        (mean, slope / sd)
    }
}

/// Number of bits whose steps, smoothed by the noise, need only a few Fourier terms.
const FINE: usize = 3;
/// Number of Fourier terms kept, counted in harmonics of the slowest of these bits. The next nonzero one is
/// the ninth: at most exp(-2 pi^2 81 / 64) = 1e-11.
const WAVES: usize = 7;

/// Mean and slope for noise of at least the weight of a bit: lower bits average out, the next `FINE` bits are
/// Fourier series of the level, and higher bits are steps.
struct Smooth {
    /// Weight of the lowest bit that counts, DN.
    apart: f64,
    full_scale_dn: f64,
    /// Half of the errors of the lower bits: each is set half of the time.
    below: f64,
    /// Errors of the bits with Fourier series.
    fine: [f64; FINE],
    above: Option<Steps>,
    /// Steps of all bits that are not lower.
    all: Steps,
}

impl Smooth {
    /// Builds the steps and Fourier terms; bits below `lowest` average out.
    fn new(mut errors: [f64; BITS], lowest: usize, bits: usize) -> Self {
        let below = 0.5 * errors[..lowest].iter().sum::<f64>();
        errors[..lowest].fill(0.0);
        let all = Steps::new(errors, bits);
        let fine = std::array::from_fn(|k| errors.get(lowest + k).copied().unwrap_or(0.0));
        errors[..(lowest + FINE).min(BITS)].fill(0.0);
        let above = errors.iter().any(|e| *e != 0.0).then(|| Steps::new(errors, bits));
        Self { apart: weight(lowest), full_scale_dn: weight(bits) - 1.0, below, fine, above, all }
    }

    /// Returns the Fourier coefficients after smoothing by the noise. A bit of the weight w is 1 in the
    /// second half of every 2 w: 1/2 less the sum over odd k of 2 / (pi k) sin(2 pi k x / 2 w). Noise
    /// multiplies each term by exp(-2 pi^2 k^2 sd^2 / (2 w)^2).
    fn waves(&self, sd: f64) -> [f64; WAVES] {
        let turns = sd / (8.0 * self.apart);
        let left = libm::exp(-2.0 * (std::f64::consts::PI * turns).powi(2));
        // Powers m^2, each from the one before.
        let (mut power, mut next) = (1.0, left);
        std::array::from_fn(|i| {
            power *= next;
            next *= left * left;
            let m = i + 1;
            let bit = FINE - 1 - m.trailing_zeros() as usize;
            let k = m >> m.trailing_zeros();
            -std::f64::consts::FRAC_2_PI / k as f64 * self.fine[bit] * power
        })
    }

    /// Returns the mean over normal noise about a level, DN, and its slope with the level. `waves`: Fourier
    /// coefficients for this noise.
    fn over(&self, level: f64, sd: f64, waves: &[f64; WAVES]) -> (f64, f64) {
        if sd < self.apart || level < 5.0 * sd || level > self.full_scale_dn - 5.0 * sd {
            let (mean, slope) = self.all.over(level, sd);
            return (self.below + mean, slope);
        }
        let (mut mean, mut slope) = self.above.as_ref().map_or((0.0, 0.0), |s| s.over(level, sd));
        let (sine, cosine) =
            libm::sincos(std::f64::consts::TAU * ((level + 0.5) / (8.0 * self.apart)).fract());
        let (mut sum, mut along) = (self.below + 0.5 * self.fine.iter().sum::<f64>(), 0.0);
        let (mut s, mut c) = (sine, cosine);
        for (i, wave) in waves.iter().enumerate() {
            sum += wave * s;
            along += wave * c * (i + 1) as f64;
            (s, c) = (s * cosine + c * sine, c * cosine - s * sine);
        }
        mean += sum;
        slope += along * std::f64::consts::TAU / (8.0 * self.apart);
        (mean, slope)
    }
}

fn depth(full_scale_dn: f64) -> usize {
    (libm::round(libm::log2(full_scale_dn + 1.0)) as usize).min(BITS)
}

impl Effect for AdcNonlinearity {
    fn id(&self) -> &'static str {
        "adc-nonlinearity"
    }

    fn stage(&self) -> Stage {
        Stage::Converter
    }

    fn parameters(&self) -> &'static [Parameter] {
        const ALL: [Parameter; 1 + 2 * EACH] = [
            Parameter {
                name: "bits",
                meaning: "0: the lowest six bits, 1: the highest six, 2: both",
                unit: "choice",
                min: 0.0,
                max: 2.0,
                starts: &[0.0, 1.0, 2.0],
            },
            bit("bit0_dn", "error of the weight of bit 0, counted from the lowest", 0.9),
            bit("bit1_dn", "error of the weight of bit 1, counted from the lowest", 0.9),
            bit("bit2_dn", "error of the weight of bit 2, counted from the lowest", 1.8),
            bit("bit3_dn", "error of the weight of bit 3, counted from the lowest", 3.6),
            bit("bit4_dn", "error of the weight of bit 4, counted from the lowest", 7.2),
            bit("bit5_dn", "error of the weight of bit 5, counted from the lowest", 14.4),
            bit("top0_dn", "error of the weight of bit 0, counted from the highest", 32.0),
            bit("top1_dn", "error of the weight of bit 1, counted from the highest", 32.0),
            bit("top2_dn", "error of the weight of bit 2, counted from the highest", 32.0),
            bit("top3_dn", "error of the weight of bit 3, counted from the highest", 32.0),
            bit("top4_dn", "error of the weight of bit 4, counted from the highest", 32.0),
            bit("top5_dn", "error of the weight of bit 5, counted from the highest", 32.0),
        ];
        &ALL
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        match (p[0].round() as i32, parameter) {
            (_, 0) => true,
            (0, k) => k <= EACH,
            (1, k) => k > EACH,
            _ => true,
        }
    }

    fn redundant(&self, p: &[f64], full_scale_dn: f64) -> Option<Vec<f64>> {
        let bits = depth(full_scale_dn);
        // With more than twelve bits the middle ones have no error and fix the gain.
        (p[0].round() as i32 == 2 && bits == 2 * EACH).then(|| {
            let low = (0..EACH).map(weight);
            let high = (0..EACH).map(|k| weight(bits - 1 - k));
            std::iter::once(0.0).chain(low).chain(high).collect()
        })
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        Some(match p[0].round() as i32 {
            0 => "the six lowest bits",
            1 => "the six highest bits, top0 the highest",
            _ => "the six lowest and the six highest bits",
        })
    }

    fn starts(&self, _: &super::Seen) -> Vec<Vec<f64>> {
        [0.0, 1.0, 2.0]
            .map(|part| {
                let mut p = vec![0.05; 1 + 2 * EACH];
                p[0] = part;
                p
            })
            .to_vec()
    }

    fn adds_scatter(&self) -> bool {
        false
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.0, 0.05, 0.0, 0.1, 0.0, -0.1, 0.0, 0.3, 0.0, -0.4, 0.0, 0.35, 0.0])
    }

    fn page(&self) -> Page {
        Page {
            what: "The capacitors of a successive-approximation converter do not match: some codes are wider than others.",
            equation: "V(c) = sum of bits (2^b + d_b); width of code c is V(c + 1) - V(c)",
            signature: "codes occur too often or too seldom, by a pattern of their bits; with high bits the means step by part of a code; variance \
                        hardly moves",
            look_alikes: "coarse quantisation leaves whole codes out",
            remedy: "dither (noise above a step hides it); a table of code widths",
            measure: "many samples over a wide range of levels: the histogram of the codes",
            sets: takes::SWEEP,
            source: "IEEE 1241-2010, histogram test",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let bits = depth(c.full_scale_dn);
        let wrong = errors(p, bits);
        out.bit_errors_dn.iter_mut().zip(wrong).for_each(|(sum, e)| *sum += e);
        // If the noise covers few codes, their widths show in each pixel's variance.
        let low = EACH.min(bits);
        let widths: f64 = wrong[..low].iter().map(|d| d * d).sum();
        for s in &mut out.sets {
            s.unsure = libm::hypot(s.unsure, 0.5 * widths * s.covariance(0, 0));
        }
        // A code is too small by the excess of its voltage: by its mean over the samples. The slope of the
        // excess multiplies their noise. Bits whose steps the samples cover many times average out.
        if wrong.iter().all(|e| *e == 0.0) {
            return;
        }
        let steps: Vec<Smooth> = (0..=low).map(|lowest| Smooth::new(wrong, lowest, bits)).collect();
        let mut shifts = vec![0.0; out.sets.len()];
        for (i, s) in out.sets.iter_mut().enumerate() {
            let level = s.signal + out.base.offset_dn;
            let (spread, places) = c.sets.get(i).map_or((0.0, &NORMAL), |s| (s.spread_dn, &s.places));
            let noise = libm::sqrt(s.covariance(0, 0).max(0.01) + (AROUND * spread).powi(2));
            let lowest = libm::log2(noise).floor().clamp(0.0, low as f64) as usize;
            let steps = &steps[lowest];
            let waves = steps.waves(noise);
            let (mut mean, mut slope) = (0.0, 0.0);
            for (x, share) in places.iter().zip(PLACES) {
                let of = steps.over(level + spread * x, noise, &waves);
                mean += share * of.0;
                slope += share * of.1;
            }
            shifts[i] = -mean;
            s.gain((1.0 - slope).max(0.1));
            s.signal -= mean;
        }
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            *m += shifts.get(frame.set).copied().unwrap_or(0.0);
        }
    }

    /// Converts by a search by bits: the code whose voltage is the nearest below the value plus half a step.
    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let offset = d.offset_dn;
        let bits = depth(d.full_scale_dn);
        let wrong = errors(p, bits);
        let weight: Vec<f64> = (0..bits).map(|b| (1u32 << b) as f64 + wrong[b]).collect();
        d.image.mapv_inplace(|v| {
            // The next code begins half a step above every code's own voltage.
            let mut left = v + offset + 0.5;
            let mut code = 0.0;
            for b in (0..bits).rev() {
                if left >= weight[b] {
                    left -= weight[b];
                    code += (1u32 << b) as f64;
                }
            }
            code - offset
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared with the sum over all steps, whose noise ends at four deviations: levels all over the range,
    /// noise between two weights.
    #[test]
    fn waves_and_steps_are_all_steps() {
        let mut p = vec![0.0; 1 + 2 * EACH];
        p[0] = 2.0;
        for (k, v) in p.iter_mut().enumerate().skip(1) {
            *v = 0.05 * ((7 * k) % 11) as f64 - 0.2;
        }
        let (bits, wrong) = (12, errors(&p, 12));
        let every = Smooth::new(wrong, 0, bits).all;
        for (lowest, sd) in [(0, 1.0), (0, 1.7), (1, 2.01), (2, 4.01), (3, 15.9), (6, 64.0), (6, 200.0)] {
            let smooth = Smooth::new(wrong, lowest, bits);
            let waves = smooth.waves(sd);
            for k in 0..400 {
                let level = 5.0 * sd + f64::from(k) * (4095.0 - 10.0 * sd) / 400.0;
                let (mean, slope) = smooth.over(level, sd, &waves);
                let all = every.over(level, sd);
                // Steps of up to 2 DN, of which 6e-5 lie beyond four deviations.
                assert!((mean - all.0).abs() < 1e-3, "{sd} at {level}: {mean}, summed {}", all.0);
                assert!((slope - all.1).abs() < 2e-3 / sd, "{sd} at {level}: {slope}, summed {}", all.1);
            }
        }
    }
}
