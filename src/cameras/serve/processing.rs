//! Image processing of cameras that a calibration must not meet: flat-field and defect correction, gamma, a
//! lookup table, sharpening, a test pattern, binning.

use super::files::Memory;
use super::gige::{Initial, Registers};
use super::register;
use crate::frame::Region;

/// Features by their GenICam names, and their registers.
pub(super) const FEATURES: [(&str, u32); 8] = [
    ("BinningHorizontal", register::BINNING_HORIZONTAL),
    ("BinningVertical", register::BINNING_VERTICAL),
    ("Gamma", register::GAMMA),
    ("LUTEnable", register::LUT),
    ("SharpeningEnable", register::SHARPENING),
    ("DefectCorrectStaticEnable", register::DEFECTS),
    ("TestPattern", register::PATTERN),
    ("FlatFieldCorrectionMode", register::FLAT_FIELD),
];

/// Entries of `TestPattern`.
pub(super) const PATTERNS: [(&str, u32); 3] = [("Off", 0), ("GreyHorizontalRamp", 1), ("FrameNumber", 2)];
/// Entries of `FlatFieldCorrectionMode`.
pub(super) const FLAT_FIELDS: [(&str, u32); 2] = [("Off", 0), ("User", 1)];
/// Values of the binning features.
pub(super) const BINNINGS: [u32; 3] = [1, 2, 4];

/// Weight of each of the four neighbours subtracted by sharpening.
const SHARPENING: f64 = 0.15;
/// Threshold of defects: excess over all neighbours, relative to full scale.
const DEFECT: f64 = 0.03;

/// All processing steps; the default changes nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Processing {
    /// Pixels averaged across and down: 1, 2 or 4.
    pub binning: (u32, u32),
    /// Exponent of the response.
    pub gamma: f64,
    /// Lookup table that raises the lower two thirds of the range by a fifth.
    pub lut: bool,
    /// Sharpening with the four neighbours.
    pub sharpening: bool,
    /// Defect correction: replaces the pixels of the user's list, or without a list the pixels that stand
    /// out, by the mean of their neighbours.
    pub defects: bool,
    /// Flat-field correction with the user's offsets and factors, if written.
    pub flat_field: bool,
    /// Test pattern in place of the image.
    pub pattern: Pattern,
}

/// Test pattern in place of the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Pattern {
    /// No test pattern.
    #[default]
    Off,
    /// Ramp from 0 to full scale in each row.
    Ramp,
    /// Frame number, and pixels that all follow from it: see [`numbered`].
    Number,
}

impl Pattern {
    fn from_register(value: u32) -> Self {
        match value {
            0 => Self::Off,
            2 => Self::Number,
            _ => Self::Ramp,
        }
    }
}

/// Number of pixels that hold the frame number, four bits each, the lowest first.
const NUMBER_PIXELS: usize = 8;

/// Fills a numbered frame, a test pattern for streams. The first eight pixels hold the number, every other
/// one a code derived from number and position, so that a pixel of another frame, a shift or any other change
/// is detected.
///
/// ```
/// use radcam::serve::processing::{number_of, numbered};
/// let mut dn = [0; 32];
/// numbered(70_000, 0xFFF, &mut dn);
/// assert_eq!(number_of(&dn, 0xFFF), Some(70_000));
/// dn[20] ^= 1;
/// assert_eq!(number_of(&dn, 0xFFF), None);
/// ```
pub fn numbered(number: u32, full_scale_dn: u16, dn: &mut [u16]) {
    for (block, dn) in (0..).zip(dn.chunks_mut(BLOCK)) {
        paint_block(number, block, full_scale_dn, dn);
    }
}

/// Number of pixels with the same two keys.
const BLOCK: usize = 4096;

/// Fills one block of a numbered frame. Each frame and block has two keys. A pixel is the upper bits of a
/// product, so another frame or a shift gives the same run of codes only with a probability of 2^-28. 16-bit
/// steps suit the vector units of every processor.
fn paint_block(number: u32, block: u32, full_scale_dn: u16, dn: &mut [u16]) {
    // Multiplicative hashing: Knuth, The Art of Computer Programming, vol. 3, 6.4.
    let mixed = (number ^ block.wrapping_mul(0x9E37_79B1)).wrapping_mul(0x85EB_CA6B);
    let mixed = (mixed ^ mixed >> 15).wrapping_mul(0xC2B2_AE35);
    let (flip, add) = (mixed as u16, (mixed >> 16) as u16);
    for (i, d) in (0u16..).zip(dn.iter_mut()) {
        *d = (i ^ flip).wrapping_mul(0x9E37).wrapping_add(add) >> 4 & full_scale_dn;
    }
    if block == 0 {
        for (i, d) in dn.iter_mut().take(NUMBER_PIXELS).enumerate() {
            *d = (number >> (4 * i) & 0xF) as u16;
        }
    }
}

/// Returns the number of a numbered frame; `None` if any pixel was changed.
pub fn number_of(dn: &[u16], full_scale_dn: u16) -> Option<u32> {
    let head = dn.get(..NUMBER_PIXELS)?;
    let number = head.iter().rev().try_fold(0u32, |n, &d| (d < 16).then(|| n << 4 | u32::from(d)))?;
    let mut made = [0; BLOCK];
    let sound = |(block, dn): (u32, &[u16])| {
        let made = &mut made[..dn.len()];
        paint_block(number, block, full_scale_dn, made);
        made == dn
    };
    (0..).zip(dn.chunks(BLOCK)).all(sound).then_some(number)
}

impl Default for Processing {
    fn default() -> Self {
        Self {
            binning: (1, 1),
            gamma: 1.0,
            lut: false,
            sharpening: false,
            defects: false,
            flat_field: false,
            pattern: Pattern::Off,
        }
    }
}

impl Processing {
    /// Sets a feature by its GenICam name.
    ///
    /// # Errors
    ///
    /// Message: no such feature, or the feature cannot take the value.
    pub fn set(&mut self, name: &str, value: &str) -> Result<(), String> {
        let fault = |what: &str| format!("{name} = {value}: {what}");
        let truth = || value.parse::<bool>().map_err(|_| fault("write true or false"));
        let binning = || {
            let n = value.parse().ok().filter(|n| BINNINGS.contains(n));
            n.ok_or_else(|| fault("write 1, 2 or 4"))
        };
        match name {
            "BinningHorizontal" => self.binning.0 = binning()?,
            "BinningVertical" => self.binning.1 = binning()?,
            "Gamma" => {
                let gamma = value.parse().ok().filter(|g| (0.25..=4.0).contains(g));
                self.gamma = gamma.ok_or_else(|| fault("write a number from 0.25 to 4"))?;
            }
            "LUTEnable" => self.lut = truth()?,
            "SharpeningEnable" => self.sharpening = truth()?,
            "DefectCorrectStaticEnable" => self.defects = truth()?,
            "FlatFieldCorrectionMode" => {
                let entry = FLAT_FIELDS.iter().find(|(entry, _)| *entry == value);
                self.flat_field = entry.ok_or_else(|| fault("write Off or User"))?.1 != 0;
            }
            "TestPattern" => {
                let entry = PATTERNS.iter().find(|(entry, _)| *entry == value);
                let names = PATTERNS.map(|(entry, _)| entry).join(" or ");
                let entry = entry.ok_or_else(|| fault(&format!("write {names}")))?;
                self.pattern = Pattern::from_register(entry.1);
            }
            _ => {
                let names = FEATURES.map(|(name, _)| name).join(", ");
                return Err(format!("{name} is none of the features that can be stuck: {names}"));
            }
        }
        Ok(())
    }

    /// Writes the settings into the registers.
    pub(super) fn write(&self, r: &mut Initial) {
        r.set_u32(register::BINNING_HORIZONTAL, self.binning.0);
        r.set_u32(register::BINNING_VERTICAL, self.binning.1);
        r.set_f64(register::GAMMA, self.gamma);
        r.set_u32(register::LUT, self.lut.into());
        r.set_u32(register::SHARPENING, self.sharpening.into());
        r.set_u32(register::DEFECTS, self.defects.into());
        r.set_u32(register::PATTERN, self.pattern as u32);
        r.set_u32(register::FLAT_FIELD, self.flat_field.into());
    }

    /// Reads the settings from the registers.
    pub(super) fn read(r: &Registers) -> Self {
        let binning = |at| BINNINGS.into_iter().find(|n| *n == r.u32(at)).unwrap_or(1);
        let gamma = r.f64(register::GAMMA);
        Self {
            binning: (binning(register::BINNING_HORIZONTAL), binning(register::BINNING_VERTICAL)),
            gamma: if gamma.is_finite() { gamma.clamp(0.25, 4.0) } else { 1.0 },
            lut: r.u32(register::LUT) != 0,
            sharpening: r.u32(register::SHARPENING) != 0,
            defects: r.u32(register::DEFECTS) != 0,
            flat_field: r.u32(register::FLAT_FIELD) != 0,
            pattern: Pattern::from_register(r.u32(register::PATTERN)),
        }
    }

    /// Returns columns and rows of the whole sensor, binned.
    pub(super) fn binned(&self, sensor: Region) -> (u32, u32) {
        (sensor.width / self.binning.0, sensor.height / self.binning.1)
    }

    /// Processes a region of the unbinned sensor; `dn` shrinks with binning.
    pub(super) fn apply(&self, dn: &mut Vec<u16>, region: Region, full_scale_dn: u16, memory: &Memory) {
        let mut width = region.width as usize;
        if *self == Self::default() || width == 0 {
            return;
        }
        let full = f64::from(full_scale_dn);
        if let Some(map) = memory.flat_field.as_ref().filter(|_| self.flat_field) {
            map.apply(region, full_scale_dn, dn);
        }
        if let Some(list) = memory.defects.as_ref().filter(|_| self.defects) {
            list.apply(region, dn);
        } else if self.defects {
            let apart = DEFECT * full;
            around(dn, width, |pixel, four| {
                let (low, high) = four.iter().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
                let stands_out = pixel > high + apart || pixel < low - apart;
                if stands_out { four.iter().sum::<f64>() / 4.0 } else { pixel }
            });
        }
        let (across, down) = (self.binning.0 as usize, self.binning.1 as usize);
        if (across, down) != (1, 1) {
            let (columns, rows) = (width / across, dn.len() / width / down);
            for y in 0..rows {
                for x in 0..columns {
                    let cells = (0..down).flat_map(|j| (0..across).map(move |i| (j, i)));
                    let sum: u32 =
                        cells.map(|(j, i)| u32::from(dn[(y * down + j) * width + x * across + i])).sum();
                    let n = (across * down) as u32;
                    // In place: the write position never passes pixels still to be read.
                    dn[y * columns + x] = ((sum + n / 2) / n) as u16;
                }
            }
            dn.truncate(columns * rows);
            width = columns;
        }
        if self.sharpening {
            around(dn, width, |pixel, four| {
                let sum: f64 = four.iter().sum();
                (pixel * (1.0 + 4.0 * SHARPENING) - SHARPENING * sum).clamp(0.0, full)
            });
        }
        if self.lut || self.gamma != 1.0 {
            let curve = |x: f64| {
                let lifted = if x < 2.0 / 3.0 { 1.2 * x } else { 0.8 + 0.6 * (x - 2.0 / 3.0) };
                (if self.lut { lifted } else { x }).powf(self.gamma)
            };
            let table: Vec<u16> = (0..=full_scale_dn)
                .map(|code| (full * curve(f64::from(code) / full)).round() as u16)
                .collect();
            dn.iter_mut().for_each(|d| *d = table[usize::from((*d).min(full_scale_dn))]);
        }
        if self.pattern == Pattern::Ramp {
            for row in dn.chunks_mut(width) {
                let most = row.len().max(2) - 1;
                for (x, d) in row.iter_mut().enumerate() {
                    *d = (full * x as f64 / most as f64) as u16;
                }
            }
        }
    }
}

/// Replaces every pixel by `act` of the pixel and its four neighbours; beyond the edge the pixel stands for
/// its neighbour.
fn around(dn: &mut [u16], width: usize, act: impl Fn(f64, [f64; 4]) -> f64) {
    let before = dn.to_vec();
    let rows = dn.len() / width;
    for (i, d) in dn.iter_mut().enumerate() {
        let (y, x) = (i / width, i % width);
        let at = |there: bool, j: usize| f64::from(before[if there { j } else { i }]);
        let four = [
            at(x > 0, i.wrapping_sub(1)),
            at(x + 1 < width, i + 1),
            at(y > 0, i.wrapping_sub(width)),
            at(y + 1 < rows, i + width),
        ];
        *d = act(f64::from(before[i]), four).round() as u16;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_does_what_it_says() {
        let with = |name: &str, value: &str| {
            let mut p = Processing::default();
            p.set(name, value).unwrap();
            p
        };
        let image =
            || vec![100u16, 100, 100, 100, 100, 3000, 100, 100, 100, 100, 100, 100, 100, 100, 100, 100];
        let after = |p: Processing| {
            let mut dn = image();
            p.apply(&mut dn, Region { x: 0, y: 0, width: 4, height: 4 }, 4095, &Memory::default());
            dn
        };
        assert_eq!(after(Processing::default()), image());
        assert_eq!(after(with("DefectCorrectStaticEnable", "true")), [100; 16]);
        assert_eq!(after(with("Gamma", "0.5"))[0], (4095.0 * (100.0f64 / 4095.0).sqrt()).round() as u16);
        assert_eq!(after(with("LUTEnable", "true"))[0], 120);
        assert_eq!(after(with("TestPattern", "GreyHorizontalRamp"))[..4], [0, 1365, 2730, 4095]);
        let sharp = after(with("SharpeningEnable", "true"));
        assert_eq!((sharp[5], sharp[4], sharp[0]), (4095, 0, 100));
        let mut binned = with("BinningHorizontal", "2");
        binned.binning.1 = 2;
        assert_eq!(after(binned), [825, 100, 100, 100]);
        for (name, value) in [("Gamma", "0"), ("BinningVertical", "3"), ("TestPattern", "On"), ("Gain", "1")]
        {
            assert!(Processing::default().set(name, value).unwrap_err().contains(name));
        }
    }
}
