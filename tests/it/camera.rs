//! What is known of the features of real cameras.

use crate::support::shared;
use radcam::features::{Kind, Role, known, neutral_value, role, suspicious};

/// Every feature that 29 real cameras offer is switched off, recorded, or harmless for a reason that is
/// written down.
#[test]
fn every_feature_of_real_cameras_is_handled_or_listed() {
    let Some(path) = shared("genicam-features.csv") else { return };
    let mut reader = csv::Reader::from_path(path).unwrap();
    let (mut rows, mut without) = (0, Vec::new());
    for record in reader.records() {
        let record = record.unwrap();
        let (camera, feature) = (&record[0], &record[1]);
        assert!(
            role(feature).is_some(),
            "{camera} has {feature}, and nobody said what it does to pixel values"
        );
        rows += 1;
        // What distorts has a value on this camera at which it does not, or is known to be a setting there.
        let Some(Role::Distorts(neutral, _)) = role(feature) else { continue };
        let kind = match &record[2] {
            "Boolean" => Kind::Boolean,
            "Enumeration" => Kind::Enumeration,
            "Integer" => Kind::Integer,
            "Float" => Kind::Float,
            other => panic!("{other}"),
        };
        let entries: Vec<String> = record[3].split('|').map(ToString::to_string).collect();
        if neutral_value(neutral, kind, &entries).is_none() {
            without.push(feature.to_string());
        }
    }
    assert_eq!(rows, 797);
    // Which colours a table serves, what stands in for a defect, presets of exposures: none of them is a
    // switch.
    without.sort();
    without.dedup();
    assert_eq!(without, ["DefectCorrectionMode", "ExposureMode", "LUTMode"]);
}

/// The features that an issue found missing once are brought to a value, not only listed.
#[test]
fn what_changes_pixel_values_is_switched_off() {
    for name in [
        "DefectMaskPixelEnable",
        "DefectMaskColumnEnable",
        "DefectPixelCorrection",
        "EdgeFilter",
        "BrightnessCorrection",
        "TestImageSelector",
        "TestPattern",
        "SharpeningEnable",
        "SharpeningAuto",
        "SaturationAuto",
        "HueAuto",
        "PGR_HDRModeEnabled",
        "Noisefilter",
        "Flat_Field_Correction",
        "Shading_Control",
        "BlackLevelAutoBalance",
        "LUTMode",
        "WDRMode",
        "Gamma",
        "GainAuto",
        "ExposureAuto",
    ] {
        assert!(matches!(role(name), Some(Role::Distorts(..))), "{name}");
    }
    for name in ["BinningHorizontal", "DecimationVertical", "ReverseX", "SensorDigitizationTaps"] {
        assert_eq!(role(name), Some(Role::Geometry), "{name}");
    }
    for (name, role) in known() {
        assert!(!suspicious(name));
        if let Role::Harmless(reason) = role {
            assert!(reason.len() > 10, "{name}: {reason}");
        }
    }
    assert!(suspicious("VendorToneMapping") && suspicious("HotPixelFilterX"));
}
