//! Slips of one set that are small, or that half of its frames have.

use crate::data_faults::BLACK_DN;
use crate::far_slips::{is_named, sweep};
use crate::import_cases::{Bench, Camera};
use crate::rewritten::Campaign;
use crate::support::{expect, radcam, small_sensor};

const SHARES: [f64; 8] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.75, 0.9];

/// A black level off by a few codes, where all other flats lie on a line: 60 of 700 codes are told by the noise,
/// 20 of 1600 are a label or a black level, 8 of 1600 are less than a label is off.
#[test]
fn a_level_off_by_little_is_named() {
    for (place, dn, kind, words) in [
        (1, 60, "other-settings", "black level 59.9"),
        (4, 20, "setting-label", "or it has a black level"),
        (4, 8, "unequal-light", "its light or its black level was another"),
    ] {
        let campaign = sweep(&SHARES, &SHARES, 5, 231);
        let set = campaign.sets("flat", 2)[place];
        for row in campaign.of(set) {
            campaign.put(row, &campaign.frame(row).mapv(|v| v + dn));
        }
        is_named(&campaign, kind, &[set], words);
    }
}

/// Codes of ten bits among those of twelve.
#[test]
fn fewer_bits_of_one_set_are_named() {
    let campaign = sweep(&SHARES, &SHARES, 4, 232);
    let set = campaign.sets("flat", 2)[5];
    for row in campaign.of(set) {
        campaign.put(row, &campaign.frame(row).mapv(|v| v / 4));
    }
    is_named(&campaign, "other-settings", &[set], "2 bits less than the other sets");
}

/// The gain falls so that the brightest two have the level of the third.
#[test]
fn an_automatic_gain_in_the_last_sets_is_named() {
    let campaign = sweep(&SHARES, &SHARES, 4, 233);
    let flats = campaign.sets("flat", 2)[6..].to_vec();
    for (set, share) in flats.iter().zip(&SHARES[6..]) {
        for row in campaign.of(*set) {
            campaign.scale(row, 0.66 / share, BLACK_DN);
        }
    }
    is_named(&campaign, "other-settings", &flats, "an automatic gain was on");
}

/// Half of the frames have other light: those of the setting stay. Where neither half has that of the setting
/// the set is left out, and a level of each second frame in many sets is what the lamp does.
#[test]
fn frames_of_two_levels_are_parted() {
    let other = |factors: [f64; 2], sets: &[usize], seed: u32| {
        let campaign = sweep(&SHARES, &SHARES, 6, seed);
        let flats = campaign.sets("flat", 2);
        let changed: Vec<u32> = sets.iter().map(|k| flats[*k]).collect();
        for (k, row) in changed.iter().flat_map(|set| campaign.of(*set)).enumerate() {
            campaign.scale(row, factors[k % 2], BLACK_DN);
        }
        (campaign, changed)
    };
    let (campaign, set) = other([1.0, 0.7], &[4], 234);
    is_named(&campaign, "odd-frame", &set, "30 % less signal; the others have the");
    let frames = campaign.said("noise")["data_faults"][0]["frames"].as_array().unwrap().len();
    assert_eq!(frames, 3);
    let (campaign, set) = other([1.15, 0.85], &[4], 235);
    is_named(&campaign, "odd-frame", &set, "neither is the");
    let (campaign, _) = other([1.0, 0.97], &[1, 2, 3, 4, 5], 236);
    let said = campaign.said("noise");
    assert!(!said["data_faults"].to_string().contains("of its frames"), "{said}");
}

/// An export with automatic contrast writes each set, or each frame, in steps of its own: no verb computes with
/// them.
#[test]
fn contrast_stretched_for_each_set_is_refused() {
    [false, true].into_iter().for_each(stretched);
}

fn stretched(each_frame: bool) {
    let bench = Bench::new();
    let mut camera = Camera::new(91);
    let sets = [("dark_5ms", 0.0, 0.005), ("dark_50ms", 0.0, 0.05)].into_iter();
    let flats = [("flat_5ms", 500.0, 0.005), ("flat_15ms", 1500.0, 0.015), ("flat_50ms", 5000.0, 0.05)];
    for (name, light_e, exposure_s) in sets.chain(flats) {
        let frames: Vec<_> = (0..4).map(|_| camera.frame(light_e, exposure_s)).collect();
        for (i, frame) in frames.iter().enumerate() {
            let all = || frames.iter().filter(|f| !each_frame || *f == frame).flatten().copied();
            let (low, high) = (f64::from(all().min().unwrap()), f64::from(all().max().unwrap()));
            let stretched = frame.mapv(|v| ((f64::from(v) - low) / (high - low) * 65535.0).round() as u16);
            bench.tiff(&format!("auto/{name}_{i}.tif"), &stretched);
        }
    }
    let dataset = bench.import("auto", &["--pattern", "mono"]).0;
    let path = dataset.root().to_str().unwrap().to_owned();
    for verb in ["noise", "diagnose", "emva"] {
        let output = radcam(&[verb, &path]);
        let said = String::from_utf8_lossy(&output.stderr).replace('\n', " ");
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains("was stretched by itself"), "{said}");
    }
}

/// Flats that were averaged over eight frames, and darks that were not: no gain is told.
#[test]
fn averaged_flats_beside_single_darks_are_refused() {
    let shares = [0.01, 0.03, 0.06, 0.1, 0.2, 0.4, 0.6, 0.9];
    let campaign = sweep(&shares, &shares, 4, 237);
    assert_eq!(campaign.said("noise")["data_faults"], serde_json::json!([]));
    for set in campaign.sets("flat", 2) {
        let rows = campaign.of(set);
        let frames: Vec<_> = rows.iter().map(|row| campaign.frame(*row).mapv(f64::from)).collect();
        let mean = frames.iter().fold(frames[0].clone() * 0.0, |sum, f| sum + f) / frames.len() as f64;
        for (row, frame) in rows.into_iter().zip(&frames) {
            let averaged = &mean + (frame - &mean) / 8f64.sqrt();
            campaign.put(row, &averaged.mapv(|v| v.round() as u16));
        }
    }
    for verb in ["noise", "emva"] {
        let output = radcam(&[verb, &campaign.path()]);
        let said = String::from_utf8_lossy(&output.stderr).replace('\n', " ");
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains("all flats were averaged before they were saved"), "{said}");
    }
}

/// Codes eight apart that hide the noise of the darks, and of dim flats: rounding is no slip, and ends no verb.
#[test]
fn noise_that_rounding_hides_is_no_slip() {
    let folder = tempfile::tempdir().unwrap();
    let model = small_sensor(folder.path(), "cmos12", 160, 128);
    let text =
        std::fs::read_to_string(&model).unwrap().replace("gain_dn_per_e = 0.38", "gain_dn_per_e = 0.038");
    assert!(text.contains("gain_dn_per_e = 0.038"), "{text}");
    std::fs::write(&model, text).unwrap();
    let model = model.to_str().unwrap();
    expect(0, &["model", "add", model, "coarse-quantization", "step_dn=8"]);
    for seed in [2, 4] {
        let said = Campaign::new(model, "standard", seed).said("diagnose");
        assert_eq!(said["data_faults"], serde_json::json!([]), "{seed}");
        assert_eq!(said["missing"][0]["effect"], "coarse-quantization", "{seed}: {}", said["missing"]);
    }
}
