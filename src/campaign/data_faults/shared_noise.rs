//! Noise shared by neighbours or successive frames in all flats: the variance measured per pixel, or
//! about the mean of the frames, lacks it, and the gain is underestimated.

use super::Campaign;
use super::campaign::median_line;
use super::facts::{NEIGHBOURS_VAR, NEXT_VAR, Neighbours};
use super::set_view::SetView;
use crate::dataset::{Between, SharedNoise};
use crate::statistics::between_sets::{MOVES, MeanFrame, noise_over_that_within};
use crate::statistics::jackknife::Value;
use crate::statistics::median::{ERROR_OVER_MEAN, median};
use crate::statistics::quantisation::SMALLEST_DARK_DN2;

/// Minimum shared fraction of the noise that is reported: it equals the gain error (a named choice:
/// twice the per cent that EMVA 1288 asks for). For frames, a settling lamp and a little lag look alike.
const LEAST: f64 = 0.02;
const LEAST_OF_FRAMES: f64 = 0.05;
/// Minimum significance, standard deviations.
const SIGMAS: f64 = 5.0;
/// Minimum ratio of the variance of a flat to that of the quietest set at which the read noise is at
/// most a tenth of it (a named choice): the fraction of that shared by neighbours may differ. If no flat
/// reaches it, the second limit applies, and the possible contribution of the read noise is added to the
/// error.
const LIT: [f64; 2] = [10.0, 3.0];
/// Maximum number of sets examined: every pair of them is compared.
const MOST_SETS: usize = 64;
/// Returns the larger of both, from flats dominated by photon noise; `None` if there is nothing.
pub(super) fn shared_noise(campaign: &Campaign<'_>) -> Option<SharedNoise> {
    let variance = |i: usize| campaign.sets[i].variance_dn2().map(|v| v.0);
    let sets = campaign.places(|s| !s.clipped).into_iter();
    let quiet = sets.filter_map(variance).fold(f64::INFINITY, f64::min);
    let flats = campaign.places(|s| s.is_lit() && !s.clipped);
    let of_light = |least: f64| -> Vec<usize> {
        let is_lit = |i: &usize| variance(*i).is_some_and(|v| v > least * quiet);
        flats.iter().copied().filter(is_lit).collect()
    };
    let sure = of_light(LIT[0]);
    let flats = if sure.is_empty() { of_light(LIT[1]) } else { sure };
    let of_reading = quiet / median(flats.iter().filter_map(|i| variance(*i)));
    let every = flats.len().div_ceil(MOST_SETS).max(1);
    let flats: Vec<usize> = flats.into_iter().step_by(every).collect();
    let is_told = |s: &SharedNoise| {
        let least = if s.between == Between::Frames { LEAST_OF_FRAMES } else { LEAST };
        s.rel.abs() > least.max(SIGMAS * s.std_err)
    };
    let less_certain =
        |s: SharedNoise| SharedNoise { std_err: s.std_err.hypot(0.5 * of_reading * s.rel), ..s };
    // Few frames determine the covariance of the nearest neighbours, but not of all.
    let told = |found: Option<SharedNoise>| found.map(less_certain).filter(is_told);
    let of_all = told(of_neighbours(campaign, &flats, |n| n.share, NEIGHBOURS_VAR));
    let of_next = || told(of_neighbours(campaign, &flats, |n| n.of_next, NEXT_VAR));
    let all = [of_all.or_else(of_next), told(of_frames(campaign, &flats))];
    all.into_iter().flatten().max_by(|a, b| a.rel.abs().total_cmp(&b.rel.abs()))
}

/// Returns the noise shared by neighbours at zero light: a part that grows with the level (the
/// brighter-fatter effect) bends the photon transfer, but leaves the gain at its dark end.
fn of_neighbours(
    campaign: &Campaign<'_>,
    flats: &[usize],
    share: impl Fn(&Neighbours) -> f64,
    variance: f64,
) -> Option<SharedNoise> {
    let zero = campaign.zero();
    // Pairs after the first two frames of sets of four and more, and only of frames in use.
    let of_kept = |set: &&SetView| {
        let firsts = if set.kept.len() < 4 { 0 } else { 2 };
        set.facts.neighbours.pixels > 0.0 && set.kept[firsts..].iter().all(|kept| *kept)
    };
    let known = || flats.iter().map(|&i| &campaign.sets[i]).filter(of_kept);
    let signal_dn = |set: &SetView| set.level_dn() - zero.as_ref().map_or(0.0, |z| z.at(set.exposure_s));
    let shared: Vec<(f64, f64)> = known().map(|set| (signal_dn(set), share(&set.facts.neighbours))).collect();
    let pixels: f64 = known().map(|set| set.facts.neighbours.pixels).sum();
    let std_err = ERROR_OVER_MEAN * (variance / pixels).sqrt();
    let middle = median(shared.iter().map(|p| p.1));
    let at_dark = median_line(&shared)?.0;
    // Error of the intercept of a line relative to that of the mean of its points (Bevington and
    // Robinson 2003, section 6.4): flats of about one level do not determine an intercept.
    let n = shared.len() as f64;
    let mean = shared.iter().map(|p| p.0).sum::<f64>() / n;
    let square = shared.iter().map(|p| (p.0 - mean).powi(2)).sum::<f64>() / n;
    let of_intercept = std_err * (1.0 + mean * mean / square).sqrt();
    let grows = (middle - at_dark).abs() > 2.0 * of_intercept;
    let (rel, std_err) = if grows { (at_dark, of_intercept) } else { (middle, std_err) };
    Some(SharedNoise { between: Between::Neighbours, rel, std_err })
}

/// Returns the noise shared by successive frames.
fn of_frames(campaign: &Campaign<'_>, flats: &[usize]) -> Option<SharedNoise> {
    let own = |&i: &usize| {
        let set = &campaign.sets[i];
        let dependence = set.dependence().filter(|d| *d > 0.0 && !set.wanders())?;
        let triples = set.frames().saturating_sub(2).max(1) as f64;
        Some((1.0 / dependence - 1.0, set.facts.pixels * triples))
    };
    let alike: Vec<(f64, f64)> = flats.iter().filter_map(own).collect();
    if alike.is_empty() {
        return of_pairs(campaign, flats);
    }
    let rel = median(alike.iter().map(|a| a.0));
    // Error of a ratio of variances of successive frames and of those two apart.
    let samples: f64 = alike.iter().map(|a| a.1).sum();
    let std_err = ERROR_OVER_MEAN * (4.0 / samples).sqrt();
    (rel > 0.0).then_some(SharedNoise { between: Between::Frames, rel, std_err })
}

/// Number of sets that tell the noise of one of them from set to set.
const COMPARED: usize = 4;

fn mean_of_pair(s: &SetView) -> MeanFrame<'_> {
    MeanFrame {
        mean_dn: &s.facts.middle_dn,
        at: s.level_dn(),
        frames: 2,
        var_dn2: 2.0 * s.facts.middle_noise_dn2,
    }
}

/// Returns the noise that the two frames of pairs share: from set to set, their means have (1 + r) / (1 - r)
/// times the noise that their difference makes of it, for a correlation r.
fn of_pairs(campaign: &Campaign<'_>, flats: &[usize]) -> Option<SharedNoise> {
    let is_pair = |s: &SetView| {
        s.frames() == 2 && s.facts.means_dn.len() == 2 && s.has_pattern() && s.facts.middle_noise_dn2 > 0.0
    };
    // A level that is carried over brings the pattern of the set before.
    let is_still = |s: &SetView| {
        s.own_scatter_dn().powi(2) < 2.0 * s.facts.middle_noise_dn2
            && s.facts.middle_noise_dn2 > 0.5 * SMALLEST_DARK_DN2
    };
    let mut pairs: Vec<&SetView> = flats.iter().map(|&i| &campaign.sets[i]).collect();
    pairs.retain(|s| is_pair(s) && is_still(s));
    pairs.sort_by(|a, b| a.level_dn().total_cmp(&b.level_dn()));
    let of_four = |sets: &[&SetView]| {
        let all: Vec<MeanFrame<'_>> = sets.iter().map(|s| mean_of_pair(s)).collect();
        let size = all[0].mean_dn.len();
        let is_alike = sets.iter().all(|s| {
            s.facts.middle_dn.len() == size
                && s.configuration == sets[0].configuration
                && s.part == sets[0].part
        });
        let all: Vec<&MeanFrame<'_>> = all.iter().collect();
        is_alike.then(|| noise_over_that_within(&all, &vec![1.0; size]))?
    };
    let ratios: Vec<Value> = pairs.chunks_exact(COMPARED).filter_map(of_four).collect();
    let ratio = median(ratios.iter().map(|v| v.value));
    let error = median(ratios.iter().map(|v| v.std_err.hypot(MOVES * v.value)));
    let std_err = ERROR_OVER_MEAN * error / (ratios.len() as f64).sqrt() * 2.0 / (ratio + 1.0).powi(2);
    let rel = (ratio - 1.0) / (ratio + 1.0);
    (rel > 0.0).then_some(SharedNoise { between: Between::Frames, rel, std_err })
}
