//! Frames and sets of a campaign, as far as a prediction needs them.

use super::PLACES;
use crate::quantize::{Rounded, rounded};

/// Exposures before a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Before {
    /// The frame before it in the campaign.
    #[default]
    Frame,
    /// Frames of its own level that are not in the campaign.
    Level,
    /// Dark frames that are not in the campaign.
    Dark,
    /// The frame before it in the campaign, and then so many frames of its own level that are not in it.
    Discarded(u8),
}

/// A frame of a campaign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameInfo {
    /// Index of its set in [`Campaign::sets`].
    pub set: usize,
    /// Start of its exposure, s from the start of the campaign.
    pub time_s: f64,
    /// Exposures before it.
    pub before: Before,
}

/// A set of frames: darks or flats of one exposure and light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SetInfo {
    /// Exposure, s.
    pub exposure_s: f64,
    /// Index of the lamp level that gives the electrons per pixel and second; `None`: dark.
    pub light: Option<usize>,
    /// Light relative to the campaign's unit.
    pub illumination: f64,
    /// Light of this set over that of its lamp level: 1 if every level has a light of its own.
    pub light_ratio: f64,
    /// Spatial deviation of the signal over its mean.
    pub spread: f64,
    /// Spatial deviation of the level, fixed pattern of the offset included, DN.
    pub spread_dn: f64,
    /// Levels of the groups of pixels with the shares [`PLACES`], in deviations from the mean.
    pub places: [f64; PLACES.len()],
}

/// Settings of a campaign that a prediction needs.
#[derive(Debug, Clone, PartialEq)]
pub struct Campaign {
    /// Frames in the order of time, including those not analysed (scenes).
    pub frames: Vec<FrameInfo>,
    /// Sets.
    pub sets: Vec<SetInfo>,
    /// Rows and columns.
    pub shape: (usize, usize),
    /// Largest code, DN.
    pub full_scale_dn: f64,
    /// True if levels count from code 0; false for tables whose dark level was subtracted.
    pub from_code_0: bool,
    /// Typical time from the end of a frame to the end of the next, s.
    pub frame_s: f64,
    /// Strongest line of the noise spectrum in read-out order, cycles per pixel.
    pub line_cycles_per_px: Option<f64>,
    /// Noise of the ordinary pixels in darks, if darks show it.
    pub ordinary: Option<Ordinary>,
}

/// Dark noise of the ordinary pixels, without the few far noisier ones, before rounding.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ordinary {
    /// Mean of their variances, DN^2.
    pub variance_dn2: f64,
    /// Variance of their variances over the square of their mean.
    pub spread: f64,
}

impl Ordinary {
    /// Derives the noise of the ordinary pixels from darks: from the median of the pixels' variances (DN^2),
    /// the standard deviation of the logarithm of their noise, and the mean level and spread of the darks
    /// (DN).
    ///
    /// Rounding adds 1/12 if the noise is a code or more. Below that the addition depends on the place
    /// between two codes (Widrow and Kollar 2008, ch. 4), and is subtracted as it is at the level of these
    /// darks. Variances are log-normal (Johnson, Kotz and Balakrishnan 1994, ch. 14).
    pub fn of_darks(median_dn2: f64, log_spread: f64, level_dn: f64, spread_dn: f64) -> Self {
        let shown = |variance: f64| {
            // The level is measured after rounding.
            let mut level = level_dn;
            for _ in 0..LEVEL_ROUNDS {
                level = level_dn - rounded(level, spread_dn, variance).mean;
            }
            let r = rounded(level, spread_dn, variance);
            (variance + r.variance, r.unequal)
        };
        let (mut low, mut high) = (LEAST_VARIANCE, median_dn2.max(LEAST_VARIANCE));
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if shown(middle).0 < median_dn2 { low = middle } else { high = middle }
        }
        let (median, (at, unequal)) = (high, shown(high));
        let slope = ((shown(1.05 * median).0 - at) / (0.05 * median)).max(0.1);
        let square = (4.0 * log_spread * log_spread - unequal / (at * at).max(f64::MIN_POSITIVE)).max(0.0)
            * (at / (slope * median)).powi(2);
        let square = square.min(LARGEST_SPREAD);
        Self { variance_dn2: median * libm::exp(0.5 * square), spread: libm::expm1(square) }
    }

    /// Returns the variance of the ordinary pixels' noise and its spread over the pixels, given the variance
    /// of all pixels and the part of it that is read noise, in squares of the code's step.
    pub(super) fn of(self, variance: f64, read: f64, step: f64) -> (f64, f64) {
        let dark = (self.variance_dn2 / (step * step)).clamp(0.1 * read, read);
        let own = variance - read + dark;
        (own, self.spread * (dark / own.max(1e-12)).powi(2))
    }
}

/// Pixels that are noisier than the ordinary ones, in squares of the code's step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Noisy {
    /// Share of the pixels.
    share: f64,
    /// Variance of their noise.
    pub variance: f64,
}

/// Minimum part of the variance of all pixels that is due to the noisy ones, for them to be clipped apart (a
/// named choice).
const NOISY_PART: f64 = 0.01;

impl Noisy {
    /// Derives share and variance of the noisy pixels from the variance of the ordinary ones, the mean over
    /// all pixels, and the variance of the pixels' variances that the ordinary ones leave over: two groups
    /// with these moments.
    pub fn beside(ordinary: f64, all: f64, unlike: f64) -> Option<Self> {
        let more = all - ordinary;
        let apart = unlike.max(0.0) / more + more;
        (more > NOISY_PART * all && apart > more)
            .then(|| Self { share: more / apart, variance: ordinary + apart })
    }

    /// Returns what clipping leaves of both groups together.
    pub fn mixed(self, ordinary: f64, clip: impl Fn(f64) -> Rounded) -> Rounded {
        let (a, b) = (clip(ordinary), clip(self.variance));
        let both = |a: f64, b: f64| (1.0 - self.share) * a + self.share * b;
        let apart = |a: f64, b: f64| self.share * (1.0 - self.share) * (b - a) * (b - a);
        Rounded {
            mean: both(a.mean, b.mean),
            slope: both(a.slope, b.slope),
            variance: both(a.variance, b.variance),
            unequal: both(a.unequal, b.unequal) + apart(ordinary + a.variance, self.variance + b.variance)
                - apart(ordinary, self.variance),
            fourth: both(a.fourth, b.fourth),
        }
    }
}

/// Number of iterations after which a level before rounding is known to a hundredth of a code.
const LEVEL_ROUNDS: usize = 5;
/// Minimum variance that differs from none, DN^2 (a named choice: a tenth of a code).
const LEAST_VARIANCE: f64 = 0.01;
/// Maximum variance of the logarithm of the pixels' variances (a named choice: a factor of two in noise
/// either way).
const LARGEST_SPREAD: f64 = 2.0;

/// Maximum noise variance, codes squared, at which the spread of levels is corrected for rounding. The slope
/// of a rounded level differs from 1 by at most 2 exp(-2 pi^2 variance) (Widrow and Kollar 2008, ch. 4).
const LEAVES_SPREAD: f64 = 0.2;

/// Returns the spread of the pixels' levels before rounding, from the spread of their measured means, in
/// steps. Close to the edge between two codes, rounding of little noise enlarges small differences.
pub(super) fn before_rounding(level: f64, measured: f64, variance: f64) -> f64 {
    if variance > LEAVES_SPREAD {
        return measured;
    }
    (0..SPREAD_ROUNDS).fold(measured, |spread, _| measured / rounded(level, spread, variance).slope.max(1.0))
}

/// Number of iterations after which the spread is known to some per cent.
const SPREAD_ROUNDS: usize = 6;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::predict::NORMAL;
    use crate::quantize::rounded_from_zero;
    use crate::rng::{PixelRng, Stream};

    /// Pixels of 0.9 codes of noise, one in 200 of 5 codes, 2.5 codes above code 0: mean, mean variance and
    /// variance of the variances after clipping agree with 400 lists of 2000 pixels within five standard
    /// errors.
    #[test]
    fn noisy_pixels_are_clipped_more_than_others() {
        let (level, share, ordinary, loud) = (2.5, 1.0 / 200.0, 0.81, 25.0);
        let apart: f64 = loud - ordinary;
        let unlike = share * (1.0 - share) * apart * apart;
        let noisy = Noisy::beside(ordinary, ordinary + share * apart, unlike).unwrap();
        assert!((noisy.share - share).abs() < 1e-12 && (noisy.variance - loud).abs() < 1e-9);
        let found = noisy.mixed(ordinary, |variance| rounded_from_zero(level, 0.0, &NORMAL, variance));
        let variance = ordinary + share * apart + found.variance;
        let expected = [level + found.mean, variance, unlike + found.unequal];
        let list = |k: u32| {
            let mut rng = PixelRng::new(31, Stream::Effect, 0, k, 0);
            let mut sums = [0.0; 3];
            for pixel in 0..2000 {
                let sd = if pixel % 200 == 0 { loud } else { ordinary }.sqrt();
                let mut codes = || (level + sd * rng.normal()).round().max(0.0);
                let (a, b, c, d) = (codes(), codes(), codes(), codes());
                // Two independent estimates of a pixel's variance: their product has no bias.
                let (one, other) = (0.5 * (a - b) * (a - b), 0.5 * (c - d) * (c - d));
                sums[0] += 0.25 * (a + b + c + d);
                sums[1] += 0.5 * (one + other);
                sums[2] += (one - variance) * (other - variance);
            }
            sums.map(|sum| sum / 2000.0)
        };
        let all: Vec<[f64; 3]> = (0..400).map(list).collect();
        for (k, expected) in expected.into_iter().enumerate() {
            let mean = all.iter().map(|l| l[k]).sum::<f64>() / 400.0;
            let error = (all.iter().map(|l| (l[k] - mean).powi(2)).sum::<f64>() / 399.0 / 400.0).sqrt();
            assert!((mean - expected).abs() < 5.0 * error, "{k}: {mean} +- {error} for {expected}");
        }
    }
}
