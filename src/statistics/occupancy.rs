//! How often each code occurs.

use serde::{Deserialize, Serialize};

/// Counts of codes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Occupancy(pub Vec<u64>);

impl Occupancy {
    /// For codes up to a full scale, DN.
    pub fn new(full_scale_dn: u16) -> Self {
        Self(vec![0; usize::from(full_scale_dn) + 1])
    }

    /// Adds codes; what lies above full scale counts as full scale.
    pub fn add(&mut self, codes: &[u16]) {
        let n = self.0.len();
        // Neighbours are often alike, and a count waits for the one before it: four tables.
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

    /// Adds what another saw.
    pub fn merge(&mut self, other: &Self) {
        self.0.iter_mut().zip(&other.0).for_each(|(a, b)| *a += b);
    }

    /// Share of samples at full scale.
    pub fn clipped(&self) -> f64 {
        self.0.last().map_or(0.0, |&n| n as f64) / self.0.iter().sum::<u64>().max(1) as f64
    }
}

/// Greatest common divisor of the distances between codes in order; 1 for fewer than two.
pub fn lattice_of(mut codes: impl Iterator<Item = usize>) -> u16 {
    let (mut divisor, Some(mut last)) = (0, codes.next()) else { return 1 };
    for code in codes {
        let (mut a, mut b) = (divisor, code - last);
        while b > 0 {
            (a, b) = (b, a % b);
        }
        (divisor, last) = (a, code);
        if divisor == 1 {
            break;
        }
    }
    u16::try_from(divisor.max(1)).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::lattice_of;

    #[test]
    fn codes_of_one_step_have_it() {
        assert_eq!(lattice_of([24, 32, 56, 64, 4080].into_iter()), 8);
        assert_eq!(lattice_of([25, 33, 57, 4081].into_iter()), 8);
        // Squares of a table of roots.
        assert_eq!(lattice_of((1..400).map(|i| i * i / 40)), 1);
        assert_eq!((lattice_of([].into_iter()), lattice_of([5].into_iter())), (1, 1));
    }
}
