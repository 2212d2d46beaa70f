//! Effects of the features of real cameras on pixel values.
//!
//! Names are those of the Standard Features Naming Convention (SFNC 2.7) and of the makers whose description
//! files were read. An unlisted feature whose name suggests radiometry is recorded with its value, and the
//! capture warns of it ([`suspicious`]).

use std::fmt;

/// Value of a feature that has no method of its own.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// Boolean.
    Bool(bool),
    /// Integer.
    Int(i64),
    /// Floating point.
    Float(f64),
    /// String or enumeration entry.
    Text(String),
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Bool(v) => v.fmt(f),
            Value::Int(v) => v.fmt(f),
            Value::Float(v) => v.fmt(f),
            Value::Text(v) => v.fmt(f),
        }
    }
}

impl From<Value> for toml::Value {
    fn from(value: Value) -> Self {
        match value {
            Value::Bool(v) => v.into(),
            Value::Int(v) => v.into(),
            Value::Float(v) => v.into(),
            Value::Text(v) => v.into(),
        }
    }
}

/// Value at which a feature leaves the image unchanged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Neutral {
    /// False, 0, or the entry for off (`Off`, `Disabled`, `None`).
    Off,
    /// True.
    On,
    /// This number.
    Number(f64),
    /// This entry; a camera without it means something else by the name.
    Entry(&'static str),
}

/// Relation of a feature to radiometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    /// Changes pixel values: set to its neutral value before a capture. Left on, it acts like these effects.
    Distorts(Neutral, &'static [&'static str]),
    /// Setting under which a calibration holds: recorded.
    Setting,
    /// Selection and combination of the pixels read: recorded; a calibration holds for its own geometry only.
    Geometry,
    /// No effect on the codes that radcam reads, for this reason.
    Harmless(&'static str),
}

use Neutral::{Entry, Number, Off, On};
use Role::{Distorts, Geometry, Harmless, Setting};

/// Curves of any kind.
const CURVE: &[&str] = &["nonlinearity", "companding"];
/// Filters over neighbours.
const FILTER: &[&str] = &["spatial-filter"];
/// Filters over neighbours or frames.
const DENOISE: &[&str] = &["spatial-filter", "temporal-filter"];
/// Single pixels replaced by their neighbours.
const DEFECTS: &[&str] = &["random-telegraph-noise"];
/// Black level that follows the image.
const BLACK: &[&str] = &["offset-drift", "row-noise", "column-noise", "black-clipping"];
/// Gain that follows the image.
const GAIN: &[&str] = &["gain-drift", "illumination-setting"];
/// Exposure that follows the image.
const EXPOSURE: &[&str] = &["illumination-setting", "illumination-drift", "exposure-offset"];
/// Factor of every pixel.
const SHADING: &[&str] = &["tap-mismatch"];
/// Codes that are no measurement.
const PATTERN: &[&str] = &[];

const COLOUR: Role = Harmless("acts on RGB and YUV, which radcam does not read");
const FOLLOWS: Role = Harmless("acts only with a feature that is switched off");
const SELECTS: Role = Harmless("says which entry another feature means");
const STATUS: Role = Harmless("tells and changes nothing");
const TIMING: Role = Harmless("when frames are read, not what is in them");
const EVENT: Role = Harmless("a message beside the image");

/// Known features, in the order of bytes, for a binary search: capitals before small letters.
const KNOWN: &[(&str, Role)] = &[
    ("ADC_range", Setting),
    ("ALC_Intensifier_Gain", Setting),
    ("ALC_Min_intensifier_gain", Setting),
    ("ALC_V_Gain", Setting),
    ("ASYNCDIRECTSHUTTER", Setting),
    ("ASYNCDIRECTSHUTTERVALUE", Setting),
    ("AUTOBLACKLEVELFLAG", Harmless("the register behind AutoBlackLevelStatus")),
    ("AcquisitionFrameRate", TIMING),
    ("AcquisitionFrameRateAuto", TIMING),
    ("AcquisitionFrameRateEnable", TIMING),
    ("AcquisitionFrameRateEnabled", TIMING),
    ("AdcBitDepth", Setting),
    ("AsyncDirectShutter", Setting),
    ("AutoAlgorithmSelector", SELECTS),
    ("AutoBlackLevelStatus", Distorts(Off, BLACK)),
    ("AutoBlackLevelValue", Setting),
    ("AutoFunctionProfile", FOLLOWS),
    ("AutoTargetValue", FOLLOWS),
    ("BalanceRatio", Setting),
    ("BalanceRatioAbs", Setting),
    ("BalanceRatioAuto", Distorts(Off, GAIN)),
    ("BalanceRatioRaw", Setting),
    ("BalanceRatioSelector", SELECTS),
    ("BalanceWhiteAuto", Distorts(Off, GAIN)),
    ("BalanceWhiteAutoProfile", FOLLOWS),
    ("BalanceWhiteMode", Distorts(Entry("Manual"), GAIN)),
    ("Binning", Geometry),
    ("BinningHorizontal", Geometry),
    ("BinningHorizontalMode", Geometry),
    ("BinningMode", Geometry),
    ("BinningSelector", SELECTS),
    ("BinningVertical", Geometry),
    ("BinningVerticalMax", STATUS),
    ("BinningVerticalMode", Geometry),
    ("BlackLevel", Setting),
    ("BlackLevelAuto", Distorts(Off, BLACK)),
    ("BlackLevelAutoBalance", Distorts(Off, BLACK)),
    ("BlackLevelClampingEnable", Distorts(Off, BLACK)),
    ("BlackLevelEnabled", Setting),
    ("BlackLevelRaw", Setting),
    ("BlackLevelSelector", SELECTS),
    ("BlackLevelValue", Setting),
    ("Bright", Setting),
    ("Bright_Pixel_Corection", Distorts(Off, DEFECTS)),
    ("BrightnessCorrection", Distorts(Off, GAIN)),
    ("CCD_TEMPERATURE", STATUS),
    ("ChunkModeActive", Harmless("data beside the image")),
    ("ColorAdjustmentHue", COLOUR),
    ("ColorAdjustmentHueRaw", COLOUR),
    ("ColorAdjustmentSaturation", COLOUR),
    ("ColorAdjustmentSaturationRaw", COLOUR),
    ("ColorEnhancementEnable", Distorts(Off, CURVE)),
    ("ColorEnhancementHysteresisWidth", FOLLOWS),
    ("ColorEnhancementThreshold", FOLLOWS),
    ("ColorTransformationEnable", Distorts(Off, CURVE)),
    ("ColorTransformationMatrixFactor", COLOUR),
    ("ColorTransformationMatrixFactorRaw", COLOUR),
    ("ColorTransformationMode", Distorts(Entry("Off"), CURVE)),
    ("ColorTransformationSelector", SELECTS),
    ("ColorTransformationValue", COLOUR),
    ("ColorTransformationValueRaw", COLOUR),
    ("ColorTransformationValueSelector", SELECTS),
    ("CriticalTemperatureEventStreamChannelIndex", EVENT),
    ("CriticalTemperatureEventTimestamp", EVENT),
    ("CurrentTemperature", STATUS),
    ("DSNUCorrectionEnable", Distorts(Off, SHADING)),
    ("DecimationHorizontal", Geometry),
    ("DecimationHorizontalMode", Geometry),
    ("DecimationSelector", SELECTS),
    ("DecimationVertical", Geometry),
    ("DecimationVerticalMode", Geometry),
    ("DefectCorrectDynamicEnable", Distorts(Off, DEFECTS)),
    ("DefectCorrectStaticEnable", Distorts(Off, DEFECTS)),
    ("DefectCorrectionMode", Distorts(Entry("Off"), DEFECTS)),
    ("DefectMaskColumnEnable", Distorts(Off, DEFECTS)),
    ("DefectMaskPixelEnable", Distorts(Off, DEFECTS)),
    ("DefectPixelCorrection", Distorts(Off, DEFECTS)),
    ("DefectPixelCorrectionEnable", Distorts(Off, DEFECTS)),
    ("DefectPixelCorrectionEnable_Control", Distorts(Off, DEFECTS)),
    ("DefectPixelCorrectionMark_Control", Distorts(Off, DEFECTS)),
    ("DefectPixelCorrectionMode", Distorts(Entry("Off"), DEFECTS)),
    ("DefectPixelCorrection_MapIndex", FOLLOWS),
    ("DefectPixelCorrection_MapSelect", FOLLOWS),
    ("DefectPixelCorrection_MapSize", FOLLOWS),
    ("DefectPixelCorrection_OffsetX", FOLLOWS),
    ("DefectPixelCorrection_OffsetY", FOLLOWS),
    ("DefectPixelCorrection_X", FOLLOWS),
    ("DefectPixelCorrection_Y", FOLLOWS),
    ("DefectTableCoordinateX", FOLLOWS),
    ("DefectTableCoordinateY", FOLLOWS),
    ("DefectTableIndex", SELECTS),
    ("DefectTablePixelCount", FOLLOWS),
    ("DenoiseMode", Distorts(Entry("Off"), DENOISE)),
    ("DeviceTemperature", STATUS),
    ("DeviceTemperatureSelector", SELECTS),
    ("DigitalShift", Distorts(Number(0.0), &["coarse-quantization"])),
    // FITS keyword: electrons per code.
    ("EGAIN", Setting),
    ("EdgeEnhancement", Distorts(Off, FILTER)),
    ("EdgeFilter", Distorts(Off, FILTER)),
    ("ExposureActiveMode", Harmless("says when an output line is high")),
    ("ExposureAuto", Distorts(Off, EXPOSURE)),
    ("ExposureAutoHighlighReduction", FOLLOWS),
    ("ExposureCompensation", FOLLOWS),
    ("ExposureCompensationAuto", Distorts(Off, EXPOSURE)),
    ("ExposureCompensationEnable", Distorts(Off, EXPOSURE)),
    ("ExposureEndEventFrameID", EVENT),
    ("ExposureEndEventStreamChannelIndex", EVENT),
    ("ExposureEndEventTimestamp", EVENT),
    ("ExposureMode", Distorts(Entry("Timed"), EXPOSURE)),
    ("ExposureOverlapTimeMaxAbs", TIMING),
    ("ExposureOverlapTimeMaxRaw", TIMING),
    ("ExposureTime", Setting),
    ("ExposureTimeAbs", Setting),
    ("ExposureTimeBaseAbs", Setting),
    ("ExposureTimeBaseAbsEnable", Setting),
    ("ExposureTimeMax", STATUS),
    ("ExposureTimeMin", STATUS),
    ("ExposureTimeRaw", Setting),
    ("ExposureValue", STATUS),
    ("FfcEnable", Distorts(Off, SHADING)),
    ("FfcMode", Distorts(Entry("Off"), SHADING)),
    ("FfcUserGain", Setting),
    ("FfcUserOffset", Setting),
    ("FfcUserTableXCoordinate", SELECTS),
    ("FlatFieldCorrectionMode", Distorts(Entry("Off"), SHADING)),
    ("Flat_Field_Correction", Distorts(Off, SHADING)),
    ("Gain", Setting),
    ("GainAbs", Setting),
    ("GainAuto", Distorts(Off, GAIN)),
    ("GainAutoBalance", Distorts(Off, GAIN)),
    ("GainAutoLevel", FOLLOWS),
    ("GainFactor", Setting),
    ("GainRaw", Setting),
    ("GainRawChannelA", Setting),
    ("GainRawChannelB", Setting),
    ("GainSelector", SELECTS),
    ("GainValue", Setting),
    ("Gamma", Distorts(Number(1.0), CURVE)),
    ("GammaEnable", Distorts(Off, CURVE)),
    ("GammaEnabled", Distorts(Off, CURVE)),
    ("GammaSelector", SELECTS),
    ("Gamma_gain_bright", FOLLOWS),
    ("Gamma_gain_dark", FOLLOWS),
    ("Gamma_sel", Distorts(Entry("one"), CURVE)),
    ("Global_Shutter", Geometry),
    ("HDREnable", Distorts(Off, CURVE)),
    ("HDRIndex", FOLLOWS),
    ("HDRPotentialAbs", FOLLOWS),
    ("HighResolutionEnable", Distorts(Off, FILTER)),
    ("Hue", COLOUR),
    ("HueAuto", Distorts(Off, CURVE)),
    ("HueEnabled", Distorts(Off, CURVE)),
    ("IMX174HardwareWDREnable", Distorts(Off, CURVE)),
    ("IMX174WDRShutter2", FOLLOWS),
    // EXIF and FITS: sensitivity.
    ("ISO", Setting),
    ("KNEEX2VALUE", FOLLOWS),
    ("KneeX1", FOLLOWS),
    ("KneeX2", FOLLOWS),
    ("KneeY1", FOLLOWS),
    ("KneeY2", FOLLOWS),
    ("LUTBitDepthIn", FOLLOWS),
    ("LUTBitDepthOut", FOLLOWS),
    ("LUTEnable", Distorts(Off, CURVE)),
    ("LUTInversion", Distorts(Entry("Positive"), CURVE)),
    ("LUTMode", Distorts(Entry("Linear"), CURVE)),
    ("LUTSelector", SELECTS),
    ("LegacyBinningVertical", Geometry),
    ("MANUALDIRECTSHUTTER", Setting),
    ("MANUALDIRECTSHUTTERVALUE", Setting),
    ("ManualDirectShutter", Setting),
    ("NoiseReduction", Distorts(Off, DENOISE)),
    ("NoiseReductionEnable", Distorts(Off, DENOISE)),
    ("NoiseReductionMode", Distorts(Entry("Off"), DENOISE)),
    ("Noisefilter", Distorts(Off, DENOISE)),
    ("OffsetAutoCenter", Distorts(Off, PATTERN)),
    ("OffsetX", Geometry),
    ("OffsetY", Geometry),
    ("Offset_Correction", Distorts(Off, BLACK)),
    ("OverTemperatureEventStreamChannelIndex", EVENT),
    ("OverTemperatureEventTimestamp", EVENT),
    ("OverheatTemperature", STATUS),
    // FITS keyword: codes added after a correction.
    ("PEDESTAL", Setting),
    ("PGR_HDRImageSelector", SELECTS),
    ("PGR_HDRModeEnabled", Distorts(Off, EXPOSURE)),
    ("PGR_HDR_ExposureTimeAbs", FOLLOWS),
    ("PGR_HDR_GainAbs", FOLLOWS),
    ("PLD_TEMPERATURE", STATUS),
    ("POSNEGLUTFLAG", Harmless("the register behind LUTInversion")),
    ("PRNUCorrectionEnable", Distorts(Off, SHADING)),
    ("PixelColorFilter", STATUS),
    ("PixelCorrectionMode", Distorts(Entry("Off"), DEFECTS)),
    ("PixelDynamicRangeMax", STATUS),
    ("PixelDynamicRangeMin", STATUS),
    ("PixelFormat", Setting),
    ("PvGainRaw", Setting),
    // FITS keywords: mode of the read-out, and direction of the rows (upwards or not).
    ("READOUTM", Setting),
    ("ROWORDER", Geometry),
    ("ReadOutTime", TIMING),
    ("ReadoutControl", TIMING),
    ("ReadoutDelay", TIMING),
    ("ReadoutMode", TIMING),
    ("ReadoutTimeAbs", TIMING),
    ("ReverseX", Geometry),
    ("ReverseY", Geometry),
    ("Saturation", COLOUR),
    ("SaturationAuto", Distorts(Off, CURVE)),
    ("SaturationEnable", Distorts(Off, CURVE)),
    ("SaturationEnabled", Distorts(Off, CURVE)),
    ("SensorAutoClampingDisable", Distorts(On, BLACK)),
    ("SensorDigitizationTaps", Geometry),
    ("SensorShutterMode", Geometry),
    ("ShadingCorrectionMode", Distorts(Entry("Off"), SHADING)),
    ("Shading_Control", Distorts(Off, SHADING)),
    ("Shading_Status", STATUS),
    ("Sharpening", FOLLOWS),
    ("SharpeningAuto", Distorts(Off, FILTER)),
    ("SharpeningEnable", Distorts(Off, FILTER)),
    ("SharpeningMode", Distorts(Entry("Off"), FILTER)),
    ("SharpeningThreshold", FOLLOWS),
    ("Sharpness", Distorts(Number(0.0), FILTER)),
    ("SharpnessAuto", Distorts(Off, FILTER)),
    ("SharpnessEnable", Distorts(Off, FILTER)),
    ("SharpnessEnabled", Distorts(Off, FILTER)),
    ("Shutter", Setting),
    ("ShutterMode", Setting),
    ("SlowShutter", Distorts(Entry("Manual"), EXPOSURE)),
    ("SpatialNoiseReductionEnable", Distorts(Off, FILTER)),
    ("TemperatureAbs", STATUS),
    ("TemperatureSelector", SELECTS),
    ("TemporalNoiseReductionEnable", Distorts(Off, &["temporal-filter"])),
    ("TestImageSelector", Distorts(Off, PATTERN)),
    ("TestPattern", Distorts(Off, PATTERN)),
    ("TestPatternGeneratorSelector", SELECTS),
    ("TonalityAuto", Distorts(Off, CURVE)),
    ("VideoGain", Setting),
    ("WDRBlockedUp", FOLLOWS),
    ("WDRBlownOut", FOLLOWS),
    ("WDRDetectionSensitivity", FOLLOWS),
    ("WDRExposureRatio", FOLLOWS),
    ("WDRImageMode", FOLLOWS),
    ("WDRMode", Distorts(Off, CURVE)),
    ("combining_relative_gain", Setting),
    ("pgrDefectPixelCorrectionEnable", Distorts(Off, DEFECTS)),
    ("pgrDefectPixelCorrectionTestMode", Distorts(Off, DEFECTS)),
    ("pgrExposureCompensation", FOLLOWS),
    ("pgrExposureCompensationAuto", Distorts(Off, EXPOSURE)),
    ("pgrHDRImageSelector", SELECTS),
    ("pgrHDRModeEnabled", Distorts(Off, EXPOSURE)),
    ("pgrHDR_ExposureTimeAbs", FOLLOWS),
    ("pgrHDR_GainAbs", FOLLOWS),
];

/// Returns the role of a feature; `None` if it is not listed.
pub fn role(name: &str) -> Option<Role> {
    KNOWN.binary_search_by(|(known, _)| (*known).cmp(name)).ok().map(|at| KNOWN[at].1)
}

/// Returns every feature that has a role, by its GenICam name.
pub fn known() -> impl Iterator<Item = (&'static str, Role)> {
    KNOWN.iter().copied()
}

/// Returns the effects that a feature resembles if it is left on; empty if it is not known.
pub fn acts_like(name: &str) -> &'static [&'static str] {
    match role(name) {
        Some(Distorts(_, effects)) => effects,
        _ => &[],
    }
}

/// Type of a feature's value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// True or false.
    Boolean,
    /// One of some names.
    Enumeration,
    /// Whole number.
    Integer,
    /// Number.
    Float,
    /// Text.
    Text,
}

/// Returns the value at which a feature of this kind, with these entries, leaves the image unchanged. `None`
/// if this camera means something else by the name, or has no such value: the feature is then a setting.
pub fn neutral_value(neutral: Neutral, kind: Kind, entries: &[String]) -> Option<Value> {
    let number = |value: f64| match kind {
        Kind::Boolean => Some(Value::Bool(value != 0.0)),
        Kind::Integer => Some(Value::Int(value as i64)),
        Kind::Float => Some(Value::Float(value)),
        Kind::Enumeration | Kind::Text => None,
    };
    let one_of = |wanted: &[&str]| {
        let entry = wanted.iter().find(|w| entries.iter().any(|e| e == **w))?;
        Some(Value::Text((*entry).to_string()))
    };
    match neutral {
        Neutral::Off | Neutral::Entry("Off") if kind == Kind::Enumeration => one_of(&OFF_ENTRIES),
        Neutral::Off => number(0.0),
        Neutral::On => number(1.0),
        Neutral::Number(value) => number(value),
        Neutral::Entry(entry) => one_of(&[entry]),
    }
}

/// Returns true if a value, as text, means off.
fn is_off(value: &str) -> bool {
    OFF_ENTRIES.contains(&value) || matches!(value, "false" | "0")
}

/// Entries of enumerations that switch something off, as makers write them.
const OFF_ENTRIES: [&str; 8] = ["Off", "OFF", "off", "Disabled", "Disable", "disable", "None", "False"];

/// Returns true if a value may mean on. An enumeration without an entry for off is no switch.
fn may_be_on(value: &str) -> bool {
    matches!(value, "true" | "On" | "ON" | "Enabled" | "Enable" | "Continuous" | "Once" | "Auto")
        || value.parse::<f64>().is_ok_and(|v| v != 0.0)
}

/// A feature that changes pixel values and was not neutral while frames were taken.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LeftOn {
    /// GenICam name.
    pub feature: String,
    /// Value, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub value: Option<String>,
    /// Effects that the feature resembles; empty if unknown.
    pub acts_like: Vec<String>,
}

impl std::fmt::Display for LeftOn {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.feature)?;
        self.value.as_ref().map_or(Ok(()), |value| write!(f, " = {value}"))
    }
}

/// Returns the features left on: those whose value, as read back, is not neutral, and the `named` ones, which
/// could not be switched off.
pub fn left_on(values: &std::collections::BTreeMap<String, String>, named: &[String]) -> Vec<LeftOn> {
    let acting = |name: &str| !is_disabled(name, |enable| values.get(enable).cloned());
    let seen = values.iter().filter(|(name, value)| {
        let neutral = match role(plain(name)) {
            Some(Distorts(Off, _)) => is_off(value) || !may_be_on(value),
            Some(Distorts(On, _)) => matches!(value.as_str(), "true" | "1"),
            Some(Distorts(Number(to), _)) => value.parse::<f64>().is_ok_and(|v| (v - to).abs() < 1e-6),
            // A camera may mean something else by the name.
            _ => true,
        };
        !neutral && acting(name)
    });
    let mut names: Vec<&String> = named.iter().filter(|name| acting(name)).collect();
    names.extend(seen.map(|(name, _)| name));
    names.sort();
    names.dedup();
    let of = |name: &String| LeftOn {
        feature: name.clone(),
        value: values.get(name).cloned(),
        acts_like: acts_like(plain(name)).iter().map(ToString::to_string).collect(),
    };
    names.into_iter().map(of).collect()
}

/// Returns true if a calibration holds for one value of a feature only. The exposure is a setting of every
/// frame and is recorded with it; a value that follows the image is no setting.
pub fn is_setting(name: &str) -> bool {
    let name = plain(name);
    let exposure =
        name.starts_with("ExposureTime") || name.to_lowercase().contains("shutter") || name == "Bright";
    let global = matches!(name, "Global_Shutter" | "SensorShutterMode");
    role(name).is_some_and(|r| !matches!(r, Harmless(_)))
        && (!exposure || global)
        && name != "AutoBlackLevelValue"
}

/// Returns true if two values of a feature, as text, are the same: `1` and `1.0` are.
pub fn same_value(a: &str, b: &str) -> bool {
    let plain = |v: &str| v.trim_matches('"').to_string();
    match (plain(a).parse::<f64>(), plain(b).parse::<f64>()) {
        (Ok(a), Ok(b)) => (a - b).abs() <= 1e-6 * a.abs().max(b.abs()),
        _ => plain(a) == plain(b),
    }
}

/// Returns a name without the entry of its selector.
fn plain(name: &str) -> &str {
    name.split_once('[').map_or(name, |(name, _)| name)
}

/// Returns true if a feature has a switch of its own (`GammaEnable` of `Gamma`) that is off.
pub fn is_disabled(name: &str, value_of: impl Fn(&str) -> Option<String>) -> bool {
    let entry = &name[plain(name).len()..];
    let switch = |end: &str| {
        let of_entry = format!("{}{end}{entry}", plain(name));
        value_of(&of_entry).or_else(|| value_of(&format!("{}{end}", plain(name))))
    };
    ["Enable", "Enabled"].iter().any(|end| switch(end).is_some_and(|v| is_off(&v)))
}

/// Returns true if the name of an unlisted feature suggests radiometry.
pub fn suspicious(name: &str) -> bool {
    const WORDS: [&str; 37] = [
        "gain",
        "gamma",
        "exposure",
        "shutter",
        "black",
        "clamp",
        "lut",
        "knee",
        "hdr",
        "wdr",
        "dynamicrange",
        "correct",
        "filter",
        "noise",
        "sharp",
        "edge",
        "defect",
        "hotpixel",
        "shading",
        "flatfield",
        "ffc",
        "balance",
        "saturation",
        "hue",
        "bright",
        "contrast",
        "tone",
        "tonal",
        "enhance",
        "binning",
        "decimation",
        "testpattern",
        "testimage",
        "dsnu",
        "prnu",
        "fpn",
        "companding",
    ];
    let plain: String = name.to_lowercase().chars().filter(|c| c.is_alphanumeric()).collect();
    role(name).is_none() && WORDS.iter().any(|word| plain.contains(word))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_is_in_order_and_names_effects_that_are() {
        assert!(KNOWN.is_sorted_by(|a, b| a.0 < b.0));
        for (name, role) in known() {
            if let Distorts(_, effects) = role {
                for id in effects {
                    assert!(radcam_sim::effects::find(id).is_some(), "{name}: {id}");
                }
            }
        }
        let values =
            [("Gamma", "0.6"), ("GammaEnable", "false"), ("LUTEnable[LUT1]", "true"), ("TestPattern", "Off")];
        let values = values.map(|(a, b)| (a.to_string(), b.to_string())).into();
        let found = left_on(&values, &["GainAuto".into()]);
        assert_eq!(
            found.iter().map(ToString::to_string).collect::<Vec<_>>(),
            ["GainAuto", "LUTEnable[LUT1] = true"]
        );
        assert_eq!(found[0].acts_like, GAIN);
        assert!(same_value("1", "1.0") && same_value("\"Off\"", "Off") && !same_value("1", "2"));
        assert!(is_setting("BinningHorizontal") && is_setting("Gamma") && !is_setting("Shutter"));
        let off = |entries: &[&str]| {
            let entries: Vec<String> = entries.iter().map(ToString::to_string).collect();
            neutral_value(Off, Kind::Enumeration, &entries)
        };
        assert_eq!(off(&["On", "Disabled"]), Some(Value::Text("Disabled".into())));
        assert_eq!(off(&["Average", "Highlight"]), None);
        assert_eq!(neutral_value(Number(1.0), Kind::Integer, &[]), Some(Value::Int(1)));
        assert!(suspicious("HighlightToneMapping") && suspicious("CdsNoiseGate"));
        assert!(!suspicious("GevMACAddress") && !suspicious("Gamma"));
    }
}
