//! What a campaign says, as a list of observables: each a number with an error, of some frames or of all.
//!
//! Sets are cut into chunks of successive frames, and the chunks are dealt to two halves that take turns: in one set the first
//! chunk goes to half 0, in the next to half 1, so that both halves see what follows a change of level.

use super::global;
use crate::calibrate::pattern::median;
use crate::dataset::table::Table;
use crate::dataset::{Dataset, DatasetError, Kind};
use crate::statistics::residual::{LAGS, Residual, Value, residual};
use ndarray::Array2;
use radcam_sim::predict::{Campaign, FrameInfo, SetInfo};
use std::sync::atomic::{AtomicBool, Ordering};

/// Most frames of a chunk: memory is bounded by it.
const CHUNK: usize = 8;
/// No lamp is known better than this, relative.
const LIGHT_FLOOR: f64 = 5e-5;
/// Share of clipped samples from which a set is not looked at.
const CLIPPED: f64 = 1e-3;

/// What an observable is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Statistic {
    /// Mean of a chunk, DN.
    Mean,
    /// Mean of frame number 0 or 1 of a set less the mean of those after it in the chunk, DN.
    Settling(usize),
    /// Variance of the frames' means, DN^2.
    FrameMeanVariance,
    /// Temporal variance, DN^2.
    Variance,
    /// Variance of row means, DN^2.
    RowVariance,
    /// Variance of column means, DN^2.
    ColumnVariance,
    /// Covariance at a lag, DN^2.
    Covariance(i32, i32),
    /// Mean product with the next frame, DN^2.
    Successive,
    /// Excess spread of the pixels' variances.
    Unequal,
    /// Growth of the neighbour covariance along rows (0), columns (1), DN^2.
    Growth(usize),
    /// Step between the middle columns: in proportion to the signal (0), constant (1).
    Tap(usize),
    /// Codes whose bit toggles next against those before it, relative.
    Occupancy(usize),
    /// Share of codes that occur.
    CodesUsed,
    /// Variance in the strongest line of the spectrum, DN^2.
    Line,
    /// Background of a scene, columns through the patch against the rest: the short exposure scaled up less the long one, DN.
    SceneColumns,
    /// Known light level: the flux over the nominal, relative.
    Light(usize),
}

/// One observable.
#[derive(Debug, Clone, PartialEq)]
pub struct Observable {
    /// What it is.
    pub kind: Statistic,
    /// Place of its set in [`Observations::campaign`]; `None` for the whole campaign.
    pub set: Option<usize>,
    /// 0 or 1; 2: belongs to both halves.
    pub half: u8,
    /// Frames of the campaign that it is made of.
    pub frames: (usize, usize),
    /// What was measured.
    pub measured: Value,
    /// Pixels.
    pub pixels: f64,
}

/// Everything that was observed.
#[derive(Debug, Clone)]
pub struct Observations {
    /// Geometry, sets and frames.
    pub campaign: Campaign,
    /// Numbers of the sets as the dataset has them.
    pub set_numbers: Vec<u32>,
    /// Kinds of the sets.
    pub kinds: Vec<Kind>,
    /// The observables.
    pub all: Vec<Observable>,
    /// The scene with the long and the short exposure.
    pub scene: Option<global::ScenePair>,
    /// Codes of the histogram's range.
    pub codes: std::ops::Range<u32>,
    /// A table without exposures: the means are taken as they are.
    pub means_given: bool,
    /// What could not be looked at.
    pub missing: Vec<String>,
    /// Known relative error of the light levels.
    pub light_rel_std: Option<f64>,
}

/// Why nothing can be said.
#[derive(Debug, thiserror::Error)]
pub enum ObserveError {
    /// The dataset.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Nothing to look at.
    #[error("{0}")]
    Nothing(String),
    /// The user asked for the end.
    #[error("interrupted")]
    Interrupted,
}

impl Statistic {
    /// Its name in reports.
    pub fn name(&self) -> String {
        match self {
            Statistic::Mean => "mean".into(),
            Statistic::Settling(0) => "first frame".into(),
            Statistic::Settling(_) => "second frame".into(),
            Statistic::FrameMeanVariance => "variance of frame means".into(),
            Statistic::Variance => "temporal variance".into(),
            Statistic::RowVariance => "variance of row means".into(),
            Statistic::ColumnVariance => "variance of column means".into(),
            Statistic::Covariance(dy, dx) => format!("covariance ({dy},{dx})"),
            Statistic::Successive => "covariance of successive frames".into(),
            Statistic::Unequal => "spread of pixel variances".into(),
            Statistic::Growth(0) => "growth of covariance along rows".into(),
            Statistic::Growth(_) => "growth of covariance along columns".into(),
            Statistic::Tap(0) => "step between halves, of the signal".into(),
            Statistic::Tap(_) => "step between halves, constant".into(),
            Statistic::Occupancy(b) => format!("occupancy of codes, bit {b}"),
            Statistic::CodesUsed => "share of codes that occur".into(),
            Statistic::Line => "line in the spectrum".into(),
            Statistic::SceneColumns => "scene, columns through the patch".into(),
            Statistic::Light(_) => "light level".into(),
        }
    }
}

/// Reads a dataset. `progress` is told (sets done, sets).
pub fn of_dataset(
    dataset: &Dataset,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Observations, ObserveError> {
    let camera = &dataset.manifest().camera;
    let shape = (camera.height, camera.width);
    let full = f64::from(camera.full_scale_dn());
    let mut missing = Vec::new();
    // Sets in the order of time, by the first row that the file has of each.
    let sets = dataset.sets();
    let settings: Vec<_> = sets.iter().map(|s| dataset.settings(s).clone()).collect();
    let mut levels: Vec<u64> = Vec::new();
    let mut light_of = |kind: Kind, illumination: f64, scene: usize| {
        if kind == Kind::Dark || illumination == 0.0 {
            return None;
        }
        // A scene has a mean of its own: a light level for itself.
        let key = if kind == Kind::Flat { illumination.to_bits() } else { u64::MAX - scene as u64 };
        let at = levels.iter().position(|l| *l == key).unwrap_or_else(|| {
            levels.push(key);
            levels.len() - 1
        });
        Some(at)
    };
    let mut infos: Vec<SetInfo> = settings
        .iter()
        .enumerate()
        .map(|(i, s)| SetInfo {
            exposure_s: s.exposure_s,
            light: light_of(s.kind, s.illumination, i),
            illumination: s.illumination,
            spread: 0.0,
        })
        .collect();
    let mut frame_of_row = vec![0; dataset.rows().len()];
    let mut set_of_row = vec![0; dataset.rows().len()];
    sets.iter().enumerate().for_each(|(i, s)| s.rows.iter().for_each(|&r| set_of_row[r] = i));
    let mut time_s = 0.0;
    let mut frames = Vec::new();
    for (r, row) in dataset.rows().iter().enumerate() {
        frame_of_row[r] = frames.len();
        let at = row.timestamp_s.unwrap_or(time_s);
        frames.push(FrameInfo { set: set_of_row[r], time_s: at });
        time_s = at + row.exposure_s;
    }

    let mut pixels = Pixels::new(shape, camera.full_scale_dn());
    let mut chunks: Vec<Chunk> = Vec::new();
    let mut read: Vec<Vec<Array2<u16>>> = Vec::new();
    for (i, set) in sets.iter().enumerate() {
        if stop.load(Ordering::Relaxed) {
            return Err(ObserveError::Interrupted);
        }
        // Few frames a set is the rule; of a long one the first hundred tell enough.
        let rows = &set.rows[..set.rows.len().min(128)];
        let images = rows.iter().map(|&r| dataset.read(&dataset.rows()[r])).collect::<Result<Vec<_>, _>>()?;
        pixels.look(&images, settings[i].kind);
        read.push(images);
        progress(i + 1, sets.len());
    }
    let used = pixels.used();
    let gain = global::rough_gain(&read, &used);
    let mut spectrum = global::LineSearch::new(shape);
    let mut histogram = global::Histogram::new(camera.full_scale_dn());
    let mut scene_means = Vec::new();
    let mut saturated = Vec::new();
    let mut others = Vec::new();
    for (i, images) in read.iter().enumerate() {
        let kind = settings[i].kind;
        if images.is_empty() {
            continue;
        }
        if matches!(kind, Kind::Scene | Kind::Target) {
            let mean = global::mean_image(images);
            others.push((i, global::mean_of(&mean, &used)));
            scene_means.push((i, mean));
            continue;
        }
        let clipped = images.iter().flat_map(|f| f.iter()).filter(|&&d| f64::from(d) >= full).count() as f64;
        if clipped / (images.len() * images[0].len()) as f64 > CLIPPED {
            saturated.push(i);
            others.push((i, global::mean_of(&global::mean_image(images), &used)));
            continue;
        }
        // Short sets stay whole; longer ones are cut into two chunks or more.
        let pieces = if images.len() < 6 { 1 } else { images.len().div_ceil(CHUNK).max(2) };
        let size = images.len().div_ceil(pieces);
        for (c, part) in images.chunks(size).enumerate() {
            // The first frame after a change carries what came before, pixel by pixel: it has a statistic of its own.
            let after_scene = i > 0 && !matches!(settings[i - 1].kind, Kind::Dark | Kind::Flat);
            let from = match part.len() {
                // A scene leaves its picture behind for longer than a flat.
                _ if c == 0 && after_scene && pieces > 1 => continue,
                4.. if c == 0 && after_scene => 2,
                3.. if c == 0 => 1,
                _ => 0,
            };
            if let Some(r) = residual(&part[from..], &used, gain, pixels.shortest_dark.as_ref()) {
                spectrum.add(&part[from..], &r);
                if kind == Kind::Flat {
                    histogram.add(&part[from..], r.var.value);
                }
                let before = (from == 1).then(|| global::mean_used(&part[0], &used));
                chunks.push(Chunk { set: i, from: c * size + from, number: c, before, residual: r });
            }
        }
    }
    if !saturated.is_empty() {
        let numbers: Vec<String> = saturated.iter().map(|&i| sets[i].number.to_string()).collect();
        missing.push(format!("sets {} are clipped at full scale and not looked at", numbers.join(", ")));
    }
    if chunks.is_empty() {
        return Err(ObserveError::Nothing(
            "no set of darks or flats has two frames that are not clipped: nothing can be compared".into(),
        ));
    }
    for c in &chunks {
        infos[c.set].spread = global::spread(&c.residual.mean_dn, &used, pixels.zero());
    }
    let mut all = Vec::new();
    let inflation = Inflation::of(&chunks);
    for c in &chunks {
        let (i, r) = (c.set, &c.residual);
        let first = frame_of_row[sets[i].rows[c.from]];
        let half = ((i + c.number) % 2) as u8;
        let mut of = |kind, frames, value: f64, std_err: f64| {
            let measured = Value { value, std_err };
            all.push(Observable { kind, set: Some(i), half, frames, measured, pixels: r.pixels });
        };
        let m = &r.frame_means_dn;
        let n = r.frames as f64;
        let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len() as f64;
        if let Some(before) = c.before {
            let start = frame_of_row[sets[i].rows[0]];
            of(Statistic::Settling(0), (start, first + r.frames), before - mean(m), 0.0);
            if m.len() >= 2 {
                of(Statistic::Settling(1), (start, first + r.frames), m[0] - mean(&m[1..]), 0.0);
            }
        }
        let mut add = |kind, value, std_err| of(kind, (first, first + r.frames), value, std_err);
        add(Statistic::Mean, mean(m), 0.0);
        let grand = m.iter().sum::<f64>() / n;
        add(
            Statistic::FrameMeanVariance,
            m.iter().map(|v| (v - grand).powi(2)).sum::<f64>() / (n - 1.0),
            0.0,
        );
        add(Statistic::Variance, r.var.value, inflation.variance * theory_var(r));
        add(Statistic::RowVariance, r.row_var_dn2, 0.0);
        add(Statistic::ColumnVariance, r.column_var_dn2, 0.0);
        for (lag, c) in LAGS.iter().zip(&r.cov) {
            add(Statistic::Covariance(lag.0, lag.1), c.value, inflation.covariance * theory_cov(r));
        }
        add(Statistic::Successive, r.successive.value, inflation.successive * theory_cov(r));
        add(Statistic::Unequal, r.unequal.value, inflation.unequal * (8.0 / r.pixels).sqrt());
        for k in 0..2 {
            add(Statistic::Growth(k), r.growth[k].value, inflation.growth * 2.0 * theory_cov(r));
        }
    }
    // What a scene or a clipped set shows matters for the frame that follows it.
    for (i, level) in others {
        let (first, last) = (frame_of_row[sets[i].rows[0]], sets[i].rows.len());
        all.push(Observable {
            kind: Statistic::Mean,
            set: Some(i),
            half: 2,
            frames: (first, first + last),
            measured: Value { value: level, std_err: 0.0 },
            pixels: (shape.0 * shape.1) as f64,
        });
    }
    let mut whole = |kind, measured: Value| {
        all.push(Observable { kind, set: None, half: 2, frames: (0, 0), measured, pixels: 1.0 });
    };
    let steps: Vec<_> = chunks.iter().map(|c| &c.residual.mean_dn).collect();
    if let Some(taps) = global::middle_step(&steps, &used, pixels.zero()) {
        whole(Statistic::Tap(0), taps[0]);
        whole(Statistic::Tap(1), taps[1]);
    } else {
        missing.push("the sensor is too narrow to look for a step between its halves".into());
    }
    let (codes, occupancy) = histogram.finish();
    for (kind, value) in occupancy {
        whole(kind, value);
    }
    let line = spectrum.strongest();
    if let Some((_, value)) = line {
        whole(Statistic::Line, value);
    }
    let scene = global::ScenePair::of(&scene_means, &settings, pixels.zero(), &used);
    match &scene {
        Some(scene) => whole(Statistic::SceneColumns, scene.columns),
        None => missing.push(
            "no scene with a bright patch at two exposures: smear cannot be told from an exposure offset"
                .into(),
        ),
    }
    let light_rel_std = dataset.manifest().bench.as_ref().and_then(|b| b.illumination_rel_std);
    if !kinds_has(&settings, Kind::Dark) {
        missing.push("no darks: what is read noise and what is offset cannot be told".into());
    }
    let mut observations = Observations {
        campaign: Campaign {
            frames,
            sets: infos,
            shape,
            full_scale_dn: full,
            line_cycles_per_px: line.map(|l| l.0),
        },
        set_numbers: sets.iter().map(|s| s.number).collect(),
        kinds: settings.iter().map(|s| s.kind).collect(),
        all,
        scene,
        codes,
        means_given: false,
        missing,
        light_rel_std,
    };
    if let Some(rel) = light_rel_std {
        // Levels that are known bind the light of one to that of another.
        let reference = super::expect::reference_level(&observations);
        let mut lights: Vec<usize> = observations
            .all
            .iter()
            .filter(|o| o.kind == Statistic::Mean)
            .filter_map(|o| o.set.filter(|&s| observations.kinds[s] == Kind::Flat))
            .filter_map(|s| observations.campaign.sets[s].light)
            .filter(|&l| l != reference)
            .collect();
        lights.sort_unstable();
        lights.dedup();
        let std_err = rel.max(LIGHT_FLOOR) * std::f64::consts::SQRT_2;
        observations.all.extend(lights.into_iter().map(|l| Observable {
            kind: Statistic::Light(l),
            set: None,
            half: 2,
            frames: (0, 0),
            measured: Value { value: 0.0, std_err },
            pixels: 1.0,
        }));
    }
    Ok(observations)
}

fn kinds_has(settings: &[crate::dataset::FrameRow], kind: Kind) -> bool {
    settings.iter().any(|s| s.kind == kind)
}

/// Standard error of a variance for independent normal pixels.
fn theory_var(r: &Residual) -> f64 {
    r.var.value * (2.0 / (r.pixels * (r.frames as f64 - 1.0))).sqrt()
}

/// Standard error of a covariance for independent normal pixels.
fn theory_cov(r: &Residual) -> f64 {
    r.var.value / (r.pixels * (r.frames as f64 - 1.0)).sqrt()
}

/// Successive frames of a set with their statistics.
struct Chunk {
    set: usize,
    /// Place of the first frame within the set.
    from: usize,
    /// Which chunk of its set.
    number: usize,
    /// Mean of the frame before, where that is the first of the set, DN.
    before: Option<f64>,
    residual: Residual,
}

/// Jackknife errors over those of independent normal pixels, the median over all chunks: one chunk's own jackknife is noisy.
struct Inflation {
    variance: f64,
    covariance: f64,
    successive: f64,
    unequal: f64,
    growth: f64,
}

impl Inflation {
    fn of(chunks: &[Chunk]) -> Self {
        let over = |ratio: &dyn Fn(&Residual) -> f64| {
            let all: Vec<f64> =
                chunks.iter().map(|c| ratio(&c.residual)).filter(|x| x.is_finite() && *x > 0.0).collect();
            let mean = (all.iter().map(|x| x * x).sum::<f64>() / all.len().max(1) as f64).sqrt();
            let middle = median(&all, &mut Vec::new());
            // The median, unless a few levels truly scatter more.
            if middle.is_finite() && mean.is_finite() {
                middle.max(0.9 * mean.min(1.2 * middle))
            } else {
                1.0
            }
        };
        Self {
            variance: over(&|r| r.var.std_err / theory_var(r)),
            covariance: over(&|r| {
                (r.cov.iter().map(|c| c.std_err * c.std_err).sum::<f64>() / r.cov.len() as f64).sqrt()
                    / theory_cov(r)
            }),
            successive: over(&|r| r.successive.std_err / theory_cov(r)),
            unequal: over(&|r| r.unequal.std_err / (8.0 / r.pixels).sqrt()),
            growth: over(&|r| {
                r.growth[0].std_err.hypot(r.growth[1].std_err) / theory_cov(r) / 2.0 / 2f64.sqrt()
            }),
        }
    }
}

/// Which pixels take part: not clipped anywhere, not hot, not dead.
struct Pixels {
    clipped: Array2<u32>,
    dark: Option<Array2<f32>>,
    /// Mean of the dimmest darks.
    shortest_dark: Option<Array2<f32>>,
    shortest: f64,
    zero: f64,
    full: u16,
}

impl Pixels {
    fn new(shape: (usize, usize), full: u16) -> Self {
        Self {
            clipped: Array2::zeros(shape),
            dark: None,
            shortest_dark: None,
            shortest: f64::INFINITY,
            zero: 0.0,
            full,
        }
    }

    fn look(&mut self, images: &[Array2<u16>], kind: Kind) {
        let Some(first) = images.first() else { return };
        if kind == Kind::Dark {
            let mean = global::mean_image(images);
            let level = f64::from(mean.mean().unwrap_or(0.0));
            if level < self.shortest {
                (self.shortest, self.zero) = (level, level);
                self.shortest_dark = Some(mean.clone());
            }
            self.dark = Some(match self.dark.take() {
                Some(old) if old.dim() == mean.dim() => {
                    ndarray::Zip::from(&old).and(&mean).map_collect(|&a, &b| a.max(b))
                }
                _ => mean,
            });
        }
        if kind == Kind::Dark || kind == Kind::Flat {
            let all = images.len() * first.len();
            let high = images.iter().flat_map(|f| f.iter()).filter(|d| **d >= self.full).count();
            // A set that is clipped as a whole says nothing of single pixels.
            if (high as f64) < 0.02 * all as f64 {
                for f in images {
                    self.clipped.zip_mut_with(f, |c, &d| *c += u32::from(d >= self.full));
                }
            }
        }
    }

    /// Level of the shortest darks, DN.
    fn zero(&self) -> f64 {
        self.zero
    }

    fn used(&self) -> Array2<bool> {
        let mut used = self.clipped.mapv(|c| c == 0);
        if let Some(dark) = &self.dark {
            let values: Vec<f64> = dark.iter().map(|&d| f64::from(d)).collect();
            let middle = median(&values, &mut Vec::new());
            let off: Vec<f64> = values.iter().map(|v| (v - middle).abs()).collect();
            let spread = (median(&off, &mut Vec::new()) / 0.6745).max(0.5);
            used.zip_mut_with(dark, |u, &d| *u &= (f64::from(d) - middle).abs() < 8.0 * spread);
        }
        // Where most fell out, the rule was wrong and not the pixels.
        if used.iter().filter(|u| **u).count() * 2 < used.len() { used.mapv(|_| true) } else { used }
    }
}

/// Observables of a table of means and variances (and covariances, where it has them).
pub fn of_table(table: &Table) -> Result<Observations, ObserveError> {
    super::table::observations(table)
}
