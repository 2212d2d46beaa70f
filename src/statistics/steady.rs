//! Whether the same pixels are noisier in one run of frames as in another: the covariance of their variances.
//!
//! A pixel that jumps between two levels does so in every run. A rare large deviation hits any pixel, and the next time another. Pixels that jump
//! lie anywhere; where those that are noisier lie side by side, or in every second line, they are parts of the sensor.

use super::jackknife::{Blocks, Value};
use super::layout::Layout;

/// Pixels' variances about their mean, summed over runs of frames.
#[derive(Debug, Clone)]
pub struct Steady {
    /// Over the first, third, ... run, and over the others.
    sums: [Vec<f32>; 2],
    squares: Vec<f32>,
    runs: usize,
}

impl Steady {
    /// For frames of so many pixels.
    pub fn new(pixels: usize) -> Self {
        Self { sums: [vec![0.0; pixels], vec![0.0; pixels]], squares: vec![0.0; pixels], runs: 0 }
    }

    /// Adds a run of frames: the variance of every pixel (0 where it does not count), and their mean, DN^2.
    pub fn add(&mut self, var_dn2: &[f32], mean_dn2: f64) {
        let sum = &mut self.sums[self.runs % 2];
        for ((sum, square), v) in sum.iter_mut().zip(&mut self.squares).zip(var_dn2) {
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
            let sum = f64::from(self.sums[0][i]) + f64::from(self.sums[1][i]);
            let square = f64::from(self.squares[i]);
            f64::from(layout.mask[i]) * (sum * sum - square) / (runs * (runs - 1.0))
        };
        layout.runs(|run, count, block| blocks.add(block, run.map(pairs).sum(), count));
        (self.runs > 1).then(|| blocks.value())
    }

    /// Covariance of a pixel's variance in one run with that in another of the pixel two columns on, and two rows on, DN^4; `None` of fewer than
    /// two runs. Two, so that every second line shows. Of noisy pixels that lie anywhere it is 0 but for its error.
    pub fn of_neighbours(&self, layout: &Layout) -> Option<[Value; 2]> {
        if self.runs < 2 {
            return None;
        }
        let columns = layout.columns();
        let pairs = (self.runs.div_ceil(2) * (self.runs / 2)) as f64;
        let [a, b] = &self.sums;
        let of = |apart: usize, last_column: usize| {
            let mut blocks = Blocks::default();
            layout.runs(|run, _, block| {
                let (mut sum, mut count) = (0.0, 0.0);
                for i in run.filter(|i| i % columns < last_column && i + apart < layout.mask.len()) {
                    let j = i + apart;
                    let both = f64::from(layout.mask[i] * layout.mask[j]);
                    let products = f64::from(a[i]) * f64::from(b[j]) + f64::from(a[j]) * f64::from(b[i]);
                    sum += both * 0.5 * products / pairs;
                    count += both;
                }
                if count > 0.0 {
                    blocks.add(block, sum, count);
                }
            });
            blocks.value()
        };
        Some([of(2, columns.saturating_sub(2)), of(2 * columns, columns)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Over 200 campaigns of four runs: noisy pixels that lie anywhere are alone, within five standard errors of the mean, which the errors cover;
    /// every second column, and the right half, are not.
    #[test]
    fn parts_of_the_sensor_are_no_single_pixels() {
        let (side, campaigns) = (32usize, 200u32);
        let layout = Layout::new(&Array2::from_elem((side, side), true), 4095);
        let of = |noisy: fn(usize, usize) -> bool, campaign: u32| {
            let mut steady = Steady::new(side * side);
            let mut rng = PixelRng::new(19, Stream::Effect, 0, campaign, 0);
            for _ in 0..4 {
                let var = |i: usize| {
                    let chi2: f64 = (0..4).map(|_| rng.normal().powi(2)).sum();
                    (chi2 / 4.0 * if noisy(i / 32, i % 32) { 2.0 } else { 1.0 }) as f32
                };
                let var: Vec<f32> = (0..side * side).map(var).collect();
                let mean = var.iter().map(|v| f64::from(*v)).sum::<f64>() / var.len() as f64;
                steady.add(&var, mean);
            }
            steady.of_neighbours(&layout).unwrap()
        };
        type Noisy = fn(usize, usize) -> bool;
        let anywhere: Noisy =
            |y, x| PixelRng::new(4, Stream::Effect, 1, (32 * y + x) as u32, 0).uniform() < 0.25;
        let cases: [(Noisy, [f64; 2]); 3] = [
            (anywhere, [0.0, 0.0]),
            (|_, x| x % 2 == 1, [0.25, 0.25]),
            // Of pairs of columns those across the middle are unlike: 2 of 30.
            (|_, x| x >= 16, [0.25 * (1.0 - 2.0 * 2.0 / 30.0), 0.25]),
        ];
        for (noisy, expected) in cases {
            let all: Vec<[Value; 2]> = (0..campaigns).map(|c| of(noisy, c)).collect();
            for (k, expected) in expected.into_iter().enumerate() {
                let n = f64::from(campaigns);
                let mean = all.iter().map(|v| v[k].value).sum::<f64>() / n;
                let scatter =
                    (all.iter().map(|v| (v[k].value - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
                let by_chance = 0.02 * f64::from(u8::from(expected == 0.0));
                assert!(
                    (mean - expected).abs() < 5.0 * scatter / n.sqrt() + by_chance,
                    "{k}: {mean}, not {expected}"
                );
                let stated = (all.iter().map(|v| v[k].std_err.powi(2)).sum::<f64>() / n).sqrt();
                assert!(stated > 0.75 * scatter, "{k}: {stated}, scatter {scatter}");
            }
        }
    }

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
