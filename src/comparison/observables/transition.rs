//! Relative excess in occurrence of the codes just below a transition of the high bits over their neighbours.

use radcam_sim::predict::Prediction;

use super::{Expected, HalfView, Observable, Put, Statistic, View, in_quadrature};

/// Excess of the code; the index is the code above the transition.
#[derive(Debug)]
pub struct Transition;

impl Statistic for Transition {
    fn id(&self) -> &'static str {
        "occupancy at transitions"
    }

    fn name(&self, _: usize) -> String {
        "occupancy at transitions of high bits".into()
    }

    fn meaning(&self, _: usize) -> &'static str {
        "unequal codes, by their bits"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        half.codes.transitions().for_each(|(code, v)| put.put(code, v.value, v.std_err));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let code = o.index.max(2) as u32;
        let value = if view.even_codes() {
            0.0
        } else {
            // Relative to the mean of the three, as it is measured.
            let (own, beside) = (view.width(code - 1), 0.5 * (view.width(code - 2) + view.width(code)));
            (own - beside) / f64::max(0.5 * (own + beside), 1e-9)
        };
        // Firmware that moves half of a share m of the samples up by a code and half down changes counts n to
        // (1 - m) n + m (n of the next lower + n of the next higher code) / 2: 1 - 3 m / 2 of the excess of
        // one code over both neighbours is left. Less is left if some samples move by several codes: the
        // error for that is m / 2 of the excess.
        let moved = if view.moves_samples() { moved_at(f64::from(code), view.prediction) } else { 0.0 };
        let (value, smeared) = (value * (1.0 - 1.5 * moved).max(0.0), 0.5 * moved * value);
        // If a table that follows the level leaves out codes, it is not predicted which ones.
        let table = if view.all_codes() { 0.0 } else { 2.0 };
        let piled = of_full_wells(f64::from(code) - 1.0, view.prediction);
        Expected::plain(o, value, in_quadrature(&[o.measured.std_err, smeared, table, piled]))
    }
}

/// Returns the share of the samples that are moved by whole codes at the level nearest to a code.
fn moved_at(code: f64, p: &Prediction) -> f64 {
    let apart = |signal: f64| (signal + p.base.offset_dn - code).abs();
    let next = p.sets.iter().min_by(|a, b| apart(a.signal).total_cmp(&apart(b.signal)));
    next.map_or(0.0, |s| s.moved)
}

/// Returns the maximum relative excess of a code over its neighbours if pixels at full well pile up. Such
/// pixels differ by read noise alone: half the relative second difference of a normal density of deviation s
/// is (x^2 - 1) / 2 s^2 at x deviations.
fn of_full_wells(code: f64, p: &Prediction) -> f64 {
    const DEVIATIONS: f64 = 4.5;
    let well_dn = p.base.gain_dn_per_e * p.well_e;
    let deviation_dn = (p.base.gain_dn_per_e * p.base.read_noise_e).hypot(1.0 / 12f64.sqrt());
    let apart_dn = (code - p.base.offset_dn - well_dn).abs();
    // A fit determines a well to some tenths of a per cent.
    let near = apart_dn < DEVIATIONS * deviation_dn + 0.003 * well_dn;
    if near { (0.5 * (DEVIATIONS / deviation_dn).powi(2)).min(2.0) } else { 0.0 }
}
