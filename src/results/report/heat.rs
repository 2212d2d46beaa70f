//! Heat map of all residuals. Rows are statistics, columns are sets by kind and level; colour and number show
//! the standardised residual.

use crate::dataset::Kind;
use crate::inference::{Comparison, Residual};
use crate::number::pretty;
use maud::{Markup, html};
use std::collections::BTreeMap;

/// Minimum residual whose number is printed, standard errors.
const WRITTEN: f64 = 3.0;
/// Residual at full colour, standard errors.
const FULL: f64 = 6.0;

/// Returns the background of a residual: blue below the model, orange above. Colour-blind readers can tell
/// the two apart, and the number carries the sign.
fn colour(z: f64) -> String {
    let strength = 0.6 * (z.abs() / FULL).min(1.0);
    format!("background: rgba(var(--{}), {strength:.2})", if z > 0.0 { "high" } else { "low" })
}

fn number(z: f64) -> String {
    if z.abs() < WRITTEN {
        String::new()
    } else if z.abs() < 99.5 {
        format!("{z:+.0}").replace('-', "−")
    } else {
        (if z > 0.0 { "≫" } else { "≪" }).into()
    }
}

/// Describes a residual in words.
pub fn words(r: &Residual) -> String {
    let place = r.set.map_or("whole campaign".into(), |set| format!("set {set} at {} DN", level(r.level_dn)));
    let unit = pretty(&r.unit);
    let sign = if r.z < 0.0 { "−" } else { "+" };
    format!(
        "{}, {place}: measured {:.5} {unit}, expected {:.5} ± {:.2e} {unit}, {sign}{:.1} standard errors",
        r.observable,
        r.measured,
        r.predicted,
        r.std_err,
        r.z.abs()
    )
}

/// One column: a set.
struct Column {
    set: u32,
    level_dn: f64,
    kind: Option<Kind>,
}

/// Returns the sets in display order: darks, flats, scenes, each by level, then by number.
fn columns(residuals: &[Residual], kind: &dyn Fn(u32) -> Option<Kind>) -> Vec<Column> {
    let mut levels: BTreeMap<u32, f64> = BTreeMap::new();
    for r in residuals {
        if let Some(set) = r.set
            && (r.observable == "mean" || !levels.contains_key(&set))
        {
            levels.insert(set, r.level_dn);
        }
    }
    let mut out: Vec<Column> =
        levels.into_iter().map(|(set, level_dn)| Column { set, level_dn, kind: kind(set) }).collect();
    let order = |c: &Column| c.kind.map_or(4, |k| k as u8);
    out.sort_by(|a, b| {
        order(a)
            .cmp(&order(b))
            .then(a.level_dn.round().total_cmp(&b.level_dn.round()))
            .then(a.set.cmp(&b.set))
    });
    out
}

/// Returns the worst residual of a statistic in a set.
fn worst<'r>(residuals: &'r [Residual], name: &str, set: u32) -> Option<&'r Residual> {
    let of = residuals.iter().filter(|r| r.set == Some(set) && r.observable == name);
    of.max_by(|a, b| a.z.abs().total_cmp(&b.z.abs()))
}

/// Renders a cell of a static page: the number, with a text for screen readers.
pub fn plain(r: &Residual, number: &str) -> Markup {
    html! { (number) @if !number.is_empty() { span.hidden { " " (words(r)) } } }
}

/// Cell renderer, for callers that need more than a plain cell.
pub type Cell<'a> = dyn Fn(&Residual, &str) -> Markup + 'a;

/// Renders the heat map under a title. `kind` returns the kind of a set. `cell` renders the contents of a
/// cell from its residual and its number.
pub fn picture(c: &Comparison, title: &str, kind: &dyn Fn(u32) -> Option<Kind>, cell: &Cell<'_>) -> Markup {
    let residuals = &c.residuals;
    let columns = columns(residuals, kind);
    let names: Vec<&str> = crate::study::statistics(c)
        .into_iter()
        .filter(|n| residuals.iter().any(|r| r.observable == *n && r.set.is_some()))
        .collect();
    let mut groups: Vec<(String, usize)> = Vec::new();
    for c in &columns {
        let name = c.kind.map_or_else(String::new, |k| format!("{k}s"));
        match groups.last_mut() {
            Some((last, n)) if *last == name => *n += 1,
            _ => groups.push((name, 1)),
        }
    }
    html! {
        (scale())
        div.scroll tabindex="0" role="region" aria-label={ (title) ": residuals of every statistic in every set" } {
            table.heat {
                thead {
                    @if groups.iter().any(|g| !g.0.is_empty()) {
                        tr { td.corner {} @for (name, n) in &groups { th.group colspan=(n) { (name) } } }
                    }
                    tr.turned {
                        th.corner scope="row" { "level (DN)" }
                        @for c in &columns { th scope="col" { span { (level(c.level_dn)) } } }
                    }
                    tr { th scope="row" { "set" } @for c in &columns { th { (c.set) } } }
                }
                tbody {
                    @for name in names {
                        tr {
                            th scope="row" { (name) }
                            @for column in &columns {
                                @match worst(residuals, name, column.set) {
                                    Some(r) => { td style=(colour(r.z)) title=(words(r)) { (cell(r, &number(r.z))) } }
                                    None => { td.none {} }
                                }
                            }
                        }
                    }
                }
            }
        }
        (of_campaign(residuals, title, cell))
    }
}

/// Formats a level; values that round to 0 have no sign.
pub fn level(dn: f64) -> String {
    if dn.abs() < 0.5 { "0".into() } else { format!("{dn:.0}") }
}

fn scale() -> Markup {
    html! {
        p.scale {
            span { "(measured − expected) / standard error: " }
            @for z in [-6, -4, -2, 0, 2, 4, 6] {
                i style=(colour(f64::from(z))) { (if z == -6 { "≤ −6".into() } else if z == 6 { "≥ +6".into() } else { format!("{z:+}").replace('-', "−") }) }
            }
            span { " The worse half of the frames is shown; hatched: not measured there." }
        }
    }
}

/// Renders statistics of the whole campaign (codes, taps, scenes, spectrum, settings), one cell per value and
/// half.
fn of_campaign(residuals: &[Residual], title: &str, cell: &Cell<'_>) -> Markup {
    let all: Vec<&Residual> = residuals.iter().filter(|r| r.set.is_none()).collect();
    let mut names: Vec<&str> = Vec::new();
    for r in &all {
        if !names.contains(&&*r.observable) {
            names.push(&r.observable);
        }
    }
    if names.is_empty() {
        return html! {};
    }
    html! {
        div.scroll tabindex="0" role="region" aria-label={ (title) ": residuals of the whole campaign" } {
            table.heat.rows {
                thead { tr { th scope="row" { "whole campaign" } th.text { "each value, of the first half of the frames, then of the second" } } }
                tbody {
                    @for name in names {
                        tr {
                            th scope="row" { (name) }
                            td.values {
                                @for r in all.iter().filter(|r| r.observable == name) {
                                    span style=(colour(r.z)) title=(words(r)) { (cell(r, &number(r.z))) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}
