//! EMVA 1288: the numbers of the reference tool, with errors that hold.

use crate::support::{camera, expect, refused, shared};
use radcam::capture::Capture;
use radcam::dataset::{Dataset, Kind};
use radcam::emva::{Definitions, Evaluation, evaluate, of_dataset};
use radcam::plan::{Plan, SetPlan};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Compares every number that the reference tool prints with ours under its definitions, to 1e-6 of itself; how many.
fn same_as_the_tool(ours: &Evaluation, tool: &serde_json::Map<String, serde_json::Value>) -> usize {
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
                assert!((q.value - value).abs() <= 1e-6 * value.abs(), "{name}: {} and {value}", q.value);
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
fn tool() -> Option<impl Fn(&[&str]) -> serde_json::Value> {
    let Some(venv) = std::env::var_os("RADCAM_TEST_EMVA") else {
        println!("SKIPPED: RADCAM_TEST_EMVA names no environment with emva1288 (.ci/test makes one where PyPI can be reached)");
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

/// Ten random cameras of the tool's own simulator, 8 to 16 bits, by exposure and by light: its numbers and its histograms.
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
            &["emva", descriptor, "--as", "reference-tool", "--pixel-area", "12.5", "--json", "-o", out.to_str().unwrap()],
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
            let of = |key: &str| theirs[theirs_name][key].as_array().unwrap().iter().map(|v| v.as_f64().unwrap());
            let near = |a: &[f64], b: Vec<f64>| {
                a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= 1e-6 * b.abs().max(1e-3))
            };
            assert!(near(&bins, of("bins").collect()), "seed {seed}: bins of {theirs_name}");
            assert!(near(&values, of("values").collect()), "seed {seed}: {theirs_name}");
        }
    }
}

/// Pairs at twelve exposures, and a stack of sixteen frames at one of them.
fn plan() -> Plan {
    let mut plan = Plan::quick();
    let set = |kind, frames, exposure_s: f64| SetPlan {
        kind,
        frames,
        exposure_s: Some(exposure_s),
        exposure: None,
        illumination: f64::from(u8::from(kind == Kind::Flat)),
        configuration: 0,
    };
    plan.full_exposure_s = Some(0.02);
    plan.sets = (1..=12)
        .flat_map(|i| [set(Kind::Dark, 2, 0.002 * f64::from(i)), set(Kind::Flat, 2, 0.002 * f64::from(i))])
        .chain([set(Kind::Dark, 16, 0.01), set(Kind::Flat, 16, 0.01)])
        .collect();
    plan
}

fn evaluated(seed: u64, root: &Path) -> Evaluation {
    let mut model = radcam_sim::sensors::load("cmos12").unwrap();
    (model.camera.width, model.camera.height, model.base.seed) = (96, 64, seed);
    // The light is even and the pixels' dark currents alike: truth is then what the model file says.
    (model.bench.shading, model.bench.gradient, model.bench.card.grain, model.bench.card.spot_fraction) =
        (0.0, 0.0, 0.0, 0.0);
    (model.base.dark_current_spread, model.base.hot_pixel_fraction) = (0.0, 0.0);
    let (mut camera, mut bench) = camera(model);
    Capture::new(&mut camera, &mut bench).run(&plan(), root).unwrap();
    let points = of_dataset(&Dataset::open(root).unwrap(), &AtomicBool::new(false), &|_, _| {}).unwrap();
    evaluate(&points, Definitions::Release4).unwrap()
}

/// Sixty cameras: values minus truth over their standard errors have the mean 0 and the size 1, each within four of its own standard errors.
#[test]
fn errors_cover_the_truth() {
    let dir = tempfile::tempdir().unwrap();
    let all: Vec<Evaluation> = (0..60).map(|k| evaluated(700 + k, &dir.path().join(k.to_string()))).collect();
    let n = all.len() as f64;
    for (name, truth) in [("K", 0.38), ("sigma_d", 2.6), ("DSNU1288_DN", 0.35), ("PRNU1288", 0.55)] {
        let pull = |e: &Evaluation| {
            let q = e.quantities[name].as_ref().unwrap();
            (q.value - truth) / q.std_err
        };
        let pulls: Vec<f64> = all.iter().map(pull).collect();
        let mean = pulls.iter().sum::<f64>() / n;
        let size = (pulls.iter().map(|p| p * p).sum::<f64>() / n).sqrt();
        println!("{name}: mean {mean:.2}, size {size:.2}");
        assert!(mean.abs() < 4.0 / n.sqrt(), "{name}: mean {mean}");
        assert!((size - 1.0).abs() < 4.0 / (2.0 * n).sqrt(), "{name}: size {size}");
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
