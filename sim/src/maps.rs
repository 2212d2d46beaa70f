//! Spatial nonuniformity: per-pixel maps that stay from frame to frame.

use crate::model::Model;
use crate::rng::{PixelRng, Stream};
use ndarray::Array2;
use rayon::prelude::*;

/// Per-pixel maps of a sensor, each (rows, columns), drawn from the seed.
#[derive(Debug, Clone)]
pub struct Maps {
    /// K(a,b), mean 1 over the sensor (eq. 2); dead and optically black pixels are then set to 0.
    pub uniformity: Array2<f32>,
    /// Dark current over its mean.
    pub dark_current: Array2<f32>,
    /// Offset from the black level, DN.
    pub offset_dn: Array2<f32>,
    /// Read noise over its root mean square; `None`: all pixels are alike.
    pub read_noise: Option<Array2<f32>>,
}

fn map(model: &Model, value: impl Fn(u32) -> f64 + Sync) -> Array2<f32> {
    let shape = (model.camera.height as usize, model.camera.width as usize);
    let mut out = Array2::zeros(shape);
    if let Some(pixels) = out.as_slice_mut() {
        pixels.par_iter_mut().enumerate().for_each(|(i, p)| *p = value(i as u32) as f32);
    }
    out
}

/// Draws the read-noise map: log-normal, some pixels noisier still, with mean square 1.
fn read_noise(model: &Model) -> Option<Array2<f32>> {
    let base = &model.base;
    if base.read_noise_log_spread == 0.0 && base.noisy_pixel_fraction == 0.0 {
        return None;
    }
    let mut all = map(model, |p| {
        let mut random = PixelRng::new(base.seed, Stream::ReadNoise, 0, p, 0);
        let ordinary = libm::exp(base.read_noise_log_spread * random.normal());
        if random.uniform() < base.noisy_pixel_fraction {
            base.noisy_pixel_factor * ordinary
        } else {
            ordinary
        }
    });
    let square = all.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / all.len() as f64;
    all.mapv_inplace(|v| (f64::from(v) / square.sqrt()) as f32);
    Some(all)
}

/// Sets K to 0 for pixels without response: dead ones anywhere, and the black reference at the left edge.
fn blind(model: &Model, uniformity: &mut Array2<f32>) {
    let base = &model.base;
    if base.dead_pixel_fraction == 0.0 && base.black_columns == 0 {
        return;
    }
    for (pixel, ((_, x), k)) in uniformity.indexed_iter_mut().enumerate() {
        let mut random = PixelRng::new(base.seed, Stream::DeadPixels, 0, pixel as u32, 0);
        if x < base.black_columns as usize || random.uniform() < base.dead_pixel_fraction {
            *k = 0.0;
        }
    }
}

impl Maps {
    /// Draws the maps of a model.
    pub fn new(model: &Model) -> Self {
        let base = &model.base;
        let normal = |stream, pixel| PixelRng::new(base.seed, stream, 0, pixel, 0).normal();
        let mut uniformity = map(model, |p| (1.0 + base.sigma_k * normal(Stream::Uniformity, p)).max(0.0));
        let mean = uniformity.iter().map(|&k| f64::from(k)).sum::<f64>() / uniformity.len() as f64;
        uniformity.mapv_inplace(|k| (f64::from(k) / mean) as f32);
        blind(model, &mut uniformity);

        // Log-normal with mean 1 and the wanted relative deviation.
        let log_variance = libm::log1p(base.dark_current_spread * base.dark_current_spread);
        let dark_current = map(model, |p| {
            let ordinary =
                libm::exp(log_variance.sqrt() * normal(Stream::DarkCurrent, p) - 0.5 * log_variance);
            let mut hot = PixelRng::new(base.seed, Stream::HotPixels, 0, p, 0);
            if hot.uniform() < base.hot_pixel_fraction {
                ordinary + base.hot_pixel_factor * hot.exponential()
            } else {
                ordinary
            }
        });
        let offset_dn = map(model, |p| base.offset_spread_dn * normal(Stream::Offset, p));
        Self { uniformity, dark_current, offset_dn, read_noise: read_noise(model) }
    }
}
