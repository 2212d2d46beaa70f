//! Darks that are not of the flats, or that hold light or charge, in campaigns of simulated cameras.

use crate::data_faults::{BLACK_DN, few_darks};
use crate::far_slips::is_named;
use crate::rewritten::{Campaign, set_of_plan};
use radcam::ndarray::{Array2, s};
use radcam_sim::rng::{PixelRng, Stream};

/// One fault is said, of all darks; the gain is right, and so is the read noise, if there is one.
fn has_foreign_darks(campaign: &Campaign, words: &str) {
    let said = campaign.said("noise");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!(faults.len(), 1, "{words}: {faults:?}");
    assert_eq!(faults[0]["kind"], "other-settings");
    assert_eq!(faults[0]["sets"].as_array().unwrap().len(), campaign.sets("dark", 1).len());
    assert!(faults[0]["text"].as_str().unwrap().contains(words), "{faults:?}");
    let gain = &said["gain_dn_per_e"];
    let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
    assert!((value - 0.38).abs() < 4.0 * error, "{words}: {value} +- {error}");
    // The read noise is that of the flats alone, above the black level that the camera states.
    let (value, error) = (said["read_noise_e"]["value"].as_f64(), said["read_noise_e"]["std_err"].as_f64());
    assert!(value.is_none_or(|v| (v - 3.0).abs() < 4.0 * error.unwrap()), "{words}: {value:?} +- {error:?}");
}

/// All darks of another gain, black level, orientation or camera than the flats, which no dark among them
/// shows and no name says: named, and their noise is no read noise.
#[test]
fn darks_that_are_not_of_the_flats_are_named() {
    let sensor = |gain: f64, seed: u32| {
        let mut model = crate::support::small("cmos12", 160, 128);
        model.base.gain_dn_per_e = gain;
        model.base.seed = seed.into();
        // Offsets of the pixels, which an analog gain behind them multiplies.
        model.base.offset_spread_dn = 4.0 * gain;
        model
    };
    let campaign = |gain: f64, seed: u32| {
        let file = tempfile::NamedTempFile::with_suffix(".toml").unwrap();
        std::fs::write(file.path(), sensor(gain, seed).to_toml().unwrap()).unwrap();
        Campaign::new(file.path().to_str().unwrap(), "emva1288", seed)
    };
    let others = [("another gain", 0.76, 60), ("not in the flats", 0.38, 61)];
    for (words, gain, seed) in others {
        let own = campaign(0.38, 60);
        let other = campaign(gain, seed);
        own.change_darks(|row| other.frame(row));
        has_foreign_darks(&own, words);
    }
    let own = campaign(0.38, 62);
    own.change_darks(|row| own.frame(row).slice(s![..;-1, ..;-1]).to_owned());
    has_foreign_darks(&own, "turned by 180 degrees");
    let own = campaign(0.38, 63);
    own.change_darks(|row| own.frame(row).mapv(|v| v + 20));
    has_foreign_darks(&own, "another black level than the flats, 19.9");
}

/// Dim flats that are called darks have the response of the pixels in them, and the brighter half of the
/// flats may be shifted by a row.
#[test]
fn light_in_darks_and_shifted_flats_are_named() {
    let mut campaign = Campaign::new("cmos12", "standard", 65);
    let level = |c: &Campaign, set: u32| c.frame(c.of(set)[0]).mapv(f64::from).mean().unwrap();
    campaign.rows.retain(|row| row[1] == "flat");
    let mut flats = campaign.sets("flat", 2);
    flats.sort_by(|a, b| level(&campaign, *a).total_cmp(&level(&campaign, *b)));
    let dimmest = flats.iter().copied().find(|f| level(&campaign, *f) > 250.0).unwrap();
    for set in flats.into_iter().take_while(|f| *f != dimmest).chain([dimmest]) {
        let rows = campaign.of(set);
        rows.iter().for_each(|r| (campaign.rows[*r][1], campaign.rows[*r][5]) = ("dark".into(), "0".into()));
    }
    campaign.save();
    let said = campaign.said("noise");
    let faults = said["data_faults"].to_string();
    assert!(faults.contains("the response of the pixels to light is in them"), "{faults}");
    let read = &said["read_noise_e"];
    let error = read["std_err"].as_f64();
    assert!(read["value"].as_f64().is_none_or(|v| (v - 2.6).abs() < 4.0 * error.unwrap()), "{read}");

    let campaign = Campaign::new("cmos12", "standard", 66);
    let flats = campaign.sets("flat", 2);
    let bright: Vec<u32> = flats.iter().copied().filter(|f| level(&campaign, *f) > 1500.0).collect();
    for row in bright.iter().flat_map(|f| campaign.of(*f)) {
        let frame = campaign.frame(row);
        let (rows, columns) = frame.dim();
        let down = |(y, x): (usize, usize)| frame[((y + 1) % rows, x)];
        campaign.put(row, &Array2::from_shape_fn((rows, columns), down));
    }
    let said = campaign.said("noise");
    let faults = said["data_faults"].as_array().unwrap();
    assert_eq!(faults.len(), 1, "{faults:?}");
    let text = faults[0]["text"].as_str().unwrap();
    assert!(text.contains("1 rows and 0 columns off against the other flats"), "{text}");
}

/// A cap that lets in 0.2 and 0.4 % of the flats' light: 6 and 12 DN in the longest darks. It is named with
/// its share within four standard errors, and no verb has a dark current; without it there is none of this.
#[test]
fn a_small_leak_is_no_dark_current() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan.toml");
    for (leak, seed) in [(0.002, 228), (0.004, 229), (0.0, 230)] {
        let kind = if leak > 0.0 { "flat" } else { "dark" };
        let shares = [0.1, 0.2, 0.3, 0.45, 0.6, 0.85];
        let darks = shares.map(|share| set_of_plan(kind, 16, share, leak)).concat();
        let flats = shares.map(|share| set_of_plan("flat", 16, share, 1.0)).concat();
        std::fs::write(&plan, format!("format = \"radcam-plan/1\"\n{darks}{flats}")).unwrap();
        let mut campaign = Campaign::new("cmos12", plan.to_str().unwrap(), seed);
        for row in 0..shares.len() * 16 {
            (campaign.rows[row][1], campaign.rows[row][5]) = ("dark".into(), "0".into());
        }
        campaign.save();
        let said = campaign.said("diagnose");
        let faults = said["data_faults"].as_array().unwrap();
        if leak == 0.0 {
            assert!(faults.is_empty(), "{faults:?}");
            continue;
        }
        assert_eq!((faults.len(), &faults[0]["left_out"]), (1, &false.into()), "{leak}: {faults:?}");
        let text = faults[0]["text"].as_str().unwrap();
        let words: Vec<&str> =
            text.split("light leaks into the darks, ").nth(1).unwrap().split(' ').collect();
        let (percent, error): (f64, f64) = (words[0].parse().unwrap(), words[2].parse().unwrap());
        assert!((percent - 100.0 * leak).abs() < 4.0 * error, "{text}");
        assert!(said["dark_current_e_per_s"].is_null(), "{}", said["dark_current_e_per_s"]);
        let emva = campaign.said("emva").to_string();
        assert!(
            !emva.contains("\"u_I_mean\":{") && emva.contains("u_I_mean and u_I_var are undefined"),
            "{emva}"
        );
    }
}

/// Dark-subtracted flats beside raw darks: the gain comes from the flats alone, the read noise is not
/// determined, and darks that were left out clip nothing.
#[test]
fn dark_subtracted_flats_are_named() {
    let campaign = few_darks("cmos12", &[0.15, 0.3, 0.45, 0.6, 0.75, 0.9], 64);
    let flats = (0..campaign.rows.len()).filter(|row| campaign.rows[*row][1] == "flat");
    flats.for_each(|row| campaign.put(row, &campaign.frame(row).mapv(|v| v.saturating_sub(BLACK_DN as u16))));
    has_foreign_darks(&campaign, "the flats are dark-subtracted");
    assert!(campaign.said("noise")["read_noise_e"]["value"].is_null());
    assert_eq!(campaign.said("diagnose")["missing"], serde_json::json!([]));
}

/// The darks of a noisy camera lost a bit, and the flats did not: before, half of the read noise and no word.
#[test]
fn darks_that_lost_a_bit_are_named() {
    let mut model = crate::support::small("cmos12", 160, 128);
    model.base.read_noise_e = 20.0;
    let file = tempfile::NamedTempFile::with_suffix(".toml").unwrap();
    std::fs::write(file.path(), model.to_toml().unwrap()).unwrap();
    let campaign = few_darks(file.path().to_str().unwrap(), &[0.15, 0.3, 0.45, 0.6, 0.75, 0.9], 66);
    let darks = (0..campaign.rows.len()).filter(|row| campaign.rows[*row][1] == "dark");
    darks.for_each(|row| campaign.put(row, &campaign.frame(row).mapv(|v| v >> 1)));
    let said = campaign.said("noise");
    assert!(said["data_faults"].to_string().contains("divided by 2"), "{}", said["data_faults"]);
    let (value, error) = (&said["gain_dn_per_e"]["value"], &said["gain_dn_per_e"]["std_err"]);
    let (value, error) = (value.as_f64().unwrap(), error.as_f64().unwrap());
    assert!((value - 0.38).abs() < 4.0 * error, "{value} +- {error}");
}

/// One of two darks has three quarters of the gain: nothing tells that from averaging, and both are said.
#[test]
fn one_of_two_darks_is_not_called_averaged() {
    let campaign = few_darks("python5000", &[0.2, 0.4, 0.6, 0.8, 1.0], 74);
    let long = campaign.sets("dark", 2)[1];
    campaign.of(long).into_iter().for_each(|row| campaign.scale(row, 0.75, 30.0));
    let faults = campaign.said("noise")["data_faults"].to_string();
    assert!(!faults.contains("dependent-frames"), "{faults}");
    assert!(faults.contains("the darks differ in gain or camera"), "{faults}");
}

/// The names of long and short darks are exchanged: hot pixels know.
#[test]
fn exchanged_exposures_of_darks_are_named() {
    // With a charge that moves the level of all pixels, and with next to none.
    exposures_are_exchanged(64, 30, 400);
    exposures_are_exchanged(65, 0, 90);
}

fn exposures_are_exchanged(seed: u32, charge_dn: u16, hot_dn: u16) {
    let mut campaign = Campaign::new("cmos12", "standard", seed);
    let darks = campaign.sets("dark", 2);
    let exposure = |c: &Campaign, set: u32| c.rows[c.of(set)[0]][4].clone();
    let by = |c: &Campaign, set: &u32| exposure(c, *set).parse::<f64>().unwrap();
    let longest = *darks.iter().max_by(|a, b| by(&campaign, a).total_cmp(&by(&campaign, b))).unwrap();
    let shortest = *darks.iter().min_by(|a, b| by(&campaign, a).total_cmp(&by(&campaign, b))).unwrap();
    // Hours at room temperature: a campaign with charge.
    for row in campaign.of(longest) {
        let hot = |((y, x), v): ((usize, usize), &u16)| {
            v + charge_dn + hot_dn * u16::from((7 * y + 13 * x) % 97 == 0)
        };
        let frame = campaign.frame(row);
        let codes = Array2::from_shape_vec(frame.dim(), frame.indexed_iter().map(hot).collect()).unwrap();
        campaign.put(row, &codes);
    }
    let (short_s, long_s) = (exposure(&campaign, shortest), exposure(&campaign, longest));
    for (set, exposure_s) in [(shortest, long_s), (longest, short_s)] {
        campaign.of(set).into_iter().for_each(|row| campaign.rows[row][4] = exposure_s.clone());
    }
    campaign.save();
    let said = campaign.said("noise");
    let faults = said["data_faults"].as_array().unwrap();
    let text = faults[0]["text"].as_str().unwrap();
    assert!(faults.len() == 1 && text.contains("the exposures of these darks are exchanged"), "{faults:?}");
    let sets = faults[0]["sets"].as_array().unwrap();
    assert!(sets.contains(&shortest.into()) && sets.contains(&longest.into()), "{faults:?}");
}

/// A digital gain of 1.5 in the longer flats makes their pattern grow by more than that of the darks: more
/// light than these have is no leak.
#[test]
fn a_gain_of_the_longer_flats_is_no_leak() {
    let plan = tempfile::tempdir().unwrap();
    let file = plan.path().join("plan.toml");
    let times = [0.15, 0.3, 0.45, 0.6];
    let of = |kind: &str, light: f64| times.map(|t| set_of_plan(kind, 4, t, light)).concat();
    std::fs::write(&file, format!("format = \"radcam-plan/1\"\n{}{}", of("dark", 0.0), of("flat", 1.0)))
        .unwrap();
    let campaign = Campaign::new("cmos12", file.to_str().unwrap(), 240);
    for kind in ["dark", "flat"] {
        for (set, time) in campaign.sets(kind, 2).iter().zip(times) {
            for row in campaign.of(*set) {
                let mut codes = campaign.frame(row);
                for ((y, x), code) in codes.indexed_iter_mut() {
                    let uneven = PixelRng::new(5, Stream::Effect, 0, y as u32, x as u32).uniform();
                    *code += (60.0 * time * uneven).round() as u16;
                }
                campaign.put(row, &codes);
                if kind == "flat" && time > 0.4 {
                    campaign.scale(row, 1.5, BLACK_DN);
                }
            }
        }
    }
    let faults = campaign.said("noise")["data_faults"].to_string();
    assert!(!faults.contains("leaks"), "{faults}");
}

/// Two of five darks exchanged, neither the shortest: the level as stated grows with no exposure, and the hot
/// pixels know which two. As stated right, nothing is said.
#[test]
fn one_exchanged_pair_among_darks_is_named() {
    let plan = tempfile::tempdir().unwrap();
    let file = plan.path().join("plan.toml");
    let times = [0.1, 0.3, 0.5, 0.8, 1.0];
    let darks = times.map(|t| set_of_plan("dark", 4, t, 0.0)).concat();
    let flats = [0.2, 0.4, 0.5, 0.6, 0.8].map(|light| set_of_plan("flat", 4, 1.0, light)).concat();
    std::fs::write(&file, format!("format = \"radcam-plan/1\"\n{darks}{flats}")).unwrap();
    for (is_exchanged, seed) in [(true, 238), (false, 239)] {
        let mut campaign = Campaign::new("cmos12", file.to_str().unwrap(), seed);
        let sets = campaign.sets("dark", 2);
        for (set, time) in sets.iter().zip(times) {
            for row in campaign.of(*set) {
                let mut codes = campaign.frame(row);
                for ((y, x), code) in codes.indexed_iter_mut() {
                    *code += (90.0 * time * f64::from((7 * y + 13 * x) % 97 == 0)).round() as u16;
                }
                campaign.put(row, &codes);
            }
        }
        let of = |c: &Campaign, set: u32| c.rows[c.of(set)[0]][4].clone();
        let (short_s, long_s) = (of(&campaign, sets[1]), of(&campaign, sets[3]));
        if is_exchanged {
            for (set, exposure_s) in [(sets[1], long_s), (sets[3], short_s)] {
                campaign.of(set).into_iter().for_each(|row| campaign.rows[row][4] = exposure_s.clone());
            }
            campaign.save();
        }
        let faults = campaign.said("noise")["data_faults"].clone();
        let wanted = if is_exchanged { 1 } else { 0 };
        assert_eq!(faults.as_array().unwrap().len(), wanted, "{faults}");
        if is_exchanged {
            assert_eq!(faults[0]["sets"], serde_json::json!([sets[1], sets[3]]), "{faults}");
            assert!(faults[0]["text"].as_str().unwrap().contains("are exchanged"), "{faults}");
        }
    }
}

/// Darks from short to far longer than the flats, whose hot pixels are full and whose pattern is that of the
/// dark charge: nothing is wrong with them.
#[test]
fn long_darks_are_no_slip() {
    let mut campaign = Campaign::new("cmos12", "standard", 71);
    let darks = campaign.sets("dark", 2);
    let mut random = PixelRng::new(71, Stream::Effect, 0, 0, 0);
    let first = campaign.frame(campaign.of(darks[0])[0]);
    // Dark charge of each pixel, DN/s: lognormal, and one in fifty is hot.
    let rate: Vec<f64> = (0..first.len())
        .map(|i| 8.0 * (0.8 * random.normal()).exp() * if i % 53 == 0 { 60.0 } else { 1.0 })
        .collect();
    for (set, exposure_s) in darks.iter().zip([0.02, 0.5, 2.0, 5.0, 10.0, 20.0]) {
        for row in campaign.of(*set) {
            let frame = campaign.frame(row);
            let charge = |(v, rate): (&u16, &f64)| {
                let dn = rate * exposure_s;
                let noisy = f64::from(*v) + dn + (0.4 * dn).sqrt() * random.normal();
                noisy.round().clamp(0.0, 4095.0) as u16
            };
            let codes: Vec<u16> = frame.iter().zip(&rate).map(charge).collect();
            campaign.put(row, &Array2::from_shape_vec(frame.dim(), codes).unwrap());
            campaign.rows[row][4] = exposure_s.to_string();
        }
    }
    campaign.save();
    let said = campaign.said("noise");
    assert!(said["data_faults"].as_array().is_none_or(Vec::is_empty), "{}", said["data_faults"]);
}

/// Two darks with exchanged exposures on a sensor without a pattern: their noise has the charge.
#[test]
fn exchanged_darks_are_told_by_the_noise_of_their_charge() {
    let mut campaign = Campaign::new("cmos12", "standard", 72);
    let darks = campaign.sets("dark", 2);
    let (short, long) = (darks[0], darks[1]);
    let gain = expected_gain(&campaign);
    let mut random = PixelRng::new(72, Stream::Effect, 0, 0, 0);
    let mean_dn = 40.0;
    // The one stated as short has the charge.
    for (set, charged) in [(short, true), (long, false)] {
        for row in campaign.of(set) {
            campaign.rows[row][4] = if charged { "0.001".into() } else { "0.02".into() };
            let frame = campaign.frame(row);
            let more = |v: &u16| {
                let noise = (gain * mean_dn).sqrt() * random.normal();
                if charged { (f64::from(*v) + mean_dn + noise).round() as u16 } else { *v }
            };
            let codes: Vec<u16> = frame.iter().map(more).collect();
            campaign.put(row, &Array2::from_shape_vec(frame.dim(), codes).unwrap());
        }
    }
    let others: Vec<usize> = darks[2..].iter().flat_map(|set| campaign.of(*set)).collect();
    campaign.rows =
        (0..campaign.rows.len()).filter(|r| !others.contains(r)).map(|r| campaign.rows[r].clone()).collect();
    campaign.save();
    let said = campaign.said("noise");
    let text = said["data_faults"][0]["text"].as_str().unwrap_or_default();
    assert!(text.contains("the exposures of these darks are exchanged"), "{}", said["data_faults"]);
}

/// System gain of a campaign as it was drawn, DN/e.
fn expected_gain(campaign: &Campaign) -> f64 {
    campaign.said("noise")["gain_dn_per_e"]["value"].as_f64().unwrap()
}

/// Darks of one exposure with charge in them: the noise of the charge is no read noise, and is said.
#[test]
fn charge_in_the_only_dark_is_no_read_noise() {
    let mut campaign = Campaign::new("cmos12", "standard", 73);
    let gain = expected_gain(&campaign);
    let darks = campaign.sets("dark", 2);
    let others: Vec<usize> = darks[1..].iter().flat_map(|set| campaign.of(*set)).collect();
    let mut random = PixelRng::new(73, Stream::Effect, 0, 0, 0);
    let mean_dn = 30.0;
    for row in campaign.of(darks[0]) {
        let frame = campaign.frame(row);
        let more =
            |v: &u16| (f64::from(*v) + mean_dn + (gain * mean_dn).sqrt() * random.normal()).round() as u16;
        let codes: Vec<u16> = frame.iter().map(more).collect();
        campaign.put(row, &Array2::from_shape_vec(frame.dim(), codes).unwrap());
    }
    campaign.rows =
        (0..campaign.rows.len()).filter(|r| !others.contains(r)).map(|r| campaign.rows[r].clone()).collect();
    campaign.save();
    campaign.forget_black_level();
    let said = campaign.said("noise");
    assert!(said["read_noise_e"]["value"].is_null(), "{said}");
    assert!(said["notes"].to_string().contains("so much dark charge is in them"), "{}", said["notes"]);
}

/// Longest of many darks, 7 DN higher where the darks before it grow by 0.6 DN each: another black level is
/// named, and no other gain, since its noise is that of its charge.
#[test]
fn a_longest_dark_of_another_black_level_is_named() {
    let campaign = Campaign::new("cmos12", "emva1288", 244);
    let exposure_s = |set: &u32| campaign.rows[campaign.of(*set)[0]][4].parse::<f64>().unwrap();
    let darks = campaign.sets("dark", 2);
    let longest = darks.into_iter().max_by(|a, b| exposure_s(a).total_cmp(&exposure_s(b))).unwrap();
    for row in campaign.of(longest) {
        campaign.put(row, &campaign.frame(row).mapv(|v| v + 7));
    }
    is_named(&campaign, "other-settings", &[longest], "another black level: its level is 6.9");
}
