//! High-pass filters that the standard applies before nonuniformities, to exclude uneven light.

use ndarray::{Array2, ArrayView1, Axis, Zip, s};

/// Smoothed image that is subtracted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HighPass {
    /// No filter.
    None,
    /// Release 3.1, appendix C.5: a 5 x 5 box.
    Box5,
    /// Release 4.0 Linear, section 8.1: boxes of 7 x 7 and 11 x 11 and a 3 x 3 binomial, one after the other.
    Two,
}

/// Gains of a filter for the variance of white nonuniformity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Gains {
    /// Gain for pixels that differ individually.
    pub pixels: f64,
    /// Gain for rows, or columns, that differ as a whole.
    pub lines: f64,
}

impl HighPass {
    /// Returns the weights of the smoothing along one axis, at 0, 1, 2... pixels from the middle.
    fn weights(self) -> Vec<f64> {
        let boxed = |n: usize| vec![1.0 / n as f64; n];
        let convolved = |a: &[f64], b: &[f64]| {
            let mut out = vec![0.0; a.len() + b.len() - 1];
            for (i, a) in a.iter().enumerate() {
                for (j, b) in b.iter().enumerate() {
                    out[i + j] += a * b;
                }
            }
            out
        };
        match self {
            Self::None => Vec::new(),
            Self::Box5 => boxed(5).split_off(2),
            Self::Two => convolved(&convolved(&boxed(7), &boxed(11)), &[0.25, 0.5, 0.25]).split_off(9),
        }
    }

    /// Rows and columns excluded at each border, where the filter would look beyond the image (appendix C.5).
    pub fn border(self) -> usize {
        self.weights().len().saturating_sub(1)
    }

    /// Subtracts the smoothed image, and cuts off the borders. `None` if nothing would be left.
    pub fn apply(self, image: &Array2<f64>) -> Option<Array2<f64>> {
        let weights = self.weights();
        let border = self.border();
        let (rows, columns) = image.dim();
        // Lines need at least two pixels for a variance of their means.
        if rows < 2 * border + 2 || columns < 2 * border + 2 {
            return None;
        }
        if weights.is_empty() {
            return Some(image.clone());
        }
        let end = |n: usize| n - border;
        let smoothed = smooth(&smooth(image, &weights).reversed_axes(), &weights).reversed_axes();
        let inner = image.slice(s![border..end(rows), border..end(columns)]);
        Some(&inner - &smoothed)
    }

    /// Computes the gains for white variances: with r the smoothing's weights, 1 - 2 r(0) + sum r^2, in two
    /// dimensions for pixels and in one for lines, which smoothing along them does not change.
    pub fn gains(self) -> Gains {
        let weights = self.weights();
        let Some(middle) = weights.first().copied() else { return Gains { pixels: 1.0, lines: 1.0 } };
        let square = middle * middle + 2.0 * weights[1..].iter().map(|w| w * w).sum::<f64>();
        Gains { pixels: 1.0 - 2.0 * middle * middle + square * square, lines: 1.0 - 2.0 * middle + square }
    }
}

/// Smooths down the columns; rows at the border are cut off.
fn smooth(image: &Array2<f64>, weights: &[f64]) -> Array2<f64> {
    let border = weights.len() - 1;
    let rows = image.nrows() - 2 * border;
    let mut out = Array2::zeros((rows, image.ncols()));
    Zip::indexed(out.rows_mut()).par_for_each(|y, mut row| {
        let at = |k: usize| -> ArrayView1<'_, f64> { image.index_axis(Axis(0), k) };
        row.scaled_add(weights[0], &at(y + border));
        for (k, w) in weights.iter().enumerate().skip(1) {
            row.scaled_add(*w, &at(y + border - k));
            row.scaled_add(*w, &at(y + border + k));
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A slope, as from uneven light, vanishes; white noise keeps the stated gain.
    #[test]
    fn uneven_light_goes_and_noise_stays() {
        let mut state = 7u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f64 / (1u64 << 24) as f64 - 0.5
        };
        let white = Array2::from_shape_fn((300, 400), |_| noise());
        let lines: Vec<f64> = (0..300).map(|_| noise()).collect();
        for filter in [HighPass::Box5, HighPass::Two] {
            let slope = Array2::from_shape_fn((300, 400), |(y, x)| 100.0 + 0.1 * y as f64 - 0.03 * x as f64);
            assert!(filter.apply(&slope).unwrap().iter().all(|v| v.abs() < 1e-9));
            let gains = filter.gains();
            // 112 000 pixels give the variance to 0.4 %, 282 lines to 8 %. Tolerance: three of these.
            let left = filter.apply(&white).unwrap().var(0.0) / white.var(0.0);
            assert!((left / gains.pixels - 1.0).abs() < 0.013, "{filter:?}: {left} {gains:?}");
            let rows = Array2::from_shape_fn((300, 400), |(y, _)| lines[y]);
            let left = filter.apply(&rows).unwrap().var(0.0) / rows.var(0.0);
            assert!((left / gains.lines - 1.0).abs() < 0.25, "{filter:?}: {left} {gains:?}");
        }
        // 1 - 1/25 and 1 - 1/5 of the variance. (Appendix C.5 prints (1 - 1/25)^2, without the contribution
        // of the neighbours.)
        let gains = HighPass::Box5.gains();
        assert!((gains.pixels - 0.96).abs() < 1e-12 && (gains.lines - 0.8).abs() < 1e-12, "{gains:?}");
        assert!(HighPass::Two.apply(&Array2::zeros((19, 40))).is_none());
        assert_eq!((HighPass::Two.border(), HighPass::Box5.border(), HighPass::None.border()), (9, 2, 0));
    }
}
