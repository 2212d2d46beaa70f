//! Save page: the model, the report, a calibration; each with the equivalent command.

use super::shell::{self, Part};
use crate::workbench::Shared;
use crate::workbench::steps::{CALIBRATION, FLAT_FIELD, folder_of};
use axum::extract::{Query, State};
use maud::{Markup, html};
use std::sync::Arc;

/// Renders the page, or its main part.
pub async fn page(State(shared): State<Arc<Shared>>, Query(q): Query<Part>) -> Markup {
    let main = shell::main(&shared, "/save", body(&shared));
    if q.part.is_some() { main } else { shell::page(&shared, "/save", main) }
}

fn body(shared: &Shared) -> Markup {
    let Some(campaign) = shared.desk().campaign() else {
        return html! { h1 { "Save" } p { "There is nothing to save yet." } };
    };
    let folder = folder_of(&campaign.path);
    let (data, model) = (campaign.path.display(), folder.join("model.toml"));
    let (cal, flat) = (folder.join(CALIBRATION), folder.join(FLAT_FIELD));
    html! {
        h1 { "Save" }
        p { "Every step is kept in " code { (folder.display()) } " as it is made." }
        h2 { "Model" }
        p { a.button href="/save/model.toml" { "Download model.toml" } " the effects that are on, with their values" }
        (shell::command(&format!("radcam compare {data} --model {}", model.display())))
        h2 { "Report" }
        p { a.button href="/save/report.html" { "Download report.html" } " verdict, evidence, curves, images and numbers as one page" }
        (shell::command(&format!("radcam report {data} --model {} -o report.html", model.display())))
        h2 { "Calibration" }
        p { button hx-post="/save/calibration" hx-target="#status" hx-swap="outerHTML" { "Calibrate" } " dark reference, fixed pattern and defects, for radcam correct" }
        @if cal.exists() { p role="status" { code { (cal.display()) } " is written." } }
        (shell::command(&format!("radcam calibrate {data} -o {}", cal.display())))
        p { button hx-post="/save/calibration" hx-vals=r#"{"flat_field": true}"# hx-target="#status" hx-swap="outerHTML" { "Flat-field correction" } " the light of the flats as well: lens shading, lamp and card" }
        @if flat.exists() { p role="status" { code { (flat.display()) } " is written." } }
        (shell::command(&format!("radcam calibrate {data} --flat-field -o {}", flat.display())))
    }
}
