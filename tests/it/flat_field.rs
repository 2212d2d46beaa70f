//! Flat-field correction: what was even before the camera is even behind it.

use crate::cases_numbers::floats;
use crate::support::{expect, refused, small_sensor};
use ndarray::{Array2, s};
use radcam::calibrate::file::Calibration;
use std::path::Path;

/// Mean of the corners over that of the middle, blocks of an eighth of each side.
fn corners_over_middle(frame: &Array2<f32>) -> f64 {
    let (rows, columns) = frame.dim();
    let (h, w) = (rows / 8, columns / 8);
    let mean = |y: usize, x: usize| f64::from(frame.slice(s![y..y + h, x..x + w]).mean().unwrap());
    let corners = [(0, 0), (0, columns - w), (rows - h, 0), (rows - h, columns - w)];
    corners.map(|(y, x)| mean(y, x)).iter().sum::<f64>() / 4.0 / mean((rows - h) / 2, (columns - w) / 2)
}

/// A camera behind a lens that leaves 60 % in the corners. Frames of another day, corrected by flats of one
/// place: corners and middle agree within 0.3 % (the error of blocks of 300 pixels is a tenth of that), and
/// what is left of the spread is the noise of the frames and the error of K, within a fifth. A K of the
/// pixels alone leaves the shading.
#[test]
fn a_shaded_flat_is_even_behind_it() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let sensor = small_sensor(dir.path(), "cmos12", 160, 120);
    let text = std::fs::read_to_string(&sensor).unwrap();
    assert!(text.contains("shading = 0.04"), "{text}");
    std::fs::write(&sensor, text.replace("shading = 0.04", "shading = 0.4")).unwrap();
    let camera = sensor.to_str().unwrap();
    expect(0, &["simulate", camera, "--plan", "standard", "-o", &at("flats")]);
    expect(0, &["simulate", camera, "--plan", "quick", "-o", &at("line")]);
    let rows = std::fs::read_to_string(at("line/frames.csv")).unwrap();
    let flats: Vec<Vec<&str>> =
        rows.lines().map(|l| l.split(',').collect()).filter(|r: &Vec<&str>| r[1] == "flat").collect();
    let last = flats.last().unwrap()[2];
    let frames: Vec<String> =
        flats.iter().filter(|r| r[2] == last).map(|r| at(&format!("line/{}", r[0]))).collect();
    assert!(frames.len() >= 4);
    let corrected = |cal: &str, out: &str| -> Vec<Array2<f32>> {
        let mut all = vec!["correct", cal];
        all.extend(frames.iter().map(String::as_str));
        all.extend(["-o", out]);
        let said = expect(0, &all);
        let is_flat = cal.contains("field");
        assert_eq!(said.contains("flat-field"), is_flat, "{said}");
        let name = |f: &String| Path::new(out).join(Path::new(f).file_name().unwrap());
        frames.iter().map(|f| floats(&name(f))).collect()
    };
    let (field, pixels) = (at("field.tiff"), at("pixels.tiff"));
    let said = expect(0, &["calibrate", &at("flats"), "--flat-field", "-o", &field]);
    assert!(said.contains("flat-field: K contains the light") && said.contains("are even"), "{said}");
    expect(0, &["calibrate", &at("flats"), "--estimator", "smooth", "-o", &pixels]);

    let of_pixels = corrected(&pixels, &at("by_pixels"));
    assert!(corners_over_middle(&of_pixels[0]) < 0.75, "{}", corners_over_middle(&of_pixels[0]));
    let of_field = corrected(&field, &at("by_field"));
    let n = of_field.len() as f32;
    let mean = of_field.iter().skip(1).fold(of_field[0].clone(), |sum, f| sum + f) / n;
    let ratio = corners_over_middle(&mean);
    assert!((ratio - 1.0).abs() < 3e-3, "{ratio}");

    let cal = Calibration::read(Path::new(&field)).unwrap();
    let level = f64::from(mean.mean().unwrap());
    let sound: Vec<(usize, usize)> =
        cal.defects.indexed_iter().filter(|(_, flags)| **flags == 0).map(|(at, _)| at).collect();
    let (mut spread, mut noise, mut of_k) = (0.0, 0.0, 0.0);
    for at in &sound {
        let own = f64::from(mean[*at]);
        spread += (own / level - 1.0).powi(2);
        let temporal = of_field.iter().map(|f| (f64::from(f[*at]) - own).powi(2)).sum::<f64>();
        noise += temporal / f64::from(n - 1.0) / f64::from(n) / level.powi(2);
        of_k += f64::from(cal.k_std_err[*at] / cal.k[*at]).powi(2);
    }
    let [spread, expected] = [spread, noise + of_k].map(|sum| (sum / sound.len() as f64).sqrt());
    assert!((spread / expected - 1.0).abs() < 0.2, "spread {spread}, noise and error of K {expected}");

    // The card is in K: nothing is said of a surface.
    let why = refused(&["scene", &field, &frames[0]]);
    assert!(why.contains("field.tiff") && why.contains("--flat-field"), "{why}");
    let both = ["calibrate", &at("flats"), "--flat-field", "--estimator", "paper", "-o", &at("x.tiff")];
    assert!(refused(&both).contains("cannot be used with"));
}
