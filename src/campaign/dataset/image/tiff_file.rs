//! TIFF reader: any page of a file, with an index of its directories.
//!
//! The crate `tiff` decodes. It reaches page n by reading the n preceding pages, so a stack would take
//! quadratic time. Therefore the index finds all directories once, and the decoder is given a view of
//! the file in which the requested directory comes first.

use super::{Buffer, ImageError, Values, array};
use std::collections::HashSet;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::{ByteOrder, Tag};

/// Directory index of a TIFF file (TIFF 6.0, section 2; BigTIFF uses 8-byte numbers).
#[derive(Debug, Clone)]
pub(crate) struct Directories {
    big_endian: bool,
    big_tiff: bool,
    /// Main directories in chain order, then those of SubIFDs.
    all: Vec<Directory>,
    /// Number of main directories.
    main: usize,
    /// Number of frames stored behind a single directory, as in large ImageJ stacks; 1 for any other
    /// file.
    contiguous: usize,
}

#[derive(Debug, Clone, Default)]
struct Directory {
    at: u64,
    /// True if NewSubfileType marks a reduced image or a mask.
    reduced: bool,
    /// Position and value of PhotometricInterpretation.
    photometric: Option<(u64, u16)>,
    sub: Vec<u64>,
    /// Positions and lengths of the ImageDescriptions.
    descriptions: Vec<(u64, u64)>,
}

/// Maximum length of a description, bytes.
const MAX_DESCRIPTION_BYTES: u64 = 1 << 20;

/// PhotometricInterpretation of a colour-filter mosaic (TIFF/EP) and of its planes (DNG): unprocessed
/// sensor codes.
const CFA: u16 = 32_803;
const LINEAR_RAW: u16 = 34_892;

/// Decodes a number of 2, 4 or 8 bytes.
fn number(bytes: &[u8], big_endian: bool) -> u64 {
    let fold = |n: u64, b: &u8| n << 8 | u64::from(*b);
    if big_endian { bytes.iter().fold(0, fold) } else { bytes.iter().rev().fold(0, fold) }
}

impl Directories {
    pub(super) fn read(path: &Path) -> Result<Self, ImageError> {
        let mut file = BufReader::with_capacity(1 << 12, crate::input::open(path)?);
        let mut head = [0u8; 16];
        let mut had = 0;
        while had < head.len() {
            match file.read(&mut head[had..])? {
                0 => break,
                n => had += n,
            }
        }
        let big_endian = match &head[..2] {
            b"II" => false,
            b"MM" => true,
            _ => return Err(tiff::TiffError::from(tiff::TiffFormatError::TiffSignatureNotFound).into()),
        };
        let big_tiff = number(&head[2..4], big_endian) == 43;
        let first = number(if big_tiff { &head[8..16] } else { &head[4..8] }, big_endian);
        let mut out = Self { big_endian, big_tiff, all: Vec::new(), main: 0, contiguous: 1 };
        let mut seen = HashSet::new();
        let mut next = first;
        while next != 0 && seen.insert(next) {
            let (directory, after) = out.directory(&mut file, next)?;
            out.all.push(directory);
            next = after;
        }
        out.main = out.all.len();
        let sub: Vec<u64> = out.all.iter().flat_map(|d| d.sub.iter().copied()).collect();
        for at in sub {
            // Pages before a damaged directory remain readable.
            if seen.insert(at)
                && let Ok((directory, _)) = out.directory(&mut file, at)
            {
                out.all.push(directory);
            }
        }
        if out.main == 1 {
            out.contiguous = out.behind_one_directory(path).unwrap_or(1);
        }
        Ok(out)
    }

    /// Reads one directory and the position of the next one.
    fn directory(&self, file: &mut BufReader<File>, at: u64) -> Result<(Directory, u64), ImageError> {
        let (count_bytes, entry_bytes, pointer) = if self.big_tiff { (8, 20, 8) } else { (2, 12, 4) };
        let mut bytes = [0u8; 8];
        file.seek(SeekFrom::Start(at))?;
        file.read_exact(&mut bytes[..count_bytes]).map_err(tiff::TiffError::from)?;
        let count = number(&bytes[..count_bytes], self.big_endian).min(1 << 16) as usize;
        let mut entries = vec![0u8; count * entry_bytes + pointer];
        file.read_exact(&mut entries).map_err(tiff::TiffError::from)?;
        let next = number(&entries[count * entry_bytes..], self.big_endian);
        let mut out = Directory { at, ..Directory::default() };
        for (k, entry) in entries[..count * entry_bytes].chunks_exact(entry_bytes).enumerate() {
            let of = |range: std::ops::Range<usize>| number(&entry[range], self.big_endian);
            let value = entry_bytes - pointer;
            let values = if self.big_tiff { of(4..12) } else { of(4..8) };
            if (of(0..2), of(2..4)) == (270, 2) {
                let inside = at + (count_bytes + k * entry_bytes + value) as u64;
                let place = if values <= pointer as u64 { inside } else { of(value..value + pointer) };
                out.descriptions.push((place, values));
                continue;
            }
            let bytes_each = match of(2..4) {
                3 => 2,
                4 | 13 => 4,
                16 | 18 => 8,
                _ => continue,
            };
            match of(0..2) {
                254 => out.reduced = of(value..value + bytes_each.min(pointer)) & 0b101 != 0,
                262 if bytes_each == 2 => {
                    let place = at + (count_bytes + k * entry_bytes + value) as u64;
                    out.photometric = Some((place, of(value..value + 2) as u16));
                }
                330 if values as usize * bytes_each <= pointer => {
                    out.sub.extend(
                        (0..values as usize)
                            .map(|i| of(value + i * bytes_each..value + (i + 1) * bytes_each)),
                    );
                }
                330 => {
                    // A header may claim any number of SubIFDs.
                    let mut list = vec![0u8; (values.min(64) as usize) * bytes_each];
                    file.seek(SeekFrom::Start(of(value..value + pointer)))?;
                    if file.read_exact(&mut list).is_ok() {
                        out.sub.extend(list.chunks_exact(bytes_each).map(|b| number(b, self.big_endian)));
                    }
                }
                _ => {}
            }
        }
        Ok((out, next))
    }

    /// Returns the numbers of the pages that are frames, without thumbnails and masks. If the main
    /// directory is only a thumbnail, the frame is in a SubIFD (DNG).
    pub(super) fn frames(&self) -> Vec<usize> {
        if self.contiguous > 1 {
            return (0..self.contiguous).collect();
        }
        let full = |from: usize, to: usize| (from..to).filter(|i| !self.all[*i].reduced).collect::<Vec<_>>();
        let main = full(0, self.main);
        let sub = if main.is_empty() { full(self.main, self.all.len()) } else { Vec::new() };
        match (main.is_empty(), sub.is_empty()) {
            (false, _) => main,
            (true, false) => sub,
            (true, true) => (0..self.main).collect(),
        }
    }

    /// Returns true if the frames are the main directories, which all TIFF readers agree on.
    pub(super) fn is_plain(&self) -> bool {
        let raw = |d: &Directory| d.photometric.is_some_and(|p| matches!(p.1, CFA | LINEAR_RAW));
        self.contiguous == 1 && self.frames().iter().all(|i| *i < self.main && !raw(&self.all[*i]))
    }

    /// Returns true if a page is marked as a colour-filter mosaic.
    pub(super) fn is_mosaic(&self, page: usize) -> bool {
        self.all.get(page).is_some_and(|d| d.photometric.is_some_and(|p| p.1 == CFA))
    }

    /// Returns true if a single directory describes all frames, as in large ImageJ stacks.
    pub(crate) fn is_contiguous(&self) -> bool {
        self.contiguous > 1
    }

    /// Returns the first ImageDescription of a page with several: decoders return the last. Python's
    /// tifffile writes the array shape after the caller's text.
    pub(crate) fn first_description(&self, path: &Path, page: usize) -> Option<String> {
        let [(place, length), _, ..] = self.all.get(page)?.descriptions[..] else { return None };
        let mut file = crate::input::open(path).ok()?;
        file.seek(SeekFrom::Start(place)).ok()?;
        let mut bytes = Vec::new();
        file.take(length.min(MAX_DESCRIPTION_BYTES)).read_to_end(&mut bytes).ok()?;
        let text = String::from_utf8_lossy(&bytes);
        Some(text.trim_end_matches('\0').to_string())
    }

    /// Opens the decoder at a page.
    pub(crate) fn decoder(&self, path: &Path, page: usize) -> Result<Tiff, ImageError> {
        let place = if self.contiguous > 1 { 0 } else { page };
        let directory = self.all.get(place).ok_or(ImageError::NoPage(page))?;
        let order = |bytes: Vec<u8>| if self.big_endian { bytes.into_iter().rev().collect() } else { bytes };
        let mut shown = vec![if self.big_tiff {
            (8, order(directory.at.to_le_bytes().to_vec()))
        } else {
            (4, order((directory.at as u32).to_le_bytes().to_vec()))
        }];
        if let Some((place, CFA | LINEAR_RAW)) = directory.photometric {
            shown.push((place, order(1u16.to_le_bytes().to_vec())));
        }
        let file = Shown { file: crate::input::open(path)?, at: 0, shown };
        Ok(Decoder::new(BufReader::new(file))?)
    }

    /// Counts frames stored contiguously behind a single directory: ImageJ does so for stacks beyond 4
    /// GB, other writers of its format always.
    fn behind_one_directory(&self, path: &Path) -> Option<usize> {
        let mut decoder = self.decoder(path, 0).ok()?;
        let text = decoder.get_tag_ascii_string(Tag::ImageDescription).ok()?;
        let said = text.strip_prefix("ImageJ=")?.lines().find_map(|l| l.strip_prefix("images="))?;
        let said: usize = said.trim().parse().ok()?;
        let (width, height) = decoder.dimensions().ok()?;
        let tiff::ColorType::Gray(bits @ (8 | 16 | 32)) = decoder.colortype().ok()? else { return None };
        let frame = u64::from(width) * u64::from(height) * u64::from(bits / 8);
        let is_plain = decoder.find_tag_unsigned::<u64>(Tag::Compression).ok()?.is_none_or(|c| c == 1);
        let from = *decoder.get_tag_u64_vec(Tag::StripOffsets).ok()?.first()?;
        let size = decoder.inner().seek(SeekFrom::End(0)).ok()?;
        let end = frame.checked_mul(said as u64)?.checked_add(from)?;
        (is_plain && said > 1 && frame > 0 && end <= size).then_some(said)
    }

    /// Reads a page: codes of 8 to 16 bits into the buffer; other values are returned as numbers.
    pub(super) fn page(
        &self,
        path: &Path,
        page: usize,
        buffer: &mut Buffer,
    ) -> Result<Option<Values>, ImageError> {
        let mut decoder = self.decoder(path, page)?;
        let shift = if self.contiguous > 1 { page as u64 } else { 0 };
        read_page(&mut decoder, shift, buffer)
    }

    /// Returns the page of a single frame; refuses a file with more frames.
    pub(super) fn single(&self, path: &Path) -> Result<usize, ImageError> {
        let frames = self.frames();
        let first = frames.first().copied().unwrap_or(0);
        if frames.len() > 1 {
            let size = |page: usize| self.decoder(path, page).ok().and_then(|mut d| d.dimensions().ok());
            // A second page of another size, or an unreadable one, is a thumbnail.
            if self.contiguous > 1 || size(first).is_some_and(|s| size(frames[1]) == Some(s)) {
                return Err(ImageError::Stack(frames.len()));
            }
        }
        Ok(first)
    }
}

/// View of a file with some bytes replaced.
#[derive(Debug)]
pub(crate) struct Shown {
    file: File,
    at: u64,
    shown: Vec<(u64, Vec<u8>)>,
}

impl Read for Shown {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let n = self.file.read(out)?;
        for (place, bytes) in &self.shown {
            let end = self.at + n as u64;
            for (at, byte) in (*place..).zip(bytes) {
                if (self.at..end).contains(&at) {
                    out[(at - self.at) as usize] = *byte;
                }
            }
        }
        self.at += n as u64;
        Ok(n)
    }
}

impl Seek for Shown {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.at = self.file.seek(to)?;
        Ok(self.at)
    }
}

pub(crate) type Tiff = Decoder<BufReader<Shown>>;

/// Strips of codes that are not compressed, tiled or inverted.
struct Strips {
    /// Offset and byte count of each strip; together they hold exactly the image.
    at: Vec<(u64, usize)>,
    /// True if the bits of every byte are reversed (FillOrder 2).
    reversed: bool,
}

fn read_page(decoder: &mut Tiff, frame: u64, buffer: &mut Buffer) -> Result<Option<Values>, ImageError> {
    let (width, height) = decoder.dimensions()?;
    let bits = match decoder.colortype()? {
        tiff::ColorType::Gray(bits) => bits,
        tiff::ColorType::Multiband { bit_depth, num_samples } => {
            return Err(ImageError::NotGrey(format!(
                "a grey TIFF with {} further channels (alpha), {bit_depth} bits each",
                num_samples - 1
            )));
        }
        other => return Err(ImageError::NotGrey(format!("a TIFF in colour ({other:?})"))),
    };
    let shape = (height as usize, width as usize);
    // LinearizationTable (DNG 1.6, chapter 4): samples are table indices, often square-root coded, not
    // converter codes.
    let table = decoder.find_tag_unsigned_vec::<u16>(Tag::Unknown(50_712))?;
    if table.is_some_and(|table| table.iter().enumerate().any(|(i, v)| usize::from(*v) != i)) {
        return Err(ImageError::NoFrames(
            "a DNG whose samples go through a table (LinearizationTable), which radcam does not read; `unprocessed_raw -T FILE` of LibRaw (or \
             `dcraw -D -4 -T FILE`) writes linear codes as TIFF"
                .into(),
        ));
    }
    if let Some(strips) = plain_strips(decoder, bits, shape, frame) {
        read_strips(decoder, &strips, bits, shape, buffer)?;
        return Ok(None);
    }
    if frame > 0 {
        return further_frame(decoder, bits, shape, frame).map(Some);
    }
    // Old and new JPEG, and lossy JPEG of DNG.
    if let Some(7 | 34_892) = decoder.find_tag_unsigned::<u64>(Tag::Compression)? {
        return Err(ImageError::NoFrames(
            "a TIFF or DNG with JPEG compression, which radcam does not read; of a DNG `unprocessed_raw -T FILE` of LibRaw (or \
             `dcraw -D -4 -T FILE`) writes its codes as TIFF"
                .into(),
        ));
    }
    if decoder.find_tag_unsigned::<u64>(Tag::FillOrder)?.is_some_and(|order| order != 1) {
        return Err(ImageError::NotGrey("a compressed TIFF with reversed bits (FillOrder 2)".into()));
    }
    if !matches!(bits, 8 | 16 | 32 | 64) {
        return Err(ImageError::NotGrey(format!("a compressed TIFF of {bits} packed bits")));
    }
    fn numbers<T: Copy + Into<f64>>(v: &[T]) -> Vec<f64> {
        v.iter().map(|v| (*v).into()).collect()
    }
    let numbers = match decoder.read_image()? {
        DecodingResult::U8(v) => {
            buffer.set(array(shape.1, shape.0, v.into_iter().map(u16::from).collect())?);
            return Ok(None);
        }
        DecodingResult::U16(v) => {
            buffer.set(array(shape.1, shape.0, v)?);
            return Ok(None);
        }
        // The EMVA reference tool stores codes in 32 bits.
        DecodingResult::U32(v) => numbers(&v),
        DecodingResult::I32(v) => numbers(&v),
        DecodingResult::I16(v) => numbers(&v),
        DecodingResult::I8(v) => numbers(&v),
        DecodingResult::F16(v) => v.into_iter().map(f64::from).collect(),
        DecodingResult::F32(v) => numbers(&v),
        DecodingResult::F64(v) => v,
        _ => return Err(ImageError::NotGrey("a TIFF of integers of 64 bits".into())),
    };
    Ok(Some(Values::Numbers(array(shape.1, shape.0, numbers)?)))
}

/// Reads frame n of a single-directory stack of signed or floating-point numbers.
fn further_frame(
    decoder: &mut Tiff,
    bits: u8,
    shape: (usize, usize),
    frame: u64,
) -> Result<Values, ImageError> {
    let big = decoder.byte_order() == ByteOrder::BigEndian;
    let format = decoder.find_tag_unsigned::<u64>(Tag::SampleFormat)?.unwrap_or(1);
    let from = decoder.get_tag_u64_vec(Tag::StripOffsets)?.first().copied().unwrap_or(0);
    let size = shape.0 * shape.1 * usize::from(bits) / 8;
    let mut bytes = vec![0; size];
    let file = decoder.inner().get_mut();
    file.seek(SeekFrom::Start(from + frame * size as u64))?;
    file.read_exact(&mut bytes)?;
    let each = usize::from(bits) / 8;
    let value = |b: &[u8]| {
        let bits = number(b, big);
        match (each, format) {
            (4, 3) => Some(f64::from(f32::from_bits(bits as u32))),
            (2, 2) => Some(f64::from(bits as u16 as i16)),
            (4, 2) => Some(f64::from(bits as u32 as i32)),
            (4, 1) => Some(bits as f64),
            _ => None,
        }
    };
    let numbers = bytes.chunks_exact(each).map(value).collect::<Option<Vec<f64>>>();
    let numbers =
        numbers.ok_or_else(|| ImageError::NotGrey(format!("a stack of {bits} bits, format {format}")))?;
    Ok(Values::Numbers(array(shape.1, shape.0, numbers)?))
}

/// Locates the pixels in a file with uncompressed, directly readable codes.
fn plain_strips(decoder: &mut Tiff, bits: u8, shape: (usize, usize), frame: u64) -> Option<Strips> {
    let mut tag = |tag, usual: u64| Some(decoder.find_tag_unsigned::<u64>(tag).ok()?.unwrap_or(usual));
    // Requires: uncompressed, black is 0, unsigned, no predictor, strips instead of tiles.
    for of in [
        Tag::Compression,
        Tag::PhotometricInterpretation,
        Tag::SampleFormat,
        Tag::Predictor,
        Tag::SamplesPerPixel,
    ] {
        (tag(of, 1)? == 1).then_some(())?;
    }
    let reversed = tag(Tag::FillOrder, 1)? == 2;
    let offsets = decoder.get_tag_u64_vec(Tag::StripOffsets).ok()?;
    let bytes = decoder.get_tag_u64_vec(Tag::StripByteCounts).ok()?;
    let row = shape.1.checked_mul(usize::from(bits))?.div_ceil(8);
    let needed = shape.0.checked_mul(row)?;
    let at: Vec<(u64, usize)> = if frame == 0 {
        let pairs = offsets.into_iter().zip(bytes);
        pairs.map(|(o, b)| Some((o, usize::try_from(b).ok()?))).collect::<Option<_>>()?
    } else {
        vec![(offsets.first()?.checked_add(frame.checked_mul(needed as u64)?)?, needed)]
    };
    let there = at.iter().try_fold(0usize, |sum, s| sum.checked_add(s.1))?;
    // Offsets in the header may be wrong: they are checked against the file size.
    let size = decoder.inner().seek(SeekFrom::End(0)).ok()?;
    let inside = at.iter().all(|(o, b)| o.checked_add(*b as u64).is_some_and(|end| end <= size));
    (bits <= 16 && there == needed && inside).then_some(Strips { at, reversed })
}

/// Reads strips of codes into the buffer.
fn read_strips(
    decoder: &mut Tiff,
    strips: &Strips,
    bits: u8,
    shape: (usize, usize),
    buffer: &mut Buffer,
) -> Result<(), ImageError> {
    let pixels = shape.0 * shape.1;
    let row = (shape.1 * usize::from(bits)).div_ceil(8);
    let big = decoder.byte_order() == ByteOrder::BigEndian;
    let Buffer { dn, bytes, .. } = buffer;
    dn.resize(pixels, 0);
    let target: &mut [u8] = if bits == 16 {
        bytemuck::cast_slice_mut(dn)
    } else {
        bytes.resize(row * shape.0, 0);
        bytes
    };
    let file = decoder.inner().get_mut();
    let mut rest = &mut *target;
    for (offset, length) in &strips.at {
        let (strip, after) = rest.split_at_mut(*length);
        file.seek(SeekFrom::Start(*offset))?;
        file.read_exact(strip)?;
        rest = after;
    }
    if strips.reversed {
        target.iter_mut().for_each(|b| *b = b.reverse_bits());
    }
    match bits {
        16 if big != cfg!(target_endian = "big") => dn.iter_mut().for_each(|d| *d = d.swap_bytes()),
        16 => {}
        8 => dn.iter_mut().zip(bytes.iter()).for_each(|(d, b)| *d = u16::from(*b)),
        _ => unpack(bytes, row, shape.1, bits, dn),
    }
    buffer.shape = shape;
    Ok(())
}

/// Unpacks codes of any bit depth, most significant bit first; every row begins at a byte (TIFF 6.0,
/// section 3).
fn unpack(bytes: &[u8], row: usize, columns: usize, bits: u8, dn: &mut [u16]) {
    for (bytes, dn) in bytes.chunks_exact(row.max(1)).zip(dn.chunks_exact_mut(columns.max(1))) {
        let (mut held, mut have) = (0u32, 0u32);
        let mut next = bytes.iter();
        for d in dn {
            while have < u32::from(bits) {
                held = held << 8 | u32::from(next.next().copied().unwrap_or(0));
                have += 8;
            }
            have -= u32::from(bits);
            *d = (held >> have) as u16 & (u16::MAX >> (16 - bits));
        }
    }
}
