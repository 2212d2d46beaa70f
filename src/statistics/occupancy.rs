//! How often each code occurs.

/// Counts of codes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Occupancy(pub Vec<u64>);

impl Occupancy {
    /// For codes up to a full scale, DN.
    pub fn new(full_scale_dn: u16) -> Self {
        Self(vec![0; usize::from(full_scale_dn) + 1])
    }

    /// Adds codes; what lies above full scale counts as full scale.
    pub fn add(&mut self, codes: &[u16]) {
        let last = self.0.len() - 1;
        codes.iter().for_each(|&d| self.0[usize::from(d).min(last)] += 1);
    }

    /// Adds what another saw.
    pub fn merge(&mut self, other: &Self) {
        self.0.iter_mut().zip(&other.0).for_each(|(a, b)| *a += b);
    }

    /// Share of samples at full scale.
    pub fn clipped(&self) -> f64 {
        self.0.last().map_or(0.0, |&n| n as f64) / self.0.iter().sum::<u64>().max(1) as f64
    }
}
