//! Reports as single HTML files that open offline: figures are drawn in the page, and a script that is in the page makes them interactive.

pub mod budget;
pub(crate) mod candidates;
pub mod emva;
pub(crate) mod heat;
mod images;
pub(crate) mod ladder;
pub mod noise;
pub(crate) mod plot;
pub mod reproduce;
pub mod study;
pub mod svg;

pub use candidates::heading;

use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Colours and measures of every page; the system's dark mode is followed, and paper is white.
pub(crate) const STYLE: &str =
    concat!(include_str!("assets/uplot/uPlot.min.css"), include_str!("assets/style.css"));
/// What makes figures answer to the pointer (uPlot 1.6.32, MIT).
pub(crate) const SCRIPTS: [&str; 2] =
    [include_str!("assets/uplot/uPlot.iife.min.js"), include_str!("assets/figures.js")];
/// Nothing is fetched: a page that tried would be stopped by the browser.
const POLICY: &str =
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'";

/// A whole page.
fn page(title: &str, subtitle: &str, body: Markup) -> String {
    document(title, html! { h1 { (title) } p.sub { (subtitle) } (body) })
}

/// What may be wider than a phone: it scrolls by itself, by the keyboard too.
pub(crate) fn scrolled(label: &str, body: Markup) -> Markup {
    html! { div.scroll tabindex="0" role="region" aria-label=(label) { (body) } }
}

/// A document whose body says everything.
fn document(title: &str, body: Markup) -> String {
    styled(title, "", body)
}

/// A document with a style of its own beside that of all.
fn styled(title: &str, style: &str, body: Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                title { (title) }
                style { (PreEscaped(STYLE)) (PreEscaped(style)) }
            }
            body {
                main { (body) }
                @for script in SCRIPTS { script { (PreEscaped(script)) } }
            }
        }
    }
    .into_string()
}
