//! Variance of the difference between the halves of a frame, DN^2: upper and lower, left and right. It shows
//! if the sensor is read and lit as one.

use super::{ChunkView, Expected, Observable, Put, Statistic, View};
use crate::statistics::layout::Layout;
use crate::statistics::lines::Lines;

/// Difference of the halves: of rows, then of columns.
#[derive(Debug)]
pub struct Halves;

/// Returns the mean of the second half of some numbers minus that of the first; a line in the middle belongs
/// to neither.
fn difference(values: impl ExactSizeIterator<Item = f32>) -> f64 {
    let (n, half) = (values.len(), values.len() / 2);
    let of = |(i, v): (usize, f32)| match i {
        i if i < half => -f64::from(v),
        i if i >= n - half => f64::from(v),
        _ => 0.0,
    };
    values.enumerate().map(of).sum::<f64>() / half.max(1) as f64
}

impl Statistic for Halves {
    fn id(&self) -> &'static str {
        "difference of halves"
    }

    fn name(&self, index: usize) -> String {
        format!("variance of {}", ["lower less upper half", "right less left half"][index.min(1)])
    }

    fn meaning(&self, _: usize) -> &'static str {
        "halves of the sensor that scatter independently from frame to frame"
    }

    fn unit(&self) -> &'static str {
        "DN^2"
    }

    fn sums(&self, layout: &Layout) -> usize {
        if layout.shape.0.min(layout.shape.1) < 16 { 0 } else { 2 }
    }

    fn add(&self, _: &[f32], lines: &Lines, layout: &Layout, sums: &mut [f64]) {
        let rows = difference(lines.row_means().iter().copied());
        let columns = difference(lines.column_means(layout));
        sums[0] += rows * rows;
        sums[1] += columns * columns;
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        chunk.sums().iter().enumerate().for_each(|(k, sum)| put.put(k, *sum, 0.0));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 0.0, 1.0) };
        let (rows, columns) = view.all.campaign.shape;
        let pixels = s.shot.of_mean() * view.left.0 + s.read.of_mean() * view.left.1;
        // The mean of a half has twice the variance of the mean of all, and there are two halves.
        let own = 4.0 * pixels / o.pixels;
        let (lines, common) = if o.index == 0 {
            // With V of a half and W of the whole, W = (V + C) / 2: 2 V - 2 C = 4 (V - W).
            let half = s.ripple_with_mean(rows / 2, rows / 2);
            (4.0 * s.row.of_mean() / rows as f64, 4.0 * (half - view.ripple_of_mean).max(0.0))
        } else {
            (4.0 * s.column.of_mean() / columns as f64, 0.0)
        };
        // Noise common to whole frames is proportional to the local light: halves differ by no more than
        // pixels do.
        let field = view.with_light * view.all.field.halves[o.index.min(1)];
        let rest = if s.common > 0.0 { s.common - s.with_light } else { 0.0 };
        let shading = view.all.largest_spread.powi(2) * (rest.max(0.0) + view.moved) + 0.1 * field;
        let interference: f64 = s.lines.iter().map(|l| l.0).sum::<f64>() / (rows.min(columns) as f64);
        let shapes = s.fields.halves(o.index == 0, if o.index == 0 { rows } else { columns });
        Expected::of_few(o, own + lines + common + shapes + field, view.dof)
            .unsure(shading + interference + common)
    }
}

#[cfg(test)]
mod tests {
    use super::difference;
    use radcam_sim::rng::{PixelRng, Stream};

    /// For independent lines the difference of the means of both halves has four times the variance of the
    /// mean of all, within five standard errors over 4000 draws. A line in the middle is in neither half.
    #[test]
    fn halves_differ_by_four_times_the_variance_of_the_mean() {
        let square = |draw: u32| {
            let mut rng = PixelRng::new(3, Stream::Effect, 0, draw, 0);
            let lines: Vec<f32> = (0..96).map(|_| rng.normal() as f32).collect();
            difference(lines.into_iter()).powi(2)
        };
        let variance = (0..4000).map(square).sum::<f64>() / 4000.0;
        let expected = 4.0 / 96.0;
        assert!((variance - expected).abs() < 5.0 * expected * (2.0 / 4000f64).sqrt(), "{variance}");
        assert_eq!(difference([1.0, 1.0, 900.0, 3.0, 3.0].into_iter()), 2.0);
    }
}
