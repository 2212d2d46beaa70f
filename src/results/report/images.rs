//! Images with a scale, embedded in the page as PNG.

use super::plot::in_html;
use crate::number::pretty;
use crate::study::Map;
use base64::Engine;
use image::{GrayImage, ImageFormat};
use maud::{Markup, html};
use ndarray::Array2;
use std::io::Cursor;

/// Maximum columns of a picture; keeps the page small.
const COLUMNS: usize = 640;

/// Averages over blocks, so that no pixel is skipped.
fn reduced(values: &Array2<f32>) -> (Array2<f32>, usize) {
    let step = values.ncols().div_ceil(COLUMNS).max(1);
    let blocks = values.exact_chunks((step, step));
    let shape = (values.nrows() / step, values.ncols() / step);
    let means: Vec<f32> = blocks.into_iter().map(|b| b.mean().unwrap_or(0.0)).collect();
    (Array2::from_shape_vec(shape, means).unwrap_or_else(|_| values.clone()), step)
}

/// Returns the central 99 % range of the pixel values.
fn range(values: &Array2<f32>) -> (f32, f32) {
    let mut sorted: Vec<f32> = values.iter().copied().filter(|v| v.is_finite()).collect();
    if sorted.is_empty() {
        return (0.0, 1.0);
    }
    let last = sorted.len() - 1;
    let (low, high) = (last / 200, last - last / 200);
    let low = *sorted.select_nth_unstable_by(low, f32::total_cmp).1;
    let high = *sorted.select_nth_unstable_by(high, f32::total_cmp).1;
    (low, if high > low { high } else { low + 1.0 })
}

/// Renders a map as a picture.
pub fn map(m: &Map) -> Markup {
    let (values, step) = reduced(&m.values);
    let (low, high) = range(&values);
    let grey = |v: &f32| (255.0 * ((v - low) / (high - low)).clamp(0.0, 1.0)).round() as u8;
    let (rows, columns) = values.dim();
    let mut png = Cursor::new(Vec::new());
    let picture = GrayImage::from_raw(columns as u32, rows as u32, values.iter().map(grey).collect());
    let written = picture.is_some_and(|p| p.write_to(&mut png, ImageFormat::Png).is_ok());
    let data = base64::engine::general_purpose::STANDARD.encode(png.into_inner());
    let unit = pretty(m.unit);
    let number = |v: f32| {
        let digits = (2.0 - (high - low).log10().floor()).clamp(0.0, 6.0) as usize;
        format!("{v:.digits$} {unit}").trim_end().to_string()
    };
    html! {
        figure.map {
            h3 { (in_html(&m.title)) }
            @if written { img src={ "data:image/png;base64," (data) } alt={ (m.title) ", " (m.of) } width=(columns) height=(rows); }
            p.bar { span { "≤ " (number(low)) } i aria-hidden="true" {} span { "≥ " (number(high)) } }
            figcaption {
                (m.of) ". The grey scale holds 99 % of the pixels" @if step > 1 { "; means of " (step) " × " (step) " pixels" } ". "
                (m.outliers) " of " (m.values.len()) " pixels lie more than 6 spreads from the median."
            }
        }
    }
}
