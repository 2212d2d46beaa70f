//! Temporal variance of the pixels, DN^2.

use super::expect::FIELD;
use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature};
use crate::statistics::pass::Summary;

/// Temporal variance of the pixels.
#[derive(Debug)]
pub struct Variance;

/// Returns the standard error for independent normal pixels.
pub fn theory(r: &Summary) -> f64 {
    r.var.value * (2.0 / (r.pixels * (r.frames as f64 - 1.0))).sqrt()
}

impl Statistic for Variance {
    fn id(&self) -> &'static str {
        "temporal variance"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "the noise of single pixels"
    }

    fn unit(&self) -> &'static str {
        "DN^2"
    }

    /// Returns true: shot noise is that of the set's own light, not of the nominal one.
    fn sees_light(&self) -> bool {
        true
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        let r = chunk.summary();
        put.put(0, r.var.value, chunk.inflation.variance * theory(r));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let unsure = view.set().map_or(0.0, |s| in_quadrature(&[s.unsure_var, s.unsure_own]));
        Expected::plain(
            o,
            view.lag(0, 0) + view.moving,
            in_quadrature(&[
                o.measured.std_err,
                // Pixels with more noise scatter more (mean square of the pixel variances over the square of
                // their mean).
                view.noise * (2.0 * view.unequal_spread() / (o.pixels * view.dof)).sqrt(),
                view.alike_in_time(o.pixels),
                view.rough.1,
                unsure,
                view.unsure_moving(),
                view.lines(0, 0),
                0.1 * view.moving,
                view.shared(0, 0),
                FIELD * view.with_light * view.all.field.pixels,
            ]),
        )
        .with_common(view.common(0, 0))
    }
}
