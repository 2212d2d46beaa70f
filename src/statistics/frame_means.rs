//! Means of whole frames, with their mean, variance, serial correlation and first step.

use super::succession::sums;
use serde::{Deserialize, Serialize};

/// Means of frames in the order in which they were taken, DN.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct FrameMeans(Vec<f64>);

impl FrameMeans {
    /// Adds the mean of the next frame, DN.
    pub fn add(&mut self, mean_dn: f64) {
        self.0.push(mean_dn);
    }

    /// Merges the frames that follow.
    pub fn merge(&mut self, later: &Self) {
        self.0.extend_from_slice(&later.0);
    }

    /// Discards all frames but keeps the memory.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Number of frames.
    pub fn frames(&self) -> u64 {
        self.0.len() as u64
    }

    /// Mean of each frame, DN.
    pub fn each_dn(&self) -> &[f64] {
        &self.0
    }

    /// Mean of all frames, DN; 0 without frames.
    pub fn mean_dn(&self) -> f64 {
        self.0.iter().sum::<f64>() / self.0.len().max(1) as f64
    }

    /// Variance with n - 1 in the denominator, DN^2.
    pub fn variance_dn2(&self) -> f64 {
        self.sums().0 / (self.0.len() as f64 - 1.0)
    }

    /// Serial correlation: sum of the products of successive deviations from the mean, over that of their
    /// squares.
    pub fn succession(&self) -> f64 {
        let (square, product) = self.sums();
        product / square
    }

    fn sums(&self) -> (f64, f64) {
        sums(self.0.iter().copied())
    }

    /// First frame minus the mean of the others, DN.
    pub fn first_step_dn(&self) -> f64 {
        let n = self.0.len() as f64;
        let first = self.0.first().copied().unwrap_or(f64::NAN);
        (first - self.mean_dn()) * n / (n - 1.0)
    }
}
