//! What file names and header words say of a frame.

use super::Facts;
use crate::dataset::Kind;
use crate::number::seconds;

/// The kind that a word names: the word itself, its plural, or with `frame` or `field` behind it. A light frame is that of the sky to some and
/// that of a card to others: it says nothing.
pub fn kind(word: &str) -> Option<Kind> {
    let word = word.to_lowercase();
    let is = |stems: &[&str]| {
        stems.iter().any(|stem| {
            let rest = word.strip_prefix(stem);
            rest.is_some_and(|rest| matches!(rest, "" | "s" | "frame" | "frames" | "field" | "fields"))
        })
    };
    if is(&["dark", "bias", "biase", "offset", "black", "zero", "flatdark", "darkflat"]) {
        Some(Kind::Dark)
    } else if is(&["flat", "bright", "white", "uniform", "ptc"]) {
        Some(Kind::Flat)
    } else if is(&["scene"]) {
        Some(Kind::Scene)
    } else if is(&["target"]) {
        Some(Kind::Target)
    } else {
        None
    }
}

/// A number in a name, with the letters on both sides of it.
#[derive(Debug, PartialEq)]
struct Number<'a> {
    before: &'a str,
    text: &'a str,
    value: f64,
    unit: &'a str,
}

/// Every number of a name. A point, a comma or a p between digits is the decimal point.
fn numbers(name: &str) -> Vec<Number<'_>> {
    let bytes = name.as_bytes();
    let digit = |i: usize| bytes.get(i).is_some_and(u8::is_ascii_digit);
    let letter = |c: char| c.is_alphabetic();
    let mut out = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        if !digit(at) {
            at += 1;
            continue;
        }
        let mut end = at;
        let mut pointed = false;
        while digit(end) || (!pointed && matches!(bytes.get(end), Some(b'.' | b',' | b'p')) && digit(end + 1))
        {
            pointed |= !digit(end);
            end += 1;
        }
        // 1e-3, not the e of a word.
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
        let rest = &name[end..];
        let unit = &rest[..rest.find(|c: char| !letter(c)).unwrap_or(rest.len())];
        // A unit ends a word: the s of `2s0` is none.
        let ends = !rest[unit.len()..].starts_with(|c: char| c.is_ascii_digit());
        let unit = if ends { unit } else { "" };
        if let Ok(value) = text.replace(['p', ','], ".").parse() {
            out.push(Number { before: &ahead[from..], text, value, unit });
        }
        at = end;
    }
    out
}

/// Facts of a path: of its last folder's name and of its own, which counts more.
pub fn facts(folder: &str, name: &str) -> Facts {
    let mut out = Facts::default();
    // A hidden folder is named by a program, not by the user.
    let folder = if folder.starts_with('.') { "" } else { folder };
    for text in [folder, name] {
        for number in numbers(text) {
            if let Some(unit_s) = seconds(number.unit) {
                out.exposure_s = Some(number.value * unit_s);
            } else if number.unit.eq_ignore_ascii_case("db") {
                out.gain_db = Some(number.value);
            } else if matches!(
                number.before.to_lowercase().as_str(),
                "light" | "illum" | "illumination" | "level"
            ) && number.text.contains(['.', ',', 'p'])
            {
                out.illumination = Some(number.value);
            }
        }
        if let Some(found) = text.split(|c: char| !c.is_alphabetic()).find_map(kind) {
            out.kind = Some(found);
        }
    }
    out
}

/// A name without its last number that has no unit: what the frames of one set have in common.
pub fn stem(name: &str) -> String {
    let last = numbers(name).into_iter().rev().find(|n| n.unit.is_empty() && !n.text.contains('.'));
    match last {
        Some(n) => {
            let at = n.text.as_ptr() as usize - name.as_ptr() as usize;
            format!("{}#{}", &name[..at], &name[at + n.text.len()..])
        }
        None => name.to_string(),
    }
}

/// A part of a name as it is ordered.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// Digits, by their size, and what stands behind a decimal point.
    Number(u64, String),
    /// Anything else.
    Text(String),
}

/// A name as it is ordered: `a_9` before `a_10`, `x0.25` before `x0.5`.
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
