//! Plots as numbers, drawn by a page and written as CSV.

use std::borrow::Cow;

/// One axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// Title with unit.
    pub title: String,
    /// Logarithmic.
    pub log: bool,
}

/// Drawing style of a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Shape {
    /// Points with error bars.
    Points,
    /// A curve with the band of its standard errors.
    Line,
    /// A dashed curve.
    Dashed,
    /// Steps, as of a histogram.
    Steps,
}

/// A series of a plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Text of the legend.
    pub label: String,
    /// Drawing style.
    pub shape: Shape,
    /// x, y, standard error of y (NaN where there is none).
    pub points: Vec<[f64; 3]>,
}

/// A plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    /// Name of its CSV file.
    pub id: Cow<'static, str>,
    /// Title.
    pub title: Cow<'static, str>,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Series of the plot.
    pub series: Vec<Series>,
    /// Range of y required by the standard.
    pub y_range: Option<(f64, f64)>,
}

impl Plot {
    /// Returns the numbers as CSV: columns series, x, y and std_err, which is empty if there is none.
    pub fn csv(&self) -> String {
        let mut out = format!("series,{},{},std_err\n", quoted(&self.x.title), quoted(&self.y.title));
        for s in &self.series {
            for [x, y, e] in &s.points {
                let error = if e.is_finite() { e.to_string() } else { String::new() };
                out += &format!("{},{x},{y},{error}\n", quoted(&s.label));
            }
        }
        out
    }
}

/// Quotes a CSV field if necessary.
fn quoted(text: &str) -> String {
    if text.contains([',', '"']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.into() }
}

/// Creates a linear axis.
pub(crate) fn axis(title: impl Into<String>) -> Axis {
    Axis { title: title.into(), log: false }
}

/// Creates a logarithmic axis.
pub(crate) fn log(title: impl Into<String>) -> Axis {
    Axis { title: title.into(), log: true }
}

/// Creates a series.
pub(crate) fn series(label: impl Into<String>, shape: Shape, points: Vec<[f64; 3]>) -> Series {
    Series { label: label.into(), shape, points }
}

/// Creates a dashed line at one value, from 0 to `end`.
pub(crate) fn level(label: impl Into<String>, y: f64, end: f64) -> Series {
    series(label, Shape::Dashed, vec![[0.0, y, f64::NAN], [end, y, f64::NAN]])
}
