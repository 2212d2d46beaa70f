//! Flats saved with fewer bits than the others: their codes, black level included, are 1/2, 1/4 and so
//! on of those expected for exposure and light, or are spaced more widely at levels where others have
//! all codes.

use super::campaign::Zero;
use super::set_view::SetView;
use super::transfer::{Transfer, above};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use crate::statistics::median::median;
use crate::statistics::quantisation::QUANTISATION_DN2;

/// Range of missing bits. A single bit could also be a digital gain.
const BITS: std::ops::RangeInclusive<u32> = 2..=8;
/// Maximum relative deviation of a flat from the response of the others: lamps drift, shutters have a
/// delay (a named choice).
const MAX_DEVIATION: f64 = 0.05;
/// Minimum fraction of full scale at which pixels may saturate (a named choice).
const MIN_FULL: f64 = 0.9;
/// Minimum number of flats with all bits.
const MIN_WHOLE: usize = 2;
/// Maximum deviation of the noise of a set with fewer bits, relative to the deviation from that of a
/// wrong label (a named choice).
const MAX_NOISE_SHARE: f64 = 0.5;
/// Minimum fraction of pixels at levels where others have all codes: more than pixels interpolated by a
/// camera, which the code step does not count.
const MIN_LOW_PIXELS: f64 = 0.003;

/// Check for flats with fewer bits.
pub struct FewerBits;

impl Check for FewerBits {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let depth = campaign.bit_depth();
        let said = |bits: u32| {
            format!("{bits} bits less than the other sets ({} of {depth})", depth.saturating_sub(bits))
        };
        let (sets, text) = if let Some((sets, bits)) = shifted_down(campaign) {
            let share = 1u32 << bits;
            let text = format!(
                "{}: codes are 1/{share} of those of the other flats, black level included: {}; times {share} they can be used for levels, and their noise is lost in rounding",
                campaign.named(&sets),
                said(bits)
            );
            (sets, text)
        } else if let Some((sets, step_dn)) = further_apart(campaign) {
            let text = format!(
                "{}: codes are {} DN apart, and 1 DN in others, also for pixels of the same level: {}",
                campaign.named(&sets),
                six_digits(step_dn),
                said(step_dn.log2().round() as u32)
            );
            (sets, text)
        } else {
            return Vec::new();
        };
        vec![campaign.fault_of_sets(FaultKind::OtherSettings, &sets, text, true)]
    }
}

/// Returns the level above the darks per light.
fn response(set: &SetView, level_dn: f64, zero: &Zero) -> f64 {
    (level_dn - zero.at(set.exposure_s)) / set.light()
}

fn is_near(a: f64, b: f64) -> bool {
    (a / b - 1.0).abs() < MAX_DEVIATION
}

/// Finds flats whose codes are 2^-n of those expected from the response of the others, and n.
fn shifted_down(campaign: &Campaign<'_>) -> Option<(Vec<usize>, u32)> {
    let zero = campaign.zero().filter(|_| campaign.is_of_one_part())?;
    let flats = campaign.places(|s| s.is_lit() && !s.clipped && !s.is_cut_off());
    let levels: Vec<f64> = campaign.sets.iter().map(SetView::level_dn).collect();
    let response = |i: usize, factor: f64| response(&campaign.sets[i], factor * levels[i], &zero);
    // Every flat has all its bits or lacks this number, relative to the response of one of them.
    let split = |bits: u32, usual: f64| {
        let (whole, rest): (Vec<usize>, Vec<usize>) =
            flats.iter().partition(|i| is_near(response(**i, 1.0), usual));
        let factor = f64::from(1u32 << bits);
        let is_full = |i: usize| factor * levels[i] > MIN_FULL * campaign.full_scale_dn;
        let is_shifted = |i: &usize| {
            let own = response(*i, factor);
            is_near(own, usual) || is_full(*i) && own < usual
        };
        let all = whole.len() >= MIN_WHOLE && !rest.is_empty() && rest.iter().all(is_shifted);
        all.then_some((rest, bits))
    };
    let usual = |i: &usize| response(*i, 1.0);
    let ways =
        BITS.flat_map(|bits| flats.iter().map(usual).filter_map(move |r| split(bits, r)).collect::<Vec<_>>());
    let (sets, bits) = ways.min_by_key(|(rest, _)| rest.len())?;
    // A wrong label keeps the noise of the level.
    let transfer = Transfer::of(campaign, &zero, &sets)?;
    let factor = f64::from(1u32 << bits);
    let is_rounded = |&i: &usize| {
        let whole_dn = factor * campaign.sets[i].level_dn() - zero.dn;
        let expected = |above_dn: f64| transfer.expected_dn2(above_dn.max(0.0)).0;
        let of_label = expected(above(campaign, &zero, i)).max(QUANTISATION_DN2);
        let of_fewer = expected(whole_dn) / factor.powi(2) + QUANTISATION_DN2;
        // Rounding may remove all noise.
        let own = campaign.sets[i].variance_dn2().map_or(f64::NAN, |v| v.0.max(QUANTISATION_DN2));
        (own / of_fewer).ln().abs() < MAX_NOISE_SHARE * (own / of_label).ln().abs()
    };
    // Full wells have less noise.
    let told = |i: &&usize| factor * campaign.sets[**i].level_dn() < MIN_FULL * campaign.full_scale_dn;
    let mut of_noise = sets.iter().filter(told).peekable();
    (of_noise.peek().is_some() && of_noise.all(is_rounded)).then_some((sets, bits))
}

/// Finds flats whose codes are 4 DN or more apart where other sets have all codes, and that distance. A
/// converter with level-dependent steps has them at every level of a pixel, so also in the blind, dusty
/// and shaded pixels of a bright flat.
fn further_apart(campaign: &Campaign<'_>) -> Option<(Vec<usize>, f64)> {
    let step = |i: usize| campaign.sets[i].facts.code_step_dn;
    let sets = campaign.places(|s| matches!(s.kind, Kind::Dark | Kind::Flat) && !s.clipped);
    let (fine, coarse): (Vec<usize>, Vec<usize>) =
        sets.into_iter().filter(|i| step(*i) > 0.0).partition(|i| step(*i) <= 1.0);
    let step_dn = step(*coarse.first()?);
    let is_power = step_dn.log2().fract() == 0.0 && step_dn >= f64::from(1u32 << BITS.start());
    let are_flats = coarse.iter().all(|i| campaign.sets[*i].is_lit() && step(*i) == step_dn);
    let highest = fine.iter().map(|i| campaign.sets[*i].level_dn()).fold(0.0, f64::max);
    let lowest = fine.iter().map(|i| campaign.sets[*i].level_dn()).fold(f64::INFINITY, f64::min);
    let has_low_pixels = |i: &usize| {
        let pixels = &campaign.sets[*i].facts.middle_dn;
        let low = pixels.iter().filter(|dn| (lowest..highest).contains(&f64::from(**dn))).count();
        low as f64 > MIN_LOW_PIXELS * pixels.len() as f64
    };
    // A gain of 4 also gives codes 4 DN apart, but shifts the level.
    let zero = campaign.zero()?;
    let own = |i: &usize| response(&campaign.sets[*i], campaign.sets[*i].level_dn(), &zero);
    let usual = median(fine.iter().filter(|i| campaign.sets[**i].is_lit()).map(own));
    let is_at_level = |i: &usize| is_near(own(i), usual);
    let is_slip = is_power
        && are_flats
        && fine.len() >= coarse.len()
        && coarse.iter().any(has_low_pixels)
        && coarse.iter().all(is_at_level);
    is_slip.then_some((coarse, step_dn))
}
