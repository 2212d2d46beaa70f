//! Lag-1 autocorrelation of the frame means: distinguishes independent from correlated frames.

use crate::statistics::succession::{of_independent, sums};

use super::{ChunkView, Expected, Observable, Put, Statistic, View};

/// Lag-1 autocorrelation of the frame means.
#[derive(Debug)]
pub struct Succession;

/// Minimum number of frames of a set.
const FEWEST: u64 = 4;

impl Statistic for Succession {
    fn id(&self) -> &'static str {
        "succession of frame means"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "shared by whole frames, and alike in successive ones"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        let means = &chunk.summary().frame_means;
        if means.frames() >= FEWEST {
            put.put(0, means.succession(), 0.0);
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 0.0, 1.0) };
        let (square, product) = sums(view.frames.iter().copied());
        let noise = (view.of_mean + s.common).max(1e-12) * view.dof;
        let value = (product + noise * view.product(&s.shot_memory)) / (square + noise);
        let (_, own) = of_independent(view.n);
        // If the level moves, the expected motion dominates.
        Expected::plain(o, value, own.hypot(square / (square + noise)))
    }
}
