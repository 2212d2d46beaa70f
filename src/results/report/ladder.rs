//! Ladder of errors: the error after each addition, on a logarithmic axis with a line at 1.

use crate::diagnosis::Rung;
use crate::number::chance;
use maud::{Markup, html};

/// Returns the tick values of an axis up to `top`.
fn ticks(top: f64) -> Vec<f64> {
    let all = [1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0, 300.0, 1000.0, 1e4, 1e5];
    let within: Vec<f64> = all.into_iter().filter(|t| *t <= top).collect();
    // At most 5 ticks, so that labels do not overlap.
    let skip = within.len().div_ceil(5).max(1);
    within.into_iter().step_by(skip).collect()
}

/// Renders the ladder. `beside` renders the contents beside a rung.
pub fn ladder(rungs: &[Rung], beside: &dyn Fn(usize) -> Markup) -> Markup {
    let worst = rungs.iter().map(|r| r.error).filter(|e| e.is_finite()).fold(1.5, f64::max);
    let (low, high) = (0.85f64, worst * 1.08);
    // In per cent of the axis.
    let x = |error: f64| 100.0 * (error.clamp(low, high) / low).ln() / (high / low).ln();
    let one = x(1.0);
    html! {
        div.ladder role="table" aria-label="error after each addition to the model" {
            @for (i, r) in rungs.iter().enumerate() {
                @let end = x(r.error);
                @let good = r.p_value >= crate::agreement::P_LIMIT;
                div.rung role="row" {
                    span.name role="cell" { (r.added.as_ref().map_or("model as given".into(), |a| if a.starts_with('−') { a.clone() } else { format!("+ {a}") })) (beside(i)) }
                    span.track role="presentation" {
                        i.one style=(format!("left: {one:.2}%")) {}
                        i.bar.good[good].bad[!good] style=(format!("left: {:.2}%; width: {:.2}%", one.min(end), (end - one).abs())) {}
                        i.dot.good[good].bad[!good] style=(format!("left: {end:.2}%")) {}
                    }
                    span.value role="cell" { data value=(r.error) { (format!("{:.2}", r.error)) } span.note { " p " (chance(r.p_value)) } }
                }
            }
            div.rung.axis aria-hidden="true" {
                span.name { "error (1: agreement)" }
                span.track { @for t in ticks(high) { b style=(format!("left: {:.2}%", x(t))) { (t) } } }
                span.value {}
            }
        }
    }
}
