//! Dark image and response of every pixel, as pictures with a scale, and the distributions of their values.

use crate::calibrate::defects::{BLIND, DEAD, HOT, UNSTABLE};
use crate::calibrate::file::Calibration;
use crate::dataset::image::Buffer;
use crate::dataset::{Dataset, Kind, Set};
use crate::observables::ObserveError;
use crate::statistics::median::median;
use ndarray::{Array2, ArrayView2};
use std::sync::atomic::{AtomicBool, Ordering};

/// Image with its description.
#[derive(Debug, Clone)]
pub struct Map {
    /// Title.
    pub title: String,
    /// Description of the source frames.
    pub of: String,
    /// Unit of its values; empty for ratios.
    pub unit: &'static str,
    /// (rows, columns).
    pub values: Array2<f32>,
    /// Standard deviation over the pixels, from the median absolute deviation; robust to a few outliers.
    pub spread: f64,
    /// Part of `spread` caused by the noise of the frames' mean. NaN for a single frame, whose noise is
    /// unknown.
    pub noise: f64,
    /// Number of pixels further than six spreads from the median.
    pub outliers: usize,
}

/// Outlier threshold, spreads from the median. It flags one normal pixel in 5e8.
const OUTLIER: f64 = 6.0;

/// Images made from the frames.
#[derive(Debug, Clone, Default)]
pub struct Images {
    /// Dark image, DN.
    pub dark: Option<Map>,
    /// Response, mean 1.
    pub response: Option<Map>,
    /// Difference of two successive darks over root 2: temporal noise of one frame, DN.
    pub dark_noise: Option<Array2<f64>>,
    /// Histogram of the codes in the first frame of every set.
    pub codes: Vec<u64>,
    /// Defects of the calibration: column, row, and kind.
    pub defects: Vec<(usize, usize, String)>,
}

impl Map {
    fn new(title: &str, of: String, unit: &'static str, values: Array2<f32>, noise: f64) -> Self {
        let middle = median(values.iter().map(|v| f64::from(*v)));
        // For normal values the median absolute deviation is 0.6745 standard deviations.
        let spread = median(values.iter().map(|v| (f64::from(*v) - middle).abs())) / 0.674_490;
        let far = |v: &&f32| (f64::from(**v) - middle).abs() > OUTLIER * spread;
        let outliers = if spread > 0.0 { values.iter().filter(far).count() } else { 0 };
        Self { title: title.into(), of, unit, values, spread, noise, outliers }
    }

    /// Returns the nonuniformity beyond the noise of the mean, and its standard error. The relative error of
    /// the standard deviation of n pixels is 1 / sqrt(2 n); from the median absolute deviation it is 1.65
    /// times that (efficiency 0.37: Huber and Ronchetti 2009, table 1.1).
    pub fn nonuniformity(&self) -> (f64, f64) {
        let n = self.values.len() as f64;
        if self.noise.is_nan() {
            return (f64::NAN, f64::NAN);
        }
        let square = (self.spread.powi(2) - self.noise.powi(2)).max(0.0);
        let error = self.spread.powi(2) * 1.65 * (2.0 / n).sqrt();
        let value = square.sqrt();
        (value, if value > 0.0 { error / (2.0 * value) } else { error.sqrt() })
    }
}

/// Reads the frames from which the maps are made.
///
/// # Errors
///
/// A frame cannot be read, or the call was stopped.
pub fn of(
    dataset: &Dataset,
    calibration: Option<&Calibration>,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Images, ObserveError> {
    let top = f64::from(dataset.manifest().camera.full_scale_dn());
    let mut out = Images { codes: vec![0; top as usize + 1], ..Images::default() };
    let mut buffer = Buffer::default();
    let sets = dataset.sets();
    let mut levels = vec![0.0; sets.len()];
    for (k, set) in sets.iter().enumerate() {
        if stop.load(Ordering::Relaxed) {
            return Err(ObserveError::Interrupted);
        }
        dataset.read_into(&dataset.rows()[set.rows[0]], &mut buffer)?;
        for v in buffer.dn() {
            out.codes[usize::from(*v)] += 1;
        }
        levels[k] = buffer.dn().iter().map(|v| f64::from(*v)).sum::<f64>() / buffer.dn().len() as f64;
        progress(k + 1, sets.len());
    }
    let kind = |set: &Set| dataset.settings(set).kind;
    // Dark: the shortest exposure, then most frames. Flat: the brightest below three quarters of the range.
    let darks = sets.iter().filter(|s| kind(s) == Kind::Dark);
    let exposure = |s: &Set| dataset.settings(s).exposure_s;
    let dark = darks.min_by(|a, b| exposure(a).total_cmp(&exposure(b)).then(b.rows.len().cmp(&a.rows.len())));
    let flats = sets.iter().zip(&levels).filter(|(s, l)| kind(s) == Kind::Flat && **l < 0.75 * top);
    let flat = flats.max_by(|a, b| a.1.total_cmp(b.1)).map(|(s, _)| s);
    let of = |set: &Set, what: &str| {
        format!("mean of {} {what} frames of set {}, {} s", set.rows.len(), set.number, exposure(set))
    };
    let dark_mean = dark.map(|set| mean(dataset, set)).transpose()?;
    if let (Some(set), Some(m)) = (dark, &dark_mean) {
        out.dark_noise = m.difference.clone();
        out.dark = Some(Map::new("Dark image", of(set, "dark"), "DN", m.mean.clone(), m.noise));
    }
    if let Some(set) = flat {
        let m = mean(dataset, set)?;
        let dark = dark_mean.as_ref().map(|d| &d.mean);
        let signal = dark.map_or_else(|| m.mean.clone(), |d| &m.mean - d);
        let level = f64::from(signal.mean().unwrap_or(1.0));
        let noise = m.noise.hypot(dark_mean.as_ref().map_or(0.0, |d| d.noise)) / level.abs().max(1e-9);
        out.response = Some(Map::new(
            "Flat image over its mean: response and light together",
            of(set, "flat"),
            "",
            signal.mapv(|v| (f64::from(v) / level) as f32),
            noise,
        ));
    }
    if let Some(cal) = calibration {
        let d = &cal.description;
        let of = format!("page 0 of the calibration, at {} s", cal.dark.exposure_s);
        out.dark = Some(Map::new("Dark reference", of, "DN", cal.dark.level_dn.clone(), cal.dark.std_err_dn));
        out.defects = cal
            .defects
            .indexed_iter()
            .filter(|(_, f)| **f != 0)
            .map(|((y, x), f)| (x, y, kinds_of(*f)))
            .collect();
        let of = format!("page 1 of the calibration: {} configurations of {} frames", d.n1, d.n2);
        let noise = median(cal.k_std_err.iter().map(|v| f64::from(*v)));
        out.response = Some(Map::new("Fixed pattern K", of, "", cal.k.clone(), noise));
    }
    Ok(out)
}

/// Names the kinds of a defect from its flags.
fn kinds_of(flags: u8) -> String {
    let all = [(HOT, "hot"), (DEAD, "dead"), (UNSTABLE, "unstable"), (BLIND, "blind")];
    all.into_iter().filter(|(f, _)| flags & f != 0).map(|(_, n)| n).collect::<Vec<_>>().join(", ")
}

/// Mean of a set's frames with its remaining noise, DN.
struct Mean {
    mean: Array2<f32>,
    noise: f64,
    difference: Option<Array2<f64>>,
}

fn mean(dataset: &Dataset, set: &Set) -> Result<Mean, ObserveError> {
    let mut buffer = Buffer::default();
    let mut first: Option<Array2<f64>> = None;
    let mut difference = None;
    let mut sum: Option<Array2<f64>> = None;
    for (k, &row) in set.rows.iter().enumerate() {
        dataset.read_into(&dataset.rows()[row], &mut buffer)?;
        let shape = buffer.shape();
        let view =
            ArrayView2::from_shape(shape, buffer.dn()).map_err(|e| ObserveError::Nothing(e.to_string()))?;
        match &mut sum {
            Some(sum) => sum.zip_mut_with(&view, |s, v| *s += f64::from(*v)),
            None => sum = Some(view.mapv(f64::from)),
        }
        match (&first, k) {
            (None, _) => first = Some(view.mapv(f64::from)),
            (Some(first), 1) => difference = Some((view.mapv(f64::from) - first) / std::f64::consts::SQRT_2),
            _ => {}
        }
    }
    let n = set.rows.len() as f64;
    let sum = sum.ok_or_else(|| ObserveError::Nothing("a set without frames".into()))?;
    let noise = difference.as_ref().map_or(f64::NAN, |d: &Array2<f64>| d.std(1.0) / n.sqrt());
    Ok(Mean { mean: sum.mapv(|s| (s / n) as f32), noise, difference })
}
