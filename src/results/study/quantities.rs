//! Quantities of a report with unit, error and method of computation.

use super::{Images, Judgement};
use crate::calibrate::file::Calibration;
use crate::inference::Fitted;
use crate::noise::NoiseReport;
use crate::number::Quantity;
use crate::observables::Observations;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Quantity with its method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reported {
    /// Short name of the quantity.
    #[serde(skip_deserializing, default)]
    pub name: &'static str,
    /// Value, standard error, unit.
    #[serde(flatten)]
    pub quantity: Quantity,
    /// Method of computation.
    pub how: String,
}

/// Returns the model in equations: the paper's, and one line for every effect.
pub fn model(fitted: Option<&Fitted>) -> Vec<String> {
    let mut out = vec![
        "mean: μ = A (K I + E_DC) + offset, I = light · exposure (Healey and Kondepudy 1994, eq. 6)"
            .to_string(),
        "temporal variance: σ² = A² (K I + E_DC) + σ_C², σ_C² = A² σ_R² + q²/12 (eq. 12, 26, 27)".to_string(),
    ];
    for (effect, _) in fitted.iter().flat_map(|f| &f.effects) {
        out.push(format!("{}: {}", effect.id(), effect.page().equation));
    }
    out
}

/// Returns the parameters of the effects of the last model.
pub fn parameters(j: &Judgement) -> Vec<(String, Vec<(String, Quantity)>)> {
    let found: Vec<_> = j
        .missing
        .iter()
        .filter(|m| !m.parameters.is_empty())
        .map(|m| (m.effect.clone(), m.parameters.clone().into_iter().collect()))
        .collect();
    let Some(fitted) = &j.fitted else { return found };
    let given = fitted.effects.iter().zip(&fitted.std_err);
    let given = given.filter(|((e, _), _)| j.missing.iter().all(|m| m.effect != e.id()));
    given
        .map(|((e, values), errors)| {
            let all = e.parameters().iter().zip(values).zip(errors);
            let of = |((p, v), error): ((&radcam_sim::effects::Parameter, &f64), &f64)| {
                (p.name.to_string(), Quantity::new(*v, *error, p.unit))
            };
            (e.id().to_string(), all.map(of).collect())
        })
        .chain(found.clone())
        .collect()
}

/// Returns all quantities by their JSON name.
pub fn all(
    all: &Observations,
    j: &Judgement,
    noise: Option<&NoiseReport>,
    images: &Images,
    calibration: Option<&Calibration>,
) -> BTreeMap<&'static str, Reported> {
    let mut out = BTreeMap::new();
    let mut put = |id: &'static str, name: &'static str, quantity: Quantity, how: String| {
        if quantity.value.is_finite() {
            out.insert(id, Reported { name, quantity, how });
        }
    };
    if let Some(f) = &j.fitted {
        let effects: Vec<&str> = f.effects.iter().map(|(e, _)| e.id()).collect();
        let with = if effects.is_empty() {
            "fit of the linear sensor to all statistics".to_string()
        } else {
            format!("fit of the linear sensor with {} to all statistics", effects.join(", "))
        };
        let (b, e) = (&f.base, &f.base_std_err);
        put("gain_dn_per_e", "system gain A", Quantity::new(b.gain_dn_per_e, e[0], "DN/e"), with.clone());
        put("read_noise_e", "read noise", Quantity::new(b.read_noise_e, e[1], "e"), with.clone());
        put(
            "offset_dn",
            "black level at zero exposure",
            Quantity::new(b.offset_dn, e[2], "DN"),
            with.clone(),
        );
        if e[3] > 0.0 && !all.light_leaks_into_darks() {
            put("dark_current_e_per_s", "dark current", Quantity::new(b.dark_e_per_s, e[3], "e/s"), with);
        }
    }
    if let Some(n) = noise {
        let used = n.levels.iter().filter(|l| l.used).count();
        let how = format!("line through {used} levels of mean and variance, {} (Section IV)", method(n));
        put("noise_gain_dn_per_e", "system gain A, photon transfer", n.gain_dn_per_e.clone(), how.clone());
        put("constant_noise_var_dn2", "constant noise σ_C²", n.constant_noise_var_dn2.clone(), how.clone());
        put(
            "noise_read_noise_e",
            "read noise, photon transfer",
            n.read_noise_e.clone(),
            format!("{how}, eq. 27"),
        );
        let top = n.levels.iter().filter(|l| l.used && l.mean_dn > 0.0 && l.var_dn2 > 0.0);
        let snr = |l: &crate::noise::LevelReport| {
            let snr = l.mean_dn / l.var_dn2.sqrt();
            (snr, 0.5 * snr * l.var_std_err_dn2 / l.var_dn2)
        };
        if let Some((value, error)) = top.map(snr).max_by(|a, b| a.0.total_cmp(&b.0)) {
            let how = "largest mean over temporal noise of the levels on the line".to_string();
            put("snr_max", "largest signal-to-noise ratio", Quantity::new(value, error, "1"), how);
        }
    }
    if let Some(map) = &images.dark {
        let (value, error) = map.nonuniformity();
        let how = format!(
            "spread of the dark image by the median absolute deviation, its noise taken off ({})",
            map.of
        );
        put("dark_nonuniformity_dn", "dark nonuniformity", Quantity::new(value, error, "DN"), how);
    }
    if let Some(map) = &images.response {
        let (value, error) = map.nonuniformity();
        let light = if calibration.is_some() { "" } else { "; the light's own nonuniformity is in it" };
        let how = format!(
            "spread of the response by the median absolute deviation, its noise taken off ({}){light}",
            map.of
        );
        let name = "response nonuniformity";
        put("response_nonuniformity_percent", name, Quantity::new(100.0 * value, 100.0 * error, "%"), how);
    }
    if let Some(cal) = calibration {
        let how = "hot, dead and unstable pixels of the calibration".to_string();
        put("defects", "defective pixels", Quantity::new(cal.description.defects as f64, f64::NAN, "1"), how);
    }
    for (id, name, c) in [
        ("error", "error of the model as given", j.comparisons.first()),
        ("error_after", "error with what was found", j.comparisons.get(1)),
    ] {
        let Some(c) = c else { continue };
        let n = c.residuals.len();
        let how =
            format!("RMS of {n} standardised residuals on frames that the fit did not see; 1 is agreement");
        // Relative error of the RMS of n normal numbers: 1 / sqrt(2 n).
        put(id, name, Quantity::new(c.error, c.error / (2.0 * n as f64).sqrt(), "1"), how);
    }
    let sets = all.campaign.sets.len() as f64;
    put("sets", "sets of frames", Quantity::new(sets, f64::NAN, "1"), "counted".into());
    out
}

fn method(n: &NoiseReport) -> &'static str {
    n.estimators
        .iter()
        .find(|e| e.gain_dn_per_e.value == n.gain_dn_per_e.value)
        .map_or("reweighted", |e| e.method.name())
}
