//! Noise that neighbours or successive frames share in all flats: variance that is measured pixel by pixel,
//! or about the mean of the frames, lacks it, and the gain comes out too low.

use super::Campaign;
use super::campaign::median_line;
use crate::number::percent;
use crate::statistics::median::median;

/// Share of the noise from which on it is said: by as much the gain is too low (a named choice, above the
/// capacitance between the pixels of many CMOS sensors).
const LEAST: f64 = 0.05;
/// Least significance, standard deviations.
const SIGMAS: f64 = 6.0;
/// Variance of a flat over that of the quietest set from which on light makes most of it (a named choice).
const LIT: f64 = 2.0;
/// Most sets that are looked at: every pair of them is compared.
const MOST_SETS: usize = 64;
/// Pixels at most that tell the correlation of neighbours.
const PIXELS: f64 = 512.0 * 512.0;

/// Noise that is shared, over that which is measured.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct SharedNoise {
    /// By neighbours in a row and in a column: twice the sum of their correlations, below 0 after sharpening;
    /// 0 where that is nothing.
    pub neighbours: f64,
    /// By successive frames: the least that a filter over time makes of their variance; 0 where that is
    /// nothing.
    pub frames: f64,
}

impl SharedNoise {
    /// Of flats in which light makes most of the noise, as it is at no light: what grows with the level (the
    /// brighter-fatter effect) bends the photon transfer, and leaves the gain at its dark end.
    pub(super) fn of(campaign: &Campaign<'_>) -> Self {
        let variance = |i: usize| campaign.sets[i].variance_dn2().map(|v| v.0);
        let quiet =
            campaign.places(|s| !s.clipped).into_iter().filter_map(variance).fold(f64::INFINITY, f64::min);
        let mut flats = campaign.places(|s| s.is_lit() && !s.clipped);
        flats.retain(|&i| variance(i).is_some_and(|v| v > LIT * quiet) || !quiet.is_finite());
        let every = flats.len().div_ceil(MOST_SETS).max(1);
        let flats: Vec<usize> = flats.into_iter().step_by(every).collect();
        let Some(pixels) = flats.iter().map(|&i| campaign.sets[i].facts.pixels).reduce(f64::min) else {
            return Self::default();
        };
        let zero = campaign.zero();
        let signal = |i: usize| {
            let set = &campaign.sets[i];
            set.level_dn() - zero.as_ref().map_or(0.0, |z| z.at(set.exposure_s))
        };
        let sure = |share: f64, std: f64| if share.abs() > LEAST.max(SIGMAS * std) { share } else { 0.0 };
        let of_neighbours = |&i: &usize| {
            let (sum, var) = (campaign.sets[i].facts.neighbours.iter().sum::<f64>(), variance(i)?);
            // The noise of reading is shared by none.
            (sum != 0.0).then(|| (signal(i), 2.0 * sum * var / (var - quiet).max(0.5 * var)))
        };
        let shared: Vec<(f64, f64)> = flats.iter().filter_map(of_neighbours).collect();
        // Four correlations, less what two means of four have (`facts::tests`); a median has 1.25 times the error
        // of a mean, and an intercept about twice as much.
        let std = 2.0 * 6f64.sqrt() * 1.25 / (pixels.min(PIXELS) * shared.len().max(1) as f64).sqrt();
        let middle = median(shared.iter().map(|p| p.1));
        let at_dark = median_line(&shared).map_or(0.0, |line| line.0);
        let grows = (middle - at_dark).abs() > 2.0 * 2.0 * std;
        let neighbours = if grows { sure(at_dark, 2.0 * std) } else { sure(middle, std) };
        let neighbours = if neighbours.is_finite() { neighbours } else { 0.0 };
        let of_frames = |&i: &usize| {
            let set = &campaign.sets[i];
            let dependence = set.dependence().filter(|d| *d > 0.0 && !set.wanders())?;
            Some((1.0 / dependence - 1.0, set.frames().saturating_sub(2).max(1) as f64))
        };
        let alike: Vec<(f64, f64)> = flats.iter().filter_map(of_frames).collect();
        let triples: f64 = alike.iter().map(|a| a.1).sum();
        // The error of a ratio of variances (as in `dependent_frames`), and of a median.
        let std = 1.25 * (4.0 / (pixels * triples.max(1.0))).sqrt();
        let frames = sure(median(alike.iter().map(|a| a.0)), std).max(0.0);
        Self { neighbours, frames }
    }

    /// What is shared, over the noise that is measured: below 0 where neighbours differ by more than chance
    /// makes them.
    pub(crate) fn share(self) -> f64 {
        if self.neighbours.abs() > self.frames { self.neighbours } else { self.frames }
    }

    /// A gain without what is shared, in words; `None` where nothing is.
    pub(crate) fn in_words(self, gain: f64) -> Option<String> {
        let share = self.share();
        let (what, about) = match self {
            _ if share == 0.0 => return None,
            Self { frames, .. } if share == frames => (
                "successive frames share noise in all flats (the camera averages over time: switch its noise reduction off): variance lacks it",
                "at least",
            ),
            _ if share < 0.0 => (
                "neighbouring pixels differ by more than chance makes them in all flats (the images were sharpened): variance has too much of it",
                "about",
            ),
            _ => (
                "neighbouring pixels share noise in all flats (the images were resampled, demosaiced, smoothed or compressed, or the sensor has \
                 crosstalk): variance lacks it",
                "about",
            ),
        };
        Some(format!(
            "{what}, and the system gain is {about} {} {}: {about} {:.4} DN/e⁻. `radcam diagnose` fits what does it",
            percent(share.abs()),
            if share > 0.0 { "higher" } else { "lower" },
            gain * (1.0 + share)
        ))
    }
}
