//! Scene before the camera, and its lighting (Section III of the paper, eq. 7 to 19).

use crate::model::{Bench, Body, Model};
use crate::optics::shares;
use crate::region::Region;
use crate::surface::{FINE, aperture, inner, smooth};
use ndarray::{Array2, Zip};
use serde::{Deserialize, Serialize};

/// Scene before the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scene {
    /// A nearly uniform reflectance card (Section III of the paper).
    #[default]
    Card,
    /// A dim background with one bright square in the middle, a third of the frame wide.
    Patch,
    /// Painted squares side by side, each with its own reflectance and variation.
    Chart,
}

/// Light of the background of [`Scene::Patch`], relative to the patch.
pub const PATCH_BACKGROUND: f64 = 0.08;

/// Reflectance between the squares of the chart.
const GAP: f64 = 0.03;

impl Bench {
    /// Returns the image region of square number `index` of the chart, without its edges, pixels.
    pub fn square_region(&self, body: &Body, index: usize) -> Region {
        let (x, y, width, height) = cell(body, self.chart.len(), index);
        let (edge_x, edge_y) = (width.div_ceil(8), height.div_ceil(8));
        Region {
            x: (x + edge_x) as u32,
            y: (y + edge_y) as u32,
            width: width.saturating_sub(2 * edge_x).max(1) as u32,
            height: height.saturating_sub(2 * edge_y).max(1) as u32,
        }
    }
}

/// Returns first column, first row, width and height of a square; three squares form a row.
fn cell(body: &Body, squares: usize, index: usize) -> (usize, usize, usize, usize) {
    let across = squares.clamp(1, 3);
    let down = squares.div_ceil(across).max(1);
    let (w, h) = (body.width as usize, body.height as usize);
    let (column, row) = (index % across, index / across);
    let (left, top) = (column * w / across, row * h / down);
    (left, top, (column + 1) * w / across - left, (row + 1) * h / down - top)
}

/// Returns the relative light at each pixel (rows, columns); 1 = plain card at the centre of the
/// illumination.
pub(crate) fn light_map(model: &Model, scene: Scene, configuration: u32) -> Array2<f32> {
    let mut light = light_of_card(model, scene, configuration);
    let radius = model.bench.image_circle;
    if radius > 0.0 {
        let (h, w) = (light.nrows() as f64, light.ncols() as f64);
        let diagonal = 0.5 * libm::hypot(h, w);
        for ((y, x), l) in light.indexed_iter_mut() {
            let off = libm::hypot(y as f64 + 0.5 - 0.5 * h, x as f64 + 0.5 - 0.5 * w) / diagonal;
            *l *= ((radius - off) / (RIM * radius)).clamp(0.0, 1.0) as f32;
        }
    }
    light
}

/// Width of the image circle's rim, relative to the radius: a slightly stopped-down lens (a named choice).
const RIM: f64 = 0.05;

/// Computes the light without the image circle.
fn light_of_card(model: &Model, scene: Scene, configuration: u32) -> Array2<f32> {
    let (body, bench) = (&model.camera, &model.bench);
    let shape = (body.height as usize, body.width as usize);
    let (h, w) = (shape.0 as f64, shape.1 as f64);
    // Card and lamp move with the configuration: the centre of the light shifts, and its slope turns by the
    // golden angle.
    let turn = f64::from(configuration) * 2.399_963_229_728_653;
    let (along_x, along_y) = (libm::cos(turn), libm::sin(turn));
    let wander = if configuration == 0 { 0.0 } else { 0.25 };
    let (mid_x, mid_y) = (wander * along_y, wander * along_x);
    // Light of the lamp at a point, in pixels from the corner.
    let lamp = |column: f64, row: f64| {
        let (x, y) = (2.0 * column / w - 1.0, 2.0 * row / h - 1.0);
        let fall = 0.5 * bench.shading * ((x - mid_x).powi(2) + (y - mid_y).powi(2));
        let slope = 0.5 * bench.gradient * (x * along_x + y * along_y);
        (1.0 - fall + slope).max(0.0)
    };
    let patch = |column: f64, row: f64| {
        let (x, y) = (2.0 * column / w - 1.0, 2.0 * row / h - 1.0);
        if x.abs() < 1.0 / 3.0 && y.abs() < 1.0 / 3.0 { 1.0 } else { PATCH_BACKGROUND }
    };
    let shares = shares(&bench.optics, &bench.bands, model.base.quantum_efficiency, FINE as f64);
    let unit = model.base.quantum_efficiency;
    let scale = |electrons: f64| if unit > 0.0 { electrons / unit } else { 0.0 };
    let reach = shares.iter().map(|s| s.kernel.len() / 2).max().unwrap_or(0);
    let plain = scene != Scene::Chart && bench.card.is_plain();
    if plain && reach == 0 {
        // No structure is finer than a pixel: the light at its centre is used.
        let all: f64 = shares.iter().map(|s| scale(s.electrons) * s.card).sum();
        return Array2::from_shape_fn(shape, |(row, column)| {
            let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
            let seen = if scene == Scene::Patch { patch(x, y) } else { 1.0 };
            (all * lamp(x, y) * seen) as f32
        });
    }

    let margin = reach.div_ceil(FINE);
    // Reflectance over its mean, the same in every band.
    let mut varies = bench.card.draw(shape, margin, model.base.seed, u64::from(configuration));
    // Number of the square at each point, where there is one; it selects the mean reflectance over the
    // card's.
    let squares = if scene == Scene::Chart { bench.chart.len() } else { 0 };
    let mut painted: Array2<u8> = Array2::from_elem(varies.dim(), u8::MAX);
    for (index, square) in bench.chart.iter().enumerate().take(squares) {
        let (left, top, width, height) = cell(body, squares, index);
        let (gap_x, gap_y) = (width / 20, height / 20);
        let size = (height - 2 * gap_y, width - 2 * gap_x);
        let number = (1 + u64::from(configuration)) << 16 | index as u64;
        let texture = square.texture.draw(size, 0, model.base.seed, number);
        let (y, x) = ((top + gap_y + margin) * FINE, (left + gap_x + margin) * FINE);
        let part = ndarray::s![y..y + size.0 * FINE, x..x + size.1 * FINE];
        varies.slice_mut(part).assign(&texture);
        painted.slice_mut(part).fill(index as u8);
    }
    let mut seen = Array2::<f64>::zeros(shape);
    for share in &shares {
        let mean = |index: u8| match bench.chart.get(usize::from(index)).filter(|_| index != u8::MAX) {
            Some(square) => {
                square.reflectance.get(share.band).or(square.reflectance.first()).map_or(0.0, |&r| r)
            }
            None if scene == Scene::Chart => GAP,
            None => 1.0,
        };
        let at = |i: usize| (i as f64 + 0.5) / FINE as f64 - margin as f64;
        let mut fine = Zip::indexed(&varies).and(&painted).par_map_collect(|(y, x), &r, &square| {
            let (x, y) = (at(x), at(y));
            let of_scene = if scene == Scene::Patch { patch(x, y) } else { mean(square) };
            lamp(x, y) * r * of_scene * share.card
        });
        fine = smooth(&fine, &share.kernel);
        seen.scaled_add(scale(share.electrons), &aperture(&inner(&fine, margin * FINE)));
    }
    seen.mapv(|light| light as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Band;
    use crate::sensors;
    use crate::surface::Texture;

    fn model() -> Model {
        let mut model = sensors::load("xc77").unwrap();
        (model.camera.width, model.camera.height) = (90, 60);
        model
    }

    #[test]
    fn the_fine_grid_agrees_with_the_plain_card() {
        let mut model = model();
        let plain = light_map(&model, Scene::Card, 3);
        model.bench.card.grain = 1e-9;
        let fine = light_map(&model, Scene::Card, 3);
        for (a, b) in plain.iter().zip(&fine) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
    }

    #[test]
    fn optics_soften_an_edge_and_leave_the_light() {
        let mut model = model();
        (model.bench.shading, model.bench.gradient) = (0.0, 0.0);
        let sharp = light_map(&model, Scene::Patch, 0);
        model.bench.optics.psf_sigma_px = 1.5;
        let soft = light_map(&model, Scene::Patch, 0);
        assert_eq!(sharp[(30, 29)], PATCH_BACKGROUND as f32);
        assert!((soft[(30, 29)] - 0.08 - 0.92 * 0.37).abs() < 0.02, "{}", soft[(30, 29)]);
        assert!((soft.mean().unwrap() / sharp.mean().unwrap() - 1.0).abs() < 1e-3);
    }

    #[test]
    fn bands_and_filters_weigh_the_light() {
        let mut model = model();
        (model.bench.shading, model.bench.gradient, model.bench.optics.nd_density) = (0.0, 0.0, 1.0);
        assert!((light_map(&model, Scene::Card, 0)[(0, 0)] - 0.1).abs() < 1e-6);
        model.bench.optics.nd_density = 0.0;
        let band = |lamp, quantum_efficiency, reflectance| Band {
            wavelength_nm: 550.0,
            lamp,
            transmission: 0.5,
            quantum_efficiency,
            reflectance,
            psf_sigma_px: None,
        };
        model.bench.bands = vec![band(3.0, 0.4, 1.0), band(1.0, 0.2, 0.5)];
        // (0.75 * 0.5 * 0.4 * 1 + 0.25 * 0.5 * 0.2 * 0.5) / 0.4
        assert!((light_map(&model, Scene::Card, 0)[(5, 5)] - 0.40625).abs() < 1e-6);
        // A square that reflects in the second band only.
        model.bench.chart[0].reflectance = vec![0.0, 0.8];
        model.bench.chart[0].texture = Texture::default();
        let region = model.bench.square_region(&model.camera, 0);
        let seen = light_map(&model, Scene::Chart, 0)[(region.y as usize + 2, region.x as usize + 2)];
        // 0.25 * 0.5 * 0.2 * 0.5 / 0.4 of the light, times 0.8.
        assert!((seen - 0.025).abs() < 1e-5, "{seen}");
    }

    /// A moved card shows every pixel a new patch; one that stays shows the same.
    #[test]
    fn each_configuration_shows_a_new_patch() {
        let mut model = model();
        (model.bench.shading, model.bench.gradient) = (0.0, 0.0);
        model.bench.card = Texture { grain: 0.01, ..Default::default() };
        let grain = |configuration| light_map(&model, Scene::Card, configuration).mapv(|l| l - 1.0);
        let product = |a: &Array2<f32>, b: &Array2<f32>| (a * b).sum() / (a * a).sum();
        let (first, second) = (grain(0), grain(1));
        assert_eq!(first, grain(0));
        // 5400 pixels: five standard errors of a correlation.
        assert!(product(&first, &second).abs() < 5.0 / 5400f32.sqrt());
    }
}
