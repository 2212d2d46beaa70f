//! Defect pixels: hot, dead, unstable and blind ones, each with its reason.

use super::dark::DarkMean;
use crate::statistics::lit::Lit;
use crate::statistics::median::median;
use ndarray::{Array2, Zip};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Flag of a pixel whose dark signal stands out.
pub const HOT: u8 = 1;
/// Flag of a pixel that hardly responds to light, or far too much.
pub const DEAD: u8 = 2;
/// Flag of a pixel whose dark values scatter more than the noise of its neighbours.
pub const UNSTABLE: u8 = 4;
/// Flag of a pixel that no light reaches, like its neighbours: outside the image circle of the lens,
/// optically black, or overscan.
pub const BLIND: u8 = 8;
/// All flags.
pub const ALL_FLAGS: u8 = HOT | DEAD | UNSTABLE | BLIND;
/// Flags of pixels of unknown response: their K is set to 1.
pub const NO_RESPONSE: u8 = DEAD | BLIND;

/// Minimum dark signal of a hot pixel, in robust standard deviations of all pixels.
const HOT_SIGMA: f64 = 8.0;
/// K below which, and above whose inverse, a pixel is dead.
pub(super) const DEAD_K: f32 = 0.5;
/// Maximum K that is printed as a number.
const MAX_SAID_K: f64 = 100.0;
/// Probability that one sound pixel of the whole frame counts as unstable.
const UNSTABLE_CHANCE: f64 = 1e-3;
/// Minimum temporal variance of an unstable pixel over the usual one: what matters to a user.
const UNSTABLE_RATIO: f64 = 2.0;

/// Defect pixel with its measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Defect {
    /// Row.
    pub y: usize,
    /// Column.
    pub x: usize,
    /// Sum of [`HOT`], [`DEAD`], [`UNSTABLE`], [`BLIND`].
    pub flags: u8,
    /// Dark signal above the median of all pixels, DN, at the longest exposure.
    pub dark_excess_dn: f64,
    /// K.
    pub k: f64,
    /// Temporal variance in the dark over that expected of such a pixel.
    pub variance_ratio: f64,
}

impl Defect {
    /// Formats the reason.
    pub fn reason(&self) -> String {
        let mut why = Vec::new();
        if self.flags & HOT != 0 {
            why.push(format!("hot: {:+.1} DN in the dark", self.dark_excess_dn));
        }
        if self.flags & DEAD != 0 {
            why.push(match self.k {
                k if k > MAX_SAID_K => {
                    format!("too bright: K above {MAX_SAID_K}, its neighbours see next to no light")
                }
                k if k > 1.0 => format!("too bright: K = {k:.3}"),
                k => format!("dead: K = {k:.3}"),
            });
        }
        if self.flags & BLIND != 0 {
            why.push("blind: no light reaches it, or a part of it".into());
        }
        if self.flags & UNSTABLE != 0 {
            why.push(format!("unstable: {:.1} times the usual variance in the dark", self.variance_ratio));
        }
        why.join("; ")
    }
}

/// Finds the defects of a camera, row by row. `gain_dn_per_e` allows a hot pixel the shot noise of its dark
/// charge; without it, 1 DN/e is assumed.
///
/// Hot pixels are searched at the longest exposure, unstable ones at the exposure with the most frames.
pub fn find(darks: &[DarkMean], k: &Array2<f32>, light: &Lit, gain_dn_per_e: Option<f64>) -> Vec<Defect> {
    let longest = darks.iter().max_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s));
    let most = darks.iter().filter(|d| d.frames >= 3).max_by_key(|d| d.frames);
    let excess = longest.map(|d| {
        let middle = median(d.mean_dn.iter().copied());
        let spread = median(d.mean_dn.iter().map(|m| (m - middle).abs())) / 0.6745;
        let noise = (median(d.var_dn2.iter().copied()).max(1.0 / 12.0) / d.frames as f64).sqrt();
        (d.mean_dn.mapv(|m| m - middle), HOT_SIGMA * spread.max(noise))
    });
    let scatter = most.map(|d| {
        let usual = median(d.var_dn2.iter().copied()).max(1.0 / 12.0);
        let middle = median(d.mean_dn.iter().copied());
        let gain = gain_dn_per_e.unwrap_or(1.0);
        let dof = (d.frames - 1) as f64;
        let chance = UNSTABLE_CHANCE / d.var_dn2.len() as f64;
        let limit = ChiSquared::new(dof).map_or(f64::INFINITY, |c| c.inverse_cdf(1.0 - chance)) / dof;
        let ratio = Zip::from(&d.var_dn2)
            .and(&d.mean_dn)
            .map_collect(|&v, &m| v / (usual + gain * (m - middle).max(0.0)));
        (ratio, limit.max(UNSTABLE_RATIO))
    });
    let mut found = Vec::new();
    for ((y, x), &k) in k.indexed_iter() {
        let at = |map: &Option<(Array2<f64>, f64)>| map.as_ref().map_or((0.0, 1.0), |(m, l)| (m[(y, x)], *l));
        let ((dark_excess_dn, hot), (variance_ratio, unstable)) = (at(&excess), at(&scatter));
        let mut flags = 0;
        flags |= if dark_excess_dn > hot { HOT } else { 0 };
        flags |= match (light.blind[(y, x)], light.lit[(y, x)]) {
            (true, _) => BLIND,
            (false, true) if (DEAD_K..=1.0 / DEAD_K).contains(&k) => 0,
            _ => DEAD,
        };
        flags |= if scatter.is_some() && variance_ratio > unstable { UNSTABLE } else { 0 };
        if flags != 0 {
            found.push(Defect { y, x, flags, dark_excess_dn, k: k.into(), variance_ratio });
        }
    }
    found
}

/// Returns for each flagged pixel the nearest sound ones that replace it: places in the frame, row by row. A
/// pixel without any within three rows and columns is not replaced.
pub fn replacements(flags: &Array2<u8>) -> Vec<(usize, Vec<usize>)> {
    replacements_of(flags, 1)
}

/// As `replacements`, for pixels of one colour `step` apart: only pixels of the same colour replace a pixel.
pub fn replacements_of(flags: &Array2<u8>, step: usize) -> Vec<(usize, Vec<usize>)> {
    let (rows, columns) = flags.dim();
    let around = |y: usize, x: usize, reach: usize| -> Vec<usize> {
        let near = |at: usize, end: usize| {
            (at.saturating_sub(reach * step)..(at + reach * step + 1).min(end))
                .filter(move |b| b.abs_diff(at) % step == 0)
        };
        near(y, rows)
            .flat_map(|b| near(x, columns).map(move |a| (b, a)))
            .filter(|&at| flags[at] == 0)
            .map(|(b, a)| b * columns + a)
            .collect()
    };
    flags
        .indexed_iter()
        .filter(|(_, f)| **f != 0)
        .filter_map(|((y, x), _)| {
            let sound = (1..=3).map(|reach| around(y, x, reach)).find(|s| !s.is_empty())?;
            Some((y * columns + x, sound))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Ten thousand pixels with noise, three of them defective in different ways; only those are found.
    #[test]
    fn broken_pixels_are_found_and_sound_ones_are_not() {
        let shape = (100, 100);
        let frames = 30;
        let mut sum = Array2::<f64>::zeros(shape);
        let mut square = Array2::<f64>::zeros(shape);
        for f in 0..frames {
            for ((y, x), s) in sum.indexed_iter_mut() {
                let normal = PixelRng::new(8, Stream::Frame, f, (y * 100 + x) as u32, 0).normal();
                let broken = if (y, x) == (7, 9) { 8.0 } else { 1.0 };
                let v = 64.0 + normal * broken + if (y, x) == (50, 3) { 40.0 } else { 0.0 };
                *s += v;
                square[(y, x)] += v * v;
            }
        }
        let n = frames as f64;
        let mean_dn = &sum / n;
        let var_dn2 = (&square - &mean_dn * &mean_dn * n) / (n - 1.0);
        let mut k = Array2::from_elem(shape, 1.0f32);
        k[(99, 99)] = 0.1;
        let dark = DarkMean { exposure_s: 1.0, frames, mean_dn, var_dn2 };
        let light = Lit::of(&[Array2::from_elem(shape, 500.0)]);
        let found = find(&[dark], &k, &light, None);
        let seen: Vec<_> = found.iter().map(|d| ((d.y, d.x), d.flags)).collect();
        assert_eq!(seen, [((7, 9), UNSTABLE), ((50, 3), HOT), ((99, 99), DEAD)]);
        assert!(found[1].reason().starts_with("hot: +40"), "{}", found[1].reason());
    }

    #[test]
    fn a_cluster_is_replaced_from_its_rim() {
        let mut flags = Array2::zeros((5, 6));
        flags[(0, 0)] = HOT;
        for (y, x) in (1..4).flat_map(|y| (2..5).map(move |x| (y, x))) {
            flags[(y, x)] = DEAD;
        }
        let all = replacements(&flags);
        assert_eq!(all.len(), 10);
        assert_eq!(all[0], (0, vec![1, 6, 7]));
        let middle = all.iter().find(|(at, _)| *at == 2 * 6 + 3).unwrap();
        assert!(middle.1.len() > 8 && middle.1.iter().all(|&i| flags[(i / 6, i % 6)] == 0));
    }
}
