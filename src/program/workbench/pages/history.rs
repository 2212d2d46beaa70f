//! History page of `radcam monitor`: paged alarms, and every reading over time, thinned by the database.

use super::shell;
use crate::monitor::store::{Period, Point, Store, StoreError};
use crate::monitor::{Followed, clock};
use crate::plot::{Plot, Shape, axis, series};
use crate::report::plot::wide;
use crate::workbench::{Shared, aside};
use axum::extract::{Query, State};
use maud::{Markup, html};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Alarms per page.
const ALARMS: u64 = 100;
/// Cameras per page; with more, one must be selected.
const CAMERAS: usize = 10;

/// Query parameters of the page.
#[derive(Default, serde::Deserialize)]
pub struct Asked {
    /// If present, only the main part is rendered.
    pub part: Option<String>,
    /// Name of one camera.
    pub camera: Option<String>,
    /// Days before the last check; all if absent.
    pub days: Option<f64>,
    /// Page of the alarms, from 0.
    pub alarms: Option<u64>,
}

/// Part of a camera's history.
struct Kept {
    camera: String,
    period: Option<Period>,
    curves: BTreeMap<Followed, Vec<Point>>,
    marked: BTreeMap<Followed, Vec<Point>>,
    /// Number of all alarms; time and sentence of those on the page.
    alarms: (u64, Vec<(f64, String)>),
}

/// Names of all cameras, and the histories shown.
struct Read {
    cameras: Vec<String>,
    shown: Vec<Kept>,
}

fn read(url: &str, asked: &Asked) -> Result<Read, StoreError> {
    let store = Store::open(url)?;
    let days = asked.days.filter(|d| d.is_finite() && *d > 0.0);
    let of = |camera: &String| {
        let period = store.period(camera, days)?;
        let curves = period.map_or(Ok(BTreeMap::new()), |p| store.curves(camera, &p))?;
        let marked = period.map_or(Ok(BTreeMap::new()), |p| store.marked(camera, &p))?;
        let skip = asked.alarms.unwrap_or(0).saturating_mul(ALARMS);
        let alarms = store.alarms_page(camera, skip, ALARMS)?;
        Ok(Kept { camera: camera.clone(), period, curves, marked, alarms })
    };
    let cameras = store.cameras()?;
    let chosen = |camera: &&String| asked.camera.as_ref().is_none_or(|c| c == *camera);
    let shown = cameras.iter().filter(chosen).take(CAMERAS).map(of).collect::<Result<_, _>>()?;
    Ok(Read { cameras, shown })
}

/// Renders the page, or its main part.
pub async fn page(State(shared): State<Arc<Shared>>, Query(q): Query<Asked>) -> Markup {
    let url = shared.history.clone();
    let part = q.part.is_some();
    let kept =
        aside(move || url.map(|u| read(&u, &q).map_err(|e| e.to_string()).map(|r| body(&r, &q)))).await;
    let body = match kept {
        Ok(Some(Ok(body))) => body,
        Ok(Some(Err(e))) | Err(e) => shell::alert(&e),
        Ok(None) => html! { p { "Name a history: " code { "radcam workbench --history history.db" } } },
    };
    let main = shell::main(&shared, "/history", body);
    if part { main } else { shell::page(&shared, "/history", main) }
}

/// Returns the address of another part of the history.
fn address(camera: Option<&str>, days: Option<f64>, alarms: u64) -> String {
    let escaped = |text: &str| -> String {
        let of =
            |b: u8| if b.is_ascii_alphanumeric() { char::from(b).to_string() } else { format!("%{b:02X}") };
        text.bytes().map(of).collect()
    };
    let parts = [
        camera.map(|c| format!("camera={}", escaped(c))),
        days.map(|d| format!("days={d}")),
        (alarms > 0).then(|| format!("alarms={alarms}")),
    ];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    if parts.is_empty() { "/history".into() } else { format!("/history?{}", parts.join("&")) }
}

fn body(read: &Read, q: &Asked) -> Markup {
    let camera = q.camera.as_deref();
    html! {
        h1 { "History of checks" }
        @if read.cameras.is_empty() { p { "No check was kept yet." } }
        @if read.cameras.len() > 1 {
            p { "Cameras: " @for name in &read.cameras { a href=(address(Some(name), q.days, 0)) { (name) } " " } }
        }
        @if !read.cameras.is_empty() {
            p {
                "Checks of the last: "
                @for (name, days) in [("day", Some(1.0)), ("week", Some(7.0)), ("month", Some(30.0)), ("all", None)] {
                    a href=(address(camera, days, 0)) aria-current=[(q.days == days).then_some("true")] { (name) } " "
                }
            }
        }
        @for kept in &read.shown { (section(kept, q)) }
    }
}

fn section(kept: &Kept, q: &Asked) -> Markup {
    let (all, alarms) = &kept.alarms;
    let page = q.alarms.unwrap_or(0);
    let next = page.saturating_add(1);
    let older = next.saturating_mul(ALARMS) < *all;
    html! {
        section {
            h2 { (kept.camera) }
            @if let Some(p) = kept.period.filter(|p| p.checks > 1) {
                p { (p.checks) " checks from " (clock(p.from_s)) " to " (clock(p.to_s)) "." }
            }
            @if *all == 0 { p { "Nothing changed." } } @else {
                div.scroll tabindex="0" role="region" aria-label={ "changes of " (kept.camera) } {
                    table {
                        thead { tr { th.text { "found" } th.text { "what changed, since when, what it costs" } } }
                        @for (time_s, sentence) in alarms {
                            tr { th scope="row" { (clock(*time_s)) } td.text { (sentence) } }
                        }
                    }
                }
                @if *all > ALARMS {
                    p {
                        (all) " changes. "
                        @if page > 0 { a href=(address(Some(&kept.camera), q.days, page - 1)) { "newer" } " " }
                        @if older { a href=(address(Some(&kept.camera), q.days, next)) { "older" } }
                    }
                }
            }
            @for figure in figures(kept) { (wide(&figure)) }
        }
    }
}

/// Converts a text to a name valid for an element and a file.
fn identifier(text: &str) -> String {
    text.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).collect()
}

/// Plots each reading; checks that raised an alarm are marked.
fn figures(kept: &Kept) -> Vec<Plot> {
    let Some(begun) = kept.period.map(|p| p.from_s) else { return Vec::new() };
    let followed: BTreeSet<Followed> = kept.curves.keys().copied().collect();
    let points = |of: &[Point]| {
        of.iter().map(|p| [(p.time_s - begun) / 3600.0, p.value, p.std_err]).collect::<Vec<_>>()
    };
    let figure = |what: Followed| {
        let mut all = vec![series("check", Shape::Points, points(&kept.curves[&what]))];
        if let Some(marked) = kept.marked.get(&what) {
            all.push(series("something changed", Shape::Points, points(marked)));
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
