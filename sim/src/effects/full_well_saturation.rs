//! Full-well saturation: a pixel holds no more charge than its well.

use crate::clipping::clipped;
use crate::predict::{NORMAL, SetPrediction};

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// min(q, full well).
pub struct FullWellSaturation;

impl Effect for FullWellSaturation {
    fn id(&self) -> &'static str {
        "full-well-saturation"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["saturation", "full well", "clipping"]
    }

    fn stage(&self) -> Stage {
        Stage::Well
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "full_well_e",
            meaning: "charge at which the well is full",
            unit: "e",
            min: 1.0,
            max: 1e9,
            starts: &[],
        }]
    }

    /// Near the brightest level.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        seen.near_peak()
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.8 * plain.range_e])
    }

    fn scaled(&self, values: &[f64], by: f64) -> Vec<f64> {
        vec![values[0] * 2.0 / (1.0 + by)]
    }

    fn page(&self) -> Page {
        Page {
            what: "The well of a pixel is full: more light brings no more charge.",
            equation: "q' = min(q, full well)",
            signature: "the mean stops and the variance falls to the read noise at one level, below the largest code",
            look_alikes: "clipping of the converter stops at the largest code",
            remedy: "use the range below the turn-off",
            measure: "an exposure sweep in small steps up to and past saturation",
            sets: takes::SWEEP,
            source: "EMVA 1288 release 4, section 6 (saturation capacity)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        // Variance over mean of the charge that has come so far.
        let shot: Vec<f64> = out.sets.iter().map(SetPrediction::shot_over_signal).collect();
        let limited = |set: usize, signal: f64| {
            let (spread, places) = c.sets.get(set).map_or((0.0, &NORMAL), |s| (s.spread, &s.places));
            let variance = shot.get(set).map_or(signal, |over| over * signal).max(1e-9);
            clipped(signal, spread * signal, places, variance, p[0])
        };
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            *m = limited(frame.set, *m).mean;
        }
        out.well_e = out.well_e.min(p[0]);
        let read = out.base.read_noise_e * out.base.read_noise_e;
        for (i, s) in out.sets.iter_mut().enumerate() {
            let left = limited(i, s.signal.max(1e-9));
            let less = (left.variance / s.shot.lag(0, 0).max(1e-9)).min(1.0);
            s.cut(less, &left);
            s.cut_shot(less, left.above);
            // The pixels' places are a few shares: which of them lie above the knee is known roughly.
            let rest = left.variance + read;
            // Where nearly all are cut, what is left is of a few in the tails.
            let unknown = 0.1 + 0.9 * left.above.powi(4);
            s.unsure_var = libm::hypot(s.unsure_var, unknown * (1.0 - less) * left.variance);
            s.unsure = libm::hypot(s.unsure, left.unsure(less, rest));
            s.cut_light(left.above);
            s.signal = left.mean;
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        d.image.mapv_inplace(|q| q.min(p[0]));
    }
}
