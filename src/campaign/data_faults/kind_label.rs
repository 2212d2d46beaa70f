//! Exchanged labels of darks and flats: a dark with the level and noise of light, a flat without light.
//! Flats with far less light than stated have a wrong label: the law of levels needs more flats to
//! reveal it.

use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::{Kind, LONG_DARKS};
use crate::number::six_digits;
use crate::statistics::median::median;

/// Minimum range of levels that distinguishes light from darkness, DN.
const MIN_RANGE_DN: f64 = 20.0;
/// Minimum level of a lit dark, relative to the range: offsets and charge of usual darks are smaller.
const MIN_LIT_SHARE: f64 = 0.05;
/// Maximum level of a flat without light, relative to that of its label.
const MAX_UNLIT_SHARE: f64 = 0.02;
/// Maximum relative deviation of a dark from the level of flats of its exposure at which it is one of
/// them, and maximum level of another dark relative to it.
const AS_LIT: (f64, f64) = (0.1, 0.05);
/// Minimum distance of both from darks, standard deviations of a frame's mean.
const MIN_SIGMAS: f64 = 20.0;

/// Check for exchanged dark and flat labels.
pub struct KindLabel;

impl Check for KindLabel {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let all = campaign.places(|s| matches!(s.kind, Kind::Dark | Kind::Flat));
        // The first frame may contain carry-over: for a dark the last one is used.
        let level = |i: usize| match campaign.sets[i].kind {
            Kind::Dark => campaign.sets[i].means_dn().last().copied().unwrap_or(f64::NAN),
            _ => campaign.sets[i].level_dn(),
        };
        let lowest = all.iter().map(|&i| level(i)).fold(f64::INFINITY, f64::min);
        let highest = all.iter().map(|&i| level(i)).fold(f64::NEG_INFINITY, f64::max);
        if all.is_empty() || highest - lowest <= MIN_RANGE_DN {
            return Vec::new();
        }
        let darks = campaign.places(|s| s.kind == Kind::Dark);
        // Flats that are darker than all darks are darks.
        let extremes = |kind: Kind| {
            let levels = || all.iter().filter(|i| campaign.sets[**i].kind == kind).map(|&i| level(i));
            (levels().fold(f64::INFINITY, f64::min), levels().fold(f64::NEG_INFINITY, f64::max))
        };
        let (of_darks, of_flats) = (extremes(Kind::Dark), extremes(Kind::Flat));
        if darks.len() > 1 && of_flats.1.is_finite() && of_flats.1 + MIN_RANGE_DN < of_darks.0 {
            let text = format!(
                "all sets: dark and flat are exchanged: the stated flats have {} to {} DN, and the stated darks {} to {} DN",
                six_digits(of_flats.0),
                six_digits(of_flats.1),
                six_digits(of_darks.0),
                six_digits(of_darks.1)
            );
            return vec![campaign.fault_of_sets(FaultKind::KindLabel, &all, text, true)];
        }
        let scatter = campaign.dark_scatter_dn();
        let bright: Vec<usize> = darks
            .iter()
            .copied()
            .filter(|&i| level(i) - lowest > MIN_LIT_SHARE * (highest - lowest))
            .collect();
        // Flats without any of the signal that the others have for their exposure and light.
        let zero = campaign.zero_without(&bright);
        let dark_at = |exposure_s: f64| zero.map_or(lowest, |z| z.at(exposure_s));
        let x = |i: usize| campaign.sets[i].exposure_s * campaign.sets[i].illumination;
        let lit = campaign.places(|s| s.is_lit() && !s.clipped);
        let above = |i: usize| level(i) - dark_at(campaign.sets[i].exposure_s);
        let longest_flat_s = lit.iter().map(|&i| campaign.sets[i].exposure_s).fold(0.0, f64::max);
        let response = median(lit.iter().map(|&i| above(i) / x(i)));
        let usual_light = median(lit.iter().map(|&i| campaign.sets[i].illumination));
        // Without darks the dimmest flat would be taken for one.
        let dim: Vec<usize> = lit
            .iter()
            .copied()
            .filter(|_| !darks.is_empty())
            .filter(|&i| {
                let expected = response * x(i);
                expected > MIN_RANGE_DN.max(MIN_SIGMAS * scatter) && above(i) < MAX_UNLIT_SHARE * expected
            })
            .collect();
        // A flat with light, but far less than stated, has a wrong label. The darks say nothing about an
        // exposure that is wrong.
        let own = |i: usize| level(i) - lowest;
        let few_dn = MIN_LIT_SHARE * (highest - lowest);
        let (unlit, wrong): (Vec<usize>, Vec<usize>) =
            dim.iter().copied().partition(|&i| own(i) < few_dn || above(i).abs() < few_dn);
        // A bright dark was lit if another one of the same or a longer exposure is dark, if the charge
        // of the others shows it, or if there is an unlit flat with which it was exchanged.
        let of_light = |&i: &usize| {
            let (own, exposure_s) = (level(i) - lowest, campaign.sets[i].exposure_s);
            let others = || darks.iter().filter(|&&d| d != i && !bright.contains(&d));
            let longer = others()
                .any(|&d| campaign.sets[d].exposure_s >= 0.9 * exposure_s && level(d) - lowest < 0.3 * own);
            let exposures: Vec<f64> = others().map(|&d| campaign.sets[d].exposure_s).collect();
            let several = exposures.iter().any(|e| (e / exposures[0] - 1.0).abs() > 0.01);
            let charge = several && dark_at(exposure_s) - lowest < 0.3 * own;
            // A dark at the level of flats of its exposure is lit as well.
            let expected = response * exposure_s * usual_light;
            let as_lit = (own / expected - 1.0).abs() < AS_LIT.0
                && others().any(|&d| level(d) - lowest < AS_LIT.1 * own);
            // A single dark that is far longer than the flats may have more charge than they have light.
            let long = exposure_s > LONG_DARKS * longest_flat_s;
            own > MIN_SIGMAS * scatter && (longer || charge || as_lit || !long && !unlit.is_empty())
        };
        let lit_darks: Vec<usize> = bright.iter().copied().filter(of_light).collect();
        // If most labels disagree, they mean something else; without a dark, the dimmest flat looks
        // unlit.
        if zero.is_none() && lit_darks.is_empty()
            || lit_darks.len() * 2 > darks.len().max(1) && unlit.len() != lit_darks.len()
            || dim.len() * 2 > lit.len()
        {
            return Vec::new();
        }
        let dn = |sets: &[usize]| six_digits(median(sets.iter().map(|&i| level(i))));
        let dark_dn = |i: usize| six_digits(dark_at(campaign.sets[i].exposure_s));
        let mut found: Vec<(Vec<usize>, String)> = Vec::new();
        if let ([dark], [flat]) = (&*lit_darks, &*unlit) {
            let text = format!(
                "sets {} and {}: dark and flat are exchanged: the stated dark has {} DN, the stated flat {} DN, and darks have {} DN",
                campaign.sets[*dark].number,
                campaign.sets[*flat].number,
                dn(&lit_darks),
                dn(&unlit),
                dark_dn(*flat),
            );
            found.push((vec![(*dark).min(*flat), (*dark).max(*flat)], text));
        } else {
            if let Some(&first) = lit_darks.first() {
                let text = format!(
                    "{}: stated dark, and the level is one of light ({} DN, where darks have {} DN)",
                    campaign.named(&lit_darks),
                    dn(&lit_darks),
                    dark_dn(first),
                );
                found.push((lit_darks.clone(), text));
            }
            if let Some(&first) = unlit.first() {
                let expected = dark_at(campaign.sets[first].exposure_s) + response * x(first);
                let text = format!(
                    "{}: stated flat, and the level is that of darks ({} DN, where its exposure and light belong to {} DN): no light fell on it",
                    campaign.named(&unlit),
                    dn(&unlit),
                    six_digits(expected),
                );
                found.push((unlit.clone(), text));
            }
        }
        let said = |i: usize| {
            let set = &campaign.sets[i];
            let text = format!(
                "{}: {} s at light {} belong to {} DN, and the level is {} DN, as of exposure x light {}",
                campaign.named(&[i]),
                six_digits(set.exposure_s),
                six_digits(set.illumination),
                six_digits(dark_at(set.exposure_s) + response * x(i)),
                six_digits(level(i)),
                six_digits(own(i) / response),
            );
            (FaultKind::SettingLabel, vec![i], text)
        };
        let wrong: Vec<_> = wrong.into_iter().map(said).collect();
        let found = found.into_iter().map(|(sets, text)| (FaultKind::KindLabel, sets, text)).chain(wrong);
        let fault = |(kind, sets, text): (FaultKind, Vec<usize>, String)| {
            campaign.fault_of_sets(kind, &sets, text, true)
        };
        found.map(fault).collect()
    }
}
