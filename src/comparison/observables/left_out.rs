//! Frames and samples that are left out of a campaign, in words.

use super::read::LeftOut;
use crate::dataset::Dataset;
use crate::statistics::outliers;
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// Describes the frames and samples that were left out.
pub(super) fn words(dataset: &Dataset, left_out: &[(usize, LeftOut)]) -> Vec<String> {
    let name = |set: usize, place: usize| {
        let set = &dataset.sets()[set];
        let file = set.rows.get(place).map_or("", |r| dataset.rows()[*r].file.as_str());
        format!("frame {place} of set {} ({file})", set.number)
    };
    let mut out = Vec::new();
    let frames: Vec<String> =
        left_out.iter().flat_map(|(set, l)| l.frames.iter().map(|f| name(*set, *f))).collect();
    if !frames.is_empty() {
        let shown = frames.iter().take(6).cloned().collect::<Vec<_>>().join(", ");
        let more = if frames.len() > 6 { format!(" and {} more", frames.len() - 6) } else { String::new() };
        out.push(format!(
            "{shown}{more} lie far from the other frames of their sets (a flash, something in the light) and are left out"
        ));
    }
    let mut hit: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (set, left_out) in left_out {
        for (_, place) in &left_out.struck {
            *hit.entry((*set, *place)).or_default() += 1;
        }
    }
    let struck: usize = hit.values().sum();
    if struck > 0 {
        let mut frames: Vec<((usize, usize), usize)> = hit.into_iter().collect();
        frames.sort_by_key(|(_, samples)| Reverse(*samples));
        let shown: Vec<String> = frames
            .iter()
            .take(4)
            .map(|((set, place), samples)| match samples {
                1 => name(*set, *place),
                n => format!("{n} in {}", name(*set, *place)),
            })
            .collect();
        let more = match frames.len() - shown.len() {
            0 => String::new(),
            1 => " and one more frame".into(),
            n => format!(" and {n} more frames"),
        };
        let (what, shown) = (outliers::in_words(struck as u64), shown.join(", "));
        out.push(format!("{what}; left out: {shown}{more}"));
    }
    out
}
