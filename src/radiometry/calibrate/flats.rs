//! Mean images of the flats for the estimate of K (the e_i of eq. 46).

use super::dark::{DarkError, DarkReference};
use super::{CalibrateError, Level, average, most_configurations};
use crate::dataset::{Dataset, Kind, Set};
use ndarray::{Array2, Zip};
use std::collections::BTreeMap;

/// Maximum share of the pixels at full scale in a flat of one level; beyond it the pattern is lost.
const MAX_CLIPPED_SHARE: f64 = 1e-3;
/// Maximum share of clipped pixels if other levels cover them: glints on the card.
const MAX_CLIPPED_SHARE_OF_MANY: f64 = 0.02;
/// Maximum share of pixels that are bright in the dark for these to be stuck, and to say nothing of the light
/// (a named choice, as in the examination of the sets).
const MAX_STUCK_SHARE: f64 = 0.05;
/// Minimum level of a flat beside brighter ones, over the brightest: below it the weight is as small, and the
/// error of the dark reference is not.
const MIN_LEVEL: f64 = 0.05;
/// Standard deviations of the noise within which full scale clips a pixel.
const REACH: f64 = 3.0;

/// Mean images with their noise.
#[derive(Debug, Default)]
pub(super) struct Flats {
    /// Images with the dark reference subtracted, DN, one per configuration.
    pub images: Vec<Array2<f32>>,
    /// Variance of the temporal noise left in each, DN^2.
    pub noise_dn2: Vec<f64>,
    /// Number of frames in each.
    pub frames: Vec<u64>,
    /// Number of exposures and lights in them.
    pub levels: usize,
    /// Sets that are not used, with the reason.
    pub left_out: Vec<String>,
}

impl Flats {
    /// Smallest number of frames of a configuration.
    pub(super) fn fewest(&self) -> u64 {
        self.frames.iter().copied().min().unwrap_or(0)
    }
}

/// One level of light of one configuration.
struct Image {
    signal_dn: Array2<f32>,
    level_dn: f64,
    frames: u64,
    /// Temporal variance of a frame, DN^2.
    var_dn2: f64,
    /// Pixels whose noise reaches full scale.
    clipped: Array2<bool>,
}

/// (A, sigma_C^2) of the campaign, if known.
type Noise = Option<(f64, f64)>;

fn image(
    dataset: &Dataset,
    sets: &[&Set],
    dark_dn: &Array2<f32>,
    noise: Noise,
) -> Result<Image, CalibrateError> {
    let full = f64::from(dataset.manifest().camera.full_scale_dn());
    let moments = average(dataset, sets)?;
    let mean = moments.mean_dn();
    let signal_dn = Zip::from(&mean).and(dark_dn).map_collect(|&m, &d| m as f32 - d);
    let level_dn = f64::from(signal_dn.mean().unwrap_or(0.0));
    // Sets of one level may differ in light: their scatter is an upper bound of the noise.
    let scatter = moments.variance_dn2().mean().unwrap_or(f64::NAN);
    let model = noise.map_or(f64::NAN, |(a, c)| a * level_dn.max(0.0) + c);
    let var_dn2 = model.min(scatter);
    if var_dn2.is_nan() {
        return Err(CalibrateError::NoiseUnknown { set: sets.first().map_or(0, |s| s.number) });
    }
    let var_dn2 = var_dn2.max(1.0 / 12.0);
    let near = full - REACH * var_dn2.sqrt();
    let clipped = mean.mapv(|m| m >= near.max(0.5 * full));
    Ok(Image { signal_dn, level_dn, frames: moments.frames(), var_dn2, clipped })
}

/// Returns the share of pixels that the light brings to full scale: pixels near it in the dark, DN, are stuck
/// there.
fn share_at_full(at_full: impl Iterator<Item = bool>, dark_dn: &Array2<f32>, full_dn: f64) -> f64 {
    let of = dark_dn.len().max(1) as f64;
    let is_stuck = |d: &f32| f64::from(*d) > 0.5 * full_dn;
    let stuck = dark_dn.iter().filter(|d| is_stuck(d)).count() as f64 / of;
    let by_light = |(at_full, dark): &(bool, &f32)| *at_full && (stuck > MAX_STUCK_SHARE || !is_stuck(dark));
    at_full.zip(dark_dn).filter(by_light).count() as f64 / of
}

/// Averages the flats of one exposure and light in all configurations.
pub(super) fn of_level(
    dataset: &Dataset,
    configurations: &BTreeMap<u32, Vec<&Set>>,
    dark_dn: &Array2<f32>,
    noise: Noise,
) -> Result<Flats, CalibrateError> {
    let full = f64::from(dataset.manifest().camera.full_scale_dn());
    let mut out = Flats { levels: 1, ..Flats::default() };
    for (&configuration, sets) in configurations {
        let image = image(dataset, sets, dark_dn, noise)?;
        let pixels = image.signal_dn.iter().zip(dark_dn);
        let at_full = share_at_full(pixels.map(|(s, d)| f64::from(s + d) >= full - 1e-3), dark_dn, full);
        if at_full > MAX_CLIPPED_SHARE {
            return Err(CalibrateError::Saturated { configuration, percent: 100.0 * at_full });
        }
        out.noise_dn2.push(image.var_dn2 / image.frames as f64);
        out.frames.push(image.frames);
        out.images.push(image.signal_dn);
    }
    Ok(out)
}

/// Averages all flats. Those of one configuration have light of one shape, and are averaged over all
/// exposures and lights with their information on K as weights: frames times signal^2 over variance. A pixel
/// that is clipped at some levels is estimated from the others. Memory holds one image per configuration.
pub(super) fn of_all(dataset: &Dataset, dark: &DarkReference, noise: Noise) -> Result<Flats, CalibrateError> {
    let mut levels: BTreeMap<u32, BTreeMap<(u64, u64), Vec<&Set>>> = BTreeMap::new();
    for set in dataset.sets() {
        let row = dataset.settings(set);
        if row.kind == Kind::Flat {
            let key = (row.exposure_s.to_bits(), row.illumination.to_bits());
            levels.entry(row.configuration).or_default().entry(key).or_default().push(set);
        }
    }
    let brightest = brightest_dn(dataset, dark)?;
    let full = f64::from(dataset.manifest().camera.full_scale_dn());
    let mut out = Flats::default();
    let mut all_levels = std::collections::BTreeSet::new();
    let mut refused: Option<CalibrateError> = None;
    for (configuration, levels) in levels {
        let mut sum = Array2::<f32>::zeros(dark.level_dn.dim());
        // Sum of the weights of each pixel, over the levels at which it is not clipped.
        let mut pixel_weights = sum.clone();
        let (mut weights, mut over_level, mut frames) = (0.0, 0.0, 0);
        for ((exposure, light), sets) in levels {
            let exposure_s = f64::from_bits(exposure);
            let numbers: Vec<String> = sets.iter().map(|s| format!("set {}", s.number)).collect();
            let name = numbers.join(", ");
            let dark_dn = match dark.at(exposure_s) {
                Ok(dark_dn) => dark_dn,
                Err(e @ DarkError::Exposure { .. }) => {
                    out.left_out.push(format!("{name}: no dark reference at {exposure_s} s"));
                    refused.get_or_insert(e.into());
                    continue;
                }
                Err(e) => return Err(e.into()),
            };
            let of = image(dataset, &sets, &dark_dn, noise)?;
            let clipped = share_at_full(of.clipped.iter().copied(), &dark_dn, full);
            if clipped > MAX_CLIPPED_SHARE_OF_MANY {
                let percent = 100.0 * clipped;
                out.left_out.push(format!("{name}: {percent:.2} % of the pixels are at full scale"));
                refused.get_or_insert(CalibrateError::Saturated { configuration, percent });
                continue;
            }
            if of.level_dn <= MIN_LEVEL * brightest {
                out.left_out
                    .push(format!("{name}: {:.0} DN of light are too little beside the others", of.level_dn));
                continue;
            }
            let weight = of.frames as f64 * of.level_dn.powi(2) / of.var_dn2;
            let scale = (weight / of.level_dn) as f32;
            Zip::from(&mut sum).and(&mut pixel_weights).and(&of.signal_dn).and(&of.clipped).for_each(
                |sum, weights, &signal, &clipped| {
                    if !clipped {
                        *sum += scale * signal;
                        *weights += weight as f32;
                    }
                },
            );
            weights += weight;
            over_level += weight / of.level_dn;
            frames += of.frames;
            all_levels.insert((exposure, light));
        }
        // Scales to the level at which an error of the dark reference would have the same effect.
        if weights <= 0.0 {
            continue;
        }
        let level = weights / over_level;
        let mean = |&sum: &f32, &own: &f32| if own > 0.0 { sum / own * level as f32 } else { 0.0 };
        out.images.push(Zip::from(&sum).and(&pixel_weights).map_collect(mean));
        out.noise_dn2.push(level * level / weights);
        out.frames.push(frames);
    }
    out.levels = all_levels.len();
    match refused {
        Some(refused) if out.images.is_empty() => Err(refused),
        _ if out.images.is_empty() => Err(super::pattern::PatternError::Dark(0).into()),
        _ => Ok(out),
    }
}

/// Level of the brightest flats above their darks, from the first frame of each set, DN.
fn brightest_dn(dataset: &Dataset, dark: &DarkReference) -> Result<f64, CalibrateError> {
    let zero = f64::from(dark.level_dn.mean().unwrap_or(0.0));
    let mut brightest = 0.0f64;
    for set in dataset.sets() {
        if dataset.settings(set).kind == Kind::Flat {
            let frame = dataset.read(&dataset.rows()[set.rows[0]])?;
            brightest = brightest.max(frame.mapv(f64::from).mean().unwrap_or(0.0) - zero);
        }
    }
    Ok(brightest)
}

/// Averages the e_i of a pilot.
pub(super) fn of_pilot(dataset: &Dataset) -> Result<Flats, CalibrateError> {
    let dataset = &super::looked_at(dataset)?;
    let Some(Level { exposure_s, configurations, .. }) = most_configurations(dataset) else {
        return Err(CalibrateError::NoFlats);
    };
    let dark = DarkReference::fit(&super::dark_means(dataset)?, exposure_s)?.at(exposure_s)?;
    of_level(dataset, &configurations, &dark, None)
}
