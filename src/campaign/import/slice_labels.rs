//! Slice labels of ImageJ stacks: names of the source files.

use super::{Facts, names};
use crate::dataset::image;
use std::collections::BTreeMap;
use std::path::Path;
use tiff::tags::Tag;

/// TIFF tags of ImageJ: byte counts of its metadata, and the metadata (ImageJ, `TiffEncoder`).
const SIZES: Tag = Tag::Unknown(50_838);
const KEPT: Tag = Tag::Unknown(50_839);
/// Source name of facts from a label.
const FROM: &str = "the label of the slice";

/// Reads the facts of the slices from their labels; empty for files without a label per page, or whose
/// labels state neither kind nor exposure.
pub fn facts(path: &Path, pages: &[usize]) -> BTreeMap<usize, Facts> {
    let labels = || {
        let directories = image::tiff_directories(path).ok()?;
        let mut decoder = directories.decoder(path, 0).ok()?;
        let sizes = decoder.get_tag_u32_vec(SIZES).ok()?;
        labels_of(&sizes, &decoder.get_tag_u8_vec(KEPT).ok()?)
    };
    let Some(labels) = labels().filter(|labels| labels.len() == pages.len()) else { return BTreeMap::new() };
    let told = |(page, label): (&usize, String)| {
        // Lines after the first are the header of the source file.
        let mut found = names::facts_in(&[], 0, label.lines().next().unwrap_or_default().trim());
        found.from.values_mut().for_each(|from| *from = FROM.into());
        (*page, found)
    };
    let told: BTreeMap<usize, Facts> = pages.iter().zip(labels).map(told).collect();
    let says = |facts: &Facts| facts.kind.is_some() || facts.exposure_s.is_some();
    if told.values().any(says) { told } else { BTreeMap::new() }
}

/// Parses the label texts: `IJIJ`, kinds with their counts, then each text as UTF-16, all in the byte
/// order of the file.
fn labels_of(sizes: &[u32], kept: &[u8]) -> Option<Vec<String>> {
    let is_big = match kept.get(..4)? {
        b"IJIJ" => true,
        b"JIJI" => false,
        _ => return None,
    };
    let number = |at: usize| {
        let bytes: [u8; 4] = kept.get(at..at + 4)?.try_into().ok()?;
        Some(if is_big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    };
    let (header, sizes) = sizes.split_first()?;
    let (mut at, mut place) = (*header as usize, 0usize);
    for kind in (4..*header as usize).step_by(8) {
        let count = number(kind + 4)? as usize;
        let of_kind = sizes.get(place..place.checked_add(count)?)?;
        let mut texts = Vec::new();
        for size in of_kind {
            let bytes = kept.get(at..at.checked_add(*size as usize)?)?;
            let unit = |pair: &[u8]| {
                let pair = [pair[0], pair[1]];
                if is_big { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) }
            };
            let units: Vec<u16> = bytes.chunks_exact(2).map(unit).collect();
            texts.push(String::from_utf16_lossy(&units));
            at += *size as usize;
        }
        // "labl"
        if number(kind)? == 0x6c61_626c {
            return Some(texts);
        }
        place += count;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns byte counts and metadata as ImageJ writes them: a text of another kind, then labels.
    fn kept(labels: &[&str], is_big: bool) -> (Vec<u32>, Vec<u8>) {
        let number = |n: u32| if is_big { n.to_be_bytes() } else { n.to_le_bytes() };
        let text = |t: &str| -> Vec<u8> {
            t.encode_utf16().flat_map(|u| if is_big { u.to_be_bytes() } else { u.to_le_bytes() }).collect()
        };
        let all: Vec<Vec<u8>> = ["Info: none"].iter().chain(labels).map(|t| text(t)).collect();
        let header = [0x494a_494a, 0x696e_666f, 1, 0x6c61_626c, labels.len() as u32].map(number).concat();
        let sizes = std::iter::once(header.len()).chain(all.iter().map(Vec::len)).map(|n| n as u32).collect();
        (sizes, [header, all.concat()].concat())
    }

    #[test]
    fn labels_are_read_in_both_orders_of_bytes() {
        for is_big in [true, false] {
            let (sizes, bytes) = kept(&["flat_5ms.tif", "Dünkel µ\nBITPIX = 16"], is_big);
            assert_eq!(labels_of(&sizes, &bytes).unwrap(), ["flat_5ms.tif", "Dünkel µ\nBITPIX = 16"]);
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(
            sizes in proptest::collection::vec(prop_oneof![0u32..64, any::<u32>()], 0..6),
            mut bytes in proptest::collection::vec(any::<u8>(), 0..80),
            big in any::<bool>(),
        ) {
            if bytes.len() >= 4 {
                bytes[..4].copy_from_slice(if big { b"IJIJ" } else { b"JIJI" });
            }
            let _ = labels_of(&sizes, &bytes);
        }
    }
}
