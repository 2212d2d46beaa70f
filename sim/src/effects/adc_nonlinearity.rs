//! ADC nonlinearity: bits of the converter have wrong weights, so that codes have unequal widths.

use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};
use crate::predict::BITS;

/// The weight of each low bit is off by some part of a step.
pub struct This;

const fn bit(name: &'static str) -> Parameter {
    Parameter { name, unit: "DN", min: -0.9, max: 0.9, starts: &[0.05] }
}

impl Effect for This {
    fn id(&self) -> &'static str {
        "adc-nonlinearity"
    }

    fn stage(&self) -> Stage {
        Stage::Converter
    }

    fn parameters(&self) -> &'static [Parameter] {
        const BIT: [Parameter; BITS] =
            [bit("bit0_dn"), bit("bit1_dn"), bit("bit2_dn"), bit("bit3_dn"), bit("bit4_dn"), bit("bit5_dn")];
        &BIT
    }

    fn page(&self) -> Page {
        Page {
            what: "The capacitors of a successive-approximation converter do not match: some codes are wider than others.",
            equation: "V(c) = sum of bits (2^b + d_b); width of code c is V(c + 1) - V(c)",
            signature: "codes occur too often or too seldom, by a pattern of their bits; variance hardly moves",
            look_alikes: "coarse quantisation leaves whole codes out",
            remedy: "dither (noise above a step hides it); a table of code widths",
            measure: "many samples over a wide range of levels: the histogram of the codes",
            sets: takes::SWEEP,
            source: "IEEE 1241-2010, histogram test",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        for (b, d) in p.iter().take(BITS).enumerate() {
            out.bit_errors_dn[b] += d;
        }
        // Where the noise covers few codes their widths are in each pixel's variance.
        let widths: f64 = p.iter().map(|d| d * d).sum();
        for s in &mut out.sets {
            s.unsure = libm::hypot(s.unsure, 0.5 * widths * s.covariance(0, 0));
        }
    }

    /// The code whose voltage is the nearest below half a step, as a search by bits finds it.
    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let offset = d.offset_dn;
        let bits = libm::round(libm::log2(d.full_scale_dn + 1.0)) as usize;
        let weight: Vec<f64> =
            (0..bits).map(|b| (1u32 << b) as f64 + p.get(b).copied().unwrap_or(0.0)).collect();
        d.image.mapv_inplace(|v| {
            // Half a step above every code's own voltage the next begins.
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
