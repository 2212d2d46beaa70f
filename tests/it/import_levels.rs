//! Levels and files that contradict names: questions at import.

use crate::import_cases::{Bench, Camera, sets};
use radcam::dataset::Kind;

/// Four frames of each set: name without counter, light in electrons, exposure.
fn campaign(bench: &Bench, folder: &str, sets: &[(&str, f64, f64)]) {
    let mut camera = Camera::new(90);
    for (name, light_e, exposure_s) in sets {
        for i in 0..4 {
            bench.tiff(&format!("{folder}/{name}_{i:03}.tif"), &camera.frame(*light_e, *exposure_s));
        }
    }
}

/// Shutter speeds with an underline for the slash: the longer, the darker.
#[test]
fn exposures_that_darken_are_asked() {
    let bench = Bench::new();
    let of = |n: u32| (f64::from(400_000 / n), 1.0 / f64::from(n));
    let flats = [80, 160, 320, 640, 1280].map(|n| (format!("flat_1_{n}s"), of(n)));
    let darks = [80, 1280].map(|n| (format!("dark_1_{n}s"), (0.0, of(n).1)));
    let all: Vec<(&str, f64, f64)> = darks.iter().chain(&flats).map(|(n, (e, s))| (&**n, *e, *s)).collect();
    campaign(&bench, "slash", &all);
    let said = bench.refused("slash");
    assert!(said.contains("exposure of set 6") && said.contains("the longer, the darker"), "{said}");
    // Each set is asked; exposures of which only one was corrected are refused again.
    let path = bench.text("to0.map.toml");
    let map = std::fs::read_to_string(&path).unwrap();
    assert_eq!(map.matches("doubts = ").count(), 7, "{map}");
    let settled: String =
        map.lines().filter(|l| !l.starts_with("doubts")).fold(String::new(), |s, l| s + l + "\n");
    let to = bench.text("settled");
    std::fs::write(&path, settled.replacen("exposure_s = 1280.0\n", "exposure_s = 0.00078125\n", 2)).unwrap();
    let said = crate::support::refused(&["import", "--map", &path, "-o", &to]);
    assert!(said.contains("the longer, the darker"), "{said}");
    let of = |n: u32| (format!("exposure_s = {n}.0\n"), format!("exposure_s = {}\n", 1.0 / f64::from(n)));
    let whole =
        [80, 160, 320, 640, 1280].map(of).iter().fold(settled, |map, (old, new)| map.replace(old, new));
    std::fs::write(&path, whole).unwrap();
    crate::support::expect(0, &["import", "--map", &path, "-o", &to]);
    // Counters in front of exposures: no question.
    campaign(
        &bench,
        "counted",
        &[("dark_1_1s", 0.0, 1.0), ("flat_1_1s", 800.0, 1.0), ("flat_1_2s", 1600.0, 2.0)],
    );
    assert_eq!(sets(&bench.import("counted", &[]).0).len(), 3);
}

/// Darks whose names have another unit than those of the flats.
#[test]
fn darks_in_another_unit_are_asked() {
    let bench = Bench::new();
    let flats = [("flat_2ms", 400.0, 0.002), ("flat_5ms", 1000.0, 0.005), ("flat_10ms", 2000.0, 0.01)];
    for (folder, darks) in [("s", ["dark_2s", "dark_10s"]), ("us", ["dark_2us", "dark_10us"])] {
        let all: Vec<_> = darks.into_iter().map(|d| (d, 0.0, 0.002)).chain(flats).collect();
        campaign(&bench, folder, &all);
        let said = bench.refused(folder);
        assert!(said.contains("in the one and") && said.contains("0.002 s"), "{said}");
    }
    // Darks whose level rises are as long as they say.
    let long = [("dark_2s", 0.0, 2.0), ("dark_10s", 800.0, 0.01)];
    campaign(&bench, "rising", &long.into_iter().chain(flats).collect::<Vec<_>>());
    assert_eq!(sets(&bench.import("rising", &[]).0).len(), 5);
    // Long darks of exposures of their own are those of a dark current.
    let darks = [("dark_2ms", 0.0, 0.002), ("dark_2s", 0.0, 2.0), ("dark_10s", 0.0, 10.0)];
    campaign(&bench, "long", &darks.into_iter().chain(flats).collect::<Vec<_>>());
    assert_eq!(sets(&bench.import("long", &[]).0).len(), 6);
}

/// Two thousand microseconds, or two.
#[test]
fn thousandths_of_microseconds_are_asked() {
    let bench = Bench::new();
    campaign(&bench, "us", &[("dark 2.000 us", 0.0, 0.002), ("flat 2.000 us", 1600.0, 0.002)]);
    assert!(bench.refused("us").contains("is 2 or 2000 us"));
    campaign(&bench, "ms", &[("dark 2.000 ms", 0.0, 0.002), ("flat 2.000 ms", 1600.0, 0.002)]);
    assert_eq!(sets(&bench.import("ms", &[]).0)[0].1, 0.002);
}

/// Flats in folders of their exposures, and no darks: the dimmest is none.
#[test]
fn the_dimmest_flat_is_no_dark() {
    let bench = Bench::new();
    let flats = [1.0, 2.0, 4.0, 8.0].map(|ms| (format!("{ms}ms/img"), 300.0 * ms, ms / 1e3));
    let all = flats.each_ref().map(|(n, e, s)| (&**n, *e, *s));
    campaign(&bench, "sweep", &all);
    let said = bench.refused("sweep");
    assert!(said.contains("kind of set 0") && said.contains("there are no darks"), "{said}");
    // A real dark is off that line, and is taken by its mean as before.
    campaign(&bench, "both", &all);
    campaign(&bench, "both", &[("cap/8ms/img", 0.0, 0.008)]);
    let kinds: Vec<Kind> = sets(&bench.import("both", &[]).0).into_iter().map(|s| s.0).collect();
    assert_eq!(kinds.iter().filter(|k| **k == Kind::Dark).count(), 1);
}

/// Files of 8 bits among those of 16.
#[test]
fn files_of_fewer_bits_are_asked() {
    let bench = Bench::new();
    campaign(&bench, "mixed", &[("dark_2ms", 0.0, 0.002), ("flat_4ms", 3200.0, 0.004)]);
    let mut camera = Camera::new(91);
    for i in 0..4 {
        let frame = camera.frame(1600.0, 0.002).mapv(|v| v / 16);
        let bytes = radcam::dataset::image::tiff_bytes(&frame, 8).unwrap();
        std::fs::write(bench.path(&format!("mixed/flat_2ms_{i:03}.tif")), bytes).unwrap();
    }
    let said = bench.refused("mixed");
    assert!(
        said.contains("frames of set 1") && said.contains("has 8 bits, and other files have 16"),
        "{said}"
    );
}

/// Serial numbers in pylon's names differ between darks and flats; days and counters do not.
#[test]
fn serial_numbers_in_names_are_compared() {
    let bench = Bench::new();
    let named = |dark: &str, flat: &str| {
        [
            (format!("acA1920_{dark}_dark_2ms"), 0.0, 0.002),
            (format!("acA1920_{dark}_dark_4ms"), 0.0, 0.004),
            (format!("acA1920_{flat}_flat_2ms"), 1600.0, 0.002),
            (format!("acA1920_{flat}_flat_4ms"), 3200.0, 0.004),
        ]
    };
    for (folder, dark, flat, asked) in [
        ("serials", "21112223", "29998887", true),
        ("one", "21112223", "21112223", false),
        ("days", "20240501", "20240502", false),
    ] {
        campaign(&bench, folder, &named(dark, flat).each_ref().map(|(n, e, s)| (&**n, *e, *s)));
        if asked {
            assert!(bench.refused(folder).contains("frames of several cameras?"));
        } else {
            assert_eq!(sets(&bench.import(folder, &[]).0).len(), 4, "{folder}");
        }
    }
}

/// A counter that the camera writes over the first pixels makes no frames of 16 bits.
#[test]
fn counters_in_the_first_row_make_no_depth() {
    let bench = Bench::new();
    let mut camera = Camera::new(92);
    for (name, light_e) in [("dark_2ms", 0.0), ("flat_2ms", 6000.0)] {
        for i in 0..4u16 {
            let mut frame = camera.frame(light_e, 0.002);
            frame[(0, 0)] = 40_000 + i;
            bench.tiff(&format!("stamped/{name}_{i:03}.tif"), &frame);
        }
    }
    assert!(
        bench.refused("stamped").contains("codes of more than 12 bits stand in the first or last row only")
    );
    assert_eq!(bench.import("stamped", &["--bit-depth", "16"]).0.manifest().camera.bit_depth, 16);
}

/// Frames of one row and of two, as line-scan cameras send them: no row lies between the first and the last.
#[test]
fn frames_of_one_row_are_read() {
    let bench = Bench::new();
    let mut camera = Camera::new(93);
    for rows in [1, 2] {
        let folder = format!("rows{rows}");
        for (name, light_e) in [("dark_2ms", 0.0), ("flat_2ms", 1600.0)] {
            for i in 0..2 {
                let frame = camera.frame(light_e, 0.002);
                bench.tiff(
                    &format!("{folder}/{name}_{i}.tif"),
                    &frame.slice(radcam::ndarray::s![..rows, ..]).to_owned(),
                );
            }
        }
        assert_eq!(bench.import(&folder, &[]).0.manifest().camera.height, rows);
    }
}

/// Positions of card and light in names are configurations, and no counters.
#[test]
fn configurations_in_names_are_read() {
    let bench = Bench::new();
    let flats = [1, 2, 3].map(|k| (format!("config{k}/flat_2ms"), 1600.0, 0.002));
    campaign(&bench, "k", &[("dark_2ms", 0.0, 0.002)]);
    campaign(&bench, "k", &flats.each_ref().map(|(n, e, s)| (&**n, *e, *s)));
    campaign(&bench, "k", &[("flat_2ms_conf4", 1600.0, 0.002)]);
    let dataset = bench.import("k", &[]).0;
    let mut found: Vec<(Kind, u32)> = dataset
        .sets()
        .iter()
        .map(|s| (dataset.settings(s).kind, dataset.settings(s).configuration))
        .collect();
    found.sort_by_key(|f| f.1);
    assert_eq!(found[0], (Kind::Dark, 0));
    assert_eq!(found[1..].iter().map(|f| f.1).collect::<Vec<_>>(), [1, 2, 3, 4]);
}

/// Frames of the sky or of a lamp's spectrum, stated as such beside darks and flats, are neither: they are
/// left out and said. Where nothing else is called flat they are the flats.
#[test]
fn light_frames_beside_flats_are_left_out() {
    let bench = Bench::new();
    let mut camera = Camera::new(93);
    for (name, kind, light_e, exposure_s) in
        [("d", "DARK", 0.0, 0.01), ("f", "FLAT", 2000.0, 0.01), ("m31", "LIGHT", 40.0, 120.0)]
    {
        for k in 0..3 {
            let cards = [format!("IMAGETYP= '{kind}'"), format!("EXPTIME = {exposure_s}")];
            bench.fits(
                &format!("night/{name}{k}.fits"),
                &cards.each_ref().map(|c| &**c),
                &camera.frame(light_e, exposure_s),
            );
        }
    }
    let (dataset, said) = bench.import("night", &[]);
    assert_eq!(sets(&dataset), [(Kind::Dark, 0.01, 3), (Kind::Flat, 0.01, 3)]);
    assert!(said.contains("3 frames are stated as light frames or snapshots"), "{said}");
    campaign(&bench, "own", &[("dark_10ms", 0.0, 0.01), ("light_10ms", 2000.0, 0.01)]);
    let kinds: Vec<Kind> = sets(&bench.import("own", &[]).0).into_iter().map(|s| s.0).collect();
    assert_eq!(kinds, [Kind::Dark, Kind::Flat]);
}

/// Averages are told by words of names and of folders; a range of exposures is none.
#[test]
fn averages_in_names_and_folders_are_asked() {
    let bench = Bench::new();
    for name in ["mean/flat_10ms_mean", "16x averaging/flat_10ms", "sums/flat_10ms_sum4", "stacked/flat_10ms"]
    {
        let folder = name.split('/').next().unwrap();
        campaign(&bench, folder, &[(name.split_once('/').unwrap().1, 2000.0, 0.01)]);
        let said = bench.refused(folder);
        assert!(said.contains("averages and corrected frames are no raw frames"), "{name}: {said}");
    }
    campaign(&bench, "range", &[("flat_2-20ms", 2000.0, 0.01)]);
    assert!(bench.refused("range").contains("is 2 or 20 ms"));
}

/// Codes in the upper bits of some files and not of the others; an array whose last axis may count the
/// frames.
#[test]
fn shifted_codes_and_narrow_arrays_are_asked() {
    let bench = Bench::new();
    let mut camera = Camera::new(94);
    for k in 0..3 {
        bench.tiff(&format!("msb/dark_2ms_{k}.tif"), &camera.frame(0.0, 0.002));
        bench.tiff(&format!("msb/flat_2ms_{k}.tif"), &camera.frame(1600.0, 0.002).mapv(|v| v * 16));
    }
    let said = bench.refused("msb");
    assert!(said.contains("frames of set 1") && said.contains("is a multiple of 16"), "{said}");
    let header = "{'descr': '<u2', 'fortran_order': False, 'shape': (24, 32, 8), }\n";
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend((0..24 * 32 * 8u16).flat_map(|k| (100 + k.wrapping_mul(40503) % 7).to_le_bytes()));
    std::fs::create_dir(bench.path("npy")).ok();
    std::fs::write(bench.path("npy/flat_2ms.npy"), bytes).unwrap();
    assert!(bench.refused("npy").contains("--frames-axis 2 (or 0)"));
}

/// Light that names state in words of their own (lamp current, filter, per cent), flats without light, and
/// darks with light: each is asked where more than one set says so; one alone is left to the look at the
/// data.
#[test]
fn light_that_no_name_states_is_asked() {
    let bench = Bench::new();
    let dark = |ms: f64| (format!("dark_{ms}ms"), 0.0, ms / 1e3);
    let flat = |word: &str, ms: f64, light_e: f64| (format!("{word}_{ms}ms"), light_e, ms / 1e3);
    let put = |folder: &str, sets: &[(String, f64, f64)]| {
        let sets: Vec<(&str, f64, f64)> = sets.iter().map(|(n, e, s)| (&**n, *e, *s)).collect();
        campaign(&bench, folder, &sets);
    };
    let bright = [1.0, 2.0, 4.0].map(|ms| flat("flat_500mA", ms, 600.0 * ms));
    let dim = [8.0, 16.0].map(|ms| flat("flat_50mA", ms, 60.0 * ms));
    put("lamp", &[&bright[..], &dim[..], &[dark(1.0), dark(16.0)]].concat());
    let said = bench.refused("lamp");
    assert!(said.contains("illumination of set") && said.contains("the light was not the same"), "{said}");
    let lit = [1.0, 2.0, 4.0, 8.0].map(|ms| flat("flat", ms, 300.0 * ms));
    let unlit = [3.0, 12.0].map(|ms| flat("flat_b", ms, 0.0));
    put("unlit", &[&lit[..], &unlit[..], &[dark(1.0), dark(8.0)]].concat());
    let said = bench.refused("unlit");
    assert!(said.contains("kind of set") && said.contains("no light fell on them"), "{said}");
    let cards = [2.0, 4.0, 8.0].map(|ms| flat("black_card", ms, 300.0 * ms));
    put("cards", &[&cards[..], &[dark(2.0), dark(16.0)]].concat());
    let said = bench.refused("cards");
    assert!(said.contains("are called darks, and light fell on them"), "{said}");
    // One set whose exposure is another than its name says.
    put("slip", &[&lit[..], &[flat("flat", 16.0, 300.0), dark(1.0), dark(16.0)]].concat());
    assert_eq!(sets(&bench.import("slip", &[]).0).len(), 7);
}

/// A point that names cannot have is an underline, a hyphen, or nothing at all: asked, since it may count
/// too.
#[test]
fn decimals_without_a_point_are_asked() {
    let bench = Bench::new();
    campaign(
        &bench,
        "us",
        &[("dark_0_2ms", 0.0, 2e-4), ("flat_0_2ms", 900.0, 2e-4), ("flat_0_4ms", 1800.0, 4e-4)],
    );
    assert!(bench.refused("us").contains("is 2 or 0.2 ms"));
    campaign(&bench, "s", &[("dark_0_05s", 0.0, 0.05), ("flat_0_05s", 900.0, 0.05)]);
    assert!(bench.refused("s").contains("is 5 or 0.05 s"));
    // A whole part may count as well: levels tell.
    let decimals =
        [("flat_1_2ms", 360.0, 1.2e-3), ("flat_2_4ms", 720.0, 2.4e-3), ("flat_12_7ms", 3810.0, 12.7e-3)];
    let dark = [("dark_1_5ms", 0.0, 1.5e-3), ("dark_18_9ms", 0.0, 18.9e-3)];
    campaign(&bench, "whole", &[&dark[..], &decimals[..]].concat());
    let said = bench.refused("whole");
    assert!(said.contains("1_2 was read as 0.002 s") && said.contains("0.0012 s"), "{said}");
    // Others have one number.
    let mixed = [("flat_2_5ms", 750.0, 2.5e-3), ("flat_5ms", 1500.0, 5e-3), ("flat_10ms", 3000.0, 1e-2)];
    campaign(&bench, "mixed", &[&[("dark_5ms", 0.0, 5e-3)][..], &mixed[..]].concat());
    let said = bench.refused("mixed");
    assert!(said.contains("2_5 was read as 0.005 s") && said.contains("0.0025 s"), "{said}");
    let counted = [("flat_1_2ms", 600.0, 2e-3), ("flat_2_4ms", 1200.0, 4e-3), ("flat_3_8ms", 2400.0, 8e-3)];
    campaign(
        &bench,
        "counters",
        &[&[("dark_1_2ms", 0.0, 2e-3), ("dark_2_8ms", 0.0, 8e-3)][..], &counted[..]].concat(),
    );
    assert_eq!(sets(&bench.import("counters", &[]).0).len(), 5);
}
