//! Files that others wrote to do harm: no end, no size, values that cannot be, links that lead elsewhere.
//! Each is refused by name and soon.

use crate::support::{calibration, expect, program, refused};
use flate2::{Compression, write::ZlibEncoder};
use radcam::calibrate::file::Calibration;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const MANIFEST: &str = "format = \"radcam-dataset/1\"\n[camera]\nvendor = \"v\"\nmodel = \"m\"\nserial = \"s\"\nwidth = 4\nheight = 4\n\
                        bit_depth = 12\npixel_format = \"Mono12\"\n";
const HEADER: &str = "file,kind,set,index,exposure_s,illumination,configuration,temperature_c,timestamp_s\n";

/// A folder of one test.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().into()
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> String {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, bytes).unwrap();
        self.text(name)
    }

    /// A dataset of one dark and one flat of 4 x 4 px, by its manifest and rows.
    fn dataset(&self, name: &str) -> String {
        self.write(&format!("{name}/dataset.toml"), MANIFEST);
        self.write(
            &format!("{name}/frames.csv"),
            format!("{HEADER}dark.tiff,dark,0,0,0.01,0,0,,\nflat.tiff,flat,1,0,0.01,1,0,,\n"),
        );
        for (file, dn) in [("dark", 64), ("flat", 900)] {
            self.write(&format!("{name}/{file}.tiff"), tiff(1, dn));
        }
        self.text(name)
    }

    fn calibration(&self) -> (Calibration, String) {
        let cal = calibration("m", "s", (4, 4), |i| (64.0, 0.95 + 0.1 * (i % 2) as f32));
        let path = self.path("cal.tiff");
        cal.write(&path).unwrap();
        (cal, path.to_str().unwrap().into())
    }
}

/// A TIFF of some pages of 4 x 4 px, codes that count up from `dn`.
fn tiff(pages: usize, dn: u16) -> Vec<u8> {
    let mut out = vec![b'I', b'I', 42, 0, 0, 0, 0, 0];
    let mut link = 4;
    for page in 0..pages {
        let at = out.len() as u32;
        out.extend((0..16).flat_map(|i| (dn + i + (page * 7 % 5) as u16).to_le_bytes()));
        let directory = out.len() as u32;
        out[link..link + 4].copy_from_slice(&directory.to_le_bytes());
        let entries: [(u16, u16, u32); 9] = [
            (256, 3, 4),
            (257, 3, 4),
            (258, 3, 16),
            (259, 3, 1),
            (262, 3, 1),
            (273, 4, at),
            (277, 3, 1),
            (278, 3, 4),
            (279, 4, 32),
        ];
        out.extend((entries.len() as u16).to_le_bytes());
        for (tag, kind, value) in entries {
            out.extend(tag.to_le_bytes());
            out.extend(kind.to_le_bytes());
            out.extend(1u32.to_le_bytes());
            out.extend(value.to_le_bytes());
        }
        link = out.len();
        out.extend([0; 4]);
    }
    out
}

fn crc(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: &u8| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    };
    !bytes.iter().fold(!0, step)
}

/// A grey PNG of 8 bits with further chunks before its pixels; the pixels are packed as they come.
fn png(width: u32, height: u32, chunks: &[(&[u8; 4], Vec<u8>)]) -> Vec<u8> {
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |name: &[u8; 4], data: &[u8]| {
        out.extend((data.len() as u32).to_be_bytes());
        let body = [&name[..], data].concat();
        out.extend(&body);
        out.extend(crc(&body).to_be_bytes());
    };
    let mut head = [width.to_be_bytes(), height.to_be_bytes()].concat();
    head.extend([8, 0, 0, 0, 0]);
    chunk(b"IHDR", &head);
    for (name, data) in chunks {
        chunk(name, data);
    }
    let row = vec![0u8; width as usize + 1];
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::best());
    (0..height).for_each(|_| packed.write_all(&row).unwrap());
    chunk(b"IDAT", &packed.finish().unwrap());
    chunk(b"IEND", &[]);
    out
}

/// So many zeros, packed.
fn packed_zeros(bytes: usize) -> Vec<u8> {
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::best());
    let block = vec![0u8; 1 << 20];
    (0..bytes >> 20).for_each(|_| packed.write_all(&block).unwrap());
    packed.finish().unwrap()
}

/// Exit code and standard error of a run that may take so many seconds and megabytes.
fn bounded(seconds: u64, megabytes: u64, arguments: &[&str]) -> (Option<i32>, String) {
    let program = program().get_program().to_owned();
    let mut command = Command::new("sh");
    command.args(["-c", &format!("ulimit -v {}; exec \"$@\"", megabytes << 10), "sh"]);
    let mut child =
        command.arg(program).args(arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > Duration::from_secs(seconds) {
            child.kill().unwrap();
            panic!("radcam {arguments:?} takes more than {seconds} s");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let output = child.wait_with_output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

/// Address space that threads and libraries of the program take without a file, and room for small ones, MB.
const ROOM_MB: u64 = 4000;

/// Standard error of a run that must be refused within ten seconds.
fn soon_refused(arguments: &[&str]) -> String {
    let (code, said) = bounded(10, ROOM_MB, arguments);
    assert!(code == Some(2) && !said.contains("panicked"), "radcam {arguments:?}: {code:?}\n{said}");
    said
}

/// Sources of the library without their tests.
fn sources(folder: &Path, out: &mut Vec<(PathBuf, String)>) {
    for entry in folder.read_dir().unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            let text = fs::read_to_string(&path).unwrap();
            let code = text.split("#[cfg(test)]\nmod ").next().unwrap().to_string();
            out.push((path, code));
        }
    }
}

/// A reader that opens a path by itself would wait for a FIFO.
#[test]
fn files_are_opened_in_one_place() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut all = Vec::new();
    for folder in ["src", "sim/src", "bindings/python/src"] {
        sources(&root.join(folder), &mut all);
    }
    // `output.rs` opens folders; a camera's own files are no files of this machine.
    let exempt = ["src/base/input.rs", "src/base/output.rs", "src/cameras/camera/aravis/files.rs"];
    for (path, code) in all {
        let name = path.strip_prefix(root).unwrap().to_string_lossy().into_owned();
        for line in code.lines().filter(|l| !l.trim_start().starts_with("//")) {
            let opens =
                ["File::open(", "fs::read(", "read_to_string(\"", "fs::read_to_string(", "OpenOptions::new("];
            let found = opens.iter().any(|o| line.contains(o));
            let own = line.contains("/proc/") || exempt.contains(&&*name);
            assert!(!found || own, "{name}: {line}\nuse crate::input, which opens regular files only");
        }
    }
}

/// W3, W4: every reader, given a link to a device and a FIFO in place of its file.
#[test]
#[cfg(unix)]
fn fifos_and_devices_are_refused_by_name() {
    let p = Place::new();
    let (_, cal) = p.calibration();
    let frame = p.write("frame.tiff", tiff(1, 700));
    let fifo = p.text("fifo");
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    for (target, kind) in [("/dev/zero", "is a device"), (&*fifo, "is a FIFO")] {
        let case = format!("of-{}", Path::new(target).file_name().unwrap().to_str().unwrap());
        let link = |name: &str| {
            let path = p.path(&format!("{case}/{name}"));
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::remove_file(&path).ok();
            std::os::unix::fs::symlink(target, &path).unwrap();
            path.to_str().unwrap().to_string()
        };
        let refuse = |arguments: &[&str]| {
            let said = soon_refused(arguments);
            assert!(
                said.contains(kind) || said.contains("leaves the dataset folder"),
                "{arguments:?}: {said}"
            );
        };
        for part in ["dataset.toml", "frames.csv", "dark.tiff"] {
            let dataset = p.dataset(&format!("{case}/{part}.set"));
            link(&format!("{part}.set/{part}"));
            refuse(&["noise", &dataset]);
        }
        let inside = p.dataset(&format!("{case}/inside"));
        fs::remove_file(p.path(&format!("{case}/inside/flat.tiff"))).unwrap();
        let made = Command::new("mkfifo").arg(p.path(&format!("{case}/inside/flat.tiff"))).status();
        assert!(made.unwrap().success());
        assert!(soon_refused(&["noise", &inside]).contains("is a FIFO"));
        let good = p.dataset(&format!("{case}/good"));
        let bare = link("bare");
        refuse(&["noise", &bare]);
        refuse(&["compare", &good, "--model", &link("m.toml")]);
        refuse(&["simulate", &bare, "-o", &p.text("none")]);
        refuse(&["simulate", "cmos12", "--plan", &link("plan.toml"), "-o", &p.text("none")]);
        refuse(&["import", "--map", &link("map.toml"), "-o", &p.text("none")]);
        refuse(&["correct", &link("cal.tiff"), &frame, "-o", &p.text("none.tiff")]);
        refuse(&["correct", &cal, &link("frame.tiff"), "-o", &p.text("none.tiff")]);
        refuse(&["scene", &cal, &link("scene.png")]);
        refuse(&["surface", "identify", &link("library.toml"), &cal, &frame]);
        refuse(&["merge", &bare, &bare, "-o", &p.text("none.stats")]);
        for name in ["a.tif", "a.png", "a.fits", "a.npy", "a.h5", "a.fits.gz"] {
            refuse(&["import", &link(name), "-o", &p.text("none"), "--yes"]);
        }
        refuse(&["capture", "--camera", &format!("replay:{bare}"), "-o", &p.text("none")]);
    }
}

/// C8: shapes with a zero, and shapes that no memory has, in every container.
#[test]
fn shapes_without_pixels_are_refused() {
    let p = Place::new();
    let import = |name: &str| {
        let path = p.text(name);
        soon_refused(&["import", &path, "-o", &p.text("none"), "--yes"])
    };
    let npy = |descr: &str, shape: &str| {
        let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
        [b"\x93NUMPY\x01\0", &(text.len() as u16).to_le_bytes()[..], text.as_bytes(), &[7; 64]].concat()
    };
    for shape in [
        "(0,)",
        "(0, 4)",
        "(4, 0, 4)",
        "(3, 4, 0)",
        "(18446744073709551615, 0)",
        "(0, 9223372036854775807, 4)",
    ] {
        p.write("a.npy", npy("<u2", shape));
        let said = import("a.npy");
        assert!(said.contains("a.npy") && said.contains("holds no frames"), "{shape}: {said}");
    }
    for shape in ["(9223372036854775807, 2, 2)", "(-1, 4)", "()", "(99999999999999999999, 2)"] {
        p.write("a.npy", npy("<u2", shape));
        assert!(import("a.npy").contains("a.npy"), "{shape}");
    }
    p.write("a.npy", npy("é8", "(2, 2)"));
    assert!(import("a.npy").contains("type 'é8'"));
    for (width, height) in [(0, 4), (4, 0), (0, 0), (u32::MAX, 1), (u32::MAX, u32::MAX), (1 << 31, 4)] {
        let bytes = png(4, 4, &[]);
        let mut head = bytes[12..29].to_vec();
        head[4..12].copy_from_slice(&[width.to_be_bytes(), height.to_be_bytes()].concat());
        let sum = crc(&head).to_be_bytes();
        p.write("a.png", [&bytes[..12], &head, &sum, &bytes[33..]].concat());
        assert!(import("a.png").contains("a.png"), "{width} x {height}");
        let mut bytes = tiff(1, 100);
        let at = 8 + 32 + 2 + 8;
        for (k, n) in [width, height].into_iter().enumerate() {
            bytes[at - 6 + 12 * k..at - 4 + 12 * k].copy_from_slice(&4u16.to_le_bytes());
            bytes[at + 12 * k..at + 4 + 12 * k].copy_from_slice(&n.to_le_bytes());
        }
        p.write("a.tif", bytes);
        assert!(import("a.tif").contains("a.tif"), "{width} x {height}");
        let card = |text: String| format!("{text:<80}");
        let cards = [
            "SIMPLE  =                    T".into(),
            "BITPIX  =                   16".into(),
            "NAXIS   =                    2".into(),
            format!("NAXIS1  = {width}"),
            format!("NAXIS2  = {height}"),
            "END".into(),
        ];
        let head: String = cards.map(card).concat();
        p.write("a.fits", format!("{head:<2880}{:2880}", ""));
        assert!(import("a.fits").contains("a.fits"), "{width} x {height}");
    }
}

/// W1, W2, C9: time in proportion to rows, pages and characters. What took half a minute to minutes takes
/// less than a second in a release.
#[test]
fn readers_are_linear() {
    let p = Place::new();
    let timed = |seconds: f64, what: &str, work: &mut dyn FnMut()| {
        let begun = Instant::now();
        work();
        let took = begun.elapsed().as_secs_f64();
        println!("{what}: {took:.2} s");
        assert!(took < seconds, "{what} takes {took} s");
    };
    p.write("rows/dataset.toml", MANIFEST);
    let row = |i: usize| format!("frames/{i:06}.tiff,flat,{},{},0.01,1,0,,{}.5\n", i / 10, i % 10, i);
    p.write("rows/frames.csv", HEADER.to_string() + &(0..100_000).map(row).collect::<String>());
    timed(4.0, "100,000 rows of frames.csv", &mut || {
        assert_eq!(radcam::dataset::Dataset::open(&p.path("rows")).unwrap().rows().len(), 100_000);
    });
    let levels = (0..1_000_000).map(|i| format!("{}.5,{}.25,1000\n", 100 + i % 4000, 5 + i % 900));
    p.write("table.csv", "mean_dn,var_dn2,pixels\n".to_string() + &levels.collect::<String>());
    timed(20.0, "10^6 rows of a table", &mut || {
        assert_eq!(
            radcam::dataset::table::Table::open(&p.path("table.csv")).unwrap().levels.len(),
            1_000_000
        );
    });
    p.write("in/dark_10ms.tif", tiff(10_000, 64));
    p.write("in/flat_10ms.tif", tiff(10_000, 900));
    timed(60.0, "import of 20,000 pages", &mut || {
        expect(0, &["import", &p.text("in"), "-o", &p.text("d"), "--yes", "--pattern", "mono"]);
    });
    // Blocks of an OME-TIFF.
    let planes = 10_000;
    let blocks = |i: usize| {
        format!("<TiffData IFD=\"{i}\" FirstT=\"{i}\"/><Plane TheT=\"{i}\" ExposureTime=\"0.01\"/>")
    };
    let xml = format!(
        "<OME xmlns=\"http://www.openmicroscopy.org/Schemas/OME/2016-06\"><Image><Pixels SizeT=\"{planes}\" SizeC=\"1\" SizeZ=\"1\">{}</Pixels></Image></OME>\0",
        (0..planes).map(blocks).collect::<String>()
    );
    p.write("ome/dark.ome.tif", described(&tiff(planes, 64), &xml));
    timed(60.0, "10,000 planes with blocks", &mut || {
        expect(0, &["import", &p.text("ome"), "-o", &p.text("o"), "--yes", "--pattern", "mono"]);
    });
    let mut model = radcam_sim::sensors::load("cmos12").unwrap().to_toml().unwrap();
    model += "\n[[effect]]\nid = \"custom\"\nname = \"long\"\nparameters = { k = 0.1 }\nformulas = { variance = \"FORMULA\" }\n";
    for (what, formula) in [
        ("10^6 terms", vec!["k*mu"; 1_000_000].join("+")),
        ("10 MB", vec!["k"; 5_000_000].join("+")),
        ("parentheses", "(".repeat(9000) + "k" + &")".repeat(9000)),
        ("parentheses within the length", "(".repeat(4000) + "k" + &")".repeat(4000)),
        ("signs", "-".repeat(10_000_000) + "k"),
    ] {
        let path = p.write("m.toml", model.replace("FORMULA", &formula));
        timed(5.0, what, &mut || {
            let said = soon_refused(&["model", "show", &path]);
            assert!(said.contains("long: variance has") && said.len() < 1000, "{said}");
        });
    }
    // The longest formula that is taken.
    let path = p.write("m.toml", model.replace("FORMULA", &vec!["k*mu"; 2000].join("+")));
    timed(5.0, "a formula of 10,000 characters", &mut || {
        expect(0, &["model", "show", &path]);
    });
}

/// A TIFF whose first page has this description.
fn described(tiff: &[u8], text: &str) -> Vec<u8> {
    let mut out = tiff.to_vec();
    let number = |at: usize| u32::from_le_bytes(tiff[at..at + 4].try_into().unwrap()) as usize;
    let directory = number(4);
    let text_at = out.len() as u32;
    out.extend(text.as_bytes());
    let mut entries: Vec<[u8; 12]> =
        (0..9).map(|i| tiff[directory + 2 + 12 * i..][..12].try_into().unwrap()).collect();
    let mut entry = [0; 12];
    entry[..2].copy_from_slice(&270u16.to_le_bytes());
    entry[2..4].copy_from_slice(&2u16.to_le_bytes());
    entry[4..8].copy_from_slice(&(text.len() as u32).to_le_bytes());
    entry[8..].copy_from_slice(&text_at.to_le_bytes());
    entries.push(entry);
    entries.sort_by_key(|e| u16::from_le_bytes([e[0], e[1]]));
    let at = out.len() as u32;
    out.extend((entries.len() as u16).to_le_bytes());
    entries.iter().for_each(|e| out.extend(e));
    out.extend(&tiff[directory + 2 + 12 * 9..][..4]);
    out[4..8].copy_from_slice(&at.to_le_bytes());
    out
}

/// W5, C7: profiles and texts are skipped; an image takes memory by its file.
#[test]
#[cfg(target_os = "linux")]
fn packed_profiles_and_texts_are_skipped() {
    let p = Place::new();
    let zeros = packed_zeros(1 << 30);
    let named = |start: &[u8]| [start, &zeros].concat();
    let bombs: [(&str, &[u8; 4], Vec<u8>); 3] = [
        ("profile", b"iCCP", named(b"p\0\0")),
        ("zTXt", b"zTXt", named(b"Comment\0\0")),
        ("iTXt", b"iTXt", named(b"Comment\0\x01\0\0\0")),
    ];
    let (_, cal) = p.calibration();
    for (name, chunk, data) in bombs {
        let path = p.write(&format!("{name}/dark_10ms.png"), png(4, 4, &[(chunk, data)]));
        let out = p.text(&format!("{name}.set"));
        let (code, said) = bounded(10, 1500, &["import", &path, "-o", &out, "--yes"]);
        assert_eq!(code, Some(0), "{name}: {said}");
        let out = p.text(&format!("{name}.tiff"));
        let (code, said) =
            bounded(10, 1500, &["correct", &cal, &path, "-o", &out, "--force", "--exposure-s", "0.01"]);
        assert_eq!(code, Some(0), "{name}: {said}");
    }
    // 900 million pixels in 900 kB.
    let path = p.write("large/dark_10ms.png", png(30_000, 30_000, &[]));
    let (code, said) = bounded(20, 1500, &["import", &path, "-o", &p.text("none"), "--yes"]);
    assert!(
        code == Some(2) && said.contains("30000 x 30000 px in") && said.contains("64 to 1"),
        "{code:?} {said}"
    );
}

/// W6: calibrations with values that no camera has.
#[test]
fn calibrations_that_cannot_be_are_refused() {
    let p = Place::new();
    let frame = p.write("frame_10ms.tiff", tiff(1, 700));
    let (good, path) = p.calibration();
    let bytes = fs::read(&path).unwrap();
    let refuse = |bytes: &[u8], part: &str| {
        let cal = p.write("bad.tiff", bytes);
        for verb in ["correct", "scene"] {
            let out = p.text("out.tiff");
            let more: &[&str] = if verb == "correct" { &["-o", &out] } else { &[] };
            let said = refused(&[&[verb, &cal, &frame][..], more].concat());
            assert!(said.contains("bad.tiff") && said.contains(part), "{part}: {said}");
        }
    };
    // The description has the length that it had.
    let text = serde_json::to_string(&good.description).unwrap();
    let at = bytes.windows(text.len()).position(|w| w == text.as_bytes()).unwrap();
    for (key, from, values) in [
        ("dark_exposure_s", "\"dark_exposure_s\":0.01", &["-1", "-1e9", "1e300"][..]),
        ("gain_dn_per_e", "\"gain_dn_per_e\":null", &["-1", "0", "-0.0", "1e99"]),
        ("constant_noise_var_dn2", "\"constant_noise_var_dn2\":null", &["-1", "1e300"]),
        ("offset_dn", "\"offset_dn\":null", &["1e99", "-1e99"]),
        ("dark_std_err_dn", "\"dark_std_err_dn\":0.1", &["-1", "-2"]),
        ("k_level_dn", "\"k_level_dn\":900.0", &["-1", "0"]),
        ("bit_depth", "\"bit_depth\":12", &["0", "17"]),
    ] {
        assert!(text.contains(from), "{from} in {text}");
        for value in values {
            let name = from.split(':').next().unwrap();
            // White space fills the room that is left.
            let changed = text.replace(from, &format!("{name}:{value}"));
            let changed = format!("{changed:<width$}", width = text.len());
            if changed.len() > text.len() {
                continue;
            }
            let all = [&bytes[..at], changed.as_bytes(), &bytes[at + text.len()..]].concat();
            refuse(&all, key);
        }
    }
    let change = |from: f32, to: f32, count: usize| {
        let mut out = bytes.clone();
        let mut left = count;
        for at in (0..out.len() - 4).step_by(2) {
            if left > 0 && out[at..at + 4] == from.to_le_bytes() {
                out[at..at + 4].copy_from_slice(&to.to_le_bytes());
                left -= 1;
            }
        }
        assert!(left < count);
        out
    };
    for (to, count, part) in [
        (1e38, 1, "K is 1"),
        (1e-38, 1, "K is 0.00000"),
        (10.5, 1, "K is 10.5"),
        (0.05, 1, "K is 0.05"),
        (-1.0, 1, "K is -1"),
        (0.0, 1, "K is 0"),
        (f32::NAN, 1, "no numbers"),
        (3.05, 8, "K has the mean 2.0"),
    ] {
        refuse(&change(0.95, to, count), part);
    }
    // Standard errors and flags.
    refuse(&change(good.k_std_err[(0, 0)], -0.5, 1), "k_std_err holds -0.5");
    let mut flagged = good.clone();
    flagged.defects[(1, 1)] = 9;
    flagged.write(&p.path("flagged.tiff")).unwrap();
    let bytes = fs::read(p.path("flagged.tiff")).unwrap();
    for (value, part) in
        [(255.0f32, "defects holds 255"), (0.5, "defects holds 0.5"), (-1.0, "defects holds -1")]
    {
        let at = bytes.windows(4).position(|w| w == 9f32.to_le_bytes()).unwrap();
        refuse(&[&bytes[..at], &value.to_le_bytes(), &bytes[at + 4..]].concat(), part);
    }
}

/// W6: numbers of datasets, tables and plans that cannot be.
#[test]
fn numbers_that_cannot_be_are_refused() {
    let p = Place::new();
    let dataset = p.dataset("d");
    for value in ["nan", "inf", "-inf", "1e300"] {
        for key in ["black_level_dn", "gain_db", "temperature_c"] {
            p.write("d/dataset.toml", format!("{MANIFEST}{key} = {value}\n"));
            let said = refused(&["noise", &dataset]);
            assert!(said.contains(&format!("camera.{key} is")) && said.contains("dataset.toml"), "{said}");
        }
        for (column, row) in [
            ("exposure_s", format!("dark.tiff,dark,0,0,{value},0,0,,")),
            ("illumination", format!("flat.tiff,flat,1,0,0.01,{value},0,,")),
            ("temperature_c", format!("dark.tiff,dark,0,0,0.01,0,0,{value},")),
            ("timestamp_s", format!("dark.tiff,dark,0,0,0.01,0,0,,{value}")),
        ] {
            p.write("d/dataset.toml", MANIFEST);
            p.write("d/frames.csv", format!("{HEADER}{row}\n"));
            let said = refused(&["noise", &dataset]);
            assert!(said.contains(column) && said.contains("line 2"), "{row}: {said}");
        }
    }
    let columns = ["exposure_s", "illumination", "monitor", "cov_01", "cov_10", "cov_11", "pixels"];
    for column in columns {
        for value in ["nan", "inf", "-inf"] {
            let path = p.write("t.csv", format!("mean_dn,var_dn2,{column}\n10,5,{}\n20,9,{value}\n", "10"));
            let said = refused(&["noise", &path]);
            assert!(said.contains(column) && said.contains("line 3"), "{column} {value}: {said}");
        }
    }
    for text in ["mean_dn,var_dn2,exposure_s\n10,5,-1\n", "mean_dn,var_dn2,illumination\n10,5,-1\n"] {
        assert!(refused(&["noise", &p.write("t.csv", text)]).contains("is -1, and must"));
    }
    let plan =
        |camera: &str, set: &str| format!("format = \"radcam-plan/1\"\n[camera]\n{camera}\n[[set]]\n{set}\n");
    for (text, part) in [
        (plan("", "kind = \"dark\"\nframes = 2\nexposure_s = nan"), "exposure"),
        (plan("", "kind = \"flat\"\nframes = 2\nexposure_s = 0.1\nillumination = nan"), "illumination"),
        (plan("gain_db = nan", "kind = \"dark\"\nframes = 2\nexposure_s = 0.1"), "gain_db"),
        (plan("black_level_dn = inf", "kind = \"dark\"\nframes = 2\nexposure_s = 0.1"), "black_level_dn"),
        (plan("frame_rate_hz = -1.0", "kind = \"dark\"\nframes = 2\nexposure_s = 0.1"), "frame_rate_hz"),
    ] {
        let path = p.write("plan.toml", text);
        let said = refused(&["simulate", "cmos12", "--plan", &path, "-o", &p.text("none")]);
        assert!(said.contains(part) && said.contains("plan.toml"), "{part}: {said}");
    }
}

/// W6: a frame's own description with numbers that cannot be says nothing.
#[test]
fn descriptions_that_cannot_be_say_nothing() {
    use radcam::dataset::tag::FrameTag;
    let tag = |exposure_s: &str| {
        format!(
            "{{\"format\":\"radcam-frame/1\",\"kind\":\"flat\",\"set\":0,\"index\":0,\"exposure_s\":{exposure_s},\
             \"illumination\":1.0,\"camera\":{{\"width\":4,\"height\":4,\"bit_depth\":12}}}}"
        )
    };
    assert!(FrameTag::from_text(&tag("0.01")).is_some());
    for value in ["-0.01", "0", "-0.0"] {
        assert!(FrameTag::from_text(&tag(value)).is_none(), "{value}");
    }
}

/// W6: a frame under two names counts once, whatever the names.
#[test]
#[cfg(unix)]
fn a_frame_under_several_names_is_one() {
    let p = Place::new();
    p.write("in/dark_10ms_0.tif", tiff(1, 64));
    p.write("in/flat_10ms_0.tif", tiff(1, 900));
    std::os::unix::fs::symlink(".", p.path("in/loop")).unwrap();
    std::os::unix::fs::symlink("../in", p.path("in/again")).unwrap();
    std::os::unix::fs::symlink("dark_10ms_0.tif", p.path("in/dark_10ms_1.tif")).unwrap();
    std::os::unix::fs::symlink("circle_10ms.tif", p.path("in/circle_10ms.tif")).unwrap();
    let out = p.text("d");
    let (code, said) = bounded(10, ROOM_MB, &["import", &p.text("in"), "-o", &out, "--yes"]);
    assert!(code == Some(2) && said.contains("circle_10ms.tif"), "{said}");
    fs::remove_file(p.path("in/circle_10ms.tif")).unwrap();
    expect(0, &["import", &p.text("in"), "-o", &out, "--yes"]);
    assert_eq!(fs::read_to_string(p.path("d/frames.csv")).unwrap().lines().count(), 3);
    // Rows of a dataset, and files of a map.
    let dataset = p.dataset("twice");
    std::os::unix::fs::symlink(".", p.path("twice/loop")).unwrap();
    std::os::unix::fs::symlink("dark.tiff", p.path("twice/link.tiff")).unwrap();
    for name in ["./dark.tiff", "loop/dark.tiff", "loop/loop/loop/dark.tiff", "link.tiff"] {
        let rows = format!(
            "dark.tiff,dark,0,0,0.01,0,0,,\n{name},dark,0,1,0.01,0,0,,\nflat.tiff,flat,1,0,0.01,1,0,,\n"
        );
        p.write("twice/frames.csv", HEADER.to_string() + &rows);
        let said = refused(&["noise", &dataset]);
        assert!(said.contains("dark.tiff") && said.contains("twice"), "{name}: {said}");
    }
    let set = |kind: &str, files: &[String]| {
        format!("[[set]]\nkind = \"{kind}\"\nexposure_s = 0.01\nillumination = 0.0\nfiles = {files:?}\n")
    };
    let files = [p.text("in/dark_10ms_0.tif"), p.text("in/loop/dark_10ms_0.tif")];
    let map =
        p.write("map.toml", format!("format = \"radcam-import/1\"\nbit_depth = 12\n{}", set("dark", &files)));
    let said = refused(&["import", "--map", &map, "-o", &p.text("none")]);
    assert!(said.contains("dark_10ms_0.tif") && said.contains("twice"), "{said}");
}

/// W6: a message repeats 80 characters of a value at most.
#[test]
fn long_values_are_not_repeated() {
    let p = Place::new();
    let long = "x".repeat(3_000_000);
    let dataset = p.dataset("d");
    let check = |arguments: &[&str]| {
        let said = soon_refused(arguments);
        let most = said.split(|c| c != 'x').map(str::len).max().unwrap();
        assert!(
            said.len() < 3000 && most <= 80,
            "{arguments:?}: {} characters, {most} of the value",
            said.len()
        );
    };
    for row in [
        format!("{long}.tiff,dark,0,0,0.01,0,0,,"),
        format!("/{long}.tiff,dark,0,0,0.01,0,0,,"),
        format!("a.tiff#{long},dark,0,0,0.01,0,0,,"),
        format!("dark.tiff,{long},0,0,0.01,0,0,,"),
        format!("dark.tiff,dark,{long},0,0.01,0,0,,"),
        format!("dark.tiff,dark,0,0,{long},0,0,,"),
        format!("{long}.tiff,dark,0,0,0.01,0,0,,\n{long}.tiff,dark,0,1,0.01,0,0,,"),
    ] {
        p.write("d/frames.csv", format!("{HEADER}{row}\n"));
        check(&["noise", &dataset]);
    }
    p.write("d/frames.csv", format!("{HEADER}dark.tiff,dark,0,0,0.01,0,0,,\n"));
    for text in [
        format!("format = \"{long}\"\n"),
        MANIFEST.replace("width = 4", &format!("width = \"{long}\"")),
        MANIFEST.replace("width", &long),
        MANIFEST.replace("Mono12", &format!("Bayer{long}")),
        format!("{MANIFEST}features = {{ a = {long} }}\n"),
        format!("{MANIFEST}[import]\nguessed = {long}\n"),
    ] {
        p.write("d/dataset.toml", text);
        check(&["noise", &dataset]);
    }
    check(&["noise", &p.write("t.csv", format!("mean_dn,var_dn2\n1,{long}\n"))]);
    check(&["noise", &p.write("t.csv", format!("mean_dn;var_dn2\n\"1.{long},5\";2\n"))]);
    check(&["noise", &p.write("e.txt", format!("n 12 4 4\n{long} 3\n"))]);
    check(&["noise", &p.write("e.txt", format!("n 12 4 4\nb {long} 3\n"))]);
    for text in [
        format!("format = \"{long}\"\n"),
        format!("{long} = 3\n"),
        radcam_sim::sensors::load("cmos12").unwrap().to_toml().unwrap()
            + &format!("\n[[effect]]\nid = \"{long}\"\n"),
    ] {
        let path = p.write("m.toml", text);
        check(&["model", "show", &path]);
        check(&["simulate", "cmos12", "--plan", &path, "-o", &p.text("none")]);
        check(&["import", "--map", &path, "-o", &p.text("none")]);
    }
    let (good, cal) = p.calibration();
    let mut description = serde_json::to_value(&good.description).unwrap();
    description["estimator"] = long.clone().into();
    description["n1"] = long.into();
    let bytes = described(&tiff(1, 64), &(description.to_string() + "\0"));
    let bad = p.write("bad.tiff", bytes);
    check(&["correct", &bad, &cal, "-o", &p.text("none.tiff")]);
}

/// Names with terminal sequences come out written, not obeyed.
#[test]
#[cfg(unix)]
fn names_do_not_steer_the_terminal() {
    let p = Place::new();
    let name = "a\x1b[2J\u{9b}31m\x07.tif";
    p.write(name, b"II*\0");
    for arguments in [
        &["noise", &p.text(name)][..],
        &["import", &p.text(name), "-o", &p.text("d"), "--yes"],
        &["noise", &p.text("none\x1b[31m")],
    ] {
        let said = refused(arguments);
        assert!(!said.contains(|c: char| c.is_control() && c != '\n'), "{said:?}");
        assert!(said.contains("\\u001b["), "{said:?}");
    }
}
