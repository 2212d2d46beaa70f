//! Section V: what a camera adds to an even light, and how to take it off again.

mod colour;
pub mod dark;
pub mod defects;
pub mod file;
pub mod joint;
pub mod pattern;
pub mod plan;
mod robust;
pub mod window;

use crate::data_faults::{DataFault, ExamineError, examined};
use crate::dataset::{Dataset, DatasetError, Kind, Set};
use crate::noise::{Method, NoiseReport};
use crate::pixel_format::PixelFormat;
use crate::statistics::moments::Moments;
use dark::{DarkError, DarkMean, DarkReference};
use defects::Defect;
use file::{Calibration, Description};
use ndarray::Array2;
use pattern::{FixedPattern, Options, PatternError};
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;

/// How K is estimated from a dataset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Estimator {
    /// Light as a smooth surface ([`joint::joint`]).
    Joint,
    /// Light as the mean over a window ([`pattern::paper`]).
    Paper(Options),
    /// One configuration is enough: its light as a smooth surface. K then contains the card and all of the lamp that the
    /// surface does not follow ([`joint::smooth`]).
    Smooth,
}

/// Why a dataset gives no calibration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
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
        // Its size was checked by the manifest.
        let _ = moments.add(&[frame.as_slice().unwrap_or_default()]);
    }
    Ok(moments)
}

/// Flats of one exposure and light, by configuration.
struct Level<'a> {
    exposure_s: f64,
    illumination: f64,
    configurations: BTreeMap<u32, Vec<&'a Set>>,
}

/// The exposure and light with the most configurations; of equal ones the longest.
fn most_configurations(dataset: &Dataset) -> Option<Level<'_>> {
    // Exposures and light levels as bits: equal settings are equal to the last digit.
    let mut flats: BTreeMap<(u64, u64), BTreeMap<u32, Vec<&Set>>> = BTreeMap::new();
    for set in dataset.sets() {
        let row = dataset.settings(set);
        if row.kind == Kind::Flat {
            let level = flats.entry((row.exposure_s.to_bits(), row.illumination.to_bits())).or_default();
            level.entry(row.configuration).or_default().push(set);
        }
    }
    let best = flats.into_iter().max_by(|(a, x), (b, y)| x.len().cmp(&y.len()).then(a.cmp(b)));
    best.map(|((exposure, light), configurations)| Level {
        exposure_s: f64::from_bits(exposure),
        illumination: f64::from_bits(light),
        configurations,
    })
}

/// Exposure, s, and light of the flats with the most configurations.
fn best_level(dataset: &Dataset) -> Option<(f64, f64)> {
    most_configurations(dataset).map(|l| (l.exposure_s, l.illumination))
}

/// The means of the darks, one for each exposure.
pub(crate) fn dark_means(dataset: &Dataset) -> Result<Vec<DarkMean>, DatasetError> {
    let mut darks: BTreeMap<u64, Vec<&Set>> = BTreeMap::new();
    for set in dataset.sets() {
        let row = dataset.settings(set);
        if row.kind == Kind::Dark {
            darks.entry(row.exposure_s.to_bits()).or_default().push(set);
        }
    }
    let mean = |(exposure, sets): (u64, Vec<&Set>)| {
        let m = average(dataset, &sets)?;
        let (mean_dn, var_dn2) = (m.mean_dn(), m.variance_dn2());
        Ok(DarkMean { exposure_s: f64::from_bits(exposure), frames: m.frames(), mean_dn, var_dn2 })
    };
    darks.into_iter().map(mean).collect()
}

/// The e_i of eq. (46), and the frames in the smallest of them.
fn images(
    dataset: &Dataset,
    configurations: &BTreeMap<u32, Vec<&Set>>,
    dark_dn: &Array2<f32>,
) -> Result<(Vec<Array2<f32>>, u64), CalibrateError> {
    let full = f64::from(dataset.manifest().camera.full_scale_dn());
    let mut images = Vec::new();
    let mut fewest = u64::MAX;
    for (&configuration, sets) in configurations {
        let moments = average(dataset, sets)?;
        fewest = fewest.min(moments.frames());
        let mean = moments.mean_dn();
        let clipped = mean.iter().filter(|&&m| m >= full).count() as f64 / mean.len() as f64;
        if clipped > 1e-3 {
            return Err(CalibrateError::Saturated { configuration, percent: 100.0 * clipped });
        }
        images.push(ndarray::Zip::from(&mean).and(dark_dn).map_collect(|&m, &d| m as f32 - d));
    }
    Ok((images, fewest))
}

/// The e_i of a pilot.
fn pilot_images(dataset: &Dataset) -> Result<(Vec<Array2<f32>>, u64), CalibrateError> {
    let dataset = &looked_at(dataset)?;
    let Some(level) = most_configurations(dataset) else { return Err(CalibrateError::NoFlats) };
    let dark = DarkReference::fit(&dark_means(dataset)?, level.exposure_s)?.at(level.exposure_s)?;
    images(dataset, &level.configurations, &dark)
}

/// The dataset without what is wrong with it.
fn looked_at(dataset: &Dataset) -> Result<Dataset, DatasetError> {
    examined(dataset, &AtomicBool::new(false)).map_err(|e| match e {
        ExamineError::Dataset(e) => e,
        ExamineError::Interrupted => {
            DatasetError::Manifest { path: dataset.root().into(), message: e.to_string() }
        }
    })
}

/// A calibration, and the pixels that it flags.
#[derive(Debug, Clone)]
pub struct Calibrated {
    /// What goes into the file.
    pub calibration: Calibration,
    /// Every defect with its reason.
    pub defects: Vec<Defect>,
    /// Faults of the data.
    pub data_faults: Vec<DataFault>,
}

/// Dark reference and K from a dataset: darks at any exposures, and flats of three configurations or more at one exposure
/// and light (one is enough for [`Estimator::Smooth`]). Frames are read one at a time: memory holds one mean image for each
/// configuration, however many frames went into it.
///
/// Of flats with several exposures the one with the most configurations is taken, of equal ones the longest.
///
/// # Errors
///
/// What the dataset lacks for a calibration, or which frame cannot be read.
pub fn of_dataset(
    dataset: &Dataset,
    estimator: Estimator,
    noise: Option<&NoiseReport>,
    provenance: &str,
) -> Result<Calibrated, CalibrateError> {
    let dataset = &looked_at(dataset)?;
    let Some(Level { exposure_s, configurations, .. }) = most_configurations(dataset) else {
        return Err(CalibrateError::NoFlats);
    };
    // Before anything is read.
    if configurations.len() < 3 && estimator != Estimator::Smooth {
        return Err(PatternError::TooFew(configurations.len()).into());
    }

    let means = dark_means(dataset)?;
    let dark = DarkReference::fit(&means, exposure_s)?;
    let level = dark.at(exposure_s)?;

    let (images, fewest) = images(dataset, &configurations, &level)?;
    let mosaic =
        PixelFormat::from_name(&dataset.manifest().camera.pixel_format).is_ok_and(PixelFormat::is_mosaic);
    let mut name = String::new();
    let mut estimate = |images: &[Array2<f32>]| -> Result<FixedPattern, CalibrateError> {
        let (pattern, text) = match estimator {
            Estimator::Joint => (joint::joint(images)?, "joint".to_string()),
            Estimator::Paper(o) => {
                let name = format!("paper: window {}, p {}, start {:?}", o.window, o.p, o.start);
                (pattern::paper(images, o)?, name)
            }
            Estimator::Smooth => {
                let name = "smooth: one configuration; K contains the card and the lamp's fine structure";
                let noise = noise.map(|n| (n.gain_dn_per_e.value, n.constant_noise_var_dn2.value));
                (joint::smooth(images, noise, fewest)?, name.to_string())
            }
        };
        name = text;
        Ok(pattern)
    };
    let pattern = if mosaic {
        // A colour's light is smooth; that of a mosaic is not, and the filters' transmissions are no part of K.
        let planes = colour::planes(&images);
        let patterns = planes.iter().map(|p| estimate(p)).collect::<Result<Vec<_>, _>>()?;
        colour::joined(&patterns, level.dim())
    } else {
        estimate(&images)?
    };
    if mosaic {
        name += "; each plane of the colour mosaic by itself";
    }
    let description = Description {
        gain_dn_per_e: noise.map(|n| n.gain_dn_per_e.value),
        constant_noise_var_dn2: noise.map(|n| n.constant_noise_var_dn2.value),
        offset_dn: noise.map(|n| n.offset_dn.value),
        noise_covariance: noise.and_then(|n| {
            let line = n.estimators.iter().find(|e| e.method == Method::Reweighted)?;
            let (a, c) = (line.gain_dn_per_e.std_err, line.constant_noise_var_dn2.std_err);
            Some([a * a, line.covariance, c * c]).filter(|v| v.iter().all(|v| v.is_finite()))
        }),
        n1: images.len(),
        n2: fewest as usize,
        estimator: name,
        provenance: provenance.into(),
        ..Description::of(dataset.manifest().camera.clone())
    };
    let defects = defects::find(&means, &pattern.k, description.gain_dn_per_e);
    let calibration = Calibration::new(description, dark, pattern, &defects);
    Ok(Calibrated { calibration, defects, data_faults: dataset.data_faults().to_vec() })
}
