//! Moments of normal noise after a limit.

use crate::normal::PLACES;

/// Moments of clipped normal noise over pixels whose levels differ.
#[derive(Default)]
pub(crate) struct Clipped {
    pub mean: f64,
    /// Mean of the pixels' variances.
    pub variance: f64,
    /// Variance of the pixels' variances.
    pub unequal: f64,
    /// Mean of the pixels' fourth cumulants.
    pub fourth: f64,
    /// Share of the samples that are clipped.
    pub above: f64,
    /// Mean of the excess that is cut off.
    pub lost: f64,
    /// Mean of the pixels' variances of the excess that is cut off.
    pub lost_variance: f64,
}

impl Clipped {
    /// Returns the model uncertainty of the variance of the pixels' variances. `less` is the share of the
    /// variance that is left, `rest` all noise that is left. A few pixels in the tails have most of it.
    pub fn unsure(&self, less: f64, rest: f64) -> f64 {
        3.0 * (1.0 - less) * rest * rest + self.above * self.unequal
    }
}

/// Computes the moments of min(x, limit) for normal x: those of a truncated normal variable (Johnson, Kotz
/// and Balakrishnan 1994, 13.10) and of the mass at the limit.
pub(crate) fn cut(mean: f64, variance: f64, limit: f64) -> Clipped {
    let sd = libm::sqrt(variance.max(1e-12));
    let c = (limit - mean) / sd;
    if c > 8.0 {
        return Clipped { mean, variance, ..Clipped::default() };
    }
    if c < -8.0 {
        // Only the limit is left; the moments below would be differences of large numbers.
        let lost = mean - limit;
        return Clipped { mean: limit, above: 1.0, lost, lost_variance: variance, ..Clipped::default() };
    }
    let below = 0.5 * libm::erfc(-c / std::f64::consts::SQRT_2);
    let above = 0.5 * libm::erfc(c / std::f64::consts::SQRT_2);
    let density = libm::exp(-0.5 * c * c) / libm::sqrt(std::f64::consts::TAU);
    // The excess that is cut off has the mean `lost`; the remainder has the opposite mean.
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

/// Soft limit. Above a knee: v' = limit - w exp(-(v - knee) / w), w = limit - knee, with the slope 1 at the
/// knee. Without one: v' = v / (1 + (v / limit)^power)^(1 / power), which approaches the limit from the
/// start. Both are named choices of shape; wells that fill slowly have others.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SoftLimit {
    /// Value below which nothing changes.
    knee: f64,
    limit: f64,
    /// Power of the limit without a knee.
    power: Option<f64>,
}

/// Relative change that is nothing (a named choice, far below the rule's error).
const UNCHANGED: f64 = 1e-7;

/// Number of intervals of the trapezoidal rule over normal noise. The rule's error decreases faster than any
/// power of the step for smooth curves (Trefethen and Weideman 2014). For the sharpest limit allowed, the
/// error is 1e-4 of the variance.
const NOISE_NODES: i32 = 40;
/// Half width of the rule's range, standard deviations.
const NOISE_REACH: f64 = 5.0;

impl SoftLimit {
    /// Returns the limit above a knee.
    pub fn above(knee: f64, limit: f64) -> Self {
        Self { knee, limit, power: None }
    }

    /// Returns the limit without a knee.
    pub fn gradual(limit: f64, power: f64) -> Self {
        Self { knee: limit * libm::pow(UNCHANGED * power, power.recip()), limit, power: Some(power) }
    }

    /// Returns the value after the limit.
    pub fn of(&self, value: f64) -> f64 {
        if let Some(power) = self.power {
            let filled = libm::pow(value.max(0.0) / self.limit, power);
            return value * libm::exp(-libm::log1p(filled) / power);
        }
        let rest = self.limit - self.knee;
        let over = value - self.knee;
        if over <= 0.0 {
            value
        } else if rest > 0.0 {
            self.limit - rest * libm::exp(-over / rest)
        } else {
            self.limit
        }
    }

    /// Returns the slope at a value, between 0 and 1.
    fn slope(&self, value: f64) -> f64 {
        if let Some(power) = self.power {
            let filled = libm::pow(value.max(0.0) / self.limit, power);
            return libm::exp(-(1.0 + power.recip()) * libm::log1p(filled));
        }
        let rest = self.limit - self.knee;
        let over = value - self.knee;
        if over <= 0.0 { 1.0 } else { libm::exp(-over / rest.max(1e-300)) }
    }

    /// Computes the moments of normal noise after the limit; `above` is the share of a small change that is
    /// lost.
    fn cut(&self, mean: f64, variance: f64) -> Clipped {
        let sd = libm::sqrt(variance.max(1e-12));
        if self.knee - mean > 8.0 * sd {
            return Clipped { mean, variance, ..Clipped::default() };
        }
        let step = 2.0 * NOISE_REACH / f64::from(NOISE_NODES);
        let (mut share, mut left, mut slope) = (0.0, [0.0f64; 4], 0.0);
        let center = self.of(mean);
        for i in 0..=NOISE_NODES {
            let x = f64::from(i) * step - NOISE_REACH;
            let weight = libm::exp(-0.5 * x * x);
            let at = mean + sd * x;
            let off = (self.of(at) - center) / sd;
            share += weight;
            slope += weight * self.slope(at);
            left.iter_mut().enumerate().for_each(|(k, m)| *m += weight * off.powi(k as i32 + 1));
        }
        let [first, second, third, fourth] = left.map(|m| m / share);
        let square = (second - first * first).max(0.0);
        let fourth = fourth - 4.0 * first * third + 6.0 * first * first * second - 3.0 * first.powi(4);
        let out = center + sd * first;
        Clipped {
            mean: out,
            variance: variance * square,
            fourth: variance * variance * (fourth - 3.0 * square * square),
            above: 1.0 - slope / share,
            lost: mean - out,
            ..Clipped::default()
        }
    }
}

/// Computes the moments of min(x, limit) for normal noise in pixels whose means have the standard deviation
/// `spread`, in groups at these places.
pub(crate) fn clipped(
    mean: f64,
    spread: f64,
    places: &[f64; PLACES.len()],
    variance: f64,
    limit: f64,
) -> Clipped {
    over_places(places.map(|x| cut(mean + spread * x, variance, limit)))
}

/// Computes the moments after a soft limit for the same noise and pixels.
pub(crate) fn clipped_softly(
    mean: f64,
    spread: f64,
    places: &[f64; PLACES.len()],
    variance: f64,
    limit: SoftLimit,
) -> Clipped {
    over_places(places.map(|x| limit.cut(mean + spread * x, variance)))
}

fn over_places(all: [Clipped; PLACES.len()]) -> Clipped {
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

    /// Mean, variance, fourth cumulant and lost part of the slope, compared with numerical integration (scipy
    /// 1.11, integrate.quad), for normal noise on, below and across the knee.
    #[test]
    fn a_soft_limit_is_what_integration_gives() {
        let known = [
            ((100.0, 4.0, 99.0, 103.0), [99.605_262_925, 2.352_263_390, 1.856_824_733, 0.250_214_010]),
            ((100.0, 4.0, 102.0, 103.0), [99.918_322_377, 3.423_164_443, -4.110_070_134, 0.084_953_319]),
            ((100.0, 100.0, 90.0, 110.0), [96.489_045_489, 43.082_508_289, 2_078.228_208_9, 0.366_110_010]),
        ];
        for ((mean, variance, knee, limit), [m, v, fourth, lost]) in known {
            let got = SoftLimit::above(knee, limit).cut(mean, variance);
            let sd = f64::sqrt(variance);
            // Error of a kink between two nodes of the rule: 1e-3 of the noise.
            assert!((got.mean - m).abs() < 1e-3 * sd, "{} {m}", got.mean);
            assert!((got.variance - v).abs() < 2e-3 * variance, "{} {v}", got.variance);
            assert!((got.fourth - fourth).abs() < 5e-3 * variance * variance, "{} {fourth}", got.fourth);
            assert!((got.above - lost).abs() < 5e-3, "{} {lost}", got.above);
        }
    }

    /// Slope and value of the limit without a knee: those of its definition; mean and variance of normal
    /// noise as sums over 20 000 steps give them.
    #[test]
    fn a_gradual_limit_is_its_definition() {
        let (limit, power) = (100.0f64, 6.0f64);
        let soft = SoftLimit::gradual(limit, power);
        for v in [-5.0f64, 20.0, 80.0, 100.0, 150.0] {
            let own = v / (1.0 + (v.max(0.0) / limit).powf(power)).powf(power.recip());
            assert!((soft.of(v) - own).abs() < 1e-9, "{v}");
            let slope = (soft.of(v + 1e-4) - soft.of(v - 1e-4)) / 2e-4;
            assert!((soft.slope(v) - slope).abs() < 1e-6, "{v}: {} {slope}", soft.slope(v));
        }
        let (mean, sd) = (95.0, 6.0);
        let got = soft.cut(mean, sd * sd);
        let (mut share, mut first, mut second) = (0.0, 0.0, 0.0);
        for k in -10_000..=10_000 {
            let x = 6.0 * f64::from(k) / 10_000.0;
            let weight = f64::exp(-0.5 * x * x);
            let v = soft.of(mean + sd * x);
            (share, first, second) = (share + weight, first + weight * v, second + weight * v * v);
        }
        let (m, v) = (first / share, second / share - (first / share).powi(2));
        assert!(
            (got.mean - m).abs() < 1e-4 && (got.variance / v - 1.0).abs() < 1e-3,
            "{} {m} {} {v}",
            got.mean,
            got.variance
        );
        assert_eq!(soft.cut(0.2, 0.0001).above, 0.0);
    }

    /// Compared with numerical integration of min(x, limit) by scipy 1.14.
    #[test]
    fn cut_noise_is_what_integration_gives() {
        // Limit; mean, variance, fourth cumulant of the remainder; share above; variance of the excess.
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
