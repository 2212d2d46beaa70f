//! Read-out low-pass: the output stage is too slow for the pixel rate.

use super::{Campaign, Drawing, Effect, Needs, Page, Parameter, Plain, Prediction, Stage, takes};
use crate::predict::Filter;

/// Each pixel keeps a share of the one read before it in the row.
pub struct ReadoutLowpass;

impl Effect for ReadoutLowpass {
    fn id(&self) -> &'static str {
        "readout-lowpass"
    }

    fn stage(&self) -> Stage {
        Stage::Converter
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "alpha",
            meaning: "share of the previous pixel's voltage that is left",
            unit: "1",
            min: 0.0,
            max: 0.9,
            starts: &[0.02],
        }]
    }

    fn needs(&self) -> Needs {
        Needs::Covariances
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.02])
    }

    fn page(&self) -> Page {
        Page {
            what: "The video chain has a finite bandwidth: part of the last pixel's voltage is still there when the next is \
                   converted.",
            equation: "y(x) = (1 - alpha) v(x) + alpha y(x - 1); power times (1 - alpha)^2 / (1 - 2 alpha cos k_x + alpha^2)",
            signature: "pixels correlated along the row only, in darks as in flats; variance lower in both",
            look_alikes: "crosstalk correlates both axes and leaves darks alone",
            remedy: "a slower pixel clock; deconvolve along the row",
            measure: "darks and flats with the covariances along rows and columns",
            sets: takes::DARKS,
            source: "Janesick 2001, Scientific Charge-Coupled Devices, ch. 6",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        let a = p[0];
        let pass = |_: f64, kx: f64| (1.0 - a) * (1.0 - a) / (1.0 - 2.0 * a * libm::cos(kx) + a * a);
        let filter = Filter::new(&pass).of_weights((0..64).map(|k| (1.0 - a) * a.powi(k)));
        out.sets.iter_mut().for_each(|s| s.filter(&filter));
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        for mut row in d.image.outer_iter_mut() {
            let mut last = row.first().copied().unwrap_or(0.0);
            for v in &mut row {
                last = (1.0 - p[0]) * *v + p[0] * last;
                *v = last;
            }
        }
    }
}
