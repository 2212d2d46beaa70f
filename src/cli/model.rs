//! `radcam model`

use anyhow::{Context, Result, bail};
use radcam_sim::Model;
use radcam_sim::effects::{self, Effect};
use std::path::Path;

/// The effects of a model file, with their values.
pub fn read_effects(path: Option<&Path>) -> Result<Vec<(&'static dyn Effect, Vec<f64>)>> {
    let Some(path) = path else { return Ok(Vec::new()) };
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let model = Model::from_toml(&text).with_context(|| path.display().to_string())?;
    let mut out = Vec::new();
    for e in &model.effects {
        let Some(effect) = effects::find(&e.id) else { bail!("{}: no effect \"{}\"", path.display(), e.id) };
        out.push((effect, e.values(effect)));
    }
    Ok(out)
}
