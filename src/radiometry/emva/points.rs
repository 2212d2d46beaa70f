//! Measurements from the frames: means and variances of pairs, and the stacks of the spatial part.

use super::{EmvaError, GainByNoise};
use crate::data_faults::{DataFault, FaultKind, SharedNoise, examined};
use crate::dataset::image::Buffer;
use crate::dataset::{Dataset, DatasetError, ElectronMultiplication, FrameRow, Kind, Set};
use crate::light::Light;
use crate::noise::{self, NoiseError};
use crate::statistics::lit::Lit;
use crate::statistics::moments::Moments;
use crate::statistics::peak::turn_off;
use ndarray::{Array2, Axis};
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// A pair of frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Mean, DN.
    pub mean_dn: f64,
    /// Temporal variance, DN^2 (release 4.0 Linear, eq. 18: the difference of the two means is subtracted).
    pub var_dn2: f64,
    /// Mean of the first frame minus that of the second, DN.
    pub difference_dn: f64,
    /// Variance over the pixels of a single frame, mean of the two, DN^2 (eq. 17): temporal and spatial
    /// together.
    pub single_var_dn2: f64,
    /// Share of the samples at 0 DN.
    pub zero_share: f64,
    /// Share of the samples at full scale.
    pub full_share: f64,
}

/// One exposure of the temporal part: a pair of flats with the darks of its exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Temporal {
    /// Exposure, s.
    pub exposure_s: f64,
    /// Photons per pixel and exposure; if unknown, in the dataset's unit times s.
    pub photons: f64,
    /// Pair of flats.
    pub flat: Pair,
    /// Pair of darks.
    pub dark: Pair,
}

impl Temporal {
    /// Mean above the dark, DN (mu_y - mu_y.dark).
    pub fn signal_dn(&self) -> f64 {
        self.flat.mean_dn - self.dark.mean_dn
    }

    /// Temporal variance above the dark's, DN^2 (sigma_y^2 - sigma_y.dark^2).
    pub fn noise_dn2(&self) -> f64 {
        self.flat.var_dn2 - self.dark.var_dn2
    }
}

/// A pair of darks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dark {
    /// Exposure, s.
    pub exposure_s: f64,
    /// Pair of frames.
    pub pair: Pair,
    /// True if a flat has this exposure; otherwise the pair belongs to a run for the dark current.
    pub with_flat: bool,
}

/// Stack of frames of the spatial part.
#[derive(Debug, Clone, PartialEq)]
pub struct Spatial {
    /// Photons per pixel and exposure, as in [`Temporal`]; 0 for darks.
    pub photons: f64,
    /// Number L of frames.
    pub frames: u64,
    /// Sum of each pixel's codes, (rows, columns), DN.
    pub sum_dn: Array2<i64>,
    /// Mean temporal variance of the pixels, DN^2 (sigma_y.stack^2).
    pub stack_var_dn2: f64,
    /// Variance of the means of whole frames, DN^2, which is in that of the pixels.
    pub frame_var_dn2: f64,
}

impl Spatial {
    /// Mean image, (rows, columns), DN.
    pub fn mean_image_dn(&self) -> Array2<f64> {
        let n = self.frames as f64;
        self.sum_dn.mapv(|s| s as f64 / n)
    }
}

/// Input of the evaluation.
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    /// Temporal part, in the order of exposure and light.
    pub temporal: Vec<Temporal>,
    /// Every pair of darks, in the order of exposure.
    pub darks: Vec<Dark>,
    /// Bright and dark stack; absent if no set has more than two frames.
    pub spatial: Option<Arc<[Spatial; 2]>>,
    /// Number of rows and columns.
    pub shape: (usize, usize),
    /// Largest code, DN.
    pub full_scale_dn: f64,
    /// True if light is in photons per pixel.
    pub photons_known: bool,
    /// Properties of the light.
    pub light: Light,
    /// Step of the converter, DN.
    pub code_step_dn: f64,
    /// Stack of flats used for the spatial part.
    pub bright: Option<Bright>,
    /// Message about excluded pixels.
    pub left_out: Option<String>,
    /// Number of samples that lie far off the same pixel in other frames.
    pub struck: u64,
    /// Share of a change of level that first frames carry from the set before.
    pub carried_share: f64,
    /// Noise shared by neighbours or successive frames.
    pub(crate) shared_noise: Option<SharedNoise>,
    /// Multiplication of electrons.
    pub(crate) multiplied: Option<ElectronMultiplication>,
    /// Gain by `radcam noise`.
    pub noise: Option<GainByNoise>,
    /// Faults of the data.
    pub data_faults: Vec<DataFault>,
}

/// Stack of flats of the spatial part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bright {
    /// Number of the set.
    pub set: u32,
    /// Number of frames.
    pub frames: usize,
    /// Level above the dark, DN.
    pub signal_dn: f64,
    /// Level of saturation above the dark, DN: that of the variance's peak, or full scale.
    pub saturation_dn: f64,
    /// Number of stacks of flats with darks of their exposure.
    pub of: usize,
}

impl Bright {
    /// Level as a share of saturation.
    pub fn share(&self) -> f64 {
        self.signal_dn / self.saturation_dn
    }
}

/// Computes mean and temporal variance of the first two frames of a set: half the variance of their
/// difference, with its mean subtracted (release 4.0 Linear, section 6.6).
fn pair(a: &[u16], b: &[u16], full_scale: u16) -> Pair {
    let sums = pulp::Arch::new().dispatch(Both { a, b, full_scale });
    let Sums { first, second, products, squares, zeros, full } = sums;
    let n = a.len() as f64;
    let (a, b) = (first as f64 / n, second as f64 / n);
    // Integers are subtracted before they are rounded.
    let difference_dn = (first as i64 - second as i64) as f64 / n;
    let difference_square = (squares - 2 * products) as f64 / n;
    Pair {
        mean_dn: 0.5 * (a + b),
        var_dn2: 0.5 * (difference_square - difference_dn * difference_dn),
        difference_dn,
        single_var_dn2: 0.5 * (squares as f64 / n - a * a - b * b),
        zero_share: zeros as f64 / (2.0 * n),
        full_share: full as f64 / (2.0 * n),
    }
}

/// Two frames, for any vector instructions of the machine.
struct Both<'a> {
    a: &'a [u16],
    b: &'a [u16],
    full_scale: u16,
}

#[derive(Default)]
struct Sums {
    first: u64,
    second: u64,
    products: u64,
    squares: u64,
    zeros: u64,
    full: u64,
}

/// Samples whose sums and halves of products fit into 32 bits: 2^15 times 2^16, twice.
const RUN: usize = 1 << 14;

impl pulp::NullaryFnOnce for Both<'_> {
    type Output = Sums;

    #[inline(always)]
    fn call(self) -> Sums {
        let Self { a, b, full_scale } = self;
        let mut sums = Sums::default();
        for (a, b) in a.chunks(RUN).zip(b.chunks(RUN)) {
            // Products are split into lower and upper halves: every sum stays within 32 bits, so that all
            // lanes have one width.
            let [mut s, mut t, mut z, mut f] = [0u32; 4];
            let [mut p_low, mut p_high, mut q_low, mut q_high] = [0u32; 4];
            for (&a, &b) in a.iter().zip(b) {
                let (x, y) = (u32::from(a), u32::from(b));
                let (p, q, r) = (x * y, x * x, y * y);
                s += x;
                t += y;
                p_low += p & 0xFFFF;
                p_high += p >> 16;
                q_low += (q & 0xFFFF) + (r & 0xFFFF);
                q_high += (q >> 16) + (r >> 16);
                z += u32::from(a == 0) + u32::from(b == 0);
                f += u32::from(a == full_scale) + u32::from(b == full_scale);
            }
            let whole = |low: u32, high: u32| u64::from(low) + (u64::from(high) << 16);
            sums.first += u64::from(s);
            sums.second += u64::from(t);
            sums.products += whole(p_low, p_high);
            sums.squares += whole(q_low, q_high);
            sums.zeros += u64::from(z);
            sums.full += u64::from(f);
        }
        sums
    }
}

/// Maximum frames of a stack in memory.
const AT_ONCE: usize = 4;

fn stack(
    dataset: &Dataset,
    set: &Set,
    photons: f64,
    stop: &AtomicBool,
    step: &(dyn Fn() + Sync),
    part: Option<&Part>,
    (moments, buffers): &mut (Option<Moments>, [Buffer; AT_ONCE]),
) -> Result<Spatial, EmvaError> {
    let camera = &dataset.manifest().camera;
    let shape = part.map_or((camera.height, camera.width), Part::shape);
    if let Some(moments) = moments {
        moments.reset();
    }
    let mut means_dn = Vec::with_capacity(set.rows.len());
    // A few frames at a time: memory does not grow with their number.
    for rows in set.rows.chunks(AT_ONCE) {
        if stop.load(Ordering::Relaxed) {
            return Err(EmvaError::Interrupted);
        }
        let frames = buffers.par_iter_mut().zip(rows);
        frames.try_for_each(|(buffer, &r)| read_part(dataset, r, buffer, part))?;
        let codes: Vec<&[u16]> = buffers[..rows.len()].iter().map(Buffer::dn).collect();
        let mean_dn = |dn: &&[u16]| dn.iter().map(|v| u64::from(*v)).sum::<u64>() as f64 / dn.len() as f64;
        means_dn.extend(codes.par_iter().map(mean_dn).collect::<Vec<f64>>());
        // Allocated only now: frames were read, so that the size that the manifest claims is theirs.
        let moments = moments.get_or_insert_with(|| Moments::new(shape, camera.bit_depth));
        moments.add(&codes).map_err(|e| EmvaError::Missing(e.to_string()))?;
        step();
    }
    let moments = moments.get_or_insert_with(|| Moments::new(shape, camera.bit_depth));
    let n = moments.frames() as f64;
    let sums = moments.sums().iter().map(|&s| s as i64).collect();
    let mean_dn = means_dn.iter().sum::<f64>() / n;
    let frame_var_dn2 = means_dn.iter().map(|m| (m - mean_dn).powi(2)).sum::<f64>() / (n - 1.0);
    Ok(Spatial {
        photons,
        frames: moments.frames(),
        sum_dn: Array2::from_shape_vec(shape, sums).map_err(|e| EmvaError::Missing(e.to_string()))?,
        stack_var_dn2: moments.total_spread_dn2() / (n * (n - 1.0)) / moments.sums().len() as f64,
        frame_var_dn2,
    })
}

/// Lit rows and columns.
struct Part([std::ops::Range<usize>; 2]);

impl Part {
    fn shape(&self) -> (usize, usize) {
        (self.0[0].len(), self.0[1].len())
    }
}

fn read_part(
    dataset: &Dataset,
    row: usize,
    buffer: &mut Buffer,
    part: Option<&Part>,
) -> Result<(), DatasetError> {
    dataset.read_into(&dataset.rows()[row], buffer)?;
    if let Some(Part([rows, columns])) = part {
        buffer.crop(rows, columns);
    }
    Ok(())
}

/// Minimum signal over the noise of a frame for detecting unlit pixels one by one.
const MIN_SIGNAL_OVER_NOISE: f64 = 10.0;

/// Returns the lit part of the frames, if optically black or overscan columns and rows lie at the edges, and
/// a message about it; `None` if all pixels are lit, or there is too little light to tell.
fn lit_part(
    dataset: &Dataset,
    wanted: &Wanted<'_>,
    flats: &[Pair],
    darks: &[Pair],
) -> Result<Option<(Part, String)>, EmvaError> {
    let signal = |i: usize| flats[i].mean_dn - darks[wanted.dark_of[i]].mean_dn;
    let usable = (0..flats.len()).filter(|&i| flats[i].full_share < 0.01);
    let Some(brightest) = usable.max_by(|&a, &b| signal(a).total_cmp(&signal(b))) else { return Ok(None) };
    if signal(brightest) < MIN_SIGNAL_OVER_NOISE * flats[brightest].var_dn2.max(1.0).sqrt() {
        return Ok(None);
    }
    let mean = |set: &Set| -> Result<Array2<f32>, DatasetError> {
        let [a, b] = [0, 1].map(|k| dataset.read(&dataset.rows()[set.rows[k]]));
        Ok((a?.mapv(f32::from) + b?.mapv(f32::from)) / 2.0)
    };
    let dark = mean(wanted.darks[wanted.dark_of[brightest]])?;
    let light = Lit::of(&[mean(wanted.flats[brightest])? - dark]);
    let (blind, of) = (light.blind_pixels(), light.blind.len());
    if blind == 0 {
        return Ok(None);
    }
    let Some([rows, columns]) = light.frame() else {
        return Err(EmvaError::Missing(format!(
            "no light reaches {blind} of {of} pixels: the image circle of the lens is smaller than the sensor, or a part is covered. Crop the \
             frames to the lit part, or light all of the sensor"
        )));
    };
    let words = format!(
        "no light reaches {blind} of {of} pixels (optically black or overscan): rows {} to {} and columns {} to {} are evaluated",
        rows.start,
        rows.end - 1,
        columns.start,
        columns.end - 1
    );
    Ok(Some((Part([rows, columns]), words)))
}

/// Minimum frames of a stack over those of the longest, for a choice by its level.
const MIN_SHARE_OF_FRAMES: f64 = 0.5;

/// Chooses the stacks of the spatial part: among those with many frames the one whose flats are nearest to
/// half of saturation, as in the standard (release 4.0 Linear, section 8), with darks of its exposure.
fn choose_stacks<'a>(
    stacks: &[[&'a Set; 2]],
    level_dn: &dyn Fn(&Set) -> Option<f64>,
    saturation_dn: f64,
) -> Option<([&'a Set; 2], Bright)> {
    let longest = stacks.iter().map(|[f, _]| f.rows.len()).max()? as f64;
    let long = stacks.iter().filter(|[f, _]| f.rows.len() as f64 >= MIN_SHARE_OF_FRAMES * longest);
    let found = long.filter_map(|&[flat, dark]| {
        let signal_dn = level_dn(flat)? - level_dn(dark)?;
        let (frames, of) = (flat.rows.len(), stacks.len());
        Some(([flat, dark], Bright { set: flat.number, frames, signal_dn, saturation_dn, of }))
    });
    let off = |b: &Bright| (b.share() - 0.5).abs();
    // Among equals, the longest.
    found.min_by(|(_, a), (_, b)| {
        let alike = (off(a) - off(b)).abs() < 0.02;
        if alike { b.frames.cmp(&a.frames) } else { off(a).total_cmp(&off(b)) }
    })
}

/// Computes row means and column means of an image.
pub(super) fn line_means(image: &Array2<f64>) -> [Vec<f64>; 2] {
    [1, 0].map(|axis| image.mean_axis(Axis(axis)).unwrap_or_default().to_vec())
}

/// Sets to be read, by purpose.
struct Wanted<'a> {
    flats: Vec<&'a Set>,
    darks: Vec<&'a Set>,
    /// Place of the dark of each flat.
    dark_of: Vec<usize>,
    /// Bright and dark stacks of equal exposure.
    stacks: Vec<[&'a Set; 2]>,
}

fn same_exposure(a: &FrameRow, b: &FrameRow) -> bool {
    (a.exposure_s / b.exposure_s - 1.0).abs() < 1e-9
}

fn wanted(dataset: &Dataset) -> Result<Wanted<'_>, EmvaError> {
    let settings = |s: &Set| dataset.settings(s);
    let sets = dataset.sets();
    let of_kind = |s: &&Set, kind| settings(s).kind == kind;
    let single = |kind| sets.iter().find(|s| settings(s).kind == kind && s.rows.len() < 2);
    let pairs: Vec<&Set> = sets.iter().filter(|s| s.rows.len() == 2).collect();
    // Campaigns not made for the standard have sets of several frames: their first two are used.
    let flats_of = |sets: &[&Set]| sets.iter().filter(|s| of_kind(s, Kind::Flat)).count();
    let longer: Vec<&Set> = sets.iter().filter(|s| s.rows.len() > 2).collect();
    let temporal: Vec<&Set> = if flats_of(&pairs) > 0 && flats_of(&pairs) >= flats_of(&longer) {
        pairs
    } else {
        sets.iter().filter(|s| s.rows.len() >= 2).collect()
    };
    let mut flats: Vec<&Set> = temporal.iter().copied().filter(|s| of_kind(s, Kind::Flat)).collect();
    let light = |s: &Set| settings(s).illumination * settings(s).exposure_s;
    flats.sort_by(|a, b| {
        settings(a).exposure_s.total_cmp(&settings(b).exposure_s).then(light(a).total_cmp(&light(b)))
    });
    if flats.is_empty() {
        return Err(EmvaError::Missing(match single(Kind::Flat) {
            Some(s) => {
                format!("set {}: one flat; the temporal noise needs two frames at each exposure", s.number)
            }
            None => "there are no flats of two frames or more".into(),
        }));
    }
    let mut darks: Vec<&Set> = temporal.iter().copied().filter(|s| of_kind(s, Kind::Dark)).collect();
    darks.sort_by(|a, b| settings(a).exposure_s.total_cmp(&settings(b).exposure_s));
    let dark = |flat: &&Set| darks.iter().position(|d| same_exposure(settings(d), settings(flat)));
    // A flat whose darks were excluded is excluded too.
    if !dataset.data_faults().is_empty() && flats.iter().any(|f| dark(f).is_some()) {
        flats.retain(|f| dark(f).is_some());
    }
    let dark_of = |flat: &&Set| {
        let found = dark(flat);
        found.ok_or_else(|| {
            // To the nanosecond: a descriptor's exposure in seconds has a rounding error in its last digit.
            let exposure_s = (settings(flat).exposure_s * 1e9).round() / 1e9;
            let one = sets.iter().find(|s| {
                of_kind(s, Kind::Dark) && s.rows.len() < 2 && same_exposure(settings(s), settings(flat))
            });
            let why = one.map(|s| format!(" (set {} has one frame)", s.number)).unwrap_or_default();
            EmvaError::Missing(format!(
                "set {}: no pair of darks at its exposure of {exposure_s} s{why}; every exposure needs flats and darks",
                flat.number
            ))
        })
    };
    let dark_of = flats.iter().map(dark_of).collect::<Result<_, _>>()?;
    Ok(Wanted { flats, darks, dark_of, stacks: stacks(dataset, |_| true) })
}

/// Returns every stack of flats with a dark stack of its exposure.
fn stacks(dataset: &Dataset, wanted: impl Fn(&Set) -> bool) -> Vec<[&Set; 2]> {
    let settings = |s: &Set| dataset.settings(s);
    let long = |kind: Kind| {
        let sets = dataset.sets().iter().filter(|s| s.rows.len() > 2);
        sets.filter(move |s| settings(s).kind == kind).collect::<Vec<&Set>>()
    };
    let darks = long(Kind::Dark);
    let dark = |flat: &Set| darks.iter().copied().find(|d| same_exposure(settings(d), settings(flat)));
    long(Kind::Flat).into_iter().filter(|s| wanted(s)).filter_map(|f| Some([f, dark(f)?])).collect()
}

/// Reads a dataset on all cores; `progress` receives (pieces done, pieces).
///
/// # Errors
///
/// If an exposure has no dark or no pair, a frame cannot be read (both are named), or reading was stopped.
pub fn of_dataset(
    dataset: &Dataset,
    stop: &AtomicBool,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Points, EmvaError> {
    dataset.must_be_monochrome()?;
    let dataset = &examined(dataset, stop)?;
    let camera = &dataset.manifest().camera;
    let bench = dataset.manifest().bench.as_ref();
    let light = bench.and_then(|b| b.light).unwrap_or_default();
    let in_photons = bench.is_some_and(|b| b.illumination_unit == "photons/px/s");
    // Photons per pixel and second of one unit of illumination.
    let unit = if in_photons { Some(1.0) } else { light.photons_per_px_s() };
    let mut wanted = wanted(dataset)?;
    // Nonuniformities do not need the light: a stack with nothing but a wrong label is usable.
    let (whole, _) = dataset.timeline();
    let mislabelled = |set: &Set| {
        let mut faults = dataset.data_faults().iter().filter(|f| f.left_out && f.sets.contains(&set.number));
        let all = |f: &DataFault| f.kind == FaultKind::SettingLabel;
        faults.next().is_some_and(all) && faults.all(all)
    };
    let of_stacks = if wanted.stacks.is_empty() { &whole } else { dataset };
    if wanted.stacks.is_empty() {
        wanted.stacks = stacks(&whole, mislabelled);
    }
    let settings = |s: &Set| dataset.settings(s);
    let photons_of = |s: &FrameRow| s.illumination * unit.unwrap_or(1.0) * s.exposure_s;
    let photons = |s: &Set| photons_of(settings(s));
    let chunks = |s: &Set| s.rows.len().div_ceil(AT_ONCE);
    let of = wanted.flats.len()
        + wanted.darks.len()
        + wanted.stacks.iter().map(|[f, d]| chunks(f) + chunks(d)).max().unwrap_or(0);
    let done = AtomicUsize::new(0);
    let step = || progress(done.fetch_add(1, Ordering::Relaxed) + 1, of);
    let read_pair = |buffers: &mut [Buffer; 2], set: &&Set, part: Option<&Part>| -> Result<Pair, EmvaError> {
        if stop.load(Ordering::Relaxed) {
            return Err(EmvaError::Interrupted);
        }
        for (k, buffer) in buffers.iter_mut().enumerate() {
            read_part(dataset, set.rows[k], buffer, part)?;
        }
        let [a, b] = buffers;
        let found = pair(a.dn(), b.dn(), camera.full_scale_dn());
        step();
        Ok(found)
    };
    // All pairs in a few pieces per core, each with its own reused memory.
    let both: Vec<&Set> = wanted.darks.iter().chain(&wanted.flats).copied().collect();
    let piece = both.len().div_ceil(4 * rayon::current_num_threads()).max(1);
    let read_all = |part: Option<&Part>| {
        let of = |buffers: &mut [Buffer; 2], set: &&Set| read_pair(buffers, set, part);
        both.par_iter().with_min_len(piece).map_init(Default::default, of).collect::<Result<Vec<_>, _>>()
    };
    let mut all = read_all(None)?;
    let (dark_pairs, flat_pairs) = all.split_at(wanted.darks.len());
    let part = lit_part(dataset, &wanted, flat_pairs, dark_pairs)?;
    let (part, left_out) = part.map_or((None, None), |(part, words)| (Some(part), Some(words)));
    if part.is_some() {
        all = read_all(part.as_ref())?;
    }
    let (dark_pairs, flat_pairs) = all.split_at(wanted.darks.len());
    let temporal = wanted.flats.iter().zip(flat_pairs).zip(&wanted.dark_of);
    let temporal = temporal.map(|((set, flat), &dark)| Temporal {
        exposure_s: settings(set).exposure_s,
        photons: photons(set),
        flat: *flat,
        dark: dark_pairs[dark],
    });
    let with_flat = |d: &Set| wanted.flats.iter().any(|f| same_exposure(settings(f), settings(d)));
    let darks = wanted.darks.iter().zip(dark_pairs);
    let darks = darks.map(|(set, pair)| Dark {
        exposure_s: settings(set).exposure_s,
        pair: *pair,
        with_flat: with_flat(set),
    });
    let temporal: Vec<Temporal> = temporal.collect();
    let curve: Vec<(f64, f64)> = temporal.iter().map(|p| (p.signal_dn(), p.noise_dn2())).collect();
    let dark_dn = dark_pairs.first().map_or(0.0, |p| p.mean_dn);
    let at_full = f64::from(camera.full_scale_dn()) - dark_dn;
    let saturation_dn = turn_off(&curve).map_or(at_full, |(_, peak)| peak);
    // Levels of stacks that are pairs are known; for the others the first frame gives the level.
    let level_dn = |set: &Set| -> Option<f64> {
        let place = both.iter().position(|s| s.number == set.number);
        place.map(|i| all[i].mean_dn).or_else(|| {
            let mut buffer = Buffer::default();
            read_part(of_stacks, set.rows[0], &mut buffer, part.as_ref()).ok()?;
            let sum: u64 = buffer.dn().iter().map(|&v| u64::from(v)).sum();
            Some(sum as f64 / buffer.dn().len().max(1) as f64)
        })
    };
    let (spatial, bright) = match choose_stacks(&wanted.stacks, &level_dn, saturation_dn) {
        None => (None, None),
        Some(([flat, dark], bright)) => {
            let (mut memory, part) = (Default::default(), part.as_ref());
            let stacks = Arc::new([
                stack(of_stacks, flat, photons_of(of_stacks.settings(flat)), stop, &step, part, &mut memory)?,
                stack(of_stacks, dark, 0.0, stop, &step, part, &mut memory)?,
            ]);
            (Some(stacks), Some(bright))
        }
    };
    let noise = match noise::of_dataset(dataset, stop, &mut |_, _| {}) {
        Ok(report) => Some(GainByNoise::from(&report)),
        Err(NoiseError::Interrupted) => return Err(EmvaError::Interrupted),
        Err(_) => None,
    };
    Ok(Points {
        noise,
        temporal,
        darks: darks.collect(),
        spatial,
        bright,
        left_out,
        shape: part.as_ref().map_or((camera.height, camera.width), Part::shape),
        full_scale_dn: f64::from(camera.full_scale_dn()),
        photons_known: unit.is_some(),
        light,
        code_step_dn: dataset.code_step_dn(),
        struck: dataset.struck(),
        carried_share: dataset.carried_share(),
        shared_noise: dataset.shared_noise(),
        multiplied: ElectronMultiplication::of(&dataset.manifest().camera),
        data_faults: dataset.data_faults().to_vec(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pair_is_what_two_passes_say() {
        let code = |k: u32, i: usize| ((i as u32).wrapping_mul(2_654_435_761 + k) >> 16) as u16;
        let [a, b]: [Vec<u16>; 2] = [0, 2].map(|k| (0..9170).map(|i| code(k, i)).collect());
        let found = pair(&a, &b, code(2, 5));
        let n = a.len() as f64;
        let d: Vec<f64> = a.iter().zip(&b).map(|(a, b)| f64::from(*b) - f64::from(*a)).collect();
        let mean = d.iter().sum::<f64>() / n;
        let var = d.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n / 2.0;
        assert!((found.var_dn2 / var - 1.0).abs() < 1e-12, "{} {var}", found.var_dn2);
        assert!((found.difference_dn + mean).abs() < 1e-9);
        let of_one = |frame: &[u16]| {
            let mean = frame.iter().map(|c| f64::from(*c)).sum::<f64>() / n;
            frame.iter().map(|c| (f64::from(*c) - mean).powi(2)).sum::<f64>() / n
        };
        let single = 0.5 * (of_one(&a) + of_one(&b));
        assert!((found.single_var_dn2 / single - 1.0).abs() < 1e-12);
        let all = a.iter().chain(&b);
        assert!((found.mean_dn - all.clone().map(|c| f64::from(*c)).sum::<f64>() / (2.0 * n)).abs() < 1e-9);
        let at = |c: u16| all.clone().filter(|x| **x == c).count() as f64 / (2.0 * n);
        assert_eq!((found.zero_share, found.full_share), (at(0), at(code(2, 5))));
        // Full swing neither overflows nor rounds.
        let extreme = pair(&[0; 8192], &[65_535; 8192], 65_535);
        assert_eq!((extreme.mean_dn, extreme.var_dn2, extreme.full_share), (32_767.5, 0.0, 0.5));
    }
}
