//! Plain-text lists beside the frames: a line begins with the name of a frame or its folder, followed by
//! settings written as in a name (`Messung01: 5 ms (Kappe zu)`).

use super::Facts;
use super::names;
use std::collections::HashMap;

/// Maximum length of a line, characters.
const MAX_LINE: usize = 300;
/// Separators after the leading name, the most specific first; otherwise the first space.
const SIGNS: [char; 5] = [':', '=', '\t', ';', ','];
/// Minimum number of exposures in a list that also has other lines (a named choice).
const MIN_LINES: usize = 3;
/// Maximum total length of the lines of one name, characters.
const MAX_TEXT: usize = 4 * MAX_LINE;

/// Returns texts by the leading name of their lines, lines of one name joined; `None` for a text without
/// exposures, such as most prose.
pub fn rows_of(text: &str) -> Option<HashMap<String, String>> {
    let mut rows: HashMap<String, String> = HashMap::new();
    for line in text.trim_start_matches('\u{feff}').lines().filter(|l| l.len() <= MAX_LINE) {
        let parts = SIGNS.iter().find_map(|sign| line.split_once(*sign));
        let Some((name, said)) = parts.or_else(|| line.trim().split_once(' ')) else { continue };
        let name = name.rsplit(['/', '\\']).next().unwrap_or_default().trim_matches(['"', ' ']);
        if name.is_empty() || said.trim().is_empty() {
            continue;
        }
        let all = rows.entry(name.to_string()).or_default();
        if all.len() + said.len() > MAX_TEXT {
            continue;
        }
        all.push(' ');
        all.push_str(said.trim());
    }
    let has_exposure = |said: &&String| said.contains(char::is_numeric) && facts(said).exposure_s.is_some();
    let known = rows.values().filter(has_exposure).take(MIN_LINES).count();
    (known == MIN_LINES || known > 0 && known == rows.len()).then_some(rows)
}

/// Parses the facts stated by a line.
pub fn facts(said: &str) -> Facts {
    let mut facts = names::facts("", said.trim());
    facts.from.values_mut().for_each(|from| *from = format!("\"{}\"", said.trim()));
    facts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Kind;
    use proptest::prelude::*;

    #[test]
    fn lines_say_exposure_and_kind_of_what_they_name() {
        let rows = rows_of(
            "Camera: DMK 33UX252, Gain 0 dB\n\nMessung01: 5 ms (Kappe zu)\nMessung02:50 ms\r\na/b/img_3.tif\t0,5 s\nx 20 ms flat\n",
        )
        .unwrap();
        let of = |name: &str| facts(&rows[name]);
        assert_eq!((of("Messung01").exposure_s, of("Messung01").kind), (Some(0.005), Some(Kind::Dark)));
        assert_eq!((of("Messung02").exposure_s, of("Messung02").kind), (Some(0.05), None));
        assert_eq!(of("img_3.tif").exposure_s, Some(0.5));
        assert_eq!((of("x").exposure_s, of("x").kind), (Some(0.02), Some(Kind::Flat)));
        assert_eq!(rows_of("dark: 10 ms\nflat: 10 ms\n").map(|rows| rows.len()), Some(2));
        assert_eq!(rows_of("Exposure=5 ms\nPeriod=10 ms\nGain=3\nflat: of the blue lamp\n"), None);
    }

    proptest! {
        #[test]
        fn no_text_makes_it_panic(text in "\\PC{0,20}([:=,;\t\n\"/]\\PC{0,10}){0,12}") {
            let _ = rows_of(&text);
        }
    }
}
