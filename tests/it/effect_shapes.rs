//! Forms of effects in captured campaigns: the effect is named first in its form, with its values and the
//! gain within four standard errors.

use crate::effects::{campaign, capture, observe, unit, with};
use crate::support::small;
use radcam::diagnosis::{Diagnosis, Missing, diagnose};
use radcam::plan::Plan;
use radcam_sim::Model;

fn verdict(model: Model, plan: Option<&Plan>) -> Diagnosis {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    match plan {
        Some(plan) => capture(model, plan, &root),
        None => campaign(model, &root),
    }
    diagnose(&observe(&root), None, Vec::new(), &mut |_| {})
}

/// First name of a diagnosis; asserts that it is this one, not partial, with the model's gain.
fn first<'d>(d: &'d Diagnosis, id: &str, model: &Model) -> &'d Missing {
    let first =
        d.missing.first().unwrap_or_else(|| panic!("{id}: nothing is named, error {}", d.error_before));
    assert!(first.effect == id && !first.partial, "{id}: {:#?}", d.missing);
    let gain = d.sensor.gain_dn_per_e.as_ref().unwrap();
    assert!(
        (gain.value - model.base.gain_dn_per_e).abs() < 4.0 * gain.std_err,
        "{id}: {gain}, not {}",
        model.base.gain_dn_per_e
    );
    first
}

fn is_near(m: &Missing, name: &str, truth: f64) {
    let q = &m.parameters[name];
    assert!((q.value - truth).abs() < 4.0 * q.std_err, "{}: {name} {q}, not {truth}", m.effect);
}

/// A held share of every charge lowers the noise and correlates successive frames; single electrons held at
/// random do neither. Confusing them makes the gain 6 % wrong.
#[test]
fn lag_of_voltage_and_of_electrons_are_told_apart() {
    for by_chance in [0.0, 1.0] {
        let model = unit(310 + by_chance as u64);
        let d = verdict(with(model.clone(), "image-lag", &[0.0, 0.03, 1.0, 0.0, 1.0, by_chance]), None);
        let lag = first(&d, "image-lag", &model);
        assert_eq!(lag.parameters["by_chance"].value, by_chance, "{lag:#?}");
        is_near(lag, "fraction", 0.03);
    }
}

/// Few frames do not tell whether a held share of every charge or single electrons stay, and the noise of
/// the one means another gain than that of the other: the error reaches to both.
#[test]
fn lag_that_is_not_told_apart_widens_the_gain() {
    let mut ties = 0;
    for seed in 700..706 {
        let mut model = small("cmos12", 48, 40);
        model.base.seed = seed;
        let d = verdict(with(model.clone(), "image-lag", &[0.0, 0.015, 1.0, 0.0, 1.0, 0.0]), None);
        let lag = first(&d, "image-lag", &model);
        ties += usize::from(lag.evidence.iter().any(|text| text.contains("with a gain of")));
    }
    assert!(ties > 0);
}

/// Errors of high and low bits at once, on twelve bits: errors in proportion to all weights are a gain, which
/// is a redundant direction of the fit.
#[test]
fn high_and_low_bits_of_a_converter_are_wrong_together() {
    let model = unit(320);
    let mut values = vec![0.0; 13];
    values[0] = 2.0;
    values[4..10].copy_from_slice(&[0.3, -0.4, 0.6, 2.0, -1.1, 1.0]);
    let d = verdict(with(model.clone(), "adc-nonlinearity", &values), None);
    let bits = first(&d, "adc-nonlinearity", &model);
    assert_eq!(bits.parameters["bits"].value, 2.0, "{bits:#?}");
    // Less their part in proportion to the weights, 2^k.
    let errors: Vec<f64> = (0..12).map(|b| if b < 6 { values[1 + b] } else { values[18 - b] }).collect();
    let gain = errors.iter().enumerate().map(|(b, e)| e * f64::from(1 << b)).sum::<f64>()
        / (4f64.powi(12) - 1.0)
        * 3.0;
    for (name, bit) in
        [("bit3_dn", 3), ("bit4_dn", 4), ("bit5_dn", 5), ("top0_dn", 11), ("top1_dn", 10), ("top2_dn", 9)]
    {
        is_near(bits, name, errors[bit] - gain * f64::from(1 << bit));
    }
}

/// Codes times 1.37, as of a digital gain, leave single codes out on one line of steps: a table would leave
/// out more of the bright ones.
#[test]
fn codes_times_a_number_are_a_digital_gain() {
    let model = unit(330);
    let d = verdict(with(model.clone(), "coarse-quantization", &[1.37, -0.2]), None);
    is_near(first(&d, "coarse-quantization", &model), "step_dn", 1.37);
}

/// Mains hum below one cycle a row: rolling bands are named interference and not row noise.
#[test]
fn hum_of_less_than_a_cycle_a_row_is_interference() {
    let model = unit(330);
    let per_px = 0.42 / model.camera.width as f64;
    let d = verdict(with(model.clone(), "periodic-interference", &[0.45, per_px, 0.05, 0.0]), None);
    let hum = first(&d, "periodic-interference", &model);
    is_near(hum, "amplitude_dn", 0.45);
    // Its phase from row to row.
    let down = |f: f64, blanking: f64| (f * model.camera.width as f64 + blanking).rem_euclid(1.0);
    let [f, blanking] = ["cycles_per_px", "blanking_cycles"].map(|name| hum.parameters[name].value);
    assert!((down(f, blanking) - 0.47).abs() < 2e-3, "{hum:#?}");
}

/// Jumping pixels: equal amplitudes in sets of three frames, and slow ones with exponential amplitudes.
/// Pixels with six times the read noise of others are not called telegraph noise.
#[test]
fn pixels_that_jump_are_told_from_noisy_ones() {
    let mut few = Plan::standard();
    few.full_exposure_s = Some(0.02);
    few.sets.iter_mut().for_each(|s| s.frames = 3);
    for (seed, values, plan) in [
        (340, [0.02, 10.0, 0.0, 0.0], Some(&few)),
        (341, [0.05, 7.0, 0.5, 1.0], None),
        (342, [0.02, 8.0, 0.0, 0.0], None),
    ] {
        let model = unit(seed);
        let [share, jump, stays, differ] = values;
        let amplitude_e = jump * model.base.read_noise_e;
        let d = verdict(
            with(model.clone(), "random-telegraph-noise", &[share, amplitude_e, stays, differ]),
            plan,
        );
        let rtn = first(&d, "random-telegraph-noise", &model);
        is_near(rtn, "amplitude_e", amplitude_e);
        is_near(rtn, "fraction", share);
    }
    let mut noisy = unit(345);
    (noisy.base.noisy_pixel_fraction, noisy.base.noisy_pixel_factor) = (0.01, 6.0);
    let d = verdict(noisy, None);
    assert!(d.consistent, "{:#?}", d.missing);
}

/// Mean of the last two frames, as firmware averages: the gain is that of single frames. A running average of
/// as much memory means another gain by tens of per cent.
#[test]
fn a_mean_of_the_last_frames_is_named() {
    let model = unit(332);
    let d = verdict(with(model.clone(), "temporal-filter", &[0.05, 3.0, 2.0]), None);
    let filter = first(&d, "temporal-filter", &model);
    let said = ["kept", "frames"].map(|name| filter.parameters[name].value);
    assert_eq!(said, [3.0, 2.0], "{filter:#?}");
    assert!(d.missing[1..].iter().all(|m| m.share < 1e-6), "{:#?}", d.missing);
}

/// Ripple of a supply where all columns of a row are converted at once: the same in a row, a sine down them,
/// of another phase in each frame. Before, it was row noise and something unknown.
#[test]
fn stripes_of_rows_in_the_dark_are_interference() {
    let model = unit(334);
    let d = verdict(with(model.clone(), "periodic-interference", &[0.3, 0.137, 0.0, 2.0]), None);
    let stripes = first(&d, "periodic-interference", &model);
    assert_eq!(stripes.parameters["shape"].value, 2.0, "{stripes:#?}");
    is_near(stripes, "amplitude_dn", 0.3);
    is_near(stripes, "cycles_per_px", 0.137);
    assert!(d.missing[1..].iter().all(|m| m.share < 0.01), "{:#?}", d.missing);
}

/// Daylight that fades by the same share each second, to a half over the flats. Before, it was flicker of a
/// size that nothing determines.
#[test]
fn light_that_fades_is_a_drift() {
    let model = unit(335);
    let d = verdict(with(model.clone(), "illumination-drift", &[2.0, -0.04, 0.0, 1.0]), None);
    let fades = first(&d, "illumination-drift", &model);
    assert_eq!(fades.parameters["shape"].value, 2.0, "{fades:#?}");
    is_near(fades, "rel_per_s", -0.04);
    assert!(d.missing[1..].iter().all(|m| m.share < 0.01), "{:#?}", d.missing);
}

/// Lag in sets of two frames, exposures in any order, and a lamp that warms up: each frame's deviation is
/// that of the level before, and no flicker, though a flicker excuses it.
#[test]
fn lag_in_sets_of_two_frames_is_no_flicker() {
    let exposures_ms = [8.0, 19.0, 14.0, 2.0, 19.0, 11.0, 17.0, 6.0, 4.0, 12.0, 9.0, 20.0, 16.0];
    let set = |kind: &str, exposure_s: f64, light: f64| {
        format!("[[set]]\nkind = \"{kind}\"\nframes = 2\nexposure_s = {exposure_s}\nillumination = {light}\n")
    };
    let flats = exposures_ms.iter().map(|ms| set("flat", ms / 1000.0, 1.0));
    let darks = [2.0, 20.0, 2.0, 20.0].map(|ms: f64| set("dark", ms / 1000.0, 0.0));
    let sets: String = flats.chain(darks).collect();
    let plan = Plan::from_toml(&format!("format = \"radcam-plan/1\"\n{sets}")).unwrap();
    let model = unit(296);
    let lag = with(model.clone(), "image-lag", &[0.0, 0.02, 1.0, 0.0, 1.0, 0.0]);
    let d = verdict(with(lag, "illumination-drift", &[0.0, -0.004, 0.0, 1.0]), Some(&plan));
    let named = ["image-lag", "temporal-filter"];
    assert!(named.contains(&d.missing[0].effect.as_str()), "{:#?}", d.missing);
    assert!(d.missing.iter().all(|m| m.effect != "illumination-flicker"), "{:#?}", d.missing);
}
