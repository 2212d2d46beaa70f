//! What the headers of image files say: FITS cards, descriptions of TIFF and PNG, their times.

use super::{Facts, names};
use crate::dataset::image;
use crate::dataset::tag::FrameTag;
use crate::number::seconds as seconds_of;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use tiff::decoder::ifd::Value;
use tiff::tags::Tag;

/// Facts of a file, and how many pages it has.
pub fn facts(path: &Path) -> Result<(Facts, usize), String> {
    use std::io::Read;
    let mut start = Vec::new();
    let file = File::open(path).map_err(|e| e.to_string())?;
    file.take(8).read_to_end(&mut start).map_err(|e| e.to_string())?;
    if start.starts_with(b"SIMPLE") {
        let cards = image::fits_cards(path).map_err(|e| e.to_string())?;
        return Ok((of_words(cards.iter().map(|(k, v)| (k.as_str(), v.as_str())), true), 1));
    }
    if start.starts_with(b"\x89PNG") {
        return Ok((of_png(path).unwrap_or_default(), 1));
    }
    if start.starts_with(b"\x93NUMPY") {
        return Ok((Facts::default(), 1));
    }
    if start.starts_with(image::JPEG) {
        return Err(image::ImageError::NotGrey(image::NO_JPEG.into()).to_string());
    }
    let fault = |e: tiff::TiffError| format!("not a sound TIFF: {}", image::tiff_words(&e));
    let file = BufReader::new(File::open(path).map_err(|e| e.to_string())?);
    let mut decoder = tiff::decoder::Decoder::new(file).map_err(fault)?;
    let text = decoder.get_tag_ascii_string(Tag::ImageDescription).unwrap_or_default();
    let mut found = match FrameTag::from_text(&text) {
        Some(tag) => of_tag(tag),
        None => Facts {
            vendor: decoder.get_tag_ascii_string(Tag::Make).ok(),
            model: decoder.get_tag_ascii_string(Tag::Model).ok(),
            ..of_description(&text)
        },
    };
    let time = || decoder_time(&mut decoder);
    found.time_s = found.time_s.or_else(time);
    found.exposure_s = found.exposure_s.or_else(|| exif_exposure_s(&mut decoder));
    let mut pages = 1;
    while decoder.more_images() {
        decoder.next_image().map_err(fault)?;
        pages += 1;
    }
    // ImageJ keeps stacks of more than 4 GB behind one page.
    let said =
        text.lines().find_map(|l| l.strip_prefix("images=")).and_then(|n| n.trim().parse::<usize>().ok());
    match said.filter(|n| *n > pages && text.starts_with("ImageJ")) {
        Some(n) => Err(format!(
            "an ImageJ stack that says it has {n} images, and {pages} can be read; save it as an image sequence"
        )),
        None => Ok((found, pages)),
    }
}

fn decoder_time<R: std::io::Read + std::io::Seek>(decoder: &mut tiff::decoder::Decoder<R>) -> Option<f64> {
    time_s(&decoder.get_tag_ascii_string(Tag::DateTime).ok()?)
}

/// What a frame that radcam wrote says of itself.
fn of_tag(tag: FrameTag) -> Facts {
    let said = |text: String| Some(text).filter(|t| !t.is_empty());
    Facts {
        kind: Some(tag.kind),
        exposure_s: Some(tag.exposure_s),
        illumination: Some(tag.illumination),
        gain_db: tag.camera.gain_db,
        temperature_c: tag.camera.temperature_c,
        vendor: said(tag.camera.vendor.clone()),
        model: said(tag.camera.model.clone()),
        time_s: tag.timestamp_s,
        set: Some(tag.set),
        differs: Vec::new(),
        camera: Some(tag.camera),
    }
}

/// What the text chunks of a PNG say.
fn of_png(path: &Path) -> Option<Facts> {
    let decoder = png::Decoder::new(BufReader::new(File::open(path).ok()?));
    let reader = decoder.read_info().ok()?;
    let info = reader.info();
    let latin = info.uncompressed_latin1_text.iter().map(|t| (t.keyword.clone(), t.text.clone()));
    let utf = info.utf8_text.iter().filter_map(|t| Some((t.keyword.clone(), t.get_text().ok()?)));
    let texts: Vec<(String, String)> = latin.chain(utf).collect();
    let mut out = of_words(texts.iter().map(|(k, v)| (k.as_str(), v.as_str())), false);
    for (_, text) in texts.iter().filter(|(k, _)| matches!(k.as_str(), "Comment" | "Description")) {
        out = out.or(match FrameTag::from_text(text) {
            Some(tag) => of_tag(tag),
            None => of_description(text),
        });
    }
    Some(out)
}

/// Seconds since 1970 of a date and time as FITS (`2026-11-22T12:00:00.5`) or TIFF (`2026:11:22 12:00:00`) has it; the zone is taken as UTC,
/// for only differences matter.
pub fn time_s(text: &str) -> Option<f64> {
    let text = text.trim_matches(|c: char| c.is_whitespace() || matches!(c, '\'' | '\0' | 'Z'));
    let (date, time) = text.split_once([' ', 'T'])?;
    let moment: jiff::civil::DateTime = format!("{}T{time}", date.replace(':', "-")).parse().ok()?;
    Some(moment.duration_since(jiff::civil::date(1970, 1, 1).at(0, 0, 0, 0)).as_secs_f64())
}

/// ExposureTime of the EXIF directory (EXIF 2.32, tag 33434), s.
fn exif_exposure_s<R: std::io::Read + std::io::Seek>(decoder: &mut tiff::decoder::Decoder<R>) -> Option<f64> {
    let seconds = |value: Value| match value {
        Value::Rational(a, b) if b > 0 => Some(f64::from(a) / f64::from(b)),
        _ => None,
    };
    let exposure = Tag::Unknown(33434);
    if let Some(found) = decoder.find_tag(exposure).ok().flatten() {
        return seconds(found);
    }
    let at = decoder.find_tag(Tag::ExifDirectory).ok().flatten()?.into_ifd_pointer().ok()?;
    let directory = decoder.read_directory(at).ok()?;
    seconds(decoder.read_directory_tags(&directory).find_tag(exposure).ok().flatten()?)
}

/// `key = value` or `key: value`, one on a line.
fn of_description(text: &str) -> Facts {
    let pairs = text.lines().filter_map(|line| line.split_once(['=', ':']));
    of_words(pairs.map(|(k, v)| (k.trim(), v.trim())), false)
}

/// Facts of named values. A unit in the name or behind the value counts; FITS times are seconds (FITS standard 4.0, section 4.3).
/// Without a unit a number counts as seconds in FITS, and where its name says so; else nobody knows.
fn of_words<'a>(pairs: impl Iterator<Item = (&'a str, &'a str)>, fits: bool) -> Facts {
    let mut out = Facts::default();
    for (key, value) in pairs {
        let value = value.trim().trim_matches('\'').trim();
        let key = key.to_lowercase();
        let end = value.find(|c: char| !(c.is_ascii_digit() || "+-.eE".contains(c))).unwrap_or(value.len());
        let number = value[..end].parse::<f64>().ok().filter(|v| v.is_finite());
        match key.as_str() {
            "exptime" | "exposure" | "exposuretime" | "exposure_s" | "exposure_time" | "xposure" => {
                let unit = value[end..].trim();
                let seconds = fits || key == "exposure_s";
                let unit_s = seconds_of(unit).or_else(|| (unit.is_empty() && seconds).then_some(1.0));
                out.exposure_s = number.zip(unit_s).map(|(n, s)| n * s).or(out.exposure_s);
            }
            "exposure_ms" => out.exposure_s = number.map(|n| 1e-3 * n).or(out.exposure_s),
            "exposure_us" => out.exposure_s = number.map(|n| 1e-6 * n).or(out.exposure_s),
            "gain_db" => out.gain_db = number.or(out.gain_db),
            "ccd-temp" | "temperature_c" | "det-temp" => out.temperature_c = number.or(out.temperature_c),
            "imagetyp" | "obstype" | "kind" => {
                out.kind = value.split(|c: char| !c.is_alphabetic()).find_map(names::kind).or(out.kind);
            }
            "gain" | "offset" | "xbinning" | "ybinning" | "readoutm" if fits => {
                out.differs.push((key.to_uppercase(), value.to_string()));
            }
            "instrume" | "camera" => out.model = Some(value.to_string()),
            "date-obs" | "datetime" | "creation time" => out.time_s = time_s(value).or(out.time_s),
            "illumination" => out.illumination = number.or(out.illumination),
            _ => {}
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Kind;

    #[test]
    fn times_are_read() {
        let of = |text: &str| time_s(text).unwrap();
        assert_eq!(of("'2026-11-22T12:00:01.25'") - of("2026:11:22 12:00:00"), 1.25);
        assert_eq!(of("1970-01-02T00:00:00"), 86_400.0);
        for text in ["", "yesterday", "2026-13-01T00:00:00", "12:00:00"] {
            assert_eq!(time_s(text), None, "{text}");
        }
    }

    #[test]
    fn descriptions_say_what_they_say() {
        let found = of_description("ImageJ=1.53t\nimages=3\nexposure_ms=12.5\nkind: dark frame");
        assert_eq!((found.exposure_s, found.kind), (Some(0.0125), Some(Kind::Dark)));
        assert_eq!(of_description("Exposure = 20 ms").exposure_s, Some(0.02));
        // Seconds, milliseconds or microseconds?
        assert_eq!(of_description("ExposureTime = 5000").exposure_s, None);
        assert_eq!(of_description("Exposure: 20").exposure_s, None);
        let cards = [("EXPTIME", "0.25"), ("IMAGETYP", "'Bias Frame'"), ("CCD-TEMP", "-10.0")];
        let found = of_words(cards.into_iter(), true);
        assert_eq!(
            (found.exposure_s, found.kind, found.temperature_c),
            (Some(0.25), Some(Kind::Dark), Some(-10.0))
        );
    }
}
