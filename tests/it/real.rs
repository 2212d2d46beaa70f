//! Cameras that nobody here drew, and those of ours whose darks are clipped.

use crate::support::{expect, shared};
use serde_json::Value;

fn diagnosed(code: i32, path: &std::path::Path) -> Value {
    serde_json::from_str(&expect(code, &["diagnose", path.to_str().unwrap(), "--json"])).unwrap()
}

/// The first public reference set of the EMVA 1288 group, a CCD: what numpy finds in it
/// (shared/real/README.md) is named, and the rest is described. Row noise of 0.505 DN within 4 %, the
/// line at half a cycle, the flicker between 0.045 and 0.065 %, the bend.
#[test]
fn a_real_ccd_is_diagnosed() {
    let Some(root) = shared("real/emva_ccd12") else { return };
    let said = diagnosed(1, &root.join("EMVA1288_Data.txt"));
    let missing = said["missing"].as_array().unwrap();
    let value = |effect: &str, parameter: &str| {
        let entry = missing.iter().find(|m| m["effect"] == effect && m.get("tied_with").is_none());
        entry.and_then(|m| m["parameters"][parameter]["value"].as_f64()).unwrap_or(f64::NAN)
    };
    let gain = said["gain_dn_per_e"]["value"].as_f64().unwrap();
    assert!((gain / 0.2905 - 1.0).abs() < 0.01, "gain {gain}");
    let row = value("row-noise", "e") * gain;
    assert!((row / 0.505 - 1.0).abs() < 0.04, "row noise {row} DN");
    let line = value("periodic-interference", "cycles_per_px");
    assert!((line - 0.5).abs() < 0.002, "line at {line}");
    let flicker = value("illumination-flicker", "rel");
    assert!((4.5e-4..6.5e-4).contains(&flicker), "flicker {flicker}");
    assert!(missing.iter().any(|m| m["effect"] == "nonlinearity"), "{missing:#?}");
    let after = said["error_after"].as_f64().unwrap();
    assert!(after < 1.5, "{after}");
    // The largest first; what is left is a remainder with a share, and words.
    assert_eq!(missing[0]["effect"], "row-noise");
    let share = |m: &Value| m["share"].as_f64().unwrap();
    assert!(missing.windows(2).all(|w| share(&w[0]) >= share(&w[1])), "{missing:#?}");
    let left = &said["remainder"];
    assert!(share(left) < 0.01 && !left["largest"].as_array().unwrap().is_empty(), "{left:#}");
}

/// A camera without a black level: its darks are clipped at code 0, which is no missing effect.
#[test]
fn darks_that_are_clipped_at_code_0_are_no_effect() {
    for seed in ["1", "2", "3"] {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("xc77");
        let path = folder.to_str().unwrap();
        expect(
            0,
            &[
                "simulate",
                "xc77",
                "--plan",
                "standard",
                "--region",
                "0,0,256,256",
                "--seed",
                seed,
                "-o",
                path,
            ],
        );
        let said = diagnosed(0, &folder);
        assert!(said["missing"].as_array().unwrap().is_empty(), "seed {seed}: {said:#}");
    }
}
