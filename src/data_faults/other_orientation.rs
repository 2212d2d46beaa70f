//! A set whose fixed pattern is that of the others mirrored.

use super::orientation::{TURNS, correlation, pattern};
use super::patterns::MIN_PIXELS;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::statistics::median::median;

/// Standard deviations by which the mirrored pattern must be there, and the one as it is must not.
const MIN_SIGMAS: f64 = 8.0;
/// Share of the mirrored correlation that the one as it is may have.
const MAX_STRAIGHT_RATIO: f64 = 0.6;
/// Least that the mirrored pattern is there, over what the patterns of the other sets are.
const MIN_RATIO_TO_OTHERS: f64 = 0.3;

/// The check.
pub struct OtherOrientation;

impl Check for OtherOrientation {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let mut turned: Vec<(usize, &'static str)> = Vec::new();
        for kind in [Kind::Flat, Kind::Dark] {
            let sets = campaign.places(|s| s.kind == kind && !s.clipped);
            if sets.len() < 3 {
                continue;
            }
            let columns = campaign.sets[sets[0]].facts.middle_columns;
            let own: Vec<Vec<f64>> =
                sets.iter().map(|&i| pattern(&campaign.sets[i].facts.middle_dn, columns)).collect();
            let pixels = own[0].len();
            if pixels < MIN_PIXELS || own.iter().any(|p| p.len() != pixels) {
                continue;
            }
            // Bright flats show the pattern of the response, and count by it.
            let mut sum = vec![0.0; pixels];
            own.iter().for_each(|p| sum.iter_mut().zip(p).for_each(|(s, v)| *s += v));
            let straight_of =
                |p: &Vec<f64>| correlation(p, &sum.iter().zip(p).map(|(s, v)| s - v).collect::<Vec<_>>());
            let usual = median(own.iter().map(straight_of));
            for (&i, p) in sets.iter().zip(&own) {
                let others: Vec<f64> = sum.iter().zip(p).map(|(s, v)| s - v).collect();
                let chance = (pixels as f64).sqrt().recip();
                let straight = correlation(p, &others);
                let best = TURNS
                    .iter()
                    .map(|(name, turn)| (correlation(&turn(p, columns), &others), *name))
                    .max_by(|a, b| a.0.total_cmp(&b.0));
                tracing::debug!("set {}: pattern {straight:.3} as it is, {best:?}", campaign.sets[i].number);
                if let Some((_, name)) = best.filter(|b| {
                    b.0 > (MIN_SIGMAS * chance).max(MIN_RATIO_TO_OTHERS * usual)
                        && straight < MAX_STRAIGHT_RATIO * b.0
                }) {
                    turned.push((i, name));
                }
            }
        }
        let mut out = Vec::new();
        for (name, _) in TURNS {
            let sets: Vec<usize> = turned.iter().filter(|t| t.1 == name).map(|t| t.0).collect();
            if !sets.is_empty()
                && sets.len() * 3 <= campaign.places(|s| s.kind == Kind::Flat || s.kind == Kind::Dark).len()
            {
                let text = format!(
                    "{}: {name}: the fixed pattern is that of the other sets so",
                    campaign.named(&sets)
                );
                out.push(campaign.fault_of_sets(FaultKind::OtherSettings, &sets, text, true));
            }
        }
        out
    }
}
