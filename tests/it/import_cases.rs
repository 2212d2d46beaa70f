//! Headers as programs write them: units, settings, orientation, averages. One wrong reading is a wrong
//! number later.

use crate::import::fits;
use crate::support::{expect, radcam, refused};
use ndarray::Array2;
use radcam::dataset::image::{described_bytes, tiff_bytes};
use radcam::dataset::{Dataset, Kind};
use std::fs;
use std::path::{Path, PathBuf};
use tiff::encoder::colortype::Gray16;

/// A linear camera of gain 0.5 DN/e and 4 e read noise, with black level and a fixed pattern.
pub struct Camera {
    state: u64,
    pub gain: f64,
    pub black: f64,
    pub size: usize,
}

impl Camera {
    pub fn new(seed: u64) -> Self {
        Self { state: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1, gain: 0.5, black: 100.0, size: 32 }
    }

    /// A uniform number, by xorshift.
    fn uniform(&mut self) -> f64 {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        (self.state >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().max(1e-300).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// A frame of so much light (e) that was exposed for so long.
    pub fn frame(&mut self, light_e: f64, exposure_s: f64) -> Array2<u16> {
        let n = self.size;
        Array2::from_shape_fn((n, n), |(y, x)| {
            let pattern = ((y * 31 + x * 17) % 11) as f64 * 0.2;
            let expected = light_e + 20.0 * exposure_s;
            let electrons = expected + (expected + 16.0).sqrt() * self.normal();
            (self.gain * electrons + self.black + pattern).round().clamp(0.0, 4095.0) as u16
        })
    }
}

/// A folder for files, and one for what becomes of them.
pub struct Bench {
    dir: tempfile::TempDir,
}

impl Bench {
    pub fn new() -> Self {
        Self { dir: tempfile::tempdir().unwrap() }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        let path = self.dir.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        path
    }

    pub fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_string()
    }

    pub fn fits(&self, name: &str, cards: &[&str], image: &Array2<u16>) {
        fits(&self.path(name), cards, image);
    }

    pub fn tiff(&self, name: &str, image: &Array2<u16>) {
        fs::write(self.path(name), tiff_bytes(image, 16).unwrap()).unwrap();
    }

    pub fn described(&self, name: &str, description: &str, image: &Array2<u16>) {
        fs::write(self.path(name), described_bytes::<Gray16>(image.view(), description).unwrap()).unwrap();
    }

    /// Imports a folder; what the program said.
    pub fn import(&self, from: &str, more: &[&str]) -> (Dataset, String) {
        let (from, to) = (self.text(from), self.fresh());
        let to = to.to_str().unwrap();
        let output = radcam(&[&["import", &from, "-o", to, "--yes"][..], more].concat());
        let said = [output.stdout, output.stderr].map(|t| String::from_utf8_lossy(&t).into_owned()).concat();
        assert_eq!(output.status.code(), Some(0), "{said}");
        (Dataset::open(Path::new(to)).unwrap(), said)
    }

    /// What an import that must fail says.
    pub fn refused(&self, from: &str) -> String {
        let (from, to) = (self.text(from), self.fresh());
        let said = refused(&["import", &from, "-o", to.to_str().unwrap(), "--yes"]);
        assert!(!to.exists());
        // The name of the map changes.
        said.replace(to.file_name().unwrap().to_str().unwrap(), "TO")
    }

    fn fresh(&self) -> PathBuf {
        let free = |k: &usize| {
            !self.dir.path().join(format!("to{k}")).exists()
                && !self.dir.path().join(format!("to{k}.map.toml")).exists()
        };
        self.dir.path().join(format!("to{}", (0..).find(free).unwrap()))
    }
}

/// Kind, exposure and frames of every set, ordered.
pub fn sets(dataset: &Dataset) -> Vec<(Kind, f64, usize)> {
    let of = |s| {
        let row = dataset.settings(s);
        (row.kind, row.exposure_s, s.rows.len())
    };
    let mut out: Vec<_> = dataset.sets().iter().map(of).collect();
    out.sort_by(|a, b| a.0.to_string().cmp(&b.0.to_string()).then(a.1.total_cmp(&b.1)));
    out
}

fn s(ms: u32) -> f64 {
    f64::from(ms) / 1e3
}

/// Cards of an exposure in milliseconds.
type Cards = dyn Fn(u32) -> Vec<String>;

/// Darks and flats of milliseconds, each with cards of its exposure.
fn exposures(bench: &Bench, folder: &str, cards: &Cards) {
    let mut camera = Camera::new(1);
    for (kind, ms, light) in
        [("dark", 100, 0.0), ("dark", 4000, 0.0), ("flat", 100, 800.0), ("flat", 400, 3200.0)]
    {
        for k in 0..2 {
            let image = camera.frame(light, f64::from(ms) / 1e3);
            let mut all = cards(ms);
            all.push(format!("IMAGETYP= '{kind}'"));
            let all: Vec<&str> = all.iter().map(String::as_str).collect();
            bench.fits(&format!("{folder}/{kind}{ms}_{k}.fits"), &all, &image);
        }
    }
}

const RIGHT: [(Kind, f64, usize); 4] =
    [(Kind::Dark, 0.1, 2), (Kind::Dark, 4.0, 2), (Kind::Flat, 0.1, 2), (Kind::Flat, 0.4, 2)];

/// A unit stands in the card, in its comment, in TIMEUNIT or in the keyword; two cards that agree are one.
#[test]
fn the_unit_of_an_exposure_is_read() {
    let bench = Bench::new();
    let ways: [(&str, &Cards); 12] = [
        ("comment", &|ms| vec![format!("EXPTIME = {ms} / exposure time in ms")]),
        ("timeunit", &|ms| vec!["TIMEUNIT= 'ms'".into(), format!("XPOSURE = {ms}")]),
        ("two", &|ms| vec![format!("EXPTIME = {} / [s]", s(ms)), format!("EXPOSURE= {ms} / [ms]")]),
        ("brackets", &|ms| vec![format!("EXPTIME = {ms}000 / [us] exposure")]),
        ("words", &|ms| vec![format!("EXPOSURE= {ms} / Exposure Time (milliseconds)")]),
        ("string", &|ms| vec![format!("EXPTIME = '{ms} ms'")]),
        ("microseconds", &|ms| vec!["TIMEUNIT= 'us'".into(), format!("EXPTIME = {ms}000")]),
        ("expoinus", &|ms| {
            vec![format!("EXPOINUS= {ms}000 / Exposure time in us"), format!("EXPTIME = {}", s(ms))]
        }),
        ("comma", &|ms| {
            vec![
                format!("EXPTIME = '{}E-03'", format!("{ms}.0").replace('.', ",")),
                format!("EXPOINUS= {ms}000"),
            ]
        }),
        ("seconds", &|ms| {
            vec![format!("EXPTIME = {} / Total Exposure Time (s)", s(ms)), format!("DARKTIME= {ms}")]
        }),
        ("rounded", &|ms| {
            vec![format!("EXPTIME = {} / seconds", s(ms)), format!("EXPOSURE= {:.6}", s(ms) * 1.000_4)]
        }),
        ("hierarch", &|ms| vec![format!("HIERARCH EXPOSURE = {ms} / [ms]")]),
    ];
    for (name, cards) in ways {
        exposures(&bench, name, cards);
        assert_eq!(sets(&bench.import(name, &[]).0), RIGHT, "{name}");
    }
}

/// What has two readings, or none, is asked, and always in the same words.
#[test]
fn an_exposure_of_two_readings_is_asked() {
    let bench = Bench::new();
    let ways: [(&str, &[&str], &Cards); 9] = [
        ("plain", &["EXPTIME 0.1", "EXPOSURE 100"], &|ms| {
            vec![format!("EXPTIME = {}", s(ms)), format!("EXPOSURE= {ms}")]
        }),
        ("twice", &["EXPTIME 0.1 ", "EXPTIME 100"], &|ms| {
            vec![format!("EXPTIME = {}", s(ms)), format!("EXPTIME = {ms}")]
        }),
        ("units", &["names two units"], &|ms| vec![format!("EXPTIME = {ms} / ms or s")]),
        ("lost", &["names two units"], &|ms| vec![format!("EXPOSURE= {ms}000 / Exposure time in ?s")]),
        ("thousands", &["0.1 s", "100"], &|ms| {
            vec![format!("EXPTIME = '0,{ms:03}'"), format!("EXPOSURE= {ms}")]
        }),
        ("group", &["1.1", "1100"], &|ms| vec![format!("EXPTIME = '1,{ms:03}'")]),
        ("negative", &["exposure_s of set 0"], &|ms| vec![format!("EXPTIME = -{ms}")]),
        ("zero", &["exposure_s of set 0"], &|_| vec!["EXPTIME = 0.0".into()]),
        ("unit", &["exposure_s of set 0"], &|ms| vec![format!("EXPTIME = '{ms} ticks'")]),
    ];
    for (name, parts, cards) in ways {
        exposures(&bench, name, cards);
        let said = bench.refused(name);
        for part in parts {
            assert!(said.contains(part), "{name}: {part}: {said}");
        }
        assert_eq!(said, bench.refused(name), "{name}");
    }
    // The order of the cards makes no difference.
    exposures(&bench, "turned/plain", &|ms| vec![format!("EXPOSURE= {ms}"), format!("EXPTIME = {}", s(ms))]);
    let (a, b) = (bench.refused("plain"), bench.refused("turned/plain").replace("turned/plain", "plain"));
    assert_eq!(a, b);
    // A number that the name has in ms: FITS means seconds, and the header says no unit.
    let mut camera = Camera::new(2);
    for k in 0..2 {
        bench.fits(&format!("named/dark_100ms_{k}.fits"), &["EXPTIME = 100"], &camera.frame(0.0, 0.1));
    }
    let said = bench.refused("named");
    assert!(said.contains("EXPTIME 100 says 100 s") && said.contains("0.1 s"), "{said}");
}

/// A header's exposure of 0 is that of a frame whose name says bias; of one named dark it is not known.
#[test]
fn zero_in_a_header_is_the_exposure_of_a_bias_by_name() {
    let bench = Bench::new();
    let mut camera = Camera::new(3);
    for k in 0..2 {
        let (bias, flat) = (camera.frame(0.0, 0.0), camera.frame(2000.0, 0.1));
        bench.fits(&format!("a/bias_{k}.fits"), &["EXPTIME = 0"], &bias);
        bench.fits(&format!("b/dark_{k}.fits"), &["EXPTIME = 0"], &bias);
        for folder in ["a", "b"] {
            bench.fits(&format!("{folder}/flat_{k}.fits"), &["EXPTIME = 0.1"], &flat);
        }
    }
    let (dataset, _) = bench.import("a", &[]);
    assert_eq!(sets(&dataset), [(Kind::Dark, 1e-9, 2), (Kind::Flat, 0.1, 2)]);
    assert!(bench.refused("b").contains("exposure_s"));
}

/// Rows that run upwards in one program's files and downwards in another's: the same sensor row.
#[test]
fn rows_that_run_upwards_are_turned() {
    let bench = Bench::new();
    let mut camera = Camera::new(4);
    let mut truth = Vec::new();
    for k in 0..2 {
        let (dark, flat) = (camera.frame(0.0, 0.01), camera.frame(2000.0, 0.01));
        let up = dark.slice(ndarray::s![..;-1, ..]).to_owned();
        let of = |kind: &str, order: &str| {
            [
                "EXPTIME = 0.01".to_string(),
                format!("IMAGETYP= '{kind} Frame'"),
                format!("ROWORDER= '{order}'"),
            ]
        };
        for (folder, orders) in [("mixed", ["BOTTOM-UP", "TOP-DOWN"]), ("one", ["BOTTOM-UP"; 2])] {
            let [a, b] = [of("Dark", orders[0]), of("Flat", orders[1])];
            bench.fits(&format!("{folder}/a{k}.fits"), &a.each_ref().map(|t| t.as_str()), &up);
            bench.fits(&format!("{folder}/b{k}.fits"), &b.each_ref().map(|t| t.as_str()), &flat);
        }
        truth.push((dark, flat, up));
    }
    let (dataset, said) = bench.import("mixed", &[]);
    assert!(said.contains("rows of 2 frames run from the bottom to the top"), "{said}");
    for (k, (dark, flat, _)) in truth.iter().enumerate() {
        assert_eq!(dataset.read(&dataset.rows()[k]).unwrap(), dark);
        assert_eq!(dataset.read(&dataset.rows()[2 + k]).unwrap(), flat);
    }
    assert_eq!(dataset.manifest().camera.features["ROWORDER"].as_str(), Some("TOP-DOWN"));
    // What all have alike stays as it is.
    let (dataset, _) = bench.import("one", &[]);
    assert_eq!(dataset.read(&dataset.rows()[0]).unwrap(), truth[0].2);
    assert_eq!(dataset.manifest().camera.features["ROWORDER"].as_str(), Some("BOTTOM-UP"));
    // Turned frames cannot be linked.
    let (from, to) = (bench.text("mixed"), bench.text("linked"));
    assert!(refused(&["import", &from, "-o", &to, "--yes", "--link"]).contains("leave --link out"));
    // Some say nothing: it is said.
    bench.fits("one/c.fits", &["EXPTIME = 0.01", "IMAGETYP= 'Flat'"], &truth[0].1);
    assert!(bench.import("one", &[]).1.contains("ROWORDER stands in 4 of 5 headers"));
}

/// Darks and flats with cards of their own.
fn two_settings(bench: &Bench, folder: &str, dark: &[&str], flat: &[&str]) {
    let mut camera = Camera::new(5);
    for k in 0..2 {
        for (kind, cards, light) in [("Dark", dark, 0.0), ("Flat", flat, 2000.0)] {
            let kind_card = format!("IMAGETYP= '{kind} Frame'");
            let all = [&["EXPTIME = 0.01", &kind_card][..], cards].concat();
            bench.fits(&format!("{folder}/{kind}{k}.fits"), &all, &camera.frame(light, 0.01));
        }
    }
}

/// Two black levels, gains, binnings or read-out modes make no dataset; averages and corrected frames are no
/// frames.
#[test]
fn headers_that_tell_of_two_settings_are_refused() {
    let bench = Bench::new();
    let ways: [(&str, &[&str], &[&str], &str); 22] = [
        ("blklevel", &["BLKLEVEL= 10"], &["BLKLEVEL= 40"], "has BLKLEVEL 40"),
        ("offset", &["OFFSET  = 10"], &["OFFSET  = 50.0"], "has OFFSET 50"),
        ("gain", &["GAIN    = 0"], &["GAIN    = 120"], "has GAIN 120"),
        ("egain", &["EGAIN   = 1.0"], &["EGAIN   = 0.25"], "has EGAIN 0.25"),
        ("iso", &["ISOSPEED= 100"], &["ISOSPEED= 200"], "has ISOSPEED 200"),
        ("binning", &["XBINNING= 1"], &["XBINNING= 2"], "has XBINNING 2"),
        ("readmode", &["READMODE= 'High Gain'"], &["READMODE= 'Low Gain'"], "has READMODE Low Gain"),
        ("pedestal", &[], &["PEDESTAL= -100"], "has PEDESTAL -100"),
        ("subframe", &["XORGSUBF= 0"], &["XORGSUBF= 64"], "has XORGSUBF 64"),
        ("camera", &["INSTRUME= 'ASI 174/A'"], &["INSTRUME= 'ASI 174/B'"], "model ASI 174/B"),
        ("calibrated", &[], &["CALSTAT = 'BD'", "PEDESTAL= -100"], "CALSTAT is BD"),
        ("stack", &["STACKCNT= 16"], &["STACKCNT= 16"], "STACKCNT is 16"),
        ("combined", &["NCOMBINE= 16"], &["NCOMBINE= 16"], "NCOMBINE is 16"),
        ("snapshot", &[], &["SNAPSHOT= 4"], "SNAPSHOT is 4"),
        ("iraf", &[], &["DARKCOR = 'Sep 3 dark.fits'"], "DARKCOR is Sep 3"),
        ("bayer", &["BAYERPAT= 'RGGB'"], &["BAYERPAT= 'RGGB'"], "--plane"),
        ("serial", &["SERIAL  = 'A1'"], &["SERIAL  = 'A2'"], "serial A2"),
        ("preamp", &["PREAMP  = 1.0"], &["PREAMP  = 5.1"], "has PREAMP 5.1"),
        ("readtime", &["READTIME= 1.0E-06"], &["READTIME= 1.0E-07"], "has READTIME 0.0000001"),
        ("accumulated", &["NUMACC  = 10"], &["NUMACC  = 10"], "NUMACC is 10"),
        ("ccdproc", &[], &["COMBINED= T"], "COMBINED is T"),
        ("db", &["GAIN    = 0 / [dB]"], &["GAIN    = 6 / [dB]"], "one gain"),
    ];
    for (name, dark, flat, part) in ways {
        two_settings(&bench, name, dark, flat);
        let said = bench.refused(name);
        assert!(said.contains(part), "{name}: {said}");
    }
    let (dataset, said) = {
        two_settings(
            &bench,
            "warm",
            &["SET-TEMP= -10.0", "CCD-TEMP= -10.1"],
            &["SET-TEMP= 20.0", "CCD-TEMP= 19.8"],
        );
        bench.import("warm", &[])
    };
    assert!(
        said.contains("several sensor temperatures: sets 0 at -10.1") && said.contains("sets 1 at 19.8"),
        "{said}"
    );
    assert_eq!(dataset.rows()[0].temperature_c, Some(-10.1));
    // A mosaic plane by plane is taken.
    bench.import("bayer", &["--plane", "0,1"]);
}

/// Settings that all frames share stand in the dataset; what only some state is said.
#[test]
fn gain_black_level_and_binning_stand_in_the_dataset() {
    let bench = Bench::new();
    let cards = [
        "GAIN    = 120.",
        "OFFSET  = 30",
        "XBINNING= 2",
        "YBINNING= 2",
        "INSTRUME= 'ZWO ASI/174MM' / camera",
        "READOUTM= 'Fast'",
        "STACKCNT= 1",
        "CALSTAT = ''",
        "CAMERA  = 'other'",
    ];
    two_settings(&bench, "in", &cards, &cards);
    let (dataset, said) = bench.import("in", &[]);
    let camera = &dataset.manifest().camera;
    let number = |name: &str| camera.features[name].as_integer();
    assert_eq!((number("GainRaw"), number("BlackLevelRaw")), (Some(120), Some(30)));
    assert_eq!((number("BinningHorizontal"), number("BinningVertical")), (Some(2), Some(2)));
    assert_eq!((&*camera.model, camera.features["READOUTM"].as_str()), ("ZWO ASI/174MM", Some("Fast")));
    assert!(!said.contains("not every frame"), "{said}");
    two_settings(&bench, "half", &["GAIN    = 120", "BLKLEVEL= 10"], &["GAIN    = 120"]);
    let (_, said) = bench.import("half", &[]);
    assert!(
        said.contains("not every frame states") && said.contains("BlackLevelRaw (10) by 2 of 4"),
        "{said}"
    );
}

/// Decimal commas of another locale, in descriptions, in headers and in tables.
#[test]
fn decimal_commas_are_read() {
    let bench = Bench::new();
    let mut camera = Camera::new(9);
    for (kind, ms, light) in [("dark", "0,5", 0.0), ("flat", "2,5", 1250.0), ("flat", "12,5", 5000.0)] {
        for k in 0..2 {
            let text = format!("ImageJ=1.53t\nexposure_ms={ms}\ntemperature_c=-10,5\ngain_db=6,5\n");
            bench.described(&format!("in/{kind}_{}_{k}.tif", ms.len()), &text, &camera.frame(light, 0.01));
        }
    }
    let (dataset, _) = bench.import("in", &[]);
    let right = [(Kind::Dark, 0.0005, 2), (Kind::Flat, 0.0025, 2), (Kind::Flat, 0.0125, 2)];
    assert_eq!(sets(&dataset), right);
    assert_eq!(
        (dataset.manifest().camera.gain_db, dataset.rows()[0].temperature_c),
        (Some(6.5), Some(-10.5))
    );
    for name in ["names/dark_0,5ms_1.tif", "names/flat_2,5ms_1.tif", "names/flat_12,5ms_1.tif"] {
        bench.tiff(name, &camera.frame(if name.contains("dark") { 0.0 } else { 2000.0 }, 0.01));
    }
    assert_eq!(
        sets(&bench.import("names", &[]).0).iter().map(|s| s.1).collect::<Vec<_>>(),
        right.map(|s| s.1)
    );
    bench.tiff("group/dark_1,500us_1.tif", &camera.frame(0.0, 0.01));
    let said = bench.refused("group");
    assert!(said.contains("is 1.5 or 1500 us"), "{said}");

    for (name, text) in [
        (
            "t1.csv",
            "\u{feff}mean_dn;var_dn2;exposure_s\r\n100,5;54,3;0,001\r\n200,5;104,3;0,002\r\n400,5;204,2;0,004\r\n",
        ),
        (
            "t2.csv",
            "\u{feff}mean_dn,var_dn2,exposure_s\r\n100.5,54.3,0.001\r\n200.5,104.3,0.002\r\n400.5,204.2,0.004\r\n",
        ),
        (
            "t3.csv",
            "mean_dn,var_dn2,exposure_s\r\n\"100,5\",\"54,3\",\"0,001\"\r\n\"200,5\",\"104,3\",\"0,002\"\r\n\"400,5\",\"204,2\",\"0,004\"\r\n",
        ),
        (
            "t4.csv",
            "mean_dn\tvar_dn2\texposure_s\r\n100.5\t54.3\t0.001\r\n200.5\t104.3\t0.002\r\n400.5\t204.2\t0.004\r\n",
        ),
    ] {
        fs::write(bench.path(name), text).unwrap();
        let said = radcam(&["noise", &bench.text(name), "--json"]);
        let json: serde_json::Value = serde_json::from_slice(&said.stdout).unwrap();
        let gain = json["gain_dn_per_e"]["value"].as_f64().unwrap();
        assert!((gain - 0.4997).abs() < 0.001, "{name}: {gain}");
    }
    fs::write(bench.path("t5.csv"), "mean_dn,var_dn2\n\"1,500\",\"2,500\"\n").unwrap();
    assert!(refused(&["noise", &bench.text("t5.csv")]).contains("decimal sign or a group of thousands"));
}

/// JSON of GenICam features beats what names say, and it is said; damaged files and odd sizes are named.
#[test]
fn headers_count_before_names() {
    let bench = Bench::new();
    let mut camera = Camera::new(13);
    for (kind, us, light) in [("dark", 5000.0, 0.0), ("flat", 20000.0, 2000.0)] {
        for k in 0..2 {
            let json = serde_json::json!({
                "ExposureTime": us, "Gain": 6.0, "BlackLevel": 64, "DeviceTemperature": 41.5,
                "DeviceSerialNumber": "22123456", "shape": [32, 32],
            });
            bench.described(
                &format!("in/{kind}_1ms_12dB_{k}.tif"),
                &json.to_string(),
                &camera.frame(light, 0.01),
            );
        }
    }
    let (dataset, said) = bench.import("in", &[]);
    assert_eq!(sets(&dataset), [(Kind::Dark, 0.005, 2), (Kind::Flat, 0.02, 2)]);
    let info = &dataset.manifest().camera;
    assert_eq!((info.gain_db, &*info.serial), (Some(6.0), "22123456"));
    assert_eq!(info.features["BlackLevel"].as_integer(), Some(64));
    assert_eq!(dataset.rows()[0].temperature_c, Some(41.5));
    assert!(said.contains("ExposureTime 5000.0 says 0.005 s, and the file's name says 0.001 s"), "{said}");

    // Filters part sets.
    for (k, filter) in ["Red", "Red", "Blue", "Blue"].into_iter().enumerate() {
        let cards = ["EXPTIME = 0.01", "IMAGETYP= 'FLAT'", &format!("FILTER  = '{filter}'")];
        bench.fits(&format!("filters/img_{k}.fits"), &cards, &camera.frame(2000.0, 0.01));
    }
    bench.tiff("filters/dark_10ms.tif", &camera.frame(0.0, 0.01));
    assert_eq!(
        sets(&bench.import("filters", &[]).0),
        [(Kind::Dark, 0.01, 1), (Kind::Flat, 0.01, 2), (Kind::Flat, 0.01, 2)]
    );

    // Every damaged file is named; the others go on where the user says so.
    for k in 0..4 {
        bench.tiff(&format!("cut/dark_1ms_{k}.tif"), &camera.frame(0.0, 0.01));
    }
    for k in [1, 3] {
        let path = bench.path(&format!("cut/dark_1ms_{k}.tif"));
        let whole = fs::read(&path).unwrap();
        fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    }
    let said = bench.refused("cut");
    assert!(said.contains("dark_1ms_1.tif") && said.contains("dark_1ms_3.tif"), "{said}");
    assert!(said.contains("--leave-out-damaged"), "{said}");
    let (dataset, said) = bench.import("cut", &["--leave-out-damaged"]);
    assert!(dataset.rows().len() == 2 && said.contains("left out, 2 files"), "{said}");

    // The odd sizes are named, and not the first file.
    for k in 0..4 {
        camera.size = if k == 0 { 30 } else { 32 };
        bench.tiff(&format!("sizes/dark_1ms_{k}.tif"), &camera.frame(0.0, 0.01));
    }
    let said = bench.refused("sizes");
    assert!(said.contains("dark_1ms_0.tif: is 30 x 30 px, and 3 frames are 32 x 32 px"), "{said}");
    assert!(said.contains("--leave-out-damaged"), "{said}");
    let (dataset, _) = bench.import("sizes", &["--leave-out-damaged"]);
    assert_eq!(dataset.rows().len(), 3);
}

/// Micro-Manager keeps exposure and binning of every page as JSON in a tag of its own.
#[test]
fn the_tag_of_micro_manager_is_read() {
    use tiff::tags::Tag;
    let bench = Bench::new();
    let mut camera = Camera::new(51);
    for (name, exposure, light) in
        [("dark", r#""Exposure-ms": 12.5"#, 0.0), ("flat", r#""Exposure-ms": {"PropVal": "25.0"}"#, 2000.0)]
    {
        let image = camera.frame(light, 0.01);
        let json = format!(r#"{{{exposure}, "Binning": "2x2", "Camera": "Andor", "Time": "x"}}"#);
        let file = fs::File::create(bench.path(&format!("in/{name}_img_000000000_Default_000.tif"))).unwrap();
        let mut encoder = tiff::encoder::TiffEncoder::new(file).unwrap();
        let mut page = encoder.new_image::<Gray16>(32, 32).unwrap();
        page.encoder().write_tag(Tag::Unknown(51_123), json.as_str()).unwrap();
        page.write_data(image.as_slice().unwrap()).unwrap();
    }
    let (dataset, _) = bench.import("in", &[]);
    assert_eq!(sets(&dataset), [(Kind::Dark, 0.0125, 1), (Kind::Flat, 0.025, 1)]);
    let camera = &dataset.manifest().camera;
    assert_eq!((&*camera.model, camera.features["BinningHorizontal"].as_integer()), ("Andor", Some(2)));
}

/// `import` asks about flats that are darker than the darks. Imported all the same, they have no gain in
/// `noise`, which says why.
#[test]
fn flats_darker_than_the_darks_are_asked() {
    let bench = Bench::new();
    let mut camera = Camera::new(53);
    for (k, light) in [500.0, 1000.0, 2000.0, 4000.0].into_iter().enumerate() {
        for f in 0..4 {
            let ms = 10 * (k + 1);
            let exposure_s = s(ms as u32);
            bench.tiff(&format!("in/dark_{ms}ms_{f}.tif"), &camera.frame(0.0, exposure_s));
            bench.tiff(&format!("in/flat_{ms}ms_{f}.tif"), &camera.frame(light, exposure_s).mapv(|v| v >> 4));
        }
    }
    let said = bench.refused("in");
    assert!(said.contains("the darks") && said.contains("Cause: shifted bits"), "{said}");
    let mut entries = fs::read_dir(bench.path("x").parent().unwrap()).unwrap().flatten().map(|e| e.path());
    let map = entries.find(|p| p.to_string_lossy().ends_with(".map.toml")).unwrap();
    let kept: Vec<String> = fs::read_to_string(&map)
        .unwrap()
        .lines()
        .filter(|l| !l.contains("Cause: shifted bits"))
        .map(String::from)
        .collect();
    fs::write(&map, kept.join("\n").replace("doubts = [\n]", "")).unwrap();
    let to = bench.text("anyway");
    expect(0, &["import", "--map", map.to_str().unwrap(), "-o", &to, "--yes"]);
    let output = radcam(&["noise", &to, "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(1), "{json:#}");
    assert!(json["gain_dn_per_e"]["value"].as_f64().is_none_or(|gain| gain > 0.0), "{json:#}");
    assert!(json["notes"].to_string().contains("flats are darker than the darks"), "{json:#}");
}

/// Sidecar files of SharpCap, FireCapture and scripts, under the frame's name, a prefix of it, and the
/// folder's name. Texts under other names are not read.
#[test]
fn settings_beside_the_frames_are_read() {
    let bench = Bench::new();
    let mut camera = Camera::new(52);
    let text = |name: &str, text: &str| fs::write(bench.path(name), text).unwrap();
    let sharp = |exposure: &str| {
        format!(
            "[ZWO ASI178MM]\r\nBinning=1\r\nColour Space=MONO16\r\nExposure={exposure}\r\nGain=120\r\nSubtract Dark=None\r\n"
        )
    };
    for k in 0..2 {
        bench.tiff(&format!("in/dark/21_00_03/Capture_{k:05}.tif"), &camera.frame(0.0, 0.005));
        bench.tiff(&format!("in/flat/21_05_07/Capture_{k:05}.tif"), &camera.frame(2000.0, 0.02));
        bench.tiff(&format!("in/flat/two/f-{k}.tif"), &camera.frame(3000.0, 0.03));
    }
    text("in/dark/21_00_03/Capture.CameraSettings.txt", &sharp("5.0000ms"));
    text("in/flat/21_05_07.CameraSettings.txt", &sharp("20.0000ms"));
    (0..2).for_each(|k| text(&format!("in/flat/two/f-{k}.json"), r#"{"exposure_ms": 30.0}"#));
    text("in/flat/two/notes.txt", "exposure: 77 ms");
    let (dataset, said) = bench.import("in", &["--explain"]);
    assert_eq!(sets(&dataset), [(Kind::Dark, 0.005, 2), (Kind::Flat, 0.02, 2), (Kind::Flat, 0.03, 2)]);
    let info = &dataset.manifest().camera;
    assert_eq!((&*info.model, info.features["Gain"].as_integer()), ("ZWO ASI178MM", Some(120)));
    assert!(said.contains("Capture.CameraSettings.txt: Exposure 5.0000ms"), "{said}");

    // FireCapture; a number without a unit is a question, and a dark that was taken off is refused.
    for k in 0..2 {
        bench.tiff(&format!("fire/dark_{k}.tif"), &camera.frame(0.0, 0.01));
        bench.tiff(&format!("fire/flat_{k}.tif"), &camera.frame(2000.0, 0.01));
    }
    text("fire/dark.txt", "FireCapture v2.7\n--\nCamera=ZWO ASI178MM\nShutter=10.00ms\nGain=300 (50%)\n");
    text("fire/flat.txt", "FireCapture v2.7\n--\nCamera=ZWO ASI178MM\nShutter=10.00ms\nGain=300 (50%)\n");
    assert_eq!(sets(&bench.import("fire", &[]).0), [(Kind::Dark, 0.01, 2), (Kind::Flat, 0.01, 2)]);
    text("fire/flat.txt", "Shutter=10.00ms\nGain=200\n");
    let said = bench.refused("fire");
    assert!(said.contains("300") && said.contains("200"), "{said}");
    text("fire/flat.txt", "Exposure=0.01\nGain=300\n");
    let said = bench.refused("fire");
    assert!(said.contains("flat"), "{said}");
    text("fire/flat.txt", "Shutter=10.00ms\nGain=300\nSubtract Dark=C:\\dark.fits\n");
    let said = bench.refused("fire");
    assert!(said.contains("Subtract Dark"), "{said}");
}

/// Guesses are said at the import, in the map, and by what uses the dataset.
#[test]
fn what_was_guessed_is_said_wherever_it_matters() {
    let bench = Bench::new();
    let mut camera = Camera::new(21);
    for (name, ms, light) in
        [("a", 1, 0.0), ("b", 400, 0.0), ("c", 2, 1000.0), ("d", 4, 2000.0), ("e", 8, 4000.0)]
    {
        for k in 0..4 {
            bench.tiff(&format!("in/{name}_{ms}ms_{k}.tif"), &camera.frame(light, f64::from(ms) / 1e3));
        }
    }
    let (dataset, said) = bench.import("in", &["--explain"]);
    assert!(
        said.contains("kind: the mean level, a guess") && said.contains("exposure_s: the file's name"),
        "{said}"
    );
    let root = dataset.root().to_str().unwrap();
    let text = fs::read_to_string(dataset.root().join("dataset.toml")).unwrap();
    assert!(text.contains("guessed = [\"kind of sets 0 to 4: by the mean"), "{text}");
    for verb in ["noise", "diagnose"] {
        let output = radcam(&[verb, root]);
        let said = String::from_utf8_lossy(&output.stdout).split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(said.contains("guessed by import: kind of sets 0 to 4: by the mean"), "{verb}: {said}");
        let json = radcam(&[verb, root, "--json"]).stdout;
        let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
        assert!(json["notes"].to_string().contains("guessed by import"), "{verb}");
    }
    // What is stated is no guess.
    for (name, light) in [("dark_1ms", 0.0), ("flat_1ms", 2000.0)] {
        (0..2).for_each(|k| bench.tiff(&format!("said/{name}_{k}.tif"), &camera.frame(light, 1e-3)));
    }
    let (dataset, _) = bench.import("said", &[]);
    assert!(!fs::read_to_string(dataset.root().join("dataset.toml")).unwrap().contains("guessed"));
    let map = expect(0, &["import", &bench.text("said"), "-o", &bench.text("again"), "--yes", "--json"]);
    let map: serde_json::Value = serde_json::from_str(&map).unwrap();
    assert_eq!(map["set"][0]["from"][0], "exposure_s: the file's name");
}
