//! Spatial nonuniformities: DSNU and PRNU with their rows, columns and pixels.

use super::Definitions;
use super::filter::HighPass;
use super::points::{Spatial, line_means};
use super::value::{Inputs, Value};
use ndarray::Array2;
use rayon::prelude::*;
use std::borrow::Cow;

/// Variances of one image.
#[derive(Debug, Clone)]
pub(super) struct Variances {
    pub measured: Value,
    pub stack: Value,
    pub columns_of_means: Value,
    pub rows_of_means: Value,
    pub whole: Value,
    pub column: Value,
    pub row: Value,
    pub pixel: Value,
}

impl Definitions {
    /// Filter before nonuniformities.
    pub(super) fn high_pass(self) -> HighPass {
        match self {
            Self::Release4 => HighPass::Two,
            Self::Release31 => HighPass::Box5,
            Self::ReferenceTool => HighPass::None,
        }
    }
}

/// Returns the image that nonuniformities are computed from; unfiltered if the image is smaller than the
/// filter.
pub(super) fn filtered(image: &Array2<f64>, definitions: Definitions) -> (Cow<'_, Array2<f64>>, HighPass) {
    let wanted = definitions.high_pass();
    let found = if wanted == HighPass::None { None } else { wanted.apply(image) };
    found.map_or((Cow::Borrowed(image), HighPass::None), |filtered| (Cow::Owned(filtered), wanted))
}

/// Splits the variance of a mean image (release 4.0 Linear, eq. 35 to 44).
///
/// With A and B the variances of column and row means, T that of all pixels and c the filter's gains for
/// white nonuniformity (lines c1, pixels c2): A = c1 (s_col^2 + p / M), B = c1 (s_row^2 + p / N), T = c1
/// (s_row^2 + s_col^2) + c2 p, where p = s_pixel^2 + sigma^2 / L. Without a filter both gains are 1, and the
/// solution is eq. (44). The standard's text has no gains, which would make DSNU and PRNU of pixels 0.5 % and
/// those of lines 5 % too low. A, B and the pixels' own part are independent, with the errors of variances of
/// N, M and M N values.
pub(super) fn variances(
    stack: &Spatial,
    image: &Array2<f64>,
    filter: HighPass,
    definitions: Definitions,
    inputs: &mut Inputs,
) -> Variances {
    let (m, n) = (image.nrows() as f64, image.ncols() as f64);
    let gains = filter.gains();
    let frames = stack.frames as f64;
    let temporal = stack.stack_var_dn2;
    let mean = image.mean().unwrap_or(f64::NAN);
    let spread = |means: &[f64]| means.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / means.len() as f64;
    let [row_means, column_means] = line_means(image);
    // Release 4.0 divides by M N (eq. 35), the releases before by M N - 1.
    let denominator = if definitions == Definitions::Release4 { m * n } else { m * n - 1.0 };
    // Pieces are computed in parallel and summed in order: the same bits in every run.
    let of_piece = |piece: &[f64]| piece.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
    let image = image.as_standard_layout();
    let pieces: Vec<f64> = image.as_slice().unwrap_or_default().par_chunks(1 << 14).map(of_piece).collect();
    let total = pieces.iter().sum::<f64>() / denominator;
    let (a, b) = (spread(&column_means) / gains.lines, spread(&row_means) / gains.lines);
    let lines = gains.lines * (a + b);
    let p = (total - lines) / (gains.pixels - gains.lines * (1.0 / m + 1.0 / n));
    let of =
        |inputs: &mut Inputs, value: f64, count: f64| inputs.value(value, value.abs() * (2.0 / count).sqrt());
    let (a, b, p) = (of(inputs, a, n), of(inputs, b, m), of(inputs, p, m * n));
    let pixels_of_stack = stack.sum_dn.len() as f64;
    let stack_value = inputs.value(temporal, temporal * (2.0 / (pixels_of_stack * (frames - 1.0))).sqrt());
    let noise = temporal / frames;
    let measured = Value::of(&[&a, &b, &p], |v| {
        gains.lines * (v[0] + v[1] - v[2] * (1.0 / m + 1.0 / n)) + gains.pixels * v[2]
    });
    Variances {
        measured,
        stack: stack_value,
        columns_of_means: Value::of(&[&a], |v| v[0] - noise / m),
        rows_of_means: Value::of(&[&b], |v| v[0] - noise / n),
        whole: Value::of(&[&a, &b, &p], |v| v[0] - v[2] / m + v[1] - v[2] / n + v[2] - noise),
        column: Value::of(&[&a, &p], |v| v[0] - v[1] / m),
        row: Value::of(&[&b, &p], |v| v[0] - v[1] / n),
        pixel: Value::of(&[&p], |v| v[0] - noise),
    }
}
