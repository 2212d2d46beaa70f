//! Whether the same pixels are noisier in one run of frames as in another: the covariance of their variances.
//!
//! A pixel that jumps between two levels does so in every run. A rare large deviation hits any pixel, and the next time another.

use super::jackknife::{Blocks, Value};
use super::layout::Layout;

/// Pixels' variances about their mean, summed over runs of frames.
#[derive(Debug, Clone)]
pub struct Steady {
    sum: Vec<f32>,
    squares: Vec<f32>,
    runs: usize,
}

impl Steady {
    /// For frames of so many pixels.
    pub fn new(pixels: usize) -> Self {
        Self { sum: vec![0.0; pixels], squares: vec![0.0; pixels], runs: 0 }
    }

    /// Adds a run of frames: the variance of every pixel (0 where it does not count), and their mean, DN^2.
    pub fn add(&mut self, var_dn2: &[f32], mean_dn2: f64) {
        for ((sum, square), v) in self.sum.iter_mut().zip(&mut self.squares).zip(var_dn2) {
            let off = v - mean_dn2 as f32;
            *sum += off;
            *square += off * off;
        }
        self.runs += 1;
    }

    /// Covariance of the pixels' variances in two runs, DN^4, as the mean over all pairs of runs and all pixels; `None` of fewer than two
    /// runs. Of pixels that are alike it is 0 but for its error.
    pub fn covariance(&self, layout: &Layout) -> Option<Value> {
        let runs = self.runs as f64;
        let mut blocks = Blocks::default();
        // What all pairs sum up to is the square of the sum less the squares.
        let pairs = |i: usize| {
            let (sum, square) = (f64::from(self.sum[i]), f64::from(self.squares[i]));
            f64::from(layout.mask[i]) * (sum * sum - square) / (runs * (runs - 1.0))
        };
        layout.runs(|run, count, block| blocks.add(block, run.map(pairs).sum(), count));
        (self.runs > 1).then(|| blocks.value())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Over 300 campaigns of three runs: of pixels that are alike 0, and the error covers it; of a tenth of the pixels with one more of
    /// variance 0.1 * 0.9, within five standard errors of the mean.
    #[test]
    fn only_what_stays_with_its_pixels_counts() {
        let (side, campaigns) = (32usize, 300u32);
        let layout = Layout::new(&Array2::from_elem((side, side), true), 4095);
        let of = |more: f64, campaign: u32| {
            let mut steady = Steady::new(side * side);
            let mut rng = PixelRng::new(9, Stream::Effect, 0, campaign, 0);
            for _ in 0..3 {
                // The variance of five numbers: chi-squared of four degrees of freedom over four.
                let var = |i: usize| {
                    let chi2: f64 = (0..4).map(|_| rng.normal().powi(2)).sum();
                    (chi2 / 4.0 * if i.is_multiple_of(10) { 1.0 + more } else { 1.0 }) as f32
                };
                let var: Vec<f32> = (0..side * side).map(var).collect();
                let mean = var.iter().map(|v| f64::from(*v)).sum::<f64>() / var.len() as f64;
                steady.add(&var, mean);
            }
            steady.covariance(&layout).unwrap()
        };
        for (more, expected) in [(0.0, 0.0), (1.0, 0.09)] {
            let all: Vec<Value> = (0..campaigns).map(|c| of(more, c)).collect();
            let n = f64::from(campaigns);
            let mean = all.iter().map(|v| v.value).sum::<f64>() / n;
            let scatter = (all.iter().map(|v| (v.value - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
            assert!((mean - expected).abs() < 5.0 * scatter / n.sqrt(), "{mean}, not {expected}");
            // Jackknife errors are known to some per cent each: their mean to less than a tenth.
            let stated = (all.iter().map(|v| v.std_err * v.std_err).sum::<f64>() / n).sqrt();
            assert!((stated / scatter - 1.0).abs() < 0.25, "{stated}, scatter {scatter}");
        }
    }
}
