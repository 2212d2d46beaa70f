//! Simulator as a camera.

use super::{
    Backend, Bounds, Camera, CameraError, Capabilities, FrameStream, Identity, Listed, Settings,
    StreamCounts, StreamOptions, Trigger, Value, check_bounds,
};
use crate::frame::{Frame, Region, Status};
use crate::pixel_format::PixelFormat;
use crate::plan::BenchState;
use radcam_sim::{Conditions, Model, Sensor, sensors};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Backend for simulated cameras.
pub const BACKEND: Backend =
    Backend { name: "sim", takes: "SENSOR", open: |name| Ok(Box::new(SimCamera::open(name, None)?)), list };

/// Lists the sensors that come with radcam.
fn list() -> Vec<Listed> {
    let of = |(name, text): &(&str, &str)| {
        let model = Model::from_toml(text).ok()?;
        Some(Listed {
            camera: format!("sim:{name}"),
            vendor: model.camera.vendor,
            model: model.camera.model,
            serial: format!("SIM{}", model.base.seed),
            protocol: "simulated".into(),
        })
    };
    sensors::ALL.iter().filter_map(of).collect()
}

/// Loads the model of a sensor by name (`xc77`, `cmos12`, `ccd16`) or from a model file. Another seed gives
/// another specimen.
///
/// # Errors
///
/// Message: no such sensor or file, or the fault in the file.
pub fn model(name: &str, seed: Option<u64>) -> Result<Model, String> {
    let mut model = if sensors::get(name).is_some() {
        sensors::load(name).map_err(|e| e.to_string())?
    } else if Path::new(name).exists() {
        let text = crate::input::settings(name.as_ref()).map_err(|e| match e.kind() {
            std::io::ErrorKind::InvalidData => format!("{name}: no text, and a model file is TOML"),
            _ => format!("{name}: {e}"),
        })?;
        Model::from_toml(&text).map_err(|e| format!("{name}: {e}"))?
    } else {
        let names: Vec<_> = sensors::ALL.iter().map(|(known, _)| *known).collect();
        return Err(format!("no model or sensor \"{name}\": neither a file nor one of {}", names.join(", ")));
    };
    model.base.seed = seed.unwrap_or(model.base.seed);
    Ok(model)
}

/// State of a simulated bench, shared with the camera in front of it.
#[derive(Debug, Clone, Default)]
pub struct SharedBench(Arc<Mutex<BenchState>>);

impl SharedBench {
    /// Returns the state of the bench.
    pub fn get(&self) -> BenchState {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the state of the bench.
    pub fn set(&self, state: BenchState) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = state;
    }
}

/// Camera that draws its frames.
///
/// The clock is simulated: a frame takes its exposure plus the sensor's read-out time, whatever the computing
/// time.
#[derive(Debug)]
pub struct SimCamera {
    identity: Identity,
    capabilities: Capabilities,
    sensor: Arc<Sensor>,
    bench: SharedBench,
    settings: Settings,
    trigger: Trigger,
    clock: Clock,
}

/// Number and time of the next frame.
#[derive(Debug, Clone, Copy, Default)]
struct Clock {
    frame: u64,
    time_s: f64,
}

/// Returns the formats in which a converter of `bit_depth` bits can output its codes.
pub fn formats_of(bit_depth: u8) -> Vec<PixelFormat> {
    let mono = |f: &PixelFormat| f.name().starts_with("Mono");
    let native =
        PixelFormat::all().filter(mono).find(|f| f.bits() >= bit_depth).map_or(16, PixelFormat::bits);
    PixelFormat::all().filter(mono).filter(|f| f.bits() == native || f.bits() == 8).collect()
}

/// Converts codes of a `bit_depth` converter to a format of `bits`: the low bits are dropped if the format
/// has fewer.
pub fn narrow(dn: &mut [u16], bit_depth: u8, bits: u8) {
    if bits < bit_depth {
        dn.iter_mut().for_each(|d| *d >>= bit_depth - bits);
    }
}

impl SimCamera {
    /// Opens a camera of a sensor by name or from a model file, with a bench of its own: see [`model`].
    ///
    /// # Errors
    ///
    /// [`CameraError::Absent`] if there is no such sensor, or its file is not a model.
    pub fn open(name: &str, seed: Option<u64>) -> Result<Self, CameraError> {
        let absent = |message: String| CameraError::Absent { camera: format!("sim:{name}"), message };
        let model = model(name, seed).map_err(absent)?;
        let sensor = Sensor::new(model).map_err(|e| absent(e.to_string()))?;
        Ok(Self::new(name, sensor.into(), SharedBench::default()))
    }

    /// Creates a camera of this sensor in front of this bench.
    pub fn new(name: &str, sensor: Arc<Sensor>, bench: SharedBench) -> Self {
        let model = sensor.model();
        let body = &model.camera;
        let formats = formats_of(body.bit_depth);
        let pixels = |max: u32| Bounds { min: 1.0, max: f64::from(max), increment: Some(1.0) };
        let bounds = |min, max, increment| Some(Bounds { min, max, increment });
        let identity = Identity {
            id: format!("sim:{name}"),
            vendor: body.vendor.clone(),
            model: body.model.clone(),
            serial: format!("SIM{}", model.base.seed),
            firmware: Some(env!("CARGO_PKG_VERSION").into()),
        };
        let capabilities = Capabilities {
            exposure_s: bounds(body.exposure_min_s, body.exposure_max_s, Some(body.exposure_increment_s)),
            gain_db: bounds(0.0, body.gain_max_db, None),
            black_level_dn: bounds(0.0, f64::from(model.full_scale_dn()), None),
            frame_rate_hz: None,
            width: pixels(body.width),
            height: pixels(body.height),
            offset_increment: (1, 1),
            pixel_formats: formats.clone(),
            software_trigger: true,
        };
        let settings = Settings {
            exposure_s: 0.01_f64.clamp(body.exposure_min_s, body.exposure_max_s),
            gain_db: Some(0.0),
            black_level_dn: Some(model.base.black_level_dn),
            frame_rate_hz: None,
            pixel_format: formats
                .into_iter()
                .find(|f| f.bits() >= body.bit_depth)
                .unwrap_or(PixelFormat::all().next().expect("the table of formats is not empty")),
            region: sensor.region(),
            temperature_c: Some(model.base.dark_reference_c),
        };
        Self {
            identity,
            capabilities,
            sensor,
            bench,
            settings,
            trigger: Trigger::FreeRun,
            clock: Clock::default(),
        }
    }

    /// Returns the sensor.
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    fn id(&self) -> &str {
        &self.identity.id
    }
}

/// Returns the conditions of a frame for camera settings and bench.
pub fn conditions(sensor: &Sensor, settings: &Settings, bench: &BenchState) -> Conditions {
    let nominal = sensor.conditions(settings.exposure_s);
    Conditions {
        illumination: bench.illumination,
        configuration: bench.configuration,
        scene: bench.scene,
        temperature_c: settings.temperature_c.unwrap_or(nominal.temperature_c),
        gain_db: settings.gain_db.unwrap_or(0.0),
        black_level_dn: settings.black_level_dn.unwrap_or(nominal.black_level_dn),
        ..nominal
    }
}

impl Camera for SimCamera {
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
        let bounds = check_bounds(self.id(), "ExposureTime", self.capabilities.exposure_s, value, "s")?;
        self.settings.exposure_s = bounds.nearest(value);
        Ok(self.settings.exposure_s)
    }

    fn set_gain_db(&mut self, value: f64) -> Result<f64, CameraError> {
        check_bounds(self.id(), "Gain", self.capabilities.gain_db, value, "dB")?;
        self.settings.gain_db = Some(value);
        Ok(value)
    }

    fn set_black_level_dn(&mut self, value: f64) -> Result<f64, CameraError> {
        check_bounds(self.id(), "BlackLevel", self.capabilities.black_level_dn, value, "DN")?;
        self.settings.black_level_dn = Some(value);
        Ok(value)
    }

    fn set_pixel_format(&mut self, format: PixelFormat) -> Result<PixelFormat, CameraError> {
        if !self.capabilities.pixel_formats.contains(&format) {
            return Err(self.not_available(&format!("pixel format {format}")));
        }
        self.settings.pixel_format = format;
        Ok(format)
    }

    fn set_region(&mut self, region: Region) -> Result<Region, CameraError> {
        let all = self.sensor.region();
        for (feature, value, max) in [
            ("OffsetX", region.x, all.width.saturating_sub(region.width)),
            ("OffsetY", region.y, all.height.saturating_sub(region.height)),
            ("Width", region.width, all.width),
            ("Height", region.height, all.height),
        ] {
            let min = if feature.starts_with("Offset") { 0.0 } else { 1.0 };
            let bounds = Bounds { min, max: f64::from(max), increment: Some(1.0) };
            check_bounds(self.id(), feature, Some(bounds), f64::from(value), "px")?;
        }
        self.settings.region = region;
        Ok(region)
    }

    fn set_trigger(&mut self, trigger: Trigger) -> Result<(), CameraError> {
        self.trigger = trigger;
        Ok(())
    }

    fn has_feature(&mut self, name: &str) -> bool {
        name == "DeviceTemperature"
    }

    fn set_feature(&mut self, name: &str, value: &Value) -> Result<Value, CameraError> {
        match (name, value) {
            ("DeviceTemperature", Value::Float(t)) => {
                let bounds = Bounds { min: -273.0, max: 200.0, increment: None };
                check_bounds(self.id(), name, Some(bounds), *t, "C")?;
                self.settings.temperature_c = Some(*t);
                Ok(value.clone())
            }
            _ => Err(self.not_available(name)),
        }
    }

    fn features(&mut self) -> BTreeMap<String, Value> {
        let region = self.settings.region;
        [("OffsetX", region.x), ("OffsetY", region.y)]
            .map(|(name, v)| (name.into(), Value::Int(v.into())))
            .into()
    }

    fn photon_flux_per_s(&mut self) -> Option<f64> {
        Some(self.sensor.model().bench.photon_flux_per_s)
    }

    fn draws_again(&self) -> bool {
        self.clock.frame == 0
    }

    fn continue_after(&mut self, frames: u64, time_s: f64) -> bool {
        self.clock = Clock { frame: frames, time_s };
        true
    }

    fn shared_bench(&self) -> Option<SharedBench> {
        Some(self.bench.clone())
    }

    fn stream(&mut self, _options: &StreamOptions) -> Result<Box<dyn FrameStream + '_>, CameraError> {
        let pending = match self.trigger {
            Trigger::FreeRun => None,
            Trigger::Software => Some(0),
        };
        Ok(Box::new(SimStream { camera: self, counts: StreamCounts::default(), pending }))
    }
}

struct SimStream<'a> {
    camera: &'a mut SimCamera,
    counts: StreamCounts,
    /// Triggers not yet answered; `None` in free run.
    pending: Option<u64>,
}

impl FrameStream for SimStream<'_> {
    fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<(), CameraError> {
        let camera = &mut *self.camera;
        match &mut self.pending {
            None => {}
            Some(0) => {
                return Err(CameraError::Timeout {
                    camera: camera.identity.id.clone(),
                    seconds: timeout.as_secs_f64(),
                    counts: "no trigger was given".into(),
                });
            }
            Some(pending) => *pending -= 1,
        }
        let settings = &camera.settings;
        let region = settings.region;
        let now = conditions(&camera.sensor, settings, &camera.bench.get());
        let conditions = Conditions { time_s: camera.clock.time_s, ..now };
        let body = &camera.sensor.model().camera;
        let dn = frame.pixels_mut(region.width as usize, region.height as usize);
        camera.sensor.draw(camera.clock.frame, &conditions, region, dn);
        narrow(dn, body.bit_depth, settings.pixel_format.bits());
        frame.status = Status::Complete;
        frame.id = camera.clock.frame;
        frame.timestamp_ns = Some((camera.clock.time_s * 1e9).round() as u64);
        frame.temperature_c = settings.temperature_c;
        camera.clock.frame += 1;
        camera.clock.time_s += settings.exposure_s + body.readout_s;
        self.counts.completed += 1;
        Ok(())
    }

    fn trigger(&mut self) -> Result<(), CameraError> {
        match &mut self.pending {
            Some(pending) => *pending += 1,
            None => return Err(self.camera.not_available("TriggerSoftware in free run")),
        }
        Ok(())
    }

    fn counts(&self) -> StreamCounts {
        self.counts
    }
}
