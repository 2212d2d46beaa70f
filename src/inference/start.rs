//! A first guess of the paper's parameters, from the darks and the slope of the variance.

use crate::dataset::Kind;
use crate::observables::{Half, Observations, Statistic, mean, monitor, variance};
use crate::statistics::median::median;
use radcam_sim::predict::{BaseParameters, Monitor};

/// A first guess of the paper's parameters.
pub fn start(all: &Observations) -> BaseParameters {
    let of = |kind: &'static dyn Statistic, wanted: Option<Kind>| {
        all.of(kind).filter_map(move |o| {
            let set = o.set?;
            (wanted.is_none_or(|k| all.kinds[set] == k)).then_some((set, o.measured.value))
        })
    };
    let mut sums = vec![(0.0, 0.0); all.campaign.sets.len()];
    of(&mean::This, None).for_each(|(set, v)| sums[set] = (sums[set].0 + v, sums[set].1 + 1.0));
    let level = |set: usize| sums[set].0 / sums[set].1;
    let (offset_dn, dark_dn_per_s) = if all.is_table { (0.0, 0.0) } else { zero_and_dark(all, &of) };
    let constant = of(&variance::This, Some(Kind::Dark)).map(|v| v.1).fold(f64::INFINITY, f64::min);
    let mut points: Vec<(f64, f64)> =
        of(&variance::This, Some(Kind::Flat)).map(|(s, v)| (level(s) - offset_dn, v)).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let constant = if constant.is_finite() { constant } else { intercept(&points) };
    let top = points.last().map_or(0.0, |p| p.0);
    let middle = points.get(points.len() / 2).copied().unwrap_or((1.0, 1.0));
    let slope = |p: &(f64, f64)| (p.0, (p.1 - constant) / p.0.max(1e-6));
    let slopes: Vec<_> = points.iter().map(slope).collect();
    let gain = before_the_end(&slopes, top).unwrap_or(slope(&middle).1).max(1e-6);
    let lights = all.campaign.sets.iter().filter_map(|s| s.light).max().map_or(0, |l| l + 1);
    let mut rates: Vec<Vec<(f64, f64)>> = vec![Vec::new(); lights];
    for (s, set) in all.campaign.sets.iter().enumerate() {
        let Some(l) = set.light else { continue };
        let above = level(s) - offset_dn;
        let rate = above / set.exposure_s / gain / set.light_ratio;
        if rate.is_finite() {
            rates[l].push((above, rate));
        }
    }
    let flux_of = |rates: &Vec<(f64, f64)>| {
        let v = before_the_end(rates, top).unwrap_or_else(|| median(rates.iter().map(|r| r.1))).max(1e-6);
        if v.is_finite() { v } else { 1.0 }
    };
    let mut flux: Vec<f64> = rates.iter().map(flux_of).collect();
    // Where a level has less than its nominal light says, the range may have ended: nothing would draw it up again.
    let flats = || {
        let sets = all.campaign.sets.iter().enumerate().filter(|(s, _)| all.kinds[*s] == Kind::Flat);
        sets.filter_map(|(s, set)| Some((s, set.light?, set.illumination)))
            .filter(|(_, _, light)| *light > 0.0)
    };
    let bright = || flats().filter(|(s, ..)| level(*s) - offset_dn > 0.02 * top);
    let per_light = of_the_largest(bright().map(|(_, l, light)| flux[l] / light));
    if let Some(per_light) = per_light.filter(|_| bright().count() >= 3 && !all.is_table && lights > 1) {
        for (_, l, light) in flats() {
            if flux[l] < 0.97 * per_light * light {
                flux[l] = per_light * light;
            }
        }
    }
    let readings: Vec<f64> = all
        .of(&monitor::This)
        .filter_map(|o| {
            let set = &all.campaign.sets[o.set?];
            Some(o.measured.value - (flux[set.light?] * set.exposure_s).ln())
        })
        .collect();
    BaseParameters {
        gain_dn_per_e: gain,
        read_noise_e: (constant - 1.0 / 12.0).max(0.01).sqrt() / gain,
        offset_dn,
        dark_e_per_s: dark_dn_per_s / gain,
        flux_e_per_s: flux,
        past_e: None,
        monitor: (!readings.is_empty()).then(|| {
            let middle = median(readings.iter().copied());
            let scatter = median(readings.iter().map(|r| (r - middle).abs())) / 0.6745;
            Monitor { ln_per_e: middle, rel: scatter.max(1e-5) }
        }),
    }
}

/// Level of zero charge, DN, and dark signal, DN/s, from the shortest and the longest darks.
fn zero_and_dark<I: Iterator<Item = (usize, f64)>>(
    all: &Observations,
    of: &impl Fn(&'static dyn Statistic, Option<Kind>) -> I,
) -> (f64, f64) {
    let darks: Vec<(f64, f64)> =
        of(&mean::This, Some(Kind::Dark)).map(|(s, m)| (all.campaign.sets[s].exposure_s, m)).collect();
    let shortest = darks.iter().copied().min_by(|a, b| a.0.total_cmp(&b.0));
    let longest = darks.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0));
    match (shortest, longest) {
        (Some(a), Some(b)) if b.0 > a.0 => (a.1, ((b.1 - a.1) / (b.0 - a.0)).max(0.0)),
        (a, _) => (a.map_or(0.0, |d| d.1), 0.0),
    }
}

/// The variance at no light, DN^2, from the dimmest of points of (signal, variance) without a dark among them.
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

/// The usual one of values that fall where the range has ended, of (level, value): where three or more levels lie in the lower half of
/// all up to `top`, their median; where few do, that of the largest. `None` where no level stands out.
fn before_the_end(all: &[(f64, f64)], top: f64) -> Option<f64> {
    let clear = || all.iter().filter(|p| p.0 > 0.02 * top);
    let low = || clear().filter(|p| p.0 <= 0.55 * top).map(|p| p.1);
    if low().count() >= 3 { Some(median(low())) } else { of_the_largest(clear().map(|p| p.1)) }
}

/// Median of the values that are not far below the largest; `None` without any.
fn of_the_largest(values: impl Iterator<Item = f64>) -> Option<f64> {
    let all: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let largest = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (!all.is_empty()).then(|| median(all.into_iter().filter(|v| *v >= 0.7 * largest)))
}

/// The light level that the others are counted from.
pub fn reference_level(all: &Observations) -> usize {
    // Levels that are known to both halves beforehand are those of scenes and clipped sets.
    let mut measured = vec![false; all.campaign.sets.len()];
    let taken = all.of(&mean::This).filter(|o| o.half != Half::Both || all.means_given);
    taken.filter_map(|o| o.set).for_each(|s| measured[s] = true);
    let sets = all.campaign.sets.iter().zip(all.kinds.iter().zip(measured));
    let sets = sets.filter(|(_, (kind, measured))| **kind == Kind::Flat && *measured);
    let near =
        sets.min_by(|(a, _), (b, _)| (a.illumination - 1.0).abs().total_cmp(&(b.illumination - 1.0).abs()));
    near.and_then(|(s, _)| s.light).unwrap_or(0)
}
