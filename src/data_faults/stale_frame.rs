//! The first frame of a set has the level of the set before: the camera exposed it before the new settings held.

use super::{Campaign, Check, DataFault, FaultKind};
use crate::number::six_digits;

/// Standard deviations of a frame's mean by which two levels must differ to be told apart.
const APART: f64 = 12.0;
/// Least difference of the levels, DN.
const APART_DN: f64 = 1.0;
/// Standard deviations within which the frame has the level of the set before.
const SAME: f64 = 8.0;
/// Share of the difference within which it does at least: what lag leaves of a level is far less than all of it.
const SAME_SHARE: f64 = 0.03;

/// The check.
pub struct StaleFrame;

impl Check for StaleFrame {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero() else { return Vec::new() };
        let mut stale = Vec::new();
        for k in 1..campaign.sets.len() {
            let (before, own) = (&campaign.sets[k - 1], &campaign.sets[k]);
            if before.out || own.out || own.frames() < 2 {
                continue;
            }
            let means = own.means_dn();
            let level = crate::statistics::median::median(means[1..].iter().copied());
            let Some(&last) = before.means_dn().last() else { continue };
            let scatter = campaign.frame_scatter_dn(k, &zero).hypot(campaign.frame_scatter_dn(k - 1, &zero));
            let apart = (last - level).abs();
            if apart < APART_DN.max(APART * scatter) {
                continue;
            }
            // What a lamp does from frame to frame is known for flats that scatter; a clipped level has none.
            if (means[0] - last).abs() < (SAME * scatter).min(0.3 * apart).max(SAME_SHARE * apart) {
                stale.push((k, 0, means[0], level));
            }
        }
        if stale.is_empty() {
            return Vec::new();
        }
        let sets: Vec<usize> = stale.iter().map(|s| s.0).collect();
        let (first, _, is, others) = stale[0];
        let text = format!(
            "{}: the first frame has the level of the set before (set {}: {} DN, its other frames {} DN): exposed before the new settings held",
            campaign.named(&sets),
            campaign.sets[first].number,
            six_digits(is),
            six_digits(others)
        );
        let frames: Vec<(usize, usize)> = stale.iter().map(|s| (s.0, s.1)).collect();
        vec![campaign.fault_of_frames(FaultKind::StaleFrame, &frames, text)]
    }
}
