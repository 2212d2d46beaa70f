//! First frames of all flats that deviate by one fraction of their own light: a lamp that starts dim at
//! each level.
//!
//! Stale frames and lag deviate by a fraction of the level change instead. Lag after unsaved dark frames
//! also deviates by a fraction of the light, but its noise distinguishes it (see `against_lag`).

use super::set_view::MIN_SIGMAS_AGAINST_LAG;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::number::{percent, six_digits};
use crate::statistics::median::median;

/// Minimum deviation relative to the light, minimum significance in standard deviations of a frame's
/// mean, and maximum relative difference of the fractions (named choices: smaller ones are harmless).
const MIN_SHARE: f64 = 0.005;
const MIN_SIGMAS: f64 = 8.0;
const MAX_REL_OF_SHARES: f64 = 0.15;
/// Minimum fraction of the flats that agree.
const MIN_AGREEING: f64 = 0.8;
/// Maximum deviation of the later frames, relative to that of the first: a lamp that warms up changes
/// gradually.
const MAX_OF_OTHERS: f64 = 0.34;
/// Minimum number of flats, and of frames of each.
const MIN_FLATS: usize = 4;
const MIN_FRAMES: usize = 3;
/// Minimum fraction of a level change in a first frame exposed under the previous settings.
const MIN_SHARE_OF_CHANGE: f64 = 0.25;
/// Maximum relative difference of the fraction of a level change in a dark after light from that in the
/// flats.
const MAX_REL_OF_DARK: f64 = 0.3;

/// Check for dim first frames.
pub struct DimFirsts;

/// First frame of a flat.
struct First {
    set: usize,
    /// Deviation from the later frames relative to their signal, and its standard deviation by noise.
    share: f64,
    std: f64,
    /// Deviation relative to the level change from the previous set.
    of_change: Option<f64>,
    /// True if the later frames agree with one another.
    alone: bool,
}

impl Check for DimFirsts {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero() else { return Vec::new() };
        let flats = campaign.places(|s| s.is_lit() && !s.clipped && s.frames() >= MIN_FRAMES && s.kept[0]);
        let first = |&set: &usize| {
            let own = &campaign.sets[set];
            let means = own.means_dn();
            let level = median(means[1..].iter().copied());
            let signal = level - zero.at(own.exposure_s);
            let off = means[0] - level;
            let noise_dn = (own.variance_dn2()?.0 / own.facts.pixels.max(1.0) * means.len() as f64
                / (means.len() - 1) as f64)
                .sqrt();
            let change = set.checked_sub(1).map(|b| campaign.sets[b].last_dn() - level);
            Some(First {
                set,
                share: off / signal,
                std: noise_dn / signal,
                of_change: change.map(|c| off / c).filter(|s| s.is_finite()),
                alone: means[1..].iter().all(|m| (m - level).abs() < MAX_OF_OTHERS * off.abs()),
            })
            .filter(|_| signal > 0.0)
        };
        let firsts: Vec<First> = flats.iter().filter_map(first).collect();
        let share = median(firsts.iter().map(|f| f.share));
        let agrees = |f: &&First| {
            f.alone
                && f.share.abs() > MIN_SIGMAS * f.std
                && (f.share - share).abs() < MAX_REL_OF_SHARES * share.abs()
        };
        let agreeing: Vec<&First> = firsts.iter().filter(agrees).collect();
        if firsts.len() < MIN_FLATS
            || share.abs() < MIN_SHARE
            || (agreeing.len() as f64) < MIN_AGREEING * firsts.len() as f64
            || are_of_changes(campaign, &agreeing)
            || !lack_lag(campaign, &agreeing, share)
        {
            return Vec::new();
        }
        let set = agreeing[0].set;
        let means = campaign.sets[set].means_dn();
        let sets: Vec<usize> = firsts.iter().map(|f| f.set).collect();
        let text = format!(
            "{}: the first frame is {} {} the others of its set, at every level (set {}: {} DN, its other frames {} DN): the lamp starts {}",
            campaign.named(&sets),
            percent(share.abs()),
            if share < 0.0 { "below" } else { "above" },
            campaign.sets[set].number,
            six_digits(means[0]),
            six_digits(median(means[1..].iter().copied())),
            if share < 0.0 { "dim" } else { "bright" }
        );
        let frames: Vec<(usize, usize)> = sets.into_iter().map(|set| (set, 0)).collect();
        vec![campaign.fault_of_frames(FaultKind::OddFrame, &frames, text)]
    }
}

/// Returns true if the first frames also deviate by one fraction of the level changes, as in sweeps whose
/// levels grow by one factor, and that is a large one, or a dark after light has it too: no lamp starts
/// bright in darkness.
fn are_of_changes(campaign: &Campaign<'_>, firsts: &[&First]) -> bool {
    let of: Vec<f64> = firsts.iter().filter_map(|f| f.of_change).collect();
    let share = median(of.iter().copied());
    let agree = of.iter().filter(|s| (*s - share).abs() < MAX_REL_OF_SHARES * share.abs()).count();
    let in_dark = |&set: &usize| {
        let of_change = campaign.share_of_change(set)?;
        Some((of_change - share).abs() < MAX_REL_OF_DARK * share)
    };
    let after_light = campaign.places(|s| !s.is_lit() && s.frames() >= MIN_FRAMES);
    let is_in_darks = || after_light.iter().filter_map(in_dark).any(|is_alike| is_alike);
    2 * agree > of.len() && (share > MIN_SHARE_OF_CHANGE || share > 0.0 && is_in_darks())
}

/// Returns true if the combined noise of all flats contradicts lag of this fraction after darkness.
fn lack_lag(campaign: &Campaign<'_>, firsts: &[&First], share: f64) -> bool {
    let Some(darkest) = campaign.darkest() else { return false };
    let of = |f: &&First| campaign.sets[f.set].against_lag(share.abs(), darkest);
    let (off, var) = firsts.iter().filter_map(of).fold((0.0, 0.0), |(a, b), (o, std)| (a + o, b + std * std));
    // A brighter first frame is not lag after darkness.
    share > 0.0 || off > MIN_SIGMAS_AGAINST_LAG * var.sqrt() && var > 0.0
}
