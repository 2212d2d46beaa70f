//! Facts of frames in HDF5 files: image keys, dataset names, and values stored with them.

use super::words::{self, Said, Writer};
use super::{Facts, kinds};
use crate::dataset::Kind;
use crate::dataset::image::Stack;
use std::collections::BTreeMap;

/// Frames of an HDF5 file that are used.
pub struct Told {
    /// Facts by page number.
    pub facts: BTreeMap<usize, Facts>,
    /// Descriptions of excluded frames.
    pub notes: Vec<String>,
}

/// Converts an image key (NXtomo of NeXus) to a kind; `None` for projections and invalid frames.
fn of_key(key: i64) -> Option<Kind> {
    match key {
        1 => Some(Kind::Flat),
        2 => Some(Kind::Dark),
        _ => None,
    }
}

/// Returns the kind stated by the name of a dataset: `data_white`, `darks`.
fn of_name(stack: &Stack) -> Option<(Kind, &str)> {
    let said = |path: &String| kinds::of(path.rsplit('/').next().unwrap_or(path));
    stack.paths.iter().find_map(|path| Some((said(path).kind.or(said(path).weak)?, path.as_str())))
}

/// Collects the facts of every frame that is a dark or a flat, or whose kind is not stated.
///
/// # Errors
///
/// The file has neither darks nor flats.
pub fn told(stacks: &[Stack]) -> Result<Told, String> {
    let mut out = Told { facts: BTreeMap::new(), notes: Vec::new() };
    for stack in stacks {
        let said = stack.said.iter().map(|(key, value)| Said::new(key, value));
        let mut of_all = words::facts(said.collect(), Writer::Lines);
        if stack.keys.is_empty() {
            match of_name(stack) {
                Some((kind, path)) => {
                    let from = format!("the name of the dataset {path}");
                    let name = path.rsplit('/').next().unwrap_or(path);
                    let mut named = super::names::facts_in(&[], 0, name);
                    named.from.values_mut().for_each(|f| f.clone_from(&from));
                    of_all = of_all.or(named);
                    of_all.set_kind(kind, &from);
                }
                // Beside datasets that state their kind, the others are projections.
                None if stacks.len() > 1 => {
                    out.notes.push(format!(
                        "{} frames of {} are left out: projections, beside darks and flats",
                        stack.frames,
                        stack.path()
                    ));
                    continue;
                }
                None => {}
            }
        }
        let mut left: BTreeMap<i64, usize> = BTreeMap::new();
        for frame in 0..stack.frames {
            let mut facts = of_all.clone();
            if let Some(&key) = stack.keys.get(frame) {
                let Some(kind) = of_key(key) else {
                    *left.entry(key).or_default() += 1;
                    continue;
                };
                facts.set_kind(kind, &format!("image_key {key} of {}", stack.path()));
            }
            let own =
                stack.of_frames.iter().filter_map(|(key, values)| Some(Said::new(key, values.get(frame)?)));
            let own: Vec<Said> = own.collect();
            if !own.is_empty() {
                facts = words::facts(own, Writer::Lines).or(facts);
            }
            out.facts.insert(stack.first + frame, facts);
        }
        for (key, count) in left {
            let what = if key == 3 { "invalid frames" } else { "projections" };
            out.notes
                .push(format!("{count} frames of {} are left out: {what} (image_key {key})", stack.path()));
        }
    }
    if out.facts.is_empty() {
        return Err(format!("holds neither darks nor flats: {}", out.notes.join("; ")));
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn image_keys_and_names_say_the_kind() {
        let keyed = Stack {
            paths: vec!["/entry/data/data".into()],
            frames: 5,
            keys: vec![2, 1, 0, 0, 3],
            said: vec![("count_time".into(), "20 ms".into()), ("title".into(), "a dark story".into())],
            ..Stack::default()
        };
        let found = told(std::slice::from_ref(&keyed)).unwrap();
        let kinds: Vec<_> = found.facts.iter().map(|(page, f)| (*page, f.kind, f.exposure_s)).collect();
        assert_eq!(kinds, [(0, Some(Kind::Dark), Some(0.02)), (1, Some(Kind::Flat), Some(0.02))]);
        assert!(
            found.notes[0].contains("2 frames") && found.notes[1].contains("invalid"),
            "{:?}",
            found.notes
        );
        let none = Stack { keys: vec![0; 5], ..keyed };
        assert!(told(&[none]).err().unwrap().contains("neither darks nor flats"));
        let exchange = |name: &str, first: usize| Stack {
            paths: vec![format!("/exchange/{name}")],
            first,
            frames: 2,
            of_frames: vec![("exposure_time".into(), vec!["5 ms".into(), "7 ms".into()])],
            ..Stack::default()
        };
        let found =
            told(&[exchange("data", 0), exchange("data_dark", 2), exchange("data_white", 4)]).unwrap();
        let of: Vec<_> = found.facts.iter().map(|(page, f)| (*page, f.kind.unwrap(), f.exposure_s)).collect();
        let (dark, flat) = (Kind::Dark, Kind::Flat);
        assert_eq!(
            of,
            [(2, dark, Some(0.005)), (3, dark, Some(0.007)), (4, flat, Some(0.005)), (5, flat, Some(0.007))]
        );
        // A single dataset has the kind stated by its name or the user.
        assert_eq!(told(&[exchange("data", 0)]).unwrap().facts[&0].kind, None);
    }
}
