//! Facts of a frame from file names and folders.

use super::values::{self, Reading};
use super::words::pattern;
use super::{Facts, kinds, stamps};
use crate::dataset::Kind;
use crate::number::seconds;
use std::ops::Range;

pub use super::kinds::kind;
pub use super::stamps::stem;

/// Number in a name, with the letters on both sides.
#[derive(Debug, PartialEq)]
pub(super) struct Number<'a> {
    /// Preceding word, with separators skipped.
    pub before: &'a str,
    /// Digits as written.
    pub text: &'a str,
    /// Possible readings.
    pub reading: Reading,
    /// Letters after the number.
    pub unit: &'a str,
    /// Position in the name.
    pub place: Range<usize>,
    /// Position of the unit.
    unit_place: Range<usize>,
    /// Temperature, degrees Celsius, if the number is one. NaN if its sign may be a separator.
    pub temperature_c: Option<f64>,
    /// True for part of a binning, `2x2`.
    pub binning: bool,
    /// True if a separator stands between the number and the preceding word.
    apart: bool,
}

/// Words before a number that is a gain.
const GAIN: &[&str] = &["gain", "gainraw"];
const ISO: &[&str] = &["iso"];
/// Minimum number after `EM` that is an electron-multiplication gain: lower ones are counters.
const MIN_EM_GAIN: f64 = 10.0;
/// Letter before a gain: `g120`.
const GAIN_LETTER: &[&str] = &["g"];
/// Words for one of several cameras: `cam1`.
const CAMERA: &[&str] = &["cam", "camera"];
const SERIAL: &[&str] = &["sn", "serial", "ser"];
/// Words after a number that is a bit depth.
const BITS: &[&str] = &["bit", "bits"];
/// Words for one of two conversion gains.
const CONVERSION: &[&str] = &["lcg", "hcg"];
const BIN: &[&str] = &["bin", "binning"];
const BLACK: &[&str] = &["offset", "blacklevel", "blklevel", "black"];
const LIGHT: &[&str] = &["light", "illum", "illumination", "level"];
/// Words before the position of card and light, as counted in a dataset.
const CONFIGURATION: &[&str] = &["config", "configuration", "conf", "cfg"];
const EXPOSURE: &[&str] =
    &["exp", "exposure", "exptime", "exposuretime", "texp", "shutter", "integration", "inttime"];
const TEMPERATURE: &[&str] = &["temp", "temperature", "sensortemp", "ccdtemp", "settemp"];
/// Words before a time that is not an exposure.
const OTHER_TIMES: &[&str] = &[
    "delay", "wait", "waited", "interval", "every", "period", "after", "pause", "settle", "total", "warmup",
];

/// Returns true if only a hyphen separates a number from the one at the given position, while other
/// separators part the words of the name, and no preceding word is one that counters follow.
fn is_range(name: &str, first: &Number<'_>, at: usize) -> bool {
    let ahead = name[..first.place.start].trim_end_matches(|c: char| c.is_ascii_digit());
    let named = first.before.is_empty() || kind(first.before).is_some() || is(first.before, EXPOSURE);
    name.get(first.place.end..at) == Some("-")
        && first.unit.is_empty()
        && !first.text.starts_with('0')
        && !ahead.ends_with('-')
        && !(first.text == "1" && name[..at].ends_with("1-"))
        && named
}

fn is(word: &str, words: &[&str]) -> bool {
    words.iter().any(|w| word.eq_ignore_ascii_case(w))
}

impl Number<'_> {
    fn value(&self) -> Option<f64> {
        self.reading.one()
    }

    fn pointed(&self) -> bool {
        self.text.contains(['.', ',', 'p'])
    }

    /// Returns true for a black level setting: `offset50`, but not a counter as in `offset_001`.
    fn is_black_level(&self) -> bool {
        is(self.before, BLACK) && !self.is_padded()
    }

    /// Returns true for an electron-multiplication gain: `EM300`, `emgain200`.
    fn is_em_gain(&self) -> bool {
        let is_large = self.value().is_some_and(|v| v >= MIN_EM_GAIN);
        is(self.before, &["emgain"]) || self.before == "EM" && !self.apart && !self.is_padded() && is_large
    }

    /// Returns true for a number that is not a setting and may be a counter.
    pub fn is_free(&self) -> bool {
        let setting = [GAIN, ISO, BIN, EXPOSURE, TEMPERATURE, CONFIGURATION]
            .into_iter()
            .any(|words| is(self.before, words))
            || self.is_black_level()
            || (is(self.before, CAMERA) && !self.apart)
            || (is(self.before, SERIAL) && self.unit.is_empty())
            || self.is_em_gain()
            || (is(self.before, GAIN_LETTER) && !self.apart && !self.is_padded() && self.unit.is_empty())
            || (is(self.before, LIGHT) && self.pointed());
        let means_something = setting && !self.is_counter();
        !means_something
            && self.temperature_c.is_none()
            && !self.binning
            && !self.is_exposure_behind_its_unit()
    }

    /// Returns true for a number with a leading zero, as in counters.
    fn is_padded(&self) -> bool {
        self.text.len() > 1 && self.text.starts_with('0')
    }

    /// Returns true for a number with leading zeros, separated from the preceding word: `low gain_0001`
    /// and `Flat-013L`.
    pub fn is_counter(&self) -> bool {
        let padded = self.text.len() >= 3 && self.text.starts_with('0');
        padded && self.apart && self.text.bytes().all(|b| b.is_ascii_digit()) && seconds(self.unit).is_none()
    }

    /// Returns true for an exposure after its unit: `Sec120.00`, as N.I.N.A. users write it.
    fn is_exposure_behind_its_unit(&self) -> bool {
        self.unit.is_empty() && !self.before.eq_ignore_ascii_case("s") && seconds(self.before).is_some()
    }
}

/// Returns the unit of time after a number and a separator: `5_secs`, `10 ms`, `0.05 s`.
fn unit_behind<'a>(number: &str, rest: &'a str) -> &'a str {
    let Some(word) = rest.strip_prefix(['_', ' ', '-']) else { return "" };
    let (word, behind) = word.split_at(word.find(|c: char| !c.is_alphabetic()).unwrap_or(word.len()));
    // A single letter may begin any word; after a decimal point and before a separator, s means second.
    if word == "s"
        && number.contains(['.', ','])
        && !behind.starts_with(|c: char| c.is_alphanumeric() || c == '=')
    {
        return word;
    }
    if word.len() > 1 && !word.eq_ignore_ascii_case("min") && seconds(word).is_some() { word } else { "" }
}

/// Finds every number of a name. A point, a comma or a p between digits is the decimal point.
pub(super) fn numbers(name: &str) -> Vec<Number<'_>> {
    let bytes = name.as_bytes();
    let digit = |i: usize| bytes.get(i).is_some_and(u8::is_ascii_digit);
    let letter = |c: char| c.is_alphabetic();
    let mut out: Vec<Number<'_>> = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        if !digit(at) {
            at += 1;
            continue;
        }
        let mut end = at;
        let mut pointed = false;
        // In flat.0001.10ms the first number is a counter; the number is not 1.1.
        let padded = (at..at + 3).all(digit) && bytes[at] == b'0';
        let counter = padded && name[..at].ends_with('.');
        while digit(end)
            || (!pointed && !counter && matches!(bytes.get(end), Some(b'.' | b',' | b'p')) && digit(end + 1))
        {
            pointed |= !digit(end);
            end += 1;
        }
        // Exponent of 1e-3, not the e of a word.
        let sign = usize::from(matches!(bytes.get(end + 1), Some(b'-' | b'+')));
        if matches!(bytes.get(end), Some(b'e' | b'E')) && digit(end + 1 + sign) {
            end += 1 + sign;
            while digit(end) {
                end += 1;
            }
        }
        let text = &name[at..end];
        let ahead = name[..at].trim_end_matches(['_', '-', '=', ' ']);
        let from = ahead
            .rfind(|c: char| !letter(c))
            .map_or(0, |i| i + ahead[i..].chars().next().map_or(1, char::len_utf8));
        // Letters after a number are its unit, not a word before the next number.
        let word = from..from + ahead[from..].len();
        let owned = out.last().is_some_and(|n| n.unit_place == word)
            || (name[..from].ends_with(|c: char| c.is_ascii_digit()) && seconds(&ahead[from..]).is_some());
        let before = if owned { "" } else { &ahead[from..] };
        let rest = &name[end..];
        let letters = rest.strip_prefix('°').unwrap_or(rest);
        let unit = &letters[..letters.find(|c: char| !letter(c)).unwrap_or(letters.len())];
        // A unit ends a word: the s of `2s0` is not a unit.
        let ends = !letters[unit.len()..].starts_with(|c: char| c.is_ascii_digit());
        let unit = match unit {
            "" => unit_behind(text, rest),
            _ if ends => unit,
            _ => "",
        };
        let value = in_context(name, at, text, unit, out.last());
        let signed = name[..at].strip_suffix('-');
        let minus = signed.is_some_and(|s| s.is_empty() || s.ends_with(['_', ' ', '(', '=', '-']));
        let degrees = matches!(unit, "C" | "degC") || rest.starts_with("°C");
        let named = is(before, TEMPERATURE) && unit.is_empty();
        let nina = minus && pointed && unit.is_empty();
        let temperature_c =
            value.one().filter(|v| (degrees || named || nina) && *v <= 100.0).map(|v| match signed {
                // Word of N.I.N.A., whose hyphen is a minus sign.
                Some(_) if minus || before.eq_ignore_ascii_case("sensortemp") => -v,
                Some(_) => f64::NAN,
                None => v,
            });
        let unit_place = match unit {
            // An empty unit has no position that could coincide with a word.
            "" => 0..0,
            _ => {
                let start = end + rest.find(unit).unwrap_or(0);
                start..start + unit.len()
            }
        };
        out.push(Number {
            unit_place,
            before,
            text,
            reading: value,
            unit,
            place: at..end,
            temperature_c,
            binning: is_binning(name, at, end),
            apart: !name[..at].ends_with(char::is_alphabetic),
        });
        at = end;
    }
    // Parts of a random name have no meaning.
    let random = stamps::digests(name);
    for n in out.iter_mut().filter(|n| random.iter().any(|r| r.contains(&n.place.start))) {
        (n.before, n.unit, n.temperature_c, n.binning) = ("", "", None, false);
    }
    // N.I.N.A. writes the temperature, without a unit, between time stamp and exposure.
    if !stamps::stamps(name).is_empty() {
        for k in 1..out.len() {
            let (a, b) = (&out[k - 1], &out[k]);
            let next = name.get(a.place.end..b.place.start) == Some("_") && seconds(b.unit).is_some();
            if next
                && a.unit.is_empty()
                && a.text.contains('.')
                && a.temperature_c.is_none()
                && a.before.is_empty()
            {
                let value = a.value();
                out[k - 1].temperature_c = value;
            }
        }
    }
    out
}

/// Denominators of shutter speeds 1/n s, written as `1-250s` because a name cannot have a slash.
const DENOMINATORS: [f64; 26] = [
    2.0, 4.0, 8.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 125.0, 160.0, 200.0, 250.0, 320.0,
    400.0, 500.0, 640.0, 800.0, 1000.0, 2000.0, 2500.0, 4000.0, 8000.0,
];

/// Interprets a number, given the text before it and its unit.
fn in_context(name: &str, at: usize, text: &str, unit: &str, last: Option<&Number<'_>>) -> Reading {
    let plain = text.replace('p', ".");
    let value = values::number(&plain).0;
    let before = &name[..at];
    let pointed = plain.contains(['.', ',']);
    let separated = |head: &str| head.is_empty() || head.ends_with(['_', '-', ' ', '=', '(']);
    if let Some(last) = last.filter(|l| l.place.end < at) {
        let between = &name[last.place.end..at];
        // 10.000,5ms has two decimal signs, and 1s500ms two units.
        let signs = matches!(between, "." | ",") && last.pointed();
        if signs || (last.unit.is_empty() && seconds(between).is_some() && seconds(unit).is_some()) {
            return Reading::None;
        }
    }
    let Reading::One(number) = value else { return value };
    // flat_2-20ms is a range, or a counter and an exposure.
    if let Some(first) = last.and_then(|l| l.value().filter(|_| is_range(name, l, at)))
        && seconds(unit).is_some()
        && first < number
    {
        return Reading::Two(first, number);
    }
    // A point before three digits groups thousands in many languages; no camera sets thousandths of a
    // microsecond.
    let grouped = plain.split_once('.').is_some_and(|(whole, rest)| {
        rest.len() == 3 && (1..=3).contains(&whole.len()) && !whole.starts_with('0')
    });
    if grouped && seconds(unit).is_some_and(|s| s < 1e-5) {
        return Reading::Two(number, 1000.0 * number);
    }
    if !pointed && before.strip_suffix('.').is_some_and(separated) {
        return values::number(&format!("0.{plain}")).0;
    }
    // Points may separate the words of the name: flat.12.10ms, 0001.10ms.
    let of_points = before.strip_suffix('.').is_some_and(|head| head.ends_with(char::is_alphabetic))
        || (at == 0 && plain.starts_with("00"));
    if let Some((_, rest)) = plain.split_once('.').filter(|_| of_points) {
        return values::number(rest).0.one().map_or(value, |rest| Reading::Two(number, rest));
    }
    // flat_0_25ms: the separator stands for the decimal point, or follows a counter.
    let no_point = ["_", "-", " ", "'", "pt", "dot", "d"];
    let of_none = no_point
        .iter()
        .any(|sign| before.strip_suffix(sign).and_then(|head| head.strip_suffix('0')).is_some_and(separated));
    if seconds(unit).is_some() && !pointed && of_none {
        let behind = values::number(&format!("0.{plain}")).0.one();
        return behind.filter(|b| *b > 0.0).map_or(value, |b| Reading::Two(number, b));
    }
    if seconds(unit) == Some(1.0) && !pointed {
        let alone = |word: &str| {
            ["_", "-"].iter().any(|sign| {
                before.strip_suffix(sign).and_then(|head| head.strip_suffix(word)).is_some_and(separated)
            })
        };
        if before.ends_with("1-") && alone("1") && DENOMINATORS.contains(&number) {
            return Reading::Two(number, 1.0 / number);
        }
    }
    value
}

/// Returns true if a number is part of a binning such as `2x2`.
fn is_binning(name: &str, at: usize, end: usize) -> bool {
    let bytes = name.as_bytes();
    let digit = |i: Option<usize>| i.and_then(|i| bytes.get(i)).is_some_and(|b| (b'1'..=b'8').contains(b));
    let any = |i: Option<usize>| i.and_then(|i| bytes.get(i)).is_some_and(u8::is_ascii_digit);
    let cross = |i: Option<usize>| i.and_then(|i| bytes.get(i)).is_some_and(|b| matches!(b, b'x' | b'X'));
    let single = end == at + 1 && digit(Some(at));
    let first = cross(Some(end)) && digit(Some(end + 1)) && !any(Some(end + 2));
    let second = cross(at.checked_sub(1)) && digit(at.checked_sub(2)) && !any(at.checked_sub(3));
    // 2x3ms are two frames of 3 ms.
    let rest = &name[end..];
    let unit = &rest[..rest.find(|c: char| !c.is_alphabetic()).unwrap_or(rest.len())];
    single && (first || second) && seconds(unit).is_none()
}

/// Exposures stated in a text, s.
#[derive(Debug, Default, PartialEq)]
struct Exposures {
    found: Vec<f64>,
    doubt: Option<String>,
}

/// Returns the word between a time and the next number, without separators; `None` if the first is not a
/// time.
fn word_between<'a>(text: &'a str, time: &Number<'_>, next: &Number<'_>) -> Option<&'a str> {
    let between = text.get(time.unit_place.end..next.place.start)?;
    seconds(time.unit).map(|_| between.trim_matches(|c: char| !c.is_alphanumeric()))
}

/// Returns the word that labels each number: the preceding word, or, in names that write labels after
/// their times (`2.5ms-exp_100ms-period`), the following one. A label follows if a hyphen ties it to the
/// time, or if the name ends with one.
fn labels<'a>(text: &'a str, numbers: &[Number<'a>]) -> Vec<&'a str> {
    let is_label = |word: &str| is(word, EXPOSURE) || is(word, OTHER_TIMES);
    let times: Vec<usize> = (0..numbers.len()).filter(|k| seconds(numbers[*k].unit).is_some()).collect();
    let behind = |k: usize| {
        let end = numbers[k].unit_place.end;
        let next = numbers.get(k + 1).map_or(text.len(), |n| n.place.start);
        let rest = text.get(end..next).unwrap_or_default();
        let word = rest.trim_start_matches(['_', '-', ' ']);
        let (signs, word) = (&rest[..rest.len() - word.len()], word);
        let word = &word[..word.find(|c: char| !c.is_alphabetic()).unwrap_or(word.len())];
        let after = &rest[signs.len() + word.len()..];
        // The word may also belong to the next number if only a separator parts them.
        let is_last = numbers.get(k + 1).is_none_or(|n| n.before != word);
        let tied = signs == "-" && after.starts_with(['_', ' ']);
        (is_label(word) && !signs.is_empty()).then_some((word, tied, is_last))
    };
    let write_behind = times.iter().filter_map(|k| behind(*k)).any(|(_, tied, _)| tied)
        || (times.len() > 1
            && times.last().is_some_and(|k| behind(*k).is_some_and(|b| b.2))
            && times.first().is_some_and(|k| !is_label(numbers[*k].before)));
    let of = |k: usize| match behind(k) {
        Some((word, _, is_last)) if seconds(numbers[k].unit).is_some() && (write_behind || is_last) => word,
        // The preceding word labels the previous time.
        _ if write_behind && k > 0 && behind(k - 1).is_some_and(|b| b.0 == numbers[k].before) => "",
        _ => numbers[k].before,
    };
    (0..numbers.len()).map(of).collect()
}

fn exposures(text: &str) -> Exposures {
    let mut out = Exposures::default();
    let mut sure = Vec::new();
    let numbers = numbers(text);
    let labels = labels(text, &numbers);
    let times = numbers.iter().filter(|n| seconds(n.unit).is_some() && !n.binning).count();
    for (k, number) in numbers.iter().enumerate() {
        let unit_s = match seconds(number.unit) {
            Some(_) if number.binning => continue,
            Some(unit_s) => unit_s,
            None if number.is_exposure_behind_its_unit() => seconds(number.before).unwrap_or(1.0),
            None => continue,
        };
        let label = labels[k];
        // The word in 5min_warmup_10ms may label either time.
        let of_either = k.checked_sub(1).and_then(|k| numbers.get(k)).is_some_and(|last| {
            let glued = text[..number.place.start].ends_with(char::is_alphabetic);
            label == number.before && word_between(text, last, number) == Some(label) && !glued
        });
        // A time of day is not an exposure, nor is a pause. If a dark "after" the flats has a single
        // time, that is its exposure.
        let alone = times == 1 && is(label, &["after"]);
        if stamps::is_stamp(text, &number.place) || (is(label, OTHER_TIMES) && !of_either && !alone) {
            continue;
        }
        match number.reading {
            // 0 is the exposure of a bias frame; for others it means unknown.
            Reading::One(value) if value > 0.0 || (value == 0.0 && kinds::of(text).bias) => {
                let seconds = values::in_seconds(value, unit_s);
                if is(label, EXPOSURE) { sure.push(seconds) } else { out.found.push(seconds) }
            }
            Reading::Two(a, b) => {
                let unit = if number.unit.is_empty() { number.before } else { number.unit };
                out.doubt = Some(format!("\"{} {unit}\" is {a} or {b} {unit}", number.text));
            }
            _ => {}
        }
    }
    if !sure.is_empty() {
        out.found = sure;
    }
    out.found.sort_by(f64::total_cmp);
    out.found.dedup_by(|a, b| super::same_exposure(*a, *b));
    if let [a, b, ..] = out.found[..] {
        out.doubt = Some(format!("the text tells {a} s and {b} s"));
    }
    if out.doubt.is_some() {
        out.found.clear();
    }
    out
}

/// Source name of facts from a file's own name.
pub const NAME: &str = "the file's name";

/// Reads facts from a path: the last folder's name and the file name, which takes precedence.
pub fn facts(folder: &str, name: &str) -> Facts {
    facts_in(&[folder], 1, name)
}

/// Reads facts from a name and the folders above it, the nearest first; nearer names take precedence.
/// All frames lie in the folders beyond the first `own`: such a folder states the kind only if its name
/// states nothing else (`Flats`, but not `dark_current_study`).
pub fn facts_in(folders: &[&str], own: usize, name: &str) -> Facts {
    // Hidden folders are named by programs, not by the user.
    let hidden = |f: &str| f.starts_with('.') || f.is_empty();
    let folders = folders.iter().enumerate().filter(|(_, f)| !hidden(f));
    let folders: Vec<(&str, bool)> = folders.map(|(k, f)| (*f, k < own.max(1) || kinds::alone(f))).collect();
    let texts: Vec<(String, &str, bool)> = std::iter::once((NAME.to_string(), name, true))
        .chain(folders.iter().map(|(f, counts)| (format!("the folder {f}"), *f, *counts)))
        .collect();
    let mut out = Facts::default();
    let strong = kinds::of_file(name).kind.is_some()
        || folders.iter().any(|(folder, counts)| *counts && kinds::of(folder).kind.is_some());
    let mut exposure_of: Option<(f64, String)> = None;
    for (place, (of, text, counts)) in texts.iter().enumerate() {
        let said = match place {
            0 => kinds::of_file(text),
            _ if *counts => kinds::of(text),
            _ => kinds::Said::default(),
        };
        let kind = said.kind.or(said.weak.filter(|_| !strong));
        out.object |= place <= 1 && said.object;
        match (out.kind, kind) {
            (None, Some(kind)) => {
                out.set_kind(kind, of);
                out.bias = said.bias;
            }
            (Some(Kind::Flat), Some(Kind::Dark))
                if place <= own.max(1) && kinds::alone(text) && !kinds::says_black_alone(text) =>
            {
                let first = out.from.get("kind").cloned().unwrap_or_default();
                out.doubts.push(format!("kind: {first} says flat, and {of} says dark"));
            }
            _ => {}
        }
        // The meaning of a time or gain is taken from the nearest two names; folders further up are
        // projects.
        if place <= 2 {
            let exposures = exposures(text);
            match (exposures.found.first(), &exposure_of) {
                (Some(seconds), None) => exposure_of = Some((*seconds, of.clone())),
                (Some(seconds), Some((first, by)))
                    if place == 1 && !super::same_exposure(*seconds, *first) =>
                {
                    out.doubts.push(format!("exposure_s: {by} says {first} s, and {of} says {seconds} s"));
                }
                _ => {}
            }
            if let Some(doubt) = exposures.doubt.filter(|_| exposure_of.is_none()) {
                out.doubts.push(format!("exposure_s: {of}: {doubt}"));
            }
        }
        settings(text, of, strong, &mut out);
    }
    if out.doubts.iter().all(|d| !d.starts_with("exposure_s"))
        && let Some((seconds, of)) = exposure_of
    {
        out.exposure_s = Some(seconds);
        out.unit_stated = true;
        out.from.insert("exposure_s".into(), of);
    }
    out.time_s = stamps::time_s(name);
    if out.time_s.is_some() {
        out.from.insert("time_s".into(), NAME.into());
    }
    // Folders further up are projects.
    for (place, (of, text, _)) in texts.iter().enumerate().take(3) {
        if let Some(why) = kinds::processed(text) {
            let of = if place == 0 { String::new() } else { format!("{of}: ") };
            out.doubts.push(format!("frames: {of}{why}: averages and corrected frames are no raw frames"));
            break;
        }
    }
    out
}

/// Reads gain, black level, binning, light and temperature from one text.
fn settings(text: &str, of: &str, strong: bool, out: &mut Facts) {
    if let Some(word) = text.split(|c: char| !c.is_alphabetic()).find(|word| is(word, CONVERSION)) {
        out.set_feature("ConversionGain", &word.to_uppercase(), of);
    }
    let words = || text.split(|c: char| !c.is_alphanumeric());
    let is_mosaic = |word: &&str| {
        let lower = word.to_lowercase();
        lower.strip_prefix("bayer").map_or(word.len() == 4, |rest| rest.len() >= 2)
    };
    if let Some(pattern) = words().filter(is_mosaic).find_map(pattern)
        && out.mosaic.is_none()
    {
        out.mosaic = Some(pattern);
        out.from.insert("mosaic".into(), of.into());
    }
    if let Some(step) = kinds::gain_step(text) {
        out.set_feature("gain step", step, of);
    }
    if let Some(letter) = kinds::camera_letter(text) {
        out.set_feature("camera", &letter, of);
    }
    for number in numbers(text) {
        let Some(value) = number.value().filter(|_| !number.is_counter()) else { continue };
        let word = number.before;
        // `low_gain_20ms`: a time is not a gain.
        if seconds(number.unit).is_some() {
            continue;
        }
        let mut setting = |feature: &str| out.set_feature(feature, &value.to_string(), of);
        if number.unit.eq_ignore_ascii_case("db") {
            if out.gain_db.is_none() {
                out.gain_db = Some(value);
                out.from.insert("gain_db".into(), of.into());
            }
        } else if is(word, GAIN) || (is(word, GAIN_LETTER) && !number.apart && !number.is_padded()) {
            setting("GainRaw");
        } else if is(word, ISO) {
            setting("ISO");
        } else if number.is_em_gain() {
            setting("EMGAIN");
        } else if is(word, CAMERA) && !number.apart && number.unit.is_empty() && value.fract() == 0.0 {
            setting("camera");
        } else if is(word, SERIAL) && number.unit.is_empty() && value.fract() == 0.0 {
            setting("serial number");
        } else if is(number.unit, BITS) && value.fract() == 0.0 {
            setting("bit depth");
        } else if is(word, CONFIGURATION) && value.fract() == 0.0 {
            if out.configuration.is_none() {
                out.configuration = Some(value as u32);
                out.from.insert("configuration".into(), of.into());
            }
        } else if number.binning || (is(word, BIN) && value <= 16.0 && value.fract() == 0.0) {
            let second = text.as_bytes()[..number.place.start].ends_with(b"x");
            if second {
                setting("BinningVertical");
            } else {
                setting("BinningHorizontal");
                if !number.binning {
                    setting("BinningVertical");
                }
            }
        } else if number.is_black_level() && strong {
            setting("BlackLevelRaw");
        } else if is(word, LIGHT) && number.pointed() {
            if out.illumination.is_none() {
                out.illumination = Some(value);
                out.from.insert("illumination".into(), of.into());
            }
        } else if let Some(celsius) = number.temperature_c.filter(|c| c.is_finite())
            && out.temperature_c.is_none()
        {
            out.temperature_c = Some(celsius);
            out.from.insert("temperature_c".into(), of.into());
        }
    }
}

/// Part of a name for natural sorting.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// Digits, sorted by value, and decimals.
    Number(u64, String),
    /// Any other text.
    Text(String),
}

/// Splits a name for natural sorting: `a_9` before `a_10`, `x0.25` before `x0.5`.
pub fn natural(name: &str) -> Vec<Part> {
    let mut out: Vec<Part> = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let digits = |text: &str| text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
        let whole = digits(rest);
        if whole == 0 {
            let end = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
            out.push(Part::Text(rest[..end].into()));
            rest = &rest[end..];
            continue;
        }
        let number =
            rest[..whole].bytes().fold(0u64, |n, d| n.saturating_mul(10).saturating_add((d - b'0').into()));
        let behind = rest[whole..].strip_prefix('.').map_or(0, digits);
        let fraction = if behind > 0 { &rest[whole + 1..whole + 1 + behind] } else { "" };
        out.push(Part::Number(number, fraction.trim_end_matches('0').into()));
        rest = &rest[whole + if behind > 0 { 1 + behind } else { 0 }..];
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn names_say_exposure_gain_and_kind() {
        for (folder, name, exposure_s, gain_db, kind) in [
            ("run", "flat_10ms_003.tif", Some(0.01), None, Some(Kind::Flat)),
            ("run", "Dark-exp0.5s-07.png", Some(0.5), None, Some(Kind::Dark)),
            ("darks", "img_250us_6dB_1.tiff", Some(250e-6), Some(6.0), Some(Kind::Dark)),
            ("100ms", "IMG0007.tif", Some(0.1), None, None),
            ("", "bias_0p5ms.fits", Some(0.0005), None, Some(Kind::Dark)),
            ("", "flat t=1.5e-3s 2.tif", Some(1.5e-3), None, Some(Kind::Flat)),
            ("", "frame 12.tif", None, None, None),
            (".tmpx2s", "a2S0uR1.tif", None, None, None),
            ("", "flat_1,5ms_2.tif", Some(1.5e-3), None, Some(Kind::Flat)),
            ("", "flatdark_5ms.tif", Some(5e-3), None, Some(Kind::Dark)),
            ("", "darkroom_flat_5ms.tif", Some(5e-3), None, Some(Kind::Flat)),
            ("", "Light_5ms.tif", Some(5e-3), None, None),
            ("", "Bias_0.000s_001.fits", Some(0.0), None, Some(Kind::Dark)),
            ("10ms", "x1f06db.tif", Some(0.01), Some(6.0), None),
            ("10ms", "aa1f06db.tif", Some(0.01), None, None),
            ("", "dark_.5s_1.tif", Some(0.5), None, Some(Kind::Dark)),
            ("", "dark 0,005 s nr 3.tif", Some(0.005), None, Some(Kind::Dark)),
            ("", "flat_0.25_s_1.tif", Some(0.25), None, Some(Kind::Flat)),
            ("", "flat_1.5_s2.tif", None, None, Some(Kind::Flat)),
            ("", "flat 10 s01.tif", None, None, Some(Kind::Flat)),
            ("", "dark.0001.10ms.tif", Some(0.01), None, Some(Kind::Dark)),
            ("", "0001.10ms.tif", None, None, None),
            ("", "dark_0010.50ms_1.tif", Some(0.0105), None, Some(Kind::Dark)),
            ("", "dark.10ms.0001.tif", Some(0.01), None, Some(Kind::Dark)),
            ("", "dark.12.10ms.tif", None, None, Some(Kind::Dark)),
            ("", "dark_0_5s_1.tif", None, None, Some(Kind::Dark)),
            ("", "dark_1-250s_1.tif", None, None, Some(Kind::Dark)),
            ("", "flat_0_1ms_01.tif", None, None, Some(Kind::Flat)),
            ("", "flat_0-25ms_01.tif", None, None, Some(Kind::Flat)),
            ("", "flat_0pt2ms.tif", None, None, Some(Kind::Flat)),
            ("", "flat_10_2ms.tif", Some(0.002), None, Some(Kind::Flat)),
            ("", "flat_low_gain_20ms.tif", Some(0.02), None, Some(Kind::Flat)),
            ("", "flat_2x3ms.tif", Some(0.003), None, Some(Kind::Flat)),
            ("", "dark_3_250s_1.tif", Some(250.0), None, Some(Kind::Dark)),
            ("", "dark_10.000,5ms_1.tif", None, None, Some(Kind::Dark)),
            ("", "dark_1s500ms_0.tif", None, None, Some(Kind::Dark)),
            ("", "dark_0ms_001.fits", None, None, Some(Kind::Dark)),
            ("", "Dark_300_secs_001.fits", Some(300.0), None, Some(Kind::Dark)),
            ("", "WhiteField 20 ms 3.tif", Some(0.02), None, Some(Kind::Flat)),
            ("", "dark_exp_500_us_1.tif", Some(5e-4), None, Some(Kind::Dark)),
            ("", "F_1234_ISO800_2s__20C.tif", Some(2.0), None, Some(Kind::Flat)),
            ("", "DF_2019-05-15_23-12-07_Bin1x1_300s__-10C.fit", Some(300.0), None, Some(Kind::Dark)),
            ("", "D_10ms_1.tif", Some(0.01), None, None),
            ("", "flat_2-20ms.tif", None, None, Some(Kind::Flat)),
            ("", "flat-2-20ms.tif", Some(0.02), None, Some(Kind::Flat)),
            ("", "flat_0002-20ms.tif", Some(0.02), None, Some(Kind::Flat)),
            ("", "flat_2.5ms-exp_100ms-period_03.tif", Some(2.5e-3), None, Some(Kind::Flat)),
            ("", "flat_2.5ms_exp_100ms_period.tif", Some(2.5e-3), None, Some(Kind::Flat)),
            ("", "flat_100ms-period_2.5ms-exp.tif", Some(2.5e-3), None, Some(Kind::Flat)),
            ("", "flat_period_100ms_exp_2.5ms.tif", Some(2.5e-3), None, Some(Kind::Flat)),
            ("", "flat_exp-2.5ms_delay-100ms.tif", Some(2.5e-3), None, Some(Kind::Flat)),
            ("", "flat_5ms exp 40ms interval.tif", Some(5e-3), None, Some(Kind::Flat)),
            ("", "dark_10ms_delay.tif", None, None, Some(Kind::Dark)),
            ("", "dark_10ms-exposure_7.tif", Some(0.01), None, Some(Kind::Dark)),
        ] {
            let got = facts(folder, name);
            assert_eq!((got.gain_db, got.kind), (gain_db, kind), "{name}");
            let close = |a: f64, b: f64| (a - b).abs() < 1e-12 * b.abs().max(1e-9);
            match (got.exposure_s, exposure_s) {
                (Some(a), Some(b)) => assert!(close(a, b), "{name}: {a}"),
                (a, b) => assert_eq!(a, b, "{name}"),
            }
        }
    }

    #[test]
    fn frames_of_a_set_have_one_stem_and_are_ordered_by_their_numbers() {
        assert_eq!(stem("flat_10ms_003.tif"), stem("flat_10ms_012.tif"));
        assert_ne!(stem("flat_10ms_003.tif"), stem("flat_20ms_003.tif"));
        assert!(natural("a_9_x.tif") < natural("a_10_x.tif"));
        assert!(natural("00_dark") < natural("01_dark"));
        assert!(natural("light0.25") < natural("light0.5") && natural("x_1.tif") < natural("x_2.tif"));
    }

    proptest! {
        #[test]
        fn no_name_makes_it_panic(name in "\\PC{0,40}") {
            let _ = (facts(&name, &name), stem(&name), natural(&name));
        }
    }
}
