//! Frames and samples that are left out of a campaign, in words.

use super::read::LeftOut;
use crate::dataset::Dataset;
use crate::statistics::outliers;

/// Frames and samples that were left out, in words.
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
    let struck: usize = left_out.iter().map(|(_, l)| l.struck.len()).sum();
    if struck > 0 {
        let mut hit: Vec<String> =
            left_out.iter().flat_map(|(set, l)| l.struck.iter().map(|s| name(*set, s.1))).collect();
        hit.dedup();
        let shown = hit.iter().take(4).cloned().collect::<Vec<_>>().join(", ");
        let more = if hit.len() > 4 { format!(" and {} more", hit.len() - 4) } else { String::new() };
        out.push(format!("{}; left out: in {shown}{more}", outliers::in_words(struck as u64)));
    }
    out
}
