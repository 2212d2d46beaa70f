//! Tile-compressed FITS images (FITS standard 4.0, section 10): RICE_1, GZIP_1, GZIP_2 and NOCOMPRESS,
//! all lossless. Lossy compression (quantised floating-point numbers, HCOMPRESS) is refused by name.

use super::fits::{Bytes, Coding, number, text};
use super::{Cards, ImageError};
use flate2::read::GzDecoder;
use std::io::{Read, SeekFrom};
use std::sync::{Arc, Mutex, PoisonError};

/// Tile index along the third axis, and the scaled numbers of its planes.
type Layer = (usize, Vec<f64>);

/// Location of the tiles of an image.
#[derive(Debug, Clone)]
pub(super) struct Tiles {
    method: Method,
    /// Axes of the image and of a tile, the fastest first; three of each.
    axes: [usize; 3],
    tile: [usize; 3],
    /// First byte of the table, bytes per row, position of the descriptor in a row and bytes of its
    /// numbers.
    table_at: u64,
    row_bytes: usize,
    descriptor: (usize, usize),
    /// First byte of the heap and its end.
    heap: (u64, u64),
    /// Planes decompressed last, by tile index along the third axis.
    unpacked: Arc<Mutex<Option<Layer>>>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Method {
    /// Numbers per block, bytes per number.
    Rice(usize, usize),
    Gzip {
        shuffled: bool,
    },
    None,
}

/// Returns the value of a card that is a count.
fn count(cards: &Cards, keyword: &str, default: Option<f64>) -> Result<usize, ImageError> {
    let n = number(cards, keyword, default)?;
    let counts = n.fract() == 0.0 && (0.0..1e12).contains(&n);
    if counts { Ok(n as usize) } else { Err(ImageError::Fits(format!("{keyword} is {n}"))) }
}

/// Returns the bytes of a column of a binary table (table 18 of the standard); `None` for an unknown
/// letter.
fn column_bytes(form: &str) -> Option<usize> {
    let letter_at = form.find(|c: char| c.is_ascii_alphabetic())?;
    let repeat: usize = if letter_at == 0 { 1 } else { form[..letter_at].parse().ok()? };
    let each = match form.as_bytes().get(letter_at)? {
        b'X' => return Some(repeat.div_ceil(8)),
        b'L' | b'B' | b'A' => 1,
        b'I' => 2,
        b'J' | b'E' => 4,
        b'K' | b'D' | b'C' | b'P' => 8,
        b'M' | b'Q' => 16,
        _ => return None,
    };
    repeat.checked_mul(each)
}

impl Tiles {
    pub(super) fn new(
        cards: &Cards,
        table: &[usize],
        axes: &[usize],
        coding: &Coding,
        table_at: u64,
        size: u64,
    ) -> Result<Self, ImageError> {
        let fault = |message: String| ImageError::Fits(message);
        let &[row_bytes, rows] = table else {
            return Err(fault("a compressed image that is no table of two axes".into()));
        };
        if axes.len() > 3 {
            return Err(ImageError::NotGrey(format!("a compressed FITS of {} axes", axes.len())));
        }
        let mut lossy = cards.contains_key("ZSCALE");
        let mut descriptor = None;
        let mut place = 0;
        for k in 1..=count(cards, "TFIELDS", None)?.min(999) {
            let form = text(cards, &format!("TFORM{k}")).unwrap_or_default();
            let name = text(cards, &format!("TTYPE{k}")).unwrap_or_default();
            lossy |= name == "ZSCALE";
            if name == "COMPRESSED_DATA" {
                let kind = form.trim_start_matches(|c: char| c.is_ascii_digit());
                descriptor = match kind.as_bytes().first() {
                    Some(b'P') => Some((place, 4)),
                    Some(b'Q') => Some((place, 8)),
                    _ => None,
                };
            }
            let bytes = column_bytes(form).ok_or_else(|| fault(format!("TFORM{k} is '{form}'")))?;
            place = bytes.saturating_add(place);
        }
        if coding.bits < 0 && lossy {
            return Err(ImageError::NotGrey(
                "a FITS whose floating-point numbers were compressed with loss: their noise is not the camera's".into(),
            ));
        }
        let descriptor = descriptor.ok_or_else(|| fault("has no column COMPRESSED_DATA".into()))?;
        let method = match text(cards, "ZCMPTYPE").unwrap_or_default() {
            "RICE_1" | "RICE_ONE" => {
                let option = |name: &str, default: usize| {
                    let at = (1..9).find(|k| text(cards, &format!("ZNAME{k}")) == Some(name));
                    at.map_or(Ok(default), |k| count(cards, &format!("ZVAL{k}"), None))
                };
                Method::Rice(option("BLOCKSIZE", 32)?, option("BYTEPIX", 4)?)
            }
            "GZIP_1" => Method::Gzip { shuffled: false },
            "GZIP_2" => Method::Gzip { shuffled: true },
            "NOCOMPRESS" => Method::None,
            other => {
                return Err(ImageError::NotGrey(format!(
                    "a FITS compressed by {other}: unpack it (funpack)"
                )));
            }
        };
        let sound = match method {
            Method::Rice(block, bytes) => block > 0 && matches!(bytes, 1 | 2 | 4) && coding.bits > 0,
            _ => true,
        };
        let of = |axes: &[usize]| [axes[0], axes[1], axes.get(2).copied().unwrap_or(1)];
        let axes = of(axes);
        let mut tile = [axes[0], 1, 1];
        for (k, t) in tile.iter_mut().enumerate() {
            *t = count(cards, &format!("ZTILE{}", k + 1), Some(*t as f64))?.min(axes[k]);
        }
        let tiles = tile.iter().zip(axes).map(|(t, n)| n.div_ceil((*t).max(1)));
        if tile.contains(&0) || !sound || tiles.product::<usize>() != rows {
            return Err(fault(format!(
                "tiles of {tile:?} px do not make an image of {axes:?} px in {rows} rows"
            )));
        }
        let heap = count(cards, "THEAP", Some((row_bytes * rows) as f64))? as u64;
        let end = table_at + (row_bytes * rows) as u64;
        if end > size || descriptor.0.saturating_add(2 * descriptor.1) > row_bytes {
            return Err(fault(format!("cut short: {end} bytes are needed, {size} are there")));
        }
        Ok(Self {
            method,
            axes,
            tile,
            table_at,
            row_bytes,
            descriptor,
            heap: (table_at + heap, size),
            unpacked: Arc::default(),
        })
    }

    /// Returns the scaled numbers of one plane.
    pub(super) fn plane(
        &self,
        file: &mut dyn Bytes,
        plane: usize,
        coding: &Coding,
    ) -> Result<Vec<f64>, ImageError> {
        let (layer, pixels) = (plane / self.tile[2], self.axes[0] * self.axes[1]);
        let from = plane % self.tile[2] * pixels;
        // A tile that spans several planes is decompressed once, not once per plane.
        let mut kept = self.unpacked.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, numbers)) = kept.as_ref().filter(|(of, _)| *of == layer) {
            return Ok(numbers[from..from + pixels].to_vec());
        }
        let numbers = self.layer(file, layer, coding)?;
        let out = numbers[from..from + pixels].to_vec();
        *kept = (self.tile[2] > 1).then_some((layer, numbers));
        Ok(out)
    }

    /// Returns the scaled numbers of the planes that one tile spans.
    fn layer(&self, file: &mut dyn Bytes, layer: usize, coding: &Coding) -> Result<Vec<f64>, ImageError> {
        let [width, height, planes] = self.axes;
        let across: Vec<usize> = self.tile.iter().zip(self.axes).map(|(t, n)| n.div_ceil(*t)).collect();
        let depth = self.tile[2].min(planes - layer * self.tile[2]);
        let mut out = vec![f64::NAN; width * height * depth];
        for tile in 0..across[0] * across[1] {
            let (x, y) = (tile % across[0] * self.tile[0], tile / across[0] * self.tile[1]);
            let size = [self.tile[0].min(width - x), self.tile[1].min(height - y), depth];
            let pixels = size.iter().product();
            let bytes = self.tile_bytes(file, layer * across[0] * across[1] + tile)?;
            let numbers = self.unpacked_tile(&bytes, pixels, coding).ok_or_else(|| {
                ImageError::Fits(format!("damaged: tile {tile} does not unpack to {pixels} numbers"))
            })?;
            for (k, row) in numbers.chunks_exact(size[0]).enumerate() {
                let (z, row_at) = (k / size[1], y + k % size[1]);
                out[(z * height + row_at) * width + x..][..size[0]].copy_from_slice(row);
            }
        }
        Ok(out)
    }

    /// Returns the number of planes that one tile spans.
    pub(super) fn depth(&self) -> usize {
        self.tile[2]
    }

    fn tile_bytes(&self, file: &mut dyn Bytes, row: usize) -> Result<Vec<u8>, ImageError> {
        let (place, each) = self.descriptor;
        let mut descriptor = [0u8; 16];
        file.seek(SeekFrom::Start(self.table_at + (row * self.row_bytes + place) as u64))?;
        file.read_exact(&mut descriptor[..2 * each])?;
        let of = |b: &[u8]| b.iter().fold(0u64, |n, b| n << 8 | u64::from(*b));
        let (length, offset) = (of(&descriptor[..each]), of(&descriptor[each..2 * each]));
        let end = self.heap.0.checked_add(offset).and_then(|at| at.checked_add(length));
        if length == 0 || end.is_none_or(|end| end > self.heap.1) {
            return Err(ImageError::Fits(format!(
                "tile {row} has {length} bytes at {offset} of the heap, which are not there"
            )));
        }
        let mut bytes = vec![0; length as usize];
        file.seek(SeekFrom::Start(self.heap.0 + offset))?;
        file.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    /// Decompresses a tile into scaled numbers; `None` if its bytes do not hold that many.
    fn unpacked_tile(&self, bytes: &[u8], pixels: usize, coding: &Coding) -> Option<Vec<f64>> {
        let each = coding.bytes_each();
        let bytes = match self.method {
            Method::Rice(block, width) => {
                let numbers = rice(bytes, pixels, block, width)?;
                return Some(numbers.into_iter().map(|n| coding.scaled(n.into())).collect());
            }
            Method::Gzip { shuffled } => {
                // Reading one byte more than the tile size reveals a tile that is too long.
                let most = (pixels * each) as u64 + 1;
                let mut out = Vec::new();
                GzDecoder::new(bytes).take(most).read_to_end(&mut out).ok()?;
                let apart = |out: Vec<u8>| {
                    // GZIP_2 stores the first bytes of all numbers, then the second bytes, and so on.
                    let part = |i: usize| out[i % each * pixels + i / each];
                    (0..pixels * each).map(part).collect()
                };
                if shuffled && out.len() == pixels * each { apart(out) } else { out }
            }
            Method::None => bytes.to_vec(),
        };
        (bytes.len() == pixels * each).then(|| bytes.chunks_exact(each).map(|b| coding.value(b)).collect())
    }
}

/// Bit reader, most significant bit first.
struct Bits<'a> {
    bytes: std::slice::Iter<'a, u8>,
    held: u64,
    have: u32,
}

impl Bits<'_> {
    fn take(&mut self, n: u32) -> Option<u32> {
        while self.have < n {
            self.held = self.held << 8 | u64::from(*self.bytes.next()?);
            self.have += 8;
        }
        self.have -= n;
        Some((self.held >> self.have & ((1 << n) - 1)) as u32)
    }

    /// Counts zeros before the next one bit.
    fn zeros(&mut self) -> Option<u32> {
        let mut n = 0;
        while self.take(1)? == 0 {
            n += 1;
        }
        Some(n)
    }
}

/// Decodes a Rice-compressed tile (section 10.4.1): blocks of differences, each with its own number of
/// low bits. Numbers of 1 byte are unsigned, those of 2 and 4 are signed, as BITPIX defines them.
fn rice(bytes: &[u8], pixels: usize, block: usize, width: usize) -> Option<Vec<i32>> {
    let (split_bits, most) = match width {
        1 => (3, 6),
        2 => (4, 14),
        _ => (5, 25),
    };
    let bits = 8 * width as u32;
    let mut stream = Bits { bytes: bytes.iter(), held: 0, have: 0 };
    let mut last = stream.take(bits)?;
    // A pixel takes at least some bits, except in blocks of equal pixels: memory is bounded by the
    // actual bytes.
    let mut out = Vec::with_capacity(pixels.min(bytes.len() * 8 * block));
    while out.len() < pixels {
        let split = stream.take(split_bits)?;
        for _ in 0..block.min(pixels - out.len()) {
            let difference = match split {
                0 => 0,
                s if s == most + 1 => stream.take(bits)?,
                s => {
                    let high = stream.zeros()?;
                    high.checked_shl(s - 1)? | stream.take(s - 1)?
                }
            };
            // Even numbers are positive differences, odd ones negative.
            let step = if difference & 1 == 1 { !(difference >> 1) } else { difference >> 1 };
            last = last.wrapping_add(step);
            out.push(match width {
                1 => i32::from(last as u8),
                2 => i32::from(last as u16 as i16),
                _ => last as i32,
            });
        }
    }
    Some(out)
}
