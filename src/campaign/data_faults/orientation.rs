//! Fixed pattern in the middle of the frame, without smooth shading: it shows the orientation.

use crate::statistics::median::{MAD_OF_NORMAL, median};

/// Side of the blocks whose means are taken off, pixels: shading is smooth within them.
const BLOCK: usize = 8;

/// The pattern of an image of so many columns, in which single pixels far off count as little as others (at most
/// three deviations).
pub fn pattern(image: &[f32], columns: usize) -> Vec<f64> {
    let image: Vec<f64> = image.iter().map(|v| f64::from(*v)).collect();
    let mut out = flattened(&image, columns);
    let usual = 1.5 * median(out.iter().map(|v| v.abs()));
    out.iter_mut().for_each(|v| *v = v.clamp(-3.0 * usual, 3.0 * usual));
    out
}

/// Deviations of a pixel from the median of its block from which on it is hot, or dust (a named choice): a mean
/// would put its part of it into all pixels of the block, the row and the column.
const MAX_DEVIATIONS: f64 = 5.0;

/// An image of so many columns, of mean 0 in every block, and then in every row and column, hot pixels left out.
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
    // Rows and columns have noise in common, which would look like a pattern.
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

/// Takes the mean of those that count off the values at these places.
fn centre<I: Iterator<Item = usize>>(values: &mut [f64], counts: &[bool], places: impl Fn() -> I) {
    let (sum, n) = places().filter(|i| counts[*i]).fold((0.0, 0.0), |(sum, n), i| (sum + values[i], n + 1.0));
    let mean = sum / f64::max(n, 1.0);
    places().for_each(|i| values[i] -= mean);
}

/// Correlation of two patterns.
pub fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    product(a, b) / (product(a, a) * product(b, b)).sqrt()
}

/// Turns an image of so many columns.
pub type Turn = fn(&[f64], usize) -> Vec<f64>;

/// Ways in which a frame is turned, beside none.
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
