//! Shares of the misfit: of each effect, and of what is left.

use super::{Cost, HOLDS, Part, cost, signatures};
use crate::agreement::P_LIMIT;
use crate::inference::{Comparison, Fitted, Residual};
use crate::observables::Observations;
use serde::{Deserialize, Serialize};

/// Minimum share of the misfit for a remainder to matter; a smaller one is not held against a name. With
/// enough frames every model is rejected (of 202 cameras of an outside generator, those with an effect of the
/// catalogue leave less in 11 of 12 that significance would call unknown).
pub(super) const MATTERS: f64 = 0.01;
/// Minimum share of the misfit for the remainder to be the larger part, and to stand first.
const LARGER_PART: f64 = 0.5;
/// Minimum ratio of the remainder to the largest share of a name for it to stand first (a named choice):
/// several names of a quarter each that leave as much are parts of something else.
const AS_LARGE: f64 = 0.75;

/// The misfit that is left with all named effects in the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Remainder {
    /// Share of the misfit of the model as given.
    pub share: f64,
    /// Error with all names in the model.
    pub error: f64,
    /// Chance of such residuals.
    pub p_value: f64,
    /// The statistics that deviate most.
    pub largest: Vec<String>,
    /// Errors of gain, read noise and linearity where the effect is ignored.
    pub cost: Cost,
}

/// Computes the misfit: the squared error above the noise.
fn misfit(c: &Comparison) -> f64 {
    (c.error * c.error - 1.0).max(0.0)
}

/// Returns the remainder; `None` if it is within the noise. `nothing`: no effect was added to the model.
pub(super) fn remainder(
    all: &Observations,
    whole: &Fitted,
    [first, last]: [&Comparison; 2],
    nothing: bool,
) -> Option<Remainder> {
    // Names must hold; the model as given must only not fail.
    if last.p_value >= if nothing { P_LIMIT } else { HOLDS } {
        return None;
    }
    let share = if nothing { 1.0 } else { misfit(last) / misfit(first).max(misfit(last)).max(1e-9) };
    Some(Remainder {
        share,
        error: last.error,
        p_value: last.p_value,
        largest: signatures(&last.residuals).into_iter().take(4).map(|s| s.text).collect(),
        cost: cost::of_remainder(all, whole),
    })
}

/// Place of `unknown` in the list.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Place {
    First,
    Last,
    Nowhere,
}

/// Error above which all names together do not describe the campaign, whatever their share (a named choice:
/// of 235 campaigns with the right names the largest error is 1.7, and samples at both ends of the codes
/// leave 1438).
const HOPELESS: f64 = 10.0;
/// Maximum error, and maximum share of the error without names, with names that describe a campaign (named
/// choices: wrong names leave 3.0 of 10.7 of salt and pepper, the right one 1.8 of 20 of companding).
const MAX_LEFT: (f64, f64) = (2.5, 0.1);

/// Returns the place of `unknown`. `doubt`: reason against the strongest name; `left`: share of the
/// remainder, and the largest share of a name; the errors without a name and with all of them in the model.
pub(super) fn place_of_unknown(
    parts: &[Part],
    doubt: Option<&str>,
    (left, largest): (f64, f64),
    [before, error]: [f64; 2],
) -> Place {
    let hopeless = error > HOPELESS || (error > MAX_LEFT.0 && error > MAX_LEFT.1 * before);
    let better = parts.first().is_some_and(|p| p.better().is_some());
    match left {
        _ if parts.is_empty() && left > 0.0 || doubt.is_some() || better => Place::First,
        left if left >= LARGER_PART || hopeless => Place::First,
        left if left >= MATTERS && left >= AS_LARGE * largest => Place::First,
        left if left >= MATTERS => Place::Last,
        _ => Place::Nowhere,
    }
}

/// Computes the share of each part in what all of them explain: growth of the sum of squares without it.
/// `fitted`: residuals with all of them.
pub(super) fn shares(parts: &[Part], fitted: &[Residual]) -> Vec<f64> {
    let squares = |residuals: &[Residual]| residuals.iter().map(|r| r.z * r.z).sum::<f64>();
    let with = squares(fitted);
    let each: Vec<f64> = parts.iter().map(|p| (squares(&p.without) - with).max(1e-9)).collect();
    let sum: f64 = each.iter().sum();
    each.iter().map(|e| e / sum).collect()
}

#[cfg(test)]
mod tests {
    use super::{Place, place_of_unknown};

    /// `unknown` stands first without any name, against a name in doubt, and if no name brings the error
    /// down.
    #[test]
    fn a_remainder_has_its_place() {
        let place = |share, error| place_of_unknown(&[], None, (share, 0.9), [60.0, error]);
        assert_eq!(place(0.001, 1.0), Place::First);
        assert_eq!(place_of_unknown(&[], Some("its frames swing"), (0.0, 1.0), [2.0, 1.0]), Place::First);
        assert_eq!((place(0.0, 1.1), place(0.0, 11.0)), (Place::Nowhere, Place::First));
        assert_eq!((place(0.0, 3.5), place(0.0, 6.5)), (Place::Nowhere, Place::First));
        // Names of a quarter each, and as much left.
        assert_eq!(place_of_unknown(&[], None, (0.0, 0.24), [1.3, 1.07]), Place::Nowhere);
    }
}
