//! A first guess of the paper's parameters, from the darks and the slope of the variance.

use super::free::FIRST_SETTING;
use crate::dataset::{Kind, LONG_DARKS};
use crate::observables::{Half, Observations, Setting, Statistic, mean, monitor, unequal, variance};
use crate::statistics::median::median;
use radcam_sim::predict::{BaseParameters, Monitor};

/// Minimum signal of a flat for the estimates of light and gain, as a share of the brightest signal: a dimmer
/// one contains too much of black level and dark variance.
const DIM: f64 = 0.02;

/// Largest relative variance of the pixels' read-noise variances: one pixel in a hundred with ten times the
/// noise of the others has 25.
pub(super) const MOST_SPREAD: f64 = 1e3;

/// Makes a first guess of the paper's parameters.
pub fn start(all: &Observations) -> BaseParameters {
    let (offset_dn, dark_dn_per_s) = if all.is_table { (0.0, 0.0) } else { zero_and_dark(all) };
    let signal_dn = signals(all, offset_dn);
    let mut points: Vec<(f64, f64)> =
        values(all, &variance::Variance, Some(Kind::Flat)).map(|(s, v)| (signal_dn[s], v)).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let dark = values(all, &variance::Variance, Some(Kind::Dark)).map(|v| v.1).reduce(f64::min);
    let dark_var_dn2 = dark.unwrap_or_else(|| intercept(&points));
    let top_dn = points.last().map_or(0.0, |p| p.0);
    let gain_dn_per_e = if points.is_empty() {
        of_darks(all, offset_dn).unwrap_or(1.0)
    } else {
        gain(&points, dark_var_dn2, top_dn)
    };
    let mut flux_e_per_s = flux(all, &signal_dn, gain_dn_per_e, top_dn);
    raise_clipped(all, &signal_dn, top_dn, &mut flux_e_per_s);
    let monitor = monitor_of(all, &flux_e_per_s);
    BaseParameters {
        gain_dn_per_e,
        read_noise_e: (dark_var_dn2 - 1.0 / 12.0).max(0.01).sqrt() / gain_dn_per_e,
        read_noise_spread: read_noise_spread(all, dark_var_dn2),
        offset_dn,
        dark_e_per_s: dark_dn_per_s / gain_dn_per_e,
        flux_e_per_s,
        past_e: None,
        setting_rel: all.setting.map(|s| match s {
            Setting::Stated(rel) => rel,
            Setting::Below(most) => FIRST_SETTING * most,
        }),
        monitor,
        cut_at_0: true,
    }
}

/// Estimates the relative spread of the pixels' read-noise variances from the darks.
fn read_noise_spread(all: &Observations, dark_var_dn2: f64) -> f64 {
    let shown = median(values(all, &unequal::Unequal, Some(Kind::Dark)).map(|v| v.1));
    let own = dark_var_dn2 / (dark_var_dn2 - 1.0 / 12.0).max(0.01);
    if shown.is_finite() { (shown * own * own).clamp(0.0, MOST_SPREAD) } else { 0.0 }
}

/// Returns the values of a statistic of sets, each with its set.
fn values<'a>(
    all: &'a Observations,
    statistic: &'static dyn Statistic,
    wanted: Option<Kind>,
) -> impl Iterator<Item = (usize, f64)> + 'a {
    all.of(statistic).filter_map(move |o| {
        let set = o.set?;
        (wanted.is_none_or(|k| all.kinds[set] == k)).then_some((set, o.measured.value))
    })
}

/// Computes the mean of every set above the zero, DN; NaN for a set without a mean.
fn signals(all: &Observations, offset_dn: f64) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); all.campaign.sets.len()];
    values(all, &mean::Mean, None).for_each(|(set, v)| sums[set] = (sums[set].0 + v, sums[set].1 + 1.0));
    sums.into_iter().map(|(sum, n)| sum / n - offset_dn).collect()
}

/// Minimum dark charge for a gain estimate, as a multiple of a pixel's noise: the shot noise of the charge is
/// then in the variance.
const BRIGHT_DARKS: f64 = 0.2;

/// Estimates A from the shot noise of the dark charge, in a campaign without light; `None` if there is too
/// little charge to tell the gain.
pub fn of_darks(all: &Observations, offset_dn: f64) -> Option<f64> {
    let variances: Vec<(usize, f64)> = values(all, &variance::Variance, Some(Kind::Dark)).collect();
    let signal = signals(all, offset_dn);
    let brightest = variances.iter().max_by(|a, b| signal[a.0].total_cmp(&signal[b.0]))?;
    let least = variances.iter().map(|v| v.1).fold(f64::INFINITY, f64::min);
    let more = brightest.1 - least;
    let level = signal[brightest.0];
    (level > BRIGHT_DARKS * least.max(0.0).sqrt()).then(|| more.max(0.02 * least) / level)
}

/// Returns true for a campaign with flats.
pub fn has_flats(all: &Observations) -> bool {
    values(all, &variance::Variance, Some(Kind::Flat)).next().is_some() || all.is_table
}

/// Estimates A from the slope of the variance over the signal.
fn gain(points: &[(f64, f64)], dark_var_dn2: f64, top_dn: f64) -> f64 {
    let slope = |p: &(f64, f64)| (p.0, (p.1 - dark_var_dn2) / p.0.max(1e-6));
    let slopes: Vec<_> = points.iter().map(slope).collect();
    let middle = points.get(points.len() / 2).copied().unwrap_or((1.0, 1.0));
    before_the_end(&slopes, top_dn).unwrap_or(slope(&middle).1).max(1e-6)
}

/// Estimates the light of every level, e/s.
fn flux(all: &Observations, signal_dn: &[f64], gain_dn_per_e: f64, top_dn: f64) -> Vec<f64> {
    let levels = all.campaign.sets.iter().filter_map(|s| s.light).max().map_or(0, |l| l + 1);
    let mut rates: Vec<Vec<(f64, f64)>> = vec![Vec::new(); levels];
    for (set, signal) in all.campaign.sets.iter().zip(signal_dn) {
        let rate = signal / set.exposure_s / gain_dn_per_e / set.light_ratio;
        if let Some(level) = set.light.filter(|_| rate.is_finite()) {
            rates[level].push((*signal, rate));
        }
    }
    let of_level = |rates: &Vec<(f64, f64)>| {
        let usual = before_the_end(rates, top_dn).unwrap_or_else(|| median(rates.iter().map(|r| r.1)));
        if usual.is_infinite() { 1.0 } else { usual.max(1e-6) }
    };
    rates.iter().map(of_level).collect()
}

/// Raises light levels below their nominal value to it: the range may have ended there, and the fit would not
/// raise them later.
fn raise_clipped(all: &Observations, signal_dn: &[f64], top_dn: f64, flux_e_per_s: &mut [f64]) {
    if all.is_table || flux_e_per_s.len() < 2 {
        return;
    }
    let sets = all.campaign.sets.iter().enumerate().filter(|(s, _)| all.kinds[*s] == Kind::Flat);
    let flats: Vec<(usize, usize, f64)> = sets
        .filter_map(|(s, set)| Some((s, set.light?, set.illumination)))
        .filter(|(_, _, light)| *light > 0.0)
        .collect();
    let bright = flats.iter().filter(|(s, ..)| signal_dn[*s] > DIM * top_dn);
    let per_light: Vec<f64> = bright.map(|(_, l, light)| flux_e_per_s[*l] / light).collect();
    if per_light.len() < 3 {
        return;
    }
    let Some(per_light) = of_the_largest(per_light.into_iter()) else { return };
    for (_, l, light) in flats {
        if flux_e_per_s[l] < 0.97 * per_light * light {
            flux_e_per_s[l] = per_light * light;
        }
    }
}

/// Estimates the parameters of the light monitor; `None` without readings.
fn monitor_of(all: &Observations, flux_e_per_s: &[f64]) -> Option<Monitor> {
    let reading = |(set, v): (usize, f64)| {
        let set = &all.campaign.sets[set];
        Some(v - (flux_e_per_s[set.light?] * set.exposure_s).ln())
    };
    let readings: Vec<f64> = values(all, &monitor::Monitor, None).filter_map(reading).collect();
    if readings.is_empty() {
        return None;
    }
    let middle = median(readings.iter().copied());
    // The median absolute deviation of normal numbers is 0.6745 standard deviations.
    let scatter = median(readings.iter().map(|r| (r - middle).abs())) / 0.6745;
    Some(Monitor { ln_per_e: middle, rel: scatter.max(1e-5) })
}

/// Estimates the black level at zero exposure, DN, and the dark signal, DN/s, from the shortest and the
/// longest darks.
fn zero_and_dark(all: &Observations) -> (f64, f64) {
    let darks: Vec<(f64, f64)> = values(all, &mean::Mean, Some(Kind::Dark))
        .map(|(s, m)| (all.campaign.sets[s].exposure_s, m))
        .collect();
    let shortest = darks.iter().copied().min_by(|a, b| a.0.total_cmp(&b.0));
    let longest = darks.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0));
    match (shortest, longest) {
        (Some(a), Some(b)) if b.0 > a.0 => (a.1, ((b.1 - a.1) / (b.0 - a.0)).max(0.0)),
        (Some(a), _) if are_long(all, a.0) || is_far_above_the_flats(all, a.1) => {
            let zero_dn = zero_of_flats(all).map_or(a.1, |zero_dn| zero_dn.clamp(0.0, a.1));
            (zero_dn, (a.1 - zero_dn) / a.0)
        }
        (a, _) => (a.map_or(0.0, |d| d.1), 0.0),
    }
}

/// Returns true for darks of one exposure that is far longer than those of the flats: their level is offset
/// plus dark charge, and only the flats separate the two.
fn are_long(all: &Observations, exposure_s: f64) -> bool {
    let of_flats = |(set, _): (usize, f64)| all.campaign.sets[set].exposure_s;
    let longest = values(all, &mean::Mean, Some(Kind::Flat)).map(of_flats).fold(0.0, f64::max);
    longest > 0.0 && exposure_s > LONG_DARKS * longest
}

/// Returns the noise of the darks: the largest of their standard deviations, DN.
fn dark_noise_dn(all: &Observations) -> f64 {
    values(all, &variance::Variance, Some(Kind::Dark)).map(|v| v.1).fold(0.0, f64::max).sqrt()
}

/// Returns true for darks that lie above the level of the flats at zero exposure by more than
/// [`AROUND_DARKS`]: charge that was collected without light.
fn is_far_above_the_flats(all: &Observations, dark_dn: f64) -> bool {
    zero_of_flats(all).is_some_and(|zero_dn| dark_dn - zero_dn > AROUND_DARKS * dark_noise_dn(all).max(1.0))
}

/// Estimates the level of the flats at zero exposure, DN: that of the line through the shortest and the
/// median exposure, at the light with most exposures.
fn zero_of_flats(all: &Observations) -> Option<f64> {
    let mut of_lights: std::collections::BTreeMap<Option<usize>, Vec<(f64, f64)>> = Default::default();
    for (set, dn) in values(all, &mean::Mean, Some(Kind::Flat)) {
        let set = &all.campaign.sets[set];
        of_lights.entry(set.light).or_default().push((set.exposure_s, dn));
    }
    let mut flats = of_lights.into_values().max_by_key(Vec::len)?;
    flats.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (a, b) = (flats[0], flats[flats.len() / 2]);
    (b.0 > a.0).then(|| a.1 - a.0 * (b.1 - a.1) / (b.0 - a.0))
}

/// Maximum distance of the black level at zero exposure from the darks, in multiples of the noise of a dark
/// sample (a named choice: where darks are cut off at code 0, it lies below what is left of them).
const AROUND_DARKS: f64 = 8.0;

/// Returns the bounds of the black level at zero exposure, DN, from the darks; infinite without darks.
/// Unbounded, a line tilted by saturated sets would take it to where all darks are cut off.
pub(super) fn zero_bounds(all: &Observations) -> (f64, f64) {
    let darks: Vec<(f64, f64)> = values(all, &mean::Mean, Some(Kind::Dark))
        .map(|(s, m)| (all.campaign.sets[s].exposure_s, m))
        .collect();
    let noise_dn = dark_noise_dn(all);
    let of = |pick: fn(f64, f64) -> f64, from: f64| darks.iter().map(|d| d.1).fold(from, pick);
    let (lowest, highest) = (of(f64::min, f64::INFINITY), of(f64::max, f64::NEG_INFINITY));
    if !lowest.is_finite() || !highest.is_finite() {
        return (f64::NEG_INFINITY, f64::INFINITY);
    }
    let shortest = darks.iter().map(|d| d.0).fold(f64::INFINITY, f64::min);
    let longest = darks.iter().map(|d| d.0).fold(0.0, f64::max);
    let times = if longest > shortest { longest / (longest - shortest) } else { 1.0 };
    let around = times * (highest - lowest) + AROUND_DARKS * noise_dn.max(1.0);
    // All of the level may be dark charge.
    let is_charge = times == 1.0 && (are_long(all, longest) || is_far_above_the_flats(all, lowest));
    let charge = if is_charge { lowest.max(0.0) } else { 0.0 };
    (lowest - around - charge, highest + around)
}

/// Estimates the variance without light, DN^2, from the dimmest points (signal, variance) when there is no
/// dark.
fn intercept(points: &[(f64, f64)]) -> f64 {
    let Some(first) = points.first() else { return 1.0 };
    let line = points.iter().take(points.len().clamp(2, 24));
    let n = line.clone().count() as f64;
    let (sx, sy) = line.clone().fold((0.0, 0.0), |(a, b), p| (a + p.0, b + p.1));
    let (mx, my) = (sx / n, sy / n);
    let (xx, xy) = line.fold((0.0, 0.0), |(a, b), p| (a + (p.0 - mx).powi(2), b + (p.0 - mx) * (p.1 - my)));
    let at_zero = if xx > 0.0 { my - xy / xx * mx } else { 0.2 * first.1 };
    at_zero.clamp(0.01 * first.1, 0.99 * first.1)
}

/// Estimates the typical value of points (level, value) below the end of the range, where values fall: the
/// median over the lower half of the levels up to `top` if three or more lie there, else that of the largest
/// values. `None` if no level stands out.
fn before_the_end(all: &[(f64, f64)], top: f64) -> Option<f64> {
    let clear = || all.iter().filter(|p| p.0 > DIM * top);
    let low = || clear().filter(|p| p.0 <= 0.55 * top).map(|p| p.1);
    if low().count() >= 3 { Some(median(low())) } else { of_the_largest(clear().map(|p| p.1)) }
}

/// Returns the median of the values that are not far below the largest; `None` without any.
fn of_the_largest(values: impl Iterator<Item = f64>) -> Option<f64> {
    let all: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let largest = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (!all.is_empty()).then(|| median(all.into_iter().filter(|v| *v >= 0.7 * largest)))
}

/// Returns the light level to which the others are relative.
pub fn reference_level(all: &Observations) -> usize {
    // Levels that are known to both halves beforehand are those of scenes and clipped sets.
    let mut measured = vec![false; all.campaign.sets.len()];
    let taken = all.of(&mean::Mean).filter(|o| o.half != Half::Both || all.means_given);
    taken.filter_map(|o| o.set).for_each(|s| measured[s] = true);
    let sets = all.campaign.sets.iter().zip(all.kinds.iter().zip(measured));
    let sets = sets.filter(|(_, (kind, measured))| **kind == Kind::Flat && *measured);
    let near =
        sets.min_by(|(a, _), (b, _)| (a.illumination - 1.0).abs().total_cmp(&(b.illumination - 1.0).abs()));
    near.and_then(|(s, _)| s.light).unwrap_or(0)
}
