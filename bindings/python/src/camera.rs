//! Cameras as iterators of arrays, and the simulated sensor by itself.

use crate::errors::{CameraError, Raised};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods};
use pyo3::exceptions::{PyStopIteration, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use radcam::camera::{self, StreamCounts, StreamOptions, Value};
use radcam::frame::{Frame, Region, Status};
use radcam::plan::BenchState;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

type Opened = Box<dyn camera::Camera>;
/// The camera; `None` while its stream owns it.
type Place = Arc<Mutex<Option<Opened>>>;

/// Frame metadata: number, device clock in ns, temperature in degrees Celsius.
type About = (u64, Option<u64>, Option<f64>);

/// Number of frames unpacked ahead: one is in transfer while the last is processed.
const AHEAD: usize = 1;
/// Polling interval for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// A camera by its name: `aravis:ID`, `sim:SENSOR` or `replay:DATASET`.
#[pyclass(frozen, module = "radcam")]
pub struct Camera {
    place: Place,
    #[pyo3(get)]
    id: String,
    #[pyo3(get)]
    vendor: String,
    #[pyo3(get)]
    model: String,
    #[pyo3(get)]
    serial: String,
}

impl Camera {
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        act: impl FnOnce(&mut dyn camera::Camera) -> Result<T, camera::CameraError> + Send,
    ) -> PyResult<T> {
        py.detach(|| {
            let mut place = self.place.lock().unwrap_or_else(PoisonError::into_inner);
            match &mut *place {
                Some(camera) => act(&mut **camera).map_err(Raised::raised),
                None => Err(CameraError::new_err(format!(
                    "camera {}: its frames are being read; close them first",
                    self.id
                ))),
            }
        })
    }
}

#[pymethods]
impl Camera {
    #[new]
    fn new(py: Python<'_>, name: PathBuf) -> PyResult<Self> {
        crate::work::own_threads()?;
        crate::logs::begin();
        let name = name.to_string_lossy();
        let opened = py.detach(|| camera::open(&name)).map_err(Raised::raised)?;
        let camera::Identity { id, vendor, model, serial, .. } = opened.identity().clone();
        Ok(Self { place: Arc::new(Mutex::new(Some(opened))), id, vendor, model, serial })
    }

    /// Settings as the camera reports them.
    fn settings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let s = self.with(py, |c| c.settings())?;
        let out = PyDict::new(py);
        out.set_item("exposure_s", s.exposure_s)?;
        out.set_item("gain_db", s.gain_db)?;
        out.set_item("black_level_dn", s.black_level_dn)?;
        out.set_item("frame_rate_hz", s.frame_rate_hz)?;
        out.set_item("pixel_format", s.pixel_format.name())?;
        out.set_item("region", (s.region.x, s.region.y, s.region.width, s.region.height))?;
        out.set_item("temperature_c", s.temperature_c)?;
        Ok(out)
    }

    fn set_exposure_s(&self, py: Python<'_>, value: f64) -> PyResult<f64> {
        self.with(py, |c| c.set_exposure_s(value))
    }

    fn set_gain_db(&self, py: Python<'_>, value: f64) -> PyResult<f64> {
        self.with(py, |c| c.set_gain_db(value))
    }

    fn set_black_level_dn(&self, py: Python<'_>, value: f64) -> PyResult<f64> {
        self.with(py, |c| c.set_black_level_dn(value))
    }

    fn set_region(
        &self,
        py: Python<'_>,
        x: u32,
        y: u32,
        width: u32,
        height: u32,
    ) -> PyResult<(u32, u32, u32, u32)> {
        let r = self.with(py, |c| c.set_region(Region { x, y, width, height }))?;
        Ok((r.x, r.y, r.width, r.height))
    }

    fn set_pixel_format(&self, py: Python<'_>, name: &str) -> PyResult<&'static str> {
        let format = radcam::pixel_format::PixelFormat::from_name(name);
        let format = format.map_err(|e| PyValueError::new_err(e.to_string()))?;
        Ok(self.with(py, |c| c.set_pixel_format(format))?.name())
    }

    /// Sets any feature by its GenICam name.
    fn set_feature(&self, py: Python<'_>, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let value = if let Ok(v) = value.extract::<bool>() {
            Value::Bool(v)
        } else if let Ok(v) = value.extract::<i64>() {
            Value::Int(v)
        } else if let Ok(v) = value.extract::<f64>() {
            Value::Float(v)
        } else {
            Value::Text(value.extract()?)
        };
        self.with(py, |c| c.set_feature(name, &value)).map(drop)
    }

    /// Sets the light before a simulated camera of this process, relative to its bench's unit, and which part
    /// of the card it sees.
    #[pyo3(signature = (illumination, configuration=0))]
    fn set_light(&self, py: Python<'_>, illumination: f64, configuration: u32) -> PyResult<()> {
        if !(illumination.is_finite() && illumination >= 0.0) {
            let message = format!("illumination is {illumination}: write a number that is not below 0");
            return Err(PyValueError::new_err(message));
        }
        let bench = self.with(py, |c| Ok(c.shared_bench()))?;
        let Some(bench) = bench else {
            let message = format!(
                "camera {}: its light is not radcam's to move; a feature of the camera may be, by set_feature",
                self.id
            );
            return Err(CameraError::new_err(message));
        };
        bench.set(BenchState { illumination, configuration, ..bench.get() });
        Ok(())
    }

    /// Frames without end.
    fn __iter__(&self, py: Python<'_>) -> PyResult<Frames> {
        self.frames(py, None, 5.0, None)
    }

    /// Switches off what changes pixels by itself; what could not be switched off, as (feature, value).
    fn disable_automatics(&self, py: Python<'_>) -> PyResult<Vec<(String, String)>> {
        let all = self.with(py, |c| c.disable_automatics())?;
        Ok(all.into_iter().filter(|a| !a.off).map(|a| (a.feature, a.now)).collect())
    }

    /// Frames as they come; `count` of them, or without end.
    #[pyo3(signature = (count=None, timeout_s=5.0, packet_size=None))]
    fn frames(
        &self,
        py: Python<'_>,
        count: Option<u64>,
        timeout_s: f64,
        packet_size: Option<u32>,
    ) -> PyResult<Frames> {
        crate::work::own_threads()?;
        if !(timeout_s > 0.0 && timeout_s <= 1e9) {
            let message = format!("timeout_s is {timeout_s}: write seconds above 0, no more than 1e9");
            return Err(PyValueError::new_err(message));
        }
        let taken = py.detach(|| self.place.lock().unwrap_or_else(PoisonError::into_inner).take());
        let Some(camera) = taken else {
            return Err(CameraError::new_err(format!(
                "camera {}: its frames are being read already; close them first",
                self.id
            )));
        };
        let (send, receive) = sync_channel(AHEAD);
        let shared = Arc::new(Shared::default());
        let (of_thread, home) = (Arc::clone(&shared), Arc::clone(&self.place));
        let options = StreamOptions { packet_size, ..StreamOptions::default() };
        let timeout = Duration::from_secs_f64(timeout_s);
        let thread = std::thread::spawn(move || {
            let mut camera = camera;
            let ended =
                read(&mut *camera, &options, count, timeout, &of_thread, &|f| send.send(Ok(f)).is_ok());
            *home.lock().unwrap_or_else(PoisonError::into_inner) = Some(camera);
            if let Err(e) = ended {
                let _ = send.send(Err(e));
            }
        });
        Ok(Frames {
            receive: Mutex::new(Some(receive)),
            thread: Mutex::new(Some(thread)),
            shared,
            last: Mutex::default(),
        })
    }
}

/// State shared by the reading thread and the iterator.
#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    counts: Mutex<StreamCounts>,
}

fn read(
    camera: &mut dyn camera::Camera,
    options: &StreamOptions,
    count: Option<u64>,
    timeout: Duration,
    shared: &Shared,
    send: &dyn Fn(Frame) -> bool,
) -> Result<(), camera::CameraError> {
    let region = camera.settings()?.region;
    let id = camera.identity().id.clone();
    let mut stream = camera.stream(options)?;
    let (mut sent, mut last) = (0, Instant::now());
    while !shared.stop.load(Ordering::Relaxed) && count.is_none_or(|n| sent < n) {
        let mut frame = Frame::new(region.width as usize, region.height as usize);
        let got = stream.next(&mut frame, timeout.min(Duration::from_millis(200)));
        let counts = stream.counts();
        *shared.counts.lock().unwrap_or_else(PoisonError::into_inner) = counts;
        match got {
            Ok(()) if frame.status == Status::Complete => {
                (sent, last) = (sent + 1, Instant::now());
                if !send(frame) {
                    break;
                }
            }
            Ok(()) | Err(camera::CameraError::Timeout { .. }) if last.elapsed() < timeout => {}
            Ok(()) => {
                let counts = format!("{} damaged", counts.failures);
                return Err(camera::CameraError::Timeout {
                    camera: id,
                    seconds: last.elapsed().as_secs_f64(),
                    counts,
                });
            }
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

/// A camera's frames, (rows, columns), uint16. Each has memory of its own.
#[pyclass(frozen, module = "radcam")]
pub struct Frames {
    receive: Mutex<Option<Receiver<Result<Frame, camera::CameraError>>>>,
    thread: Mutex<Option<std::thread::JoinHandle<()>>>,
    shared: Arc<Shared>,
    last: Mutex<Option<About>>,
}

impl Frames {
    fn end(&self) {
        self.shared.stop.store(true, Ordering::SeqCst);
        *self.receive.lock().unwrap_or_else(PoisonError::into_inner) = None;
        if let Some(thread) = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take() {
            let _ = thread.join();
        }
    }
}

impl Drop for Frames {
    fn drop(&mut self) {
        // The thread may need the GIL to end: for an effect or a log handler in Python.
        if Python::try_attach(|py| py.detach(|| self.end())).is_none() {
            self.shared.stop.store(true, Ordering::SeqCst);
        }
    }
}

#[pymethods]
impl Frames {
    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u16>>> {
        loop {
            let got = py.detach(|| {
                let receive = self.receive.lock().unwrap_or_else(PoisonError::into_inner);
                receive.as_ref().map(|r| r.recv_timeout(LOOK))
            });
            match got {
                Some(Ok(Ok(frame))) => {
                    let about = (frame.id, frame.timestamp_ns, frame.temperature_c);
                    *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some(about);
                    return Ok(frame.pixels.into_pyarray(py));
                }
                Some(Ok(Err(e))) => {
                    py.detach(|| self.end());
                    return Err(e.raised());
                }
                Some(Err(RecvTimeoutError::Timeout)) => py.check_signals()?,
                None | Some(Err(RecvTimeoutError::Disconnected)) => {
                    py.detach(|| self.end());
                    return Err(PyStopIteration::new_err(()));
                }
            }
        }
    }

    /// Of the last frame: number by the camera's count, device clock in ns, temperature in degrees Celsius.
    #[getter]
    fn last(&self) -> Option<About> {
        *self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What was counted so far: frames handed out, damaged, without a buffer, never seen.
    #[getter]
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let c = *self.shared.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let out = PyDict::new(py);
        out.set_item("completed", c.completed)?;
        out.set_item("failures", c.failures)?;
        out.set_item("underruns", c.underruns)?;
        out.set_item("missing", c.missing)?;
        Ok(out)
    }

    /// Stops the camera.
    fn close(&self, py: Python<'_>) {
        py.detach(|| self.end());
    }

    fn __enter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: &Bound<'_, pyo3::types::PyTuple>) {
        self.close(py);
    }
}

/// A simulated sensor by itself: frames under conditions that are given, as fast as they can be drawn.
#[pyclass(frozen, module = "radcam")]
pub struct Sensor(radcam_sim::Sensor);

#[pymethods]
impl Sensor {
    #[new]
    #[pyo3(signature = (model, seed=None))]
    fn new(py: Python<'_>, model: crate::verbs::Named, seed: Option<u64>) -> PyResult<Self> {
        crate::work::own_threads()?;
        let make = || {
            let model = model.load(seed)?;
            radcam_sim::Sensor::new(model).map_err(Raised::raised)
        };
        Ok(Self(py.detach(make)?))
    }

    /// (rows, columns).
    #[getter]
    fn shape(&self) -> (usize, usize) {
        let region = self.0.region();
        (region.height as usize, region.width as usize)
    }

    #[getter]
    fn bit_depth(&self) -> u8 {
        self.0.model().camera.bit_depth
    }

    /// Frame number `frame`, (rows, columns), DN: the same number, seed and conditions give the same frame.
    #[pyo3(signature = (frame, exposure_s, illumination=1.0, configuration=0, time_s=0.0, out=None))]
    #[allow(clippy::too_many_arguments)] // conditions by name
    fn draw<'py>(
        &self,
        py: Python<'py>,
        frame: u64,
        exposure_s: f64,
        illumination: f64,
        configuration: u32,
        time_s: f64,
        out: Option<Bound<'py, PyArray2<u16>>>,
    ) -> PyResult<Bound<'py, PyArray2<u16>>> {
        if !(exposure_s.is_finite() && exposure_s >= 0.0 && illumination.is_finite() && illumination >= 0.0) {
            let message = format!(
                "exposure_s is {exposure_s} and illumination {illumination}: write numbers that are not below 0"
            );
            return Err(PyValueError::new_err(message));
        }
        crate::work::own_threads()?;
        let conditions =
            radcam_sim::Conditions { illumination, configuration, time_s, ..self.0.conditions(exposure_s) };
        let region = self.0.region();
        let Some(out) = out else {
            let mut image = vec![0; region.width as usize * region.height as usize];
            py.detach(|| self.0.draw(frame, &conditions, region, &mut image));
            crate::effect::raised()?;
            let image = ndarray::Array2::from_shape_vec(self.shape(), image);
            return Ok(image.map_err(|e| PyValueError::new_err(e.to_string()))?.into_pyarray(py));
        };
        if (out.dims()[0], out.dims()[1]) != self.shape() {
            let (rows, columns) = self.shape();
            return Err(PyValueError::new_err(format!("out is not of ({rows}, {columns})")));
        }
        crate::frames::in_rows(&out)?;
        let mut into = out.try_readwrite()?;
        let to = into.as_slice_mut()?;
        py.detach(|| self.0.draw(frame, &conditions, region, to));
        drop(into);
        crate::effect::raised()?;
        Ok(out)
    }
}
