//! Automatic investigation: captures a campaign, searches for missing effects, and takes the measurement that
//! separates the closest candidates. Repeats until no candidates are tied or the bench cannot separate them.
//!
//! All measurements form one campaign in one dataset; later sets are appended in time order.

use crate::capture::{Capture, CaptureError, PLAN_FILE};
use crate::dataset::{Dataset, DatasetError, Folder, write_whole};
use crate::diagnosis::{Diagnosis, diagnose, searched};
use crate::inference::Given;
use crate::observables::{ObserveError, of_dataset};
use crate::plan::Plan;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Reason why an investigation stopped. Captured data are kept; the investigation can be resumed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InvestigateError {
    /// Capture failed.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// Dataset error.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Captured frames could not be evaluated.
    #[error(transparent)]
    Observe(#[from] ObserveError),
    /// List of measurements could not be parsed.
    #[error("{0}")]
    State(String),
}

/// A measurement of an investigation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// Purpose of the measurement.
    pub about: String,
    /// Range of dataset sets that the measurement produced.
    pub sets: (usize, usize),
}

/// File name of the list of measurements, stored beside the dataset.
pub const STATE_FILE: &str = "investigation.toml";

/// Limit on measurements beyond the first. A tie of three candidates takes two.
const MOST: usize = 3;

#[derive(Default, Serialize, Deserialize)]
struct State {
    measurement: Vec<Measurement>,
}

/// Progress events of an investigation.
#[derive(Debug)]
pub enum Event<'a> {
    /// A measurement begins.
    Begins {
        /// Purpose of the measurement.
        about: &'a str,
        /// Number of frames.
        frames: u64,
        /// Number of sets.
        sets: usize,
        /// Estimated duration, s.
        seconds: f64,
        /// Exposure that counts as 1, s.
        full_exposure_s: Option<f64>,
    },
    /// The campaign so far was diagnosed.
    Judged(&'a Diagnosis),
}

/// Result of an investigation.
#[derive(Debug)]
pub struct Found {
    /// Diagnosis of all measurements.
    pub diagnosis: Diagnosis,
    /// All measurements, including the first.
    pub measurements: Vec<Measurement>,
    /// Question that this bench cannot decide, with the reason.
    pub undecided: Option<String>,
}

/// Captures a plan into `root` and takes further measurements until the verdict is clear. `root` is new or
/// holds an interrupted investigation. `known` are effects that the camera is known to have.
///
/// # Errors
///
/// The capture failed, or data cannot be read. Captured data are kept; the same call resumes.
pub fn investigate(
    capture: &mut Capture<'_>,
    plan: &Plan,
    root: &Path,
    known: &[Given],
    tell: &mut dyn FnMut(Event<'_>),
) -> Result<Found, InvestigateError> {
    let _held = Folder::hold(root)?;
    let dataset = root.join("dataset");
    let state_path = root.join(STATE_FILE);
    let mut state = State::default();
    let mut zero_ns;
    if dataset.join("dataset.toml").exists() {
        if let Ok(text) = crate::input::settings(&state_path) {
            let fault = |e: toml::de::Error| {
                InvestigateError::State(format!(
                    "{}: {}",
                    state_path.display(),
                    crate::input::echo_lines(&e.to_string())
                ))
            };
            state = toml::from_str(&text).map_err(fault)?;
        }
        tracing::info!("goes on with its own plan");
        zero_ns = capture.resume(&dataset)?.zero_ns;
    } else {
        let plan = capture.ready(plan)?;
        let format = capture.camera.settings().map_err(CaptureError::from)?.pixel_format;
        if format.is_mosaic() {
            return Err(InvestigateError::State(format!(
                "the camera gives {format}, a colour mosaic, and one verdict holds for one colour: name a monochrome pixel_format under [camera] \
                 of a plan; or `radcam capture`, then `radcam diagnose --plane 0,0` for each colour"
            )));
        }
        begins(capture, &plan, tell)?;
        state.measurement.push(Measurement { about: plan.about.clone(), sets: (0, plan.sets.len()) });
        keep(&state, &state_path)?;
        zero_ns = capture.run(&plan, &dataset)?.zero_ns;
    }
    loop {
        let opened = Dataset::open(&dataset)?;
        let all = of_dataset(&opened, capture.stop, &mut |_, _| {})?;
        let effects = searched(&all, known);
        let diagnosis = diagnose(&all, None, effects, &mut |text| tracing::info!("{text}"));
        tell(Event::Judged(&diagnosis));
        let measurements = |state: State| state.measurement;
        let Some(next) = &diagnosis.next_plan else {
            return Ok(Found { diagnosis, measurements: measurements(state), undecided: None });
        };
        let asked = diagnosis.next_measurement.clone().unwrap_or_default();
        let done = state.measurement.iter().any(|m| m.about == next.about);
        let why = if done {
            Some("that measurement was taken, and they still look alike".to_string())
        } else if state.measurement.len() > MOST {
            Some(format!("{MOST} measurements more were taken, and it is still open"))
        } else {
            let first = opened.sets().len();
            let plan_path = dataset.join(PLAN_FILE);
            let before = crate::input::bytes(&plan_path).map_err(DatasetError::io(&plan_path))?;
            let sets = (first, first + next.sets.len());
            state.measurement.push(Measurement { about: next.about.clone(), sets });
            keep(&state, &state_path)?;
            let summary = begins(capture, &absolute(next, &dataset)?, tell)
                .and_then(|()| Ok(capture.extend(next, &dataset, zero_ns)?));
            match summary {
                Ok(summary) => {
                    zero_ns = summary.zero_ns;
                    None
                }
                // Sets captured before the bench error stay valid.
                Err(InvestigateError::Capture(CaptureError::Bench(e))) => {
                    write_whole(&plan_path, &before)?;
                    state.measurement.pop();
                    keep(&state, &state_path)?;
                    Some(e.to_string())
                }
                Err(e) => return Err(e),
            }
        };
        if let Some(why) = why {
            let undecided = Some(format!("{asked}: {why}"));
            return Ok(Found { diagnosis, measurements: measurements(state), undecided });
        }
    }
}

/// Converts the exposures of a further plan to seconds, from the full exposure of the campaign.
fn absolute(plan: &Plan, dataset: &Path) -> Result<Plan, InvestigateError> {
    let path = dataset.join(PLAN_FILE);
    let text = crate::input::settings(&path).map_err(DatasetError::io(&path))?;
    let first = Plan::from_toml(&text).map_err(CaptureError::from)?;
    Ok(plan.absolute(first.full_exposure_s.unwrap_or(1.0), |e| e))
}

fn begins(
    capture: &mut Capture<'_>,
    plan: &Plan,
    tell: &mut dyn FnMut(Event<'_>),
) -> Result<(), InvestigateError> {
    let rate = capture.camera.settings().map_err(CaptureError::from)?.frame_rate_hz;
    tell(Event::Begins {
        about: &plan.about,
        frames: plan.frames(),
        sets: plan.sets.len(),
        seconds: plan.seconds(rate),
        full_exposure_s: plan.full_exposure_s,
    });
    Ok(())
}

fn keep(state: &State, path: &Path) -> Result<(), InvestigateError> {
    let text = toml::to_string(state).map_err(|e| InvestigateError::State(e.to_string()))?;
    Ok(write_whole(path, text.as_bytes())?)
}
