//! What `radcam monitor` keeps: alarms, and every reading over time.

use super::shell::{self, Part};
use crate::monitor::store::{Store, StoreError};
use crate::monitor::{Check, Followed, clock};
use crate::plot::{Plot, Shape, axis, series};
use crate::report::plot::wide;
use crate::workbench::{Shared, aside};
use axum::extract::{Query, State};
use maud::{Markup, html};
use std::collections::BTreeSet;
use std::sync::Arc;

/// A camera's checks and alarms.
struct Kept {
    camera: String,
    checks: Vec<Check>,
    /// Name, time and sentence.
    alarms: Vec<(String, f64, String)>,
}

fn read(url: &str) -> Result<Vec<Kept>, StoreError> {
    let store = Store::open(url)?;
    let of =
        |camera: String| Ok(Kept { checks: store.history(&camera)?, alarms: store.alarms(&camera)?, camera });
    store.cameras()?.into_iter().map(of).collect()
}

/// The page, or its main part.
pub async fn page(State(shared): State<Arc<Shared>>, Query(q): Query<Part>) -> Markup {
    let url = shared.history.clone();
    let kept = aside(move || url.map(|u| read(&u).map_err(|e| e.to_string()))).await;
    let body = match kept {
        Ok(Some(Ok(all))) => body(&all),
        Ok(Some(Err(e))) | Err(e) => shell::alert(&e),
        Ok(None) => html! { p { "Name a history: " code { "radcam workbench --history history.db" } } },
    };
    let main = shell::main(&shared, "/history", body);
    if q.part.is_some() { main } else { shell::page(&shared, "/history", main) }
}

fn body(all: &[Kept]) -> Markup {
    html! {
        h1 { "History of checks" }
        @if all.is_empty() { p { "No check was kept yet." } }
        @for kept in all {
            section {
                h2 { (kept.camera) }
                @if let [first, .., last] = &kept.checks[..] {
                    p { (kept.checks.len()) " checks from " (clock(first.time_s)) " to " (clock(last.time_s)) "." }
                }
                @if kept.alarms.is_empty() { p { "Nothing changed." } } @else {
                    div.scroll tabindex="0" role="region" aria-label={ "changes of " (kept.camera) } {
                        table {
                            thead { tr { th.text { "found" } th.text { "what changed, since when, what it costs" } } }
                            @for (_, time_s, sentence) in kept.alarms.iter().rev() {
                                tr { th scope="row" { (clock(*time_s)) } td.text { (sentence) } }
                            }
                        }
                    }
                }
                @for figure in figures(kept) { (wide(&figure)) }
            }
        }
    }
}

/// A name that an element and a file may have.
fn identifier(text: &str) -> String {
    text.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).collect()
}

/// A figure for each reading, the checks after which something was found marked.
fn figures(kept: &Kept) -> Vec<Plot> {
    let Some(begun) = kept.checks.first().map(|c| c.time_s) else { return Vec::new() };
    let followed: BTreeSet<Followed> = kept.checks.iter().flat_map(|c| c.readings.keys().copied()).collect();
    // Times are kept to the nanosecond.
    let found = |time_s: f64| kept.alarms.iter().any(|a| (a.1 - time_s).abs() < 1e-6);
    let figure = |what: Followed| {
        let point = |c: &Check| {
            let r = c.readings.get(&what)?;
            Some([(c.time_s - begun) / 3600.0, r.value, r.std_err])
        };
        let mut all = vec![series("check", Shape::Points, kept.checks.iter().filter_map(point).collect())];
        let marked: Vec<_> = kept.checks.iter().filter(|c| found(c.time_s)).filter_map(point).collect();
        if !marked.is_empty() {
            all.push(series("something changed", Shape::Points, marked));
        }
        Plot {
            id: identifier(&format!("{}-{what:?}", kept.camera)).into(),
            title: what.title().into(),
            x: axis(format!("Hours since {}", clock(begun))),
            y: axis(what.title()),
            series: all,
            y_range: None,
        }
    };
    followed.into_iter().map(figure).collect()
}
