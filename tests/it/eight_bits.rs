//! The format that most cameras are set to: 8 of 12 bits, the others cut off.

use crate::rewritten::Campaign;
use crate::support::expect;
use radcam::dataset::image::{read_single, tiff_bytes};
use std::path::Path;

/// Cuts the lowest four bits of a 12-bit dataset off.
fn cut(root: &Path) {
    for file in std::fs::read_dir(root.join("frames")).unwrap() {
        let path = file.unwrap().path();
        let codes = read_single(&path).unwrap().mapv(|v| v >> 4);
        std::fs::write(&path, tiff_bytes(&codes, 8).unwrap()).unwrap();
    }
    let manifest = root.join("dataset.toml");
    let text = std::fs::read_to_string(&manifest).unwrap();
    let text = text.replace("bit_depth = 12", "bit_depth = 8").replace("\"Mono12\"", "\"Mono8\"");
    assert!(text.contains("bit_depth = 8"), "{text}");
    std::fs::write(&manifest, text).unwrap();
}

/// Sensors with 0.05 to 0.06 codes of dark noise: no effect is named, gain and read noise lie within four
/// standard errors of those at 12 bits or are not determined, and a note recommends more bits.
#[test]
fn eight_of_twelve_bits_are_a_linear_sensor_that_hides_its_noise() {
    for (sensor, plan, seed, gain_dn_per_e, read_noise_e) in [
        ("cmos12", "standard", "2", 0.38, 2.6),
        ("cmos12", "emva1288", "5", 0.38, 2.6),
        ("imx250", "standard", "6", 0.3697, 2.15),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("c");
        let at = root.to_str().unwrap();
        expect(0, &["simulate", sensor, "--plan", plan, "--region", "0,0,160,128", "--seed", seed, "-o", at]);
        cut(&root);
        let said: serde_json::Value = serde_json::from_str(&expect(0, &["diagnose", at, "--json"])).unwrap();
        assert_eq!(said["missing"].as_array().unwrap().len(), 0, "{sensor} {seed}: {}", said["missing"]);
        let near = |name: &str, truth: f64| {
            let (Some(value), Some(error)) = (said[name]["value"].as_f64(), said[name]["std_err"].as_f64())
            else {
                return false;
            };
            assert!(
                (value - truth).abs() < 4.0 * error,
                "{sensor} {seed}, {name}: {value} +- {error}, not {truth}"
            );
            true
        };
        assert!(near("gain_dn_per_e", gain_dn_per_e / 16.0), "{sensor} {seed}");
        near("read_noise_e", read_noise_e);
        let notes = said["notes"].to_string();
        assert!(notes.contains("Mono12"), "{notes}");
    }
}

/// A black level where a code ends: nearly all pixels of the darks have two codes, and none jumps. Two black
/// levels in the middle of a code, where darks have one code only: no frames were averaged.
#[test]
fn two_codes_of_a_level_are_no_telegraph_noise() {
    for (black_dn, seed) in [(64.0, 344), (64.0, 345), (66.0, 346), (72.0, 347), (72.0, 348)] {
        let dir = tempfile::tempdir().unwrap();
        let (model, root) = (dir.path().join("m.toml"), dir.path().join("c"));
        let mut camera = radcam_sim::sensors::load("cmos12").unwrap();
        camera.base.black_level_dn = black_dn;
        std::fs::write(&model, camera.to_toml().unwrap()).unwrap();
        let (model, at) = (model.to_str().unwrap(), root.to_str().unwrap());
        let seed = seed.to_string();
        expect(0, &["simulate", model, "--region", "0,0,160,128", "--seed", &seed, "-o", at]);
        cut(&root);
        let said: serde_json::Value = serde_json::from_str(&expect(0, &["diagnose", at, "--json"])).unwrap();
        for list in ["missing", "data_faults"] {
            assert_eq!(said[list], serde_json::json!([]), "{black_dn} {seed}");
        }
    }
}

/// Darks of many pairs with 0.37 codes of noise: rounding does to all their variances the same, and to the
/// covariances of lines what chance does: the mean square of their residuals is 1 within four standard
/// errors.
#[test]
fn covariances_of_lines_of_coarse_darks_have_true_errors() {
    let mut squares: Vec<f64> = Vec::new();
    for seed in 220..224 {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("m.toml");
        let mut camera = radcam_sim::sensors::load("cmos12").unwrap();
        camera.base.gain_dn_per_e *= 0.375;
        std::fs::write(&model, camera.to_toml().unwrap()).unwrap();
        let campaign = Campaign::new(model.to_str().unwrap(), "emva1288", seed);
        let darks: Vec<u64> = campaign.sets("dark", 2).into_iter().map(u64::from).collect();
        let said = campaign.said("compare");
        let of_lines = said["residuals"].as_array().unwrap().iter().filter(|r| {
            let of = r["statistic"].as_str().unwrap();
            ["covariance of row means", "covariance of column means"].contains(&of)
                && darks.contains(&r["set"].as_u64().unwrap())
        });
        squares.extend(of_lines.filter_map(|r| r["z"].as_f64()).map(|z| z * z));
    }
    let n = squares.len() as f64;
    let mean = squares.iter().sum::<f64>() / n;
    println!("{n} residuals, mean square {mean:.3}");
    assert!(n > 300.0 && (mean - 1.0).abs() < 4.0 * (2.0 / n).sqrt(), "{mean} of {n}");
}
