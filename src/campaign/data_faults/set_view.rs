//! Set as seen by the checks: means and noise of the remaining frames.

use super::campaign::Zero;
use super::facts::SetFacts;
use super::lost_parts::Zeros;
use super::patterns::MIN_PIXELS;
use crate::dataset::Kind;
use crate::statistics::median::median;

/// Minimum significance with which the noise of frames contradicts lag, standard errors.
pub const MIN_SIGMAS_AGAINST_LAG: f64 = 3.0;

/// Maximum fraction of samples at code 0, beyond those of permanently dark pixels, at which pixels of
/// little charge are not clipped (a named choice).
const MAX_ZEROS: f64 = 0.005;

/// Set with the statistics of its frames.
#[derive(Debug, Clone)]
pub struct SetView {
    /// Number of the set.
    pub number: u32,
    /// Kind: dark, flat or other.
    pub kind: Kind,
    /// Stated exposure, s.
    pub exposure_s: f64,
    /// Stated light.
    pub illumination: f64,
    /// Position of card and light.
    pub configuration: u32,
    /// Statistics of its frames.
    pub facts: SetFacts,
    /// Flags of the frames in use, in time order.
    pub kept: Vec<bool>,
    /// True if the whole set is excluded.
    pub out: bool,
    /// True if the set is excluded for its noise alone.
    pub level_holds: bool,
    /// True if the level is clipped at full scale.
    pub clipped: bool,
    /// Number of its dataset among joined ones.
    pub(super) part: usize,
    /// Usual carry-over of the previous level into the first frame, DN.
    pub(super) carried_dn: f64,
    /// Error of the level from carry-over into later frames, DN: the squared carry-over, as a temporal
    /// filter leaves it; for the first set, whose predecessor is unknown, the difference of its first
    /// frame.
    pub carried_error_dn: f64,
    /// Noise variance of the mean relative to that of as many independent frames.
    pub mean_noise_factor: f64,
    /// Fraction of samples at code 0 in all sets: dead pixels and columns, masks.
    pub(super) zeros_always: f64,
}

impl SetView {
    fn places(&self) -> impl Iterator<Item = usize> + '_ {
        self.kept.iter().enumerate().filter(|(_, kept)| **kept).map(|(i, _)| i)
    }

    /// Returns the number of frames in use.
    pub fn frames(&self) -> usize {
        self.kept.iter().filter(|k| **k).count()
    }

    /// Returns the means of the frames in use, DN.
    pub fn means_dn(&self) -> Vec<f64> {
        self.places().map(|i| self.facts.means_dn[i]).collect()
    }

    /// Returns the means of the frames in use, DN, with the carry-over into the first removed.
    pub(super) fn settled_dn(&self) -> Vec<f64> {
        self.places().map(|i| self.facts.means_dn[i] - if i == 0 { self.carried_dn } else { 0.0 }).collect()
    }

    /// Returns the median of the frames' means, DN, with the carry-over into the first removed.
    pub fn level_dn(&self) -> f64 {
        median(self.settled_dn().into_iter())
    }

    /// Returns the median of the means without the first frame, DN; for a single frame its own mean.
    pub fn behind_first_dn(&self) -> f64 {
        let means = self.means_dn();
        median(means.iter().skip(usize::from(means.len() > 1)).copied())
    }

    /// Returns the standard deviation of the means without the first frame, from their differences, DN;
    /// 0 for fewer than four frames.
    pub fn own_scatter_dn(&self) -> f64 {
        let means = self.means_dn();
        let steps: Vec<f64> = means.windows(2).skip(1).map(|w| (w[1] - w[0]).powi(2)).collect();
        let mean_square = steps.iter().sum::<f64>() / (2.0 * steps.len() as f64);
        if steps.len() > 1 { mean_square.sqrt() } else { 0.0 }
    }

    /// Returns the standard error of the difference between the first frame's mean and the median of the
    /// others, by the pixels' noise and the scatter of the frames, DN; `None` without a pair.
    pub(super) fn first_frame_error_dn(&self) -> Option<f64> {
        let others = self.frames().saturating_sub(1) as f64;
        let of_pixels = (self.variance_dn2()?.0 / self.facts.pixels.max(1.0)).sqrt();
        Some(of_pixels.max(self.own_scatter_dn()) * (1.0 + 1.0 / others.max(1.0)).sqrt())
    }

    /// Returns the mean of the last frame in use, DN.
    pub fn last_dn(&self) -> f64 {
        self.places().last().map_or(f64::NAN, |i| self.facts.means_dn[i])
    }

    /// Returns the number of first frames skipped because of lag; 0 for short sets.
    fn settling(&self) -> usize {
        usize::from(self.kept.len() > 3)
    }

    /// Returns the temporal variance, DN^2, and the number of pairs of successive frames behind it;
    /// `None` without a pair.
    pub fn variance_dn2(&self) -> Option<(f64, f64)> {
        let pair = |i: &usize| *i > self.settling() && self.kept[*i] && self.kept[i - 1];
        let all: Vec<f64> = (0..self.kept.len()).filter(pair).map(|i| self.facts.successive_dn2[i]).collect();
        let n = all.len() as f64;
        (n > 0.0).then(|| (all.iter().sum::<f64>() / n, n))
    }

    /// Returns the variance of successive frames relative to that of frames two apart: 1 for independent
    /// ones. `None` with fewer than three frames.
    pub fn dependence(&self) -> Option<f64> {
        let third =
            |i: &usize| *i > 1 + self.settling() && self.kept[*i] && self.kept[i - 1] && self.kept[i - 2];
        let all: Vec<usize> = (0..self.kept.len()).filter(third).collect();
        let near: f64 = all
            .iter()
            .map(|i| 0.5 * (self.facts.successive_dn2[*i] + self.facts.successive_dn2[i - 1]))
            .sum();
        let far: f64 = all.iter().map(|i| self.facts.second_dn2[*i]).sum();
        (far > 0.0).then(|| near / far)
    }

    /// Returns true if the noise contradicts lag of this fraction from a dimmer previous set.
    pub fn lacks_lag(&self, share: f64, dimmer: &Self) -> bool {
        self.against_lag(share, dimmer).is_some_and(|(off, std)| off > MIN_SIGMAS_AGAINST_LAG * std)
    }

    /// Returns the dependence of successive frames minus that of lag of this fraction from a dimmer
    /// previous set, and its standard deviation; 0 for lag. A fraction f of each frame's charge that is
    /// read with the next correlates successive frames by f (1 - f) of the charge's variance (image-lag,
    /// shape 0), and the variance of a difference is 2 sigma^2 (1 - r).
    pub fn against_lag(&self, share: f64, dimmer: &Self) -> Option<(f64, f64)> {
        let noise = self.variance_dn2().zip(dimmer.variance_dn2());
        let (dependence, ((noise_dn2, _), (dark_dn2, _))) = self.dependence().zip(noise)?;
        let of_lag = share * (1.0 - share) * (1.0 - dark_dn2 / noise_dn2);
        Some((dependence - (1.0 - of_lag), self.dependence_std()))
    }

    /// Returns the standard deviation of [`Self::dependence`] for independent frames: for one triple the
    /// two variances differ by 3/2 of their expectation for each pixel, and overlapping triples are as
    /// informative as others.
    fn dependence_std(&self) -> f64 {
        let triples = self.frames().saturating_sub(self.settling() + 2) as f64;
        1.5 / (self.facts.pixels * triples).max(1.0).sqrt()
    }

    /// Returns true if frames differ more with growing distance in time: the level of lines or parts
    /// wanders. After a temporal filter with the correlation r the variance of the difference is 2
    /// sigma^2 (1 - r^k) for frames k apart: beyond that of successive frames, distant ones have at most
    /// 1 / (1 - r) times what frames two apart have, twice as much for r up to a half.
    pub fn wanders(&self) -> bool {
        const MAX_OF_A_FILTER: f64 = 2.5;
        let Some(((near, _), dependence)) = self.variance_dn2().zip(self.dependence()) else { return false };
        let second = near / dependence;
        self.kept.iter().all(|kept| *kept)
            && self.facts.ends_dn2 - near > MAX_OF_A_FILTER * (second - near).max(0.0)
    }

    /// Returns the fraction of samples at code 0 outside long runs; 0 if unknown.
    pub(super) fn zeros(&self) -> f64 {
        let zeros: f64 = self.facts.zeros.iter().map(Zeros::single).sum();
        let samples = self.facts.pixels * self.facts.zeros.len() as f64;
        if samples > 0.0 { zeros / samples } else { 0.0 }
    }

    /// Returns true if code 0 clips the noise, or the pixels of least charge.
    pub fn is_cut_off(&self) -> bool {
        self.zeros() - self.zeros_always > MAX_ZEROS
            || self.variance_dn2().is_some_and(|(var, _)| self.level_dn() < 4.0 * var.sqrt() + 0.5)
    }

    /// Returns true if the frame means agree; false while the level drifts or settles.
    pub fn is_of_one_level(&self, zero: &Zero) -> bool {
        let means = self.means_dn();
        let most = means.iter().fold(f64::NEG_INFINITY, |a, b| a.max(*b));
        let least = means.iter().fold(f64::INFINITY, |a, b| a.min(*b));
        most - least < (20.0 * zero.scatter_dn).max(0.05 * (self.level_dn() - zero.dn).abs())
    }

    /// Returns stated exposure times light.
    pub fn light(&self) -> f64 {
        self.exposure_s * self.illumination
    }

    /// Returns true if level, noise and fixed pattern are known. The pattern is that of all frames, so
    /// none may be excluded.
    pub fn has_pattern(&self) -> bool {
        let whole = self.kept.iter().all(|kept| *kept);
        whole && !self.clipped && self.variance_dn2().is_some() && self.facts.middle_dn.len() >= MIN_PIXELS
    }

    /// Returns true for a flat whose label states light.
    pub fn is_lit(&self) -> bool {
        self.kind == Kind::Flat && self.illumination > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Returns flats of unit noise in which each frame passes this fraction on to the next; and a dark
    /// without noise.
    fn sets(frames: usize, pixels: usize, share: f64, seed: u32) -> [SetView; 2] {
        let drawn = |f: usize, p: usize| PixelRng::new(7, Stream::Effect, f as u64, seed, p as u32).normal();
        let value = |f: usize, p: usize| (1.0 - share) * drawn(f + 1, p) + share * drawn(f, p);
        let apart = |f: usize, by: usize| -> f64 {
            let Some(before) = f.checked_sub(by) else { return 0.0 };
            let square = (0..pixels).map(|p| 0.5 * (value(f, p) - value(before, p)).powi(2));
            square.sum::<f64>() / pixels as f64
        };
        let view = |noise: f64| SetView {
            number: 0,
            kind: Kind::Flat,
            exposure_s: 1.0,
            illumination: 1.0,
            configuration: 0,
            facts: SetFacts {
                pixels: pixels as f64,
                means_dn: vec![100.0; frames],
                successive_dn2: (0..frames).map(|f| noise * apart(f, 1)).collect(),
                second_dn2: (0..frames).map(|f| noise * apart(f, 2)).collect(),
                ..SetFacts::default()
            },
            kept: vec![true; frames],
            out: false,
            level_holds: false,
            clipped: false,
            part: 0,
            carried_dn: 0.0,
            carried_error_dn: 0.0,
            mean_noise_factor: 1.0,
            zeros_always: 0.0,
        };
        [view(1.0), view(0.0)]
    }

    /// The variance of successive differences relative to that of differences two frames apart is 1 for
    /// independent frames, and scatters as stated, within four standard errors over 200 sets of 4 to 20
    /// frames. Lag of 5 % is not contradicted in 99 of 100 sets, and its absence is detected.
    #[test]
    fn noise_contradicts_lag() {
        for frames in [4, 6, 12, 20] {
            let (mut square, n) = (0.0, 200);
            for seed in 0..n {
                let [flat, _] = sets(frames, 200, 0.0, seed);
                square += ((flat.dependence().unwrap() - 1.0) / flat.dependence_std()).powi(2);
            }
            let rms = (square / f64::from(n)).sqrt();
            println!("{frames} frames: rms {rms:.3}");
            assert!((0.8..1.0 + 4.0 / (2.0 * f64::from(n)).sqrt()).contains(&rms), "{frames} frames: {rms}");
        }
        let lacks = |share: f64| {
            let all = (0..100).map(|seed| sets(12, 2000, share, 1000 + seed));
            all.filter(|[flat, dark]| flat.lacks_lag(0.05, dark)).count()
        };
        let (with, without) = (lacks(0.05), lacks(0.0));
        println!("contradicted: {with} with lag, {without} without");
        assert!(with <= 1 && without >= 50, "{with} with lag, {without} without");
    }
}
