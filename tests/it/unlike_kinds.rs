//! Darks and flats that do not belong together: averages of one kind, another black level, lost bits, light
//! in some darks; sensors of two amplifiers.

use crate::import_cases::{Bench, Camera};
use crate::support::{expect, radcam};
use ndarray::Array2;
use radcam_sim::rng::{PixelRng, Stream};
use serde_json::Value;

/// Gain of the camera, DN/e, its read noise, e, and that of one of its frames with rounding, DN^2.
const GAIN: f64 = 0.5;
const READ_E: f64 = 4.0;

/// A camera with hot pixels, of 500 to 4000 e/s, and light of 100,000 e/s.
struct Hot(Camera);

impl Hot {
    fn new(seed: u64) -> Self {
        let mut camera = Camera::new(seed);
        camera.size = 96;
        Self(camera)
    }

    fn frame(&mut self, light_e: f64, exposure_s: f64) -> Array2<u16> {
        let mut frame = self.0.frame(light_e, exposure_s);
        for (k, hot_e_per_s) in [500.0, 1000.0, 2000.0, 4000.0].into_iter().enumerate() {
            let hot = self.0.frame(light_e + hot_e_per_s * exposure_s, exposure_s);
            (0..12).map(|i| (7 * i + 2 * k + 3, 5 * i + 11 * k + 2)).for_each(|at| frame[at] = hot[at]);
        }
        frame
    }

    /// Mean of so many frames.
    fn mean(&mut self, of: usize, light_e: f64, exposure_s: f64) -> Array2<u16> {
        let frames = (0..of).map(|_| self.frame(light_e, exposure_s).mapv(f64::from));
        let sum = frames.reduce(|sum, frame| sum + frame).unwrap();
        (sum / of as f64).mapv(|v| v.round() as u16)
    }
}

/// A campaign of darks and flats at these exposures, ms, eight frames each, drawn by the function of light
/// and exposure, e and s; imported. Its path.
fn campaign(
    bench: &Bench,
    darks_ms: &[f64],
    flats_ms: &[f64],
    draw: &mut dyn FnMut(f64, f64) -> Array2<u16>,
) -> String {
    for (kind, exposures_ms) in [("dark", darks_ms), ("flat", flats_ms)] {
        for ms in exposures_ms {
            let light_e = if kind == "flat" { 100.0 * ms } else { 0.0 };
            for i in 0..8 {
                bench.tiff(&format!("in/{kind}_{ms}ms_{i}.tif"), &draw(light_e, ms / 1000.0));
            }
        }
    }
    bench.import("in", &["--pattern", "mono"]).0.root().to_str().unwrap().to_owned()
}

const FLATS_MS: [f64; 5] = [5.0, 10.0, 20.0, 30.0, 40.0];

/// Flats that are means of two and of four frames beside single darks, and darks that are means of eight
/// beside single flats, are named by the charge of the darks; single frames are not.
#[test]
fn averages_of_one_kind_are_named() {
    for (flats, darks, seed) in [(1, 1, 273), (2, 1, 274), (4, 1, 275), (1, 8, 276)] {
        let (bench, mut hot) = (Bench::new(), Hot::new(seed));
        let mut draw = |light_e: f64, exposure_s: f64| {
            hot.mean(if light_e > 0.0 { flats } else { darks }, light_e, exposure_s)
        };
        let path = campaign(&bench, &[10.0, 400.0], &FLATS_MS, &mut draw);
        let output = radcam(&["noise", &path, "--json"]);
        let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).replace('\n', " ");
        let (averaged, of_flats) =
            (said.contains("were averaged before they were saved"), said.contains("all flats were averaged"));
        assert_eq!((averaged, of_flats), (flats * darks > 1, flats > 1), "{flats} {darks}: {said}");
        assert_eq!(output.status.code(), Some(if flats > 1 { 2 } else { 0 }), "{said}");
        if flats > 1 {
            // The darks agree with the model; the campaign does not.
            let said = expect(1, &["diagnose", &path]);
            assert!(said.contains("slips leave out all flats"), "{said}");
            continue;
        }
        let gain = &serde_json::from_str::<Value>(&said).unwrap()["gain_dn_per_e"];
        let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
        assert!((value - GAIN).abs() < 4.0 * error, "{flats} {darks}: {value} +- {error}");
    }
}

/// All darks but one are means of frames: the single one is not blamed and left out, and a read noise that is
/// off by more than a tenth does not end with 0.
#[test]
fn the_only_single_dark_is_not_blamed() {
    for (of, seed) in [(2, 375), (3, 376), (4, 377), (8, 378)] {
        let (bench, mut hot) = (Bench::new(), Hot::new(seed));
        let mut draw = |light_e: f64, exposure_s: f64| {
            let frames = if light_e == 0.0 && exposure_s < 0.0125 { of } else { 1 };
            hot.mean(frames, light_e, exposure_s)
        };
        let path = campaign(&bench, &[10.0, 11.0, 12.0, 13.0], &FLATS_MS, &mut draw);
        for verb in ["noise", "diagnose"] {
            let output = radcam(&[verb, &path, "--json"]);
            let said: Value = serde_json::from_slice(&output.stdout).unwrap();
            let faults = said["data_faults"].as_array().unwrap();
            assert!(faults.iter().any(|f| f["kind"] == "dependent-frames"), "{of} {verb}: {faults:?}");
            assert!(faults.iter().all(|f| f["kind"] != "other-settings"), "{of} {verb}: {faults:?}");
            let read = &said["read_noise_e"];
            let wrong = read["value"].as_f64().is_some_and(|v| {
                // The dark charge of 13 ms and the hot pixels add less than a tenth.
                !(0.95 * READ_E..1.1 * READ_E).contains(&v)
            });
            assert!(!wrong || output.status.code() != Some(0), "{of} {verb}: {read}");
        }
    }
}

/// Means of so many frames each, darks and flats, rounded to even as numpy does: named, and the gain is no
/// result. Single frames and means of three have no such trace.
#[test]
fn means_of_all_frames_are_named() {
    for (of, seed) in [(1u32, 354), (2, 355), (3, 356), (4, 357), (8, 358)] {
        let (bench, mut hot) = (Bench::new(), Hot::new(seed));
        let mut draw = |light_e: f64, exposure_s: f64| {
            let frames = (0..of).map(|_| hot.frame(light_e, exposure_s).mapv(f64::from));
            let sum = frames.reduce(|sum, frame| sum + frame).unwrap();
            (sum / f64::from(of)).mapv(|v| v.round_ties_even() as u16)
        };
        let path = campaign(&bench, &[10.0, 40.0], &FLATS_MS, &mut draw);
        let output = radcam(&["noise", &path, "--json"]);
        let said: Value = serde_json::from_slice(&output.stdout).unwrap();
        let text = said["data_faults"].to_string();
        assert_eq!(text.contains(&format!("as in means of {of} frames")), of % 2 == 0, "{of}: {text}");
        assert_eq!(output.status.code(), Some(i32::from(of % 2 == 0)), "{of}: {text}");
        let gain = said["gain_dn_per_e"]["value"].as_f64().unwrap();
        assert!((gain * f64::from(of) / GAIN - 1.0).abs() < 0.05, "{of}: {gain}");
    }
}

/// Darks of another black level, and darks that lost two bits, beside flats of which none is dim: named, and
/// the gain is that of the flats.
#[test]
fn darks_of_another_black_level_are_named_by_bright_flats() {
    for (lost, words, seed) in
        [(false, "another black level than the flats", 277), (true, "lost their last bits", 278)]
    {
        let (bench, mut hot) = (Bench::new(), Hot::new(seed));
        let mut draw = |light_e: f64, exposure_s: f64| {
            let frame = hot.frame(light_e, exposure_s);
            match (light_e > 0.0, lost) {
                (true, false) => frame.mapv(|v| v + 60),
                (false, true) => frame.mapv(|v| v / 4),
                _ => frame,
            }
        };
        let path = campaign(&bench, &[10.0, 20.0, 30.0], &[5.0, 15.0, 25.0, 35.0, 50.0], &mut draw);
        let said: Value = serde_json::from_slice(&radcam(&["noise", &path, "--json"]).stdout).unwrap();
        assert!(said["data_faults"].to_string().contains(words), "{words}: {}", said["data_faults"]);
        let gain = &said["gain_dn_per_e"];
        let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
        assert!((value - GAIN).abs() < 4.0 * error, "{words}: {value} +- {error}");
    }
}

/// Light that fell on one of five darks; it is left out, and the read noise is right.
#[test]
fn a_dark_with_light_in_it_is_left_out() {
    let (bench, mut hot) = (Bench::new(), Hot::new(279));
    let mut draw = |light_e: f64, exposure_s: f64| {
        let stray_e = if light_e == 0.0 && exposure_s == 0.03 { 60.0 } else { 0.0 };
        hot.frame(light_e + stray_e, exposure_s)
    };
    let path = campaign(&bench, &[10.0, 20.0, 30.0, 40.0, 50.0], &FLATS_MS, &mut draw);
    let said: Value = serde_json::from_slice(&radcam(&["noise", &path, "--json"]).stdout).unwrap();
    let text = said["data_faults"].to_string();
    assert!(text.contains("above the line of the other darks"), "{text}");
    assert_eq!(said["data_faults"].as_array().unwrap().len(), 1, "{text}");
    let read = &said["read_noise_e"];
    let (value, error) = (read["value"].as_f64().unwrap(), read["std_err"].as_f64().unwrap());
    assert!((value - READ_E).abs() < 4.0 * error, "{value} +- {error}");
}

/// One dark exposure and one of light, two frames each, of twelve cameras: nothing is missing in any. A half
/// of the frames without flats tells no gain, and is not asked what flats scatter by.
#[test]
fn two_frames_of_two_sets_raise_no_alarm() {
    for seed in 280..292 {
        let (bench, mut hot) = (Bench::new(), Hot::new(seed));
        for i in 0..2 {
            bench.tiff(&format!("in/dark_6ms_{i}.tif"), &hot.frame(0.0, 0.006));
            bench.tiff(&format!("in/flat_6ms_{i}.tif"), &hot.frame(2400.0, 0.006));
        }
        let path = bench.import("in", &["--pattern", "mono"]).0.root().to_str().unwrap().to_owned();
        let output = radcam(&["diagnose", &path]);
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success() && said.contains("agrees with the model"), "{seed}: {said}");
    }
}

/// Three columns of 96, beside the middle, that stand at full scale in every frame saturate no set, and make
/// no step.
#[test]
fn stuck_columns_saturate_no_set() {
    let (bench, mut hot) = (Bench::new(), Hot::new(292));
    let mut draw = |light_e: f64, exposure_s: f64| {
        let mut frame = hot.frame(light_e, exposure_s);
        (45..48).for_each(|x| frame.column_mut(x).fill(4095));
        frame
    };
    let path = campaign(&bench, &[10.0, 40.0], &FLATS_MS, &mut draw);
    for verb in ["noise", "diagnose"] {
        let output = radcam(&[verb, &path, "--json"]);
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert_eq!(output.status.code(), Some(0), "{verb}: {said}");
        let gain = &serde_json::from_str::<Value>(&said).unwrap()["gain_dn_per_e"];
        let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
        assert!((value - GAIN).abs() < 4.0 * error, "{verb}: {value} +- {error}");
    }
}

/// Three exposures of which none saturates: EMVA 1288 wants levels up to 70 % of saturation, which lies
/// beyond all.
#[test]
fn levels_far_from_saturation_all_count() {
    let (bench, mut hot) = (Bench::new(), Hot::new(293));
    let exposures_ms = [10.0, 20.0, 30.0];
    let path =
        campaign(&bench, &exposures_ms, &exposures_ms, &mut |light, exposure| hot.frame(light, exposure));
    let output = radcam(&["emva", &path, "--json"]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(0), "{said}");
    let json: Value = serde_json::from_str(&said).unwrap();
    let gain = &json["quantities"]["K"];
    let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
    assert!((value - GAIN).abs() < 4.0 * error, "{value} +- {error}");
    assert!(json["notes"].to_string().contains("fitted to all 3 levels"), "{}", json["notes"]);
}

/// A sensor that changes from a quiet to a noisy amplifier between two levels lies on no line: the noise of
/// the levels together tells it, where that of each alone is too little.
#[test]
fn noise_on_no_line_does_not_agree() {
    for (noisy_dn, agrees, seed) in [(0.0, true, 294), (14.0, false, 295)] {
        let (bench, mut hot) = (Bench::new(), Hot::new(seed));
        let mut rng = PixelRng::new(seed, Stream::Effect, 0, 0, 0);
        let mut draw = |light_e: f64, exposure_s: f64| {
            let noisy_dn = if light_e > 400.0 { noisy_dn } else { 0.0 };
            let mut noisy = |v: u16| (f64::from(v) + noisy_dn * rng.normal()).round().max(0.0) as u16;
            hot.frame(light_e, exposure_s).mapv(&mut noisy)
        };
        let path = campaign(&bench, &[10.0, 20.0, 30.0], &FLATS_MS, &mut draw);
        let said: Value = serde_json::from_slice(&radcam(&["diagnose", &path, "--json"]).stdout).unwrap();
        assert_eq!(said["consistent"], agrees, "{}", said["verdict"]);
        assert!(agrees || said["verdict"].to_string().contains("noise"), "{}", said["verdict"]);
    }
}

/// A sensor that merges two amplifiers with gains 1.5 % apart has a step at the level where it changes over:
/// no lamp is off by the same on one side of a level and by nothing on the other. The law that is said is
/// that step:
/// 1.5 % of the code, which is up to a tenth more of the signal, since the black level is in the code.
#[test]
fn a_step_of_the_response_is_no_lamp() {
    let (bench, mut hot) = (Bench::new(), Hot::new(301));
    let mut draw = |light_e: f64, exposure_s: f64| {
        let merged = |v: u16| if v > 900 { (f64::from(v) * 0.985).round() as u16 } else { v };
        hot.frame(light_e, exposure_s).mapv(merged)
    };
    let flats_ms = [4.0, 7.0, 10.0, 13.0, 20.0, 26.0, 32.0, 38.0, 44.0, 50.0, 56.0];
    let path = campaign(&bench, &[10.0, 20.0, 30.0], &flats_ms, &mut draw);
    let said: Value = serde_json::from_slice(&radcam(&["diagnose", &path, "--json"]).stdout).unwrap();
    assert_eq!(said["missing"][0]["effect"], "unknown", "{}", said["missing"]);
    let law = &said["proposal"];
    assert!(law["text"].to_string().contains("in proportion to the signal above one level"), "{law}");
    let [k, std_err] = ["value", "std_err"].map(|of| law["parameters"]["k"][of].as_f64().unwrap());
    assert!((-16.5 - 3.0 * std_err..-15.0 + 3.0 * std_err).contains(&k), "{k} +- {std_err}");
}

/// Two darks of five that were warmer, with twenty times the dark charge: named together and left out.
#[test]
fn two_darks_with_more_charge_are_left_out() {
    let (bench, mut hot) = (Bench::new(), Hot::new(303));
    let mut draw = |light_e: f64, exposure_s: f64| {
        let warm_e = if light_e == 0.0 && exposure_s > 0.035 { 4000.0 * exposure_s } else { 0.0 };
        hot.frame(light_e + warm_e, exposure_s)
    };
    let path = campaign(&bench, &[10.0, 20.0, 30.0, 40.0, 50.0], &FLATS_MS, &mut draw);
    let said: Value = serde_json::from_slice(&radcam(&["noise", &path, "--json"]).stdout).unwrap();
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert_eq!(faults[0]["sets"].as_array().unwrap().len(), 2, "{faults:?}");
    assert!(faults[0]["text"].as_str().unwrap().contains("the sensor was warmer"), "{faults:?}");
}

/// One of five flats with a black level 60 DN higher: its noise is that of its light.
#[test]
fn a_black_level_of_one_of_five_flats_is_named() {
    let (bench, mut hot) = (Bench::new(), Hot::new(304));
    let mut draw = |light_e: f64, exposure_s: f64| {
        let black = if light_e == 2000.0 { 60 } else { 0 };
        hot.frame(light_e, exposure_s).mapv(|v| v + black)
    };
    let path = campaign(&bench, &[10.0, 20.0, 30.0], &FLATS_MS, &mut draw);
    let said: Value = serde_json::from_slice(&radcam(&["noise", &path, "--json"]).stdout).unwrap();
    let faults = said["data_faults"].to_string();
    assert!(faults.contains("higher than in the other sets"), "{faults}");
    let gain = &said["gain_dn_per_e"];
    let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
    assert!((value - GAIN).abs() < 4.0 * error, "{value} +- {error}");
}
