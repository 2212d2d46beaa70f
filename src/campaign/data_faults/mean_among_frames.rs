//! Mean of a set's frames saved among them, as first or last file: it has less noise than they have, and
//! correlates with theirs.

use super::set_view::SetView;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use crate::statistics::median::median;

/// Maximum ratio of the variance of the difference between a frame and the mean of m that includes it to
/// that of the difference of two frames: (1 - 1/m) / 2; higher for a median, and for a mean of other
/// frames. The limit is above that and below 1 (a named choice).
const MAX_RATIO: f64 = 0.7;
/// Minimum number of frames of a set at which the others determine their own noise.
const MIN_FRAMES: usize = 4;
/// Minimum noise variance above rounding, DN^2: rounding adds its own to the mean.
const MIN_VARIANCE_DN2: f64 = 0.5;
/// Maximum deviation of its level, relative to the signal and in DN: a mean has the level of its frames
/// (named choices).
const MAX_OFF: f64 = 0.01;
const MAX_OFF_DN: f64 = 0.5;
/// Minimum fraction of the sets that are affected.
const MIN_SETS: f64 = 0.5;

/// Check for a mean among the frames.
pub struct MeanAmongFrames;

/// Position of the mean in its set.
#[derive(Clone, Copy)]
enum End {
    First,
    Last,
}

impl Check for MeanAmongFrames {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let told = |s: &SetView| {
            let is_whole = s.kept.iter().all(|kept| *kept);
            matches!(s.kind, Kind::Dark | Kind::Flat) && !s.clipped && is_whole && s.frames() >= MIN_FRAMES
        };
        let sets = campaign.places(told);
        let zero = campaign.zero();
        for end in [End::Last, End::First] {
            let has_their_level = |i: &&usize| {
                let set = &campaign.sets[**i];
                let means = &set.facts.means_dn;
                let (own, others) = match end {
                    End::First => (means[0], &means[1..]),
                    End::Last => (means[means.len() - 1], &means[..means.len() - 1]),
                };
                let usual = median(others.iter().copied());
                let signal = usual - zero.as_ref().map_or(0.0, |z| z.at(set.exposure_s));
                (own - usual).abs() < MAX_OFF_DN.max(MAX_OFF * signal)
            };
            let ratios = sets.iter().filter(has_their_level);
            let ratios = ratios.filter_map(|&i| Some((i, ratio(&campaign.sets[i], end)?)));
            let found: Vec<(usize, f64)> = ratios.filter(|(_, ratio)| *ratio < MAX_RATIO).collect();
            if found.is_empty() || (found.len() as f64) < MIN_SETS * sets.len() as f64 {
                continue;
            }
            let place = |i: usize| match end {
                End::First => 0,
                End::Last => campaign.sets[i].frames() - 1,
            };
            let frames: Vec<(usize, usize)> = found.iter().map(|&(i, _)| (i, place(i))).collect();
            let own: Vec<usize> = found.iter().map(|f| f.0).collect();
            let usual = median(found.iter().map(|f| f.1));
            let text = format!(
                "{}: the {} frame ({}) is a mean of the others, saved among them: it differs from them by {} of the variance that they differ by",
                campaign.named(&own),
                match end {
                    End::First => "first",
                    End::Last => "last",
                },
                campaign.file(frames[0].0, frames[0].1),
                six_digits((100.0 * usual).round() / 100.0)
            );
            return vec![campaign.fault_of_frames(FaultKind::DependentFrames, &frames, text)];
        }
        Vec::new()
    }
}

/// Returns the variance of the differences to the frame at an end relative to that of the others, the
/// larger one of next and second-next frame; `None` if rounding hides it.
fn ratio(set: &SetView, end: End) -> Option<f64> {
    let (near, far) = (&set.facts.successive_dn2, &set.facts.second_dn2);
    let n = near.len();
    // The first frames may contain carry-over from the previous set.
    let (own_near, own_far, others) = match end {
        End::First => (near[1], far[2], &near[2..]),
        End::Last => (near[n - 1], far[n - 1], &near[2..n - 1]),
    };
    let usual = others.iter().sum::<f64>() / others.len() as f64;
    (usual > MIN_VARIANCE_DN2).then(|| own_near.max(own_far) / usual)
}
