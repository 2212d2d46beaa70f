//! Report contents as data. The report and the workbench render it; `radcam report --json` prints it.

mod curves;
mod evidence;
mod images;
mod provenance;
mod quantities;

pub use evidence::{Level, decisive, of_statistic, plot_of, statistics};
pub use images::{Images, Map};
pub use provenance::Provenance;
pub use quantities::Reported;

use crate::calibrate::file::Calibration;
use crate::dataset::{CameraInfo, DataFault};
use crate::diagnosis::{Diagnosis, Missing, Proposal, Rung, Verdict};
use crate::inference::{Comparison, Fitted};
use crate::noise::NoiseReport;
use crate::observables::{Observations, ObserveError};
use crate::plot::Plot;
use crate::source::Source;
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;

/// Judgement of a model against a campaign: a comparison alone, or a diagnosis with missing effects.
#[derive(Debug, Clone)]
pub struct Judgement {
    /// Summary of one or two plain sentences.
    pub sentence: String,
    /// True if the model as given describes the campaign.
    pub consistent: bool,
    /// Missing effects, strongest first; empty if no search was made.
    pub missing: Vec<Missing>,
    /// Law for an unnamed effect.
    pub proposal: Option<Proposal>,
    /// Ladder of errors, the model as given first.
    pub ladder: Vec<Rung>,
    /// Comparison with the model as given, then with the effects found, if any.
    pub comparisons: Vec<Comparison>,
    /// Last fitted model.
    pub fitted: Option<Fitted>,
    /// Measurement that would separate the candidates.
    pub next_measurement: Option<String>,
    /// Faults of the data.
    pub slips: Vec<DataFault>,
    /// Checks that were not possible, and remaining deviations.
    pub notes: Vec<String>,
    /// True if effects were searched for.
    pub searched: bool,
}

impl Judgement {
    /// Creates a judgement from a comparison alone.
    pub fn of_comparison(comparison: &Comparison, fitted: &Fitted) -> Self {
        Self {
            sentence: format!(
                "{} Nothing was searched for: `radcam diagnose` names what is missing.",
                sentence_of(comparison)
            ),
            consistent: comparison.consistent,
            missing: Vec::new(),
            proposal: None,
            ladder: vec![Rung { added: None, error: comparison.error, p_value: comparison.p_value }],
            comparisons: vec![comparison.clone()],
            fitted: Some(fitted.clone()),
            next_measurement: None,
            slips: comparison.data_faults.clone(),
            notes: comparison.not_looked_at.clone(),
            searched: false,
        }
    }

    /// Creates a judgement from a diagnosis.
    pub fn of_diagnosis(d: &Diagnosis) -> Self {
        let (fitted, comparison) = d.described();
        Self {
            sentence: d.verdict.sentence().into(),
            consistent: d.consistent,
            missing: d.missing.clone(),
            proposal: d.proposal.clone(),
            ladder: d.ladder_with_law(),
            comparisons: d.comparisons.iter().take(1).chain(comparison).cloned().collect(),
            fitted: fitted.cloned(),
            next_measurement: d.next_measurement.clone(),
            slips: d.data_faults.clone(),
            notes: d.notes.clone(),
            searched: true,
        }
    }

    /// Returns the heading of the page.
    pub fn heading(&self, verdict: Option<&Verdict>) -> String {
        match verdict {
            Some(Verdict::Named { effect, .. }) => format!("The camera shows {effect}"),
            Some(Verdict::Unknown { .. }) => "The camera shows an effect without a name".into(),
            _ if self.consistent => "The model describes the camera".into(),
            _ => "The model does not describe the camera".into(),
        }
    }
}

/// Describes a comparison in a sentence.
fn sentence_of(c: &Comparison) -> String {
    let words = c.agreement.words();
    let mut letters = words.chars();
    let capital: String = letters.next().map(|l| l.to_uppercase().collect()).unwrap_or_default();
    format!("{capital}{}: error {:.2} over {} statistics.", letters.as_str(), c.error, c.residuals.len())
}

/// Contents of a report.
#[derive(Debug, Clone)]
pub struct Study {
    /// Title of the page.
    pub heading: String,
    /// Camera and its settings; none for a table.
    pub camera: Option<CameraInfo>,
    /// Provenance of the numbers.
    pub provenance: Provenance,
    /// Equations of the model.
    pub model: Vec<String>,
    /// Judgement of the model.
    pub judgement: Judgement,
    /// Gain and constant noise, level by level, or the reason why there are none.
    pub noise: Result<NoiseReport, String>,
    /// All quantities, by name.
    pub quantities: BTreeMap<&'static str, Reported>,
    /// Parameters of the effects found or given.
    pub parameters: Vec<(String, Vec<(String, crate::number::Quantity)>)>,
    /// Plots of the camera: photon transfer, linearity, and so on.
    pub plots: Vec<Plot>,
    /// Deciding statistic, before and after.
    pub decisive: Vec<Plot>,
    /// All statistics against the level.
    pub statistics: Vec<Plot>,
    /// Correlations of the noise with neighbours: (rows, columns) apart, value and standard error, mean over
    /// the flats.
    pub neighbours: Vec<((i32, i32), f64, f64)>,
    /// Dark image and response.
    pub images: Images,
}

/// Output of `radcam report --json`, also embedded in the page.
#[derive(Debug, Serialize)]
pub struct Numbers<'a> {
    sentence: &'a str,
    consistent: bool,
    error_before: f64,
    error_after: f64,
    quantities: &'a BTreeMap<&'static str, Reported>,
    missing: &'a [Missing],
    proposal: Option<&'a Proposal>,
    ladder: &'a [Rung],
    next_measurement: Option<&'a str>,
    provenance: &'a Provenance,
    data_faults: &'a [DataFault],
    notes: &'a [String],
}

impl Study {
    /// Builds the study from observations and a judgement. Reads the frames again for the images and for the
    /// line of gain and noise. `stop` cancels; `progress` receives (pieces done, pieces).
    ///
    /// # Errors
    ///
    /// A frame cannot be read, or the call was stopped.
    pub fn of(
        source: &Source,
        all: &Observations,
        judged: (&Judgement, Option<&Verdict>),
        calibration: Option<&Calibration>,
        provenance: Provenance,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Self, ObserveError> {
        let (judgement, verdict) = judged;
        let noise = match source.noise_with(stop, progress) {
            Err(crate::noise::NoiseError::Interrupted) => return Err(ObserveError::Interrupted),
            other => other.map_err(|e| e.to_string()),
        };
        let images = match source {
            Source::Frames(dataset) => images::of(dataset, calibration, stop, progress)?,
            Source::Table(_) => Images::default(),
        };
        let camera = match source {
            Source::Frames(dataset) => Some(dataset.manifest().camera.clone()),
            Source::Table(_) => None,
        };
        let line = noise.as_ref().ok();
        let plots = curves::plots(all, judgement, line, &images, calibration);
        Ok(Self {
            heading: judgement.heading(verdict),
            camera,
            provenance,
            model: quantities::model(judgement.fitted.as_ref()),
            quantities: quantities::all(all, judgement, line, &images, calibration),
            parameters: quantities::parameters(judgement),
            decisive: evidence::decisive(judgement),
            statistics: evidence::every(judgement),
            neighbours: evidence::neighbours(all),
            plots,
            images,
            judgement: judgement.clone(),
            noise,
        })
    }

    /// Returns the numbers of the page.
    pub fn numbers(&self) -> Numbers<'_> {
        let j = &self.judgement;
        let error = |c: Option<&Comparison>| c.map_or(f64::NAN, |c| c.error);
        Numbers {
            sentence: &j.sentence,
            consistent: j.consistent,
            error_before: error(j.comparisons.first()),
            error_after: error(j.comparisons.last()),
            quantities: &self.quantities,
            missing: &j.missing,
            proposal: j.proposal.as_ref(),
            ladder: &j.ladder,
            next_measurement: j.next_measurement.as_deref(),
            provenance: &self.provenance,
            data_faults: &j.slips,
            notes: &j.notes,
        }
    }
}
