//! Image lag: charge that stays behind and is read with the next frame.

use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};

/// A share of a frame's charge is handed on to the next.
pub struct This;

impl Effect for This {
    fn id(&self) -> &'static str {
        "image-lag"
    }

    fn stage(&self) -> Stage {
        Stage::Transfer
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "fraction", unit: "1", min: 0.0, max: 0.5, starts: &[0.005] }]
    }

    fn page(&self) -> Page {
        Page {
            what: "The photodiode is not emptied: a share of the charge waits for the next read-out.",
            equation: "out_t = (1 - f) q_t + f q_(t-1); variance times (1 - f)^2 + f^2, correlation of successive frames f (1 - f)",
            signature: "the first frame after a change of level carries the one before; darks after bright frames are raised; steady \
                        levels are right, with slightly less variance",
            look_alikes: "a temporal filter correlates the read noise of darks too, and lasts several frames",
            remedy: "throw away the first frame after a change; a longer reset; charge flushing",
            measure: "darks straight after a bright flat, and a bright flat straight after darks",
            sets: takes::TRANSITIONS,
            source: "Fossum and Hondongwa 2014, IEEE JEDS 2(3); Janesick 2007",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        let f = p[0];
        let mut last = 0.0;
        for m in &mut out.frame_signal {
            let now = *m;
            *m = (1.0 - f) * now + f * last;
            last = now;
        }
        let less = (1.0 - f) * (1.0 - f) + f * f;
        for s in &mut out.sets {
            s.shot.scale(less);
            s.shot_memory = vec![f * (1.0 - f) / less];
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let now = d.image.clone();
        d.image.mapv_inplace(|q| (1.0 - p[0]) * q);
        if let Some(last) = d.memory.get(self.id()).filter(|m| m.dim() == now.dim()) {
            d.image.scaled_add(p[0], last);
        }
        d.memory.insert(self.id(), now);
    }
}
