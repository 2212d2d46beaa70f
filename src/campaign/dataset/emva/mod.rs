//! Reader of the descriptor file of the EMVA 1288 reference tool, so that its datasets can be used
//! unchanged.
//!
//! Lines: `v VERSION` (any), `n BITS WIDTH HEIGHT`; `b EXPOSURE PHOTONS` and `d EXPOSURE` begin a set
//! (exposure in nanoseconds, or with a unit: `10ms`), and so does `dc EXPOSURE`, darks for the dark
//! current only; `i FILE` adds a frame to the set; `#` begins a comment. Photons are per pixel and
//! exposure; they are converted to photons per pixel per second. File names may contain backslashes.

mod write;

pub use write::{DESCRIPTOR, write_descriptor};

use super::{BenchInfo, CameraInfo, Dataset, DatasetError, FrameRow, Kind, Manifest};
use crate::input::echo;
use crate::number::seconds;
use std::path::Path;

/// Reads a descriptor.
pub fn open(path: &Path) -> Result<Dataset, DatasetError> {
    let text = super::text(path)?;
    let (camera, rows) =
        parse(&text).map_err(|(line, message)| DatasetError::Row { path: path.into(), line, message })?;
    let mut manifest = Manifest::new(camera);
    manifest.bench = Some(BenchInfo { illumination_unit: "photons/px/s".into(), ..Default::default() });
    let root = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Dataset::new(root.into(), manifest, rows, path)
}

/// Maximum side of a frame. A named choice, above the side of any sensor: it rejects implausible
/// headers.
const LARGEST_SIDE_PX: usize = 65_535;

type Parsed = (CameraInfo, Vec<(u64, FrameRow)>);

fn parse(text: &str) -> Result<Parsed, (u64, String)> {
    let mut camera = None;
    let mut rows: Vec<(u64, FrameRow)> = Vec::new();
    let mut current: Option<FrameRow> = None;
    let mut next_set = 0;
    for (i, line) in text.lines().enumerate() {
        let number = i as u64 + 1;
        let fault = |message: String| (number, message);
        let line = line.split('#').next().unwrap_or("");
        let words: Vec<&str> = line.split_whitespace().collect();
        let float = |word: &str| {
            let value: f64 = word
                .replace(',', ".")
                .parse()
                .map_err(|_| fault(format!("\"{}\" is not a number", echo(word))))?;
            Ok(value)
        };
        // Nanoseconds, as in the standard's tool, unless the number has a unit.
        let exposure = |word: &str| {
            let end = word.find(|c: char| c.is_alphabetic() && !matches!(c, 'e' | 'E')).unwrap_or(word.len());
            let unit_s = if end == word.len() { Some(1e-9) } else { seconds(&word[end..]) };
            let unit_s = unit_s.ok_or_else(|| fault(format!("\"{}\": write ns, us, ms or s", echo(word))))?;
            Ok(float(&word[..end])? * unit_s)
        };
        // A bias frame has no exposure; one nanosecond stands for zero.
        let mut begin = |kind, exposure_s: f64, photons: f64| {
            let exposure_s = if exposure_s == 0.0 { 1e-9 } else { exposure_s };
            let kind = if photons == 0.0 { Kind::Dark } else { kind };
            current = Some(FrameRow {
                file: String::new(),
                kind,
                set: next_set,
                index: 0,
                exposure_s,
                illumination: photons / exposure_s,
                configuration: 0,
                temperature_c: None,
                timestamp_s: None,
            });
            next_set += 1;
        };
        match words.as_slice() {
            [] | ["v", ..] => {}
            ["n", bits, width, height] => {
                let whole = |word: &str| {
                    word.parse::<usize>()
                        .map_err(|_| fault(format!("\"{}\" is not a whole number", echo(word))))
                };
                let bit_depth = whole(bits)?;
                if !(1..=16).contains(&bit_depth) {
                    return Err(fault(format!("{bit_depth} bits; frames have 1 to 16")));
                }
                let side = |word: &str| {
                    let side = whole(word)?;
                    if (1..=LARGEST_SIDE_PX).contains(&side) {
                        Ok(side)
                    } else {
                        Err(fault(format!("{side} px; frames have sides of 1 to {LARGEST_SIDE_PX} px")))
                    }
                };
                camera = Some(CameraInfo {
                    width: side(width)?,
                    height: side(height)?,
                    bit_depth: bit_depth as u8,
                    pixel_format: format!("Mono{bit_depth}"),
                    ..Default::default()
                });
            }
            ["b", exposed, photons] => begin(Kind::Flat, exposure(exposed)?, float(photons)?),
            ["d" | "dc", exposed] => begin(Kind::Dark, exposure(exposed)?, 0.0),
            ["i", _, ..] => {
                let file = line.trim_start().trim_start_matches('i').trim();
                let row =
                    current.as_mut().ok_or_else(|| fault("a frame stands before any b or d line".into()))?;
                row.file = file.replace('\\', "/");
                rows.push((number, row.clone()));
                row.index += 1;
            }
            [..] if ["mean", "var"].iter().all(|w| line.to_lowercase().contains(w)) => {
                return Err(fault(format!(
                    "the columns are called \"{}\": call them mean_dn and var_dn2 (mean above the black level in DN, variance in DN^2)",
                    echo(line)
                )));
            }
            [word, ..] => {
                return Err(fault(format!(
                    "\"{}\" begins no line of an EMVA 1288 descriptor (v, n, b, d, dc, i), and the file is no table \
                     with mean_dn and var_dn2 either",
                    echo(word)
                )));
            }
        }
    }
    let camera = camera.ok_or_else(|| (1, "no line \"n BITS WIDTH HEIGHT\"; not a descriptor".into()))?;
    Ok((camera, rows))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposures_of_any_unit_and_none_are_read() {
        let text = "v 4.0\nn 12 4 3\nd 0\ni a.tif\nd 10ms\ni b.tif\nb 2,5e-3s 100\ni c.tif\nb 20us 0\ni d.tif\nb 500 9\ni e.tif\n";
        let (_, rows) = parse(text).unwrap();
        let said: Vec<_> = rows.iter().map(|(_, r)| (r.kind, (r.exposure_s * 1e9).round())).collect();
        let wanted = [
            (Kind::Dark, 1.0),
            (Kind::Dark, 1e7),
            (Kind::Flat, 2.5e6),
            (Kind::Dark, 2e4),
            (Kind::Flat, 500.0),
        ];
        assert_eq!(said, wanted);
        assert!((rows[2].1.illumination - 100.0 / 2.5e-3).abs() < 1e-6);
        assert!(parse("n 12 4 3\nd 10m\n").unwrap_err().1.contains("write ns, us, ms or s"));
    }

    #[test]
    fn a_descriptor_is_read() {
        let text = "v 3.0\nn 12 640 480\n# darks\nd 1000000.0\ni images\\d0.png\ni images\\d1.png\n\
                    b 1000000.0 250,5\ni images\\b0.png\n";
        let (camera, rows) = parse(text).unwrap();
        assert_eq!((camera.width, camera.height, camera.bit_depth), (640, 480, 12));
        assert_eq!((rows[1].1.file.as_str(), rows[1].1.index), ("images/d1.png", 1));
        let bright = &rows[2].1;
        assert_eq!((bright.kind, bright.set, bright.index), (Kind::Flat, 1, 0));
        assert!((bright.illumination * bright.exposure_s - 250.5).abs() < 1e-9);
    }

    #[test]
    fn faults_are_named_by_line() {
        for (text, line, part) in [
            ("v 3\nn 12 640\n", 2, "begins no line"),
            ("n 12 640 480\ni a.png\n", 2, "before any"),
            ("n 33 640 480\n", 1, "33 bits"),
            ("n 12 4000000000 480\n", 1, "4000000000 px"),
            ("n 12 640 0\n", 1, "0 px"),
            ("n 12 640 480\nb fast 3\n", 2, "fast"),
            ("v 3\n", 1, "not a descriptor"),
        ] {
            let (found, message) = parse(text).unwrap_err();
            assert!(found == line && message.contains(part), "{found}: {message}");
        }
    }
}
