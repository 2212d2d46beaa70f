//! Sequential tests: CUSUM of log-likelihood ratios, reset at 0 (Page 1954, Continuous inspection schemes,
//! Biometrika 41).
//!
//! Without a change the sum passes h on average not before e^h readings, for any distribution, provided the
//! likelihood ratio is correct (Lorden 1971, Procedures for reacting to a change in distribution, Annals of
//! Mathematical Statistics 42): the false-alarm rate is at most e^-h. After a change of the design size the
//! sum grows at each reading by the mean log-ratio, the Kullback-Leibler divergence.

use serde::{Deserialize, Serialize};

/// One CUSUM.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Cusum {
    /// Sum, in natural logarithms.
    pub sum: f64,
    /// Readings since the sum was last 0: the most likely age of a change.
    pub age: u64,
}

impl Cusum {
    /// Adds the log-likelihood ratio of a reading: with the change against without.
    pub fn add(&mut self, log_ratio: f64) {
        self.sum += log_ratio;
        self.age += 1;
        if self.sum <= 0.0 || !self.sum.is_finite() {
            *self = Self::default();
        }
    }
}

/// Returns log(p(z | shift) / p(z | 0)) of a reading with unit variance: shift (z - shift / 2).
pub fn of_shift(z: f64, shift: f64) -> f64 {
    shift * (z - 0.5 * shift)
}

/// Returns the log-likelihood ratio of a variance relative to its baseline, with `dof` degrees of freedom,
/// for a change by the factor `ratio`.
pub fn of_variance(relative: f64, dof: f64, ratio: f64) -> f64 {
    0.5 * dof * (relative * (1.0 - 1.0 / ratio) - ratio.ln())
}

/// Returns the log-likelihood ratio of a Poisson count with mean `usual`, for a change by the factor `ratio`.
pub fn of_count(count: f64, usual: f64, ratio: f64) -> f64 {
    count * ratio.ln() - usual * (ratio - 1.0)
}

/// Returns the limit at which `sums` tests together raise at most one false alarm in `readings` readings.
pub fn limit(sums: usize, readings: f64) -> f64 {
    (sums as f64 * readings).ln()
}

/// Returns the mean number of readings to detect a shift, in standard errors: h over the divergence, shift^2
/// / 2, plus one for the overshoot (Wald).
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

    /// Two million readings without a change, limit set for one false alarm in 1000: no more are raised, at
    /// three sizes of shift.
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
            // At most 2000 alarms; more than 50 show that the test is active.
            assert!(alarms < 2000 && alarms > 50, "shift {shift}: {alarms}");
        }
    }

    /// Detection delay of a change by the design size: mean of 400 within 15 % of theory.
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
