//! Cards of a FITS header: keyword, value and comment (FITS standard 4.0, section 4).

use crate::dataset::image;
use std::path::Path;

/// Size of a card, bytes.
const CARD: usize = 80;

/// FITS card with a value.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Card {
    /// Keyword.
    pub key: String,
    /// Value, strings without their quotes.
    pub value: String,
    /// Comment behind the slash.
    pub comment: String,
}

/// Reads the cards of the image header, sorted by keyword: the file order is meaningless.
pub fn read(path: &Path) -> Result<Vec<Card>, String> {
    Ok(of_bytes(&image::fits_header(path).map_err(|e| e.to_string())?))
}

/// Parses the cards of a header.
pub fn of_bytes(header: &[u8]) -> Vec<Card> {
    let mut out: Vec<Card> = Vec::new();
    let mut continued = false;
    for card in header.chunks_exact(CARD) {
        let text = image::card_text(card);
        let key = text.get(..8).unwrap_or(&text).trim_end();
        if key == "END" {
            break;
        }
        if key == "CONTINUE" && continued {
            let (more, comment) = value_of(text.get(8..).unwrap_or_default());
            if let Some(last) = out.last_mut() {
                last.value.pop();
                last.value += &more;
                last.comment += &comment;
                continued = last.value.ends_with('&');
            }
            continue;
        }
        continued = false;
        // HISTORY and COMMENT are text without a value (section 4.4.2.4).
        if key == "HISTORY" || (key == "COMMENT" && !text.get(8..).is_some_and(|rest| rest.starts_with('=')))
        {
            let value = text.get(8..).unwrap_or_default().trim().to_string();
            out.push(Card { key: key.to_string(), value, comment: String::new() });
            continue;
        }
        // ESO's convention for long keywords.
        let (key, value) = match text.strip_prefix("HIERARCH ").and_then(|rest| rest.split_once('=')) {
            Some((key, value)) => (key.trim(), value),
            None => match text.get(8..).and_then(|rest| rest.strip_prefix('=')) {
                Some(value) => (key, value),
                None => continue,
            },
        };
        let (value, comment) = value_of(value);
        continued = value.ends_with('&');
        out.push(Card { key: key.to_string(), value, comment });
    }
    out.sort();
    out
}

/// Splits value and comment: a slash inside quotes belongs to the value.
fn value_of(text: &str) -> (String, String) {
    let text = text.trim_start();
    let (value, rest) = match text.strip_prefix('\'') {
        Some(inside) => {
            let mut value = String::new();
            let mut rest = "";
            let mut chars = inside.char_indices().peekable();
            while let Some((at, c)) = chars.next() {
                if c == '\'' {
                    // Two quotes encode one.
                    if chars.next_if(|(_, next)| *next == '\'').is_none() {
                        rest = &inside[at + 1..];
                        break;
                    }
                }
                value.push(c);
            }
            (value.trim_end().to_string(), rest)
        }
        None => {
            let (value, _) = text.split_once('/').unwrap_or((text, ""));
            (value.trim().to_string(), &text[value.len()..])
        }
    };
    let comment = rest.trim_start().trim_start_matches('/').trim();
    (value, comment.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(cards: &[&str]) -> Vec<u8> {
        cards.iter().flat_map(|c| format!("{c:<80}").into_bytes()).collect()
    }

    /// Micro signs in UTF-8 and in Latin-1, where they are one byte.
    #[test]
    fn micro_signs_are_read() {
        let mut header = header(&["EXPTIME =                 25 / [µs]", "END"]);
        let utf8 = header.windows(2).position(|w| w == "µ".as_bytes()).unwrap();
        assert_eq!(of_bytes(&header)[0].comment, "[µs]");
        header.splice(utf8..utf8 + 2, [0xb5, b's']);
        header.splice(utf8 + 2..utf8 + 3, *b"]");
        header.resize(160, b' ');
        assert!(of_bytes(&header)[0].comment.starts_with("[µs]"), "{:?}", of_bytes(&header));
    }

    #[test]
    fn values_and_comments_are_told_apart() {
        let found = of_bytes(&header(&[
            "INSTRUME= 'ZWO ASI/174MM' / camera",
            "EXPTIME =                100 / exposure time in ms",
            "HIERARCH DET EXP TIME = 3.5 / [s]",
            "OBSERVER= 'O''Neil'",
            "LONG    = 'one &'",
            "CONTINUE  'and two' / joined",
            "COMMENT exposure in ms",
            "HISTORY Auto-Dark Subtraction",
            "END",
            "AFTER   = 1",
        ]));
        let of = |key: &str| found.iter().find(|c| c.key == key).map(|c| (&*c.value, &*c.comment));
        assert_eq!(of("INSTRUME"), Some(("ZWO ASI/174MM", "camera")));
        assert_eq!(of("EXPTIME"), Some(("100", "exposure time in ms")));
        assert_eq!(of("DET EXP TIME"), Some(("3.5", "[s]")));
        assert_eq!(of("OBSERVER"), Some(("O'Neil", "")));
        assert_eq!(of("LONG"), Some(("one and two", "joined")));
        assert_eq!(of("COMMENT"), Some(("exposure in ms", "")));
        assert_eq!(of("HISTORY"), Some(("Auto-Dark Subtraction", "")));
        assert_eq!(of("AFTER"), None);
    }
}
