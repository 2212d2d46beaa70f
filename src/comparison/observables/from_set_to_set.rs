//! Noise of the means of sets of two or three frames from set to set, over the noise within the sets: frames
//! that a filter over time makes alike have less noise within a set than between sets.

use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature};
use crate::statistics::between_sets::MOVES;

/// Noise from set to set over that within.
#[derive(Debug)]
pub struct FromSetToSet;

impl Statistic for FromSetToSet {
    fn id(&self) -> &'static str {
        "noise of means from set to set"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "the frames of a set are alike"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        if let Some(ratio) = chunk.between_sets() {
            put.put(0, ratio.value, ratio.std_err);
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let value = view.noise_of_mean();
        // The error of a variance is in proportion to it: that of the prediction, not of the measured ratio.
        let std_err =
            in_quadrature(&[o.measured.std_err * value.max(1.0) / o.measured.value.max(1.0), MOVES * value]);
        Expected::plain(o, value, std_err)
    }
}
