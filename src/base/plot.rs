//! Plots as numbers: what a page draws and what is written as CSV.

use std::borrow::Cow;

/// One axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// Title with unit.
    pub title: String,
    /// Logarithmic.
    pub log: bool,
}

/// How a series is drawn.
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
    /// What the legend says.
    pub label: String,
    /// How it is drawn.
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
    /// What is drawn.
    pub series: Vec<Series>,
    /// Range of y that the standard asks for.
    pub y_range: Option<(f64, f64)>,
}

impl Plot {
    /// The numbers: columns series, x, y and std_err, empty where there is none.
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

/// A field of CSV.
fn quoted(text: &str) -> String {
    if text.contains([',', '"']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.into() }
}

/// A linear axis.
pub(crate) fn axis(title: impl Into<String>) -> Axis {
    Axis { title: title.into(), log: false }
}

/// A logarithmic axis.
pub(crate) fn log(title: impl Into<String>) -> Axis {
    Axis { title: title.into(), log: true }
}

/// A series.
pub(crate) fn series(label: impl Into<String>, shape: Shape, points: Vec<[f64; 3]>) -> Series {
    Series { label: label.into(), shape, points }
}

/// A dashed line at one value, from 0 to `end`.
pub(crate) fn level(label: impl Into<String>, y: f64, end: f64) -> Series {
    series(label, Shape::Dashed, vec![[0.0, y, f64::NAN], [end, y, f64::NAN]])
}
