//! Pixels of frames as numbers for the viewer, thumbnails, and the live picture. Frames are addressed by set
//! and index, never by path.

use super::{Shared, aside};
use crate::dataset::image::Buffer;
use crate::dataset::{Dataset, Set};
use axum::extract::{Query, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use image::{GrayImage, ImageFormat};
use ndarray::Array2;
use serde::Deserialize;
use std::io::Cursor;
use std::sync::Arc;

/// Requested image.
#[derive(Deserialize)]
pub struct Wanted {
    set: u32,
    #[serde(default)]
    index: usize,
    /// One of: frame, difference, mean, variance.
    #[serde(default)]
    of: String,
    /// Subtracted frame of the same set, for a difference; the preceding one if absent.
    less: Option<usize>,
}

fn refused(e: &str) -> Response {
    (StatusCode::NOT_FOUND, [(header::CONTENT_TYPE, "text/plain; charset=utf-8")], format!("{e}\n"))
        .into_response()
}

fn set_of(dataset: &Dataset, number: u32) -> Result<&Set, String> {
    dataset.sets().iter().find(|s| s.number == number).ok_or_else(|| format!("there is no set {number}"))
}

fn frame(dataset: &Dataset, set: &Set, index: usize) -> Result<Array2<u16>, String> {
    let row =
        set.rows.get(index).ok_or_else(|| format!("set {} has {} frames", set.number, set.rows.len()))?;
    dataset.read(&dataset.rows()[*row]).map_err(|e| e.to_string())
}

/// Computes mean and temporal variance of a set's frames, pixel by pixel (Welford 1962, Technometrics 4,
/// 419).
fn moments(dataset: &Dataset, set: &Set) -> Result<[Array2<f32>; 2], String> {
    let mut buffer = Buffer::default();
    let (mut mean, mut squares): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
    for (k, &row) in set.rows.iter().enumerate() {
        dataset.read_into(&dataset.rows()[row], &mut buffer).map_err(|e| e.to_string())?;
        mean.resize(buffer.dn().len(), 0.0);
        squares.resize(buffer.dn().len(), 0.0);
        for ((m, s), v) in mean.iter_mut().zip(&mut squares).zip(buffer.dn()) {
            let d = f64::from(*v) - *m;
            *m += d / (k + 1) as f64;
            *s += d * (f64::from(*v) - *m);
        }
    }
    let dof = (set.rows.len() as f64 - 1.0).max(1.0);
    let image = |values: Vec<f64>, over: f64| {
        let values = values.into_iter().map(|v| (v / over) as f32).collect();
        Array2::from_shape_vec(buffer.shape(), values).map_err(|e| e.to_string())
    };
    Ok([image(mean, 1.0)?, image(squares, dof)?])
}

fn wanted(dataset: &Dataset, q: &Wanted) -> Result<Array2<f32>, String> {
    let set = set_of(dataset, q.set)?;
    match &*q.of {
        "" | "frame" => Ok(frame(dataset, set, q.index)?.mapv(f32::from)),
        "difference" => {
            let less = q.less.unwrap_or_else(|| q.index.saturating_sub(1));
            Ok(frame(dataset, set, q.index)?.mapv(f32::from) - frame(dataset, set, less)?.mapv(f32::from))
        }
        "mean" => moments(dataset, set).map(|[mean, _]| mean),
        "variance" if set.rows.len() > 1 => moments(dataset, set).map(|[_, variance]| variance),
        "variance" => Err(format!("set {} has one frame: no temporal variance", q.set)),
        other => Err(format!("there is no \"{other}\" of a frame")),
    }
}

fn numbers(image: &Array2<f32>) -> Response {
    let bytes: Vec<u8> = image.iter().flat_map(|v| v.to_le_bytes()).collect();
    let (rows, columns) = image.dim();
    (
        [
            ("content-type", "application/octet-stream".to_string()),
            ("x-width", columns.to_string()),
            ("x-height", rows.to_string()),
        ],
        bytes,
    )
        .into_response()
}

/// Serves a frame, difference, mean or variance as 32-bit floats, little-endian, row by row.
pub async fn pixels(State(shared): State<Arc<Shared>>, Query(q): Query<Wanted>) -> Response {
    let image = aside(move || {
        let campaign = shared.desk().campaign().ok_or("there is no campaign yet")?;
        wanted(campaign.dataset().ok_or("a table has no frames")?, &q)
    });
    match image.await.and_then(|r: Result<_, String>| r) {
        Ok(image) => numbers(&image),
        Err(e) => refused(&e),
    }
}

/// Maximum columns of a thumbnail.
const SMALL: usize = 160;

/// Serves a thumbnail of the first frame of a set.
pub async fn thumbnail(State(shared): State<Arc<Shared>>, Query(q): Query<Wanted>) -> Response {
    let png = aside(move || -> Result<Vec<u8>, String> {
        let campaign = shared.desk().campaign().ok_or("there is no campaign yet")?;
        let dataset = campaign.dataset().ok_or("a table has no frames")?;
        let pixels = frame(dataset, set_of(dataset, q.set)?, 0)?;
        let full = f32::from(dataset.manifest().camera.full_scale_dn());
        let step = pixels.ncols().div_ceil(SMALL).max(1);
        let small = pixels.slice(ndarray::s![..;step, ..;step]);
        // Square root of the fraction of full scale: dark sets stay dark, and their pattern is still visible.
        let grey = small.iter().map(|v| (255.0 * (f32::from(*v) / full).min(1.0).sqrt()) as u8).collect();
        let (rows, columns) = small.dim();
        let picture = GrayImage::from_raw(columns as u32, rows as u32, grey).ok_or("no pixels")?;
        let mut png = Cursor::new(Vec::new());
        picture.write_to(&mut png, ImageFormat::Png).map_err(|e| e.to_string())?;
        Ok(png.into_inner())
    });
    match png.await.and_then(|r| r) {
        Ok(png) => ([(header::CONTENT_TYPE, "image/png")], png).into_response(),
        Err(e) => refused(&e),
    }
}

/// Number of the last picture received.
#[derive(Deserialize)]
pub struct After {
    #[serde(default)]
    after: u64,
}

/// Serves the live picture as soon as there is a newer one: 16-bit codes, little-endian, row by row;
/// statistics in headers.
pub async fn live(State(shared): State<Arc<Shared>>, Query(q): Query<After>) -> Response {
    let Some(live) = shared.live() else { return refused("there is no camera") };
    let Some(p) = live.picture(q.after).await else {
        let (settings, _, error) = live.state();
        let waited = crate::camera::patience(settings.map_or(0.0, |s| s.exposure_s));
        let error = error.unwrap_or_else(|| format!("no picture within {:.0} s", waited.as_secs_f64()));
        return (StatusCode::SERVICE_UNAVAILABLE, format!("{error}\n")).into_response();
    };
    let drawn = aside(move || {
        let bytes: Vec<u8> = p.frame.pixels.iter().flat_map(|v| v.to_le_bytes()).collect();
        let (rows, columns) = p.frame.pixels.dim();
        let says = [
            ("x-width", columns.to_string()),
            ("x-height", rows.to_string()),
            ("x-number", p.number.to_string()),
            ("x-frame", p.frame.id.to_string()),
            ("x-mean", format!("{:.2}", p.mean_dn())),
            ("x-variance", format!("{:.3}", p.var_dn2())),
            ("x-saturated", p.saturated().to_string()),
            ("x-full", p.full_dn.to_string()),
        ];
        (bytes, says)
    });
    let (bytes, says) = match drawn.await {
        Ok(drawn) => drawn,
        Err(e) => return refused(&e),
    };
    let mut answer = ([(header::CONTENT_TYPE, "application/octet-stream")], bytes).into_response();
    for (name, value) in says {
        if let Ok(value) = HeaderValue::from_str(&value) {
            answer.headers_mut().insert(HeaderName::from_static(name), value);
        }
    }
    answer
}
