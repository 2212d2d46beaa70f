//! Excess spread of the pixels' variances, relative: whether some pixels are noisier than the rest.

use super::{ChunkView, Expected, Observable, Put, Statistic, View};

/// The spread.
#[derive(Debug)]
pub struct This;

impl Statistic for This {
    fn id(&self) -> &'static str {
        "spread of pixel variances"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "a few pixels noisier than the rest"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        let r = chunk.said();
        put.put(0, r.unequal.value, chunk.inflation.unequal * (8.0 / r.pixels).sqrt());
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 0.0, 1.0) };
        // The variance of a sample variance has the fourth cumulant over the frames in it (Cramer 1946, 27.4).
        let allowed = 1.0 + 2.0 / view.dof;
        let variance = view.noise.max(1e-9);
        let rest = view.rough.1.hypot(view.moving) / variance;
        let square = variance * variance;
        // Shot noise of unequal dark charge: only pixels that stand out are known to have more of it.
        let dark = view.at.map_or(0.0, |set| view.all.dark_spread_dn2[set]);
        let charge = dark * view.prediction.base.gain_dn_per_e.powi(2);
        Expected::plain(
            o,
            (s.unequal + s.fourth / (view.n * allowed)) / square,
            o.measured.std_err.hypot((s.unsure + charge) / square).hypot(0.002).hypot(rest),
        )
    }
}
