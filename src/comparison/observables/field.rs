//! The field of the light: how far the brightness of pixels, rows and columns lies from the mean, as the flats
//! show it. What scatters with the light of whole frames does so in proportion to it: a dark corner flickers
//! less.

use super::gradient;
use crate::statistics::pass::Summary;

/// Means of rows, and of columns, this far apart are compared.
pub const LINE_LAGS: [usize; 7] = [1, 2, 4, 8, 16, 32, 64];

/// Mean squares and products of the relative deviations of the field.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Field {
    /// Of single pixels.
    pub pixels: f64,
    /// Of pixels and their neighbours: what is smooth.
    pub smooth: f64,
    /// Of the means of rows, and of columns.
    pub rows: f64,
    /// See `rows`.
    pub columns: f64,
    /// Products of the means of rows [`LINE_LAGS`] apart.
    pub row_lags: [f64; LINE_LAGS.len()],
    /// Products of the means of columns as far apart.
    pub column_lags: [f64; LINE_LAGS.len()],
    /// Mean products with the shapes of [`gradient`](super::gradient), in its order.
    pub shapes: [f64; 4],
    /// Squares of the differences of the halves: lower less upper, right less left.
    pub halves: [f64; 2],
}

/// Relative deviations of the means of lines from their mean.
fn relative(lines_dn: &[f64], zero_dn: f64) -> Vec<f64> {
    let mean = lines_dn.iter().sum::<f64>() / lines_dn.len().max(1) as f64;
    let signal = (mean - zero_dn).max(1e-9);
    lines_dn.iter().map(|v| (v - mean) / signal).collect()
}

fn halves(lines: &[f64]) -> f64 {
    let half = lines.len() / 2;
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len().max(1) as f64;
    (mean(&lines[lines.len() - half..]) - mean(&lines[..half])).powi(2)
}

impl Field {
    /// Of the mean image of bright frames.
    pub fn of(s: &Summary, zero_dn: f64) -> Self {
        let signal = (s.frame_means.mean_dn() - zero_dn).max(1e-9);
        let (rows, columns) = (relative(&s.rows_dn, zero_dn), relative(&s.columns_dn, zero_dn));
        let product =
            |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / a.len().max(1) as f64;
        let at = |lines: &[f64], lag: usize| {
            if lag < lines.len() { product(&lines[..lines.len() - lag], &lines[lag..]) } else { 0.0 }
        };
        let (of_rows, of_columns) = (product(&rows, &rows), product(&columns, &columns));
        let pixels = s.spatial_var_dn2.max(0.0) / (signal * signal);
        let shape = |lines: &[f64], halves: u32| gradient::product(lines.iter().copied(), halves);
        let [gradient, curvature] = gradient::HALF_TURNS;
        Self {
            pixels,
            shapes: [
                shape(&rows, gradient),
                shape(&rows, curvature),
                shape(&columns, gradient),
                shape(&columns, curvature),
            ],
            // Rows and columns tell nearly all of a smooth field.
            smooth: (of_rows + of_columns).min(pixels),
            rows: of_rows,
            columns: of_columns,
            row_lags: LINE_LAGS.map(|lag| at(&rows, lag)),
            column_lags: LINE_LAGS.map(|lag| at(&columns, lag)),
            halves: [halves(&rows), halves(&columns)],
        }
    }
}
