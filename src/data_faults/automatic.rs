//! Automatic exposure or gain: several flats have one level, whatever exposure and light are stated. A full
//! well holds the level too, but wipes out the pattern of the pixels' response, which an automatic control
//! leaves.

use super::patterns::{Noise, noise_of_mean, pattern_of, share};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;

/// Difference of the levels, relative, up to which they are one.
const SAME_LEVEL: f64 = 0.03;
/// Least ratio of exposure times light over them, and their least number.
const MIN_RATIO: f64 = 2.0;
const MIN_FLATS: usize = 3;
/// Share of the pattern that is left at least, and its standard error at most.
const MIN_SHARE: f64 = 0.8;
const MAX_STD_ERR: f64 = 0.1;
/// Difference of the noise's variances, relative, up to which it is that of the same light.
const SAME_NOISE: f64 = 0.15;

/// The check.
pub struct Automatic;

impl Check for Automatic {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_one_bench()) else { return Vec::new() };
        let flats = campaign.places(|s| s.is_lit() && s.has_pattern());
        let above = |i: usize| campaign.sets[i].level_dn() - zero.at(campaign.sets[i].exposure_s);
        let light = |i: usize| campaign.sets[i].light();
        let highest = flats.iter().map(|&i| above(i)).fold(0.0, f64::max);
        let mut held: Vec<usize> =
            flats.iter().copied().filter(|&i| above(i) > (1.0 - SAME_LEVEL) * highest).collect();
        held.sort_by(|a, b| light(*a).total_cmp(&light(*b)));
        let [first, .., last] = *held.as_slice() else { return Vec::new() };
        if held.len() < MIN_FLATS
            || light(last) < MIN_RATIO * light(first)
            || !campaign.are_of_one_size(held.iter())
        {
            return Vec::new();
        }
        let columns = campaign.sets[first].facts.middle_columns;
        let pattern = |i: usize| pattern_of(&campaign.sets[i]);
        let noise = Noise::of_flats(noise_of_mean(&campaign.sets[first]));
        let kept = share(&pattern(last), &pattern(first), noise, columns);
        tracing::debug!("{} of one level have {kept:?} of the pattern", campaign.named(&held));
        let alike = MIN_SHARE - MAX_STD_ERR..2.0 - MIN_SHARE + MAX_STD_ERR;
        if !kept.is_some_and(|(part, std)| std < MAX_STD_ERR && alike.contains(&part)) {
            return Vec::new();
        }
        let var = |i: usize| campaign.sets[i].variance_dn2().map_or(f64::NAN, |v| v.0);
        let dark = campaign
            .places(|s| s.kind == Kind::Dark && s.variance_dn2().is_some())
            .iter()
            .map(|&i| var(i))
            .fold(f64::INFINITY, f64::min);
        let (a, b) = (var(first), var(last));
        let one_light = (b / a - 1.0).abs() < SAME_NOISE;
        let falls = b < a && b > 0.5 * dark.min(a);
        if !one_light && !falls {
            return Vec::new();
        }
        // The first counts where all had one light; a gain may have been regulated from the first on.
        let (why, out) = if one_light {
            let of_first = format!(
                "their noise is that of one light: an automatic exposure was on, or the light was set to it; of these only set {} counts",
                campaign.sets[first].number
            );
            (of_first, &held[1..])
        } else {
            let of_gain = "their noise falls as with less and less gain, while the pixels respond as before: an automatic gain was on";
            (of_gain.into(), &held[..])
        };
        let text = format!(
            "{}: all have {} DN above black, though exposure and light are stated to differ by a factor of {}; {why}",
            campaign.named(&held),
            six_digits(above(first)),
            six_digits(light(last) / light(first)),
        );
        vec![campaign.fault_of_sets(FaultKind::OtherSettings, out, text, true)]
    }
}
