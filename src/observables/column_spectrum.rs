//! Spectrum of the column means: stripes down the image that move from frame to frame. It is no observable and
//! gives a search its starts.

use super::{Expected, Observable, Statistic, View, row_spectrum};
use crate::statistics::layout::Layout;
use crate::statistics::lines::Lines;
use std::cell::RefCell;

/// Power of the column means of the deviations at frequencies in steps of a quarter of a cycle over all columns.
#[derive(Debug)]
pub struct ColumnSpectrum;

thread_local! {
    static COLUMNS: RefCell<Option<row_spectrum::Plan>> = const { RefCell::new(None) };
}

impl Statistic for ColumnSpectrum {
    fn id(&self) -> &'static str {
        "spectrum of column means"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "stripes of columns that move"
    }

    fn sums(&self, layout: &Layout) -> usize {
        row_spectrum::count(layout.shape.1)
    }

    fn add(&self, _: &[f32], lines: &Lines, layout: &Layout, sums: &mut [f64]) {
        let columns = lines.column_means(layout);
        COLUMNS.with_borrow_mut(|plan| row_spectrum::add_power(plan, layout.shape.1, columns, sums));
    }

    fn expect(&self, o: &Observable, _: &View<'_>) -> Expected {
        Expected::plain(o, 0.0, 1.0)
    }
}
