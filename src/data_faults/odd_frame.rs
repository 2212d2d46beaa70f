//! One frame of another level or another field than the others of its set: a flash, someone in the light.

use super::campaign::Zero;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::{percent, six_digits};
use crate::observables::outliers;
use crate::statistics::median::median;

/// Standard deviations of a frame's mean from which on it is odd.
const FAR: f64 = 10.0;
/// Least deviation from the other frames, over the signal: what is less costs nobody anything.
const LEAST: f64 = 0.002;
/// The same of a dark, DN.
const LEAST_DN: f64 = 0.3;
/// Share of the frames up to which they are slips: more are what the camera or the lamp does.
const FEW: f64 = 0.05;

/// Share of the sets up to which one frame of each is a slip.
const PART: f64 = 0.4;

/// What first frames carry over from the level before.
#[derive(Clone, Copy)]
struct Carries {
    share: f64,
}

/// Share of the change of level that first frames usually carry; `None` with fewer than three changes.
fn carries(campaign: &Campaign<'_>, zero: &Zero) -> Option<Carries> {
    let mut shares = Vec::new();
    for k in 1..campaign.sets.len() {
        let (own, before) = (&campaign.sets[k], &campaign.sets[k - 1]);
        if own.out || before.out || own.frames() < 3 || before.frames() == 0 || !own.kept[0] {
            continue;
        }
        let (level, change) = (own.level_dn(), before.level_dn() - own.level_dn());
        let scatter = campaign.frame_scatter_dn(k, zero);
        if change.abs() > 20.0 * scatter {
            shares.push((own.facts.means_dn[0] - level) / change);
        }
    }
    (shares.len() >= 3).then(|| Carries { share: median(shares.into_iter()) })
}

impl Carries {
    /// Whether the deviation of a first frame is what it carries, to a half.
    fn is_it(self, campaign: &Campaign<'_>, set: usize, off_dn: f64) -> bool {
        let Some(before) = set.checked_sub(1).map(|b| &campaign.sets[b]).filter(|b| b.frames() > 0) else { return true };
        let expected = self.share * (before.level_dn() - campaign.sets[set].level_dn());
        (off_dn - expected).abs() < 0.5 * off_dn.abs()
    }
}

/// The check.
pub struct OddFrame;

impl Check for OddFrame {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero() else { return Vec::new() };
        let sets = campaign.places(|s| s.frames() >= 3);
        let frames: usize = sets.iter().map(|&s| campaign.sets[s].frames()).sum();
        let blocks = |set: usize| {
            let view = &campaign.sets[set];
            let cells = view.facts.cells_dn.iter().zip(&view.kept).filter(|(_, k)| **k).map(|(c, _)| c.clone());
            outliers::apart_of(&cells.collect::<Vec<_>>(), true)
        };
        let aparts: Vec<(bool, outliers::Apart)> =
            sets.iter().map(|&s| (!campaign.sets[s].is_lit(), blocks(s))).collect();
        let usual = outliers::Usual::of(&aparts, zero.dn);
        let carries = carries(campaign, &zero);
        let mut odd: Vec<(usize, usize, f64, f64)> = Vec::new();
        for (&set, (dark, apart)) in sets.iter().zip(&aparts) {
            let view = &campaign.sets[set];
            let places: Vec<usize> = (0..view.kept.len()).filter(|p| view.kept[*p]).collect();
            let signal = (apart.level_dn - zero.at(view.exposure_s)).max(1.0);
            let least = if *dark { LEAST_DN } else { (LEAST * signal).max(LEAST_DN) };
            let scatter = campaign.frame_scatter_dn(set, &zero);
            let cell = usual.far_cell_dn(*dark, signal).max(least);
            let far = |k: &usize| {
                let off = apart.mean_dn[*k];
                let carried = places[*k] == 0 && carries.is_some_and(|c| c.is_it(campaign, set, off));
                let by_cell = apart.cell_dn.get(*k).is_some_and(|c| *c > cell);
                !carried && (off.abs() > least.max(FAR * scatter) || by_cell)
            };
            let mut own: Vec<usize> = (0..places.len()).filter(far).collect();
            // What dies away over frames was carried over from the set before.
            let dies_away = |w: &[f64]| w[0] * w[1] > 0.0 && w[1].abs() > (0.02 * w[0].abs()).max(3.0 * scatter);
            if own.contains(&0) && apart.mean_dn.len() > 3 && dies_away(&apart.mean_dn[..2]) {
                own.retain(|k| *k > 1);
            }
            if own.len() == 1 || own.len() * 4 <= places.len() {
                odd.extend(own.iter().map(|k| (set, places[*k], apart.mean_dn[*k], signal)));
            }
        }
        // A dark of two frames, one of which is that of the other darks.
        for set in campaign.places(|s| s.kind == Kind::Dark && s.frames() == 2) {
            let level = zero.at(campaign.sets[set].exposure_s);
            let means = campaign.sets[set].means_dn();
            let off: Vec<f64> = means.iter().map(|m| m - level).collect();
            let same = (10.0 * zero.scatter_dn).max(LEAST_DN);
            if let Some(k) = (0..2).find(|k| off[*k].abs() > 10.0 * same && off[1 - k].abs() < same) {
                let places: Vec<usize> = (0..campaign.sets[set].kept.len()).filter(|p| campaign.sets[set].kept[*p]).collect();
                odd.push((set, places[k], off[k], 1.0));
            }
        }
        // The same frame of sets that follow one another: the light was another for a part of the sweep.
        let part = odd.len() > 1 && odd.iter().all(|o| o.1 == odd[0].1);
        let kind = if part { FaultKind::UnequalLight } else { FaultKind::OddFrame };
        let few = if part { PART * sets.len() as f64 } else { (FEW * frames as f64).max(1.0) };
        if odd.is_empty() || odd.len() as f64 > few {
            return Vec::new();
        }
        let (set, place, off, signal) = odd[0];
        let by = if campaign.sets[set].is_lit() {
            format!("{} of the signal", percent(off.abs() / signal))
        } else {
            format!("{} DN", six_digits(off.abs()))
        };
        let places: Vec<(usize, usize)> = odd.iter().map(|o| (o.0, o.1)).collect();
        let sets: Vec<usize> = odd.iter().map(|o| o.0).collect();
        let text = format!(
            "{}: frame {place} ({}) is {by} {} the other frames of its set{}",
            campaign.named(&sets),
            campaign.file(set, place),
            if off < 0.0 { "below" } else { "above" },
            if odd.len() > 1 { format!(", and {} more frames are so", odd.len() - 1) } else { String::new() },
        );
        vec![campaign.fault_of_frames(kind, &places, text)]
    }
}
