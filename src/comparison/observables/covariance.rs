//! Covariance of pixels at small lags within a frame, DN^2.

use super::expect::FIELD;
use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature};
use crate::statistics::covariance::LAGS;
use crate::statistics::pass::Summary;

/// Covariance at each of [`LAGS`].
#[derive(Debug)]
pub struct Covariance;

/// Returns the standard error for independent normal pixels.
pub fn theory(r: &Summary) -> f64 {
    r.var.value / (r.pixels * (r.frames as f64 - 1.0)).sqrt()
}

fn lag(index: usize) -> (i32, i32) {
    LAGS.get(index).copied().unwrap_or((0, 1))
}

impl Statistic for Covariance {
    fn id(&self) -> &'static str {
        "covariance"
    }

    fn name(&self, index: usize) -> String {
        let (dy, dx) = lag(index);
        format!("covariance ({dy},{dx})")
    }

    fn meaning(&self, index: usize) -> &'static str {
        match lag(index) {
            (0, _) => "correlated along the rows",
            (_, 0) => "correlated along the columns",
            _ => "correlated along a diagonal",
        }
    }

    fn unit(&self) -> &'static str {
        "DN^2"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        let r = chunk.summary();
        let std_err = chunk.inflation.covariance * theory(r);
        r.covariances.at.iter().enumerate().for_each(|(k, c)| put.put(k, c.value, std_err));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let (dy, dx) = lag(o.index);
        let unsure = view.set().map_or(0.0, |s| s.unsure_var);
        Expected::plain(
            o,
            // While the level moves, shading moves neighbours together and fixed pattern does not: the truth
            // lies between.
            view.lag(dy, dx) + 0.5 * view.moving,
            in_quadrature(&[
                o.measured.std_err,
                view.alike_in_time(o.pixels),
                unsure,
                view.lines(dy, dx),
                0.3 * view.moving,
                view.shared(dy, dx),
                FIELD * view.with_light * view.all.field.smooth,
            ]),
        )
        .with_common(view.common(dy, dx))
    }
}
