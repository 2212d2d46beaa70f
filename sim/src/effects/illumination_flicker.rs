//! Illumination flicker: the lamp is a little brighter or darker in each frame.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Stage, takes};

/// Each frame's light times 1 + rel N(0, 1).
pub struct IlluminationFlicker;

impl Effect for IlluminationFlicker {
    fn id(&self) -> &'static str {
        "illumination-flicker"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["flicker", "flickering", "lamp ripple"]
    }

    fn stage(&self) -> Stage {
        Stage::Light
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "rel",
            meaning: "standard deviation of the light from frame to frame, relative",
            unit: "1",
            min: 0.0,
            max: 0.5,
            starts: &[0.002],
        }]
    }

    fn shown_by(&self) -> Option<&'static str> {
        Some("variance of frame means")
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.003])
    }

    fn page(&self) -> Page {
        Page {
            what: "The lamp, its supply or its shutter varies from frame to frame; all pixels alike.",
            equation: "light of a frame = mean light * (1 + rel N(0,1)); variance of frame means + (rel mu)^2",
            signature: "scatter of the frame means in proportion to the light; nothing within a frame once its mean is taken off",
            look_alikes: "gain noise looks the same without a light monitor, except that dark charge shares it",
            remedy: "a stabilised, DC-driven lamp; exposures of whole mains periods; a monitor diode",
            measure: "a run of flats with a photodiode beside the camera",
            sets: takes::REFERENCE,
            source: "EMVA 1288 release 4, section 6 (stability of the light source)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        for (s, info) in out.sets.iter_mut().zip(&c.sets) {
            let light = s.signal - out.base.dark_e_per_s * info.exposure_s;
            let light = if info.light.is_some() { light } else { 0.0 };
            s.common += (p[0] * light).powi(2);
            s.with_light += (p[0] * light).powi(2);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let more = p[0] * d.random(self.id(), d.frame, 0).normal() * d.exposure_s;
        d.image.scaled_add(more, d.rate_e_per_s);
        d.image.mapv_inplace(|q| q.max(0.0));
    }
}
