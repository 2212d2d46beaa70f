//! Automatic exposure or gain: several flats have one level, whatever exposure and light are stated. A
//! full well holds the level too, but removes the PRNU pattern, which an automatic control preserves.

use super::campaign::{Zero, median_line};
use super::patterns::{Noise, combined, share};
use super::transfer::Transfer;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use crate::statistics::median::median;

/// Maximum relative difference of equal levels.
const SAME_LEVEL: f64 = 0.03;
/// Minimum ratio of exposure times light over these flats, and their minimum number.
const MIN_RATIO: f64 = 2.0;
const MIN_FLATS: usize = 3;
/// Maximum relative difference of the levels of two or more flats held by an automatic gain that their
/// noise reveals; minimum ratio of their exposure times light (named choices).
const HELD_LEVEL: f64 = 0.005;
const MIN_HELD_RATIO: f64 = 1.1;
/// Minimum relative deviation from the level that the other flats predict for their setting, and minimum
/// number of these.
const MIN_OFF: f64 = 0.03;
const MIN_OTHERS: usize = 4;
/// Maximum deviation of their noise from that of the gain, relative to the change that the gain causes
/// (a named choice).
const SAME_GAIN: f64 = 0.3;
/// Maximum loss of the pattern at which it counts as preserved, and minimum significance of its
/// presence, standard errors.
const MAX_LOSS: f64 = 0.3;
const MIN_SIGMAS: f64 = 5.0;
/// Maximum relative difference of noise variances under the same light.
const SAME_NOISE: f64 = 0.15;

/// Check for automatic exposure or gain.
pub struct Automatic;

impl Check for Automatic {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_of_one_part()) else { return Vec::new() };
        if let Some((held, held_dn)) = held_by_gain(campaign, &zero) {
            let text = format!(
                "{}: all have {} DN above black, though exposure and light are stated to differ, and their noise is that of a gain which holds the level: an automatic gain was on",
                campaign.named(&held),
                six_digits(held_dn)
            );
            return vec![campaign.fault_of_sets(FaultKind::OtherSettings, &held, text, true)];
        }
        let above = |i: usize| campaign.sets[i].level_dn() - zero.at(campaign.sets[i].exposure_s);
        let light = |i: usize| campaign.sets[i].light();
        // For each position of card and light, the flats at its highest level; one position must have at
        // least two lights.
        let mut fields: Vec<Vec<usize>> = Vec::new();
        for flats in campaign.flats_by_field().into_values() {
            let highest = flats.iter().map(|&i| above(i)).fold(0.0, f64::max);
            let mut held: Vec<usize> =
                flats.into_iter().filter(|&i| above(i) > (1.0 - SAME_LEVEL) * highest).collect();
            held.sort_by(|a, b| light(*a).total_cmp(&light(*b)));
            if let [first, .., last] = *held.as_slice()
                && light(last) >= MIN_RATIO * light(first)
            {
                fields.push(held);
            }
        }
        let held: Vec<usize> = fields.iter().flatten().copied().collect();
        if held.len() < MIN_FLATS || !campaign.are_of_one_size(held.iter()) {
            return Vec::new();
        }
        // Patterns of the upper and the lower half of the lights.
        let columns = campaign.sets[held[0]].facts.middle_columns;
        let (mut lower, mut upper) = (Vec::new(), Vec::new());
        for field in &fields {
            let middle = (light(field[0]) * light(field[field.len() - 1])).sqrt();
            field.iter().for_each(|&i| if light(i) < middle { lower.push(i) } else { upper.push(i) });
        }
        let mean = |sets: &[usize]| combined(campaign, sets, &vec![1.0 / sets.len() as f64; sets.len()]);
        let ((pattern, noise_dn2), (image, _)) = (mean(&lower), mean(&upper));
        let kept = share(&image, &pattern, Noise::of_flats(noise_dn2), columns);
        tracing::debug!("{} of one level have {kept:?} of the pattern", campaign.named(&held));
        let is_kept =
            |(part, std): (f64, f64)| part > MIN_SIGMAS * std && (part - 1.0).abs() < MAX_LOSS.max(2.0 * std);
        if !kept.is_some_and(is_kept) {
            return Vec::new();
        }
        let var = |i: usize| campaign.sets[i].variance_dn2().map_or(f64::NAN, |v| v.0);
        let dark = campaign
            .places(|s| s.kind == Kind::Dark && s.variance_dn2().is_some())
            .iter()
            .map(|&i| var(i))
            .fold(f64::INFINITY, f64::min);
        let usual = |sets: &[usize]| median(sets.iter().map(|&i| var(i)));
        let (a, b) = (usual(&lower), usual(&upper));
        let one_light = (b / a - 1.0).abs() < SAME_NOISE;
        let falls = b < a && b > 0.5 * dark.min(a);
        if !one_light && !falls {
            return Vec::new();
        }
        // With a single light the first flat of each field is valid; a gain may have been regulated from
        // the first on.
        let first: Vec<usize> = fields.iter().map(|field| field[0]).collect();
        let (why, mut out): (String, Vec<usize>) = if one_light {
            let of_first = format!(
                "their noise is that of one light: an automatic exposure was on, or the light was set to it; of these only {} {}",
                campaign.named(&first),
                if first.len() == 1 { "counts" } else { "count" },
            );
            (of_first, held.iter().copied().filter(|i| !first.contains(i)).collect())
        } else {
            let of_gain = "their noise falls as with less and less gain, while the pixels respond as before: an automatic gain was on";
            (of_gain.into(), held.clone())
        };
        out.sort_unstable();
        let (weakest, strongest) =
            held.iter().map(|&i| light(i)).fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
        let text = format!(
            "{}: all have {} DN above black, though exposure and light are stated to differ by a factor of {}; {why}",
            campaign.named(&held),
            six_digits(above(first[0])),
            six_digits(strongest / weakest),
        );
        vec![campaign.fault_of_sets(FaultKind::OtherSettings, &out, text, true)]
    }
}

/// Finds flats of one level whose noise is that of the stated light at a gain that holds the level: the
/// variance falls with its square (Healey and Kondepudy 1994, eq. 35). The other flats give level and
/// noise as functions of light; at a full well the noise vanishes with the pattern, not as the gain.
/// Returns the flats and their level above black, DN.
fn held_by_gain(campaign: &Campaign<'_>, zero: &Zero) -> Option<(Vec<usize>, f64)> {
    let above = |i: usize| campaign.sets[i].level_dn() - zero.at(campaign.sets[i].exposure_s);
    let light = |i: usize| campaign.sets[i].light();
    let lit = campaign.places(|s| s.is_lit() && !s.clipped && s.variance_dn2().is_some());
    let is_one_field =
        lit.windows(2).all(|w| campaign.sets[w[0]].configuration == campaign.sets[w[1]].configuration);
    let by_light = |a: &&usize, b: &&usize| light(**a).total_cmp(&light(**b));
    let brightest = *lit.iter().max_by(by_light).filter(|_| is_one_field)?;
    let held_dn = above(brightest);
    let (held, others): (Vec<usize>, Vec<usize>) =
        lit.iter().partition(|i| (above(**i) / held_dn - 1.0).abs() < HELD_LEVEL);
    let lights = || held.iter().map(|&i| light(i));
    let ratio = lights().fold(0.0, f64::max) / lights().fold(f64::INFINITY, f64::min);
    if held.len() < 2 || ratio < MIN_HELD_RATIO || others.len() < MIN_OTHERS {
        return None;
    }
    let transfer = Transfer::of(campaign, zero, &held)?;
    let points: Vec<(f64, f64)> = others.iter().map(|&i| (light(i), above(i))).collect();
    let (dn, dn_per_light) = median_line(&points)?;
    let is_of_gain = |&i: &usize| {
        let expected_dn = dn + dn_per_light * light(i);
        let off = (above(i) / expected_dn).ln();
        let Some((noise, std)) = transfer.off(campaign, i, expected_dn) else { return false };
        tracing::debug!("set {}: level {off:+.3}, noise {noise:+.3} +- {std:.3}", campaign.sets[i].number);
        off < -MIN_OFF && (noise - 2.0 * off).abs() < (SAME_GAIN * -off).max(2.0 * std)
            // A wrong label, or light held constant, has the noise of the level.
            && (noise - off).abs() > (noise - 2.0 * off).abs()
    };
    let held: Vec<usize> = held.into_iter().filter(is_of_gain).collect();
    (held.len() > 1).then_some((held, held_dn))
}
