//! Which pixels of a sensor count, and where they lie.

use super::covariance::Covariance;
use super::jackknife::Blocks;
use ndarray::Array2;

/// Which pixels count, and what is known of them: the same for all sets of a campaign.
#[derive(Debug)]
pub struct Layout {
    /// Rows and columns.
    pub shape: (usize, usize),
    /// 1 for a pixel that counts, row by row.
    pub mask: Vec<f32>,
    /// How many count, in all.
    pub pixels: f64,
    /// In each row, in each column.
    pub row_pixels: Vec<f32>,
    /// See `row_pixels`.
    pub column_pixels: Vec<f32>,
    /// The pixels' level without light, DN, where it is known.
    pub zero: Option<Vec<f32>>,
    /// Growth of a pixel's variance with its signal, DN: brighter pixels are not taken for unequal ones.
    pub gain: f64,
    pub(super) full_scale_dn: u16,
    pub(super) pairs: Covariance,
}

impl Layout {
    /// For frames of the shape of `used` (rows, columns).
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
        // Pairs of pixels that count are the products of the mask.
        let mut pairs = Covariance::new(used.dim());
        (0..layout.shape.0).for_each(|y| pairs.add_row(y, &layout.mask));
        layout.pairs = pairs;
        layout
    }

    /// Columns.
    pub fn columns(&self) -> usize {
        self.shape.1
    }

    /// Every run of pixels of a row that lies within one block: their places, how many of them count, and the block.
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
