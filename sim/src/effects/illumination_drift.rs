//! Illumination drift: the light slowly becomes brighter or darker.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};
use crate::drift;

/// Light times 1 + rate * time, 1 + rel * exp(-time / tau), or exp(rate * time).
pub struct IlluminationDrift;

const RATE: Parameter = drift::relative_rate("shapes 0 and 2: change of the light per second, relative");
/// Excess at the start of the campaign: many times that at the first flat if the lamp is switched on after
/// the darks.
const EXCESS: Parameter = drift::relative_excess("shape 1: excess of the light at the start, relative", 5.0);

impl Effect for IlluminationDrift {
    fn id(&self) -> &'static str {
        "illumination-drift"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["warm-up", "lamp drift", "daylight", "twilight"]
    }

    fn stage(&self) -> Stage {
        Stage::Light
    }

    fn is_of_the_lamp(&self) -> bool {
        true
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[drift::SHAPE_OF_LIGHT, RATE, EXCESS, drift::TAU]
    }

    drift::in_time!();

    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        drift::starts(&[1e-4], 0.01, seen).into_iter().chain([vec![2.0, 1e-4, 0.0, 1.0]]).collect()
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.0, 0.006 / (300.0 * plain.frame_s), 0.01, 60.0 * plain.frame_s])
    }

    fn is_drift_of_level(&self) -> bool {
        true
    }

    fn page(&self) -> Page {
        Page {
            what: "The lamp warms up or ages during the campaign, or daylight fades.",
            equation: "shape 0: light(t) = light(0) (1 + rate t); shape 1: light(t) = light(late) (1 + rel exp(-t / tau)); shape 2: \
                       light(t) = light(0) exp(rate t)",
            signature: "the repeated reference level moves with time, in proportion to the light; darks stand still",
            look_alikes: "gain drift moves dark charge and noise too; offset drift moves darks and flats by the same DN",
            remedy: "let the lamp warm up; repeat a reference level and divide it out",
            measure: "the same flat at start, middle and end, with darks of long exposure beside it",
            sets: takes::LONG,
            source: "EMVA 1288 release 4, section 6",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let mut of_set = vec![(0.0, 0.0); c.sets.len()];
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            let Some(info) = c.sets.get(frame.set).filter(|s| s.light.is_some()) else { continue };
            let light = *m - out.base.dark_e_per_s * info.exposure_s;
            // Light is never negative.
            let more = drift::change(p, frame.time_s).max(-1.0) * light;
            *m += more;
            of_set[frame.set].0 += more;
            of_set[frame.set].1 += 1.0;
        }
        // Shot noise follows the light; a gain that drifts changes it with its square.
        for (s, (sum, n)) in out.sets.iter_mut().zip(of_set).filter(|(_, (_, n))| *n > 0.0) {
            s.signal += sum / n;
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        d.image.scaled_add(drift::change(p, d.time_s) * d.exposure_s, d.rate_e_per_s);
        d.image.mapv_inplace(|q| q.max(0.0));
    }
}
