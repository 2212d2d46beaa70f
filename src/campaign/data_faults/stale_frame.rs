//! Stale first frame of a set, exposed under the settings of the previous set: all of them, or only its
//! exposure or light.

use super::campaign::{Scatter, Zero};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::number::{percent, six_digits};
use crate::statistics::median::{MAD_OF_NORMAL, median};

/// Minimum difference of two distinguishable levels, standard deviations of a frame's mean.
const MIN_SEPARATION_SIGMAS: f64 = 12.0;
/// Minimum difference of the levels, DN.
const MIN_SEPARATION_DN: f64 = 1.0;
/// Maximum distance of the frame from the previous level, standard deviations.
const MAX_MATCH_SIGMAS: f64 = 8.0;
/// Maximum distance relative to the difference, as an alternative: lag leaves far less than the whole
/// level.
const MIN_MATCH_SHARE: f64 = 0.03;

/// Maximum distance, relative to the difference, from a level of the old exposure or light that is only
/// derived from the ratio of the labels.
const MAX_LABEL_MISMATCH: f64 = 0.12;

/// Minimum relative difference of an old level from the new one.
const MIN_REL_APART: f64 = 0.05;
/// Minimum fraction of stale sets, among those that could show it, at which all are assumed stale.
const MIN_STALE_SHARE: f64 = 0.7;
/// Maximum fraction of a level that lag or a filter carries over to the next frame.
const MAX_CARRIED_SHARE: f64 = 0.5;

/// Minimum fraction of the previous settings in a frame exposed under both (a named choice): image lag
/// with electrons that stay at random, which means and noise cannot distinguish from it, is smaller.
const MIN_SHARE_OF_BOTH: f64 = 0.25;
/// Maximum relative difference of the fractions of such frames.
const MAX_REL_OF_SHARES: f64 = 0.2;
/// Minimum number of level changes, and of flats, that distinguishes such frames from others and from
/// lag.
const MIN_CHANGES_OF_BOTH: usize = 3;
const MIN_FLATS_OF_BOTH: usize = 3;
/// Maximum number of stale frames of a set: pipelines of cameras and drivers hold two or three.
const MAX_STALE_FRAMES: usize = 3;
/// Minimum number of remaining frames of a set with several stale ones.
const MIN_FRAMES_LEFT: usize = 3;

/// Check for stale frames.
pub struct StaleFrame;

/// First frame of a set with its possible levels.
struct First {
    set: usize,
    /// Levels under the previous settings, DN, with true for measured ones.
    old_dn: Vec<(f64, bool)>,
    /// Mean of this frame, and median of the other frames, DN.
    own_dn: f64,
    others_dn: f64,
    /// True for an exact copy of the last frame of the previous set.
    copy: bool,
}

impl First {
    fn of(campaign: &Campaign<'_>, zero: &Zero, set: usize) -> Option<Self> {
        let own = &campaign.sets[set];
        let means = own.means_dn();
        let [own_dn, others @ ..] = &*means else { return None };
        let others_dn = median(others.iter().copied());
        if own.out || others.is_empty() {
            return None;
        }
        let before = |lit: Option<bool>| {
            let earlier = campaign.sets[..set].iter().rev();
            earlier.filter(|s| !s.out && s.frames() > 0).find(|s| lit.is_none_or(|l| s.is_lit() == l))
        };
        let mut old_dn: Vec<(f64, bool)> = Vec::new();
        let direct = Some(&campaign.sets[set - 1]).filter(|b| !b.out);
        // A frame after a stale one is not a copy of the previous set.
        let copy = own.kept.first() == Some(&true)
            && direct.is_some_and(|b| b.facts.digests.last() == own.facts.digests.first());
        old_dn.extend(direct.and_then(|b| b.means_dn().last().copied()).map(|m| (m, true)));
        // With the old exposure the light may already be the new one, or vice versa: a flat among darks
        // follows the previous flat.
        for other in [direct, before(Some(own.is_lit()))].into_iter().flatten() {
            let signal = others_dn - zero.at(own.exposure_s);
            if !own.is_lit() && other.is_lit() {
                let signal = other.behind_first_dn() - zero.at(other.exposure_s);
                old_dn.push((zero.at(own.exposure_s) + signal * own.exposure_s / other.exposure_s, false));
            }
            if own.is_lit() {
                old_dn.push((zero.at(other.exposure_s) + signal * other.exposure_s / own.exposure_s, false));
                if other.is_lit() {
                    old_dn.push((
                        zero.at(own.exposure_s) + signal * other.illumination / own.illumination,
                        false,
                    ));
                }
            }
            if other.kind == own.kind {
                old_dn.extend(other.means_dn().last().map(|m| (*m, true)));
            }
        }
        // A strobe that missed the frame, or a stale frame of the dark before.
        if own.is_lit() {
            old_dn.push((zero.at(own.exposure_s), false));
        }
        let full = campaign.full_scale_dn;
        old_dn.iter_mut().for_each(|o| o.0 = o.0.min(full));
        Some(Self { set, old_dn, own_dn: *own_dn, others_dn, copy })
    }

    /// Returns true for a level that differs from that of the other frames.
    fn is_far(&self, old_dn: f64) -> bool {
        (old_dn - self.others_dn).abs() > MIN_REL_APART * old_dn.max(self.others_dn)
    }

    /// Returns the deviation from the nearest old level, DN; `None` if all are near the other frames'
    /// level.
    fn off_dn(&self) -> Option<f64> {
        let far = self.old_dn.iter().filter(|o| self.is_far(o.0)).map(|o| (self.own_dn - o.0).abs());
        far.min_by(f64::total_cmp)
    }

    fn is_stale(&self, scatter_dn: f64) -> bool {
        self.old_dn.iter().any(|(old, measured)| {
            let apart = (old - self.others_dn).abs();
            let within = match measured {
                true => (MAX_MATCH_SIGMAS * scatter_dn).min(0.3 * apart).max(MIN_MATCH_SHARE * apart),
                false => MAX_LABEL_MISMATCH * apart,
            };
            apart > MIN_SEPARATION_DN.max(MIN_SEPARATION_SIGMAS * scatter_dn)
                && (self.own_dn - old).abs() < within
        })
    }
}

/// Sets whose first frame in use is stale, and the fraction of the previous settings in it if it was
/// exposed under both.
#[derive(Default)]
struct Stale {
    sets: Vec<usize>,
    share: Option<f64>,
}

/// Finds stale frames among the first ones in use of all sets.
fn stale_firsts(campaign: &Campaign<'_>) -> Stale {
    // The mean of a pair may contain a stale frame.
    let Some(zero) = campaign.zero_behind_firsts() else { return Stale::default() };
    let firsts: Vec<First> = (1..campaign.sets.len()).filter_map(|k| First::of(campaign, &zero, k)).collect();
    let usual_scatter = campaign.scatter(&zero);
    // Scatter is overestimated if all first frames are stale: then their distance from the old
    // levels is used. Where darks follow each flat the stale frames of flats alone show.
    let level = |s: usize| (campaign.sets[s].behind_first_dn() - zero.dn).abs().max(1.0);
    let scale = |f: &First| level(f.set).max(level(f.set - 1));
    let is_lit = |f: &First| campaign.sets[f.set].is_lit();
    let meets = [false, true].map(|lit| {
        let of_kind = firsts.iter().filter(|f| is_lit(f) == lit);
        median(of_kind.filter_map(|f| Some(f.off_dn()? / scale(f)))) / MAD_OF_NORMAL
    });
    let scatter = |f: &First| {
        let of_frame = |s: usize| usual_scatter.of_frame_dn(&campaign.sets[s]);
        let usual = of_frame(f.set).hypot(of_frame(f.set - 1));
        let noise = |s: usize| {
            campaign.sets[s].variance_dn2().map_or(0.0, |v| v.0 / campaign.sets[s].facts.pixels.max(1.0))
        };
        let least = (noise(f.set) + noise(f.set - 1)).sqrt().max(0.03);
        let meets = meets[usize::from(is_lit(f))];
        if meets.is_finite() { usual.min((meets * scale(f)).max(least)) } else { usual }
    };
    // Lag and filters may carry over as much as an old exposure would cause.
    let share = campaign.carried(&usual_scatter).filter(|s| s.abs() < MAX_CARRIED_SHARE);
    let carried = |f: &First| {
        let change = campaign.sets[f.set - 1].level_dn() - f.others_dn;
        let off = f.own_dn - f.others_dn;
        share.is_some_and(|s| s.abs() > 1e-3 && (off - s * change).abs() < 0.2 * off.abs())
    };
    for f in &firsts {
        tracing::debug!(
            "set {}: first frame {:.1} DN, others {:.1} DN, old levels {:.1?}, scatter {:.2} DN, carried {}",
            campaign.sets[f.set].number,
            f.own_dn,
            f.others_dn,
            f.old_dn,
            scatter(f),
            carried(f)
        );
    }
    let stale: Vec<&First> =
        firsts.iter().filter(|f| f.copy || (f.is_stale(scatter(f)) && !carried(f))).collect();
    // A copy of a frame with equal settings is a duplicate, nothing more.
    let told = |f: &&&First| {
        !f.copy
            || (f
                .old_dn
                .first()
                .is_some_and(|o| (o.0 - f.others_dn).abs() > MIN_SEPARATION_SIGMAS * scatter(f)))
    };
    let stale: Vec<&First> = stale.iter().filter(told).copied().collect();
    let both = of_both(campaign, &usual_scatter);
    let mut sets: Vec<usize> = stale.iter().map(|f| f.set).chain(both.sets).collect();
    sets.sort_unstable();
    sets.dedup();
    // Sets too near the previous level cannot show a stale frame: they are assumed stale if nearly all
    // others are.
    let shows = |f: &&First| {
        let is_apart = |old: f64| {
            (old - f.others_dn).abs() > MIN_SEPARATION_DN.max(MIN_SEPARATION_SIGMAS * scatter(f))
                || f.is_far(old)
        };
        f.old_dn.iter().any(|o| o.1 && is_apart(o.0))
    };
    let could = firsts.iter().filter(shows).count();
    if sets.len() >= 3 && sets.len() as f64 > MIN_STALE_SHARE * could as f64 {
        let near = firsts.iter().filter(|f| !shows(f) && campaign.sets[f.set].frames() > 2);
        sets.extend(near.map(|f| f.set));
        sets.sort_unstable();
        sets.dedup();
    }
    Stale { sets, share: both.share }
}

/// Finds first frames exposed under the settings of both sets: all contain the same fraction of the
/// change, as with lag, but the noise contradicts lag that takes the same fraction of every charge.
fn of_both(campaign: &Campaign<'_>, scatter: &Scatter) -> Stale {
    let firsts = campaign.shares_of_firsts(scatter);
    let share = median(firsts.iter().map(|f| f.1));
    let agree = firsts.iter().filter(|f| (f.1 - share).abs() < MAX_REL_OF_SHARES * share.abs()).count();
    let is_usual = agree >= MIN_CHANGES_OF_BOTH && agree as f64 >= MIN_STALE_SHARE * firsts.len() as f64;
    let Some(darkest) = campaign.darkest().filter(|_| is_usual && share > MIN_SHARE_OF_BOTH) else {
        return Stale::default();
    };
    let flats = campaign.places(|s| s.is_lit() && !s.clipped && s.dependence().is_some());
    let lacks = flats.iter().filter(|&&i| campaign.sets[i].lacks_lag(share, darkest)).count();
    if flats.len() < MIN_FLATS_OF_BOTH || 2 * lacks <= flats.len() {
        return Stale::default();
    }
    Stale { sets: firsts.into_iter().map(|f| f.0).collect(), share: Some(share) }
}

impl Check for StaleFrame {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let mut frames: Vec<(usize, usize)> = Vec::new();
        let mut share = None;
        for pass in 0..MAX_STALE_FRAMES {
            let found = stale_firsts(campaign);
            let has_enough = |&set: &usize| pass == 0 || campaign.sets[set].frames() > MIN_FRAMES_LEFT;
            let sets: Vec<usize> = found.sets.into_iter().filter(has_enough).collect();
            // A pipeline of several frames shows in most sets.
            if sets.is_empty() || (pass > 0 && 2 * sets.len() <= frames.len()) {
                break;
            }
            share = share.or(found.share);
            for set in sets {
                if let Some(place) = campaign.sets[set].kept.iter().position(|kept| *kept) {
                    campaign.sets[set].kept[place] = false;
                    frames.push((set, place));
                }
            }
        }
        let Some(&(first, place)) = frames.first() else { return Vec::new() };
        let others_dn = median(campaign.sets[first].means_dn().into_iter());
        let mut sets: Vec<usize> = frames.iter().map(|f| f.0).collect();
        sets.sort_unstable();
        sets.dedup();
        let what = match (frames.iter().filter(|f| f.0 == first).count(), share) {
            (_, Some(share)) => format!(
                "the first frame has {} of the level before: it was exposed under both settings, or is image lag whose electrons stay by chance",
                percent(share)
            ),
            (1, None) => "the first frame was exposed before the new settings held".to_string(),
            (n, None) => format!("the first {n} frames were exposed before the new settings held"),
        };
        let text = format!(
            "{}: {what} (set {}: {} DN, its other frames {} DN)",
            campaign.named(&sets),
            campaign.sets[first].number,
            six_digits(campaign.sets[first].facts.means_dn[place]),
            six_digits(others_dn)
        );
        frames.sort_unstable();
        vec![campaign.fault_of_frames(FaultKind::StaleFrame, &frames, text)]
    }
}
