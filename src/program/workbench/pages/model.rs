//! Model page: the error of the model, the evidence, the missing effects; adding an effect reduces the error.

use super::shell::{self, Part, alert};
use crate::diagnosis::{LAW, Rung, Verdict};
use crate::inference::Residual;
use crate::number::{Quantity, chance, pretty, six_digits, with_error, with_unit};
use crate::report::candidates::{candidate, law};
use crate::report::heat;
use crate::report::ladder::ladder;
use crate::report::plot::wide;
use crate::report::scrolled;
use crate::study::{Judgement, decisive, plot_of};
use crate::workbench::desk::{Data, Desk, Found, Judged};
use crate::workbench::steps::{Entry, Step, folder_of};
use crate::workbench::{Shared, aside};
use axum::extract::{Query, State};
use maud::{Markup, html};
use radcam_sim::effects::{self, find};
use std::sync::Arc;

/// Renders the page, or its main part.
pub async fn page(State(shared): State<Arc<Shared>>, Query(q): Query<Part>) -> Markup {
    if shared.dataset.is_none() && shared.live().is_none() && shared.history.is_some() {
        let asked = super::history::Asked { part: q.part, ..Default::default() };
        return super::history::page(State(shared), Query(asked)).await;
    }
    let body = main(&shared);
    // The form for the user's own effect is outside the re-rendered part, so that typed text stays.
    if q.part.is_some() { body } else { shell::page(&shared, "/", html! { (body) (own()) }) }
}

/// Renders the main part from the current state of the desk.
pub fn main(shared: &Arc<Shared>) -> Markup {
    let desk = shared.desk();
    let body = match &desk.data {
        Data::None => html! {
            h1 { "Nothing is captured yet" }
            p { "Look at the live picture and capture a plan under " a href="/camera" { "Camera" } "; the verdict stands here then." }
        },
        Data::Reading => {
            html! { h1 { "Reading the campaign" } p { "Its statistics are collected once; everything after that is quick." } }
        }
        Data::Failed(why) => html! { h1 { "The campaign cannot be read" } (alert(why)) },
        Data::Ready(campaign) => ready(shared, &desk, campaign),
    };
    drop(desk);
    html! { (shell::main(shared, "/", body)) }
}

fn ready(shared: &Shared, desk: &Desk, campaign: &crate::workbench::desk::Campaign) -> Markup {
    let Some([now, first]) = &desk.judged else { return alert("The model could not be fitted.") };
    let c = &now.comparison;
    let model = folder_of(&campaign.path).join("model.toml");
    let rungs: Vec<Rung> = desk.steps.step.iter().map(rung).collect();
    html! {
        (verdict(desk))
        div.cards {
            div { span { "error (1: agreement to within noise)" }
                b #error class=(if c.consistent { "good" } else { "bad" }) { data value=(c.error) { (format!("{:.3}", c.error)) } } }
            div { span { "p-value" } b { (chance(c.p_value)) } }
            @for (name, q) in base(now) { div { span { (name) } b { (q.to_string()) } } }
        }
        div.columns {
            section aria-labelledby="h-missing" {
                h2 #h-missing { "What is missing" }
                (missing(desk, shared))
            }
            section aria-labelledby="h-model" {
                h2 #h-model { "The model" }
                (entries(desk, now))
                h3 { "Error" }
                (ladder(&rungs, &|_| html! {}))
                p.buttons {
                    button #undo hx-post="/model/undo" hx-target="#main" hx-swap="outerHTML" disabled[rungs.len() < 2] { "Undo" }
                }
                (shell::command(&format!("radcam compare {} --model {}", campaign.path.display(), model.display())))
                p.note { "Fitted and judged in " (format!("{:.0}", now.milliseconds)) " ms over " (c.residuals.len()) " statistics." }
            }
        }
        h2 { "Residuals" }
        p.note {
            "Each row is a statistic of the frames, such as their mean, their temporal variance, or the covariance of a pixel with the next one in its row, "
            "(0,1), or column, (1,0). The error is the root mean square of all residuals; p is the probability of deviations at least as large if the "
            "model is right, and below 0.001 the model is rejected."
        }
        p.note { "Choose a cell (arrow keys move) to see that statistic: measured, expected by the first model, and by the model as it stands." }
        div #cell aria-live="polite" {}
        (heat::picture(c, "The model as it stands", &|set| campaign.kinds.get(&set).copied(), &cell_button))
        @if rungs.len() > 1 {
            details { summary { "Residuals of the first model: error " (format!("{:.2}", first.comparison.error)) }
                (heat::picture(&first.comparison, "The first model", &|set| campaign.kinds.get(&set).copied(), &cell_button)) }
        }
    }
}

fn rung(s: &Step) -> Rung {
    let given = s.what == "the model as given";
    Rung {
        added: (!given).then(|| s.what.strip_prefix("+ ").unwrap_or(&s.what).to_string()),
        error: s.error,
        p_value: s.p_value,
    }
}

fn base(j: &Judged) -> Vec<(&'static str, Quantity)> {
    let (b, e) = (&j.fitted.base, &j.fitted.base_std_err);
    vec![
        ("system gain A", Quantity::new(b.gain_dn_per_e, e[0], "DN/e")),
        ("read noise", Quantity::new(b.read_noise_e, e[1], "e")),
        ("dark current", Quantity::new(b.dark_e_per_s, e[3], "e/s")),
    ]
}

/// Renders the verdict of the last search, at the top of the page.
fn verdict(desk: &Desk) -> Markup {
    match &desk.found {
        Found::Done(d) => {
            let head = Judgement::of_diagnosis(d).heading(Some(&d.verdict));
            html! {
                h1 { (head) }
                @for fault in &d.data_faults { p { (fault.to_string()) } }
                p.verdict { (d.verdict.sentence()) }
            }
        }
        Found::Searching => {
            html! { h1 { "Looking for what is missing" } p.verdict { "Every effect of the catalogue is tried beside the model." } }
        }
        Found::None => html! {
            h1 { "Nothing was searched for yet" }
            p { button hx-post="/model/search" hx-target="#main" hx-swap="outerHTML" { "Look for what is missing" } }
        },
    }
}

fn missing(desk: &Desk, shared: &Shared) -> Markup {
    let Found::Done(d) = &desk.found else { return html! { p.note { "The search has no answer yet." } } };
    html! {
        @if matches!(d.verdict, Verdict::Describes { .. }) { p { "Nothing: the model describes the campaign." } }
        @if !d.missing.is_empty() {
            @for plot in decisive(&Judgement::of_diagnosis(d)) { (wide(&plot)) }
        }
        @if let Some(p) = &d.proposal {
            (law(p))
            p.buttons {
                button.first id="add-law" hx-post="/model/add" hx-vals=(vals(LAW)) hx-target="#main" hx-swap="outerHTML" { "Add the law to the model" }
            }
        }
        @for m in &d.missing {
            (candidate(m))
            @if m.effect != "unknown" {
                p.buttons {
                    button.first id={ "add-" (m.effect) } hx-post="/model/add" hx-vals=(vals(&m.effect)) hx-target="#main" hx-swap="outerHTML" { "Add " (m.effect) " to the model" }
                }
            } @else {
                @for near in &m.nearest {
                    p.buttons { button hx-post="/model/add" hx-vals=(vals(near)) hx-target="#main" hx-swap="outerHTML" { "Try " (near) } }
                }
            }
        }
        @if let Some(next) = &d.next_measurement {
            h3 { "The measurement that decides" }
            p { (next) }
            p.buttons {
                @if d.next_plan.is_some() { a.button href="/save/next.toml" { "Write its plan" } }
                @if d.next_plan.is_some() && shared.live().is_some() {
                    " " button hx-post="/camera/next" hx-target="#status" hx-swap="outerHTML" { "Take it" }
                }
            }
        }
        (shell::command(&format!("radcam diagnose {}", shared.dataset.as_ref().map_or(String::new(), |p| p.display().to_string()))))
        form.inline hx-post="/model/add" hx-target="#main" hx-swap="outerHTML" {
            label for="other" { "Another effect" }
            select #other name="effect" { @for e in effects::all() { option value=(e.id()) { (e.id()) } } }
            button { "Add" }
        }
    }
}

fn vals(effect: &str) -> String {
    serde_json::json!({ "effect": effect }).to_string()
}

/// Renders the effects of the model, each with its switch, values and page.
fn entries(desk: &Desk, now: &Judged) -> Markup {
    let all = desk.entries();
    html! {
        p.note { "The linear sensor of Healey and Kondepudy 1994: shot noise, read noise, dark current, black level" @if all.is_empty() { ", and nothing else." } @else { ", and:" } }
        @for e in &all {
            div.entry {
                button.switch id={ "switch-" (e.name()) } role="switch" aria-checked=(if e.on { "true" } else { "false" }) aria-label={ "in the model: " (e.name()) }
                    hx-post="/model/switch" hx-vals=(vals(e.name())) hx-target="#main" hx-swap="outerHTML" { @if e.on { "on" } @else { "off" } }
                div {
                    b { (e.name()) }
                    @for (name, q) in values(e, now) { br; code { (name) } " = " (q) }
                    @for (what, formula) in &e.effect.formulas { br; (what) " + " code { (formula) } }
                    @if let Some(p) = find(&e.effect.id).map(|e| e.page()) {
                        details { summary { "About it" }
                            p { (p.what) } p { "What to do: " (p.remedy) } p { "Equation: " code { (p.equation) } } p.note { (p.source) }
                        }
                    }
                }
                button.quiet id={ "remove-" (e.name()) } hx-post="/model/remove" hx-vals=(vals(e.name())) hx-target="#main" hx-swap="outerHTML" aria-label={ "remove " (e.name()) } { "Remove" }
            }
        }
    }
}

/// Formats a value without its error: six digits, or four in scientific notation if it is very small or
/// large.
fn small(v: f64) -> String {
    if v == 0.0 || (1e-3..1e6).contains(&v.abs()) { six_digits(v) } else { format!("{v:.3e}") }
}

/// Returns the values with errors from the fit; for an effect that is off, its stored values.
fn values(e: &Entry, now: &Judged) -> Vec<(String, String)> {
    let place = now.fitted.effects.iter().position(|(f, _)| f.id() == e.name());
    match place.filter(|_| e.on) {
        Some(at) => {
            let (effect, values) = &now.fitted.effects[at];
            let errors = &now.fitted.std_err[at];
            let all = effect.parameters().iter().zip(values).zip(errors).enumerate();
            let used = all.filter(|(k, _)| effect.uses(values, *k));
            used.map(|(_, ((p, v), s))| (p.name.to_string(), with_unit(*v, *s, p.unit))).collect()
        }
        None => e.effect.parameters.iter().map(|(n, v)| (n.clone(), small(*v))).collect(),
    }
}

fn cell_button(r: &Residual, number: &str) -> Markup {
    let query = |q: &str| {
        q.bytes()
            .map(|b| if b.is_ascii_alphanumeric() { char::from(b).to_string() } else { format!("%{b:02X}") })
            .collect::<String>()
    };
    let set = r.set.map_or(String::new(), |s| format!("&set={s}"));
    let address = format!("/cell?statistic={}{set}", query(&r.observable));
    html! { button.cell hx-get=(address) hx-target="#cell" hx-swap="innerHTML" aria-label={ (number) " " (heat::words(r)) } { (number) } }
}

/// Cell of the heat map.
#[derive(serde::Deserialize)]
pub struct Cell {
    statistic: String,
    set: Option<u32>,
}

/// Renders one statistic: its curve before and after, and the numbers of one set.
pub async fn cell(State(shared): State<Arc<Shared>>, Query(q): Query<Cell>) -> Markup {
    let drawn = aside(move || {
        let desk = shared.desk();
        let [now, first] = desk.judged.clone()?;
        // Names of the effects in the current model.
        let names = desk.entries().into_iter().filter(|e| e.on);
        let names = names
            .map(|e| Rung { added: Some(e.name().into()), error: f64::NAN, p_value: f64::NAN })
            .collect();
        let both = desk.steps.step.len() > 1;
        drop(desk);
        Some(detail(&q, &now, &first, names, both))
    })
    .await;
    drawn.ok().flatten().unwrap_or_else(|| alert("There is no model yet."))
}

fn detail(q: &Cell, now: &Judged, first: &Judged, rungs: Vec<Rung>, both: bool) -> Markup {
    let comparisons = if both {
        vec![first.comparison.clone(), now.comparison.clone()]
    } else {
        vec![now.comparison.clone()]
    };
    let mut judgement = Judgement::of_comparison(&now.comparison, &now.fitted);
    (judgement.comparisons, judgement.ladder) = (comparisons, rungs);
    let of = |j: &Judged| -> Vec<Residual> {
        let same = |r: &&Residual| r.observable == q.statistic && (q.set.is_none() || r.set == q.set);
        j.comparison.residuals.iter().filter(same).cloned().collect()
    };
    let (before, after) = (of(first), of(now));
    let Some(any) = after.first() else { return alert("There is no such statistic.") };
    html! {
        section.detail aria-label=(q.statistic) {
            h3 { (q.statistic) @if let Some(set) = q.set { ", set " (set) " at " (heat::level(any.level_dn)) " DN" } }
            p.note { "A deviation means: " (any.meaning) "." }
            div.columns {
                div { @if let Some(plot) = plot_of(&judgement, &q.statistic) { (wide(&plot)) } @else { p.note { "It belongs to the whole campaign: no curve over the level." } } }
                (scrolled("numbers of both halves", html! { table {
                    thead { tr { th.text { "frames" } th { "measured" @if !any.unit.is_empty() { " (" (pretty(&any.unit)) ")" } } th { "expected" @if both { " first, now" } } th { "residual (σ)" @if both { " first, now" } } } }
                    @for (k, (b, a)) in before.iter().zip(&after).enumerate() {
                        tr {
                            th scope="row" { (if before.len() == 2 { ["first half", "second half"][k] } else { "value" }) }
                            td.number { (six_digits(a.measured)) }
                            td.number { @if both { (six_digits(b.predicted)) ", " } (with_error(a.predicted, a.std_err)) }
                            td.number { @if both { (format!("{:+.1}, ", b.z)) } (format!("{:+.1}", a.z)) }
                        }
                    }
                } }))
            }
        }
    }
}

/// Renders the trial fit of the user's own effect.
pub fn tried(before: f64, judged: &Judged) -> Markup {
    let c = &judged.comparison;
    let values = judged.fitted.effects.last().zip(judged.fitted.std_err.last());
    html! {
        p role="status" {
            "Error " (format!("{before:.3}")) " without it, " b { (format!("{:.3}", c.error)) } " with it (p " (chance(c.p_value)) "); fitted "
            @if let Some(((effect, values), errors)) = values {
                @for ((p, v), s) in effect.parameters().iter().zip(values).zip(errors) { code { (p.name) } " = " (with_unit(*v, *s, p.unit)) "  " }
            }
        }
    }
}

fn own() -> Markup {
    let neighbours = ["cov_01", "cov_10", "cov_11", "cov_02", "cov_20"];
    let targets = effects::TARGETS.into_iter().chain(neighbours);
    html! { section.own-room aria-label="An effect of your own" {
        h2 { "An effect of your own" }
        p.note {
            "A formula gives the change of a statistic (mean in DN, the others in DN²) in terms of mu (mean above the black level, DN), exposure (s), "
            "illumination and the parameters. cov_01 is the covariance with the next pixel of the row, cov_10 of the column, cov_11 across the corner; "
            "row, column and common are variances that a row, a column or a frame shares; gradient and curvature those of a field that tilts or bends "
            "anew in each frame, down the rows (y) or across the columns (x); parity_01 and parity_10 are what odd columns or rows have more than "
            "even ones. The same formulas stand in model files and in simulated cameras."
        }
        form.own hx-post="/model/try" hx-target="#tried" hx-swap="innerHTML" {
            label { "Name" input name="name" value="extra-variance" required; }
            label { "It changes" select name="target" { @for t in targets { option selected[t == "variance"] { (t) } } } }
            label.long { "by" input name="formula" value="k * mu^2" required spellcheck="false"; }
            label { "Parameters, as they begin" input name="parameters" value="k = 1e-6" spellcheck="false"; }
            p.buttons {
                button { "Try" } " "
                button type="button" hx-post="/model/own" hx-include="closest form" hx-target="#main" hx-swap="outerHTML" { "Add" }
            }
        }
        div #tried aria-live="polite" {}
    } }
}
