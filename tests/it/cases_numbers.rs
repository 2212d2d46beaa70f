//! Numbers from the wrong pixels, sets and frames: cases of the public record and measured data, through the
//! program with real files. The camera here is drawn by hand: Poisson charge, gain, offsets, response, read
//! noise, rounding.

use crate::support::{expect, radcam, refused, shared, small};
use radcam::calibrate::defects::{BLIND, DEAD};
use radcam::calibrate::file::Calibration;
use radcam::dataset::image::tiff_bytes;
use radcam::ndarray::{Array2, Zip};
use radcam_sim::rng::{PixelRng, Stream};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

const SIDE: usize = 128;
const GAIN: f64 = 0.5;
const READ_E: f64 = 4.0;

/// A camera of 12 bits with the numbers of the public cases.
pub struct Camera {
    seed: u64,
    frame: u64,
    /// K times the light's shape.
    pub response: Array2<f64>,
    /// K alone.
    k: Array2<f64>,
    dark_e_per_s: Array2<f64>,
    offset_dn: Array2<f64>,
    black_dn: f64,
}

fn map(seed: u64, number: u64, value: impl Fn(usize, usize, &mut PixelRng) -> f64) -> Array2<f64> {
    Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
        value(y, x, &mut PixelRng::new(seed, Stream::Effect, number, (y * SIDE + x) as u32, 0))
    })
}

impl Camera {
    pub fn new(seed: u64, shape: impl Fn(usize, usize) -> f64) -> Self {
        let k = map(seed, 1, |_, _, r| 1.0 + 0.01 * r.normal());
        Self {
            seed,
            frame: 0,
            response: Array2::from_shape_fn(k.dim(), |(y, x)| k[(y, x)] * shape(y, x)),
            k,
            dark_e_per_s: map(seed, 2, |_, _, _| 20.0),
            offset_dn: map(seed, 3, |_, _, r| 0.5 * r.normal()),
            black_dn: 100.0,
        }
    }

    /// 1 % of the pixels hot, with an exponential dark current of this mean.
    fn hot(mut self, mean_e_per_s: f64) -> Self {
        let hot = map(
            self.seed,
            4,
            |_, _, r| {
                if r.uniform() < 0.01 { mean_e_per_s * r.exponential() } else { 0.0 }
            },
        );
        self.dark_e_per_s += &hot;
        self
    }

    pub fn draw(&mut self, light_e: f64, exposure_s: f64) -> Array2<u16> {
        self.frame += 1;
        let maps = Zip::indexed(&self.response).and(&self.dark_e_per_s).and(&self.offset_dn);
        maps.map_collect(|(y, x), &k, &dark, &offset| {
            let mut r = PixelRng::new(self.seed, Stream::Frame, self.frame, (y * SIDE + x) as u32, 0);
            let mean = light_e * k + dark * exposure_s;
            let charge = if mean > 50.0 {
                mean + mean.sqrt() * r.normal() + (r.normal().powi(2) - 1.0) / 6.0
            } else {
                let (mut n, mut left) = (0.0, (-mean).exp());
                let mut u = r.uniform();
                while u > left && n < 200.0 {
                    u -= left;
                    n += 1.0;
                    left *= mean / n;
                }
                n
            };
            let dn = GAIN * (charge + READ_E * r.normal()) + self.black_dn + offset;
            dn.round().clamp(0.0, 4095.0) as u16
        })
    }
}

/// Folder of frames that `import` groups by their names.
pub struct Bench {
    dir: tempfile::TempDir,
}

impl Bench {
    pub fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("in")).unwrap();
        Self { dir }
    }

    pub fn at(&self, name: &str) -> String {
        self.dir.path().join(name).to_str().unwrap().into()
    }

    pub fn save(&self, name: &str, codes: &Array2<u16>) -> String {
        fs::write(self.dir.path().join(name), tiff_bytes(codes, 16).unwrap()).unwrap();
        self.at(name)
    }

    pub fn set(&self, camera: &mut Camera, name: &str, frames: usize, light_e: f64, exposure_s: f64) {
        for i in 0..frames {
            self.save(&format!("in/{name}_{i}.tif"), &camera.draw(light_e, exposure_s));
        }
    }

    pub fn dark(&self, camera: &mut Camera, frames: usize, ms: u32) {
        self.set(camera, &format!("dark_{ms}ms"), frames, 0.0, f64::from(ms) / 1e3);
    }

    pub fn flat(&self, camera: &mut Camera, frames: usize, ms: u32, e_per_ms: f64) {
        self.set(camera, &format!("flat_{ms}ms"), frames, e_per_ms * f64::from(ms), f64::from(ms) / 1e3);
    }

    pub fn import(&self) -> String {
        expect(0, &["import", &self.at("in"), "-o", &self.at("d"), "--yes"]);
        self.at("d")
    }

    pub fn json(&self, verb: &str) -> Value {
        let output = radcam(&[verb, &self.at("d"), "--json"]);
        assert!(output.status.code() != Some(2), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    }

    /// Darks and the flats that an estimator needs, imported: four exposures for `smooth`, and else four
    /// configurations with the light from another side.
    fn measure(&self, camera: &mut Camera, estimator: &str) {
        [10, 100].iter().for_each(|ms| self.dark(camera, 8, *ms));
        if estimator == "smooth" {
            [10, 20, 30, 40].iter().for_each(|ms| self.flat(camera, 8, *ms, 150.0));
        } else {
            for c in 0..4 {
                let response = camera.response.clone();
                for ((_, x), r) in camera.response.indexed_iter_mut() {
                    *r *= 1.0 + 0.05 * (f64::from(c) - 1.0) * (x as f64 / SIDE as f64 - 0.5);
                }
                self.set(camera, &format!("c{c}_flat_30ms"), 8, 4500.0, 0.03);
                camera.response = response;
            }
        }
        self.import();
        if estimator != "smooth" {
            configurations(&self.at("d"));
        }
    }

    /// Calibrates, corrects a frame of 4000 e with and without replacing, and reads both back.
    fn calibrated(&self, camera: &mut Camera, estimator: &str) -> (Calibration, Array2<f32>) {
        let cal = self.at("cal.tiff");
        expect(0, &["calibrate", &self.at("d"), "--estimator", estimator, "-o", &cal]);
        let light = self.save("light_30ms.tif", &camera.draw(4000.0, 0.03));
        let (plain, replaced) = (self.at("plain.tiff"), self.at("replaced.tiff"));
        expect(0, &["correct", &cal, &light, "-o", &plain]);
        expect(0, &["correct", &cal, &light, "-o", &replaced, "--replace-defects"]);
        (Calibration::read(Path::new(&cal)).unwrap(), floats(Path::new(&plain)))
    }
}

pub fn floats(path: &Path) -> Array2<f32> {
    let bytes = fs::read(path).unwrap();
    let mut decoder = tiff::decoder::Decoder::new(std::io::Cursor::new(bytes)).unwrap();
    let (width, height) = decoder.dimensions().unwrap();
    let tiff::decoder::DecodingResult::F32(values) = decoder.read_image().unwrap() else {
        panic!("no floats")
    };
    Array2::from_shape_vec((height as usize, width as usize), values).unwrap()
}

pub fn value(json: &Value, name: &str) -> (f64, f64) {
    let of = |field: &str| json[name][field].as_f64().unwrap_or(f64::NAN);
    (of("value"), of("std_err"))
}

pub fn notes(json: &Value) -> String {
    json["notes"].to_string()
}

pub fn within(json: &Value, name: &str, truth: f64, rel: f64) {
    let (found, error) = value(json, name);
    assert!(
        (found - truth).abs() < (rel * truth).max(3.0 * error) && error < 0.1 * truth,
        "{name}: {found} +- {error}"
    );
}

/// Rms of K against the truth in the middle of the frame, each over its own mean.
fn off(cal: &Calibration, truth: &Array2<f64>) -> f64 {
    let middle = radcam::ndarray::s![44..84, 44..84];
    let (k, t) = (cal.k.slice(middle).mapv(f64::from), truth.slice(middle));
    let (k_mean, t_mean) = (k.mean().unwrap(), t.mean().unwrap());
    let off = Zip::from(&k).and(&t).map_collect(|k, t| (k / k_mean - t / t_mean).powi(2));
    off.mean().unwrap().sqrt()
}

/// Case 23: one dead pixel, a dead column, hot pixels; both estimators. The file is usable and the pixels are
/// flagged.
#[test]
fn dead_pixels_are_flagged_and_the_calibration_is_usable() {
    for (seed, estimator, column, hot) in [
        (1, "smooth", false, false),
        (2, "smooth", true, false),
        (3, "smooth", false, true),
        (4, "paper", true, true),
        (5, "joint", true, false),
    ] {
        let bench = Bench::new();
        let mut camera = Camera::new(seed, |_, _| 1.0);
        if hot {
            camera = camera.hot(3e4);
        }
        camera.response[(20, 30 + seed as usize)] = 0.0;
        if column {
            camera.response.column_mut(40).fill(0.0);
        }
        bench.measure(&mut camera, estimator);
        let (cal, corrected) = bench.calibrated(&mut camera, estimator);
        let dead = cal.defects.iter().filter(|f| **f & DEAD != 0).count();
        let wanted = 1 + if column { SIDE } else { 0 };
        assert!(cal.defects[(20, 30 + seed as usize)] == DEAD, "seed {seed}");
        assert!((wanted..wanted + 3).contains(&dead), "seed {seed}: {dead} dead");
        assert!(cal.k.indexed_iter().all(|(at, k)| cal.defects[at] & DEAD == 0 || *k == 1.0));
        let sound: Vec<f64> =
            cal.k.iter().zip(&cal.defects).filter(|(_, f)| **f == 0).map(|(k, _)| f64::from(*k)).collect();
        let mean = sound.iter().sum::<f64>() / sound.len() as f64;
        let sd = (sound.iter().map(|k| (k - mean).powi(2)).sum::<f64>() / sound.len() as f64).sqrt();
        assert!((mean - 1.0).abs() < 1e-5 && (0.009..0.012).contains(&sd), "seed {seed}: {mean} {sd}");
        let level = corrected.slice(radcam::ndarray::s![44..84, 44..84]).mean().unwrap();
        assert!((level / 2000.0 - 1.0).abs() < 0.005, "seed {seed}: {level}");
    }
}

/// Gives every set of flats its own configuration.
fn configurations(dataset: &str) {
    let path = Path::new(dataset).join("frames.csv");
    let text = fs::read_to_string(&path).unwrap();
    let line = |l: &str| {
        let mut fields: Vec<&str> = l.split(',').collect();
        if fields[1] == "flat" {
            fields[6] = fields[2];
        }
        fields.join(",")
    };
    fs::write(path, text.lines().map(line).collect::<Vec<_>>().join("\n") + "\n").unwrap();
}

/// Light at a row and a column.
type Shape<'a> = &'a dyn Fn(usize, usize) -> f64;

/// Case 19: an image circle smaller than the sensor, optically black columns, and a black border. They are
/// blind, K of the rest has its 1 %, and statistics of whole rows and columns are those of the lit part:
/// nothing is missing.
#[test]
fn pixels_without_light_are_blind_and_the_rest_is_measured() {
    let circle = |y: usize, x: usize| {
        let off = (y as f64 - 63.5).hypot(x as f64 - 63.5);
        ((62.0 - off) / 4.0).clamp(0.0, 1.0)
    };
    let black = |_: usize, x: usize| if x < 4 { 0.0 } else { 1.0 };
    let border = |y: usize, x: usize| if !(6..120).contains(&x) || y < 8 { 0.0 } else { 1.0 };
    let shapes: [(Shape<'_>, f64); 3] = [(&circle, 0.355), (&black, 4.0 / 128.0), (&border, 0.165)];
    for (shape, blind) in shapes {
        let bench = Bench::new();
        let mut camera = Camera::new(19, shape);
        [10, 100].iter().for_each(|ms| bench.dark(&mut camera, 8, *ms));
        [10, 20, 30, 40].iter().for_each(|ms| bench.flat(&mut camera, 8, *ms, 150.0));
        bench.import();
        within(&bench.json("noise"), "gain_dn_per_e", GAIN, 0.005);
        let said = bench.json("diagnose");
        assert_eq!(said["missing"], serde_json::json!([]), "{}", said["verdict"]);
        assert!(said["notes"].to_string().contains("of the light reaches"), "{}", said["notes"]);
        within(&said, "gain_dn_per_e", GAIN, 0.01);
        let (cal, corrected) = bench.calibrated(&mut camera, "smooth");
        let share = cal.defects.iter().filter(|f| **f & BLIND != 0).count() as f64 / cal.defects.len() as f64;
        assert!((share - blind).abs() < 0.02, "{share} blind");
        assert!(off(&cal, &camera.k) < 0.0036, "{}", off(&cal, &camera.k));
        let level = corrected.slice(radcam::ndarray::s![44..84, 44..84]).mean().unwrap();
        assert!((level / 2000.0 - 1.0).abs() < 0.005, "{level}");
        let said =
            expect(0, &["calibrate", &bench.at("d"), "--estimator", "smooth", "-o", &bench.at("again.tiff")]);
        assert!(said.contains("blind") && said.contains("no light reaches"), "{said}");
    }
}

/// A lens that falls off over the outer third of its circle, to a few per cent at a hard edge, and one whose
/// corners get a few per cent: K of what is well lit is right, with one configuration and with several, and
/// pixels of the rim are no reason to refuse.
#[test]
fn a_lens_that_falls_off_steeply_is_calibrated() {
    let off = |y: usize, x: usize| (y as f64 - 63.5).hypot(x as f64 - 63.5);
    // From 1 at two thirds of the radius to 0.03 at the rim, and nothing beyond.
    let steep = move |y: usize, x: usize| {
        let r = off(y, x) / 60.0;
        if r > 1.0 { 0.0 } else { 1.0 - 0.97 * ((r - 0.667) / 0.333).clamp(0.0, 1.0) }
    };
    let soft = move |y: usize, x: usize| (-(off(y, x) / 48.0).powi(2)).exp();
    let hard = move |y: usize, x: usize| if off(y, x) > 62.0 { 0.0 } else { soft(y, x) };
    // The kink of the first is no polynomial: K has some of the lens in it.
    let shapes: [(&str, Shape<'_>, f64); 3] =
        [("steep", &steep, 0.02), ("soft", &soft, 0.005), ("hard", &hard, 0.005)];
    for (k, (name, shape, most_off)) in shapes.into_iter().enumerate() {
        for estimator in ["smooth", "joint"] {
            let bench = Bench::new();
            let mut camera = Camera::new(60 + k as u64, shape);
            bench.measure(&mut camera, estimator);
            let (cal, corrected) = bench.calibrated(&mut camera, estimator);
            let lit = |at: (usize, usize)| shape(at.0, at.1) > 0.5;
            let sound = cal.defects.indexed_iter().filter(|(at, f)| lit(*at) && **f == 0).count();
            let all = cal.defects.indexed_iter().filter(|(at, _)| lit(*at)).count();
            assert!(sound as f64 > 0.97 * all as f64, "{name} {estimator}: {sound} of {all}");
            let off = fine_off(&cal, &camera.k, &lit);
            assert!(off < most_off, "{name} {estimator}: {off}");
            let level = corrected[(64, 64)];
            assert!((level / 2000.0 - 1.0).abs() < 0.05, "{name} {estimator}: {level}");
        }
    }
}

/// Rms of K against the truth at well lit pixels, each over its mean within nine pixels: a fall that no
/// surface follows stays in K.
fn fine_off(cal: &Calibration, truth: &Array2<f64>, lit: &dyn Fn((usize, usize)) -> bool) -> f64 {
    let ratio = Zip::from(&cal.k).and(truth).map_collect(|k, t| f64::from(*k) / t);
    let used = |at: (usize, usize)| lit(at) && cal.defects[at] == 0;
    let (mut n, mut sum) = (0.0, 0.0);
    for ((y, x), r) in ratio.indexed_iter().filter(|(at, _)| used(*at)) {
        let near = |at: usize| at.saturating_sub(4)..(at + 5).min(SIDE);
        let around = near(y).flat_map(|b| near(x).map(move |a| (b, a))).filter(|at| used(*at));
        let (m, total) = around.fold((0.0, 0.0), |(m, total), at| (m + 1.0, total + ratio[at]));
        sum += (r * m / total - 1.0).powi(2);
        n += 1.0;
    }
    f64::sqrt(sum / n)
}

/// Case 16: overscan columns. They have no part in the PRNU, and this is said.
#[test]
fn overscan_columns_are_left_out_and_said() {
    let bench = Bench::new();
    let mut camera = Camera::new(16, |_, x| if x >= 112 { 0.0 } else { 1.0 });
    [1, 5, 10, 20, 30, 40, 50, 400].iter().for_each(|ms| bench.dark(&mut camera, 8, *ms));
    [5, 10, 20, 30, 40, 50].iter().for_each(|ms| bench.flat(&mut camera, 8, *ms, 120.0));
    bench.import();
    within(&bench.json("noise"), "gain_dn_per_e", GAIN, 0.005);
    let sheet = bench.json("emva");
    let prnu = sheet["quantities"]["PRNU1288"]["value"].as_f64().unwrap();
    assert!((prnu - 1.0).abs() < 0.1, "PRNU {prnu} %");
    assert!(notes(&sheet).contains("columns 0 to 111"), "{}", notes(&sheet));
    assert!(notes(&sheet).contains("nearest to half of saturation"), "{}", notes(&sheet));
    let (cal, _) = bench.calibrated(&mut camera, "smooth");
    assert_eq!(cal.description.blind, 16 * SIDE);
    let circle = Bench::new();
    let mut camera =
        Camera::new(17, |y, x| f64::from(u8::from((y as f64 - 63.5).hypot(x as f64 - 63.5) < 50.0)));
    [10, 20].iter().for_each(|ms| circle.dark(&mut camera, 3, *ms));
    [10, 20].iter().for_each(|ms| circle.flat(&mut camera, 3, *ms, 120.0));
    let dataset = circle.import();
    let said = refused(&["emva", &dataset]);
    assert!(said.contains("image circle"), "{said}");
}

/// Case 15: the black level moved by 10 DN between two sets of darks. The zero lies between them, 105 +- 3.
#[test]
fn a_black_level_that_moved_widens_the_zero() {
    let bench = Bench::new();
    let mut camera = Camera::new(15, |_, _| 1.0);
    bench.set(&mut camera, "00_dark_10ms", 8, 0.0, 0.01);
    for (k, ms) in [5, 10, 20, 30, 40, 50].into_iter().enumerate() {
        camera.black_dn = 100.0 + 1.5 * (k as f64 + 1.0);
        let name = format!("0{}_flat_{ms}ms", k + 1);
        bench.set(&mut camera, &name, 8, 120.0 * f64::from(ms), f64::from(ms) / 1e3);
    }
    camera.black_dn = 110.0;
    bench.set(&mut camera, "09_dark_10ms", 8, 0.0, 0.01);
    let dataset = bench.import();
    let said = bench.json("noise");
    let (zero, error) = value(&said, "offset_dn");
    assert!((zero - 105.0).abs() < 1.0 && (2.5..3.5).contains(&error), "{zero} +- {error}");
    assert!(notes(&said).contains("the black level moved"), "{}", notes(&said));
    let (gain, error) = value(&said, "gain_dn_per_e");
    assert!((gain - GAIN).abs() < 3.0 * error, "{gain} +- {error}");
    assert!(said["data_faults"].as_array().unwrap().is_empty(), "{}", said["data_faults"]);
    // The dark reference does not hold at the exposures of the flats.
    let said = refused(&["calibrate", &dataset, "--estimator", "smooth", "-o", &bench.at("cal.tiff")]);
    assert!(said.contains("darks at two or more") || said.contains("no dark reference"), "{said}");
}

/// Case 39: 1 % hot pixels, some of them full in long darks; and a glint on the card that is full in flats.
#[test]
fn hot_pixels_and_glints_are_masked_as_diagnose_masks_them() {
    let bench = Bench::new();
    let mut camera = Camera::new(39, |_, _| 1.0).hot(2e4);
    [10, 20, 30, 40, 50, 1000].iter().for_each(|ms| bench.dark(&mut camera, 8, *ms));
    [10, 20, 30, 40, 50].iter().for_each(|ms| bench.flat(&mut camera, 8, *ms, 120.0));
    bench.import();
    let said = bench.json("noise");
    let (read, error) = value(&said, "read_noise_e");
    assert!((read - READ_E).abs() < 0.05 && error < 0.05, "{read} +- {error}");
    within(&said, "gain_dn_per_e", GAIN, 0.005);
    assert!(notes(&said).contains("hot"), "{}", notes(&said));
    bench.calibrated(&mut camera, "smooth");

    let bench = Bench::new();
    let glint = |y: usize, x: usize| if (60..67).contains(&y) && (60..67).contains(&x) { 6.0 } else { 1.0 };
    let mut camera = Camera::new(40, glint);
    [1, 400].iter().for_each(|ms| bench.dark(&mut camera, 8, *ms));
    [10, 20, 30, 40].iter().for_each(|ms| bench.flat(&mut camera, 8, *ms, 100.0));
    bench.import();
    let said = bench.json("noise");
    assert!(said["levels"].as_array().unwrap().iter().all(|l| l["used"] == true), "{said:#}");
    within(&said, "gain_dn_per_e", GAIN, 0.005);
    // The levels that the glint clips tell of the other pixels.
    let (cal, _) = bench.calibrated(&mut camera, "smooth");
    assert_eq!(cal.description.n2, 32);
}

/// Case 14: a lamp that flickers by 2 % in a field that falls to a fifth in the corners. The gain is right
/// within its error.
#[test]
fn unequal_light_in_a_shaded_field_leaves_the_gain() {
    for (seed, fall) in [(1, 0.4), (2, 0.8), (3, 0.8)] {
        let bench = Bench::new();
        let mut camera = Camera::new(1400 + seed, |y, x| {
            let (v, u) = (y as f64 / 127.0 - 0.5, x as f64 / 127.0 - 0.5);
            1.0 - fall * (u * u + v * v) / 0.5
        });
        [1, 400].iter().for_each(|ms| bench.dark(&mut camera, 8, *ms));
        let mut lamp = PixelRng::new(seed, Stream::Effect, 9, 0, 0);
        for ms in [5, 10, 20, 30, 40, 50] {
            for i in 0..8 {
                let light = 150.0 * f64::from(ms) * (1.0 + 0.02 * lamp.normal());
                let codes = camera.draw(light, f64::from(ms) / 1e3);
                bench.save(&format!("in/flat_{ms}ms_{i}.tif"), &codes);
            }
        }
        bench.import();
        let said = bench.json("noise");
        let (gain, error) = value(&said, "gain_dn_per_e");
        assert!((gain - GAIN).abs() < 3.5 * error && error < 0.01, "seed {seed}: {gain} +- {error}");
    }
}

fn noise_of(path: &Path) -> Value {
    let output = radcam(&["noise", path.to_str().unwrap(), "--json"]);
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Rows of a curve are left as they are, eight of them side by side too, and the slope at the dark end is the
/// gain; a single row off it is left out and said.
#[test]
fn a_curve_is_no_row_of_outliers() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("table.csv");
    let write = |var: &dyn Fn(usize, f64) -> f64| {
        let row = |i: usize| {
            let mean = 100.0 * (i as f64 + 1.0);
            let z = PixelRng::new(7, Stream::Frame, i as u64, 0, 0).normal();
            format!("{mean},{},100000\n", var(i, mean) * (1.0 + 0.0045 * z))
        };
        fs::write(&path, format!("mean_dn,var_dn2,pixels\n{}", (0..40).map(row).collect::<String>()))
            .unwrap();
    };
    // A line that bends down over its last eight rows.
    write(&|_, mean| 0.5 * mean + 4.0 - if mean > 3200.0 { 0.2 * (mean - 3200.0) } else { 0.0 });
    let said = noise_of(&path);
    let dropped: Vec<&Value> =
        said["levels"].as_array().unwrap().iter().filter(|l| l["used"] == false).collect();
    assert!(dropped.is_empty(), "{dropped:#?}");
    write(&|_, mean| 0.5 * mean * (1.0 - 6e-5 * mean) + 4.0);
    let said = noise_of(&path);
    let (gain, error) = value(&said, "gain_dn_per_e");
    assert!((gain / 0.5 - 1.0).abs() < 0.01 && (gain - 0.5).abs() < 3.5 * error, "{gain} +- {error}");
    assert!(notes(&said).contains("on a curve"), "{}", notes(&said));
    write(&|i, mean| (0.5 * mean + 4.0) * if i == 20 { 1.2 } else { 1.0 });
    let said = noise_of(&path);
    assert!(notes(&said).contains("set 20 stands off the line"), "{}", notes(&said));
    within(&said, "gain_dn_per_e", 0.5, 0.005);
}

/// Sets of one frame have no variance: what cannot be said is not printed as a number.
#[test]
fn sets_of_one_frame_print_no_nonsense() {
    let bench = Bench::new();
    let mut camera = Camera::new(5, |_, _| 1.0);
    bench.dark(&mut camera, 1, 10);
    bench.dark(&mut camera, 4, 20);
    [10, 20, 30].iter().for_each(|ms| bench.flat(&mut camera, if *ms == 10 { 1 } else { 4 }, *ms, 100.0));
    let dataset = bench.import();
    let said = expect(0, &["noise", &dataset]);
    assert!(!said.contains("2147483647") && !said.contains("NaN)"), "{said}");
}

/// A sensor that warms up is said.
#[test]
fn a_temperature_that_drifts_is_said() {
    let bench = Bench::new();
    let mut camera = Camera::new(6, |_, _| 1.0);
    [10, 20].iter().for_each(|ms| bench.dark(&mut camera, 4, *ms));
    [10, 20, 30].iter().for_each(|ms| bench.flat(&mut camera, 4, *ms, 100.0));
    let dataset = bench.import();
    assert!(!notes(&bench.json("noise")).contains("temperature"));
    let path = PathBuf::from(&dataset).join("frames.csv");
    let text = fs::read_to_string(&path).unwrap();
    let line = |(i, l): (usize, &str)| {
        let mut fields: Vec<String> = l.split(',').map(String::from).collect();
        if i > 0 {
            fields[7] = (30.0 + 0.2 * i as f64).to_string();
        }
        fields.join(",")
    };
    fs::write(&path, text.lines().enumerate().map(line).collect::<Vec<_>>().join("\n") + "\n").unwrap();
    let said = notes(&bench.json("noise"));
    assert!(said.contains("between 30.2 and 34.0 °C"), "{said}");
}

/// PRNU is that of the stack nearest to half of saturation; a far one is refused with the reason.
#[test]
fn prnu_is_taken_at_half_of_saturation() {
    let bench = Bench::new();
    let mut camera = Camera::new(8, |_, _| 1.0);
    let exposures = [1, 2, 5, 10, 20, 30, 40];
    exposures.iter().for_each(|ms| bench.dark(&mut camera, 8, *ms));
    exposures.iter().for_each(|ms| bench.flat(&mut camera, 8, *ms, 150.0));
    bench.import();
    let sheet = bench.json("emva");
    let prnu = sheet["quantities"]["PRNU1288"]["value"].as_f64().unwrap();
    assert!((prnu - 1.0).abs() < 0.08, "PRNU {prnu} %");
    assert!(notes(&sheet).contains("nearest to half of saturation of 7 stacks"), "{}", notes(&sheet));

    let bench = Bench::new();
    // A pixel at full scale: the frames are of 12 bits.
    camera.dark_e_per_s[(0, 0)] = 1e8;
    [1, 2, 5, 10].iter().for_each(|ms| bench.dark(&mut camera, 8, *ms));
    [1, 2, 5, 10].iter().for_each(|ms| bench.flat(&mut camera, 8, *ms, 100.0));
    bench.import();
    let sheet = bench.json("emva");
    assert!(sheet["quantities"]["PRNU1288"]["value"].is_null(), "{}", sheet["quantities"]["PRNU1288"]);
    assert!(notes(&sheet).contains("PRNU is undefined"), "{}", notes(&sheet));
}

/// A K of too few frames is refused with the number that suffices, and that number does.
#[test]
fn a_k_that_makes_frames_noisier_is_refused() {
    let draw = |frames: usize| {
        let bench = Bench::new();
        let mut camera = Camera::new(12, |_, _| 1.0);
        camera.response.mapv_inplace(|k| 1.0 + 0.3 * (k - 1.0));
        [5, 50].iter().for_each(|ms| bench.dark(&mut camera, frames.max(8), *ms));
        bench.flat(&mut camera, frames, 5, 400.0);
        bench.import();
        bench
    };
    let bench = draw(8);
    let said = refused(&["calibrate", &bench.at("d"), "--estimator", "smooth", "-o", &bench.at("cal.tiff")]);
    assert!(said.contains("K would make frames noisier"), "{said}");
    assert!(!Path::new(&bench.at("cal.tiff")).exists());
    let wanted: usize =
        said.split(" flats in place of 8").next().unwrap().split(' ').next_back().unwrap().parse().unwrap();
    assert!((60..400).contains(&wanted), "{said}");
    let bench = draw(wanted);
    let said =
        expect(0, &["calibrate", &bench.at("d"), "--estimator", "smooth", "-o", &bench.at("cal.tiff")]);
    assert!(said.contains("standard deviation 0.003"), "{said}");
}

/// The simulator draws dead pixels, a black reference and an image circle; every verb that reads a
/// calibration takes the file.
#[test]
fn simulated_dead_and_blind_pixels_go_through_every_verb() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let mut model = small("cmos12", 128, 96);
    (model.base.dead_pixel_fraction, model.base.black_columns) = (1e-3, 4);
    model.bench.image_circle = 0.95;
    fs::write(at("m.toml"), model.to_toml().unwrap()).unwrap();
    expect(0, &["simulate", &at("m.toml"), "--plan", "standard", "-o", &at("d")]);
    expect(0, &["calibrate", &at("d"), "--estimator", "smooth", "-o", &at("cal.tiff")]);
    let cal = Calibration::read(Path::new(&at("cal.tiff"))).unwrap();
    assert!(cal.defects.column(2).iter().all(|f| f & BLIND != 0));
    assert!(cal.defects.iter().filter(|f| **f & DEAD != 0).count() >= 4);
    assert!(cal.description.blind > 4 * 96 && cal.description.blind < 1500, "{}", cal.description.blind);
    let frame = at("d/frames/00100.tiff");
    expect(0, &["correct", &at("cal.tiff"), &frame, "--exposure-s", "0.005", "-o", &at("out.tiff")]);
    expect(0, &["scene", &at("cal.tiff"), &frame, "--roi", "40,30,40,30", "--json"]);
    radcam(&["report", &at("d"), "--cal", &at("cal.tiff"), "-o", &at("page.html")]);
    assert!(Path::new(&at("page.html")).exists());
}

/// Measured data: an amateur's CMOS with a black-level clamp, a CCD whose table has a stray row, a beamline's
/// camera.
#[test]
fn measured_cameras_have_their_gain() {
    let Some(real) = shared("real") else { return };
    let table = noise_of(&real.join("tables/e2v_ccd250_266_amp05_ptc.csv"));
    let (gain, _) = value(&table, "gain_dn_per_e");
    assert!((gain / 1.286 - 1.0).abs() < 0.01, "E2V: {gain}");
    let stray =
        table["levels"].as_array().unwrap().iter().find(|l| l["var_dn2"].as_f64() > Some(4e5)).unwrap();
    assert_eq!(stray["used"], false, "{stray}");

    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let source = real.join("asi178").to_str().unwrap().to_string();
    let map = at("asi.map.toml");
    // The bias frames do not say their exposure in a way that can be trusted: 32 us.
    radcam(&["import", &source, "-o", &at("asi"), "--yes", "--plane", "0,0"]);
    if let Ok(text) = fs::read_to_string(&map) {
        fs::write(&map, text.replace("# exposure_s =   # seconds", "exposure_s = 3.2e-5")).unwrap();
        if !Path::new(&at("asi")).exists() {
            expect(0, &["import", "--map", &map, "-o", &at("asi"), "--yes"]);
        }
    }
    let said = noise_of(Path::new(&at("asi")));
    let (gain, _) = value(&said, "gain_dn_per_e");
    assert!((gain / 1.056 - 1.0).abs() < 0.02, "asi178: {gain}");
    assert!(said["levels"].to_string().contains("black-level clamp"), "{said:#}");

    let source = real.join("k11").to_str().unwrap().to_string();
    expect(0, &["import", &source, "-o", &at("k11"), "--yes"]);
    let said = noise_of(Path::new(&at("k11")));
    let (gain, _) = value(&said, "gain_dn_per_e");
    assert!((gain / 1.561 - 1.0).abs() < 0.02, "k11: {gain}");
    assert!(said["data_faults"].to_string().contains("unequal-light"), "{}", said["data_faults"]);
}

/// Darks of 8 bits whose noise is about half a step: rounding gives them less or more than q^2/12, by where
/// the black level lies between two codes.
#[test]
fn quiet_darks_of_eight_bits_do_not_tilt_the_line() {
    let (mut sum, mut square, mut n) = (0.0, 0.0, 0.0);
    for seed in 0u32..8 {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
        let mut model = small("cmos12", 120, 96);
        model.camera.bit_depth = 8;
        let b = &mut model.base;
        (b.gain_dn_per_e, b.read_noise_e, b.black_level_dn) = (0.0057, 82.0, 8.0 + 0.12 * f64::from(seed));
        (b.offset_spread_dn, b.dark_current_e_per_s, b.hot_pixel_fraction) = (0.02, 1.0, 0.0);
        b.seed = 100 + u64::from(seed);
        model.bench.shading = 0.3;
        // Pairs at many levels and their darks.
        let full_s = 0.9 * 247.0 / 0.0057 / (model.bench.photon_flux_per_s * model.base.quantum_efficiency);
        let mut plan = String::from("format = \"radcam-plan/1\"\n");
        for i in 1..=16 {
            let exposure_s = full_s * f64::from(i) / 16.0;
            for (kind, light) in [("flat", "illumination = 1.0\n"), ("dark", "")] {
                plan +=
                    &format!("[[set]]\nkind = \"{kind}\"\nframes = 2\nexposure_s = {exposure_s}\n{light}");
            }
        }
        fs::write(at("m.toml"), model.to_toml().unwrap()).unwrap();
        fs::write(at("plan.toml"), plan).unwrap();
        expect(0, &["simulate", &at("m.toml"), "--plan", &at("plan.toml"), "-o", &at("d")]);
        let (gain, error) = value(&noise_of(Path::new(&at("d"))), "gain_dn_per_e");
        let z = (gain - 0.0057) / error;
        (sum, square, n) = (sum + z, square + z * z, n + 1.0);
        assert!(z.abs() < 4.0, "black level {}: {z:+.1} standard errors", 8.0 + 0.12 * f64::from(seed));
    }
    assert!(
        (sum / n).abs() < 3.0 / f64::sqrt(n) && square / n < 2.5,
        "mean {} square {}",
        sum / n,
        square / n
    );
}
