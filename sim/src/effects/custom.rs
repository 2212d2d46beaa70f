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
//! Formulas give the change of `mean` (DN), `variance`, `cov_01`, `cov_10`, `cov_11`, `row`, `column`,
//! `common` (DN^2), and of `parity_01`, `parity_10` (what a neighbour covariance from odd columns, rows has
//! more than from even ones), in terms of the parameters and of mu (mean above the black level, DN), exposure
//! (s) and illumination (relative to the bench's unit); when frames are drawn, `mean` and `variance` may also
//! use row, column and parity (0 or 1).

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Stage, takes};
use crate::text::{echo, echo_message};
use exmex::{Express, FlatEx};
use std::collections::{BTreeMap, HashMap};
use std::sync::{LazyLock, Mutex};

/// What a formula may change.
const TARGETS: [&str; 10] =
    ["mean", "variance", "cov_01", "cov_10", "cov_11", "parity_01", "parity_10", "row", "column", "common"];
/// What a formula may use beside its parameters.
const VARIABLES: [&str; 6] = ["mu", "exposure", "illumination", "row", "column", "parity"];

/// Characters of a formula. The parser takes time with their square: the longest allowed takes some
/// milliseconds, 10^6 took minutes.
const MAX_FORMULA_CHARACTERS: usize = 10_000;
/// Parentheses inside one another; each takes a step of the stack.
const MAX_FORMULA_DEPTH: usize = 200;
/// Parameters of an effect of formulas. A fit of more has no use of them.
const MAX_PARAMETERS: usize = 1000;

/// Refuses a formula that is longer or deeper than any that a person writes.
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

/// One formula, ready to be evaluated.
struct Formula {
    expression: FlatEx<f64>,
    /// For each variable of the expression: a parameter's place, or that of a variable.
    places: Vec<Result<usize, usize>>,
}

impl Formula {
    fn eval(&self, p: &[f64], variables: &[f64; 6]) -> f64 {
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

    /// Whether it is a number at ordinary levels, exposures and lights; where not, at which.
    fn sound(&self, p: &[f64]) -> Result<(), String> {
        let values = |v: &[f64; 6]| -> Vec<f64> {
            let of = |place: &Result<usize, usize>| match place {
                Ok(i) => p.get(*i).copied().unwrap_or(0.0),
                Err(i) => v[*i],
            };
            self.places.iter().map(of).collect()
        };
        for v in [[10.0, 0.01, 1.0, 3.0, 5.0, 0.0], [1000.0, 0.01, 0.5, 3.0, 5.0, 1.0]] {
            if !self.expression.eval(&values(&v)).is_ok_and(f64::is_finite) {
                return Err(format!("mu = {} DN, exposure = {} s, illumination = {}", v[0], v[1], v[2]));
            }
        }
        Ok(())
    }

    fn uses(&self, variable: usize) -> bool {
        self.places.contains(&Err(variable))
    }

    /// For every pixel of an image: where it depends on the level alone, from a table over the levels.
    fn over(&self, p: &[f64], image: &ndarray::Array2<f64>, bare: &[f64; 6]) -> ndarray::Array2<f64> {
        let at = |level: f64, y: usize, x: usize| {
            let place = [y as f64, x as f64, ((y + x) % 2) as f64];
            self.eval(p, &[level, bare[1], bare[2], place[0], place[1], place[2]])
        };
        if (3..6).any(|place| self.uses(place)) {
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
}

/// Description of an effect of formulas, as a model file has it.
#[derive(Debug, Clone, Copy)]
pub struct Described<'a> {
    /// Its name.
    pub name: &'a str,
    /// Formula for each target.
    pub formulas: &'a BTreeMap<String, String>,
    /// Parameters and their values.
    pub values: &'a BTreeMap<String, f64>,
    /// Lowest and highest value of a parameter.
    pub bounds: &'a BTreeMap<String, [f64; 2]>,
    /// Units of parameters.
    pub units: &'a BTreeMap<String, String>,
}

impl Described<'_> {
    /// Lowest and highest value of a parameter.
    pub fn bounds_of(&self, parameter: &str) -> [f64; 2] {
        self.bounds.get(parameter).copied().unwrap_or([-1e12, 1e12])
    }

    /// Checks formulas and bounds; nothing is kept.
    ///
    /// # Errors
    ///
    /// Which formula or bound cannot be understood.
    pub fn check(&self) -> Result<(), String> {
        parsed(self).map(drop)
    }
}

/// Makes an effect of formulas, one for each description. It is kept until the program ends.
///
/// # Errors
///
/// Which formula or bound cannot be understood.
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
        // "choice" has a meaning of its own: see Parameter::is_choice.
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
    }));
    kept.insert(key, effect);
    Ok(effect)
}

/// Formulas by their targets, checked.
fn parsed(described: &Described<'_>) -> Result<BTreeMap<String, Formula>, String> {
    let Described { name, formulas, values, bounds, .. } = *described;
    if formulas.is_empty() {
        return Err(format!("custom effect {name} has no formulas; it may change {}", TARGETS.join(", ")));
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
        if !TARGETS.contains(&target.as_str()) {
            return Err(format!(
                "custom effect {name}: a formula cannot change {}, only {}",
                echo(target),
                TARGETS.join(", ")
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
        Page {
            what: "An effect of the user's own, written as formulas in the model file.",
            equation: "see the model file",
            signature: "see the model file",
            look_alikes: "not known",
            remedy: "not known",
            measure: "the statistic that its formula changes, at more levels",
            sets: takes::PAIRS,
            source: "the user",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        for (i, (s, info)) in out.sets.iter_mut().zip(&c.sets).enumerate() {
            let variables = [s.signal, info.exposure_s, info.illumination, 0.0, 0.0, 0.0];
            let of = |target: &str| self.formulas.get(target).map_or(0.0, |f| f.eval(p, &variables));
            let (variance, h, v, d) = (of("variance"), of("cov_01"), of("cov_10"), of("cov_11"));
            s.read.add(|ky, kx| {
                variance
                    + 2.0 * h * libm::cos(kx)
                    + 2.0 * v * libm::cos(ky)
                    + 4.0 * d * libm::cos(kx) * libm::cos(ky)
            });
            s.row.add(of("row"));
            s.column.add(of("column"));
            s.common += of("common");
            s.parity = (s.parity.0 + of("parity_01"), s.parity.1 + of("parity_10"));
            let shift = of("mean");
            s.signal += shift;
            for (m, _) in out.frame_signal.iter_mut().zip(&c.frames).filter(|(_, f)| f.set == i) {
                *m += shift;
            }
        }
    }

    /// What odd and even lines differ by is predicted only.
    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let level = d.image.mean().unwrap_or(0.0);
        let bare = [level, d.exposure_s, d.illumination, 0.0, 0.0, 0.0];
        let of = |target: &str| self.formulas.get(target).map_or(0.0, |f| f.eval(p, &bare));
        let tag = |target: &str| format!("{} {target}", self.name);
        if let Some(mean) = self.formulas.get("mean") {
            let shift = mean.over(p, &d.image, &bare);
            d.image += &shift;
        }
        if let Some(variance) = self.formulas.get("variance") {
            let shared = [of("cov_01"), of("cov_10"), of("cov_11")];
            let rng = |y: usize, x: usize, columns: usize| {
                d.random(&tag("variance"), d.frame, (y * columns + x) as u32).normal()
            };
            let columns = d.image.ncols();
            let noise = ndarray::Array2::from_shape_fn(d.image.dim(), |(y, x)| rng(y, x, columns));
            if shared.iter().any(|c| *c != 0.0) {
                d.image += &correlated(&noise, of("variance"), shared);
            } else {
                let variance = variance.over(p, &d.image, &bare);
                d.image += &(noise * variance.mapv(|v| libm::sqrt(v.max(0.0))));
            }
        }
        for (target, axis) in [("row", 0), ("column", 1)] {
            let variance = of(target);
            if variance > 0.0 {
                d.add_to_lines(&tag(target), axis, libm::sqrt(variance));
            }
        }
        let common = of("common");
        if common > 0.0 {
            d.image += libm::sqrt(common) * d.random(&tag("common"), d.frame, 0).normal();
        }
    }
}

/// Noise of this variance and these covariances with the next column, the next row and along the diagonals,
/// made of white noise by the filter whose power is theirs; where no noise has them the nearest that there
/// is.
fn correlated(white: &ndarray::Array2<f64>, variance: f64, [h, v, d]: [f64; 3]) -> ndarray::Array2<f64> {
    const REACH: i32 = 4;
    let power = |ky: f64, kx: f64| {
        let (cy, cx) = (libm::cos(ky), libm::cos(kx));
        (variance + 2.0 * h * cx + 2.0 * v * cy + 4.0 * d * cx * cy).max(0.0)
    };
    // The filter's weights are the Fourier sum of the root of the power.
    const FINE: usize = 32;
    let angle = |i: usize| std::f64::consts::TAU * i as f64 / FINE as f64;
    let weight = |dy: i32, dx: i32| {
        let of = |i: usize| {
            let (ky, kx) = (angle(i / FINE), angle(i % FINE));
            libm::sqrt(power(ky, kx)) * libm::cos(ky * f64::from(dy)) * libm::cos(kx * f64::from(dx))
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

    /// One effect for each description, and none for a check.
    #[test]
    fn a_description_is_kept_once() {
        let formulas = BTreeMap::from([("variance".to_string(), "k * mu".to_string())]);
        let values = BTreeMap::from([("k".to_string(), 0.25)]);
        let (bounds, units) = (BTreeMap::new(), BTreeMap::new());
        let of =
            |name| Described { name, formulas: &formulas, values: &values, bounds: &bounds, units: &units };
        let place = |effect: &'static dyn Effect| std::ptr::from_ref(effect).cast::<()>();
        let first = custom(of("kept once")).unwrap();
        assert!(of("kept once").check().is_ok());
        assert_eq!(place(first), place(custom(of("kept once")).unwrap()));
        assert_ne!(place(first), place(custom(of("another")).unwrap()));
        assert_eq!((first.id(), first.parameters()[0].starts), ("kept once", &[0.25][..]));
    }
}
