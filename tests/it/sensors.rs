//! What sensors as they are sold do at the ends of their range, and what one level of light cannot tell.

use crate::effects::{campaign, with};
use crate::support::{expect, radcam, shared, small};
use serde_json::Value;
use std::path::Path;

fn diagnosed(path: &Path) -> Value {
    serde_json::from_slice(&radcam(&["diagnose", path.to_str().unwrap(), "--json"]).stdout).unwrap()
}

fn first(json: &Value) -> &str {
    json["missing"][0]["effect"].as_str().unwrap_or_default()
}

/// The last fifth of a well fills ever more slowly: a full well, whose size and softness come back within
/// four of their errors, and no nonlinearity. A bend of the amplifier is one still.
#[test]
fn a_soft_well_is_a_full_well() {
    let dir = tempfile::tempdir().unwrap();
    let model = small("cmos12", 128, 96);
    let truth = [0.8 * f64::from(model.full_scale_dn()) / model.base.gain_dn_per_e, 1.0, 0.2];
    campaign(with(model.clone(), "full-well-saturation", &truth), &dir.path().join("soft"));
    let json = diagnosed(&dir.path().join("soft"));
    assert_eq!(first(&json), "full-well-saturation", "{json:#}");
    for (name, truth) in [("full_well_e", truth[0]), ("softness", truth[2])] {
        let of = |part: &str| json["missing"][0]["parameters"][name][part].as_f64().unwrap();
        assert!((of("value") - truth).abs() < 4.0 * of("std_err"), "{name}: {json:#}");
    }
    campaign(with(model, "nonlinearity", &[0.0, 0.03]), &dir.path().join("bent"));
    assert_eq!(first(&diagnosed(&dir.path().join("bent"))), "nonlinearity");
}

/// A black level of 1.5 deviations of the noise: 2 % of the darks' samples are cut off at code 0, and that is
/// said. At eight deviations nothing is missing. Four frames a dark, where a lower read noise would fit as
/// well.
#[test]
fn darks_that_reach_code_0_are_said() {
    for (deviations, named) in [(1.5, "black-clipping"), (8.0, "")] {
        let dir = tempfile::tempdir().unwrap();
        let mut model = small("cmos12", 128, 96);
        model.base.black_level_dn = deviations * model.constant_noise_var_dn2(0.0).sqrt();
        campaign(model, &dir.path().join("c"));
        let json = diagnosed(&dir.path().join("c"));
        assert_eq!(first(&json), named, "{deviations}: {json:#}");
    }
    let dir = tempfile::tempdir().unwrap();
    let mut model = small("cmos12", 128, 96);
    model.base.read_noise_e = 2.3;
    model.base.black_level_dn = 1.6;
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    std::fs::write(at("m.toml"), model.to_toml().unwrap()).unwrap();
    expect(0, &["simulate", &at("m.toml"), "--plan", "quick", "-o", &at("c")]);
    assert_eq!(first(&diagnosed(&dir.path().join("c"))), "black-clipping");
}

/// One flat level of a colour camera and darks whose level falls while their noise grows (ASI178MC,
/// shared/real): no curve can be drawn through one level, and none is named; row noise is what numpy finds
/// within three errors, the clamp and the unequal flats are in the list.
#[test]
fn one_level_of_light_draws_no_curve() {
    let Some(root) = shared("real/asi178") else { return };
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    expect(0, &["import", root.to_str().unwrap(), "--plane", "0,0", "-o", &at("c"), "--yes"]);
    let json = diagnosed(&dir.path().join("c"));
    let names: Vec<&str> =
        json["missing"].as_array().unwrap().iter().filter_map(|m| m["effect"].as_str()).collect();
    assert!(!names.contains(&"nonlinearity"), "{names:?}");
    for name in ["row-noise", "illumination-flicker", "black-level-clamp"] {
        assert!(names.contains(&name), "{name}: {names:?}");
    }
    let row = json["missing"].as_array().unwrap().iter().find(|m| m["effect"] == "row-noise").unwrap();
    let of = |part: &str| row["parameters"]["e"][part].as_f64().unwrap();
    let (e, error) = (of("value"), of("std_err"));
    assert!((e - 0.52).abs() < 3.0 * error && error < 0.1, "{e} +- {error}");
    // The first flat is 3 % darker: no share of the charge that stays makes the gain another one.
    let gain = json["gain_dn_per_e"]["value"].as_f64().unwrap();
    assert!((gain / 1.056 - 1.0).abs() < 0.02, "gain {gain}");
}

/// Interference that goes on while rows are blanked, and interference in step with the rows: both are named,
/// with frequency, amplitude and phase between rows within three standard errors.
#[test]
fn interference_is_found_with_its_line_blanking() {
    for (blanking, shape) in [(0.31, 0.0), (0.0, 1.0)] {
        let dir = tempfile::tempdir().unwrap();
        let model = small("cmos12", 128, 96);
        let amplitude_dn = 0.5 * model.constant_noise_var_dn2(0.0).sqrt();
        let drawn = [amplitude_dn, 0.0973, blanking, shape];
        campaign(with(model, "periodic-interference", &drawn), &dir.path().join("c"));
        let json = diagnosed(&dir.path().join("c"));
        assert_eq!(first(&json), "periodic-interference", "{json:#}");
        let found = &json["missing"][0]["parameters"];
        let names = ["amplitude_dn", "cycles_per_px", "blanking_cycles"];
        for (name, drawn) in names.iter().zip(drawn).take(if shape > 0.5 { 2 } else { 3 }) {
            let of = |part: &str| found[name][part].as_f64().unwrap();
            let off = (of("value") - drawn).abs();
            assert!(off < 3.0 * of("std_err") + 0.02 * drawn, "{name}: {drawn}, found {}", found[name]);
        }
    }
}

/// Codes in steps of eight noises: darks show one code, and the step is named all the same.
#[test]
fn steps_wider_than_the_noise_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let mut model = small("cmos12", 128, 96);
    model.base.black_level_dn = 104.0;
    let step = (8.0 * model.constant_noise_var_dn2(0.0).sqrt()).round();
    campaign(with(model, "coarse-quantization", &[step, 0.0]), &dir.path().join("c"));
    let json = diagnosed(&dir.path().join("c"));
    assert_eq!(first(&json), "coarse-quantization", "{json:#}");
    assert_eq!(json["missing"][0]["parameters"]["step_dn"]["value"].as_f64().unwrap(), step);
}

/// Eight levels of light at one exposure, each with a dark.
fn one_exposure(frames: u32) -> String {
    let set = |kind: &str, light: f64| {
        format!("[[set]]\nkind = \"{kind}\"\nframes = {frames}\nexposure_s = 0.01\nillumination = {light}\n")
    };
    let levels = (1..=8).map(|k| set("dark", 0.0) + &set("flat", f64::from(k) / 8.0));
    std::iter::once("format = \"radcam-plan/1\"\n".into()).chain(levels).collect()
}

/// Simulates a model under a plan and diagnoses it.
fn simulated(model: &radcam_sim::Model, plan: &str) -> Value {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    std::fs::write(at("m.toml"), model.to_toml().unwrap()).unwrap();
    std::fs::write(at("p.toml"), plan).unwrap();
    expect(0, &["simulate", &at("m.toml"), "--plan", &at("p.toml"), "-o", &at("c")]);
    diagnosed(&dir.path().join("c"))
}

/// Flats of one exposure show what is left of a lamp's ripple: bands are named, the ripple's frequency and
/// strength are not, and the verdict says so.
#[test]
fn bands_at_one_exposure_are_named_without_a_strength() {
    let mut model = small("cmos12", 128, 96);
    model.bench.photon_flux_per_s =
        0.8 * 4095.0 / model.base.gain_dn_per_e / 0.01 / model.base.quantum_efficiency;
    // Of 6 % at 1650 Hz sinc(16.5) leaves 0.12 %.
    let model = with(model, "light-banding", &[0.0, 0.06, 0.04, 1650.0, 0.9]);
    let json = simulated(&model, &one_exposure(6));
    assert_eq!(first(&json), "light-banding", "{json:#}");
    let missing = &json["missing"][0];
    let of = |name: &str, part: &str| missing["parameters"][name][part].as_f64().unwrap();
    assert!((of("cycles_per_row", "value") - 0.04).abs() < 3.0 * of("cycles_per_row", "std_err"));
    assert!((of("rel", "value") - 0.06).abs() < of("rel", "std_err"), "{missing:#}");
    let text = missing["evidence"].to_string();
    assert!(text.contains("at 10.00 ms bands are 0.1"), "{text}");
    assert!(json["verdict"]["sentence"].as_str().unwrap().contains("does not determine"), "{json:#}");
}

/// A black level that scatters three times as much as noise lets the means of frames scatter, in pairs of
/// frames: known to a third of itself, and there for certain.
#[test]
fn a_scatter_that_few_frames_tell_is_named() {
    let mut model = small("cmos12", 128, 96);
    let frame_mean_dn = (model.constant_noise_var_dn2(0.0) / (128.0 * 96.0)).sqrt();
    model.base.seed = 5;
    let json = simulated(&with(model, "offset-noise", &[3.0 * frame_mean_dn]), &one_exposure(2));
    assert_eq!(first(&json), "offset-noise", "{json:#}");
}
