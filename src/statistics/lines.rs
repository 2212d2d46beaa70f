//! Variance of the means of rows and of columns: noise that whole lines share.

use super::pass::{Layout, Quadratic};

/// Squares of the deviations of row means and of column means.
#[derive(Debug, Clone, Default)]
pub struct Lines {
    rows: f64,
    columns: f64,
    /// Sums of the columns of the frame at hand.
    now: Vec<f32>,
}

impl Lines {
    /// Variance of row means and of column means, DN^2.
    pub fn finish(&self, layout: &Layout, dof: f64) -> [f64; 2] {
        let lines = |counts: &[f32]| counts.iter().filter(|n| **n > 0.0).count().max(1) as f64;
        [self.rows / dof / lines(&layout.row_pixels), self.columns / dof / lines(&layout.column_pixels)]
    }
}

impl Quadratic for Lines {
    #[inline(always)]
    fn row(&mut self, y: usize, image: &[f32], layout: &Layout) {
        let columns = layout.columns();
        let row = &image[y * columns..][..columns];
        if y == 0 {
            self.now.clear();
            self.now.resize(columns, 0.0);
        }
        let mut sum = 0.0f64;
        for (part, now) in row.chunks(64).zip(self.now.chunks_mut(64)) {
            let mut lanes = [0f32; 8];
            for (eight, out) in part.chunks(8).zip(now.chunks_mut(8)) {
                for ((l, o), v) in lanes.iter_mut().zip(out).zip(eight) {
                    *l += v;
                    *o += v;
                }
            }
            sum += f64::from(lanes.iter().sum::<f32>());
        }
        let mean = sum / f64::from(layout.row_pixels[y]).max(1.0);
        self.rows += mean * mean;
    }

    fn end(&mut self, _: &[f32], layout: &Layout) {
        let means =
            self.now.iter().zip(&layout.column_pixels).map(|(s, n)| f64::from(*s) / f64::from(n.max(1.0)));
        self.columns += means.map(|m| m * m).sum::<f64>();
    }

    fn absorb(&mut self, other: &Self) {
        self.rows += other.rows;
        self.columns += other.columns;
    }
}
