//! Slips of one set that are small, or that half of its frames have.

use crate::data_faults::BLACK_DN;
use crate::far_slips::{is_named, sweep};
use crate::import_cases::{Bench, Camera};
use crate::rewritten::{Campaign, set_of_plan};
use crate::support::{expect, radcam, small_sensor};
use radcam_sim::rng::{PixelRng, Stream};
use serde_json::Value;

const SHARES: [f64; 8] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.75, 0.9];

/// A black level off by a few codes, where all other flats lie on a line: 60 of 700 codes are told by the
/// noise, 20 of 1600 are a label or a black level, 8 of 1600 are less than a label is off.
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

/// An export with automatic contrast writes each set, or each frame, in steps of its own: no verb computes
/// with them.
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

/// Codes eight apart that hide the noise of the darks, and of dim flats: rounding is no slip, and ends no
/// verb.
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

/// Scales the light of a frame; codes at full scale stay.
fn lit_by(campaign: &Campaign, row: usize, factor: f64) {
    let other = |v: u16| (BLACK_DN + factor * (f64::from(v) - BLACK_DN)).round().min(4095.0) as u16;
    campaign.put(row, &campaign.frame(row).mapv(|v| if v == 4095 { v } else { other(v) }));
}

/// Draws a standard normal number.
fn drawn(seed: u32, k: usize) -> f64 {
    PixelRng::new(seed.into(), Stream::Effect, k as u64, 0, 0).normal()
}

/// Two successive sets of one setting differ by 3 % in light, under a lamp whose settings scatter by 0.1 %:
/// both are left out, or the one off the line of the others. No slip is a lamp that falls by 3 % over a sweep
/// in order, with the first setting again at its end.
#[test]
fn repeats_of_unequal_light_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let plan = dir.path().join("plan.toml");
    let set = |kind: &str, share: f64| set_of_plan(kind, 5, share, f64::from(u8::from(kind == "flat")));
    let shares = |drifts: bool| -> Vec<f64> {
        let levels = [0.046, 0.068, 0.1, 0.147, 0.216, 0.316, 0.464, 0.681, 0.95];
        let repeat = if drifts { levels[0] } else { levels[3] };
        let place = if drifts { levels.len() } else { 4 };
        [&levels[..place], &[repeat], &levels[place..]].concat()
    };
    for (seed, drifts) in [(246, false), (247, false), (248, true), (251, true), (252, true), (253, true)] {
        let flats: Vec<String> = shares(drifts).into_iter().map(|share| set("flat", share)).collect();
        let text = set("dark", 0.046) + &set("dark", 0.95) + &flats.concat();
        std::fs::write(&plan, format!("format = \"radcam-plan/1\"\n{text}")).unwrap();
        let campaign = Campaign::new("cmos12", plan.to_str().unwrap(), seed);
        let flats = campaign.sets("flat", 2);
        let last = (flats.len() - 1) as f64;
        for (k, &flat) in flats.iter().enumerate() {
            let share = if drifts { k as f64 / last } else { f64::from(u8::from(k == 4)) };
            let factor = 1.0 - 0.03 * share + 0.001 * drawn(seed, k);
            campaign.of(flat).into_iter().for_each(|row| lit_by(&campaign, row, factor));
        }
        let faults = campaign.said("noise")["data_faults"].clone();
        if drifts {
            assert_eq!(faults.to_string(), "[]", "{seed}");
        } else {
            let sets = faults[0]["sets"].as_array().unwrap();
            assert!(sets.contains(&flats[4].into()) && faults[0]["left_out"] == true, "{seed}: {faults}");
            assert!(faults.as_array().unwrap().len() == 1, "{seed}: {faults}");
        }
    }
}

/// Four pairs with 1.6 % less light in the first frame, under 0.2 % flicker: named together, since each is
/// too little to be told alone.
#[test]
fn pairs_that_differ_alike_are_named() {
    for (seed, less) in [(249, 0.984), (250, 1.0)] {
        let campaign = Campaign::new("cmos12", "emva1288", seed);
        let pairs = campaign.sets("flat", 2);
        let pairs: Vec<u32> = pairs.into_iter().filter(|f| campaign.of(*f).len() == 2).collect();
        let unequal = &pairs[14..18];
        for flat in campaign.sets("flat", 2) {
            for (i, row) in campaign.of(flat).into_iter().enumerate() {
                let own = if i == 0 && unequal.contains(&flat) { less } else { 1.0 };
                lit_by(&campaign, row, own * (1.0 + 0.002 * drawn(seed, row)));
            }
        }
        let faults = campaign.said("noise")["data_faults"].clone();
        assert!(faults[0]["kind"].is_null() || faults[0]["kind"] == "unequal-light", "{seed}: {faults}");
        let sets = faults[0]["sets"]
            .as_array()
            .map_or(Vec::new(), |all| all.iter().filter_map(Value::as_u64).collect());
        let expected = if less < 1.0 { unequal.iter().map(|p| u64::from(*p)).collect() } else { Vec::new() };
        assert_eq!(sets, expected, "{seed}: {faults}");
    }
}
