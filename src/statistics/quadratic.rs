//! Sums of products of deviations, row by row while the image is in the cache.

use super::layout::Layout;

/// A sum of products of deviations.
pub trait Quadratic {
    /// Adds row `y` of an image of deviations whose rows up to `y` are there.
    fn row(&mut self, y: usize, image: &[f32], layout: &Layout);
    /// The image is complete.
    fn end(&mut self, image: &[f32], layout: &Layout);
    /// Adds the sums of another.
    fn absorb(&mut self, other: &Self);
}
