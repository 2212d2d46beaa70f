//! Duration of a diagnosis against the number of sets, through the program: a clean camera and one with row
//! noise.
//!
//!     cargo bench --bench diagnosis

#![allow(clippy::unwrap_used, clippy::print_stdout)] // a bench may stop where it stumbles, and prints what it measured

use radcam_sim::sensors;
use std::fmt::Write;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

/// Plan of `sets` sets of eight frames: every fifth set darks, the others flats at levels over the whole
/// range.
fn plan(sets: usize) -> String {
    let mut out = String::from("format = \"radcam-plan/1\"\n");
    for i in 0..sets {
        let (kind, exposure, light) = match i % 5 {
            0 => ("dark", [0.02, 1.0, 4.0][i / 5 % 3], 0.0),
            _ => ("flat", 0.03 + 0.95 * (i * 37 % sets) as f64 / sets as f64, 1.0),
        };
        let set = format!("kind = \"{kind}\"\nframes = 8\nexposure = {exposure}\nillumination = {light}");
        writeln!(out, "\n[[set]]\n{set}").unwrap();
    }
    out
}

fn run(arguments: &[&str]) -> f64 {
    let begin = Instant::now();
    let output = Command::new(env!("CARGO_BIN_EXE_radcam")).args(arguments).output().unwrap();
    assert!(output.status.code() != Some(2), "{}", String::from_utf8_lossy(&output.stderr));
    begin.elapsed().as_secs_f64()
}

fn main() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let clean = sensors::get("cmos12").unwrap();
    std::fs::write(path("clean.toml"), clean).unwrap();
    let row = "[[effect]]\nid = \"row-noise\"\n[effect.parameters]\ne = 1.0\n";
    std::fs::write(path("row-noise.toml"), format!("{clean}\n{row}")).unwrap();
    println!("camera       sets   s      ms/set");
    for camera in ["clean", "row-noise"] {
        for sets in [25, 50, 100, 200] {
            let (plan_file, data) = (path("plan.toml"), path(&format!("{camera}-{sets}")));
            std::fs::write(&plan_file, plan(sets)).unwrap();
            let model = path(&format!("{camera}.toml"));
            run(&["simulate", &model, "--plan", &plan_file, "--region", "0,0,128,128", "-o", &data]);
            let s = run(&["diagnose", &data, "--json"]);
            println!("{camera:12} {sets:4} {s:6.2} {:8.1}", 1e3 * s / sets as f64);
            std::fs::remove_dir_all(Path::new(&data)).unwrap();
        }
    }
}
