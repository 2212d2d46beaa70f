//! Levels: from the frames of a dataset, or the rows of a table, to points of the photon-transfer plot.

use super::NoiseError;
use crate::dataset::table::Table;
use crate::dataset::{DataFault, Dataset, Key, Kind, Set};
use crate::first_look::Seen;
use crate::fit::line::{fit, goodness};
use crate::number::finite;
use crate::statistics::level::{Level, LevelAccumulator};
use crate::statistics::outliers;
use radcam_sim::rounded;
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// One point of the photon-transfer plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Number of the set, or of the row of a table.
    pub set: u32,
    /// Dark or flat.
    pub kind: Kind,
    /// Mean above the black level, DN.
    pub mean_dn: f64,
    /// Temporal variance, DN^2.
    pub var_dn2: f64,
    /// Number of frames; 2 for a row of a table.
    pub frames: f64,
    /// Number of pixels; NaN if unknown.
    pub pixels: f64,
    /// Variance of the pixels' true means over the field, DN^2.
    pub spatial_var_dn2: f64,
    /// Variance over the pixels of their read-noise variances, DN^4.
    pub noise_spread_dn4: f64,
    /// Error of the variance beyond that of independent pixels, DN^2.
    pub var_unsure_dn2: f64,
    /// Error of the variance that is common to all levels, DN^2, with its own size and sign at each.
    pub var_common_dn2: f64,
    /// Standard error of the mean that other levels do not share, DN: a moving black level.
    pub mean_unsure_dn: f64,
    /// Pairs of the level as (mean above zero, variance).
    pub pairs: Vec<(f64, f64)>,
    /// Reason for exclusion from the fit.
    pub excluded: Option<String>,
}

/// Black level at zero exposure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Zero {
    /// Black level, DN.
    #[serde(with = "finite")]
    pub dn: f64,
    /// Standard error, DN.
    #[serde(with = "finite")]
    pub std_err_dn: f64,
    /// Source of the black level.
    pub source: &'static str,
    /// Standard deviation of the zero of a single set, DN, if the level of the darks moved; otherwise 0.
    pub moved_dn: f64,
}

impl Zero {
    /// Range over which the zero moved, DN: that of a uniform distribution with this standard deviation.
    pub fn moved_range_dn(&self) -> f64 {
        self.moved_dn * 12f64.sqrt()
    }
}

/// Pixels that are excluded from the noise: hot, blind, clipped, jumping and interpolated ones, as in
/// `diagnose`.
#[derive(Debug, Clone, Default)]
pub(crate) struct Mask {
    /// Places of the masked pixels, row by row, ascending.
    masked: Vec<usize>,
    /// Numbers of the sets with so many pixels at full scale that they are useless.
    saturated: Vec<u32>,
    /// Digest of the mask.
    under: String,
}

impl Mask {
    pub(crate) fn of(seen: &Seen, dataset: &Dataset) -> Self {
        let mask = seen.layout.mask.iter().enumerate();
        let masked: Vec<usize> = mask.filter(|(_, used)| **used == 0.0).map(|(i, _)| i).collect();
        let sets = dataset.sets().iter().zip(&seen.looks).filter(|(_, look)| look.saturated);
        let mut digest = Sha256::new();
        digest.update(env!("CARGO_PKG_VERSION"));
        masked.iter().for_each(|i| digest.update((*i as u64).to_le_bytes()));
        Self {
            saturated: sets.map(|(set, _)| set.number).collect(),
            under: digest.finalize().iter().map(|b| format!("{b:02x}")).collect(),
            masked,
        }
    }

    /// Returns the key of a level measured under this mask.
    pub(crate) fn key(&self, dataset: &Dataset, set: &Set) -> Key {
        Key { under: self.under.clone(), ..Key::first(dataset, set, usize::MAX) }
    }
}

/// Statistics of the frames of a dataset, before any line is fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Sets of darks and flats with at least two frames.
    pub levels: Vec<(u32, Kind, f64, Level)>,
    /// Full scale, DN.
    pub full_scale_dn: f64,
    /// `black_level_dn` of the manifest.
    pub black_level_dn: Option<f64>,
    /// Step of the converter, DN.
    pub code_step_dn: f64,
    /// Numbers of the sets at full scale in too many pixels.
    pub saturated: Vec<u32>,
    /// Share of a change of level that first frames carry from the set before.
    pub carried_share: f64,
    /// True if light is in the darks.
    pub darks_are_lit: bool,
}

/// Reads every dark and flat. `progress` receives (sets done, sets).
///
/// # Errors
///
/// If a frame (named) cannot be read, or the measurement was stopped.
pub fn measure(
    dataset: &Dataset,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Measured, NoiseError> {
    let camera = &dataset.manifest().camera;
    let wanted: Vec<_> = dataset
        .sets()
        .iter()
        .filter(|s| matches!(dataset.settings(s).kind, Kind::Dark | Kind::Flat))
        .collect();
    if wanted.is_empty() {
        return Err(NoiseError::NoFrames);
    }
    let mask = Mask::of(&Seen::new(dataset, stop, &mut |_| {})?, dataset);
    let mut levels = Vec::new();
    let mut accumulator: Option<LevelAccumulator> = None;
    for (done, set) in wanted.iter().enumerate() {
        let settings = dataset.settings(set);
        if let Some(level) = level_of(dataset, set, &mask, &mut accumulator, stop)? {
            levels.push((set.number, settings.kind, settings.exposure_s, level));
        }
        progress(done + 1, wanted.len());
    }
    Ok(Measured {
        levels,
        full_scale_dn: camera.full_scale_dn().into(),
        black_level_dn: dataset.black_level_dn(),
        code_step_dn: dataset.code_step_dn(),
        saturated: mask.saturated,
        carried_share: dataset.carried_share(),
        darks_are_lit: dataset.data_faults().iter().any(DataFault::is_leak),
    })
}

/// Source of a black level between the single dark level and `black_level_dn`.
pub(super) const ONE_EXPOSURE_BOUNDED: &str = "between the darks of one exposure and black_level_dn";
/// Source of a black level from darks of one exposure alone.
pub(super) const ONE_EXPOSURE: &str = "darks of one exposure";
/// Source of an unknown black level.
pub(super) const NO_ZERO: &str = "none: no usable darks, taken as 0 DN";
/// Source of a black level stated in the manifest.
pub(super) const BLACK_LEVEL: &str = "black_level_dn of dataset.toml";
/// Variance below which the noise is narrower than half a step, in squared steps.
const COARSE: f64 = 0.25;

/// Share of clipped samples above which the bias of a level's variance exceeds its error.
const CLIPPED: f64 = 1e-4;
/// Share of samples at code 0 above which the bias of the variance of a dark or dim flat exceeds its error:
/// normal noise that is cut off three standard deviations below its mean, one sample in 740, has 0.25 % less
/// (the integral of (z^2 - 9) over the tail).
const CLIPPED_AT_BLACK: f64 = 1.35e-3;

/// Reason for excluding a single frame.
pub(super) const ONE_FRAME: &str = "one frame: a variance needs two";

fn clipped_because(level: &Level) -> Option<String> {
    let percent = |share: f64| format!("{:.2} %", 100.0 * share);
    if level.pixels < 2 {
        Some("every pixel is clipped in every frame".into())
    } else if level.saturated > CLIPPED {
        // Stuck pixels count too.
        let share = level.saturated.min(1.0) * (1.0 - level.stuck) + level.stuck;
        Some(format!("{} of the samples are at full scale", percent(share)))
    } else if level.stuck > 0.5 {
        Some("most pixels are clipped in every frame".into())
    } else if level.black > CLIPPED_AT_BLACK {
        Some(format!("{} of the samples are clipped at black", percent(level.black)))
    } else if level.frames < 2 {
        Some(ONE_FRAME.into())
    } else {
        None
    }
}

/// Measures mean and variance of a set of darks or flats under a mask; `None` for other sets. `memory` is
/// reused for the next set.
///
/// # Errors
///
/// If a frame (named) cannot be read, or the measurement was stopped.
pub(crate) fn level_of(
    dataset: &Dataset,
    set: &Set,
    mask: &Mask,
    memory: &mut Option<LevelAccumulator>,
    stop: &AtomicBool,
) -> Result<Option<Level>, NoiseError> {
    if !matches!(dataset.settings(set).kind, Kind::Dark | Kind::Flat) {
        return Ok(None);
    }
    if let Some(known) = dataset.reduced().and_then(|r| r.get::<Option<Level>>(&mask.key(dataset, set))) {
        return Ok(known.clone());
    }
    let camera = &dataset.manifest().camera;
    if let Some(level) = memory {
        level.reset();
    }
    // Eight frames at a time: one pass through memory, bounded for a long set.
    let mut struck = 0;
    for rows in outliers::blocks(&set.rows) {
        if stop.load(Ordering::Relaxed) {
            return Err(NoiseError::Interrupted);
        }
        let read = |i: &usize| dataset.read(&dataset.rows()[*i]).map(Arc::new);
        let frames: Vec<_> = rows.iter().map(read).collect::<Result<_, _>>()?;
        let (frames, hit) = dataset.without_struck(frames);
        struck += hit as u64;
        let slices: Vec<&[u16]> = frames.iter().filter_map(|f| f.as_slice()).collect();
        // Memory is allocated once frames were read and their size checked, not for the claim of a damaged
        // manifest.
        let shape = (camera.height, camera.width);
        let level = memory.get_or_insert_with(|| {
            LevelAccumulator::new(shape, camera.bit_depth).without(mask.masked.clone())
        });
        let _ = level.add(&slices);
    }
    let level = memory.as_ref().and_then(LevelAccumulator::finish);
    Ok(level.map(|level| Level { struck, ..level }))
}

/// Estimates the black level at zero exposure from the darks: their means extrapolated to no exposure.
pub fn zero(measured: &Measured) -> Zero {
    let darks: Vec<_> = measured
        .levels
        .iter()
        .filter(|(_, kind, _, level)| *kind == Kind::Dark && clipped_because(level).is_none())
        .collect();
    // Scatter of the frame means from any cause (read noise, row noise, a drifting black level).
    let n = darks.len() as f64;
    let scatter = darks.iter().map(|(.., l)| l.frame_mean_var_dn2).sum::<f64>() / n;
    let square = measured.code_step_dn.powi(2);
    let variance = |l: &Level| {
        // A constant code hides its mean within the step: q^2/12, which averaging does not reduce.
        let hidden = if l.var_dn2 < COARSE * square { square / 12.0 } else { 0.0 };
        (scatter / l.frames as f64).max(l.var_dn2 / (l.frames * l.pixels) as f64) + hidden
    };
    let points = || darks.iter().map(|(_, _, exposure_s, l)| (*exposure_s, l.mean_dn, variance(l)));
    if let Some(line) = fit(points()) {
        let shortest = points().min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, shortest_dn, variance)) = shortest.filter(|_| measured.darks_are_lit && line.dof == 0)
        {
            // Light in only one of two darks changes the line: the zero lies anywhere between the shorter
            // dark and that line.
            let range = shortest_dn - line.intercept;
            return Zero {
                dn: shortest_dn - 0.5 * range,
                std_err_dn: (range / 12f64.sqrt()).hypot(variance.sqrt()),
                source: "between the shorter of two darks with light in them and their line",
                moved_dn: 0.0,
            };
        }
        // Scatter of the means beyond that of their frames (temperature) widens the error.
        let inflation = if line.dof > 0 { (line.chi2 / line.dof as f64).max(1.0) } else { 1.0 };
        let moved_dn = moved(points().map(|(t, mean, variance)| (mean - line.at(t), variance)), line.dof);
        let std_err_dn = (line.var_intercept * inflation).sqrt().hypot(moved_dn);
        return Zero {
            dn: line.intercept,
            std_err_dn,
            source: "darks extrapolated to zero exposure",
            moved_dn,
        };
    }
    if let Some((weight, sum)) = points()
        .map(|(_, mean, variance)| (1.0 / variance, mean / variance))
        .reduce(|a, b| (a.0 + b.0, a.1 + b.1))
    {
        // This dark mean contains an unknown amount of dark charge, since there is one exposure only. A known
        // black level bounds it: anything between the two is equally likely.
        let mut dark = sum / weight;
        let moved_dn = moved(points().map(|(_, mean, variance)| (mean - dark, variance)), darks.len() - 1);
        if moved_dn > 0.0 {
            // The frames' own scatter is negligible beside that of the sets.
            dark = darks.iter().map(|(.., l)| l.mean_dn).sum::<f64>() / n;
        }
        let own = weight.sqrt().recip().hypot(moved_dn);
        return match measured.black_level_dn {
            Some(black) => Zero {
                dn: 0.5 * (dark + black),
                std_err_dn: ((dark - black).powi(2) / 12.0).sqrt().hypot(own),
                source: ONE_EXPOSURE_BOUNDED,
                moved_dn,
            },
            None => Zero { dn: dark, std_err_dn: own, source: ONE_EXPOSURE, moved_dn },
        };
    }
    // A single frame has a mean, with the error from its pixels' scatter.
    let single = measured
        .levels
        .iter()
        .filter(|(_, kind, _, l)| *kind == Kind::Dark && l.frames == 1 && l.pixels > 1 && l.black <= CLIPPED);
    if let Some((.., level)) = single.min_by(|a, b| a.2.total_cmp(&b.2)) {
        let std_err_dn = (level.spatial_var_dn2 / level.pixels as f64).sqrt();
        return Zero { dn: level.mean_dn, std_err_dn, source: "a single dark frame", moved_dn: 0.0 };
    }
    match measured.black_level_dn {
        Some(dn) => Zero { dn, std_err_dn: f64::NAN, source: BLACK_LEVEL, moved_dn: 0.0 },
        None => Zero { dn: 0.0, std_err_dn: f64::NAN, source: NO_ZERO, moved_dn: 0.0 },
    }
}

/// Returns the standard deviation of the zero of any set, DN, if the darks' levels, given as (deviation,
/// variance), scatter beyond the noise of their frames; otherwise 0. A drifting level lies anywhere between
/// the levels seen, and more darks do not average it out: uniform distribution over the range.
fn moved(darks: impl Iterator<Item = (f64, f64)>, dof: usize) -> f64 {
    let (mut chi2, mut least, mut most) = (0.0, f64::INFINITY, f64::NEG_INFINITY);
    for (off, variance) in darks {
        chi2 += off * off / variance;
        (least, most) = (off.min(least), off.max(most));
    }
    let range = most - least;
    if dof == 0 || goodness(chi2, dof as f64) > MOVED_P || range < MIN_MOVED_DN {
        return 0.0;
    }
    range / 12f64.sqrt()
}

/// Returns true for a flat whose level lies below that of the darks.
pub(super) fn is_darker(kind: Kind, mean_dn: f64, var_dn2: f64) -> bool {
    kind == Kind::Flat && mean_dn < -var_dn2.max(1.0).sqrt()
}

/// Returns the reason for excluding a flat below the darks.
fn darker(kind: Kind, mean_dn: f64, level: &Level) -> Option<String> {
    is_darker(kind, mean_dn, level.var_dn2).then(|| {
        format!(
            "a flat {:.0} DN darker than the darks: the two may be exchanged, or darks were taken off",
            -mean_dn
        )
    })
}

/// Converts sets to points above the zero, with the reasons for excluding clipped or too coarsely quantised
/// ones.
pub fn points(measured: &Measured, zero: &Zero) -> Vec<Point> {
    let light = Light::of(measured, zero);
    let step_dn = measured.code_step_dn;
    let noise_spread_dn4 = noise_spread_dn4(measured);
    let point = |(set, kind, _, level): &(u32, Kind, f64, Level)| {
        let coarse = (level.var_dn2 < COARSE * step_dn.powi(2)).then(|| {
            format!(
                "noise of {:.2} DN is below half a step: quantisation noise is not q^2/12 there",
                level.var_dn2.sqrt()
            )
        });
        let full =
            measured.saturated.contains(set).then(|| "2 % of the pixels or more are at full scale".into());
        let mean_dn = level.mean_dn - zero.dn;
        // Variance from unequal light in a shaded field.
        let by_light = if *kind == Kind::Flat { light.var_dn2(level, mean_dn) } else { 0.0 };
        let by_rounding = by_rounding(level, step_dn);
        let of_pair = |p: &crate::statistics::level::Pair| {
            let (mean, moved) = (p.mean_dn - zero.dn, 0.5 * p.difference_dn * p.difference_dn);
            let by_light = if *kind == Kind::Flat { light.of_scatter(level, moved, mean_dn) } else { 0.0 };
            (mean, p.var_dn2 - by_light - by_rounding)
        };
        Point {
            set: *set,
            kind: *kind,
            mean_dn,
            var_dn2: level.var_dn2 - by_light - by_rounding,
            frames: level.frames as f64,
            pixels: level.pixels as f64,
            spatial_var_dn2: level.spatial_var_dn2,
            noise_spread_dn4,
            var_unsure_dn2: LIGHT_SHAPE_ERROR * by_light,
            var_common_dn2: ROUNDING_ERROR * by_rounding + by_memory(level, measured.carried_share),
            mean_unsure_dn: zero.moved_dn,
            pairs: level.pairs.iter().map(of_pair).collect(),
            excluded: clipped_because(level).or(full).or_else(|| darker(*kind, mean_dn, level)).or(coarse),
        }
    };
    let mut points: Vec<Point> = measured.levels.iter().map(point).collect();
    exclude_clamped_darks(measured, &mut points);
    points
}

/// Unknown share of the correction for rounding: equal pixels have two thirds of it, and pixels that differ
/// twice as much four thirds.
const ROUNDING_ERROR: f64 = 0.33;

/// Computes the variance that a level lacks if each frame carries a share of the one before, DN^2.
fn by_memory(level: &Level, share: f64) -> f64 {
    level.var_dn2 * (kept_variance(share, level.frames).recip() - 1.0)
}

/// Computes the variance about the mean of n frames, each of which carries a share f of the one before, over
/// that of independent frames.
///
/// The variance of y_t = (1 - f) x_t + f y_(t-1) is (1 - f) / (1 + f) that of x. Frames k apart have the
/// correlation f^k (Box and Jenkins 1976, 3.2.3). The variance about the mean of n frames is less by the sum
/// of (1 - k / n) f^k, times 2 / (n - 1) (ibid., 2.1.5: the variance of a mean). Charge that is read with the
/// next frame only has nearly the same effect on both.
fn kept_variance(share: f64, frames: u64) -> f64 {
    let n = frames as f64;
    let shared: f64 = (1..frames.min(100)).map(|k| (1.0 - k as f64 / n) * share.powi(k as i32)).sum();
    (1.0 - share) / (1.0 + share) * (1.0 - 2.0 * shared / (n - 1.0).max(1.0))
}
/// Variance of the logarithm of the pixels' noise variances: a standard deviation of the noise of 15 %
/// (log-normal), as in the data sheets of CMOS sensors. Rounded noise does not determine it.
const USUAL_LOG_VAR: f64 = 0.09;

/// Computes the variance of a level beyond that before rounding and q^2/12, DN^2. Noise of about half a step
/// has more or less, depending on the position of its level between two codes, the spread of the pixels'
/// levels, and the differences in noise between pixels (log-normal: Johnson, Kotz and Balakrishnan 1994, ch.
/// 14).
fn by_rounding(level: &Level, step_dn: f64) -> f64 {
    // All in steps of the converter.
    let square = step_dn * step_dn;
    let (mean, var) = (level.mean_dn / step_dn, level.var_dn2 / square);
    let spread = level.spatial_var_dn2.max(0.0).sqrt() / step_dn;
    if !(COARSE..WIDE).contains(&var) || !(mean + spread).is_finite() {
        return 0.0;
    }
    let seen = |before: f64| {
        let of = |&(z, weight): &(f64, f64)| {
            let own = before * (USUAL_LOG_VAR.sqrt() * z - 0.5 * USUAL_LOG_VAR).exp();
            weight * (own + rounded(mean, spread, own).variance)
        };
        NORMAL_POINTS.iter().map(of).sum::<f64>()
    };
    let (mut low, mut high) = (0.0, 2.0 * WIDE);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if seen(middle) < var { low = middle } else { high = middle }
    }
    square * (var - (0.5 * (low + high) + 1.0 / 12.0))
}

/// Nodes and weights of the mean over a standard normal number (Gauss and Hermite; Abramowitz and Stegun,
/// table 25.10).
const NORMAL_POINTS: [(f64, f64); 5] = [
    (-2.856_970_0, 0.011_257_4),
    (-1.355_626_2, 0.222_075_9),
    (0.0, 0.533_333_4),
    (1.355_626_2, 0.222_075_9),
    (2.856_970_0, 0.011_257_4),
];

/// Variance, in squared steps, above which rounding adds q^2/12 at any level: the remaining error is exp(-2
/// pi^2 0.7) = 1e-6.
const WIDE: f64 = 0.7 + 1.0 / 12.0;

/// Estimates the variance over the pixels of the read noise's variances, DN^4, from all darks. The variance
/// of unequal pixels scatters more than that of as many equal ones.
fn noise_spread_dn4(measured: &Measured) -> f64 {
    let darks = measured.levels.iter().filter(|(_, kind, _, l)| *kind == Kind::Dark && l.frames > 1);
    let of = darks.map(|(.., l)| l.square_dn4 - l.var_dn2 * l.var_dn2).filter(|v| v.is_finite());
    let median = crate::statistics::median::median(of);
    if median.is_finite() { median.max(0.0) } else { 0.0 }
}

/// Unknown share of the correction for unequal light: the shape of the light may differ from that of the
/// level.
const LIGHT_SHAPE_ERROR: f64 = 0.1;

/// Unequal light of the frames of a set. In a shaded field a frame with the relative excess e of light
/// differs from the others by e times the field, and subtracting the frame's mean removes the even part only.
/// The remainder has the variance of e times that of the field.
struct Light {
    /// Variance of the means of dark frames, DN^2: the black level moves the field as a whole.
    of_darks_dn2: f64,
    /// Spatial variance of the darks, DN^2.
    pattern_dn2: f64,
}

impl Light {
    fn of(measured: &Measured, zero: &Zero) -> Self {
        let darks = measured.levels.iter().filter(|(_, kind, ..)| *kind == Kind::Dark);
        let of = |value: &dyn Fn(&Level) -> f64| {
            let all = darks.clone().map(|(.., l)| value(l)).filter(|v| v.is_finite());
            let median = crate::statistics::median::median(all);
            if median.is_finite() && zero.dn.is_finite() { median } else { 0.0 }
        };
        Self { of_darks_dn2: of(&|l| l.frame_mean_var_dn2), pattern_dn2: of(&|l| l.spatial_var_dn2) }
    }

    /// Variance that unequal light of the frames leaves in a level, DN^2.
    fn var_dn2(&self, level: &Level, mean_dn: f64) -> f64 {
        let by_noise = level.var_dn2 / level.pixels.max(1) as f64;
        self.of_scatter(level, level.frame_mean_var_dn2 - by_noise, mean_dn)
    }

    /// As `var_dn2`, for frames whose means have the variance `moved_dn2`, DN^2.
    fn of_scatter(&self, level: &Level, moved_dn2: f64, mean_dn: f64) -> f64 {
        let field = (level.spatial_var_dn2 - self.pattern_dn2).max(0.0);
        let light = (moved_dn2 - self.of_darks_dn2).max(0.0);
        let of = light * field / (mean_dn * mean_dn);
        if of.is_finite() && mean_dn > 0.0 { of.min(level.var_dn2) } else { 0.0 }
    }
}

/// Excludes darks whose variance grows with the exposure while their level does not: the camera subtracts the
/// dark charge from the level, and its shot noise stays. Their position on the line is unknown. Flats of such
/// exposures have that noise too; it is subtracted as measured in the darks.
fn exclude_clamped_darks(measured: &Measured, points: &mut [Point]) {
    let of = |kind: Kind| {
        let all = measured.levels.iter().enumerate().filter(move |(_, l)| l.1 == kind);
        all.map(|(i, (_, _, exposure_s, _))| (i, *exposure_s))
    };
    let usable = |i: &usize| points[*i].excluded.is_none();
    let shortest = of(Kind::Dark).filter(|d| usable(&d.0)).min_by(|a, b| a.1.total_cmp(&b.1));
    let Some((first, shortest_s)) = shortest else { return };
    let (own, base) = (|i: usize| points[i].mean_dn - points[first].mean_dn, points[first].var_dn2);
    let above = |i: usize| points[i].var_dn2 - base;
    let gains = of(Kind::Flat).filter(|f| usable(&f.0) && own(f.0) > 0.0).map(|f| above(f.0) / own(f.0));
    let gain = crate::statistics::median::median(gains);
    if gain.is_nan() || gain <= 0.0 {
        return;
    }
    let clamped = |i: usize| {
        let p = &points[i];
        let error = (2.0 / ((p.frames - 1.0) * (p.pixels - 1.0))).sqrt() * (p.var_dn2 + base);
        let more = above(i) - 2.0 * gain * own(i).max(0.0);
        more > 5.0 * error && more > MIN_CLAMPED_EXCESS * base
    };
    let found: Vec<usize> =
        of(Kind::Dark).filter(|d| usable(&d.0) && d.1 > shortest_s && clamped(d.0)).map(|d| d.0).collect();
    // The noise without a level is a line over the exposure.
    let charge = |(i, exposure_s): (usize, f64)| {
        let p = &points[i];
        let square = 2.0 / ((p.frames - 1.0) * (p.pixels - 1.0)) * p.var_dn2.powi(2);
        (exposure_s, p.var_dn2 - gain * own(i).max(0.0), square)
    };
    let line = fit(of(Kind::Dark).filter(|d| usable(&d.0)).map(charge));
    let line = line.filter(|l| !found.is_empty() && l.chi2 < MAX_CHI2_OF_CHARGE * l.dof.max(1) as f64);
    for i in found {
        points[i].excluded = Some(format!(
            "a black-level clamp: {:+.1} DN of level for {:+.1} DN^2 of noise beyond the shortest dark's{}",
            own_of(points, i, first),
            points[i].var_dn2 - base,
            if line.is_some() { TAKEN_OFF } else { "" }
        ));
    }
    let Some(line) = line else { return };
    for (point, (_, _, exposure_s, _)) in points.iter_mut().zip(&measured.levels) {
        let taken_dn2 = line.slope * exposure_s;
        if point.excluded.is_none() && taken_dn2 < point.var_dn2 {
            point.var_dn2 -= taken_dn2;
            point.pairs.iter_mut().for_each(|pair| pair.1 -= taken_dn2);
            point.var_unsure_dn2 = point.var_unsure_dn2.hypot(line.var_slope.sqrt() * exposure_s);
        }
    }
}

fn own_of(points: &[Point], i: usize, first: usize) -> f64 {
    points[i].mean_dn - points[first].mean_dn
}

/// Message for a dark whose noise is subtracted from the flats.
pub(super) const TAKEN_OFF: &str = ", which is taken off flats of its exposure";
/// Maximum chi-square of a line per degree of freedom: pixels differ in noise, which the error of a variance
/// ignores (a named choice).
const MAX_CHI2_OF_CHARGE: f64 = 20.0;
/// Minimum excess of a dark's variance, over that of the shortest, for a clamp (a named choice: what matters
/// to a user).
const MIN_CLAMPED_EXCESS: f64 = 0.1;
/// Maximum p-value of the scatter of the darks' levels at which the black level moved.
const MOVED_P: f64 = 1e-4;
/// Minimum range of the darks' levels that is reported, DN.
const MIN_MOVED_DN: f64 = 0.2;

/// Converts the rows of a table to points. Each row counts as one pair of frames.
pub fn table_points(table: &Table) -> Vec<Point> {
    let row = |(i, level): (usize, &crate::dataset::table::Level)| Point {
        set: i as u32,
        kind: Kind::Flat,
        mean_dn: level.mean_dn,
        var_dn2: level.var_dn2,
        frames: 2.0,
        pixels: level.pixels.unwrap_or(f64::NAN),
        spatial_var_dn2: 0.0,
        noise_spread_dn4: 0.0,
        var_unsure_dn2: 0.0,
        var_common_dn2: 0.0,
        mean_unsure_dn: 0.0,
        pairs: vec![(level.mean_dn, level.var_dn2)],
        excluded: None,
    };
    let mut points: Vec<Point> = table.levels.iter().enumerate().map(row).collect();
    for (i, first) in table.copies() {
        points[i].excluded = Some(format!("a copy of row {first}"));
    }
    points
}

/// Source of the pixel counts of a table's rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Counts {
    /// Every row has its own count.
    Given,
    /// Count estimated from the rows' own scatter.
    FromScatter(f64),
    /// Too few rows to estimate a scatter: weights, but no errors.
    Unknown,
}

/// Gives rows without a pixel count the count estimated from their scatter about a smooth curve.
pub(crate) fn pixels_from_scatter(points: &mut [Point]) -> Counts {
    if points.iter().all(|p| p.pixels.is_finite()) {
        return Counts::Given;
    }
    let mut order: Vec<usize> = (0..points.len()).filter(|&i| points[i].excluded.is_none()).collect();
    order.sort_by(|&a, &b| points[a].mean_dn.total_cmp(&points[b].mean_dn));
    // Relative deviation of each point from the line through its neighbours, over the error by all three
    // points.
    let mut off: Vec<f64> = order
        .windows(3)
        .filter_map(|w| {
            let [a, b, c] = [&points[w[0]], &points[w[1]], &points[w[2]]];
            let t = (b.mean_dn - a.mean_dn) / (c.mean_dn - a.mean_dn);
            let expected = a.var_dn2 * (1.0 - t) + c.var_dn2 * t;
            let size = (1.0 + t * t + (1.0 - t) * (1.0 - t)).sqrt();
            (t.is_finite() && b.var_dn2 > 0.0).then(|| ((b.var_dn2 - expected) / (b.var_dn2 * size)).abs())
        })
        .collect();
    off.sort_by(f64::total_cmp);
    let counts = if off.len() >= 4 {
        // The median of |normal| is 0.6745 of the standard deviation; relative variance of s^2 is 2 / M.
        let relative = (off[off.len() / 2] / 0.6745).max(1e-6);
        Counts::FromScatter(2.0 / (relative * relative) + 1.0)
    } else {
        Counts::Unknown
    };
    let pixels = if let Counts::FromScatter(pixels) = counts { pixels } else { 1e4 };
    for p in points.iter_mut().filter(|p| !p.pixels.is_finite()) {
        p.pixels = pixels;
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Simulated sets of 2, 5 and 16 frames, each of which carries 3 or 20 % of the one before: the variance
    /// agrees within five standard errors of 40,000 sets.
    #[test]
    fn frames_that_carry_the_one_before_have_this_variance() {
        use radcam_sim::rng::{PixelRng, Stream};
        for (share, frames) in [(0.03, 2u64), (0.2, 2), (0.03, 5), (0.2, 5), (0.2, 16)] {
            let sets = 40_000;
            let variances: Vec<f64> = (0..sets)
                .map(|set| {
                    let mut random = PixelRng::new(7, Stream::Effect, frames, set, 0);
                    let mut y = 0.0;
                    // The memory of the start is gone after 30 frames.
                    let mut next = || {
                        y = (1.0 - share) * random.normal() + share * y;
                        y
                    };
                    (0..30).for_each(|_| {
                        next();
                    });
                    let values: Vec<f64> = (0..frames).map(|_| next()).collect();
                    let mean = values.iter().sum::<f64>() / frames as f64;
                    values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (frames as f64 - 1.0)
                })
                .collect();
            let n = f64::from(sets);
            let mean = variances.iter().sum::<f64>() / n;
            let square = variances.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
            let expected = kept_variance(share, frames);
            assert!(
                (mean - expected).abs() < 5.0 * (square / n).sqrt(),
                "{share} {frames}: {mean}, {expected}"
            );
        }
    }
}
