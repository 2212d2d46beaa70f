//! Full-well saturation: a pixel holds no more charge than its well.

use crate::predict::{NORMAL, PLACES};

use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};

/// min(q, full well).
pub struct This;

/// What clipping leaves of normal noise in pixels whose levels differ.
pub(super) struct Clipped {
    pub mean: f64,
    /// Mean of the pixels' variances.
    pub variance: f64,
    /// Variance of the pixels' variances.
    pub unequal: f64,
    /// Mean of the pixels' fourth cumulants.
    pub fourth: f64,
    /// Share of the samples that were cut.
    pub above: f64,
    /// Mean of the pixels' variances of what was cut off.
    pub lost_variance: f64,
}

/// Mean, variance and fourth cumulant of min(x, limit) for normal x: moments of a truncated normal variable (Johnson, Kotz and
/// Balakrishnan 1994, 13.10) and of the mass at the limit.
fn cut(mean: f64, variance: f64, limit: f64) -> (f64, f64, f64) {
    let sd = libm::sqrt(variance.max(1e-12));
    let c = (limit - mean) / sd;
    if c > 8.0 {
        return (mean, variance, 0.0);
    }
    let below = 0.5 * libm::erfc(-c / std::f64::consts::SQRT_2);
    let density = libm::exp(-0.5 * c * c) / libm::sqrt(std::f64::consts::TAU);
    let above = 1.0 - below;
    let moments = [
        1.0,
        -density + c * above,
        below - c * density + c * c * above,
        -(c * c + 2.0) * density + c.powi(3) * above,
        3.0 * below - (c.powi(3) + 3.0 * c) * density + c.powi(4) * above,
    ];
    let m = moments[1];
    let second = (moments[2] - m * m).max(0.0);
    let fourth = moments[4] - 4.0 * m * moments[3] + 6.0 * m * m * moments[2] - 3.0 * m.powi(4);
    (mean + sd * m, variance * second, variance * variance * (fourth - 3.0 * second * second))
}

/// How often normal x lies above the limit, and the variance of what is above it.
fn lost(mean: f64, variance: f64, limit: f64) -> (f64, f64) {
    let sd = libm::sqrt(variance.max(1e-12));
    let c = (limit - mean) / sd;
    let above = 0.5 * libm::erfc(c / std::f64::consts::SQRT_2);
    let density = libm::exp(-0.5 * c * c) / libm::sqrt(std::f64::consts::TAU);
    let first = density - c * above;
    (above, variance * ((1.0 + c * c) * above - c * density - first * first).max(0.0))
}

/// min(x, limit) for normal noise in pixels whose means have the deviation `spread` and lie at these places.
pub(super) fn clipped(mean: f64, spread: f64, places: &[f64; PLACES.len()], variance: f64, limit: f64) -> Clipped {
    let mut all = [(0.0, (0.0, 0.0, 0.0)); PLACES.len()];
    for ((out, x), share) in all.iter_mut().zip(places).zip(PLACES) {
        *out = (share, cut(mean + spread * x, variance, limit));
    }
    let average = |of: &dyn Fn(&(f64, f64, f64)) -> f64| all.iter().map(|(w, c)| w * of(c)).sum::<f64>();
    let (mut above, mut lost_variance) = (0.0, 0.0);
    for (x, share) in places.iter().zip(PLACES) {
        let (over, lost) = lost(mean + spread * x, variance, limit);
        (above, lost_variance) = (above + share * over, lost_variance + share * lost);
    }
    let variance = average(&|c| c.1);
    Clipped {
        above,
        lost_variance,
        mean: average(&|c| c.0),
        variance,
        unequal: average(&|c| (c.1 - variance) * (c.1 - variance)),
        fourth: average(&|c| c.2),
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
            s.cut(less, left.unequal, left.fourth);
            s.shot.scale(less);
            // The pixels' places are a few shares: which of them lie above the knee is known roughly.
            let rest = left.variance + read;
            s.unsure_var = libm::hypot(s.unsure_var, 0.1 * (1.0 - less) * less * before);
            s.unsure = libm::hypot(s.unsure, 3.0 * (1.0 - less) * rest * rest);
            s.common *= less * less;
            s.signal = left.mean;
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        d.image.mapv_inplace(|q| q.min(p[0]));
    }
}
