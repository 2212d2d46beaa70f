//! Temporal variance of the means of rows, DN^2; not EMVA's spatial row variance.

use super::{ChunkView, Expected, Observable, Put, Statistic, View};

/// Scatter of whole rows.
#[derive(Debug)]
pub struct RowVariance;

impl Statistic for RowVariance {
    fn id(&self) -> &'static str {
        "variance of row means"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "shared by whole rows"
    }

    fn unit(&self) -> &'static str {
        "DN^2"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        put.put(0, chunk.summary().line_var_dn2[0], 0.0);
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        view.line_variance(o, true)
    }
}
