//! Request handlers of the pages. Every action has an equivalent command.

use super::desk::{Campaign, Found, Judged, entries_of, judge, read};
use super::live::{Order, is_incomplete, lock};
use super::pages::{model, shell};
use super::steps::{CALIBRATION, Entry, FLAT_FIELD, folder_of, own};
use super::{Job, Shared, aside};
use crate::calibrate::{Estimator, of_dataset};
use crate::capture::PLAN_FILE;
use crate::diagnosis::{Diagnosis, diagnose, searched};
use crate::frame::Region;
use crate::model::given;
use crate::plan::Plan;
use crate::study::{Judgement, Provenance, Study};
use axum::extract::{Form, Query, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use maud::{Markup, html};
use radcam_sim::EffectValues;
use serde::Deserialize;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;

type Desktop = State<Arc<Shared>>;

/// Another campaign, shown beside the one on the desk.
pub struct Run {
    /// Path of the campaign.
    pub path: PathBuf,
    /// Diagnosis, gain and read noise of the campaign, or the reason why there is none.
    pub said: Result<(Diagnosis, f64, f64), String>,
}

/// Starts a job, unless one is running. A failure becomes the page's message.
fn start(
    shared: &Arc<Shared>,
    what: impl Into<String>,
    work: impl FnOnce(&Arc<Shared>, &Job) -> Result<(), String> + Send + 'static,
) -> Result<(), String> {
    let job = Job::new(what);
    {
        let mut running = lock(&shared.job);
        if let Some(other) = &*running {
            return Err(format!("{} still runs; wait, or cancel it", other.what));
        }
        *running = Some(job.clone());
    }
    shared.desk().error = None;
    let shared = shared.clone();
    std::thread::spawn(move || {
        shared.status_changed();
        let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| work(&shared, &job)));
        let done = done.unwrap_or_else(|_| Err(format!("{} failed", job.what)));
        {
            let mut running = lock(&shared.job);
            // A cancelled search runs on in the background; the current job may be another one.
            if !running.as_ref().is_some_and(|now| Arc::ptr_eq(now, &job)) {
                return;
            }
            *running = None;
        }
        let mut desk = shared.desk();
        if matches!(desk.found, Found::Searching) {
            desk.found = Found::None;
        }
        match done {
            Err(e) if job.is_stopped() => {
                desk.error = Some(format!("{} was cancelled{}", job.what, because(&e)))
            }
            Err(e) => desk.error = Some(e),
            Ok(()) => {}
        }
        drop(desk);
        shared.model_changed();
    });
    Ok(())
}

/// Returns the cause of a failure, or nothing for a cancelled job.
fn because(e: &str) -> String {
    if e == CANCELLED { String::new() } else { format!(": {e}") }
}

/// Error text of a job that the user cancelled.
const CANCELLED: &str = "cancelled";
/// Name of the search job. A search cannot be stopped; a cancelled one is ignored.
const SEARCH: &str = "looking for what is missing";

/// Reads the campaign of the desk, then searches for effects missing from its model.
pub fn read_campaign(shared: &Arc<Shared>) {
    let Some(path) = shared.dataset.clone() else { return };
    if shared.live().is_some() && !path.exists() {
        shared.desk().data = super::Data::None;
        return;
    }
    let begun = start(shared, "reading the campaign", move |shared, job| {
        shared.desk().data = super::Data::Reading;
        let campaign = read(&path, shared.plane, &job.stop, &mut |done, of| job.step(done, of));
        let effects = shared.effects.clone();
        let laid = campaign.and_then(|campaign| shared.desk().lay(campaign, &effects));
        if let Err(e) = laid {
            let why = if job.is_stopped() { "reading was cancelled".to_string() } else { e };
            let mut desk = shared.desk();
            if desk.campaign().is_none() {
                desk.data = super::Data::Failed(why);
                return Ok(());
            }
            return Err(why);
        }
        shared.model_changed();
        look(shared, job)
    });
    if let Err(e) = begun {
        shared.desk().error = Some(e);
    }
}

/// Searches for effects missing from the model on the desk; repeats if the model has changed meanwhile.
fn look(shared: &Arc<Shared>, job: &Job) -> Result<(), String> {
    loop {
        let (campaign, on, revision) = {
            let mut desk = shared.desk();
            let campaign = desk.campaign().ok_or("there is no campaign yet")?;
            desk.found = Found::Searching;
            let on: Vec<_> = desk.entries().into_iter().filter(|e| e.on).map(|e| e.effect).collect();
            (campaign, on, desk.revision)
        };
        shared.model_changed();
        let known = given(&on).map_err(|e| e.to_string())?;
        let all = &campaign.all;
        let d = diagnose(all, None, searched(all, &known), &mut |_| {});
        if job.is_stopped() {
            return Err(CANCELLED.into());
        }
        let mut desk = shared.desk();
        if desk.revision == revision {
            desk.found = Found::Done(Arc::new(d));
            return Ok(());
        }
    }
}

/// Changes the model and responds with the updated page. Starts a search in the background.
async fn change(
    shared: Arc<Shared>,
    work: impl FnOnce(&mut super::Desk) -> Result<(), String> + Send + 'static,
) -> Response {
    let busy = shared.clone();
    let done = aside(move || {
        let mut desk = busy.desk();
        desk.error = None;
        let done = work(&mut desk);
        if let Err(e) = &done {
            desk.error = Some(e.clone());
        }
        done.is_ok()
    })
    .await;
    if done == Ok(true) {
        let _ = start(&shared, SEARCH, look);
    }
    shared.model_changed();
    model::main(&shared).into_response()
}

/// Form that names one effect.
#[derive(Deserialize)]
pub struct Named {
    effect: String,
}

/// Adds an effect found by the search to the model.
pub async fn add(State(shared): Desktop, Form(named): Form<Named>) -> Response {
    let asked = shared.clone();
    let id = named.effect.clone();
    // Fitting takes time; it runs aside so that the pages still respond.
    let added = aside(move || {
        let (found, campaign, on) = {
            let desk = asked.desk();
            let found = match &desk.found {
                Found::Done(d) => {
                    let entries = desk.entries();
                    let taken: Vec<&str> = entries.iter().map(Entry::name).collect();
                    entries_of(d, &id, &taken)
                }
                _ => None,
            };
            let on: Vec<_> = desk.entries().into_iter().filter(|e| e.on).map(|e| e.effect).collect();
            (found, desk.campaign(), on)
        };
        match found {
            Some(entries) => Ok(entries),
            None => {
                let campaign = campaign.ok_or("there is no campaign yet")?;
                searched_for(&campaign, on, &id).map(|entry| vec![entry])
            }
        }
    })
    .await
    .and_then(|r| r);
    change(shared, move |desk| {
        let added = added?;
        let mut entries = desk.entries();
        entries.retain(|e| added.iter().all(|a| a.name() != e.name()));
        entries.extend(added);
        desk.take(format!("+ {}", named.effect), entries)
    })
    .await
}

/// Fits an effect of the catalogue beside a model.
fn searched_for(campaign: &Campaign, mut on: Vec<EffectValues>, id: &str) -> Result<Entry, String> {
    on.retain(|e| e.called() != id);
    on.push(EffectValues::new(id));
    let known = given(&on).map_err(|e| e.to_string())?;
    let found = searched(&campaign.all, &known);
    let (effect, values) = found.last().ok_or("nothing was found")?;
    let named = effect.parameters().iter().zip(values).map(|(p, v)| (p.name.to_string(), *v)).collect();
    Ok(Entry { on: true, effect: EffectValues { parameters: named, ..EffectValues::new(id) } })
}

/// Switches an effect of the model on or off.
pub async fn switch(State(shared): Desktop, Form(named): Form<Named>) -> Response {
    change(shared, move |desk| {
        let mut entries = desk.entries();
        let entry = entries.iter_mut().find(|e| e.name() == named.effect);
        let entry = entry.ok_or_else(|| format!("the model has no {}", named.effect))?;
        entry.on = !entry.on;
        let sign = if entry.on { "+" } else { "−" };
        desk.take(format!("{sign} {}", named.effect), entries)
    })
    .await
}

/// Removes an effect from the model.
pub async fn remove(State(shared): Desktop, Form(named): Form<Named>) -> Response {
    change(shared, move |desk| {
        let mut entries = desk.entries();
        entries.retain(|e| e.name() != named.effect);
        desk.take(format!("− {}", named.effect), entries)
    })
    .await
}

/// Undoes the last step.
pub async fn undo(State(shared): Desktop) -> Response {
    change(shared, super::Desk::undo).await
}

/// Searches again for missing effects.
pub async fn search(State(shared): Desktop) -> Response {
    if let Err(e) = start(&shared, SEARCH, look) {
        shared.desk().error = Some(e);
    }
    model::main(&shared).into_response()
}

/// The user's own effect, as typed.
#[derive(Deserialize)]
pub struct Own {
    name: String,
    target: String,
    formula: String,
    #[serde(default)]
    parameters: String,
}

/// Fits the user's own effect on trial, without adding it.
pub async fn try_own(State(shared): Desktop, Form(typed): Form<Own>) -> Markup {
    let tried = aside(move || -> Result<(f64, Judged), String> {
        let effect =
            own(&typed.name, &typed.target, &typed.formula, &typed.parameters).map_err(|e| e.to_string())?;
        let (campaign, mut on, before) = {
            let desk = shared.desk();
            let on: Vec<_> = desk.entries().into_iter().filter(|e| e.on).map(|e| e.effect).collect();
            let before = desk.steps.now().map_or(f64::NAN, |s| s.error);
            (desk.campaign().ok_or("there is no campaign yet")?, on, before)
        };
        on.push(effect);
        Ok((before, judge(&campaign.all, &on)?))
    })
    .await
    .and_then(|r| r);
    match tried {
        Ok((before, judged)) => model::tried(before, &judged),
        Err(e) => shell::alert(&e),
    }
}

/// Adds the user's own effect to the model, with its fitted values.
pub async fn add_own(State(shared): Desktop, Form(typed): Form<Own>) -> Response {
    change(shared, move |desk| {
        let mut effect =
            own(&typed.name, &typed.target, &typed.formula, &typed.parameters).map_err(|e| e.to_string())?;
        let campaign = desk.campaign().ok_or("there is no campaign yet")?;
        let mut entries = desk.entries();
        entries.retain(|e| e.name() != typed.name.trim());
        let on: Vec<_> =
            entries.iter().filter(|e| e.on).map(|e| e.effect.clone()).chain([effect.clone()]).collect();
        let judged = judge(&campaign.all, &on)?;
        if let Some((e, values)) = judged.fitted.effects.last() {
            effect.parameters =
                e.parameters().iter().zip(values).map(|(p, v)| (p.name.to_string(), *v)).collect();
        }
        entries.push(Entry { on: true, effect });
        desk.take(format!("+ {}", typed.name.trim()), entries)
    })
    .await
}

/// Cancels the running job.
pub async fn cancel(State(shared): Desktop) -> Markup {
    {
        let mut running = lock(&shared.job);
        if let Some(job) = running.clone() {
            job.stop.store(true, Ordering::Relaxed);
            if job.what == SEARCH {
                *running = None;
                shared.desk().found = Found::None;
            }
        }
    }
    if let Some(live) = shared.live() {
        live.operator.give_up();
    }
    shared.model_changed();
    shell::status(&shared)
}

/// Revision that the page has seen last.
#[derive(Deserialize)]
pub struct Seen {
    #[serde(default)]
    seen: u64,
}

/// Waits for a change (long polling). Returns the revision of the model, the overall revision, and a flag for
/// a running job. The wait is at most 250 ms while a job runs, to update its progress, and 20 s otherwise.
pub async fn events(State(shared): Desktop, Query(q): Query<Seen>) -> String {
    let mut changed = shared.changed.subscribe();
    let newer = changed.wait_for(|c| c.1 > q.seen);
    let busy = || u8::from(lock(&shared.job).is_some());
    let patience = if busy() == 1 { 250 } else { 20_000 };
    let _ = tokio::time::timeout(std::time::Duration::from_millis(patience), newer).await;
    let (model, all) = *shared.changed.borrow();
    format!("{model},{all},{}", busy())
}

/// Answer of the bench operator.
#[derive(Deserialize)]
pub struct Answer {
    number: u64,
    done: bool,
}

/// Accepts the operator's answer: the bench was moved, or the operator gave up.
pub async fn operator(State(shared): Desktop, Form(answer): Form<Answer>) -> Markup {
    if let Some(live) = shared.live() {
        live.operator.answer(answer.number, answer.done);
    }
    shell::status(&shared)
}

/// Settings of the camera, as typed; empty fields leave the setting unchanged.
#[derive(Deserialize)]
pub struct Settings {
    #[serde(default)]
    exposure_ms: String,
    #[serde(default)]
    gain_db: String,
    #[serde(default)]
    light_percent: String,
    #[serde(default)]
    region: String,
}

/// Changes settings of the camera.
pub async fn set_camera(State(shared): Desktop, Form(s): Form<Settings>) -> Markup {
    let said = aside(move || -> Result<Vec<String>, String> {
        let live = shared.live().ok_or("there is no camera")?;
        let number = |what: &str, text: &str| -> Result<Option<f64>, String> {
            let text = text.trim();
            if text.is_empty() {
                return Ok(None);
            }
            text.parse().map(Some).map_err(|_| format!("{what}: \"{text}\" is not a number"))
        };
        let (ms, db) = (number("exposure", &s.exposure_ms)?, number("gain", &s.gain_db)?);
        let (percent, region) = (number("light", &s.light_percent)?, region_of(&s.region)?);
        let running = lock(&shared.job).as_ref().map(|j| j.what.clone());
        if let Some(what) = running.filter(|w| w == CAPTURE) {
            return Err(format!("{what}: the settings stay as they are until it has ended"));
        }
        let orders = [
            ms.map(|ms| Order::Exposure(ms / 1e3)),
            db.map(Order::Gain),
            percent.map(|p| Order::Light(p / 100.0)),
            region.map(|[x, y, width, height]| Order::Region(Region { x, y, width, height })),
        ];
        let mut said: Vec<String> = Vec::new();
        for order in orders.into_iter().flatten() {
            match live.order(order) {
                Ok(text) => said.push(text),
                Err(e) if said.is_empty() => return Err(e),
                Err(e) => return Err(format!("{e}; before that the camera took {}", said.join(", "))),
            }
        }
        Ok(said)
    })
    .await
    .and_then(|r| r);
    match said {
        Ok(said) if said.is_empty() => html! { p role="status" { "Nothing to change." } },
        Ok(said) => html! { p role="status" { "The camera reports " (said.join(", ")) "." } },
        Err(e) => shell::alert(&e),
    }
}

/// Parses `column,row,width,height`; an empty text gives none.
fn region_of(text: &str) -> Result<Option<[u32; 4]>, String> {
    if text.trim().is_empty() {
        return Ok(None);
    }
    let parts: Result<Vec<u32>, _> = text.split(',').map(|p| p.trim().parse()).collect();
    let region = parts.ok().and_then(|p| <[u32; 4]>::try_from(p).ok());
    region.map(Some).ok_or_else(|| format!("region: write column,row,width,height in pixels, not \"{text}\""))
}

/// Name of the capture job.
const CAPTURE: &str = "capturing";

/// Form of a capture.
#[derive(Deserialize)]
pub struct Captured {
    plan: String,
    #[serde(default)]
    frames: String,
    #[serde(default)]
    region: String,
    #[serde(default)]
    own: String,
}

/// Captures a plan, reads the campaign and searches for missing effects.
pub async fn capture(State(shared): Desktop, Form(c): Form<Captured>) -> Markup {
    let begun = (|| {
        let mut plan = if c.own.trim().is_empty() {
            Plan::named(&c.plan).ok_or_else(|| format!("there is no plan \"{}\"", c.plan))?
        } else {
            Plan::from_toml(&c.own).map_err(|e| format!("the plan: {e}"))?
        };
        if !c.frames.trim().is_empty() {
            let frames: u32 =
                c.frames.trim().parse().map_err(|_| format!("frames: \"{}\" is not a number", c.frames))?;
            plan.sets.iter_mut().for_each(|s| s.frames = frames.max(2));
        }
        if let Some(region) = region_of(&c.region)? {
            plan.camera.region = Some(region);
        }
        let folder = shared
            .dataset
            .clone()
            .ok_or("name a folder for captures: radcam workbench FOLDER --camera ID")?;
        if shared.desk().campaign().is_some() && !is_incomplete(&folder) {
            return Err(format!("{} holds a campaign already; name a new folder", folder.display()));
        }
        begin_capture(&shared, plan, folder, false)
    })();
    match begun {
        Ok(()) => shell::status(&shared),
        Err(e) => {
            shared.desk().error = Some(e);
            shell::status(&shared)
        }
    }
}

fn begin_capture(shared: &Arc<Shared>, plan: Plan, folder: PathBuf, extend: bool) -> Result<(), String> {
    if shared.live().is_none() {
        return Err("there is no camera".into());
    }
    start(shared, CAPTURE, move |shared, job| {
        let live = shared.live().ok_or("there is no camera")?;
        let handle = lock(&shared.job).clone().ok_or("the work is gone")?;
        live.order(Order::Capture { plan: Box::new(plan), folder: folder.clone(), extend, job: handle })?;
        let campaign = read(&folder, shared.plane, &job.stop, &mut |done, of| job.step(done, of))?;
        let effects = shared.effects.clone();
        shared.desk().lay(campaign, &effects)?;
        shared.model_changed();
        look(shared, job)
    })
}

/// Captures the measurement that separates the closest candidates.
pub async fn take_next(State(shared): Desktop) -> Markup {
    let begun = (|| {
        let plan = match &shared.desk().found {
            Found::Done(d) => d.next_plan.clone(),
            _ => None,
        };
        let plan = plan.ok_or("there is nothing left to be told apart")?;
        let folder = shared.dataset.clone().ok_or("there is no folder")?;
        if !folder.join(PLAN_FILE).exists() {
            return Err(format!(
                "{} was not captured by radcam: a measurement cannot be added to it",
                folder.display()
            ));
        }
        begin_capture(&shared, plan, folder, true)
    })();
    if let Err(e) = begun {
        shared.desk().error = Some(e);
    }
    shell::status(&shared)
}

/// Reads the other campaigns.
pub async fn read_runs(State(shared): Desktop) -> Markup {
    let begun = start(&shared, "reading the other campaigns", |shared, job| {
        lock(&shared.runs).clear();
        for path in shared.others.clone() {
            let said = read(&path, shared.plane, &job.stop, &mut |done, of| job.step(done, of)).map(|c| {
                let known = given(&shared.effects).unwrap_or_default();
                let d = diagnose(&c.all, None, searched(&c.all, &known), &mut |_| {});
                let base = d.fitted.as_ref().map(|f| (f.base.gain_dn_per_e, f.base.read_noise_e));
                let (gain, noise) = base.unwrap_or((f64::NAN, f64::NAN));
                (d, gain, noise)
            });
            if job.is_stopped() {
                return Err(CANCELLED.into());
            }
            lock(&shared.runs).push(Run { path, said });
            shared.model_changed();
        }
        Ok(())
    });
    if let Err(e) = begun {
        shared.desk().error = Some(e);
    }
    shell::status(&shared)
}

/// Requested kind of calibration.
#[derive(Debug, serde::Deserialize)]
pub struct Kind {
    /// Flat-field correction: the light of the flats stays in K.
    #[serde(default)]
    flat_field: bool,
}

/// Writes a calibration file beside the steps.
pub async fn calibrate(State(shared): Desktop, Form(kind): Form<Kind>) -> Markup {
    let (estimator, name) =
        if kind.flat_field { (Estimator::FlatField, FLAT_FIELD) } else { (Estimator::Joint, CALIBRATION) };
    let begun = start(&shared, "calibrating", move |shared, job| {
        let campaign = shared.desk().campaign().ok_or("there is no campaign yet")?;
        let dataset = campaign.dataset().ok_or("a table has no frames to calibrate with")?;
        let noise = match crate::noise::of_dataset(dataset, &job.stop, &mut |done, of| job.step(done, of)) {
            Err(crate::noise::NoiseError::Interrupted) => return Err(CANCELLED.into()),
            other => other.ok(),
        };
        let provenance = format!("radcam {} from {}", env!("CARGO_PKG_VERSION"), campaign.path.display());
        let made = of_dataset(dataset, estimator, noise.as_ref(), &provenance).map_err(|e| e.to_string())?;
        if job.is_stopped() {
            return Err(CANCELLED.into());
        }
        let folder = folder_of(&campaign.path);
        crate::output::folder(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        made.calibration.write(&folder.join(name)).map_err(|e| e.to_string())
    });
    if let Err(e) = begun {
        shared.desk().error = Some(e);
    }
    shell::status(&shared)
}

fn failed(e: &str) -> Response {
    (StatusCode::CONFLICT, [(header::CONTENT_TYPE, "text/plain; charset=utf-8")], format!("{e}\n"))
        .into_response()
}

/// Serves the report of the current model.
pub async fn report(State(shared): Desktop) -> Response {
    let made = aside(move || -> Result<String, String> {
        let (campaign, judged, found) = {
            let desk = shared.desk();
            let [judged, _] = desk.judged.clone().ok_or("there is no model yet")?;
            let found = match &desk.found {
                Found::Done(d) => Some(d.clone()),
                _ => None,
            };
            (desk.campaign().ok_or("there is no campaign yet")?, judged, found)
        };
        let (judgement, verdict) = match &found {
            Some(d) => (Judgement::of_diagnosis(d), Some(d.verdict.clone())),
            None => (Judgement::of_comparison(&judged.comparison, &judged.fitted), None),
        };
        let folder = folder_of(&campaign.path);
        let command = format!(
            "radcam report {} --model {}",
            campaign.path.display(),
            folder.join("model.toml").display()
        );
        let paths = [campaign.path.clone()];
        let provenance = Provenance::of(&paths, &campaign.source, &command).map_err(|e| e.to_string())?;
        let never = std::sync::atomic::AtomicBool::new(false);
        let judged = (&judgement, verdict.as_ref());
        let study =
            Study::of(&campaign.source, &campaign.all, judged, None, provenance, &never, &mut |_, _| {});
        let page = crate::report::study::html(&study.map_err(|e| e.to_string())?, &campaign.kinds);
        crate::output::folder(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        let path = folder.join("report.html");
        crate::dataset::write_whole(&path, page.as_bytes()).map_err(|e| e.to_string())?;
        Ok(page)
    })
    .await
    .and_then(|r| r);
    match made {
        Ok(page) => {
            let name = "attachment; filename=\"report.html\"";
            ([(header::CONTENT_TYPE, "text/html; charset=utf-8"), (header::CONTENT_DISPOSITION, name)], page)
                .into_response()
        }
        Err(e) => failed(&e),
    }
}

fn toml_file(name: &str, text: Result<String, String>) -> Response {
    match text {
        Ok(text) => {
            let name = format!("attachment; filename=\"{name}\"");
            (
                [(header::CONTENT_TYPE, "application/toml".to_string()), (header::CONTENT_DISPOSITION, name)],
                text,
            )
                .into_response()
        }
        Err(e) => failed(&e),
    }
}

/// Serves the model file.
pub async fn model_file(State(shared): Desktop) -> Response {
    let desk = shared.desk();
    let text = desk.campaign().and_then(|c| desk.model(&c)).ok_or("there is no model yet".to_string());
    toml_file("model.toml", text.and_then(|m| m.to_toml().map_err(|e| e.to_string())))
}

/// Serves the plan of the measurement that separates the closest candidates.
pub async fn next_file(State(shared): Desktop) -> Response {
    let plan = match &shared.desk().found {
        Found::Done(d) => d.next_plan.clone(),
        _ => None,
    };
    let plan = plan.ok_or("there is nothing left to be told apart".to_string());
    toml_file("next.toml", plan.and_then(|p| p.to_toml().map_err(|e| e.to_string())))
}
