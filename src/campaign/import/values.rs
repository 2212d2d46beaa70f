//! Parser of numbers and units in the notations of programs and people.

use crate::number::seconds;

/// Reading of a text that begins with a number.
#[derive(Debug, Clone, PartialEq)]
pub enum Reading {
    /// Not a number.
    None,
    /// Unambiguous number.
    One(f64),
    /// Two possible readings.
    Two(f64, f64),
}

impl Reading {
    /// Returns the number if there is only one reading.
    pub fn one(&self) -> Option<f64> {
        match self {
            Self::One(value) => Some(*value),
            _ => None,
        }
    }
}

/// Parses the number at the start of a text, and returns the rest.
///
/// The decimal sign is a point or a comma. A single comma before three digits is a thousands separator
/// to some and the decimal comma to others: both readings are returned.
pub fn number(text: &str) -> (Reading, &str) {
    let text = text.trim();
    let bytes = text.as_bytes();
    let digit = |i: usize| bytes.get(i).is_some_and(u8::is_ascii_digit);
    let mut end = usize::from(matches!(bytes.first(), Some(b'+' | b'-')));
    let start = end;
    while digit(end)
        || (matches!(bytes.get(end), Some(b'.' | b','))
            && (digit(end + 1) || (end > start && digit(end - 1))))
    {
        end += 1;
    }
    if !(start..end).any(digit) {
        return (Reading::None, text);
    }
    let mantissa = end;
    let sign = usize::from(matches!(bytes.get(end + 1), Some(b'-' | b'+')));
    // FITS allows D for the exponent of a double (FITS standard 4.0, section 4.2.4).
    if matches!(bytes.get(end), Some(b'e' | b'E' | b'd' | b'D')) && digit(end + 1 + sign) {
        end += 1 + sign;
        while digit(end) {
            end += 1;
        }
    }
    let exponent = text[mantissa..end].to_lowercase().replace('d', "e");
    let of = |digits: &str| format!("{digits}{exponent}").parse::<f64>().ok().filter(|v| v.is_finite());
    let plain = &text[..mantissa];
    let reading = match readings(plain) {
        (Some(a), Some(b)) => match (of(&a), of(&b)) {
            (Some(a), Some(b)) => Reading::Two(a, b),
            _ => Reading::None,
        },
        (Some(a), None) => of(&a).map_or(Reading::None, Reading::One),
        _ => Reading::None,
    };
    (reading, text[end..].trim_start())
}

/// Parses a shutter speed `1/400`, a ratio of integers, at the start of a text, and returns the rest.
pub fn fraction(text: &str) -> Option<(Reading, &str)> {
    let (above, rest) = text.trim().split_once('/')?;
    let end = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
    let (below, rest) = rest.split_at(end);
    // 1/2/2024 is a date.
    let ends = !rest.starts_with(['/', '.', ',', '-', ':']);
    let (above, below) = (above.parse::<u32>().ok()?, below.parse::<u32>().ok()?);
    (ends && below > 0).then(|| (Reading::One(f64::from(above) / f64::from(below)), rest.trim_start()))
}

/// Returns the possible decimal readings of a text of digits, points and commas.
fn readings(text: &str) -> (Option<String>, Option<String>) {
    let count = |c: char| text.matches(c).count();
    let grouped = |separator: char, whole: &str| {
        let parts: Vec<&str> = whole.trim_start_matches(['+', '-']).split(separator).collect();
        (1..=3).contains(&parts[0].len()) && parts[1..].iter().all(|p| p.len() == 3)
    };
    match (count('.'), count(',')) {
        (0 | 1, 0) => (Some(text.into()), None),
        (0, 1) => {
            let decimal = text.replace(',', ".");
            let whole = text.split(',').next().unwrap_or_default().trim_start_matches(['+', '-']);
            let thousands = grouped(',', text) && whole != "0";
            (Some(decimal), thousands.then(|| text.replace(',', "")))
        }
        // Thousands separators, followed by the decimal sign.
        (1, _) | (_, 1) if count('.') > 0 && count(',') > 0 => {
            let at = text.rfind(['.', ',']).unwrap_or(0);
            let (decimal, other) = if text[at..].starts_with('.') { ('.', ',') } else { (',', '.') };
            let whole = &text[..at];
            let sound = !whole.contains(decimal) && grouped(other, whole);
            (sound.then(|| format!("{}.{}", whole.replace(other, ""), &text[at + 1..])), None)
        }
        (0, _) if grouped(',', text) => (Some(text.replace(',', "")), None),
        (_, 0) if grouped('.', text) => (Some(text.replace('.', "")), None),
        _ => (None, None),
    }
}

/// Converts a time to seconds so that the result is the nearest decimal: 35 ms is 0.035 and 47.933 us is
/// 0.000047933.
pub fn in_seconds(value: f64, unit_s: f64) -> f64 {
    let seconds = value * unit_s;
    format!("{seconds:.14e}").parse().unwrap_or(seconds)
}

/// Finds the unit of time in a comment: `exposure time in ms`, `[s] integration`. `Err` if there are
/// two, or one that cannot be parsed.
pub fn unit_in(comment: &str) -> Result<Option<f64>, ()> {
    // A unit in brackets takes precedence (FITS standard 4.0, section 4.3).
    if let Some((inside, _)) = comment.split_once('[').and_then(|(_, rest)| rest.split_once(']'))
        && let Some(unit_s) = seconds(inside.trim())
    {
        return Ok(Some(unit_s));
    }
    // Programs replace a micro sign that they cannot write by a question mark.
    let is_lost =
        |word: &str| matches!(word.trim_matches(['(', ')', '[', ']', '.', ',', ';']), "?s" | "\u{fffd}s");
    // `(min)` may mean minute or minimum.
    if comment.split_whitespace().any(is_lost) || comment.contains("(min)") {
        return Err(());
    }
    let words = comment.split(|c: char| !c.is_alphanumeric() && c != '\'' && c != '/');
    // min means minimum as often as minute.
    let words = words.map(|w| w.trim_matches('/')).filter(|w| !w.eq_ignore_ascii_case("min"));
    let mut units: Vec<f64> = words.filter_map(seconds).collect();
    units.dedup();
    match units[..] {
        [] => Ok(None),
        [one] => Ok(Some(one)),
        _ => Err(()),
    }
}

/// Splits a word and its unit of time: `exposure_ms`, `Exposure (us)`, `EXPOINUS`.
pub fn split_unit(key: &str) -> (String, Option<f64>) {
    let words: Vec<&str> = key.split(|c: char| !c.is_alphanumeric()).filter(|w| !w.is_empty()).collect();
    let joined = |words: &[&str]| words.concat().to_lowercase();
    match words[..] {
        [ref first @ .., last] if !first.is_empty() => match seconds(last) {
            Some(unit_s) => (joined(first).trim_end_matches("in").into(), Some(unit_s)),
            None => (joined(&words), None),
        },
        _ => match &*joined(&words) {
            "expoinus" => ("exposure".into(), Some(1e-6)),
            "exposureinus" => ("exposure".into(), Some(1e-6)),
            "exposureinms" => ("exposure".into(), Some(1e-3)),
            "exposurems" => ("exposure".into(), Some(1e-3)),
            "exposureus" => ("exposure".into(), Some(1e-6)),
            other => (other.into(), None),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn numbers_of_every_locale_are_read_once() {
        for (text, value, rest) in [
            ("12.5", 12.5, ""),
            ("12,5 ms", 12.5, "ms"),
            ("0,5", 0.5, ""),
            ("0,125", 0.125, ""),
            ("3,2E-05", 3.2e-5, ""),
            ("1.5D-3", 1.5e-3, ""),
            ("-10,5 C", -10.5, "C"),
            ("1,234.5", 1234.5, ""),
            ("1.234,5", 1234.5, ""),
            ("1,234,567", 1_234_567.0, ""),
            ("100. / s", 100.0, "/ s"),
            (".5s", 0.5, "s"),
            ("12,5000", 12.5, ""),
        ] {
            assert_eq!(number(text), (Reading::One(value), rest), "{text}");
        }
        assert_eq!(number("12,500 us").0, Reading::Two(12.5, 12_500.0));
        for text in ["", "ms", "-", "1.2.3", "1,2,3", "1.5.000,2"] {
            assert_eq!(number(text).0, Reading::None, "{text}");
        }
        assert_eq!(in_seconds(35.0, 1e-3), 0.035);
        assert_eq!(in_seconds(47.933, 1e-6), 4.7933e-5);
        assert_eq!(in_seconds(2.0, 60.0), 120.0);
    }

    #[test]
    fn shutter_speeds_are_fractions() {
        assert_eq!(fraction("1/400"), Some((Reading::One(0.0025), "")));
        assert_eq!(fraction(" 3/2 s"), Some((Reading::One(1.5), "s")));
        for text in ["1/2/2024", "1/0", "a/b", "1.5/2", "1/", "400", "1/4.5"] {
            assert_eq!(fraction(text), None, "{text}");
        }
    }

    #[test]
    fn units_stand_in_comments_and_words() {
        for (comment, unit) in [
            ("exposure time in ms", Ok(Some(1e-3))),
            ("[s] exposure", Ok(Some(1.0))),
            ("Exposure time (us)", Ok(Some(1e-6))),
            ("[ms] and not in seconds", Ok(Some(1e-3))),
            ("Total Exposure Time (s)", Ok(Some(1.0))),
            ("the camera's exposure", Ok(None)),
            ("exposure (min)", Err(())),
            ("least exposure, min 1", Ok(None)),
            ("Exposure time in ?s", Err(())),
            ("is this the exposure?so it is", Ok(None)),
            ("ms or s", Err(())),
            ("min exposure", Ok(None)),
            ("", Ok(None)),
        ] {
            assert_eq!(unit_in(comment), unit, "{comment}");
        }
        assert_eq!(split_unit("Exposure-ms"), ("exposure".into(), Some(1e-3)));
        assert_eq!(split_unit("EXPOINUS"), ("exposure".into(), Some(1e-6)));
        assert_eq!(split_unit("Exposure Time (µs)"), ("exposuretime".into(), Some(1e-6)));
        assert_eq!(split_unit("exposure_time"), ("exposuretime".into(), None));
    }

    proptest! {
        #[test]
        fn no_text_makes_it_panic(text in "\\PC{0,30}") {
            let _ = (number(&text), unit_in(&text), split_unit(&text));
        }

        #[test]
        fn what_is_written_is_read(value in -1e6f64..1e6) {
            let text = format!("{value}");
            prop_assert_eq!(number(&text).0, Reading::One(value));
            let comma = text.replace('.', ",");
            match number(&comma).0 {
                Reading::One(read) | Reading::Two(read, _) => prop_assert_eq!(read, value),
                Reading::None => prop_assert!(false, "{}", comma),
            }
        }
    }
}
