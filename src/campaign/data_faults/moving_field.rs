//! Field that moves or changes its shape during a set: the image shifts, the lamp wanders.
//!
//! A shift d per frame changes a pixel by k d dI/dx over k frames (first order in d), so the variance of
//! the difference of frames k apart exceeds that of the noise by a term that grows with k^2. A temporal
//! filter with the correlation r makes it 2 sigma^2 (1 - r^k): frames two apart differ nearly as much as
//! the first and the last.

use super::{Campaign, Check, DataFault, FaultKind};
use crate::number::six_digits;

/// Minimum number of frames that distinguishes motion from a filter (this and the next three: named
/// choices).
const MIN_FRAMES: usize = 7;
/// Minimum ratio of the variance between the last frame and the third to that of successive ones.
const MIN_RATIO: f64 = 1.2;
/// Minimum ratio of the excess of that difference over the noise to the excess of frames two apart.
const MIN_GROWTH: f64 = 4.0;
/// Minimum significance of an excess variance, standard deviations.
const MIN_SIGMAS: f64 = 10.0;
/// Maximum contribution of motion to the variance in the frames that stay (a named choice).
const MAX_SHARE: f64 = 0.02;

/// Check for a moving field.
pub struct MovingField;

impl Check for MovingField {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let mut found = Vec::new();
        for i in campaign.places(|s| s.is_lit() && !s.clipped && s.kept.len() >= MIN_FRAMES) {
            let set = &campaign.sets[i];
            // Excluded frames may be among those compared.
            let whole = set.kept.iter().all(|kept| *kept);
            let Some((successive, _)) = set.variance_dn2().filter(|_| whole) else { continue };
            let n = set.facts.second_dn2.len();
            let second = set.facts.second_dn2[2..].iter().sum::<f64>() / (n - 2) as f64;
            let std = successive * (3.0 / set.facts.pixels).sqrt();
            let (grown, near) = (set.facts.ends_dn2 - successive, (second - successive).max(std));
            if set.facts.ends_dn2 < MIN_RATIO * successive
                || grown < (MIN_SIGMAS * std).max(MIN_GROWTH * near)
            {
                continue;
            }
            // The mean of k^2 over all pairs of m frames is m (m + 1) / 6.
            let of_one = grown / ((n - 3) as f64).powi(2);
            let added = |m: usize| of_one * (m * (m + 1)) as f64 / 6.0;
            let keep = (2..n).take_while(|m| added(*m) < MAX_SHARE * successive).last().unwrap_or(2);
            let frames: Vec<(usize, usize)> = (keep..n).map(|place| (i, place)).collect();
            let text = format!(
                "set {}: the field moves or changes while it is taken: frames {} apart differ by a variance of {} DN^2, successive ones by {}; \
                 frames {keep} to {}",
                set.number,
                n - 3,
                six_digits(set.facts.ends_dn2),
                six_digits(successive),
                n - 1
            );
            found.push((frames, text));
        }
        found
            .into_iter()
            .map(|(frames, text)| campaign.fault_of_frames(FaultKind::OddFrame, &frames, text))
            .collect()
    }
}
