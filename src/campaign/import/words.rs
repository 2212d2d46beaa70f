//! Named values of headers: FITS cards, lines of a description, JSON.

use super::values::{self, Reading};
use super::{Facts, headers, kinds, same_exposure};
use crate::features::is_setting;
use crate::number::seconds;

/// A named value.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Said {
    /// Name as written.
    pub key: String,
    /// Value as text, without quotes.
    pub value: String,
    /// Comment of a FITS value.
    pub comment: String,
}

impl Said {
    pub fn new(key: &str, value: &str) -> Self {
        Self { key: key.trim().into(), value: value.trim().into(), comment: String::new() }
    }
}

/// Kind of writer, which determines the meaning of a number without a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Writer {
    /// FITS: times are in seconds unless stated otherwise (FITS standard 4.0, section 4.3).
    Fits,
    /// `key = value` lines: a number without a unit is ambiguous.
    Lines,
    /// JSON of GenICam features: `ExposureTime` is in microseconds (SFNC 2.7, section 6.3), `Gain` in dB.
    Json,
}

/// Settings shared by all frames of a dataset: the name in the dataset and the words in headers.
const SETTINGS: &[(&str, &[&str])] = &[
    ("GainRaw", &["gain", "gainraw", "cameragain", "camgain"]),
    ("ISO", &["iso", "isospeed", "isospeedratings", "isovalue"]),
    ("EGAIN", &["egain"]),
    ("BlackLevelRaw", &["blklevel", "blacklevelraw", "blacklvl", "blevel", "offset", "cameraoffset"]),
    ("PEDESTAL", &["pedestal"]),
    ("BinningHorizontal", &["xbinning", "binningx", "ccdxbin", "binx", "xbin", "hbin", "binninghorizontal"]),
    ("BinningVertical", &["ybinning", "binningy", "ccdybin", "biny", "ybin", "vbin", "binningvertical"]),
    ("READOUTM", &["readoutm", "readmode", "readoutmode", "rdmode"]),
    ("PREAMP", &["preamp", "preampgain"]),
    ("OUTPTAMP", &["outptamp", "outputamplifier"]),
    ("EMGAIN", &["emgain", "emrealgn"]),
    ("READTIME", &["readtime"]),
    ("READSPD", &["readspd", "readspeed", "readoutspeed", "digitizer"]),
    ("CONVGAIN", &["convgain", "conversiongain", "gainmode", "gainmod", "convgainmode", "sensorgainmode"]),
    ("SUBRECT", &["subrect", "roi", "region"]),
    ("DETECTOR", &["detector"]),
    ("HIGHSPD", &["highspd"]),
    ("BLCLAMP", &["blclamp"]),
    ("FLIPX", &["flipx"]),
    ("FLIPY", &["flipy"]),
    ("FLIPSTAT", &["flipstat"]),
    ("OffsetX", &["xorgsubf"]),
    ("OffsetY", &["yorgsubf"]),
];

/// Words for the number of exposures combined into one frame.
const COMBINED: &[&str] = &[
    "ncombine",
    "stackcnt",
    "ncoadds",
    "coadds",
    "ncoadd",
    "numcoadd",
    "nstack",
    "stacknum",
    "imstack",
    "snapshot",
    "averages",
    "averaging",
    "averageframes",
    "navg",
    "naverage",
    "numaverages",
    "frameaverage",
    "frameaveraging",
    "frameaveragecount",
    "framesaveraged",
    "framestoaverage",
    "frmavg",
    "averagecount",
    "accumulations",
    "accumulationcount",
    "numberofaccumulations",
    "accum",
    "nacc",
    "numacc",
    "coadd",
    "ndit",
    "nsumexp",
];

/// Words whose value confirms a processing step: `T`, `yes`, `On`, a file name.
const DONE: &[&str] = &[
    "combined",
    "stacked",
    "imcmb001",
    "calibrat",
    "calibrated",
    "zerocor",
    "biascor",
    "darkcor",
    "flatcor",
    "biascorr",
    "darkcorr",
    "flatcorr",
    "ccdproc",
    "biassub",
    "darksub",
    "subbias",
    "subdark",
    "biasfile",
    "darkfile",
    "flatfile",
    "filtered",
    "linearize",
    "linearized",
    "lineariz",
    "debayer",
    "debayered",
    "resample",
    "resampled",
    "subtract",
    "subtractdark",
    "applyflat",
    "shading",
    "shadingcorrection",
];

/// Returns true if such a value is negative.
fn is_no(value: &str) -> bool {
    matches!(
        value.trim().to_uppercase().as_str(),
        "F" | "0" | "NO" | "NONE" | "OFF" | "OMIT" | "PERFORM" | "FALSE" | "N/A" | "N"
    )
}

/// Words for an exposure, the best first. The choice does not depend on the order of a header.
const EXPOSURES: &[&str] = &[
    "exptime",
    "exposure",
    "exposuretime",
    "xposure",
    "exposuretimeabs",
    "counttime",
    "integrationtime",
    "inttime",
    "itime",
    "tint",
    "shutterspeed",
    "shutter",
    "exp",
    "belichtungszeit",
    "belichtung",
    "integrationszeit",
    "tempsdexposition",
    "tempsdepose",
    "tiempodeexposicion",
];

/// Words for the unit of the times in a header.
const UNITS: &[&str] = &[
    "timeunit",
    "timeunits",
    "expunit",
    "exptunit",
    "expunits",
    "exposureunit",
    "exposureunits",
    "exposuretimeunit",
];

const KINDS: &[&str] = &[
    "imagetyp",
    "typ",
    "type",
    "imagetype",
    "imgtype",
    "frametyp",
    "frametype",
    "obstype",
    "picttype",
    "kind",
    "art",
    "bildart",
    "bildtyp",
];

pub(super) fn plain(key: &str) -> String {
    key.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Extracts facts from named values; the result does not depend on their order.
pub fn facts(mut said: Vec<Said>, writer: Writer) -> Facts {
    said.sort();
    said.dedup();
    let mut out = Facts::default();
    exposure(&said, writer, &mut out);
    // Position of the first pixel in the pattern cell, column and row.
    let mut first = [0, 0];
    for Said { key, value, comment } in &said {
        if value.is_empty() {
            continue;
        }
        let word = plain(key);
        let number = values::number(value).0.one();
        let from = key.as_str();
        let mut note = |key: &str| out.from.insert(key.into(), from.into());
        match word.as_str() {
            "gaindb" | "verstärkungdb" => {
                out.gain_db = number.or(out.gain_db);
                note("gain_db");
            }
            "ccdtemp" | "temperaturec" | "dettemp" | "devicetemperature" | "sensortemperature"
            | "sensortemp" | "temperature" | "temp" => {
                // The letter K marks kelvin.
                let kelvin = values::number(value).1.eq_ignore_ascii_case("k");
                let celsius = number.map(|n| if kelvin { n - 273.15 } else { n });
                out.temperature_c = celsius.or(out.temperature_c);
                note("temperature_c");
            }
            "settemp" | "ccdsetp" | "settemperature" => {
                out.set_temperature_c = number.or(out.set_temperature_c)
            }
            "frame" if writer == Writer::Fits => kind_of(key, value, &mut out),
            word if KINDS.contains(&word) => kind_of(key, value, &mut out),
            "instrume" | "devicemodelname" | "cameramodel" => {
                out.model = Some(value.clone());
                note("model");
            }
            "camera" if out.model.is_none() => {
                out.model = Some(value.clone());
                note("model");
            }
            "devicevendorname" => out.vendor = Some(value.clone()),
            "deviceserialnumber" | "serialnumber" | "cameraserialnumber" | "serial" | "serno" => {
                out.serial = Some(value.clone())
            }
            "dateobs" | "datetime" | "creationtime" => out.time_s = headers::time_s(value).or(out.time_s),
            "illumination" => {
                out.illumination = number.or(out.illumination);
                note("illumination");
            }
            "filter" if writer != Writer::Lines => out.filter = Some(value.clone()),
            "roworder" => {
                let upper = value.to_uppercase();
                out.bottom_up = match (upper.contains("TOP-DOWN"), upper.contains("BOTTOM-UP")) {
                    (true, false) => Some(false),
                    (false, true) => Some(true),
                    _ => None,
                };
                note("rows");
            }
            "bayerpat" | "bayerpattern" | "colortyp" | "cfapattern" | "cfapat" | "pixelformat"
                if out.mosaic.is_none() =>
            {
                out.mosaic = pattern(value);
            }
            "biassec" if writer == Writer::Fits => out.bias_section = Some(value.clone()),
            // The sections are sorted by keyword, so TRIMSEC overrides DATASEC.
            "datasec" | "trimsec" if writer == Writer::Fits => {
                out.trim_section = Some((key.clone(), value.clone()));
            }
            "xbayroff" => first[0] = number.unwrap_or(0.0) as i64,
            "ybayroff" => first[1] = number.unwrap_or(0.0) as i64,
            "calstat" if value.contains(['B', 'D', 'F']) => {
                out.processed =
                    Some(format!("CALSTAT is {value}: bias (B), dark (D) or flat (F) are taken off already"));
            }
            word if DONE.contains(&word) && !is_no(value) => {
                out.processed =
                    Some(format!("{key} is {value}: the frame is a combined or corrected one already"));
            }
            "acqmode" | "acquisitionmode" if value.to_lowercase().contains("accumul") => {
                out.processed = Some(format!("{key} is {value}: several exposures were added up"));
            }
            "bunit" if value.to_lowercase().contains("electron") || value.contains('/') => {
                out.processed = Some(format!("{key} is {value}: these are no codes of the camera"));
            }
            "process" | "prodtype" if kinds::processed(value).is_some() => {
                out.processed = Some(format!("{key} is {value}: the frame is corrected already"));
            }
            "history" | "comment" if tells_of_a_correction(value) => {
                out.processed = Some(format!("{key} says \"{value}\": the frame is corrected already"));
            }
            "history" | "comment" if tells_of_a_combination(value) => {
                out.processed = Some(format!(
                    "{key} says \"{value}\": several exposures were combined, and their noise is not that of one frame"
                ));
            }
            word if COMBINED.contains(&word) && number.is_some_and(|n| n > 1.0) => {
                out.processed = Some(format!(
                    "{key} is {value}: that many exposures were combined, and their noise is not that of one frame"
                ));
            }
            _ => setting(key, &word, value, comment, writer, &mut out),
        }
    }
    out.mosaic = out.mosaic.map(|pattern| shifted(&pattern, first));
    // Zero is the exposure of a bias frame; for others it means unknown.
    out.zero_exposure = out.exposure_s == Some(0.0);
    if out.zero_exposure && !out.bias {
        out.exposure_s = None;
    }
    out
}

/// Parses the colour pattern in a header, also as a pixel format (`BayerRG12`); `None` for a monochrome
/// sensor.
pub(super) fn pattern(value: &str) -> Option<String> {
    let upper = value.trim().to_uppercase();
    const PATTERNS: [&str; 5] = ["RGGB", "BGGR", "GRBG", "GBRG", "CMYG"];
    let of_format = upper.strip_prefix("BAYER").and_then(|rest| rest.get(..2));
    let named = |p: &&&str| upper.contains(**p) || of_format.is_some_and(|start| p.starts_with(start));
    PATTERNS.iter().find(named).map(ToString::to_string)
}

/// Returns the pattern that begins at this column and row.
pub(super) fn shifted(pattern: &str, [x, y]: [i64; 2]) -> String {
    let colours: Vec<char> = pattern.chars().collect();
    let [a, b, c, d] = colours[..] else { return pattern.into() };
    let [a, b, c, d] = if x % 2 == 0 { [a, b, c, d] } else { [b, a, d, c] };
    if y % 2 == 0 { [a, b, c, d] } else { [c, d, a, b] }.iter().collect()
}

fn kind_of(key: &str, value: &str, out: &mut Facts) {
    let said = kinds::of(value);
    let of_stack = value.to_lowercase().split(|c: char| !c.is_alphabetic()).any(|w| w == "stack");
    let why = kinds::processed(value).or_else(|| of_stack.then(|| "it says \"stack\"".into()));
    if let Some(why) = why {
        out.processed = Some(format!("{key} is {value}: {why}"));
    }
    out.object |= said.object;
    let Some(kind) = said.kind.or(said.weak) else { return };
    match out.kind {
        Some(before) if before != kind => {
            let first = out.from.get("kind").cloned().unwrap_or_default();
            out.doubts.push(format!("kind: {first} says {before}, and {key} says {value}"));
        }
        _ => {
            out.set_kind(kind, &format!("{key} {value}"));
            out.bias = said.bias;
        }
    }
}

fn setting(key: &str, word: &str, value: &str, comment: &str, writer: Writer, out: &mut Facts) {
    let (reading, unit) = values::number(value);
    let text = reading.one().map_or_else(|| value.to_string(), |n| n.to_string());
    let about = comment.to_lowercase();
    if word == "gain" {
        // IRAF's GAIN is in electrons per code.
        if ["e-/", "e/", "electron"].iter().any(|w| about.contains(w)) {
            return out.set_feature("EGAIN", &text, key);
        }
        // ZWO counts in tenths of a decibel.
        let tenths = ["0.1", "tenth", "/10"].iter().any(|w| about.contains(w));
        let in_comment = about.split(|c: char| !c.is_alphabetic()).any(|w| w == "db") && !tenths;
        let db = unit.eq_ignore_ascii_case("db") || in_comment;
        if db || (writer == Writer::Json && key == "Gain") {
            out.gain_db = reading.one().or(out.gain_db);
            out.from.insert("gain_db".into(), key.into());
            return;
        }
        if writer == Writer::Lines && key == "Gain" {
            return out.set_feature("Gain", &text, key);
        }
    }
    if word == "ccdsum" {
        let parts: Vec<&str> = value.split_whitespace().collect();
        if let [x, y] = parts[..] {
            out.set_feature("BinningHorizontal", x, key);
            out.set_feature("BinningVertical", y, key);
        }
        return;
    }
    if word == "binning" {
        let parts: Vec<&str> = value.split(['x', 'X']).collect();
        let (x, y) = match parts[..] {
            [x, y] => (x.trim(), y.trim()),
            _ => (value, value),
        };
        out.set_feature("BinningHorizontal", x, key);
        out.set_feature("BinningVertical", y, key);
        return;
    }
    // GenICam features keep their own names; the pixel format is compared by its bits.
    if writer != Writer::Fits && key != "PixelFormat" && is_setting(key) {
        return out.set_feature(key, &text, key);
    }
    if let Some((feature, _)) = SETTINGS.iter().find(|(_, words)| words.contains(&word)) {
        out.set_feature(feature, &text, key);
    }
}

/// Extracts the exposure: all cards that state one must agree.
fn exposure(said: &[Said], writer: Writer, out: &mut Facts) {
    let of_header = said.iter().find(|s| UNITS.contains(&&*plain(&s.key))).and_then(|s| seconds(&s.value));
    let mut found: Vec<(usize, f64, bool, String)> = Vec::new();
    for Said { key, value, comment } in said {
        let (word, of_key) = values::split_unit(key);
        let Some(rank) = EXPOSURES.iter().position(|e| *e == word) else { continue };
        let (reading, rest) = values::fraction(value).unwrap_or_else(|| values::number(value));
        let text =
            if comment.is_empty() { format!("{key} {value}") } else { format!("{key} {value} ({comment})") };
        let unit = rest.trim_matches(|c: char| matches!(c, '[' | ']' | '(' | ')' | ' '));
        // A shutter value means open, closed or 1, unless it is a time.
        let is_fraction = values::fraction(value).is_some();
        if word == "shutter" && unit.is_empty() && of_key.is_none() && !is_fraction {
            continue;
        }
        let of_comment = values::unit_in(comment);
        if of_comment.is_err() && of_key.is_none() && seconds(unit).is_none() {
            out.doubts.push(format!(
                "exposure_s: the comment of {text} names two units, or one that is not readable"
            ));
            continue;
        }
        let genicam = match (writer, key.as_str()) {
            (Writer::Json, "ExposureTime") | (Writer::Json | Writer::Lines, "ExposureTimeAbs") => Some(1e-6),
            _ => None,
        };
        let fits = (writer == Writer::Fits).then_some(1.0);
        let stated = match unit {
            // Shutter speeds of photography are in seconds.
            "" if is_fraction => of_key.or(Some(1.0)),
            "" => of_key.or(of_comment.unwrap_or(None)).or(of_header),
            _ => seconds(unit),
        };
        let unit_s = if unit.is_empty() { stated.or(genicam).or(fits) } else { stated };
        match (reading, unit_s) {
            (Reading::One(n), Some(unit_s)) if n >= 0.0 => {
                let exposure_s = values::in_seconds(n, unit_s);
                // No camera exposes for so short a time by accident: the value is probably in seconds.
                if genicam.is_some() && stated.is_none() && n > 0.0 && n < 1.0 {
                    out.doubts
                        .push(format!("exposure_s: {text} is {exposure_s} s as GenICam has it, or {n} s"));
                    continue;
                }
                found.push((rank, exposure_s, stated.is_some() || genicam.is_some(), text));
            }
            (Reading::Two(a, b), _) => {
                let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
                out.doubts.push(format!("exposure_s: {text} is {a}{unit} or {b}{unit}"));
            }
            _ => {}
        }
    }
    // A text line that names another unit may refer to these times, or to others.
    let line = |s: &&Said| matches!(&*plain(&s.key), "comment" | "history") && tells_of_a_time(&s.value);
    let other = |s: &&Said| !matches!(values::unit_in(&s.value), Ok(None | Some(1.0)));
    if writer == Writer::Fits
        && found.iter().any(|f| !f.2)
        && let Some(said) = said.iter().filter(line).find(other)
    {
        out.doubts.push(format!(
            "exposure_s: {} states no unit, and {} says \"{}\"",
            found.iter().find(|f| !f.2).map_or("", |f| &f.3),
            said.key,
            said.value
        ));
    }
    // Zero is wrong if another card states more.
    if found.iter().any(|f| f.1 > 0.0) {
        found.retain(|f| f.1 > 0.0);
    }
    found.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then_with(|| a.3.cmp(&b.3)));
    let Some(first) = found.first() else { return };
    if let Some(other) = found.iter().find(|f| !same_exposure(f.1, first.1)) {
        out.doubts
            .push(format!("exposure_s: {} says {} s, and {} says {} s", first.3, first.1, other.3, other.1));
    } else if out.doubts.is_empty() {
        out.exposure_s = Some(first.1);
        out.unit_stated = first.2;
        out.from.insert("exposure_s".into(), first.3.clone());
    }
}

/// Parses a description: a JSON object, or `key = value` lines.
pub fn of_description(text: &str) -> Facts {
    let text = text.trim_matches(|c: char| c.is_whitespace() || c == '\0');
    if text.starts_with('{')
        && let Ok(json) = serde_json::from_str::<serde_json::Value>(text)
    {
        let mut said = Vec::new();
        flatten(&json, "", &mut said);
        return facts(said, Writer::Json);
    }
    // Semicolons separate the pairs of a line.
    let pairs = text.lines().flat_map(|line| line.split(';')).filter_map(|part| part.split_once(['=', ':']));
    facts(pairs.map(|(k, v)| Said::new(k, v.trim().trim_matches('\''))).collect(), Writer::Lines)
}

/// Flattens a JSON object and nested objects, by their own names. A value with its unit (`{"value": 5,
/// "unit": "ms"}`) is kept together.
fn flatten(json: &serde_json::Value, key: &str, out: &mut Vec<Said>) {
    match json {
        serde_json::Value::Object(inside) => {
            let text = |v: &serde_json::Value| v.as_str().map_or_else(|| v.to_string(), Into::into);
            let part = |names: &[&str]| {
                inside.iter().find(|(k, _)| names.contains(&&*k.to_lowercase())).map(|(_, v)| text(v))
            };
            // Micro-Manager 2 stores a value as PropVal.
            if let Some(value) = part(&["value", "propval"]) {
                let unit = part(&["unit", "units"]).unwrap_or_default();
                out.push(Said::new(key, &format!("{value} {unit}")));
                return;
            }
            inside.iter().for_each(|(k, v)| flatten(v, k, out));
        }
        serde_json::Value::String(text) => out.push(Said::new(key, text)),
        serde_json::Value::Number(number) => out.push(Said::new(key, &number.to_string())),
        serde_json::Value::Bool(on) => out.push(Said::new(key, &on.to_string())),
        _ => {}
    }
}

/// Extracts facts from FITS cards.
pub fn of_cards(cards: Vec<super::cards::Card>) -> Facts {
    let said = cards.into_iter().map(|c| Said { key: c.key, value: c.value, comment: c.comment });
    facts(said.collect(), Writer::Fits)
}

/// Returns true if a header line mentions exposures.
fn tells_of_a_time(line: &str) -> bool {
    let words = ["exposure", "exposures", "exptime", "exposed", "integration", "shutter", "times"];
    line.to_lowercase().split(|c: char| !c.is_alphabetic()).any(|word| words.contains(&word))
}

/// Returns true if a history line of a header states that a dark, bias or flat was applied: `Auto-Dark
/// Subtraction` of CCDSoft, `Bias Subtraction` of MaxIm DL, `flat fielded`.
fn tells_of_a_correction(line: &str) -> bool {
    let line = line.to_lowercase();
    let names = |words: &[&str]| words.iter().any(|w| line.contains(w));
    names(&["dark", "bias", "zero", "flat"])
        && names(&["subtract", "divid", "correct", "calibrat", "fielded"])
        && !line.split_whitespace().any(|w| w == "not" || w == "no")
}

/// Returns true if a history line of a header states that several exposures were combined: `imcombine:
/// average of 8`, `Stacking result of 10 images`.
fn tells_of_a_combination(line: &str) -> bool {
    const WORDS: [&str; 8] = [
        "imcombine",
        "combined",
        "coadded",
        "co-added",
        "averaged",
        "average of",
        "stack of",
        "stacking result",
    ];
    let line = line.to_lowercase();
    WORDS.iter().any(|w| line.contains(w)) && !line.split_whitespace().any(|w| w == "not" || w == "no")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Kind;
    use proptest::prelude::*;

    fn fits(cards: &[(&str, &str, &str)]) -> Facts {
        let said = |c: &(&str, &str, &str)| Said { comment: c.2.into(), ..Said::new(c.0, c.1) };
        facts(cards.iter().map(said).collect(), Writer::Fits)
    }

    #[test]
    fn descriptions_say_what_they_say() {
        let found = of_description("ImageJ=1.53t\nimages=3\nexposure_ms=12.5\nkind: dark frame");
        assert_eq!((found.exposure_s, found.kind), (Some(0.0125), Some(Kind::Dark)));
        assert_eq!(of_description("Exposure = 20 ms").exposure_s, Some(0.02));
        assert_eq!(of_description("exposure_ms=12,5\ngain_db=6,5").exposure_s, Some(0.0125));
        assert_eq!(of_description("exposure_ms=12,5\ngain_db=6,5").gain_db, Some(6.5));
        // Seconds, milliseconds or microseconds?
        assert_eq!(of_description("ExposureTime = 5000").exposure_s, None);
        assert_eq!(of_description("Exposure: 20").exposure_s, None);
        let json = of_description(r#"{"a": {"ExposureTime": 5000.0, "Gain": 6, "BlackLevel": 64}}"#);
        assert_eq!(
            (json.exposure_s, json.gain_db, json.feature("BlackLevel")),
            (Some(0.005), Some(6.0), Some("64"))
        );
        let json = of_description(r#"{"exposure": {"value": 5, "unit": "ms"}, "Exposure-ms": 5}"#);
        assert_eq!(json.exposure_s, Some(0.005));
        let seconds = of_description(r#"{"ExposureTime": 0.005}"#);
        assert!(seconds.exposure_s.is_none() && seconds.doubts[0].contains("0.005 s"));
    }

    #[test]
    fn units_of_fits_are_heeded() {
        for (cards, exposure_s) in [
            (vec![("EXPTIME", "0.25", ""), ("CCD-TEMP", "-10.0", "")], Some(0.25)),
            (vec![("EXPTIME", "100", "exposure time in ms")], Some(0.1)),
            (vec![("TIMEUNIT", "ms", ""), ("XPOSURE", "100", "")], Some(0.1)),
            (vec![("EXPTIME", "0.1", "[s]"), ("EXPOSURE", "100", "[ms]")], Some(0.1)),
            (vec![("EXPTIME", "3,2E-05", ""), ("EXPOINUS", "32", "Exposure time in us")], Some(3.2e-5)),
            (vec![("EXPTIME", "0.0", ""), ("EXPOINUS", "32", "")], Some(3.2e-5)),
            (vec![("EXPTIME", "0.1", ""), ("EXPOSURE", "100", "")], None),
            (vec![("EXPTIME", "-1", "")], None),
            (vec![("EXPTIME", "0", ""), ("IMAGETYP", "Flat", "")], None),
            (vec![("EXPTIME", "0", ""), ("IMAGETYP", "Bias Frame", "")], Some(0.0)),
            (vec![("EXPTIME", "12,500", "")], None),
            (vec![("EXPTIME", "100", "ms or s")], None),
            (vec![("SHUTTER", "1/400", "")], Some(0.0025)),
            (vec![("EXPTIME", "1/400 s", "")], Some(0.0025)),
            (vec![("SHUTTER", "1", "open")], None),
            (vec![("EXPTIME", "25", ""), ("COMMENT", "exposure time in milliseconds", "")], None),
            (vec![("EXPTIME", "25", "[ms]"), ("COMMENT", "exposure time in milliseconds", "")], Some(0.025)),
            (vec![("EXPTIME", "25", ""), ("COMMENT", "times are in s", "")], Some(25.0)),
            (vec![("EXPTIME", "25", ""), ("COMMENT", "long exposure, 3 ms after the trigger", "")], None),
        ] {
            assert_eq!(fits(&cards).exposure_s, exposure_s, "{cards:?}");
        }
        assert!(fits(&[("EXPTIME", "0.1", ""), ("EXPOSURE", "100", "")]).doubts[0].contains("EXPOSURE 100"));
    }

    #[test]
    fn what_is_no_raw_frame_says_so() {
        for card in [
            ("CALSTAT", "BD", ""),
            ("HISTORY", "Auto-Dark Subtraction", ""),
            ("HISTORY", "Bias Subtraction (Bias 4, 1529 x 1032, Bin2 x 2)", ""),
            ("STACKCNT", "16", ""),
            ("NCOMBINE", "16", ""),
            ("SNAPSHOT", "4", "number of images combined"),
            ("DARKCOR", "Jan 1 dark.fits", ""),
            ("IMAGETYP", "Master Dark", ""),
            ("IMAGETYP", "flat (stack)", ""),
            ("COMBINED", "T", ""),
            ("IMCMB001", "flat1.fits", ""),
            ("NUMACC", "10", ""),
            ("ACQMODE", "Accumulate", ""),
            ("BUNIT", "electron", ""),
            ("DARKFILE", "md.fits", ""),
            ("HISTORY", "imcombine: average of 8", ""),
            ("COMMENT", "stack of 10 frames", ""),
        ] {
            assert!(fits(&[card]).processed.is_some(), "{card:?}");
        }
        for card in [
            ("HISTORY", "dark frame taken", ""),
            ("HISTORY", "Dark Subtraction: no", ""),
            ("CALSTAT", "", ""),
            ("STACKCNT", "1", ""),
            ("NCOMBINE", "0", ""),
            ("DARKCOR", "F", ""),
            ("COMBINED", "F", ""),
            ("NUMACC", "1", ""),
            ("ACQMODE", "Single", ""),
            ("BUNIT", "ADU", ""),
            ("SHADING", "Off", ""),
        ] {
            assert!(fits(&[card]).processed.is_none(), "{card:?}");
        }
        assert_eq!(fits(&[("GAIN", "120", "[0.1 dB]")]).feature("GainRaw"), Some("120"));
        assert_eq!(fits(&[("GAIN", "6", "gain in dB")]).gain_db, Some(6.0));
        assert_eq!(fits(&[("EXPTIME", "100", ""), ("EXPUNIT", "ms", "")]).exposure_s, Some(0.1));
        assert_eq!(fits(&[("GAIN", "0.38", "[e-/ADU]")]).feature("EGAIN"), Some("0.38"));
        assert_eq!(fits(&[("BAYERPAT", "RGGB", "")]).mosaic.as_deref(), Some("RGGB"));
        assert_eq!(fits(&[("BAYERPAT", "RGGB", ""), ("XBAYROFF", "1", "")]).mosaic.as_deref(), Some("GRBG"));
        assert_eq!(of_description("PixelFormat: BayerGB12").mosaic.as_deref(), Some("GBRG"));
        assert_eq!(of_description("PixelFormat: Mono12").mosaic, None);
    }

    proptest! {
        #[test]
        fn the_order_of_a_header_says_nothing(
            cards in Just(vec![
                ("EXPTIME", "0.1", "[s]"), ("EXPOSURE", "100", "[ms]"), ("IMAGETYP", "Dark", ""), ("FRAME", "Dark", ""),
                ("GAIN", "120", ""), ("OFFSET", "10", ""), ("BLKLEVEL", "20", ""), ("INSTRUME", "A/B", ""),
                ("CAMERA", "C", ""), ("CCD-TEMP", "-10", ""), ("DET-TEMP", "-9", ""),
            ]).prop_shuffle(),
        ) {
            let first = fits(&[
                ("BLKLEVEL", "20", ""), ("CAMERA", "C", ""), ("CCD-TEMP", "-10", ""), ("DET-TEMP", "-9", ""),
                ("EXPOSURE", "100", "[ms]"), ("EXPTIME", "0.1", "[s]"), ("FRAME", "Dark", ""), ("GAIN", "120", ""),
                ("IMAGETYP", "Dark", ""), ("INSTRUME", "A/B", ""), ("OFFSET", "10", ""),
            ]);
            prop_assert_eq!(fits(&cards), first);
        }

        #[test]
        fn no_description_makes_it_panic(text in "\\PC{0,60}") {
            let _ = of_description(&text);
        }
    }
}
