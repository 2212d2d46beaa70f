//! Companding: codes are sent with steps that grow with the level, and expanded again.

use crate::normal::upper;
use crate::predict::quantised_mean;

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// A square-root table, or coarser steps above a knee.
pub struct Companding;

/// Returns the step of the codes at a level, DN.
fn step(p: &[f64], level_dn: f64, full_scale_dn: f64) -> f64 {
    let step = if p[0] >= 0.5 {
        if level_dn > p[2] { p[3] } else { 1.0 }
    } else {
        2.0 * libm::sqrt(level_dn.max(0.0) * full_scale_dn) / p[1]
    };
    step.max(1.0)
}

/// Returns the code after compression and expansion.
fn expanded(p: &[f64], code: f64, full_scale_dn: f64) -> f64 {
    if p[0] >= 0.5 {
        let over = code - p[2];
        return if over > 0.0 { p[2] + libm::round(over / p[3]) * p[3] } else { code };
    }
    let sent = libm::round(p[1] * libm::sqrt(code.max(0.0) / full_scale_dn));
    full_scale_dn * (sent / p[1]) * (sent / p[1])
}

/// Ratio of the code spacing over the whole range to the coarse step, above which the effect is coarse
/// quantisation, not a knee (a named choice).
const EVERYWHERE: f64 = 0.97;

impl Effect for Companding {
    fn id(&self) -> &'static str {
        "companding"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["compression", "piecewise linear", "square-root table"]
    }

    fn stage(&self) -> Stage {
        Stage::Firmware
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "shape",
                meaning: "0: square root, 1: two slopes",
                unit: "choice",
                min: 0.0,
                max: 1.0,
                starts: &[0.0, 1.0],
            },
            Parameter {
                name: "codes",
                meaning: "shape 0: number of codes that are sent",
                unit: "1",
                min: 16.0,
                max: 65_536.0,
                starts: &[],
            },
            Parameter {
                name: "knee_dn",
                meaning: "shape 1: level above which steps are coarse",
                unit: "DN",
                min: 1.0,
                max: 65_535.0,
                starts: &[],
            },
            // Fewer bits are sent: steps of two codes at least.
            Parameter {
                name: "step_dn",
                meaning: "shape 1: size of the coarse steps",
                unit: "DN",
                min: 2.0,
                max: 256.0,
                starts: &[4.0],
            },
        ]
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        parameter == 0 || (parameter >= 2) == (p[0] >= 0.5)
    }

    /// Codes on one regular grid, or coarse steps from the darkest level on, indicate coarse quantisation: a
    /// square-root table or a knee has steps of several sizes.
    fn is_another(&self, p: &[f64], seen: &Seen) -> bool {
        seen.stretch_dn > 1.0 || p[0] >= 0.5 && seen.code_step_dn.is_some_and(|step| step > EVERYWHERE * p[3])
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        Some(if p[0] >= 0.5 { "coarser steps above a knee" } else { "a square-root table" })
    }

    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let full = seen.full_scale_dn;
        // Number of codes sent over full scale: 0.0039 is eight bits for sixteen.
        let mut all: Vec<Vec<f64>> = [1.8, 1.4, 1.0, 0.5, 0.25, 0.125, 0.0625, 0.031, 0.0156, 0.0078, 0.0039]
            .map(|part| vec![0.0, part * full, 0.3 * full, 4.0])
            .to_vec();
        for knee in [0.12, 0.25, 0.5] {
            all.extend([2.0, 4.0, 8.0].map(|step| vec![1.0, full, knee * full, step]));
        }
        all
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        let full = plain.full_scale_dn;
        Some(vec![0.0, libm::round(0.12 * full), libm::round(0.25 * full), 8.0])
    }

    fn scaled(&self, values: &[f64], by: f64) -> Vec<f64> {
        let coarser = libm::round(values[3] * by).max(2.0);
        vec![values[0], libm::round(values[1] / by).max(16.0), values[2], coarser]
    }

    fn page(&self) -> Page {
        Page {
            what: "The camera sends fewer bits than it converts, by a table whose steps grow with the level, and expands them again.",
            equation: "sent = round(codes sqrt(D / full scale)), D' = full scale (sent / codes)^2; or steps of step_dn above knee_dn; noise of \
                       one step q(D)^2 / 12",
            signature: "codes are missing, the more the brighter; the noise of a step grows with the level; the means stay",
            look_alikes: "coarse quantisation leaves the same codes out at all levels",
            remedy: "a pixel format with all bits; allow for the step in the noise",
            measure: "the histogram of flats at several levels: which codes occur",
            sets: takes::SWEEP,
            source: "EMVA 1288 release 4, section 2 (raw data are required); IEEE 1241-2010",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let full = c.full_scale_dn;
        for (i, s) in out.sets.iter_mut().enumerate() {
            let level = s.signal + out.base.offset_dn;
            let spread = c.sets.get(i).map_or(0.0, |s| s.spread_dn);
            let total = libm::hypot(spread, libm::sqrt(s.covariance(0, 0).max(0.0)));
            let places = c.sets.get(i).map_or(crate::predict::NORMAL, |s| s.places);
            let over = |of: &dyn Fn(f64) -> f64| -> f64 {
                let all = places.iter().zip(crate::predict::PLACES);
                all.map(|(x, share)| share * of(step(p, level + total * x, full))).sum()
            };
            // The input is whole codes: rounding to q adds (q^2 - 1) / 12 if the noise covers a step.
            let here = step(p, level, full);
            let wide = s.covariance(0, 0) / (here * here);
            let added = over(&|q| (q * q - 1.0) / 12.0);
            s.read.add_white(added.max(0.0));
            if p[0] < 0.5 && here > 1.001 {
                // The squares of the roots are rounded to whole codes, each by a different fraction of a
                // code. Whole codes also fall between the table's steps in an irregular pattern, so steps of
                // few codes do not average out. Bounds: root mean squares over tables and levels from
                // tests/outside/companding.py.
                let r = libm::sqrt(wide.max(0.0));
                let (square, variance) = (here * here, s.covariance(0, 0));
                let of_variance = 0.3 / here;
                s.unsure_mean = libm::hypot(s.unsure_mean, 0.29 / libm::sqrt(1.0 + 3.5 * total / here));
                s.unsure_own = libm::hypot(s.unsure_own, of_variance * square);
                let apart = of_variance / (1.0 + 8.0 * r * r * r);
                s.unsure = libm::hypot(s.unsure, apart * variance * variance);
                let fourth = 0.6 / (1.0 + 0.6 * r * r * r);
                s.unsure_fourth = libm::hypot(s.unsure_fourth, fourth * variance * variance);
            }
            if p[0] >= 0.5 {
                // A value in the middle of a step is rounded up: whole codes move by half a code on average
                // if the step is even, and not at all if it is odd.
                let above = over(&|q| f64::from(u8::from(q > 1.0)));
                s.unsure_mean = libm::hypot(s.unsure_mean, 0.5 * above);
            }
            s.codes_used *= over(&|q| 1.0 / q);
            s.step_dn = s.step_dn.max(here);
            // Noise narrower than half a step: its remainder depends on the place in the step, from pixel to
            // pixel, and the spread of the levels includes the steps.
            let square = here * here;
            let turn = 2.0 * std::f64::consts::PI.powi(2);
            let spread = (spread * spread / square - 1.0 / 12.0).max(0.0);
            let left = libm::exp(-turn * wide);
            let ripple = here / std::f64::consts::PI * libm::exp(-turn * (wide + spread));
            s.unsure_mean = libm::hypot(s.unsure_mean, ripple);
            s.unsure_own = libm::hypot(s.unsure_own, square * left * (0.2 + 4.0 * wide));
            if here > 1.001 {
                // A pixel d steps from an edge has the variance p (1 - p), p = Phi(d / r), at most 1 / 4; its
                // square is at most 1 / 16. Levels in the middle of a step pass an edge so seldom that
                // moments over the variance have no bound.
                let seldom = 0.5 / upper(0.5 / libm::sqrt(wide.max(0.0) + spread)).max(1e-6);
                s.unsure = libm::hypot(s.unsure, square * square * left / 16.0 * seldom);
                s.unsure_fourth = libm::hypot(s.unsure_fourth, square * square * left / 8.0 * seldom);
                s.uneven = libm::hypot(s.uneven, here * quantised_mean(wide));
            }
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let full = d.full_scale_dn;
        d.image.mapv_inplace(|v| expanded(p, v, full));
    }
}
