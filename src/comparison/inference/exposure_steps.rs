//! Start of a search for whole steps of the exposure that the levels of the flats follow.
//!
//! Under constant light a level tells how many steps its exposure had, and the scale of the steps goes with
//! the light. A step is known only between the two values at which any exposure has one step more or less.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::f64::consts::PI;

use radcam_sim::effects::{ExposureStep, steps_of_a_number, whole_steps};

use crate::observables::{Observations, gaps, mean};
use radcam_sim::predict::BaseParameters;

/// Minimum number of different exposures at one light: light and step take two of them (a named choice).
const MIN_EXPOSURES: usize = 5;

/// Minimum evidence beyond the price of the choice among all steps that are tried: twice the logarithm of a
/// ratio of 150 (Kass and Raftery 1995, J. Am. Stat. Assoc. 90, 773: very strong).
const EVIDENCE: f64 = 10.0;

/// Maximum excess of the squared deviations over the minimum for a step that fits as well: three standard
/// errors.
const AS_WELL: f64 = 9.0;

/// Shapes of whole steps: cut, rounded, rounded up.
const SHAPES: [f64; 3] = [1.0, 2.0, 3.0];

/// Minimum share of single codes that never occur if codes were multiplied (a named choice).
const LEFT_OUT: f64 = 1e-3;

/// Maximum number of steps tried, of each shape.
const MOST: f64 = 10_000.0;

/// Tested relative errors of a lamp that is not set anew.
const LAMPS: [f64; 4] = [3e-5, 1e-4, 3e-4, 1e-3];

/// Minimum error of a level, DN: resolution of the stored means.
const KEPT_DN: f64 = 0.002;

/// Level of a set.
#[derive(Clone, Copy)]
struct Level {
    exposure_s: f64,
    /// Lamp level, at which the light stays, and the light relative to that; `None`: a dark.
    light: Option<(usize, f64)>,
    /// Signal above black level and dark charge, DN.
    signal_dn: f64,
    /// One over its squared error.
    weight: f64,
}

/// Levels in proportion to exposures, above one offset: the remaining error of the black level.
struct Line {
    offset_dn: f64,
    /// Rate of each light.
    rates_dn_per_s: Vec<f64>,
}

impl Line {
    /// Fits a line by weighted least squares; `of`: exposure of a level.
    fn through(levels: &[Level], of: impl Fn(&Level) -> f64) -> Self {
        let lights = levels.iter().filter_map(|l| Some(l.light?.0)).max().map_or(0, |l| l + 1);
        // Weighted sums of each light (x, x x, x y) and of all levels (1, y).
        let mut sums = vec![[0.0; 3]; lights];
        let (mut ones, mut ys) = (0.0, 0.0);
        for l in levels {
            ones += l.weight;
            ys += l.weight * l.signal_dn;
            if let Some((light, ratio)) = l.light {
                let x = ratio * of(l);
                sums[light][0] += l.weight * x;
                sums[light][1] += l.weight * x * x;
                sums[light][2] += l.weight * x * l.signal_dn;
            }
        }
        let lit = || sums.iter().filter(|s| s[1] > 0.0);
        let own = ones - lit().map(|[x, xx, _]| x * x / xx).sum::<f64>();
        let rest = ys - lit().map(|[x, xx, xy]| x * xy / xx).sum::<f64>();
        let offset_dn = if own > 1e-9 * ones { rest / own } else { 0.0 };
        let rate = |[x, xx, xy]: &[f64; 3]| if *xx > 0.0 { (xy - offset_dn * x) / xx } else { 0.0 };
        Self { offset_dn, rates_dn_per_s: sums.iter().map(rate).collect() }
    }

    /// Returns the measured minus the expected level, DN.
    fn deviation_dn(&self, l: &Level, exposure_s: f64) -> f64 {
        let rate = l.light.map_or(0.0, |(light, ratio)| self.rates_dn_per_s[light] * ratio);
        l.signal_dn - self.offset_dn - rate * exposure_s
    }
}

/// Finds the best step of each shape that describes the levels far better than a constant time, or a light or
/// exposure of its own for each set.
pub(super) fn likely(all: &Observations, base: &BaseParameters) -> [Option<ExposureStep>; 3] {
    // Multiplied codes shift every level by its own part of a code.
    let is_multiplied = || all.of(&gaps::Gaps).any(|o| o.index == 0 && o.measured.value > LEFT_OUT);
    let find = || if is_multiplied() { [None; 3] } else { of_levels(&levels(all, base)) };
    *all.exposure_steps.get_or_init(find)
}

fn of_levels(levels: &[Level]) -> [Option<ExposureStep>; 3] {
    let lit = || levels.iter().filter(|l| l.light.is_some());
    let mut exposures: Vec<f64> = lit().map(|l| l.exposure_s).collect();
    exposures.sort_by(f64::total_cmp);
    exposures.dedup_by(|a, b| (*a - *b).abs() <= 1e-6 * *b);
    let Some(&longest) = exposures.last().filter(|_| exposures.len() >= MIN_EXPOSURES) else {
        return [None; 3];
    };
    let constant = left_by_a_constant(levels);
    // Smallest step that shows: two standard errors of the level that tells a time best.
    let rate = |l: &Level| l.signal_dn / l.exposure_s;
    let least = lit().map(|l| 2.0 / (rate(l) * l.weight.sqrt())).fold(f64::INFINITY, f64::min);
    if constant < EVIDENCE || !(least > 0.0 && least < longest) {
        return [None; 3];
    }
    // The next step tried gives the longest exposure a third of a step more.
    let least = least.max(3.0 * longest / MOST);
    let number = 3.0 * longest / least;
    let enough = constant.min(left_by_settings(levels)).min(left_by_times(levels))
        - 2.0 * (SHAPES.len() as f64 * number).ln()
        - EVIDENCE;
    let mut tried = Vec::new();
    for rel in LAMPS {
        let (levels, wider) = widened(levels, rel);
        if wider > enough {
            break;
        }
        for shape in SHAPES {
            let mut step_s = longest;
            while step_s > least {
                let left = wider + left_by_steps(&levels, shape, step_s);
                if left < enough {
                    tried.extend(between(&exposures, shape, step_s).map(|step| (left, step)));
                }
                step_s -= (step_s / longest) * step_s / 3.0;
            }
        }
    }
    let best = tried.iter().map(|(left, _)| *left).fold(f64::INFINITY, f64::min);
    tried.retain(|(left, _)| *left < best + AS_WELL);
    tracing::debug!("  steps of the exposure: {constant:.1} -> {best:.1}, asked {enough:.1}");
    SHAPES.map(|shape| {
        let own = tried.iter().filter(|(_, s)| s.shape == shape).min_by(|a, b| a.0.total_cmp(&b.0))?.1;
        // Distance to each other one, over the standard errors by which it fits worse.
        let away =
            |(left, s): &(f64, ExposureStep)| (s.step_s - own.step_s).abs() / (left - best).max(1.0).sqrt();
        let far = tried.iter().map(away).fold(0.0, f64::max);
        Some(ExposureStep { std_err_s: own.std_err_s.max(far), ..own })
    })
}

/// Computes the levels of the sets.
fn levels(all: &Observations, base: &BaseParameters) -> Vec<Level> {
    let gain = base.gain_dn_per_e;
    let of = |o: &crate::observables::Observable| {
        let set = all.campaign.sets.get(o.set?)?;
        let dark_dn = base.offset_dn + gain * base.dark_e_per_s * set.exposure_s;
        let signal_dn = o.measured.value - dark_dn;
        let frames = (o.frames.1 - o.frames.0).max(1) as f64;
        let noise_dn2 = gain * (signal_dn.max(0.0) + gain * base.read_noise_e.powi(2));
        let scatter_dn2 = (noise_dn2 / o.pixels.max(1.0)).max(o.frame_means.1) / frames;
        // Largest error of a mean rounded to codes (Widrow and Kollar 2008, ch. 4), over root two.
        let unrounded_dn2 = noise_dn2 + set.spread_dn.powi(2);
        let rounding_dn = (-2.0 * PI.powi(2) * unrounded_dn2).exp() / (PI * 2.0_f64.sqrt());
        let var_dn2 = scatter_dn2 + KEPT_DN.powi(2) + rounding_dn.powi(2);
        let light = set.light.map(|light| (light, set.light_ratio));
        let level = Level { exposure_s: set.exposure_s, light, signal_dn, weight: var_dn2.recip() };
        (light.is_none() || set.exposure_s > 0.0 && signal_dn > 0.0).then_some((o.set?, level))
    };
    let mut sets: BTreeMap<usize, Level> = BTreeMap::new();
    for (set, level) in all.of(&mean::Mean).filter_map(of) {
        match sets.entry(set) {
            Entry::Vacant(free) => {
                free.insert(level);
            }
            Entry::Occupied(mut has) => {
                let both = has.get_mut();
                let weight = both.weight + level.weight;
                both.signal_dn = (both.weight * both.signal_dn + level.weight * level.signal_dn) / weight;
                both.weight = weight;
            }
        }
    }
    sets.into_values().collect()
}

/// Adds a relative error of the light to the levels. Also returns the sum of the log ratios of the variances
/// with and without it.
fn widened(levels: &[Level], rel: f64) -> (Vec<Level>, f64) {
    widened_by(levels, |l| rel * l.signal_dn)
}

/// Adds another error, DN, to the lit levels.
fn widened_by(levels: &[Level], error_dn: impl Fn(&Level) -> f64) -> (Vec<Level>, f64) {
    let by = |l: &Level| 1.0 + if l.light.is_some() { l.weight * error_dn(l).powi(2) } else { 0.0 };
    let wide = levels.iter().map(|l| Level { weight: l.weight / by(l), ..*l }).collect();
    (wide, levels.iter().map(|l| by(l).ln()).sum())
}

/// Computes the sum of the squared deviations, in standard errors, from levels in proportion to exposures
/// `of` a level.
fn left(levels: &[Level], of: impl Fn(&Level) -> f64) -> f64 {
    let line = Line::through(levels, &of);
    levels.iter().map(|l| l.weight * line.deviation_dn(l, of(l)).powi(2)).sum()
}

/// Computes the deviance if each set has a light of its own, with the likeliest scatter: minus twice the log
/// likelihood, relative to levels without an error.
fn left_by_settings(levels: &[Level]) -> f64 {
    let at = |rel: f64| with_an_error(levels, |l| rel * l.signal_dn);
    (0..SCATTERS).map(|k| at(1e-5 * 1.25_f64.powi(k))).fold(at(0.0), f64::min)
}

/// Computes the deviance if each set has an exposure of its own, with the likeliest scatter: deviations of a
/// few dim levels, as near black, are no steps.
fn left_by_times(levels: &[Level]) -> f64 {
    let longest_s = levels.iter().map(|l| l.exposure_s).fold(0.0, f64::max);
    let at = |time_s: f64| with_an_error(levels, |l| time_s * l.signal_dn / l.exposure_s);
    (0..SCATTERS).map(|k| at(1e-5 * longest_s * 1.25_f64.powi(k))).fold(at(0.0), f64::min)
}

fn with_an_error(levels: &[Level], error_dn: impl Fn(&Level) -> f64) -> f64 {
    let (levels, wider) = widened_by(levels, error_dn);
    let line = Line::through(&levels, |l| l.exposure_s);
    wider + levels.iter().map(|l| l.weight * line.deviation_dn(l, l.exposure_s).powi(2)).sum::<f64>()
}

/// Number of tested scatters of settings and times, each a quarter larger than the one before: to 0.6.
const SCATTERS: i32 = 50;

fn left_by_steps(levels: &[Level], shape: f64, step_s: f64) -> f64 {
    left(levels, |l| whole_steps(shape, step_s, l.exposure_s) * step_s)
}

/// Computes the sum of the squared deviations with the best constant time added to the exposures, at the
/// minimum of a parabola through three points.
fn left_by_a_constant(levels: &[Level]) -> f64 {
    let lit = levels.iter().filter(|l| l.light.is_some());
    let shortest = lit.map(|l| l.exposure_s).fold(f64::INFINITY, f64::min);
    let at = |t0_s: f64| left(levels, |l| l.exposure_s + t0_s);
    let mut t0_s = 0.0;
    let mut span = 0.5 * shortest;
    for _ in 0..ROUNDS {
        let (below, here, above) = (at(t0_s - span), at(t0_s), at(t0_s + span));
        let bend = below - 2.0 * here + above;
        if bend > 0.0 {
            t0_s += (0.5 * (below - above) / bend).clamp(-1.0, 1.0) * span;
        }
        span *= 0.3;
    }
    at(t0_s).min(at(0.0))
}

/// Number of iterations to find the constant time.
const ROUNDS: usize = 8;

/// Returns the middle of the steps that give every exposure the same number of steps, and the standard
/// deviation of a uniform distribution over them; `None` if no exposure has two steps, so that none is too
/// long.
fn between(exposures: &[f64], shape: f64, step_s: f64) -> Option<ExposureStep> {
    let (mut low, mut high) = (0.0_f64, f64::INFINITY);
    for t in exposures {
        let (shortest, longest) = steps_of_a_number(shape, whole_steps(shape, step_s, *t), *t);
        (low, high) = (low.max(shortest), high.min(longest));
    }
    high.is_finite().then(|| ExposureStep {
        shape,
        step_s: 0.5 * (low + high),
        std_err_s: (high - low) / 12.0_f64.sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Levels of twelve exposures with a relative error of `rel`, by a camera that exposes for `of` the
    /// nominal time.
    fn levels(of: impl Fn(f64) -> f64, rel: f64, seed: u64) -> Vec<Level> {
        let mut random = radcam_sim::rng::PixelRng::new(seed, radcam_sim::rng::Stream::Effect, 0, 0, 0);
        (0..12)
            .map(|i| {
                let exposure_s = 1e-4 * 1.7_f64.powi(i);
                let signal_dn = 4e5 * of(exposure_s);
                let error = rel * signal_dn;
                let signal_dn = signal_dn + error * random.normal();
                Level { exposure_s, light: Some((0, 1.0)), signal_dn, weight: error.powi(-2) }
            })
            .collect()
    }

    #[test]
    fn the_constant_time_is_taken_off() {
        // Chi-square of nine degrees of freedom, mean of 100: 9 +- 0.42; five sigma.
        let all: f64 = (0..100).map(|s| left_by_a_constant(&levels(|t| t + 2e-5, 1e-3, s))).sum();
        assert!((all / 100.0 - 9.0).abs() < 2.1, "{}", all / 100.0);
    }

    /// Ten campaigns each: lamps that do not return to their setting show no steps, and steps are found with
    /// their shape.
    #[test]
    fn steps_are_told_from_settings() {
        for seed in 0..10 {
            assert_eq!(of_levels(&levels(|t| t, 1e-3, seed)), [None; 3], "{seed}");
            let mut random = radcam_sim::rng::PixelRng::new(seed, radcam_sim::rng::Stream::Effect, 1, 0, 0);
            let lamps: Vec<f64> = (0..12).map(|_| 1.0 + 0.01 * random.normal()).collect();
            let scattered: Vec<Level> = levels(|t| t, 1e-3, seed)
                .into_iter()
                .zip(&lamps)
                .map(|(l, lamp)| Level { signal_dn: l.signal_dn * lamp, ..l })
                .collect();
            assert_eq!(of_levels(&scattered), [None; 3], "{seed}");
            // The two dimmest levels are off, as near black.
            let toe = levels(|t| t + 3e-6 * (-(t / 1.5e-4)).exp(), 1e-3, seed);
            assert_eq!(of_levels(&toe), [None; 3], "{seed}");
            for (k, shape) in SHAPES.into_iter().enumerate() {
                let step_s = 3e-5 * (1.0 + 0.01 * seed as f64);
                let steps = |t: f64| whole_steps(shape, step_s, t) * step_s;
                let found = of_levels(&levels(steps, 1e-3, seed))[k];
                let found = found.unwrap_or_else(|| panic!("{shape} {seed}"));
                assert!((found.step_s - step_s).abs() < 3.0 * found.std_err_s, "{found:?} {step_s}");
            }
        }
    }

    #[test]
    fn steps_lie_between_those_of_another_number() {
        let exposures = [1e-4, 2.5e-4, 9.9e-4, 3.21e-3];
        for (shape, step_s) in [(1.0, 3.2e-5), (2.0, 3.2e-5), (3.0, 3.2e-5), (1.0, 1e-5)] {
            let found = between(&exposures, shape, step_s).unwrap();
            assert!((found.step_s - step_s).abs() < 2.0 * found.std_err_s + 1e-9, "{found:?}");
            for t in exposures {
                assert_eq!(whole_steps(shape, step_s, t), whole_steps(shape, found.step_s, t));
            }
        }
        assert_eq!(between(&exposures, 1.0, 4e-3), None);
    }
}
