//! Sequential tests: sums of log-likelihood ratios that are set back to 0 (Page 1954, Continuous inspection schemes, Biometrika 41).
//!
//! Such a sum passes h by chance on average not before e^h readings, whatever is read, where the ratio is right (Lorden 1971, Procedures for
//! reacting to a change in distribution, Annals of Mathematical Statistics 42): the rate of false alarms is at most e^-h. After a change by the
//! size that it is made for it grows by the ratio's mean, the Kullback-Leibler divergence, at each reading.

use serde::{Deserialize, Serialize};

/// One sum.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Cusum {
    /// The sum, in units of natural logarithms.
    pub sum: f64,
    /// Readings since it was last 0: the most likely age of a change.
    pub age: u64,
}

impl Cusum {
    /// Adds the logarithm of the ratio of a reading's likelihoods with and without the change.
    pub fn add(&mut self, log_ratio: f64) {
        self.sum += log_ratio;
        self.age += 1;
        if self.sum <= 0.0 || !self.sum.is_finite() {
            *self = Self::default();
        }
    }
}

/// log(p(z | shift) / p(z | 0)) of a reading with unit variance: shift (z - shift / 2).
pub fn of_shift(z: f64, shift: f64) -> f64 {
    shift * (z - 0.5 * shift)
}

/// The same of a variance with so many degrees of freedom, in units of the usual one, that may be `ratio` times as large.
pub fn of_variance(relative: f64, dof: f64, ratio: f64) -> f64 {
    0.5 * dof * (relative * (1.0 - 1.0 / ratio) - ratio.ln())
}

/// The same of a count of which `usual` are expected, and `ratio` times as many after a change (Poisson).
pub fn of_count(count: f64, usual: f64, ratio: f64) -> f64 {
    count * ratio.ln() - usual * (ratio - 1.0)
}

/// The limit at which `sums` of them together raise at most one false alarm in so many readings.
pub fn limit(sums: usize, readings: f64) -> f64 {
    (sums as f64 * readings).ln()
}

/// Readings until a shift, in standard errors, is found: h over the divergence, shift^2 / 2, and one for the overshoot (Wald).
pub fn readings_needed(limit: f64, shift: f64) -> f64 {
    limit / (0.5 * shift * shift) + 1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    fn normal(n: u32) -> f64 {
        PixelRng::new(77, Stream::Frame, u64::from(n >> 16), n, 0).normal()
    }

    /// Two million readings without a change, with a limit at which one in a thousand may raise an alarm: no more do, at three sizes of shift.
    #[test]
    fn false_alarms_are_as_rare_as_stated() {
        let limit = limit(1, 1000.0);
        for shift in [0.5, 1.0, 3.0] {
            let mut cusum = Cusum::default();
            let alarms = (0..2_000_000)
                .filter(|&n| {
                    cusum.add(of_shift(normal(n), shift));
                    let alarm = cusum.sum > limit;
                    if alarm {
                        cusum = Cusum::default();
                    }
                    alarm
                })
                .count();
            // At most 2000, and the bound is not idle.
            assert!(alarms < 2000 && alarms > 50, "shift {shift}: {alarms}");
        }
    }

    /// A change by the size that the sum is made for is found after the number of readings that theory gives, on average of 400, within 15 %.
    #[test]
    fn changes_are_found_when_theory_says() {
        let limit = limit(14, 1e4);
        let mut n = 0;
        for shift in [0.3, 0.8, 1.5] {
            let delays = (0..400).map(|_| {
                let mut cusum = Cusum::default();
                let mut delay = 0.0;
                while cusum.sum <= limit {
                    n += 1;
                    cusum.add(of_shift(normal(n) + shift, shift));
                    delay += 1.0;
                }
                delay
            });
            let mean = delays.sum::<f64>() / 400.0;
            let theory = readings_needed(limit, shift);
            assert!((mean / theory - 1.0).abs() < 0.15, "shift {shift}: {mean} for {theory}");
        }
    }
}
