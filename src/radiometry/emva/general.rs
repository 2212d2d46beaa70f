//! General model of release 4.0: a camera as a black box, neither linear nor raw. Equation numbers are those
//! of release 4.0 General (release candidate of 2021-03-15).

use super::Definitions;
use super::lines::{dark_lines, of_variance, signal_std};
use super::points::{Points, Temporal};
use super::saturation::Saturation;
use super::spatial::{filtered, variances};
use super::spline::Spline;
use super::value::Inputs;
use crate::number::Quantity;
use crate::statistics::quantisation::QUANTISATION_DN2;
use radcam_sim::rng::{PixelRng, Stream};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Results of the general model, in photons: without a linear camera there are no electrons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct General {
    /// Quantities by name: R_d, u_p_min, u_p_sat, DR, DR_dB, SNR_max, SNR_max_dB, sigma_y_dark, sigma_d,
    /// u_I_mean, DSNU1288, PRNU1288; null where undefined.
    pub quantities: BTreeMap<String, Option<Quantity>>,
    /// Input signal-to-noise ratio of every level up to saturation: photons, SNR_p (eq. 10), and with spatial
    /// nonuniformity (eq. 60).
    pub snr: Vec<(f64, f64, f64)>,
}

/// Draws of the parametric bootstrap for the errors, which have an error of 5 % themselves.
const DRAWS: u64 = 200;

/// Input of the curves.
#[derive(Clone)]
struct Levels {
    points: Vec<Temporal>,
    dark_dn2: f64,
    quantisation_dn2: f64,
    sat: f64,
    /// Slope of the dark mean, DN/s.
    dark_slope: f64,
    /// Spatial variances of the bright and the dark stack, DN^2, and photons of the bright one.
    spatial: Option<(f64, f64, f64)>,
}

/// Regressions of mean and variance over the photons.
struct Curves {
    mean: Spline,
    variance: Spline,
}

impl Curves {
    /// Fits the curves, with 6 to 8 intervals for the standard's 50 levels (section 6.6). The dark is the
    /// level of no photons.
    fn of(l: &Levels) -> Option<Self> {
        let intervals = (l.points.len() / 7).clamp(1, 8);
        let with_dark = |dark: f64, of: &dyn Fn(&Temporal) -> f64| -> Option<Spline> {
            let points: Vec<(f64, f64)> =
                std::iter::once((0.0, dark)).chain(l.points.iter().map(|p| (p.photons, of(p)))).collect();
            Spline::fit(&points, l.sat, intervals)
        };
        Some(Self {
            mean: with_dark(0.0, &|p| p.signal_dn())?,
            variance: with_dark(l.dark_dn2, &|p| p.flat.var_dn2)?,
        })
    }

    /// Input signal-to-noise ratio (eq. 10).
    fn snr(&self, photons: f64, var_dn2: f64) -> f64 {
        photons * self.mean.at(photons).1 / var_dn2.sqrt()
    }
}

/// Computes the quantities in the order of [`NAMES`].
fn compute(l: &Levels) -> Option<[f64; NAMES.len()]> {
    let curves = Curves::of(l)?;
    let slope = curves.mean.at(0.0).1;
    // Photons at which SNR_p is 1. The standard's regression of the inverse curve begins at the dimmest
    // level, whose SNR is 10 or more. Mean and variance are known down to no light, and their regressions
    // give SNR_p there.
    let snr = |p: f64| curves.snr(p, curves.variance.at(p).0.max(l.dark_dn2));
    let (mut low, mut high) = (0.0, l.sat);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if snr(middle) < 1.0 { low = middle } else { high = middle }
    }
    let u_p_min = 0.5 * (low + high);
    let snr_max = l.points.iter().map(|p| curves.snr(p.photons, p.flat.var_dn2)).fold(0.0, f64::max);
    let (dsnu, prnu) = l.spatial.map_or((f64::NAN, f64::NAN), |(bright, dark, photons)| {
        // Converts to the input by the slope at each level (eq. 58 and 59).
        let bright_p = bright / curves.mean.at(photons).1.powi(2);
        let dark_p = dark / (slope * slope);
        (dark_p.sqrt(), 100.0 * (bright_p - dark_p).sqrt() / photons)
    });
    Some([
        slope,
        u_p_min,
        l.sat,
        l.sat / u_p_min,
        20.0 * (l.sat / u_p_min).log10(),
        snr_max,
        20.0 * snr_max.log10(),
        l.dark_dn2.sqrt(),
        (l.dark_dn2 - l.quantisation_dn2).sqrt() / slope,
        l.dark_slope / slope,
        dsnu,
        prnu,
    ])
}

const NAMES: [(&str, &str); 12] = [
    ("R_d", "DN/p"),
    ("u_p_min", "p"),
    ("u_p_sat", "p"),
    ("DR", "1"),
    ("DR_dB", "dB"),
    ("SNR_max", "1"),
    ("SNR_max_dB", "dB"),
    ("sigma_y_dark", "DN"),
    ("sigma_d", "p"),
    ("u_I_mean", "p/s"),
    ("DSNU1288", "p"),
    ("PRNU1288", "%"),
];

/// Evaluates the general model. `None` if photons or saturation are unknown, or there are too few levels for
/// the regression.
pub(super) fn general(points: &Points, saturated: &Saturation) -> Option<General> {
    let Saturation::At { photons: sat, .. } = saturated else { return None };
    if !points.photons_known {
        return None;
    }
    let pixels = (points.shape.0 * points.shape.1) as f64;
    let mut below: Vec<Temporal> =
        points.temporal.iter().filter(|p| p.photons <= sat.value).copied().collect();
    below.sort_by(|a, b| a.photons.total_cmp(&b.photons));
    let first = points.darks.first()?;
    let lines = dark_lines(&points.darks, pixels);
    let spatial = points.spatial.as_ref().map(|stacks| {
        let mut inputs = Inputs::default();
        stacks.each_ref().map(|stack| {
            let mean = stack.mean_image_dn();
            let (image, filter) = filtered(&mean, Definitions::Release4);
            let whole = variances(stack, &image, filter, Definitions::Release4, &mut inputs).whole;
            (whole.value, whole.std_err())
        })
    });
    let bright_photons = points.spatial.as_ref().map_or(f64::NAN, |s| s[0].photons);
    let levels = Levels {
        points: below,
        dark_dn2: first.pair.var_dn2,
        quantisation_dn2: QUANTISATION_DN2 * points.code_step_dn.powi(2),
        sat: sat.value,
        dark_slope: lines.as_ref().map_or(f64::NAN, |l| l[0].slope),
        spatial: spatial.map(|s| (s[0].0, s[1].0, bright_photons)),
    };
    let found = compute(&levels)?;
    let draws: Vec<[f64; NAMES.len()]> = (0..DRAWS)
        .filter_map(|k| {
            let mut rng = PixelRng::new(1288, Stream::Effect, k, 0, 0);
            let mut normal = |std: f64| std * rng.normal();
            let mut drawn = levels.clone();
            for p in &mut drawn.points {
                p.flat.mean_dn += normal(signal_std(p, pixels));
                p.flat.var_dn2 += normal(of_variance(p.flat.var_dn2, pixels));
            }
            drawn.dark_dn2 += normal(of_variance(drawn.dark_dn2, pixels));
            drawn.sat += normal(sat.std_err());
            drawn.dark_slope += normal(lines.as_ref().map_or(0.0, |l| l[0].slope_std()));
            if let (Some(s), Some(drawn)) = (&spatial, &mut drawn.spatial) {
                drawn.0 += normal(s[0].1);
                drawn.1 += normal(s[1].1);
            }
            // An error of the calibration of the light moves all levels together.
            let scale = 1.0 + normal(points.light.irradiance_rel_std.unwrap_or(0.0));
            drawn.points.iter_mut().for_each(|p| p.photons *= scale);
            drawn.sat *= scale;
            compute(&drawn)
        })
        .collect();
    let std_err = |i: usize| {
        let all: Vec<f64> = draws.iter().map(|d| d[i]).filter(|v| v.is_finite()).collect();
        let n = all.len() as f64;
        let mean = all.iter().sum::<f64>() / n;
        (all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()
    };
    let quantities = NAMES.iter().enumerate().map(|(i, (name, unit))| {
        let quantity = found[i].is_finite().then(|| Quantity::new(found[i], std_err(i), unit));
        (name.to_string(), quantity)
    });
    let curves = Curves::of(&levels)?;
    let snr = levels.points.iter().map(|p| {
        (p.photons, curves.snr(p.photons, p.flat.var_dn2), curves.snr(p.photons, p.flat.single_var_dn2))
    });
    Some(General { quantities: quantities.collect(), snr: snr.collect() })
}
