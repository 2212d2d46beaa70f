//! Covariance of a pixel's noise in successive frames, from mean square successive differences (von Neumann
//! 1941).

use super::jackknife::{Blocks, Value};
use super::layout::Layout;

/// Squared differences of successive frames, and the first and last frame.
#[derive(Debug, Clone)]
pub struct Successive {
    squares: Vec<f32>,
    /// First and last frame minus their means, DN.
    first: Vec<f32>,
    last: Vec<f32>,
}

impl Successive {
    /// Creates an accumulator for frames of this number of pixels.
    pub fn new(pixels: usize) -> Self {
        Self { squares: vec![0.0; pixels], first: vec![0.0; pixels], last: vec![0.0; pixels] }
    }

    /// Discards all frames.
    pub fn clear(&mut self) {
        self.squares.fill(0.0);
    }

    /// Adds a row of the next frame, minus the frame's mean, from pixel `at` on.
    #[inline(always)]
    pub fn row(&mut self, at: usize, row: &[f32], is_first: bool) {
        let last = &mut self.last[at..][..row.len()];
        if is_first {
            self.first[at..][..row.len()].copy_from_slice(row);
        } else {
            for ((s, l), v) in self.squares[at..][..row.len()].iter_mut().zip(&*last).zip(row) {
                *s += (v - l) * (v - l);
            }
        }
        last.copy_from_slice(row);
    }

    /// Merges the frames that follow.
    pub fn merge(&mut self, later: &Self) {
        let seam = self.last.iter().zip(&later.first).map(|(a, b)| (b - a) * (b - a));
        self.squares.iter_mut().zip(&later.squares).zip(seam).for_each(|((s, o), seam)| *s += o + seam);
        self.last.copy_from_slice(&later.last);
    }

    /// Covariance of a pixel's noise in successive frames, DN^2: the mean product, plus the variance over the
    /// number of frames, which subtracting the mean removed; 0 for independent frames. `squares`: squared
    /// deviations; `mean`: means of the pixels.
    pub fn finish(&self, layout: &Layout, dof: f64, squares: &[f32], mean: &[f32]) -> Value {
        let mut blocks = Blocks::default();
        layout.runs(|run, count, block| {
            let end = |v: f32, i: usize| f64::from(v - mean[i]).powi(2);
            let product = |i: usize| {
                let ends = end(self.first[i], i) + end(self.last[i], i);
                let square = f64::from(squares[i]);
                square - 0.5 * (ends + f64::from(self.squares[i])) + square / (dof + 1.0)
            };
            blocks.add(block, run.map(product).sum::<f64>() / dof, count);
        });
        blocks.value()
    }
}

/// Computes the standard error of this covariance over the variance, for one pixel of independent normal
/// noise: for a quadratic form with matrix M it is the root of 2 tr (P M P)^2, where P subtracts the mean.
pub fn error_of(frames: usize) -> f64 {
    let n = frames as f64;
    let form = |i: usize, j: usize| match i.abs_diff(j) {
        0 => 1.0 / (n * (n - 1.0)),
        1 => 0.5 / (n - 1.0),
        _ => 0.0,
    };
    // A row holds the diagonal and one or two elements beside it.
    let row = |i: usize| {
        let beside = f64::from(u8::from(i > 0)) + f64::from(u8::from(i + 1 < frames));
        (form(0, 0) + beside * form(0, 1)) / n
    };
    let all = (0..frames).map(row).sum::<f64>() / n;
    let without = |i: usize, j: usize| form(i, j) - row(i) - row(j) + all;
    let square: f64 = (0..frames).flat_map(|i| (0..frames).map(move |j| without(i, j).powi(2))).sum();
    (2.0 * square).sqrt()
}

#[cfg(test)]
mod tests {
    use super::error_of;

    /// Two frames carry no information. For three the estimate is -r^2 / 2 + (sum of squares) / 6, with r of
    /// the middle frame, of variance 1/9.
    #[test]
    fn few_frames_say_little() {
        assert!(error_of(2) < 1e-12);
        assert!((error_of(3) - 1.0 / 3.0).abs() < 1e-12, "{}", error_of(3));
        assert!((error_of(400) * 399f64.sqrt() - 1.0).abs() < 0.01, "{}", error_of(400));
    }
}
