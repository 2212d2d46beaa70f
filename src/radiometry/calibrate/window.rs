//! Means over a window centred at every pixel (eq. 47), at a cost independent of the window's size (except
//! for a rim of half a window).

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use std::ops::Range;

/// Computes the mean over an `m` x `m` window centred at each pixel, (rows, columns). At the edges the window
/// is truncated, and the least-squares plane through the rest is evaluated at the pixel: its mean would
/// belong to another place, and light that falls towards the edges would appear as a K below 1.
///
/// `m` is rounded up to an odd number. Sums are kept in `f64`, and updated along the way.
///
/// ```
/// let even = ndarray::Array2::from_elem((20, 30), 7.5f32);
/// assert_eq!(radcam::calibrate::window::mean(even.view(), 9), even);
/// ```
pub fn mean(image: ArrayView2<'_, f32>, m: usize) -> Array2<f32> {
    let (rows, columns) = image.dim();
    let mut out = Array2::zeros((rows, columns));
    if columns == 0 {
        return out;
    }
    let band = rows.div_ceil(4 * rayon::current_num_threads()).max(m);
    let pixels = out.as_slice_mut().unwrap_or_default();
    pixels.par_chunks_mut(band * columns).enumerate().for_each(|(i, out)| {
        let mut sweep = Sweep::new(image, m, i * band);
        out.chunks_mut(columns).for_each(|row| sweep.next(row));
    });
    out
}

/// Row-by-row [`mean`]: the column sums of the window are carried downwards.
pub(super) struct Sweep<'a> {
    image: ArrayView2<'a, f32>,
    reach: usize,
    row: usize,
    sums: Vec<f64>,
    /// Column sums of the slope along y, for rows with a truncated window.
    tilted: Vec<f64>,
    held: Range<usize>,
}

impl<'a> Sweep<'a> {
    pub(super) fn new(image: ArrayView2<'a, f32>, m: usize, row: usize) -> Self {
        let none = || vec![0.0; image.ncols()];
        Self { image, reach: m / 2, row, sums: none(), tilted: none(), held: 0..0 }
    }

    /// Writes the next row.
    pub(super) fn next(&mut self, out: &mut [f32]) {
        let Self { image, reach, row, sums, tilted, held } = self;
        let (rows, columns) = image.dim();
        let wanted = window(*row, *reach, rows);
        let add = |sums: &mut [f64], row: usize, weight: f64| {
            sums.iter_mut().zip(image.row(row)).for_each(|(s, &x)| *s += weight * f64::from(x));
        };
        if held.end == 0 {
            wanted.clone().for_each(|row| add(sums, row, 1.0));
        } else {
            (held.end..wanted.end).for_each(|row| add(sums, row, 1.0));
            (held.start..wanted.start).for_each(|row| add(sums, row, -1.0));
        }
        *held = wanted.clone();
        let y_lever = Lever::new(&wanted, *row);
        if y_lever.cut {
            tilted.fill(0.0);
            wanted.clone().for_each(|row| add(tilted, row, y_lever.weight(row)));
        }
        *row += 1;
        let height = wanted.len() as f64;
        // Along the row, likewise with the column sums: first truncated windows, then whole ones.
        let (reach, whole) = (*reach, *reach..columns.saturating_sub(*reach));
        for x in (0..columns).filter(|x| !whole.contains(x)) {
            let across = window(x, reach, columns);
            let width = across.len() as f64;
            let mut value = sums[across.clone()].iter().sum::<f64>() / (height * width);
            if y_lever.cut {
                value += tilted[across.clone()].iter().sum::<f64>() / width;
            }
            let x_lever = Lever::new(&across, x);
            if x_lever.cut {
                value += across.map(|x| x_lever.weight(x) * sums[x]).sum::<f64>() / height;
            }
            out[x] = value as f32;
        }
        if whole.is_empty() {
            return;
        }
        let m = 2 * reach + 1;
        let slide = |sums: &[f64], scale: f64, out: &mut [f32], keep: f32| {
            let mut sum = sums[..m - 1].iter().sum::<f64>();
            for (out, (&enters, &leaves)) in out.iter_mut().zip(sums[m - 1..].iter().zip(sums)) {
                sum += enters;
                *out = keep * *out + (sum * scale) as f32;
                sum -= leaves;
            }
        };
        slide(sums, 1.0 / (height * m as f64), &mut out[whole.clone()], 0.0);
        if y_lever.cut {
            slide(tilted, 1.0 / m as f64, &mut out[whole], 1.0);
        }
    }
}

/// Computes [`mean`] at one pixel, by its definition.
pub(super) fn at(image: ArrayView2<'_, f32>, m: usize, (y, x): (usize, usize)) -> f64 {
    let (down, across) = (window(y, m / 2, image.nrows()), window(x, m / 2, image.ncols()));
    let (of_y, of_x) = (Lever::new(&down, y), Lever::new(&across, x));
    let (h, w) = (down.len() as f64, across.len() as f64);
    let mut sum = 0.0;
    for b in down {
        for a in across.clone() {
            sum += f64::from(image[(b, a)]) * (1.0 / (h * w) + of_y.weight(b) / w + of_x.weight(a) / h);
        }
    }
    sum
}

/// Returns the places of a window about `at` that lie inside.
fn window(at: usize, reach: usize, n: usize) -> Range<usize> {
    at.saturating_sub(reach)..(at + reach + 1).min(n)
}

/// Weights along one axis of a truncated window: contribution of each place to the slope of a line through
/// the window, evaluated at the pixel.
struct Lever {
    cut: bool,
    middle: f64,
    /// (pixel - middle) / sum (place - middle)^2
    slope: f64,
}

impl Lever {
    fn new(window: &Range<usize>, at: usize) -> Self {
        let n = window.len() as f64;
        let middle = 0.5 * (window.start + window.end - 1) as f64;
        let off = at as f64 - middle;
        // For n equally spaced places.
        let spread = n * (n * n - 1.0) / 12.0;
        let cut = off != 0.0 && spread > 0.0;
        Self { cut, middle, slope: if cut { off / spread } else { 0.0 } }
    }

    fn weight(&self, place: usize) -> f64 {
        self.slope * (place as f64 - self.middle)
    }

    /// Sum of the squares of all weights along this axis.
    fn square(&self, n: usize) -> f64 {
        let n = n as f64;
        self.slope * self.slope * n * (n * n - 1.0) / 12.0
    }
}

/// Computes the variance of [`mean`] at a pixel for independent pixels of variance 1: 1/m^2 inside, more for
/// a truncated window.
pub fn variance((y, x): (usize, usize), (rows, columns): (usize, usize), m: usize) -> f64 {
    let (down, across) = (window(y, m / 2, rows), window(x, m / 2, columns));
    let (h, w) = (down.len(), across.len());
    let (of_y, of_x) = (Lever::new(&down, y).square(h), Lever::new(&across, x).square(w));
    1.0 / (h * w) as f64 + of_y / w as f64 + of_x / h as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A plane is its own mean everywhere, edges and corners included; the stated variance is that of the
    /// weights.
    #[test]
    fn a_slope_is_not_bent_at_the_edges() {
        let plane = Array2::from_shape_fn((30, 40), |(y, x)| 100.0 + 3.0 * y as f32 - 2.0 * x as f32);
        for (a, b) in mean(plane.view(), 9).iter().zip(&plane) {
            assert!((a - b).abs() < 1e-3, "{a} {b}");
        }
        for at in [(15, 20), (0, 0), (1, 38), (29, 7)] {
            let square: f64 = (0..30 * 40)
                .map(|i| {
                    let mut one = Array2::zeros((30, 40));
                    one[(i / 40, i % 40)] = 1.0;
                    f64::from(mean(one.view(), 9)[at]).powi(2)
                })
                .sum();
            assert!((square / variance(at, (30, 40), 9) - 1.0).abs() < 1e-4, "{at:?}: {square}");
        }
    }

    proptest! {
        /// Compared with the definition, for sizes smaller and larger than the window.
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
                    // Least-squares plane through the window, at the pixel: x and y are orthogonal over a
                    // rectangle.
                    let values = part.mapv(f64::from);
                    let (h, w) = values.dim();
                    let (from_y, from_x) = (y.saturating_sub(reach) as f64, x.saturating_sub(reach) as f64);
                    let (mid_y, mid_x) = (from_y + 0.5 * (h as f64 - 1.0), from_x + 0.5 * (w as f64 - 1.0));
                    let mut expected = values.mean().unwrap();
                    let (mut yy, mut xx, mut ye, mut xe) = (0.0, 0.0, 0.0, 0.0);
                    for ((b, a), v) in values.indexed_iter() {
                        let (dy, dx) = (from_y + b as f64 - mid_y, from_x + a as f64 - mid_x);
                        (yy, xx, ye, xe) = (yy + dy * dy, xx + dx * dx, ye + dy * v, xe + dx * v);
                    }
                    expected += if yy > 0.0 { ye / yy * (y as f64 - mid_y) } else { 0.0 };
                    expected += if xx > 0.0 { xe / xx * (x as f64 - mid_x) } else { 0.0 };
                    prop_assert!((f64::from(means[(y, x)]) - expected).abs() < 4e-3, "{y} {x}");
                    prop_assert!((at(image.view(), 2 * reach + 1, (y, x)) - expected).abs() < 1e-6, "{y} {x}");
                }
            }
        }
    }
}
