//! What the levels say against what names say: questions, and no guess.

use super::propose::Growing;
use super::{Found, few};
use crate::dataset::Kind;
use crate::number::six_digits;
use std::collections::BTreeMap;

/// Ratio of exposures from which on the level tells which is longer, and of the signals.
const LONGER: f64 = 1.5;
const BRIGHTER: f64 = 1.1;
/// Part of the largest signal by which a dark is off the line of the flats at least.
const OFF_THE_LINE: f64 = 0.02;
/// Digits of a number in a name that may be a camera's serial number.
const SERIAL_DIGITS: std::ops::RangeInclusive<usize> = 7..=10;

/// Asks where the longer exposures are the darker ones: `1_80s` is 1/80 s, or `2.000 us` are two thousand.
pub fn falling_levels(sets: &mut [Growing], lowest_dn: f64) {
    let flats: Vec<(usize, f64, f64)> = sets
        .iter()
        .enumerate()
        .filter(|(_, s)| s.set.kind == Kind::Flat && s.set.illumination.is_none())
        .filter_map(|(k, s)| Some((k, s.set.exposure_s?, s.mean_dn - lowest_dn)))
        .collect();
    let pairs = || flats.iter().flat_map(|a| flats.iter().map(move |b| (a, b)));
    let longer = |(a, b): &(&(usize, f64, f64), &(usize, f64, f64))| b.1 > LONGER * a.1;
    let rises = pairs().filter(longer).filter(|(a, b)| b.2 > BRIGHTER * a.2).count();
    let falls = pairs().filter(longer).filter(|(a, b)| a.2 > BRIGHTER * b.2).count();
    let longest = flats.iter().max_by(|a, b| a.1.total_cmp(&b.1));
    let shortest = flats.iter().min_by(|a, b| a.1.total_cmp(&b.1));
    if let (Some(longest), Some(shortest)) = (longest, shortest)
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

/// Asks where what was taken for a dark by its mean lies on the line of the flats over the exposure: there are no
/// darks.
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
    // A line of three or more, which is one.
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

/// Asks about files that keep fewer bits than the others: 8 bits of 12 are another gain.
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

/// Asks about two cameras: numbers as long as a serial number, one in all names of some sets and another in those of
/// the rest.
pub fn serial_numbers(sets: &mut [Growing], found: &[Found]) {
    let mut of_sets: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (k, set) in sets.iter().enumerate() {
        let mut names = set.frames.iter().map(|i| {
            let name = found[*i].path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            super::stamps::long_numbers(&name, SERIAL_DIGITS)
        });
        let first = names.next().unwrap_or_default();
        let shared = names.fold(first, |kept, own| kept.into_iter().filter(|n| own.contains(n)).collect());
        // Counters of the frames are in no two names.
        if let ([serial], true) = (shared.as_slice(), set.frames.len() > 1) {
            of_sets.entry(serial.clone()).or_default().push(k);
        }
    }
    let told: usize = of_sets.values().map(Vec::len).sum();
    if !(2..=4).contains(&of_sets.len()) || told != sets.len() || told < 2 * of_sets.len() {
        return;
    }
    let said: Vec<String> =
        of_sets.iter().map(|(n, of)| format!("{n} in those of sets {}", super::map::ranges(of))).collect();
    let text = format!("frames: the names hold a long number, {}: frames of several cameras?", few(&said));
    let fewest = of_sets.values().min_by_key(|of| of.len());
    if let Some(place) = fewest.and_then(|of| of.first()) {
        sets[*place].set.doubts.push(text);
    }
}
