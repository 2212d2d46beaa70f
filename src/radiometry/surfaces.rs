//! Surfaces recognised by their scene variation: one band, any light level (Section VI of the paper).

use crate::number::Quantity;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Name and major version of the file.
pub const FORMAT: &str = "radcam-surfaces/1";

/// Minimum probability of the distance to the nearest surface; below it no surface is named.
pub const NONE_BELOW: f64 = 1e-4;

/// Library of surfaces, a TOML file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Library {
    /// [`FORMAT`].
    pub format: String,
    /// Learnt surfaces.
    #[serde(default, rename = "surface")]
    pub surfaces: Vec<Surface>,
}

/// Surface of a library.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Surface {
    /// Name of the surface.
    pub name: String,
    /// V_s.
    pub scene_variation: f64,
    /// Standard error of V_s.
    pub std_err: f64,
    /// Number of regions learnt.
    pub regions: u32,
    /// Identifiers of these regions, where known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub seen: Vec<String>,
}

/// Identification of a region.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Most likely surface; null: none of these.
    pub surface: Option<String>,
    /// All surfaces, the most likely first.
    pub candidates: Vec<Candidate>,
}

/// Candidate surface.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Name of the surface.
    pub name: String,
    /// Log-likelihood of the V_s seen.
    pub log_likelihood: f64,
    /// Probability among the surfaces of the library, with equal priors.
    pub probability: f64,
    /// Distance in standard errors of the difference.
    pub z: f64,
}

/// Error: a library cannot be read or used.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {message}")]
pub struct LibraryError {
    path: PathBuf,
    message: String,
}

impl Default for Library {
    fn default() -> Self {
        Self { format: FORMAT.into(), surfaces: Vec::new() }
    }
}

impl Library {
    /// Reads a library.
    ///
    /// # Errors
    ///
    /// If the file cannot be read or is no library.
    pub fn read(path: &Path) -> Result<Self, LibraryError> {
        let fault = |message: String| LibraryError { path: path.into(), message };
        let text = crate::input::settings(path).map_err(|e| fault(e.to_string()))?;
        let library: Self =
            toml::from_str(&text).map_err(|e| fault(crate::input::echo_lines(&e.to_string())))?;
        if library.format != FORMAT {
            return Err(fault(format!(
                "format is \"{}\", and this program reads \"{FORMAT}\"",
                crate::input::echo(&library.format)
            )));
        }
        let sound = |s: &Surface| s.scene_variation.is_finite() && s.std_err.is_finite() && s.std_err >= 0.0;
        match library.surfaces.iter().find(|s| !sound(s)) {
            Some(s) => Err(fault(format!("surface \"{}\" holds no sound numbers", s.name))),
            None => Ok(library),
        }
    }

    /// Writes the library atomically.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), LibraryError> {
        let fault = |message: String| LibraryError { path: path.into(), message };
        let text = toml::to_string(self).map_err(|e| fault(e.to_string()))?;
        crate::dataset::write_whole(path, text.as_bytes()).map_err(|e| fault(e.to_string()))
    }

    /// Adds a region's V_s to a surface, or a new surface; regions are averaged with inverse-variance
    /// weights. `region` identifies the region. A region learnt before is refused, since it adds no
    /// information.
    ///
    /// # Errors
    ///
    /// If this region was learnt already, with its name.
    pub fn learn(&mut self, name: &str, seen: &Quantity, region: &str) -> Result<(), String> {
        let before = self.surfaces.iter().find(|s| s.seen.iter().any(|r| r == region));
        if let Some(before) = before {
            return Err(format!("this region was learnt before, as \"{}\"", before.name));
        }
        let (value, std_err) = (seen.value, seen.std_err.max(f64::MIN_POSITIVE));
        match self.surfaces.iter_mut().find(|s| s.name == name) {
            Some(known) => {
                let (a, b) = (known.std_err.max(f64::MIN_POSITIVE).powi(-2), std_err.powi(-2));
                known.scene_variation = (a * known.scene_variation + b * value) / (a + b);
                known.std_err = (a + b).sqrt().recip();
                known.regions += 1;
                known.seen.push(region.into());
            }
            None => self.surfaces.push(Surface {
                name: name.into(),
                scene_variation: value,
                std_err,
                regions: 1,
                seen: vec![region.into()],
            }),
        }
        Ok(())
    }

    /// Identifies a surface by its V_s. No surface is returned if the distance even of the nearest has a
    /// probability below [`NONE_BELOW`].
    ///
    /// ```
    /// use radcam::number::Quantity;
    /// use radcam::surfaces::Library;
    /// let mut library = Library::default();
    /// let quantity = |value| Quantity::new(value, 1e-5, "1");
    /// library.learn("rough", &quantity(1e-3), "first image")?;
    /// library.learn("smooth", &quantity(1e-4), "second image")?;
    /// assert_eq!(library.identify(&quantity(1.02e-4)).surface.as_deref(), Some("smooth"));
    /// assert_eq!(library.identify(&quantity(5e-4)).surface, None);
    /// # Ok::<(), String>(())
    /// ```
    pub fn identify(&self, seen: &Quantity) -> Answer {
        let mut candidates: Vec<Candidate> = self
            .surfaces
            .iter()
            .map(|s| {
                let sd = seen.std_err.hypot(s.std_err).max(f64::MIN_POSITIVE);
                let z = (seen.value - s.scene_variation) / sd;
                let log_likelihood = -0.5 * z * z - sd.ln() - 0.5 * std::f64::consts::TAU.ln();
                Candidate { name: s.name.clone(), log_likelihood, probability: 0.0, z }
            })
            .collect();
        candidates.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
        let best = candidates.first().map_or(0.0, |c| c.log_likelihood);
        let sum: f64 = candidates.iter().map(|c| (c.log_likelihood - best).exp()).sum();
        for c in &mut candidates {
            c.probability = (c.log_likelihood - best).exp() / sum;
        }
        let near = candidates
            .first()
            .filter(|c| statrs::function::erf::erfc(c.z.abs() / std::f64::consts::SQRT_2) >= NONE_BELOW);
        Answer { surface: near.map(|c| c.name.clone()), candidates }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_library_survives_the_disk_and_others_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.toml");
        let mut library = Library::default();
        for value in [1.0e-3, 1.2e-3] {
            let seen = Quantity::new(value, 1e-4, "1");
            library.learn("paint", &seen, &value.to_string()).unwrap();
        }
        // A region learnt twice adds nothing, under any name.
        let again = Quantity::new(1.2e-3, 1e-4, "1");
        assert!(library.learn("chalk", &again, "0.0012").unwrap_err().contains("as \"paint\""));
        assert!((library.surfaces[0].scene_variation - 1.1e-3).abs() < 1e-12);
        assert!((library.surfaces[0].std_err - 1e-4 / 2f64.sqrt()).abs() < 1e-12);
        library.write(&path).unwrap();
        assert_eq!(Library::read(&path).unwrap(), library);
        std::fs::write(&path, "format = \"radcam-surfaces/3\"").unwrap();
        assert!(Library::read(&path).unwrap_err().to_string().contains("radcam-surfaces/3"));
        assert_eq!(Library::default().identify(&Quantity::new(1.0, 1.0, "1")).surface, None);
    }
}
