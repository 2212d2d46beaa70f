//! Pixels that the camera fills in from their neighbours: its correction of defects.
//!
//! Such a pixel has no noise of its own, and shares that of its neighbours: in the mean over the image that is
//! what a weak filter does. From frame to frame it changes as the mean of those neighbours does, to within
//! rounding, and no other pixel does so frame after frame.

use ndarray::Array2;
use std::borrow::Borrow;

/// Neighbours whose mean fills a defect in, (row, column) from it: those in the row, in the column, all four, all
/// eight, and copies of one: of two that are alike the first is taken for the copy, and the other counts.
const KERNELS: [&[(isize, isize)]; 6] = [
    &[(0, -1), (0, 1)],
    &[(-1, 0), (1, 0)],
    &[(-1, 0), (1, 0), (0, -1), (0, 1)],
    &[(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)],
    &[(0, 1)],
    &[(1, 0)],
];
/// Temporal variance from which on chance does not do it, DN^2: of normal noise a difference of two frames then
/// lies within rounding at one in fourteen pixels, and in all differences of four frames and two sets at one in
/// ten million.
pub const LEAST_VAR_DN2: f64 = 40.0;
/// Level from which on, as a share of full scale: some sets are enough.
pub const LEAST_LEVEL: f64 = 0.25;
/// Sets that are looked at, and frames of each at least.
pub const SETS: (usize, usize) = (4, 4);
/// Beyond this share of the pixels it is no correction of defects: the image is smoothed.
const MOST: f64 = 0.05;

/// Pixels whose changes from frame to frame are those of the mean of some neighbours, to within a code.
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
    // Two changes leave a few pixels of a hundred, which are looked at one by one.
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
            // A pixel that does not change at all is dead, and is left out elsewhere.
            if is_filled && changes.iter().any(|c| c[i] != 0) {
                found.push(i);
            }
        }
    }
    found
}

/// Pixels that every set that was looked at shows to be filled in.
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

    /// Of two sets of 8 frames of 128 x 96 pixels with a deviation of 8 DN: pixels that are filled in by each
    /// kernel are found, whole; of others none, nor where all is smoothed.
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
                    // A smoothed frame has a third of the deviation.
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
        // The pixel that is smoothed last is the mean of neighbours that are final.
        assert_eq!((found(false, false).len(), found(false, true).len()), (0, 1));
    }
}
