//! Black clipping: what lies below a level is cut off.

use super::full_well_saturation::clipped;
use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};

/// max(v, level), counted from the level of zero charge.
pub struct This;

impl Effect for This {
    fn id(&self) -> &'static str {
        "black-clipping"
    }

    fn stage(&self) -> Stage {
        Stage::Converter
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "level_dn", unit: "DN", min: -1e3, max: 1e3, starts: &[-1.0, 0.5] }]
    }

    fn page(&self) -> Page {
        Page {
            what: "The black level is too low, or the camera cuts off what lies below it: half of the dark noise is lost.",
            equation: "v' = max(v, level), from the level of zero charge",
            signature: "darks have less variance and a higher mean than the line says; one code occurs far too often",
            look_alikes: "a wrong zero moves all levels alike",
            remedy: "raise the black level until no sample is cut off",
            measure: "short darks at a higher black level",
            sets: takes::DARKS,
            source: "EMVA 1288 release 4, section 6 (offset must be visible in darks)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let noise: Vec<f64> = out.sets.iter().map(|s| s.covariance(0, 0)).collect();
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            let variance = noise.get(frame.set).copied().unwrap_or(0.0);
            *m = -clipped(-*m, variance, -p[0]).0;
        }
        for (s, variance) in out.sets.iter_mut().zip(noise) {
            let (mean, left) = clipped(-s.signal, variance, -p[0]);
            s.signal = -mean;
            let less = if variance > 0.0 { left / variance } else { 1.0 };
            s.unsure += 2.0 * (1.0 - less).abs();
            s.shot.scale(less);
            s.read.scale(less);
            (s.row, s.column, s.common) = (s.row * less, s.column * less, s.common * less);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        d.image.mapv_inplace(|v| v.max(p[0]));
    }
}
