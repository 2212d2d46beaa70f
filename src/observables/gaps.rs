//! Share of single codes that never occur, between codes that do: codes multiplied after conversion.

use super::{Expected, HalfView, Observable, Put, Statistic, View};

/// The share.
#[derive(Debug)]
pub struct This;

impl Statistic for This {
    fn id(&self) -> &'static str {
        "single codes left out"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "single codes that never occur, as after a multiplication of the codes"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        if let Some(v) = half.codes.gaps() {
            put.put(0, v.value, v.std_err);
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        // A converter whose codes have at least half a step leaves out none; which ones others leave out is the business of other statistics.
        let regular = view.all_codes()
            && view.prediction.code_step_dn <= 1.0
            && view.prediction.bit_errors_dn.iter().map(|e| e.abs()).sum::<f64>() < 0.5;
        Expected::plain(o, 0.0, o.measured.std_err.hypot(if regular { 0.0 } else { 1.0 }))
    }
}
