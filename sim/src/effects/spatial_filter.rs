//! Spatial filter: the camera sharpens or smooths its images.

use super::{Campaign, Drawing, Effect, Needs, Page, Parameter, Prediction, Stage, takes};

/// The difference from a mean of the neighbours is enlarged (s above 0) or lessened.
pub struct This;

/// Share of the four diagonal neighbours in that mean: none, as the other four, half as much.
fn diagonal(p: &[f64]) -> f64 {
    match p[1].round() as i32 {
        0 => 0.0,
        1 => 1.0 / 2.0,
        _ => 1.0 / 3.0,
    }
}

impl Effect for This {
    fn id(&self) -> &'static str {
        "spatial-filter"
    }

    fn stage(&self) -> Stage {
        Stage::Firmware
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter { name: "strength", unit: "1", min: -0.49, max: 3.0, starts: &[0.05] },
            // 4 neighbours, 8 alike, 8 with the diagonal ones at half.
            Parameter { name: "kernel", unit: "choice", min: 0.0, max: 2.0, starts: &[0.0, 1.0, 2.0] },
        ]
    }

    fn needs(&self) -> Needs {
        Needs::Covariances
    }

    fn page(&self) -> Page {
        Page {
            what: "Firmware sharpens (edge enhancement) or smooths (noise reduction) after conversion.",
            equation: "y = v + s (v - mean of the neighbours): kernel 0 the nearest 4, 1 all 8 alike, 2 the diagonal ones at half weight; power \
                       times (1 + s (1 - (1 - d) (cos k_y + cos k_x) / 2 - d cos k_y cos k_x))^2, d = 0, 1/2, 1/3",
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
        let (strength, d) = (p[0], diagonal(p));
        let h = |ky: f64, kx: f64| {
            let (cy, cx) = (libm::cos(ky), libm::cos(kx));
            let h = 1.0 + strength * (1.0 - (1.0 - d) * 0.5 * (cy + cx) - d * cy * cx);
            h * h
        };
        // A row's own noise has all vertical frequencies and no horizontal one: the mean of h over one axis, where h is
        // 1 + s (1 + d) / 2 (1 - cos k).
        let half = 0.5 * strength * (1.0 + d);
        let line = (1.0 + half) * (1.0 + half) + 0.5 * half * half;
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
        let (strength, share) = (p[0], diagonal(p));
        let near = (d.shifted(1, 0) + d.shifted(-1, 0) + d.shifted(0, 1) + d.shifted(0, -1)) * 0.25;
        let around = if share > 0.0 {
            let corner = d.shifted(1, 1) + d.shifted(-1, 1) + d.shifted(1, -1) + d.shifted(-1, -1);
            near * (1.0 - share) + corner * (0.25 * share)
        } else {
            near
        };
        d.image = &d.image * (1.0 + strength) - around * strength;
    }
}
