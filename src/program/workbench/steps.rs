//! Model on the desk with its history. Steps are stored in the dataset's folder: a reload, a second tab or a
//! restart loses nothing, and steps can be undone.

use crate::dataset::write_whole;
use radcam_sim::{EffectValues, Model, ModelError};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Name and major version of the file format.
const FORMAT: &str = "radcam-workbench/1";

/// Effect of the model with its switch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// True if the effect is in the model.
    pub on: bool,
    /// Effect and its values.
    pub effect: EffectValues,
}

impl Entry {
    /// Returns the identifier, or the name of the user's own effect.
    pub fn name(&self) -> &str {
        self.effect.called()
    }
}

/// State of the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Description of the change.
    pub what: String,
    /// Error on held-out frames.
    pub error: f64,
    /// p-value of the residuals.
    pub p_value: f64,
    /// Effects of the model.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub entries: Vec<Entry>,
}

impl Step {
    /// Iterates over the effects that are switched on.
    pub fn on(&self) -> impl Iterator<Item = &EffectValues> {
        self.entries.iter().filter(|e| e.on).map(|e| &e.effect)
    }
}

/// Contents of the steps file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Steps {
    format: String,
    /// Steps, the model as given first.
    #[serde(default)]
    pub step: Vec<Step>,
}

impl Default for Steps {
    fn default() -> Self {
        Self { format: FORMAT.into(), step: Vec::new() }
    }
}

/// Calibration by the pixels' own response, and flat-field correction, in the workbench folder.
pub const CALIBRATION: &str = "cal.tiff";
pub const FLAT_FIELD: &str = "flat-field.tiff";

/// Returns the workbench folder of a dataset: inside a dataset folder, beside a dataset file.
pub fn folder_of(dataset: &Path) -> PathBuf {
    if dataset.is_file() { dataset.with_extension("workbench") } else { dataset.join("workbench") }
}

impl Steps {
    /// Reads the steps stored in a folder; empty if there are none.
    ///
    /// # Errors
    ///
    /// The file is invalid; the message names it.
    pub fn read(folder: &Path) -> Result<Self, String> {
        let path = folder.join("steps.toml");
        let text = match crate::input::settings(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Self::default()),
            Err(e) => return Err(format!("{}: {e}", path.display())),
        };
        let fault = |message: String| format!("{}: {message}; move it away to begin anew", path.display());
        let steps: Self =
            toml::from_str(&text).map_err(|e| fault(crate::input::echo_lines(&e.to_string())))?;
        if steps.format != FORMAT {
            return Err(fault(format!("format \"{}\" is not {FORMAT}", steps.format)));
        }
        for entry in steps.step.iter().flat_map(|s| &s.entries) {
            entry.effect.check().map_err(|e| fault(e.to_string()))?;
        }
        Ok(steps)
    }

    /// Writes the steps, and the effects that are on as a model file, with which `radcam compare` gives the
    /// same error.
    ///
    /// # Errors
    ///
    /// The folder cannot be written.
    pub fn write(&self, folder: &Path, model: &Model) -> Result<(), String> {
        let fault = |e: &dyn std::fmt::Display| format!("{} cannot be kept: {e}", folder.display());
        crate::output::folder(folder).map_err(|e| fault(&e))?;
        let text = toml::to_string(self).map_err(|e| fault(&e))?;
        write_whole(&folder.join("steps.toml"), text.as_bytes()).map_err(|e| e.to_string())?;
        let text = model.to_toml().map_err(|e| fault(&e))?;
        write_whole(&folder.join("model.toml"), text.as_bytes()).map_err(|e| e.to_string())
    }

    /// Returns the current step.
    pub fn now(&self) -> Option<&Step> {
        self.step.last()
    }
}

/// Parses the user's own effect from typed text: a name, its target, the formula, and its parameters as
/// `k = 0.1, b = 2`.
///
/// # Errors
///
/// The text is invalid.
pub fn own(name: &str, target: &str, formula: &str, parameters: &str) -> Result<EffectValues, ModelError> {
    let fault = |text: String| ModelError::Effect(text);
    let mut e = EffectValues { id: "custom".into(), name: Some(name.trim().into()), ..Default::default() };
    if name.trim().is_empty() {
        return Err(fault("give the effect a name".into()));
    }
    e.formulas.insert(target.into(), formula.trim().into());
    for part in parameters.split([',', ';']).filter(|p| !p.trim().is_empty()) {
        let (name, value) =
            part.split_once('=').ok_or_else(|| fault(format!("write {} as name = value", part.trim())))?;
        let value: f64 =
            value.trim().parse().map_err(|_| fault(format!("\"{}\" is not a number", value.trim())))?;
        e.parameters.insert(name.trim().into(), value);
    }
    e.effect()?;
    Ok(e)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_kept_is_read_again_and_rubbish_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let model = radcam_sim::sensors::load("cmos12").unwrap();
        let mut steps = Steps::read(folder.path()).unwrap();
        let effect = own("extra", "variance", "k * mu", "k = 0.1").unwrap();
        let entries = vec![Entry { on: true, effect }];
        steps.step.push(Step { what: "added extra".into(), error: 1.0 / 3.0, p_value: 0.5, entries });
        steps.write(folder.path(), &model).unwrap();
        assert_eq!(Steps::read(folder.path()).unwrap(), steps);
        std::fs::write(folder.path().join("steps.toml"), "format = \"other/2\"").unwrap();
        assert!(Steps::read(folder.path()).unwrap_err().contains("other/2"));
        for (effect, said) in [
            (
                "id = \"illumination-flicker\"\nparameters = { rel = nan }",
                "effect illumination-flicker: rel is NaN, and",
            ),
            (
                "id = \"illumination-flicker\"\nparameters = { rel = -1.0 }",
                "rel is -1, and must lie within 0 to 0.71;",
            ),
            ("id = \"ghosts\"", "ghosts"),
        ] {
            let text = format!(
                "format = \"{FORMAT}\"\n[[step]]\nwhat = \"a\"\nerror = 1.0\np_value = 0.5\n\
                 [[step.entries]]\non = true\n[step.entries.effect]\n{effect}"
            );
            std::fs::write(folder.path().join("steps.toml"), text).unwrap();
            let refused = Steps::read(folder.path()).unwrap_err();
            assert!(refused.contains(said) && refused.contains("steps.toml"), "{refused}");
        }
        for (name, formula, parameters) in
            [("", "k*mu", "k=1"), ("a", "k *", "k=1"), ("a", "k*mu", "k"), ("a", "k*mu", "k=x")]
        {
            assert!(own(name, "variance", formula, parameters).is_err(), "{name} {formula} {parameters}");
        }
    }
}
