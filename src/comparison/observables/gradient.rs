//! Variance of the gradient and the curvature of frames down the rows and across the columns, DN^2: it shows
//! if the common noise of whole frames differs across the field.
//!
//! Each value is the mean product of a frame's deviations with a cosine of mean square 1 (half a turn or one
//! turn over all lines). For independent pixels it has the variance of the frame's mean.

use super::expect::{FIELD, line_mean};
use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature};
use crate::statistics::layout::Layout;
use crate::statistics::lines::Lines;
use radcam_sim::predict::{SHAPES, cosine, cosine_power};

/// Scatter of the shape of the frames.
#[derive(Debug)]
pub struct Gradient;

/// Half turns of each cosine.
pub(super) const HALF_TURNS: [u32; SHAPES] = [1, 2];
/// Share of the variance of a moving level that may differ from the field (a named choice).
const UNLIKE: f64 = 0.3;

/// Returns the mean product of line values with the cosine of this number of half turns, of mean square 1.
pub(super) fn product(lines: impl ExactSizeIterator<Item = f64>, halves: u32) -> f64 {
    let n = lines.len().max(1);
    lines.enumerate().map(|(y, v)| v * cosine(halves, y, n)).sum::<f64>() / n as f64
}

impl Statistic for Gradient {
    fn id(&self) -> &'static str {
        "variance of frame gradients"
    }

    fn name(&self, index: usize) -> String {
        let shape = if index.is_multiple_of(SHAPES) { "gradient" } else { "curvature" };
        let along = if index < SHAPES { "down the rows" } else { "across the columns" };
        format!("variance of the frames' {shape} {along}")
    }

    fn meaning(&self, _: usize) -> &'static str {
        "the field of a frame tilts or bends from frame to frame"
    }

    fn unit(&self) -> &'static str {
        "DN^2"
    }

    fn only_judges(&self) -> bool {
        true
    }

    fn sums(&self, _: &Layout) -> usize {
        2 * SHAPES
    }

    fn add(&self, _: &[f32], lines: &Lines, layout: &Layout, sums: &mut [f64]) {
        let (rows, columns) = sums.split_at_mut(SHAPES);
        for ((row, column), halves) in rows.iter_mut().zip(columns).zip(HALF_TURNS) {
            *row += product(lines.row_means().iter().map(|v| f64::from(*v)), halves).powi(2);
            *column += product(lines.column_means(layout).map(f64::from), halves).powi(2);
        }
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        chunk.sums().iter().enumerate().for_each(|(k, sum)| put.put(k, *sum, 0.0));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 0.0, 1.0) };
        let (rows, columns) = view.all.campaign.shape;
        let (rows, columns) = (rows as f64, columns as f64);
        let (of_rows, halves) = (o.index < SHAPES, HALF_TURNS[o.index % SHAPES]);
        let pixels = s.shot.of_mean() * view.left.0 + s.read.of_mean() * view.left.1;
        let (lines, ripples) = if of_rows {
            let ripple =
                |(v, ripple): &(f64, radcam_sim::predict::Ripple)| v * ripple.with_cosine(halves, rows);
            (s.row.of_mean() / rows, s.ripples.iter().map(ripple).sum::<f64>())
        } else {
            (s.column.of_mean() / columns, 0.0)
        };
        let line = |&(v, along, down): &(f64, f64, f64)| {
            if of_rows {
                v * line_mean(along, columns) * cosine_power(halves, rows, down)
            } else {
                v * line_mean(down, rows) * cosine_power(halves, columns, along)
            }
        };
        let interference: f64 = s.lines.iter().map(line).sum();
        // A light that changes as a whole changes the field in proportion.
        let field = view.all.field.shapes[o.index].powi(2);
        let lit = view.at.is_some_and(|set| view.all.campaign.sets[set].light.is_some());
        let moved = if lit { view.moved * field } else { 0.0 };
        let light = view.with_light * field;
        let shapes = if of_rows { s.fields.down } else { s.fields.across };
        let own = lines + ripples + interference + shapes[o.index % SHAPES];
        let value = pixels / o.pixels + own + light + moved;
        let single = in_quadrature(&[s.unsure_var, s.unsure_own, view.rough.1]) / o.pixels;
        // If the scatter of the light is added to noise, a square scatters by both.
        Expected::of_few(o, value + 1e-9, view.dof).unsure(in_quadrature(&[
            single,
            2.0 * FIELD * light,
            moved,
            UNLIKE * view.moving,
        ]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tilt is a gradient without curvature; a bowl is the reverse.
    #[test]
    fn a_tilt_and_a_bowl_are_told_apart() {
        let at = |y: u32| (f64::from(y) + 0.5) / 50.0 - 1.0;
        let tilt = HALF_TURNS.map(|halves| product((0..100).map(|y| at(y as u32)), halves));
        let bowl = HALF_TURNS.map(|halves| product((0..100).map(|y| at(y as u32).powi(2)), halves));
        assert!(tilt[0].abs() > 0.5 && tilt[1].abs() < 1e-9, "{tilt:?}");
        assert!(bowl[1].abs() > 0.2 && bowl[0].abs() < 1e-9, "{bowl:?}");
    }
}
