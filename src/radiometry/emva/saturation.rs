//! Saturation of the camera.

use super::points::Temporal;
use super::value::{Inputs, Value};

/// Exposure of saturation.
#[derive(Debug, Clone)]
pub(super) enum Saturation {
    /// Photons per pixel, and the mean signal there, DN.
    At { photons: Value, signal_dn: f64, note: Option<String> },
    /// Saturation not shown by the data: the reason, and the largest signal, DN.
    Unknown { why: String, signal_dn: f64 },
}

impl Saturation {
    /// Mean signal at saturation, or the largest signal, DN.
    pub fn signal_dn(&self) -> f64 {
        match self {
            Self::At { signal_dn, .. } | Self::Unknown { signal_dn, .. } => *signal_dn,
        }
    }
}

/// Share of the samples at the largest code that defines saturation: the middle of the standard's 0.1 to 0.2
/// % (release 4.0 Linear, section 6.6).
pub(super) const SHARE: f64 = 0.0015;
/// Share below which the variance of a level is not yet clipped: a tenth of [`SHARE`] reduces it by 0.05 %.
const UNCUT: f64 = 1.5e-4;
/// Share above which the mean signal is so far clipped that its distance from the limit says little.
const CUT: f64 = 0.9;

/// Returns the place of the temporal variance's maximum, searched from the brightest end: a single peak of
/// the noise on the way up is passed over (release 3.1; `Results1288.index_u_ysat`).
pub(super) fn peak(var_dn2: &[f64]) -> usize {
    let (mut most, mut at) = (0.0, 0);
    for i in (0..var_dn2.len()).rev() {
        let before = var_dn2[if i == 0 { 1.min(var_dn2.len() - 1) } else { i - 1 }];
        if var_dn2[i] >= most || before >= most {
            (most, at) = (var_dn2[i], i);
        } else {
            break;
        }
    }
    at
}

/// Takes the exposure at which the variance has its maximum, known to the step between exposures.
pub(super) fn at_peak(points: &[Temporal], inputs: &mut Inputs) -> Saturation {
    let at = peak(&points.iter().map(|p| p.flat.var_dn2).collect::<Vec<_>>());
    let step = points[at].photons - if at > 0 { points[at - 1].photons } else { 0.0 };
    Saturation::At {
        photons: inputs.value(points[at].photons, step.abs() / 12f64.sqrt()),
        signal_dn: points[at].signal_dn(),
        note: None,
    }
}

/// Finds the exposure at which [`SHARE`] of the samples have the largest code. Between the exposures it is
/// interpolated by a probit regression: the samples of a level are spread by their temporal and spatial
/// variance, and the limit cuts off the share beyond it.
pub(super) fn by_share(points: &[Temporal], pixels: f64, inputs: &mut Inputs) -> Saturation {
    let mut sorted: Vec<&Temporal> = points.iter().collect();
    sorted.sort_by(|a, b| a.photons.total_cmp(&b.photons));
    let signal_dn = sorted.iter().map(|p| p.signal_dn()).fold(0.0, f64::max);
    let Some(first) = sorted.iter().position(|p| p.flat.full_share >= SHARE) else {
        return without_full_scale(&sorted, pixels, inputs, signal_dn);
    };
    let last_uncut = sorted[..first].iter().rposition(|p| p.flat.full_share < UNCUT && p.photons > 0.0);
    let Some(uncut) = last_uncut.map(|i| sorted[i]) else {
        let why = format!(
            "{:.1} % of the samples of the dimmest exposure are at full scale: shorter exposures are needed",
            100.0 * sorted[first].flat.full_share
        );
        return Saturation::Unknown { why, signal_dn };
    };
    // Spread of a level's samples, from that of the last unclipped one: temporal variance grows with the
    // photons, spatial variance with their square.
    let temporal = |p: f64| {
        let dark = uncut.dark.var_dn2;
        dark + (uncut.flat.var_dn2 - dark).max(0.0) * p / uncut.photons
    };
    let spatial = (uncut.flat.single_var_dn2 - uncut.flat.var_dn2).max(0.0);
    let spread = |p: f64| (temporal(p) + spatial * (p / uncut.photons).powi(2)).max(1.0 / 12.0).sqrt();
    // Signal of a linear camera, extrapolated from the last unclipped level.
    let linear = |p: f64| uncut.signal_dn() * p / uncut.photons;
    let near: Vec<&&Temporal> =
        sorted.iter().filter(|p| p.photons >= uncut.photons && p.flat.full_share < CUT).collect();
    // Photon noise is skewed to the bright side: its third moment is the gain times its variance.
    let gain = (uncut.flat.var_dn2 - uncut.dark.var_dn2).max(0.0) / uncut.signal_dn();
    let skewness = |p: f64| gain * (temporal(p) - uncut.dark.var_dn2).max(0.0) / spread(p).powi(3);
    // Share beyond a limit that lies w deviations above the mean, to first order in the skewness (Edgeworth's
    // series; Kendall and Stuart, The Advanced Theory of Statistics, section 6.18).
    let beyond = |p: f64, limit: f64, scale: f64| {
        let w = (limit - scale * linear(p)) / spread(p);
        let density = (-0.5 * w * w).exp() / std::f64::consts::TAU.sqrt();
        let above = 0.5 * libm::erfc(w * std::f64::consts::FRAC_1_SQRT_2);
        above + skewness(p) / 6.0 * (w * w - 1.0) * density
    };
    let limit_at = uncut.signal_dn() + spread(uncut.photons) * 3.0;
    let samples = 2.0 * pixels;
    let objective = |limit: f64, scale: f64| -> f64 {
        let of = |p: &&&Temporal| {
            let share = beyond(p.photons, limit, scale).clamp(1e-12, 1.0 - 1e-12);
            let count = samples * p.flat.full_share;
            -(count * share.ln() + (samples - count) * (1.0 - share).ln())
        };
        // Two levels determine both. If fewer lie near saturation, a prior keeps the scale near 1, to the 3 %
        // by which a linear camera may bend there.
        near.iter().map(of).sum::<f64>() + 0.5 * ((scale - 1.0) / 0.03).powi(2)
    };
    let Some((limit, scale, covariance)) = minimum(&objective, limit_at, spread(uncut.photons)) else {
        let at = sorted[first];
        let step = at.photons - uncut.photons;
        return Saturation::At {
            photons: inputs.value(at.photons - 0.5 * step, step / 12f64.sqrt()),
            signal_dn: uncut.signal_dn(),
            note: Some(
                "u_p_sat: known to the step between exposures; more of them near saturation would tell"
                    .into(),
            ),
        };
    };
    // Solves for the exposure at which the share is reached, by bisection.
    let reached = |limit: f64, scale: f64| {
        // Bracket: from six deviations below the limit to the limit.
        let at_limit = limit.max(1.0) / (scale * linear(1.0)).max(1e-300);
        let (mut low, mut high) =
            (at_limit * (1.0 - 6.0 * spread(at_limit) / limit.max(1.0)).max(0.0), at_limit);
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if beyond(middle, limit, scale) < SHARE { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    };
    let photons = reached(limit, scale);
    let steps = [1e-4 * limit.abs().max(1.0), 1e-5];
    let slopes = [
        (reached(limit + steps[0], scale) - reached(limit - steps[0], scale)) / (2.0 * steps[0]),
        (reached(limit, scale + steps[1]) - reached(limit, scale - steps[1])) / (2.0 * steps[1]),
    ];
    let [[a, b], [_, d]] = covariance;
    let variance = slopes[0] * slopes[0] * a + 2.0 * slopes[0] * slopes[1] * b + slopes[1] * slopes[1] * d;
    Saturation::At {
        photons: inputs.value(photons, variance.max(0.0).sqrt()),
        signal_dn: scale * linear(photons),
        note: None,
    }
}

/// Finds saturation if no exposure brings enough samples to the largest code: the well is full before, or the
/// light was not enough.
fn without_full_scale(sorted: &[&Temporal], pixels: f64, inputs: &mut Inputs, signal_dn: f64) -> Saturation {
    let variances: Vec<f64> = sorted.iter().map(|p| p.flat.var_dn2).collect();
    let at = peak(&variances);
    let last = variances.len() - 1;
    // Significant fall: five of its standard errors (eq. 19).
    let falls = variances[at] - variances[last] > 5.0 * variances[at] * 2.0 / pixels.sqrt();
    if at == last || !falls {
        let most = sorted.last().map_or(0.0, |p| 100.0 * p.flat.full_share);
        let why = format!(
            "the brightest exposure has {most:.3} % of its samples at full scale, and its variance does not fall: saturation lies beyond, above a \
             signal of {signal_dn:.0} DN"
        );
        return Saturation::Unknown { why, signal_dn };
    }
    let step = sorted[at].photons - if at > 0 { sorted[at - 1].photons } else { 0.0 };
    Saturation::At {
        photons: inputs.value(sorted[at].photons, step.abs() / 12f64.sqrt()),
        signal_dn: sorted[at].signal_dn(),
        note: Some(
            "u_p_sat: no exposure reaches the largest code; the well is full before. Saturation is where the temporal variance has its maximum \
             (release 3.1), known to the step between exposures"
                .into(),
        ),
    }
}

/// Minimises a function of two unknowns near (`limit`, 1) by Newton's method with numerical derivatives;
/// returns the inverse of its curvature as well. `width` is the scale of the first unknown.
fn minimum(f: &dyn Fn(f64, f64) -> f64, limit: f64, width: f64) -> Option<(f64, f64, [[f64; 2]; 2])> {
    let (mut x, mut y) = (limit, 1.0);
    // Scans the limit alone first, over a range in which it must lie: Newton's method needs a start nearby.
    let mut best = f64::INFINITY;
    for k in -60..=120 {
        let at = limit + 0.1 * f64::from(k) * width;
        let value = f(at, 1.0);
        if value < best {
            (best, x) = (value, at);
        }
    }
    let (dx, dy) = (1e-3 * width, 1e-5);
    let mut inverse = [[0.0; 2]; 2];
    for _ in 0..60 {
        let here = f(x, y);
        let [xp, xm, yp, ym] = [f(x + dx, y), f(x - dx, y), f(x, y + dy), f(x, y - dy)];
        let gradient = [(xp - xm) / (2.0 * dx), (yp - ym) / (2.0 * dy)];
        let xx = (xp - 2.0 * here + xm) / (dx * dx);
        let yy = (yp - 2.0 * here + ym) / (dy * dy);
        let xy =
            (f(x + dx, y + dy) - f(x + dx, y - dy) - f(x - dx, y + dy) + f(x - dx, y - dy)) / (4.0 * dx * dy);
        let determinant = xx * yy - xy * xy;
        if !(determinant > 0.0 && xx > 0.0) {
            return None;
        }
        inverse = [[yy / determinant, -xy / determinant], [-xy / determinant, xx / determinant]];
        let mut step = [
            -(inverse[0][0] * gradient[0] + inverse[0][1] * gradient[1]),
            -(inverse[1][0] * gradient[0] + inverse[1][1] * gradient[1]),
        ];
        while f(x + step[0], y + step[1]) > here && step[0].abs() > 1e-9 * width {
            step = step.map(|s| 0.5 * s);
        }
        (x, y) = (x + step[0], y + step[1]);
        if step[0].abs() < 1e-6 * width && step[1].abs() < 1e-8 {
            break;
        }
    }
    (x.is_finite() && y.is_finite()).then_some((x, y, inverse))
}
