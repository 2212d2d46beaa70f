//! Relative excess in occurrence of codes just before a low bit is set over those just before it is cleared.

use super::codes::{LOW_BITS, occupancy_of};
use super::{Expected, HalfView, Observable, Put, Statistic, View, in_quadrature};

/// Excess for each of the low bits.
#[derive(Debug)]
pub struct Occupancy;

impl Statistic for Occupancy {
    fn id(&self) -> &'static str {
        "occupancy of codes"
    }

    fn name(&self, index: usize) -> String {
        format!("occupancy of codes, bit {index}")
    }

    fn meaning(&self, _: usize) -> &'static str {
        "unequal codes, by their bits"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        for b in 0..LOW_BITS {
            if let Some(v) = half.codes.bit(b) {
                put.put(b, v.value, v.std_err);
            }
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let codes = &view.all.codes[o.half.place()].bits;
        let value = if view.even_codes() { 0.0 } else { occupancy_of(&|c| view.width(c), codes, o.index) };
        let table = if view.all_codes() { 0.0 } else { of_table(view, codes.len() as f64, o.index) };
        Expected::plain(o, value, in_quadrature(&[o.measured.std_err, table]))
    }
}

/// Minimum share of codes that a table leaves out or doubles (a named choice: it doubles codes where its step
/// is below 1).
const MIN_IRREGULAR: f64 = 0.1;
/// Maximum share of codes left out between codes that occur, and minimum difference of the share between
/// levels, for codes without a regular order (named choices).
const IRREGULAR: (f64, f64) = (0.5, 0.02);
/// Standard deviation with a regular order: all codes of one kind may be left out.
const REGULAR: f64 = 2.0;
/// Margin of the scatter below: levels cover a part of the codes (a named choice).
const MARGIN: f64 = 2.0;

/// Returns the standard deviation of the occupancy of a bit under a table that follows the level. It is not
/// predicted which codes it leaves out: each is one less in its kind of codes, or half of one more in that of
/// its neighbours.
fn of_table(view: &View<'_>, codes: f64, bit: usize) -> f64 {
    let left_out = |used: f64| (1.0 / used.max(0.1) - 1.0).abs();
    let shares = || view.prediction.sets.iter().map(|s| left_out(s.codes_used));
    let (least, most) = shares().fold((f64::INFINITY, 0.0f64), |(a, b), s| (a.min(s), b.max(s)));
    if most > IRREGULAR.0 || most - least < IRREGULAR.1 {
        return REGULAR;
    }
    let share = shares().sum::<f64>() / (view.prediction.sets.len() as f64).max(1.0);
    let of_kind = codes / f64::from(2u32 << bit);
    (MARGIN * (3.0 * share.max(MIN_IRREGULAR) / of_kind.max(1.0)).sqrt()).min(REGULAR)
}
