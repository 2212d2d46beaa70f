//! Calibrations, and correction of frames (eq. 51).

use crate::errors::{CorrectError, Raised};
use crate::frames::{codes_of, in_rows};
use crate::work::own_threads;
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyReadwriteArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use radcam::correct::Codes;
use std::path::PathBuf;

/// A calibration file: dark reference, K, defects.
#[pyclass(frozen, module = "radcam")]
pub struct Calibration(radcam::calibrate::file::Calibration);

#[pymethods]
impl Calibration {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let read = || radcam::calibrate::file::Calibration::read(&path);
        Ok(Self(py.detach(read).map_err(Raised::raised)?))
    }

    /// What the file says of itself, JSON.
    fn description(&self) -> PyResult<String> {
        serde_json::to_string(&self.0.description).map_err(|e| PyValueError::new_err(e.to_string()))
    }

    /// K, (rows, columns), of mean 1.
    #[getter]
    fn k<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f32>> {
        self.0.k.clone().into_pyarray(py)
    }

    /// Standard error of K, (rows, columns).
    #[getter]
    fn k_std_err<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f32>> {
        self.0.k_std_err.clone().into_pyarray(py)
    }

    /// Flags of defects, (rows, columns): 0 where a pixel is sound.
    #[getter]
    fn defects<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<u8>> {
        self.0.defects.clone().into_pyarray(py)
    }

    /// The dark reference at an exposure, (rows, columns), DN.
    fn dark_dn<'py>(&self, py: Python<'py>, exposure_s: f64) -> PyResult<Bound<'py, PyArray2<f32>>> {
        if !(exposure_s.is_finite() && exposure_s >= 0.0) {
            return Err(radcam::correct::CorrectError::Exposure(exposure_s).raised());
        }
        let dark = self.0.dark.at(exposure_s).map_err(|e| CorrectError::new_err(e.to_string()))?;
        Ok(dark.into_pyarray(py))
    }

    /// Makes it ready for frames of an exposure, s.
    #[pyo3(signature = (exposure_s, replace_defects=false))]
    fn corrector(&self, py: Python<'_>, exposure_s: f64, replace_defects: bool) -> PyResult<Corrector> {
        let make = || {
            let made = radcam::correct::Corrector::new(&self.0, exposure_s)?;
            Ok(if replace_defects { made.replacing_defects(&self.0) } else { made })
        };
        Ok(Corrector(py.detach(make).map_err(|e: radcam::correct::CorrectError| e.raised())?))
    }
}

/// A calibration made ready for one exposure.
#[pyclass(frozen, module = "radcam")]
pub struct Corrector(radcam::correct::Corrector);

impl Corrector {
    fn fits<T: numpy::Element>(&self, array: &Bound<'_, PyArray2<T>>) -> PyResult<()> {
        let (found, shape) = (array.dims(), self.0.shape());
        if (found[0], found[1]) != shape {
            let message = format!(
                "the array has {} x {} pixels, and the calibration {} x {}",
                found[1], found[0], shape.1, shape.0
            );
            return Err(CorrectError::new_err(message));
        }
        in_rows(array)
    }
}

/// Rejects an output that shares memory with the frame.
fn apart<A, B>(from: &[A], to: &[B]) -> PyResult<()> {
    let (a, b) = (from.as_ptr_range(), to.as_ptr_range());
    let overlap = (a.start as usize) < b.end as usize && (b.start as usize) < a.end as usize;
    if overlap { Err(shared()) } else { Ok(()) }
}

fn shared() -> PyErr {
    PyValueError::new_err(
        "out shares memory with the frame, or is in use: give the frame itself, or memory of its own",
    )
}

#[pymethods]
impl Corrector {
    /// (rows, columns).
    #[getter]
    fn shape(&self) -> (usize, usize) {
        self.0.shape()
    }

    /// A frame as DN above the dark reference, float32; `out` is written and returned where it is given.
    #[pyo3(signature = (frame, out=None))]
    fn correct<'py>(
        &self,
        py: Python<'py>,
        frame: &Bound<'py, PyAny>,
        out: Option<Bound<'py, PyArray2<f32>>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        own_threads()?;
        let frame = codes_of(frame)?.try_readonly()?;
        let out = out.unwrap_or_else(|| PyArray2::zeros(py, self.0.shape(), false));
        self.fits(&frame)?;
        self.fits(&out)?;
        let mut into: PyReadwriteArray2<'_, f32> = out.try_readwrite().map_err(|_| shared())?;
        let (from, to) = (frame.as_slice()?, into.as_slice_mut()?);
        apart(from, to)?;
        py.detach(|| self.0.to_f32(from, to)).map_err(Raised::raised)?;
        drop(into);
        Ok(out)
    }

    /// A frame as 16-bit codes, `scale` times DN above the dark reference plus `offset`, rounded and clipped;
    /// `out` may be the frame itself.
    #[pyo3(signature = (frame, scale=1.0, offset=0.0, out=None))]
    fn correct_codes<'py>(
        &self,
        py: Python<'py>,
        frame: &Bound<'py, PyAny>,
        scale: f32,
        offset: f32,
        out: Option<Bound<'py, PyArray2<u16>>>,
    ) -> PyResult<Bound<'py, PyArray2<u16>>> {
        own_threads()?;
        if !(scale > 0.0 && scale.is_finite() && offset.is_finite()) {
            let message = format!("scale is {scale} and offset {offset}: write numbers, the scale above 0");
            return Err(PyValueError::new_err(message));
        }
        let in_place = out.as_ref().is_some_and(|out| out.is(frame));
        let frame = codes_of(frame)?;
        let codes = Codes { scale, offset };
        let out = out.unwrap_or_else(|| PyArray2::zeros(py, self.0.shape(), false));
        self.fits(&frame)?;
        self.fits(&out)?;
        let mut into: PyReadwriteArray2<'_, u16> = out.try_readwrite().map_err(|_| shared())?;
        let to = into.as_slice_mut()?;
        if in_place {
            py.detach(|| self.0.in_place(to, codes)).map_err(Raised::raised)?;
        } else {
            let frame = frame.try_readonly().map_err(|_| shared())?;
            let from = frame.as_slice()?;
            apart(from, to)?;
            py.detach(|| self.0.to_u16(from, codes, to)).map_err(Raised::raised)?;
        }
        drop(into);
        Ok(out)
    }
}
