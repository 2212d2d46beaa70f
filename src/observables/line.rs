//! Variance in the strongest line of the noise's spectrum in read-out order, DN^2.

use crate::statistics::spectrum::Power;

use super::{Expected, HalfView, Observable, Put, Statistic, View};

/// The line.
#[derive(Debug)]
pub struct Line;

impl Statistic for Line {
    fn id(&self) -> &'static str {
        "line in the spectrum"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "at one frequency"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        if let Some(v) = half.line {
            put.put(0, v.value, v.std_err);
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        // A line elsewhere is not the one that was measured: its place is known to a part of a bin of the spectrum.
        let (seen, bins) =
            (view.all.campaign.line_cycles_per_px, Power::length(view.all.campaign.shape) as f64);
        let here = |across: f64| {
            let away = seen.map_or(0.0, |seen| (across / std::f64::consts::TAU - seen) * bins);
            (-0.5 * away * away).exp()
        };
        // The same in all sets, but where clipping takes of it.
        let of_sets =
            view.prediction.sets.iter().map(|s| s.lines.iter().map(|l| l.0 * here(l.1)).sum::<f64>());
        let line = of_sets.fold(0.0, f64::max);
        Expected::plain(o, line, o.measured.std_err)
    }
}
