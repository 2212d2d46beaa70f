//! An effect outside radcam's catalogue: the reference of the column converters is sampled anew for every
//! row, so that each row of each frame has its own gain.
//!
//! An effect draws and predicts. [`radcam_sim::effects::register`] registers it for every command: `effects`,
//! `model add`, `simulate`, `compare`, `diagnose`.

use radcam_sim::effects::{Drawing, Effect, Page, Parameter, Plain, Stage, takes};
use radcam_sim::predict::{Campaign, Prediction};

/// Row gain noise: the signal of each row is multiplied by 1 + rel N(0, 1), anew in every frame.
pub struct RowGainNoise;

impl Effect for RowGainNoise {
    fn id(&self) -> &'static str {
        "row-gain-noise"
    }

    fn stage(&self) -> Stage {
        Stage::Amplifier
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "rel",
            meaning: "standard deviation of a row's gain from frame to frame, relative",
            unit: "1",
            min: 0.0,
            max: 0.1,
            starts: &[0.001],
        }]
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.15 / plain.range_e.sqrt()])
    }

    fn page(&self) -> Page {
        Page {
            what: "The reference of the column converters is sampled for each row, with noise of its own.",
            equation: "v' = v (1 + rel N(0,1)), one number a row; variance of row means + (rel mu)^2",
            signature: "variance of row means growing as the square of the mean; darks are free of it",
            look_alikes: "row noise is the same at every level",
            remedy: "masked columns of known charge, divided out row by row",
            measure: "flats at several levels: the variance of row means against the mean",
            sets: takes::SWEEP,
            source: "an illustration, made for this example",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        // After the amplifier all values are in DN above the black level.
        for s in &mut out.sets {
            s.row.add((p[0] * s.signal).powi(2));
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        for y in 0..d.image.nrows() {
            let gain = 1.0 + p[0] * d.random(self.id(), d.frame, y as u32).normal();
            d.image.row_mut(y).mapv_inplace(|v| v * gain);
        }
    }
}
