//! What ignoring an effect costs is what the program's own EMVA 1288 evaluation finds.

use crate::effects::with;
use crate::support::{expect, radcam, small};
use serde_json::Value;

/// Gain of an EMVA campaign by `emva` against that of `diagnose` with the effect in the model, and the cost
/// that `diagnose` says: they agree within three standard errors of K.
#[test]
fn the_cost_is_that_of_an_emva_evaluation() {
    let crosstalk: &[f64] = &[0.02, 0.0, 0.0];
    let brighter_fatter: &[f64] = &[2e-6, 2e-6];
    for (id, values) in [("interpixel-crosstalk", crosstalk), ("brighter-fatter", brighter_fatter)] {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
        let model = with(small("cmos12", 128, 96), id, values);
        std::fs::write(at("m.toml"), model.to_toml().unwrap()).unwrap();
        expect(0, &["simulate", &at("m.toml"), "--plan", "emva1288", "-o", &at("c")]);
        let json = |verb: &str| -> Value {
            serde_json::from_slice(&radcam(&[verb, &at("c"), "--json"]).stdout).unwrap()
        };
        let (diagnosis, sheet) = (json("diagnose"), json("emva"));
        assert_eq!(diagnosis["missing"][0]["effect"], id, "{diagnosis:#}");
        let k = |part: &str| sheet["quantities"]["K"][part].as_f64().unwrap();
        let gain = diagnosis["gain_dn_per_e"]["value"].as_f64().unwrap();
        let cost = diagnosis["missing"][0]["cost"]["gain_rel"].as_f64().unwrap();
        let found = k("value") / gain - 1.0;
        let error = k("std_err") / gain;
        assert!(cost < -10.0 * error, "{id}: {cost} +- {error}");
        assert!((found - cost).abs() < 3.0 * error, "{id}: {found} +- {error}, said {cost}");
    }
}

/// Cost of an effect with flats at one level: that of the slope from the darks to it, which `noise` finds in
/// the same frames; the two agree within three standard errors. Row noise is no part of the read noise; the
/// dark noise has both.
#[test]
fn one_level_has_a_cost_and_shared_noise_is_in_the_dark_noise() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let set = |kind: &str, exposure: f64, light: f64| {
        format!(
            "[[set]]\nkind = \"{kind}\"\nframes = 8\nexposure = {exposure}\nillumination = {light}\nconfiguration = 0\n"
        )
    };
    let darks = [0.1, 1.0].map(|t| set("dark", t, 0.0)).concat();
    std::fs::write(
        at("p.toml"),
        format!("format = \"radcam-plan/1\"\n{darks}{}", set("flat", 1.0, 1.0).repeat(4)),
    )
    .unwrap();
    let said = |id: &str, values: &[f64], folder: &str| {
        let model = with(small("cmos12", 128, 96), id, values);
        std::fs::write(at("m.toml"), model.to_toml().unwrap()).unwrap();
        expect(0, &["simulate", &at("m.toml"), "--plan", &at("p.toml"), "-o", &at(folder)]);
        let json = |verb: &str| -> Value {
            serde_json::from_slice(&radcam(&[verb, &at(folder), "--json"]).stdout).unwrap()
        };
        (json("diagnose"), json("noise"))
    };
    let (diagnosis, noise) = said("spatial-filter", &[0.05, 0.0, 0.0], "filtered");
    assert_eq!(diagnosis["missing"][0]["effect"], "spatial-filter", "{diagnosis:#}");
    let of = |json: &Value, part: &str| json["gain_dn_per_e"][part].as_f64().unwrap();
    let (gain, plain) = (of(&diagnosis, "value"), of(&noise, "value"));
    let error = (of(&diagnosis, "std_err") / gain).hypot(of(&noise, "std_err") / plain);
    let cost = diagnosis["missing"][0]["cost"]["gain_rel"].as_f64().unwrap();
    assert!(cost.abs() > 10.0 * error, "{cost} +- {error}");
    assert!((plain / gain - 1.0 - cost).abs() < 3.0 * error, "{plain} of {gain} +- {error}, said {cost}");

    let (diagnosis, noise) = said("row-noise", &[0.0, 1.0, 0.0, 0.0], "rows");
    let read = &diagnosis["read_noise_e"];
    let ratio = diagnosis["dark_noise_over_read_noise"].as_f64().unwrap();
    let (value, error) = (ratio * read["value"].as_f64().unwrap(), ratio * read["std_err"].as_f64().unwrap());
    // Variances add; and it is the read noise that `noise` finds.
    let truth = 2.6f64.hypot(1.0);
    assert!((value - truth).abs() < 3.0 * error.hypot(0.02), "{value} +- {error}, truth {truth}");
    let (other, other_error) = (
        noise["read_noise_e"]["value"].as_f64().unwrap(),
        noise["read_noise_e"]["std_err"].as_f64().unwrap(),
    );
    assert!(
        (value - other).abs() < 4.0 * error.hypot(other_error),
        "{value} +- {error}, noise {other} +- {other_error}"
    );
}
