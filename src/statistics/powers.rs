//! Sums of powers of every pixel's deviations from its mean, found in one pass and merged.

use serde::{Deserialize, Serialize};

/// Sums of third and fourth powers of every pixel's deviations from its mean (Pebay 2008, Sandia report
/// SAND2008-6212, eqs. 2.1 and 2.2).
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Powers {
    /// Third powers, DN^3.
    pub thirds: Vec<f32>,
    /// Fourth powers, DN^4.
    pub fourths: Vec<f32>,
}

impl Powers {
    /// Empty sums.
    pub fn new(pixels: usize) -> Self {
        Self { thirds: vec![0.0; pixels], fourths: vec![0.0; pixels] }
    }

    /// Adds one frame after `before` frames. `now`: its deviations from their mean times sqrt(before /
    /// (before + 1)); `squares`: sums of squares including this frame.
    pub fn add(&mut self, before: u64, now: &[f32], squares: &[f32]) {
        let (k, n) = (before as f32, before as f32 + 1.0);
        let root = (n / k).sqrt();
        let (of_third, of_fourth) = (k * (k - 1.0) / (n * n), k * (n * n - 3.0 * n + 3.0) / (n * n * n));
        let all = self.thirds.iter_mut().zip(&mut self.fourths).zip(now.iter().zip(squares));
        for ((third, fourth), (now, square)) in all {
            let (off, square) = (now * root, square - now * now);
            let off2 = off * off;
            *fourth += off2 * (off2 * of_fourth + 6.0 * square / (n * n)) - 4.0 * off * *third / n;
            *third += off * (off2 * of_third - 3.0 * square / n);
        }
    }

    /// Merges the sums of later frames. `squares`: sums of squares of both parts; `[a, b]`: their numbers of
    /// frames; `off`: means of the later part minus means of this one.
    pub fn merge(
        &mut self,
        later: &Self,
        squares: [&[f32]; 2],
        [a, b]: [f32; 2],
        off: impl Iterator<Item = f32>,
    ) {
        let n = a + b;
        let own = self.thirds.iter_mut().zip(&mut self.fourths);
        let more = later.thirds.iter().zip(&later.fourths).zip(squares[0].iter().zip(squares[1]));
        for (((third, fourth), ((third_b, fourth_b), (square, square_b))), off) in own.zip(more).zip(off) {
            let off2 = off * off;
            *fourth += fourth_b
                + off2 * off2 * a * b * (a * a - a * b + b * b) / (n * n * n)
                + 6.0 * off2 * (a * a * square_b + b * b * square) / (n * n)
                + 4.0 * off * (a * third_b - b * *third) / n;
            *third += third_b
                + off * off2 * a * b * (a - b) / (n * n)
                + 3.0 * off * (a * square_b - b * square) / n;
        }
    }
}
