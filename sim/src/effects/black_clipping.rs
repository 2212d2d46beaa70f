//! Black clipping: values below a level are cut off.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};
use crate::clipping::clipped;
use crate::predict::NORMAL;

/// max(v, level), counted from the black level; or code 0, where the black level is too low.
pub struct BlackClipping;

/// Indexes of the parameters.
const LEVEL: usize = 0;
const AT: usize = 1;

fn is_at_code_0(p: &[f64]) -> bool {
    p[AT].round() as i32 == 1
}

impl Effect for BlackClipping {
    fn id(&self) -> &'static str {
        "black-clipping"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["crushed blacks", "clipped blacks"]
    }

    fn stage(&self) -> Stage {
        Stage::Converter
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "level_dn",
                meaning: "at 0: lowest value that is passed, from the black level",
                unit: "DN",
                min: -1e3,
                max: 1e3,
                starts: &[],
            },
            Parameter {
                name: "at",
                meaning: "0: at level_dn, 1: at code 0, to which noise of darks reaches",
                unit: "choice",
                min: 0.0,
                max: 1.0,
                starts: &[0.0, 1.0],
            },
        ]
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        parameter != LEVEL || !is_at_code_0(p)
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        is_at_code_0(p).then_some("at code 0: the black level is too low for the noise of darks")
    }

    /// Returns starts relative to the measured dark noise: clipping at the mean reduces the standard
    /// deviation to 0.58.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        [-1.0, -0.3 * seen.dark_noise_dn, -1.5 * seen.dark_noise_dn, 0.5 * seen.dark_noise_dn]
            .map(|v| vec![v, 0.0])
            .into_iter()
            .chain([vec![0.0, 1.0]])
            .collect()
    }

    /// Darks that extend below the level are not clipped there. Darks with fewer than 1 sample in 200 near
    /// code 0 are not clipped at code 0. Both tests tolerate rounding and the error of the black level.
    fn is_another(&self, p: &[f64], seen: &Seen) -> bool {
        if is_at_code_0(p) {
            return seen.darkest_code.is_some_and(|code| code > 1.0);
        }
        seen.darkest_dn.is_some_and(|dn| dn < p[LEVEL] - 1.0)
    }

    /// A black level below 1 DN is clipped at code 0 anyway, so the example then clips above it.
    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![if plain.black_dn < 1.0 { 1.0 } else { -0.5 }, 0.0])
    }

    fn scaled(&self, values: &[f64], by: f64) -> Vec<f64> {
        vec![-8.0 / (1.0 + 15.0 * by), values[AT]]
    }

    /// All levels between two code edges give the same codes: standard deviation of a uniform distribution
    /// over one step.
    fn resolution(&self, _: usize, _: &[f64], _: &Seen) -> f64 {
        1.0 / libm::sqrt(12.0)
    }

    fn page(&self) -> Page {
        Page {
            what: "The black level is too low, or the camera cuts off what lies below it: that part of the dark noise is lost.",
            equation: "v' = max(v, level), from the black level; at 1: D = max(D, 0)",
            signature: "darks have less variance and a higher mean than the line says; one code occurs far too often",
            look_alikes: "a wrong zero moves all levels alike",
            remedy: "raise the black level until no sample is cut off",
            measure: "short darks at a higher black level",
            sets: takes::DARKS,
            source: "EMVA 1288 release 4, section 6 (offset must be visible in darks)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        if is_at_code_0(p) {
            out.cut_at_0 = true;
            return;
        }
        out.floor_dn = out.floor_dn.max(p[LEVEL]);
        let noise: Vec<f64> = out.sets.iter().map(|s| s.covariance(0, 0)).collect();
        let limited = |set: usize, level: f64| {
            // Clipped from below: mirrored.
            let places = c.sets.get(set).map_or(NORMAL, |s| s.places).map(|x| -x);
            let spread = c.sets.get(set).map_or(0.0, |s| s.spread_dn);
            clipped(-level, spread, &places, noise.get(set).copied().unwrap_or(0.0), -p[LEVEL])
        };
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            *m = -limited(frame.set, *m).mean;
        }
        for (i, s) in out.sets.iter_mut().enumerate() {
            let left = limited(i, s.signal);
            s.signal = -left.mean;
            let less = if noise[i] > 0.0 { left.variance / noise[i] } else { 1.0 };
            s.cut_all(less, &left);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        // Conversion itself cuts at code 0.
        if !is_at_code_0(p) {
            d.image.mapv_inplace(|v| v.max(p[LEVEL]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn darks_far_above_code_0_are_not_cut_off_there() {
        let seen = |code: Option<f64>| Seen { darkest_code: code, ..Seen::default() };
        let is_another = |code| BlackClipping.is_another(&[0.0, 1.0], &seen(code));
        assert!(is_another(Some(57.0)) && !is_another(Some(0.0)) && !is_another(None));
        // At a level: darks that go on below it.
        let seen = |dn: Option<f64>| Seen { darkest_dn: dn, ..Seen::default() };
        let is_another = |dn| BlackClipping.is_another(&[-6.0, 0.0], &seen(dn));
        assert!(is_another(Some(-9.0)) && !is_another(Some(-6.5)) && !is_another(None));
    }
}
