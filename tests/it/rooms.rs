//! Rooms of `src/`: few, listed in CONTRIBUTING.md, and each uses only what stands above it there.

use regex::Regex;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Most names in `src/`, and most lines of a room's door.
const MAX_NAMES: usize = 12;
const MAX_LINES_OF_A_DOOR: usize = 150;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Names in a folder, without their endings and its door.
fn names(folder: &Path) -> BTreeSet<String> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries
        .map(|p| p.file_stem().unwrap().to_str().unwrap().to_owned())
        .filter(|name| name != "mod")
        .collect()
}

/// Rooms with their modules, in the order of the table.
fn listed() -> Vec<(String, Vec<String>)> {
    let text = std::fs::read_to_string(root().join("CONTRIBUTING.md")).unwrap();
    let table = text.lines().skip_while(|line| *line != "| room | modules |").skip(2);
    let word = Regex::new("`(\\w+)`").unwrap();
    let row = |line: &str| {
        let mut words = word.captures_iter(line).map(|found| found[1].to_owned());
        (words.next().unwrap(), words.collect())
    };
    table.take_while(|line| line.starts_with('|')).map(row).collect()
}

/// Rust sources below a file or folder.
fn sources(path: &Path) -> Vec<PathBuf> {
    if path.is_file() {
        return vec![path.into()];
    }
    let entries = std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path());
    let rust = |p: &PathBuf| p.is_dir() || p.extension().is_some_and(|e| e == "rs");
    entries.filter(rust).flat_map(|p| sources(&p)).collect()
}

/// Modules of the crate that a source names, without its comments and its own tests.
fn used(text: &str) -> BTreeSet<String> {
    let text = text.split("#[cfg(test)]\nmod ").next().unwrap();
    let text = Regex::new("//.*").unwrap().replace_all(text, "");
    let path = Regex::new("crate::(?:\\{([^;]*?)\\};|(\\w+))").unwrap();
    let first = Regex::new("(?:^|[,{])\\s*(\\w+)").unwrap();
    let mut out = BTreeSet::new();
    for found in path.captures_iter(&text) {
        match (found.get(1), found.get(2)) {
            (_, Some(one)) => drop(out.insert(one.as_str().to_owned())),
            (Some(several), _) => {
                out.extend(first.captures_iter(several.as_str()).map(|name| name[1].to_owned()));
            }
            _ => {}
        }
    }
    out
}

#[test]
fn rooms_are_few_and_listed() {
    let (rooms, src) = (listed(), root().join("src"));
    let mut expected: BTreeSet<String> = rooms.iter().map(|(room, _)| room.clone()).collect();
    expected.extend(["lib".into(), "main".into()]);
    assert_eq!(names(&src), expected);
    assert!(expected.len() <= MAX_NAMES);
    for (room, modules) in rooms.iter().filter(|(_, modules)| !modules.is_empty()) {
        assert_eq!(names(&src.join(room)), modules.iter().cloned().collect(), "{room}");
        let door = std::fs::read_to_string(src.join(room).join("mod.rs")).unwrap();
        assert!(door.lines().count() < MAX_LINES_OF_A_DOOR && door.starts_with("//! "), "{room}");
    }
}

#[test]
fn no_module_uses_one_below_it() {
    let src = root().join("src");
    let mut place: BTreeMap<String, usize> = BTreeMap::new();
    let mut paths = Vec::new();
    for (room, modules) in listed() {
        let folder = src.join(&room);
        let own = if modules.is_empty() { vec![room.clone()] } else { modules };
        for module in own {
            let file = folder.join(format!("{module}.rs"));
            let path = if module == room {
                folder.clone()
            } else if file.is_file() {
                file
            } else {
                folder.join(&module)
            };
            place.insert(module.clone(), place.len());
            paths.push((module, path));
        }
    }
    let mut arrows = 0;
    for (module, path) in &paths {
        for source in sources(path) {
            let text = std::fs::read_to_string(&source).unwrap();
            for other in used(&text) {
                let Some(at) = place.get(&other) else { continue };
                arrows += 1;
                assert!(*at <= place[module], "{}: {module} uses {other}", source.display());
            }
        }
    }
    assert!(arrows > 300, "{arrows} imports were found");
}

#[test]
fn imports_of_a_source_are_read() {
    let text = "use crate::{noise::Level, dataset::{Set, Kind}};\nuse crate::number; // crate::emva\nfn f() { crate::fit::g() }";
    let found: Vec<String> = used(text).into_iter().collect();
    assert!(["dataset", "fit", "noise", "number"].iter().all(|m| found.contains(&(*m).into())), "{found:?}");
    assert!(!found.contains(&"emva".into()));
}

/// Whole-line comments of the packages, with file and line: outside of examples in documentation, which are
/// code.
fn comments() -> Vec<(String, String)> {
    let folders = ["src", "sim/src", "bindings", "benches", "examples", "tests/it"];
    let mut out = Vec::new();
    for path in folders.iter().flat_map(|folder| sources(&root().join(folder))) {
        let text = std::fs::read_to_string(&path).unwrap();
        let name = path.strip_prefix(root()).unwrap().to_str().unwrap().to_owned();
        let mut in_example = false;
        for (number, line) in text.lines().enumerate() {
            let Some(text) = line.trim_start().strip_prefix("//") else { continue };
            let fence = text.trim_start_matches(['/', '!']).trim_start().starts_with("```");
            in_example ^= fence;
            if !in_example && !fence {
                out.push((format!("{name}:{}", number + 1), line.to_owned()));
            }
        }
    }
    out
}

/// Comments fit beside one another on a screen, and begin with the thing: a noun for types and fields, a verb
/// for functions. Help texts of the program and of Python, which the packages show, are exempt from the
/// latter.
#[test]
fn comments_are_narrow_and_name_the_thing() {
    let (mut wide, mut vague) = (Vec::new(), Vec::new());
    let opening = Regex::new("^ *//[/!]? (What|Whether|Where|Of|How|Which|That|The same|It)\\b").unwrap();
    let list = Regex::new("^ *//[/!]? +([-|]|\\d+\\.|SAFETY|http| )").unwrap();
    let all = comments();
    assert!(all.len() > 10_000, "{}", all.len());
    for (at, line) in all {
        if line.chars().count() > 110 && !list.is_match(&line) {
            wide.push(at.clone());
        }
        let is_help =
            ["src/program/cli/", "bindings/python/", "tests/it/"].iter().any(|of| at.starts_with(of));
        if opening.is_match(&line) && !is_help {
            vague.push(at);
        }
    }
    assert!(wide.is_empty(), "comments of more than 110 columns: {wide:#?}");
    assert!(vague.is_empty(), "comments that begin with a clause: {vague:#?}");
}
