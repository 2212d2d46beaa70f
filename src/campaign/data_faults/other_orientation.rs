//! Set whose fixed pattern is that of the others mirrored or rotated ("turned").

use super::orientation::{TURNS, correlation, pattern};
use super::patterns::MIN_PIXELS;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::statistics::median::median;

/// Minimum significance of the turned pattern, and maximum of the unturned one, standard deviations.
const MIN_SIGMAS: f64 = 8.0;
/// Maximum ratio of the unturned correlation to the turned one.
const MAX_STRAIGHT_RATIO: f64 = 0.6;
/// Minimum correlation of the turned pattern, relative to that among the other sets.
const MIN_RATIO_TO_OTHERS: f64 = 0.3;

/// Minimum significance with which the dark pattern shows which flats are turned, standard deviations of
/// chance (a named choice).
const MIN_SIGMAS_OF_DARKS: f64 = 5.0;

/// Check for another orientation.
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
            // Bright flats show the response pattern, and are weighted by it.
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
            if kind == Kind::Flat {
                as_the_darks(campaign, &sets, &own, &mut turned);
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

/// Exchanges the roles of turned and other flats if the darks say so, whose pattern is in the flats too:
/// bright turned flats may outweigh more dim ones. Without evidence from the darks the minority is
/// turned.
fn as_the_darks(
    campaign: &Campaign<'_>,
    flats: &[usize],
    own: &[Vec<f64>],
    turned: &mut Vec<(usize, &'static str)>,
) {
    let Some(&(_, name)) = turned.first().filter(|first| turned.iter().all(|t| t.1 == first.1)) else {
        return;
    };
    let Some((_, turn)) = TURNS.iter().find(|t| t.0 == name) else { return };
    let columns = campaign.sets[flats[0]].facts.middle_columns;
    let is_turned = |i: usize| turned.iter().any(|t| t.0 == i);
    let rest: Vec<usize> = flats.iter().copied().filter(|i| !is_turned(*i)).collect();
    let mut darks = vec![0.0; own[0].len()];
    for dark in campaign.places(|s| s.kind == Kind::Dark && !s.clipped) {
        let pattern = pattern(&campaign.sets[dark].facts.middle_dn, columns);
        if pattern.len() == darks.len() {
            darks.iter_mut().zip(pattern).for_each(|(sum, v)| *sum += v);
        }
    }
    // Excess of the unturned over the turned dark pattern in these flats.
    let straight = |of: &dyn Fn(usize) -> bool| {
        let one = |p: &Vec<f64>| correlation(p, &darks) - correlation(&turn(p, columns), &darks);
        let all = flats.iter().zip(own).filter(|(i, _)| of(**i)).map(|(_, p)| one(p));
        all.fold(0.0, |sum: f64, v| if v.is_finite() { sum + v } else { sum })
    };
    // The flats share a pattern, so all share its chance correlation with that of the darks.
    let chance = flats.len() as f64 * (2.0 / darks.len() as f64).sqrt();
    let by_darks = straight(&is_turned) - straight(&|i| !is_turned(i));
    tracing::debug!(
        "the darks' pattern in flats that are turned, less that in the others: {by_darks:.3} +- {chance:.3}"
    );
    let pattern_of = |i: usize| flats.iter().position(|f| *f == i).map(|k| &own[k]);
    // The flats that would be the turned ones have one pattern without turning.
    let are_alike = rest.iter().filter_map(|i| pattern_of(*i)).collect::<Vec<_>>().windows(2).all(|pair| {
        let as_it_is = correlation(pair[0], pair[1]);
        as_it_is > correlation(&turn(pair[0], columns), pair[1]).abs() / MAX_STRAIGHT_RATIO
    });
    let others_are = are_alike
        && if by_darks.abs() > MIN_SIGMAS_OF_DARKS * chance {
            by_darks > 0.0
        } else {
            turned.len() > rest.len()
        };
    if others_are {
        *turned = rest.into_iter().map(|i| (i, name)).collect();
    }
}
