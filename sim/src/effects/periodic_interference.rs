//! Periodic interference: a disturbance of one frequency during read-out.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// A sine in read-out order, with a new phase in every frame.
pub struct PeriodicInterference;

impl Effect for PeriodicInterference {
    fn id(&self) -> &'static str {
        "periodic-interference"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["hum", "interference", "moving pattern"]
    }

    fn stage(&self) -> Stage {
        Stage::Converter
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "amplitude_dn",
                meaning: "amplitude of the line",
                unit: "DN",
                min: 0.0,
                max: 1e4,
                starts: &[0.3],
            },
            Parameter {
                name: "cycles_per_px",
                meaning: "its frequency in read-out order",
                unit: "1/px",
                min: 0.0,
                max: 0.5,
                starts: &[],
            },
        ]
    }

    /// At the strongest line that was measured; without one there is nothing to look for.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        seen.line_cycles_per_px.map(|line| vec![self.parameters()[0].starts[0], line]).into_iter().collect()
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.35 * plain.noise_e * plain.gain_dn_per_e, 0.0973])
    }

    fn page(&self) -> Page {
        Page {
            what: "A clock or a switching supply couples into the video signal while the frame is read.",
            equation: "v + a sin(2 pi f n + phase), n the pixel's place in read-out order; variance + a^2 / 2",
            signature: "a line in the noise's spectrum in read-out order; stripes whose place changes from frame to frame",
            look_alikes: "row noise is white from row to row; a fixed phase would be fixed pattern",
            remedy: "shielding, a synchronised supply; a notch filter in read-out order",
            measure: "a run of darks and their spectrum in read-out order",
            sets: takes::DARKS,
            source: "Janesick 2001, ch. 7; EMVA 1288 release 4, section 8 (spectrogram)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let across = std::f64::consts::TAU * p[1];
        for s in &mut out.sets {
            s.lines.push((0.5 * p[0] * p[0], across, across * c.shape.1 as f64));
            // The fourth cumulant of a sine of random phase is -3/2 of the square of its variance.
            s.fourth -= 1.5 * 0.25 * p[0].powi(4);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let turn = std::f64::consts::TAU;
        let phase = turn * d.random(self.id(), d.frame, 0).uniform();
        for (n, v) in d.image.iter_mut().enumerate() {
            *v += p[0] * libm::sin(turn * p[1] * n as f64 + phase);
        }
    }
}
