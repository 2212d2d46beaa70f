//! Spatial filter: the camera sharpens or smooths its images.

use super::{Campaign, Drawing, Effect, Needs, Page, Parameter, Plain, Prediction, Seen, Stage, takes};
use crate::predict::Filter;
use crate::quantize::Correction;

/// Filter that enlarges (s above 0) or reduces the difference from a mean of the neighbours.
pub struct SpatialFilter;

/// Returns the share of the four diagonal neighbours in that mean: none, as the other four, half as much.
fn diagonal(p: &[f64]) -> f64 {
    match p[1].round() as i32 {
        0 => 0.0,
        1 => 1.0 / 2.0,
        _ => 1.0 / 3.0,
    }
}

/// Returns true if the input of the filter is finer than whole codes.
fn fine(p: &[f64]) -> bool {
    p[2] >= 0.5
}

/// Returns the weights of the kernel: its middle, four neighbours and four diagonal ones.
fn weights(strength: f64, diagonal: f64) -> impl Iterator<Item = f64> {
    let of = move |share: f64| std::iter::repeat_n(-0.25 * strength * share, 4);
    std::iter::once(1.0 + strength).chain(of(1.0 - diagonal)).chain(of(diagonal))
}

impl Effect for SpatialFilter {
    fn id(&self) -> &'static str {
        "spatial-filter"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["sharpening", "sharpness", "denoise", "noise reduction", "smoothing", "edge enhancement"]
    }

    fn stage(&self) -> Stage {
        Stage::Firmware
    }

    fn stage_with(&self, p: &[f64]) -> Stage {
        if fine(p) { Stage::Converter } else { Stage::Firmware }
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "strength",
                meaning: "s: positive sharpens, negative smooths",
                unit: "1",
                min: -0.95,
                max: 3.0,
                starts: &[0.05],
            },
            // 4 neighbours, 8 alike, 8 with the diagonal ones at half.
            Parameter {
                name: "kernel",
                meaning: "0: the nearest four neighbours, 1: all eight alike, 2: the diagonal ones at half weight",
                unit: "choice",
                min: 0.0,
                max: 2.0,
                starts: &[0.0],
            },
            // Input: whole codes, or samples with more bits than the output.
            Parameter {
                name: "of",
                meaning: "0: of whole codes, 1: before codes are rounded",
                unit: "choice",
                min: 0.0,
                max: 1.0,
                starts: &[0.0],
            },
        ]
    }

    /// Returns starts for each kernel, on whole codes and on finer samples.
    fn starts(&self, _: &Seen) -> Vec<Vec<f64>> {
        let weak = (0..6).map(|k| vec![0.05, f64::from(k % 3), f64::from(k / 3)]);
        // The mean over 3 x 3 pixels with weights 1, 2, 1 has the strength -0.75.
        weak.chain([0.0, 1.0].map(|of| vec![-0.6, 2.0, of])).collect()
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        Some(if fine(p) { "before codes are rounded" } else { "of whole codes" })
    }

    fn needs(&self) -> Needs {
        Needs::Covariances
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.04, 0.0, 0.0])
    }

    fn page(&self) -> Page {
        Page {
            what: "Firmware sharpens (edge enhancement) or smooths (noise reduction) after conversion: whole codes, or more bits than it hands out.",
            equation: "y = v + s (v - mean of the neighbours): kernel 0 the nearest 4, 1 all 8 alike, 2 the diagonal ones at half weight; power \
                       times (1 + s (1 - (1 - d) (cos k_y + cos k_x) / 2 - d cos k_y cos k_x))^2, d = 0, 1/2, 1/3",
            signature: "neighbours correlated in darks as in flats, along both axes: negative with sharpening, positive with \
                        smoothing; variance up or down in both",
            look_alikes: "crosstalk leaves the read noise of darks uncorrelated",
            remedy: "switch it off (Sharpness, NoiseReduction); calibrate only then",
            measure: "darks with their covariances along both axes",
            sets: takes::DARKS,
            source: "EMVA 1288 release 4, section 2 (raw data are required); GenICam SFNC, Sharpness",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let (strength, d) = (p[0], diagonal(p));
        let power = |strength: f64| {
            move |ky: f64, kx: f64| {
                let (cy, cx) = (libm::cos(ky), libm::cos(kx));
                let h = 1.0 + strength * (1.0 - (1.0 - d) * 0.5 * (cy + cx) - d * cy * cx);
                h * h
            }
        };
        if fine(p) {
            out.sets
                .iter_mut()
                .for_each(|s| s.filter(&Filter::new(&power(strength)).of_weights(weights(strength, d))));
            return;
        }
        // The offset pattern, which alone remains in the darkest sets, is not smooth like shading.
        let known = c.sets.iter().map(|s| s.spread_dn).filter(|s| *s > 0.0);
        let pattern = known.fold(f64::INFINITY, f64::min).min(1e3);
        for (i, s) in out.sets.iter_mut().enumerate() {
            // The pattern of a long dark includes its dark current.
            let dark = c.sets.get(i).filter(|s| s.light.is_none() && s.spread_dn > 0.0);
            let pattern = dark.map_or(pattern, |s| s.spread_dn);
            // Each code is corrected by floor(s (v - mean of neighbours) + 1/2): with four neighbours, the
            // argument is a quarter of s times a whole number.
            let x = s.pixels();
            let (whole, square) = if d == 0.0 { (0.25, 20.0) } else { (0.125, 72.0) };
            let correction =
                Correction::new(whole * strength, libm::sqrt(square * x), libm::sqrt(square) * pattern);
            let (slope, noise) = correction.linear();
            // The part that crosses thresholds because of fixed pattern alone is uncertain by half: five
            // quadrature nodes do not resolve the tails.
            let (bare_slope, bare_noise) =
                Correction::new(whole * strength, libm::sqrt(square * x), 0.0).linear();
            let by_pattern = (noise - bare_noise).abs() + 2.0 * x * (slope - bare_slope).abs() / whole;
            s.unsure_var = libm::hypot(s.unsure_var, 0.5 * by_pattern);
            let moved = (slope.abs() / (whole * strength).abs().max(1e-9)).min(1.0) * correction.narrow();
            let strength = (slope / whole).copysign(strength);
            s.filter(&Filter::new(&power(strength)).of_weights(weights(strength, d)));
            s.read.add_white(noise);
            s.moved = s.moved.max(correction.moves());
            // Fixed pattern is represented by five nodes, so its contribution has a 100 % uncertainty.
            let unequal = correction.unequal(2.0 * x / whole);
            s.unequal += unequal;
            s.unsure = libm::hypot(s.unsure, unequal);
            // The tails of narrow noise are no longer normal where samples are moved.
            s.unsure_fourth = libm::hypot(s.unsure_fourth, 0.3 * moved * s.pixels().powi(2));
            // A few pixels whose level lies at a threshold are moved more than others.
            s.unsure = libm::hypot(s.unsure, 0.05 * moved * s.pixels().powi(2));
        }
        out.whole = true;
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let (strength, share) = (p[0], diagonal(p));
        let near = (d.shifted(1, 0) + d.shifted(-1, 0) + d.shifted(0, 1) + d.shifted(0, -1)) * 0.25;
        let around = if share > 0.0 {
            let corner = d.shifted(1, 1) + d.shifted(-1, 1) + d.shifted(1, -1) + d.shifted(-1, -1);
            near * (1.0 - share) + corner * (0.25 * share)
        } else {
            near
        };
        d.image = &d.image * (1.0 + strength) - around * strength;
    }
}
