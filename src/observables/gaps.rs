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
        // Codes whose lowest bits are all set, so many and no more, have one width.
        let kinds: Vec<(f64, f64)> = (0..u16::BITS)
            .map(|bits| {
                let (first, apart) = ((1u32 << bits) - 1, 1u32 << (bits + 1));
                let below = |end: u32| end.saturating_sub(first).div_ceil(apart);
                let share = f64::from(below(codes.end) - below(codes.start)) / codes.len().max(1) as f64;
                (view.width(first), share)
            })
            .collect();
        let share = |width: f64| kinds.iter().filter(|k| k.0 <= width).map(|k| k.1).sum::<f64>();
        // Weights of bits are known to some tenths of a step: narrow codes may be none, and those that are none narrow ones.
        let unsure = share(NARROW) - 0.5 * share(0.0);
        Expected::plain(o, share(0.0), o.measured.std_err.hypot(unsure))
    }
}

/// Width of a code that may be none, in steps.
const NARROW: f64 = 0.3;
