//! What cables, switches, power, disks and other clients do to a stream. Every pixel of every frame follows from its number, so that none that
//! is wrong can be accepted unseen; the network is two namespaces with a program between them that does the damage.

use crate::support::{gige_port, program, small};
use radcam::calibrate::dark::DarkReference;
use radcam::calibrate::file::{Calibration, Description};
use radcam::calibrate::pattern::FixedPattern;
use radcam::dataset::{CameraInfo, image};
use radcam::ndarray::Array2;
use radcam::serve::processing::number_of;
use radcam::stream::Summary;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;
const FULL_SCALE_DN: u16 = 0xFFF;
const CAMERA: &str = "10.77.0.1";

/// A calibration that leaves every code as it is.
fn identity(path: &Path, serial: &str) {
    let shape = (HEIGHT as usize, WIDTH as usize);
    let plane = |value: f32| Array2::from_elem(shape, value);
    let dark = DarkReference {
        exposure_s: 0.01,
        level_dn: plane(0.0),
        current_dn_per_s: Some(plane(0.0)),
        std_err_dn: 0.1,
        var_dn2: 1.0,
    };
    let pattern = FixedPattern {
        k: plane(1.0),
        std_err: plane(0.001),
        kept: Array2::from_elem(shape, 9),
        pooled_sd: 0.003,
        mean_before: 1.0,
        level_dn: 900.0,
    };
    let camera = CameraInfo {
        vendor: "radcam".into(),
        model: "cmos12".into(),
        serial: serial.into(),
        width: shape.1,
        height: shape.0,
        bit_depth: 12,
        pixel_format: "Mono12".into(),
        ..Default::default()
    };
    Calibration::new(Description::of(camera), dark, pattern, &[]).write(path).unwrap();
}

/// Two namespaces and what lies between them.
struct Network {
    child: Child,
    commands: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
    names: [String; 2],
}

impl Network {
    /// `None`, with the reason printed, where namespaces cannot be made.
    fn new() -> Option<Self> {
        let probe = format!("radcam-probe-{}", std::process::id());
        let ip = |arguments: &[&str]| Command::new("ip").args(arguments).stderr(Stdio::null()).status();
        let may = ip(&["netns", "add", &probe]).is_ok_and(|s| s.success());
        if !may || !Path::new("/dev/net/tun").exists() {
            eprintln!("skipped: network namespaces and /dev/net/tun need root and iproute2");
            return None;
        }
        ip(&["netns", "del", &probe]).unwrap();
        let names = ["a", "b"].map(|end| format!("radcam-{}-{end}", std::process::id()));
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/outside/network.py");
        let mut child = Command::new("python3")
            .arg(script)
            .args(&names)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (commands, answers) = (child.stdin.take(), BufReader::new(child.stdout.take().unwrap()));
        let mut network = Self { child, commands, answers, names };
        assert_eq!(network.answer(), "ready");
        Some(network)
    }

    fn answer(&mut self) -> String {
        let mut line = String::new();
        self.answers.read_line(&mut line).unwrap();
        line.trim_end().into()
    }

    fn tell(&mut self, command: &str) -> String {
        writeln!(self.commands.as_mut().unwrap(), "{command}").unwrap();
        self.answer()
    }

    /// radcam at one end: 0 the camera's, 1 the client's.
    fn radcam(&self, end: usize) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[end]]).arg(program().get_program());
        command
    }

    /// Another program at the client's end.
    fn client(&self, name: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[1], name]);
        command
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        drop(self.commands.take());
        let _ = self.child.wait();
    }
}

/// A served camera; it ends with its standard input.
struct Camera(Child);

impl Camera {
    fn start(mut command: Command, folder: &Path, more: &[&str]) -> Self {
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
struct Running {
    child: Child,
    to: PathBuf,
}

impl Running {
    fn start(mut command: Command, folder: &Path, camera: &str, more: &[&str]) -> Self {
        let (cal, to) = (folder.join("cal.tiff"), folder.join("out"));
        identity(&cal, "UP");
        command.args(["stream", "--json", "--camera", &format!("aravis:{camera}"), "--exposure-s", "0.01"]);
        command.arg("--cal").arg(&cal).arg("--to").arg(&to).args(more);
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        Self { child, to }
    }

    /// Waits until so many frames are on the disk.
    fn reaches(&mut self, frames: usize) {
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
    fn ends(self) -> (i32, Option<Summary>, String, PathBuf) {
        let out = self.child.wait_with_output().unwrap();
        let text = String::from_utf8(out.stderr).unwrap();
        (out.status.code().unwrap_or(-1), serde_json::from_slice(&out.stdout).ok(), text, self.to)
    }
}

/// The numbers of the frames in a folder: every pixel of each is right, and the camera's numbers run as those in the pixels do.
fn numbers(to: &Path) -> Vec<u32> {
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

/// Sent, by the numbers in the pixels, is whole and lost together; a frame at either end may be on its way.
fn accounted(s: &Summary, numbers: &[u32]) {
    let sent = u64::from(numbers[numbers.len() - 1] - numbers[0]) + 1;
    let known = numbers.len() as u64 + s.received.lost();
    assert!(known >= sent && known <= sent + 3, "{sent} sent, {known} known: {s:?}");
    assert_eq!(s.corrected, s.sinks["written"].taken + s.sinks["written"].dropped);
}

/// What is done to packets, to how many of them, and whether frames are lost by it.
#[test]
fn packets_are_lost_doubled_reordered_and_changed() {
    let Some(mut network) = Network::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let _camera = Camera::start(network.radcam(0), dir.path(), &["--interface", CAMERA]);
    for (damage, share, costs) in
        [("lose", 0.003, true), ("double", 0.02, false), ("reorder", 0.02, false), ("change", 0.003, true)]
    {
        let folder = dir.path().join(damage);
        fs::create_dir(&folder).unwrap();
        assert_eq!(network.tell(&format!("{damage} {share}")), "ok");
        let stream = Running::start(network.radcam(1), &folder, CAMERA, &["--frames", "80", "--packet-size", "1400"]);
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
    assert!(["lose=", "double=", "reorder=", "change="].iter().all(|d| !done.contains(&format!("{d}0"))), "{done}");
}

/// The cable is pulled for longer than the heartbeat lasts, the interface goes down and up, the camera loses power and comes back with other
/// settings: each time the stream goes on by itself, and says how long it was without the camera.
#[test]
fn a_camera_that_was_away_is_found_again() {
    let Some(mut network) = Network::new() else { return };
    let dir = tempfile::tempdir().unwrap();
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

/// A second program is told that the first has the camera, and disturbs nothing; packets that are larger than the network takes are named as
/// what they are.
#[test]
fn two_clients_and_a_wrong_packet_size() {
    let Some(network) = Network::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let _camera = Camera::start(network.radcam(0), dir.path(), &["--interface", CAMERA]);
    let mut stream = Running::start(network.radcam(1), dir.path(), CAMERA, &["--frames", "700", "--packet-size", "1400"]);
    stream.reaches(20);
    let second = dir.path().join("second");
    fs::create_dir(&second).unwrap();
    let (code, _, log, _) = Running::start(network.radcam(1), &second, CAMERA, &["--frames", "5"]).ends();
    assert_eq!(code, 2, "{log}");
    assert!(log.contains("another program has control"), "{log}");
    let seen = network.client("arv-tool-0.8").args([&format!("--address={CAMERA}"), "control", "Width"]).output();
    assert!(seen.is_ok());
    let (code, summary, log, to) = stream.ends();
    let summary = summary.unwrap_or_else(|| panic!("{log}"));
    // 700 frames pass the end of the 16-bit numbers, which begin at 65401 here.
    let numbers = numbers(&to);
    accounted(&summary, &numbers);
    // A wrap that is taken for a loss would cost 65 000; a busy machine may lose some.
    assert!(summary.corrected == 700 && summary.received.lost() < 20, "{summary:?} {log}");
    assert_eq!(code == 1, summary.received.lost() > 0);

    let large = dir.path().join("large");
    fs::create_dir(&large).unwrap();
    // The ordinary socket puts fragments together; the packet socket takes the first for the whole.
    let more = ["--seconds", "9", "--packet-size", "9000", "--patience", "1", "--packet-socket"];
    let (code, summary, log, _) = Running::start(network.radcam(1), &large, CAMERA, &more).ends();
    assert!(code != 0 && summary.is_none_or(|s| s.corrected == 0), "{log}");
    assert!(log.contains("packet size"), "{log}");
}

/// A disk that is slower than the camera costs the oldest frames, counted; a full one ends the stream with the file's name; what was written is
/// whole, also where the program is killed.
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
    let built = Command::new("gcc").args(["-shared", "-fPIC", "-o"]).args([&library, &source]).status().unwrap();
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
        eprintln!("skipped in part: a full disk needs the privilege to mount");
        return;
    }
    let script = format!("{first} && (\"$@\"; code=$?; cp -r {} {}; exit $code)", full.display(), kept.display());
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

/// Two cameras at once, each by its own program.
#[test]
fn two_cameras_at_once() {
    let _port = gige_port();
    let added = Command::new("ip").args(["addr", "add", "127.0.0.2/8", "dev", "lo"]).stderr(Stdio::null()).status();
    if added.is_err() || std::net::UdpSocket::bind(("127.0.0.2", 0)).is_err() {
        eprintln!("skipped: a second address of the loopback interface needs root and iproute2");
        return;
    }
    let addresses = ["127.0.0.1", "127.0.0.2"];
    let folders = addresses.map(|_| tempfile::tempdir().unwrap());
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
