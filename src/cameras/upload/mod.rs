//! Upload of a calibration into a camera's own memory. The camera then corrects its frames itself, and any
//! software receives corrected images.
//!
//! Each kind of memory is one file here, with its `Memory`, and one line below. Coefficient files have a
//! proprietary layout; an unknown layout is not written.

use crate::calibrate::file::Calibration;
use crate::camera::{Camera, CameraError, Value};
use crate::correct::CorrectError;
use crate::flat_field::FlatField;
use crate::stream::{StreamError, prepare};
use serde::{Deserialize, Serialize};

macro_rules! memories {
    ($($module:ident)*) => {
        $(mod $module;)*

        /// All kinds of memory; for each map, the best first.
        static MEMORIES: &[Memory] = &[$($module::MEMORY),*];
    };
}

memories! {
    user_flat_field
    ffc_user_table
    defect_table
}

/// Contents of a memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Map {
    /// Offsets and factors.
    FlatField,
    /// List of defective pixels.
    Defects,
}

/// Kind of camera memory.
struct Memory {
    map: Map,
    /// Name, in words.
    name: &'static str,
    /// Features required for this kind of memory.
    features: &'static [&'static str],
    /// Entry of `FileSelector` required for this kind of memory.
    file: Option<&'static str>,
    write: Write,
}

/// Function that writes the content. It reports the share done, and stops when the answer is false.
type Write = fn(&mut dyn Camera, &Content<'_>, &mut dyn FnMut(f64) -> bool) -> Result<Written, UploadError>;

/// Content to write.
struct Content<'a> {
    calibration: &'a Calibration,
    flat_field: FlatField,
    /// Number of clipped coefficients.
    cut: usize,
    exposure_s: f64,
    /// Saves the tables beyond power-off, if that is a command of its own.
    save: bool,
}

/// Result for one memory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Written {
    /// Map in the memory.
    pub map: Map,
    /// Name of the memory, in words.
    pub memory: String,
    /// Number of pixels, columns or defects written and verified by readback.
    pub entries: usize,
    /// Losses: rounding, and entries that did not fit.
    pub remarks: Vec<String>,
    /// Features set to activate the correction.
    pub switched_on: Vec<String>,
}

/// Result of an upload.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Uploaded {
    /// Camera.
    pub camera: String,
    /// Exposure for which the offsets hold, s.
    pub exposure_s: f64,
    /// Output code at 0 DN above the dark reference.
    pub black_dn: u16,
    /// Results of each memory.
    pub written: Vec<Written>,
    /// Maps without a memory that radcam can write.
    pub without: Vec<Map>,
}

/// Reason why a calibration was not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UploadError {
    /// Camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The camera is not the calibrated one, or has other settings.
    #[error(transparent)]
    Prepare(#[from] StreamError),
    /// The dark reference does not cover the exposure.
    #[error(transparent)]
    Correct(#[from] CorrectError),
    /// No writable memory, or the memory failed.
    #[error("camera {camera}: {message}")]
    Memory {
        /// Camera id.
        camera: String,
        /// Reason, and what to do.
        message: String,
    },
    /// Stopped on request.
    #[error("interrupted: the camera's memory holds a part of the maps, and is switched off")]
    Interrupted,
}

/// Options of an upload.
#[derive(Debug, Clone, Copy, Default)]
pub struct Options {
    /// Exposure for which the offsets hold, s; `None`: the current exposure of the camera.
    pub exposure_s: Option<f64>,
    /// Saves the tables beyond power-off, if that is a command of its own.
    pub save: bool,
}

/// Writes a calibration into a camera's own memory, reads it back, and switches it on. `go_on` receives the
/// share done; returning false stops the upload.
///
/// # Errors
///
/// The camera is not the calibrated one, has no known memory, or refuses.
pub fn upload(
    camera: &mut dyn Camera,
    calibration: &Calibration,
    options: Options,
    go_on: &mut dyn FnMut(f64) -> bool,
) -> Result<Uploaded, UploadError> {
    let settings = prepare(camera, calibration, options.exposure_s)?;
    let id = camera.identity().id.clone();
    let fault = |message: String| UploadError::Memory { camera: id.clone(), message };
    // Files and lists cover the whole sensor.
    let (region, whole) = (settings.region, camera.capabilities());
    if (f64::from(region.width), f64::from(region.height)) != (whole.width.max, whole.height.max) {
        return Err(fault(format!(
            "its memory is of all {} x {} px of the sensor, and the calibration of a region of {} x {} px: calibrate the whole sensor",
            whole.width.max, whole.height.max, region.width, region.height
        )));
    }
    let (flat_field, cut) = FlatField::of(calibration, settings.exposure_s)?;
    let black_dn = flat_field.black_dn();
    let content =
        Content { calibration, flat_field, cut, exposure_s: settings.exposure_s, save: options.save };
    let files = camera.files();
    let (mut written, mut without) = (Vec::new(), Vec::new());
    for map in [Map::FlatField, Map::Defects] {
        let found = MEMORIES.iter().find(|m| {
            m.map == map
                && m.features.iter().all(|f| camera.has_feature(f))
                && m.file.is_none_or(|file| files.iter().any(|f| f == file))
        });
        match found {
            Some(memory) => written.push((memory.write)(camera, &content, go_on)?),
            None => without.push(map),
        }
    }
    if written.is_empty() {
        let known: Vec<&str> = MEMORIES.iter().map(|m| m.name).collect();
        let files = match &files[..] {
            [] => "it offers no files".into(),
            files => format!("the layout of its files ({}) is its maker's and not known", files.join(", ")),
        };
        return Err(fault(format!(
            "it has no memory that radcam can write: {}; {files}. `radcam stream --serve-as` offers corrected frames without it",
            known.join("; ")
        )));
    }
    Ok(Uploaded { camera: id, exposure_s: content.exposure_s, black_dn, written, without })
}

/// Sets a feature and records it in `said`.
fn switch_on(
    camera: &mut dyn Camera,
    name: &str,
    value: Value,
    said: &mut Vec<String>,
) -> Result<(), UploadError> {
    camera.set_feature(name, &value)?;
    said.push(format!("{name} = {value}"));
    Ok(())
}

/// Executes a command that saves a table, if requested and available.
fn save(
    camera: &mut dyn Camera,
    content: &Content<'_>,
    command: &str,
    remarks: &mut Vec<String>,
) -> Result<(), UploadError> {
    if !camera.has_feature(command) {
        return Ok(());
    }
    if content.save {
        camera.execute(command)?;
    } else {
        remarks.push(format!("lost when the camera is switched off: --save executes {command}"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::dark::DarkReference;
    use crate::calibrate::file::Description;
    use crate::calibrate::pattern::FixedPattern;
    use crate::camera::{Bounds, Capabilities, FrameStream, Identity, Settings, StreamOptions};
    use crate::dataset::CameraInfo;
    use crate::frame::Region;
    use crate::pixel_format::PixelFormat;
    use ndarray::Array2;
    use std::collections::BTreeMap;

    /// Camera with tables as described by FLIR: a value for each index.
    struct Flir {
        identity: Identity,
        capabilities: Capabilities,
        index: BTreeMap<&'static str, i64>,
        values: BTreeMap<(String, i64), Value>,
        commands: Vec<String>,
    }

    const SIZE: (u32, u32) = (8, 4);
    const TABLES: [(&str, &str); 4] = [
        ("FfcUserGain", "FfcUserTableXCoordinate"),
        ("FfcUserOffset", "FfcUserTableXCoordinate"),
        ("DefectTableCoordinateX", "DefectTableIndex"),
        ("DefectTableCoordinateY", "DefectTableIndex"),
    ];

    impl Flir {
        fn new() -> Self {
            let side = |max: u32| Bounds { min: 1.0, max: max.into(), increment: None };
            let capabilities = Capabilities {
                exposure_s: None,
                gain_db: None,
                black_level_dn: None,
                frame_rate_hz: None,
                width: side(SIZE.0),
                height: side(SIZE.1),
                offset_increment: (1, 1),
                pixel_formats: vec![PixelFormat::MONO16],
                software_trigger: false,
            };
            let identity = Identity { id: "flir".into(), ..Default::default() };
            Self {
                identity,
                capabilities,
                index: BTreeMap::new(),
                values: BTreeMap::new(),
                commands: Vec::new(),
            }
        }

        fn place(&self, name: &str) -> (String, i64) {
            let index = TABLES.iter().find(|t| t.0 == name).and_then(|t| self.index.get(t.1));
            (name.into(), index.copied().unwrap_or(0))
        }
    }

    impl Camera for Flir {
        fn identity(&self) -> &Identity {
            &self.identity
        }
        fn capabilities(&self) -> &Capabilities {
            &self.capabilities
        }
        fn settings(&mut self) -> Result<Settings, CameraError> {
            Ok(Settings {
                exposure_s: 0.01,
                gain_db: None,
                black_level_dn: None,
                frame_rate_hz: None,
                pixel_format: PixelFormat::MONO16,
                region: Region { x: 0, y: 0, width: SIZE.0, height: SIZE.1 },
                temperature_c: None,
            })
        }
        fn set_exposure_s(&mut self, _: f64) -> Result<f64, CameraError> {
            Err(self.not_available("ExposureTime"))
        }
        fn set_pixel_format(&mut self, _: PixelFormat) -> Result<PixelFormat, CameraError> {
            Err(self.not_available("PixelFormat"))
        }
        fn set_region(&mut self, _: Region) -> Result<Region, CameraError> {
            Err(self.not_available("Width"))
        }
        fn stream(&mut self, _: &StreamOptions) -> Result<Box<dyn FrameStream + '_>, CameraError> {
            Err(self.not_available("stream"))
        }
        fn has_feature(&mut self, name: &str) -> bool {
            name.starts_with("Ffc") || name.starts_with("Defect")
        }
        fn set_feature(&mut self, name: &str, value: &Value) -> Result<Value, CameraError> {
            match (TABLES.iter().find(|t| t.1 == name), value) {
                (Some((_, index)), Value::Int(at)) => drop(self.index.insert(index, *at)),
                _ => drop(self.values.insert(self.place(name), value.clone())),
            }
            Ok(value.clone())
        }
        fn feature(&mut self, name: &str) -> Result<Value, CameraError> {
            self.values.get(&self.place(name)).cloned().ok_or_else(|| self.not_available(name))
        }
        fn largest(&mut self, name: &str) -> Option<f64> {
            (name == "DefectTablePixelCount").then_some(2.0)
        }
        fn execute(&mut self, command: &str) -> Result<(), CameraError> {
            self.commands.push(command.into());
            Ok(())
        }
    }

    /// The tables implement eq. (51) by column: the dark level of each column is mapped to that of the
    /// sensor, and its signal is multiplied by 1/K. Two of three defects fit.
    #[test]
    fn tables_of_columns_and_of_defects_are_filled() {
        let shape = (SIZE.1 as usize, SIZE.0 as usize);
        let dark = DarkReference {
            exposure_s: 0.01,
            level_dn: Array2::from_shape_fn(shape, |(_, x)| 100.0 + 8.0 * x as f32),
            current_dn_per_s: None,
            std_err_dn: 0.1,
            current_std_err_dn_per_s: f64::NAN,
            var_dn2: 1.0,
        };
        let pattern = FixedPattern {
            k: Array2::from_shape_fn(shape, |(_, x)| 0.9 + 0.03 * x as f32),
            std_err: Array2::zeros(shape),
            kept: Array2::from_elem(shape, 9),
            pooled_sd: 0.003,
            mean_before: 1.0,
            level_dn: 900.0,
        };
        let camera = CameraInfo {
            width: shape.1,
            height: shape.0,
            bit_depth: 16,
            pixel_format: "Mono16".into(),
            ..Default::default()
        };
        let mut calibration = Calibration::new(Description::of(camera), dark, pattern, &[]);
        for at in [(0, 2), (1, 3), (2, 7)] {
            calibration.defects[at] = 1;
        }
        let mut camera = Flir::new();
        let done = upload(&mut camera, &calibration, Options::default(), &mut |_| true).unwrap();
        assert_eq!(done.written.iter().map(|w| w.entries).collect::<Vec<_>>(), [8, 2]);
        assert!(done.without.is_empty() && camera.commands == ["DefectTableApply"]);
        assert!(done.written[1].remarks[0].contains("1 of 3 defects do not fit"), "{done:?}");
        let number = |camera: &Flir, name: &str, at: i64| match camera.values[&(name.to_string(), at)] {
            Value::Int(v) => v as f64,
            Value::Float(v) => v,
            _ => f64::NAN,
        };
        for x in 0..8 {
            let (dark_dn, k) = (100.0 + 8.0 * x as f64, 0.9 + 0.03 * x as f64);
            let p = |u: f64| number(&camera, "FfcUserGain", x) * (u + number(&camera, "FfcUserOffset", x));
            // Tolerance 0.6 DN: an offset is a whole number.
            assert!((p(dark_dn) - f64::from(done.black_dn)).abs() < 0.6, "{x}");
            assert!((p(dark_dn + 9000.0 * k) - p(dark_dn) - 9000.0).abs() < 0.1, "{x}");
        }
        let places =
            [0, 1].map(|i| ["X", "Y"].map(|c| number(&camera, &format!("DefectTableCoordinate{c}"), i)));
        // (2, 7) has the largest |K - 1|, then (0, 2).
        assert_eq!(places, [[2.0, 0.0], [7.0, 2.0]]);
        let save = Options { save: true, ..Options::default() };
        upload(&mut camera, &calibration, save, &mut |_| true).unwrap();
        assert_eq!(camera.commands[1..], ["FfcUserTableSave", "DefectTableApply", "DefectTableSave"]);
        let stopped = upload(&mut camera, &calibration, save, &mut |_| false);
        assert!(matches!(stopped, Err(UploadError::Interrupted)));
    }
}
