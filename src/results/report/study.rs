//! Page of a campaign: verdict, deciding evidence, ladder, missing effects, residuals, curves and images of
//! the camera, all quantities, provenance.

use super::candidates::{candidate, law};
use super::document;
use super::ladder::ladder;
use super::plot::figure;
use super::{heat, images};
use crate::dataset::Kind;
use crate::diagnosis::signatures;
use crate::inference::Comparison;
use crate::number::{chance, with_error};
use crate::observables::Observations;
use crate::study::Study;
use maud::{Markup, PreEscaped, html};
use std::collections::BTreeMap;

/// Maximum number of listed defects.
const LISTED: usize = 40;

/// Maps set numbers to the kinds of the sets of a campaign.
pub fn kinds(all: &Observations) -> BTreeMap<u32, Kind> {
    all.set_numbers.iter().copied().zip(all.kinds.iter().copied()).collect()
}

/// Renders the page.
pub fn html(s: &Study, kinds: &BTreeMap<u32, Kind>) -> String {
    let j = &s.judgement;
    let json = serde_json::to_string(&s.numbers()).unwrap_or_default();
    // Escape `<`: a name must not close the script element or open a comment in it.
    let json = json.replace('<', "\\u003c");
    let body = html! {
        p.sub { (title(s)) }
        h1 { (s.heading) }
        p.verdict { (j.sentence) }
        @for slip in &j.slips { p.bad { (slip.to_string()) } }
        (cards(s))
        p.hint.note { "Figures: point at a curve for its values, drag to zoom, double-click to zoom out; CSV has the numbers." }
        nav.rooms aria-label="Sections" {
            @for (id, name) in sections(s) { a href={ "#" (id) } { (name) } }
        }
        @if !s.decisive.is_empty() {
            h2 #decided { @if j.comparisons.len() > 1 { "What decided" } @else { "What deviates most" } }
            div.plots { @for plot in &s.decisive { (figure(plot)) } }
            (deviations(&j.comparisons[0]))
        }
        h2 #ladder { "Error" }
        (ladder(&j.ladder, &|_| html! {}))
        p.note {
            "The error is the root mean square of (measured − expected) / standard error over all statistics, on frames that the fit did not see. "
            "p is the probability of deviations at least as large if the model is right; below 0.001 the model is rejected. "
            "The model as given is the linear sensor of Healey and Kondepudy 1994 with the effects that --model names."
        }
        @if !j.missing.is_empty() {
            h2 #missing { "What the model lacks" }
            @if let Some(p) = &j.proposal { (law(p)) }
            @for m in &j.missing { (candidate(m)) }
        }
        @if let Some(next) = &j.next_measurement { h2 #next { "Next measurement" } p { (next) } }
        h2 #residuals { "Residuals" }
        @for (c, name) in j.comparisons.iter().zip(["The model as given", "The model with what was found"]).take(if j.missing.is_empty() { 1 } else { 2 }) {
            h3.picture { (name) ": error " (format!("{:.2}", c.error)) ", p " (chance(c.p_value)) }
            (heat::picture(c, name, &|set| kinds.get(&set).copied(), &heat::plain))
        }
        @if !s.plots.is_empty() {
            h2 #camera { "The camera" }
            div.plots { @for p in &s.plots { (figure(p)) } }
        }
        @if !s.neighbours.is_empty() {
            h2 #neighbours { "Noise of neighbouring pixels" }
            (neighbours(s))
        }
        @if s.images.dark.is_some() || s.images.response.is_some() {
            h2 #images { "Images" }
            div.maps { @for m in [&s.images.dark, &s.images.response].into_iter().flatten() { (images::map(m)) } }
        }
        @if !s.images.defects.is_empty() {
            h3.picture { (s.images.defects.len()) " defective pixels" }
            p {
                @for (x, y, what) in s.images.defects.iter().take(LISTED) { span.defect { "x " (x) ", y " (y) ": " (what) "; " } }
                @if s.images.defects.len() > LISTED { "and " (s.images.defects.len() - LISTED) " more, on the page of defects of the calibration" }
            }
        }
        @if !s.statistics.is_empty() {
            h2 #statistics { "Every statistic" }
            p.note { "Each measured less what the model as given expects, with its standard error; the line is the model with what was found." }
            div.plots.small { @for p in &s.statistics { (figure(p)) } }
        }
        h2 #quantities { "Quantities" }
        (quantities(s))
        h2 #settings { "Camera and settings" }
        (facts(s))
        h2 #provenance { "Provenance" }
        (provenance(s))
        script type="application/json" id="radcam-report" { (PreEscaped(json)) }
    };
    document(&format!("{}: {}", s.heading, title(s)), body)
}

fn title(s: &Study) -> String {
    let camera = s.camera.as_ref().map(|c| format!("{} {} {}", c.vendor, c.model, c.serial));
    let camera = camera.map(|c| c.split_whitespace().collect::<Vec<_>>().join(" ")).filter(|c| !c.is_empty());
    let names = s.provenance.datasets.join(", ");
    camera.map_or_else(|| names.clone(), |c| format!("{c}, {names}"))
}

fn sections(s: &Study) -> Vec<(&'static str, &'static str)> {
    let j = &s.judgement;
    let all = [
        (!s.decisive.is_empty(), "decided", "Evidence"),
        (true, "ladder", "Error"),
        (!j.missing.is_empty(), "missing", "What the model lacks"),
        (j.next_measurement.is_some(), "next", "Next measurement"),
        (true, "residuals", "Residuals"),
        (!s.plots.is_empty(), "camera", "Camera"),
        (!s.neighbours.is_empty(), "neighbours", "Neighbours"),
        (s.images.dark.is_some() || s.images.response.is_some(), "images", "Images"),
        (!s.statistics.is_empty(), "statistics", "Every statistic"),
        (true, "quantities", "Quantities"),
        (true, "settings", "Settings"),
        (true, "provenance", "Provenance"),
    ];
    all.into_iter().filter(|a| a.0).map(|(_, id, name)| (id, name)).collect()
}

/// Renders cards with the most wanted numbers.
fn cards(s: &Study) -> Markup {
    html! {
        div.cards {
            @for id in ["error", "error_after", "gain_dn_per_e", "read_noise_e", "dark_current_e_per_s", "snr_max"] {
                @if let Some(q) = s.quantities.get(id) {
                    div { span { (q.name) } b { data value=(q.quantity.value) { (q.quantity.to_string()) } } }
                }
            }
        }
    }
}

/// Lists the deviations from the model as given, worst first.
fn deviations(c: &Comparison) -> Markup {
    let all = signatures(&c.residuals);
    html! {
        @if !all.is_empty() {
            p.note { "Deviations from the model as given, worst first:" }
            ul { @for d in all.iter().take(6) { li { (d.text) } } }
        }
    }
}

/// Renders correlations with the neighbours on one side; the other side is equal by symmetry.
fn neighbours(s: &Study) -> Markup {
    let at = |dy: i32, dx: i32| {
        let same = |l: (i32, i32)| l == (dy, dx) || l == (-dy, -dx);
        s.neighbours.iter().find(|(lag, ..)| same(*lag))
    };
    let shade = |value: f64, error: f64| {
        let strength = 0.6 * ((value / error).abs() / 6.0).min(1.0);
        format!("background: rgba(var(--{}), {strength:.2})", if value > 0.0 { "high" } else { "low" })
    };
    html! {
        p.note {
            "Correlation of a pixel's temporal noise with that of its neighbours, per cent of the variance, mean over the flats; the colour is its "
            "distance from 0 in standard errors."
        }
        div.scroll tabindex="0" role="region" aria-label="correlation with neighbours" {
            table.lags {
                thead { tr { th.text { "rows below" } @for dx in -3..=3 { th scope="col" { (format!("{dx:+}").replace('-', "−").replace("+0", "0")) @if dx == 0 { " columns" } } } } }
                tbody {
                    @for dy in 0..=3 {
                        tr {
                            th scope="row" { (dy) }
                            @for dx in -3..=3 {
                                @if (dy, dx) == (0, 0) { td.number { "100" } }
                                @else if let Some((_, value, error)) = at(dy, dx) {
                                    td.number style=(shade(*value, *error)) { (with_error(100.0 * value, 100.0 * error)) }
                                } @else { td { "" } }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn quantities(s: &Study) -> Markup {
    html! {
        table.stack {
            thead { tr { th { "quantity" } th.text { "value ± standard error" } th.text { "how it was computed" } } }
            tbody {
                @for (id, q) in &s.quantities {
                    tr {
                        th scope="row" { (q.name) }
                        td.text.number { data.quantity id={ "q-" (id) } value=(q.quantity.value) { (q.quantity.to_string()) } }
                        td.text.small { (q.how) }
                    }
                }
                @for (effect, parameters) in &s.parameters {
                    @for (name, q) in parameters {
                        tr {
                            th scope="row" { (effect) ": " (name) }
                            td.text.number { data value=(q.value) { (q.to_string()) } }
                            td.text.small { "fitted with the effect in the model" }
                        }
                    }
                }
            }
        }
        @if let Err(why) = &s.noise { p { "No photon transfer line: " (why) "." } }
        @if !s.judgement.notes.is_empty() {
            h3 { "Notes" }
            ul { @for note in &s.judgement.notes { li { (note) } } }
        }
        h3 { "Model" }
        ul { @for line in &s.model { li { code { (line) } } } }
    }
}

fn facts(s: &Study) -> Markup {
    let Some(c) = &s.camera else { return html! { p { "A table holds no settings." } } };
    let number = |x: Option<f64>, unit: &str| x.map(|x| format!("{x} {unit}"));
    let all: Vec<(&str, Option<String>)> = vec![
        ("Vendor", Some(c.vendor.clone())),
        ("Model", Some(c.model.clone())),
        ("Serial number", Some(c.serial.clone())),
        ("Firmware", c.firmware.clone()),
        ("Size", Some(format!("{} × {} px", c.width, c.height))),
        ("Pixel format", Some(format!("{} ({} bit)", c.pixel_format, c.bit_depth))),
        ("Gain", number(c.gain_db, "dB")),
        ("Black level", number(c.black_level_dn, "DN")),
        ("Temperature", number(c.temperature_c, "°C")),
        ("Still automatic", Some(c.still_automatic.join(", "))),
    ];
    html! {
        dl.facts {
            @for (name, value) in all {
                @if let Some(value) = value.filter(|v| !v.trim().is_empty()) { div { dt { (name) } dd { (value) } } }
            }
        }
        @if !c.features.is_empty() {
            details {
                summary { (c.features.len()) " GenICam features as they were read" }
                dl.facts { @for (name, value) in &c.features { div { dt { (name) } dd { (value.to_string().trim_matches('"')) } } } }
            }
        }
    }
}

fn provenance(s: &Study) -> Markup {
    let p = &s.provenance;
    html! {
        dl.facts {
            div { dt { "Data" } dd { (p.datasets.join(", ")) } }
            div { dt { "Frames" } dd { (p.frames) } }
            div { dt { "Made" } dd { (p.made) } }
            div { dt { "By" } dd { "radcam " (p.version) } }
        }
        p { "Command: " code { (p.command) } }
        p { "SHA-256 of what sha256sum prints of the " (p.files) " files: " code { (p.sha256) } }
    }
}
