//! The median.

/// Median of some values; NaN of none.
pub fn median(values: impl Iterator<Item = f64>) -> f64 {
    median_of(&values.collect::<Vec<_>>(), &mut Vec::new())
}

/// Median of a list; `sorted` is memory that is used again. NaN of an empty one.
pub fn median_of(values: &[f64], sorted: &mut Vec<f64>) -> f64 {
    sorted.clear();
    sorted.extend_from_slice(values);
    sorted.sort_unstable_by(f64::total_cmp);
    let half = sorted.len() / 2;
    match sorted.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => sorted[half],
        _ => 0.5 * (sorted[half - 1] + sorted[half]),
    }
}
