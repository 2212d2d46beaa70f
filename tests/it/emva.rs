//! EMVA 1288: the numbers of the reference tool, with errors that hold.

use crate::support::{camera, expect, radcam, refused, shared};
use radcam::capture::Capture;
use radcam::dataset::Dataset;
use radcam::emva::{Definitions, EmvaError, Evaluation, Limit, evaluate, of_dataset};
use radcam::plan::Plan;
use radcam_sim::Model;
use radcam_sim::rng::{PixelRng, Stream};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Compares every number that the reference tool prints with ours under its definitions, to 1e-6 of itself;
/// how many.
pub fn same_as_the_tool(ours: &Evaluation, tool: &serde_json::Map<String, serde_json::Value>) -> usize {
    let mut compared = 0;
    for (name, of_tool) in tool {
        // Places in the tool's lists; histograms are compared elsewhere.
        let info = name.starts_with("index_") || name.starts_with("histogram_") || name == "s2q";
        if info || name.ends_with("_area") && of_tool.is_null() {
            continue;
        }
        let of_tool = of_tool.get("value").unwrap_or(of_tool);
        let ours = ours.quantities.get(name).unwrap_or_else(|| panic!("{name} is missing"));
        match (of_tool.as_f64(), ours) {
            (None, None) => {}
            (Some(value), Some(q)) => {
                // The tool iterates its line of the darks, in nanoseconds, and stops short of the solution by
                // up to a few ten-thousandths of its standard error (rational arithmetic gives ours).
                let iterated = if name.starts_with("u_I") { 1e-3 * q.std_err } else { 0.0 };
                assert!(
                    (q.value - value).abs() <= 1e-6 * value.abs() + iterated,
                    "{name}: {} and {value}",
                    q.value
                );
                assert!(q.std_err >= 0.0 && q.std_err.is_finite(), "{name}: {q}");
            }
            (value, ours) => panic!("{name}: {value:?} and {ours:?}"),
        }
        compared += 1;
    }
    compared
}

/// Frames of a real camera: every quantity that the reference tool (PyPI emva1288 1.0.2) prints for them.
#[test]
fn every_quantity_is_the_reference_tools() {
    let Some(real) = shared("real/emva_ccd12") else { return };
    let file = real.join("EMVA1288_Data.txt");
    let arguments = ["emva", file.to_str().unwrap(), "--as", "reference-tool", "--json"];
    let ours: Evaluation = serde_json::from_str(&expect(0, &arguments)).unwrap();
    let text = std::fs::read_to_string(real.join("reference_tool.json")).unwrap();
    let tool: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(same_as_the_tool(&ours, tool.as_object().unwrap()), 47);
    // What is null is said.
    assert!(ours.notes.iter().any(|n| n.starts_with("DSNU1288_pixel")), "{:?}", ours.notes);
}

/// The tool itself, in an environment of its own; says so where it is not there.
pub fn tool() -> Option<impl Fn(&[&str]) -> serde_json::Value> {
    let Some(venv) = std::env::var_os("RADCAM_TEST_EMVA") else {
        println!(
            "SKIPPED: RADCAM_TEST_EMVA names no environment with emva1288 (.ci/test makes one where PyPI can be reached)"
        );
        return None;
    };
    let python = Path::new(&venv).join("bin/python");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/outside/emva.py");
    Some(move |arguments: &[&str]| {
        let output = std::process::Command::new(&python).arg(&script).args(arguments).output().unwrap();
        let err = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{arguments:?}: {err}");
        serde_json::from_slice(&output.stdout).unwrap()
    })
}

/// x and y of the first series of a plot's CSV.
fn first_series(folder: &Path, plot: &str) -> (Vec<f64>, Vec<f64>) {
    let mut reader = csv::Reader::from_path(folder.join("plots").join(format!("{plot}.csv"))).unwrap();
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    let column = |k: usize| {
        let of = rows.iter().filter(|r| r[0] == rows[0][0]).map(|r| r[k].parse().unwrap());
        of.collect::<Vec<f64>>()
    };
    (column(1), column(2))
}

/// Ten random cameras of the tool's own simulator, 8 to 16 bits, by exposure and by light: its numbers and
/// its histograms.
#[test]
fn ten_cameras_of_the_tool_are_evaluated_as_it_does() {
    let Some(tool) = tool() else { return };
    let dir = tempfile::tempdir().unwrap();
    for seed in 1..=10u32 {
        let folder = dir.path().join(seed.to_string());
        let drawn = tool(&["draw", folder.to_str().unwrap(), &seed.to_string()]);
        let descriptor = drawn["descriptor"].as_str().unwrap();
        let theirs = tool(&["results", descriptor, "12.5"]);
        let out = folder.join("sheet");
        let ours = expect(
            0,
            &[
                "emva",
                descriptor,
                "--as",
                "reference-tool",
                "--pixel-area",
                "12.5",
                "--json",
                "-o",
                out.to_str().unwrap(),
            ],
        );
        let ours: Evaluation = serde_json::from_str(&ours).unwrap();
        let compared = same_as_the_tool(&ours, theirs.as_object().unwrap());
        assert!(compared >= 47, "seed {seed}: {compared} compared");
        for (theirs_name, plot) in [
            ("histogram_DSNU", "histogram-dsnu"),
            ("histogram_PRNU", "histogram-prnu"),
            ("histogram_DSNU_accumulated", "accumulated-histogram-dsnu"),
            ("histogram_PRNU_accumulated", "accumulated-histogram-prnu"),
        ] {
            let (bins, values) = first_series(&out, plot);
            let of =
                |key: &str| theirs[theirs_name][key].as_array().unwrap().iter().map(|v| v.as_f64().unwrap());
            let near = |a: &[f64], b: Vec<f64>| {
                a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= 1e-6 * b.abs().max(1e-3))
            };
            assert!(near(&bins, of("bins").collect()), "seed {seed}: bins of {theirs_name}");
            assert!(near(&values, of("values").collect()), "seed {seed}: {theirs_name}");
        }
    }
}

/// The share of samples at full scale at so many photons: Poisson electrons, spread by the pixels' K, with
/// normal offsets and read noise, summed term by term.
fn share_at_full_scale(model: &Model, photons: f64) -> f64 {
    let b = &model.base;
    let rest_dn = (b.gain_dn_per_e * b.read_noise_e).hypot(b.offset_spread_dn);
    let limit_dn = f64::from(model.full_scale_dn()) - 0.5 - b.black_level_dn;
    let (mut share, mut weights) = (0.0, 0.0);
    for node in -12..=12 {
        let k = 0.4 * f64::from(node);
        let weight = (-0.5 * k * k).exp();
        let mean = photons * b.quantum_efficiency * (1.0 + k * b.sigma_k);
        let width = 9.0 * mean.sqrt();
        let mut pixel = 0.0;
        for n in (mean - width).max(0.0) as u64..(mean + width) as u64 {
            let n = n as f64;
            // Stirling's series for ln n!.
            let ln_factorial = n * n.ln() - n + 0.5 * (std::f64::consts::TAU * n).ln() + 1.0 / (12.0 * n);
            let poisson = (n * mean.ln() - mean - ln_factorial).exp();
            let w = (limit_dn - b.gain_dn_per_e * n) / rest_dn;
            pixel += poisson * 0.5 * libm::erfc(w * std::f64::consts::FRAC_1_SQRT_2);
        }
        share += weight * pixel;
        weights += weight;
    }
    share / weights
}

/// Photons at which the middle of the standard's 0.1 to 0.2 % of the samples are at full scale.
fn saturation(model: &Model) -> f64 {
    let b = &model.base;
    let top = f64::from(model.full_scale_dn()) / (b.gain_dn_per_e * b.quantum_efficiency);
    let (mut low, mut high) = (0.8 * top, top);
    for _ in 0..24 {
        let middle = 0.5 * (low + high);
        if share_at_full_scale(model, middle) < 0.0015 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// A camera of its own kind: gain, depth, noise and nonuniformities drawn by its seed, before even light,
/// pixels alike in dark current.
fn specimen(seed: u64) -> Model {
    let mut rng = PixelRng::new(seed, Stream::Effect, 1288, 0, 0);
    let mut between = |a: f64, b: f64| a * (b / a).powf(rng.uniform());
    let mut model = radcam_sim::sensors::load("cmos12").unwrap();
    (model.camera.width, model.camera.height, model.base.seed) = (96, 64, seed);
    model.camera.bit_depth = if seed.is_multiple_of(2) { 12 } else { 10 };
    let full = f64::from(model.full_scale_dn());
    let b = &mut model.base;
    b.gain_dn_per_e = full / between(3_000.0, 15_000.0);
    b.read_noise_e = between(0.8, 3.0) / b.gain_dn_per_e;
    b.black_level_dn = 0.03 * full;
    b.offset_spread_dn = between(0.3, 1.5);
    b.quantum_efficiency = between(0.3, 0.9);
    b.sigma_k = between(0.003, 0.012);
    (b.dark_current_spread, b.hot_pixel_fraction) = (0.0, 0.0);
    let bench = &mut model.bench;
    (bench.shading, bench.gradient, bench.card.grain, bench.card.spot_fraction) = (0.0, 0.0, 0.0, 0.0);
    bench.photon_flux_per_s = 50.0 * full / (b.gain_dn_per_e * b.quantum_efficiency);
    model
}

/// Measured values of a specimen less its truth, over the standard errors.
fn pulls(seed: u64, root: &Path) -> [f64; QUANTITIES.len()] {
    let model = specimen(seed);
    let (b, sat) = (model.base.clone(), saturation(&model));
    let dsnu = b.offset_spread_dn / b.gain_dn_per_e;
    let truths = [
        b.gain_dn_per_e,
        100.0 * b.quantum_efficiency,
        dsnu,
        100.0 * b.sigma_k,
        b.read_noise_e,
        sat,
        sat * b.quantum_efficiency,
    ];
    let (mut camera, mut bench) = camera(model);
    let mut plan = Plan::emva1288();
    plan.full_exposure_s = Some(0.85 / 50.0);
    // The spatial part in a sixth of its frames.
    plan.sets.iter_mut().filter(|s| s.frames > 2).for_each(|s| s.frames = 16);
    Capture::new(&mut camera, &mut bench).run(&plan, root).unwrap();
    let points = of_dataset(&Dataset::open(root).unwrap(), &AtomicBool::new(false), &|_, _| {}).unwrap();
    let found = evaluate(&points, Definitions::Release4).unwrap();
    std::fs::remove_dir_all(root).unwrap();
    std::array::from_fn(|i| {
        let q =
            found.quantities[QUANTITIES[i]].as_ref().unwrap_or_else(|| panic!("{seed}: {:?}", found.notes));
        (q.value - truths[i]) / q.std_err
    })
}

const QUANTITIES: [&str; 7] = ["K", "QE", "DSNU1288", "PRNU1288", "sigma_d", "u_p_sat", "u_e_sat"];

/// Values minus truth over their standard errors, of so many cameras.
fn campaign(cameras: u64) -> Vec<[f64; QUANTITIES.len()]> {
    let dir = tempfile::tempdir().unwrap();
    let one = |k: u64| pulls(20_000 + k, &dir.path().join(k.to_string()));
    let half = cameras / 2;
    // Two cameras at a time.
    std::thread::scope(|s| {
        let second = s.spawn(|| (half..cameras).map(one).collect::<Vec<_>>());
        let mut all: Vec<_> = (0..half).map(one).collect();
        all.extend(second.join().unwrap());
        all
    })
}

/// Twenty-four cameras: mean 0 and size 1, each within four of its own standard errors.
#[test]
fn errors_cover_the_truth() {
    let all = campaign(24);
    let n = all.len() as f64;
    for (i, name) in QUANTITIES.iter().enumerate() {
        let mean = all.iter().map(|p| p[i]).sum::<f64>() / n;
        let size = (all.iter().map(|p| p[i] * p[i]).sum::<f64>() / n).sqrt();
        println!("{name}: mean {mean:.2}, size {size:.2}");
        assert!(mean.abs() < 4.0 / n.sqrt(), "{name}: mean {mean}");
        assert!((size - 1.0).abs() < 4.0 / (2.0 * n).sqrt(), "{name}: size {size}");
    }
}

/// Five hundred cameras: the table in docs/emva.md. `cargo test --release --test it -- --ignored
/// emva::coverage --nocapture`
#[test]
#[ignore = "minutes"]
fn coverage() {
    let all = campaign(1500);
    let n = all.len() as f64;
    let mut off = Vec::new();
    for (i, name) in QUANTITIES.iter().enumerate() {
        let within = |limit: f64| 100.0 * all.iter().filter(|p| p[i].abs() < limit).count() as f64 / n;
        let mean = all.iter().map(|p| p[i]).sum::<f64>() / n;
        let (one, two) = (within(1.0), within(1.959_964));
        let size = (all.iter().map(|p| p[i] * p[i]).sum::<f64>() / n).sqrt();
        println!(
            "{name:<10} {one:.1} % within 1 sigma, {two:.1} % within 1.96 sigma, mean {mean:+.2}, size {size:.3}"
        );
        if (one - 68.27).abs() >= 3.0 || (two - 95.0).abs() >= 3.0 {
            off.push(*name);
        }
    }
    assert!(off.is_empty(), "{off:?}");
}

/// Captures a plan with a camera and evaluates it.
fn measured(model: Model, plan: &Plan, root: &Path) -> Result<Evaluation, EmvaError> {
    let (mut camera, mut bench) = camera(model);
    Capture::new(&mut camera, &mut bench).run(plan, root).unwrap();
    let points = of_dataset(&Dataset::open(root).unwrap(), &AtomicBool::new(false), &|_, _| {})?;
    evaluate(&points, Definitions::Release4)
}

/// Within four standard errors.
fn is_true(e: &Evaluation, name: &str, truth: f64) {
    let q = e.quantities[name].as_ref().unwrap_or_else(|| panic!("{name}: {:?}", e.notes));
    println!("{name}: {q}, truth {truth}, tool {:?}", e.reference_tool.get(name));
    assert!((q.value - truth).abs() < 4.0 * q.std_err, "{name}: {q}, truth {truth}");
}

/// A null, and the note that says why.
fn is_refused(e: &Evaluation, name: &str, why: &str) {
    assert_eq!(e.quantities[name], None, "{name}");
    assert!(e.notes.iter().any(|n| n.contains(name) && n.contains(why)), "{name}: {:?}", e.notes);
}

/// Campaigns of which the reference tool gives a wrong number, or ends in its own error: the table of
/// docs/emva.md, row by row.
#[test]
fn what_fails_silently_is_true_or_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let plan = || {
        let mut plan = Plan::emva1288();
        plan.full_exposure_s = Some(0.85 / 50.0);
        plan.sets.iter_mut().filter(|s| s.frames > 2).for_each(|s| s.frames = 16);
        plan
    };
    let of = |model: &Model| {
        let b = &model.base;
        (b.gain_dn_per_e, 100.0 * b.quantum_efficiency, b.read_noise_e)
    };

    // The dark signal lies below its noise: half of the darks are at 0 DN.
    let mut model = specimen(1);
    model.base.black_level_dn = 0.0;
    let (k, qe, _) = of(&model);
    let e = measured(model, &plan(), &at("black")).unwrap();
    is_true(&e, "K", k);
    is_true(&e, "QE", qe);
    for name in ["sigma_d", "u_p_min", "DSNU", "DR"] {
        let name = if name == "DSNU" { "DSNU1288" } else { name };
        assert_eq!(e.quantities[name], None, "{name}");
    }
    is_refused(&e, "sigma_y_dark", "Raise the black level");

    // A gain of 0.02 DN/e: the dark noise is a tenth of a step.
    let mut model = specimen(2);
    model.camera.bit_depth = 8;
    let b = &mut model.base;
    (b.gain_dn_per_e, b.read_noise_e, b.black_level_dn, b.offset_spread_dn) = (0.02, 5.0, 8.3, 0.4);
    model.bench.photon_flux_per_s = 50.0 * 255.0 / (b.gain_dn_per_e * b.quantum_efficiency);
    let (k, qe, sigma) = of(&model);
    let e = measured(model, &plan(), &at("gain")).unwrap();
    is_true(&e, "K", k);
    is_true(&e, "QE", qe);
    assert_eq!(e.limits["sigma_d"], Limit::AtMost);
    assert!(e.quantities["sigma_d"].as_ref().unwrap().value > sigma);

    // A lamp that flickers: the formula takes the scatter of whole frames for noise of the pixels.
    let mut model = specimen(3);
    let truth = 100.0 * model.base.sigma_k;
    model = crate::effects::with(model, "illumination-flicker", &[0.02, 0.0]);
    let e = measured(model, &plan(), &at("flicker")).unwrap();
    let q = e.quantities["PRNU1288"].as_ref();
    let note = e.notes.iter().find(|n| n.starts_with("PRNU1288 is too low")).unwrap();
    let own: f64 =
        note.split("Without that it is ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!(q.is_none_or(|q| q.value < 0.97 * truth), "{q:?}, truth {truth}");
    assert!((own / truth - 1.0).abs() < 0.06, "{note}, truth {truth}");

    // Saturation between two of twelve exposures.
    let model = specimen(3);
    let sat = saturation(&model);
    let mut coarse = plan();
    // Every fourth of the fifty, and the stacks.
    coarse.sets.retain(|s| {
        s.frames > 2 || s.exposure.is_some_and(|e| e > 5.0 || ((e / 0.025).round() as i32) % 4 == 0)
    });
    let e = measured(model.clone(), &coarse, &at("coarse")).unwrap();
    is_true(&e, "u_p_sat", sat);

    // No exposure saturates.
    let mut dim = plan();
    dim.sets.retain(|s| s.frames > 2 || s.exposure.is_some_and(|e| e < 0.8));
    let e = measured(model.clone(), &dim, &at("dim")).unwrap();
    for name in ["u_p_sat", "u_e_sat", "SNR_max", "DR"] {
        is_refused(&e, name, "saturation lies beyond");
    }
    is_true(&e, "K", model.base.gain_dn_per_e);

    // One exposure, the light varied.
    let mut light = plan();
    for set in &mut light.sets {
        if set.frames == 2 && set.illumination > 0.0 {
            set.illumination = set.exposure.unwrap();
        }
        set.exposure = Some(1.0);
    }
    light.sets.iter_mut().filter(|s| s.frames > 2 && s.illumination > 0.0).for_each(|s| s.illumination = 0.6);
    let mut darks = 0;
    light.sets.retain(|s| {
        s.frames > 2 || s.illumination > 0.0 || {
            darks += 1;
            darks == 1
        }
    });
    let e = measured(model.clone(), &light, &at("light")).unwrap();
    is_refused(&e, "u_I_mean", "three exposures");
    for (name, truth) in
        [("K", of(&model).0), ("QE", of(&model).1), ("sigma_d", of(&model).2), ("u_p_sat", sat)]
    {
        is_true(&e, name, truth);
    }

    // The same as a flash before a shutter of 0 s: in the descriptor the exposure is 0.
    let path = at("light").join("EMVA1288_Data.txt");
    let text = std::fs::read_to_string(&path).unwrap();
    let exposure = format!(" {:.3}", 0.85 / 50.0 * 1e9);
    assert!(text.contains(&exposure), "{text:.300}");
    let flash = at("light").join("flash.txt");
    std::fs::write(&flash, text.replace(&exposure, " 0")).unwrap();
    let shown = expect(0, &["emva", flash.to_str().unwrap(), "--json"]);
    let flashed: Evaluation = serde_json::from_str(&shown).unwrap();
    is_true(&flashed, "QE", of(&model).1);
    is_refused(&flashed, "u_I_mean", "three exposures");

    // Gaps: an exposure without darks, a pair with one frame, a dark with one.
    let gap = |drop: &str, with: &str| {
        let path = at("coarse").join("gap.txt");
        let text = std::fs::read_to_string(at("coarse").join("EMVA1288_Data.txt")).unwrap();
        let i = text.find(drop).unwrap() + 1;
        let from = i + text[i..].find('\n').unwrap() + 1;
        let lines: Vec<&str> = text[from..].lines().collect();
        let rest = match with {
            "one frame" => [&lines[..1], &lines[2..]].concat(),
            _ => lines[2..].to_vec(),
        };
        let head = if with == "one frame" { &text[..from] } else { &text[..i] };
        std::fs::write(&path, format!("{head}{}\n", rest.join("\n"))).unwrap();
        refused(&["emva", path.to_str().unwrap()])
    };
    assert!(gap("\nd ", "nothing").contains("no pair of darks at its exposure of 0.0017 s"));
    assert!(gap("\nd ", "one frame").contains("has one frame"));
    // A flat of one frame is none: the level is missing, and the others serve.
    // Everything saturated.
    let mut bright = plan();
    bright.sets.retain(|s| s.frames > 2 || s.exposure.is_some_and(|e| (1.1..5.0).contains(&e)));
    bright.sets.iter_mut().filter(|s| s.frames > 2).for_each(|s| s.exposure = Some(1.2));
    let e = measured(model, &bright, &at("bright"));
    assert!(e.unwrap_err().to_string().contains("below 70 % of saturation"));
}

/// A camera with the datasheet of a real one measures that datasheet; one of four sensors.
#[test]
fn sensors_return_their_published_datasheets() {
    return_their_datasheets(4);
}

#[test]
#[ignore = "two minutes; `cargo test --release --test it every_sensor_returns -- --ignored`"]
fn every_sensor_returns_its_published_datasheet() {
    return_their_datasheets(1);
}

/// One in `step` of the sensors with a published datasheet.
fn return_their_datasheets(step: usize) {
    let dir = tempfile::tempdir().unwrap();
    let published = |text: &&'static str| text.lines().find_map(|l| l.strip_prefix("# Published: "));
    let known: Vec<_> = radcam_sim::sensors::ALL
        .iter()
        .filter_map(|(sensor, text)| Some((*sensor, *text, published(text)?)))
        .collect();
    assert!(known.len() >= 12, "{}", known.len());
    for (sensor, text, published) in known.into_iter().step_by(step) {
        assert!(text.starts_with("# Source: "), "{sensor}");
        let root = dir.path().join(sensor);
        let at = root.to_str().unwrap();
        expect(0, &["simulate", sensor, "--plan", "emva1288", "--region", "0,0,160,120", "-o", at]);
        let e: Evaluation = serde_json::from_str(&expect(0, &["emva", at, "--json"])).unwrap();
        // The gain beside K is the one that `noise` gives.
        let noise: serde_json::Value =
            serde_json::from_slice(&radcam(&["noise", at, "--json"]).stdout).unwrap();
        let beside = e.noise.as_ref().unwrap();
        assert_eq!(serde_json::json!(beside.gain), noise["gain_dn_per_e"], "{sensor}");
        assert_eq!(serde_json::json!(beside.read_noise), noise["read_noise_e"], "{sensor}");
        for field in published.split_whitespace().filter(|f| f.contains('=')) {
            let (name, value) = field.split_once('=').unwrap();
            let value: f64 = value.parse().unwrap();
            let q = e.quantities[name].as_ref().unwrap_or_else(|| panic!("{sensor}: {name}: {:?}", e.notes));
            // Four standard errors, what the published figure is rounded to, and 1.5 % of the saturation,
            // which releases define otherwise.
            let digits = field.split('.').nth(1).map_or(0, str::len) as i32;
            let rounding = 0.5 * 10f64.powi(-digits) + if name == "u_e_sat" { 0.015 * value } else { 0.0 };
            let off = (q.value - value).abs();
            assert!(off < 4.0 * q.std_err + rounding, "{sensor}: {name} is {q}, published {value}");
        }
        std::fs::remove_dir_all(root).unwrap();
    }
}

#[test]
fn what_is_missing_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    let at = root.to_str().unwrap();
    expect(0, &["simulate", "cmos12", "--plan", "quick", "--region", "0,0,64,48", "-o", at]);
    // The quick plan has darks at two exposures of its eight.
    assert!(refused(&["emva", at]).contains("no pair of darks at its exposure"));
}
