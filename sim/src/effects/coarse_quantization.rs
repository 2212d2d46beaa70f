//! Coarse quantisation: the camera converts with fewer bits than its format has.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// Steps of codes from which bits are cut.
const STEPS: [f64; 6] = [2.0, 4.0, 8.0, 16.0, 32.0, 64.0];

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
        &[Parameter {
            name: "step_dn",
            meaning: "every code is a multiple of this",
            unit: "DN",
            min: 1.0,
            max: 256.0,
            starts: &STEPS,
        }]
    }

    /// The step that the codes show, and usual ones.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let seen = seen.code_step_dn.filter(|s| *s > 1.2).map(f64::round);
        seen.into_iter().chain(STEPS).map(|s| vec![s]).collect()
    }

    fn is_whole(&self, _: usize) -> bool {
        true
    }

    /// A step of 4.003 codes, as of a scale from 1023 to 4095, leaves out the same share of them.
    fn resolution(&self, _: usize, _: &[f64], _: &Seen) -> f64 {
        0.01
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(vec![4.0])
    }

    fn scaled(&self, _values: &[f64], by: f64) -> Vec<f64> {
        vec![if by < 0.5 { 2.0 } else { 4.0 }]
    }

    fn page(&self) -> Page {
        Page {
            what: "A 10-bit converter hands out 12-bit words, or firmware drops bits: some codes never occur.",
            equation: "D = step * round(v / step); variance + (step^2 - 1) / 12",
            signature: "codes that are no multiple of the step never occur; variance higher by a constant",
            look_alikes: "unequal code widths leave no code out",
            remedy: "use the format of the converter's own depth; at a step above twice the noise q^2 / 12 no longer holds",
            measure: "the histogram of any flat",
            sets: takes::SWEEP,
            source: "Widrow and Kollar 2008, Quantization Noise, ch. 4 and 5",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        out.code_step_dn = p[0].max(1.0);
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let step = p[0].max(1.0);
        let offset = d.offset_dn;
        d.image.mapv_inplace(|v| libm::round((v + offset) / step) * step - offset);
    }
}
