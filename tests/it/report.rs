//! The report as a page: its numbers are those of the JSON, it fetches nothing, and its hash is that of
//! sha256sum.

use crate::far_slips::sweep;
use crate::support::{expect, shared};
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// A practice dataset, by its path.
fn practice(name: &str) -> Option<String> {
    let path = shared("practice")?.join(name).canonicalize().unwrap();
    Some(path.to_string_lossy().into_owned())
}

/// What stands between two texts.
fn between<'t>(page: &'t str, from: &str, to: &str) -> &'t str {
    let rest = page.split_once(from).unwrap_or_else(|| panic!("no {from}")).1;
    rest.split_once(to).unwrap().0
}

/// Every number of the page's table of quantities and of its cards is the number of the JSON, bit for bit,
/// and none is missing.
#[test]
fn the_page_says_what_the_json_says() {
    let Some(root) = practice("interpixel-crosstalk") else { return };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("report.html");
    let said = expect(1, &["report", &root, "-o", path.to_str().unwrap(), "--json"]);
    let json: serde_json::Value = serde_json::from_str(&said).unwrap();
    let page = std::fs::read_to_string(&path).unwrap();
    let held = between(&page, "<script type=\"application/json\" id=\"radcam-report\">", "</script>");
    let held: serde_json::Value = serde_json::from_str(held).unwrap();
    assert_eq!(held, json);
    let quantities = json["quantities"].as_object().unwrap();
    assert!(quantities.len() >= 12, "{quantities:?}");
    let mut seen = BTreeSet::new();
    for piece in page.split("<data class=\"quantity\" id=\"q-").skip(1) {
        let (id, rest) = piece.split_once("\" value=\"").unwrap();
        let value: f64 = rest.split_once('"').unwrap().0.parse().unwrap();
        assert_eq!(Some(value), quantities[id]["value"].as_f64(), "{id}");
        seen.insert(id.to_string());
    }
    assert_eq!(seen, quantities.keys().cloned().collect());
    // The first heading is the verdict.
    assert_eq!(between(&page, "<h1>", "</h1>"), "The camera shows interpixel-crosstalk");
    let diagnosis: serde_json::Value =
        serde_json::from_str(&expect(1, &["diagnose", &root, "--json"])).unwrap();
    for name in ["error_before", "error_after", "missing", "ladder"] {
        assert_eq!(json[name], diagnosis[name], "{name}");
    }
    assert_eq!(json["sentence"], diagnosis["verdict"]["sentence"]);
    fetches_nothing(&page);
}

/// No address but data, anchors and names of XML.
fn fetches_nothing(page: &str) {
    assert!(page.contains("default-src 'none'"));
    for piece in ["src=\"", "href=\"", "url("].into_iter().flat_map(|a| page.split(a).skip(1)) {
        assert!(piece.starts_with("data:") || piece.starts_with('#'), "{}", &piece[..60.min(piece.len())]);
    }
}

/// A camera that agrees with the model is not headed by what the model lacks.
#[test]
fn a_clean_camera_is_called_that() {
    let Some(root) = practice("clean") else { return };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("report.html");
    expect(0, &["report", &root, "-o", path.to_str().unwrap()]);
    let page = std::fs::read_to_string(&path).unwrap();
    assert_eq!(between(&page, "<h1>", "</h1>"), "The model describes the camera");
    assert!(!page.contains("What the model lacks"));
    // What is measured is there for whoever files it.
    for id in
        ["photon-transfer", "linearity", "snr", "dark-current", "noise-spectrum", "codes", "variance-budget"]
    {
        assert!(page.contains(&format!("download=\"{id}.csv\"")), "{id}");
    }
}

/// Slips stand below the verdict, and in the JSON.
#[test]
fn slips_stand_below_the_verdict() {
    let shares = [0.1, 0.25, 0.4, 0.55, 0.7, 0.85];
    let mut stated = shares;
    stated[3] = 0.5;
    let campaign = sweep(&shares, &stated, 4, 241);
    let path = campaign.dir.path().join("report.html");
    let said = expect(0, &["report", &campaign.path(), "-o", path.to_str().unwrap(), "--json"]);
    let json: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(json["data_faults"][0]["kind"], "setting-label", "{json}");
    let page = std::fs::read_to_string(&path).unwrap();
    let head = between(&page, "<h1>", "<nav");
    assert!(head.contains("slip in the data: set 5") && head.contains("its level belongs to"), "{head}");
    assert_eq!(page.matches("slip in the data").count(), 1);
}

/// A comparison's page has the same rooms, and says that nothing was looked for; a table has no images.
#[test]
fn other_verbs_write_the_same_page() {
    let Some(root) = practice("clean") else { return };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("report.html");
    let path = path.to_str().unwrap();
    expect(0, &["compare", &root, "--report", path]);
    let page = std::fs::read_to_string(path).unwrap();
    assert!(page.contains("Nothing was searched for") && page.contains("download=\"photon-transfer.csv\""));
    let table = Path::new(&root).with_file_name("table-two-lamps.csv");
    expect(1, &["report", table.to_str().unwrap(), "-o", path]);
    let page = std::fs::read_to_string(path).unwrap();
    assert!(page.contains("A table holds no settings") && !page.contains("id=\"images\""));
}

/// The hash is what anybody computes with sha256sum.
#[test]
fn the_hash_is_that_of_sha256sum() {
    let Some(root) = practice("clean") else { return };
    let json: serde_json::Value = serde_json::from_str(&expect(0, &["report", &root, "--json"])).unwrap();
    let script = "cd / && { find \"$1\" -type f ! -name truth.json ! -name README.md | LC_ALL=C sort | xargs sha256sum | sha256sum; }";
    let out = Command::new("sh").args(["-c", script, "sh", &root]).output().unwrap();
    let hash = String::from_utf8(out.stdout).unwrap();
    assert_eq!(json["provenance"]["sha256"].as_str(), hash.split_whitespace().next());
    assert_eq!(json["provenance"]["frames"], 232);
}
