//! Rust part of the Python package `radcam`. The package itself, with its types and documentation, is in
//! `python/radcam`.

mod calibration;
mod camera;
mod effect;
mod errors;
mod frames;
mod logs;
mod verbs;
mod work;

use pyo3::prelude::*;

/// The program, with the arguments of `sys.argv`.
#[pyfunction]
fn main(py: Python<'_>, arguments: Vec<String>) -> u8 {
    py.detach(|| radcam::cli::run(arguments.into_iter().map(Into::into)))
}

#[pymodule]
fn _radcam(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add("__version__", env!("CARGO_PKG_VERSION"))?;
    m.add("HAS_ARAVIS", cfg!(feature = "aravis"))?;
    m.add_function(wrap_pyfunction!(main, m)?)?;
    errors::add(m)?;
    verbs::add(m)?;
    frames::add(m)?;
    effect::add(m)?;
    m.add_class::<camera::Camera>()?;
    m.add_class::<camera::Frames>()?;
    m.add_class::<camera::Sensor>()?;
    m.add_class::<calibration::Calibration>()?;
    m.add_class::<calibration::Corrector>()?;
    Ok(())
}
