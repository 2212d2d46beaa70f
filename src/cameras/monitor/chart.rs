//! Change-point test on the time series of a reading.
//!
//! Neither the baseline of a reading nor its scatter is known beforehand: both are estimated from the history
//! that is searched for a change. For every candidate change point, the mean m1 of the n1 readings since then
//! is compared with the mean m0 of the n0 readings before. With v = 1/n0 + 1/n1 and a known scatter sigma,
//! (m1 - m0) / sigma is normal with variance v. The log-likelihood ratio of a change by d sigma against no
//! change is
//!
//! ```text
//! d (m1 - m0) / (sigma v) - d^2 / (2 v)
//! ```
//!
//! This is the likelihood ratio of the maximal invariant under shifts, which does not depend on the unknown
//! baseline (Lehmann and Romano 2005, Testing Statistical Hypotheses, section 6.3). Without a change the
//! ratio has mean 1 at every check, for any n0. The largest of the ratios that begin at each check therefore
//! passes e^h on average not before e^h checks (Lorden 1971, Procedures for reacting to a change in
//! distribution, Annals of Mathematical Statistics 42; the sum over beginnings minus their number is a
//! martingale). The scatter is estimated as well: the t statistic with n0 + n1 - 2 degrees of freedom is
//! transformed to the normal scale (Wallace 1959, Bounds on normal approximations to Student's and the
//! chi-square distributions, Annals of Mathematical Statistics 30).

use super::check::Reading;
use super::cusum;

/// Minimum number of readings before a change.
pub(super) const BEFORE: usize = 8;
/// Returns the design shift, at most sqrt(2 h) standard errors: a relevant change may be many standard
/// errors, and a shift of sqrt(2 h) is certain after a single reading. The observed change must still be half
/// of the relevant one.
fn designed(shift: f64, limit: f64) -> f64 {
    shift.min((2.0 * limit).sqrt())
}

/// Past readings, with mean and scatter of any stretch of them.
#[derive(Debug, Clone, Default)]
pub struct Chart {
    /// Check of each reading.
    checks: Vec<usize>,
    first: f64,
    /// Cumulative sums of the value minus the first, its square, and the square of the stated error.
    sums: Vec<[f64; 3]>,
}

/// Readings before and since.
#[derive(Debug, Clone, Copy)]
pub struct Split {
    /// Mean of the readings before.
    pub before: f64,
    /// Mean of the readings since.
    pub since: f64,
    /// Scatter of a reading, standard deviation.
    pub std_err: f64,
    /// Number of readings before and since.
    pub counts: (usize, usize),
}

impl Split {
    /// Returns 1 / n0 + 1 / n1.
    fn variance(&self) -> f64 {
        1.0 / self.counts.0 as f64 + 1.0 / self.counts.1 as f64
    }

    /// Returns the difference with its error.
    pub fn difference(&self) -> Reading {
        Reading { value: self.since - self.before, std_err: self.std_err * self.variance().sqrt() }
    }

    /// Returns the difference over the value before.
    pub fn relative(&self) -> Reading {
        let Reading { value, std_err } = self.difference();
        Reading { value: value / self.before, std_err: std_err / self.before.abs() }
    }

    /// Returns the log-likelihood ratio of a change by `step` against none; `None` for an irrelevant change.
    fn score(&self, step: f64, limit: f64) -> Option<f64> {
        let difference = self.difference();
        if !(step > 0.0 && difference.value.abs() >= 0.5 * step) {
            return None;
        }
        let dof = (self.counts.0 + self.counts.1 - 2) as f64;
        let z = normal_of(difference.value.abs() / difference.std_err, dof);
        let shift = designed(step / self.std_err, limit) / self.variance().sqrt();
        Some(cusum::of_shift(z, shift))
    }
}

/// Converts a t statistic to the normal deviate of equal tail probability (Wallace 1959).
fn normal_of(t: f64, dof: f64) -> f64 {
    (dof * (t * t / dof).ln_1p()).sqrt() * (8.0 * dof + 1.0) / (8.0 * dof + 3.0)
}

impl Chart {
    /// Returns the number of readings so far.
    pub fn len(&self) -> usize {
        self.checks.len()
    }

    /// Returns the check of each reading.
    pub fn checks(&self) -> &[usize] {
        &self.checks
    }

    /// Returns true if there are no readings.
    pub fn is_empty(&self) -> bool {
        self.checks.is_empty()
    }

    /// Adds the reading of a check.
    pub fn add(&mut self, check: usize, reading: Reading) {
        if self.is_empty() {
            self.first = reading.value;
            self.sums.push([0.0; 3]);
        }
        let d = reading.value - self.first;
        let last = self.sums[self.len()];
        self.checks.push(check);
        self.sums.push([last[0] + d, last[1] + d * d, last[2] + reading.std_err.powi(2)]);
    }

    /// Returns the mean of all readings.
    pub fn mean(&self) -> Option<f64> {
        let n = self.len();
        (n > 0).then(|| self.first + self.sums[n][0] / n as f64)
    }

    /// Returns the check of the n-th last reading.
    pub fn check(&self, n: usize) -> usize {
        self.checks.get(self.len().saturating_sub(n.max(1))).copied().unwrap_or(0)
    }

    /// Splits into readings before one check and since another, without those between; `None` if either part
    /// is empty.
    pub fn apart(&self, before: usize, since: usize) -> Option<Split> {
        let place = |check: usize| self.checks.partition_point(|c| *c < check);
        self.split(place(before), place(since))
    }

    /// Splits into the first `n0` readings and those from the index `from` on.
    fn split(&self, n0: usize, from: usize) -> Option<Split> {
        let n = self.len();
        if n0 == 0 || from < n0 || from >= n {
            return None;
        }
        let (a, m, b) = (self.sums[n0], self.sums[from], self.sums[n]);
        let n1 = n - from;
        let (n0f, n1f) = (n0 as f64, n1 as f64);
        let (s0, s1) = (a[0], b[0] - m[0]);
        let squares = a[1] + b[1] - m[1];
        let within = (squares - s0 * s0 / n0f - s1 * s1 / n1f) / (n0f + n1f - 2.0).max(1.0);
        // Scatter beyond the stated errors comes from the camera and the room.
        let stated = (a[2] + b[2] - m[2]) / (n0f + n1f);
        let std_err = within.max(stated).sqrt().max(f64::MIN_POSITIVE);
        let (before, since) = (self.first + s0 / n0f, self.first + s1 / n1f);
        Some(Split { before, since, std_err, counts: (n0, n1) })
    }

    /// Returns the most likely change point if its score passes `limit`; `step` gives the relevant change for
    /// a baseline.
    ///
    /// Candidate numbers of readings since the change start at 1 and grow in steps of a sixteenth.
    pub fn changed(&self, step: impl Fn(f64) -> f64, limit: f64) -> Option<usize> {
        let mut best: Option<(f64, usize)> = None;
        let mut since = 1;
        while since + BEFORE <= self.len() {
            let from = self.len() - since;
            let score = self.split(from, from).and_then(|s| s.score(step(s.before), limit));
            if let Some(score) = score
                && score > limit
                && best.is_none_or(|(most, _)| score > most)
            {
                best = Some((score, self.check(since)));
            }
            since += 1 + since / 16;
        }
        best.map(|(_, check)| check)
    }

    /// Returns the mean number of readings to detect the relevant change: with a known baseline, and with its
    /// present estimate. Infinite: not yet detectable.
    pub fn needed(&self, step: impl Fn(f64) -> f64, limit: f64) -> (f64, f64) {
        let n = self.len();
        let last = n.saturating_sub(1);
        let Some(split) = self.split(last, last).filter(|_| n >= BEFORE) else {
            return (f64::INFINITY, f64::INFINITY);
        };
        let shift = designed(step(split.before) / split.std_err, limit);
        // d^2 / (2 v) = h.
        let known = 0.5 * shift * shift / limit;
        let now = known - 1.0 / n as f64;
        (1.0 / known + 1.0, if now > 0.0 { 1.0 / now + 1.0 } else { f64::INFINITY })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Compared with the distributions of statrs, from 7 degrees of freedom on, up to the scale of h: within
    /// 2 %.
    #[test]
    fn a_t_is_as_rare_as_its_normal_number() {
        use statrs::distribution::{ContinuousCDF, Normal, StudentsT};
        let normal = Normal::standard();
        for dof in [7.0, 15.0, 40.0, 200.0] {
            let of_t = StudentsT::new(0.0, 1.0, dof).unwrap();
            for t in [1.0, 2.0, 4.0, 8.0] {
                let exact = -normal.inverse_cdf(of_t.cdf(-t));
                if exact < 6.0 {
                    assert!((normal_of(t, dof) / exact - 1.0).abs() < 0.02, "{t}, {dof}: {exact}");
                }
            }
        }
    }

    fn normal(series: u32, n: u64) -> f64 {
        PixelRng::new(78, Stream::Frame, n, series, 0).normal()
    }

    fn reading(value: f64) -> Reading {
        Reading { value, std_err: 1e-9 }
    }

    /// 400 unchanged cameras, 1000 checks each, mean and scatter unknown, limit set for one alarm in 500
    /// checks: no more are raised, for relevant changes of a fifth to eight standard errors.
    #[test]
    fn false_alarms_are_as_rare_as_stated() {
        let limit = cusum::limit(1, 500.0);
        for step in [0.2, 0.5, 1.0, 2.0, 8.0] {
            let mut alarms = 0;
            for series in 0..400 {
                let mut chart = Chart::default();
                for n in 0..1000 {
                    chart.add(n, reading(7.0 + normal(series, n as u64)));
                    if chart.changed(|_| step, limit).is_some() {
                        alarms += 1;
                        chart = Chart::default();
                    }
                }
            }
            println!("step {step}: {alarms}");
            // 400 000 / 500 = 800.
            assert!(alarms <= 800, "step {step}: {alarms}");
        }
    }

    /// A relevant change is detected after the number of readings given by theory; the change point is right
    /// to within that number.
    #[test]
    fn changes_are_found_when_theory_says() {
        let limit = cusum::limit(14, 1e4);
        for (step, before) in [(0.5, 1000), (1.0, 200), (1.0, 120), (3.0, 60), (20.0, 30)] {
            let (mut sum, mut theory) = (0.0, 0.0);
            for series in 0..200 {
                let mut chart = Chart::default();
                for n in 0..before {
                    chart.add(n, reading(normal(1000 + series, n as u64)));
                }
                theory += chart.needed(|_| step, limit).1 / 200.0;
                let mut n = before;
                loop {
                    chart.add(n, reading(step + normal(1000 + series, n as u64)));
                    n += 1;
                    let Some(since) = chart.changed(|_| step, limit) else { continue };
                    assert!(since + 2 * n > 3 * before - 40, "since {since} of {before}, found at {n}");
                    break;
                }
                sum += (n - before) as f64;
            }
            let mean = sum / 200.0;
            println!("step {step} after {before}: {mean} for {theory}");
            assert!(mean < 1.25 * theory + 0.5, "step {step} after {before}: {mean} for {theory}");
        }
    }
}
