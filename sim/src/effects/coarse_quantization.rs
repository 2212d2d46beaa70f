//! Coarse quantisation: the camera converts with fewer bits than its format has, or multiplies its codes.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// Steps of codes with truncated bits.
const STEPS: [f64; 6] = [2.0, 4.0, 8.0, 16.0, 32.0, 64.0];

/// Index of `zero_dn`.
const ZERO: usize = 1;

/// Tolerance for treating a step as a whole number (a named choice). A step of 4.003 (4095/1023) is 3 codes
/// off at full scale, so it is not whole.
const WHOLE: f64 = 1e-4;

/// Rounds the step to whole codes if it is whole.
fn to_whole(step: f64) -> f64 {
    if (step / step.round() - 1.0).abs() < WHOLE { step.round() } else { step }
}

/// Returns an upper bound of the standard error of a mean, DN, after a noninteger step is rounded to whole
/// codes. `steps`: standard deviation of the level distribution in steps; at 0 the bound is 1/root 12. This
/// bound and the next hold for root mean squares over grids and levels
/// (`multiplied_codes_are_within_the_bounds`).
fn rounded_mean(steps: f64) -> f64 {
    1.0 / (libm::sqrt(12.0) * (1.0 + 0.45 * steps))
}

/// Returns the error of a variance over the step, one standard deviation, DN, from the same rounding.
fn rounded_variance(steps: f64) -> f64 {
    0.03 + 0.24 * libm::sqrt(steps)
}

/// Rounding of codes to multiples of a step.
pub struct CoarseQuantization;

impl Effect for CoarseQuantization {
    fn id(&self) -> &'static str {
        "coarse-quantization"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["posterization", "posterisation", "missing codes", "8 bits", "digital gain", "digital shift"]
    }

    fn stage(&self) -> Stage {
        Stage::Converter
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "step_dn",
                meaning: "distance of successive codes",
                unit: "DN",
                min: 1.0,
                max: 256.0,
                starts: &STEPS,
            },
            Parameter {
                name: "zero_dn",
                meaning: "a code from which all others are whole numbers of steps away",
                unit: "DN",
                min: -128.0,
                max: 128.0,
                starts: &[],
            },
        ]
    }

    /// Default of models written before the parameter existed.
    fn usual(&self, parameter: usize) -> Option<f64> {
        (parameter == ZERO).then_some(0.0)
    }

    /// Returns starts from the measured step, then from the steps of truncated bits.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let line = (seen.stretch_dn > 1.0).then(|| vec![to_whole(seen.stretch_dn), seen.stretch_zero_dn]);
        let share = seen.code_step_dn.filter(|s| *s > 1.2 && line.is_none()).map(f64::round);
        line.into_iter().chain(share.into_iter().chain(STEPS).map(|s| vec![s, 0.0])).collect()
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        (p[0].fract() != 0.0).then_some("codes multiplied after conversion, as by a digital gain")
    }

    fn is_whole(&self, _: usize) -> bool {
        true
    }

    /// A step of 4.003 (4095/1023) omits the same share of the codes as a step of 4.
    fn resolution(&self, _: usize, _: &[f64], _: &Seen) -> f64 {
        0.01
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(vec![4.0, 0.0])
    }

    fn scaled(&self, values: &[f64], by: f64) -> Vec<f64> {
        vec![if by < 0.5 { 2.0 } else { 4.0 }, values[ZERO]]
    }

    fn page(&self) -> Page {
        Page {
            what: "A 10-bit converter hands out 12-bit words, firmware drops bits, or a digital gain multiplies the codes: some codes never occur.",
            equation: "D = zero + step * round((v - zero) / step), rounded; variance + (step^2 - 1) / 12",
            signature: "codes that are no multiple of the step never occur; variance higher by a constant",
            look_alikes: "unequal code widths leave no code out",
            remedy: "use the format of the converter's own depth; at a step above twice the noise q^2 / 12 no longer holds",
            measure: "the histogram of any flat",
            sets: takes::SWEEP,
            source: "Widrow and Kollar 2008, Quantization Noise, ch. 4 and 5",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let step = p[0].max(1.0);
        (out.code_step_dn, out.code_zero_dn) = (step, p[ZERO]);
        if step.fract() == 0.0 {
            return;
        }
        // Each multiplied code is rounded by its own part of a code.
        for (i, s) in out.sets.iter_mut().enumerate() {
            let spread = c.sets.get(i).map_or(0.0, |s| s.spread_dn);
            let noise = libm::sqrt(s.covariance(0, 0).max(0.0));
            s.unsure_mean = libm::hypot(s.unsure_mean, rounded_mean(libm::hypot(spread, noise) / step));
            s.unsure_own = libm::hypot(s.unsure_own, step * rounded_variance(noise / step));
            s.uneven = libm::hypot(s.uneven, rounded_mean(noise / step));
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let (step, offset) = (p[0].max(1.0), d.offset_dn - p[ZERO]);
        d.image.mapv_inplace(|v| libm::round((v + offset) / step) * step - offset);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::normal::upper;
    use crate::rng::{PixelRng, Stream};

    /// Mean and variance of normal levels, converted in steps and rounded to whole codes, against those
    /// of the codes before they are rounded: the root mean squares over 4000 lines and levels lie within
    /// the bounds, and above half of them.
    #[test]
    fn multiplied_codes_are_within_the_bounds() {
        for steps in [0.1, 0.3, 1.0, 3.0, 10.0] {
            let (mut mean, mut variance, mut n) = (0.0, 0.0, 0.0);
            for k in 0..4000u32 {
                let random = |place: u64| PixelRng::new(11, Stream::Effect, place, k, 0).uniform();
                let (step, zero, level) = (1.01 + 5.0 * random(0), random(1), 500.0 * random(2));
                let deviation = steps * step;
                let mut sums = [0.0; 4];
                let middle = ((level - zero) / step).round() as i64;
                let reach = (5.0 * steps) as i64 + 2;
                for code in middle - reach..=middle + reach {
                    let line = zero + step * code as f64;
                    let edge = |by: f64| upper((line + by * step - level) / deviation);
                    let (share, sent) = (edge(-0.5) - edge(0.5), line.round());
                    let parts = [sent, sent * sent, line, line * line];
                    sums.iter_mut().zip(parts).for_each(|(sum, part)| *sum += share * part);
                }
                let off = sums[0] - sums[2];
                let changed = (sums[1] - sums[0] * sums[0]) - (sums[3] - sums[2] * sums[2]);
                (mean, variance, n) = (mean + off * off, variance + (changed / step).powi(2), n + 1.0);
            }
            let (mean, variance) = (f64::sqrt(mean / n), f64::sqrt(variance / n));
            let bound = rounded_mean(steps);
            assert!((0.5 * bound..bound).contains(&mean), "{steps} steps: mean {mean}, bound {bound}");
            let bound = rounded_variance(steps);
            assert!(
                (0.5 * bound..bound).contains(&variance),
                "{steps} steps: variance {variance}, bound {bound}"
            );
        }
    }
}
