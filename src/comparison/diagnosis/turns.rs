//! Tests of independence for the scatter from frame to frame: a blinking light, a beating or wandering level,
//! and settling first frames are not independent.

use super::Part;
use crate::dataset::Kind;
use crate::inference::{Fitted, residuals_of};
use crate::observables::{Observations, Statistic, mean};
use radcam_sim::rng::{PixelRng, Stream};
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;

/// Frequencies of the sines that are fitted, cycles per 32 frames.
const FREQUENCIES: std::ops::RangeInclusive<u32> = 1..=16;
/// Minimum frames of a set: of five frames a sine explains nearly everything.
const FEWEST: usize = 6;
/// Monte Carlo draws of independent frames; the mean share is known to 1.6 % of the deviation.
const DRAWS: u32 = 4000;
/// Maximum standardised deviation of independent frames. Four planned tests reject independent frames once in
/// two hundred campaigns.
const SWINGS: f64 = 3.0;

/// Computes the share of the variance that the best-fitting sine explains (Lomb 1976; Scargle 1982), and its
/// frequency in cycles per frame.
fn swing(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let off: Vec<f64> = values.iter().map(|v| v - mean).collect();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let all = dot(&off, &off);
    let share = |frequency: f64| {
        let centred = |of: fn(f64) -> f64| {
            let wave: Vec<f64> = (0..values.len()).map(|i| of(TAU * frequency * i as f64)).collect();
            let mean = wave.iter().sum::<f64>() / n;
            wave.into_iter().map(|w| w - mean).collect::<Vec<f64>>()
        };
        let (u, mut v) = (centred(f64::cos), centred(f64::sin));
        let square = dot(&u, &u);
        let along = dot(&u, &v) / square;
        v.iter_mut().zip(&u).for_each(|(v, u)| *v -= along * u);
        let rest = dot(&v, &v);
        let of_rest = if rest > 1e-6 * n { dot(&v, &off).powi(2) / rest } else { 0.0 };
        (dot(&u, &off).powi(2) / square + of_rest) / all
    };
    let shares = FREQUENCIES.map(|k| f64::from(k) / 32.0).map(|f| (share(f), f));
    shares.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|s| s.0.is_finite()).unwrap_or((0.0, 0.0))
}

/// Estimates the mean and standard deviation of the share that [`swing`] finds in n independent normal
/// numbers, by Monte Carlo.
fn of_independent(n: usize) -> (f64, f64) {
    let (mut sum, mut squares) = (0.0, 0.0);
    for draw in 0..DRAWS {
        let mut random = PixelRng::new(0, Stream::Effect, 0, draw, n as u32);
        let values: Vec<f64> = (0..n).map(|_| random.normal()).collect();
        let (share, _) = swing(&values);
        (sum, squares) = (sum + share, squares + share * share);
    }
    let mean = sum / f64::from(DRAWS);
    (mean, (squares / f64::from(DRAWS) - mean * mean).sqrt())
}

/// Computes the standardised excess of the share explained by a sine, over all sets, and the median
/// frequency. Each set is (frame means, weight): the weight is the part of its variance that the effect
/// claims.
fn together(sets: &[(&[f64], f64)]) -> Option<(f64, f64)> {
    let mut known = BTreeMap::new();
    let (mut sum, mut variance, mut frequencies) = (0.0, 0.0, Vec::new());
    for (means, weight) in sets.iter().filter(|s| s.0.len() >= FEWEST && s.1 > 0.0) {
        let (mean, deviation) = *known.entry(means.len()).or_insert_with(|| of_independent(means.len()));
        let (share, frequency) = swing(means);
        sum += weight * (share - mean);
        variance += (weight * deviation).powi(2);
        frequencies.push(frequency);
    }
    frequencies.sort_by(f64::total_cmp);
    let middle = *frequencies.get(frequencies.len() / 2)?;
    Some((sum / variance.sqrt(), middle))
}

/// Frames of a set.
struct Run<'s> {
    means: &'s [f64],
    /// Part of the variance of the means that the effect claims.
    part: f64,
    /// Expected standard deviation.
    deviation_dn: f64,
    /// Index of the first frame in the campaign.
    first: usize,
}

/// Computes the chance of a share as large as that of the best sine through the frames of all sets, in the
/// order in which they were taken, and its period in frames. Means of sets are subtracted from the frames and
/// the sines (Lomb 1976; Scargle 1982). With n degrees of freedom, a sine of a given frequency explains the
/// share s by chance in (1 - s)^((n - 2) / 2).
fn rhythm(sets: &[Run<'_>]) -> Option<(f64, f64)> {
    let used = || sets.iter().filter(|s| s.means.len() > 1 && s.part > CLAIMED && s.deviation_dn > 0.0);
    let (mut values, mut places, mut of) = (Vec::new(), Vec::new(), Vec::new());
    for (set, Run { means, deviation_dn, first, .. }) in used().enumerate() {
        let n = means.len() as f64;
        let mean = means.iter().sum::<f64>() / n;
        for (k, m) in means.iter().enumerate() {
            values.push((m - mean) / deviation_dn);
            places.push((first + k) as f64);
            of.push(set);
        }
    }
    let (n, count) = (values.len(), used().count());
    let dof = n.checked_sub(count + 2).filter(|dof| *dof >= FEWEST)? as f64;
    let sizes: Vec<f64> = used().map(|s| s.means.len() as f64).collect();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let centred = |mut wave: Vec<f64>| {
        let mut sums = vec![0.0; count];
        wave.iter().zip(&of).for_each(|(w, set)| sums[*set] += w);
        wave.iter_mut().zip(&of).for_each(|(w, set)| *w -= sums[*set] / sizes[*set]);
        wave
    };
    let all = dot(&values, &values);
    let length = places.last()? - places[0] + 1.0;
    let share = |frequency: f64| {
        let wave = |of: fn(f64) -> f64| centred(places.iter().map(|at| of(TAU * frequency * at)).collect());
        let (u, mut v) = (wave(f64::cos), wave(f64::sin));
        let square = dot(&u, &u).max(1e-9);
        let along = dot(&u, &v) / square;
        v.iter_mut().zip(&u).for_each(|(v, u)| *v -= along * u);
        let rest = dot(&v, &v);
        let of_rest = if rest > 1e-6 * n as f64 { dot(&v, &values).powi(2) / rest } else { 0.0 };
        (dot(&u, &values).powi(2) / square + of_rest) / all
    };
    // Periods from two frames to twenty; a campaign of n frames resolves steps of 1 / n. The chance counts n
    // frequencies, twice the independent ones.
    let steps = (2.0 * length.min(MOST_STEPS)) as usize;
    let frequency = |k: usize| 0.05 + 0.45 * k as f64 / steps as f64;
    let shares = (0..=steps).map(|k| (share(frequency(k)), frequency(k)));
    let (best, at) = shares.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|s| s.0.is_finite())?;
    let one = 0.5 * dof * (1.0 - best.min(1.0 - 1e-12)).ln();
    Some(((one.exp() * 0.5 * steps as f64).min(1.0), 1.0 / at))
}

/// Minimum part of a set's scatter that an effect claims, for the frames of the set to tell of it (a named
/// choice).
const CLAIMED: f64 = 0.3;
/// Maximum number of frequencies that the chance counts.
const MOST_STEPS: f64 = 2000.0;
/// Chance below which frames have a rhythm; about as strict as [`SWINGS`].
const NO_RHYTHM: f64 = 1e-3;

/// Computes the standardised excess of the first frame's share of the variance. For n independent frames, one
/// frame's share times n / (n - 1) is beta-distributed with 1 / 2 and (n - 2) / 2 (Cochran 1934).
fn first_frames(sets: &[(&[f64], f64)]) -> f64 {
    let (mut sum, mut variance) = (0.0, 0.0);
    for (means, weight) in sets.iter().filter(|s| s.0.len() > 2 && s.1 > 0.0) {
        let n = means.len() as f64;
        let mean = means.iter().sum::<f64>() / n;
        let square: f64 = means.iter().map(|m| (m - mean).powi(2)).sum();
        if square > 0.0 {
            let share = (means[0] - mean).powi(2) / square * n / (n - 1.0);
            sum += weight * (share - 1.0 / (n - 1.0));
            variance += weight * weight * 2.0 * (n - 2.0) / ((n - 1.0).powi(2) * (n + 1.0));
        }
    }
    if variance > 0.0 { sum / variance.sqrt() } else { 0.0 }
}

/// Maximum scatter of the settings of the light in the errors of a set's mean (a named choice: the product of
/// two halves then has a mean of a tenth).
const MOST_SCATTER: f64 = 0.3;

/// Computes the standardised agreement of the mean residuals of both halves of each set: sum of the products
/// over the root of the sum of their squares, normal if signs are random (Efron 1969). Flats whose
/// settings of the light scatter by more than the means are known tell of the light and not of the effect.
fn alike(all: &Observations, whole: &Fitted) -> f64 {
    let scatter_rel = whole.base.setting_rel.unwrap_or(0.0);
    let sets = all.kinds.iter().zip(&all.set_numbers);
    let darks: BTreeSet<u32> = sets.filter(|(kind, _)| **kind == Kind::Dark).map(|(_, set)| *set).collect();
    let mut of_set: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for r in residuals_of(all, whole).iter().filter(|r| r.statistic == mean::Mean.id()) {
        let is_known = scatter_rel * r.level_dn < MOST_SCATTER * r.std_err;
        if let Some(set) = r.set.filter(|set| is_known || darks.contains(set)) {
            of_set.entry(set).or_default().push((r.measured - r.predicted) / r.std_err);
        }
    }
    let products = of_set.values().filter(|z| z.len() == 2).map(|z| z[0] * z[1]);
    let (sum, square) = products.fold((0.0, 0.0), |(sum, square), p| (sum + p, square + p * p));
    if square > 0.0 { sum / square.sqrt() } else { 0.0 }
}

/// Returns the reason to reject independent frames, for effects that scatter from frame to frame; `None` if
/// all tests hold.
pub fn in_turns(all: &Observations, part: &Part, whole: &Fitted) -> Option<String> {
    part.effect.shown_by().filter(|_| !part.effect.told_by().is_empty())?;
    let prediction = whole.predict(all);
    let common = |set: usize, means: &[f64]| {
        let mean = means.iter().sum::<f64>() / means.len().max(1) as f64;
        let square: f64 = means.iter().map(|m| (m - mean).powi(2)).sum();
        let variance = square / (means.len() as f64 - 1.0).max(1.0);
        prediction.sets.get(set).map_or(0.0, |s| (s.common / variance.max(1e-12)).min(1.0))
    };
    let sets = all.frame_means_dn.iter().enumerate();
    let sets: Vec<(&[f64], f64)> = sets.map(|(set, means)| (&means[..], common(set, means))).collect();
    let (z, frequency) = together(&sets).unwrap_or_default();
    let (first, alike) = (first_frames(&sets), alike(all, whole));
    tracing::debug!("frames: swing {z:.1} at {frequency:.3} cycles, first {first:.1}, sets {alike:.1}");
    let period = 1.0 / frequency.max(1.0 / 32.0);
    if let Some((chance, period)) =
        rhythm(&in_order(all, &sets, |set| prediction.sets.get(set).map_or(0.0, |s| s.common.sqrt())))
            .filter(|r| r.0 < NO_RHYTHM)
    {
        tracing::debug!("frames: rhythm of {period:.2} frames, chance {chance:.1e}");
        return Some(format!("its frames repeat once in {period:.1} frames through the whole campaign"));
    }
    let why = [
        (
            z,
            format!(
                "its frames swing within the sets, about once in {period:.1} frames: a beat, a blink or a wander"
            ),
        ),
        (-z, "single frames of a set lie off, and the others do not scatter".to_string()),
        (first, "the first frames of the sets lie off more than others".to_string()),
        (alike, "its level moves from set to set more than from frame to frame".to_string()),
    ];
    why.into_iter().find(|(z, _)| *z > SWINGS).map(|(_, why)| why)
}

/// Orders sets as runs of frames. `deviation_dn`: expected standard deviation of the frames of a set.
fn in_order<'s>(
    all: &Observations,
    sets: &[(&'s [f64], f64)],
    deviation_dn: impl Fn(usize) -> f64,
) -> Vec<Run<'s>> {
    let mut place = vec![None; sets.len()];
    for (at, frame) in all.campaign.frames.iter().enumerate() {
        if let Some(slot) = place.get_mut(frame.set) {
            slot.get_or_insert(at);
        }
    }
    let mut out = Vec::new();
    for (set, (&(means, part), first)) in sets.iter().zip(place).enumerate() {
        if let Some(first) = first {
            out.push(Run { means, part, deviation_dn: deviation_dn(set), first });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Over 300 campaigns of twelve sets of eight frames, independent frames have a mean of 0 and a deviation
    /// of 1, within five standard errors; a blink, a beat and single frames lie beyond the limit.
    #[test]
    fn swings_are_told_from_independent_frames() {
        let campaigns = 300;
        let of = |campaign: u32, frame: &dyn Fn(usize, usize, &mut PixelRng) -> f64| {
            let mut random = PixelRng::new(5, Stream::Effect, 0, campaign, 0);
            let sets: Vec<Vec<f64>> =
                (0..12).map(|s| (0..8).map(|f| frame(s, f, &mut random)).collect()).collect();
            together(&sets.iter().map(|s| (&s[..], 1.0)).collect::<Vec<_>>()).unwrap()
        };
        let all: Vec<f64> = (0..campaigns).map(|c| of(c, &|_, _, r| r.normal()).0).collect();
        let n = f64::from(campaigns);
        let mean = all.iter().sum::<f64>() / n;
        let deviation = (all.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / n).sqrt();
        assert!(
            mean.abs() < 5.0 / n.sqrt() && (deviation - 1.0).abs() < 5.0 / (2.0 * n).sqrt(),
            "{mean} {deviation}"
        );
        let blink = of(0, &|s, f, r| f64::from(u8::from((s + f) % 3 == 0)) + 0.1 * r.normal());
        let beat =
            of(0, &|s, f, r| (1.7 * s as f64 + (0.6 + 0.1 * s as f64) * f as f64).sin() + 0.1 * r.normal());
        assert!(blink.0 > SWINGS && beat.0 > SWINGS, "{blink:?} {beat:?}");
        assert!((blink.1 - 1.0 / 3.0).abs() < 0.03, "{blink:?}");
        let settles: Vec<Vec<f64>> = (0..12)
            .map(|s| (0..8).map(|f: i32| 0.4f64.powi(f) + 0.02 * f64::from(s * f % 7)).collect())
            .collect();
        assert!(first_frames(&settles.iter().map(|s| (&s[..], 1.0)).collect::<Vec<_>>()) > SWINGS);
        let single = of(0, &|s, f, r| if f == s % 8 { 9.0 } else { 0.1 * r.normal() });
        assert!(single.0 < -SWINGS, "{single:?}");
    }
    /// At most one of 300 campaigns of twelve sets of six independent frames has a rhythm; a sawtooth of 7.3
    /// frames under noise of a third of its deviation has it.
    #[test]
    fn a_rhythm_through_the_campaign_is_told_from_independent_frames() {
        let of = |campaign: u32, frame: &dyn Fn(usize, &mut PixelRng) -> f64| {
            let mut random = PixelRng::new(6, Stream::Effect, 0, campaign, 0);
            let sets: Vec<Vec<f64>> =
                (0..12).map(|s| (0..6).map(|f| frame(6 * s + f, &mut random)).collect()).collect();
            let mut runs = Vec::new();
            for (s, means) in sets.iter().enumerate() {
                runs.push(Run { means, part: 1.0, deviation_dn: 1.0, first: 6 * s });
            }
            rhythm(&runs).unwrap()
        };
        let found = (0..300).filter(|c| of(*c, &|_, r| r.normal()).0 < NO_RHYTHM).count();
        assert!(found <= 1, "{found}");
        let saw = of(0, &|k, r| (k as f64 / 7.3).fract() + 0.1 * r.normal());
        assert!(saw.0 < NO_RHYTHM && (saw.1 - 7.3).abs() < 0.3, "{saw:?}");
    }
}
