//! Carry-over: the first and the second frame of a set minus the mean of those after them in the chunk, DN.

use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature};

/// Step to the settled level.
#[derive(Debug)]
pub struct Settling;

impl Statistic for Settling {
    fn id(&self) -> &'static str {
        "settling"
    }

    fn name(&self, index: usize) -> String {
        if index == 0 { "mean of the first frame" } else { "mean of the second frame" }.into()
    }

    fn meaning(&self, _: usize) -> &'static str {
        "a frame depends on those before it"
    }

    fn unit(&self) -> &'static str {
        "DN"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        if let Some(before) = chunk.before() {
            let means = &chunk.summary().frame_means;
            put.put_over(0, chunk.since_the_first(), before - means.mean_dn());
            put.put_over(1, chunk.since_the_first(), means.first_step_dn());
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 0.0, 1.0) };
        let rest = view.frames.get(o.index + 1..).unwrap_or(&[]);
        let m = rest.len().max(1) as f64;
        let expected = view.frames.get(o.index).copied().unwrap_or(0.0) - rest.iter().sum::<f64>() / m;
        let noise = ((view.of_mean + s.common) * (1.0 + 1.0 / m)).sqrt();
        Expected::plain(o, expected, in_quadrature(&[noise, 0.002, s.unsure_first]))
    }
}
