//! The median.

/// Median absolute deviation of a normal distribution over its standard deviation.
pub const MAD_OF_NORMAL: f64 = 0.6745;

/// Standard error of the median of normal numbers over that of their mean (Kenney and Keeping 1962, section
/// 8.6).
pub const ERROR_OVER_MEAN: f64 = 1.25;

/// Computes the median; NaN without values.
pub fn median(values: impl Iterator<Item = f64>) -> f64 {
    median_of(&values.collect::<Vec<_>>(), &mut Vec::new())
}

/// Computes the median of a list by selection, reusing `memory`. NaN for an empty list.
pub fn median_of(values: &[f64], memory: &mut Vec<f64>) -> f64 {
    memory.clear();
    memory.extend_from_slice(values);
    let n = memory.len();
    if n == 0 {
        return f64::NAN;
    }
    let (below, upper, _) = memory.select_nth_unstable_by(n / 2, f64::total_cmp);
    if n % 2 == 1 {
        return *upper;
    }
    let lower = below.iter().copied().max_by(f64::total_cmp).unwrap_or(*upper);
    0.5 * (lower + *upper)
}

#[cfg(test)]
mod tests {
    use super::median;

    #[test]
    fn the_middle_of_any_order() {
        for (values, middle) in [
            (&[3.0][..], 3.0),
            (&[4.0, 1.0], 2.5),
            (&[9.0, -1.0, 2.0], 2.0),
            (&[1.0, 8.0, 2.0, 7.0], 4.5),
            (&[2.0, 2.0, 2.0, 1.0, 3.0, 2.0], 2.0),
        ] {
            assert_eq!(median(values.iter().copied()), middle);
        }
        assert!(median([].into_iter()).is_nan());
    }
}
