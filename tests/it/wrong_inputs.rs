//! What a new user gives by mistake: frames of other settings, copies, files in the wrong place. No wrong
//! number comes with exit code 0.

use crate::frame_headers::{Drawn, Folder, fits};
use crate::support::{expect, radcam, refused};
use serde_json::Value;
use std::fs;

/// A camera, its loose frames in `in`, the dataset `d` and `cal.tiff`; darks of 10 ms and 0.5 s where there
/// are darks.
fn calibrated(seed: u64, darks: bool) -> (Folder, Drawn) {
    let (folder, mut camera) = (Folder::new(), Drawn::new(seed, 200.0));
    fs::create_dir(folder.path("in")).unwrap();
    let mut take = |kind: &str, exposure_s: f64, light_e: f64| {
        for i in 0..6 {
            let name = format!("in/{kind}_{exposure_s}s_{i}.fits");
            fits(&folder.path(&name), &[], &camera.frame(light_e, exposure_s));
        }
    };
    if darks {
        take("dark", 0.01, 0.0);
        take("dark", 0.5, 0.0);
    }
    for (exposure_s, light_e) in [(0.01, 1500.0), (0.02, 3000.0), (0.03, 4500.0), (0.04, 6000.0)] {
        take("flat", exposure_s, light_e);
    }
    expect(0, &["import", &folder.text("in"), "-o", &folder.text("d"), "--yes"]);
    if darks {
        expect(0, &["calibrate", &folder.text("d"), "--estimator", "smooth", "-o", &folder.text("cal.tiff")]);
    }
    (folder, camera)
}

/// Frames that a calibration cannot hold for are refused, and what makes corrected values wrong in part is
/// said.
#[test]
fn frames_of_another_exposure_level_or_range_are_told() {
    let (folder, mut camera) = calibrated(41, true);
    let refuse = |name: &str, parts: &[&str]| {
        let out = folder.text("no.tiff");
        let said = refused(&["correct", &folder.text("cal.tiff"), &folder.text(name), "-o", &out]);
        assert!(parts.iter().all(|part| said.contains(part)), "{name}: {said}");
        assert!(!folder.path("no.tiff").exists());
    };
    // A unit that was mistaken: the dark charge of 500 s fills the range.
    fits(&folder.path("shot_500s.fits"), &[], &camera.frame(2000.0, 0.5));
    refuse("shot_500s.fits", &["at 500 s the dark reference is", "4095 DN", "in seconds?"]);
    // Far from the darks the dark reference is known less well than the frame's own noise.
    fits(&folder.path("far_8s.fits"), &[], &camera.frame(2000.0, 8.0));
    let (_, said) = folder.correct("far_8s.fits", &[]);
    assert!(said.contains("at 8 s the dark reference of a pixel is known to"), "{said}");
    // Another black level.
    camera.black_dn = 40.0;
    fits(&folder.path("low_0.02s.fits"), &[], &camera.frame(0.0, 0.02));
    refuse(
        "low_0.02s.fits",
        &["low_0.02s.fits", "DN darker than the dark reference at 0.02 s", "black level", "--force"],
    );
    folder.correct("low_0.02s.fits", &["--force"]);
    camera.black_dn = 100.0;
    // A fifth of the pixels saturated.
    let lit = camera.frame_of(6000.0, 0.02, |_, x| (if x % 5 == 0 { 3.0 } else { 1.0 }, 1.0));
    fits(&folder.path("lit_0.02s.fits"), &[], &lit);
    let (_, said) = folder.correct("lit_0.02s.fits", &[]);
    assert!(said.contains("20 % of the pixels are at full scale, 4095 DN"), "{said}");
    let scene = |more: &[&str]| refused(&[&["scene", &folder.text("cal.tiff")][..], more].concat());
    assert!(
        scene(&[&folder.text("lit_0.02s.fits")]).contains("20 % of the region's pixels are at full scale")
    );
    // Twelve bits stretched to sixteen.
    let stretched = camera.frame(2000.0, 0.02).mapv(|v| (u32::from(v) * 65_535 / 4095) as u16);
    fits(&folder.path("stretched_0.02s.fits"), &[], &stretched);
    refuse("stretched_0.02s.fits", &["holds", "the largest code of the calibration's 12 bits is 4095 DN"]);
}

/// What was corrected is not corrected again; codes that cannot hold the values are told; outputs go where
/// they were meant.
#[test]
fn corrected_frames_and_outputs_are_what_they_seem() {
    let (folder, mut camera) = calibrated(42, true);
    fits(&folder.path("shot_0.02s.fits"), &[], &camera.frame(2000.0, 0.02));
    fits(&folder.path("dark_0.02s.fits"), &[], &camera.frame(0.0, 0.02));
    let (cal, shot, dark) =
        (folder.text("cal.tiff"), folder.text("shot_0.02s.fits"), folder.text("dark_0.02s.fits"));
    let codes = folder.text("codes_0.02s.tiff");
    let run = |input: &str, codes: &str, output: &str| {
        let run = radcam(&["correct", &cal, input, "-o", output, "--codes", codes, "--overwrite"]);
        assert_eq!(run.status.code(), Some(0), "{run:?}");
        String::from_utf8_lossy(&run.stderr).into_owned()
    };
    assert_eq!(run(&shot, "1,200", &codes), "");
    let again = folder.text("again.tiff");
    for verb in [&["correct", &cal, &codes, "-o", &again][..], &["scene", &cal, &codes]] {
        let said = refused(verb);
        assert!(said.contains("was corrected already") && said.contains("raw"), "{said}");
    }
    let said = run(&dark, "1,0", &codes);
    assert!(
        said.contains("of the corrected pixels are cut off at code 0") && said.contains("OFFSET"),
        "{said}"
    );
    let said = run(&shot, "100,200", &codes);
    assert!(said.contains("are cut off at code 65535") && said.contains("SCALE"), "{said}");
    for (inputs, output, part) in [
        (&[shot.as_str(), &dark][..], "two.tiff", "several frames go into a folder"),
        (&[folder.text("in").as_str()], "x", "without dataset.toml"),
    ] {
        let said = refused(&[&["correct", &cal][..], inputs, &["-o", &folder.text(output)]].concat());
        assert!(said.contains(part), "{said}");
    }
    fs::create_dir(folder.path("there")).unwrap();
    for output in ["there", "new/"] {
        expect(0, &["correct", &cal, &shot, "-o", &folder.text(output)]);
        assert!(folder.path(output).join("shot_0.02s.tiff").is_file());
    }
    assert!(
        refused(&["correct", &folder.text("d"), &shot, "-o", &again])
            .contains("calibration file comes first")
    );
    for verb in ["correct", "scene"] {
        let more: &[&str] = if verb == "correct" { &["-o", &again] } else { &[] };
        let said = refused(&[&[verb, &folder.text("there/shot_0.02s.tiff"), &shot][..], more].concat());
        assert!(said.contains("shot_0.02s.tiff") && said.contains("calibrat"), "{said}");
    }
    assert!(refused(&["noise", &folder.text("nowhere")]).contains("there is no such file or folder"));
}

/// V_s of a dark, of copies, and of a region with defects.
#[test]
fn scene_variation_is_of_light_and_of_sound_pixels() {
    let (folder, mut camera) = calibrated(43, true);
    let cal = folder.text("cal.tiff");
    for i in 0..2 {
        fits(&folder.path(&format!("shot{i}_0.02s.fits")), &[], &camera.frame(2000.0, 0.02));
    }
    let (one, two) = (folder.text("shot0_0.02s.fits"), folder.text("shot1_0.02s.fits"));
    expect(0, &["scene", &cal, &one, &two]);
    let said = refused(&["scene", &cal, &one, &two, &one]);
    assert!(said.contains("are the same image") && said.contains("once"), "{said}");
    for verb in ["scene", "budget"] {
        let said = refused(&[verb, &cal, &folder.text("in/dark_0.5s_0.fits")]);
        assert!(said.contains("no light, no scene variation"), "{said}");
    }
    // A dead pixel, flagged by the calibration, shows nothing of the surface.
    let value = |cal: &str| -> f64 {
        let said: Value = serde_json::from_str(&expect(0, &["scene", cal, &one, &two, "--json"])).unwrap();
        said["scene_variation"]["value"].as_f64().unwrap()
    };
    let before = value(&cal);
    let mut calibration = radcam::calibrate::file::Calibration::read(cal.as_ref()).unwrap();
    for at in [(10, 10), (30, 41), (50, 7)] {
        calibration.defects[at] = 2;
        calibration.k[at] = 0.01;
    }
    let flagged = folder.path("flagged.tiff");
    calibration.write(&flagged).unwrap();
    let after = value(flagged.to_str().unwrap());
    assert!((after - before).abs() < 2e-6, "{before} {after}");
    calibration.defects.fill(4);
    calibration.write(&flagged).unwrap();
    assert!(refused(&["scene", flagged.to_str().unwrap(), &one]).contains("are defects in the calibration"));
}

/// A recording ends; it is not a camera that is lost and comes back with the same frames.
#[test]
fn a_recording_is_streamed_once() {
    let (folder, _) = calibrated(44, true);
    let replay = format!("replay:{}", folder.text("d"));
    let said = expect(0, &["stream", "--camera", &replay, "--cal", &folder.text("cal.tiff"), "--json"]);
    let summary: Value = serde_json::from_str(&said).unwrap();
    assert_eq!((&summary["corrected"], &summary["reconnections"]), (&6.into(), &0.into()), "{summary}");
    // A camera whose black level is another: 64 DN, and 100 DN in the calibration.
    let sensor = crate::support::small_sensor(folder.0.path(), "cmos12", 80, 64);
    let camera = format!("sim:{}", sensor.display());
    let cal = folder.text("cal.tiff");
    let other = ["stream", "--camera", &camera, "--cal", &cal, "--exposure-s", "0.01", "--frames", "2"];
    let said = refused(&other);
    assert!(said.contains("darker than the dark reference at 0.01 s") && said.contains("--force"), "{said}");
    expect(0, &[&other[..], &["--force"]].concat());
    // Frames that are not there are no stream of none.
    let said =
        refused(&["stream", "--camera", &replay, "--cal", &folder.text("cal.tiff"), "--exposure-s", "0.04"]);
    assert!(said.contains("no further frame at 0.04 s"), "{said}");
}

/// Maps of another camera do not stand in a report, and a monitor says at its first check that the camera is
/// another.
#[test]
fn a_calibration_of_another_camera_is_told() {
    let (folder, _) = calibrated(45, true);
    let (other, _) = calibrated(46, true);
    let path = folder.path("d/dataset.toml");
    let manifest = fs::read_to_string(&path).unwrap();
    fs::write(&path, manifest.replace("serial = \"\"", "serial = \"A1\"")).unwrap();
    let path = other.path("d/dataset.toml");
    fs::write(&path, manifest.replace("serial = \"\"", "serial = \"B2\"")).unwrap();
    let cal = other.text("cal2.tiff");
    expect(0, &["calibrate", &other.text("d"), "--estimator", "smooth", "-o", &cal]);
    let page = folder.text("r.html");
    let said = refused(&["report", &folder.text("d"), "--cal", &cal, "-o", &page]);
    assert!(said.contains("serial is A1, and was B2") && !folder.path("r.html").exists(), "{said}");
    // 100 DN of black level here, 64 DN there, and a calibration that states no camera.
    let sensor = crate::support::small_sensor(folder.0.path(), "cmos12", 80, 64);
    let camera = format!("sim:{}", sensor.display());
    let run = radcam(&["monitor", "--camera", &camera, "--cal", &folder.text("cal.tiff"), "--checks", "1"]);
    let (out, err) = (String::from_utf8_lossy(&run.stdout), String::from_utf8_lossy(&run.stderr));
    assert_eq!(run.status.code(), Some(1), "{out}{err}");
    assert!(out.contains("NOT AS CALIBRATED") && out.contains("the black level is 63.9"), "{out}");
    assert!(err.contains("the calibration does not state"), "{err}");
}

/// An exposure a thousand times too long by its label is a wrong label, and no missing light.
#[test]
fn a_wrong_unit_is_a_wrong_label() {
    let (folder, _) = calibrated(48, true);
    let path = folder.path("d/frames.csv");
    let rows = fs::read_to_string(&path).unwrap();
    fs::write(&path, rows.replace(",0.02,1", ",20,1").replace(",0.02,1.0", ",20,1.0")).unwrap();
    let report: Value = serde_json::from_str(&expect(0, &["noise", &folder.text("d"), "--json"])).unwrap();
    let faults = report["data_faults"].as_array().unwrap();
    assert_eq!(faults.len(), 1, "{faults:#?}");
    assert_eq!((&faults[0]["kind"], &faults[0]["sets"]), (&"setting-label".into(), &serde_json::json!([3])));
    let text = faults[0]["text"].as_str().unwrap();
    assert!(text.contains("20 s at light 1") && text.contains("as of exposure x light 0.0"), "{text}");
    expect(0, &["calibrate", &folder.text("d"), "--estimator", "smooth", "-o", &folder.text("cal2.tiff")]);
}

/// Flats without darks: the dimmest is no dark.
#[test]
fn flats_without_darks_are_flats() {
    let (folder, _) = calibrated(47, false);
    let said = expect(0, &["noise", &folder.text("d"), "--json"]);
    let report: Value = serde_json::from_str(&said).unwrap();
    assert_eq!(report["data_faults"], serde_json::json!([]), "{said}");
    let (value, error) = (
        report["gain_dn_per_e"]["value"].as_f64().unwrap(),
        report["gain_dn_per_e"]["std_err"].as_f64().unwrap(),
    );
    assert!((value - 0.5).abs() < 4.0 * error, "{value} +- {error}");
    let said =
        refused(&["calibrate", &folder.text("d"), "--estimator", "smooth", "-o", &folder.text("c.tiff")]);
    assert!(said.contains("needs dark frames"), "{said}");
}
