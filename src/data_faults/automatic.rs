//! Automatic exposure or gain: the level of several flats is one, whatever exposure and light are stated. A well that is
//! full ends the level too, and with it the response of the pixels: their pattern goes, which an automatic control leaves.

use super::campaign::SetView;
use super::orientation::flattened;
use super::patterns::{Noise, noise_of_mean, share};
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
/// Pixels below which no pattern tells.
const MIN_PIXELS: usize = 1024;

/// The check.
pub struct Automatic;

impl Check for Automatic {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_one_bench()) else { return Vec::new() };
        let usable = |s: &SetView| !s.clipped && s.variance_dn2().is_some() && s.facts.middle_columns > 0;
        let flats = campaign.places(|s| s.is_lit() && usable(s));
        let above = |i: usize| campaign.sets[i].level_dn() - zero.at(campaign.sets[i].exposure_s);
        let light = |i: usize| campaign.sets[i].exposure_s * campaign.sets[i].illumination;
        let highest = flats.iter().map(|&i| above(i)).fold(0.0, f64::max);
        let mut held: Vec<usize> =
            flats.iter().copied().filter(|&i| above(i) > (1.0 - SAME_LEVEL) * highest).collect();
        held.sort_by(|a, b| light(*a).total_cmp(&light(*b)));
        let [first, .., last] = *held.as_slice() else { return Vec::new() };
        let pixels = campaign.sets[first].facts.middle_dn.len();
        if held.len() < MIN_FLATS
            || light(last) < MIN_RATIO * light(first)
            || pixels < MIN_PIXELS
            || campaign.sets[last].facts.middle_dn.len() != pixels
        {
            return Vec::new();
        }
        let columns = campaign.sets[first].facts.middle_columns;
        let pattern = |i: usize| {
            let image: Vec<f64> = campaign.sets[i].facts.middle_dn.iter().map(|v| f64::from(*v)).collect();
            flattened(&image, columns)
        };
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
        // Under one light the first counts; where the gain was regulated it may have been from the first on.
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
