//! Excludes levels that the line cannot describe.

use super::Point;
use super::estimators::{residual_variance, reweighted};
use crate::dataset::Kind;
use crate::fit::line::fit;
use crate::number::{percent, with_error};
use crate::statistics::peak::{strays, turn_off};

/// Minimum run of adjacent levels on one side of the line that is a curve, and no outliers.
const CURVE: usize = 3;

/// Minimum distance of an outlier from the line of the other levels, in standard errors (a named choice).
const OFF_SIGMAS: f64 = 6.0;

/// Minimum level of the variance's peak at full well, as a share of the highest level: beyond the peak the
/// mean hardly rises (EMVA 1288 release 4, 6.5; a named choice).
const LEAST_PEAK: f64 = 0.5;

/// Excludes levels whose variance lies far above that of the levels around and could be mistaken for the
/// peak.
pub(super) fn exclude_strays(points: &mut [Point]) {
    let used: Vec<usize> = (0..points.len()).filter(|&i| points[i].excluded.is_none()).collect();
    let levels: Vec<(f64, f64)> = used.iter().map(|&i| (points[i].mean_dn, points[i].var_dn2)).collect();
    for k in strays(&levels) {
        points[used[k]].excluded = Some("its variance lies far above that of the levels around".into());
    }
}

/// Excludes levels beyond the variance's peak: the wells are full, and the light does not cause the variance.
pub(super) fn exclude_past_the_peak(points: &mut [Point]) {
    let error = |p: &Point| (2.0 / ((p.frames - 1.0) * (p.pixels - 1.0))).sqrt() * p.var_dn2;
    let usable = || points.iter().filter(|p| p.excluded.is_none());
    let Some(peak) = usable().max_by(|a, b| a.var_dn2.total_cmp(&b.var_dn2)).cloned() else { return };
    // A variance that falls over most of the range, or from dark to dark, is no full well.
    let highest = usable().map(|p| p.mean_dn).fold(0.0, f64::max);
    if peak.kind != Kind::Flat || peak.mean_dn < LEAST_PEAK * highest {
        return;
    }
    let levels: Vec<(f64, f64)> = usable().map(|p| (p.mean_dn, p.var_dn2)).collect();
    let fallen = |p: &Point| {
        let drop = peak.var_dn2 - p.var_dn2;
        let noise = (error(p).powi(2) + error(&peak).powi(2)).sqrt();
        p.mean_dn > peak.mean_dn && drop > 5.0 * noise && drop > 0.01 * peak.var_dn2
    };
    // Excludes levels from the first significant fall on, and those that turn before it.
    let first = usable().filter(|p| fallen(p)).map(|p| p.mean_dn).fold(f64::INFINITY, f64::min);
    let limit = turn_off(&levels).filter(|_| first.is_finite()).map_or(first, |t| first.min(t.0));
    for p in points.iter_mut().filter(|p| p.excluded.is_none() && (p.mean_dn >= first || p.mean_dn > limit)) {
        p.excluded = Some(format!(
            "past the variance's peak at {:.0} DN: the wells or the amplifier are full",
            peak.mean_dn
        ));
    }
}

/// Excludes single levels off the line of the others, but no curve. Returns a message.
pub(super) fn exclude_outliers(points: &mut [Point]) -> Option<String> {
    let most = points.iter().filter(|p| p.excluded.is_none()).count() / 5;
    let mut found: Vec<(usize, f64)> = Vec::new();
    let before: Vec<usize> = (0..points.len()).filter(|&i| points[i].excluded.is_none()).collect();
    while found.len() < most {
        let used: Vec<usize> = (0..points.len()).filter(|&i| points[i].excluded.is_none()).collect();
        if used.len() < 5 {
            break;
        }
        let Some(line) = reweighted(points) else { break };
        // Compares each level with the line of the others: residual over the root of its variance, both
        // corrected for the level's leverage h on the line.
        let z: Vec<f64> = used
            .iter()
            .map(|&i| {
                let p = &points[i];
                let variance = residual_variance(p, line.slope, line.intercept);
                let x = p.mean_dn;
                let of_line = line.var_slope * x * x + line.var_intercept + 2.0 * line.covariance * x;
                let h = (of_line / variance).min(0.999);
                (p.var_dn2 - line.at(x)) / (variance * (1.0 - h)).sqrt()
            })
            .collect();
        let mut sizes: Vec<f64> = z.iter().map(|z| z.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let median = sizes[sizes.len() / 2];
        let Some(worst) = (0..z.len()).max_by(|&a, &b| z[a].abs().total_cmp(&z[b].abs())) else { break };
        if z[worst].abs() < OFF_SIGMAS || z[worst].abs() < 5.0 * median {
            break;
        }
        found.push((used[worst], z[worst]));
        points[used[worst]].excluded =
            Some(format!("{:+.0} standard errors off the line of the others", z[worst]));
    }
    // Adjacent levels on one side of the line are its bend.
    let mut order = before;
    order.sort_by(|&a, &b| points[a].mean_dn.total_cmp(&points[b].mean_dn));
    let side = |i: usize| found.iter().find(|f| f.0 == i).map(|f| f.1 > 0.0);
    let is_curve =
        order.chunk_by(|&a, &b| side(a) == side(b)).any(|run| run.len() >= CURVE && side(run[0]).is_some());
    if is_curve || are_the_darks_off(points, &found) {
        found.iter().for_each(|f| points[f.0].excluded = None);
        return None;
    }
    let numbers: Vec<String> = found.iter().map(|f| points[f.0].set.to_string()).collect();
    (!numbers.is_empty()).then(|| {
        let (sets, stand) = if numbers.len() == 1 { ("set", "stands") } else { ("sets", "stand") };
        format!("{sets} {} {stand} off the line of the others: not used", numbers.join(", "))
    })
}

/// Returns true if the dimmest flat is among the outliers and lies on a line with the other flats: then the
/// darks are off, in black level, gain or noise.
fn are_the_darks_off(points: &[Point], found: &[(usize, f64)]) -> bool {
    let is_found = |i: usize| found.iter().any(|f| f.0 == i);
    let flats = || {
        let known = points.iter().enumerate().filter(|(i, p)| p.excluded.is_none() || is_found(*i));
        known.filter(|(_, p)| p.kind == Kind::Flat)
    };
    // A single dark that is off as well is an outlier: the others lie on the line.
    if found.iter().any(|f| points[f.0].kind == Kind::Dark) {
        return false;
    }
    let dimmest = flats().min_by(|a, b| a.1.mean_dn.total_cmp(&b.1.mean_dn)).map(|(i, _)| i);
    if !dimmest.is_some_and(is_found) || flats().count() <= CURVE {
        return false;
    }
    let mut alone: Vec<Point> = flats().map(|(_, p)| p.clone()).collect();
    alone.iter_mut().for_each(|p| p.excluded = None);
    reweighted(&alone).is_some_and(|line| {
        alone.iter().all(|p| {
            let variance = residual_variance(p, line.slope, line.intercept);
            (p.var_dn2 - line.at(p.mean_dn)).abs() < OFF_SIGMAS * variance.sqrt()
        })
    })
}

/// Minimum ratio of the gain's variance without the charge of the darks to that with it, at which the darks
/// decide the gain (a named choice).
const DARKS_DECIDE: f64 = 2.0;

/// Minimum unknown share of a flat's variance that is stated as the reason (a named choice).
const UNSURE: f64 = 0.05;

/// Excludes darks with charge if they would decide the gain, and returns a message: hot pixels and a moving
/// black level produce a level of a few DN too. The darkest stays.
pub(super) fn exclude_dark_charge(points: &mut [Point]) -> Option<String> {
    let line = reweighted(points)?;
    let used = || points.iter().enumerate().filter(|(_, p)| p.excluded.is_none());
    let is_dark = |(_, p): &(usize, &Point)| p.kind == Kind::Dark;
    let (darkest, _) = used().filter(is_dark).min_by(|a, b| a.1.mean_dn.total_cmp(&b.1.mean_dn))?;
    // Variance of the slope of the line through the selected levels.
    let of = |wanted: &dyn Fn(usize, &Point) -> bool| {
        let chosen = used().filter(|(i, p)| wanted(*i, p));
        let points: Vec<(f64, f64, f64)> = chosen
            .map(|(_, p)| (p.mean_dn, p.var_dn2, residual_variance(p, line.slope, line.intercept.max(0.0))))
            .collect();
        fit(points.into_iter()).map_or(f64::INFINITY, |line| line.var_slope)
    };
    let with = of(&|_, _| true);
    let without = of(&|i, p| p.kind == Kind::Flat || i == darkest);
    if !(without.is_finite() && without > DARKS_DECIDE * with) {
        return None;
    }
    let flats: Vec<&Point> = used().map(|(_, p)| p).filter(|p| p.kind == Kind::Flat).collect();
    let unsure = flats.iter().map(|p| p.var_unsure_dn2 / p.var_dn2).fold(0.0, f64::max);
    let gain = with_error(line.slope, with.sqrt());
    let sets = if flats.len() == 1 { "the set of flats hardly tells" } else { "the flats hardly tell" };
    let out: Vec<usize> =
        used().filter(|(i, p)| p.kind == Kind::Dark && *i != darkest).map(|(i, _)| i).collect();
    for i in out {
        points[i].excluded = Some("the charge of darks would decide the gain, and is no light".into());
    }
    let why = if unsure > UNSURE {
        format!(
            ": the frames of a set differ in light, which leaves {} of their variance unknown",
            percent(unsure)
        )
    } else {
        String::new()
    };
    Some(format!(
        "{sets} the gain{why}. The charge of the darks would make {gain} DN/e⁻ of it; that is the gain only if hot pixels, rays and the black \
         level have no part in it, and it is left out"
    ))
}
