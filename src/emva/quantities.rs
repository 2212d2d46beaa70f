//! The quantities, from the points.

use super::{EmvaError, Points, Spatial};
use crate::number::Quantity;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Evaluation {
    /// By the reference tool's names; null where the standard leaves one undefined, and a note says why.
    pub quantities: BTreeMap<String, Option<Quantity>>,
    /// What a reader should know.
    pub notes: Vec<String>,
}

/// Variance of quantisation, DN^2 (`Results1288.s2q`; q^2 / 12, eq. 27 of the paper).
const QUANTISATION_DN2: f64 = 1.0 / 12.0;
/// Below this temporal variance of the darks, DN^2, quantisation hides the noise (`Results1288.sigma_y_dark`).
const SMALLEST_DARK_DN2: f64 = 0.24;

/// A straight line y = slope x + offset by least squares without weights.
fn line(x: &[f64], y: &[f64]) -> (f64, f64) {
    let n = x.len() as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let xx: f64 = x.iter().map(|x| (x - mx).powi(2)).sum();
    let xy: f64 = x.iter().zip(y).map(|(x, y)| (x - mx) * (y - my)).sum();
    (xy / xx, my - xy / xx * mx)
}

/// A value, and its derivatives by the independent inputs times their standard errors: errors add in quadrature.
#[derive(Debug, Clone)]
struct Value {
    value: f64,
    parts: Vec<(usize, f64)>,
}

impl Value {
    fn exact(value: f64) -> Self {
        Self { value, parts: Vec::new() }
    }

    fn std_err(&self) -> f64 {
        self.parts.iter().map(|p| p.1 * p.1).sum::<f64>().sqrt()
    }

    /// A function of some values, by central differences in each.
    fn of(values: &[&Self], f: impl Fn(&[f64]) -> f64) -> Self {
        let at: Vec<f64> = values.iter().map(|v| v.value).collect();
        let mut parts: BTreeMap<usize, f64> = BTreeMap::new();
        for (k, v) in values.iter().enumerate() {
            let step = 1e-6 * v.value.abs().max(1e-12);
            let moved = |by: f64| {
                let mut to = at.clone();
                to[k] += by;
                f(&to)
            };
            let slope = (moved(step) - moved(-step)) / (2.0 * step);
            for (input, part) in &v.parts {
                *parts.entry(*input).or_default() += slope * part;
            }
        }
        Self { value: f(&at), parts: parts.into_iter().collect() }
    }
}

/// Independent inputs.
#[derive(Default)]
struct Inputs(usize);

impl Inputs {
    fn value(&mut self, value: f64, std_err: f64) -> Value {
        self.0 += 1;
        Value { value, parts: vec![(self.0, std_err)] }
    }
}

/// Evaluates the points.
///
/// # Errors
///
/// Where there are too few points for the fits of the standard.
pub fn evaluate(points: &Points) -> Result<Evaluation, EmvaError> {
    let t = &points.temporal;
    let pixels = (points.shape.0 * points.shape.1) as f64;
    let signal: Vec<f64> = t.iter().map(|p| p.mean_dn - p.dark_mean_dn).collect();
    let noise: Vec<f64> = t.iter().map(|p| p.var_dn2 - p.dark_var_dn2).collect();
    let photons: Vec<f64> = t.iter().map(|p| p.photons).collect();
    let saturation = saturation(&t.iter().map(|p| p.var_dn2).collect::<Vec<_>>());
    let last_below = |share: f64| signal.iter().rposition(|s| *s <= share * signal[saturation]);
    let too_few = |what: &str| EmvaError::Missing(format!("there are too few exposures for {what}"));
    let most = last_below(0.7).ok_or_else(|| too_few("the gain (up to 70 % of saturation)"))?;
    let used = 0..most + 1;
    let mut inputs = Inputs::default();
    let mut out = BTreeMap::new();
    let mut notes = Vec::new();

    // Gain and responsivity: lines through the origin, without weights (`Results1288.K`, `R`).
    let square: f64 = signal[used.clone()].iter().map(|x| x * x).sum();
    let through = |x: &[f64], y: &[f64]| -> f64 {
        let xy: f64 = used.clone().map(|i| x[i] * y[i]).sum();
        xy / used.clone().map(|i| x[i] * x[i]).sum::<f64>()
    };
    let k = through(&signal, &noise);
    // The variance of a pair's difference is known to root 2 / pixels of itself.
    let of_variance = |v: f64| v * (2.0 / pixels).sqrt();
    let k_var: f64 = used
        .clone()
        .map(|i| {
            let error = of_variance(t[i].var_dn2).hypot(of_variance(t[i].dark_var_dn2));
            (signal[i] * error / square).powi(2)
        })
        .sum();
    let k = inputs.value(k, k_var.sqrt());
    let r = through(&photons, &signal);
    let n = used.len() as f64;
    let light_square: f64 = used.clone().map(|i| photons[i] * photons[i]).sum();
    let scatter: f64 =
        used.clone().map(|i| (signal[i] - r * photons[i]).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    let r = inputs.value(r, (scatter / light_square).sqrt());

    // Dark noise: its value at no exposure where there are more than two exposures.
    let mut exposures: Vec<f64> = t.iter().map(|p| p.exposure_s).collect();
    exposures.dedup();
    let several = exposures.len() > 2;
    let seconds: Vec<f64> = t.iter().map(|p| p.exposure_s).collect();
    let dark_var: Vec<f64> = t.iter().map(|p| p.dark_var_dn2).collect();
    let dark_mean: Vec<f64> = t.iter().map(|p| p.dark_mean_dn).collect();
    let var_line = line(&seconds, &dark_var);
    let mean_line = line(&seconds, &dark_mean);
    let scatter_of = |y: &[f64], (slope, offset): (f64, f64)| {
        let left: f64 = seconds.iter().zip(y).map(|(x, y)| (y - offset - slope * x).powi(2)).sum();
        left / (y.len() as f64 - 2.0).max(1.0)
    };
    let mx = seconds.iter().sum::<f64>() / seconds.len() as f64;
    let xx: f64 = seconds.iter().map(|x| (x - mx).powi(2)).sum();
    let offset_share = (1.0 / seconds.len() as f64 + mx * mx / xx).sqrt();
    let dark_dn2 = if several { var_line.1 } else { dark_var[0] };
    let dark_error = if several {
        scatter_of(&dark_var, var_line).sqrt() * offset_share
    } else {
        of_variance(dark_var[0])
    };
    if dark_dn2 < SMALLEST_DARK_DN2 {
        notes.push(format!(
            "sigma_y_dark: the temporal variance of the darks is {dark_dn2:.4} DN^2, below {SMALLEST_DARK_DN2} DN^2, where quantisation \
             hides it; {SMALLEST_DARK_DN2} DN^2 stands in its place, an upper bound"
        ));
    }
    let dark = inputs
        .value(dark_dn2.max(SMALLEST_DARK_DN2), if dark_dn2 < SMALLEST_DARK_DN2 { 0.0 } else { dark_error });

    // Saturation is known to the step between exposures.
    let step = photons[saturation] - if saturation > 0 { photons[saturation - 1] } else { 0.0 };
    let at_saturation = inputs.value(photons[saturation], step.abs() / 12f64.sqrt());

    let mut put = |name: &str, value: &Value, unit: &'static str| {
        let quantity = value.value.is_finite().then(|| Quantity::new(value.value, value.std_err(), unit));
        out.insert(name.to_string(), quantity);
    };
    let qe = Value::of(&[&r, &k], |v| 100.0 * v[0] / v[1]);
    let sigma_y_dark = Value::of(&[&dark], |v| v[0].sqrt());
    let sigma_d = Value::of(&[&dark, &k], |v| (v[0] - QUANTISATION_DN2).sqrt() / v[1]);
    let u_e_min = Value::of(&[&dark, &k], |v| v[0].sqrt() / v[1] + 0.5);
    let u_p_min = Value::of(&[&dark, &k, &r], |v| (v[0].sqrt() / v[1] + 0.5) * v[1] / v[2]);
    let u_e_sat = Value::of(&[&at_saturation, &r, &k], |v| v[0] * v[1] / v[2]);
    let dr =
        Value::of(&[&at_saturation, &dark, &k, &r], |v| v[0] / ((v[1].sqrt() / v[2] + 0.5) * v[2] / v[3]));
    let snr = Value::of(&[&u_e_sat], |v| v[0].sqrt());
    put("K", &k, "DN/e");
    put("inverse_K", &Value::of(&[&k], |v| 1.0 / v[0]), "e/DN");
    put("sigma_y_dark", &sigma_y_dark, "DN");
    put("sigma_d", &sigma_d, "e");
    put("u_e_min", &u_e_min, "e");
    put("u_e_sat", &u_e_sat, "e");
    put("SNR_max", &snr, "1");
    put("SNR_max_dB", &Value::of(&[&snr], |v| 20.0 * v[0].log10()), "dB");
    put("SNR_max_bit", &Value::of(&[&snr], |v| v[0].log2()), "bit");
    put("inverse_SNR_max", &Value::of(&[&snr], |v| 100.0 / v[0]), "%");
    put("DR", &dr, "1");
    put("DR_dB", &Value::of(&[&dr], |v| 20.0 * v[0].log10()), "dB");
    for (name, value, unit) in
        [("R", &r, "DN/p"), ("QE", &qe, "%"), ("u_p_min", &u_p_min, "p"), ("u_p_sat", &at_saturation, "p")]
    {
        let known = if points.photons_known { value.clone() } else { Value::exact(f64::NAN) };
        put(name, &known, unit);
    }
    if !points.photons_known {
        notes.push("R, QE, u_p_min and u_p_sat: the light is not in photons per pixel; give it in dataset.toml, illumination_unit".into());
    }

    // Linearity, 5 to 95 % of saturation, weights 1 / signal (`Results1288.linearity`).
    let first = signal.iter().position(|s| *s >= 0.05 * signal[saturation]);
    let last = last_below(0.95);
    let range = first.zip(last).filter(|(a, b)| b > a);
    let deviations = range.map(|(a, b)| linearity(&photons[a..=b], &signal[a..=b]));
    // Each deviation is known to the noise of its means.
    let of_means = range.map_or(f64::NAN, |(a, b)| {
        let one = |i: usize| 100.0 * (0.5 * (t[i].var_dn2 + t[i].dark_var_dn2) / pixels).sqrt() / signal[i];
        (a..=b).map(one).fold(0.0, f64::max)
    });
    let (least, greatest) = deviations.map_or((f64::NAN, f64::NAN), |d| {
        (d.iter().copied().fold(f64::INFINITY, f64::min), d.iter().copied().fold(f64::NEG_INFINITY, f64::max))
    });
    put("LE_min", &inputs.value(least, of_means), "%");
    put("LE_max", &inputs.value(greatest, of_means), "%");
    if range.is_none() {
        notes.push("LE_min, LE_max: fewer than two exposures lie between 5 and 95 % of saturation".into());
    }

    // Dark current (`Results1288.u_I_mean`, `u_I_var`).
    let slope_error = |y: &[f64], fitted| (scatter_of(y, fitted) / xx).sqrt();
    let nothing = Value::exact(f64::NAN);
    let (by_mean, by_var) = if several {
        (
            inputs.value(mean_line.0, slope_error(&dark_mean, mean_line)),
            inputs.value(var_line.0, slope_error(&dark_var, var_line)),
        )
    } else {
        notes.push("u_I_mean, u_I_var: the dark current needs three exposures or more".into());
        (nothing.clone(), nothing.clone())
    };
    put("u_I_mean_DN", &by_mean, "DN/s");
    put("u_I_mean", &Value::of(&[&by_mean, &k], |v| v[0] / v[1]), "e/s");
    let sound = if by_var.value < 0.0 { &nothing } else { &by_var };
    if by_var.value < 0.0 {
        notes.push(format!(
            "u_I_var: the variance of the darks falls with the exposure ({:.4} ± {:.4} DN^2/s)",
            by_var.value,
            by_var.std_err()
        ));
    }
    put("u_I_var_DN", &Value::of(&[sound, &k], |v| v[0] / v[1]), "DN/s");
    put("u_I_var", &Value::of(&[sound, &k], |v| v[0] / (v[1] * v[1])), "e/s");

    match &points.spatial {
        Some(stacks) => nonuniformity(points.shape, stacks, &k, &mut inputs, &mut put, &mut notes),
        None => notes.push(
            "DSNU and PRNU: no set of more than two flats has darks of its exposure in more than two frames"
                .into(),
        ),
    }
    Ok(Evaluation { quantities: out, notes })
}

/// Where the temporal variance has its maximum, looked for from the brightest end: a single peak of the noise on the way up is passed over
/// (`Results1288.index_u_ysat`).
fn saturation(var_dn2: &[f64]) -> usize {
    let (mut most, mut at) = (0.0, 0);
    for i in (0..var_dn2.len()).rev() {
        let before = var_dn2[if i == 0 { 1.min(var_dn2.len() - 1) } else { i - 1 }];
        if var_dn2[i] >= most || before >= most {
            (most, at) = (var_dn2[i], i);
        } else {
            break;
        }
    }
    at
}

/// Relative deviations from the line fitted with weights 1 / y^2, per cent.
fn linearity(x: &[f64], y: &[f64]) -> Vec<f64> {
    let sum = |f: &dyn Fn(f64, f64) -> f64| x.iter().zip(y).map(|(x, y)| f(*x, *y)).sum::<f64>();
    let (xy, xy2, x2y2) = (sum(&|x, y| x / y), sum(&|x, y| x / (y * y)), sum(&|x, y| (x / y).powi(2)));
    let (y1, y2) = (sum(&|_, y| 1.0 / y), sum(&|_, y| 1.0 / (y * y)));
    let offset = (xy * xy2 - x2y2 * y1) / (xy2 * xy2 - x2y2 * y2);
    let slope = (xy - offset * xy2) / x2y2;
    x.iter().zip(y).map(|(x, y)| 100.0 * (y - (slope * x + offset)) / (slope * x + offset)).collect()
}

/// DSNU and PRNU with their rows, columns and pixels (`Results1288.s_2_y_col` and its neighbours, release 4.0 eq. 36 to 41).
fn nonuniformity(
    (rows, columns): (usize, usize),
    stacks: &[Spatial; 2],
    k: &Value,
    inputs: &mut Inputs,
    put: &mut dyn FnMut(&str, &Value, &'static str),
    notes: &mut Vec<String>,
) {
    let (m, n) = (rows as f64, columns as f64);
    let free = m * n - m - n;
    let mut variances = Vec::new();
    for (stack, name) in stacks.iter().zip(["", "_dark"]) {
        let measured = stack.measured_var_dn2;
        // Variances of m n values, of n column means and of m row means.
        let measured_value = inputs.value(measured, measured * (2.0 / (m * n)).sqrt());
        let with_noise = |v: f64, across: f64| v + stack.stack_var_dn2 / (stack.frames * across);
        let columns_value =
            inputs.value(stack.columns_var_dn2, with_noise(stack.columns_var_dn2, m) * (2.0 / n).sqrt());
        let rows_value =
            inputs.value(stack.rows_var_dn2, with_noise(stack.rows_var_dn2, n) * (2.0 / m).sqrt());
        let temporal = stack.stack_var_dn2 / stack.frames;
        let whole = Value::of(&[&measured_value], |v| v[0] - temporal);
        let all = [&whole, &columns_value, &rows_value];
        let column = Value::of(&all, |v| (m * n - m) / free * v[1] - n / free * (v[0] - v[2]));
        let row = Value::of(&all, |v| (m * n - n) / free * v[2] - m / free * (v[0] - v[1]));
        let pixel = Value::of(&all, |v| m * n / free * (v[0] - v[1] - v[2]));
        let stack_value = inputs
            .value(stack.stack_var_dn2, stack.stack_var_dn2 * (2.0 / (m * n * (stack.frames - 1.0))).sqrt());
        for (part, value) in [
            ("sigma_2_y_stack", &stack_value),
            ("s_2_y_measured", &measured_value),
            ("s_2_y", &whole),
            ("s_2_y_cav", &columns_value),
            ("s_2_y_rav", &rows_value),
            ("s_2_y_col", &column),
            ("s_2_y_row", &row),
            ("s_2_y_pixel", &pixel),
        ] {
            put(&format!("{part}{name}"), value, "DN^2");
        }
        variances.push([whole, column, row, pixel]);
    }
    let light = stacks[0].mean_dn - stacks[1].mean_dn;
    for (i, part) in ["", "_col", "_row", "_pixel"].into_iter().enumerate() {
        let (bright, dark) = (&variances[0][i], &variances[1][i]);
        let root = |v: f64| if v < 0.0 { f64::NAN } else { v.sqrt() };
        put(&format!("DSNU1288{part}"), &Value::of(&[dark, k], |v| root(v[0]) / v[1]), "e");
        if i == 0 {
            put("DSNU1288_DN", &Value::of(&[dark], |v| root(v[0])), "DN");
        }
        put(
            &format!("PRNU1288{part}"),
            &Value::of(&[bright, dark], |v| 100.0 * root(v[0] - v[1]) / light),
            "%",
        );
        if dark.value < 0.0 {
            notes.push(format!(
                "DSNU1288{part}: the spatial variance of the darks is {:.5} ± {:.5} DN^2: no more than their noise",
                dark.value,
                dark.std_err()
            ));
        }
        if bright.value < dark.value {
            notes.push(format!("PRNU1288{part}: the flats vary no more than the darks"));
        }
    }
}
