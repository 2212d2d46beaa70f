//! What lies on the desk: the campaign's statistics, collected once, the model, and what is known of it.

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

/// A campaign whose statistics are collected.
pub struct Campaign {
    /// Where it lies.
    pub path: PathBuf,
    /// Its frames or its table.
    pub source: Source,
    /// Its statistics.
    pub all: Observations,
    /// Kinds of its sets.
    pub kinds: BTreeMap<u32, Kind>,
}

impl Campaign {
    /// Its frames, where it has any.
    pub fn dataset(&self) -> Option<&Dataset> {
        match &self.source {
            Source::Frames(dataset) => Some(dataset),
            Source::Table(_) => None,
        }
    }
}

/// The campaign, or why there is none.
#[derive(Clone)]
pub enum Data {
    /// Nothing was captured yet.
    None,
    /// It is being read.
    Reading,
    /// It cannot be read.
    Failed(String),
    /// It is there.
    Ready(Arc<Campaign>),
}

/// A model after its fit.
pub struct Judged {
    /// The fit.
    pub fitted: Fitted,
    /// How it stands on frames that the fit did not see.
    pub comparison: Comparison,
    /// Time that took, ms.
    pub milliseconds: f64,
}

/// What a search for missing effects came to.
#[derive(Clone)]
pub enum Found {
    /// None was made for the model as it stands.
    None,
    /// It runs.
    Searching,
    /// Its answer.
    Done(Arc<Diagnosis>),
}

/// Everything of one campaign.
pub struct Desk {
    /// The campaign.
    pub data: Data,
    /// The model's steps.
    pub steps: Steps,
    /// The fit of the last step, and of the first.
    pub judged: Option<[Arc<Judged>; 2]>,
    /// What is missing from the last step's model.
    pub found: Found,
    /// What went wrong last.
    pub error: Option<String>,
    /// Counts changes.
    pub revision: u64,
}

/// Fits and judges a model, as `radcam compare --model` does.
///
/// # Errors
///
/// An effect that cannot be understood.
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
    /// A desk without a campaign.
    pub fn new(data: Data) -> Self {
        Self { data, steps: Steps::default(), judged: None, found: Found::None, error: None, revision: 0 }
    }

    /// The campaign, where it is there.
    pub fn campaign(&self) -> Option<Arc<Campaign>> {
        match &self.data {
            Data::Ready(campaign) => Some(campaign.clone()),
            _ => None,
        }
    }

    /// Lays a campaign on the desk, with what was kept of it; `effects` are those that the user gave, where nothing was kept.
    ///
    /// # Errors
    ///
    /// What was kept and cannot be understood.
    pub fn lay(&mut self, campaign: Campaign, effects: &[EffectValues]) -> Result<(), String> {
        let campaign = Arc::new(campaign);
        self.steps = Steps::read(&folder_of(&campaign.path))?;
        self.data = Data::Ready(campaign.clone());
        self.found = Found::None;
        if self.steps.step.is_empty() {
            let entries = effects.iter().map(|e| Entry { on: true, effect: e.clone() }).collect();
            return self.take("the model as given".into(), entries);
        }
        // The campaign may have grown since.
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

    /// Makes another step: the model with these effects.
    ///
    /// # Errors
    ///
    /// An effect that cannot be understood.
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

    /// Takes the last step back.
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

    /// Effects of the model as it stands, switched on or off.
    pub fn entries(&self) -> Vec<Entry> {
        self.steps.now().map(|s| s.entries.clone()).unwrap_or_default()
    }

    /// The model file of the model as it stands: the values that its effects begin with, so that a comparison with the file gives the same error.
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

    /// Keeps the steps; where the folder cannot be written the page says so, and goes on.
    fn keep(&mut self, campaign: &Campaign) {
        let kept = self.model(campaign).ok_or_else(|| "there is no model yet".to_string());
        let kept = kept.and_then(|model| self.steps.write(&folder_of(&campaign.path), &model));
        if let Err(e) = kept {
            self.error = Some(format!("{e}; the steps last until radcam ends"));
        }
    }
}

/// Effect that a search found, as an entry of the model; the law with the effects beside it. `taken`: names that
/// the model has.
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
/// What cannot be read.
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
