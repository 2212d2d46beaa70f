//! Campaigns with one warm dark, with none, or with nothing else: what they tell is said, and what they do
//! not tell is not made up. Of cameras that the program simulates; sets are taken away by their labels.

use crate::rewritten::{Campaign, set_of_plan};
use crate::support::small_sensor;
use serde_json::Value;

/// A campaign of a small camera with these lines of its model file changed, and this effect.
fn campaign(changes: &[(&str, &str)], effect: &str, seed: u32) -> Campaign {
    let dir = tempfile::tempdir().unwrap();
    let model = small_sensor(dir.path(), "cmos12", 160, 128);
    let mut text = std::fs::read_to_string(&model).unwrap();
    for (name, value) in changes {
        let line = text.lines().find(|l| l.starts_with(&format!("{name} ="))).unwrap().to_string();
        text = text.replace(&line, &format!("{name} = {value}"));
    }
    std::fs::write(&model, format!("{text}\n{effect}")).unwrap();
    Campaign::new(model.to_str().unwrap(), "standard", seed)
}

/// Standard errors between a value that was said and the truth.
fn sigmas(said: &Value, truth: f64) -> f64 {
    let of = |name: &str| said[name].as_f64().unwrap_or(f64::NAN);
    (of("value") - truth) / of("std_err")
}

/// The only dark is as long as the longest flat and warm (66 electrons): gain and dark current within four
/// standard errors, and nothing is missing.
#[test]
fn a_single_warm_dark_tells_gain_and_dark_current() {
    for seed in [31, 32] {
        let mut campaign = campaign(&[("dark_current_e_per_s", "200.0")], "", seed);
        let darks = campaign.rows.iter().filter(|r| r[1] == "dark");
        let longest_s = darks.map(|r| r[4].parse::<f64>().unwrap()).fold(0.0, f64::max);
        campaign.keep(|kind, exposure_s| kind == "flat" || kind == "dark" && exposure_s == longest_s);
        campaign.forget_black_level();
        let said = campaign.said("diagnose");
        assert!(said["consistent"] == true && said["data_faults"] == Value::Array(vec![]), "{said:#}");
        let off = sigmas(&said["gain_dn_per_e"], 0.38);
        assert!(off.abs() < 4.0, "gain {off} of {}", said["gain_dn_per_e"]);
        // The mean of so many pixels that differ by half of it is that of the sensor within 0.35 %.
        let dark = &said["dark_current_e_per_s"];
        let std_err = dark["std_err"].as_f64().unwrap().hypot(200.0 * 0.5 / f64::from(160 * 128).sqrt());
        assert!((dark["value"].as_f64().unwrap() - 200.0).abs() < 4.0 * std_err, "{dark}");
    }
}

/// Flats alone: a dark current that they do not tell is not said, or is not below zero.
#[test]
fn flats_alone_make_no_negative_dark_current() {
    for seed in [33, 34] {
        let mut campaign = campaign(&[], "", seed);
        campaign.keep(|kind, _| kind == "flat");
        campaign.forget_black_level();
        let said = campaign.said("diagnose");
        let dark = &said["dark_current_e_per_s"];
        assert!(dark["value"].as_f64().is_none_or(|v| v >= 0.0), "{dark}");
        assert_eq!(said["consistent"], true, "{said:#}");
    }
}

/// Darks without charge tell no gain: the row noise in them has a size in DN, within four standard errors of
/// the truth.
#[test]
fn darks_alone_say_sizes_in_dn() {
    let effect = "[[effect]]\nid = \"row-noise\"\n[effect.parameters]\ne = 1.5\n";
    let mut campaign = campaign(&[], effect, 35);
    campaign.keep(|kind, exposure_s| kind == "dark" && exposure_s < 0.05);
    let said = campaign.said("diagnose");
    let row = &said["missing"][0];
    assert_eq!(row["effect"], "row-noise", "{said:#}");
    let size = &row["parameters"]["e"];
    assert_eq!(size["unit"], "DN", "{row:#}");
    assert!(sigmas(size, 1.5 * 0.38).abs() < 4.0, "{size}");
}

/// A frame of a bright flat that lost a tenth of its rows on the link: the set is not called clipped, and the
/// gain is that without the loss, within four standard errors.
#[test]
fn rows_that_a_frame_lost_clip_no_set() {
    let campaign = campaign(&[], "", 36);
    let level = |row: &usize| campaign.frame(*row).mapv(f64::from).mean().unwrap();
    // The brightest flat that is not near full scale.
    let flats =
        (0..campaign.rows.len()).filter(|r| campaign.rows[*r][1] == "flat" && campaign.rows[*r][3] == "1");
    let brightest = flats.filter(|r| level(r) < 3000.0).max_by(|a, b| level(a).total_cmp(&level(b))).unwrap();
    let mut codes = campaign.frame(brightest);
    let lost = codes.nrows() - codes.nrows() / 10;
    codes.slice_mut(radcam::ndarray::s![lost.., ..]).fill(0);
    campaign.put(brightest, &codes);
    let said = campaign.said("diagnose");
    let words = format!("{} {}", said["notes"], said["data_faults"]);
    assert!(!words.contains("clipped"), "{words}");
    let off = sigmas(&said["gain_dn_per_e"], 0.38);
    assert!(off.abs() < 4.0, "gain {off}: {said:#}");
}

/// A black level that falls during a set makes its frames alike, and no filter: none is called filtered.
#[test]
fn frames_that_drift_are_not_called_filtered() {
    let effect = "[[effect]]\nid = \"offset-drift\"\n[effect.parameters]\nshape = 1.0\ndn_per_s = 0.0\ndn = 12.0\ntau_s = 4.0\n";
    let said = campaign(&[], effect, 37).said("diagnose");
    assert!(!said["data_faults"].to_string().contains("filtered"), "{}", said["data_faults"]);
    assert_eq!(said["missing"][0]["effect"], "offset-drift", "{said:#}");
}

/// Two darks beside bright flats, which do not tell the noise of darks: the shorter dark has a third of the
/// longer one's noise, and neither is accused.
#[test]
fn the_shorter_of_two_darks_may_have_less_noise() {
    let dir = tempfile::tempdir().unwrap();
    let plan = dir.path().join("plan.toml");
    let set = |kind: &str, share: f64| set_of_plan(kind, 6, share, f64::from(u8::from(kind == "flat")));
    let flats = [0.5, 0.6, 0.7, 0.8, 0.9].map(|share| set("flat", share)).concat();
    let text = set("dark", 0.3) + &set("dark", 0.9) + &flats;
    std::fs::write(&plan, format!("format = \"radcam-plan/1\"\n{text}")).unwrap();
    for seed in [242, 243] {
        let campaign = Campaign::new("cmos12", plan.to_str().unwrap(), seed);
        let rows = campaign.of(campaign.sets("dark", 2)[1]);
        let frames: Vec<_> = rows.iter().map(|row| campaign.frame(*row).mapv(f64::from)).collect();
        let mean = frames.iter().fold(frames[0].clone() * 0.0, |sum, f| sum + f) / frames.len() as f64;
        for (row, frame) in rows.into_iter().zip(&frames) {
            let other = &mean + (frame - &mean) * 3.0;
            campaign.put(row, &other.mapv(|v| v.round() as u16));
        }
        assert_eq!(campaign.said("noise")["data_faults"].to_string(), "[]", "{seed}");
    }
}
