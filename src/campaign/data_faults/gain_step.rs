//! Another gain in a part of the flats: in those that were taken later, in the brighter ones, or here and there.
//! The level jumps by a factor, and the slope of the variance over the level by the same one (Healey and
//! Kondepudy 1994, eq. 35: sigma_N^2 = A^2 (I + E_DC) + sigma_C^2). A bend does not jump, a lamp does not touch
//! the slope.

use super::transfer::MODEL_ERROR;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::fit::line::{Line, fit};
use crate::number::with_error;
use crate::statistics::median::median;

/// Least number of flats in all, and in each part.
const MIN_FLATS: usize = 5;
const MIN_OF_PART: usize = 2;
/// Usual relative scatter of a set's level: what lamps that nobody touches have (a named choice).
const LEVEL_SCATTER: f64 = 0.003;
/// Usual relative scatter of a set's level between positions of card and light (a named choice).
const SCATTER_OF_POSITIONS: f64 = 0.03;
/// Least change of the gain that is said.
const MIN_GAIN_RATIO: f64 = 1.08;
/// Square of standard deviations that two gains must explain beyond one.
const MIN_CHI2_GAIN: f64 = 60.0;
/// Mean square of the standard deviations that may be left.
const MAX_CHI2_OF_ONE: f64 = 5.0;
/// Standard deviations within which level and noise must say the same gain, and the largest relative
/// difference.
const MAX_SIGMAS: f64 = 4.0;
const MAX_DIFFERENCE: f64 = 0.15;
/// Least ratio of the lights of a part from which on its levels have a line of their own, and of its signals for the
/// variances.
const MIN_RANGE: (f64, f64) = (1.2, 1.5);
/// Largest standard errors of the gain's logarithm by level and by noise, of the logarithm itself, and the
/// least jump of the level where the parts meet, of the same (named choices, as are the bounds above).
const MAX_REL_STD: (f64, f64) = (0.1, 0.2);
const MIN_JUMP: f64 = 0.5;
/// Level above the darks, in standard deviations of their noise, from which on a flat counts.
const MIN_LEVEL: f64 = 1.0;

/// The check.
pub struct GainStep;

/// A flat: light, level above the darks, temporal variance, with their standard errors.
#[derive(Clone, Copy)]
struct Point {
    set: usize,
    light: f64,
    level_dn: f64,
    level_std: f64,
    variance_dn2: f64,
    variance_std: f64,
}

/// A line through points (x, y, variance of y) by weighted least squares; through `fixed` at x = 0 where that
/// is given.
fn line(points: &[(f64, f64, f64)], fixed: Option<f64>) -> Option<Line> {
    let Some(intercept) = fixed else { return fit(points.iter().copied()) };
    let sum = |f: &dyn Fn(f64, f64) -> f64| points.iter().map(|&(x, y, v)| f(x, y) / v).sum::<f64>();
    let squares = sum(&|x, _| x * x);
    let slope = sum(&|x, y| x * (y - intercept)) / squares;
    let chi2 = points.iter().map(|&(x, y, v)| (y - slope * x - intercept).powi(2) / v).sum();
    (squares > 0.0).then(|| Line {
        slope,
        intercept,
        var_slope: squares.recip(),
        var_intercept: 0.0,
        covariance: 0.0,
        chi2,
        dof: points.len() - 1,
    })
}

/// Level over light, and variance over level, of a part of the flats.
struct Part {
    response: Line,
    noise: Line,
}

impl Part {
    /// `from_zero`: the levels lie on a line through that without light, and the variances on one through that of
    /// darks.
    fn of(points: &[Point], dark_dn2: f64, from_zero: bool) -> Option<Self> {
        let has_range = |of: &dyn Fn(&Point) -> f64, ratio: f64| {
            let (least, most) =
                points.iter().map(of).fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
            most > ratio * least
        };
        let levels: Vec<(f64, f64, f64)> =
            points.iter().map(|p| (p.light, p.level_dn, p.level_std.powi(2))).collect();
        let response = line(&levels, (from_zero || !has_range(&|p| p.light, MIN_RANGE.0)).then_some(0.0))?;
        // Signal: the level above that without light, which a gain on the codes moves too.
        let signal = |p: &Point| p.level_dn - response.intercept;
        let noises: Vec<(f64, f64, f64)> =
            points.iter().map(|p| (signal(p), p.variance_dn2, p.variance_std.powi(2))).collect();
        let free = !from_zero && points.len() > MIN_OF_PART && has_range(&signal, MIN_RANGE.1);
        let noise = line(&noises, (!free).then_some(dark_dn2))?;
        (response.slope > 0.0 && noise.slope > 0.0).then_some(Self { response, noise })
    }

    fn chi2(&self) -> f64 {
        self.response.chi2 + self.noise.chi2
    }
}

/// Two parts with their gains.
struct Step {
    parts: [Vec<Point>; 2],
    chi2: f64,
    /// Gain of the second over that of the first, and its standard error.
    ratio: (f64, f64),
}

impl Step {
    /// A cut of the flats in two; `None` where level and noise do not say one gain.
    fn of(first: &[Point], second: &[Point], dark_dn2: f64, from_zero: bool) -> Option<Self> {
        let ratio = |a: &Line, b: &Line| {
            let rel = |line: &Line| line.var_slope.sqrt() / line.slope;
            ((b.slope / a.slope).ln(), rel(a).hypot(rel(b)))
        };
        let parts = |dark_one_dn2: f64, dark_two_dn2: f64| {
            Part::of(first, dark_one_dn2, from_zero).zip(Part::of(second, dark_two_dn2, from_zero))
        };
        let plain = parts(dark_dn2, dark_dn2)?;
        let level = ratio(&plain.0.response, &plain.1.response);
        // The darks have the gain of either part; the constant noise of the other changes with its square.
        let square = (2.0 * level.0).exp();
        let ways = [Some(plain), parts(dark_dn2 / square, dark_dn2), parts(dark_dn2, dark_dn2 * square)];
        let noise_of = |(one, two): &(Part, Part)| ratio(&one.noise, &two.noise);
        let off = |way: &(Part, Part)| (noise_of(way).0 - level.0).abs();
        let best = ways.into_iter().flatten().min_by(|a, b| off(a).total_cmp(&off(b)))?;
        let (noise, (one, two)) = (noise_of(&best), best);
        let std = level.1.hypot(noise.1);
        let difference = (level.0 - noise.0).abs();
        let agree =
            difference < MAX_SIGMAS * std && difference < (MAX_DIFFERENCE * level.0).abs().max(2.0 * std);
        // The level must jump where the parts meet.
        let extreme =
            |of: &[Point], f: fn(f64, f64) -> f64, from: f64| of.iter().map(|p| p.light).fold(from, f);
        let (low, high) = (extreme(second, f64::min, f64::INFINITY), extreme(first, f64::max, 0.0));
        let meet = (low * high).sqrt();
        let jump = (two.response.at(meet) / one.response.at(meet)).ln();
        let known = noise.1 < MAX_REL_STD.1 * level.0.abs() && level.1 < MAX_REL_STD.0 * level.0.abs();
        let jumps = jump / level.0 > MIN_JUMP && level.0.abs() > MIN_GAIN_RATIO.ln();
        // A gain on the codes with the black level in them moves the level by more than its factor: level and
        // noise then differ by what the ratio is not known.
        let ratio = level.0.exp();
        (agree && known && jumps).then(|| Self {
            parts: [first.to_vec(), second.to_vec()],
            chi2: one.chi2() + two.chi2(),
            ratio: (ratio, ratio * std.hypot(difference)),
        })
    }
}

impl Check for GainStep {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_of_one_part()) else { return Vec::new() };
        let darks = campaign.places(|s| s.kind == Kind::Dark && !s.clipped);
        let dark_dn2 = median(darks.iter().filter_map(|&i| campaign.sets[i].variance_dn2().map(|v| v.0)));
        if !dark_dn2.is_finite() {
            return Vec::new();
        }
        let scatter = if campaign.is_one_bench() { LEVEL_SCATTER } else { SCATTER_OF_POSITIONS };
        let point = |i: usize| {
            let set = &campaign.sets[i];
            let (variance_dn2, pairs) = set.variance_dn2()?;
            let level_dn = set.level_dn() - zero.at(set.exposure_s);
            // Relative variance of the variance of n pairs that overlap: 3 / n for normal noise.
            let rel = MODEL_ERROR.hypot((3.0 / (set.facts.pixels * pairs)).sqrt());
            (level_dn > MIN_LEVEL * dark_dn2.sqrt()).then_some(Point {
                set: i,
                light: set.light(),
                level_dn,
                level_std: (scatter * level_dn).hypot(3.0 * zero.scatter_dn),
                variance_dn2,
                variance_std: rel * variance_dn2,
            })
        };
        let flats = campaign.places(|s| s.is_lit() && !s.clipped && !s.is_cut_off());
        let in_time: Vec<Point> = flats.into_iter().filter_map(point).collect();
        if in_time.len() < MIN_FLATS {
            return Vec::new();
        }
        let mut by_light = in_time.clone();
        by_light.sort_by(|a, b| a.light.total_cmp(&b.light));
        // Noise that falls with the level has no line.
        let whole_chi2 = Part::of(&in_time, dark_dn2, false).map_or(f64::INFINITY, |whole| whole.chi2());
        // Gains that come and go: those whose level is high for their light.
        let mut by_response = by_light.clone();
        by_response.sort_by(|a, b| (a.level_dn / a.light).total_cmp(&(b.level_dn / b.light)));
        let orders = [(by_light, false), (in_time, false), (by_response, true)];
        let cuts = orders.into_iter().flat_map(|(points, from_zero)| {
            (MIN_OF_PART..=points.len() - MIN_OF_PART)
                .filter_map(|at| Step::of(&points[..at], &points[at..], dark_dn2, from_zero))
                .collect::<Vec<_>>()
        });
        let Some(step) = cuts.min_by(|a, b| a.chi2.total_cmp(&b.chi2)) else { return Vec::new() };
        let n = 2.0 * (step.parts[0].len() + step.parts[1].len()) as f64;
        tracing::debug!(
            "gain {:?} in a part of the flats: chi-square {:.0} for {:.0}",
            step.ratio,
            step.chi2,
            whole_chi2
        );
        if whole_chi2 - step.chi2 < MIN_CHI2_GAIN * (step.chi2 / n).max(1.0)
            || step.chi2 > MAX_CHI2_OF_ONE * n
        {
            return Vec::new();
        }
        // The larger part counts; of equal ones that with less light.
        let light = |part: &[Point]| median(part.iter().map(|p| p.light));
        let [one, two] = &step.parts;
        let second_is_out = (two.len(), light(one)) <= (one.len(), light(two));
        let (out, (value, std)) = if second_is_out {
            (two, step.ratio)
        } else {
            (one, (step.ratio.0.recip(), step.ratio.1 / step.ratio.0.powi(2)))
        };
        let mut sets: Vec<usize> = out.iter().map(|p| p.set).collect();
        sets.sort_unstable();
        let text = format!(
            "{}: another gain than the other flats, {} times theirs: level and noise both say so",
            campaign.named(&sets),
            with_error(value, std)
        );
        vec![campaign.fault_of_sets(FaultKind::OtherSettings, &sets, text, true)]
    }
}
