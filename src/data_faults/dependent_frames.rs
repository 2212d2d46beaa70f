//! Frames of few sets that were averaged or filtered over time before they were saved: less noise than their level has elsewhere, or successive
//! frames alike.

use super::transfer::{Transfer, above};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use crate::statistics::median::median;

/// Share of the usual variance below which frames were averaged: two make it a half.
const AVERAGED: f64 = 0.8;
/// Ratio of the usual variance from which on a dark has another gain.
const GAINED: f64 = 1.25;
/// Share of the highest level from which on saturation takes noise away.
const TOP: f64 = 0.85;
/// Deviation of the level from its law within which it does not, relative.
const STRAIGHT: f64 = 0.003;
/// Least that the variance of successive frames falls short of that of frames two apart.
const ALIKE: f64 = 0.05;
/// Standard deviations of that.
const TOLD: f64 = 10.0;
/// Share of the sets up to which it is a slip: more are what the camera does.
const FEW: f64 = 0.34;

/// The check.
pub struct DependentFrames;

impl Check for DependentFrames {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero() else { return Vec::new() };
        let all = campaign.places(|s| matches!(s.kind, Kind::Dark | Kind::Flat) && !s.clipped);
        let level = |i: usize| above(campaign, &zero, i);
        let highest = all.iter().map(|&i| level(i)).fold(0.0, f64::max);
        // Frames alike.
        let usual = median(all.iter().filter_map(|&i| campaign.sets[i].dependence()));
        let alike = |i: usize| {
            let set = &campaign.sets[i];
            let triples = set.frames().saturating_sub(2).max(1) as f64;
            let std = (4.0 / (set.facts.pixels * triples)).sqrt();
            set.dependence().is_some_and(|d| d < usual - ALIKE.max(TOLD * std))
        };
        let filtered: Vec<usize> = all.iter().copied().filter(|&i| alike(i)).collect();
        let transfer = Transfer::of(campaign, &zero, &filtered);
        let (mut averaged, mut gained) = (filtered.clone(), Vec::new());
        if let Some(transfer) = &transfer {
            for &i in &all {
                if let Some((off, std)) = transfer.off(campaign, i, level(i)) {
                    tracing::debug!(
                        "set {}: level {:.1} DN, ln of the variance's ratio {off:+.4}, standard deviation {std:.4}",
                        campaign.sets[i].number,
                        level(i)
                    );
                }
            }
            for &i in &transfer.strays {
                let Some((off, std)) = transfer.off(campaign, i, level(i)) else { continue };
                let lit = campaign.sets[i].is_lit();
                // A well that is full bends the level too.
                let straight = campaign.sets[i].off.is_some_and(|off| off.abs() < STRAIGHT);
                let saturates = lit && level(i) > TOP * highest && !straight;
                if off < AVERAGED.ln() && off < -TOLD * std && !saturates {
                    averaged.push(i);
                } else if !lit && off > GAINED.ln() && off > TOLD * std {
                    gained.push((i, off));
                }
            }
        }
        averaged.sort_unstable();
        let mut out = Vec::new();
        if !averaged.is_empty() && averaged.len() as f64 <= (FEW * all.len() as f64).max(1.0) {
            let i = averaged[0];
            let ratio = transfer.as_ref().and_then(|t| t.off(campaign, i, level(i))).map(|o| o.0.exp());
            let text = match ratio {
                Some(ratio) if ratio < AVERAGED => format!(
                    "{}: frames were averaged or filtered over time before they were saved: variance of set {} is {} of what its level has elsewhere",
                    campaign.named(&averaged),
                    campaign.sets[i].number,
                    six_digits((ratio * 1000.0).round() / 1000.0)
                ),
                _ => format!(
                    "{}: frames were filtered over time before they were saved: successive frames are alike",
                    campaign.named(&averaged)
                ),
            };
            out.push(campaign.fault_of_sets(FaultKind::DependentFrames, &averaged, text, true));
        }
        for (i, off) in gained {
            let text = format!(
                "set {} ({}): another gain: the noise of this dark is {} times that of others at its level",
                campaign.sets[i].number,
                campaign.file(i, 0),
                six_digits((0.5 * off).exp())
            );
            out.push(campaign.fault_of_sets(FaultKind::OtherSettings, &[i], text, true));
        }
        out
    }
}
