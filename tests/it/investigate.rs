//! One command from a camera to a verdict, and several datasets taken together.

use crate::support::{expect, refused, small};
use radcam::dataset::Dataset;
use radcam_sim::{EffectValues, Model};
use std::fs;
use std::path::Path;

/// A camera that has an effect at its example's strength.
pub fn with(id: &str) -> Model {
    let mut model = small("cmos12", 320, 256);
    let effect = radcam_sim::effects::find(id).unwrap();
    let values = radcam_sim::effects::example(id, &model).unwrap();
    let parameters = effect.parameters().iter().zip(&values).map(|(p, v)| (p.name.to_string(), *v)).collect();
    model.effects = vec![EffectValues { id: id.into(), parameters, ..Default::default() }];
    model
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap()
}

/// The first look cannot tell these from others; the second measurement can, without a hand.
#[cfg(feature = "aravis")]
#[test]
fn a_tie_is_broken_by_the_second_measurement() {
    let _port = crate::support::gige_port();
    let dir = tempfile::tempdir().unwrap();
    for (id, measurements) in [("smear", 2), ("image-lag", 1), ("illumination-drift", 2)] {
        let sensor = radcam_sim::Sensor::new(with(id)).unwrap();
        let options = radcam::serve::Options::default();
        let interface = std::net::Ipv4Addr::LOCALHOST.into();
        let _served = radcam::serve::serve(sensor.into(), interface, "TEST1", &options).unwrap();
        let root = dir.path().join(id);
        let path = root.to_str().unwrap();
        let camera = ["investigate", "--camera", "aravis:127.0.0.1"];
        let said = expect(1, &[&camera[..], &["--plan", "quick", "--json", "-o", path]].concat());
        let found = json(&said);
        // Alone the first measurement leaves two of them open. Times are the clock's: whether the lamp or the
        // gain that drifts is the nearer one in the first look is chance.
        assert_eq!(found["measurements"].as_array().unwrap().len(), measurements, "{id}: {said}");
        let near = if id == "illumination-drift" { "-drift" } else { id };
        let second = found["measurements"][1]["about"].as_str();
        assert!(second.is_none_or(|about| about.contains(near)), "{id}: {said}");
        let d = &found["diagnosis"];
        assert_eq!(d["missing"][0]["effect"], id, "{said}");
        assert!(d["missing"].as_array().unwrap().len() == 1 && found["undecided"].is_null(), "{id}: {said}");
        for file in ["report.html", "model.toml", "investigation.toml", "dataset/frames.csv"] {
            assert!(root.join(file).exists(), "{file}");
        }
    }
}

/// A campaign that was broken off is gone on with, and not begun again; a folder with something else in it is
/// left alone.
#[test]
fn an_investigation_goes_on_where_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let text = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    fs::write(text("camera.toml"), with("row-noise").to_toml().unwrap()).unwrap();
    let camera = format!("sim:{}", text("camera.toml"));
    let run = ["investigate", "--camera", &camera, "--plan", "quick", "--frames", "4", "-o", &text("i")];
    let first = expect(1, &run);
    assert!(first.contains("row-noise"), "{first}");
    // The crash: the last sets have no rows.
    let csv = dir.path().join("i/dataset/frames.csv");
    let rows = fs::read_to_string(&csv).unwrap();
    let whole = rows.lines().count();
    let kept: Vec<&str> = rows.lines().take(20).collect();
    fs::write(&csv, kept.join("\n") + "\n").unwrap();
    let again = expect(1, &run);
    assert!(again.contains("row-noise"), "{again}");
    let rows = fs::read_to_string(&csv).unwrap();
    assert_eq!(rows.lines().count(), whole);
    assert!(rows.starts_with(&kept.join("\n")));
    fs::create_dir(text("other")).unwrap();
    fs::write(text("other") + "/thesis.txt", "x").unwrap();
    let said = refused(&["investigate", "--camera", "sim:cmos12", "-o", &text("other")]);
    assert!(said.contains("no investigation"), "{said}");
}

/// Two campaigns of one camera: together they tell what the first alone leaves open, in every verb that
/// judges.
#[test]
fn several_datasets_are_taken_together() {
    let dir = tempfile::tempdir().unwrap();
    let text = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    fs::write(text("camera.toml"), with("smear").to_toml().unwrap()).unwrap();
    expect(0, &["simulate", &text("camera.toml"), "--plan", "quick", "-o", &text("a")]);
    let alone = expect(1, &["diagnose", &text("a"), "--json", "--next", &text("next.toml")]);
    assert!(json(&alone)["missing"][1]["tied_with"].is_string(), "{alone}");
    // Another stretch of the camera's frames than that of the first.
    let mut plan: toml::Table = fs::read_to_string(text("next.toml")).unwrap().parse().unwrap();
    let full =
        Dataset::open(Path::new(&text("a"))).unwrap().rows().iter().map(|r| r.exposure_s).fold(0.0, f64::max);
    plan.insert("full_exposure_s".into(), (full / 6.0).into());
    fs::write(text("next.toml"), plan.to_string()).unwrap();
    let camera = ["simulate", &text("camera.toml"), "--plan", &text("next.toml"), "-o", &text("b")];
    expect(0, &camera);
    let together = expect(1, &["diagnose", &text("a"), &text("b"), "--json"]);
    let d = json(&together);
    assert_eq!(d["missing"][0]["effect"], "smear", "{together}");
    assert_eq!(d["missing"].as_array().unwrap().len(), 1, "{together}");
    // The model with it describes both; without it neither.
    expect(0, &["model", "new", &text("m.toml"), "--sensor", "cmos12"]);
    expect(1, &["compare", &text("a"), &text("b"), "--model", &text("m.toml")]);
    expect(0, &["model", "add", &text("m.toml"), "smear"]);
    expect(0, &["model", "fit", &text("m.toml"), &text("a"), &text("b")]);
    expect(0, &["compare", &text("a"), &text("b"), "--model", &text("m.toml")]);
    // Not of another camera, and not the same one twice.
    expect(0, &["simulate", "xc77", "--region", "0,0,64,64", "--plan", "quick", "-o", &text("c")]);
    assert!(refused(&["diagnose", &text("a"), &text("c")]).contains("and was"));
    assert!(refused(&["compare", &text("a"), &text("a"), "--model", &text("m.toml")]).contains("twice"));
}
