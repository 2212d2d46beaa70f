//! Counters and times in names: they do not separate sets.

use super::headers;
use super::names::numbers;
use crate::number::seconds;
use std::ops::Range;

/// Minimum digits of a number that is a counter or time stamp at any position: `img_000000012`,
/// `21000312`.
const COUNTER_DIGITS: usize = 6;

/// Words before a number that counts frames.
const COUNTERS: [&str; 4] = ["frame", "frm", "shot", "snap"];

/// Run of digits.
#[derive(Debug, Clone, Copy)]
struct Run {
    start: usize,
    end: usize,
}

impl Run {
    fn len(self) -> usize {
        self.end - self.start
    }

    fn of(self, text: &str) -> u32 {
        text[self.start..self.end].parse().unwrap_or(u32::MAX)
    }
}

fn runs(text: &str) -> Vec<Run> {
    let bytes = text.as_bytes();
    let mut out = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        if !bytes[at].is_ascii_digit() {
            at += 1;
            continue;
        }
        let start = at;
        while bytes.get(at).is_some_and(u8::is_ascii_digit) {
            at += 1;
        }
        out.push(Run { start, end: at });
    }
    out
}

fn is_date(year: u32, month: u32, day: u32) -> bool {
    (1990..2100).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day)
}

fn is_time(hour: u32, minute: u32, second: u32) -> bool {
    hour < 24 && minute < 60 && second < 61
}

/// Returns the text between two runs if it is a single separator or empty.
fn gap(text: &str, a: Run, b: Run) -> &str {
    &text[a.end..b.start]
}

/// Finds dates followed by times, and times written with letters (`21h00m03s`): unambiguous stamps.
pub fn stamps(text: &str) -> Vec<Range<usize>> {
    let runs = runs(text);
    let mut out: Vec<Range<usize>> = Vec::new();
    let mut k = 0;
    while k < runs.len() {
        let date = date_at(text, &runs[k..]);
        let taken = match date {
            Some((count, end)) => {
                let mut end = end;
                let mut count = count;
                if let Some((more, last)) = time_behind(text, &runs[k + count - 1..]) {
                    (count, end) = (count + more, last);
                }
                out.push(runs[k].start..end);
                count
            }
            None => match lettered(text, &runs[k..]) {
                Some((count, end)) => {
                    out.push(runs[k].start..end);
                    count
                }
                None => 1,
            },
        };
        k += taken;
    }
    out
}

/// Returns seconds since 1970 of the first date with a time to the second, as [`headers::time_s`]
/// defines them; digits after the seconds are their fraction.
///
/// [`headers::time_s`]: super::headers::time_s
pub fn time_s(text: &str) -> Option<f64> {
    /// Number of digits of a date with its time.
    const WHOLE: usize = 14;
    let digits_of =
        |stamp: Range<usize>| -> String { text[stamp].chars().filter(char::is_ascii_digit).collect() };
    let digits = stamps(text).into_iter().map(digits_of).find(|digits| digits.len() >= WHOLE)?;
    let part = |range: Range<usize>| &digits[range];
    let date = format!("{}-{}-{}", part(0..4), part(4..6), part(6..8));
    let time = format!("{}:{}:{}", part(8..10), part(10..12), part(12..14));
    let fraction: f64 = format!("0.{}", part(WHOLE..digits.len())).parse().unwrap_or(0.0);
    Some(headers::time_s(&format!("{date}T{time}"))? + fraction)
}

/// Parses a date at the first run: returns the number of its runs, and its end.
fn date_at(text: &str, runs: &[Run]) -> Option<(usize, usize)> {
    let first = *runs.first()?;
    let digits = &text[first.start..first.end];
    // Formats 20240501, 20240501210003 and 20240501210003123.
    if matches!(first.len(), 8 | 14 | 17) {
        let part = |range: Range<usize>| digits[range].parse().unwrap_or(u32::MAX);
        let whole = first.len() == 8 || is_time(part(8..10), part(10..12), part(12..14));
        return (is_date(part(0..4), part(4..6), part(6..8)) && whole).then_some((1, first.end));
    }
    let (second, third) = (*runs.get(1)?, *runs.get(2)?);
    let separated = |a: Run, b: Run| matches!(gap(text, a, b), "-" | "_" | "." | "/");
    let sound = first.len() == 4
        && second.len() == 2
        && third.len() >= 2
        && gap(text, first, second) == gap(text, second, third)
        && separated(first, second);
    let day = text[third.start..third.end].get(..2)?.parse().ok()?;
    (sound && third.len() == 2 && is_date(first.of(text), second.of(text), day)).then_some((3, third.end))
}

/// Parses a time after a date whose last run is the first of `runs`.
fn time_behind(text: &str, runs: &[Run]) -> Option<(usize, usize)> {
    let (date, first) = (*runs.first()?, *runs.get(1)?);
    if !matches!(gap(text, date, first), "_" | "-" | "T" | "t" | " " | "__" | "." | " at ") {
        return None;
    }
    let digits = &text[first.start..first.end];
    let part = |range: Range<usize>| digits[range].parse().unwrap_or(u32::MAX);
    let whole = match first.len() {
        4 => is_time(part(0..2), part(2..4), 0),
        6.. => is_time(part(0..2), part(2..4), part(4..6)),
        _ => false,
    };
    // 100000us is an exposure.
    if whole && !is_measured(text, first.end) {
        let fraction = runs.get(2).filter(|f| matches!(gap(text, first, **f), "." | ","));
        return Some(fraction.map_or((1, first.end), |f| (2, f.end)));
    }
    clock(text, &runs[1..])
}

/// Parses a time of day of three two-digit runs, with its fraction: returns the number of its runs, and
/// its end.
fn clock(text: &str, runs: &[Run]) -> Option<(usize, usize)> {
    let (h, m, s) = (*runs.first()?, *runs.get(1)?, *runs.get(2)?);
    let separator = gap(text, h, m);
    let sound = matches!(h.len(), 1 | 2)
        && m.len() == 2
        && s.len() == 2
        && matches!(separator, "-" | "_" | ":" | ".")
        && separator == gap(text, m, s)
        && is_time(h.of(text), m.of(text), s.of(text));
    let fraction = runs.get(3).filter(|f| f.len() >= 3 && matches!(gap(text, s, **f), "." | ","));
    let (count, end) = fraction.map_or((3, s.end), |fraction| (4, fraction.end));
    // 01_02_10ms are two counters and an exposure; 01_02_10s is ambiguous.
    let measured = is_measured(text, end) && !letters(text, end).eq_ignore_ascii_case("s");
    (sound && !measured).then_some((count, end))
}

/// Returns the letters after a position.
fn letters(text: &str, end: usize) -> &str {
    let rest = &text[end..];
    &rest[..rest.find(|c: char| !c.is_alphabetic()).unwrap_or(rest.len())]
}

/// Returns true if a number is followed by a unit of time.
fn is_measured(text: &str, end: usize) -> bool {
    seconds(letters(text, end)).is_some()
}

/// Parses `21h00m03s` and `12m30s`: a time of day or a duration in parts.
fn lettered(text: &str, runs: &[Run]) -> Option<(usize, usize)> {
    let unit = |a: Run, b: Option<&Run>| {
        text[a.end..b.map_or(text.len(), |b| b.start)].trim_matches(['_', '-', ' ']).to_lowercase()
    };
    let first = *runs.first()?;
    let starts = |word: &str, units: &[&str]| units.contains(&word);
    let (mut count, mut last) = (1, first);
    let word = unit(first, runs.get(1));
    if !starts(&word, &["h", "hr", "m", "min"]) {
        return None;
    }
    for pair in runs.windows(2) {
        let word = unit(pair[0], Some(&pair[1]));
        if !starts(&word, &["h", "hr", "m", "min"]) {
            break;
        }
        count += 1;
        last = pair[1];
    }
    let rest = &text[last.end..];
    let letters = rest.find(|c: char| !c.is_alphabetic()).unwrap_or(rest.len());
    let ends = matches!(&*rest[..letters].to_lowercase(), "s" | "sec" | "m" | "min" | "h");
    let end = last.end + letters;
    // Milliseconds: `14h00m09s747ms`.
    if let Some(parts) = runs.get(count).filter(|r| starts(&word, &["h", "hr"]) && r.start == end)
        && ends
        && text[parts.end..].to_lowercase().starts_with("ms")
    {
        return Some((count + 1, parts.end + 2));
    }
    (count > 1 && ends).then_some((count, end))
}

/// Finds three digit pairs that may be a time of day: `Capture 21_00_03`. Counters look alike.
pub fn clocks(text: &str) -> Vec<Range<usize>> {
    let runs = runs(text);
    let alone = |at: usize, end: usize| {
        let before = text[..at].chars().next_back();
        let after = letters(text, end).to_lowercase();
        before.is_none_or(|c| !c.is_ascii_digit() && c != '.')
            && matches!(&*after, "" | "s" | "am" | "pm" | "z")
    };
    let of = |k: usize| clock(text, &runs[k..]).map(|(_, end)| runs[k].start..end);
    (0..runs.len()).filter_map(of).filter(|r| alone(r.start, r.end)).collect()
}

/// Replaces every range by `#`. Ranges may overlap.
fn without(text: &str, mut ranges: Vec<Range<usize>>) -> String {
    ranges.sort_by_key(|r| (r.start, r.end));
    let mut out = String::new();
    let mut at = 0;
    for range in ranges {
        if range.end <= at {
            continue;
        }
        if range.start >= at {
            out += &text[at..range.start];
            out.push('#');
        }
        at = range.end;
    }
    out + &text[at..]
}

/// Finds temperatures with their unit: `-10.0C`, `-9.9°C`.
fn temperatures(text: &str) -> Vec<Range<usize>> {
    let degrees = |n: &super::names::Number<'_>| n.temperature_c.is_some();
    numbers(text).iter().filter(|n| degrees(n)).map(|n| n.place.clone()).collect()
}

/// Finds hexadecimal words that are random names: `4c38cec7`, a UUID.
pub fn digests(text: &str) -> Vec<Range<usize>> {
    const LENGTH: usize = 8;
    /// Number of digits in the parts of a UUID (RFC 9562, section 4).
    const UUID: [usize; 5] = [8, 4, 4, 4, 12];
    let mut words: Vec<Range<usize>> = Vec::new();
    let mut start = 0;
    for (end, c) in text.char_indices().chain([(text.len(), '.')]) {
        if !c.is_alphanumeric() {
            words.push(start..end);
            start = end + c.len_utf8();
        }
    }
    let hex = |r: &Range<usize>| text[r.clone()].bytes().all(|b| b.is_ascii_hexdigit());
    let has = |r: &Range<usize>, of: fn(&u8) -> bool| text[r.clone()].bytes().any(|b| of(&b));
    let single = words.iter().filter(|r| {
        r.len() >= LENGTH && hex(r) && has(r, u8::is_ascii_digit) && has(r, u8::is_ascii_alphabetic)
    });
    let whole = words.windows(UUID.len()).filter(|w| w.iter().zip(UUID).all(|(r, n)| r.len() == n && hex(r)));
    single.cloned().chain(whole.map(|w| w[0].start..w[UUID.len() - 1].end)).collect()
}

/// Returns numbers with this many digits that are not a date, a time or a zero-padded counter.
pub fn long_numbers(name: &str, digits: std::ops::RangeInclusive<usize>) -> Vec<String> {
    let stamps = stamps(name);
    let is_long = |run: &Run| {
        digits.contains(&run.len())
            && !name[run.start..].starts_with('0')
            && !is_measured(name, run.end)
            && !stamps.iter().any(|r| r.start <= run.start && run.end <= r.end)
    };
    runs(name).into_iter().filter(is_long).map(|run| name[run.start..run.end].to_string()).collect()
}

/// Removes suffixes that file managers add to copies: a copy belongs to the set of its original.
fn uncopied(name: &str) -> String {
    const ADDED: [&str; 5] = [" - Copy", " - Kopie", " - Copie", " copy", "_copy"];
    ADDED.iter().fold(name.to_string(), |name, added| name.replace(added, ""))
}

/// Removes everything that differs from frame to frame: time stamps, sensor temperatures, long counters,
/// and the last number without a unit. Frames of one set share the result.
pub fn stem(name: &str) -> String {
    let name = &uncopied(name);
    let mut ranges = stamps(name);
    ranges.extend(digests(name));
    ranges.extend(temperatures(name));
    let stamped = ranges.clone();
    let inside = |place: &Range<usize>| stamped.iter().any(|r| r.start <= place.start && place.end <= r.end);
    let numbers = numbers(name);
    let free: Vec<_> =
        numbers.iter().filter(|n| n.unit.is_empty() && n.is_free() && !inside(&n.place)).collect();
    let whole = |text: &str| text.bytes().all(|b| b.is_ascii_digit());
    let counts = |n: &super::names::Number<'_>| {
        n.text.len() >= COUNTER_DIGITS || COUNTERS.iter().any(|word| n.before.eq_ignore_ascii_case(word))
    };
    ranges.extend(free.iter().filter(|n| whole(n.text) && counts(n)).map(|n| n.place.clone()));
    // The number before a file extension, if it is an integer.
    ranges.extend(free.iter().rev().find(|n| !n.text.contains('.')).map(|n| n.place.clone()));
    without(name, ranges)
}

/// Removes all numbers without a unit; also returns true if a removed part looks like a time of day.
pub fn loose(name: &str) -> (String, bool) {
    let name = &uncopied(name);
    let mut ranges = stamps(name);
    ranges.extend(digests(name));
    ranges.extend(temperatures(name));
    let clocks = clocks(name);
    let timed = !clocks.is_empty();
    ranges.extend(clocks);
    let free = |n: &&super::names::Number<'_>| (n.unit.is_empty() || n.is_counter()) && n.is_free();
    ranges.extend(numbers(name).iter().filter(free).map(|n| n.place.clone()));
    ranges.extend(ordinals(name));
    (without(name, ranges), timed)
}

/// Finds words that count like numbers: `_A`, `first`, `runB`.
fn ordinals(name: &str) -> Vec<Range<usize>> {
    const WORDS: [&str; 8] = ["one", "two", "three", "four", "first", "second", "third", "fourth"];
    const RUNS: [&str; 4] = ["run", "rep", "set", "series"];
    let ends = |c: char| !c.is_alphanumeric();
    let mut out = Vec::new();
    let mut start = 0;
    for (end, c) in name.char_indices().chain([(name.len(), '.')]).filter(|(_, c)| ends(*c)) {
        let word = name[start..end].to_lowercase();
        let letter = RUNS.iter().find_map(|run| word.strip_prefix(run)).unwrap_or(&word);
        if WORDS.contains(&&*word) || matches!(letter, "a" | "b" | "c" | "d") {
            out.push(start..end);
        }
        start = end + c.len_utf8();
    }
    out
}

/// Returns true if a position in a name belongs to a time of day or a date.
pub fn is_stamp(name: &str, place: &Range<usize>) -> bool {
    let touches = |r: &Range<usize>| r.start < place.end && place.start < r.end;
    stamps(name).iter().chain(&clocks(name)).any(touches)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn stamps_tell_the_time() {
        let noon = headers::time_s("2024-05-01T12:00:00").unwrap();
        for (name, after_s) in [
            ("acA1920-155um__22123456__20240501_120003123_0000.tiff", Some(3.123)),
            ("2024-05-01_12-00-03_flat.fits", Some(3.0)),
            ("flat_20240501120003.tif", Some(3.0)),
            ("2024-05-01T12:00:03.500.fits", Some(3.5)),
            // Minutes alone, a date alone, a counter.
            ("flat_20240501_1200.tif", None),
            ("flat_20240501_0001.tif", None),
            ("flat_00000012.tif", None),
        ] {
            let said = time_s(name).map(|t| (1000.0 * (t - noon)).round() / 1000.0);
            assert_eq!(said, after_s, "{name}");
        }
    }

    #[test]
    fn time_stamps_and_counters_part_no_sets() {
        for (a, b) in [
            // N.I.N.A.
            (
                "2024-05-01_21-00-03_DARK_-10.00_0.01s_0000.fits",
                "2024-05-01_21-00-09_DARK_-10.00_0.01s_0002.fits",
            ),
            // pylon Viewer
            (
                "Dark_10ms_acA1920-40um__22123456__20240501_210003003_0000.tiff",
                "Dark_10ms_acA1920-40um__22123456__20240501_210006006_0001.tiff",
            ),
            // ASIAIR
            (
                "Dark_1.0ms_Bin1_gain0_20230505-210200_-10.0C_0000.fit",
                "Dark_1.0ms_Bin1_gain0_20230505-210201_-9.9C_0001.fit",
            ),
            // Micro-Manager
            (
                "img_channel000_position000_time000000001_z000.tif",
                "img_channel000_position000_time000000002_z000.tif",
            ),
            ("img_000000001_Default_000.tif", "img_000000017_Default_000.tif"),
            // FlyCapture and Spinnaker
            ("fc2_save_2012-05-04-134444-0000.tif", "fc2_save_2012-05-04-134451-0007.tif"),
            // KStars
            ("Flat_L_5_secs_2023-05-05T21-00-03_001.fits", "Flat_L_5_secs_2023-05-05T21-00-09_002.fits"),
            ("flat_10ms_003.tif", "flat_10ms_012.tif"),
            ("flat_10ms_003.tif", "flat_10ms_003 - Copy.tif"),
            ("flat_10ms_003.tif", "flat_10ms_004 copy.tif"),
            ("bee8c57e.tif", "4c38cec7.tif"),
            (
                "10ms_3f2504e0-4f89-41d3-9a0c-0305e82c3301.tif",
                "10ms_0f8fad5b-d9cb-469f-a165-70867728950e.tif",
            ),
            ("dark_21h00m03s_10ms.tif", "dark_21h00m09s_10ms.tif"),
            ("flat_5ms_14h00m09s747ms.tif", "flat_5ms_14h00m10s830ms.tif"),
            ("20240501210003123.tif", "20240501210004001.tif"),
            ("20240501T210003.123456_flat_10ms.tif", "20240501T210004.000001_flat_10ms.tif"),
            ("img_1714597203123_10ms.tif", "img_1714597203456_10ms.tif"),
            ("2024_05_01_21_00_03_0001.tif", "2024_05_01_21_00_04_0002.tif"),
        ] {
            assert_eq!(stem(a), stem(b), "{a}");
        }
        for (a, b) in [
            ("flat_10ms_003.tif", "flat_20ms_003.tif"),
            ("flat_5ms_level1_003.tif", "flat_5ms_level2_003.tif"),
            ("flat_01_02_03.tif", "flat_01_03_03.tif"),
            ("flat-5-c-0003.tif", "flat-6-c-0003.tif"),
            ("dark_gain10_1.tif", "dark_gain20_1.tif"),
        ] {
            assert_ne!(stem(a), stem(b), "{a}");
        }
        assert_eq!(loose("Capture 21_00_03.tif"), loose("Capture 21_01_57.tif"));
        assert_eq!(loose("Snap 9-57-07 PM.tif"), loose("Snap 10-00-07 PM.tif"));
        assert_eq!(loose("flat_10ms_A.tif"), loose("flat_10ms_B.tif"));
        assert_eq!(loose("runA/flat_10ms.tif"), loose("runC/flat_10ms.tif"));
        assert_eq!(loose("first/flat_10ms.tif"), loose("second/flat_10ms.tif"));
        assert_eq!(loose("Flat-013L.fit"), loose("Flat-014L.fit"));
        assert_ne!(loose("flat_10ms_red.tif"), loose("flat_10ms_blue.tif"));
        assert!(loose("Capture 21_00_03.tif").1 && !loose("Capture 3.tif").1);
        for exposure in ["20240501_100000us_1.tif", "20240501_1000ms_1.tif", "flat_01_02_10ms.tif"] {
            let number = numbers(exposure).into_iter().find(|n| !n.unit.is_empty()).unwrap();
            assert!(!is_stamp(exposure, &number.place), "{exposure}");
        }
        assert!(is_stamp("x_12_30_45s.tif", &(8..10)) && !is_stamp("x_45s.tif", &(2..4)));
    }

    proptest! {
        #[test]
        fn no_name_makes_it_panic(name in "[0-9a-zµ°_.,: hms-]{0,40}") {
            let _ = (stem(&name), loose(&name), stamps(&name), clocks(&name));
        }
    }
}
