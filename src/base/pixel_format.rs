//! Pixel formats of the Pixel Format Naming Convention (PFNC), and the conversion of their bytes to DN.
//!
//! One row of the table below is one format. A new format is a new row.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Monochrome or Bayer-mosaic pixel format. Bayer frames are kept as mosaics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct PixelFormat(usize);

type Unpack = fn(&[u8], &mut [u16]);
type Pack = fn(&[u16], &mut [u8]);

/// Properties of one format.
struct Row {
    name: &'static str,
    /// PFNC code, as GigE Vision and USB3 Vision send it.
    code: u32,
    /// Significant bits of a pixel.
    bits: u8,
    unpack: Unpack,
    pack: Pack,
}

const fn row(name: &'static str, code: u32, bits: u8, unpack: Unpack, pack: Pack) -> Row {
    Row { name, code, bits, unpack, pack }
}

/// Codes: GenICam Pixel Format Naming Convention 2.4 and its table of values.
const TABLE: &[Row] = &[
    row("Mono8", 0x0108_0001, 8, unpack_8, pack_8),
    row("Mono10", 0x0110_0003, 10, unpack_16, pack_16),
    row("Mono12", 0x0110_0005, 12, unpack_16, pack_16),
    row("Mono14", 0x0110_0025, 14, unpack_16, pack_16),
    row("Mono16", 0x0110_0007, 16, unpack_16, pack_16),
    row("Mono10p", 0x010A_0046, 10, unpack_10p, pack_10p),
    row("Mono12p", 0x010C_0047, 12, unpack_12p, pack_12p),
    row("Mono10Packed", 0x010C_0004, 10, unpack_10_packed, pack_10_packed),
    row("Mono12Packed", 0x010C_0006, 12, unpack_12_packed, pack_12_packed),
    row("BayerGR8", 0x0108_0008, 8, unpack_8, pack_8),
    row("BayerRG8", 0x0108_0009, 8, unpack_8, pack_8),
    row("BayerGB8", 0x0108_000A, 8, unpack_8, pack_8),
    row("BayerBG8", 0x0108_000B, 8, unpack_8, pack_8),
    row("BayerGR10", 0x0110_000C, 10, unpack_16, pack_16),
    row("BayerRG10", 0x0110_000D, 10, unpack_16, pack_16),
    row("BayerGB10", 0x0110_000E, 10, unpack_16, pack_16),
    row("BayerBG10", 0x0110_000F, 10, unpack_16, pack_16),
    row("BayerGR12", 0x0110_0010, 12, unpack_16, pack_16),
    row("BayerRG12", 0x0110_0011, 12, unpack_16, pack_16),
    row("BayerGB12", 0x0110_0012, 12, unpack_16, pack_16),
    row("BayerBG12", 0x0110_0013, 12, unpack_16, pack_16),
    row("BayerGR16", 0x0110_002E, 16, unpack_16, pack_16),
    row("BayerRG16", 0x0110_002F, 16, unpack_16, pack_16),
    row("BayerGB16", 0x0110_0030, 16, unpack_16, pack_16),
    row("BayerBG16", 0x0110_0031, 16, unpack_16, pack_16),
    row("BayerGR10p", 0x010A_0056, 10, unpack_10p, pack_10p),
    row("BayerRG10p", 0x010A_0058, 10, unpack_10p, pack_10p),
    row("BayerGB10p", 0x010A_0054, 10, unpack_10p, pack_10p),
    row("BayerBG10p", 0x010A_0052, 10, unpack_10p, pack_10p),
    row("BayerGR12p", 0x010C_0057, 12, unpack_12p, pack_12p),
    row("BayerRG12p", 0x010C_0059, 12, unpack_12p, pack_12p),
    row("BayerGB12p", 0x010C_0055, 12, unpack_12p, pack_12p),
    row("BayerBG12p", 0x010C_0053, 12, unpack_12p, pack_12p),
    row("BayerGR10Packed", 0x010C_0026, 10, unpack_10_packed, pack_10_packed),
    row("BayerRG10Packed", 0x010C_0027, 10, unpack_10_packed, pack_10_packed),
    row("BayerGB10Packed", 0x010C_0028, 10, unpack_10_packed, pack_10_packed),
    row("BayerBG10Packed", 0x010C_0029, 10, unpack_10_packed, pack_10_packed),
    row("BayerGR12Packed", 0x010C_002A, 12, unpack_12_packed, pack_12_packed),
    row("BayerRG12Packed", 0x010C_002B, 12, unpack_12_packed, pack_12_packed),
    row("BayerGB12Packed", 0x010C_002C, 12, unpack_12_packed, pack_12_packed),
    row("BayerBG12Packed", 0x010C_002D, 12, unpack_12_packed, pack_12_packed),
];

/// Name or code that is not in the table.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("pixel format {0} is not supported; supported are {names}", names = PixelFormat::names().join(", "))]
pub struct UnknownFormat(String);

/// Wrong length of the bytes of a frame.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{pixels} pixels of {format} are {expected} bytes, and {found} came")]
pub struct WrongLength {
    format: PixelFormat,
    pixels: usize,
    expected: usize,
    found: usize,
}

impl PixelFormat {
    /// Mono16, the format of frames that radcam itself passes on.
    pub const MONO16: Self = Self(4);

    /// Returns every format.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..TABLE.len()).map(Self)
    }

    fn names() -> Vec<&'static str> {
        TABLE.iter().map(|row| row.name).collect()
    }

    fn row(self) -> &'static Row {
        &TABLE[self.0]
    }

    /// Finds the format of a PFNC name, such as `Mono12p`.
    ///
    /// ```
    /// use radcam::pixel_format::PixelFormat;
    /// let format = PixelFormat::from_name("Mono12Packed")?;
    /// let mut dn = [0u16; 2];
    /// format.unpack(&[0xAB, 0x6C, 0x45], &mut dn)?; // most significant bits first
    /// assert_eq!(dn, [0xABC, 0x456]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    ///
    /// radcam cannot unpack a format of this name.
    pub fn from_name(name: &str) -> Result<Self, UnknownFormat> {
        Self::all().find(|f| f.name() == name).ok_or_else(|| UnknownFormat(format!("\"{name}\"")))
    }

    /// Finds the format of a PFNC code.
    ///
    /// # Errors
    ///
    /// radcam cannot unpack a format of this code.
    pub fn from_code(code: u32) -> Result<Self, UnknownFormat> {
        Self::all().find(|f| f.code() == code).ok_or_else(|| UnknownFormat(format!("{code:#010x}")))
    }

    /// Returns the format of the same pixels with whole bytes per pixel.
    pub fn unpacked(self) -> Self {
        let name = self.name();
        let plain = name.trim_end_matches("Packed").trim_end_matches('p');
        Self::from_name(plain).unwrap_or(self)
    }

    /// Returns true for a colour mosaic of two by two pixels.
    pub fn is_mosaic(self) -> bool {
        self.name().starts_with("Bayer")
    }

    /// Returns the PFNC name.
    pub fn name(self) -> &'static str {
        self.row().name
    }

    /// Returns the PFNC code.
    pub fn code(self) -> u32 {
        self.row().code
    }

    /// Returns the significant bits of a pixel; codes run from 0 to 2^bits - 1.
    pub fn bits(self) -> u8 {
        self.row().bits
    }

    /// Returns the largest code, DN.
    pub fn full_scale_dn(self) -> u16 {
        ((1u32 << self.bits()) - 1) as u16
    }

    /// Returns the bits of a pixel on the wire: the third byte of a PFNC code.
    pub fn bits_per_pixel(self) -> usize {
        (self.code() >> 16 & 0xFF) as usize
    }

    /// Returns the bytes of this number of pixels, rounded up.
    pub fn payload(self, pixels: usize) -> usize {
        (pixels * self.bits_per_pixel()).div_ceil(8)
    }

    /// Converts the bytes of a frame to codes in DN.
    ///
    /// # Errors
    ///
    /// The two lengths do not match.
    pub fn unpack(self, bytes: &[u8], dn: &mut [u16]) -> Result<(), WrongLength> {
        self.check(bytes.len(), dn.len())?;
        (self.row().unpack)(bytes, dn);
        Ok(())
    }

    /// Converts codes to the bytes of a frame; the inverse of [`unpack`](Self::unpack).
    ///
    /// # Errors
    ///
    /// The two lengths do not match.
    pub fn pack(self, dn: &[u16], bytes: &mut [u8]) -> Result<(), WrongLength> {
        self.check(bytes.len(), dn.len())?;
        (self.row().pack)(dn, bytes);
        Ok(())
    }

    /// Converts as [`unpack`](Self::unpack) does, for lengths that were checked.
    pub(crate) fn unpack_checked(self, bytes: &[u8], dn: &mut [u16]) {
        (self.row().unpack)(bytes, dn);
    }

    pub(crate) fn check(self, found: usize, pixels: usize) -> Result<(), WrongLength> {
        let expected = self.payload(pixels);
        if found == expected { Ok(()) } else { Err(WrongLength { format: self, pixels, expected, found }) }
    }
}

impl fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl TryFrom<String> for PixelFormat {
    type Error = UnknownFormat;
    fn try_from(name: String) -> Result<Self, UnknownFormat> {
        Self::from_name(&name)
    }
}

impl From<PixelFormat> for String {
    fn from(format: PixelFormat) -> Self {
        format.name().into()
    }
}

fn unpack_8(bytes: &[u8], dn: &mut [u16]) {
    for (d, &b) in dn.iter_mut().zip(bytes) {
        *d = b.into();
    }
}

fn pack_8(dn: &[u16], bytes: &mut [u8]) {
    for (b, &d) in bytes.iter_mut().zip(dn) {
        *b = d as u8;
    }
}

/// Unpacks little-endian words with the code in the low bits.
fn unpack_16(bytes: &[u8], dn: &mut [u16]) {
    let (words, _) = bytes.as_chunks::<2>();
    for (d, &w) in dn.iter_mut().zip(words) {
        *d = u16::from_le_bytes(w);
    }
}

fn pack_16(dn: &[u16], bytes: &mut [u8]) {
    let (words, _) = bytes.as_chunks_mut::<2>();
    for (w, d) in words.iter_mut().zip(dn) {
        *w = d.to_le_bytes();
    }
}

/// Unpacks groups of `N` pixels in `B` bytes; a last, incomplete group is padded with zeros.
fn unpack_groups<const B: usize, const N: usize>(
    bytes: &[u8],
    dn: &mut [u16],
    group: impl Fn([u8; B]) -> [u16; N],
) {
    let (full, rest) = bytes.as_chunks::<B>();
    let (groups, tail) = dn.as_chunks_mut::<N>();
    for (pixels, &bytes) in groups.iter_mut().zip(full) {
        *pixels = group(bytes);
    }
    if !tail.is_empty() {
        let mut padded = [0; B];
        padded[..rest.len()].copy_from_slice(rest);
        tail.copy_from_slice(&group(padded)[..tail.len()]);
    }
}

fn pack_groups<const B: usize, const N: usize>(
    dn: &[u16],
    bytes: &mut [u8],
    group: impl Fn([u16; N]) -> [u8; B],
) {
    let (full, rest) = dn.as_chunks::<N>();
    let (groups, tail) = bytes.as_chunks_mut::<B>();
    for (bytes, &pixels) in groups.iter_mut().zip(full) {
        *bytes = group(pixels);
    }
    if !rest.is_empty() {
        let mut padded = [0; N];
        padded[..rest.len()].copy_from_slice(rest);
        tail.copy_from_slice(&group(padded)[..tail.len()]);
    }
}

/// Unpacks GigE Vision 12 bit: high eight bits of each pixel outside, both low nibbles in the middle byte.
fn unpack_12_packed(bytes: &[u8], dn: &mut [u16]) {
    unpack_groups(bytes, dn, |[a, b, c]: [u8; 3]| {
        [u16::from(a) << 4 | u16::from(b & 0x0F), u16::from(c) << 4 | u16::from(b >> 4)]
    });
}

fn pack_12_packed(dn: &[u16], bytes: &mut [u8]) {
    pack_groups(dn, bytes, |[p, q]: [u16; 2]| {
        [(p >> 4) as u8, (p & 0x0F) as u8 | ((q & 0x0F) as u8) << 4, (q >> 4) as u8]
    });
}

/// Unpacks GigE Vision 10 bit: as 12 bit, with two low bits at bits 0 and 4 of the middle byte.
fn unpack_10_packed(bytes: &[u8], dn: &mut [u16]) {
    unpack_groups(bytes, dn, |[a, b, c]: [u8; 3]| {
        [u16::from(a) << 2 | u16::from(b & 3), u16::from(c) << 2 | u16::from(b >> 4 & 3)]
    });
}

fn pack_10_packed(dn: &[u16], bytes: &mut [u8]) {
    pack_groups(dn, bytes, |[p, q]: [u16; 2]| {
        [(p >> 2) as u8, (p & 3) as u8 | ((q & 3) as u8) << 4, (q >> 2) as u8]
    });
}

/// Unpacks PFNC `p`: one stream of bits, least significant first.
fn unpack_12p(bytes: &[u8], dn: &mut [u16]) {
    unpack_groups(bytes, dn, |[a, b, c]: [u8; 3]| {
        [u16::from(a) | u16::from(b & 0x0F) << 8, u16::from(b >> 4) | u16::from(c) << 4]
    });
}

fn pack_12p(dn: &[u16], bytes: &mut [u8]) {
    pack_groups(dn, bytes, |[p, q]: [u16; 2]| {
        [p as u8, (p >> 8 & 0x0F) as u8 | ((q & 0x0F) as u8) << 4, (q >> 4) as u8]
    });
}

fn unpack_10p(bytes: &[u8], dn: &mut [u16]) {
    unpack_groups(bytes, dn, |[a, b, c, d, e]: [u8; 5]| {
        let bits = u64::from_le_bytes([a, b, c, d, e, 0, 0, 0]);
        [0, 10, 20, 30].map(|shift| (bits >> shift & 0x3FF) as u16)
    });
}

fn pack_10p(dn: &[u16], bytes: &mut [u8]) {
    pack_groups(dn, bytes, |[p, q, r, s]: [u16; 4]| {
        let bits = [p, q, r, s].iter().rev().fold(0u64, |bits, &x| bits << 10 | u64::from(x & 0x3FF));
        let [a, b, c, d, e, ..] = bits.to_le_bytes();
        [a, b, c, d, e]
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn layouts_follow_the_convention_to_the_bit() {
        let cases: [(&str, &[u8], &[u16]); 6] = [
            ("Mono8", &[1, 255], &[1, 255]),
            ("Mono16", &[0x34, 0x12], &[0x1234]),
            ("Mono12p", &[0xBC, 0x6A, 0x45], &[0xABC, 0x456]),
            ("Mono12Packed", &[0xAB, 0x6C, 0x45], &[0xABC, 0x456]),
            // 0x3FF, 0, 0x155, 0x2AA in one stream of bits
            ("Mono10p", &[0xFF, 0x03, 0x50, 0x95, 0xAA], &[0x3FF, 0, 0x155, 0x2AA]),
            ("Mono10Packed", &[0xFF, 0x13, 0x55], &[0x3FF, 0x155]),
        ];
        for (name, bytes, dn) in cases {
            let format = PixelFormat::from_name(name).unwrap();
            let mut unpacked = vec![0; dn.len()];
            format.unpack(bytes, &mut unpacked).unwrap();
            assert_eq!(unpacked, dn, "{name}");
        }
    }

    #[test]
    fn names_and_codes_are_unique_and_found() {
        for format in PixelFormat::all() {
            assert_eq!(PixelFormat::from_name(format.name()), Ok(format));
            assert_eq!(PixelFormat::from_code(format.code()), Ok(format));
            assert!(format.bits_per_pixel() >= usize::from(format.bits()));
        }
        assert!(PixelFormat::from_name("RGB8").unwrap_err().to_string().contains("Mono12p"));
        assert!(PixelFormat::from_code(0x0218_0014).is_err());
    }

    proptest! {
        #[test]
        fn unpacking_undoes_packing(dn in prop::collection::vec(any::<u16>(), 0..70), i in 0..TABLE.len()) {
            let format = PixelFormat(i);
            let dn: Vec<u16> = dn.iter().map(|d| d & format.full_scale_dn()).collect();
            let mut bytes = vec![0; format.payload(dn.len())];
            format.pack(&dn, &mut bytes).unwrap();
            let mut back = vec![0; dn.len()];
            format.unpack(&bytes, &mut back).unwrap();
            prop_assert_eq!(back, dn);
            bytes.push(0);
            prop_assert!(format.unpack(&bytes, &mut [0; 3]).is_err() || format.payload(3) == bytes.len());
        }
    }
}
