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
