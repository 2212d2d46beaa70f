//! Test for a step in the mean of an ordered list of numbers.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Step that best splits a list.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Mean from the step on minus the mean before.
    pub difference: f64,
    /// Standard error from the scatter within both parts.
    pub std_err: f64,
    /// Chance probability of a step as large, at any place, in independent normal numbers: that of Student's
    /// t, times the number of places (Bonferroni; slightly too large, since adjacent places are correlated).
    pub p_value: f64,
}

/// Finds the largest step over all places; `None` for fewer than four numbers or if all are equal.
pub fn largest(values: &[f64]) -> Option<Step> {
    let n = values.len() as f64;
    let student = (values.len() >= 4).then(|| StudentsT::new(0.0, 1.0, n - 2.0).ok()).flatten()?;
    let (sum, squares) = values.iter().fold((0.0, 0.0), |(a, b), v| (a + v, b + v * v));
    let spread = squares - sum * sum / n;
    let mut before = 0.0;
    let mut best: Option<(f64, f64, f64)> = None;
    for (k, v) in values.iter().enumerate().take(values.len() - 1) {
        before += v;
        let (first, rest) = (k as f64 + 1.0, n - k as f64 - 1.0);
        let difference = (sum - before) / rest - before / first;
        // Sum of squares explained by the step, and residual within both parts.
        let taken = difference * difference * first * rest / n;
        let std_err = ((spread - taken).max(1e-12 * spread) / (n - 2.0) * (1.0 / first + 1.0 / rest)).sqrt();
        if std_err > 0.0 && best.is_none_or(|b| taken > b.2) {
            best = Some((difference, std_err, taken));
        }
    }
    let (difference, std_err, _) = best?;
    let p_value = (2.0 * student.sf((difference / std_err).abs()) * (n - 1.0)).min(1.0);
    Some(Step { difference, std_err, p_value })
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    fn normal(seed: u64, n: u32) -> Vec<f64> {
        (0..n).map(|i| PixelRng::new(seed, Stream::Effect, 0, i, 0).normal()).collect()
    }

    /// In 4000 random lists, the p-value is below the limit no more often than stated (tolerance: four
    /// standard errors), and at least a third as often.
    #[test]
    fn chances_are_those_of_independent_numbers() {
        for n in [8, 24] {
            for limit in [0.05, 0.01] {
                let of = |seed: u64| largest(&normal(seed, n)).is_some_and(|s| s.p_value < limit);
                let (found, expected) = ((0..4000).filter(|s| of(*s)).count() as f64, 4000.0 * limit);
                assert!(found < expected + 4.0 * expected.sqrt(), "{n}: {found} below {limit}");
                assert!(found > expected / 3.0 - 4.0 * expected.sqrt(), "{n}: {found} below {limit}");
            }
        }
    }

    /// A step of four standard deviations is found, with its size within five standard errors; equal numbers
    /// have no step.
    #[test]
    fn a_step_is_found() {
        for seed in 0..50 {
            let mut values = normal(seed, 24);
            values[16..].iter_mut().for_each(|v| *v += 4.0);
            let step = largest(&values).unwrap();
            assert!(step.p_value < 1e-3 && (step.difference - 4.0).abs() < 5.0 * step.std_err, "{step:?}");
        }
        assert_eq!(largest(&[1.0; 9]), None);
        assert_eq!(largest(&[1.0, 2.0, 3.0]), None);
    }
}
