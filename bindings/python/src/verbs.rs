//! Commands of the program on datasets. Results equal the program's JSON, number for number.

use crate::errors::{ModelError, PlanError, Raised};
use crate::work::run;
use pyo3::prelude::*;
use radcam::calibrate::{Estimator, of_dataset as calibration_of, pattern::Options as Paper};
use radcam::camera;
use radcam::capture as campaign;
use radcam::dataset::Dataset;
use radcam::diagnosis::{diagnose as search, searched};
use radcam::emva::{Definitions, evaluate, of_dataset};
use radcam::inference::{Given, compare as judge, fit, start};
use radcam::plan::Plan;
use radcam::reduction;
use radcam::source::Source;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

type Progress<'py> = Option<Bound<'py, PyAny>>;

fn json(value: &impl serde::Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|e| crate::errors::RadcamError::new_err(e.to_string()))
}

/// A model: a sensor's name, a file, or a `Model`.
pub enum Named {
    Name(String),
    Text(String),
}

impl<'py> FromPyObject<'_, 'py> for Named {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        if let Ok(text) = object.getattr("text") {
            return Ok(Self::Text(text.extract()?));
        }
        let path: PathBuf = object.extract()?;
        Ok(Self::Name(path.to_string_lossy().into_owned()))
    }
}

impl Named {
    pub fn load(&self, seed: Option<u64>) -> PyResult<radcam_sim::Model> {
        match self {
            Self::Name(name) => camera::sim::model(name, seed).map_err(ModelError::new_err),
            Self::Text(text) => {
                let mut model = radcam_sim::Model::from_toml(text).map_err(Raised::raised)?;
                model.base.seed = seed.unwrap_or(model.base.seed);
                Ok(model)
            }
        }
    }
}

fn effects(model: Option<&Named>) -> PyResult<Vec<Given>> {
    let Some(model) = model else { return Ok(Vec::new()) };
    radcam::model::given(&model.load(None)?.effects).map_err(Raised::raised)
}

/// Refuses to write over a file unless that is asked for.
#[pyfunction]
fn may_be_written(output: PathBuf, overwrite: bool) -> PyResult<()> {
    free(&output, overwrite)
}

fn free(output: &Path, overwrite: bool) -> PyResult<()> {
    if output.exists() && !overwrite {
        let message = format!("{} is there already; overwrite=True writes over it", output.display());
        return Err(pyo3::exceptions::PyFileExistsError::new_err(message));
    }
    Ok(())
}

/// Checks the plane: row and column, 0 or 1, of one pixel of every 2 x 2 cell.
fn checked(plane: Option<[u8; 2]>) -> PyResult<Option<[u8; 2]>> {
    match plane {
        Some([y, x]) if y > 1 || x > 1 => {
            let message = format!("plane is ({y}, {x}): write (0, 0), (0, 1), (1, 0) or (1, 1)");
            Err(pyo3::exceptions::PyValueError::new_err(message))
        }
        other => Ok(other),
    }
}

/// Opens datasets, or one colour of them.
fn open(paths: &[PathBuf], plane: Option<[u8; 2]>) -> PyResult<Source> {
    let source = Source::open_all(paths).map_err(Raised::raised)?;
    plane.map_or(Ok(source.clone()), |plane| source.plane(plane)).map_err(Raised::raised)
}

/// Opens a dataset, or one colour of it.
fn dataset(path: &Path, plane: Option<[u8; 2]>) -> PyResult<Dataset> {
    let dataset = reduction::open(path).map_err(Raised::raised)?;
    plane.map_or(Ok(dataset.clone()), |plane| dataset.plane(plane)).map_err(Raised::raised)
}

#[pyfunction]
#[pyo3(signature = (paths, progress=None, plane=None))]
fn noise(
    py: Python<'_>,
    paths: Vec<PathBuf>,
    progress: Progress<'_>,
    plane: Option<[u8; 2]>,
) -> PyResult<String> {
    let plane = checked(plane)?;
    run(py, progress.as_ref(), move |w| {
        let source = open(&paths, plane)?;
        json(&source.noise_with(&w.stop, &mut |done, of| w.step(done, of)).map_err(Raised::raised)?)
    })
}

#[pyfunction]
#[pyo3(signature = (paths, model=None, progress=None, plane=None))]
fn compare(
    py: Python<'_>,
    paths: Vec<PathBuf>,
    model: Option<Named>,
    progress: Progress<'_>,
    plane: Option<[u8; 2]>,
) -> PyResult<String> {
    let plane = checked(plane)?;
    run(py, progress.as_ref(), move |w| {
        let effects = effects(model.as_ref())?;
        let source = open(&paths, plane)?;
        let all =
            source.observations_with(&w.stop, &mut |done, of| w.step(done, of)).map_err(Raised::raised)?;
        json(&judge(&all, &fit(&all, &start(&all), &searched(&all, &effects))))
    })
}

#[pyfunction]
#[pyo3(signature = (paths, model=None, progress=None, plane=None))]
fn diagnose(
    py: Python<'_>,
    paths: Vec<PathBuf>,
    model: Option<Named>,
    progress: Progress<'_>,
    plane: Option<[u8; 2]>,
) -> PyResult<(String, Option<String>)> {
    let plane = checked(plane)?;
    run(py, progress.as_ref(), move |w| {
        let effects = effects(model.as_ref())?;
        let source = open(&paths, plane)?;
        let all =
            source.observations_with(&w.stop, &mut |done, of| w.step(done, of)).map_err(Raised::raised)?;
        let found = search(&all, None, searched(&all, &effects), &mut |_| {});
        let next = found.next_plan.as_ref().map(Plan::to_toml).transpose().map_err(Raised::raised)?;
        Ok((json(&found)?, next))
    })
}

#[pyfunction]
#[pyo3(signature = (path, release="4.0", progress=None, plane=None))]
fn emva(
    py: Python<'_>,
    path: PathBuf,
    release: &str,
    progress: Progress<'_>,
    plane: Option<[u8; 2]>,
) -> PyResult<String> {
    let plane = checked(plane)?;
    let definitions = match release {
        "4.0" => Definitions::Release4,
        "3.1" => Definitions::Release31,
        "reference-tool" => Definitions::ReferenceTool,
        other => {
            let message = format!("release is {other:?}; there are \"4.0\", \"3.1\" and \"reference-tool\"");
            return Err(pyo3::exceptions::PyValueError::new_err(message));
        }
    };
    run(py, progress.as_ref(), move |w| {
        let dataset = dataset(&path, plane)?;
        let points = of_dataset(&dataset, &w.stop, &|done, of| w.step(done, of)).map_err(Raised::raised)?;
        json(&evaluate(&points, definitions).map_err(Raised::raised)?)
    })
}

#[pyfunction]
#[pyo3(signature = (path, output, estimator="joint", overwrite=false, progress=None))]
fn calibrate(
    py: Python<'_>,
    path: PathBuf,
    output: PathBuf,
    estimator: &str,
    overwrite: bool,
    progress: Progress<'_>,
) -> PyResult<String> {
    free(&output, overwrite)?;
    let estimator = match estimator {
        "joint" => Estimator::Joint,
        "paper" => Estimator::Paper(Paper::default()),
        "smooth" => Estimator::Smooth,
        "flat-field" => Estimator::FlatField,
        other => {
            let message = format!(
                "estimator is {other:?}; there are \"joint\", \"paper\", \"smooth\" and \"flat-field\""
            );
            return Err(pyo3::exceptions::PyValueError::new_err(message));
        }
    };
    run(py, progress.as_ref(), move |w| {
        let dataset = reduction::open(&path).map_err(Raised::raised)?;
        let dataset = radcam::data_faults::examined(&dataset, &w.stop).map_err(Raised::raised)?;
        let noise = radcam::noise::of_dataset(&dataset, &w.stop, &mut |done, of| w.step(done, of)).ok();
        let from = format!("radcam {} from {}", env!("CARGO_PKG_VERSION"), path.display());
        let made = calibration_of(&dataset, estimator, noise.as_ref(), &from).map_err(Raised::raised)?;
        made.calibration.write(&output).map_err(Raised::raised)?;
        let told = |e: serde_json::Error| crate::errors::RadcamError::new_err(e.to_string());
        let mut said = serde_json::to_value(&made.calibration.description).map_err(told)?;
        said["data_faults"] = serde_json::to_value(&made.data_faults).map_err(told)?;
        json(&said)
    })
}

fn plan(name: &str) -> PyResult<Plan> {
    if let Some(plan) = Plan::named(name) {
        return Ok(plan);
    }
    if !Path::new(name).exists() && !name.contains('\n') {
        let message = format!("no plan \"{name}\": neither a file nor one of quick, standard, emva1288");
        return Err(PlanError::new_err(message));
    }
    let text = if name.contains('\n') { name.into() } else { radcam::input::settings(name.as_ref())? };
    Plan::from_toml(&text).map_err(Raised::raised)
}

/// Captures a plan with a camera or, where `model` is given, a simulated one of it with `seed`; `resume` goes
/// on with one that was ended.
#[pyfunction]
#[pyo3(signature = (camera, output, plan_name="standard", region=None, full_exposure_s=None, model=None, seed=None, resume=false, progress=None))]
#[allow(clippy::too_many_arguments)] // as many as the verb has
fn capture(
    py: Python<'_>,
    camera: String,
    output: PathBuf,
    plan_name: &str,
    region: Option<[u32; 4]>,
    full_exposure_s: Option<f64>,
    model: Option<Named>,
    seed: Option<u64>,
    resume: bool,
    progress: Progress<'_>,
) -> PyResult<String> {
    if let Some(s) = full_exposure_s.filter(|s| !(s.is_finite() && *s > 0.0)) {
        let message = format!("full_exposure_s is {s}: write seconds above 0");
        return Err(pyo3::exceptions::PyValueError::new_err(message));
    }
    let stored = output.join(campaign::PLAN_FILE);
    let mut plan = if resume { plan(&stored.to_string_lossy())? } else { plan(plan_name)? };
    plan.camera.region = region.or(plan.camera.region);
    plan.full_exposure_s = full_exposure_s.or(plan.full_exposure_s);
    run(py, progress.as_ref(), move |w| {
        let mut camera: Box<dyn camera::Camera> = match model {
            Some(model) => {
                let sensor = radcam_sim::Sensor::new(model.load(seed)?).map_err(Raised::raised)?;
                Box::new(camera::sim::SimCamera::new(
                    camera.trim_start_matches("sim:"),
                    sensor.into(),
                    Default::default(),
                ))
            }
            None => camera::open(&camera).map_err(Raised::raised)?,
        };
        let mut bench = radcam::bench::of(&mut *camera, &plan);
        let mut progress = |p: campaign::Progress| w.step(p.frames as usize, p.of as usize);
        let mut capture = campaign::Capture::new(&mut *camera, &mut *bench);
        capture.stop = &w.stop;
        capture.progress = Some(&mut progress);
        let done = if resume { capture.resume(&output) } else { capture.run(&plan, &output) };
        json(&done.map_err(Raised::raised)?)
    })
}

/// Reduces parts to a file of statistics; (frames, sets).
#[pyfunction]
#[pyo3(signature = (parts, output, plan=None, look=false, overwrite=false, progress=None, plane=None))]
#[allow(clippy::too_many_arguments)] // as many as the verb has
fn reduce(
    py: Python<'_>,
    parts: Vec<PathBuf>,
    output: PathBuf,
    plan: Option<PathBuf>,
    look: bool,
    overwrite: bool,
    progress: Progress<'_>,
    plane: Option<[u8; 2]>,
) -> PyResult<(usize, usize)> {
    free(&output, overwrite)?;
    let plane = checked(plane)?;
    run(py, progress.as_ref(), move |w| {
        let plan = plan.as_deref().map(|p| dataset(p, None)).transpose()?;
        let options = reduction::Options { plan, look_only: look };
        let parts = parts.iter().map(|p| dataset(p, plane)).collect::<PyResult<_>>()?;
        let reduced = reduction::reduce(parts, &options, &w.stop, &mut |done, of| w.step(done, of));
        let reduced = reduced.map_err(Raised::raised)?;
        reduction::write(&reduced, &output).map_err(Raised::raised)?;
        Ok((reduced.rows().len(), reduced.sets().len()))
    })
}

/// Fits a model's effects to datasets: the model as TOML.
#[pyfunction]
#[pyo3(signature = (text, paths, progress=None, plane=None))]
fn fit_model(
    py: Python<'_>,
    text: String,
    paths: Vec<PathBuf>,
    progress: Progress<'_>,
    plane: Option<[u8; 2]>,
) -> PyResult<String> {
    let plane = checked(plane)?;
    run(py, progress.as_ref(), move |w| {
        let model = radcam_sim::Model::from_toml(&text).map_err(Raised::raised)?;
        let source = open(&paths, plane)?;
        let all =
            source.observations_with(&w.stop, &mut |done, of| w.step(done, of)).map_err(Raised::raised)?;
        let effects = radcam::model::to_be_fitted(&model).map_err(Raised::raised)?;
        let fitted = fit(&all, &start(&all), &searched(&all, &effects));
        let camera = match &source {
            Source::Frames(dataset) => Some(&dataset.manifest().camera),
            Source::Table(_) => None,
        };
        radcam::model::with_fit(model, &all, &fitted, camera).to_toml().map_err(Raised::raised)
    })
}

/// A sensor or a model file as TOML, checked.
#[pyfunction]
fn load_model(name: &str) -> PyResult<String> {
    Named::Name(name.into()).load(None)?.to_toml().map_err(Raised::raised)
}

/// TOML of a model, checked, as JSON.
#[pyfunction]
fn check_model(text: &str) -> PyResult<String> {
    json(&radcam_sim::Model::from_toml(text).map_err(Raised::raised)?)
}

/// TOML of a model with one more effect, whose parameters are those that are given; a fit finds the others.
#[pyfunction]
fn add_to_model(text: &str, effect: &str, parameters: BTreeMap<String, f64>) -> PyResult<String> {
    let mut model = radcam_sim::Model::from_toml(text).map_err(Raised::raised)?;
    let mut entry = radcam_sim::EffectValues::new(effect);
    if model.effects.iter().any(|e| e.is_same(&entry)) {
        return Err(ModelError::new_err(format!("the model has {effect} already")));
    }
    entry.parameters.extend(parameters);
    model.effects.push(entry);
    model.check().map_err(Raised::raised)?;
    model.to_toml().map_err(Raised::raised)
}

/// TOML of a model without an effect.
#[pyfunction]
fn remove_from_model(text: &str, effect: &str) -> PyResult<String> {
    let mut model = radcam_sim::Model::from_toml(text).map_err(Raised::raised)?;
    if !model.remove(effect) {
        return Err(ModelError::new_err(format!("the model has no effect \"{effect}\"")));
    }
    model.to_toml().map_err(Raised::raised)
}

/// The catalogue of effects as JSON.
#[pyfunction]
fn catalogue() -> PyResult<String> {
    json(&radcam_sim::effects::all().iter().map(|e| radcam::model::page(*e)).collect::<Vec<_>>())
}

/// Cameras that can be opened now: (name, vendor, model, serial number, protocol).
#[pyfunction]
fn cameras(py: Python<'_>) -> Vec<(String, String, String, String, String)> {
    let all = py.detach(camera::list);
    all.into_iter().map(|c| (c.camera, c.vendor, c.model, c.serial, c.protocol)).collect()
}

pub fn add(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(noise, m)?)?;
    m.add_function(wrap_pyfunction!(compare, m)?)?;
    m.add_function(wrap_pyfunction!(diagnose, m)?)?;
    m.add_function(wrap_pyfunction!(emva, m)?)?;
    m.add_function(wrap_pyfunction!(calibrate, m)?)?;
    m.add_function(wrap_pyfunction!(capture, m)?)?;
    m.add_function(wrap_pyfunction!(reduce, m)?)?;
    m.add_function(wrap_pyfunction!(fit_model, m)?)?;
    m.add_function(wrap_pyfunction!(load_model, m)?)?;
    m.add_function(wrap_pyfunction!(check_model, m)?)?;
    m.add_function(wrap_pyfunction!(add_to_model, m)?)?;
    m.add_function(wrap_pyfunction!(remove_from_model, m)?)?;
    m.add_function(wrap_pyfunction!(may_be_written, m)?)?;
    m.add_function(wrap_pyfunction!(catalogue, m)?)?;
    m.add_function(wrap_pyfunction!(cameras, m)?)
}
