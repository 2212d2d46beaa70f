//! Duplicate frames: temporal noise never repeats.

use super::set_view::SetView;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::statistics::median::median;
use std::collections::BTreeMap;

/// Minimum usual number of differing pixels at which two identical frames are duplicates: if each
/// differs by chance, the probability that none does is below 1e-13.
const MIN_CHANGED_PIXELS: f64 = 30.0;
/// Maximum fraction of pixels in which a copy may differ: cameras and programs write a number or the
/// time into a corner of the frame.
const MAX_STAMP_SHARE: f64 = 0.01;
/// Minimum fraction of pixels in which frames of the same level usually differ in that case.
const MIN_CHANGED_SHARE: f64 = 0.4;
/// Minimum signal at which light alone makes frames differ, DN.
const MIN_SIGNAL_DN: f64 = 20.0;
/// Maximum difference of the levels of two sets of one level, DN, minimum difference of a pixel that rounding
/// does not explain, DN, and minimum share of such pixels that hot pixels do not reach (named choices).
const SAME_LEVEL_DN: f64 = 0.5;
const MIN_STEP_DN: f32 = 2.0;
const MIN_SHARE_APART: f64 = 0.03;

/// Check for duplicate frames.
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
        let stamped = stamped(campaign);
        if copies.is_empty() && stamped.is_empty() {
            return Vec::new();
        }
        // Median number of pixels that differ between frames of a set, duplicates excluded.
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
            // At saturation nothing is left to differ, even if it is below the largest code.
            if view.clipped || has_one_code(&view.facts.middle_dn) {
                return false;
            }
            // All frames are identical: use sets of less light.
            let level = view.level_dn();
            let darker =
                campaign.places(|_| true).into_iter().filter(|s| campaign.sets[*s].level_dn() <= level);
            let usual = median(darker.map(changes).filter(|c| c.is_finite()));
            usual >= MIN_CHANGED_PIXELS
                || (view.facts.spread_dn2 > 0.0 && level - lowest > MIN_SIGNAL_DN)
                || differs_from_another(campaign, set)
        };
        let mut frames: Vec<(usize, usize)> = copies.into_iter().filter(|(s, _)| has_noise(*s)).collect();
        let exact = frames.len();
        frames.extend(stamped);
        frames.sort_unstable();
        frames.dedup();
        let word = if exact == frames.len() { ", code for code" } else { " but for a stamp in a corner" };
        if frames.is_empty() {
            return Vec::new();
        }
        let mut sets: Vec<usize> = frames.iter().map(|f| f.0).collect();
        sets.dedup();
        let text = format!(
            "{}: {} frames are copies of others{word} ({}{}): noise never repeats itself, and each frame counts once",
            campaign.named(&sets),
            frames.len(),
            campaign.file(frames[0].0, frames[0].1),
            if frames.len() > 1 { " and others" } else { "" },
        );
        vec![campaign.fault_of_frames(FaultKind::CopiedFrames, &frames, text)]
    }
}

/// Returns true if the frame of a set differs from that of another set of its level by more than rounding
/// does: all darks of a campaign may be copied.
fn differs_from_another(campaign: &Campaign<'_>, set: usize) -> bool {
    let own = &campaign.sets[set];
    let is_alike = |s: &SetView| {
        s.number != own.number
            && (s.level_dn() - own.level_dn()).abs() < SAME_LEVEL_DN
            && s.facts.middle_dn.len() == own.facts.middle_dn.len()
    };
    let differ = |i: usize| {
        let pairs = own.facts.middle_dn.iter().zip(&campaign.sets[i].facts.middle_dn);
        let apart = pairs.filter(|(a, b)| (**a - **b).abs() >= MIN_STEP_DN).count();
        apart as f64 > MIN_SHARE_APART * own.facts.middle_dn.len() as f64
    };
    campaign.places(is_alike).into_iter().any(differ)
}

/// Returns true if most pixels have a single code: saturated.
fn has_one_code(middle_dn: &[f32]) -> bool {
    let middle = median(middle_dn.iter().map(|v| f64::from(*v)));
    median(middle_dn.iter().map(|v| (f64::from(*v) - middle).abs())) == 0.0
}

/// Finds frames that differ from the previous one only in a corner, while others of their level differ
/// everywhere.
fn stamped(campaign: &Campaign<'_>) -> Vec<(usize, usize)> {
    let all = campaign.places(|s| !s.clipped);
    let pixels = |set: usize| campaign.sets[set].facts.pixels;
    // Outlier samples are not counted: a short stamp may change none.
    let is_stamp = |set: usize, changed: u64| (changed as f64) < MAX_STAMP_SHARE * pixels(set);
    // Fraction of the pixels changed by noise.
    let usual = |set: usize| {
        let changed = campaign.sets[set].facts.changed.iter().skip(1).filter(|c| !is_stamp(set, **c));
        median(changed.map(|c| *c as f64)) / pixels(set)
    };
    let mut out = Vec::new();
    for &set in &all {
        let view = &campaign.sets[set];
        let places: Vec<usize> = (1..view.facts.changed.len())
            .filter(|&k| view.kept[k] && view.kept[k - 1] && is_stamp(set, view.facts.changed[k]))
            .collect();
        if places.is_empty() {
            continue;
        }
        let darker = all.iter().filter(|s| campaign.sets[**s].level_dn() <= view.level_dn());
        let known = median(darker.map(|s| usual(*s)).filter(|u| u.is_finite()));
        let own = usual(set);
        if (if own.is_finite() { own } else { known }) > MIN_CHANGED_SHARE {
            out.extend(places.into_iter().map(|k| (set, k)));
        }
    }
    out
}
