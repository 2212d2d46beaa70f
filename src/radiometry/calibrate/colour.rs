//! Four planes of a colour mosaic of two by two pixels.

use super::pattern::FixedPattern;
use crate::statistics::lit::Lit;
use ndarray::{Array2, s};

/// First row and column of each plane.
const PLACES: [(usize, usize); 4] = [(0, 0), (0, 1), (1, 0), (1, 1)];

/// Returns first row, first column and period of each plane; a sensor without a mosaic is one plane.
pub(super) fn places(mosaic: bool) -> impl Iterator<Item = (usize, usize, usize)> {
    let (planes, period) = if mosaic { (PLACES.len(), 2) } else { (1, 1) };
    PLACES.into_iter().take(planes).map(move |(y, x)| (y, x, period))
}

/// Splits images into the four planes, at half the size.
pub(super) fn planes(images: &[Array2<f32>]) -> [Vec<Array2<f32>>; 4] {
    PLACES.map(|(y, x)| images.iter().map(|image| image.slice(s![y..;2, x..;2]).to_owned()).collect())
}

/// Joins the patterns of the planes, in that order, and the maps of lit pixels: K has mean 1 in each.
pub(super) fn joined(patterns: &[(FixedPattern, Lit)], shape: (usize, usize)) -> (FixedPattern, Lit) {
    let mut light =
        Lit { lit: Array2::from_elem(shape, false), blind: Array2::from_elem(shape, false), level_dn: 0.0 };
    let mut out = FixedPattern {
        k: Array2::ones(shape),
        std_err: Array2::zeros(shape),
        kept: Array2::zeros(shape),
        pooled_sd: 0.0,
        mean_before: 0.0,
        level_dn: 0.0,
    };
    let n = patterns.len().max(1) as f64;
    for ((y, x), (p, of_plane)) in PLACES.into_iter().zip(patterns) {
        light.lit.slice_mut(s![y..;2, x..;2]).assign(&of_plane.lit);
        light.blind.slice_mut(s![y..;2, x..;2]).assign(&of_plane.blind);
        out.k.slice_mut(s![y..;2, x..;2]).assign(&p.k);
        out.std_err.slice_mut(s![y..;2, x..;2]).assign(&p.std_err);
        out.kept.slice_mut(s![y..;2, x..;2]).assign(&p.kept);
        out.pooled_sd += p.pooled_sd / n;
        out.mean_before += p.mean_before / n;
        // An error of the darks weighs most in the plane with the least light: its level bounds the error.
        out.level_dn = if out.level_dn == 0.0 { p.level_dn } else { out.level_dn.min(p.level_dn) };
    }
    (out, light)
}
