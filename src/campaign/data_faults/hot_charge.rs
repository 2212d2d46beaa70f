//! System gain from the charge of hot pixels in a dark: their shot noise A^2 E_DC over their level A
//! E_DC (Healey and Kondepudy 1994, eq. 35). A level that the camera subtracts from all pixels alike
//! affects neither.

use crate::statistics::median::{ERROR_OVER_MEAN, MAD_OF_NORMAL, median};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Minimum distance of a hot pixel from the level of the frame, robust standard deviations over the
/// pixels and DN (named choices): noise and fixed offset pattern are small beside its charge.
const MIN_SPREADS: f64 = 12.0;
const MIN_ABOVE_DN: f64 = 10.0;
/// Maximum code of a hot pixel, relative to full scale, so that its noise stays below.
const MAX_OF_FULL: f64 = 0.75;
/// Minimum number of hot pixels, and number beyond which more add nothing (named choices).
const PIXELS: std::ops::RangeInclusive<usize> = 10..=1024;
/// Maximum number of frames stored for hot pixels.
const MAX_FRAMES: usize = 64;
/// Minimum ratio of the noise of the charge to that of other pixels (a named choice).
const MIN_OVER_OTHERS: f64 = 2.0;

/// Gain from the hot pixels of a dark.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HotCharge {
    /// Gain, DN/e.
    pub gain_dn_per_e: f64,
    /// Degrees of freedom of the underlying variances.
    pub dof: f64,
}

impl HotCharge {
    /// Combines several gains, DN/e, with standard error: the relative error of a variance is sqrt(2 /
    /// dof).
    pub fn of_all(all: impl Iterator<Item = Self>) -> Option<(f64, f64)> {
        let (sum, dof) = all.fold((0.0, 0.0), |(sum, dof), h| (sum + h.dof * h.gain_dn_per_e, dof + h.dof));
        let gain = sum / dof;
        (dof > 0.0).then(|| (gain, gain.abs() * ERROR_OVER_MEAN * (2.0 / dof).sqrt()))
    }
}

/// Hot pixels of a set while its frames are read, selected in the first frame.
#[derive(Debug, Default)]
pub(super) struct HotPixels {
    places: Vec<usize>,
    level_dn: f64,
    /// Codes of the hot pixels, frame by frame.
    codes: Vec<Vec<u16>>,
}

impl HotPixels {
    /// Adds the next frame.
    pub fn add(&mut self, codes: &[u16], full: u16) {
        if self.codes.is_empty() {
            self.find(codes, full);
        }
        if self.codes.len() < MAX_FRAMES {
            self.codes.push(self.places.iter().map(|&i| codes.get(i).copied().unwrap_or(0)).collect());
        }
    }

    fn find(&mut self, codes: &[u16], full: u16) {
        // Every n-th pixel suffices for level and spread.
        let step = (codes.len() / 16_384).max(1);
        let some = || codes.iter().step_by(step).map(|c| f64::from(*c));
        self.level_dn = median(some());
        let spread_dn = median(some().map(|c| (c - self.level_dn).abs())) / MAD_OF_NORMAL;
        let least = self.level_dn + (MIN_SPREADS * spread_dn).max(MIN_ABOVE_DN);
        let is_hot = |code: u16| f64::from(code) > least && f64::from(code) < MAX_OF_FULL * f64::from(full);
        let hot: Vec<usize> =
            codes.iter().enumerate().filter(|(_, code)| is_hot(**code)).map(|(i, _)| i).collect();
        let every = hot.len().div_ceil(*PIXELS.end()).max(1);
        self.places = hot.into_iter().step_by(every).collect();
    }

    /// Returns the gain; `noise_dn2` is the temporal variance of the other pixels. `None` with few hot
    /// pixels or single frames. The median ignores jumping pixels, and a common drift of the charge is
    /// removed.
    pub fn finish(self, noise_dn2: f64) -> Option<HotCharge> {
        // The first frame may contain carry-over from the previous set.
        let frames = &self.codes[usize::from(self.codes.len() > 3)..];
        if self.places.len() < *PIXELS.start() || frames.len() < 2 {
            return None;
        }
        let n = frames.len() as f64;
        let above: Vec<f64> = (0..self.places.len())
            .map(|k| frames.iter().map(|f| f64::from(f[k])).sum::<f64>() / n - self.level_dn)
            .collect();
        let mut squares = vec![0.0; above.len()];
        for frame in frames {
            let off = |k: usize| f64::from(frame[k]) - self.level_dn - above[k];
            // The median ignores jumping pixels.
            let drift = median((0..above.len()).filter(|&k| above[k] > 0.0).map(|k| off(k) / above[k]));
            squares.iter_mut().enumerate().for_each(|(k, s)| *s += (off(k) - drift * above[k]).powi(2));
        }
        // Median of chi^2 relative to its degrees of freedom.
        let dof = n - 1.0;
        let of_median = ChiSquared::new(dof).ok()?.inverse_cdf(0.5) / dof;
        let gain = |k: usize| (squares[k] / dof / of_median - noise_dn2) / above[k];
        let hot = || (0..above.len()).filter(|&k| above[k] > 0.0);
        let rough = median(hot().map(gain));
        let kept: Vec<usize> = hot().filter(|&k| above[k] * rough > MIN_OVER_OTHERS * noise_dn2).collect();
        (kept.len() >= *PIXELS.start()).then(|| HotCharge {
            gain_dn_per_e: median(kept.iter().map(|&k| gain(k))),
            dof: dof * kept.len() as f64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Darks with some hot pixels, of which every tenth jumps by 200 DN in half of the frames, and a
    /// level that grows by 2 % of the charge over the set: the gain is recovered without bias, and
    /// scatters as stated.
    #[test]
    fn hot_pixels_tell_the_gain() {
        for (frames, hot) in [(2, 60), (4, 30), (16, 24), (8, 400)] {
            let gain = 0.5;
            let (mut sum, mut square, mut tell) = (0.0, 0.0, 0.0);
            let n = 200;
            for seed in 0..n {
                let mut pixels = HotPixels::default();
                for frame in 0..frames {
                    let draw = |i: u32| PixelRng::new(11, Stream::Frame, frame, seed, i);
                    let code = |i: u32| {
                        let read_dn = 100.0 + 1.5 * draw(i).normal();
                        let is_hot = i % (8000 / hot) == 3;
                        let charge_e = if is_hot { 200.0 + f64::from(i) / 8.0 } else { 0.0 };
                        let charge_e = charge_e * (1.0 + 0.02 * frame as f64 / frames as f64);
                        let shot_e = charge_e.sqrt() * draw(i + 100_000).normal();
                        let jumps = is_hot && i.is_multiple_of(10) && draw(i + 200_000).normal() > 0.0;
                        (read_dn + gain * (charge_e + shot_e) + if jumps { 200.0 } else { 0.0 }).round()
                            as u16
                    };
                    let codes: Vec<u16> = (0..8000).map(code).collect();
                    pixels.add(&codes, 4095);
                }
                let Some(of) = pixels.finish(1.5 * 1.5 + 1.0 / 12.0) else { continue };
                tell += 1.0;
                sum += of.gain_dn_per_e / gain;
                let (value, std_err) = HotCharge::of_all([of].into_iter()).unwrap();
                square += ((value - gain) / std_err).powi(2);
            }
            let (mean, rms) = (sum / tell, (square / tell).sqrt());
            println!("{frames} frames, {hot} hot pixels: {tell} of {n}, mean {mean:.3}, rms {rms:.2}");
            assert!(tell > 0.9 * f64::from(n));
            // A jumping pixel counts in the noisier half: a shift by 0.05 of a rank, with a larger
            // effect for fewer frames.
            assert!((0.93..1.2).contains(&mean), "{mean}");
            assert!((0.7..1.5).contains(&rms), "{rms}");
        }
    }
}
