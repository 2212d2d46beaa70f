//! Means of N frames rounded to whole codes: half-way values go to even codes (IEEE 754, as in numpy's
//! `round` and OpenCV), so (N + 1) / 2N of the samples of all sets are even if N is even.
//!
//! One mean in N lies half-way between two codes, and half of those would have gone to odd ones. Codes
//! themselves are even or odd equally often if they spread over several.

use super::set_view::SetView;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;

/// Numbers of frames tested. The lowest bit of a converter may look like larger ones and those between.
const FRAMES: [u32; 3] = [2, 4, 8];
/// Minimum variance of the samples of a frame at which even and odd codes are equally frequent, DN^2:
/// for normal samples of variance v even codes have 0.5 +- exp(-pi^2 v / 2).
const MIN_SPREAD_DN2: f64 = 3.0;
/// Minimum temporal variance at which a pixel has another code in the next frame, DN^2 (a named choice):
/// with less, frames repeat their pixels.
const MIN_NEW_DN2: f64 = 1.0;
/// Maximum code step without missing codes: multiplied codes have their own excess.
const MAX_STEP_DN: f64 = 1.1;
/// Minimum number of sets.
const MIN_SETS: usize = 3;
/// Maximum relative standard error of the excess (a named choice): at this error an arbitrary excess matches
/// one of the numbers in one case of ten.
const MAX_REL_ERROR: f64 = 0.02;
/// Maximum distance of the excess from that of N, standard errors.
const SIGMAS: f64 = 3.0;

/// Check for rounded means.
pub struct RoundedMeans;

impl Check for RoundedMeans {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let tells = |s: &SetView| {
            matches!(s.kind, Kind::Dark | Kind::Flat)
                && !s.clipped
                && !s.is_cut_off()
                && s.facts.even_share > 0.0
                && s.facts.spread_dn2 >= MIN_SPREAD_DN2
                && s.facts.step_dn < MAX_STEP_DN
                && s.facts.code_step_dn == 1.0
        };
        let sets = campaign.places(tells);
        let of = |i: &usize| {
            let set = &campaign.sets[*i];
            let is_new = set.variance_dn2().is_some_and(|v| v.0 > MIN_NEW_DN2);
            let frames = if is_new { set.frames() as f64 } else { 1.0 };
            (set.facts.even_share - 0.5, set.facts.pixels * frames)
        };
        let of_kind = |kind: Kind| sets.iter().copied().filter(|i| campaign.sets[*i].kind == kind).collect();
        let groups: [Vec<usize>; 3] = [sets.clone(), of_kind(Kind::Flat), of_kind(Kind::Dark)];
        let number = |sets: &[usize]| frames_in_a_mean(&sets.iter().map(of).collect::<Vec<_>>());
        let Some((n, sets)) = groups.into_iter().find_map(|sets| Some((number(&sets)?, sets))) else {
            return Vec::new();
        };
        let text = format!(
            "{}: {} % of the samples are even codes, as in means of {n} frames that were rounded (numpy, OpenCV): system gain of such means is {n} times \
             too low. Import the frames that they were made of. Means of {n} pixels, codes divided by {n}, and a lowest bit of the converter that is off \
             by 1/{n} DN do the same",
            campaign.named(&sets),
            six_digits((1000.0 * (0.5 + 0.5 / f64::from(n))).round() / 10.0)
        );
        vec![campaign.fault_of_sets(FaultKind::DependentFrames, &sets, text, false)]
    }
}

/// Finds the number of averaged frames that explains the excess of all sets. `excess`: fraction of even
/// codes above a half, and samples.
fn frames_in_a_mean(excess: &[(f64, f64)]) -> Option<u32> {
    if excess.len() < MIN_SETS {
        return None;
    }
    let n = excess.len() as f64;
    let mean = excess.iter().map(|e| e.0).sum::<f64>() / n;
    let scatter = excess.iter().map(|e| (e.0 - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let of_chance = excess.iter().map(|e| 0.25 / e.1).sum::<f64>() / n;
    let std_err = (scatter.max(of_chance) / n).sqrt();
    FRAMES.into_iter().find(|frames| {
        let own = 0.5 / f64::from(*frames);
        (mean - own).abs() < SIGMAS * std_err && std_err < MAX_REL_ERROR * own
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An excess is explained by the number of averaged frames only if it is that of every set; any
    /// other is not.
    #[test]
    fn the_number_of_frames_is_found() {
        let of = |shares: [f64; 3]| frames_in_a_mean(&shares.map(|s| (s - 0.5, 1e6)));
        assert_eq!(of([0.7501, 0.7499, 0.7502]), Some(2));
        assert_eq!(of([0.5624, 0.5626, 0.5625]), Some(8));
        assert_eq!(of([0.51, 0.5101, 0.5099]), None);
        assert_eq!(of([0.75, 0.5, 0.75]), None);
        assert_eq!(frames_in_a_mean(&[(0.25, 1e6); 2]), None);
    }
}
