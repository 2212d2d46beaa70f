//! A calibrated camera that changes: each change is found when theory says and named as what it is, and
//! nothing is found where nothing changed.

use crate::support::{calibration, expect, radcam, small};
use radcam::calibrate::dark::{DarkMean, DarkReference};
use radcam::calibrate::file::Calibration;
use radcam::monitor::store::Store;
use radcam::monitor::{Alarm, Changed, Check, Followed, Limits, Monitor, Stack, Taken};
use radcam::statistics::moments::Moments;
use radcam_sim::{Conditions, Model, Sensor};
use std::path::Path;
use std::process::{Command, Stdio};

const EXPOSURE_S: f64 = 0.02;
const LONG_S: f64 = 0.2;
const FRAMES: u64 = 8;

/// A camera whose light is even, so that its K is the mean flat.
fn model(width: u32, height: u32) -> Model {
    let mut model = small("cmos12", width, height);
    (model.bench.shading, model.bench.gradient) = (0.0, 0.0);
    model
}

/// The camera as it is at a check.
#[derive(Clone)]
struct Camera {
    sensor: std::sync::Arc<Sensor>,
    illumination: f64,
    black_level_dn: f64,
    /// Pixels that have become hot.
    hot: Vec<usize>,
    hot_dn_per_s: f64,
    number: u64,
}

impl Camera {
    fn new(model: Model) -> Self {
        let black_level_dn = model.base.black_level_dn;
        let sensor = Sensor::new(model).unwrap().into();
        Self { sensor, illumination: 0.8, black_level_dn, hot: Vec::new(), hot_dn_per_s: 300.0, number: 0 }
    }

    fn frame(&mut self, exposure_s: f64, lit: bool) -> Vec<u16> {
        let region = self.sensor.region();
        let mut dn = vec![0; region.width as usize * region.height as usize];
        let illumination = if lit { self.illumination } else { 0.0 };
        let black_level_dn = self.black_level_dn;
        let conditions = Conditions { illumination, black_level_dn, ..self.sensor.conditions(exposure_s) };
        self.sensor.draw(self.number, &conditions, region, &mut dn);
        self.number += 1;
        for &at in &self.hot {
            dn[at] += (self.hot_dn_per_s * exposure_s) as u16;
        }
        dn
    }

    fn calibration(&mut self) -> Calibration {
        self.calibrated([EXPOSURE_S, LONG_S], 200)
    }

    /// With so many darks at each of two exposures, and 200 flats.
    fn calibrated(&mut self, darks_s: [f64; 2], frames: u64) -> Calibration {
        let region = self.sensor.region();
        let shape = (region.height as usize, region.width as usize);
        let mut moments = |exposure_s, lit, frames| {
            let mut moments = Moments::new(shape, 12);
            for _ in 0..frames {
                moments.add(&[&self.frame(exposure_s, lit)]).unwrap();
            }
            moments
        };
        let darks = darks_s.map(|exposure_s| {
            let m = moments(exposure_s, false, frames);
            DarkMean { exposure_s, frames, mean_dn: m.mean_dn(), var_dn2: m.variance_dn2() }
        });
        let dark = DarkReference::fit(&darks, EXPOSURE_S).unwrap();
        let light = moments(EXPOSURE_S, true, 200).mean_dn() - dark.level_dn.mapv(f64::from);
        let level = light.mean().unwrap();
        let at = |i: usize| (i / shape.1, i % shape.1);
        let mut made =
            calibration("cmos12", "SIM12", shape, |i| (dark.level_dn[at(i)], (light[at(i)] / level) as f32));
        made.description.dark_exposure_s = EXPOSURE_S;
        made.description.dark_std_err_dn = Some(dark.std_err_dn);
        made.description.dark_current_std_err_dn_per_s = Some(dark.current_std_err_dn_per_s);
        made.dark = dark;
        made
    }

    fn check(&mut self, calibration: &Calibration) -> Check {
        let stack = || Stack::new(calibration.k.dim(), 12);
        let (mut short, mut long, mut flat) = (stack(), stack(), stack());
        for _ in 0..FRAMES {
            short.add(&self.frame(EXPOSURE_S, false)).unwrap();
            long.add(&self.frame(LONG_S, false)).unwrap();
            flat.add(&self.frame(EXPOSURE_S, true)).unwrap();
        }
        let time_s = 60.0 * self.number as f64;
        let taken = Taken {
            time_s,
            exposure_s: EXPOSURE_S,
            long_s: LONG_S,
            temperature_c: None,
            short,
            long,
            flat,
            lost: 0,
        };
        taken.check(calibration)
    }
}

/// A monitor that has learned what is usual.
fn learned(camera: &mut Camera, calibration: &Calibration) -> Monitor {
    let mut monitor = Monitor::new(Limits::default());
    while monitor.history().len() < 40 || !monitor.learning().is_empty() {
        let alarms = monitor.add(camera.check(calibration));
        assert!(alarms.is_empty(), "{alarms:?}");
        assert!(monitor.history().len() < 400, "{:?}", monitor.learning());
    }
    monitor
}

/// Checks until something is found.
fn found(monitor: &mut Monitor, camera: &mut Camera, calibration: &Calibration) -> (usize, Vec<Alarm>) {
    for n in 1..=60 {
        let alarms = monitor.add(camera.check(calibration));
        if !alarms.is_empty() {
            return (n, alarms);
        }
    }
    panic!("nothing was found in 60 checks");
}

/// A percent of gain, half a DN of black level, two percent of lamp, ten hot pixels: each is named as what it
/// is, after no more than twice the mean number of checks that theory gives and two (a sum's delay has an
/// exponential tail: of 10 trials none is later).
#[test]
fn changes_are_found_in_time_and_named() {
    let start = model(160, 120);
    let mut camera = Camera::new(start.clone());
    let calibration = camera.calibration();
    let monitor = learned(&mut camera, &calibration);
    let needed = monitor.checks_needed();
    let allowed = |what| 2.0 * needed[&what] + 2.0;
    // 19 200 pixels of 8 frames know the gain to 0.4 %.
    assert!((2.0..20.0).contains(&needed[&Followed::Gain]), "{needed:?}");
    // One check is enough to tell, and one is the bound of the theory.
    assert!(needed[&Followed::BlackLevel] < 2.1 && needed[&Followed::Signal] < 2.1, "{needed:?}");
    for trial in 0..10u64 {
        let begin = |change: &dyn Fn(&mut Camera)| {
            let mut changed = camera.clone();
            changed.number += 1_000_000 * (trial + 1);
            change(&mut changed);
            (monitor.clone(), changed)
        };
        let mut brighter = start.clone();
        brighter.base.gain_dn_per_e *= 1.01;
        let sensor: std::sync::Arc<Sensor> = Sensor::new(brighter).unwrap().into();
        let (mut m, mut c) = begin(&|c| c.sensor = sensor.clone());
        let (checks, alarms) = found(&mut m, &mut c, &calibration);
        // It may first be known that something is brighter, and then what.
        let (checks, alarm) = match &alarms[..] {
            [a] if a.what == Changed::LightOrGain => {
                let (more, alarms) = found(&mut m, &mut c, &calibration);
                (checks + more, alarms[0].clone())
            }
            [a] => (checks, a.clone()),
            other => panic!("{other:?}"),
        };
        assert_eq!(alarm.what, Changed::Gain, "{alarm:?}");
        assert!((alarm.change.value - 0.01).abs() < 5.0 * alarm.change.std_err, "{alarm:?}");
        assert!((checks as f64) < allowed(Followed::Gain), "gain after {checks}: {needed:?}");

        let (mut m, mut c) = begin(&|c| c.black_level_dn += 0.5);
        let (checks, alarms) = found(&mut m, &mut c, &calibration);
        assert_eq!(alarms.iter().map(|a| a.what).collect::<Vec<_>>(), [Changed::BlackLevel], "{alarms:?}");
        assert!((checks as f64) < allowed(Followed::BlackLevel), "black level after {checks}");
        assert!((alarms[0].change.value - 0.5).abs() < 5.0 * alarms[0].change.std_err, "{alarms:?}");

        let (mut m, mut c) = begin(&|c| c.illumination *= 1.02);
        let (checks, alarms) = found(&mut m, &mut c, &calibration);
        let (checks, alarm) = match &alarms[..] {
            [a] if a.what == Changed::LightOrGain => {
                assert!((checks as f64) < allowed(Followed::Signal));
                let (more, alarms) = found(&mut m, &mut c, &calibration);
                (checks + more, alarms[0].clone())
            }
            [a] => (checks, a.clone()),
            other => panic!("{other:?}"),
        };
        assert_eq!(alarm.what, Changed::Light, "{alarm:?}");
        assert!((alarm.change.value - 0.02).abs() < 5.0 * alarm.change.std_err, "{alarm:?}");
        assert!(
            (checks as f64) < allowed(Followed::Signal) + allowed(Followed::Gain),
            "light after {checks}"
        );

        let (mut m, mut c) = begin(&|c| c.hot = (0..10).map(|i| 777 + 1801 * i).collect());
        let (checks, alarms) = found(&mut m, &mut c, &calibration);
        assert_eq!(
            (checks, alarms[0].what, alarms[0].change.value),
            (2, Changed::HotPixels, 10.0),
            "{alarms:?}"
        );
        assert!(alarms[0].sentence.contains("(x 18 y 16, x 22 y 61"), "{}", alarms[0].sentence);
    }
}

/// The README's darks, at 1 and 20 ms, know the dark current to 8 DN/s a pixel: of what long darks show at
/// ten times the exposure nothing is called hot that is not, and a pixel of 2000 DN/s is.
#[test]
fn darks_of_short_exposures_make_no_hot_pixels() {
    let mut camera = Camera::new(model(160, 120));
    let calibration = camera.calibrated([0.001, EXPOSURE_S], 50);
    assert!((0..10).all(|_| camera.check(&calibration).hot.is_empty()));
    camera.hot = vec![7777];
    camera.hot_dn_per_s = 2000.0;
    assert_eq!(camera.check(&calibration).hot, [(7777 % 160, 7777 / 160)]);
}

/// A lamp that fails is light's, not gain's and no dead pixels, and it is told once. It comes back as it was;
/// then gain and light change at once, and both are named.
#[test]
fn a_lamp_that_fails_and_two_changes_at_once_are_named() {
    let start = model(160, 120);
    let mut camera = Camera::new(start.clone());
    let calibration = camera.calibration();
    let mut monitor = learned(&mut camera, &calibration);
    let light = camera.illumination;
    camera.illumination = 0.0;
    let (checks, alarms) = found(&mut monitor, &mut camera, &calibration);
    assert_eq!((checks, alarms.len(), alarms[0].what), (1, 1, Changed::NoLight), "{alarms:?}");
    assert!(alarms[0].sentence.contains("100 % darker"), "{alarms:?}");
    for _ in 0..40 {
        let alarms = monitor.add(camera.check(&calibration));
        assert!(alarms.is_empty(), "{alarms:?}");
    }
    camera.illumination = light;
    for _ in 0..40 {
        let alarms = monitor.add(camera.check(&calibration));
        assert!(alarms.is_empty(), "{alarms:?}");
    }
    let mut brighter = start;
    brighter.base.gain_dn_per_e *= 1.1;
    camera.sensor = Sensor::new(brighter).unwrap().into();
    camera.illumination *= 0.8;
    let mut all = Vec::new();
    for _ in 0..20 {
        all.extend(monitor.add(camera.check(&calibration)));
    }
    let of = |what| all.iter().filter(|a| a.what == what).collect::<Vec<_>>();
    let (gain, light) = (of(Changed::Gain), of(Changed::Light));
    assert!((gain.len(), light.len()) == (1, 1), "{all:?}");
    assert!((gain[0].change.value - 0.1).abs() < 5.0 * gain[0].change.std_err, "{all:?}");
    assert!((light[0].change.value + 0.2).abs() < 5.0 * light[0].change.std_err, "{all:?}");
}

/// A check without light between two flickers, and a store that takes what is found: nothing is told twice in
/// a check.
#[test]
fn alarms_of_a_check_are_different_ones() {
    use radcam::monitor::Reading;
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(dir.path().join("history.db").to_str().unwrap()).unwrap();
    let mut monitor = Monitor::new(Limits::default());
    let mut whats = std::collections::BTreeSet::new();
    for n in 0..500u64 {
        let z = ((n * 7919) % 101) as f64 / 50.0 - 1.0;
        let late = n >= 200;
        let mut readings = std::collections::BTreeMap::new();
        let mut put = |what, value, std_err| readings.insert(what, Reading { value, std_err });
        put(Followed::Signal, 1000.0 * (1.0 + 0.002 * z) * if late { 1.03 } else { 1.0 }, 2.0);
        if n % 9 != 0 {
            // The gain is read too badly to tell at once.
            put(Followed::Gain, 0.4 * (1.0 + 0.04 * z) * if late { 1.03 } else { 1.0 }, 0.016);
            put(Followed::Flicker, 1e-6 * (1.0 + z) * if n >= 300 { 20.0 } else { 1.0 }, 0.0);
        }
        put(Followed::LostFrames, if late { 1.0 } else { 0.0 }, 0.0);
        let check = Check { time_s: n as f64, frames: 24, flats: 8, readings, ..Check::default() };
        let alarms = monitor.add(check.clone());
        store.keep("SIM12", "abc", &check, &alarms).unwrap();
        assert!(alarms.iter().all(|a| a.change.value.is_finite() && a.change.value > -0.5), "{alarms:?}");
        whats.extend(alarms.iter().map(|a| a.what));
    }
    for what in [Changed::LightOrGain, Changed::Gain, Changed::Flicker, Changed::LostFrames] {
        assert!(whats.contains(&what), "{whats:?}");
    }
}

/// A flat of 1000 DN known to 2 DN and a gain known to 4 %, or no light; what a monitor says of each check,
/// by number.
fn told(lights: &[f64]) -> (Vec<(usize, Changed)>, Monitor) {
    use radcam::monitor::Reading;
    use radcam_sim::rng::{PixelRng, Stream as Numbers};
    let mut monitor = Monitor::new(Limits::default());
    let mut all = Vec::new();
    for (n, light) in lights.iter().enumerate() {
        let z = |i: u32| PixelRng::new(6, Numbers::Frame, n as u64, i, 0).normal();
        let mut readings = std::collections::BTreeMap::new();
        let mut put = |what, value, std_err| readings.insert(what, Reading { value, std_err });
        put(Followed::Signal, 1000.0 * light + 2.0 * z(0), 2.0);
        if *light > 0.1 {
            put(Followed::Gain, 0.4 + 0.016 * z(1), 0.016);
        }
        let check = Check { time_s: n as f64, frames: 24, flats: 8, readings, ..Check::default() };
        all.extend(monitor.add(check).into_iter().map(|a| (n, a.what)));
    }
    (all, monitor)
}

/// A monitor that begins without light is not blind to it afterwards; a lamp that was dim for a while and is
/// as it was is told once; one that is out in between does not hide a later change; and what is read for the
/// first time is still being learned.
#[test]
fn what_the_light_did_before_hides_nothing() {
    let lights = |parts: &[(usize, f64)]| -> Vec<f64> {
        parts.iter().flat_map(|(n, light)| std::iter::repeat_n(*light, *n)).collect()
    };
    let (all, _) = told(&lights(&[(10, 0.0), (60, 1.0), (3, 0.9)]));
    assert!(matches!(all[0], (70..=72, _)), "{all:?}");
    let (all, _) = told(&lights(&[(60, 1.0), (9, 0.97), (300, 1.0), (30, 0.9)]));
    assert!(matches!(all[..2], [(60..=61, Changed::LightOrGain), (369..=371, _)]), "{all:?}");
    let (all, _) = told(&lights(&[(60, 1.0), (5, 0.97), (3, 0.0), (60, 0.97), (3, 0.9)]));
    assert!(all.contains(&(65, Changed::NoLight)), "{all:?}");
    assert!(all.iter().any(|(n, _)| (128..=130).contains(n)), "{all:?}");
    let (_, monitor) = told(&[1.0; 3]);
    assert!(monitor.learning().contains(&Followed::Signal), "{:?}", monitor.learning());
}

/// Checks of a camera to which nothing happens.
fn quiet(checks: usize) -> usize {
    let mut camera = Camera::new(model(64, 48));
    let calibration = camera.calibration();
    let mut monitor = Monitor::new(Limits::default());
    let mut alarms = 0;
    for _ in 0..checks {
        for alarm in monitor.add(camera.check(&calibration)) {
            println!("{alarm:?}");
            alarms += 1;
        }
    }
    assert!(monitor.learning().is_empty(), "{:?}", monitor.learning());
    alarms
}

#[test]
fn three_thousand_quiet_checks_raise_no_alarm() {
    assert_eq!(quiet(3000), 0);
}

#[test]
#[ignore = "a minute; `cargo test --release --test it ten_thousand_quiet -- --ignored`"]
fn ten_thousand_quiet_checks_raise_at_most_one_alarm() {
    assert!(quiet(10_000) <= 1);
}

/// Readings as independent normal numbers, of monitors that learn from the first check on: 180 000 checks
/// raise no more alarms than stated, whether the change that matters is a half, one, two or six standard
/// errors of a check.
#[test]
fn what_is_learned_from_few_checks_raises_no_more_alarms() {
    learning(60);
}

#[test]
#[ignore = "minutes: three million checks"]
fn what_is_learned_from_few_checks_raises_no_more_alarms_in_the_long_run() {
    learning(1000);
}

fn learning(monitors: usize) {
    use radcam::monitor::{FALSE_ALARM_EVERY, Reading};
    use radcam_sim::rng::{PixelRng, Stream as Numbers};
    let limits = Limits::default();
    let usual = [
        (Followed::BlackLevel, 64.0, limits.black_level_dn),
        (Followed::DarkCurrent, 5.0, limits.dark_current * 5.0),
        (Followed::Gain, 0.4, limits.gain * 0.4),
        (Followed::Signal, 1000.0, limits.signal * 1000.0),
        (Followed::DarkNoise, 4.0, 0.1025 * 4.0),
        (Followed::Pattern, 1e-5, limits.pattern * limits.pattern),
    ];
    let checks = 3000;
    let mut alarms = 0;
    let mut by_shift = [0; 4];
    for series in 0..monitors {
        let mut monitor = Monitor::new(limits);
        let shift = [0.5, 1.0, 2.0, 6.0][series % 4];
        for n in 0..checks {
            let reading = |(i, (what, value, step)): (usize, &(Followed, f64, f64))| {
                let z = PixelRng::new(5, Numbers::Frame, n, (8 * series + i) as u32, 0).normal();
                let std_err = step / shift;
                (*what, Reading { value: value + std_err * z, std_err })
            };
            let readings = usual.iter().enumerate().map(reading).collect();
            let check = Check { time_s: n as f64, frames: 24, flats: 8, readings, ..Check::default() };
            let found = monitor.add(check).len();
            alarms += found;
            by_shift[series % 4] += found;
        }
    }
    let stated = (monitors as u64 * checks) as f64 / FALSE_ALARM_EVERY;
    println!("{alarms} alarms, at most {stated} stated; by shift {by_shift:?}");
    assert!(alarms as f64 <= stated + 3.0 * stated.sqrt(), "{alarms} for {stated}");
}

/// What a store keeps it gives back, and a monitor goes on where it was; the same for every database.
fn storage(url: &str) {
    let mut camera = Camera::new(model(64, 48));
    let calibration = camera.calibration();
    let checks: Vec<Check> = (0..30).map(|_| camera.check(&calibration)).collect();
    let mut monitor = Monitor::new(Limits::default());
    {
        let store = Store::open(url).unwrap();
        for (i, check) in checks.iter().enumerate() {
            let mut found = monitor.add(check.clone());
            if i == 20 {
                found.push(Alarm {
                    what: Changed::Gain,
                    time_s: check.time_s,
                    since_s: check.time_s - 60.0,
                    checks: 1,
                    change: radcam::monitor::Reading { value: 0.01, std_err: 0.001 },
                    sentence: "Gain is 1 % higher; it's \"so\" ± 0.1 %.".into(),
                });
            }
            store.keep("SIM12", "abc", check, &found).unwrap();
        }
        assert!(store.keep("SIM12", "abc", &checks[3], &[]).is_err(), "a check is kept once");
        store.keep("OTHER", "abc", &checks[3], &[]).unwrap();
    }
    // Opened again: the tables are there, and so is every check.
    let store = Store::open(url).unwrap();
    assert_eq!(store.checks("SIM12", "abc").unwrap(), checks);
    assert!(store.checks("SIM12", "another calibration").unwrap().is_empty());
    let alarms = store.alarms("SIM12").unwrap();
    assert_eq!(alarms.len(), 1);
    assert_eq!((&*alarms[0].0, &*alarms[0].2), ("gain", "Gain is 1 % higher; it's \"so\" ± 0.1 %."));
    let again = store.monitor("SIM12", "abc", Limits::default()).unwrap();
    assert_eq!((again.history(), again.learning()), (monitor.history(), monitor.learning()));
}

#[test]
fn sqlite_keeps_the_history() {
    let dir = tempfile::tempdir().unwrap();
    storage(&format!("sqlite:{}", dir.path().join("history.db").display()));
    storage(dir.path().join("plain path.db").to_str().unwrap());
    let text = Store::open(dir.path().join("no/such/folder.db").to_str().unwrap()).unwrap_err().to_string();
    assert!(text.contains("folder.db"), "{text}");
}

/// A server of Debian's PostgreSQL on a socket of its own, as an ordinary user.
struct Postgres(tempfile::TempDir, std::path::PathBuf);

impl Postgres {
    fn start() -> Option<Self> {
        let newest =
            std::fs::read_dir("/usr/lib/postgresql").ok()?.filter_map(|e| Some(e.ok()?.path())).max()?;
        let server = Self(tempfile::tempdir().unwrap(), newest.join("bin"));
        let root = server.0.path();
        let _ = Command::new("chmod").arg("777").arg(root).status();
        server.run(&format!("initdb -D {}/data -U radcam --auth=trust -N", root.display()));
        server.control("start");
        Some(server)
    }

    fn run(&self, command: &str) {
        // PostgreSQL does not run as root.
        let root = Command::new("id").arg("-u").output().unwrap().stdout == b"0\n";
        let mut shell = Command::new(if root { "runuser" } else { "sh" });
        if root {
            shell.args(["-u", "postgres", "--", "sh"]);
        }
        let line = format!("{}/{command}", self.1.display());
        let done = shell.args(["-c", &line]).current_dir(self.0.path()).stdout(Stdio::null()).status();
        assert!(done.unwrap().success(), "{command}");
    }

    /// Starts or stops it.
    fn control(&self, what: &str) {
        let root = self.0.path().display();
        let options = format!("-c listen_addresses= -c unix_socket_directories={root} -F");
        self.run(&format!("pg_ctl -D {root}/data -o '{options}' -l {root}/log -w {what}"));
    }

    fn url(&self) -> String {
        let folder = self.0.path().display().to_string().replace('/', "%2F");
        format!("postgres://radcam@{folder}/postgres")
    }
}

impl Drop for Postgres {
    fn drop(&mut self) {
        let pid = std::fs::read_to_string(self.0.path().join("data/postmaster.pid")).unwrap_or_default();
        if let Some(pid) = pid.lines().next() {
            let _ = Command::new("kill").args(["-QUIT", pid]).status();
        }
        std::thread::sleep(std::time::Duration::from_millis(300));
    }
}

#[test]
fn postgresql_keeps_the_history() {
    let Some(server) = Postgres::start() else {
        assert!(std::env::var_os("RADCAM_TEST_TOOLS").is_none(), "PostgreSQL is not installed");
        println!("SKIPPED: PostgreSQL is not installed");
        return;
    };
    storage(&server.url());
}

/// The program with a simulated camera: it learns, is ended and goes on; another camera of that serial number
/// whose gain is 3 % higher is found, in the history, on standard output, and in what Prometheus reads.
#[test]
fn the_program_finds_a_change_between_two_runs() {
    let dir = tempfile::tempdir().unwrap();
    let mut start = model(96, 64);
    let mut camera = Camera::new(start.clone());
    let cal = dir.path().join("cal.tiff");
    camera.calibration().write(&cal).unwrap();
    let file = dir.path().join("camera.toml");
    std::fs::write(&file, start.to_toml().unwrap()).unwrap();
    let (sensor, store) = (format!("sim:{}", file.display()), dir.path().join("history.db"));
    let arguments = |checks| {
        let text = |p: &Path| p.to_str().unwrap().to_string();
        let mut all: Vec<String> =
            ["monitor", "--camera", &sensor, "--every", "0.001", "--checks", checks].map(Into::into).into();
        all.extend(["--cal".into(), text(&cal), "--store".into(), text(&store)]);
        all.extend(["--illumination".into(), "0.8".into(), "--gain-limit".into(), "0.03".into()]);
        all
    };
    let run = |code, checks| {
        let all = arguments(checks);
        expect(code, &all.iter().map(String::as_str).collect::<Vec<_>>())
    };
    let text = run(0, "45");
    assert!(text.contains("45: as usual"), "{text}");
    start.base.gain_dn_per_e *= 1.03;
    std::fs::write(&file, start.to_toml().unwrap()).unwrap();
    let mut all = arguments("20");
    let campaigns = dir.path().join("campaigns");
    all.extend([
        "--metrics".into(),
        "127.0.0.1:0".into(),
        "--diagnose".into(),
        campaigns.to_str().unwrap().into(),
    ]);
    let out = radcam(&all.iter().map(String::as_str).collect::<Vec<_>>());
    let text = String::from_utf8(out.stdout).unwrap();
    assert_eq!(out.status.code(), Some(1), "{text}");
    let alarms: Vec<&str> = text.lines().filter(|l| l.starts_with("ALARM")).collect();
    assert!(
        alarms.iter().any(|a| a.contains("ALARM SIM12: Gain is") && a.contains("higher since")),
        "{text}"
    );
    // Its own gain is what a diagnosis fits: nothing is missing from the model, and the campaign is there to
    // be calibrated from.
    let campaign = std::fs::read_dir(&campaigns).unwrap().next().unwrap().unwrap().path();
    assert!(text.contains(campaign.to_str().unwrap()) && !text.contains("no diagnosis"), "{text}");
    assert_eq!(radcam::dataset::Dataset::open(&campaign).unwrap().rows().len(), 240);
    let kept = Store::open(store.to_str().unwrap()).unwrap().alarms("SIM12").unwrap();
    assert_eq!(kept.len(), alarms.len());
    let text = run(0, "1");
    assert!(text.contains("65 in the history"), "{text}");
}

/// What Prometheus is given is read by a parser of others.
#[test]
fn prometheus_reads_the_metrics() {
    use radcam::monitor::metrics::{Metrics, serve};
    use std::io::{Read, Write};
    use std::sync::Arc;
    let mut camera = Camera::new(model(64, 48));
    let calibration = camera.calibration();
    let check = camera.check(&calibration);
    let metrics = Arc::new(Metrics::default());
    metrics.take("SIM\"12", &check, &[]);
    let address = serve("127.0.0.1:0".parse().unwrap(), Arc::clone(&metrics)).unwrap();
    // Clients that ask slowly, or not at all, hold nobody up.
    let slow: Vec<_> = (0..50).map(|_| std::net::TcpStream::connect(address).unwrap()).collect();
    slow.iter().for_each(|mut s| write!(s, "GET /metrics HT").unwrap());
    let begun = std::time::Instant::now();
    let get = |path: &str| {
        let mut stream = std::net::TcpStream::connect(address).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        text
    };
    assert!(get("/other").starts_with("HTTP/1.1 404"));
    let answer = get("/metrics");
    assert!(begun.elapsed().as_secs() < 2, "{:?}", begun.elapsed());
    let body = answer.split_once("\r\n\r\n").unwrap().1;
    let lines = body.lines().filter(|l| *l != "# EOF").map(|l| Ok(l.to_string()));
    let scrape = prometheus_parse::Scrape::parse(lines).unwrap();
    let value = |name: &str, what: &str| {
        let sample = scrape.samples.iter().find(|s| s.metric == name && s.labels.get("what") == Some(what));
        match sample.unwrap_or_else(|| panic!("{name} {what}: {body}")).value {
            prometheus_parse::Value::Gauge(v)
            | prometheus_parse::Value::Counter(v)
            | prometheus_parse::Value::Untyped(v) => v,
            ref other => panic!("{other:?}"),
        }
    };
    assert_eq!(value("radcam_reading", "gain"), check.readings[&Followed::Gain].value);
    assert_eq!(value("radcam_reading_std_err", "gain"), check.readings[&Followed::Gain].std_err);
    assert_eq!(value("radcam_checks_total", "all"), 1.0);
}

/// A running monitor of a small simulated camera, as fast as it can: what it prints, a line for each check.
fn monitored(
    dir: &Path,
    store: &str,
    checks: &str,
    more: &[&str],
    preload: Option<&Path>,
) -> std::process::Child {
    let model = model(64, 48);
    let (file, cal) = (dir.join("camera.toml"), dir.join("cal.tiff"));
    std::fs::write(&file, model.to_toml().unwrap()).unwrap();
    Camera::new(model).calibration().write(&cal).unwrap();
    let mut command = crate::support::program();
    command.arg("monitor").arg("--camera").arg(format!("sim:{}", file.display())).arg("--cal").arg(&cal);
    command.args(["--json", "--illumination", "0.8", "--checks", checks, "--store", store]).args(more);
    if let Some(library) = preload {
        command.env("LD_PRELOAD", library);
    }
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Exit code, lines of standard output, log.
fn ended(child: std::process::Child) -> (Option<i32>, usize, String) {
    let out = child.wait_with_output().unwrap();
    let lines = String::from_utf8(out.stdout).unwrap().lines().count();
    (out.status.code(), lines, String::from_utf8(out.stderr).unwrap())
}

/// Checks of the one camera in a history.
fn kept(store: &str) -> usize {
    let store = Store::open(store).unwrap();
    let cameras = store.cameras().unwrap();
    cameras.iter().map(|c| store.history(c).unwrap().len()).sum()
}

/// A database that another program has locked for longer than SQLite waits: checks go on and are told, and
/// all of them are written in the end.
#[test]
fn a_locked_history_loses_no_check() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("history.db");
    let store = file.to_str().unwrap();
    Store::open(store).unwrap();
    let script = "import sqlite3, sys, time\nc = sqlite3.connect(sys.argv[1], isolation_level=None)\n\
                  c.execute('BEGIN EXCLUSIVE')\nprint('locked', flush=True)\ntime.sleep(8)";
    let lock = |from: &str| {
        let mut other =
            Command::new("python3").args(["-c", script, from]).stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        std::io::BufRead::read_line(&mut std::io::BufReader::new(other.stdout.as_mut().unwrap()), &mut line)
            .unwrap();
        other
    };
    // At the start, and while it runs.
    let mut other = lock(store);
    let child = monitored(dir.path(), store, "30", &["--every", "0.3"], None);
    other.wait().unwrap();
    std::thread::sleep(std::time::Duration::from_secs(2));
    let mut other = lock(store);
    let (code, lines, log) = ended(child);
    other.wait().unwrap();
    assert_eq!((code, lines), (Some(0), 30), "{log}");
    assert!(log.contains("waiting for the history") && log.contains("checks wait in memory"), "{log}");
    assert_eq!(kept(store), 30);
}

/// A history that is moved away and back.
#[test]
fn an_absent_history_loses_no_check() {
    let dir = tempfile::tempdir().unwrap();
    let (file, away) = (dir.path().join("history.db"), dir.path().join("away.db"));
    let store = file.to_str().unwrap();
    Store::open(store).unwrap();
    let child = monitored(dir.path(), store, "20", &["--every", "0.2"], None);
    std::thread::sleep(std::time::Duration::from_secs(1));
    std::fs::rename(&file, &away).unwrap();
    std::thread::sleep(std::time::Duration::from_secs(2));
    std::fs::rename(&away, &file).unwrap();
    let (code, lines, log) = ended(child);
    assert_eq!((code, lines, kept(store)), (Some(0), 20, 20), "{log}");
    assert!(log.contains("not there") && log.contains("written again"), "{log}");
}

/// A PostgreSQL server that is away for some seconds.
#[test]
fn a_history_whose_server_is_away_loses_no_check() {
    let Some(server) = Postgres::start() else { return };
    let dir = tempfile::tempdir().unwrap();
    let url = server.url();
    Store::open(&url).unwrap();
    let child = monitored(dir.path(), &url, "25", &["--every", "0.2"], None);
    std::thread::sleep(std::time::Duration::from_secs(1));
    server.control("stop -m immediate");
    std::thread::sleep(std::time::Duration::from_secs(5));
    server.control("start");
    let (code, lines, log) = ended(child);
    assert_eq!((code, lines, kept(&url)), (Some(0), 25, 25), "{log}");
    assert!(log.contains("checks wait in memory") && log.contains("written again"), "{log}");
}

/// A clock that was never set, one beyond 64 bits of nanoseconds, and one that stands still.
#[test]
fn a_clock_out_of_range_does_not_end_a_monitor() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("clock.c");
    let text = "#define _GNU_SOURCE\n#include <time.h>\n#include <unistd.h>\n#include <sys/syscall.h>\n\
        int clock_gettime(clockid_t id, struct timespec *t) {\n int done = syscall(SYS_clock_gettime, id, t);\n\
        if (id == CLOCK_REALTIME) { t->tv_sec = SECONDS; t->tv_nsec = 0; }\n return done; }";
    std::fs::write(&source, text).unwrap();
    for (name, seconds) in
        [("before", "-1000000"), ("zero", "0"), ("after", "10000000000LL"), ("far", "800000000000LL")]
    {
        let library = dir.path().join(format!("{name}.so"));
        let define = format!("-DSECONDS={seconds}");
        let built =
            Command::new("gcc").args(["-shared", "-fPIC", &define, "-o"]).args([&library, &source]).status();
        assert!(built.unwrap().success());
        let file = dir.path().join(format!("{name}.db"));
        let store = file.to_str().unwrap();
        let child = monitored(dir.path(), store, "5", &["--every", "0.01"], Some(&library));
        let (code, lines, log) = ended(child);
        assert_eq!((code, lines, kept(store)), (Some(0), 5, 5), "{name}: {log}");
    }
}
