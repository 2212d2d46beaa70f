//! Captures that are killed: whatever was written is whole, and what goes on ends as an undisturbed one.

use crate::support::{expect, program, small};
use radcam_sim::rng::{PixelRng, Stream};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Instant;

/// Every file of a campaign but its log, which tells of each run.
pub fn files(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut out = BTreeMap::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap().map(Result::unwrap) {
            let path = entry.path();
            if entry.file_type().unwrap().is_dir() {
                folders.push(path);
            } else if path.file_name().unwrap() != "capture.log" {
                out.insert(path.strip_prefix(root).unwrap().to_path_buf(), fs::read(&path).unwrap());
            }
        }
    }
    out
}

/// Frames of the quick plan.
const FRAMES: usize = 40;

/// Frames that a campaign says it has.
fn rows(root: &Path) -> usize {
    fs::read_to_string(root.join("frames.csv")).map_or(0, |t| t.lines().count().saturating_sub(1))
}

/// Kills as many captures by SIGKILL at random instants, some again while they go on; each must end, frame
/// for frame and row for row, as the one that nobody disturbed. Lag makes each frame depend on those before
/// it.
fn killed(captures: u32) {
    let dir = tempfile::tempdir().unwrap();
    let mut model = small("cmos12", 64, 48);
    let lag = radcam_sim::effects::find("image-lag").unwrap();
    let values = radcam_sim::effects::example("image-lag", &model).unwrap();
    let parameters = lag.parameters().iter().zip(&values).map(|(p, v)| (p.name.to_string(), *v)).collect();
    model.effects =
        vec![radcam_sim::EffectValues { id: "image-lag".into(), parameters, ..Default::default() }];
    let camera = dir.path().join("camera.toml");
    fs::write(&camera, model.to_toml().unwrap()).unwrap();
    let arguments = |to: &Path, resume: bool| -> Vec<String> {
        let mut all =
            vec!["simulate".to_string(), camera.display().to_string(), "-o".into(), to.display().to_string()];
        all.extend(if resume { vec!["--resume".to_string()] } else { vec!["--plan".into(), "quick".into()] });
        all
    };
    let run = |to: &Path, resume: bool| {
        let all = arguments(to, resume);
        expect(0, &all.iter().map(String::as_str).collect::<Vec<_>>());
    };
    let whole = dir.path().join("whole");
    let begun = Instant::now();
    run(&whole, false);
    let took = begun.elapsed();
    let expected = files(&whole);
    assert_eq!(expected.len(), FRAMES + 3);
    let (mut in_time, mut again) = (0, 0);
    for number in 0..captures {
        let to = dir.path().join(format!("{number}"));
        let mut random = PixelRng::new(2026, Stream::Effect, 0, number, 0);
        loop {
            // Some die before the folder is there: then it is begun, not continued.
            let resume = to.join("dataset.toml").exists();
            again += u32::from(resume);
            let mut child = program()
                .args(arguments(&to, resume))
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap();
            // By its progress, then at any instant within a frame: the time alone would depend on what else
            // the machine does.
            let after = (random.uniform() * FRAMES as f64) as usize;
            while rows(&to) < after && child.try_wait().unwrap().is_none() {
                std::thread::yield_now();
            }
            let within = if after == 0 { took } else { took / FRAMES as u32 };
            std::thread::sleep(within.mul_f64(random.uniform()));
            child.kill().unwrap();
            let ended = child.wait().unwrap().success();
            in_time += u32::from(!ended);
            if random.uniform() < 0.6 {
                break;
            }
        }
        // A folder that holds no campaign yet is written as a new one is.
        run(&to, to.join("dataset.toml").exists());
        let found = files(&to);
        let names = |of: &BTreeMap<PathBuf, Vec<u8>>| of.keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(&found), names(&expected), "capture {number}");
        for (name, bytes) in &expected {
            assert!(found[name] == *bytes, "capture {number}: {} differs", name.display());
        }
        fs::remove_dir_all(&to).unwrap();
    }
    println!(
        "{captures} captures: {in_time} kills found one running, {again} of them one that had been killed before"
    );
    assert!(in_time >= captures / 2 && again > 0);
}

#[test]
fn a_capture_that_is_killed_goes_on_as_if_nothing_had_been() {
    killed(12);
}

#[test]
#[ignore = "200 captures, a quarter of a minute: cargo test --release --test it -- --ignored killed:: --nocapture"]
fn two_hundred_captures_are_killed() {
    killed(200);
}

/// Captures over the network that are killed, each of a served camera that has gone on meanwhile: frames,
/// rows and times end as those of one that nobody disturbed.
#[cfg(feature = "aravis")]
fn killed_over_the_network(captures: u32) {
    let _port = crate::support::gige_port();
    let dir = tempfile::tempdir().unwrap();
    let model = dir.path().join("camera.toml");
    fs::write(&model, small("cmos12", 96, 64).to_toml().unwrap()).unwrap();
    let mut command = program();
    command.arg("serve").arg(&model).stdout(Stdio::null());
    let _camera = crate::outages::Camera(command.spawn().unwrap());
    let capture = |to: &Path| {
        let mut command = program();
        command.args(["capture", "--camera", "aravis:127.0.0.1", "-o"]).arg(to);
        if to.join("dataset.toml").exists() {
            command.arg("--resume");
        } else {
            command.args(["--plan", "quick"]);
        }
        command.stdout(Stdio::null()).stderr(Stdio::null());
        command
    };
    // A camera lets go of a client that was killed within some seconds.
    let to_its_end = |to: &Path| {
        let begun = Instant::now();
        while !capture(to).status().unwrap().success() {
            assert!(begun.elapsed().as_secs() < 60, "{} does not come to its end", to.display());
            std::thread::sleep(std::time::Duration::from_millis(300));
        }
    };
    let whole = dir.path().join("whole");
    to_its_end(&whole);
    let expected = files(&whole);
    let times = fs::read_to_string(whole.join("frames.csv")).unwrap();
    assert!(times.lines().all(|row| !row.ends_with(',')), "{times}");
    let mut in_time = 0;
    for number in 0..captures {
        let to = dir.path().join(format!("{number}"));
        let mut random = PixelRng::new(8, Stream::Effect, 0, number, 0);
        let after = (random.uniform() * FRAMES as f64) as usize;
        let mut child = capture(&to).spawn().unwrap();
        while rows(&to) < after && child.try_wait().unwrap().is_none() {
            std::thread::yield_now();
        }
        child.kill().unwrap();
        in_time += u32::from(!child.wait().unwrap().success());
        to_its_end(&to);
        let found = files(&to);
        assert_eq!(found.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>(), "capture {number}");
        for (name, bytes) in &expected {
            assert!(found[name] == *bytes, "capture {number}: {} differs", name.display());
        }
        fs::remove_dir_all(&to).unwrap();
    }
    println!("{captures} captures over the network, {in_time} of them killed");
    assert!(in_time >= captures / 2);
}

#[cfg(feature = "aravis")]
#[test]
fn captures_over_the_network_that_are_killed_go_on() {
    killed_over_the_network(3);
}

#[cfg(feature = "aravis")]
#[test]
#[ignore = "six minutes: cargo test --release --test it -- --ignored killed::a_hundred --nocapture"]
fn a_hundred_captures_over_the_network_are_killed() {
    killed_over_the_network(100);
}
