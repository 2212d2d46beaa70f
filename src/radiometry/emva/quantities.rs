//! Quantities, computed from the points.

use super::general::{General, general};
use super::lines::{
    FIT_RANGE, UNDERFLOW, dark_lines, distinct, fitted_points, linear_range, noise_std, of_variance,
    signal_std, transfer_lines, underflow, with_flats,
};
use super::points::{Dark, Points, Temporal};
use super::saturation::{self, Saturation};
use super::spatial::{Variances, filtered, variances};
use super::spline::Spline;
use super::value::{Inputs, Value};
use super::{Definitions, EmvaError};
use crate::agreement::Agreement;
use crate::data_faults::DataFault;
use crate::noise::NoiseReport;
use crate::number::Quantity;
use crate::statistics::outliers;
use crate::statistics::quantisation::{QUANTISATION_DN2, SMALLEST_DARK_DN2};
use radcam_sim::rng::{PixelRng, Stream};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Minimum number of samples that stand far off, over the pixels of a frame, for a note (a named choice): one
/// at full scale in 10,000 pixels doubles the variance of a pair.
const MIN_STRUCK_SHARE: f64 = 1e-4;

/// Minimum difference of two gains that is reported, relative, and in standard errors (named choices).
const MIN_OFF: f64 = 0.01;
const MIN_SIGMA: f64 = 4.0;

/// Bound that a quantity is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Limit {
    /// Upper bound: the quantity is no more than the value.
    AtMost,
    /// Lower bound: the quantity is no less than the value.
    AtLeast,
}

/// Gain by `radcam noise`: Section IV of Healey and Kondepudy on all frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct GainByNoise {
    /// Gain A, called K in the standard.
    pub gain: Quantity,
    /// Read noise.
    pub read_noise: Quantity,
    /// Chi-square of the line.
    #[serde(with = "crate::number::finite")]
    pub chi2: f64,
    /// Degrees of freedom of chi-square.
    pub dof: usize,
    /// Probability of a larger chi-square.
    #[serde(with = "crate::number::finite")]
    pub q: f64,
    /// Agreement of the levels with the line.
    pub line: Agreement,
}

impl From<&NoiseReport> for GainByNoise {
    fn from(report: &NoiseReport) -> Self {
        Self {
            line: report.agreement(),
            gain: report.gain_dn_per_e.clone(),
            read_noise: report.read_noise_e.clone(),
            chi2: report.chi2,
            dof: report.dof,
            q: report.q,
        }
    }
}

impl GainByNoise {
    /// Returns a note on the difference to K, if it is more than chance and matters.
    fn against(&self, k: &Value) -> Option<String> {
        let off = k.value / self.gain.value - 1.0;
        let std_err = (k.std_err() / k.value).hypot(self.gain.std_err / self.gain.value);
        (self.line == Agreement::Holds && off.abs() > MIN_OFF.max(MIN_SIGMA * std_err)).then(|| {
            format!(
                "K is {} % {} than the gain of `radcam noise`, whose line describes the variance of all frames: two frames at each exposure are \
                 more or less alike than others of their set, as under a lamp that flickers with the frames",
                crate::number::with_error(100.0 * off.abs(), 100.0 * std_err),
                if off > 0.0 { "larger" } else { "smaller" }
            )
        })
    }
}

/// Evaluation of a camera by EMVA 1288.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Evaluation {
    /// Source of the definitions.
    pub definitions: Definitions,
    /// Quantities by the reference tool's names; null where undefined, with a note on the reason.
    pub quantities: BTreeMap<String, Option<Quantity>>,
    /// Mean signal at saturation, or the largest signal, DN: gain and linearity use shares of it.
    pub saturation_signal_dn: f64,
    /// Quantities that are bounds.
    pub limits: BTreeMap<String, Limit>,
    /// Values of the reference tool that differ by its definition; null where it gives none.
    pub reference_tool: BTreeMap<String, Option<f64>>,
    /// General model of release 4.0, which assumes neither a linear camera nor raw data.
    pub general: Option<General>,
    /// Gain by `noise`; absent if it gives none, and with the reference tool's definitions.
    pub noise: Option<GainByNoise>,
    /// Faults of the data.
    #[serde(default)]
    pub data_faults: Vec<DataFault>,
    /// Notes for the reader.
    pub notes: Vec<String>,
}

/// Dark noise that the standard assumes if quantisation hides it, DN, and the limit of the noise without
/// quantisation, DN (eq. 54).
const HIDDEN_DARK_DN: f64 = 0.49;
const HIDDEN_NOISE_DN: f64 = 0.40;
/// Number of exposures that the standard asks for the dark current (section 7.1).
const DARK_EXPOSURES: usize = 6;

/// Evaluation under construction.
struct Sheet {
    inputs: Inputs,
    quantities: BTreeMap<String, Option<Quantity>>,
    limits: BTreeMap<String, Limit>,
    notes: Vec<String>,
}

impl Sheet {
    fn put(&mut self, name: &str, value: &Value, unit: &'static str) {
        let quantity = value.value.is_finite().then(|| Quantity::new(value.value, value.std_err(), unit));
        self.quantities.insert(name.to_string(), quantity);
    }

    fn note(&mut self, note: String) {
        self.notes.push(note);
    }
}

/// Evaluates the points.
///
/// ```no_run
/// use radcam::emva::{Definitions, evaluate, of_dataset};
/// let dataset = radcam::dataset::Dataset::open("EMVA1288_Data.txt".as_ref())?;
/// let points = of_dataset(&dataset, &Default::default(), &|_, _| {})?;
/// let evaluation = evaluate(&points, Definitions::Release4)?;
/// if let Some(Some(k)) = evaluation.quantities.get("K") {
///     println!("K = {k}"); // K = 0.2800(5) DN/e
/// }
/// # Ok::<(), radcam::emva::EmvaError>(())
/// ```
///
/// # Errors
///
/// If there are too few points for the fits of the standard.
pub fn evaluate(points: &Points, definitions: Definitions) -> Result<Evaluation, EmvaError> {
    let mut evaluation = by(points, definitions)?;
    if definitions != Definitions::ReferenceTool
        && let Ok(tool) = by(points, Definitions::ReferenceTool)
    {
        for (name, theirs) in tool.quantities {
            let value = |q: &Option<Quantity>| q.as_ref().map(|q| q.value);
            let (ours, theirs) = (evaluation.quantities.get(&name).and_then(value), value(&theirs));
            let same = match (ours, theirs) {
                (Some(a), Some(b)) => (a - b).abs() <= 1e-6 * b.abs(),
                (a, b) => a.is_none() && b.is_none(),
            };
            if !same {
                evaluation.reference_tool.insert(name, theirs);
            }
        }
    }
    Ok(evaluation)
}

fn by(points: &Points, definitions: Definitions) -> Result<Evaluation, EmvaError> {
    let as_tool = definitions == Definitions::ReferenceTool;
    let release4 = definitions == Definitions::Release4;
    let mut points = points.clone();
    if definitions == Definitions::Release31 {
        // Only release 4.0 subtracts the difference of the two means (appendix E.1, 4).
        let with_difference = |p: &mut super::Pair| p.var_dn2 += 0.5 * p.difference_dn * p.difference_dn;
        for p in &mut points.temporal {
            with_difference(&mut p.flat);
            with_difference(&mut p.dark);
        }
        points.darks.iter_mut().for_each(|d| with_difference(&mut d.pair));
    }
    let t = &points.temporal;
    let pixels = (points.shape.0 * points.shape.1) as f64;
    let mut sheet = Sheet {
        inputs: Inputs::default(),
        quantities: BTreeMap::new(),
        limits: BTreeMap::new(),
        notes: Vec::new(),
    };
    let calibration = (sheet.inputs.next(), points.light.irradiance_rel_std.unwrap_or(0.0));

    if points.struck as f64 > MIN_STRUCK_SHARE * pixels {
        sheet.note(format!(
            "{}. The standard takes all pixels as they are: variances, K and the nonuniformities contain them; noise and diagnose leave them out",
            outliers::in_words(points.struck)
        ));
    }

    if let Some(memory) = crate::noise::memory_in_words(points.carried_share) {
        sheet.note(format!(
            "{memory} The standard takes frames as independent: K is too low by what they share. `radcam diagnose` says by how much"
        ));
    }
    // Darks that are clipped at 0 DN show less than their noise, and shift every signal.
    let underflow = underflow(&points.darks);
    let clipped = !as_tool && underflow > UNDERFLOW;
    if clipped {
        sheet.note(format!(
            "sigma_y_dark, sigma_d, u_p_min, u_e_min, DR, DSNU and the dark current are undefined: {:.1} % of the samples of the darks are at 0 DN, \
             where the standard allows 0.5 % (section 6.5). Raise the black level. K and R are the slopes of lines with a free offset through \
             levels that are not cut off",
            100.0 * underflow
        ));
    }

    let saturated = if release4 {
        saturation::by_share(t, pixels, &mut sheet.inputs)
    } else {
        saturation::at_peak(t, &mut sheet.inputs)
    };
    let most = saturated.signal_dn();
    let at_saturation = match &saturated {
        Saturation::At { photons, note, .. } => {
            sheet.notes.extend(note.clone());
            photons.clone().scaled_by(calibration.0, calibration.1)
        }
        Saturation::Unknown { why, .. } => {
            sheet.note(format!("u_p_sat, u_e_sat, SNR_max and DR are undefined: {why}"));
            Value::undefined()
        }
    };

    let used = fitted_points(t, most, definitions, clipped)?;
    if release4 && used.iter().any(|p| p.signal_dn() > FIT_RANGE * most) {
        sheet.note(format!(
            "K and R are fitted to all {} levels: fewer than three lie below 70 % of the brightest, and none saturates",
            used.len()
        ));
    }
    let [k, r] = transfer_lines(&used, pixels, definitions, clipped);
    let k = sheet.inputs.value(k.slope, k.slope_std());
    let r = sheet.inputs.value(r.slope, r.slope_std()).scaled_by(calibration.0, -calibration.1);
    if definitions == Definitions::Release4 && (k.value <= 0.0 || k.value.is_nan()) {
        return Err(EmvaError::Missing(format!(
            "K is {} DN/e: the variance does not grow with the signal as photon noise does. Frames that were averaged, copied, compressed or \
             stretched do this, and an automatic gain",
            crate::number::with_error(k.value, k.std_err())
        )));
    }
    if k.value < 3.0 * k.std_err() {
        sheet.note(format!(
            "K is {} DN/e: no more than three of its standard errors. The variance does not grow with the signal as photon noise does",
            crate::number::with_error(k.value, k.std_err())
        ));
    }

    sheet.notes.extend(points.multiplied.map(|multiplied| multiplied.with_gain(k.value, k.std_err())));
    sheet.notes.extend(points.shared_noise.map(|shared| shared.in_words(k.value, k.std_err())));

    let dark = dark_noise(&points, definitions, clipped, pixels, &mut sheet);
    sensitivity(&points, definitions, &mut sheet, &k, &r, &dark, &at_saturation);
    linearity(t, most, definitions, pixels, &mut sheet);
    if points.data_faults.iter().any(DataFault::is_leak) {
        sheet.note("u_I_mean and u_I_var are undefined: light leaks into the darks, and is in their growth with the exposure".into());
    } else {
        dark_current(&points.darks, definitions, clipped, pixels, &mut sheet, &k);
    }
    nonuniformity(&points, definitions, clipped, &k, &mut sheet);
    if let Some(left_out) = &points.left_out {
        sheet.note(left_out.clone());
    }
    let by_noise = points.noise.clone().filter(|_| !as_tool);
    sheet.notes.extend(by_noise.as_ref().and_then(|noise| noise.against(&k)));
    if release4 {
        local_gains(&used, k.value, pixels, &mut sheet);
    }
    let general = if release4 { general(&points, &saturated) } else { None };
    if !points.photons_known {
        sheet.note(
            "R, QE, u_p_min and u_p_sat are undefined: the light is not in photons. Give [bench.light] in dataset.toml: photon_flux_per_s, or \
             irradiance_w_per_m2 with wavelength_nm and pixel_area_um2"
                .into(),
        );
    }
    let Sheet { quantities, limits, notes, .. } = sheet;
    Ok(Evaluation {
        definitions,
        quantities,
        saturation_signal_dn: most,
        limits,
        reference_tool: BTreeMap::new(),
        general,
        noise: by_noise,
        data_faults: points.data_faults.clone(),
        notes,
    })
}

/// Temporal variance of the darks, DN^2.
struct DarkNoise {
    var_dn2: Value,
    /// True if quantisation hides the noise: the value is a bound.
    hidden: bool,
}

/// Step of the converter, DN; 1 DN for the reference tool.
pub(super) fn step_dn(points: &Points, definitions: Definitions) -> f64 {
    if definitions == Definitions::ReferenceTool { 1.0 } else { points.code_step_dn }
}

fn dark_noise(
    points: &Points,
    definitions: Definitions,
    clipped: bool,
    pixels: f64,
    sheet: &mut Sheet,
) -> DarkNoise {
    let shortest = points.darks.first().map_or(f64::NAN, |d| d.pair.var_dn2);
    let (value, std_err) = match definitions {
        // Variance at the lowest exposure (section 6.6).
        Definitions::Release4 => (shortest, of_variance(shortest, pixels)),
        // Offset of the line of the variances against the exposure.
        _ => {
            let darks = with_flats(&points.darks);
            match dark_lines(&darks, pixels) {
                Some([_, variances]) => variances.at(0.0),
                None => {
                    let first = darks.first().map_or(f64::NAN, |d| d.pair.var_dn2);
                    (first, of_variance(first, pixels))
                }
            }
        }
    };
    if clipped {
        return DarkNoise { var_dn2: Value::undefined(), hidden: false };
    }
    let square = step_dn(points, definitions).powi(2);
    let smallest = SMALLEST_DARK_DN2 * square;
    let hidden = value < smallest;
    if !hidden {
        return DarkNoise { var_dn2: sheet.inputs.value(value, std_err), hidden };
    }
    sheet.note(format!(
        "sigma_y_dark: the temporal variance of the darks is {value:.4} DN², below {smallest} DN², where quantisation hides it. The standard \
         puts {} DN in its place: sigma_y_dark, sigma_d, u_p_min and u_e_min are upper limits, DR is a lower one",
        HIDDEN_DARK_DN * square.sqrt()
    ));
    for name in ["sigma_y_dark", "sigma_d", "u_p_min", "u_e_min", "u_p_min_area", "u_e_min_area"] {
        sheet.limits.insert(name.into(), Limit::AtMost);
    }
    for name in ["DR", "DR_dB"] {
        sheet.limits.insert(name.into(), Limit::AtLeast);
    }
    // The tool takes the root of 0.24 DN^2.
    let bound =
        if definitions == Definitions::ReferenceTool { smallest } else { HIDDEN_DARK_DN.powi(2) * square };
    DarkNoise { var_dn2: Value::exact(bound), hidden }
}

/// Computes gain, quantum efficiency, dark noise, threshold, saturation, SNR and dynamic range (section 6.6).
fn sensitivity(
    points: &Points,
    definitions: Definitions,
    sheet: &mut Sheet,
    k: &Value,
    r: &Value,
    dark: &DarkNoise,
    at_saturation: &Value,
) {
    let as_tool = definitions == Definitions::ReferenceTool;
    // Release 4.0 introduced the exact threshold (eq. 26; appendix E.1, 6).
    let half = if definitions == Definitions::Release4 { 0.25 } else { 0.0 };
    let threshold_e = move |dark_dn2: f64, k: f64| (dark_dn2 / (k * k) + half).sqrt() + 0.5;
    let d = &dark.var_dn2;
    let step = step_dn(points, definitions);
    let noise_dn = move |dark_dn2: f64| (dark_dn2 - QUANTISATION_DN2 * step * step).sqrt();
    let sigma_d = if dark.hidden && !as_tool {
        Value::of(&[k], |v| HIDDEN_NOISE_DN * step / v[0])
    } else {
        Value::of(&[d, k], |v| noise_dn(v[0]) / v[1])
    };
    let u_e_min = Value::of(&[d, k], |v| threshold_e(v[0], v[1]));
    let u_p_min = Value::of(&[d, k, r], |v| threshold_e(v[0], v[1]) * v[1] / v[2]);
    let u_e_sat = Value::of(&[at_saturation, r, k], |v| v[0] * v[1] / v[2]);
    let dr = Value::of(&[at_saturation, d, k, r], |v| v[0] / (threshold_e(v[1], v[2]) * v[2] / v[3]));
    let snr = Value::of(&[&u_e_sat], |v| v[0].sqrt());
    sheet.put("K", k, "DN/e");
    sheet.put("inverse_K", &Value::of(&[k], |v| 1.0 / v[0]), "e/DN");
    sheet.put("sigma_y_dark", &Value::of(&[d], |v| v[0].sqrt()), "DN");
    sheet.put("sigma_d", &sigma_d, "e");
    sheet.put("u_e_min", &u_e_min, "e");
    sheet.put("u_e_sat", &u_e_sat, "e");
    sheet.put("SNR_max", &snr, "1");
    sheet.put("SNR_max_dB", &Value::of(&[&snr], |v| 20.0 * v[0].log10()), "dB");
    sheet.put("SNR_max_bit", &Value::of(&[&snr], |v| v[0].log2()), "bit");
    sheet.put("inverse_SNR_max", &Value::of(&[&snr], |v| 100.0 / v[0]), "%");
    sheet.put("DR", &dr, "1");
    sheet.put("DR_dB", &Value::of(&[&dr], |v| 20.0 * v[0].log10()), "dB");
    let qe = Value::of(&[r, k], |v| 100.0 * v[0] / v[1]);
    let nothing = Value::undefined();
    let with_light = |v| if points.photons_known { v } else { &nothing };
    for (name, value, unit) in
        [("R", r, "DN/p"), ("QE", &qe, "%"), ("u_p_min", &u_p_min, "p"), ("u_p_sat", at_saturation, "p")]
    {
        sheet.put(name, with_light(value), unit);
    }
    if let Some(area) = points.light.pixel_area_um2 {
        let over_area = |v: &Value| Value::of(&[v], |v| v[0] / area);
        sheet.put("u_p_min_area", &over_area(with_light(&u_p_min)), "p/um^2");
        sheet.put("u_p_sat_area", &over_area(with_light(at_saturation)), "p/um^2");
        sheet.put("u_e_min_area", &over_area(&u_e_min), "e/um^2");
        sheet.put("u_e_sat_area", &over_area(&u_e_sat), "e/um^2");
    }
}

fn linearity(t: &[Temporal], most: f64, definitions: Definitions, pixels: f64, sheet: &mut Sheet) {
    let Some(fit) = linear_range(t, most, definitions) else {
        for name in ["LE", "LE_min", "LE_max"] {
            sheet.put(name, &Value::undefined(), "%");
        }
        sheet.note("LE is undefined: fewer than three exposures lie between 5 and 95 % of saturation".into());
        return;
    };
    let deviations: Vec<f64> = fit.levels.iter().map(|p| fit.deviation(p)).collect();
    let errors: Vec<f64> = fit.levels.iter().map(|p| 100.0 * signal_std(p, pixels) / p.signal_dn()).collect();
    let n = deviations.len() as f64;
    // Deviation and error of the level that is chosen.
    let of = |better: &dyn Fn(f64, f64) -> bool| {
        let mut at = 0;
        for (i, d) in deviations.iter().enumerate() {
            if better(*d, deviations[at]) {
                at = i;
            }
        }
        (deviations[at], errors[at])
    };
    let (least, greatest) = (of(&|a, b| a < b), of(&|a, b| a > b));
    // Release 4.0: mean of the magnitudes (eq. 63).
    let mean = deviations.iter().map(|d| d.abs()).sum::<f64>() / n;
    let mean_std = errors.iter().map(|e| e * e).sum::<f64>().sqrt() / n;
    if definitions != Definitions::ReferenceTool {
        let value = sheet.inputs.value(mean, mean_std);
        sheet.put("LE", &value, "%");
    }
    for (name, (value, std_err)) in [("LE_min", least), ("LE_max", greatest)] {
        let value = sheet.inputs.value(value, std_err);
        sheet.put(name, &value, "%");
    }
}

/// Computes the dark current from mean and variance (section 7.1).
fn dark_current(
    darks: &[Dark],
    definitions: Definitions,
    clipped: bool,
    pixels: f64,
    sheet: &mut Sheet,
    k: &Value,
) {
    let as_tool = definitions == Definitions::ReferenceTool;
    let darks = if as_tool { with_flats(darks) } else { darks.to_vec() };
    let lines = if clipped { None } else { dark_lines(&darks, pixels) };
    let exposures = distinct(&darks);
    if exposures < 3 && !clipped {
        sheet.note(format!(
            "u_I_mean and u_I_var are undefined: the dark current needs darks at three exposures or more, and there are {exposures}"
        ));
    } else if exposures < DARK_EXPOSURES && !as_tool && !clipped {
        sheet.note(format!(
            "the dark current is of {exposures} exposures; the standard wants six (section 7.1)"
        ));
    }
    let (by_mean, by_var) = match &lines {
        Some([means, variances]) => (
            sheet.inputs.value(means.slope, means.slope_std()),
            sheet.inputs.value(variances.slope, variances.slope_std()),
        ),
        None => (Value::undefined(), Value::undefined()),
    };
    if !as_tool && by_mean.value < -BELOW_ZERO * by_mean.std_err() {
        sheet.note(format!(
            "u_I_mean is below zero ({} DN/s): darks of long exposures have less than those of short ones. The camera's clamp takes off more than \
             the dark charge, the black level moved, or the stated exposures are not those of the darks",
            crate::number::with_error(by_mean.value, by_mean.std_err())
        ));
    }
    sheet.put("u_I_mean_DN", &by_mean, "DN/s");
    sheet.put("u_I_mean", &Value::of(&[&by_mean, k], |v| v[0] / v[1]), "e/s");
    // The standard reports a negative value too, with its error: an upper limit (section 7.1). The tool does
    // not.
    let by_var = if as_tool && by_var.value < 0.0 { Value::undefined() } else { by_var };
    if as_tool {
        sheet.put("u_I_var_DN", &Value::of(&[&by_var, k], |v| v[0] / v[1]), "DN/s");
    } else {
        sheet.put("u_I_var_DN", &by_var, "DN^2/s");
    }
    sheet.put("u_I_var", &Value::of(&[&by_var, k], |v| v[0] / (v[1] * v[1])), "e/s");
}

/// Minimum standard errors below zero at which a negative dark current is reported (a named choice).
const BELOW_ZERO: f64 = 3.0;

/// Shares of saturation at which a stack of flats gives PRNU: half, within a factor of two below and of one
/// and three quarters above (a named choice: noise and offsets contribute to dimmer ones, clipping to
/// brighter ones).
const HALF_OF_SATURATION: std::ops::RangeInclusive<f64> = 0.25..=0.875;

/// Minimum share of PRNU that is said to be missing under a lamp that flickers (a named choice).
const MAX_LACK: f64 = 0.02;

fn is_tool(definitions: Definitions) -> bool {
    definitions == Definitions::ReferenceTool
}

/// Computes DSNU and PRNU with their rows, columns and pixels (eq. 66 and 67).
fn nonuniformity(points: &Points, definitions: Definitions, clipped: bool, k: &Value, sheet: &mut Sheet) {
    let Some(stacks) = &points.spatial else {
        sheet.note(
            "DSNU and PRNU are undefined: no set of more than two flats has darks of its exposure in more than two frames".into(),
        );
        return;
    };
    let far = points.bright.filter(|b| !(HALF_OF_SATURATION.contains(&b.share()) || is_tool(definitions)));
    if let Some(bright) = &points.bright {
        let share = 100.0 * bright.share();
        let of = if bright.of > 1 {
            format!("nearest to half of saturation of {} stacks", bright.of)
        } else {
            "the only stack of flats with darks of its exposure".into()
        };
        let what = format!("set {} ({} frames, {share:.0} % of saturation), {of}", bright.set, bright.frames);
        sheet.note(if far.is_some() {
            format!(
                "PRNU is undefined: the standard has it at half of saturation, and the flats are of {what}; take a stack of flats and one of darks \
                 at half of saturation"
            )
        } else {
            format!("PRNU and DSNU are of {what}")
        });
    }
    let images = stacks.each_ref().map(super::Spatial::mean_image_dn);
    let light = images[0].mean().unwrap_or(f64::NAN) - images[1].mean().unwrap_or(f64::NAN);
    let mut both: Vec<Variances> = Vec::new();
    for (stack, image) in stacks.iter().zip(&images) {
        let (image, filter) = filtered(image, definitions);
        if filter != definitions.high_pass() && both.is_empty() {
            sheet.note(
                "DSNU and PRNU are of images without the high-pass filter, which is larger than they are"
                    .into(),
            );
        }
        both.push(variances(stack, &image, filter, definitions, &mut sheet.inputs));
    }
    for (v, name) in both.iter().zip(["", "_dark"]) {
        for (part, value) in [
            ("sigma_2_y_stack", &v.stack),
            ("s_2_y_measured", &v.measured),
            ("s_2_y", &v.whole),
            ("s_2_y_cav", &v.columns_of_means),
            ("s_2_y_rav", &v.rows_of_means),
            ("s_2_y_col", &v.column),
            ("s_2_y_row", &v.row),
            ("s_2_y_pixel", &v.pixel),
        ] {
            sheet.put(&format!("{part}{name}"), value, "DN^2");
        }
    }
    let root = |v: f64| if v < 0.0 { f64::NAN } else { v.sqrt() };
    let parts = |v: &Variances| [v.whole.clone(), v.column.clone(), v.row.clone(), v.pixel.clone()];
    let (bright, dark) = (parts(&both[0]), parts(&both[1]));
    for (i, part) in ["", "_col", "_row", "_pixel"].into_iter().enumerate() {
        let (bright, dark) = (&bright[i], &dark[i]);
        let nothing = Value::undefined();
        let of_dark = if clipped { &nothing } else { dark };
        sheet.put(&format!("DSNU1288{part}"), &Value::of(&[of_dark, k], |v| root(v[0]) / v[1]), "e");
        if i == 0 {
            sheet.put("DSNU1288_DN", &Value::of(&[of_dark], |v| root(v[0])), "DN");
        }
        let prnu = if far.is_some() {
            Value::undefined()
        } else {
            Value::of(&[bright, dark], |v| 100.0 * root(v[0] - v[1]) / light)
        };
        sheet.put(&format!("PRNU1288{part}"), &prnu, "%");
        // The noise that all pixels of a frame share is in the temporal variance, and not in the mean image.
        let shared_dn2 = stacks[0].frame_var_dn2 / stacks[0].frames as f64;
        let own = 100.0 * root(bright.value - dark.value + shared_dn2) / light;
        let is_right = prnu.value >= (1.0 - MAX_LACK) * own;
        if i == 0 && own.is_finite() && far.is_none() && !is_right {
            let set = points.bright.map_or_else(String::new, |b| format!(" of set {}", b.set));
            sheet.note(format!(
                "PRNU1288 is too low: the means of the frames{set} scatter by {:.2} % (a lamp that flickers), which the standard's formula (eq. 66) takes \
                 for noise of the pixels. Without that it is {own:.3} %; take the stack under a steady light, or more frames",
                100.0 * stacks[0].frame_var_dn2.sqrt() / light
            ));
        }
        let named = |v: &Value| format!("{} DN²", crate::number::with_error(v.value, v.std_err()));
        if dark.value < 0.0 && !clipped {
            sheet.note(format!(
                "DSNU1288{part} is undefined: the spatial variance of the darks is {}, no more than their noise",
                named(dark)
            ));
        }
        if bright.value < dark.value && far.is_none() {
            let difference = Value::of(&[bright, dark], |v| v[0] - v[1]);
            sheet.note(format!(
                "PRNU1288{part} is undefined: the flats vary no more than the darks, by {}",
                named(&difference)
            ));
        }
    }
}

/// Computes the standard's check of the photon transfer curve (eq. 51): mean deviation from K of the local
/// slopes of a cubic B-spline.
fn local_gains(used: &[Temporal], k: f64, pixels: f64, sheet: &mut Sheet) {
    let points: Vec<(f64, f64)> = used.iter().map(|p| (p.signal_dn(), p.noise_dn2())).collect();
    let end = points.iter().map(|p| p.0).fold(0.0, f64::max);
    // Six intervals for 35 levels below 70 % of saturation, as in the general model for 50.
    let deviation_of = |points: &[(f64, f64)]| -> Option<f64> {
        let spline =
            Spline::fit(points, end, (points.len() / 6).clamp(2, 6)).filter(|_| points.len() >= 9)?;
        let sum: f64 = points.iter().map(|p| (spline.at(p.0).1 / k - 1.0).abs()).sum();
        Some(100.0 * sum / points.len() as f64)
    };
    let deviation = deviation_of(&points).unwrap_or(f64::NAN);
    // Deviations that the noise of the variances alone gives a straight line; their mean is taken as the
    // error.
    let by_noise: Vec<f64> = (0..40)
        .filter_map(|draw| {
            let mut rng = PixelRng::new(51, Stream::Effect, draw, 0, 0);
            let straight = |p: &Temporal, rng: &mut PixelRng| {
                (p.signal_dn(), k * p.signal_dn() + noise_std(p, pixels) * rng.normal())
            };
            deviation_of(&used.iter().map(|p| straight(p, &mut rng)).collect::<Vec<_>>())
        })
        .collect();
    let expected = by_noise.iter().sum::<f64>() / by_noise.len().max(1) as f64;
    let value = sheet.inputs.value(deviation, expected);
    sheet.put("K_deviation", &value, "%");
    if deviation > 3.0 {
        let why = if deviation < 2.0 * expected {
            format!(
                "the noise of so few pixels alone makes {expected:.1} %: more pixels or exposures would tell"
            )
        } else {
            "the standard's linear model does not hold (eq. 51): use the general one. `radcam diagnose` looks for the reason".into()
        };
        sheet.note(format!(
            "K_deviation: the local slope of the photon transfer curve differs from K by {deviation:.1} % on average, more than 3 %; {why}"
        ));
    }
}
