//! Temporal variance of the means of rows and of columns about their mean over the frames: noise common to
//! whole lines. Not EMVA's spatial row and column variance.

use super::layout::Layout;
use super::quadratic::Quadratic;

/// Sums of squared deviations of row means and of column means.
#[derive(Debug, Clone)]
pub struct Lines {
    rows: f64,
    columns: f64,
    /// Row means and column sums of the current image.
    row_means: Vec<f32>,
    column_sums: Vec<f32>,
}

impl Lines {
    /// Creates an accumulator for frames of (rows, columns).
    pub fn new((rows, columns): (usize, usize)) -> Self {
        Self { rows: 0.0, columns: 0.0, row_means: vec![0.0; rows], column_sums: vec![0.0; columns] }
    }

    /// Variance of row means and of column means, DN^2.
    pub fn finish(&self, layout: &Layout, dof: f64) -> [f64; 2] {
        let lines = |counts: &[f32]| counts.iter().filter(|n| **n > 0.0).count().max(1) as f64;
        [self.rows / dof / lines(&layout.row_pixels), self.columns / dof / lines(&layout.column_pixels)]
    }

    /// Mean of every row of the last complete image.
    pub fn row_means(&self) -> &[f32] {
        &self.row_means
    }

    /// Mean of every column of the last complete image.
    pub fn column_means<'a>(&'a self, layout: &'a Layout) -> impl ExactSizeIterator<Item = f32> + 'a {
        self.column_sums.iter().zip(&layout.column_pixels).map(|(s, n)| s / n.max(1.0))
    }
}

impl Quadratic for Lines {
    #[inline(always)]
    fn row(&mut self, y: usize, image: &[f32], layout: &Layout) {
        let columns = layout.columns();
        let row = &image[y * columns..][..columns];
        if y == 0 {
            self.column_sums.fill(0.0);
        }
        for (sum, v) in self.column_sums.iter_mut().zip(row) {
            *sum += v;
        }
        let mut lanes = [0f32; 32];
        let mut parts = row.chunks_exact(32);
        for part in &mut parts {
            for (l, v) in lanes.iter_mut().zip(part) {
                *l += v;
            }
        }
        let rest: f32 = parts.remainder().iter().sum();
        let mean = (lanes.iter().sum::<f32>() + rest) / layout.row_pixels[y].max(1.0);
        self.row_means[y] = mean;
        self.rows += f64::from(mean) * f64::from(mean);
    }

    fn end(&mut self, _: &[f32], layout: &Layout) {
        let squares: f64 = self.column_means(layout).map(|m| f64::from(m) * f64::from(m)).sum();
        self.columns += squares;
    }

    fn absorb(&mut self, other: &Self) {
        self.rows += other.rows;
        self.columns += other.columns;
    }
}
