//! Share of single codes that never occur, between codes that do: codes multiplied after conversion, or sent
//! through a table.

use super::codes::Filled;
use super::{Expected, HalfView, Observable, Put, Statistic, View, in_quadrature};

/// Share of missing codes. Index 0 is that of all codes, the others are bands of codes.
#[derive(Debug)]
pub struct Gaps;

impl Statistic for Gaps {
    fn id(&self) -> &'static str {
        "single codes left out"
    }

    fn name(&self, index: usize) -> String {
        if index == 0 { self.id().into() } else { "single codes left out, by level".into() }
    }

    fn meaning(&self, _: usize) -> &'static str {
        "single codes that never occur, as after a multiplication of the codes"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        let of_all = half.codes.gaps().map(|v| (0, v));
        let of_bands = half.codes.gaps_of_bands().map(|(band, v)| (1 + band, v));
        of_all.into_iter().chain(of_bands).for_each(|(index, v)| put.put(index, v.value, v.std_err));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let step = view.prediction.code_step_dn;
        if step > 1.0 && step < 2.0 {
            let (share, error) = share_of([(1.0, step, 0.0)].into_iter(), 2.0 * o.measured.std_err);
            return Expected::plain(o, share, o.measured.std_err.hypot(error));
        }
        if step > 1.0 {
            return Expected::plain(o, 0.0, 1.0);
        }
        let seen = &view.all.codes[o.half.place()];
        if !view.all_codes() {
            return of_table(o, view, seen);
        }
        if view.even_codes() {
            return Expected::plain(o, 0.0, o.measured.std_err);
        }
        let codes = seen.range_of(o.index, view.all.campaign.full_scale_dn as usize + 1);
        // Codes with exactly this number of lowest bits set have one width.
        let kinds: Vec<(f64, f64)> = (0..u16::BITS)
            .map(|bits| {
                let (first, apart) = ((1u32 << bits) - 1, 1u32 << (bits + 1));
                let below = |end: u32| end.saturating_sub(first).div_ceil(apart);
                let share = f64::from(below(codes.end) - below(codes.start)) / codes.len().max(1) as f64;
                (view.width(first), share)
            })
            .collect();
        let share = |width: f64| kinds.iter().filter(|k| k.0 <= width).map(|k| k.1).sum::<f64>();
        // Weights of bits are known to some tenths of a step: a narrow code may be missing, and a missing
        // code may be narrow.
        let unsure = share(NARROW) - 0.5 * share(0.0);
        Expected::plain(o, share(0.0), o.measured.std_err.hypot(unsure))
    }
}

/// Width below which a code may be missing, in steps.
const NARROW: f64 = 0.3;
/// Difference between the steps of neighbouring levels, in codes, above which a table has a knee; the steps
/// of a square root differ by some tenths.
const KNEE: f64 = 0.5;

/// Returns the share of missing codes between occurring ones, for steps of q = 1 + f codes. A share f of the
/// steps is of two codes and the rest of one, in the most even order: rounded multiples of q are a Sturmian
/// word (Lothaire 2002, Algebraic Combinatorics on Words, section 2.1.2). For f < 1/2 no two steps of two are
/// neighbours: f codes are missing for each step, and two steps of one follow each other 1 - 2 f times. From
/// 1/2 on no two steps of one do.
fn left_out(q: f64) -> f64 {
    let f = q - 1.0;
    if f < 0.5 { f / (1.0 - f) } else { 1.0 }
}

/// Returns the share of missing single codes over some parts, with its error. `parts`: the codes of each, the
/// step there, and the difference between the steps around it. `one`: share of a single code.
fn share_of(parts: impl Iterator<Item = (f64, f64, f64)>, one: f64) -> (f64, f64) {
    let (mut single, mut all, mut open) = (0.0, 0.0, 0.0);
    for (codes, q, apart) in parts {
        if apart > KNEE || q > 2.0 + KNEE {
            // A knee lies somewhere between; steps of three codes leave out no single ones.
            open += codes;
        } else {
            single += codes * left_out(q);
            all += codes;
        }
    }
    let share = if all > 0.0 { single / all } else { 0.0 };
    let of_knee = if open > 0.0 { open / (all + open) } else { 0.0 };
    // Steps between levels are known to a twentieth. Their start adds or removes one code; if few are
    // missing, their number scatters as by chance.
    let of_ends = one * (share / one).min(1.0).sqrt();
    (share, in_quadrature(&[0.05 * share, of_ends, of_knee]))
}

/// Returns the expectation for a table whose steps grow with the level.
fn of_table(o: &Observable, view: &View<'_>, seen: &Filled) -> Expected {
    let offset_dn = view.prediction.base.offset_dn;
    let mut steps: Vec<(f64, f64)> =
        (view.prediction.sets.iter()).map(|s| (s.signal + offset_dn, 1.0 / s.codes_used.max(1e-3))).collect();
    steps.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Step at a level, and the difference between the steps of the levels around it.
    let step = |level: f64| {
        let after = steps.partition_point(|s| s.0 < level);
        let (Some(b), Some(a)) = (steps.get(after).or(steps.last()), steps.get(after.saturating_sub(1)))
        else {
            return (1.0, 0.0);
        };
        let part = if b.0 > a.0 { ((level - a.0) / (b.0 - a.0)).clamp(0.0, 1.0) } else { 0.0 };
        (a.1 + part * (b.1 - a.1), (b.1 - a.1).abs())
    };
    let full = view.all.campaign.full_scale_dn + 1.0;
    let parts = seen.parts(o.index).map(|(place, codes)| {
        let (q, apart) = step(place * full);
        (codes, q, apart)
    });
    let (share, error) = share_of(parts, 2.0 * o.measured.std_err);
    Expected::plain(o, share, o.measured.std_err.hypot(error))
}

#[cfg(test)]
mod tests {
    use super::super::codes::gaps;
    use super::share_of;

    /// Rounded tables of even steps and of square roots leave out the expected share, within its error.
    #[test]
    fn tables_leave_out_what_is_expected() {
        let (mut squares, mut tables) = (0.0, 0.0);
        for k in 0..2000u32 {
            let random = |n: u32| f64::from((k * 4 + n).wrapping_mul(2_654_435_761)) / 4_294_967_296.0;
            let (from, length) = (1000.0 * random(0), 200 + (3000.0 * random(1)) as u32);
            // Steps at the first and at the last code.
            let first = 1.0 + 0.3 * random(2);
            let last = if k % 2 == 0 { first } else { first + 0.2 * random(3) };
            let step = |part: f64| (first * first + (last * last - first * first) * part).sqrt();
            let mut counts = vec![0u64; 8192];
            let mut level = from;
            (0..length).for_each(|c| {
                counts[level.round() as usize] = 500;
                level += step(f64::from(c) / f64::from(length));
            });
            let found = gaps(&counts).unwrap();
            let parts = (0..16).map(|part| (1.0, step((f64::from(part) + 0.5) / 16.0), 0.0));
            let (share, error) = share_of(parts, 2.0 * found.std_err);
            let z = (found.value - share) / found.std_err.hypot(error);
            assert!(
                z.abs() < 3.5,
                "step {first:.4} to {last:.4}, {length} codes: {found:?}, {share} +- {error}"
            );
            (squares, tables) = (squares + z * z, tables + 1.0);
        }
        // An error ten times too large would say nothing.
        let rms = f64::sqrt(squares / tables);
        assert!((0.1..1.0).contains(&rms), "{rms}");
    }
}
