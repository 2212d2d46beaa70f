//! Smear: light collected while the charge is moved through the image.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Stage, takes};
use ndarray::Axis;

/// Mean light of the column, added to each of its pixels for a fixed time at any exposure.
pub struct Smear;

impl Effect for Smear {
    fn id(&self) -> &'static str {
        "smear"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["vertical smear", "streak"]
    }

    /// Returns 2 ln 3, the evidence penalty of a cause that is three times rarer: CMOS global shutters have
    /// no smear, and one camera in three sold is a CCD (a named choice).
    fn rarer(&self) -> f64 {
        2.2
    }

    fn stage(&self) -> Stage {
        Stage::Light
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "transfer_s",
            meaning: "time that a pixel is lit by the rest of its column while the rows are shifted",
            unit: "s",
            min: 0.0,
            max: 1.0,
            starts: &[1e-6, 1e-4],
        }]
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![5e-4 * plain.bright_s])
    }

    fn page(&self) -> Page {
        Page {
            what: "A frame-transfer or interline sensor without a shutter is lit while its rows are shifted.",
            equation: "q(y, x) + t_s * mean light of column x",
            signature: "mean + light * t_s at every exposure; on a scene, columns through a bright patch are raised, the more so at short \
                        exposures",
            look_alikes: "an exposure offset does the same on flats; a scene with a bright patch at two exposures tells them apart",
            remedy: "a shutter or a strobe; subtract the column mean of covered rows",
            measure: "a still scene with a bright patch at a long and at a short exposure",
            sets: takes::SCENES,
            source: "EMVA 1288 release 4, section 4; Janesick 2001, ch. 4",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        out.smear_s += p[0];
        longer(|_| p[0], c, out);
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        if let Some(mean) = d.rate_e_per_s.mean_axis(Axis(0)) {
            d.image += &(mean * p[0]);
        }
    }
}

/// Adds light for `by_s` of the exposure, s, to every frame.
pub(super) fn longer(by_s: impl Fn(f64) -> f64, c: &Campaign, out: &mut Prediction) {
    let base = out.base.clone();
    let extra = |set: usize| c.sets.get(set).map_or(0.0, |s| by_s(s.exposure_s) * base.rate_e_per_s(s));
    for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
        *m += extra(frame.set);
    }
    for (i, s) in out.sets.iter_mut().enumerate() {
        s.signal += extra(i);
        out.light_e[i] += extra(i);
    }
}
