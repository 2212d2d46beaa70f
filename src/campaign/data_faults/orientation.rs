//! Fixed pattern in the centre of the frame, without smooth shading: it shows the orientation.

use crate::statistics::median::{MAD_OF_NORMAL, median};

/// Side of the blocks whose means are removed, pixels: shading is smooth within them.
const BLOCK: usize = 8;

/// Returns the pattern of an image with this number of columns, with outliers clipped (at most three
/// deviations).
pub fn pattern(image: &[f32], columns: usize) -> Vec<f64> {
    let image: Vec<f64> = image.iter().map(|v| f64::from(*v)).collect();
    let mut out = flattened(&image, columns);
    let usual = 1.5 * median(out.iter().map(|v| v.abs()));
    out.iter_mut().for_each(|v| *v = v.clamp(-3.0 * usual, 3.0 * usual));
    out
}

/// Minimum deviation of a hot or dusty pixel from the median of its block (a named choice): in a mean it
/// would affect all pixels of the block, the row and the column.
const MAX_DEVIATIONS: f64 = 5.0;

/// Returns an image with this number of columns, with mean 0 in every block, and then in every row and
/// column, hot pixels excluded.
pub fn flattened(image: &[f64], columns: usize) -> Vec<f64> {
    let rows = image.len() / columns.max(1);
    let mut out = vec![0.0; rows * columns];
    let corners = || {
        let of_row = move |top| (0..columns).step_by(BLOCK).map(move |left| (top, left));
        (0..rows).step_by(BLOCK).flat_map(of_row)
    };
    let block = |(top, left): (usize, usize)| {
        let (bottom, right) = ((top + BLOCK).min(rows), (left + BLOCK).min(columns));
        (top..bottom).flat_map(move |y| (left..right).map(move |x| y * columns + x))
    };
    for corner in corners() {
        let middle = median(block(corner).map(|i| image[i]));
        block(corner).for_each(|i| out[i] = image[i] - middle);
    }
    let usual = median(out.iter().map(|v| v.abs())) / MAD_OF_NORMAL;
    let counts: Vec<bool> = out.iter().map(|v| usual == 0.0 || v.abs() < MAX_DEVIATIONS * usual).collect();
    // Row and column noise would look like a pattern.
    for corner in corners() {
        centre(&mut out, &counts, || block(corner));
    }
    for y in 0..rows {
        centre(&mut out, &counts, || y * columns..(y + 1) * columns);
    }
    for x in 0..columns {
        centre(&mut out, &counts, || (x..rows * columns).step_by(columns));
    }
    out
}

/// Subtracts the mean of the counted values from the values at these indices.
fn centre<I: Iterator<Item = usize>>(values: &mut [f64], counts: &[bool], places: impl Fn() -> I) {
    let (sum, n) = places().filter(|i| counts[*i]).fold((0.0, 0.0), |(sum, n), i| (sum + values[i], n + 1.0));
    let mean = sum / f64::max(n, 1.0);
    places().for_each(|i| values[i] -= mean);
}

/// Returns the correlation of two patterns.
pub fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    product(a, b) / (product(a, a) * product(b, b)).sqrt()
}

/// Reorientation of an image with this number of columns.
pub type Turn = fn(&[f64], usize) -> Vec<f64>;

/// Possible orientations other than the original.
pub const TURNS: [(&str, Turn); 3] =
    [("left and right exchanged", left_right), ("upside down", up_down), ("turned by 180 degrees", turned)];

fn left_right(image: &[f64], columns: usize) -> Vec<f64> {
    image.chunks_exact(columns).flat_map(|row| row.iter().rev().copied()).collect()
}

fn up_down(image: &[f64], columns: usize) -> Vec<f64> {
    image.chunks_exact(columns).rev().flatten().copied().collect()
}

fn turned(image: &[f64], _: usize) -> Vec<f64> {
    image.iter().rev().copied().collect()
}
