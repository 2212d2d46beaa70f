//! Levels and files against names: questions where they contradict each other.

use super::propose::Growing;
use super::{Found, few};
use crate::dataset::Kind;
use crate::number::{ranges, six_digits};
use std::collections::BTreeMap;

/// Ratio of exposures from which on the level tells which is longer, and of the signals.
const LONGER: f64 = 1.5;
const BRIGHTER: f64 = 1.1;
/// Part of the largest signal by which a dark is off the line of the flats at least.
const OFF_THE_LINE: f64 = 0.02;
/// Bits that occur in the codes of a frame from which on they tell a step: a dark may have one code only.
const MIN_BITS: u32 = 4;
/// Digits of a number in a name that may be a camera's serial number.
const SERIAL_DIGITS: std::ops::RangeInclusive<usize> = 7..=10;

/// Questions exposures that darken: `1_80s` is 1/80 s, or `2.000 us` are two thousand.
pub fn falling_levels(sets: &mut [Growing], lowest_dn: f64) {
    // Place, exposure and signal of each.
    let mut flats: Vec<(usize, f64, f64)> = sets
        .iter()
        .enumerate()
        .filter(|(_, s)| s.set.kind == Kind::Flat && s.set.illumination.is_none())
        .filter_map(|(k, s)| Some((k, s.set.exposure_s?, s.mean_dn - lowest_dn)))
        .collect();
    flats.sort_by(|a, b| a.1.total_cmp(&b.1));
    // Each against the next one that is clearly longer.
    let (mut rises, mut falls, mut next) = (0, 0, 0);
    for (k, a) in flats.iter().enumerate() {
        next = next.max(k);
        while flats.get(next).is_some_and(|b| b.1 <= LONGER * a.1) {
            next += 1;
        }
        let Some(b) = flats.get(next) else { break };
        rises += usize::from(b.2 > BRIGHTER * a.2);
        falls += usize::from(a.2 > BRIGHTER * b.2);
    }
    if let [shortest, .., longest] = *flats.as_slice()
        && falls > 2 * rises
    {
        sets[longest.0].set.doubts.push(format!(
            "exposure: flats of {} s have {:.0} DN and those of {} s {:.0} DN: the longer, the darker. Either they are read wrongly \
             (1_80s as 80 s for 1/80 s), or the light differs (then give illumination)",
            six_digits(shortest.1),
            shortest.2 + lowest_dn,
            six_digits(longest.1),
            longest.2 + lowest_dn
        ));
    }
}

/// Questions darks by their mean that lie on the line of the flats over the exposure: they are the dimmest
/// flats.
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
    // Three points show whether they are on a line.
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

/// Questions files that keep fewer bits than the others: 8 bits of 12 are another gain.
pub fn fewer_bits(sets: &mut [Growing], found: &[Found]) {
    let most = found.iter().map(|f| f.stored_bits).max().unwrap_or(0);
    for set in sets.iter_mut() {
        let Some(few) = set.frames.iter().map(|k| &found[*k]).find(|f| f.stored_bits < most) else {
            continue;
        };
        set.set.doubts.push(format!(
            "frames: {} has {} bits, and other files have {most}: are its codes those of the others, or a sixteenth of them?",
            few.path.display(),
            few.stored_bits
        ));
    }
}

/// Questions frames whose codes are all multiples of 4 or more where others' are not: shifted in some files and
/// not in the rest.
pub fn shifted_codes(sets: &mut [Growing], found: &[Found]) {
    let step = |f: &Found| 1u32 << f.bits.trailing_zeros().min(15);
    // A frame of one code alone has that code's bits.
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

/// Questions two numbers as long as a serial number, one in the names of some sets and the other in the rest.
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
