//! What the frames say: means and variances of pairs, means and variances of stacks.

use super::EmvaError;
use crate::dataset::{Dataset, Kind, Set};
use crate::statistics::moments::Moments;
use ndarray::{Array2, Axis};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// One exposure of the temporal part: a pair of flats and a pair of darks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Temporal {
    /// Exposure, s.
    pub exposure_s: f64,
    /// Photons per pixel and exposure; in the dataset's unit times s where that is not known.
    pub photons: f64,
    /// Mean of the flats, DN (mu_y).
    pub mean_dn: f64,
    /// Temporal variance of the flats, DN^2 (sigma_y^2).
    pub var_dn2: f64,
    /// Mean of the darks, DN (mu_y.dark).
    pub dark_mean_dn: f64,
    /// Temporal variance of the darks, DN^2 (sigma_y.dark^2).
    pub dark_var_dn2: f64,
}

/// A stack of the spatial part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spatial {
    /// Frames L.
    pub frames: f64,
    /// Mean, DN.
    pub mean_dn: f64,
    /// Mean temporal variance of the pixels, DN^2 (sigma_y.stack^2).
    pub stack_var_dn2: f64,
    /// Variance of the mean image, DN^2 (s_y.measured^2).
    pub measured_var_dn2: f64,
    /// Variance of the column means, DN^2, less what noise adds (s_y.cav^2).
    pub columns_var_dn2: f64,
    /// Variance of the row means, DN^2, less what noise adds (s_y.rav^2).
    pub rows_var_dn2: f64,
}

/// Everything that the evaluation needs.
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    /// In the order of exposure and light.
    pub temporal: Vec<Temporal>,
    /// The bright stack and the dark one; absent where no set has more than two frames.
    pub spatial: Option<[Spatial; 2]>,
    /// Rows and columns.
    pub shape: (usize, usize),
    /// Largest code, DN.
    pub full_scale_dn: f64,
    /// Whether light is in photons per pixel.
    pub photons_known: bool,
}

/// Mean and temporal variance of the first two frames of a set (`Data1288._get_temporal_data`: half the variance of the
/// difference of two frames, its mean taken off).
fn pair(frames: &[Array2<u16>]) -> (f64, f64) {
    let n = frames[0].len() as f64;
    let (mut sum, mut difference, mut square) = (0u64, 0i64, 0u64);
    for (a, b) in frames[0].iter().zip(&frames[1]) {
        let d = i64::from(*b) - i64::from(*a);
        sum += u64::from(*a) + u64::from(*b);
        difference += d;
        square += (d * d) as u64;
    }
    let mean_difference = difference as f64 / n;
    (sum as f64 / (2.0 * n), 0.5 * (square as f64 / n - mean_difference * mean_difference))
}

fn stack(dataset: &Dataset, set: &Set) -> Result<Spatial, EmvaError> {
    let camera = &dataset.manifest().camera;
    let mut moments = Moments::new((camera.height, camera.width), camera.bit_depth);
    // Two frames at a time: memory that does not grow with their number, and one pass over the sums for both.
    for rows in set.rows.chunks(2) {
        let frames =
            rows.par_iter().map(|&r| dataset.read(&dataset.rows()[r])).collect::<Result<Vec<_>, _>>()?;
        let codes: Vec<&[u16]> = frames.iter().filter_map(|f| f.as_slice()).collect();
        moments.add(&codes).map_err(|e| EmvaError::Missing(e.to_string()))?;
    }
    let frames = moments.frames() as f64;
    let image = moments.mean_dn();
    let (rows, columns) = (image.nrows() as f64, image.ncols() as f64);
    let mean_dn = image.mean().unwrap_or(f64::NAN);
    let stack_var_dn2 = moments.variance_dn2().mean().unwrap_or(f64::NAN);
    let spread = |axis: usize, lines: f64, across: f64| {
        let means = image.mean_axis(Axis(axis)).unwrap_or_default();
        let square: f64 = means.iter().map(|m| (m - mean_dn).powi(2)).sum();
        square / lines - stack_var_dn2 / (frames * across)
    };
    Ok(Spatial {
        frames,
        mean_dn,
        stack_var_dn2,
        measured_var_dn2: image.var(1.0),
        columns_var_dn2: spread(0, columns, rows),
        rows_var_dn2: spread(1, rows, columns),
    })
}

/// Reads a dataset; `progress` is told (sets done, sets).
///
/// # Errors
///
/// Which exposure has no dark or no pair, which frame cannot be read, or that it was stopped.
pub fn of_dataset(
    dataset: &Dataset,
    stop: &AtomicBool,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Points, EmvaError> {
    let bench = dataset.manifest().bench.as_ref();
    let photons_known = bench.is_some_and(|b| b.illumination_unit == "photons/px/s");
    let settings = |s: &Set| dataset.settings(s).clone();
    let light = |s: &Set| settings(s).kind == Kind::Flat;
    let dark = |s: &Set| settings(s).kind == Kind::Dark;
    let same = |a: &Set, b: &Set| (settings(a).exposure_s / settings(b).exposure_s - 1.0).abs() < 1e-9;
    let sets = dataset.sets();
    let pairs: Vec<&Set> = sets.iter().filter(|s| s.rows.len() == 2).collect();
    // Campaigns that were not made for the standard have sets of several frames: their first two serve.
    let temporal: Vec<&Set> = if pairs.iter().any(|s| light(s)) {
        pairs
    } else {
        sets.iter().filter(|s| s.rows.len() > 2).collect()
    };
    let mut flats: Vec<&&Set> = temporal.iter().filter(|s| light(s)).collect();
    flats.sort_by(|a, b| {
        let (a, b) = (settings(a), settings(b));
        let photons = |r: &crate::dataset::FrameRow| r.illumination * r.exposure_s;
        a.exposure_s.total_cmp(&b.exposure_s).then(photons(&a).total_cmp(&photons(&b)))
    });
    if flats.is_empty() {
        return Err(EmvaError::Missing("there are no flats of two frames or more".into()));
    }
    let done = AtomicUsize::new(0);
    let read_pair = |set: &Set| -> Result<(f64, f64), EmvaError> {
        if stop.load(Ordering::Relaxed) {
            return Err(EmvaError::Interrupted);
        }
        let read = |&r: &usize| dataset.read(&dataset.rows()[r]);
        let frames = set.rows.iter().take(2).map(read).collect::<Result<Vec<_>, _>>()?;
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, flats.len());
        Ok(pair(&frames))
    };
    let darks: Vec<&Set> = temporal.iter().copied().filter(|s| dark(s)).collect();
    let dark_of: Vec<usize> = flats
        .iter()
        .map(|flat| {
            let found = darks.iter().position(|d| same(d, flat));
            found.ok_or_else(|| {
                let exposure_s = settings(flat).exposure_s;
                EmvaError::Missing(format!("set {}: no darks at its exposure of {exposure_s} s", flat.number))
            })
        })
        .collect::<Result<_, _>>()?;
    let dark_pairs = darks.par_iter().map(|d| read_pair(d)).collect::<Result<Vec<_>, _>>()?;
    let flat_pairs = flats.par_iter().map(|f| read_pair(f)).collect::<Result<Vec<_>, _>>()?;
    let temporal = flats
        .iter()
        .zip(flat_pairs)
        .zip(dark_of)
        .map(|((flat, (mean_dn, var_dn2)), dark)| {
            let row = settings(flat);
            let (dark_mean_dn, dark_var_dn2) = dark_pairs[dark];
            let photons = row.illumination * row.exposure_s;
            Temporal { exposure_s: row.exposure_s, photons, mean_dn, var_dn2, dark_mean_dn, dark_var_dn2 }
        })
        .collect();
    let stacks: Vec<&Set> = sets.iter().filter(|s| s.rows.len() > 2).collect();
    // The largest stack of flats with a dark stack of its exposure; of equal ones the first.
    let best = stacks
        .iter()
        .rev()
        .filter(|s| light(s))
        .filter_map(|f| Some((f, stacks.iter().find(|d| dark(d) && same(d, f))?)))
        .max_by_key(|(f, _)| f.rows.len());
    let spatial =
        best.map(|(f, d)| Ok::<_, EmvaError>([stack(dataset, f)?, stack(dataset, d)?])).transpose()?;
    let camera = &dataset.manifest().camera;
    Ok(Points {
        temporal,
        spatial,
        shape: (camera.height, camera.width),
        full_scale_dn: f64::from(camera.full_scale_dn()),
        photons_known,
    })
}
