//! Frames in whatever holds them: stretched codes, signed and floating-point numbers, stacks, cubes, packed
//! files.

use crate::support::{expect, refused, shared};
use flate2::Compression;
use flate2::write::GzEncoder;
use ndarray::{Array2, Array3, Axis};
use radcam::dataset::{CameraInfo, Dataset, FrameRow, Kind, Manifest, Writer, image};
use radcam_sim::rng::{PixelRng, Stream};
use std::fs;
use std::io::{Read, Write};
use std::path::Path;
use tiff::encoder::colortype::{Gray16, Gray32Float};
use tiff::encoder::{TiffEncoder, TiffValue};
use tiff::tags::Tag;

pub const SIDE: usize = 96;
/// Darks at two exposures and flats at five, ms: electrons of a pixel.
const SETS: [(&str, u32, f64); 7] = [
    ("dark", 1, 0.0),
    ("dark", 40, 0.0),
    ("flat", 5, 0.12),
    ("flat", 10, 0.25),
    ("flat", 20, 0.5),
    ("flat", 30, 0.75),
    ("flat", 40, 0.9),
];
const FRAMES: u32 = 6;

/// A converter: bits, gain (DN/e), read noise (e), black level (DN), charge of the brightest flat over 0.9
/// (e).
#[derive(Clone, Copy)]
pub struct Camera {
    pub bits: u8,
    pub gain: f64,
    pub read_noise_e: f64,
    pub black_dn: f64,
    pub most_e: f64,
}

impl Camera {
    /// Codes of a frame: charge with shot noise (normal), read noise, rounded.
    pub fn frame(&self, number: u32, share: f64) -> Array2<u16> {
        let full = f64::from((1u32 << self.bits) - 1);
        Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
            let mut random = PixelRng::new(5, Stream::Frame, number.into(), (y * SIDE + x) as u32, 0);
            let mean = share * self.most_e;
            let charge = mean + mean.sqrt() * random.normal() + self.read_noise_e * random.normal();
            (self.gain * charge + self.black_dn).round().clamp(0.0, full) as u16
        })
    }

    /// Every frame of the campaign with its name.
    fn frames(&self) -> Vec<(String, Array2<u16>)> {
        let mut out = Vec::new();
        for (k, (kind, ms, share)) in SETS.into_iter().enumerate() {
            for i in 0..FRAMES {
                out.push((format!("{kind}_{ms}ms_{i}"), self.frame(FRAMES * k as u32 + i, share)));
            }
        }
        out
    }
}

pub fn tiff<C: tiff::encoder::colortype::ColorType>(
    path: &Path,
    frames: &[Array2<C::Inner>],
    description: &str,
) where
    C::Inner: Clone,
    [C::Inner]: TiffValue,
{
    let mut encoder = TiffEncoder::new(std::io::BufWriter::new(fs::File::create(path).unwrap())).unwrap();
    for frame in frames {
        let (rows, columns) = frame.dim();
        let mut image = encoder.new_image::<C>(columns as u32, rows as u32).unwrap();
        if !description.is_empty() {
            image.encoder().write_tag(Tag::ImageDescription, description).unwrap();
        }
        image.write_data(frame.as_slice().unwrap()).unwrap();
    }
}

/// A FITS file: header cards and the bytes of its numbers.
fn fits_bytes(cards: &[String], data: &[u8]) -> Vec<u8> {
    let mut out: Vec<u8> = cards
        .iter()
        .map(String::as_str)
        .chain(["END"])
        .flat_map(|c| format!("{c:<80}").into_bytes())
        .collect();
    out.resize(out.len().next_multiple_of(2880), b' ');
    out.extend(data);
    out.resize(out.len().next_multiple_of(2880), 0);
    out
}

fn cards(first: &str, bits: i32, axes: &[usize], more: &[&str]) -> Vec<String> {
    let axis = axes.iter().enumerate().map(|(k, n)| format!("NAXIS{:<3}= {n}", k + 1));
    [format!("{first:<10}"), format!("BITPIX  = {bits}"), format!("NAXIS   = {}", axes.len())]
        .into_iter()
        .chain(axis)
        .chain(more.iter().map(|c| (*c).to_string()))
        .collect()
}

const PRIMARY: &str = "SIMPLE  = T";
const OFFSET: &str = "BZERO   = 32768";

fn big_endian(frame: &Array2<u16>) -> Vec<u8> {
    frame.iter().flat_map(|v| (v ^ 0x8000).to_be_bytes()).collect()
}

fn json(arguments: &[&str]) -> serde_json::Value {
    serde_json::from_str(&expect(0, arguments)).unwrap()
}

pub struct Folder(pub tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        let out = Self(tempfile::tempdir().unwrap());
        fs::create_dir(out.0.path().join("in")).unwrap();
        out
    }

    /// A file to be imported.
    pub fn file(&self, name: &str) -> std::path::PathBuf {
        self.0.path().join("in").join(name)
    }

    pub fn text(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().into()
    }

    /// Imports the files; what was said and the dataset.
    pub fn import(&self) -> (String, Dataset) {
        let said = expect(0, &["import", &self.text("in"), "-o", &self.text("d"), "--yes"]);
        (said, Dataset::open(&self.0.path().join("d")).unwrap())
    }

    /// What `noise` finds: gain (DN/e) and read noise (e).
    pub fn noise(&self) -> (f64, f64) {
        let found = json(&["noise", &self.text("d"), "--json"]);
        let of = |name: &str| found[name]["value"].as_f64().unwrap();
        (of("gain_dn_per_e"), of("read_noise_e"))
    }
}

fn close(found: f64, truth: f64, share: f64) -> bool {
    (found / truth - 1.0).abs() < share
}

type Stretch = fn(u32) -> u32;

/// Eight to fourteen bits in sixteen, however they were stretched: the codes of the converter come back, and
/// the read noise holds no quantisation of another step.
#[test]
fn stretched_codes_are_those_of_the_converter() {
    let of =
        |bits, gain, read_noise_e, black_dn, most_e| Camera { bits, gain, read_noise_e, black_dn, most_e };
    let eight = of(8, 0.05, 16.0, 8.0, 4000.0);
    let ten = of(10, 0.1, 10.0, 32.0, 9000.0);
    let twelve = of(12, 0.5, 2.0, 32.0, 7000.0);
    let ways: [(&str, Camera, Stretch); 9] = [
        ("x257", eight, |v| v * 257),
        ("x256", eight, |v| v * 256),
        ("bits repeated", ten, |v| v << 6 | v >> 4),
        ("65535/1023, cut off", ten, |v| v * 65_535 / 1023),
        ("x64, ones in the low bits", ten, |v| v << 6 | 63),
        ("65535/4095, rounded", twelve, |v| (v * 65_535 + 2047) / 4095),
        ("x16", twelve, |v| v << 4),
        ("x16, cut off at 65535", twelve, |v| if v > 3500 { 65_535 } else { v << 4 }),
        ("x10", twelve, |v| v * 10),
    ];
    for (name, camera, stretch) in ways {
        let folder = Folder::new();
        for (file, frame) in camera.frames() {
            let stretched = frame.mapv(|v| stretch(v.into()) as u16);
            tiff::<Gray16>(&folder.file(&format!("{file}.tif")), &[stretched], "");
        }
        let (said, dataset) = folder.import();
        assert_eq!(dataset.manifest().camera.bit_depth, camera.bits, "{name}: {said}");
        assert!(said.contains("stretched") || said.contains("shifted down"), "{name}: {said}");
        let (gain, read_noise_e) = folder.noise();
        assert!(
            close(gain, camera.gain, 0.02) && close(read_noise_e, camera.read_noise_e, 0.02),
            "{name}: {gain} {read_noise_e}"
        );
        // Codes come back but for a constant, below the level at which the way cuts off.
        let (first, frame) = (dataset.read(&dataset.rows()[0]).unwrap(), camera.frame(0, 0.0));
        let off = i32::from(first[[0, 0]]) - i32::from(frame[[0, 0]]);
        assert!(first.iter().zip(&frame).all(|(a, b)| i32::from(*a) - i32::from(*b) == off), "{name}");
    }
}

/// The same in PNG (with the bits that count in sBIT), FITS and single precision.
#[test]
fn stretched_codes_of_other_files_are_those_of_the_converter() {
    let camera = Camera { bits: 10, gain: 0.1, read_noise_e: 10.0, black_dn: 32.0, most_e: 9000.0 };
    for kind in ["png", "fits", "float"] {
        let folder = Folder::new();
        for (file, frame) in camera.frames() {
            let stretched = frame.mapv(|v| v << 6 | v >> 4);
            let path = folder.file(&format!("{file}.{}", if kind == "float" { "tif" } else { kind }));
            match kind {
                "png" => {
                    let out = fs::File::create(&path).unwrap();
                    let mut encoder = png::Encoder::new(out, SIDE as u32, SIDE as u32);
                    encoder.set_color(png::ColorType::Grayscale);
                    encoder.set_depth(png::BitDepth::Sixteen);
                    let mut writer = encoder.write_header().unwrap();
                    writer.write_chunk(png::chunk::sBIT, &[10]).unwrap();
                    let bytes: Vec<u8> = stretched.iter().flat_map(|v| v.to_be_bytes()).collect();
                    writer.write_image_data(&bytes).unwrap();
                }
                "fits" => {
                    let head = cards(PRIMARY, 16, &[SIDE, SIDE], &[OFFSET]);
                    fs::write(&path, fits_bytes(&head, &big_endian(&stretched))).unwrap();
                }
                // As a program writes it that has 1 for full scale.
                _ => tiff::<Gray32Float>(&path, &[stretched.mapv(|v| f32::from(v) / 65_535.0)], ""),
            }
        }
        let (said, dataset) = folder.import();
        assert_eq!(dataset.manifest().camera.bit_depth, 10, "{kind}: {said}");
        let (gain, read_noise_e) = folder.noise();
        assert!(close(gain, 0.1, 0.02) && close(read_noise_e, 10.0, 0.02), "{kind}: {gain} {read_noise_e}");
    }
}

/// A BMP of rows from the bottom to the top, each filled up to four bytes: with a palette of greys, of other
/// contrast with a `colour`, or in three channels that differ by it in the last row.
fn bmp(frame: &Array2<u16>, channels: usize, colour: u8) -> Vec<u8> {
    let (rows, columns) = frame.dim();
    let mut palette: Vec<u8> =
        if channels == 1 { (0..=255).flat_map(|v| [v, v, v, 0]).collect() } else { vec![] };
    let mut pixels = Vec::new();
    for row in frame.rows().into_iter().rev() {
        pixels.extend(row.iter().flat_map(|v| vec![*v as u8; channels]));
        pixels.resize(pixels.len().next_multiple_of(4), 0);
    }
    if channels == 3 {
        pixels[0] ^= colour;
    } else if colour > 0 {
        // Of higher contrast, as a viewer shows it.
        palette.iter_mut().for_each(|v| *v = v.saturating_mul(2));
    }
    let start = 54 + palette.len() as u32;
    let [size, width, height, data] =
        [start as usize + pixels.len(), columns, rows, pixels.len()].map(|v| (v as u32).to_le_bytes());
    let [start, zero, header] = [start, 0, 40].map(u32::to_le_bytes);
    let [planes, bits] = [1, 8 * channels as u16].map(u16::to_le_bytes);
    let head = [b"BM".as_slice(), &size, &zero, &start, &header, &width, &height, &planes, &bits];
    let head = [head.concat(), [zero, data, zero, zero, zero, zero].concat(), palette];
    [head.concat(), pixels].concat()
}

/// BMP as viewers of cameras save it, and a PNG in three channels: grey ones are the frames, a colour
/// is refused with advice, and so is a palette that is not all greys in order.
#[test]
fn grey_frames_in_colours_are_read() {
    let camera = Camera { bits: 8, gain: 0.1, read_noise_e: 10.0, black_dn: 16.0, most_e: 2000.0 };
    let save = |path: &Path, frame: &Array2<u16>, kind: usize, colour: u8| {
        if kind < 4 {
            return fs::write(path, bmp(frame, kind, colour)).unwrap();
        }
        let (rows, columns) = frame.dim();
        let mut encoder = png::Encoder::new(fs::File::create(path).unwrap(), columns as u32, rows as u32);
        encoder.set_color(png::ColorType::Rgb);
        let mut bytes: Vec<u8> = frame.iter().flat_map(|v| [*v as u8; 3]).collect();
        bytes[0] ^= colour;
        encoder.write_header().unwrap().write_image_data(&bytes).unwrap();
    };
    for (kind, extension) in [(1, "bmp"), (3, "bmp"), (4, "png")] {
        let folder = Folder::new();
        for (file, frame) in camera.frames() {
            let frame = frame.slice(ndarray::s![.., 1..]).to_owned();
            save(&folder.file(&format!("{file}.{extension}")), &frame, kind, 0);
        }
        let (said, dataset) = folder.import();
        assert_eq!(dataset.manifest().camera.bit_depth, 8, "{kind}: {said}");
        let first = camera.frame(0, 0.0).slice(ndarray::s![.., 1..]).to_owned();
        assert_eq!(dataset.read(&dataset.rows()[0]).unwrap(), first, "{kind}");
        let (gain, read_noise_e) = folder.noise();
        assert!(close(gain, 0.1, 0.05) && close(read_noise_e, 10.0, 0.03), "{kind}: {gain} {read_noise_e}");
        let folder = Folder::new();
        let path = folder.file(&format!("dark_1ms_0.{extension}"));
        save(&path, &camera.frame(0, 0.0), kind, 1);
        let said = refused(&["import", path.to_str().unwrap(), "-o", folder.file("out").to_str().unwrap()]);
        let why = if kind == 1 { "its index or its grey" } else { "BayerRG8, not RGB8" };
        assert!(said.contains(why), "{kind}: {said}");
    }
}

/// Codes that count in every step stay as they are, however few bits they need.
#[test]
fn codes_of_the_converter_stay() {
    for bits in [8, 11, 14] {
        let camera = Camera { bits, gain: 0.25, read_noise_e: 4.0, black_dn: 40.0, most_e: 700.0 };
        let folder = Folder::new();
        for (file, frame) in camera.frames() {
            tiff::<Gray16>(&folder.file(&format!("{file}.tif")), &[frame], "");
        }
        let (said, dataset) = folder.import();
        assert!(!said.contains("stretched") && !said.contains("shifted"), "{said}");
        assert_eq!(dataset.read(&dataset.rows()[0]).unwrap(), camera.frame(0, 0.0));
    }
}

/// A dataset that was never imported keeps its codes: `noise` and `emva` find the step, and the read noise is
/// right.
#[test]
fn every_verb_knows_the_step_of_a_dataset() {
    let camera = Camera { bits: 12, gain: 0.5, read_noise_e: 2.0, black_dn: 32.0, most_e: 7000.0 };
    // Two darks, and flats of one exposure beyond full scale.
    let shares = [0.0, 0.0].into_iter().chain((1..=26).map(|k| 0.05 * f64::from(k)));
    for factor in [16u16, 4, 1] {
        let folder = Folder::new();
        let info = CameraInfo {
            width: SIDE,
            height: SIDE,
            bit_depth: if factor == 1 { 12 } else { 16 },
            ..CameraInfo::default()
        };
        let root = folder.0.path().join("d");
        let mut writer = Writer::create(&root, &Manifest::new(info), &[]).unwrap();
        for (k, share) in shares.clone().enumerate() {
            for i in 0..FRAMES {
                let row = FrameRow {
                    file: String::new(),
                    kind: if k < 2 { Kind::Dark } else { Kind::Flat },
                    set: k as u32,
                    index: i,
                    exposure_s: if k == 0 { 1e-3 } else { 0.04 },
                    illumination: share,
                    configuration: 0,
                    temperature_c: None,
                    timestamp_s: None,
                };
                let frame = camera.frame(FRAMES * k as u32 + i, share);
                let full = if factor == 1 { 4095 } else { 65_535 };
                let stretched = frame.mapv(|v| if v == 4095 { full } else { factor * v });
                writer.append(row, &stretched).unwrap();
            }
        }
        drop(writer);
        let (gain, read_noise_e) = folder.noise();
        let truth = camera.gain * f64::from(factor);
        assert!(
            close(gain, truth, 0.02) && close(read_noise_e, 2.0, 0.02),
            "x{factor}: {gain} {read_noise_e}"
        );
        let sheet = json(&["emva", &folder.text("d"), "--json"]);
        let of = |name: &str| sheet["quantities"][name]["value"].as_f64().unwrap();
        assert!(
            close(of("K"), truth, 0.03) && close(of("sigma_d"), 2.0, 0.03),
            "x{factor}: {} {}",
            of("K"),
            of("sigma_d")
        );
    }
}

/// Signed, shifted and fractional numbers become codes, and A keeps the unit of the files.
#[test]
fn numbers_become_codes() {
    let camera = Camera { bits: 12, gain: 0.5, read_noise_e: 8.0, black_dn: 100.0, most_e: 7000.0 };
    type Number = fn(f32) -> f32;
    let ways: [(&str, Number, f64); 5] = [
        ("whole", |v| v, 1.0),
        // A black level was taken off.
        ("signed", |v| v - 150.0, 1.0),
        ("shifted", |v| v - 100.375, 1.0),
        // The mean of four pixels, or a binned frame: noise is far above the step.
        ("quarters", |v| v + 0.25 * (v % 4.0), 1.0),
        ("of full scale", |v| v / 4095.0, 1.0 / 4095.0),
    ];
    for (name, number, step) in ways {
        let folder = Folder::new();
        for (file, frame) in camera.frames() {
            let numbers = frame.mapv(|v| number(f32::from(v)));
            tiff::<Gray32Float>(&folder.file(&format!("{file}.tif")), &[numbers], "");
        }
        let (said, _) = folder.import();
        let (gain, read_noise_e) = folder.noise();
        assert!(
            close(gain, camera.gain, 0.03) && close(read_noise_e, 8.0, 0.03),
            "{name}: {gain} {read_noise_e}\n{said}"
        );
        if step != 1.0 {
            assert!(said.contains("1 code is 0.000244"), "{said}");
        }
    }
    // Not a number at one pixel is named.
    let folder = Folder::new();
    let mut broken = camera.frame(0, 0.0).mapv(f32::from);
    broken[[3, 5]] = f32::NAN;
    tiff::<Gray32Float>(&folder.file("dark_1ms_0.tif"), &[broken], "");
    let said = refused(&["import", &folder.text("in"), "-o", &folder.text("d"), "--yes"]);
    assert!(said.contains("NaN at row 3, column 5"), "{said}");
}

/// 12-bit codes of a dark and a flat frame: what every container must give back.
pub fn two() -> [(&'static str, Array2<u16>); 2] {
    let camera = Camera { bits: 12, gain: 0.5, read_noise_e: 4.0, black_dn: 100.0, most_e: 4000.0 };
    [("dark_10ms", camera.frame(0, 0.0)), ("flat_10ms", camera.frame(1, 0.5))]
}

/// Frames of the dataset, in its order.
pub fn frames(dataset: &Dataset) -> Vec<Array2<u16>> {
    dataset.rows().iter().map(|row| dataset.read(row).unwrap()).collect()
}

#[test]
fn fits_of_every_kind_is_read() {
    let integer =
        |frame: &Array2<u16>| frame.iter().flat_map(|v| i32::from(*v).to_be_bytes()).collect::<Vec<u8>>();
    let float =
        |frame: &Array2<u16>| frame.iter().flat_map(|v| f32::from(*v).to_be_bytes()).collect::<Vec<u8>>();
    let double =
        |frame: &Array2<u16>| frame.iter().flat_map(|v| f64::from(*v).to_be_bytes()).collect::<Vec<u8>>();
    let size = [SIDE, SIDE];
    for kind in ["int32", "float", "double", "gz", "extension", "cube of one", "cube of four", "gz cube"] {
        let folder = Folder::new();
        for (name, frame) in two() {
            let one = fits_bytes(&cards(PRIMARY, 16, &size, &[OFFSET]), &big_endian(&frame));
            let zip = |bytes: &[u8]| {
                let mut out = GzEncoder::new(Vec::new(), Compression::fast());
                out.write_all(bytes).unwrap();
                out.finish().unwrap()
            };
            let cube = || {
                let all: Vec<u8> = (0..4u16).flat_map(|k| big_endian(&frame.mapv(|v| v + k % 2))).collect();
                fits_bytes(&cards(PRIMARY, 16, &[SIDE, SIDE, 4], &[OFFSET]), &all)
            };
            let (extension, bytes) = match kind {
                "int32" => ("fits", fits_bytes(&cards(PRIMARY, 32, &size, &[]), &integer(&frame))),
                "float" => ("fit", fits_bytes(&cards(PRIMARY, -32, &size, &[]), &float(&frame))),
                "double" => ("fts", fits_bytes(&cards(PRIMARY, -64, &size, &[]), &double(&frame))),
                "gz" => ("fits.gz", zip(&one)),
                "cube of one" => (
                    "fits",
                    fits_bytes(&cards(PRIMARY, 16, &[SIDE, SIDE, 1], &[OFFSET]), &big_endian(&frame)),
                ),
                "cube of four" => ("fits", cube()),
                "gz cube" => ("fit.gz", zip(&cube())),
                _ => {
                    let head = fits_bytes(&cards(PRIMARY, 8, &[], &["EXTEND  = T"]), &[]);
                    let own =
                        cards("XTENSION= 'IMAGE   '", 16, &size, &["PCOUNT  = 0", "GCOUNT  = 1", OFFSET]);
                    ("fits", [head, fits_bytes(&own, &big_endian(&frame))].concat())
                }
            };
            fs::write(folder.file(&format!("{name}.{extension}")), bytes).unwrap();
        }
        let (_, dataset) = folder.import();
        let found = frames(&dataset);
        let [(_, dark), (_, flat)] = two();
        if kind.ends_with("four") || kind == "gz cube" {
            assert_eq!(found.len(), 8, "{kind}");
            assert_eq!((&found[0], &found[5]), (&dark, &flat.mapv(|v| v + 1)), "{kind}");
        } else {
            assert_eq!(found, [dark, flat], "{kind}");
        }
    }
}

/// Values of the compressed images in `data`, which astropy 7 wrote.
fn compressed(y: usize, x: usize) -> u16 {
    match y {
        5 => 60_000,
        6 if x.is_multiple_of(2) => 0,
        6 => 65_535,
        _ => (1000 + 7 * x + 311 * y + ((x * 2_654_435_761 + y * 40_503) >> 7) % 64) as u16,
    }
}

#[test]
fn tile_compressed_fits_is_read() {
    let unzipped = |bytes: &[u8]| {
        let mut out = Vec::new();
        flate2::read::GzDecoder::new(bytes).read_to_end(&mut out).unwrap();
        out
    };
    let truth = Array2::from_shape_fn((24, 40), |(y, x)| compressed(y, x));
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("x.fits.fz");
    for (name, bytes) in [
        ("rice", &include_bytes!("data/rice.fits.fz.gz")[..]),
        ("gzip 1", include_bytes!("data/gzip1.fits.fz.gz")),
        ("gzip 2, tiles of 16 x 8", include_bytes!("data/gzip2.fits.fz.gz")),
    ] {
        fs::write(&path, unzipped(bytes)).unwrap();
        assert_eq!(image::read(&path, 0).unwrap(), truth, "{name}");
    }
    fs::write(&path, unzipped(include_bytes!("data/rice32cube.fits.fz.gz"))).unwrap();
    let images = image::Images::open(&path).unwrap();
    assert_eq!(images.frames(), [0, 1]);
    for page in [1, 0] {
        let numbers = truth.mapv(|v| 3.0 * f64::from(v.wrapping_add(page as u16)));
        assert_eq!(images.values(page).unwrap(), image::Values::Numbers(numbers), "{page}");
    }
    fs::write(&path, unzipped(include_bytes!("data/hcompress.fits.fz.gz"))).unwrap();
    assert!(image::read(&path, 0).unwrap_err().to_string().contains("HCOMPRESS_1"));
    // A header and tiles from strangers end no program.
    let whole = unzipped(include_bytes!("data/rice.fits.fz.gz"));
    for seed in 0..400u32 {
        let mut damaged = whole.clone();
        for k in 0..3 {
            let at = PixelRng::new(9, Stream::Effect, 0, seed, k).uniform() * damaged.len() as f64;
            damaged[at as usize] = damaged[at as usize].wrapping_add((seed % 255) as u8 + 1);
        }
        damaged.truncate(whole.len() - (seed as usize * 37) % 4000);
        fs::write(&path, damaged).unwrap();
        let _ = image::read(&path, 0);
    }
}

/// What cannot be read is refused by its reason.
#[test]
fn what_is_no_frame_is_refused_by_its_reason() {
    let [(_, dark), (_, flat)] = two();
    let three: Vec<u8> = [&dark, &flat, &flat.mapv(|v| v / 2)].into_iter().flat_map(big_endian).collect();
    let own = cards("XTENSION= 'IMAGE   '", 16, &[SIDE, SIDE], &["PCOUNT  = 0", "GCOUNT  = 1", OFFSET]);
    let extension = fits_bytes(&own, &big_endian(&dark));
    let head = fits_bytes(&cards(PRIMARY, 8, &[], &["EXTEND  = T"]), &[]);
    let cube = fits_bytes(&cards(PRIMARY, 16, &[SIDE, SIDE, 3], &[OFFSET]), &three);
    let cut = cube[..cube.len() - 9000].to_vec();
    let mut zipped = GzEncoder::new(Vec::new(), Compression::fast());
    zipped.write_all(&cube).unwrap();
    let zipped = zipped.finish().unwrap();
    // Samples by the root of the codes, as some monochrome cameras write them.
    let mut table = std::io::Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut table).unwrap();
    let mut rooted = encoder.new_image::<Gray16>(SIDE as u32, SIDE as u32).unwrap();
    let squares: Vec<u16> = (0..256u32).map(|i| (i * i / 16) as u16).collect();
    rooted.encoder().write_tag(Tag::Unknown(50_712), squares.as_slice()).unwrap();
    rooted.write_data(&vec![90; SIDE * SIDE]).unwrap();
    for (name, bytes, part) in [
        ("rooted.dng", table.into_inner(), "LinearizationTable"),
        ("colours.fits", cube.clone(), "three planes"),
        (
            "amplifiers.fits",
            [head.clone(), extension.clone(), extension].concat(),
            "several image extensions",
        ),
        ("empty.fits", head, "without an image"),
        ("cut.fits", cut, "cut short"),
        ("cut.fits.gz", zipped[..zipped.len() / 2].to_vec(), "cut short"),
        ("hdf5.tif", b"\x89HDF\r\n\x1a\n and more".to_vec(), "HDF5"),
        ("a.nef", b"II*\0 and more".to_vec(), "unprocessed_raw -T"),
    ] {
        let folder = Folder::new();
        fs::write(folder.file(name), bytes).unwrap();
        let said = refused(&["import", &folder.text("in"), "-o", &folder.text("d"), "--yes"]);
        assert!(said.contains(part) && said.contains(name), "{name}: {said}");
    }
}

fn npy(descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
    let order = if fortran { "True" } else { "False" };
    let text = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
    let mut out = b"\x93NUMPY\x01\0".to_vec();
    out.extend((text.len() as u16).to_le_bytes());
    out.extend(text.bytes());
    out.extend(data);
    out
}

/// Arrays of any type and byte order; where the frames lie along another axis than the first, it is asked
/// for.
#[test]
fn arrays_of_any_order_are_read() {
    let stack = |share: f64, from: u32| {
        let camera = Camera { bits: 12, gain: 0.5, read_noise_e: 4.0, black_dn: 100.0, most_e: 4000.0 };
        let mut out = Array3::<u16>::zeros((5, SIDE, SIDE));
        for k in 0..5 {
            // Shading and offsets, as every sensor has them.
            let mut frame = camera.frame(from + k, share);
            frame.indexed_iter_mut().for_each(|((y, x), v)| *v += ((y * 31 + x * 17) % 23 + y / 3) as u16);
            out.index_axis_mut(Axis(0), k as usize).assign(&frame);
        }
        out
    };
    let write = |folder: &Folder, kind: &str| {
        for (name, stack) in [("dark_10ms", stack(0.0, 0)), ("flat_10ms", stack(0.5, 5))] {
            let bytes = match kind {
                "big" => npy(
                    ">u2",
                    false,
                    "(5, 96, 96)",
                    &stack.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<_>>(),
                ),
                "float" => {
                    let numbers: Vec<u8> = stack.iter().flat_map(|v| f64::from(*v).to_le_bytes()).collect();
                    npy("<f8", false, "(5, 96, 96)", &numbers)
                }
                "fortran" => {
                    let turned = stack.view().reversed_axes();
                    let turned = turned.as_standard_layout();
                    npy(
                        "<u2",
                        true,
                        "(5, 96, 96)",
                        &turned.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>(),
                    )
                }
                _ => {
                    let last = stack.view().permuted_axes([1, 2, 0]);
                    let last = last.as_standard_layout();
                    npy(
                        "<u2",
                        false,
                        "(96, 96, 5)",
                        &last.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>(),
                    )
                }
            };
            fs::write(folder.file(&format!("{name}.npy")), bytes).unwrap();
        }
    };
    for kind in ["big", "float", "fortran", "last"] {
        let folder = Folder::new();
        write(&folder, kind);
        if kind == "last" {
            let said = refused(&["import", &folder.text("in"), "-o", &folder.text("d"), "--yes"]);
            assert!(said.contains("--frames-axis 2"), "{said}");
            let all = ["import", &folder.text("in"), "-o", &folder.text("d"), "--yes", "--frames-axis", "2"];
            expect(0, &all);
        } else {
            folder.import();
        }
        let dataset = Dataset::open(&folder.0.path().join("d")).unwrap();
        let found = frames(&dataset);
        assert_eq!(found.len(), 10, "{kind}");
        assert_eq!(found[7], stack(0.5, 5).index_axis(Axis(0), 2), "{kind}");
    }
}

/// A stack takes no more than twice the time of its frames in single files, with few pages and with many.
#[test]
fn long_stacks_take_the_time_of_single_files() {
    const PAGES: usize = 4000;
    let page = |k: usize, level: u16| {
        Array2::from_shape_fn((16, 16), |(y, x)| level + ((k * 7 + y * 5 + x * 3 + k * y) % 11) as u16)
    };
    let seconds = |arguments: &[&str]| {
        let start = std::time::Instant::now();
        expect(0, arguments);
        start.elapsed().as_secs_f64()
    };
    let (stacks, files) = (Folder::new(), Folder::new());
    for (kind, level) in [("dark", 40), ("flat", 900)] {
        let pages: Vec<_> = (0..PAGES).map(|k| page(k, level)).collect();
        tiff::<Gray16>(&stacks.file(&format!("{kind}_10ms.tif")), &pages, "");
        for (k, page) in pages.into_iter().enumerate() {
            tiff::<Gray16>(&files.file(&format!("{kind}_10ms_{k}.tif")), &[page], "");
        }
    }
    let import = |f: &Folder| seconds(&["import", &f.text("in"), "-o", &f.text("d"), "--yes"]);
    let (stack_s, files_s) = (import(&stacks), import(&files));
    assert!(stack_s < 2.0 * files_s + 1.0, "import: {stack_s} s, single files {files_s} s");
    let noise = |f: &Folder| {
        let start = std::time::Instant::now();
        let output = crate::support::radcam(&["noise", &f.text("d")]);
        assert!(matches!(output.status.code(), Some(0..=2)));
        start.elapsed().as_secs_f64()
    };
    let (stack_s, files_s) = (noise(&stacks), noise(&files));
    assert!(stack_s < 2.0 * files_s + 1.0, "noise: {stack_s} s, single files {files_s} s");
}

/// Measured: float32 in steps of 0.25.
#[test]
fn the_tooth_is_read_without_rounding_by_hand() {
    let Some(tooth) = shared("real/tooth") else { return };
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path().join("d").to_str().unwrap().to_string();
    expect(0, &["import", tooth.to_str().unwrap(), "-o", &d, "--yes"]);
    let found = json(&["noise", &d, "--json"]);
    let gain = found["gain_dn_per_e"]["value"].as_f64().unwrap();
    assert!((gain - 0.651).abs() < 0.012, "{gain}");
}

/// Tables as spreadsheets of other countries write them.
#[test]
fn tables_of_spreadsheets_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let rows = [(100.5, 54.3), (200.5, 104.3), (400.5, 204.2), (800.25, 404.1)];
    let text = |separator: &str, comma: bool, quote: &str, mark: &str| {
        let number = |v: f64| {
            let text = v.to_string();
            format!("{quote}{}{quote}", if comma { text.replace('.', ",") } else { text })
        };
        let mut out = format!("{mark}mean_dn{separator}var_dn2\r\n");
        for (mean, var) in rows {
            out += &format!("{}{separator}{}\r\n", number(mean), number(var));
        }
        out
    };
    for (name, content) in [
        ("points", text(",", false, "", "")),
        ("semicolons", text(";", true, "", "\u{feff}")),
        ("mark", text(",", false, "", "\u{feff}")),
        ("quoted", text(",", true, "\"", "")),
        ("tabs", text("\t", false, "", "")),
        ("tabs and commas", text("\t", true, "", "\u{feff}")),
    ] {
        let path = dir.path().join(format!("{name}.csv"));
        fs::write(&path, content).unwrap();
        let found = json(&["noise", path.to_str().unwrap(), "--json"]);
        let gain = found["gain_dn_per_e"]["value"].as_f64().unwrap();
        assert!((gain - 0.5).abs() < 0.002, "{name}: {gain}");
    }
}
