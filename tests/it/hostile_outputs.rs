//! Places that radcam writes to, secrets that it is given, signals: what others prepared there is left as it
//! is.

use crate::support::{calibration, expect, program, radcam, refused, small_sensor};
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

fn text(path: &Path) -> String {
    path.to_str().unwrap().into()
}

/// C4: every output, onto a FIFO, a device, a socket and a link.
#[test]
#[cfg(unix)]
fn outputs_replace_nothing_but_files() {
    use std::os::unix::fs::{FileTypeExt, symlink};
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let sensor = text(&small_sensor(dir.path(), "cmos12", 24, 16));
    let dataset = text(&path("d"));
    expect(0, &["simulate", &sensor, "--plan", "quick", "-o", &dataset]);
    let cal = path("cal.tiff");
    calibration("m", "s", (16, 24), |_| (64.0, 1.0)).write(&cal).unwrap();
    let cal = text(&cal);
    let frame = text(&path("d/frames/00030.tiff"));
    fs::write(path("target"), "kept").unwrap();
    let fifo = path("fifo");
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let _socket = std::os::unix::net::UnixListener::bind(path("socket")).unwrap();
    symlink(path("target"), path("link")).unwrap();
    symlink(path("nowhere"), path("dangling")).unwrap();
    // A device of its own where the user may make one; else a link to one.
    let node = Command::new("mknod").arg(path("node")).args(["c", "1", "3"]).stderr(Stdio::null()).status();
    let node = node.is_ok_and(|s| s.success());
    if !node {
        symlink("/dev/null", path("node")).unwrap();
    }
    for (name, kind) in [
        ("fifo", "is a FIFO"),
        ("socket", "is a socket"),
        ("link", "is a link"),
        ("dangling", "is a link"),
        ("node", if node { "is a device" } else { "is a link" }),
    ] {
        let out = &*text(&path(name));
        let refuse = |arguments: &[&str]| {
            let said = refused(arguments);
            assert!(said.contains(kind) && said.contains(name), "{arguments:?}: {said}");
            let now = fs::symlink_metadata(path(name)).unwrap().file_type();
            assert!(
                now.is_fifo() || now.is_socket() || now.is_symlink() || now.is_char_device(),
                "{arguments:?}"
            );
        };
        refuse(&["report", &dataset, "-o", out]);
        refuse(&["diagnose", &dataset, "--report", out]);
        refuse(&["diagnose", &dataset, "-o", out]);
        refuse(&["diagnose", &dataset, "--next", out]);
        refuse(&["compare", &dataset, "--model", &sensor, "--report", out]);
        refuse(&["noise", &dataset, "--report", out]);
        refuse(&["reduce", &dataset, "-o", out, "--overwrite"]);
        refuse(&["calibrate", &dataset, "-o", out, "--overwrite"]);
        refuse(&["plan-calibration", &dataset, "-o", out, "--overwrite"]);
        refuse(&["correct", &cal, &frame, "-o", out, "--overwrite", "--force"]);
        refused(&["model", "new", out]);
        refuse(&["scene", &cal, &frame, "--map", "10", "--map-output", out]);
        refuse(&["monitor", "--camera", "sim:cmos12", "--cal", &cal, "--checks", "1", "--store", out]);
        refuse(&["reproduce", "--report", out]);
        // Folders.
        refuse(&["simulate", &sensor, "--plan", "quick", "-o", out]);
        refuse(&["import", &frame, "-o", out, "--yes"]);
        refuse(&["man", "-o", out]);
    }
    assert_eq!(fs::read_to_string(path("target")).unwrap(), "kept");
    assert!(!path("nowhere").exists());
    // Folders inside a folder, and files in them.
    fs::create_dir(path("elsewhere")).unwrap();
    fs::create_dir(path("out")).unwrap();
    symlink(path("elsewhere"), path("out/frames")).unwrap();
    let out = text(&path("out"));
    let said = refused(&["correct", &cal, &dataset, "-o", &out, "--force"]);
    assert!(said.contains("out/frames") && said.contains("is a link"), "{said}");
    fs::create_dir(path("man")).unwrap();
    symlink(path("target"), path("man/radcam.1")).unwrap();
    assert!(refused(&["man", "-o", &text(&path("man"))]).contains("radcam.1: is a link"));
    // A campaign that is continued.
    for part in ["frames", "frames.csv", "capture.log"] {
        let campaign = text(&path(&format!("with-{part}")));
        expect(0, &["simulate", &sensor, "--plan", "quick", "-o", &campaign]);
        let file = Path::new(&campaign).join(part);
        fs::rename(&file, path(&format!("moved-{part}"))).unwrap();
        symlink(path(&format!("moved-{part}")), &file).unwrap();
        let before = fs::read(path("moved-frames.csv")).ok();
        let run = radcam(&["simulate", &sensor, "-o", &campaign, "--resume"]);
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        assert!(said.contains("is a link"), "{part}: {said}");
        assert!(part == "capture.log" || run.status.code() == Some(2), "{part}: {said}");
        assert_eq!(fs::read(path("moved-frames.csv")).ok(), before);
    }
    assert_eq!(path("elsewhere").read_dir().unwrap().count(), 0);
    assert_eq!(fs::read_to_string(path("target")).unwrap(), "kept");
}

/// C3: one of two captures into one new folder at once is refused, and no row names the other's pixels.
#[test]
fn one_capture_writes_into_a_folder() {
    let dir = tempfile::tempdir().unwrap();
    let sensor = text(&small_sensor(dir.path(), "cmos12", 24, 16));
    let alone = |seed: &str| {
        let path = dir.path().join(format!("alone-{seed}"));
        expect(0, &["simulate", &sensor, "--seed", seed, "--plan", "quick", "-o", &text(&path)]);
        path
    };
    let alone = [alone("1"), alone("2")];
    let frames = |root: &Path| -> Vec<Vec<u8>> {
        let rows = fs::read_to_string(root.join("frames.csv")).unwrap();
        rows.lines().skip(1).map(|row| fs::read(root.join(row.split(',').next().unwrap())).unwrap()).collect()
    };
    let expected = alone.each_ref().map(|root| frames(root));
    for round in 0..30 {
        let path = dir.path().join(format!("both-{round}"));
        let start = |seed: &str| {
            let mut command = program();
            command.args(["simulate", &sensor, "--seed", seed, "--plan", "quick", "-o"]).arg(&path);
            command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
        };
        let both = [start("1"), start("2")].map(|child| child.wait_with_output().unwrap());
        let good: Vec<usize> = (0..2).filter(|k| both[*k].status.code() == Some(0)).collect();
        assert_eq!(good.len(), 1, "{both:?}");
        let said = String::from_utf8_lossy(&both[1 - good[0]].stderr).into_owned();
        assert!(said.contains("another program is writing") || said.contains("is not empty"), "{said}");
        assert!(frames(&path) == expected[good[0]], "round {round}: frames of the other");
    }
}

/// C12: a capture that was killed at any instant before its manifest is continued, or started again, with a
/// message that says so.
#[test]
fn a_capture_without_a_manifest_is_continued() {
    let dir = tempfile::tempdir().unwrap();
    let sensor = text(&small_sensor(dir.path(), "cmos12", 24, 16));
    let whole = dir.path().join("whole");
    expect(0, &["simulate", &sensor, "--plan", "quick", "-o", &text(&whole)]);
    for parts in [&["plan.toml"][..], &["plan.toml", "frames.csv"]] {
        let cut = dir.path().join(format!("cut-{}", parts.len()));
        fs::create_dir_all(cut.join("frames")).unwrap();
        fs::copy(whole.join("plan.toml"), cut.join("plan.toml")).unwrap();
        if parts.len() > 1 {
            let rows = fs::read_to_string(whole.join("frames.csv")).unwrap();
            fs::write(cut.join("frames.csv"), format!("{}\n", rows.lines().next().unwrap())).unwrap();
        }
        fs::write(cut.join(".radcam-left"), "half").unwrap();
        expect(0, &["simulate", &sensor, "-o", &text(&cut), "--resume"]);
        for name in ["dataset.toml", "frames.csv", "plan.toml", "frames/00000.tiff", "frames/00039.tiff"] {
            assert!(fs::read(cut.join(name)).unwrap() == fs::read(whole.join(name)).unwrap(), "{name}");
        }
        assert!(!cut.join(".radcam-left").exists());
    }
    // Before the plan nothing is known of the capture.
    let bare = dir.path().join("bare");
    fs::create_dir_all(bare.join("frames")).unwrap();
    for path in [&bare, &dir.path().join("none")] {
        let said = refused(&["simulate", &sensor, "-o", &text(path), "--resume"]);
        assert!(said.contains("no capture was begun here") && said.contains("leave --resume out"), "{said}");
    }
    assert!(!dir.path().join("none").exists());
    expect(0, &["simulate", &sensor, "--plan", "quick", "-o", &text(&bare)]);
}

/// C5: a password is neither taken on the command line nor shown, wherever it stands in the address.
#[cfg(unix)]
#[test]
fn passwords_are_not_shown() {
    let dir = tempfile::tempdir().unwrap();
    let cal = dir.path().join("cal.tiff");
    calibration("m", "s", (16, 24), |_| (64.0, 1.0)).write(&cal).unwrap();
    let cal = text(&cal);
    let verbs = |address: &str| -> [Vec<String>; 2] {
        [
            ["workbench", "--history", address].map(String::from).to_vec(),
            ["monitor", "--camera", "sim:cmos12", "--cal", &cal, "--checks", "1", "--store", address]
                .map(String::from)
                .to_vec(),
        ]
    };
    let command = |arguments: &[String]| {
        let mut command = program();
        command.args(arguments).env("ADDRESS", "postgres://me:hush@127.0.0.1:1/db?password=hush");
        command.env("RADCAM_LOG", "trace").stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    };
    let run = |arguments: &[String]| -> Output { command(arguments).output().unwrap() };
    // A monitor waits a minute for its database, unless it is stopped.
    let interrupted = |arguments: &[String]| -> Output {
        let mut child = command(arguments).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
        let mut said: Vec<String> = Vec::new();
        while !said.last().is_some_and(|line| line.contains("waiting for the history")) {
            said.push(lines.next().unwrap_or_else(|| panic!("{said:?}")));
        }
        let kill = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
        assert!(kill.success());
        said.extend(lines);
        Output { stderr: said.join("\n").into_bytes(), ..child.wait_with_output().unwrap() }
    };
    let quiet_with = |code: i32, output: &Output, part: &str| {
        let said =
            format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(!said.contains("hush") && said.contains(part), "{said}");
    };
    let quiet = |output: &Output, part: &str| quiet_with(2, output, part);
    for address in [
        "postgres://me:hush@127.0.0.1:1/db",
        "postgres://:hush@127.0.0.1:1/db",
        "postgres://me:hu@/hush@127.0.0.1:1/db",
        "postgres://127.0.0.1:1/db?user=me&password=hush",
        "postgresql://127.0.0.1:1/db?Password=hush",
    ] {
        for arguments in verbs(address) {
            quiet(&run(&arguments), "command line");
        }
    }
    // From a file and from the environment it is taken; the database is not there.
    let file = dir.path().join("address");
    fs::write(&file, "postgres://me:hush@127.0.0.1:1/db\n").unwrap();
    for address in [format!("@{}", file.display()), "env:ADDRESS".into()] {
        let [workbench, monitor] = verbs(&address);
        quiet(&run(&workbench), "postgres://me@127.0.0.1:1/db");
        quiet_with(130, &interrupted(&monitor), "postgres://me@127.0.0.1:1/db");
    }
    for (address, part) in [("env:NOTHING_OF_THIS", "NOTHING_OF_THIS"), ("@/none/there", "/none/there")] {
        for arguments in verbs(address) {
            quiet(&run(&arguments), part);
        }
    }
}

/// A run that is ended by a signal after a while: exit code and time that took.
#[cfg(unix)]
fn signalled(child: Child, signal: &str, after: Duration) -> (Option<i32>, Duration) {
    let mut child = child;
    std::thread::sleep(after);
    let ended = child.try_wait().unwrap();
    assert!(ended.is_none(), "ended before the signal: {ended:?}");
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > Duration::from_secs(20) {
            child.kill().unwrap();
            panic!("{signal} does not end it");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    (child.wait().unwrap().code(), begun.elapsed())
}

/// Every verb ends within a second of SIGINT and SIGTERM, whatever it does; half a second more for a machine
/// that is busy.
#[test]
#[cfg(unix)]
fn signals_end_every_verb() {
    let dir = tempfile::tempdir().unwrap();
    let sensor = text(&small_sensor(dir.path(), "cmos12", 256, 256));
    let dataset = text(&dir.path().join("d"));
    expect(0, &["simulate", &sensor, "--plan", "quick", "-o", &dataset]);
    let cal = text(&dir.path().join("cal.tiff"));
    calibration("cmos12", "s", (256, 256), |_| (64.0, 1.0)).write(cal.as_ref()).unwrap();
    let out = |name: &str| text(&dir.path().join(name));
    let verbs = |run: &str| -> Vec<Vec<String>> {
        vec![
            vec!["reproduce".into()],
            vec!["simulate".into(), "cmos12".into(), "-o".into(), out(&format!("s{run}"))],
            vec![
                "investigate".into(),
                "--camera".into(),
                "sim:cmos12".into(),
                "-o".into(),
                out(&format!("i{run}")),
            ],
            vec!["workbench".into(), dataset.clone()],
            vec!["demo".into(), "-o".into(), out(&format!("demo{run}"))],
        ]
    };
    for signal in ["-INT", "-TERM"] {
        for arguments in verbs(signal) {
            let mut command = program();
            command.args(&arguments).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
            let (code, took) = signalled(command.spawn().unwrap(), signal, Duration::from_millis(700));
            println!("{arguments:?} {signal}: {code:?} after {took:?}");
            // 0.6 s on a machine that has nothing else to do.
            assert!(took < Duration::from_millis(1500), "{arguments:?} {signal}: {took:?}");
            assert!(matches!(code, Some(0 | 2 | 130)), "{arguments:?} {signal}: {code:?}");
        }
    }
    // An operator who does not answer.
    let mut command = program();
    command.args(["capture", "--camera", &format!("replay:{dataset}"), "-o", &out("r")]);
    command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    if child.try_wait().unwrap().is_none() {
        let (_, took) = signalled(child, "-TERM", Duration::ZERO);
        assert!(took < Duration::from_millis(1500), "{took:?}");
    }
}

/// The token of the page stands on no command line.
#[test]
#[cfg(unix)]
fn the_browser_is_given_no_token() {
    use std::io::{BufRead, BufReader};
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    let sensor = text(&small_sensor(dir.path(), "cmos12", 24, 16));
    let dataset = text(&dir.path().join("d"));
    expect(0, &["simulate", &sensor, "--plan", "quick", "-o", &dataset]);
    // A browser that keeps what it is given.
    let (browser, given) = (dir.path().join("xdg-open"), dir.path().join("given"));
    let script = format!(
        "#!/bin/sh\necho \"$@\" > {0}\ncp \"$1\" {0}.html\nstat -c %a \"$1\" > {0}.mode\n",
        given.display()
    );
    fs::write(&browser, script).unwrap();
    fs::set_permissions(&browser, fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", dir.path().display(), std::env::var("PATH").unwrap());
    let mut command = program();
    command.args(["workbench", &dataset, "--open"]).env("PATH", path).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let token = line.trim().split_once("token=").unwrap().1.to_string();
    let mode: PathBuf = format!("{}.mode", given.display()).into();
    let begun = Instant::now();
    while fs::read_to_string(&mode).map_or(true, |m| m.is_empty())
        && begun.elapsed() < Duration::from_secs(10)
    {
        std::thread::sleep(Duration::from_millis(20));
    }
    let _ = child.kill();
    let _ = child.wait();
    assert!(!fs::read_to_string(&given).unwrap().contains(&token));
    assert!(fs::read_to_string(format!("{}.html", given.display())).unwrap().contains(&token));
    assert_eq!(fs::read_to_string(&mode).unwrap().trim(), "600");
}
