//! Headers of image files: FITS cards, descriptions of TIFF and PNG, and times.

use super::words::{self, Said, Writer, of_description};
use super::{Facts, cards, ome, stacks};
use crate::dataset::image;
use crate::dataset::tag::FrameTag;
use std::collections::BTreeMap;
use std::path::Path;
use tiff::decoder::ifd::Value;
use tiff::tags::Tag;

/// TIFF tag of Micro-Manager's JSON.
const MICRO_MANAGER: u16 = 51_123;

/// Reads the facts of a file and its number of pages.
pub fn facts(path: &Path) -> Result<(Facts, usize), String> {
    let start = crate::input::start(path, 8).map_err(|e| e.to_string())?;
    if image::begins_as_fits(&start) {
        return Ok((words::of_cards(cards::read(path)?), 1));
    }
    if start.starts_with(b"\x89PNG") {
        return Ok((of_png(path).unwrap_or_default(), 1));
    }
    if start.starts_with(b"\x93NUMPY") || start.starts_with(image::bmp_file::BMP) {
        return Ok((Facts::default(), 1));
    }
    if start.starts_with(image::JPEG) {
        return Err(image::ImageError::NotGrey(image::NO_JPEG.into()).to_string());
    }
    if start.starts_with(image::HDF5) {
        let images = image::Images::open(path).map_err(|e| e.to_string())?;
        let told = stacks::told(&images.stacks())?.facts;
        let pages = told.len();
        return Ok((told.into_values().next().unwrap_or_default(), pages));
    }
    let directories = image::tiff_directories(path).map_err(|e| e.to_string())?;
    let mut decoder = directories.decoder(path, 0).map_err(|e| e.to_string())?;
    let text = decoder.get_tag_ascii_string(Tag::ImageDescription).unwrap_or_default();
    let found = of_directory(&mut decoder, directories.first_description(path, 0));
    let pages = image::Images::open(path).map_err(|e| e.to_string())?.frames().len();
    // ImageJ stores stacks of more than 4 GB behind one page.
    let said =
        text.lines().find_map(|l| l.strip_prefix("images=")).and_then(|n| n.trim().parse::<usize>().ok());
    match said.filter(|n| *n > pages && text.starts_with("ImageJ")) {
        Some(n) => Err(format!(
            "an ImageJ stack that says it has {n} images, and {pages} can be read; save it as an image sequence"
        )),
        None => Ok((found, pages)),
    }
}

/// Reads facts from the tags of a TIFF directory. `first`: a description before the one that decoders
/// return.
fn of_directory<R: std::io::Read + std::io::Seek>(
    decoder: &mut tiff::decoder::Decoder<R>,
    first: Option<String>,
) -> Facts {
    let text = decoder.get_tag_ascii_string(Tag::ImageDescription).unwrap_or_default();
    let mut found = match FrameTag::from_text(&text) {
        Some(tag) => of_tag(tag),
        None => {
            let tags = Facts {
                vendor: decoder.get_tag_ascii_string(Tag::Make).ok(),
                model: decoder.get_tag_ascii_string(Tag::Model).ok(),
                ..Facts::default()
            };
            let of_text =
                |text: &str| if ome::is_ome(text) { ome::facts(text) } else { of_description(text) };
            let first = first.map(|text| of_text(&text)).unwrap_or_default();
            tags.or(first).or(of_text(&text))
        }
    };
    // Frames that viewers rotate or flip have another orientation.
    let orientation = decoder.find_tag(Tag::Orientation).ok().flatten().and_then(|v| v.into_u16().ok());
    if let Some(turned) = orientation.filter(|o| (2..=8).contains(o)) {
        found.set_feature(ORIENTATION, &turned.to_string(), ORIENTATION);
    }
    // Micro-Manager stores the settings of every page in its own tag.
    if let Ok(json) = decoder.get_tag_ascii_string(Tag::Unknown(MICRO_MANAGER)) {
        found = found.or(of_description(&json));
    }
    found.time_s = found.time_s.or_else(|| decoder_time(decoder));
    exif(decoder, &mut found);
    found
}

/// Reads facts of TIFF pages whose directories differ; empty for other files, and for stacks described
/// by their first directory.
pub fn of_pages(path: &Path, pages: &[usize]) -> BTreeMap<usize, Facts> {
    let empty = BTreeMap::new;
    let (Some(second), Ok(directories)) = (pages.get(1), image::tiff_directories(path)) else {
        return empty();
    };
    if directories.is_contiguous() {
        return empty();
    }
    let said = |page: usize| {
        let mut decoder = directories.decoder(path, page).ok()?;
        let texts = [Tag::ImageDescription, Tag::Unknown(MICRO_MANAGER), Tag::ExifDirectory];
        let says = texts.into_iter().any(|tag| matches!(decoder.find_tag(tag), Ok(Some(_))));
        says.then(|| of_directory(&mut decoder, directories.first_description(path, page)))
    };
    let Some(_) = said(*second) else { return empty() };
    pages.iter().filter_map(|&page| Some((page, said(page)?))).collect()
}

fn decoder_time<R: std::io::Read + std::io::Seek>(decoder: &mut tiff::decoder::Decoder<R>) -> Option<f64> {
    time_s(&decoder.get_tag_ascii_string(Tag::DateTime).ok()?)
}

/// Setting for frames whose first pixel is not at the upper left (TIFF 6.0, Orientation); 1 if not
/// stated.
pub(super) const ORIENTATION: &str = "Orientation";

/// Source name of metadata written by radcam into its own frames.
const SELF: &str = "radcam's description";

/// Converts the metadata of a frame written by radcam.
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
        mosaic: words::pattern(&tag.camera.pixel_format),
        camera: Some(tag.camera),
        unit_stated: true,
        from: [("kind", SELF), ("exposure_s", SELF), ("illumination", SELF)]
            .map(|(key, from)| (key.to_string(), from.to_string()))
            .into(),
        ..Facts::default()
    }
}

/// Reads facts from the text chunks of a PNG.
fn of_png(path: &Path) -> Option<Facts> {
    let reader = image::png_file::decoder(path).ok()?.read_info().ok()?;
    let info = reader.info();
    let latin = info.uncompressed_latin1_text.iter().map(|t| (t.keyword.clone(), t.text.clone()));
    // Compressed texts are not decompressed, as their size is not known in advance.
    let utf = info
        .utf8_text
        .iter()
        .filter(|t| !t.compressed)
        .filter_map(|t| Some((t.keyword.clone(), t.get_text().ok()?)));
    let texts: Vec<(String, String)> = latin.chain(utf).collect();
    let mut out = words::facts(texts.iter().map(|(k, v)| Said::new(k, v)).collect(), Writer::Lines);
    for (_, text) in texts.iter().filter(|(k, _)| matches!(k.as_str(), "Comment" | "Description")) {
        out = out.or(match FrameTag::from_text(text) {
            Some(tag) => of_tag(tag),
            None => of_description(text),
        });
    }
    Some(out)
}

/// Returns seconds since 1970 of a date and time in FITS (`2026-11-22T12:00:00.5`) or TIFF (`2026:11:22
/// 12:00:00`) form; the time zone is taken as UTC, as only differences matter.
pub fn time_s(text: &str) -> Option<f64> {
    let text = text.trim_matches(|c: char| c.is_whitespace() || matches!(c, '\'' | '\0' | 'Z'));
    let (date, time) = text.split_once([' ', 'T'])?;
    let moment: jiff::civil::DateTime = format!("{}T{time}", date.replace(':', "-")).parse().ok()?;
    Some(moment.duration_since(jiff::civil::date(1970, 1, 1).at(0, 0, 0, 0)).as_secs_f64())
}

/// Reads ExposureTime and ISO of the EXIF directory (EXIF 2.32, tags 33434 and 34855).
fn exif<R: std::io::Read + std::io::Seek>(decoder: &mut tiff::decoder::Decoder<R>, found: &mut Facts) {
    let mut of = |number: u16| {
        let tag = Tag::Unknown(number);
        if let Some(value) = decoder.find_tag(tag).ok().flatten() {
            return Some(value);
        }
        let at = decoder.find_tag(Tag::ExifDirectory).ok().flatten()?.into_ifd_pointer().ok()?;
        let directory = decoder.read_directory(at).ok()?;
        decoder.read_directory_tags(&directory).find_tag(tag).ok().flatten()
    };
    if let Some(Value::Rational(a, b)) = of(33434)
        && a > 0
        && b > 0
    {
        let exif = Facts {
            exposure_s: Some(f64::from(a) / f64::from(b)),
            unit_stated: true,
            from: [("exposure_s".to_string(), "EXIF ExposureTime".to_string())].into(),
            ..Facts::default()
        };
        *found = std::mem::take(found).or(exif);
    }
    if let Some(iso) = of(34855).and_then(|v| v.into_u32().ok()).filter(|iso| *iso > 0) {
        found.set_feature("ISO", &iso.to_string(), "EXIF ISO");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read() {
        let of = |text: &str| time_s(text).unwrap();
        assert_eq!(of("'2026-11-22T12:00:01.25'") - of("2026:11:22 12:00:00"), 1.25);
        assert_eq!(of("1970-01-02T00:00:00"), 86_400.0);
        for text in ["", "yesterday", "2026-13-01T00:00:00", "12:00:00"] {
            assert_eq!(time_s(text), None, "{text}");
        }
    }
}
