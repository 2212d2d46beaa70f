//! Lines of the standard, with the errors of their slopes: photon transfer, response, dark current,
//! linearity.

use super::points::{Dark, Temporal};
use super::{Definitions, EmvaError, saturation};
use crate::fit::line::goodness;
use crate::number::six_digits;

/// Share of dark samples at 0 DN above which they count as clipped (section 6.5: less than about 0.5 %).
pub(super) const UNDERFLOW: f64 = 0.005;
/// Maximum signal for the fit of gain and responsivity, as a share of saturation (section 6.6).
pub(crate) const FIT_RANGE: f64 = 0.7;
/// Range of the linearity error, as shares of saturation (section 6.9).
pub(crate) const LINEAR_RANGE: (f64, f64) = (0.05, 0.95);
/// Minimum p-value of chi-square; below it the errors come from the scatter about a line, not from the noise
/// of the points.
const BY_CHANCE: f64 = 0.01;

/// Unweighted line y = slope x + offset, from points (x, y, standard error of y); the offset may be fixed at
/// zero. Errors of slope and offset come from those of the points, or from their scatter if it is more than
/// chance.
pub(super) struct Fitted {
    pub slope: f64,
    pub offset: f64,
    /// Abscissa and standard error of each point.
    points: Vec<(f64, f64)>,
    mean_x: f64,
    xx: f64,
    /// 1 / n, or 0 if the offset is fixed at 0.
    share: f64,
    /// Ratio of the scatter to the points' errors, if it is more than chance; otherwise 1.
    scale: f64,
}

impl Fitted {
    /// Standard error of a combination of the points' ordinates.
    fn std_of(&self, weight: impl Fn(f64) -> f64) -> f64 {
        self.scale * self.points.iter().map(|(x, s)| (weight(*x) * s).powi(2)).sum::<f64>().sqrt()
    }

    pub fn slope_std(&self) -> f64 {
        self.std_of(|x| (x - self.mean_x) / self.xx)
    }

    /// Line at x, with its standard error.
    pub fn at(&self, x: f64) -> (f64, f64) {
        let std = self.std_of(|of| self.share + (x - self.mean_x) * (of - self.mean_x) / self.xx);
        (self.offset + self.slope * x, std)
    }
}

pub(super) fn line(points: &[(f64, f64, f64)], through_origin: bool) -> Fitted {
    let n = points.len() as f64;
    let mean = |of: &dyn Fn(&(f64, f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / n;
    let (mx, my) = if through_origin { (0.0, 0.0) } else { (mean(&|p| p.0), mean(&|p| p.1)) };
    let xx: f64 = points.iter().map(|p| (p.0 - mx).powi(2)).sum();
    let slope = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>() / xx;
    let offset = my - slope * mx;
    // The weighted line decides whether a line describes the points: the unweighted one leaves more than
    // noise at points of small error.
    let (chi2, dof) = best_chi2(points, through_origin);
    let by_scatter = dof > 0.0 && chi2.is_finite() && goodness(chi2, dof) < BY_CHANCE;
    let scale = if by_scatter { (chi2 / dof).sqrt() } else { 1.0 };
    let share = if through_origin { 0.0 } else { 1.0 / n };
    Fitted {
        slope,
        offset,
        points: points.iter().map(|p| (p.0, p.2)).collect(),
        mean_x: mx,
        xx,
        share,
        scale,
    }
}

/// Computes chi-square of the weighted line and its degrees of freedom.
fn best_chi2(points: &[(f64, f64, f64)], through_origin: bool) -> (f64, f64) {
    if !through_origin {
        let line = crate::fit::line::fit(points.iter().map(|p| (p.0, p.1, p.2 * p.2)));
        return line.map_or((0.0, 0.0), |l| (l.chi2, l.dof as f64));
    }
    let sum = |of: &dyn Fn(&(f64, f64, f64)) -> f64| points.iter().map(|p| of(p) / (p.2 * p.2)).sum::<f64>();
    let slope = sum(&|p| p.0 * p.1) / sum(&|p| p.0 * p.0);
    (sum(&|p| (p.1 - slope * p.0).powi(2)), points.len() as f64 - 1.0)
}

/// Standard error of a pair's variance, DN^2 (eq. 19).
pub(super) fn of_variance(var_dn2: f64, pixels: f64) -> f64 {
    var_dn2 * (2.0 / pixels).sqrt()
}

/// Standard error of a level's variance above its dark's, DN^2.
pub(super) fn noise_std(p: &Temporal, pixels: f64) -> f64 {
    of_variance(p.flat.var_dn2, pixels).hypot(of_variance(p.dark.var_dn2, pixels))
}

/// Standard error of a level's mean above its dark's, DN, from two frames each.
pub(super) fn signal_std(p: &Temporal, pixels: f64) -> f64 {
    ((p.flat.var_dn2 + p.dark.var_dn2) / (2.0 * pixels)).sqrt()
}

/// Fits the photon transfer line, of slope K, and the response line, of slope R (section 6.6).
pub(super) fn transfer_lines(
    used: &[Temporal],
    pixels: f64,
    definitions: Definitions,
    clipped: bool,
) -> [Fitted; 2] {
    let noise: Vec<_> = used.iter().map(|p| (p.signal_dn(), p.noise_dn2(), noise_std(p, pixels))).collect();
    let response: Vec<_> = used.iter().map(|p| (p.photons, p.signal_dn(), signal_std(p, pixels))).collect();
    // Release 4.0: free offset (eq. 50); before: none. The response has none (eq. 49), unless the darks are
    // clipped.
    [line(&noise, definitions != Definitions::Release4), line(&response, !clipped)]
}

/// Maximum share of samples at 0 DN over all darks.
pub(super) fn underflow(darks: &[Dark]) -> f64 {
    darks.iter().map(|d| d.pair.zero_share).fold(0.0, f64::max)
}

/// Minimum ratio of the highest to the lowest level for a meaningful slope (a named choice: EMVA 1288 asks
/// for 50 levels from dark to saturation).
pub(crate) const MIN_RANGE: f64 = 1.5;

/// Selects the levels for the fit of gain and responsivity: up to 70 % of saturation.
pub(super) fn fitted_points(
    t: &[Temporal],
    most: f64,
    definitions: Definitions,
    clipped: bool,
) -> Result<Vec<Temporal>, EmvaError> {
    let limit = FIT_RANGE * most;
    if !(limit > 0.0 && limit < f64::from(u16::MAX)) {
        return Err(EmvaError::Missing(
            "these levels have no saturation: the variance's peak lies beyond every code. The flats are not brighter than the darks, or not \
             of one camera and gain"
                .into(),
        ));
    }
    let within: Vec<Temporal> = if definitions == Definitions::ReferenceTool {
        // Up to the last level of the list that lies below the limit.
        let last = t.iter().rposition(|p| p.signal_dn() <= limit);
        last.map(|last| t[..=last].to_vec()).unwrap_or_default()
    } else {
        let below = |p: &&Temporal| p.signal_dn() <= limit && !(clipped && p.flat.zero_share > UNDERFLOW);
        t.iter().filter(below).copied().collect()
    };
    let needed = if definitions == Definitions::Release4 { 3 } else { 1 };
    // If no level saturates, saturation lies beyond the brightest: all are below it, by an unknown amount.
    let is_beyond = t.iter().all(|p| p.signal_dn() <= most && p.flat.full_share < saturation::SHARE);
    let within = if definitions == Definitions::Release4 && is_beyond && within.len() < needed {
        t.iter().filter(|p| !(clipped && p.flat.zero_share > UNDERFLOW)).copied().collect()
    } else {
        within
    };
    if within.len() < needed {
        return Err(EmvaError::Missing(if is_beyond {
            format!(
                "there are {} exposures with flats and darks, and the gain needs {needed} or more",
                within.len()
            )
        } else {
            format!(
                "{} of the {} exposures lie below 70 % of saturation (a signal of {} DN), and the gain needs {needed} or more; take \
                 shorter exposures or less light",
                within.len(),
                t.len(),
                six_digits(limit)
            )
        }));
    }
    let (low, high) = within
        .iter()
        .fold((f64::INFINITY, 0.0f64), |(low, high), p| (low.min(p.signal_dn()), high.max(p.signal_dn())));
    if definitions == Definitions::Release4 && high < MIN_RANGE * low {
        return Err(EmvaError::Missing(format!(
            "the {} exposures below 70 % of saturation have one level (signals of {} to {} DN), and the gain is a slope over several",
            within.len(),
            six_digits(low),
            six_digits(high)
        )));
    }
    Ok(within)
}

pub(super) fn distinct(darks: &[Dark]) -> usize {
    let mut exposures: Vec<f64> = darks.iter().map(|d| d.exposure_s).collect();
    exposures.dedup_by(|a, b| (*a / *b - 1.0).abs() < 1e-9);
    exposures.len()
}

/// Returns the darks whose exposure has a flat: the reference tool uses no others.
pub(super) fn with_flats(darks: &[Dark]) -> Vec<Dark> {
    darks.iter().filter(|d| d.with_flat).copied().collect()
}

/// Fits lines of the darks' means and variances against the exposure; `None` for fewer than three exposures.
pub(super) fn dark_lines(darks: &[Dark], pixels: f64) -> Option<[Fitted; 2]> {
    let means: Vec<_> = darks
        .iter()
        .map(|d| (d.exposure_s, d.pair.mean_dn, (d.pair.var_dn2 / (2.0 * pixels)).sqrt()))
        .collect();
    let variances: Vec<_> =
        darks.iter().map(|d| (d.exposure_s, d.pair.var_dn2, of_variance(d.pair.var_dn2, pixels))).collect();
    (distinct(darks) > 2).then(|| [line(&means, false), line(&variances, false)])
}

/// Line of the linearity error (eq. 59 to 61): offset and slope with weights 1 / y^2, and the levels of its
/// range.
pub(super) struct Linearity {
    pub offset: f64,
    pub slope: f64,
    pub levels: Vec<Temporal>,
}

impl Linearity {
    /// Relative deviation of a level, per cent (eq. 62).
    pub fn deviation(&self, p: &Temporal) -> f64 {
        let fitted = self.offset + self.slope * p.photons;
        100.0 * (p.signal_dn() - fitted) / fitted
    }
}

/// Fits the levels between 5 and 95 % of a signal; `None` for fewer than three.
pub(super) fn linear_range(t: &[Temporal], most: f64, definitions: Definitions) -> Option<Linearity> {
    let (low, high) = (LINEAR_RANGE.0 * most, LINEAR_RANGE.1 * most);
    let levels: Vec<Temporal> = if definitions == Definitions::ReferenceTool {
        let first = t.iter().position(|p| p.signal_dn() >= low)?;
        let last = t.iter().rposition(|p| p.signal_dn() <= high)?;
        t.get(first..=last)?.to_vec()
    } else {
        t.iter().filter(|p| (low..=high).contains(&p.signal_dn())).copied().collect()
    };
    if levels.len() < 3 {
        return None;
    }
    let sum = |f: &dyn Fn(f64, f64) -> f64| levels.iter().map(|p| f(p.photons, p.signal_dn())).sum::<f64>();
    let (xy, xy2, x2y2) = (sum(&|x, y| x / y), sum(&|x, y| x / (y * y)), sum(&|x, y| (x / y).powi(2)));
    let (y1, y2) = (sum(&|_, y| 1.0 / y), sum(&|_, y| 1.0 / (y * y)));
    let offset = (xy * xy2 - x2y2 * y1) / (xy2 * xy2 - x2y2 * y2);
    let slope = (xy - offset * xy2) / x2y2;
    Some(Linearity { offset, slope, levels })
}
