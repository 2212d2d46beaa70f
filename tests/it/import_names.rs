//! Names of files and folders as programs and people write them: kind, settings, time stamps, copies,
//! leftovers.

use crate::import_cases::{Bench, Camera, sets};
use crate::support::{expect, program, radcam};
use radcam::dataset::{Dataset, Kind};
use std::fs;

/// A campaign of two darks and three flats, `frames` frames a set; the name of each from kind, exposure (ms),
/// the number of the frame in its set, and that in the campaign.
fn campaign(bench: &Bench, folder: &str, frames: usize, name: &dyn Fn(&str, f64, usize, usize) -> String) {
    let mut camera = Camera::new(30);
    let mut all = 0;
    for (kind, ms, light) in [
        ("Dark", 10.0, 0.0),
        ("Dark", 400.0, 0.0),
        ("Flat", 10.0, 1200.0),
        ("Flat", 20.0, 2400.0),
        ("Flat", 30.0, 3600.0),
    ] {
        for k in 0..frames {
            let path = format!("{folder}/{}", name(kind, ms, k, all));
            bench.tiff(&path, &camera.frame(light, ms / 1e3));
            all += 1;
        }
    }
}

fn right(frames: usize) -> Vec<(Kind, f64, usize)> {
    [(Kind::Dark, 0.01), (Kind::Dark, 0.4), (Kind::Flat, 0.01), (Kind::Flat, 0.02), (Kind::Flat, 0.03)]
        .map(|(kind, s)| (kind, s, frames))
        .into()
}

/// Hours, minutes and seconds of a frame every three seconds.
fn time(n: usize) -> (usize, usize, usize) {
    let s = 3 * n + 3;
    (21 + s / 3600, s / 60 % 60, s % 60)
}

fn dashes(n: usize) -> String {
    let (h, m, s) = time(n);
    format!("{h:02}-{m:02}-{s:02}")
}

fn digits(n: usize) -> String {
    dashes(n).replace('-', "")
}

fn s(ms: f64) -> f64 {
    ms / 1e3
}

type Name = dyn Fn(&str, f64, usize, usize) -> String;

/// Time stamps and counters of every frame part no sets: names as the programs write them.
#[test]
fn time_stamps_in_names_part_no_sets() {
    let bench = Bench::new();
    let ways: [(&str, &Name); 23] = [
        ("nina", &|k, ms, _, n| {
            format!(
                "2024-05-01_{}_{}_-{:.2}_{:.2}s_{n:04}.tif",
                dashes(n),
                k.to_uppercase(),
                10.0 - (n % 3) as f64 * 0.1,
                s(ms)
            )
        }),
        ("nina folders", &|k, ms, i, n| {
            format!(
                "2024-05-01/{}/2024-05-01_{}_L_-10.00_{:.2}s_{i:04}.tif",
                k.to_uppercase(),
                dashes(n),
                s(ms)
            )
        }),
        ("nina own", &|k, ms, _, n| {
            format!(
                "{}_Sec{:.2}_Gain100_HFR{:.2}_SensorTemp-10.{}0_Num{n:04}.tif",
                k.to_uppercase(),
                s(ms),
                2.0 + n as f64 / 50.0,
                n % 3
            )
        }),
        ("pylon", &|k, ms, _, n| {
            format!(
                "{k}_{ms}ms_acA1920-40um__22123456__20240501_{}{:03}_{n:04}.tiff",
                digits(n),
                n * 7 % 1000
            )
        }),
        ("sharpcap", &|k, ms, _, n| format!("{k}_{ms}ms/Capture {}.tif", dashes(n).replace('-', "_"))),
        ("sharpcap numbers", &|k, ms, i, n| {
            format!("{k}_{ms}ms/Capture_{i:05} {}.tif", dashes(n).replace('-', "_"))
        }),
        ("asiair", &|k, ms, i, n| {
            format!(
                "{k}_{ms:.1}ms_Bin1_gain0_20230505-{}_-{:.1}C_{i:04}.tif",
                digits(n),
                10.0 - (n % 2) as f64 * 0.1
            )
        }),
        ("micro-manager", &|k, ms, i, _| {
            format!("{k}_{ms}ms/img_channel000_position000_time{i:09}_z000.tif")
        }),
        ("micro-manager 1.4", &|k, ms, i, _| format!("{k}_{ms}ms/img_{i:09}_Default_000.tif")),
        ("imagej", &|k, ms, i, _| format!("{k} {ms} ms/{k}{i:04}.tif")),
        ("spinview", &|k, ms, i, n| format!("{k}_{ms}ms_22123456-2024-05-01-{}-{i}.tif", digits(n))),
        ("flycapture", &|k, ms, i, n| format!("{k}_{ms}ms/fc2_save_2024-05-01-{}-{i:04}.tif", digits(n))),
        ("vimba", &|k, ms, i, _| format!("{k}/{ms}ms/VimbaImage_{i}.tif")),
        ("sgp", &|k, ms, i, _| format!("M31_{k}_{}sec_1x1_frame{}.tif", s(ms), i + 1)),
        ("apt", &|k, ms, i, n| {
            format!("{}_{n:04}_2024-05-01_{}_Bin1x1_{}s__-10C_{i}.tif", &k[..1], dashes(n), s(ms))
        }),
        ("siril", &|k, ms, i, _| {
            format!("{}_{ms}ms/{}_{:05}.tif", k.to_lowercase(), k.to_lowercase(), i + 1)
        }),
        ("ekos", &|k, ms, i, n| format!("{k}_L_{}_secs_2024-05-01T{}_{:03}.tif", s(ms), dashes(n), i + 1)),
        ("one run", &|k, ms, _, n| format!("{k}_{ms}ms/20240501{}{:03}.tif", digits(n), n * 7 % 1000)),
        ("half day", &|k, ms, _, n| {
            let (h, m, s) = time(n + 1195);
            format!("{k}_{ms}ms/Snap {}-{m:02}-{s:02} PM.tif", h - 12)
        }),
        ("seconds since 1970", &|k, ms, _, n| format!("{k}/{ms}ms/{}.{:06}.tif", 1_714_597_203 + n, n * 777)),
        ("random", &|k, ms, _, n| {
            format!("{k}_{ms}ms/{:08x}8c.tif", (n as u64 + 3) * 0x0123_4567 % 0xffff_fff1)
        }),
        ("folders", &|k, ms, _, n| format!("{k}_{ms}ms/{}/Capture_00001.tif", dashes(n).replace('-', "_"))),
        ("letters", &|k, ms, _, n| {
            let (h, m, s) = time(n);
            format!("{k}_{ms}ms_{h:02}h{m:02}m{s:02}s.tif")
        }),
    ];
    for (name, of) in ways {
        // Long enough to pass from one minute to the next within a set.
        campaign(&bench, name, 5, of);
        assert_eq!(sets(&bench.import(name, &[]).0), right(5), "{name}");
    }
    // Counters of sets and levels still part them.
    let mut camera = Camera::new(31);
    for (set, light) in [(1, 1000.0), (2, 1500.0)] {
        for k in 0..2 {
            bench.tiff(&format!("levels/flat_10ms_light0.{set}_{k}.tif"), &camera.frame(light, 0.01));
            bench.tiff(&format!("sweep/flat_10ms_lamp{set}_{k}.tif"), &camera.frame(light, 0.01));
        }
        bench.tiff(&format!("single/flat_10ms_lamp{set}_x.tif"), &camera.frame(light, 0.01));
    }
    assert_eq!(sets(&bench.import("levels", &[]).0).len(), 2);
    assert!(bench.refused("sweep").contains("illumination of set 0"));
    for k in 0..4 {
        bench.tiff(&format!("ramp/flat_10ms_{k}.tif"), &camera.frame(1000.0 * (k + 1) as f64, 0.01));
    }
    bench.tiff("ramp/dark_10ms_0.tif", &camera.frame(0.0, 0.01));
    assert!(bench.import("ramp", &[]).1.contains("frames of one set have several levels"));
    // The cap was left on: levels next to the darks are one.
    for k in 0..4 {
        bench.tiff(&format!("capped/dark_10ms_{k}.tif"), &camera.frame(0.0, 0.01));
        bench.tiff(&format!("capped/flat_10ms_{k}.tif"), &camera.frame(0.0, 0.01));
        bench.tiff(&format!("capped/flat_20ms_{k}.tif"), &camera.frame(2000.0, 0.02));
    }
    assert!(!bench.import("capped", &[]).1.contains("several levels"));
}

/// The kind stands in any folder above, and flat darks are darks.
#[test]
fn kinds_of_folders_and_flat_darks() {
    let bench = Bench::new();
    let ways: [(&str, &Name); 14] = [
        ("two up", &|k, ms, i, _| format!("{}/{ms}ms/img_{i}.tif", k.to_lowercase())),
        ("three up", &|k, ms, i, _| format!("{k}s/led 530 nm/{ms}ms/img_{i}.tif")),
        ("exposure first", &|k, ms, i, _| format!("{ms}ms/{k}/img_{i}.tif")),
        ("numbered", &|k, ms, i, _| format!("01_{k}/run2/{ms}ms_{i}.tif")),
        ("camel", &|k, ms, i, _| format!("my{k}Frames/exp{ms}ms/img_{i}.tif")),
        ("units", &|k, ms, i, _| format!("{k}s/{}us/{i}.tif", ms * 1e3)),
        ("flat darks", &|k, ms, i, _| match k {
            "Dark" if ms < 100.0 => format!("Flat Darks/{ms}ms_{i}.tif"),
            _ => format!("{k}s/{ms}ms_{i}.tif"),
        }),
        ("black level", &|k, ms, i, _| format!("{k}_BlackLevel64_{ms}ms_{i}.tif")),
        ("room", &|k, ms, i, _| format!("dark room 2/{k}/{ms}ms_{i}.tif")),
        ("off", &|k, ms, i, _| format!("{k}_DarkCorrectionOff_{ms}ms_{i}.tif")),
        ("letters", &|k, ms, i, _| format!("{k}_{ms}ms_{}.tif", ["A", "B"][i])),
        ("ordinals", &|k, ms, i, _| format!("{}/{k}_{ms}ms.tif", ["first", "second"][i])),
        ("filters", &|k, ms, _, n| format!("{ms}ms/{k}-{n:03}L.tif")),
        ("in one word", &|k, ms, i, _| match k {
            "Dark" if ms < 100.0 => format!("DarkFlat_{ms}ms_{i}.tif"),
            "Dark" => format!("flat_dark_{ms}ms_{i}.tif"),
            _ => format!("flat_{ms}ms_{i}.tif"),
        }),
    ];
    for (name, of) in ways {
        campaign(&bench, name, 2, of);
        let dataset = bench.import(name, &[]).0;
        assert_eq!(sets(&dataset), right(2), "{name}");
        // A frame every three seconds, by names with a date and the time to the second.
        if ["nina", "nina folders", "pylon"].contains(&name) {
            let times: Vec<f64> =
                dataset.rows().iter().filter_map(|r| r.timestamp_s).map(f64::round).collect();
            assert_eq!(times, (0..10).map(|n| 3.0 * f64::from(n)).collect::<Vec<_>>(), "{name}");
        }
    }
    // One folder alone, files named one by one, and paths from within the folder.
    let (dataset, said) = bench.import("two up/flat", &[]);
    assert!(dataset.rows().iter().all(|r| r.kind == Kind::Flat) && !said.contains("guess"), "{said}");
    assert_eq!(sets(&bench.import("two up/flat/10ms", &["--explain"]).0), [(Kind::Flat, 0.01, 2)]);
    let root = bench.path("two up");
    let out = program()
        .current_dir(&root)
        .args([
            "import",
            "flat/10ms/img_0.tif",
            "flat/10ms/img_1.tif",
            "dark/10ms",
            "-o",
            "../within",
            "--yes",
        ])
        .output()
        .unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    assert_eq!(
        sets(&Dataset::open(&bench.path("within")).unwrap()),
        [(Kind::Dark, 0.01, 2), (Kind::Flat, 0.01, 2)]
    );
    // The name of a project is no kind: nothing tells it but the means, and that is said.
    campaign(&bench, "dark_current_study", 2, &|k, ms, i, _| format!("{}/{ms}ms_{i}.tif", &k[..1]));
    let (dataset, said) = bench.import("dark_current_study", &[]);
    assert!(sets(&dataset).len() == 5 && said.contains("kind of sets 0 to 4: by the mean"), "{said}");
    // The numbers of the camera, as `noise` finds them.
    campaign(&bench, "noise", 8, &|k, ms, i, _| format!("{}/{ms}ms/img_{i}.tif", k.to_lowercase()));
    let (dataset, _) = bench.import("noise", &[]);
    let json = expect(0, &["noise", dataset.root().to_str().unwrap(), "--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let (gain, zero) =
        (json["gain_dn_per_e"]["value"].as_f64().unwrap(), json["offset_dn"]["value"].as_f64().unwrap());
    assert!((gain - 0.5).abs() < 0.02 && (zero - 101.0).abs() < 0.2, "{gain} {zero}");
    // Headers say it as well.
    let mut camera = Camera::new(42);
    for (name, card, light) in [
        ("a", "IMAGETYP= 'Flat Dark'", 0.0),
        ("b", "IMAGETYP= 'DARKFLAT'", 0.0),
        ("c", "FRAME   = 'Flat'", 2000.0),
    ] {
        for k in 0..2 {
            bench.fits(
                &format!("cards/{name}{k}.fits"),
                &["EXPTIME = 0.021", card],
                &camera.frame(light, 0.021),
            );
        }
    }
    let kinds: Vec<Kind> = sets(&bench.import("cards", &[]).0).iter().map(|s| s.0).collect();
    assert_eq!(kinds, [Kind::Dark, Kind::Dark, Kind::Flat]);
}

/// Gain, ISO, binning, black level and temperature of names are settings as those of headers are.
#[test]
fn settings_in_names_are_compared() {
    let bench = Bench::new();
    let ways: [(&str, &Name, &str); 15] = [
        (
            "a letter",
            &|k, ms, i, _| format!("{k}_g{}_{ms}ms_{i}.tif", if k == "Dark" { 0 } else { 120 }),
            "gain 120",
        ),
        (
            "letters",
            &|k, ms, i, _| format!("cam{}_{k}_{ms}ms_{i}.tif", if k == "Dark" { 'A' } else { 'B' }),
            "camera B",
        ),
        (
            "gains",
            &|k, ms, i, _| format!("{}gain_{k}_{ms}ms_{i}.tif", if k == "Dark" { "low" } else { "high" }),
            "gain step low",
        ),
        (
            "serials",
            &|k, ms, i, _| format!("SN{}_{k}_{ms}ms_{i}.tif", if k == "Dark" { 1001 } else { 1002 }),
            "serial number 1002",
        ),
        (
            "depths",
            &|k, ms, i, _| format!("{k}_{}bit_{ms}ms_{i}.tif", if k == "Dark" { 14 } else { 12 }),
            "bit depth 12",
        ),
        (
            "conversion gains",
            &|k, ms, i, _| format!("{k}_{}_{ms}ms_{i}.tif", if k == "Dark" { "LCG" } else { "HCG" }),
            "ConversionGain HCG",
        ),
        ("cameras", &|k, ms, i, _| format!("cam{}_{k}_{ms}ms_{i}.tif", i % 2 + 1), "camera 2"),
        (
            "asiair",
            &|k, ms, i, n| {
                format!(
                    "{k}_{ms:.1}ms_Bin1_gain{}_20230505-2102{n:02}_-10.0C_{i:04}.tif",
                    if k == "Dark" { 0 } else { 120 }
                )
            },
            "gain 120",
        ),
        (
            "iso",
            &|k, ms, i, _| {
                format!("{k}_ISO{}_{ms}ms_{i}.tif", if ms > 15.0 && k == "Flat" { 200 } else { 100 })
            },
            "ISO 200",
        ),
        (
            "bin",
            &|k, ms, i, _| format!("{k}_{ms}ms_bin{}_{i}.tif", if k == "Dark" { 1 } else { 2 }),
            "binning 2",
        ),
        (
            "sgp",
            &|k, ms, i, _| {
                format!("{k}_{}sec_{}_frame{i}.tif", ms / 1e3, if k == "Dark" { "1x1" } else { "2x2" })
            },
            "binning 2",
        ),
        (
            "offset",
            &|k, ms, i, _| format!("{k}_{ms}ms_offset{}_{i}.tif", if k == "Dark" { 10 } else { 50 }),
            "black level 50",
        ),
        (
            "folder",
            &|k, ms, i, _| format!("gain{}/{k}_{ms}ms_{i}.tif", if k == "Dark" { 0 } else { 200 }),
            "gain 200",
        ),
        (
            "db",
            &|k, ms, i, _| format!("{k}_{ms}ms_{}dB_{i}.tif", if k == "Dark" { 0 } else { 6 }),
            "one gain",
        ),
        (
            "spaced",
            &|k, ms, i, _| format!("{k} {ms} ms gain={} {i}.tif", if k == "Dark" { 1 } else { 2 }),
            "gain 2",
        ),
    ];
    for (name, of, part) in ways {
        campaign(&bench, name, 2, of);
        let said = bench.refused(name);
        assert!(said.contains(part) && said.contains("import each by itself"), "{name}: {said}");
    }
    campaign(&bench, "alike", 2, &|k, ms, i, n| {
        format!("{k}_{ms}ms_Bin2_gain120_offset30_{}C_{i}.tif", if n < 4 { "-10.0" } else { "20.0" })
    });
    let (dataset, said) = bench.import("alike", &[]);
    assert_eq!(sets(&dataset), right(2));
    let features = &dataset.manifest().camera.features;
    let value = |name: &str| features[name].as_integer();
    assert_eq!(
        (value("GainRaw"), value("BlackLevelRaw"), value("BinningVertical")),
        (Some(120), Some(30), Some(2))
    );
    assert!(
        said.contains("sets 0, 1 at -10 degrees") && dataset.rows()[0].temperature_c == Some(-10.0),
        "{said}"
    );
    // What a header says counts, and the difference is said.
    let mut camera = Camera::new(43);
    for k in 0..2 {
        let cards = ["EXPTIME = 0.01", "GAIN    = 100", "IMAGETYP= 'FLAT'"];
        bench.fits(&format!("both/flat_10ms_gain200_{k}.fits"), &cards, &camera.frame(2000.0, 0.01));
    }
    let (dataset, said) = bench.import("both", &[]);
    assert_eq!(dataset.manifest().camera.features["GainRaw"].as_integer(), Some(100));
    assert!(said.contains("GAIN says 100, and the file's name says 200"), "{said}");
}

/// A time of day, a pause or two times are no exposure without a question.
#[test]
fn times_that_are_no_exposures() {
    let bench = Bench::new();
    let mut camera = Camera::new(44);
    for (folder, name, part) in [
        ("clock", "dark_12_30_45s.tif", "exposure_s of set 0"),
        ("letters", "dark_10h30m12s.tif", "exposure_s of set 0"),
        ("fraction", "dark_0_5s_1.tif", "is 5 or 0.5 s"),
        ("shutter", "dark_1-250s_1.tif", "is 250 or 0.004 s"),
        ("points", "dark.12.10ms.tif", "is 12.1 or 10 ms"),
        ("two units", "dark_1s500ms_0.tif", "exposure_s of set 0"),
        ("two signs", "dark_10.000,5ms_1.tif", "exposure_s of set 0"),
        ("two", "dark_10ms_20ms_1.tif", "tells 0.01 s and 0.02 s"),
        ("warm-up", "dark_5min_warmup_10ms_1.tif", "tells 0.01 s and 300 s"),
        ("parts", "dark_2m30s_1.tif", "exposure_s of set 0"),
        ("apart", "20ms/dark_10ms_1.tif", "the folder 20ms says 0.02 s"),
        ("kinds", "Darks/flat_10ms_1.tif", "kind of set 0"),
        ("master", "masterDark_10ms.tif", "frames of set 0"),
        ("siril", "pp_flat_10ms_00001.tif", "frames of set 0"),
        ("average", "dark_avg16_10ms_1.tif", "frames of set 0"),
        ("times", "dark_10ms_x4_1.tif", "averages of 4 frames"),
        ("delay", "dark_100ms_delay.tif", "exposure_s of set 0"),
    ] {
        bench.tiff(&format!("{folder}/{name}"), &camera.frame(0.0, 0.01));
        let said = bench.refused(folder);
        assert!(said.contains(part), "{name}: {said}");
    }
    for (folder, name, exposure_s) in [
        ("pause", "dark_10ms_delay5s_1.tif", 0.01),
        ("exposure", "dark_exp10ms_every_5s_1.tif", 0.01),
        ("minutes", "dark_5min_1.tif", 300.0),
        ("after", "dark_after_10ms_1.tif", 0.01),
        ("black columns", "black/dark_3ms_1.tif", 0.003),
        ("labels", "dark_2.5ms-exp_100ms-period_1.tif", 0.0025),
        ("sensor", "stacked_cmos/dark_3ms_1.tif", 0.003),
        ("test", "mean_variance_test/dark_3ms_1.tif", 0.003),
        ("behind", "dark_Sec120.00_1.tif", 120.0),
        ("day", "dark_2024-05-01_21-00-03_2s_0001.tif", 2.0),
        ("micro", "dark 250µs 1.tif", 250e-6),
        ("after a date", "dark_20240501_100000us_1.tif", 0.1),
        ("after counters", "dark_01_02_10ms.tif", 0.01),
    ] {
        bench.tiff(&format!("{folder}/{name}"), &camera.frame(0.0, 0.01));
        assert_eq!(sets(&bench.import(folder, &[]).0), [(Kind::Dark, exposure_s, 1)], "{name}");
    }
}

/// The same frame as TIFF and PNG counts once; what operating systems leave is passed over with a word.
#[test]
fn copies_and_leftovers_do_not_count() {
    let bench = Bench::new();
    let mut camera = Camera::new(45);
    let png = |path: &std::path::Path, image: &ndarray::Array2<u16>| {
        let (h, w) = image.dim();
        let mut encoder = png::Encoder::new(fs::File::create(path).unwrap(), w as u32, h as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        let bytes: Vec<u8> = image.iter().flat_map(|v| v.to_be_bytes()).collect();
        encoder.write_header().unwrap().write_image_data(&bytes).unwrap();
    };
    for (kind, light) in [("dark", 0.0), ("flat", 2000.0)] {
        for k in 0..2 {
            let image = camera.frame(light, 0.01);
            let name = format!("in/{kind}_10ms_{k}");
            bench.tiff(&format!("{name}.tif"), &image);
            png(&bench.path(&format!("{name}.png")), &image);
            let cards = ["EXPTIME = 0.01", "GAIN    = 100", "IMAGETYP= 'FLAT'"];
            let cards = [cards[0], cards[1], if kind == "flat" { cards[2] } else { "IMAGETYP= 'DARK'" }];
            bench.fits(&format!("in/fits/{kind}_10ms_{k}.fit"), &cards, &image);
            fs::write(bench.path(&format!("in/._{kind}_10ms_{k}.tif")), b"\0\x05\x16\x07").unwrap();
        }
    }
    for name in
        ["in/Thumbs.db", "in/.DS_Store", "in/desktop.ini", "in/__MACOSX/flat_10ms_0.tif", "in/notes.txt"]
    {
        fs::write(bench.path(name), b"x").unwrap();
    }
    let (dataset, said) = bench.import("in", &[]);
    assert_eq!(sets(&dataset), [(Kind::Dark, 0.01, 2), (Kind::Flat, 0.01, 2)]);
    assert!(said.contains("8 files have the frames of files of the same name"), "{said}");
    assert!(
        said.contains("Thumbs.db") && said.contains("._dark_10ms_0.tif") && said.contains("1 .txt"),
        "{said}"
    );
    // The file that says most is kept.
    assert_eq!(dataset.manifest().camera.features["GainRaw"].as_integer(), Some(100));
    // A shell hands on everything.
    let to = bench.text("glob");
    let names = ["flat_10ms_0.tif", "._flat_10ms_0.tif", "Thumbs.db", "flat_10ms_0.tif"]
        .map(|n| bench.text(&format!("in/{n}")));
    let arguments = [&["import"][..], &names.each_ref().map(|n| n.as_str()), &["-o", &to, "--yes"]].concat();
    expect(0, &arguments);
    assert_eq!(Dataset::open(&bench.path("glob")).unwrap().rows().len(), 1);
    // Of one name, and not alike: nobody knows which is the frame.
    png(&bench.path("in/flat_10ms_0.png"), &camera.frame(2000.0, 0.01));
    let said = bench.refused("in");
    assert!(
        said.contains("flat_10ms_0.tif") && said.contains("flat_10ms_0.png have one name and other pixels"),
        "{said}"
    );
}

/// Files in any order, cards in any order, lines in any order: one dataset, byte for byte.
#[test]
fn no_order_changes_the_dataset() {
    let mut results = Vec::new();
    for turn in 0..4usize {
        let bench = Bench::new();
        let mut camera = Camera::new(46);
        let mut writes: Vec<(String, Vec<String>, ndarray::Array2<u16>)> = Vec::new();
        for (kind, ms, light) in [("Dark", 10, 0.0), ("Flat", 10, 1000.0), ("Flat", 20, 2000.0)] {
            for k in 0..3 {
                let cards = vec![
                    format!("EXPTIME = {} / [s]", f64::from(ms) / 1e3),
                    format!("EXPOSURE= {ms} / [ms]"),
                    format!("IMAGETYP= '{kind}'"),
                    format!("FRAME   = '{kind}'"),
                    "GAIN    = 120".into(),
                    "OFFSET  = 10".into(),
                    "BLKLEVEL= 10".into(),
                    "CCD-TEMP= -10.1".into(),
                    "DET-TEMP= -10.2".into(),
                    "INSTRUME= 'A/B'".into(),
                    "CAMERA  = 'C'".into(),
                    "FILTER  = 'L'".into(),
                ];
                writes.push((
                    format!("{kind}{ms}_{k}.fits"),
                    cards,
                    camera.frame(light, f64::from(ms) / 1e3),
                ));
            }
        }
        let count = writes.len();
        let mut arguments = Vec::new();
        for step in 0..count {
            // Entries of a folder come in the order in which they were made.
            let (name, cards, image) = &writes[(step * [1, 2, 5, 7][turn] + turn) % count];
            let mut cards = cards.clone();
            cards.rotate_left(turn * 3);
            if turn % 2 == 1 {
                cards.reverse();
            }
            let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
            bench.fits(&format!("in/{name}"), &cards, image);
            arguments.push(bench.text(&format!("in/{name}")));
        }
        let to = bench.text("out");
        let arguments: Vec<&str> = ["import"]
            .into_iter()
            .chain(arguments.iter().map(String::as_str))
            .chain(["-o", &to, "--yes"])
            .collect();
        expect(0, &arguments);
        let (of_folder, _) = bench.import("in", &[]);
        let bytes = |dataset: &Dataset| -> Vec<(String, Vec<u8>)> {
            let text = |name: &str| (name.to_string(), fs::read(dataset.root().join(name)).unwrap());
            // Headers are copied with the files; the pixels are what counts.
            let pixels = dataset.rows().iter().map(|r| {
                let codes = dataset.read(r).unwrap();
                (r.file.clone(), codes.iter().flat_map(|v| v.to_le_bytes()).collect())
            });
            ["dataset.toml", "frames.csv"].map(text).into_iter().chain(pixels).collect()
        };
        results.push(bytes(&Dataset::open(&bench.path("out")).unwrap()));
        results.push(bytes(&of_folder));
    }
    for other in &results[1..] {
        assert!(*other == results[0]);
    }
    assert_eq!(results[0].len(), 11);
}

/// Every row of docs/files.md names its tests, and they are there.
#[test]
fn every_row_of_the_table_of_files_has_its_test() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = fs::read_to_string(root.join("docs/files.md")).unwrap();
    let sources = [
        "import",
        "import_cases",
        "import_levels",
        "import_names",
        "import_files",
        "containers",
        "frame_headers",
        "tiff_files",
        "hdf5",
        "mixed_frames",
    ]
    .map(|name| fs::read_to_string(root.join(format!("tests/it/{name}.rs"))).unwrap())
    .concat();
    let rows =
        text.lines().filter(|l| l.starts_with("| ") && !l.starts_with("| ---") && !l.ends_with("| test |"));
    let mut count = 0;
    for row in rows {
        let tests = row.trim_end_matches('|').rsplit('|').next().unwrap();
        let names: Vec<&str> = tests.split('`').filter(|n| n.contains('_')).collect();
        assert!(!names.is_empty(), "{row}");
        for name in names {
            assert!(sources.contains(&format!("fn {name}(")), "{name}: {row}");
        }
        count += 1;
    }
    assert!(count > 25);
}

/// Electrons that are multiplied, by names: `noise` says twice the gain for what it is.
#[test]
fn electron_multiplication_in_names_is_said() {
    let bench = Bench::new();
    campaign(&bench, "em", 4, &|k, ms, i, _| format!("{k}_EM300_{ms}ms_{i:03}.tif"));
    let (dataset, _) = bench.import("em", &[]);
    let said = radcam(&["noise", dataset.root().to_str().unwrap()]);
    let said = String::from_utf8_lossy(&said.stdout).split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(said.contains("EM gain 300") && said.contains("the system gain is"), "{said}");
}
