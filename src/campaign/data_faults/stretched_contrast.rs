//! Codes stretched to the whole range for each set or frame by itself, as "Enhance contrast" and "auto" of an
//! export do: the distance of the codes differs from set to set, and levels and noise have no common unit.

use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;

/// Least ratio of the distances of the codes that are not one.
const MIN_RATIO: f64 = 1.02;
/// Least number of sets with distances of their own that reach full scale.
const MIN_SETS: usize = 3;

/// The check.
pub struct StretchedContrast;

impl Check for StretchedContrast {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let all = campaign.places(|s| matches!(s.kind, Kind::Dark | Kind::Flat));
        // A set of frames that were each stretched shows no step, and its first frame does.
        let step = |i: usize| campaign.sets[i].facts.code_step_dn.max(campaign.sets[i].facts.frame_step_dn);
        // A converter whose steps grow with the level reaches full scale in the brightest sets only.
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
