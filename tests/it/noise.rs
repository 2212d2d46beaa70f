//! Section IV against simulated truth over many seeds, and against data of others.

use crate::far_slips::sweep;
use crate::rewritten::{Campaign, set_of_plan};
use crate::support::{expect, shared, small};
use radcam::dataset::Dataset;
use radcam::ndarray::Array2;
use radcam::noise::{self, Measured, Method, NoiseReport};
use radcam::statistics::level::LevelAccumulator;
use radcam::{dataset::Kind, fit::line::goodness};
use radcam_sim::rng::{PixelRng, Stream};
use radcam_sim::{Conditions, Sensor};
use serde_json::Value;
use std::sync::atomic::AtomicBool;

/// A campaign of the paper's size: 6 levels of light, 100 x 100 pixels, one pair each.
fn campaign(sensor: &Sensor, number: u64) -> Measured {
    let region = sensor.region();
    let mut levels = Vec::new();
    for (i, illumination) in [0.05, 0.2, 0.4, 0.6, 0.8, 1.0].into_iter().enumerate() {
        let c = Conditions { illumination, ..sensor.conditions(1.0 / 30.0) };
        let mut level = LevelAccumulator::new((100, 100), 8);
        let mut frames = [vec![0; 10_000], vec![0; 10_000]];
        for (j, frame) in frames.iter_mut().enumerate() {
            sensor.draw(number * 12 + 2 * i as u64 + j as u64, &c, region, frame);
        }
        level.add(&[&frames[0], &frames[1]]).unwrap();
        levels.push((i as u32, Kind::Flat, c.exposure_s, level.finish().unwrap()));
    }
    Measured {
        levels,
        full_scale_dn: 255.0,
        black_level_dn: Some(0.0),
        code_step_dn: 1.0,
        saturated: Vec::new(),
        carried_share: 0.0,
        darks_are_lit: false,
    }
}

/// Distance of an ordered sample from a distribution and its chance (Kolmogorov; Marsaglia's asymptotic
/// series).
fn kolmogorov(mut chances: Vec<f64>) -> f64 {
    chances.sort_by(f64::total_cmp);
    let n = chances.len() as f64;
    let d = chances
        .iter()
        .enumerate()
        .map(|(i, p)| (p - i as f64 / n).max((i as f64 + 1.0) / n - p))
        .fold(0.0, f64::max);
    let t = d * (n.sqrt() + 0.12 + 0.11 / n.sqrt());
    (2.0 * (1..100).map(f64::from).map(|k| (-1f64).powf(k - 1.0) * (-2.0 * k * k * t * t).exp()).sum::<f64>())
        .clamp(0.0, 1.0)
}

/// Inverse of the information about (A, sigma_C^2) that normal noise of these variances holds: Cramer and
/// Rao's bound on the variance of A.
fn cramer_rao_gain(sensor: &Sensor, gain: f64, constant: f64) -> f64 {
    let (mut aa, mut ac, mut cc) = (0.0, 0.0, 0.0);
    for illumination in [0.05, 0.2, 0.4, 0.6, 0.8, 1.0] {
        let c = Conditions { illumination, ..sensor.conditions(1.0 / 30.0) };
        let mean = sensor.predict(&c).mean_dn.mean().unwrap();
        let information = 9_999.0 / 2.0 / (gain * mean + constant).powi(2);
        aa += information * mean * mean;
        ac += information * mean;
        cc += information;
    }
    cc / (aa * cc - ac * ac)
}

struct Campaigns {
    reports: Vec<NoiseReport>,
    gain: f64,
    constant: f64,
    bound: f64,
}

fn campaigns(n: u64) -> Campaigns {
    let model = small("xc77", 100, 100);
    let (gain, constant) = (model.base.gain_dn_per_e, model.constant_noise_var_dn2(0.0));
    let sensor = Sensor::new(model).unwrap();
    let reports = (0..n)
        .map(|i| {
            let measured = campaign(&sensor, i);
            // The paper's camera has no black level: its zero is 0 DN by construction.
            let source = "the paper's camera has none";
            let zero = noise::Zero { dn: 0.0, std_err_dn: 0.0, source, moved_dn: 0.0 };
            noise::estimate(noise::points(&measured, &zero), &zero).unwrap()
        })
        .collect();
    let bound = cramer_rao_gain(&sensor, gain, constant);
    Campaigns { reports, gain, constant, bound }
}

/// 2000 campaigns: chi-square, coverage, efficiency. About four seconds.
#[test]
fn two_thousand_campaigns_of_the_paper() {
    let n = 2000;
    let Campaigns { reports, gain, constant, bound } = campaigns(n);
    let n = n as f64;
    for method in [Method::Paper, Method::Reweighted, Method::Likelihood] {
        let of: Vec<_> =
            reports.iter().map(|r| r.estimators.iter().find(|e| e.method == method).unwrap()).collect();
        let p = kolmogorov(of.iter().map(|e| goodness(e.chi2, e.dof as f64)).collect());
        let within = |z: f64, f: &dyn Fn(&noise::Estimate) -> (f64, f64)| {
            let hit = |e: &&&noise::Estimate| {
                let (off, error) = f(e);
                off.abs() <= z * error
            };
            of.iter().filter(hit).count() as f64 / n
        };
        let a = |e: &noise::Estimate| (e.gain_dn_per_e.value - gain, e.gain_dn_per_e.std_err);
        let c = |e: &noise::Estimate| {
            (e.constant_noise_var_dn2.value - constant, e.constant_noise_var_dn2.std_err)
        };
        let mean = of.iter().map(|e| e.gain_dn_per_e.value).sum::<f64>() / n;
        let spread =
            (of.iter().map(|e| (e.gain_dn_per_e.value - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        let (a68, a95, c68, c95) = (within(1.0, &a), within(1.96, &a), within(1.0, &c), within(1.96, &c));
        let (bias, ratio) = ((mean - gain) / (spread / n.sqrt()), spread / bound.sqrt());
        println!(
            "{method:?}: KS p {p:.3}; A covered {:.1} % and {:.1} %, constant {:.1} % and {:.1} %; \
             spread / bound {ratio:.3}, bias {bias:+.1} sigma",
            100.0 * a68,
            100.0 * a95,
            100.0 * c68,
            100.0 * c95
        );
        if method != Method::Paper {
            assert!(p > 0.01, "{method:?}: chi-square, p = {p}");
            for (got, wanted, room) in
                [(a68, 0.6827, 0.03), (c68, 0.6827, 0.03), (a95, 0.95, 0.015), (c95, 0.95, 0.015)]
            {
                assert!((got - wanted).abs() < room, "{method:?}: coverage {got} instead of {wanted}");
            }
            assert!((ratio - 1.0).abs() < 0.05, "{method:?}: spread over bound {ratio}");
            assert!(bias.abs() < 4.0, "{method:?}: bias {bias} sigma");
        }
    }
}

/// Datasets of a generator that shares no code with this project. The gain of the clean one within 1 %, and
/// within 4 of its standard errors; the constant noise too.
#[test]
fn a_camera_of_others_is_measured_right() {
    let Some(practice) = shared("practice") else { return };
    let dataset = Dataset::open(&practice.join("clean")).unwrap();
    let truth: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(practice.join("clean/truth.json")).unwrap()).unwrap();
    let truth = |name: &str| truth[name].as_f64().unwrap();
    let report = noise::of_dataset(&dataset, &AtomicBool::new(false), &mut |_, _| {}).unwrap();
    let a = report.gain_dn_per_e.clone();
    let gain = truth("gain_dn_per_e");
    assert!((a.value / gain - 1.0).abs() < 0.01);
    assert!((a.value - gain).abs() < 4.0 * a.std_err, "{a:?}");
    let c = report.constant_noise_var_dn2.clone();
    let constant = (gain * truth("read_noise_e")).powi(2) + 1.0 / 12.0;
    assert!((c.value - constant).abs() < 4.0 * c.std_err, "{c:?} {constant}");
    assert!((report.offset_dn.value - truth("offset_dn")).abs() < 0.1, "{:?}", report.offset_dn);
    assert!(report.consistent());
}

/// The paper's camera and two of today, a whole standard campaign each: pulls of A, constant noise and zero
/// over 24 specimens have unit size. The zero is compared with the mean of the drawn offsets.
#[test]
fn cameras_are_recovered_within_stated_errors_zero_included() {
    let (mut pulls, mut deviations) = (Vec::new(), 0);
    for seed in 0..24 {
        let name = ["cmos12", "ccd16", "xc77"][seed % 3];
        let mut model = small(name, 96, 80);
        model.base.seed = 900 + seed as u64;
        let (gain, constant) = (model.base.gain_dn_per_e, model.constant_noise_var_dn2(0.0));
        let sensor = Sensor::new(model.clone()).unwrap();
        let full_s = 0.85 * f64::from(model.full_scale_dn())
            / (gain * model.bench.photon_flux_per_s * model.base.quantum_efficiency);
        let mut levels = Vec::new();
        let sets = [(0.02, 0.0), (1.0, 0.0), (8.0, 0.0)]
            .into_iter()
            .chain((1..=8).map(|i| (f64::from(i) / 8.0, 1.0)));
        for (set, (exposure, illumination)) in sets.enumerate() {
            let c = Conditions { illumination, ..sensor.conditions(exposure * full_s) };
            let mut level = LevelAccumulator::new((80, 96), model.camera.bit_depth);
            for frame in 0..8 {
                let mut dn = vec![0; 96 * 80];
                sensor.draw(set as u64 * 8 + frame, &c, sensor.region(), &mut dn);
                level.add(&[&dn]).unwrap();
            }
            let kind = if illumination == 0.0 { Kind::Dark } else { Kind::Flat };
            levels.push((set as u32, kind, c.exposure_s, level.finish().unwrap()));
        }
        let measured = Measured {
            levels,
            full_scale_dn: model.full_scale_dn().into(),
            black_level_dn: Some(model.base.black_level_dn),
            code_step_dn: 1.0,
            saturated: Vec::new(),
            carried_share: 0.0,
            darks_are_lit: false,
        };
        let zero = noise::zero(&measured);
        let offset = model.base.black_level_dn + f64::from(sensor.maps().offset_dn.mean().unwrap());
        let report = noise::estimate(noise::points(&measured, &zero), &zero).unwrap();
        let (a, c) = (report.gain_dn_per_e, report.constant_noise_var_dn2);
        pulls.push((a.value - gain) / a.std_err);
        pulls.push((c.value - constant) / c.std_err);
        pulls.push((zero.dn - offset) / zero.std_err_dn);
        deviations += usize::from(report.q < 0.01);
    }
    let n = pulls.len() as f64;
    let square = pulls.iter().map(|p| p * p).sum::<f64>() / n;
    // Errors from the scatter of few frames give pulls with heavier tails than normal ones: 2.5 in place of
    // 2.
    assert!((square - 1.0).abs() < 4.0 * (2.5 / n).sqrt(), "mean square of the pulls {square}: {pulls:.1?}");
    assert!(pulls.iter().all(|p| p.abs() < 5.0), "{pulls:.1?}");
    assert!(deviations <= 2, "{deviations} of 24 with Q below 0.01");
}

/// Means with the black level in them, and no darks: the variances meet zero at it, `noise` and `diagnose`
/// say so, and both have the gain.
#[test]
fn a_black_level_in_the_means_of_a_table_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("ptc.csv");
    let rows = [200.0, 300.0, 500.0, 900.0, 1400.0, 2200.0, 3000.0].iter().enumerate().map(|(k, mean)| {
        let off = 1.0 + 0.002 * [1.0, -1.0, 0.5, 0.0, -0.5, 1.0, -1.0][k];
        format!("{mean},{}\n", 0.35 * (mean - 128.0) * off)
    });
    std::fs::write(&file, format!("mean_dn,var_dn2\n{}", rows.collect::<String>())).unwrap();
    for verb in ["noise", "diagnose"] {
        let said = crate::support::radcam(&[verb, file.to_str().unwrap(), "--json"]);
        let json: serde_json::Value = serde_json::from_slice(&said.stdout).unwrap();
        let gain = &json["gain_dn_per_e"];
        let (value, error) = (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap());
        assert!((value - 0.35).abs() < 3.0 * error && error < 0.01, "{verb}: {value} +- {error}");
        assert!(
            json["notes"].to_string().contains("the variances meet zero at a mean of 12"),
            "{verb}: {json}"
        );
    }
}

/// Frames whose neighbours or successors share noise have a line, and a gain that is too low by what they
/// share: it is said with its error, and exit code 1. Practice campaigns of others, the gain that follows
/// within four standard errors and 1 % (crosstalk acts on the light, not on the noise of reading); frames of
/// ours of which two by two or two neighbours are the mean, a sharpened one, and a mean with the frame
/// before.
#[test]
fn noise_that_pixels_or_frames_share_is_said() {
    let said = |code: i32, path: &str| -> Value {
        serde_json::from_str(&expect(code, &["noise", path, "--json"])).unwrap()
    };
    let is_near = |v: &Value, truth: f64, name: &str| {
        let of = |q: &str, part: &str| v[q][part].as_f64().unwrap();
        let factor = 1.0 + of("shared_noise_rel", "value");
        let gain = of("gain_dn_per_e", "value") * factor;
        let error = (of("gain_dn_per_e", "std_err") * factor)
            .hypot(of("gain_dn_per_e", "value") * of("shared_noise_rel", "std_err"));
        assert!((gain - truth).abs() < 4.0 * error + 0.01 * truth, "{name}: {gain} +- {error} for {truth}");
    };
    if let Some(root) = shared("practice/interpixel-crosstalk") {
        let v = said(1, root.to_str().unwrap());
        is_near(&v, 0.27727, "crosstalk");
        let text = expect(1, &["noise", root.to_str().unwrap()]);
        let beside = text.lines().position(|l| l.contains("shared noise")).unwrap();
        assert!(
            beside < 7 && v["notes"][0].as_str().unwrap().contains("neighbouring pixels share"),
            "{text}"
        );
    }
    // Covariances of neighbours grow with the level there, and the gain at the dark end is right.
    if let Some(root) = shared("practice/brighter-fatter") {
        let v = said(1, root.to_str().unwrap());
        assert!(v["shared_noise_rel"].is_null(), "{}", v["notes"]);
    }
    let new = |seed| Campaign::of_region("cmos12", "standard", [256, 192], seed);
    assert!(new(41).said("noise")["shared_noise_rel"].is_null());
    let next = |a: &Array2<f64>, k: isize, axis: usize| {
        let n = a.dim();
        let at = |i: usize, n: usize, k: isize| (i as isize + k).rem_euclid(n as isize) as usize;
        Array2::from_shape_fn(
            n,
            |(y, x)| {
                if axis == 1 { a[[y, at(x, n.1, k)]] } else { a[[at(y, n.0, k), x]] }
            },
        )
    };
    type Change<'a> = &'a dyn Fn(&Array2<f64>, &Array2<f64>) -> Array2<f64>;
    let two = |a: &Array2<f64>, axis: usize| 0.5 * (a + &next(a, 1, axis));
    // Frames made of a frame and the one before it.
    let changes: [(&str, Change<'_>); 4] = [
        ("mean of two", &|a, _| two(a, 1)),
        ("mean of two by two", &|a, _| two(&two(a, 1), 0)),
        ("sharpened", &|a, _| 1.4 * a - 0.2 * (next(a, 1, 1) + next(a, -1, 1))),
        ("filtered", &|a, before| 0.5 * (a + before)),
    ];
    for (seed, (name, change)) in (42..).zip(changes) {
        let campaign = new(seed);
        let mut before: Option<(String, Array2<f64>)> = None;
        for row in 0..campaign.rows.len() {
            let set = campaign.rows[row][2].clone();
            let own = campaign.frame(row).mapv(f64::from);
            let last = before.filter(|b| b.0 == set).map_or_else(|| own.clone(), |b| b.1);
            campaign.put(row, &change(&own, &last).mapv(|v| v.round().clamp(0.0, 4095.0) as u16));
            before = Some((set, own));
        }
        let v = said(1, &campaign.path());
        if name == "filtered" {
            // The least of it: a mean of two frames has half the variance.
            let rel = v["shared_noise_rel"]["value"].as_f64().unwrap();
            assert!((0.5..1.1).contains(&rel), "{name}: {rel}");
        } else {
            is_near(&v, 0.38, name);
        }
    }
}

/// Dark charge whose level the camera takes off leaves its noise in flats of long exposures: before, the gain
/// was
/// 0.447 for 0.38 here, with exit code 0 where the levels happened to lie on a line.
#[test]
fn the_noise_of_clamped_charge_is_no_gain() {
    let folder = tempfile::tempdir().unwrap();
    let (model, plan) = (folder.path().join("m.toml"), folder.path().join("plan.toml"));
    let model = model.to_str().unwrap();
    expect(0, &["model", "new", model, "--sensor", "cmos12"]);
    expect(0, &["model", "add", model, "black-level-clamp", "dark_e_per_s=100000"]);
    let exposures = [0.05, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9];
    let sets = |kind: &str, light: f64| exposures.map(|t| set_of_plan(kind, 6, t, light)).concat();
    let text = format!("format = \"radcam-plan/1\"\n{}{}", sets("dark", 0.0), sets("flat", 1.0));
    std::fs::write(&plan, text).unwrap();
    for seed in 262..266 {
        let said = Campaign::new(model, plan.to_str().unwrap(), seed).said("noise");
        let value =
            |name: &str| (said[name]["value"].as_f64().unwrap(), said[name]["std_err"].as_f64().unwrap());
        let ((gain, error), (read, read_error)) = (value("gain_dn_per_e"), value("read_noise_e"));
        assert!((gain - 0.38).abs() < 4.0 * error && error < 0.004, "{gain} +- {error}");
        assert!((read - 2.6).abs() < 4.0 * read_error + 0.1, "{read} +- {read_error}");
        assert!(
            said["notes"].to_string().contains("takes the level of the dark charge off"),
            "{}",
            said["notes"]
        );
    }
}

/// Dark charge whose level the camera takes off, beside flats of one exposure: a shorter dark has less noise,
/// and is no average. Before, it was left out, and the read noise was that of the charge.
#[test]
fn a_short_dark_of_clamped_charge_is_no_average() {
    let folder = tempfile::tempdir().unwrap();
    let (model, plan) = (folder.path().join("m.toml"), folder.path().join("plan.toml"));
    let model = model.to_str().unwrap();
    expect(0, &["model", "new", model, "--sensor", "cmos12"]);
    expect(0, &["model", "add", model, "black-level-clamp", "dark_e_per_s=3000"]);
    let darks = [1.0, 0.1, 1.0].map(|t| set_of_plan("dark", 4, t, 0.0)).concat();
    let flats =
        [0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9].map(|light| set_of_plan("flat", 4, 1.0, light)).concat();
    std::fs::write(&plan, format!("format = \"radcam-plan/1\"\n{darks}{flats}")).unwrap();
    for seed in 266..268 {
        let campaign = Campaign::new(model, plan.to_str().unwrap(), seed);
        // Pixels differ in dark charge: the pattern of long exposures.
        let mut random = PixelRng::new(u64::from(seed), Stream::Effect, 0, 0, 0);
        let charge: Vec<f64> = (0..160 * 128).map(|_| 4.0 * random.normal()).collect();
        let longest = campaign.rows.iter().map(|r| r[4].parse::<f64>().unwrap()).fold(0.0, f64::max);
        for row in 0..campaign.rows.len() {
            let share = campaign.rows[row][4].parse::<f64>().unwrap() / longest;
            let mut frame = campaign.frame(row);
            for (v, charge) in frame.iter_mut().zip(&charge) {
                *v = (f64::from(*v) + share * charge).round() as u16;
            }
            campaign.put(row, &frame);
        }
        let said = campaign.said("diagnose");
        assert_eq!(said["data_faults"], serde_json::json!([]));
        assert_eq!(said["missing"][0]["effect"], "black-level-clamp", "{}", said["verdict"]);
    }
}

/// Two frames a set of pixels that share 3 % of their charge with each of four neighbours: what the next
/// pixels share is said, with the gain, where what all neighbours share is not told.
#[test]
fn noise_that_few_frames_share_is_said() {
    let campaign = sweep(&[0.3, 0.5, 0.7, 0.95], &[0.3, 0.5, 0.7, 0.95], 2, 268);
    for row in campaign.sets("flat", 2).into_iter().flat_map(|set| campaign.of(set)) {
        let frame = campaign.frame(row).mapv(f64::from);
        let (rows, columns) = frame.dim();
        let at = |y: usize, x: usize| frame[(y.min(rows - 1), x.min(columns - 1))];
        let shared = radcam::ndarray::Array2::from_shape_fn((rows, columns), |(y, x)| {
            let near = at(y + 1, x) + at(y.saturating_sub(1), x) + at(y, x + 1) + at(y, x.saturating_sub(1));
            (0.88 * at(y, x) + 0.03 * near).round() as u16
        });
        campaign.put(row, &shared);
    }
    let said = campaign.said("noise");
    let shared = &said["shared_noise_rel"];
    let (value, error) = (shared["value"].as_f64().unwrap(), shared["std_err"].as_f64().unwrap());
    // The variance of the kernel is 0.88^2 + 4 0.03^2, its sum 1; its next pixels share 4 (2 0.88 0.03) of
    // that.
    let own = 0.88f64.powi(2) + 4.0 * 0.03f64.powi(2);
    assert!((own + 4.0 * 2.0 * 0.88 * 0.03 - own * (1.0 + value)).abs() < 4.0 * error + 0.01, "{shared}");
    assert!(said["notes"].to_string().contains("neighbouring pixels share noise"), "{}", said["notes"]);
}
