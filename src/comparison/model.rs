//! Model files in a comparison: effects that one gives, and a model with fitted values; files of the user's
//! own effects.

use crate::dataset::CameraInfo;
use crate::inference::{Fitted, Given};
use crate::observables::Observations;
use radcam_sim::ModelError;
use radcam_sim::effects::{Effect, OwnEffect, find};
use radcam_sim::{EffectValues, Model};
use std::path::{Path, PathBuf};

/// Returns the effects of a list, with their given values.
///
/// # Errors
///
/// An effect that is not known, or a formula that cannot be understood.
pub fn given<'e>(effects: impl IntoIterator<Item = &'e EffectValues>) -> Result<Vec<Given>, ModelError> {
    let of = |e: &EffectValues| {
        let effect = e.effect()?;
        Ok((effect, e.given(effect)))
    };
    effects.into_iter().map(of).collect()
}

/// Returns the effects of a model as a fit takes them. Values that an earlier fit found, and which therefore
/// have an error, are searched for anew, choices included. Values that the user has given are kept, as are
/// the starts of a formula of the user's own.
///
/// # Errors
///
/// As [`given`].
pub fn to_be_fitted(model: &Model) -> Result<Vec<Given>, ModelError> {
    let of = |e: &EffectValues| {
        let mut e = e.clone();
        if find(&e.id).is_some() {
            let found = &e.std_err;
            e.parameters.retain(|name, _| !found.contains_key(name));
        }
        e
    };
    given(&model.effects.iter().map(of).collect::<Vec<_>>())
}

/// Returns the page of an effect as JSON: description, signature, remedy, parameters.
pub fn page(e: &dyn Effect) -> serde_json::Value {
    let page = e.page();
    let parameters: Vec<_> = e
        .parameters()
        .iter()
        .map(|p| serde_json::json!({ "name": p.name, "min": p.min, "max": p.max, "unit": p.unit }))
        .collect();
    serde_json::json!({
        "id": e.id(), "stage": format!("{:?}", e.stage()), "what": page.what, "equation": page.equation,
        "signature": page.signature, "look_alikes": page.look_alikes, "remedy": page.remedy,
        "measure": page.measure, "source": page.source, "parameters": parameters,
    })
}

/// Returns a model with the values of a fit. `camera`: source of its size and bit depth.
pub fn with_fit(mut model: Model, all: &Observations, fitted: &Fitted, camera: Option<&CameraInfo>) -> Model {
    if let Some(camera) = camera {
        (model.camera.width, model.camera.height) = (camera.width as u32, camera.height as u32);
        model.camera.bit_depth = camera.bit_depth.max(2);
    }
    let base = &fitted.base;
    model.base.gain_dn_per_e = base.gain_dn_per_e;
    model.base.read_noise_e = base.read_noise_e;
    // The fitted spread is that of all pixels, noisy ones included, under a log-normal read noise (Johnson,
    // Kotz and Balakrishnan 1994, ch. 14).
    let pixels = all.pixel_noise.filter(|p| p.log_spread.is_finite());
    model.base.read_noise_log_spread =
        pixels.map_or(0.5 * base.read_noise_spread.max(0.0).ln_1p().sqrt(), |p| p.log_spread).min(2.0);
    (model.base.noisy_pixel_fraction, model.base.noisy_pixel_factor) = (0.0, 0.0);
    model.base.black_level_dn = base.offset_dn.max(0.0);
    model.base.dark_current_e_per_s = base.dark_e_per_s.max(0.0);
    let unit = all.campaign.sets.iter().filter(|s| s.light.is_some());
    let near = unit.min_by(|a, b| (a.illumination - 1.0).abs().total_cmp(&(b.illumination - 1.0).abs()));
    if let Some(set) = near
        && let Some(flux) = set.light.and_then(|l| base.flux_e_per_s.get(l))
        && model.base.quantum_efficiency > 0.0
    {
        model.bench.photon_flux_per_s = flux / model.base.quantum_efficiency / set.illumination.max(1e-9);
    }
    model.effects = fitted
        .effects
        .iter()
        .zip(&fitted.std_err)
        .map(|((e, values), errors)| {
            let named =
                |v: &[f64]| e.parameters().iter().zip(v).map(|(p, v)| (p.name.to_string(), *v)).collect();
            let sound: Vec<f64> = errors.iter().map(|e| if e.is_finite() { *e } else { 0.0 }).collect();
            let known = model.effects.iter().find(|k| k.id == e.id() || k.name.as_deref() == Some(e.id()));
            // Effects of formulas are written with them, so that the model can be read without its file.
            let known = known.filter(|k| !k.formulas.is_empty()).cloned();
            let known = known.or_else(|| e.written()).unwrap_or_else(|| EffectValues::new(e.id()));
            EffectValues { parameters: named(values), std_err: named(&sound), ..known }
        })
        .collect();
    model
}

/// Reads a file of a user's own effect.
///
/// # Errors
///
/// The file cannot be read, or a line, name, formula or bound (which is named) cannot be understood.
pub fn own_effect(path: &Path) -> Result<OwnEffect, ModelError> {
    let in_file = |e: String| ModelError::Effect(format!("{}: {e}", path.display()));
    let text = crate::input::settings(path).map_err(|e| in_file(e.to_string()))?;
    OwnEffect::from_toml(&text).map_err(in_file)
}

/// Registers the effects of a folder for the run of the program: models may name them, and a diagnosis tries
/// them too. Only files whose names end in `.toml` are read.
///
/// # Errors
///
/// The folder cannot be read, a file of it is no effect, or another effect has its name.
pub fn register_own_effects(folder: &Path) -> Result<Vec<String>, ModelError> {
    own_files(folder)?.iter().map(|path| register_own_effect(path)).collect()
}

/// Registers the effect of a file for the run of the program, and returns its name.
///
/// # Errors
///
/// The file is no effect, or another effect has its name.
pub fn register_own_effect(path: &Path) -> Result<String, ModelError> {
    let own = own_effect(path)?;
    let taken = |e: String| {
        ModelError::Effect(format!(
            "{}: {e}; give this one another name, or move the file away",
            path.display()
        ))
    };
    own.register().map_err(taken)?;
    Ok(own.name)
}

/// Returns true if a file is an effect by its name, which ends in `.toml` and does not begin with a dot (side
/// files of macOS do).
pub fn is_own_file(path: &Path) -> bool {
    let name = path.file_name().map(|n| n.to_string_lossy());
    name.is_some_and(|n| n.ends_with(".toml") && !n.starts_with('.'))
}

/// Lists the files of a folder that are effects by their names, in order of name.
///
/// # Errors
///
/// The folder cannot be read.
pub fn own_files(folder: &Path) -> Result<Vec<PathBuf>, ModelError> {
    if !folder.is_dir() {
        return Err(ModelError::Effect(format!("there is no file or folder {}", folder.display())));
    }
    let of_folder = |e: std::io::Error| ModelError::Effect(format!("{}: {e}", folder.display()));
    let entries = std::fs::read_dir(folder).map_err(of_folder)?;
    let mut files: Vec<PathBuf> =
        entries.map(|entry| entry.map(|e| e.path())).collect::<Result<_, _>>().map_err(of_folder)?;
    files.retain(|path| is_own_file(path));
    files.sort();
    Ok(files)
}
