//! Helpers: the program, small cameras, fixtures, the one GigE Vision port.

use radcam::bench::SharedBench;
use radcam::calibrate::dark::DarkReference;
use radcam::calibrate::file::{Calibration, Description};
use radcam::calibrate::pattern::FixedPattern;
use radcam::camera::sim::SimCamera;
use radcam::dataset::CameraInfo;
use radcam::ndarray::Array2;
use radcam_sim::{Model, Sensor, sensors};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;

/// A sensor of the catalogue, cut down to a small frame.
pub fn small(name: &str, width: u32, height: u32) -> Model {
    let mut model = sensors::load(name).unwrap();
    (model.camera.width, model.camera.height) = (width, height);
    model
}

/// A simulated camera of a model, before a bench.
pub fn camera(model: Model) -> (SimCamera, SharedBench) {
    let bench = SharedBench::default();
    (SimCamera::new("test", Arc::new(Sensor::new(model).unwrap()), bench.clone()), bench)
}

/// The program; another one than this checkout's where RADCAM_PROGRAM names it.
pub fn program() -> Command {
    Command::new(std::env::var("RADCAM_PROGRAM").unwrap_or_else(|_| env!("CARGO_BIN_EXE_radcam").into()))
}

/// Runs the program.
pub fn radcam(arguments: &[&str]) -> Output {
    program().args(arguments).output().unwrap()
}

/// Standard output of a run that must end with this exit code.
pub fn expect(code: i32, arguments: &[&str]) -> String {
    let output = radcam(arguments);
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(code), "radcam {arguments:?}\n{out}\n{err}");
    out.into_owned()
}

/// Standard error of a run that must fail with exit code 2, and never by a panic.
pub fn refused(arguments: &[&str]) -> String {
    let output = radcam(arguments);
    let err = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "radcam {arguments:?}\n{err}");
    assert!(!err.contains("panicked"), "{err}");
    err
}

/// A folder beside the repository that only some checkouts have; says so where it is missing.
pub fn shared(folder: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared").join(folder);
    if path.exists() {
        return Some(path);
    }
    assert!(std::env::var_os("RADCAM_TEST_SHARED").is_none(), "{} is not there", path.display());
    println!("SKIPPED: {} is not there", path.display());
    None
}

/// The GigE Vision port of the loopback: one served camera at a time on this machine.
///
/// A file lock, so that it holds between processes too (some test runners start one for each test).
#[cfg(feature = "aravis")]
pub fn gige_port() -> std::fs::File {
    let path = std::env::temp_dir().join("radcam-test-gige.lock");
    let file = std::fs::File::create(path).unwrap();
    file.lock().unwrap();
    file
}

/// A model file of a sensor with fewer pixels.
pub fn small_sensor(folder: &Path, sensor: &str, width: u32, height: u32) -> PathBuf {
    let mut model = radcam_sim::sensors::load(sensor).unwrap();
    (model.camera.width, model.camera.height) = (width, height);
    let path = folder.join(format!("{sensor}.toml"));
    std::fs::write(&path, model.to_toml().unwrap()).unwrap();
    path
}

/// A calibration of a 12-bit camera of which dark reference, DN, and K of every pixel are given by its place.
pub fn calibration(
    model: &str,
    serial: &str,
    shape: (usize, usize),
    maps: impl Fn(usize) -> (f32, f32),
) -> Calibration {
    let plane = |value: &dyn Fn(usize) -> f32| Array2::from_shape_fn(shape, |(y, x)| value(y * shape.1 + x));
    let dark = DarkReference {
        exposure_s: 0.01,
        level_dn: plane(&|i| maps(i).0),
        current_dn_per_s: Some(plane(&|_| 0.0)),
        std_err_dn: 0.1,
        current_std_err_dn_per_s: f64::NAN,
        var_dn2: 1.0,
    };
    let pattern = FixedPattern {
        k: plane(&|i| maps(i).1),
        std_err: plane(&|_| 0.001),
        kept: Array2::from_elem(shape, 9),
        pooled_sd: 0.003,
        mean_before: 1.0,
        level_dn: 900.0,
    };
    let camera = CameraInfo {
        vendor: "radcam".into(),
        model: model.into(),
        serial: serial.into(),
        width: shape.1,
        height: shape.0,
        bit_depth: 12,
        pixel_format: "Mono12".into(),
        ..Default::default()
    };
    Calibration::new(Description::of(camera), dark, pattern, &[])
}
