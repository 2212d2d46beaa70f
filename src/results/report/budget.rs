//! Variance budget as a plot and a page (Fig. 4 of the paper).

use super::page;
use super::svg::{Panel, picture};
use crate::budget::{Level, NAMES};
use crate::number::with_error;
use crate::scene_variation::Variation;
use maud::{Markup, html};

/// Colours of the parts, in the order of [`NAMES`].
const COLOURS: [&str; 5] = ["var(--data)", "var(--fit)", "var(--good)", "var(--soft)", "var(--bad)"];

/// Plots the shares of the variance against intensity.
pub fn plot(levels: &[Level]) -> Markup {
    let right = levels.last().map_or(1.0, |l| l.mean_dn);
    let panel = Panel { frame: [72.0, 14.0, 620.0, 330.0], x: (0.0, right), y: (0.0, 1.0) };
    picture(
        860.0,
        395.0,
        "share of each part in the total variance against the mean",
        html! {
            (panel.axes("mean above the dark reference (DN)", "share of the variance", true))
            @for (part, (name, colour)) in NAMES.iter().zip(COLOURS).enumerate() {
                @let curve: Vec<_> = levels.iter().map(|l| (l.mean_dn, l.shares()[part])).collect();
                (panel.curve(&curve, colour))
                @let y = 34.0 + 24.0 * part as f64;
                line x1="716" x2="742" y1=(y) y2=(y) stroke=(colour) stroke-width="3" {}
                text x="750" y=(y + 4.0) { (name) }
            }
        },
    )
}

/// Renders the page of one region.
pub fn html(subtitle: &str, seen: &Variation, levels: &[Level]) -> String {
    let v = &seen.scene_variation;
    let body = html! {
        div.cards {
            div { span { "scene variation V" sub { "s" } } b { (with_error(v.value, v.std_err)) } }
            div { span { "mean above the dark reference" } b { (format!("{:.2} DN", seen.mean_dn)) } }
            div { span { "spatial variance, corrected" } b { (format!("{:.3} DN²", seen.spatial_var_dn2)) } }
            div { span { "of it the camera's noise" } b { (format!("{:.3} DN²", seen.noise_var_dn2)) } }
        }
        h2 { "Parts of the variance of a raw image" }
        (plot(levels))
        table {
            tr { th { "mean (DN)" } th { "total (DN²)" } @for name in NAMES { th { (name) } } }
            @for l in levels.iter().step_by((levels.len() / 12).max(1)) {
                tr {
                    td { (format!("{:.1}", l.mean_dn)) }
                    td { (format!("{:.3}", l.total_dn2)) }
                    @for share in l.shares() { td { (format!("{:.1} %", 100.0 * share)) } }
                }
            }
        }
    };
    page("Variance budget", subtitle, body)
}
