//! Single frame with another level or light field than the others of its set: a flash, someone in the
//! light.

use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::{percent, six_digits};
use crate::statistics::outliers;

/// Minimum deviation of an odd frame, standard deviations of a frame's mean.
const MIN_SIGMAS: f64 = 8.0;
/// Minimum deviation from the other frames, relative to the signal: smaller ones are harmless.
const MIN_RELATIVE_OFFSET: f64 = 0.002;
/// Minimum deviation of a dark frame, DN.
const MIN_OFFSET_DN: f64 = 0.3;
/// Maximum fraction of frames that are isolated faults: more are a property of the camera or the lamp.
const MAX_SHARE_OF_FRAMES: f64 = 0.05;

/// Maximum fraction of a level change that a first frame may carry over.
const MAX_LAG: f64 = 0.05;
/// Maximum deviation of the frames beside an odd one, relative to its deviation.
const MAX_NEIGHBOUR_SHARE: f64 = 0.34;
/// Maximum number of frames of a set with at most one odd frame.
const FEW_FRAMES: usize = 7;
/// Minimum carry-over into first frames at which the level before the first set matters.
const MIN_CARRIED_SHARE: f64 = 3e-4;
/// Maximum ratio of the carried share to its median: lag depends on the time between frames.
const CARRIED_TOLERANCE: f64 = 3.0;
/// Cells of a frame.
const CELLS_PER_FRAME: f64 = 36.0;
/// Maximum fraction of sets with one odd frame each that are isolated faults.
const MAX_SHARE_OF_SETS: f64 = 0.4;

/// Check for odd frames.
pub struct OddFrame;

impl Check for OddFrame {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero() else { return Vec::new() };
        let sets = campaign.places(|s| s.frames() >= 3);
        let frames: usize = sets.iter().map(|&s| campaign.sets[s].frames()).sum();
        let blocks = |set: usize| {
            let view = &campaign.sets[set];
            let cells =
                view.facts.cells_dn.iter().zip(&view.kept).filter(|(_, k)| **k).map(|(c, _)| c.clone());
            outliers::apart_of(&cells.collect::<Vec<_>>(), true)
        };
        let aparts: Vec<(bool, outliers::Apart)> =
            sets.iter().map(|&s| (!campaign.sets[s].is_lit(), blocks(s))).collect();
        let usual = outliers::Usual::of(&aparts, zero.dn);
        let usual_scatter = campaign.scatter(&zero);
        let share = campaign.carried(&usual_scatter);
        let mut odd: Vec<(usize, usize, f64, f64)> = Vec::new();
        for (&set, (dark, apart)) in sets.iter().zip(&aparts) {
            let view = &campaign.sets[set];
            let places: Vec<usize> = (0..view.kept.len()).filter(|p| view.kept[*p]).collect();
            let signal = (apart.level_dn - zero.at(view.exposure_s)).max(1.0);
            let least = if *dark { MIN_OFFSET_DN } else { (MIN_RELATIVE_OFFSET * signal).max(MIN_OFFSET_DN) };
            // Light bands and flicker move the means of short exposures, but not those of others.
            let scatter = usual_scatter.of_frame_dn(view).max(apart.usual_mean_dn());
            // Hot pixels make cells scatter.
            let noise = view.variance_dn2().map_or(0.0, |v| v.0);
            let of_cell = (noise * CELLS_PER_FRAME / view.facts.pixels.max(1.0)).sqrt();
            let cell = usual.far_cell_dn(apart, *dark, signal).max(least).max(MIN_SIGMAS * of_cell);
            let far = |k: &usize| {
                let off = apart.mean_dn[*k];
                let by_cell = apart.cell_dn.get(*k).is_some_and(|c| *c > cell);
                if off.abs() <= least.max(MIN_SIGMAS * scatter) && !by_cell {
                    return false;
                }
                // A level that settles or drifts does so step by step: an odd frame stands alone.
                let beside = [k.checked_sub(1), Some(*k + 1)]
                    .into_iter()
                    .flatten()
                    .filter_map(|n| apart.mean_dn.get(n));
                let most =
                    |offsets: &mut dyn Iterator<Item = &f64>| offsets.fold(0.0f64, |a, b| a.max(b.abs()));
                let mut others = apart.mean_dn.iter().enumerate().filter(|(n, _)| n != k).map(|(_, off)| off);
                // In a set of few frames the odd one must stand out from all others.
                let near = if places.len() <= FEW_FRAMES { most(&mut others) } else { most(&mut { beside }) };
                if !by_cell && near > MAX_NEIGHBOUR_SHARE * off.abs() {
                    return false;
                }
                // Lag below any fault matters too: a sensor may carry 1e-5 of 60000 DN into the next
                // dark.
                let most = share.map_or(MAX_LAG, |s| {
                    if s.abs() > MIN_CARRIED_SHARE { CARRIED_TOLERANCE * s.abs() } else { MIN_CARRIED_SHARE }
                });
                // The previous level is carried over and decays; the level before the first set is
                // unknown.
                let Some(before) = set.checked_sub(1).map(|b| &campaign.sets[b]) else {
                    return places[*k] > 2
                        || share.is_none_or(|s| s.abs() < MIN_CARRIED_SHARE)
                        || off.abs() > most * campaign.full_scale_dn;
                };
                let change = if before.frames() > 0 { before.last_dn() - apart.level_dn } else { 0.0 };
                let carried = places[*k] <= 2 && off * change > 0.0 && off.abs() < most * change.abs();
                // If there are too few level changes, the noise distinguishes lag from a dim frame.
                let carried = carried && !(share.is_none() && view.lacks_lag(off / change, before));
                let dies_away = (1..=2).contains(k)
                    && apart.mean_dn[*k - 1] * off > 0.0
                    && apart.mean_dn[*k - 1].abs() > 2.0 * off.abs();
                !carried && !dies_away
            };
            let own: Vec<usize> = (0..places.len()).filter(far).collect();
            if own.len() == 1 || own.len() * 4 <= places.len() {
                odd.extend(own.iter().map(|k| (set, places[*k], apart.mean_dn[*k], signal)));
            }
        }
        // Dark of two frames, one of which agrees with the other darks.
        for set in campaign.places(|s| s.kind == Kind::Dark && s.frames() == 2) {
            let level = zero.at(campaign.sets[set].exposure_s);
            let means = campaign.sets[set].means_dn();
            let off: Vec<f64> = means.iter().map(|m| m - level).collect();
            // Lag is in the first dark after light.
            let usual = share.filter(|s| s.abs() > MIN_CARRIED_SHARE);
            if campaign
                .share_of_change(set)
                .zip(usual)
                .is_some_and(|(own, usual)| own * usual > 0.0 && own.abs() < CARRIED_TOLERANCE * usual.abs())
            {
                continue;
            }
            let same = (10.0 * zero.scatter_dn).max(MIN_OFFSET_DN);
            if let Some(k) = (0..2).find(|k| off[*k].abs() > 10.0 * same && off[1 - k].abs() < same) {
                let places: Vec<usize> =
                    (0..campaign.sets[set].kept.len()).filter(|p| campaign.sets[set].kept[*p]).collect();
                odd.push((set, places[k], off[k], 1.0));
            }
        }
        // Frame with the same index in successive sets: the light differed during a part of the sweep.
        let part = odd.len() > 1 && odd.iter().all(|o| o.1 == odd[0].1);
        let kind = if part { FaultKind::UnequalLight } else { FaultKind::OddFrame };
        let few = if part {
            MAX_SHARE_OF_SETS * sets.len() as f64
        } else {
            (MAX_SHARE_OF_FRAMES * frames as f64).max(1.0)
        };
        if odd.is_empty() || odd.len() as f64 > few {
            return Vec::new();
        }
        let (set, place, off, signal) = odd[0];
        let by = if campaign.sets[set].is_lit() {
            format!("{} of the signal", percent(off.abs() / signal))
        } else {
            format!("{} DN", six_digits(off.abs()))
        };
        let places: Vec<(usize, usize)> = odd.iter().map(|o| (o.0, o.1)).collect();
        let mut sets: Vec<usize> = odd.iter().map(|o| o.0).collect();
        sets.dedup();
        let text = format!(
            "{}: frame {place} ({}) is {by} {} the other frames of its set{}",
            campaign.named(&sets),
            campaign.file(set, place),
            if off < 0.0 { "below" } else { "above" },
            if odd.len() > 1 { format!(", and {} more frames are so", odd.len() - 1) } else { String::new() },
        );
        vec![campaign.fault_of_frames(kind, &places, text)]
    }
}
