//! Black-level clamp: the camera subtracts the dark charge of covered pixels.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};
use crate::rng::PixelRng;

/// The mean dark charge is subtracted from the black level; its shot noise stays.
pub struct BlackLevelClamp;

/// Minimum share of the dark charge that a clamp subtracts (a named choice): covered pixels have a dark
/// current of the order of that of the others.
const LEAST_SHARE: f64 = 0.1;
/// Tolerance of the subtracted charge, in standard errors.
const SURE: f64 = 2.0;

/// Draws a Poisson number by the product of uniform numbers (Knuth 1969, 3.4.1), or as a normal number at
/// large means.
fn poisson(mean: f64, random: &mut PixelRng) -> f64 {
    if mean > 40.0 {
        return (mean + mean.sqrt() * random.normal()).round().max(0.0);
    }
    let (limit, mut product, mut count) = (libm::exp(-mean), random.uniform(), 0.0);
    while product > limit {
        product *= random.uniform();
        count += 1.0;
    }
    count
}

impl Effect for BlackLevelClamp {
    fn id(&self) -> &'static str {
        "black-level-clamp"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["black level", "clamp", "optical black"]
    }

    fn stage(&self) -> Stage {
        Stage::Charge
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter {
            name: "dark_e_per_s",
            meaning: "dark charge per second that is taken off the level of every frame",
            unit: "e/s",
            min: 0.0,
            max: 1e6,
            starts: &[1.0, 100.0],
        }]
    }

    /// Darks cut off at code 0 have neither the mean nor the noise of their charge.
    fn is_another(&self, _: &[f64], seen: &Seen) -> bool {
        seen.darkest_code.is_some_and(|code| code <= 1.0)
    }

    fn contradicted(&self, p: &[f64], std_err: &[f64], seen: &Seen) -> Option<&'static str> {
        let most = p[0] + SURE * std_err[0];
        (most < LEAST_SHARE * (most + seen.dark_e_per_s)).then_some(
            "the level of darks grows with the exposure by more than would be taken off, and covered pixels have the dark current of the others",
        )
    }

    fn shows_in_darks(&self) -> bool {
        true
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![3.0 * plain.noise_e * plain.noise_e / (16.0 * plain.bright_s)])
    }

    fn page(&self) -> Page {
        Page {
            what: "The sensor measures covered pixels and takes their level off every frame, dark charge included: the level of darks does not grow \
                   with the exposure, and may fall, while their noise does.",
            equation: "q + Poisson(d T) - d T: mean unchanged, variance + d T (T the exposure, d the dark charge per second that is taken off)",
            signature: "variance of darks grows with the exposure by more than their mean accounts for; flats of one exposure do not move",
            look_alikes: "read noise that grows with time does so in short exposures too; a light leak moves the mean of darks",
            remedy: "the dark current is that of the variance (EMVA 1288 release 4, section 7.1: by variance where the mean is compensated); switch the \
                     clamp (BlackLevelAuto) off where the camera allows it",
            measure: "darks at several exposures up to the longest: mean and variance of each",
            sets: takes::LONG,
            source: "EMVA 1288 release 4, section 7.1 (dark current compensation)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        for (s, set) in out.sets.iter_mut().zip(&c.sets) {
            s.shot.add_white(p[0] * set.exposure_s);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let mean = p[0] * d.exposure_s;
        let columns = d.image.ncols();
        let frame = d.frame;
        for y in 0..d.image.nrows() {
            for x in 0..columns {
                let mut random = d.random(self.id(), frame, (y * columns + x) as u32);
                d.image[(y, x)] += poisson(mean, &mut random) - mean;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clamp subtracts at least a tenth of the dark charge, within two standard errors.
    #[test]
    fn a_small_part_of_the_dark_charge_is_no_clamp() {
        let of = |taken: f64, std_err: f64, left: f64| {
            let seen = Seen { dark_e_per_s: left, ..Seen::default() };
            BlackLevelClamp.contradicted(&[taken], &[std_err], &seen).is_some()
        };
        assert!(of(3.0, 0.8, 43.0));
        assert!(!of(343.0, 41.0, 290.0) && !of(0.2, 0.02, -0.1) && !of(5.0, 1.0, 0.0));
        // Too few frames to tell.
        assert!(!of(3.0, 6.0, 43.0));
        // Darks cut off at code 0 tell nothing of a clamp.
        let cut = Seen { darkest_code: Some(0.0), dark_e_per_s: 5.0, ..Seen::default() };
        assert!(
            BlackLevelClamp.is_another(&[5.0], &cut) && !BlackLevelClamp.is_another(&[5.0], &Seen::default())
        );
    }
}
