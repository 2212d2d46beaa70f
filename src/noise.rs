//! Section IV of the paper: gain A and constant noise sigma_C^2 from the growth of variance with the mean.
//!
//! sigma^2 = A mu + sigma_C^2 (eq. 41) holds for mu counted from the level of zero charge. The paper's camera has
//! no black level; others have, and it would enter the intercept as A times the black level. So the zero is
//! taken from the darks, extrapolated to no exposure ([`Zero`]).
//!
//! Three estimators:
//!
//! - [`Method::Paper`]: pairs of flats, eq. (36) to (42), weights from eq. (40), that is from the noisy variance
//!   itself. A level whose variance came out low weighs more: A and chi-square are biased.
//! - [`Method::Reweighted`]: all frames of every level, darks included, weights from the fitted line, iterated.
//!   The weights also hold the fourth cumulant of Poisson and quantisation noise and the spread of variance
//!   over a field that is not flat.
//! - [`Method::Likelihood`]: the chi-square likelihood of the levels' variances. Its score equation is the one
//!   that the reweighted fit iterates (a gamma model with identity link: McCullagh and Nelder, "Generalized
//!   Linear Models", 1989, section 8.3), so that both give the same line; its goodness of fit is the deviance,
//!   and its errors come from the observed curvature.

use crate::dataset::table::Table;
use crate::dataset::{Dataset, DatasetError, Kind};
use crate::fit::line::{Line, fit, goodness};
use crate::statistics::level::{Level, LevelAccumulator};
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};

/// How A and sigma_C^2 are estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// As in the paper.
    Paper,
    /// Weights from the fitted line.
    Reweighted,
    /// Chi-square likelihood.
    Likelihood,
}

/// A value with its standard error and unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantity {
    /// The value.
    #[serde(serialize_with = "finite")]
    pub value: f64,
    /// Its standard error.
    #[serde(serialize_with = "finite")]
    pub std_err: f64,
    /// Unit of both.
    pub unit: &'static str,
}

/// JSON has no NaN: it becomes null.
fn finite<S: serde::Serializer>(x: &f64, s: S) -> Result<S::Ok, S::Error> {
    if x.is_finite() { s.serialize_f64(*x) } else { s.serialize_none() }
}

/// One point of the photon-transfer plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Number of the set, or of the row of a table.
    pub set: u32,
    /// Dark or flat.
    pub kind: Kind,
    /// Mean above the level of zero charge, DN.
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

/// The level of zero charge.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Zero {
    /// DN.
    #[serde(serialize_with = "finite")]
    pub dn: f64,
    /// Standard error, DN.
    #[serde(serialize_with = "finite")]
    pub std_err_dn: f64,
    /// Where it comes from.
    pub source: &'static str,
}

/// A and sigma_C^2 by one method.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Estimate {
    /// Which method.
    pub method: Method,
    /// A, DN per electron.
    pub gain_dn_per_e: Quantity,
    /// sigma_C^2, DN^2.
    pub constant_noise_var_dn2: Quantity,
    /// Covariance of the two.
    #[serde(serialize_with = "finite")]
    pub covariance: f64,
    /// Chi-square (deviance for the likelihood).
    #[serde(serialize_with = "finite")]
    pub chi2: f64,
    /// Its degrees of freedom.
    pub dof: usize,
    /// Chance of a larger chi-square.
    #[serde(serialize_with = "finite")]
    pub q: f64,
}

/// One level as the report shows it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LevelReport {
    /// Number of the set.
    pub set: u32,
    /// Dark or flat.
    pub kind: Kind,
    /// Mean above the level of zero charge, DN.
    pub mean_dn: f64,
    /// Temporal variance, DN^2.
    pub var_dn2: f64,
    /// Standard error of the variance at the fitted line, DN^2.
    #[serde(serialize_with = "finite")]
    pub var_std_err_dn2: f64,
    /// Residual over its standard error.
    #[serde(serialize_with = "finite")]
    pub z: f64,
    /// Whether it took part in the fit.
    pub used: bool,
    /// Why not.
    pub excluded_because: Option<String>,
}

/// The whole answer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NoiseReport {
    /// A by the reweighted estimator.
    pub gain_dn_per_e: Quantity,
    /// sigma_C^2 by the reweighted estimator.
    pub constant_noise_var_dn2: Quantity,
    /// Read noise with quantisation taken off, electrons: sqrt(sigma_C^2 - q^2/12) / A (eq. 27).
    pub read_noise_e: Quantity,
    /// The level of zero charge.
    pub offset_dn: Quantity,
    /// Where the zero comes from.
    pub offset_source: &'static str,
    /// Chi-square of the reweighted fit.
    #[serde(serialize_with = "finite")]
    pub chi2: f64,
    /// Its degrees of freedom.
    pub dof: usize,
    /// Chance of a larger chi-square.
    #[serde(serialize_with = "finite")]
    pub q: f64,
    /// Every estimator that the data allow.
    pub estimators: Vec<Estimate>,
    /// Every level.
    pub levels: Vec<LevelReport>,
    /// What a reader should know.
    pub notes: Vec<String>,
}

/// Below this chance the line does not describe the levels.
pub const Q_LIMIT: f64 = 1e-3;

impl NoiseReport {
    /// Whether the levels lie on the line. With no degrees of freedom nothing speaks against it.
    pub fn consistent(&self) -> bool {
        self.q.is_nan() || self.q >= Q_LIMIT
    }
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum NoiseError {
    /// The dataset.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Too few levels are left.
    #[error(
        "the line needs two levels, one of them lit, and {usable} of {of} can be used, {lit} of them lit{}",
        why.first().map(|w| format!(" ({w})")).unwrap_or_default()
    )]
    TooFewLevels {
        /// Levels left.
        usable: usize,
        /// Flats among them.
        lit: usize,
        /// Levels measured.
        of: usize,
        /// Why the others fell out.
        why: Vec<String>,
    },
    /// The user asked for the end.
    #[error("interrupted")]
    Interrupted,
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
}

/// Reads every dark and flat. `progress` is told (sets done, sets).
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
    let mut level = LevelAccumulator::new((camera.height, camera.width), camera.bit_depth);
    for (done, set) in wanted.iter().enumerate() {
        let settings = dataset.settings(set);
        level.reset();
        // Eight frames at a time: one trip through memory, and no more of it for a long set.
        for rows in set.rows.chunks(8) {
            if stop.load(Ordering::Relaxed) {
                return Err(NoiseError::Interrupted);
            }
            let frames: Vec<_> =
                rows.iter().map(|&i| dataset.read(&dataset.rows()[i])).collect::<Result<_, _>>()?;
            let slices: Vec<&[u16]> = frames.iter().filter_map(|f| f.as_slice()).collect();
            // Sizes were held against the manifest when the frames were read.
            let _ = level.add(&slices);
        }
        if let Some(level) = level.finish() {
            levels.push((set.number, settings.kind, settings.exposure_s, level));
        }
        progress(done + 1, wanted.len());
    }
    Ok(Measured {
        levels,
        full_scale_dn: camera.full_scale_dn().into(),
        black_level_dn: camera.black_level_dn,
    })
}

/// Share of clipped samples from which a level's variance is off by more than its error.
const CLIPPED: f64 = 1e-4;

fn clipped_because(level: &Level) -> Option<String> {
    let percent = |share: f64| format!("{:.2} %", 100.0 * share);
    if level.saturated > CLIPPED {
        Some(format!("{} of the samples are at full scale", percent(level.saturated)))
    } else if level.stuck > 0.5 {
        Some("most pixels are clipped in every frame".into())
    } else if level.black > CLIPPED {
        Some(format!("{} of the samples are clipped at black", percent(level.black)))
    } else {
        None
    }
}

/// The level of zero charge from the darks: their means extrapolated to no exposure.
pub fn zero(measured: &Measured) -> Zero {
    let darks: Vec<_> = measured
        .levels
        .iter()
        .filter(|(_, kind, _, level)| *kind == Kind::Dark && clipped_because(level).is_none())
        .collect();
    // Scatter of the frames' means, whatever makes it (read noise, row noise, a wandering black level).
    let n = darks.len() as f64;
    let scatter = darks.iter().map(|(.., l)| l.frame_mean_var_dn2).sum::<f64>() / n;
    let variance = |l: &Level| (scatter / l.frames as f64).max(l.var_dn2 / (l.frames * l.pixels) as f64);
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
        return Zero { dn: sum / weight, std_err_dn: weight.sqrt().recip(), source: "darks of one exposure" };
    }
    match measured.black_level_dn {
        Some(dn) => Zero { dn, std_err_dn: f64::NAN, source: "black_level_dn of dataset.toml" },
        None => Zero { dn: 0.0, std_err_dn: f64::NAN, source: "none: no usable darks, taken as 0 DN" },
    }
}

/// Sets counted from the zero, with the reasons for those that are clipped or quantised too coarsely.
pub fn points(measured: &Measured, zero: &Zero) -> Vec<Point> {
    measured
        .levels
        .iter()
        .map(|(set, kind, _, level)| {
            let coarse = (level.var_dn2 < 0.25).then(|| {
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

/// Variance of a level's variance at the fitted line.
///
/// For independent pixels with variances sigma_p^2 and fourth cumulants k_p, the residual mean square over n
/// frames and M pixels has variance 2 mean(sigma_p^4) / ((n - 1) (M - 1)) + mean(k_p) / (n M) (Kendall and Stuart,
/// vol. 1, chapter 12, for one pixel). Over a field whose means have the variance V, mean(sigma_p^4) = sigma^4 + A^2 V.
/// A Poisson number of mean lambda has the fourth cumulant lambda, so the charge gives A^4 lambda = A^3 mu;
/// quantisation gives -q^4 / 120.
fn variance_of_variance(p: &Point, gain: f64, constant: f64) -> f64 {
    let mean = p.mean_dn.max(0.0);
    let sigma2 = (gain * mean + constant).max(1e-12);
    let fourth = gain.powi(3) * mean - 1.0 / 120.0;
    let spread = sigma2 * sigma2 + gain * gain * p.spatial_var_dn2;
    let variance = 2.0 * spread / ((p.frames - 1.0) * (p.pixels - 1.0)) + fourth / (p.frames * p.pixels);
    // A cumulant that eats the variance up means a model far from the data; the normal value then.
    if variance > 0.0 { variance } else { 2.0 * spread / ((p.frames - 1.0) * (p.pixels - 1.0)) }
}

/// Eq. (42) with the weights of eq. (40).
fn paper(points: &[Point]) -> Option<Line> {
    let used = points.iter().filter(|p| p.excluded.is_none() && p.kind == Kind::Flat);
    let pairs: Vec<_> = used
        .flat_map(|p| p.pairs.iter().map(|&(mean, var)| (mean, var, 2.0 * var * var / (p.pixels - 1.0))))
        .collect();
    fit(pairs.into_iter())
}

fn reweighted(points: &[Point]) -> Option<Line> {
    let used: Vec<_> = points.iter().filter(|p| p.excluded.is_none()).collect();
    let normal = |p: &Point| 2.0 * p.var_dn2 * p.var_dn2 / ((p.frames - 1.0) * (p.pixels - 1.0));
    let mut line = fit(used.iter().map(|p| (p.mean_dn, p.var_dn2, normal(p))))?;
    for _ in 0..50 {
        let next = fit(used
            .iter()
            .map(|p| (p.mean_dn, p.var_dn2, variance_of_variance(p, line.slope, line.intercept))))?;
        let step = ((next.slope - line.slope) / next.slope).abs()
            + (next.intercept - line.intercept).abs() / next.var_intercept.sqrt();
        line = next;
        if step < 1e-10 {
            break;
        }
    }
    Some(line)
}

/// Newton's method on the chi-square likelihood, from the paper's weights, with the levels' effective degrees of
/// freedom 2 sigma^4 / var(s^2) at `start`.
fn likelihood(points: &[Point], start: &Line) -> Option<Line> {
    let used: Vec<(f64, f64, f64)> = points
        .iter()
        .filter(|p| p.excluded.is_none())
        .map(|p| {
            let dof =
                2.0 * start.at(p.mean_dn).powi(2) / variance_of_variance(p, start.slope, start.intercept);
            (p.mean_dn, p.var_dn2, dof)
        })
        .collect();
    let (mut a, mut c) = (start.slope, start.intercept);
    let mut curvature = (0.0, 0.0, 0.0);
    for _ in 0..50 {
        let (mut ga, mut gc) = (0.0, 0.0);
        curvature = (0.0, 0.0, 0.0);
        for &(x, s2, dof) in &used {
            let m = a * x + c;
            if m <= 0.0 {
                return None;
            }
            let g = 0.5 * dof * (s2 - m) / (m * m);
            let h = 0.5 * dof * (2.0 * s2 - m) / (m * m * m);
            ga += g * x;
            gc += g;
            curvature.0 += h * x * x;
            curvature.1 += h * x;
            curvature.2 += h;
        }
        let (haa, hac, hcc) = curvature;
        let det = haa * hcc - hac * hac;
        if det <= 0.0 {
            return None;
        }
        let (da, dc) = ((hcc * ga - hac * gc) / det, (haa * gc - hac * ga) / det);
        a += da;
        c += dc;
        if (da / a).abs() < 1e-13 && dc.abs() < 1e-13 * (c.abs() + 1e-12) {
            break;
        }
    }
    let (haa, hac, hcc) = curvature;
    let det = haa * hcc - hac * hac;
    let deviance = used
        .iter()
        .map(|&(x, s2, dof)| {
            let ratio = s2 / (a * x + c);
            dof * (ratio - 1.0 - ratio.ln())
        })
        .sum();
    Some(Line {
        slope: a,
        intercept: c,
        var_slope: hcc / det,
        var_intercept: haa / det,
        covariance: -hac / det,
        chi2: deviance,
        dof: used.len() - 2,
    })
}

fn estimate_of(method: Method, line: &Line, zero: &Zero) -> Estimate {
    // An error of the zero moves every mean together, and so the intercept by A times it.
    let shift = if zero.std_err_dn.is_finite() { line.slope * zero.std_err_dn } else { 0.0 };
    let quantity = |value, variance: f64, unit| Quantity { value, std_err: variance.sqrt(), unit };
    Estimate {
        method,
        gain_dn_per_e: quantity(line.slope, line.var_slope, "DN/e"),
        constant_noise_var_dn2: quantity(line.intercept, line.var_intercept + shift * shift, "DN^2"),
        covariance: line.covariance,
        chi2: line.chi2,
        dof: line.dof,
        q: goodness(line.chi2, line.dof as f64),
    }
}

/// Marks levels beyond the variance's peak: there the wells are full, and what varies is not the light.
fn exclude_past_the_peak(points: &mut [Point]) {
    let error = |p: &Point| (2.0 / ((p.frames - 1.0) * (p.pixels - 1.0))).sqrt() * p.var_dn2;
    let usable = points.iter().filter(|p| p.excluded.is_none());
    let Some(peak) = usable.max_by(|a, b| a.var_dn2.total_cmp(&b.var_dn2)).cloned() else { return };
    // From the peak on, everything from the first significant fall.
    let fallen = |p: &Point| {
        let drop = peak.var_dn2 - p.var_dn2;
        let noise = (error(p).powi(2) + error(&peak).powi(2)).sqrt();
        p.mean_dn > peak.mean_dn && drop > 5.0 * noise && drop > 0.01 * peak.var_dn2
    };
    let first = points.iter().filter(|p| fallen(p)).map(|p| p.mean_dn).fold(f64::INFINITY, f64::min);
    for p in points.iter_mut().filter(|p| p.excluded.is_none() && p.mean_dn >= first) {
        p.excluded = Some(format!(
            "past the variance's peak at {:.0} DN: the wells or the amplifier are full",
            peak.mean_dn
        ));
    }
}

/// Marks single levels that stand off a line on which the others lie; a curve is left as it is.
fn exclude_strays(points: &mut [Point]) {
    let most = points.iter().filter(|p| p.excluded.is_none()).count() / 5;
    for _ in 0..most {
        let used: Vec<usize> = (0..points.len()).filter(|&i| points[i].excluded.is_none()).collect();
        if used.len() < 5 {
            return;
        }
        // Each level against the line of the others.
        let z: Vec<f64> = used
            .iter()
            .map(|&i| {
                let mut others = points.to_vec();
                others[i].excluded = Some(String::new());
                reweighted(&others).map_or(0.0, |line| {
                    let p = &points[i];
                    let at = line.var_slope * p.mean_dn.powi(2)
                        + line.var_intercept
                        + 2.0 * line.covariance * p.mean_dn;
                    let variance = variance_of_variance(p, line.slope, line.intercept) + at;
                    (p.var_dn2 - line.at(p.mean_dn)) / variance.sqrt()
                })
            })
            .collect();
        let mut sizes: Vec<f64> = z.iter().map(|z| z.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let median = sizes[sizes.len() / 2];
        let Some(worst) = (0..z.len()).max_by(|&a, &b| z[a].abs().total_cmp(&z[b].abs())) else { return };
        if z[worst].abs() < 6.0 || z[worst].abs() < 5.0 * median {
            return;
        }
        points[used[worst]].excluded =
            Some(format!("{:+.0} standard errors off the line of the others", z[worst]));
    }
}

/// Gives rows without a pixel count the one that their own scatter about a smooth curve asks for. Returns it.
fn pixels_from_scatter(points: &mut [Point]) -> Option<f64> {
    if points.iter().all(|p| p.pixels.is_finite()) {
        return None;
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
    // The median of |normal| is 0.6745 of the standard deviation; relative variance of s^2 is 2 / M.
    let relative = off.get(off.len() / 2).map_or(0.01, |m| m / 0.6745).max(1e-6);
    let pixels = 2.0 / (relative * relative) + 1.0;
    for p in points.iter_mut().filter(|p| !p.pixels.is_finite()) {
        p.pixels = pixels;
    }
    Some(pixels)
}

/// Fits the line to points and reports.
///
/// ```
/// use radcam::dataset::table::{Level, Table};
/// use radcam::noise;
/// let level = |mean_dn: f64| Level {
///     mean_dn, var_dn2: 0.5 * mean_dn + 4.0, pixels: Some(1e6), exposure_s: None, illumination: None,
///     cov_01: None, cov_10: None, cov_11: None,
/// };
/// let table = Table { levels: [10.0, 100.0, 500.0, 900.0].map(level).into() };
/// let report = noise::of_table(&table)?;
/// assert!((report.gain_dn_per_e.value - 0.5).abs() < 1e-9);
/// # Ok::<(), noise::NoiseError>(())
/// ```
pub fn estimate(mut points: Vec<Point>, zero: &Zero) -> Result<NoiseReport, NoiseError> {
    let mut notes = Vec::new();
    if let Some(pixels) = pixels_from_scatter(&mut points) {
        notes.push(format!(
            "no pixel count: errors come from the rows' own scatter, as of {pixels:.0} pixels a row"
        ));
    }
    exclude_past_the_peak(&mut points);
    exclude_strays(&mut points);
    let is_lit = |p: &&Point| p.excluded.is_none() && p.kind == Kind::Flat;
    let lit = points.iter().filter(is_lit).count();
    let Some(line) = reweighted(&points).filter(|_| lit > 0) else {
        let why = points.iter().filter_map(|p| p.excluded.as_ref().map(|e| format!("set {}: {e}", p.set)));
        return Err(NoiseError::TooFewLevels {
            usable: points.iter().filter(|p| p.excluded.is_none()).count(),
            lit,
            of: points.len(),
            why: why.collect(),
        });
    };
    let mut estimators = Vec::new();
    if let Some(line) = paper(&points) {
        estimators.push(estimate_of(Method::Paper, &line, zero));
    }
    let best = estimate_of(Method::Reweighted, &line, zero);
    estimators.push(best.clone());
    if let Some(line) = likelihood(&points, &line) {
        estimators.push(estimate_of(Method::Likelihood, &line, zero));
    }

    if !zero.std_err_dn.is_finite() && zero.source != TABLE_ZERO {
        notes.push(format!(
            "level of zero charge: {}. If it is wrong by d DN, the constant noise is wrong by A d",
            zero.source
        ));
    }
    if best.q < Q_LIMIT {
        notes.push(
            "the levels do not lie on a line: the model lacks something, and the errors above do not hold"
                .into(),
        );
    }
    let levels = points
        .iter()
        .map(|p| {
            let std_err = variance_of_variance(p, line.slope, line.intercept).sqrt();
            LevelReport {
                set: p.set,
                kind: p.kind,
                mean_dn: p.mean_dn,
                var_dn2: p.var_dn2,
                var_std_err_dn2: std_err,
                z: (p.var_dn2 - line.at(p.mean_dn)) / std_err,
                used: p.excluded.is_none(),
                excluded_because: p.excluded.clone(),
            }
        })
        .collect();
    Ok(NoiseReport {
        read_noise_e: read_noise(&best),
        gain_dn_per_e: best.gain_dn_per_e,
        constant_noise_var_dn2: best.constant_noise_var_dn2,
        offset_dn: Quantity { value: zero.dn, std_err: zero.std_err_dn, unit: "DN" },
        offset_source: zero.source,
        chi2: best.chi2,
        dof: best.dof,
        q: best.q,
        estimators,
        levels,
        notes,
    })
}

/// sigma_R = sqrt(sigma_C^2 - 1/12) / A (eq. 27), its error by first order in both.
fn read_noise(e: &Estimate) -> Quantity {
    let (a, c) = (e.gain_dn_per_e, e.constant_noise_var_dn2);
    let dn2 = c.value - 1.0 / 12.0;
    let value = dn2.max(0.0).sqrt() / a.value;
    let (by_c, by_a) = (0.5 / (dn2.sqrt() * a.value), -value / a.value);
    let variance = (by_c * c.std_err).powi(2) + (by_a * a.std_err).powi(2) + 2.0 * by_c * by_a * e.covariance;
    Quantity { value, std_err: variance.sqrt(), unit: "e" }
}

const TABLE_ZERO: &str = "table: black level removed";

/// Section IV on a dataset of frames.
pub fn of_dataset(
    dataset: &Dataset,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<NoiseReport, NoiseError> {
    let measured = measure(dataset, stop, progress)?;
    let zero = zero(&measured);
    estimate(points(&measured, &zero), &zero)
}

/// Section IV on a table of statistics.
pub fn of_table(table: &Table) -> Result<NoiseReport, NoiseError> {
    estimate(table_points(table), &Zero { dn: 0.0, std_err_dn: f64::NAN, source: TABLE_ZERO })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use radcam_sim::rng::{PixelRng, Stream};

    fn point(set: u32, mean_dn: f64, var_dn2: f64, pixels: f64) -> Point {
        Point {
            set,
            kind: Kind::Flat,
            mean_dn,
            var_dn2,
            frames: 2.0,
            pixels,
            spatial_var_dn2: 0.0,
            pairs: vec![(mean_dn, var_dn2)],
            excluded: None,
        }
    }

    const TABLE: Zero = Zero { dn: 0.0, std_err_dn: f64::NAN, source: TABLE_ZERO };

    /// Levels on a line with normal scatter of the right size.
    fn scattered(seed: u32, levels: usize, pixels: f64) -> Vec<Point> {
        (0..levels)
            .map(|i| {
                let mean = 20.0 + 200.0 * i as f64 / levels as f64;
                let var = 0.4 * mean + 3.0;
                let z = PixelRng::new(31, Stream::Frame, i as u64, seed, 0).normal();
                point(i as u32, mean, var * (1.0 + z * (2.0 / pixels).sqrt()), pixels)
            })
            .collect()
    }

    #[test]
    fn likelihood_and_reweighted_solve_the_same_equation() {
        for seed in 0..20 {
            let report = estimate(scattered(seed, 9, 3000.0), &TABLE).unwrap();
            let [_, r, l] = &report.estimators[..] else { panic!("{:?}", report.estimators) };
            assert!((r.gain_dn_per_e.value / l.gain_dn_per_e.value - 1.0).abs() < 1e-6);
            assert!((r.chi2 - l.chi2).abs() < 0.2 * (1.0 + r.chi2), "{} {}", r.chi2, l.chi2);
        }
    }

    #[test]
    fn a_stray_level_and_full_wells_are_shown_with_the_reason() {
        let mut points = scattered(1, 12, 10_000.0);
        points[5].var_dn2 *= 1.5;
        for (i, var) in [(12, 70.0), (13, 30.0)] {
            points.push(point(i, 230.0 + f64::from(i), var, 10_000.0));
        }
        let report = estimate(points, &TABLE).unwrap();
        let because = |i: usize| report.levels[i].excluded_because.clone().unwrap_or_default();
        assert!(because(5).contains("off the line"), "{}", because(5));
        assert!(because(12).contains("peak") && because(13).contains("peak"));
        assert_eq!(report.levels.iter().filter(|l| !l.used).count(), 3);
        assert!(report.consistent(), "{}", report.q);
    }

    /// A bend is not cured by throwing levels away.
    #[test]
    fn a_curve_is_left_as_it_is() {
        let points = (1..=15).map(|i| {
            let mean = 100.0 * f64::from(i);
            point(i as u32, mean, 0.4 * mean * (1.0 - 1e-4 * mean) + 3.0, 100_000.0)
        });
        let report = estimate(points.collect(), &TABLE).unwrap();
        assert!(report.levels.iter().all(|l| l.used));
        assert!(!report.consistent() && report.notes[0].contains("do not lie on a line"));
    }

    /// The bias that the other estimators cure: weights from the noisy variance prefer what came out low.
    /// With 200 pixels the paper's A is about 1 % low; 400 campaigns tell that to 0.3 %.
    #[test]
    fn the_papers_weights_are_biased_and_the_lines_are_not() {
        let n = 400;
        let (mut paper, mut line, mut line2) = (0.0, 0.0, 0.0);
        for seed in 0..n {
            let report = estimate(scattered(1000 + seed, 6, 200.0), &TABLE).unwrap();
            let gain = |i: usize| report.estimators[i].gain_dn_per_e.value / 0.4 - 1.0;
            paper += gain(0);
            line += gain(1);
            line2 += gain(1) * gain(1);
        }
        let n = f64::from(n);
        let error = (line2 / n).sqrt() / n.sqrt();
        assert!((line / n).abs() < 4.0 * error, "reweighted {} +- {error}", line / n);
        assert!(paper / n < -2.0 * error, "paper {} +- {error}", paper / n);
    }

    proptest! {
        #[test]
        fn no_levels_make_it_panic(
            rows in prop::collection::vec((-10f64..1e5, 0f64..1e5, prop::option::of(2f64..1e6)), 0..12)
        ) {
            let points: Vec<_> = rows
                .iter()
                .enumerate()
                .map(|(i, &(m, v, p))| point(i as u32, m, v, p.unwrap_or(f64::NAN)))
                .collect();
            if let Ok(report) = estimate(points, &TABLE) {
                prop_assert_eq!(report.levels.len(), rows.len());
                serde_json::to_string(&report).unwrap();
            }
        }
    }
}
