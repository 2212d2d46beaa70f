//! Cause of a set's level that does not fit its setting, from the noise: a wrong label has the noise of
//! its level, another black level that of the stated light, another gain scales both; codes of fewer
//! bits are 1/2, 1/4 and so on of the expected ones, black level included.

use super::campaign::{Campaign, Zero};
use super::transfer::Transfer;
use crate::number::six_digits;
use crate::statistics::quantisation::QUANTISATION_DN2;

/// Minimum improvement of chi^2 of the noise by another cause over a wrong label, which is the usual
/// fault; and maximum deviation of the noise from that cause, standard deviations.
const BY_USUAL_ERROR: (f64, f64) = (6.0, 6.0);
/// The corresponding limits if the error is the scatter of the other sets about their curve alone (named
/// choices).
const BY_OWN_SCATTER: (f64, f64) = (12.0, 3.0);
/// Minimum significance with which the noise excludes another black level, in usual errors.
const MIN_SIGMAS_AGAINST: f64 = 2.5;
/// Range of bits that a set may lack.
const FEWER_BITS: std::ops::RangeInclusive<u32> = 1..=8;
/// Maximum deviation from the level of fewer bits, relative to that of the setting, and in codes:
/// truncation loses up to one.
const SAME_LEVEL: (f64, f64) = (0.01, 1.0);
/// Maximum relative deviation from the variance of fewer bits (a named choice).
const SAME_NOISE: f64 = 0.3;

/// Set whose level does not fit its setting.
#[derive(Debug, Clone, Copy)]
pub struct Stray {
    /// Index of the set.
    pub set: usize,
    /// Level above black, DN.
    pub above_dn: f64,
    /// Logarithm of the ratio of the level to that of the setting.
    pub off: f64,
}

/// Cause of a stray level.
pub enum Reason {
    /// Other settings of the camera, with a description.
    Other(String),
    /// Wrong label; or another black level, with a description, if the noise does not exclude it.
    Label(Option<String>),
}

impl Stray {
    /// Returns the level of the setting above black, DN.
    pub fn expected_dn(&self) -> f64 {
        self.above_dn * (-self.off).exp()
    }

    /// Returns the cause indicated by the noise.
    pub fn reason(&self, campaign: &Campaign<'_>, zero: &Zero, transfer: Option<&Transfer>) -> Reason {
        let Some(transfer) = transfer else { return Reason::Label(None) };
        let level = format!(
            "{} DN above black, {:+.1} % from the {} DN of its setting",
            six_digits(self.above_dn),
            100.0 * self.off.exp_m1(),
            six_digits(self.expected_dn())
        );
        if let Some(bits) = self.fewer_bits(campaign, zero, transfer) {
            return Reason::Other(format!(
                "{bits} bits less than the other sets: codes and noise are {} of what its setting makes",
                ["a half", "a quarter", "an eighth"]
                    .get(bits as usize - 1)
                    .map_or_else(|| format!("1/{}", 1u64 << bits), |part| (*part).to_owned())
            ));
        }
        let noise = |above_dn: f64| {
            let usual = transfer.off(campaign, self.set, above_dn)?;
            Some([usual, transfer.off_by_scatter(campaign, self.set, above_dn)?])
        };
        let Some((own, stated)) = noise(self.above_dn).zip(noise(self.expected_dn())) else {
            return Reason::Label(None);
        };
        let black_level = format!(
            "black level {} DN {}",
            six_digits((self.above_dn - self.expected_dn()).abs()),
            if self.off > 0.0 { "higher" } else { "lower" }
        );
        let z = |o: f64, std: f64| (o / std).abs();
        for ((limits, own), stated) in [BY_USUAL_ERROR, BY_OWN_SCATTER].into_iter().zip(own).zip(stated) {
            let (label, black) = (z(own.0, own.1), z(stated.0, stated.1));
            // The noise of another gain grows with its square.
            let gain = z(stated.0 - 2.0 * self.off, stated.1);
            let better = |z: f64| z < limits.1 && label * label - z * z > limits.0;
            if better(black) && black <= gain {
                return Reason::Other(format!(
                    "{black_level} than in the other sets: {level}, and the noise is that of the stated light"
                ));
            } else if better(gain) {
                return Reason::Other(format!(
                    "another gain, {} times that of the other sets: {level}, and the noise grew with it",
                    six_digits(self.off.exp())
                ));
            }
        }
        let excluded = z(stated[0].0, stated[0].1).max(z(stated[1].0, stated[1].1)) > MIN_SIGMAS_AGAINST;
        Reason::Label((!excluded).then_some(black_level))
    }

    /// Returns the number of missing bits, if codes and noise of the set are those of its setting
    /// shifted.
    fn fewer_bits(&self, campaign: &Campaign<'_>, zero: &Zero, transfer: &Transfer) -> Option<u32> {
        let set = &campaign.sets[self.set];
        let (variance_dn2, _) = set.variance_dn2()?;
        let whole_dn = zero.at(set.exposure_s) + self.expected_dn();
        let whole_dn2 = transfer.expected_dn2(self.expected_dn() + zero.at(set.exposure_s) - zero.dn).0;
        FEWER_BITS.into_iter().find(|bits| {
            let part = f64::from(1u32 << bits).recip();
            let level = set.level_dn() - part * whole_dn;
            let noise_dn2 = part * part * whole_dn2 + QUANTISATION_DN2;
            (-SAME_LEVEL.1 - SAME_LEVEL.0 * part * whole_dn..SAME_LEVEL.0 * part * whole_dn + 0.1)
                .contains(&level)
                && (variance_dn2 / noise_dn2 - 1.0).abs() < SAME_NOISE
        })
    }
}
