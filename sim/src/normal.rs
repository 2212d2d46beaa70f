//! Density and upper tail of the normal distribution, from a table: a fit asks for them some ten million
//! times. `libm::erfc` serves where small tails or their differences count (drawing Poisson numbers, moments
//! of clipped noise).

use std::sync::OnceLock;

/// Shares of the pixels in nine groups of levels, from the lowest to the highest level; the groups in the
/// tails are small. [`crate::predict::SetInfo::places`] gives the levels of the groups.
pub const PLACES: [f64; 9] = [0.01, 0.04, 0.1, 0.2, 0.3, 0.2, 0.1, 0.04, 0.01];

/// Standard deviation of levels within a group, relative to that of all levels: half the spacing of the
/// middle groups.
pub const AROUND: f64 = 0.35;

/// [`crate::predict::SetInfo::places`] of normal levels.
pub const NORMAL: [f64; PLACES.len()] =
    [-2.718_725, -1.950_477, -1.326_337, -0.699_978, 0.0, 0.699_978, 1.326_337, 1.950_477, 2.718_725];

/// End of the table, in standard deviations: beyond it the tail is 0 or 1, with an error of 1e-17.
const END: f64 = 8.5;
/// Table points per standard deviation. The cubic Taylor polynomial about the nearest point is off by
/// 1.2e-11: (h / 2)^4 / 24 times the fourth derivative, which is at most 1.2.
const EACH: usize = 128;

fn table() -> &'static [(f64, f64)] {
    static TABLE: OnceLock<Vec<(f64, f64)>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let at = |i: usize| {
            let x = i as f64 / EACH as f64 - END;
            let density = libm::exp(-0.5 * x * x) / libm::sqrt(std::f64::consts::TAU);
            (density, 0.5 * libm::erfc(x * std::f64::consts::FRAC_1_SQRT_2))
        };
        (0..=(2.0 * END) as usize * EACH).map(at).collect()
    })
}

/// Returns the density and the upper tail probability of a standard normal number; both to 2e-11.
pub fn tail(x: f64) -> (f64, f64) {
    if x.abs() >= END {
        return (0.0, if x > 0.0 { 0.0 } else { 1.0 });
    }
    let i = ((x + END) * EACH as f64 + 0.5) as usize;
    let Some(&(density, above)) = table().get(i) else { return (f64::NAN, f64::NAN) };
    let at = i as f64 / EACH as f64 - END;
    let (d, square) = (x - at, at * at);
    // Derivatives of the density are Hermite polynomials times the density.
    let (second, third) = (d * d * (square - 1.0) / 2.0, d * d * d * at * (3.0 - square) / 6.0);
    (density * (1.0 - at * d + second + third), above - density * d * (1.0 - 0.5 * at * d + second / 3.0))
}

/// Returns the upper tail probability.
pub fn upper(x: f64) -> f64 {
    tail(x).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_exact_to_2e_11() {
        for i in -100_000..=100_000 {
            let x = f64::from(i) * 9.137e-5;
            let (density, above) = tail(x);
            let exact = libm::exp(-0.5 * x * x) / libm::sqrt(std::f64::consts::TAU);
            assert!((density - exact).abs() < 2e-11, "{x}: {density} {exact}");
            let exact = 0.5 * libm::erfc(x * std::f64::consts::FRAC_1_SQRT_2);
            assert!((above - exact).abs() < 2e-11, "{x}: {above} {exact}");
        }
        assert!(tail(f64::NAN).1.is_nan());
        assert_eq!((upper(f64::INFINITY), upper(f64::NEG_INFINITY)), (0.0, 1.0));
    }
}
