//! Laws for what has no name: found on frames of a generator that shares nothing with them, added to a model
//! file by one command, drawn as they are predicted.

use crate::effects::{campaign, observe, unit};
use crate::outside;
use crate::support::{expect, refused};
use radcam::inference::{compare, fit, start};
use radcam::model::given;
use radcam_sim::EffectValues;
use std::path::Path;

/// Change of a frame: its number, its signal (DN) and the image.
type Act<'a> = &'a dyn Fn(u64, f64, &mut ndarray::Array2<f64>);

/// Diagnosis of a campaign in which something happens that no catalogue has.
fn diagnosis_of(root: &Path, act: Act<'_>) -> serde_json::Value {
    outside::campaign(root, act);
    serde_json::from_str(&expect(1, &["diagnose", root.to_str().unwrap(), "--json"])).unwrap()
}

/// Noise shared by blocks of two by two pixels, an echo of the line before last, a gain that is another one
/// for every sample, and light that tilts from frame to frame: each law has the right statistic and growth,
/// leaves an error of 1 and gives the gain of the camera within three standard errors; added to a model file
/// by one command it describes the campaign.
#[test]
fn what_has_no_name_gets_a_law() {
    use outside::{SIZE, normal};
    let blocks: Act<'_> = &|f, _, image| {
        for ((y, x), v) in image.indexed_iter_mut() {
            *v += normal((3 << 48) + (f << 20) + (y / 2 * SIZE + x / 2) as u64);
        }
    };
    let echo: Act<'_> = &|_, _, image| {
        let (before, mean) = (image.clone(), image.mean().unwrap());
        for ((y, x), v) in image.indexed_iter_mut().filter(|((y, _), _)| *y >= 2) {
            *v += 0.04 * (before[(y - 2, x)] - mean);
        }
    };
    let gains: Act<'_> = &|f, signal, image| {
        for ((y, x), v) in image.indexed_iter_mut() {
            *v += 0.003 * signal * normal((5 << 48) + (f << 20) + (y * SIZE + x) as u64);
        }
    };
    // A straight tilt, not the cosine of the law.
    let tilt: Act<'_> = &|f, signal, image| {
        let of_frame = 0.0005 * signal * normal((6 << 48) + f);
        for ((y, _), v) in image.indexed_iter_mut() {
            *v += of_frame * (2.0 * y as f64 / (SIZE - 1) as f64 - 1.0);
        }
    };
    for (name, act, targets, growth) in [
        ("tilt", tilt, vec!["gradient_y"], "k * (mu / 1000)^2"),
        ("blocks", blocks, vec!["cov_01", "cov_10", "cov_11", "parity_01", "parity_10"], "k"),
        ("echo", echo, vec!["cov_20"], "k * noise"),
        ("gains", gains, vec!["variance"], "k * (mu / 1000)^2"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
        let root = at("c");
        let d = diagnosis_of(Path::new(&root), act);
        assert_eq!(d["missing"][0]["effect"], "unknown", "{name}: {}", d["missing"]);
        let law = &d["proposal"];
        let formulas = law["formulas"].as_object().unwrap_or_else(|| panic!("{name}: {d}"));
        assert_eq!(formulas.keys().collect::<Vec<_>>(), targets, "{name}: {law}");
        assert!(formulas.values().all(|f| f.as_str().unwrap().ends_with(growth)), "{name}: {law}");
        let error = law["error_after"].as_f64().unwrap();
        assert!(error < 1.1 && law["p_value"].as_f64().unwrap() > 0.05, "{name}: {law}");
        let [gain, std_err] = ["value", "std_err"].map(|of| d["gain_dn_per_e"][of].as_f64().unwrap());
        assert!((gain - 0.25).abs() < 3.0 * std_err, "{name}: {gain} +- {std_err}");
        // An echo of 0.04 from two rows above: a filter would have changed the variance by twice that.
        let open = law["gain_open_rel"].as_f64().unwrap();
        assert!(if name == "echo" { (0.06..0.1).contains(&open) } else { open < 0.3 }, "{name}: {open}");
        assert!(!law["causes"].as_array().unwrap().is_empty(), "{name}: {law}");
        expect(0, &["model", "new", &at("m.toml")]);
        let shown = expect(0, &["model", "add", &at("m.toml"), "--proposal", &root]);
        assert!(shown.contains(growth), "{name}: {shown}");
        expect(0, &["compare", &root, "--model", &at("m.toml")]);
        // The answer can be read again.
        let read: radcam::diagnosis::Diagnosis = serde_json::from_value(d.clone()).unwrap();
        assert_eq!(read.proposal.map(|p| p.formulas.len()), Some(targets.len()));
        // Drawn by the simulator, another campaign of the same camera agrees with its own model.
        expect(0, &["simulate", &at("m.toml"), "--plan", "quick", "-o", &at("again")]);
        expect(0, &["compare", &at("again"), "--model", &at("m.toml")]);
    }
}

/// A strong tilt, of some per cent of the noise: it has the law of one, and is neither bands of light nor
/// interference, which come near.
#[test]
fn a_strong_tilt_is_no_band() {
    use outside::{SIZE, normal};
    for (seed, size) in [(7, 0.002), (8, 0.004)] {
        let act: Act<'_> = &|f, signal, image| {
            let of_frame = size * signal * normal((seed << 48) + f);
            for ((y, _), v) in image.indexed_iter_mut() {
                *v += of_frame * (2.0 * y as f64 / (SIZE - 1) as f64 - 1.0);
            }
        };
        let dir = tempfile::tempdir().unwrap();
        let d = diagnosis_of(&dir.path().join("c"), act);
        assert_eq!(d["missing"][0]["effect"], "unknown", "{size}: {}", d["missing"][0]["effect"]);
        assert!(d["proposal"]["formulas"]["gradient_y"].is_string(), "{size}: {}", d["proposal"]);
    }
}

/// Two laws at once, of the noise of pixels and of rows two apart: each is an effect of its own in the model
/// file, which agrees with what the simulator draws from it.
#[test]
fn two_laws_are_two_effects() {
    use outside::{SIZE, normal};
    let act: Act<'_> = &|f, signal, image| {
        for ((y, x), v) in image.indexed_iter_mut() {
            *v += 0.003 * signal * normal((5 << 48) + (f << 20) + (y * SIZE + x) as u64);
        }
        let (before, mean) = (image.clone(), image.mean().unwrap());
        for ((y, x), v) in image.indexed_iter_mut().filter(|((y, _), _)| *y >= 2) {
            *v += 0.04 * (before[(y - 2, x)] - mean);
        }
    };
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let d = diagnosis_of(Path::new(&at("c")), act);
    let formulas = d["proposal"]["formulas"].as_object().unwrap();
    assert_eq!(formulas.keys().collect::<Vec<_>>(), ["cov_20", "variance"], "{}", d["proposal"]);
    expect(0, &["model", "new", &at("m.toml")]);
    expect(0, &["model", "add", &at("m.toml"), "--proposal", &at("c")]);
    let model = radcam_sim::Model::from_toml(&std::fs::read_to_string(at("m.toml")).unwrap()).unwrap();
    let names: Vec<_> = model.effects.iter().filter_map(|e| e.name.as_deref()).collect();
    assert_eq!(names, ["law", "law-2"]);
    expect(0, &["compare", &at("c"), "--model", &at("m.toml")]);
    expect(0, &["simulate", &at("m.toml"), "--plan", "quick", "-o", &at("again")]);
    expect(0, &["compare", &at("again"), "--model", &at("m.toml")]);
}

/// An effect that is excluded by other means is not named; a name that there is not is refused.
#[test]
fn an_excluded_effect_is_not_named() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    let model = unit(320);
    let values = radcam_sim::effects::example("row-noise", &model).unwrap();
    campaign(crate::effects::with(model, "row-noise", &values), &root);
    let root = root.to_str().unwrap();
    let d: serde_json::Value =
        serde_json::from_str(&expect(1, &["diagnose", root, "--json", "--without", "row-noise"])).unwrap();
    let names: Vec<&str> =
        d["missing"].as_array().unwrap().iter().filter_map(|m| m["effect"].as_str()).collect();
    assert!(!names.contains(&"row-noise"), "{names:?}");
    let said = refused(&["diagnose", root, "--without", "row-nois"]);
    assert!(said.contains("row-noise"), "{said}");
}

/// Without anything nameless there is no law to add, and that is said.
#[test]
fn a_camera_without_a_remainder_gets_no_law() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    campaign(unit(305), Path::new(&at("c")));
    expect(0, &["model", "new", &at("m.toml")]);
    let said = refused(&["model", "add", &at("m.toml"), "--proposal", &at("c")]);
    assert!(said.contains("no law is proposed") && said.contains("agrees"), "{said}");
}

/// Formulas of covariances at any lag, of one diagonal alone, and of frames (every second one, time) are
/// drawn as they are predicted: fitted to its own campaign the size is what was drawn within four standard
/// errors, the model agrees at one in a thousand, and the model without the formula does not.
#[test]
fn formulas_are_drawn_as_they_are_predicted() {
    for (k, (target, formula, size)) in [
        ("cov_20", "k * mu / 1000", 8.0),
        ("cov_12", "k * noise", 0.04),
        ("cov_1-1", "k * noise", 0.04),
        ("parity_01", "k * noise", 0.04),
        ("mean", "k * odd * mu / 1000", 4.0),
        ("mean", "k * time", 0.5),
        ("mean", "k * (mu / 1000)^2", 10.0),
        ("gradient_y", "k * (mu / 1000)^2", 1.0),
        ("gradient_x", "k", 0.1),
        ("curvature_y", "k", 0.1),
        ("curvature_x", "k * (mu / 1000)^2", 1.0),
    ]
    .into_iter()
    .enumerate()
    {
        let dir = tempfile::tempdir().unwrap();
        let mut model = unit(306 + k as u64);
        let map = |name: &str, text: &str| [(name.to_string(), text.to_string())].into();
        model.effects.push(EffectValues {
            id: "custom".into(),
            name: Some("law".into()),
            formulas: map(target, formula),
            parameters: [("k".to_string(), size)].into(),
            units: map("k", "DN^2"),
            ..Default::default()
        });
        let effects = given(&model.effects).unwrap();
        campaign(model, &dir.path().join("c"));
        let all = observe(&dir.path().join("c"));
        let known = effects.iter().map(|(e, v)| (*e, v.iter().map(|v| v.unwrap()).collect())).collect();
        let fitted = fit(&all, &start(&all), &known);
        let with = compare(&all, &fitted);
        let without = compare(&all, &fit(&all, &start(&all), &Vec::new()));
        let (found, std_err) = (fitted.effects[0].1[0], fitted.std_err[0][0]);
        assert!(
            (found - size).abs() < 4.0 * std_err,
            "{target} = {formula}: {found} +- {std_err}, drawn {size}"
        );
        assert!(with.p_value > 1e-3, "{target} = {formula}: p {} {:?}", with.p_value, with.largest);
        assert!(without.p_value < 1e-3, "{target} = {formula}: p {}", without.p_value);
    }
}
