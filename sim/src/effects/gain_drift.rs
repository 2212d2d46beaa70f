//! Gain drift: the amplifier's gain changes slowly.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};
use crate::drift;

/// A times 1 + rate * time.
pub struct GainDrift;

const RATE: Parameter = drift::relative_rate("shape 0: change of the gain per second, relative");
const EXCESS: Parameter = drift::relative_excess("shape 1: excess of the gain at the start, relative", 0.5);

impl Effect for GainDrift {
    fn id(&self) -> &'static str {
        "gain-drift"
    }

    /// Returns 2 ln 3: prior odds of 3 for a drift of the lamp (a named choice). Lamps drift by percents
    /// while they warm up, amplifiers by some 1e-4 per kelvin.
    fn rarer(&self) -> f64 {
        2.2
    }

    fn stage(&self) -> Stage {
        Stage::Amplifier
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[drift::SHAPE, RATE, EXCESS, drift::TAU]
    }

    drift::in_time!();

    /// Flats of two times are needed: darks show a drift of their noise only, which has other causes too.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        if seen.flat_sets < 2 { Vec::new() } else { drift::starts(&[1e-4, -1e-4], 0.01, seen) }
    }

    /// One amplifier serves all pixels.
    fn told_by(&self) -> &'static [&'static str] {
        &["profiles"]
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.0, 0.006 / (300.0 * plain.frame_s), 0.0, 60.0 * plain.frame_s])
    }

    fn is_drift_of_level(&self) -> bool {
        true
    }

    fn page(&self) -> Page {
        Page {
            what: "The camera warms up and its gain with it.",
            equation: "A(t) = A(0) (1 + rate t); or A(late) (1 + rel exp(-t / tau))",
            signature: "the repeated reference level moves with time; dark charge and all noise move with it",
            look_alikes: "illumination drift leaves dark charge and read noise alone: only dark charge or very many frames tell",
            remedy: "let the camera warm up; repeat a reference level",
            measure: "darks of long exposure at start and end: their signal moves with the gain and not with the lamp",
            sets: takes::LONG,
            source: "EMVA 1288 release 4, section 6; Janesick 2007",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let mut of_set = vec![(0.0, 0.0); c.sets.len()];
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            let gain = 1.0 + drift::change(p, frame.time_s);
            *m *= gain;
            if let Some(s) = of_set.get_mut(frame.set) {
                *s = (s.0 + gain * gain, s.1 + 1.0);
            }
        }
        for (s, (sum, n)) in out.sets.iter_mut().zip(of_set) {
            let square = if n > 0.0 { sum / n } else { 1.0 };
            s.scale(square);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let gain = 1.0 + drift::change(p, d.time_s);
        d.image.mapv_inplace(|v| v * gain);
    }
}
