//! The workbench: who it answers, and the whole story in a browser.

use crate::support::{expect, program, shared};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// A copy of a practice dataset, since the workbench keeps its steps beside the frames.
fn copy(name: &str, to: &Path) -> Option<PathBuf> {
    let from = shared("practice")?.join(name);
    let done = Command::new("cp").arg("-r").arg(from).arg(to).status().unwrap();
    assert!(done.success());
    Some(to.join(name))
}

/// A running workbench; ended when it is dropped.
struct Running {
    child: Child,
    host: String,
    token: String,
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Running {
    fn start(arguments: &[&str]) -> Self {
        let mut child = program().arg("workbench").args(arguments).stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let (host, token) = line.trim().trim_start_matches("http://").split_once("/?token=").unwrap();
        Self { host: host.into(), token: token.into(), child }
    }

    /// Status and text of an answer; of a name in `headers` that is Host, that is the host.
    fn ask(&self, method: &str, path: &str, headers: &[(&str, &str)]) -> (u16, String) {
        self.ask_with(method, path, headers, "")
    }

    /// Status and text of an answer to a form.
    fn ask_with(&self, method: &str, path: &str, headers: &[(&str, &str)], form: &str) -> (u16, String) {
        let mut stream = TcpStream::connect(self.host.replace("0.0.0.0", "127.0.0.1")).unwrap();
        let host = headers.iter().find(|h| h.0 == "Host").map_or(&*self.host, |h| h.1);
        let length = form.len();
        let mut text = format!(
            "{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nContent-Length: {length}\r\n"
        );
        for (name, value) in headers.iter().filter(|h| h.0 != "Host") {
            text += &format!("{name}: {value}\r\n");
        }
        stream.write_all(format!("{text}\r\n{form}").as_bytes()).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let answer = String::from_utf8_lossy(&answer).into_owned();
        (answer.split_whitespace().nth(1).unwrap().parse().unwrap(), answer)
    }

    fn cookie(&self) -> String {
        format!("radcam-{}={}", self.host.rsplit_once(':').unwrap().1, self.token)
    }
}

/// A camera whose blocks of two by two pixels share noise, which is in no catalogue.
fn blocks(root: &Path) {
    use crate::outside::{SIZE, campaign, normal};
    campaign(root, &|f, _, image| {
        for ((y, x), v) in image.indexed_iter_mut() {
            *v += normal((3 << 48) + (f << 20) + (y / 2 * SIZE + x / 2) as u64);
        }
    });
}

/// Law for what has no name: added to the model by one button, it takes the error to 1.
#[test]
fn a_law_is_added_by_a_button() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    blocks(&root);
    let w = Running::start(&[root.to_str().unwrap()]);
    let (cookie, home) = (w.cookie(), format!("http://{}", w.host));
    let me = [
        ("Cookie", &*cookie),
        ("Origin", &*home),
        ("Content-Type", "application/x-www-form-urlencoded"),
        ("HX-Request", "true"),
    ];
    let found = (0..600).any(|_| {
        std::thread::sleep(std::time::Duration::from_millis(100));
        w.ask("GET", "/", &me[..1]).1.contains("id=\"add-law\"")
    });
    assert!(found, "{}", w.ask("GET", "/", &me[..1]).1);
    let (status, text) = w.ask_with("POST", "/model/add", &me, "effect=law");
    assert!(status == 200 && text.contains("+ law"), "{status} {text}");
    let steps = std::fs::read_to_string(root.join("workbench/steps.toml")).unwrap();
    let errors: Vec<f64> =
        steps.lines().filter_map(|line| line.strip_prefix("error = ")?.parse().ok()).collect();
    assert!(errors[0] > 1.5 && errors.last().is_some_and(|e| *e < 1.1), "{steps}");
}

/// Without the token, from another page, under another name or by a path that leaves the dataset it refuses;
/// with what the browser was given it answers.
#[test]
fn it_answers_to_nobody_else() {
    let dir = tempfile::tempdir().unwrap();
    let Some(dataset) = copy("clean", dir.path()) else { return };
    let w = Running::start(&[dataset.to_str().unwrap()]);
    assert!(w.host.starts_with("127.0.0.1:"), "{}", w.host);
    assert!(w.token.len() == 32 && w.token.bytes().all(|b| b.is_ascii_hexdigit()));
    let cookie = w.cookie();
    let me = ("Cookie", &*cookie);
    let home = format!("http://{}", w.host);
    // The address that was printed gives the cookie, and leaves the address.
    let (status, text) = w.ask("GET", &format!("/?token={}", w.token), &[]);
    assert_eq!(status, 303);
    assert!(text.contains("HttpOnly; SameSite=Strict") && text.contains("location: /\r\n"), "{text}");
    let (status, text) = w.ask("GET", "/", &[me]);
    assert!(
        status == 200 && text.contains("default-src 'none'") && text.contains("frame-ancestors 'none'"),
        "{text}"
    );
    assert_eq!(w.ask("POST", "/model/undo", &[me, ("Origin", &home)]).0, 200);
    let wrong = format!("{}0", &cookie[..cookie.len() - 1]);
    let wrong = if wrong == cookie { format!("{}1", &cookie[..cookie.len() - 1]) } else { wrong };
    let name = format!("radcam.example:{}", w.host.rsplit_once(':').unwrap().1);
    let rebound = format!("http://{name}");
    for (why, method, path, headers, expected) in [
        ("no token", "GET", "/", vec![], 403),
        ("wrong token", "GET", "/?token=00000000000000000000000000000000", vec![], 403),
        ("wrong cookie", "GET", "/", vec![("Cookie", &*wrong)], 403),
        ("no token for pixels", "GET", "/pixels?set=0", vec![], 403),
        ("another origin", "POST", "/model/undo", vec![me, ("Origin", "http://evil.example")], 403),
        ("a page without origin", "POST", "/model/undo", vec![me, ("Origin", "null")], 403),
        (
            "another site's picture",
            "GET",
            "/thumbnail?set=0",
            vec![me, ("Sec-Fetch-Site", "cross-site")],
            403,
        ),
        ("another name", "GET", "/", vec![me, ("Host", &*name)], 421),
        (
            "another name, as its own origin",
            "POST",
            "/model/undo",
            vec![me, ("Host", &*name), ("Origin", &*rebound)],
            421,
        ),
        ("a path", "GET", "/../../etc/passwd", vec![me], 404),
        ("a path in disguise", "GET", "/%2e%2e/%2e%2e/etc/passwd", vec![me], 404),
        ("a path for a set", "GET", "/pixels?set=..%2F..%2Fetc%2Fpasswd", vec![me], 400),
        ("a set that is not there", "GET", "/pixels?set=9999", vec![me], 404),
        ("a frame that is not there", "GET", "/pixels?set=0&index=9999", vec![me], 404),
        ("no number", "GET", "/events?seen=x", vec![me], 400),
    ] {
        let (status, text) = w.ask(method, path, &headers);
        assert_eq!(status, expected, "{why}: {text}");
        assert!(!text.contains("root:") && !text.contains("panicked"), "{why}: {text}");
    }
}

/// Another interface needs a flag, and a warning is printed; it answers under that interface's address. All
/// interfaces at once have no address.
#[test]
fn another_interface_is_warned_of() {
    let dir = tempfile::tempdir().unwrap();
    let Some(dataset) = copy("clean", dir.path()) else { return };
    let path = dataset.to_str().unwrap();
    assert!(crate::support::refused(&["workbench", path, "--listen", "0.0.0.0"]).contains("one interface"));
    // The address of this machine towards others; nothing is sent.
    let socket = std::net::UdpSocket::bind("0.0.0.0:0").unwrap();
    let outward = socket.connect("192.0.2.1:9").and_then(|()| socket.local_addr());
    let Some(own) = outward.ok().map(|a| a.ip()).filter(|ip| !ip.is_loopback()) else {
        println!("SKIPPED: this machine has no interface but its own");
        return;
    };
    let mut child = program()
        .args(["workbench", path, "--listen", &own.to_string()])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let (host, token) = line.trim().trim_start_matches("http://").split_once("/?token=").unwrap();
    let mut stream = TcpStream::connect(host).unwrap();
    write!(stream, "GET /?token={token} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    child.kill().unwrap();
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    child.wait().unwrap();
    assert!(host.starts_with(&own.to_string()) && answer.starts_with("HTTP/1.1 303"), "{line} {answer}");
    assert!(said.contains("nothing is encrypted"), "{said}");
}

/// The browser's script; says so where there is no browser.
fn browser(arguments: &[&str]) -> Option<serde_json::Value> {
    let Some(venv) = std::env::var_os("RADCAM_TEST_BROWSER") else {
        println!("SKIPPED: RADCAM_TEST_BROWSER names no environment with Selenium (.ci/test makes one)");
        return None;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/outside/workbench.py");
    let output =
        Command::new(Path::new(&venv).join("bin/python")).arg(script).args(arguments).output().unwrap();
    let err = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {err}");
    let seen: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(seen["foreign"], serde_json::json!([]), "requests that left this machine");
    assert_eq!(seen["console"], serde_json::json!([]), "errors on the console");
    assert_eq!(seen["wide"], serde_json::json!([]), "wider than the window");
    for violation in seen["violations"].as_array().unwrap() {
        assert!(!["serious", "critical"].contains(&violation[2].as_str().unwrap_or("")), "axe: {violation}");
    }
    Some(seen)
}

fn radcam_path() -> String {
    program().get_program().to_string_lossy().into_owned()
}

/// Open, see the misfit, read the evidence, add, watch the error fall, switch, undo, try a formula, reload,
/// second tab, restart; and the error on the page is the one that `radcam compare` prints of the model that
/// was kept, to the last digit.
#[test]
fn the_whole_story_in_a_browser() {
    let dir = tempfile::tempdir().unwrap();
    let Some(dataset) = copy("interpixel-crosstalk", dir.path()) else { return };
    let path = dataset.to_str().unwrap();
    let Some(seen) = browser(&["story", &radcam_path(), path]) else { return };
    let number = |name: &str| seen[name].as_f64().unwrap_or_else(|| panic!("{name} of {seen}"));
    assert!(!seen["address"].as_str().unwrap().contains("token"), "the token stays in no history");
    assert_eq!(seen["heading"], "The camera shows interpixel-crosstalk");
    let sentence = seen["sentence"].as_str().unwrap();
    assert!(
        sentence.contains("of 1.17") && sentence.contains("% too low") && sentence.contains("remedy: "),
        "{sentence}"
    );
    let error = |arguments: &[&str], code| -> f64 {
        let said: serde_json::Value = serde_json::from_str(&expect(code, arguments)).unwrap();
        said["error"].as_f64().unwrap()
    };
    assert_eq!(number("error_before"), error(&["compare", path, "--json"], 1));
    let model = dataset.join("workbench/model.toml");
    assert_eq!(
        number("error_after"),
        error(&["compare", path, "--model", model.to_str().unwrap(), "--json"], 0)
    );
    for same in ["error_reloaded", "error_second_tab", "error_restarted"] {
        assert_eq!(number(same), number("error_after"), "{same}");
    }
    assert_eq!(number("error_switched_off"), number("error_before"));
    assert_eq!(number("rungs"), 2.0);
    let cell = seen["cell"].as_str().unwrap();
    assert!(
        cell.contains("covariance") && cell.contains("first half") && cell.contains("measured"),
        "{cell}"
    );
    assert!(seen["refused"].as_str().unwrap().contains("nonsense"), "{}", seen["refused"]);
    assert!(seen["tried"].as_str().unwrap().contains("without it"), "{}", seen["tried"]);
}

/// A law is said for what has no name; its button adds it, and the error falls to the noise.
#[test]
fn a_law_is_added_in_a_browser() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    blocks(&root);
    let Some(seen) = browser(&["law", &radcam_path(), root.to_str().unwrap()]) else { return };
    assert_eq!(seen["heading"], "The camera shows an effect without a name");
    let sentence = seen["sentence"].as_str().unwrap();
    assert!(sentence.contains("blocks of two by two pixels"), "{sentence}");
    let error = |name: &str| seen[name].as_f64().unwrap();
    assert!(error("error_before") > 1.5 && error("error_after") < 1.1, "{seen}");
    assert_eq!(seen["rungs"], 2);
}

/// A dataset that cannot be read says why, with file and line.
#[test]
fn a_bad_dataset_shows_its_error() {
    let dir = tempfile::tempdir().unwrap();
    let Some(dataset) = copy("clean", dir.path()) else { return };
    let rows = std::fs::read_to_string(dataset.join("frames.csv")).unwrap();
    std::fs::write(dataset.join("frames.csv"), rows.replacen(",dark,", ",dusk,", 1)).unwrap();
    let Some(seen) = browser(&["broken", &radcam_path(), dataset.to_str().unwrap()]) else { return };
    let said = seen["said"].as_str().unwrap();
    assert!(said.contains("frames.csv") && said.contains("dusk"), "{said}");
}

/// Reports fetch nothing, fit a phone and have no violation: of a diagnosis, of a table, of the datasheet.
#[test]
fn reports_are_sound_pages() {
    let Some(practice) = shared("practice") else { return };
    let dir = tempfile::tempdir().unwrap();
    let page = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let at = |name: &str| practice.join(name).to_str().unwrap().to_string();
    expect(1, &["report", &at("row-noise"), "-o", &page("effect.html")]);
    expect(0, &["report", &at("clean"), "-o", &page("clean.html")]);
    expect(1, &["report", &at("table-two-lamps.csv"), "-o", &page("table.html")]);
    expect(0, &["noise", &at("clean"), "--report", &page("noise.html")]);
    browser(&["pages", &page("effect.html"), &page("clean.html"), &page("table.html"), &page("noise.html")]);
}

/// A served camera: live picture, settings, a capture that is cancelled and goes on, and its verdict.
#[cfg(feature = "aravis")]
#[test]
fn serve_a_camera_to_the_workbench() {
    if std::env::var_os("RADCAM_TEST_BROWSER").is_none() {
        println!("SKIPPED: RADCAM_TEST_BROWSER names no environment with Selenium (.ci/test makes one)");
        return;
    }
    let _port = crate::support::gige_port();
    let dir = tempfile::tempdir().unwrap();
    let sensor = crate::support::small_sensor(dir.path(), "cmos12", 256, 192);
    let mut served = program()
        .args(["serve", sensor.to_str().unwrap(), "--interface", "127.0.0.1", "--serial", "BROWSE"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(served.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let folder = dir.path().join("captured");
    let seen = browser(&["camera", &radcam_path(), "aravis:127.0.0.1", folder.to_str().unwrap()]);
    served.kill().unwrap();
    served.wait().unwrap();
    let seen = seen.unwrap();
    assert_eq!(seen["empty"], "Nothing is captured yet");
    assert!(seen["set"].as_str().unwrap().contains("exposure 0.002 s"), "{}", seen["set"]);
    assert!(seen["refused"].as_str().unwrap().contains("much"), "{}", seen["refused"]);
    assert!(seen["cancelled"].as_str().unwrap().contains("cancelled"), "{}", seen["cancelled"]);
    assert_eq!(seen["heading"], "The model describes the camera");
    // Whatever was cancelled, the campaign is whole.
    assert_eq!(std::fs::read_to_string(folder.join("frames.csv")).unwrap().lines().count(), 241);
}

impl Running {
    /// What a page says to the browser that was given the token.
    fn page(&self, path: &str) -> String {
        let (status, text) = self.ask("GET", path, &[("Cookie", &self.cookie())]);
        assert_eq!(status, 200, "{path}: {text}");
        text
    }

    /// Sends a form.
    fn send(&self, path: &str, form: &str) -> String {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        let head = format!(
            "POST {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nCookie: {cookie}\r\nContent-Type: \
             application/x-www-form-urlencoded\r\nContent-Length: {length}\r\n\r\n",
            host = self.host,
            cookie = self.cookie(),
            length = form.len()
        );
        stream.write_all((head + form).as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }

    /// Waits until no work runs and the page says this.
    fn wait(&self, path: &str, says: &str) -> String {
        for _ in 0..1200 {
            if !self.page("/status").contains("class=\"job\"") {
                let page = self.page(path);
                if page.contains(says) {
                    return page;
                }
            }
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
        panic!("{path} never says {says}: {}", self.page(path))
    }
}

/// A camera whose first campaign leaves two names open: the measurement that decides is taken from the page,
/// added to the campaign, and the verdict is one name. Then report, model file and a calibration that cannot
/// be had.
#[test]
fn a_tie_is_broken_from_the_page() {
    let dir = tempfile::tempdir().unwrap();
    let model = dir.path().join("camera.toml");
    std::fs::write(&model, crate::investigate::with("smear").to_toml().unwrap()).unwrap();
    let folder = dir.path().join("captured");
    let camera = format!("sim:{}", model.display());
    let w = Running::start(&[folder.to_str().unwrap(), "--camera", &camera]);
    assert!(w.page("/").contains("Nothing is captured yet"));
    assert!(w.send("/camera/capture", "plan=other&frames=&region=&own=").contains("there is no plan"));
    assert!(w.send("/camera/capture", "plan=quick&own=sets+%3D+3").contains("the plan: "));
    w.send("/camera/capture", "plan=quick&frames=&region=&own=");
    let page = w.wait("/", "The measurement that decides");
    assert!(page.contains("tied with") && page.contains("Take it"), "{page}");
    let plan = w.page("/save/next.toml");
    let plan = radcam::plan::Plan::from_toml(plan.split_once("\r\n\r\n").unwrap().1).unwrap();
    let before = std::fs::read_to_string(folder.join("frames.csv")).unwrap().lines().count() as u64;
    w.send("/camera/next", "");
    let page = w.wait("/", "The camera shows smear");
    assert!(!page.contains("tied with"), "{page}");
    let after = std::fs::read_to_string(folder.join("frames.csv")).unwrap().lines().count() as u64;
    assert_eq!(after - before, plan.frames());
    // What is saved.
    w.send("/model/add", "effect=smear");
    let page = w.wait("/", "The model describes the camera");
    let error = between(&page, "id=\"error\"", "</data>");
    let error: f64 = between(error, "value=\"", "\"").parse().unwrap();
    let report = w.page("/save/report.html");
    let numbers = between(&report, "id=\"radcam-report\">", "</script>");
    let numbers: serde_json::Value = serde_json::from_str(numbers).unwrap();
    assert_eq!(numbers["error_before"].as_f64(), Some(error));
    let kept = folder.join("workbench/model.toml");
    let said = expect(0, &["compare", folder.to_str().unwrap(), "--model", kept.to_str().unwrap(), "--json"]);
    assert_eq!(serde_json::from_str::<serde_json::Value>(&said).unwrap()["error"].as_f64(), Some(error));
    w.send("/save/calibration", "");
    let status = w.wait("/status", "role=\"alert\"");
    assert!(status.contains("configurations"), "{status}");
    // Flats of one place are enough for a flat-field correction.
    w.send("/save/calibration", "flat_field=true");
    let page = w.wait("/save", "flat-field.tiff</code> is written");
    assert!(page.contains("--flat-field"), "{page}");
    let made = radcam::calibrate::file::Calibration::read(&folder.join("workbench/flat-field.tiff")).unwrap();
    assert!(made.description.is_flat_field());
}

/// What stands between two texts.
fn between<'t>(page: &'t str, from: &str, to: &str) -> &'t str {
    let rest = page.split_once(from).unwrap_or_else(|| panic!("no {from} in {page}")).1;
    rest.split_once(to).unwrap().0
}

/// Campaigns side by side; one that cannot be read says why in its row.
#[test]
fn campaigns_stand_side_by_side() {
    let dir = tempfile::tempdir().unwrap();
    let (Some(clean), Some(noisy)) = (copy("clean", dir.path()), copy("row-noise", dir.path())) else {
        return;
    };
    let missing = dir.path().join("nowhere");
    let w = Running::start(&[&clean, &noisy, &missing].map(|p| p.to_str().unwrap()));
    w.wait("/", "The model describes the camera");
    w.send("/runs/read", "");
    let page = w.wait("/runs", "nowhere: there is no such file or folder");
    assert!(page.contains("row-noise") && page.contains("(this one)"), "{page}");
}

/// The history of a monitor: what changed, the newest first, and a figure of each reading; a history that is
/// not there is refused and not made.
#[test]
fn a_history_of_checks_is_shown() {
    use radcam::monitor::store::Store;
    use radcam::monitor::{Check, Followed, Limits, Monitor, Reading};
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("history.db");
    let name = file.to_str().unwrap();
    let refused = crate::support::refused(&["workbench", "--history", name]);
    assert!(refused.contains("there is no such history") && !file.exists(), "{refused}");
    {
        let store = Store::open(name).unwrap();
        let mut monitor = Monitor::new(Limits::default());
        let mut alarms = 0;
        for number in 0..60u32 {
            // The black level steps by 2 DN, of which one check knows 0.05.
            let wobble = f64::from(number * 37 % 11) / 11.0 - 0.5;
            let value = 64.0 + 0.1 * wobble + if number < 50 { 0.0 } else { 2.0 };
            let readings = [(Followed::BlackLevel, Reading { value, std_err: 0.05 })].into();
            let check = Check { time_s: 1.7e9 + 60.0 * f64::from(number), readings, ..Check::default() };
            let found = monitor.add(check.clone());
            alarms += found.len();
            store.keep("LINE <1>", "c", &check, &found).unwrap();
        }
        assert_eq!(alarms, 1);
    }
    let w = Running::start(&["--history", name]);
    let page = w.page("/history");
    assert!(page.contains("LINE &lt;1&gt;") && page.contains("60 checks"), "{page}");
    assert!(page.contains("Black level") && page.contains("something changed"), "{page}");
    let mut arguments = vec!["history".to_string(), radcam_path(), name.into()];
    // A folder for screenshots.
    arguments.extend(std::env::var("RADCAM_TEST_PICTURES"));
    browser(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
}

/// 100,000 checks (70 days, one a minute): a page of some hundred kilobytes, whose curves keep least and
/// largest values.
#[test]
fn a_long_history_is_thinned() {
    use radcam::monitor::store::Store;
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("history.db");
    let name = file.to_str().unwrap();
    drop(Store::open(name).unwrap());
    // One check stands out; one in five hundred brings an alarm.
    let script = r#"
import json, sqlite3, sys
db = sqlite3.connect(sys.argv[1])
n = 100000
times = [1700000000000000000 + 60000000000 * i for i in range(n)]
value = lambda i: 99.0 if i == 54321 else 64.0 + 0.1 * (i * 37 % 11)
names = ["black_level", "gain", "signal", "dark_noise"]
body = json.dumps({"time_s": 0, "about": "x" * 500})
db.executemany("INSERT INTO checks VALUES ('LINE 1', 'c', ?, ?)", ((t, body) for t in times))
db.executemany("INSERT INTO readings VALUES ('LINE 1', ?, ?, ?, 0.05)", ((t, k, value(i)) for i, t in enumerate(times) for k in names))
db.executemany("INSERT INTO alarms VALUES ('LINE 1', ?, ?, 'gain', ?)", ((t, t, f"alarm {i}") for i, t in enumerate(times) if i % 500 == 0))
db.commit()
"#;
    let made = Command::new("python3").args(["-c", script, name]).status().unwrap();
    assert!(made.success());
    let w = Running::start(&["--history", name]);
    let begun = std::time::Instant::now();
    let page = w.page("/history");
    println!("{} bytes in {:?}", page.len(), begun.elapsed());
    assert!(page.len() < 2_000_000, "{} bytes", page.len());
    assert!(begun.elapsed().as_secs() < 10, "{:?}", begun.elapsed());
    assert!(
        page.contains("100000 checks") && page.contains("99.0") | page.contains(",99,"),
        "the one that stands out"
    );
    // Alarms come a hundred at a time, the newest first.
    let rows = |page: &str| page.matches("alarm ").count();
    assert!(
        rows(&page) == 100 && page.contains("alarm 99500") && page.contains("200 changes"),
        "{}",
        rows(&page)
    );
    let older = w.page("/history?camera=LINE%201&alarms=1");
    assert!(rows(&older) == 100 && older.contains("alarm 0<") && !older.contains("alarm 99500"));
    // A day is one check a minute, each of them there.
    let day = w.page("/history?days=1");
    assert!(day.contains("1441 checks") && day.len() < 2_000_000, "{}", day.len());
    for wrong in ["days=nan", "days=-1", "alarms=18446744073709551615", "camera=none"] {
        assert!(w.page(&format!("/history?{wrong}")).contains("History of checks"), "{wrong}");
    }
}

/// C11: a folder or a file of the workbench that is a link to another place is refused, and that place stays
/// as it is.
#[test]
#[cfg(unix)]
fn the_workbench_follows_no_link_out_of_its_dataset() {
    let dir = tempfile::tempdir().unwrap();
    let other = dir.path().join("other");
    std::fs::create_dir(&other).unwrap();
    let model = other.join("model.toml");
    std::fs::write(&model, "mine").unwrap();
    for inside in [false, true] {
        let place = dir.path().join(format!("{inside}"));
        std::fs::create_dir(&place).unwrap();
        let Some(dataset) = copy("clean", &place) else { return };
        let folder = dataset.join("workbench");
        if inside {
            std::fs::create_dir(&folder).unwrap();
            std::os::unix::fs::symlink(&model, folder.join("model.toml")).unwrap();
        } else {
            std::os::unix::fs::symlink(&other, &folder).unwrap();
        }
        let w = Running::start(&[dataset.to_str().unwrap()]);
        let page = w.wait("/", "is a link");
        assert!(page.contains("workbench"), "{page}");
        w.ask("GET", "/save/report.html", &[("Cookie", &w.cookie())]);
        assert_eq!(std::fs::read_to_string(&model).unwrap(), "mine");
        assert_eq!(other.read_dir().unwrap().count(), 1);
    }
}

/// C13: the address with the token leads to a page of this server, whatever its path; one that a file or
/// another program opened too.
#[test]
fn the_token_leads_nowhere_else() {
    let dir = tempfile::tempdir().unwrap();
    let Some(dataset) = copy("clean", dir.path()) else { return };
    let w = Running::start(&[dataset.to_str().unwrap()]);
    for path in [
        "//other.example/x",
        "///other.example",
        "/\\other.example",
        "//other.example",
        "/%5cother.example",
        "/;//other.example",
    ] {
        let (status, text) = w.ask("GET", &format!("{path}?token={}", w.token), &[]);
        let to = text.lines().find_map(|l| l.strip_prefix("location: ")).unwrap_or("/");
        assert!(
            matches!(status, 303 | 400) && to.starts_with('/') && !to.starts_with("//") && !to.contains('\\'),
            "{path}: {text}"
        );
    }
    let (status, text) =
        w.ask("GET", &format!("/data?token={}", w.token), &[("Sec-Fetch-Site", "cross-site")]);
    assert!(status == 200 && text.contains("0;url=/data\"") && text.contains("SameSite=Strict"), "{text}");
    assert!(!text.split_once("\r\n\r\n").unwrap().1.contains(&w.token), "{text}");
    for (method, token) in [("POST", &*w.token), ("GET", "00000000000000000000000000000000")] {
        let (status, _) = w.ask(method, &format!("/?token={token}"), &[("Sec-Fetch-Site", "cross-site")]);
        assert_eq!(status, 403, "{method}");
    }
}

/// What was kept and cannot be understood is named, and nothing is written over it.
#[test]
fn steps_that_are_spoilt_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let Some(dataset) = copy("clean", dir.path()) else { return };
    let steps = dataset.join("workbench/steps.toml");
    std::fs::create_dir(dataset.join("workbench")).unwrap();
    std::fs::write(&steps, "format = \"radcam-workbench/7\"").unwrap();
    let w = Running::start(&[dataset.to_str().unwrap()]);
    let page = w.wait("/", "cannot be read");
    assert!(page.contains("steps.toml") && page.contains("radcam-workbench/7"), "{page}");
    assert_eq!(std::fs::read_to_string(&steps).unwrap(), "format = \"radcam-workbench/7\"");
}
