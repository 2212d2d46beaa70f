//! Covariances of the means of lines some way apart: the code common to rows and columns.

/// Returns the lags that fit into half of the lines, each with its index in [`super::LINE_LAGS`].
pub(super) fn lags(lines: usize) -> impl Iterator<Item = (usize, usize)> {
    super::LINE_LAGS.into_iter().enumerate().filter(move |(_, lag)| 2 * lag < lines)
}

/// Returns the lag at an index; the last lag for larger indices.
pub(super) fn lag(index: usize) -> usize {
    super::LINE_LAGS[index.min(super::LINE_LAGS.len() - 1)]
}

/// Returns the name of one covariance. `line`: "row" or "column".
pub(super) fn name(line: &str, index: usize) -> String {
    match lag(index) {
        1 => format!("covariance of the next {line}'s mean"),
        lag => format!("covariance of {line} means {lag} apart"),
    }
}

/// Adds mean products of line means at every lag to the sums.
pub(super) fn add(means: &[f32], sums: &mut [f64]) {
    for ((_, lag), sum) in lags(means.len()).zip(sums) {
        let products = means.iter().zip(&means[lag..]).map(|(a, b)| f64::from(a * b));
        *sum += products.sum::<f64>() / (means.len() - lag) as f64;
    }
}
