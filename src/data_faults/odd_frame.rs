//! One frame of another level or another field than the others of its set: a flash, someone in the light.

use super::{Campaign, Check, DataFault, FaultKind};
use crate::number::{percent, six_digits};
use crate::observables::outliers;

/// Standard deviations of a frame's mean from which on it is odd.
const FAR: f64 = 10.0;
/// Least deviation from the other frames, over the signal: what is less costs nobody anything.
const LEAST: f64 = 0.002;
/// The same of a dark, DN.
const LEAST_DN: f64 = 0.3;
/// Share of the frames up to which they are slips: more are what the camera or the lamp does.
const FEW: f64 = 0.05;

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
        let mut odd = Vec::new();
        for (&set, (dark, apart)) in sets.iter().zip(&aparts) {
            let view = &campaign.sets[set];
            let places: Vec<usize> = (0..view.kept.len()).filter(|p| view.kept[*p]).collect();
            let signal = (apart.level_dn - zero.at(view.exposure_s)).max(1.0);
            let least = if *dark { LEAST_DN } else { (LEAST * signal).max(LEAST_DN) };
            let scatter = campaign.frame_scatter_dn(set, &zero);
            let cell = usual.far_cell_dn(*dark, signal).max(least);
            let far = |k: &usize| apart.mean_dn[*k].abs() > least.max(FAR * scatter) || apart.cell_dn.get(*k).is_some_and(|c| *c > cell);
            let mut own: Vec<usize> = (0..places.len()).filter(far).collect();
            // What dies away is carried over from the set before.
            let carried = |k: usize, own: &[usize]| {
                k <= 1 && own.contains(&0) && k + 1 < places.len() && {
                    let step = apart.mean_dn[k + 1];
                    k == 0 && step.abs() > 0.02 * apart.mean_dn[0].abs() && step.abs() > 2.0 * scatter && step * apart.mean_dn[0] > 0.0
                }
            };
            if carried(0, &own) {
                own.retain(|k| *k > 1);
            }
            if own.len() == 1 || own.len() * 4 <= places.len() {
                odd.extend(own.iter().map(|k| (set, places[*k], apart.mean_dn[*k], signal)));
            }
        }
        // First frames that are off in several sets are what the camera carries over.
        let firsts = odd.iter().filter(|o| o.1 == 0).count();
        if firsts > 1 {
            odd.retain(|o| o.1 != 0);
        }
        if odd.is_empty() || odd.len() as f64 > (FEW * frames as f64).max(1.0) {
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
        vec![campaign.fault_of_frames(FaultKind::OddFrame, &places, text)]
    }
}
