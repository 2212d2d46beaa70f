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

/// Largest step of codes that is looked for.
const MOST_STEP: usize = 256;
/// Share of samples that may lie between the steps: those that stand for struck ones are means of others.
const BETWEEN: f64 = 1e-3;
/// Smallest number of steps that tell one (a named choice).
const STEPS: usize = 16;

/// Step of which nearly all codes that occur are multiples, from one of them on; 1 where there is none. `counts`:
/// of each code.
pub fn lattice_of(counts: &[u64]) -> u16 {
    let all: u64 = counts.iter().sum();
    let most = counts.iter().enumerate().max_by_key(|(_, n)| **n).map_or(0, |(code, _)| code);
    let has = |step: &usize| {
        let on = counts.iter().skip(most % step).step_by(*step).filter(|n| **n > 0);
        let (steps, samples) = on.fold((0, 0), |(steps, sum), n| (steps + 1, sum + n));
        steps >= STEPS && samples as f64 >= (1.0 - BETWEEN) * all as f64
    };
    let found = (2..=MOST_STEP).rev().find(has).unwrap_or(1);
    u16::try_from(found).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::lattice_of;

    #[test]
    fn codes_of_one_step_have_it() {
        let of = |codes: &mut dyn Iterator<Item = usize>| {
            let mut counts = vec![0; 4096];
            codes.for_each(|code| counts[code] += 100);
            counts
        };
        assert_eq!(lattice_of(&of(&mut (0..500).map(|i| 8 * i))), 8);
        let mut shifted = of(&mut (0..500).map(|i| 8 * i + 1));
        shifted[1003] = 20;
        assert_eq!(lattice_of(&shifted), 8, "samples that stand for struck ones");
        shifted[1006] = 200;
        assert_eq!(lattice_of(&shifted), 1);
        // Squares of a table of roots, and all codes; too few to tell.
        assert_eq!(lattice_of(&of(&mut (1..400).map(|i| i * i / 40))), 1);
        assert_eq!((lattice_of(&[1; 4096]), lattice_of(&[]), lattice_of(&[0, 5, 0, 5])), (1, 1, 1));
    }
}
