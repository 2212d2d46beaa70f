//! Exposures beyond a limit of the camera: flats of several stated exposures at one end of a sweep have
//! one level.

use super::campaign::Zero;
use super::transfer::{Transfer, above};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use crate::statistics::median::median;

/// Maximum relative difference of the levels of one exposure: lamps drift by less within a campaign (a
/// named choice).
const MAX_REL_OF_ONE_LEVEL: f64 = 0.01;
/// Minimum ratio of the longest to the shortest stated exposure of such flats, which their levels would
/// show.
const MIN_EXPOSURE_RATIO: f64 = 1.1;
/// Minimum number of other flats, and maximum relative deviation of their levels from proportionality to
/// exposure (named choices).
const MIN_OTHERS: usize = 3;
const MAX_REL_OF_OTHERS: f64 = 0.1;
/// Minimum ratio of their variance to that expected at their level: a full well, which also limits
/// levels, reduces noise.
const MIN_VARIANCE_RATIO: f64 = 0.8;

/// Check for exposures beyond a limit.
pub struct ExposureLimit;

/// End of a sweep.
#[derive(Clone, Copy, PartialEq)]
enum End {
    Shortest,
    Longest,
}

impl Check for ExposureLimit {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_one_bench()) else { return Vec::new() };
        let mut flats = campaign.places(|s| s.is_lit() && !s.clipped);
        let exposure_s = |i: usize| campaign.sets[i].exposure_s;
        flats.sort_by(|a, b| exposure_s(*a).total_cmp(&exposure_s(*b)));
        let light = |i: usize| campaign.sets[i].illumination;
        if flats.iter().any(|&i| light(i) != light(flats[0])) {
            return Vec::new();
        }
        let level = |i: usize| above(campaign, &zero, i);
        let mut out = Vec::new();
        for end in [End::Shortest, End::Longest] {
            if end == End::Longest {
                flats.reverse();
            }
            // Flats of one level, from this end.
            let first = flats.first().map_or(f64::NAN, |&i| level(i));
            let is_one = |i: &&usize| (level(**i) / first - 1.0).abs() < MAX_REL_OF_ONE_LEVEL;
            let group: Vec<usize> = flats.iter().take_while(is_one).copied().collect();
            let others = &flats[group.len()..];
            let (Some(&a), Some(&b)) = (group.first(), group.last()) else { continue };
            let ratio = exposure_s(a) / exposure_s(b);
            if ratio.max(ratio.recip()) < MIN_EXPOSURE_RATIO || others.len() < MIN_OTHERS {
                continue;
            }
            let per_s = median(others.iter().map(|&i| level(i) / exposure_s(i)));
            let are_straight =
                others.iter().all(|&i| (level(i) / exposure_s(i) / per_s - 1.0).abs() < MAX_REL_OF_OTHERS);
            let limit_s = median(group.iter().map(|&i| level(i))) / per_s;
            // The flat nearest to the limit may be correct.
            let is_beyond = |i: &usize| match end {
                End::Shortest => exposure_s(*i) < limit_s / MIN_EXPOSURE_RATIO,
                End::Longest => exposure_s(*i) > limit_s * MIN_EXPOSURE_RATIO,
            };
            let mut beyond: Vec<usize> = group.iter().filter(|i| is_beyond(i)).copied().collect();
            beyond.sort_unstable();
            if !are_straight || beyond.is_empty() {
                continue;
            }
            if end == End::Longest && !have_noise_of_level(campaign, &zero, &beyond) {
                continue;
            }
            // Darks beyond the limit have wrong exposures too, which only the limit reveals.
            let mut darks = campaign.places(|s| s.kind == Kind::Dark);
            let all = darks.len();
            darks.retain(|i| is_beyond(i));
            darks.truncate(if darks.len() < all { darks.len() } else { 0 });
            let stated: Vec<String> =
                beyond.iter().map(|&i| format!("{} s", six_digits(exposure_s(i)))).collect();
            let text = format!(
                "{}: stated exposures of {}, and the level of all is that of {} s: the camera does not expose {}",
                campaign.named(&beyond),
                stated.join(", "),
                six_digits(limit_s),
                if end == End::Shortest { "shorter" } else { "longer" }
            );
            let text = match darks.as_slice() {
                [] => text,
                darks => format!(
                    "{text}; the exposure of {}, darks, is as little what it says",
                    campaign.named(darks)
                ),
            };
            beyond.extend(darks);
            beyond.sort_unstable();
            out.push((beyond, text));
        }
        let fault = |(sets, text): (Vec<usize>, String)| {
            campaign.fault_of_sets(FaultKind::SettingLabel, &sets, text, true)
        };
        out.into_iter().map(fault).collect()
    }
}

/// Returns true if the noise of the sets is known and fits their level.
fn have_noise_of_level(campaign: &Campaign<'_>, zero: &Zero, sets: &[usize]) -> bool {
    let Some(transfer) = Transfer::of(campaign, zero, sets) else { return false };
    let off = |i: usize| transfer.off(campaign, i, above(campaign, zero, i));
    sets.iter().all(|&i| off(i).is_some_and(|(off, _)| off > MIN_VARIANCE_RATIO.ln()))
}
