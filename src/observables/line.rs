//! Variance in the strongest line of the noise's spectrum in read-out order, DN^2.

use super::{Expected, HalfView, Observable, Put, Statistic, View};

/// The line.
#[derive(Debug)]
pub struct This;

impl Statistic for This {
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
        // The same in all sets, but where clipping takes of it.
        let of_sets = view.prediction.sets.iter().map(|s| s.lines.iter().map(|l| l.0).sum::<f64>());
        let line = of_sets.fold(0.0, f64::max);
        Expected::plain(o, line, o.measured.std_err)
    }
}
