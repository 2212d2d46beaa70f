//! The levels: from the frames of a dataset, or the rows of a table, to points of the photon-transfer plot.

use super::NoiseError;
use crate::dataset::table::Table;
use crate::dataset::{Dataset, Kind, Set};
use crate::fit::line::fit;
use crate::number::finite;
use crate::reduction::Key;
use crate::statistics::level::{Level, LevelAccumulator};
use serde::Serialize;
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
    /// Frames; 2 for a row of a table.
    pub frames: f64,
    /// Pixels; NaN where not known.
    pub pixels: f64,
    /// Variance of the pixels' true means over the field, DN^2.
    pub spatial_var_dn2: f64,
    /// Pairs of the level as (mean above zero, variance).
    pub pairs: Vec<(f64, f64)>,
    /// Why the level takes no part in the fit.
    pub excluded: Option<String>,
}

/// The black level at zero exposure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Zero {
    /// DN.
    #[serde(with = "finite")]
    pub dn: f64,
    /// Standard error, DN.
    #[serde(with = "finite")]
    pub std_err_dn: f64,
    /// Where it comes from.
    pub source: &'static str,
}

/// What the frames of a dataset say, before any line is fitted.
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
}

/// Reads every dark and flat. `progress` is told (sets done, sets).
///
/// # Errors
///
/// Which frame cannot be read, or that it was stopped.
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
    let mut levels = Vec::new();
    let mut accumulator: Option<LevelAccumulator> = None;
    for (done, set) in wanted.iter().enumerate() {
        let settings = dataset.settings(set);
        if let Some(level) = level_of(dataset, set, &mut accumulator, stop)? {
            levels.push((set.number, settings.kind, settings.exposure_s, level));
        }
        progress(done + 1, wanted.len());
    }
    Ok(Measured {
        levels,
        full_scale_dn: camera.full_scale_dn().into(),
        black_level_dn: camera.black_level_dn,
        code_step_dn: dataset.code_step_dn(),
    })
}

/// Zero between the one dark level and `black_level_dn`.
pub(super) const ONE_EXPOSURE_BOUNDED: &str = "between the darks of one exposure and black_level_dn";
/// Zero from darks of one exposure alone.
pub(super) const ONE_EXPOSURE: &str = "darks of one exposure";
/// Zero that nobody knows.
pub(super) const NO_ZERO: &str = "none: no usable darks, taken as 0 DN";
/// Zero as the camera states it.
pub(super) const BLACK_LEVEL: &str = "black_level_dn of dataset.toml";
/// Variance below which the noise is narrower than half a step, in squared steps.
const COARSE: f64 = 0.25;

/// Share of clipped samples from which a level's variance is off by more than its error.
const CLIPPED: f64 = 1e-4;

/// Why a single frame takes no part.
pub(super) const ONE_FRAME: &str = "one frame: a variance needs two";

fn clipped_because(level: &Level) -> Option<String> {
    let percent = |share: f64| format!("{:.2} %", 100.0 * share);
    if level.pixels < 2 {
        Some("every pixel is clipped in every frame".into())
    } else if level.saturated > CLIPPED {
        Some(format!("{} of the samples are at full scale", percent(level.saturated)))
    } else if level.stuck > 0.5 {
        Some("most pixels are clipped in every frame".into())
    } else if level.black > CLIPPED {
        Some(format!("{} of the samples are clipped at black", percent(level.black)))
    } else if level.frames < 2 {
        Some(ONE_FRAME.into())
    } else {
        None
    }
}

/// Mean and variance of a set of darks or flats; `None` of others. `memory` serves the next set.
///
/// # Errors
///
/// Which frame cannot be read, or that it was stopped.
pub(crate) fn level_of(
    dataset: &Dataset,
    set: &Set,
    memory: &mut Option<LevelAccumulator>,
    stop: &AtomicBool,
) -> Result<Option<Level>, NoiseError> {
    if !matches!(dataset.settings(set).kind, Kind::Dark | Kind::Flat) {
        return Ok(None);
    }
    if let Some(known) = dataset.reduced().and_then(|r| r.level(&Key::first(dataset, set, usize::MAX))) {
        return Ok(known.clone());
    }
    let camera = &dataset.manifest().camera;
    if let Some(level) = memory {
        level.reset();
    }
    // Eight frames at a time: one trip through memory, and no more of it for a long set.
    for rows in set.rows.chunks(8) {
        if stop.load(Ordering::Relaxed) {
            return Err(NoiseError::Interrupted);
        }
        let frames: Vec<_> =
            rows.iter().map(|&i| dataset.read(&dataset.rows()[i])).collect::<Result<_, _>>()?;
        let slices: Vec<&[u16]> = frames.iter().filter_map(|f| f.as_slice()).collect();
        // Memory for what the frames are, not for what a damaged manifest says. Their sizes were checked by it
        // when they were read.
        let shape = (camera.height, camera.width);
        let level = memory.get_or_insert_with(|| LevelAccumulator::new(shape, camera.bit_depth));
        let _ = level.add(&slices);
    }
    Ok(memory.as_ref().and_then(LevelAccumulator::finish))
}

/// The black level at zero exposure from the darks: their means extrapolated to no exposure.
pub fn zero(measured: &Measured) -> Zero {
    let darks: Vec<_> = measured
        .levels
        .iter()
        .filter(|(_, kind, _, level)| *kind == Kind::Dark && clipped_because(level).is_none())
        .collect();
    // Scatter of the frames' means, whatever makes it (read noise, row noise, a wandering black level).
    let n = darks.len() as f64;
    let scatter = darks.iter().map(|(.., l)| l.frame_mean_var_dn2).sum::<f64>() / n;
    let square = measured.code_step_dn.powi(2);
    let variance = |l: &Level| {
        // Codes that do not move hide their mean within the step: q^2/12, and no averaging helps.
        let hidden = if l.var_dn2 < COARSE * square { square / 12.0 } else { 0.0 };
        (scatter / l.frames as f64).max(l.var_dn2 / (l.frames * l.pixels) as f64) + hidden
    };
    let points = darks.iter().map(|(_, _, exposure_s, l)| (*exposure_s, l.mean_dn, variance(l)));
    if let Some(line) = fit(points.clone()) {
        // Means that scatter more than their frames do (temperature) widen the error.
        let inflation = if line.dof > 0 { (line.chi2 / line.dof as f64).max(1.0) } else { 1.0 };
        let std_err_dn = (line.var_intercept * inflation).sqrt();
        return Zero { dn: line.intercept, std_err_dn, source: "darks extrapolated to zero exposure" };
    }
    if let Some((weight, sum)) = points
        .map(|(_, mean, variance)| (1.0 / variance, mean / variance))
        .reduce(|a, b| (a.0 + b.0, a.1 + b.1))
    {
        // Part of this dark mean is dark charge, and one exposure does not tell how much. A known black level bounds
        // it: anything between the two is as likely.
        let dark = sum / weight;
        return match measured.black_level_dn {
            Some(black) => {
                let std_err_dn = ((dark - black).powi(2) / 12.0 + 1.0 / weight).sqrt();
                Zero { dn: 0.5 * (dark + black), std_err_dn, source: ONE_EXPOSURE_BOUNDED }
            }
            None => Zero { dn: dark, std_err_dn: weight.sqrt().recip(), source: ONE_EXPOSURE },
        };
    }
    // A single frame has a mean, and the error that its pixels' scatter leaves.
    let single = measured
        .levels
        .iter()
        .filter(|(_, kind, _, l)| *kind == Kind::Dark && l.frames == 1 && l.pixels > 1 && l.black <= CLIPPED);
    if let Some((.., level)) = single.min_by(|a, b| a.2.total_cmp(&b.2)) {
        let std_err_dn = (level.spatial_var_dn2 / level.pixels as f64).sqrt();
        return Zero { dn: level.mean_dn, std_err_dn, source: "a single dark frame" };
    }
    match measured.black_level_dn {
        Some(dn) => Zero { dn, std_err_dn: f64::NAN, source: BLACK_LEVEL },
        None => Zero { dn: 0.0, std_err_dn: f64::NAN, source: NO_ZERO },
    }
}

/// Sets counted from the zero, with the reasons for those that are clipped or quantised too coarsely.
pub fn points(measured: &Measured, zero: &Zero) -> Vec<Point> {
    measured
        .levels
        .iter()
        .map(|(set, kind, _, level)| {
            let coarse = (level.var_dn2 < COARSE * measured.code_step_dn.powi(2)).then(|| {
                format!(
                    "noise of {:.2} DN is below half a step: quantisation noise is not q^2/12 there",
                    level.var_dn2.sqrt()
                )
            });
            Point {
                set: *set,
                kind: *kind,
                mean_dn: level.mean_dn - zero.dn,
                var_dn2: level.var_dn2,
                frames: level.frames as f64,
                pixels: level.pixels as f64,
                spatial_var_dn2: level.spatial_var_dn2,
                pairs: level.pairs.iter().map(|p| (p.mean_dn - zero.dn, p.var_dn2)).collect(),
                excluded: clipped_because(level).or(coarse),
            }
        })
        .collect()
}

/// Rows of a table as points. Each row counts as one pair of frames.
pub fn table_points(table: &Table) -> Vec<Point> {
    let row = |(i, level): (usize, &crate::dataset::table::Level)| Point {
        set: i as u32,
        kind: Kind::Flat,
        mean_dn: level.mean_dn,
        var_dn2: level.var_dn2,
        frames: 2.0,
        pixels: level.pixels.unwrap_or(f64::NAN),
        spatial_var_dn2: 0.0,
        pairs: vec![(level.mean_dn, level.var_dn2)],
        excluded: None,
    };
    table.levels.iter().enumerate().map(row).collect()
}

/// What stands in for a pixel count that a table does not give.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Counts {
    /// Every row has its own.
    Given,
    /// The count that the rows' own scatter asks for.
    FromScatter(f64),
    /// Too few rows to see a scatter: weights, but no errors.
    Unknown,
}

/// Gives rows without a pixel count the one that their own scatter about a smooth curve asks for.
pub(crate) fn pixels_from_scatter(points: &mut [Point]) -> Counts {
    if points.iter().all(|p| p.pixels.is_finite()) {
        return Counts::Given;
    }
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| points[a].mean_dn.total_cmp(&points[b].mean_dn));
    // Each point against the line through its neighbours, relative, and free of its own weight.
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
