//! Page of `radcam reproduce`: the paper's numbers and its four figures.

use super::svg::{Mark, Panel, picture, range};
use super::{budget, noise, page};
use crate::number::with_error;
use crate::reproduce::{Figures, Reproduction};
use maud::{Markup, html};

/// Colours of the four surfaces.
const COLOURS: [&str; 4] = ["var(--data)", "var(--fit)", "var(--good)", "var(--bad)"];

/// Renders the whole page.
pub fn html(r: &Reproduction) -> String {
    let agree = r.rows.iter().filter(|row| row.agrees == Some(true)).count();
    let body = html! {
        table {
            tr { th { "quantity" } th { "paper" } th { "ours" } th {} }
            @for row in &r.rows {
                tr {
                    td { (row.quantity) @if let Some(note) = &row.note { br; span.note { (note) } } }
                    td { @if row.paper.is_finite() { (row.paper) } }
                    td { (with_error(row.ours, row.std_err)) }
                    @match row.agrees {
                        Some(true) => { td.good { "agrees" } }
                        Some(false) => { td.bad { "differs" } }
                        None => { td { "not confirmable" } }
                    }
                }
            }
        }
        h2 { "Fig. 1: slopes of one pixel, with an outlier" }
        (slopes(&r.figures))
        h2 { "Fig. 2: the sensor noise estimate" }
        (noise::plot(&r.figures.line))
        h2 { "Fig. 3: four surfaces at seven light levels" }
        (surfaces(&r.figures))
        h2 { "Fig. 4: parts of the variance" }
        (budget::plot(&r.figures.budget))
    };
    let subtitle = format!(
        "Healey and Kondepudy 1994, Section VII, on {} simulated XC-77 cameras: {agree} of {} rows agree, {open} cannot be confirmed. The error is that of \
         one experiment of the paper's size. Figures: the first camera.",
        r.seeds,
        r.rows.len(),
        open = r.rows.iter().filter(|row| row.agrees.is_none()).count()
    );
    page("The paper, run again", &subtitle, body)
}

fn slopes(figures: &Figures) -> Markup {
    let s = &figures.slopes;
    let (y, x) = s.at;
    let panel = Panel {
        frame: [72.0, 14.0, 770.0, 330.0],
        x: range(s.points.iter().map(|p| p.0)),
        y: range(s.points.iter().map(|p| p.1)),
    };
    let marks: Vec<Mark> = s
        .points
        .iter()
        .map(|&(x, y, kept)| Mark { x, y, error: 0.0, out: !kept, title: format!("{x:.2}, {y:.2} DN") })
        .collect();
    let (from, to) = panel.x;
    picture(
        860.0,
        395.0,
        "a pixel's value against its window's mean, one point for each configuration",
        html! {
            (panel.axes("mean over the 9 × 9 window (DN)", &format!("pixel ({x}, {y}) (DN)"), true))
            (panel.line((from, s.k * from), (to, s.k * to), "var(--fit)"))
            (panel.marks(&marks))
            text x="830" y="325" text-anchor="end" { "slope K = " (format!("{:.5}", s.k)) "; hollow: left out" }
        },
    )
}

fn surfaces(figures: &Figures) -> Markup {
    let (right, top) = figures.reach();
    let panel = Panel { frame: [72.0, 14.0, 770.0, 330.0], x: (0.0, 1.04 * right), y: (0.0, 1.06 * top) };
    picture(
        860.0,
        395.0,
        "scene variance against the mean for four surfaces, with parabolas",
        html! {
            (panel.axes("mean μ_D (DN)", "σ_D² − σ_CN² (DN²)", true))
            @for (k, (surface, colour)) in figures.surfaces.iter().zip(COLOURS).enumerate() {
                @let y = 34.0 + 22.0 * k as f64;
                line x1="96" x2="120" y1=(y) y2=(y) stroke=(colour) stroke-width="3" {}
                text x="128" y=(y + 4.0) { (surface.name) ", V" tspan dy="3" font-size="9" { "s" } tspan dy="-3" { (format!(" = {:.2e}", surface.scene_variation)) } }
                @let last = surface.points.last().map_or(0.0, |p| p.0);
                @let curve: Vec<_> = (0..=60)
                    .map(|i| f64::from(i) / 60.0 * last)
                    .map(|x| (x, surface.scene_variation * x * x))
                    .collect();
                (panel.curve(&curve, colour))
                @let marks: Vec<_> = surface.points.iter().map(|&(x, y, error)| Mark {
                    x, y, error, out: false, title: format!("{}: {x:.1} DN, {y:.2} DN²", surface.name),
                }).collect();
                (panel.coloured(&marks, colour))
            }
        },
    )
}
