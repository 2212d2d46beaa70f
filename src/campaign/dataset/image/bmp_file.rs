//! BMP reader: grey frames of 8 bits, with a palette of all greys or in colours that are equal.

use super::{Buffer, ImageError, grey, is_packed_too_much, too_much};
use crate::input;
use image::ImageDecoder;
use image::codecs::bmp::BmpDecoder;
use std::io::BufReader;
use std::path::Path;

/// Magic bytes of a BMP.
pub(crate) const BMP: &[u8] = b"BM";

/// Reads the frame of a file.
pub(super) fn read(path: &Path, buffer: &mut Buffer) -> Result<(), ImageError> {
    let fault = |e: image::ImageError| ImageError::Bmp(e.to_string());
    let size = std::fs::metadata(path)?.len();
    let decoder = BmpDecoder::new(BufReader::with_capacity(1 << 16, input::open(path)?)).map_err(fault)?;
    let bits = bits(path)?;
    let is_ramp = |palette: &[[u8; 3]]| (0..=u8::MAX).zip(palette).all(|(k, grey)| *grey == [k; 3]);
    match (bits, decoder.get_palette()) {
        (8, Some(palette)) if !is_ramp(palette) => {
            let why =
                "a BMP with a palette, and the camera's code may be its index or its grey; save without one";
            return Err(ImageError::NotGrey(why.into()));
        }
        (8 | 24 | 32, _) => (),
        _ => return Err(ImageError::NotGrey(format!("a BMP of {bits} bits"))),
    }
    let (width, height) = decoder.dimensions();
    let (width, height) = (width as usize, height as usize);
    let channels = usize::from(decoder.color_type().channel_count());
    if is_packed_too_much(width as u64, height as u64, 2 + channels as u64, size) {
        return Err(ImageError::NoFrames(format!("a BMP of {}", too_much(width, height, size))));
    }
    buffer.bytes.resize(width.saturating_mul(height).saturating_mul(channels), 0);
    decoder.read_image(&mut buffer.bytes).map_err(fault)?;
    buffer.dn.clear();
    buffer.dn.reserve(width * height);
    if !grey::put(&buffer.bytes, channels, 8, &mut buffer.dn) {
        return Err(ImageError::NotGrey("a BMP in colours, 8 bits each".into()));
    }
    buffer.shape = (height, width);
    Ok(())
}

/// Returns the bits of a pixel (biBitCount; in a header of 12 bytes bcBitCount).
fn bits(path: &Path) -> std::io::Result<u16> {
    let start = input::start(path, 30)?;
    let of = |at: usize| start.get(at..at + 2).map_or(0, |b| u16::from_le_bytes([b[0], b[1]]));
    Ok(of(if of(14) == 12 { 24 } else { 28 }))
}
