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
//! Formulas give the change of `mean` (DN), `variance`, `cov_01`, `cov_10`, `cov_11`, `row`, `column`, `common` (DN^2), and of
//! `parity_01`, `parity_10` (what a neighbour covariance from odd columns, rows has more than from even ones), in terms of
//! the parameters and of mu (mean above the level of zero charge, DN), exposure (s) and illumination; when frames are drawn,
//! `mean` may also use row, column and parity (0 or 1).

use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};
use exmex::{Express, FlatEx};
use std::collections::BTreeMap;

/// What a formula may change.
const TARGETS: [&str; 10] =
    ["mean", "variance", "cov_01", "cov_10", "cov_11", "parity_01", "parity_10", "row", "column", "common"];
/// What a formula may use beside its parameters.
const VARIABLES: [&str; 6] = ["mu", "exposure", "illumination", "row", "column", "parity"];

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
}

/// An effect made of formulas.
pub struct Custom {
    name: &'static str,
    parameters: &'static [Parameter],
    formulas: BTreeMap<String, Formula>,
}

/// Makes an effect of formulas. It is kept until the program ends.
pub fn custom(
    name: &str,
    formulas: &BTreeMap<String, String>,
    values: &BTreeMap<String, f64>,
    bounds: &BTreeMap<String, [f64; 2]>,
    units: &BTreeMap<String, String>,
) -> Result<&'static dyn Effect, String> {
    if formulas.is_empty() {
        return Err(format!("custom effect {name} has no formulas; it may change {}", TARGETS.join(", ")));
    }
    let keep = |text: &str| -> &'static str { Box::leak(text.to_string().into_boxed_str()) };
    let names: Vec<&String> = values.keys().collect();
    let mut ready = BTreeMap::new();
    for (target, text) in formulas {
        if !TARGETS.contains(&target.as_str()) {
            return Err(format!(
                "custom effect {name}: a formula cannot change {target}, only {}",
                TARGETS.join(", ")
            ));
        }
        let expression = exmex::parse::<f64>(text)
            .map_err(|e| format!("custom effect {name}: {target} = \"{text}\": {e}"))?;
        let places = expression
            .var_names()
            .iter()
            .map(|variable| {
                if let Some(i) = names.iter().position(|n| *n == variable) {
                    return Ok(Ok(i));
                }
                VARIABLES.iter().position(|v| v == variable).map(Err).ok_or_else(|| {
                    format!(
                        "custom effect {name}: {target} uses {variable}, which is no parameter and none of {}",
                        VARIABLES.join(", ")
                    )
                })
            })
            .collect::<Result<Vec<_>, String>>()?;
        ready.insert(target.clone(), Formula { expression, places });
    }
    let parameters: Vec<Parameter> = values
        .iter()
        .map(|(n, v)| {
            let [min, max] = bounds.get(n).copied().unwrap_or([-1e12, 1e12]);
            // "choice" has a meaning of its own: see Parameter::is_choice.
            let unit = keep(units.get(n).map(String::as_str).filter(|u| *u != "choice").unwrap_or("1"));
            Parameter { name: keep(n), unit, min, max, starts: Box::leak(Box::new([*v])) }
        })
        .collect();
    Ok(Box::leak(Box::new(Custom {
        name: keep(name),
        parameters: Box::leak(parameters.into_boxed_slice()),
        formulas: ready,
    })))
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
            for (k, power) in s.read.0.iter_mut().enumerate() {
                let (ky, kx) = (
                    crate::predict::angle(k / crate::predict::GRID),
                    crate::predict::angle(k % crate::predict::GRID),
                );
                *power += variance
                    + 2.0 * h * libm::cos(kx)
                    + 2.0 * v * libm::cos(ky)
                    + 4.0 * d * libm::cos(kx) * libm::cos(ky);
            }
            s.row += of("row");
            s.column += of("column");
            s.common += of("common");
            s.parity = (s.parity.0 + of("parity_01"), s.parity.1 + of("parity_10"));
            let shift = of("mean");
            s.signal += shift;
            for (m, _) in out.frame_signal.iter_mut().zip(&c.frames).filter(|(_, f)| f.set == i) {
                *m += shift;
            }
        }
    }

    /// The mean and the variance of single pixels, rows, columns and frames; a correlation of neighbours is predicted only.
    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let mean_rate = d.rate_e_per_s.mean().unwrap_or(0.0);
        let columns = d.image.ncols();
        let noise = |target: &str, v: &[f64; 6], index: u32, d: &Drawing<'_>| {
            let variance = self.formulas.get(target).map_or(0.0, |f| f.eval(p, v));
            if variance > 0.0 {
                libm::sqrt(variance) * d.random(target, d.frame, index).normal()
            } else {
                0.0
            }
        };
        let level = d.image.mean().unwrap_or(0.0);
        let bare = [level, d.exposure_s, mean_rate, 0.0, 0.0, 0.0];
        let common = noise("common", &bare, 0, d);
        let rows: Vec<f64> = (0..d.image.nrows()).map(|y| noise("row", &bare, y as u32, d)).collect();
        let of_columns: Vec<f64> = (0..columns).map(|x| noise("column", &bare, x as u32, d)).collect();
        let mut image = d.image.clone();
        for ((y, x), v) in image.indexed_iter_mut() {
            let variables = [*v, d.exposure_s, mean_rate, y as f64, x as f64, ((y + x) % 2) as f64];
            let shift = self.formulas.get("mean").map_or(0.0, |f| f.eval(p, &variables));
            *v += shift
                + common
                + rows[y]
                + of_columns[x]
                + noise("variance", &variables, (y * columns + x) as u32, d);
        }
        d.image = image;
    }
}
