//! What is known of the features of real cameras.

use crate::support::shared;
use radcam::camera::features::{Role, known, role, suspicious};

/// Every feature that 29 real cameras offer is switched off, recorded, or harmless for a reason that is written down.
#[test]
fn every_feature_of_real_cameras_is_handled_or_listed() {
    let Some(path) = shared("genicam-features.csv") else { return };
    let mut reader = csv::Reader::from_path(path).unwrap();
    let mut rows = 0;
    for record in reader.records() {
        let record = record.unwrap();
        let (camera, feature) = (&record[0], &record[1]);
        assert!(
            role(feature).is_some(),
            "{camera} has {feature}, and nobody said what it does to pixel values"
        );
        rows += 1;
    }
    assert_eq!(rows, 797);
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
