//! A set of frames at one level of light: its mean, its temporal variance, and its pairs (Section IV).

use super::moments::{Moments, SizeMismatch};
use crate::number::finite;
use serde::{Deserialize, Serialize};

/// Pair of frames, as in the paper.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pair {
    /// Mean over both frames, DN (eq. 37).
    pub mean_dn: f64,
    /// Variance of the noise, DN^2 (eq. 38).
    pub var_dn2: f64,
    /// Mean of the first frame minus that of the second, DN.
    #[serde(default)]
    pub difference_dn: f64,
}

/// Statistics of a set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Level {
    /// Number of frames.
    pub frames: u64,
    /// Number of pixels used: those that are not clipped in every frame.
    pub pixels: u64,
    /// Mean over pixels and frames, DN.
    pub mean_dn: f64,
    /// Temporal variance pooled over pixels, DN^2, after subtraction of each frame's own mean.
    ///
    /// For two frames it is eq. (38); for n it is the residual mean square of the two-way layout (pixel and
    /// frame), with (n - 1)(M - 1) degrees of freedom. Lamp flicker does not enter.
    pub var_dn2: f64,
    /// Variance of the pixels' true means over the field, DN^2: shading, K, dark current.
    pub spatial_var_dn2: f64,
    /// Variance of the frame means, DN^2: fluctuation of the light from frame to frame, and noise.
    pub frame_mean_var_dn2: f64,
    /// Share of the samples at the largest code, excluding pixels that are there in every frame.
    pub saturated: f64,
    /// Share of the samples at code 0, excluding pixels that are there in every frame.
    pub black: f64,
    /// Share of the pixels excluded because they are at the largest code or at 0 in every frame.
    pub stuck: f64,
    /// Pairs of frames 0 and 1, 2 and 3, and so on.
    pub pairs: Vec<Pair>,
    /// Number of pixels excluded by the mask.
    #[serde(default)]
    pub masked: u64,
    /// Number of samples far off the same pixel in other frames, replaced by the pixel's usual code.
    #[serde(default)]
    pub struck: u64,
    /// Mean over the pixels of their squared variances, corrected for the scatter of few frames of normal
    /// noise, DN^4: above [`var_dn2`](Self::var_dn2) squared if pixels differ in noise.
    #[serde(default = "nan", with = "finite")]
    pub square_dn4: f64,
}

fn nan() -> f64 {
    f64::NAN
}

impl Level {
    /// Degrees of freedom of [`var_dn2`](Self::var_dn2) for independent normal pixels.
    pub fn dof(&self) -> f64 {
        (self.frames as f64 - 1.0) * (self.pixels as f64 - 1.0)
    }
}

/// Accumulator of a set, frame by frame; memory does not grow with the number of frames.
#[derive(Debug, Clone)]
pub struct LevelAccumulator {
    full_scale: u16,
    moments: Moments,
    frame_sums: Vec<u64>,
    saturated: u64,
    black: u64,
    previous: Option<Vec<u16>>,
    pairs: Vec<Pair>,
    /// Masked pixels, ascending.
    masked: Vec<usize>,
}

impl LevelAccumulator {
    /// Excludes some pixels, given by their places row by row, ascending.
    pub fn without(mut self, masked: Vec<usize>) -> Self {
        self.masked = masked;
        self
    }

    /// Creates an accumulator for frames of (rows, columns) from a camera of `bit_depth` bits.
    pub fn new(shape: (usize, usize), bit_depth: u8) -> Self {
        Self {
            full_scale: ((1u32 << bit_depth.min(16)) - 1) as u16,
            moments: Moments::new(shape, bit_depth),
            frame_sums: Vec::new(),
            saturated: 0,
            black: 0,
            previous: None,
            pairs: Vec::new(),
            masked: Vec::new(),
        }
    }

    /// Discards all frames but keeps the memory for the next set.
    pub fn reset(&mut self) {
        self.moments.reset();
        self.frame_sums.clear();
        self.pairs.clear();
        (self.saturated, self.black, self.previous) = (0, 0, None);
    }

    /// Adds frames in order of time, codes in DN row by row.
    ///
    /// # Errors
    ///
    /// If the frames differ in size.
    pub fn add(&mut self, frames: &[&[u16]]) -> Result<(), SizeMismatch> {
        self.moments.add(frames)?;
        for frame in frames {
            let (mut sum, mut saturated, mut black) = (0u64, 0u64, 0u64);
            // Chunks of 4096: their counts fit into 16 bits and vectorise.
            for part in frame.chunks(4096) {
                sum += u64::from(part.iter().map(|&x| u32::from(x)).sum::<u32>());
                saturated += u64::from(part.iter().map(|&x| u16::from(x >= self.full_scale)).sum::<u16>());
                black += u64::from(part.iter().map(|&x| u16::from(x == 0)).sum::<u16>());
            }
            for &code in self.masked.iter().filter_map(|&i| frame.get(i)) {
                sum -= u64::from(code);
                saturated -= u64::from(code >= self.full_scale);
                black -= u64::from(code == 0);
            }
            self.frame_sums.push(sum);
            self.saturated += saturated;
            self.black += black;
            match self.previous.take() {
                Some(first) => self.pairs.push(pair(&first, frame, &self.masked)),
                None => self.previous = Some(frame.to_vec()),
            }
        }
        Ok(())
    }

    /// Computes the level; `None` before the first frame. With one frame, or with every pixel clipped, the
    /// variance is NaN.
    pub fn finish(&self) -> Option<Level> {
        let frames = self.moments.frames();
        let n = frames as f64;
        let full = u64::from(self.full_scale);
        let all = self.moments.sums();
        let without = self.masked_and_jumping();
        let masked = all.len().min(without.len());
        // Runs between the excluded pixels.
        let ends = without.iter().copied().chain([all.len()]);
        let starts = std::iter::once(0).chain(without.iter().map(|i| i + 1));
        let sums = || starts.clone().zip(ends.clone()).flat_map(|(from, to)| &all[from.min(to)..to]).copied();
        let stuck_high = sums().filter(|&s| s == frames * full).count() as u64;
        let stuck_low = sums().filter(|&s| s == 0).count() as u64;
        let counted = (all.len() - masked) as u64;
        let pixels = counted - stuck_high - stuck_low;
        if frames == 0 {
            return None;
        }
        if frames < 2 || pixels < 2 {
            let samples = n * counted as f64;
            let mean_dn = sums().sum::<u64>() as f64 / samples;
            // The spatial variance of one frame includes the noise.
            let between = sums().map(|s| (s as f64 / n - mean_dn).powi(2)).sum::<f64>();
            return Some(Level {
                frames,
                pixels,
                mean_dn,
                var_dn2: f64::NAN,
                spatial_var_dn2: between / (counted as f64 - 1.0),
                frame_mean_var_dn2: f64::NAN,
                saturated: self.saturated as f64 / samples,
                black: self.black as f64 / samples,
                stuck: (stuck_high + stuck_low) as f64 / counted as f64,
                pairs: Vec::new(),
                masked: masked as u64,
                struck: 0,
                square_dn4: f64::NAN,
            });
        }
        let m = pixels as f64;
        let samples = n * m;
        // Stuck pixels do not vary: they contribute a constant to the frame sums.
        let jumping_dn: f64 = {
            let sum = |pixels: &[usize]| pixels.iter().filter_map(|&i| all.get(i)).sum::<u64>() as f64;
            (sum(&without) - sum(&self.masked)) / n
        };
        let frame_means: Vec<f64> =
            self.frame_sums.iter().map(|s| ((s - stuck_high * full) as f64 - jumping_dn) / m).collect();
        let mean_dn = frame_means.iter().sum::<f64>() / n;
        let between_frames: f64 = frame_means.iter().map(|f| (f - mean_dn).powi(2)).sum();
        let of_masked: f64 = without.iter().map(|&i| self.moments.spread_dn2(i)).sum();
        let within_pixels = (self.moments.total_spread_dn2() - of_masked) / n;
        let var_dn2 = (within_pixels - m * between_frames).max(0.0) / ((n - 1.0) * (m - 1.0));
        let used = sums().filter(|&s| s != 0 && s != frames * full);
        let between_pixels: f64 = used.map(|s| (s as f64 / n - mean_dn).powi(2)).sum::<f64>() / (m - 1.0);
        Some(Level {
            frames,
            pixels,
            mean_dn,
            var_dn2,
            spatial_var_dn2: (between_pixels - var_dn2 / n).max(0.0),
            frame_mean_var_dn2: between_frames / (n - 1.0),
            saturated: (self.saturated - stuck_high * frames) as f64 / samples,
            black: (self.black - stuck_low * frames) as f64 / samples,
            stuck: (stuck_high + stuck_low) as f64 / counted as f64,
            pairs: self.pairs.clone(),
            masked: masked as u64,
            struck: 0,
            square_dn4: self.square_dn4(&without),
        })
    }
}

/// Minimum variance of a jumping pixel over the mean variance: in standard errors of the sum over the pixels,
/// so that the pixel alone dominates it; and as a ratio, since noisy pixels reach lower ones (named choices).
const DECIDES: f64 = 3.0;
const MIN_JUMP: f64 = 100.0;

impl LevelAccumulator {
    /// Returns the masked pixels and those that jump from one level to another in the set (traps,
    /// after-effects of a ray): one of a million that moves by half the range doubles the variance of a dark.
    fn masked_and_jumping(&self) -> Vec<usize> {
        let (n, pixels) = (self.moments.frames() as f64, self.moments.sums().len());
        let of_masked: f64 = self.masked.iter().map(|&i| self.moments.spread_dn2(i)).sum();
        let counted = (pixels - self.masked.len().min(pixels)) as f64;
        let mut out = self.masked.clone();
        if n < 2.0 || counted < 2.0 {
            return out;
        }
        // The variance falls with each pixel found, which reveals more of them.
        let mut left = self.moments.total_spread_dn2() - of_masked;
        let limit = (DECIDES * (2.0 * counted / (n - 1.0)).sqrt()).max(MIN_JUMP);
        for _ in 0..3 {
            let most = limit * left / counted;
            let found: Vec<usize> = (0..pixels)
                .filter(|&i| self.moments.spread_dn2(i) > most && out.binary_search(&i).is_err())
                .collect();
            if found.is_empty() {
                break;
            }
            left -= found.iter().map(|&i| self.moments.spread_dn2(i)).sum::<f64>();
            out.extend(found);
            out.sort_unstable();
        }
        out
    }

    /// Computes the mean squared variance, with E s^4 = sigma^4 (1 + 2 / (n - 1)) for the variance s^2 of n
    /// normal numbers.
    fn square_dn4(&self, without: &[usize]) -> f64 {
        let n = self.moments.frames() as f64;
        let square = |i: usize| (self.moments.spread_dn2(i) / (n * (n - 1.0))).powi(2);
        let pixels = self.moments.sums().len();
        let all: f64 = (0..pixels).map(square).sum();
        let of_masked: f64 = without.iter().map(|&i| square(i)).sum();
        (all - of_masked) / (pixels - without.len()) as f64 / (1.0 + 2.0 / (n - 1.0))
    }
}

/// Computes eq. (37) and (38) for two frames, without masked pixels.
fn pair(first: &[u16], second: &[u16], masked: &[usize]) -> Pair {
    let (mut sum, mut difference, mut square) = (0u64, 0i64, 0u64);
    for (&a, &b) in first.iter().zip(second) {
        let d = i64::from(a) - i64::from(b);
        sum += u64::from(a) + u64::from(b);
        difference += d;
        square += (d * d) as u64;
    }
    for (&a, &b) in masked.iter().filter_map(|&i| first.get(i).zip(second.get(i))) {
        let d = i64::from(a) - i64::from(b);
        sum -= u64::from(a) + u64::from(b);
        difference -= d;
        square -= (d * d) as u64;
    }
    let m = (first.len() - masked.len().min(first.len())) as f64;
    let mean_difference = difference as f64 / m;
    let spread = square as f64 - m * mean_difference * mean_difference;
    Pair {
        mean_dn: sum as f64 / (2.0 * m),
        var_dn2: spread / (2.0 * (m - 1.0)),
        difference_dn: mean_difference,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    fn noise(frame: u64, pixel: u32) -> f64 {
        PixelRng::new(5, Stream::Frame, frame, pixel, 9).normal()
    }

    /// Two frames give eq. (38); flicker and a stuck pixel change only their own figures.
    #[test]
    fn two_frames_give_the_pair_of_the_paper() {
        let frame = |f: u64, light: f64| -> Vec<u16> {
            (0..4000).map(|p| (1000.0 + light + f64::from(p % 50) + 8.0 * noise(f, p)) as u16).collect()
        };
        let mut plain = LevelAccumulator::new((40, 100), 12);
        plain.add(&[&frame(0, 0.0), &frame(1, 0.0)]).unwrap();
        let plain = plain.finish().unwrap();
        assert!((plain.var_dn2 - plain.pairs[0].var_dn2).abs() < 1e-9);
        assert!((plain.mean_dn - plain.pairs[0].mean_dn).abs() < 1e-9);

        let (mut a, mut b) = (frame(0, 0.0), frame(1, 37.0));
        (a[17], b[17]) = (4095, 4095);
        (a[18], b[18]) = (0, 0);
        let mut other = LevelAccumulator::new((40, 100), 12);
        other.add(&[&a]).unwrap();
        assert!(other.finish().unwrap().var_dn2.is_nan());
        other.add(&[&b]).unwrap();
        let other = other.finish().unwrap();
        assert!((other.var_dn2 / plain.var_dn2 - 1.0).abs() < 2e-3);
        assert_eq!((other.saturated, other.black, other.stuck), (0.0, 0.0, 2.0 / 4000.0));
        assert!((other.frame_mean_var_dn2 - 37.0f64.powi(2) / 2.0).abs() < 20.0);
    }

    /// A pixel of 40 000 that jumps by 3000 DN in the middle of a set would add 80 DN^2 to 64. Without it the
    /// variance agrees with that of the others to 0.1 %; a pixel with ten times the noise is kept.
    #[test]
    fn a_pixel_that_jumps_does_not_decide() {
        let frame = |f: u64, jump: f64, noisy: f64| -> Vec<u16> {
            let value = |p: u32| {
                let more = if p == 7 { jump } else { 0.0 };
                let times = if p == 9 { noisy } else { 1.0 };
                (1000.0 + more + 8.0 * times * noise(f, p)) as u16
            };
            (0..40_000).map(value).collect()
        };
        let level = |jump: f64, noisy: f64| {
            let mut level = LevelAccumulator::new((200, 200), 16);
            for f in 0..10 {
                level.add(&[&frame(f, if f > 4 { jump } else { 0.0 }, noisy)]).unwrap();
            }
            level.finish().unwrap()
        };
        let (still, jumps, noisy) = (level(0.0, 1.0), level(3000.0, 1.0), level(0.0, 10.0));
        assert_eq!((still.masked, jumps.masked, noisy.masked), (0, 1, 0));
        assert!((jumps.var_dn2 / still.var_dn2 - 1.0).abs() < 1e-3, "{} {}", jumps.var_dn2, still.var_dn2);
        assert!((jumps.mean_dn - still.mean_dn).abs() < 0.01, "{} {}", jumps.mean_dn, still.mean_dn);
        assert!((noisy.var_dn2 - still.var_dn2 - 99.0 * 64.0 / 40_000.0).abs() < 0.15, "{}", noisy.var_dn2);
    }

    /// Over 300 sets of six frames the pooled variance has the expected mean and scatter, each within 5
    /// sigma.
    #[test]
    fn the_pooled_variance_has_its_stated_degrees_of_freedom() {
        let (sets, sigma) = (300, 8.0);
        let z: Vec<f64> = (0..sets)
            .map(|set| {
                let mut level = LevelAccumulator::new((10, 20), 12);
                for f in 0..6 {
                    let frame: Vec<u16> = (0..200)
                        .map(|p| (1000.5 + f64::from(p) + sigma * noise(set * 6 + f, p)) as u16)
                        .collect();
                    level.add(&[&frame]).unwrap();
                }
                let level = level.finish().unwrap();
                let expected = sigma * sigma + 1.0 / 12.0;
                (level.var_dn2 / expected - 1.0) * (level.dof() / 2.0).sqrt()
            })
            .collect();
        let n = sets as f64;
        let mean = z.iter().sum::<f64>() / n;
        let var = z.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / (n - 1.0);
        assert!(mean.abs() < 5.0 / n.sqrt(), "{mean}");
        assert!((var - 1.0).abs() < 5.0 * (2.0 / n).sqrt(), "{var}");
    }
}
