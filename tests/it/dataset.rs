//! Datasets as others write them, and campaigns that are cut short.

use crate::support::{camera, small};
use radcam::bench::{BenchError, BenchState, Illuminator, SharedBench};
use radcam::camera::sim::SimCamera;
use radcam::camera::{
    Camera, CameraError, Capabilities, FrameStream, Identity, Settings, StreamCounts, StreamOptions,
};
use radcam::capture::{Capture, CaptureError};
use radcam::dataset::{BenchInfo, Dataset, Kind};
use radcam::frame::{Frame, Region, Status};
use radcam::pixel_format::PixelFormat;
use radcam::plan::Plan;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

fn run(
    camera: &mut dyn Camera,
    bench: &mut dyn Illuminator,
    plan: &Plan,
    root: &Path,
    resume: bool,
    stop_after: u64,
) -> Result<u64, CaptureError> {
    let stop = AtomicBool::new(false);
    let mut progress = |p: radcam::capture::Progress| stop.store(p.frames >= stop_after, Ordering::Relaxed);
    let options = StreamOptions::default();
    let mut capture =
        Capture { camera, bench, options, stop: &stop, progress: Some(&mut progress), shown: None };
    let summary = if resume { capture.resume(root) } else { capture.run(plan, root) };
    summary.map(|s| s.frames)
}

/// Every row of the contract's header, one dataset.toml, and time that runs forwards.
#[test]
fn a_captured_campaign_is_the_plan() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    let (mut camera, mut bench) = camera(small("cmos12", 40, 30));
    let plan = Plan::standard();
    assert_eq!(run(&mut camera, &mut bench, &plan, &root, false, u64::MAX).unwrap(), plan.frames());

    let dataset = Dataset::open(&root).unwrap();
    assert_eq!(dataset.sets().len(), plan.sets.len());
    for (set, wanted) in dataset.sets().iter().zip(&plan.sets) {
        let row = dataset.settings(set);
        assert_eq!((row.kind, row.illumination), (wanted.kind, wanted.illumination));
        assert_eq!(set.rows.len(), wanted.frames as usize);
        dataset.read_set(set).unwrap();
    }
    let times: Vec<f64> = dataset.rows().iter().map(|r| r.timestamp_s.unwrap()).collect();
    assert!(times.windows(2).all(|w| w[1] > w[0]));
    // The brightest flat lies where the plan wants it: the pilot found the exposure.
    let brightest = dataset
        .sets()
        .iter()
        .filter(|s| dataset.settings(s).kind == Kind::Flat)
        .map(|s| dataset.read(&dataset.rows()[s.rows[0]]).unwrap().mapv(f64::from).mean().unwrap())
        .fold(0.0, f64::max);
    assert!((brightest / 4095.0 - 0.85).abs() < 0.03, "{brightest}");
    let text = std::fs::read_to_string(root.join("frames.csv")).unwrap();
    assert!(text.starts_with(
        "file,kind,set,index,exposure_s,illumination,configuration,temperature_c,timestamp_s\n"
    ));
}

#[test]
fn an_interrupted_campaign_is_continued_without_loss_or_repetition() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    let model = small("cmos12", 24, 16);
    let plan = Plan::quick();
    let (mut first, mut bench) = camera(model.clone());
    let error = run(&mut first, &mut bench, &plan, &root, false, 13).unwrap_err();
    assert!(matches!(error, CaptureError::Interrupted { frames: 13 }), "{error}");
    let again = run(&mut first, &mut bench, &plan, &root, false, u64::MAX).unwrap_err().to_string();
    assert!(again.contains("--resume"), "{again}");

    let (mut second, mut bench) = camera(model.clone());
    assert_eq!(run(&mut second, &mut bench, &plan, &root, true, u64::MAX).unwrap(), plan.frames() - 13);
    let dataset = Dataset::open(&root).unwrap();
    assert_eq!(dataset.rows().len() as u64, plan.frames());
    let frames: Vec<_> = dataset.rows().iter().map(|r| dataset.read(r).unwrap()).collect();
    for (i, a) in frames.iter().enumerate() {
        assert!(frames[..i].iter().all(|b| a != b), "frame {i} shows the noise of an earlier one");
    }
    // Nothing left to do is no fault.
    let (mut third, mut bench) = camera(model.clone());
    assert_eq!(run(&mut third, &mut bench, &plan, &root, true, u64::MAX).unwrap(), 0);
    // Another camera is.
    let mut other = model;
    other.camera.model = "another".into();
    let (mut fourth, mut bench) = camera(other);
    let error = run(&mut fourth, &mut bench, &plan, &root, true, u64::MAX).unwrap_err().to_string();
    assert!(error.contains("model \"cmos12\"") && error.contains("\"another\""), "{error}");
}

/// A bench that fails in the middle loses nothing.
#[test]
fn what_was_captured_before_a_fault_stays_whole() {
    struct Failing(SharedBench, u32);
    impl Illuminator for Failing {
        fn apply(&mut self, state: &BenchState, camera: &mut dyn Camera) -> Result<BenchState, BenchError> {
            self.1 += 1;
            // Once for the search, once to let it fade, and once for each set.
            if self.1 > 6 {
                return Err(BenchError::Operator("the lamp is broken".into()));
            }
            self.0.apply(state, camera)
        }
        fn info(&self) -> Option<BenchInfo> {
            None
        }
    }
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("c");
    let (mut camera, bench) = camera(small("cmos12", 24, 16));
    let plan = Plan::quick();
    let error = run(&mut camera, &mut Failing(bench, 0), &plan, &root, false, u64::MAX).unwrap_err();
    assert!(error.to_string().contains("the lamp is broken"), "{error}");
    let dataset = Dataset::open(&root).unwrap();
    assert_eq!(dataset.rows().len(), 16);
    dataset.rows().iter().for_each(|r| assert!(dataset.read(r).is_ok()));
}

/// A simulated camera whose link damages the first frame of some streams.
struct Damaging {
    inner: SimCamera,
    streams: usize,
    damaged: Vec<usize>,
}

struct DamagingStream<'a>(Box<dyn FrameStream + 'a>, bool);

impl FrameStream for DamagingStream<'_> {
    fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<(), CameraError> {
        self.0.next(frame, timeout)?;
        if std::mem::take(&mut self.1) {
            frame.status = Status::Damaged("lost packets".into());
        }
        Ok(())
    }

    fn trigger(&mut self) -> Result<(), CameraError> {
        self.0.trigger()
    }

    fn counts(&self) -> StreamCounts {
        self.0.counts()
    }
}

impl Camera for Damaging {
    fn identity(&self) -> &Identity {
        self.inner.identity()
    }

    fn capabilities(&self) -> &Capabilities {
        self.inner.capabilities()
    }

    fn settings(&mut self) -> Result<Settings, CameraError> {
        self.inner.settings()
    }

    fn set_exposure_s(&mut self, value: f64) -> Result<f64, CameraError> {
        self.inner.set_exposure_s(value)
    }

    fn set_pixel_format(&mut self, format: PixelFormat) -> Result<PixelFormat, CameraError> {
        self.inner.set_pixel_format(format)
    }

    fn set_region(&mut self, region: Region) -> Result<Region, CameraError> {
        self.inner.set_region(region)
    }

    fn stream(&mut self, options: &StreamOptions) -> Result<Box<dyn FrameStream + '_>, CameraError> {
        self.streams += 1;
        let damages = self.damaged.contains(&self.streams);
        Ok(Box::new(DamagingStream(self.inner.stream(options)?, damages)))
    }
}

/// The frame after a change of level holds what is carried over: where it is lost, the level before is
/// exposed once more.
#[test]
fn a_set_whose_first_frame_is_lost_is_begun_again() {
    let mut model = small("cmos12", 64, 48);
    model.effects.push(radcam_sim::EffectValues {
        id: "image-lag".into(),
        parameters: [("fraction".to_string(), 0.05)].into(),
        ..Default::default()
    });
    let text = |sets: &str| format!("format = \"radcam-plan/1\"\n{sets}");
    let sets = "[[set]]\nkind = \"flat\"\nframes = 4\nexposure_s = 0.004\nillumination = 1.0\n\
                [[set]]\nkind = \"dark\"\nframes = 4\nexposure_s = 0.004\n";
    let plan = Plan::from_toml(&text(sets)).unwrap();
    // Nothing damaged; the first frame of the darks; and all beginnings of it, which is taken as it comes at
    // last.
    let first_dark = |damaged: &[usize]| {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("c");
        let (inner, mut bench) = camera(model.clone());
        let mut camera = Damaging { inner, streams: 0, damaged: damaged.to_vec() };
        assert_eq!(run(&mut camera, &mut bench, &plan, &root, false, u64::MAX).unwrap(), 8);
        let log = std::fs::read_to_string(root.join(radcam::capture::LOG_FILE)).unwrap();
        assert_eq!(log.contains("set 1 begun again"), !damaged.is_empty(), "{log}");
        let dataset = Dataset::open(&root).unwrap();
        let rows = &dataset.sets()[1].rows;
        let mean = |k: usize| dataset.read(&dataset.rows()[rows[k]]).unwrap().mapv(f64::from).mean().unwrap();
        mean(0) - mean(3)
    };
    let (sound, again) = (first_dark(&[]), first_dark(&[2]));
    assert!(sound > 10.0, "{sound} DN are carried over");
    // The light of the two is the same; the mean of 3072 pixels of some 4 DN of noise scatters by 0.1 DN.
    assert!((again - sound).abs() < 0.02 * sound + 0.5, "{again} DN, not {sound}");
    assert!(first_dark(&(2..40).collect::<Vec<_>>()) < 0.5 * sound);
}
