//! Layout of all pages: title, navigation, status and errors.

use crate::workbench::Shared;
use crate::workbench::live::lock;
use maud::{DOCTYPE, Markup, html};
use std::sync::Arc;

/// Query for the main part alone, sent by a page that is already open.
#[derive(serde::Deserialize)]
pub struct Part {
    /// If present, only the main part is rendered.
    pub part: Option<String>,
}

/// Renders an error that a screen reader announces at once.
pub fn alert(text: &str) -> Markup {
    html! { p.error role="alert" { (text) } }
}

/// Renders the equivalent command.
pub fn command(text: &str) -> Markup {
    html! { p.command { "Command: " code { (text) } } }
}

fn title(shared: &Shared) -> String {
    let name = shared.dataset.as_ref().map(|p| p.display().to_string());
    name.or_else(|| shared.live().map(|l| l.identity.clone()))
        .or_else(|| shared.history.as_deref().map(crate::secret::shown))
        .unwrap_or_default()
}

/// Renders a whole page. `room` is its route.
pub fn page(shared: &Arc<Shared>, room: &str, main: Markup) -> Markup {
    let rooms = [
        (shared.dataset.is_some() || shared.live().is_some(), "/", "Model"),
        (shared.dataset.is_some(), "/data", "Data"),
        (shared.live().is_some(), "/camera", "Camera"),
        (!shared.others.is_empty(), "/runs", "Runs"),
        (shared.history.is_some(), "/history", "History"),
        (shared.dataset.is_some(), "/save", "Save"),
    ];
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="htmx-config" content="{\"allowEval\":false,\"includeIndicatorStyles\":false,\"historyEnabled\":false}";
                title { "radcam: " (title(shared)) }
                link rel="stylesheet" href="/style.css";
                link rel="icon" href="data:,";
                @for script in ["/uPlot.js", "/htmx.js", "/figures.js", "/viewer.js", "/workbench.js"] { script src=(script) defer {} }
            }
            body.workbench {
                a.skip href="#main" { "To the content" }
                header {
                    p.name { b { "radcam" } " " (title(shared)) }
                    nav aria-label="Pages" {
                        @for (_, address, name) in rooms.iter().filter(|r| r.0) {
                            a href=(address) aria-current=[(*address == room).then_some("page")] { (name) }
                        }
                    }
                    (status(shared))
                    p #said role="alert" {}
                    p #heard.hidden aria-live="polite" {}
                }
                (main)
            }
        }
    }
}

/// Renders the status: the running job with progress and cancellation, a question of the bench, the last
/// error. Two states with the same key differ in progress only.
pub fn status(shared: &Arc<Shared>) -> Markup {
    let job = lock(&shared.job).clone();
    let question = shared.live().and_then(|l| l.operator.question());
    let error = shared.desk().error.clone().or_else(|| shared.live().and_then(|l| l.state().2));
    let key = format!(
        "{:?} {:?} {error:?}",
        job.as_ref().map(|j| (&j.what, j.is_stopped(), j.progress().1)),
        question.as_ref().map(|q| q.0)
    );
    let answer = |number: u64, done: bool| serde_json::json!({ "number": number, "done": done }).to_string();
    html! {
        div #status data-key=(key) {
            @if let Some(job) = &job {
                @let (done, of) = job.progress();
                p.job {
                    span.what { (job.what) @if of > 0 { ": " (done) " of " (of) } @else { " …" } }
                    @if of > 0 { progress value=(done) max=(of) aria-label=(job.what) {} } @else { progress aria-label=(job.what) {} }
                    @if job.is_stopped() { span { "is being cancelled" } }
                    @else { button #cancel hx-post="/job/cancel" hx-target="#status" hx-swap="outerHTML" { "Cancel" } }
                }
            }
            @if let Some((number, question)) = &question {
                p.question role="alert" {
                    b { (question) "." } " "
                    button #done hx-post="/operator" hx-vals=(answer(*number, true)) hx-target="#status" hx-swap="outerHTML" { "Done" } " "
                    button #give-up hx-post="/operator" hx-vals=(answer(*number, false)) hx-target="#status" hx-swap="outerHTML" { "Give up" }
                }
            }
            @if let Some(error) = &error { (alert(error)) }
        }
    }
}

/// Renders the main part of a page; it is re-rendered from the route `room` when the model changes.
pub fn main(shared: &Shared, room: &str, body: Markup) -> Markup {
    let (model, _) = *shared.changed.borrow();
    html! { main #main data-model=(model) data-room=(room) { (body) } }
}
