//! Steps between parts of the sensor: right and left half, lower and upper half, odd and even columns, odd
//! and even rows. Each has a part in proportion to the signal and a constant part, DN.

use super::{Expected, HalfView, Observable, Put, Statistic, View};
use crate::statistics::taps;

/// Step between parts. The index is twice the number of the parts, plus one for the constant part.
#[derive(Debug)]
pub struct Tap;

impl Statistic for Tap {
    fn id(&self) -> &'static str {
        "step between parts"
    }

    fn name(&self, index: usize) -> String {
        let parts = ["left and right", "top and bottom", "even and odd columns", "even and odd rows"];
        let parts = parts.get(index / 2).unwrap_or(&"parts");
        format!(
            "{parts}, {}",
            if index.is_multiple_of(2) { "in proportion to the signal" } else { "constant" }
        )
    }

    fn meaning(&self, _: usize) -> &'static str {
        "a step between parts of the sensor"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        let (columns, rows) = (half.profiles(|s| &s.columns_dn), half.profiles(|s| &s.rows_dn));
        let kept = [&columns, &rows].map(|profiles| lines_with_pixels(profiles, half.zero_dn));
        let steps = [
            taps::middle(&columns, &kept[0]),
            taps::middle(&rows, &kept[1]),
            taps::odd(&columns, &kept[0]),
            taps::odd(&rows, &kept[1]),
        ];
        for (parts, step) in steps.into_iter().enumerate() {
            for (k, value) in step.into_iter().flatten().enumerate() {
                // The error is the sensor's pattern, which both halves share: together they know no more than
                // one.
                put.put(2 * parts + k, value.value, value.std_err * std::f64::consts::SQRT_2);
            }
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let tap = view.prediction.taps.get(o.index / 2).copied().unwrap_or_default();
        Expected::plain(o, if o.index.is_multiple_of(2) { tap.0 } else { tap.1 }, o.measured.std_err)
    }
}

/// Returns the indices of the lines that have pixels. A line without any has the frame's mean in every
/// profile.
fn lines_with_pixels(profiles: &[(f64, &[f64])], zero_dn: f64) -> Vec<usize> {
    let lines = profiles.first().map_or(0, |p| p.1.len());
    let is_of_frame = |p: &(f64, &[f64]), x: usize| {
        let mean_dn = p.0 + zero_dn;
        (p.1[x] - mean_dn).abs() <= 1e-12 * mean_dn.abs().max(1.0)
    };
    (0..lines).filter(|x| profiles.iter().any(|p| !is_of_frame(p, *x))).collect()
}
