//! Covariance of neighbours in odd columns (0) or rows (1) minus that in even ones, DN^2.

use super::{ChunkView, Expected, Observable, Put, Statistic, View, covariance, in_quadrature};

/// Difference between odd and even lines.
#[derive(Debug)]
pub struct Parity;

impl Statistic for Parity {
    fn id(&self) -> &'static str {
        "covariance by parity"
    }

    fn name(&self, index: usize) -> String {
        format!("covariance by {} parity", if index == 0 { "column" } else { "row" })
    }

    fn meaning(&self, index: usize) -> &'static str {
        if index == 0 { "every second column differs" } else { "every second row differs" }
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        let r = chunk.summary();
        let std_err = chunk.inflation.covariance * 2.0 * covariance::theory(r);
        r.covariances.parity.iter().enumerate().for_each(|(k, v)| put.put(k, v.value, std_err));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 0.0, 1.0) };
        let parity = if o.index == 0 { s.parity.0 } else { s.parity.1 };
        let own = o.measured.std_err * view.unlike();
        Expected::plain(o, parity, in_quadrature(&[own, 0.3 * view.moving, 2.0 * view.shared(1, 1)]))
    }
}
