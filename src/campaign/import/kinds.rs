//! Dark or flat: words in file names, folders and headers.

use crate::dataset::Kind;
use crate::number::seconds;

/// Returns the kind that a word names: the word, its plural, or the word followed by `frame` or `field`.
/// "Light frame" means a sky frame to some and a card frame to others, so it states no kind.
pub fn kind(word: &str) -> Option<Kind> {
    let word = word.to_lowercase();
    let is = |stems: &[&str]| {
        stems.iter().any(|stem| {
            let rest = word.strip_prefix(stem);
            rest.is_some_and(|rest| matches!(rest, "" | "s" | "frame" | "frames" | "field" | "fields"))
        })
    };
    if is(&[
        "dark",
        "bias",
        "biase",
        "offset",
        "black",
        "zero",
        "flatdark",
        "darkflat",
        "dunkel",
        "dunkelbild",
        "dunkelbilder",
    ]) {
        Some(Kind::Dark)
    } else if is(&[
        "flat",
        "bright",
        "white",
        "uniform",
        "ptc",
        "skyflat",
        "domeflat",
        "twiflat",
        "hell",
        "hellbild",
        "hellbilder",
    ]) {
        Some(Kind::Flat)
    } else if is(&["scene"]) {
        Some(Kind::Scene)
    } else if is(&["target"]) {
        Some(Kind::Target)
    } else {
        None
    }
}

/// Kind statements of one text.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Said {
    /// Kind, if the words agree.
    pub kind: Option<Kind>,
    /// Ambiguous word that may also be a setting: `offset` or `black` followed by a number. Used only if
    /// no other text states the kind.
    pub weak: Option<Kind>,
    /// True for a frame without its own exposure: bias, offset, zero.
    pub bias: bool,
    /// True for a frame of an object: neither dark nor flat, if others are named so.
    pub object: bool,
}

/// Words that follow `dark`, `black`, `white` in names of rooms and settings.
const NO_KIND: [&str; 13] = [
    "room", "box", "lab", "tent", "chamber", "cabinet", "level", "lvl", "gain", "point", "order", "balance",
    "body",
];
/// Words that follow `dark` in names of a correction or a study: `flat_DarkCorrectionOff_10ms` is a
/// flat.
const OF_DARK: [&str; 8] =
    ["corr", "correction", "corrected", "current", "sub", "subtraction", "subtracted", "signal"];

/// Words for a lamp or card; followed by `off` they state that there was no light: `flat_LEDoff_3ms`.
const LAMPS: [&str; 16] = [
    "led",
    "leds",
    "lamp",
    "lamps",
    "light",
    "lights",
    "illumination",
    "source",
    "laser",
    "flat",
    "flats",
    "white",
    "bright",
    "uniform",
    "field",
    "beam",
];
/// Words that state the absence of light.
const NO_LIGHT: [&str; 14] = [
    "capped",
    "lenscap",
    "covered",
    "closed",
    "nolight",
    "unlit",
    "ledoff",
    "lampoff",
    "lightoff",
    "lightsoff",
    "shuttered",
    "abgedeckt",
    "verschlossen",
    "abgedunkelt",
];

/// Returns true if words state the absence of light: `LED off`, `capped`, `no light`.
fn is_unlit(words: &[String]) -> bool {
    let pair = |first: &str, second: &str| match second {
        "off" => LAMPS.contains(&first),
        "light" | "illumination" => matches!(first, "no" | "without"),
        "licht" => first == "ohne",
        "on" => first == "cap",
        "zu" | "drauf" | "geschlossen" => {
            matches!(first, "kappe" | "deckel" | "objektivdeckel" | "verschluss" | "shutter")
        }
        _ => false,
    };
    words.iter().any(|w| NO_LIGHT.contains(&&**w)) || words.windows(2).any(|w| pair(&w[0], &w[1]))
}

/// Returns the kind that a text names. Flat darks (`Flat Darks`, `flat_dark_`, `DarkFlat`) are darks; if
/// both words are separated (`flats and darks`) the text states no kind.
pub fn of(text: &str) -> Said {
    let words = words(text);
    let lower: Vec<String> = words.iter().map(|(word, _)| word.to_lowercase()).collect();
    let follows = |place: usize, any: &[&str]| lower.get(place + 1).is_some_and(|w| any.contains(&&**w));
    let mut strong: Vec<(usize, Kind)> = Vec::new();
    let mut out = Said::default();
    for (place, (word, number)) in words.iter().enumerate() {
        out.object |= !number && is_object(&lower[place]);
        // `dark_gain0` states a gain; `dark_gain` is a gain map.
        let is_setting =
            words.get(place + 1).is_some_and(|(next, number)| *number && next.eq_ignore_ascii_case("gain"));
        let names = |_: &Kind| is_setting || !follows(place, &NO_KIND);
        let Some(kind) = kind(word).filter(names) else { continue };
        out.bias |= ["bias", "biases", "biasframe", "zero", "zeros"].contains(&&*lower[place]);
        if *number && ["offset", "black", "zero", "white", "bright", "target"].contains(&&*lower[place]) {
            out.weak = out.weak.or(Some(kind));
        } else {
            strong.push((place, kind));
        }
    }
    // A dark correction is stated next to another kind; alone, `dark` is the kind.
    if strong.iter().any(|s| s.1 != Kind::Dark) {
        strong.retain(|s| s.1 != Kind::Dark || !follows(s.0, &OF_DARK));
    }
    let first = strong.first().map(|(_, kind)| *kind);
    let dark = strong.iter().position(|(_, kind)| *kind == Kind::Dark);
    let other = strong.iter().position(|(_, kind)| *kind != Kind::Dark);
    out.kind = match (dark, other) {
        (Some(a), Some(b)) => {
            let is_flat_dark =
                strong[a].0.abs_diff(strong[b].0) == 1 && lower[strong[a].0].starts_with("dark");
            is_flat_dark.then_some(Kind::Dark)
        }
        _ => first,
    };
    if is_unlit(&lower) && out.kind.is_none_or(|k| k == Kind::Flat) {
        (out.kind, out.weak) = (Some(Kind::Dark), None);
    }
    out.object &= out.kind.is_none() && out.weak.is_none();
    out
}

/// Returns true for a word that names a frame of the sky or of any object.
fn is_object(word: &str) -> bool {
    matches!(
        word,
        "light" | "lights" | "lightframe" | "lightframes" | "science" | "object" | "snapshot" | "snapshots"
    )
}

/// Returns the kind stated by a file name: by its words, or by the leading letter that APT writes
/// (`D_1234_ISO800_300s__20C`, `F_2019-05-15_23-12-07_Bin1x1_2s__-10C`).
pub fn of_file(name: &str) -> Said {
    let said = of(name);
    let letters = &name[..name.find(|c: char| !c.is_ascii_uppercase()).unwrap_or(name.len())];
    let rest = name[letters.len()..].strip_prefix('_').unwrap_or_default();
    let apt = rest.starts_with(|c: char| c.is_ascii_digit())
        && rest.split('_').any(|part| {
            let after = part.strip_prefix("ISO").or_else(|| part.strip_prefix("Bin"));
            after.is_some_and(|n| n.starts_with(|c: char| c.is_ascii_digit()))
        });
    let kind = match letters {
        "D" | "DF" | "FD" | "B" if apt => Kind::Dark,
        "F" if apt => Kind::Flat,
        _ => return said,
    };
    Said { kind: said.kind.or(Some(kind)), bias: said.bias || letters == "B", ..said }
}

/// Returns true if a text states only the kind and settings: `01_Darks`, `flat 10ms gain0`, but not
/// `dark_current_study`.
pub fn alone(text: &str) -> bool {
    const SETTINGS: [&str; 14] = [
        "frame", "frames", "field", "fields", "gain", "iso", "bin", "offset", "exp", "exposure", "light",
        "led", "set", "run",
    ];
    words(text).iter().all(|(word, _)| {
        let lower = word.to_lowercase();
        kind(word).is_some() || SETTINGS.contains(&&*lower) || word.len() <= 2 || seconds(word).is_some()
    })
}

/// Returns true if `black` alone marks a folder as darks: it may be that of a black camera, or of black
/// columns.
pub fn says_black_alone(text: &str) -> bool {
    words(text).iter().all(|(word, _)| kind(word).is_none() || word.eq_ignore_ascii_case("black"))
}

/// Splits into words of letters, with a flag for a following number; `FlatDark` gives two words.
fn words(text: &str) -> Vec<(&str, bool)> {
    let mut out = Vec::new();
    let mut start = None;
    let mut before = ' ';
    let number_after = |at: usize| {
        let rest = text[at..].trim_start_matches(['_', '=', ' ', '-']);
        rest.starts_with(|c: char| c.is_ascii_digit())
    };
    for (at, c) in text.char_indices() {
        let splits = before.is_lowercase() && c.is_uppercase();
        if let Some(from) = start
            && (!c.is_alphabetic() || splits)
        {
            out.push((&text[from..at], !splits && number_after(at)));
            start = None;
        }
        if c.is_alphabetic() && start.is_none() {
            start = Some(at);
        }
        before = c;
    }
    if let Some(from) = start {
        out.push((&text[from..], false));
    }
    out
}

/// Returns the gain step that a name states in words: `lowgain_flat`, `flat_high_gain`.
pub fn gain_step(name: &str) -> Option<&'static str> {
    let lower: Vec<(String, bool)> =
        words(name).iter().map(|(word, number)| (word.to_lowercase(), *number)).collect();
    let steps = [
        ("low", "low"),
        ("lo", "low"),
        ("niedrig", "low"),
        ("niedrige", "low"),
        ("high", "high"),
        ("hi", "high"),
        ("hoch", "high"),
        ("hohe", "high"),
        ("medium", "medium"),
    ];
    let is_gain = |word: &str| matches!(word, "gain" | "verstärkung" | "verstaerkung");
    let of = |(short, step): (&str, &'static str)| {
        let together = format!("{short}gain");
        let pair = |a: &(String, bool), b: &(String, bool)| {
            // In gain100_low the number is the gain.
            (a.0 == short && is_gain(&b.0)) || (is_gain(&a.0) && !a.1 && b.0 == short)
        };
        let apart = lower.windows(2).any(|w| pair(&w[0], &w[1]));
        (apart || lower.iter().any(|w| w.0 == together)).then_some(step)
    };
    steps.into_iter().find_map(of)
}

/// Returns the letter of one of several cameras: `camA_flat`, `flat_Camera-B`, `cam_left`.
pub fn camera_letter(name: &str) -> Option<String> {
    const SIDES: [&str; 4] = ["left", "right", "master", "slave"];
    const CAMERA: [&str; 2] = ["camera", "cam"];
    let parts: Vec<&str> = name.split(|c: char| !c.is_alphanumeric()).collect();
    // The letter s of `cams` is a plural.
    let is_letter = |word: &str| {
        word.len() == 1 && word.starts_with(|c: char| c.is_ascii_uppercase() || matches!(c, 'a'..='d'))
    };
    let is_camera = |word: &str| CAMERA.iter().any(|c| word.eq_ignore_ascii_case(c));
    let glued = |part: &str| {
        let rest = CAMERA
            .iter()
            .find_map(|c| part.get(..c.len()).filter(|p| p.eq_ignore_ascii_case(c)).map(|_| c))?;
        let rest = &part[rest.len()..];
        is_letter(rest).then(|| rest.to_uppercase())
    };
    let apart = |w: &[&str]| {
        let is_name = is_letter(w[1]) || SIDES.contains(&&*w[1].to_lowercase());
        (is_camera(w[0]) && is_name).then(|| w[1].to_uppercase())
    };
    parts.iter().find_map(|p| glued(p)).or_else(|| parts.windows(2).find_map(apart))
}

/// Returns the reason that a name marks a processed file: averages and corrected frames have different
/// noise.
pub fn processed(name: &str) -> Option<String> {
    // Siril's prefix of preprocessed frames, also after the prefix of registered ones.
    let siril = ["pp_", "r_pp_", "bkg_pp_"].iter().any(|p| name.starts_with(p));
    const WORDS: &[&str] = &[
        "master",
        "masters",
        "masterdark",
        "masterflat",
        "masterbias",
        "superdark",
        "superflat",
        "superbias",
        "stacked",
        "averaged",
        "average",
        "averages",
        "averaging",
        "avg",
        "nav",
        "mean",
        "median",
        "sum",
        "summed",
        "coadd",
        "coadded",
        "accum",
        "accumulated",
        "accumulation",
        "integration",
        "integrated",
        "combined",
        "merged",
        "composite",
        "hdr",
        "denoised",
        "despeckled",
        "filtered",
        "processed",
        "reduced",
        "normalized",
        "normalised",
        "linearized",
        "linearised",
        "registered",
        "resampled",
        "upscaled",
        "lossy",
        "calibrated",
        "bgsub",
        "bgcorr",
        "debiased",
        "dsub",
        "minusdark",
        "darksub",
        "biassub",
        "subtracted",
        "corrected",
        "flatfielded",
        "debayered",
    ];
    let whole: Vec<String> =
        name.split(|c: char| !c.is_alphabetic()).map(str::to_lowercase).filter(|w| !w.is_empty()).collect();
    let camel: Vec<String> = words(name).into_iter().map(|(word, _)| word.to_lowercase()).collect();
    let of = |all: &[String]| {
        let is_one = |k: &usize| {
            let next = all.get(k + 1).map_or("", String::as_str);
            WORDS.contains(&&*all[*k]) && !SENSORS_AND_TESTS.contains(&(&*all[*k], next))
        };
        (0..all.len()).find(is_one).map(|k| all[k].clone())
    };
    let word = of(&whole).or_else(|| of(&camel));
    match (siril, word) {
        (true, _) => Some("the name begins with pp_, which Siril gives to calibrated frames".into()),
        (_, Some(word)) => Some(format!("the name says \"{word}\"")),
        _ => None,
    }
}

/// Words of [`processed`] that together with the next word name a sensor, a test or an exposure.
const SENSORS_AND_TESTS: [(&str, &str); 12] = [
    ("stacked", "cmos"),
    ("stacked", "sensor"),
    ("stacked", "bsi"),
    ("mean", "variance"),
    ("mean", "var"),
    ("mean", "vs"),
    ("mean", "sigma"),
    ("mean", "signal"),
    ("integration", "time"),
    ("integration", "ms"),
    ("integration", "us"),
    ("integration", "s"),
];

/// Returns the number of frames possibly averaged, stated as a separate word (`x4`, `8x`), with that
/// word. Positions (`x2_y3`), regions (`64x64`), fractions (`x2.5`) and lens magnifications (`10x`,
/// `20x`) are excluded.
pub fn times(name: &str) -> Option<(&str, u32)> {
    // Strip the extension.
    let stem = name
        .rsplit_once('.')
        .filter(|(_, e)| e.starts_with(|c: char| c.is_alphabetic()))
        .map_or(name, |s| s.0);
    let parts = || stem.split(|c: char| !c.is_alphanumeric() && c != '.');
    let number = |digits: &str| digits.parse::<u32>().ok();
    let many = |n: &u32| (2..=1024).contains(n);
    if parts().any(|part| part.strip_prefix(['y', 'Y']).and_then(number).is_some()) {
        return None;
    }
    parts().find_map(|part| {
        let in_front = part.strip_prefix(['x', 'X']).and_then(number).filter(many);
        let behind = part.strip_suffix(['x', 'X']).and_then(number).filter(many);
        in_front.or(behind.filter(|n| n.is_power_of_two())).map(|n| (part, n))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flat_darks_are_darks() {
        for text in
            ["Flat Darks", "flat_dark_21ms_3", "FlatDark", "darkFlat", "DARKFLAT", "Flat-Darks", "dark flats"]
        {
            assert_eq!(of(text).kind, Some(Kind::Dark), "{text}");
        }
        for text in ["Flats", "SkyFlat", "flat_offset10_5ms", "Dome Flat", "flat_black_level 3"] {
            let said = of(text);
            assert!(said.kind == Some(Kind::Flat), "{text}: {said:?}");
        }
        for text in [
            "flat_BlackLevel64_10ms",
            "flat_black_level 3",
            "flat_DarkRoom_1",
            "flat_dark_room_1",
            "flatBlackLevel64",
            "flat_DarkCorrectionOff_10ms",
            "dark_current_test_flat_10ms",
        ] {
            assert_eq!(of(text).kind, Some(Kind::Flat), "{text}");
        }
        for text in ["BlackLevel64", "dark room", "dark_room_2024"] {
            assert_eq!(of(text).kind, None, "{text}");
        }
        assert_eq!(of("dark_current_10ms").kind, Some(Kind::Dark));
        assert!(
            of("LIGHT").object
                && of("M31_lights").object
                && !of("flat_light_1").object
                && !of("light2").object
        );
        for text in [
            "flat_LEDoff_3ms",
            "flat_capped",
            "flats off",
            "flat_no_light",
            "led_off_10ms",
            "dark_gain0_exp10ms",
            "white cap on",
        ] {
            assert_eq!(of(text).kind, Some(Kind::Dark), "{text}");
        }
        for text in ["flat_LEDon_3ms", "flat_shading_off", "flat_gain_0_10ms", "flat_shutter_open"] {
            assert_eq!(of(text).kind, Some(Kind::Flat), "{text}");
        }
        assert_eq!(of("flats and darks").kind, None);
        assert_eq!(of("darkroom").kind, None);
        assert!(alone("01_Darks") && alone("flat 10ms gain0") && alone("Flat Field"));
        assert!(!alone("dark_current_study") && !alone("darks_of_camera_7"));
        let said = of("offset_001");
        assert_eq!((said.kind, said.weak), (None, Some(Kind::Dark)));
        assert!(of("Bias Frame").bias && !of("dark").bias);
    }

    #[test]
    fn averages_and_corrected_frames_are_told_by_their_names() {
        for name in
            ["masterDark_10ms.fit", "MasterFlat.fit", "pp_flat_00001.fit", "dark_stacked.fit", "flat_avg16_1"]
        {
            assert!(processed(name).is_some(), "{name}");
        }
        for name in ["flat_10ms_x4_001.tif", "dark_8x_10ms.tif", "flat x16.tif", "16x"] {
            assert!(times(name).is_some(), "{name}");
        }
        for name in [
            "dark_10ms_stack.tif",
            "flat_10ms_003.tif",
            "applepp_1.tif",
            "mastery_flat.tif",
            "stacked_cmos",
            "StackedCMOS_2",
            "mean_variance_test",
            "mean-vs-sigma",
            "integration_time_10ms",
            "flat_2x2_10ms.tif",
            "flat_64x64_3.tif",
            "flat_x2.5_3.tif",
            "flat_x2_y3.tif",
            "flat_20x_10ms.tif",
            "flat_x1.tif",
            "x0.25",
        ] {
            assert_eq!((processed(name), times(name)), (None, None), "{name}");
        }
        assert!(processed("stacked_flats").is_some() && processed("flat_mean").is_some());
    }

    #[test]
    fn cameras_and_gains_have_words() {
        for (name, letter) in
            [("camA_flat_1.tif", "A"), ("flat_Camera-B_2", "B"), ("cam_left_3", "LEFT"), ("cama_1", "A")]
        {
            assert_eq!(camera_letter(name).as_deref(), Some(letter), "{name}");
        }
        for name in ["cams_1", "camera_flat", "campaign_a", "cam1_flat", "camera_s_1", "a_cam"] {
            assert_eq!(camera_letter(name), None, "{name}");
        }
        for (name, step) in [
            ("lowgain_flat", "low"),
            ("flat_high_gain_3", "high"),
            ("FlatLowGain", "low"),
            ("Verstärkung hoch", "high"),
            ("niedrige Verstärkung", "low"),
        ] {
            assert_eq!(gain_step(name), Some(step), "{name}");
        }
        for name in ["low_light_gain5", "highlight_gain", "gain100_low"] {
            assert_eq!(gain_step(name), None, "{name}");
        }
    }
}
