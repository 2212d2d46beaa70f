//! What stands before the camera, and how it is lit.

use crate::model::{Bench, Body};
use ndarray::Array2;
use serde::{Deserialize, Serialize};

/// What the camera looks at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scene {
    /// A nearly uniform reflectance card (Section III of the paper).
    #[default]
    Card,
    /// A dim background with one bright square in the middle, a third of the frame wide.
    Patch,
}

/// Light of the background of [`Scene::Patch`], relative to the patch.
pub const PATCH_BACKGROUND: f64 = 0.08;

/// The relative light at every pixel, (rows, columns): 1 in the middle of the card.
pub fn light_map(body: &Body, bench: &Bench, scene: Scene, configuration: u32) -> Array2<f32> {
    let (h, w) = (body.height as usize, body.width as usize);
    // Card and lamp are moved: the middle of the light wanders and its slope turns by the golden angle.
    let turn = f64::from(configuration) * 2.399_963_229_728_653;
    let (along_x, along_y) = (libm::cos(turn), libm::sin(turn));
    let wander = if configuration == 0 { 0.0 } else { 0.25 };
    let (mid_x, mid_y) = (wander * along_y, wander * along_x);
    Array2::from_shape_fn((h, w), |(row, column)| {
        // From -1 to 1 across the frame.
        let x = 2.0 * (column as f64 + 0.5) / w as f64 - 1.0;
        let y = 2.0 * (row as f64 + 0.5) / h as f64 - 1.0;
        let fall = 0.5 * bench.shading * ((x - mid_x).powi(2) + (y - mid_y).powi(2));
        let slope = 0.5 * bench.gradient * (x * along_x + y * along_y);
        let light = (1.0 - fall + slope).max(0.0);
        let seen = match scene {
            Scene::Card => 1.0,
            Scene::Patch if x.abs() < 1.0 / 3.0 && y.abs() < 1.0 / 3.0 => 1.0,
            Scene::Patch => PATCH_BACKGROUND,
        };
        (light * seen) as f32
    })
}
