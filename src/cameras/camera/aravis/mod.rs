//! Real cameras (GigE Vision, USB3 Vision) through libaravis.

mod files;
mod report;
mod stream;

use super::{
    Arrived, Automatic, Backend, Bounds, Camera, CameraError, Capabilities, FrameCounter, FrameStream, Identity,
    Listed, Settings, StreamCounts, StreamOptions, Trigger, Value, check_bounds,
};
use crate::features::{Kind, Neutral, Role, is_disabled, known, neutral_value, role, suspicious};
use crate::frame::Region;
use crate::pixel_format::PixelFormat;
use radcam_aravis::{self as arv, DeviceInfo, Feature, FeatureKind, StreamSetup};
use std::collections::BTreeMap;

/// GenICam camera.
#[derive(Debug)]
pub struct AravisCamera {
    inner: arv::Camera,
    identity: Identity,
    capabilities: Capabilities,
    trigger: Trigger,
    /// All features that the camera description lists, and known ones outside the list.
    tree: Vec<Feature>,
    exposure: ExposureFeature,
    /// Name of the gain feature in dB.
    gain: Option<&'static str>,
    /// True for GigE Vision over the loopback of this machine, where packets may be as large as its MTU.
    loopback: bool,
}

/// Feature that sets the exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
enum ExposureFeature {
    /// Exposure in microseconds, under the name that Aravis finds.
    Time,
    /// `ExposureTimeRaw` in steps of `step_us` microseconds.
    Raw { step_us: f64 },
}

/// Maximum GVSP packet size, bytes, that passes the loopback's MTU of 65536 bytes unfragmented.
const LOOPBACK_PACKET: u32 = 65_000;

/// Backend for real cameras.
pub const BACKEND: Backend = Backend {
    name: "aravis",
    takes: "ID (an IP address, an Aravis id or a serial number)",
    open: |id| Ok(Box::new(AravisCamera::open(id)?)),
    list,
};

/// Lists every camera on networks and USB. Takes about a second.
fn list() -> Vec<Listed> {
    let of = |d: DeviceInfo| Listed {
        camera: format!("aravis:{}", if d.protocol.starts_with("GigE") { d.address } else { d.id }),
        vendor: d.vendor,
        model: d.model,
        serial: d.serial,
        protocol: d.protocol,
    };
    arv::devices().into_iter().map(of).collect()
}

impl AravisCamera {
    /// Opens a camera by IP address, Aravis id, or serial number.
    ///
    /// # Errors
    ///
    /// [`CameraError::Absent`] if no such camera answers (it lists those that do), or if the camera refuses
    /// the setup.
    pub fn open(name: &str) -> Result<Self, CameraError> {
        let id = format!("aravis:{name}");
        let absent = |message: String| CameraError::Absent { camera: id.clone(), message };
        // An IP address needs no discovery, and works with several network interfaces.
        let direct = name.parse::<std::net::IpAddr>().is_ok();
        let mut address = name.to_string();
        if !direct {
            let devices = arv::devices();
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
        if !inner.has_control() {
            let message = "another program has control of it: end that program; of one that was killed the camera lets go \
                           within some seconds";
            return Err(absent(message.into()));
        }
        // A killed program may have left an acquisition running, which would go on under changing settings.
        if let Err(e) = inner.stop_acquisition() {
            tracing::debug!(error = %e, "AcquisitionStop at the start");
        }
        let (vendor, model, serial) = inner.identity().map_err(|e| absent(e.to_string()))?;
        let firmware = ["DeviceFirmwareVersion", "DeviceVersion"]
            .iter()
            .find_map(|f| inner.has(f).then(|| inner.string(f).ok()).flatten());
        let identity = Identity { id: format!("aravis:{address}"), vendor, model, serial, firmware };
        let exposure = exposure_feature(&inner);
        let gain = ["Gain", "GainAbs"].into_iter().find(|name| in_unit(&inner, name, "dB"));
        let capabilities = capabilities(&inner, &identity.id, exposure, gain)?;
        let loopback = inner.is_gigevision() && address.starts_with("127.");
        let mut tree = inner.features();
        // A description may have features outside its categories, or no categories.
        let listed: std::collections::BTreeSet<String> = tree.iter().map(|f| f.name.clone()).collect();
        tree.extend(
            known().filter(|(name, _)| !listed.contains(*name)).filter_map(|(name, _)| inner.feature(name)),
        );
        if tree.is_empty() {
            tracing::warn!(
                camera = identity.id,
                "its description lists no features: nothing can be switched off"
            );
        }
        Ok(Self { inner, identity, capabilities, trigger: Trigger::FreeRun, tree, exposure, gain, loopback })
    }

    fn refused(&self, e: arv::Error) -> CameraError {
        let camera = self.identity.id.clone();
        if self.inner.is_lost() {
            return CameraError::Lost { camera, message: e.to_string() };
        }
        CameraError::Backend { camera, feature: e.what, message: e.message }
    }

    /// Reads a feature.
    fn read(&self, name: &str, kind: FeatureKind) -> Option<Value> {
        match kind {
            FeatureKind::Boolean => self.inner.boolean(name).ok().map(Value::Bool),
            FeatureKind::Integer => self.inner.integer(name).ok().map(Value::Int),
            FeatureKind::Float => self.inner.float(name).ok().map(Value::Float),
            FeatureKind::Enumeration | FeatureKind::Text => self.inner.string(name).ok().map(Value::Text),
        }
    }

    /// Returns the value at which a feature does not affect the image, if there is one.
    fn neutral(&self, feature: &Feature, neutral: Neutral) -> Option<Value> {
        let kind = match feature.kind {
            FeatureKind::Boolean => Kind::Boolean,
            FeatureKind::Enumeration => Kind::Enumeration,
            FeatureKind::Integer => Kind::Integer,
            FeatureKind::Float => Kind::Float,
            FeatureKind::Text => Kind::Text,
        };
        let enumeration = feature.kind == FeatureKind::Enumeration;
        let entries = if enumeration { self.inner.entries(&feature.name).ok()? } else { Vec::new() };
        neutral_value(neutral, kind, &entries)
    }

    /// Sets a feature to a value and returns the result.
    fn neutralise(&self, name: &str, shown: String, kind: FeatureKind, to: &Value) -> Option<Automatic> {
        let before = self.read(name, kind)?;
        let set = match to {
            Value::Bool(v) => self.inner.set_boolean(name, *v),
            Value::Int(v) => self.inner.set_integer(name, *v),
            Value::Float(v) => self.inner.set_float(name, *v),
            Value::Text(v) => self.inner.set_string(name, v),
        };
        if let Err(e) = set {
            tracing::debug!(feature = name, error = %e, "could not be set");
        }
        let now = self.read(name, kind);
        let off = match (&now, to) {
            (Some(Value::Float(now)), Value::Float(to)) => (now - to).abs() < 1e-6,
            (now, to) => now.as_ref() == Some(to),
        };
        let now = now.map_or_else(|| "unreadable".into(), |v| v.to_string());
        Some(Automatic { feature: shown, before: before.to_string(), now, off })
    }

    /// Runs `act` on a feature under every entry of its selector, then restores the selector. `act` receives
    /// the entry if there are several.
    fn under_selector(&self, name: &str, mut act: impl FnMut(Option<&str>)) {
        let selector = self.selector_of(name);
        let entries =
            selector.and_then(|s| Some((s, self.inner.entries(s).ok()?, self.inner.string(s).ok()?)));
        match entries {
            Some((selector, entries, before)) if entries.len() > 1 => {
                for entry in &entries {
                    if self.inner.set_string(selector, entry).is_ok() && self.inner.has(name) {
                        act(Some(entry));
                    }
                }
                if let Err(e) = self.inner.set_string(selector, &before) {
                    tracing::debug!(feature = selector, error = %e, "could not be set back");
                }
            }
            _ => act(None),
        }
    }

    /// Returns the selector of a feature: the one that declares it, or in older descriptions, which declare
    /// nothing, the one named after it.
    fn selector_of(&self, name: &str) -> Option<&str> {
        let says = |f: &&Feature| f.selected.iter().any(|s| s == name);
        let named = |f: &&Feature| {
            f.selected.is_empty()
                && f.name.strip_suffix("Selector").is_some_and(|stem| name.starts_with(stem))
        };
        let mut enumerations =
            self.tree.iter().filter(|f| f.kind == FeatureKind::Enumeration && f.name != name);
        let found = enumerations.clone().find(says).or_else(|| enumerations.find(named));
        found.map(|f| f.name.as_str()).filter(|selector| self.inner.has(selector))
    }

    fn exposure_s(&self) -> Result<f64, CameraError> {
        match self.exposure {
            ExposureFeature::Time => self.inner.exposure_s(),
            ExposureFeature::Raw { step_us } => {
                self.inner.integer("ExposureTimeRaw").map(|steps| steps as f64 * step_us * 1e-6)
            }
        }
        .map_err(|e| self.refused(e))
    }

    /// Reads a float, or an integer as a float.
    fn number(&self, name: &str) -> Option<f64> {
        self.inner.float(name).ok().or_else(|| self.inner.integer(name).ok().map(|i| i as f64))
    }

    /// Sets a float, or an integer to the nearest value.
    fn set_number(&self, name: &str, value: f64) -> Result<(), arv::Error> {
        let set = self.inner.set_float(name, value);
        set.or_else(|first| self.inner.set_integer(name, value.round() as i64).map_err(|_| first))
    }
}

/// Returns true if a float feature exists and has this unit.
fn in_unit(inner: &arv::Camera, feature: &str, unit: &str) -> bool {
    inner.has(feature) && inner.unit(feature).is_some_and(|u| u.trim().eq_ignore_ascii_case(unit))
}

/// Returns the feature that sets the exposure. Older cameras count steps of a time base.
fn exposure_feature(inner: &arv::Camera) -> ExposureFeature {
    let raw = "ExposureTimeRaw";
    if ["ExposureTime", "ExposureTimeAbs"].iter().any(|name| inner.has(name)) || !inner.has(raw) {
        return ExposureFeature::Time;
    }
    let base = inner.float("ExposureTimeBaseAbs").ok().filter(|us| *us > 0.0);
    if base.is_none() {
        tracing::warn!("ExposureTimeRaw has no ExposureTimeBaseAbs beside it: one step is taken as 1 us");
    }
    ExposureFeature::Raw { step_us: base.unwrap_or(1.0) }
}

fn capabilities(
    inner: &arv::Camera,
    id: &str,
    exposure: ExposureFeature,
    gain: Option<&str>,
) -> Result<Capabilities, CameraError> {
    let fault =
        |e: arv::Error| CameraError::Backend { camera: id.into(), feature: e.what, message: e.message };
    let bounds = |(min, max): (f64, f64), increment| Bounds { min, max, increment };
    let pixels = |name: &str| -> Result<Bounds, CameraError> {
        let (min, max) = inner.integer_bounds(name).map_err(fault)?;
        Ok(bounds((min as f64, max as f64), Some(inner.integer_increment(name) as f64)))
    };
    let exposure_s = match exposure {
        ExposureFeature::Time => {
            let name = ["ExposureTime", "ExposureTimeAbs"].into_iter().find(|name| inner.has(name));
            let step = name.and_then(|n| inner.float_increment(n)).map(|us| us * 1e-6);
            inner.exposure_bounds_s().ok().map(|b| bounds(b, step))
        }
        ExposureFeature::Raw { step_us } => {
            let step_s = step_us * 1e-6;
            let limits = inner.integer_bounds("ExposureTimeRaw").ok();
            limits.map(|(min, max)| bounds((min.max(1) as f64 * step_s, max as f64 * step_s), Some(step_s)))
        }
    };
    // Only a black level with unit DN is used; makers have units of their own.
    let black_level_dn =
        in_unit(inner, "BlackLevel", "DN").then(|| inner.float_bounds("BlackLevel").ok()).flatten();
    // The maxima of width and height shrink with the offsets; the bounds must cover the whole sensor.
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
        exposure_s,
        gain_db: gain.and_then(|name| inner.float_bounds(name).ok()).map(|b| bounds(b, None)),
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
            exposure_s: self.exposure_s()?,
            gain_db: self.gain.and_then(|name| self.inner.float(name).ok()),
            black_level_dn: optional(self.capabilities.black_level_dn.is_some(), &|| {
                self.inner.float("BlackLevel").ok()
            }),
            frame_rate_hz: optional(self.capabilities.frame_rate_hz.is_some(), &|| {
                self.inner.frame_rate_hz().ok()
            }),
            pixel_format,
            region: Region { x, y, width, height },
            temperature_c: ["DeviceTemperature", "TemperatureAbs", "CurrentTemperature"]
                .into_iter()
                .find_map(|name| optional(self.inner.has(name), &|| self.inner.float(name).ok())),
        })
    }

    fn set_exposure_s(&mut self, value: f64) -> Result<f64, CameraError> {
        check_bounds(&self.identity.id, "ExposureTime", self.capabilities.exposure_s, value, "s")?;
        match self.exposure {
            ExposureFeature::Time => self.inner.set_exposure_s(value),
            ExposureFeature::Raw { step_us } => {
                let steps = (value * 1e6 / step_us).round().max(1.0);
                self.inner.set_integer("ExposureTimeRaw", steps as i64)
            }
        }
        .map_err(|e| self.refused(e))?;
        self.exposure_s()
    }

    fn set_gain_db(&mut self, value: f64) -> Result<f64, CameraError> {
        check_bounds(&self.identity.id, "Gain", self.capabilities.gain_db, value, "dB")?;
        let name = self.gain.unwrap_or("Gain");
        let mut set = Ok(());
        // Gains of all, of the analog and of the digital part multiply, so only `All` or `AnalogAll` is set
        // if present. Gains of taps and colours apply side by side.
        let whole = ["All", "AnalogAll"];
        let selector = self.selector_of(name);
        let entries = selector.and_then(|s| self.inner.entries(s).ok()).unwrap_or_default();
        let only = whole.into_iter().find(|w| entries.iter().any(|e| e == w));
        self.under_selector(name, |entry| {
            if only.is_none_or(|only| entry.is_none_or(|e| e == only))
                && let Err(e) = self.inner.set_float(name, value)
            {
                set = Err(e);
            }
        });
        set.and_then(|()| self.inner.float(name)).map_err(|e| self.refused(e))
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
        // Aravis does not enforce increments; a camera that does would report another region.
        let (width, height) = (w.nearest(region.width.into()) as i32, h.nearest(region.height.into()) as i32);
        let on_grid = |v: u32, step: u32| (v / step.max(1) * step.max(1)) as i32;
        let (x, y) = self.capabilities.offset_increment;
        let wanted = [on_grid(region.x, x), on_grid(region.y, y), width, height];
        // The offsets go to 0 first: a large offset can block a large size, and vice versa.
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
        for feature in &self.tree {
            let name = feature.name.as_str();
            let Some(Role::Distorts(neutral, _)) = role(name) else { continue };
            if !self.inner.has(name) {
                continue;
            }
            self.under_selector(name, |entry| {
                let shown = entry.map_or_else(|| name.to_string(), |entry| format!("{name}[{entry}]"));
                let to = self.neutral(feature, neutral);
                done.extend(to.and_then(|to| self.neutralise(name, shown, feature.kind, &to)));
            });
        }
        if self.inner.is_lost() {
            return Err(self.refused(arv_lost()));
        }
        let now: BTreeMap<String, String> = done.iter().map(|a| (a.feature.clone(), a.now.clone())).collect();
        for a in &mut done {
            a.off |= is_disabled(&a.feature, |switch| now.get(switch).cloned());
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
            // A float that the camera stores as an integer reads back rounded.
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

    fn feature(&mut self, name: &str) -> Result<Value, CameraError> {
        let kind = self.inner.feature(name).filter(|_| self.inner.has(name)).map(|f| f.kind);
        let value = kind.and_then(|kind| self.read(name, kind));
        value.ok_or_else(|| if self.inner.is_lost() { self.refused(arv_lost()) } else { self.not_available(name) })
    }

    fn execute(&mut self, command: &str) -> Result<(), CameraError> {
        if !self.inner.has(command) && !self.inner.is_lost() {
            return Err(self.not_available(command));
        }
        self.inner.execute(command).map_err(|e| self.refused(e))
    }

    fn largest(&mut self, name: &str) -> Option<f64> {
        let float = || self.inner.float_bounds(name).ok().map(|b| b.1);
        self.inner.integer_bounds(name).ok().map(|b| b.1 as f64).or_else(float)
    }

    fn files(&mut self) -> Vec<String> {
        files::names(&self.inner)
    }

    fn write_file(
        &mut self,
        name: &str,
        bytes: &[u8],
        go_on: &mut dyn FnMut(usize) -> bool,
    ) -> Result<(), CameraError> {
        files::write(&self.inner, name, bytes, go_on).map_err(|e| self.refused(e))
    }

    fn read_file(
        &mut self,
        name: &str,
        most: usize,
        go_on: &mut dyn FnMut(usize) -> bool,
    ) -> Result<Vec<u8>, CameraError> {
        files::read(&self.inner, name, most, go_on).map_err(|e| self.refused(e))
    }

    fn photon_flux_per_s(&mut self) -> Option<f64> {
        self.inner.float("BenchPhotonFlux").ok().filter(|flux| *flux > 0.0)
    }

    fn features(&mut self) -> BTreeMap<String, Value> {
        let mut features = BTreeMap::new();
        let kept = |name: &str| {
            let role = role(name);
            // Not recorded: exposure and pixel format, and gain and black level that have dataset keys.
            let said = ["ExposureTime", "ExposureTimeAbs", "PixelFormat"].contains(&name)
                || self.gain == Some(name)
                || (name == "BlackLevel" && self.capabilities.black_level_dn.is_some());
            let recorded = matches!(role, Some(Role::Setting | Role::Geometry)) || suspicious(name);
            (recorded && !said) || name == "TriggerMode"
        };
        // A distorting feature without a neutral value is recorded as a setting.
        let without = |f: &Feature| match role(&f.name) {
            Some(Role::Distorts(neutral, _)) => self.neutral(f, neutral).is_none(),
            _ => false,
        };
        for feature in self.tree.iter().filter(|f| self.inner.has(&f.name) && (kept(&f.name) || without(f))) {
            self.under_selector(&feature.name, |entry| {
                let name = &feature.name;
                let shown = entry.map_or_else(|| name.clone(), |entry| format!("{name}[{entry}]"));
                features.extend(self.read(name, feature.kind).map(|value| (shown, value)));
            });
        }
        if let Some(size) = self.inner.packet_size() {
            features.insert("GevSCPSPacketSize".into(), Value::Int(size.into()));
        }
        features
    }

    fn unlisted_features(&mut self) -> Vec<String> {
        let there = self.tree.iter().filter(|f| suspicious(&f.name) && self.inner.has(&f.name));
        there.map(|f| f.name.clone()).collect()
    }

    /// Sets both through features that a served camera has.
    fn draw_from(&mut self, frame: u64, time_s: f64) -> bool {
        // The `BenchFrame` register has 32 bits.
        let number = i64::from(frame as u32);
        self.inner.has("BenchFrame")
            && self.inner.has("BenchTime")
            && self.inner.set_integer("BenchFrame", number).is_ok()
            && self.inner.set_float("BenchTime", time_s).is_ok()
    }

    fn stream(&mut self, options: &StreamOptions) -> Result<Box<dyn FrameStream + '_>, CameraError> {
        let settings = self.settings()?;
        let id = self.identity.id.clone();
        let setup = StreamSetup {
            buffers: options.buffers,
            waiting: options.waiting,
            packet_size: options.packet_size.or(self.loopback.then_some(LOOPBACK_PACKET)),
            // Without packet resend there is nothing to wait for: complete frames would queue behind a
            // damaged one.
            packet_resend: options.packet_resend && self.inner.resends(),
            packet_timeout: options.packet_timeout,
            frame_retention: options.frame_retention,
            socket_buffer: options.socket_buffer,
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
        if let Some(granted) = stream.receive_buffer() {
            warn_of_a_small_buffer(granted, options.socket_buffer);
        }
        Ok(Box::new(stream::AravisStream {
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

/// Warns once if the system grants a smaller socket buffer than requested: packets are then lost whenever the
/// receiver is late.
fn warn_of_a_small_buffer(granted_bytes: usize, wanted_bytes: usize) {
    static SAID: std::sync::Once = std::sync::Once::new();
    if granted_bytes < wanted_bytes {
        SAID.call_once(|| {
            tracing::warn!(
                granted_bytes,
                "packets may be lost: let sockets have larger buffers by `sysctl -w net.core.rmem_max={wanted_bytes}`"
            );
        });
    }
}

fn arv_lost() -> arv::Error {
    arv::Error { what: "control".into(), message: "the camera no longer answers".into() }
}

