//! Row noise: every row has its own noise in every frame.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};
use crate::predict::Ripple;

/// One normal number for each row and frame, added with the read noise; rows may have a part in common with
/// the next.
pub struct RowNoise;

/// Minimum number of bands in a frame if most of the noise is in bands, and if it is in single rows (named
/// choices; a band is as long as the correlation takes to fall to 1/e).
const MIN_BANDS: f64 = 10.0;
const MIN_BANDS_BESIDE_ROWS: f64 = core::f64::consts::LN_10;
/// Share of the variance in bands above which the noise is mostly in bands.
const MOSTLY: f64 = 0.5;

fn wanders(p: &[f64]) -> bool {
    p[0] >= 0.5
}

impl Effect for RowNoise {
    fn id(&self) -> &'static str {
        "row-noise"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["stripes", "horizontal lines", "horizontal stripes", "line noise"]
    }

    fn stage(&self) -> Stage {
        Stage::Read
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "shape",
                meaning: "0: every row by itself, 1: a part of it in bands of rows",
                unit: "choice",
                min: 0.0,
                max: 1.0,
                starts: &[0.0, 1.0],
            },
            Parameter {
                name: "e",
                meaning: "standard deviation of what a row shares in one frame",
                unit: "e",
                min: 0.0,
                max: 1e4,
                starts: &[0.5],
            },
            Parameter {
                name: "in_bands",
                meaning: "part of the variance that lies in bands",
                unit: "1",
                min: 0.0,
                max: 1.0,
                starts: &[],
            },
            Parameter {
                name: "next_row",
                meaning: "correlation of the bands from row to row",
                unit: "1",
                min: 0.0,
                max: 0.995,
                starts: &[],
            },
        ]
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        parameter < 2 || wanders(p)
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        wanders(p).then_some("in part shared by bands of rows")
    }

    /// Noise shared by all rows of a frame is not row noise: long bands move the mean of the frame as much as
    /// its rows.
    fn is_another(&self, p: &[f64], seen: &Seen) -> bool {
        let bands_per_frame = -libm::log(p[3]) * seen.rows;
        let least = if p[2] > MOSTLY { MIN_BANDS } else { MIN_BANDS_BESIDE_ROWS };
        wanders(p) && bands_per_frame < least
    }

    fn starts(&self, _: &Seen) -> Vec<Vec<f64>> {
        vec![
            vec![0.0, 0.5, 0.0, 0.0],
            vec![1.0, 0.5, 0.5, 0.5],
            vec![1.0, 0.5, 0.5, 0.9],
            vec![1.0, 0.5, 0.2, 0.5],
            vec![1.0, 0.5, 1.0, 0.9],
        ]
    }

    /// Interference in bursts is concentrated in few rows.
    fn told_by(&self) -> &'static [&'static str] {
        &["kurtosis of row means"]
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.0, 0.2 * plain.noise_e, 0.4, 0.8])
    }

    fn page(&self) -> Page {
        Page {
            what: "A supply, a reference or a sample circuit that a whole row shares is sampled once for each of them.",
            equation: "v(row) + e N(0,1) in every frame; variance of row means + e^2, of which the part in_bands is a first-order \
                       autoregression down the rows with the correlation next_row",
            signature: "temporal variance of the row means, the same at every level, darks too; nothing along the other axis",
            look_alikes: "periodic interference has a line in the spectrum; a fixed pattern of rows does not change with time",
            remedy: "subtract the mean of covered pixels of each row; a cleaner supply",
            measure: "a run of darks: the variance of the row means over what single pixels explain",
            sets: takes::DARKS,
            source: "EMVA 1288 release 4, section 8 (row noise); Janesick 2007",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        for s in &mut out.sets {
            let variance = p[1] * p[1];
            if wanders(p) {
                s.row.add((1.0 - p[2]) * variance);
                s.ripples.push((p[2] * variance, Ripple::Wander(p[3])));
            } else {
                s.row.add(variance);
            }
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        if !wanders(p) {
            d.add_to_lines(self.id(), 0, p[1]);
            return;
        }
        d.add_to_lines(self.id(), 0, p[1] * libm::sqrt(1.0 - p[2]));
        let (sd, fresh) = (p[1] * libm::sqrt(p[2]), libm::sqrt(1.0 - p[3] * p[3]));
        let mut wander = d.random("row-noise wander", d.frame, 0).normal();
        for y in 0..d.image.nrows() {
            d.image.row_mut(y).mapv_inplace(|v| v + sd * wander);
            wander = p[3] * wander + fresh * d.random("row-noise wander", d.frame, y as u32 + 1).normal();
        }
    }
}
