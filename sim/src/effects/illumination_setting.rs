//! Illumination setting: the light of every set has an error of its own.

use super::{Campaign, Drawing, Effect, Needs, Page, Parameter, Plain, Prediction, Stage, takes};

/// Each set's light times 1 + rel N(0, 1), the same for all its frames.
pub struct IlluminationSetting;

impl Effect for IlluminationSetting {
    fn id(&self) -> &'static str {
        "illumination-setting"
    }

    fn stage(&self) -> Stage {
        Stage::Light
    }

    fn is_of_the_lamp(&self) -> bool {
        true
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "rel",
            meaning: "standard deviation of the light from setting to setting, relative",
            unit: "1",
            min: 0.0,
            max: 0.3,
            starts: &[0.002],
        }]
    }

    fn needs(&self) -> Needs {
        Needs::Means
    }

    fn sets_each(&self) -> bool {
        true
    }

    /// Errors of a lamp's setting are drawn anew each time, are as large at long exposures as at short ones,
    /// and come in any order.
    fn told_by(&self) -> &'static [&'static str] {
        &[
            "light settings that come back",
            "light settings at long exposures",
            "step of light settings, in the order of the signal",
            "succession of light settings, in the order of the signal",
        ]
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.003])
    }

    fn page(&self) -> Page {
        Page {
            what: "The lamp does not come back to the same light when it is set again, or the exposure is not quite what was asked for: a \
                   whole set is brighter or darker than its nominal light.",
            equation: "light of a set = nominal light * (1 + rel N(0,1)); the frames of the set agree",
            signature: "means of sets scatter about any law, in proportion to the light; frames of one set agree, and variance over mean does not move",
            look_alikes: "a bend of the response is smooth in the level and moves the variance too; flicker scatters the frames of one set",
            remedy: "a light monitor, or repeat each level and compare by variance instead of by the nominal light",
            measure: "the same levels again in another order, with a photodiode beside the camera",
            sets: takes::SWEEP,
            source: "EMVA 1288 release 4, section 6 (irradiance is measured at every level)",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        for (s, light) in out.sets.iter_mut().zip(&out.light_e) {
            s.setting += (p[0] * light).powi(2);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        // A set lasts as long as its exposure, light and scene stay.
        let more = p[0] * d.random(self.id(), d.setting, 0).normal() * d.exposure_s;
        d.image.scaled_add(more, d.rate_e_per_s);
        d.image.mapv_inplace(|q| q.max(0.0));
    }
}
