//! Mean of the frames of a chunk, DN.

use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature};

/// Minimum relative error of the light of a set, for any lamp (a named choice: an LED's light falls by some
/// 1e-3 per kelvin, so that a tenth of a kelvin is as much; a bend or a drift of 0.01 % costs nobody
/// anything).
const LAMP: f64 = 1e-4;

/// Mean level of the frames.
#[derive(Debug)]
pub struct Mean;

impl Statistic for Mean {
    fn id(&self) -> &'static str {
        "mean"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "the level of whole sets"
    }

    fn unit(&self) -> &'static str {
        "DN"
    }

    fn is_level(&self) -> bool {
        true
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        put.put(0, chunk.summary().frame_means.mean_dn(), 0.0);
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 0.0, 1.0) };
        if view.all.is_table {
            return Expected::plain(o, view.mean, (view.noise / o.pixels).sqrt());
        }
        // Temporally correlated noise averages out less.
        let memory = s.shot_memory.first().copied().unwrap_or(0.0).max(0.0);
        // A fitted dark current below 0 has no noise.
        let noise = ((view.of_mean + s.common).max(0.0) * (1.0 + 2.0 * memory) / view.n).sqrt();
        let set = view.at.and_then(|at| view.all.campaign.sets.get(at));
        let lamp = if set.is_some_and(|set| set.light.is_some()) { LAMP * s.signal.max(0.0) } else { 0.0 };
        // The sums are kept in 32 bits, and means to some thousandths of a DN.
        Expected::plain(o, view.mean, in_quadrature(&[noise, 0.002, view.rough.0, s.unsure_mean, lamp]))
    }
}
