//! Sums of products of deviations, row by row while the image is in the cache.

use super::layout::Layout;

/// A sum of products of deviations.
pub trait Quadratic {
    /// Adds row `y` of an image of deviations; rows up to `y` must be filled.
    fn row(&mut self, y: usize, image: &[f32], layout: &Layout);
    /// Completes the image.
    fn end(&mut self, image: &[f32], layout: &Layout);
    /// Merges the sums of another.
    fn absorb(&mut self, other: &Self);
}
