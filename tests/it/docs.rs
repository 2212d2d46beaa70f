//! The documents are true: commands run, formats parse, links lead somewhere, tables list what there is.

use crate::support::{program, small_sensor};
use radcam::dataset::Manifest;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

fn document(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap()
}

/// Lines of a document's indented blocks that call radcam.
fn commands(name: &str) -> Vec<String> {
    let text = document(name);
    let lines = text.lines().filter_map(|l| l.strip_prefix("    "));
    lines.filter(|l| l.starts_with("radcam ")).map(Into::into).collect()
}

/// Seconds that a command may take on a busy machine before it is ended: it hangs.
const LIMIT_S: &str = "600";

/// Runs a line of a document in this folder. What says that Ctrl-C ends it is interrupted once it has worked
/// for a while.
fn run(line: &str, root: &Path) -> Output {
    let errors = root.join("stderr.txt");
    // In the foreground it hands an interrupt on once; otherwise to its group as well, and a second one ends
    // radcam at once.
    let shell = line.replacen("radcam", &format!("exec timeout --foreground {LIMIT_S} \"$RADCAM\""), 1);
    let mut child = Command::new("sh")
        .args(["-c", &shell])
        .env("RADCAM", env!("CARGO_BIN_EXE_radcam"))
        .current_dir(root)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(fs::File::create(&errors).unwrap())
        .spawn()
        .unwrap();
    let mut stdout = BufReader::new(child.stdout.take().unwrap());
    let mut said = String::new();
    while stdout.read_line(&mut said).unwrap() > 0 {
        if said.ends_with("Ctrl-C ends\n") {
            std::thread::sleep(Duration::from_secs(3));
            let kill = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
            assert!(kill.success(), "{line}");
        }
    }
    let mut out = child.wait_with_output().unwrap();
    (out.stdout, out.stderr) = (said.into_bytes(), fs::read(errors).unwrap());
    out
}

/// README's commands in the order of README, each as a reader types it. Only the camera is another: a
/// simulated one of few pixels, with image lag.
#[test]
fn the_commands_of_the_readme_run() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    let sensor = small_sensor(root, "cmos12", 96, 64);
    let mut model = fs::read_to_string(&sensor).unwrap();
    model += "\n[[effect]]\nid = \"image-lag\"\nparameters = { shape = 0.0, fraction = 0.02, tau_s = 1.0, fraction_2 = 0.0, tau_2_s = 1.0 }\n";
    let camera = root.join("camera.toml");
    fs::write(&camera, model).unwrap();
    let simulate = |output: &str, plan: &str| {
        let arguments = ["simulate", camera.to_str().unwrap(), "--plan", plan, "-o", output];
        assert!(program().current_dir(root).args(arguments).output().unwrap().status.success());
    };
    simulate("loose", "standard");
    // Loose files, as somebody else's program leaves them, and what the calibration is to be applied to.
    fs::create_dir(root.join("FOLDER")).unwrap();
    fs::create_dir(root.join("frames")).unwrap();
    let frames = fs::read_to_string(root.join("loose/frames.csv")).unwrap();
    for row in frames.lines().skip(1) {
        let name = Path::new(row.split(',').next().unwrap());
        fs::copy(root.join("loose").join(name), root.join("FOLDER").join(name.file_name().unwrap())).unwrap();
    }
    let mut ran = Vec::new();
    for line in commands("README.md") {
        // A reader who has frames of a campaign already begins with `diagnose`; here the import comes first.
        let line = line.replace("aravis:192.168.1.5", "sim:camera.toml");
        if line.starts_with("radcam diagnose") && !root.join("campaign").exists() {
            continue;
        }
        let line = if line.contains("import FOLDER") { line + " --yes" } else { line };
        if line.starts_with("radcam correct") {
            let folder = ["calibration", "campaign"].map(|f| root.join(f)).into_iter().find(|f| f.exists());
            fs::copy(folder.unwrap().join("frames/00008.tiff"), root.join("frames/one.tiff")).unwrap();
        }
        if line.contains("--plan bench.toml") {
            fs::copy(
                Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/standard-plan.toml"),
                root.join("bench.toml"),
            )
            .unwrap();
        }
        // A camera is served through libaravis.
        let line =
            if cfg!(feature = "aravis") { line } else { line.replace("--serve-as LINE1", "--to live") };
        let out = run(&line, root);
        let said = String::from_utf8_lossy(&out.stderr);
        // A verdict that something is missing is an answer.
        let answers = ["diagnose", "investigate"].iter().any(|v| line.contains(v));
        let code = out.status.code();
        // A simulated camera may be faster than the disk: frames that are counted as lost are an answer, too.
        let may_differ = answers || line.starts_with("radcam stream");
        assert!(code == Some(0) || may_differ && code == Some(1), "{line}: {code:?}\n{said}");
        if answers {
            let told = String::from_utf8_lossy(&out.stdout);
            assert!(told.contains("image-lag"), "{line}\n{told}");
        }
        ran.push(line.split(' ').nth(1).unwrap().to_string());
    }
    assert!(root.join("history.db").exists());
    let verbs = [
        "import",
        "noise",
        "diagnose",
        "cameras",
        "investigate",
        "calibrate",
        "correct",
        "plan-calibration",
        "capture",
        "calibrate",
        "correct",
        "stream",
        "monitor",
    ];
    assert_eq!(ran, verbs);
    // Both ways in stand within the first two screens of 50 lines.
    let readme = document("README.md");
    let line_of = |heading: &str| readme.lines().position(|l| l == heading).unwrap();
    assert!(line_of("## I have TIFFs") < 100 && line_of("## I have a camera") < 100);
}

/// The blocks of docs/formats.md are read by what reads such files.
#[test]
fn the_formats_are_those_that_are_read() {
    let text = document("docs/formats.md");
    let block = |heading: &str, language: &str, number: usize| {
        let (_, of) = text.split_once(&format!("\n## {heading}\n")).unwrap();
        let of = of.split("\n## ").next().unwrap();
        let block = of.split(&format!("```{language}\n")).nth(number).unwrap();
        block.split("\n```").next().unwrap().to_string() + "\n"
    };
    let manifest = Manifest::from_toml(&block("Dataset", "toml", 1)).unwrap();
    assert_eq!(manifest.camera.left_on().len(), 1);
    assert_eq!(radcam::plan::Plan::from_toml(&block("Plan", "toml", 1)).unwrap().sets.len(), 2);
    let standard = radcam::plan::Plan::from_toml(&document("docs/standard-plan.toml")).unwrap();
    assert_eq!(standard, radcam::plan::Plan::standard());
    let model = radcam_sim::Model::from_toml(&block("Model", "toml", 1)).unwrap();
    assert_eq!(model.effects.len(), 2);
    radcam_sim::Sensor::new(model).unwrap();
    assert_eq!(radcam::import::Map::from_toml(&block("Import map", "toml", 1)).unwrap().sets.len(), 2);
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: String| {
        let path = dir.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, text).unwrap();
        path
    };
    let source = |path: &Path| radcam::source::Source::open(path).unwrap();
    let table = source(&write("t.csv", block("Table", "csv", 1)));
    assert!((table.noise().unwrap().gain_dn_per_e.value - 0.4).abs() < 1e-6);
    assert!(matches!(
        source(&write("d.txt", block("Descriptor", "text", 1))),
        radcam::source::Source::Frames(_)
    ));
    write("set/dataset.toml", block("Dataset", "toml", 1));
    write("set/frames.csv", block("Dataset", "csv", 1));
    assert!(
        matches!(source(&dir.path().join("set")), radcam::source::Source::Frames(d) if d.sets().len() == 2)
    );
    let library = radcam::surfaces::Library::read(&write("l.toml", block("Surfaces", "toml", 1))).unwrap();
    assert_eq!(library.surfaces[0].name, "plaster");
}

/// Every command stands in the table of docs/commands.md, and nothing else does.
#[test]
fn the_table_of_commands_is_whole() {
    let text = document("docs/commands.md");
    let listed: std::collections::BTreeSet<&str> = text
        .split("`radcam ")
        .skip(1)
        .filter_map(|t| t.split([' ', '`']).next())
        .filter(|v| *v != "COMMAND")
        .collect();
    let help = String::from_utf8(program().arg("--help").output().unwrap().stdout).unwrap();
    let (_, verbs) = help.split_once("Commands:\n").unwrap();
    let verbs = verbs.split("\n\n").next().unwrap().lines().filter_map(|l| l.split_whitespace().next());
    let real: std::collections::BTreeSet<&str> = help
        .lines()
        .filter(|l| l.starts_with("  ") && !l.starts_with("   "))
        .filter_map(|l| l.split_whitespace().next())
        .filter(|v| *v != "help" && !v.starts_with('-'))
        .collect();
    assert!(verbs.count() > 20, "{help}");
    assert_eq!(listed, real);
}

/// Relative links of all documents lead to files and headings that exist.
#[test]
fn links_lead_somewhere() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut pages = vec![root.join("README.md"), root.join("CONTRIBUTING.md"), root.join("CHANGELOG.md")];
    for folder in ["docs", "docs/decisions"] {
        let files = fs::read_dir(root.join(folder)).unwrap().map(|f| f.unwrap().path());
        pages.extend(files.filter(|p| p.extension().is_some_and(|e| e == "md")));
    }
    let slug = |heading: &str| {
        let kept: String =
            heading.to_lowercase().chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c)).collect();
        kept.replace(' ', "-")
    };
    for page in pages {
        let text = fs::read_to_string(&page).unwrap();
        for link in text.split("](").skip(1).filter_map(|t| t.split(')').next()) {
            if link.contains("://") {
                continue;
            }
            let (file, heading) = link.split_once('#').map_or((link, None), |(f, h)| (f, Some(h)));
            let path = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
            assert!(path.exists(), "{}: {link}", page.display());
            if let Some(heading) = heading {
                let text = fs::read_to_string(&path).unwrap();
                let mut headings = text
                    .lines()
                    .filter(|l| l.starts_with('#'))
                    .map(|l| slug(l.trim_start_matches('#').trim()));
                assert!(headings.any(|h| h == heading), "{}: {link}", page.display());
            }
        }
    }
}
