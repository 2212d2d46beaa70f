//! Offset noise: the black level of each frame scatters.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Stage, takes};

/// Each frame's black level plus a normal number.
pub struct OffsetNoise;

impl Effect for OffsetNoise {
    fn id(&self) -> &'static str {
        "offset-noise"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["clamp noise", "black level noise", "dc noise"]
    }

    fn stage(&self) -> Stage {
        Stage::Converter
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "dn",
            meaning: "standard deviation of the black level from frame to frame",
            unit: "DN",
            min: 0.0,
            max: 1000.0,
            starts: &[0.1],
        }]
    }

    fn shown_by(&self) -> Option<&'static str> {
        Some("variance of frame means")
    }

    /// A light that blinks, or a level that wanders, shows in the succession of frames; a level that steps
    /// within a frame tilts it.
    fn told_by(&self) -> &'static [&'static str] {
        &["succession of frame means", "variance of frame gradients"]
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.05 * plain.noise_e * plain.gain_dn_per_e])
    }

    fn page(&self) -> Page {
        Page {
            what: "The black clamp finds another level in every frame: all pixels of a frame are shifted alike, darks as bright frames.",
            equation: "v + dn N(0,1), one number for each frame",
            signature: "scatter of the frame means, the same number of DN at every level, darks too; nothing within a frame once its mean is taken off",
            look_alikes: "flicker of the light scatters in proportion to the signal and leaves darks alone; an offset drift runs with time",
            remedy: "subtract the mean of covered pixels of each frame; a longer clamp; average frames",
            measure: "many short darks: the scatter of their means",
            sets: takes::DARKS,
            source: "Janesick 2007 (clamp noise); EMVA 1288 release 4, section 6.3 (the variance is taken about the frames' means)",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        out.sets.iter_mut().for_each(|s| s.common += p[0] * p[0]);
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let more = p[0] * d.random(self.id(), d.frame, 0).normal();
        d.image.mapv_inplace(|v| v + more);
    }
}
