//! Effects of a user's own in files: a law becomes one by one command, and the next diagnosis knows it by
//! name.

use crate::jitter_of_the_samples::JitterOfTheSamplesEffect;
use crate::outside::{self, SIZE, normal};
use crate::support::{expect, program, refused};
use radcam_sim::effects::Effect;
use std::path::Path;

/// Gain of every sample of its own, relative.
const REL: f64 = 0.003;

/// A camera in which every sample has a gain of its own, whose spread is `rel`.
fn jitter(root: &Path, rel: f64, seed: u64) {
    outside::campaign(root, &|f, signal, image| {
        for ((y, x), v) in image.indexed_iter_mut() {
            *v += rel * signal * normal((seed << 48) + (f << 20) + (y * SIZE + x) as u64);
        }
    });
}

/// A law that one campaign shows becomes an effect of the catalogue by one command. Another campaign of such
/// a camera, of another strength, has its name and size (three standard errors), not a law; the model that is
/// written holds without the folder.
#[test]
fn a_law_becomes_an_effect_that_is_known_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    jitter(Path::new(&at("first")), REL, 5);
    jitter(Path::new(&at("second")), 1.5 * REL, 6);
    std::fs::create_dir(at("own")).unwrap();
    let file = at("own/jitter-of-the-samples.toml");
    let new = |more: &[&str]| {
        let first = at("first");
        let all = ["effects", "new", "jitter-of-the-samples", "--from", &first, "-o", &file];
        [&all[..], more].concat().iter().map(|s| (*s).to_string()).collect::<Vec<_>>()
    };
    let refs = |all: &[String]| expect(0, &all.iter().map(String::as_str).collect::<Vec<_>>());
    let said = refs(&new(&["--rust", &at("jitter.rs")]));
    assert!(said.contains("square of the signal") && said.contains("--effects"), "{said}");
    let source = std::fs::read_to_string(at("jitter.rs")).unwrap();
    assert!(source.contains("pub struct JitterOfTheSamplesEffect;"), "{source}");

    let page = expect(0, &["effects", "jitter-of-the-samples", "--effects", &at("own")]);
    assert!(page.contains("variance + k * (mu / 1000)^2") && page.contains("law found by radcam"), "{page}");
    let diagnose = ["diagnose", &at("second"), "--effects", &at("own"), "--json", "-o", &at("m.toml")];
    let d: serde_json::Value = serde_json::from_str(&expect(1, &diagnose)).unwrap();
    assert_eq!(d["missing"][0]["effect"], "jitter-of-the-samples", "{}", d["missing"]);
    assert!(d["proposal"].is_null() && d["missing"].as_array().unwrap().len() == 1, "{d}");
    let k = &d["missing"][0]["parameters"]["k"];
    let [value, std_err] = ["value", "std_err"].map(|of| k[of].as_f64().unwrap());
    let truth = (1.5 * REL * 1000.0).powi(2);
    assert!((value - truth).abs() < 3.0 * std_err, "{value} +- {std_err}, not {truth}");
    expect(0, &["compare", &at("second"), "--model", &at("m.toml")]);

    // An effect that is there is replaced where that is asked for, by the same law.
    let before = std::fs::read_to_string(&file).unwrap();
    let again = new(&["--effects", &at("own")]);
    assert!(refused(&again.iter().map(String::as_str).collect::<Vec<_>>()).contains("already"));
    assert!(refused(&new(&[]).iter().map(String::as_str).collect::<Vec<_>>()).contains("--overwrite"));
    refs(&new(&["--effects", &at("own"), "--overwrite"]));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), before);
    // The folder of the user's settings needs no option.
    let settings = dir.path().join("settings/radcam");
    std::fs::create_dir_all(&settings).unwrap();
    std::fs::rename(at("own"), settings.join("effects")).unwrap();
    let list = program().arg("effects").env("XDG_CONFIG_HOME", dir.path().join("settings")).output().unwrap();
    assert!(String::from_utf8_lossy(&list.stdout).contains("jitter-of-the-samples"));
    // A file of it that is no effect is said and passed over: it keeps nobody from working.
    std::fs::write(settings.join("effects/broken.toml"), "name = 1").unwrap();
    let list = program().arg("effects").env("XDG_CONFIG_HOME", dir.path().join("settings")).output().unwrap();
    let [out, err] = [&list.stdout, &list.stderr].map(|text| String::from_utf8_lossy(text).into_owned());
    assert!(list.status.success() && out.contains("jitter-of-the-samples"), "{out}");
    assert!(err.contains("broken.toml"), "{err}");
}

/// Each file that is no effect is refused with its name and what is wrong with it, a folder that is absent
/// too.
#[test]
fn files_that_are_no_effect_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().to_str().unwrap();
    let path = dir.path().join("e.toml");
    let sound = "formulas = { row = \"k * mu\" }\nparameters = { k = 1.0 }\n";
    for (text, said) in [
        ("name = \"a\"", "formulas"),
        ("name = \"Noise Of Rows\"\nformulas = { row = \"1\" }", "small letters"),
        ("name = \"a\"\nformulas = { row = \"k * mux\" }\nparameters = { k = 1.0 }", "mux"),
        ("name = \"a\"\nformulas = { rows = \"1\" }", "rows"),
        (&format!("name = \"row-noise\"\n{sound}"), "already"),
        (&format!("name = \"a\"\n{sound}bounds = {{ k = [2.0, 3.0] }}"), "not within 2 to 3"),
        (&format!("name = \"a\"\n{sound}[page]\nwhy = \"?\""), "why"),
        (&format!("name = \"custom\"\n{sound}"), "another name"),
        (&format!("name = \"a\"\n{sound}units = {{ g = \"DN\" }}"), "no parameter"),
    ] {
        std::fs::write(&path, text).unwrap();
        let refusal = refused(&["effects", "--effects", folder]);
        assert!(refusal.contains("e.toml") && refusal.contains(said), "{text}: {refusal}");
    }
    // Neither side files nor other files are effects.
    std::fs::write(&path, format!("name = \"noise-of-rows\"\n{sound}")).unwrap();
    std::fs::write(dir.path().join("._e.toml"), "no TOML").unwrap();
    std::fs::write(dir.path().join("notes.txt"), "no TOML").unwrap();
    assert!(expect(0, &["effects", "--effects", folder]).contains("noise-of-rows"));
    assert!(refused(&["effects", "--effects", &format!("{folder}/none")]).contains("no file or folder"));
    // A name is looked at before anything is read or written.
    for (name, said) in
        [("../up", "small letters"), ("row-noise", "another name"), ("custom", "another name")]
    {
        let refusal =
            refused(&["effects", "new", name, "--from", "nowhere", "-o", &format!("{folder}/n.toml")]);
        assert!(refusal.contains(said), "{refusal}");
    }
}

/// An effect of a source that `effects new --rust` writes is what its formulas say.
#[test]
fn a_written_source_is_an_effect() {
    let effect = JitterOfTheSamplesEffect;
    assert_eq!(effect.id(), "jitter-of-the-samples");
    assert_eq!(effect.page().equation, "variance + k * (mu / 1000)^2");
    assert_eq!(effect.parameters().len(), 1);
    assert_eq!(effect.parameters()[0].starts, [8.0]);
    // It predicts what its formulas draw: with it the model agrees with their campaign (one chance in a
    // thousand to be refused), without it not.
    let dir = tempfile::tempdir().unwrap();
    let mut model = crate::effects::unit(331);
    model.effects.push(radcam_sim::EffectValues {
        id: "custom".into(),
        name: Some("formulas".into()),
        formulas: [("variance".to_string(), "k * (mu / 1000)^2".to_string())].into(),
        parameters: [("k".to_string(), 8.0)].into(),
        ..Default::default()
    });
    crate::effects::campaign(model, &dir.path().join("c"));
    let all = crate::effects::observe(&dir.path().join("c"));
    let chance = |effects: radcam::inference::Effects| {
        let fitted = radcam::inference::fit(&all, &radcam::inference::start(&all), &effects);
        radcam::inference::compare(&all, &fitted).p_value
    };
    assert!(chance(vec![(&JitterOfTheSamplesEffect, vec![8.0])]) > 1e-3);
    assert!(chance(Vec::new()) < 1e-3);
    assert!(effect.written().is_none(), "a model names it, and has no formulas");
}

/// Effects of formulas are added and removed by their names, and are other effects than those of the
/// catalogue of the same name.
#[test]
fn effects_of_formulas_are_removed_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.toml");
    let m = path.to_str().unwrap();
    expect(0, &["model", "new", m]);
    let mut text = std::fs::read_to_string(&path).unwrap();
    for name in ["row-noise", "other"] {
        text += &format!("\n[[effect]]\nid = \"custom\"\nname = \"{name}\"\nformulas = {{ row = \"k\" }}\n");
        text += "parameters = { k = 1.0 }\n";
    }
    std::fs::write(&path, text).unwrap();
    expect(0, &["model", "add", m, "row-noise"]);
    let names = || -> Vec<(String, Option<String>)> {
        let model = radcam_sim::Model::from_toml(&std::fs::read_to_string(&path).unwrap()).unwrap();
        model.effects.into_iter().map(|e| (e.id, e.name)).collect()
    };
    let of = |id: &str, name: Option<&str>| (id.to_string(), name.map(String::from));
    expect(0, &["model", "remove", m, "row-noise"]);
    assert_eq!(names(), [of("custom", Some("row-noise")), of("custom", Some("other"))]);
    assert!(refused(&["model", "remove", m, "custom"]).contains("row-noise, other"));
    expect(0, &["model", "remove", m, "row-noise"]);
    assert_eq!(names(), [of("custom", Some("other"))]);
    expect(0, &["model", "remove", m, "custom"]);
    assert!(names().is_empty());
}
