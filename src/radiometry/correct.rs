//! Correction of frames, eq. (51): D_C = (D - D_D) / K. The hot path: one pass, no allocation per frame.

use crate::calibrate::dark::DarkError;
use crate::calibrate::defects::replacements_of;
use crate::calibrate::file::Calibration;
use crate::number::six_digits;
use crate::pixel_format::{PixelFormat, WrongLength};
use ndarray::Array2;
use rayon::prelude::*;

/// Pixels per work item of a thread.
const CHUNK: usize = 65_536;
/// Pixels unpacked at a time: their codes stay in the nearest cache. Whole bytes and whole groups of every
/// packed format.
const BLOCK: usize = 4096;

/// Maximum distance of a level below the dark reference, in standard deviations of a pixel's dark noise: a
/// lower level has other settings, since no light makes it.
const MAX_BELOW: f64 = 5.0;

/// Calibration prepared for one exposure.
///
/// Correction is limited by memory: dark reference and 1/K are stored as half floats of their small distance
/// from the median. A value is rounded by at most 1/2048 of that distance: 4.9e-6 for a K that is 1 % off.
#[derive(Debug, Clone)]
pub struct Corrector {
    shape: (usize, usize),
    dark_dn: Halves,
    gain: Halves,
    /// Largest code of the camera, DN: frames may come in a wider format.
    full_scale_dn: u16,
    /// Pixels to replace, and the sound pixels whose mean replaces them.
    replace: Vec<(usize, Vec<usize>)>,
}

/// Map of half floats about its median.
#[derive(Debug, Clone)]
struct Halves {
    about: About,
    off: Vec<u16>,
}

/// Origin and unit of the half floats of a map: a value is `middle` + `unit` times the result of [`widen`].
#[derive(Debug, Clone, Copy)]
struct About {
    middle: f32,
    unit: f32,
}

impl Halves {
    fn new(values: impl Iterator<Item = f32>) -> Self {
        let values: Vec<f32> = values.collect();
        let mut sorted = values.clone();
        let half = sorted.len() / 2;
        let middle =
            if sorted.is_empty() { 0.0 } else { *sorted.select_nth_unstable_by(half, f32::total_cmp).1 };
        // Scales by the power of two that brings the largest distance close to the largest half float, so
        // that small distances keep all their digits. No code lies 2^30 away; only a dark current that
        // saturates does.
        let off = |v: f32| (v - middle).clamp(-1.073_741_8e9, 1.073_741_8e9);
        let largest = values.iter().map(|v| off(*v).abs()).fold(0.0, f32::max);
        let power = if largest > 0.0 { (32_768.0 / largest).log2().floor().clamp(-15.0, 60.0) } else { 0.0 };
        let scale = power.exp2();
        let off = values.iter().map(|v| half::f16::from_f32(off(*v) * scale).to_bits()).collect();
        Self { about: About { middle, unit: f32::from_bits(BIAS) / scale }, off }
    }
}

/// Bits of 2^112, the factor between a half float and its bits placed in a float.
const BIAS: u32 = 0x7780_0000;

/// Converts a half float's bits to a float of 2^-112 times its value: sign, exponent and digits are shifted
/// into place. Vectorises to three instructions.
#[inline(always)]
fn widen(bits: u16) -> f32 {
    let spread = i32::from(bits as i16) << 13;
    f32::from_bits(spread as u32 & 0x8fff_e000)
}

/// Conversion of corrected values to 16-bit codes: code = scale * D_C + offset, rounded, clipped to 0 and
/// 65535.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Codes {
    /// Codes per DN.
    pub scale: f32,
    /// Code of D_C = 0, with room for noise below zero.
    pub offset: f32,
}

/// Error: a frame cannot be corrected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CorrectError {
    /// The frame and the calibration differ in size.
    #[error("the frame has {found} pixels, the calibration {expected}")]
    Size {
        /// Pixels of the calibration.
        expected: usize,
        /// Pixels of the frame.
        found: usize,
    },
    /// The calibration was made under other settings.
    #[error("the calibration does not hold here: {0}")]
    Settings(String),
    /// Not a valid exposure.
    #[error("an exposure of {0} s; write a number of seconds that is not below 0")]
    Exposure(f64),
    /// Dark charge fills the range at this exposure.
    #[error(
        "at {} s the dark reference is {dark_dn:.0} DN, and the camera's largest code {full_scale_dn} DN: dark charge alone \
         saturates it; is that the exposure, in seconds?",
        six_digits(*exposure_s)
    )]
    DarkSaturates {
        /// Exposure, s.
        exposure_s: f64,
        /// Median of the dark reference, DN.
        dark_dn: f32,
        /// Largest code, DN.
        full_scale_dn: u16,
    },
    /// Frames are darker than without light.
    #[error(
        "{below_dn:.0} DN darker than the dark reference at {} s: exposure, black level or temperature are not those of the \
         calibration; --force goes on all the same",
        six_digits(*exposure_s)
    )]
    Darker {
        /// Distance below the dark reference, DN.
        below_dn: f64,
        /// Exposure, s.
        exposure_s: f64,
    },
    /// The dark reference does not extend to this exposure.
    #[error(transparent)]
    Dark(#[from] DarkError),
    /// The bytes are not those of a frame of that size and format.
    #[error(transparent)]
    Bytes(#[from] WrongLength),
}

/// Statistics of a raw frame, collected while it is corrected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Seen {
    /// Sum of all codes, DN.
    pub sum_dn: u64,
    /// Number of pixels at full scale.
    pub saturated: u64,
    /// Number of pixels.
    pub pixels: u64,
}

impl Seen {
    fn and(self, other: Self) -> Self {
        Self {
            sum_dn: self.sum_dn + other.sum_dn,
            saturated: self.saturated + other.saturated,
            pixels: self.pixels + other.pixels,
        }
    }

    /// Mean of the raw frame, DN.
    pub fn mean_dn(&self) -> f64 {
        self.sum_dn as f64 / self.pixels.max(1) as f64
    }
}

impl Corrector {
    /// Prepares a calibration for frames of an exposure, s.
    ///
    /// # Errors
    ///
    /// If this is no exposure, or the dark reference does not extend to it.
    pub fn new(calibration: &Calibration, exposure_s: f64) -> Result<Self, CorrectError> {
        if !(exposure_s.is_finite() && exposure_s >= 0.0) {
            return Err(CorrectError::Exposure(exposure_s));
        }
        let dark = calibration.dark.at(exposure_s)?;
        let dark_dn = Halves::new(dark.iter().copied());
        let full_scale_dn = match calibration.description.camera.full_scale_dn() {
            0 => u16::MAX,
            full => full,
        };
        if dark_dn.about.middle >= f32::from(full_scale_dn) {
            return Err(CorrectError::DarkSaturates {
                exposure_s,
                dark_dn: dark_dn.about.middle,
                full_scale_dn,
            });
        }
        Ok(Self {
            shape: dark.dim(),
            dark_dn,
            gain: Halves::new(calibration.k.iter().map(|&k| 1.0 / k)),
            full_scale_dn,
            replace: Vec::new(),
        })
    }

    /// Also replaces the flagged pixels of the calibration by the mean of the nearest sound ones.
    pub fn replacing_defects(mut self, calibration: &Calibration) -> Self {
        self.replace = replacements_of(&calibration.defects, calibration.period());
        self
    }

    /// Number of replaced pixels.
    pub fn replaced(&self) -> usize {
        self.replace.len()
    }

    /// Number of rows and columns.
    pub fn shape(&self) -> (usize, usize) {
        self.shape
    }

    /// Median of the dark reference, DN.
    pub fn dark_dn(&self) -> f32 {
        self.dark_dn.about.middle
    }

    /// Refuses a level of frames, DN, below the dark reference by more than noise and the reference's error
    /// allow.
    ///
    /// # Errors
    ///
    /// If the level is darker, with the difference.
    pub fn is_lit(
        &self,
        calibration: &Calibration,
        exposure_s: f64,
        level_dn: f64,
    ) -> Result<(), CorrectError> {
        let below_dn = f64::from(self.dark_dn()) - level_dn;
        let allowed_dn =
            MAX_BELOW * calibration.dark_noise_dn(self.dark_dn()) + calibration.dark.std_err_at(exposure_s);
        if below_dn > allowed_dn { Err(CorrectError::Darker { below_dn, exposure_s }) } else { Ok(()) }
    }

    /// Largest code of the camera, DN.
    pub fn full_scale_dn(&self) -> u16 {
        self.full_scale_dn
    }

    fn check(&self, lengths: [usize; 2]) -> Result<(), CorrectError> {
        let expected = self.gain.off.len();
        match lengths.into_iter().find(|&found| found != expected) {
            Some(found) => Err(CorrectError::Size { expected, found }),
            None => Ok(()),
        }
    }

    /// Corrects a frame (row by row, DN) to DN above the dark reference.
    ///
    /// # Errors
    ///
    /// If frame, output and calibration differ in size.
    pub fn to_f32(&self, frame: &[u16], out: &mut [f32]) -> Result<(), CorrectError> {
        self.each(frame, out, ())?;
        for (at, from) in &self.replace {
            out[*at] = from.iter().map(|&i| out[i]).sum::<f32>() / from.len() as f32;
        }
        Ok(())
    }

    /// Corrects a frame (row by row, DN) to 16-bit codes.
    ///
    /// # Errors
    ///
    /// If frame, output and calibration differ in size.
    pub fn to_u16(&self, frame: &[u16], codes: Codes, out: &mut [u16]) -> Result<(), CorrectError> {
        self.each(frame, out, (codes, u16::MAX))?;
        self.replace_u16(out);
        Ok(())
    }

    /// Corrects a frame from its bytes as transferred to 16-bit codes, in one pass: unpacked codes stay in
    /// the nearest cache. Codes equal those of [`to_u16`](Self::to_u16) bit for bit, but are limited to
    /// `limit`.
    ///
    /// # Errors
    ///
    /// If bytes, output and calibration differ in size.
    pub fn arrived_to_u16(
        &self,
        format: PixelFormat,
        bytes: &[u8],
        codes: Codes,
        limit: u16,
        out: &mut [u16],
    ) -> Result<Seen, CorrectError> {
        self.check([out.len(), out.len()])?;
        format.check(bytes.len(), out.len())?;
        let arch = pulp::Arch::new();
        let about = (self.dark_dn.about, self.gain.about);
        let full_scale_dn = format.full_scale_dn().min(self.full_scale_dn);
        let maps = self.dark_dn.off.par_chunks(CHUNK).zip(self.gain.off.par_chunks(CHUNK));
        let pieces = out.par_chunks_mut(CHUNK).zip(bytes.par_chunks(format.payload(CHUNK))).zip(maps);
        let seen = pieces.map(|((out, bytes), (dark, gain))| {
            let mut memory = [0; BLOCK];
            let mut seen = Seen::default();
            let maps = dark.chunks(BLOCK).zip(gain.chunks(BLOCK));
            let blocks = out.chunks_mut(BLOCK).zip(bytes.chunks(format.payload(BLOCK))).zip(maps);
            for ((out, bytes), (dark, gain)) in blocks {
                let frame = match as_codes(format, bytes) {
                    Some(codes) => codes,
                    None => {
                        let memory = &mut memory[..out.len()];
                        format.unpack_checked(bytes, memory);
                        &*memory
                    }
                };
                let form = (codes, limit);
                let piece = Piece { frame, dark, gain, about, form, out };
                seen = seen.and(arch.dispatch(Watched { piece, full_scale_dn }));
            }
            seen
        });
        let seen = seen.reduce(Seen::default, Seen::and);
        self.replace_u16(out);
        Ok(seen)
    }

    /// Corrects a frame (row by row, DN) to 16-bit codes in place, like [`to_u16`](Self::to_u16).
    ///
    /// # Errors
    ///
    /// If frame and calibration differ in size.
    pub fn in_place(&self, frame: &mut [u16], codes: Codes) -> Result<(), CorrectError> {
        self.check([frame.len(), frame.len()])?;
        let arch = pulp::Arch::new();
        let about = (self.dark_dn.about, self.gain.about);
        let maps = self.dark_dn.off.par_chunks(CHUNK).zip(self.gain.off.par_chunks(CHUNK));
        frame.par_chunks_mut(CHUNK).zip(maps).for_each(|(frame, (dark, gain))| {
            let mut memory = [0; BLOCK];
            let maps = dark.chunks(BLOCK).zip(gain.chunks(BLOCK));
            for (out, (dark, gain)) in frame.chunks_mut(BLOCK).zip(maps) {
                let frame = &mut memory[..out.len()];
                frame.copy_from_slice(out);
                arch.dispatch(Piece { frame, dark, gain, about, form: (codes, u16::MAX), out });
            }
        });
        self.replace_u16(frame);
        Ok(())
    }

    fn replace_u16(&self, out: &mut [u16]) {
        for (at, from) in &self.replace {
            let sum: u64 = from.iter().map(|&i| u64::from(out[i])).sum();
            let n = from.len() as u64;
            out[*at] = ((sum + n / 2) / n) as u16;
        }
    }

    /// Corrects every pixel of a frame, on all cores.
    fn each<T: Send, F: Sync + Copy>(&self, frame: &[u16], out: &mut [T], form: F) -> Result<(), CorrectError>
    where
        for<'a> Piece<'a, T, F>: pulp::NullaryFnOnce<Output = ()>,
    {
        self.check([frame.len(), out.len()])?;
        let arch = pulp::Arch::new();
        let maps = self.dark_dn.off.par_chunks(CHUNK).zip(self.gain.off.par_chunks(CHUNK));
        let about = (self.dark_dn.about, self.gain.about);
        out.par_chunks_mut(CHUNK).zip(frame.par_chunks(CHUNK)).zip(maps).for_each(
            |((out, frame), (dark, gain))| arch.dispatch(Piece { frame, dark, gain, about, form, out }),
        );
        Ok(())
    }

    /// Corrects a frame into a new image, (rows, columns), DN above the dark reference.
    ///
    /// # Errors
    ///
    /// If frame, output and calibration differ in size.
    pub fn image(&self, frame: &Array2<u16>) -> Result<Array2<f32>, CorrectError> {
        let mut out = Array2::zeros(self.shape);
        let frame = frame.as_standard_layout();
        self.to_f32(frame.as_slice().unwrap_or_default(), out.as_slice_mut().unwrap_or_default())?;
        Ok(out)
    }
}

/// Returns the bytes of a frame as codes if they need no conversion.
fn as_codes(format: PixelFormat, bytes: &[u8]) -> Option<&[u16]> {
    let plain = format.bits_per_pixel() == 16 && cfg!(target_endian = "little");
    plain.then(|| bytemuck::try_cast_slice(bytes).ok()).flatten()
}

/// Pixels of one work item, their maps, and the requested form of output.
struct Piece<'a, T, F> {
    frame: &'a [u16],
    dark: &'a [u16],
    gain: &'a [u16],
    about: (About, About),
    form: F,
    out: &'a mut [T],
}

impl<T, F> Piece<'_, T, F> {
    /// Computes (D - D_DC) / K (eq. 51). `look` receives every raw code.
    #[inline(always)]
    fn corrected(self, form: impl Fn(f32) -> T, mut look: impl FnMut(u16)) {
        let (about_dark, about_gain) = self.about;
        let maps = self.dark.iter().zip(self.gain);
        for ((out, &d), (&dark, &gain)) in self.out.iter_mut().zip(self.frame).zip(maps) {
            let dark_dn = about_dark.unit * widen(dark);
            let gain = about_gain.middle + about_gain.unit * widen(gain);
            *out = form((f32::from(d) - about_dark.middle - dark_dn) * gain);
            look(d);
        }
    }
}

impl Piece<'_, u16, (Codes, u16)> {
    #[inline(always)]
    fn codes(self, look: impl FnMut(u16)) {
        let (Codes { scale, offset }, limit) = self.form;
        let most = ZERO + i32::from(limit);
        // Adding 1.5 * 2^23 rounds to an integer in the low bits; the bits order as the numbers do.
        let code = |v: f32| {
            let bits = (v * scale + offset + 12_582_912.0).to_bits() as i32;
            bits.max(ZERO).min(most) as u16
        };
        self.corrected(code, look);
    }
}

/// Piece of at most [`BLOCK`] pixels whose statistics are collected while it is corrected.
struct Watched<'a> {
    piece: Piece<'a, u16, (Codes, u16)>,
    full_scale_dn: u16,
}

impl pulp::NullaryFnOnce for Watched<'_> {
    type Output = Seen;

    #[inline(always)]
    fn call(self) -> Seen {
        let pixels = self.piece.frame.len() as u64;
        // For one block both fit into 32 bits, the width of the codes while they are converted.
        let (mut sum, mut saturated) = (0u32, 0u32);
        self.piece.codes(|d| {
            sum += u32::from(d);
            saturated += u32::from(d >= self.full_scale_dn);
        });
        Seen { sum_dn: sum.into(), saturated: saturated.into(), pixels }
    }
}

impl pulp::NullaryFnOnce for Piece<'_, f32, ()> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.corrected(|v| v, |_| {});
    }
}

impl pulp::NullaryFnOnce for Piece<'_, u16, (Codes, u16)> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.codes(|_| {});
    }
}

/// Bits of 1.5 * 2^23.
const ZERO: i32 = 0x4b40_0000;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::dark::{DarkMean, DarkReference};
    use crate::calibrate::file::Description;
    use crate::calibrate::joint::joint;
    use crate::dataset::CameraInfo;
    use crate::statistics::moments::Moments;
    use radcam_sim::{Conditions, Sensor, sensors};

    fn camera(info: (usize, usize)) -> CameraInfo {
        CameraInfo { width: info.1, height: info.0, bit_depth: 12, ..Default::default() }
    }

    /// A corrected flat at high light has the spatial variance of shot and constant noise alone, within 3 %
    /// at eight levels, while that of the raw flat grows as intensity squared. The light is even here, so
    /// that the remaining pattern is the camera's.
    #[test]
    fn a_corrected_flat_is_limited_by_shot_noise() {
        let mut model = sensors::load("cmos12").unwrap();
        (model.camera.width, model.camera.height) = (160, 120);
        (model.bench.shading, model.bench.gradient) = (0.0, 0.0);
        model.base.hot_pixel_fraction = 0.0;
        let sensor = Sensor::new(model).unwrap();
        let (shape, region) = ((120, 160), sensor.region());
        let mut next = 0;
        let mut average = |c: &Conditions, frames: u64| {
            let mut moments = Moments::new(shape, 12);
            for _ in 0..frames {
                let mut dn = vec![0; 120 * 160];
                sensor.draw(next, c, region, &mut dn);
                next += 1;
                moments.add(&[&dn]).unwrap();
            }
            (moments.mean_dn(), moments.variance_dn2())
        };
        let at = |exposure_s, illumination| Conditions { illumination, ..sensor.conditions(exposure_s) };
        let darks: Vec<DarkMean> = [0.001, 0.5]
            .map(|exposure_s| {
                let (mean_dn, var_dn2) = average(&at(exposure_s, 0.0), 100);
                DarkMean { exposure_s, frames: 100, mean_dn, var_dn2 }
            })
            .into();
        let flat_s = 0.02;
        let dark = DarkReference::fit(&darks, flat_s).unwrap();
        let reference = dark.at(flat_s).unwrap().mapv(f64::from);
        let flats: Vec<_> =
            (0..16).map(|_| (average(&at(flat_s, 0.9), 20).0 - &reference).mapv(|x| x as f32)).collect();
        let calibration = Calibration::new(Description::of(camera(shape)), dark, joint(&flats).unwrap(), &[]);

        let variance = |x: &Array2<f64>| {
            let mean = x.mean().unwrap();
            (x.mapv(|x| (x - mean).powi(2)).sum() / (x.len() as f64 - 1.0), mean)
        };
        let gain = sensor.model().base.gain_dn_per_e;
        let constant = sensor.model().constant_noise_var_dn2(0.0);
        let mut raw_excess = Vec::new();
        for level in 1..=8 {
            let exposure_s = flat_s * f64::from(level) / 8.0;
            let corrector = Corrector::new(&calibration, exposure_s).unwrap();
            // Eight frames have 153,600 samples, which give the variance to 0.4 %.
            let (mut corrected, mut raw, mut mean) = (0.0, 0.0, 0.0);
            for frame in 0..8 {
                let mut dn = Array2::zeros(shape);
                let c = at(exposure_s, 0.9);
                sensor.draw(50_000 + 8 * level as u64 + frame, &c, region, dn.as_slice_mut().unwrap());
                let (v, m) = variance(&corrector.image(&dn).unwrap().mapv(f64::from));
                corrected += v / 8.0;
                mean += m / 8.0;
                raw += variance(&dn.mapv(f64::from)).0 / 8.0;
            }
            let noise = gain * mean + constant;
            assert!((corrected / noise - 1.0).abs() < 0.03, "level {level}: {corrected} for {noise}");
            raw_excess.push((raw - noise - 0.35f64.powi(2)) / (mean * mean));
        }
        // The excess of the raw frames is sigma_K^2 times the squared mean, at every level where it is
        // visible.
        for excess in &raw_excess[3..] {
            assert!((excess.sqrt() / sensor.model().base.sigma_k - 1.0).abs() < 0.1, "{raw_excess:?}");
        }
    }

    /// All finite half floats, compared with the library's own conversion.
    #[test]
    fn halves_are_widened_exactly() {
        for bits in (0..=u16::MAX).filter(|b| b & 0x7c00 != 0x7c00) {
            let wide = widen(bits) * f32::from_bits(BIAS);
            assert_eq!(wide.to_bits(), half::f16::from_bits(bits).to_f32().to_bits(), "{bits:x}");
        }
    }

    /// Values are recovered within 1/2048 of their distance from the median, for any range of the map: a flat
    /// one, PRNU, a hot pixel of 16 bits, distances too small for all digits of half floats, and infinity.
    #[test]
    fn maps_keep_their_digits() {
        for (middle, spread, far) in [
            (1.0, 0.0, 1.0),
            (1.0, 0.01, 0.5),
            (64.0, 2.0, 65_535.0),
            (1.0, 1e-7, 1.0 + 1e-6),
            (1.0, 0.01, f32::INFINITY),
        ] {
            let value = |i: usize| middle + spread * ((i * 31 % 997) as f32 / 997.0 - 0.5);
            let values: Vec<f32> = (0..997).map(value).chain([far]).collect();
            let halves = Halves::new(values.iter().copied());
            for (&bits, &v) in halves.off.iter().zip(values.iter().filter(|v| v.is_finite())) {
                let back = halves.about.middle + halves.about.unit * widen(bits);
                // In addition, rounding of the sum, and half the smallest step of a half float.
                let smallest = 2f32.powi(-25) * halves.about.unit * 2f32.powi(-112);
                let most = (v - halves.about.middle).abs() / 2048.0 + v.abs() * f32::EPSILON + smallest;
                assert!((back - v).abs() <= most, "{v} comes back as {back}");
            }
        }
    }

    /// Every format, at a size that is no multiple of anything, with replaced pixels: equal to unpacking and
    /// then correcting, and the statistics are those of the frame.
    #[test]
    fn a_frame_is_corrected_as_it_came() {
        let n = 2 * CHUNK + 3 * BLOCK + 4 * 7;
        let map =
            |at: f32, by: f32| Halves::new((0..n).map(move |i| at + by * ((i * 31 % 997) as f32 / 997.0)));
        let corrector = Corrector {
            shape: (1, n),
            dark_dn: map(3.0, 2.0),
            gain: map(0.9, 0.2),
            full_scale_dn: 4095,
            replace: vec![(5, vec![4, 6]), (CHUNK, vec![CHUNK + 1])],
        };
        let codes = Codes { scale: 4.0, offset: 16.0 };
        for format in PixelFormat::all() {
            let full = format.full_scale_dn();
            let dn: Vec<u16> = (0..n).map(|i| (i * 7919 % (usize::from(full) + 1)) as u16).collect();
            let mut bytes = vec![0; format.payload(n)];
            format.pack(&dn, &mut bytes).unwrap();
            let (mut one, mut two) = (vec![0; n], vec![0; n]);
            corrector.to_u16(&dn, codes, &mut one).unwrap();
            two.copy_from_slice(&dn);
            corrector.in_place(&mut two, codes).unwrap();
            assert_eq!(one, two, "{format}");
            let seen = corrector.arrived_to_u16(format, &bytes, codes, u16::MAX, &mut two).unwrap();
            assert_eq!(one, two, "{format}");
            let sum_dn = dn.iter().map(|&d| u64::from(d)).sum();
            let saturated = dn.iter().filter(|&&d| d >= full.min(4095)).count() as u64;
            assert_eq!(seen, Seen { sum_dn, saturated, pixels: n as u64 }, "{format}");
            corrector.arrived_to_u16(format, &bytes, codes, 99, &mut two).unwrap();
            let limited = two.iter().zip(&one).enumerate();
            // A replaced pixel is the mean of limited ones.
            assert!(
                limited.into_iter().all(|(i, (t, o))| t == o.min(&99) || [5, CHUNK].contains(&i)),
                "{format}"
            );
            let short = corrector.arrived_to_u16(format, &bytes[1..], codes, u16::MAX, &mut two);
            assert!(matches!(short, Err(CorrectError::Bytes(_))), "{format}");
        }
    }

    #[test]
    fn codes_round_and_clip_and_sizes_are_checked() {
        let corrector = Corrector {
            shape: (1, 4),
            dark_dn: Halves::new([10.0f32; 4].into_iter()),
            gain: Halves::new([2.0f32, 1.0, 1.0, 1.0].into_iter()),
            full_scale_dn: u16::MAX,
            replace: vec![],
        };
        let mut out = [0u16; 4];
        let codes = Codes { scale: 16.0, offset: 100.0 };
        corrector.to_u16(&[20, 10, 0, 65_535], codes, &mut out).unwrap();
        assert_eq!(out, [420, 100, 0, 65_535]);
        let mut float = [0.0; 4];
        corrector.to_f32(&[20, 10, 0, 11], &mut float).unwrap();
        assert_eq!(float, [20.0, 0.0, -10.0, 1.0]);
        assert!(corrector.to_f32(&[1, 2], &mut float).is_err());
        let replacing = Corrector { replace: vec![(1, vec![0, 3])], ..corrector };
        replacing.to_f32(&[20, 10, 0, 12], &mut float).unwrap();
        assert_eq!(float, [20.0, 11.0, -10.0, 2.0]);
        replacing.to_u16(&[20, 10, 0, 12], codes, &mut out).unwrap();
        assert_eq!(out[1], (420 + 132) / 2);
    }
}
