//! Temporal filter: the camera averages successive frames.

use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};

/// A running average with weight 1 - alpha for the new frame.
pub struct This;

/// What y_t = (1 - a) x_t + a y_(t-1) makes of independent noise: its variance, relative, and the correlations over 1, 2, ... frames
/// (an autoregression of the first order: Box and Jenkins 1976, 3.2.3).
pub(super) fn running_average(a: f64) -> (f64, Vec<f64>) {
    ((1.0 - a) / (1.0 + a), (1..=8).map(|k| libm::pow(a, f64::from(k))).collect())
}

impl Effect for This {
    fn id(&self) -> &'static str {
        "temporal-filter"
    }

    fn stage(&self) -> Stage {
        Stage::Firmware
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "alpha", unit: "1", min: 0.0, max: 0.9, starts: &[0.05] }]
    }

    fn page(&self) -> Page {
        Page {
            what: "Firmware noise reduction mixes each frame with the ones before.",
            equation: "y_t = (1 - alpha) v_t + alpha y_(t-1); variance times (1 - alpha) / (1 + alpha), correlation alpha^k over k frames",
            signature: "successive frames correlated, darks too; variance down in darks and flats; first frames after a change carry the \
                        old level",
            look_alikes: "image lag carries charge only: read noise of darks is uncorrelated in time",
            remedy: "switch it off (TemporalNoiseReduction, 3DNR); it also smears what moves",
            measure: "a long run of darks: their correlation from frame to frame",
            sets: takes::TRANSITIONS,
            source: "EMVA 1288 release 4, section 2; GenICam SFNC",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        let a = p[0];
        let mut last: Option<f64> = None;
        for m in &mut out.frame_signal {
            let now = (1.0 - a) * *m + a * last.unwrap_or(*m);
            (*m, last) = (now, Some(now));
        }
        let (less, memory) = running_average(a);
        for s in &mut out.sets {
            let before = s.covariance(0, 0);
            s.shot.scale(less);
            s.read.scale(less);
            (s.row, s.column, s.common) = (s.row * less, s.column * less, s.common * less);
            s.follow(before);
            (s.shot_memory, s.read_memory) = (memory.clone(), memory.clone());
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        if let Some(last) = d.memory.get(self.id()).filter(|m| m.dim() == d.image.dim()) {
            d.image = &d.image * (1.0 - p[0]) + last * p[0];
        }
        d.memory.insert(self.id(), d.image.clone());
    }
}
