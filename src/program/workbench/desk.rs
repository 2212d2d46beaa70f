//! State of the desk: the campaign's statistics, collected once, the model, its fit, and the last diagnosis.

use super::steps::{Entry, Step, Steps, folder_of};
use crate::dataset::{Dataset, Kind};
use crate::diagnosis::{Diagnosis, LAW, searched};
use crate::inference::{Comparison, Fitted, compare, fit, start};
use crate::model::{given, with_fit};
use crate::observables::Observations;
use crate::source::Source;
use radcam_sim::{EffectValues, Model};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Campaign with its statistics.
pub struct Campaign {
    /// Path of the campaign.
    pub path: PathBuf,
    /// Frames or table.
    pub source: Source,
    /// Statistics of the campaign.
    pub all: Observations,
    /// Kinds of the sets, by set number.
    pub kinds: BTreeMap<u32, Kind>,
}

impl Campaign {
    /// Returns the frames; none for a table.
    pub fn dataset(&self) -> Option<&Dataset> {
        match &self.source {
            Source::Frames(dataset) => Some(dataset),
            Source::Table(_) => None,
        }
    }
}

/// State of the campaign's data.
#[derive(Clone)]
pub enum Data {
    /// Nothing was captured yet.
    None,
    /// Reading is in progress.
    Reading,
    /// Reading failed.
    Failed(String),
    /// The campaign is loaded.
    Ready(Arc<Campaign>),
}

/// Model with its fit and comparison.
pub struct Judged {
    /// Fit of the model.
    pub fitted: Fitted,
    /// Comparison with the held-out frames.
    pub comparison: Comparison,
    /// Duration of fit and comparison, ms.
    pub milliseconds: f64,
}

/// State of the search for missing effects.
#[derive(Clone)]
pub enum Found {
    /// No search was made for the current model.
    None,
    /// The search is running.
    Searching,
    /// Result of the search.
    Done(Arc<Diagnosis>),
}

/// All state of one campaign.
pub struct Desk {
    /// Campaign data.
    pub data: Data,
    /// Steps of the model.
    pub steps: Steps,
    /// Fits of the last step and of the first step.
    pub judged: Option<[Arc<Judged>; 2]>,
    /// Search for effects missing from the model of the last step.
    pub found: Found,
    /// Last error.
    pub error: Option<String>,
    /// Number of changes.
    pub revision: u64,
}

/// Fits a model and compares it with the data, as `radcam compare --model` does.
///
/// # Errors
///
/// An effect is invalid.
pub fn judge<'e>(
    all: &Observations,
    effects: impl IntoIterator<Item = &'e EffectValues>,
) -> Result<Judged, String> {
    let begun = std::time::Instant::now();
    let known = given(effects).map_err(|e| e.to_string())?;
    let fitted = fit(all, &start(all), &searched(all, &known));
    let comparison = compare(all, &fitted);
    Ok(Judged { fitted, comparison, milliseconds: 1e3 * begun.elapsed().as_secs_f64() })
}

impl Desk {
    /// Creates a desk without a campaign.
    pub fn new(data: Data) -> Self {
        Self { data, steps: Steps::default(), judged: None, found: Found::None, error: None, revision: 0 }
    }

    /// Returns the campaign, if loaded.
    pub fn campaign(&self) -> Option<Arc<Campaign>> {
        match &self.data {
            Data::Ready(campaign) => Some(campaign.clone()),
            _ => None,
        }
    }

    /// Loads a campaign onto the desk, with its stored steps. Without stored steps the model starts from
    /// `effects`, the effects given by the user.
    ///
    /// # Errors
    ///
    /// The stored steps are invalid.
    pub fn lay(&mut self, campaign: Campaign, effects: &[EffectValues]) -> Result<(), String> {
        let campaign = Arc::new(campaign);
        self.steps = Steps::read(&folder_of(&campaign.path))?;
        self.data = Data::Ready(campaign.clone());
        self.found = Found::None;
        if self.steps.step.is_empty() {
            let entries = effects.iter().map(|e| Entry { on: true, effect: e.clone() }).collect();
            return self.take("the model as given".into(), entries);
        }
        // The campaign may have grown since the steps were stored.
        let mut judged = Vec::new();
        for step in &mut self.steps.step {
            let fit = Arc::new(judge(&campaign.all, step.on())?);
            (step.error, step.p_value) = (fit.comparison.error, fit.comparison.p_value);
            judged.push(fit);
        }
        self.judged = judged.first().zip(judged.last()).map(|(first, last)| [last.clone(), first.clone()]);
        if !effects.is_empty() {
            self.error = Some("--model was not used: the steps that were kept go on from another one".into());
        }
        self.keep(&campaign);
        Ok(())
    }

    /// Adds a step: the model with these effects.
    ///
    /// # Errors
    ///
    /// An effect is invalid.
    pub fn take(&mut self, what: String, entries: Vec<Entry>) -> Result<(), String> {
        let campaign = self.campaign().ok_or("there is no campaign yet")?;
        let on: Vec<EffectValues> = entries.iter().filter(|e| e.on).map(|e| e.effect.clone()).collect();
        let judged = Arc::new(judge(&campaign.all, &on)?);
        let c = &judged.comparison;
        self.steps.step.push(Step { what, error: c.error, p_value: c.p_value, entries });
        let first = self.judged.as_ref().map_or_else(|| judged.clone(), |[_, first]| first.clone());
        self.judged = Some([judged, first]);
        self.found = Found::None;
        self.revision += 1;
        self.keep(&campaign);
        Ok(())
    }

    /// Undoes the last step.
    ///
    /// # Errors
    ///
    /// As [`take`](Self::take).
    pub fn undo(&mut self) -> Result<(), String> {
        let campaign = self.campaign().ok_or("there is no campaign yet")?;
        if self.steps.step.len() < 2 {
            return Err("there is no step to take back".into());
        }
        self.steps.step.pop();
        let now = self.steps.now().map(|s| s.on().cloned().collect::<Vec<_>>()).unwrap_or_default();
        let judged = Arc::new(judge(&campaign.all, &now)?);
        let first = self.judged.as_ref().map_or_else(|| judged.clone(), |[_, first]| first.clone());
        self.judged = Some([judged, first]);
        self.found = Found::None;
        self.revision += 1;
        self.keep(&campaign);
        Ok(())
    }

    /// Returns the effects of the current model, each switched on or off.
    pub fn entries(&self) -> Vec<Entry> {
        self.steps.now().map(|s| s.entries.clone()).unwrap_or_default()
    }

    /// Returns the current model as a model file, with the start values of its effects: a comparison with the
    /// file gives the same error.
    pub fn model(&self, campaign: &Campaign) -> Option<Model> {
        let [judged, _] = self.judged.as_ref()?;
        let blank = radcam_sim::sensors::load("cmos12").ok()?;
        let info = campaign.dataset().map(|d| &d.manifest().camera);
        let mut model = with_fit(blank, &campaign.all, &judged.fitted, info);
        if let Some(info) = info {
            (model.camera.vendor, model.camera.model) = (info.vendor.clone(), info.model.clone());
        }
        model.about = format!("Fitted to {} on the workbench", campaign.path.display());
        model.effects = self.steps.now()?.on().cloned().collect();
        Some(model)
    }

    /// Saves the steps. If the folder is read-only the page shows a warning and continues.
    fn keep(&mut self, campaign: &Campaign) {
        let kept = self.model(campaign).ok_or_else(|| "there is no model yet".to_string());
        let kept = kept.and_then(|model| self.steps.write(&folder_of(&campaign.path), &model));
        if let Err(e) = kept {
            self.error = Some(format!("{e}; the steps last until radcam ends"));
        }
    }
}

/// Returns the entries for an effect that a search found. A law comes with the effects beside it. `taken` are
/// the names that the model has already.
pub fn entries_of(d: &Diagnosis, id: &str, taken: &[&str]) -> Option<Vec<Entry>> {
    if id == LAW {
        let law = d.proposal.as_ref()?;
        let fitted = law.beside_it()?;
        let beside = law.beside.iter().filter_map(|id| entry_of(&fitted, id));
        let laws = law.laws(taken).into_iter().map(|effect| Entry { on: true, effect });
        return Some(beside.chain(laws).collect());
    }
    entry_of(d.fitted.as_ref()?, id).map(|entry| vec![entry])
}

fn entry_of(fitted: &Fitted, id: &str) -> Option<Entry> {
    let (effect, values) = fitted.effects.iter().find(|(e, _)| e.id() == id)?;
    let named = effect.parameters().iter().zip(values).map(|(p, v)| (p.name.to_string(), *v)).collect();
    Some(Entry { on: true, effect: EffectValues { parameters: named, ..EffectValues::new(id) } })
}

/// Opens a campaign and collects its statistics.
///
/// # Errors
///
/// The campaign cannot be read.
pub fn read(
    path: &Path,
    plane: Option<[u8; 2]>,
    stop: &std::sync::atomic::AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Campaign, String> {
    let source = Source::open(path).map_err(|e| e.to_string())?;
    let source = plane.map_or(Ok(source.clone()), |plane| source.plane(plane)).map_err(|e| e.to_string())?;
    let all = source.observations_with(stop, progress).map_err(|e| e.to_string())?;
    let kinds = crate::report::study::kinds(&all);
    Ok(Campaign { path: path.to_path_buf(), source, all, kinds })
}
