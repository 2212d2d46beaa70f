//! Sets whose frames have two levels: light or exposure was changed during the set, or a strobe missed
//! some frames. Frames at the level of the setting stay.

use super::campaign::Zero;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::number::{percent, six_digits};
use crate::statistics::median::median;

/// Minimum distance of the levels: relative to the signal, in standard deviations of a frame's mean, and
/// in DN.
const MIN_DISTANCE: (f64, f64, f64) = (0.01, 20.0, 3.0);
/// Maximum range of the frames of one level, relative to the distance: flicker and settling have no
/// distinct levels.
const MAX_RANGE: f64 = 0.1;
/// Maximum ratio of the distances from the level of the setting at which the nearer level is accepted.
const NEARER: f64 = 0.3;
/// Maximum fraction of the sets that are isolated faults: more are a property of the lamp or the camera.
const MAX_SHARE_OF_SETS: f64 = 0.25;
/// Maximum fraction of the signal of the setting in frames without light.
const UNLIT: f64 = 0.01;

/// Check for frames of two levels.
pub struct FramesOfTwoLevels;

/// Frames of one set, separated by level.
struct Parted {
    set: usize,
    /// Indices of the frames and their level, DN: of the lower level and of the higher one.
    parts: [(Vec<usize>, f64); 2],
}

impl Check for FramesOfTwoLevels {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero() else { return Vec::new() };
        let scatter = campaign.scatter(&zero);
        let sets = campaign.places(|s| s.is_lit() && !s.clipped && s.frames() >= 4);
        let parted = |&set: &usize| {
            let view = &campaign.sets[set];
            let signal_dn = view.level_dn() - zero.at(view.exposure_s);
            let (relative, sigmas, dn) = MIN_DISTANCE;
            let least_dn = dn.max(relative * signal_dn).max(sigmas * scatter.of_frame_dn(view));
            parts_of(&view.means_dn(), &view.kept, least_dn).map(|parts| Parted { set, parts })
        };
        let found: Vec<Parted> = sets.iter().filter_map(parted).collect();
        if found.len() as f64 > (MAX_SHARE_OF_SETS * sets.len() as f64).max(1.0) {
            return Vec::new();
        }
        let is_parted = |set: &usize| found.iter().any(|f| f.set == *set);
        let others: Vec<(f64, f64)> = sets
            .iter()
            .filter(|set| !is_parted(set))
            .map(|&set| {
                let view = &campaign.sets[set];
                (view.light(), view.level_dn() - zero.at(view.exposure_s))
            })
            .collect();
        found.into_iter().filter_map(|parted| fault(campaign, &zero, &others, &parted)).collect()
    }
}

/// Returns the signal at a light, DN, interpolated between the neighbouring flats (light, signal in DN)
/// by a power law of the light; beyond them in proportion to the light. `None` without flats.
fn signal_at(light: f64, flats: &[(f64, f64)]) -> Option<f64> {
    let by_light = |a: &&(f64, f64), b: &&(f64, f64)| a.0.total_cmp(&b.0);
    let below = flats.iter().filter(|f| f.0 <= light && f.1 > 0.0).max_by(by_light);
    let above = flats.iter().filter(|f| f.0 >= light && f.1 > 0.0).min_by(by_light);
    let proportion = |f: &(f64, f64)| f.1 * light / f.0;
    match (below, above) {
        (Some(a), Some(b)) if b.0 > a.0 => {
            let power = (b.1 / a.1).ln() / (b.0 / a.0).ln();
            Some(a.1 * (light / a.0).powf(power))
        }
        (Some(one), _) | (None, Some(one)) => Some(proportion(one)),
        (None, None) => None,
    }
}

/// Creates the fault of frames of two levels; `None` if no other flat determines the level of the
/// setting.
fn fault(
    campaign: &mut Campaign<'_>,
    zero: &Zero,
    others: &[(f64, f64)],
    parted: &Parted,
) -> Option<DataFault> {
    let set = parted.set;
    let zero_dn = zero.at(campaign.sets[set].exposure_s);
    let expected_dn = zero_dn + signal_at(campaign.sets[set].light(), others)?;
    let off = |k: usize| (parted.parts[k].1 - expected_dn).abs();
    let nearer = usize::from(off(1) < off(0));
    let ((_, level_dn), (wrong, wrong_dn)) = (&parted.parts[nearer], &parted.parts[1 - nearer]);
    let name = campaign.named(&[set]);
    if off(nearer) < NEARER * off(1 - nearer) {
        let number = wrong.len();
        let what = if (wrong_dn - zero_dn) < UNLIT * (expected_dn - zero_dn) {
            "as without light".to_owned()
        } else {
            let factor = (wrong_dn - zero_dn) / (level_dn - zero_dn);
            format!(
                "{} {}",
                percent((factor - 1.0).abs()),
                if factor > 1.0 { "more signal" } else { "less signal" }
            )
        };
        let text = format!(
            "{name}: {number} of its frames, the first of them {}, have {} DN, {what}; the others have the {} DN of its setting",
            campaign.file(set, wrong[0]),
            six_digits(*wrong_dn),
            six_digits(*level_dn),
        );
        let frames: Vec<(usize, usize)> = wrong.iter().map(|place| (set, *place)).collect();
        return Some(campaign.fault_of_frames(FaultKind::OddFrame, &frames, text));
    }
    let [(_, low), (_, high)] = &parted.parts;
    let text = format!(
        "{name}: some of its frames have {} DN and some {} DN, and neither is the {} DN of its setting",
        six_digits(*low),
        six_digits(*high),
        six_digits(expected_dn)
    );
    Some(campaign.fault_of_sets(FaultKind::OddFrame, &[set], text, true))
}

/// Returns indices and levels of the frames on both sides of the widest gap between their means; `None`
/// for a single level, or if only one frame stands out.
fn parts_of(means_dn: &[f64], kept: &[bool], least_dn: f64) -> Option<[(Vec<usize>, f64); 2]> {
    let places = kept.iter().enumerate().filter(|(_, kept)| **kept).map(|(place, _)| place);
    let mut all: Vec<(f64, usize)> = means_dn.iter().copied().zip(places).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let gap = |k: &usize| all[*k].0 - all[*k - 1].0;
    let at = (1..all.len()).max_by(|a, b| gap(a).total_cmp(&gap(b)))?;
    let range = |part: &[(f64, usize)]| part[part.len() - 1].0 - part[0].0;
    let distance = gap(&at);
    let (low, high) = all.split_at(at);
    let apart = distance > least_dn && range(low).max(range(high)) < MAX_RANGE * distance;
    let part = |part: &[(f64, usize)]| {
        let mut places: Vec<usize> = part.iter().map(|(_, place)| *place).collect();
        places.sort_unstable();
        (places, median(part.iter().map(|(mean, _)| *mean)))
    };
    (apart && low.len() > 1 && high.len() > 1).then(|| [part(low), part(high)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// For a gamma of 0.6 the signal follows the power law between neighbours, and proportionality
    /// beyond them.
    #[test]
    fn levels_lie_between_their_neighbours() {
        let of = |light: f64| 1000.0 * light.powf(0.6);
        let flats = [0.8, 0.1, 0.4].map(|light| (light, of(light)));
        assert!((signal_at(0.2, &flats).unwrap() / of(0.2) - 1.0).abs() < 1e-9);
        assert!((signal_at(0.4, &flats).unwrap() / of(0.4) - 1.0).abs() < 1e-9);
        assert!((signal_at(1.6, &flats).unwrap() / of(0.8) - 2.0).abs() < 1e-9);
        assert_eq!(signal_at(0.4, &[]), None);
    }

    /// Two levels are separated, in blocks or alternating; a single odd frame, growing steps, and noise
    /// are not.
    #[test]
    fn two_levels_are_parted() {
        let parts = |means: &[f64]| parts_of(means, &vec![true; means.len()], 10.0).map(|p| p.map(|p| p.0));
        assert_eq!(parts(&[100.0, 300.0, 101.0, 301.0]), Some([vec![0, 2], vec![1, 3]]));
        assert_eq!(parts(&[300.0, 301.0, 300.5, 299.0, 200.0, 201.0]), Some([vec![4, 5], vec![0, 1, 2, 3]]));
        assert_eq!(parts(&[300.0, 301.0, 300.5, 200.0]), None);
        assert_eq!(parts(&[100.0, 120.0, 140.0, 160.0, 180.0]), None);
        assert_eq!(
            parts_of(&[1.0, 2.0, 30.0, 31.0], &[true, false, true, true, true], 10.0).unwrap()[1].0,
            [3, 4]
        );
        for seed in 0..2000 {
            let mean = |k: usize| 50.0 * PixelRng::new(3, Stream::Frame, k as u64, seed, 0).normal();
            let means: Vec<f64> = (0..8).map(mean).collect();
            assert_eq!(parts(&means), None, "{means:?}");
        }
    }
}
