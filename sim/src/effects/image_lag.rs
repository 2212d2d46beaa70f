//! Image lag: charge that stays behind and is read with the next frame.

use super::temporal_filter::running_average;
use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};

/// A share of a frame's charge is handed on to the next; of that, again a share, or all of it is read.
pub struct This;

/// What is read of this charge, where so much was held from before.
fn read(p: &[f64], charge: f64, held: f64) -> f64 {
    if p[1] >= 0.5 { (1.0 - p[0]) * (charge + held) } else { (1.0 - p[0]) * charge + held }
}

/// What is held for the next frame.
fn left(p: &[f64], charge: f64, held: f64) -> f64 {
    p[0] * if p[1] >= 0.5 { charge + held } else { charge }
}

impl Effect for This {
    fn id(&self) -> &'static str {
        "image-lag"
    }

    fn stage(&self) -> Stage {
        Stage::Transfer
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter { name: "fraction", unit: "1", min: 0.0, max: 0.5, starts: &[0.005] },
            // 0: the next frame has all of it; 1: it stays as other charge does.
            Parameter { name: "again", unit: "choice", min: 0.0, max: 1.0, starts: &[0.0, 1.0] },
        ]
    }

    fn page(&self) -> Page {
        Page {
            what: "The photodiode is not emptied: a share of the charge waits for the next read-out.",
            equation: "out_t = (1 - f) q_t + f q_(t-1); variance times (1 - f)^2 + f^2, covariance of successive frames f (1 - f); with \
                       again = 1 out_t = (1 - f) (q_t + f q_(t-1) + f^2 q_(t-2) + ...)",
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
        let mut held = 0.0;
        for m in &mut out.frame_signal {
            let charge = *m;
            *m = read(p, charge, held);
            held = left(p, charge, held);
        }
        let once = (1.0 - f) * (1.0 - f) + f * f;
        let (less, memory) =
            if p[1] >= 0.5 { running_average(f) } else { (once, vec![f * (1.0 - f) / once]) };
        for s in &mut out.sets {
            s.shot.scale(less);
            s.shot_memory.clone_from(&memory);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let held = d.memory.remove(self.id()).filter(|m| m.dim() == d.image.dim());
        let held = held.unwrap_or_else(|| ndarray::Array2::zeros(d.image.dim()));
        let next = ndarray::Zip::from(&d.image).and(&held).map_collect(|q, h| left(p, *q, *h));
        d.image.zip_mut_with(&held, |q, h| *q = read(p, *q, *h));
        d.memory.insert(self.id(), next);
    }
}
