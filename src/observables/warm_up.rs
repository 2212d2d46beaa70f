//! Light that rises or falls steadily while a set of flats is taken.

/// Least drift of the light within a set, relative, that is said, the share of the scatter of the frames that it must be,
/// and the fewest frames.
const DRIFT: (f64, f64, usize) = (0.005, 0.7, 8);

/// A light that rises or falls steadily while a set is taken, in words.
pub(super) fn in_words(means_dn: &[f64], zero_dn: f64) -> Option<String> {
    let n = means_dn.len() as f64;
    let (x, y) = ((n - 1.0) / 2.0, means_dn.iter().sum::<f64>() / n);
    let sum = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
        means_dn.iter().enumerate().map(|(k, mean)| f(k as f64 - x, mean - y)).sum()
    };
    let (sxx, sxy, syy) = (sum(&|x, _| x * x), sum(&|x, y| x * y), sum(&|_, y| y * y));
    let (all, share) = (sxy / sxx * (n - 1.0) / (y - zero_dn), sxy * sxy / (sxx * syy));
    (means_dn.len() >= DRIFT.2 && all.abs() > DRIFT.0 && share > DRIFT.1).then(|| {
        format!(
            "the light {} by {} from its first frame to its last, and that is {} of the scatter of its frames: a lamp that warms up, and no \
             flicker",
            if all > 0.0 { "rises" } else { "falls" },
            crate::number::percent(all.abs()),
            crate::number::percent(share)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::in_words;

    #[test]
    fn a_drift_is_told_from_flicker() {
        let of = |off: &dyn Fn(usize) -> f64| (0..20).map(|k| 1064.0 + 1000.0 * off(k)).collect::<Vec<f64>>();
        let rises = in_words(&of(&|k| 0.001 * k as f64), 64.0).unwrap();
        assert!(rises.contains("rises by 2 %"), "{rises}");
        assert!(in_words(&of(&|k| -0.001 * k as f64), 64.0).unwrap().contains("falls"));
        assert_eq!(in_words(&of(&|k| 0.01 * (k % 2) as f64), 64.0), None);
        assert_eq!(in_words(&of(&|k| 0.0001 * k as f64), 64.0), None);
        assert_eq!(in_words(&[1000.0, 1010.0, 1020.0], 64.0), None);
    }
}
