//! Frames of datasets, and statistics of frames given as arrays.

use crate::errors::{DatasetError, Raised};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::{PyIndexError, PyMemoryError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use radcam::statistics::layout::Layout;
use radcam::statistics::moments::Moments as Sums;
use radcam::statistics::pass::Pass;
use std::path::PathBuf;

/// Rejects arrays that are not C-contiguous. An array in Fortran order would be taken for its transpose:
/// numpy's slices accept both.
pub fn in_rows<T: numpy::Element>(array: &Bound<'_, PyArray2<T>>) -> PyResult<()> {
    if array.is_c_contiguous() {
        return Ok(());
    }
    Err(PyValueError::new_err("the array is not contiguous row by row: numpy.ascontiguousarray makes it so"))
}

/// Converts a frame to 16-bit codes, row by row: returns the array itself if it is one, otherwise a copy of
/// an array of unsigned codes of up to 16 bits.
pub fn codes_of<'py>(frame: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray2<u16>>> {
    let py = frame.py();
    if frame.hasattr("mask")? {
        let message = "masked arrays: radcam has no use for a mask; give frame.data, or a part of the frame";
        return Err(PyTypeError::new_err(message));
    }
    if let Ok(codes) = frame.cast::<PyArray2<u16>>()
        && codes.is_c_contiguous()
    {
        return Ok(codes.clone());
    }
    let numpy = py.import("numpy")?;
    let array = numpy.call_method1("asarray", (frame,))?;
    let kind = array.getattr("dtype")?;
    let unsigned = kind.getattr("kind")?.extract::<String>()? == "u"
        && kind.getattr("itemsize")?.extract::<usize>()? <= 2;
    let dimensions: usize = array.getattr("ndim")?.extract()?;
    if !unsigned || dimensions != 2 {
        let message = format!(
            "a frame is an array of (rows, columns) of uint8 or uint16 codes; this is of {kind} with {dimensions} dimensions"
        );
        return Err(PyTypeError::new_err(message));
    }
    let to = numpy.call_method1("ascontiguousarray", (array, numpy.getattr("uint16")?))?;
    Ok(to.cast_into()?)
}

/// A campaign on disk: a dataset folder, an EMVA 1288 descriptor or a file of statistics.
#[pyclass(frozen, module = "radcam")]
pub struct Dataset(radcam::dataset::Dataset);

#[pymethods]
impl Dataset {
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        Ok(Self(radcam::reduction::open(&path).map_err(Raised::raised)?))
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

/// Sums of the codes of every pixel and of their squares: whole numbers, so that any split of the frames
/// gives the same bits.
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
        let pixels = pixels(shape)?;
        // Checked before allocation: 16 bytes per pixel.
        if Vec::<u128>::new().try_reserve_exact(pixels).is_err() || pixels > 1 << 32 {
            return Err(PyMemoryError::new_err(format!("sums of {} x {} px do not fit", shape.1, shape.0)));
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
    fn add(&mut self, py: Python<'_>, frame: &Bound<'_, PyAny>) -> PyResult<()> {
        crate::work::own_threads()?;
        let frame = codes_of(frame)?.try_readonly()?;
        let dn = codes(&frame, self.shape, self.bit_depth)?;
        py.detach(|| self.sums.add(&[dn])).map_err(|e| PyValueError::new_err(e.to_string()))
    }

    /// Adds what another saw.
    fn merge(&mut self, other: PyRef<'_, Self>) -> PyResult<()> {
        if self.bit_depth != other.bit_depth {
            let message = format!(
                "frames of {} bits and of {} bits have no common mean",
                self.bit_depth, other.bit_depth
            );
            return Err(PyValueError::new_err(message));
        }
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

/// Returns the number of pixels of a frame of (rows, columns).
fn pixels(shape: (usize, usize)) -> PyResult<usize> {
    shape.0.checked_mul(shape.1).filter(|n| *n > 0).ok_or_else(|| {
        PyValueError::new_err(format!("a frame of {} x {} px makes no image", shape.1, shape.0))
    })
}

/// Returns the codes of a frame of this shape, none above full scale.
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

/// All statistics of the noise of frames that come from an iterator, in memory that does not grow with them:
/// JSON.
#[pyfunction]
#[pyo3(signature = (frames, bit_depth=16))]
fn statistics(py: Python<'_>, frames: &Bound<'_, PyAny>, bit_depth: u8) -> PyResult<Option<String>> {
    if !(1..=16).contains(&bit_depth) {
        return Err(PyValueError::new_err(format!("bit_depth is {bit_depth}, and must lie within 1 to 16")));
    }
    crate::work::own_threads()?;
    let mut frames = frames.try_iter()?;
    let Some(first) = frames.next() else { return Ok(None) };
    let first = codes_of(&first?)?;
    let shape = (first.dims()[0], first.dims()[1]);
    pixels(shape)?;
    let layout = Layout::new(&ndarray::Array2::from_elem(shape, true), ((1u32 << bit_depth) - 1) as u16);
    let mut pass = Pass::new(&layout);
    let mut add = |frame: PyReadonlyArray2<'_, u16>| {
        let dn = codes(&frame, shape, bit_depth)?;
        py.detach(|| pass.add(dn)).map_err(|e| PyValueError::new_err(e.to_string()))
    };
    add(first.try_readonly()?)?;
    for frame in frames {
        add(codes_of(&frame?)?.try_readonly()?)?;
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
