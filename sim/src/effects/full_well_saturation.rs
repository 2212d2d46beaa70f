//! Full-well saturation: a pixel holds no more charge than its well.

use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};

/// min(q, full well).
pub struct This;

/// Points and weights of Gauss and Hermite for a normal spread.
const SPREAD: [(f64, f64); 5] = [
    (-2.856_970_013_872_8, 0.011_257_411_327_720_7),
    (-1.355_626_179_974_3, 0.222_075_922_005_613),
    (0.0, 0.533_333_333_333_333),
    (1.355_626_179_974_3, 0.222_075_922_005_613),
    (2.856_970_013_872_8, 0.011_257_411_327_720_7),
];

/// Mean and variance of min(x, limit) for normal x.
pub(super) fn clipped(mean: f64, variance: f64, limit: f64) -> (f64, f64) {
    let sd = libm::sqrt(variance.max(1e-12));
    let z = (limit - mean) / sd;
    let below = 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
    let density = libm::exp(-0.5 * z * z) / libm::sqrt(std::f64::consts::TAU);
    let m = mean * below - sd * density + limit * (1.0 - below);
    let square = (mean * mean + variance) * below - sd * (mean + limit) * density + limit * limit * (1.0 - below);
    (m, (square - m * m).max(0.0))
}

impl Effect for This {
    fn id(&self) -> &'static str {
        "full-well-saturation"
    }

    fn stage(&self) -> Stage {
        Stage::Charge
    }

    fn parameters(&self) -> &'static [Parameter] {
        // Not a number: begin near the brightest level.
        &[Parameter { name: "full_well_e", unit: "e", min: 1.0, max: 1e9, starts: &[f64::NAN, f64::NAN, f64::NAN] }]
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
        let limited = |signal: f64, spread: f64, variance: f64| {
            SPREAD.iter().fold((0.0, 0.0), |(m, v), (x, weight)| {
                let (mean, var) = clipped(signal * (1.0 + spread * x), variance, p[0]);
                (m + weight * mean, v + weight * var)
            })
        };
        let spread = |set: usize| c.sets.get(set).map_or(0.0, |s| s.spread);
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            *m = limited(*m, spread(frame.set), m.max(0.0)).0;
        }
        for (i, s) in out.sets.iter_mut().enumerate() {
            let before = s.signal.max(1e-9);
            let (mean, variance) = limited(before, spread(i), before);
            let less = (variance / before).min(1.0);
            s.unsure += 3.0 * (1.0 - less);
            s.shot.scale(less);
            s.common *= less * less;
            s.signal = mean;
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        d.image.mapv_inplace(|q| q.min(p[0]));
    }
}
