//! Stray light: part of all light is spread over the whole image.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Stage, takes};

/// A share of the mean light falls on every pixel alike.
pub struct StrayLight;

impl Effect for StrayLight {
    fn id(&self) -> &'static str {
        "stray-light"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["light leak", "glare"]
    }

    fn stage(&self) -> Stage {
        Stage::Light
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "share",
            meaning: "share of the light that is spread over the image",
            unit: "1",
            min: 0.0,
            max: 0.9,
            starts: &[0.01],
        }]
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        None
    }

    fn page(&self) -> Page {
        Page {
            what: "Light is reflected between sensor, cover glass and lens and veils the image.",
            equation: "light' = (1 - s) light + s * mean light of the frame",
            signature: "nothing on an even flat; shading and fixed pattern of flats are veiled; the background of a scene is raised in \
                        proportion to all of its light",
            look_alikes: "smear keeps to columns; a background that is truly brighter looks the same: only a scene of known contrast tells",
            remedy: "baffles, a hood, a clean lens; subtract the veil",
            measure: "a black hole beside a bright patch, with the patch covered and not",
            sets: takes::SCENES,
            source: "ISO 9358 (veiling glare)",
        }
    }

    /// Predicts no change: an even flat stays the same, and the content of a scene is unknown.
    fn predict(&self, _: &[f64], _: &Campaign, _: &mut Prediction) {}

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let mean = d.rate_e_per_s.mean().unwrap_or(0.0);
        d.image.scaled_add(-p[0] * d.exposure_s, d.rate_e_per_s);
        d.image += p[0] * d.exposure_s * mean;
    }
}
