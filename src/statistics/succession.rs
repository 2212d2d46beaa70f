//! Serial correlation of numbers: products of successive deviations from their mean.

/// Computes the sum of squared deviations from the mean, and the sum of products of successive deviations.
pub fn sums(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let n = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / n;
    let (mut square, mut product) = (0.0, 0.0);
    let mut before = None;
    for d in values.map(|v| v - mean) {
        square += d * d;
        product += before.map_or(0.0, |b: f64| b * d);
        before = Some(d);
    }
    (square, product)
}

/// Returns mean and standard deviation of the products over the squares, for n independent normal numbers of
/// equal variance (R. L. Anderson 1942, Ann. Math. Stat. 13, 1; the mean is exact, the deviation to a few per
/// cent from four numbers on).
pub fn of_independent(n: f64) -> (f64, f64) {
    (-1.0 / n, (n - 2.0) / n / (n - 1.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// 4000 lists: the mean agrees within five of its errors, the deviation within ten per cent from eight
    /// numbers on, and fifteen for four.
    #[test]
    fn independent_numbers_have_the_moments_that_are_said() {
        for (n, slack) in [(4u32, 0.15), (8, 0.1), (16, 0.1), (40, 0.1)] {
            let quotient = |seed: u64| {
                let value = |i: u32| PixelRng::new(seed, Stream::Effect, 0, i, 0).normal();
                let (square, product) = sums((0..n).map(value));
                product / square
            };
            let lists = 4000.0;
            let (mut sum, mut squares) = (0.0, 0.0);
            for seed in 0..4000 {
                let q = quotient(seed);
                sum += q;
                squares += q * q;
            }
            let mean = sum / lists;
            let deviation = (squares / lists - mean * mean).sqrt();
            let (expected, std_err) = of_independent(f64::from(n));
            assert!((mean - expected).abs() < 5.0 * deviation / f64::sqrt(lists), "{n}: {mean} {expected}");
            assert!((deviation / std_err - 1.0).abs() < slack, "{n}: {deviation} {std_err}");
        }
    }
}
