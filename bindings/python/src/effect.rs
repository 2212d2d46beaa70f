//! Effects written in Python: a class that draws and predicts.

use numpy::{IntoPyArray, PyArray2, PyArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyType;
use radcam_sim::effects::{Drawing, Effect, Page, Parameter, Plain, Stage, Take, register as known, takes};
use radcam_sim::predict as expected;
use std::sync::{Mutex, PoisonError};

/// First exception of an effect: the simulator and the fits cannot propagate it.
static RAISED: Mutex<Option<PyErr>> = Mutex::new(None);

/// Returns the exception raised by an effect since the last call, and clears it.
pub fn raised() -> PyResult<()> {
    RAISED.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(Ok(()), Err)
}

fn keep(result: PyResult<()>) {
    if let Err(e) = result {
        RAISED.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(e);
    }
}

/// Statistics of one set, which an effect shifts.
#[pyclass(module = "radcam")]
pub struct SetPrediction(expected::SetPrediction);

#[pymethods]
impl SetPrediction {
    /// Mean signal of the settled frames: e before the amplifier, DN above zero after it.
    #[getter]
    fn signal(&self) -> f64 {
        self.0.signal
    }

    #[setter]
    fn set_signal(&mut self, value: f64) {
        self.0.signal = value;
    }

    /// Variance common to the pixels of a frame.
    #[getter]
    fn common(&self) -> f64 {
        self.0.common
    }

    #[setter]
    fn set_common(&mut self, value: f64) {
        self.0.common = value;
    }

    /// Variance, from pixel to pixel, of their noise's variance.
    #[getter]
    fn unequal(&self) -> f64 {
        self.0.unequal
    }

    #[setter]
    fn set_unequal(&mut self, value: f64) {
        self.0.unequal = value;
    }

    /// Mean fourth cumulant of the pixels' noise.
    #[getter]
    fn fourth(&self) -> f64 {
        self.0.fourth
    }

    #[setter]
    fn set_fourth(&mut self, value: f64) {
        self.0.fourth = value;
    }

    /// Variance of the shot noise of a pixel.
    #[getter]
    fn shot(&self) -> f64 {
        self.0.shot.lag(0, 0)
    }

    /// Variance of a pixel's noise at read-out.
    #[getter]
    fn read(&self) -> f64 {
        self.0.read.lag(0, 0)
    }

    /// Multiplies the image about its mean: all noise by the square.
    fn gain(&mut self, by: f64) {
        self.0.gain(by);
    }

    /// Adds variance that pixels have of their own, as light has it.
    fn add_shot(&mut self, variance: f64) {
        self.0.shot.add_white(variance);
    }

    /// Adds variance that pixels have of their own at read-out.
    fn add_read(&mut self, variance: f64) {
        self.0.read.add_white(variance);
    }

    /// Adds variance that the pixels of a row share.
    fn add_row(&mut self, variance: f64) {
        self.0.row.add(variance);
    }

    /// Adds variance that the pixels of a column share.
    fn add_column(&mut self, variance: f64) {
        self.0.column.add(variance);
    }
}

/// What is expected of a campaign.
#[pyclass(module = "radcam")]
pub struct Prediction {
    /// Statistics of every set.
    #[pyo3(get)]
    sets: Vec<Py<SetPrediction>>,
    /// Mean of every frame: e before the amplifier, DN after it.
    #[pyo3(get, set)]
    frame_signal: Vec<f64>,
    /// A, DN/e.
    #[pyo3(get)]
    gain_dn_per_e: f64,
    /// Read noise, e.
    #[pyo3(get)]
    read_noise_e: f64,
    /// Black level at zero exposure, DN.
    #[pyo3(get)]
    offset_dn: f64,
    /// Dark current, e/s.
    #[pyo3(get)]
    dark_e_per_s: f64,
}

/// What was measured.
#[pyclass(frozen, module = "radcam", get_all)]
pub struct Campaign {
    /// Exposure of every set, s.
    exposures_s: Vec<f64>,
    /// Whether a set has light.
    lit: Vec<bool>,
    /// Light of every set, relative to the campaign's unit.
    illuminations: Vec<f64>,
    /// Set of every frame.
    frame_sets: Vec<usize>,
    /// Start of every frame, s.
    frame_times_s: Vec<f64>,
    /// (rows, columns).
    shape: (usize, usize),
    /// Largest code, DN.
    full_scale_dn: f64,
}

/// Of a frame that is being drawn.
#[pyclass(frozen, module = "radcam", get_all)]
pub struct Drawn {
    /// Exposure, s.
    exposure_s: f64,
    /// Light relative to the bench's unit.
    illumination: f64,
    /// Time, s.
    time_s: f64,
    /// Number of the frame.
    frame: u64,
    /// Seed of the noise.
    seed: u64,
    /// Largest code, DN.
    full_scale_dn: f64,
    /// Black level at zero exposure, DN.
    offset_dn: f64,
}

/// A camera as examples need it.
#[pyclass(frozen, module = "radcam", get_all)]
pub struct PlainCamera {
    /// A, DN/e.
    gain_dn_per_e: f64,
    /// Signal near full scale, e.
    range_e: f64,
    /// Exposure that brings it, s.
    bright_s: f64,
    /// Constant noise, e.
    noise_e: f64,
    /// Rows.
    rows: f64,
    /// Largest code, DN.
    full_scale_dn: f64,
}

/// Effect with methods in Python. Its metadata live as long as the process, as those of built-in effects do.
struct Own {
    object: Py<PyAny>,
    id: &'static str,
    stage: Stage,
    parameters: &'static [Parameter],
    page: Page,
}

impl Effect for Own {
    fn id(&self) -> &'static str {
        self.id
    }

    fn stage(&self) -> Stage {
        self.stage
    }

    fn parameters(&self) -> &'static [Parameter] {
        self.parameters
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Python::attach(|py| {
            let plain = PlainCamera {
                gain_dn_per_e: plain.gain_dn_per_e,
                range_e: plain.range_e,
                bright_s: plain.bright_s,
                noise_e: plain.noise_e,
                rows: plain.rows,
                full_scale_dn: plain.full_scale_dn,
            };
            let values = self.object.bind(py).call_method1("example", (plain,)).and_then(|v| v.extract());
            values.map_err(|e| keep(Err(e))).ok().flatten()
        })
    }

    fn page(&self) -> Page {
        self.page
    }

    fn predict(&self, p: &[f64], campaign: &expected::Campaign, out: &mut expected::Prediction) {
        keep(Python::attach(|py| {
            let sets = out.sets.iter().map(|s| Py::new(py, SetPrediction(s.clone())));
            let base = &out.base;
            let prediction = Py::new(
                py,
                Prediction {
                    sets: sets.collect::<PyResult<_>>()?,
                    frame_signal: out.frame_signal.clone(),
                    gain_dn_per_e: base.gain_dn_per_e,
                    read_noise_e: base.read_noise_e,
                    offset_dn: base.offset_dn,
                    dark_e_per_s: base.dark_e_per_s,
                },
            )?;
            let c = Campaign {
                exposures_s: campaign.sets.iter().map(|s| s.exposure_s).collect(),
                lit: campaign.sets.iter().map(|s| s.light.is_some()).collect(),
                illuminations: campaign.sets.iter().map(|s| s.illumination).collect(),
                frame_sets: campaign.frames.iter().map(|f| f.set).collect(),
                frame_times_s: campaign.frames.iter().map(|f| f.time_s).collect(),
                shape: campaign.shape,
                full_scale_dn: campaign.full_scale_dn,
            };
            self.object.bind(py).call_method1("predict", (p.to_vec(), c, prediction.clone_ref(py)))?;
            let prediction = prediction.borrow(py);
            if prediction.frame_signal.len() != out.frame_signal.len() {
                return Err(PyValueError::new_err(format!(
                    "{}: predict left frame_signal with another length",
                    self.id
                )));
            }
            let mut frames = prediction.frame_signal.clone();
            let same = frames == out.frame_signal;
            for (number, (to, from)) in out.sets.iter_mut().zip(&prediction.sets).enumerate() {
                let now = &from.borrow(py).0;
                let said =
                    [now.signal, now.common, now.unequal, now.fourth, now.shot.lag(0, 0), now.read.lag(0, 0)];
                if !said.iter().all(|v| v.is_finite()) {
                    let message = format!(
                        "{}: predict left set {number} with a number that is none: {said:?}",
                        self.id
                    );
                    return Err(PyValueError::new_err(message));
                }
                // An effect that changes only the signal of a set means its frames.
                let by = now.signal - to.signal;
                if same && by != 0.0 {
                    let of_set = campaign.frames.iter().zip(&mut frames).filter(|(f, _)| f.set == number);
                    of_set.for_each(|(_, signal)| *signal += by);
                }
                to.clone_from(now);
            }
            if let Some(at) = frames.iter().position(|v| !v.is_finite()) {
                let message = format!("{}: predict left frame {at} with a signal of {}", self.id, frames[at]);
                return Err(PyValueError::new_err(message));
            }
            out.frame_signal = frames;
            Ok(())
        }));
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        keep(Python::attach(|py| {
            let shape = d.image.dim();
            let image = std::mem::take(&mut d.image).into_pyarray(py);
            let about = Drawn {
                exposure_s: d.exposure_s,
                illumination: d.illumination,
                time_s: d.time_s,
                frame: d.frame,
                seed: d.seed,
                full_scale_dn: d.full_scale_dn,
                offset_dn: d.offset_dn,
            };
            let drawn = self.object.bind(py).call_method1("draw", (p.to_vec(), &image, about));
            // After an error the drawing continues with an image of zeros.
            let back = drawn.and_then(|drawn| {
                if drawn.is_none() {
                    return Ok(image.to_owned_array());
                }
                let drawn = drawn.cast_into::<PyArray2<f64>>().map_err(|_| {
                    PyTypeError::new_err(format!(
                        "{}: draw returns None or a float64 array of the image's shape",
                        self.id
                    ))
                })?;
                Ok(drawn.to_owned_array())
            });
            let (next, raised) = match back {
                Ok(next) if next.dim() == shape && next.iter().all(|v| v.is_finite()) => (next, Ok(())),
                Ok(next) if next.dim() == shape => {
                    let message = format!("{}: draw left pixels that are no numbers", self.id);
                    (ndarray::Array2::zeros(shape), Err(PyValueError::new_err(message)))
                }
                Ok(next) => {
                    let message =
                        format!("{}: draw returned {:?}, and the image has {shape:?}", self.id, next.dim());
                    (ndarray::Array2::zeros(shape), Err(PyValueError::new_err(message)))
                }
                Err(e) => (ndarray::Array2::zeros(shape), Err(e)),
            };
            d.image = next;
            raised
        }));
    }
}

const STAGES: [(&str, Stage); 8] = [
    ("light", Stage::Light),
    ("charge", Stage::Charge),
    ("well", Stage::Well),
    ("transfer", Stage::Transfer),
    ("read", Stage::Read),
    ("amplifier", Stage::Amplifier),
    ("converter", Stage::Converter),
    ("firmware", Stage::Firmware),
];

const MEASUREMENTS: [(&str, &[Take]); 7] = [
    ("darks", takes::DARKS),
    ("sweep", takes::SWEEP),
    ("pairs", takes::PAIRS),
    ("transitions", takes::TRANSITIONS),
    ("reference", takes::REFERENCE),
    ("long", takes::LONG),
    ("scenes", takes::SCENES),
];

fn one_of<T: Copy>(what: &str, name: &str, all: &[(&str, T)]) -> PyResult<T> {
    all.iter().find(|(n, _)| *n == name).map(|(_, value)| *value).ok_or_else(|| {
        let names: Vec<&str> = all.iter().map(|(n, _)| *n).collect();
        PyValueError::new_err(format!("{what} is {name:?}; there are {}", names.join(", ")))
    })
}

fn kept(text: String) -> &'static str {
    Box::leak(text.into_boxed_str())
}

/// Makes an effect known to all verbs in this process. (name, meaning, unit, min, max, starts) of every
/// parameter; the page's texts are what, equation, signature, look_alikes, remedy, measure, source.
#[pyfunction]
#[allow(clippy::type_complexity)]
fn register(
    object: Py<PyAny>,
    id: String,
    stage: &str,
    parameters: Vec<(String, String, String, f64, f64, Vec<f64>)>,
    page: [String; 7],
    sets: &str,
) -> PyResult<()> {
    let is_id =
        !id.is_empty() && id.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-');
    if !is_id {
        return Err(PyValueError::new_err(format!("id is {id:?}: write small letters, digits and \"-\"")));
    }
    if Python::attach(|py| object.bind(py).is_instance_of::<PyType>()) {
        return Err(PyTypeError::new_err(format!("{id}: register an object of the class, not the class")));
    }
    let mut names: Vec<&String> = parameters.iter().map(|p| &p.0).collect();
    names.sort();
    if let Some(twice) = names.windows(2).find(|w| w[0] == w[1]) {
        return Err(PyValueError::new_err(format!("parameter {} is there twice", twice[0])));
    }
    let parameters: Vec<Parameter> = parameters
        .into_iter()
        .map(|(name, meaning, unit, min, max, starts)| {
            let sound = min < max && !starts.is_empty() && starts.iter().all(|s| (min..=max).contains(s));
            if !sound {
                let message = format!(
                    "parameter {name}: min must lie below max, and one start at least between them, and every other"
                );
                return Err(PyValueError::new_err(message));
            }
            Ok(Parameter {
                name: kept(name),
                meaning: kept(meaning),
                unit: kept(unit),
                min,
                max,
                starts: Vec::leak(starts),
            })
        })
        .collect::<PyResult<_>>()?;
    let [what, equation, signature, look_alikes, remedy, measure, source] = page.map(kept);
    let own = Own {
        object,
        stage: one_of("stage", stage, &STAGES)?,
        parameters: Vec::leak(parameters),
        page: Page {
            what,
            equation,
            signature,
            look_alikes,
            remedy,
            measure,
            sets: one_of("sets", sets, &MEASUREMENTS)?,
            source,
        },
        id: kept(id),
    };
    known(Box::leak(Box::new(own))).map_err(PyValueError::new_err)
}

/// Takes an effect of one's own out again.
#[pyfunction]
fn unregister(id: &str) -> PyResult<()> {
    if radcam_sim::effects::unregister(id) {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("no effect {id:?} was registered in this process")))
}

/// Makes the effects of a folder's files known to all verbs in this process: their names.
#[pyfunction]
fn load_effects(folder: std::path::PathBuf) -> PyResult<Vec<String>> {
    radcam::model::register_own_effects(&folder).map_err(|e| PyValueError::new_err(e.to_string()))
}

pub fn add(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_class::<SetPrediction>()?;
    m.add_class::<Prediction>()?;
    m.add_class::<Campaign>()?;
    m.add_class::<Drawn>()?;
    m.add_class::<PlainCamera>()?;
    m.add_function(wrap_pyfunction!(load_effects, m)?)?;
    m.add_function(wrap_pyfunction!(register, m)?)?;
    m.add_function(wrap_pyfunction!(unregister, m)?)
}
