//! Data page: sets with thumbnails, and a viewer with pixel values, histogram, line profile, differences,
//! means and variances.

use super::shell::{self, Part, alert};
use crate::dataset::Dataset;
use crate::workbench::Shared;
use axum::extract::{Query, State};
use maud::{Markup, html};
use std::sync::Arc;

/// Renders the page, or its main part.
pub async fn page(State(shared): State<Arc<Shared>>, Query(q): Query<Part>) -> Markup {
    let campaign = shared.desk().campaign();
    let body = match campaign.as_ref().and_then(|c| c.dataset()) {
        Some(dataset) => body(dataset),
        None if campaign.is_some() => {
            html! { h1 { "Data" } p { "A table of means and variances has no frames." } }
        }
        None => {
            html! { h1 { "Data" } p { "Nothing is read yet." } @if let crate::workbench::desk::Data::Failed(why) = &shared.desk().data { (alert(why)) } }
        }
    };
    // Without a room the page is not re-rendered while the user works in the viewer.
    let room = if campaign.is_some() { "" } else { "/data" };
    let main = shell::main(&shared, room, body);
    if q.part.is_some() { main } else { shell::page(&shared, "/data", main) }
}

fn body(dataset: &Dataset) -> Markup {
    let camera = &dataset.manifest().camera;
    html! {
        h1 { "Data" }
        p.sub { (dataset.rows().len()) " frames in " (dataset.sets().len()) " sets, " (camera.width) " × " (camera.height) " px, " (camera.bit_depth) " bit" }
        div #viewer data-full=(camera.full_scale_dn()) {
            p.tools {
                label { "Set " select #v-set { @for s in dataset.sets() { @let r = dataset.settings(s);
                    option value=(s.number) data-frames=(s.rows.len()) { (s.number) ": " (r.kind) ", " (format!("{:.4}", 1e3 * r.exposure_s)) " ms, light " (format!("{:.3}", r.illumination)) } } } }
                label { "Frame " input #v-index type="number" min="0" value="0"; }
                label { "Show " select #v-of { option value="frame" { "the frame" } option value="difference" { "the frame less another" } option value="mean" { "mean of the set" } option value="variance" { "temporal variance of the set" } } }
                label #v-other hidden { "less frame " input #v-less type="number" min="0" value="1"; }
                label { "Black " input #v-low type="number" step="any"; }
                label { "White " input #v-high type="number" step="any"; }
                button #v-fit { "Whole image" }
            }
            p #v-error role="alert" {}
            div.view {
                canvas #v-image tabindex="0" role="img" aria-label="The image. Arrow keys move the view, plus and minus zoom, and the pixel in the middle is read." {}
                div.side {
                    p #v-pixel aria-live="polite" { "Point at a pixel." }
                    h2 { "Histogram" } canvas #v-histogram width="300" height="140" role="img" aria-label="histogram of the image" {}
                    h2 { "Row and column through the pixel" } canvas #v-profile width="300" height="160" role="img" aria-label="profiles through the pixel" {}
                    p #v-statistics.note {}
                }
            }
            p.note { "Wheel or + and −: zoom. Drag or arrow keys: move. Click: keep the pixel for the profiles." }
        }
        h2 { "Sets" }
        div.sets {
            @for s in dataset.sets() {
                @let r = dataset.settings(s);
                button.set data-set=(s.number) {
                    img src={ "/thumbnail?set=" (s.number) } alt="" loading="lazy" width="160";
                    span { b { "set " (s.number) } " " (r.kind) br; (format!("{:.4}", 1e3 * r.exposure_s)) " ms, light " (format!("{:.3}", r.illumination)) br; (s.rows.len()) " frames" }
                }
            }
        }
    }
}
