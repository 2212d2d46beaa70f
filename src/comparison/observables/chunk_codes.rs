//! Share of occurring codes around a set's level.

use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature};

/// Share of occurring codes.
#[derive(Debug)]
pub struct ChunkCodes;

impl Statistic for ChunkCodes {
    fn id(&self) -> &'static str {
        "share of codes around the level"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "codes are left out"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        if let Some((share, std_err)) = chunk.codes_used() {
            put.put(0, share, std_err);
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let used = view.set().map_or(1.0, |s| s.codes_used);
        let widths = view.prediction.bit_errors_dn[..6].iter().map(|e| e.abs()).fold(0.0, f64::max);
        // Codes narrower than a quarter of a step may be missed.
        let narrow = 0.3 * (widths - 0.75).max(0.0);
        let std_err = in_quadrature(&[o.measured.std_err, narrow, 0.03 * (1.0 - used)]);
        Expected::plain(o, used / view.prediction.code_step_dn.max(1.0), std_err)
    }
}
