//! Writer of the descriptor file of the EMVA 1288 reference tool, for radcam campaigns.

use crate::dataset::{Dataset, DatasetError, Kind, Set, write_whole};
use std::collections::HashSet;
use std::path::PathBuf;

/// Name of the descriptor inside a dataset.
pub const DESCRIPTOR: &str = "EMVA1288_Data.txt";

/// Writes the descriptor of a campaign, with which the reference tool and [`Dataset::open`] read its
/// frames: pairs of flats with darks of the same exposure, one stack of each, and `dc` lines with darks
/// of other exposures, which the reference tool ignores. If photons are unknown, they are counted as
/// relative light times nanoseconds.
///
/// Returns None, and writes nothing, if the campaign has no such pairs.
///
/// # Errors
///
/// The file cannot be written.
pub fn write_descriptor(dataset: &Dataset) -> Result<Option<PathBuf>, DatasetError> {
    let Some(text) = text(dataset) else { return Ok(None) };
    let path = dataset.root().join(DESCRIPTOR);
    write_whole(&path, text.as_bytes())?;
    Ok(Some(path))
}

fn text(dataset: &Dataset) -> Option<String> {
    let manifest = dataset.manifest();
    let bench = manifest.bench.as_ref();
    let in_photons = bench.is_some_and(|b| b.illumination_unit == "photons/px/s");
    let unit =
        if in_photons { Some(1.0) } else { bench.and_then(|b| b.light).and_then(|l| l.photons_per_px_s()) };
    let settings = |s: &Set| dataset.settings(s);
    let ns = |s: &Set| settings(s).exposure_s * 1e9;
    let of = |kind: Kind, wanted: fn(usize) -> bool| {
        dataset.sets().iter().filter(move |s| settings(s).kind == kind && wanted(s.rows.len()))
    };
    let key = |s: &Set| format!("{:.3}", ns(s));
    let two: fn(usize) -> bool = |n| n == 2;
    let more: fn(usize) -> bool = |n| n > 2;
    let dark_pairs: Vec<&Set> = of(Kind::Dark, two).collect();
    let dark_keys: HashSet<String> = dark_pairs.iter().map(|s| key(s)).collect();
    let flats: Vec<&Set> = of(Kind::Flat, two).filter(|s| dark_keys.contains(&key(s))).collect();
    if flats.is_empty() {
        return None;
    }
    let flat_keys: HashSet<String> = flats.iter().map(|s| key(s)).collect();
    let camera = &manifest.camera;
    let mut out = format!(
        "# {} {} {}\n# Written by radcam {}. Lines dc are darks for the dark current alone; the reference tool warns of them and passes on.\n{}v 4.0\nn {} {} {}\n",
        camera.vendor,
        camera.model,
        camera.serial,
        env!("CARGO_PKG_VERSION"),
        if unit.is_some() {
            ""
        } else {
            "# The light is not known in photons: they are relative light times nanoseconds.\n"
        },
        camera.bit_depth,
        camera.width,
        camera.height,
    );
    let photons =
        |s: &Set| settings(s).illumination * unit.map_or(ns(s), |flux| flux * settings(s).exposure_s);
    let mut put = |head: String, set: &Set| {
        out += &format!("{head}\n");
        for &row in &set.rows {
            out += &format!("i {}\n", dataset.rows()[row].file.replace('/', "\\"));
        }
    };
    let bright = |s: &Set| format!("b {} {}", key(s), photons(s));
    let dark = |s: &Set| format!("d {}", key(s));
    let mut taken = HashSet::new();
    for set in &flats {
        if taken.insert(bright(set)) {
            put(bright(set), set);
        }
    }
    for set in dark_pairs.iter().filter(|s| flat_keys.contains(&key(s))) {
        if taken.insert(dark(set)) {
            put(dark(set), set);
        }
    }
    // One stack of each kind: the tool supports no more.
    let stack =
        of(Kind::Flat, more).find_map(|f| Some((f, of(Kind::Dark, more).find(|d| key(d) == key(f))?)));
    if let Some((flat, of_dark)) = stack {
        put(bright(flat), flat);
        put(dark(of_dark), of_dark);
    }
    for set in dark_pairs.iter().filter(|s| !flat_keys.contains(&key(s))) {
        put(format!("dc {}", key(set)), set);
    }
    Some(out)
}
