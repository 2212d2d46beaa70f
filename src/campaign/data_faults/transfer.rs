//! Photon-transfer curve of a campaign (Healey and Kondepudy 1994, eq. 35: sigma_N^2 = A^2 (I + E_DC) +
//! sigma_C^2, a line over the level), with a bend.

use super::campaign::{Campaign, Zero};
use super::law::{Law, Point};
use crate::dataset::Kind;

/// Relative error of a variance beyond that of independent pixels: hot pixels, shading and shared noise
/// (a named choice).
pub const MODEL_ERROR: f64 = 0.02;
/// Minimum number of sets for a curve.
const MIN_SETS: usize = 4;
/// Maximum variance at which rounding dominates, DN^2.
pub const MIN_VARIANCE_DN2: f64 = 0.35;
/// Minimum ratio of the expected variance to that limit for a set to count as quiet.
const MIN_QUIET_RATIO: f64 = 2.0;
/// Maximum relative bend of the curve at the highest level.
pub const MAX_BEND: f64 = 0.15;

/// Photon-transfer curve: variance over the level.
pub struct Transfer {
    law: Law,
    most: f64,
    model_error: f64,
    /// Sets removed from the fit as strays.
    pub strays: Vec<usize>,
    /// Sets with so little noise that rounding dominates it, at levels that have much.
    pub quiet: Vec<usize>,
}

impl Transfer {
    /// Fits the curve to all sets except some.
    pub fn of(campaign: &Campaign<'_>, zero: &Zero, without: &[usize]) -> Option<Self> {
        Self::with_model_error(campaign, zero, without, MODEL_ERROR)
    }

    /// Fits the curve as [`Self::of`] does, with the errors of independent pixels alone, and the scatter
    /// of the sets if that is larger: predictions beyond the range are tighter.
    pub fn by_pixels(campaign: &Campaign<'_>, zero: &Zero, without: &[usize]) -> Option<Self> {
        Self::with_model_error(campaign, zero, without, 0.0)
    }

    fn with_model_error(
        campaign: &Campaign<'_>,
        zero: &Zero,
        without: &[usize],
        model_error: f64,
    ) -> Option<Self> {
        let usable = |i: &usize| {
            let s = &campaign.sets[*i];
            !without.contains(i)
                && !s.clipped
                && !s.is_cut_off()
                && s.is_of_one_level(zero)
                && s.variance_dn2().is_some_and(|v| v.0 > MIN_VARIANCE_DN2)
        };
        let sets: Vec<usize> = campaign
            .places(|s| matches!(s.kind, Kind::Dark | Kind::Flat))
            .into_iter()
            .filter(usable)
            .collect();
        let points: Vec<(f64, f64, f64)> = sets
            .iter()
            .filter_map(|&i| {
                let (var, pairs) = campaign.sets[i].variance_dn2()?;
                Some((above(campaign, zero, i), var, pixel_error(campaign, i, pairs).hypot(model_error)))
            })
            .collect();
        let most = points.iter().map(|p| p.0).fold(1.0, f64::max);
        tracing::debug!("photon transfer of {} sets: {points:.3?}", sets.len());
        if points.len() < MIN_SETS {
            return None;
        }
        // Relative weights need the curve itself: start with the median line.
        let slope =
            crate::statistics::median::median(points.iter().filter(|p| p.0 > 0.1 * most).map(|p| p.1 / p.0));
        let dark = points.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
        let mut expected: Vec<f64> =
            points.iter().map(|p| (dark + slope.max(0.0) * p.0.max(0.0)).max(MIN_VARIANCE_DN2)).collect();
        let mut law = None;
        for _ in 0..4 {
            let priors = [1e6, 1e6, MAX_BEND * (slope * most).abs().max(1.0)];
            let rows: Vec<Point> = points
                .iter()
                .zip(&expected)
                .map(|(p, e)| Point {
                    factors: factors(p.0 / most).iter().map(|f| f / e).collect(),
                    value: p.1 / e,
                    std: p.2,
                })
                .collect();
            let fit = Law::fit(&rows, &priors, (points.len() / 3).clamp(1, 5))?;
            for (p, e) in points.iter().zip(&mut expected) {
                *e = fit.at(&factors(p.0 / most)).max(MIN_VARIANCE_DN2);
            }
            law = Some(fit);
        }
        let law = law?;
        let strays = law.out.iter().map(|k| sets[*k]).collect();
        let is_quiet = |i: &usize| {
            let s = &campaign.sets[*i];
            let expected = law.at(&factors(above(campaign, zero, *i) / most));
            !without.contains(i)
                && !s.clipped
                && s.is_of_one_level(zero)
                && s.variance_dn2().is_some_and(|v| {
                    v.0 > 0.0 && v.0 <= MIN_VARIANCE_DN2 && expected > MIN_QUIET_RATIO * MIN_VARIANCE_DN2
                })
        };
        let quiet = campaign.places(|s| s.is_lit()).into_iter().filter(is_quiet).collect();
        Some(Self { law, most, model_error, strays, quiet })
    }

    /// Returns the bend: the curve's deviation from its line at the highest level, relative to that line.
    pub fn bend(&self) -> f64 {
        self.law.at(&[0.0, 0.0, 1.0]) / self.law.at(&[0.0, 1.0, 0.0])
    }

    /// Returns the slope at the lowest levels: the system gain, DN/e.
    pub fn slope(&self) -> f64 {
        self.slope_with_error().0
    }

    /// Returns the slope at the lowest levels and its standard error, DN/e.
    pub fn slope_with_error(&self) -> (f64, f64) {
        let [low, high] = [factors(0.0), factors(0.1)];
        let own: Vec<f64> =
            low.iter().zip(&high).map(|(low, high)| (high - low) / (0.1 * self.most)).collect();
        let value = self.law.at(&own);
        (value, self.law.std(&Point { factors: own, value, std: 0.0 }))
    }

    /// Returns the variance expected at a level above the darks, DN^2, and its standard error: also
    /// below the lowest level.
    pub fn expected_dn2(&self, above_dn: f64) -> (f64, f64) {
        let own = factors(above_dn / self.most).to_vec();
        let value = self.law.at(&own);
        (value, self.law.std(&Point { factors: own, value, std: 0.0 }))
    }

    /// Returns the logarithm of the ratio of a set's variance to that expected at a level, and its
    /// standard error.
    pub fn off(&self, campaign: &Campaign<'_>, set: usize, above_dn: f64) -> Option<(f64, f64)> {
        let (off, point, _) = self.ratio(campaign, set, above_dn)?;
        Some((off, self.law.std(&point)))
    }

    /// Returns the logarithm of that ratio with its error from the scatter of the other sets about the
    /// curve alone.
    pub fn off_by_scatter(&self, campaign: &Campaign<'_>, set: usize, above_dn: f64) -> Option<(f64, f64)> {
        let (off, point, of_pixels) = self.ratio(campaign, set, above_dn)?;
        Some((off, self.law.own_std(&point).max(of_pixels)))
    }

    fn ratio(&self, campaign: &Campaign<'_>, set: usize, above_dn: f64) -> Option<(f64, Point, f64)> {
        let (var, pairs) = campaign.sets[set].variance_dn2()?;
        let expected = self.law.at(&factors(above_dn / self.most)).max(MIN_VARIANCE_DN2);
        let own = factors(above_dn / self.most).iter().map(|f| f / expected).collect();
        let std = pixel_error(campaign, set, pairs).hypot(self.model_error);
        let point = Point { factors: own, value: 1.0, std };
        Some(((var / expected).ln(), point, pixel_error(campaign, set, pairs)))
    }
}

/// Returns the factors of the curve at a level relative to the highest: a line with a bend.
pub fn factors(level: f64) -> [f64; 3] {
    [1.0, level, level * level]
}

/// Returns the level of a set above the darks, DN.
pub fn above(campaign: &Campaign<'_>, zero: &Zero, set: usize) -> f64 {
    // The charge of darks also has shot noise, so the level at zero exposure is used.
    campaign.sets[set].level_dn() - zero.dn
}

/// Returns the relative error of a variance from this number of pairs: successive pairs share frames.
pub fn variance_error(campaign: &Campaign<'_>, set: usize, pairs: f64) -> f64 {
    pixel_error(campaign, set, pairs).hypot(MODEL_ERROR)
}

/// Returns the relative error of a variance from independent pixels alone.
pub fn pixel_error(campaign: &Campaign<'_>, set: usize, pairs: f64) -> f64 {
    (3.0 / (campaign.sets[set].facts.pixels.max(1.0) * pairs)).sqrt()
}
