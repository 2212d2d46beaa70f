//! Covariances of the means of lines some way apart: what those of rows and those of columns share.

/// Lines apart, each with its place among [`super::LINE_LAGS`]: those that fit into half of the lines.
pub(super) fn lags(lines: usize) -> impl Iterator<Item = (usize, usize)> {
    super::LINE_LAGS.into_iter().enumerate().filter(move |(_, lag)| 2 * lag < lines)
}

/// Lag at a place, the last where there are fewer.
pub(super) fn lag(index: usize) -> usize {
    super::LINE_LAGS[index.min(super::LINE_LAGS.len() - 1)]
}

/// Name of one covariance. `line`: "row" or "column".
pub(super) fn name(line: &str, index: usize) -> String {
    match lag(index) {
        1 => format!("covariance of the next {line}'s mean"),
        lag => format!("covariance of {line} means {lag} apart"),
    }
}

/// Mean products of line means at every lag, added to the sums.
pub(super) fn add(means: &[f32], sums: &mut [f64]) {
    for ((_, lag), sum) in lags(means.len()).zip(sums) {
        let products = means.iter().zip(&means[lag..]).map(|(a, b)| f64::from(a * b));
        *sum += products.sum::<f64>() / (means.len() - lag) as f64;
    }
}
