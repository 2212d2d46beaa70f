//! Full-well saturation: a pixel holds no more charge than its well.

use crate::clipping::{SoftLimit, clipped, clipped_softly};
use crate::predict::{NORMAL, SetPrediction};

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// Limit min(q, full well), or a knee above which the well fills ever more slowly.
pub struct FullWellSaturation;

/// Indexes of the parameters.
const FULL: usize = 0;
const SHAPE: usize = 1;
const SOFTNESS: usize = 2;

/// Minimum softness of a well without a knee: the power is its reciprocal.
const MIN_SOFTNESS: f64 = 0.02;

/// Returns the limit of a well that fills slowly; `None` if it is hard.
fn soft(p: &[f64]) -> Option<SoftLimit> {
    match p[SHAPE].round() as i32 {
        1 => Some(SoftLimit::above(p[FULL] * (1.0 - p[SOFTNESS]), p[FULL])),
        2 => Some(SoftLimit::gradual(p[FULL], p[SOFTNESS].max(MIN_SOFTNESS).recip())),
        _ => None,
    }
}

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
        const ALL: [Parameter; 3] = [
            Parameter {
                name: "full_well_e",
                meaning: "charge at which the well is full",
                unit: "e",
                min: 1.0,
                max: 1e9,
                starts: &[],
            },
            Parameter {
                name: "shape",
                meaning: "0: hard, 1: soft, the last part of the well fills ever more slowly, 2: soft without a knee",
                unit: "choice",
                min: 0.0,
                max: 2.0,
                starts: &[0.0, 1.0, 2.0],
            },
            Parameter {
                name: "softness",
                meaning: "shape 1: part of the well above the knee, 2: reciprocal of the power",
                unit: "1",
                min: 0.0,
                max: 0.5,
                starts: &[],
            },
        ];
        &ALL
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        parameter != SOFTNESS || soft(p).is_some()
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        match p[SHAPE].round() as i32 {
            1 => Some("a soft knee: the last part of the well fills ever more slowly"),
            2 => Some("a well that fills ever more slowly, without a knee"),
            _ => None,
        }
    }

    /// Returns starts near the brightest level.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        if !seen.shows_a_curve() {
            return Vec::new();
        }
        let hard = seen.near_peak().into_iter().map(|p| vec![p[FULL], 0.0, 0.0]);
        let peak_e = seen.peak_e.max(1.0);
        let soft = [0.95, 1.0, 1.03, 1.1]
            .into_iter()
            .flat_map(|part| [0.08, 0.15, 0.25].map(|softness| vec![part * peak_e, 1.0, softness]));
        let gradual = [1.0, 1.15, 1.4]
            .into_iter()
            .flat_map(|part| [0.08, 0.15, 0.25].map(|softness| vec![part * peak_e, 2.0, softness]));
        hard.chain(soft.chain(gradual).filter(|start| !seen.exceeds(start[FULL]))).collect()
    }

    fn contradicted(&self, p: &[f64], _: &[f64], seen: &Seen) -> Option<&'static str> {
        seen.exceeds(p[FULL]).then_some(super::BRIGHTER_PIXELS)
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.8 * plain.range_e, 0.0, 0.2])
    }

    fn scaled(&self, values: &[f64], by: f64) -> Vec<f64> {
        vec![values[FULL] * 2.0 / (1.0 + by), values[SHAPE], values[SOFTNESS]]
    }

    fn page(&self) -> Page {
        Page {
            what: "The well of a pixel is full: more light brings no more charge.",
            equation: "shape 0: q' = min(q, W), W = full well; 1: W - w exp(-(q - k) / w) above the knee k = W (1 - softness), w = W - k; 2: q / (1 + (q / W)^p)^(1 / p), p = 1 / softness",
            signature: "the mean stops and the variance falls to the read noise at one level, below the largest code",
            look_alikes: "clipping of the converter stops at the largest code; a bend goes on rising",
            remedy: "use the range below the turn-off",
            measure: "an exposure sweep in small steps up to and past saturation",
            sets: takes::SWEEP,
            source: "EMVA 1288 release 4, section 6 (saturation capacity)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        // Variance over mean of the charge at this stage.
        let shot: Vec<f64> = out.sets.iter().map(SetPrediction::shot_over_signal).collect();
        let limited = |set: usize, signal: f64| {
            let (spread, places) = c.sets.get(set).map_or((0.0, &NORMAL), |s| (s.spread, &s.places));
            let variance = shot.get(set).map_or(signal, |over| over * signal).max(1e-9);
            match soft(p) {
                Some(limit) => clipped_softly(signal, spread * signal, places, variance, limit),
                None => clipped(signal, spread * signal, places, variance, p[FULL]),
            }
        };
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            *m = limited(frame.set, *m).mean;
        }
        out.well_e = out.well_e.min(p[FULL]);
        let read = out.base.read_noise_e * out.base.read_noise_e;
        for (i, s) in out.sets.iter_mut().enumerate() {
            let left = limited(i, s.signal.max(1e-9));
            let shot = s.shot.lag(0, 0).max(1e-9);
            let less = (left.variance / shot).min(1.0);
            if let Some(limit) = soft(p) {
                let (spread, places) = c.sets.get(i).map_or((0.0, &NORMAL), |s| (s.spread, &s.places));
                let bent = places.map(|x| limit.of(s.signal * (1.0 + spread * x)));
                s.bend_shot(less, &left, limit.of(s.signal), places, &bent);
                continue;
            }
            s.cut(less, &left);
            s.cut_shot(less, left.above);
            // Nine level groups represent the pixels, so the share of pixels above the knee is uncertain.
            let rest = left.variance + read;
            // If nearly all pixels are clipped, the remaining noise is that of a few in the tails.
            let unknown = 0.1 + 0.9 * left.above.powi(4);
            s.unsure_var = libm::hypot(s.unsure_var, unknown * (1.0 - less) * left.variance);
            s.unsure = libm::hypot(s.unsure, left.unsure(less, rest));
            s.cut_light(left.above);
            s.signal = left.mean;
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        match soft(p) {
            Some(limit) => d.image.mapv_inplace(|q| limit.of(q)),
            None => d.image.mapv_inplace(|q| q.min(p[FULL])),
        }
    }
}
