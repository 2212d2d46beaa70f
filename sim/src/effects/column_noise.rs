//! Column noise: every column has its own noise in every frame.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Stage, takes};

/// One normal number for each column and frame, added with the read noise.
pub struct ColumnNoise;

impl Effect for ColumnNoise {
    fn id(&self) -> &'static str {
        "column-noise"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["stripes", "vertical lines", "vertical stripes"]
    }

    fn stage(&self) -> Stage {
        Stage::Read
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "e",
            meaning: "standard deviation of what a column shares in one frame",
            unit: "e",
            min: 0.0,
            max: 1e4,
            starts: &[0.5],
        }]
    }

    /// Periodic interference correlates neighbouring columns; column noise does not.
    fn told_by(&self) -> &'static [&'static str] {
        &["covariance of column means", "variance of frame gradients"]
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.2 * plain.noise_e])
    }

    fn page(&self) -> Page {
        Page {
            what: "A supply, a reference or a sample circuit that a whole column shares is sampled once for each of them.",
            equation: "v(column) + e N(0,1) in every frame; variance of column means + e^2",
            signature: "temporal variance of the column means, the same at every level, darks too; nothing along the other axis",
            look_alikes: "periodic interference has a line in the spectrum; a fixed pattern of columns does not change with time",
            remedy: "subtract the mean of covered pixels of each column; a cleaner supply",
            measure: "a run of darks: the variance of the column means over what single pixels explain",
            sets: takes::DARKS,
            source: "EMVA 1288 release 4, section 8 (column noise); Janesick 2007",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        for s in &mut out.sets {
            s.column.add(p[0] * p[0]);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        d.add_to_lines(self.id(), 1, p[0]);
    }
}
