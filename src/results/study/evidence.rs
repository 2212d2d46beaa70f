//! Measured and predicted statistics as curves over the level.

use super::Judgement;
use crate::dataset::Kind;
use crate::diagnosis::signatures;
use crate::inference::{Comparison, Residual};
use crate::number::pretty;
use crate::observables::{Observations, covariance, variance};
use crate::plot::{Plot, Shape, axis, level, series};
use crate::statistics::covariance::LAGS;

/// One statistic in one set, with both halves of its frames combined.
#[derive(Debug, Clone, PartialEq)]
pub struct Level {
    /// Number of the set.
    pub set: u32,
    /// Mean above the black level, DN.
    pub level_dn: f64,
    /// Measured value.
    pub measured: f64,
    /// Value predicted by the model.
    pub predicted: f64,
    /// Standard error of the difference.
    pub std_err: f64,
}

/// Returns the names of the statistics of a comparison, in order.
pub fn statistics(c: &Comparison) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for r in &c.residuals {
        if !names.contains(&&*r.observable) {
            names.push(&r.observable);
        }
    }
    names
}

/// Returns a statistic for every set, halves weighted equally, sorted by level.
pub fn of_statistic(c: &Comparison, name: &str) -> Vec<Level> {
    let mut out: Vec<(Level, f64)> = Vec::new();
    for r in c.residuals.iter().filter(|r| r.observable == name) {
        let Some(set) = r.set else { continue };
        match out.iter_mut().find(|(l, _)| l.set == set) {
            Some((l, n)) => {
                l.measured += r.measured;
                l.predicted += r.predicted;
                l.std_err = l.std_err.hypot(r.std_err);
                *n += 1.0;
            }
            None => out.push((
                Level {
                    set,
                    level_dn: r.level_dn,
                    measured: r.measured,
                    predicted: r.predicted,
                    std_err: r.std_err,
                },
                1.0,
            )),
        }
    }
    let mut all: Vec<Level> = out
        .into_iter()
        .map(|(l, n)| Level {
            measured: l.measured / n,
            predicted: l.predicted / n,
            std_err: l.std_err / n,
            ..l
        })
        .collect();
    all.sort_by(|a, b| a.level_dn.total_cmp(&b.level_dn));
    all
}

/// Minimum number of sets for a curve over the level.
const CURVE: usize = 3;

/// Returns the deciding statistic: the largest deviation from the model as given whose excess falls below
/// half with the effects found.
fn deciding(j: &Judgement) -> Option<String> {
    let (first, last) = (j.comparisons.first()?, j.comparisons.last()?);
    let left = signatures(&last.residuals);
    let mended = |name: &str, excess: f64| left.iter().all(|l| l.name != name || l.excess < 0.5 * excess);
    let all = signatures(&first.residuals);
    let mut curves = all.iter().filter(|s| of_statistic(first, &s.name).len() >= CURVE);
    let alone = j.comparisons.len() < 2;
    let best = curves.clone().find(|s| alone || mended(&s.name, s.excess)).or_else(|| curves.next())?;
    Some(best.name.clone())
}

/// Plots the deciding statistic: measured values, and predictions before and after the effects found.
///
/// There are two plots: in its unit, to show its growth, and in standard errors, to show its significance.
pub fn decisive(j: &Judgement) -> Vec<Plot> {
    let Some(name) = deciding(j) else { return Vec::new() };
    plot_of(j, &name).into_iter().chain(in_errors(j, &name)).collect()
}

/// Like [`plot_of`], in standard errors.
fn in_errors(j: &Judgement, name: &str) -> Option<Plot> {
    let before = of_statistic(j.comparisons.first()?, name);
    let mut plot = plot_of(j, name)?;
    for s in &mut plot.series {
        for p in &mut s.points {
            // Sets at one level have equal standard errors.
            let std_err = before.iter().find(|l| l.level_dn == p[0]).map_or(1.0, |l| l.std_err);
            (p[1], p[2]) = (p[1] / std_err, p[2] / std_err);
        }
    }
    plot.id = format!("{}-in-errors", plot.id).into();
    plot.title = format!("{name}, in standard errors").into();
    plot.y = axis("deviation, standard errors");
    Some(plot)
}

/// Plots one statistic: measured values and predictions with all effects found, both minus the prediction of
/// the model as given.
pub fn plot_of(j: &Judgement, name: &str) -> Option<Plot> {
    let (first, last) = (j.comparisons.first()?, j.comparisons.last()?);
    let before = of_statistic(first, name);
    let unit = unit_of(&first.residuals, name);
    let end = before.last()?.level_dn;
    let measured = before.iter().map(|l| [l.level_dn, l.measured - l.predicted, l.std_err]).collect();
    let mut all =
        vec![series("measured", Shape::Points, measured), level("the model as given", 0.0, end.max(0.0))];
    if j.comparisons.len() > 1 {
        let after = of_statistic(last, name);
        let expected = after
            .iter()
            .filter_map(|l| {
                let b = before.iter().find(|b| b.set == l.set)?;
                Some([b.level_dn, l.predicted - b.predicted, f64::NAN])
            })
            .collect();
        let added: Vec<&str> = j.ladder.iter().filter_map(|r| r.added.as_deref()).collect();
        let label = if added.is_empty() {
            "the model with what was found".into()
        } else {
            format!("with {}", added.join(", "))
        };
        all.push(series(label, Shape::Line, expected));
    }
    Some(Plot {
        id: format!("statistic-{}", slug(name)).into(),
        title: name.to_string().into(),
        x: axis("level (DN above the black level)"),
        y: axis(format!("measured − expected{unit}")),
        series: all,
        y_range: None,
    })
}

/// Plots all statistics that have a curve.
pub fn every(j: &Judgement) -> Vec<Plot> {
    let Some(first) = j.comparisons.first() else { return Vec::new() };
    let curves = statistics(first).into_iter().filter(|n| of_statistic(first, n).len() >= CURVE);
    curves.filter_map(|n| plot_of(j, n)).collect()
}

fn unit_of(residuals: &[Residual], name: &str) -> String {
    let unit = residuals.iter().find(|r| r.observable == name).map_or("", |r| &*r.unit);
    if unit.is_empty() { String::new() } else { format!(" ({})", pretty(unit)) }
}

/// Converts a name to part of an identifier.
pub fn slug(name: &str) -> String {
    let mut out = String::new();
    for c in name.chars() {
        if c.is_ascii_alphanumeric() || c == '-' && out.is_empty() {
            out.push(c.to_ascii_lowercase());
        } else if !out.ends_with('-') {
            out.push('-');
        }
    }
    out.trim_end_matches('-').into()
}

/// Returns the correlation of a pixel's noise with its neighbours: covariance over variance, error-weighted
/// mean over the flats.
pub fn neighbours(all: &Observations) -> Vec<((i32, i32), f64, f64)> {
    let of_lag = |index: usize| {
        let (mut sum, mut weight) = (0.0, 0.0);
        for o in all.of(&covariance::Covariance).filter(|o| o.index == index) {
            let is_flat = o.set.is_some_and(|s| all.kinds[s] == Kind::Flat);
            let same = |v: &&crate::observables::Observable| v.set == o.set && v.frames == o.frames;
            let Some(var) = all.of(&variance::Variance).find(same).filter(|_| is_flat) else { continue };
            let var = var.measured.value;
            let (value, error) = (o.measured.value / var, o.measured.std_err / var);
            if value.is_finite() && error > 0.0 {
                sum += value / (error * error);
                weight += 1.0 / (error * error);
            }
        }
        (weight > 0.0).then(|| (LAGS[index], sum / weight, 1.0 / weight.sqrt()))
    };
    (0..LAGS.len()).filter_map(of_lag).collect()
}

#[cfg(test)]
mod tests {
    use super::slug;

    #[test]
    fn names_become_identifiers() {
        assert_eq!(slug("covariance (0,1)"), "covariance-0-1");
        assert_eq!(slug("temporal variance"), "temporal-variance");
    }
}
