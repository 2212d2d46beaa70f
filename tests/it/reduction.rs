//! Parts of a campaign through `radcam reduce` and `radcam merge`.

use super::support::{expect, refused};
use std::fs;
use std::path::{Path, PathBuf};

fn simulated(folder: &Path) -> PathBuf {
    let campaign = folder.join("campaign");
    let to = campaign.to_str().unwrap();
    expect(0, &["simulate", "cmos12", "--plan", "quick", "--region", "0,0,64,48", "-o", to]);
    campaign
}

/// Copies a campaign as datasets with some of its rows each.
fn split(campaign: &Path, to: &Path, parts: usize, part_of: impl Fn(usize, u32) -> usize) -> Vec<PathBuf> {
    let text = fs::read_to_string(campaign.join("frames.csv")).unwrap();
    let (head, rows) = text.split_once('\n').unwrap();
    let column = |name| head.split(',').position(|c| c == name).unwrap();
    let (file, set) = (column("file"), column("set"));
    (0..parts)
        .map(|part| {
            let folder = to.join(format!("part{part}"));
            fs::create_dir_all(folder.join("frames")).unwrap();
            fs::copy(campaign.join("dataset.toml"), folder.join("dataset.toml")).unwrap();
            let mut own = format!("{head}\n");
            for (i, row) in rows.lines().enumerate() {
                let values: Vec<&str> = row.split(',').collect();
                if part_of(i, values[set].parse().unwrap()) == part {
                    fs::copy(campaign.join(values[file]), folder.join(values[file])).unwrap();
                    own += row;
                    own += "\n";
                }
            }
            fs::write(folder.join("frames.csv"), own).unwrap();
            folder
        })
        .collect()
}

/// What a verb says of a campaign, without its name.
fn said(verb: &str, campaign: &Path) -> serde_json::Value {
    let path = campaign.to_str().unwrap();
    let mut json: serde_json::Value = serde_json::from_str(&expect(0, &[verb, path, "--json"])).unwrap();
    json.as_object_mut().unwrap().remove("dataset");
    json
}

/// Runs `reduce` or `merge` and gives the file.
fn reduced(verb: &str, parts: &[PathBuf], output: PathBuf, options: &[&str]) -> PathBuf {
    let mut arguments = vec![verb];
    arguments.extend(parts.iter().map(|p| p.to_str().unwrap()));
    arguments.extend(["-o", output.to_str().unwrap()]);
    arguments.extend(options);
    let told = expect(0, &arguments);
    assert!(told.contains(" frames in "), "{told}");
    output
}

#[test]
fn three_parts_merge_to_what_the_whole_says() {
    let dir = tempfile::tempdir().unwrap();
    let campaign = simulated(dir.path());
    // Frames of a set on different machines: read again where they are merged.
    let parts = split(&campaign, dir.path(), 3, |i, _| i % 3);
    let each: Vec<PathBuf> = parts
        .iter()
        .map(|p| reduced("reduce", std::slice::from_ref(p), p.with_extension("stats"), &[]))
        .collect();
    let all = reduced("merge", &each, dir.path().join("all.stats"), &[]);
    parts.iter().for_each(|p| fs::remove_dir_all(p).unwrap());
    for verb in ["noise", "compare", "diagnose"] {
        assert_eq!(said(verb, &all), said(verb, &campaign), "{verb}");
    }
    // What has no frames cannot be calibrated from, and says so.
    let cal = dir.path().join("cal.tiff");
    let from = all.to_str().unwrap();
    let told = refused(&["calibrate", from, "-o", cal.to_str().unwrap(), "--estimator", "smooth"]);
    assert!(told.contains("frame ") && told.contains("part0"), "{told}");
    assert!(!cal.exists());
}

#[test]
fn with_a_plan_no_frame_is_read_twice() {
    let dir = tempfile::tempdir().unwrap();
    let campaign = simulated(dir.path());
    let parts = split(&campaign, dir.path(), 3, |_, set| set as usize % 3);
    let one = |p: &PathBuf, ending: &str, options: &[&str]| {
        reduced("reduce", std::slice::from_ref(p), p.with_extension(ending), options)
    };
    let looks: Vec<PathBuf> = parts.iter().map(|p| one(p, "look", &["--look"])).collect();
    let plan = reduced("merge", &looks, dir.path().join("plan"), &["--look"]);
    let blind: Vec<PathBuf> = parts.iter().map(|p| one(p, "blind", &[])).collect();
    let each: Vec<PathBuf> =
        parts.iter().map(|p| one(p, "stats", &["--plan", plan.to_str().unwrap()])).collect();
    parts.iter().for_each(|p| fs::remove_dir_all(p).unwrap());
    let all = reduced("merge", &each, dir.path().join("all.stats"), &[]);
    for verb in ["noise", "compare", "diagnose"] {
        assert_eq!(said(verb, &all), said(verb, &campaign), "{verb}");
    }
    // Without the plan they would be needed: the message says how to do without.
    let output = dir.path().join("blind.stats");
    let mut arguments = vec!["merge"];
    arguments.extend(blind.iter().map(|p| p.to_str().unwrap()));
    arguments.extend(["-o", output.to_str().unwrap()]);
    let told = refused(&arguments);
    assert!(told.contains("frame ") && told.contains("reduce --plan"), "{told}");
    assert!(!output.exists());
    // Nor is anything written over, or merged twice.
    let told = refused(&["reduce", campaign.to_str().unwrap(), "-o", all.to_str().unwrap()]);
    assert!(told.contains("--overwrite"), "{told}");
    let twice = each[0].to_str().unwrap();
    let told = refused(&["merge", twice, twice, "-o", output.to_str().unwrap()]);
    assert!(told.contains("share no frame"), "{told}");
}

/// Statistics that cannot be read say why: an empty file, and one of another version.
#[test]
fn other_statistics_are_refused_by_their_reason() {
    let dir = tempfile::tempdir().unwrap();
    for (start, said) in [("", "is empty"), ("radcam statistics 2\n\0", "another version of radcam")] {
        let path = dir.path().join("night.stats");
        std::fs::write(&path, start).unwrap();
        for verb in ["noise", "diagnose", "emva"] {
            let why = refused(&[verb, path.to_str().unwrap()]);
            assert!(why.contains(said) && why.contains("night.stats"), "{verb}: {why}");
        }
    }
}
