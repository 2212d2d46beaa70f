//! Reports as single HTML files: no scripts, no fonts, nothing fetched.

pub mod budget;
pub mod compare;
pub mod emva;
pub mod noise;
mod plot;
pub mod reproduce;
pub mod svg;

use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Colours and measures of every page; the system's dark mode is followed.
const STYLE: &str = "
:root { --ink: #1b1f24; --soft: #5b6570; --line: #d5dae0; --page: #ffffff; --card: #f6f8fa;
  --data: #0b5fa5; --fit: #c2410c; --good: #1a7f37; --bad: #b3261e; --band: #0b5fa51c; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ed; --soft: #9aa5b1; --line: #37404a; --page: #14181d;
  --card: #1c2229; --data: #62b0f0; --fit: #ff9257; --good: #4cc26a; --bad: #ff7b72; --band: #62b0f024; } }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--page); margin: 2rem auto;
  max-width: 60rem; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin: 0 0 .2rem; } h2 { font-size: 1.1rem; margin: 2rem 0 .5rem; }
p.sub { color: var(--soft); margin: 0 0 1.5rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; width: 100%; }
th, td { text-align: right; padding: .25rem .7rem; border-bottom: 1px solid var(--line); }
th { color: var(--soft); font-weight: 600; } th:first-child, td:first-child { text-align: left; }
td.text, th.text { text-align: left; }
tr.out td { color: var(--soft); } .good { color: var(--good); } .bad { color: var(--bad); }
.cards { display: flex; flex-wrap: wrap; gap: .8rem; margin: 1rem 0; }
.cards div { background: var(--card); border-radius: .5rem; padding: .7rem 1rem; flex: 1 1 12rem; }
.cards b { display: block; font-size: 1.05rem; white-space: nowrap; font-variant-numeric: tabular-nums; }
.cards span { color: var(--soft); font-size: .85rem; }
svg { width: 100%; height: auto; } svg text { fill: var(--ink); font: 12px system-ui, sans-serif; }
span.note { color: var(--soft); font-size: .85rem; }
svg .soft { fill: var(--soft); }
";

/// A whole page.
fn page(title: &str, subtitle: &str, body: Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (title) }
                p.sub { (subtitle) }
                (body)
            }
        }
    }
    .into_string()
}
