//! Curves of the camera: photon transfer, linearity, signal-to-noise ratio, dark current, spectra, codes,
//! histograms, variance budget.

use super::{Images, Judgement, Map, of_statistic};
use crate::calibrate::file::Calibration;
use crate::dataset::Kind;
use crate::emva::power;
use crate::noise::{LevelReport, NoiseReport};
use crate::observables::Observations;
use crate::plot::{Axis, Plot, Series, Shape, axis, level, log, series};
use crate::statistics::median::median;
use ndarray::Array2;

const SIGNAL: &str = "mean above the black level (DN)";

fn plot(id: &'static str, title: &'static str, x: Axis, y: Axis, series: Vec<Series>) -> Plot {
    Plot { id: id.into(), title: title.into(), x, y, series, y_range: None }
}

/// Returns all plots that the campaign allows.
pub fn plots(
    all: &Observations,
    j: &Judgement,
    noise: Option<&NoiseReport>,
    images: &Images,
    calibration: Option<&Calibration>,
) -> Vec<Plot> {
    let mut out = Vec::new();
    if let Some(n) = noise {
        out.extend(photon_transfer(n));
        out.extend(snr(n));
    }
    out.extend(linearity(all, j));
    out.extend(dark_current(all, j));
    out.extend(lines(j));
    out.extend(images.dark_noise.as_ref().map(spectrum));
    out.extend(occupancy(&images.codes));
    if let Some(n) = noise {
        out.extend(budget(n, images, calibration));
    }
    for (id, title, map) in [
        ("dark-histogram", "Histogram of the dark image", &images.dark),
        ("response-histogram", "Histogram of the response", &images.response),
    ] {
        out.extend(map.as_ref().map(|m| histogram(id, title, m)));
    }
    out
}

fn photon_transfer(n: &NoiseReport) -> Vec<Plot> {
    let of = |used: bool| -> Vec<&LevelReport> {
        n.levels.iter().filter(|l| l.used == used && l.var_dn2.is_finite()).collect()
    };
    let point = |l: &LevelReport| [l.mean_dn, l.var_dn2, l.var_std_err_dn2];
    let (a, c) = (n.gain_dn_per_e.value, n.constant_noise_var_dn2.value);
    let covariance = n.estimators.iter().find(|e| e.gain_dn_per_e.value == a).map_or(0.0, |e| e.covariance);
    let (va, vc) = (n.gain_dn_per_e.std_err.powi(2), n.constant_noise_var_dn2.std_err.powi(2));
    let end = n.levels.iter().map(|l| l.mean_dn).fold(1.0, f64::max);
    let fit = |x: f64| [x, a * x + c, (va * x * x + 2.0 * covariance * x + vc).sqrt()];
    let line: Vec<[f64; 3]> = (0..=60).map(|i| fit(end * f64::from(i) / 60.0)).collect();
    let low = n.levels.iter().map(|l| l.mean_dn).filter(|m| *m > 0.0).fold(end, f64::min).max(end * 1e-4);
    let curve: Vec<[f64; 3]> = (0..=60).map(|i| fit(low * (end / low).powf(f64::from(i) / 60.0))).collect();
    let points = |list: Vec<&LevelReport>| list.into_iter().map(point).collect::<Vec<_>>();
    let with = |line: Vec<[f64; 3]>, sound: &dyn Fn(&[f64; 3]) -> bool| {
        let mut all = vec![
            series("levels on the line", Shape::Points, points(of(true)).into_iter().filter(sound).collect()),
            series("fit σ² = A μ + σ_C²", Shape::Line, line),
        ];
        let out: Vec<[f64; 3]> = points(of(false)).into_iter().filter(sound).collect();
        if !out.is_empty() {
            all.push(series("left out", Shape::Points, out));
        }
        all
    };
    let variance = "temporal variance (DN²)";
    let residuals = |list: Vec<&LevelReport>| list.into_iter().map(|l| [l.mean_dn, l.z, 1.0]).collect();
    let mut rest =
        vec![series("levels on the line", Shape::Points, residuals(of(true))), level("line", 0.0, end)];
    if !of(false).is_empty() {
        rest.push(series("left out", Shape::Points, residuals(of(false))));
    }
    vec![
        plot("photon-transfer", "Photon transfer", axis(SIGNAL), axis(variance), with(line, &|_| true)),
        plot(
            "photon-transfer-log",
            "Photon transfer, logarithmic",
            log(SIGNAL),
            log(variance),
            with(curve, &|p| p[0] > 0.0 && p[1] > 0.0),
        ),
        plot(
            "photon-transfer-residuals",
            "Residuals of the photon transfer line",
            axis(SIGNAL),
            axis("distance from the line (standard errors)"),
            rest,
        ),
    ]
}

fn snr(n: &NoiseReport) -> Option<Plot> {
    let a = n.gain_dn_per_e.value;
    // Above the last level on the line the signal is clipped, and so is the noise.
    let top = n.levels.iter().filter(|l| l.used).map(|l| l.mean_dn).fold(0.0, f64::max);
    let measured: Vec<[f64; 3]> = n
        .levels
        .iter()
        .filter(|l| l.mean_dn > 1.0 && l.mean_dn <= top && l.var_dn2 > 0.0)
        .map(|l| {
            let snr = l.mean_dn / l.var_dn2.sqrt();
            [l.mean_dn, snr, 0.5 * snr * l.var_std_err_dn2 / l.var_dn2]
        })
        .collect();
    let low = measured.iter().map(|p| p[0]).reduce(f64::min)?;
    let end = measured.iter().map(|p| p[0]).reduce(f64::max)?;
    let ratios = |f: &dyn Fn(f64) -> f64| -> Vec<[f64; 3]> {
        (0..=60).map(|i| low * (end / low).powf(f64::from(i) / 60.0)).map(|x| [x, f(x), f64::NAN]).collect()
    };
    let c = n.constant_noise_var_dn2.value.max(0.0);
    Some(plot(
        "snr",
        "Signal-to-noise ratio",
        log(SIGNAL),
        log("mean over temporal noise"),
        vec![
            series("measured", Shape::Points, measured),
            series("line of the photon transfer", Shape::Line, ratios(&|x| x / (a * x + c).sqrt())),
            series("shot-noise limit √(μ/A)", Shape::Dashed, ratios(&|x| (x / a).sqrt())),
        ],
    ))
}

/// Plots the means of the flats against exposure times light, and their relative deviation from the line
/// through the origin.
fn linearity(all: &Observations, j: &Judgement) -> Vec<Plot> {
    if all.means_given {
        return Vec::new();
    }
    let Some(first) = j.comparisons.first() else { return Vec::new() };
    // The dark signal of the same exposure is not a response to light and is subtracted (EMVA 1288 release
    // 4.0 Linear, section 6.4).
    let dark_dn_per_s = j.fitted.as_ref().map_or(0.0, |f| f.base.gain_dn_per_e * f.base.dark_e_per_s);
    let setting = |set: u32| {
        let place = all.set_numbers.iter().position(|n| *n == set)?;
        let info = &all.campaign.sets[place];
        (all.kinds[place] == Kind::Flat)
            .then_some((info.exposure_s * info.illumination, dark_dn_per_s * info.exposure_s))
    };
    let points: Vec<[f64; 3]> = of_statistic(first, "mean")
        .into_iter()
        .filter_map(|l| setting(l.set).map(|(light, dark)| [light, l.level_dn - dark, l.std_err]))
        .filter(|p| p[0] > 0.0 && p[1] > 0.0)
        .collect();
    if points.len() < 3 {
        return Vec::new();
    }
    // Fit range 5 to 95 %, relative deviations weighted equally, as in EMVA 1288 (release 4.0 Linear, section
    // 6.7). Saturation is not known here, so 95 % refers to the brightest level.
    let top = points.iter().map(|p| p[1]).fold(0.0, f64::max);
    let fitted: Vec<&[f64; 3]> =
        points.iter().filter(|p| (0.05 * top..=0.95 * top).contains(&p[1])).collect();
    if fitted.is_empty() {
        return Vec::new();
    }
    let slope = fitted.iter().map(|p| p[1] / p[0]).sum::<f64>() / fitted.len() as f64;
    let end = points.iter().map(|p| p[0]).fold(0.0, f64::max);
    let off =
        points.iter().map(|p| [p[0], 100.0 * (p[1] / (slope * p[0]) - 1.0), 100.0 * p[2] / (slope * p[0])]);
    let off: Vec<[f64; 3]> = off.collect();
    let x = "exposure × light (s · unit of the light)";
    let line = vec![[0.0, 0.0, f64::NAN], [end, slope * end, f64::NAN]];
    vec![
        plot(
            "linearity",
            "Linearity",
            axis(x),
            axis(SIGNAL),
            vec![series("flats", Shape::Points, points), series("line through zero", Shape::Line, line)],
        ),
        plot(
            "linearity-deviation",
            "Deviation from linearity",
            axis(x),
            axis("distance from the line (%)"),
            vec![series("flats", Shape::Points, off), level("line through zero", 0.0, end)],
        ),
    ]
}

/// Plots the means of the darks against exposure.
fn dark_current(all: &Observations, j: &Judgement) -> Option<Plot> {
    let (first, f) = (j.comparisons.first()?, j.fitted.as_ref()?);
    let exposure = |set: u32| {
        let place = all.set_numbers.iter().position(|n| *n == set)?;
        (all.kinds[place] == Kind::Dark).then_some(all.campaign.sets[place].exposure_s)
    };
    let darks: Vec<[f64; 3]> = of_statistic(first, "mean")
        .into_iter()
        .filter_map(|l| Some([exposure(l.set)?, l.measured, l.std_err]))
        .collect();
    let end = darks.iter().map(|p| p[0]).reduce(f64::max)?;
    if darks.iter().all(|p| p[0] == end) {
        return None;
    }
    let b = &f.base;
    let rate = b.gain_dn_per_e * b.dark_e_per_s;
    let line = vec![[0.0, b.offset_dn, f64::NAN], [end, b.offset_dn + rate * end, f64::NAN]];
    Some(plot(
        "dark-current",
        "Dark signal against exposure",
        axis("exposure (s)"),
        axis("mean of the darks (DN)"),
        vec![
            series("darks", Shape::Points, darks),
            series("black level and dark current", Shape::Line, line),
        ],
    ))
}

/// Plots the noise common to rows and to columns.
fn lines(j: &Judgement) -> Option<Plot> {
    let first = j.comparisons.first()?;
    let of = |name: &str| -> Vec<[f64; 3]> {
        of_statistic(first, name).into_iter().map(|l| [l.level_dn, l.measured, l.std_err]).collect()
    };
    let all: Vec<Series> = [("row variance", "rows"), ("column variance", "columns")]
        .into_iter()
        .map(|(name, label)| series(label, Shape::Points, of(name)))
        .filter(|s| !s.points.is_empty())
        .collect();
    let y = axis("variance of line means beyond their pixels' (DN²)");
    (!all.is_empty()).then(|| plot("line-noise", "Noise that rows and columns share", axis(SIGNAL), y, all))
}

/// Plots the amplitude spectrum of one dark frame's temporal noise, along rows and along columns.
fn spectrum(noise: &Array2<f64>) -> Plot {
    let of = |image: &Array2<f64>| -> Vec<[f64; 3]> {
        let (lines, length) = image.dim();
        // Mean over the lines of the squared amplitudes: relative error 1 / sqrt(lines), half of it for the
        // root.
        let error = 0.5 / (lines as f64).sqrt();
        let all = power(image).into_iter().enumerate().skip(1);
        all.map(|(k, p)| [k as f64 / length as f64, p.sqrt(), error * p.sqrt()]).collect()
    };
    plot(
        "noise-spectrum",
        "Spectrum of the dark noise",
        axis("spatial frequency (cycles/pixel)"),
        log("standard deviation (DN)"),
        vec![
            series("along rows", Shape::Line, of(noise)),
            series("along columns", Shape::Line, of(&noise.t().to_owned())),
        ],
    )
}

/// Codes shown individually on either side of the central code.
const NEAR: usize = 48;
/// Maximum points of a histogram of all codes.
const POINTS: usize = 512;

fn occupancy(codes: &[u64]) -> Vec<Plot> {
    let Some(last) = codes.iter().rposition(|n| *n > 0) else { return Vec::new() };
    let step = last / POINTS + 1;
    let all = codes[..=last].chunks(step).enumerate();
    let all: Vec<[f64; 3]> =
        all.map(|(k, n)| [(k * step) as f64, n.iter().sum::<u64>() as f64 / step as f64, f64::NAN]).collect();
    // Single codes are shown around the median code.
    let filled: u64 = codes.iter().sum();
    let mut sum = 0;
    let middle = codes.iter().position(|n| {
        sum += n;
        2 * sum >= filled
    });
    let middle = middle.unwrap_or(0);
    let near = middle.saturating_sub(NEAR)..(middle + NEAR + 1).min(codes.len());
    let near: Vec<[f64; 3]> = near.map(|c| [c as f64, codes[c] as f64, (codes[c] as f64).sqrt()]).collect();
    let title = |of: &str| format!("pixels for a code ({of})");
    vec![
        plot(
            "codes",
            "How often codes occur",
            axis("code (DN)"),
            log(title("first frames")),
            vec![series("first frame of every set", Shape::Steps, all)],
        ),
        plot(
            "codes-near",
            "Single codes around the middle",
            axis("code (DN)"),
            axis(title("first frames")),
            vec![series("first frame of every set", Shape::Steps, near)],
        ),
    ]
}

/// Plots the parts of the variance of an uncorrected image against the mean.
fn budget(n: &NoiseReport, images: &Images, calibration: Option<&Calibration>) -> Option<Plot> {
    let end = n.levels.iter().map(|l| l.mean_dn).reduce(f64::max).filter(|m| *m > 10.0)?;
    let curve = |f: &dyn Fn(f64) -> f64| -> Vec<[f64; 3]> {
        (0..=40).map(|i| end * 1e-3f64.powf(1.0 - f64::from(i) / 40.0)).map(|x| [x, f(x), f64::NAN]).collect()
    };
    let a = n.gain_dn_per_e.value;
    let mut all = vec![
        series("shot noise", Shape::Line, curve(&|x| a * x)),
        series("constant noise", Shape::Line, curve(&|_| n.constant_noise_var_dn2.value.max(1e-6))),
    ];
    let mut total: Vec<[f64; 3]> = curve(&|x| a * x + n.constant_noise_var_dn2.value.max(0.0));
    for (map, label) in [
        (&images.dark, "dark nonuniformity"),
        (&images.response, if calibration.is_some() { "fixed pattern K" } else { "response and light" }),
    ] {
        let Some(map) = map else { continue };
        let spread = map.nonuniformity().0;
        if !spread.is_finite() {
            continue;
        }
        let part = |x: f64| if map.unit.is_empty() { (spread * x).powi(2) } else { spread * spread };
        total.iter_mut().for_each(|p| p[1] += part(p[0]));
        if spread > 0.0 {
            all.push(series(label, Shape::Line, curve(&part)));
        }
    }
    all.push(series("all", Shape::Dashed, total));
    Some(plot(
        "variance-budget",
        "Variance budget of an uncorrected image",
        log(SIGNAL),
        log("variance over the pixels (DN²)"),
        all,
    ))
}

/// Half range of a histogram about the median, in spreads.
const REACH: f64 = 10.0;
/// Number of bins of a histogram.
const BINS: usize = 128;

fn histogram(id: &'static str, title: &'static str, map: &Map) -> Plot {
    let sound = || map.values.iter().map(|v| f64::from(*v)).filter(|v| v.is_finite());
    let (least, most) = sound().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    // Limit the range: a hot pixel must not press all others into one bin.
    let middle = median(sound());
    let reach = if map.spread > 0.0 { REACH * map.spread } else { f64::INFINITY };
    let (low, high) = (least.max(middle - reach), most.min(middle + reach));
    let width = ((high - low) / BINS as f64).max(1e-12);
    let mut counts = vec![0.0; BINS];
    let (mut below, mut above) = (0, 0);
    for v in sound() {
        match v {
            v if v < low => below += 1,
            v if v > high => above += 1,
            v => counts[(((v - low) / width) as usize).min(BINS - 1)] += 1.0,
        }
    }
    let steps = counts.iter().enumerate().map(|(k, n)| [low + width * k as f64, *n, f64::NAN]).collect();
    let unit = if map.unit.is_empty() { String::new() } else { format!(" ({})", map.unit) };
    let beyond =
        if below + above > 0 { format!("; {below} pixels below, {above} above") } else { String::new() };
    plot(
        id,
        title,
        axis(format!("value{unit}{beyond}")),
        log("pixels"),
        vec![series("pixels", Shape::Steps, steps)],
    )
}
