//! Recorded dataset as a camera: a setting selects the sets that were taken with it.

use super::sim::SharedBench;
use super::{
    Backend, Bounds, Camera, CameraError, Capabilities, FrameStream, Identity, Settings, StreamCounts,
    StreamOptions, Value,
};
use crate::dataset::{Dataset, Kind};
use crate::frame::{Frame, Region, Status};
use crate::pixel_format::PixelFormat;
use crate::plan::BenchState;
use radcam_sim::Scene;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

/// Backend for recordings.
pub const BACKEND: Backend = Backend {
    name: "replay",
    takes: "DATASET",
    open: |path| Ok(Box::new(ReplayCamera::open(Path::new(path), SharedBench::default())?)),
    list: Vec::new,
};

/// Camera that plays back a dataset.
#[derive(Debug)]
pub struct ReplayCamera {
    identity: Identity,
    capabilities: Capabilities,
    dataset: Dataset,
    bench: SharedBench,
    settings: Settings,
    /// Number of frames played, by set.
    played: Vec<usize>,
}

impl ReplayCamera {
    /// Opens a dataset as a camera. Exposure and the state of `bench` select the sets that are played.
    ///
    /// # Errors
    ///
    /// [`CameraError::Absent`] if the dataset cannot be opened or has no frames.
    pub fn open(path: &Path, bench: SharedBench) -> Result<Self, CameraError> {
        let absent =
            |message: String| CameraError::Absent { camera: format!("replay:{}", path.display()), message };
        let dataset = Dataset::open(path).map_err(|e| absent(e.to_string()))?;
        let info = dataset.manifest().camera.clone();
        let first = dataset.rows().first().ok_or_else(|| absent("the dataset has no frames".into()))?;
        let exposures = dataset.rows().iter().map(|r| r.exposure_s);
        let (min, max) = exposures.fold((f64::MAX, 0.0_f64), |(a, b), e| (a.min(e), b.max(e)));
        let format = PixelFormat::from_name(&info.pixel_format)
            .or_else(|_| PixelFormat::from_name(if info.bit_depth > 8 { "Mono16" } else { "Mono8" }))
            .map_err(|e| absent(e.to_string()))?;
        let fixed = |v: usize| Bounds { min: v as f64, max: v as f64, increment: None };
        let settings = Settings {
            exposure_s: first.exposure_s,
            gain_db: info.gain_db,
            black_level_dn: info.black_level_dn,
            frame_rate_hz: None,
            pixel_format: format,
            region: Region { x: 0, y: 0, width: info.width as u32, height: info.height as u32 },
            temperature_c: first.temperature_c,
        };
        Ok(Self {
            identity: Identity {
                id: format!("replay:{}", path.display()),
                vendor: info.vendor,
                model: info.model,
                serial: info.serial,
                firmware: info.firmware,
            },
            capabilities: Capabilities {
                exposure_s: Some(Bounds { min, max, increment: None }),
                gain_db: None,
                black_level_dn: None,
                frame_rate_hz: None,
                width: fixed(info.width),
                height: fixed(info.height),
                offset_increment: (1, 1),
                pixel_formats: vec![format],
                software_trigger: false,
            },
            played: vec![0; dataset.sets().len()],
            dataset,
            bench,
            settings,
        })
    }

    /// Returns true if a set was taken with the current settings.
    fn matches(&self, set: usize, bench: &BenchState) -> bool {
        let row = self.dataset.settings(&self.dataset.sets()[set]);
        let dark = bench.illumination == 0.0;
        let kind = match row.kind {
            Kind::Dark => dark,
            Kind::Flat => !dark && bench.scene == Scene::Card,
            Kind::Scene => !dark && bench.scene == Scene::Patch,
            Kind::Target => !dark && bench.scene == Scene::Chart,
        };
        kind && close(row.exposure_s, self.settings.exposure_s)
            && close(row.illumination, bench.illumination)
            && row.configuration == bench.configuration
    }
}

/// Returns true if two values agree to a millionth, the precision that survives conversion to text.
fn close(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-6 * a.abs().max(b.abs())
}

impl Camera for ReplayCamera {
    fn identity(&self) -> &Identity {
        &self.identity
    }

    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn settings(&mut self) -> Result<Settings, CameraError> {
        Ok(self.settings.clone())
    }

    fn set_exposure_s(&mut self, value: f64) -> Result<f64, CameraError> {
        super::check_bounds(&self.identity.id, "ExposureTime", self.capabilities.exposure_s, value, "s")?;
        let recorded = self.dataset.rows().iter().map(|r| r.exposure_s);
        let nearest = recorded.min_by(|a, b| (a - value).abs().total_cmp(&(b - value).abs()));
        self.settings.exposure_s = nearest.unwrap_or(value);
        Ok(self.settings.exposure_s)
    }

    fn set_pixel_format(&mut self, format: PixelFormat) -> Result<PixelFormat, CameraError> {
        if format == self.settings.pixel_format {
            Ok(format)
        } else {
            Err(self.not_available(&format!("pixel format {format}")))
        }
    }

    fn set_region(&mut self, region: Region) -> Result<Region, CameraError> {
        if region == self.settings.region {
            Ok(region)
        } else {
            Err(self.not_available(&format!("region {region:?}: a recording has the one it was taken with")))
        }
    }

    fn feature(&mut self, name: &str) -> Result<Value, CameraError> {
        self.features().remove(name).ok_or_else(|| self.not_available(name))
    }

    fn features(&mut self) -> BTreeMap<String, Value> {
        let value = |v: &toml::Value| match v {
            toml::Value::Boolean(v) => Value::Bool(*v),
            toml::Value::Integer(v) => Value::Int(*v),
            toml::Value::Float(v) => Value::Float(*v),
            toml::Value::String(v) => Value::Text(v.clone()),
            other => Value::Text(other.to_string()),
        };
        let features = &self.dataset.manifest().camera.features;
        features.iter().map(|(name, v)| (name.clone(), value(v))).collect()
    }

    fn shared_bench(&self) -> Option<SharedBench> {
        Some(self.bench.clone())
    }

    fn stream(&mut self, _options: &StreamOptions) -> Result<Box<dyn FrameStream + '_>, CameraError> {
        Ok(Box::new(ReplayStream { camera: self, counts: StreamCounts::default() }))
    }
}

struct ReplayStream<'a> {
    camera: &'a mut ReplayCamera,
    counts: StreamCounts,
}

impl FrameStream for ReplayStream<'_> {
    fn next(&mut self, frame: &mut Frame, _timeout: Duration) -> Result<(), CameraError> {
        let camera = &mut *self.camera;
        let bench = camera.bench.get();
        let left = |&set: &usize| {
            camera.matches(set, &bench) && camera.played[set] < camera.dataset.sets()[set].rows.len()
        };
        let Some(set) = (0..camera.played.len()).find(left) else {
            let message = format!(
                "the recording has no further frame at {} s, illumination {}, configuration {}",
                camera.settings.exposure_s, bench.illumination, bench.configuration
            );
            return Err(CameraError::Ended { camera: camera.identity.id.clone(), message });
        };
        let number = camera.dataset.sets()[set].rows[camera.played[set]];
        let row = &camera.dataset.rows()[number];
        frame.pixels = camera.dataset.read(row).map_err(|e| CameraError::Backend {
            camera: camera.identity.id.clone(),
            feature: "replay".into(),
            message: e.to_string(),
        })?;
        frame.status = Status::Complete;
        frame.id = number as u64;
        frame.timestamp_ns = row.timestamp_s.map(|t| (t * 1e9).round() as u64);
        frame.temperature_c = row.temperature_c;
        camera.played[set] += 1;
        self.counts.completed += 1;
        Ok(())
    }

    fn trigger(&mut self) -> Result<(), CameraError> {
        Err(self.camera.not_available("TriggerSoftware"))
    }

    fn counts(&self) -> StreamCounts {
        self.counts
    }
}
