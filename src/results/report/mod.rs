//! Reports as single HTML files that open offline. Figures are embedded in the page; an embedded script makes
//! them interactive.

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

/// Colours and sizes of all pages. Follows the system's dark mode; print is white.
pub(crate) const STYLE: &str =
    concat!(include_str!("assets/uplot/uPlot.min.css"), include_str!("assets/style.css"));
/// Scripts that make figures interactive (uPlot 1.6.32, MIT).
pub(crate) const SCRIPTS: [&str; 2] =
    [include_str!("assets/uplot/uPlot.iife.min.js"), include_str!("assets/figures.js")];
/// Content security policy: the browser blocks every fetch.
const POLICY: &str =
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'";

/// Renders a whole page.
fn page(title: &str, subtitle: &str, body: Markup) -> String {
    document(title, html! { h1 { (title) } p.sub { (subtitle) } (body) })
}

/// Wraps content that may be wider than a phone: it scrolls separately, also by keyboard.
pub(crate) fn scrolled(label: &str, body: Markup) -> Markup {
    html! { div.scroll tabindex="0" role="region" aria-label=(label) { (body) } }
}

/// Renders a document from a complete body.
fn document(title: &str, body: Markup) -> String {
    styled(title, "", body)
}

/// Renders a document with additional styles.
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
