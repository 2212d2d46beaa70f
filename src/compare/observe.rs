//! What a campaign says, as a list of observables: each a number with an error, of some frames of one half.

use super::global;
use super::read::{Chunk, Reading, read};
use super::scene::{Direction, ScenePair};
use crate::dataset::table::Table;
use crate::dataset::{Dataset, DatasetError, FrameRow, Kind};
use crate::statistics::covariance::LAGS;
use crate::statistics::jackknife::Value;
use crate::statistics::median::median;
use crate::statistics::pass::Summary;
use crate::statistics::successive::error_of;
use crate::statistics::taps;
use radcam_sim::predict::{Campaign, FrameInfo, NORMAL, SetInfo};
use std::ops::Range;
use std::sync::atomic::AtomicBool;

/// No lamp is known better than this, relative.
const LIGHT_FLOOR: f64 = 5e-5;

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
    /// Covariance with the next frame, DN^2.
    Successive,
    /// Excess spread of the pixels' variances.
    Unequal,
    /// Growth of the neighbour covariance along rows (0), columns (1), DN^2.
    Growth(usize),
    /// Neighbour covariance of odd columns (0), rows (1) less that of even ones, DN^2.
    Parity(usize),
    /// Step between right and left half (0), lower and upper (1), odd and even columns (2), odd and even rows (3): in proportion to
    /// the signal (0), constant (1).
    Tap(usize, usize),
    /// Codes whose bit toggles next against those before it, relative.
    Occupancy(usize),
    /// Share of codes that occur.
    CodesUsed,
    /// Variance in the strongest line of the spectrum, DN^2.
    Line,
    /// Beside a scene's bright patch, against the background away from it: the short exposure scaled up less the long one, DN.
    Leak(Direction),
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
    /// 0 or 1; 2: known beforehand, given to both fits and judged in none.
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
    /// The scene with the long and the short exposure, in each half.
    pub scenes: [Option<ScenePair>; 2],
    /// Codes of the histogram's range, in each half.
    pub codes: [Range<u32>; 2],
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
            Statistic::Parity(0) => "covariance by column parity".into(),
            Statistic::Parity(_) => "covariance by row parity".into(),
            Statistic::Tap(parts, k) => {
                let parts = ["left and right", "top and bottom", "even and odd columns", "even and odd rows"]
                    .get(*parts)
                    .unwrap_or(&"parts");
                format!("{parts}, {}", if *k == 0 { "of the signal" } else { "constant" })
            }
            Statistic::Occupancy(b) => format!("occupancy of codes, bit {b}"),
            Statistic::CodesUsed => "share of codes that occur".into(),
            Statistic::Line => "line in the spectrum".into(),
            Statistic::Leak(way) => format!("scene, {} the patch", way.name()),
            Statistic::Light(_) => "light level".into(),
        }
    }
}

/// Sets and frames in the order of time, the light levels told apart.
fn campaign(dataset: &Dataset, settings: &[FrameRow]) -> (Vec<SetInfo>, Vec<FrameInfo>) {
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
    let set = |(i, s): (usize, &FrameRow)| SetInfo {
        exposure_s: s.exposure_s,
        light: light_of(s.kind, s.illumination, i),
        illumination: s.illumination,
        spread: 0.0,
        spread_dn: 0.0,
        places: NORMAL,
    };
    let infos = settings.iter().enumerate().map(set).collect();
    let mut set_of_row = vec![0; dataset.rows().len()];
    for (i, s) in dataset.sets().iter().enumerate() {
        s.rows.iter().for_each(|&r| set_of_row[r] = i);
    }
    let mut time_s = 0.0;
    let frame = |(row, set): (&FrameRow, usize)| {
        let at = row.timestamp_s.unwrap_or(time_s);
        time_s = at + row.exposure_s;
        FrameInfo { set, time_s: at }
    };
    (infos, dataset.rows().iter().zip(set_of_row).map(frame).collect())
}

/// Reads a dataset. `progress` is told (pieces done, pieces).
pub fn of_dataset(
    dataset: &Dataset,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Observations, ObserveError> {
    let camera = &dataset.manifest().camera;
    let shape = (camera.height, camera.width);
    let sets = dataset.sets();
    let settings: Vec<_> = sets.iter().map(|s| dataset.settings(s).clone()).collect();
    let (mut infos, frames) = campaign(dataset, &settings);
    let Reading { layout, zero_dn, chunks, scenes, codes, lines, saturated } = read(dataset, stop, progress)?;
    let mut missing = Vec::new();
    if !saturated.is_empty() {
        let numbers: Vec<String> = saturated.iter().map(|s| sets[s.0].number.to_string()).collect();
        missing.push(format!("sets {} are clipped at full scale and not looked at", numbers.join(", ")));
    }
    if chunks.is_empty() {
        return Err(ObserveError::Nothing(
            "no set of darks or flats has two frames that are not clipped: nothing can be compared".into(),
        ));
    }
    for c in &chunks {
        let above = c.said.frame_means.mean_dn() - zero_dn;
        let spread_dn = c.said.spatial_var_dn2.max(0.0).sqrt();
        infos[c.set].spread_dn = spread_dn;
        infos[c.set].places = c.said.places;
        infos[c.set].spread = if above > 5.0 { (spread_dn / above).min(0.3) } else { 0.0 };
    }
    // Flats have one pattern of light and response. Where the range ended an image has lost it: what others show holds before that.
    // Dim ones have more of the offsets' pattern.
    let above = |c: &Chunk| c.said.frame_means.mean_dn() - zero_dn;
    let top = chunks.iter().map(above).fold(0.0, f64::max);
    let bright: Vec<usize> = chunks
        .iter()
        .filter(|c| settings[c.set].kind == Kind::Flat && above(c) > 0.25 * top)
        .map(|c| c.set)
        .collect();
    let whole = bright.iter().map(|&s| infos[s]).max_by(|a, b| a.spread.total_cmp(&b.spread));
    if let Some(whole) = whole {
        for s in bright {
            if infos[s].spread < 0.9 * whole.spread {
                (infos[s].spread, infos[s].places) = (whole.spread, whole.places);
            }
        }
    }
    let mut all = Vec::new();
    let inflation = Inflation::of(&chunks);
    chunks.iter().for_each(|c| of_chunk(c, &sets[c.set].rows, &inflation, &mut all));
    // What a scene or a clipped set shows matters for the frame that follows it: known beforehand, and judged in neither half.
    let levels = scenes.iter().map(|s| (s.set, global::mean_of(&s.mean_dn, &layout)));
    for (i, level) in levels.chain(saturated) {
        let rows = &sets[i].rows;
        all.push(Observable {
            kind: Statistic::Mean,
            set: Some(i),
            half: 2,
            frames: (rows[0], rows[0] + rows.len()),
            measured: Value { value: level, std_err: 0.0 },
            pixels: (shape.0 * shape.1) as f64,
        });
    }
    let line = lines[0].with(&lines[1]).strongest();
    let mut ranges = [0..0, 0..0];
    let mut pairs = [None, None];
    for (half, codes) in codes.into_iter().enumerate() {
        let mut whole = |kind, measured: Value| {
            let half = half as u8;
            all.push(Observable { kind, set: None, half, frames: (0, 0), measured, pixels: 1.0 });
        };
        let of_half = || chunks.iter().filter(|c| usize::from(c.half) == half);
        let said: Vec<&Summary> = of_half().map(|c| &c.said).collect();
        let profiles = |of: fn(&Summary) -> &[f64]| -> Vec<(f64, &[f64])> {
            said.iter().map(|s| (s.frame_means.mean_dn() - zero_dn, of(s))).collect()
        };
        let (columns, rows) = (profiles(|s| &s.columns_dn), profiles(|s| &s.rows_dn));
        let steps = [taps::middle(&columns), taps::middle(&rows), taps::odd(&columns), taps::odd(&rows)];
        for (parts, step) in steps.into_iter().enumerate() {
            for (k, value) in step.into_iter().flatten().enumerate() {
                // Their error is the sensor's pattern, which both halves have: together they know no more than one.
                let std_err = value.std_err * std::f64::consts::SQRT_2;
                whole(Statistic::Tap(parts, k), Value { std_err, ..value });
            }
        }
        let (range, occupancy) = codes.finish();
        ranges[half] = range;
        occupancy.into_iter().for_each(|(kind, value)| whole(kind, value));
        if let Some((place, _)) = line {
            whole(Statistic::Line, lines[half].at(place));
        }
        let of_half: Vec<_> = scenes.iter().filter(|s| usize::from(s.half) == half).collect();
        pairs[half] = ScenePair::of(&of_half, &settings, zero_dn, &layout);
        if let Some(scene) = &pairs[half] {
            scene.leaks.iter().for_each(|(way, value)| whole(Statistic::Leak(*way), *value));
        }
    }
    if shape.0.min(shape.1) < 64 {
        missing.push(format!(
            "{} x {} pixels are too few for a step between parts of the sensor",
            shape.1, shape.0
        ));
    }
    if pairs.iter().all(Option::is_none) {
        missing.push(
            "no scene with a bright patch at two exposures: smear cannot be told from an exposure offset"
                .into(),
        );
    }
    if settings.iter().all(|s| s.kind != Kind::Dark) {
        missing.push("no darks: what is read noise and what is offset cannot be told".into());
    }
    let mut observations = Observations {
        campaign: Campaign {
            frames,
            sets: infos,
            shape,
            full_scale_dn: f64::from(camera.full_scale_dn()),
            line_cycles_per_px: line.map(|l| l.1),
        },
        set_numbers: sets.iter().map(|s| s.number).collect(),
        kinds: settings.iter().map(|s| s.kind).collect(),
        all,
        scenes: pairs,
        codes: ranges,
        means_given: false,
        missing,
        light_rel_std: dataset.manifest().bench.as_ref().and_then(|b| b.illumination_rel_std),
    };
    known_lights(&mut observations);
    Ok(observations)
}

/// Levels that are known bind the light of one to that of another.
fn known_lights(all: &mut Observations) {
    let Some(rel) = all.light_rel_std else { return };
    let reference = super::expect::reference_level(all);
    let flats = all.all.iter().filter(|o| o.kind == Statistic::Mean);
    let flats = flats.filter_map(|o| o.set.filter(|&s| all.kinds[s] == Kind::Flat));
    let mut lights: Vec<usize> =
        flats.filter_map(|s| all.campaign.sets[s].light).filter(|&l| l != reference).collect();
    lights.sort_unstable();
    lights.dedup();
    let std_err = rel.max(LIGHT_FLOOR) * std::f64::consts::SQRT_2;
    all.all.extend(lights.into_iter().map(|l| Observable {
        kind: Statistic::Light(l),
        set: None,
        half: 2,
        frames: (0, 0),
        measured: Value { value: 0.0, std_err },
        pixels: 1.0,
    }));
}

/// Observables of one chunk; `rows` are those of its set, in the order of time.
fn of_chunk(c: &Chunk, rows: &[usize], inflation: &Inflation, all: &mut Vec<Observable>) {
    let (r, means) = (&c.said, &c.said.frame_means);
    let first = rows[c.from];
    let mut of = |kind, frames, value: f64, std_err: f64| {
        let measured = Value { value, std_err };
        all.push(Observable { kind, set: Some(c.set), half: c.half, frames, measured, pixels: r.pixels });
    };
    let end = first + r.frames;
    if let Some(before) = c.before {
        of(Statistic::Settling(0), (rows[0], end), before - means.mean_dn(), 0.0);
        of(Statistic::Settling(1), (rows[0], end), means.first_step_dn(), 0.0);
    }
    let mut add = |kind, value, std_err| of(kind, (first, end), value, std_err);
    add(Statistic::Mean, means.mean_dn(), 0.0);
    add(Statistic::FrameMeanVariance, means.variance_dn2(), 0.0);
    add(Statistic::Variance, r.var.value, inflation.variance * theory_var(r));
    add(Statistic::RowVariance, r.line_var_dn2[0], 0.0);
    add(Statistic::ColumnVariance, r.line_var_dn2[1], 0.0);
    for (lag, c) in LAGS.iter().zip(&r.covariances.at) {
        add(Statistic::Covariance(lag.0, lag.1), c.value, inflation.covariance * theory_cov(r));
    }
    if r.frames > 2 {
        add(Statistic::Successive, r.successive.value, inflation.successive * theory_next(r));
    }
    add(Statistic::Unequal, r.unequal.value, inflation.unequal * (8.0 / r.pixels).sqrt());
    for k in 0..2 {
        let std_err = inflation.covariance * 2.0 * theory_cov(r);
        add(Statistic::Growth(k), r.covariances.growth[k].value, std_err);
        add(Statistic::Parity(k), r.covariances.parity[k].value, std_err);
    }
}

/// Standard error of a variance for independent normal pixels.
fn theory_var(r: &Summary) -> f64 {
    r.var.value * (2.0 / (r.pixels * (r.frames as f64 - 1.0))).sqrt()
}

/// Standard error of a covariance for independent normal pixels.
fn theory_cov(r: &Summary) -> f64 {
    r.var.value / (r.pixels * (r.frames as f64 - 1.0)).sqrt()
}

/// Standard error of the covariance with the next frame for independent normal pixels.
fn theory_next(r: &Summary) -> f64 {
    r.var.value * error_of(r.frames) / r.pixels.sqrt()
}

/// Jackknife errors over those of independent normal pixels, the median over all chunks: one chunk's own jackknife is noisy.
struct Inflation {
    variance: f64,
    covariance: f64,
    successive: f64,
    unequal: f64,
}

impl Inflation {
    fn of(chunks: &[Chunk]) -> Self {
        let over = |ratio: &dyn Fn(&Summary) -> f64| {
            let all: Vec<f64> =
                chunks.iter().map(|c| ratio(&c.said)).filter(|x| x.is_finite() && *x > 0.0).collect();
            let mean = (all.iter().map(|x| x * x).sum::<f64>() / all.len().max(1) as f64).sqrt();
            let middle = median(all.iter().copied());
            // The median, unless a few levels truly scatter more.
            if middle.is_finite() && mean.is_finite() {
                middle.max(0.9 * mean.min(1.2 * middle))
            } else {
                1.0
            }
        };
        let lags = |r: &Summary| r.covariances.at.iter().map(|c| c.std_err * c.std_err).sum::<f64>();
        Self {
            variance: over(&|r| r.var.std_err / theory_var(r)),
            covariance: over(&|r| (lags(r) / LAGS.len() as f64).sqrt() / theory_cov(r)),
            successive: over(&|r| r.successive.std_err / theory_next(r)),
            unequal: over(&|r| r.unequal.std_err / (8.0 / r.pixels).sqrt()),
        }
    }
}

/// Observables of a table of means and variances (and covariances, where it has them).
pub fn of_table(table: &Table) -> Result<Observations, ObserveError> {
    super::table::observations(table)
}
