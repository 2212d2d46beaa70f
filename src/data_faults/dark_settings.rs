//! A dark of another black level or gain than the other darks.

use super::law::{Law, Point};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use crate::statistics::median::median;

/// Usual scatter of a dark set's level, DN.
const USUAL_DN: f64 = 0.1;
/// Least deviation that is said, DN.
const LEAST_DN: f64 = 1.0;
/// Darks below which none stands out.
const FEWEST: usize = 4;
/// Ratio of the noise's standard deviations up to which the gain is the same.
const SAME_GAIN: f64 = 1.1;

/// The check.
pub struct DarkSettings;

impl Check for DarkSettings {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let darks = campaign.places(|s| s.kind == Kind::Dark && !s.clipped);
        if darks.len() < FEWEST {
            return Vec::new();
        }
        let longest = darks.iter().map(|&i| campaign.sets[i].exposure_s).fold(0.0, f64::max);
        let frame = campaign.dark_scatter_dn();
        let points: Vec<Point> = darks
            .iter()
            .map(|&i| {
                let set = &campaign.sets[i];
                let t = set.exposure_s / longest;
                let std = USUAL_DN.hypot(frame / (set.frames() as f64).sqrt());
                Point { factors: vec![1.0, t, t * t], value: set.level_dn(), std }
            })
            .collect();
        let Some(law) = Law::fit(&points, &[1e6, 1e6, 1.0], (darks.len() / 4).clamp(1, 3)) else { return Vec::new() };
        let noise = |i: usize| campaign.sets[i].variance_dn2().map_or(f64::NAN, |v| v.0).sqrt();
        let usual = median(darks.iter().map(|&i| noise(i)).filter(|n| n.is_finite()));
        let mut found = Vec::new();
        for &k in &law.out {
            let (i, off) = (darks[k], points[k].value - law.at(&points[k].factors));
            // The longest exposure alone says what its charge is.
            let alone = points.iter().filter(|p| p.factors[1] >= 0.5 * points[k].factors[1]).count() == 1;
            if off.abs() < LEAST_DN || (alone && off > 0.0) {
                continue;
            }
            let ratio = noise(i) / usual;
            let of_gain = ratio.is_finite() && !(SAME_GAIN.recip()..SAME_GAIN).contains(&ratio);
            let what = if of_gain {
                format!("another gain, {} times that of the other darks by its noise: its", six_digits(ratio))
            } else {
                "another black level: its".into()
            };
            let text = format!(
                "set {} ({}): {what} level is {} DN {} that of the other darks",
                campaign.sets[i].number,
                campaign.file(i, 0),
                six_digits(off.abs()),
                if off < 0.0 { "below" } else { "above" }
            );
            found.push((i, text));
        }
        found.into_iter().map(|(i, text)| campaign.fault_of_sets(FaultKind::OtherSettings, &[i], text, true)).collect()
    }
}
