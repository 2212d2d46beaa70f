//! A user's own effect, written as formulas in the model file.
//!
//! ```toml
//! [[effect]]
//! id = "custom"
//! name = "noise-of-the-long-exposure"
//! formulas = { variance = "k * exposure * mu", cov_01 = "0.5 * k * exposure * mu" }
//! parameters = { k = 0.1 }
//! bounds = { k = [0.0, 10.0] }
//! units = { k = "DN/s" }
//! ```
//!
//! Formulas give the change of `mean` (DN), of `variance`, `row`, `column`, `common` (DN^2), of the gradient
//! and the curvature of frames down the rows and across the columns (`gradient_y`, `gradient_x`,
//! `curvature_y`, `curvature_x`, DN^2, mean over the pixels), and of covariances (DN^2). `cov_YX`: covariance
//! of pixels Y rows and X columns apart (up to 3 of each; both diagonals alike). `cov_1-1`: covariance along
//! the diagonal up to the right minus that along the other. `parity_01`, `parity_10`: neighbour covariance
//! starting at odd columns (rows) minus that at even ones. Formulas may use the parameters, mu (mean above
//! the black level, DN), noise (variance of a pixel without the effect, DN^2), exposure (s) and illumination
//! (relative to the bench's unit). `mean` may also use time (s from the first frame) and odd (1 in every
//! second frame, else 0); when frames are drawn, `mean` and `variance` may also use row, column and parity (0
//! or 1).

use super::own::page_of;
use super::{Campaign, Drawing, Effect, OwnPage, Page, Parameter, Plain, Prediction, Stage};
use crate::EffectValues;
use crate::predict::{LAGS, SHAPES, SetPrediction, cosine};
use crate::text::{echo, echo_message};
use exmex::{Express, FlatEx};
use std::collections::{BTreeMap, HashMap};
use std::sync::{LazyLock, Mutex};

/// Statistics that a formula may change, beside covariances.
pub const TARGETS: [&str; 12] = [
    "mean",
    "variance",
    "row",
    "column",
    "common",
    "parity_01",
    "parity_10",
    "cov_1-1",
    "gradient_y",
    "gradient_x",
    "curvature_y",
    "curvature_x",
];
/// Targets of the field's shapes, down the rows and across the columns.
const FIELD_TARGETS: [[&str; SHAPES]; 2] = [["gradient_y", "curvature_y"], ["gradient_x", "curvature_x"]];
/// Variables of a formula beside its parameters.
const VARIABLES: [&str; 9] =
    ["mu", "exposure", "illumination", "row", "column", "parity", "time", "odd", "noise"];
/// Indexes of the variables that differ from pixel to pixel.
const OF_PIXELS: std::ops::Range<usize> = 3..6;
/// Indexes of the variables that differ from frame to frame.
const OF_FRAMES: std::ops::Range<usize> = 6..8;

/// Values of all variables.
type Variables = [f64; VARIABLES.len()];

/// Returns the rows and columns between the pixels of a covariance target.
fn lag(target: &str) -> Option<(usize, usize)> {
    let lag = target.strip_prefix("cov_")?;
    let digit = |c: u8| (b'0'..b'0' + LAGS as u8).contains(&c).then(|| usize::from(c - b'0'));
    let &[y, x] = lag.as_bytes() else { return None };
    digit(y).zip(digit(x)).filter(|lag| *lag != (0, 0))
}

/// Lists the names of all targets in words.
fn targets() -> String {
    format!("{} and covariances such as cov_01 (up to 3 rows and columns apart)", TARGETS.join(", "))
}

/// Bound of a parameter without bounds.
pub const UNBOUNDED: f64 = 1e12;

/// Maximum number of characters of a formula. The parser's time grows with their square: the longest allowed
/// takes some milliseconds, 10^6 took minutes.
const MAX_FORMULA_CHARACTERS: usize = 10_000;
/// Maximum depth of nested parentheses; each level takes a stack frame.
const MAX_FORMULA_DEPTH: usize = 200;
/// Maximum number of parameters of an effect of formulas. A fit cannot use more.
const MAX_PARAMETERS: usize = 1000;

/// Refuses a formula that is longer or deeper than any written by a person.
fn must_be_short(text: &str) -> Result<(), String> {
    let characters = text.chars().count();
    if characters > MAX_FORMULA_CHARACTERS {
        return Err(format!("has {characters} characters; a formula has {MAX_FORMULA_CHARACTERS} at most"));
    }
    let mut depth = 0usize;
    for c in text.chars() {
        match c {
            '(' | '[' | '{' => depth += 1,
            ')' | ']' | '}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth > MAX_FORMULA_DEPTH {
            return Err(format!("has more than {MAX_FORMULA_DEPTH} parentheses inside one another"));
        }
    }
    Ok(())
}

/// Parsed formula.
struct Formula {
    expression: FlatEx<f64>,
    /// For each variable of the expression: index of a parameter (`Ok`) or of a variable (`Err`).
    places: Vec<Result<usize, usize>>,
}

impl Formula {
    fn eval(&self, p: &[f64], variables: &Variables) -> f64 {
        let values: Vec<f64> = self
            .places
            .iter()
            .map(|place| match place {
                Ok(i) => p.get(*i).copied().unwrap_or(0.0),
                Err(i) => variables[*i],
            })
            .collect();
        self.expression.eval(&values).ok().filter(|v| v.is_finite()).unwrap_or(0.0)
    }

    /// Checks that the formula is a number at ordinary levels, exposures and lights; the error says where it
    /// is not.
    fn sound(&self, p: &[f64]) -> Result<(), String> {
        let values = |v: &Variables| -> Vec<f64> {
            let of = |place: &Result<usize, usize>| match place {
                Ok(i) => p.get(*i).copied().unwrap_or(0.0),
                Err(i) => v[*i],
            };
            self.places.iter().map(of).collect()
        };
        for v in [
            [10.0, 0.01, 1.0, 3.0, 5.0, 0.0, 0.0, 0.0, 4.0],
            [1000.0, 0.01, 0.5, 3.0, 5.0, 1.0, 2.0, 1.0, 100.0],
        ] {
            if !self.expression.eval(&values(&v)).is_ok_and(f64::is_finite) {
                return Err(format!("mu = {} DN, exposure = {} s, illumination = {}", v[0], v[1], v[2]));
            }
        }
        Ok(())
    }

    fn uses(&self, variable: usize) -> bool {
        self.places.contains(&Err(variable))
    }

    /// Evaluates the formula for every pixel of an image; from a table over the levels if it depends on the
    /// level alone.
    fn over(&self, p: &[f64], image: &ndarray::Array2<f64>, bare: &Variables) -> ndarray::Array2<f64> {
        let at = |level: f64, y: usize, x: usize| {
            let mut variables = *bare;
            variables[0] = level;
            variables[OF_PIXELS].copy_from_slice(&[y as f64, x as f64, ((y + x) % 2) as f64]);
            self.eval(p, &variables)
        };
        if OF_PIXELS.into_iter().any(|place| self.uses(place)) {
            return ndarray::Array2::from_shape_fn(image.dim(), |(y, x)| at(image[(y, x)], y, x));
        }
        if !self.uses(0) {
            return ndarray::Array2::from_elem(image.dim(), at(0.0, 0, 0));
        }
        const STEPS: usize = 256;
        let low = image.iter().copied().fold(f64::INFINITY, f64::min);
        let high = image.iter().copied().fold(f64::NEG_INFINITY, f64::max).max(low + 1e-9);
        let table: Vec<f64> =
            (0..=STEPS).map(|i| at(low + (high - low) * i as f64 / STEPS as f64, 0, 0)).collect();
        image.mapv(|v| {
            let place = (v - low) / (high - low) * STEPS as f64;
            let i = (place as usize).min(STEPS - 1);
            table[i] + (place - i as f64) * (table[i + 1] - table[i])
        })
    }
}

/// An effect made of formulas.
pub struct Custom {
    name: &'static str,
    parameters: &'static [Parameter],
    formulas: BTreeMap<String, Formula>,
    written: EffectValues,
    page: Page,
}

/// Description of an effect of formulas, as in a model file.
#[derive(Debug, Clone, Copy)]
pub struct Described<'a> {
    /// Name.
    pub name: &'a str,
    /// Formula for each target.
    pub formulas: &'a BTreeMap<String, String>,
    /// Parameters and their values.
    pub values: &'a BTreeMap<String, f64>,
    /// Lowest and highest value of a parameter.
    pub bounds: &'a BTreeMap<String, [f64; 2]>,
    /// Units of parameters.
    pub units: &'a BTreeMap<String, String>,
    /// Page, if there is one.
    pub page: Option<&'a OwnPage>,
}

impl Described<'_> {
    /// Returns the lowest and highest value of a parameter.
    pub fn bounds_of(&self, parameter: &str) -> [f64; 2] {
        self.bounds.get(parameter).copied().unwrap_or([-UNBOUNDED, UNBOUNDED])
    }

    /// Checks formulas and bounds; stores nothing.
    ///
    /// # Errors
    ///
    /// A formula or bound cannot be understood; the message names it.
    pub fn check(&self) -> Result<(), String> {
        parsed(self).map(drop)
    }
}

/// Creates an effect of formulas, one for each description. It is kept until the program ends.
///
/// # Errors
///
/// A formula or bound cannot be understood; the message names it.
pub fn custom(described: Described<'_>) -> Result<&'static dyn Effect, String> {
    static KEPT: LazyLock<Mutex<HashMap<String, &'static Custom>>> = LazyLock::new(Mutex::default);
    let key = format!("{described:?}");
    let mut kept = KEPT.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if let Some(known) = kept.get(&key) {
        return Ok(*known);
    }
    let formulas = parsed(&described)?;
    let keep = |text: &str| -> &'static str { Box::leak(text.to_string().into_boxed_str()) };
    let parameter = |(n, v): (&String, &f64)| {
        let [min, max] = described.bounds_of(n);
        // "choice" is reserved: see Parameter::is_choice.
        let unit = described.units.get(n).map(String::as_str).filter(|u| *u != "choice").unwrap_or("1");
        Parameter {
            name: keep(n),
            meaning: "",
            unit: keep(unit),
            min,
            max,
            starts: Box::leak(Box::new([*v])),
        }
    };
    let parameters: Vec<Parameter> = described.values.iter().map(parameter).collect();
    let effect: &'static Custom = Box::leak(Box::new(Custom {
        name: keep(described.name),
        parameters: Box::leak(parameters.into_boxed_slice()),
        formulas,
        written: Custom::written_as(&described),
        page: page_of(&described),
    }));
    kept.insert(key, effect);
    Ok(effect)
}

/// Parses and checks the formulas, by target.
fn parsed(described: &Described<'_>) -> Result<BTreeMap<String, Formula>, String> {
    let Described { name, formulas, values, bounds, .. } = *described;
    if formulas.is_empty() {
        return Err(format!("custom effect {name} has no formulas; it may change {}", targets()));
    }
    let name = &*echo(name);
    if values.len() > MAX_PARAMETERS {
        return Err(format!(
            "custom effect {name} has {} parameters; it may have {MAX_PARAMETERS}",
            values.len()
        ));
    }
    if let Some((parameter, [min, max])) =
        bounds.iter().find(|(_, [min, max])| min.is_nan() || max.is_nan() || min > max)
    {
        return Err(format!(
            "custom effect {name}: bounds of {} are {min} to {max}; the first must not be above the second",
            echo(parameter)
        ));
    }
    let names: Vec<&String> = values.keys().collect();
    let mut ready = BTreeMap::new();
    for (target, text) in formulas {
        if !TARGETS.contains(&target.as_str()) && lag(target).is_none() {
            return Err(format!(
                "custom effect {name}: a formula cannot change {}, only {}",
                echo(target),
                targets()
            ));
        }
        must_be_short(text).map_err(|e| format!("custom effect {name}: {target} {e}"))?;
        let shown = echo(text);
        let expression = exmex::parse::<f64>(text).map_err(|e| {
            format!("custom effect {name}: {target} = \"{shown}\": {}", echo_message(&e.to_string()))
        })?;
        let places = expression
            .var_names()
            .iter()
            .map(|variable| {
                if let Some(i) = names.iter().position(|n| *n == variable) {
                    return Ok(Ok(i));
                }
                VARIABLES.iter().position(|v| v == variable).map(Err).ok_or_else(|| {
                    format!(
                        "custom effect {name}: {target} uses {}, which is no parameter and none of {}",
                        echo(variable),
                        VARIABLES.join(", ")
                    )
                })
            })
            .collect::<Result<Vec<_>, String>>()?;
        let formula = Formula { expression, places };
        let place: Vec<f64> = names.iter().map(|n| values[*n]).collect();
        formula
            .sound(&place)
            .map_err(|at| format!("custom effect {name}: {target} = \"{shown}\" is no number at {at}"))?;
        ready.insert(target.clone(), formula);
    }
    Ok(ready)
}

impl Effect for Custom {
    fn id(&self) -> &'static str {
        self.name
    }

    fn stage(&self) -> Stage {
        Stage::Converter
    }

    fn parameters(&self) -> &'static [Parameter] {
        self.parameters
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        None
    }

    fn page(&self) -> Page {
        self.page
    }

    fn written(&self) -> Option<EffectValues> {
        Some(self.written.clone())
    }

    fn is_in_time(&self, _: &[f64]) -> bool {
        self.formulas.values().any(|formula| OF_FRAMES.into_iter().any(|place| formula.uses(place)))
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        for (i, (s, info)) in out.sets.iter_mut().zip(&c.sets).enumerate() {
            let (exposure_s, noise) = (info.exposure_s, s.covariance(0, 0));
            let variables = [s.signal, exposure_s, info.illumination, 0.0, 0.0, 0.0, 0.0, 0.0, noise];
            let of = |target: &str| self.formulas.get(target).map_or(0.0, |f| f.eval(p, &variables));
            if let Some(mean) = self.formulas.get("mean") {
                self.shift(mean, p, (i, s), variables, c, &mut out.frame_signal);
            }
            s.read.add_white(of("variance"));
            let lags = self.lags(p, &variables);
            if !lags.is_empty() {
                s.read.add(|ky, kx| lags.iter().map(|(lag, c)| power(*lag, *c, ky, kx)).sum());
            }
            s.row.add(of("row"));
            s.column.add(of("column"));
            s.common += of("common");
            for (variances, targets) in
                [&mut s.fields.down, &mut s.fields.across].into_iter().zip(FIELD_TARGETS)
            {
                for (variance, target) in variances.iter_mut().zip(targets) {
                    let own = of(target);
                    *variance += own;
                    // The square of a cosine has the variance 1/2 over the pixels.
                    s.unequal += 0.5 * own * own;
                }
            }
            s.parity = (s.parity.0 + of("parity_01"), s.parity.1 + of("parity_10"));
            s.uphill += of("cov_1-1");
        }
    }

    /// Draws covariances together with a variance as separate noise, with odd and even lines alike. Without a
    /// variance, neighbours share the existing noise, to first order: up to a tenth of the variance. A
    /// negative variance is predicted only.
    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let level = d.image.mean().unwrap_or(0.0);
        let odd = (d.frame % 2) as f64;
        let noise = d.gain_dn_per_e * level.max(0.0) + d.read_noise_dn * d.read_noise_dn;
        let bare = [level, d.exposure_s, d.illumination, 0.0, 0.0, 0.0, d.time_s, odd, noise];
        let of = |target: &str| self.formulas.get(target).map_or(0.0, |f| f.eval(p, &bare));
        let tag = |target: &str| format!("{} {target}", self.name);
        if let Some(mean) = self.formulas.get("mean") {
            let shift = mean.over(p, &d.image, &bare);
            d.image += &shift;
        }
        let (lags, uphill) = (self.lags(p, &bare), of("cov_1-1"));
        let parity = [of("parity_01"), of("parity_10")];
        if let Some(variance) = self.formulas.get("variance") {
            let rng = |y: usize, x: usize, columns: usize| {
                d.random(&tag("variance"), d.frame, (y * columns + x) as u32).normal()
            };
            let columns = d.image.ncols();
            let noise = ndarray::Array2::from_shape_fn(d.image.dim(), |(y, x)| rng(y, x, columns));
            if !lags.is_empty() || uphill != 0.0 {
                d.image += &correlated(&noise, of("variance"), &lags, uphill);
            } else {
                let variance = variance.over(p, &d.image, &bare);
                d.image += &(noise * variance.mapv(|v| libm::sqrt(v.max(0.0))));
            }
        } else if !lags.is_empty() || uphill != 0.0 || parity != [0.0; 2] {
            share(&mut d.image, noise.max(1e-9), &lags, uphill, parity);
        }
        for (target, axis) in [("row", 0), ("column", 1)] {
            let variance = of(target);
            if variance > 0.0 {
                d.add_to_lines(&tag(target), axis, libm::sqrt(variance));
            }
        }
        for (axis, targets) in FIELD_TARGETS.into_iter().enumerate() {
            for (shape, target) in targets.into_iter().enumerate() {
                let variance = of(target);
                if variance > 0.0 {
                    let size = libm::sqrt(variance) * d.random(&tag(target), d.frame, 0).normal();
                    let lines = d.image.len_of(ndarray::Axis(axis));
                    for line in 0..lines {
                        let moved = size * cosine(shape as u32 + 1, line, lines);
                        d.image.index_axis_mut(ndarray::Axis(axis), line).mapv_inplace(|v| v + moved);
                    }
                }
            }
        }
        let common = of("common");
        if common > 0.0 {
            d.image += libm::sqrt(common) * d.random(&tag("common"), d.frame, 0).normal();
        }
    }
}

impl Custom {
    /// Writes the entry of a model file.
    fn written_as(described: &Described<'_>) -> EffectValues {
        EffectValues {
            id: "custom".into(),
            name: Some(described.name.into()),
            parameters: described.values.clone(),
            formulas: described.formulas.clone(),
            bounds: described.bounds.clone(),
            units: described.units.clone(),
            ..Default::default()
        }
    }

    /// Returns the covariances of the formulas, by rows and columns between the pixels, DN^2.
    fn lags(&self, p: &[f64], variables: &Variables) -> Vec<((usize, usize), f64)> {
        self.formulas.iter().filter_map(|(target, f)| Some((lag(target)?, f.eval(p, variables)))).collect()
    }

    /// Moves the mean of a set and its frames. The noise follows the slope, which may differ from frame to
    /// frame.
    fn shift(
        &self,
        mean: &Formula,
        p: &[f64],
        (set, s): (usize, &mut SetPrediction),
        at: Variables,
        c: &Campaign,
        frames: &mut [f64],
    ) {
        let (mut sum, mut count) = (0.0, 0.0);
        let near = SLOPE_STEP * s.signal.abs().max(1.0);
        // Square of the slope at a frame.
        let square = |at: &Variables| {
            let beside = |by: f64| {
                let mut variables = *at;
                variables[0] += by;
                mean.eval(p, &variables)
            };
            (1.0 + (beside(near) - beside(-near)) / (2.0 * near)).powi(2)
        };
        let mut squares = 0.0;
        for (k, frame) in c.frames.iter().enumerate().filter(|(_, f)| f.set == set) {
            let mut variables = at;
            variables[OF_FRAMES].copy_from_slice(&[frame.time_s, (k % 2) as f64]);
            let Some(m) = frames.get_mut(k) else { continue };
            variables[0] = *m;
            squares += square(&variables);
            let shift = mean.eval(p, &variables);
            *m += shift;
            (sum, count) = (sum + shift, count + 1.0);
        }
        let squares = if count > 0.0 { squares / count } else { square(&at) };
        s.signal += if count > 0.0 { sum / count } else { mean.eval(p, &at) };
        if mean.uses(0) {
            s.scale(squares);
        }
    }
}

/// Step of the level for the numerical slope of a formula, as a share of the level.
const SLOPE_STEP: f64 = 1e-3;

/// Returns the power of a covariance at a lag, alike along both diagonals, at a spatial frequency
/// (Wiener-Khinchin).
fn power((y, x): (usize, usize), covariance: f64, ky: f64, kx: f64) -> f64 {
    let twice = |lag: usize| if lag == 0 { 1.0 } else { 2.0 };
    twice(y) * twice(x) * covariance * libm::cos(y as f64 * ky) * libm::cos(x as f64 * kx)
}

/// Gives independent noise of this variance the covariances, to first order: each pixel gets a fraction of
/// others. `parity`: covariance of neighbours starting at odd columns and rows minus that at even ones.
fn share(
    image: &mut ndarray::Array2<f64>,
    variance: f64,
    lags: &[((usize, usize), f64)],
    uphill: f64,
    parity: [f64; 2],
) {
    let mean = image.mean().unwrap_or(0.0);
    let apart = image.mapv(|v| v - mean);
    let mut add = |dy: usize, dx: isize, of: &dyn Fn(usize, usize) -> f64| {
        let (rows, columns) = apart.dim();
        for y in 0..rows.saturating_sub(dy) {
            for x in 0..columns {
                let Some(other) = x.checked_add_signed(dx).filter(|x| *x < columns) else { continue };
                // Each pixel gets half, so that the product of the two has all of the covariance.
                let half = 0.5 * of(y, x) / variance;
                image[(y, x)] += half * apart[(y + dy, other)];
                image[(y + dy, other)] += half * apart[(y, x)];
            }
        }
    };
    for &((y, x), covariance) in lags {
        add(y, x as isize, &|_, _| covariance);
        if y > 0 && x > 0 {
            add(y, -(x as isize), &|_, _| covariance);
        }
    }
    add(1, -1, &|_, _| uphill);
    let sign = |odd: usize| if odd % 2 == 1 { 0.5 } else { -0.5 };
    add(0, 1, &|_, x| parity[0] * sign(x));
    add(1, 0, &|y, _| parity[1] * sign(y));
}

/// Filters white noise to this variance and these covariances. If no noise can have them, the result is the
/// nearest possible noise.
fn correlated(
    white: &ndarray::Array2<f64>,
    variance: f64,
    lags: &[((usize, usize), f64)],
    uphill: f64,
) -> ndarray::Array2<f64> {
    const REACH: i32 = 4;
    let power = |ky: f64, kx: f64| {
        let lags: f64 = lags.iter().map(|(lag, c)| power(*lag, *c, ky, kx)).sum();
        (variance + lags + 2.0 * uphill * libm::cos(ky - kx)).max(0.0)
    };
    // Weights of the filter: the Fourier sum of the root of the power.
    const FINE: usize = 32;
    let angle = |i: usize| std::f64::consts::TAU * i as f64 / FINE as f64;
    let roots: Vec<f64> =
        (0..FINE * FINE).map(|i| libm::sqrt(power(angle(i / FINE), angle(i % FINE)))).collect();
    let weight = |dy: i32, dx: i32| {
        let of = |i: usize| {
            roots[i] * libm::cos(angle(i / FINE) * f64::from(dy) + angle(i % FINE) * f64::from(dx))
        };
        (0..FINE * FINE).map(of).sum::<f64>() / (FINE * FINE) as f64
    };
    let mut out = ndarray::Array2::zeros(white.dim());
    for dy in -REACH..=REACH {
        for dx in -REACH..=REACH {
            let w = weight(dy, dx);
            if w.abs() > 1e-4 * libm::sqrt(variance.max(0.0)) {
                out.scaled_add(w, &super::shifted(white, dy, dx));
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One effect is kept for each description, and none for a check.
    #[test]
    fn a_description_is_kept_once() {
        let formulas = BTreeMap::from([("variance".to_string(), "k * mu".to_string())]);
        let values = BTreeMap::from([("k".to_string(), 0.25)]);
        let (bounds, units) = (BTreeMap::new(), BTreeMap::new());
        let of = |name| Described {
            name,
            formulas: &formulas,
            values: &values,
            bounds: &bounds,
            units: &units,
            page: None,
        };
        let place = |effect: &'static dyn Effect| std::ptr::from_ref(effect).cast::<()>();
        let first = custom(of("kept once")).unwrap();
        assert!(of("kept once").check().is_ok());
        assert_eq!(place(first), place(custom(of("kept once")).unwrap()));
        assert_ne!(place(first), place(custom(of("another")).unwrap()));
        assert_eq!((first.id(), first.parameters()[0].starts), ("kept once", &[0.25][..]));
    }
}
