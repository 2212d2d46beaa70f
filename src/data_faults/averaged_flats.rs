//! Flats that were all averaged before they were saved, beside darks that were not: no flat stands out, but the
//! darks have more noise than the line of the flats leaves for their level.
//!
//! The mean of n frames has 1/n of their variance, and their rounding on top: flats and darks then lie on two
//! photon-transfer lines (Healey and Kondepudy 1994, eqs. 35 and 43).

use super::set_view::SetView;
use super::transfer::{MIN_VARIANCE_DN2, Transfer, above};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use crate::statistics::median::median;
use crate::statistics::quantisation::QUANTISATION_DN2;

/// Least number of darks and of flats.
const MIN_SETS: (usize, usize) = (2, 5);
/// Least ratio of the darks' variance to what the flats leave, and standard errors beyond that (named choices):
/// cameras whose noise is no straight line come near neither.
const MIN_RATIO: f64 = 1.7;
const MIN_SIGMAS: f64 = 5.0;

/// The check.
pub struct AveragedFlats;

impl Check for AveragedFlats {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_of_one_part()) else { return Vec::new() };
        let measured = |s: &SetView| !s.clipped && !s.is_cut_off() && s.variance_dn2().is_some();
        let darks = campaign.places(|s| s.kind == Kind::Dark && measured(s));
        let flats = campaign.places(|s| s.is_lit() && measured(s));
        if darks.len() < MIN_SETS.0 || flats.len() < MIN_SETS.1 {
            return Vec::new();
        }
        let Some(transfer) = Transfer::of(campaign, &zero, &darks) else { return Vec::new() };
        let of = |i: &usize| {
            let (left_dn2, std_dn2) = transfer.expected_dn2(above(campaign, &zero, *i));
            let own_dn2 = campaign.sets[*i].variance_dn2().map_or(0.0, |v| v.0);
            (own_dn2, left_dn2.max(QUANTISATION_DN2), std_dn2)
        };
        let all: Vec<(f64, f64, f64)> = darks.iter().map(of).collect();
        let is_more = |(own, left, std): &(f64, f64, f64)| {
            *own > 2.0 * MIN_VARIANCE_DN2 && *own > MIN_RATIO * (left + MIN_SIGMAS * std)
        };
        for (i, (own, left, std)) in darks.iter().zip(&all) {
            tracing::debug!(
                "set {}: variance {own:.3} DN^2, the flats leave {left:.3} +- {std:.3}",
                campaign.sets[*i].number
            );
        }
        if !all.iter().all(is_more) {
            return Vec::new();
        }
        let (own, left) = (median(all.iter().map(|d| d.0)), median(all.iter().map(|d| d.1)));
        let number = (own / (left - QUANTISATION_DN2).max(QUANTISATION_DN2)).round();
        let text = format!(
            "{}: the flats leave a variance of {} DN² for the level of the darks, and these have {} DN²: all flats were averaged before they were saved, about {number} frames each, and the darks were not, or the darks are of other settings; gain and read noise would be wrong by that factor: take single frames of both",
            campaign.named(&flats),
            six_digits((1000.0 * left).round() / 1000.0),
            six_digits((1000.0 * own).round() / 1000.0),
        );
        vec![campaign.fault_of_sets(FaultKind::DependentFrames, &flats, text, true)]
    }
}
