//! Pixels that see no light, darks that had light, flats that tell no gain, darks that are none: frames that
//! do not belong together make no number, or are left out.

use crate::cases_numbers::{Bench, Camera, notes, value, within};
use crate::import_cases;
use crate::support::{expect, radcam, refused, small};
use radcam::dataset::Kind;
use radcam::ndarray::Array2;
use serde_json::Value;

/// Saves frames that were changed by hand.
fn changed(
    bench: &Bench,
    camera: &mut Camera,
    name: &str,
    [light_e, exposure_s]: [f64; 2],
    change: &dyn Fn(&mut Array2<u16>),
) {
    for i in 0..6 {
        let mut frame = camera.draw(light_e, exposure_s);
        change(&mut frame);
        bench.save(&format!("in/{name}_{i}.tif"), &frame);
    }
}

/// Six covered columns, and 40 pixels that always have the largest code: neither makes an effect, nor takes
/// the sets away.
#[test]
fn covered_columns_and_stuck_pixels_take_no_part() {
    let bench = Bench::new();
    let mut camera = Camera::new(71, |_, x| if x < 6 { 0.0 } else { 1.0 });
    let stuck = |frame: &mut Array2<u16>| (0..40).for_each(|k| frame[(3 * k, 20 + 2 * k)] = 4095);
    for ms in [2u32, 16] {
        changed(&bench, &mut camera, &format!("dark_{ms}ms"), [0.0, f64::from(ms) / 1e3], &stuck);
    }
    for ms in [2u32, 4, 6, 8, 10, 12, 14, 16] {
        let s = f64::from(ms) / 1e3;
        changed(&bench, &mut camera, &format!("flat_{ms}ms"), [400.0 * f64::from(ms), s], &stuck);
    }
    bench.import();
    let json = bench.json("diagnose");
    assert!(json["missing"].as_array().unwrap().is_empty(), "{json:#}");
    within(&json, "gain_dn_per_e", 0.5, 0.01);
    let noise = bench.json("noise");
    within(&noise, "gain_dn_per_e", 0.5, 0.01);
    assert!(notes(&noise).contains("blind"), "{}", notes(&noise));
}

/// The longer darks had a twentieth of the light: its pattern is in them. They are left out, and the others
/// tell the read noise.
#[test]
fn darks_that_had_light_are_no_darks() {
    let bench = Bench::new();
    let mut camera = Camera::new(72, |_, _| 1.0);
    bench.dark(&mut camera, 8, 2);
    bench.set(&mut camera, "dark_16ms", 8, 0.05 * 6400.0, 0.016);
    [2, 4, 8, 12, 16].iter().for_each(|ms| bench.flat(&mut camera, 8, *ms, 400.0));
    bench.import();
    let noise = bench.json("noise");
    let faults = noise["data_faults"].to_string();
    assert!(faults.contains("the response of the pixels to light is in them"), "{faults}");
    let (read_e, error) = value(&noise, "read_noise_e");
    assert!((read_e - 4.0).abs() < 4.0 * error.max(0.02), "{read_e} +- {error}");
}

/// All flats are saturated: the darks have a noise in DN, and nothing has a gain.
#[test]
fn saturated_flats_tell_no_gain() {
    let bench = Bench::new();
    let mut camera = Camera::new(73, |_, _| 1.0);
    [2, 16].iter().for_each(|ms| bench.dark(&mut camera, 8, *ms));
    [4, 8].iter().for_each(|ms| bench.flat(&mut camera, 8, *ms, 10_000.0));
    bench.import();
    let json = bench.json("diagnose");
    assert!(json["gain_dn_per_e"].is_null() && json["read_noise_e"].is_null(), "{json:#}");
    let (noise_dn, error) = value(&json, "read_noise_dn");
    assert!((noise_dn - 2.0).abs() < 4.0 * error && error < 0.02, "{noise_dn} +- {error}");
    let sentence = json["verdict"]["sentence"].as_str().unwrap();
    assert!(sentence.contains("gain is not determined"), "{sentence}");
}

/// Flats in a folder `Black camera` are darks by their name, and not by their level: that is asked.
#[test]
fn a_dark_that_is_bright_is_asked() {
    let bench = import_cases::Bench::new();
    let mut camera = import_cases::Camera::new(74);
    for i in 0..2 {
        bench.tiff(&format!("in/Black camera/capped_10ms_{i}.tif"), &camera.frame(0.0, 0.01));
        bench.tiff(&format!("in/Black camera/lamp_10ms_{i}.tif"), &camera.frame(4000.0, 0.01));
    }
    let said = bench.refused("in");
    assert!(said.contains("a name says dark, and the level is 2"), "{said}");
    // Hot darks of a longer exposure are darks.
    for i in 0..2 {
        bench.tiff(&format!("hot/dark_10ms_{i}.tif"), &camera.frame(0.0, 0.01));
        bench.tiff(&format!("hot/dark_90s_{i}.tif"), &camera.frame(0.0, 90.0));
    }
    assert!(import_cases::sets(&bench.import("hot", &[]).0).iter().all(|s| s.0 == Kind::Dark));
}

/// A camera as sold, pairs of frames at each level and one longer set, as EMVA 1288 has them. Noisy pixels of
/// pairs are those of the long set, and no cosmic rays: in eight campaigns the levels lie on a line.
#[test]
fn pairs_and_long_sets_have_one_noise() {
    let set = |kind: &str, frames: u32, ms: u32| {
        let light = u8::from(kind == "flat");
        format!(
            "[[set]]\nkind = \"{kind}\"\nframes = {frames}\nexposure_s = {}\nillumination = {light}\n",
            f64::from(ms) / 1e3
        )
    };
    let pairs = (1..13).map(|k| set("flat", 2, k) + &set("dark", 2, k));
    let plan: String = std::iter::once("format = \"radcam-plan/1\"\n".into())
        .chain(pairs)
        .chain([set("flat", 16, 6), set("dark", 16, 6)])
        .collect();
    for seed in 0..8 {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
        let mut model = small("cmos12", 160, 120);
        model.base.seed = 300 + seed;
        model.base.read_noise_e = 6.0;
        model.base.read_noise_log_spread = 0.15;
        model.base.noisy_pixel_fraction = 0.003;
        model.base.noisy_pixel_factor = 6.0;
        model.bench.photon_flux_per_s =
            0.8 * 4095.0 / model.base.gain_dn_per_e / 0.012 / model.base.quantum_efficiency;
        std::fs::write(at("m.toml"), model.to_toml().unwrap()).unwrap();
        std::fs::write(at("p.toml"), &plan).unwrap();
        expect(0, &["simulate", &at("m.toml"), "--plan", &at("p.toml"), "-o", &at("c")]);
        let json: Value = serde_json::from_slice(&radcam(&["noise", &at("c"), "--json"]).stdout).unwrap();
        assert!(json["q"].as_f64().unwrap() > 1e-3, "{seed}: {}", json["q"]);
    }
}

/// Noise that jumps half way up, as where a sensor switches its gain, in a camera whose pixels differ: their
/// spread is the same in every set, and excuses nothing.
#[test]
fn a_jump_of_the_noise_is_no_agreement() {
    let bench = Bench::new();
    let mut camera = Camera::new(75, |_, _| 1.0);
    // A fortieth of the pixels has ten times the noise.
    let mut state = 9u64;
    let mut uniform = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut noisy = |frame: &mut Array2<u16>, more_dn: f64| {
        for ((y, x), v) in frame.indexed_iter_mut() {
            let own = if (y * 128 + x) % 40 == 7 { 20.0 } else { more_dn };
            let normal = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
            *v = (f64::from(*v) + own * normal).round().clamp(0.0, 4095.0) as u16;
        }
    };
    let levels = [(0.0, 2u32), (0.0, 16)].into_iter().chain((1..9).map(|k| (800.0 * f64::from(k), 2 * k)));
    for (light_e, ms) in levels {
        let kind = if light_e > 0.0 { "flat" } else { "dark" };
        for i in 0..5 {
            let mut frame = camera.draw(light_e, f64::from(ms) / 1e3);
            noisy(&mut frame, if light_e > 3600.0 { 7.0 } else { 0.0 });
            bench.save(&format!("in/{kind}_{ms}ms_{i}.tif"), &frame);
        }
    }
    bench.import();
    let json = bench.json("diagnose");
    assert!(!json["consistent"].as_bool().unwrap(), "{json:#}");
}

/// A sound NumPy array where one frame is asked for: what it is, and where it serves.
#[test]
fn a_numpy_array_is_named_where_it_does_not_serve() {
    let bench = Bench::new();
    let mut camera = Camera::new(76, |_, _| 1.0);
    let cal = bench.at("cal.tiff");
    [10, 100].iter().for_each(|ms| bench.dark(&mut camera, 8, *ms));
    [10, 20, 30, 40].iter().for_each(|ms| bench.flat(&mut camera, 8, *ms, 150.0));
    let d = bench.import();
    expect(0, &["calibrate", &d, "--estimator", "smooth", "-o", &cal]);
    std::fs::write(bench.at("a.npy"), b"\x93NUMPY\x01\x00").unwrap();
    let said = refused(&["correct", &cal, &bench.at("a.npy"), "-o", &bench.at("b.tiff")]);
    assert!(said.contains("a NumPy array, which `radcam import` takes"), "{said}");
}
