//! Section IV on the frames of a dataset, with notes on its darks and pixels.

use super::levels::{Measured, ONE_EXPOSURE, TAKEN_OFF, measure, points, zero};
use super::{NoiseError, NoiseReport, estimate_with};
use crate::data_faults::examined;
use crate::dataset::{Dataset, ElectronMultiplication, Kind, LONG_DARKS};
use crate::first_look::lit_part;
use crate::number::{six_digits, with_error};
use crate::statistics::level::Level;
use crate::statistics::outliers;
use std::sync::atomic::AtomicBool;

/// Evaluates Section IV on a dataset of frames.
///
/// # Errors
///
/// If no line can be fitted, a frame (named) cannot be read, or the evaluation was stopped.
pub fn of_dataset(
    dataset: &Dataset,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<NoiseReport, NoiseError> {
    dataset.must_be_monochrome()?;
    let dataset = examined(dataset, stop)?;
    let (dataset, cut) = match lit_part(&dataset)? {
        Some((part, words)) => (part, Some(words)),
        None => (dataset, None),
    };
    let measured = measure(&dataset, stop, progress)?;
    if measured.levels.is_empty() {
        return Err(NoiseError::NoFrames);
    }
    let zero = zero(&measured);
    let mut report = estimate_with(points(&measured, &zero), &zero, dataset.quantisation_dn2())?;
    if let Some((dark_s, flat_s)) = long_darks(&measured).filter(|_| zero.source == ONE_EXPOSURE) {
        let most = with_error(report.read_noise_e.value, report.read_noise_e.std_err);
        (report.read_noise_e.value, report.read_noise_e.std_err) = (f64::NAN, f64::NAN);
        report.notes.push(format!(
            "darks of {} s only, and flats of {} s at most: the noise of so long a dark charge is in the constant noise, and the read noise \
             is at most {most} e⁻. Take darks of the flats' exposures",
            six_digits(dark_s),
            six_digits(flat_s)
        ));
    } else if let Some(charge_dn) =
        // A black level that moved by as much explains the difference.
        charge_of_darks(&measured, &dataset)
            .filter(|dn| zero.source == ONE_EXPOSURE && *dn > zero.moved_range_dn())
    {
        let (gain, constant) = (report.gain_dn_per_e.value, report.constant_noise_var_dn2.value);
        let without = constant - gain * charge_dn - dataset.quantisation_dn2();
        if report.read_noise_e.value.is_finite() && gain * charge_dn > CHARGE_SHARE * constant {
            let most = with_error(report.read_noise_e.value, report.read_noise_e.std_err);
            (report.read_noise_e.value, report.read_noise_e.std_err) = (f64::NAN, f64::NAN);
            let about = if without > 0.0 {
                format!(", about {:.1} e⁻", without.sqrt() / gain)
            } else {
                String::new()
            };
            report.notes.push(format!(
                "the flats meet zero exposure {charge_dn:.1} DN below the darks, which have one exposure: so much dark charge is in them \
                 (unless exposures are shorter than stated), and its noise is in the constant noise. The read noise is less than {most} e⁻{about}. Take darks at two exposures"
            ));
        } else {
            // With little charge, its share of the noise is not known better.
            let by_charge = report.read_noise_e.value - without.max(0.0).sqrt() / gain;
            report.read_noise_e.std_err = report.read_noise_e.std_err.hypot(by_charge);
        }
    }
    // Lag and filters over time leave more of the light in darks right after it.
    if let Some(found) = unlike(darks(&measured)).filter(|_| dataset.carried_share() == 0.0) {
        let (gain, quantisation_dn2) = (report.gain_dn_per_e.value, dataset.quantisation_dn2());
        let read_e = |var_dn2: f64| (var_dn2 - quantisation_dn2).max(0.0).sqrt() / gain;
        let [least_e, most_e] = [found.least.1, found.most.1].map(read_e);
        let read = &mut report.read_noise_e;
        if read.value.is_finite() && gain > 0.0 {
            let off = (read.value - least_e).abs().max((most_e - read.value).abs());
            read.std_err = read.std_err.hypot(off);
        }
        let constant = &mut report.constant_noise_var_dn2;
        let off = (constant.value - found.least.1).abs().max((found.most.1 - constant.value).abs());
        constant.std_err = constant.std_err.hypot(off);
        report.notes.insert(
            0,
            format!(
                "darks of one exposure differ in noise: set {} has a variance of {:.3} DN^2 and set {} of {:.3} DN^2. Some were averaged, \
                 filtered or taken under other settings; the error of the read noise takes them all in. Leave out those that differ",
                found.least.0, found.least.1, found.most.0, found.most.1
            ),
        );
    }
    report.notes.extend(cut);
    let step = dataset.code_step_dn();
    if step > 1.0 {
        report.notes.push(format!(
            "the codes that occur are {} DN apart: the converter's step, whose quantisation noise q^2/12 = {} DN^2 is no read noise",
            six_digits(step),
            six_digits(dataset.quantisation_dn2())
        ));
    }
    report.notes.extend(memory_in_words(dataset.carried_share()).map(|m| {
        format!("{m} A is too low by what they share, which its error takes in; `radcam diagnose` puts it into the model")
    }));
    if let Some(multiplied) = ElectronMultiplication::of(&dataset.manifest().camera) {
        let gain = &report.gain_dn_per_e;
        report.notes.insert(0, multiplied.with_gain(gain.value, gain.std_err));
    }
    if let Some(shared) = dataset.shared_noise() {
        let gain = &report.gain_dn_per_e;
        report.notes.insert(0, shared.in_words(gain.value, gain.std_err));
        report.shared_noise_rel = Some(shared.quantity());
    }
    let is_taken_off =
        |because: &Option<String>| because.as_ref().is_some_and(|text| text.ends_with(TAKEN_OFF));
    if report.levels.iter().any(|l| is_taken_off(&l.excluded_because)) {
        report.notes.push(
            "the camera takes the level of the dark charge off, and its noise stays: so much as the darks show for each exposure is taken off the \
             variance of the levels"
                .into(),
        );
    }
    report.notes.extend(masked(&measured));
    report.notes.extend(struck(&measured));
    report.notes.extend(temperature(&dataset));
    Ok(NoiseReport { data_faults: dataset.data_faults().to_vec(), ..report })
}

/// Minimum ratio of the variances of darks of one exposure at which they are no frames of one camera under
/// one setting, and minimum difference in its errors (named choices: none of 159 campaigns of single
/// frames without a filter over time has such darks).
const UNLIKE: (f64, f64) = (1.2, 10.0);

/// Set and variance, DN^2, of the darks of one exposure with the least and the most noise.
struct Unlike {
    least: (u32, f64),
    most: (u32, f64),
}

/// A set of darks: number, exposure in s, temporal variance in DN^2 and its relative error.
type Darks = (u32, f64, f64, f64);

/// Returns darks of one exposure whose noise differs by far more than its error.
fn unlike(mut darks: Vec<Darks>) -> Option<Unlike> {
    darks.sort_by(|a, b| a.1.total_cmp(&b.1));
    let of_one = darks.chunk_by(|a, b| b.1 <= 1.001 * a.1);
    let unlike = of_one.filter_map(|group| {
        let (least, most) = (group.iter().min_by(by_variance)?, group.iter().max_by(by_variance)?);
        let is_far = most.2 > UNLIKE.0 * least.2 && most.2 - least.2 > UNLIKE.1 * most.2 * most.3;
        is_far.then_some(Unlike { least: (least.0, least.2), most: (most.0, most.2) })
    });
    unlike.max_by(|a, b| (a.most.1 / a.least.1).total_cmp(&(b.most.1 / b.least.1)))
}

fn by_variance(a: &&Darks, b: &&Darks) -> std::cmp::Ordering {
    a.2.total_cmp(&b.2)
}

/// Returns the darks of the levels.
fn darks(measured: &Measured) -> Vec<Darks> {
    let several = measured.levels.iter().filter(|l| l.1 == Kind::Dark && l.3.frames > 1);
    let error = |l: &Level| (2.0f64 / (l.pixels as f64 * (l.frames - 1) as f64)).sqrt();
    several.map(|(set, _, exposure_s, l)| (*set, *exposure_s, l.var_dn2, error(l))).collect()
}

/// Minimum share of dark charge in the constant noise at which this is no read noise (a named choice).
const CHARGE_SHARE: f64 = 0.1;
/// Maximum level, as a share of full scale, of flats that lie on a line over the exposure, and their maximum
/// relative scatter about it (named choices).
const ON_A_LINE: (f64, f64) = (0.7, 0.005);

/// Estimates the level of the darks above that of a line through the flats of at least three exposures at no
/// light, DN; `None` if it is not above by three of its errors, or the flats are not on a line.
fn charge_of_darks(measured: &Measured, dataset: &Dataset) -> Option<f64> {
    let light = |number: u32| {
        let set = dataset.sets().iter().find(|s| s.number == number)?;
        let settings = dataset.settings(set);
        Some(settings.exposure_s * settings.illumination)
    };
    let highest_dn = ON_A_LINE.0 * measured.full_scale_dn;
    let flats =
        measured.levels.iter().filter(|(_, kind, _, l)| *kind == Kind::Flat && l.mean_dn < highest_dn);
    let points: Vec<(f64, f64)> = flats.filter_map(|f| Some((light(f.0)?, f.3.mean_dn))).collect();
    let mut exposures: Vec<f64> = points.iter().map(|p| p.0).collect();
    exposures.sort_by(f64::total_cmp);
    exposures.dedup_by(|a, b| (*a / *b - 1.0).abs() < 1e-6);
    let line = crate::fit::line::fit(points.iter().map(|(x, y)| (*x, *y, y * y)))?;
    let scatter = (line.chi2 / line.dof.max(1) as f64).sqrt();
    if exposures.len() < 3 || scatter > ON_A_LINE.1 || line.slope <= 0.0 {
        return None;
    }
    let darks = || measured.levels.iter().filter(|l| l.1 == Kind::Dark).map(|l| l.3.mean_dn);
    let charge_dn = darks().sum::<f64>() / darks().count().max(1) as f64 - line.intercept;
    (charge_dn > 3.0 * scatter * line.var_intercept.sqrt()).then_some(charge_dn)
}

/// Returns the exposure of the darks and the longest one of the flats, s, if all darks are far longer.
fn long_darks(measured: &Measured) -> Option<(f64, f64)> {
    let of = |kind: Kind| measured.levels.iter().filter(move |l| l.1 == kind).map(|l| l.2);
    let shortest = of(Kind::Dark).fold(f64::INFINITY, f64::min);
    let longest = of(Kind::Flat).fold(0.0, f64::max);
    (longest > 0.0 && shortest.is_finite() && shortest > LONG_DARKS * longest).then_some((shortest, longest))
}

/// Formats the share that first frames carry from the set before.
pub(crate) fn memory_in_words(share: f64) -> Option<String> {
    (share > 0.0).then(|| {
        format!(
            "the first frames of sets carry {} of a change of level from the set before (image lag, or a filter over time), so that successive \
             frames share noise.",
            crate::number::percent(share)
        )
    })
}

/// Formats a note on masked pixels.
fn masked(measured: &Measured) -> Option<String> {
    // A set of one frame has no pixels with a variance.
    let level = measured.levels.iter().map(|l| &l.3).max_by_key(|l| l.pixels)?;
    let n = level.masked;
    let share = crate::number::percent(n as f64 / (n + level.pixels) as f64);
    let (pixels, are) = if n == 1 { ("pixel", "is") } else { ("pixels", "are") };
    (n > 0).then(|| {
        format!(
            "{n} {pixels} ({share}) {are} hot, blind, clipped, jumping or interpolated, and {are} left out"
        )
    })
}

/// Formats a note on struck samples.
fn struck(measured: &Measured) -> Option<String> {
    let hit = measured.levels.iter().filter(|(.., level)| level.struck > 0).count();
    let n: u64 = measured.levels.iter().map(|(.., level)| level.struck).sum();
    (n > 0)
        .then(|| format!("{}; left out: in {hit} of {} sets", outliers::in_words(n), measured.levels.len()))
}

/// Minimum range of the sensor's temperature that is reported, K: dark current doubles in about 7 K (a named
/// choice).
const MIN_TEMPERATURE_RANGE_K: f64 = 1.0;

/// Formats a note on drifting temperatures.
fn temperature(dataset: &Dataset) -> Option<String> {
    let rows = dataset.rows().iter().filter(|r| matches!(r.kind, Kind::Dark | Kind::Flat));
    let all: Vec<f64> = rows.filter_map(|r| r.temperature_c).collect();
    let least = all.iter().copied().fold(f64::INFINITY, f64::min);
    let most = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (most - least > MIN_TEMPERATURE_RANGE_K).then(|| {
        format!(
            "the sensor's temperature lies between {least:.1} and {most:.1} °C over the campaign: dark current and black level go with it. \
             Let the camera warm up, or take darks beside each set of flats"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Twelve darks of one exposure differ by chance in none of 2000 campaigns; one of 1.4 times the variance
    /// among them is found in all, and one of another exposure in none.
    #[test]
    fn darks_of_other_noise_are_found() {
        let drawn = |seed: u32, last: (f64, f64)| -> Vec<Darks> {
            let of = |k: u32| {
                let (exposure_s, var_dn2) = if k == 11 { last } else { (0.01, 0.4) };
                let z = PixelRng::new(8, Stream::Effect, 1, seed, k).normal();
                (k, exposure_s, var_dn2 * (1.0 + 0.014 * z), 0.014)
            };
            (0..12).map(of).collect()
        };
        let found = |last: (f64, f64)| (0..2000).filter(|seed| unlike(drawn(*seed, last)).is_some()).count();
        assert_eq!([found((0.01, 0.4)), found((0.01, 0.56)), found((0.02, 0.56))], [0, 2000, 0]);
    }
}
