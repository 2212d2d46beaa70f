//! Correction in the electronics of a camera: integers, one offset and one factor per pixel, and a list of
//! defects.

use crate::calibrate::defects::replacements_of;
use crate::calibrate::file::Calibration;
use crate::correct::CorrectError;
use crate::frame::Region;
use ndarray::Array2;

/// First bytes of a file of coefficients.
const MAGIC: [u8; 4] = *b"RCFF";
/// Version of the layout.
const VERSION: u16 = 1;
/// Bytes before the first pixel.
const HEADER: usize = 20;
/// Fractional bits of a factor: steps of 6e-5, up to 4.
const GAIN_PLACES: u16 = 14;
/// Maximum fractional bits of an offset, if its range allows them: a sixteenth of a DN.
const OFFSET_PLACES: u16 = 4;

/// Offsets and factors of all pixels of a sensor.
///
/// The camera turns a code d into ((d - offset) * gain + black level), rounded to the nearest code and
/// clipped to 0 and full scale: eq. (51) of the paper with gain = 1/K and offset = the dark reference.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FlatField {
    width: u32,
    height: u32,
    /// Code at 0 DN above the dark reference.
    black_dn: u16,
    /// Fractional bits of the offsets.
    places: u16,
    /// Offset and factor of each pixel, row by row.
    pixels: Vec<[u16; 2]>,
}

/// Error: bytes are no file of coefficients.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct LayoutError(&'static str);

impl FlatField {
    /// Computes the coefficients of a calibration at an exposure, s, and the number of values clipped to the
    /// range of a factor or an offset.
    ///
    /// # Errors
    ///
    /// If the dark reference does not extend to this exposure.
    pub fn of(calibration: &Calibration, exposure_s: f64) -> Result<(Self, usize), CorrectError> {
        let dark = calibration.dark.at(exposure_s)?;
        let (height, width) = dark.dim();
        let mut sorted: Vec<f32> = dark.iter().copied().collect();
        let middle = sorted.len() / 2;
        let black_dn = match sorted.len() {
            0 => 0.0,
            _ => sorted.select_nth_unstable_by(middle, f32::total_cmp).1.round(),
        };
        let full_dn = f32::from(calibration.description.camera.full_scale_dn());
        let places =
            (0..=OFFSET_PLACES).rev().find(|p| full_dn * f32::from(1u16 << p) <= 65_535.0).unwrap_or(0);
        let mut cut = 0;
        let mut fixed = |value: f32, places: u16| {
            let value = (value * f32::from(1u16 << places)).round();
            cut += usize::from(!(0.0..=65_535.0).contains(&value));
            value as u16
        };
        let pixels = dark.iter().zip(&calibration.k);
        let pixels = pixels.map(|(&d, &k)| [fixed(d, places), fixed(1.0 / k, GAIN_PLACES)]).collect();
        Ok((
            Self { width: width as u32, height: height as u32, black_dn: black_dn as u16, places, pixels },
            cut,
        ))
    }

    /// Number of columns and rows.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// Code at 0 DN above the dark reference.
    pub fn black_dn(&self) -> u16 {
        self.black_dn
    }

    /// Maximum rounding of an offset, DN.
    pub fn offset_rounding_dn(&self) -> f64 {
        0.5 / f64::from(1u16 << self.places)
    }

    /// Writes the layout of a file: `RCFF`, version, fractional bits of offsets and of factors, black level
    /// (u16 each), two zero bytes, columns, rows (u32 each); then offset and factor of each pixel (u16 each),
    /// row by row; little endian.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(HEADER + 4 * self.pixels.len());
        out.extend(MAGIC);
        for value in [VERSION, self.places | GAIN_PLACES << 8, self.black_dn, 0] {
            out.extend(value.to_le_bytes());
        }
        out.extend(self.width.to_le_bytes());
        out.extend(self.height.to_le_bytes());
        out.extend(self.pixels.iter().flatten().flat_map(|v| v.to_le_bytes()));
        out
    }

    /// Reads the output of [`to_bytes`](Self::to_bytes).
    ///
    /// # Errors
    ///
    /// A message about the fault.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, LayoutError> {
        let (header, rest) = bytes.split_at_checked(HEADER).ok_or(LayoutError("shorter than its header"))?;
        let short = |at: usize| u16::from_le_bytes([header[at], header[at + 1]]);
        let long = |at: usize| u32::from(short(at)) | u32::from(short(at + 2)) << 16;
        if header[..4] != MAGIC || short(4) != VERSION {
            return Err(LayoutError("not a file of coefficients of this version"));
        }
        let places = short(6) & 0xFF;
        if places > OFFSET_PLACES || short(6) >> 8 != GAIN_PLACES {
            return Err(LayoutError("binary places that are not known"));
        }
        let (width, height) = (long(12), long(16));
        let claimed = (u64::from(width) * u64::from(height)).checked_mul(4);
        if claimed != Some(rest.len() as u64) {
            return Err(LayoutError("another length than its size says"));
        }
        let pixels = rest.chunks_exact(4).map(|p| [[p[0], p[1]], [p[2], p[3]]].map(u16::from_le_bytes));
        Ok(Self { width, height, black_dn: short(8), places, pixels: pixels.collect() })
    }

    /// Corrects the pixels of a region in place; pixels beyond the sensor are left unchanged.
    pub fn apply(&self, region: Region, full_scale_dn: u16, dn: &mut [u16]) {
        let (places, half) = (i64::from(self.places), 1i64 << (self.places + GAIN_PLACES - 1));
        let columns = self.width as usize;
        for (row, dn) in (region.y as usize..).zip(dn.chunks_mut((region.width as usize).max(1))) {
            let from = row * columns + region.x as usize;
            let map = self.pixels.get(from..((row + 1) * columns).max(from)).unwrap_or_default();
            for (d, &[offset, gain]) in dn.iter_mut().zip(map) {
                let above = (i64::from(*d) << places) - i64::from(offset);
                let code = (above * i64::from(gain) + half) >> (places + i64::from(GAIN_PLACES));
                *d = (code + i64::from(self.black_dn)).clamp(0, full_scale_dn.into()) as u16;
            }
        }
    }
}

/// List of defects, and the pixels whose mean replaces them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DefectList {
    width: usize,
    replace: Vec<(usize, Vec<usize>)>,
}

impl DefectList {
    /// Creates the list for a sensor of this size; `places` are (column, row). Pixels of one colour are
    /// `step` apart.
    pub fn new((width, height): (usize, usize), places: &[(u32, u32)], step: usize) -> Self {
        let mut flags = Array2::zeros((height, width));
        for &(x, y) in places {
            if let Some(flag) = flags.get_mut((y as usize, x as usize)) {
                *flag = 1;
            }
        }
        Self { width, replace: replacements_of(&flags, step) }
    }

    /// Replaces the defects of a region by the mean of the nearest sound pixels in it.
    pub fn apply(&self, region: Region, dn: &mut [u16]) {
        let (x, y) = (region.x as usize, region.y as usize);
        let (width, height) = (region.width as usize, region.height as usize);
        let inside = |at: usize| {
            let (row, column) = ((at / self.width).checked_sub(y)?, (at % self.width).checked_sub(x)?);
            (row < height && column < width).then_some(row * width + column)
        };
        for (at, from) in &self.replace {
            let Some(at) = inside(*at) else { continue };
            let sound: Vec<u64> = from.iter().filter_map(|&f| inside(f)).map(|f| dn[f].into()).collect();
            if !sound.is_empty() {
                let n = sound.len() as u64;
                dn[at] = ((sound.iter().sum::<u64>() + n / 2) / n) as u16;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::dark::DarkReference;
    use crate::calibrate::file::Description;
    use crate::calibrate::pattern::FixedPattern;
    use crate::correct::{Codes, Corrector};
    use crate::dataset::CameraInfo;

    fn calibration(bit_depth: u8) -> Calibration {
        let shape = (40, 60);
        let map = |f: &dyn Fn(usize) -> f32| Array2::from_shape_fn(shape, |(y, x)| f(y * shape.1 + x));
        let dark = DarkReference {
            exposure_s: 0.01,
            level_dn: map(&|i| 60.0 + (i * 31 % 97) as f32 / 10.0),
            current_dn_per_s: None,
            std_err_dn: 0.1,
            current_std_err_dn_per_s: f64::NAN,
            var_dn2: 1.0,
        };
        let pattern = FixedPattern {
            k: map(&|i| 0.9 + (i * 17 % 101) as f32 / 500.0),
            std_err: map(&|_| 0.001),
            kept: Array2::from_elem(shape, 9),
            pooled_sd: 0.003,
            mean_before: 1.0,
            level_dn: 900.0,
        };
        let camera = CameraInfo {
            width: shape.1,
            height: shape.0,
            bit_depth,
            pixel_format: "Mono12".into(),
            ..Default::default()
        };
        Calibration::new(Description::of(camera), dark, pattern, &[])
    }

    /// The camera's codes agree with the host's to one code, as the rounded coefficients explain, and most
    /// are equal.
    #[test]
    fn a_camera_corrects_as_the_host_does() {
        for bit_depth in [8, 12, 16] {
            let made = calibration(bit_depth);
            let full = made.description.camera.full_scale_dn();
            let (flat, cut) = FlatField::of(&made, 0.01).unwrap();
            assert_eq!(cut, 0);
            let corrector = Corrector::new(&made, 0.01).unwrap();
            let codes = Codes { scale: 1.0, offset: flat.black_dn().into() };
            let frame: Vec<u16> =
                (0..2400usize).map(|i| (i * 7919 % (usize::from(full) + 1)) as u16).collect();
            let mut host = vec![0; frame.len()];
            corrector.to_u16(&frame, codes, &mut host).unwrap();
            let mut camera = frame.clone();
            flat.apply(Region { x: 0, y: 0, width: 60, height: 40 }, full, &mut camera);
            let limited = host.iter().map(|h| *h.min(&full));
            let apart: Vec<u16> = camera.iter().zip(limited).map(|(c, h)| c.abs_diff(h)).collect();
            // A factor is rounded by 3e-5: 2 DN of 65 535.
            let most = 1 + (f64::from(full) * 0.5 / 16_384.0 + flat.offset_rounding_dn() * 1.2) as u16;
            assert!(apart.iter().all(|a| *a <= most), "{bit_depth} bits: {:?}", apart.iter().max());
            let same = apart.iter().filter(|a| **a == 0).count();
            assert!(bit_depth == 16 || same > 2200, "{bit_depth} bits: {same} of 2400");
            // A region gives the same pixels.
            let mut part: Vec<u16> = (5..25).flat_map(|y| frame[y * 60 + 7..y * 60 + 37].to_vec()).collect();
            flat.apply(Region { x: 7, y: 5, width: 30, height: 20 }, full, &mut part);
            let of_whole: Vec<u16> = (5..25).flat_map(|y| camera[y * 60 + 7..y * 60 + 37].to_vec()).collect();
            assert_eq!(part, of_whole);
        }
    }

    #[test]
    fn a_file_is_read_as_written_and_no_other() {
        let (flat, _) = FlatField::of(&calibration(12), 0.01).unwrap();
        let bytes = flat.to_bytes();
        assert_eq!(FlatField::from_bytes(&bytes), Ok(flat));
        for cut in [0, HEADER - 1, HEADER, bytes.len() - 1] {
            assert!(FlatField::from_bytes(&bytes[..cut]).is_err());
        }
        for at in [0, 4, 6, 12, 19] {
            let mut changed = bytes.clone();
            changed[at] ^= 0x80;
            assert!(FlatField::from_bytes(&changed).is_err(), "{at}");
        }
    }

    #[test]
    fn defects_are_replaced_by_their_neighbours() {
        let list = DefectList::new((4, 3), &[(1, 1), (9, 9)], 1);
        let mut dn = vec![10, 10, 10, 0, 10, 999, 10, 0, 10, 10, 14, 0];
        list.apply(Region { x: 0, y: 0, width: 4, height: 3 }, &mut dn);
        assert_eq!(dn[5], 11);
        let mut part = vec![999, 8];
        list.apply(Region { x: 1, y: 1, width: 2, height: 1 }, &mut part);
        assert_eq!(part, [8, 8]);
    }
}
