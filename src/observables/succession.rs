//! Product of the deviations of successive frame means over their variance: whether frames scatter one by one.

use super::{ChunkView, Expected, Observable, Put, Statistic, View};

/// The correlation from frame to frame.
#[derive(Debug)]
pub struct This;

/// Frames from which on a set tells of it.
const FEWEST: u64 = 4;

impl Statistic for This {
    fn id(&self) -> &'static str {
        "succession of frame means"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "shared by whole frames, and alike in successive ones"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        let means = &chunk.said().frame_means;
        if means.frames() >= FEWEST {
            put.put(0, means.succession(), 0.0);
        }
    }

    /// Of independent normal numbers about their own mean the quotient has the mean -1/n and nearly the variance
    /// (n - 2)^2 / (n^2 (n - 1)) (R. L. Anderson 1942, Ann. Math. Stat. 13, 1).
    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 0.0, 1.0) };
        let (square, product) = products(view.frames);
        let noise = (view.of_mean + s.common).max(1e-12) * view.dof;
        let value = (product + noise * view.product(&s.shot_memory)) / (square + noise);
        let own = (view.n - 2.0) / view.n / view.dof.sqrt();
        // Where the level moves, what is known of that decides.
        Expected::plain(o, value, own.hypot(square / (square + noise)))
    }
}

/// Sum of the squares of deviations from the mean, and of the products of successive ones.
fn products(means: &[f64]) -> (f64, f64) {
    let mean = means.iter().sum::<f64>() / means.len().max(1) as f64;
    let square = means.iter().map(|m| (m - mean) * (m - mean)).sum::<f64>();
    (square, means.windows(2).map(|m| (m[0] - mean) * (m[1] - mean)).sum())
}
