//! Blooming: a full well spills into its column.

use super::full_well_saturation::clipped;
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
            equation: "q' = min(q, full well); half of the rest goes up, half down, fills pixel after pixel, and is lost at the ends",
            signature: "the variance falls below the largest code; in a scene with a patch above the well its columns are filled above and below it",
            look_alikes: "full-well saturation loses the charge: nothing is beside the patch; smear grows with light at every level",
            remedy: "an anti-blooming gate; less light",
            measure: "a scene with a patch well above saturation, at several exposures",
            sets: takes::SCENES,
            source: "Janesick 2001, ch. 4",
        }
    }

    /// On a flat charge stays in its column until all of it is full: the mean goes on to the well itself, and pixels that are full
    /// vary no more.
    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let spread = |set: usize| c.sets.get(set).map_or(0.0, |s| s.spread);
        // A pixel shares with some eight neighbours of its column.
        let level = |signal: f64, spread: f64| {
            clipped(signal, 0.5 * spread * signal, signal.max(1e-9) / 8.0, p[0]).mean
        };
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            *m = level(*m, spread(frame.set));
        }
        for (i, s) in out.sets.iter_mut().enumerate() {
            let before = s.signal.max(1e-9);
            let left = clipped(before, spread(i) * before, before, p[0]);
            let less = (left.variance / before).min(1.0);
            s.cut(less, left.unequal, left.fourth);
            // How far a pixel's charge goes depends on its neighbours: the knee is known roughly.
            let knee = (1.0 - less) * (less + 0.02);
            s.unsure_var = libm::hypot(s.unsure_var, 0.5 * knee * before);
            s.unsure = libm::hypot(s.unsure, 3.0 * knee * before * before);
            s.shot.scale(less);
            s.common *= less * less;
            s.signal = level(before, spread(i));
        }
        out.bloom_e = out.bloom_e.min(p[0]);
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let rows = d.image.nrows();
        for mut column in d.image.columns_mut() {
            // Half of what is over goes each way, fills pixel after pixel, and is lost at the ends.
            let over: Vec<f64> = column.iter().map(|q| 0.5 * (q - p[0]).max(0.0)).collect();
            column.mapv_inplace(|q| q.min(p[0]));
            let mut fill = |rows: &mut dyn Iterator<Item = usize>| {
                let mut carried = 0.0;
                for y in rows {
                    let taken = (p[0] - column[y]).min(carried);
                    column[y] += taken;
                    carried += over[y] - taken;
                }
            };
            fill(&mut (0..rows));
            fill(&mut (0..rows).rev());
        }
    }
}
