//! Settings shared by all frames of a dataset: contradicting headers are refused, settings that only
//! some state are noted.

use super::{Found, ImportError, few, names};
use crate::features::same_value;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Refuses frames that were corrected or combined before they were saved.
pub fn raw_frames(found: &[Found]) -> Result<(), ImportError> {
    let said: Vec<(String, &str)> = found
        .iter()
        .filter_map(|f| Some((f.path.display().to_string(), f.facts.processed.as_deref()?)))
        .collect();
    let Some((first, why)) = said.first() else { return Ok(()) };
    let mut paths: Vec<&String> = said.iter().map(|(path, _)| path).collect();
    paths.dedup();
    let more = match paths.len() {
        1 => String::new(),
        n => format!(" ({n} files say such a thing)"),
    };
    Err(ImportError::Files(format!(
        "{first}: {why}{more}; radcam measures the noise of single raw frames, so import those"
    )))
}

/// Returns a setting in the terms of its source.
fn word(frame: &Found, name: &str) -> String {
    let from = frame.facts.from.get(name).map_or(name, String::as_str);
    let keyword = from.split(' ').next().unwrap_or(from);
    let of_header = !keyword.is_empty() && from != names::NAME && !from.starts_with("the folder");
    match (of_header, name) {
        (true, _) => keyword.to_string(),
        (_, "GainRaw") => "gain".into(),
        (_, "BlackLevelRaw") => "black level".into(),
        (_, "BinningHorizontal" | "BinningVertical") => "binning".into(),
        _ => name.to_string(),
    }
}

/// Settings of all frames, and notes on them.
pub struct Shared {
    /// Settings by name.
    pub features: BTreeMap<String, toml::Value>,
    /// Notes, as sentences.
    pub notes: Vec<String>,
}

/// Refuses frames whose headers or names state different cameras or settings.
pub fn shared(found: &[Found]) -> Result<Shared, ImportError> {
    let of = |f: &Found| {
        let text = |name: &str, v: &Option<String>| v.clone().map(|v| (name.to_string(), v));
        let facts = &f.facts;
        let mut all: Vec<(String, String)> = [("vendor", &facts.vendor), ("model", &facts.model)]
            .into_iter()
            .chain([("serial", &facts.serial)])
            .filter_map(|(name, v)| text(name, v))
            .collect();
        all.extend(facts.differs.iter().cloned());
        // A pedestal is added to corrected frames only: a missing one equals 0.
        if found.iter().any(|f| f.facts.feature("PEDESTAL").is_some()) && facts.feature("PEDESTAL").is_none()
        {
            all.push(("PEDESTAL".into(), "0".into()));
        }
        // A TIFF without the tag has its first pixel at the upper left.
        let turned = super::headers::ORIENTATION;
        if found.iter().any(|f| f.facts.feature(turned).is_some()) && facts.feature(turned).is_none() {
            all.push((turned.into(), "1".into()));
        }
        all
    };
    let mut said: BTreeMap<String, (String, PathBuf, usize)> = BTreeMap::new();
    for frame in found {
        for (name, value) in of(frame) {
            let (first, path, count) =
                said.entry(name.clone()).or_insert_with(|| (value.clone(), frame.path.clone(), 0));
            *count += 1;
            if !same_value(first, &value) {
                let word = match name.as_str() {
                    "vendor" | "model" | "serial" => name.clone(),
                    _ => word(frame, &name),
                };
                return Err(ImportError::Files(format!(
                    "{} has {word} {value}, and {} has {first}; a dataset is of one camera under one set of \
                     settings, so import each by itself",
                    frame.path.display(),
                    path.display()
                )));
            }
        }
    }
    let partial: Vec<String> = said
        .iter()
        .filter(|(_, (_, _, count))| *count < found.len())
        .map(|(name, (value, _, count))| format!("{name} ({value}) by {count} of {}", found.len()))
        .collect();
    let mut notes = Vec::new();
    if !partial.is_empty() {
        notes.push(format!(
            "not every frame states these settings, and the others are taken to be alike: {}",
            few(&partial)
        ));
    }
    let features = said
        .into_iter()
        .filter(|(name, _)| !matches!(name.as_str(), "vendor" | "model" | "serial"))
        .map(|(name, (value, ..))| (name, super::facts::feature_value(&value)))
        .collect();
    Ok(Shared { features, notes })
}

/// Maximum difference of sensor temperatures under one cooler setting, kelvin.
pub const SAME_TEMPERATURE_K: f64 = 2.5;

/// Returns the temperature of a frame: the set point if stated, else the measured one.
pub fn temperature_c(frame: &Found) -> Option<f64> {
    frame.facts.set_temperature_c.or(frame.facts.temperature_c)
}

/// Groups temperatures, each group as (lowest, highest): neighbours within a group are close.
pub fn temperatures(found: &[Found]) -> Vec<(f64, f64)> {
    let mut all: Vec<f64> = found.iter().filter_map(temperature_c).collect();
    all.sort_by(f64::total_cmp);
    let mut out: Vec<(f64, f64)> = Vec::new();
    for t in all {
        match out.last_mut() {
            Some((_, high)) if t - *high <= SAME_TEMPERATURE_K => *high = t,
            _ => out.push((t, t)),
        }
    }
    out
}
