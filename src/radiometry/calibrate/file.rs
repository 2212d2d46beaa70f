//! Calibration file: a multi-page TIFF of 32-bit floats with its meaning in the first page's description.
//!
//! Page 0 is the dark reference in DN, page 1 is K with mean 1, then the standard error of K, the flags of
//! defects, and the dark current in DN per second if known. ImageJ, OpenCV and tifffile open the file.

use crate::calibrate::dark::DarkReference;
use crate::calibrate::defects::{ALL_FLAGS, BLIND, Defect};
use crate::calibrate::pattern::FixedPattern;
use crate::dataset::image::ascii;
use crate::dataset::{CameraInfo, write_whole};
use crate::input::{self, echo, echo_message};
use ndarray::Array2;
use serde::{Deserialize, Serialize};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use tiff::decoder::{Decoder, DecodingResult};
use tiff::encoder::{TiffEncoder, colortype::Gray32Float};
use tiff::tags::Tag;

/// Name and major version of the format.
pub const FORMAT: &str = "radcam-calibration/1";

/// JSON object in the first page's ImageDescription.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// [`FORMAT`].
    pub format: String,
    /// Camera and settings for which the calibration is valid.
    pub camera: CameraInfo,
    /// Contents of each page.
    pub pages: Vec<String>,
    /// Exposure of the dark reference, s.
    pub dark_exposure_s: f64,
    /// A, DN per electron.
    pub gain_dn_per_e: Option<f64>,
    /// sigma_C^2, DN^2.
    pub constant_noise_var_dn2: Option<f64>,
    /// Black level at zero exposure, DN.
    pub offset_dn: Option<f64>,
    /// Variance of A, covariance of A and sigma_C^2, variance of sigma_C^2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_covariance: Option<[f64; 3]>,
    /// Standard error of the dark reference, DN.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dark_std_err_dn: Option<f64>,
    /// Standard error of the dark current, DN per second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dark_current_std_err_dn_per_s: Option<f64>,
    /// Mean above the dark reference at which K was measured, DN: there the dark reference's error enters K,
    /// with the other sign.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k_level_dn: Option<f64>,
    /// Number of pixels with a flag in the map of defects.
    #[serde(default)]
    pub defects: usize,
    /// Number of blind pixels among them.
    #[serde(default)]
    pub blind: usize,
    /// Number n1 of configurations.
    pub n1: usize,
    /// Number n2 of frames averaged in each.
    pub n2: usize,
    /// Estimator of K.
    pub estimator: String,
    /// Source of the calibration.
    pub provenance: String,
}

/// Calibration in memory.
#[derive(Debug, Clone)]
pub struct Calibration {
    /// Description and validity.
    pub description: Description,
    /// Dark reference.
    pub dark: DarkReference,
    /// K, (rows, columns), mean 1.
    pub k: Array2<f32>,
    /// Standard error of K.
    pub k_std_err: Array2<f32>,
    /// Flags of [`super::defects`], 0 for a sound pixel.
    pub defects: Array2<u8>,
}

/// Error: a calibration file cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {message}")]
pub struct FileError {
    path: PathBuf,
    message: String,
}

const DARK: &str = "dark_reference_dn";
const K: &str = "k";
const K_ERROR: &str = "k_std_err";
const CURRENT: &str = "dark_current_dn_per_s";
const DEFECTS: &str = "defects";

impl Description {
    /// Returns true if K contains the light of the flats: a correction removes lens shading, lamp and card as
    /// well.
    pub fn is_flat_field(&self) -> bool {
        self.estimator.starts_with(super::flat_field::NAME)
    }

    /// Error of K from the dark reference: that of the reference over the level at which K was measured.
    pub fn dark_error_of_k(&self) -> f64 {
        match (self.dark_std_err_dn, self.k_level_dn) {
            (Some(error), Some(level)) => error / level,
            _ => 0.0,
        }
    }

    /// Kind of correction, as text.
    pub fn correction(&self) -> &'static str {
        if self.is_flat_field() {
            "flat-field: the light of the flats is taken off"
        } else {
            "by the pixels' own response: the light stays"
        }
    }

    /// Refuses impossible values.
    ///
    /// # Errors
    ///
    /// Key and value.
    pub fn check(&self) -> Result<(), String> {
        self.camera.check()?;
        let (width, height, bits) = (self.camera.width, self.camera.height, self.camera.bit_depth);
        if !(1..=16).contains(&bits) {
            return Err(format!("camera.bit_depth is {bits}, and must lie within 1 to 16"));
        }
        if width.min(height) == 0 || width.max(height) > 1 << 16 {
            return Err(format!("camera size {width} x {height} px makes no image"));
        }
        /// Maximum level of 16-bit codes, DN; its square, for variances, DN^2.
        const MAX_DN: f64 = 65_536.0;
        let some = |name, value: Option<f64>, min, max| value.map(|v| (name, v, min, max));
        let [var_gain, _, var_noise] = self.noise_covariance.map_or([None; 3], |c| c.map(Some));
        let covariance = self.noise_covariance.map(|c| c[1]);
        // A dark reference of no exposure is the black level alone; a day exceeds any exposure.
        let bounds = [
            some("dark_exposure_s", Some(self.dark_exposure_s), 0.0, 86_400.0),
            some("gain_dn_per_e", self.gain_dn_per_e, f64::MIN_POSITIVE, MAX_DN),
            some("constant_noise_var_dn2", self.constant_noise_var_dn2, 0.0, MAX_DN * MAX_DN),
            some("offset_dn", self.offset_dn, -MAX_DN, MAX_DN),
            some("dark_std_err_dn", self.dark_std_err_dn, 0.0, MAX_DN),
            some("dark_current_std_err_dn_per_s", self.dark_current_std_err_dn_per_s, 0.0, f64::MAX),
            some("k_level_dn", self.k_level_dn, f64::MIN_POSITIVE, MAX_DN),
            some("noise_covariance[0]", var_gain, 0.0, f64::MAX),
            some("noise_covariance[1]", covariance, -f64::MAX, f64::MAX),
            some("noise_covariance[2]", var_noise, 0.0, f64::MAX),
        ];
        for (name, value, min, max) in bounds.into_iter().flatten() {
            if !(min..=max).contains(&value) {
                let wanted = match (min, max) {
                    (0.0, f64::MAX) => "must not be below 0".into(),
                    (f64::MIN_POSITIVE, _) => format!("must be above 0 and at most {max}"),
                    _ => format!("must lie within {min} to {max}"),
                };
                return Err(format!("{name} is {value}, and {wanted}"));
            }
        }
        Ok(())
    }

    /// Creates a description of the camera only.
    pub fn of(camera: CameraInfo) -> Self {
        Self {
            format: FORMAT.into(),
            camera,
            pages: Vec::new(),
            dark_exposure_s: 0.0,
            gain_dn_per_e: None,
            constant_noise_var_dn2: None,
            offset_dn: None,
            noise_covariance: None,
            dark_std_err_dn: None,
            dark_current_std_err_dn_per_s: None,
            k_level_dn: None,
            defects: 0,
            blind: 0,
            n1: 0,
            n2: 0,
            estimator: String::new(),
            provenance: String::new(),
        }
    }
}

/// Refuses an impossible K.
fn check_k(k: &Array2<f32>, defects: &Array2<u8>) -> Result<(), String> {
    /// Bounds of K.
    const BOUNDS: (f32, f32) = (0.1, 10.0);
    /// Bounds of K for a flagged pixel: it is not used, but visible in a corrected frame.
    const BOUNDS_OF_DEFECTS: (f32, f32) = (1e-3, 1e3);
    /// Bounds of the mean of K: 1 by definition, apart from defects, shading at the rim and rounding.
    const MEANS: (f64, f64) = (0.8, 1.25);
    let (mut sum, mut sound) = (0.0, 0usize);
    for (((y, x), k), flags) in k.indexed_iter().zip(defects) {
        let (min, max) = if *flags == 0 { BOUNDS } else { BOUNDS_OF_DEFECTS };
        if !(min..=max).contains(k) {
            return Err(format!("K is {k} at row {y}, column {x}, and must lie within {min} to {max}"));
        }
        if *flags == 0 {
            sum += f64::from(*k);
            sound += 1;
        }
    }
    let mean = if sound == 0 { 1.0 } else { sum / sound as f64 };
    if !(MEANS.0..=MEANS.1).contains(&mean) {
        return Err(format!("K has the mean {mean:.3}, and must have 1"));
    }
    Ok(())
}

/// Converts the page of defects to flags.
fn flags_of(page: &Array2<f32>) -> Result<Array2<u8>, String> {
    let known = |f: f32| f.fract() == 0.0 && (0.0..=f32::from(ALL_FLAGS)).contains(&f);
    match page.indexed_iter().find(|(_, f)| !known(**f)) {
        None => Ok(page.mapv(|f| f as u8)),
        Some(((y, x), f)) => Err(format!(
            "page {DEFECTS} holds {f} at row {y}, column {x}; flags are whole numbers from 0 to {ALL_FLAGS}"
        )),
    }
}

impl Calibration {
    /// Assembles a calibration; `description.format` and `.pages` are filled in.
    pub fn new(
        mut description: Description,
        dark: DarkReference,
        pattern: FixedPattern,
        found: &[Defect],
    ) -> Self {
        description.format = FORMAT.into();
        description.dark_std_err_dn = Some(dark.std_err_dn).filter(|e| e.is_finite());
        description.dark_current_std_err_dn_per_s =
            Some(dark.current_std_err_dn_per_s).filter(|e| e.is_finite());
        let mut defects = Array2::zeros(pattern.k.dim());
        for d in found {
            defects[(d.y, d.x)] = d.flags;
        }
        description.defects = found.len();
        description.blind = found.iter().filter(|d| d.flags & BLIND != 0).count();
        description.k_level_dn = Some(pattern.level_dn).filter(|l| l.is_finite() && *l > 0.0);
        // All configurations share the subtracted dark reference: its error does not average out.
        let shared = description.dark_error_of_k() as f32;
        description.dark_exposure_s = dark.exposure_s;
        description.pages = vec![DARK.into(), K.into(), K_ERROR.into(), DEFECTS.into()];
        if dark.current_dn_per_s.is_some() {
            description.pages.push(CURRENT.into());
        }
        Self {
            description,
            dark,
            k: pattern.k,
            k_std_err: pattern.std_err.mapv(|e| e.hypot(shared)),
            defects,
        }
    }

    /// Standard deviation of a pixel's noise in the dark, with the shot noise of the charge that brings it to
    /// `dark_dn`, DN (eq. 41); 1 DN if unknown or smaller.
    pub fn dark_noise_dn(&self, dark_dn: f32) -> f64 {
        let d = &self.description;
        let charge_dn = d.offset_dn.map_or(0.0, |offset| f64::from(dark_dn) - offset);
        let shot_dn2 = d.gain_dn_per_e.unwrap_or(0.0) * charge_dn.max(0.0);
        (d.constant_noise_var_dn2.unwrap_or(0.0) + shot_dn2).max(1.0).sqrt()
    }

    /// Period of a colour in rows and columns, pixels: 2 for a mosaic, otherwise 1.
    pub fn period(&self) -> usize {
        if self.description.camera.is_mosaic() { 2 } else { 1 }
    }

    /// Writes the file atomically, after checking that [`read`](Self::read) accepts it.
    ///
    /// # Errors
    ///
    /// If the file cannot be written, or could not be read again.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        let bytes = self.to_bytes(path)?;
        Self::from_bytes(&bytes, path).map_err(|e| FileError {
            message: format!("not written: it could not be read again ({})", e.message),
            ..e
        })?;
        write_whole(path, &bytes).map_err(|e| FileError { path: path.into(), message: e.to_string() })
    }

    fn to_bytes(&self, path: &Path) -> Result<Vec<u8>, FileError> {
        let fault = |message: String| FileError { path: path.into(), message };
        let mut out = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut out).map_err(|e| fault(e.to_string()))?;
        let text = serde_json::to_string(&self.description).map_err(|e| fault(e.to_string()))?;
        let defects = self.defects.mapv(f32::from);
        let pages = [
            Some(&self.dark.level_dn),
            Some(&self.k),
            Some(&self.k_std_err),
            Some(&defects),
            self.dark.current_dn_per_s.as_ref(),
        ];
        for (i, page) in pages.into_iter().flatten().enumerate() {
            let (height, width) = page.dim();
            let standard = page.as_standard_layout();
            let mut image = encoder
                .new_image::<Gray32Float>(width as u32, height as u32)
                .map_err(|e| fault(e.to_string()))?;
            if i == 0 {
                let tag = image.encoder().write_tag(Tag::ImageDescription, ascii(&text).as_str());
                tag.map_err(|e| fault(e.to_string()))?;
            }
            image.write_data(standard.as_slice().unwrap_or_default()).map_err(|e| fault(e.to_string()))?;
        }
        Ok(out.into_inner())
    }

    /// Reads a file; truncated or edited files and other versions are refused with the file's name.
    ///
    /// # Errors
    ///
    /// If the file cannot be read or is no calibration.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let bytes =
            input::bytes(path).map_err(|e| FileError { path: path.into(), message: e.to_string() })?;
        Self::from_bytes(&bytes, path)
    }

    /// Reads a calibration from bytes; `path` is used in errors.
    fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, FileError> {
        let fault = |message: String| FileError { path: path.into(), message };
        let broken = |e: tiff::TiffError| fault(format!("not a sound calibration file: {e}"));
        let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(broken)?;
        let text = decoder.get_tag_ascii_string(Tag::ImageDescription).map_err(|_| {
            fault("no calibration file (no ImageDescription); `radcam calibrate` makes one".into())
        })?;
        let value: serde_json::Value = serde_json::from_str(text.trim_end_matches('\0')).map_err(|e| {
            let e = echo_message(&e.to_string());
            fault(format!("no calibration file (its ImageDescription is no JSON object: {e}); `radcam calibrate` makes one"))
        })?;
        match value.get("format").and_then(|f| f.as_str()) {
            Some(FORMAT) => {}
            other => {
                let Some(other) = other else {
                    return Err(fault("no calibration file; `radcam calibrate` makes one".into()));
                };
                return Err(fault(format!(
                    "format is \"{}\", and this program reads \"{FORMAT}\"",
                    echo(other)
                )));
            }
        }
        let description: Description = serde_json::from_value(value).map_err(|e| {
            fault(format!("its ImageDescription was changed: {}", echo_message(&e.to_string())))
        })?;
        description.check().map_err(fault)?;
        let size = (description.camera.height, description.camera.width);
        let mut pages = std::collections::HashMap::new();
        for (i, name) in description.pages.iter().enumerate() {
            if i > 0 {
                if !decoder.more_images() {
                    return Err(fault(format!("page {i} ({name}) is missing")));
                }
                decoder.next_image().map_err(broken)?;
            }
            let (width, height) = decoder.dimensions().map_err(broken)?;
            let DecodingResult::F32(values) = decoder.read_image().map_err(broken)? else {
                return Err(fault(format!("page {i} ({name}) is not of 32-bit floats")));
            };
            let page = Array2::from_shape_vec((height as usize, width as usize), values)
                .ok()
                .filter(|page| page.dim() == size)
                .ok_or_else(|| {
                    fault(format!(
                        "page {i} ({name}) is {width} x {height} px, and its camera {} x {} px",
                        size.1, size.0
                    ))
                })?;
            if !page.iter().all(|v| v.is_finite()) {
                return Err(fault(format!("page {i} ({name}) holds values that are no numbers")));
            }
            pages.insert(name.clone(), page);
        }
        let mut take = |name: &str| pages.remove(name).ok_or_else(|| fault(format!("has no page {name}")));
        let (level_dn, k, k_std_err) = (take(DARK)?, take(K)?, take(K_ERROR)?);
        if let Some(((y, x), e)) = k_std_err.indexed_iter().find(|(_, e)| **e < 0.0) {
            return Err(fault(format!(
                "page {K_ERROR} holds {e} at row {y}, column {x}; a standard error is 0 or more"
            )));
        }
        let dark = DarkReference {
            exposure_s: description.dark_exposure_s,
            level_dn,
            current_dn_per_s: take(CURRENT).ok(),
            std_err_dn: description.dark_std_err_dn.unwrap_or(f64::NAN),
            current_std_err_dn_per_s: description.dark_current_std_err_dn_per_s.unwrap_or(f64::NAN),
            var_dn2: f64::NAN,
        };
        let defects = match take(DEFECTS) {
            Ok(flags) => flags_of(&flags).map_err(fault)?,
            Err(_) => Array2::zeros(k.dim()),
        };
        check_k(&k, &defects).map_err(fault)?;
        Ok(Self { description, dark, k, k_std_err, defects })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn calibration(current: bool) -> Calibration {
        let plane = |value: f32| Array2::from_shape_fn((3, 4), |(y, x)| value + 0.01 * (4 * y + x) as f32);
        let dark = DarkReference {
            exposure_s: 0.02,
            level_dn: plane(64.0),
            current_dn_per_s: current.then(|| plane(2.0)),
            std_err_dn: 0.1,
            current_std_err_dn_per_s: f64::NAN,
            var_dn2: 1.0,
        };
        let pattern = FixedPattern {
            k: plane(0.9),
            std_err: plane(0.001),
            kept: Array2::from_elem((3, 4), 9),
            pooled_sd: 0.003,
            mean_before: 1.0,
            level_dn: 900.0,
        };
        let camera = CameraInfo { width: 4, height: 3, bit_depth: 12, ..Default::default() };
        let description = Description {
            gain_dn_per_e: Some(0.38),
            constant_noise_var_dn2: Some(1.06),
            noise_covariance: Some([1e-8, 0.0, 1e-4]),
            n1: 12,
            n2: 18,
            ..Description::of(camera)
        };
        let defect = Defect { y: 1, x: 2, flags: 5, dark_excess_dn: 9.0, k: 1.0, variance_ratio: 6.0 };
        Calibration::new(description, dark, pattern, &[defect])
    }

    #[test]
    fn a_calibration_survives_a_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("cal.tiff");
        for current in [false, true] {
            let written = calibration(current);
            written.write(&path).unwrap();
            let read = Calibration::read(&path).unwrap();
            assert_eq!(read.description, written.description);
            assert_eq!((&read.k, &read.k_std_err), (&written.k, &written.k_std_err));
            assert_eq!((&read.defects, read.defects[(1, 2)]), (&written.defects, 5));
            assert_eq!(read.dark.level_dn, written.dark.level_dn);
            assert_eq!(read.dark.current_dn_per_s, written.dark.current_dn_per_s);
        }
    }

    /// The writer is as strict as the reader, and writes no file that the reader would refuse.
    #[test]
    fn what_could_not_be_read_is_not_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("cal.tiff");
        for bad in [-0.0003, f32::NAN] {
            let mut calibration = calibration(true);
            calibration.k[(1, 1)] = bad;
            let message = calibration.write(&path).unwrap_err().to_string();
            assert!(message.contains("not written") && !path.exists(), "{message}");
        }
    }

    #[test]
    fn what_was_cut_or_edited_is_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("cal.tiff");
        calibration(true).write(&path).unwrap();
        let good = std::fs::read(&path).unwrap();
        let refused = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            Calibration::read(&path).unwrap_err().to_string()
        };
        let edit = |from: &str, to: &str| {
            assert_eq!(from.len(), to.len());
            let at = good.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
            [&good[..at], to.as_bytes(), &good[at + from.len()..]].concat()
        };
        assert!(refused(&edit("calibration/1", "calibration/7")).contains("radcam-calibration/7"));
        assert!(refused(&edit("\"width\":4", "\"width\":5")).contains("4 x 3 px, and its camera 5 x 3 px"));
        assert!(refused(&edit("\"n1\":12", "\"n1\":-1")).contains("was changed"));
        for cut in (0..good.len()).step_by(7) {
            assert!(refused(&good[..cut]).contains("cal.tiff"), "cut at {cut}");
        }
    }
}
