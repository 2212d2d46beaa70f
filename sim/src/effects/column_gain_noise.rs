//! Column gain noise: the gain of a column's amplifier differs from frame to frame.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Stage, takes};

/// Gain factor 1 + rel N(0, 1) of each column in each frame.
pub struct ColumnGainNoise;

impl Effect for ColumnGainNoise {
    fn id(&self) -> &'static str {
        "column-gain-noise"
    }

    fn stage(&self) -> Stage {
        Stage::Amplifier
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "rel",
            meaning: "standard deviation of a column's gain from frame to frame, relative",
            unit: "1",
            min: 0.0,
            max: 0.1,
            starts: &[0.001],
        }]
    }

    /// Periodic interference correlates neighbouring columns; column gain noise does not.
    fn told_by(&self) -> &'static [&'static str] {
        &["covariance of column means", "variance of frame gradients"]
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.15 / libm::sqrt(plain.range_e)])
    }

    fn page(&self) -> Page {
        Page {
            what: "A column's amplifier or converter has a reference that is sampled anew for each frame: its gain differs from frame to frame.",
            equation: "v(column) (1 + rel N(0,1)) in every frame; variance of column means + (rel mu)^2",
            signature: "temporal variance of the column means, growing with the square of the signal; nothing in darks, nothing along the rows",
            look_alikes: "column noise is the same in darks",
            remedy: "a quieter reference; average frames",
            measure: "flats at several levels: the variance of the column means against the mean",
            sets: takes::PAIRS,
            source: "EMVA 1288 release 4, section 8 (column noise); Janesick 2007",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        for s in &mut out.sets {
            s.column.add((p[0] * s.signal).powi(2));
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        for x in 0..d.image.ncols() {
            let gain = 1.0 + p[0] * d.random(self.id(), d.frame, x as u32).normal();
            d.image.column_mut(x).mapv_inplace(|v| v * gain);
        }
    }
}
