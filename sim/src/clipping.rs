//! What a limit leaves of normal noise.

use crate::normal::PLACES;

/// What clipping leaves of normal noise in pixels whose levels differ.
#[derive(Default)]
pub(crate) struct Clipped {
    pub mean: f64,
    /// Mean of the pixels' variances.
    pub variance: f64,
    /// Variance of the pixels' variances.
    pub unequal: f64,
    /// Mean of the pixels' fourth cumulants.
    pub fourth: f64,
    /// Share of the samples that were cut.
    pub above: f64,
    /// Mean of what was cut off.
    pub lost: f64,
    /// Mean of the pixels' variances of what was cut off.
    pub lost_variance: f64,
}

impl Clipped {
    /// Model uncertainty of the variance of the pixels' variances, where `less` of the variance is left and `rest` is all noise that
    /// is: a few pixels in the tails have most of it.
    pub fn unsure(&self, less: f64, rest: f64) -> f64 {
        3.0 * (1.0 - less) * rest * rest + self.above * self.unequal
    }
}

/// min(x, limit) of normal x: moments of a truncated normal variable (Johnson, Kotz and Balakrishnan 1994, 13.10) and of the mass
/// at the limit.
pub(crate) fn cut(mean: f64, variance: f64, limit: f64) -> Clipped {
    let sd = libm::sqrt(variance.max(1e-12));
    let c = (limit - mean) / sd;
    if c > 8.0 {
        return Clipped { mean, variance, ..Clipped::default() };
    }
    if c < -8.0 {
        // Of all of it only the limit is left; the moments below would be differences of large numbers.
        let lost = mean - limit;
        return Clipped { mean: limit, above: 1.0, lost, lost_variance: variance, ..Clipped::default() };
    }
    let below = 0.5 * libm::erfc(-c / std::f64::consts::SQRT_2);
    let above = 0.5 * libm::erfc(c / std::f64::consts::SQRT_2);
    let density = libm::exp(-0.5 * c * c) / libm::sqrt(std::f64::consts::TAU);
    // What is cut off has the mean `lost`; what is left, the opposite of it.
    let lost = density - c * above;
    let [first, second, third, fourth] = [
        -lost,
        below - c * density + c * c * above,
        -(c * c + 2.0) * density + c.powi(3) * above,
        3.0 * below - (c.powi(3) + 3.0 * c) * density + c.powi(4) * above,
    ];
    let left = (second - first * first).max(0.0);
    let fourth = fourth - 4.0 * first * third + 6.0 * first * first * second - 3.0 * first.powi(4);
    Clipped {
        mean: mean + sd * first,
        variance: variance * left,
        fourth: variance * variance * (fourth - 3.0 * left * left),
        above,
        lost: sd * lost,
        lost_variance: variance * ((1.0 + c * c) * above - c * density - lost * lost).max(0.0),
        ..Clipped::default()
    }
}

/// min(x, limit) for normal noise in pixels whose means have the deviation `spread` and lie at these places.
pub(crate) fn clipped(
    mean: f64,
    spread: f64,
    places: &[f64; PLACES.len()],
    variance: f64,
    limit: f64,
) -> Clipped {
    let all = places.map(|x| cut(mean + spread * x, variance, limit));
    let average =
        |of: &dyn Fn(&Clipped) -> f64| all.iter().zip(PLACES).map(|(c, share)| share * of(c)).sum::<f64>();
    let variance = average(&|c| c.variance);
    Clipped {
        mean: average(&|c| c.mean),
        variance,
        unequal: average(&|c| (c.variance - variance) * (c.variance - variance)),
        fourth: average(&|c| c.fourth),
        above: average(&|c| c.above),
        lost: average(&|c| c.lost),
        lost_variance: average(&|c| c.lost_variance),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    /// Against numerical integration of min(x, limit) by scipy 1.14.
    #[test]
    fn cut_noise_is_what_integration_gives() {
        // Limit; mean, variance, fourth cumulant of what is left; share above; variance of what is lost.
        let known = [
            (
                -1.0,
                [
                    -1.0833154705876864,
                    0.06839831570452314,
                    0.09326260041433707,
                    0.8413447460685429,
                    0.751087807841609,
                ],
            ),
            (
                0.5,
                [
                    -0.19779655740130608,
                    0.553440704453552,
                    0.14096012029610439,
                    0.3085375387259869,
                    0.17051578190552574,
                ],
            ),
            (
                2.0,
                [
                    -0.008490702616829715,
                    0.9601963707872341,
                    -0.23045851906680026,
                    0.022750131948179195,
                    0.005696634683592495,
                ],
            ),
        ];
        for (limit, expected) in known {
            let c = cut(0.0, 1.0, limit);
            for (got, expected) in
                [c.mean, c.variance, c.fourth, c.above, c.lost_variance].iter().zip(expected)
            {
                assert!((got - expected).abs() < 1e-9, "at {limit}: {got}, not {expected}");
            }
            let wide = cut(5.0, 9.0, 5.0 + 3.0 * limit);
            assert!(
                (wide.fourth - 81.0 * c.fourth).abs() < 1e-9 && (wide.mean - 5.0 - 3.0 * c.mean).abs() < 1e-9
            );
        }
    }
}
