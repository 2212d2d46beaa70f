//! Temporal variance of every pixel, its mean, and its spread over the pixels.

use super::jackknife::{Blocks, Value};
use super::layout::Layout;
use super::quadratic::Quadratic;

/// Sums of squared deviations of every pixel.
#[derive(Debug, Clone)]
pub struct Variance {
    squares: Vec<f32>,
}

impl Variance {
    /// Creates an accumulator for frames of this number of pixels.
    pub fn new(pixels: usize) -> Self {
        Self { squares: vec![0.0; pixels] }
    }

    /// Discards all frames.
    pub fn clear(&mut self) {
        self.squares.fill(0.0);
    }

    /// Squared deviations, row by row, DN^2.
    pub fn squares(&self) -> &[f32] {
        &self.squares
    }

    /// Mean over the pixels, DN^2.
    pub fn finish(&self, layout: &Layout, dof: f64) -> Value {
        let mut blocks = Blocks::default();
        // Masked pixels have squares of 0.
        layout.runs(|run, count, block| {
            let sum: f64 = self.squares[run].iter().map(|s| f64::from(*s)).sum();
            blocks.add(block, sum / dof, count);
        });
        blocks.value()
    }

    /// Excess of the spread of the pixels' variances over sampling scatter; 0 for equal pixels with normal
    /// noise.
    ///
    /// Each pixel is compared with the expectation at its own mean: hot pixels and shading have more shot
    /// noise. Differences in the dark are mostly offset; only pixels that stand out carry signal there.
    pub fn tails(&self, layout: &Layout, dof: f64, mean_dn: impl Fn(usize) -> f64) -> Value {
        let var = self.finish(layout, dof).value;
        let zero = layout.zero.as_deref();
        let signal = |i: usize| mean_dn(i) - zero.map_or(0.0, |z| f64::from(z[i]));
        let marked = || layout.mask.iter().enumerate().filter(|(_, m)| **m > 0.0).map(|(i, _)| i);
        let lit = marked().map(signal).sum::<f64>() / layout.pixels;
        let noise = var.max(0.0).sqrt();
        let bright = lit > 10.0 * noise;
        let ratio = |i: usize| {
            let more = signal(i) - lit;
            let more = if bright || more > 5.0 * noise { layout.gain * more } else { 0.0 };
            f64::from(self.squares[i]) / dof / (var + more).max(0.1 * var)
        };
        let (mut square, mut level) = (Blocks::default(), Blocks::default());
        layout.runs(|run, count, block| {
            let (first, second) = run.map(ratio).fold((0.0, 0.0), |(a, b), r| (a + r, b + r * r));
            square.add(block, second, count);
            level.add(block, first, count);
        });
        let allowed = 1.0 + 2.0 / dof;
        square.with(&level, |square, level| square / (level * level * allowed) - 1.0)
    }
}

impl Quadratic for Variance {
    #[inline(always)]
    fn row(&mut self, y: usize, image: &[f32], layout: &Layout) {
        let columns = layout.columns();
        let (out, row) = (&mut self.squares[y * columns..][..columns], &image[y * columns..][..columns]);
        for (o, &v) in out.iter_mut().zip(row) {
            *o += v * v;
        }
    }

    fn end(&mut self, _: &[f32], _: &Layout) {}

    fn absorb(&mut self, other: &Self) {
        self.squares.iter_mut().zip(&other.squares).for_each(|(a, b)| *a += b);
    }
}
