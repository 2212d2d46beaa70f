//! Copies of one frame: temporal noise never repeats.

use super::{Campaign, Check, DataFault, FaultKind};
use crate::statistics::median::median;
use std::collections::BTreeMap;

/// Pixels that frames usually differ in, from which on two that do not are one: where each differs by chance, the
/// chance of none is below 1e-13.
const MIN_CHANGED_PIXELS: f64 = 30.0;
/// Signal from which light alone makes frames differ, DN.
const MIN_SIGNAL_DN: f64 = 20.0;

/// The check.
pub struct CopiedFrames;

impl Check for CopiedFrames {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let mut same: BTreeMap<u64, Vec<(usize, usize)>> = BTreeMap::new();
        for set in campaign.places(|_| true) {
            let view = &campaign.sets[set];
            for (place, digest) in view.facts.digests.iter().enumerate().filter(|(p, _)| view.kept[*p]) {
                same.entry(*digest).or_default().push((set, place));
            }
        }
        let copies: Vec<(usize, usize)> = same.into_values().flat_map(|v| v.into_iter().skip(1)).collect();
        if copies.is_empty() {
            return Vec::new();
        }
        // How much frames of a set differ that are not the same.
        let changes = |set: usize| {
            let all = campaign.sets[set].facts.changed.iter().skip(1).filter(|c| **c > 0);
            median(all.map(|c| *c as f64))
        };
        let lowest = campaign
            .places(|_| true)
            .into_iter()
            .map(|s| campaign.sets[s].level_dn())
            .fold(f64::INFINITY, f64::min);
        let has_noise = |set: usize| {
            let view = &campaign.sets[set];
            let own = changes(set);
            if own.is_finite() {
                return own >= MIN_CHANGED_PIXELS;
            }
            // At full scale nothing is left to differ.
            if view.clipped {
                return false;
            }
            // All are the same: sets of less light tell.
            let level = view.level_dn();
            let darker =
                campaign.places(|_| true).into_iter().filter(|s| campaign.sets[*s].level_dn() <= level);
            let usual = median(darker.map(changes).filter(|c| c.is_finite()));
            usual >= MIN_CHANGED_PIXELS || (view.facts.spread_dn2 > 0.0 && level - lowest > MIN_SIGNAL_DN)
        };
        let mut frames: Vec<(usize, usize)> = copies.into_iter().filter(|(s, _)| has_noise(*s)).collect();
        frames.sort_unstable();
        if frames.is_empty() {
            return Vec::new();
        }
        let mut sets: Vec<usize> = frames.iter().map(|f| f.0).collect();
        sets.dedup();
        let text = format!(
            "{}: {} frames are copies of others, code for code ({}{}): noise never repeats itself, and each frame counts once",
            campaign.named(&sets),
            frames.len(),
            campaign.file(frames[0].0, frames[0].1),
            if frames.len() > 1 { " and others" } else { "" },
        );
        vec![campaign.fault_of_frames(FaultKind::CopiedFrames, &frames, text)]
    }
}
