//! Camera page: live picture with its statistics, the main settings, and captures.

use super::shell::{self, Part};
use crate::camera::Bounds;
use crate::workbench::Shared;
use crate::workbench::live::{Live, is_incomplete};
use axum::extract::{Query, State};
use maud::{Markup, html};
use std::sync::Arc;

/// Renders the page, or its main part.
pub async fn page(State(shared): State<Arc<Shared>>, Query(q): Query<Part>) -> Markup {
    let body = match shared.live() {
        Some(live) => body(&shared, live),
        None => html! { h1 { "Camera" } p { "No camera was named: radcam workbench FOLDER --camera ID." } },
    };
    let main = shell::main(&shared, "", body);
    if q.part.is_some() { main } else { shell::page(&shared, "/camera", main) }
}

fn range(bounds: Option<Bounds>, scale: f64, unit: &str) -> String {
    bounds.map_or("not available".into(), |b| {
        format!("{} to {} {unit}", number(scale * b.min), number(scale * b.max))
    })
}

fn number(x: f64) -> String {
    format!("{:.4}", x).trim_end_matches('0').trim_end_matches('.').into()
}

fn body(shared: &Shared, live: &Live) -> Markup {
    let (settings, light, _) = live.state();
    let c = &live.capabilities;
    let set = settings.as_ref();
    html! {
        h1 { "Camera" }
        p.sub { (live.identity) }
        div.view {
            div {
                canvas #live role="img" aria-label="live picture" {}
                p #live-error role="alert" {}
            }
            div.side {
                dl.facts #live-says {
                    @for (id, name) in [("frame", "Frame"), ("mean", "Mean (DN)"), ("variance", "Temporal variance (DN²)"), ("saturated", "Saturated pixels"), ("rate", "Pictures a second")] {
                        div { dt { (name) } dd id={ "live-" (id) } { "–" } }
                    }
                }
                label.check { input #live-mark type="checkbox" checked; " Mark saturated pixels" }
                label.check { input #live-stretch type="checkbox"; " Stretch from darkest to brightest" }
                h2 { "Settings" }
                form.own hx-post="/camera/set" hx-target="#set" hx-swap="innerHTML" {
                    label { "Exposure (ms)" input name="exposure_ms" inputmode="decimal" placeholder=(set.map_or(String::new(), |s| number(1e3 * s.exposure_s))); small { (range(c.exposure_s, 1e3, "ms")) } }
                    label { "Gain (dB)" input name="gain_db" inputmode="decimal" placeholder=(set.and_then(|s| s.gain_db).map_or(String::new(), number)); small { (range(c.gain_db, 1.0, "dB")) } }
                    label { "Light (%)" input name="light_percent" inputmode="decimal" placeholder=(number(100.0 * light)); small { "of the bench's full light" } }
                    label { "Region (column,row,width,height)" input name="region" placeholder=(set.map_or(String::new(), |s| format!("{},{},{},{}", s.region.x, s.region.y, s.region.width, s.region.height))); small { "px" } }
                    p.buttons { button { "Set" } }
                }
                div #set aria-live="polite" {}
            }
        }
        h2 { "Capture" }
        @if let Some(folder) = shared.dataset.as_ref().filter(|f| is_incomplete(f)) {
            p { (folder.display()) " holds a capture that has not all frames of its plan." }
            p.buttons { button.first hx-post="/camera/capture" hx-vals="{\"plan\": \"quick\"}" hx-target="#status" hx-swap="outerHTML" { "Go on with it" } }
            (shell::command(&format!("radcam capture --camera {} -o {} --resume", live.id, folder.display())))
        } @else if let Some(folder) = &shared.dataset {
            form.own hx-post="/camera/capture" hx-target="#status" hx-swap="outerHTML" {
                label { "Plan" select name="plan" { @for p in ["quick", "standard", "emva1288"] { option selected[p == "standard"] { (p) } } } }
                label { "Frames in each set" input name="frames" inputmode="numeric" placeholder="as the plan has it"; }
                label { "Region (column,row,width,height)" input name="region" placeholder="as set above"; }
                details.long { summary { "A plan of your own" } label { "TOML, as radcam capture --plan takes it; it is captured in place of the one above" textarea name="own" rows="8" spellcheck="false" {} } }
                p.buttons { button.first { "Capture and diagnose" } }
            }
            p.note { "Automatic functions are switched off first. What is taken is kept frame by frame; a capture that ends early goes on where it was." }
            (shell::command(&format!("radcam capture --camera {} --plan standard -o {}", live.id, folder.display())))
        } @else {
            p { "Name a folder to capture into: radcam workbench FOLDER --camera ID." }
        }
    }
}
