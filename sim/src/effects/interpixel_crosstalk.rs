//! Interpixel crosstalk: charge or capacitance shared with the neighbours before the amplifier.

use super::{Campaign, Drawing, Effect, Needs, Page, Parameter, Plain, Prediction, Stage, takes};
use crate::predict::Filter;

/// Each pixel gives a share to each of its four neighbours.
pub struct InterpixelCrosstalk;

impl Effect for InterpixelCrosstalk {
    fn id(&self) -> &'static str {
        "interpixel-crosstalk"
    }

    fn stage(&self) -> Stage {
        Stage::Charge
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "a",
            meaning: "share of the charge that goes to each of the four neighbours",
            unit: "1",
            min: 0.0,
            max: 0.2,
            starts: &[0.005],
        }]
    }

    fn needs(&self) -> Needs {
        Needs::Covariances
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.008])
    }

    fn page(&self) -> Page {
        Page {
            what: "Charge diffuses, or capacitance couples, to the four neighbours after it was counted by shot noise.",
            equation: "q' = (1 - 4 a) q + a (q_up + q_down + q_left + q_right); power times (1 - 4 a + 2 a cos k_y + 2 a cos k_x)^2",
            signature: "slope of the photon-transfer line falls, nearest covariance over variance is constant (about 2 a); read \
                        noise in darks stays uncorrelated",
            look_alikes: "brighter-fatter's covariance grows as mu^2; a read-out low-pass correlates darks too, and one axis only",
            remedy: "the gain from variance alone is too low by 1 - 8 a: add the covariances to the variance; deconvolve images",
            measure: "flats with their covariances at several levels, and darks",
            sets: takes::PAIRS,
            source: "Moore, Ninkov and Forrest 2006, Opt. Eng. 45, 076402",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        let h = |ky: f64, kx: f64| {
            let h = 1.0 - 4.0 * p[0] + 2.0 * p[0] * (libm::cos(ky) + libm::cos(kx));
            h * h
        };
        let filter = Filter::new(&h);
        // Nothing but charge is there yet.
        out.sets.iter_mut().for_each(|s| s.filter(&filter));
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let around = d.shifted(1, 0) + d.shifted(-1, 0) + d.shifted(0, 1) + d.shifted(0, -1);
        d.image = &d.image * (1.0 - 4.0 * p[0]) + around * p[0];
    }
}
