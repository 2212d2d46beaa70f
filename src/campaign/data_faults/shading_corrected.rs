//! Shading corrected by the camera: a position-dependent digital gain makes the flats even, and
//! multiplies the noise of each place by the same factor. At one level the variance then differs in the
//! corners, unlike in any raw frame (variance and mean of all pixels lie on one line: Healey and
//! Kondepudy 1994, eq. 35).

use super::facts::ENOUGH;
use super::set_view::SetView;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::number::six_digits;
use crate::statistics::median::{MAD_OF_NORMAL, median};

/// Minimum ratio of the variance of a flat with mostly photon noise to that of the quietest set.
const LIT: f64 = 4.0;
/// Minimum number of usable flats.
const MIN_FLATS: usize = 3;
/// Minimum ratio of the largest to the smallest variance at one level (a named choice: parts of a sensor
/// with separate amplifiers differ by a few per cent), and its minimum significance.
const MIN_RATIO: f64 = 1.12;
const MIN_SIGMAS: f64 = 8.0;

/// Minimum level of a usable cell relative to its frame.
const MIN_LEVEL: f64 = 0.3;
/// Maximum deviation of the median ratio of the cells from 1 (a named choice).
const MAX_OFF: f64 = 0.1;
/// One in this number of cells is ignored at either end of the range.
const OUTER: usize = 12;

/// Check for shading correction.
pub struct ShadingCorrected;

impl Check for ShadingCorrected {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some((least, most)) = range(campaign) else { return Vec::new() };
        let flats = campaign.places(|s| s.is_lit());
        let text = format!(
            "{}: at one level the noise differs by place, its variance from {} to {} of the mean: a shading correction or another gain by place is on \
             in the camera, and system gain and read noise are means over the field. Switch it off for measurements",
            campaign.named(&flats),
            six_digits((100.0 * least).round() / 100.0),
            six_digits((100.0 * most).round() / 100.0)
        );
        vec![campaign.fault_of_sets(FaultKind::OtherSettings, &flats, text, false)]
    }
}

/// Returns the minimum and maximum variance of a cell relative to that of its level elsewhere, if they
/// differ significantly.
fn range(campaign: &Campaign<'_>) -> Option<(f64, f64)> {
    let zero = campaign.zero().filter(|_| campaign.is_of_one_part())?;
    let variance = |i: usize| campaign.sets[i].variance_dn2().map_or(f64::NAN, |v| v.0);
    let level = |i: usize| campaign.sets[i].level_dn() - zero.at(campaign.sets[i].exposure_s);
    let quiet = campaign.places(|s| !s.clipped).into_iter().map(variance).fold(f64::INFINITY, f64::min);
    let is_whole = |s: &SetView| s.kept.iter().all(|kept| *kept) && !s.facts.cells_dn2.is_empty();
    let mut flats = campaign.places(|s| s.is_lit() && !s.clipped && !s.is_cut_off() && is_whole(s));
    flats.retain(|&i| variance(i) > LIT * quiet.max(f64::MIN_POSITIVE) && level(i) > 0.0);
    if flats.len() < MIN_FLATS || !campaign.are_of_one_size(flats.iter()) {
        return None;
    }
    flats.sort_by(|a, b| level(*a).total_cmp(&level(*b)));
    // Ratio of variance to level, interpolated between the flats.
    let curve: Vec<(f64, f64)> = flats.iter().map(|&i| (level(i), variance(i) / level(i))).collect();
    let expected = |level_dn: f64| {
        let above = curve.partition_point(|p| p.0 < level_dn);
        let (a, b) = (curve.get(above.checked_sub(1)?)?, curve.get(above)?);
        Some((a.1 + (b.1 - a.1) * (level_dn - a.0) / (b.0 - a.0)) * level_dn)
    };
    let cells = campaign.sets[flats[0]].facts.cells_dn2.len();
    let of_cell = |cell: usize| -> Vec<f64> {
        let ratio = |&i: &usize| {
            let facts = &campaign.sets[i].facts;
            let means = facts.cells_dn.iter().filter_map(|c| c.get(cell));
            let mean_dn = means.sum::<f64>() / facts.cells_dn.len().max(1) as f64;
            let level_dn = mean_dn - zero.at(campaign.sets[i].exposure_s);
            let own = facts.cells_dn2.get(cell)? / expected(level_dn)?;
            // At little light the noise is not from light.
            (level_dn > MIN_LEVEL * level(i) && own > 0.0).then_some(own)
        };
        flats.iter().filter_map(ratio).collect()
    };
    // Variance of a variance from this number of pixels and pairs of frames, and the median over the
    // flats.
    let square = |&i: &usize| {
        let set = &campaign.sets[i];
        let pairs = (set.frames() / 2).max(1) as f64;
        let samples = (set.facts.pixels * pairs).min(ENOUGH as f64 + set.facts.pixels) / cells as f64;
        2.0 / samples.max(1.0)
    };
    let of_noise = flats.iter().map(square).sum::<f64>() / flats.len() as f64;
    let ratios: Vec<(f64, f64)> = (0..cells)
        .map(of_cell)
        .filter(|all| all.len() >= MIN_FLATS)
        .map(|all| {
            let middle = median(all.iter().copied());
            let scatter = median(all.iter().map(|r| (r - middle).abs())) / MAD_OF_NORMAL;
            (middle, 1.25 * scatter.max(of_noise.sqrt()) / (all.len() as f64).sqrt())
        })
        .collect();
    // Partial illumination of the field leaves few cells, and light bands affect only the noise of
    // cells: both quantities agree in the middle.
    let middle = median(ratios.iter().map(|r| r.0));
    if 2 * ratios.len() < cells || (middle - 1.0).abs() > MAX_OFF {
        return None;
    }
    let std = median(ratios.iter().map(|r| r.1));
    // Dust and defect pixels affect single cells.
    let mut sorted: Vec<f64> = ratios.iter().map(|r| r.0).collect();
    sorted.sort_by(f64::total_cmp);
    let outer = sorted.len() / OUTER;
    let (least, most) = (*sorted.get(outer)?, *sorted.get(sorted.len().checked_sub(1 + outer)?)?);
    tracing::debug!("variance of cells {least:.3} to {most:.3} of what their level has, +- {std:.3}");
    (most > MIN_RATIO * least && most - least > MIN_SIGMAS * std).then_some((least, most))
}
