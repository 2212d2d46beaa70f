//! Temporal variance of the column means about their mean over the frames, DN^2; not EMVA's spatial column
//! variance.

use super::{ChunkView, Expected, Observable, Put, Statistic, View};

/// Temporal variance of the column means.
#[derive(Debug)]
pub struct ColumnVariance;

impl Statistic for ColumnVariance {
    fn id(&self) -> &'static str {
        "variance of column means"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "shared by whole columns"
    }

    fn unit(&self) -> &'static str {
        "DN^2"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        put.put(0, chunk.summary().line_var_dn2[1], 0.0);
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        view.line_variance(o, false)
    }
}
