//! Tests of the noise over the level, sigma^2 = A mu + sigma_C^2 (Healey and Kondepudy 1994, eq. 41):
//! residuals of single sets that are too small to show add up over all sets.

use super::fit::{Fitted, halves};
use super::judge::{SLACK_OF_MEAN, SLACK_OF_SQUARES};
use super::layout::Layout;
use super::settings::Test;
use super::start::has_flats;
use crate::observables::{Observations, lightened, variance};
use radcam_sim::effects::Stage;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Name of the test of a bend.
const BEND: &str = "bend of the noise over the level";
/// Name of the test of the sum of squares.
const SQUARES: &str = "squares of the noise of all levels";

/// Noise of a set.
struct Point {
    /// Its level above black, DN.
    level_dn: f64,
    /// Error of its variance, DN^2.
    std_err_dn2: f64,
    /// Its residual over that error.
    z: f64,
}

/// Tests the bend of the noise over the level and the sum of squares of its residuals, with all frames in the
/// fit. Returns no test for a model that changes codes. `levels`: mean of every set above black, DN.
pub(super) fn tests(all: &Observations, model: &Fitted, levels: &[f64]) -> Vec<Test> {
    // A table of whole codes doubles and leaves out codes. The noise of a level then depends on their places
    // by some per cent that no prediction has (gamma of 0.99, noise of 8 DN: 3 %).
    if model.effects.iter().any(|(e, values)| e.stage_with(values) >= Stage::Converter) {
        return Vec::new();
    }
    let layout = Layout::new(all, &halves(None), model.free.effects.iter());
    let state = layout.at(&model.free, &model.point);
    let rows = layout.rows.iter().zip(&state.expected);
    let points: Vec<Point> = rows
        .filter(|(o, _)| o.is(&variance::Variance))
        .filter_map(|(o, e)| {
            let z = if e.heavy { lightened(e.z()) } else { e.z() };
            let known = z.is_finite() && e.std_err.is_finite() && e.std_err > 0.0;
            known.then_some(Point { level_dn: levels[o.set?], std_err_dn2: e.std_err, z })
        })
        .collect();
    let fitted = if has_flats(all) { 2.0 } else { 1.0 };
    [bend(&points), squares(&points, fitted)].into_iter().flatten().collect()
}

/// Tests the part of the residuals that grows with the squared level, orthogonal to the level and to a
/// constant, which gain and read noise follow.
fn bend(points: &[Point]) -> Option<Test> {
    let top = points.iter().map(|p| p.level_dn.abs()).fold(0.0, f64::max);
    let column = |power: i32| -> Vec<f64> {
        points.iter().map(|p| (p.level_dn / top).powi(power) / p.std_err_dn2).collect()
    };
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    // Gram and Schmidt.
    let mut units: Vec<Vec<f64>> = Vec::new();
    for power in 0..3 {
        let whole = column(power);
        let mut left = whole.clone();
        for unit in &units {
            let along = dot(&left, unit);
            left.iter_mut().zip(unit).for_each(|(l, u)| *l -= along * u);
        }
        let (length, was) = (dot(&left, &left).sqrt(), dot(&whole, &whole).sqrt());
        if !length.is_finite() || length <= LEAST_LEFT * was {
            return None;
        }
        units.push(left.into_iter().map(|l| l / length).collect());
    }
    let measured = dot(&units[2], &points.iter().map(|p| p.z).collect::<Vec<_>>());
    let z = measured / SLACK_OF_MEAN;
    Some(Test { name: BEND.into(), measured, predicted: 0.0, std_err: SLACK_OF_MEAN, z })
}

/// Tests the sum of squares over the degrees of freedom. `fitted`: number of fitted parameters.
fn squares(points: &[Point], fitted: f64) -> Option<Test> {
    let dof = points.len() as f64 - fitted;
    let chi2 = ChiSquared::new(dof).ok().filter(|_| dof >= 1.0)?;
    let square: f64 = points.iter().map(|p| p.z * p.z).sum();
    Some(Test {
        name: SQUARES.into(),
        measured: square / dof,
        predicted: 1.0,
        std_err: (2.0 / dof).sqrt(),
        z: super::settings::as_z(chi2.sf(square / SLACK_OF_SQUARES)),
    })
}

/// Minimum part of a column that the columns before do not contain; with less, levels and darks do not tell
/// them apart (a named choice, far above rounding).
const LEAST_LEFT: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Sixteen sets from dark to 4000 DN whose residuals are normal and have a bend of this many standard
    /// errors at the top.
    fn points(seed: u64, bend: f64) -> Vec<Point> {
        let at = |k: usize| {
            let level_dn = 4000.0 * k as f64 / 15.0;
            let x = level_dn / 4000.0;
            let z = PixelRng::new(seed, Stream::Effect, 0, k as u32, 0).normal() + bend * x * (2.0 * x - 1.0);
            Point { level_dn, std_err_dn2: 0.02 + 1e-3 * level_dn, z }
        };
        (0..16).map(at).collect()
    }

    /// Over 4000 draws of normal residuals the bend has unit deviation before the slack, and the squares
    /// exceed 2.6 standard errors (chance 1 %) in no more than 1 %; tolerance five standard errors. A real
    /// bend is found.
    #[test]
    fn tests_of_the_noise_have_their_chances() {
        let n = 4000;
        let bends = (0..n).map(|seed| bend(&points(seed, 0.0)).unwrap().z * SLACK_OF_MEAN);
        let rms = (bends.map(|z| z * z).sum::<f64>() / n as f64).sqrt();
        assert!((rms - 1.0).abs() < 5.0 / (2.0 * n as f64).sqrt(), "{rms}");
        let far = (0..n).filter(|seed| squares(&points(*seed, 0.0), 0.0).unwrap().z > 2.576).count() as f64;
        assert!(far < 40.0 + 5.0 * 40f64.sqrt(), "{far}");
        let found = (0..100).filter(|seed| bend(&points(*seed, 30.0)).unwrap().z.abs() > 4.0).count();
        assert!(found >= 95, "{found}");
        assert!(bend(&points(0, 0.0)[..2]).is_none() && squares(&[], 2.0).is_none());
    }
}
