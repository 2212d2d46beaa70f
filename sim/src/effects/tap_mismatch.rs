//! Tap mismatch: parts of the sensor are read through different amplifiers.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// Gain and offset of half of the pixels differ from those of the rest.
pub struct TapMismatch;

/// Returns true if a pixel of (rows, columns) belongs to the second tap: right half, lower half, odd columns,
/// odd rows.
fn second(kind: f64, (y, x): (usize, usize), (rows, columns): (usize, usize)) -> bool {
    match kind.round() as usize {
        0 => x >= columns / 2,
        1 => y >= rows / 2,
        2 => x % 2 == 1,
        _ => y % 2 == 1,
    }
}

impl Effect for TapMismatch {
    fn id(&self) -> &'static str {
        "tap-mismatch"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["seam", "tap balance", "channel mismatch"]
    }

    fn stage(&self) -> Stage {
        Stage::Amplifier
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "gain_rel",
                meaning: "gain of the second part over that of the first, less 1",
                unit: "1",
                min: -0.5,
                max: 0.5,
                starts: &[0.003],
            },
            Parameter {
                name: "offset_dn",
                meaning: "offset of the second part less that of the first",
                unit: "DN",
                min: -1e3,
                max: 1e3,
                starts: &[0.0, 1.0],
            },
            // Right half, lower half, odd columns, odd rows.
            Parameter {
                name: "parts",
                meaning: "0: right half, 1: lower half, 2: odd columns, 3: odd rows against the rest",
                unit: "choice",
                min: 0.0,
                max: 3.0,
                starts: &[0.0, 1.0, 2.0, 3.0],
            },
        ]
    }

    /// Error for offsets that scatter by 1 DN, over halves of 5000 pixels: sqrt(2 / 5000) DN.
    fn resolution(&self, parameter: usize, _: &[f64], _: &Seen) -> f64 {
        if parameter == 1 { 0.02 } else { 0.0 }
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.01, 1.0, 0.0])
    }

    fn page(&self) -> Page {
        Page {
            what: "Two taps have different gains or offsets: a step runs through the middle of the image, or every second line differs.",
            equation: "parts 0 right half, 1 lower half, 2 odd columns, 3 odd rows: v (1 + g) + o",
            signature: "a step between the middle columns (rows), or between odd and even ones, constant in darks (offset) and growing with the signal (gain)",
            look_alikes: "shading changes slowly; a step has no width",
            remedy: "balance the taps; K and the dark reference take it off at fixed settings",
            measure: "flats and darks: the step between the parts against the mean",
            sets: takes::SWEEP,
            source: "EMVA 1288 release 4, section 8",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        let tap = &mut out.taps[(p[2].round() as usize).min(3)];
        *tap = (tap.0 + p[0], tap.1 + p[1]);
        // Half of the pixels change: the mean follows by half.
        for m in &mut out.frame_signal {
            *m += 0.5 * (p[0] * *m + p[1]);
        }
        let square = 0.5 * (1.0 + (1.0 + p[0]) * (1.0 + p[0]));
        for s in &mut out.sets {
            s.signal += 0.5 * (p[0] * s.signal + p[1]);
            s.scale(square);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let shape = d.image.dim();
        for (_, v) in d.image.indexed_iter_mut().filter(|(at, _)| second(p[2], *at, shape)) {
            *v = *v * (1.0 + p[0]) + p[1];
        }
    }
}
