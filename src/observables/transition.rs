//! Codes just below a transition of the high bits against their neighbours, relative: how often they occur.

use super::{Expected, HalfView, Observable, Put, Statistic, View};

/// The excess; the index is the code above the transition.
#[derive(Debug)]
pub struct This;

impl Statistic for This {
    fn id(&self) -> &'static str {
        "occupancy at transitions"
    }

    fn name(&self, _: usize) -> String {
        "occupancy at transitions of high bits".into()
    }

    fn meaning(&self, _: usize) -> &'static str {
        "in the codes, by their bits"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        half.codes.transitions().for_each(|(code, v)| put.put(code, v.value, v.std_err));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let code = o.index.max(2) as u32;
        let value = if view.even_codes() {
            0.0
        } else {
            // Of the mean of the three, as it is measured.
            let (own, beside) = (view.width(code - 1), 0.5 * (view.width(code - 2) + view.width(code)));
            (own - beside) / f64::max(0.5 * (own + beside), 1e-9)
        };
        // Where codes are left out by a table that follows the level, which of them is not predicted.
        let table = if view.all_codes() { 0.0 } else { 2.0 };
        Expected::plain(o, value, o.measured.std_err.hypot(table))
    }
}
