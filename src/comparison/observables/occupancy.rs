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
        let codes = &view.all.codes[o.half.place()].range;
        let value = if view.even_codes() { 0.0 } else { occupancy_of(&|c| view.width(c), codes, o.index) };
        // If a table that follows the level leaves out codes, it is not predicted which ones.
        let table = if view.all_codes() { 0.0 } else { 2.0 };
        Expected::plain(o, value, in_quadrature(&[o.measured.std_err, table]))
    }
}
