//! Fixed pattern in the middle of the frame, without smooth shading: it shows the orientation.

/// Side of the blocks whose means are taken off, pixels: shading is smooth within them.
const BLOCK: usize = 8;

/// The pattern of an image of so many columns, in which single pixels far off count as little as others (at most
/// three deviations).
pub fn pattern(image: &[f32], columns: usize) -> Vec<f64> {
    let image: Vec<f64> = image.iter().map(|v| f64::from(*v)).collect();
    let mut out = flattened(&image, columns);
    let usual = 1.5 * crate::statistics::median::median(out.iter().map(|v| v.abs()));
    out.iter_mut().for_each(|v| *v = v.clamp(-3.0 * usual, 3.0 * usual));
    out
}

/// An image of so many columns, of mean 0 in every block, and then in every row and column.
pub fn flattened(image: &[f64], columns: usize) -> Vec<f64> {
    let rows = image.len() / columns.max(1);
    let mut out = vec![0.0; rows * columns];
    for top in (0..rows).step_by(BLOCK) {
        for left in (0..columns).step_by(BLOCK) {
            let (bottom, right) = ((top + BLOCK).min(rows), (left + BLOCK).min(columns));
            let at = || (top..bottom).flat_map(move |y| (left..right).map(move |x| y * columns + x));
            let mean = at().map(|i| image[i]).sum::<f64>() / at().count() as f64;
            at().for_each(|i| out[i] = image[i] - mean);
        }
    }
    // Rows and columns have noise in common, which would look like a pattern.
    for y in 0..rows {
        let row = &mut out[y * columns..][..columns];
        let mean = row.iter().sum::<f64>() / columns as f64;
        row.iter_mut().for_each(|v| *v -= mean);
    }
    for x in 0..columns {
        let mean = (0..rows).map(|y| out[y * columns + x]).sum::<f64>() / rows as f64;
        (0..rows).for_each(|y| out[y * columns + x] -= mean);
    }
    out
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
