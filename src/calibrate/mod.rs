//! Section V: what a camera adds to an even light, and how to take it off again.

pub mod dark;
pub mod file;
pub mod joint;
pub mod pattern;
pub mod window;

use crate::dataset::{Dataset, DatasetError, Kind, Set};
use crate::noise::NoiseReport;
use crate::statistics::moments::Moments;
use dark::{DarkError, DarkMean, DarkReference};
use file::{Calibration, Description};
use ndarray::Array2;
use pattern::{Options, PatternError};
use std::collections::BTreeMap;

/// How K is estimated from a dataset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Estimator {
    /// Light as a smooth surface ([`joint::joint`]).
    Joint,
    /// Light as the mean over a window ([`pattern::paper`]).
    Paper(Options),
}

/// Why a dataset gives no calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError {
    /// The dataset.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The darks.
    #[error(transparent)]
    Dark(#[from] DarkError),
    /// The flats.
    #[error(transparent)]
    Pattern(#[from] PatternError),
    /// No flats.
    #[error("the dataset has no flats")]
    NoFlats,
    /// Clipped flats have lost their pattern.
    #[error(
        "configuration {configuration}: {percent:.2} % of the samples are at full scale; shorten the exposure"
    )]
    Saturated {
        /// Number of the configuration.
        configuration: u32,
        /// Clipped share.
        percent: f64,
    },
}

/// Averages sets of frames, read one at a time.
fn average(dataset: &Dataset, sets: &[&Set]) -> Result<Moments, DatasetError> {
    let camera = &dataset.manifest().camera;
    let mut moments = Moments::new((camera.height, camera.width), camera.bit_depth);
    for &row in sets.iter().flat_map(|s| &s.rows) {
        let frame = dataset.read(&dataset.rows()[row])?;
        // Its size was held against the manifest.
        let _ = moments.add(&[frame.as_slice().unwrap_or_default()]);
    }
    Ok(moments)
}

/// Dark reference and K from a dataset: darks at any exposures, and flats of three configurations or more at one exposure
/// and light.
///
/// Of flats with several exposures the one with the most configurations is taken, of equal ones the longest.
pub fn of_dataset(
    dataset: &Dataset,
    estimator: Estimator,
    noise: Option<&NoiseReport>,
    provenance: &str,
) -> Result<Calibration, CalibrateError> {
    // Exposures and light levels as bits: equal settings are equal to the last digit.
    let mut darks: BTreeMap<u64, Vec<&Set>> = BTreeMap::new();
    let mut flats: BTreeMap<(u64, u64), BTreeMap<u32, Vec<&Set>>> = BTreeMap::new();
    for set in dataset.sets() {
        let row = dataset.settings(set);
        let exposure = row.exposure_s.to_bits();
        match row.kind {
            Kind::Dark => darks.entry(exposure).or_default().push(set),
            Kind::Flat => {
                let level = flats.entry((exposure, row.illumination.to_bits())).or_default();
                level.entry(row.configuration).or_default().push(set);
            }
            Kind::Scene | Kind::Target => {}
        }
    }
    let best = flats.iter().max_by(|(a, x), (b, y)| x.len().cmp(&y.len()).then(a.cmp(b)));
    let Some((&(exposure, _), configurations)) = best else { return Err(CalibrateError::NoFlats) };
    let exposure_s = f64::from_bits(exposure);
    // Before anything is read.
    if configurations.len() < 3 {
        return Err(PatternError::TooFew(configurations.len()).into());
    }

    let means = darks
        .iter()
        .map(|(&exposure, sets)| {
            let m = average(dataset, sets)?;
            let (mean_dn, var_dn2) = (m.mean_dn(), m.variance_dn2());
            Ok(DarkMean { exposure_s: f64::from_bits(exposure), frames: m.frames(), mean_dn, var_dn2 })
        })
        .collect::<Result<Vec<_>, DatasetError>>()?;
    let dark = DarkReference::fit(&means, exposure_s)?;
    let level = dark.at(exposure_s)?;

    let full = f64::from(dataset.manifest().camera.full_scale_dn());
    let mut images: Vec<Array2<f32>> = Vec::new();
    let mut fewest = u64::MAX;
    for (&configuration, sets) in configurations {
        let moments = average(dataset, sets)?;
        fewest = fewest.min(moments.frames());
        let mean = moments.mean_dn();
        let clipped = mean.iter().filter(|&&m| m >= full).count() as f64 / mean.len() as f64;
        if clipped > 1e-3 {
            return Err(CalibrateError::Saturated { configuration, percent: 100.0 * clipped });
        }
        images.push(ndarray::Zip::from(&mean).and(&level).map_collect(|&m, &d| m as f32 - d));
    }
    let (pattern, name) = match estimator {
        Estimator::Joint => (joint::joint(&images)?, "joint".to_string()),
        Estimator::Paper(o) => {
            let name = format!("paper: window {}, p {}, start {:?}", o.window, o.p, o.start);
            (pattern::paper(&images, o)?, name)
        }
    };
    let description = Description {
        format: String::new(),
        camera: dataset.manifest().camera.clone(),
        pages: Vec::new(),
        dark_exposure_s: 0.0,
        gain_dn_per_e: noise.map(|n| n.gain_dn_per_e.value),
        constant_noise_var_dn2: noise.map(|n| n.constant_noise_var_dn2.value),
        offset_dn: noise.map(|n| n.offset_dn.value),
        n1: images.len(),
        n2: fewest as usize,
        estimator: name,
        provenance: provenance.into(),
    };
    Ok(Calibration::new(description, dark, pattern))
}
