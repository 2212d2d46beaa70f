//! Spectrum of the column means: stripes down the image that move from frame to frame. Its peaks are the
//! starts of a search; the strongest of the campaign is an observable ([`line_peak`]).

use super::line_peak::{self, Axis};
use super::{Expected, HalfView, Observable, Put, Statistic, View, row_spectrum};
use crate::statistics::layout::Layout;
use crate::statistics::lines::Lines;
use std::cell::RefCell;

/// Power of the column means of the deviations at frequencies in steps of a quarter of a cycle over all
/// columns.
#[derive(Debug)]
pub struct ColumnSpectrum;

thread_local! {
    static COLUMNS: RefCell<Option<row_spectrum::Plan>> = const { RefCell::new(None) };
}

impl Statistic for ColumnSpectrum {
    fn id(&self) -> &'static str {
        "spectrum of column means"
    }

    fn name(&self, index: usize) -> String {
        line_peak::name("column", index)
    }

    fn meaning(&self, _: usize) -> &'static str {
        "stripes of columns that move"
    }

    fn unit(&self) -> &'static str {
        "DN^2"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        half.put_peak(Axis::Columns, put);
    }

    fn sums(&self, layout: &Layout) -> usize {
        row_spectrum::count(layout.shape.1)
    }

    fn add(&self, _: &[f32], lines: &Lines, layout: &Layout, sums: &mut [f64]) {
        let columns = lines.column_means(layout);
        COLUMNS.with_borrow_mut(|plan| row_spectrum::add_power(plan, layout.shape.1, columns, sums));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        view.peak(Axis::Columns, o)
    }
}
