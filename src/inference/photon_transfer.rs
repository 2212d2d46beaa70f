//! Tests of the noise over the level: what each set's own residual is too small to show, all of them together do.

use super::fit::{Fitted, halves};
use super::judge::SLACK_OF_SQUARES;
use super::layout::Layout;
use super::settings::Test;
use crate::observables::{Observations, lightened, variance};
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

/// Deviation of a test in words, by its name.
pub(super) fn words(name: &str) -> Option<&'static str> {
    match name {
        BEND => Some("the noise over the level is bent: no one gain and read noise make it"),
        SQUARES => Some("the noise of the levels scatters about what one gain and read noise make"),
        _ => None,
    }
}

/// Bend of the noise over the level and the sum of squares of its residuals, with all frames in the fit.
/// `levels`: mean of every set above black, DN.
pub(super) fn tests(all: &Observations, model: &Fitted, levels: &[f64]) -> Vec<Test> {
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
    [bend(&points), squares(&points)].into_iter().flatten().collect()
}

/// Part of the residuals that goes with the square of the level, and with neither the level nor a constant, which
/// gain and read noise follow.
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
        if !(length > LEAST_LEFT * was) {
            return None;
        }
        units.push(left.into_iter().map(|l| l / length).collect());
    }
    let z = dot(&units[2], &points.iter().map(|p| p.z).collect::<Vec<_>>());
    Some(Test { name: BEND.into(), measured: z, predicted: 0.0, std_err: 1.0, z })
}

/// Sum of the squares over their number, of which the fit took two.
fn squares(points: &[Point]) -> Option<Test> {
    let dof = points.len() as f64 - 2.0;
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

/// Part of a column below which levels and darks do not tell it from the ones before (a named choice, far above
/// rounding).
const LEAST_LEFT: f64 = 1e-3;
