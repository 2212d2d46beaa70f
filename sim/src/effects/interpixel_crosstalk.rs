//! Interpixel crosstalk: charge or capacitance shared with the neighbours before the amplifier.

use super::{Campaign, Drawing, Effect, Needs, Page, Parameter, Plain, Prediction, Seen, Stage, takes};
use crate::predict::Filter;

/// Each pixel gives a share to its neighbours.
pub struct InterpixelCrosstalk;

/// Returns the shares that go to each neighbour in the row and to each in the column.
fn shares(p: &[f64]) -> (f64, f64) {
    match p[1].round() as i32 {
        0 => (p[0], p[0]),
        1 => (p[0], 0.0),
        2 => (0.0, p[0]),
        _ => (p[0], p[2]),
    }
}

impl Effect for InterpixelCrosstalk {
    fn id(&self) -> &'static str {
        "interpixel-crosstalk"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["crosstalk", "blur"]
    }

    fn stage(&self) -> Stage {
        Stage::Charge
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "a",
                meaning: "share of the charge that goes to each neighbour",
                unit: "1",
                min: 0.0,
                max: 0.2,
                starts: &[0.005],
            },
            Parameter {
                name: "shape",
                meaning: "0: to all four neighbours alike, 1: to those in the row, 2: to those in the column, 3: to both with shares of their own",
                unit: "choice",
                min: 0.0,
                max: 3.0,
                starts: &[0.0],
            },
            Parameter {
                name: "a_column",
                meaning: "of shape 3: share that goes to each neighbour in the column; a is that in the row",
                unit: "1",
                min: 0.0,
                max: 0.2,
                starts: &[0.002],
            },
        ]
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        parameter < 2 || p[1] >= 2.5
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        Some(match p[1].round() as i32 {
            0 => "to all four neighbours alike",
            1 => "along the rows only",
            2 => "along the columns only",
            _ => "along rows and columns with shares of their own",
        })
    }

    fn starts(&self, _: &Seen) -> Vec<Vec<f64>> {
        [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.002), (3.0, 0.008)]
            .map(|(shape, a_column)| vec![0.005, shape, a_column])
            .to_vec()
    }

    fn needs(&self) -> Needs {
        Needs::Covariances
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.008, 0.0, 0.0])
    }

    fn page(&self) -> Page {
        Page {
            what: "Charge diffuses, or capacitance couples, to the neighbours after it was counted by shot noise.",
            equation: "q' = (1 - 2 a - 2 b) q + a (q_left + q_right) + b (q_up + q_down); power times \
                       (1 - 2 a - 2 b + 2 a cos k_x + 2 b cos k_y)^2; b = a, 0 or its own",
            signature: "slope of the photon-transfer line falls, nearest covariance over variance is constant (about 2 a); read \
                        noise in darks stays uncorrelated",
            look_alikes: "brighter-fatter's covariance grows as mu^2; a read-out low-pass correlates darks too, along the rows only",
            remedy: "the gain from variance alone is too low by 1 - 4 a - 4 b: add the covariances to the variance; deconvolve images",
            measure: "flats with their covariances at several levels, and darks",
            sets: takes::PAIRS,
            source: "Moore, Ninkov and Forrest 2006, Opt. Eng. 45, 076402",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        let (a, b) = shares(p);
        let h = |ky: f64, kx: f64| {
            let h = 1.0 - 2.0 * a * (1.0 - libm::cos(kx)) - 2.0 * b * (1.0 - libm::cos(ky));
            h * h
        };
        let filter = Filter::new(&h);
        // At this stage there is only charge.
        out.sets.iter_mut().for_each(|s| s.filter(&filter));
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let (a, b) = shares(p);
        let (column, row) = (d.shifted(1, 0) + d.shifted(-1, 0), d.shifted(0, 1) + d.shifted(0, -1));
        d.image = &d.image * (1.0 - 2.0 * a - 2.0 * b) + row * a + column * b;
    }
}
