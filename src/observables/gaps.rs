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
        // Which codes steps or a table leave out is the business of other statistics.
        if !view.all_codes() || view.prediction.code_step_dn > 1.0 {
            return Expected::plain(o, 0.0, 1.0);
        }
        if view.even_codes() {
            return Expected::plain(o, 0.0, o.measured.std_err);
        }
        let codes = &view.all.codes[o.half.place()];
        let share = |width: f64| {
            codes.clone().filter(|c| view.width(*c) <= width).count() as f64 / codes.len().max(1) as f64
        };
        // Weights of bits are known to some tenths of a step: narrow codes may be none, and those that are none narrow ones.
        let unsure = share(NARROW) - 0.5 * share(0.0);
        Expected::plain(o, share(0.0), o.measured.std_err.hypot(unsure))
    }
}

/// Width of a code that may be none, in steps.
const NARROW: f64 = 0.3;
