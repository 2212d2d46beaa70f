//! EMVA 1288 datasheet: general data, the summary page with its table and two plots, all plots, all
//! quantities. Prints on A4.

use super::plot::{figure, in_html};
use crate::dataset::CameraInfo;
use crate::emva::names::{GROUPS, Name};
use crate::emva::{Evaluation, Limit, Points};
use crate::number::Quantity;
use crate::plot::Plot;
use maud::{Markup, html};

/// Head of the datasheet.
#[derive(Debug)]
pub struct Head<'a> {
    /// Camera.
    pub camera: &'a CameraInfo,
    /// Dataset or descriptor.
    pub source: String,
    /// Command that made the datasheet.
    pub command: String,
}

const STYLE: &str = "
:root { --c0: #0072b2; --c1: #d55e00; --c2: #009e73; --c3: #b58900; --c4: #6b6b6b; }
@media (prefers-color-scheme: dark) { :root { --c0: #56b4e9; --c1: #ff8f4d; --c2: #3fcf9f; --c3: #e6c04d; --c4: #b5b5b5; } }
body { max-width: 66rem; font-size: 14px; }
.summary { display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 1.3fr); gap: 1.2rem; align-items: start; }
.plots { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 1rem 1.6rem; }
figure { margin: 0; break-inside: avoid; } h3 { font-size: .95rem; margin: 0 0 .2rem; }
.legend { margin: 0; font-size: .8rem; color: var(--soft); display: flex; flex-wrap: wrap; gap: .1rem .9rem; }
.legend span { white-space: nowrap; } svg.key { width: 18px; height: 8px; margin-right: .3rem; }
td { white-space: nowrap; } td.text { white-space: normal; } td.small { color: var(--soft); font-size: .85em; } sub { font-size: .75em; } tr { break-inside: avoid; } td { vertical-align: top; }
th.group { text-align: left; padding-top: .8rem; color: var(--ink); }
.facts { display: grid; grid-template-columns: repeat(auto-fit, minmax(15rem, 1fr)); gap: .1rem 1.6rem; margin: 0; }
.facts div { display: flex; justify-content: space-between; gap: 1rem; border-bottom: 1px solid var(--line); padding: .2rem 0; }
.facts dt { color: var(--soft); } .facts dd { margin: 0; text-align: right; overflow-wrap: anywhere; }
.notes li { margin: .3rem 0; } code { overflow-wrap: anywhere; font-size: .85em; }
@media screen and (max-width: 46rem) { .summary, .plots { grid-template-columns: 1fr; } table { display: block; overflow-x: auto; } }
@page { size: A4; margin: 13mm 12mm; }
@media print { :root { --ink: #000; --soft: #444; --line: #ccc; --page: #fff; --card: #fff; --c0: #0072b2; --c1: #d55e00; --c2: #009e73;
  --c3: #b58900; --c4: #6b6b6b; } body { font-size: 9pt; margin: 0; max-width: none; padding: 0; } h2 { margin: 1rem 0 .4rem; }
  .summary { grid-template-columns: minmax(0, .8fr) minmax(0, 1.2fr); gap: 4mm; }
  .plots { grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 2mm 6mm; } td, th { padding: .06rem .25rem; } td.small { font-size: 7.5pt; } .facts div { padding: .05rem 0; } .legend { font-size: 7.5pt; } }
";

fn shown(e: &Evaluation, name: &str, quantity: &Quantity) -> String {
    match e.limits.get(name) {
        Some(Limit::AtMost) => format!("≤ {quantity}"),
        Some(Limit::AtLeast) => format!("≥ {quantity}"),
        None => quantity.to_string(),
    }
}

/// Quantities of the summary page (release 4.0 Linear, table 2).
const SUMMARY: [&str; 25] = [
    "QE",
    "K",
    "inverse_K",
    "sigma_y_dark",
    "sigma_d",
    "SNR_max",
    "SNR_max_dB",
    "inverse_SNR_max",
    "u_p_min",
    "u_e_min",
    "u_p_sat",
    "u_e_sat",
    "DR",
    "DR_dB",
    "DSNU1288",
    "DSNU1288_row",
    "DSNU1288_col",
    "DSNU1288_pixel",
    "PRNU1288",
    "PRNU1288_row",
    "PRNU1288_col",
    "PRNU1288_pixel",
    "LE",
    "u_I_mean",
    "u_I_var",
];

fn named(name: &str) -> Option<&'static Name> {
    GROUPS.iter().flat_map(|(_, group)| group.iter()).find(|n| n.0 == name)
}

fn value(e: &Evaluation, name: &str) -> Markup {
    match e.quantities.get(name) {
        Some(Some(q)) => html! { (shown(e, name, q)) },
        _ => html! { span.note { "undefined" } },
    }
}

fn facts(head: &Head<'_>, points: &Points, e: &Evaluation) -> Markup {
    let c = head.camera;
    let number = |x: Option<f64>, unit: &str| x.map(|x| format!("{x} {unit}"));
    let l = &points.light;
    let all: Vec<(&str, Option<String>)> = vec![
        ("Vendor", Some(c.vendor.clone())),
        ("Model", Some(c.model.clone())),
        ("Serial number", Some(c.serial.clone())),
        ("Firmware", c.firmware.clone()),
        ("Resolution", Some(format!("{} × {} px", c.width, c.height))),
        ("Pixel format", Some(format!("{} ({} bit)", c.pixel_format, c.bit_depth))),
        ("Gain", number(c.gain_db, "dB")),
        ("Black level", number(c.black_level_dn, "DN")),
        ("Temperature", number(c.temperature_c, "°C")),
        ("Wavelength", number(l.wavelength_nm, "nm")),
        ("Pixel area", number(l.pixel_area_um2, "µm²")),
        ("Irradiance known to", number(l.irradiance_rel_std.map(|s| 100.0 * s), "%")),
        ("Exposures", Some(format!("{}, {} of darks", points.temporal.len(), points.darks.len()))),
        (
            "Spatial part",
            points.spatial.as_deref().map(|[b, d]| format!("{} flats, {} darks", b.frames, d.frames)),
        ),
        ("Definitions", Some(format!("EMVA 1288, {}", e.definitions))),
        ("Evaluated by", Some(format!("radcam {}", env!("CARGO_PKG_VERSION")))),
    ];
    html! {
        dl.facts {
            @for (name, value) in &all {
                @if let Some(value) = value.as_ref().filter(|v| !v.is_empty()) { div { dt { (name) } dd { (value) } } }
            }
        }
    }
}

fn whole_table(e: &Evaluation) -> Markup {
    let tools = !e.reference_tool.is_empty();
    html! {
        table {
            tr { th {} th.text { "" } th { "value ± standard error" } @if tools { th { "reference tool" } } }
            @for (heading, group) in GROUPS {
                @if group.iter().any(|n| e.quantities.contains_key(n.0)) {
                    tr { th.group colspan=(if tools { 4 } else { 3 }) { (heading) } }
                    @for (name, symbol, meaning) in group.iter().filter(|n| e.quantities.contains_key(n.0)) {
                        tr {
                            td.symbol title=(name) { (in_html(symbol)) }
                            td.text { (meaning) }
                            td { (value(e, name)) }
                            @if tools {
                                td { @match e.reference_tool.get(*name) {
                                    Some(Some(v)) => (format!("{v:.5}")),
                                    Some(None) => "none",
                                    None => "",
                                } }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Renders the datasheet.
pub fn html(head: &Head<'_>, points: &Points, e: &Evaluation, plots: &[Plot]) -> String {
    let camera = format!("{} {}", head.camera.vendor, head.camera.model);
    let title = if camera.trim().is_empty() {
        "EMVA 1288 datasheet".into()
    } else {
        format!("EMVA 1288 datasheet: {}", camera.trim())
    };
    let first: Vec<&Plot> = plots.iter().filter(|p| ["photon-transfer", "snr"].contains(&&*p.id)).collect();
    let body = html! {
                h1 { (title) }
                p.sub { (head.source) }
                (facts(head, points, e))
                h2 { "Summary" }
                div.summary {
                    div { @for p in &first { (figure(p)) } }
                    table {
                        @for name in SUMMARY.iter().filter(|n| e.quantities.contains_key(**n)) {
                            @if let Some((_, symbol, meaning)) = named(name) {
                                tr { td.symbol { (in_html(symbol)) } td.text.small { (meaning) } td { (value(e, name)) } }
                            }
                        }
                    }
                }
                @if let Some(n) = &e.noise {
                    p {
                        "By " code { "radcam noise" } ", from all frames: gain " (n.gain.to_string()) ", read noise " (n.read_noise.to_string())
                        "; χ² = " (format!("{:.1}", n.chi2)) " for " (n.dof) " degrees of freedom, Q = " (format!("{:.3}", n.q)) ": "
                        (n.line.of_a_line()) "."
                    }
                }
                @if !(e.notes.is_empty() && e.data_faults.is_empty()) {
                    h2 { "Notes" }
                    ul.notes {
                        @for fault in &e.data_faults { li { (fault.to_string()) } }
                        @for note in &e.notes { li { (note) } }
                    }
                }
                h2 { "Plots" }
                div.plots { @for p in plots { (figure(p)) } }
                h2.page { "All quantities" }
                (whole_table(e))
                @if let Some(general) = &e.general {
                    h2 { "General model" }
                    p.sub { "Release 4.0 General: the camera need not be linear; everything is in photons." }
                    table {
                        @for (name, quantity) in &general.quantities {
                            tr { td { (name) } td { @match quantity { Some(q) => (q.to_string()), None => span.note { "undefined" } } } }
                        }
                    }
                }
                h2 { "Provenance" }
                p { code { (head.command) } }
                p.sub {
                    "Standard errors are those of the measurement; bands and bars show one of them. The numbers of each plot are in plots/*.csv, all "
                    "quantities in quantities.csv and emva.json."
                }
    };
    super::styled(&title, STYLE, body)
}
