//! Exposure offset: the effective exposure is the commanded one plus a constant.

use super::{Campaign, Drawing, Effect, Needs, Page, Parameter, Plain, Prediction, Stage, takes};

/// effective = commanded + t0, for light.
pub struct ExposureOffset;

impl Effect for ExposureOffset {
    fn id(&self) -> &'static str {
        "exposure-offset"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["exposure time", "shutter delay"]
    }

    fn stage(&self) -> Stage {
        Stage::Light
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "t0_s",
            meaning: "effective less commanded exposure",
            unit: "s",
            min: -1.0,
            max: 1.0,
            starts: &[1e-6, -1e-6, 1e-4],
        }]
    }

    fn needs(&self) -> Needs {
        Needs::Means
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![5e-4 * plain.bright_s])
    }

    fn page(&self) -> Page {
        Page {
            what: "The electronic shutter opens or closes a fixed time early or late.",
            equation: "effective exposure = commanded exposure + t0",
            signature: "mean against exposure is a straight line that misses zero, in proportion to the light",
            look_alikes: "smear does the same on flats, but on a scene only in the columns through what is bright; a toe of the response near black takes the same from every light",
            remedy: "add t0 to every exposure; vary the light at a fixed exposure",
            measure: "a still scene with a bright patch at a long and at a short exposure",
            sets: takes::SCENES,
            source: "EMVA 1288 release 4, section 6 (linearity by exposure time)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        super::smear::longer(p[0], c, out);
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        d.image.scaled_add(p[0], d.rate_e_per_s);
        d.image.mapv_inplace(|q| q.max(0.0));
    }
}
