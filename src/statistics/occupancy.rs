//! Histogram of codes.

use serde::{Deserialize, Serialize};

/// Counts of codes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Occupancy(pub Vec<u64>);

impl Occupancy {
    /// Creates an empty histogram for codes up to a full scale, DN.
    pub fn new(full_scale_dn: u16) -> Self {
        Self(vec![0; usize::from(full_scale_dn) + 1])
    }

    /// Adds codes; codes above full scale count as full scale.
    pub fn add(&mut self, codes: &[u16]) {
        let n = self.0.len();
        // Neighbouring codes are often equal, and an increment waits for the one before: four tables avoid
        // this.
        let mut tables = vec![0u32; 4 * n];
        let last = (n - 1) as u16;
        let (a, rest) = tables.split_at_mut(n);
        let (b, rest) = rest.split_at_mut(n);
        let (c, d) = rest.split_at_mut(n);
        let four = codes.chunks_exact(4);
        four.remainder().iter().for_each(|&code| a[usize::from(code.min(last))] += 1);
        for code in four {
            a[usize::from(code[0].min(last))] += 1;
            b[usize::from(code[1].min(last))] += 1;
            c[usize::from(code[2].min(last))] += 1;
            d[usize::from(code[3].min(last))] += 1;
        }
        let counts = a.iter().zip(b).zip(c.iter().zip(d));
        self.0
            .iter_mut()
            .zip(counts)
            .for_each(|(sum, ((a, b), (c, d)))| *sum += u64::from(*a + *b + *c + *d));
    }

    /// Removes a code that was added.
    pub fn take_off(&mut self, code: u16) {
        let last = self.0.len() - 1;
        self.0[usize::from(code).min(last)] -= 1;
    }

    /// Merges the counts of another.
    pub fn merge(&mut self, other: &Self) {
        self.0.iter_mut().zip(&other.0).for_each(|(a, b)| *a += b);
    }

    /// Share of samples at full scale.
    pub fn clipped(&self) -> f64 {
        self.0.last().map_or(0.0, |&n| n as f64) / self.0.iter().sum::<u64>().max(1) as f64
    }
}
