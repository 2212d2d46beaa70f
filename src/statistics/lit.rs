//! Unlit pixels: outside the image circle of a lens, optically black columns, overscan.

use super::median::{MAD_OF_NORMAL, median};
use ndarray::{Array2, Axis, s};

/// Minimum signal of a lit pixel, as a share of the light level: lenses fall to a tenth in their corners at
/// worst (a named choice).
const MIN_LIGHT: f32 = 0.05;
/// Side of the blocks whose medians give the light level, pixels: single and dead pixels have no influence.
const BLOCK: usize = 8;
/// Share of the blocks that may exceed the light level: glints on the card.
const BRIGHTER_BLOCKS: f64 = 0.05;
/// Minimum light level over that of the brightest block, for circles that light few blocks.
const MIN_LEVEL: f32 = 0.2;
/// Neighbourhood, in pixels in each direction, of which half is unlit around a blind pixel.
const AROUND: usize = 2;
/// Minimum deficit of the response at the rim of a blind region, in standard deviations.
const RIM_DEVIATIONS: f64 = 5.0;

/// Lit pixels, and blind pixels: unlit ones among other unlit ones.
#[derive(Debug, Clone)]
pub struct Lit {
    /// True for lit pixels, (rows, columns).
    pub lit: Array2<bool>,
    /// True for unlit pixels in a mostly unlit neighbourhood.
    pub blind: Array2<bool>,
    /// Light level, DN.
    pub level_dn: f32,
}

impl Lit {
    /// Finds lit and blind pixels from flats of one size, dark reference subtracted, DN.
    pub fn of(images: &[Array2<f32>]) -> Self {
        Self::above(images, MIN_LIGHT)
    }

    /// Finds lit and blind pixels with another minimum share of the light level.
    pub fn above(images: &[Array2<f32>], min_light: f32) -> Self {
        let Some(first) = images.first() else {
            let none = || Array2::default((0, 0));
            return Self { lit: none(), blind: none(), level_dn: 0.0 };
        };
        let mut sum = first.clone();
        images[1..].iter().for_each(|image| sum += image);
        let (rows, columns) = sum.dim();
        let mut blocks: Vec<f32> = Vec::new();
        for y in (0..rows).step_by(BLOCK) {
            for x in (0..columns).step_by(BLOCK) {
                let part = sum.slice(s![y..(y + BLOCK).min(rows), x..(x + BLOCK).min(columns)]);
                blocks.push(median(part.iter().map(|&v| f64::from(v))) as f32);
            }
        }
        blocks.sort_by(|a, b| b.total_cmp(a));
        let place = (BRIGHTER_BLOCKS * blocks.len() as f64) as usize;
        let brightest = blocks.first().copied().unwrap_or(0.0);
        let level = blocks.get(place).copied().unwrap_or(brightest).max(MIN_LEVEL * brightest);
        let lit = sum.mapv(|v| v > (min_light * level).max(0.0));
        let near = |at: usize, n: usize| at.saturating_sub(AROUND)..(at + AROUND + 1).min(n);
        let blind = Array2::from_shape_fn(sum.dim(), |(y, x)| {
            let around = lit.slice(s![near(y, rows), near(x, columns)]);
            !lit[(y, x)] && 2 * around.iter().filter(|lit| !**lit).count() >= around.len()
        });
        Self { lit, blind, level_dn: level }
    }

    /// Extends the blind region by its rim, iteratively: neighbours of blind pixels that are unlit, or whose
    /// `response` (1 for even light) is below that of the others by more than `RIM_DEVIATIONS`.
    pub fn with_rim(mut self, response: &Array2<f32>) -> Self {
        let (rows, columns) = self.blind.dim();
        let off =
            || response.iter().zip(&self.lit).filter(|(_, lit)| **lit).map(|(k, _)| f64::from(k - 1.0).abs());
        let least = (1.0 - RIM_DEVIATIONS * median(off()) / MAD_OF_NORMAL) as f32;
        let mut open: Vec<(usize, usize)> =
            self.blind.indexed_iter().filter(|(_, blind)| **blind).map(|(at, _)| at).collect();
        while let Some((y, x)) = open.pop() {
            for b in y.saturating_sub(1)..(y + 2).min(rows) {
                for a in x.saturating_sub(1)..(x + 2).min(columns) {
                    let at = (b, a);
                    if !self.blind[at] && (!self.lit[at] || response[at] < least) {
                        (self.blind[at], self.lit[at]) = (true, false);
                        open.push(at);
                    }
                }
            }
        }
        self
    }

    /// Returns the ranges of the lit rows and columns if the blind pixels are whole rows and columns at the
    /// edges; `None` for other shapes.
    pub fn frame(&self) -> Option<[std::ops::Range<usize>; 2]> {
        let line = |axis: usize| {
            let whole: Vec<bool> = self.blind.axis_iter(Axis(axis)).map(|l| l.iter().all(|b| *b)).collect();
            let from = whole.iter().position(|w| !w)?;
            let to = whole.iter().rposition(|w| !w)? + 1;
            Some(from..to)
        };
        let (rows, columns) = (line(0)?, line(1)?);
        let inside = self.blind.slice(s![rows.clone(), columns.clone()]);
        inside.iter().all(|b| !b).then_some([rows, columns])
    }

    /// Number of pixels with light.
    pub fn lit_pixels(&self) -> usize {
        self.lit.iter().filter(|l| **l).count()
    }

    /// Number of blind pixels.
    pub fn blind_pixels(&self) -> usize {
        self.blind.iter().filter(|b| **b).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A circle, a black reference, a dead column and a dead pixel: only unlit pixels among unlit ones are
    /// blind.
    #[test]
    fn blind_pixels_are_told_from_dead_ones() {
        let mut image = Array2::from_shape_fn((64, 80), |(y, x)| {
            let off = (y as f32 - 31.5).hypot(x as f32 - 39.5);
            if off < 36.0 { 1000.0 - 0.3 * off * off } else { 0.4 }
        });
        image.slice_mut(s![.., 40]).fill(-1.0);
        image[(20, 20)] = 0.0;
        let light = Lit::of(&[image]);
        assert!(light.blind[(0, 0)] && light.blind[(63, 79)] && !light.lit[(0, 0)]);
        assert!(!light.lit[(30, 40)] && !light.blind[(30, 40)], "a dead column");
        assert!(!light.lit[(20, 20)] && !light.blind[(20, 20)], "a dead pixel");
        assert!(light.lit[(31, 8)] && light.lit[(31, 70)], "the dim rim of the circle");
        let mut black = Array2::from_elem((40, 50), 300.0f32);
        black.slice_mut(s![.., ..4]).fill(0.2);
        let light = Lit::of(&[black]);
        assert_eq!(light.blind.iter().filter(|b| **b).count(), 4 * 40);
    }

    #[test]
    fn edges_are_a_frame_and_a_circle_is_none() {
        let mut image = Array2::from_elem((40, 50), 300.0f32);
        image.slice_mut(s![.., 45..]).fill(0.2);
        assert_eq!(Lit::of(&[image.clone()]).frame(), Some([0..40, 0..45]));
        image.slice_mut(s![..10, ..10]).fill(0.0);
        assert_eq!(Lit::of(&[image]).frame(), None);
    }

    /// A rim of a few pixels is blind too; a dim pixel elsewhere is not.
    #[test]
    fn the_rim_goes_with_the_circle() {
        let off = |y: usize, x: usize| (y as f32 - 31.5).hypot(x as f32 - 31.5);
        let noise = |y: usize, x: usize| 0.01 * (((y * 7 + x * 13) % 11) as f32 / 5.0 - 1.0);
        let image = Array2::from_shape_fn((64, 64), |(y, x)| {
            (1.0 + noise(y, x)) * ((30.0 - off(y, x)) / 4.0).clamp(0.0, 1.0)
        });
        let mut light = Lit::of(&[image.mapv(|v| 1000.0 * v)]);
        assert!(light.lit[(31, 4)], "on the rim");
        light = light.with_rim(&image);
        assert!(light.blind[(31, 4)] && !light.blind[(31, 8)] && light.lit[(20, 20)]);
    }
}
