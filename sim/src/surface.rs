//! Surfaces: reflectance as a mean plus a random variation (Section III of the paper, eq. 7 to 9).
//!
//! A surface is drawn on a grid finer than the pixels, so that optics and pixel aperture act on structure
//! that a pixel cannot resolve, and structure above the Nyquist frequency aliases as it should.

use crate::rng::{PixelRng, Stream};
use ndarray::{Array2, Axis};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Points of the fine grid along the side of a pixel.
pub const FINE: usize = 3;

/// Shape of the spectrum of a surface's variation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Spectrum {
    /// Correlation exp(-d^2 / (2 L^2)): smooth grain.
    #[default]
    Gaussian,
    /// Exponential smoothing along both axes: sharp grain with a long tail of frequencies.
    Exponential,
}

/// Variation of a surface's reflectance about its mean.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Texture {
    /// Standard deviation of r over the mean reflectance, before optics and aperture smooth it.
    pub grain: f64,
    /// Correlation length L of the grain, pixels; 0: white on the fine grid.
    pub grain_length_px: f64,
    /// Shape of the grain's spectrum.
    pub spectrum: Spectrum,
    /// Share of pixels with a spot.
    pub spot_fraction: f64,
    /// Largest darkening by a spot; each takes a random part of it.
    pub spot_depth: f64,
    /// Relative amplitude of a grating along the rows.
    pub grating: f64,
    /// Frequency of the grating, cycles per pixel.
    pub grating_cycles_per_px: f64,
}

impl Texture {
    /// Returns true if there is nothing to draw.
    pub fn is_plain(&self) -> bool {
        self.grain == 0.0 && self.spot_fraction * self.spot_depth == 0.0 && self.grating == 0.0
    }

    /// Draws the reflectance over its mean on the fine grid, for `shape` pixels (rows, columns) and `margin`
    /// more pixels on every side. `patch` selects the piece of the surface.
    pub(crate) fn draw(&self, shape: (usize, usize), margin: usize, seed: u64, patch: u64) -> Array2<f64> {
        let side = |n: usize| (n + 2 * margin) * FINE;
        // The grain is smoothed on a wider field, which is then cropped.
        let sigma = self.grain_length_px / std::f64::consts::SQRT_2 * FINE as f64;
        let kernel = match self.spectrum {
            Spectrum::Gaussian => gaussian(sigma),
            Spectrum::Exponential => exponential(self.grain_length_px * FINE as f64),
        };
        let reach = kernel.len() / 2;
        let fine = (side(shape.0), side(shape.1));
        let mut out = if self.grain > 0.0 {
            let wide = (fine.0 + 2 * reach, fine.1 + 2 * reach);
            let mut white = Array2::zeros(wide);
            if let Some(all) = white.as_slice_mut() {
                all.par_chunks_mut(2).enumerate().for_each(|(i, pair)| {
                    let (a, b) = PixelRng::new(seed, Stream::Card, patch, i as u32, 0).normal_pair();
                    pair.iter_mut().zip([a, b]).for_each(|(v, n)| *v = self.grain * n);
                });
            }
            // White noise keeps its variance if the squares of the kernel add up to one.
            let norm = kernel.iter().map(|k| k * k).sum::<f64>().sqrt();
            let kernel: Vec<f64> = kernel.iter().map(|k| k / norm).collect();
            inner(&smooth(&white, &kernel), reach) + 1.0
        } else {
            Array2::ones(fine)
        };
        if self.spot_fraction > 0.0 {
            let (rows, columns) = (fine.0 / FINE, fine.1 / FINE);
            for y in 0..rows {
                for x in 0..columns {
                    let mut rng = PixelRng::new(seed, Stream::Spots, patch, (y * columns + x) as u32, 0);
                    if rng.uniform() < self.spot_fraction {
                        let dark = 1.0 - self.spot_depth * rng.uniform();
                        let spot = ndarray::s![y * FINE..(y + 1) * FINE, x * FINE..(x + 1) * FINE];
                        out.slice_mut(spot).mapv_inplace(|r| r * dark);
                    }
                }
            }
        }
        if self.grating != 0.0 {
            let turn = std::f64::consts::TAU * self.grating_cycles_per_px / FINE as f64;
            for (x, mut column) in out.axis_iter_mut(Axis(1)).enumerate() {
                let at = x as f64 + 0.5 - (margin * FINE) as f64;
                column.mapv_inplace(|r| r * (1.0 + self.grating * libm::cos(turn * at)));
            }
        }
        out.mapv_inplace(|r| r.max(0.0));
        out
    }
}

/// Returns a normalised Gaussian kernel of standard deviation `sigma`, grid points; a single 1 if it is 0.
pub(crate) fn gaussian(sigma: f64) -> Vec<f64> {
    let reach = libm::ceil(4.0 * sigma) as i64;
    normalised((-reach..=reach).map(|i| {
        let t = i as f64 / sigma.max(1e-9);
        libm::exp(-0.5 * t * t)
    }))
}

fn exponential(length: f64) -> Vec<f64> {
    let reach = libm::ceil(6.0 * length) as i64;
    normalised((-reach..=reach).map(|i| libm::exp(-(i.abs() as f64) / length.max(1e-9))))
}

fn normalised(kernel: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut kernel: Vec<f64> = kernel.collect();
    let sum: f64 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    kernel
}

/// Convolves with the same kernel along both axes; the border is repeated.
pub(crate) fn smooth(image: &Array2<f64>, kernel: &[f64]) -> Array2<f64> {
    if kernel.len() < 2 {
        return image.clone();
    }
    let along_rows = |image: &Array2<f64>| {
        let (rows, columns) = image.dim();
        let reach = kernel.len() / 2;
        let mut out = Array2::zeros((rows, columns));
        let pixels = out.as_slice_mut().unwrap_or_default();
        pixels.par_chunks_mut(columns).zip(image.axis_iter(Axis(0)).into_par_iter()).for_each(
            |(out, row)| {
                let last = columns - 1;
                let padded: Vec<f64> =
                    (0..columns + 2 * reach).map(|i| row[i.saturating_sub(reach).min(last)]).collect();
                for (out, window) in out.iter_mut().zip(padded.windows(kernel.len())) {
                    *out = window.iter().zip(kernel).map(|(v, k)| v * k).sum();
                }
            },
        );
        out
    };
    let turned = along_rows(image).reversed_axes().as_standard_layout().into_owned();
    along_rows(&turned).reversed_axes().as_standard_layout().into_owned()
}

/// Crops `margin` points on every side.
pub(crate) fn inner(image: &Array2<f64>, margin: usize) -> Array2<f64> {
    let (rows, columns) = image.dim();
    image.slice(ndarray::s![margin..rows - margin, margin..columns - margin]).to_owned()
}

/// Integrates over the apertures of the pixels: the mean of each pixel's fine points (eq. 16).
pub(crate) fn aperture(fine: &Array2<f64>) -> Array2<f64> {
    let (rows, columns) = (fine.nrows() / FINE, fine.ncols() / FINE);
    Array2::from_shape_fn((rows, columns), |(y, x)| {
        let part = fine.slice(ndarray::s![y * FINE..(y + 1) * FINE, x * FINE..(x + 1) * FINE]);
        part.sum() / (FINE * FINE) as f64
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn correlation(field: &Array2<f64>, lag: usize) -> f64 {
        let mean = field.mean().unwrap();
        let (rows, columns) = field.dim();
        let at = |x: usize| field.slice(ndarray::s![.., x..columns - lag + x]).mapv(|v| v - mean);
        let product = (&at(0) * &at(lag)).sum() / (rows * (columns - lag)) as f64;
        product / (field.mapv(|v| (v - mean).powi(2)).sum() / field.len() as f64)
    }

    /// Standard deviation and correlation of the grain are those asked for. The field holds some 700
    /// independent patches: four standard errors of a deviation are 0.11.
    #[test]
    fn grain_has_its_spread_and_its_length() {
        for (spectrum, at_length) in [(Spectrum::Gaussian, (-0.5f64).exp()), (Spectrum::Exponential, 0.73)] {
            let texture = Texture { grain: 0.02, grain_length_px: 2.0, spectrum, ..Default::default() };
            let field = texture.draw((120, 120), 2, 5, 0);
            let mean = field.mean().unwrap();
            let sd = field.mapv(|v| (v - mean).powi(2)).mean().unwrap().sqrt();
            assert!((sd / 0.02 - 1.0).abs() < 0.11, "{spectrum:?}: {sd}");
            let r = correlation(&field, 2 * FINE);
            // Smoothing by exp(-|x|/L) twice correlates as (1 + d/L) exp(-d/L): 0.736 at d = L.
            assert!((r - at_length).abs() < 0.1, "{spectrum:?}: {r}");
        }
    }

    /// A grating of 0.8 cycles per pixel is seen at 0.2, weakened by the aperture's sinc: 0.234 of it is
    /// left.
    #[test]
    fn structure_above_nyquist_aliases() {
        let texture = Texture { grating: 0.5, grating_cycles_per_px: 0.8, ..Default::default() };
        let seen = aperture(&texture.draw((2, 100), 0, 1, 0));
        let wave = |f: f64| {
            let (mut c, mut s) = (0.0, 0.0);
            for (x, v) in seen.row(0).iter().enumerate() {
                let phase = std::f64::consts::TAU * f * (x as f64 + 0.5);
                (c, s) = (c + (v - 1.0) * phase.cos(), s + (v - 1.0) * phase.sin());
            }
            (c * c + s * s).sqrt() / 50.0
        };
        // Three points a pixel: the mean of three cosines, sin(3 t / 2) / (3 sin(t / 2)) with t = 2 pi 0.8 /
        // 3.
        let t = std::f64::consts::TAU * 0.8 / 3.0;
        let left = ((1.5 * t).sin() / (3.0 * (0.5 * t).sin())).abs();
        assert!((wave(0.2) / (0.5 * left) - 1.0).abs() < 0.02, "{} {left}", wave(0.2));
        assert!(wave(0.33) < 0.01);
    }
}
