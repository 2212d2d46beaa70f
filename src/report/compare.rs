//! The page of a comparison: observables down, levels across, colour by the standardised residual; and the ladder.

use super::page;
use crate::diagnosis::{Diagnosis, Missing, signatures};
use crate::inference::{Comparison, Residual};
use crate::number::{chance, percent};
use maud::{Markup, html};

/// A comparison as a page.
pub fn html(title: &str, subtitle: &str, c: &Comparison) -> String {
    page(title, subtitle, body(c))
}

/// A diagnosis as a page: the ladder, what is missing, the picture before and after.
pub fn diagnosis(title: &str, subtitle: &str, d: &Diagnosis) -> String {
    let body = html! {
        p.verdict { (d.verdict.sentence()) }
        h2 { "The ladder" }
        (ladder(d))
        @for m in &d.missing {
            h2 { (m.effect) " " span.note { (heading(m)) } }
            ul {
                @for (name, q) in &m.parameters {
                    li { (name) " = " (q.to_string()) }
                }
                @for text in &m.evidence { li { (text) } }
            }
        }
        @if let Some(next) = &d.next_measurement { h2 { "Next measurement" } p { (next) } }
        @for (c, name) in d.comparisons.iter().zip(["The starting model", "With the effects found"]) {
            h2 { (name) }
            (body(c))
        }
        @for note in &d.notes { p.sub { (note) } }
    };
    page(title, subtitle, body)
}

/// What stands beside a name.
pub fn heading(m: &Missing) -> String {
    let mut parts = Vec::new();
    if m.effect == "unknown" {
        if !m.nearest.is_empty() {
            parts.push(format!("nearest: {}", m.nearest.join(", ")));
        }
    } else {
        parts.push(format!("probability among the candidates: {}", percent(m.confidence)));
    }
    parts.extend(m.form.clone());
    if let Some(other) = &m.tied_with {
        parts.push(format!("tied with {other}"));
    }
    if m.partial {
        parts.push("explains part of it only".into());
    }
    parts.join("; ")
}

fn ladder(d: &Diagnosis) -> Markup {
    let top = d.ladder.iter().map(|r| r.error.max(1.0).ln()).fold(0.1, f64::max);
    let height = 34.0 * d.ladder.len() as f64 + 10.0;
    let body = html! {
        @for (i, r) in d.ladder.iter().enumerate() {
            @let y = 8.0 + 34.0 * i as f64;
            @let width = 6.0 + 470.0 * r.error.max(1.0).ln() / top;
            text x="190" y=(y + 17.0) text-anchor="end" { (r.added.as_deref().unwrap_or("starting model")) }
            rect x="200" y=(y) width=(width) height="24" rx="3"
                fill=(if r.error < 1.15 { "var(--good)" } else { "var(--bad)" }) {}
            text x=(210.0 + width) y=(y + 17.0) { (format!("error {:.2}", r.error)) }
        }
    };
    super::svg::picture(860.0, height, "error at each rung of the ladder", body)
}

fn body(c: &Comparison) -> Markup {
    html! {
        div.cards {
            div { span { "error (1: agreement to within noise)" }
                b class=(if c.consistent { "good" } else { "bad" }) { (format!("{:.3}", c.error)) } }
            div { span { "p-value" } b { (chance(c.p_value)) } }
            div { span { "residuals" } b { (c.residuals.len()) } }
        }
        @let deviations = signatures(&c.residuals);
        @if !deviations.is_empty() { ul { @for s in deviations.iter().take(8) { li { (s.text) } } } }
        (heat(&c.residuals))
    }
}

/// Colour of a residual: blue below the model, red above.
fn colour(z: f64) -> String {
    let strength = (z.abs() / 6.0).min(1.0);
    let (r, g, b) = if z > 0.0 { (200, 50, 40) } else { (20, 90, 180) };
    format!("rgba({r},{g},{b},{:.2})", 0.06 + 0.94 * strength)
}

fn heat(residuals: &[Residual]) -> Markup {
    let mut names: Vec<&str> = Vec::new();
    residuals.iter().filter(|r| r.set.is_some()).for_each(|r| {
        if !names.contains(&r.observable.as_str()) {
            names.push(&r.observable);
        }
    });
    let mut levels: Vec<(u32, f64)> = Vec::new();
    for r in residuals {
        if let Some(set) = r.set
            && r.observable == "mean"
            && !levels.iter().any(|l| l.0 == set)
        {
            levels.push((set, r.level_dn));
        }
    }
    for r in residuals {
        if let Some(set) = r.set
            && !levels.iter().any(|l| l.0 == set)
        {
            levels.push((set, r.level_dn));
        }
    }
    levels.sort_by(|a, b| a.1.total_cmp(&b.1));
    let cell = 560.0 / levels.len().max(1) as f64;
    let height = 18.0 * names.len() as f64 + 70.0;
    let body = html! {
        @for (row, name) in names.iter().enumerate() {
            @let y = 10.0 + 18.0 * row as f64;
            text x="232" y=(y + 13.0) text-anchor="end" { (name) }
            @for (column, (set, level)) in levels.iter().enumerate() {
                @let of: Vec<&Residual> = residuals.iter().filter(|r| r.set == Some(*set) && r.observable == *name).collect();
                @let worst = of.iter().max_by(|a, b| a.z.abs().total_cmp(&b.z.abs()));
                @if let Some(r) = worst {
                    rect x=(240.0 + cell * column as f64) y=(y) width=(cell - 1.0) height="17" fill=(colour(r.z)) {
                        title { (format!("set {set}, {level:.0} DN: {} {:+.1} sigma ({:.4} for {:.4})", name, r.z, r.measured, r.predicted)) }
                    }
                }
            }
        }
        @let base = 18.0 * names.len() as f64 + 26.0;
        @for (column, (_, level)) in levels.iter().enumerate().step_by((levels.len() / 10).max(1)) {
            text x=(240.0 + cell * (column as f64 + 0.5)) y=(base) text-anchor="middle" .soft { (format!("{level:.0}")) }
        }
        text x="520" y=(base + 22.0) text-anchor="middle" { "level (DN above the zero), darks to the left; red: above the model, blue: below" }
    };
    super::svg::picture(860.0, height, "residuals of every observable at every level", body)
}
