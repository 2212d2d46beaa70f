//! Mask and geometry of the pixels of a sensor.

use super::covariance::Covariance;
use super::jackknife::Blocks;
use ndarray::Array2;

/// Pixels in use and their known properties, common to all sets of a campaign.
#[derive(Debug)]
pub struct Layout {
    /// Number of rows and columns.
    pub shape: (usize, usize),
    /// 1 for a pixel in use, otherwise 0, row by row.
    pub mask: Vec<f32>,
    /// Number of pixels in use.
    pub pixels: f64,
    /// Number of pixels in use in each row, and in each column.
    pub row_pixels: Vec<f32>,
    /// See `row_pixels`.
    pub column_pixels: Vec<f32>,
    /// Dark level of the pixels, DN, if known.
    pub zero: Option<Vec<f32>>,
    /// Approximate system gain, DN/e: predicts the shot noise of bright pixels, which would otherwise count
    /// as noisier.
    pub gain: f64,
    pub(super) full_scale_dn: u16,
    pub(super) pairs: Covariance,
}

impl Layout {
    /// Creates the layout of frames of the shape of `used` (rows, columns).
    pub fn new(used: &Array2<bool>, full_scale_dn: u16) -> Self {
        let mask: Vec<f32> = used.iter().map(|u| f32::from(*u)).collect();
        let line = |axis: usize| -> Vec<f32> {
            used.lanes(ndarray::Axis(axis))
                .into_iter()
                .map(|l| l.iter().filter(|u| **u).count() as f32)
                .collect()
        };
        let mut layout = Self {
            shape: used.dim(),
            pixels: mask.iter().map(|m| f64::from(*m)).sum(),
            row_pixels: line(1),
            column_pixels: line(0),
            mask,
            zero: None,
            gain: 0.0,
            full_scale_dn,
            pairs: Covariance::new(used.dim()),
        };
        // Products of the mask count the pairs of pixels in use.
        let mut pairs = Covariance::new(used.dim());
        (0..layout.shape.0).for_each(|y| pairs.add_row(y, &layout.mask));
        layout.pairs = pairs;
        layout
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.shape.1
    }

    /// Calls `act` for every run of pixels of a row within one block, with their places, the number in use,
    /// and the block.
    pub fn runs(&self, mut act: impl FnMut(std::ops::Range<usize>, f64, (usize, usize))) {
        let (rows, columns) = self.shape;
        for y in 0..rows {
            let mut from = 0;
            while from < columns {
                let block = Blocks::of(from, columns);
                let to = Blocks::end(block, columns);
                let run = y * columns + from..y * columns + to;
                let count: f32 = self.mask[run.clone()].iter().sum();
                if count > 0.0 {
                    act(run, f64::from(count), (Blocks::of(y, rows), block));
                }
                from = to;
            }
        }
    }
}
