//! Section V: nonuniformity that a camera adds to even light, and its correction.

mod colour;
pub mod dark;
pub mod defects;
pub mod file;
mod flat_field;
mod flats;
pub mod joint;
pub mod pattern;
pub mod plan;
mod robust;
pub mod window;
mod worth;

use crate::data_faults::{DataFault, ExamineError, examined};
use crate::dataset::{CameraInfo, Dataset, DatasetError, Kind, Set};
use crate::noise::{Method, NoiseReport};
use crate::number::six_digits;
use crate::statistics::lit::Lit;
use crate::statistics::moments::Moments;
use crate::statistics::outliers;
use dark::{DarkError, DarkMean, DarkReference};
use defects::Defect;
use file::{Calibration, Description};
use ndarray::{Array2, Zip, s};
use pattern::{FixedPattern, Options, PatternError};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Estimator of K from a dataset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Estimator {
    /// Light as a smooth surface ([`joint::joint`]).
    Joint,
    /// Light as the mean over a window ([`pattern::paper`]).
    Paper(Options),
    /// Light of a single configuration as a smooth surface. K then contains the card, and the parts of the
    /// lamp that the surface does not follow ([`joint::smooth`]).
    Smooth,
    /// Light of the flats left in K, so that corrected flats are even: lens shading, lamp and card are
    /// removed with the fixed pattern. One configuration is enough.
    FlatField,
}

impl Estimator {
    /// Returns true if flats of one configuration are enough; all flats are used then.
    fn takes_all(self) -> bool {
        matches!(self, Self::Smooth | Self::FlatField)
    }
}

/// Error: a dataset gives no calibration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrateError {
    /// Error of the dataset.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Error of the darks.
    #[error(transparent)]
    Dark(#[from] DarkError),
    /// Error of the flats.
    #[error(transparent)]
    Pattern(#[from] PatternError),
    /// No flats.
    #[error("the dataset has no flats")]
    NoFlats,
    /// Flats of single frames without a known gain: the noise, and so the error of K, is unknown.
    #[error(
        "set {set} has one frame, and the gain that would tell its noise is not known, so that the error of K is not known; take two frames or \
         more of each level"
    )]
    NoiseUnknown {
        /// Number of the first such set.
        set: u32,
    },
    /// Clipped flats, which have lost their pattern.
    #[error(
        "configuration {configuration}: {percent:.2} % of the samples are at full scale; shorten the exposure"
    )]
    Saturated {
        /// Number of the configuration.
        configuration: u32,
        /// Clipped share.
        percent: f64,
    },
    /// Darks that do not belong to the flats.
    #[error(
        "the photon transfer's line leaves {} DN² for the constant noise, and no noise is below 0: darks and flats are of other settings, or \
         the levels lie on no line; `radcam noise` shows them",
        six_digits(*.dn2)
    )]
    NegativeNoise {
        /// Constant noise, DN^2.
        dn2: f64,
    },
    /// K would add more noise than it removes.
    #[error(
        "K would make frames noisier: its error is {:.3} % a pixel, and the pixels differ by {}{:.3} % (PRNU); {needed} bring it to half of \
         that",
        100.0 * .error, if *.at_most { "at most " } else { "" }, 100.0 * .prnu
    )]
    TooNoisy {
        /// Standard error of K, relative.
        error: f64,
        /// Spread of the pixels' response, relative.
        prnu: f64,
        /// True if the spread is below that error; it is an upper limit then.
        at_most: bool,
        /// Frames that suffice, as text.
        needed: String,
    },
}

/// Averages sets of frames, read one at a time.
fn average(dataset: &Dataset, sets: &[&Set]) -> Result<Moments, DatasetError> {
    let camera = &dataset.manifest().camera;
    let mut moments = Moments::new((camera.height, camera.width), camera.bit_depth);
    for rows in sets.iter().flat_map(|s| outliers::blocks(&s.rows)) {
        let read = |row: &usize| dataset.read(&dataset.rows()[*row]).map(Arc::new);
        let frames = rows.iter().map(read).collect::<Result<Vec<_>, _>>()?;
        // A cosmic ray in a dark is no dark current of its pixel.
        let (frames, _) = dataset.without_struck(frames);
        // Sizes were checked against the manifest.
        let slices: Vec<&[u16]> = frames.iter().filter_map(|f| f.as_slice()).collect();
        let _ = moments.add(&slices);
    }
    Ok(moments)
}

/// Flats of one exposure and light, by configuration.
struct Level<'a> {
    exposure_s: f64,
    illumination: f64,
    configurations: BTreeMap<u32, Vec<&'a Set>>,
}

/// Returns the exposure and light with the most configurations; among equals the longest exposure.
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

/// Returns exposure, s, and light of the flats with the most configurations.
fn best_level(dataset: &Dataset) -> Option<(f64, f64)> {
    most_configurations(dataset).map(|l| (l.exposure_s, l.illumination))
}

/// Averages the darks, one mean for each exposure.
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

/// Sensor temperature of the campaign, degrees Celsius: from the manifest, or the mean of the darks.
fn temperature_c(dataset: &Dataset) -> Option<f64> {
    let darks = dataset.rows().iter().filter(|r| r.kind == Kind::Dark).filter_map(|r| r.temperature_c);
    let (sum, count) = darks.fold((0.0, 0.0), |(sum, count), t| (sum + t, count + 1.0));
    let mean = (count > 0.0).then(|| (100.0 * sum / count).round() / 100.0);
    dataset.manifest().camera.temperature_c.or(mean)
}

/// Examines the dataset and excludes its faulty data.
fn looked_at(dataset: &Dataset) -> Result<Dataset, DatasetError> {
    let fault = |message: String| DatasetError::Manifest { path: dataset.root().into(), message };
    let whole = examined(dataset, &AtomicBool::new(false)).map_err(|e| match e {
        ExamineError::Dataset(e) => e,
        ExamineError::Interrupted => fault(e.to_string()),
    })?;
    if whole.is_without_text() {
        return Err(fault("a correction needs every pixel of the camera, and some rows hold text".into()));
    }
    // Rows that jump without being text may have defective pixels: a correction is of whole frames.
    Ok(whole.uncut())
}

/// Calibration, with its flagged pixels.
#[derive(Debug, Clone)]
pub struct Calibrated {
    /// Contents of the file.
    pub calibration: Calibration,
    /// All defects with their reasons.
    pub defects: Vec<Defect>,
    /// Faults of the data.
    pub data_faults: Vec<DataFault>,
    /// Number of exposures and lights of the flats used for K.
    pub levels: usize,
    /// Flats that are not used for K, with the reason.
    pub left_out: Vec<String>,
    /// True if K may contain the card: nothing was moved between the configurations, or no movement is
    /// detectable.
    pub has_card: bool,
}

/// Computes dark reference and K from a dataset: darks at any exposures, and flats of three configurations or
/// more at one exposure and light (one is enough for [`Estimator::Smooth`] and [`Estimator::FlatField`]).
/// Frames are read one at a time: memory holds one mean image per configuration, for any number of frames.
///
/// Among flats of several exposures the one with the most configurations is used, among equals the longest;
/// [`Estimator::Smooth`] and [`Estimator::FlatField`] use all flats. Dead and unlit pixels are flagged and
/// have K = 1. A K whose error exceeds what it corrects is refused.
///
/// # Errors
///
/// If the dataset lacks data for a calibration, or a frame cannot be read; both are named.
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
    // Checked before anything is read.
    if configurations.len() < 3 && !estimator.takes_all() {
        return Err(PatternError::TooFew(configurations.len()).into());
    }
    let means = dark_means(dataset)?;
    let dark = DarkReference::fit(&means, exposure_s)?;
    let level = dark.at(exposure_s)?;
    let constant = noise.map(|n| &n.constant_noise_var_dn2).filter(|c| c.value.is_finite());
    if let Some(c) = constant.filter(|c| c.value < -MIN_SIGMAS_BELOW_0 * c.std_err) {
        return Err(CalibrateError::NegativeNoise { dn2: c.value });
    }
    let line = noise.map(|n| (n.gain_dn_per_e.value, n.constant_noise_var_dn2.value));
    let line = line.filter(|(a, c)| a.is_finite() && c.is_finite());
    let flats = if estimator.takes_all() {
        flats::of_all(dataset, &dark, line)?
    } else {
        flats::of_level(dataset, &configurations, &level, line)?
    };
    let mosaic = dataset.manifest().camera.is_mosaic();
    let (mut pattern, light) = if mosaic {
        // The light of one colour is smooth; that of a mosaic is not, and the filters' transmissions are no
        // part of K.
        let planes = colour::planes(&flats.images);
        let of = |images: &Vec<Array2<f32>>| estimate(estimator, images, &flats.noise_dn2);
        let found = planes.iter().map(of).collect::<Result<Vec<_>, _>>()?;
        colour::joined(&found, level.dim())
    } else {
        estimate(estimator, &flats.images, &flats.noise_dn2)?
    };
    let name = name_of(estimator, mosaic);
    let gain = noise.map(|n| n.gain_dn_per_e.value).filter(|a| a.is_finite());
    let defects = defects::find(&means, &pattern.k, &light, gain);
    without_defects(&mut pattern, &defects, mosaic);
    let darks = means.iter().map(|d| d.frames).sum();
    // The noise of the planes of a mosaic is not that of all pixels.
    let has_card =
        estimator.takes_all() || (!mosaic && worth::differ_by_noise_alone(&pattern, &flats.noise_dn2));
    // A flat-field correction removes the shading as well, which is worth some noise.
    if estimator == Estimator::FlatField {
        flat_field::with_light(&mut pattern, &flats.images, &defects, mosaic);
    }
    worth::check(&pattern, &defects, &dark, flats.frames.iter().sum(), darks)?;
    let camera = &dataset.manifest().camera;
    let description = Description {
        gain_dn_per_e: gain,
        constant_noise_var_dn2: constant.map(|c| c.value.max(0.0)),
        offset_dn: noise.map(|n| n.offset_dn.value).filter(|o| o.is_finite()),
        noise_covariance: noise.and_then(|n| {
            let line = n.estimators.iter().find(|e| e.method == Method::Reweighted)?;
            let (a, c) = (line.gain_dn_per_e.std_err, line.constant_noise_var_dn2.std_err);
            Some([a * a, line.covariance, c * c]).filter(|v| v.iter().all(|v| v.is_finite()))
        }),
        n1: flats.images.len(),
        n2: flats.fewest() as usize,
        estimator: name,
        provenance: provenance.into(),
        ..Description::of(CameraInfo { temperature_c: temperature_c(dataset), ..camera.clone() })
    };
    let calibration = Calibration::new(description, dark, pattern, &defects);
    let data_faults = dataset.data_faults().to_vec();
    Ok(Calibrated {
        calibration,
        defects,
        data_faults,
        levels: flats.levels,
        left_out: flats.left_out,
        has_card,
    })
}

/// Maximum iterations of excluding pixels that the surfaces show to be dead.
const ROUNDS: usize = 3;
/// Minimum standard errors below 0 at which a negative constant noise is significant (a named choice).
const MIN_SIGMAS_BELOW_0: f64 = 3.0;

/// Minimum share of the lit pixels that must be left without the rim of the image circle.
const MIN_SHARE_WITHOUT_RIM: f64 = 0.7;

/// Estimates K of one colour, and its lit pixels. Dead and unlit pixels are excluded from the light.
fn estimate(
    estimator: Estimator,
    images: &[Array2<f32>],
    noise_dn2: &[f64],
) -> Result<(FixedPattern, Lit), CalibrateError> {
    let mut light = Lit::of(images);
    let mut sound = light.lit.clone();
    let of_light = light.lit_pixels() as f64;
    if !sound.iter().any(|s| *s) {
        return Err(PatternError::NoPixels.into());
    }
    let once = |sound: &Array2<bool>| match estimator {
        Estimator::Joint => joint::joint_of(images, sound),
        Estimator::Paper(o) if sound.iter().all(|s| *s) => pattern::paper(images, o),
        Estimator::Paper(o) => pattern::paper_of(&joint::filled(images, sound), o, sound),
        Estimator::Smooth | Estimator::FlatField => joint::smooth_of(images, noise_dn2, sound),
    };
    let mut pattern = once(&sound)?;
    for _ in 0..ROUNDS {
        about_its_median(&mut pattern, &light.lit);
        // A rim that covers most of the image is lens shading.
        let grown = light.clone().with_rim(&pattern.k);
        if grown.lit_pixels() as f64 >= MIN_SHARE_WITHOUT_RIM * of_light {
            light = grown;
        }
        let answers = |&k: &f32, &lit: &bool| lit && (defects::DEAD_K..=1.0 / defects::DEAD_K).contains(&k);
        let now = Zip::from(&pattern.k).and(&light.lit).map_collect(answers);
        if now == sound {
            break;
        }
        if !now.iter().any(|s| *s) {
            return Err(PatternError::NoPixels.into());
        }
        sound = now;
        pattern = once(&sound)?;
    }
    about_its_median(&mut pattern, &light.lit);
    Ok((pattern, light))
}

/// Scales K to a median of 1 over the lit pixels. If a surface cannot follow a steep falloff of the lens, K
/// of a few pixels is in the thousands: a mean over all of them would make every other pixel dead. The error
/// is relative to the light and is kept.
fn about_its_median(pattern: &mut FixedPattern, lit: &Array2<bool>) {
    let of_light = pattern.k.iter().zip(lit).filter(|(k, lit)| **lit && k.is_finite());
    let usual = crate::statistics::median::median(of_light.map(|(k, _)| f64::from(*k)));
    if usual.is_finite() && usual > 0.0 {
        pattern.k.mapv_inplace(|k| (f64::from(k) / usual) as f32);
        pattern.mean_before *= usual;
    }
}

fn name_of(estimator: Estimator, mosaic: bool) -> String {
    let name = match estimator {
        Estimator::Joint => "joint".to_string(),
        Estimator::Paper(o) => format!("paper: window {}, p {}, start {:?}", o.window, o.p, o.start),
        Estimator::Smooth => {
            "smooth: one configuration; K contains the card and the lamp's fine structure".to_string()
        }
        Estimator::FlatField => {
            format!("{}: K contains the light of the flats (lens shading, lamp, card)", flat_field::NAME)
        }
    };
    name + if mosaic { "; each plane of the colour mosaic by itself" } else { "" }
}

/// Creates the map of the defect flags.
fn flags_of(defects: &[Defect], shape: (usize, usize)) -> Array2<u8> {
    let mut flags = Array2::zeros(shape);
    defects.iter().for_each(|d| flags[(d.y, d.x)] = d.flags);
    flags
}

/// Sets K = 1 for pixels of unknown response, and scales K to a mean of 1 over those without a defect; for a
/// mosaic in each plane.
fn without_defects(pattern: &mut FixedPattern, defects: &[Defect], mosaic: bool) {
    let flags = flags_of(defects, pattern.k.dim());
    let errors = pattern.std_err.iter().zip(&flags).filter(|(_, f)| **f == 0).map(|(e, _)| f64::from(*e));
    let usual = crate::statistics::median::median(errors) as f32;
    for (y, x, period) in colour::places(mosaic) {
        let plane = s![y..;period, x..;period];
        let flags = flags.slice(plane);
        let mut k = pattern.k.slice_mut(plane);
        let sound = k.iter().zip(&flags).filter(|(_, f)| **f == 0).map(|(k, _)| f64::from(*k));
        let (n, sum) = sound.fold((0.0, 0.0), |(n, sum), k| (n + 1.0, sum + k));
        if n > 0.0 {
            let mean = sum / n;
            k.mapv_inplace(|k| (f64::from(k) / mean) as f32);
        }
        let mut std_err = pattern.std_err.slice_mut(plane);
        Zip::from(&mut k).and(&mut std_err).and(&flags).for_each(|k, e, &f| {
            if f & defects::NO_RESPONSE != 0 || !(k.is_finite() && *k > 0.0) {
                (*k, *e) = (1.0, if usual.is_finite() { usual } else { 1.0 });
            }
        });
    }
}
