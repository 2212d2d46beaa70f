//! Another gain in a part of the flats: the later ones, the brighter ones, or scattered ones. The level
//! jumps by a factor, and the slope of the variance over the level by the same factor (Healey and
//! Kondepudy 1994, eq. 35: sigma_N^2 = A^2 (I + E_DC) + sigma_C^2). A bend does not jump, and a lamp
//! does not change the slope.

use super::transfer::MODEL_ERROR;
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::fit::line::{Line, fit};
use crate::number::with_error;
use crate::statistics::median::median;

/// Minimum number of flats in all, and in each part.
const MIN_FLATS: usize = 5;
const MIN_OF_PART: usize = 2;
/// Usual relative scatter of a set's level for undisturbed lamps (a named choice).
const LEVEL_SCATTER: f64 = 0.003;
/// Usual relative scatter of a set's level between positions of card and light (a named choice).
const SCATTER_OF_POSITIONS: f64 = 0.03;
/// Minimum change of the gain that is reported.
const MIN_GAIN_RATIO: f64 = 1.08;
/// Minimum decrease of chi^2 by two gains instead of one.
const MIN_CHI2_GAIN: f64 = 60.0;
/// Maximum remaining mean chi^2.
const MAX_CHI2_OF_ONE: f64 = 5.0;
/// Maximum difference of the gains from level and from noise, standard deviations, and relative.
const MAX_SIGMAS: f64 = 4.0;
const MAX_DIFFERENCE: f64 = 0.15;
/// Minimum ratio of the lights of a part whose levels get their own line, and of its signals for the
/// variances.
const MIN_RANGE: (f64, f64) = (1.2, 1.5);
/// Maximum standard errors of the logarithm of the gain, by level and by noise, relative to that
/// logarithm, and minimum jump of the level between the parts, relative to the same (named choices, as
/// are the bounds above).
const MAX_REL_STD: (f64, f64) = (0.1, 0.2);
const MIN_JUMP: f64 = 0.5;
/// Minimum level of a flat above the darks, in standard deviations of their noise.
const MIN_LEVEL: f64 = 1.0;

/// Check for a gain step.
pub struct GainStep;

/// Flat: light, level above the darks, temporal variance, with standard errors.
#[derive(Clone, Copy)]
struct Point {
    set: usize,
    light: f64,
    level_dn: f64,
    level_std: f64,
    variance_dn2: f64,
    variance_std: f64,
}

/// Fits a line through points (x, y, variance of y) by weighted least squares; through `fixed` at x = 0
/// if given.
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

/// Level over light, and variance over level, for a part of the flats.
struct Part {
    response: Line,
    noise: Line,
}

impl Part {
    /// Fits a part. `from_zero`: the line of the levels passes through zero at zero light, that of the
    /// variances through the dark variance.
    fn of(points: &[Point], dark_dn2: f64, from_zero: bool) -> Option<Self> {
        let has_range = |of: &dyn Fn(&Point) -> f64, ratio: f64| {
            let (least, most) =
                points.iter().map(of).fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
            most > ratio * least
        };
        let levels: Vec<(f64, f64, f64)> =
            points.iter().map(|p| (p.light, p.level_dn, p.level_std.powi(2))).collect();
        let response = line(&levels, (from_zero || !has_range(&|p| p.light, MIN_RANGE.0)).then_some(0.0))?;
        // Signal: level above that at zero light, which a gain on the codes also moves.
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
    /// Ratio of the second gain to the first, and its standard error.
    ratio: (f64, f64),
}

impl Step {
    /// Splits the flats in two; `None` if level and noise do not agree on one gain.
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
        // The darks have the gain of one of the parts; the constant noise of the other scales with its
        // square.
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
        // The level must jump between the parts.
        let extreme =
            |of: &[Point], f: fn(f64, f64) -> f64, from: f64| of.iter().map(|p| p.light).fold(from, f);
        let (low, high) = (extreme(second, f64::min, f64::INFINITY), extreme(first, f64::max, 0.0));
        let meet = (low * high).sqrt();
        let jump = (two.response.at(meet) / one.response.at(meet)).ln();
        let known = noise.1 < MAX_REL_STD.1 * level.0.abs() && level.1 < MAX_REL_STD.0 * level.0.abs();
        let jumps = jump / level.0 > MIN_JUMP && level.0.abs() > MIN_GAIN_RATIO.ln();
        // A gain on codes that include the black level moves the level by more than its factor: the
        // difference between level and noise is then the uncertainty of the ratio.
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
            // Relative variance of the variance from n overlapping pairs: 3 / n for normal noise.
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
        // Intermittent gains: flats with a high level for their light.
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
        // The larger part is kept; of equal ones that with less light.
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
