//! Field of the light: relative deviation of pixels, rows and columns from the mean brightness, as shown by
//! the flats. The scatter of the light of whole frames is proportional to it: a dark corner flickers less.

use super::gradient;
use crate::statistics::pass::Summary;

/// Distances at which means of rows, and of columns, are compared.
pub const LINE_LAGS: [usize; 7] = [1, 2, 4, 8, 16, 32, 64];

/// Mean squares and products of the relative deviations of the field.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Field {
    /// Mean square over single pixels.
    pub pixels: f64,
    /// Mean product of neighbouring pixels: the smooth part.
    pub smooth: f64,
    /// Mean square of the row means.
    pub rows: f64,
    /// Mean square of the column means.
    pub columns: f64,
    /// Mean products of row means [`LINE_LAGS`] apart.
    pub row_lags: [f64; LINE_LAGS.len()],
    /// Mean products of column means at the same distances.
    pub column_lags: [f64; LINE_LAGS.len()],
    /// Mean products with the shapes of [`gradient`](super::gradient), in its order.
    pub shapes: [f64; 4],
    /// Squared differences of the halves: lower less upper, right less left.
    pub halves: [f64; 2],
}

/// Returns the relative deviations of line means from their mean.
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
    /// Computes the field from the mean image of bright frames.
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
            // Rows and columns determine nearly all of a smooth field.
            smooth: (of_rows + of_columns).min(pixels),
            rows: of_rows,
            columns: of_columns,
            row_lags: LINE_LAGS.map(|lag| at(&rows, lag)),
            column_lags: LINE_LAGS.map(|lag| at(&columns, lag)),
            halves: [halves(&rows), halves(&columns)],
        }
    }
}
