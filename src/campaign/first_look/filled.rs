//! Pixels interpolated by the camera from their neighbours: in-camera defect correction.
//!
//! Such a pixel has no noise of its own, and shares that of its neighbours; in the mean over the image
//! this looks like a weak filter. From frame to frame it changes as the mean of those neighbours does,
//! to within rounding, and no other pixel does so frame after frame.

use ndarray::Array2;
use std::borrow::Borrow;

/// Interpolation kernels, (row, column) from the defect pixel: neighbours in the row, in the column, all
/// four, all eight, and copies of one neighbour. Of two equal pixels the first is taken for the copy and
/// the other is used.
const KERNELS: [&[(isize, isize)]; 6] = [
    &[(0, -1), (0, 1)],
    &[(-1, 0), (1, 0)],
    &[(-1, 0), (1, 0), (0, -1), (0, 1)],
    &[(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)],
    &[(0, 1)],
    &[(1, 0)],
];
/// Minimum temporal variance at which coincidence is excluded, DN^2: for normal noise a difference of
/// two frames lies within rounding at one pixel in fourteen, and all differences of four frames and two
/// sets at one in ten million.
pub const LEAST_VAR_DN2: f64 = 40.0;
/// Minimum level, relative to full scale: some sets suffice.
pub const LEAST_LEVEL: f64 = 0.25;
/// Number of sets examined, and minimum number of frames of each.
pub const SETS: (usize, usize) = (4, 4);
/// Maximum fraction of pixels under defect correction: beyond, the image is smoothed.
const MOST: f64 = 0.05;

/// Finds pixels whose changes from frame to frame equal those of the mean of some neighbours, to within
/// a code.
pub fn candidates<F: Borrow<Array2<u16>>>(frames: &[F]) -> Vec<usize> {
    let Some(first) = frames.first().map(F::borrow) else { return Vec::new() };
    let (rows, columns) = first.dim();
    if frames.len() < SETS.1 || rows < 3 || columns < 3 {
        return Vec::new();
    }
    let pixels: Vec<&[u16]> = frames.iter().filter_map(|f| f.borrow().as_slice()).collect();
    let kernels = KERNELS.map(|k| k.iter().map(|(y, x)| y * columns as isize + x).collect::<Vec<_>>());
    let changes: Vec<Vec<i32>> = pixels
        .windows(2)
        .map(|w| w[0].iter().zip(w[1]).map(|(a, b)| i32::from(*b) - i32::from(*a)).collect())
        .collect();
    let mut found = Vec::new();
    // Two changes leave a few per cent of the pixels, which are then examined one by one.
    let (mut off, mut near) = (vec![0i32; columns - 2], vec![0u8; columns - 2]);
    for y in 1..rows - 1 {
        let from = y * columns + 1;
        near.fill(0);
        for (bit, kernel) in kernels.iter().enumerate() {
            let n = kernel.len() as i32;
            let mut both = vec![1u8; columns - 2];
            for change in changes.iter().take(2) {
                off.iter_mut().zip(&change[from..]).for_each(|(o, c)| *o = n * c);
                for d in kernel {
                    off.iter_mut().zip(&change[from.wrapping_add_signed(*d)..]).for_each(|(o, c)| *o -= c);
                }
                both.iter_mut().zip(&off).for_each(|(b, o)| *b &= u8::from(o.abs() <= n));
            }
            near.iter_mut().zip(&both).for_each(|(m, b)| *m |= b << bit);
        }
        for (x, near) in near.iter().enumerate().filter(|(_, near)| **near != 0) {
            let i = from + x;
            let follows = |kernel: &[isize], change: &[i32]| {
                let sum: i32 = kernel.iter().map(|d| change[i.wrapping_add_signed(*d)]).sum();
                let n = kernel.len() as i32;
                (n * change[i] - sum).abs() <= n
            };
            let is_filled = kernels
                .iter()
                .enumerate()
                .any(|(bit, kernel)| near >> bit & 1 == 1 && changes.iter().all(|c| follows(kernel, c)));
            // A pixel that never changes is dead, and is excluded elsewhere.
            if is_filled && changes.iter().any(|c| c[i] != 0) {
                found.push(i);
            }
        }
    }
    found
}

/// Returns the pixels found in every examined set.
pub fn of_sets(sets: &[&[usize]], pixels: usize) -> Vec<usize> {
    let [first, others @ ..] = sets else { return Vec::new() };
    if others.is_empty() {
        return Vec::new();
    }
    let all = |i: &usize| others.iter().all(|o| o.binary_search(i).is_ok());
    let found: Vec<usize> = first.iter().copied().filter(all).collect();
    if found.len() as f64 > MOST * pixels as f64 { Vec::new() } else { found }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Two sets of 8 frames of 128 x 96 pixels with a standard deviation of 8 DN: all pixels filled in
    /// by each kernel are found, and no others; none are found if everything is smoothed.
    #[test]
    fn filled_pixels_are_found_and_no_others() {
        let (rows, columns) = (96usize, 128usize);
        let frame = |number: u64, sd: f64| {
            let value = |i: usize| {
                let z = PixelRng::new(31, Stream::Frame, number, i as u32, 0).normal();
                (1000.0 + sd * z + (i % 7) as f64).round() as u16
            };
            Array2::from_shape_fn((rows, columns), |(y, x)| value(y * columns + x))
        };
        let places: Vec<usize> = (0..24).map(|k| (4 + 3 * k) * columns + 5 + 4 * k).collect();
        let mean = |image: &Array2<u16>, i: usize, kernel: &[(isize, isize)]| {
            let at = |(dy, dx): &(isize, isize)| {
                f64::from(
                    image[((i / columns).wrapping_add_signed(*dy), (i % columns).wrapping_add_signed(*dx))],
                )
            };
            kernel.iter().map(at).sum::<f64>() / kernel.len() as f64
        };
        let set = |first: u64, fill: bool, smooth: bool| -> Vec<usize> {
            let frames: Vec<Array2<u16>> = (first..first + 8)
                .map(|n| {
                    // Smoothing reduces the standard deviation to a third.
                    let raw = frame(n, if smooth { 30.0 } else { 8.0 });
                    let mut out = raw.clone();
                    for (k, i) in places.iter().enumerate().filter(|_| fill) {
                        out[(i / columns, i % columns)] = mean(&raw, *i, KERNELS[k % 6]).round() as u16;
                    }
                    if smooth {
                        for i in (1..rows - 1).flat_map(|y| (1..columns - 1).map(move |x| y * columns + x)) {
                            out[(i / columns, i % columns)] = mean(&out, i, KERNELS[3]).round() as u16;
                        }
                    }
                    out
                })
                .collect();
            candidates(&frames)
        };
        let found = |fill, smooth| {
            let sets = [set(0, fill, smooth), set(100, fill, smooth)];
            of_sets(&[&sets[0], &sets[1]], rows * columns)
        };
        assert_eq!(found(true, false), places);
        // The last smoothed pixel is the mean of neighbours that are already final.
        assert_eq!((found(false, false).len(), found(false, true).len()), (0, 1));
    }
}
