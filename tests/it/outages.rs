//! Effects of cables, switches, power, disks and other clients on a stream. Every pixel of every frame
//! follows from its number, so that none that is wrong can be accepted unseen; the network is two namespaces
//! with a program between them that does the damage.

use crate::network::Network;
use crate::support::{calibration, expect, gige_port, program, small};
use radcam::correct::{Codes, Corrector};
use radcam::dataset::image;
use radcam::serve::processing::{number_of, numbered};
use radcam::stream::Summary;
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;
const FULL_SCALE_DN: u16 = 0xFFF;
const CAMERA: &str = "10.77.0.1";

/// A calibration that leaves every code as it is.
pub fn identity(path: &Path, serial: &str) {
    let shape = (HEIGHT as usize, WIDTH as usize);
    calibration("cmos12", serial, shape, |_| (0.0, 1.0)).write(path).unwrap();
}

/// A program that is ended with the test.
pub struct Camera(pub Child);

impl Camera {
    pub fn start(mut command: Command, folder: &Path, more: &[&str]) -> Self {
        let model = folder.join("camera.toml");
        fs::write(&model, small("cmos12", WIDTH, HEIGHT).to_toml().unwrap()).unwrap();
        command.arg("serve").arg(&model).args(["--serial", "UP", "--while-stdin", "--json"]);
        command.args(["--stuck", "TestPattern=FrameNumber"]).args(more);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        assert!(line.contains("UP"), "{line}");
        Self(child)
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A stream under way.
pub struct Running {
    pub child: Child,
    pub to: PathBuf,
}

impl Running {
    pub fn start(mut command: Command, folder: &Path, camera: &str, more: &[&str]) -> Self {
        let (cal, to) = (folder.join("cal.tiff"), folder.join("out"));
        identity(&cal, "UP");
        command.args(["stream", "--json", "--camera", &format!("aravis:{camera}"), "--exposure-s", "0.01"]);
        command.arg("--cal").arg(&cal).arg("--to").arg(&to).args(more);
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        Self { child, to }
    }

    /// Waits until so many frames are on the disk.
    pub fn reaches(&mut self, frames: usize) {
        let begun = Instant::now();
        let rows = |to: &Path| fs::read_to_string(to.join("frames.csv")).map_or(0, |t| t.lines().count());
        while rows(&self.to) <= frames {
            if let Some(status) = self.child.try_wait().unwrap() {
                let mut text = String::new();
                self.child.stderr.take().unwrap().read_to_string(&mut text).unwrap();
                panic!("it ended with {status} before {frames} frames: {text}");
            }
            assert!(begun.elapsed() < Duration::from_secs(60), "{frames} frames did not come");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Waits for its end: exit code, summary, log.
    pub fn ends(self) -> (i32, Option<Summary>, String, PathBuf) {
        let out = self.child.wait_with_output().unwrap();
        let text = String::from_utf8(out.stderr).unwrap();
        (out.status.code().unwrap_or(-1), serde_json::from_slice(&out.stdout).ok(), text, self.to)
    }
}

/// A folder in memory, where there is one: every frame is brought to the disk, and one that is busy with
/// others' files would take longer than the camera. What a slow disk does has a test of its own.
pub fn in_memory() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// The numbers of the frames in a folder: every pixel of each is right, and the camera's numbers run as those
/// in the pixels do.
pub fn numbers(to: &Path) -> Vec<u32> {
    let rows = fs::read_to_string(to.join("frames.csv")).unwrap();
    let mut out: Vec<(u32, u64)> = Vec::new();
    for row in rows.lines().skip(1) {
        let (file, rest) = row.split_once(',').unwrap();
        let id: u64 = rest.split(',').next().unwrap().parse().unwrap();
        let pixels = image::read_single(&to.join(file)).unwrap();
        let number = number_of(pixels.as_slice().unwrap(), FULL_SCALE_DN);
        out.push((number.unwrap_or_else(|| panic!("{file} holds pixels that were never sent")), id));
    }
    for pair in out.windows(2) {
        assert!(pair[0].0 < pair[1].0, "frame {} came after {}", pair[1].0, pair[0].0);
    }
    out.into_iter().map(|(number, _)| number).collect()
}

/// Sent, by the numbers in the pixels, is written, dropped by the writer and lost together; a frame at either
/// end may be on its way.
fn accounted(s: &Summary, numbers: &[u32]) {
    let sent = u64::from(numbers[numbers.len() - 1] - numbers[0]) + 1;
    let known = numbers.len() as u64 + s.received.lost();
    let dropped = s.sinks["written"].dropped;
    assert!(
        known + dropped >= sent && known <= sent + 3,
        "{sent} sent, {known} known and {dropped} dropped: {s:?}"
    );
    assert_eq!(s.corrected, s.sinks["written"].taken + s.sinks["written"].dropped);
}

/// What is done to packets, to how many of them, and whether frames are lost by it.
#[test]
fn packets_are_lost_doubled_reordered_and_changed() {
    let Some(mut network) = Network::new() else { return };
    let dir = in_memory();
    let _camera = Camera::start(network.radcam(0), dir.path(), &["--interface", CAMERA]);
    for (damage, share, costs) in
        [("lose", 0.003, true), ("double", 0.02, false), ("reorder", 0.02, false), ("change", 0.003, true)]
    {
        let folder = dir.path().join(damage);
        fs::create_dir(&folder).unwrap();
        assert_eq!(network.tell(&format!("{damage} {share}")), "ok");
        let stream =
            Running::start(network.radcam(1), &folder, CAMERA, &["--frames", "80", "--packet-size", "1400"]);
        let (code, summary, log, to) = stream.ends();
        assert_eq!(network.tell(&format!("{damage} 0")), "ok");
        let summary = summary.unwrap_or_else(|| panic!("{damage}: {log}"));
        let numbers = numbers(&to);
        accounted(&summary, &numbers);
        assert_eq!(summary.corrected, 80, "{damage}");
        assert_eq!(code == 1, summary.received.lost() > 0, "{damage}: {summary:?}");
        // 80 frames of 112 packets: 0.3 % of them cost every fourth frame, and 27 more are on average needed.
        assert_eq!(summary.received.lost() > 3, costs, "{damage}: {summary:?}");
    }
    let done = network.tell("done");
    assert!(
        ["lose=", "double=", "reorder=", "change="].iter().all(|d| !done.contains(&format!("{d}0"))),
        "{done}"
    );
}

/// The cable is pulled for longer than the heartbeat lasts, the interface goes down and up, the camera loses
/// power and comes back with other settings: each time the stream goes on by itself, and says how long it was
/// without the camera.
#[test]
fn a_camera_that_was_away_is_found_again() {
    let Some(mut network) = Network::new() else { return };
    let dir = in_memory();
    let mut camera = Camera::start(network.radcam(0), dir.path(), &["--interface", CAMERA]);
    let mut stream = Running::start(network.radcam(1), dir.path(), CAMERA, &["--packet-size", "1400"]);
    stream.reaches(20);
    network.tell("cut");
    std::thread::sleep(Duration::from_secs(8));
    network.tell("join");
    stream.reaches(400);
    let end = network.names[1].clone();
    let link = |to: &str| {
        let status = Command::new("ip").args(["-n", &end, "link", "set", "tap0", to]).status().unwrap();
        assert!(status.success());
    };
    link("down");
    std::thread::sleep(Duration::from_secs(1));
    link("up");
    stream.reaches(800);
    drop(camera);
    std::thread::sleep(Duration::from_secs(1));
    camera = Camera::start(network.radcam(0), dir.path(), &["--interface", CAMERA]);
    std::thread::sleep(Duration::from_secs(9));
    stream.reaches(1000);
    let pid = stream.child.id().to_string();
    // `ip netns exec` becomes the program.
    assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
    let (code, summary, log, to) = stream.ends();
    let summary = summary.unwrap_or_else(|| panic!("{log}"));
    assert_eq!(code, 1, "{summary:?}");
    assert!(summary.reconnections >= 2 && summary.away_s > 1.0, "{summary:?} {log}");
    assert!(log.contains("the camera is back"), "{log}");
    // The camera that was switched on again counts from the start.
    let rows = fs::read_to_string(to.join("frames.csv")).unwrap();
    for row in rows.lines().skip(1) {
        let pixels = image::read_single(&to.join(row.split_once(',').unwrap().0)).unwrap();
        assert!(number_of(pixels.as_slice().unwrap(), FULL_SCALE_DN).is_some(), "{row}");
    }
    drop(camera);
}

/// The program is stopped for longer than the heartbeat lasts, and for less: what the camera sent meanwhile
/// is counted.
#[test]
fn frames_of_a_stopped_program_are_counted() {
    let _port = gige_port();
    let dir = in_memory();
    let _camera = Camera::start(program(), dir.path(), &[]);
    for (name, stopped_s) in [("short", 1.0), ("long", 6.0)] {
        let folder = dir.path().join(name);
        fs::create_dir(&folder).unwrap();
        let mut stream = Running::start(program(), &folder, "127.0.0.1", &["--frames", "400"]);
        stream.reaches(50);
        let pid = stream.child.id().to_string();
        let signal = |s: &str| assert!(Command::new("kill").args([s, &pid]).status().unwrap().success());
        signal("-STOP");
        std::thread::sleep(Duration::from_secs_f64(stopped_s));
        signal("-CONT");
        let (code, summary, log, to) = stream.ends();
        let summary = summary.unwrap_or_else(|| panic!("{log}"));
        println!("{name}: exit {code}, {summary:?}");
        accounted(&summary, &numbers(&to));
        assert_eq!(summary.reconnections > 0, name == "long", "{summary:?} {log}");
    }
}

/// A second program is told that the first has the camera, and disturbs nothing; packets that are larger than
/// the network takes come in fragments, and sizes that no camera takes are named.
#[test]
fn two_clients_and_a_wrong_packet_size() {
    let Some(network) = Network::new() else { return };
    let dir = in_memory();
    let _camera = Camera::start(network.radcam(0), dir.path(), &["--interface", CAMERA]);
    let mut stream =
        Running::start(network.radcam(1), dir.path(), CAMERA, &["--frames", "700", "--packet-size", "1400"]);
    stream.reaches(20);
    let second = dir.path().join("second");
    fs::create_dir(&second).unwrap();
    let (code, _, log, _) = Running::start(network.radcam(1), &second, CAMERA, &["--frames", "5"]).ends();
    assert_eq!(code, 2, "{log}");
    assert!(log.contains("another program has control"), "{log}");
    let seen =
        network.client("arv-tool-0.8").args([&format!("--address={CAMERA}"), "control", "Width"]).output();
    assert!(seen.is_ok());
    let (code, summary, log, to) = stream.ends();
    let summary = summary.unwrap_or_else(|| panic!("{log}"));
    let numbers = numbers(&to);
    accounted(&summary, &numbers);
    // A wrap that is taken for a loss would cost 65 000; a busy machine may lose some.
    assert!(summary.corrected == 700 && summary.received.lost() < 20, "{summary:?} {log}");
    assert_eq!(code == 1, summary.received.lost() > 0);

    let large = dir.path().join("large");
    fs::create_dir(&large).unwrap();
    // The system puts fragments together again.
    let more = ["--frames", "20", "--packet-size", "9000"];
    let (_, summary, log, _) = Running::start(network.radcam(1), &large, CAMERA, &more).ends();
    assert_eq!(summary.unwrap_or_else(|| panic!("{log}")).corrected, 20, "{log}");
    // A packet into which no leader fits is named.
    let small = dir.path().join("small");
    fs::create_dir(&small).unwrap();
    let more = ["--seconds", "9", "--packet-size", "36", "--patience", "1"];
    let (code, _, log, _) = Running::start(network.radcam(1), &small, CAMERA, &more).ends();
    assert!(code == 2 && log.contains("GevSCPSPacketSize"), "{log}");
}

/// A disk that is slower than the camera costs the oldest frames, counted; a full one ends the stream with
/// the file's name; what was written is whole, also where the program is killed.
#[test]
fn slow_and_full_disks_and_a_kill() {
    let dir = tempfile::tempdir().unwrap();
    let cal = dir.path().join("cal.tiff");
    identity(&cal, "SIM12");
    let model = dir.path().join("camera.toml");
    fs::write(&model, small("cmos12", WIDTH, HEIGHT).to_toml().unwrap()).unwrap();
    let start = |to: &Path, preload: Option<&Path>, more: &[&str]| {
        let mut command = program();
        if let Some(library) = preload {
            command.env("LD_PRELOAD", library);
        }
        command.arg("stream").arg("--camera").arg(format!("sim:{}", model.display())).arg("--cal").arg(&cal);
        command.arg("--json").arg("--to").arg(to).args(more);
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let whole = |to: &Path| {
        let rows = fs::read_to_string(to.join("frames.csv")).unwrap();
        let names: Vec<&str> = rows.lines().skip(1).map(|r| r.split(',').next().unwrap()).collect();
        for name in &names {
            assert_eq!(image::read_single(&to.join(name)).unwrap().dim(), (HEIGHT as usize, WIDTH as usize));
        }
        names.len()
    };
    // A disk that takes 10 ms to synchronise, and the simulator, which takes one for a frame.
    let (source, library) = (dir.path().join("slow.c"), dir.path().join("slow.so"));
    fs::write(&source, "#include <unistd.h>\nint fsync(int f) { (void)f; return usleep(10000); }\n").unwrap();
    let built =
        Command::new("gcc").args(["-shared", "-fPIC", "-o"]).args([&library, &source]).status().unwrap();
    assert!(built.success());
    let slow = dir.path().join("slow");
    let out = start(&slow, Some(&library), &["--frames", "800"]).wait_with_output().unwrap();
    let s: Summary = serde_json::from_slice(&out.stdout).unwrap();
    let written = s.sinks["written"];
    assert_eq!((out.status.code(), written.taken + written.dropped, s.corrected), (Some(1), 800, 800));
    assert!(written.dropped > 0 && whole(&slow) as u64 == written.taken, "{s:?}");

    let killed = dir.path().join("killed");
    let mut child = start(&killed, None, &[]);
    std::thread::sleep(Duration::from_millis(1500));
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(whole(&killed) > 0);

    let full = dir.path().join("full");
    fs::create_dir(&full).unwrap();
    // What lies under the mount is seen by the program alone: it copies its rows out at the end.
    let kept = dir.path().join("kept");
    let first = format!("mount -t tmpfs -o size=4m none {0}", full.display());
    let probe = Command::new("unshare").args(["-m", "true"]).status();
    if !probe.is_ok_and(|s| s.success()) {
        println!("SKIPPED in part: a full disk needs the privilege to mount");
        return;
    }
    let script =
        format!("{first} && (\"$@\"; code=$?; cp -r {} {}; exit $code)", full.display(), kept.display());
    let mut command = Command::new("unshare");
    command.args(["-m", "sh", "-c", &script, "sh"]).arg(program().get_program());
    command.arg("stream").arg("--camera").arg(format!("sim:{}", model.display())).arg("--cal").arg(&cal);
    let out = command.arg("--to").arg(full.join("out")).output().unwrap();
    let text = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(2), "{text}");
    assert!(text.contains("No space left") && text.contains("frames/0000"), "{text}");
    let frames = whole(&kept.join("out"));
    assert!(frames > 10, "{frames}");
    // Nothing half-written is left.
    assert_eq!(fs::read_dir(kept.join("out/frames")).unwrap().count(), frames);
}

/// Whether the loopback interface has a second address, for a second camera.
fn second_loopback() -> bool {
    let ip =
        Command::new("ip").args(["addr", "add", "127.0.0.2/8", "dev", "lo"]).stderr(Stdio::null()).status();
    let there = ip.is_ok() && std::net::UdpSocket::bind(("127.0.0.2", 0)).is_ok();
    if !there {
        println!("SKIPPED: a second address of the loopback interface needs root and iproute2");
    }
    there
}

/// Corrected frames that are offered again: Aravis's own program receives them whole, and a client that
/// shares nothing with Aravis saves them, each pixel what `correct` makes of the frame of that number.
#[test]
fn corrected_frames_are_served_again() {
    let _port = gige_port();
    if !second_loopback() {
        return;
    }
    let dir = in_memory();
    let shape = (HEIGHT as usize, WIDTH as usize);
    // The pixels that hold the number stay as they are.
    let maps = |i: usize| match i {
        0..8 => (0.0, 1.0),
        _ => (60.0 + (i * 31 % 97) as f32 / 10.0, 0.9 + (i * 17 % 101) as f32 / 500.0),
    };
    let made = calibration("cmos12", "UP", shape, maps);
    let cal = dir.path().join("cal.tiff");
    made.write(&cal).unwrap();
    let codes = Codes { scale: 8.0, offset: 512.0 };
    let corrector = Corrector::new(&made, 0.01).unwrap();
    let _camera = Camera::start(program(), dir.path(), &[]);
    let mut command = program();
    command
        .args(["stream", "--camera", "aravis:127.0.0.1", "--cal"])
        .arg(&cal)
        .args(["--codes", "8,512", "--json"]);
    command.args(["--serve-as", "AGAIN", "--interface", "127.0.0.2", "--exposure-s", "0.01"]);
    let mut stream = Camera(command.stdout(Stdio::piped()).spawn().unwrap());
    std::thread::sleep(Duration::from_secs(3));
    if std::env::var_os("RADCAM_TEST_TOOLS").is_some() && std::env::var_os("RADCAM_TEST_VENV").is_some() {
        // A busy machine may cost the receiver a packet: one run of three must be whole.
        let whole = || {
            let tool =
                ["-s", "INT", "3", "arv-camera-test-0.8", "--name", "127.0.0.2", "--gv-packet-size", "8000"];
            let text =
                String::from_utf8(Command::new("timeout").args(tool).output().unwrap().stdout).unwrap();
            let count = |name: &str| {
                let line =
                    text.lines().find(|l| l.starts_with(name)).unwrap_or_else(|| panic!("{name}: {text}"));
                line.rsplit(' ').next().unwrap().parse::<u64>().unwrap()
            };
            println!("{text}");
            // Underruns may be packets of the other camera: the tool's packet socket sees them until its
            // filter is set. Underruns of this camera leave a gap in the numbers of its frames.
            count("n_completed_buffers") > 50 && ["n_failures", "n_missing_frames"].map(count) == [0, 0]
        };
        assert!((0..3).any(|_| whole()));
    }
    let saved = dir.path().join("saved");
    fs::create_dir(&saved).unwrap();
    if std::env::var_os("RADCAM_TEST_VENV").is_none() {
        println!("SKIPPED in part: RADCAM_TEST_VENV names no Python environment with viva-genicam");
    }
    if let Some(python) = std::env::var_os("RADCAM_TEST_VENV").map(PathBuf::from) {
        let out = Command::new(python.join("bin/viva-camctl"))
            .args(["--iface", "127.0.0.2", "stream", "--packet-size", "8000", "--duration-s", "3"])
            .args(["--save", "100", "--save-format", "tiff", "--ip", "127.0.0.2"])
            .current_dir(&saved)
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr);
        assert!(text.contains("incomplete=0 missed=0"), "{text}");
        let mut seen = std::collections::BTreeSet::new();
        for file in fs::read_dir(&saved).unwrap().map(|e| e.unwrap().path()) {
            let got = image::read_single(&file).unwrap();
            let first = &got.as_slice().unwrap()[..8];
            let digits = first.iter().rev().map(|c| u32::from(*c - 512) / 8);
            let number = digits.fold(0, |n, d| n << 4 | d);
            let (mut raw, mut corrected) = (vec![0; shape.0 * shape.1], vec![0; shape.0 * shape.1]);
            numbered(number, FULL_SCALE_DN, &mut raw);
            corrector.to_u16(&raw, codes, &mut corrected).unwrap();
            assert!(got.iter().eq(&corrected), "frame {number} of {}", file.display());
            assert!(seen.insert(number), "frame {number} came twice");
            if seen.len() == 1 {
                // What the verb makes of the same frame.
                let (one, out) = (dir.path().join("one.tiff"), dir.path().join("corrected.tiff"));
                let raw = radcam::ndarray::Array2::from_shape_vec(shape, raw).unwrap();
                let bytes =
                    image::described_bytes::<tiff::encoder::colortype::Gray16>(raw.view(), "raw").unwrap();
                fs::write(&one, bytes).unwrap();
                let [cal, one, out] = [&cal, &one, &out].map(|p| p.to_str().unwrap());
                expect(0, &["correct", cal, one, "-o", out, "--codes", "8,512", "--exposure-s", "0.01"]);
                assert_eq!(image::read_single(Path::new(out)).unwrap(), got);
            }
        }
        assert_eq!(seen.len(), 100);
    }
    let pid = stream.0.id().to_string();
    assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
    let mut text = String::new();
    stream.0.stdout.take().unwrap().read_to_string(&mut text).unwrap();
    stream.0.wait().unwrap();
    let summary: Summary = serde_json::from_str(&text).unwrap();
    let client = std::env::var_os("RADCAM_TEST_VENV").is_some();
    assert_eq!(summary.sinks["served"].taken > 100, client, "{summary:?}");
    assert_eq!(summary.reconnections, 0, "{summary:?}");
}

/// Two cameras of two megapixels, corrected live for RADCAM_MINUTES (ten where not given): the rates that
/// Aravis's own program and ours sustain, and every frame accounted for by the number in its pixels. In
/// release: its figures stand in docs/BENCHMARKS.md.
#[test]
#[ignore = "ten minutes; run it in release"]
fn two_cameras_for_ten_minutes() {
    use radcam::camera::{self, Value};
    use radcam::stream::{Corrected, Options, Sink, SinkCounts, StreamError, run};
    use std::sync::{Arc, atomic::AtomicBool};
    assert!(second_loopback());
    let minutes: f64 = std::env::var("RADCAM_MINUTES").map_or(10.0, |m| m.parse().unwrap());
    // What a network for cameras carries; both programs take the same.
    let packet = std::env::var("RADCAM_PACKET").unwrap_or("8000".into());
    let (width, height) = (1936u32, 1088u32);
    let dir = in_memory();
    let model = dir.path().join("two.toml");
    fs::write(&model, small("cmos12", width, height).to_toml().unwrap()).unwrap();
    let addresses = ["127.0.0.1", "127.0.0.2"];
    let _cameras: Vec<Camera> = addresses
        .iter()
        .map(|a| {
            let mut command = program();
            command.arg("serve").arg(&model).args([
                "--serial",
                "UP",
                "--while-stdin",
                "--json",
                "--interface",
                a,
            ]);
            command.args(["--stuck", "TestPattern=FrameNumber"]);
            let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
            BufReader::new(child.stdout.take().unwrap()).read_line(&mut String::new()).unwrap();
            Camera(child)
        })
        .collect();
    let rate = |hz: f64| {
        for a in addresses {
            let mut camera = camera::open(&format!("aravis:{a}")).unwrap();
            camera.set_feature("AcquisitionFrameRate", &Value::Float(hz)).unwrap();
        }
    };
    // Aravis's program with both cameras, as fast as they send.
    let alone = |seconds: u32, cameras: &[&str]| -> Vec<f64> {
        let runs: Vec<Child> = cameras
            .iter()
            .map(|a| {
                let s = seconds.to_string();
                let arguments =
                    ["-s", "INT", &s, "arv-camera-test-0.8", "--name", a, "--gv-packet-size", &packet];
                Command::new("timeout")
                    .args(arguments)
                    .stdout(Stdio::piped())
                    .stderr(Stdio::null())
                    .spawn()
                    .unwrap()
            })
            .collect();
        let whole = |child: Child| {
            let text = String::from_utf8(child.wait_with_output().unwrap().stdout).unwrap();
            println!(
                "{}",
                text.lines()
                    .filter(|l| l.starts_with("n_") && !l.ends_with("= 0"))
                    .collect::<Vec<_>>()
                    .join("; ")
            );
            // Whole seconds in between: it takes some to begin and to end.
            let per_s: Vec<f64> =
                text.lines().filter_map(|l| l.split_once(" frames/s")?.0.trim().parse().ok()).collect();
            let middle = &per_s[1..];
            middle.iter().sum::<f64>() / middle.len() as f64
        };
        runs.into_iter().map(whole).collect()
    };
    rate(1000.0);
    let one = alone(15, &addresses[..1]);
    let peer = alone(20, &addresses);
    println!("arv-camera-test: one camera alone {one:.1?} frames/s, both at once {peer:.1?}");
    struct Check {
        numbers: u64,
        first: Option<u32>,
        last: u32,
    }
    impl Sink for Check {
        fn name(&self) -> &'static str {
            "checked"
        }
        fn take(&mut self, frame: &Arc<Corrected>) -> Result<(), StreamError> {
            // The number stands in the first pixels, of every frame; all pixels of every hundredth are
            // compared, so that what is timed is the stream and not this test.
            let head = number_of(&frame.pixels[..8], FULL_SCALE_DN).expect("no number");
            let number = if !head.is_multiple_of(100) {
                head
            } else {
                number_of(&frame.pixels, FULL_SCALE_DN).expect("a pixel is wrong")
            };
            assert!(self.first.is_none() || number > self.last);
            self.first.get_or_insert(number);
            self.last = number;
            self.numbers += 1;
            Ok(())
        }
        fn counts(&self) -> SinkCounts {
            SinkCounts { taken: self.numbers, dropped: 0 }
        }
    }
    let shape = (height as usize, width as usize);
    let made = calibration("cmos12", "UP", shape, |_| (0.0, 1.0));
    let stop = AtomicBool::new(false);
    let ours: Vec<(Summary, f64)> = std::thread::scope(|scope| {
        let threads: Vec<_> = addresses
            .iter()
            .map(|a| {
                let (made, stop, packet) = (&made, &stop, &packet);
                scope.spawn(move || {
                    let mut options = Options {
                        duration: Some(Duration::from_secs_f64(60.0 * minutes)),
                        ..Options::default()
                    };
                    options.stream.packet_size = packet.parse().ok();
                    let mut check = Check { numbers: 0, first: None, last: 0 };
                    let summary = {
                        struct By<'a>(&'a mut Check);
                        impl Sink for By<'_> {
                            fn name(&self) -> &'static str {
                                self.0.name()
                            }
                            fn take(&mut self, frame: &Arc<Corrected>) -> Result<(), StreamError> {
                                self.0.take(frame)
                            }
                            fn counts(&self) -> SinkCounts {
                                self.0.counts()
                            }
                        }
                        let mut sinks: Vec<Box<dyn Sink + '_>> = vec![Box::new(By(&mut check))];
                        let mut open = || camera::open(&format!("aravis:{a}"));
                        run(&mut open, made, &options, &mut sinks, &mut |_| {}, stop).unwrap()
                    };
                    let sent = u64::from(check.last - check.first.unwrap()) + 1;
                    let known = check.numbers + summary.received.lost();
                    println!("{a}: {sent} sent, {} whole, {known} known; {summary:?}", check.numbers);
                    assert!(known >= sent && known <= sent + 3);
                    let per_s = summary.frames_per_s;
                    (summary, per_s)
                })
            })
            .collect();
        threads.into_iter().map(|t| t.join().unwrap()).collect()
    });
    let sum = |all: &[f64]| all.iter().sum::<f64>();
    let ours: Vec<f64> = ours.iter().map(|(_, per_s)| *per_s).collect();
    let after = alone(20, &addresses);
    println!("radcam stream: {ours:.1?} frames/s; arv-camera-test after it {after:.1?}");
    let share = sum(&ours) / (0.5 * (sum(&peer) + sum(&after)));
    println!("share of what arv-camera-test sustains with both: {:.0} %", 100.0 * share);
    assert!(share >= 0.8);
}

/// Two cameras at once, each by its own program.
#[test]
fn two_cameras_at_once() {
    let _port = gige_port();
    if !second_loopback() {
        return;
    }
    let addresses = ["127.0.0.1", "127.0.0.2"];
    let folders = addresses.map(|_| in_memory());
    let cameras: Vec<Camera> = addresses
        .iter()
        .zip(&folders)
        .map(|(a, dir)| Camera::start(program(), dir.path(), &["--interface", a]))
        .collect();
    let streams: Vec<Running> = addresses
        .iter()
        .zip(&folders)
        .map(|(a, dir)| Running::start(program(), dir.path(), a, &["--frames", "150"]))
        .collect();
    for stream in streams {
        let (_, summary, log, to) = stream.ends();
        let summary = summary.unwrap_or_else(|| panic!("{log}"));
        accounted(&summary, &numbers(&to));
        assert_eq!(summary.corrected, 150);
    }
    drop(cameras);
}

/// The computer's clock is set forward by an hour and back by two while frames come: each comes through, and
/// the latency is that of frames, not of clocks.
#[test]
fn the_clock_is_set_while_frames_come() {
    let _port = gige_port();
    let (dir, aside) = (in_memory(), tempfile::tempdir().unwrap());
    let (source, library) = (aside.path().join("clock.c"), aside.path().join("clock.so"));
    // Steps 2 and 3 s after the first look at it.
    let text = r"
        #define _GNU_SOURCE
        #include <time.h>
        #include <unistd.h>
        #include <sys/syscall.h>
        int clock_gettime(clockid_t id, struct timespec *t) {
            static long begun;
            int done = syscall(SYS_clock_gettime, id, t);
            if (id == CLOCK_REALTIME) {
                struct timespec m;
                syscall(SYS_clock_gettime, CLOCK_MONOTONIC, &m);
                long ms = m.tv_sec * 1000 + m.tv_nsec / 1000000;
                if (!begun) begun = ms;
                if (ms - begun > 3000) t->tv_sec -= 3600;
                else if (ms - begun > 2000) t->tv_sec += 3600;
            }
            return done;
        }
    ";
    fs::write(&source, text).unwrap();
    let built =
        Command::new("gcc").args(["-shared", "-fPIC", "-o"]).args([&library, &source]).status().unwrap();
    assert!(built.success());
    let _camera = Camera::start(program(), dir.path(), &[]);
    let mut command = program();
    command.env("LD_PRELOAD", &library);
    // 100 frames a second.
    let stream = Running::start(command, dir.path(), "127.0.0.1", &["--frames", "500"]);
    let (code, summary, log, to) = stream.ends();
    let summary = summary.unwrap_or_else(|| panic!("{log}"));
    accounted(&summary, &numbers(&to));
    assert_eq!((code == 1, summary.corrected), (summary.received.lost() > 0, 500), "{summary:?} {log}");
    assert!(summary.received.lost() < 5 && summary.reconnections == 0, "{summary:?} {log}");
    let latency = summary.latency.unwrap();
    assert!(latency.median_ms < 500.0 && latency.worst_ms < 60_000.0, "{latency:?}");
}

/// Bytes of memory that this process holds.
fn resident() -> u64 {
    let pages = fs::read_to_string("/proc/self/statm").unwrap();
    4096 * pages.split(' ').nth(1).unwrap().parse::<u64>().unwrap()
}

/// Served and received in this process, each frame looked at in place: memory after the first tenth is memory
/// at the end. So many cameras opened, used and closed leave nothing behind either.
fn no_growth(frames: u64, openings: u32) {
    use radcam::camera::{self, StreamOptions, Value};
    use radcam::frame::Frame;
    use radcam::serve::{Options, serve};
    let _port = gige_port();
    let sensor = radcam_sim::Sensor::new(small("cmos12", 64, 48)).unwrap();
    let options = Options { stuck: vec![("TestPattern".into(), "FrameNumber".into())], ..Options::default() };
    let _served = serve(sensor.into(), [127, 0, 0, 1].into(), "GROW", &options).unwrap();
    let mut memory = Frame::new(0, 0);
    let mut stream_for = |frames: u64, warm: u64| {
        let mut camera = camera::open("aravis:127.0.0.1").unwrap();
        camera.set_feature("AcquisitionFrameRate", &Value::Float(1000.0)).unwrap();
        let mut stream = camera.stream(&StreamOptions::default()).unwrap();
        let (mut bytes, mut before) = (0, 0);
        for number in 0..frames {
            stream
                .next_arrived(&mut memory, Duration::from_secs(10), &mut |a| {
                    bytes += a.map_or(0, |a| a.bytes.len())
                })
                .unwrap();
            if number == warm {
                before = resident();
            }
        }
        assert!(bytes > 0);
        resident().saturating_sub(before)
    };
    let grown = stream_for(frames, frames / 10);
    println!("{frames} frames: {grown} bytes more at the end than after a tenth of them");
    assert!(grown < 1 << 20, "{grown} bytes");
    let mut open = |times: u32| (0..times).map(|_| stream_for(5, 0)).max();
    open(5);
    // The allocator takes memory for new threads now and then, a megabyte at once; what leaks grows each
    // time.
    let mut round = || {
        let before = resident();
        open(openings);
        let each = resident().saturating_sub(before) / u64::from(openings);
        println!("{openings} openings: {each} bytes each");
        each
    };
    let each = (0..4).map(|_| round()).find(|&each| each < 4096).unwrap_or_else(round);
    // A description alone has 30 kB, a buffer of a frame 6 kB.
    assert!(each < 4096, "{each} bytes");
}

#[test]
fn frames_and_openings_leave_no_memory_behind() {
    no_growth(4000, 20);
}

#[test]
#[ignore = "two minutes: cargo test --release --test it -- --ignored outages::a_hundred_thousand --nocapture"]
fn a_hundred_thousand_frames_leave_no_memory_behind() {
    no_growth(100_000, 200);
}
