//! Virtual cameras that come with the crate: one TOML file each, and one line here.

use crate::model::{Model, ModelError};

/// Name and text of every sensor.
pub const ALL: &[(&str, &str)] = &[
    ("xc77", include_str!("xc77.toml")),
    ("cmos12", include_str!("cmos12.toml")),
    ("ccd16", include_str!("ccd16.toml")),
];

/// The text of a sensor, or `None` where there is none of that name.
pub fn get(name: &str) -> Option<&'static str> {
    ALL.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// Reads a sensor of the catalogue.
///
/// # Errors
///
/// Where there is no sensor of this name.
pub fn load(name: &str) -> Result<Model, ModelError> {
    let text = get(name).ok_or_else(|| {
        let names: Vec<_> = ALL.iter().map(|(known, _)| *known).collect();
        ModelError::Syntax(format!("no sensor \"{name}\"; there are {}", names.join(", ")))
    })?;
    Model::from_toml(text)
}
