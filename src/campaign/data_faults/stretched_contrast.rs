//! Codes stretched to the full range for each set or frame separately, as "Enhance contrast" and "auto"
//! of an export do: the code step differs between sets, and levels and noise have no common unit.

use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;

/// Minimum ratio of different code steps.
const MIN_RATIO: f64 = 1.02;
/// Minimum number of sets with their own code step that reach full scale.
const MIN_SETS: usize = 3;

/// Check for stretched contrast.
pub struct StretchedContrast;

impl Check for StretchedContrast {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let all = campaign.places(|s| matches!(s.kind, Kind::Dark | Kind::Flat));
        // A set of individually stretched frames shows no step, but its first frame does.
        let step = |i: usize| campaign.sets[i].facts.code_step_dn.max(campaign.sets[i].facts.frame_step_dn);
        // With level-dependent converter steps only the brightest sets reach full scale.
        let is_full = |i: &usize| step(*i) > 1.0 && campaign.sets[*i].facts.clipped > 0.0;
        let mut own: Vec<usize> = all.iter().copied().filter(is_full).collect();
        own.sort_by(|a, b| step(*a).total_cmp(&step(*b)));
        own.dedup_by(|a, b| step(*a) < MIN_RATIO * step(*b));
        let &[least, .., most] = own.as_slice() else { return Vec::new() };
        if own.len() < MIN_SETS {
            return Vec::new();
        }
        let text = format!(
            "all sets: each set, or frame, was stretched by itself: neighbouring codes are {} apart in {}, and {} in {}, as an export with automatic contrast writes them; levels and noise cannot be compared: export the raw codes",
            six_digits(step(most)),
            campaign.named(&[most]),
            six_digits(step(least)),
            campaign.named(&[least]),
        );
        vec![campaign.fault_of_sets(FaultKind::OtherSettings, &all, text, true)]
    }
}
