//! Offset drift: the black level wanders.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};
use crate::drift;

/// Black level plus rate * time.
pub struct OffsetDrift;

impl Effect for OffsetDrift {
    fn id(&self) -> &'static str {
        "offset-drift"
    }

    fn stage(&self) -> Stage {
        Stage::Converter
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            drift::SHAPE,
            Parameter {
                name: "dn_per_s",
                meaning: "shape 0: change of the black level per second",
                unit: "DN/s",
                min: -10.0,
                max: 10.0,
                starts: &[1e-3, -1e-3],
            },
            Parameter {
                name: "dn",
                meaning: "shape 1: excess of the black level at the start",
                unit: "DN",
                min: -1e4,
                max: 1e4,
                starts: &[1.0],
            },
            drift::TAU,
        ]
    }

    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        drift::starts(&[1e-3, -1e-3], 1.0, seen)
    }

    drift::in_time!();

    /// A glow fades locally; the black level moves everywhere.
    fn told_by(&self) -> &'static [&'static str] {
        &["profiles"]
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.0, 0.06 / (300.0 * plain.frame_s), 0.0, 60.0 * plain.frame_s])
    }

    fn page(&self) -> Page {
        Page {
            what: "The black level moves with temperature.",
            equation: "offset(t) = offset(0) + rate t; or offset(late) + dn exp(-t / tau)",
            signature: "darks and flats move with time by the same DN; no noise changes",
            look_alikes: "dark current that grows with temperature scales with exposure",
            remedy: "a black clamp; darks taken between the flats",
            measure: "short darks at start, middle and end",
            sets: takes::LONG,
            source: "Janesick 2007; EMVA 1288 release 4, section 6",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            *m += drift::change(p, frame.time_s);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let more = drift::change(p, d.time_s);
        d.image.mapv_inplace(|v| v + more);
    }
}
