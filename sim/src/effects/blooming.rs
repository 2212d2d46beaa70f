//! Blooming: a full well spills into its column.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};
use crate::clipping::clipped;
use crate::predict::{NORMAL, SetPrediction};

/// Overflow of charge above the well into the pixels above and below.
pub struct Blooming;

impl Effect for Blooming {
    fn id(&self) -> &'static str {
        "blooming"
    }

    fn stage(&self) -> Stage {
        Stage::Well
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "full_well_e",
            meaning: "charge at which the well spills",
            unit: "e",
            min: 1.0,
            max: 1e9,
            starts: &[],
        }]
    }

    /// Returns starts near the brightest level.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        seen.near_peak()
    }

    fn contradicted(&self, p: &[f64], _: &[f64], seen: &Seen) -> Option<&'static str> {
        seen.exceeds(p[0]).then_some(super::BRIGHTER_PIXELS)
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.8 * plain.range_e])
    }

    fn scaled(&self, values: &[f64], by: f64) -> Vec<f64> {
        vec![values[0] * 2.0 / (1.0 + by)]
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

    /// On a flat, charge stays in its column until the whole column is full: the mean rises to the well
    /// itself. Each neighbour receives half of the excess and varies with it. With e the excess and m the
    /// charge that stays, the variance is var m + var e / 2 and the covariance with the neighbour cov(m, e).
    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let shot: Vec<f64> = out.sets.iter().map(SetPrediction::shot_over_signal).collect();
        let limited = |set: usize, signal: f64, part: f64, noise: f64| {
            let (spread, places) = c.sets.get(set).map_or((0.0, &NORMAL), |s| (s.spread, &s.places));
            let variance = shot.get(set).map_or(signal, |over| over * signal).max(1e-9);
            clipped(signal, part * spread * signal, places, variance * noise, p[0])
        };
        // A pixel shares with some eight neighbours of its column.
        let level = |set: usize, signal: f64| limited(set, signal, 0.5, 0.125).mean;
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            *m = level(frame.set, *m);
        }
        for (i, s) in out.sets.iter_mut().enumerate() {
            let signal = s.signal.max(1e-9);
            let before = s.shot.lag(0, 0).max(1e-9);
            let left = limited(i, signal, 1.0, 1.0);
            let column = limited(i, signal, 0.5, 0.125);
            // If the neighbours are full as well, the excess moves on and its covariance is not observed.
            let room = 1.0 - left.above;
            // Full columns show no covariance either.
            let open = 1.0 - column.above;
            let neighbour = 0.5 * (before - left.variance - left.lost_variance).max(0.0) * room * open;
            let own = (left.variance + 0.5 * left.lost_variance * room * room) * open;
            let less = (own / before).min(1.0);
            s.cut(less, &left);
            let knee = left.above * libm::sqrt(left.above);
            s.unsure_var = libm::hypot(s.unsure_var, 0.5 * knee * less * before);
            let rest = own + out.base.read_noise_e * out.base.read_noise_e;
            s.unsure = libm::hypot(s.unsure, left.unsure(less, rest));
            s.shot.shape(|ky, _| less + 2.0 * neighbour / before * libm::cos(ky));
            s.cut_light(column.above);
            // The absorbed part of the excess depends on the order of bright and dark pixels: from none to
            // all, if the column has room.
            let (none, all) = (left.mean, limited(i, signal, 0.0, 0.0).mean);
            s.unsure_mean = libm::hypot(s.unsure_mean, 0.25 * (all - none).abs());
            s.signal = column.mean;
        }
        (out.bloom_e, out.well_e) = (out.bloom_e.min(p[0]), out.well_e.min(p[0]));
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let rows = d.image.nrows();
        for mut column in d.image.columns_mut() {
            // Half of the excess goes each way, fills pixel after pixel, and is lost at the ends.
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
