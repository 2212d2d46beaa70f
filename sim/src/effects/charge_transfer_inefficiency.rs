//! Charge transfer inefficiency: each transfer leaves a little charge behind.

use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};

/// A share per transfer is deferred to the pixel behind, along columns (towards row 0) and along rows (towards column 0); below nothing
/// towards the last row and the last column.
pub struct This;

/// Share deferred after n transfers.
fn deferred(per_transfer: f64, n: f64) -> f64 {
    (per_transfer.abs() * n).min(0.5)
}

impl Effect for This {
    fn id(&self) -> &'static str {
        "charge-transfer-inefficiency"
    }

    fn stage(&self) -> Stage {
        Stage::Transfer
    }

    fn parameters(&self) -> &'static [Parameter] {
        const STARTS: &[f64] = &[1e-5];
        &[
            Parameter { name: "parallel_per_transfer", unit: "1", min: -0.01, max: 0.01, starts: STARTS },
            Parameter { name: "serial_per_transfer", unit: "1", min: -0.01, max: 0.01, starts: STARTS },
        ]
    }

    fn keeps_sign(&self) -> bool {
        true
    }

    fn page(&self) -> Page {
        Page {
            what: "Traps hold charge while it is shifted to the output and free it into the packet behind.",
            equation: "after n transfers: out(y) = (1 - n e) q(y) + n e q(y - 1), n = y; e < 0: the output lies at the other end",
            signature: "pixels correlated along the axis of transfer, more the farther from the output; a trail behind bright edges",
            look_alikes: "a read-out low-pass is the same everywhere and correlates darks; crosstalk correlates both axes alike",
            remedy: "a fat zero; slower clocks; correct from the trail",
            measure: "flats: the covariance along the axis in bands of rows, near the output and far from it",
            sets: takes::PAIRS,
            source: "Janesick 2001, ch. 5; Massey et al. 2010, MNRAS 401, 371",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let far = (c.shape.0 as f64, c.shape.1 as f64);
        let mean = (deferred(p[0], 0.5 * far.0), deferred(p[1], 0.5 * far.1));
        for s in &mut out.sets {
            s.shot.shape(|ky, kx| {
                let h = |w: f64, k: f64| (1.0 - w) * (1.0 - w) + 2.0 * w * (1.0 - w) * libm::cos(k) + w * w;
                h(mean.0, ky) * h(mean.1, kx)
            });
            // Of w (1 - w) between both ends.
            let growth = |e: f64, n: f64| (deferred(e, n) * (1.0 - deferred(e, n))).copysign(e);
            s.growth.0 += growth(p[1], far.1);
            s.growth.1 += growth(p[0], far.0);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let (rows, columns) = d.image.dim();
        for (axis, e) in p.iter().enumerate().filter(|(_, e)| **e != 0.0) {
            let side = if *e > 0.0 { 1 } else { -1 };
            let behind = if axis == 0 { d.shifted(side, 0) } else { d.shifted(0, side) };
            for ((y, x), q) in d.image.indexed_iter_mut() {
                let (place, end) = if axis == 0 { (y, rows) } else { (x, columns) };
                let transfers = if *e > 0.0 { place } else { end - 1 - place };
                let w = deferred(*e, transfers as f64);
                *q = (1.0 - w) * *q + w * behind[(y, x)];
            }
        }
    }
}
