//! EMVA 1288: the numbers of the reference tool, with errors that hold.

use crate::support::{camera, expect, refused, shared};
use radcam::capture::Capture;
use radcam::dataset::{Dataset, Kind};
use radcam::emva::{Evaluation, evaluate, of_dataset};
use radcam::plan::{Plan, SetPlan};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Frames of a real camera: every quantity that the reference tool (PyPI emva1288 1.0.2) prints for them, to 1e-6 of itself.
#[test]
fn every_quantity_is_the_reference_tools() {
    let Some(real) = shared("real/emva_ccd12") else { return };
    let file = real.join("EMVA1288_Data.txt");
    let ours: Evaluation =
        serde_json::from_str(&expect(0, &["emva", file.to_str().unwrap(), "--json"])).unwrap();
    let text = std::fs::read_to_string(real.join("reference_tool.json")).unwrap();
    let tool: serde_json::Value = serde_json::from_str(&text).unwrap();
    let mut compared = 0;
    for (name, of_tool) in tool.as_object().unwrap() {
        // Places in the tool's lists.
        if name.starts_with("index_") {
            continue;
        }
        let ours = ours.quantities.get(name).unwrap_or_else(|| panic!("{name} is missing"));
        match (of_tool["value"].as_f64(), ours) {
            (None, None) => {}
            (Some(value), Some(q)) => {
                assert!((q.value / value - 1.0).abs() < 1e-6, "{name}: {} and {value}", q.value);
                assert!(q.std_err > 0.0 && q.std_err.is_finite(), "{name}: {q}");
            }
            (value, ours) => panic!("{name}: {value:?} and {ours:?}"),
        }
        compared += 1;
    }
    assert_eq!(compared, 47);
    // What is null is said.
    assert!(ours.notes.iter().any(|n| n.starts_with("DSNU1288_pixel")), "{:?}", ours.notes);
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
    evaluate(&points).unwrap()
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
    // The light of the bench is relative: nothing of photons is claimed.
    assert!(all[0].quantities["QE"].is_none() && all[0].notes.iter().any(|n| n.contains("photons")));
}

#[test]
fn what_is_missing_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    let at = root.to_str().unwrap();
    expect(0, &["simulate", "cmos12", "--plan", "quick", "--region", "0,0,64,48", "-o", at]);
    // The quick plan has darks at two exposures of its eight.
    assert!(refused(&["emva", at]).contains("no darks at its exposure"));
}
