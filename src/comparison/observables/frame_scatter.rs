//! Variance of the means of whole frames, DN^2.

use super::{ChunkView, Expected, Observable, Put, Statistic, View};

/// Scatter from frame to frame.
#[derive(Debug)]
pub struct FrameScatter;

impl Statistic for FrameScatter {
    fn id(&self) -> &'static str {
        "variance of frame means"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "shared by whole frames, from frame to frame"
    }

    fn unit(&self) -> &'static str {
        "DN^2"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        put.put(0, chunk.summary().frame_means.variance_dn2(), 0.0);
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let common = view.set().map_or(0.0, |s| s.common);
        // The floor is the rounding of a mean in 32 bits.
        Expected::of_few(o, view.of_mean + common + view.moved + 1e-7, view.dof)
    }
}
