//! Reads the frames of a campaign: a first look at every set, then one pass over all frames.
//!
//! Memory use does not depend on the number of frames: each core holds some frames and their sums, and
//! decoded frames take at most 256 MiB.

use super::campaign::is_quiet;
use super::left_out::words;
use super::{Half, ObserveError, STATISTICS, SUMMED, codes};
use crate::dataset::{Dataset, Key, Kind, Reduced, Set};
use crate::first_look::{FIRST, Look, Seen, middle};
use crate::statistics::between_sets::{MeanFrame, noise_over_that_within};
use crate::statistics::covariance::LAGS;
use crate::statistics::jackknife::Value;
use crate::statistics::layout::Layout;
use crate::statistics::outliers;
use crate::statistics::pass::{Pass, Summary};
use crate::statistics::powers::Powers;
use crate::statistics::quantisation::SMALLEST_DARK_DN2;
use crate::statistics::spectrum::Power;
use crate::statistics::steady::{Group, Levels, PixelNoise, Steady};
use ndarray::Array2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// A set is cut into pieces of about this many frames, and into at most [`PIECES`].
const PIECE: usize = 8;
const PIECES: usize = 8;
/// Share of clipped samples above which a set is excluded.
const CLIPPED: f64 = 1e-3;

/// Successive frames of a set with their statistics.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Chunk {
    pub set: usize,
    /// Index of the first frame in the set.
    pub from: usize,
    /// Half of the campaign that the chunk belongs to.
    pub half: Half,
    /// Mean of the frame before the chunk if that frame is the first of the set, DN.
    pub before: Option<f64>,
    /// Share of occurring codes around the level, and its error.
    pub codes_used: Option<(f64, f64)>,
    /// Noise of the means of this and a few other sets of few frames over that within them; of the whole
    /// campaign, and not stored with the chunk.
    #[serde(skip)]
    pub from_set_to_set: Option<Value>,
    pub summary: Summary,
    /// Variance of every pixel of short darks until they are summed up, DN^2.
    var_dn2: Vec<f32>,
    /// Sums of powers of every pixel's deviations in the same frames, and the pixel's mean minus that of the
    /// frames, DN.
    #[serde(default)]
    single: Option<(Powers, Vec<f32>)>,
}

/// Mean image of the frames of a scene in one half, DN.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SceneMean {
    pub set: usize,
    pub half: Half,
    /// Range of its frames in the set.
    #[serde(default)]
    pub frames: (usize, usize),
    pub mean_dn: Array2<f32>,
}

/// Clipped set with the mean of its last frames.
#[derive(Debug, Clone, Copy)]
pub struct Saturated {
    pub set: usize,
    pub level_dn: f64,
    /// Range of these frames in the set.
    pub frames: (usize, usize),
}

/// Result of reading a campaign.
pub struct Reading {
    pub layout: Layout,
    /// Level of the shortest darks, DN.
    pub zero_dn: f64,
    pub chunks: Vec<Chunk>,
    pub scenes: Vec<SceneMean>,
    /// Codes and spectra of both halves.
    pub codes: [codes::Codes; 2],
    pub lines: [codes::LineSearch; 2],
    /// Covariance of the pixels' variances between short darks, DN^4.
    pub steady_dn4: Option<Value>,
    /// Covariance of the variances of pixels two columns and two rows apart, DN^4.
    pub together_dn4: Option<[Value; 2]>,
    /// Distribution of the pixels' noise in short darks.
    pub pixel_noise: Option<PixelNoise>,
    /// Excess kurtosis of noisy pixels in the short darks of both halves.
    pub noisy_levels: [[Option<Levels>; 3]; 2],
    /// Code below which one in two hundred samples of the darks lies.
    pub darkest_dn: Option<f64>,
    /// Clipped sets.
    pub saturated: Vec<Saturated>,
    /// Frames and samples that were left out, in words.
    pub left_out: Vec<String>,
}

/// Piece of work: frames `from..to` of a set.
#[derive(Debug, Clone, Copy)]
struct Piece {
    set: usize,
    from: usize,
    to: usize,
    half: Half,
    before: bool,
}

/// Cuts the sets into pieces. Successive frames stay together, so that noise correlated from frame to frame
/// stays in one half. The first piece of one set goes to half 0, that of the next set to half 1: both halves
/// see what follows a change of level.
fn pieces(dataset: &Dataset) -> Vec<Piece> {
    let sets = dataset.sets();
    let kinds: Vec<Kind> = sets.iter().map(|s| dataset.settings(s).kind).collect();
    let cut: Vec<bool> = sets.iter().map(|s| s.rows.len() >= CUT).collect();
    let turns = turns(&kinds, &cut);
    let still = |i: usize| !matches!(dataset.settings(&sets[i]).kind, Kind::Dark | Kind::Flat);
    let mut out = Vec::new();
    for (set, info) in sets.iter().enumerate() {
        let frames = info.rows.len();
        let count = if frames < CUT { 1 } else { frames.div_ceil(PIECE).clamp(2, PIECES) };
        let size = frames.div_ceil(count).max(1);
        let after_scene = set > 0 && still(set - 1);
        for (number, start) in (0..frames).step_by(size).enumerate() {
            let to = (start + size).min(frames);
            // The first frame after a change carries the level before, pixel by pixel; it has a statistic of
            // its own. A scene persists for longer than a flat.
            let skip = match to - start {
                _ if still(set) || number > 0 => 0,
                _ if after_scene && count > 1 => continue,
                4.. if after_scene => 2,
                3.. => 1,
                _ => 0,
            };
            let half = Half::TURNS[(turns[set] + number) % 2];
            out.push(Piece { set, from: start + skip, to, half, before: skip == 1 });
        }
    }
    out
}

/// Minimum number of frames of a set that is cut into pieces for both halves.
const CUT: usize = 6;

/// Minimum share of the sets of a kind in each half, of those that are not cut (a named choice).
const SHARE: f64 = 0.25;

/// Assigns the sets to the halves in turn. If that gives nearly all darks to one half and nearly all flats to
/// the other, as when each flat is followed by its dark, the turns are taken within each kind.
fn turns(kinds: &[Kind], cut: &[bool]) -> Vec<usize> {
    let one_sided = |kind: Kind| {
        let of_kind = || (0..kinds.len()).filter(|s| kinds[*s] == kind && !cut[*s]);
        let (all, odd) = (of_kind().count() as f64, of_kind().filter(|s| s % 2 == 1).count() as f64);
        all > 1.0 && odd.min(all - odd) < SHARE * all
    };
    if !one_sided(Kind::Dark) && !one_sided(Kind::Flat) {
        return (0..kinds.len()).collect();
    }
    (0..kinds.len()).map(|s| kinds[..s].iter().filter(|k| **k == kinds[s]).count()).collect()
}

/// Result of reading one piece.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum Work {
    Scene(SceneMean),
    Noise(Option<Box<Chunk>>),
    /// Set, mean in DN, and range of the frames averaged.
    Clipped(usize, f64, usize, usize),
}

impl Work {
    /// Returns true if the result fits frames of (rows, columns) with codes up to a full scale.
    pub fn fits(&self, shape: (usize, usize), full_scale_dn: u16) -> bool {
        let c = match self {
            Self::Scene(scene) => return scene.mean_dn.dim() == shape,
            Self::Clipped(..) | Self::Noise(None) => return true,
            Self::Noise(Some(chunk)) => chunk,
        };
        let s = &c.summary;
        s.frames > 1
            && (s.rows_dn.len(), s.columns_dn.len()) == shape
            && s.power.len() == Power::length(shape) / 2 + 1
            && s.occupancy.0.len() == usize::from(full_scale_dn) + 1
            && s.covariances.at.len() == LAGS.len()
            && (c.var_dn2.is_empty() || c.var_dn2.len() == shape.0 * shape.1)
            && c.single.as_ref().is_none_or(|(powers, mean)| {
                let all = [mean, &powers.thirds, &powers.fourths];
                !c.var_dn2.is_empty() && all.iter().all(|v| v.len() == shape.0 * shape.1)
            })
    }
}

/// Frames and samples excluded from a piece.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct LeftOut {
    /// Indices in the set of frames that lie far from the others.
    pub(super) frames: Vec<usize>,
    /// Pixels of struck samples, with the frame indices.
    pub(super) struck: Vec<(usize, usize)>,
    /// True if any sample was taken for a struck one. Otherwise the result is the same without removal of
    /// struck samples.
    cleaned: bool,
}

impl LeftOut {
    /// Returns true if the list fits frames of this many pixels.
    pub fn fits(&self, pixels: usize) -> bool {
        self.struck.iter().all(|s| s.0 < pixels)
    }
}

/// Context for reading all pieces.
struct Reader<'a, 'b> {
    dataset: &'a Dataset,
    layout: &'b Layout,
    /// Digest that pieces read elsewhere must share: the first look and the statistics.
    under: String,
    pool: Mutex<Vec<Pass<'b>>>,
    stop: &'a AtomicBool,
    usual: outliers::Usual,
    zero_dn: f64,
    /// True if samples that stand out are removed as struck ones.
    clean: bool,
    /// Longest exposure of flats, s.
    longest_lit_s: f64,
    quiet_dark_dn2: f64,
    /// First look at each set.
    looks: &'b [Look],
}

impl<'a, 'b> Reader<'a, 'b> {
    fn new(dataset: &'a Dataset, seen: &'b Seen, stop: &'a AtomicBool) -> Self {
        Self {
            dataset,
            layout: &seen.layout,
            under: seen.digest(STATISTICS.iter().map(|s| s.id())),
            pool: Mutex::new(Vec::new()),
            stop,
            usual: seen.usual,
            zero_dn: seen.zero_dn,
            clean: dataset.struck_are_rays(),
            longest_lit_s: seen.longest_lit_s,
            quiet_dark_dn2: seen.quiet_dark_dn2,
            looks: &seen.looks,
        }
    }

    fn frame(&self, set: usize, place: usize) -> Result<Arc<Array2<u16>>, ObserveError> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(ObserveError::Interrupted);
        }
        let row = self.dataset.sets()[set].rows[place];
        Ok(self.dataset.frame(&self.dataset.rows()[row])?)
    }

    fn key(&self, p: &Piece, clean: bool) -> Key {
        let set = Key::first(self.dataset, &self.dataset.sets()[p.set], usize::MAX);
        Key { from: p.from, to: p.to, before: p.before, clean, under: self.under.clone(), ..set }
    }

    /// Returns the recorded result of a piece if it was read under the same look and is complete.
    fn known(&self, p: &Piece) -> Option<(Work, LeftOut)> {
        let reduced = self.dataset.reduced()?;
        let cleaned =
            reduced.get::<(Work, LeftOut)>(&self.key(p, true)).filter(|(_, l)| self.clean || !l.cleaned);
        let (mut work, left_out) =
            cleaned.or_else(|| reduced.get::<(Work, LeftOut)>(&self.key(p, self.clean)))?.clone();
        match &mut work {
            Work::Scene(scene) => (scene.set, scene.half) = (p.set, p.half),
            Work::Clipped(set, ..) => *set = p.set,
            Work::Noise(None) => {}
            Work::Noise(Some(chunk)) => {
                (chunk.set, chunk.half) = (p.set, p.half);
                let expected = SUMMED.iter().map(|s| s.size(self.layout));
                if !chunk.summary.extra.iter().map(Vec::len).eq(expected) {
                    return None;
                }
            }
        }
        Some((work, left_out))
    }

    fn known_or_read(&self, p: &Piece) -> Result<(Work, LeftOut), ObserveError> {
        self.known(p).map_or_else(|| self.piece(p), Ok)
    }

    fn piece(&self, p: &Piece) -> Result<(Work, LeftOut), ObserveError> {
        let kind = self.dataset.settings(&self.dataset.sets()[p.set]).kind;
        let mut out = LeftOut::default();
        if !matches!(kind, Kind::Dark | Kind::Flat) {
            let mut sum = self.frame(p.set, p.from)?.mapv(f32::from);
            for place in p.from + 1..p.to {
                sum.zip_mut_with(&self.frame(p.set, place)?, |m, &d| *m += f32::from(d));
            }
            let mean_dn = sum / (p.to - p.from) as f32;
            return Ok((
                Work::Scene(SceneMean { set: p.set, half: p.half, frames: (p.from, p.to), mean_dn }),
                out,
            ));
        }
        // Passes are recycled: fresh memory pages cost as much as the frames.
        let free = || self.pool.lock().unwrap_or_else(PoisonError::into_inner);
        let mut pass = free().pop().unwrap_or_else(|| Pass::with(self.layout, SUMMED));
        pass.of_single_pixels(self.is_short_dark(p.set));
        let (mut from, mut to) = (p.from, p.to);
        let work = loop {
            let outlier = self.add(p, from..to, kind == Kind::Dark, &mut pass, &mut out)?;
            let Some(outlier) = outlier else { break self.summarise(p, from, &mut pass, &mut out) };
            // The piece keeps the longer run of frames without the outlier.
            out.frames.push(outlier);
            out.struck.clear();
            pass.clear();
            if outlier - from >= to - outlier {
                to = outlier
            } else {
                from = outlier + 1
            }
            if to < from + 2 {
                break Ok(Work::Noise(None));
            }
        };
        pass.clear();
        free().push(pass);
        Ok((work?, out))
    }

    /// Adds frames to a pass until one lies far from the others, and returns the index of that frame.
    fn add(
        &self,
        p: &Piece,
        places: std::ops::Range<usize>,
        dark: bool,
        pass: &mut Pass<'b>,
        out: &mut LeftOut,
    ) -> Result<Option<usize>, ObserveError> {
        let wrong = |e: crate::statistics::moments::SizeMismatch| ObserveError::Nothing(e.to_string());
        let size = outliers::block_size(places.len());
        for start in places.clone().step_by(size) {
            let end = (start + size).min(places.end);
            let frames = (start..end).map(|i| self.frame(p.set, i));
            let mut block =
                frames.map(|f| f.map(Arc::unwrap_or_clone)).collect::<Result<Vec<Array2<u16>>, _>>()?;
            let outlier = if end - start < outliers::FEWEST {
                self.without_struck(&mut block, start, out);
                None
            } else {
                self.without_outliers(p.set, &mut block, start, dark, out)
            };
            if let Some(outlier) = outlier {
                return Ok(Some(start + outlier));
            }
            for frame in &block {
                pass.add(frame.as_slice().unwrap_or(&[])).map_err(wrong)?;
            }
        }
        Ok(None)
    }

    /// Removes struck samples from a block.
    fn without_struck(&self, block: &mut [Array2<u16>], start: usize, out: &mut LeftOut) {
        if self.clean {
            let struck = outliers::take_struck(block);
            out.cleaned |= !struck.is_empty();
            out.struck.extend(struck.into_iter().map(|(f, pixel)| (pixel, start + f)));
        }
    }

    /// Returns the frame of a block that lies far from the others, unless a few struck samples cause it. The
    /// struck samples of a block without such a frame are removed.
    fn without_outliers(
        &self,
        set: usize,
        block: &mut Vec<Array2<u16>>,
        start: usize,
        dark: bool,
        out: &mut LeftOut,
    ) -> Option<usize> {
        let outlier = self.outlier(set, block, start, dark);
        if !self.clean || outlier.is_some() && block.len() <= 2 {
            return outlier;
        }
        let whole = outlier.map(|_| block.clone());
        let struck = outliers::take_struck(block);
        if let Some(whole) = whole {
            out.cleaned |= !struck.is_empty();
            let outlier = self.outlier(set, block, start, dark);
            if outlier.is_some() {
                *block = whole;
                return outlier;
            }
        }
        out.cleaned |= !struck.is_empty();
        out.struck.extend(struck.into_iter().map(|(f, pixel)| (pixel, start + f)));
        None
    }

    /// Returns the first frame of a block that lies far from the others.
    fn outlier(&self, set: usize, block: &[Array2<u16>], start: usize, dark: bool) -> Option<usize> {
        let apart = outliers::apart(block);
        // The first frames of a set may carry the level before.
        let before = |outlier: usize| match outlier.checked_sub(1) {
            Some(before) => Some(apart.mean_dn[before]),
            None => {
                let before = start.checked_sub(1).and_then(|i| self.frame(set, i).ok());
                before.map(|f| outliers::mean_dn(&f) - apart.level_dn)
            }
        };
        let carried = |outlier: usize| {
            let dies_away = |b: f64| outliers::dies_away(b, apart.mean_dn[outlier]);
            start + outlier <= 2 && before(outlier).is_none_or(dies_away)
        };
        // A level that still settles: the middle frame is not at the final level, but each step is less than
        // the one before.
        let settling = |outlier: usize| {
            let step = |k: usize| apart.mean_dn[k] - apart.mean_dn[k - 1];
            start <= 1 && outlier == 2 && outliers::dies_away(step(outlier - 1), step(outlier))
        };
        let none = outliers::Apart::default();
        let of_set = self.looks.get(set).and_then(|l| l.apart.as_ref()).map_or(&none, |(_, apart)| apart);
        let mut outliers = self.usual.outliers(&apart, of_set, dark, start, self.zero_dn);
        outliers.retain(|outlier| !carried(*outlier) && !settling(*outlier));
        // If many frames deviate, none is an outlier.
        outliers.first().copied().filter(|_| outliers.len() * 3 <= block.len())
    }

    /// Returns true for short darks. Longer ones have shot noise of dark charge, which also stays with its
    /// pixels.
    fn is_short_dark(&self, set: usize) -> bool {
        let noise_dn2 = self.looks.get(set).and_then(Look::var_dn2);
        if noise_dn2.is_some_and(|var| var > self.quiet_dark_dn2) {
            return false;
        }
        let set = self.dataset.settings(&self.dataset.sets()[set]);
        set.kind == Kind::Dark && set.exposure_s <= self.longest_lit_s
    }

    /// Returns the mean of the frame before a piece, without struck samples, DN.
    fn first_frame_dn(&self, p: &Piece, from: usize, out: &mut LeftOut) -> Result<f64, ObserveError> {
        let places = from - 1..(from + outliers::BLOCK - 1).min(p.to);
        if !self.clean {
            return Ok(codes::mean_of(&self.frame(p.set, from - 1)?.mapv(f32::from), self.layout));
        }
        let frames = places.map(|i| self.frame(p.set, i).map(Arc::unwrap_or_clone));
        let mut block = frames.collect::<Result<Vec<_>, _>>()?;
        let struck = outliers::take_struck(&mut block);
        let own = struck.into_iter().filter(|(frame, _)| *frame == 0);
        let before = out.struck.len();
        out.struck.extend(own.map(|(_, pixel)| (pixel, from - 1)));
        out.cleaned |= out.struck.len() > before;
        Ok(codes::mean_of(&block[0].mapv(f32::from), self.layout))
    }

    /// Summarises the frames in a pass.
    fn summarise(
        &self,
        p: &Piece,
        from: usize,
        pass: &mut Pass<'_>,
        out: &mut LeftOut,
    ) -> Result<Work, ObserveError> {
        if pass.clipped() > CLIPPED || self.looks.get(p.set).is_some_and(|look| look.saturated) {
            return Ok(Work::Clipped(p.set, pass.mean_dn(), from, p.to));
        }
        let summary = pass.finish();
        let is_short_dark = self.is_short_dark(p.set);
        let before = if p.before && from == p.from { Some(self.first_frame_dn(p, from, out)?) } else { None };
        let chunk = |summary: Summary| {
            let codes_used = codes::share_used(&summary);
            let var_dn2 = if is_short_dark { pass.variances_dn2() } else { Vec::new() };
            Box::new(Chunk {
                set: p.set,
                from,
                half: p.half,
                before,
                codes_used,
                from_set_to_set: None,
                summary,
                var_dn2,
                single: pass.single_pixels(),
            })
        };
        Ok(Work::Noise(summary.map(chunk)))
    }
}

/// Sums over all pieces.
struct Sums {
    chunks: Vec<Chunk>,
    scenes: Vec<SceneMean>,
    /// Clipped sets.
    saturated: Vec<Saturated>,
    codes: [codes::Codes; 2],
    lines: [codes::LineSearch; 2],
    steady: Steady,
    left_out: Vec<(usize, LeftOut)>,
}

impl Sums {
    fn new(full: u16, shape: (usize, usize)) -> Self {
        let (codes, lines) = (|| codes::Codes::new(full), || codes::LineSearch::new(shape));
        Self {
            chunks: Vec::new(),
            scenes: Vec::new(),
            saturated: Vec::new(),
            codes: [codes(), codes()],
            lines: [lines(), lines()],
            steady: Steady::new(shape.0 * shape.1),
            left_out: Vec::new(),
        }
    }

    /// Adds the summary of a piece of a set of this kind and exposure.
    fn add(&mut self, work: Work, kind: Kind, exposure_s: f64) {
        let mut chunk = match work {
            Work::Scene(scene) => return self.scenes.push(scene),
            Work::Clipped(set, level_dn, from, to) => {
                // The next set follows the last frames of this one.
                self.saturated.retain(|s| s.set != set);
                return self.saturated.push(Saturated { set, level_dn, frames: (from, to) });
            }
            Work::Noise(None) => return,
            Work::Noise(Some(chunk)) => chunk,
        };
        let half = chunk.half.place();
        self.lines[half].add(&chunk.summary);
        if kind == Kind::Flat {
            self.codes[half].add(&chunk.summary);
        }
        if !chunk.var_dn2.is_empty() && !is_quiet(&chunk.summary) {
            let Summary { var, frames, .. } = chunk.summary;
            self.steady.add(&chunk.var_dn2, var.value, frames);
            if let Some((powers, mean_dn)) = chunk.single.take() {
                let dof = frames as f32 - 1.0;
                let squares = chunk.var_dn2.iter().map(|v| dof * v).collect();
                let level_dn = chunk.summary.frame_means.mean_dn();
                let frames = frames as u64;
                self.steady.add_run(half, Group { exposure_s, frames, level_dn, mean_dn, squares, powers });
            }
        }
        // These arrays are long, and only their sums are needed.
        (chunk.summary.power, chunk.summary.occupancy.0) = (Vec::new(), Vec::new());
        (chunk.var_dn2, chunk.single) = (Vec::new(), None);
        self.chunks.push(*chunk);
    }

    /// Returns the pixels of samples that stand far above the same pixel in other frames.
    fn struck(&self) -> Vec<usize> {
        self.left_out.iter().flat_map(|(_, l)| l.struck.iter().map(|s| s.0)).collect()
    }
}

/// Reads the frames of a dataset. `progress` is told (pieces done, pieces).
pub fn read(
    dataset: &Dataset,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Reading, ObserveError> {
    let camera = &dataset.manifest().camera;
    let (full, shape) = (camera.full_scale_dn(), (camera.height, camera.width));
    let sets = dataset.sets();
    let pieces = pieces(dataset);
    let of = pieces.len() + sets.len() / 4;
    if dataset.rows().is_empty() {
        return Err(ObserveError::Nothing("the dataset has no frames".into()));
    }
    let seen = Seen::new(dataset, stop, &mut |seen| progress(seen / 4, of))?;
    let mut reader = Reader::new(dataset, &seen, stop);
    let samples = (shape.0 * shape.1) as f64 * dataset.rows().len() as f64;
    let mut sums = loop {
        let mut sums = Sums::new(full, shape);
        let mut seen = sets.len() / 4;
        for group in pieces.chunks(4 * rayon::current_num_threads()) {
            let work: Vec<(Work, LeftOut)> =
                group.par_iter().map(|p| reader.known_or_read(p)).collect::<Result<_, _>>()?;
            for (p, (work, left_out)) in group.iter().zip(work) {
                sums.left_out.push((p.set, left_out));
                let settings = dataset.settings(&sets[p.set]);
                sums.add(work, settings.kind, settings.exposure_s);
            }
            seen += group.len();
            progress(seen, of);
        }
        let struck = sums.struck();
        if !reader.clean
            || struck.is_empty()
            || outliers::are_rays(&struck, samples, (shape.0 * shape.1) as f64)
        {
            break sums;
        }
        // If the same pixels stand out again and again, they belong to the sensor: no sample is removed.
        tracing::debug!("{} samples stand far off, often the same: they belong to the sensor", struck.len());
        reader.clean = false;
    };
    drop(reader);
    dataset.forget_frames();
    sums.chunks.retain(|c| sums.saturated.iter().all(|s| s.set != c.set));
    compare_means(&mut sums.chunks, dataset, &seen);
    let mut left_out = words(dataset, &sums.left_out);
    if seen.filled > 0 {
        left_out.push(format!(
            "{} pixels are interpolated from their neighbours by the camera (defect pixel correction) and are left out",
            seen.filled
        ));
    }
    Ok(Reading {
        left_out,
        steady_dn4: sums.steady.covariance(&seen.layout),
        darkest_dn: seen.darkest_dn,
        together_dn4: sums.steady.of_neighbours(&seen.layout),
        pixel_noise: sums.steady.distribution(&seen.layout),
        noisy_levels: sums.steady.levels(&seen.layout),
        zero_dn: seen.zero_dn,
        layout: seen.layout,
        chunks: sums.chunks,
        scenes: sums.scenes,
        codes: sums.codes,
        lines: sums.lines,
        saturated: sums.saturated,
    })
}

/// Number of darks and of flats whose means are compared at a time.
const COMPARED: [usize; 2] = [3, 4];
/// Maximum level of flats that are compared, relative to the brightest: wells that fill, and converters that
/// clip, change the fixed pattern (a named choice).
const MAX_LEVEL: f64 = 0.75;
/// Maximum variance of the frame means, relative to that of a pixel: a level that is carried over from the
/// set before brings the pattern of that set, some tenths of itself (a named choice).
const MAX_MOVE: f64 = 0.5;

/// Compares the means of sets of few frames of one half: darks in the order of their exposures, flats of one
/// position of the light in the order of their levels.
fn compare_means(chunks: &mut [Chunk], dataset: &Dataset, seen: &Seen) {
    let settings = |c: &Chunk| dataset.settings(&dataset.sets()[c.set]);
    let level = |c: &Chunk| c.summary.frame_means.mean_dn() - seen.zero_dn;
    let brightest = chunks.iter().map(level).fold(0.0, f64::max);
    let lights: BTreeSet<u32> =
        chunks.iter().filter(|c| settings(c).kind == Kind::Flat).map(|c| settings(c).configuration).collect();
    let groups = std::iter::once((Kind::Dark, None)).chain(lights.into_iter().map(|l| (Kind::Flat, Some(l))));
    for (half, (kind, light)) in groups.flat_map(|group| Half::TURNS.map(|half| (half, group))) {
        let is_compared = |c: &Chunk| {
            let set = &dataset.sets()[c.set];
            settings(c).kind == kind
                && light.is_none_or(|light| settings(c).configuration == light)
                && c.half == half
                && c.summary.frames == set.rows.len()
                && c.summary.var.value > SMALLEST_DARK_DN2
                && c.summary.frame_means.variance_dn2() < MAX_MOVE * c.summary.var.value
                && (kind == Kind::Dark || level(c) < MAX_LEVEL * brightest)
        };
        let mean = |place: usize| -> Option<(usize, MeanFrame<'_>)> {
            let c = &chunks[place];
            let own = MeanFrame {
                mean_dn: seen.looks.get(c.set)?.middle_mean()?,
                at: if kind == Kind::Dark { settings(c).exposure_s } else { level(c) },
                frames: c.summary.frames,
                var_dn2: c.summary.var.value,
            };
            Some((place, own))
        };
        let mut means: Vec<(usize, MeanFrame<'_>)> =
            (0..chunks.len()).filter(|i| is_compared(&chunks[*i])).filter_map(mean).collect();
        means.sort_by(|a, b| a.1.at.total_cmp(&b.1.at));
        let mask = &seen.layout.mask[middle(seen.layout.shape)];
        let number = COMPARED[usize::from(kind == Kind::Flat)];
        let found: Vec<(usize, Option<Value>)> = means
            .chunks_exact(number)
            .map(|sets| {
                let all: Vec<&MeanFrame<'_>> = sets.iter().map(|s| &s.1).collect();
                (sets[1].0, noise_over_that_within(&all, mask))
            })
            .collect();
        found.into_iter().for_each(|(place, value)| chunks[place].from_set_to_set = value);
    }
}

/// Returns the statistics of the pieces of the wanted sets, for storage. `progress` is told (pieces done,
/// pieces).
pub fn record(
    dataset: &Dataset,
    wanted: &(dyn Fn(&Set) -> bool + Sync),
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Reduced, ObserveError> {
    let sets = dataset.sets();
    let mut out = Reduced::default();
    let pieces: Vec<Piece> = pieces(dataset).into_iter().filter(|p| wanted(&sets[p.set])).collect();
    if dataset.rows().is_empty() {
        return Err(ObserveError::Nothing("the dataset has no frames".into()));
    }
    let seen = Seen::new(dataset, stop, &mut |_| {})?;
    for (set, look) in sets.iter().zip(&seen.looks).filter(|(s, _)| wanted(s)) {
        out.add(Key::first(dataset, set, FIRST), look.clone());
    }
    let mut reader = Reader::new(dataset, &seen, stop);
    for clean in [true, false] {
        reader.clean = clean;
        let mut done = 0;
        for group in pieces.chunks(4 * rayon::current_num_threads()) {
            // The whole campaign decides if samples that stand out are struck. Both versions are stored if
            // they differ.
            let needed = |p: &&Piece| {
                clean || out.get::<(Work, LeftOut)>(&reader.key(p, true)).is_none_or(|w| w.1.cleaned)
            };
            let group: Vec<&Piece> = group.iter().filter(needed).collect();
            let work: Vec<(Work, LeftOut)> =
                group.par_iter().map(|p| reader.known_or_read(p)).collect::<Result<_, _>>()?;
            for (p, work) in group.iter().zip(work) {
                out.add(reader.key(p, clean), work);
            }
            done += group.len();
            if clean {
                progress(done, pieces.len());
            }
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_halves_have_darks_and_flats() {
        let (d, f) = (Kind::Dark, Kind::Flat);
        assert_eq!(turns(&[d, d, f, f, f], &[false; 5]), [0, 1, 2, 3, 4]);
        assert_eq!(turns(&[f, d, f, d, f, d], &[false; 6]), [0, 0, 1, 1, 2, 2]);
        // Sets that are cut are in both halves anyway; the sets beside them are not.
        assert_eq!(turns(&[f, d, f, d], &[true; 4]), [0, 1, 2, 3]);
        let with_stacks = [false, false, false, false, true, true];
        assert_eq!(turns(&[f, d, f, d, f, d], &with_stacks), [0, 0, 1, 1, 2, 2]);
    }
}
