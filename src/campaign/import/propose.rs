//! Grouping of files into sets.

use super::camera::{BOTTOM_UP, ROW_ORDER, TOP_DOWN};
use super::listing::PACKED;
use super::map::{MAP_FORMAT, Map, MapSet, SAME_LIGHT};
use super::{Facts, Found, ImportError, LIT, Region, depth_of, few, plausible, settings, stamps};
use crate::dataset::Kind;
use crate::number::ranges;
use crate::number::six_digits;
use std::collections::BTreeMap;
use std::path::Path;

/// Maximum difference of equal levels, DN (a named choice).
const SAME_LEVEL_DN: f64 = 1.0;

/// Set under construction.
pub(super) struct Growing {
    /// Set as in the map.
    pub set: MapSet,
    /// Indices of the frames in the survey.
    pub frames: Vec<usize>,
    /// Key shared with sets whose names differ only in counters.
    loose: String,
    /// True if a possible time of day was removed from the name.
    timed: bool,
    /// Mean of the frames, DN.
    pub mean_dn: f64,
}

/// Groups frames into sets by names and headers, else by folder and name; darks are separated from flats
/// by their means.
///
/// # Errors
///
/// The files are not of one camera and one size, or there are none.
pub fn propose(found: &[Found], bit_depth: Option<u8>) -> Result<Map, ImportError> {
    let bits = found.iter().fold(0, |a, f| a | f.bits);
    let inner = found.iter().fold(0, |a, f| a | f.inner_bits);
    // A hot pixel in the row may have one bit more.
    if bit_depth.is_none() && depth_of(inner) + 4 <= depth_of(bits) {
        return Err(ImportError::Files(format!(
            "codes of more than {0} bits stand in the first or last row only: the camera writes a counter or a time there. Switch that off; \
             of these frames give --bit-depth {1}, and in the map region and bit_depth = {0}, to cut the row off",
            depth_of(inner),
            depth_of(bits)
        )));
    }
    let bit_depth = bit_depth.unwrap_or_else(|| depth_of(bits));
    if bits > 0 && bit_depth < 16 && u32::from(bits) >> bit_depth != 0 {
        return Err(ImportError::Files(format!(
            "codes reach above {} DN, the largest of {bit_depth} bits",
            (1u32 << bit_depth) - 1
        )));
    }
    settings::raw_frames(found)?;
    let mut gains: Vec<f64> = found.iter().filter_map(|f| f.facts.gain_db).collect();
    gains.dedup();
    if let Some(other) = gains.iter().find(|g| **g != gains[0]) {
        return Err(ImportError::Files(format!(
            "frames at {} dB and at {other} dB; a dataset has one gain, so import each by itself",
            gains[0]
        )));
    }
    let shared = settings::shared(found)?;
    let (mut features, mut notes) = (shared.features, shared.notes);
    let region = kept(found, &mut notes)?;
    let turns = turns(found, &mut features, &mut notes);
    let temperatures = settings::temperatures(found);
    let lowest = found.iter().map(|f| f.mean_dn).fold(f64::INFINITY, f64::min);
    let lit = lowest + LIT * f64::from((1u32 << bit_depth) - 1);
    let mut frames_of: BTreeMap<&Path, usize> = BTreeMap::new();
    found.iter().for_each(|f| *frames_of.entry(&f.path).or_default() += 1);
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    let mut sets: Vec<Growing> = Vec::new();
    for (number, frame) in found.iter().enumerate() {
        let (kind, by_mean) = match frame.facts.kind {
            Some(kind) => (kind, false),
            None => (if frame.mean_dn > lit { Kind::Flat } else { Kind::Dark }, true),
        };
        let turned = turns && frame.facts.bottom_up == Some(true);
        let warm = settings::temperature_c(frame)
            .and_then(|t| temperatures.iter().position(|(low, high)| (*low..=*high).contains(&t)));
        let is_of_stack = frame.page.is_some() && frames_of.get(&*frame.path).is_some_and(|n| *n > 1);
        let (key, loose, timed) = keys(frame, kind, is_of_stack, &format!("{turned} {warm:?}"));
        let place = *places.entry(key).or_insert_with(|| {
            sets.push(Growing {
                set: set_of(frame, kind, by_mean, turned),
                frames: Vec::new(),
                loose,
                timed,
                mean_dn: 0.0,
            });
            sets.len() - 1
        });
        sets[place].frames.push(number);
        let set = &mut sets[place].set;
        add(&mut set.doubts, &frame.facts.doubts);
        add(&mut set.guessed, &frame.facts.overruled);
    }
    for set in &mut sets {
        set.mean_dn = mean(found, &set.frames);
    }
    let mut sets = joined(sets, found, lowest);
    plausible::exposures_that_darken(&mut sets, found, lowest);
    plausible::decimals_in_two(&mut sets, found, lowest);
    plausible::off_the_light(&mut sets, lowest);
    plausible::lit_and_dark(&mut sets, lowest);
    plausible::neither_dark_nor_flat(&mut sets, found);
    plausible::darks_on_the_line(&mut sets);
    plausible::fewer_bits(&mut sets, found);
    plausible::shifted_codes(&mut sets, found);
    plausible::averaged_by_name(&mut sets, found);
    plausible::normalized(&mut sets, found);
    plausible::means_of_several(&mut sets, found);
    plausible::longer_than_the_period(&mut sets, found);
    plausible::darks_in_another_unit(&mut sets, found);
    plausible::flats_below_darks(&mut sets);
    plausible::serial_numbers(&mut sets, found);
    lit_darks(&mut sets, LIT * f64::from((1u32 << bit_depth) - 1));
    notes.extend(several_levels(&sets, found, lowest));
    let sets: Vec<MapSet> = sets.into_iter().map(|s| finished(s, found)).collect();
    notes.extend(two_temperatures(&sets));
    let scale = found.first().map(|f| f.scale).unwrap_or_default();
    if found.iter().any(|f| f.is_rounded) {
        notes.push(format!(
            "the files hold signed or fractional values: a code of the dataset is {} in the files, and code 0 is {}",
            six_digits(scale.step),
            six_digits(scale.zero)
        ));
    } else if let Some(done) = scale.words() {
        notes.push(format!(
            "{done}: gain, noise and levels are in codes of the dataset, of which one is {} in the files",
            six_digits(scale.step)
        ));
    }
    let camera = found.iter().find_map(|f| f.facts.camera.clone());
    let bit_depth = camera.as_ref().map_or(bit_depth, |c| c.bit_depth.max(depth_of(bits).min(bit_depth)));
    let first = |of: fn(&Facts) -> &Option<String>| found.iter().find_map(|f| of(&f.facts).clone());
    Ok(Map {
        format: MAP_FORMAT.into(),
        bit_depth,
        shift: 0,
        step: scale.step,
        zero: scale.zero,
        frames_axis: None,
        hdf5_dataset: None,
        plane: None,
        pattern: None,
        region: region.map(|r| r.to_numbers()),
        gain_db: gains.first().copied(),
        vendor: first(|f| &f.vendor),
        model: first(|f| &f.model),
        serial: first(|f| &f.serial),
        notes,
        features,
        camera,
        sets,
    })
}

/// Returns the strict key of a frame's set, and the loose key without any counter.
fn keys(frame: &Found, kind: Kind, is_of_stack: bool, further: &str) -> (String, String, bool) {
    let facts = &frame.facts;
    let folder = frame.path.parent().unwrap_or(Path::new("")).display().to_string();
    if let Some(set) = facts.set {
        // A stated set needs no guess.
        return (format!("{folder} set {set}"), String::new(), false);
    }
    // Formatted so that exposures that differ only by rounding of the unit are equal.
    let exposure = facts.exposure_s.map(|s| format!("{s:.9e}"));
    let all = format!(
        "{kind} {exposure:?} {:?} {:?} {:?} {further}",
        facts.illumination, facts.configuration, facts.filter
    );
    let name = frame.path.file_name().unwrap_or_default().to_string_lossy();
    // A compressed frame belongs to the same set as before compression.
    let name = PACKED.iter().find_map(|p| name.strip_suffix(&format!(".{p}"))).unwrap_or(&name);
    // Pages of a stack form one set.
    if is_of_stack {
        return (format!("{folder}/{name} {all}"), String::new(), false);
    }
    // Two runs of a program that names folders by time remain two sets.
    let (of_folder, _) = stamps::loose(&folder);
    let (of_name, timed) = stamps::loose(name);
    // Without an exposure, a number in the name may be the exposure.
    let loose = match exposure {
        Some(_) => format!("{of_folder}/{of_name} {all}"),
        None => String::new(),
    };
    (format!("{folder}/{} {all}", stamps::stem(name)), loose, timed)
}

/// Adds texts that are not yet present.
fn add(to: &mut Vec<String>, texts: &[String]) {
    for text in texts {
        if !to.contains(text) {
            to.push(text.clone());
        }
    }
}

fn mean(found: &[Found], frames: &[usize]) -> f64 {
    frames.iter().map(|k| found[*k].mean_dn).sum::<f64>() / frames.len().max(1) as f64
}

/// Creates a set with the settings of its first frame.
fn set_of(frame: &Found, kind: Kind, by_mean: bool, turned: bool) -> MapSet {
    let facts = &frame.facts;
    let mut from: Vec<String> = facts.from.iter().map(|(key, of)| format!("{key}: {of}")).collect();
    if by_mean {
        from.insert(0, "kind: the mean level, a guess".into());
    }
    if facts.illumination.is_none() && kind != Kind::Dark {
        from.push("illumination: not stated, taken as that of all flats".into());
    }
    let bias = facts.exposure_s.is_some_and(|s| s < SHORTEST_S);
    if bias {
        from.push("exposure_s: a bias frame has none, written as 1 ns".into());
    }
    MapSet {
        kind,
        exposure_s: facts.exposure_s.map(|s| s.max(SHORTEST_S)),
        illumination: if kind == Kind::Dark { Some(0.0) } else { facts.illumination },
        configuration: facts.configuration.unwrap_or(0),
        temperature_c: None,
        mean_dn: None,
        kind_by_mean: by_mean,
        turned,
        doubts: Vec::new(),
        guessed: Vec::new(),
        from,
        files: Vec::new(),
        times_s: None,
    }
}

/// Nominal exposure of a bias frame, s.
const SHORTEST_S: f64 = 1e-9;

/// Joins sets whose names differ only in counters and times of day: all settings are equal, the sets
/// have single frames or a time of day in their names, and the levels are alike.
fn joined(sets: Vec<Growing>, found: &[Found], lowest: f64) -> Vec<Growing> {
    let mut groups: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (k, set) in sets.iter().enumerate().filter(|(_, s)| !s.loose.is_empty()) {
        groups.entry(&set.loose).or_default().push(k);
    }
    let mut into: Vec<usize> = (0..sets.len()).collect();
    for members in groups.into_values() {
        // Two frames taken in the same second may share a name.
        let frames: usize = members.iter().map(|k| sets[*k].frames.len()).sum();
        let single = frames < 2 * members.len();
        let timed = members.iter().all(|k| sets[*k].timed);
        let means = || members.iter().map(|k| sets[*k].mean_dn - lowest);
        let (low, high) = means().fold((f64::INFINITY, 0.0f64), |(a, b), m| (a.min(m), b.max(m)));
        let alike = sets[members[0]].set.kind == Kind::Dark || high - low <= SAME_LIGHT * high;
        if (single || timed) && alike {
            members[1..].iter().for_each(|k| into[*k] = members[0]);
        }
    }
    let mut out: Vec<Growing> = Vec::new();
    let mut places: BTreeMap<usize, usize> = BTreeMap::new();
    for (k, set) in sets.into_iter().enumerate() {
        match places.get(&into[k]) {
            Some(place) => {
                let joined = &mut out[*place];
                joined.frames.extend(set.frames);
                joined.mean_dn = mean(found, &joined.frames);
                let note = "frames: names that differ in a counter or a time of day";
                if !joined.set.from.iter().any(|f| f == note) {
                    joined.set.from.push(note.into());
                }
                add(&mut joined.set.doubts, &set.set.doubts);
                add(&mut joined.set.guessed, &set.set.guessed);
            }
            None => {
                places.insert(k, out.len());
                out.push(set);
            }
        }
    }
    // Survey order, which is that of time or names.
    for set in &mut out {
        set.frames.sort_unstable();
    }
    out.sort_by_key(|s| s.frames.first().copied());
    out
}

/// Questions darks whose level shows light: frames in a folder `Black camera` may be of any kind. Darks
/// of one exposure and temperature have one level. `lit_dn`: minimum signal that shows light.
fn lit_darks(sets: &mut [Growing], lit_dn: f64) {
    let is_dark = |s: &Growing| s.set.kind == Kind::Dark && !s.set.kind_by_mean && s.set.exposure_s.is_some();
    let darks: Vec<(f64, f64)> =
        sets.iter().filter(|s| is_dark(s)).map(|s| (s.set.exposure_s.unwrap_or(0.0), s.mean_dn)).collect();
    for set in sets.iter_mut().filter(|s| is_dark(s)) {
        let exposure_s = set.set.exposure_s.unwrap_or(0.0);
        let alike = darks.iter().filter(|(s, _)| (s - exposure_s).abs() <= 1e-6 * exposure_s);
        let least = alike.map(|(_, mean)| *mean).fold(f64::INFINITY, f64::min);
        if set.mean_dn - least > lit_dn {
            set.set.doubts.push(format!(
                "kind: a name says dark, and the level is {:.0} DN where other darks of this exposure have {least:.0} DN",
                set.mean_dn
            ));
        }
    }
}

/// Finds flats with different levels within a set: names and headers do not distinguish lights or
/// exposures.
fn several_levels(sets: &[Growing], found: &[Found], lowest: f64) -> Option<String> {
    let several = |set: &Growing| {
        let mut means: Vec<f64> = set.frames.iter().map(|k| found[*k].mean_dn - lowest).collect();
        means.sort_by(f64::total_cmp);
        let median = means.get(means.len() / 2).copied().unwrap_or(0.0);
        // The signal of the dimmest frames is unknown if there is no darker one.
        let is_lowest = means.first().is_some_and(|m| *m <= 0.0);
        let signal = if is_lowest { median + lowest } else { median };
        // Near the dark level a fraction of the signal is too small a tolerance.
        let same = (SAME_LIGHT * signal).max(SAME_LEVEL_DN);
        let apart = means.iter().filter(|m| (*m - median).abs() > same).count();
        // A single frame of another level is an ordinary fault, which is searched for later.
        let dn = |m: Option<&f64>| m.copied().unwrap_or(0.0) + lowest;
        (set.set.kind == Kind::Flat && apart > 1).then(|| (dn(means.first()), dn(means.last())))
    };
    let said: Vec<String> = sets
        .iter()
        .enumerate()
        .filter_map(|(k, set)| several(set).map(|(a, b)| format!("set {k} ({a:.0} to {b:.0} DN)")))
        .collect();
    (!said.is_empty()).then(|| {
        format!(
            "frames of one set have several levels, and a set has one light and one exposure: {}; if the names tell \
             them apart, part them in the map",
            few(&said)
        )
    })
}

/// Completes a set with files, times, mean and temperature.
fn finished(grown: Growing, found: &[Found]) -> MapSet {
    let Growing { mut set, frames, mean_dn, .. } = grown;
    let of = |k: &usize| &found[*k];
    set.files = frames
        .iter()
        .map(of)
        .map(|f| format!("{}{}", f.path.display(), f.page.map(|p| format!("#{p}")).unwrap_or_default()))
        .collect();
    set.times_s = frames.iter().map(|k| of(k).facts.time_s).collect();
    let mut temperatures: Vec<f64> =
        frames.iter().filter_map(|k| of(k).facts.temperature_c.or(of(k).facts.set_temperature_c)).collect();
    temperatures.sort_by(f64::total_cmp);
    set.temperature_c = temperatures.get(temperatures.len() / 2).copied();
    set.mean_dn = Some((10.0 * mean_dn).round() / 10.0);
    set
}

/// Returns the region without overscan, which all frames must state alike.
fn kept(found: &[Found], notes: &mut Vec<String>) -> Result<Option<Region>, ImportError> {
    let Some(first) = found.iter().find(|f| f.region.is_some()) else { return Ok(None) };
    if let Some(other) = found.iter().find(|f| f.region != first.region) {
        let words = |f: &Found| match &f.region {
            Some((_, cut)) => format!("{} states overscan at {cut}", f.path.display()),
            None => format!("{} states none", f.path.display()),
        };
        return Err(ImportError::Files(format!(
            "{}, and {}; a dataset is of one read-out, so import each by itself, or correct TRIMSEC",
            words(first),
            words(other)
        )));
    }
    Ok(first.region.as_ref().map(|(region, cut)| {
        notes.push(format!("overscan is cut off, as the headers state (TRIMSEC, DATASEC or BIASSEC): {cut}"));
        region.clone()
    }))
}

/// Returns true if rows run upwards in some frames and downwards in others: the former are flipped.
fn turns(found: &[Found], features: &mut BTreeMap<String, toml::Value>, notes: &mut Vec<String>) -> bool {
    let count = |up: Option<bool>| found.iter().filter(|f| f.facts.bottom_up == up).count();
    let (up, down, unknown) = (count(Some(true)), count(Some(false)), count(None));
    if up + down == 0 {
        return false;
    }
    if unknown > 0 {
        notes.push(format!(
            "ROWORDER stands in {} of {} headers: the rows of the others are taken as they are",
            up + down,
            found.len()
        ));
    }
    let mixed = up > 0 && down > 0;
    if mixed {
        notes.push(format!("rows of {up} frames run from the bottom to the top (ROWORDER): they are turned"));
    }
    let order = if down > 0 { TOP_DOWN } else { BOTTOM_UP };
    features.insert(ROW_ORDER.into(), order.into());
    mixed
}

/// Finds sets with different temperatures.
fn two_temperatures(sets: &[MapSet]) -> Option<String> {
    let mut known: Vec<(f64, usize)> =
        sets.iter().enumerate().filter_map(|(k, s)| Some((s.temperature_c?, k))).collect();
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut groups: Vec<(f64, f64, Vec<usize>)> = Vec::new();
    for (t, k) in known {
        match groups.last_mut() {
            Some((_, high, of)) if t - *high <= settings::SAME_TEMPERATURE_K => {
                *high = t;
                of.push(k);
            }
            _ => groups.push((t, t, vec![k])),
        }
    }
    let said = |(low, high, sets): &mut (f64, f64, Vec<usize>)| {
        sets.sort_unstable();
        let t = if low == high { format!("{low}") } else { format!("{low} to {high}") };
        format!("sets {} at {t} degrees Celsius", ranges(sets))
    };
    (groups.len() > 1).then(|| {
        let said: Vec<String> = groups.iter_mut().map(said).collect();
        format!("several sensor temperatures: {}; dark current and black level differ", said.join("; "))
    })
}
