//! Nonlinearity: the signal bends away from a straight line in the light.

use crate::predict::quantised_mean;

use super::{Campaign, Drawing, Effect, Needs, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// A curve after the amplifier, one of several shapes.
pub struct Nonlinearity;

/// Number of knots of the free curve, at equal steps up to full scale; it begins at 0.
const KNOTS: usize = 6;
/// Indexes of the parameters.
const REL: usize = 1;
const EXPONENT: usize = 4;
const KNEE: usize = 5;
const ASYMPTOTE: usize = 7;
const FIRST_KNOT: usize = 8;
const TOE: usize = FIRST_KNOT + KNOTS;
const PLACES: usize = TOE + 2;

const fn size(name: &'static str, meaning: &'static str, start: f64) -> Parameter {
    let max = 0.45;
    let starts: &[f64] = if start == 0.01 { &[0.01] } else { &[0.003] };
    Parameter { name, meaning, unit: "1", min: -max, max, starts }
}

/// Computes the natural cubic spline through (0, 0) and values at equal steps: second derivatives at the
/// knots, in steps (de Boor 2001, A Practical Guide to Splines, ch. IV).
fn second_derivatives(values: &[f64; KNOTS + 1]) -> [f64; KNOTS + 1] {
    let (mut below, mut right) = ([0.0; KNOTS + 1], [0.0; KNOTS + 1]);
    for i in 1..KNOTS {
        let pivot = 4.0 - below[i - 1];
        below[i] = 1.0 / pivot;
        right[i] = (6.0 * (values[i + 1] - 2.0 * values[i] + values[i - 1]) - right[i - 1]) / pivot;
    }
    let mut out = [0.0; KNOTS + 1];
    for i in (1..KNOTS).rev() {
        out[i] = right[i] - below[i] * out[i + 1];
    }
    out
}

/// Returns the curve.
fn bent(p: &[f64], full_scale_dn: f64) -> impl Fn(f64) -> f64 {
    let shape = p[0].round() as i32;
    let p: Vec<f64> = p.to_vec();
    let mut values = [0.0; KNOTS + 1];
    values[1..].copy_from_slice(&p[FIRST_KNOT..TOE]);
    let second = second_derivatives(&values);
    move |v| {
        // Below zero the curve continues as a straight line, except for the power law: noise there is small.
        let x = v.max(0.0) / full_scale_dn;
        match shape {
            0..=2 => v * (1.0 - p[REL] * x.powi(shape + 1)),
            3 => v * (1.0 - x * (p[REL] + x * (p[REL + 1] + x * p[REL + 2]))),
            4 => full_scale_dn * libm::pow((v / full_scale_dn).abs(), p[EXPONENT]).copysign(v),
            5 => v.min(p[KNEE]) + p[KNEE + 1] * (v - p[KNEE]).max(0.0),
            6 => {
                if v > 0.0 {
                    -p[ASYMPTOTE] * libm::expm1(-v / p[ASYMPTOTE])
                } else {
                    v
                }
            }
            8 => v + p[TOE] * libm::expm1(-v.max(0.0) / p[TOE + 1]),
            _ => {
                let at = (x * KNOTS as f64).clamp(0.0, 2.0 * KNOTS as f64);
                let i = (at as usize).min(KNOTS - 1);
                let (b, a) = (at - i as f64, 1.0 - at + i as f64);
                let bend = a * values[i]
                    + b * values[i + 1]
                    + ((a * a * a - a) * second[i] + (b * b * b - b) * second[i + 1]) / 6.0;
                v * (1.0 - bend)
            }
        }
    }
}

/// Minimum level of the knee of a full well, relative to the brightest level.
const FILLING: f64 = 0.85;
/// Maximum slope above this knee for a full well (named choices: amplifiers bend by less).
const FILLS: f64 = 0.75;

/// Shape with a table of whole codes.
const WHOLE_CODE: i32 = 9;
/// Shape with the same curve, computed with more bits than the codes that are sent (a converter of 12 bits
/// behind 8 of the output): it leaves out no codes.
const FINE: i32 = 10;

/// Slope of a table below which darks of a few codes share its rounding error (a named choice: beyond, the
/// noise of darks skips codes).
const MAX_SLOPE: f64 = 2.0;
/// Standard deviation of the rounding error, in codes: root 1/12.
const ROUNDED: f64 = 0.29;

fn is_of_whole_code(p: &[f64]) -> bool {
    p[0].round() as i32 == WHOLE_CODE
}

fn is_fine(p: &[f64]) -> bool {
    p[0].round() as i32 == FINE
}

/// Computes the gamma of the code with the black level in it: a curve of DN above the black level, with the
/// code of darks before it.
fn fine(g: f64, full: f64, black: f64) -> impl Fn(f64) -> f64 {
    let black = black.max(1e-3);
    let before = full * libm::pow(black / full, 1.0 / g);
    move |v| full * libm::pow(((v + before) / full).max(0.0), g) - black
}

/// Maps codes c to full scale (c / full scale)^g, black level included: the level of the darks is the black
/// level after the map.
fn of_whole_code(g: f64, c: &Campaign, out: &mut Prediction) {
    let (full, black) = (c.full_scale_dn, out.base.offset_dn.max(1e-3));
    let before = full * libm::pow(black / full, 1.0 / g);
    // The spacing of the table's codes equals its slope: above 1, some codes do not occur.
    let slope = |level: f64| g * libm::pow((level.max(1.0)) / full, g - 1.0);
    let darkest = out.sets.iter().map(|s| s.signal).fold(f64::INFINITY, f64::min);
    for (i, s) in out.sets.iter_mut().enumerate() {
        let spread = c.sets.get(i).map_or(0.0, |s| s.spread_dn);
        let places = c.sets.get(i).map_or(crate::predict::NORMAL, |s| s.places);
        let level = s.signal + before;
        let all = places.iter().zip(crate::predict::PLACES);
        let used: f64 = all.map(|(x, share)| share * (1.0 / slope(level + spread * x)).min(1.0)).sum();
        s.codes_used *= used;
        let here = slope(level);
        // The rounding error of the table is periodic in the code, with (slope - 1) cycles per code. It
        // averages out if the noise and the levels cover a cycle (Widrow and Kollar 2008, ch. 4). If the
        // slope is above 1, the noise must cover the spacing of the codes.
        let (turn, variance) = (here - 1.0, s.covariance(0, 0));
        let square = 2.0 * std::f64::consts::PI * std::f64::consts::PI;
        let left = libm::exp(-square * turn * turn * (variance + spread * spread));
        // Black level and read noise are fitted to darks with the same rounding: sets within a part of a
        // cycle from the darkest share its error.
        let is_dense = here < MAX_SLOPE;
        let cycles = |per_code: f64| {
            let apart = std::f64::consts::TAU * per_code * (s.signal - darkest);
            if is_dense { apart.min(1.0) } else { 1.0 }
        };
        let (of_table, of_codes) =
            (ROUNDED * left * cycles(turn.abs()), quantised_mean(variance) * cycles(1.0));
        s.unsure_mean = libm::hypot(s.unsure_mean, of_table);
        // The error rises or falls with the code: its covariance with the noise is the variance times its
        // mean slope (Stein 1981, lemma 1).
        let slope_of_error = std::f64::consts::TAU * turn.abs() * ROUNDED * left;
        let of_noise = if is_dense {
            2.0 * slope_of_error * (variance + ROUNDED * ROUNDED) / here
        } else {
            0.5 * of_table
        };
        s.unsure_own = libm::hypot(s.unsure_own, of_noise * cycles(turn.abs()));
        if is_dense && s.signal <= darkest {
            out.unsure_dark_dn2 = libm::hypot(out.unsure_dark_dn2, of_noise);
        }
        if here > 1.0 {
            s.unsure_own = libm::hypot(s.unsure_own, 0.5 * of_codes);
            s.unsure_mean = libm::hypot(s.unsure_mean, of_codes);
        }
    }
    out.bend(c, fine(g, full, black));
    out.whole = false;
}

impl Effect for Nonlinearity {
    fn id(&self) -> &'static str {
        "nonlinearity"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["gamma", "lut", "knee", "linearity", "contrast curve", "tone curve"]
    }

    fn stage(&self) -> Stage {
        Stage::Amplifier
    }

    /// A table of codes comes after the converter.
    fn stage_with(&self, values: &[f64]) -> Stage {
        if is_of_whole_code(values) {
            Stage::Firmware
        } else if is_fine(values) {
            Stage::Converter
        } else {
            Stage::Amplifier
        }
    }

    fn parameters(&self) -> &'static [Parameter] {
        const ALL: [Parameter; PLACES] = [
            Parameter {
                name: "shape",
                meaning: "0 to 2: one power, 3: polynomial, 4: gamma of the signal, 5: two slopes, 6: exponential saturation, 7: free curve, 8: toe, \
                          9: gamma of the whole code, 10: the same before codes are rounded",
                unit: "choice",
                min: 0.0,
                max: 10.0,
                starts: &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0],
            },
            size("rel", "shapes 0 to 3: what is missing at full scale, relative", 0.01),
            size("rel_2", "shape 3: of the second power", 0.003),
            size("rel_3", "shape 3: of the third power", 0.003),
            Parameter {
                name: "exponent",
                meaning: "shapes 4, 9 and 10: the exponent (gamma)",
                unit: "1",
                min: 0.25,
                max: 2.5,
                starts: &[0.97, 1.03],
            },
            Parameter {
                name: "knee_dn",
                meaning: "shape 5: level of the knee",
                unit: "DN",
                min: 1.0,
                max: 65_535.0,
                starts: &[],
            },
            Parameter {
                name: "ratio",
                meaning: "shape 5: slope above the knee over that below",
                unit: "1",
                min: 0.05,
                max: 2.0,
                starts: &[0.9],
            },
            Parameter {
                name: "asymptote_dn",
                meaning: "shape 6: level that the output approaches",
                unit: "DN",
                min: 1.0,
                max: 1e8,
                starts: &[],
            },
            size("bend_1", "shape 7: the curve at 1/6 of full scale, relative", 0.003),
            size("bend_2", "shape 7: the curve at 2/6 of full scale, relative", 0.003),
            size("bend_3", "shape 7: the curve at 3/6 of full scale, relative", 0.003),
            size("bend_4", "shape 7: the curve at 4/6 of full scale, relative", 0.003),
            size("bend_5", "shape 7: the curve at 5/6 of full scale, relative", 0.003),
            size("bend_6", "shape 7: the curve at 6/6 of full scale, relative", 0.003),
            Parameter {
                name: "toe_dn",
                meaning: "shape 8: what is missing above the toe",
                unit: "DN",
                min: -1000.0,
                max: 1000.0,
                starts: &[1.0],
            },
            Parameter {
                name: "toe_width_dn",
                meaning: "shape 8: level at which 63 % of it is missing",
                unit: "DN",
                min: 1.0,
                max: 65_535.0,
                starts: &[],
            },
        ];
        &ALL
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        match (p[0].round() as i32, parameter) {
            (_, 0) => true,
            (0..=2, k) => k == REL,
            (3, k) => (REL..REL + 3).contains(&k),
            (4 | WHOLE_CODE | FINE, k) => k == EXPONENT,
            (5, k) => k == KNEE || k == KNEE + 1,
            (6, k) => k == ASYMPTOTE,
            (7, k) => (FIRST_KNOT..TOE).contains(&k),
            (_, k) => k >= TOE,
        }
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        Some(match p[0].round() as i32 {
            0 => "a bend with the square of the signal",
            1 => "a bend with the cube of the signal",
            2 => "a bend with the fourth power of the signal",
            3 => "a polynomial of fourth order",
            4 => "a power law (a gamma)",
            5 => "two slopes with a knee between them",
            6 => "saturation towards an asymptote",
            8 => "a toe near black",
            WHOLE_CODE => "gamma, applied to the whole code with the black level in it",
            FINE => "gamma, applied to the whole code with the black level in it, before it is rounded",
            _ => "a free curve",
        })
    }

    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let full = seen.full_scale_dn;
        let peak = (seen.peak_dn).clamp(1.0, full);
        let base = |shape: f64| {
            let mut p = vec![0.0; PLACES];
            (p[0], p[EXPONENT], p[KNEE], p[KNEE + 1], p[ASYMPTOTE], p[TOE + 1]) =
                (shape, 1.0, 0.5 * peak, 1.0, 30.0 * full, 0.01 * peak);
            p
        };
        let with = |shape: f64, set: &[(usize, f64)]| {
            let mut p = base(shape);
            set.iter().for_each(|(i, v)| p[*i] = *v);
            p
        };
        if !seen.shows_a_curve() {
            return Vec::new();
        }
        let mut out: Vec<Vec<f64>> = (0..3).map(|k| with(f64::from(k), &[(REL, 0.01)])).collect();
        if !seen.means {
            // The variance alone determines one parameter of a bend.
            return out;
        }
        for shape in [WHOLE_CODE, FINE] {
            out.extend([0.97, 0.85, 0.6, 0.45, 1.1].map(|e| with(f64::from(shape), &[(EXPONENT, e)])));
        }
        out.push(with(3.0, &[(REL, 0.01), (REL + 1, 0.003), (REL + 2, 0.003)]));
        out.extend([0.93, 1.07].map(|e| with(4.0, &[(EXPONENT, e)])));
        out.extend([0.3, 0.5, 0.7, 0.85].map(|k| with(5.0, &[(KNEE, k * peak), (KNEE + 1, 0.9)])));
        out.push(with(5.0, &[(KNEE, 0.5 * peak), (KNEE + 1, 1.1)]));
        out.extend([4.0, 30.0].map(|a| with(6.0, &[(ASYMPTOTE, a * full)])));
        let knots: Vec<(usize, f64)> = (0..KNOTS).map(|k| (FIRST_KNOT + k, 0.002 * (k + 1) as f64)).collect();
        out.push(with(7.0, &knots));
        out.extend([0.003, 0.01, 0.03].map(|w| with(8.0, &[(TOE, 1.0), (TOE + 1, w * peak)])));
        out
    }

    fn needs(&self) -> Needs {
        Needs::Variances
    }

    /// A slope near 0 above the knee is a full well: charge still rises by a few per cent of the light, since
    /// pixels differ and few are full at first. A knee near the end of the range also is a full well: too
    /// few levels lie beyond it to tell two slopes from a curve. A toe as wide as the range is a bend, which
    /// other shapes describe. A toe within the noise of darks is a difference between darks and flats.
    fn is_another(&self, p: &[f64], seen: &Seen) -> bool {
        match p[0].round() as i32 {
            5 => p[KNEE + 1] < 0.1 || p[KNEE] > FILLING * seen.peak_dn && p[KNEE + 1] < FILLS,
            8 => !(2.0 * seen.dark_noise_dn..=0.3 * seen.peak_dn).contains(&p[TOE + 1]),
            _ => false,
        }
    }

    fn bends_means(&self) -> bool {
        true
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        let mut p = vec![0.0; PLACES];
        (p[TOE], p[TOE + 1]) = (0.001 * plain.full_scale_dn, 0.01 * plain.full_scale_dn);
        (p[REL], p[EXPONENT], p[KNEE], p[KNEE + 1], p[ASYMPTOTE]) =
            (0.003, 0.99, 0.4 * plain.full_scale_dn, 0.99, 100.0 * plain.full_scale_dn);
        (p[REL + 1], p[REL + 2]) = (-0.004, 0.006);
        for (k, v) in [0.001, 0.003, 0.002, 0.003, 0.005, 0.009].into_iter().enumerate() {
            p[FIRST_KNOT + k] = v;
        }
        Some(p)
    }

    fn scaled(&self, values: &[f64], by: f64) -> Vec<f64> {
        let mut p = values.to_vec();
        for (k, v) in p.iter_mut().enumerate() {
            match k {
                0 | KNEE => {}
                k if k == TOE + 1 => {}
                EXPONENT => *v = 1.0 + by * (*v - 1.0),
                ASYMPTOTE => *v /= by,
                k if k == KNEE + 1 => *v = 1.0 + by * (*v - 1.0),
                _ => *v *= by,
            }
        }
        p.iter().zip(self.parameters()).map(|(v, p)| v.clamp(p.min, p.max)).collect()
    }

    fn page(&self) -> Page {
        Page {
            what: "The output does not grow in proportion to the charge: a source follower whose capacitance changes with the voltage, an \
                   amplifier near its rail, a gamma or a knee that is switched on.",
            equation: "D = f(v), v = A q; shape 0 to 2: v (1 - rel x^n), x = v / full scale, n = 1, 2, 3; 3: v (1 - rel x - rel_2 x^2 - \
                       rel_3 x^3); 4: full scale x^exponent; 5: slope 1 up to knee_dn, ratio above; 6: a (1 - exp(-v / a)); 7: v (1 - c(x)), \
                       c a cubic spline; 8: v - toe_dn (1 - exp(-v / toe_width_dn)); 9: D' = full scale (D / full scale)^exponent of codes D, black level included, 10: the same \
                       before rounding; \
                       the inverse is full scale (D' / full scale)^(1 / exponent); noise is multiplied by the slope",
            signature: "the mean against the exposure bends; variance over mean follows the square of the slope; neighbours stay uncorrelated",
            look_alikes: "brighter-fatter lowers the variance too, but leaves the mean alone and correlates neighbours; lamp settings scatter \
                          the means about a straight line and leave the variance alone; an exposure offset moves the line as a narrow toe does, \
                          but in proportion to the light",
            remedy: "switch gamma and knee off; correct by the inverse curve, or stay where it is straight",
            measure: "an exposure sweep at fixed light: the mean tells nonlinearity from brighter-fatter",
            sets: takes::SWEEP,
            source: "Janesick 2007, Photon Transfer, ch. 7; EMVA 1288 release 4, linearity",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        if is_of_whole_code(p) {
            of_whole_code(p[EXPONENT], c, out);
            return;
        }
        if is_fine(p) {
            out.bend(c, fine(p[EXPONENT], c.full_scale_dn, out.base.offset_dn));
            return;
        }
        out.bend(c, bent(p, c.full_scale_dn));
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        if is_of_whole_code(p) {
            let full = d.full_scale_dn;
            d.image.mapv_inplace(|code| full * libm::pow((code / full).max(0.0), p[EXPONENT]));
            return;
        }
        if is_fine(p) {
            // The image counts from the black level before the curve.
            let (full, black) = (d.full_scale_dn, d.offset_dn);
            d.image.mapv_inplace(|v| full * libm::pow(((v + black) / full).max(0.0), p[EXPONENT]) - black);
            return;
        }
        d.image.mapv_inplace(bent(p, d.full_scale_dn));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The natural spline through 0, 1, 3, 2, 3, 5, 9 at 0 to 6, from its tridiagonal system solved by numpy
    /// 2.4 (numpy.linalg.solve).
    #[test]
    fn the_spline_is_that_of_numpy() {
        let mut p = vec![0.0; PLACES];
        p[0] = 7.0;
        for (k, v) in [1.0, 3.0, 2.0, 3.0, 5.0, 9.0].into_iter().enumerate() {
            p[FIRST_KNOT + k] = 0.01 * v;
        }
        let curve = bent(&p, 6.0);
        let c = |x: f64| (1.0 - curve(x) / x) * 100.0;
        for (x, expected) in [(1.0, 1.0), (2.0, 3.0), (6.0, 9.0), (2.5, 2.608_173_076_923_077)] {
            assert!((c(x) - expected).abs() < 1e-9, "{x}: {}", c(x));
        }
    }
}
