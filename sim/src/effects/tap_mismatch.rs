//! Tap mismatch: the halves of the sensor are read through different amplifiers.

use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};

/// Gain and offset of the right half differ from the left's.
pub struct This;

impl Effect for This {
    fn id(&self) -> &'static str {
        "tap-mismatch"
    }

    fn stage(&self) -> Stage {
        Stage::Amplifier
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter { name: "gain_rel", unit: "1", min: -0.5, max: 0.5, starts: &[0.003, -0.003] },
            Parameter { name: "offset_dn", unit: "DN", min: -1e3, max: 1e3, starts: &[0.0] },
        ]
    }

    fn page(&self) -> Page {
        Page {
            what: "Two taps have different gains or offsets: a step runs through the middle of the image.",
            equation: "right half: v (1 + g) + o",
            signature: "a step between the middle columns, constant in darks (offset) and growing with the signal (gain)",
            look_alikes: "shading changes slowly; a step has no width",
            remedy: "balance the taps; K and the dark reference take it off at fixed settings",
            measure: "flats and darks: the step between the two middle columns against the mean",
            sets: takes::SWEEP,
            source: "EMVA 1288 release 4, section 8",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        out.taps = (out.taps.0 + p[0], out.taps.1 + p[1]);
        // Half of the pixels: the mean follows by half.
        for m in &mut out.frame_signal {
            *m += 0.5 * (p[0] * *m + p[1]);
        }
        let square = 0.5 * (1.0 + (1.0 + p[0]) * (1.0 + p[0]));
        for s in &mut out.sets {
            s.signal += 0.5 * (p[0] * s.signal + p[1]);
            s.shot.scale(square);
            s.read.scale(square);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let half = d.image.ncols() / 2;
        d.image.slice_mut(ndarray::s![.., half..]).mapv_inplace(|v| v * (1.0 + p[0]) + p[1]);
    }
}
