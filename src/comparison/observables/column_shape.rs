//! Covariance of the means of columns some way apart, DN^2. It separates columns that scatter one by one, in
//! stripes, or with a field that changes its shape.

use super::expect::{FIELD, larger};
use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature, line_shape};
use crate::statistics::layout::Layout;
use crate::statistics::lines::Lines;
use std::cell::RefCell;

/// Covariance at these distances.
#[derive(Debug)]
pub struct ColumnShape;

thread_local! {
    static COLUMNS: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
}

impl Statistic for ColumnShape {
    fn id(&self) -> &'static str {
        "covariance of column means"
    }

    fn name(&self, index: usize) -> String {
        line_shape::name("column", index)
    }

    fn meaning(&self, _: usize) -> &'static str {
        "shared by stripes of columns"
    }

    fn unit(&self) -> &'static str {
        "DN^2"
    }

    fn sums(&self, layout: &Layout) -> usize {
        line_shape::lags(layout.shape.1).count()
    }

    fn add(&self, _: &[f32], lines: &Lines, layout: &Layout, sums: &mut [f64]) {
        COLUMNS.with_borrow_mut(|columns| {
            columns.clear();
            columns.extend(lines.column_means(layout));
            line_shape::add(columns, sums);
        });
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        chunk.sums().iter().enumerate().for_each(|(k, sum)| put.put(k, *sum, 0.0));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let (rows, columns) = view.all.campaign.shape;
        let (Some(s), lag) = (view.set(), line_shape::lag(o.index)) else {
            return Expected::plain(o, 0.0, 1.0);
        };
        // Filtered noise of pixels and columns; the frame's mean removes its part.
        let near = if lag < 4 {
            let (shot, read) = (s.shot.across_lag(lag), s.read.across_lag(lag));
            (shot * view.left.0 + read * view.left.1) / rows as f64 + s.column.lag(lag as i32)
        } else {
            0.0
        };
        let flat = view.of_mean - s.row.of_mean() / rows as f64 - view.ripple_of_mean;
        let own = (s.shot.across_lag(0) + s.read.across_lag(0)) / rows as f64 + s.column.lag(0);
        let fields = s.fields.columns_apart(lag, columns);
        let stripes = view.stripes(false, lag, own);
        let alone = own / (((columns - lag) as f64) * view.dof).sqrt();
        let single = in_quadrature(&[s.unsure_var, view.rough_lags]) / rows as f64;
        let lines: f64 = s.lines.iter().map(|l| l.0).sum();
        let of_fields = view.field_error(fields);
        let rest = lines / rows as f64;
        let error = in_quadrature(&[alone, of_fields, 0.3 * view.moving, stripes.variance, rest, single]);
        let field = view.with_light * view.all.field.column_lags[o.index.min(super::LINE_LAGS.len() - 1)];
        let error = in_quadrature(&[error, FIELD * view.with_light * view.all.field.columns]);
        let value = near - flat + stripes.covariance + fields + field;
        Expected::plain(o, value, error).with_common(larger(stripes.common, of_fields))
    }
}
