//! Scene variation (Section VI of the paper, eq. 54 to 58): relative variation of a surface, independent of
//! the lamp.
//!
//! The camera's own noise is subtracted from the spatial variance of a corrected image. The remainder grows
//! as the square of the mean, and its factor V_s = sigma_E^2 / S^2 depends on the surface (and on how its
//! light varies) alone.

use crate::calibrate::file::Calibration;
use crate::number::Quantity;
use ndarray::{Array2, ArrayView2, s};
use serde::{Deserialize, Serialize};

/// Blocks along each side of a region for the standard error.
const BLOCKS: usize = 5;

/// Noise of the camera, from its calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraNoise {
    /// A, DN per electron.
    pub gain_dn_per_e: f64,
    /// sigma_C^2, DN^2.
    pub constant_noise_var_dn2: f64,
    /// Black level at zero exposure, DN.
    pub offset_dn: f64,
    /// Variance of A, covariance, variance of sigma_C^2.
    pub covariance: [f64; 3],
}

/// A rectangle of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Roi {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// Error: no scene variation.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum VariationError {
    /// The calibration has too few levels to determine the noise.
    #[error(
        "the calibration holds no gain and constant noise; calibrate from a campaign with flats of several levels \
         (`radcam plan-calibration` writes such a plan)"
    )]
    NoNoise,
    /// The region leaves the image.
    #[error("region {}, {}, {} x {} px leaves the image of {columns} x {rows} px", roi.x, roi.y, roi.width, roi.height)]
    Region {
        /// The region.
        roi: Roi,
        /// Columns of the image.
        columns: usize,
        /// Rows of the image.
        rows: usize,
    },
    /// Too few pixels for a variance with an error.
    #[error("region of {width} x {height} px is too small; at least 10 x 10 px are needed")]
    Small {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// Most pixels of the region are defects of the sensor.
    #[error(
        "{defects} of the region's {pixels} pixels are defects in the calibration; choose another region"
    )]
    Defects {
        /// Defect pixels.
        defects: usize,
        /// Pixels of the region.
        pixels: usize,
    },
    /// No light to divide by.
    #[error("the region's mean is {mean_dn:.3} DN above the dark reference: no light, no scene variation")]
    Dark {
        /// Mean, DN.
        mean_dn: f64,
    },
}

/// Scene variation of a region, with its components.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Variation {
    /// V_s.
    pub scene_variation: Quantity,
    /// mu_D (eq. 54), DN.
    pub mean_dn: f64,
    /// sigma_D^2 (eq. 55), DN^2.
    pub spatial_var_dn2: f64,
    /// sigma_CN^2 (eq. 56 and 58) over the frames averaged, including the calibration's own errors, DN^2.
    pub noise_var_dn2: f64,
    /// Standard error of V_s from the camera's noise alone: scatter of repeated views of one patch.
    pub repeat_std_err: f64,
    /// Number of sound pixels.
    pub pixels: usize,
    /// Number of frames averaged.
    pub frames: u64,
}

impl CameraNoise {
    /// Takes the camera's noise from a calibration.
    ///
    /// # Errors
    ///
    /// If the calibration holds no gain and constant noise.
    pub fn of(calibration: &Calibration) -> Result<Self, VariationError> {
        let d = &calibration.description;
        match (d.gain_dn_per_e, d.constant_noise_var_dn2) {
            (Some(gain_dn_per_e), Some(constant_noise_var_dn2)) => Ok(Self {
                gain_dn_per_e,
                constant_noise_var_dn2,
                offset_dn: d.offset_dn.unwrap_or(0.0),
                covariance: d.noise_covariance.unwrap_or_default(),
            }),
            _ => Err(VariationError::NoNoise),
        }
    }

    /// Computes sigma_N^2 of one frame at a mean above the black level (eq. 41), DN^2.
    pub fn var_dn2(&self, above_zero_dn: f64) -> f64 {
        self.gain_dn_per_e * above_zero_dn + self.constant_noise_var_dn2
    }
}

/// Returns the part of a map that a region covers.
///
/// # Errors
///
/// If the rectangle leaves the image.
pub fn part<'a, T>(map: &'a Array2<T>, roi: Roi) -> Result<ArrayView2<'a, T>, VariationError> {
    let (rows, columns) = map.dim();
    let fits = |from: usize, size: usize, all: usize| from.checked_add(size).is_some_and(|end| end <= all);
    if !fits(roi.x, roi.width, columns) || !fits(roi.y, roi.height, rows) {
        return Err(VariationError::Region { roi, columns, rows });
    }
    Ok(map.slice(s![roi.y..roi.y + roi.height, roi.x..roi.x + roi.width]))
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
    sum / n
}

/// Computes V_s of a region of a corrected image (mean of `frames` frames, (rows, columns), DN above the dark
/// reference), eq. (54) to (58). `dark_dn` is the dark reference at the image's exposure.
///
/// The variance from the calibration itself is subtracted too: the mean square error of K times the squared
/// mean, and the error of the dark reference. The standard error combines a delete-one-block jackknife over
/// 25 blocks, which allows for a grain wider than a pixel, with the errors of A and sigma_C^2.
///
/// # Errors
///
/// If the region leaves the image, is too small or too dark, or frame and calibration differ in size.
pub fn of_region(
    corrected: &Array2<f32>,
    frames: u64,
    dark_dn: &Array2<f32>,
    calibration: &Calibration,
    roi: Roi,
) -> Result<Variation, VariationError> {
    let noise = CameraNoise::of(calibration)?;
    let view = part(corrected, roi)?;
    let dark = part(dark_dn, roi)?;
    let (k, k_error) = (part(&calibration.k, roi)?, part(&calibration.k_std_err, roi)?);
    let flags = part(&calibration.defects, roi)?;
    if roi.width < 10 || roi.height < 10 {
        return Err(VariationError::Small { width: roi.width, height: roi.height });
    }
    // Defect pixels say nothing of the surface.
    fn sound<'a>(
        map: &'a ArrayView2<'_, f32>,
        flags: &'a ArrayView2<'_, u8>,
    ) -> impl Iterator<Item = f64> + 'a {
        map.iter().zip(flags).filter(|(_, flag)| **flag == 0).map(|(v, _)| f64::from(*v))
    }
    let pixels = sound(&view, &flags).count();
    if 2 * pixels < view.len() {
        return Err(VariationError::Defects { defects: view.len() - pixels, pixels: view.len() });
    }
    let n = pixels as f64;
    let mean_dn = mean(sound(&view, &flags));
    if mean_dn.is_nan() || mean_dn <= 0.0 {
        return Err(VariationError::Dark { mean_dn });
    }
    let spatial_var_dn2 = sound(&view, &flags).map(|d| (d - mean_dn).powi(2)).sum::<f64>() / (n - 1.0);
    let above_zero_dn = mean_dn + mean(sound(&dark, &flags)) - noise.offset_dn;
    let of_k = mean(sound(&k, &flags).map(|k| k.powi(-2)));
    let frames = frames.max(1);
    let temporal = noise.var_dn2(above_zero_dn) * of_k / frames as f64;
    // The dark reference's error d is in K too: it cancels at the level L of K's flats; at mu, d^2 (1 - mu /
    // L)^2 is left.
    let d = &calibration.description;
    let dark_error = d.dark_std_err_dn.unwrap_or(0.0);
    let own = mean(sound(&k_error, &flags).map(|e| e.powi(2))) - d.dark_error_of_k().powi(2);
    let of_dark = dark_error * (1.0 - d.k_level_dn.map_or(0.0, |level| mean_dn / level));
    let noise_var_dn2 = temporal + mean_dn * mean_dn * own.max(0.0) + of_dark * of_dark;
    let value = |var: f64, noise: f64, mean: f64| (var - noise) / (mean * mean);
    let whole = value(spatial_var_dn2, noise_var_dn2, mean_dn);

    // Leaves out each block in turn; sums are enough.
    let sums: Vec<[f64; 3]> = (0..BLOCKS * BLOCKS)
        .map(|block| {
            let span = |i: usize, size: usize| i * size / BLOCKS..(i + 1) * size / BLOCKS;
            let (rows, columns) = (span(block / BLOCKS, roi.height), span(block % BLOCKS, roi.width));
            let at = s![rows, columns];
            sound(&view.slice(at), &flags.slice(at)).fold([0.0; 3], |[n, d, q], v| {
                let off = v - mean_dn;
                [n + 1.0, d + off, q + off * off]
            })
        })
        .collect();
    let total = sums.iter().fold([0.0; 3], |[a, b, c], [n, d, q]| [a + n, b + d, c + q]);
    let left: Vec<f64> = sums
        .iter()
        .map(|[bn, bd, bq]| {
            let (n, d, q) = (total[0] - bn, total[1] - bd, total[2] - bq);
            let off = d / n;
            value((q - n * off * off) / (n - 1.0), noise_var_dn2, mean_dn + off)
        })
        .collect();
    let blocks = left.len() as f64;
    let middle = mean(left.iter().copied());
    let jackknife = (blocks - 1.0) / blocks * left.iter().map(|v| (v - middle).powi(2)).sum::<f64>();
    let [aa, ac, cc] = noise.covariance;
    let of_line = (above_zero_dn * above_zero_dn * aa + 2.0 * above_zero_dn * ac + cc).max(0.0)
        * (of_k / frames as f64 / (mean_dn * mean_dn)).powi(2);
    let std_err = (jackknife + of_line).sqrt();
    // A variation as large as the mean is no surface: the mean is too small to divide by.
    if std_err.is_nan() || (std_err >= 1.0 && whole < 3.0 * std_err) {
        return Err(VariationError::Dark { mean_dn });
    }
    // Repeated view of one patch: variance of a variance of noise about a fixed pattern, 2 v^2 + 4 v
    // (pattern's variance).
    let stays = (spatial_var_dn2 - temporal).max(0.0);
    let again = (2.0 * temporal * temporal + 4.0 * temporal * stays) / n / mean_dn.powi(4);
    Ok(Variation {
        scene_variation: Quantity::new(whole, std_err, "1"),
        mean_dn,
        spatial_var_dn2,
        noise_var_dn2,
        repeat_std_err: (again + of_line).sqrt(),
        pixels,
        frames,
    })
}

/// Computes V_s and its standard error over adjacent windows of `side` pixels, each (windows down, windows
/// across); NaN for a window that is dark, or more than half defect pixels.
///
/// # Errors
///
/// If the region leaves the image, is too small or too dark, or frame and calibration differ in size.
pub fn map(
    corrected: &Array2<f32>,
    frames: u64,
    dark_dn: &Array2<f32>,
    calibration: &Calibration,
    side: usize,
) -> Result<(Array2<f32>, Array2<f32>), VariationError> {
    let (rows, columns) = corrected.dim();
    if side < 10 || side > rows.min(columns) {
        return Err(VariationError::Small { width: side, height: side });
    }
    let shape = (rows / side, columns / side);
    let (mut value, mut error) = (Array2::from_elem(shape, f32::NAN), Array2::from_elem(shape, f32::NAN));
    for y in 0..shape.0 {
        for x in 0..shape.1 {
            let roi = Roi { x: x * side, y: y * side, width: side, height: side };
            match of_region(corrected, frames, dark_dn, calibration, roi) {
                Ok(v) => {
                    value[(y, x)] = v.scene_variation.value as f32;
                    error[(y, x)] = v.scene_variation.std_err as f32;
                }
                Err(VariationError::Dark { .. } | VariationError::Defects { .. }) => {}
                Err(e) => return Err(e),
            }
        }
    }
    Ok((value, error))
}
