//! Grey images of 8 or 16 bits: TIFF (any page), PNG and FITS in; TIFF out.

use ndarray::{Array2, ArrayView2};
use std::fs::File;
use std::io::{BufReader, Cursor, Seek, Write};
use std::path::Path;
use tiff::decoder::DecodingResult;
use tiff::encoder::{TiffEncoder, colortype};

/// Why an image cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The file system refused.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// Not a sound TIFF.
    #[error("not a sound TIFF: {}", tiff_words(.0))]
    Tiff(#[from] tiff::TiffError),
    /// Not a sound PNG.
    #[error("not a sound PNG: {0}")]
    Png(#[from] ::image::ImageError),
    /// Not a sound FITS.
    #[error("not a sound FITS: {0}")]
    Fits(String),
    /// Sound, but not a grey image of unsigned 8 or 16 bits.
    #[error("is {0}; frames are grey, with 8 or 16 unsigned bits")]
    NotGrey(String),
    /// A page that the file has not.
    #[error("has no page {0} (pages count from 0)")]
    NoPage(usize),
    /// A stack where one frame is asked for.
    #[error("is a stack of {0} pages or more, and one frame is asked for; `radcam import` takes stacks")]
    Stack(usize),
}

/// How a JPEG begins.
pub(crate) const JPEG: &[u8] = b"\xff\xd8\xff";
/// Why it is no frame.
pub(crate) const NO_JPEG: &str = "a JPEG, whose codes are not those of the camera";

/// What is wrong with a TIFF; of one that ends too early, that.
pub(crate) fn tiff_words(error: &tiff::TiffError) -> String {
    match error {
        tiff::TiffError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => {
            "cut short: the file ends before its pixels do".into()
        }
        tiff::TiffError::FormatError(tiff::TiffFormatError::TiffSignatureNotFound) => {
            "radcam reads TIFF, PNG and FITS, and it begins like none of them".into()
        }
        other => other.to_string(),
    }
}

/// Memory for a frame that serves again: asking the system for a new page costs more than filling it.
#[derive(Debug, Default)]
pub struct Buffer {
    dn: Vec<u16>,
    bytes: Vec<u8>,
    /// Rows and columns.
    shape: (usize, usize),
}

impl Buffer {
    /// The codes, row by row, DN.
    pub fn dn(&self) -> &[u16] {
        &self.dn
    }

    /// Rows and columns.
    pub fn shape(&self) -> (usize, usize) {
        self.shape
    }

    /// As (rows, columns).
    pub fn into_array(self) -> Array2<u16> {
        // Every reader leaves as many codes as its shape says.
        Array2::from_shape_vec(self.shape, self.dn).unwrap_or_default()
    }

    fn set(&mut self, image: Array2<u16>) {
        self.shape = image.dim();
        self.dn.clear();
        self.dn.extend(image.iter());
    }
}

/// Reads one page as (rows, columns) of DN. The kind of file is told by its first bytes, not by its name.
///
/// # Errors
///
/// Where the file cannot be read or has no such page, or its pixels are no codes of up to 16 bits.
pub fn read(path: &Path, page: usize) -> Result<Array2<u16>, ImageError> {
    let mut buffer = Buffer::default();
    read_into(path, Some(page), &mut buffer)?;
    Ok(buffer.into_array())
}

/// Reads a file that has one frame; of a stack nobody said which.
///
/// # Errors
///
/// As [`read`], and where the file has several pages.
pub fn read_single(path: &Path) -> Result<Array2<u16>, ImageError> {
    let mut buffer = Buffer::default();
    read_into(path, None, &mut buffer)?;
    Ok(buffer.into_array())
}

/// Reads one page, or the only one, into memory that is there.
///
/// # Errors
///
/// As [`read`], and where no page is named and the file has several.
pub fn read_into(path: &Path, page: Option<usize>, buffer: &mut Buffer) -> Result<(), ImageError> {
    let mut file = File::open(path)?;
    let mut start = [0u8; 8];
    let read = std::io::Read::read(&mut file, &mut start)?;
    let start = &start[..read];
    if start.starts_with(JPEG) {
        return Err(ImageError::NotGrey(NO_JPEG.into()));
    }
    if start.starts_with(b"\x89PNG") {
        first_page_only(page.unwrap_or(0))?;
        file.rewind()?;
        return read_png(file, buffer);
    }
    if start.starts_with(b"SIMPLE") {
        first_page_only(page.unwrap_or(0))?;
        buffer.set(read_fits(&std::fs::read(path)?)?);
        return Ok(());
    }
    file.rewind()?;
    read_tiff(file, page, buffer)
}

/// Bits of a pixel as the file keeps it, 8, 16 or 32: what a code can be at most.
///
/// # Errors
///
/// Where the file cannot be read.
pub fn stored_bits(path: &Path) -> Result<u8, ImageError> {
    let mut start = [0u8; 26];
    let read = std::io::Read::read(&mut File::open(path)?, &mut start)?;
    if start.starts_with(b"\x89PNG") && read == start.len() {
        // The bit depth of the IHDR chunk (PNG specification, 11.2.2).
        return Ok(start[24].max(8));
    }
    if start.starts_with(b"SIMPLE") {
        let bits = fits_cards(path)?.get("BITPIX").and_then(|b| b.parse().ok());
        let bits: i16 = bits.ok_or_else(|| ImageError::Fits("has no BITPIX".into()))?;
        return Ok(bits.unsigned_abs().min(64) as u8);
    }
    let mut decoder = tiff::decoder::Decoder::new(BufReader::new(File::open(path)?))?;
    Ok(decoder.colortype()?.bit_depth())
}

fn first_page_only(page: usize) -> Result<(), ImageError> {
    if page == 0 { Ok(()) } else { Err(ImageError::NoPage(page)) }
}

fn array(width: usize, height: usize, pixels: Vec<u16>) -> Result<Array2<u16>, ImageError> {
    let found = pixels.len();
    Array2::from_shape_vec((height, width), pixels)
        .map_err(|_| ImageError::NotGrey(format!("{width} x {height} px with {found} values")))
}

fn read_tiff(file: File, page: Option<usize>, buffer: &mut Buffer) -> Result<(), ImageError> {
    let mut decoder = tiff::decoder::Decoder::new(BufReader::new(file))?;
    for _ in 0..page.unwrap_or(0) {
        if !decoder.more_images() {
            return Err(ImageError::NoPage(page.unwrap_or(0)));
        }
        decoder.next_image()?;
    }
    let (width, height) = decoder.dimensions()?;
    let color = decoder.colortype()?;
    let tiff::ColorType::Gray(bits @ (8 | 16 | 32)) = color else {
        return Err(ImageError::NotGrey(format!("{color:?}")));
    };
    let shape = (height as usize, width as usize);
    if let Some(strips) = plain_strips(&mut decoder, bits, shape) {
        read_strips(&mut decoder, &strips, bits, shape, buffer)?;
    } else {
        let pixels = match decoder.read_image()? {
            DecodingResult::U8(v) => v.into_iter().map(u16::from).collect(),
            DecodingResult::U16(v) => v,
            // The EMVA reference tool keeps its codes in 32 bits.
            DecodingResult::U32(v) => v.into_iter().map(narrow).collect::<Result<_, _>>()?,
            DecodingResult::I32(v) => v.into_iter().map(narrow).collect::<Result<_, _>>()?,
            _ => return Err(ImageError::NotGrey("a TIFF of signed or floating-point values".into())),
        };
        buffer.set(array(shape.1, shape.0, pixels)?);
    }
    if page.is_none() && decoder.more_images() {
        // A second page of another size, or one that cannot be read, is a thumbnail.
        let next = decoder.next_image().and_then(|()| decoder.dimensions());
        if next.is_ok_and(|size| size == (width, height)) {
            return Err(ImageError::Stack(2));
        }
    }
    Ok(())
}

/// Where the pixels lie in a file of 8 or 16 bits that is neither compressed nor tiled nor inverted: offset and bytes of each strip, which
/// together hold the image and no more.
fn plain_strips(decoder: &mut Tiff, bits: u8, shape: (usize, usize)) -> Option<Vec<(u64, usize)>> {
    use tiff::tags::Tag;
    let mut is = |tag, value: u64| {
        decoder.find_tag_unsigned::<u64>(tag).ok()?.is_none_or(|v| v == value).then_some(())
    };
    // Not compressed, black is 0, unsigned, no predictor; strips and not tiles.
    is(Tag::Compression, 1)?;
    is(Tag::PhotometricInterpretation, 1)?;
    is(Tag::SampleFormat, 1)?;
    is(Tag::Predictor, 1)?;
    is(Tag::FillOrder, 1)?;
    is(Tag::SamplesPerPixel, 1)?;
    let offsets = decoder.get_tag_u64_vec(Tag::StripOffsets).ok()?;
    let bytes = decoder.get_tag_u64_vec(Tag::StripByteCounts).ok()?;
    let needed = shape.0.checked_mul(shape.1)?.checked_mul(usize::from(bits) / 8)?;
    let strips: Vec<(u64, usize)> = offsets
        .into_iter()
        .zip(bytes)
        .map(|(o, b)| Some((o, usize::try_from(b).ok()?)))
        .collect::<Option<_>>()?;
    let there = strips.iter().try_fold(0usize, |sum, s| sum.checked_add(s.1))?;
    // A header may claim anything; the file holds what it holds.
    let size = std::io::Seek::seek(decoder.inner(), std::io::SeekFrom::End(0)).ok()?;
    let inside = strips.iter().all(|(o, b)| o.checked_add(*b as u64).is_some_and(|end| end <= size));
    (bits < 32 && there == needed && inside).then_some(strips)
}

type Tiff = tiff::decoder::Decoder<BufReader<File>>;

/// Reads strips of codes into place.
fn read_strips(
    decoder: &mut Tiff,
    strips: &[(u64, usize)],
    bits: u8,
    shape: (usize, usize),
    buffer: &mut Buffer,
) -> Result<(), ImageError> {
    let pixels = shape.0 * shape.1;
    let big = decoder.byte_order() == tiff::tags::ByteOrder::BigEndian;
    let Buffer { dn, bytes, .. } = buffer;
    dn.resize(pixels, 0);
    let target: &mut [u8] = if bits == 16 {
        bytemuck::cast_slice_mut(dn)
    } else {
        bytes.resize(pixels, 0);
        bytes
    };
    let file = decoder.inner().get_mut();
    let mut rest = target;
    for (offset, length) in strips {
        let (strip, after) = rest.split_at_mut(*length);
        std::io::Seek::seek(file, std::io::SeekFrom::Start(*offset))?;
        std::io::Read::read_exact(file, strip)?;
        rest = after;
    }
    if bits == 16 {
        if big != cfg!(target_endian = "big") {
            dn.iter_mut().for_each(|d| *d = d.swap_bytes());
        }
    } else {
        dn.iter_mut().zip(bytes.iter()).for_each(|(d, b)| *d = u16::from(*b));
    }
    buffer.shape = shape;
    Ok(())
}

/// A code that fits into 16 bits.
fn narrow<T: Copy + std::fmt::Display + TryInto<u16>>(code: T) -> Result<u16, ImageError> {
    code.try_into().map_err(|_| ImageError::NotGrey(format!("a TIFF of 32 bits with the value {code}")))
}

fn read_png(file: File, buffer: &mut Buffer) -> Result<(), ImageError> {
    use ::image::codecs::png::PngDecoder;
    use ::image::{ColorType, ImageDecoder};
    let size = file.metadata()?.len();
    // A header may claim anything: deflate packs at most about a thousand to one (RFC 1951).
    let mut limits = ::image::Limits::default();
    limits.max_alloc = Some(size.saturating_mul(1100).saturating_add(1 << 20));
    let decoder = PngDecoder::with_limits(BufReader::with_capacity(1 << 16, file), limits.clone())?;
    let (width, height) = decoder.dimensions();
    limits.reserve(decoder.total_bytes())?;
    let pixels = width as usize * height as usize;
    match decoder.color_type() {
        ColorType::L16 => {
            buffer.dn.resize(pixels, 0);
            decoder.read_image(bytemuck::cast_slice_mut(&mut buffer.dn))?;
        }
        ColorType::L8 => {
            buffer.bytes.resize(pixels, 0);
            decoder.read_image(&mut buffer.bytes)?;
            buffer.dn.clear();
            buffer.dn.extend(buffer.bytes.iter().map(|b| u16::from(*b)));
        }
        other => return Err(ImageError::NotGrey(format!("{other:?}"))),
    }
    buffer.shape = (height as usize, width as usize);
    Ok(())
}

/// Size of a FITS record, bytes, and of a card in it (FITS standard 4.0, section 3.1 and 4.1).
const FITS_RECORD: usize = 2880;
const FITS_CARD: usize = 80;

type Cards = std::collections::HashMap<String, String>;

/// The cards of a FITS header that have a value, strings in their quotes, and where the header ends.
fn cards_of(bytes: &[u8]) -> Result<(Cards, usize), ImageError> {
    let fault = |message: &str| ImageError::Fits(message.into());
    let mut values = Cards::new();
    for (i, card) in bytes.chunks_exact(FITS_CARD).enumerate() {
        let card = std::str::from_utf8(card).map_err(|_| fault("the header is not text"))?;
        let keyword = card.get(..8).unwrap_or(card).trim_end();
        if keyword == "END" {
            return Ok((values, (i + 1) * FITS_CARD));
        }
        if let Some(value) = card.get(8..).and_then(|rest| rest.strip_prefix("= ")) {
            let value = value.split('/').next().unwrap_or(value).trim();
            values.entry(keyword.to_string()).or_insert_with(|| value.to_string());
        }
    }
    Err(fault("the header has no END"))
}

/// The values of a FITS file's header by their keywords.
pub(crate) fn fits_cards(path: &Path) -> Result<Cards, ImageError> {
    Ok(cards_of(&std::fs::read(path)?)?.0)
}

/// Reads the primary image of a FITS file that has two axes, with BZERO and BSCALE applied (section 5.2.5): FITS has no unsigned 16-bit
/// integers, they are written with BZERO = 32768. Rows are kept in the order of the file.
///
/// Our own, for of the crates that read FITS one leaves BZERO to its user, one needs the C library, and one asks for as much memory as a header
/// claims (docs/decisions/0006-our-own-fits-reader.md).
fn read_fits(bytes: &[u8]) -> Result<Array2<u16>, ImageError> {
    let (values, end) = cards_of(bytes)?;
    let data_at = end.next_multiple_of(FITS_RECORD);
    let number = |keyword: &str, default: Option<f64>| match values.get(keyword) {
        Some(text) => text.parse::<f64>().map_err(|_| ImageError::Fits(format!("{keyword} is {text}"))),
        None => default.ok_or_else(|| ImageError::Fits(format!("the header has no {keyword}"))),
    };
    let axes = number("NAXIS", None)?;
    if axes != 2.0 {
        return Err(ImageError::NotGrey(format!("a FITS of {axes} axes")));
    }
    let size = |keyword| {
        let n = number(keyword, None)?;
        if n.fract() == 0.0 && (1.0..=65_536.0).contains(&n) {
            Ok(n as usize)
        } else {
            Err(ImageError::Fits(format!("{keyword} is {n}")))
        }
    };
    let (width, height) = (size("NAXIS1")?, size("NAXIS2")?);
    let (scale, zero) = (number("BSCALE", Some(1.0))?, number("BZERO", Some(0.0))?);
    let bits = number("BITPIX", None)?;
    let raw: fn(&[u8]) -> f64 = match bits as i64 {
        8 => |b| b.first().copied().map_or(f64::NAN, f64::from),
        16 => |b| b.try_into().map_or(f64::NAN, |b| i16::from_be_bytes(b).into()),
        32 => |b| b.try_into().map_or(f64::NAN, |b| i32::from_be_bytes(b).into()),
        -32 => |b| b.try_into().map_or(f64::NAN, |b| f32::from_be_bytes(b).into()),
        _ => return Err(ImageError::NotGrey(format!("a FITS with BITPIX {bits}"))),
    };
    let bytes_each = bits.abs() as usize / 8;
    let needed = width * height * bytes_each;
    let data = bytes.get(data_at..data_at + needed).ok_or_else(|| {
        let has = bytes.len().saturating_sub(data_at);
        ImageError::Fits(format!("cut short: {needed} bytes of pixels are needed, {has} are there"))
    })?;
    let code = |b: &[u8]| {
        let value = scale * raw(b) + zero;
        if (0.0..=65_535.0).contains(&value) && value.fract() == 0.0 {
            Ok(value as u16)
        } else {
            Err(ImageError::NotGrey(format!("a FITS with the value {value}")))
        }
    };
    array(width, height, data.chunks_exact(bytes_each).map(code).collect::<Result<_, _>>()?)
}

/// Writes a frame as an uncompressed TIFF, 8 bits deep where `bit_depth` is at most 8, else 16.
///
/// # Errors
///
/// Where the output cannot be written.
pub fn write_tiff<W: Write + Seek>(out: W, pixels: &Array2<u16>, bit_depth: u8) -> Result<(), ImageError> {
    let (height, width) = pixels.dim();
    let (width, height) = (width as u32, height as u32);
    let mut encoder = TiffEncoder::new(out)?;
    let standard = pixels.as_standard_layout();
    let dn = standard.as_slice().unwrap_or_default();
    if bit_depth <= 8 {
        let bytes: Vec<u8> = dn.iter().map(|&d| d as u8).collect();
        encoder.write_image::<colortype::Gray8>(width, height, &bytes)?;
    } else {
        encoder.write_image::<colortype::Gray16>(width, height, dn)?;
    }
    Ok(())
}

/// The bytes of [`write_tiff`].
///
/// # Errors
///
/// Where the output cannot be written.
pub fn tiff_bytes(pixels: &Array2<u16>, bit_depth: u8) -> Result<Vec<u8>, ImageError> {
    let mut out = Cursor::new(Vec::with_capacity(pixels.len() * 2 + 1024));
    write_tiff(&mut out, pixels, bit_depth)?;
    Ok(out.into_inner())
}

/// A text as TIFF takes it, which knows ASCII only: what is beyond is written as JSON escapes it.
pub(crate) fn ascii(text: &str) -> String {
    let escaped = |c: char| {
        let mut units = [0; 2];
        c.encode_utf16(&mut units).iter().map(|u| format!("\\u{u:04x}")).collect::<String>()
    };
    text.chars().map(|c| if c.is_ascii() { c.to_string() } else { escaped(c) }).collect()
}

/// The bytes of an uncompressed TIFF of one page, with an ImageDescription that says what the numbers mean.
///
/// # Errors
///
/// Where the output cannot be written.
pub fn described_bytes<C: colortype::ColorType>(
    pixels: ArrayView2<'_, C::Inner>,
    description: &str,
) -> Result<Vec<u8>, ImageError>
where
    C::Inner: Clone,
    [C::Inner]: tiff::encoder::TiffValue,
{
    let (height, width) = pixels.dim();
    let mut out = Cursor::new(Vec::with_capacity(pixels.len() * size_of::<C::Inner>() + 1024));
    let standard = pixels.as_standard_layout();
    let mut encoder = TiffEncoder::new(&mut out)?;
    let mut image = encoder.new_image::<C>(width as u32, height as u32)?;
    image.encoder().write_tag(tiff::tags::Tag::ImageDescription, ascii(description).as_str())?;
    image.write_data(standard.as_slice().unwrap_or_default())?;
    Ok(out.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn fits(cards: &[&str], data: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        for card in cards.iter().chain(&["END"]) {
            out.extend(format!("{card:<80}").bytes());
        }
        out.resize(out.len().next_multiple_of(FITS_RECORD), b' ');
        out.extend(data);
        out
    }

    const HEAD: [&str; 4] =
        ["SIMPLE  =                    T", "BITPIX  = 16", "NAXIS   = 2", "NAXIS1  = 2 / columns"];

    #[test]
    fn fits_of_unsigned_words_is_read() {
        let mut cards = HEAD.to_vec();
        cards.extend(["NAXIS2  = 1", "BZERO   =              32768.0"]);
        let image = read_fits(&fits(&cards, &[0x80, 0x00, 0x7F, 0xFF])).unwrap();
        assert_eq!(image, ndarray::array![[0u16, 65_535]]);
        let cut = read_fits(&fits(&cards, &[0x80])).unwrap_err().to_string();
        assert!(cut.contains("4 bytes of pixels are needed, 1 are there"), "{cut}");
        // Codes in 32 bits or as floating-point numbers, as other tools write them.
        for (bits, data) in [("32", 4_000i32.to_be_bytes()), ("-32", 4_000f32.to_be_bytes())] {
            let bitpix = format!("BITPIX  = {bits}");
            let cards = [HEAD[0], &bitpix, HEAD[2], "NAXIS1  = 1", "NAXIS2  = 1"];
            assert_eq!(read_fits(&fits(&cards, &data)).unwrap(), ndarray::array![[4_000]]);
        }
        // Without BZERO the values are signed.
        assert!(read_fits(&fits(&[&HEAD[..], &["NAXIS2  = 1"]].concat(), &[0xFF; 4])).is_err());
    }

    #[test]
    fn codes_kept_in_32_bits_are_read_where_they_fit() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.tiff");
        let write = |codes: [i32; 2]| {
            let mut encoder = TiffEncoder::new(File::create(&path).unwrap()).unwrap();
            encoder.write_image::<colortype::GrayI32>(2, 1, &codes).unwrap();
            read(&path, 0)
        };
        assert_eq!(write([0, 65_535]).unwrap(), ndarray::array![[0, 65_535]]);
        assert!(write([0, 65_536]).unwrap_err().to_string().contains("65536"));
        assert!(write([-1, 0]).is_err());
    }

    proptest! {
        #[test]
        fn no_fits_header_makes_the_reader_panic(
            bits in prop::sample::select(vec![8i64, 16, 32, 64, -32, -64, 0, 7, i64::MIN]),
            axes in prop::collection::vec(prop_oneof![0i64..9, any::<i64>()], 0..4),
            count in prop_oneof![0i64..4, any::<i64>()],
            extra in prop::sample::select(vec!["PCOUNT  = 9223372036854775807", "GCOUNT  = -1", "BSCALE  = 'x'", "GROUPS  = T", "ZIMAGE  = T"]),
            data in prop::collection::vec(any::<u8>(), 0..64),
        ) {
            let sizes = axes.iter().enumerate().map(|(i, n)| format!("NAXIS{}  = {n}", i + 1));
            let head = [HEAD[0].into(), format!("BITPIX  = {bits}"), format!("NAXIS   = {count}")];
            let cards: Vec<String> = head.into_iter().chain(sizes).chain([extra.into()]).collect();
            let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
            let _ = read_fits(&fits(&cards, &data));
        }

        #[test]
        fn no_bytes_make_the_readers_panic(bytes in prop::collection::vec(any::<u8>(), 0..400), kind in 0usize..4) {
            let start: &[u8] = [&b"SIMPLE  "[..], b"\x89PNG\r\n\x1a\n", b"II*\0", b""][kind];
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("x");
            std::fs::write(&path, [start, &bytes].concat()).unwrap();
            let _ = read(&path, 0);
        }

        #[test]
        fn tiff_survives_a_round_trip(w in 1usize..9, h in 1usize..9, bits in 8u8..=16, seed in any::<u16>()) {
            let mask = ((1u32 << bits) - 1) as u16;
            let image = Array2::from_shape_fn((h, w), |(y, x)| {
                seed.wrapping_mul(31).wrapping_add((y * 977 + x * 131) as u16) & mask
            });
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("x.tiff");
            std::fs::write(&path, tiff_bytes(&image, bits).unwrap()).unwrap();
            prop_assert_eq!(read(&path, 0).unwrap(), image);
            prop_assert!(matches!(read(&path, 1), Err(ImageError::NoPage(1))));
        }
    }
}
