//! Tags and pages of files, and tables beside them.

use crate::import_cases::{Bench, Camera, sets};
use crate::tiff_files::rename_tag;
use radcam::dataset::Kind;
use std::fs;
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::Gray16;
use tiff::tags::Tag;

/// Pages of one file, each with a description of its own.
#[test]
fn pages_have_their_own_exposures() {
    let bench = Bench::new();
    let mut camera = Camera::new(54);
    let pages = [(0.0, 5.0, "dark"), (0.0, 5.0, "dark"), (2000.0, 20.0, "flat"), (2000.0, 20.0, "flat")];
    let mut encoder =
        tiff::encoder::TiffEncoder::new(fs::File::create(bench.path("in/all.tif")).unwrap()).unwrap();
    for (light, ms, kind) in pages {
        let frame = camera.frame(light, ms / 1e3);
        let size = frame.nrows() as u32;
        let mut image = encoder.new_image::<Gray16>(size, size).unwrap();
        let text = format!("{{\"kind\": \"{kind}\", \"exposure_ms\": {ms}, \"Gain\": 6}}");
        image.encoder().write_tag(tiff::tags::Tag::ImageDescription, &*text).unwrap();
        image.write_data(frame.as_slice().unwrap()).unwrap();
    }
    drop(encoder);
    let (dataset, said) = bench.import("in", &[]);
    assert_eq!(sets(&dataset), [(Kind::Dark, 0.005, 2), (Kind::Flat, 0.02, 2)]);
    assert_eq!(dataset.manifest().camera.gain_db, Some(6.0));
    assert!(!said.contains("guess"), "{said}");
}

/// A second page with a small picture for browsers is no frame, also where nothing marks it as one.
#[test]
fn small_pictures_behind_a_frame_are_left_out() {
    let bench = Bench::new();
    let mut camera = Camera::new(55);
    for (name, light) in
        [("dark_10ms_0", 0.0), ("dark_10ms_1", 0.0), ("flat_10ms_0", 2000.0), ("flat_10ms_1", 2000.0)]
    {
        let frame = camera.frame(light, 0.01);
        let file = fs::File::create(bench.path(&format!("in/{name}.tif"))).unwrap();
        let mut encoder = tiff::encoder::TiffEncoder::new(file).unwrap();
        encoder.write_image::<Gray16>(32, 32, frame.as_slice().unwrap()).unwrap();
        encoder.write_image::<Gray16>(8, 8, &[40_000; 64]).unwrap();
    }
    let (dataset, said) = bench.import("in", &[]);
    assert_eq!(sets(&dataset), [(Kind::Dark, 0.01, 2), (Kind::Flat, 0.01, 2)]);
    assert!(said.contains("1 of 2 pages are left out"), "{said}");
}

/// Tables of scripts: one row for a frame, for a set by the beginning of its names, or for a folder.
#[test]
fn tables_beside_the_frames_are_read() {
    let bench = Bench::new();
    let mut camera = Camera::new(53);
    let right = [(Kind::Dark, 0.005, 2), (Kind::Flat, 0.02, 2), (Kind::Flat, 0.03, 2)];
    let all = [("a", "dark", 5.0, 0.0), ("b", "flat", 20.0, 2000.0), ("c", "flat", 30.0, 3000.0)];
    let text = |name: &str, rows: &[String]| fs::write(bench.path(name), rows.join("\r\n")).unwrap();
    let mut rows = [
        vec!["image;kind;exposure (ms)".to_string()],
        vec!["#comment".to_string(), "prefix,type,kind,exposure_s".to_string()],
        vec!["exposure_us\tkind\tfolder".to_string()],
    ];
    for (name, kind, ms, light) in all {
        for k in 0..2 {
            let frame = camera.frame(light, ms / 1e3);
            ["frames", "sets"].iter().for_each(|f| bench.tiff(&format!("{f}/{name}_{k}.tif"), &frame));
            bench.tiff(&format!("folders/{name}/img_{k}.tif"), &frame);
            rows[0].push(
                format!("C:\\data\\{name}_{k}.tif;{kind};{:.1}", ms)
                    .replace('.', ",")
                    .replace(",tif", ".tif"),
            );
        }
        rows[1].push(format!("{name},raw,{kind},{}", ms / 1e3));
        rows[2].push(format!("{}\t{kind}\tfolders/{name}", ms * 1e3));
    }
    text("frames/exposures.csv", &rows[0]);
    text("sets/log.csv", &rows[1]);
    text("folders/sets.tsv", &rows[2]);
    for folder in ["frames", "sets", "folders"] {
        let (dataset, said) = bench.import(folder, &["--explain"]);
        assert_eq!(sets(&dataset), right, "{folder}");
        assert!(said.contains("sv: exposure"), "{said}");
    }
    // A table that tells two exposures of one frame is asked, and one without a unit tells nothing.
    text("sets/log.csv", &["name,exposure_ms".into(), "b,20".into(), "b,21".into()]);
    assert!(bench.refused("sets").contains("exposure_ms 21"), "{}", bench.refused("sets"));
    text("sets/log.csv", &["name,exposure".into(), "a,20".into()]);
    assert!(bench.refused("sets").contains("exposure_s of set 0"));
}

/// A table that German Excel saved in Windows' letters, one whose rows name the first and the last frame, and
/// one that names other frames, which is said.
#[test]
fn tables_of_spreadsheets_are_read() {
    let bench = Bench::new();
    let mut camera = Camera::new(57);
    let right = [(Kind::Dark, 0.005, 2), (Kind::Flat, 0.0125, 2), (Kind::Flat, 0.02, 2)];
    let all = [("Dunkel", 5.0, 0.0), ("Hell", 12.5, 1250.0), ("Hell", 20.0, 2000.0)];
    let mut german = "Datei;Art;Belichtungszeit [ms];Verst\u{e4}rkung [dB]\r\n".to_string();
    let mut ranges = "first,last,exposure_ms,type\n".to_string();
    for (set, (kind, ms, light)) in all.into_iter().enumerate() {
        for k in 1..=2 {
            let (name, frame) = (format!("img_{:04}", 2 * set + k), camera.frame(light, ms / 1e3));
            ["german", "ranges", "other"].iter().for_each(|f| bench.tiff(&format!("{f}/{name}.tif"), &frame));
            german += &format!("{name}.tif;{kind};{};0,0\r\n", ms.to_string().replace('.', ","));
        }
        let english = if light > 0.0 { "flat" } else { "dark" };
        ranges += &format!("img_{:04}.tif,img_{:04}.tif,{ms},{english}\n", 2 * set + 1, 2 * set + 2);
    }
    let windows: Vec<u8> = german.chars().map(|c| u8::try_from(u32::from(c)).unwrap()).collect();
    fs::write(bench.path("german/Protokoll.csv"), windows).unwrap();
    fs::write(bench.path("ranges/log.csv"), ranges).unwrap();
    for folder in ["german", "ranges"] {
        assert_eq!(sets(&bench.import(folder, &[]).0), right, "{folder}");
    }
    fs::write(bench.path("other/log.csv"), "file,exposure_ms\nscan_1.tif,5\n").unwrap();
    let said = bench.refused("other");
    assert!(said.contains("no row names a frame or a folder (it has \"scan_1.tif\")"), "{said}");
}

/// Notes of a person: a line for each folder. A list that names none of them is said.
#[test]
fn lists_in_plain_text_are_read() {
    let bench = Bench::new();
    let mut camera = Camera::new(59);
    let all = [(5.0, 0.0, " (Kappe zu)"), (5.0, 500.0, ""), (10.0, 1000.0, ""), (20.0, 2000.0, "")];
    let mut lines = ["read", "other"].map(|_| "Kamera: DMK 33UX252, Gain 0 dB\n\n".to_string());
    for (run, (ms, light, words)) in all.into_iter().enumerate() {
        for k in 0..2 {
            let frame = camera.frame(light, ms / 1e3);
            ["read", "other"]
                .iter()
                .for_each(|f| bench.tiff(&format!("{f}/Messung0{run}/bild{k}.tif"), &frame));
        }
        lines[0] += &format!("Messung0{run}: {ms} ms{words}\n");
        lines[1] += &format!("Run {run}: {ms} ms{words}\n");
    }
    // Names count more than prose.
    let frame = camera.frame(3000.0, 0.03);
    (0..2).for_each(|k| bench.tiff(&format!("read/flat_30ms/bild{k}.tif"), &frame));
    lines[0] += "flat_30ms: begun with 5 ms, then 30 ms\n";
    fs::write(bench.path("read/Belichtungen.txt"), &lines[0]).unwrap();
    fs::write(bench.path("other/Belichtungen.txt"), &lines[1]).unwrap();
    let flats = [0.005, 0.01, 0.02, 0.03].map(|exposure_s| (Kind::Flat, exposure_s, 2));
    let right: Vec<_> = [(Kind::Dark, 0.005, 2)].into_iter().chain(flats).collect();
    assert_eq!(sets(&bench.import("read", &[]).0), right);
    let said = bench.refused("other");
    assert!(said.contains("Belichtungen.txt") && said.contains("no row names a frame or a folder"), "{said}");
}

/// ImageJ's stack of named files keeps their names.
#[test]
fn labels_of_slices_are_read() {
    let bench = Bench::new();
    let mut camera = Camera::new(58);
    let all = [("dark_5ms", 0.0, 0.005), ("flat_5ms", 500.0, 0.005), ("flat_10ms", 1000.0, 0.01)];
    let (mut pages, mut labels) = (Vec::new(), Vec::new());
    for (name, light_e, exposure_s) in all {
        for k in 0..2 {
            pages.push(camera.frame(light_e, exposure_s));
            labels.push(format!("{name}_{k}.tif\nBITPIX = 16"));
        }
    }
    let units: Vec<Vec<u8>> =
        labels.iter().map(|l| l.encode_utf16().flat_map(u16::to_le_bytes).collect()).collect();
    let header = [b"JIJIlbal".to_vec(), (labels.len() as u32).to_le_bytes().to_vec()].concat();
    let sizes: Vec<u32> =
        std::iter::once(header.len()).chain(units.iter().map(Vec::len)).map(|n| n as u32).collect();
    let kept = [header, units.concat()].concat();
    let mut file = std::io::Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut file).unwrap();
    for (k, page) in pages.iter().enumerate() {
        let mut image = encoder.new_image::<Gray16>(page.ncols() as u32, page.nrows() as u32).unwrap();
        if k == 0 {
            image.encoder().write_tag(Tag::Unknown(50_838), &sizes[..]).unwrap();
            image.encoder().write_tag(Tag::Unknown(50_839), &kept[..]).unwrap();
        }
        image.write_data(page.as_slice().unwrap()).unwrap();
    }
    fs::write(bench.path("in/Stack.tif"), file.into_inner()).unwrap();
    let (dataset, said) = bench.import("in", &["--explain"]);
    let right = [(Kind::Dark, 0.005, 2), (Kind::Flat, 0.005, 2), (Kind::Flat, 0.01, 2)];
    assert_eq!(sets(&dataset), right);
    assert!(said.contains("the label of the slice"), "{said}");
}

/// Flats that were each divided by their mean tell no gain, and means of frames tell another: asked.
#[test]
fn flats_divided_by_their_means_are_asked() {
    let bench = Bench::new();
    let mut camera = Camera::new(56);
    let mut array = |name: &str, light: f64, by: Option<f64>| {
        let frame = camera.frame(light, 0.01).mapv(f64::from);
        let mean = by.unwrap_or_else(|| frame.mean().unwrap());
        let mut bytes = b"\x93NUMPY\x01\x00\x46\x00".to_vec();
        bytes.extend(
            format!("{:<69}\n", "{'descr': '<f4', 'fortran_order': False, 'shape': (32, 32)}").bytes(),
        );
        bytes.extend(frame.iter().flat_map(|v| ((v / mean) as f32).to_le_bytes()));
        fs::write(bench.path(name), bytes).unwrap();
    };
    for k in 0..4 {
        array(&format!("in/dark_10ms_{k}.npy"), 0.0, Some(4095.0));
        array(&format!("in/flat_10ms_{k}.npy"), 2000.0, None);
        for (folder, by) in [("raw", 4095.0), ("means", 7.0)] {
            array(&format!("{folder}/dark_10ms_{k}.npy"), 0.0, Some(by));
            array(&format!("{folder}/flat_10ms_{k}.npy"), 2000.0, Some(by));
        }
    }
    let said = bench.refused("in");
    assert!(said.contains("each was divided by its own"), "{said}");
    bench.import("raw", &[]);
    // Sums of seven frames over seven have such values too.
    let said = bench.refused("means");
    assert!(said.contains("all values are multiples of 1/7: means of 7 frames"), "{said}");
}

/// A frame as TIFF with texts and numbers in tags.
fn tagged(
    bench: &Bench,
    name: &str,
    frame: &ndarray::Array2<u16>,
    texts: &[(Tag, &str)],
    orientation: Option<u16>,
) {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
    let size = frame.nrows() as u32;
    let mut image = encoder.new_image::<Gray16>(size, size).unwrap();
    texts.iter().for_each(|(tag, text)| image.encoder().write_tag(*tag, *text).unwrap());
    orientation.iter().for_each(|o| image.encoder().write_tag(Tag::Orientation, *o).unwrap());
    image.write_data(frame.as_slice().unwrap()).unwrap();
    fs::write(bench.path(name), bytes.into_inner()).unwrap();
}

/// Python's tifffile writes the text of its caller, and behind it the shape of the array, as two
/// ImageDescriptions.
#[test]
fn the_first_of_two_descriptions_is_read() {
    let bench = Bench::new();
    let mut camera = Camera::new(57);
    let mut frame = |name: &str, light: f64, text: &str| {
        let frame = camera.frame(light, 0.01);
        let texts = [(Tag::Unknown(269), text), (Tag::ImageDescription, r#"{"shape": [32, 32]}"#)];
        tagged(&bench, name, &frame, &texts, None);
        let mut bytes = fs::read(bench.path(name)).unwrap();
        rename_tag(&mut bytes, 269, 270);
        fs::write(bench.path(name), bytes).unwrap();
    };
    for k in 0..2 {
        frame(&format!("in/d{k}.tif"), 0.0, "kind=dark\nexposure=5 ms\ngain_db=6");
        frame(&format!("in/f{k}.tif"), 2000.0, "kind=flat\nexposure=20 ms\ngain_db=6");
        frame(&format!("colour/flat_10ms_{k}.tif"), 2000.0, r#"{"PixelFormat": "BayerRG12"}"#);
        frame(&format!("colour/dark_10ms_{k}.tif"), 0.0, r#"{"PixelFormat": "BayerRG12"}"#);
    }
    let (dataset, _) = bench.import("in", &[]);
    assert_eq!(sets(&dataset), [(Kind::Dark, 0.005, 2), (Kind::Flat, 0.02, 2)]);
    assert_eq!(dataset.manifest().camera.gain_db, Some(6.0));
    assert!(bench.refused("colour").contains("RGGB"));
}

/// Frames that viewers turn beside frames that they do not: refused.
#[test]
fn two_orientations_are_refused() {
    let bench = Bench::new();
    let mut camera = Camera::new(58);
    for k in 0..2 {
        tagged(&bench, &format!("in/dark_10ms_{k}.tif"), &camera.frame(0.0, 0.01), &[], None);
        tagged(&bench, &format!("in/flat_10ms_{k}.tif"), &camera.frame(2000.0, 0.01), &[], Some(4));
        tagged(&bench, &format!("one/dark_10ms_{k}.tif"), &camera.frame(0.0, 0.01), &[], Some(1));
        tagged(&bench, &format!("one/flat_10ms_{k}.tif"), &camera.frame(2000.0, 0.01), &[], None);
    }
    assert!(bench.refused("in").contains("Orientation"));
    assert_eq!(bench.import("one", &[]).0.rows().len(), 4);
}
