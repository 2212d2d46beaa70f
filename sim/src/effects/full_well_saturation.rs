//! Full-well saturation: a pixel holds no more charge than its well.

use crate::predict::{NORMAL, PLACES};

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// min(q, full well).
pub struct This;

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
    /// By so much the variance of the pixels' variances is not known, where `less` of the variance is left and `rest` is all noise that
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
pub(super) fn clipped(
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

impl Effect for This {
    fn id(&self) -> &'static str {
        "full-well-saturation"
    }

    fn stage(&self) -> Stage {
        Stage::Charge
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "full_well_e", unit: "e", min: 1.0, max: 1e9, starts: &[] }]
    }

    /// Near the brightest level.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        seen.near_peak()
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.8 * plain.range_e])
    }

    fn scaled(&self, values: &[f64], by: f64) -> Vec<f64> {
        vec![values[0] * 2.0 / (1.0 + by)]
    }

    fn page(&self) -> Page {
        Page {
            what: "The well of a pixel is full: more light brings no more charge.",
            equation: "q' = min(q, full well)",
            signature: "the mean stops and the variance falls to the read noise at one level, below the largest code",
            look_alikes: "clipping of the converter stops at the largest code",
            remedy: "use the range below the turn-off",
            measure: "an exposure sweep in small steps up to and past saturation",
            sets: takes::SWEEP,
            source: "EMVA 1288 release 4, section 6 (saturation capacity)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let limited = |set: usize, signal: f64| {
            let (spread, places) = c.sets.get(set).map_or((0.0, &NORMAL), |s| (s.spread, &s.places));
            clipped(signal, spread * signal, places, signal.max(1e-9), p[0])
        };
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            *m = limited(frame.set, *m).mean;
        }
        let read = out.base.read_noise_e * out.base.read_noise_e;
        for (i, s) in out.sets.iter_mut().enumerate() {
            let before = s.signal.max(1e-9);
            let left = limited(i, before);
            let less = (left.variance / before).min(1.0);
            s.cut(less, &left);
            s.shot.scale(less);
            // The pixels' places are a few shares: which of them lie above the knee is known roughly.
            let rest = left.variance + read;
            // Where nearly all are cut, what is left is of a few in the tails.
            let unknown = 0.1 + 0.9 * left.above.powi(4);
            s.unsure_var = libm::hypot(s.unsure_var, unknown * (1.0 - less) * left.variance);
            s.unsure = libm::hypot(s.unsure, left.unsure(less, rest));
            (s.common, s.setting) = (s.common * less * less, s.setting * less * less);
            s.signal = left.mean;
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        d.image.mapv_inplace(|q| q.min(p[0]));
    }
}

#[cfg(test)]
mod tests {
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
            let c = super::cut(0.0, 1.0, limit);
            for (got, expected) in
                [c.mean, c.variance, c.fourth, c.above, c.lost_variance].iter().zip(expected)
            {
                assert!((got - expected).abs() < 1e-9, "at {limit}: {got}, not {expected}");
            }
            let wide = super::cut(5.0, 9.0, 5.0 + 3.0 * limit);
            assert!(
                (wide.fourth - 81.0 * c.fourth).abs() < 1e-9 && (wide.mean - 5.0 - 3.0 * c.mean).abs() < 1e-9
            );
        }
    }
}
