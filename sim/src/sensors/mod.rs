//! Virtual cameras that come with the crate: one TOML file each, and one line here.

use crate::model::{Model, ModelError};

/// Name and text of every sensor.
pub const ALL: &[(&str, &str)] = &[
    ("xc77", include_str!("xc77.toml")),
    ("cmos12", include_str!("cmos12.toml")),
    ("ccd16", include_str!("ccd16.toml")),
    ("imx174", include_str!("imx174.toml")),
    ("imx178", include_str!("imx178.toml")),
    ("imx250", include_str!("imx250.toml")),
    ("imx252", include_str!("imx252.toml")),
    ("imx264", include_str!("imx264.toml")),
    ("imx273", include_str!("imx273.toml")),
    ("imx287", include_str!("imx287.toml")),
    ("imx392", include_str!("imx392.toml")),
    ("imx421", include_str!("imx421.toml")),
    ("imx547", include_str!("imx547.toml")),
    ("imx900", include_str!("imx900.toml")),
    ("imx900-hcg", include_str!("imx900-hcg.toml")),
    ("python1300", include_str!("python1300.toml")),
    ("python5000", include_str!("python5000.toml")),
    ("gmax2505", include_str!("gmax2505.toml")),
    ("cmv4000", include_str!("cmv4000.toml")),
];

/// Returns the text of a sensor, or `None` if there is none of that name.
pub fn get(name: &str) -> Option<&'static str> {
    ALL.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// Reads a sensor of the catalogue.
///
/// # Errors
///
/// There is no sensor of this name.
pub fn load(name: &str) -> Result<Model, ModelError> {
    let text = get(name).ok_or_else(|| {
        let names: Vec<_> = ALL.iter().map(|(known, _)| *known).collect();
        ModelError::Syntax(format!("no sensor \"{name}\"; there are {}", names.join(", ")))
    })?;
    Model::from_toml(text)
}
