//! Model files: effects in formulas, values that are searched for, and what a fit writes.

use crate::effects::{campaign, unit, with};
use crate::outside;
use crate::support::expect;
use radcam_sim::Model;
use radcam_sim::effects::example;
use std::path::Path;

/// An effect in formulas, added to the model file by hand, explains what has no name; the model can be drawn
/// again.
#[test]
fn a_formula_explains_what_has_no_name() {
    use outside::{SIZE, normal};
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    // Noise shared by 2 x 2 pixels: half of the neighbours along each axis, a quarter of the diagonals; those
    // of even columns, rows.
    outside::campaign(&root, &|f, _, image| {
        for ((y, x), v) in image.indexed_iter_mut() {
            *v += normal((3 << 48) + (f << 20) + (y / 2 * SIZE + x / 2) as u64);
        }
    });
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    expect(0, &["model", "new", &at("m.toml")]);
    let mut text = std::fs::read_to_string(at("m.toml")).unwrap();
    text += r#"
[[effect]]
id = "custom"
name = "shared-by-two-by-two"
formulas = { variance = "v", cov_01 = "0.5 * v", cov_10 = "0.5 * v", cov_11 = "0.25 * v", parity_01 = "-v", parity_10 = "-v" }
parameters = { v = 0.1 }
bounds = { v = [0.0, 100.0] }
units = { v = "DN^2" }
"#;
    std::fs::write(at("m.toml"), &text).unwrap();
    let before = expect(1, &["compare", root.to_str().unwrap(), "--json"]);
    let after =
        crate::support::radcam(&["compare", root.to_str().unwrap(), "--model", &at("m.toml"), "--json"]);
    let error =
        |text: &str| serde_json::from_str::<serde_json::Value>(text).unwrap()["error"].as_f64().unwrap();
    let (before, after) = (error(&before), error(&String::from_utf8_lossy(&after.stdout)));
    assert!(before > 2.0 && after < 1.2, "{before} -> {after}");
    let said = expect(0, &["model", "fit", &at("m.toml"), root.to_str().unwrap()]);
    assert!(said.contains("shared-by-two-by-two") && said.contains("DN²"), "{said}");
    let model = Model::from_toml(&std::fs::read_to_string(at("m.toml")).unwrap()).unwrap();
    let v = model.effects[0].parameters["v"];
    assert!((v - 1.0).abs() < 4.0 * model.effects[0].std_err["v"], "{v}");
    // Drawn again, and wrong formulas refused by name.
    expect(0, &["simulate", &at("m.toml"), "--plan", "quick", "-o", &at("again")]);
    for (wrong, part) in [("0.5 * w", "uses w"), ("0.5 * (v", "cov_01"), ("v\"\nvariation = \"v", "TOML")] {
        std::fs::write(at("bad.toml"), text.replace("0.5 * v\", cov_10", &format!("{wrong}\", cov_10")))
            .unwrap();
        let said = crate::support::refused(&["model", "show", &at("bad.toml")]);
        assert!(said.contains(part) || part == "TOML", "{said}");
    }
}

/// A value that is not given is found in the dataset by `compare` and `model fit`; to draw without it is
/// refused by name.
#[test]
fn open_values_of_a_model_are_found() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let model = unit(3);
    let values = example("full-well-saturation", &model).unwrap();
    campaign(with(model, "full-well-saturation", &values), Path::new(&at("c")));
    expect(0, &["model", "new", &at("m.toml")]);
    let out = expect(0, &["model", "add", &at("m.toml"), "full-well-saturation"]);
    assert!(out.contains("full_well_e") && out.contains("not given"), "{out}");
    assert!(crate::support::refused(&["simulate", &at("m.toml"), "-o", &at("s")]).contains("full_well_e"));
    expect(0, &["compare", &at("c"), "--model", &at("m.toml")]);
    expect(0, &["model", "fit", &at("m.toml"), &at("c")]);
    let fitted: Model = Model::from_toml(&std::fs::read_to_string(at("m.toml")).unwrap()).unwrap();
    let (found, std_err) =
        (fitted.effects[0].parameters["full_well_e"], fitted.effects[0].std_err["full_well_e"]);
    assert!((found - values[0]).abs() < 4.0 * std_err, "{found} +- {std_err}, hidden {}", values[0]);
}

/// Values that an earlier fit found are searched for anew on other data, choices included; a fit says how
/// well it does and how well the paper's values are known.
#[test]
fn a_fit_forgets_what_other_data_chose() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let mut bent = vec![0.0, 0.03, 0.0, 0.0, 1.0, 2000.0, 0.85, 1e5];
    bent.resize(14, 0.0);
    let mut knee = bent.clone();
    knee[0] = 5.0;
    campaign(with(unit(5), "nonlinearity", &bent), Path::new(&at("bent")));
    campaign(with(unit(6), "nonlinearity", &knee), Path::new(&at("knee")));
    expect(0, &["model", "new", &at("m.toml")]);
    expect(0, &["model", "add", &at("m.toml"), "nonlinearity"]);
    for (data, shape) in [("bent", 0.0), ("knee", 5.0)] {
        let said = expect(0, &["model", "fit", &at("m.toml"), &at(data)]);
        let fitted = Model::from_toml(&std::fs::read_to_string(at("m.toml")).unwrap()).unwrap();
        assert_eq!(fitted.effects[0].parameters["shape"], shape, "{said}");
        assert!(said.contains("the model agrees") && said.contains("p-value"), "{said}");
        let gain = said.lines().rev().find(|l| l.trim_start().starts_with("A ")).unwrap_or_default();
        assert!(gain.contains("±"), "{said}");
    }
}
