//! Growth of the covariance of neighbours across the sensor, along rows (0) and columns (1), DN^2.

use super::{ChunkView, Expected, Observable, Put, Statistic, View, covariance, in_quadrature};

/// Difference between the two ends of the sensor.
#[derive(Debug)]
pub struct Growth;

impl Statistic for Growth {
    fn id(&self) -> &'static str {
        "growth of covariance"
    }

    fn name(&self, index: usize) -> String {
        format!("growth of covariance along {}", if index == 0 { "rows" } else { "columns" })
    }

    fn meaning(&self, _: usize) -> &'static str {
        "changing across the sensor"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        let r = chunk.summary();
        let std_err = chunk.inflation.covariance * 2.0 * covariance::theory(r);
        r.covariances.growth.iter().enumerate().for_each(|(k, v)| put.put(k, v.value, std_err));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 0.0, 1.0) };
        let growth = if o.index == 0 { s.growth.0 } else { s.growth.1 };
        // The inequality of unequal pixels is not known.
        let noise = (view.noise * view.noise).max(f64::MIN_POSITIVE);
        let own = o.measured.std_err * (view.unlike().powi(2) + s.unsure / noise).sqrt();
        let std_err = in_quadrature(&[own, 0.3 * view.moving, 2.0 * view.shared(1, 1)]);
        Expected::plain(o, 0.5 * growth * view.pixels().0, std_err)
    }
}
