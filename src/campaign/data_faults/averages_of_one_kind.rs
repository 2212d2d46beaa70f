//! Flats that were all averaged before saving, beside darks that were not, or the reverse: no single set
//! stands out, but the two kinds have different noise.
//!
//! The mean of n frames has 1/n of their variance, plus rounding: flats and darks then lie on two
//! photon-transfer lines (Healey and Kondepudy 1994, eqs. 35 and 43). Two tests reveal them: the noise
//! that the flats predict at the dark level, and the gain from the dark charge. The camera may subtract
//! the level of that charge, but not the excess of single hot pixels.

use super::hot_charge::HotCharge;
use super::set_view::SetView;
use super::transfer::{MIN_VARIANCE_DN2, Transfer, above, pixel_error};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::{six_digits, with_error};
use crate::statistics::median::median;
use crate::statistics::quantisation::QUANTISATION_DN2;

/// Minimum number of flats that predict the noise of darks.
const MIN_FLATS: usize = 4;
/// Minimum ratio of the noise of the two kinds, or of their gains (a named choice): two frames make it
/// 2.
const MIN_RATIO: f64 = 1.6;
/// Minimum significance of a ratio from one test alone, and from a second test beside it, standard
/// errors (named choices).
const MIN_SIGMAS: f64 = 5.0;
const MIN_SIGMAS_BESIDE: f64 = 3.0;
/// Minimum number of averaged darks beside others: a single one is a stray from the curve.
const MIN_AVERAGED_DARKS: usize = 2;
/// Maximum relative difference of two equal gains from the dark charge (a named choice).
const SAME_GAIN: f64 = 0.25;

/// Maximum relative bend of the photon transfer at the highest level for all flats to predict the noise of
/// darks (a named choice: brighter-fatter and full wells bend by less; gamma 0.85 by a quarter).
const MAX_BEND_TO_BLACK: f64 = 0.1;

/// Check for averages of one kind.
pub struct AveragesOfOneKind;

/// Value and standard error.
type Measured = (f64, f64);

/// Noise and gains of the darks and flats of a campaign.
struct Kinds {
    /// Variance of each dark, and that predicted by the flats at its level, DN^2.
    darks: Vec<(f64, Measured)>,
    /// Gain from the flats, DN/e.
    of_flats: Measured,
    /// Gain from the growth of level and noise between darks, DN/e.
    of_growth: Option<Measured>,
    /// Gain from hot pixels of the darks, DN/e.
    of_hot: Option<Measured>,
}

impl Kinds {
    fn of(campaign: &Campaign<'_>, darks: &[usize]) -> Option<Self> {
        let zero = campaign.zero()?;
        let transfer = Transfer::by_pixels(campaign, &zero, darks)?;
        // A response that bends (gamma, a knee) bends the curve more than it can follow: the darkest flats
        // alone then tell what is left for the darks, unless they lie on a bend too.
        let bends = |transfer: &Transfer| transfer.bend().abs() > MAX_BEND_TO_BLACK;
        let transfer = if bends(&transfer) {
            Transfer::by_pixels(campaign, &zero, &all_but_the_darkest_flats(campaign))
                .filter(|t| !bends(t))?
        } else {
            transfer
        };
        let left = |i: &usize| {
            let own_dn2 = campaign.sets[*i].variance_dn2().map_or(0.0, |v| v.0);
            (own_dn2, transfer.expected_dn2(above(campaign, &zero, *i)))
        };
        let of_growth = growth(campaign, darks);
        let of_hot = HotCharge::of_all(darks.iter().filter_map(|&i| campaign.sets[i].facts.hot_charge));
        let of_flats = transfer.slope_with_error();
        // Flats of about one level give no gain.
        if of_flats.0 <= MIN_SIGMAS * of_flats.1 {
            return None;
        }
        let all = Self { darks: darks.iter().map(left).collect(), of_flats, of_growth, of_hot };
        for (i, (own, (left, std))) in darks.iter().zip(&all.darks) {
            tracing::debug!(
                "set {}: variance {own:.3} DN^2, the flats leave {left:.3} +- {std:.3}",
                campaign.sets[*i].number
            );
        }
        tracing::debug!(
            "gain by the flats {:.4?}, by the growth of the darks {of_growth:?}, by hot pixels {of_hot:?}",
            all.of_flats
        );
        Some(all)
    }

    /// Returns the ratio of the gains from darks and flats, if level, noise and hot pixels agree on it.
    fn ratio(&self) -> Option<Measured> {
        let ((growth, growth_std), (hot, hot_std)) = self.of_growth.zip(self.of_hot)?;
        let agree = (growth - hot).abs()
            < SAME_GAIN * growth.max(hot) + MIN_SIGMAS_BESIDE * growth_std.hypot(hot_std);
        // Hot pixels alone deviate from the flats in the same direction: their level is not subtracted.
        let (flats, flats_std) = self.of_flats;
        let beside = MIN_SIGMAS_BESIDE * hot_std.hypot(flats_std) < (hot - flats).abs()
            && (hot > flats) == (growth > flats);
        let weights = (growth_std.powi(-2), hot_std.powi(-2));
        let weight = weights.0 + weights.1;
        let mean = (growth * weights.0 + hot * weights.1) / weight;
        let ratio = mean / flats;
        (agree && beside).then_some((ratio, (weight.powf(-0.5) / flats).hypot(ratio * flats_std / flats)))
    }

    /// Returns the deviation of a ratio from 1 in standard deviations, including those of the predicted
    /// dark noise.
    fn sigmas(&self, (ratio, std): Measured) -> f64 {
        let side = if ratio > 1.0 { 1.0 } else { -1.0 };
        let of_noise = median(self.darks.iter().map(|(own, (left, std))| side * (own - left) / std));
        (side * (ratio - 1.0) / std).hypot(of_noise.max(0.0))
    }

    /// Returns true if the dark charge gives the gain of the flats.
    fn gains_agree(&self) -> bool {
        let is_same = |(gain, std): Measured| {
            let off = (gain / self.of_flats.0).ln().abs();
            off < 0.5 * MIN_RATIO.ln() && std < 0.5 * (MIN_RATIO - 1.0) * gain
        };
        self.of_hot.is_some_and(is_same) || self.of_growth.is_some_and(is_same)
    }

    /// Returns true if all darks exceed the predicted noise by about the same amount: an excess that
    /// grows with exposure is charge, which the flats have too, and its level may be subtracted.
    fn darks_have_more(&self) -> bool {
        let least = self.darks.iter().map(|d| d.0).fold(f64::INFINITY, f64::min);
        let are_alike = self.darks.iter().all(|d| d.0 < MIN_RATIO * least);
        are_alike
            && self.darks.iter().all(|(own, (left, std))| {
                *own > 2.0 * MIN_VARIANCE_DN2
                    && *own > MIN_RATIO * left.max(QUANTISATION_DN2)
                    && *own > left + MIN_SIGMAS * std
            })
    }

    /// Returns true if all darks have less noise than the flats predict.
    fn darks_have_less(&self) -> bool {
        self.darks.iter().all(|(own, (left, std))| {
            *left > MIN_VARIANCE_DN2 && MIN_RATIO * own < *left && *own < left - MIN_SIGMAS * std
        })
    }

    /// Returns true if no dark has less (or more) noise than the flats predict, beyond errors.
    fn allows(&self, darks_have_more: bool) -> bool {
        self.darks.iter().all(|(own, (left, std))| {
            let off = (own - left) / std;
            if darks_have_more { off > -MIN_SIGMAS_BESIDE } else { off < MIN_SIGMAS_BESIDE }
        })
    }
}

/// Returns all sets but the darkest flats, of which a curve can be fitted.
fn all_but_the_darkest_flats(campaign: &Campaign<'_>) -> Vec<usize> {
    let mut flats =
        campaign.places(|s| s.is_lit() && !s.clipped && !s.is_cut_off() && s.variance_dn2().is_some());
    let level = |i: usize| campaign.sets[i].level_dn();
    flats.sort_by(|a, b| level(*a).total_cmp(&level(*b)));
    flats.truncate(MIN_FLATS.max(flats.len() / 3));
    (0..campaign.sets.len()).filter(|i| !flats.contains(i)).collect()
}

/// Returns the darks with less noise than flats and other darks leave for their level; none if they are all
/// darks. A dark of the flats' exposures is among them, so that it is not charge that they lack.
fn averages_among_darks(
    campaign: &Campaign<'_>,
    kinds: &Kinds,
    darks: &[usize],
    shortest_s: f64,
) -> Vec<usize> {
    let is_less = |own: f64, (left, std): Measured, sigmas: f64| {
        left > MIN_VARIANCE_DN2 && MIN_RATIO * own < left && own < left - sigmas * std
    };
    let less: Vec<usize> = darks
        .iter()
        .zip(&kinds.darks)
        .filter(|(_, (own, left))| is_less(*own, *left, MIN_SIGMAS_BESIDE))
        .map(|(i, _)| *i)
        .collect();
    let has_their_charge = |i: &usize| 2.0 * campaign.sets[*i].exposure_s >= shortest_s;
    if less.len() < MIN_AVERAGED_DARKS || less.len() == darks.len() || !less.iter().any(has_their_charge) {
        return Vec::new();
    }
    let Some(zero) = campaign.zero() else { return Vec::new() };
    let Some(transfer) = Transfer::by_pixels(campaign, &zero, &less) else { return Vec::new() };
    let own_and_left = |i: &usize| {
        let own = campaign.sets[*i].variance_dn2().map_or(f64::NAN, |v| v.0);
        (own, transfer.expected_dn2(above(campaign, &zero, *i)))
    };
    let agrees = |i: &usize| {
        let (own, (left, std)) = own_and_left(i);
        (own - left).abs() < MIN_SIGMAS * std
    };
    let are_averaged = less.iter().all(|i| {
        let (own, left) = own_and_left(i);
        is_less(own, left, MIN_SIGMAS)
    });
    let others_agree = darks.iter().filter(|i| !less.contains(i)).all(agrees);
    if are_averaged && others_agree { less } else { Vec::new() }
}

/// Returns the gain from the growth of level and noise between the darks of lowest and highest level.
fn growth(campaign: &Campaign<'_>, darks: &[usize]) -> Option<Measured> {
    let level = |i: &&usize| campaign.sets[**i].level_dn();
    let low = darks.iter().min_by(|a, b| level(a).total_cmp(&level(b)))?;
    let high = darks.iter().max_by(|a, b| level(a).total_cmp(&level(b)))?;
    let noise = |i: usize| {
        let (var_dn2, pairs) = campaign.sets[i].variance_dn2()?;
        Some((var_dn2, var_dn2 * pixel_error(campaign, i, pairs)))
    };
    let ((low_dn2, low_std), (high_dn2, high_std)) = noise(*low).zip(noise(*high))?;
    let (more_dn, more_dn2) = (level(&high) - level(&low), high_dn2 - low_dn2);
    // If charge causes the level, the longest exposure has the highest one.
    let is_longer = campaign.sets[*high].exposure_s > campaign.sets[*low].exposure_s;
    let level_std = 2f64.sqrt() * campaign.dark_scatter_dn();
    (is_longer && more_dn > MIN_SIGMAS * level_std).then(|| {
        let std = low_std.hypot(high_std).hypot(more_dn2 / more_dn * level_std) / more_dn;
        (more_dn2 / more_dn, std)
    })
}

impl Check for AveragesOfOneKind {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        if !campaign.is_of_one_part() {
            return Vec::new();
        }
        let measured = |s: &SetView| {
            !s.clipped && !s.is_cut_off() && !campaign.is_rounded(s) && s.variance_dn2().is_some()
        };
        let darks = campaign.places(|s| s.kind == Kind::Dark && measured(s));
        let flats = campaign.places(|s| s.is_lit() && measured(s));
        if darks.is_empty() || flats.len() < MIN_FLATS {
            return Vec::new();
        }
        let Some(kinds) = Kinds::of(campaign, &darks) else { return Vec::new() };
        let ratio = kinds.ratio();
        let is_sure = ratio.is_some_and(|r| kinds.sigmas(r) > MIN_SIGMAS);
        let of_flats = is_sure && ratio.is_some_and(|(r, _)| r > MIN_RATIO) && kinds.allows(true);
        let of_darks = is_sure && ratio.is_some_and(|(r, _)| r * MIN_RATIO < 1.0) && kinds.allows(false);
        // Noise alone suffices if the dark charge does not contradict.
        let by_noise = !kinds.gains_agree();
        let flats_are = of_flats || by_noise && kinds.darks_have_more();
        // Flats of far longer exposures have charge that the darks lack, and its level may be
        // subtracted.
        let exposure_s = |i: &usize| campaign.sets[*i].exposure_s;
        let shortest_s = flats.iter().map(exposure_s).fold(f64::INFINITY, f64::min);
        let have_their_charge = darks.iter().any(|i| 2.0 * exposure_s(i) >= shortest_s);
        let less = by_noise && have_their_charge && kinds.darks_have_less();
        let darks_are = !flats_are && (of_darks || less);
        let three = |value: f64| six_digits((1000.0 * value).round() / 1000.0);
        if !flats_are && !darks_are {
            let some = averages_among_darks(campaign, &kinds, &darks, shortest_s);
            if some.is_empty() {
                return Vec::new();
            }
            let of = |set: &usize| darks.iter().zip(&kinds.darks).find(|d| d.0 == set).map(|d| d.1);
            let (own, left) = (
                median(some.iter().filter_map(|i| of(i).map(|d| d.0))),
                median(some.iter().filter_map(|i| of(i).map(|d| d.1.0))),
            );
            let text = format!(
                "{}: frames were averaged over time before they were saved, or have another gain: a variance of {} DN², where the flats and the other darks leave {} DN² for the level; take single frames",
                campaign.named(&some),
                three(own),
                three(left)
            );
            return vec![campaign.fault_of_sets(FaultKind::DependentFrames, &some, text, true)];
        }
        let own = median(kinds.darks.iter().map(|d| d.0));
        let left = median(kinds.darks.iter().map(|d| d.1.0)).max(QUANTISATION_DN2);
        let (number, witness) = match ratio.filter(|_| of_flats || of_darks) {
            Some((r, std)) => (
                if flats_are { r } else { r.recip() },
                format!(
                    "the charge of the darks has a gain of {} DN/e, and the flats have {} DN/e",
                    with_error(r * kinds.of_flats.0, std * kinds.of_flats.0),
                    with_error(kinds.of_flats.0, kinds.of_flats.1)
                ),
            ),
            _ => {
                let share = (own - QUANTISATION_DN2) / (left - QUANTISATION_DN2).max(QUANTISATION_DN2);
                (
                    if flats_are { share } else { share.max(1e-3).recip() },
                    format!(
                        "the flats leave a variance of {} DN² for the level of the darks, and these have {} DN²",
                        three(left),
                        three(own)
                    ),
                )
            }
        };
        let (averaged, others, sets, wrong) = if flats_are {
            ("flats", "darks", flats, "gain and variances would be too small")
        } else {
            ("darks", "flats", darks, "their variance would be too small")
        };
        let text = format!(
            "{}: {witness}: the darks have another gain or other settings than the flats, or all {averaged} were averaged before they were saved, about {} frames each, and the {others} were not; {wrong} by that factor: take single frames of both at the same settings",
            campaign.named(&sets),
            number.round().max(2.0)
        );
        vec![campaign.fault_of_sets(FaultKind::DependentFrames, &sets, text, true)]
    }
}
