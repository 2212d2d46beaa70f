//! Spatial filter: the camera sharpens or smooths its images.

use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};

/// The difference from the mean of four neighbours is enlarged (s above 0) or lessened.
pub struct This;

impl Effect for This {
    fn id(&self) -> &'static str {
        "spatial-filter"
    }

    fn stage(&self) -> Stage {
        Stage::Firmware
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "strength", unit: "1", min: -0.49, max: 3.0, starts: &[0.05, -0.05] }]
    }

    fn tables_tell(&self) -> bool {
        true
    }

    fn page(&self) -> Page {
        Page {
            what: "Firmware sharpens (edge enhancement) or smooths (noise reduction) after conversion.",
            equation: "y = v + s (v - mean of the 4 neighbours); power times (1 + s (1 - (cos k_y + cos k_x) / 2))^2",
            signature: "neighbours correlated in darks as in flats, along both axes: negative with sharpening, positive with \
                        smoothing; variance up or down in both",
            look_alikes: "crosstalk leaves the read noise of darks uncorrelated",
            remedy: "switch it off (Sharpness, NoiseReduction); calibrate only then",
            measure: "darks with their covariances along both axes",
            sets: takes::DARKS,
            source: "EMVA 1288 release 4, section 2 (raw data are required); GenICam SFNC, Sharpness",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        let h = |ky: f64, kx: f64| {
            let h = 1.0 + p[0] * (1.0 - 0.5 * (libm::cos(ky) + libm::cos(kx)));
            h * h
        };
        // A row's own noise has all vertical frequencies and no horizontal one: the mean of h over one axis.
        let line = (1.0 + 0.5 * p[0]) * (1.0 + 0.5 * p[0]) + p[0] * p[0] / 8.0;
        for s in &mut out.sets {
            let before = s.covariance(0, 0);
            s.shot.shape(h);
            s.read.shape(h);
            s.row *= line;
            s.column *= line;
            s.follow(before);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let around = (d.shifted(1, 0) + d.shifted(-1, 0) + d.shifted(0, 1) + d.shifted(0, -1)) * 0.25;
        d.image = &d.image * (1.0 + p[0]) - around * p[0];
    }
}
