//! Everything that reads what others wrote, each as a function of bytes that must not panic, hang or take
//! memory that a header claims.

use radcam::calibrate::file::Calibration;
use radcam::dataset::{Dataset, Manifest, image, table::Table};
use radcam::pixel_format::PixelFormat;
use radcam::plan::Plan;
use radcam::sim::Model;
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

/// A name, and what it does.
pub type Target = (&'static str, fn(&[u8]));

/// Every target.
pub const TARGETS: &[Target] = &[
    ("bmp", |b| picture(&file("bmp", b))),
    ("calibration", |b| drop(Calibration::read(&file("tiff", b)))),
    ("descriptor", |b| drop(Dataset::open(&file("txt", b)))),
    ("fits", |b| picture(&file("fits", b))),
    ("flat-field", |b| drop(radcam::flat_field::FlatField::from_bytes(b))),
    ("formula", formula),
    ("frames", frames),
    ("hdf5", |b| picture(&file("h5", b))),
    ("manifest", |b| drop(Manifest::from_toml(&text(b)))),
    ("map", |b| drop(radcam::import::Map::from_toml(&text(b)))),
    ("model", model),
    ("name", |b| drop(radcam::import::names::facts(&text(b), &text(b)))),
    ("npy", |b| drop(radcam::import::survey(&[file("npy", b)], &Default::default(), |_, _| true))),
    ("plan", plan),
    ("png", |b| picture(&file("png", b))),
    ("request", request),
    ("statistics", statistics),
    ("table", |b| drop(Table::open(&file("csv", b)))),
    ("tiff", |b| picture(&file("tiff", b))),
    ("unpack", unpack),
];

/// A file of statistics, and what is computed of it; its frames are nowhere.
fn statistics(bytes: &[u8]) {
    if let Ok(dataset) = radcam::reduction::from_cbor(bytes, Path::new("input.stats")) {
        let source = radcam::source::Source::Frames(Box::new(dataset));
        let _ = (source.noise(), source.observations());
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A folder in memory, of this thread of this process.
fn folder() -> &'static Path {
    thread_local! {
        static FOLDER: &'static Path = {
            let root = if Path::new("/dev/shm").is_dir() { PathBuf::from("/dev/shm") } else { std::env::temp_dir() };
            let thread = format!("{:?}", std::thread::current().id());
            let digits: String = thread.chars().filter(char::is_ascii_digit).collect();
            let path = root.join(format!("radcam-fuzz-{}-{digits}", std::process::id()));
            std::fs::create_dir_all(path.join("frames")).expect("a folder in memory");
            Box::leak(path.into_boxed_path())
        };
    }
    FOLDER.with(|f| *f)
}

fn file(kind: &str, bytes: &[u8]) -> PathBuf {
    let path = folder().join(format!("input.{kind}"));
    std::fs::write(&path, bytes).expect("memory");
    path
}

fn picture(path: &Path) {
    let _ = image::read(path, 0);
    let _ = image::read_single(path);
    let _ = image::stored_bits(path);
    let _ = radcam::import::survey(&[path.to_path_buf()], &Default::default(), |_, _| true);
}

fn frames(bytes: &[u8]) {
    const MANIFEST: &str = "format = \"radcam-dataset/1\"\n[camera]\nvendor = \"\"\nmodel = \"\"\nserial = \"\"\nwidth = 8\nheight = 6\n\
                            bit_depth = 12\npixel_format = \"Mono12\"\n";
    let root = folder();
    std::fs::write(root.join("dataset.toml"), MANIFEST).expect("memory");
    std::fs::write(root.join("frames.csv"), bytes).expect("memory");
    if let Ok(dataset) = Dataset::open(root) {
        for row in dataset.rows().iter().take(4) {
            let _ = dataset.read(row);
        }
    }
}

fn model(bytes: &[u8]) {
    if let Ok(model) = Model::from_toml(&text(bytes)) {
        let _ = model.to_toml();
    }
}

fn plan(bytes: &[u8]) {
    if let Ok(plan) = Plan::from_toml(&text(bytes)) {
        let _ = (plan.to_toml(), plan.frames(), plan.seconds(Some(10.0)));
    }
}

fn formula(bytes: &[u8]) {
    let text = text(bytes);
    let map = |name: &str, value: f64| BTreeMap::from([(name.to_string(), value)]);
    for target in ["mean", "variance", "row"] {
        let effect = radcam::sim::EffectValues {
            id: "custom".into(),
            parameters: map("a", 0.5),
            bounds: BTreeMap::from([("a".to_string(), [0.0, 1.0])]),
            formulas: BTreeMap::from([(target.to_string(), text.clone())]),
            ..Default::default()
        };
        let _ = effect.check();
    }
}

/// The first byte chooses a format, the second how many pixels are asked for.
fn unpack(bytes: &[u8]) {
    let [format, pixels, rest @ ..] = bytes else { return };
    let all: Vec<PixelFormat> = PixelFormat::all().collect();
    let format = all[usize::from(*format) % all.len()];
    let mut dn = vec![0; usize::from(*pixels)];
    let _ = format.unpack(rest, &mut dn);
    let whole = rest.len() * 8 / format.bits_per_pixel();
    let mut dn = vec![0; whole];
    let mut again = rest[..format.payload(whole).min(rest.len())].to_vec();
    if format.unpack(&again, &mut dn).is_ok() {
        assert!(dn.iter().all(|d| *d <= format.full_scale_dn()) || format.bits_per_pixel() == 16);
        let _ = format.pack(&dn, &mut again);
    }
}

/// A request to the workbench: its head and body as they are, behind a method and the token.
#[cfg(feature = "cli")]
fn request(bytes: &[u8]) {
    use radcam::workbench::{Options, Workbench};
    static SERVER: OnceLock<Option<(String, String)>> = OnceLock::new();
    let server = SERVER.get_or_init(|| {
        let bench = Workbench::open(Options {
            dataset: None,
            others: Vec::new(),
            plane: None,
            history: None,
            camera: None,
            stream: Default::default(),
            effects: Vec::new(),
            address: "127.0.0.1:0".parse().ok()?,
        })
        .ok()?;
        let url = bench.url();
        let (address, token) = url.strip_prefix("http://")?.split_once("/?token=")?;
        let known = (address.to_string(), token.to_string());
        std::thread::spawn(|| bench.serve(Box::leak(Box::default())));
        Some(known)
    });
    let Some((address, token)) = server else { return };
    let Ok(mut stream) = std::net::TcpStream::connect(address) else { return };
    let _ = stream.set_read_timeout(Some(Duration::from_secs(5)));
    let [method, rest @ ..] = bytes else { return };
    let method = if method % 2 == 0 { "GET" } else { "POST" };
    let (path, body) =
        rest.iter().position(|b| *b == b'\n').map_or((rest, &[][..]), |at| (&rest[..at], &rest[at + 1..]));
    let path: String = path.iter().map(|b| if b.is_ascii_graphic() { char::from(*b) } else { '_' }).collect();
    let port = address.rsplit(':').next().unwrap_or_default();
    let head = format!(
        "{method} /{path} HTTP/1.1\r\nHost: {address}\r\nCookie: radcam-{port}={token}\r\nOrigin: http://{address}\r\n\
         Content-Type: application/x-www-form-urlencoded\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    if stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(body)).is_ok() {
        // Streams of events do not end; the first bytes are enough.
        let mut answer = [0; 4096];
        let n = stream.read(&mut answer).unwrap_or(0);
        assert!(n == 0 || answer.starts_with(b"HTTP/1.1 "), "no answer");
        assert!(!answer.starts_with(b"HTTP/1.1 500"), "{}", String::from_utf8_lossy(&answer[..n]));
    }
}

#[cfg(not(feature = "cli"))]
fn request(_: &[u8]) {}
