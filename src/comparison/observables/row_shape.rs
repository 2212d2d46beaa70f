//! Covariance of the means of rows some way apart, DN^2: it separates rows that scatter one by one from
//! bands.

use super::expect::{FIELD, larger};
use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature, line_shape};
use crate::statistics::layout::Layout;
use crate::statistics::lines::Lines;

/// Covariance at these distances.
#[derive(Debug)]
pub struct RowShape;

impl Statistic for RowShape {
    fn id(&self) -> &'static str {
        "covariance of row means"
    }

    fn name(&self, index: usize) -> String {
        line_shape::name("row", index)
    }

    fn meaning(&self, _: usize) -> &'static str {
        "shared by bands of rows"
    }

    fn unit(&self) -> &'static str {
        "DN^2"
    }

    fn sums(&self, layout: &Layout) -> usize {
        line_shape::lags(layout.shape.0).count()
    }

    fn add(&self, _: &[f32], lines: &Lines, _: &Layout, sums: &mut [f64]) {
        let rows = lines.row_means();
        line_shape::add(rows, sums);
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        chunk.sums().iter().enumerate().for_each(|(k, sum)| put.put(k, *sum, 0.0));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let (rows, columns) = view.all.campaign.shape;
        let (Some(s), lag) = (view.set(), line_shape::lag(o.index)) else {
            return Expected::plain(o, 0.0, 1.0);
        };
        // Filtered noise of pixels and rows; the frame's mean removes its part.
        let near = if lag < 4 {
            let (shot, read) = view.of_rows(lag);
            (shot * view.left.0 + read * view.left.1) / columns as f64 + s.row.lag(lag as i32)
        } else {
            0.0
        };
        let flat = view.of_mean - s.column.of_mean() / columns as f64 - view.ripple_of_mean;
        let common = s.ripple_correlation(lag as f64);
        // The mean of a slow change is subtracted as a whole: the rest of a product depends on the places of
        // the rows.
        let slow = if s.ripples.is_empty() {
            0.0
        } else {
            common * s.ripple(0.0) - 2.0 * s.ripple_with_mean(rows - lag, rows) + view.ripple_of_mean
        };
        let lines: f64 = s.lines.iter().map(|l| l.0).sum();
        let (shot, read) = view.of_rows(0);
        let own = (shot + read) / columns as f64 + s.row.lag(0);
        // A product of rows with little in common scatters by half of the variance of a square.
        let ripple = view.ripple_error * (0.5 * (1.0 + common * common)).sqrt();
        let fields = s.fields.rows_apart(lag, rows);
        let stripes = view.stripes(true, lag, own);
        let alone = own / (((rows - lag) as f64) * view.dof).sqrt();
        let single = in_quadrature(&[s.unsure_var, view.rough_lags]) / columns as f64;
        let error = in_quadrature(&[
            alone,
            ripple,
            view.field_error(fields),
            0.3 * view.moving,
            stripes.std_err,
            lines / columns as f64,
            single,
        ]);
        let field = view.with_light * view.all.field.row_lags[o.index.min(super::LINE_LAGS.len() - 1)];
        let error = in_quadrature(&[error, FIELD * view.with_light * view.all.field.rows]);
        // A ripple, stripes and fields have different common errors: the largest is used.
        let shared = larger(larger(stripes.common, view.ripple_error * common), view.field_error(fields));
        let value = near - flat + slow + stripes.covariance + fields + field;
        Expected::plain(o, value, error).with_common(shared)
    }
}
