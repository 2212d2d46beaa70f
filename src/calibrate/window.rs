//! Means over a window centred at every pixel (eq. 47), at a cost that does not depend on the window's size.

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

/// Mean over an `m` x `m` window centred at each pixel, (rows, columns). At the edges the window is cut off and the
/// mean taken over what is left, so that an even image stays even there.
///
/// `m` is taken as the odd number not below it. Sums are kept in `f64`, added and taken off along the way.
///
/// ```
/// let even = ndarray::Array2::from_elem((20, 30), 7.5f32);
/// assert_eq!(radcam::calibrate::window::mean(even.view(), 9), even);
/// ```
pub fn mean(image: ArrayView2<'_, f32>, m: usize) -> Array2<f32> {
    let (rows, columns) = image.dim();
    let reach = m / 2;
    let mut out = Array2::zeros((rows, columns));
    // Bands of rows: each carries the column sums of its window downwards.
    let band = rows.div_ceil(4 * rayon::current_num_threads()).max(2 * reach + 1);
    if columns == 0 {
        return out;
    }
    let pixels = out.as_slice_mut().unwrap_or_default();
    pixels.par_chunks_mut(band * columns).enumerate().for_each(|(i, out)| {
        let first = i * band;
        let window = |row: usize| row.saturating_sub(reach)..(row + reach + 1).min(rows);
        let mut sums = vec![0.0f64; columns];
        let mut held = 0..0;
        for (y, out) in out.chunks_mut(columns).enumerate() {
            let wanted = window(first + y);
            let add = |sums: &mut [f64], row: usize, sign: f64| {
                sums.iter_mut().zip(image.row(row)).for_each(|(s, &x)| *s += sign * f64::from(x));
            };
            if held.is_empty() {
                wanted.clone().for_each(|row| add(&mut sums, row, 1.0));
            } else {
                (held.end..wanted.end).for_each(|row| add(&mut sums, row, 1.0));
                (held.start..wanted.start).for_each(|row| add(&mut sums, row, -1.0));
            }
            held = wanted.clone();
            // Along the row, the same with the column sums.
            let height = wanted.len() as f64;
            let (mut sum, mut from, mut to) = (0.0, 0, 0);
            for (x, out) in out.iter_mut().enumerate() {
                let (start, end) = (x.saturating_sub(reach), (x + reach + 1).min(columns));
                sum += sums[to..end].iter().sum::<f64>() - sums[from..start].iter().sum::<f64>();
                (from, to) = (start, end);
                *out = (sum / (height * (end - start) as f64)) as f32;
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against the definition, over sizes smaller and larger than the window.
        #[test]
        fn it_is_the_mean_over_the_window(
            rows in 1usize..14, columns in 1usize..14, reach in 0usize..5, seed in any::<u32>()
        ) {
            let image = Array2::from_shape_fn((rows, columns), |(y, x)| {
                (seed.wrapping_mul(2_654_435_761).wrapping_add((y * 131 + x * 977) as u32) % 4096) as f32
            });
            let means = mean(image.view(), 2 * reach + 1);
            for y in 0..rows {
                for x in 0..columns {
                    let part = image.slice(ndarray::s![
                        y.saturating_sub(reach)..(y + reach + 1).min(rows),
                        x.saturating_sub(reach)..(x + reach + 1).min(columns)
                    ]);
                    let expected = part.mapv(f64::from).mean().unwrap();
                    prop_assert!((f64::from(means[(y, x)]) - expected).abs() < 1e-3, "{y} {x}");
                }
            }
        }
    }
}
