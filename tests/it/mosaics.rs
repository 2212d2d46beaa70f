//! Colour mosaics: one number for all four planes is a number of none of them.

use crate::frame_headers::{Drawn, fits};
use crate::support::{expect, radcam, refused};
use radcam::dataset::Dataset;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Gain of red and blue over that of green: a camera's white balance, which makes the planes equal under this
/// light.
const BALANCE: [[f64; 2]; 2] = [[1.8, 1.0], [1.0, 1.5]];

/// Frames of a colour camera whose white balance makes the planes' means equal, with these cards in their
/// headers; gain 0.5 DN/e of green.
fn frames(folder: &Path, cards: &[&str]) {
    let mut camera = Drawn::new(6, 20.0);
    let balanced = |y: usize, x: usize| {
        let gain = BALANCE[y % 2][x % 2];
        (1.0 / gain, gain)
    };
    fs::create_dir(folder).unwrap();
    let mut take = |kind: &str, exposure_s: f64, light_e: f64| {
        for i in 0..8 {
            let said = [format!("EXPTIME = {exposure_s}"), format!("IMAGETYP = '{kind}'")];
            let all: Vec<&str> = said.iter().map(String::as_str).chain(cards.iter().copied()).collect();
            let image = camera.frame_of(light_e, exposure_s, balanced);
            fits(&folder.join(format!("{}{exposure_s}_{i}.fits", &kind[..1])), &all, &image);
        }
    };
    take("Dark Frame", 0.01, 0.0);
    take("Dark Frame", 0.5, 0.0);
    for (k, light_e) in [500.0, 1500.0, 3000.0, 4500.0, 6500.0].into_iter().enumerate() {
        take("Flat Frame", 0.01 * (k + 1) as f64, light_e);
    }
}

fn gain(arguments: &[&str]) -> (f64, f64) {
    let said: Value = serde_json::from_slice(&radcam(arguments).stdout).unwrap();
    let gain = &said["gain_dn_per_e"];
    (gain["value"].as_f64().unwrap(), gain["std_err"].as_f64().unwrap())
}

/// The header says the pattern: import says colour and --plane, and of frames that are kept whole every verb
/// that takes pixels for of one kind refuses by the format's name, and with --plane each colour has its own
/// gain, the same as `import --plane` gives. `calibrate` takes each colour by itself as it is.
#[test]
fn a_mosaic_is_measured_plane_by_plane() {
    let dir = tempfile::tempdir().unwrap();
    let text = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    frames(&dir.path().join("in"), &["BAYERPAT = 'RGGB'", "XBAYROFF = 0", "YBAYROFF = 0"]);
    let (input, d) = (text("in"), text("d"));
    let said = refused(&["import", &input, "-o", &d, "--yes"]);
    for part in ["colour", "RGGB", "--plane 0,0 (R), 0,1 (G), 1,0 (G) or 1,1 (B)", "--pattern RGGB"] {
        assert!(said.contains(part), "{said}");
    }
    expect(0, &["import", &input, "-o", &d, "--yes", "--pattern", "RGGB"]);
    assert_eq!(Dataset::open(d.as_ref()).unwrap().manifest().camera.pixel_format, "BayerRG12");
    let plan = text("plan.toml");
    let (stats, page) = (text("d.stats"), text("d.html"));
    let model = text("m.toml");
    expect(0, &["model", "new", &model]);
    let verbs: [&[&str]; 9] = [
        &["noise", &d],
        &["noise", &d, "--json"],
        &["diagnose", &d],
        &["emva", &d],
        &["compare", &d],
        &["reduce", &d, "-o", &stats],
        &["report", &d, "-o", &page],
        &["model", "fit", &model, &d],
        &["plan-calibration", &d, "-o", &plan],
    ];
    for verb in verbs {
        let said = refused(verb);
        assert!(
            said.contains("BayerRG12") && said.contains("colour") && said.contains("--plane 0,0 (R)"),
            "{said}"
        );
    }
    for output in [&stats, &page, &plan] {
        assert!(!Path::new(output).exists(), "{output}");
    }
    for (plane, truth) in [("0,0", 0.9), ("0,1", 0.5), ("1,0", 0.5), ("1,1", 0.75)] {
        let (value, error) = gain(&["noise", &d, "--plane", plane, "--json"]);
        assert!((value - truth).abs() < 4.0 * error && error < 0.02 * truth, "{plane}: {value} +- {error}");
        let one = text(&format!("d{}", plane.replace(',', "")));
        expect(0, &["import", &input, "-o", &one, "--yes", "--plane", plane]);
        assert_eq!(gain(&["noise", &one, "--json"]), (value, error), "{plane}");
    }
    let same = |a: &[&str], b: &[&str]| {
        let [a, b] = [a, b].map(|arguments| {
            let mut said: Value = serde_json::from_slice(&radcam(arguments).stdout).unwrap();
            said.as_object_mut().unwrap().remove("title");
            said
        });
        assert_eq!(a, b);
    };
    let red = text("d00");
    same(&["compare", &d, "--plane", "0,0", "--json"], &["compare", &red, "--json"]);
    // This campaign has no darks at each exposure.
    assert_eq!(refused(&["emva", &d, "--plane", "0,0"]), refused(&["emva", &red]));
    // Statistics of a plane are of that plane.
    expect(0, &["reduce", &d, "--plane", "0,0", "-o", &stats]);
    assert_eq!(gain(&["noise", &stats, "--json"]), gain(&["noise", &red, "--json"]));
    assert!(refused(&["noise", &stats, "--plane", "0,0"]).contains("plane"));
    assert!(refused(&["noise", &d, "--plane", "2,0"]).contains("0,0, 0,1, 1,0 or 1,1"));
    // Of the mosaic as it is: each colour by itself, and no gain that would be of none.
    expect(0, &["calibrate", &d, "--estimator", "smooth", "-o", &text("cal.tiff")]);
    let said: Value = serde_json::from_str(&expect(
        0,
        &["calibrate", &d, "--estimator", "smooth", "-o", &text("cal.tiff"), "--overwrite", "--json"],
    ))
    .unwrap();
    assert!(
        said["gain_dn_per_e"].is_null() && said["estimator"].as_str().unwrap().contains("plane"),
        "{said}"
    );
    expect(0, &["correct", &text("cal.tiff"), &d, "-o", &text("flat")]);
}

/// The pattern of other headers, of captures and of hand-written manifests, and one that only the means tell
/// of.
#[test]
fn a_mosaic_is_known_by_any_header() {
    let dir = tempfile::tempdir().unwrap();
    let text = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    frames(&dir.path().join("in"), &["COLORTYP = 'GBRG    '"]);
    let d = text("d");
    assert!(refused(&["import", &text("in"), "-o", &d, "--yes"]).contains("GBRG"));
    expect(0, &["import", &text("in"), "-o", &d, "--yes", "--pattern", "gbrg"]);
    assert_eq!(Dataset::open(d.as_ref()).unwrap().manifest().camera.pixel_format, "BayerGB12");
    // Formats that radcam does not unpack are mosaics of files all the same.
    let path = dir.path().join("d/dataset.toml");
    let manifest = fs::read_to_string(&path).unwrap();
    for name in ["BayerRG14", "BayerRG12Packed", "bayerbg12"] {
        fs::write(&path, manifest.replace("BayerGB12", name)).unwrap();
        let said = refused(&["noise", &d]);
        assert!(said.contains(name) && said.contains("--plane"), "{said}");
    }
    // The user's word counts more than the header's.
    expect(0, &["import", &text("in"), "-o", &text("mono"), "--yes", "--pattern", "mono"]);
    assert_eq!(Dataset::open(text("mono").as_ref()).unwrap().manifest().camera.pixel_format, "Mono12");
    expect(0, &["import", &text("in"), "-o", &text("bg"), "--yes", "--pattern", "bggr"]);
    assert_eq!(Dataset::open(text("bg").as_ref()).unwrap().manifest().camera.pixel_format, "BayerBG12");
    assert!(refused(&["import", &text("in"), "-o", &text("x"), "--pattern", "RGB"]).contains("GBRG or mono"));
    // A window that begins in the second column.
    frames(&dir.path().join("off"), &["BAYERPAT = 'RGGB'", "XBAYROFF = 1", "YBAYROFF = 0"]);
    assert!(refused(&["import", &text("off"), "-o", &text("o"), "--yes"]).contains("GRBG"));
    // A colour filter that no format has, and two that are at odds.
    frames(&dir.path().join("cmyg"), &["BAYERPAT = 'CMYG'"]);
    let said = refused(&["import", &text("cmyg"), "-o", &text("x"), "--yes"]);
    assert!(said.contains("CMYG") && said.contains("--plane"), "{said}");
    expect(0, &["import", &text("cmyg"), "-o", &text("c"), "--yes", "--plane", "1,0"]);
    let said = refused(&["import", &text("in"), &text("off"), "-o", &text("x"), "--yes"]);
    assert!(said.contains("colour pattern"), "{said}");
    assert!(!dir.path().join("x").exists());
}
