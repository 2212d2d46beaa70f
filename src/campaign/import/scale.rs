//! Scale of the codes: stretched codes are converted back to those of the converter, signed and
//! floating-point numbers are converted to codes.
//!
//! A dataset has codes of up to 16 bits, and quantisation of one code is part of its model (a variance
//! of 1/12). So a code must be a step of the converter, or small compared with the noise.

use crate::dataset::image::Values;
use crate::number::six_digits;
use crate::statistics::code_step::{self, Occurring, Stretch};
use ndarray::Array2;
use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

/// Linear scale: code k is stored as zero + step k.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// File value per code.
    pub step: f64,
    /// File value of code 0.
    pub zero: f64,
}

impl Default for Scale {
    fn default() -> Self {
        Self { step: 1.0, zero: 0.0 }
    }
}

impl Scale {
    /// Returns true if file values equal codes.
    pub fn is_identity(&self) -> bool {
        *self == Self::default()
    }

    /// Converts a frame to codes.
    ///
    /// # Errors
    ///
    /// A value that is not a code: its position and value.
    pub fn codes(&self, values: Values) -> Result<Array2<u16>, String> {
        let numbers = match values {
            Values::Codes(codes) if self.is_identity() => return Ok(codes),
            Values::Codes(codes) => codes.mapv(f64::from),
            Values::Numbers(numbers) => numbers,
        };
        let line = Stretch { step: self.step, zero: self.zero };
        let codes = numbers.mapv(|v| line.code(v));
        match codes.indexed_iter().find(|(_, c)| !(0.0..=65_535.0).contains(*c)) {
            None => Ok(codes.mapv(|c| c as u16)),
            Some(((y, x), _)) => Err(format!(
                "holds {} at row {y}, column {x}, which is no code of 16 bits where code 0 is {} and a code is {}",
                numbers[[y, x]],
                six_digits(self.zero),
                six_digits(self.step)
            )),
        }
    }

    /// Converts a value to a code, unrounded.
    pub fn of(&self, value: f64) -> f64 {
        (value - self.zero) / self.step
    }

    /// Describes the conversion for the table of `radcam import`; `None` if codes are unchanged.
    pub fn words(&self) -> Option<String> {
        let power = self.step.log2();
        if self.is_identity() {
            return None;
        }
        let step = six_digits(self.step);
        // An offset below half a step is due to rounding.
        let zero = match self.zero {
            zero if 2.0 * zero.abs() <= self.step => String::new(),
            zero => format!(", code 0 is {} in the files", six_digits(zero)),
        };
        Some(match self.step {
            1.0 => format!("1 code is 1 in the files{zero}"),
            _ if self.step > 1.0 && power.fract() == 0.0 && self.zero == 0.0 => {
                format!("codes shifted down by {power} bits: all are multiples of {}", self.step)
            }
            _ if self.step > 1.0 => {
                format!("codes were stretched to steps of {step}: taken back to those of the converter{zero}")
            }
            _ => format!("1 code is {step} in the files{zero}"),
        })
    }
}

/// Maximum number of distinct values stored: continuous values have as many as pixels.
const MAX_DISTINCT: usize = 200_000;

/// Maximum number of averaged frames or pixels that is searched for in fractions of a code, and minimum
/// range of the values, in codes: numbers scaled to 0 to 1 are not averages (named choices).
const MAX_IN_A_MEAN: f64 = 256.0;
const MIN_RANGE_OF_MEANS: f64 = 4.0;

/// Minimum fraction of pixels with their own fractional part in averages of frames, and the distance
/// from an integer that single precision leaves in a sum of eight 16-bit codes (named choices).
const MIN_FRACTIONAL_SHARE: f64 = 0.1;
const MAX_OFF_WHOLE: f64 = 0.02;

/// Codes by which negative values are lifted: what a subtracted dark leaves, a subtracted black level, and
/// the middle of signed 16-bit samples (FITS Standard 4.0, section 4.4.2.5: BZERO 32768).
const LIFTS: [f64; 3] = [256.0, 4096.0, 32_768.0];
/// Minimum temporal noise, in file units, at which floating-point numbers are rounded to whole codes:
/// quantisation is then at most a twelfth of the noise, and is accounted for (q^2/12).
const MIN_NOISE_OF_WHOLE_CODES: f64 = 1.0;

/// Statistics of the values of all frames that determine the scale.
#[derive(Debug, Default)]
pub struct Census {
    occurring: Occurring,
    numbers: Option<Numbers>,
    /// Number of integer frames.
    of_integers: usize,
    /// Files whose floating-point values have fractions.
    fractional: BTreeSet<PathBuf>,
}

#[derive(Debug)]
struct Numbers {
    distinct: HashSet<u64>,
    least: f64,
    most: f64,
    whole: bool,
    /// Minimum standard deviation of half the difference of successive frames.
    noise: f64,
    before: Option<Array2<f64>>,
    /// Maximum fraction of pixels in two successive frames with their own fractional part
    /// ([`fractional_share`]).
    fractional_share: f64,
}

/// Returns the fraction of pixels whose fractional part is not a sum of constants for row, column and
/// pixel in all frames, which subtracted overscan and dark frames leave: for such a sum the differences
/// of two frames, of neighbouring columns and of neighbouring rows are whole numbers.
fn fractional_share(frame: &Array2<f64>, before: &Array2<f64>) -> f64 {
    let off = frame - before;
    let cells = off.windows((2, 2));
    let is_fractional = |cell: &ndarray::ArrayView2<'_, f64>| {
        let sum = cell[[0, 0]] - cell[[0, 1]] - cell[[1, 0]] + cell[[1, 1]];
        (sum - sum.round()).abs() > MAX_OFF_WHOLE
    };
    let all = (off.nrows().max(1) - 1) * (off.ncols().max(1) - 1);
    cells.into_iter().filter(is_fractional).count() as f64 / all.max(1) as f64
}

impl Numbers {
    /// Finds the step of the numbers and of these codes; `None` for continuous numbers.
    fn stretch(&self, codes: &[f64]) -> Option<Stretch> {
        if self.distinct.len() >= MAX_DISTINCT {
            return None;
        }
        let numbers = self.distinct.iter().map(|b| f64::from_bits(*b));
        let mut values: Vec<f64> = numbers.chain(codes.iter().copied()).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        if self.whole { code_step::of_whole_codes(&values) } else { code_step::of_numbers(&values) }
    }
}

impl Census {
    /// Adds a frame.
    ///
    /// # Errors
    ///
    /// A value is NaN or infinite.
    pub fn add(&mut self, values: &Values, path: &Path) -> Result<(), String> {
        let numbers = match values {
            Values::Codes(codes) => {
                self.of_integers += 1;
                codes.rows().into_iter().for_each(|row| match row.as_slice() {
                    Some(row) => self.occurring.add(row),
                    None => self.occurring.add(&row.to_vec()),
                });
                return Ok(());
            }
            Values::Numbers(numbers) => numbers,
        };
        if let Some(((y, x), v)) = numbers.indexed_iter().find(|(_, v)| !v.is_finite()) {
            return Err(format!("holds {v} at row {y}, column {x}; a frame has a number for every pixel"));
        }
        if numbers.iter().any(|v| v.fract() != 0.0) {
            self.fractional.insert(path.into());
        }
        let all = self.numbers.get_or_insert_with(|| Numbers {
            distinct: HashSet::new(),
            least: f64::INFINITY,
            most: f64::NEG_INFINITY,
            whole: true,
            noise: f64::INFINITY,
            before: None,
            fractional_share: 0.0,
        });
        for v in numbers {
            all.least = all.least.min(*v);
            all.most = all.most.max(*v);
            all.whole &= v.fract() == 0.0;
            if all.distinct.len() < MAX_DISTINCT {
                // Maps -0 to 0.
                all.distinct.insert((*v + 0.0).to_bits());
            }
        }
        if let Some(before) = all.before.as_ref().filter(|b| b.dim() == numbers.dim()) {
            let n = numbers.len() as f64;
            let of = |power: i32| numbers.iter().zip(before).map(|(a, b)| (a - b).powi(power)).sum::<f64>();
            let noise = (0.5 * (of(2) / n - (of(1) / n).powi(2)).max(0.0)).sqrt();
            if noise > 0.0 {
                all.noise = all.noise.min(noise);
            }
            if !all.whole {
                all.fractional_share = all.fractional_share.max(fractional_share(numbers, before));
            }
        }
        all.before = Some(numbers.clone());
        Ok(())
    }

    /// Returns the highest code under a scale.
    pub fn highest(&self, scale: &Scale) -> u16 {
        let codes = self.occurring.codes();
        let most = self.numbers.as_ref().map_or(f64::NEG_INFINITY, |n| n.most);
        let line = Stretch { step: scale.step, zero: scale.zero };
        line.code(codes.last().copied().unwrap_or(most).max(most)).clamp(0.0, 65_535.0) as u16
    }

    /// Returns the number of frames or pixels whose average each value may be: the values are integer
    /// multiples of its reciprocal. `None` for whole codes and continuous numbers.
    pub fn in_a_mean(&self) -> Option<u32> {
        let is_mean = |n: &&Numbers| {
            !n.whole && n.most - n.least > MIN_RANGE_OF_MEANS && n.fractional_share > MIN_FRACTIONAL_SHARE
        };
        let numbers = self.numbers.as_ref().filter(is_mean)?;
        let Stretch { step, zero } = numbers.stretch(&[])?;
        let n = step.recip().round();
        // Single precision has seven digits.
        let is_one_over = |v: f64| (v * n - (v * n).round()).abs() < 1e-6 * n * numbers.most.abs();
        ((2.0..=MAX_IN_A_MEAN).contains(&n) && (step * n - 1.0).abs() < 1e-4 && is_one_over(zero))
            .then_some(n as u32)
    }

    /// Finds the scale that fits all frames.
    ///
    /// # Errors
    ///
    /// Values that do not fit 16-bit codes, or a mixture of camera frames and computed ones.
    pub fn scale(&self) -> Result<Scale, String> {
        if let Some(first) = self.fractional.first().filter(|_| self.of_integers > 0) {
            let more = match self.fractional.len() - 1 {
                0 => "holds".into(),
                n => format!("and {n} more hold"),
            };
            return Err(format!(
                "{} {more} fractions of a code, and other files whole codes: what was averaged (a master) or computed has not the noise of a \
                 frame. Leave it out, and take the frames that it was made of",
                first.display()
            ));
        }
        let Some(numbers) = &self.numbers else {
            let Some(Stretch { step, zero }) = self.occurring.stretch() else { return Ok(Scale::default()) };
            return Ok(Scale { step, zero });
        };
        let codes = self.occurring.codes();
        let ends = [codes.first(), codes.last()].into_iter().flatten();
        let least = ends.clone().copied().fold(numbers.least, f64::min);
        let most = ends.copied().fold(numbers.most, f64::max);
        let (step, zero) = match numbers.stretch(&codes) {
            Some(Stretch { step, zero }) if step >= 1.0 - 1e-6 || numbers.whole => (step, zero),
            _ if numbers.whole || numbers.noise.is_finite() && numbers.noise >= MIN_NOISE_OF_WHOLE_CODES => {
                (1.0, 0.0)
            }
            Some(Stretch { step, zero }) => (step, zero),
            None if numbers.noise.is_finite() => (10f64.powf(numbers.noise.log10().floor()), 0.0),
            None => {
                return Err(
                    "the frames hold fractions, and no two of them tell their noise: codes of a dataset are \
                            whole numbers that are fine against it; take two frames of a level"
                        .into(),
                );
            }
        };
        // Single precision leaves small errors on a whole step.
        let step = if (step - step.round()).abs() < 1e-6 * step { step.round() } else { step };
        let zero = if zero.abs() < 1e-6 * step { 0.0 } else { zero };
        // Negative values are lifted to codes by one of a few numbers: two folders of a camera get the same
        // one, whatever their darkest sample is.
        let below = ((least - zero) / step).round();
        let lift = if below < 0.0 {
            LIFTS.into_iter().find(|lift| -below <= *lift).unwrap_or((-below).ceil())
        } else {
            0.0
        };
        let scale = Scale { step, zero: zero - lift * step };
        let highest = scale.of(most).round();
        if highest > 65_535.0 {
            return Err(format!(
                "the frames hold values from {least} to {most}: in steps of {} that is more than 16 bits hold",
                six_digits(step)
            ));
        }
        Ok(scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    fn frames(of: impl Fn(f64) -> f64) -> Vec<Array2<f64>> {
        let value = |frame: u32, y: usize, x: usize| {
            let level = if frame < 2 { 40.0 } else { 900.0 };
            let spread = if frame < 2 { 2.0 } else { 12.0 };
            let normal = PixelRng::new(1, Stream::Frame, frame.into(), (y * 64 + x) as u32, 0).normal();
            of((level + spread * normal).round())
        };
        (0..4).map(|f| Array2::from_shape_fn((64, 64), |(y, x)| value(f, y, x))).collect()
    }

    fn scale(frames: &[Array2<f64>]) -> Result<Scale, String> {
        let mut census = Census::default();
        frames.iter().try_for_each(|f| census.add(&Values::Numbers(f.clone()), Path::new("a.tif")))?;
        census.scale()
    }

    #[test]
    fn fractions_of_codes_may_be_means() {
        let of = |of: fn(f64) -> f64| {
            let mut census = Census::default();
            frames(of).into_iter().for_each(|f| census.add(&Values::Numbers(f), Path::new("a.tif")).unwrap());
            census.in_a_mean()
        };
        assert_eq!(of(|v| f64::from((v / 3.0) as f32)), Some(3));
        assert_eq!(of(|v| v / 4.0), Some(4));
        assert_eq!(of(|v| f64::from(((v + 5.0 * v.sin().round()) / 10.0) as f32)), Some(10));
        for whole in [
            (|v| v) as fn(f64) -> f64,
            |v| v - 150.0,
            |v| v - 50.5,
            |v| f64::from((v / 4095.0) as f32),
            |v| v + 0.3 * v.sin(),
        ] {
            assert_eq!(of(whole), None);
        }
        // Overscan of 32 columns subtracted from each row, and a master of ten darks from each frame.
        for n in [32.0, 10.0] {
            let mut census = Census::default();
            for (k, mut frame) in frames(|v| v).into_iter().enumerate() {
                frame.indexed_iter_mut().for_each(|((y, x), v)| {
                    let sum = if n == 32.0 { 7 * y + 5 * k } else { 3 * y + 11 * x };
                    *v = f64::from((*v - 20.0 - (sum % n as usize) as f64 / n) as f32);
                });
                census.add(&Values::Numbers(frame), Path::new("a.tif")).unwrap();
            }
            assert_eq!(census.in_a_mean(), None, "{n}");
            assert!(census.scale().is_ok());
        }
    }

    #[test]
    fn numbers_get_the_scale_that_fits() {
        for (of, step, zero) in [
            // Overscan subtracted.
            ((|v| v - 50.5) as fn(f64) -> f64, 1.0, -256.5),
            (|v| v - 150.0, 1.0, -256.0),
            // With noise of 8 and steps of 0.25, whole codes are fine enough; with noise of 0.02 they
            // are not.
            (|v| 4.0 * v + 0.25 * (v % 3.0), 1.0, 0.0),
            (|v| 0.01 * v, 0.01, 0.0),
            (|v| f64::from((v / 4095.0) as f32), 1.0 / 4095.0, 0.0),
            (|v| 16.0 * v + 0.5, 16.0, 0.5),
        ] {
            let found = scale(&frames(of)).unwrap();
            assert!((found.step / step - 1.0).abs() < 1e-4, "{found:?}, not {step}");
            assert!((found.zero - zero).abs() < 1e-6 * step.max(1.0), "{found:?}, not {zero}");
        }
        // Continuous numbers: a power of ten below the noise.
        let smooth = |v: f64| 1e-3 * v + 1e-6 * (v * 1e4).sin();
        let found = scale(&frames(smooth)).unwrap();
        assert!((found.step / 1e-3 - 1.0).abs() < 1e-9, "{found:?}");
        assert!(scale(&frames(|v| 1000.0 * v + 0.3 * v.sin())).unwrap_err().contains("16 bits"));
        // Fractions beside whole codes: a master beside raw frames.
        let mut census = Census::default();
        census.add(&Values::Codes(Array2::from_elem((4, 4), 100)), Path::new("raw.tif")).unwrap();
        census.add(&Values::Numbers(Array2::from_elem((4, 4), 100.0)), Path::new("whole.tif")).unwrap();
        assert!(census.scale().is_ok());
        census.add(&Values::Numbers(Array2::from_elem((4, 4), 100.0625)), Path::new("master.tif")).unwrap();
        assert!(census.scale().unwrap_err().contains("master.tif holds fractions"));
        let mut broken = frames(|v| v);
        broken[1][[3, 4]] = f64::NAN;
        assert!(scale(&broken).unwrap_err().contains("NaN at row 3, column 4"));
        assert!(scale(&frames(|v| v + 0.3 * v.sin())[..1]).unwrap_err().contains("two frames"));
    }
}
