//! Light on the second frame of a dark pair: the first one agrees with the other darks.

use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;

/// Maximum distance of a frame from the darks, standard deviations; ten times that shows light.
const MAX_DARK_SIGMAS: f64 = 10.0;
/// Minimum width of that band, DN.
const MIN_DARK_BAND_DN: f64 = 0.3;

/// Check for a lit frame in a dark pair.
pub struct LitDarkFrame;

impl Check for LitDarkFrame {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero() else { return Vec::new() };
        let darks = campaign.places(|s| s.kind == Kind::Dark);
        let same = (MAX_DARK_SIGMAS * zero.scatter_dn).max(MIN_DARK_BAND_DN);
        let lit: Vec<(usize, f64)> = darks
            .iter()
            .filter(|&&i| campaign.sets[i].frames() == 2)
            .filter_map(|&i| {
                let level = zero.at(campaign.sets[i].exposure_s);
                let off: Vec<f64> = campaign.sets[i].means_dn().iter().map(|m| m - level).collect();
                (off[0].abs() < same && off[1] > MAX_DARK_SIGMAS * same).then_some((i, off[1]))
            })
            .collect();
        if lit.is_empty() || lit.len() * 3 > darks.len() {
            return Vec::new();
        }
        let sets: Vec<usize> = lit.iter().map(|l| l.0).collect();
        let text = format!(
            "{}: light fell on the second frame of these darks ({} DN above the first, {})",
            campaign.named(&sets),
            six_digits(lit[0].1),
            campaign.file(sets[0], 1)
        );
        let frames: Vec<(usize, usize)> = sets.iter().map(|s| (*s, 1)).collect();
        vec![campaign.fault_of_frames(FaultKind::OddFrame, &frames, text)]
    }
}
