//! From a camera to a verdict: a campaign, what it lacks, and the measurement that tells the closest names apart, until nothing is left to be
//! told apart or this bench cannot.
//!
//! Everything is one campaign in one dataset: what is measured later stands behind what was there, in the order of time.

use crate::capture::{Capture, CaptureError, PLAN_FILE};
use crate::dataset::{Dataset, DatasetError, Folder, write_whole};
use crate::diagnosis::{Diagnosis, diagnose, searched};
use crate::inference::Given;
use crate::observables::{ObserveError, of_dataset};
use crate::plan::Plan;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Why an investigation stopped. What was captured stays, and is gone on with.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InvestigateError {
    /// The capture.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// The dataset.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// What was captured cannot be looked at.
    #[error(transparent)]
    Observe(#[from] ObserveError),
    /// The list of measurements cannot be understood.
    #[error("{0}")]
    State(String),
}

/// A measurement of an investigation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// What it is for.
    pub about: String,
    /// Sets of the dataset that it made.
    pub sets: (usize, usize),
}

/// Name of the list of measurements, beside the dataset.
pub const STATE_FILE: &str = "investigation.toml";

/// Measurements beyond the first: a tie of three names takes two.
const MOST: usize = 3;

#[derive(Default, Serialize, Deserialize)]
struct State {
    measurement: Vec<Measurement>,
}

/// What an investigation tells while it runs.
#[derive(Debug)]
pub enum Event<'a> {
    /// A measurement begins.
    Begins {
        /// What it is for.
        about: &'a str,
        /// Frames.
        frames: u64,
        /// Sets.
        sets: usize,
        /// About how long it takes, s.
        seconds: f64,
        /// Exposure that counts as 1, s.
        full_exposure_s: Option<f64>,
    },
    /// The campaign so far was judged.
    Judged(&'a Diagnosis),
}

/// What came of it.
#[derive(Debug)]
pub struct Found {
    /// The verdict over everything that was measured.
    pub diagnosis: Diagnosis,
    /// Every measurement, the first one included.
    pub measurements: Vec<Measurement>,
    /// What this bench cannot decide, and why.
    pub undecided: Option<String>,
}

/// Captures a plan into `root`, which is new or an investigation that was interrupted, and measures on until the verdict is clear. `known` are
/// effects that the camera is known to have.
///
/// # Errors
///
/// What stopped the capture, or what cannot be read. What was captured stays, and the same call goes on with it.
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
                // What was captured before stands.
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

/// The exposures of a further plan in seconds, by the full exposure of the campaign.
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
