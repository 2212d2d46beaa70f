//! Blooming: a full well spills into its column.

use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};

/// Charge above the well goes to the pixels above and below.
pub struct This;

impl Effect for This {
    fn id(&self) -> &'static str {
        "blooming"
    }

    fn stage(&self) -> Stage {
        Stage::Charge
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "full_well_e", unit: "e", min: 1.0, max: 1e9, starts: &[f64::NAN, f64::NAN, f64::NAN] }]
    }

    fn page(&self) -> Page {
        Page {
            what: "A well that is full spills its charge over the channel stops' lowest barrier, into its neighbours in the column.",
            equation: "q' = min(q, full well); half of the rest to the pixel above, half to the one below, until none is left",
            signature: "below the largest code the variance falls while the mean goes on; columns through a bright patch are filled",
            look_alikes: "full-well saturation loses the charge: the mean stops; smear grows with light at every level",
            remedy: "an anti-blooming gate; less light",
            measure: "a scene with a patch well above saturation, at several exposures",
            sets: takes::SCENES,
            source: "Janesick 2001, ch. 4",
        }
    }

    /// On a flat no charge is lost: the mean goes on, and what is noise between neighbours is evened out.
    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        for (s, info) in out.sets.iter_mut().zip(&c.sets) {
            let sd = libm::sqrt(s.signal.max(1.0)) + info.spread * s.signal;
            let over = 0.5 * libm::erfc((p[0] - s.signal) / (sd * std::f64::consts::SQRT_2));
            // Above the well only the slowest parts of the noise along the column are left.
            s.shot.shape(|ky, _| 1.0 - over + over * 0.25 * (1.0 + libm::cos(ky)) * (1.0 + libm::cos(ky)));
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let rows = d.image.nrows();
        for mut column in d.image.columns_mut() {
            // What is over moves on in both directions; at the ends it is lost.
            for _ in 0..2 {
                let mut carried = 0.0;
                for y in 0..rows {
                    let q = column[y] + carried;
                    carried = 0.5 * (q - p[0]).max(0.0);
                    column[y] = q - carried;
                }
                carried = 0.0;
                for y in (0..rows).rev() {
                    let q = column[y] + carried;
                    carried = (q - p[0]).max(0.0);
                    column[y] = q - carried;
                }
            }
        }
    }
}
