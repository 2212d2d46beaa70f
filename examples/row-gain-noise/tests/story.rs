//! The program with its own effect, from model file to diagnosis.

#![allow(clippy::unwrap_used)] // a test may stop where it stumbles

use std::path::Path;
use std::process::{Command, Output};

fn run(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_row-gain-noise")).args(arguments).current_dir(folder).output().unwrap()
}

/// Drawn by a model with the effect, it is diagnosed by name; the model found describes the campaign.
#[test]
fn the_effect_is_added_drawn_and_found() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let done = |arguments: &[&str], code: i32| {
        let out = run(arguments, at);
        let (text, said) = (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
        assert_eq!(out.status.code(), Some(code), "{arguments:?}\n{text}\n{said}");
        text.into_owned()
    };
    assert!(done(&["effects", "row-gain-noise"], 0).contains("square of the mean"));
    done(&["model", "new", "m.toml"], 0);
    done(&["model", "add", "m.toml", "row-gain-noise", "rel=0.003"], 0);
    done(&["simulate", "m.toml", "--region", "0,0,128,96", "--plan", "standard", "-o", "campaign"], 0);
    let said = done(&["diagnose", "campaign", "--output", "found.toml"], 1);
    assert!(said.contains("The camera shows row-gain-noise of 0.3"), "{said}");
    assert!(std::fs::read_to_string(at.join("found.toml")).unwrap().contains("row-gain-noise"));
    done(&["compare", "campaign", "--model", "found.toml"], 0);
}

/// A name can be registered only once.
#[test]
fn names_are_taken_once() {
    assert!(radcam_sim::effects::register(&row_gain_noise::RowGainNoise).is_ok());
    let again = radcam_sim::effects::register(&row_gain_noise::RowGainNoise);
    assert!(again.unwrap_err().contains("row-gain-noise"));
    assert!(radcam_sim::effects::find("row-gain-noise").is_some());
}
