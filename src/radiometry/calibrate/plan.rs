//! Capture plan of a calibration: n1 configurations, n2 frames, s darks, from a short pilot (Sections V.A and
//! V.B).

use super::CalibrateError;
use super::dark::frames_needed;
use super::pattern::{Options, PatternError, paper};
use crate::dataset::{Dataset, Kind};
use crate::noise::NoiseReport;
use crate::plan::{CameraPlan, Plan, SetPlan};

use serde::{Deserialize, Serialize};

/// Number of configurations of a pilot, for measuring the scatter of the card.
pub const PILOT_CONFIGURATIONS: u32 = 6;
/// Number of frames of each set of a pilot.
pub const PILOT_FRAMES: u32 = 8;

/// Needs of a calibration, and the measurements behind them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Needs {
    /// Number n1 of configurations.
    pub n1: u64,
    /// Number n2 of frames in each.
    pub n2: u64,
    /// Number s of dark frames at each exposure.
    pub s: u64,
    /// Deviation of the slopes over the configurations (eq. 49), with the frames' own noise averaged over n2.
    pub slope_sd: f64,
    /// Smallest share of configurations kept at a pixel.
    pub worst_kept: f64,
    /// Bits b of the converter.
    pub bit_depth: u8,
    /// Temporal variance at full scale, eq. (41), DN^2.
    pub full_scale_var_dn2: f64,
    /// Temporal variance in the dark, DN^2.
    pub dark_var_dn2: f64,
    /// Requested standard error of K; without one K keeps as many bits as the converter has (Section V.B).
    pub k_std_err: Option<f64>,
    /// True for a single configuration: K contains the card and the lamp's fine structure.
    #[serde(default)]
    pub smooth: bool,
}

/// Maximum number of frames of each level for A, if one configuration has all frames that K needs.
const FRAMES_OF_A_LEVEL: u64 = 16;

/// Computes the number n2 of frames for sigma_N^2 / n2 of at most q^2 / 9 at full scale, q = 1 DN.
///
/// ```
/// // The paper's camera: (0.003384 * 255 + 1.1196) * 9 = 17.8.
/// assert_eq!(radcam::calibrate::plan::frames(0.003384 * 255.0 + 1.1196), 18);
/// ```
pub fn frames(full_scale_var_dn2: f64) -> u64 {
    (9.0 * full_scale_var_dn2).ceil().max(1.0) as u64
}

/// Computes the number n1 of configurations for var K < 1 / (10 * 2^(2b)), with `p` deviations `slope_sd` of
/// the slopes and at worst a share `worst_kept` of them kept: n1'_min >= 10 * 2^(2b) (p s)^2. At least three.
pub fn configurations(bit_depth: u8, p: f64, slope_sd: f64, worst_kept: f64) -> u64 {
    let kept = 10.0 * 2f64.powi(2 * i32::from(bit_depth)) * (p * slope_sd).powi(2);
    (kept / worst_kept.clamp(0.05, 1.0)).ceil().clamp(3.0, 1e9) as u64
}

/// Computes the configurations n1, and the frames n2 in each, for a standard error of K. The card, whose
/// slopes scatter by `card_sd`, and the frames' own noise, of relative variance `noise_var` in each, take
/// half of its square each: var K = (card_sd^2 + noise_var / n2) / n1. At least three configurations and two
/// frames.
///
/// ```
/// // Noise of 1 % in a frame and a card of 0.2 %, for K to 0.1 %: 8 configurations, and 200 / 8 frames in each.
/// assert_eq!(radcam::calibrate::plan::for_error(1e-3, 2e-3, 1e-4), (8, 25));
/// ```
pub fn for_error(k_std_err: f64, card_sd: f64, noise_var: f64) -> (u64, u64) {
    let half = 0.5 * k_std_err * k_std_err;
    // Rounding of the quotients must not add one more.
    let up = |x: f64| (x * (1.0 - 1e-9)).ceil().clamp(0.0, 1e9) as u64;
    let n1 = up(card_sd * card_sd / half).max(3);
    (n1, up(noise_var / half / n1 as f64).max(2))
}

/// Computes the frames of one configuration for a standard error of K, or for K to keep `bit_depth` bits,
/// where the relative variance of a frame's noise is `noise_var`: var K = noise_var / n2.
///
/// ```
/// // Noise of 1 % in a frame, for K to 0.1 %: 100 frames.
/// assert_eq!(radcam::calibrate::plan::frames_of_one(Some(1e-3), 12, 1e-4), 100);
/// ```
pub fn frames_of_one(k_std_err: Option<f64>, bit_depth: u8, noise_var: f64) -> u64 {
    let most = k_std_err.map_or(0.1 * 2f64.powi(-2 * i32::from(bit_depth)), |e| e * e);
    (noise_var / most * (1.0 - 1e-9)).ceil().clamp(2.0, 1e9) as u64
}

/// Computes the needs of [`Estimator::Smooth`](super::Estimator::Smooth) from a pilot: darks and flats of one
/// configuration or more.
///
/// # Errors
///
/// If the pilot lacks a level or darks, or a frame cannot be read.
pub fn needs_smooth(
    pilot: &Dataset,
    noise: &NoiseReport,
    k_std_err: Option<f64>,
) -> Result<Needs, CalibrateError> {
    let flats = super::flats::of_pilot(pilot)?;
    let levels = flats.images.iter().filter_map(|image| image.mean()).map(f64::from);
    let level = levels.fold(0.0, f64::max);
    if level <= 0.0 {
        return Err(PatternError::Dark(0).into());
    }
    let Variances { full_scale_var_dn2, dark_var_dn2, at_level } = variances(pilot, noise, level);
    let bit_depth = pilot.manifest().camera.bit_depth;
    let n2 = frames_of_one(k_std_err, bit_depth, at_level);
    let slope_sd = (at_level / n2 as f64).sqrt();
    let s = darks_needed(dark_var_dn2, k_std_err, level);
    Ok(Needs {
        n1: 1,
        n2,
        s,
        slope_sd,
        worst_kept: 1.0,
        bit_depth,
        full_scale_var_dn2,
        dark_var_dn2,
        k_std_err,
        smooth: true,
    })
}

/// Temporal variances estimated from a pilot.
struct Variances {
    full_scale_var_dn2: f64,
    dark_var_dn2: f64,
    /// Relative variance of a frame's noise at the level of the flats.
    at_level: f64,
}

fn variances(pilot: &Dataset, noise: &NoiseReport, level: f64) -> Variances {
    let (a, c) = (noise.gain_dn_per_e.value, noise.constant_noise_var_dn2.value);
    let full_scale = f64::from(pilot.manifest().camera.full_scale_dn()) - noise.offset_dn.value;
    let darks = noise.levels.iter().filter(|l| l.kind == Kind::Dark && l.var_dn2.is_finite());
    Variances {
        full_scale_var_dn2: a * full_scale + c,
        dark_var_dn2: darks.map(|l| l.var_dn2).fold(c, f64::max),
        at_level: (a * level + c) / (level * level),
    }
}

/// Computes the darks for a reference as good as the averaged flats: an error of q / 3, or a third of the
/// requested error at the level of the flats.
fn darks_needed(dark_var_dn2: f64, k_std_err: Option<f64>, level: f64) -> u64 {
    let std_err_dn = k_std_err.map_or(1.0 / 3.0, |e| (e * level / 3.0).min(1.0));
    frames_needed(dark_var_dn2, std_err_dn).max(4)
}

/// Computes the needs from a pilot: darks and flats of at least three configurations. `k_std_err`: requested
/// standard error of K, relative; `None`: small enough for K to keep as many bits as the converter has, as in
/// the paper.
///
/// # Errors
///
/// If the pilot lacks a level or darks, or a frame cannot be read.
pub fn needs(pilot: &Dataset, noise: &NoiseReport, k_std_err: Option<f64>) -> Result<Needs, CalibrateError> {
    let options = Options::default();
    let camera = &pilot.manifest().camera;
    let flats = super::flats::of_pilot(pilot)?;
    let (images, frames_each) = (&flats.images, flats.fewest());
    if images.len() < 3 {
        return Err(PatternError::TooFew(images.len()).into());
    }
    let found = paper(images, options)?;
    let level = found.level_dn;
    // The pilot's scatter contains the frames' own noise as averaged there; the campaign averages it over n2.
    let Variances { full_scale_var_dn2, dark_var_dn2, at_level: noise_var } = variances(pilot, noise, level);
    let card = (found.pooled_sd.powi(2) - noise_var / frames_each as f64).max(0.0);
    let wanted = k_std_err.map(|e| for_error(e, card.sqrt(), noise_var));
    let n2 = wanted.map_or_else(|| frames(full_scale_var_dn2), |(_, n2)| n2);
    let slope_sd = (card + noise_var / n2 as f64).sqrt();
    // The worst share of a pilot of few configurations is a poor estimate: half the median share at worst.
    let share = |kept: u16| f64::from(kept) / images.len() as f64;
    let mut kept: Vec<f64> = found.kept.iter().map(|&k| share(k)).collect();
    kept.sort_by(f64::total_cmp);
    let worst_kept = kept[kept.len() / 1000].max(0.5 * kept[kept.len() / 2]);
    let n1 = wanted
        .map_or_else(|| configurations(camera.bit_depth, options.p, slope_sd, worst_kept), |(n1, _)| n1);
    let s = darks_needed(dark_var_dn2, k_std_err, level);
    let bit_depth = camera.bit_depth;
    Ok(Needs {
        n1,
        n2,
        s,
        slope_sd,
        worst_kept,
        bit_depth,
        full_scale_var_dn2,
        dark_var_dn2,
        k_std_err,
        smooth: false,
    })
}

fn set(kind: Kind, frames: u64, exposure_s: f64, illumination: f64, configuration: u32) -> SetPlan {
    SetPlan {
        kind,
        frames: frames.min(u64::from(u32::MAX)) as u32,
        exposure_s: Some(exposure_s),
        exposure: None,
        illumination,
        configuration,
    }
}

/// Returns the pilot: darks at two exposures, flats at four, and [`PILOT_CONFIGURATIONS`] of the card.
pub fn pilot() -> Plan {
    let mut plan = Plan::quick();
    plan.about = "A pilot for a calibration".into();
    let last = plan.sets.last().cloned();
    for set in &mut plan.sets {
        set.frames = PILOT_FRAMES;
    }
    if let Some(last) = last {
        plan.sets.extend((1..PILOT_CONFIGURATIONS).map(|configuration| SetPlan {
            configuration,
            frames: PILOT_FRAMES,
            ..last.clone()
        }));
    }
    plan
}

/// Returns the plan of the calibration campaign, at the exposure of the pilot's configurations.
pub fn campaign(pilot: &Dataset, needs: &Needs) -> Plan {
    let flat = super::best_level(pilot);
    let (exposure_s, light) = flat.map_or((0.01, 1.0), |(e, l)| (e, l));
    let longest = pilot.sets().iter().map(|s| pilot.settings(s)).filter(|r| r.kind == Kind::Dark);
    let longest = longest.map(|r| r.exposure_s).fold(exposure_s, f64::max);
    let mut sets = vec![set(Kind::Dark, needs.s, exposure_s, 0.0, 0)];
    if longest > exposure_s {
        sets.push(set(Kind::Dark, needs.s, longest, 0.0, 0));
    }
    // A few levels of light, so that the same campaign gives A and the constant noise.
    for part in [0.1, 0.3, 0.6] {
        let most = if needs.smooth { FRAMES_OF_A_LEVEL } else { u64::MAX };
        sets.push(set(Kind::Flat, needs.n2.clamp(4, most), exposure_s * part, light, 0));
    }
    let n1 = needs.n1.min(100_000) as u32;
    sets.extend((0..n1).map(|k| set(Kind::Flat, needs.n2, exposure_s, light, k)));
    let camera = &pilot.manifest().camera;
    Plan {
        format: crate::plan::FORMAT.into(),
        about: format!("Calibration: {n1} configurations of {} frames, {} darks", needs.n2, needs.s),
        full_exposure_s: Some(exposure_s),
        searched: false,
        camera: CameraPlan {
            gain_db: camera.gain_db,
            black_level_dn: camera.black_level_dn,
            ..CameraPlan::default()
        },
        bench: None,
        light: None,
        sets,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's n1 = 11: 10 * 2^16 (1.5 s)^2 with s of 0.0027 is 10.7.
    #[test]
    fn the_papers_eleven_configurations() {
        assert_eq!(configurations(8, 1.5, 0.0027, 1.0), 11);
        assert_eq!(configurations(8, 1.5, 0.0027, 0.5), 22);
        assert_eq!(configurations(8, 1.5, 0.0, 1.0), 3);
    }
}
