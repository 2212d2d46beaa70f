//! `unknown` as a model among models: each statistic deviates by a smooth function of the level without a
//! name.
//!
//! Kennedy and O'Hagan 2001, J. R. Statist. Soc. B 63, 425 (section 4): a discrepancy function with a prior
//! of its own stands beside the physics, and its evidence tells whether the physics is enough. Here the
//! function is a sum of cosines of the level's rank. The variances of its weights fall as 1 / (1 + k^2), so
//! that its evidence has a closed form (linear model with a normal prior: Bishop 2006, eq. 3.86).
//! Alternatively every set deviates by a number of its own, which both halves of its frames show.

use crate::fit::cholesky::Factor;
use crate::inference::Residual;
use crate::observables::Statistic;
use crate::observables::from_set_to_set::FromSetToSet;
use std::collections::BTreeMap;

/// Number of cosines, including the constant.
const TERMS: usize = 5;
/// Tested sizes of the function, in standard errors of a residual.
const SIZES: [f64; 12] = [0.15, 0.3, 0.6, 1.2, 2.5, 5.0, 10.0, 30.0, 100.0, 300.0, 1e3, 1e4];

/// Computes the evidence (twice the logarithm of a Bayes factor) for such a function or such numbers, summed
/// over the statistics of sets that gain by it. Each pays for its size by BIC.
pub fn evidence(residuals: &[Residual], observations: f64) -> f64 {
    let mut of: BTreeMap<&str, Vec<&Residual>> = BTreeMap::new();
    residuals.iter().for_each(|r| of.entry(r.observable.as_str()).or_default().push(r));
    // Statistics of the whole campaign have one value in each half, and no level. Frames that are alike are
    // no function of the level.
    let has_levels = |r: &&Residual| r.set.is_some() && r.statistic != FromSetToSet.id();
    let of_levels = of.values().filter(|rows| rows.iter().any(has_levels));
    of_levels.map(|rows| (smooth(rows).max(of_sets(rows)) - observations.ln()).max(0.0)).sum()
}

/// Computes the evidence that every set has a number of its own, normal with the variance q in squares of the
/// error. For k residuals with the sum s it is q s^2 / (1 + k q) - ln(1 + k q) (the same closed form with one
/// term: Bishop 2006, eq. 3.86).
fn of_sets(rows: &[&Residual]) -> f64 {
    let mut sets: BTreeMap<Option<u32>, (f64, f64)> = BTreeMap::new();
    for r in rows {
        let (k, sum) = sets.entry(r.set).or_default();
        (*k, *sum) = (*k + 1.0, *sum + r.z);
    }
    let gain = |size: f64| {
        let q = size * size;
        sets.values().map(|(k, s)| q * s * s / (1.0 + k * q) - (k * q).ln_1p()).sum::<f64>()
    };
    SIZES.into_iter().map(gain).fold(0.0, f64::max)
}

/// Computes the evidence that the residuals deviate by a sum of cosines of the level's rank, with normal
/// weights.
fn smooth(rows: &[&Residual]) -> f64 {
    let mut order: Vec<&&Residual> = rows.iter().collect();
    order.sort_by(|a, b| a.level_dn.total_cmp(&b.level_dn));
    let (mut squares, mut with) = ([[0.0; TERMS]; TERMS], [0.0; TERMS]);
    for (rank, r) in order.iter().enumerate() {
        let at = terms((rank as f64 + 0.5) / order.len() as f64);
        for i in 0..TERMS {
            with[i] += at[i] * r.z;
            for j in 0..TERMS {
                squares[i][j] += at[i] * at[j];
            }
        }
    }
    SIZES.into_iter().map(|size| gain(&squares, &with, size * size)).fold(0.0, f64::max)
}

/// Returns the cosines at a rank from 0 to 1, scaled by the decay of their weights.
fn terms(rank: f64) -> [f64; TERMS] {
    std::array::from_fn(|k| (std::f64::consts::PI * k as f64 * rank).cos() / (1.0 + (k * k) as f64).sqrt())
}

/// Computes the evidence of weights with this variance: w' (S + 1 / v)^-1 w - ln det(1 + v S), with S the
/// products of the terms and w their products with the residuals (Bishop 2006, eq. 3.86).
fn gain(squares: &[[f64; TERMS]; TERMS], with: &[f64; TERMS], variance: f64) -> f64 {
    let own = |i: usize, j: usize| if i == j { 1.0 / variance } else { 0.0 };
    let a: Vec<f64> =
        (0..TERMS * TERMS).map(|k| squares[k / TERMS][k % TERMS] + own(k / TERMS, k % TERMS)).collect();
    let Some(factor) = Factor::of(&a, TERMS) else { return 0.0 };
    let log_det = factor.ln_determinant() + TERMS as f64 * variance.ln();
    let mut solved = with.to_vec();
    factor.solve(&mut solved);
    solved.iter().zip(with).map(|(s, w)| s * w).sum::<f64>() - log_det
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observables::mean;
    use radcam_sim::rng::{PixelRng, Stream};

    fn rows(seed: u64, off: impl Fn(f64) -> f64) -> Vec<Residual> {
        let row = |i: u32| Residual {
            observable: format!("statistic {}", i % 4),
            set: Some(i / 4),
            measured: 0.0,
            predicted: 0.0,
            std_err: 1.0,
            z: PixelRng::new(seed, Stream::Effect, 0, i, 0).normal()
                + if i.is_multiple_of(4) { off(f64::from(i) / 200.0) } else { 0.0 },
            independent_z: 0.0,
            level_dn: f64::from(i / 4),
            statistic: mean::Mean.id().into(),
            meaning: mean::Mean.meaning(0).into(),
            unit: "".into(),
        };
        (0..200).map(row).collect()
    }

    /// At most two of 200 lists of pure noise show anything; a bend of three standard errors is seen in each.
    #[test]
    fn noise_is_no_function_and_a_bend_is() {
        let seen =
            |off: &dyn Fn(f64) -> f64| (0..200).filter(|s| evidence(&rows(*s, off), 200.0) > 9.0).count();
        assert!(seen(&|_| 0.0) <= 2);
        assert_eq!(seen(&|u| 3.0 * (2.0 * u - 1.0)), 200);
        // Alternation from set to set is no smooth function, but it is a number of each set.
        let apart = |u: f64| if ((200.0 * u) as u32 / 4).is_multiple_of(2) { 6.0 } else { -6.0 };
        assert_eq!(seen(&apart), 200);
    }
}
