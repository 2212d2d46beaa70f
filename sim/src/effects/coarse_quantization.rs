//! Coarse quantisation: the camera converts with fewer bits than its format has, or multiplies its codes.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// Steps of codes from which bits are cut.
const STEPS: [f64; 6] = [2.0, 4.0, 8.0, 16.0, 32.0, 64.0];

/// Index of `zero_dn`.
const ZERO: usize = 1;

/// Deviation of a step from a whole number, relative, up to which it is one: 4.003 of a scale from 1023 to
/// 4095 is three codes off at full scale, and none (a named choice).
const WHOLE: f64 = 1e-4;

/// The step, to whole codes where it is one.
fn to_whole(step: f64) -> f64 {
    if (step / step.round() - 1.0).abs() < WHOLE { step.round() } else { step }
}

/// What rounding each of some codes to a whole one adds to the mean, one standard deviation, DN, where noise
/// and shading together cover so many steps. A bound of the root mean squares over tables and levels that
/// tests/outside/companding.py prints.
pub(super) fn rounded_mean(steps: f64) -> f64 {
    0.29 / libm::sqrt(1.0 + 3.5 * steps)
}

/// The same of the variance, over the step, DN.
pub(super) const ROUNDED_VARIANCE: f64 = 0.3;

/// Codes are multiples of a step.
pub struct CoarseQuantization;

impl Effect for CoarseQuantization {
    fn id(&self) -> &'static str {
        "coarse-quantization"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["posterization", "posterisation", "missing codes", "8 bits"]
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

    /// The step that the codes show, and usual ones.
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

    /// A step of 4.003 codes, as of a scale from 1023 to 4095, leaves out the same share of them.
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
        // Multiplied codes are rounded to whole ones, each by its own part of one: the bounds that a table of
        // roots has too.
        for (i, s) in out.sets.iter_mut().enumerate() {
            let spread = c.sets.get(i).map_or(0.0, |s| s.spread_dn);
            let total = libm::hypot(spread, libm::sqrt(s.covariance(0, 0).max(0.0)));
            s.unsure_mean = libm::hypot(s.unsure_mean, rounded_mean(total / step));
            s.unsure_own = libm::hypot(s.unsure_own, ROUNDED_VARIANCE * step);
            s.uneven = libm::hypot(s.uneven, rounded_mean(total / step));
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let (step, offset) = (p[0].max(1.0), d.offset_dn - p[ZERO]);
        d.image.mapv_inplace(|v| libm::round((v + offset) / step) * step - offset);
    }
}
