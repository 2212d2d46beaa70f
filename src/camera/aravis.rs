//! Real cameras (GigE Vision, USB3 Vision) through libaravis.

use super::{
    Automatic, Bounds, Camera, CameraError, Capabilities, FrameCounter, FrameStream, Identity, Settings,
    StreamCounts, StreamOptions, Trigger, Value, check_bounds,
};
use crate::frame::{Frame, Region, Status};
use crate::pixel_format::PixelFormat;
use radcam_aravis::{self as arv, DeviceInfo, Received, StreamSetup};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// A camera that speaks GenICam.
#[derive(Debug)]
pub struct AravisCamera {
    inner: arv::Camera,
    identity: Identity,
    capabilities: Capabilities,
    trigger: Trigger,
    /// GigE Vision on this machine's own loopback, where packets may be as large as its MTU.
    loopback: bool,
}

/// Largest GVSP packet that the loopback's MTU of 65536 bytes passes whole.
const LOOPBACK_PACKET: u32 = 65_000;

/// Features that change the image behind the radiometry's back, and the value at which they do not.
const AUTOMATICS: &[(&str, Neutral)] = &[
    ("ExposureAuto", Neutral::Entry("Off")),
    ("GainAuto", Neutral::Entry("Off")),
    ("BlackLevelAuto", Neutral::Entry("Off")),
    ("BlackLevelClampingEnable", Neutral::Off),
    ("BalanceWhiteAuto", Neutral::Entry("Off")),
    ("BalanceRatioAuto", Neutral::Entry("Off")),
    ("TonalityAuto", Neutral::Entry("Off")),
    ("ExposureCompensationAuto", Neutral::Entry("Off")),
    ("GammaEnable", Neutral::Off),
    ("GammaEnabled", Neutral::Off),
    ("Gamma", Neutral::Number(1.0)),
    ("LUTEnable", Neutral::Off),
    ("SharpnessAuto", Neutral::Entry("Off")),
    ("SharpnessEnable", Neutral::Off),
    ("SharpnessEnabled", Neutral::Off),
    ("SharpeningMode", Neutral::Entry("Off")),
    ("Sharpness", Neutral::Number(0.0)),
    ("SaturationEnable", Neutral::Off),
    ("SaturationEnabled", Neutral::Off),
    ("ColorTransformationEnable", Neutral::Off),
    ("NoiseReduction", Neutral::Number(0.0)),
    ("NoiseReductionMode", Neutral::Entry("Off")),
    ("NoiseReductionEnable", Neutral::Off),
    ("DenoiseMode", Neutral::Entry("Off")),
    ("SpatialNoiseReductionEnable", Neutral::Off),
    ("TemporalNoiseReductionEnable", Neutral::Off),
    ("DefectCorrectStaticEnable", Neutral::Off),
    ("DefectCorrectDynamicEnable", Neutral::Off),
    ("DefectCorrectionMode", Neutral::Entry("Off")),
    ("DefectPixelCorrectionEnable", Neutral::Off),
    ("DefectPixelCorrectionMode", Neutral::Entry("Off")),
    ("PixelCorrectionMode", Neutral::Entry("Off")),
    ("ShadingCorrectionMode", Neutral::Entry("Off")),
    ("FlatFieldCorrectionMode", Neutral::Entry("Off")),
    ("DSNUCorrectionEnable", Neutral::Off),
    ("PRNUCorrectionEnable", Neutral::Off),
    ("HDREnable", Neutral::Off),
    ("DigitalShift", Neutral::Number(0.0)),
];

/// A value that leaves the image alone.
#[derive(Debug, Clone, Copy)]
enum Neutral {
    Entry(&'static str),
    Off,
    Number(f64),
}

/// Every camera on networks and USB. Takes about a second.
pub fn list() -> Vec<DeviceInfo> {
    arv::devices()
}

impl AravisCamera {
    /// Opens a camera by IP address, Aravis id, or serial number.
    pub fn open(name: &str) -> Result<Self, CameraError> {
        let id = format!("aravis:{name}");
        let absent = |message: String| CameraError::Absent { camera: id.clone(), message };
        // An address needs no search, and is right where several interfaces exist.
        let direct = name.parse::<std::net::IpAddr>().is_ok();
        let mut address = name.to_string();
        if !direct {
            let devices = list();
            let matching = |d: &&DeviceInfo| d.id == name || d.serial == name || d.address == name;
            let Some(device) = devices.iter().find(matching) else {
                let found: Vec<_> = devices.iter().map(|d| format!("{} ({})", d.id, d.address)).collect();
                return Err(absent(if found.is_empty() {
                    "not found; no camera answers on any network or on USB".into()
                } else {
                    format!("not found; there are {}", found.join(", "))
                }));
            };
            let by_address = device.protocol.starts_with("GigE");
            address = if by_address { device.address.clone() } else { device.id.clone() };
        }
        let inner = arv::Camera::open(&address)
            .map_err(|e| absent(format!("{e}; `radcam cameras` lists what answers")))?;
        let (vendor, model, serial) = inner.identity().map_err(|e| absent(e.to_string()))?;
        let firmware = ["DeviceFirmwareVersion", "DeviceVersion"]
            .iter()
            .find_map(|f| inner.has(f).then(|| inner.string(f).ok()).flatten());
        let identity = Identity { id: format!("aravis:{address}"), vendor, model, serial, firmware };
        let capabilities = capabilities(&inner, &identity.id)?;
        let loopback = inner.is_gigevision() && address.starts_with("127.");
        Ok(Self { inner, identity, capabilities, trigger: Trigger::FreeRun, loopback })
    }

    fn refused(&self, e: arv::Error) -> CameraError {
        let camera = self.identity.id.clone();
        if self.inner.is_lost() {
            return CameraError::Lost { camera, message: e.to_string() };
        }
        CameraError::Backend { camera, feature: e.what, message: e.message }
    }

    /// Reads a feature by what it is for the neutral value asked for.
    fn read(&self, name: &str, like: Neutral) -> Option<Value> {
        match like {
            Neutral::Entry(_) => self.inner.string(name).ok().map(Value::Text),
            Neutral::Off => self.inner.boolean(name).ok().map(Value::Bool),
            Neutral::Number(_) => self.number(name).map(Value::Float),
        }
    }

    /// A float, or an integer taken for one.
    fn number(&self, name: &str) -> Option<f64> {
        self.inner.float(name).ok().or_else(|| self.inner.integer(name).ok().map(|i| i as f64))
    }

    /// Sets a float, or the nearest value of an integer.
    fn set_number(&self, name: &str, value: f64) -> Result<(), arv::Error> {
        let set = self.inner.set_float(name, value);
        set.or_else(|first| self.inner.set_integer(name, value.round() as i64).map_err(|_| first))
    }
}

/// Whether a float feature is there and in this unit.
fn in_unit(inner: &arv::Camera, feature: &str, unit: &str) -> bool {
    inner.has(feature) && inner.unit(feature).is_some_and(|u| u.trim().eq_ignore_ascii_case(unit))
}

fn capabilities(inner: &arv::Camera, id: &str) -> Result<Capabilities, CameraError> {
    let fault =
        |e: arv::Error| CameraError::Backend { camera: id.into(), feature: e.what, message: e.message };
    let bounds = |(min, max): (f64, f64), increment| Bounds { min, max, increment };
    let pixels = |name: &str| -> Result<Bounds, CameraError> {
        let (min, max) = inner.integer_bounds(name).map_err(fault)?;
        Ok(bounds((min as f64, max as f64), Some(inner.integer_increment(name) as f64)))
    };
    let exposure_name = ["ExposureTime", "ExposureTimeAbs"].into_iter().find(|name| inner.has(name));
    let exposure_step = exposure_name.and_then(|n| inner.float_increment(n)).map(|us| us * 1e-6);
    // Only what is said to be in DN counts as such; makers have units of their own.
    let black_level_dn =
        in_unit(inner, "BlackLevel", "DN").then(|| inner.float_bounds("BlackLevel").ok()).flatten();
    // Width and height shrink with the offsets: the whole sensor is what the bounds are about.
    let sensor = |name: &str, region: &str| -> Result<Bounds, CameraError> {
        let mut b = pixels(region)?;
        if let Ok(whole) = inner.integer(name) {
            b.max = b.max.max(whole as f64);
        }
        Ok(b)
    };
    let step = |name: &str| if inner.has(name) { inner.integer_increment(name) as u32 } else { 1 };
    let codes = inner.pixel_formats().map_err(fault)?;
    Ok(Capabilities {
        exposure_s: inner.exposure_bounds_s().ok().map(|b| bounds(b, exposure_step)),
        gain_db: in_unit(inner, "Gain", "dB")
            .then(|| inner.gain_bounds().ok())
            .flatten()
            .map(|b| bounds(b, None)),
        black_level_dn: black_level_dn.map(|b| bounds(b, None)),
        frame_rate_hz: inner.frame_rate_bounds_hz().ok().map(|b| bounds(b, None)),
        width: sensor("SensorWidth", "Width")?,
        height: sensor("SensorHeight", "Height")?,
        offset_increment: (step("OffsetX"), step("OffsetY")),
        pixel_formats: codes.iter().filter_map(|&c| PixelFormat::from_code(c).ok()).collect(),
        software_trigger: inner.has("TriggerSoftware"),
    })
}

impl Camera for AravisCamera {
    fn identity(&self) -> &Identity {
        &self.identity
    }

    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn settings(&mut self) -> Result<Settings, CameraError> {
        let refused = |e| self.refused(e);
        let code = self.inner.pixel_format().map_err(refused)?;
        let pixel_format = PixelFormat::from_code(code).map_err(|e| CameraError::Backend {
            camera: self.identity.id.clone(),
            feature: "PixelFormat".into(),
            message: e.to_string(),
        })?;
        let [x, y, width, height] = self.inner.region().map_err(refused)?.map(|v| v.max(0) as u32);
        let optional = |has: bool, read: &dyn Fn() -> Option<f64>| has.then(read).flatten();
        Ok(Settings {
            exposure_s: self.inner.exposure_s().map_err(refused)?,
            gain_db: optional(self.capabilities.gain_db.is_some(), &|| self.inner.gain().ok()),
            black_level_dn: optional(self.capabilities.black_level_dn.is_some(), &|| {
                self.inner.float("BlackLevel").ok()
            }),
            frame_rate_hz: optional(self.capabilities.frame_rate_hz.is_some(), &|| {
                self.inner.frame_rate_hz().ok()
            }),
            pixel_format,
            region: Region { x, y, width, height },
            temperature_c: optional(self.inner.has("DeviceTemperature"), &|| {
                self.inner.float("DeviceTemperature").ok()
            }),
        })
    }

    fn set_exposure_s(&mut self, value: f64) -> Result<f64, CameraError> {
        check_bounds(&self.identity.id, "ExposureTime", self.capabilities.exposure_s, value, "s")?;
        self.inner.set_exposure_s(value).map_err(|e| self.refused(e))?;
        self.inner.exposure_s().map_err(|e| self.refused(e))
    }

    fn set_gain_db(&mut self, value: f64) -> Result<f64, CameraError> {
        check_bounds(&self.identity.id, "Gain", self.capabilities.gain_db, value, "dB")?;
        self.inner.set_gain(value).map_err(|e| self.refused(e))?;
        self.inner.gain().map_err(|e| self.refused(e))
    }

    fn set_black_level_dn(&mut self, value: f64) -> Result<f64, CameraError> {
        check_bounds(&self.identity.id, "BlackLevel", self.capabilities.black_level_dn, value, "DN")?;
        self.inner.set_float("BlackLevel", value).map_err(|e| self.refused(e))?;
        self.inner.float("BlackLevel").map_err(|e| self.refused(e))
    }

    fn set_frame_rate_hz(&mut self, value: f64) -> Result<f64, CameraError> {
        let bounds = self.capabilities.frame_rate_hz;
        check_bounds(&self.identity.id, "AcquisitionFrameRate", bounds, value, "Hz")?;
        self.inner.set_frame_rate_hz(value).map_err(|e| self.refused(e))?;
        self.inner.frame_rate_hz().map_err(|e| self.refused(e))
    }

    fn set_pixel_format(&mut self, format: PixelFormat) -> Result<PixelFormat, CameraError> {
        if !self.capabilities.pixel_formats.contains(&format) {
            return Err(self.not_available(&format!("pixel format {format}")));
        }
        self.inner.set_pixel_format(format.code()).map_err(|e| self.refused(e))?;
        Ok(self.settings()?.pixel_format)
    }

    fn set_region(&mut self, region: Region) -> Result<Region, CameraError> {
        let (w, h) = (self.capabilities.width, self.capabilities.height);
        for (feature, bounds, value) in [
            ("Width", w, region.width),
            ("Height", h, region.height),
            ("OffsetX", Bounds { min: 0.0, max: w.max - f64::from(region.width), increment: None }, region.x),
            (
                "OffsetY",
                Bounds { min: 0.0, max: h.max - f64::from(region.height), increment: None },
                region.y,
            ),
        ] {
            check_bounds(&self.identity.id, feature, Some(bounds), value.into(), "px")?;
        }
        // Aravis does not enforce increments; a camera that does would answer with another region.
        let (width, height) = (w.nearest(region.width.into()) as i32, h.nearest(region.height.into()) as i32);
        let on_grid = |v: u32, step: u32| (v / step.max(1) * step.max(1)) as i32;
        let (x, y) = self.capabilities.offset_increment;
        let wanted = [on_grid(region.x, x), on_grid(region.y, y), width, height];
        // First to the corner: a large offset may stand in the way of a large size, and the other way round.
        self.inner
            .set_region([0, 0, width, height])
            .and_then(|()| self.inner.set_region(wanted))
            .map_err(|e| self.refused(e))?;
        Ok(self.settings()?.region)
    }

    fn set_trigger(&mut self, trigger: Trigger) -> Result<(), CameraError> {
        match trigger {
            Trigger::FreeRun if !self.inner.has("TriggerMode") => Ok(()),
            Trigger::FreeRun => self.inner.clear_triggers(),
            Trigger::Software => self.inner.set_software_trigger(),
        }
        .map_err(|e| self.refused(e))?;
        self.trigger = trigger;
        Ok(())
    }

    fn disable_automatics(&mut self) -> Result<Vec<Automatic>, CameraError> {
        let mut done = Vec::new();
        for &(name, neutral) in AUTOMATICS {
            if !self.inner.has(name) {
                continue;
            }
            let Some(before) = self.read(name, neutral) else { continue };
            let set = match neutral {
                Neutral::Entry(entry) => self.inner.set_string(name, entry),
                Neutral::Off => self.inner.set_boolean(name, false),
                Neutral::Number(value) => self.set_number(name, value),
            };
            if let Err(e) = set {
                tracing::debug!(feature = name, error = %e, "could not be set");
            }
            let now = self.read(name, neutral);
            let off = match (&now, neutral) {
                (Some(Value::Text(now)), Neutral::Entry(entry)) => now == entry,
                (Some(Value::Bool(now)), Neutral::Off) => !now,
                (Some(Value::Float(now)), Neutral::Number(value)) => (now - value).abs() < 1e-6,
                _ => false,
            };
            done.push(Automatic {
                feature: name.into(),
                before: before.to_string(),
                now: now.map_or_else(|| "unreadable".into(), |v| v.to_string()),
                off,
            });
        }
        if self.inner.is_lost() {
            return Err(self.refused(arv_lost()));
        }
        Ok(done)
    }

    fn has_feature(&mut self, name: &str) -> bool {
        self.inner.has(name)
    }

    fn set_feature(&mut self, name: &str, value: &Value) -> Result<Value, CameraError> {
        if !self.inner.has(name) && !self.inner.is_lost() {
            return Err(self.not_available(name));
        }
        let set = match value {
            Value::Bool(v) => self.inner.set_boolean(name, *v),
            // A plan may write `Gamma = 1` for a float.
            Value::Int(v) => {
                self.inner.set_integer(name, *v).or_else(|_| self.inner.set_float(name, *v as f64))
            }
            Value::Float(v) => self.set_number(name, *v),
            Value::Text(v) => self.inner.set_string(name, v),
        };
        set.map_err(|e| self.refused(e))?;
        let now = match value {
            Value::Bool(_) => self.inner.boolean(name).map(Value::Bool),
            Value::Int(v) => self.inner.integer(name).map(Value::Int).or_else(|_| {
                self.inner
                    .float(name)
                    .map(|now| if now == *v as f64 { Value::Int(*v) } else { Value::Float(now) })
            }),
            Value::Float(_) => self.number(name).map(Value::Float).ok_or_else(arv_lost),
            Value::Text(_) => self.inner.string(name).map(Value::Text),
        }
        .map_err(|e| self.refused(e))?;
        let same = match (value, &now) {
            // A float that the camera keeps as an integer comes back rounded.
            (Value::Float(a), Value::Float(b)) => {
                (a - b).abs() <= (1e-3 * a.abs()).max(0.5 * f64::from(b.fract() == 0.0))
            }
            (a, b) => a == b,
        };
        if same {
            return Ok(now);
        }
        let (asked, got) = (value.to_string(), now.to_string());
        Err(CameraError::ReadBack { camera: self.identity.id.clone(), feature: name.into(), asked, got })
    }

    fn features(&mut self) -> BTreeMap<String, Value> {
        let texts = ["TriggerMode", "BinningHorizontal", "BinningVertical", "SensorShutterMode", "ReverseX"];
        let mut features: BTreeMap<_, _> = texts
            .iter()
            .filter(|name| self.inner.has(name))
            .filter_map(|name| {
                let value = self.inner.string(name).map(Value::Text);
                let value = value.or_else(|_| self.inner.integer(name).map(Value::Int));
                Some((name.to_string(), value.ok()?))
            })
            .collect();
        for (name, known) in [
            ("Gain", self.capabilities.gain_db.is_some()),
            ("GainRaw", false),
            ("BlackLevel", self.capabilities.black_level_dn.is_some()),
            ("BlackLevelRaw", false),
        ] {
            if let Some(value) = self.number(name).filter(|_| !known && self.inner.has(name)) {
                features.insert(name.into(), Value::Float(value));
            }
        }
        if let Some(size) = self.inner.packet_size() {
            features.insert("GevSCPSPacketSize".into(), Value::Int(size.into()));
        }
        features
    }

    fn stream(&mut self, options: &StreamOptions) -> Result<Box<dyn FrameStream + '_>, CameraError> {
        let settings = self.settings()?;
        let id = self.identity.id.clone();
        let setup = StreamSetup {
            buffers: options.buffers,
            packet_size: options.packet_size.or(self.loopback.then_some(LOOPBACK_PACKET)),
            packet_resend: options.packet_resend,
            packet_timeout: options.packet_timeout,
            frame_retention: options.frame_retention,
            socket_buffer: options.socket_buffer,
            packet_socket: options.packet_socket,
        };
        let gigevision = self.inner.is_gigevision();
        let lost = self.inner.is_lost();
        let stream = self.inner.stream(&setup).map_err(|e| {
            if lost {
                CameraError::Lost { camera: id.clone(), message: e.to_string() }
            } else {
                CameraError::Backend { camera: id.clone(), feature: e.what, message: e.message }
            }
        })?;
        Ok(Box::new(AravisStream {
            stream,
            id,
            settings,
            trigger: self.trigger,
            gigevision,
            counter: FrameCounter::default(),
            counts: StreamCounts::default(),
        }))
    }
}

fn arv_lost() -> arv::Error {
    arv::Error { what: "control".into(), message: "the camera no longer answers".into() }
}

struct AravisStream<'a> {
    stream: arv::Stream<'a>,
    id: String,
    settings: Settings,
    trigger: Trigger,
    gigevision: bool,
    counter: FrameCounter,
    counts: StreamCounts,
}

impl FrameStream for AravisStream<'_> {
    fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<(), CameraError> {
        let Self { stream, settings, counter, counts, gigevision, .. } = self;
        let begun = Instant::now();
        let got =
            stream.next(timeout, |received| take(received, settings, *gigevision, counter, counts, frame));
        match got {
            Ok(Some(())) => Ok(()),
            Ok(None) => {
                let counted = self.counts();
                Err(CameraError::Timeout {
                    camera: self.id.clone(),
                    seconds: begun.elapsed().as_secs_f64(),
                    counts: format!(
                        "completed {}, failures {}, underruns {}; check the trigger, the packet size against \
                         the network's MTU, and the firewall",
                        counted.completed, counted.failures, counted.underruns
                    ),
                })
            }
            Err(e) => Err(CameraError::Lost { camera: self.id.clone(), message: e.message }),
        }
    }

    fn trigger(&mut self) -> Result<(), CameraError> {
        if self.trigger != Trigger::Software {
            let feature = "TriggerSoftware in free run".into();
            return Err(CameraError::NotAvailable { camera: self.id.clone(), feature });
        }
        self.stream.trigger().map_err(|e| CameraError::Backend {
            camera: self.id.clone(),
            feature: e.what,
            message: e.message,
        })
    }

    fn counts(&self) -> StreamCounts {
        StreamCounts { underruns: self.stream.counts().underruns, ..self.counts }
    }
}

/// Unpacks a frame that is whole and what was asked for; counts every other.
fn take(
    received: Received<'_>,
    settings: &Settings,
    gigevision: bool,
    counter: &mut FrameCounter,
    counts: &mut StreamCounts,
    frame: &mut Frame,
) {
    let damaged = |why: String, frame: &mut Frame, counts: &mut StreamCounts| {
        frame.status = Status::Damaged(why);
        counts.failures += 1;
    };
    let (bytes, code, region, id, timestamp_ns) = match received {
        Received::Complete { bytes, format, region, frame_id, timestamp_ns } => {
            (bytes, format, region, frame_id, timestamp_ns)
        }
        Received::Damaged(why) => return damaged(why, frame, counts),
    };
    let wanted = settings.region;
    let [x, y, w, h] = region.map(|v| v.max(0) as u32);
    if (Region { x, y, width: w, height: h }) != wanted || code != settings.pixel_format.code() {
        let why = format!("{w} x {h} px at {x}, {y} in format {code:#010x}, not what was commanded");
        return damaged(why, frame, counts);
    }
    // Before the pixels: a frame that cannot be unpacked was sent all the same.
    let (id, missing) = counter.take(id, gigevision);
    counts.missing += missing;
    let dn = frame.pixels_mut(w as usize, h as usize);
    if let Err(e) = settings.pixel_format.unpack(bytes, dn) {
        return damaged(e.to_string(), frame, counts);
    }
    frame.status = Status::Complete;
    frame.id = id;
    frame.timestamp_ns = (timestamp_ns != 0).then_some(timestamp_ns);
    frame.temperature_c = settings.temperature_c;
    counts.completed += 1;
}
