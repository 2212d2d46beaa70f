//! Loose files: a folder, a stack, headers, a map; and what cannot be known.

use crate::effects::{campaign, unit, with};
use crate::support::{expect, refused};
use ndarray::Array2;
use radcam::dataset::image::{read, tiff_bytes};
use radcam::dataset::{Dataset, Kind};
use std::fs;
use std::path::Path;

/// The frames of a campaign as people keep them: a folder for each set, settings in its name.
fn loose(dataset: &Dataset, to: &Path) {
    for (k, set) in dataset.sets().iter().enumerate() {
        let row = dataset.settings(set);
        let folder =
            to.join(format!("{k:02}_{}_{}us_light{:?}", row.kind, row.exposure_s * 1e6, row.illumination));
        fs::create_dir_all(&folder).unwrap();
        for &i in &set.rows {
            let row = &dataset.rows()[i];
            fs::copy(dataset.root().join(&row.file), folder.join(format!("img_{}.tif", row.index))).unwrap();
        }
    }
}

/// A folder of TIFFs with exposures in their names becomes a dataset, a verdict and a calibration.
#[test]
fn a_folder_of_tiffs_becomes_a_verdict_and_a_calibration() {
    let dir = tempfile::tempdir().unwrap();
    let of = |name: &str| dir.path().join(name);
    let text = |name: &str| of(name).to_str().unwrap().to_string();
    let model = unit(11);
    let row_noise = radcam_sim::effects::example("row-noise", &model).unwrap();
    campaign(with(model, "row-noise", &row_noise), &of("campaign"));
    let campaign = Dataset::open(&of("campaign")).unwrap();
    loose(&campaign, &of("files"));
    let said = expect(0, &["import", &text("files"), "-o", &text("d"), "--yes"]);
    let (frames, sets) = (campaign.rows().len(), campaign.sets().len());
    assert!(said.contains(&format!("{frames} frames in {sets} sets")), "{said}");
    let imported = Dataset::open(&of("d")).unwrap();
    assert_eq!(imported.rows().len(), campaign.rows().len());
    assert_eq!(imported.manifest().camera.bit_depth, 12);
    for (a, b) in imported.rows().iter().zip(campaign.rows()) {
        assert_eq!((a.kind, a.set, a.index, a.illumination), (b.kind, b.set, b.index, b.illumination));
        assert!((a.exposure_s / b.exposure_s - 1.0).abs() < 1e-9, "{a:?} {b:?}");
        assert_eq!(imported.read(a).unwrap(), campaign.read(b).unwrap());
    }
    let verdict: serde_json::Value =
        serde_json::from_str(&expect(1, &["diagnose", &text("d"), "--json"])).unwrap();
    assert_eq!(verdict["missing"][0]["effect"], "row-noise", "{verdict}");
    expect(0, &["calibrate", &text("d"), "--estimator", "smooth", "-o", &text("cal.tiff")]);
    // A second time it is refused: nothing is written over.
    let said = refused(&["import", &text("files"), "-o", &text("d"), "--yes"]);
    assert!(said.contains("is there already"), "{said}");
}

/// A dark and a lit stack of three pages, as ImageJ writes them. Their exposure stands nowhere: the map asks
/// for it.
#[test]
fn a_stack_is_a_set_and_what_is_not_known_is_asked() {
    let dir = tempfile::tempdir().unwrap();
    let text = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    for (name, level) in [("a.tif", 40u16), ("b.tif", 900)] {
        let mut file = fs::File::create(dir.path().join(name)).unwrap();
        let mut encoder = tiff::encoder::TiffEncoder::new(&mut file).unwrap();
        for page in 0..3u16 {
            let pixels: Vec<u16> = (0..48).map(|i| level + (i * 7 + page * 3) % 5).collect();
            encoder.write_image::<tiff::encoder::colortype::Gray16>(8, 6, &pixels).unwrap();
        }
    }
    let said = refused(&["import", &text("a.tif"), &text("b.tif"), "-o", &text("d"), "--yes"]);
    assert!(said.contains("exposure_s of set 0 (dark") && said.contains("--map"), "{said}");
    assert!(!dir.path().join("d").exists());
    let map = fs::read_to_string(text("d.map.toml")).unwrap();
    let filled = map.replace("kind = ", "exposure_s = 0.02\nkind = ");
    fs::write(text("d.map.toml"), filled).unwrap();
    // A map that makes no dataset leaves nothing behind, and what was wrong can be mended and run again.
    for (from, to, part) in [("0.02", "-0.02", "above 0 s"), ("b.tif#2", "c.tif#2", "c.tif")] {
        fs::write(text("wrong.toml"), fs::read_to_string(text("d.map.toml")).unwrap().replace(from, to))
            .unwrap();
        let said = refused(&["import", "--map", &text("wrong.toml"), "-o", &text("d"), "--yes"]);
        assert!(said.contains(part) && !dir.path().join("d").exists(), "{said}");
    }
    expect(0, &["import", "--map", &text("d.map.toml"), "-o", &text("d"), "--yes"]);
    let dataset = Dataset::open(&dir.path().join("d")).unwrap();
    let kinds: Vec<_> = dataset.sets().iter().map(|s| (dataset.settings(s).kind, s.rows.len())).collect();
    assert_eq!(kinds, [(Kind::Dark, 3), (Kind::Flat, 3)]);
    // The pages are three, and not one page three times.
    let frames = dataset.read_set(&dataset.sets()[1]).unwrap();
    assert!(frames[0] != frames[1] && frames[1] != frames[2]);
    assert_eq!(dataset.rows().iter().filter(|r| r.exposure_s == 0.02).count(), 6);
    // A row that names no page of a stack is no frame.
    let csv = fs::read_to_string(text("d/frames.csv")).unwrap();
    fs::write(text("d/frames.csv"), csv.replace("#0", "")).unwrap();
    let said = refused(&["noise", &text("d")]);
    assert!(said.contains("is a stack") && said.contains("#0"), "{said}");
}

/// A FITS file of unsigned words.
pub fn fits(path: &Path, cards: &[&str], image: &Array2<u16>) {
    let (rows, columns) = image.dim();
    let size = [format!("NAXIS1  = {columns}"), format!("NAXIS2  = {rows}")];
    let head = ["SIMPLE  = T", "BITPIX  = 16", "NAXIS   = 2", &size[0], &size[1], "BZERO   = 32768"];
    let mut out: Vec<u8> =
        head.iter().chain(cards).chain(&["END"]).flat_map(|c| format!("{c:<80}").into_bytes()).collect();
    out.resize(out.len().next_multiple_of(2880), b' ');
    out.extend(image.iter().flat_map(|v| (v ^ 0x8000).to_be_bytes()));
    fs::write(path, out).unwrap();
}

/// Exposure, kind and temperature from FITS headers; a bias frame has no exposure.
#[test]
fn fits_headers_say_exposure_and_kind() {
    let dir = tempfile::tempdir().unwrap();
    let text = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    for (k, kind, time, level) in
        [(0, "'Bias Frame'", 0.0, 100), (1, "'Bias Frame'", 0.0, 100), (2, "'Flat Field'", 1.5, 900)]
    {
        let cards = [format!("EXPTIME = {time}"), format!("IMAGETYP= {kind}"), "CCD-TEMP= -10.5".into()];
        let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
        let image = Array2::from_shape_fn((4, 6), |(y, x)| level + (y * 3 + x) as u16);
        fits(&dir.path().join(format!("n{k}.fits")), &cards, &image);
    }
    let inputs: Vec<String> = (0..3).map(|k| text(&format!("n{k}.fits"))).collect();
    let said =
        expect(0, &["import", &inputs[0], &inputs[1], &inputs[2], "-o", &text("d"), "--yes", "--json"]);
    assert!(said.contains("\"bit_depth\": 10"), "{said}");
    let dataset = Dataset::open(&dir.path().join("d")).unwrap();
    let sets: Vec<_> = dataset.sets().iter().map(|s| dataset.settings(s)).collect();
    assert_eq!((sets[0].kind, sets[0].exposure_s), (Kind::Dark, 1e-9));
    assert_eq!((sets[1].kind, sets[1].exposure_s), (Kind::Flat, 1.5));
    assert_eq!(sets[1].temperature_c, Some(-10.5));
}

/// What would make a wrong dataset is refused by name.
#[test]
fn what_makes_no_dataset_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let text = |name: &str| path(name).to_str().unwrap().to_string();
    let write =
        |name: &str, image: &Array2<u16>| fs::write(path(name), tiff_bytes(image, 16).unwrap()).unwrap();
    write("flat_1ms_0.tif", &Array2::from_elem((4, 4), 3001));
    write("flat_1ms_1.tif", &Array2::from_elem((4, 5), 3001));
    let out = text("d");
    let said = refused(&["import", &text("flat_1ms_0.tif"), &text("flat_1ms_1.tif"), "-o", &out, "--yes"]);
    assert!(said.contains("5 x 4 px") && said.contains("one size"), "{said}");
    write("flat_3ms_6dB.tif", &Array2::from_elem((4, 4), 801));
    write("flat_3ms_12dB.tif", &Array2::from_elem((4, 4), 801));
    let said =
        refused(&["import", &text("flat_3ms_6dB.tif"), &text("flat_3ms_12dB.tif"), "-o", &out, "--yes"]);
    assert!(said.contains("one gain"), "{said}");
    // Two lights at one exposure, and nobody says how strong they are.
    for (name, level) in [("dark_5ms_0.tif", 100), ("flat_5ms_a_0.tif", 500), ("flat_5ms_b_0.tif", 901)] {
        write(name, &Array2::from_elem((4, 4), level));
    }
    let names = ["dark_5ms_0.tif", "flat_5ms_a_0.tif", "flat_5ms_b_0.tif"].map(text);
    let said = refused(&["import", &names[0], &names[1], &names[2], "-o", &out, "--yes"]);
    assert!(said.contains("illumination of set 1") && said.contains("the exposure of set 2"), "{said}");
    // Not asked, and nobody there to ask.
    let said = refused(&["import", &text("flat_3ms_6dB.tif"), "-o", &out]);
    assert!(said.contains("--yes"), "{said}");
    fs::write(path("notes.txt"), "x").unwrap();
    let said = refused(&["import", &text("notes.txt"), "-o", &out, "--yes"]);
    assert!(said.contains("notes.txt") && said.contains("begins like none of them"), "{said}");
    fs::create_dir(path("empty")).unwrap();
    assert!(refused(&["import", &text("empty"), "-o", &out, "--yes"]).contains("no image files"));
    assert!(!path("d").exists());
    assert_eq!(read(&path("flat_1ms_0.tif"), 0).unwrap()[[0, 0]], 3001);
}

/// Twelve bits in the upper bits of sixteen are shifted down; a Bayer plane is taken by itself.
#[test]
fn shifted_codes_and_mosaics_are_written_anew() {
    let dir = tempfile::tempdir().unwrap();
    let text = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    for (name, level) in [("dark_2ms_0.tif", 10u16), ("flat_2ms_0.tif", 1000)] {
        // Odd columns of odd rows have four times the signal.
        let of = |y: usize, x: usize| level * if y % 2 == 1 && x % 2 == 1 { 4 } else { 1 } + (y + x) as u16;
        let image = Array2::from_shape_fn((6, 8), |(y, x)| of(y, x) << 4);
        fs::write(text(name), tiff_bytes(&image, 16).unwrap()).unwrap();
    }
    let inputs = [text("dark_2ms_0.tif"), text("flat_2ms_0.tif")];
    let run = |more: &[&str]| {
        crate::support::radcam(&[&["import", &inputs[0], &inputs[1], "--yes"][..], more].concat())
    };
    let said = refused(&["import", &inputs[0], &inputs[1], "--yes", "-o", &text("whole")]);
    assert!(said.contains("raw Bayer") && said.contains("--plane") && said.contains("--pattern"), "{said}");
    let whole = run(&["-o", &text("whole"), "--pattern", "mono"]);
    let out = String::from_utf8_lossy(&whole.stdout);
    assert!(out.contains("shifted down by 4 bits"), "{out}");
    let plane = run(&["-o", &text("plane"), "--plane", "1,1"]);
    assert!(plane.status.success() && !String::from_utf8_lossy(&plane.stderr).contains("Bayer"));
    let dataset = Dataset::open(&dir.path().join("plane")).unwrap();
    let camera = &dataset.manifest().camera;
    assert_eq!((camera.width, camera.height, camera.bit_depth), (4, 3, 12));
    assert_eq!(dataset.read(&dataset.rows()[1]).unwrap()[[1, 2]], 4000 + 3 + 5);
    // Notes for `noise` and `diagnose`.
    let notes = dataset.manifest().import_notes().join("; ");
    assert!(notes.contains("in codes of the dataset, of which one is 16 in the files"), "{notes}");
}

/// A numpy array of frames is a set; times in headers put sets in their order and into the rows.
#[test]
fn numpy_arrays_and_times_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let text = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let dark = ndarray::Array3::from_shape_fn((3, 4, 5), |(f, y, x)| (60 + (f + y + x) % 3) as u16);
    ndarray_npy::write_npy(text("dark_10ms.npy"), &dark).unwrap();
    let flat = ndarray::Array3::from_shape_fn((2, 4, 5), |(f, y, x)| (2060 + (f * 2 + y + x) % 5) as i32);
    ndarray_npy::write_npy(text("flat_10ms.npy"), &flat).unwrap();
    expect(0, &["import", &text("dark_10ms.npy"), &text("flat_10ms.npy"), "-o", &text("d"), "--yes"]);
    let dataset = Dataset::open(&dir.path().join("d")).unwrap();
    let sets: Vec<_> = dataset.sets().iter().map(|s| (dataset.settings(s).kind, s.rows.len())).collect();
    assert_eq!(sets, [(Kind::Dark, 3), (Kind::Flat, 2)]);
    assert_eq!(dataset.read(&dataset.rows()[4]).unwrap()[[1, 1]], flat[[1, 1, 1]] as u16);
    // A header that claims more than there is asks for no memory.
    let mut cut = fs::read(text("flat_10ms.npy")).unwrap();
    let at = cut.windows(9).position(|w| w == b"(2, 4, 5)").unwrap();
    cut[at..at + 9].copy_from_slice(b"(2,4,9e9)"[..9].try_into().unwrap());
    fs::write(text("cut.npy"), &cut).unwrap();
    assert!(refused(&["import", &text("cut.npy"), "-o", &text("e"), "--yes"]).contains("cut.npy"));
    cut[at..at + 9].copy_from_slice(b"(99,4, 5)");
    fs::write(text("cut.npy"), &cut).unwrap();
    assert!(refused(&["import", &text("cut.npy"), "-o", &text("e"), "--yes"]).contains("cut.npy"));
    ndarray_npy::write_npy(text("bad.npy"), &ndarray::array![[0.5, 1.0]]).unwrap();
    assert!(refused(&["import", &text("bad.npy"), "-o", &text("e"), "--yes"]).contains("whole numbers"));

    for (name, kind, time, level) in [
        ("a.fits", "'FLAT'", "'2026-11-22T12:00:09.5'", 900),
        ("b.fits", "'DARK'", "'2026-11-22T12:00:02'", 100),
        ("c.fits", "'DARK'", "'2026-11-22T12:00:01.25'", 100),
    ] {
        let cards = ["EXPTIME = 0.5".into(), format!("IMAGETYP= {kind}"), format!("DATE-OBS= {time}")];
        let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
        let image = Array2::from_shape_fn((4, 6), |(y, x)| level + (y * 3 + x) as u16);
        fits(&dir.path().join(name), &cards, &image);
    }
    let inputs = ["a.fits", "b.fits", "c.fits"].map(text);
    expect(0, &["import", &inputs[0], &inputs[1], &inputs[2], "-o", &text("t"), "--yes"]);
    let dataset = Dataset::open(&dir.path().join("t")).unwrap();
    let rows: Vec<_> = dataset.rows().iter().map(|r| (r.kind, r.timestamp_s.unwrap())).collect();
    assert_eq!(rows, [(Kind::Dark, 0.0), (Kind::Dark, 0.75), (Kind::Flat, 8.25)]);
}

/// Exposures of 5 and 50 in frames that follow one another by 0.2 s are no seconds: asked. Where frames
/// follow one another by more, or a unit is stated, they are, and times at which one set was written tell
/// nothing.
#[test]
fn exposures_longer_than_the_time_between_frames_are_asked() {
    let dir = tempfile::tempdir().unwrap();
    let text = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    for (folder, period_s, last_s) in
        [("short", 0.2, 0.2), ("long", 60.0, 60.0), ("written", 60.0, 0.1), ("stated", 0.2, 0.2)]
    {
        std::fs::create_dir(dir.path().join(folder)).unwrap();
        let unit = if folder == "stated" { " / [s]" } else { "" };
        let mut time_s: f64 = 0.0;
        for (k, (kind, exposure)) in
            [("'DARK'", 5), ("'DARK'", 50), ("'FLAT'", 5), ("'FLAT'", 50)].into_iter().enumerate()
        {
            for i in 0..4 {
                time_s += if k == 3 { last_s } else { period_s };
                let (hours, minutes) = ((time_s / 3600.0) as u32, (time_s / 60.0) as u32 % 60);
                let time = format!("'2026-11-22T{hours:02}:{minutes:02}:{:05.2}'", time_s % 60.0);
                let cards = [
                    format!("EXPTIME = {exposure}{unit}"),
                    format!("IMAGETYP= {kind}"),
                    format!("DATE-OBS= {time}"),
                ];
                let level = if k < 2 { 100 } else { 100 + 20 * exposure };
                let image = Array2::from_shape_fn((4, 6), |(y, x)| level + (y * 3 + x + i) as u16);
                let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
                fits(&dir.path().join(folder).join(format!("{k}_{i}.fits")), &cards, &image);
            }
        }
        let arguments = ["import", &text(folder), "-o", &text(&format!("{folder}_d")), "--yes"];
        if folder == "short" {
            let said = refused(&arguments);
            assert!(
                said.contains("the frames follow one another by") && said.contains("milliseconds"),
                "{said}"
            );
        } else {
            expect(0, &arguments);
        }
    }
}

/// Frames that radcam wrote say of themselves what they are: thrown together without their rows they are the
/// same dataset.
#[test]
fn frames_of_radcam_say_their_settings() {
    let dir = tempfile::tempdir().unwrap();
    let text = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    // A plan in which settings come back: each time is a set of its own.
    expect(0, &["simulate", "cmos12", "--region", "8,4,32,24", "--plan", "standard", "-o", &text("c")]);
    expect(0, &["import", &text("c/frames"), "-o", &text("d"), "--yes"]);
    let [a, b] = ["c", "d"].map(|name| Dataset::open(&dir.path().join(name)).unwrap());
    assert_eq!(a.rows().len(), b.rows().len());
    for (a, b) in a.rows().iter().zip(b.rows()) {
        assert_eq!((a.kind, a.set, a.index), (b.kind, b.set, b.index));
        assert_eq!((a.exposure_s, a.illumination), (b.exposure_s, b.illumination));
        assert!((a.timestamp_s.unwrap() - b.timestamp_s.unwrap()).abs() < 1e-9);
    }
    assert_eq!(b.manifest().camera.features, a.manifest().camera.features);
    assert_eq!((b.manifest().camera.bit_depth, b.manifest().camera.black_level_dn), (12, Some(64.0)));
    assert_eq!(b.manifest().camera.gain_db, Some(0.0));
    assert_eq!(b.manifest().camera.model, "cmos12");
}

/// Two cameras, or two settings that headers tell of, make no dataset; a map that the files do not bear out
/// neither.
#[test]
fn one_dataset_is_of_one_camera() {
    let dir = tempfile::tempdir().unwrap();
    let text = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let image = Array2::from_shape_fn((4, 6), |(y, x)| 900 + (y * 3 + x) as u16);
    for (name, gain, camera) in [("a.fits", 100, "'ASI'"), ("b.fits", 300, "'ASI'"), ("c.fits", 100, "'QHY'")]
    {
        let cards = ["EXPTIME = 0.5".into(), format!("GAIN    = {gain}"), format!("INSTRUME= {camera}")];
        let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
        fits(&dir.path().join(name), &cards, &image);
    }
    for (other, part) in [("b.fits", "GAIN 300"), ("c.fits", "model QHY")] {
        let said = refused(&["import", &text("a.fits"), &text(other), "-o", &text("d"), "--yes"]);
        assert!(said.contains(part) && said.contains("each by itself"), "{said}");
    }
    let map = |lines: &str| {
        let set = format!("[[set]]\nkind = \"flat\"\nfiles = [\"{}\"]\n{lines}", text("a.fits"));
        fs::write(text("m.toml"), format!("format = \"radcam-import/1\"\nbit_depth = 8\n{set}")).unwrap();
        refused(&["import", "--map", &text("m.toml"), "-o", &text("d")])
    };
    assert!(map("exposure_s = 0.5\n").contains("more than bit_depth = 8"));
    assert!(map("exposure_s = -1.0\n").contains("set 0: exposure_s is -1"));
    assert!(map("exposure_s = 1.0\nillumination = nan\n").contains("illumination is NaN"));
    assert!(!dir.path().join("d").exists());
}
