//! Comparison of campaigns: verdict, error, gain and read noise of each.

use super::shell::{self, Part};
use crate::number::with_error;
use crate::report::heading;
use crate::workbench::Shared;
use crate::workbench::desk::Found;
use crate::workbench::live::lock;
use axum::extract::{Query, State};
use maud::{Markup, html};
use std::sync::Arc;

/// Renders the page, or its main part.
pub async fn page(State(shared): State<Arc<Shared>>, Query(q): Query<Part>) -> Markup {
    let main = shell::main(&shared, "/runs", body(&shared));
    if q.part.is_some() { main } else { shell::page(&shared, "/runs", main) }
}

fn body(shared: &Shared) -> Markup {
    let desk = shared.desk();
    let runs = lock(&shared.runs);
    html! {
        h1 { "Campaigns side by side" }
        p { button hx-post="/runs/read" hx-target="#status" hx-swap="outerHTML" { "Read the others" } }
        div.scroll tabindex="0" role="region" aria-label="campaigns" {
            table {
                thead { tr { th { "campaign" } th { "error as given" } th { "error after" } th { "gain (DN/e⁻)" } th { "read noise (e⁻)" } th.text { "missing" } } }
                @if let (Some(path), Some([now, first])) = (&shared.dataset, &desk.judged) {
                    @let (b, e) = (&now.fitted.base, &now.fitted.base_std_err);
                    tr {
                        th scope="row" { b { (path.display()) } " (this one)" }
                        td.number { (format!("{:.3}", first.comparison.error)) } td.number { (format!("{:.3}", now.comparison.error)) }
                        td.number { (with_error(b.gain_dn_per_e, e[0])) } td.number { (with_error(b.read_noise_e, e[1])) }
                        td.text { @if let Found::Done(d) = &desk.found { @for m in &d.missing { (m.effect) " " span.note { (heading(m)) } br; } } }
                    }
                }
                @for run in runs.iter() {
                    tr {
                        th scope="row" { (run.path.display()) }
                        @match &run.said {
                            Ok((d, gain, noise)) => {
                                td.number { (format!("{:.3}", d.error_before)) } td.number { (format!("{:.3}", d.error_after)) }
                                td.number { (format!("{gain:.5}")) } td.number { (format!("{noise:.3}")) }
                                td.text { @for m in &d.missing { (m.effect) " " span.note { (heading(m)) } br; } @if d.missing.is_empty() { "nothing" } }
                            }
                            Err(e) => { td.text colspan="5" { (shell::alert(e)) } }
                        }
                    }
                }
            }
        }
    }
}
