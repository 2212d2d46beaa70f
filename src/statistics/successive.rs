//! Covariance of a pixel's noise with that in the next frame, from mean square successive differences (von Neumann 1941).

use super::jackknife::{Blocks, Value};
use super::pass::Layout;

/// Squared differences of successive frames, and the frames at both ends.
#[derive(Debug, Clone)]
pub struct Successive {
    squares: Vec<f32>,
    /// The first and the last frame, less their means, DN.
    first: Vec<f32>,
    last: Vec<f32>,
}

impl Successive {
    /// For frames of so many pixels.
    pub fn new(pixels: usize) -> Self {
        Self { squares: vec![0.0; pixels], first: vec![0.0; pixels], last: vec![0.0; pixels] }
    }

    /// Forgets every frame.
    pub fn clear(&mut self) {
        self.squares.fill(0.0);
    }

    /// A row of the next frame, less the frame's mean, from place `at` on.
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

    /// Adds the frames that follow.
    pub fn merge(&mut self, later: &Self) {
        let seam = self.last.iter().zip(&later.first).map(|(a, b)| (b - a) * (b - a));
        self.squares.iter_mut().zip(&later.squares).zip(seam).for_each(|((s, o), seam)| *s += o + seam);
        self.last.copy_from_slice(&later.last);
    }

    /// Mean product of a pixel's deviations in successive frames, DN^2: -variance / frames for independent ones. `squares` are
    /// the squared deviations and `mean` the means of the pixels.
    pub fn finish(&self, layout: &Layout, dof: f64, squares: &[f32], mean: &[f32]) -> Value {
        let mut blocks = Blocks::default();
        layout.runs(|run, count, block| {
            let end = |v: f32, i: usize| f64::from(v - mean[i]).powi(2);
            let product = |i: usize| {
                let ends = end(self.first[i], i) + end(self.last[i], i);
                f64::from(squares[i]) - 0.5 * (ends + f64::from(self.squares[i]))
            };
            blocks.add(block, run.map(product).sum::<f64>() / dof, count);
        });
        blocks.value()
    }
}
