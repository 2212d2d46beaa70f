//! Periodic interference: a disturbance of one frequency during read-out.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// A sine with a new phase in every frame: in read-out order, where it goes on while the rows are blanked, in
/// step with the rows, or by row.
pub struct PeriodicInterference;

/// Read-out order that a disturbance meets.
#[derive(Clone, Copy, PartialEq)]
enum Shape {
    /// Pixels are read one after the other.
    InReadOutOrder,
    /// In step with the rows: stripes of columns.
    InStep,
    /// All columns of a row are converted at once: stripes of rows.
    ByRow,
}

impl Shape {
    fn of(p: &[f64]) -> Self {
        match p[3] {
            shape if shape < 0.5 => Self::InReadOutOrder,
            shape if shape < 1.5 => Self::InStep,
            _ => Self::ByRow,
        }
    }
}

/// Returns the cycles from one pixel to the next in its row, and from one row to the next.
fn cycles(p: &[f64], columns: usize) -> (f64, f64) {
    match Shape::of(p) {
        Shape::InReadOutOrder => (p[1], p[1] * columns as f64 + p[2]),
        Shape::InStep => (p[1], 0.0),
        Shape::ByRow => (0.0, p[1]),
    }
}

/// Maximum distance of a line from the Nyquist frequency, cycles per row, for which a start exactly at
/// Nyquist is added (a named choice).
const NEAR_HALF: f64 = 2.0;

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
                meaning: "its frequency in read-out order; shape 2: from row to row",
                unit: "1/px",
                min: 0.0,
                max: 0.5,
                starts: &[],
            },
            Parameter {
                name: "blanking_cycles",
                meaning: "shape 0: its phase between the last pixel of a row and the first of the next, without whole cycles: line blanking",
                unit: "1",
                min: -0.5,
                max: 0.5,
                starts: &[],
            },
            Parameter {
                name: "shape",
                meaning: "0: in read-out order, 1: in step with the rows, 2: by row, where all columns are converted at once",
                unit: "choice",
                min: 0.0,
                max: 2.0,
                starts: &[0.0, 1.0, 2.0],
            },
        ]
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        parameter != 2 || Shape::of(p) == Shape::InReadOutOrder
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        match Shape::of(p) {
            Shape::InReadOutOrder => None,
            Shape::InStep => Some("in step with the rows: stripes of columns"),
            Shape::ByRow => Some("all columns at once: stripes of rows"),
        }
    }

    /// Returns starts at the strongest line and at the strongest stripes of columns and of rows. If rows are
    /// blanked, the line is one tooth of a comb: starts lie on either side of it, with the phase that puts
    /// the tooth there. Without lines and stripes there is no start.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let columns = seen.columns.max(2.0);
        let start = |cycles_per_px: f64, blanking: f64, shape: f64| {
            vec![self.parameters()[0].starts[0], cycles_per_px.clamp(0.0, 0.5), blanking, shape]
        };
        let line = seen.line_cycles_per_px.into_iter();
        // Clock of half the pixel rate: its line is at Nyquist and aliases onto itself; a fit started beside
        // it does not reach it.
        let half = line.clone().filter(|f| 0.5 - f < NEAR_HALF / columns);
        let half = half.flat_map(|_| [0.0, 0.5].map(|blanking| start(0.5, blanking, 0.0)));
        let tooth =
            |f: f64| [0.0, -0.25, 0.25, -0.45, 0.45].map(|away| start(f + away / columns, -away, 0.0));
        let in_step = |f: f64| start(f, 0.0, 1.0);
        let by_row = |f: f64| start(f, 0.0, 2.0);
        // Row means do not determine the sign of the phase step from row to row.
        let mirrored = |f: f64| f + (1.0 - 2.0 * (f * columns).fract()) / columns;
        let line = line.flat_map(|f| [f, mirrored(f)]);
        let stripes = seen.column_cycles.map(in_step).into_iter();
        let of_rows = seen.row_cycles.into_iter().flatten().take(1).map(by_row);
        line.flat_map(tooth).chain(half).chain(stripes).chain(of_rows).collect()
    }

    /// Default: a camera without blanking between rows.
    fn usual(&self, parameter: usize) -> Option<f64> {
        (parameter == 2).then_some(0.0)
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.35 * plain.noise_e * plain.gain_dn_per_e, 0.0973, 0.0, 0.0])
    }

    fn page(&self) -> Page {
        Page {
            what: "A clock or a switching supply couples into the video signal while the frame is read.",
            equation: "v + a sin(2 pi (f n + b y) + phase), n the pixel's place in read-out order, y its row, b the cycles while a row is blanked; \
                       in step with the rows v + a sin(2 pi f x + phase), x the column; by row v + a sin(2 pi f y + phase); variance + a^2 / 2",
            signature: "a line in the noise's spectrum in read-out order; stripes whose place changes from frame to frame",
            look_alikes: "row noise is white from row to row; light bands vanish in the dark; a fixed phase would be fixed pattern",
            remedy: "shielding, a synchronised supply; a notch filter in read-out order",
            measure: "a run of darks and their spectrum in read-out order",
            sets: takes::DARKS,
            source: "Janesick 2001, ch. 7; EMVA 1288 release 4, section 8 (spectrogram)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let (across, down) = cycles(p, c.shape.1);
        let (across, down) = (std::f64::consts::TAU * across, std::f64::consts::TAU * down);
        for s in &mut out.sets {
            s.lines.push((0.5 * p[0] * p[0], across, down));
            // The fourth cumulant of a sine of random phase is -3/2 of the square of its variance.
            s.fourth -= 1.5 * 0.25 * p[0].powi(4);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let turn = std::f64::consts::TAU;
        let phase = turn * d.random(self.id(), d.frame, 0).uniform();
        let columns = d.image.ncols();
        let (across, down) = cycles(p, columns);
        for (n, v) in d.image.iter_mut().enumerate() {
            let cycles = across * (n % columns) as f64 + down * (n / columns) as f64;
            *v += p[0] * libm::sin(turn * cycles + phase);
        }
    }
}
