//! Slips that many sets share, or that are so far off that no law of the others tells them.

use crate::data_faults::{BLACK_DN, of_flats};
use crate::rewritten::{Campaign, set_of_plan};
use crate::support::{expect, radcam};
use radcam_sim::rng::{PixelRng, Stream};

/// One fault of a kind is said, of these sets, with these words; nothing is missing then, and the gain lies
/// within four standard errors of the camera's.
pub fn is_named(campaign: &Campaign, kind: &str, sets: &[u32], words: &str) {
    let said = campaign.said("diagnose");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!(faults.len(), 1, "{kind} {sets:?}: {faults:?}");
    assert_eq!(
        (&faults[0]["kind"], &faults[0]["sets"]),
        (&kind.into(), &serde_json::json!(sets)),
        "{faults:?}"
    );
    assert!(faults[0]["text"].as_str().unwrap().contains(words), "{faults:?}");
    assert_eq!(said["missing"], serde_json::json!([]), "{kind}");
    let noise = campaign.said("noise");
    for (verb, gain) in [("diagnose", &said["gain_dn_per_e"]), ("noise", &noise["gain_dn_per_e"])] {
        let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
        assert!((value - 0.38).abs() < 4.0 * error, "{kind} {verb}: {value} +- {error}");
    }
}

/// A sweep of exposures by its lights: sets of flats at one light with these shares of the longest exposure.
pub fn sweep(shares: &[f64], stated: &[f64], frames: usize, seed: u32) -> Campaign {
    let mut campaign = of_flats("cmos12", shares, frames, seed);
    let flats = campaign.sets("flat", 2);
    let longest: f64 = campaign.rows[campaign.of(flats[0])[0]][4].parse().unwrap();
    for (set, share) in flats.into_iter().zip(stated) {
        for row in campaign.of(set) {
            (campaign.rows[row][4], campaign.rows[row][5]) = ((longest * share).to_string(), "1".into());
        }
    }
    campaign.save();
    campaign
}

/// `30us` for 30 ms.
#[test]
fn a_label_of_another_order_is_named() {
    let shares = [0.2, 0.35, 0.5, 0.65, 0.8, 0.95];
    let mut stated = shares;
    stated[2] /= 1000.0;
    let campaign = sweep(&shares, &stated, 4, 200);
    is_named(&campaign, "setting-label", &campaign.sets("flat", 2)[2..3], "its level belongs to");
}

/// A camera that does not expose shorter, or longer, than it can: the dark of such an exposure is not what it
/// says either.
#[test]
fn exposures_beyond_a_limit_are_named() {
    let campaign = sweep(&[0.3, 0.3, 0.3, 0.5, 0.7, 0.9], &[0.1, 0.2, 0.3, 0.5, 0.7, 0.9], 4, 201);
    let (darks, flats) = (campaign.sets("dark", 2), campaign.sets("flat", 2));
    is_named(&campaign, "setting-label", &[darks[0], flats[0], flats[1]], "does not expose shorter");
    let campaign = sweep(&[0.15, 0.3, 0.45, 0.6, 0.6, 0.6], &[0.15, 0.3, 0.45, 0.6, 0.75, 0.9], 4, 202);
    let (darks, flats) = (campaign.sets("dark", 2), campaign.sets("flat", 2));
    is_named(&campaign, "setting-label", &[darks[1], flats[4], flats[5]], "does not expose longer");
}

/// Two frames of each set are of the settings before: a pipeline of the driver.
#[test]
fn two_stale_frames_of_each_set_are_named() {
    let campaign = sweep(&[0.2, 0.4, 0.6, 0.8, 0.95], &[0.2, 0.4, 0.6, 0.8, 0.95], 8, 203);
    let flats = campaign.sets("flat", 2);
    let last: Vec<_> = flats.iter().map(|set| campaign.of(*set)[7]).map(|row| campaign.frame(row)).collect();
    let others: Vec<_> =
        flats.iter().map(|set| campaign.of(*set)[6]).map(|row| campaign.frame(row)).collect();
    for (k, set) in flats.iter().enumerate().skip(1) {
        let rows = campaign.of(*set);
        // Frames of the set before that are nowhere else.
        campaign.put(rows[0], &last[k - 1]);
        campaign.put(rows[1], &others[k - 1]);
    }
    let mut short = campaign;
    let gone: Vec<usize> = flats.iter().flat_map(|set| short.of(*set)[6..].to_vec()).collect();
    short.leave_out(&gone);
    // Sets that follow one of the same level cannot show it, and lose their first frame with the others.
    let said = short.said("diagnose");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!((faults.len(), &faults[0]["kind"]), (1, &"stale-frame".into()), "{faults:?}");
    let frames = faults[0]["frames"].to_string();
    for set in &flats[1..] {
        assert!(short.of(*set)[..2].iter().all(|row| frames.contains(&short.rows[*row][0])), "{faults:?}");
    }
    assert_eq!(said["missing"], serde_json::json!([]));
}

/// The first frame of each set was exposed half under the settings before: its noise is not that of lag.
#[test]
fn first_frames_of_both_settings_are_named() {
    let campaign = sweep(&[0.2, 0.4, 0.6, 0.8, 0.95], &[0.2, 0.4, 0.6, 0.8, 0.95], 6, 204);
    let flats = campaign.sets("flat", 2);
    let level = |set: u32| campaign.frame(campaign.of(set)[3]).mapv(f64::from).mean().unwrap() - BLACK_DN;
    let levels: Vec<f64> = flats.iter().map(|set| level(*set)).collect();
    for (k, set) in flats.iter().enumerate().skip(1) {
        let ratio = 0.5 * (levels[k - 1] + levels[k]) / levels[k];
        campaign.scale(campaign.of(*set)[0], ratio, BLACK_DN);
    }
    let said = campaign.said("diagnose");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!((faults.len(), &faults[0]["kind"]), (1, &"stale-frame".into()), "{faults:?}");
    let sets = faults[0]["sets"].to_string();
    assert!(flats[1..].iter().all(|set| sets.contains(&set.to_string())), "{sets}");
    assert_eq!(said["missing"], serde_json::json!([]));
}

/// Every frame was saved twice, and a number was written into a corner of each.
#[test]
fn copies_with_a_stamp_are_named() {
    let campaign = sweep(&[0.2, 0.4, 0.6, 0.8, 0.95], &[0.2, 0.4, 0.6, 0.8, 0.95], 6, 205);
    let mut random = PixelRng::new(205, Stream::Effect, 0, 0, 0);
    let all: Vec<u32> = campaign.sets("dark", 2).into_iter().chain(campaign.sets("flat", 2)).collect();
    for set in &all {
        let rows = campaign.of(*set);
        for pair in rows.chunks(2) {
            for row in pair {
                let mut frame = campaign.frame(pair[0]);
                frame.iter_mut().take(12).for_each(|v| *v = (4000.0 * random.uniform()) as u16);
                campaign.put(*row, &frame);
            }
        }
    }
    is_named(&campaign, "copied-frames", &all, "but for a stamp in a corner");
}

/// Averages of four in a set in the middle and in the brightest: the second has lost the same share.
#[test]
fn averages_in_the_brightest_set_too_are_named() {
    let campaign = sweep(&[0.2, 0.35, 0.5, 0.65, 0.8, 0.95], &[0.2, 0.35, 0.5, 0.65, 0.8, 0.95], 24, 206);
    let flats = campaign.sets("flat", 2);
    let averaged = [flats[2], flats[5]];
    let mut gone = Vec::new();
    for set in &flats {
        let rows = campaign.of(*set);
        for (k, four) in rows.chunks(4).enumerate() {
            if averaged.contains(set) {
                let sum = four.iter().map(|row| campaign.frame(*row).mapv(f64::from)).reduce(|a, b| a + b);
                campaign.put(rows[k], &sum.unwrap().mapv(|v| (v / 4.0).round() as u16));
            }
        }
        gone.extend_from_slice(&rows[6..]);
    }
    let mut campaign = campaign;
    campaign.leave_out(&gone);
    is_named(&campaign, "dependent-frames", &averaged, "averaged or filtered over time");
}

/// Two darks of one setting and one fixed pattern, one of them averaged: which one its noise tells.
#[test]
fn one_of_two_equal_darks_was_averaged() {
    let campaign = Campaign::new("python5000", "standard", 207);
    let darks = campaign.sets("dark", 2);
    let (first, second) = (darks[0], darks[1]);
    let (rows, others) = (campaign.of(first), campaign.of(second));
    let exposure_s = campaign.rows[rows[0]][4].clone();
    let mut campaign = campaign;
    let frames: Vec<_> = rows.iter().map(|row| campaign.frame(*row).mapv(f64::from)).collect();
    let n = others.len().min(rows.len());
    for (k, row) in others.iter().enumerate() {
        // Each is the mean of four frames of the first, and no two are of the same four.
        let sum = (0..4)
            .map(|i| &frames[(k + i * (1 + k / n)) % frames.len()])
            .fold(0.0 * &frames[0], |a, b| a + b);
        campaign.put(*row, &sum.mapv(|v| (v / 4.0).round() as u16));
        campaign.rows[*row][4] = exposure_s.clone();
    }
    campaign.save();
    let faults = campaign.said("noise")["data_faults"].clone();
    let named = faults.as_array().unwrap().iter().find(|f| f["kind"] == "dependent-frames");
    assert!(named.is_some_and(|f| f["sets"].to_string().contains(&second.to_string())), "{faults}");
}

/// Puts the last of four frames of each flat in place of the first of the next one, and keeps so many of
/// each.
fn expose_firsts_as_before(campaign: &mut Campaign, flats: &[u32], keep: usize) {
    let others: Vec<_> = flats.iter().map(|set| campaign.frame(campaign.of(*set)[3])).collect();
    let mut gone = Vec::new();
    for (k, set) in flats.iter().enumerate() {
        let rows = campaign.of(*set);
        if k > 0 {
            campaign.put(rows[0], &others[k - 1]);
        }
        gone.extend_from_slice(&rows[keep..]);
    }
    campaign.leave_out(&gone);
}

/// Pairs in no order of their exposures, the first frame of each exposed as the set before it: half of what
/// is read of a pair is stale.
#[test]
fn stale_frames_of_pairs_in_any_order_are_named() {
    let shares = [0.5, 0.2, 0.95, 0.35, 0.8, 0.1, 0.65, 0.3, 0.9, 0.15];
    let mut campaign = sweep(&shares, &shares, 4, 208);
    let flats = campaign.sets("flat", 4);
    expose_firsts_as_before(&mut campaign, &flats, 2);
    let said = campaign.said("diagnose");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!((faults.len(), &faults[0]["kind"]), (1, &"stale-frame".into()), "{faults:?}");
    let sets = faults[0]["sets"].to_string();
    assert!(flats[1..].iter().all(|set| sets.contains(&set.to_string())), "{sets}");
    assert_eq!(said["missing"], serde_json::json!([]));
}

/// Flats with a stale first frame, each followed by a dark of its exposure as EMVA 1288 has it: the darks,
/// which are not stale, say nothing of the scatter of first frames.
#[test]
fn stale_flats_between_darks_are_named() {
    let shares = [0.5, 0.2, 0.95, 0.35, 0.8, 0.1, 0.65, 0.3];
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan.toml");
    let pair =
        |share: &f64| set_of_plan("flat", 4, 0.85 * share, 1.0) + &set_of_plan("dark", 2, 0.85 * share, 0.0);
    let text: String = shares.iter().map(pair).collect();
    std::fs::write(&plan, format!("format = \"radcam-plan/1\"\n{text}")).unwrap();
    let mut campaign = Campaign::new("cmos12", plan.to_str().unwrap(), 371);
    let flats = campaign.sets("flat", 4);
    expose_firsts_as_before(&mut campaign, &flats, 3);
    let said = campaign.said("noise");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!((faults.len(), &faults[0]["kind"]), (1, &"stale-frame".into()), "{faults:?}");
    let sets = faults[0]["sets"].to_string();
    assert!(flats[1..].iter().all(|set| sets.contains(&set.to_string())), "{sets}");
}

/// One of three darks has a black level 6 DN lower, of the same exposure as another and as the flats: the
/// light of the flats tells which of the two is right.
#[test]
fn a_dark_of_another_black_level_among_three_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan.toml");
    let flats: String = (1..9).map(|k| set_of_plan("flat", 4, 0.8, 0.1 * f64::from(k))).collect();
    let darks = set_of_plan("dark", 4, 0.8, 0.0).repeat(2) + &set_of_plan("dark", 4, 0.4, 0.0);
    std::fs::write(&plan, format!("format = \"radcam-plan/1\"\n{flats}{darks}")).unwrap();
    for (which, seed) in [(0, 372), (1, 373), (2, 374)] {
        let campaign = Campaign::new("cmos12", plan.to_str().unwrap(), seed);
        let dark = campaign.sets("dark", 4)[which];
        for row in campaign.of(dark) {
            campaign.put(row, &campaign.frame(row).mapv(|v| v.saturating_sub(6)));
        }
        is_named(&campaign, "other-settings", &[dark], "another black level");
    }
}

/// Image lag whose electrons stay by chance leaves the noise as frames of both settings do: up to the share
/// that sensors have, it is no slip.
#[test]
fn lag_by_chance_is_no_stale_frame() {
    for (fraction, seed) in [("0.12", 209), ("0.2", 210)] {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("m.toml");
        let model = model.to_str().unwrap();
        expect(0, &["model", "new", model, "--sensor", "cmos12"]);
        let fraction_of_all = format!("fraction={fraction}");
        expect(0, &["model", "add", model, "image-lag", "shape=0", &fraction_of_all, "by_chance=1"]);
        let shares = [0.2, 0.4, 0.6, 0.8, 0.95];
        let said = of_flats(model, &shares, 6, seed).said("diagnose");
        assert_eq!(said["data_faults"], serde_json::json!([]), "{fraction}");
        assert_eq!(said["missing"][0]["effect"], "image-lag", "{fraction}: {}", said["missing"]);
    }
}

/// Flats at the full well have one level at the longest exposures, and less noise than it has: the exposure
/// is what is stated.
#[test]
fn flats_at_the_full_well_have_their_exposures() {
    let shares = [0.1, 0.25, 0.4, 0.5, 0.5, 0.5];
    let campaign = sweep(&shares, &[0.1, 0.25, 0.4, 0.5, 0.7, 0.9], 4, 211);
    let flats = campaign.sets("flat", 4);
    let full: Vec<_> = campaign.of(flats[3]).into_iter().map(|row| campaign.frame(row)).collect();
    let level = full[0].mapv(f64::from).mean().unwrap();
    for set in &flats[3..] {
        for row in campaign.of(*set) {
            // A third of the noise is left: that of the readout.
            let frame = campaign.frame(row).mapv(|v| (level + 0.33 * (f64::from(v) - level)).round() as u16);
            campaign.put(row, &frame);
        }
    }
    let faults = campaign.said("diagnose")["data_faults"].clone();
    assert!(!faults.to_string().contains("does not expose longer"), "{faults}");
}

/// Darks of one exposure between which the black level moved: how much charge is in them is not told.
#[test]
fn a_black_level_that_moved_is_no_dark_charge() {
    let shares = [0.2, 0.4, 0.6, 0.8, 0.95];
    for (moves, moved) in [([3.0, 3.0], false), ([0.0, 6.0], true)] {
        let mut campaign = sweep(&shares, &shares, 4, 212);
        let exposure_s = campaign.rows[campaign.of(campaign.sets("flat", 4)[4])[0]][4].clone();
        for (set, by) in campaign.sets("dark", 4).into_iter().zip(moves) {
            for row in campaign.of(set) {
                campaign.put(row, &campaign.frame(row).mapv(|v| v + by as u16));
                campaign.rows[row][4] = exposure_s.clone();
            }
        }
        campaign.save();
        campaign.forget_black_level();
        let notes = campaign.said("noise")["notes"].to_string();
        assert_eq!(notes.contains("so much dark charge is in them"), !moved, "{moves:?}: {notes}");
    }
}

/// A lamp that starts 5 % dim at each level, in sweeps that grow by one step and by one factor: all first
/// frames are left out, and nothing is missing. Those of the settings before, in levels that grow by one
/// factor, stay stale.
#[test]
fn lamps_that_start_dim_are_named() {
    for (shares, by, seed) in
        [([0.15, 0.3, 0.45, 0.6, 0.75, 0.9], 0.95, 213), ([0.05, 0.1, 0.2, 0.4, 0.8, 0.9], 0.95, 214)]
    {
        let campaign = sweep(&shares, &shares, 6, seed);
        let flats = campaign.sets("flat", 2);
        flats.iter().for_each(|set| campaign.scale(campaign.of(*set)[0], by, BLACK_DN));
        is_named(&campaign, "odd-frame", &flats, "the lamp starts dim");
    }
    let shares = [0.15, 0.3, 0.45, 0.6, 0.75, 0.9];
    let campaign = sweep(&shares, &shares, 6, 218);
    let flats = campaign.sets("flat", 2);
    flats.iter().for_each(|set| campaign.scale(campaign.of(*set)[0], 1.03, BLACK_DN));
    is_named(&campaign, "odd-frame", &flats, "the lamp starts bright");
    let shares = [0.05, 0.1, 0.2, 0.4, 0.8];
    let campaign = sweep(&shares, &shares, 6, 215);
    let flats = campaign.sets("flat", 2);
    let last: Vec<_> = flats.iter().map(|set| campaign.frame(campaign.of(*set)[5])).collect();
    flats[1..].iter().zip(&last).for_each(|(set, frame)| campaign.put(campaign.of(*set)[0], frame));
    let faults = campaign.said("diagnose")["data_faults"].clone();
    let faults = faults.as_array().unwrap();
    assert!(faults.iter().all(|f| f["kind"] != "odd-frame") && !faults.is_empty(), "{faults:?}");
}

/// Two cameras of one model at every exposure: their flats have patterns of their own.
#[test]
fn flats_of_two_cameras_are_named() {
    let shares = [0.2, 0.2, 0.4, 0.4, 0.6, 0.6, 0.8, 0.8];
    let campaign = sweep(&shares, &shares, 4, 216);
    let flats = campaign.sets("flat", 2);
    let gain = |y: usize, x: usize, camera: u32| {
        1.0 + 0.02 * PixelRng::new(216, Stream::Effect, u64::from(camera), y as u32, x as u32).normal()
    };
    for (k, set) in flats.iter().enumerate() {
        for row in campaign.of(*set) {
            let mut frame = campaign.frame(row);
            frame.indexed_iter_mut().for_each(|((y, x), v)| {
                *v = (BLACK_DN + (f64::from(*v) - BLACK_DN) * gain(y, x, k as u32 % 2)).round() as u16;
            });
            campaign.put(row, &frame);
        }
    }
    let faults = campaign.said("noise")["data_faults"].clone();
    let own: Vec<u32> = flats.iter().copied().step_by(2).collect();
    let others: Vec<u32> = flats.iter().copied().skip(1).step_by(2).collect();
    let faults = faults.as_array().unwrap();
    assert_eq!((faults.len(), &faults[0]["kind"]), (1, &"other-settings".into()), "{faults:?}");
    assert!([own, others].iter().any(|sets| faults[0]["sets"] == serde_json::json!(sets)), "{faults:?}");
}

/// An amplifier that warms up with a time constant of 15 frames, whose files carry no times, is a drift and
/// no lag. Each frame is taken to last 1 s and its exposure, of at most 0.02 s.
#[test]
fn a_warm_up_without_times_is_a_drift() {
    let shares = [0.15, 0.3, 0.45, 0.6, 0.75, 0.9];
    let mut campaign = sweep(&shares, &shares, 8, 217);
    for (k, set) in campaign.sets("flat", 2).into_iter().enumerate() {
        for (i, row) in campaign.of(set).into_iter().enumerate() {
            let frames = (8 * k + i) as f64;
            campaign.scale(row, 1.0 - 0.08 * (-frames / 15.0).exp(), BLACK_DN);
        }
    }
    campaign.rows.iter_mut().for_each(|row| row[8].clear());
    campaign.save();
    let said = campaign.said("diagnose");
    assert_eq!(said["data_faults"], serde_json::json!([]));
    let missing = said["missing"].as_array().unwrap();
    assert_eq!((missing.len(), &missing[0]["effect"]), (1, &"gain-drift".into()), "{missing:?}");
    let tau = &missing[0]["parameters"]["tau_s"];
    let (tau_s, error_s) = (tau["value"].as_f64().unwrap(), tau["std_err"].as_f64().unwrap());
    assert!((15.0 - 4.0 * error_s..15.3 + 4.0 * error_s).contains(&tau_s), "{tau_s} +- {error_s}");
    assert!(said["notes"].to_string().contains("the frames carry no times"), "{}", said["notes"]);
}

/// Image lag after dark frames that nobody saved takes one share off the first frame of every flat too: it is
/// in the noise, and no slip.
#[test]
fn lag_after_unsaved_darks_is_no_dim_lamp() {
    let folder = tempfile::tempdir().unwrap();
    let (model, plan) = (folder.path().join("m.toml"), folder.path().join("plan.toml"));
    let model = model.to_str().unwrap();
    expect(0, &["model", "new", model, "--sensor", "cmos12"]);
    expect(0, &["model", "add", model, "image-lag", "shape=0", "fraction=0.05", "by_chance=0"]);
    let set = |kind: &str, frames: u32, exposure: f64| {
        set_of_plan(kind, frames, exposure, f64::from(u8::from(kind == "flat")))
    };
    let flats = [0.15, 0.3, 0.45, 0.6, 0.75, 0.9].map(|t| set("dark", 3, t) + &set("flat", 6, t)).concat();
    let text = set("dark", 4, 0.1) + &set("dark", 4, 1.0) + &flats;
    std::fs::write(&plan, format!("format = \"radcam-plan/1\"\n{text}")).unwrap();
    let mut campaign = Campaign::new(model, plan.to_str().unwrap(), 219);
    let unsaved: Vec<usize> =
        campaign.sets("dark", 1)[2..].iter().flat_map(|set| campaign.of(*set)).collect();
    campaign.leave_out(&unsaved);
    let said = campaign.said("diagnose");
    assert_eq!(said["data_faults"], serde_json::json!([]));
    let lag = &said["missing"][0];
    assert_eq!((lag["effect"].as_str(), said["missing"].as_array().unwrap().len()), (Some("image-lag"), 1));
    for (value, truth) in [(&lag["parameters"]["fraction"], 0.05), (&said["gain_dn_per_e"], 0.38)] {
        let (value, error) = (value["value"].as_f64().unwrap(), value["std_err"].as_f64().unwrap());
        assert!(
            (value - truth).abs() < 4.0 * error && error < 0.02 * truth,
            "{value} +- {error} for {truth}"
        );
    }
    assert!(said["notes"].to_string().contains("darkness before each set"), "{}", said["notes"]);
}

/// Darks of one exposure, each pair the means of another number of frames: the read noise is not low without
/// a word, but said and within its error, or ends with 1.
#[test]
fn darks_of_unlike_means_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan.toml");
    let flats: String = (1..9).map(|k| set_of_plan("flat", 2, 0.8, 0.1 * f64::from(k))).collect();
    let text = flats + &set_of_plan("dark", 16, 0.8, 0.0).repeat(6);
    std::fs::write(&plan, format!("format = \"radcam-plan/1\"\n{text}")).unwrap();
    let mut campaign = Campaign::new("cmos12", plan.to_str().unwrap(), 380);
    let truth = campaign.said("noise")["read_noise_e"]["value"].as_f64().unwrap();
    let mut gone = Vec::new();
    for (set, of) in campaign.sets("dark", 16).into_iter().zip([2usize, 1, 4, 3, 8, 6]) {
        let rows = campaign.of(set);
        for k in 0..2 {
            let frames = rows[k * of..][..of].iter().map(|row| campaign.frame(*row).mapv(f64::from));
            let sum = frames.reduce(|sum, frame| sum + frame).unwrap();
            campaign.put(rows[k], &(sum / of as f64).mapv(|v| v.round() as u16));
        }
        gone.extend_from_slice(&rows[2..]);
    }
    campaign.leave_out(&gone);
    let output = radcam(&["noise", &campaign.path(), "--json"]);
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let read = &said["read_noise_e"];
    let holds =
        read["value"].as_f64().zip(read["std_err"].as_f64()).is_none_or(|(v, e)| (v - truth).abs() < 3.0 * e);
    let words = format!("{} {}", said["data_faults"], said["notes"]);
    assert!(
        words.contains("averaged") && (holds || output.status.code() == Some(1)),
        "{read} for {truth}: {words}"
    );
}

/// A sweep in steps of a third under a lag of 1 %, whose first frames alone show it: `noise` says so, and the
/// error of the gain, 2 % too low by it, takes it in.
#[test]
fn lag_in_a_fine_sweep_is_in_the_error_of_the_gain() {
    let folder = tempfile::tempdir().unwrap();
    let (model, plan) = (folder.path().join("m.toml"), folder.path().join("plan.toml"));
    let model = model.to_str().unwrap();
    expect(0, &["model", "new", model, "--sensor", "cmos12"]);
    expect(0, &["model", "add", model, "image-lag", "shape=0", "fraction=0.01", "by_chance=0"]);
    let darks = set_of_plan("dark", 4, 0.1, 0.0) + &set_of_plan("dark", 4, 1.0, 0.0);
    let flats: String = (0..10).map(|k| set_of_plan("flat", 6, 0.9 * 0.74f64.powi(9 - k), 1.0)).collect();
    std::fs::write(&plan, format!("format = \"radcam-plan/1\"\n{darks}{flats}")).unwrap();
    let said = Campaign::new(model, plan.to_str().unwrap(), 379).said("noise");
    assert!(said["notes"].to_string().contains("of a change of level"), "{}", said["notes"]);
    let gain = &said["gain_dn_per_e"];
    let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
    assert!((value - 0.38).abs() < 3.0 * error && error < 0.04 * 0.38, "{value} +- {error}");
}

/// The first frame or two of each set were discarded, as people do: what a filter over time leaves of the set
/// before is a power of its weight then, and no smaller weight.
#[test]
fn a_filter_behind_discarded_frames_keeps_its_weight() {
    for (discarded, seed) in [(1usize, 254), (2, 255)] {
        let folder = tempfile::tempdir().unwrap();
        let (model, plan) = (folder.path().join("m.toml"), folder.path().join("plan.toml"));
        let model = model.to_str().unwrap();
        expect(0, &["model", "new", model, "--sensor", "cmos12"]);
        expect(0, &["model", "add", model, "temporal-filter", "alpha=0.2", "kept=0", "frames=2"]);
        let frames = 6 + discarded as u32;
        let flats =
            [0.15, 0.3, 0.45, 0.6, 0.75, 0.9].map(|light| set_of_plan("flat", frames, 1.0, light)).concat();
        let darks = [0.1, 1.0].map(|t| set_of_plan("dark", frames, t, 0.0)).concat();
        std::fs::write(&plan, format!("format = \"radcam-plan/1\"\n{darks}{flats}")).unwrap();
        let mut campaign = Campaign::new(model, plan.to_str().unwrap(), seed);
        let sets = [campaign.sets("dark", 2), campaign.sets("flat", 2)].concat();
        let unsaved: Vec<usize> =
            sets.iter().flat_map(|set| campaign.of(*set)[..discarded].to_vec()).collect();
        campaign.leave_out(&unsaved);
        let said = campaign.said("diagnose");
        assert_eq!(said["data_faults"], serde_json::json!([]));
        let filter = &said["missing"][0];
        assert_eq!(
            (filter["effect"].as_str(), said["missing"].as_array().unwrap().len()),
            (Some("temporal-filter"), 1),
            "{}",
            said["missing"]
        );
        for (value, truth) in [(&filter["parameters"]["alpha"], 0.2), (&said["gain_dn_per_e"], 0.38)] {
            let (value, error) = (value["value"].as_f64().unwrap(), value["std_err"].as_f64().unwrap());
            assert!(
                (value - truth).abs() < 4.0 * error && error < 0.02 * truth,
                "{value} +- {error} for {truth}"
            );
        }
        assert!(
            said["notes"].to_string().contains("exposed between the sets and not saved"),
            "{}",
            said["notes"]
        );
    }
}

/// Flats of three configurations for a calibration.
fn of_configurations(seed: u32) -> Campaign {
    let plan = tempfile::tempdir().unwrap();
    let file = plan.path().join("plan.toml");
    let flat = |light: f64, k: u32| {
        set_of_plan("flat", 4, 1.0, light).replace("configuration = 0", &format!("configuration = {k}"))
    };
    let flats: String = (0..3).flat_map(|k| [flat(0.15, k), flat(0.4, k)]).collect();
    let darks = [0.1, 1.0].map(|t| set_of_plan("dark", 4, t, 0.0)).concat();
    std::fs::write(&file, format!("format = \"radcam-plan/1\"\n{darks}{flats}")).unwrap();
    Campaign::new("cmos12", file.to_str().unwrap(), seed)
}

/// One fault is said, of these sets, with these words, and `noise` has the gain of the others.
fn has_another_gain(campaign: &Campaign, sets: &[u32], words: &str) {
    let said = campaign.said("noise");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert_eq!(
        (&faults[0]["kind"], &faults[0]["sets"]),
        (&"other-settings".into(), &serde_json::json!(sets)),
        "{faults:?}"
    );
    assert!(faults[0]["text"].as_str().unwrap().contains(words), "{faults:?}");
    let gain = &said["gain_dn_per_e"];
    let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
    assert!((value - 0.38).abs() < 4.0 * error, "{value} +- {error}");
}

/// A digital gain in one configuration of a calibration, about the black level and with it; an automatic gain
/// in all.
#[test]
fn another_gain_in_configurations_is_named() {
    for (above, seed) in [(BLACK_DN, 256), (0.0, 257)] {
        let campaign = of_configurations(seed);
        let flats = campaign.sets("flat", 2);
        for row in flats[4..].iter().flat_map(|set| campaign.of(*set)) {
            let gained = |v: u16| (above + 1.4 * (f64::from(v) - above)).round().min(4095.0) as u16;
            campaign.put(row, &campaign.frame(row).mapv(gained));
        }
        has_another_gain(&campaign, &flats[4..], "another gain than the flats of the same settings");
    }
    let campaign = of_configurations(258);
    let flats = campaign.sets("flat", 2);
    let bright = [flats[1], flats[3], flats[5]];
    for row in bright.iter().flat_map(|set| campaign.of(*set)) {
        campaign.scale(row, 0.4, BLACK_DN);
    }
    has_another_gain(&campaign, &bright, "another gain than the other flats");
}

/// The brighter half of a sweep in 8 of 12 bits: as smaller codes, and as codes 16 apart.
#[test]
fn fewer_bits_of_many_sets_are_named() {
    let shares = [0.1, 0.2, 0.3, 0.4, 0.55, 0.65, 0.75, 0.9];
    for (times, words, seed) in [(1, "codes are 1/16 of those", 259), (16, "codes are 16 DN apart", 260)] {
        let campaign = sweep(&shares, &shares, 4, seed);
        let flats = campaign.sets("flat", 2);
        for row in flats[4..].iter().flat_map(|set| campaign.of(*set)) {
            // Blind pixels, dusty and shaded ones, as every sensor has.
            let mut frame = campaign.frame(row);
            for (k, v) in frame.iter_mut().take(160).enumerate() {
                *v = BLACK_DN as u16 + 4 * k as u16;
            }
            campaign.put(row, &frame.mapv(|v| v / 16 * times));
        }
        is_named(&campaign, "other-settings", &flats[4..], words);
    }
}

/// Frames of which packets were lost on the way: rows of code 0 in one of twelve.
#[test]
fn lost_packets_are_named() {
    let campaign = sweep(&[0.2, 0.4, 0.6, 0.8, 0.95], &[0.2, 0.4, 0.6, 0.8, 0.95], 6, 261);
    let all: Vec<u32> = campaign.sets("dark", 2).into_iter().chain(campaign.sets("flat", 2)).collect();
    for set in all.iter().step_by(2) {
        let row = campaign.of(*set)[3];
        let mut frame = campaign.frame(row);
        frame.iter_mut().skip(4000).take(700).for_each(|v| *v = 0);
        campaign.put(row, &frame);
    }
    let hit: Vec<u32> = all.into_iter().step_by(2).collect();
    is_named(&campaign, "odd-frame", &hit, "700 samples that are exactly 0");
}

/// A camera that makes its corners brighter by a digital gain: the noise at one level grows with it.
#[test]
fn shading_that_the_camera_corrects_is_said() {
    let shares = [0.05, 0.1, 0.2, 0.3, 0.4, 0.5];
    let campaign = sweep(&shares, &shares, 4, 269);
    for row in 0..campaign.rows.len() {
        let frame = campaign.frame(row);
        let (rows, columns) = frame.dim();
        let gain = |y: usize, x: usize| {
            let off = (y as f64 / rows as f64 - 0.5).hypot(x as f64 / columns as f64 - 0.5);
            0.85 + 0.9 * off * off
        };
        let corrected = radcam::ndarray::Array2::from_shape_fn(frame.dim(), |(y, x)| {
            (BLACK_DN + gain(y, x) * (f64::from(frame[(y, x)]) - BLACK_DN)).round().min(4095.0) as u16
        });
        campaign.put(row, &corrected);
    }
    for verb in ["noise", "diagnose"] {
        let said = campaign.said(verb);
        let faults = said["data_faults"].as_array().unwrap();
        assert_eq!(faults.len(), 1, "{faults:?}");
        assert_eq!((&faults[0]["kind"], &faults[0]["left_out"]), (&"other-settings".into(), &false.into()));
        assert!(faults[0]["text"].as_str().unwrap().contains("a shading correction"), "{faults:?}");
    }
}

/// The mean of a set saved as its last file.
#[test]
fn a_mean_among_the_frames_is_named() {
    for frames in [4, 6] {
        let shares = [0.2, 0.4, 0.6, 0.8, 0.95];
        let campaign = sweep(&shares, &shares, frames, 270);
        let flats = campaign.sets("flat", 2);
        for set in &flats {
            let rows = campaign.of(*set);
            let (last, others) = rows.split_last().unwrap();
            let mut sum = campaign.frame(others[0]).mapv(f64::from);
            others[1..].iter().for_each(|row| sum += &campaign.frame(*row).mapv(f64::from));
            campaign.put(*last, &sum.mapv(|v| (v / others.len() as f64).round() as u16));
        }
        is_named(&campaign, "dependent-frames", &flats, "is a mean of the others");
    }
}

/// The two brightest of five flats are turned: they outweigh the others, and are the fewer.
#[test]
fn bright_flats_that_are_turned_are_named() {
    let shares = [0.2, 0.3, 0.4, 0.85, 0.95];
    let campaign = sweep(&shares, &shares, 6, 271);
    let flats = campaign.sets("flat", 2);
    for row in flats[3..].iter().flat_map(|set| campaign.of(*set)) {
        let frame = campaign.frame(row);
        campaign.put(row, &frame.slice(radcam::ndarray::s![..;-1, ..;-1]).to_owned());
    }
    is_named(&campaign, "other-settings", &flats[3..], "turned by 180 degrees");
}

/// Darks of a hot sensor at full scale in most pixels: what is left of them decides nothing. Before, a bend
/// of 16 % was named.
#[test]
fn a_dark_at_full_scale_decides_nothing() {
    let shares = [0.2, 0.4, 0.6, 0.8, 0.95];
    let mut campaign = sweep(&shares, &shares, 4, 272);
    let dark = campaign.sets("dark", 2)[1];
    let rows = campaign.of(dark);
    let long = (campaign.rows[rows[0]][4].parse::<f64>().unwrap() * 16.0).to_string();
    let mut random = PixelRng::new(272, Stream::Effect, 0, 0, 0);
    let hot: Vec<f64> = (0..160 * 128).map(|_| 4500.0 + 1500.0 * random.normal()).collect();
    for &row in &rows {
        let mut frame = campaign.frame(row);
        for (v, hot) in frame.iter_mut().zip(&hot) {
            *v = (hot + 20.0 * random.normal()).round().clamp(0.0, 4095.0) as u16;
        }
        campaign.put(row, &frame);
        campaign.rows[row][4].clone_from(&long);
    }
    campaign.save();
    let said = campaign.said("diagnose");
    assert_eq!(said["missing"], serde_json::json!([]), "{}", said["verdict"]);
    let gain = &said["gain_dn_per_e"];
    let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
    assert!((value - 0.38).abs() < 4.0 * error, "{gain}");
}
