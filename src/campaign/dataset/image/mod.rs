//! Grey images: reads TIFF (any page), PNG, BMP, FITS and HDF5; writes TIFF of 8 or 16 bits.

pub(crate) mod bmp_file;
mod fits;
mod fits_tiles;
mod grey;
#[cfg(feature = "hdf5")]
mod hdf5;
pub(crate) mod png_file;
mod tiff_file;

use crate::input;
use ndarray::{Array2, ArrayView2, s};
use std::io::{Cursor, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use tiff::encoder::{TiffEncoder, colortype};

/// Errors of reading or writing an image.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// Error of the file system.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// Damaged TIFF.
    #[error("not a sound TIFF: {}", tiff_words(.0))]
    Tiff(#[from] tiff::TiffError),
    /// Damaged PNG.
    #[error("not a sound PNG: {0}")]
    Png(#[from] png::DecodingError),
    /// Damaged BMP, or a kind of it that is not read.
    #[error("not a BMP that radcam reads: {0}")]
    Bmp(String),
    /// Damaged FITS.
    #[error("not a sound FITS: {0}")]
    Fits(String),
    /// Damaged HDF5.
    #[error("not a sound HDF5 (NeXus): {0}")]
    Hdf5(String),
    /// Valid, but not a grey image of unsigned 8 or 16 bits.
    #[error(
        "is {0}; frames are grey, with 8 or 16 unsigned bits: of a colour camera its raw pixels (BayerRG8, not RGB8)"
    )]
    NotGrey(String),
    /// Frames that cannot be identified, or a format that radcam does not read; with advice.
    #[error("is {0}")]
    NoFrames(String),
    /// Valid and grey, but with values that are not codes: value, row, column.
    #[error(
        "holds {0} at row {1}, column {2}, and codes are whole numbers from 0 to 65535; `radcam import` finds their step"
    )]
    NotCodes(f64, usize, usize),
    /// Page number that the file does not have.
    #[error("has no page {0} (pages count from 0)")]
    NoPage(usize),
    /// Stack, where a single frame is expected.
    #[error("is a stack of {0} pages or more, and one frame is asked for; `radcam import` takes stacks")]
    Stack(usize),
}

/// Magic bytes of a JPEG.
pub(crate) const JPEG: &[u8] = b"\xff\xd8\xff";
/// First bytes of a NumPy array.
pub(crate) const NUMPY: &[u8] = b"\x93NUMPY";
/// Reason that a NumPy array is refused.
const NO_NUMPY: &str =
    "a NumPy array, which `radcam import` takes; other verbs take frames as TIFF, PNG, BMP, FITS or HDF5";
/// Reason that a JPEG is refused.
pub(crate) const NO_JPEG: &str = "a JPEG, whose codes are not those of the camera";

/// Extensions of camera raw files.
const CAMERA_RAWS: [&str; 12] =
    ["cr2", "cr3", "crw", "nef", "nrw", "arw", "orf", "rw2", "raf", "pef", "srw", "3fr"];
/// Advice on camera raw files: LibRaw's program preserves every code and the masked borders.
pub(crate) const CAMERA_RAW: &str = "a camera raw file, which radcam does not read; `unprocessed_raw -T FILE` of LibRaw (or `dcraw -D -4 -T FILE`) writes its codes \
     as TIFF";

/// Returns true for the name of a camera raw file.
pub(crate) fn is_camera_raw(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    CAMERA_RAWS.contains(&&*extension)
}

/// Magic bytes of HDF5.
pub(crate) const HDF5: &[u8] = b"\x89HDF\r\n\x1a\n";
/// Reason that HDF5 is refused by a build without the feature.
#[cfg(not(feature = "hdf5"))]
const NO_HDF5: &str = "an HDF5 (NeXus) file, and this radcam was built without the feature hdf5; save its frames as TIFF or NumPy \
                       array";

/// Dataset of frames of an HDF5 file, with its metadata.
#[derive(Debug, Clone, Default)]
pub(crate) struct Stack {
    /// Names of the dataset in the file.
    pub(crate) paths: Vec<String>,
    /// Page of the first frame.
    pub(crate) first: usize,
    /// Number of frames.
    pub(crate) frames: usize,
    /// Image keys of the frames (NXtomo): 0 projection, 1 flat, 2 dark, 3 invalid; empty where there are
    /// none.
    pub(crate) keys: Vec<i64>,
    /// Named values of all frames, with units.
    pub(crate) said: Vec<(String, String)>,
    /// Named values, one for each frame.
    pub(crate) of_frames: Vec<(String, Vec<String>)>,
}

impl Stack {
    /// Expands values to one per frame, from one per frame or one per place on an outer axis; `None` for
    /// other counts.
    #[cfg(feature = "hdf5")]
    fn each(&self, values: Vec<f64>, outer: usize) -> Option<Vec<f64>> {
        let n = values.len();
        let repeated = self.frames / n.max(1);
        let fits = n > 0 && (n == self.frames || n == outer && n * repeated == self.frames);
        fits.then(|| values.into_iter().flat_map(|v| std::iter::repeat_n(v, repeated)).collect())
    }

    /// Returns the first name of the dataset.
    pub(crate) fn path(&self) -> &str {
        self.paths.first().map_or("", String::as_str)
    }
}

/// Describes a TIFF error; a truncated file is reported as such.
pub(crate) fn tiff_words(error: &tiff::TiffError) -> String {
    match error {
        tiff::TiffError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => {
            "cut short: the file ends before its pixels do".into()
        }
        tiff::TiffError::FormatError(tiff::TiffFormatError::TiffSignatureNotFound) => {
            "radcam reads TIFF, PNG, BMP, FITS, HDF5 and NumPy arrays, and it begins like none of them".into()
        }
        other => other.to_string(),
    }
}

/// Recycled frame buffer: faulting in new pages costs more than filling them.
#[derive(Debug, Default)]
pub struct Buffer {
    dn: Vec<u16>,
    bytes: Vec<u8>,
    /// Rows and columns.
    shape: (usize, usize),
}

impl Buffer {
    /// Returns the codes, row by row, DN.
    pub fn dn(&self) -> &[u16] {
        &self.dn
    }

    /// Returns rows and columns.
    pub fn shape(&self) -> (usize, usize) {
        self.shape
    }

    /// Converts to an array of (rows, columns).
    pub fn into_array(self) -> Array2<u16> {
        // Every reader leaves exactly as many codes as the shape needs.
        Array2::from_shape_vec(self.shape, self.dn).unwrap_or_default()
    }

    /// Crops to these rows and columns. Does nothing if the image does not have them.
    pub fn crop(&mut self, rows: &std::ops::Range<usize>, columns: &std::ops::Range<usize>) {
        let (height, width) = self.shape;
        if rows.end > height || columns.end > width || self.dn.len() != height * width {
            return;
        }
        let mut to = 0;
        for y in rows.clone() {
            let from = y * width;
            self.dn.copy_within(from + columns.start..from + columns.end, to);
            to += columns.len();
        }
        self.dn.truncate(to);
        self.shape = (rows.len(), columns.len());
    }

    /// Keeps the pixel at this row and column of every 2 x 2 cell.
    pub(super) fn keep_plane(&mut self, [y, x]: [u8; 2]) {
        let (rows, columns) = self.shape;
        let half = |pixels: usize, from: u8| pixels.saturating_sub(from.into()).div_ceil(2);
        let shape = (half(rows, y), half(columns, x));
        let mut at = 0;
        for row in (usize::from(y)..rows).step_by(2) {
            for column in (usize::from(x)..columns).step_by(2) {
                // `at` never overtakes the read position.
                self.dn[at] = self.dn[row * columns + column];
                at += 1;
            }
        }
        self.dn.truncate(at);
        self.shape = shape;
    }

    fn set(&mut self, image: Array2<u16>) {
        self.shape = image.dim();
        self.dn.clear();
        self.dn.extend(image.iter());
    }
}

/// Pixel values of one frame as stored in its file.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Codes that fit into 16 bits.
    Codes(Array2<u16>),
    /// Signed, wider or floating-point numbers.
    Numbers(Array2<f64>),
}

impl Values {
    /// Converts to codes if all values are whole and fit into 16 bits.
    #[must_use]
    pub fn as_codes(self) -> Self {
        match self {
            Self::Numbers(numbers) if numbers.iter().all(is_code) => Self::Codes(numbers.mapv(|v| v as u16)),
            other => other,
        }
    }

    /// Returns these rows and columns. They must exist.
    #[must_use]
    pub fn region(self, rows: std::ops::Range<usize>, columns: std::ops::Range<usize>) -> Self {
        match self {
            Self::Codes(codes) => Self::Codes(codes.slice(s![rows, columns]).to_owned()),
            Self::Numbers(numbers) => Self::Numbers(numbers.slice(s![rows, columns]).to_owned()),
        }
    }

    /// Returns the mean of all pixels.
    pub fn mean(&self) -> f64 {
        match self {
            Self::Codes(codes) => {
                codes.iter().map(|v| f64::from(*v)).sum::<f64>() / codes.len().max(1) as f64
            }
            Self::Numbers(numbers) => numbers.mean().unwrap_or(f64::NAN),
        }
    }
}

fn is_code(v: &f64) -> bool {
    (0.0..=65_535.0).contains(v) && v.fract() == 0.0
}

/// Reads one page as (rows, columns) of DN. The format is determined by magic bytes, not by the file
/// name.
///
/// For many pages of a long stack use one [`Images`].
///
/// # Errors
///
/// The file cannot be read or has no such page, or its pixels are not codes of up to 16 bits.
pub fn read(path: &Path, page: usize) -> Result<Array2<u16>, ImageError> {
    let mut buffer = Buffer::default();
    Images::open(path)?.read_into(page, &mut buffer)?;
    Ok(buffer.into_array())
}

/// Reads a file that has a single frame; a stack is refused, because no page is named.
///
/// # Errors
///
/// As [`read`], and for a file with several pages.
pub fn read_single(path: &Path) -> Result<Array2<u16>, ImageError> {
    let mut buffer = Buffer::default();
    read_into(path, None, &mut buffer)?;
    Ok(buffer.into_array())
}

/// Reads one page, or the only one, into a recycled buffer.
///
/// # Errors
///
/// As [`read`], and if no page is named and the file has several.
pub fn read_into(path: &Path, page: Option<usize>, buffer: &mut Buffer) -> Result<(), ImageError> {
    let images = Images::open(path)?;
    let page = page.map_or_else(|| images.single(), Ok)?;
    images.read_into(page, buffer)
}

/// Image file with known structure: pages are read in any order without a walk through the preceding
/// ones.
#[derive(Debug, Clone)]
pub struct Images {
    path: PathBuf,
    kind: Container,
}

#[derive(Debug, Clone)]
enum Container {
    Tiff(tiff_file::Directories),
    Png,
    Bmp,
    Fits(fits::Fits),
    #[cfg(feature = "hdf5")]
    Hdf5(Arc<hdf5::Hdf5>),
}

impl Images {
    /// Reads the structure of a file.
    ///
    /// # Errors
    ///
    /// The file cannot be read, or has a format that radcam does not read.
    pub fn open(path: &Path) -> Result<Self, ImageError> {
        Self::open_with(path, None, None)
    }

    /// As `open`; for an HDF5 file with the chosen dataset and the axis that counts its frames.
    pub(crate) fn open_with(
        path: &Path,
        dataset: Option<&str>,
        axis: Option<usize>,
    ) -> Result<Self, ImageError> {
        if is_camera_raw(path) {
            return Err(ImageError::NoFrames(CAMERA_RAW.into()));
        }
        let start = &*input::start(path, 8)?;
        let kind = if start.starts_with(JPEG) {
            return Err(ImageError::NotGrey(NO_JPEG.into()));
        } else if start.starts_with(NUMPY) {
            return Err(ImageError::NoFrames(NO_NUMPY.into()));
        } else if start.starts_with(HDF5) {
            open_hdf5(path, dataset, axis)?
        } else if start.starts_with(b"\x89PNG") {
            Container::Png
        } else if start.starts_with(bmp_file::BMP) {
            Container::Bmp
        } else if begins_as_fits(start) {
            Container::Fits(fits::Fits::open(path)?)
        } else {
            Container::Tiff(tiff_file::Directories::read(path)?)
        };
        Ok(Self { path: path.into(), kind })
    }

    /// Returns the numbers of the pages that are frames; thumbnails and masks are excluded.
    pub fn frames(&self) -> Vec<usize> {
        match &self.kind {
            Container::Tiff(directories) => directories.frames(),
            Container::Png | Container::Bmp => vec![0],
            Container::Fits(fits) => (0..fits.pages()).collect(),
            #[cfg(feature = "hdf5")]
            Container::Hdf5(file) => (0..file.pages()).collect(),
        }
    }

    /// Returns the frame datasets of an HDF5 file; empty for other formats.
    pub(crate) fn stacks(&self) -> Vec<Stack> {
        match &self.kind {
            #[cfg(feature = "hdf5")]
            Container::Hdf5(file) => file.stacks().cloned().collect(),
            _ => Vec::new(),
        }
    }

    /// Returns true for a frame of an HDF5 file that was never written: its chunks hold only the fill
    /// value.
    pub(crate) fn is_blank(&self, page: usize, values: &Values) -> bool {
        match &self.kind {
            #[cfg(feature = "hdf5")]
            Container::Hdf5(file) => file.is_blank(page, values),
            _ => {
                let _ = (page, values);
                false
            }
        }
    }

    /// Returns true for a FITS with several planes.
    pub(crate) fn is_cube(&self) -> bool {
        matches!(&self.kind, Container::Fits(fits) if fits.pages() > 1)
    }

    /// Returns true if every dataset reader can read the file: TIFF, grey PNG, and FITS with a primary image
    /// of one frame.
    pub(crate) fn is_plain(&self) -> bool {
        match &self.kind {
            Container::Tiff(directories) => directories.is_plain(),
            // The colour type of the IHDR chunk (PNG specification, 11.2.2): 0 is grey.
            Container::Png => input::start(&self.path, 26).is_ok_and(|start| start.get(25) == Some(&0)),
            Container::Bmp => false,
            Container::Fits(fits) => fits.is_plain(),
            #[cfg(feature = "hdf5")]
            Container::Hdf5(_) => false,
        }
    }

    /// Returns true if the file marks the pixels of a page as a colour-filter mosaic.
    pub fn is_mosaic(&self, page: usize) -> bool {
        matches!(&self.kind, Container::Tiff(directories) if directories.is_mosaic(page))
    }

    /// Returns the bits per pixel in the file, as [`stored_bits`].
    ///
    /// # Errors
    ///
    /// The file cannot be read.
    pub fn stored_bits(&self) -> Result<u8, ImageError> {
        match &self.kind {
            Container::Png => {
                // The bit depth of the IHDR chunk (PNG specification, 11.2.2).
                Ok(input::start(&self.path, 26)?.get(24).copied().unwrap_or(8).max(8))
            }
            Container::Bmp => Ok(8),
            Container::Fits(fits) => Ok(fits.bits()),
            #[cfg(feature = "hdf5")]
            Container::Hdf5(file) => Ok(file.bits()),
            Container::Tiff(directories) => {
                let page = directories.frames().first().copied().unwrap_or(0);
                Ok(directories.decoder(&self.path, page)?.colortype()?.bit_depth())
            }
        }
    }

    /// Reads the values of one page as stored.
    ///
    /// # Errors
    ///
    /// There is no such page, or it cannot be read.
    pub fn values(&self, page: usize) -> Result<Values, ImageError> {
        let mut buffer = Buffer::default();
        match self.fill(page, &mut buffer)? {
            Some(values) => Ok(values),
            None => Ok(Values::Codes(buffer.into_array())),
        }
    }

    /// Reads the codes of one page into a recycled buffer.
    ///
    /// # Errors
    ///
    /// As [`values`](Self::values), and if the values are not codes of up to 16 bits.
    pub fn read_into(&self, page: usize, buffer: &mut Buffer) -> Result<(), ImageError> {
        if let Some(values) = self.fill(page, buffer)? {
            buffer.set(narrowed(values)?);
        }
        Ok(())
    }

    /// Returns the page of a file that has a single frame.
    fn single(&self) -> Result<usize, ImageError> {
        match &self.kind {
            Container::Tiff(directories) => directories.single(&self.path),
            Container::Fits(fits) if fits.pages() > 1 => Err(ImageError::Stack(fits.pages())),
            #[cfg(feature = "hdf5")]
            Container::Hdf5(file) if file.pages() > 1 => Err(ImageError::Stack(file.pages())),
            _ => Ok(0),
        }
    }

    /// Reads codes into the buffer; returns any other values.
    fn fill(&self, page: usize, buffer: &mut Buffer) -> Result<Option<Values>, ImageError> {
        match &self.kind {
            Container::Tiff(directories) => directories.page(&self.path, page, buffer),
            Container::Png => {
                first_page_only(page)?;
                png_file::read(&self.path, buffer).map(|()| None)
            }
            Container::Bmp => {
                first_page_only(page)?;
                bmp_file::read(&self.path, buffer).map(|()| None)
            }
            Container::Fits(fits) => fits.values(page).map(Some),
            #[cfg(feature = "hdf5")]
            Container::Hdf5(file) => file.values(page).map(Some),
        }
    }
}

#[cfg(feature = "hdf5")]
fn open_hdf5(path: &Path, dataset: Option<&str>, axis: Option<usize>) -> Result<Container, ImageError> {
    Ok(Container::Hdf5(Arc::new(hdf5::Hdf5::open(path, dataset, axis)?)))
}

#[cfg(not(feature = "hdf5"))]
fn open_hdf5(_: &Path, _: Option<&str>, _: Option<usize>) -> Result<Container, ImageError> {
    Err(ImageError::NoFrames(NO_HDF5.into()))
}

/// Cache of opened image files: the structure of a stack is read once, not once per page.
#[derive(Debug, Default)]
pub(crate) struct Opened(Mutex<Vec<Arc<Images>>>);

impl Opened {
    /// Maximum number of cached stacks: sets are read in sequence, on as many threads as there are
    /// cores.
    const MAX_FILES: usize = 64;

    /// Returns a stack from the cache, or opens it.
    pub(crate) fn stack(&self, path: &Path) -> Result<Arc<Images>, ImageError> {
        let mut kept = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(known) = kept.iter().find(|images| images.path == path) {
            return Ok(known.clone());
        }
        let images = Arc::new(Images::open(path)?);
        if kept.len() == Self::MAX_FILES {
            kept.remove(0);
        }
        kept.push(images.clone());
        Ok(images)
    }
}

/// Converts values to codes.
fn narrowed(values: Values) -> Result<Array2<u16>, ImageError> {
    let numbers = match values {
        Values::Codes(codes) => return Ok(codes),
        Values::Numbers(numbers) => numbers,
    };
    match numbers.indexed_iter().find(|(_, v)| !is_code(v)) {
        None => Ok(numbers.mapv(|v| v as u16)),
        Some(((y, x), v)) => Err(ImageError::NotCodes(*v, y, x)),
    }
}

/// Opens the TIFF decoder at the first directory, for its tags.
pub(crate) fn tiff_head(path: &Path) -> Result<tiff_file::Tiff, ImageError> {
    tiff_directories(path)?.decoder(path, 0)
}

/// Reads the directories of a TIFF file, each of which can be opened.
pub(crate) fn tiff_directories(path: &Path) -> Result<tiff_file::Directories, ImageError> {
    tiff_file::Directories::read(path)
}

/// Returns true for the magic bytes of a FITS file, gzipped or not.
pub(crate) fn begins_as_fits(start: &[u8]) -> bool {
    start.starts_with(b"SIMPLE") || start.starts_with(fits::GZIP)
}

/// Returns the bits per pixel in the file, 8, 16 or 32: an upper limit for the bit depth.
///
/// # Errors
///
/// The file cannot be read.
pub fn stored_bits(path: &Path) -> Result<u8, ImageError> {
    Images::open(path)?.stored_bits()
}

/// Returns true if a frame exceeds the memory that a compressed file of this size may unpack to; `each`:
/// bytes per pixel in memory.
fn is_packed_too_much(width: u64, height: u64, each: u64, size: u64) -> bool {
    width.saturating_mul(height).saturating_mul(each) > input::max_unpacked_bytes(size)
}

/// Describes the reason that such a file is refused.
fn too_much(width: usize, height: usize, size: u64) -> String {
    format!(
        "{width} x {height} px in {size} bytes: large images are packed 64 to 1 at most; save as plain TIFF"
    )
}

fn first_page_only(page: usize) -> Result<(), ImageError> {
    if page == 0 { Ok(()) } else { Err(ImageError::NoPage(page)) }
}

fn array<T>(width: usize, height: usize, pixels: Vec<T>) -> Result<Array2<T>, ImageError> {
    let found = pixels.len();
    Array2::from_shape_vec((height, width), pixels)
        .map_err(|_| ImageError::NotGrey(format!("{width} x {height} px with {found} values")))
}

/// Size of a FITS record and of a card in it, bytes (FITS standard 4.0, sections 3.1 and 4.1).
const FITS_RECORD: usize = 2880;
const FITS_CARD: usize = 80;

type Cards = std::collections::HashMap<String, String>;

/// Decodes the text of a card: ASCII by the standard, but programs write a micro sign as UTF-8 or
/// Latin-1.
pub(crate) fn card_text(card: &[u8]) -> String {
    std::str::from_utf8(card).map_or_else(|_| card.iter().map(|b| char::from(*b)).collect(), String::from)
}

/// Parses the cards of a FITS header that have a value, strings in their quotes; also returns the end of
/// the header.
fn cards_of(bytes: &[u8]) -> Result<(Cards, usize), ImageError> {
    let fault = |message: &str| ImageError::Fits(message.into());
    let mut values = Cards::new();
    for (i, card) in bytes.chunks_exact(FITS_CARD).enumerate() {
        if !card.iter().take(8).all(u8::is_ascii) {
            return Err(fault("the header is not text"));
        }
        let card = &card_text(card);
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

/// Reads the header of a FITS file; for an image in an extension its own header followed by the primary
/// one.
pub(crate) fn fits_header(path: &Path) -> Result<Vec<u8>, ImageError> {
    Ok(fits::Fits::open(path)?.header)
}

/// Writes a frame as an uncompressed TIFF, 8 bits deep if `bit_depth` is at most 8, else 16.
///
/// # Errors
///
/// The output cannot be written.
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

/// Returns the bytes of [`write_tiff`].
///
/// # Errors
///
/// The output cannot be written.
pub fn tiff_bytes(pixels: &Array2<u16>, bit_depth: u8) -> Result<Vec<u8>, ImageError> {
    let mut out = Cursor::new(Vec::with_capacity(pixels.len() * 2 + 1024));
    write_tiff(&mut out, pixels, bit_depth)?;
    Ok(out.into_inner())
}

/// Converts a text to ASCII, as TIFF requires: other characters are escaped as in JSON.
pub(crate) fn ascii(text: &str) -> String {
    let escaped = |c: char| {
        let mut units = [0; 2];
        c.encode_utf16(&mut units).iter().map(|u| format!("\\u{u:04x}")).collect::<String>()
    };
    text.chars().map(|c| if c.is_ascii() { c.to_string() } else { escaped(c) }).collect()
}

/// Returns the bytes of an uncompressed single-page TIFF with an ImageDescription that gives the meaning
/// of the numbers.
///
/// # Errors
///
/// The output cannot be written.
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

    fn read_fits(bytes: &[u8]) -> Result<Array2<u16>, ImageError> {
        narrowed(fits::Fits::of_bytes(bytes)?.values(0)?)
    }

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
            let mut encoder = TiffEncoder::new(std::fs::File::create(&path).unwrap()).unwrap();
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
        fn no_bytes_make_the_readers_panic(bytes in prop::collection::vec(any::<u8>(), 0..400), kind in 0usize..5) {
            let start: &[u8] = [&b"SIMPLE  "[..], b"\x89PNG\r\n\x1a\n", b"II*\0", b"BM", b""][kind];
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
