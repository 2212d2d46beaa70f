//! Values with standard errors from a jackknife over blocks of the sensor (Efron and Stein 1981).

use serde::{Deserialize, Serialize};

/// Blocks along each side.
pub const BLOCKS: usize = 8;

/// A value with its standard error.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Value {
    /// The value.
    pub value: f64,
    /// Standard error of the value.
    pub std_err: f64,
}

/// Sums by block of the sensor, and their divisors.
#[derive(Debug, Clone, PartialEq)]
pub struct Blocks(Vec<(f64, f64)>);

impl Default for Blocks {
    fn default() -> Self {
        Self(vec![(0.0, 0.0); BLOCKS * BLOCKS])
    }
}

impl Blocks {
    /// Block along one side that place `i` of `n` belongs to.
    pub fn of(i: usize, n: usize) -> usize {
        i * BLOCKS / n
    }

    /// End of a block along one side.
    pub fn end(block: usize, n: usize) -> usize {
        ((block + 1) * n).div_ceil(BLOCKS)
    }

    /// Adds to the block at (down, right).
    pub fn add(&mut self, (down, right): (usize, usize), sum: f64, count: f64) {
        let block = &mut self.0[down * BLOCKS + right];
        block.0 += sum;
        block.1 += count;
    }

    /// Ratio of the totals with its jackknife error.
    pub fn value(&self) -> Value {
        self.part(|_| true)
    }

    /// Ratio of the totals over the selected blocks at (down, right), with its jackknife error.
    pub fn part(&self, wanted: impl Fn((usize, usize)) -> bool) -> Value {
        let places = self.0.iter().enumerate().filter(|(i, _)| wanted((i / BLOCKS, i % BLOCKS)));
        jackknife(places.map(|(_, b)| [*b; 2]), |v, _| v)
    }

    /// Function of the ratios of two sums over the same blocks; the error includes their correlation.
    pub fn with(&self, other: &Self, of: impl Fn(f64, f64) -> f64) -> Value {
        jackknife(self.0.iter().zip(&other.0).map(|(a, b)| [*a, *b]), of)
    }

    /// Value of the selected blocks minus that of the other blocks.
    pub fn difference(&self, far: impl Fn((usize, usize)) -> bool) -> Value {
        let (a, b) = (self.part(&far), self.part(|at| !far(at)));
        Value { value: a.value - b.value, std_err: a.std_err.hypot(b.std_err) }
    }
}

fn jackknife(blocks: impl Iterator<Item = [(f64, f64); 2]>, of: impl Fn(f64, f64) -> f64) -> Value {
    let blocks: Vec<_> = blocks.collect();
    let mut all = [(0.0, 0.0); 2];
    for b in &blocks {
        all.iter_mut().zip(b).for_each(|(a, b)| *a = (a.0 + b.0, a.1 + b.1));
    }
    let value = |taken: [(f64, f64); 2]| {
        let ratio = |k: usize| (all[k].0 - taken[k].0) / (all[k].1 - taken[k].1);
        of(ratio(0), ratio(1))
    };
    let left: Vec<f64> =
        blocks.iter().filter(|b| b[0].1 > 0.0 && b[0].1 < all[0].1).map(|b| value(*b)).collect();
    let g = left.len() as f64;
    let mean = left.iter().sum::<f64>() / g;
    let var = (g - 1.0) / g * left.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    Value { value: value([(0.0, 0.0); 2]), std_err: var.sqrt() }
}
