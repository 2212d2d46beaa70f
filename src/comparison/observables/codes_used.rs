//! Share of occurring codes within the range of the campaign.

use super::{Expected, HalfView, Observable, Put, Statistic, View};

/// Share of occurring codes.
#[derive(Debug)]
pub struct CodesUsed;

impl Statistic for CodesUsed {
    fn id(&self) -> &'static str {
        "share of codes that occur"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "unequal codes, by their bits"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        if let Some(v) = half.codes.used() {
            put.put(0, v.value, v.std_err);
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let step = view.prediction.code_step_dn.max(1.0);
        // If steps grow with the level, the average over the levels is expected.
        let flats =
            view.prediction.sets.iter().zip(&view.all.campaign.sets).filter(|(_, s)| s.light.is_some());
        let (sum, n) = flats.fold((0.0, 0.0), |(sum, n), (s, _)| (sum + s.codes_used, n + 1.0));
        let used = if n > 0.0 { sum / n } else { 1.0 };
        // The model knows only roughly which levels fill which part of the range.
        Expected::plain(o, used / step, o.measured.std_err.hypot(0.5 * (1.0 - used)))
    }
}
