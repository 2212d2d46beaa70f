//! Plots of a datasheet.

use super::histogram::{Histogram, accumulated, histogram};
use super::lines::{
    UNDERFLOW, dark_lines, fitted_points, linear_range, of_variance, signal_std, transfer_lines, underflow,
};
use super::points::{Points, Temporal, line_means};
use super::spatial::filtered;
use super::{Definitions, Evaluation};
use crate::plot::{Plot, Shape, axis, level, log, series};
use ndarray::Array2;
use rayon::prelude::*;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use std::borrow::Cow;

/// Lists `n` numbers from a to b, in equal steps or equal ratios.
fn between(a: f64, b: f64, n: u32, ratios: bool) -> impl Iterator<Item = f64> {
    (0..n).map(move |i| {
        let part = f64::from(i) / f64::from(n - 1);
        if ratios { a * (b / a).powf(part) } else { a + (b - a) * part }
    })
}

const SIGNAL: &str = "signal μ_y − μ_y.dark (DN)";

/// Returns all plots that the points allow, in the order of the datasheet.
pub fn plots(points: &Points, evaluation: &Evaluation) -> Vec<Plot> {
    let mut all = temporal(points, evaluation);
    all.extend(spatial(points, evaluation));
    all
}

fn temporal(points: &Points, e: &Evaluation) -> Vec<Plot> {
    let t = &points.temporal;
    let pixels = (points.shape.0 * points.shape.1) as f64;
    let value = |name: &str| e.quantities.get(name).and_then(|q| q.as_ref()).map_or(f64::NAN, |q| q.value);
    let most = e.saturation_signal_dn;
    let clipped = e.definitions != Definitions::ReferenceTool && underflow(&points.darks) > UNDERFLOW;
    let used = fitted_points(t, most, e.definitions, clipped).unwrap_or_default();
    let [transfer, response] = transfer_lines(&used, pixels, e.definitions, clipped);
    let photons =
        if points.photons_known { "exposure μ_p (photons/pixel)" } else { "exposure (relative light × s)" };
    let marks =
        |of: &dyn Fn(&Temporal) -> [f64; 3], from: &[Temporal]| from.iter().map(of).collect::<Vec<_>>();
    let end_signal = t.iter().map(Temporal::signal_dn).fold(0.0, f64::max);
    let end_photons = t.iter().map(|p| p.photons).fold(0.0, f64::max);
    let along = |end: f64, of: &dyn Fn(f64) -> (f64, f64)| -> Vec<[f64; 3]> {
        between(0.0, end, 60, false).map(|x| (x, of(x))).map(|(x, (y, s))| [x, y, s]).collect()
    };
    let noise = |p: &Temporal| {
        [
            p.signal_dn(),
            p.noise_dn2(),
            of_variance(p.flat.var_dn2, pixels).hypot(of_variance(p.dark.var_dn2, pixels)),
        ]
    };
    let signal = |p: &Temporal| [p.photons, p.signal_dn(), signal_std(p, pixels)];
    let mut all = vec![
        Plot {
            id: "photon-transfer".into(),
            title: "Photon transfer".into(),
            x: axis(SIGNAL),
            y: axis("variance σ²_y − σ²_y.dark (DN²)"),
            series: vec![
                series("measured", Shape::Points, marks(&noise, t)),
                series("fit, 0 to 70 % of saturation", Shape::Line, along(end_signal, &|x| transfer.at(x))),
                series("used in the fit", Shape::Points, marks(&noise, &used)),
            ],
            y_range: None,
        },
        snr(points, &value, photons),
        Plot {
            id: "sensitivity".into(),
            title: "Sensitivity".into(),
            x: axis(photons),
            y: axis(SIGNAL),
            series: vec![
                series("measured", Shape::Points, marks(&signal, t)),
                series("fit, 0 to 70 % of saturation", Shape::Line, along(end_photons, &|x| response.at(x))),
                series("used in the fit", Shape::Points, marks(&signal, &used)),
            ],
            y_range: None,
        },
    ];
    all.extend(dark_plots(points, pixels));
    if let Some(fit) = linear_range(t, most, e.definitions) {
        all.push(Plot {
            id: "linearity".into(),
            title: "Linearity".into(),
            x: axis(photons),
            y: axis(SIGNAL),
            series: vec![
                series("measured", Shape::Points, marks(&signal, t)),
                series(
                    "fit, 5 to 95 % of saturation",
                    Shape::Line,
                    along(end_photons, &|x| (fit.offset + fit.slope * x, f64::NAN)),
                ),
                series("used in the fit", Shape::Points, marks(&signal, &fit.levels)),
            ],
            y_range: None,
        });
        let deviation =
            |p: &Temporal| [p.photons, fit.deviation(p), 100.0 * signal_std(p, pixels) / p.signal_dn()];
        let ends = fit.levels.iter().map(|p| p.photons).fold(0.0, f64::max);
        all.push(Plot {
            id: "deviation-from-linearity".into(),
            title: "Deviation from linearity".into(),
            x: axis(photons),
            y: axis("deviation δ_y (%)"),
            series: vec![
                series("measured", Shape::Points, marks(&deviation, &fit.levels)),
                level("no deviation", 0.0, ends),
            ],
            y_range: None,
        });
    }
    let sigma = |p: &Temporal| {
        let std = p.flat.var_dn2.sqrt();
        [p.signal_dn(), std, std / (2.0 * pixels).sqrt()]
    };
    let difference =
        |p: &Temporal| [p.signal_dn(), p.flat.difference_dn, (2.0 * p.flat.var_dn2 / pixels).sqrt()];
    all.push(Plot {
        id: "stability".into(),
        title: "Stability".into(),
        x: axis(SIGNAL),
        y: axis("difference of the means, noise (DN)"),
        series: vec![
            series("difference of the two frames' means", Shape::Points, marks(&difference, t)),
            series("temporal noise σ_y", Shape::Line, marks(&sigma, t)),
        ],
        y_range: None,
    });
    all
}

/// Plots the signal-to-noise ratio against the photons: measured, the model (eq. 21), with nonuniformity (eq.
/// 69), and the shot-noise limit (eq. 23).
fn snr(points: &Points, value: &dyn Fn(&str) -> f64, photons: &str) -> Plot {
    let pixels = (points.shape.0 * points.shape.1) as f64;
    let of = |var: &dyn Fn(&Temporal) -> f64| -> Vec<[f64; 3]> {
        // Beyond saturation the noise is clipped, and the ratio is meaningless.
        let end = Some(value("u_p_sat")).filter(|e| e.is_finite()).unwrap_or(f64::INFINITY);
        let below = |p: &&Temporal| p.photons <= end && p.flat.full_share < 0.01;
        let lit = points.temporal.iter().filter(|p| var(p) > 0.0 && p.signal_dn() > 0.0).filter(below);
        lit.map(|p| (p.photons, p.signal_dn() / var(p).sqrt()))
            .map(|(x, y)| [x, y, y / (2.0 * pixels).sqrt()])
            .collect()
    };
    let mut all = vec![
        series("measured", Shape::Points, of(&|p| p.flat.var_dn2)),
        series("measured, with nonuniformity", Shape::Points, of(&|p| p.flat.single_var_dn2)),
    ];
    let end = points.temporal.iter().map(|p| p.photons).fold(0.0, f64::max);
    let (k, r) = (value("K"), value("R"));
    let eta = r / k;
    let (dark, dsnu, prnu) = (value("sigma_y_dark") / k, value("DSNU1288"), value("PRNU1288") / 100.0);
    let first = value("u_p_min");
    if first > 0.0 && end > first {
        let curve = |of: &dyn Fn(f64) -> f64| -> Vec<[f64; 3]> {
            between(first, end, 80, true).map(|p| [p, of(p), f64::NAN]).collect()
        };
        let model = |p: f64| eta * p / (dark * dark + eta * p).sqrt();
        let total =
            |p: f64| eta * p / (dark * dark + dsnu * dsnu + eta * p + (prnu * eta * p).powi(2)).sqrt();
        all.push(series("linear model", Shape::Line, curve(&model)));
        if dsnu.is_finite() && prnu.is_finite() {
            all.push(series("linear model with nonuniformity", Shape::Dashed, curve(&total)));
        }
        all.push(series("shot-noise limit", Shape::Dashed, curve(&f64::sqrt)));
    }
    Plot {
        id: "snr".into(),
        title: "Signal-to-noise ratio".into(),
        x: log(photons),
        y: log("SNR"),
        series: all,
        y_range: None,
    }
}

fn dark_plots(points: &Points, pixels: f64) -> Vec<Plot> {
    let end = points.darks.iter().map(|d| d.exposure_s).fold(0.0, f64::max);
    let lines = dark_lines(&points.darks, pixels);
    let means: Vec<[f64; 3]> = points
        .darks
        .iter()
        .map(|d| [d.exposure_s, d.pair.mean_dn, (d.pair.var_dn2 / (2.0 * pixels)).sqrt()])
        .collect();
    let variances: Vec<[f64; 3]> = points
        .darks
        .iter()
        .map(|d| [d.exposure_s, d.pair.var_dn2, of_variance(d.pair.var_dn2, pixels)])
        .collect();
    let of = |id, title, unit: &str, measured: Vec<[f64; 3]>, k: usize| {
        let mut all = vec![series("measured", Shape::Points, measured)];
        if let Some(lines) = &lines {
            let line = between(0.0, end, 60, false).map(|x| (x, lines[k].at(x))).map(|(x, (y, s))| [x, y, s]);
            all.push(series("fit", Shape::Line, line.collect()));
        }
        Plot {
            id: Cow::Borrowed(id),
            title: Cow::Borrowed(title),
            x: axis("exposure time (s)"),
            y: axis(unit),
            series: all,
            y_range: None,
        }
    };
    vec![
        of("dark-mean", "Dark signal", "dark mean μ_y.dark (DN)", means, 0),
        of("dark-variance", "Dark noise", "dark variance σ²_y.dark (DN²)", variances, 1),
    ]
}

/// Computes the mean power spectrum of the rows (eq. 70 and 71), from 0 to half a cycle per pixel.
pub(crate) fn power(image: &Array2<f64>) -> Vec<f64> {
    let (rows, columns) = image.dim();
    let mean = image.mean().unwrap_or(0.0);
    let fft = FftPlanner::new().plan_fft_forward(columns);
    let half = columns / 2 + 1;
    let sum = image
        .outer_iter()
        .into_par_iter()
        .fold(
            || vec![0.0; half],
            |mut sum, row| {
                let mut line: Vec<Complex<f32>> =
                    row.iter().map(|v| Complex::new((v - mean) as f32, 0.0)).collect();
                fft.process(&mut line);
                sum.iter_mut().zip(&line).for_each(|(s, c)| *s += f64::from(c.norm_sqr()));
                sum
            },
        )
        .reduce(
            || vec![0.0; half],
            |mut a, b| {
                a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
                a
            },
        );
    let scale = (rows * columns) as f64;
    sum.iter().map(|s| s / scale).collect()
}

fn spatial(points: &Points, e: &Evaluation) -> Vec<Plot> {
    let Some([bright, dark]) = points.spatial.as_deref() else { return Vec::new() };
    let value = |name: &str| e.quantities.get(name).and_then(|q| q.as_ref()).map_or(f64::NAN, |q| q.value);
    let dark_image = dark.mean_image_dn();
    let response = bright.mean_image_dn() - &dark_image;
    let mean = response.mean().unwrap_or(f64::NAN);
    // The tool filters only histograms of the PRNU.
    let as_tool = e.definitions == Definitions::ReferenceTool;
    let (dark_flat, response_flat) =
        (filtered(&dark_image, e.definitions).0, filtered(&response, e.definitions).0);
    let stack = |name: &str| value(name).sqrt();
    let mut all = Vec::new();
    for (vertical, ids, titles) in [
        (
            false,
            ["horizontal-spectrogram-prnu", "horizontal-spectrogram-dsnu"],
            ["Horizontal spectrogram, PRNU", "Horizontal spectrogram, DSNU"],
        ),
        (
            true,
            ["vertical-spectrogram-prnu", "vertical-spectrogram-dsnu"],
            ["Vertical spectrogram, PRNU", "Vertical spectrogram, DSNU"],
        ),
    ] {
        let turned = |image: &Array2<f64>| if vertical { image.t().to_owned() } else { image.clone() };
        let of = |image: &Array2<f64>, scale: f64| -> Vec<[f64; 3]> {
            let image = turned(image);
            let lines = image.nrows() as f64;
            let columns = image.ncols() as f64;
            let p = power(&image);
            // The tool counts its frequencies in bins of the half spectrum.
            let step = if as_tool { 0.5 / p.len() as f64 } else { 1.0 / columns };
            // Mean of M squares of normal numbers, two each except at both ends.
            p.iter()
                .enumerate()
                .map(|(v, p)| {
                    let y = scale * p.sqrt();
                    [v as f64 * step, y, 0.5 * y / lines.sqrt()]
                })
                .collect()
        };
        let frequency = "spatial frequency (cycles/pixel)";
        // The tool divides the power, not its root, by the mean.
        let scale = if as_tool { 1.0 / mean.sqrt() } else { 100.0 / mean };
        all.push(Plot {
            id: ids[0].into(),
            title: titles[0].into(),
            x: axis(frequency),
            y: log("standard deviation (%)"),
            series: vec![
                series("spectrogram", Shape::Line, of(&response_flat, scale)),
                level("PRNU", value("PRNU1288"), 0.5),
                level("temporal noise of one frame", 100.0 * stack("sigma_2_y_stack") / mean, 0.5),
            ],
            y_range: None,
        });
        all.push(Plot {
            id: ids[1].into(),
            title: titles[1].into(),
            x: axis(frequency),
            y: log("standard deviation (DN)"),
            series: vec![
                series("spectrogram", Shape::Line, of(&dark_flat, 1.0)),
                level("DSNU", value("DSNU1288_DN"), 0.5),
                level("temporal noise of one frame", stack("sigma_2_y_stack_dark"), 0.5),
            ],
            y_range: None,
        });
    }
    all.extend(histograms(points, e, [&dark_flat, &response_flat], mean));
    all.extend(profiles(&response, &dark_image));
    all
}

/// Converts an image to integer multiples of 1 / L, which is exact for L frames without a filter.
fn whole(image: &Array2<f64>, frames: f64) -> Vec<i64> {
    image.iter().map(|v| (v * frames).round() as i64).collect()
}

fn histograms(points: &Points, e: &Evaluation, [dark, response]: [&Array2<f64>; 2], mean: f64) -> Vec<Plot> {
    let Some([bright_stack, dark_stack]) = points.spatial.as_deref() else { return Vec::new() };
    let as_tool = e.definitions == Definitions::ReferenceTool;
    let (dark_values, dark_scale) = (whole(dark, dark_stack.frames as f64), dark_stack.frames as f64);
    let (bright_values, bright_scale) = if as_tool {
        // 25 times the result of the tool's 5 x 5 filter, in integers; the sums of equally many frames.
        let difference = (&bright_stack.sum_dn - &dark_stack.sum_dn).mapv(|s| s as f64);
        let filtered = super::filter::HighPass::Box5.apply(&difference).unwrap_or(difference);
        (whole(&filtered, 25.0), 25.0 * bright_stack.frames as f64)
    } else {
        (whole(response, bright_stack.frames as f64), bright_stack.frames as f64)
    };
    let normal = |h: &Histogram, values: &[i64], scale: f64| -> Vec<[f64; 3]> {
        let n = values.len() as f64;
        let centre = values.iter().sum::<i64>() as f64 / n;
        let std = (values.iter().map(|v| (*v as f64 - centre).powi(2)).sum::<f64>() / n).sqrt() / scale;
        let (Some(first), Some(last)) = (h.bins.first(), h.bins.last()) else { return Vec::new() };
        let centre = centre / scale;
        let density = |x: f64| {
            h.width * n / ((std::f64::consts::TAU).sqrt() * std) * (-0.5 * ((x - centre) / std).powi(2)).exp()
        };
        // Down to 0.3 pixels per bin.
        between(*first, *last, 200, false).map(|x| [x, density(x), f64::NAN]).filter(|p| p[1] > 0.3).collect()
    };
    let shifted = |points: Vec<[f64; 3]>, by: f64, scale: f64| -> Vec<[f64; 3]> {
        points.into_iter().map(|[x, y, s]| [(x - by) * scale, y, s]).collect()
    };
    // A count has the standard deviation of its root.
    let counted = |h: &Histogram| -> Vec<[f64; 3]> {
        h.bins.iter().zip(&h.counts).map(|(x, y)| [*x, *y, y.sqrt()]).collect()
    };
    let mut all = Vec::new();
    for (ids, titles, values, scale, unit, factor) in [
        (
            ["histogram-dsnu", "accumulated-histogram-dsnu"],
            ["Logarithmic histogram, DSNU", "Accumulated logarithmic histogram, DSNU"],
            &dark_values,
            dark_scale,
            "DN",
            1.0,
        ),
        (
            ["histogram-prnu", "accumulated-histogram-prnu"],
            ["Logarithmic histogram, PRNU", "Accumulated logarithmic histogram, PRNU"],
            &bright_values,
            bright_scale,
            if as_tool { "DN" } else { "%" },
            if as_tool { 1.0 } else { 100.0 / mean },
        ),
    ] {
        let centre = values.iter().sum::<i64>() as f64 / values.len().max(1) as f64 / scale;
        // The tool does not subtract the PRNU's mean.
        let by = if as_tool && ids[0] == "histogram-prnu" { 0.0 } else { centre };
        let h = histogram(values, scale, e.definitions);
        all.push(Plot {
            id: ids[0].into(),
            title: titles[0].into(),
            x: axis(format!("deviation from the mean ({unit})")),
            y: log("pixels per bin"),
            series: vec![
                series("measured", Shape::Steps, shifted(counted(&h), by, factor)),
                series("normal distribution", Shape::Dashed, shifted(normal(&h, values, scale), by, factor)),
            ],
            y_range: None,
        });
        let a = accumulated(values, scale, e.definitions);
        let n = values.len() as f64;
        let shares = a.bins.iter().zip(&a.counts).map(|(x, y)| [x * factor, *y, (100.0 * y / n).sqrt()]);
        all.push(Plot {
            id: ids[1].into(),
            title: titles[1].into(),
            x: axis(format!("deviation from the mean, at least ({unit})")),
            y: log("pixels (%)"),
            series: vec![series("measured", Shape::Steps, shares.collect())],
            y_range: None,
        });
    }
    all
}

/// Plots middle, mean, least and greatest line of the images without any filter (section 8.7).
fn profiles(response: &Array2<f64>, dark: &Array2<f64>) -> Vec<Plot> {
    let mut all = Vec::new();
    for (id, title, image, vertical) in [
        ("horizontal-profile-prnu", "Horizontal profile, PRNU", response, false),
        ("horizontal-profile-dsnu", "Horizontal profile, DSNU", dark, false),
        ("vertical-profile-prnu", "Vertical profile, PRNU", response, true),
        ("vertical-profile-dsnu", "Vertical profile, DSNU", dark, true),
    ] {
        let turned = if vertical { image.t() } else { image.view() };
        let [_, means] = line_means(&turned.to_owned());
        let numbered = |values: Vec<f64>| -> Vec<[f64; 3]> {
            values.into_iter().enumerate().map(|(i, v)| [i as f64, v, f64::NAN]).collect()
        };
        let folded = |start: f64, f: fn(f64, f64) -> f64| {
            turned.columns().into_iter().map(|c| c.fold(start, |a, b| f(a, *b))).collect::<Vec<f64>>()
        };
        let (greatest, least) = (folded(f64::NEG_INFINITY, f64::max), folded(f64::INFINITY, f64::min));
        let average = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        // Range of section 8.7.
        let range = if id.ends_with("dsnu") {
            (0.9 * average(&least), 1.1 * average(&greatest))
        } else {
            (0.9 * average(&means), 1.1 * average(&means))
        };
        all.push(Plot {
            id: Cow::Borrowed(id),
            title: Cow::Borrowed(title),
            x: axis(if vertical { "row" } else { "column" }),
            y: axis("signal (DN)"),
            series: vec![
                series("greatest", Shape::Line, numbered(greatest)),
                series("least", Shape::Line, numbered(least)),
                series("middle", Shape::Line, numbered(turned.row(turned.nrows() / 2).to_vec())),
                series("mean", Shape::Line, numbered(means)),
            ],
            y_range: Some(range),
        });
    }
    all
}
