//! One suite for every camera backend; what a backend declares it has not is passed over.

use crate::support::{camera, small};
use radcam::bench::{BenchState, Illuminator};
use radcam::camera::replay::ReplayCamera;
use radcam::camera::{Camera, CameraError, StreamOptions, Trigger};
use radcam::capture::Capture;
use radcam::frame::{Frame, Region, Status};
use radcam::plan::Plan;
use std::time::Duration;

const TIMEOUT: Duration = Duration::from_secs(10);

/// Duties of every camera.
pub fn suite(camera: &mut dyn Camera, bench: &mut dyn Illuminator) {
    identity(camera);
    let automatics = camera.disable_automatics().unwrap();
    assert!(automatics.iter().all(|a| a.off), "{automatics:?}");
    let exposure_s = exposure(camera);
    gain_and_black_level(camera);
    formats(camera);
    frames(camera, bench, exposure_s);
    region(camera);
    software_trigger(camera);
}

fn identity(camera: &mut dyn Camera) {
    let identity = camera.identity().clone();
    assert!(!identity.id.is_empty() && !identity.model.is_empty(), "{identity:?}");
    let capabilities = camera.capabilities();
    assert!(!capabilities.pixel_formats.is_empty());
    assert!(capabilities.width.max >= 1.0 && capabilities.height.max >= 1.0);
}

/// Exposures are read back, and those out of bounds refused with camera, feature, value and unit.
fn exposure(camera: &mut dyn Camera) -> f64 {
    let Some(bounds) = camera.capabilities().exposure_s else { return 0.0 };
    let now = camera.settings().unwrap().exposure_s;
    let set = camera.set_exposure_s(now).unwrap();
    assert!((set / now - 1.0).abs() < 1e-3 && (camera.settings().unwrap().exposure_s - set).abs() < 1e-9);
    let error = camera.set_exposure_s(bounds.max * 2.0).unwrap_err();
    assert!(matches!(error, CameraError::OutOfRange { .. }), "{error}");
    let text = error.to_string();
    let id = &camera.identity().id;
    assert!(text.contains(id) && text.contains("ExposureTime") && text.contains(" s"), "{text}");
    set
}

fn gain_and_black_level(camera: &mut dyn Camera) {
    match camera.capabilities().gain_db {
        Some(bounds) => {
            let value = 0.5 * (bounds.min + bounds.max);
            assert!((camera.set_gain_db(value).unwrap() - value).abs() < 0.2);
            assert!(matches!(camera.set_gain_db(bounds.max + 1.0), Err(CameraError::OutOfRange { .. })));
            camera.set_gain_db(bounds.min).unwrap();
        }
        None => assert!(matches!(camera.set_gain_db(1.0), Err(CameraError::NotAvailable { .. }))),
    }
    match camera.capabilities().black_level_dn {
        Some(_) => {
            let before = camera.settings().unwrap().black_level_dn.unwrap();
            let set = camera.set_black_level_dn(before + 3.0).unwrap();
            assert!((set - before - 3.0).abs() < 0.51);
            camera.set_black_level_dn(before).unwrap();
        }
        None => assert!(matches!(camera.set_black_level_dn(1.0), Err(CameraError::NotAvailable { .. }))),
    }
}

/// Every format that is offered delivers frames that stay within its bits.
fn formats(camera: &mut dyn Camera) {
    let before = camera.settings().unwrap().pixel_format;
    if camera.capabilities().pixel_formats.len() > 1 {
        for format in camera.capabilities().pixel_formats.clone() {
            assert_eq!(camera.set_pixel_format(format).unwrap(), format);
            let mut frame = Frame::new(0, 0);
            let mut stream = camera.stream(&StreamOptions::default()).unwrap();
            stream.next(&mut frame, TIMEOUT).unwrap();
            assert_eq!(frame.status, Status::Complete, "{format}");
            assert!(frame.fits(format) && frame.pixels.iter().any(|&d| d > 0), "{format}");
        }
    }
    camera.set_pixel_format(before).unwrap();
}

/// Frames are numbered upwards, dated forwards, of the commanded size, and the counts add up.
fn frames(camera: &mut dyn Camera, bench: &mut dyn Illuminator, exposure_s: f64) {
    let light = BenchState { illumination: 0.5, ..Default::default() };
    bench.apply(&light, camera).unwrap();
    let region = camera.settings().unwrap().region;
    let mut stream = camera.stream(&StreamOptions::default()).unwrap();
    let mut frame = Frame::new(0, 0);
    let mut last: Option<(u64, Option<u64>)> = None;
    for _ in 0..3 {
        stream.next(&mut frame, TIMEOUT).unwrap();
        assert_eq!(frame.status, Status::Complete);
        assert_eq!(frame.pixels.dim(), (region.height as usize, region.width as usize));
        if let Some((id, at)) = last {
            assert!(frame.id > id);
            let step = frame.timestamp_ns.zip(at).map(|(now, before)| now as f64 - before as f64);
            assert!(step.is_none_or(|ns| ns * 1e-9 > 0.9 * exposure_s), "{step:?}");
        }
        last = Some((frame.id, frame.timestamp_ns));
    }
    let counts = stream.counts();
    assert_eq!((counts.completed, counts.failures, counts.missing), (3, 0, 0));
    assert!(stream.trigger().is_err(), "a trigger in free run");
}

fn region(camera: &mut dyn Camera) {
    let whole = camera.settings().unwrap().region;
    let too_wide = Region { width: whole.width + 100_000, ..whole };
    assert!(camera.set_region(too_wide).is_err());
    let part = Region { x: 8, y: 4, width: 16, height: 8 };
    match camera.set_region(part) {
        Ok(set) => {
            assert_eq!(set, part);
            let mut frame = Frame::new(0, 0);
            camera.stream(&StreamOptions::default()).unwrap().next(&mut frame, TIMEOUT).unwrap();
            assert_eq!(frame.pixels.dim(), (8, 16));
            assert_eq!(camera.set_region(whole).unwrap(), whole);
        }
        Err(e) => assert!(matches!(e, CameraError::NotAvailable { .. }), "{e}"),
    }
}

fn software_trigger(camera: &mut dyn Camera) {
    if !camera.capabilities().software_trigger {
        assert!(camera.set_trigger(Trigger::Software).is_err());
        return;
    }
    camera.set_trigger(Trigger::Software).unwrap();
    {
        let mut stream = camera.stream(&StreamOptions::default()).unwrap();
        let mut frame = Frame::new(0, 0);
        let silence = stream.next(&mut frame, Duration::from_millis(300)).unwrap_err();
        assert!(matches!(silence, CameraError::Timeout { .. }), "{silence}");
        for _ in 0..2 {
            stream.trigger().unwrap();
            stream.next(&mut frame, TIMEOUT).unwrap();
            assert_eq!(frame.status, Status::Complete);
        }
    }
    camera.set_trigger(Trigger::FreeRun).unwrap();
}

#[test]
fn the_simulator_conforms() {
    let (mut camera, mut bench) = camera(small("cmos12", 64, 48));
    suite(&mut camera, &mut bench);
}

#[test]
fn a_replay_conforms() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("campaign");
    let (mut camera, mut bench) = camera(small("cmos12", 32, 24));
    let mut plan = Plan::quick();
    plan.sets.iter_mut().for_each(|s| s.illumination *= 0.5);
    plan.sets.iter_mut().for_each(|s| s.exposure = Some(1.0));
    Capture::new(&mut camera, &mut bench).run(&plan, &root).unwrap();
    let mut replay = ReplayCamera::open(&root, bench.clone()).unwrap();
    suite(&mut replay, &mut bench);
}
