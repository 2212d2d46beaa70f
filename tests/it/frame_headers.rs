//! Settings that `correct`, `scene` and `stream` read of a frame's header and name, held against the
//! calibration. A camera of its own: no code of radcam draws it, but for the random numbers.

use crate::support::{expect, radcam, refused};
use ndarray::Array2;
use radcam_sim::rng::{PixelRng, Stream};
use std::fs;
use std::path::{Path, PathBuf};

/// A linear camera of 12 bits: gain (DN/e), read noise 4 e, black level (DN), dark charge (e/s), K of 1 %.
pub struct Drawn {
    pub seed: u64,
    pub gain: f64,
    pub black_dn: f64,
    pub dark_e_per_s: f64,
    pub shape: (usize, usize),
    drawn: u64,
}

impl Drawn {
    pub fn new(seed: u64, dark_e_per_s: f64) -> Self {
        Self { seed, gain: 0.5, black_dn: 100.0, dark_e_per_s, shape: (64, 80), drawn: 0 }
    }

    /// A frame of so many electrons of light; `factor` of the row and the column multiplies light and, last,
    /// gain.
    pub fn frame_of(
        &mut self,
        light_e: f64,
        exposure_s: f64,
        factor: impl Fn(usize, usize) -> (f64, f64),
    ) -> Array2<u16> {
        self.drawn += 1;
        let (seed, frame, width) = (self.seed, self.drawn, self.shape.1);
        Array2::from_shape_fn(self.shape, |(y, x)| {
            let pixel = (y * width + x) as u32;
            let k = 1.0 + 0.01 * PixelRng::new(seed, Stream::Uniformity, 0, pixel, 0).normal();
            let (light, gain) = factor(y, x);
            let mean = light_e * light * k + self.dark_e_per_s * exposure_s;
            let (a, b) = PixelRng::new(seed, Stream::Frame, frame, pixel, 0).normal_pair();
            let charge = mean + mean.sqrt() * a + 4.0 * b;
            (self.gain * gain * charge + self.black_dn).round().clamp(0.0, 4095.0) as u16
        })
    }

    pub fn frame(&mut self, light_e: f64, exposure_s: f64) -> Array2<u16> {
        self.frame_of(light_e, exposure_s, |_, _| (1.0, 1.0))
    }
}

/// A FITS of 16 bits; cards as `KEY = value`.
pub fn fits(path: &Path, cards: &[&str], image: &Array2<u16>) {
    let (rows, columns) = image.dim();
    let size = [format!("NAXIS1  = {columns}"), format!("NAXIS2  = {rows}")];
    let head = ["SIMPLE  = T", "BITPIX  = 16", "NAXIS   = 2", &size[0], &size[1], "BZERO   = 32768"];
    let card = |text: &str| match text.split_once('=') {
        Some((key, value)) => format!("{:<80}", format!("{:<8}= {}", key.trim(), value.trim())),
        None => format!("{text:<80}"),
    };
    let mut out: Vec<u8> =
        head.iter().chain(cards).chain(&["END"]).flat_map(|c| card(c).into_bytes()).collect();
    out.resize(out.len().next_multiple_of(2880), b' ');
    out.extend(image.iter().flat_map(|v| (v ^ 0x8000).to_be_bytes()));
    out.resize(out.len().next_multiple_of(2880), 0);
    fs::write(path, out).unwrap();
}

/// A TIFF with a description, and with an exposure as EXIF has it (tag 33434, in the first directory).
fn tiff(path: &Path, image: &Array2<u16>, description: &str, exif_s: Option<(u32, u32)>) {
    use tiff::encoder::{Rational, TiffEncoder, colortype::Gray16};
    use tiff::tags::Tag;
    let mut file = fs::File::create(path).unwrap();
    let mut encoder = TiffEncoder::new(&mut file).unwrap();
    let (rows, columns) = image.dim();
    let mut page = encoder.new_image::<Gray16>(columns as u32, rows as u32).unwrap();
    if !description.is_empty() {
        page.encoder().write_tag(Tag::ImageDescription, description).unwrap();
    }
    if let Some((n, d)) = exif_s {
        page.encoder().write_tag(Tag::Unknown(33434), Rational { n, d }).unwrap();
    }
    page.write_data(image.as_slice().unwrap()).unwrap();
}

/// A PNG of 16 bits with texts.
fn png(path: &Path, image: &Array2<u16>, texts: &[(&str, &str)]) {
    let (rows, columns) = image.dim();
    let mut encoder = png::Encoder::new(fs::File::create(path).unwrap(), columns as u32, rows as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    for (key, text) in texts {
        encoder.add_text_chunk(key.to_string(), text.to_string()).unwrap();
    }
    let bytes: Vec<u8> = image.iter().flat_map(|v| v.to_be_bytes()).collect();
    encoder.write_header().unwrap().write_image_data(&bytes).unwrap();
}

/// Mean of a corrected image, DN.
fn mean(path: &Path) -> f64 {
    let mut decoder = tiff::decoder::Decoder::new(fs::File::open(path).unwrap()).unwrap();
    let tiff::decoder::DecodingResult::F32(values) = decoder.read_image().unwrap() else { panic!() };
    values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64
}

/// A folder of files, with what is often done there.
pub struct Folder(pub tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().into()
    }

    /// Corrects a frame with `cal.tiff`: mean of the corrected image, DN, and what was said.
    pub fn correct(&self, frame: &str, more: &[&str]) -> (f64, String) {
        let out = self.text("out.tiff");
        let (cal, frame) = (self.text("cal.tiff"), self.text(frame));
        let run = radcam(&[&["correct", &cal, &frame, "-o", &out, "--overwrite"][..], more].concat());
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        assert_eq!(run.status.code(), Some(0), "{said}");
        (mean(&self.path("out.tiff")), said)
    }

    /// Imports `in` into `d`, and makes `cal.tiff` of it.
    pub fn calibrate(&self) {
        expect(0, &["import", &self.text("in"), "-o", &self.text("d"), "--yes"]);
        expect(0, &["calibrate", &self.text("d"), "--estimator", "smooth", "-o", &self.text("cal.tiff")]);
    }
}

const SETTINGS: [&str; 6] = [
    "GAIN = 100",
    "OFFSET = 10",
    "INSTRUME = 'ZWO ASI174MM'",
    "XBINNING = 1",
    "YBINNING = 1",
    "CCD-TEMP = -10.0",
];

/// A calibration of FITS frames at `SETTINGS`, darks of 10 ms and 4 s.
fn of_fits(folder: &Folder, camera: &mut Drawn) {
    fs::create_dir(folder.path("in")).unwrap();
    let mut take = |kind: &str, exposure_s: f64, light_e: f64| {
        for i in 0..6 {
            let said = [format!("EXPTIME = {exposure_s}"), format!("IMAGETYP = '{kind}'")];
            let cards: Vec<&str> = said.iter().map(String::as_str).chain(SETTINGS).collect();
            let name = format!("in/{}{exposure_s}_{i}.fits", &kind[..1]);
            fits(&folder.path(&name), &cards, &camera.frame(light_e, exposure_s));
        }
    };
    take("Dark Frame", 0.01, 0.0);
    take("Dark Frame", 4.0, 0.0);
    take("Flat Frame", 0.01, 1500.0);
    take("Flat Frame", 0.03, 4500.0);
    folder.calibrate();
}

/// FITS: the exposure of the header counts, 400 DN of dark charge in 4 s of it, and each setting that differs
/// from the calibration's is refused by its name and both values. What a header does not state is said.
#[test]
fn fits_headers_are_held_against_the_calibration() {
    let (folder, mut camera) = (Folder::new(), Drawn::new(20, 200.0));
    of_fits(&folder, &mut camera);
    let manifest = fs::read_to_string(folder.path("d/dataset.toml")).unwrap();
    for line in ["GainRaw = 100", "BlackLevelRaw = 10", "BinningHorizontal = 1", "BinningVertical = 1"] {
        assert!(manifest.contains(line), "{manifest}");
    }
    let frame = camera.frame(2000.0, 4.0);
    let write = |name: &str, cards: &[&str]| fits(&folder.path(name), cards, &frame);
    let with = |said: &str| -> Vec<String> {
        let key = said.split('=').next().unwrap().trim().to_string();
        let others = SETTINGS.iter().filter(|c| c.split('=').next().unwrap().trim() != key);
        others.map(ToString::to_string).chain([said.to_string(), "EXPTIME = 4.0".into()]).collect()
    };
    let written = |name: &str, cards: &[String]| {
        write(name, &cards.iter().map(String::as_str).collect::<Vec<_>>());
    };
    written("same_1.fits", &with("GAIN = 100"));
    let (level, said) = folder.correct("same_1.fits", &[]);
    assert!((level - 1000.0).abs() < 3.0, "{level}");
    assert!(said.is_empty(), "{said}");
    for (card, part) in [
        ("GAIN = 300", "GainRaw) is 300, and was 100"),
        ("OFFSET = 50", "BlackLevelRaw) is 50, and was 10"),
        ("INSTRUME = 'QHY 268M'", "model is QHY 268M, and was ZWO ASI174MM"),
        ("XBINNING = 2", "BinningHorizontal is 2, and was 1"),
        ("YBINNING = 4", "BinningVertical is 4, and was 1"),
        ("BAYERPAT = 'RGGB'", "pixel format is BayerRG12, and was Mono of 12 bits"),
    ] {
        written("other_1.fits", &with(card));
        let arguments =
            ["correct", &folder.text("cal.tiff"), &folder.text("other_1.fits"), "-o", &folder.text("x.tiff")];
        let said = refused(&arguments);
        assert!(said.contains("other_1.fits") && said.contains(part) && said.contains("--force"), "{said}");
        assert!(!folder.path("x.tiff").exists());
        let scene = ["scene", arguments[1], arguments[2], "--roi", "0,0,20,20"];
        assert!(refused(&scene).contains(part));
        let (level, _) = folder.correct("other_1.fits", &["--force"]);
        assert!((level - 1000.0).abs() < 3.0, "{level}");
    }
    // Numbers as other programs write them are the same setting.
    written("same_2.fits", &with("GAIN = 100.0"));
    assert!(folder.correct("same_2.fits", &[]).1.is_empty());
    written("warm.fits", &with("CCD-TEMP = 15.0"));
    let (_, said) = folder.correct("warm.fits", &[]);
    assert!(said.contains("15 °C") && said.contains("-10 °C"), "{said}");
    // What is not stated is said, once for many frames, and the calibration's is taken.
    write("bare_1.fits", &["EXPTIME = 4.0"]);
    write("bare_2.fits", &["EXPTIME = 4.0"]);
    let (level, said) = folder.correct("bare_1.fits", &[]);
    assert!((level - 1000.0).abs() < 3.0, "{level}");
    for part in ["model (ZWO ASI174MM)", "GainRaw) (100)", "BlackLevelRaw) (10)", "BinningHorizontal (1)"] {
        assert!(said.contains(part), "{said}");
    }
    let (cal, out) = (folder.text("cal.tiff"), folder.text("many"));
    let run = radcam(&[
        "correct",
        &cal,
        &folder.text("bare_1.fits"),
        &folder.text("bare_2.fits"),
        "-o",
        &out,
        "--json",
    ]);
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    assert_eq!(said.matches("does not state").count(), 1, "{said}");
    let answer: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(answer["notes"].as_array().unwrap().len(), 1, "{answer}");
    write("mute.fits", &[]);
    let (_, said) = folder.correct("mute.fits", &[]);
    assert!(said.contains("states no exposure") && said.contains("--exposure-s"), "{said}");
}

/// TIFF and PNG: exposure of the description, of EXIF, of text chunks, of the name; a gain in dB that differs
/// is refused.
#[test]
fn descriptions_exif_texts_and_names_say_the_exposure() {
    let (folder, mut camera) = (Folder::new(), Drawn::new(33, 200.0));
    fs::create_dir(folder.path("in")).unwrap();
    for (kind, ms, light_e) in
        [("dark", 10, 0.0), ("dark", 4000, 0.0), ("flat", 10, 1500.0), ("flat", 20, 3000.0)]
    {
        for i in 0..6 {
            let image = camera.frame(light_e, f64::from(ms) * 1e-3);
            let text = format!("exposure_ms={ms}\ngain_db=0");
            tiff(&folder.path(&format!("in/{kind}_{ms}_{i}.tif")), &image, &text, None);
        }
    }
    folder.calibrate();
    let frame = camera.frame(2000.0, 4.0);
    let of = |name: &str| folder.path(name);
    tiff(&of("text_1.tif"), &frame, "exposure_ms=4000\ngain_db=0", None);
    tiff(&of("exif_1.tif"), &frame, "", Some((4, 1)));
    png(&of("text_1.png"), &frame, &[("exposure_ms", "4000")]);
    png(&of("comment_1.png"), &frame, &[("Comment", "exposure_s = 4\ngain_db = 0.0")]);
    tiff(&of("shot_4s_0dB_1.tif"), &frame, "", None);
    fs::create_dir(of("4000ms")).unwrap();
    tiff(&of("4000ms/shot_1.tif"), &frame, "", None);
    for name in
        ["text_1.tif", "exif_1.tif", "text_1.png", "comment_1.png", "shot_4s_0dB_1.tif", "4000ms/shot_1.tif"]
    {
        let (level, said) = folder.correct(name, &[]);
        assert!((level - 1000.0).abs() < 3.0, "{name}: {level}");
        let stated = ["text_1.tif", "comment_1.png", "shot_4s_0dB_1.tif"].contains(&name);
        assert_eq!(said.contains("does not state gain (0 dB)"), !stated, "{name}: {said}");
    }
    tiff(&of("gain_1.tif"), &frame, "exposure_ms=4000\ngain_db=12", None);
    tiff(&of("shot_4s_12dB_1.tif"), &frame, "", None);
    png(&of("gain_1.png"), &frame, &[("exposure_ms", "4000"), ("gain_db", "12")]);
    for name in ["gain_1.tif", "shot_4s_12dB_1.tif", "gain_1.png"] {
        let said = refused(&[
            "correct",
            &folder.text("cal.tiff"),
            &folder.text(name),
            "-o",
            &folder.text("refused.tiff"),
        ]);
        assert!(said.contains("gain is 12 dB, and was 0 dB"), "{said}");
    }
    // The exposure that is given counts, and what the frame states is not hidden.
    let (level, said) = folder.correct("exif_1.tif", &["--exposure-s", "2"]);
    assert!((level - 1200.0).abs() < 3.0, "{level}");
    assert!(said.contains("states an exposure of 4 s") && said.contains("2 s"), "{said}");
}

/// A recording whose header settings differ from those of the calibration is no camera for it; one that does
/// not state them is told of.
#[test]
fn a_stream_is_held_against_the_calibration_as_frames_are() {
    let (folder, mut camera) = (Folder::new(), Drawn::new(21, 200.0));
    of_fits(&folder, &mut camera);
    let replay = format!("replay:{}", folder.text("d"));
    let arguments = ["stream", "--camera", &replay, "--cal", &folder.text("cal.tiff"), "--frames", "3"];
    let run = radcam(&arguments);
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    assert_eq!(run.status.code(), Some(0), "{said}");
    assert!(!said.contains("does not state"), "{said}");
    let path = folder.path("d/dataset.toml");
    let manifest = fs::read_to_string(&path).unwrap();
    for (from, to, part) in [
        ("GainRaw = 100", "GainRaw = 300", "GainRaw) is 300, and was 100"),
        ("BinningVertical = 1", "BinningVertical = 2", "BinningVertical is 2, and was 1"),
        ("ASI174MM", "ASI178MM", "model is ZWO ASI178MM"),
    ] {
        fs::write(&path, manifest.replace(from, to)).unwrap();
        let said = refused(&arguments);
        assert!(said.contains(part), "{said}");
        let frames = ["correct", &folder.text("cal.tiff"), &folder.text("d"), "-o", &folder.text("no")];
        assert!(refused(&frames).contains(part));
    }
    fs::write(&path, manifest.replace("GainRaw = 100\n", "")).unwrap();
    let said = String::from_utf8_lossy(&radcam(&arguments).stderr).into_owned();
    assert!(said.contains("does not state gain setting (GainRaw) (100)"), "{said}");
}

/// Codes of 12 bits stretched by 65535/4095: `import` takes them back, and `correct` refuses flats and darks
/// that were not, though the codes of a dark lie within 12 bits.
#[test]
fn stretched_frames_are_no_frames_of_the_calibration() {
    let folder = Folder::new();
    // Codes below 128 become multiples of 16, which `correct` knew before.
    let mut camera = Drawn { black_dn: 200.0, ..Drawn::new(41, 20.0) };
    fs::create_dir(folder.path("in")).unwrap();
    let stretched = |image: &Array2<u16>| image.mapv(|v| ((u32::from(v) * 65_535 + 2047) / 4095) as u16);
    let mut take = |kind: &str, ms: u32, light_e: f64| {
        for i in 0..6 {
            let image = camera.frame(light_e, f64::from(ms) / 1e3);
            tiff(&folder.path(&format!("in/{kind}_{ms}ms_{i}.tif")), &stretched(&image), "", None);
        }
    };
    take("dark", 10, 0.0);
    take("dark", 4000, 0.0);
    [10, 20, 30, 40].into_iter().for_each(|ms| take("flat", ms, 150.0 * f64::from(ms)));
    folder.calibrate();
    for (name, light_e) in [("dark_10ms", 0.0), ("flat_10ms", 1500.0)] {
        let image = camera.frame(light_e, 0.01);
        let (raw, back) = (format!("{name}_raw.tif"), format!("{name}_back.tif"));
        tiff(&folder.path(&raw), &stretched(&image), "", None);
        tiff(&folder.path(&back), &image, "", None);
        let (cal, raw, out) = (folder.text("cal.tiff"), folder.text(&raw), folder.text("no.tiff"));
        let said = refused(&["correct", &cal, &raw, "-o", &out]);
        let part = if light_e > 0.0 { "codes stretched to more bits" } else { "steps of 16" };
        assert!(said.contains(part) && said.contains("radcam import"), "{said}");
        let (mean, _) = folder.correct(&back, &[]);
        assert!((mean - 0.5 * light_e).abs() < 3.0, "{name}: {mean}");
    }
}

/// Codes in the upper bits of 16: files as `import` shifted them down are shifted down by `correct`, and
/// said.
#[test]
fn codes_in_the_upper_bits_are_shifted_down() {
    let (folder, mut camera) = (Folder::new(), Drawn::new(297, 20.0));
    fs::create_dir(folder.path("in")).unwrap();
    let mut take = |name: &str, ms: u32, light_e: f64| {
        let image = camera.frame(light_e, f64::from(ms) / 1e3).mapv(|v| v << 4);
        tiff(&folder.path(name), &image, "", None);
    };
    for i in 0..6 {
        take(&format!("in/dark_10ms_{i}.tif"), 10, 0.0);
        take(&format!("in/dark_4000ms_{i}.tif"), 4000, 0.0);
        for ms in [10, 20, 30, 40] {
            take(&format!("in/flat_{ms}ms_{i}.tif"), ms, 150.0 * f64::from(ms));
        }
    }
    take("one_10ms.tif", 10, 1500.0);
    folder.calibrate();
    let (mean, said) = folder.correct("one_10ms.tif", &[]);
    assert!((mean - 750.0).abs() < 3.0, "{mean}");
    assert!(said.contains("all codes are multiples of 16: shifted down by 4 bits"), "{said}");
}

/// Rows from the bottom to the top against a calibration of rows from the top: turned and said. A calibration
/// that does not state how its rows run is asked about.
#[test]
fn rows_that_run_the_other_way_are_turned() {
    let brighter = |y: usize, _: usize| (if y < 32 { 1.4 } else { 1.0 }, 1.0);
    for stated in [true, false] {
        let (folder, mut camera) = (Folder::new(), Drawn::new(298, 20.0));
        fs::create_dir(folder.path("in")).unwrap();
        let mut take = |name: &str, kind: &str, ms: u32, light_e: f64, order: Option<&str>| {
            let exposure_s = f64::from(ms) / 1e3;
            let said = [format!("EXPTIME = {exposure_s}"), format!("IMAGETYP = '{kind}'")];
            let order = order.map(|order| format!("ROWORDER = '{order}'"));
            let cards: Vec<&str> = said.iter().map(String::as_str).chain(order.as_deref()).collect();
            let mut image = camera.frame_of(light_e, exposure_s, brighter);
            if order.as_deref().is_some_and(|order| order.contains("BOTTOM")) {
                image.invert_axis(ndarray::Axis(0));
            }
            fits(&folder.path(name), &cards, &image);
        };
        let order = stated.then_some("TOP-DOWN");
        for i in 0..6 {
            take(&format!("in/d1_{i}.fits"), "Dark", 10, 0.0, order);
            take(&format!("in/d2_{i}.fits"), "Dark", 4000, 0.0, order);
            for ms in [10, 20, 30, 40] {
                take(&format!("in/f{ms}_{i}.fits"), "Flat", ms, 100.0 * f64::from(ms), order);
            }
        }
        take("up.fits", "Light", 10, 1000.0, Some("BOTTOM-UP"));
        folder.calibrate();
        if !stated {
            let arguments =
                ["correct", &folder.text("cal.tiff"), &folder.text("up.fits"), "-o", &folder.text("x.tiff")];
            let said = refused(&arguments);
            assert!(said.contains("ROWORDER") && said.contains("does not state"), "{said}");
            continue;
        }
        let (_, said) = folder.correct("up.fits", &[]);
        assert!(said.contains("are BOTTOM-UP and the calibration's are TOP-DOWN"), "{said}");
        let mut decoder =
            tiff::decoder::Decoder::new(fs::File::open(folder.path("out.tiff")).unwrap()).unwrap();
        let tiff::decoder::DecodingResult::F32(values) = decoder.read_image().unwrap() else { panic!() };
        let (upper, lower) = values.split_at(32 * 80);
        let mean = |of: &[f32]| of.iter().map(|v| f64::from(*v)).sum::<f64>() / of.len() as f64;
        // The smooth estimator leaves the light in: the brighter half is above, as in the calibration.
        assert!(mean(upper) > 1.2 * mean(lower), "{} {}", mean(upper), mean(lower));
    }
}

/// Overscan that a FITS header states is cut off by `import` and by `correct`; sections that are none are
/// refused.
#[test]
fn overscan_of_fits_is_cut_off() {
    let folder = Folder::new();
    let mut camera = Drawn::new(42, 20.0);
    fs::create_dir(folder.path("in")).unwrap();
    // Eight columns behind the sensor's 72, and two rows.
    let overscan = |y: usize, x: usize| (f64::from(u8::from(x < 72 && y < 62)), 1.0);
    let trim = ["BIASSEC = '[73:80,1:62]'", "TRIMSEC = '[1:72,1:62]' / light", "DATASEC = '[1:80,1:62]'"];
    let mut take = |name: &str, kind: &str, exposure_s: f64, light_e: f64, cards: &[&str]| {
        let said = [format!("EXPTIME = {exposure_s}"), format!("IMAGETYP = '{kind}'")];
        let all: Vec<&str> = said.iter().map(String::as_str).chain(cards.iter().copied()).collect();
        fits(&folder.path(name), &all, &camera.frame_of(light_e, exposure_s, overscan));
    };
    for i in 0..6 {
        take(&format!("in/d1_{i}.fits"), "Dark", 0.01, 0.0, &trim);
        take(&format!("in/d2_{i}.fits"), "Dark", 4.0, 0.0, &trim);
        for ms in [10, 20, 30, 40] {
            let exposure_s = f64::from(ms) / 1e3;
            take(&format!("in/f{ms}_{i}.fits"), "Flat", exposure_s, 150.0 * f64::from(ms), &trim);
        }
    }
    folder.calibrate();
    let map = fs::read_to_string(folder.path("d/dataset.toml")).unwrap();
    assert!(map.contains("width = 72") && map.contains("height = 62"), "{map}");
    assert!(map.contains("columns 73 to 80 of 80, rows 63 to 64 of 64"), "{map}");
    let cal = radcam::calibrate::file::Calibration::read(&folder.path("cal.tiff")).unwrap();
    assert_eq!(cal.description.blind, 0);
    take("one.fits", "Light", 0.01, 1500.0, &trim);
    let (mean, _) = folder.correct("one.fits", &[]);
    assert!((mean - 750.0).abs() < 4.0, "{mean}");
    // Only the overscan is stated, and one that reaches beyond the frame.
    fs::create_dir(folder.path("in2")).unwrap();
    take("in2/a.fits", "Dark", 0.01, 0.0, &["BIASSEC = '[1:4,1:64]'"]);
    let said = expect(0, &["import", &folder.text("in2"), "-o", &folder.text("d2"), "--yes", "--json"]);
    assert!(said.contains("columns 1 to 4 of 80"), "{said}");
    fs::create_dir(folder.path("in3")).unwrap();
    take("in3/b.fits", "Dark", 0.01, 0.0, &["TRIMSEC = '[1:160,1:128]'"]);
    let said = refused(&["import", &folder.text("in3"), "-o", &folder.text("d3"), "--yes"]);
    assert!(
        said.contains("b.fits") && said.contains("[1:160,1:128]") && said.contains("80 x 64 px"),
        "{said}"
    );
    // Frames of two read-outs are no dataset.
    take("in2/c.fits", "Dark", 0.01, 0.0, &["BIASSEC = '[77:80,1:64]'"]);
    let said = refused(&["import", &folder.text("in2"), "-o", &folder.text("d4"), "--yes"]);
    assert!(said.contains("a.fits states overscan at columns 1 to 4"), "{said}");
}
