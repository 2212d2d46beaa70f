//! FITS reader: images, cubes, a single image extension, gzipped files, tile compression (FITS standard
//! 4.0).
//!
//! docs/decisions/0006-our-own-fits-reader.md gives the reasons for an own reader.

use super::fits_tiles::Tiles;
use super::{Cards, FITS_RECORD, ImageError, Values, array, cards_of};
use flate2::read::MultiGzDecoder;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Magic bytes of a gzipped file (RFC 1952).
pub(super) const GZIP: &[u8] = b"\x1f\x8b";

/// FITS file with parsed headers.
#[derive(Debug, Clone)]
pub(super) struct Fits {
    data: Data,
    image: Image,
    /// Header of the image, followed by the primary header if the image is in an extension.
    pub(super) header: Vec<u8>,
}

#[derive(Debug, Clone)]
enum Data {
    File(PathBuf),
    Unpacked(Arc<Vec<u8>>),
}

pub(super) trait Bytes: Read + Seek {}
impl<T: Read + Seek> Bytes for T {}

/// Layout and coding of the image data.
#[derive(Debug, Clone)]
struct Image {
    at: u64,
    width: usize,
    height: usize,
    planes: usize,
    coding: Coding,
    tiles: Option<Tiles>,
}

/// Coding of the stored numbers (sections 4.4.2.5 and 5.3).
#[derive(Debug, Clone, Copy)]
pub(super) struct Coding {
    pub(super) bits: i64,
    scale: f64,
    zero: f64,
    blank: Option<f64>,
}

impl Coding {
    pub(super) fn bytes_each(&self) -> usize {
        self.bits.unsigned_abs() as usize / 8
    }

    /// Decodes and scales one number; NaN if the file marks it as undefined.
    pub(super) fn value(&self, b: &[u8]) -> f64 {
        let raw = match (self.bits, b) {
            (8, &[a]) => f64::from(a),
            (16, &[a, b]) => i16::from_be_bytes([a, b]).into(),
            (32, &[a, b, c, d]) => i32::from_be_bytes([a, b, c, d]).into(),
            (-32, &[a, b, c, d]) => f32::from_be_bytes([a, b, c, d]).into(),
            (-64, b) => b.try_into().map_or(f64::NAN, f64::from_be_bytes),
            _ => f64::NAN,
        };
        self.scaled(raw)
    }

    pub(super) fn scaled(&self, raw: f64) -> f64 {
        if self.blank == Some(raw) { f64::NAN } else { self.scale * raw + self.zero }
    }
}

/// Returns the number of a card, or the default.
pub(super) fn number(cards: &Cards, keyword: &str, default: Option<f64>) -> Result<f64, ImageError> {
    match cards.get(keyword) {
        Some(text) => text.parse::<f64>().map_err(|_| ImageError::Fits(format!("{keyword} is {text}"))),
        None => default.ok_or_else(|| ImageError::Fits(format!("the header has no {keyword}"))),
    }
}

/// Returns the text of a card without its quotes.
pub(super) fn text<'a>(cards: &'a Cards, keyword: &str) -> Option<&'a str> {
    cards.get(keyword).map(|v| v.trim().trim_matches('\'').trim())
}

/// Reads the axes of an image, counted by `NAXIS` or `ZNAXIS`.
fn axes(cards: &Cards, prefix: &str) -> Result<Vec<usize>, ImageError> {
    let count = number(cards, &format!("{prefix}NAXIS"), None)?;
    if count.fract() != 0.0 || !(0.0..=9.0).contains(&count) {
        return Err(ImageError::Fits(format!("{prefix}NAXIS is {count}")));
    }
    let axis = |k: usize| {
        let keyword = format!("{prefix}NAXIS{k}");
        let n = number(cards, &keyword, None)?;
        let fits = n.fract() == 0.0 && (0.0..=1e9).contains(&n);
        if fits { Ok(n as usize) } else { Err(ImageError::Fits(format!("{keyword} is {n}"))) }
    };
    (1..=count as usize).map(axis).collect()
}

/// Returns the data size of a header in bytes (equation 2), or `None` if it claims an impossible size.
fn data_size(cards: &Cards, axes: &[usize]) -> Result<Option<u64>, ImageError> {
    let bits = number(cards, "BITPIX", None)?.abs();
    let (parameters, groups) = (number(cards, "PCOUNT", Some(0.0))?, number(cards, "GCOUNT", Some(1.0))?);
    let pixels = if axes.is_empty() { 0.0 } else { axes.iter().map(|n| *n as f64).product() };
    let size = bits / 8.0 * groups * (parameters + pixels);
    Ok((0.0..1e15).contains(&size).then_some(size as u64))
}

impl Fits {
    pub(super) fn open(path: &Path) -> Result<Self, ImageError> {
        let mut file = crate::input::open(path)?;
        let mut start = [0u8; 2];
        let packed = file.read_exact(&mut start).is_ok() && start == *GZIP;
        file.rewind()?;
        if !packed {
            return Self::of(Data::File(path.into()), &mut file);
        }
        let size = file.metadata()?.len();
        let most = crate::input::max_unpacked_bytes(size);
        let mut bytes = Vec::new();
        let unpacked = MultiGzDecoder::new(file).take(most).read_to_end(&mut bytes);
        unpacked.map_err(|e| ImageError::Fits(format!("damaged or cut short as a gzipped file: {e}")))?;
        if !bytes.starts_with(b"SIMPLE") {
            return Err(ImageError::NotGrey("a gzipped file that is no FITS: unpack it".into()));
        }
        let bytes = Arc::new(bytes);
        let out = Self::of(Data::Unpacked(bytes.clone()), &mut Cursor::new(bytes.as_slice()))?;
        must_be_image(out.image.width, out.image.height, size)?;
        Ok(out)
    }

    #[cfg(test)]
    pub(super) fn of_bytes(bytes: &[u8]) -> Result<Self, ImageError> {
        let bytes = Arc::new(bytes.to_vec());
        Self::of(Data::Unpacked(bytes.clone()), &mut Cursor::new(bytes.as_slice()))
    }

    /// Walks the headers to the image: the primary image, or else the only image extension.
    fn of(data: Data, file: &mut dyn Bytes) -> Result<Self, ImageError> {
        let size = file.seek(SeekFrom::End(0))?;
        let first = header(file, 0)?;
        let (cards, end) = cards_of(&first)?;
        let own = axes(&cards, "")?;
        if !own.is_empty() && own.iter().all(|n| *n > 0) {
            let image = image(&cards, &own, end.next_multiple_of(FITS_RECORD) as u64, size)?;
            return Ok(Self { data, image, header: first });
        }
        let mut at = end.next_multiple_of(FITS_RECORD) as u64
            + data_size(&cards, &own)?.unwrap_or(0).next_multiple_of(FITS_RECORD as u64);
        let mut found: Option<(Image, Vec<u8>)> = None;
        let mut tables = 0;
        while at < size {
            // Anything may follow the last extension (section 3.5).
            let Ok(bytes) = header(file, at) else { break };
            if !bytes.starts_with(b"XTENSION") {
                break;
            }
            let (cards, end) = cards_of(&bytes)?;
            let own = axes(&cards, "")?;
            let data_at = at + end.next_multiple_of(FITS_RECORD) as u64;
            let compressed = text(&cards, "ZIMAGE") == Some("T");
            let image = if compressed {
                Some(tiled(&cards, &own, data_at, size)?)
            } else if text(&cards, "XTENSION") == Some("IMAGE") && own.len() >= 2 && !own.contains(&0) {
                Some(image(&cards, &own, data_at, size)?)
            } else {
                tables += usize::from(!own.is_empty());
                None
            };
            if let Some(image) = image {
                if found.is_some() {
                    return Err(ImageError::NotGrey(
                        "a FITS with several image extensions: frames, or amplifiers of one? Save each as a file".into(),
                    ));
                }
                found = Some((image, bytes));
            }
            let Some(length) = data_size(&cards, &own)? else { break };
            at = data_at.saturating_add(length.next_multiple_of(FITS_RECORD as u64));
        }
        let Some((image, mut header)) = found else {
            let tables = if tables > 0 { " but tables" } else { "" };
            return Err(ImageError::NotGrey(format!("a FITS without an image: it has nothing{tables}")));
        };
        // END is removed so that the primary header can be appended.
        let (_, end) = cards_of(&header)?;
        header.truncate(end_card(&header, end));
        header.extend(first);
        Ok(Self { data, image, header })
    }

    /// Returns the number of frames: planes of a cube.
    pub(super) fn pages(&self) -> usize {
        self.image.planes
    }

    /// Returns true if the primary image is a single uncompressed frame.
    pub(super) fn is_plain(&self) -> bool {
        let own = self.header.starts_with(b"SIMPLE") && self.image.tiles.is_none();
        own && self.image.planes == 1 && matches!(self.data, Data::File(_))
    }

    /// Returns the bits per stored number.
    pub(super) fn bits(&self) -> u8 {
        self.image.coding.bits.unsigned_abs().min(64) as u8
    }

    /// Returns the numbers of one plane. Rows stay in file order.
    pub(super) fn values(&self, plane: usize) -> Result<Values, ImageError> {
        let image = &self.image;
        if plane >= image.planes {
            return Err(ImageError::NoPage(plane));
        }
        let mut file: Box<dyn Bytes + '_> = match &self.data {
            Data::File(path) => Box::new(crate::input::open(path)?),
            Data::Unpacked(bytes) => Box::new(Cursor::new(bytes.as_slice())),
        };
        if let Some(tiles) = &image.tiles {
            let values = tiles.plane(&mut *file, plane, &image.coding)?;
            return Ok(Values::Numbers(array(image.width, image.height, values)?));
        }
        let each = image.coding.bytes_each();
        let mut bytes = vec![0; image.width * image.height * each];
        file.seek(SeekFrom::Start(image.at + plane as u64 * bytes.len() as u64))?;
        file.read_exact(&mut bytes)?;
        let values = bytes.chunks_exact(each).map(|b| image.coding.value(b)).collect();
        Ok(Values::Numbers(array(image.width, image.height, values)?))
    }
}

/// Returns the position of the END card in a header that ends at `end`.
fn end_card(header: &[u8], end: usize) -> usize {
    let records = header[..end.min(header.len())].chunks_exact(super::FITS_CARD);
    let found = records.enumerate().find(|(_, card)| card.starts_with(b"END     "));
    found.map_or(end, |(i, _)| i * super::FITS_CARD)
}

/// Reads the records of a header.
fn header(file: &mut dyn Bytes, at: u64) -> Result<Vec<u8>, ImageError> {
    /// Maximum size of a header, bytes: headers have at most some thousand cards; 10,000 records of 36
    /// cards are not a header.
    const MAX_HEADER_BYTES: usize = 10_000 * FITS_RECORD;
    file.seek(SeekFrom::Start(at))?;
    let mut out = Vec::new();
    let mut record = [0u8; FITS_RECORD];
    while out.len() < MAX_HEADER_BYTES {
        let mut had = 0;
        while had < record.len() {
            match file.read(&mut record[had..])? {
                0 => break,
                n => had += n,
            }
        }
        out.extend(&record[..had]);
        let ends = record[..had].chunks_exact(super::FITS_CARD).any(|card| card.starts_with(b"END     "));
        if ends || had < record.len() {
            break;
        }
    }
    Ok(out)
}

/// Returns width, height and planes of an image with these axes.
fn sizes(axes: &[usize]) -> Result<(usize, usize, usize), ImageError> {
    let [width, height, rest @ ..] = axes else {
        return Err(ImageError::NotGrey(format!("a FITS of {} axes", axes.len())));
    };
    let planes = rest.iter().try_fold(1usize, |n, k| n.checked_mul(*k));
    match planes {
        Some(planes) if (1..=65_536).contains(width) && (1..=65_536).contains(height) && planes > 0 => {
            Ok((*width, *height, planes))
        }
        _ => Err(ImageError::Fits(format!("the axes {axes:?} make no image"))),
    }
}

fn coding(cards: &Cards, bitpix: &str) -> Result<Coding, ImageError> {
    let bits = number(cards, bitpix, None)?;
    if ![8.0, 16.0, 32.0, -32.0, -64.0].contains(&bits) {
        return Err(ImageError::NotGrey(format!("a FITS with {bitpix} {bits}")));
    }
    let blank = number(cards, if bitpix == "ZBITPIX" { "ZBLANK" } else { "BLANK" }, Some(f64::NAN)).ok();
    Ok(Coding {
        bits: bits as i64,
        scale: number(cards, "BSCALE", Some(1.0))?,
        zero: number(cards, "BZERO", Some(0.0))?,
        blank: blank.filter(|b| bits > 0.0 && !b.is_nan()),
    })
}

fn image(cards: &Cards, axes: &[usize], at: u64, size: u64) -> Result<Image, ImageError> {
    let (width, height, planes) = sizes(axes)?;
    let coding = coding(cards, "BITPIX")?;
    let needed = (width as u64 * height as u64 * coding.bytes_each() as u64).checked_mul(planes as u64);
    let has = size.saturating_sub(at);
    if needed.is_none_or(|n| n > has) {
        let needed = needed.map_or("too many".into(), |n| n.to_string());
        return Err(ImageError::Fits(format!(
            "cut short: {needed} bytes of pixels are needed, {has} are there"
        )));
    }
    Ok(Image { at, width, height, planes, coding, tiles: None })
}

/// Refuses an image with an implausible compression ratio.
fn must_be_image(width: usize, height: usize, size: u64) -> Result<(), ImageError> {
    if super::is_packed_too_much(width as u64, height as u64, 8, size) {
        return Err(ImageError::Fits(super::too_much(width, height, size)));
    }
    Ok(())
}

fn tiled(cards: &Cards, table: &[usize], at: u64, size: u64) -> Result<Image, ImageError> {
    let axes = axes(cards, "Z")?;
    let (width, height, planes) = sizes(&axes)?;
    let coding = coding(cards, "ZBITPIX")?;
    must_be_image(width, height, size)?;
    let tiles = Tiles::new(cards, table, &axes, &coding, at, size)?;
    must_be_image(width, height.saturating_mul(tiles.depth()), size)?;
    Ok(Image { at, width, height, planes, coding, tiles: Some(tiles) })
}
