//! Means of whole frames: their mean, their scatter, and how far the first one lies off.

use serde::{Deserialize, Serialize};

/// Sums over the means of frames (Welford 1962; merged after Chan, Golub and LeVeque 1979).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct FrameMeans {
    frames: u64,
    first_dn: f64,
    last_dn: f64,
    mean_dn: f64,
    squares: f64,
    /// Sum of the squares of the steps from frame to frame.
    steps: f64,
}

impl FrameMeans {
    /// Adds the mean of the next frame, DN.
    pub fn add(&mut self, mean_dn: f64) {
        self.merge(&Self { frames: 1, first_dn: mean_dn, last_dn: mean_dn, mean_dn, ..Self::default() });
    }

    /// Adds the frames that follow.
    pub fn merge(&mut self, later: &Self) {
        if self.frames == 0 {
            *self = later.clone();
            return;
        }
        let (a, b) = (self.frames as f64, later.frames as f64);
        let apart = later.mean_dn - self.mean_dn;
        self.squares += later.squares + apart * apart * a * b / (a + b);
        self.steps += later.steps + (later.first_dn - self.last_dn).powi(2);
        self.last_dn = later.last_dn;
        self.mean_dn += apart * b / (a + b);
        self.frames += later.frames;
    }

    /// Frames.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Mean of all, DN.
    pub fn mean_dn(&self) -> f64 {
        self.mean_dn
    }

    /// Variance with n - 1 in the denominator, DN^2.
    pub fn variance_dn2(&self) -> f64 {
        self.squares / (self.frames as f64 - 1.0)
    }

    /// Sum of the products of successive deviations from the mean over that of their squares: steps d' - d have the sum of squares
    /// 2 sum d^2 - (first^2 + last^2) - 2 sum d d'.
    pub fn succession(&self) -> f64 {
        let end = |dn: f64| (dn - self.mean_dn).powi(2);
        let products = self.squares - 0.5 * (end(self.first_dn) + end(self.last_dn) + self.steps);
        products / self.squares
    }

    /// The first frame less the mean of the others, DN.
    pub fn first_step_dn(&self) -> f64 {
        let n = self.frames as f64;
        (self.first_dn - self.mean_dn) * n / (n - 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::succession::sums;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Merged in parts, the running sums give what the plain definition does.
    #[test]
    fn succession_is_that_of_the_definition() {
        for n in [4u32, 5, 9, 30] {
            let means: Vec<f64> =
                (0..n).map(|i| 2000.0 + PixelRng::new(3, Stream::Effect, n.into(), i, 0).normal()).collect();
            let (square, product) = sums(means.iter().copied());
            for split in 0..means.len() {
                let mut parts = [FrameMeans::default(), FrameMeans::default()];
                means.iter().enumerate().for_each(|(i, m)| parts[usize::from(i >= split)].add(*m));
                let [mut all, later] = parts;
                all.merge(&later);
                assert!(
                    (all.succession() - product / square).abs() < 1e-9,
                    "{n} frames, {split} in the first part"
                );
            }
        }
    }
}
