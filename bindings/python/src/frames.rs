//! Frames of datasets, and statistics of frames that come as arrays.

use crate::errors::{DatasetError, Raised};
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use radcam::statistics::layout::Layout;
use radcam::statistics::moments::Moments as Sums;
use radcam::statistics::pass::Pass;
use std::path::PathBuf;

/// Refuses what does not lie row by row without gaps. An array in Fortran's order would be taken for its transpose: numpy's slices take both.
pub fn in_rows<T: numpy::Element>(array: &Bound<'_, PyArray2<T>>) -> PyResult<()> {
    if array.is_c_contiguous() {
        return Ok(());
    }
    Err(PyValueError::new_err("the array is not contiguous row by row: numpy.ascontiguousarray makes it so"))
}

/// A campaign on disk: a dataset folder, an EMVA 1288 descriptor or a file of statistics.
#[pyclass(frozen, module = "radcam")]
pub struct Dataset(radcam::dataset::Dataset);

#[pymethods]
impl Dataset {
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        Ok(Self(radcam::dataset::Dataset::open(&path).map_err(Raised::raised)?))
    }

    /// (rows, columns).
    #[getter]
    fn shape(&self) -> (usize, usize) {
        let camera = &self.0.manifest().camera;
        (camera.height, camera.width)
    }

    #[getter]
    fn bit_depth(&self) -> u8 {
        self.0.manifest().camera.bit_depth
    }

    /// `dataset.toml` as JSON.
    fn manifest(&self) -> PyResult<String> {
        serde_json::to_string(self.0.manifest()).map_err(|e| DatasetError::new_err(e.to_string()))
    }

    /// `frames.csv` as JSON.
    fn rows(&self) -> PyResult<String> {
        serde_json::to_string(self.0.rows()).map_err(|e| DatasetError::new_err(e.to_string()))
    }

    /// The frame of a row of `rows`, (rows, columns), DN.
    fn read<'py>(&self, py: Python<'py>, row: usize) -> PyResult<Bound<'py, PyArray2<u16>>> {
        let Some(of) = self.0.rows().get(row) else {
            let message = format!("row {row}: the dataset has {}", self.0.rows().len());
            return Err(PyIndexError::new_err(message));
        };
        Ok(py.detach(|| self.0.read(of)).map_err(Raised::raised)?.into_pyarray(py))
    }
}

/// Sums of the codes of every pixel and of their squares: whole numbers, so that any split of the frames gives the same bits.
#[pyclass(module = "radcam")]
pub struct Moments {
    sums: Sums,
    shape: (usize, usize),
    #[pyo3(get)]
    bit_depth: u8,
}

impl Moments {
    fn of(shape: (usize, usize), bit_depth: u8) -> PyResult<Self> {
        if !(1..=16).contains(&bit_depth) {
            return Err(PyValueError::new_err(format!(
                "bit_depth is {bit_depth}, and must lie within 1 to 16"
            )));
        }
        Ok(Self { sums: Sums::new(shape, bit_depth), shape, bit_depth })
    }
}

#[pymethods]
impl Moments {
    #[new]
    #[pyo3(signature = (shape, bit_depth=16))]
    fn new(shape: (usize, usize), bit_depth: u8) -> PyResult<Self> {
        Self::of(shape, bit_depth)
    }

    /// (rows, columns).
    #[getter]
    fn shape(&self) -> (usize, usize) {
        self.shape
    }

    /// Adds a frame, (rows, columns), DN.
    fn add(&mut self, py: Python<'_>, frame: PyReadonlyArray2<'_, u16>) -> PyResult<()> {
        let dn = codes(&frame, self.shape, self.bit_depth)?;
        py.detach(|| self.sums.add(&[dn])).map_err(|e| PyValueError::new_err(e.to_string()))
    }

    /// Adds what another saw.
    fn merge(&mut self, other: PyRef<'_, Self>) -> PyResult<()> {
        self.sums.merge(&other.sums).map_err(|e| PyValueError::new_err(e.to_string()))
    }

    #[getter]
    fn frames(&self) -> u64 {
        self.sums.frames()
    }

    /// Mean of every pixel, (rows, columns), DN.
    fn mean_dn<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        py.detach(|| self.sums.mean_dn()).into_pyarray(py)
    }

    /// Variance of every pixel over the frames, (rows, columns), DN^2, with n - 1 in the denominator.
    fn variance_dn2<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        py.detach(|| self.sums.variance_dn2()).into_pyarray(py)
    }
}

/// The codes of a frame of this shape, none above full scale.
fn codes<'a>(
    frame: &'a PyReadonlyArray2<'_, u16>,
    shape: (usize, usize),
    bit_depth: u8,
) -> PyResult<&'a [u16]> {
    let found = frame.as_array().dim();
    if found != shape {
        let message =
            format!("a frame is {} x {} px, and the first {} x {} px", found.1, found.0, shape.1, shape.0);
        return Err(PyValueError::new_err(message));
    }
    in_rows(frame)?;
    let dn = frame.as_slice()?;
    let full = ((1u32 << bit_depth) - 1) as u16;
    if dn.iter().fold(0, |a, b| a | b) > full {
        let largest = dn.iter().max().copied().unwrap_or(0);
        let message = format!("a frame holds {largest} DN, and {bit_depth} bits hold at most {full} DN");
        return Err(PyValueError::new_err(message));
    }
    Ok(dn)
}

/// All statistics of the noise of frames that come from an iterator, in memory that does not grow with them: JSON.
#[pyfunction]
#[pyo3(signature = (frames, bit_depth=16))]
fn statistics(py: Python<'_>, frames: &Bound<'_, PyAny>, bit_depth: u8) -> PyResult<Option<String>> {
    if !(1..=16).contains(&bit_depth) {
        return Err(PyValueError::new_err(format!("bit_depth is {bit_depth}, and must lie within 1 to 16")));
    }
    let mut frames = frames.try_iter()?;
    let Some(first) = frames.next() else { return Ok(None) };
    let first: PyReadonlyArray2<'_, u16> = first?.extract()?;
    let shape = first.as_array().dim();
    let layout = Layout::new(&ndarray::Array2::from_elem(shape, true), ((1u32 << bit_depth) - 1) as u16);
    let mut pass = Pass::new(&layout);
    let mut add = |frame: PyReadonlyArray2<'_, u16>| {
        let dn = codes(&frame, shape, bit_depth)?;
        py.detach(|| pass.add(dn)).map_err(|e| PyValueError::new_err(e.to_string()))
    };
    add(first)?;
    for frame in frames {
        add(frame?.extract()?)?;
        py.check_signals()?;
    }
    let text = |s| serde_json::to_string(&s).map_err(|e| PyValueError::new_err(e.to_string()));
    pass.finish().map(text).transpose()
}

pub fn add(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_class::<Dataset>()?;
    m.add_class::<Moments>()?;
    m.add_function(wrap_pyfunction!(statistics, m)?)
}
