//! Slips of the hand, put into campaigns of simulated cameras by rewriting labels and files, and read by the
//! program.

use crate::rewritten::{Campaign, set_of_plan};
use crate::support::{expect, radcam, shared};
use radcam::ndarray::{Array2, s};
use radcam_sim::rng::{PixelRng, Stream};
use std::path::Path;

/// Black level of the sensor `cmos12`, DN.
pub const BLACK_DN: f64 = 64.0;

/// Puts one slip into a campaign; its kind and its sets.
type Slip = fn(&mut Campaign) -> (&'static str, Vec<u32>);

fn wrong_exposure(c: &mut Campaign) -> (&'static str, Vec<u32>) {
    let set = c.flat(2);
    for row in c.of(set) {
        let exposure_s: f64 = c.rows[row][4].parse().unwrap();
        c.rows[row][4] = (1.25 * exposure_s).to_string();
    }
    c.save();
    ("setting-label", vec![set])
}

fn exchanged(c: &mut Campaign) -> (&'static str, Vec<u32>) {
    let (flat, dark) = (c.flat(2), c.sets("dark", 2)[1]);
    for (set, kind, light) in [(flat, "dark", "0"), (dark, "flat", "1")] {
        for row in c.of(set) {
            (c.rows[row][1], c.rows[row][5]) = (kind.into(), light.into());
        }
    }
    c.save();
    let (first, last) = (dark.min(flat), dark.max(flat));
    ("kind-label", vec![first, last])
}

fn copied(c: &mut Campaign) -> (&'static str, Vec<u32>) {
    let set = c.flat(2);
    let rows = c.of(set);
    c.put(*rows.last().unwrap(), &c.frame(rows[0]));
    ("copied-frames", vec![set])
}

/// A lost packet: 3000 pixels are those of the frame before.
fn old_packet(c: &mut Campaign) -> (&'static str, Vec<u32>) {
    let set = c.flat(2);
    let rows = c.of(set);
    let (before, mut own) = (c.frame(rows[0]), c.frame(rows[1]));
    own.iter_mut().zip(&before).skip(2000).take(3000).for_each(|(own, before)| *own = *before);
    c.put(rows[1], &own);
    ("copied-frames", vec![set])
}

fn averaged(c: &mut Campaign) -> (&'static str, Vec<u32>) {
    let set = c.flat(4);
    let rows = c.of(set);
    let mut sent = c.frame(rows[0]).mapv(f64::from);
    for row in rows {
        sent = 0.5 * sent + 0.5 * c.frame(row).mapv(f64::from);
        c.put(row, &sent.mapv(|v| v.round() as u16));
    }
    ("dependent-frames", vec![set])
}

fn stale(c: &mut Campaign) -> (&'static str, Vec<u32>) {
    let set = c.flat(2);
    let (own, before) = (c.of(set)[0], *c.of(c.before(set).unwrap()).last().unwrap());
    c.put(own, &c.frame(before));
    ("stale-frame", vec![set])
}

fn darker(c: &mut Campaign) -> (&'static str, Vec<u32>) {
    let set = c.flat(4);
    c.scale(c.of(set)[2], 0.9, BLACK_DN);
    ("odd-frame", vec![set])
}

fn more_gain(c: &mut Campaign) -> (&'static str, Vec<u32>) {
    let set = c.flat(2);
    c.of(set).into_iter().for_each(|row| c.scale(row, 1.41, BLACK_DN));
    ("other-settings", vec![set])
}

fn mirrored(c: &mut Campaign) -> (&'static str, Vec<u32>) {
    let set = c.flat(2);
    for row in c.of(set) {
        let codes = c.frame(row).slice(s![.., ..;-1]).to_owned();
        c.put(row, &codes);
    }
    ("other-settings", vec![set])
}

fn other_black(c: &mut Campaign) -> (&'static str, Vec<u32>) {
    let set = c.sets("dark", 2)[1];
    c.of(set).into_iter().for_each(|row| c.put(row, &c.frame(row).mapv(|v| v + 30)));
    ("other-settings", vec![set])
}

fn unequal(c: &mut Campaign) -> (&'static str, Vec<u32>) {
    let pairs = c.sets("flat", 2).into_iter().filter(|s| c.of(*s).len() == 2);
    let set = c.flat_of(pairs.collect());
    c.scale(c.of(set)[1], 0.95, BLACK_DN);
    ("unequal-light", vec![set])
}

/// Each kind is named with its set, by `diagnose` and `noise` in the same words; nothing is missing then, and
/// the gain lies within four standard errors of the camera's.
#[test]
fn slips_are_named_with_their_sets_and_left_out() {
    let all: [(&str, Slip); 10] = [
        ("standard", wrong_exposure),
        ("emva1288", wrong_exposure),
        ("emva1288", exchanged),
        ("standard", copied),
        ("standard", averaged),
        ("standard", stale),
        ("standard", darker),
        ("emva1288", more_gain),
        ("standard", mirrored),
        ("emva1288", unequal),
    ];
    for (seed, (plan, slip)) in all.into_iter().enumerate() {
        told(plan, slip, 30 + seed as u32);
    }
    told("emva1288", other_black, 44);
    told("standard", old_packet, 45);
    told("emva1288", old_packet, 46);
}

fn told(plan: &str, slip: Slip, seed: u32) {
    let mut campaign = Campaign::new("cmos12", plan, seed);
    let (kind, sets) = slip(&mut campaign);
    let said = campaign.said("diagnose");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!(faults.len(), 1, "{plan} {kind} {sets:?}: {faults:?}");
    assert_eq!(
        (&faults[0]["kind"], &faults[0]["sets"]),
        (&kind.into(), &serde_json::json!(sets)),
        "{faults:?}"
    );
    assert_eq!(said["missing"], serde_json::json!([]), "{plan} {kind} {sets:?}");
    let noise = campaign.said("noise");
    assert_eq!(noise["data_faults"], said["data_faults"]);
    for (verb, gain) in [("diagnose", &said["gain_dn_per_e"]), ("noise", &noise["gain_dn_per_e"])] {
        let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
        assert!((value - 0.38).abs() < 4.0 * error, "{plan} {kind} {verb}: {value} +- {error}");
    }
}

/// A time stamp of eight digits in the upper rows of every frame, white on what is there, or on black: its
/// rows are left out, gain and verdict are those of the camera, and no correction is made of the rest.
#[test]
fn rows_with_text_are_left_out() {
    for (plan, on_black, of_set, seed) in
        [("standard", true, false, 359), ("emva1288", false, false, 360), ("standard", true, true, 361)]
    {
        let campaign = Campaign::new("cmos12", plan, seed);
        for row in 0..campaign.rows.len() {
            let mut codes = campaign.frame(row);
            for digit in 0..8u32 {
                // A clock that ticks with each frame, or between sets.
                let tick = if of_set { campaign.rows[row][2].parse().unwrap() } else { row as u32 };
                let shape = (tick * 137 + 1000) / 10u32.pow(7 - digit) % 10;
                for (y, x) in (0..7u32).flat_map(|y| (0..5u32).map(move |x| (y, x))) {
                    let is_white = PixelRng::new(shape.into(), Stream::Effect, 0, y, x).uniform() < 0.5;
                    let at = [2 + y as usize, (2 + 6 * digit + x) as usize];
                    codes[at] = if is_white {
                        4095
                    } else if on_black {
                        0
                    } else {
                        codes[at]
                    };
                }
            }
            campaign.put(row, &codes);
        }
        let said = campaign.said("diagnose");
        let faults = said["data_faults"].to_string();
        assert!(faults.contains("rows 2 to 8 jump from frame to frame as text does"), "{plan}: {faults}");
        assert_eq!(said["data_faults"].as_array().unwrap().len(), 1, "{plan}: {faults}");
        assert_eq!(said["missing"], serde_json::json!([]), "{plan}");
        let noise = campaign.said("noise");
        assert_eq!(noise["data_faults"], said["data_faults"]);
        let gain = &noise["gain_dn_per_e"];
        let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
        assert!((value - 0.38).abs() < 4.0 * error, "{plan}: {value} +- {error}");
        let to = campaign.path() + ".cal";
        let refused = crate::support::refused(&["calibrate", &campaign.path(), "--flat-field", "-o", &to]);
        assert!(refused.contains("every pixel") && refused.contains("overlay"), "{refused}");
        let refused = crate::support::refused(&["reduce", &campaign.path(), "-o", &to]);
        assert!(refused.contains("statistics are of whole frames"), "{refused}");
    }
}

/// A row of embedded data, other codes in each frame: left out, and the gain is that of the camera.
#[test]
fn a_row_of_embedded_data_is_left_out() {
    let campaign = Campaign::new("cmos12", "standard", 362);
    for row in 0..campaign.rows.len() {
        let mut codes = campaign.frame(row);
        let of = |x: usize| PixelRng::new(row as u64, Stream::Effect, 0, x as u32, 0).uniform();
        codes.row_mut(0).indexed_iter_mut().for_each(|(x, v)| *v = (4095.0 * of(x)) as u16);
        campaign.put(row, &codes);
    }
    let noise = campaign.said("noise");
    assert!(
        noise["data_faults"].to_string().contains("row 0 jumps from frame to frame (embedded data"),
        "{noise}"
    );
    let gain = &noise["gain_dn_per_e"];
    let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
    assert!((value - 0.38).abs() < 4.0 * error, "{value} +- {error}");
    // A correction is of whole frames, and its errors are those of the row; the row is named.
    let to = campaign.path() + ".cal";
    let refused = crate::support::refused(&["calibrate", &campaign.path(), "--flat-field", "-o", &to]);
    assert!(refused.contains("row 0 jumps"), "{refused}");
}

/// Two flats with a tenth less light in a corner are named and left out; a curve of the response under a
/// shaded field is no other field.
#[test]
fn another_field_of_light_is_named() {
    let campaign = Campaign::new("cmos12", "standard", 352);
    let level = |set: u32| campaign.frame(campaign.of(set)[0]).mapv(f64::from).mean().unwrap();
    let mut flats = campaign.sets("flat", 2);
    flats.retain(|f| (600.0..3600.0).contains(&level(*f)));
    let mut wrong = [flats[1], flats[flats.len() - 2]];
    wrong.sort_unstable();
    for row in wrong.iter().flat_map(|set| campaign.of(*set)) {
        let mut frame = campaign.frame(row);
        let (rows, columns) = frame.dim();
        let mut corner = frame.slice_mut(ndarray::s![..rows / 3, ..columns / 3]);
        corner.mapv_inplace(|v| (BLACK_DN + 0.9 * (f64::from(v) - BLACK_DN)).round() as u16);
        campaign.put(row, &frame);
    }
    let said = campaign.said("noise");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert_eq!(faults[0]["sets"], serde_json::json!(wrong), "{faults:?}");
    let text = faults[0]["text"].as_str().unwrap();
    assert!(faults[0]["kind"] == "unequal-light" && text.contains("falls on other places"), "{text}");
    // Five per cent less at full scale.
    let campaign = Campaign::new("cmos12", "standard", 353);
    let all: Vec<usize> = campaign.sets("flat", 2).iter().flat_map(|set| campaign.of(*set)).collect();
    for row in all {
        let bent = |v: u16| {
            let v = f64::from(v) - BLACK_DN;
            (BLACK_DN + v * (1.0 - 0.05 * v / 4095.0)).round() as u16
        };
        campaign.put(row, &campaign.frame(row).mapv(bent));
    }
    assert_eq!(campaign.said("noise")["data_faults"], serde_json::json!([]));
}

/// The only fault says another gain than the other flats have, with the ratio within three of its errors.
fn has_another_gain(faults: &[serde_json::Value], ratio: f64) {
    let text = faults[0]["text"].as_str().unwrap();
    assert!(faults.len() == 1 && text.contains("another gain than the other flats"), "{faults:?}");
    let mut numbers =
        text.split("flats, ").nth(1).unwrap().split([' ', '±']).filter_map(|w| w.parse::<f64>().ok());
    let (named, error) = (numbers.next().unwrap(), numbers.next().unwrap());
    assert!((named - ratio).abs() < 3.0 * error && error < 0.1 * ratio, "{ratio}: {text}");
}

/// Another gain of single flats here and there: these are named, with the ratio within three stated errors,
/// and the gain is that of the others.
#[test]
fn another_gain_of_flats_here_and_there_is_named() {
    for (plan, seed, ratio) in [("standard", 341, 1.1), ("standard", 342, 1.5), ("emva1288", 343, 1.2)] {
        let campaign = Campaign::new("cmos12", plan, seed);
        let level = |set: u32| campaign.frame(campaign.of(set)[0]).mapv(f64::from).mean().unwrap();
        let mut flats = campaign.sets("flat", 2);
        flats.retain(|f| level(*f) * ratio < 3600.0);
        flats.sort_by(|a, b| level(*a).total_cmp(&level(*b)));
        let wrong: Vec<u32> = (0..flats.len()).filter(|k| k % 4 == 2).map(|k| flats[k]).collect();
        wrong.iter().flat_map(|f| campaign.of(*f)).for_each(|row| campaign.scale(row, ratio, BLACK_DN));
        let said = campaign.said("noise");
        let faults = said["data_faults"].as_array().unwrap();
        has_another_gain(faults, ratio);
        let mut sets = wrong.clone();
        sets.sort_unstable();
        assert_eq!(faults[0]["sets"], serde_json::json!(sets), "{faults:?}");
        let gain = &said["gain_dn_per_e"];
        let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
        assert!((value - 0.38).abs() < 4.0 * error, "{plan} {ratio}: {value} +- {error}");
    }
}

/// Another gain of the brighter flats, in the camera about the black level or on the codes with the black
/// level in them: all of these flats are named, the true ratio lies within three stated errors, and the gain
/// is that of the others. A curve with a knee at the same place is no other gain.
#[test]
fn another_gain_of_the_brighter_flats_is_named() {
    for (seed, ratio, about) in [(67, 0.6, BLACK_DN), (68, 0.8, BLACK_DN), (72, 0.7, 0.0), (73, 0.5, 0.0)] {
        let campaign = Campaign::new("cmos12", "standard", seed);
        let level = |set: u32| campaign.frame(campaign.of(set)[0]).mapv(f64::from).mean().unwrap();
        let mut flats = campaign.sets("flat", 2);
        flats.retain(|f| level(*f) < 3600.0);
        flats.sort_by(|a, b| level(*a).total_cmp(&level(*b)));
        // A third of them, cut between two levels.
        let mut at = 2 * flats.len() / 3;
        while level(flats[at]) < 1.1 * level(flats[at - 1]) {
            at += 1;
        }
        let bright = flats.split_off(at);
        assert!(bright.len() > 1, "{bright:?}");
        bright.iter().flat_map(|f| campaign.of(*f)).for_each(|row| campaign.scale(row, ratio, about));
        let said = campaign.said("noise");
        let faults = said["data_faults"].as_array().unwrap();
        has_another_gain(faults, ratio);
        let sets = faults[0]["sets"].as_array().unwrap();
        assert!(bright.iter().all(|f| sets.contains(&(*f).into())), "{faults:?}, {bright:?}");
        let gain = &said["gain_dn_per_e"];
        let (gain, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
        assert!((gain - 0.38).abs() < 4.0 * error, "{gain} +- {error}");
    }
    let campaign = Campaign::new("cmos12", "standard", 69);
    for row in 0..campaign.rows.len() {
        let bent = |v: u16| if v > 1500 { 1500 + (f64::from(v - 1500) * 0.6).round() as u16 } else { v };
        campaign.put(row, &campaign.frame(row).mapv(bent));
    }
    assert_eq!(campaign.said("noise")["data_faults"], serde_json::json!([]));
}

/// A pattern that drifts across the field of one flat while it is taken: the set is named, and its later
/// frames are left out.
#[test]
fn a_field_that_moves_is_named() {
    let campaign = Campaign::new("cmos12", "standard", 71);
    let set = campaign.flat(8);
    for (k, row) in campaign.of(set).into_iter().enumerate() {
        let frame = campaign.frame(row);
        let moved = frame.indexed_iter().map(|((y, x), v)| {
            let phase = 0.35 * (x + 2 * y) as f64 + 0.02 * k as f64;
            (BLACK_DN + (f64::from(*v) - BLACK_DN) * (1.0 + 0.25 * phase.sin())).round() as u16
        });
        campaign.put(row, &Array2::from_shape_vec(frame.dim(), moved.collect()).unwrap());
    }
    let said = campaign.said("noise");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert_eq!(faults[0]["kind"], "odd-frame");
    assert_eq!(faults[0]["sets"], serde_json::json!([set]));
    let text = faults[0]["text"].as_str().unwrap();
    assert!(text.contains("the field moves or changes while it is taken"), "{text}");
}

/// Pairs of flats and darks in a random order of a camera with a lag of 10 %, one under a wrong label: that
/// is named and nothing else, the set that is left out still leaves its charge in the next, and the lag is
/// right. `noise` has a gain that is too low by what frames share, and its error says so.
#[test]
fn a_wrong_label_beside_image_lag_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let (model, plan) = (folder.path().join("m.toml"), folder.path().join("plan.toml"));
    let model = model.to_str().unwrap();
    expect(0, &["model", "new", model, "--sensor", "cmos12"]);
    expect(0, &["model", "add", model, "image-lag", "shape=0", "fraction=0.1"]);
    let set = |kind: &str, exposure: f64, frames: u32, light: u32| {
        set_of_plan(kind, frames, exposure, f64::from(light))
    };
    let sets = [1.0, 0.25, 0.7, 0.1, 0.9, 0.4, 0.15, 0.8, 0.5, 0.2, 0.6, 0.3].map(|t| {
        let dark = if [0.7, 0.4, 0.5, 0.3].contains(&t) { set("dark", t, 4, 0) } else { String::new() };
        set("flat", t, 2, 1) + &dark
    });
    std::fs::write(&plan, format!("format = \"radcam-plan/1\"\n{}", sets.concat())).unwrap();
    let mut campaign = Campaign::new(model, plan.to_str().unwrap(), 75);
    for row in campaign.of(6) {
        let exposure_s: f64 = campaign.rows[row][4].parse().unwrap();
        campaign.rows[row][4] = (1.3 * exposure_s).to_string();
    }
    campaign.save();
    let said = campaign.said("diagnose");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert_eq!((&faults[0]["kind"], &faults[0]["sets"]), (&"setting-label".into(), &serde_json::json!([6])));
    let missing = said["missing"].as_array().unwrap();
    assert_eq!(missing[0]["effect"], "image-lag", "{missing:?}");
    let fraction = &missing[0]["parameters"]["fraction"];
    let (value, error) = (fraction["value"].as_f64().unwrap(), fraction["std_err"].as_f64().unwrap());
    assert!((value - 0.1).abs() < 4.0 * error, "{value} +- {error}");
    let gain = &campaign.said("noise")["gain_dn_per_e"];
    let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
    assert!((value - 0.38).abs() < 3.0 * error && error < 0.5 * value, "{value} +- {error}");
}

/// A strobe that misses the first frame of every flat; names that exchange all darks and flats; light on one
/// dark frame, which is left out and tells nothing of the others.
#[test]
fn dark_first_frames_and_exchanged_kinds_are_named() {
    let campaign = Campaign::new("cmos12", "standard", 76);
    let dark = campaign.frame(campaign.of(campaign.sets("dark", 2)[0])[0]);
    let flats = campaign.sets("flat", 4);
    for set in &flats {
        campaign.put(campaign.of(*set)[0], &dark.mapv(|v| v + (*set % 3) as u16));
    }
    let said = campaign.said("noise");
    let faults = said["data_faults"].as_array().unwrap();
    let kinds = ["stale-frame", "odd-frame"];
    assert!(faults.iter().all(|f| kinds.contains(&f["kind"].as_str().unwrap())), "{faults:?}");
    let named: Vec<&serde_json::Value> = faults.iter().flat_map(|f| f["sets"].as_array().unwrap()).collect();
    assert!(flats.iter().all(|set| named.contains(&&serde_json::json!(set))), "{faults:?}");

    let mut campaign = Campaign::new("cmos12", "standard", 77);
    for row in &mut campaign.rows {
        let dark = row[1] == "dark";
        (row[1], row[5]) = if dark { ("flat".into(), "1".into()) } else { ("dark".into(), "0".into()) };
    }
    campaign.save();
    let output = radcam(&["noise", &campaign.path()]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        output.status.code() == Some(2) && said.contains("all sets: dark and flat are exchanged"),
        "{said}"
    );

    let campaign = Campaign::new("cmos12", "standard", 78);
    let (dark, flat) = (campaign.sets("dark", 6)[0], campaign.flat(8));
    let lit = campaign.frame(campaign.of(flat)[3]).mapv(f64::from);
    let row = campaign.of(dark)[4];
    let codes = campaign.frame(row).mapv(f64::from) + (lit - BLACK_DN) * 0.1;
    campaign.put(row, &codes.mapv(|v| v.round() as u16));
    let said = campaign.said("noise");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!((faults.len(), &faults[0]["kind"]), (1, &"odd-frame".into()), "{faults:?}");
}

/// The light of the one stack of flats is stated 5 % too high: the set is named, and PRNU and DSNU, which do
/// not need the light, are those of the right label.
#[test]
fn a_stack_under_a_wrong_label_still_tells_nonuniformity() {
    let mut campaign = Campaign::new("cmos12", "emva1288", 79);
    let flats = campaign.sets("flat", 3);
    assert_eq!(flats.len(), 1);
    let values = |c: &Campaign| {
        let said = c.said("emva");
        ["PRNU1288", "DSNU1288_DN"].map(|name| said["quantities"][name]["value"].as_f64().unwrap())
    };
    let right = values(&campaign);
    for row in campaign.of(flats[0]) {
        let light: f64 = campaign.rows[row][5].parse().unwrap();
        campaign.rows[row][5] = (1.05 * light).to_string();
    }
    campaign.save();
    let faults = campaign.said("emva")["data_faults"].to_string();
    assert!(faults.contains("setting-label"), "{faults}");
    for (a, b) in right.into_iter().zip(values(&campaign)) {
        assert!((a - b).abs() < 1e-9 * a, "{a} {b}");
    }
}

/// Two darks, and flats at these lights with four frames each.
pub fn few_darks(sensor: &str, lights: &[f64], seed: u32) -> Campaign {
    of_flats(sensor, lights, 4, seed)
}

/// Two darks, and flats at these lights with so many frames each.
pub fn of_flats(sensor: &str, lights: &[f64], frames: usize, seed: u32) -> Campaign {
    let plan = tempfile::tempdir().unwrap();
    let file = plan.path().join("plan.toml");
    let darks = [0.1, 1.0].map(|t| set_of_plan("dark", 4, t, 0.0)).concat();
    let flats: String = lights.iter().map(|light| set_of_plan("flat", frames as u32, 1.0, *light)).collect();
    std::fs::write(&file, format!("format = \"radcam-plan/1\"\n{darks}{flats}")).unwrap();
    Campaign::new(sensor, file.to_str().unwrap(), seed)
}

/// Labels of two of six flats are exchanged, whichever: both are named and left out.
#[test]
fn exchanged_labels_of_two_of_six_flats_are_named() {
    for (k, (a, b)) in [(0, 1), (1, 3), (2, 3), (4, 5), (0, 5)].into_iter().enumerate() {
        let mut campaign = few_darks("cmos12", &[0.15, 0.3, 0.45, 0.6, 0.75, 0.9], 90 + k as u32);
        let flats = campaign.sets("flat", 4);
        let light = |c: &Campaign, set: u32| c.rows[c.of(set)[0]][5].clone();
        let (of_a, of_b) = (light(&campaign, flats[a]), light(&campaign, flats[b]));
        for (set, light) in [(flats[a], of_b), (flats[b], of_a)] {
            campaign.of(set).into_iter().for_each(|row| campaign.rows[row][5] = light.clone());
        }
        campaign.save();
        let said = campaign.said("diagnose");
        let faults = said["data_faults"].as_array().unwrap();
        assert_eq!(faults.len(), 1, "{a} {b}: {faults:?}");
        let both = serde_json::json!([flats[a], flats[b]]);
        assert_eq!((&faults[0]["kind"], &faults[0]["sets"]), (&"setting-label".into(), &both), "{faults:?}");
        assert_eq!(said["missing"], serde_json::json!([]), "{a} {b}");
    }
}

/// Two darks and one light, whose first frame is 3 % dim: no lag, as the noise of its frames does not
/// depend on the frame before, and the frame is left out.
#[test]
fn a_dim_first_flat_after_the_darks_is_odd() {
    let campaign = of_flats("cmos12", &[1.0], 12, 71);
    let first = campaign.of(campaign.sets("flat", 4)[0])[0];
    campaign.scale(first, 0.97, BLACK_DN);
    let said = campaign.said("diagnose");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert_eq!(
        (&faults[0]["kind"], &faults[0]["frames"][0]),
        (&"odd-frame".into(), &campaign.rows[first][0].as_str().into())
    );
    assert_eq!(said["missing"], serde_json::json!([]));
}

/// Every flat has one level, whatever exposure its label states.
#[test]
fn an_automatic_exposure_is_named() {
    let mut campaign = few_darks("cmos12", &[1.0; 6], 70);
    let exposure: f64 = campaign.rows[campaign.of(campaign.sets("flat", 2)[0])[0]][4].parse().unwrap();
    for (k, set) in campaign.sets("flat", 2).into_iter().enumerate() {
        let stated = (exposure * [0.05, 0.1, 0.2, 0.4, 0.7, 1.0][k]).to_string();
        campaign.of(set).into_iter().for_each(|row| campaign.rows[row][4] = stated.clone());
    }
    campaign.save();
    let said = campaign.said("noise");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!(faults.len(), 1, "{faults:?}");
    let text = faults[0]["text"].as_str().unwrap();
    assert!(text.contains("an automatic exposure was on") && text.contains("by a factor of 20"), "{text}");
}

/// What nobody did wrong is not said to be.
#[test]
fn campaigns_without_a_slip_have_none() {
    for (sensor, plan, seed) in [
        ("cmos12", "standard", 1),
        ("cmos12", "emva1288", 2),
        ("imx250", "standard", 3),
        ("cmos12", "quick", 4),
    ] {
        let campaign = Campaign::new(sensor, plan, seed);
        let said = campaign.said("noise");
        assert_eq!(said["data_faults"], serde_json::json!([]), "{sensor} {plan}");
    }
}

/// Every frame a copy: what is left is refused, and the reason has the copies in it.
#[test]
fn what_cannot_be_left_out_is_refused_with_the_reason() {
    let campaign = Campaign::new("cmos12", "emva1288", 5);
    for set in campaign.sets("flat", 2) {
        let rows = campaign.of(set);
        rows[1..].iter().for_each(|row| campaign.put(*row, &campaign.frame(rows[0])));
    }
    for verb in ["noise", "emva"] {
        let output = radcam(&[verb, &campaign.path()]);
        let err = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{verb}: {err}");
        assert!(err.contains("copies of others"), "{verb}: {err}");
    }
}

/// Statistics that were kept say the same of a campaign with a slip, without its frames.
#[test]
fn kept_statistics_know_the_slips() {
    let mut campaign = Campaign::new("cmos12", "standard", 6);
    wrong_exposure(&mut campaign);
    stale(&mut campaign);
    let kept = campaign.dir.path().join("kept.stats");
    expect(0, &["reduce", &campaign.path(), "-o", kept.to_str().unwrap()]);
    let whole = campaign.said("noise");
    std::fs::remove_dir_all(Path::new(&campaign.path()).join("frames")).unwrap();
    let of_kept: serde_json::Value =
        serde_json::from_slice(&radcam(&["noise", kept.to_str().unwrap(), "--json"]).stdout).unwrap();
    // Kept statistics name files by their whole paths.
    let faults = |said: &serde_json::Value| -> Vec<serde_json::Value> {
        let all = said["data_faults"].as_array().unwrap().iter();
        all.map(|f| serde_json::json!([f["kind"], f["sets"]])).collect()
    };
    assert_eq!(faults(&whole).len(), 2, "{}", whole["data_faults"]);
    assert_eq!(faults(&whole), faults(&of_kept));
    for name in ["gain_dn_per_e", "constant_noise_var_dn2", "offset_dn", "levels"] {
        assert_eq!(whole[name], of_kept[name], "{name}");
    }
}

/// The practice campaigns with a slip: its kind and its sets, nothing missing, the gain within three standard
/// errors.
#[test]
fn practice_sets_with_slips_are_told() {
    let Some(root) = shared("practice") else { return };
    for name in ["wrong-exposure", "wrong-light-pairs", "copied-frames", "stale-first-frame"] {
        let path = root.join(name);
        let truth: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(path.join("truth.json")).unwrap()).unwrap();
        let said: serde_json::Value =
            serde_json::from_str(&expect(0, &["diagnose", path.to_str().unwrap(), "--json"])).unwrap();
        let (found, hidden) = (said["data_faults"].as_array().unwrap(), &truth["data_faults"][0]);
        assert_eq!((found.len(), &found[0]["kind"]), (1, &hidden["kind"]), "{name}: {found:?}");
        // Some truths say "every flat set" in words.
        if hidden["sets"].is_array() {
            assert_eq!(found[0]["sets"], hidden["sets"], "{name}");
        }
        assert_eq!(said["missing"], serde_json::json!([]), "{name}");
        let gain = &said["gain_dn_per_e"];
        let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
        let true_gain = truth["gain_dn_per_e"].as_f64().unwrap();
        assert!((value - true_gain).abs() < 3.5 * error, "{name}: {value} +- {error}, not {true_gain}");
    }
}

/// Bits that a link turned over, one sample in 20,000 to code 0 or to full scale, darks and first frames too:
/// every verb leaves them out and says how many, no slip is reported, no effect is named, and gain, read
/// noise and the pixels' dark reference are those of the same campaign without them within one of their
/// errors.
#[test]
fn bits_that_a_link_turned_over_change_nothing() {
    let clean = Campaign::new("cmos12", "quick", 41);
    let struck = Campaign::new("cmos12", "quick", 41);
    let mut random = PixelRng::new(41, Stream::Effect, 0, 0, 0);
    let mut turned = 0;
    for row in 0..struck.rows.len() {
        let mut codes = struck.frame(row);
        for code in &mut codes {
            let u = random.uniform();
            if u < 5e-5 {
                *code = if u < 2.5e-5 { 0 } else { 4095 };
                turned += 1;
            }
        }
        struck.put(row, &codes);
    }
    assert!(turned > 30, "{turned}");
    let value = |json: &serde_json::Value, name: &str| {
        (json[name]["value"].as_f64().unwrap(), json[name]["std_err"].as_f64().unwrap())
    };
    for verb in ["noise", "diagnose"] {
        let (expected, found) = (clean.said(verb), struck.said(verb));
        for name in ["gain_dn_per_e", "read_noise_e"] {
            let ((a, error), (b, _)) = (value(&expected, name), value(&found, name));
            assert!((a - b).abs() < error, "{verb} {name}: {a} +- {error}, {b}");
        }
        assert_eq!(found["data_faults"].as_array().unwrap().len(), 0, "{verb}: {:#}", found["data_faults"]);
        let notes = found["notes"].as_array().unwrap().iter().filter_map(|n| n.as_str());
        let said = notes.filter(|n| n.contains("bit errors")).count();
        assert_eq!(said, 1, "{verb}: {:#}", found["notes"]);
    }
    assert_eq!(struck.said("diagnose")["consistent"], true);
}
