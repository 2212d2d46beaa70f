//! Missing effects: each with its description, size, evidence and remedy.

use crate::diagnosis::{Missing, Proposal, capital};
use crate::number::percent;
use maud::{Markup, html};
use radcam_sim::effects::find;

/// Returns the note beside an effect's name.
pub fn heading(m: &Missing) -> String {
    let mut parts = Vec::new();
    if m.effect == "unknown" {
        parts.push(match m.nearest.as_slice() {
            [] => "no name is near".into(),
            names => format!("nearest: {}", names.join(", ")),
        });
    } else {
        parts.push(format!("{} of the misfit", percent(m.share)));
        parts.push(format!("probability among the candidates: {}", percent(m.confidence)));
    }
    parts.extend(m.form.clone());
    if let Some(other) = &m.tied_with {
        parts.push(format!("tied with {other}"));
    }
    if m.partial {
        parts.push("the camera behaves like it and is not quite that".into());
    }
    parts.join("; ")
}

/// Renders one candidate.
pub fn candidate(m: &Missing) -> Markup {
    let page = find(&m.effect).map(|e| e.page());
    let meaning = |name: &str| {
        let effect = find(&m.effect)?;
        effect.parameters().iter().find(|p| p.name == name).map(|p| p.meaning)
    };
    html! {
        section.effect {
            h3 { (m.effect) " " span.note { (heading(m)) } }
            @if let Some(p) = &page { p { (p.what) } }
            @if !m.parameters.is_empty() {
                table.stack {
                    thead { tr { th { "parameter" } th.text { "value ± standard error" } th.text { "meaning" } } }
                    @for (name, q) in &m.parameters {
                        tr {
                            th scope="row" { code { (name) } }
                            td.text.number { data value=(q.value) { (q.to_string()) } }
                            td.text.small { (meaning(name).unwrap_or("a combination that the campaign tells better than its parts")) }
                        }
                    }
                }
            }
            dl {
                @if !m.evidence.is_empty() {
                    dt { "Evidence" }
                    dd { ul { @for text in &m.evidence { li { (text) } } } }
                }
                @if let Some(p) = &page {
                    dt { "What to do" } dd { (p.remedy) }
                    dt { "What looks like it" } dd { (p.look_alikes) }
                    dt { "Equation" } dd { code { (p.equation) } }
                    dt { "Source" } dd { (p.source) }
                }
            }
        }
    }
}

/// Renders a law for an unnamed effect: in words, as formulas, with its implications.
pub fn law(p: &Proposal) -> Markup {
    html! {
        section.effect {
            h3 { "A law" " " span.note { (heading_of_law(p)) } }
            p { (capital(&p.sentence())) "." }
            table.stack {
                thead { tr { th { "changes" } th.text { "by" } } }
                @for (target, formula) in &p.formulas {
                    tr { th scope="row" { code { (target) } } td.text { code { (formula) } } }
                }
            }
            table.stack {
                thead { tr { th { "parameter" } th.text { "value ± standard error" } } }
                @for (name, q) in &p.parameters {
                    tr { th scope="row" { code { (name) } } td.text.number { data value=(q.value) { (q.to_string()) } } }
                }
            }
            @if !p.causes.is_empty() {
                dl { dt { "Points to" } dd { ul { @for cause in &p.causes { li { (cause) } } } } }
            }
        }
    }
}

fn heading_of_law(p: &Proposal) -> String {
    if p.beside.is_empty() {
        "beside the model as given".into()
    } else {
        format!("beside {}", p.beside.join(", "))
    }
}
