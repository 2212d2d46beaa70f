//! Why the level of one set is not that of its setting. Its noise tells: a wrong label leaves the noise of its
//! level, another black level that of the stated light, another gain scales both; codes of fewer bits are a half,
//! a quarter and so on of what they would be, black level and all.

use super::campaign::{Campaign, Zero};
use super::transfer::Transfer;
use crate::number::six_digits;
use crate::statistics::quantisation::QUANTISATION_DN2;

/// Square of standard deviations by which another reason must fit the noise better than a wrong label does, which
/// is the usual slip; and standard deviations within which it must fit it.
const BY_USUAL_ERROR: (f64, f64) = (6.0, 6.0);
/// Limits of these by the scatter of the other sets about their curve alone (named choices).
const BY_OWN_SCATTER: (f64, f64) = (12.0, 3.0);
/// Standard deviations of the usual error by which the noise excludes another black level.
const MIN_SIGMAS_AGAINST: f64 = 2.5;
/// Bits that a set may have less than the others.
const FEWER_BITS: std::ops::RangeInclusive<u32> = 1..=8;
/// Largest deviation from the level of fewer bits, relative to that of the setting, and in codes: cut off, these
/// lose up to one.
const SAME_LEVEL: (f64, f64) = (0.01, 1.0);
/// Largest deviation from the variance of fewer bits, relative (a named choice).
const SAME_NOISE: f64 = 0.3;

/// Set off the level of its setting.
#[derive(Debug, Clone, Copy)]
pub struct Stray {
    /// Place of the set.
    pub set: usize,
    /// Level above black, DN.
    pub above_dn: f64,
    /// Logarithm of the ratio of that to the level of the setting.
    pub off: f64,
}

/// Why.
pub enum Reason {
    /// Other settings of the camera, in words.
    Other(String),
    /// A wrong label; or another black level, in words, where the noise does not exclude that.
    Label(Option<String>),
}

impl Stray {
    /// Level of the setting above black, DN.
    pub fn expected_dn(&self) -> f64 {
        self.above_dn * (-self.off).exp()
    }

    /// Reason for which the noise speaks.
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
            // Noise of another gain grows with its square.
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

    /// Bits that the set lacks: its codes, and its noise, are those of its setting shifted.
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
