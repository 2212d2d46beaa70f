//! Plausibility checks: levels and files against names, with questions on contradictions.

use super::propose::Growing;
use super::{Found, few, same_exposure};
use crate::dataset::Kind;
use crate::number::{ranges, seconds, six_digits};
use std::collections::BTreeMap;

/// Minimum ratio of exposures, and of signals, at which the level shows which exposure is longer.
const LONGER: f64 = 1.5;
const BRIGHTER: f64 = 1.1;
/// Minimum distance of a dark from the line of the flats, relative to the largest signal.
const OFF_THE_LINE: f64 = 0.02;
/// Minimum number of different bits in the codes of a frame that reveals a step: a dark may have one
/// code only.
const MIN_BITS: u32 = 4;
/// Number of digits of a number in a name that may be a camera's serial number.
const SERIAL_DIGITS: std::ops::RangeInclusive<usize> = 7..=10;

/// Finds flats that get darker with exposure: returns the longest one, and a description. `flats`:
/// place, exposure (s) and mean (DN) of flats without a stated light.
pub fn falling_levels(mut flats: Vec<(usize, f64, f64)>, lowest_dn: f64) -> Option<(usize, String)> {
    flats.sort_by(|a, b| a.1.total_cmp(&b.1));
    // Each flat is compared with the next one that is clearly longer.
    let (mut rises, mut falls, mut next) = (0, 0, 0);
    for (k, a) in flats.iter().enumerate() {
        next = next.max(k);
        while flats.get(next).is_some_and(|b| b.1 <= LONGER * a.1) {
            next += 1;
        }
        let Some(b) = flats.get(next) else { break };
        let (a_dn, b_dn) = (a.2 - lowest_dn, b.2 - lowest_dn);
        rises += usize::from(b_dn > BRIGHTER * a_dn);
        falls += usize::from(a_dn > BRIGHTER * b_dn);
    }
    let [shortest, .., longest] = *flats.as_slice() else { return None };
    (falls > 2 * rises).then(|| {
        let text = format!(
            "exposure: flats of {} s have {:.0} DN and those of {} s {:.0} DN: the longer, the darker. Either they are read wrongly \
             (1_80s as 80 s for 1/80 s), or the light differs (then give illumination)",
            six_digits(shortest.1),
            shortest.2,
            six_digits(longest.1),
            longest.2
        );
        (longest.0, text)
    })
}

/// Questions exposures whose flats get darker: `1_80s` may be 1/80 s, or `2.000 us` two thousand. Asks
/// for every set with a name of the form `1_80s`.
pub fn exposures_that_darken(sets: &mut [Growing], found: &[Found], lowest_dn: f64) {
    let flats =
        sets.iter().enumerate().filter(|(_, s)| s.set.kind == Kind::Flat && s.set.illumination.is_none());
    let flats = flats.filter_map(|(k, s)| Some((k, s.set.exposure_s?, s.mean_dn))).collect();
    let Some((longest, text)) = falling_levels(flats, lowest_dn) else { return };
    sets[longest].set.doubts.push(text);
    for set in sets.iter_mut().enumerate().filter(|(k, _)| *k != longest).map(|(_, set)| set) {
        let number = set.set.exposure_s.map(six_digits).unwrap_or_default();
        let is_fraction = |file: &String| {
            ["1_", "1-"].iter().any(|one| {
                let whole = format!("{one}{number}");
                file.match_indices(&whole).any(|(at, _)| {
                    let digit = |c: Option<char>| c.is_some_and(|c| c.is_ascii_digit());
                    !digit(file[..at].chars().next_back()) && !digit(file[at + whole.len()..].chars().next())
                })
            })
        };
        let first = set.frames.first().and_then(|f| found.get(*f)).map(|f| f.path.display().to_string());
        if !number.is_empty() && first.as_ref().is_some_and(is_fraction) {
            set.set.doubts.push(format!(
                "exposure: the longer, the darker (set {longest}): 1/{number} s here, or {number} s?"
            ));
        }
    }
}

/// Minimum relative deviation of a set from the usual signal for its exposure that shows another light,
/// and minimum fraction of the range at which a signal may be saturated (named choices).
const OTHER_LIGHT: f64 = 0.15;
const NEAR_THE_END: f64 = 0.8;
/// Maximum fraction of the expected signal of a flat without light.
const NO_LIGHT: f64 = 0.02;

/// Questions flats of one stated light if several deviate from the signal of their exposures and one of
/// them is darker than a shorter one: another lamp current, filter or aperture that no name states
/// legibly, or flats without light. A single one is an ordinary fault, which the examination of the data
/// names.
pub fn off_the_light(sets: &mut [Growing], lowest_dn: f64) {
    let asked = |s: &Growing| s.set.doubts.iter().any(|d| d.starts_with("exposure"));
    if sets.iter().any(asked) {
        return;
    }
    // Place, exposure, signal and signal a second.
    let flats: Vec<(usize, f64, f64, f64)> = sets
        .iter()
        .enumerate()
        .filter(|(_, s)| s.set.kind == Kind::Flat && s.set.illumination.is_none())
        .filter_map(|(k, s)| {
            let (exposure_s, signal_dn) = (s.set.exposure_s?, s.mean_dn - lowest_dn);
            Some((k, exposure_s, signal_dn, signal_dn / exposure_s))
        })
        .collect();
    let top = flats.iter().map(|f| f.2).fold(0.0, f64::max);
    let usual = crate::statistics::median::median(flats.iter().map(|f| f.3));
    let is_off = |f: &&(usize, f64, f64, f64)| {
        let ended = f.2 > NEAR_THE_END * top && f.3 < usual;
        (f.2 - usual * f.1).abs() > OTHER_LIGHT * usual * f.1
            && (f.2 - usual * f.1).abs() > OFF_THE_LINE * top
            && !ended
    };
    let off: Vec<&(usize, f64, f64, f64)> = flats.iter().filter(is_off).collect();
    let darker = |f: &&&(usize, f64, f64, f64)| {
        flats.iter().any(|g| f.1 > g.1 * LONGER && f.2 * BRIGHTER < g.2 && f.3 < usual)
    };
    let Some(first) = off.iter().find(darker).filter(|_| off.len() > 1) else { return };
    let (place, exposure_s, signal_dn, _) = **first;
    let unlit = off.iter().filter(|f| f.2 < NO_LIGHT * usual * f.1).count() == off.len();
    let numbers: Vec<usize> = off.iter().map(|f| f.0).collect();
    let of = ranges(&numbers);
    sets[place].set.doubts.push(if unlit {
        format!(
            "kind: sets {of} are called flats, and no light fell on them (flats of {} s have {:.0} DN): darks (lamp off, cap on)?",
            six_digits(exposure_s),
            signal_dn + lowest_dn
        )
    } else {
        format!(
            "illumination: flats of {} s have {:.0} DN, darker than shorter ones, and sets {of} are off the signal that the others have a second by \
             more than {:.0} %: the light was not the same (lamp current, filter, aperture, distance); give illumination",
            six_digits(exposure_s),
            signal_dn + lowest_dn,
            100.0 * OTHER_LIGHT
        )
    });
}

/// Minimum difference of two darks with similar exposures, relative to the range of levels, that shows
/// light on one.
const LIT_DARK: f64 = 0.2;

/// Questions darks if one is far brighter than another of the same or longer exposure:
/// `black_card_10ms`, `dark_slide_out`.
pub fn lit_and_dark(sets: &mut [Growing], lowest_dn: f64) {
    let top = sets.iter().map(|s| s.mean_dn - lowest_dn).fold(0.0, f64::max);
    let stated = |s: &Growing| s.set.kind == Kind::Dark && !s.set.kind_by_mean;
    // Place, exposure and signal of each dark.
    let darks: Vec<(usize, f64, f64)> = sets
        .iter()
        .enumerate()
        .filter(|(_, s)| stated(s))
        .filter_map(|(k, s)| Some((k, s.set.exposure_s?, s.mean_dn - lowest_dn)))
        .collect();
    let lit: Vec<usize> = darks
        .iter()
        .filter(|(_, t, dn)| {
            darks
                .iter()
                .any(|(_, u, other)| *u > t / BRIGHTER && dn - other > LIT_DARK * top && *dn > 2.0 * other)
        })
        .map(|d| d.0)
        .collect();
    // A single one is an ordinary fault.
    if let [first, _, ..] = *lit {
        let text = format!(
            "kind: sets {} are called darks, and light fell on them ({:.0} DN, where other darks as long have {lowest_dn:.0}): flats?",
            ranges(&lit),
            sets[first].mean_dn
        );
        sets[first].set.doubts.push(text);
    }
}

/// Questions words like x4 in the names of all frames of a set: averages of four, a lens or a gain? In
/// names that count frames (`x0`, `x1`) the words differ.
pub fn averaged_by_name(sets: &mut [Growing], found: &[Found]) {
    let said = |set: &Growing| {
        let mut words = set.frames.iter().map(|k| {
            let name = found[*k].path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            super::kinds::times(&name).map(|(word, n)| (word.to_string(), n))
        });
        let first = words.next().flatten()?;
        words.all(|other| other.as_ref() == Some(&first)).then_some(first)
    };
    let all: Vec<Option<(String, u32)>> = sets.iter().map(said).collect();
    // Different words count frames if each set has a single frame.
    let alone = sets.iter().all(|s| s.frames.len() == 1);
    if alone && all.iter().any(|word| *word != all[0]) {
        return;
    }
    for (set, word) in sets.iter_mut().zip(&all) {
        let Some((word, n)) = word.as_ref().filter(|_| alone || set.frames.len() > 1) else { continue };
        set.set.doubts.push(format!(
            "frames: the names say \"{word}\": averages of {n} frames, a lens or a gain? Averages are no raw frames"
        ));
    }
}

/// Maximum relative difference of the means of normalised flats, above rounding to 24 bits; lamps and
/// shot noise move means by more (a named choice).
const MAX_REL_OF_NORMALIZED: f64 = 1e-6;

/// Questions floating-point flats with equal means: each was divided by its mean.
pub fn normalized(sets: &mut [Growing], found: &[Found]) {
    let flats = || sets.iter().enumerate().filter(|(_, s)| s.set.kind == Kind::Flat);
    let frames = || flats().flat_map(|(_, s)| &s.frames).map(|k| &found[*k]);
    let level = |f: &Found| f.scale.zero + f.scale.step * f.mean_dn;
    let (least, most) = frames().map(level).fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
    let is_one = most - least <= MAX_REL_OF_NORMALIZED * most;
    if frames().count() < MIN_FLATS || !frames().all(|f| f.is_rounded) || !is_one {
        return;
    }
    let Some((first, _)) = flats().next() else { return };
    sets[first].set.doubts.push(format!(
        "frames: all flats have one mean, {}, to a millionth: each was divided by its own; save frames as they were read",
        six_digits(most)
    ));
}

/// Numbers of pixels of binning 2 x 2 to 4 x 4, which may have been averaged.
const BINNED: [u32; 3] = [4, 9, 16];

/// Questions values that are multiples of 1/N: averages of N frames are not raw frames. Averages of N
/// pixels are valid; for the N of binning they are assumed and noted.
pub fn means_of_several(sets: &mut [Growing], found: &[Found]) {
    let Some(n) = found.first().and_then(|f| f.in_a_mean) else { return };
    let Some(first) = sets.first_mut() else { return };
    let what = format!("all values are multiples of 1/{n}");
    let harm = format!(
        "means of {n} frames (ImageJ's Z projection, numpy's mean) have less noise than frames, and gain and read noise of them are wrong"
    );
    if BINNED.contains(&n) {
        first.set.guessed.push(format!("frames: {what}: taken for means of {n} pixels (binning); {harm}"));
    } else {
        first.set.doubts.push(format!(
            "frames: {what}: {harm}: import the frames that they were made of. Means of {n} pixels (binning) are frames"
        ));
    }
}

/// Minimum ratio of the frame period to the exposure, and the error of times in whole seconds, s.
const MIN_PERIOD_SHARE: f64 = 0.5;
const ERROR_OF_TIMES_S: f64 = 1.0;

/// Questions exposures without a unit that exceed the frame period: milliseconds?
pub fn longer_than_the_period(sets: &mut [Growing], found: &[Found]) {
    // Returns the exposure and the maximum frame period.
    let of = |s: &Growing| {
        let exposure_s =
            s.set.exposure_s.filter(|_| s.frames.iter().all(|k| !found[*k].facts.unit_stated))?;
        let times: Option<Vec<f64>> = s.frames.iter().map(|k| found[*k].facts.time_s).collect();
        let (least, most) =
            times?.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(*t), b.max(*t)));
        let periods = s.frames.len() as f64 - 1.0;
        (periods > 0.0).then(|| (exposure_s, (most - least + ERROR_OF_TIMES_S) / periods))
    };
    let is_longer =
        |s: &Growing| of(s).is_some_and(|(exposure_s, period_s)| MIN_PERIOD_SHARE * exposure_s > period_s);
    // File times of files written together after all exposures affect only one or two sets.
    if 2 * sets.iter().filter(|s| is_longer(s)).count() < sets.len() {
        return;
    }
    let Some(first) = sets.iter_mut().find(|s| is_longer(s)) else { return };
    let Some((exposure_s, period_s)) = of(first) else { return };
    first.set.doubts.push(format!(
        "exposure: {} s, and by their times the frames follow one another by {} s at most: milliseconds? (They may be, unless the times are \
         those at which the files were written)",
        six_digits(exposure_s),
        six_digits((100.0 * period_s).round() / 100.0)
    ));
}

/// Minimum share of the darks whose exposures are those of flats in another unit, and rise of their levels by
/// which a dark charge shows that they are long, DN (named choices).
const IN_ANOTHER_UNIT: f64 = 0.75;
const RISE_DN: f64 = 1.0;

/// Questions darks whose exposures are a thousand or a million times those of the flats, or the inverse: one
/// of the two units is wrong. Headers of one program use one unit and are not questioned; neither is a single
/// dark beside flats of several exposures, nor darks whose level rises.
pub fn darks_in_another_unit(sets: &mut [Growing], found: &[Found]) {
    let exposures = |kind: Kind| -> Vec<(usize, f64)> {
        let of = |(k, s): (usize, &Growing)| Some((k, s.set.exposure_s.filter(|t| *t > 0.0)?));
        let mut all: Vec<(usize, f64)> =
            sets.iter().enumerate().filter(|(_, s)| s.set.kind == kind).filter_map(of).collect();
        all.sort_by(|a, b| a.1.total_cmp(&b.1));
        all.dedup_by(|a, b| same_exposure(a.1, b.1));
        all
    };
    let (darks, flats) = (exposures(Kind::Dark), exposures(Kind::Flat));
    let flat_of = |exposure_s: f64| flats.iter().find(|f| same_exposure(f.1, exposure_s));
    let least = if flats.len() > 1 { 2.0 } else { 1.0 };
    let fits = |by: &f64| {
        let fitting = darks.iter().filter(|d| flat_of(d.1 / by).is_some()).count() as f64;
        fitting >= least && fitting >= IN_ANOTHER_UNIT * darks.len() as f64
    };
    let Some(factor) = [1e3, 1e6, 1e-3, 1e-6].into_iter().find(fits) else { return };
    let pair = darks.iter().find_map(|d| Some((d, flat_of(d.1 / factor)?)));
    let ([shortest, .., longest] | [shortest @ longest]) = darks.as_slice() else { return };
    let rise_dn = sets[longest.0].mean_dn - sets[shortest.0].mean_dn;
    let (Some((dark, flat)), false) = (pair, darks.iter().any(|d| flat_of(d.1).is_some())) else { return };
    let source = |set: usize| {
        let frame = sets[set].frames.first().map(|k| &found[*k].facts);
        frame.and_then(|facts| facts.from.get("exposure_s")).cloned().unwrap_or_default()
    };
    let is_header = |source: &str| !["name", "folder"].iter().any(|word| source.contains(word));
    let (of_dark, of_flat) = (source(dark.0), source(flat.0));
    if rise_dn > RISE_DN || is_header(&of_dark) && is_header(&of_flat) {
        return;
    }
    let text = format!(
        "exposure: darks are {} the flats ({} s by {of_dark}, {} s by {of_flat}): milliseconds in the one and seconds in the other? Dark current would \
         be wrong by as much. Correct exposure_s where it is wrong",
        if factor > 1.0 {
            format!("{} times as long as", six_digits(factor))
        } else {
            format!("shorter by {} than", six_digits(1.0 / factor))
        },
        six_digits(dark.1),
        six_digits(flat.1)
    );
    sets[dark.0].set.doubts.push(text);
}

/// Minimum deficit below all darks at which flats are questioned, DN and relative to the dark level: a
/// black level drifts by less (named choices).
const MIN_BELOW_DARKS: (f64, f64) = (5.0, 0.05);

/// Questions flats that are darker than all darks. Files with fewer bits, which have the same effect,
/// are questioned before.
pub fn flats_below_darks(sets: &mut [Growing]) {
    if sets.iter().any(|s| s.set.doubts.iter().any(|d| d.starts_with("frames"))) {
        return;
    }
    let darks = sets.iter().filter(|s| s.set.kind == Kind::Dark && !s.set.kind_by_mean);
    let lowest = darks.map(|s| s.mean_dn).fold(f64::INFINITY, f64::min);
    let least = MIN_BELOW_DARKS.0.max(MIN_BELOW_DARKS.1 * lowest);
    let is_below = |s: &Growing| s.set.kind == Kind::Flat && s.mean_dn < lowest - least;
    let below: Vec<usize> = (0..sets.len()).filter(|k| lowest.is_finite() && is_below(&sets[*k])).collect();
    let Some(&first) = below.first() else { return };
    let text = format!(
        "frames: the flats of sets {} have {:.0} DN, and the darks {lowest:.0} DN or more. Cause: shifted bits, dark-subtracted flats, another black \
         level, or exchanged kinds. Save darks and flats in the same way",
        ranges(&below),
        sets[first].mean_dn
    );
    sets[first].set.doubts.push(text);
}

/// Questions frames stated as those of an object that were classified as darks or flats by their mean.
pub fn neither_dark_nor_flat(sets: &mut [Growing], found: &[Found]) {
    let of_object = |s: &Growing| s.set.kind_by_mean && s.frames.iter().any(|k| found[*k].facts.object);
    if let Some(set) = sets.iter_mut().find(|s| of_object(s)) {
        set.set.doubts.push(
            "kind: the frames are stated as light frames or objects, neither dark nor flat: give the kind of those that are".into(),
        );
    }
}

/// Questions darks classified by mean that lie on the line of the flats over exposure: they are the
/// dimmest flats.
pub fn darks_on_the_line(sets: &mut [Growing]) {
    let of = |s: &Growing| Some((s.set.exposure_s?, s.mean_dn));
    let guessed = |s: &&Growing| s.set.kind_by_mean && s.set.illumination.unwrap_or(1.0) != 0.0;
    let flats: Vec<(f64, f64)> =
        sets.iter().filter(|s| s.set.kind == Kind::Flat).filter(guessed).filter_map(of).collect();
    let n = flats.len() as f64;
    let (x, y) = flats.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
    let sxx: f64 = flats.iter().map(|p| (p.0 - x).powi(2)).sum();
    let slope = flats.iter().map(|p| (p.0 - x) * (p.1 - y)).sum::<f64>() / sxx;
    let most = flats.iter().map(|p| p.1).fold(0.0, f64::max);
    let scatter = flats.iter().map(|p| (p.1 - y - slope * (p.0 - x)).abs()).fold(0.0, f64::max);
    // At least three points are needed to show a line.
    if flats.len() < 3 || !slope.is_finite() || scatter > OFF_THE_LINE * most {
        return;
    }
    for set in sets.iter_mut().filter(|s| s.set.kind == Kind::Dark && s.set.kind_by_mean) {
        let Some(exposure_s) = set.set.exposure_s else { continue };
        let line = y + slope * (exposure_s - x);
        if (set.mean_dn - line).abs() < OFF_THE_LINE * most && slope * exposure_s > OFF_THE_LINE * most {
            set.set.doubts.push(format!(
                "kind: no name says it, and {:.0} DN are what the line of the other sets has at {} s: a flat like them, and there are no darks",
                set.mean_dn,
                six_digits(exposure_s)
            ));
        }
    }
}

/// Questions files with fewer bits than the others: 8 bits of 12 are another gain.
pub fn fewer_bits(sets: &mut [Growing], found: &[Found]) {
    // The stored bits of floating-point numbers are arbitrary, and negative integers have no more than
    // others.
    let bits = |f: &Found| if f.is_rounded && f.stored_bits > 16 { 32 } else { f.stored_bits.min(32) };
    let most = found.iter().map(bits).max().unwrap_or(0);
    for set in sets.iter_mut() {
        let Some(few) = set.frames.iter().map(|k| &found[*k]).find(|f| bits(f) < most) else {
            continue;
        };
        set.set.doubts.push(format!(
            "frames: {} has {} bits, and other files have {most}: are its codes those of the others, or a sixteenth of them?",
            few.path.display(),
            few.stored_bits
        ));
    }
}

/// Questions frames whose codes are all multiples of 4 or more while others' are not: shifted in some
/// files only.
pub fn shifted_codes(sets: &mut [Growing], found: &[Found]) {
    let step = |f: &Found| 1u32 << f.bits.trailing_zeros().min(15);
    // The bits of a frame with a single code are those of that code.
    let is_one_code = |f: &Found| (f.mean_dn - f64::from(f.bits)).abs() < 0.5;
    let tells = |f: &Found| f.bits.count_ones() >= MIN_BITS && !is_one_code(f);
    let Some(whole) = found.iter().find(|f| tells(f) && step(f) == 1) else { return };
    for set in sets.iter_mut() {
        let Some(shifted) = set.frames.iter().map(|k| &found[*k]).find(|f| tells(f) && step(f) >= 4) else {
            continue;
        };
        set.set.doubts.push(format!(
            "frames: every code of {} is a multiple of {}, and those of {} are not: are its codes shifted to the upper bits?",
            shifted.path.display(),
            step(shifted),
            whole.path.display()
        ));
    }
}

/// Questions two numbers with the length of a serial number, one in the names of some sets and the other
/// in the rest.
pub fn serial_numbers(sets: &mut [Growing], found: &[Found]) {
    let mut of_sets: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (k, set) in sets.iter().enumerate() {
        let mut names = set.frames.iter().map(|i| {
            let name = found[*i].path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            super::stamps::long_numbers(&name, SERIAL_DIGITS)
        });
        let first = names.next().unwrap_or_default();
        let shared = names.fold(first, |kept, own| kept.into_iter().filter(|n| own.contains(n)).collect());
        // A counter differs from frame to frame.
        if let ([serial], true) = (shared.as_slice(), set.frames.len() > 1) {
            of_sets.entry(serial.clone()).or_default().push(k);
        }
    }
    let told: usize = of_sets.values().map(Vec::len).sum();
    if !(2..=4).contains(&of_sets.len()) || told != sets.len() || told < 2 * of_sets.len() {
        return;
    }
    let said: Vec<String> =
        of_sets.iter().map(|(n, of)| format!("{n} in those of sets {}", ranges(of))).collect();
    let text = format!("frames: the names hold a long number, {}: frames of several cameras?", few(&said));
    let fewest = of_sets.values().min_by_key(|of| of.len());
    if let Some(place) = fewest.and_then(|of| of.first()) {
        sets[*place].set.doubts.push(text);
    }
}

/// Minimum number of flats whose levels distinguish decimals from counters, and the minimum fraction of
/// them whose levels agree with a correct reading (named choices).
const MIN_FLATS: usize = 3;
const AGREE: f64 = 0.8;

/// Flat with its exposure as read and, if another number precedes it, as a decimal.
struct Read {
    set: usize,
    signal_dn: f64,
    read_s: f64,
    /// Exposure if the preceding number is the integer part, and both numbers.
    decimal: Option<(f64, String)>,
}

impl Read {
    fn of(place: usize, set: &Growing, found: &[Found], lowest_dn: f64) -> Option<Self> {
        let name = found[*set.frames.first()?].path.file_name()?.to_string_lossy();
        let read_s = set.set.exposure_s?;
        let decimal = two_numbers(&name).and_then(|(whole, part)| {
            let behind = part.parse::<f64>().ok().filter(|v| *v > 0.0)?;
            let both = format!("{whole}.{part}").parse::<f64>().ok()?;
            Some((read_s / behind * both, format!("{whole}_{part}")))
        });
        Some(Self { set: place, signal_dn: set.mean_dn - lowest_dn, read_s, decimal })
    }

    fn decimal_s(&self) -> f64 {
        self.decimal.as_ref().map_or(self.read_s, |d| d.0)
    }
}

/// Questions exposures preceded by another number, as in flat_2_4ms, if the levels of the flats fit 2.4
/// ms and not 4 ms. Other flats (flat_5ms) may have a single number.
pub fn decimals_in_two(sets: &mut [Growing], found: &[Found], lowest_dn: f64) {
    let flats = sets.iter().enumerate().filter(|(_, s)| s.set.kind == Kind::Flat);
    let flats: Option<Vec<Read>> = flats.map(|(k, s)| Read::of(k, s, found, lowest_dn)).collect();
    let Some(flats) = flats.filter(|f| f.len() >= MIN_FLATS) else { return };
    let signal = |exposure_s: &dyn Fn(&Read) -> f64| {
        crate::statistics::median::median(flats.iter().map(|f| f.signal_dn / exposure_s(f)))
    };
    let agrees =
        |f: &Read, exposure_s: f64, usual: f64| (f.signal_dn / exposure_s / usual - 1.0).abs() < OTHER_LIGHT;
    let usual = signal(&Read::decimal_s);
    let agree = flats.iter().filter(|f| agrees(f, f.decimal_s(), usual)).count();
    let as_read = signal(&|f| f.read_s);
    let agree_as_read = flats.iter().filter(|f| agrees(f, f.read_s, as_read)).count();
    if (agree as f64) < AGREE * flats.len() as f64 || agree <= agree_as_read {
        return;
    }
    let wrong = flats.iter().find(|f| f.decimal.is_some() && !agrees(f, f.read_s, usual));
    if let Some(Read { set, read_s, decimal: Some((decimal_s, digits)), .. }) = wrong {
        sets[*set].set.doubts.push(format!(
            "exposure: {digits} was read as {} s, and the levels of the flats are in proportion to the exposures if such numbers are decimals: {} s. \
             State exposure_s",
            six_digits(*read_s),
            six_digits(*decimal_s)
        ));
    }
}

/// Splits digits, a separator and digits before a unit of time, as in `2_4ms`; `None` unless this occurs
/// exactly once.
fn two_numbers(name: &str) -> Option<(&str, &str)> {
    let digits_before = |end: usize| {
        let start = name[..end].trim_end_matches(|c: char| c.is_ascii_digit()).len();
        (start < end).then_some((start, end))
    };
    let mut out = None;
    for (at, _) in name.char_indices().filter(|(_, c)| c.is_ascii_digit()) {
        let rest = name[at..].trim_start_matches(|c: char| c.is_ascii_digit());
        let end = name.len() - rest.len();
        let unit = &rest[..rest.find(|c: char| !c.is_alphabetic()).unwrap_or(rest.len())];
        let is_first = !name[..at].ends_with(|c: char| c.is_ascii_digit());
        if !is_first || seconds(unit).is_none() {
            continue;
        }
        let whole = name[..at].ends_with(['_', '-', ' ']).then(|| digits_before(at - 1)).flatten();
        let (start, stop) = whole?;
        if out.replace((&name[start..stop], &name[at..end])).is_some() {
            return None;
        }
    }
    out
}
