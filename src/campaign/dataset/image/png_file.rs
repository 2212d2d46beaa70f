//! PNG reader: grey frames of 8 or 16 bits, also in colours that are equal, row by row. Colour profiles and
//! texts are skipped, not decompressed.

use super::{Buffer, ImageError, grey, is_packed_too_much, too_much};
use crate::input;
use png::{BitDepth, ColorType, Decoder, Transformations};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Opens a decoder that ignores colour profiles; texts stay as stored, also compressed ones.
pub(crate) fn decoder(path: &Path) -> std::io::Result<Decoder<BufReader<File>>> {
    let mut decoder = Decoder::new(BufReader::with_capacity(1 << 16, input::open(path)?));
    // A megabyte of compressed profile can expand to a gigabyte.
    decoder.set_ignore_iccp_chunk(true);
    Ok(decoder)
}

/// Reads the frame of a file.
pub(super) fn read(path: &Path, buffer: &mut Buffer) -> Result<(), ImageError> {
    let size = std::fs::metadata(path)?.len();
    let mut decoder = decoder(path)?;
    decoder.set_ignore_text_chunk(true);
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info()?;
    let (colour, depth) = reader.output_color_type();
    let bits = if depth == BitDepth::Sixteen { 16 } else { 8 };
    if reader.info().color_type == ColorType::Indexed {
        return Err(ImageError::NotGrey("a PNG with a palette".into()));
    }
    let channels = colour.samples();
    let in_colours = || ImageError::NotGrey(format!("a PNG of {colour:?}, {bits} bits each"));
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    // Codes take 16 bits in memory.
    if is_packed_too_much(width as u64, height as u64, 2, size) {
        return Err(ImageError::NoFrames(format!("a PNG of {}", too_much(width, height, size))));
    }
    let row_bytes = reader.output_line_size(width as u32).unwrap_or(usize::MAX);
    buffer.dn.clear();
    if reader.info().interlaced {
        buffer.bytes.resize(row_bytes.saturating_mul(height), 0);
        reader.next_frame(&mut buffer.bytes)?;
        if !grey::put(&buffer.bytes, channels, bits, &mut buffer.dn) {
            return Err(in_colours());
        }
    } else {
        // Memory grows with the rows read, not with the height claimed by the header.
        buffer.bytes.resize(row_bytes, 0);
        for _ in 0..height {
            reader.read_row(&mut buffer.bytes)?;
            if !grey::put(&buffer.bytes, channels, bits, &mut buffer.dn) {
                return Err(in_colours());
            }
        }
    }
    buffer.shape = (height, width);
    Ok(())
}
