//! HDF5 and NeXus: the files of tests/corpus/hdf5, which tests/corpus/hdf5.py made with h5py.

use crate::support::{expect, refused};
use proptest::prelude::*;
use radcam::dataset::{Dataset, Kind, image};
use radcam::import::{ReadOptions, survey};
use serde_json::Value;
use std::path::{Path, PathBuf};

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus/hdf5").join(name)
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn at(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().into()
    }

    /// Imports a file; what was said, the map and the dataset.
    fn import(&self, name: &str, more: &[&str]) -> (Value, Dataset) {
        let (from, to) = (file(name).to_str().unwrap().to_string(), self.at("d"));
        let said = expect(0, &[&["import", &from, "-o", &to, "--yes", "--json"], more].concat());
        (serde_json::from_str(&said).unwrap(), Dataset::open(to.as_ref()).unwrap())
    }
}

/// (kind, exposure in ms, frames) of each set.
fn sets(dataset: &Dataset) -> Vec<(Kind, f64, usize)> {
    let of = |set: &radcam::dataset::Set| {
        let row = dataset.settings(set);
        (row.kind, 1e3 * row.exposure_s, set.rows.len())
    };
    dataset.sets().iter().map(of).collect()
}

/// Image keys of tomography: flats and darks become sets by the time of each frame, projections are left out
/// and said, and `noise` finds the gain of the generator.
#[test]
fn image_keys_of_nexus_are_kinds() {
    let folder = Folder::new();
    let (map, dataset) = folder.import("nxtomo.nxs", &[]);
    let (dark, flat) = (Kind::Dark, Kind::Flat);
    let wanted =
        [(dark, 1.0, 6), (flat, 5.0, 6), (flat, 10.0, 6), (flat, 20.0, 6), (flat, 40.0, 6), (dark, 40.0, 6)];
    assert_eq!(sets(&dataset), wanted);
    assert_eq!((map["bit_depth"].as_u64(), map["serial"].as_str()), (Some(12), Some("T-17")));
    // The sample's temperature is not the sensor's.
    assert!(map["set"][0].get("temperature_c").is_none(), "{map}");
    let from = map["set"][1]["from"].to_string();
    assert!(from.contains("image_key 1 of /entry/data/data") && from.contains("count_time 5 ms"), "{from}");
    assert!(map["set"][1]["files"][0].as_str().unwrap().ends_with("nxtomo.nxs#6"), "{map}");
    let found: Value = serde_json::from_str(&expect(0, &["noise", &folder.at("d"), "--json"])).unwrap();
    for (name, truth) in [("gain_dn_per_e", 0.5), ("read_noise_e", 4.0)] {
        let of = |field: &str| found[name][field].as_f64().unwrap();
        assert!((of("value") - truth).abs() < 3.0 * of("std_err"), "{name}: {}", found[name]);
    }
    let said = survey(&[file("nxtomo.nxs")], &ReadOptions::default(), |_, _| true).unwrap();
    let notes = said.notes.join("; ");
    assert!(notes.contains("3 frames") && notes.contains("projections (image_key 0)"), "{notes}");
    assert!(notes.contains("1 frames") && notes.contains("invalid frames (image_key 3)"), "{notes}");
}

/// DataExchange: data_white and data_dark say their kind, and data are projections.
#[test]
fn data_exchange_says_its_kinds() {
    let folder = Folder::new();
    let (_, dataset) = folder.import("exchange.h5", &[]);
    assert_eq!(sets(&dataset), [(Kind::Dark, 20.0, 3), (Kind::Flat, 20.0, 3)]);
    let said = survey(&[file("exchange.h5")], &ReadOptions::default(), |_, _| true).unwrap();
    assert!(said.notes[0].contains("4 frames of /exchange/data"), "{:?}", said.notes);
}

/// Single precision packed with LZF in chunks of three frames; exposure and unit in attributes, kind by the
/// name.
#[test]
fn a_plain_stack_is_described_by_its_attributes() {
    let folder = Folder::new();
    let (map, dataset) = folder.import("plain.h5", &[]);
    assert_eq!(sets(&dataset), [(Kind::Flat, 20.0, 5)]);
    assert!(map["set"][0]["from"].to_string().contains("the name of the dataset /flats"), "{map}");
    let frame = dataset.read(&dataset.rows()[4]).unwrap();
    let direct = image::read(&file("plain.h5"), 4).unwrap();
    assert_eq!(frame, direct);
    let mean = frame.iter().map(|v| f64::from(*v)).sum::<f64>() / frame.len() as f64;
    assert!((mean - 740.0).abs() < 10.0, "{mean}");
}

/// Levels by repeats: an attribute has one exposure for each level.
#[test]
fn exposures_of_an_outer_axis_are_read() {
    let (map, dataset) = Folder::new().import("levels.h5", &[]);
    let (dark, flat) = (Kind::Dark, Kind::Flat);
    assert_eq!(sets(&dataset), [(dark, 5.0, 3), (dark, 20.0, 3), (flat, 5.0, 3), (flat, 20.0, 3)], "{map}");
}

/// A file of one frame is read wherever single images are; a stack is refused there.
#[test]
fn a_single_frame_is_an_image() {
    let frame = image::read_single(&file("single.h5")).unwrap();
    assert_eq!(frame.dim(), (12, 16));
    assert_eq!(image::stored_bits(&file("single.h5")).unwrap(), 16);
    let (facts, pages) = radcam::import::facts(&file("single.h5")).unwrap();
    assert_eq!((facts.exposure_s, pages), (Some(0.02), 1));
    let stack = image::read_single(&file("plain.h5")).unwrap_err().to_string();
    assert!(stack.contains("stack of 5 pages"), "{stack}");
}

/// Several datasets are listed with the option that picks one; other reasons are the true ones, with the
/// file.
#[test]
fn a_refusal_says_what_to_do() {
    let folder = Folder::new();
    let refuse = |name: &str, more: &[&str]| {
        let from = file(name).to_str().unwrap().to_string();
        let said =
            refused(&[&["import", &from, "-o", &folder.at("d"), "--yes"], more].concat()).replace('\n', " ");
        assert!(said.contains(name), "{said}");
        said
    };
    let said = refuse("two.h5", &[]);
    for part in ["/scan/camera_1 (3 x 12 x 16)", "/scan/camera_2", "--hdf5-dataset PATH"] {
        assert!(said.contains(part), "{said}");
    }
    assert!(refuse("two.h5", &["--hdf5-dataset", "scan/camera_3"]).contains("it has /scan/camera_1"));
    assert!(refuse("elsewhere.h5", &[]).contains("virtual dataset"));
    assert!(refuse("claims.h5", &[]).contains("more than the file can hold"));
    // A scan that was broken off: the frames that were written are there.
    let said = survey(&[file("broken_off.h5")], &ReadOptions::default(), |_, _| true).unwrap();
    assert!(said.frames.len() == 4 && said.notes[0].contains("4 of 8 frames"), "{:?}", said.notes);
}

/// The dataset that is named is taken, of either byte order, and the map keeps the choice.
#[test]
fn a_dataset_is_picked() {
    let mut means = Vec::new();
    for (path, bits) in [("scan/camera_1", 10), ("/scan/camera_2/", 8)] {
        let folder = Folder::new();
        let (map, dataset) = folder.import("two.h5", &["--hdf5-dataset", path]);
        assert_eq!(map["hdf5_dataset"].as_str(), Some(path));
        assert_eq!((dataset.manifest().camera.bit_depth, dataset.rows().len()), (bits, 3));
        assert!((dataset.rows()[0].exposure_s - 0.02).abs() < 1e-12);
        let frame = dataset.read(&dataset.rows()[0]).unwrap();
        means.push(frame.iter().map(|v| f64::from(*v)).sum::<f64>() / frame.len() as f64);
    }
    assert!((means[0] - 740.0).abs() < 10.0 && (means[1] - 45.8).abs() < 1.0, "{means:?}");
}

/// The axis that counts the frames may be another one.
#[test]
fn frames_lie_along_another_axis() {
    let options = ReadOptions { frames_axis: Some(2), hdf5_dataset: Some("/scan/camera_1".into()) };
    let said = survey(&[file("two.h5")], &options, |_, _| true).unwrap();
    assert_eq!((said.frames.len(), said.frames[0].shape), (16, (3, 12)));
    // Pixels that repeat along the last axis are asked for.
    let of = |axis: Option<usize>| {
        let options = ReadOptions { frames_axis: axis, hdf5_dataset: None };
        survey(&[file("last_axis.h5")], &options, |_, _| true)
    };
    let asked = of(None).unwrap();
    let why = &asked.damaged[0].1;
    assert!(
        asked.frames.is_empty()
            && why.contains("/flat_20ms has the shape")
            && why.contains("--frames-axis 2"),
        "{why}"
    );
    assert_eq!(of(Some(2)).unwrap().frames.len(), 8);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    /// Files that are cut and whose bytes are changed give frames, or an error that names the file; memory is
    /// not taken on the word of a header.
    #[test]
    fn damaged_files_are_named(
        which in 0usize..6,
        cut in prop::option::of(0.0f64..1.0),
        flips in prop::collection::vec((0.0f64..1.0, any::<u8>()), 0..12),
        head in any::<bool>(),
    ) {
        let names = ["nxtomo.nxs", "exchange.h5", "plain.h5", "two.h5", "broken_off.h5", "single.h5"];
        let mut bytes = std::fs::read(file(names[which])).unwrap();
        for (at, value) in flips {
            // The structure of a file is at most some kilobytes of it.
            let reach = if head { bytes.len().min(6000) } else { bytes.len() };
            let at = (at * reach as f64) as usize;
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate((cut * bytes.len() as f64) as usize);
        }
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("damaged.h5");
        std::fs::write(&path, &bytes).unwrap();
        match survey(std::slice::from_ref(&path), &ReadOptions::default(), |_, _| true) {
            Ok(found) => {
                prop_assert!(found.damaged.iter().all(|(of, why)| *of == path && !why.is_empty()));
                prop_assert!(!found.damaged.is_empty() || !found.frames.is_empty());
            }
            Err(e) => prop_assert!(!e.to_string().is_empty()),
        }
    }
}
