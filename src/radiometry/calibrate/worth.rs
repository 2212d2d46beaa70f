//! Checks that K removes more nonuniformity than it adds: K of few frames contains their noise.

use super::CalibrateError;
use super::dark::DarkReference;
use super::defects::Defect;
use super::pattern::FixedPattern;
use ndarray::Array2;

/// Minimum number of pixels for an estimate of the spatial variance.
const MIN_PIXELS: f64 = 64.0;
/// Minimum spatial variance beyond the error of K for a detectable PRNU, in standard errors.
const MIN_SIGMAS: f64 = 3.0;
/// Target error of K, relative to the PRNU, for the frame counts in the message.
const WANTED: f64 = 0.5;

/// Refuses a K whose error exceeds the spread of the pixels' response.
///
/// The spatial variance of K is the sum of the variance of the response and that of the error of K. The dark
/// reference's standard error is a level in DN, so it is divided by the level of the flats.
pub(super) fn check(
    pattern: &FixedPattern,
    defects: &[Defect],
    dark: &DarkReference,
    flats: u64,
    darks: u64,
) -> Result<(), CalibrateError> {
    let mut sound = Array2::from_elem(pattern.k.dim(), true);
    defects.iter().for_each(|d| sound[(d.y, d.x)] = false);
    let (mut n, mut spread, mut of_flats) = (0.0, 0.0, 0.0);
    for ((k, e), _) in pattern.k.iter().zip(&pattern.std_err).zip(&sound).filter(|(_, sound)| **sound) {
        n += 1.0;
        spread += (f64::from(*k) - 1.0).powi(2);
        of_flats += f64::from(*e).powi(2);
    }
    if n < MIN_PIXELS || pattern.level_dn.is_nan() || pattern.level_dn <= 0.0 {
        return Ok(());
    }
    let (spread, of_flats) = (spread / n, of_flats / n);
    let of_darks = (dark.std_err_dn / pattern.level_dn).powi(2);
    let of_darks = if of_darks.is_finite() { of_darks } else { 0.0 };
    let error = of_flats + of_darks;
    let unsure = MIN_SIGMAS * spread * (2.0 / n).sqrt();
    let own = spread - error;
    // An undetected PRNU may be as large as the detection limit.
    let (prnu, at_most) = if own > unsure { (own, false) } else { (own.max(0.0) + unsure, true) };
    if error <= prnu {
        return Ok(());
    }
    let each = 0.5 * WANTED * WANTED * prnu;
    let more = |frames: u64, of: f64| (frames as f64 * (of / each).max(1.0)).ceil() as u64;
    let least = if at_most { "at least " } else { "" };
    let needed_darks = more(darks, of_darks);
    let and_darks = if needed_darks > darks {
        format!(" and {least}{needed_darks} darks in place of {darks}")
    } else {
        String::new()
    };
    let needed = format!("{least}{} flats in place of {flats}{and_darks}", more(flats, of_flats));
    Err(CalibrateError::TooNoisy { error: error.sqrt(), prnu: prnu.sqrt(), at_most, needed })
}

/// Ratio of between-configuration variance to frame noise below which camera and card cannot be separated:
/// nothing was moved, or card and lamp are uniform to less than half the noise (a named choice).
const MOVED: f64 = 1.2;

/// Returns true if configurations differ by no more than the noise of their frames: then camera and card
/// cannot be separated. `noise_dn2`: noise variances of the mean images.
pub(super) fn differ_by_noise_alone(pattern: &FixedPattern, noise_dn2: &[f64]) -> bool {
    let noise = noise_dn2.iter().sum::<f64>() / noise_dn2.len().max(1) as f64 / pattern.level_dn.powi(2);
    tracing::debug!(
        "configurations differ by {:.6} of the light, noise {:.6}",
        pattern.pooled_sd,
        noise.sqrt()
    );
    noise > 0.0 && pattern.pooled_sd.powi(2) < MOVED * noise
}
