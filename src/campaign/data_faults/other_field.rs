//! Flats with another light field: the lamp, dust or the lens moved, or a cap covers a part. Relative to
//! the mean of its frame, every place has the same light in all flats of one position (Healey and
//! Kondepudy 1994, eq. 22: I(a) is that of the card, up to a factor). Effects of the level alone, a bend
//! or a full well, are a function of the local light, and are removed.

use super::campaign::Zero;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::number::percent;
use crate::statistics::median::median;

/// Minimum number of flats of one position, and of those that stay.
const MIN_FLATS: usize = 4;
const MIN_STAY: usize = 3;
/// Minimum relative change of the light in the two cells that change most, and minimum significance in
/// standard errors (named choices: the field of an undisturbed lamp changes by some tenths of a per
/// cent).
const MIN_CHANGE: f64 = 0.03;
const MIN_SIGMAS: f64 = 8.0;
/// Maximum fraction of the flats that are excluded: with more it is unknown which field is right.
const MAX_SHARE: f64 = 0.34;
/// Minimum signal of a usable flat, relative to the brightest.
const MIN_SIGNAL: f64 = 0.05;

/// Check for another light field.
pub struct OtherField;

/// Light of the cells relative to the mean of the frame, and its standard error.
struct Field {
    set: usize,
    cells: Vec<f64>,
    std: f64,
}

impl Check for OtherField {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_of_one_part()) else { return Vec::new() };
        let mut found = Vec::new();
        for flats in campaign.flats_by_field().into_values() {
            let signal = |i: usize| campaign.sets[i].level_dn() - zero.at(campaign.sets[i].exposure_s);
            let brightest = flats.iter().map(|&i| signal(i)).fold(0.0, f64::max);
            let told = |i: &usize| {
                let set = &campaign.sets[*i];
                !set.clipped && !set.is_cut_off() && signal(*i) > MIN_SIGNAL * brightest
            };
            let fields: Vec<Field> =
                flats.iter().filter(|i| told(i)).filter_map(|&i| field(campaign, &zero, i)).collect();
            let Some((changed, most)) = changed(&fields) else { continue };
            let stay = fields.len() - changed.len();
            let left_out = changed.len() as f64 <= MAX_SHARE * fields.len() as f64 && stay >= MIN_STAY;
            found.push((changed, most, left_out));
        }
        let fault = |(sets, most, left_out): (Vec<usize>, f64, bool)| {
            let text = format!(
                "{}: the light falls on other places than in the other flats of this position, by up to {}: the lamp, the lens or dust moved, or \
                 something covers a part",
                campaign.named(&sets),
                percent(most)
            );
            campaign.fault_of_sets(FaultKind::UnequalLight, &sets, text, left_out)
        };
        found.into_iter().map(fault).collect()
    }
}

/// Returns sets whose field differs from the others, and the largest change; `None` if all have one
/// field.
fn changed(fields: &[Field]) -> Option<(Vec<usize>, f64)> {
    if fields.len() < MIN_FLATS || fields.iter().any(|f| f.cells.len() != fields[0].cells.len()) {
        return None;
    }
    let usual: Vec<f64> =
        (0..fields[0].cells.len()).map(|c| median(fields.iter().map(|f| f.cells[c]))).collect();
    let (mut sets, mut largest) = (Vec::new(), 0.0f64);
    for field in fields {
        let rest = without_level(&usual, &field.cells);
        let mut changes: Vec<f64> = rest.iter().map(|r| r.abs()).collect();
        changes.sort_by(|a, b| b.total_cmp(a));
        let second = changes.get(1).copied().unwrap_or(0.0);
        tracing::debug!("set {}: field changes by {second:.4}, standard error {:.4}", field.set, field.std);
        if second > MIN_CHANGE.max(MIN_SIGMAS * field.std) {
            sets.push(field.set);
            largest = largest.max(changes[0]);
        }
    }
    (!sets.is_empty()).then_some((sets, largest))
}

/// Returns the cells of a set relative to the mean frame, with a parabola of the light removed.
fn without_level(usual: &[f64], cells: &[f64]) -> Vec<f64> {
    let mean = usual.iter().sum::<f64>() / usual.len().max(1) as f64;
    // Orthogonal basis: 1, x, x^2.
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for power in 0..3 {
        let mut v: Vec<f64> = usual.iter().map(|u| (u - mean).powi(power)).collect();
        for b in &basis {
            let along: f64 = v.iter().zip(b).map(|(v, b)| v * b).sum();
            v.iter_mut().zip(b).for_each(|(v, b)| *v -= along * b);
        }
        let norm = v.iter().map(|v| v * v).sum::<f64>().sqrt();
        if norm > 1e-9 {
            basis.push(v.iter().map(|v| v / norm).collect());
        }
    }
    let mut rest: Vec<f64> =
        cells.iter().zip(usual).map(|(c, u)| c / u.max(f64::MIN_POSITIVE) - 1.0).collect();
    for b in &basis {
        let along: f64 = rest.iter().zip(b).map(|(v, b)| v * b).sum();
        rest.iter_mut().zip(b).for_each(|(v, b)| *v -= along * b);
    }
    rest
}

/// Returns the light of the cells of a set relative to that of its frames, from the frames in use.
fn field(campaign: &Campaign<'_>, zero: &Zero, set: usize) -> Option<Field> {
    let view = &campaign.sets[set];
    let (black, black_std) = cells_of_darks(campaign, view.exposure_s, view.facts.cells_dn.first()?.len());
    let zero_dn = zero.at(view.exposure_s);
    let frames: Vec<Vec<f64>> = (view.facts.cells_dn.iter().zip(&view.facts.means_dn))
        .zip(&view.kept)
        .filter(|(_, kept)| **kept)
        .map(|((cells, mean), _)| {
            let signal = mean - zero_dn;
            cells
                .iter()
                .enumerate()
                .map(|(c, v)| (v - zero_dn - black.get(c).unwrap_or(&0.0)) / signal)
                .collect()
        })
        .collect();
    if frames.len() < 2 {
        return None;
    }
    let (cells, std) = mean_and_std(&frames);
    let signal_dn = view.level_dn() - zero_dn;
    Some(Field { set, cells, std: std.hypot(black_std / signal_dn) })
}

/// Returns the mean of the cells of frames, and its standard error, the same for all.
fn mean_and_std(frames: &[Vec<f64>]) -> (Vec<f64>, f64) {
    let n = frames.len() as f64;
    let cells = frames.first().map_or(0, Vec::len);
    let means: Vec<f64> = (0..cells).map(|c| frames.iter().map(|f| f[c]).sum::<f64>() / n).collect();
    let off = |f: &Vec<f64>| f.iter().zip(&means).map(|(v, m)| (v - m).powi(2)).sum::<f64>();
    let squares: f64 = frames.iter().map(off).sum();
    let std = (squares / ((n - 1.0).max(1.0) * cells.max(1) as f64) / n).sqrt();
    (means, std)
}

/// Returns the cells of the darks nearest in exposure, minus their mean, DN, and their standard error;
/// zeros without darks.
fn cells_of_darks(campaign: &Campaign<'_>, exposure_s: f64, cells: usize) -> (Vec<f64>, f64) {
    let has_cells = |i: &usize| {
        let own = &campaign.sets[*i].facts.cells_dn;
        !own.is_empty() && own.iter().all(|c| c.len() == cells)
    };
    let darks = campaign.darks_with_level().filter(has_cells);
    let off = |i: &usize| (campaign.sets[*i].exposure_s.max(1e-9) / exposure_s.max(1e-9)).ln().abs();
    let Some(nearest) = darks.min_by(|a, b| off(a).total_cmp(&off(b))) else {
        return (Vec::new(), 0.0);
    };
    let (means, std) = mean_and_std(&campaign.sets[nearest].facts.cells_dn);
    let level = means.iter().sum::<f64>() / cells.max(1) as f64;
    (means.into_iter().map(|v| v - level).collect(), std)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Field whose cells fall from 1.2 to 0.8: one of five flats is bent by the level, another has two
    /// cells covered by 4 %.
    #[test]
    fn a_bend_is_no_other_field() {
        let plain: Vec<f64> = (0..64).map(|c| 1.2 - 0.4 * f64::from(c) / 63.0).collect();
        let of = |set: usize, cells: Vec<f64>| Field { set, cells, std: 1e-3 };
        let bent: Vec<f64> = plain.iter().map(|v| v * (1.02 - 0.15 * (v - 1.0))).collect();
        let mut fields: Vec<Field> = (0..4).map(|set| of(set, plain.clone())).collect();
        fields.push(of(4, bent));
        assert!(changed(&fields).is_none());
        let mut covered = plain.clone();
        covered[20..22].iter_mut().for_each(|v| *v *= 0.96);
        fields.push(of(5, covered));
        let (sets, most) = changed(&fields).unwrap();
        assert_eq!(sets, [5]);
        assert!((0.035..0.041).contains(&most), "{most}");
    }
}
