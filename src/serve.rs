//! The simulator as a GigE Vision camera on the network.
//!
//! Any GenICam client can drive it: exposure, gain, black level, region and format change the physics, and the
//! features `BenchIllumination`, `BenchDark`, `BenchConfiguration`, `BenchScene` and `DeviceTemperature` move the bench.
//!
//! Its clock is simulated: timestamps grow by exposure and read-out time while frames come as fast as
//! `AcquisitionFrameRate` says. Frame n since the start shows the noise of frame number n.

use crate::bench::BenchState;
use crate::camera::sim::{formats_of, narrow};
use crate::frame::Region;
use crate::pixel_format::PixelFormat;
use radcam_aravis::{Painter, Registers, Request, VirtualCamera, address};
use radcam_sim::{Conditions, Model, Scene, Sensor};
use std::fmt::Write;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// Our own registers, behind those of the fake camera and the bootstrap registers.
mod register {
    pub const EXPOSURE_US: u32 = 0x8000;
    pub const GAIN_DB: u32 = 0x8008;
    pub const BLACK_LEVEL: u32 = 0x8010;
    pub const TEMPERATURE_C: u32 = 0x8018;
    pub const ILLUMINATION: u32 = 0x8020;
    pub const DARK: u32 = 0x8028;
    pub const CONFIGURATION: u32 = 0x802C;
    pub const SCENE: u32 = 0x8030;
}

/// Step of the region's width and height: rows of every packed format then end on a byte.
const SIZE_STEP: u32 = 4;

/// Why a camera cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The network or libaravis.
    #[error(transparent)]
    Aravis(#[from] radcam_aravis::Error),
    /// The sensor.
    #[error(transparent)]
    Model(#[from] radcam_sim::ModelError),
}

/// A camera being served; it stops when dropped.
pub struct Served {
    camera: VirtualCamera,
}

impl Served {
    /// Makes the camera lose this share of its packets, 0 to 1.
    pub fn set_lost_packets(&self, share: f64) {
        self.camera.set_lost_packets(share);
    }
}

/// Serves a sensor on an interface, named by its IPv4 address.
pub fn serve(sensor: Arc<Sensor>, interface: IpAddr, serial: &str) -> Result<Served, ServeError> {
    let model = sensor.model().clone();
    let xml = description(&model);
    let painter = Artist::new(sensor);
    let camera = VirtualCamera::start(interface, serial, &xml, Box::new(painter), |registers| {
        set_up(&model, registers);
    })?;
    Ok(Served { camera })
}

/// The format in which the camera starts: the deepest, unpacked.
fn native_format(bit_depth: u8) -> u32 {
    let formats = formats_of(bit_depth);
    formats.iter().max_by_key(|f| (f.bits(), f.bits_per_pixel())).map_or(0, |f| f.code())
}

fn size(pixels: u32) -> u32 {
    (pixels / SIZE_STEP * SIZE_STEP).max(1)
}

fn set_up(model: &Model, r: &Registers) {
    let body = &model.camera;
    r.set_text(address::VENDOR, 32, &body.vendor);
    r.set_text(address::MODEL, 32, &body.model);
    r.set_text(address::VERSION, 32, env!("CARGO_PKG_VERSION"));
    r.set_u32(address::SENSOR_WIDTH, size(body.width));
    r.set_u32(address::SENSOR_HEIGHT, size(body.height));
    r.set_u32(address::WIDTH, size(body.width));
    r.set_u32(address::HEIGHT, size(body.height));
    r.set_u32(address::PIXEL_FORMAT, native_format(body.bit_depth));
    r.set_u32(address::FRAME_PERIOD_US, 10_000);
    r.set_f64(register::EXPOSURE_US, 1e6 * 0.01_f64.clamp(body.exposure_min_s, body.exposure_max_s));
    r.set_f64(register::GAIN_DB, 0.0);
    r.set_f64(register::BLACK_LEVEL, model.base.black_level_dn);
    r.set_f64(register::TEMPERATURE_C, model.base.dark_reference_c);
    r.set_f64(register::ILLUMINATION, 1.0);
    r.set_u32(register::DARK, 0);
    r.set_u32(register::CONFIGURATION, 0);
    r.set_u32(register::SCENE, 0);
}

/// Entries of `BenchScene`.
const SCENES: [(&str, u32, Scene); 3] =
    [("Card", 0, Scene::Card), ("Patch", 1, Scene::Patch), ("Chart", 2, Scene::Chart)];

/// What the registers ask for.
fn conditions(sensor: &Sensor, r: &Registers) -> Conditions {
    let body = &sensor.model().camera;
    let sound = |x: f64, min: f64, max: f64, or: f64| if x.is_finite() { x.clamp(min, max) } else { or };
    let exposure_s = sound(
        r.f64(register::EXPOSURE_US) * 1e-6,
        body.exposure_min_s,
        body.exposure_max_s,
        body.exposure_min_s,
    );
    let dark = r.u32(register::DARK) != 0;
    let bench = BenchState {
        illumination: if dark { 0.0 } else { sound(r.f64(register::ILLUMINATION), 0.0, 1e6, 0.0) },
        configuration: r.u32(register::CONFIGURATION),
        scene: SCENES.iter().find(|(_, n, _)| *n == r.u32(register::SCENE)).map_or(Scene::Card, |s| s.2),
    };
    let full_scale = f64::from(sensor.model().full_scale_dn());
    Conditions {
        exposure_s,
        illumination: bench.illumination,
        configuration: bench.configuration,
        scene: bench.scene,
        temperature_c: sound(r.f64(register::TEMPERATURE_C), -273.0, 200.0, 25.0),
        gain_db: sound(r.f64(register::GAIN_DB), 0.0, body.gain_max_db, 0.0),
        black_level_dn: sound(r.f64(register::BLACK_LEVEL), 0.0, full_scale, 0.0),
        time_s: 0.0,
    }
}

/// What a frame shows.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Job {
    number: u64,
    conditions: Conditions,
    region: Region,
}

/// Paints frames; the next one is drawn ahead on a thread of its own, because `paint` runs where the control
/// protocol is answered.
struct Artist {
    sensor: Arc<Sensor>,
    jobs: SyncSender<(Job, Vec<u16>)>,
    done: Receiver<(Job, Vec<u16>)>,
    /// A frame is being drawn ahead.
    ahead: bool,
    /// Frame memory that is not on its way.
    spare: Vec<u16>,
    time_s: f64,
}

impl Artist {
    fn new(sensor: Arc<Sensor>) -> Self {
        let (jobs, inbox) = sync_channel::<(Job, Vec<u16>)>(1);
        let (outbox, done) = sync_channel(1);
        let painter = Arc::clone(&sensor);
        // Ends when either channel does.
        std::thread::spawn(move || {
            while let Ok((job, mut dn)) = inbox.recv() {
                draw(&painter, &job, &mut dn);
                if outbox.send((job, dn)).is_err() {
                    break;
                }
            }
        });
        Self { sensor, jobs, done, ahead: false, spare: Vec::new(), time_s: 1.0 }
    }
}

fn draw(sensor: &Sensor, job: &Job, dn: &mut Vec<u16>) {
    dn.resize(job.region.width as usize * job.region.height as usize, 0);
    sensor.draw(job.number, &job.conditions, job.region, dn);
}

impl Painter for Artist {
    fn paint(&mut self, registers: &Registers, request: Request, frame: &mut [u8]) -> u64 {
        let now_ns = (self.time_s * 1e9).round() as u64;
        let body = &self.sensor.model().camera;
        let (bit_depth, readout_s) = (body.bit_depth, body.readout_s);
        let all = self.sensor.region();
        let [x, y, width, height] = request.region;
        let inside = u64::from(x) + u64::from(width) <= u64::from(all.width)
            && u64::from(y) + u64::from(height) <= u64::from(all.height);
        let (true, Ok(format)) = (inside, PixelFormat::from_code(request.format)) else {
            tracing::warn!(
                ?request,
                "a client asked for a frame that the sensor has not; it gets a black one"
            );
            return now_ns;
        };
        let conditions = Conditions { time_s: self.time_s - 1.0, ..conditions(&self.sensor, registers) };
        let job = Job { number: request.number, conditions, region: Region { x, y, width, height } };

        let mut dn = std::mem::take(&mut self.spare);
        let mut ready = false;
        if self.ahead
            && let Ok((drawn, memory)) = self.done.recv()
        {
            self.ahead = false;
            ready = drawn == job;
            dn = memory;
        }
        if !ready {
            draw(&self.sensor, &job, &mut dn);
        }
        narrow(&mut dn, bit_depth, format.bits());
        if format.pack(&dn, frame).is_err() {
            tracing::warn!(%format, "frame memory of another size than the format needs; a black frame goes out");
        }
        self.time_s += conditions.exposure_s + readout_s;
        // Most likely the next frame is asked for under the same conditions.
        let conditions = Conditions { time_s: self.time_s - 1.0, ..conditions };
        let next = Job { number: request.number + 1, conditions, ..job };
        if !self.sensor.model().effects.is_empty() {
            // Effects remember the frame before: none may be drawn that is not asked for.
            self.spare = dn;
            return now_ns;
        }
        match self.jobs.try_send((next, dn)) {
            Ok(()) => self.ahead = true,
            Err(std::sync::mpsc::TrySendError::Full((_, memory)))
            | Err(std::sync::mpsc::TrySendError::Disconnected((_, memory))) => self.spare = memory,
        }
        now_ns
    }
}

/// Builds the GenICam description file.
struct Description {
    categories: Vec<(&'static str, Vec<String>)>,
    nodes: String,
}

impl Description {
    fn list(&mut self, category: &'static str, name: &str) {
        match self.categories.iter_mut().find(|(known, _)| *known == category) {
            Some((_, names)) => names.push(name.into()),
            None => self.categories.push((category, vec![name.into()])),
        }
    }

    fn register(&mut self, name: &str, at: u32, access: &str) {
        let _ = writeln!(
            self.nodes,
            "<IntReg Name=\"{name}\" NameSpace=\"Custom\"><Address>{at:#x}</Address><Length>4</Length>\
             <AccessMode>{access}</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>\
             <Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
        );
    }

    fn text(&mut self, category: &'static str, name: &str, at: u32, length: u32) {
        self.list(category, name);
        let _ = writeln!(
            self.nodes,
            "<StringReg Name=\"{name}\" NameSpace=\"Standard\"><Address>{at:#x}</Address>\
             <Length>{length}</Length><AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>"
        );
    }

    fn integer(&mut self, category: &'static str, name: &str, at: u32, bounds: &str) {
        self.list(category, name);
        let access = if bounds.is_empty() { "RO" } else { "RW" };
        let _ = writeln!(
            self.nodes,
            "<Integer Name=\"{name}\" NameSpace=\"Standard\"><pValue>{name}Reg</pValue>{bounds}</Integer>"
        );
        self.register(&format!("{name}Reg"), at, access);
    }

    fn float(&mut self, category: &'static str, name: &str, at: u32, (min, max): (f64, f64), unit: &str) {
        self.list(category, name);
        let _ = writeln!(
            self.nodes,
            "<Float Name=\"{name}\" NameSpace=\"Standard\"><pValue>{name}Reg</pValue><Min>{min}</Min>\
             <Max>{max}</Max><Unit>{unit}</Unit></Float>\n\
             <FloatReg Name=\"{name}Reg\" NameSpace=\"Custom\"><Address>{at:#x}</Address><Length>8</Length>\
             <AccessMode>RW</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>\
             <Endianess>BigEndian</Endianess></FloatReg>"
        );
    }

    fn enumeration(&mut self, category: &'static str, name: &str, at: u32, entries: &[(&str, u32)]) {
        self.list(category, name);
        let _ = write!(self.nodes, "<Enumeration Name=\"{name}\" NameSpace=\"Standard\">");
        for (entry, value) in entries {
            let _ = write!(self.nodes, "<EnumEntry Name=\"{entry}\"><Value>{value}</Value></EnumEntry>");
        }
        let _ = writeln!(self.nodes, "<pValue>{name}Reg</pValue></Enumeration>");
        self.register(&format!("{name}Reg"), at, "RW");
    }

    fn boolean(&mut self, category: &'static str, name: &str, at: u32) {
        self.list(category, name);
        let _ = writeln!(
            self.nodes,
            "<Boolean Name=\"{name}\"><pValue>{name}Reg</pValue><OnValue>1</OnValue><OffValue>0</OffValue>\
             </Boolean>"
        );
        self.register(&format!("{name}Reg"), at, "RW");
    }

    fn command(&mut self, category: &'static str, name: &str, reg: &str, value: u32) {
        self.list(category, name);
        let _ = writeln!(
            self.nodes,
            "<Command Name=\"{name}\" NameSpace=\"Standard\"><pValue>{reg}</pValue>\
             <CommandValue>{value}</CommandValue></Command>"
        );
    }
}

/// The GenICam description of a sensor (GenApi 1.0 schema, names of the Standard Features Naming Convention).
fn description(model: &Model) -> String {
    let body = &model.camera;
    let (w, h) = (size(body.width), size(body.height));
    let mut d = Description { categories: Vec::new(), nodes: String::new() };

    d.text("DeviceControl", "DeviceVendorName", address::VENDOR, 32);
    d.text("DeviceControl", "DeviceModelName", address::MODEL, 32);
    d.text("DeviceControl", "DeviceVersion", address::VERSION, 32);
    d.text("DeviceControl", "DeviceID", 0xd8, 16);
    d.text("DeviceControl", "DeviceSerialNumber", 0xd8, 16);
    d.float("DeviceControl", "DeviceTemperature", register::TEMPERATURE_C, (-100.0, 150.0), "C");

    d.integer("ImageFormatControl", "SensorWidth", address::SENSOR_WIDTH, "");
    d.integer("ImageFormatControl", "SensorHeight", address::SENSOR_HEIGHT, "");
    let step = SIZE_STEP;
    let sized = |max| format!("<Min>{}</Min><Max>{max}</Max><Inc>{step}</Inc>", step.min(max));
    d.integer("ImageFormatControl", "Width", address::WIDTH, &sized(w));
    d.integer("ImageFormatControl", "Height", address::HEIGHT, &sized(h));
    d.integer("ImageFormatControl", "OffsetX", address::OFFSET_X, &format!("<Min>0</Min><Max>{w}</Max>"));
    d.integer("ImageFormatControl", "OffsetY", address::OFFSET_Y, &format!("<Min>0</Min><Max>{h}</Max>"));
    let formats: Vec<_> = formats_of(body.bit_depth).iter().map(|f| (f.name(), f.code())).collect();
    d.enumeration("ImageFormatControl", "PixelFormat", address::PIXEL_FORMAT, &formats);

    let modes = [("Continuous", 1), ("SingleFrame", 2), ("MultiFrame", 3)];
    d.enumeration("AcquisitionControl", "AcquisitionMode", 0x12c, &modes);
    d.register("AcquisitionReg", 0x124, "WO");
    d.command("AcquisitionControl", "AcquisitionStart", "AcquisitionReg", 1);
    d.command("AcquisitionControl", "AcquisitionStop", "AcquisitionReg", 0);
    d.list("AcquisitionControl", "AcquisitionFrameRate");
    d.nodes.push_str(
        "<Float Name=\"AcquisitionFrameRate\" NameSpace=\"Standard\"><pValue>FrameRateConverter</pValue>\
         <Min>0.1</Min><Max>1000</Max><Unit>Hz</Unit></Float>\n\
         <Converter Name=\"FrameRateConverter\"><FormulaTo>1000000 / FROM</FormulaTo>\
         <FormulaFrom>1000000 / TO</FormulaFrom><pValue>FramePeriodReg</pValue></Converter>\n",
    );
    d.register("FramePeriodReg", address::FRAME_PERIOD_US, "RW");
    let exposure_us = (1e6 * body.exposure_min_s, 1e6 * body.exposure_max_s);
    d.float("AcquisitionControl", "ExposureTime", register::EXPOSURE_US, exposure_us, "us");
    d.list("AcquisitionControl", "TriggerSelector");
    d.nodes.push_str(
        "<Enumeration Name=\"TriggerSelector\" NameSpace=\"Standard\"><EnumEntry Name=\"FrameStart\">\
         <Value>0</Value></EnumEntry><Value>0</Value></Enumeration>\n",
    );
    d.enumeration("AcquisitionControl", "TriggerMode", 0x300, &[("Off", 0), ("On", 1)]);
    d.enumeration("AcquisitionControl", "TriggerSource", 0x304, &[("Line0", 0), ("Software", 1)]);
    d.enumeration("AcquisitionControl", "TriggerActivation", 0x308, &[("RisingEdge", 0)]);
    d.register("TriggerSoftwareReg", 0x30c, "WO");
    d.command("AcquisitionControl", "TriggerSoftware", "TriggerSoftwareReg", 1);

    d.float("AnalogControl", "Gain", register::GAIN_DB, (0.0, body.gain_max_db), "dB");
    let full_scale = f64::from(model.full_scale_dn());
    d.float("AnalogControl", "BlackLevel", register::BLACK_LEVEL, (0.0, full_scale), "DN");

    d.float("BenchControl", "BenchIllumination", register::ILLUMINATION, (0.0, 1e6), "relative");
    d.boolean("BenchControl", "BenchDark", register::DARK);
    let configurations = "<Min>0</Min><Max>1000000</Max>";
    d.integer("BenchControl", "BenchConfiguration", register::CONFIGURATION, configurations);
    d.enumeration("BenchControl", "BenchScene", register::SCENE, &SCENES.map(|(name, n, _)| (name, n)));

    d.list("TransportLayerControl", "PayloadSize");
    d.nodes.push_str(
        "<IntSwissKnife Name=\"PayloadSize\" NameSpace=\"Standard\"><pVariable Name=\"W\">Width</pVariable>\
         <pVariable Name=\"H\">Height</pVariable><pVariable Name=\"P\">PixelFormat</pVariable>\
         <Formula>W * H * ((P &gt;&gt; 16) &amp; 0xFF) / 8</Formula></IntSwissKnife>\n\
         <Integer Name=\"TLParamsLocked\"><Visibility>Invisible</Visibility><Value>0</Value><Min>0</Min>\
         <Max>1</Max></Integer>\n<Port Name=\"Device\" NameSpace=\"Standard\"/>\n",
    );

    let escape = |s: &str| s.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;");
    let mut xml = format!(
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<RegisterDescription ModelName=\"{}\" VendorName=\"{}\" \
         StandardNameSpace=\"GEV\" SchemaMajorVersion=\"1\" SchemaMinorVersion=\"0\" SchemaSubMinorVersion=\"1\" \
         MajorVersion=\"1\" MinorVersion=\"0\" SubMinorVersion=\"0\" ToolTip=\"{}\" \
         ProductGuid=\"0\" VersionGuid=\"0\" xmlns=\"http://www.genicam.org/GenApi/Version_1_0\">\n",
        escape(&body.model),
        escape(&body.vendor),
        escape(&model.about),
    );
    xml.push_str("<Category Name=\"Root\" NameSpace=\"Standard\">");
    for (category, _) in &d.categories {
        let _ = write!(xml, "<pFeature>{category}</pFeature>");
    }
    xml.push_str("</Category>\n");
    for (category, names) in &d.categories {
        let _ = write!(xml, "<Category Name=\"{category}\">");
        for name in names {
            let _ = write!(xml, "<pFeature>{name}</pFeature>");
        }
        xml.push_str("</Category>\n");
    }
    xml + &d.nodes + "</RegisterDescription>\n"
}
