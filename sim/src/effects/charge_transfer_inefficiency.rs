//! Charge transfer inefficiency: each transfer leaves a little charge behind.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// A share per transfer is deferred to the pixel behind, along columns (towards row 0) and along rows
/// (towards column 0). Negative values transfer towards the last row and the last column. Full traps hold no
/// more.
pub struct ChargeTransferInefficiency;

/// Returns the charge deferred after n transfers, and its derivative with respect to the charge.
fn deferred(p: &[f64], per_transfer: f64, n: f64, charge: f64) -> (f64, f64) {
    let w = (per_transfer.abs() * n).min(0.5);
    if p[0] < 0.5 {
        return (w * charge, w);
    }
    // Traps fill: a constant share at little charge, a constant amount at much.
    let fill = 1.0 + charge.max(0.0) / p[3].max(1e-9);
    (w * charge / fill, w / (fill * fill))
}

impl Effect for ChargeTransferInefficiency {
    fn id(&self) -> &'static str {
        "charge-transfer-inefficiency"
    }

    fn stage(&self) -> Stage {
        Stage::Transfer
    }

    fn parameters(&self) -> &'static [Parameter] {
        const STARTS: &[f64] = &[1e-5];
        &[
            Parameter {
                name: "shape",
                meaning: "0: in proportion to the charge, 1: traps that fill",
                unit: "choice",
                min: 0.0,
                max: 1.0,
                starts: &[0.0, 1.0],
            },
            Parameter {
                name: "parallel_per_transfer",
                meaning: "share left behind at each transfer along the columns; the sign says at which end the output lies",
                unit: "1",
                min: -0.01,
                max: 0.01,
                starts: STARTS,
            },
            Parameter {
                name: "serial_per_transfer",
                meaning: "the same along the rows",
                unit: "1",
                min: -0.01,
                max: 0.01,
                starts: STARTS,
            },
            Parameter {
                name: "full_e",
                meaning: "shape 1: charge at which half of the traps are full",
                unit: "e",
                min: 1.0,
                max: 1e7,
                starts: &[],
            },
        ]
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        parameter < 3 || p[0] >= 0.5
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        Some(if p[0] >= 0.5 { "traps that fill" } else { "in proportion to the charge" })
    }

    fn keeps_sign(&self) -> bool {
        true
    }

    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let peak = seen.peak_e.max(10.0);
        let with = |shape: f64, full: f64| vec![shape, 1e-5, 1e-5, full];
        vec![with(0.0, peak), with(1.0, 0.03 * peak), with(1.0, 0.3 * peak)]
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.0, 0.03 / plain.rows, 0.0, 0.3 * plain.range_e])
    }

    fn page(&self) -> Page {
        Page {
            what: "Traps hold charge while it is shifted to the output and free it into the packet behind.",
            equation: "after n transfers: out(y) = q(y) - w(q(y)) + w(q(y - 1)), n = y; shape 0: w(q) = n e q; shape 1: w(q) = n e q / (1 + q / \
                       full_e); e < 0: the output lies at the other end",
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
        for s in &mut out.sets {
            let share = |e: f64, n: f64| deferred(p, e, n, s.signal).1;
            let (down, across) = (share(p[1], 0.5 * far.0), share(p[2], 0.5 * far.1));
            s.shot.shape(|ky, kx| {
                let h = |w: f64, k: f64| (1.0 - w) * (1.0 - w) + 2.0 * w * (1.0 - w) * libm::cos(k) + w * w;
                h(down, ky) * h(across, kx)
            });
            // Difference of w (1 - w) between both ends.
            let growth = |e: f64, n: f64| (share(e, n) * (1.0 - share(e, n))).copysign(e);
            let more = (growth(p[2], far.1), growth(p[1], far.0));
            s.growth = (s.growth.0 + more.0, s.growth.1 + more.1);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let (rows, columns) = d.image.dim();
        for (axis, e) in p[1..3].iter().enumerate().filter(|(_, e)| **e != 0.0) {
            let side = if *e > 0.0 { 1 } else { -1 };
            let behind = if axis == 0 { d.shifted(side, 0) } else { d.shifted(0, side) };
            for ((y, x), q) in d.image.indexed_iter_mut() {
                let (place, end) = if axis == 0 { (y, rows) } else { (x, columns) };
                let n = (if *e > 0.0 { place } else { end - 1 - place }) as f64;
                *q += deferred(p, *e, n, behind[(y, x)]).0 - deferred(p, *e, n, *q).0;
            }
        }
    }
}
