//! Illumination drift: the lamp slowly becomes brighter or darker.

use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};

/// Light times 1 + rate * time.
pub struct This;

impl Effect for This {
    fn id(&self) -> &'static str {
        "illumination-drift"
    }

    fn stage(&self) -> Stage {
        Stage::Light
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "rel_per_s", unit: "1/s", min: -0.05, max: 0.05, starts: &[1e-4, -1e-4] }]
    }

    fn page(&self) -> Page {
        Page {
            what: "The lamp warms up or ages during the campaign.",
            equation: "light(t) = light(0) (1 + rate t)",
            signature: "the repeated reference level moves with time, in proportion to the light; darks stand still",
            look_alikes: "gain drift moves dark charge and noise too; offset drift moves darks and flats by the same DN",
            remedy: "let the lamp warm up; repeat a reference level and divide it out",
            measure: "the same flat at start, middle and end, with darks of long exposure beside it",
            sets: takes::LONG,
            source: "EMVA 1288 release 4, section 6",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            let Some(info) = c.sets.get(frame.set).filter(|s| s.light.is_some()) else { continue };
            let light = *m - out.base.dark_e_per_s * info.exposure_s;
            *m += p[0] * frame.time_s * light;
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        d.image.scaled_add(p[0] * d.time_s * d.exposure_s, d.rate_e_per_s);
        d.image.mapv_inplace(|q| q.max(0.0));
    }
}
