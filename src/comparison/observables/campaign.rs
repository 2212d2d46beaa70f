//! Observables of a campaign of frames.

use super::observations::{Identity, Observations, Setting};
use super::read::{Chunk, Reading, read};
use super::shapes::{column_cycles, field, peaks, row_cycles, with_peak};
use super::{
    ChunkView, Half, HalfView, Inflation, Observable, Put, STATISTICS, ScenePair, SetOfChunk, Statistic,
    before_sets, codes, covariance, mean, ripple, successive, unequal, variance, warm_up,
};
use crate::data_faults::{ExamineError, examined};
use crate::dataset::{Dataset, DatasetError, ElectronMultiplication, FrameRow, Kind, Set};
use crate::first_look::lit_part;
use crate::number::{percent, ranges};
use crate::statistics::covariance::LAGS;
use crate::statistics::jackknife::Value;
use crate::statistics::median::median;
use crate::statistics::pass::Summary;
use crate::statistics::quantisation::{QUIET_DN2, SMALLEST_DARK_DN2};
use crate::statistics::steady::PixelNoise;
use radcam_sim::predict::{Before, Campaign, FrameInfo, NORMAL, Ordinary, SetInfo};
use std::sync::atomic::AtomicBool;

/// Returns the spatial variance of the dark charge of every set, DN^2; 0 for flats.
pub fn dark_spreads(sets: &[SetInfo], kinds: &[Kind]) -> Vec<f64> {
    // Darks that are left out have no spread.
    let darks = || sets.iter().zip(kinds).filter(|(s, kind)| **kind == Kind::Dark && s.spread_dn > 0.0);
    let shortest = darks().min_by(|a, b| a.0.exposure_s.total_cmp(&b.0.exposure_s));
    let offset = shortest.map_or(0.0, |(s, _)| s.spread_dn);
    let of = |(s, kind): (&SetInfo, &Kind)| {
        if *kind == Kind::Dark { (s.spread_dn.powi(2) - offset * offset).max(0.0) } else { 0.0 }
    };
    sets.iter().zip(kinds).map(of).collect()
}

/// Reasons for having no observables.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ObserveError {
    /// Error of the dataset.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The dataset has nothing to observe.
    #[error("{0}")]
    Nothing(String),
    /// The user interrupted the reading.
    #[error("interrupted")]
    Interrupted,
}

impl From<ExamineError> for ObserveError {
    fn from(error: ExamineError) -> Self {
        match error {
            ExamineError::Dataset(e) => Self::Dataset(e),
            ExamineError::Interrupted => Self::Interrupted,
        }
    }
}

/// Returns the sets and frames in the order of time, with the light levels told apart.
fn campaign(dataset: &Dataset, settings: &[FrameRow]) -> (Vec<SetInfo>, Vec<FrameInfo>) {
    // Photons that a descriptor states are nominal: one light, in the ratios stated, as accurate as the data
    // show it to be.
    let nominal = dataset.light_is_nominal();
    let flats =
        || settings.iter().filter(|s| s.kind == Kind::Flat && s.illumination > 0.0).map(|s| s.illumination);
    let usual = median(flats());
    let mut levels: Vec<(usize, u64)> = Vec::new();
    let mut light_of = |kind: Kind, illumination: f64, scene: usize| {
        if kind == Kind::Dark || illumination == 0.0 {
            return None;
        }
        // A scene has a mean of its own, and so a light level of its own.
        let key = match kind {
            Kind::Flat if nominal => 0,
            Kind::Flat => illumination.to_bits(),
            _ => u64::MAX - scene as u64,
        };
        // Two campaigns are not known to have the same light.
        let key = (dataset.part_of(dataset.sets()[scene].rows[0]).0, key);
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
        light_ratio: if nominal && s.kind == Kind::Flat && usual > 0.0 {
            s.illumination / usual
        } else {
            1.0
        },
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
    let frame = |(i, (row, set)): (usize, (&FrameRow, usize))| {
        let at = row.timestamp_s.unwrap_or(time_s);
        time_s = at + row.exposure_s + BETWEEN_FRAMES_S;
        let (part, first) = dataset.part_of(i);
        FrameInfo { set, time_s: at, before: if first && part > 0 { Before::Level } else { Before::Frame } }
    };
    (infos, dataset.rows().iter().zip(set_of_row).enumerate().map(frame).collect())
}

/// Reads a dataset. `progress` is told (pieces done, pieces).
///
/// # Errors
///
/// There is nothing to observe, a frame cannot be read, or the reading was stopped.
pub fn of_dataset(
    dataset: &Dataset,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Observations, ObserveError> {
    dataset.must_be_monochrome()?;
    let dataset = &examined(dataset, stop)?;
    let cut = lit_part(dataset)?;
    let dataset = cut.as_ref().map_or(dataset, |(part, _)| part);
    let camera = &dataset.manifest().camera;
    let shape = (camera.height, camera.width);
    let Reading {
        layout,
        zero_dn,
        mut chunks,
        mut scenes,
        codes,
        lines,
        steady_dn4,
        together_dn4,
        pixel_noise,
        noisy_levels,
        darkest_dn,
        mut saturated,
        left_out,
    } = read(dataset, stop, progress)?;
    // Sets that were left out were exposed nonetheless: later sets may carry their charge.
    let (dataset, passed_over) = &dataset.timeline();
    let sets = dataset.sets();
    let passed = |i: usize| passed_over.iter().find(|p| p.set == sets[i].number);
    let places: Vec<usize> = (0..sets.len()).filter(|i| passed(*i).is_none()).collect();
    let numbers = chunks.iter_mut().map(|c| &mut c.set).chain(scenes.iter_mut().map(|s| &mut s.set));
    numbers.chain(saturated.iter_mut().map(|s| &mut s.set)).for_each(|set| *set = places[*set]);
    let mut settings: Vec<_> = sets.iter().map(|s| dataset.settings(s).clone()).collect();
    for (i, s) in settings.iter_mut().enumerate() {
        if let Some(p) = passed(i).filter(|p| !p.as_stated) {
            let lit = p.last_dn - zero_dn > LEAST_LIT_DN;
            s.kind = if lit { Kind::Flat } else { Kind::Dark };
            // A set stated as dark has no illumination; it gets 1.
            s.illumination = if s.illumination > 0.0 { s.illumination } else { 1.0 };
        }
    }
    let (mut infos, frames) = campaign(dataset, &settings);
    let mut missing = left_out;
    missing.extend(cut.as_ref().map(|(_, words)| words.clone()));
    let masked = layout.mask.len() as f64 - layout.pixels;
    if masked > MANY_MASKED * layout.mask.len() as f64 {
        missing.push(format!(
            "{masked} pixels ({}) are hot, blind, clipped, jumping or interpolated, and left out: gain and read noise are those of the others, and \
             what these pixels do (telegraph noise, hot pixels) is not looked at",
            percent(masked / layout.mask.len() as f64)
        ));
    }
    if !saturated.is_empty() {
        let mut numbers: Vec<usize> = saturated.iter().map(|s| sets[s.set].number as usize).collect();
        numbers.sort_unstable();
        let which = if numbers.len() == 1 { "set" } else { "sets" };
        let are = if numbers.len() == 1 { "is" } else { "are" };
        missing.push(format!("{which} {} {are} clipped at full scale and not looked at", ranges(&numbers)));
    }
    if chunks.is_empty() {
        return Err(ObserveError::Nothing(
            "no set of darks or flats has two frames that are not clipped: nothing can be compared".into(),
        ));
    }
    let no_flats = chunks.iter().all(|c| settings[c.set].kind != Kind::Flat);
    if no_flats {
        missing.push(
            "no flats that can be used (two frames that are not clipped): darks tell noise, offsets and dark charge, and no gain, unless the noise of the dark charge \
             tells the gain"
                .into(),
        );
    }
    let stated_flat = |i: usize| dataset.settings(&sets[i]).kind == Kind::Flat;
    let flats_left_out = no_flats && (0..sets.len()).any(|i| passed(i).is_some() && stated_flat(i));
    if flats_left_out {
        missing.push("slips leave out all flats: the verdict is on the darks alone".into());
    }
    spreads(&mut infos, &chunks, &settings, zero_dn);
    // A level beyond the end of the range, or not as stated, has a light of its own.
    let is_seen = |light: Option<usize>| places.iter().any(|i| infos[*i].light == light);
    let of_their_own: Vec<usize> = (0..sets.len())
        .filter(|i| passed(*i).is_some_and(|p| !p.as_stated || !is_seen(infos[*i].light)))
        .filter(|i| settings[*i].kind == Kind::Flat)
        .collect();
    for i in saturated.iter().map(|s| s.set).chain(of_their_own.iter().copied()) {
        let levels = infos.iter().filter_map(|s| s.light).max().map_or(0, |l| l + 1);
        if infos[i].light.is_some() {
            (infos[i].light, infos[i].light_ratio) = (Some(levels), 1.0);
        }
    }
    let still = |i: usize| !matches!(settings[i].kind, Kind::Dark | Kind::Flat);
    let after_scene: Vec<bool> = (0..sets.len()).map(|i| i > 0 && still(i - 1)).collect();
    let main_field = main_field(&settings);
    let mut list = of_chunks(&chunks, sets);
    let mut frames = frames;
    let (before_sets, successive) = before_sets::of(&list, &infos, &settings, zero_dn);
    if before_sets != Before::Frame {
        sets.iter().for_each(|s| frames[s.rows[0]].before = before_sets);
    }
    missing.extend(before_sets::note(before_sets));
    // The level of a scene or a clipped set matters for the next frame: it is known beforehand, and judged in
    // neither half.
    let levels = scenes.iter().map(|s| (s.set, codes::mean_of(&s.mean_dn, &layout), s.frames));
    // Dark charge has no light of its own that could set the level.
    let flats = saturated.iter().filter(|s| settings[s.set].kind != Kind::Dark);
    let levels = levels.chain(flats.map(|s| (s.set, s.level_dn, s.frames)));
    let last = |i: &usize| {
        let frames = sets[*i].rows.len();
        (*i, passed(*i).map_or(zero_dn, |p| p.last_dn), (frames - 1, frames))
    };
    for (i, level, (from, to)) in levels.chain(of_their_own.iter().map(last)) {
        let rows = &sets[i].rows;
        list.push(Observable {
            statistic: &mean::Mean,
            index: 0,
            set: Some(i),
            half: Half::Both,
            frames: (rows[0] + from, rows[0] + to),
            measured: Value { value: level, std_err: 0.0 },
            pixels: (shape.0 * shape.1) as f64,
            frame_means: (0.0, 0.0),
        });
    }
    let line = lines[0].with(&lines[1]).strongest();
    let peaks = peaks(&chunks, &settings, zero_dn);
    let stretch = codes::stretch(&codes);
    let mut filled = [codes::Filled::default(), codes::Filled::default()];
    let mut pairs = [None, None];
    for (half, codes) in Half::TURNS.into_iter().zip(codes) {
        let of_codes = codes.finish();
        let of_half: Vec<_> = scenes.iter().filter(|s| s.half == half).collect();
        pairs[half.place()] = ScenePair::of(&of_half, &settings, zero_dn, &layout);
        let of_half = || chunks.iter().filter(|c| c.half == half && !is_quiet(&c.summary));
        let view = HalfView {
            chunks: of_half().map(|c| &c.summary).collect(),
            sets: of_half()
                .map(|c| SetOfChunk {
                    exposure_s: settings[c.set].exposure_s,
                    after_scene: after_scene[c.set],
                    in_main_field: settings[c.set].kind == Kind::Dark
                        || Some(settings[c.set].configuration) == main_field,
                })
                .collect(),
            zero_dn,
            codes: &of_codes,
            line: line.map(|(place, _)| lines[half.place()].teeth(place, shape.1)),
            noisy_levels: &noisy_levels[half.place()],
            scene: pairs[half.place()].as_ref(),
            half,
            peaks: &peaks,
        };
        for &statistic in STATISTICS {
            let measured = Value { value: 0.0, std_err: 0.0 };
            let template = Observable {
                statistic,
                index: 0,
                set: None,
                half,
                frames: (0, 0),
                measured,
                pixels: 1.0,
                frame_means: (0.0, 0.0),
            };
            statistic.of_half(&view, &mut Put { all: &mut list, template });
        }
        filled[half.place()] = of_codes.filled;
    }
    missing
        .extend(ElectronMultiplication::of(&dataset.manifest().camera).map(ElectronMultiplication::in_words));
    missing.extend(cannot_be_told(shape, pairs.iter().any(Option::is_some), &settings));
    let kinds: Vec<Kind> = settings.iter().map(|s| s.kind).collect();
    let frame_means_dn = frame_means(&chunks, sets.len());
    for (i, means) in frame_means_dn.iter().enumerate().filter(|(i, _)| kinds[*i] == Kind::Flat) {
        missing
            .extend(warm_up::in_words(means, zero_dn).map(|text| format!("set {}: {text}", sets[i].number)));
    }
    let darks = chunks.iter().filter(|c| kinds[c.set] == Kind::Dark).map(|c| c.summary.var.value);
    if let Some(var) = darks.min_by(f64::total_cmp).filter(|v| *v < SMALLEST_DARK_DN2) {
        missing.push(format!(
            "darks have a temporal variance of {var:.2} DN^2, and EMVA 1288 (release 4, eq. 54) takes less than {SMALLEST_DARK_DN2} DN^2 for \
             rounding: read noise is not well known; more bits (Mono12 for Mono8) or more gain tell it"
        ));
    }
    let quiet = chunks.iter().filter(|c| is_quiet(&c.summary));
    let mut quiet: Vec<u32> = quiet.map(|c| sets[c.set].number).collect();
    quiet.sort_unstable();
    quiet.dedup();
    if !quiet.is_empty() {
        let which = match quiet.as_slice() {
            few if few.len() <= LISTED => {
                format!("sets {}", few.iter().map(u32::to_string).collect::<Vec<_>>().join(", "))
            }
            many => format!("{} of {} sets", many.len(), sets.len()),
        };
        missing.push(format!(
            "{which}: rounding hides their noise (temporal variance below {QUIET_DN2} DN^2), and only their levels are used"
        ));
    }
    if darkest_dn == Some(0.0) {
        missing.push(
            "at least one in two hundred samples of a dark frame lies at code 0: raise the black level, which EMVA 1288 asks for".into(),
        );
    }
    let dark_spread_dn2 = dark_spreads(&infos, &kinds);
    let ends: Vec<f64> = frames.iter().map(|f: &FrameInfo| f.time_s + infos[f.set].exposure_s).collect();
    let frame_s = median(ends.windows(2).map(|w| w[1] - w[0]));
    let light_rel_std = dataset.manifest().bench.as_ref().and_then(|b| b.illumination_rel_std);
    let ordinary = pixel_noise.and_then(|p| ordinary(&p, &chunks, &infos, &kinds));
    let mut all = Observations {
        identity: Identity::default(),
        setting: setting(dataset, &settings, light_rel_std),
        light_settings: light_settings(&infos, |i| !of_their_own.contains(&i)),
        before_sets,
        successive,
        ripples: ripple::of_bands(&chunks, &settings, zero_dn, peaks[0].as_ref()),
        flickers: ripple::of_frames(&chunks, &settings, zero_dn),
        lines: {
            let of = |pixels: &[f32]| pixels.iter().filter(|n| **n > 0.0).count();
            (of(&layout.row_pixels), of(&layout.column_pixels))
        },
        row_cycles: with_peak(row_cycles(&chunks, &settings, zero_dn), &peaks[0]),
        column_cycles: with_peak(column_cycles(&chunks), &peaks[1]),
        peaks,
        stretch,
        alike: alike(&chunks, &settings),
        field: field(&chunks, &settings, zero_dn),
        // Flats only: the pattern of a dark beside its charge is that of the offsets, which does not move.
        largest_spread: infos
            .iter()
            .zip(&kinds)
            .filter(|(_, kind)| **kind == Kind::Flat)
            .map(|(s, _)| s.spread)
            .fold(0.0, f64::max),
        campaign: Campaign {
            frames,
            sets: infos,
            shape,
            full_scale_dn: f64::from(camera.full_scale_dn()),
            from_code_0: true,
            frame_s: if frame_s.is_finite() { frame_s.max(0.0) } else { 0.0 },
            line_cycles_per_px: line.map(|l| l.1),
            ordinary,
        },
        set_numbers: sets.iter().map(|s| s.number).collect(),
        frame_means_dn,
        kinds,
        list,
        scenes: pairs,
        codes: filled,
        after_scene,
        is_table: false,
        means_given: false,
        missing,
        data_faults: dataset.data_faults().to_vec(),
        flats_left_out,
        exposure_steps: Default::default(),
        left_on: camera.left_on(),
        light_rel_std,
        dark_spread_dn2,
        steady_dn4,
        together_dn4,
        pixel_noise,
        darkest_dn,
        no_black_level: camera.black_level_dn.is_some_and(|level| level <= 0.0),
    };
    if !no_flats && !all.tells_dark_current(None) {
        let darks = all
            .of(&mean::Mean)
            .any(|o| o.half != Half::Both && o.set.is_some_and(|s| all.kinds[s] == Kind::Dark));
        let why = if darks {
            "every light has one exposure, and so have the darks: dark current cannot be told from black level and read noise"
        } else {
            "no darks that can be used (of two frames or more): dark current cannot be told from light"
        };
        all.missing.push(format!("{why}, and is taken as 0; darks at two exposures tell it"));
    }
    Ok(all)
}

/// Minimum level above the darks for a set that is left out to count as lit, DN (a named choice): less leaves
/// nothing in the frames that follow.
const LEAST_LIT_DN: f64 = 5.0;
/// Minimum share of pixels left out that is said (a named choice: data sheets allow some 0.1 % of defects).
const MANY_MASKED: f64 = 0.01;

/// Returns the number of chunks at the level of every set.
fn alike(chunks: &[Chunk], settings: &[FrameRow]) -> Vec<f64> {
    let darks = chunks.iter().filter(|c| settings[c.set].kind == Kind::Dark).count();
    let of = |(i, s): (usize, &FrameRow)| match s.kind {
        Kind::Dark => darks.max(1) as f64,
        _ => chunks.iter().filter(|c| c.set == i).count().max(1) as f64,
    };
    settings.iter().enumerate().map(of).collect()
}

/// Returns, for every set, the first of the consecutive sets under the same light, ignoring darks in between.
fn light_settings(sets: &[SetInfo], is_kept: impl Fn(usize) -> bool) -> Vec<usize> {
    let mut last: Option<(usize, (usize, u64))> = None;
    let of = |(i, s): (usize, &SetInfo)| {
        let light = s.light.filter(|_| is_kept(i)).map(|l| (l, s.illumination.to_bits()));
        let Some(light) = light else { return i };
        let first = last.filter(|(_, l)| *l == light).map_or(i, |(first, _)| first);
        last = Some((first, light));
        first
    };
    sets.iter().enumerate().map(of).collect()
}

/// Largest scatter of a light that is stated in photons without an error: as much as lamps have.
const UNSTATED: f64 = 0.1;
/// Minimum number of light levels whose scatter is meaningful.
const FEWEST_LIGHTS: usize = 3;

/// Returns the scatter of the light between settings that is no finding: the stated scatter, if the light was
/// set anew.
fn setting(dataset: &Dataset, settings: &[FrameRow], stated: Option<f64>) -> Option<Setting> {
    let mut lights: Vec<u64> = settings
        .iter()
        .filter(|s| s.kind == Kind::Flat && s.illumination > 0.0)
        .map(|s| s.illumination.to_bits())
        .collect();
    let flats = lights.len();
    lights.sort_unstable();
    lights.dedup();
    // Two lights in turn are set anew at each change.
    if lights.len() < 2 || flats < FEWEST_LIGHTS {
        return None;
    }
    match stated {
        Some(rel) => (rel > 0.0).then_some(Setting::Stated(rel)),
        None => {
            (dataset.light_is_nominal() && lights.len() >= FEWEST_LIGHTS).then_some(Setting::Below(UNSTATED))
        }
    }
}

/// Fills in the distribution of pixel levels in every set.
fn spreads(infos: &mut [SetInfo], chunks: &[Chunk], settings: &[FrameRow], zero_dn: f64) {
    for c in chunks {
        let above = c.summary.frame_means.mean_dn() - zero_dn;
        let spread_dn = c.summary.spatial_var_dn2.max(0.0).sqrt();
        infos[c.set].spread_dn = spread_dn;
        infos[c.set].places = c.summary.places;
        infos[c.set].spread = if above > 5.0 { (spread_dn / above).min(0.3) } else { 0.0 };
    }
    // Flats have one pattern of light and response. An image beyond the end of the range has lost it, and the
    // pattern of other flats holds below that. Dim flats have more of the offsets' pattern.
    let above = |c: &Chunk| c.summary.frame_means.mean_dn() - zero_dn;
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
}

/// Returns the values of every statistic for the chunks.
fn of_chunks(chunks: &[Chunk], sets: &[Set]) -> Vec<Observable> {
    let mut list = Vec::new();
    let inflation = Inflation::of(chunks);
    for c in chunks {
        let rows = &sets[c.set].rows;
        let first = rows[c.from];
        let template = Observable {
            statistic: &mean::Mean,
            index: 0,
            set: Some(c.set),
            half: c.half,
            frames: (first, first + c.summary.frames),
            measured: Value { value: 0.0, std_err: 0.0 },
            pixels: c.summary.pixels,
            frame_means: (c.summary.frame_means.mean_dn(), c.summary.frame_means.variance_dn2()),
        };
        let quiet = is_quiet(&c.summary);
        let looked_at = STATISTICS.iter().enumerate().filter(|(_, s)| !quiet || s.id() == mean::Mean.id());
        for (extra, &statistic) in looked_at {
            let view = ChunkView { chunk: c, rows, inflation: &inflation, extra };
            statistic
                .of_chunk(&view, &mut Put { all: &mut list, template: Observable { statistic, ..template } });
        }
    }
    list
}

/// Maximum number of sets listed by number in a note.
const LISTED: usize = 8;

/// Returns true if rounding hides the noise of a chunk: see [`QUIET_DN2`].
pub(super) fn is_quiet(summary: &Summary) -> bool {
    summary.var.value < QUIET_DN2
}

/// Time from the end of an exposure to the next if frames carry no times, s: readout, saving and pauses (a
/// named choice). Short exposures then follow one another evenly, as cameras at a fixed rate take them.
const BETWEEN_FRAMES_S: f64 = 1.0;

/// Limit of campaigns whose frames carry no times.
pub(crate) const NO_TIMES: &str = "the frames carry no times: each is taken to follow the one before by its exposure and 1 s, and what changes \
     with time is in this measure; record the times of frames to have it in seconds";

/// Limit of campaigns without a scene.
pub(crate) const NO_PATCH: &str =
    "no scene with a bright patch at two exposures: smear cannot be told from an exposure offset";

/// Returns notes on what a campaign without some sets, or of few pixels, leaves open.
fn cannot_be_told(shape: (usize, usize), patch: bool, settings: &[FrameRow]) -> Vec<String> {
    let mut missing = Vec::new();
    if shape.0.min(shape.1) < 64 {
        missing.push(format!(
            "{} x {} pixels are too few for a step between parts of the sensor",
            shape.1, shape.0
        ));
    }
    if !patch {
        missing.push(NO_PATCH.into());
    }
    if settings.iter().all(|s| s.timestamp_s.is_none()) {
        missing.push(NO_TIMES.into());
    }
    if settings.iter().all(|s| s.kind != Kind::Dark) {
        missing.push("no darks: what is read noise and what is offset cannot be told".into());
    }
    missing
}

/// Part of the spread of the pixels that changes from set to set, by slow telegraph noise or warming (a named
/// choice).
const CHANGED: f64 = 0.2;

impl Inflation {
    fn of(chunks: &[Chunk]) -> Self {
        let over = |ratio: &dyn Fn(&Summary) -> f64| {
            let all: Vec<f64> =
                chunks.iter().map(|c| ratio(&c.summary)).filter(|x| x.is_finite() && *x > 0.0).collect();
            let mean = (all.iter().map(|x| x * x).sum::<f64>() / all.len().max(1) as f64).sqrt();
            let middle = median(all.iter().copied());
            // The median is used, unless a few levels truly scatter more.
            if middle.is_finite() && mean.is_finite() {
                middle.max(0.9 * mean.min(1.2 * middle))
            } else {
                1.0
            }
        };
        // The jackknife variance of a mean over N pixels of sample variances with d degrees of freedom is
        // (u + (1 + u) 2 / d) / N of its square (law of total variance), u the relative variance of the
        // pixels' true variances. The first part is the same in every set but for [`CHANGED`]; only the
        // second is chance.
        let of_variance = |r: &Summary| {
            let spread = r.unequal.value.max(0.0);
            let same = (1.0 - CHANGED * CHANGED) * spread * r.var.value * r.var.value / r.pixels;
            let chance = (r.var.std_err * r.var.std_err - same).max(0.0).sqrt();
            (chance / (variance::theory(r) * (1.0 + spread).sqrt())).max(1.0)
        };
        let lags = |r: &Summary| r.covariances.at.iter().map(|c| c.std_err * c.std_err).sum::<f64>();
        Self {
            variance: over(&of_variance),
            covariance: over(&|r| (lags(r) / LAGS.len() as f64).sqrt() / covariance::theory(r)),
            successive: over(&|r| r.successive.std_err / successive::theory(r)),
            unequal: over(&|r| r.unequal.std_err / unequal::theory(r)),
        }
    }
}

/// Returns the frame means of every set in order of time, DN.
fn frame_means(chunks: &[Chunk], sets: usize) -> Vec<Vec<f64>> {
    let mut in_order: Vec<&Chunk> = chunks.iter().collect();
    in_order.sort_by_key(|c| c.from);
    let mut out = vec![Vec::new(); sets];
    in_order.iter().for_each(|c| out[c.set].extend_from_slice(c.summary.frame_means.each_dn()));
    out
}

/// Returns the noise of the ordinary pixels at the median level of the darks; `None` if too few frames show
/// it.
fn ordinary(pixels: &PixelNoise, chunks: &[Chunk], infos: &[SetInfo], kinds: &[Kind]) -> Option<Ordinary> {
    let darks = || chunks.iter().filter(|c| kinds[c.set] == Kind::Dark);
    let level_dn = median(darks().map(|c| c.summary.frame_means.mean_dn()));
    let spread_dn = median(darks().map(|c| infos[c.set].spread_dn));
    let known = pixels.log_spread.is_finite() && pixels.mean_dn2.is_finite() && level_dn.is_finite();
    let median_dn2 = pixels.median * pixels.median * pixels.mean_dn2;
    known.then(|| Ordinary::of_darks(median_dn2, pixels.log_spread, level_dn, spread_dn))
}

/// Returns the position of card and light that most flats have; the first of several.
fn main_field(settings: &[FrameRow]) -> Option<u32> {
    let mut counts: std::collections::BTreeMap<u32, usize> = Default::default();
    for set in settings.iter().filter(|s| s.kind == Kind::Flat) {
        *counts.entry(set.configuration).or_default() += 1;
    }
    let most = counts.values().max().copied()?;
    counts.into_iter().find(|(_, n)| *n == most).map(|(configuration, _)| configuration)
}
